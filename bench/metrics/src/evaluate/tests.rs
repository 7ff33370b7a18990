use proptest::prelude::*;

use super::{EvaluateError, GroundTruth, ImageScore, Prediction, evaluate_with_pixels};
use crate::flip::flip_blend;
use crate::metrics::{Metric, Metrics};
use crate::protocol::{
    Alignment, Camera, Crop, Group, InfiniteDepth, KnownCamera, LogBase, Protocol, StereoCamera,
    protocol,
};

/// Parts of a [`GroundTruth`], one calibration for both kinds of camera.
#[derive(Clone)]
struct Image {
    width: usize,
    height: usize,
    depth_m: Vec<f32>,
    disparity_px: Option<Vec<f32>>,
    focal_px: f64,
    baseline_m: f64,
    labels: Option<Vec<u8>>,
}

impl Image {
    fn truth(self) -> Result<GroundTruth, EvaluateError> {
        let size = (self.width, self.height);
        let camera = KnownCamera {
            calibration: StereoCamera {
                focal_px: self.focal_px,
                baseline_m: self.baseline_m,
            },
            nominal_focal_px: Some(self.focal_px),
        };
        let mut truth = match self.disparity_px {
            Some(disparity_px) => GroundTruth::stereo(size, &self.depth_m, &disparity_px, camera)?,
            None => GroundTruth::new(size, &self.depth_m, camera)?,
        };
        if let Some(labels) = self.labels {
            truth.set_labels(labels)?;
        }
        Ok(truth)
    }
}

/// Shorter: what is known is usable in nearly all tests.
fn evaluate(
    protocol: &Protocol,
    image: &Image,
    disparity_fraction: &[f32],
) -> Result<Vec<ImageScore>, EvaluateError> {
    super::evaluate(protocol, &image.clone().truth()?, disparity_fraction)
}

fn evaluate_depth(
    protocol: &Protocol,
    image: &Image,
    depth_m: &[f32],
) -> Result<Vec<ImageScore>, EvaluateError> {
    super::evaluate_depth(protocol, &image.clone().truth()?, depth_m)
}

const WIDTH: usize = 1242;
const HEIGHT: usize = 375;
const FOCAL_PX: f64 = 721.5377;
const BASELINE_M: f64 = 0.532_725_428;

/// Plain bilinear resizing in single precision, as `tests/oracle/geometry.py` does it.
fn resize(source: &[f32], (width, height): (usize, usize)) -> Vec<f32> {
    let taps = |from: usize, to: usize| -> Vec<(usize, usize, f32)> {
        (0..to)
            .map(|i| {
                let x = (i as f64 + 0.5) * (from as f64 / to as f64) - 0.5;
                let inside = x >= 0.0 && x.floor() < (from - 1) as f64;
                let near = (x.floor().max(0.0) as usize).min(from - 1);
                let weight = if inside { x - x.floor() } else { 0.0 };
                (near, (near + 1).min(from - 1), weight as f32)
            })
            .collect()
    };
    let columns = taps(width, WIDTH);
    let blend = |row: usize| -> Vec<f32> {
        let row = &source[row * width..(row + 1) * width];
        columns
            .iter()
            .map(|&(a, b, f)| row[a] * (1.0 - f) + row[b] * f)
            .collect()
    };
    taps(height, HEIGHT)
        .into_iter()
        .flat_map(|(a, b, f)| {
            let (a, b) = (blend(a), blend(b));
            a.into_iter()
                .zip(b)
                .map(move |(a, b)| a * (1.0 - f) + b * f)
        })
        .collect()
}

/// Closed formulas of the recipes: plain and mirrored output, 512 x 256.
fn network_outputs() -> (Vec<f32>, Vec<f32>) {
    let plane = |value: &dyn Fn(f64, f64, f64) -> f64| {
        (0..256 * 512)
            .map(|i| {
                let (y, x) = (f64::from(i / 512), f64::from(i % 512));
                value(y, x, (y - 90.0).max(0.0) / 165.0) as f32
            })
            .collect::<Vec<f32>>()
    };
    (
        plane(&|y, x, ramp| 0.0012 + 0.062 * ramp + 0.0006 * (x / 17.0).sin() * (y / 11.0).cos()),
        plane(&|y, x, ramp| {
            0.0012 + 0.060 * ramp + 0.0006 * ((511.0 - x) / 19.0).sin() * (y / 13.0).cos()
        }),
    )
}

