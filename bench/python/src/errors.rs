//! Errors as Python raises them: the sentences of the commands.

use std::error::Error;

use pyo3::PyErr;
use pyo3::exceptions::{PyOSError, PyValueError};
use strat_bench::evaluate::{SampleError, in_memory::InMemoryError, write::WriteError};
use strat_bench::rows::compare::CompareError;
use strat_store::command::error_chain;

/// `OSError` where a file or folder cannot be used, `ValueError` for everything else.
pub fn raised(error: impl Into<Box<dyn Error>>) -> PyErr {
    let error = error.into();
    let text = error_chain(error.as_ref());
    let mut next: Option<&dyn Error> = Some(error.as_ref());
    while let Some(error) = next {
        if is_of_file(error) {
            return PyOSError::new_err(text);
        }
        next = error.source();
    }
    PyValueError::new_err(text)
}

/// What passes another error on as it is, is none of its causes.
fn is_of_file(error: &(dyn Error + 'static)) -> bool {
    error.is::<strat_store::Error>()
        || error.is::<std::io::Error>()
        || matches!(
            error.downcast_ref(),
            Some(
                InMemoryError::Store(_)
                    | InMemoryError::Write(WriteError::Store(_))
                    | InMemoryError::Score(SampleError::Store(_))
            )
        )
        || matches!(error.downcast_ref(), Some(SampleError::Store(_)))
        || matches!(error.downcast_ref(), Some(CompareError::Store(_)))
        || matches!(error.downcast_ref(), Some(WriteError::Store(_)))
}
