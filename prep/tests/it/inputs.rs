//! The forms in which KITTI lies on disks: folders, archives, JPEG, odd places.

use std::path::Path;

use strat_splits::Role;
use strat_store::image_files;
use strat_store::resize::{self, Kernel};

use crate::world::{DRIVE_1, DRIVE_2, World, assert_has, assert_same_tree, ids, picture, prep};

#[test]
fn scenes_without_calibration_go_by_their_size() {
    let world = World::new();
    world.remove("stereo/training/calib_cam_to_cam/000006.txt");
    let outcome = world.kitti("out", &["--allow-missing"]);
    assert_eq!(outcome.code, 1);
    assert_has(
        &outcome.stderr,
        &["is 62x20, which is no KITTI size, and has no calibration"],
    );
    assert_eq!(ids(&world.open("out"), Role::Test), ["kitti2015/000000"]);
}

#[test]
fn jpeg_and_folders_without_sync_are_taken_and_png_wins() {
    let world = World::new();
    std::fs::rename(
        world.path(&format!("raw/{DRIVE_1}")),
        world.path("raw/2011_09_26/2011_09_26_drive_0001"),
    )
    .unwrap();
    let jpeg = image_files::encode_jpeg_rgb(&picture(1), 92);
    for side in [2, 3] {
        // Frame 3 as JPEG alone, frame 0 as both.
        world.remove(&format!("raw/{DRIVE_2}/image_0{side}/data/0000000003.png"));
        for frame in [0, 3] {
            world.write(
                &format!("raw/{DRIVE_2}/image_0{side}/data/{frame:010}.jpg"),
                &jpeg,
            );
        }
    }
    let outcome = world.eigen("out", &["--allow-missing"]);
    assert_eq!(outcome.code, 0, "{}", outcome.stderr);
    let set = world.open("out");
    assert_eq!(ids(&set, Role::Train), ["2011_09_26_drive_0001/0000000004"]);
    let [frame_3, frame_0] = set.samples(Role::Test).unwrap().try_into().unwrap();
    let full = frame_3.left_full.unwrap();
    assert!(
        full.path.ends_with("0000000003.jpg") && std::fs::read(set.path(&full)).unwrap() == jpeg
    );
    assert!(frame_0.left_full.unwrap().path.ends_with("0000000000.png"));
    let expected = resize::rgb(&picture(2), 32, 16, Kernel::Area);
    assert_eq!(
        image_files::read_rgb(&set.path(&frame_0.left)).unwrap(),
        expected
    );
}

#[test]
fn archives_give_what_folders_give() {
    let world = World::new();
    world.pack_all();
    let whole = world.kitti("whole", &["--allow-missing"]);
    assert_eq!(whole.code, 0, "{}", whole.stderr);
    for (stereo, out) in [
        ("scenes", "from-folder"),
        ("scenes/data_scene_flow.zip", "from-file"),
    ] {
        let outcome = world.kitti_from("zips", stereo, out);
        assert_eq!(outcome.code, 0, "{}", outcome.stderr);
        assert_same_tree(&world.path("whole"), &world.path(out));
    }
    let again = world.kitti_from("zips", "scenes", "from-folder");
    assert_has(&again.stdout, &["0 files written"]);

    // Half unpacked, a frame of it as a file with other pixels: the file counts.
    let frame = format!("{DRIVE_2}/image_02/data/0000000003.png");
    let other = image_files::encode_png_rgb(&picture(99));
    world.write(&format!("zips/{frame}"), &other);
    let mixed = world.kitti_from("zips", "stereo", "mixed");
    assert_eq!(mixed.code, 0, "{}", mixed.stderr);
    world.write(&format!("raw/{frame}"), &other);
    assert_eq!(world.kitti("unpacked", &["--allow-missing"]).code, 0);
    assert_same_tree(&world.path("unpacked"), &world.path("mixed"));
}

