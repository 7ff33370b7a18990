//! Why the experiments cannot be made.

use std::path::PathBuf;

use super::{rows::RowsError, sprites::SpriteError};
use crate::{draw::png::DrawError, evaluate::SampleError, model::ModelError};

/// Why the experiments cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum CueError {
    /// A sprite cannot be used.
    #[error(transparent)]
    Sprite(#[from] SpriteError),
    /// The rows cannot be read or written.
    #[error(transparent)]
    Rows(#[from] RowsError),
    /// A file of the set cannot be read or written.
    #[error(transparent)]
    Store(#[from] strat_store::Error),
    /// A sprite has no room in a picture.
    #[error(
        "the sprite \"{sprite}\" would be {width}x{height} pixels and does not fit into a \
         background of {image_width}x{image_height}; give a narrower sprite or larger images"
    )]
    SpriteTooLarge {
        /// The sprite.
        sprite: String,
        /// Its width where it is pasted.
        width: u32,
        /// Its height where it is pasted.
        height: u32,
        /// Width of the background.
        image_width: u32,
        /// Height of the background.
        image_height: u32,
    },
    /// There are not enough pictures.
    #[error(
        "the set in {set} has {found} test images at full size, and the experiments need at least \
         {needed} backgrounds; prepare more of the test set"
    )]
    TooFewBackgrounds {
        /// The folder.
        set: String,
        /// Usable pictures.
        found: usize,
        /// Least number.
        needed: usize,
    },
    /// A picture that was asked for is not there.
    #[error("the set in {set} has no test image \"{id}\" at full size; its ids are in test.csv")]
    NoSuchBackground {
        /// The folder.
        set: String,
        /// The id.
        id: String,
    },
    /// A background cannot be used.
    #[error("background {id}: {source}")]
    Background {
        /// Image id.
        id: String,
        /// Why.
        source: SampleError,
    },
    /// The horizon is not in the picture.
    #[error(
        "the horizon at row {row} does not lie in the background {id} of {height} rows; give \
         another `--horizon-row`"
    )]
    Horizon {
        /// Image id.
        id: String,
        /// The row.
        row: f64,
        /// Rows of the picture.
        height: u32,
    },
    /// There are no sprites to be had from a set.
    #[error("{what} could not be made: {reason}")]
    Sprites {
        /// What was to be made.
        what: String,
        /// Why not.
        reason: String,
    },
    /// The model fails on every background.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// A figure cannot become PNG.
    #[error("figure {name}: {source}")]
    Draw {
        /// The figure.
        name: String,
        /// Why.
        source: DrawError,
    },
    /// What was measured cannot be kept for a later run.
    #[error("{} cannot be written: {source}", path.display())]
    Journal {
        /// The journal.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
}
