//! Rows, leaderboards, names of protocols, and YAML of the user's own: protocols and descriptions.
#![no_main]

mod damage;

use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use strat_bench::{evaluate::predictions::SavedDescription, model::Description, protocol_file};
use strat_metrics::{ImageScore, Metrics, Row, RowContext, leaderboard, protocol, rows};
use strat_store::yaml;
use tempfile::TempDir;

static FOLDER: LazyLock<TempDir> = LazyLock::new(|| tempfile::tempdir().expect("a folder"));
static ROWS: LazyLock<Vec<u8>> = LazyLock::new(|| {
    let context = RowContext {
        model: "m".to_owned(),
        protocol: "kitti2015".to_owned(),
        protocol_digest: "d".to_owned(),
        data_digest: "e".to_owned(),
        ..RowContext::default()
    };
    let score = ImageScore {
        group: None,
        metrics: Metrics::default(),
        further: None,
        d1_all: Some(1.0),
        sum_squared_error: 2.0,
        pixels: 3,
        floored_pixels: 0,
        fit: None,
    };
    let made: Vec<Row> = (0..3)
        .map(|i| Row::new(&context, format!("a_drive_b/{i}"), score))
        .collect();
    let mut bytes = Vec::new();
    rows::write(&made, &mut bytes).expect("rows are written");
    bytes
});
static BOARD: LazyLock<Vec<u8>> = LazyLock::new(|| {
    let mut bytes = Vec::new();
    leaderboard::write(&leaderboard::published()[..3], &mut bytes).expect("lines are written");
    bytes
});
const PROTOCOL: &str = "name: mine\nbase: eigen-80\ncrop: none\nmax_depth_m: 60\n";
const DESCRIPTION: &str = "input: {width: 64, height: 32, range: 0..1, layout: nhwc}\n\
    output: {meaning: inverse_depth, scale: 5.4, sigmoid: {min_depth: 0.1, max_depth: 100}}\n";
const SAVED: &str = "meaning: disparity_px\npng_divisor: 256\narray: x\n";

fuzz_target!(|data: &[u8]| {
    let Some((which, data)) = data.split_first() else {
        return;
    };
    let path = FOLDER.path().join("x.yaml");
    let put = |valid: &str| {
        std::fs::write(&path, damage::damaged(valid.as_bytes(), data)).expect("written");
    };
    match which % 6 {
        0 => {
            if let Ok(read) = rows::read(damage::damaged(&ROWS, data).as_slice()) {
                let mut again = Vec::new();
                rows::write(&read, &mut again).expect("what was read is written");
                let reread = rows::read(again.as_slice()).expect("and read again");
                assert_eq!(reread.len(), read.len());
            }
        }
        1 => {
            let _ = leaderboard::read(damage::damaged(&BOARD, data).as_slice());
        }
        2 => {
            put(PROTOCOL);
            if let Ok(protocol) = protocol_file::load(&path) {
                assert!(!protocol.digest().is_empty());
            }
        }
        3 => {
            put(DESCRIPTION);
            let _ = yaml::load::<Description>(&path);
        }
        4 => {
            let name = String::from_utf8_lossy(data);
            if let Some(rules) = protocol(&name) {
                // Rows carry the canonical spelling.
                assert_eq!(protocol(&rules.name), Some(rules));
            }
        }
        _ => {
            put(SAVED);
            let _ = yaml::load::<SavedDescription>(&path);
        }
    }
});
