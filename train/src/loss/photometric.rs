//! Photometric, left-right and smoothness terms of both views at all scales.

use burn::tensor::Tensor;

use super::sampler::sample_horizontal;
use super::terms::{SideTerms, Term, Terms, Weights};
use crate::kernels;
use crate::network::generator::SCALES;

/// Block means: level `s` of `[n, c, h, w]` is `[n, c, h / 2^s, w / 2^s]`, level 0 the image itself.
///
/// Height and width must be multiples of 8.
pub fn area_pyramid(image: Tensor<4>) -> [Tensor<4>; SCALES] {
    let mut level = image;
    std::array::from_fn(|index| {
        if index > 0 {
            level = halve(level.clone());
        }
        level.clone()
    })
}

/// Means over blocks of 2x2.
fn halve(image: Tensor<4>) -> Tensor<4> {
    let [batch, channels, height, width] = image.dims();
    image
        .reshape([batch * channels, height / 2, 2, width / 2, 2])
        .mean_dims(&[2, 4])
        .reshape([batch, channels, height / 2, width / 2])
}

/// clip((1 - SSIM) / 2, 0, 1) for every 3x3 window that lies inside the image, `[n, c, h - 2, w - 2]`.
///
/// Uniform windows, biased variances, C1 = 0.01^2, C2 = 0.03^2, images in 0..1.
pub fn dssim(x: Tensor<4>, y: Tensor<4>) -> Tensor<4> {
    kernels::dssim::dssim(&x, &y).unwrap_or_else(|| dssim_by_maps(x, y))
}

/// The same in burn's own operations, for every backend.
pub(super) fn dssim_by_maps(x: Tensor<4>, y: Tensor<4>) -> Tensor<4> {
    const C1: f64 = 0.01 * 0.01;
    const C2: f64 = 0.03 * 0.03;
    // Variances do not change when a constant is subtracted, but their rounding errors do: the mean
    // of the square of a centred value is much closer to the variance it is part of.
    const MIDDLE: f64 = 0.5;
    let (x, y) = (x - MIDDLE, y - MIDDLE);
    let mean_x = window_mean(x.clone());
    let mean_y = window_mean(y.clone());
    let variance_x = window_mean(x.clone() * x.clone()) - mean_x.clone() * mean_x.clone();
    let variance_y = window_mean(y.clone() * y.clone()) - mean_y.clone() * mean_y.clone();
    let covariance = window_mean(x * y) - mean_x.clone() * mean_y.clone();
    let (mean_x, mean_y) = (mean_x + MIDDLE, mean_y + MIDDLE);
    let squares = mean_x.clone() * mean_x.clone() + mean_y.clone() * mean_y.clone();
    let ssim = ((mean_x * mean_y * 2.0 + C1) * (covariance * 2.0 + C2))
        / ((squares + C1) * (variance_x + variance_y + C2));
    ((ssim * -1.0 + 1.0) * 0.5).clamp(0.0, 1.0)
}

/// Means over all 3x3 windows inside the image.
fn window_mean(image: Tensor<4>) -> Tensor<4> {
    let [_, _, height, width] = image.dims();
    let row = |first: usize| image.clone().narrow(2, first, height - 2);
    let rows = row(0) + row(1) + row(2);
    let column = |first: usize| rows.clone().narrow(3, first, width - 2);
    (column(0) + column(1) + column(2)) * (1.0 / 9.0)
}

/// Edge-aware horizontal smoothness: mean |dx d| exp(-mean over colours |dx I|).
///
/// `disparity` is `[n, 1, h, w]`, `image` `[n, 3, h, w]`.
pub fn horizontal_smoothness(disparity: Tensor<4>, image: Tensor<4>) -> Tensor<1> {
    let step = |map: Tensor<4>| {
        let [_, _, _, width] = map.dims();
        (map.clone().narrow(3, 0, width - 1) - map.narrow(3, 1, width - 1)).abs()
    };
    let weight = (step(image).mean_dim(1) * -1.0).exp();
    (step(disparity) * weight).mean()
}

/// Left and right disparity of a head's output `[n, 2, h, w]`, each `[n, 1, h, w]`.
pub(super) fn split(disparity: Tensor<4>) -> (Tensor<4>, Tensor<4>) {
    (disparity.clone().narrow(1, 0, 1), disparity.narrow(1, 1, 1))
}

/// Photometric, left-right and smoothness terms of both views at all scales.
///
/// `left` and `right` are `[n, 3, h, w]` in 0..1, `disparities` what the generator returned for
/// `left`. The adversarial term is separate: it has its own inputs.
pub fn stereo_losses(
    left: Tensor<4>,
    right: Tensor<4>,
    disparities: &[Tensor<4>; SCALES],
    weights: &Weights,
) -> Terms {
    let lefts = area_pyramid(left);
    let rights = area_pyramid(right);
    let levels = std::array::from_fn(|level| {
        let (left, right) = (&lefts[level], &rights[level]);
        let (left_disparity, right_disparity) = split(disparities[level].clone());
        let of_left = Side {
            target: left,
            source: right,
            offset: left_disparity.clone() * -1.0,
            own: left_disparity.clone(),
            other: right_disparity.clone(),
        };
        let of_right = Side {
            target: right,
            source: left,
            offset: right_disparity.clone(),
            own: right_disparity,
            other: left_disparity,
        };
        [of_left.terms(weights), of_right.terms(weights)]
    });
    Terms::new(levels, weights, &disparities[0].device())
}

/// What the terms of one view need.
struct Side<'a> {
    target: &'a Tensor<4>,
    source: &'a Tensor<4>,
    /// Signed displacement that turns `source` into `target`.
    offset: Tensor<4>,
    /// Disparity on the grid of `target`.
    own: Tensor<4>,
    /// Disparity on the grid of `source`.
    other: Tensor<4>,
}

impl Side<'_> {
    fn terms(self, weights: &Weights) -> SideTerms {
        let wanted = |term| weights.of(term) != 0.0;
        let mut terms = SideTerms::default();
        if wanted(Term::Ssim) || wanted(Term::L1) {
            let synthesised = sample_horizontal(self.source.clone(), self.offset.clone());
            if wanted(Term::L1) {
                let difference = synthesised.clone() - self.target.clone();
                terms[Term::L1 as usize] = Some(difference.abs().mean());
            }
            if wanted(Term::Ssim) {
                let dissimilarity = dssim(synthesised, self.target.clone());
                terms[Term::Ssim as usize] = Some(dissimilarity.mean());
            }
        }
        if wanted(Term::LeftRight) {
            let seen = sample_horizontal(self.other, self.offset);
            terms[Term::LeftRight as usize] = Some((seen - self.own.clone()).abs().mean());
        }
        if wanted(Term::Smoothness) {
            let smoothness = horizontal_smoothness(self.own, self.target.clone());
            terms[Term::Smoothness as usize] = Some(smoothness);
        }
        terms
    }
}
