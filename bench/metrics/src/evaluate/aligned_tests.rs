//! Models without a scale: values of the oracle, and what does not fit.

use super::{EvaluateError, Fit, GroundTruth, ImageScore, Prediction, evaluate_prediction};
use crate::protocol::{
    Alignment, BenchmarkCrop, Crop, KnownCamera, Protocol, StereoCamera, protocol,
};

pub(super) const WIDTH: usize = 1242;
pub(super) const HEIGHT: usize = 375;

pub(super) fn truth_of(size: (usize, usize), depth_m: Vec<f32>) -> GroundTruth {
    let calibration = StereoCamera {
        focal_px: 721.5377,
        baseline_m: 0.532_725_428,
    };
    let camera = KnownCamera {
        calibration,
        nominal_focal_px: None,
    };
    GroundTruth::new(size, &depth_m, camera).unwrap()
}

/// A map by its formula in rows and columns.
pub(super) fn map(value: impl Fn(f64, f64) -> f64) -> Vec<f32> {
    (0..WIDTH * HEIGHT)
        .map(|i| value((i / WIDTH) as f64, (i % WIDTH) as f64) as f32)
        .collect()
}

/// The closed formulas of the recipe: truth, inverse depth and depth in no unit.
fn scene() -> (GroundTruth, Vec<f32>, Vec<f32>) {
    let depth_m: Vec<f32> = (0..HEIGHT * WIDTH)
        .map(|i| {
            let (y, x) = (i / WIDTH, i % WIDTH);
            if y <= 120 || (x * 7 + y * 13) % 5 != 0 {
                return 0.0;
            }
            let (y, x) = (y as f64, x as f64);
            let px = 5.0 + 76.0 * (y - 120.0) / 255.0 + 2.0 * (x / 40.0).sin();
            384.38148_f32 / (((px * 256.0).floor() / 256.0) as f32) + 0.27
        })
        .collect();
    let smooth = |y: f64| 384.38148 / (5.0 + 76.0 * (y - 120.0).max(0.0) / 255.0);
    let wobble = |y: f64, x: f64| 1.0 + 0.06 * (x / 29.0).sin() * (y / 19.0).cos();
    let inverse = map(|y, x| {
        let is_hole = (210.0..214.0).contains(&y) && (400.0..410.0).contains(&x);
        if is_hole {
            0.0
        } else {
            250.0 * wobble(y, x) / smooth(y) + 9.0
        }
    });
    let depth = map(|y, x| 0.02 * smooth(y) * wobble(y, x) + 0.3);
    (truth_of((WIDTH, HEIGHT), depth_m), inverse, depth)
}

/// All numbers of a score in the order of the recipe.
pub(super) fn numbers(score: &ImageScore) -> Vec<f64> {
    // Without alignment depth is what it is.
    let fit = score.fit.unwrap_or(Fit {
        scale: 1.0,
        shift: 0.0,
    });
    let further = score.further.unwrap().to_array();
    [
        &score.metrics.to_array()[..],
        &further,
        &[fit.scale, fit.shift],
    ]
    .concat()
}

