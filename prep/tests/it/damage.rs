//! Damaged, replaced and contradictory inputs, and sets that were only half made.

use image::RgbImage;
use strat_splits::Role;
use strat_store::image_files;

use crate::world::{
    CAM, DRIVE_1, DRIVE_2, HEIGHT, VELO, WIDTH, World, assert_has, assert_same_tree, ids, picture,
};

#[test]
fn a_second_run_finishes_an_interrupted_one_and_mends_changed_files() {
    let world = World::new();
    assert_eq!(world.eigen("whole", &["--allow-missing"]).code, 0);
    assert_eq!(world.eigen("out", &["--allow-missing"]).code, 0);
    world.write(
        "out/images/2011_09_26_drive_0001/left/0000000004.png",
        b"scratched",
    );
    let mended = world.eigen("out", &["--allow-missing"]);
    assert_has(&mended.stdout, &["1 files written"]);
    assert_same_tree(&world.path("whole"), &world.path("out"));

    for lost in [
        "manifest.yaml",
        "images/2011_09_26_drive_0002/right/0000000000.png",
        "depth/camera/2011_09_26_drive_0001/0000000005.exr",
    ] {
        world.remove(&format!("out/{lost}"));
    }
    assert_eq!(world.eigen("out", &["--allow-missing"]).code, 0);
    assert_same_tree(&world.path("whole"), &world.path("out"));
}

#[test]
fn broken_inputs_are_named_and_the_rest_is_kept() {
    let world = World::new();
    assert_eq!(world.eigen("whole", &["--allow-missing"]).code, 0);
    let image = format!("raw/{DRIVE_1}/image_03/data/0000000004.png");
    let scan = format!("raw/{DRIVE_2}/velodyne_points/data/0000000003.bin");
    let (good_image, good_scan) = (world.truncate(&image), world.truncate(&scan));

    let outcome = world.eigen("out", &["--allow-missing"]);
    assert_eq!(outcome.code, 1);
    assert_has(
        &outcome.stdout,
        &["train 0 of 23158 pairs, val 1 of 330, test 1 of 697"],
    );
    assert_has(
        &outcome.stderr,
        &[
            "train 2011_09_26_drive_0001/0000000004 skipped: ",
            "0000000004.png is not a usable image: it is truncated",
            "0000000003.bin: a Velodyne scan is rows",
            "2 inputs could not be used",
        ],
    );
    let failures = std::fs::read_to_string(world.path("out/failures.csv")).unwrap();
    assert_has(
        &failures,
        &[
            "role,id,file,problem",
            "image_03/data/0000000004.png",
            "0000000003.bin",
        ],
    );
    assert_eq!(failures.lines().count(), 3);
    let set = world.open("out");
    assert_eq!(set.manifest.failures, 2);
    assert_eq!(ids(&set, Role::Test), ["2011_09_26_drive_0002/0000000000"]);

    world.write(&image, &good_image);
    world.write(&scan, &good_scan);
    assert_eq!(world.eigen("out", &["--allow-missing"]).code, 0);
    assert_same_tree(&world.path("whole"), &world.path("out"));
}

/// Holes take no room on the disk, so this is a scan of 20 GB.
#[test]
fn a_scan_that_cannot_be_one_is_refused_unread() {
    let world = World::new();
    let scan = world.path(&format!(
        "raw/{DRIVE_2}/velodyne_points/data/0000000003.bin"
    ));
    let file = std::fs::File::create(&scan).unwrap();
    if file.set_len(20_000_000_000).is_err() {
        eprintln!("could not run: no file of 20 GB here");
        return;
    }
    let outcome = world.eigen("out", &["--allow-missing"]);
    assert_eq!(outcome.code, 1);
    let sentence = "0000000003.bin has 20.0 GB, but a Velodyne scan has at most 64.0 MB";
    assert_has(&outcome.stderr, &[sentence]);
    assert_eq!(world.open("out").manifest.failures, 1);
}

#[test]
fn a_validation_pair_outlives_its_broken_scan() {
    let world = World::new();
    world.write(
        &format!("raw/{DRIVE_1}/velodyne_points/data/0000000005.bin"),
        b"",
    );
    let outcome = world.eigen("out", &["--allow-missing"]);
    assert_eq!(outcome.code, 1);
    assert_has(
        &outcome.stderr,
        &["0000000005.bin: the Velodyne scan is empty"],
    );
    let val = world.open("out").samples(Role::Val).unwrap();
    assert!(val[0].depth_velodyne.is_none() && val[0].depth_camera.is_none());
}

#[test]
fn sizes_that_contradict_each_other_are_failures() {
    let world = World::new();
    let small = image_files::encode_png_rgb(&RgbImage::new(60, 20));
    world.write(
        &format!("raw/{DRIVE_1}/image_03/data/0000000004.png"),
        &small,
    );
    world.write(
        "stereo/training/disp_noc_0/000006_10.png",
        &image_files::encode_png_gray16(4, 3, &[9; 12]),
    );
    world.write(
        "stereo/training/disp_noc_0/000000_10.png",
        &image_files::encode_png_gray8(62, 20, &[9; 1240]),
    );
    let outcome = world.kitti("out", &["--allow-missing"]);
    assert_eq!(outcome.code, 1);
    assert_has(
        &outcome.stderr,
        &[
            "is 60x20, but its left image is 62x20",
            "000006_10.png is 4x3, but its left image is 62x20",
            "16-bit grey",
        ],
    );
}

