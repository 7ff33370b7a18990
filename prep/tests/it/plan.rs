//! `prep plan`, sets of test images alone, and `prep verify` on archives, on a small rendered world.

use std::collections::BTreeSet;
use std::io::Write;
use std::path::Path;
use std::process::{Command, Output, Stdio};

use serde_json::Value;
use strat_splits::{DriveRole, Role, Split, drives};
use strat_store::set::PreparedSet;

fn prep(words: &[&str], paths: &[(&str, &Path)]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_prep"));
    command.args(words).stdin(Stdio::null());
    for (option, path) in paths {
        command.arg(option).arg(path);
    }
    command.output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

fn plan(words: &[&str], paths: &[(&str, &Path)]) -> Value {
    let made = prep(&[&["plan", "--json"], words].concat(), paths);
    serde_json::from_slice(&made.stdout).unwrap_or_else(|_| panic!("{}", text(&made.stderr)))
}

fn names(plan: &Value) -> Vec<&str> {
    let archives = plan["archives"].as_array().unwrap();
    archives
        .iter()
        .map(|a| a["name"].as_str().unwrap())
        .collect()
}

fn world() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("world");
    let made = prep(
        &["synth", "--preset", "tiny", "--quiet"],
        &[("--out", &out)],
    );
    assert!(made.status.success(), "{}", text(&made.stderr));
    folder
}

#[test]
fn a_table_needs_no_more_than_its_test_images() {
    let plan_31 = plan(&["--table", "3.1"], &[]);
    assert_eq!(
        names(&plan_31),
        ["data_scene_flow.zip", "data_scene_flow_calib.zip"]
    );
    assert_eq!(plan_31["samples"], 200);
    assert!(
        plan_31["measured_on"]
            .as_str()
            .unwrap()
            .contains("synthetic")
    );
    assert!(
        plan_31["command"]
            .as_str()
            .unwrap()
            .starts_with("prep kitti --test-only")
    );
    assert_eq!(
        names(&plan(&["--table", "3.2"], &[]))[2..],
        ["data_semantics.zip"]
    );

    // Training drives of the Eigen split are none of the evaluation's.
    let plan_33 = plan(&["--table", "3.3"], &[]);
    let tested = drives()
        .iter()
        .filter(|drive| drive.role(Split::Eigen) == DriveRole::Test);
    let wanted: BTreeSet<_> = tested
        .map(|drive| format!("{}_sync.zip", drive.id))
        .collect();
    let named: BTreeSet<_> = names(&plan_33)
        .into_iter()
        .filter(|name| name.ends_with("_sync.zip"))
        .map(str::to_owned)
        .collect();
    assert_eq!(named, wanted);
    assert_eq!(plan_33["samples"], 697);

    let told = prep(&["plan", "--table", "3.1"], &[]);
    let told = text(&told.stdout);
    for part in ["about 2.0 GB", "missing", "free ", "synthetic image"] {
        assert!(told.contains(part), "{part}\n{told}");
    }
    assert_eq!(prep(&["plan"], &[]).status.code(), Some(2));
}

