//! Scores one image under a [`Protocol`].
//!
//! Order of steps, PROTOCOL 3.3 to 3.6 and 3.9: floor the disparity, turn it into depth, choose
//! the pixels, scale by medians if the protocol says so, clip, measure. Predictions arrive at
//! the size of the ground truth; how they were resized is the caller's business.
//!
//! # Precision
//!
//! The reference holds a prediction in single precision until it is compared: disparity in
//! pixels is `width * fraction` and depth `(focal * baseline) / disparity`, where the products
//! of plain numbers are double but the quotient is single. Both roundings are repeated here,
//! because a depth that is rounded otherwise may fall on the other side of an accuracy
//! threshold. Everything after that is double precision.
//!
//! `truth` is what is known of an image, `score` the steps. Not here: flip post-processing, see
//! [`flip_blend`](crate::flip_blend).

mod error;
mod score;
#[cfg(test)]
mod tests;
mod truth;

pub use error::EvaluateError;
pub use score::ImageScore;
pub use truth::GroundTruth;

use crate::protocol::{InfiniteDepth, Protocol};
use score::{Predicted, Scene};

/// Scores a predicted disparity, given as a fraction of image width at the size of the ground
/// truth. Returns one score, or one per group that occurs in the image, in table order.
///
/// # Errors
/// Planes of wrong size, values that are negative or not finite, input that the protocol needs
/// and was not given, and an image without a pixel to score.
pub fn evaluate(
    protocol: &Protocol,
    truth: &GroundTruth,
    disparity_fraction: &[f32],
) -> Result<Vec<ImageScore>, EvaluateError> {
    let scene = Scene::new(protocol, truth)?;
    scene.check_prediction("disparity", disparity_fraction)?;
    let floor = protocol.disparity_floor_fraction as f32;
    let width = truth.width as f32;
    let focal_baseline = scene.focal_baseline as f32;
    let infinite = match protocol.infinite_depth {
        InfiniteDepth::FarLimit => f32::INFINITY,
        InfiniteDepth::NearLimit => 0.0,
    };
    scene.score(|index| {
        let disparity_px = width * disparity_fraction[index].max(floor);
        let depth_m = focal_baseline / disparity_px;
        Predicted {
            depth_m: if depth_m.is_infinite() {
                infinite
            } else {
                depth_m
            },
            disparity_px,
            floored: disparity_fraction[index] < floor,
        }
    })
}

/// Scores a predicted depth in metres at the size of the ground truth: for models that do not
/// predict disparity, and for baselines such as a constant map. A depth of 0 ends at the
/// near limit. The floor of the protocol does not apply.
///
/// # Errors
/// As for [`evaluate`].
pub fn evaluate_depth(
    protocol: &Protocol,
    truth: &GroundTruth,
    depth_m: &[f32],
) -> Result<Vec<ImageScore>, EvaluateError> {
    let scene = Scene::new(protocol, truth)?;
    scene.check_prediction("depth", depth_m)?;
    scene.score(|index| Predicted {
        depth_m: depth_m[index],
        disparity_px: (scene.focal_baseline / f64::from(depth_m[index])) as f32,
        floored: false,
    })
}
