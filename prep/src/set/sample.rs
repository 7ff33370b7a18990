//! A frame on its way to becoming a sample, and why it may not become one.

use std::path::Path;

use strat_splits::Role;

use crate::error::Error;
use crate::input::source::Source;

/// A frame from which a sample is made.
#[derive(Debug)]
pub struct Frame<T> {
    /// What it is for.
    pub role: Role,
    /// Name of its sample.
    pub id: String,
    /// What it is made from.
    pub input: T,
}

/// An input that cannot be used.
#[derive(Debug)]
pub struct BadInput {
    /// Its name.
    pub file: String,
    /// What is wrong with it; a sentence that names it.
    pub problem: String,
}

/// Why a sample, or a file of it, is not there.
#[derive(Debug)]
pub enum SampleError {
    /// An input is bad, which costs this sample only.
    Input(BadInput),
    /// The output cannot be written, which ends everything.
    Output(Error),
}

/// A sample or a file of it.
pub type SampleResult<T> = Result<T, SampleError>;

impl SampleError {
    /// A bad input; the problem names it already.
    pub fn input(file: &Source, problem: impl ToString) -> Self {
        Self::Input(BadInput {
            file: file.to_string(),
            problem: problem.to_string(),
        })
    }

    /// A bad input whose problem does not name it yet.
    pub fn about(file: &Source, problem: impl std::fmt::Display) -> Self {
        Self::input(file, format!("{file}: {problem}"))
    }

    /// A bad input that is a file of a folder; the problem names it already.
    pub fn path(file: &Path, problem: impl ToString) -> Self {
        Self::input(&Source::File(file.to_owned()), problem)
    }
}

/// What a sample can do without: `None`, with a note of the reason, if its input is bad.
///
/// # Errors
/// The output cannot be written.
pub fn optional<T>(file: SampleResult<T>, left_out: &mut Vec<BadInput>) -> SampleResult<Option<T>> {
    match file {
        Ok(file) => Ok(Some(file)),
        Err(SampleError::Input(bad)) => {
            left_out.push(bad);
            Ok(None)
        }
        Err(error) => Err(error),
    }
}

/// Makes sure that a map has the size of its image.
///
/// # Errors
/// It has another.
pub fn same_size(file: &Source, found: (u32, u32), image: (u32, u32)) -> SampleResult<()> {
    if found == image {
        return Ok(());
    }
    let ((w, h), (iw, ih)) = (found, image);
    Err(SampleError::input(
        file,
        format!("{file} is {w}x{h}, but its left image is {iw}x{ih}"),
    ))
}
