//! What preparing in parts means, for every collection alike.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Command, Output};

/// Every file below `root` by name.
pub fn tree(root: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut files = BTreeMap::new();
    let mut folders = vec![root.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                let name = path.strip_prefix(root).unwrap().display().to_string();
                files.insert(name, std::fs::read(path).unwrap());
            }
        }
    }
    files
}

pub fn assert_same_files(a: &Path, b: &Path) {
    let (a, b) = (tree(a), tree(b));
    assert!(a.keys().eq(b.keys()), "{:?}\n{:?}", a.keys(), b.keys());
    for (name, bytes) in &a {
        assert!(*bytes == b[name], "{name} differs");
    }
}

pub fn merge(out: &Path) -> Output {
    let mut prep = Command::new(env!("CARGO_BIN_EXE_prep"));
    prep.arg("merge").arg(out).output().unwrap()
}

/// Prepares with `command`, which is given the output folder and more options, once as a whole and
/// once in three parts in any order, the second one late; everything is then the same byte for byte.
/// `code` is the exit code of the whole.
pub fn assert_parts_make_the_whole(code: i32, command: impl Fn(&Path, &[&str]) -> Command) {
    let folder = tempfile::tempdir().unwrap();
    let (whole, parts) = (folder.path().join("whole"), folder.path().join("parts"));
    let run = |out: &Path, more: &[&str]| command(out, more).output().unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    let made = run(&whole, &[]);
    assert_eq!(made.status.code(), Some(code), "{}", text(&made.stderr));

    for shard in ["2/3", "0/3"] {
        let made = run(&parts, &["--shard", shard]);
        assert!(
            text(&made.stdout).contains(&format!("part {shard} of")),
            "{}{}",
            text(&made.stdout),
            text(&made.stderr)
        );
    }
    let early = merge(&parts);
    let told = text(&early.stderr);
    assert_eq!(early.status.code(), Some(1), "{told}");
    assert!(
        told.contains("1 of 3 parts") && told.contains("--shard 1/3"),
        "{told}"
    );
    assert!(!parts.join("manifest.yaml").exists(), "nothing was merged");
    run(&parts, &["--shard", "1/3"]);
    let merged = merge(&parts);
    assert_eq!(merged.status.code(), Some(code), "{}", text(&merged.stderr));
    assert_same_files(&whole, &parts);
}
