//! Which pictorial depth cues a model uses: the experiments of the thesis' chapter 4.
//!
//! Sprites are pasted into pictures of a prepared set ([`composite`], [`sprites`]) in one of three
//! experiments ([`experiments`], PROTOCOL 5.1 to 5.3): relative size, occlusion and luminance
//! contrast, height in the visual field. Any model that `bench` can run is asked about each
//! composite ([`run`]); what it says becomes one row each ([`rows`]), and rows alone make the
//! statistics and verdicts ([`summary`]) and the figures ([`figures`]).
//!
//! Sprite depth is the median over what is opaque, eroded by 2 pixels; the same pixels of the
//! clean background are its reference. Models without a scale are judged by relative measures.
//! [`cutouts`] makes sprites of a labelled set's own objects.

use strat_store::set::Content;

use crate::{
    cues::{rows::RowsError, sprites::SpriteError},
    evaluate::SampleError,
};

pub mod composite;
pub mod cutouts;
pub mod experiments;
pub mod figures;
pub mod rows;
pub mod run;
pub mod sprites;
pub mod summary;

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
    /// A summary or figure cannot be encoded.
    #[error("{what} could not be made: {reason}")]
    Output {
        /// What was to be made.
        what: String,
        /// Why not.
        reason: String,
    },
}

/// Row of the horizon: the principal point of KITTI's cameras (PROTOCOL 1.1), by image width.
///
/// Images of other sizes of a KITTI set are taken for scaled ones of 1242x375. Of other
/// collections nothing is known, and the middle row is returned with `false`.
#[must_use]
pub fn horizon_row(content: Content, width: u32, height: u32) -> (f64, bool) {
    let rows = f64::from(height);
    if content.split().is_none() {
        return (0.5 * (rows - 1.0), false);
    }
    let row = match width {
        1224 => 180.5066,
        1238 => 181.5122,
        1226 => 183.1104,
        1241 => 185.2157,
        _ => 172.854 * rows / 375.0,
    };
    (row, true)
}