#[test]
fn a_replaced_input_is_read_again() {
    let world = World::new();
    assert_eq!(world.eigen("out", &["--allow-missing"]).code, 0);
    // As `mv` does it: other content under an older time.
    let name = format!("raw/{DRIVE_1}/image_02/data/0000000004.png");
    world.write("new.png", &image_files::encode_png_rgb(&picture(77)));
    let file = std::fs::File::options()
        .write(true)
        .open(world.path("new.png"))
        .unwrap();
    file.set_modified(std::time::SystemTime::UNIX_EPOCH)
        .unwrap();
    std::fs::rename(world.path("new.png"), world.path(&name)).unwrap();
    let outcome = world.eigen("out", &["--allow-missing"]);
    let written = if cfg!(unix) {
        "1 files written"
    } else {
        "0 files written"
    };
    assert_has(&outcome.stdout, &[written]);
    // A calibration changes the depth of its day: of the validation frame and two test frames.
    world.write(
        "raw/2011_09_26/calib_velo_to_cam.txt",
        VELO.replace("0.25", "0.5").as_bytes(),
    );
    let outcome = world.eigen("out", &["--allow-missing"]);
    assert_has(&outcome.stdout, &["6 files written"]);
    assert_eq!(world.eigen("fresh", &["--allow-missing"]).code, 0);
    assert_same_tree(&world.path("fresh"), &world.path("out"));
}

#[test]
fn a_damaged_calibration_is_not_a_missing_one() {
    let world = World::new();
    for (out, name, good, from) in [
        ("one", "raw/2011_09_26/calib_velo_to_cam.txt", VELO, "0.25"),
        ("two", "raw/2011_09_26/calib_cam_to_cam.txt", CAM, "-18"),
    ] {
        world.write(name, good.replace(from, "nan").as_bytes());
        let outcome = world.kitti(out, &["--allow-missing"]);
        assert_eq!(outcome.code, 1, "{}", outcome.stderr);
        let failures = std::fs::read_to_string(world.path(out).join("failures.csv"));
        assert_has(&failures.unwrap(), &[name.rsplit('/').next().unwrap()]);
        world.write(name, good.as_bytes());
    }
}

#[test]
fn every_kind_of_bad_input_is_a_sentence() {
    let world = World::new();
    let image = |side: u32, frame: u32| format!("raw/{DRIVE_1}/image_0{side}/data/{frame:010}.png");
    let scan = format!("raw/{DRIVE_2}/velodyne_points/data/0000000003.bin");
    let [good_image, good_scan] =
        [image(2, 4), scan.clone()].map(|name| std::fs::read(world.path(&name)).unwrap());
    let nan: Vec<u8> = good_scan
        .chunks(4)
        .flat_map(|_| f32::NAN.to_le_bytes())
        .collect();
    let deep: Vec<u8> = {
        let (w, h) = (WIDTH, HEIGHT);
        image_files::encode_png_gray16(w, h, &vec![7; (w * h) as usize])
    };
    for (number, (name, content, good, part)) in [
        (
            image(2, 4),
            &good_image[..good_image.len() / 2],
            &good_image,
            "truncated",
        ),
        (image(2, 4), b"", &good_image, "the file is empty"),
        (
            image(2, 4),
            b"Not Found",
            &good_image,
            "neither PNG nor JPEG",
        ),
        (
            scan.clone(),
            b"17 bytes of scan.",
            &good_scan,
            "a Velodyne scan is rows",
        ),
        (scan.clone(), b"", &good_scan, "the Velodyne scan is empty"),
        (scan.clone(), &nan, &good_scan, "0000000003.bin"),
    ]
    .into_iter()
    .enumerate()
    {
        world.write(&name, content);
        let outcome = world.eigen(&format!("out-{number}"), &["--allow-missing"]);
        assert_eq!(outcome.code, 1, "{part}: {}", outcome.stderr);
        assert_has(&outcome.stderr, &[part, "1 inputs could not be used"]);
        assert_has(&outcome.stdout, &["val 1 of 330"]);
        world.write(&name, good);
    }
    // Grey 16-bit pictures are pictures; as labels or disparities, 8 bits would be wrong (above).
    world.write(&image(2, 4), &deep);
    world.write(&image(3, 4), &deep);
    assert_eq!(world.eigen("grey", &["--allow-missing"]).code, 0);

    let cam = CAM
        .lines()
        .filter(|line| !line.starts_with("P_rect_03"))
        .collect::<Vec<_>>()
        .join("\n");
    world.write("raw/2011_09_26/calib_cam_to_cam.txt", cam.as_bytes());
    let outcome = world.eigen("none", &["--allow-missing"]);
    assert_eq!(outcome.code, 1);
    assert_has(&outcome.stderr, &["calib_cam_to_cam.txt", "P_rect_03"]);
    assert!(!world.path("none").exists());
}
