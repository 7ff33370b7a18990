//! The whole evaluation against the independent one in `tests/oracle`, row by row.
//!
//! Frames are rendered, prepared, and scored with predictions by closed formulas that are saved as an
//! array: reading them, resizing, the floor, ground truth, crops, caps, median scaling, groups and metrics are all
//! compared. `STRAT_KITTI_SAMPLES`, a folder with `kitti_raw/` and `kitti2015/`, adds real frames.

use std::collections::BTreeMap;
use std::ffi::{OsStr, OsString};
use std::path::{Path, PathBuf};

use strat_metrics::rows;
use strat_needs::Need;
use strat_splits::{Role, Split};
use strat_store::set::PreparedSet;
use strat_tests::steps::Command;

use crate::python::oracle;

/// A row as the oracle expects it.
struct Expected {
    metrics: Vec<f64>,
    d1: Option<f64>,
    pixels: u64,
}

/// By protocol, image and group.
type Rows = BTreeMap<(String, String, Option<String>), Expected>;

fn expected(file: &Path) -> Rows {
    let text = std::fs::read_to_string(file).expect("what the oracle wrote");
    let records: Vec<serde_json::Value> = serde_json::from_str(&text).expect("JSON");
    let read = |record: &serde_json::Value| {
        let text = |key: &str| record[key].as_str().map(str::to_owned);
        let values = record["metrics"].as_array().expect("metrics");
        let key = (text("protocol")?, text("image")?, text("group"));
        let row = Expected {
            metrics: values
                .iter()
                .filter_map(serde_json::Value::as_f64)
                .collect(),
            d1: record["d1"].as_f64(),
            pixels: record["pixels"].as_u64()?,
        };
        Some((key, row))
    };
    records
        .iter()
        .map(|record| read(record).expect("a record"))
        .collect()
}

/// The test images of a set prepared from `data`, which holds `kitti_raw/` and `kitti2015/`.
fn prepared(split: Split, data: &Path, set: &Path) -> Vec<String> {
    let mut line = words(&[
        &split.as_str(),
        &"--raw",
        &data.join("kitti_raw"),
        &"--out",
        &set,
    ]);
    line.extend(words(&[&"--allow-missing", &"--test-only", &"--quiet"]));
    if split == Split::Kitti {
        let stereo = data.join("kitti2015");
        line.extend(words(&[&"--stereo2015", &stereo]));
        if stereo.join("training/semantic").is_dir() {
            line.extend(words(&[&"--semantics", &stereo]));
        }
    }
    assert_eq!(Command::Prep.run(&line), 0);
    let tests = PreparedSet::open(set)
        .and_then(|set| set.samples(Role::Test))
        .expect("test samples");
    tests
        .into_iter()
        .map(|sample| sample.id.to_string())
        .collect()
}

fn words(words: &[&dyn AsRef<OsStr>]) -> Vec<OsString> {
    words.iter().map(|word| word.as_ref().to_owned()).collect()
}

fn agrees(split: Split, data: &Path, least: usize) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let at = |name: &str| folder.path().join(name);
    let ids = prepared(split, data, &at("set"));
    let list = at("ids.txt");
    std::fs::write(&list, ids.join("\n")).expect("a list");
    if oracle("expected.py", &[data, &list, folder.path()]).is_none() {
        return;
    }
    let mut expected = expected(&at("expected.json"));
    let out = at("out");
    let mut line = words(&[
        &"--table",
        &"all",
        &"--data",
        &at("set"),
        &"--predictions",
        &at("predictions.npy"),
        &"--out",
        &out,
    ]);
    line.push("--quiet".into());
    let mut protocols: Vec<&String> = expected.keys().map(|(protocol, ..)| protocol).collect();
    protocols.dedup();
    for protocol in protocols {
        line.extend(words(&[&"--protocol", protocol]));
    }
    // Samples may lack one of the two maps of an image, which `bench` calls a failure.
    assert!(Command::Bench.run(&line) <= 1);
    let file = std::fs::File::open(out.join("rows.csv")).expect("rows");
    let rows = rows::read(file).expect("rows");
    let mut largest = 0.0_f64;
    for row in &rows {
        let group = row.score.group.map(|group| group.name().to_owned());
        let key = (row.context.protocol.clone(), row.image.clone(), group);
        let name = format!("{key:?}");
        let Expected {
            metrics,
            d1,
            pixels,
        } = expected
            .remove(&key)
            .unwrap_or_else(|| panic!("{name}: no such row"));
        assert_eq!(row.score.pixels, pixels, "{name}");
        for (at, (found, expected)) in row
            .score
            .metrics
            .to_array()
            .iter()
            .zip(&metrics)
            .enumerate()
        {
            // Shares of pixels may differ by a pixel that lies on the threshold.
            let allowed = if at < 4 {
                1e-6 * expected.max(1.0)
            } else {
                1.5 / pixels as f64
            };
            let difference = (found - expected).abs();
            assert!(difference <= allowed, "{name} {at}: {found}, {expected}");
            if at < 4 {
                largest = largest.max(difference / expected);
            }
        }
        if let (Some(found), Some(expected)) = (row.score.d1_all, d1) {
            assert!(
                (found - expected).abs() <= 150.0 / pixels as f64,
                "{name} D1"
            );
        }
    }
    assert!(
        expected.is_empty(),
        "bench has no row for {:?}",
        expected.keys()
    );
    assert!(rows.len() >= least, "{} rows", rows.len());
    eprintln!(
        "{split}: {} rows, largest relative difference {largest:.1e}",
        rows.len()
    );
}

/// A world with frames of both splits at a third of KITTI's size.
fn rendered() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let world = folder.path().join("world");
    let line = words(&[&"synth", &"--preset", &"tiny", &"--out", &world, &"--quiet"]);
    assert_eq!(Command::Prep.run(&line), 0);
    (folder, world)
}

#[test]
fn rows_of_rendered_frames_are_those_of_the_oracle() {
    let (_folder, world) = rendered();
    agrees(Split::Kitti, &world, 40);
    agrees(Split::Eigen, &world, 40);
}

#[test]
fn rows_of_real_frames_are_those_of_the_oracle() {
    let Some(samples) = std::env::var_os("STRAT_KITTI_SAMPLES") else {
        Need::KittiFrames.is_lacking("STRAT_KITTI_SAMPLES names no frames");
        return;
    };
    agrees(Split::Kitti, samples.as_ref(), 100);
    agrees(Split::Eigen, samples.as_ref(), 20);
}
