//! The whole evaluation against an independent one in numpy, on real frames.
//!
//! `STRAT_ORACLE` names the folder of `oracle.py`, `STRAT_KITTI_SAMPLES` one with `kitti_raw/` and
//! `kitti2015/`; needs python3 with numpy. The predictions are closed formulas, saved as an array:
//! reading them, resizing, ground truth, crops, caps, median scaling and metrics are all compared,
//! image by image. Golden values of the same oracle stand in strat-metrics and need none of this.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

use strat_metrics::rows;
use strat_needs::Need;
use strat_splits::{Role, Split};
use strat_store::set::PreparedSet;
use strat_tests::steps::Command;

/// Seven metrics, and D1-all where there is disparity, by protocol and image.
type Expected = BTreeMap<String, BTreeMap<String, Vec<f64>>>;

fn folders() -> Option<(PathBuf, PathBuf)> {
    let named = ["STRAT_ORACLE", "STRAT_KITTI_SAMPLES"].map(std::env::var_os);
    let [Some(oracle), Some(samples)] = named else {
        Need::KittiFrames
            .is_lacking("STRAT_ORACLE and STRAT_KITTI_SAMPLES name no oracle and no frames");
        return None;
    };
    Some((oracle.into(), samples.into()))
}

fn words(words: &[&dyn AsRef<std::ffi::OsStr>]) -> Vec<OsString> {
    words.iter().map(|word| word.as_ref().to_owned()).collect()
}

fn agrees(split: Split, oracle: &Path, samples: &Path) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let set = folder.path().join("set");
    let mut prepare = words(&[
        &split.as_str(),
        &"--raw",
        &samples.join("kitti_raw"),
        &"--out",
        &set,
        &"--allow-missing",
        &"--test-only",
        &"--quiet",
    ]);
    if split == Split::Kitti {
        prepare.extend(words(&[&"--stereo2015", &samples.join("kitti2015")]));
    }
    assert_eq!(Command::Prep.run(&prepare), 0);
    let tests = PreparedSet::open(&set)
        .and_then(|set| set.samples(Role::Test))
        .expect("test samples");
    let ids: Vec<&str> = tests.iter().map(|sample| sample.id.as_str()).collect();
    let list = folder.path().join("ids.txt");
    std::fs::write(&list, ids.join("\n")).expect("a list");
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("peers/oracle_expected.py");
    let python = std::process::Command::new("python3")
        .arg(script)
        .args([oracle, samples, &list, folder.path()])
        .status()
        .expect("python3 runs");
    assert!(python.success(), "python3 with numpy is needed");
    let text = std::fs::read_to_string(folder.path().join("expected.json")).expect("figures");
    let expected: Expected = serde_json::from_str(&text).expect("figures");

    let out = folder.path().join("out");
    let mut line = words(&[
        &"--table",
        &"all",
        &"--data",
        &set,
        &"--predictions",
        &folder.path().join("predictions.npy"),
        &"--out",
        &out,
        &"--quiet",
    ]);
    for protocol in expected.keys() {
        line.extend(words(&[&"--protocol", protocol]));
    }
    // Samples may lack one of the two maps of an image, which `bench` calls a failure.
    let whole = expected.values().all(|images| images.len() == ids.len());
    assert_eq!(Command::Bench.run(&line), u8::from(!whole));
    let file = std::fs::File::open(out.join("rows.csv")).expect("rows");
    let rows = rows::read(file).expect("rows");
    let (mut compared, mut largest) = (0, 0.0_f64);
    for row in rows.iter().filter(|row| row.score.group.is_none()) {
        let Some(images) = expected.get(&row.context.protocol) else {
            continue;
        };
        let values = &images[&row.image];
        compared += 1;
        let name = format!("{} {}", row.context.protocol, row.image);
        let found = row.score.metrics.to_array();
        for (at, (found, expected)) in found.iter().zip(values).enumerate() {
            // Shares of pixels may differ by a pixel that lies on the threshold.
            let allowed = if at < 4 {
                1e-6 * expected.abs().max(1.0)
            } else {
                1.5 / row.score.pixels as f64
            };
            let difference = (found - expected).abs();
            assert!(difference <= allowed, "{name} {at}: {found}, {expected}");
            if at < 4 {
                largest = largest.max(difference / expected.abs());
            }
        }
        if let (Some(found), Some(expected)) = (row.score.d1_all, values.get(7)) {
            let allowed = 150.0 / row.score.pixels as f64;
            assert!((found - expected).abs() <= allowed, "{name} D1");
        }
    }
    assert_eq!(
        compared,
        expected.values().map(BTreeMap::len).sum::<usize>()
    );
    eprintln!(
        "{split}: {compared} images and protocols, largest relative difference {largest:.1e}"
    );
}

#[test]
fn figures_of_the_kitti_split_are_those_of_the_oracle() {
    let Some((oracle, samples)) = folders() else {
        return;
    };
    agrees(Split::Kitti, &oracle, &samples);
}

#[test]
fn figures_of_the_eigen_split_are_those_of_the_oracle() {
    let Some((oracle, samples)) = folders() else {
        return;
    };
    agrees(Split::Eigen, &oracle, &samples);
}