#[test]
fn one_archive_can_be_the_raw_data() {
    let world = World::new();
    world.pack("raw", &["2011_09_26"], "kitti.zip");
    assert_eq!(world.kitti("whole", &["--allow-missing"]).code, 0);
    let outcome = world.kitti_from("kitti.zip", "stereo", "out");
    assert_eq!(outcome.code, 0, "{}", outcome.stderr);
    assert_same_tree(&world.path("whole"), &world.path("out"));
    world.pack("stereo", &["training"], "other.zip");
    let outcome = world.kitti_from("other.zip", "stereo", "none");
    assert_eq!(outcome.code, 2);
    assert_has(&outcome.stderr, &["this archive is none of KITTI raw"]);
    let outcome = world.kitti_from("kitti.zip", "kitti.zip", "none");
    assert_eq!(outcome.code, 2);
    assert_has(&outcome.stderr, &["--stereo2015", "data_scene_flow.zip"]);
}

#[test]
fn a_damaged_archive_costs_what_is_in_it() {
    let world = World::new();
    world.pack_all();
    world.truncate("zips/2011_09_26_drive_0002_sync.zip");
    let outcome = world.kitti_from("zips", "scenes", "out");
    assert_eq!(outcome.code, 1, "{}", outcome.stderr);
    assert_has(
        &outcome.stderr,
        &["0002_sync.zip is no whole zip archive", "download it again"],
    );
    assert_has(&outcome.stdout, &["train 1 of 29839 pairs, val 1"]);
    let failures = std::fs::read_to_string(world.path("out/failures.csv")).unwrap();
    assert_has(&failures, &["zips/2011_09_26_drive_0002_sync.zip"]);

    // Its directory is whole, but one entry is not.
    world.pack_all();
    let path = "zips/2011_09_26/2011_09_26_drive_0001_sync.zip";
    let mut bytes = std::fs::read(world.path(path)).unwrap();
    bytes[200] ^= 0x55;
    world.write(path, &bytes);
    let outcome = world.kitti_from("zips", "scenes", "entry");
    assert_eq!(outcome.code, 1);
    assert_has(
        &outcome.stderr,
        &[
            "0001_sync.zip: 2011_09_26/2011_09_26_drive_0001_sync/image_02/data/0000000004.png",
            "damaged here",
        ],
    );
    assert_has(&outcome.stdout, &["train 2 of 29839 pairs, val 1"]);
}

#[test]
fn odd_places_are_no_trouble() {
    let world = World::new();
    assert_eq!(world.eigen("whole", &["--allow-missing"]).code, 0);
    let odd = "Bücher und Bilder/straße 日本";
    std::fs::create_dir_all(world.path("Bücher und Bilder")).unwrap();
    std::fs::rename(world.path("raw"), world.path(odd)).unwrap();
    // Without the level `data`, as some copies have it.
    let folder = world.path(&format!("{odd}/{DRIVE_2}/image_03"));
    std::fs::rename(folder.join("data"), world.path("moved")).unwrap();
    std::fs::remove_dir(&folder).unwrap();
    std::fs::rename(world.path("moved"), &folder).unwrap();
    #[cfg(unix)]
    for (to, at) in [
        ("loop", "loop"),
        (".", "2011_09_28"),
        ("..", &format!("{DRIVE_1}/up")),
    ] {
        std::os::unix::fs::symlink(to, world.path(&format!("{odd}/{at}"))).unwrap();
    }
    let (raw, out) = (world.path(odd), world.path("Ausgabe für später"));
    let [raw, out] = [&raw, &out].map(|path| path.to_str().unwrap());
    let sizes = ["--width", "32", "--height", "16", "--allow-missing"];
    let outcome = prep(&[&["eigen", "--raw", raw, "--out", out], &sizes[..]].concat());
    assert_eq!(outcome.code, 0, "{}", outcome.stderr);
    assert_same_tree(&world.path("whole"), Path::new(out));
}