struct Fixture {
    predicted: Vec<f32>,
    mirror: Vec<f32>,
    disparity_px: Vec<f32>,
    depth_m: Vec<f32>,
}

/// Predictions and ground truth of the recipes at 1242 x 375.
fn fixture() -> Fixture {
    let (predicted, mirror) = network_outputs();
    let disparity_px: Vec<f32> = (0..HEIGHT * WIDTH)
        .map(|i| {
            let (y, x) = (i / WIDTH, i % WIDTH);
            if y <= 120 || (x * 7 + y * 13) % 5 != 0 {
                return 0.0;
            }
            let (y, x) = (y as f64, x as f64);
            let px = 5.0 + 76.0 * (y - 120.0) / 255.0 + 2.0 * (x / 40.0).sin();
            ((px * 256.0).floor() / 256.0) as f32
        })
        .collect();
    let depth_m = disparity_px
        .iter()
        .map(|&px| {
            if px > 0.0 {
                384.38148_f32 / px + 0.27
            } else {
                0.0
            }
        })
        .collect();
    Fixture {
        predicted: resize(&predicted, (512, 256)),
        mirror: resize(&mirror, (512, 256)),
        disparity_px,
        depth_m,
    }
}

fn close(found: Metrics, expected: [f64; 7]) {
    for (metric, expected) in Metric::ALL.into_iter().zip(expected) {
        let found = found.get(metric);
        assert!(
            (found - expected).abs() < 1e-6,
            "{metric:?}: {found} is not {expected}"
        );
    }
}

/// Whatever a protocol scores, its pixels are handed out as they were compared: their mean relative
/// error is Abs Rel, they lie within the crop (Garg's at this size, worked out by hand: rows 153 to
/// 370, columns 44 to 1196), and their truth is the plane's own.
#[test]
fn the_pixels_behind_a_score_are_those_that_were_scored() {
    let fixture = fixture();
    let image = Image {
        width: WIDTH,
        height: HEIGHT,
        depth_m: fixture.depth_m.clone(),
        disparity_px: None,
        focal_px: FOCAL_PX,
        baseline_m: BASELINE_M,
        labels: None,
    };
    let truth = image.clone().truth().unwrap();
    // A model of unknown scale: three times the disparity.
    let unscaled: Vec<f32> = fixture.predicted.iter().map(|d| 3.0 * d).collect();
    for (name, predicted, cropped) in [
        ("eigen-80", &fixture.predicted, true),
        ("eigen-50", &fixture.predicted, true),
        ("eigen-80-nocrop", &fixture.predicted, false),
        ("eigen-80-median", &unscaled, true),
        ("eigen-80-nocrop-median", &unscaled, false),
    ] {
        let protocol = protocol(name).unwrap();
        let prediction = Prediction::DisparityFraction(predicted);
        let (scores, compared) =
            evaluate_with_pixels(&protocol, &truth, prediction, false).unwrap();
        assert_eq!(scores, evaluate(&protocol, &image, predicted).unwrap());
        assert_eq!(compared.pixels.len() as u64, scores[0].pixels);
        let mut sum = 0.0;
        let mut outside = 0;
        for pixel in &compared.pixels {
            let (row, column) = (pixel.index / WIDTH, pixel.index % WIDTH);
            outside += usize::from(!(153..371).contains(&row) || !(44..1197).contains(&column));
            assert_eq!(pixel.truth_m, f64::from(fixture.depth_m[pixel.index]));
            let depth_m = (FOCAL_PX * BASELINE_M) as f32 / (WIDTH as f32 * predicted[pixel.index]);
            let (nearest, farthest) = compared.limits_m;
            let scale = compared.fit.map_or(1.0, |fit| fit.scale);
            let scored_m = (f64::from(depth_m) * scale).clamp(nearest, farthest);
            assert_eq!(pixel.predicted_m, scored_m, "{name} {row} {column}");
            assert_eq!(compared.predicted_m[pixel.index], scored_m as f32);
            sum += (pixel.predicted_m - pixel.truth_m).abs() / pixel.truth_m;
        }
        assert_eq!(outside == 0, cropped, "{name}: {outside}");
        let mean = sum / compared.pixels.len() as f64;
        assert!((mean - scores[0].metrics.abs_rel).abs() < 1e-12, "{name}");
        assert_eq!(compared.fit.is_some(), name.ends_with("-median"), "{name}");
    }
}

