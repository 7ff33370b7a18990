//! What the discriminator and the generator play for: the synthesised views and both objectives.

use burn::tensor::Tensor;
use burn::tensor::activation::log_sigmoid;

use super::photometric::split;
use super::sampler::sample_horizontal;

/// The generated views at the fraction `baseline_fraction` of the baseline (equation 3.4):
/// `(right, left)`, each `[n, 3, h, w]`.
///
/// `disparity` is level 0 of the generator's output, `[n, 2, h, w]`. At fraction 1 these are the
/// views the photometric terms compare; at fraction 0 they are the source images themselves.
pub fn synthesize(
    left: Tensor<4>,
    right: Tensor<4>,
    disparity: Tensor<4>,
    baseline_fraction: f64,
) -> (Tensor<4>, Tensor<4>) {
    let (left_disparity, right_disparity) = split(disparity);
    (
        sample_horizontal(left, right_disparity * baseline_fraction),
        sample_horizontal(right, left_disparity * -baseline_fraction),
    )
}

/// Adversarial term of the generator (equation 3.5): mean of -ln C(fake), from logits.
pub fn generator_adversarial(fake_logits: Tensor<4>) -> Tensor<1> {
    log_sigmoid(fake_logits).mean() * -1.0
}

/// Objective of the discriminator (equation 3.3), to be minimised:
/// mean of -ln C(real) plus mean of -ln (1 - C(fake)), from logits.
pub fn discriminator_adversarial(real_logits: Tensor<4>, fake_logits: Tensor<4>) -> Tensor<1> {
    (log_sigmoid(real_logits).mean() + log_sigmoid(fake_logits * -1.0).mean()) * -1.0
}
