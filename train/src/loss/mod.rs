//! Training objectives (PROTOCOL 4.4): photometric, left-right and adversarial terms, and the
//! objective of the monodepth baseline.
//!
//! All reductions are means over batch, channels and pixels; the published weights presume that.
//! Photometric and left-right terms are taken at four scales and always at the full baseline; only
//! the fakes the discriminator sees are synthesised at a fraction of it.
//!
//! Not here: the discriminator, augmentation, schedules.

pub mod sampler;

use burn::tensor::Tensor;
use burn::tensor::activation::log_sigmoid;
use serde::{Deserialize, Serialize};

use crate::kernels;
use crate::loss::sampler::sample_horizontal;
use crate::network::generator::SCALES;

/// Weights of the terms; a term of weight 0 is not computed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Weights {
    /// Structural dissimilarity, at every scale.
    pub ssim: f64,
    /// Absolute colour difference, at every scale.
    pub l1: f64,
    /// Left-right consistency of the disparities, at every scale.
    pub left_right: f64,
    /// Horizontal smoothness of the disparities; halved at every coarser scale.
    pub smoothness: f64,
    /// Adversarial term of the generator, at full size.
    pub adversarial: f64,
}

impl Weights {
    /// The thesis: no smoothness.
    pub const STRAT: Self = Self {
        ssim: 1.0,
        l1: 0.1,
        left_right: 1.0,
        smoothness: 0.0,
        adversarial: 0.01,
    };

    /// The thesis without a discriminator.
    pub const PHOTOMETRIC: Self = Self {
        adversarial: 0.0,
        ..Self::STRAT
    };

    /// The monodepth baseline, with the horizontal smoothness term its released code has in effect.
    pub const MONODEPTH: Self = Self {
        ssim: 0.85,
        l1: 0.15,
        left_right: 1.0,
        smoothness: 0.1,
        adversarial: 0.0,
    };
}

impl Default for Weights {
    fn default() -> Self {
        Self::STRAT
    }
}

/// Terms of one view at one scale, unweighted, each `[1]`. A term of weight 0 is absent.
#[derive(Clone, Debug)]
pub struct SideTerms {
    /// Mean of clip((1 - SSIM) / 2, 0, 1).
    pub ssim: Option<Tensor<1>>,
    /// Mean absolute colour difference.
    pub l1: Option<Tensor<1>>,
    /// Mean absolute difference of the two views' disparities.
    pub left_right: Option<Tensor<1>>,
    /// Edge-aware horizontal smoothness, not yet divided by the scale.
    pub smoothness: Option<Tensor<1>>,
}

/// All stereo terms of a batch.
#[derive(Clone, Debug)]
pub struct Terms {
    /// Weighted sum of all terms, `[1]`: what is minimised, without the adversarial term.
    pub total: Tensor<1>,
    /// Left view, level 0 (full size) first.
    pub left: [SideTerms; SCALES],
    /// Right view.
    pub right: [SideTerms; SCALES],
}

/// The terms as numbers for logs: unweighted, summed over scales, both views apart.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TermValues {
    /// Weighted sum, without the adversarial term.
    pub total: f64,
    /// Structural dissimilarity of the left view.
    pub ssim_left: f64,
    /// Structural dissimilarity of the right view.
    pub ssim_right: f64,
    /// Absolute colour difference of the left view.
    pub l1_left: f64,
    /// Absolute colour difference of the right view.
    pub l1_right: f64,
    /// Left-right consistency, left term.
    pub left_right_left: f64,
    /// Left-right consistency, right term.
    pub left_right_right: f64,
    /// Smoothness of the left disparity, each scale divided by 2^s.
    pub smoothness_left: f64,
    /// Smoothness of the right disparity, each scale divided by 2^s.
    pub smoothness_right: f64,
}

