//! View synthesis: sampling an image along its rows (PROTOCOL 4.3).
//!
//! `out(y, x) = source(y, x + width * offset)`, linear between neighbouring columns. The right view
//! is `sample(left, +right disparity)`, the left view `sample(right, -left disparity)`. Columns -1
//! and `width` are black and coordinates are clamped to that range, so an image fades out over one
//! pixel at either side. Gradients reach the offset through both taps, and the source.
//!
//! Not here: vertical displacement, other interpolation kernels.

use burn::tensor::ops::PadMode;
use burn::tensor::{Int, Tensor};

use crate::kernels::sampler;

/// Samples `source`, `[n, c, h, w]`, at columns displaced by `offset_fraction`, `[n, 1, h, w]`, a
/// fraction of the width.
///
/// The result has the shape of `source`.
pub fn sample_horizontal(source: Tensor<4>, offset_fraction: Tensor<4>) -> Tensor<4> {
    sampler::sample_horizontal(&source, &offset_fraction)
        .unwrap_or_else(|| by_gathering(source, offset_fraction))
}

/// The same in burn's own operations, for every backend.
fn by_gathering(source: Tensor<4>, offset_fraction: Tensor<4>) -> Tensor<4> {
    let [batch, channels, height, width] = source.dims();
    let device = source.device();
    // Column numbers in the padded image, where the first real column is 1.
    let columns = Tensor::<1, Int>::arange(1..width as i64 + 1, &device)
        .float()
        .reshape([1, 1, 1, width]);
    let position = (offset_fraction * width as f64 + columns).clamp(0.0, (width + 1) as f64);
    let floor = position.clone().detach().floor();
    let fraction = position - floor.clone();
    let first = floor.int();
    let second = (first.clone() + 1).clamp_max(width as i64 + 1);
    let padded = source.pad([(0, 0), (1, 1)], PadMode::Constant(0.0));
    let tap = |index: Tensor<4, Int>| {
        padded
            .clone()
            .gather(3, index.expand([batch, channels, height, width]))
    };
    let (low, high) = (tap(first), tap(second));
    low.clone() + fraction * (high - low)
}

#[cfg(test)]
mod tests {
    use burn::tensor::{Device, TensorData};

    use super::*;
    use crate::network::layers::values_of;

    fn tensor(shape: [usize; 4], value: impl Fn(usize, usize, usize) -> f64) -> Tensor<4> {
        let [_, channels, height, width] = shape;
        let mut values = Vec::new();
        for c in 0..channels {
            for y in 0..height {
                values.extend((0..width).map(|x| value(c, y, x) as f32));
            }
        }
        Tensor::from_data(TensorData::new(values, shape), &Device::flex())
    }

    /// Recipe: make_golden.py train/sampler: source `0.5 + 0.5 sin(0.7 x + 1.3 y + 2.1 c)`, offset
    /// `0.45 sin(1.1 x - 0.6 y)`, 4 rows, 6 columns, 2 channels.
    #[test]
    fn agrees_with_the_reference() {
        let source = tensor([1, 2, 4, 6], |c, y, x| {
            0.5 + 0.5 * (0.7 * x as f64 + 1.3 * y as f64 + 2.1 * c as f64).sin()
        });
        let offset = tensor([1, 1, 4, 6], |_, y, x| {
            0.45 * (1.1 * x as f64 - 0.6 * y as f64).sin()
        });
        let expected = [
            0.5,
            0.824_307_141,
            0.604_766_468,
            0.957_636_586,
            0.895_588_796,
            0.906_503_315,
            0.0,
            0.613_147_256,
            0.028_703_219,
            0.077_170_718,
            0.594_867_257,
            0.595_074_096,
            0.0,
            0.511_864_102,
            0.193_931_257,
            0.273_703_512,
            0.095_716_488,
            0.057_615_206,
            0.0,
            0.040_685_981,
            0.377_887_973,
            0.291_227_205,
            0.577_346_148,
            0.555_117_129,
            0.931_604_683,
            0.041_689_708,
            0.040_896_726,
            0.175_118_369,
            0.519_821_987,
            0.058_943_184,
            0.0,
            0.044_704_704,
            0.689_609_707,
            0.509_368_461,
            0.052_483_951,
            0.052_395_929,
            0.0,
            0.083_002_407,
            0.969_371_309,
            0.649_499_162,
            0.934_019_461,
            0.586_898_313,
            0.0,
            0.093_896_572,
            0.975_045_426,
            0.141_854_956,
            0.281_221_71,
            0.875_335_036,
        ];
        let found = values_of(sample_horizontal(source, offset));
        assert_eq!(found.len(), expected.len());
        for (found, expected) in found.iter().zip(expected) {
            assert!(
                (f64::from(*found) - expected).abs() < 1e-6,
                "{found} {expected}"
            );
        }
    }

    #[test]
    fn a_zero_offset_is_the_identity_and_whole_pixels_shift() {
        let source = tensor([1, 3, 2, 8], |c, y, x| (c * 16 + y * 8 + x) as f64 / 48.0);
        let offset = |pixels: f64| tensor([1, 1, 2, 8], |_, _, _| pixels / 8.0);
        let same = values_of(sample_horizontal(source.clone(), offset(0.0)));
        assert_eq!(same, values_of(source.clone()));
        let shifted = sample_horizontal(source.clone(), offset(2.0));
        let kept = values_of(shifted.clone().narrow(3, 0, 6));
        assert_eq!(kept, values_of(source.narrow(3, 2, 6)));
        assert!(values_of(shifted.narrow(3, 6, 2)).iter().all(|&v| v == 0.0));
    }

    #[test]
    fn offsets_that_are_no_numbers_do_not_panic() {
        let source = tensor([1, 1, 1, 4], |_, _, x| x as f64);
        for wrong in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e30] {
            let sampled = sample_horizontal(source.clone(), tensor([1, 1, 1, 4], |_, _, _| wrong));
            assert_eq!(sampled.dims(), [1, 1, 1, 4]);
        }
    }

    #[test]
    fn the_form_for_every_backend_gives_the_same_values_and_gradients() {
        let device = Device::flex().autodiff();
        let leaf = |map: Tensor<4>| map.autodiff().require_grad();
        let run = |function: fn(Tensor<4>, Tensor<4>) -> Tensor<4>| {
            let source = leaf(tensor([1, 2, 4, 6], |c, y, x| {
                (0.7 * x as f64 + 1.3 * y as f64 + 2.1 * c as f64).sin()
            }));
            let offset = leaf(tensor([1, 1, 4, 6], |_, y, x| {
                0.45 * (1.1 * x as f64 - 0.6 * y as f64 + 0.1).sin()
            }));
            let weights = tensor([1, 2, 4, 6], |c, y, x| {
                ((c + 2 * y + 5 * x) % 7) as f64 - 3.0
            });
            let sampled = function(source.clone(), offset.clone());
            let gradients = (sampled.clone() * weights.to_device(&device))
                .sum()
                .backward();
            [
                values_of(sampled.inner()),
                values_of(source.grad(&gradients).expect("a gradient")),
                values_of(offset.grad(&gradients).expect("a gradient")),
            ]
            .concat()
        };
        for (found, expected) in run(sample_horizontal).iter().zip(run(by_gathering)) {
            assert!((found - expected).abs() < 2e-5, "{found} {expected}");
        }
    }
}