/// Recipe: make_golden.py metrics/eigen. No disparity is below the floor: the smallest is 0.0006.
#[test]
fn eigen_figures_of_the_oracle() {
    let fixture = fixture();
    let truth = Image {
        width: WIDTH,
        height: HEIGHT,
        depth_m: fixture.depth_m.clone(),
        disparity_px: None,
        focal_px: FOCAL_PX,
        baseline_m: BASELINE_M,
        labels: None,
    };
    let named = |name: &str| protocol(name).unwrap();
    let uncropped = Protocol {
        crop: Crop::None,
        ..named("eigen-80")
    };
    #[rustfmt::skip]
    let cases = [
        // eigen80_garg
        (named("eigen-80"), 50_271, [0.144_551_977_515_220_64, 1.089_973_449_707_031_2,
            4.733_181_953_430_176, 0.189_052_745_699_882_5, 0.816_395_138_350_142_2,
            0.954_665_711_841_817_4, 0.992_162_479_361_858_8]),
        // eigen50_garg
        (named("eigen-50"), 50_271, [0.144_480_556_249_618_53, 1.086_107_969_284_057_6,
            4.723_513_126_373_291, 0.188_918_426_632_881_16, 0.816_395_138_350_142_2,
            0.954_665_711_841_817_4, 0.992_202_263_730_580_1]),
        // eigen50_garg_min1
        (named("eigen-50-min1"), 50_271, [0.144_480_556_249_618_53, 1.086_107_969_284_057_6,
            4.723_513_126_373_291, 0.188_918_426_632_881_16, 0.816_395_138_350_142_2,
            0.954_665_711_841_817_4, 0.992_202_263_730_580_1]),
        // eigen80_median
        (named("eigen-80-median"), 50_271, [0.118_900_977_075_099_95, 0.716_745_138_168_335,
            3.870_397_329_330_444_3, 0.156_806_990_504_264_83, 0.881_581_826_500_368,
            0.970_559_567_146_068_3, 0.997_175_309_820_771_4]),
        // eigen80_nocrop
        (uncropped, 62_686, [0.233_354_464_173_316_96, 5.019_251_823_425_293,
            12.753_135_681_152_344, 0.288_388_252_258_300_8, 0.730_210_892_384_264_4,
            0.869_747_631_049_995_2, 0.941_964_713_014_070_1]),
    ];
    for (protocol, pixels, expected) in cases {
        let scores = evaluate(&protocol, &truth, &fixture.predicted).unwrap();
        assert_eq!(scores.len(), 1, "{}", protocol.name);
        close(scores[0].metrics, expected);
        assert_eq!((scores[0].pixels, scores[0].floored_pixels), (pixels, 0));
        assert_eq!((scores[0].group, scores[0].d1_all), (None, None));
    }
}

/// Recipe: make_golden.py metrics/kitti.
#[test]
fn kitti_figures_of_the_oracle() {
    let fixture = fixture();
    // Stored depth of the same pixels; the figures must come from the disparity.
    let stored: Vec<f32> = fixture.disparity_px.iter().map(|&px| px.min(1.0)).collect();
    let truth = Image {
        width: WIDTH,
        height: HEIGHT,
        depth_m: stored,
        disparity_px: Some(fixture.disparity_px.clone()),
        focal_px: FOCAL_PX,
        // Not the nominal baseline: the protocol brings its own.
        baseline_m: BASELINE_M,
        labels: None,
    };
    let scores = evaluate(&protocol("kitti2015").unwrap(), &truth, &fixture.predicted).unwrap();
    let expected = [
        0.256_518_230_686_986_65,
        5.105_656_785_576_712,
        12.863_553_774_099_625,
        0.295_884_723_440_720_14,
        0.707_717_179_401_835_4,
        0.867_703_232_737_726_7,
        0.941_403_959_234_784_8,
    ];
    close(scores[0].metrics, expected);
    assert!((scores[0].d1_all.unwrap() - 74.886_278_984_990_41).abs() < 1e-9);
    assert_eq!((scores[0].pixels, scores[0].floored_pixels), (63_093, 0));
    let pooled = (scores[0].sum_squared_error / 63_093.0).sqrt();
    assert!((pooled - scores[0].metrics.rmse).abs() < 1e-12);
}