impl Terms {
    /// Reads all terms from the device.
    pub fn values(&self) -> TermValues {
        let sum = |side: &[SideTerms; SCALES], pick: fn(&SideTerms) -> &Option<Tensor<1>>| {
            side.iter()
                .filter_map(|terms| pick(terms).as_ref())
                .map(scalar)
                .sum()
        };
        let smoothness = |side: &[SideTerms; SCALES]| {
            side.iter()
                .enumerate()
                .filter_map(|(level, terms)| {
                    let value = scalar(terms.smoothness.as_ref()?);
                    Some(value / f64::from(1_u32 << level))
                })
                .sum()
        };
        TermValues {
            total: scalar(&self.total),
            ssim_left: sum(&self.left, |t| &t.ssim),
            ssim_right: sum(&self.right, |t| &t.ssim),
            l1_left: sum(&self.left, |t| &t.l1),
            l1_right: sum(&self.right, |t| &t.l1),
            left_right_left: sum(&self.left, |t| &t.left_right),
            left_right_right: sum(&self.right, |t| &t.left_right),
            smoothness_left: smoothness(&self.left),
            smoothness_right: smoothness(&self.right),
        }
    }
}

/// The number in a tensor of one element.
pub fn scalar(tensor: &Tensor<1>) -> f64 {
    tensor
        .clone()
        .into_data()
        .iter::<f64>()
        .next()
        .unwrap_or(f64::NAN)
}

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
    kernels::dssim(&x, &y).unwrap_or_else(|| dssim_by_maps(x, y))
}

