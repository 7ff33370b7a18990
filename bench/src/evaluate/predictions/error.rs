//! Why saved predictions cannot be used, and the two ways in which that is found at once.

use std::{
    fs::File,
    path::{Path, PathBuf},
};
use strat_store::inputs::{self, Kind};

use crate::{model::Implausible, view::NoCrop};

/// Why saved predictions cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum SavedError {
    /// A file could not be read or decoded.
    #[error(transparent)]
    Store(#[from] strat_store::Error),
    /// A file is not what it should be.
    #[error("{} cannot be read as predictions: {reason}", path.display())]
    Unusable {
        /// The file or folder.
        path: PathBuf,
        /// A sentence.
        reason: String,
    },
    /// Nobody says what the numbers mean.
    #[error(
        "{} does not say what its numbers mean, and {} is missing; write one, such as \
         `meaning: disparity_fraction` (`bench eval --help` has the others)",
        path.display(), yaml.display()
    )]
    Undescribed {
        /// The predictions.
        path: PathBuf,
        /// Where a description was looked for.
        yaml: PathBuf,
    },
    /// An image without a map.
    #[error("{} has no map for this image", path.display())]
    Missing {
        /// The predictions.
        path: PathBuf,
    },
    /// A map that cannot be scored.
    #[error("{}: {fault}", path.display())]
    Map {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        fault: MapFault,
    },
}

/// Why a map, wherever it comes from, cannot be scored.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MapFault {
    /// Something that is not a number.
    #[error("the map is not a number at row {row}, column {column}")]
    NotFinite {
        /// First such row, from 0.
        row: usize,
        /// First such column, from 0.
        column: usize,
    },
    /// It shows a crop that the image does not have.
    #[error(transparent)]
    NoCrop(#[from] NoCrop),
    /// It cannot be what it is said to be.
    #[error("the map cannot be what its description says: {0}")]
    Implausible(Implausible),
}

pub(super) fn unusable(path: &Path, reason: impl ToString) -> SavedError {
    SavedError::Unusable {
        path: path.to_path_buf(),
        reason: reason.to_string(),
    }
}

pub(super) fn open(path: &Path) -> Result<File, SavedError> {
    Ok(inputs::open(path, Kind::Maps)?)
}
