//! Predictions in files: read ([`SavedPredictions`]) and written ([`PredictionWriter`]).

mod read;
mod write;

pub use read::{FOLDER_DESCRIPTION, SavedDescription, SavedError, SavedPredictions};
pub use write::{PredictionWriter, SaveError};
