//! Descriptions and probes, whole and damaged.

use super::probe::PROBE_POINTS;
use super::*;
use proptest::prelude::*;

fn full() -> ModelMetadata {
    ModelMetadata {
        kernel: Some("area".into()),
        train_data_digest: Some("00ff".into()),
        split: Some("eigen".into()),
        train_drives: vec![
            "2011_09_26_drive_0001".into(),
            "2011_09_30_drive_0020".into(),
        ],
        train_source: Some("rendered".into()),
        unknown_start: Some("ff00".into()),
        camera: Some(camera([0.58, 0.57, 0.585], 0.54)),
        variant: Some("strat".into()),
        seed: Some(u64::MAX),
        epoch: Some(50),
        tool_version: Some("0.1.0".into()),
        parity: Some(4.5e-8),
        probe: Some(Probe::record(16, 8, &[0.1; 256]).unwrap()),
        ..ModelMetadata::new(OutputMeaning::DisparityFraction, InputRange::Unit, 512, 256)
    }
}

fn read(props: &[(String, String)]) -> Reading {
    ModelMetadata::from_props(props.iter().map(|(k, v)| (k.as_str(), v.as_str())))
}

/// The properties of `full` with one value replaced, or removed for `None`.
fn with(key: &str, value: Option<&str>) -> Reading {
    let mut props = full().to_props();
    match value {
        Some(value) => props.iter_mut().find(|(k, _)| k == key).unwrap().1 = value.to_owned(),
        None => props.retain(|(k, _)| k != key),
    }
    read(&props)
}

#[test]
fn a_full_description_comes_back() {
    let reading = read(&full().to_props());
    assert_eq!(reading.problems, Vec::<String>::new());
    assert_eq!(reading.metadata, Some(full()));
}

#[test]
fn properties_of_others_are_no_description() {
    let props = [("author".to_owned(), "someone".to_owned())];
    assert_eq!(read(&props), Reading::default());
}

#[test]
fn broken_values_are_sentences_and_cost_only_themselves() {
    let reading = with("strat.seed", Some("seven"));
    assert_eq!(
        reading.problems,
        ["\"strat.seed\" is \"seven\", which is not a whole number"]
    );
    let expected = ModelMetadata {
        seed: None,
        ..full()
    };
    assert_eq!(reading.metadata, Some(expected));

    for (key, value) in [
        ("strat.probe.image", "lena"),
        ("strat.probe.expected", "1 2 3"),
        ("strat.probe.width", "0"),
        ("strat.probe.height", "-3"),
    ] {
        let reading = with(key, Some(value));
        assert_eq!(reading.problems.len(), 1, "{:?}", reading.problems);
        assert_eq!(
            reading.metadata,
            Some(ModelMetadata {
                probe: None,
                ..full()
            })
        );
    }
    let newer = with("strat.format", Some("2"));
    assert!(newer.problems[0].contains("format 2"));
    assert_eq!(newer.metadata, Some(full()));
}

#[test]
fn what_decides_the_use_must_be_there() {
    for key in ["output", "input_range", "input_width", "input_height"] {
        let key = format!("strat.{key}");
        for value in [None, Some("?"), Some("")] {
            let reading = with(&key, value);
            assert_eq!(reading.metadata, None);
            assert!(
                reading.problems.iter().any(|p| p.contains(&key)),
                "{:?}",
                reading.problems
            );
        }
    }
    assert_eq!(with("strat.input_width", Some("0")).metadata, None);
}

#[test]
fn a_missing_key_shows_in_the_count() {
    for (key, _) in full().to_props() {
        assert!(!with(&key, None).problems.is_empty(), "{key}");
    }
}

/// Worked by hand: at width 2, height 1 the first pixel has u = 1/4, v = 1/2. Channel 0:
/// 3u + 2v = 1.75, t = |2 * 0.75 - 1| = 0.5; block 2 + 2 + 0 is even; 11u = 2.75, t = 0.5;
/// 0.4 / 2 + 0.3 / 2 + 0.2 + 0.1 / 2 = 0.6. Channel 1: 5u + 3v = 2.75, t = 0.5; block odd:
/// 0.4. Channel 2: 7u + 4v = 3.75: 0.6 again.
#[test]
fn the_probe_image_follows_its_formula() {
    let image = probe_image(2, 1);
    assert_eq!(image.len(), 6);
    for (found, expected) in [image[0], image[2], image[4]]
        .into_iter()
        .zip([0.6, 0.4, 0.6])
    {
        assert!((found - expected).abs() < 1e-6, "{image:?}");
    }
    let image = probe_image(512, 256);
    let (least, most) = image
        .iter()
        .fold((1.0_f32, 0.0_f32), |(a, b), &v| (a.min(v), b.max(v)));
    assert!(
        least >= 0.0 && most <= 1.0 && most - least > 0.8,
        "{least}..{most}"
    );
}

