//! The command line: usage, and folders that are refused.

use crate::world::{DRIVE_1, World, assert_has, prep, tree};

#[test]
fn folders_that_hold_something_else_are_refused() {
    let world = World::new();
    assert_eq!(world.kitti("out", &["--allow-missing"]).code, 0);
    let before = tree(&world.path("out"));
    for (outcome, parts) in [
        (
            world.eigen("out", &["--allow-missing"]),
            &["holds the kitti split", "leak"][..],
        ),
        (
            world.kitti(
                "out",
                &["--allow-missing", "--width", "64", "--height", "16"],
            ),
            &["32x16", "64x16"],
        ),
        (
            world.kitti("out", &["--allow-missing", "--kernel", "lanczos3"]),
            &["`area`", "`lanczos3`"],
        ),
        (
            world.kitti("stereo", &["--allow-missing"]),
            &["inside the input folder"],
        ),
        (
            world.kitti("raw/new", &["--allow-missing"]),
            &["inside the input folder"],
        ),
        (
            world.kitti("raw/2011_09_26/calib_cam_to_cam.txt", &["--allow-missing"]),
            &["inside the input folder"],
        ),
    ] {
        assert_eq!(outcome.code, 2, "{}", outcome.stderr);
        assert_has(&outcome.stderr, parts);
    }
    assert!(tree(&world.path("out")) == before);

    world.write("full/letter.txt", b"dear");
    let outcome = world.kitti("full", &["--allow-missing"]);
    assert_eq!(outcome.code, 2);
    assert_has(&outcome.stderr, &["holds other things"]);
    let outcome = world.kitti("full/letter.txt", &["--allow-missing"]);
    assert_eq!(outcome.code, 2);
    assert_has(&outcome.stderr, &["this is a file"]);
}

#[test]
fn wrong_input_folders_are_explained() {
    let world = World::new();
    world.write("archives/2011_09_26_drive_0001_sync.zip", b"PK");
    world.write("other/notes.txt", b"");
    std::fs::create_dir(world.path("empty")).unwrap();
    let raw = |name: &str| {
        let (raw, out) = (
            world.path(name).display().to_string(),
            world.path("out").display().to_string(),
        );
        prep(&["eigen", "--raw", &raw, "--out", &out])
    };
    let right = format!(
        "Give the folder above it: --raw {}",
        world.path("raw").display()
    );
    let two_up = format!(
        "Give the folder two above it: --raw {}",
        world.path("raw").display()
    );
    let deeper = format!("one folder deeper: --raw {}", world.path("raw").display());
    for (name, parts) in [
        ("nowhere", &["folder not found"][..]),
        ("raw/RENDERED", &["folder not found"]),
        ("raw/2011_09_26/calib_cam_to_cam.txt", &["this is a file"]),
        (
            "archives/2011_09_26_drive_0001_sync.zip",
            &["0001_sync.zip is not a whole zip archive"],
        ),
        ("empty", &["the folder is empty", "looked for"]),
        ("raw/2011_09_26", &["one recording day", &right]),
        (&format!("raw/{DRIVE_1}"), &["one drive", &two_up]),
        ("", &[&deeper]),
        ("stereo", &["--stereo2015"]),
        ("archives", &["0001_sync.zip is not a whole zip archive"]),
        ("other", &["none of the five days"]),
    ] {
        let outcome = raw(name);
        assert_eq!(outcome.code, 2, "{name}: {}", outcome.stderr);
        assert_has(&outcome.stderr, &["error: --raw "]);
        assert_has(&outcome.stderr, parts);
    }
    for (name, part) in [
        ("nowhere", "folder not found"),
        ("empty", "the folder is empty"),
        ("stereo/training", "Give the folder above it"),
        (
            "raw",
            "looked for training/image_2, training/image_3, training/disp_noc_0",
        ),
    ] {
        let stereo = world.path(name).display().to_string();
        let outcome = world.run("kitti", &["--stereo2015", &stereo], "out", &[]);
        assert_eq!(outcome.code, 2, "{name}");
        assert_has(&outcome.stderr, &["error: --stereo2015 ", part]);
    }
    std::fs::remove_dir_all(world.path("stereo/training/image_3")).unwrap();
    assert_has(
        &world.kitti("out", &[]).stderr,
        &["training/image_3 is not there"],
    );
    assert!(!world.path("out").exists());
}

#[test]
fn usage() {
    let help = prep(&["--help"]);
    assert_eq!(help.code, 0);
    assert_has(&help.stdout, &["prep kitti --raw", "Exit codes"]);
    assert_eq!(prep(&["--version"]).code, 0);
    for wrong in [
        &["kitti"][..],
        &["nothing"],
        &[],
        &["splits", "nyu"],
        &["splits", "kitti", "--list", "all"],
    ] {
        assert_eq!(prep(wrong).code, 2, "{wrong:?}");
    }
    let world = World::new();
    for wrong in [["--jobs", "0"], ["--width", "0"], ["--kernel", "cubic"]] {
        assert_eq!(world.eigen("out", &wrong).code, 2, "{wrong:?}");
    }
}

#[test]
fn splits_are_shown_beside_the_thesis() {
    let kitti = prep(&["splits", "kitti"]);
    assert_eq!(kitti.code, 0);
    assert_has(
        &kitti.stdout,
        &[
            "training drives                 32       33  differs",
            "train                        29839    29829  differs",
            "test images                    200      200\n",
            "drive counts of the two splits exchanged: its 30159 pairs are those of the 32 drives",
            // PROTOCOL 2.3.
            "92 of the 142 test images",
        ],
    );
    assert_has(
        &prep(&["splits", "eigen"]).stdout,
        &[
            "train                        23158    23168  differs",
            "347 of the 697 test images",
        ],
    );
    let listed = prep(&["splits", "eigen", "--list", "test"]).stdout;
    assert_eq!(listed.lines().count(), 697);
    assert_eq!(
        listed.lines().next(),
        Some("2011_09_26_drive_0002/0000000069")
    );
    assert_eq!(
        prep(&["splits", "kitti", "--list", "val"])
            .stdout
            .lines()
            .count(),
        320
    );
}
