//! Sets made in parts, sets made by killed runs, and `prep verify`, on a small rendered world.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::OnceLock;

use crate::parts::{assert_same_files, tree};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// The rendered world, made once for all tests of this file.
fn world() -> &'static Path {
    static WORLD: OnceLock<tempfile::TempDir> = OnceLock::new();
    let folder = WORLD.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("world");
        let made = prep(&["synth", "--preset", "tiny", "--quiet", "--out"], &[&out]);
        assert!(made.status.success(), "{}", text(&made.stderr));
        folder
    });
    folder.path()
}

fn command(words: &[&str], paths: &[&Path]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_prep"));
    command.args(words).args(paths).stdin(Stdio::null());
    command
}

fn prep(words: &[&str], paths: &[&Path]) -> Output {
    command(words, paths).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Arguments of a preparation of the rendered KITTI split into `out`.
fn kitti(out: &Path, more: &[&str]) -> Command {
    let world = world().join("world");
    let mut command = command(&["kitti", "--allow-missing", "--quiet", "--out"], &[out]);
    command.args(["--width", "64", "--height", "32"]);
    command.arg("--raw").arg(world.join("kitti_raw"));
    command.arg("--stereo2015").arg(world.join("kitti2015"));
    command.arg("--semantics").arg(world.join("kitti2015"));
    command.args(more);
    command
}

/// A folder for outputs, and in it a set that one undisturbed run made.
fn whole() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("whole");
    let made = kitti(&out, &[]).output().unwrap();
    assert!(made.status.success(), "{}", text(&made.stderr));
    (folder, out)
}

#[test]
fn merged_parts_are_the_set_of_a_single_run() {
    let (folder, whole) = whole();
    let parts = folder.path().join("parts");
    // In any order, and with one that failed the first time.
    for shard in ["2/4", "0/4", "3/4"] {
        let made = kitti(&parts, &["--shard", shard]).output().unwrap();
        assert_eq!(made.status.code(), Some(0), "{}", text(&made.stderr));
        assert!(text(&made.stdout).contains(&format!("part {shard} of")));
    }
    let early = prep(&["merge"], &[&parts]);
    assert_eq!(early.status.code(), Some(1));
    let told = text(&early.stderr);
    assert!(
        told.contains("1 of 4 parts") && told.contains("--shard 1/4"),
        "{told}"
    );
    assert!(told.contains("SHARDS=4 sbatch --array=1"), "{told}");
    assert!(!parts.join("manifest.yaml").exists(), "nothing was merged");

    // A part without its manifest was interrupted.
    let manifest = parts.join("parts/0003-of-0004/manifest.yaml");
    std::fs::remove_file(manifest).unwrap();
    let told = text(&prep(&["merge"], &[&parts]).stderr);
    assert!(told.contains("--array=1,3"), "{told}");

    for shard in ["1/4", "3/4"] {
        assert!(
            kitti(&parts, &["--shard", shard])
                .status()
                .unwrap()
                .success()
        );
    }
    let merged = prep(&["merge"], &[&parts]);
    assert_eq!(merged.status.code(), Some(0), "{}", text(&merged.stderr));
    assert_same_files(&whole, &parts);

    let again = prep(&["merge"], &[&parts]);
    assert_eq!(again.status.code(), Some(2));
    assert!(text(&again.stderr).contains("nothing is left to merge"));
}

#[test]
fn parts_of_two_divisions_do_not_mix() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("set");
    for shard in ["0/2", "1/3"] {
        assert!(kitti(&out, &["--shard", shard]).status().unwrap().success());
    }
    let told = prep(&["merge"], &[&out]);
    assert_eq!(told.status.code(), Some(2));
    assert!(
        text(&told.stderr).contains("parts of 2 and parts of 3"),
        "{}",
        text(&told.stderr)
    );
    let empty = prep(&["merge"], &[folder.path()]);
    assert_eq!(empty.status.code(), Some(2));
    assert!(text(&empty.stderr).contains("settings.yaml"));
}

/// Files of the set that are there.
fn count(out: &Path) -> usize {
    if out.exists() { tree_names(out) } else { 0 }
}

fn tree_names(folder: &Path) -> usize {
    // Files come and go while a run writes; what cannot be listed any more is not there.
    let Ok(entries) = std::fs::read_dir(folder) else {
        return 0;
    };
    let count = |entry: std::fs::DirEntry| match entry.file_type() {
        Ok(kind) if kind.is_dir() => tree_names(&entry.path()),
        Ok(_) => 1,
        Err(_) => 0,
    };
    entries.flatten().map(count).sum()
}

fn kill(mut child: Child) -> bool {
    let running = child.try_wait().unwrap().is_none();
    child.kill().unwrap();
    child.wait().unwrap();
    running
}