/// A probe notices swapped maps, a mirrored map, and a map that is shifted by a pixel.
#[test]
fn a_probe_is_not_blind() {
    let (width, height) = (64_usize, 32_usize);
    let plane = width * height;
    let output: Vec<f32> = (0..2 * plane)
        .map(|i| (i / plane) as f32 * 0.01 + (i % plane % width) as f32 / 1000.0)
        .collect();
    let probe = Probe::record(64, 32, &output).unwrap();
    assert_eq!(probe.max_difference(&output), Ok(0.0));
    let swapped = [&output[plane..], &output[..plane]].concat();
    let mirrored: Vec<f32> = output
        .chunks(width)
        .flat_map(|r| r.iter().rev().copied())
        .collect();
    let mut shifted = output.clone();
    shifted.rotate_right(1);
    for other in [&swapped, &mirrored, &shifted] {
        assert!(probe.max_difference(other).unwrap() > 5e-4);
    }
    let nan = vec![f32::NAN; 2 * plane];
    assert_eq!(probe.max_difference(&nan), Ok(f32::INFINITY));
    assert!(matches!(
        Probe::record(64, 32, &nan),
        Err(ProbeError::NotFinite { row: 2, column: 4 })
    ));
    assert!(matches!(
        probe.max_difference(&output[1..]),
        Err(ProbeError::Size { .. })
    ));
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn numbers_come_back_bit_for_bit(
        expected in proptest::collection::vec(-1e30_f32..1e30, 2 * PROBE_POINTS),
        parity in proptest::option::of(0.0_f64..1.0),
        seed in proptest::option::of(any::<u64>()),
        variant in ".*",
    ) {
        let metadata = ModelMetadata {
            probe: Some(Probe { width: 9, height: 9, expected }),
            parity,
            seed,
            variant: Some(variant),
            ..full()
        };
        prop_assert_eq!(read(&metadata.to_props()).metadata, Some(metadata));
    }

    #[test]
    fn any_properties_can_be_read(
        props in proptest::collection::vec(("(strat\\.)?[a-z_.]{0,12}", ".{0,60}"), 0..20),
        key in 0_usize..17,
        value in ".{0,60}",
    ) {
        let _ = read(&props);
        let mut props = full().to_props();
        let key = key % props.len();
        props[key].1 = value;
        let _ = read(&props);
    }
}

fn camera(focal: [f64; 3], baseline: f64) -> TrainingCamera {
    let [mean, lowest, highest] = focal;
    TrainingCamera {
        focal_fraction: Spread {
            mean,
            lowest,
            highest,
        },
        baseline_m: Spread::of([baseline]).unwrap(),
    }
}

#[test]
fn the_cameras_of_a_training_come_back() {
    let one = Spread::of([0.58, 0.58, 0.58]).unwrap();
    assert_eq!(one.to_string(), "0.58");
    assert_eq!("0.58".parse(), Ok(one));
    // 5/8 and 1/8 are exact.
    let several = Spread::of([0.625, 0.125, 0.125, 0.125]).unwrap();
    assert_eq!(several.to_string(), "0.25 0.125 0.625");
    assert_eq!("0.25 0.125 0.625".parse(), Ok(several));
    assert_eq!(Spread::of([]), None);
    assert_eq!(Spread::of([0.5, 0.0]), None);
    assert_eq!(Spread::of([f64::NAN]), None);
    for text in ["", "x", "1 2", "0", "-1", "0.5 0.6 0.7", "inf", "1 0.5 NaN"] {
        assert!(text.parse::<Spread>().is_err(), "{text}");
    }
    // A camera of which one half is damaged is none, and said.
    let reading = with("strat.train_baseline_m", Some("wide"));
    assert_eq!(reading.metadata.unwrap().camera, None);
    assert!(
        reading.problems[0].contains("train_baseline_m"),
        "{:?}",
        reading.problems
    );
}

#[test]
fn another_camera_than_the_trainings_is_said() {
    let kitti = camera([0.58, 0.57, 0.585], 0.54);
    assert_eq!(kitti.difference(0.58, 0.54), None);
    assert_eq!(kitti.difference(0.56, 0.532), None);
    let text = kitti.difference(0.58, 0.16).unwrap();
    assert!(
        text.contains("0.540 m") && text.contains("0.160 m"),
        "{text}"
    );
    assert!(kitti.difference(0.8, 0.54).is_some());
}
