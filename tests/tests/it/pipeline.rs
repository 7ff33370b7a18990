//! The whole way on the smallest rendered world: every step of the demo, with the real networks,
//! files and runtimes, at a size that takes seconds.
//!
//! Not here: whether the model learns. Three steps of training cannot; `cargo demo` shows it.

use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};

use strat_bench::runtime::install::{Availability, ensure_runtime};
use strat_metrics::Row;
use strat_needs::Need;
use strat_tests::steps::{Command, Plan};

/// Options that make a training small enough for a test.
pub fn small_training() -> Vec<OsString> {
    let sets = [
        "input.width=128",
        "input.height=64",
        "discriminator.patch=64",
        "network.width=1/16",
        "discriminator.width=1/16",
        "batch=2",
        "validation.images=2",
    ];
    let mut arguments: Vec<OsString> = vec!["--max-steps".into(), "3".into()];
    for set in sets {
        arguments.extend(["--set".into(), set.into()]);
    }
    arguments.push("--quiet".into());
    arguments
}

/// A configuration small enough for a test; everything not named is the demo's.
fn plan(out: &Path, runtime: &str) -> Plan {
    Plan {
        out: out.to_owned(),
        world: "tiny".into(),
        config: "demo".into(),
        train_arguments: small_training(),
        bench_arguments: vec!["--runtime".into(), runtime.into(), "--quiet".into()],
    }
}

fn rows(folder: PathBuf) -> Vec<Row> {
    let path = folder.join("rows.csv");
    let file = fs::File::open(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    strat_metrics::rows::read(file).expect("rows.csv is valid")
}

fn first_line(path: &Path) -> String {
    let text = fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    text.lines().next().unwrap_or_default().to_owned()
}

#[test]
fn from_a_rendered_world_to_tables() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let plan = plan(folder.path(), "embedded");
    for step in plan.steps() {
        assert_eq!(step.command.run(&step.arguments), 0, "{}", step.line());
    }

    let table = plan.kitti_results().join("table_3_1.txt");
    let line = first_line(&table);
    assert!(
        line.contains("of 200 images"),
        "the first line tells the coverage: {line}"
    );
    for name in [
        "table_3_1.md",
        "table_3_1.tex",
        "table_3_2.csv",
        "leaderboard.csv",
        "run.yaml",
    ] {
        assert!(
            plan.kitti_results().join(name).is_file(),
            "{name} is written"
        );
    }
    assert!(first_line(&plan.eigen_results().join("table_3_3.txt")).contains("of 697 images"));

    let page = fs::read_to_string(plan.report()).expect("the page is written");
    for text in [
        "Table 3.1",
        "Table 3.2",
        "Table 3.3",
        "Abs Rel against distance",
    ] {
        assert!(page.contains(text), "{text} stands on the page");
    }

    let eigen = rows(plan.eigen_results());
    for model in ["StrAT", "Median depth (constant)"] {
        for protocol in ["eigen-80", "eigen-50"] {
            let found = eigen
                .iter()
                .filter(|row| row.context.model == model && row.context.protocol == protocol)
                .count();
            assert!(found >= 3, "{model} under {protocol}: {found} rows");
        }
    }
    assert!(
        eigen
            .iter()
            .all(|row| row.score.metrics.abs_rel.is_finite() && row.score.pixels > 0),
        "every row has figures"
    );

    // A second run of a finished preparation does nothing and says the same.
    let manifest = |split: &str| fs::read(folder.path().join(split).join("manifest.yaml")).unwrap();
    let before = (manifest("kitti"), manifest("eigen"));
    for step in plan.steps().iter().take(3) {
        assert_eq!(step.command.run(&step.arguments), 0, "{}", step.line());
    }
    assert!(before == (manifest("kitti"), manifest("eigen")));

    // ONNX Runtime computes what the embedded runtime computes.
    match ensure_runtime() {
        Availability::Unavailable(reason) => {
            Need::OnnxRuntime.is_lacking(reason);
        }
        Availability::Ready(_) => {
            let out = folder.path().join("ort");
            let mut arguments: Vec<OsString> = ["--table", "3.3", "--runtime", "ort", "--quiet"]
                .map(OsString::from)
                .to_vec();
            let mut model = OsString::from("StrAT=");
            model.push(folder.path().join("run").join("model.onnx"));
            for (flag, value) in [
                ("--data", folder.path().join("eigen").into_os_string()),
                ("--model", model),
                ("--out", out.clone().into_os_string()),
            ] {
                arguments.extend([OsString::from(flag), value]);
            }
            assert_eq!(Command::Bench.run(&arguments), 0);
            let record = fs::read_to_string(out.join("run.yaml")).expect("run.yaml");
            assert!(!record.contains("PROBE FAILED"), "{record}");
            let mut compared = 0;
            for ours in rows(out) {
                let embedded = eigen
                    .iter()
                    .find(|row| {
                        (&row.context.model, &row.context.protocol, &row.image)
                            == (&ours.context.model, &ours.context.protocol, &ours.image)
                    })
                    .expect("the same image was evaluated");
                let (a, b) = (ours.score.metrics.abs_rel, embedded.score.metrics.abs_rel);
                assert!((a - b).abs() < 1e-3 * b, "{}: {a} and {b}", ours.image);
                compared += 1;
            }
            assert!(compared >= 6, "{compared} rows compared");
        }
    }
}
