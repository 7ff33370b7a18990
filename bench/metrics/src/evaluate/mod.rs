//! Scores one image under a [`Protocol`].
//!
//! Order of steps, PROTOCOL 3.3 to 3.6, 3.9 and 10: floor the disparity, turn it into depth, choose
//! the pixels, align with the truth if the protocol says so, clip, measure. Predictions arrive at
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
//! `truth` is what is known of an image, `scene` what a pixel is, `pixels` which ones count, `alignment` the
//! fit, `score` the steps, `scratch` what several protocols need not find twice. Not here: flip post-processing,
//! see [`flip_blend`](crate::flip_blend).

#[cfg(test)]
mod aligned_tests;
mod alignment;
mod error;
#[cfg(test)]
mod models_tests;
mod pixels;
mod prediction;
mod scene;
mod score;
mod scratch;
mod tallies;
#[cfg(test)]
mod tests;
mod truth;

pub use alignment::Fit;
pub use error::EvaluateError;
pub use prediction::Prediction;
pub use score::{Compared, ComparedPixel, ImageScore};
pub use scratch::Scratch;
pub use truth::{GroundTruth, TruthRows};

use crate::protocol::Protocol;
use scene::{Places, Scene};

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
    let prediction = Prediction::DisparityFraction(disparity_fraction);
    evaluate_prediction(protocol, truth, prediction, false)
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
    evaluate_prediction(protocol, truth, Prediction::DepthM(depth_m), false)
}

/// Scores any prediction, if wanted with the `further` metrics of PROTOCOL 10.3.
///
/// # Errors
/// As for [`evaluate_depth`], a prediction that the protocol's alignment does not fit, and values from
/// which no fit follows.
pub fn evaluate_prediction(
    protocol: &Protocol,
    truth: &GroundTruth,
    prediction: Prediction<'_>,
    further: bool,
) -> Result<Vec<ImageScore>, EvaluateError> {
    let scene = Scene::new(protocol, truth, prediction, Places::All)?;
    Ok(scene.score(further, &mut Scratch::default(), false)?.scores)
}

/// Scores a prediction as [`evaluate_prediction`] does, of which there is a value for each
/// [measured](GroundTruth::measured) pixel alone, in their order. `scratch` is that of the image: what one
/// protocol finds, the next need not find again.
///
/// # Errors
/// As for [`evaluate_prediction`].
///
/// # Panics
/// If there are more or fewer values than measured pixels.
pub fn evaluate_measured(
    protocol: &Protocol,
    truth: &GroundTruth,
    prediction: Prediction<'_>,
    further: bool,
    scratch: &mut Scratch,
) -> Result<Vec<ImageScore>, EvaluateError> {
    let scene = Scene::new(protocol, truth, prediction, Places::Measured)?;
    Ok(scene.score(further, scratch, false)?.scores)
}

/// Scores a prediction as [`evaluate_prediction`] does, and hands out what was compared.
///
/// # Errors
/// As for [`evaluate_prediction`].
pub fn evaluate_with_pixels(
    protocol: &Protocol,
    truth: &GroundTruth,
    prediction: Prediction<'_>,
    further: bool,
) -> Result<(Vec<ImageScore>, Compared), EvaluateError> {
    let scene = Scene::new(protocol, truth, prediction, Places::All)?;
    let scored = scene.score(further, &mut Scratch::default(), true)?;
    Ok(scored.with_pixels(&scene))
}