#[test]
fn a_run_killed_again_and_again_ends_with_the_same_bytes() {
    // The number of kills can be raised: STRAT_KILLS=50 cargo test --test it shards
    let kills: usize = std::env::var("STRAT_KILLS").map_or(6, |text| text.parse().unwrap());
    let (folder, whole) = whole();
    let all = count(&whole);
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let mut below = |bound: usize| random.next_u32() as usize % bound;
    let (mut hit, mut rounds) = (0, 0);
    while hit < kills {
        // A new folder once most of the set is there, so that kills fall on all stages.
        rounds += 1;
        assert!(
            rounds < 20 * kills,
            "{hit} of {kills} kills in {rounds} rounds"
        );
        let out = folder.path().join(format!("killed-{rounds}"));
        for _ in 0..5 {
            let there = count(&out);
            let wanted = there + below(all / 3 + 1);
            let mut child = kitti(&out, &[])
                .stdout(Stdio::null())
                .stderr(Stdio::null())
                .spawn()
                .unwrap();
            while count(&out) < wanted && child.try_wait().unwrap().is_none() {
                std::thread::yield_now();
            }
            hit += usize::from(kill(child));
            // What is there under its own name is whole.
            for (name, bytes) in tree(&out) {
                let odd = name.contains(".unfinished-");
                let undisturbed = || std::fs::read(whole.join(&name)).unwrap();
                assert!(odd || bytes == undisturbed(), "{name} is half-written");
            }
        }
        let last = kitti(&out, &[]).output().unwrap();
        assert!(last.status.success(), "{}", text(&last.stderr));
        // Temporary files of killed runs stay; they carry a name that says so.
        for name in tree(&out)
            .keys()
            .filter(|name| name.contains(".unfinished-"))
        {
            std::fs::remove_file(out.join(name)).unwrap();
        }
        assert_same_files(&whole, &out);
    }
}

#[test]
fn a_set_is_verified_against_its_digests() {
    let (_folder, set) = whole();
    let good = prep(&["verify", "--deep", "--quiet"], &[&set]);
    assert_eq!(good.status.code(), Some(0), "{}", text(&good.stdout));
    assert!(text(&good.stdout).contains("complete"));

    let names: Vec<_> = tree(&set).into_keys().collect();
    let one = |part: &str| set.join(names.iter().find(|name| name.contains(part)).unwrap());
    let (changed, gone) = (one("images/"), one("depth/"));
    let mut bytes = std::fs::read(&changed).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(&changed, bytes).unwrap();
    std::fs::remove_file(gone).unwrap();
    std::fs::write(set.join("images/notes.txt"), "mine").unwrap();
    let bad = prep(&["verify", "--quiet"], &[&set]);
    assert_eq!(bad.status.code(), Some(1));
    let told = text(&bad.stdout);
    for part in [
        "changed 1: images/",
        "short by 1: depth/",
        "images/notes.txt",
    ] {
        assert!(told.contains(part), "{part}\n{told}");
    }
    let json = prep(&["verify", "--json", "--quiet"], &[&set]);
    let json: serde_json::Value = serde_json::from_slice(&json.stdout).unwrap();
    assert!(json["findings"].as_array().unwrap().len() > 5);

    std::fs::write(set.join("test.csv"), "id\n").unwrap();
    let edited = prep(&["verify", "--quiet"], &[&set]);
    assert_eq!(edited.status.code(), Some(1));
    assert!(
        text(&edited.stderr).contains("a file edited"),
        "{}",
        text(&edited.stderr)
    );
}

#[test]
fn inputs_are_verified_drive_by_drive() {
    let folder = tempfile::tempdir().unwrap();
    // One rendered drive, copied so that it can be damaged.
    let from = world().join("world/kitti_raw");
    let to = folder.path().join("raw");
    for (name, bytes) in tree(&from) {
        if name.contains("2011_09_26_drive_0001") || name.ends_with(".txt") {
            let path = to.join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, bytes).unwrap();
        }
    }
    let drive = to.join("2011_09_26/2011_09_26_drive_0001_sync");
    let first = |folder: &str| {
        let files = tree(&drive.join(folder));
        drive.join(folder).join(files.into_keys().next().unwrap())
    };
    let (left, scan) = (first("image_02/data"), first("velodyne_points/data"));
    let bytes = std::fs::read(&left).unwrap();
    std::fs::write(&left, &bytes[..bytes.len() - 20]).unwrap();
    std::fs::write(&scan, [0; 17]).unwrap();
    let told = prep(&["verify", "--quiet", "--raw"], &[&to]);
    assert_eq!(told.status.code(), Some(1));
    let out = text(&told.stdout);
    assert!(
        out.contains("truncated 1: ") && out.contains("without its IEND chunk"),
        "{out}"
    );
    assert!(
        out.contains("17 bytes are not a whole number of points"),
        "{out}"
    );
    assert!(out.contains("of 108 good; short by"), "{out}");
    assert!(out.contains("60 drives are not there"), "{out}");

    let wrong = prep(&["verify"], &[]);
    assert_eq!(wrong.status.code(), Some(2));
}
