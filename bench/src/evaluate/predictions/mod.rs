//! Predictions in files: read ([`SavedPredictions`]) and written ([`PredictionWriter`]).

mod find;
mod names;
mod read;
#[cfg(test)]
mod tests;
mod write;

pub use read::{FOLDER_DESCRIPTION, SavedDescription, SavedError, SavedPredictions};
pub use write::{PredictionWriter, SaveError};
