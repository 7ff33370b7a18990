//! What killed runs leave, what is somebody else's, and being told to stop.

use std::path::{Path, PathBuf};
use std::process::Output;

use assert_cmd::Command;
use image::{Rgb, RgbImage};
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

    /// `prep pairs` into a folder.
    fn prepare(&self, out: &Path, more: &[&str]) -> Output {
        let (list, out) = (self.list(), out.to_str().unwrap());
        let mut args = vec!["pairs", "--csv", list.to_str().unwrap(), "--out", out];
        args.extend(["--width", "16", "--height", "8", "--jobs", "1", "--quiet"]);
        args.extend(more);
        prep(&args)
    }
}

fn prep(args: &[&str]) -> Output {
    Command::cargo_bin("prep")
        .unwrap()
        .args(args)
        .output()
        .unwrap()
}

fn assert_done(output: &Output, what: &str) {
    let text = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{what}: {text}");
}

#[test]
fn files_that_belong_to_no_part_stay() {
    let pairs = Pairs::new();
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("set");
    for shard in ["0/2", "1/2"] {
        assert_done(&pairs.prepare(&out, &["--shard", shard]), shard);
    }
    let notes = out.join("parts/0001-of-0002/notes.txt");
    std::fs::write(&notes, "mine").unwrap();
    let merged = prep(&["merge", out.to_str().unwrap()]);
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
    assert_done(&pairs.prepare(&out, &[]), "beside a leftover");
    let leftover = out.join("images/.unfinished-a1B2c3");
    std::fs::write(&leftover, "half a picture").unwrap();
    let verified = prep(&["verify", out.to_str().unwrap()]);
    assert_done(&verified, "verify beside a leftover");
    assert_done(&pairs.prepare(&out, &[]), "again");
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
