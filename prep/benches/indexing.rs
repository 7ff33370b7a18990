//! How long looking through all of KITTI raw takes, and how much memory it needs:
//! `cargo bench -p strat-prep --bench indexing`.
//!
//! The tree is made in a temporary folder with every frame of the drive table as empty files, left,
//! right and scan, which is all that looking through it sees of the real one.
#![allow(clippy::print_stdout, reason = "a measurement is printed")]

use std::fs::{self, File};
use std::time::Instant;

use strat_prep::input::raw::RawFolder;
use strat_prep::kitti::inventory::{Inventory, Roles};
use strat_splits::Role;

fn main() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut pairs = 0;
    for drive in strat_splits::drives() {
        let root = folder
            .path()
            .join(drive.id.date.as_str())
            .join(format!("{}_sync", drive.id));
        for (place, ending) in [
            ("image_02", "png"),
            ("image_03", "png"),
            ("velodyne_points", "bin"),
        ] {
            let place = root.join(place).join("data");
            fs::create_dir_all(&place).expect("a folder can be made");
            for frame in 0..drive.frames {
                File::create(place.join(format!("{frame:010}.{ending}"))).expect("a file");
            }
        }
        pairs += drive.frames;
    }
    println!("{pairs} pairs with their scans, as empty files");
    for round in ["first", "second"] {
        let start = Instant::now();
        let raw = RawFolder::open(folder.path()).expect("recording days");
        let looked = start.elapsed();
        let inventory = Inventory::eigen(&raw, None, Roles::AllWithDepth);
        println!(
            "{round}: {looked:.2?} for the folders, {:.2?} with the comparison to the Eigen split ({} train samples)",
            start.elapsed(),
            inventory.counts[&Role::Train].expected
        );
    }
    // Linux tells the most memory that was in use.
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    if let Some(peak) = status.lines().find(|line| line.starts_with("VmHWM")) {
        println!("{peak}");
    }
}