#[test]
fn what_is_there_is_counted_and_test_images_need_no_raw_data() {
    let folder = world();
    let (raw, stereo) = (
        folder.path().join("world/kitti_raw"),
        folder.path().join("world/kitti2015"),
    );
    let out = folder.path().join("set");
    let paths: [(&str, &Path); 3] = [("--raw", &raw), ("--stereo2015", &stereo), ("--out", &out)];
    let before = plan(
        &["--split", "kitti", "--width", "64", "--height", "32"],
        &paths,
    );
    assert!(
        before["measured_on"]
            .as_str()
            .unwrap()
            .ends_with("of your images")
    );
    assert_eq!(before["bytes_written"], 0);
    let scenes = &before["archives"][0];
    let found = scenes["found"].as_u64().unwrap();
    assert!(0 < found && found < 200, "{scenes}");
    let drive = before["archives"].as_array().unwrap().iter();
    let mut drive = drive.filter(|a| a["name"] == "2011_09_26_drive_0001_sync.zip");
    let drive = drive.next().unwrap();
    assert_eq!(drive["wanted"], 108);
    let frames = drive["found"].as_u64().unwrap();
    assert!(
        0 < frames && frames < 108,
        "a part of a drive is not all of it"
    );
    let told = text(&prep(&["plan", "--split", "kitti"], &paths).stdout);
    assert!(told.contains(&format!("{frames} of 108")), "{told}");

    // The KITTI split's test images are scenes, so its drives are not asked for.
    let small = [
        "--test-only",
        "--allow-missing",
        "--quiet",
        "--width",
        "64",
        "--height",
        "32",
    ];
    let made = prep(&[&["kitti"], &small[..]].concat(), &paths[1..]);
    assert_eq!(made.status.code(), Some(0), "{}", text(&made.stderr));
    let set = PreparedSet::open(&out).unwrap();
    assert_eq!(set.manifest.source, "rendered");
    assert_eq!(set.samples(Role::Test).unwrap().len() as u64, found);
    assert!(set.samples(Role::Train).unwrap().is_empty());
    assert_eq!(set.manifest.counts[&Role::Train].expected, 29_839);
    assert!(!set.manifest.is_complete(Role::Train));

    // What is written already is not to be written again.
    let after = plan(
        &["--split", "kitti", "--width", "64", "--height", "32"],
        &paths,
    );
    let bytes = |plan: &Value, of: &str| plan[of].as_u64().unwrap();
    assert!(bytes(&after, "bytes_written") > 0);
    assert_eq!(
        bytes(&after, "bytes_written") + bytes(&after, "bytes_to_write"),
        bytes(&before, "bytes_to_write")
    );

    // Those of the Eigen split are frames of drives.
    let refused = prep(&["eigen", "--test-only"], &paths[2..]);
    assert_eq!(refused.status.code(), Some(2));
    assert!(text(&refused.stderr).contains("--raw"));
}

#[test]
fn archives_are_verified_where_they_lie() {
    let folder = world();
    let data = folder
        .path()
        .join("world/kitti_raw/2011_09_26/2011_09_26_drive_0001_sync/image_02/data");
    let mut files: Vec<_> = std::fs::read_dir(data)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    files.sort();
    let downloads = folder.path().join("downloads");
    std::fs::create_dir(&downloads).unwrap();
    let path = downloads.join("2011_09_26_drive_0001_sync.zip");
    let mut zip = zip::ZipWriter::new(std::fs::File::create(&path).unwrap());
    let inside = "2011_09_26/2011_09_26_drive_0001_sync/image_02/data";
    for (number, file) in files.iter().take(3).enumerate() {
        let name = file.file_name().unwrap().to_str().unwrap();
        let stored = zip::write::SimpleFileOptions::default()
            .compression_method(zip::CompressionMethod::Stored);
        zip.start_file(format!("{inside}/{name}"), stored).unwrap();
        let bytes = std::fs::read(file).unwrap();
        // The last was damaged before it was packed: only decoding it tells.
        let half = if number == 2 {
            bytes.len() / 2
        } else {
            bytes.len()
        };
        zip.write_all(&bytes[..half]).unwrap();
    }
    zip.finish().unwrap();

    let verify = |more: &[&str]| {
        let words = [&["verify", "--quiet", "--split", "kitti"], more].concat();
        let told = prep(&words, &[("--raw", &downloads)]);
        assert_eq!(told.status.code(), Some(1));
        text(&told.stdout)
    };
    let quick = verify(&[]);
    assert!(
        quick.contains("left   3 of 108 good; short by 105"),
        "{quick}"
    );
    let deep = verify(&["--deep"]);
    assert!(
        deep.contains("left   2 of 108 good; short by 105"),
        "{deep}"
    );
    assert!(deep.contains("without its IEND chunk"), "{deep}");

    // A download that broke off has lost the directory at its end.
    let whole = std::fs::read(&path).unwrap();
    std::fs::write(&path, &whole[..whole.len() - 40]).unwrap();
    let told = prep(&["verify", "--quiet"], &[("--raw", &downloads)]);
    assert_ne!(told.status.code(), Some(0));
    let told = text(&told.stdout) + &text(&told.stderr);
    assert!(told.contains("2011_09_26_drive_0001_sync.zip"), "{told}");
}
