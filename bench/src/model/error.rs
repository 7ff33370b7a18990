//! Why a model cannot be used.

use std::path::PathBuf;

use strat_onnx::{metadata::ProbeError, model::ReadError};

use crate::{runtime::RuntimeError, view::NoCrop};

/// Why a model cannot be used, or what it did wrong.
#[derive(Debug, thiserror::Error)]
pub enum ModelError {
    /// The file was refused before any runtime saw it.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The runtime refused the model or failed.
    #[error(transparent)]
    Runtime(#[from] RuntimeError),
    /// The file beside the model could not be used.
    #[error(transparent)]
    DescriptionFile(strat_store::Error),
    /// Nobody says what the tensors mean.
    #[error(
        "{} does not say what its tensors mean, and {} is missing; \
         `bench describe` drafts one from the file, for you to confirm",
        model.display(), yaml.display()
    )]
    Undescribed {
        /// The model file.
        model: PathBuf,
        /// Where a description was looked for.
        yaml: PathBuf,
    },
    /// The model's metadata has a value this program does not understand.
    #[error("the metadata of {} cannot be used: {reason}", model.display())]
    Metadata {
        /// The model file.
        model: PathBuf,
        /// What is wrong, as a sentence.
        reason: String,
    },
    /// The graph does not fit its description.
    #[error("{} does not fit its description: {reason}", model.display())]
    Graph {
        /// The model file.
        model: PathBuf,
        /// What does not fit.
        reason: String,
    },
    /// The image does not hold the crop of the description.
    #[error(
        "the model is shown the image up to row {bottom} and column {right} (`crop` of its description), \
         but this image is {width}x{height}"
    )]
    Crop {
        /// One past the last row of the crop.
        bottom: u32,
        /// One past its last column.
        right: u32,
        /// Columns of the image.
        width: u32,
        /// Rows of the image.
        height: u32,
    },
    /// The image does not hold KITTI's benchmark crop.
    #[error(transparent)]
    NoCrop(#[from] NoCrop),
    /// An image whose input would be too large.
    #[error("for this image the model's input would be {width}x{height}, more than {most} pixels")]
    TooLarge {
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
        /// Pixels that it may have.
        most: u64,
    },
    /// Depth for a canonical camera, and an image whose camera is not known.
    #[error(
        "the model gives depth for a camera of `canonical_focal_px`; metres need the focal length of the \
         image, which is not known (`--focal-px`, or a set that has it)"
    )]
    NoFocal,
    /// The model ran, but an output is missing.
    #[error("the model gave no output `{wanted}`; its outputs are {found}")]
    NoOutput {
        /// Name looked for.
        wanted: String,
        /// Names there.
        found: String,
    },
    /// The model ran, but gave another shape.
    #[error("the model's output `{name}` has the shape {found:?}, but {expected} is needed")]
    OutputShape {
        /// The output.
        name: String,
        /// Shape given.
        found: Vec<usize>,
        /// Shape needed.
        expected: String,
    },
    /// The model ran, but gave something that is not a number.
    #[error(
        "the model's output `{name}` is not a number at row {row}, column {column} \
         ({count} of {total} values are NaN or infinite)"
    )]
    NotFinite {
        /// The output.
        name: String,
        /// First such row, from 0.
        row: usize,
        /// First such column, from 0.
        column: usize,
        /// How many.
        count: usize,
        /// Of how many.
        total: usize,
    },
    /// The model ran, but gave a map that cannot be what its description says.
    #[error("the model's output `{name}` cannot be what its description says: {reason}")]
    Implausible {
        /// The output.
        name: String,
        /// What cannot be.
        reason: Implausible,
    },
    /// The probe that the trainer left cannot be held against this model.
    #[error("the model's own check cannot be made: {0}")]
    Probe(#[from] ProbeError),
}

/// Why a map cannot be what it is said to be.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Implausible {
    /// The map has another aspect than what it maps.
    #[error(
        "it is a map of {width}x{height} for {what} of {of_width}x{of_height}, which has another \
         aspect; {hint}"
    )]
    Aspect {
        /// Columns of the map.
        width: usize,
        /// Rows of the map.
        height: usize,
        /// What it maps.
        what: &'static str,
        /// Columns of that.
        of_width: usize,
        /// Rows of that.
        of_height: usize,
        /// The likely cause, and the key of the description that decides.
        hint: &'static str,
    },
    /// A value that nothing of this meaning can have.
    #[error("it has the value {value} at row {row}, column {column}, but {rule}")]
    Value {
        /// The value.
        value: f32,
        /// Its row, from 0.
        row: usize,
        /// Its column, from 0.
        column: usize,
        /// What cannot be, the likely cause, and the key of the description that decides.
        rule: String,
    },
}
