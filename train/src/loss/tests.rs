//! Golden values of the objectives and their hand-worked cases.

use burn::tensor::{Device, Tensor, TensorData};

use super::photometric::dssim_by_maps;
use super::sampler::sample_horizontal;
use super::*;
use crate::network::generator::SCALES;
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
    let expected = [
        ("ssim_left", 0.615_322_558),
        ("ssim_right", 0.605_491_470),
        ("l1_left", 0.444_052_733),
        ("l1_right", 0.422_871_029),
        ("left_right_left", 0.056_190_735),
        ("left_right_right", 0.055_385_264),
        ("smoothness_left", 0.007_936_193),
        ("smoothness_right", 0.007_932_031),
    ];
    assert_eq!(values.columns().count(), expected.len());
    for ((name, found), (expected_name, expected)) in values.columns().zip(expected) {
        assert_eq!(name, expected_name);
        assert_close(found, expected, 2e-6);
    }
    assert_close(values.both(Term::L1), 0.444_052_733 + 0.422_871_029, 4e-6);
    assert_close(values.total, 1.280_893_310, 4e-6);
    let (left, right, disparities) = closed_form();
    let terms = stereo_losses(left, right, &disparities, &Weights::STRAT);
    assert!(terms.levels[0][0][Term::Smoothness as usize].is_none());
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
    let disparities =
        std::array::from_fn(|level| tensor([1, 2, 24 >> level, 32 >> level], |_, _, _| 2.0 / 32.0));
    let terms = stereo_losses(left, right, &disparities, &Weights::STRAT);
    for side in &terms.levels[0] {
        let value = |term: Term| scalar(side[term as usize].as_ref().expect("computed"));
        assert_close(value(Term::L1), 0.0, 1e-6);
        assert_close(value(Term::Ssim), 0.0, 1e-5);
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
    let [[ssim_left, _], [l1_left, _], left_right, _] = values.by_view;
    assert_close(l1_left, 1.0, 1e-6);
    assert_close(ssim_left, 4.0 * 0.099_968_010, 1e-5);
    // |D_R - 0| for the left term, |0 - D_R| for the right one, at four scales.
    assert_eq!(left_right.map(|value| (value * 1e5).round()), [2e4, 2e4]);
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
