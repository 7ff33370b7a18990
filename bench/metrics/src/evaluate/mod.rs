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
pub use score::{Compared, ComparedPixel, ImageScore};
pub use truth::GroundTruth;

use crate::protocol::Protocol;
use score::{Predicted, Scene, Scored};

/// A prediction at the size of the ground truth, row-major.
#[derive(Clone, Copy, Debug)]
pub enum Prediction<'a> {
    /// Disparity as a fraction of image width.
    DisparityFraction(&'a [f32]),
    /// Depth in metres: for models that do not predict disparity, and for baselines such as a
    /// constant map. The floor of the protocol does not apply. A depth of 0 is none, as in KITTI's own
    /// files: such pixels are left out of all figures and counted in
    /// [`ImageScore::floored_pixels`].
    DepthM(&'a [f32]),
}

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
    let prediction = Prediction::DisparityFraction(disparity_fraction);
    Ok(score(&scene, prediction)?.scores)
}

/// Scores a predicted depth in metres at the size of the ground truth; see
/// [`Prediction::DepthM`].
///
/// # Errors
/// As for [`evaluate`], and a map without depth at any pixel that is to be scored.
pub fn evaluate_depth(
    protocol: &Protocol,
    truth: &GroundTruth,
    depth_m: &[f32],
) -> Result<Vec<ImageScore>, EvaluateError> {
    let scene = Scene::new(protocol, truth)?;
    Ok(score(&scene, Prediction::DepthM(depth_m))?.scores)
}

/// Scores a prediction as [`evaluate`] and [`evaluate_depth`] do, and hands out what was compared.
///
/// # Errors
/// As for [`evaluate`].
pub fn evaluate_with_pixels(
    protocol: &Protocol,
    truth: &GroundTruth,
    prediction: Prediction<'_>,
) -> Result<(Vec<ImageScore>, Compared), EvaluateError> {
    let scene = Scene::new(protocol, truth)?;
    let scored = score(&scene, prediction)?;
    Ok(match prediction {
        Prediction::DisparityFraction(fraction) => {
            let depth_m = fraction.iter().map(|&d| scene.of_disparity(d).depth_m);
            scored.with_pixels(&scene, depth_m)
        }
        Prediction::DepthM(depth_m) => {
            let (scores, mut compared) = scored.with_pixels(&scene, depth_m.iter().copied());
            for (scored_m, &depth_m) in compared.predicted_m.iter_mut().zip(depth_m) {
                if depth_m == 0.0 {
                    *scored_m = 0.0;
                }
            }
            (scores, compared)
        }
    })
}

fn score(scene: &Scene<'_>, prediction: Prediction<'_>) -> Result<Scored, EvaluateError> {
    match prediction {
        Prediction::DisparityFraction(fraction) => {
            scene.check_prediction("disparity", fraction)?;
            scene.score(|index| Some(scene.of_disparity(fraction[index])))
        }
        Prediction::DepthM(depth_m) => {
            scene.check_prediction("depth", depth_m)?;
            scene.score(|index| {
                (depth_m[index] != 0.0).then(|| Predicted {
                    depth_m: depth_m[index],
                    disparity_px: (scene.focal_baseline / f64::from(depth_m[index])) as f32,
                    floored: false,
                })
            })
        }
    }
}