/// Recipe: make_golden.py align/image.
#[test]
fn aligned_figures_of_the_oracle() {
    let (truth, inverse, depth) = scene();
    let rules = |name: &str, crop, limits: (f64, f64), benchmark_crop| Protocol {
        crop,
        min_depth_m: limits.0,
        max_depth_m: limits.1,
        benchmark_crop,
        ..protocol(name).unwrap()
    };
    let (inverse, depth) = (
        Prediction::InverseDepth(&inverse),
        Prediction::Depth(&depth),
    );
    let cut = BenchmarkCrop::ImageAndTruth;
    #[rustfmt::skip]
    let cases = [
        (rules("eigen-80-affine-disparity", Crop::Eigen, (1e-5, 80.0), cut), inverse, [
            0.0449265826193498, 0.12498397754593704, 1.5410635640345973, 0.06267036628505952,
            0.9973080346481992, 0.9998263248160129, 0.9998263248160129, 6.259506091403086,
            0.019403060059148936, 4.6819836773306545, 0.6988390762754563, 0.008113660392661362,
            0.003761042603768902, -0.03089970444942533]),
        (rules("eigen-80-affine-depth", Crop::Eigen, (1e-5, 80.0), cut), depth, [
            0.045665196177800786, 0.06374860480773628, 1.2135459765776166, 0.05829300629089672,
            1.0, 1.0, 1.0, 5.82832586880496,
            0.019793763879088263, 4.709642481709472, 0.7072591006064625, 0.003421516094114571,
            50.4256785163462, -14.91755151939652]),
        (rules("eigen-80-scale-disparity", Crop::Garg, (1e-3, 80.0), BenchmarkCrop::None), inverse, [
            0.08754372276509778, 0.327764782646898, 2.513471788682797, 0.13947308642019748,
            0.8821586998468302, 0.9895764953949593, 0.9998408625251138, 12.669609545443386,
            0.04104105549100089, 10.148410984768704, 1.2924844834099096, 0.019084144091151705,
            0.0030443694090374735, 0.0]),
        (rules("eigen-80-scale-depth", Crop::Garg, (1e-3, 50.0), BenchmarkCrop::None), depth, [
            0.29407224791192504, 0.9246935371189006, 3.074524357414004, 0.29973085653168824,
            0.44059199140657634, 0.8540112589763482, 1.0, 26.254736550145964,
            0.11211252043598742, 38.152429237810836, 2.5364670694741593, 0.1255704044545918,
            21.775160060703637, 0.0]),
        (rules("eigen-80-median", Crop::None, (1e-3, 80.0), BenchmarkCrop::None), depth, [
            0.2609737989378353, 1.8361058391226996, 8.208193836243447, 0.33658645756253036,
            0.43425964330153466, 0.8499505471716172, 0.9546310180901637, 33.226913905526835,
            0.12027556412963208, 30.256170013794925, 4.49910873544116, 0.09168067215669391,
            19.197470708201703, 0.0]),
    ];
    for (protocol, prediction, expected) in cases {
        let scores = evaluate_prediction(&protocol, &truth, prediction, true).unwrap();
        assert_eq!(scores.len(), 1);
        for (index, (found, expected)) in numbers(&scores[0]).into_iter().zip(expected).enumerate()
        {
            assert!(
                (found - expected).abs() <= 1e-6 * expected.abs(),
                "{} {index}: {found} is not {expected}",
                protocol.name
            );
        }
        // The further metrics cost the seven nothing.
        let plain = evaluate_prediction(&protocol, &truth, prediction, false).unwrap();
        assert_eq!(
            (plain[0].metrics, plain[0].further),
            (scores[0].metrics, None)
        );
    }
}

/// Disparity, depth in metres and inverse depth are all inverse depth to an alignment of it.
#[test]
fn metric_predictions_take_any_alignment() {
    let depth_m: Vec<f32> = (0..64 * 32).map(|i| 5.0 + (i % 37) as f32).collect();
    let truth = truth_of((64, 32), depth_m.clone());
    let disparity: Vec<f32> = depth_m.iter().map(|d| 0.4 / d).collect();
    let of_depth: Vec<f32> = depth_m.iter().map(|d| 3.0 * d).collect();
    for alignment in Alignment::ALL.into_iter().skip(1) {
        let rules = Protocol {
            alignment,
            crop: Crop::None,
            ..protocol("eigen-80").unwrap()
        };
        for prediction in [
            Prediction::DisparityFraction(&disparity),
            Prediction::DepthM(&of_depth),
        ] {
            let score = evaluate_prediction(&rules, &truth, prediction, false).unwrap()[0];
            assert!(score.metrics.abs_rel < 1e-6, "{alignment}: {score:?}");
            assert!(score.fit.unwrap().scale > 0.0);
        }
    }
}

