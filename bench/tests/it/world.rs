//! A prepared set in a folder of its own, and the `bench` command run over it.

use std::{
    fs,
    path::{Path, PathBuf},
};

use assert_cmd::Command;
use strat_metrics::{Row, rows};
use strat_splits::Split;

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

pub struct Ran {
    pub code: i32,
    pub out: String,
    pub err: String,
}

impl Ran {
    #[track_caller]
    pub fn code(&self, code: i32) -> &Self {
        assert_eq!(
            self.code, code,
            "stdout:\n{}\nstderr:\n{}",
            self.out, self.err
        );
        self
    }

    #[track_caller]
    pub fn says(&self, text: &str) -> &Self {
        assert!(
            self.err.contains(text),
            "no {text:?} in stderr:\n{}",
            self.err
        );
        assert!(!self.err.contains("panicked"), "{}", self.err);
        self
    }
}

pub fn run(command: &mut Command) -> Ran {
    let output = command.output().unwrap();
    Ran {
        code: output.status.code().unwrap_or(-1),
        out: String::from_utf8(output.stdout).unwrap(),
        err: String::from_utf8(output.stderr).unwrap(),
    }
}

pub fn text(path: &Path) -> String {
    path.to_str().unwrap().to_owned()
}
