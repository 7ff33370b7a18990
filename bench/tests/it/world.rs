//! A prepared set in a folder of its own, and the `bench` command run over it.

use std::{fs, path::PathBuf};

use assert_cmd::Command;
use strat_metrics::{Row, rows};
use strat_splits::Split;

use crate::command::{Ran, run};
use crate::fixtures::write_set;

/// A folder with a set and a place for results.
pub struct World {
    pub folder: tempfile::TempDir,
}

impl World {
    pub fn new(split: Split, tests: u32, with_labels: bool) -> Self {
        let folder = tempfile::tempdir().unwrap();
        write_set(&folder.path().join("set"), split, tests, with_labels);
        Self { folder }
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// `bench --table TABLE --data set --out OUT --runtime embedded` and more arguments.
    pub fn bench(&self, table: &str, out: &str, more: &[&str]) -> Ran {
        let mut command = Command::cargo_bin("bench").unwrap();
        command
            .args(["--table", table, "--data"])
            .arg(self.path("set"))
            .arg("--out")
            .arg(self.path(out));
        if !more.contains(&"--runtime") {
            command.args(["--runtime", "embedded"]);
        }
        run(command.args(more))
    }

    pub fn rows(&self, out: &str) -> Vec<Row> {
        let file = fs::File::open(self.path(out).join("rows.csv")).unwrap();
        rows::read(file).unwrap()
    }
}
