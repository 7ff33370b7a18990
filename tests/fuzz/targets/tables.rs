//! Tables that other programs may have touched (CSV, latencies, cues), records of runs, sprites of the
//! user's own, and entries of archives.
#![no_main]

mod damage;

use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use strat_bench::{cues::rows as cue_rows, cues::sprites, evaluate::record::RunRecord, latency};
use strat_csv::{Reader, guarded, unguarded};
use strat_prep::input::source::{self, Source};
use strat_store::{inputs::Kind, yaml};
use tempfile::TempDir;

static FOLDER: LazyLock<TempDir> = LazyLock::new(|| tempfile::tempdir().expect("a folder"));

const SPRITES: &str = "sprites:\n  - {file: car.png, name: car, familiar: true, height_m: 1.5}\n";
const RECORD: &str = "tool: bench\ntool_version: 0.1.0\narguments: []\ndevice: cpu\nruntime: none\n\
    runtime_library: null\njobs: 1\nthreads: 2\nmodels: []\nprotocols: []\nwarnings: []\nfailures: 0\n\
    data: {path: a, source: rendered, content: kitti, data_digest: e, test_images_expected: 1, \
    test_images_found: 1, prepared_by: 0.1.0}\n";

fuzz_target!(|data: &[u8]| {
    let Some((which, data)) = data.split_first() else {
        return;
    };
    let put = |name: &str, bytes: &[u8]| {
        let path = FOLDER.path().join(name);
        std::fs::write(&path, bytes).expect("written");
        path
    };
    match which % 6 {
        0 => {
            for row in Reader::without_header(data).records() {
                let Ok(row) = row else { return };
                for cell in &row {
                    assert_eq!(unguarded(&guarded(cell)), cell);
                }
            }
        }
        1 => {
            let _ = latency::read_rows(data);
        }
        2 => {
            put(cue_rows::ROWS, data);
            let _ = cue_rows::read(FOLDER.path());
        }
        3 => {
            let path = put("run.yaml", &damage::damaged(RECORD.as_bytes(), data));
            let _ = yaml::load::<RunRecord>(&path);
        }
        4 => {
            put(
                sprites::DESCRIPTION,
                &damage::damaged(SPRITES.as_bytes(), data),
            );
            put("car.png", data);
            let _ = sprites::read_folder(FOLDER.path());
        }
        _ => {
            let path = put("p.zip", data);
            for entry in source::entries(&path, |_| true).unwrap_or_default() {
                let _ = Source::Entry(entry).read(Kind::Image);
            }
        }
    }
});
