//! One line of `cues.csv` for each composite, and the file in both directions.
//!
//! Everything that figures and summaries say comes from these lines, so that a folder can be
//! drawn again without model and data.

use std::path::Path;

use serde::{Deserialize, Serialize};
use strat_store::files;
use strat_store::inputs::{self, Kind};

/// File name of the rows.
pub const ROWS: &str = "cues.csv";

/// Which experiment a composite belongs to (PROTOCOL 5.1 to 5.3).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Experiment {
    /// One sprite in 50 sizes.
    Size,
    /// The same beside a second sprite of fixed size.
    SizePair,
    /// One sprite before another.
    Occlusion,
    /// A sprite at different heights in the picture.
    Height,
}

/// What is varied besides the step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Condition {
    /// A sprite alone.
    Single,
    /// With a second one of fixed size.
    Pair,
    /// Occluder and occluded of the same luminance.
    Same,
    /// The occluder lighter or darker.
    Contrast,
    /// Size follows from the place on the ground (run A).
    SizeChanges,
    /// Size is the same everywhere (run B).
    SizeFixed,
}

/// What depth is counted in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Unit {
    /// Metres.
    M,
    /// Multiples of the depth that belongs to the clean background's median value: the model's
    /// scale, or the camera, is not known.
    Relative,
}

impl Unit {
    /// Behind a number or in an axis' label.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::M => "m",
            Self::Relative => "relative",
        }
    }
}

/// A composite and what the model said of it. Rows and columns are pixel centres.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CueRow {
    /// Name of the model.
    pub model: String,
    /// Which experiment.
    pub experiment: Experiment,
    /// Name of the sprite that is measured; of the occluder where one is before another.
    pub sprite: String,
    /// Whether a network trained on streets has seen such objects.
    pub familiar: bool,
    /// Image id of the background.
    pub background: String,
    /// One of the composites that the thesis' own experiment has.
    pub thesis: bool,
    /// What is varied besides the step.
    pub condition: Condition,
    /// 1-based: the factor k that divides the size, the size, or the place from the bottom up.
    pub step: u32,
    /// Pixels from the sprite's top to its contact with the ground.
    pub height_px: f64,
    /// Row of that contact.
    pub contact_row: f64,
    /// Row of the horizon.
    pub horizon_row: f64,
    /// Last row of the image.
    pub bottom_row: f64,
    /// Focal length of the image where it is known.
    pub focal_px: Option<f64>,
    /// Depth that the varied cue alone implies, metres: of size f h / height_px, of place f 1.65 /
    /// (v - cy).
    pub ideal_depth_m: Option<f64>,
    /// What the depths are counted in.
    pub unit: Unit,
    /// Median depth over the sprite.
    pub depth: f64,
    /// The same pixels in the clean background.
    pub reference_depth: f64,
    /// Pixels that both medians are over.
    pub pixels: usize,
    /// By how many pixels the sprite was eroded: 2, or less where nothing would be left.
    pub eroded_px: usize,
    /// Occlusion only: median depth outside the occluder's edge minus that inside.
    pub step_depth: Option<f64>,
    /// The same over the same pixels of the clean background.
    pub clean_step_depth: Option<f64>,
    /// Occlusion only: width in pixels of the bands on both sides of the edge, 3 pixels of the network.
    #[serde(default)]
    pub band_px: Option<i64>,
    /// Contrast only: mean |same - contrast| within the band along the edge.
    pub band_change: Option<f64>,
    /// Contrast only: the same over the rest of both objects.
    pub rest_change: Option<f64>,
}

/// What tells the composites of one model apart: experiment, sprite, background, condition and step.
pub type Key = (Experiment, String, String, Condition, u32);

impl CueRow {
    /// Which composite it is about.
    #[must_use]
    pub fn key(&self) -> Key {
        (
            self.experiment,
            self.sprite.clone(),
            self.background.clone(),
            self.condition,
            self.step,
        )
    }

    /// Sprite over reference.
    #[must_use]
    pub fn relative_depth(&self) -> f64 {
        self.depth / self.reference_depth
    }

    /// Rows from the horizon down to the contact.
    #[must_use]
    pub fn rows_below_horizon(&self) -> f64 {
        self.contact_row - self.horizon_row
    }
}

/// Why `cues.csv` cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum RowsError {
    /// The file could not be read or written.
    #[error(transparent)]
    Store(#[from] strat_store::Error),
    /// A line does not fit.
    #[error("{path} cannot be used: {source}; it must be the {ROWS} that `bench cues` wrote")]
    Csv {
        /// The file.
        path: String,
        /// What is wrong and where.
        source: strat_csv::Error,
    },
    /// There is nothing in it.
    #[error("{path} has no rows; run `bench cues` with a model first")]
    Empty {
        /// The file.
        path: String,
    },
}

/// Writes the rows of all models.
///
/// # Errors
/// The file cannot be written.
pub fn write(folder: &Path, rows: &[CueRow]) -> Result<(), RowsError> {
    Ok(files::write_csv(&folder.join(ROWS), rows)?)
}

/// Reads the rows of a folder.
///
/// # Errors
/// The file is missing, empty, or a line does not fit; the line is named.
pub fn read(folder: &Path) -> Result<Vec<CueRow>, RowsError> {
    let path = folder.join(ROWS);
    let bytes = inputs::read(&path, Kind::Table)?;
    let rows: Vec<CueRow> = strat_csv::Reader::new(bytes.as_slice())
        .deserialize()
        .map_err(|source| RowsError::Csv {
            path: path.display().to_string(),
            source,
        })?;
    if rows.is_empty() {
        return Err(RowsError::Empty {
            path: path.display().to_string(),
        });
    }
    Ok(rows)
}
