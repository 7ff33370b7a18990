//! The workflow that `bench leaderboard init` writes, step by step as a host runs it.

use std::ffi::OsString;
use std::path::Path;
use std::{env, fs, process};

use serde_yaml::Value;

use crate::command::{bench, text};

/// The commands of the workflow's first job, and the address that it builds `bench` from.
fn workflow(board: &Path) -> (Vec<String>, String) {
    let text = fs::read_to_string(board.join(".github/workflows/leaderboard.yml")).unwrap();
    let workflow: Value = serde_yaml::from_str(&text).unwrap();
    let steps = workflow["jobs"]["check"]["steps"].as_sequence().unwrap();
    let commands = steps
        .iter()
        .filter_map(|step| Some(step.get("run")?.as_str()?.to_owned()));
    let address = workflow["env"]["STRAT"].as_str().unwrap().to_owned();
    (commands.collect(), address)
}

/// Runs a step as the hosts do, with the built `bench` in the path or with nothing but the shell's.
fn step(board: &Path, command: &str, with_bench: bool) -> process::Output {
    let built = assert_cmd::cargo::cargo_bin("bench");
    let own = built.parent().unwrap().as_os_str();
    let mut path = OsString::from("/usr/bin:/bin");
    if with_bench {
        path = env::join_paths([Path::new(own), Path::new("/usr/bin"), Path::new("/bin")]).unwrap();
    }
    process::Command::new("/bin/bash")
        .args(["-e", "-o", "pipefail", "-c", command])
        .current_dir(board)
        .env("PATH", path)
        .env("STRAT", "")
        .output()
        .unwrap()
}

#[test]
fn the_workflow_of_a_new_leaderboard_runs() {
    let folder = tempfile::tempdir().unwrap();
    let board = folder.path().join("board");
    let address = "https://example.org/somebody/strat";
    bench(&["leaderboard", "init", &text(&board), "--strat", address])
        .code(0)
        .says("next: name the data sets");
    let (commands, named) = workflow(&board);
    assert_eq!(named, address);
    assert_eq!(commands.len(), 3);
    for command in &commands {
        let ran = step(&board, command, true);
        let said = String::from_utf8_lossy(&ran.stderr);
        assert!(ran.status.success(), "{command}: {said}");
    }
    assert!(board.join("site/index.html").is_file());
    // Without bench and without an address it says what is missing.
    let ran = step(&board, &commands[0], false);
    let said = String::from_utf8_lossy(&ran.stderr);
    assert_eq!(ran.status.code(), Some(1));
    assert!(
        said.contains("STRAT is empty: write the git address"),
        "{said}"
    );
    let other = folder.path().join("other");
    bench(&["leaderboard", "init", &text(&other)])
        .code(0)
        .says("write the git address of strat into");
    assert_eq!(workflow(&other).1, "${{ vars.STRAT }}");
}
