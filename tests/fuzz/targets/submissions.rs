//! A leaderboard's folder: what its maintainers write and what contributors submit.
#![no_main]

mod damage;

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use strat_leaderboard::{check::check, publish::publish};
use strat_metrics::{ImageScore, Metrics, Row, RowContext, protocol, rows};
use strat_splits::{Split, test_ids};
use tempfile::TempDir;

const PROTOCOL: &str = "eigen-80";
const IMAGES: usize = 3;

/// A leaderboard with one submission and one published row, and its files by their paths.
struct Valid {
    folder: TempDir,
    files: BTreeMap<String, Vec<u8>>,
}

static VALID: LazyLock<Valid> = LazyLock::new(|| {
    let folder = tempfile::tempdir().expect("a folder");
    let put = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        std::fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
        std::fs::write(path, bytes).expect("a file");
    };
    let rules = protocol(PROTOCOL).expect("a protocol");
    let data_digest = "0f".repeat(32);
    let board = format!(
        "strat_leaderboard: 1\ntitle: A board\ndata:\n  - {{digest: {data_digest}, name: A set, source: kitti, \
         split: eigen, images: {IMAGES}}}\n"
    );
    put("board/leaderboard.yaml", board.as_bytes());
    let published = "method,protocol,group,supervision,citation,abs_rel,sq_rel,rmse,rmse_log,a1,a2,a3,silog,log10,note\n\
        Somebody [1],eigen-80,,stereo,\"Somebody 2018, Table 1\",0.1,1,5,0.2,0.8,0.9,0.95,,,\n";
    put("board/published/some.csv", published.as_bytes());
    let record = format!(
        "tool: bench\ntool_version: 0.1.0\narguments: []\n\
         data: {{path: sets/eigen, source: kitti, data_digest: {data_digest}, test_images_expected: 697, \
         test_images_found: {IMAGES}}}\ndevice: cpu\n\
         models:\n- {{name: m, file: m.onnx, blake3: abc, parameters: 7, runtime: embedded, provider: cpu, \
         metadata: {{split: eigen, train_drives: [2011_09_26_drive_0001], seed: 3}}}}\n\
         protocols: [{{name: {PROTOCOL}, digest: {}}}]\nwarnings: []\nfailures: 0\n",
        rules.digest()
    );
    put("run/run.yaml", record.as_bytes());
    let context = RowContext {
        model: "m".to_owned(),
        model_hash: "abc".to_owned(),
        protocol: PROTOCOL.to_owned(),
        protocol_digest: rules.digest(),
        data_digest,
        split: "eigen".to_owned(),
        runtime: "embedded".to_owned(),
        provider: "cpu".to_owned(),
        tool_version: "0.1.0".to_owned(),
        ..RowContext::default()
    };
    let score = ImageScore {
        group: None,
        metrics: Metrics {
            abs_rel: 0.1,
            sq_rel: 0.5,
            rmse: 3.0,
            rmse_log: 0.2,
            a1: 0.8,
            a2: 0.9,
            a3: 1.0,
        },
        further: None,
        d1_all: None,
        sum_squared_error: 90.0,
        pixels: 10,
        floored_pixels: 0,
        fit: None,
    };
    let row = |image: String| Row::new(&context, image, score);
    let made: Vec<Row> = test_ids(Split::Eigen)
        .into_iter()
        .take(IMAGES)
        .map(row)
        .collect();
    let mut bytes = Vec::new();
    rows::write(&made, &mut bytes).expect("rows are written");
    put("run/rows.csv", &bytes);
    let own = folder.path().join("board/submissions/m");
    publish(&folder.path().join("run/rows.csv"), None, &own).expect("a submission");
    let names = [
        "leaderboard.yaml",
        "published/some.csv",
        "submissions/m/run.yaml",
        "submissions/m/card.yaml",
        "submissions/m/leaderboard.csv",
        "submissions/m/rows.csv.gz",
    ];
    let read =
        |name: &str| std::fs::read(folder.path().join("board").join(name)).expect("own file");
    let mut files: BTreeMap<String, Vec<u8>> =
        names.map(|name| (name.to_owned(), read(name))).into();
    files.insert("submissions/m/rows.csv".to_owned(), bytes);
    Valid { folder, files }
});

fuzz_target!(|data: &[u8]| {
    let Some((which, data)) = data.split_first() else {
        return;
    };
    let board = VALID.folder.path().join("board");
    let path = |name: &str| board.join(name);
    let write = |path: &Path, bytes: &[u8]| std::fs::write(path, bytes).expect("written");
    let chosen = usize::from(*which) % VALID.files.len();
    let Some((name, valid)) = VALID.files.iter().nth(chosen) else {
        return;
    };
    let is_plain = name.ends_with("rows.csv");
    // A submission has its rows once, packed or plain.
    if is_plain {
        std::fs::remove_file(path("submissions/m/rows.csv.gz")).expect("removed");
    }
    write(&path(name), &damage::damaged(valid, data));
    if let Ok(checked) = check(&board, true) {
        for problem in &checked.problems {
            assert!(!problem.sentence.is_empty());
            // What a log of somebody's server shows.
            assert!(!problem.to_string().contains(['\n', '\u{1b}', '\0']));
        }
    }
    if is_plain {
        std::fs::remove_file(path(name)).expect("removed");
        write(
            &path("submissions/m/rows.csv.gz"),
            &VALID.files["submissions/m/rows.csv.gz"],
        );
    } else {
        write(&path(name), valid);
    }
});
