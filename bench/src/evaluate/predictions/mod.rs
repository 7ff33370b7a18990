//! Predictions in files: read ([`SavedPredictions`]) and written ([`PredictionWriter`]).

mod error;
mod find;
mod names;
mod read;
#[cfg(test)]
mod tests;
mod write;

pub use error::{MapFault, SavedError};
pub use read::{FOLDER_DESCRIPTION, SavedDescription, SavedPredictions};
pub use write::{PredictionWriter, SaveError};
