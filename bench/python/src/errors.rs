//! Errors as Python raises them: the sentences of the commands.

use std::error::Error;

use pyo3::PyErr;
use pyo3::exceptions::{PyOSError, PyValueError};
use strat_store::command::error_chain;

/// `OSError` where a file or folder cannot be used, `ValueError` for everything else.
pub fn raised(error: impl Into<Box<dyn Error>>) -> PyErr {
    let error = error.into();
    let text = error_chain(error.as_ref());
    let mut next: Option<&dyn Error> = Some(error.as_ref());
    while let Some(error) = next {
        if error.is::<strat_store::Error>() || error.is::<std::io::Error>() {
            return PyOSError::new_err(text);
        }
        next = error.source();
    }
    PyValueError::new_err(text)
}
