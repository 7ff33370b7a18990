//! Real KITTI frames through `prep`, where a folder with them is named.
//!
//! `STRAT_KITTI_SAMPLES` names a folder with `kitti_raw/` and `kitti2015/` in KITTI's layouts; no
//! frame of KITTI is part of the repository. The counts below are facts about the published files.

use std::ffi::OsString;
use std::path::PathBuf;

use strat_needs::Need;
use strat_splits::Role;
use strat_store::{exr, set::PreparedSet};
use strat_tests::steps::Command;

fn samples() -> Option<PathBuf> {
    match std::env::var_os("STRAT_KITTI_SAMPLES") {
        Some(folder) => Some(folder.into()),
        None => {
            Need::KittiFrames
                .is_lacking("STRAT_KITTI_SAMPLES names no folder with real KITTI frames");
            None
        }
    }
}

#[test]
fn stereo_2015_ground_truth_survives_preparation_exactly() {
    let Some(samples) = samples() else { return };
    let folder = tempfile::tempdir().expect("a temporary folder");
    let out = folder.path().join("kitti");
    let mut line: Vec<OsString> = vec!["kitti".into()];
    for (flag, value) in [
        ("--raw", samples.join("kitti_raw")),
        ("--stereo2015", samples.join("kitti2015")),
        ("--out", out.clone()),
    ] {
        line.extend([flag.into(), value.into_os_string()]);
    }
    line.extend(["--allow-missing".into(), "--quiet".into()]);
    assert_eq!(Command::Prep.run(&line), 0);

    let set = PreparedSet::open(&out).expect("a prepared set");
    assert_eq!(set.manifest.source, "kitti");
    let tests = set.samples(Role::Test).expect("test samples");
    let sample = tests
        .iter()
        .find(|sample| sample.id == "kitti2015/000006")
        .expect("image 000006 is among the samples");
    assert_eq!((sample.width, sample.height), (1242, 375));
    // Measured pixels of the two published maps of this image.
    for (file, pixels) in [
        (&sample.depth_noc, 109_779),
        (&sample.depth_occ, 109_779 + 1_547),
    ] {
        let file = file.as_ref().expect("the map is there");
        let (depth_m, header) = exr::read_depth(&set.path(file)).expect("a depth file");
        let valid: Vec<f64> = depth_m
            .data
            .iter()
            .filter(|depth| **depth > 0.0)
            .map(|depth| f64::from(*depth))
            .collect();
        assert_eq!(valid.len(), pixels);
        assert_eq!((header.focal_px, header.baseline_m), (721.5377, 0.54));
        // KITTI stores disparities as multiples of 1/256 pixel: they must come back as such.
        for depth in valid {
            let steps = 256.0 * header.focal_px * header.baseline_m / depth;
            assert!((steps - steps.round()).abs() < 0.01, "{steps}");
        }
    }
}