#[test]
fn what_an_alignment_does_not_fit_is_refused_with_what_does() {
    let truth = truth_of((2, 1), vec![5.0, 7.0]);
    let values = [1.0, 2.0];
    let message = |name: &str, prediction| {
        let rules = Protocol {
            crop: Crop::None,
            ..protocol(name).unwrap()
        };
        evaluate_prediction(&rules, &truth, prediction, false)
            .unwrap_err()
            .to_string()
    };
    let inverse = message("eigen-80-affine-depth", Prediction::InverseDepth(&values));
    assert!(
        inverse.contains("`scale-disparity`, `affine-disparity`"),
        "{inverse}"
    );
    let depth = message("eigen-80", Prediction::Depth(&values));
    assert!(
        depth.contains("`median`, `scale-depth`, `affine-depth`"),
        "{depth}"
    );
    let infinite = message("eigen-80-affine-depth", Prediction::Depth(&[1.0, f32::NAN]));
    assert!(infinite.contains("row 0, column 1 is NaN"), "{infinite}");
}

/// By hand: two pixels in the crop's part, one above it; what stands there is never looked at, and of
/// the whole image's crop it has no prediction.
#[test]
fn only_the_benchmark_crop_is_looked_at() {
    let size = (1220, 360);
    let mut depth_m = vec![0.0; size.0 * size.1];
    // Rows 8 to 359 and columns 2 to 1217 are the crop.
    let inside = [20 * size.0 + 2, 359 * size.0 + 1217];
    let outside = 7 * size.0 + 600;
    for (index, metres) in [(inside[0], 10.0), (inside[1], 20.0), (outside, 30.0)] {
        depth_m[index] = metres;
    }
    let truth = truth_of(size, depth_m);
    let mut predicted = vec![1.0; size.0 * size.1];
    predicted[inside[0]] = 11.0;
    predicted[inside[1]] = 22.0;
    for (benchmark_crop, pixels, unpredicted) in [
        (BenchmarkCrop::None, 3, 0),
        (BenchmarkCrop::Image, 2, 1),
        (BenchmarkCrop::ImageAndTruth, 2, 0),
    ] {
        let rules = Protocol {
            benchmark_crop,
            crop: Crop::None,
            ..protocol("eigen-80").unwrap()
        };
        let prediction = Prediction::DepthM(&predicted);
        let score = evaluate_prediction(&rules, &truth, prediction, false).unwrap()[0];
        assert_eq!((score.pixels, score.floored_pixels), (pixels, unpredicted));
        if pixels == 2 {
            assert!((score.metrics.abs_rel - 0.1).abs() < 1e-7, "{score:?}");
        }
    }
    let small = truth_of((640, 192), vec![5.0; 640 * 192]);
    let rules = protocol("eigen-kb-garg").unwrap();
    let error = evaluate_prediction(&rules, &small, Prediction::DepthM(&[5.0; 640 * 192]), false);
    assert_eq!(
        error,
        Err(EvaluateError::TooSmall {
            name: "eigen-kb-garg".to_owned(),
            width: 640,
            height: 192
        })
    );
}

/// What lies beyond the floor, 1000 m, is counted; zeros are scored far away.
#[test]
fn aligned_inverse_depth_at_the_floor_is_counted() {
    let truth = truth_of((3, 1), vec![5.0, 10.0, 40.0]);
    let rules = Protocol {
        crop: Crop::None,
        ..protocol("eigen-80-scale-disparity").unwrap()
    };
    let score = evaluate_prediction(
        &rules,
        &truth,
        Prediction::InverseDepth(&[0.4, 0.2, 0.0]),
        false,
    );
    let score = score.unwrap()[0];
    assert_eq!((score.pixels, score.floored_pixels), (3, 1));
    // 80 m for 40 m: a relative error of 1 in one of three.
    assert!(
        (score.metrics.abs_rel - 1.0 / 3.0).abs() < 1e-7,
        "{score:?}"
    );
}