/// Distances divide the pixels of an image: together they say what the image says.
#[test]
fn distances_add_up_to_the_image() {
    let fixture = fixture();
    let truth = Image {
        width: WIDTH,
        height: HEIGHT,
        depth_m: fixture.disparity_px.clone(),
        disparity_px: Some(fixture.disparity_px.clone()),
        focal_px: FOCAL_PX,
        baseline_m: BASELINE_M,
        labels: None,
    };
    let score =
        |name: &str| evaluate(&protocol(name).unwrap(), &truth, &fixture.predicted).unwrap();
    let whole = score("kitti2015")[0];
    let parts = score("kitti2015-distance");
    let groups: Vec<Group> = parts.iter().filter_map(|part| part.group).collect();
    assert!(
        groups.len() == parts.len() && groups.len() > 4,
        "{groups:?}"
    );
    assert!(groups.is_sorted(), "{groups:?}");
    let sum = |of: &dyn Fn(&ImageScore) -> f64| parts.iter().map(of).sum::<f64>();
    let pixels = |score: &ImageScore| score.pixels as f64;
    assert_eq!(sum(&pixels), pixels(&whole));
    let squared = sum(&|part| part.sum_squared_error);
    assert!((squared / whole.sum_squared_error - 1.0).abs() < 1e-12);
    let abs_rel = sum(&|part| part.metrics.abs_rel * pixels(part)) / pixels(&whole);
    assert!((abs_rel / whole.metrics.abs_rel - 1.0).abs() < 1e-12);
}

/// Recipe: make_golden.py metrics/groups. Two images: the first with labels
/// (row / 5 + column / 7) % 34, whole divisions; the second predicted by `mirror`, with the ids 24 and
/// 25 made 0. Per group: pooled, mean over images, pixels, images.
#[test]
fn group_errors_of_the_oracle() {
    let fixture = fixture();
    let labels: Vec<u8> = (0..HEIGHT * WIDTH)
        .map(|i| ((i / WIDTH / 5 + i % WIDTH / 7) % 34) as u8)
        .collect();
    let without_humans: Vec<u8> = labels
        .iter()
        .map(|&id| if id == 24 || id == 25 { 0 } else { id })
        .collect();
    let truth = |labels: &[u8]| Image {
        width: WIDTH,
        height: HEIGHT,
        depth_m: fixture.disparity_px.clone(),
        disparity_px: Some(fixture.disparity_px.clone()),
        focal_px: FOCAL_PX,
        baseline_m: BASELINE_M,
        labels: Some(labels.to_vec()),
    };
    let semantic = protocol("semantic").unwrap();
    let mut scores = evaluate(&semantic, &truth(&labels), &fixture.predicted).unwrap();
    assert_eq!(scores.len(), 5);
    scores.extend(evaluate(&semantic, &truth(&without_humans), &fixture.mirror).unwrap());
    let expected = [
        (
            Group::Flat,
            14.575_118_925_304_231,
            14.574_164_845_849_374,
            14_916,
            2,
        ),
        (
            Group::Human,
            9.748_885_335_192_725,
            9.748_885_335_192_725,
            3678,
            1,
        ),
        (
            Group::Vehicle,
            12.452_536_239_635_725,
            12.447_170_725_783_476,
            29_926,
            2,
        ),
        (
            Group::Construction,
            13.297_244_858_690_72,
            13.296_504_134_255_116,
            22_020,
            2,
        ),
        (
            Group::Object,
            11.488_341_892_593_198,
            11.488_089_895_813_552,
            14_640,
            2,
        ),
    ];
    for (group, pooled, mean, pixels, images) in expected {
        let members: Vec<&ImageScore> = scores
            .iter()
            .filter(|score| score.group == Some(group))
            .collect();
        assert_eq!(members.len(), images);
        let count: u64 = members.iter().map(|score| score.pixels).sum();
        assert_eq!(count, pixels);
        let squared: f64 = members.iter().map(|score| score.sum_squared_error).sum();
        assert!(((squared / count as f64).sqrt() - pooled).abs() < 1e-6);
        let roots: f64 = members.iter().map(|score| score.metrics.rmse).sum();
        assert!((roots / images as f64 - mean).abs() < 1e-6);
    }
}

