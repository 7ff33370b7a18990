//! The forms in which KITTI lies on disks: folders, archives, JPEG, odd places.

use std::path::Path;

use strat_splits::Role;
use strat_store::image_files;
use strat_store::resize::{self, Kernel};

use crate::world::{
    CAM, DRIVE_1, DRIVE_2, VELO, World, assert_has, assert_same_tree, ids, picture, prep, tree,
};

#[test]
fn scenes_without_calibration_go_by_their_size() {
    let world = World::new();
    world.remove("stereo/training/calib_cam_to_cam/000006.txt");
    let outcome = world.kitti("out", &["--allow-missing"]);
    assert_eq!(outcome.code, 1);
    assert_has(
        &outcome.stderr,
        &["is 62x20, which is not a KITTI size, and has no calibration"],
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
    assert_has(&outcome.stderr, &["this is not an archive of KITTI raw"]);
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
        &[
            "0002_sync.zip is not a whole zip archive",
            "download it again",
        ],
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

#[test]
fn archives_unpacked_beside_each_other_are_one_folder() {
    let world = World::new();
    assert_eq!(world.kitti("whole", &["--allow-missing"]).code, 0);
    for (archive, inner) in [
        ("2011_09_26_drive_0001_sync", DRIVE_1),
        ("2011_09_26_drive_0002_sync", DRIVE_2),
    ] {
        std::fs::create_dir_all(world.path(&format!("beside/{archive}/2011_09_26"))).unwrap();
        let to = world.path(&format!("beside/{archive}/{inner}"));
        std::fs::rename(world.path(&format!("raw/{inner}")), to).unwrap();
    }
    let calib = "beside/2011_09_26_calib/2011_09_26/calib";
    world.write(&format!("{calib}_cam_to_cam.txt"), CAM.as_bytes());
    world.write(&format!("{calib}_velo_to_cam.txt"), VELO.as_bytes());
    let outcome = world.kitti_from("beside", "stereo", "out");
    assert_eq!(outcome.code, 0, "{}", outcome.stderr);
    assert_same_tree(&world.path("whole"), &world.path("out"));
    // A folder of another name may be another data set, and is not mixed in.
    std::fs::rename(
        world.path("beside/2011_09_26_drive_0002_sync"),
        world.path("beside/rendered"),
    )
    .unwrap();
    let outcome = world.kitti_from("beside", "stereo", "less");
    assert_has(
        &outcome.stderr,
        &["no folder for 19 drives (6164 pairs): 0002 "],
    );
}

/// Writes an archive of stored files; their names stay as they are.
fn zip(path: &Path, files: &[(String, Vec<u8>)]) {
    use std::io::Write;
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    let mut zip = zip::ZipWriter::new(std::fs::File::create(path).unwrap());
    for (name, content) in files {
        let options = zip::write::SimpleFileOptions::default()
            .compression_method(zip::CompressionMethod::Stored);
        zip.start_file(name.as_str(), options).unwrap();
        zip.write_all(content).unwrap();
    }
    zip.finish().unwrap();
}

#[test]
fn archives_with_backslashes_are_read() {
    let world = World::new();
    assert_eq!(world.kitti("whole", &["--allow-missing"]).code, 0);
    let files = tree(&world.path("raw")).into_iter();
    let files: Vec<_> = files
        .map(|(name, content)| (name.to_str().unwrap().replace('/', "\\"), content))
        .collect();
    assert!(files.iter().all(|(name, _)| !name.contains('/')));
    zip(&world.path("zips/all.zip"), &files);
    let outcome = world.kitti_from("zips", "stereo", "out");
    assert_eq!(outcome.code, 0, "{}", outcome.stderr);
    assert_same_tree(&world.path("whole"), &world.path("out"));
}

#[test]
fn drives_that_are_not_rectified_are_named() {
    let world = World::new();
    std::fs::rename(
        world.path(&format!("raw/{DRIVE_1}")),
        world.path("raw/2011_09_26/2011_09_26_drive_0001_extract"),
    )
    .unwrap();
    let name = "2011_09_26/2011_09_26_drive_0005_extract/image_02/data/0000000000.png";
    zip(
        &world.path("raw/2011_09_26_drive_0005_extract.zip"),
        &[(name.to_owned(), vec![1])],
    );
    let outcome = world.kitti("out", &["--allow-missing"]);
    assert_eq!(outcome.code, 0, "{}", outcome.stderr);
    let named =
        "2 drives are there only as `_extract`, which is neither synchronised nor rectified";
    let drives = "as `_sync`: 2011_09_26_drive_0001, 2011_09_26_drive_0005";
    assert_has(&outcome.stderr, &[named, drives]);
    let only = world.path("raw/2011_09_26").display().to_string();
    std::fs::remove_dir_all(world.path(&format!("raw/{DRIVE_2}"))).unwrap();
    let outcome = world.kitti_from("raw/2011_09_26", "stereo", "none");
    assert_eq!(outcome.code, 2, "{only}");
    assert_has(
        &outcome.stderr,
        &["drive_0001_extract is neither synchronised"],
    );
}

#[test]
fn extensions_may_be_in_capitals() {
    let world = World::new();
    assert_eq!(world.kitti("whole", &["--allow-missing"]).code, 0);
    for root in ["raw", "stereo"] {
        for name in tree(&world.path(root)).into_keys() {
            if name.extension().is_some_and(|extension| extension == "png") {
                let from = world.path(root).join(&name);
                std::fs::rename(&from, from.with_extension("PNG")).unwrap();
            }
        }
    }
    let outcome = world.kitti("out", &["--allow-missing"]);
    assert_eq!(outcome.code, 0, "{}", outcome.stderr);
    assert_same_tree(&world.path("whole"), &world.path("out"));
}

#[test]
fn test_frames_need_no_right_image() {
    let world = World::new();
    world.remove(&format!("raw/{DRIVE_2}/image_03/data/0000000003.png"));
    let outcome = world.eigen("out", &["--allow-missing", "--test-only"]);
    assert_eq!(outcome.code, 0, "{}", outcome.stderr);
    assert_has(&outcome.stdout, &["test 2 of 697"]);
    assert_has(
        &outcome.stderr,
        &["written without them", "right images (image_03) missing"],
    );
    let set = world.open("out");
    let samples = set.samples(Role::Test).unwrap();
    let without: Vec<_> = samples.iter().filter(|s| s.right.is_none()).collect();
    assert_eq!(without.len(), 1);
    assert!(without[0].id.ends_with("0000000003") && without[0].depth_velodyne.is_some());
    // A training pair is none without it.
    world.remove(&format!("raw/{DRIVE_1}/image_03/data/0000000004.png"));
    let outcome = world.eigen("all", &["--allow-missing"]);
    assert_has(
        &outcome.stdout,
        &["train 0 of 23158 pairs, val 1 of 330, test 2 of 697"],
    );
}

#[test]
fn scans_of_another_type_are_refused() {
    let world = World::new();
    let points = crate::world::scan();
    let numbers = points
        .chunks_exact(4)
        .map(|b| f32::from_le_bytes(b.try_into().unwrap()));
    let doubles: Vec<u8> = numbers.flat_map(|n| f64::from(n).to_le_bytes()).collect();
    world.write(
        &format!("raw/{DRIVE_2}/velodyne_points/data/0000000003.bin"),
        &doubles,
    );
    let outcome = world.eigen("out", &["--allow-missing"]);
    assert_eq!(outcome.code, 1, "{}", outcome.stderr);
    assert_has(
        &outcome.stderr,
        &["0000000003.bin: a Velodyne scan is rows of x, y, z and reflectance"],
    );
    assert_eq!(ids(&world.open("out"), Role::Test).len(), 1);
    let raw = world.path("raw").display().to_string();
    let verified = prep(&[
        "verify", "--raw", &raw, "--split", "eigen", "--deep", "--quiet",
    ]);
    assert_has(
        &verified.stdout,
        &["0000000003 (a Velodyne scan is rows of"],
    );
}
