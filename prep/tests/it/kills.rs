//! Every change to the file system is a place where a process may be killed: each is tried, and the next
//! run must end with the bytes of one that nothing happened to.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Output;

use assert_cmd::Command;
use image::{Rgb, RgbImage};
use strat_store::fault;
use strat_store::image_files;
use tempfile::TempDir;

use crate::world::{World, assert_has, tree};

/// Two pairs, one of them with ground truth, and the list of them.
struct Pairs(TempDir);

impl Pairs {
    fn new() -> Self {
        let pairs = Self(TempDir::new().unwrap());
        for name in ["l0", "r0", "l1", "r1"] {
            let image = RgbImage::from_fn(20, 12, |x, y| Rgb([x as u8 * 9, y as u8 * 7, 3]));
            pairs.write(name, &image_files::encode_png_rgb(&image));
        }
        pairs.write(
            "depth",
            &image_files::encode_png_gray16(20, 12, &[5120; 20 * 12]),
        );
        let list = "left,right,focal_px,baseline_m,split,depth\n\
                    l0.png,r0.png,30,0.5,train,\nl1.png,r1.png,30,0.5,test,depth.png\n";
        std::fs::write(pairs.list(), list).unwrap();
        pairs
    }

    fn write(&self, name: &str, png: &[u8]) {
        std::fs::write(self.0.path().join(name).with_extension("png"), png).unwrap();
    }

    fn list(&self) -> PathBuf {
        self.0.path().join("pairs.csv")
    }

    /// `prep pairs` into a folder, killed before or after the `fault`-th change if one is given.
    fn prepare(&self, out: &Path, more: &[&str], fault: Option<u64>) -> Output {
        let (list, out) = (self.list(), out.to_str().unwrap());
        let mut args = vec!["pairs", "--csv", list.to_str().unwrap(), "--out", out];
        args.extend(["--width", "16", "--height", "8", "--jobs", "1", "--quiet"]);
        args.extend(more);
        prep(&args, fault)
    }
}

fn prep(args: &[&str], fault: Option<u64>) -> Output {
    let mut command = Command::cargo_bin("prep").unwrap();
    command.args(args).env_remove(fault::AT);
    if let Some(number) = fault {
        command.env(fault::AT, number.to_string());
    }
    command.output().unwrap()
}

fn assert_done(output: &Output, what: &str) {
    let text = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{what}: {text}");
}

/// Kills `run` at every change in turn, each time in a fresh folder that `begin` has filled, runs it
/// again and compares; the number of changes.
fn try_all(
    reference: &BTreeMap<PathBuf, Vec<u8>>,
    begin: impl Fn(&Path),
    run: impl Fn(&Path, Option<u64>) -> Output,
    again: impl Fn(&Path, u64),
) -> u64 {
    for number in 1.. {
        let folder = TempDir::new().unwrap();
        let out = folder.path().join("out");
        begin(&out);
        if run(&out, Some(number)).status.code().is_some() {
            return number - 1;
        }
        again(&out, number);
        assert!(
            tree(&out) == *reference,
            "killed at change {number}: {:?} instead of {:?}",
            tree(&out).keys(),
            reference.keys()
        );
    }
    unreachable!()
}

#[test]
fn a_killed_preparation_goes_on_wherever_it_was() {
    let pairs = Pairs::new();
    let folder = TempDir::new().unwrap();
    let whole = folder.path().join("whole");
    assert_done(&pairs.prepare(&whole, &[], None), "undisturbed");
    let changes = try_all(
        &tree(&whole),
        |_| {},
        |out, fault| pairs.prepare(out, &[], fault),
        |out, number| {
            assert_done(
                &pairs.prepare(out, &[], None),
                &format!("after a kill at {number}"),
            );
            let verified = prep(&["verify", out.to_str().unwrap()], None);
            assert_done(&verified, &format!("verify after a kill at {number}"));
        },
    );
    // Six pictures, depth, three tables, settings, manifest: begun, written and renamed.
    assert!(changes >= 36, "{changes}");
}

#[test]
fn a_killed_merge_loses_nothing() {
    let pairs = Pairs::new();
    let folder = TempDir::new().unwrap();
    let whole = folder.path().join("whole");
    assert_done(&pairs.prepare(&whole, &[], None), "undisturbed");
    let merge = |out: &Path, fault| prep(&["merge", out.to_str().unwrap()], fault);
    let changes = try_all(
        &tree(&whole),
        |out| {
            for shard in ["0/2", "1/2"] {
                assert_done(&pairs.prepare(out, &["--shard", shard], None), shard);
            }
        },
        merge,
        |out, number| {
            let output = merge(out, None);
            let text = String::from_utf8_lossy(&output.stderr);
            let finished = text.contains("nothing is left to merge");
            assert!(output.status.success() || finished, "{number}: {text}");
        },
    );
    assert!(changes > 14, "{changes}");
}

#[test]
fn files_that_belong_to_no_part_stay() {
    let pairs = Pairs::new();
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("set");
    for shard in ["0/2", "1/2"] {
        assert_done(&pairs.prepare(&out, &["--shard", shard], None), shard);
    }
    let notes = out.join("parts/0001-of-0002/notes.txt");
    std::fs::write(&notes, "mine").unwrap();
    let merged = prep(&["merge", out.to_str().unwrap()], None);
    assert_done(&merged, "merge");
    assert!(String::from_utf8_lossy(&merged.stderr).contains("notes.txt belongs to no part"));
    assert_eq!(std::fs::read(&notes).unwrap(), b"mine");
    assert!(!out.join("parts/0000-of-0002").exists());
}

#[test]
fn what_is_half_written_is_no_obstacle() {
    let pairs = Pairs::new();
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("set");
    std::fs::create_dir_all(&out).unwrap();
    std::fs::write(out.join(".unfinished-q1W2e3"), "format: 2\nsource").unwrap();
    assert_done(&pairs.prepare(&out, &[], None), "beside a leftover");
    let leftover = out.join("images/.unfinished-a1B2c3");
    std::fs::write(&leftover, "half a picture").unwrap();
    let verified = prep(&["verify", out.to_str().unwrap()], None);
    assert_done(&verified, "verify beside a leftover");
    assert_done(&pairs.prepare(&out, &[], None), "again");
    assert!(!leftover.exists() && !out.join(".unfinished-q1W2e3").exists());
}

#[test]
fn paths_are_resolved_before_they_are_compared() {
    let world = World::new();
    let before = tree(&world.path("."));
    let outcome = world.eigen("none/../none/deeper/../../raw/set", &["--allow-missing"]);
    assert_eq!(outcome.code, 2, "{}", outcome.stderr);
    assert_has(&outcome.stderr, &["inside the input folder"]);
    assert!(tree(&world.path(".")) == before && !world.path("none").exists());
}