/// Recipe: make_golden.py metrics/flip, in double precision: row 200 at six columns.
#[test]
fn flip_blending_of_the_oracle() {
    let (predicted, mirror) = network_outputs();
    let blended = flip_blend(&predicted, &mirror, 512);
    let expected = [
        (0, 0.041_200_000_792_741_776),
        (30, 0.040_837_024_570_007_15),
        (40, 0.041_320_422_799_153_336),
        (256, 0.041_784_960_776_567_46),
        (480, 0.042_399_665_687_065_54),
        (511, 0.042_072_914_540_767_7),
    ];
    for (column, value) in expected {
        assert!(
            (f64::from(blended[200 * 512 + column]) - value).abs() < 4e-9,
            "{column}"
        );
    }
}

/// A 2 x 2 image with depths 10, 20, 90 m and a pixel without.
const DEPTH_M: [f32; 4] = [10.0, 20.0, 90.0, 0.0];

fn small() -> Image {
    Image {
        width: 2,
        height: 2,
        depth_m: DEPTH_M.to_vec(),
        disparity_px: None,
        focal_px: 100.0,
        baseline_m: 0.5,
        labels: None,
    }
}

fn uncropped(name: &str) -> Protocol {
    Protocol {
        crop: Crop::None,
        ..protocol(name).unwrap()
    }
}

#[test]
fn mask_and_clip_by_hand() {
    // 50 m px over 2 columns: fractions of 2.5, 1.25 give 10 m and 20 m, 0.25 gives 100 m.
    let predicted = [2.5, 0.25, 0.25, 0.25];
    let eigen = evaluate(&uncropped("eigen-80"), &small(), &predicted).unwrap()[0];
    // 90 m is masked out; 100 m becomes 80 m against 20 m.
    assert_eq!((eigen.pixels, eigen.sum_squared_error), (2, 3600.0));
    let kitti = Protocol {
        camera: Camera::Nominal { baseline_m: 0.5 },
        ..protocol("kitti2015").unwrap()
    };
    let kitti = evaluate(&kitti, &small(), &predicted).unwrap()[0];
    // 90 m counts, and its prediction of 100 m becomes 80 m.
    assert_eq!((kitti.pixels, kitti.sum_squared_error), (3, 3600.0 + 100.0));
    assert_eq!(kitti.d1_all, None, "no disparity, no D1");
}

#[test]
fn limits_of_the_mask_are_outside_unless_comparisons_are_loose() {
    let depth_m = [10.0, 50.0, 1.0, 0.0];
    let truth = Image {
        depth_m: depth_m.to_vec(),
        ..small()
    };
    let strict = uncropped("eigen-50-min1");
    let loose = Protocol {
        strict_comparisons: false,
        ..strict.clone()
    };
    let pixels = |protocol| evaluate(protocol, &truth, &[1.0; 4]).unwrap()[0].pixels;
    assert_eq!((pixels(&strict), pixels(&loose)), (1, 3));
}

#[test]
fn zero_disparity_is_floored_and_counted_or_follows_the_reference() {
    let predicted = [0.0, 1.25, 0.0, 0.0];
    let eigen = uncropped("eigen-80");
    let floored = evaluate(&eigen, &small(), &predicted).unwrap()[0];
    // 1e-4 of two columns is 250 km, so 80 m; the pixels outside the mask do not count.
    assert_eq!(
        (floored.floored_pixels, floored.sum_squared_error),
        (1, 4900.0)
    );
    let unfloored = Protocol {
        disparity_floor_fraction: 0.0,
        ..eigen
    };
    let near = evaluate(&unfloored, &small(), &predicted).unwrap()[0];
    let limit = f64::from(1e-3_f32);
    assert_eq!(
        (near.floored_pixels, near.sum_squared_error),
        (0, (10.0 - limit).powi(2))
    );
    let far = Protocol {
        infinite_depth: InfiniteDepth::FarLimit,
        ..unfloored
    };
    assert_eq!(
        evaluate(&far, &small(), &predicted).unwrap()[0].sum_squared_error,
        4900.0
    );
}

#[test]
fn median_scaling_takes_out_the_scale_and_happens_before_clipping() {
    let protocol = Protocol {
        crop: Crop::None,
        ..protocol("eigen-80-median").unwrap()
    };
    // 7 times too far: 140 m would be clipped if clipping came first.
    let depths = [70.0, 140.0, 7.0, 7.0];
    let score = evaluate_depth(&protocol, &small(), &depths).unwrap()[0];
    assert!(score.metrics.abs_rel < 1e-15 && score.metrics.a1 == 1.0);
}

