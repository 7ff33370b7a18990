//! Manifest and tables of a prepared set.
#![no_main]

mod damage;

use std::path::Path;
use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use strat_splits::Role;
use strat_store::resize::Kernel;
use strat_store::set::{
    CameraEntry, Content, Count, FORMAT, FileRef, Manifest, PreparedSet, Sample,
};
use tempfile::TempDir;

struct Valid {
    folder: TempDir,
    set: PreparedSet,
    manifest: Vec<u8>,
    table: Vec<u8>,
}

static VALID: LazyLock<Valid> = LazyLock::new(|| {
    let folder = tempfile::tempdir().expect("a folder");
    let file = |path: &str| FileRef {
        path: path.to_owned(),
        blake3: "0".repeat(64),
    };
    let sample = |id: &str| Sample {
        right: Some(file("images/d/right/5.png")),
        depth_velodyne: Some(file("depth/velodyne/d/5.exr")),
        ..Sample::new(id, (1242, 375), 721.5377, 0.3, file("images/d/left/5.png"))
    };
    let manifest = Manifest {
        format: FORMAT,
        content: Content::Eigen,
        split_digest: Some("1".repeat(64)),
        source: "kitti".to_owned(),
        image_width: 512,
        image_height: 256,
        kernel: Kernel::Area,
        codec: "png".to_owned(),
        counts: [(
            Role::Train,
            Count {
                expected: 3,
                found: 2,
            },
        )]
        .into(),
        failures: 1,
        cameras: vec![CameraEntry {
            name: "2011_09_26".to_owned(),
            width: 1242,
            height: 375,
            focal_px: 721.5377,
            baseline_m: 0.5327,
        }],
        tool_version: "0.1.0".to_owned(),
        data_digest: String::new(),
    };
    let samples = [(Role::Train, vec![sample("a/1"), sample("a/2")])].into();
    let set = PreparedSet::write(folder.path(), manifest, &samples).expect("a set is written");
    let read = |name: &str| std::fs::read(folder.path().join(name)).expect("own file");
    let (manifest, table) = (read("manifest.yaml"), read("train.csv"));
    Valid {
        folder,
        set,
        manifest,
        table,
    }
});

fuzz_target!(|data: &[u8]| {
    let Some((which, data)) = data.split_first() else {
        return;
    };
    let put = |name: &str, bytes: &[u8]| {
        let path: &Path = VALID.folder.path();
        std::fs::write(path.join(name), bytes).expect("a file is written");
    };
    if which % 2 == 0 {
        put("manifest.yaml", &damage::damaged(&VALID.manifest, data));
        put("train.csv", &VALID.table);
        if let Ok(set) = PreparedSet::open(VALID.folder.path()) {
            assert_eq!(set.manifest.format, FORMAT);
        }
    } else {
        put("train.csv", &damage::damaged(&VALID.table, data));
        if let Ok(samples) = VALID.set.samples(Role::Train) {
            for sample in samples {
                for (_, file) in sample.files() {
                    // A path that leaves the folder would let a table read anything.
                    assert!(VALID.set.path(file).starts_with(VALID.folder.path()));
                    assert!(file.path.split('/').all(|part| part != ".."));
                }
            }
        }
    }
});
