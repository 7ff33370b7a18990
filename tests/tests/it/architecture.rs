//! Holds the rules of ARCHITECTURE.md against `cargo metadata` and the sources.

use std::collections::{BTreeMap, BTreeSet};
use std::process::Command;

use crate::sources::files;

/// Normal and build dependencies of every workspace member, by package name.
fn dependencies() -> BTreeMap<String, BTreeSet<String>> {
    let output = Command::new(env!("CARGO"))
        .args([
            "metadata",
            "--format-version",
            "1",
            "--no-deps",
            "--offline",
            "--manifest-path",
            concat!(env!("CARGO_MANIFEST_DIR"), "/Cargo.toml"),
        ])
        .output()
        .expect("cargo runs");
    assert!(
        output.status.success(),
        "cargo metadata: {}",
        String::from_utf8_lossy(&output.stderr)
    );
    let metadata: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let packages = metadata["packages"].as_array().expect("packages");
    packages
        .iter()
        .map(|package| {
            let uses = package["dependencies"]
                .as_array()
                .expect("dependencies")
                .iter()
                .filter(|d| d["kind"].as_str() != Some("dev"))
                .map(|d| d["name"].as_str().expect("name").to_owned())
                .collect();
            (package["name"].as_str().expect("name").to_owned(), uses)
        })
        .collect()
}

#[test]
fn crates_use_only_what_the_architecture_allows() {
    let allowed: BTreeMap<&str, &[&str]> = BTreeMap::from([
        ("strat-splits", &[][..]),
        ("strat-csv", &[]),
        ("strat-geometry", &[]),
        ("strat-store", &["strat-splits", "strat-csv"]),
        ("strat-onnx", &[]),
        ("strat-metrics", &["strat-splits", "strat-csv"]),
        (
            "strat-leaderboard",
            &["strat-splits", "strat-csv", "strat-store", "strat-metrics"],
        ),
        ("strat-needs", &[]),
        (
            "strat-prep",
            &["strat-splits", "strat-csv", "strat-geometry", "strat-store"],
        ),
        (
            "strat-train",
            &[
                "strat-splits",
                "strat-csv",
                "strat-geometry",
                "strat-store",
                "strat-onnx",
                "strat-metrics",
            ],
        ),
        (
            "strat-bench",
            &[
                "strat-splits",
                "strat-csv",
                "strat-geometry",
                "strat-store",
                "strat-onnx",
                "strat-metrics",
                "strat-leaderboard",
            ],
        ),
        (
            "strat-python",
            &[
                "strat-splits",
                "strat-geometry",
                "strat-store",
                "strat-onnx",
                "strat-metrics",
                "strat-prep",
                "strat-bench",
            ],
        ),
    ]);
    let all = dependencies();
    for (name, uses) in &all {
        let Some(allowed) = allowed.get(name.as_str()) else {
            assert_eq!(name, "strat-tests", "a crate without a rule: {name}");
            continue;
        };
        for used in uses.iter().filter(|used| used.starts_with("strat-")) {
            assert!(
                allowed.contains(&used.as_str()),
                "{name} must not depend on {used}"
            );
        }
    }
    assert_eq!(all.len(), allowed.len() + 1, "every rule has its crate");
}

#[test]
fn heavy_libraries_stay_in_their_crate() {
    for (library, home) in [
        ("burn", "strat-train"),
        ("ort", "strat-bench"),
        ("rten", "strat-onnx"),
        ("exr", "strat-store"),
        ("pyo3", "strat-python"),
    ] {
        assert_eq!(users_of(library), [home], "only {home} knows {library}");
    }
}

fn users_of(library: &str) -> Vec<String> {
    dependencies()
        .into_iter()
        .filter(|(_, uses)| uses.contains(library))
        .map(|(name, _)| name)
        .collect()
}

/// So that no table has cells that a spreadsheet runs. `prep` reads lists of the user's own.
#[test]
fn tables_are_written_by_one_crate() {
    assert_eq!(users_of("csv"), ["strat-csv", "strat-prep"]);
}

#[test]
fn pure_crates_do_no_input_or_output() {
    let all = dependencies();
    for pure in [
        "strat-csv",
        "strat-geometry",
        "strat-metrics",
        "strat-splits",
    ] {
        for library in ["fs-err", "image", "rayon", "tempfile", "indicatif"] {
            assert!(
                !all[pure].contains(library),
                "{pure} is pure and must not use {library}"
            );
        }
    }
}

/// What libraries of platforms compute to different last bits is in no metric, so rows are the same everywhere.
#[test]
fn metrics_are_the_same_on_every_machine() {
    let inexact = [
        ".ln()",
        ".ln_1p()",
        ".log2()",
        ".log10()",
        ".exp()",
        ".exp_m1()",
        ".powf(",
        ".sin()",
        ".cos()",
        ".tan()",
    ];
    let of_metrics = files(&["rs"]).into_iter().filter(|(path, _)| {
        let is_test = path.to_string_lossy().ends_with("tests.rs");
        path.starts_with("bench/metrics/src") && !is_test
    });
    let mut count = 0;
    for (path, text) in of_metrics {
        let code = text.split("#[cfg(test)]\nmod tests {").next();
        for name in inexact {
            assert!(
                !code.is_some_and(|code| code.contains(name)),
                "{name} in {}",
                path.display()
            );
        }
        count += 1;
    }
    assert!(count > 20, "{count} files were looked through");
}

/// Packages that are compiled for some of the workspace, with the features switched on in them.
fn features(of: &[&str]) -> BTreeSet<String> {
    let output = Command::new(env!("CARGO"))
        .args(["tree", "--offline", "--locked", "--prefix", "none"])
        .args(["--edges", "normal,build,dev", "--format", "{p} [{f}]"])
        .args(of)
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .expect("cargo runs");
    let told = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "cargo tree: {told}");
    let tree = String::from_utf8(output.stdout).expect("UTF-8");
    let packages = tree.lines().map(|line| line.trim_end_matches(" (*)"));
    packages.map(str::to_owned).collect()
}

/// With other features in shared packages, `cargo demo` would compile them, and what is made of them, again.
#[test]
fn the_demo_is_built_from_what_the_tests_are_built_from() {
    let demo = features(&["--package", "strat-tests"]);
    let tests = features(&["--workspace"]);
    let own: Vec<&String> = demo.difference(&tests).collect();
    assert!(!demo.is_empty() && own.is_empty(), "{own:#?}");
}