/// Four measured pixels within all limits.
fn measured() -> Image {
    Image {
        depth_m: vec![10.0, 20.0, 3.0, 4.0],
        ..small()
    }
}

/// By hand: where depth is predicted it is 1.1 times the true one.
#[test]
fn depth_of_zero_is_none_and_is_counted() {
    for (name, abs_rel) in [("eigen-80", 0.1), ("eigen-80-median", 0.0)] {
        let protocol = uncropped(name);
        let score = evaluate_depth(&protocol, &measured(), &[11.0, 0.0, 3.3, 4.4]).unwrap()[0];
        assert!(
            (score.metrics.abs_rel - abs_rel).abs() < 1e-6,
            "{name}: {score:?}"
        );
        assert_eq!((score.pixels, score.floored_pixels), (3, 1));
        let dead = evaluate_depth(&protocol, &measured(), &[0.0; 4]).unwrap_err();
        assert!(dead.to_string().contains("dead"), "{dead}");
    }
}

/// The two pixels nearer than 5 m are one group, one of them without depth; 20 m has none at all, so
/// its group has no score.
#[test]
fn every_group_counts_its_own_pixels_without_depth() {
    let protocol = uncropped("eigen-80-distance");
    let scores = evaluate_depth(&protocol, &measured(), &[10.0, 0.0, 0.0, 4.0]).unwrap();
    let counts: Vec<(u64, u64)> = scores
        .iter()
        .map(|s| (s.pixels, s.floored_pixels))
        .collect();
    assert_eq!(counts, [(1, 1), (1, 0)]);
}

/// By hand for truth x 1.1 and for a perfect prediction, under every protocol by name: the
/// relative error is 0.1, that of the logarithm ln 1.1 (or log10 1.1), and all pixels lie
/// within 1.25. Where medians set the scale nothing is left of the error.
#[test]
fn ten_percent_too_far_is_ten_percent_under_every_protocol() {
    // As large as the crop of KITTI's benchmark.
    let (width, height) = (1216, 352);
    let depth_m: Vec<f32> = (0..width * height).map(|i| 5.0 + (i % 37) as f32).collect();
    let labels: Vec<u8> = (0..width * height)
        .map(|i| [7, 24, 26, 11, 17][i % 5])
        .collect();
    for known in crate::protocol::protocols() {
        let truth = Image {
            width,
            height,
            depth_m: depth_m.to_vec(),
            disparity_px: None,
            focal_px: 100.0,
            baseline_m: 0.5,
            labels: Some(labels.to_vec()),
        };
        let disparity_px: Vec<f32> = depth_m.iter().map(|depth| 54.0 / depth).collect();
        let truth = Image {
            disparity_px: known.ground_truth.is_stereo().then(|| disparity_px.clone()),
            ..truth
        };
        for factor in [1.0, 1.1] {
            let baseline = match known.camera {
                Camera::Nominal { baseline_m } => baseline_m,
                _ => truth.baseline_m,
            };
            // What the protocol itself takes for the truth.
            let predicted: Vec<f32> = match &truth.disparity_px {
                Some(plane) => plane
                    .iter()
                    .map(|d| (100.0 * baseline / f64::from(*d) * factor) as f32)
                    .collect(),
                None => depth_m
                    .iter()
                    .map(|d| (f64::from(*d) * factor) as f32)
                    .collect(),
            };
            // Whatever aligns takes out a factor.
            let error: f64 = match known.alignment {
                Alignment::None => factor,
                _ => 1.0,
            };
            let log = match known.log_base {
                LogBase::Natural => error.ln(),
                LogBase::Ten => error.log10(),
            };
            for score in evaluate_depth(&known, &truth, &predicted).unwrap() {
                let m = score.metrics;
                assert!(
                    (m.abs_rel - (error - 1.0)).abs() < 2e-7,
                    "{} {m:?}",
                    known.name
                );
                assert!((m.rmse_log - log).abs() < 2e-7, "{} {m:?}", known.name);
                assert_eq!((m.a1, m.a3), (1.0, 1.0), "{}", known.name);
            }
        }
    }
}

