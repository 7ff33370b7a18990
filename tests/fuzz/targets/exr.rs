//! Depth files.
#![no_main]

mod damage;

use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use strat_store::exr::{DepthHeader, encode_depth, read_depth};
use strat_store::raster::Plane;
use tempfile::TempDir;

static VALID: LazyLock<Vec<u8>> = LazyLock::new(|| {
    let depth_m = Plane {
        width: 7,
        height: 19,
        data: (0..7 * 19).map(|i| (i % 11) as f32).collect(),
    };
    let header = DepthHeader {
        source: "velodyne".to_owned(),
        axis: "camera-z".to_owned(),
        focal_px: 721.5377,
        baseline_m: 0.5327,
        frame: "a/1".to_owned(),
    };
    encode_depth(&depth_m, &header).expect("a small plane is encoded")
});
static FOLDER: LazyLock<TempDir> = LazyLock::new(|| tempfile::tempdir().expect("a folder"));

fuzz_target!(|data: &[u8]| {
    let path = FOLDER.path().join("x.exr");
    std::fs::write(&path, damage::damaged(&VALID, data)).expect("a file is written");
    if let Ok((depth_m, _)) = read_depth(&path) {
        assert_eq!(depth_m.width * depth_m.height, depth_m.data.len());
    }
});