/// The same in burn's own operations, for every backend.
fn dssim_by_maps(x: Tensor<4>, y: Tensor<4>) -> Tensor<4> {
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
fn split(disparity: Tensor<4>) -> (Tensor<4>, Tensor<4>) {
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
    let per_level: [(SideTerms, SideTerms); SCALES] = std::array::from_fn(|level| {
        let (left, right) = (&lefts[level], &rights[level]);
        let (left_disparity, right_disparity) = split(disparities[level].clone());
        let left_offset = left_disparity.clone() * -1.0;
        (
            side(
                weights,
                Side {
                    target: left,
                    source: right,
                    offset: left_offset,
                    own: left_disparity.clone(),
                    other: right_disparity.clone(),
                },
            ),
            side(
                weights,
                Side {
                    target: right,
                    source: left,
                    offset: right_disparity.clone(),
                    own: right_disparity,
                    other: left_disparity,
                },
            ),
        )
    });

    let mut total: Option<Tensor<1>> = None;
    let mut add = |term: &Option<Tensor<1>>, weight: f64| {
        if let Some(term) = term {
            let weighted = term.clone() * weight;
            total = Some(match total.take() {
                Some(sum) => sum + weighted,
                None => weighted,
            });
        }
    };
    for (level, (left, right)) in per_level.iter().enumerate() {
        for terms in [left, right] {
            add(&terms.ssim, weights.ssim);
            add(&terms.l1, weights.l1);
            add(&terms.left_right, weights.left_right);
            add(
                &terms.smoothness,
                weights.smoothness / f64::from(1_u32 << level),
            );
        }
    }
    let total = total.unwrap_or_else(|| Tensor::zeros([1], &disparities[0].device()));
    let (left, right): (Vec<_>, Vec<_>) = per_level.into_iter().unzip();
    let levels = |terms: Vec<SideTerms>| match terms.try_into() {
        Ok(levels) => levels,
        Err(_) => unreachable!("one entry per scale"),
    };
    Terms {
        total,
        left: levels(left),
        right: levels(right),
    }
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

fn side(weights: &Weights, side: Side<'_>) -> SideTerms {
    let wanted = |weight: f64| weight != 0.0;
    let mut terms = SideTerms {
        ssim: None,
        l1: None,
        left_right: None,
        smoothness: None,
    };
    if wanted(weights.ssim) || wanted(weights.l1) {
        let synthesised = sample_horizontal(side.source.clone(), side.offset.clone());
        if wanted(weights.l1) {
            let difference = synthesised.clone() - side.target.clone();
            terms.l1 = Some(difference.abs().mean());
        }
        if wanted(weights.ssim) {
            terms.ssim = Some(dssim(synthesised, side.target.clone()).mean());
        }
    }
    if wanted(weights.left_right) {
        let seen = sample_horizontal(side.other, side.offset);
        terms.left_right = Some((seen - side.own.clone()).abs().mean());
    }
    if wanted(weights.smoothness) {
        terms.smoothness = Some(horizontal_smoothness(side.own, side.target.clone()));
    }
    terms
}

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

#[cfg(test)]
mod tests {
    use burn::tensor::{Device, TensorData};

    use super::*;
    use crate::network::layers::values_of;

    fn tensor(shape: [usize; 4], value: impl Fn(usize, f64, f64) -> f64) -> Tensor<4> {
        let [_, channels, height, width] = shape;
        let mut values = Vec::new();
        for c in 0..channels {
            for y in 0..height {
                values.extend((0..width).map(|x| value(c, y as f64, x as f64) as f32));
            }
        }
        Tensor::from_data(TensorData::new(values, shape), &Device::flex())
    }

    fn assert_close(found: f64, expected: f64, tolerance: f64) {
        assert!((found - expected).abs() < tolerance, "{found} {expected}");
    }

    /// Recipe: make_golden.py train/dssim: images `0.5 + 0.4 sin(0.9 x + 0.4 y + c)` and
    /// `0.5 + 0.4 sin(0.9 x + 0.5 y + 1.2 c + 0.3)`, 5 rows, 6 columns, 3 channels.
    #[test]
    fn dssim_agrees_with_the_reference() {
        let x = tensor([1, 3, 5, 6], |c, y, x| {
            0.5 + 0.4 * (0.9 * x + 0.4 * y + c as f64).sin()
        });
        let y = tensor([1, 3, 5, 6], |c, y, x| {
            0.5 + 0.4 * (0.9 * x + 0.5 * y + 1.2 * c as f64 + 0.3).sin()
        });
        let expected = [
            0.177_075_697,
            0.039_373_993,
            0.024_520_407,
            0.090_668_439,
            0.161_997_212,
            0.031_380_726,
            0.064_396_043,
            0.252_697_16,
            0.084_674_659,
            0.050_989_506,
            0.182_522_405,
            0.225_969_612,
            0.058_381_852,
            0.063_997_194,
            0.254_475_405,
            0.161_268_219,
            0.057_089_778,
            0.157_219_921,
            0.388_304_828,
            0.106_565_068,
            0.106_858_377,
            0.384_177_618,
            0.256_904_98,
            0.080_597_581,
            0.138_128_193,
            0.465_547_17,
            0.190_344_541,
            0.073_599_403,
            0.317_247_091,
            0.432_726_711,
            0.127_746_186,
            0.135_877_261,
            0.589_738_731,
            0.270_524_293,
            0.110_954_385,
            0.360_220_903,
        ];
        let found = dssim(x, y);
        assert_eq!(found.dims(), [1, 3, 3, 4]);
        for (found, expected) in values_of(found).iter().zip(expected) {
            assert_close(f64::from(*found), expected, 1e-6);
        }
    }

    #[test]
    fn the_form_for_every_backend_gives_the_same_values_and_gradients() {
        let run = |function: fn(Tensor<4>, Tensor<4>) -> Tensor<4>| {
            let leaf = |phase: f64| {
                tensor([1, 2, 7, 9], |c, y, x| {
                    0.5 + 0.45 * (0.9 * x + 0.4 * y * y + c as f64 + phase).sin()
                })
                .autodiff()
                .require_grad()
            };
            let (x, y) = (leaf(0.0), leaf(0.7));
            let weights = tensor([1, 2, 5, 7], |c, y, x| (x + 3.0 * y) % 5.0 - 2.0 + c as f64);
            let found = function(x.clone(), y.clone());
            let gradients = (found.clone() * weights.autodiff()).sum().backward();
            [
                values_of(found.inner()),
                values_of(x.grad(&gradients).expect("a gradient")),
                values_of(y.grad(&gradients).expect("a gradient")),
            ]
            .concat()
        };
        for (found, expected) in run(dssim).iter().zip(run(dssim_by_maps)) {
            assert!((found - expected).abs() < 2e-5, "{found} {expected}");
        }
    }

    #[test]
    fn dssim_of_flat_images_is_the_luminance_term() {
        let flat = |value| tensor([1, 1, 3, 3], |_, _, _| value);
        assert_close(
            f64::from(values_of(dssim(flat(0.5), flat(0.5)))[0]),
            0.0,
            1e-6,
        );
        // (1 - (2 * 0.125 + 0.0001) / (0.3125 + 0.0001)) / 2
        let found = f64::from(values_of(dssim(flat(0.25), flat(0.5)))[0]);
        assert_close(found, 0.099_968_010, 1e-6);
    }

    #[test]
    fn pyramid_levels_are_block_means() {
        let image = tensor([1, 1, 8, 16], |_, y, x| y * 16.0 + x);
        let levels = area_pyramid(image);
        assert_eq!(levels[3].dims(), [1, 1, 1, 2]);
        // Mean row 3.5, mean columns 3.5 and 11.5.
        assert_eq!(values_of(levels[3].clone()), [59.5, 67.5]);
        assert_eq!(values_of(levels[1].clone())[..2], [8.5, 10.5]);
    }

    fn closed_form() -> (Tensor<4>, Tensor<4>, [Tensor<4>; SCALES]) {
        let image = |phase: f64| {
            tensor([1, 3, 32, 64], move |c, y, x| {
                let c = c as f64;
                0.5 + 0.3 * (0.35 * x + 0.2 * y + c + phase).sin()
                    + 0.1 * (0.15 * x * (c + 1.0) - 0.4 * y).cos()
            })
        };
        let disparities = std::array::from_fn(|level| {
            let scale = f64::from(1_u32 << level);
            tensor([1, 2, 32 >> level, 64 >> level], move |c, y, x| {
                0.04 + 0.03 * (0.5 * x * scale / 4.0 + 0.3 * y + c as f64).sin()
            })
        });
        (image(0.0), image(0.8), disparities)
    }

    /// Recipe: make_golden.py train/losses, for the images and disparities of `closed_form`.
    #[test]
    fn terms_agree_with_the_reference() {
        let (left, right, disparities) = closed_form();
        let values = stereo_losses(left, right, &disparities, &Weights::MONODEPTH).values();
        for (found, expected) in [
            (values.ssim_left, 0.615_322_558),
            (values.ssim_right, 0.605_491_470),
            (values.l1_left, 0.444_052_733),
            (values.l1_right, 0.422_871_029),
            (values.left_right_left, 0.056_190_735),
            (values.left_right_right, 0.055_385_264),
            (values.smoothness_left, 0.007_936_193),
            (values.smoothness_right, 0.007_932_031),
        ] {
            assert_close(found, expected, 2e-6);
        }
        assert_close(values.total, 1.280_893_310, 4e-6);
        let (left, right, disparities) = closed_form();
        let terms = stereo_losses(left, right, &disparities, &Weights::STRAT);
        assert!(terms.left[0].smoothness.is_none());
        assert_close(terms.values().total, 1.419_082_403, 4e-6);
    }

    #[test]
    fn true_disparities_explain_both_views() {
        // Two pixels of disparity; what the other camera cannot see is black in both images.
        let left = tensor([1, 3, 24, 32], |c, y, x| {
            if x < 2.0 {
                0.0
            } else {
                0.5 + 0.4 * (x + 2.0 * y + c as f64).sin()
            }
        });
        let right = sample_horizontal(left.clone(), tensor([1, 1, 24, 32], |_, _, _| 2.0 / 32.0));
        let disparities = std::array::from_fn(|level| {
            tensor([1, 2, 24 >> level, 32 >> level], |_, _, _| 2.0 / 32.0)
        });
        let terms = stereo_losses(left, right, &disparities, &Weights::STRAT);
        for side in [&terms.left[0], &terms.right[0]] {
            assert_close(scalar(side.l1.as_ref().expect("computed")), 0.0, 1e-6);
            assert_close(scalar(side.ssim.as_ref().expect("computed")), 0.0, 1e-5);
        }
    }

    #[test]
    fn constant_images_give_hand_worked_terms() {
        let flat = |value| tensor([1, 3, 32, 32], move |_, _, _| value);
        let disparities = std::array::from_fn(|level| {
            // Left 0, right 0.05.
            tensor([1, 2, 32 >> level, 32 >> level], |c, _, _| 0.05 * c as f64)
        });
        let left_zero = stereo_losses(flat(0.5), flat(0.25), &disparities, &Weights::STRAT);
        let values = left_zero.values();
        // The left view is the right image unmoved: |0.25 - 0.5| at four scales.
        assert_close(values.l1_left, 1.0, 1e-6);
        assert_close(values.ssim_left, 4.0 * 0.099_968_010, 1e-5);
        // |D_R - 0| for the left term, |0 - D_R| for the right one, at four scales.
        assert_close(values.left_right_left, 0.2, 1e-6);
        assert_close(values.left_right_right, 0.2, 1e-6);
    }

    #[test]
    fn smoothness_is_horizontal_and_weaker_at_edges() {
        let disparity = tensor([1, 1, 1, 4], |_, _, x| [0.0, 0.1, 0.1, 0.3][x as usize]);
        let image = tensor([1, 3, 1, 4], |_, _, x| if x > 2.0 { 1.0 } else { 0.0 });
        let found = scalar(&horizontal_smoothness(disparity, image));
        assert_close(found, (0.1 + 0.2 * (-1.0_f64).exp()) / 3.0, 1e-7);
        let vertical = tensor([1, 1, 4, 4], |_, y, _| y);
        let image = tensor([1, 3, 4, 4], |_, _, _| 0.0);
        assert_close(scalar(&horizontal_smoothness(vertical, image)), 0.0, 1e-9);
    }

    #[test]
    fn fakes_move_with_the_baseline() {
        let left = tensor([1, 3, 2, 16], |c, y, x| (x + y + c as f64) / 20.0);
        let right = tensor([1, 3, 2, 16], |c, y, x| (x * 0.5 + y + c as f64) / 20.0);
        // Left 2 pixels, right 4 pixels.
        let disparity = tensor([1, 2, 2, 16], |c, _, _| 2.0 * (c + 1) as f64 / 16.0);
        let fakes = |b| synthesize(left.clone(), right.clone(), disparity.clone(), b);
        let (fake_right, fake_left) = fakes(0.0);
        assert_eq!(values_of(fake_right), values_of(left.clone()));
        assert_eq!(values_of(fake_left), values_of(right.clone()));
        let (fake_right, fake_left) = fakes(0.5);
        assert_eq!(
            values_of(fake_right.narrow(3, 0, 14)),
            values_of(left.clone().narrow(3, 2, 14))
        );
        assert_eq!(
            values_of(fake_left.narrow(3, 1, 15)),
            values_of(right.clone().narrow(3, 0, 15))
        );
    }

    #[test]
    fn adversarial_terms_are_stable_logarithms() {
        let logits = |value: f64| tensor([1, 1, 2, 2], move |_, _, _| value);
        let ln2 = std::f64::consts::LN_2;
        assert_close(scalar(&generator_adversarial(logits(0.0))), ln2, 1e-6);
        assert_close(scalar(&generator_adversarial(logits(-200.0))), 200.0, 1e-3);
        assert_close(scalar(&generator_adversarial(logits(200.0))), 0.0, 1e-6);
        let d = |real, fake| scalar(&discriminator_adversarial(logits(real), logits(fake)));
        assert_close(d(0.0, 0.0), 2.0 * ln2, 1e-6);
        assert_close(d(200.0, -200.0), 0.0, 1e-6);
        assert_close(d(-200.0, 200.0), 400.0, 1e-3);
        // ln(1 + exp(-1)) + ln(1 + exp(-2))
        assert_close(d(1.0, -2.0), 0.313_261_688 + 0.126_928_011, 1e-6);
    }
}