/// Make3D: 1 / disparity in any unit, brought to metres by medians, clipped at 70 m, and
/// the logarithm to base 10. By hand: truth 10, 20, 60; disparities 4, 2, 0.25 are depths in
/// the ratio 1 : 2 : 16, the medians agree at 20 m, so 10, 20 and 160, clipped to 70.
#[test]
fn make3d_by_hand() {
    let depth_m = [10.0, 20.0, 60.0, 71.0];
    let truth = Image {
        depth_m: depth_m.to_vec(),
        focal_px: 0.0,
        baseline_m: 0.0,
        ..small()
    };
    let rules = protocol("make3d-c1").unwrap();
    let score = evaluate(&rules, &truth, &[0.4, 0.2, 0.025, 0.4]).unwrap()[0];
    assert_eq!(score.pixels, 3);
    let m = score.metrics;
    assert!((m.abs_rel - 10.0 / 60.0 / 3.0).abs() < 1e-6, "{m:?}");
    assert!((m.rmse - (100.0_f64 / 3.0).sqrt()).abs() < 1e-5, "{m:?}");
    let log = (70.0_f64 / 60.0).log10() / 3.0_f64.sqrt();
    assert!((m.rmse_log - log).abs() < 1e-6, "{m:?}");
}

/// One camera for all images: 0.58 * 0.54 m / d, whatever the calibration says.
#[test]
fn an_agreed_camera_overrides_the_calibration() {
    let rules = Protocol {
        crop: Crop::None,
        ..protocol("eigen-monodepth2").unwrap()
    };
    let depth_m = [10.44_f32, 0.0, 0.0, 0.0];
    let truth = Image {
        depth_m: depth_m.to_vec(),
        focal_px: f64::NAN,
        baseline_m: 3.0,
        ..small()
    };
    let score = evaluate(&rules, &truth, &[0.03, 0.0, 0.0, 0.0]).unwrap()[0];
    assert!(score.metrics.abs_rel < 1e-6, "{score:?}");
}

#[test]
fn depth_and_disparity_of_the_same_scene_score_alike() {
    let disparities = [2.0, 1.0, 0.5, 3.0];
    let depths = disparities.map(|fraction: f32| 50.0 / (2.0 * fraction));
    let disparity_px = [5.0, 2.5, 0.625, 0.0];
    let truth = Image {
        disparity_px: Some(disparity_px.to_vec()),
        ..small()
    };
    for protocol in [
        uncropped("eigen-80"),
        Protocol {
            camera: Camera::Calibrated,
            ..protocol("kitti2015").unwrap()
        },
    ] {
        let a = evaluate(&protocol, &truth, &disparities).unwrap();
        assert_eq!(a, evaluate_depth(&protocol, &truth, &depths).unwrap());
    }
}

#[test]
fn a_calibrated_stereo_protocol_needs_disparity() {
    let calibrated = protocol("kitti2015-calibrated").unwrap();
    let error = evaluate(&calibrated, &small(), &[1.0; 4]).unwrap_err();
    assert!(matches!(error, EvaluateError::Missing { .. }), "{error}");
}

#[test]
fn bad_values_are_errors_that_name_the_place() {
    let eigen = uncropped("eigen-80");
    for bad in [f32::NAN, f32::INFINITY, -0.1] {
        // The place is outside the mask: a broken model is broken everywhere.
        let error = evaluate(&eigen, &small(), &[0.1, 0.1, 0.1, bad]).unwrap_err();
        let text = error.to_string();
        assert!(text.contains("disparity at row 1, column 1"), "{text}");
        let error = evaluate_depth(&eigen, &small(), &[0.1, 0.1, bad, 0.1]).unwrap_err();
        assert!(error.to_string().contains("depth at row 1, column 0"));
        let depth_m = [1.0, bad, 1.0, 1.0];
        let truth = Image {
            depth_m: depth_m.to_vec(),
            ..small()
        };
        let error = evaluate(&eigen, &truth, &[0.1; 4]).unwrap_err();
        assert!(
            matches!(
                error,
                EvaluateError::Truth {
                    row: 0,
                    column: 1,
                    ..
                }
            ),
            "{error}"
        );
    }
    for focal_px in [0.0, f64::NAN, -1.0] {
        let truth = Image {
            focal_px,
            ..small()
        };
        assert!(evaluate(&eigen, &truth, &[0.1; 4]).is_err());
    }
    let error = evaluate(&eigen, &small(), &[0.1; 3]).unwrap_err();
    assert_eq!(
        error.to_string(),
        "the prediction has 3 values where 2 x 2 = 4 are needed"
    );
    let upside_down = Protocol {
        min_depth_m: 90.0,
        ..eigen
    };
    assert!(evaluate(&upside_down, &small(), &[0.1; 4]).is_err());
}

