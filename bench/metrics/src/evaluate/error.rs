//! Why an image was not scored.

use crate::protocol::{Alignment, CameraError};

/// Why an image was not scored.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum EvaluateError {
    /// A plane has another size than the ground truth.
    #[error("the {plane} has {found} values where {width} x {height} = {expected} are needed")]
    Size {
        /// Which plane.
        plane: &'static str,
        /// Its length.
        found: usize,
        /// Length needed.
        expected: usize,
        /// Columns of the ground truth.
        width: usize,
        /// Rows of the ground truth.
        height: usize,
    },
    /// A prediction that is negative or not finite.
    #[error(
        "the predicted {what} at row {row}, column {column} is {value}; predictions must be \
         finite and not negative, so the model or the way its output is read is at fault"
    )]
    Prediction {
        /// Disparity or depth.
        what: &'static str,
        /// 0-based row.
        row: usize,
        /// 0-based column.
        column: usize,
        /// The value.
        value: f32,
    },
    /// Ground truth that is negative or not finite.
    #[error(
        "the true {what} at row {row}, column {column} is {value}; ground truth must be finite \
         and not negative, so the file is damaged or no depth map"
    )]
    Truth {
        /// Disparity or depth.
        what: &'static str,
        /// 0-based row.
        row: usize,
        /// 0-based column.
        column: usize,
        /// The value.
        value: f32,
    },
    /// A prediction that is not a number or infinite, where any number would do.
    #[error(
        "the predicted {what} at row {row}, column {column} is {value}; predictions must be finite"
    )]
    Infinite {
        /// Depth or inverse depth, in no unit.
        what: &'static str,
        /// 0-based row.
        row: usize,
        /// 0-based column.
        column: usize,
        /// The value.
        value: f32,
    },
    /// A prediction that the protocol's alignment is not for.
    #[error(
        "protocol {name} has the alignment `{alignment}`, which does not fit {what}; what fits is {}",
        fitting.iter().map(|one| format!("`{one}`")).collect::<Vec<_>>().join(", ")
    )]
    Alignment {
        /// Name of the protocol.
        name: String,
        /// Its alignment.
        alignment: Alignment,
        /// What was predicted.
        what: &'static str,
        /// The alignments that fit.
        fitting: &'static [Alignment],
    },
    /// Values from which no scale follows.
    #[error(
        "there is nothing to align (`{alignment}`): the prediction {} to be scored",
        if alignment.is_of_inverse_depth() {
            "has no inverse depth above 0 at any of the pixels"
        } else {
            "is 0 at all pixels"
        }
    )]
    NothingToFit {
        /// The alignment.
        alignment: Alignment,
    },
    /// A fit that is not finite.
    #[error(
        "the alignment `{alignment}` has no finite result: the prediction is infinite at some of the \
         pixels to be scored, or too large"
    )]
    Unbounded {
        /// The alignment.
        alignment: Alignment,
    },
    /// An image that is too small for KITTI's benchmark crop.
    #[error(
        "protocol {name} is about KITTI's benchmark crop, and an image of {width}x{height} is smaller \
         than its 1216x352"
    )]
    TooSmall {
        /// Name of the protocol.
        name: String,
        /// Columns of the image.
        width: usize,
        /// Rows of the image.
        height: usize,
    },
    /// The protocol's camera cannot be had.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// A protocol that cannot be followed, for instance one read from a file.
    #[error("protocol {name} cannot be followed: {reason}")]
    Protocol {
        /// Name of the protocol.
        name: String,
        /// What is wrong.
        reason: &'static str,
    },
    /// A crop in pixels that does not lie within the image.
    #[error(
        "the protocol's crop ends at row {bottom} and column {right}, but the ground truth has {height} \
         rows and {width} columns; a crop in pixels is for images of one size"
    )]
    Crop {
        /// One past the last row of the crop.
        bottom: usize,
        /// One past its last column.
        right: usize,
        /// Columns of the ground truth.
        width: usize,
        /// Rows of the ground truth.
        height: usize,
    },
    /// Disparity under a protocol that can make no metres of it.
    #[error(
        "protocol {name} has no camera, and without one disparity becomes no depth in metres; give it a \
         camera, or scale by the median"
    )]
    NoCamera {
        /// Name of the protocol.
        name: String,
    },
    /// Something the protocol needs was not given.
    #[error("protocol {name} needs {what}, which this image does not have")]
    Missing {
        /// Name of the protocol.
        name: String,
        /// What it needs.
        what: &'static str,
    },
    /// No pixel passed the protocol's mask, or none of its groups occurs.
    #[error(
        "no pixel of this image is left under protocol {name} ({with_truth} pixels have ground \
         truth); an average over nothing is not a number, so the image gets no score"
    )]
    NothingToScore {
        /// Name of the protocol.
        name: String,
        /// Pixels of the whole image with ground truth.
        with_truth: usize,
    },
    /// A map of depth without any where it is to be scored.
    #[error(
        "the map is dead: it has no depth (0 is none) at any of the {pixels} pixels to be scored"
    )]
    NothingPredicted {
        /// Pixels to be scored.
        pixels: usize,
    },
    /// Half or more of the predicted depths are zero or infinite, so there is no median to
    /// scale by.
    #[error("the median of the predicted depth is {0} m; the prediction cannot be scaled by it")]
    Median(f64),
}