#[test]
fn an_image_without_a_pixel_to_score_gets_no_score() {
    let depth_m = [0.0, 90.0, 0.0, 0.0];
    let truth = Image {
        depth_m: depth_m.to_vec(),
        ..small()
    };
    let error = evaluate(&uncropped("eigen-80"), &truth, &[0.1; 4]).unwrap_err();
    assert!(
        matches!(error, EvaluateError::NothingToScore { with_truth: 1, .. }),
        "{error}"
    );
    let labels = [23, 23, 0, 7];
    let truth = Image {
        labels: Some(labels.to_vec()),
        ..small()
    };
    let semantic = protocol("semantic").unwrap();
    assert!(matches!(
        evaluate(&semantic, &truth, &[0.1; 4]),
        Err(EvaluateError::NothingToScore { .. })
    ));
    assert!(matches!(
        evaluate(&semantic, &small(), &[0.1; 4]),
        Err(EvaluateError::Missing { .. })
    ));
}

fn scene() -> impl Strategy<Value = (Protocol, usize, Vec<[f32; 2]>, Vec<u8>)> {
    const NAMES: [&str; 5] = [
        "kitti2015",
        "semantic",
        "eigen-80",
        "eigen-50",
        "eigen-80-median",
    ];
    let value = || {
        prop_oneof![
            Just(0.0_f32),
            1e-6_f32..2.0,
            Just(f32::MIN_POSITIVE),
            Just(1e30)
        ]
    };
    (
        proptest::sample::select(&NAMES[..]),
        1_usize..9,
        proptest::collection::vec([value(), value()], 72),
        proptest::collection::vec(0_u8..40, 72),
    )
        .prop_map(|(name, width, planes, labels)| (uncropped(name), width, planes, labels))
}

proptest! {
    #[test]
    fn a_score_is_always_made_of_numbers((protocol, width, planes, labels) in scene()) {
        let count = 72 / width * width;
        let depth_m: Vec<f32> = planes[..count].iter().map(|p| p[0] * 60.0).collect();
        let disparity_px: Vec<f32> = planes[..count].iter().map(|p| p[0]).collect();
        let truth = Image {
            width,
            height: count / width,
            depth_m: depth_m.to_vec(),
            disparity_px: protocol.ground_truth.is_stereo().then(|| disparity_px.clone()),
            focal_px: 700.0,
            baseline_m: 0.5,
            labels: Some(labels[..count].to_vec()),
                };
        let predicted: Vec<f32> = planes[..count].iter().map(|p| p[1]).collect();
        for (is_disparity, scores) in [
            (true, evaluate(&protocol, &truth, &predicted)),
            (false, evaluate_depth(&protocol, &truth, &predicted)),
        ] {
            for score in scores.unwrap_or_default() {
                let m = score.metrics;
                prop_assert!(m.to_array().iter().all(|v| v.is_finite() && *v >= 0.0), "{m:?}");
                prop_assert!(m.a1 <= m.a2 && m.a2 <= m.a3 && m.a3 <= 1.0);
                prop_assert!(!is_disparity || score.floored_pixels <= score.pixels);
                prop_assert!(score.pixels > 0);
                prop_assert!(score.d1_all.is_none_or(|d1| (0.0..=100.0).contains(&d1)));
            }
        }
    }

    #[test]
    fn after_median_scaling_the_unit_of_depth_is_irrelevant(
        depths in proptest::collection::vec([1.0_f32..79.0, 1.0_f32..79.0], 4),
    ) {
        let depth_m: Vec<f32> = depths.iter().map(|d| d[0]).collect();
        let truth = Image { depth_m: depth_m.to_vec(), ..small() };
        let score = |unit: f32| {
            let predicted: Vec<f32> = depths.iter().map(|d| d[1] * unit).collect();
            let mut score = evaluate_depth(&uncropped("eigen-80-median"), &truth, &predicted).unwrap()[0];
            // The scale is the unit's reciprocal; nothing else knows of it.
            if let Some(fit) = &mut score.fit {
                fit.scale *= f64::from(unit);
            }
            score
        };
        prop_assert_eq!(score(1.0), score(1024.0));
        prop_assert_eq!(score(1.0), score(1.0 / 64.0));
    }
}
