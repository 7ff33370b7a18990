//! What a prepared set of KITTI or Eigen holds.

use strat_splits::Role;
use strat_store::resize::{self, Kernel};
use strat_store::set::Count;
use strat_store::{exr, image_files};

use crate::world::{
    CAM, HEIGHT, WIDTH, World, assert_has, assert_same_tree, disparity, ids, picture, prep, scan,
    tree,
};

#[test]
fn an_incomplete_split_is_refused_with_what_is_missing() {
    let world = World::new();
    let kitti = world.kitti("out", &[]);
    assert_eq!(kitti.code, 1);
    assert_has(
        &kitti.stderr,
        &[
            "train 3 of 29839 pairs, val 1 of 320, test 2 of 200",
            "2011_09_26_drive_0001: 106 of 108 left images (image_02) missing: 0000000000, 0000000001, 0000000002, ...",
            "2011_09_29: no folder for 1 drive (158 pairs): 0026",
            "stereo 2015: 198 of 200 disparities (disp_noc_0) missing: 000001_10, 000002_10, 000003_10, ...",
            "--allow-missing",
        ],
    );
    assert!(kitti.stdout.is_empty());
    assert!(!world.path("out").exists(), "nothing is written");

    let eigen = world.eigen("out", &[]);
    assert_eq!(eigen.code, 1);
    assert_has(
        &eigen.stderr,
        &["train 1 of 23158 pairs, val 1 of 330, test 2 of 697"],
    );
}

#[test]
fn the_kitti_set_holds_what_the_contract_says() {
    let world = World::new();
    let inputs = tree(&world.path("raw"));
    let outcome = world.kitti("out", &["--allow-missing"]);
    assert_eq!(outcome.code, 0, "{}", outcome.stderr);
    assert_has(
        &outcome.stdout,
        &[
            "train 3 of 29839 pairs, val 1 of 320, test 2 of 200",
            "digest ",
        ],
    );
    assert_has(
        &outcome.stderr,
        &["stereo 2015: 199 of 200 disparities (disp_occ_0) missing: 000000_10"],
    );
    assert!(
        tree(&world.path("raw")) == inputs,
        "inputs are never changed"
    );

    let set = world.open("out");
    let manifest = &set.manifest;
    assert_eq!(
        manifest.counts[&Role::Train],
        Count {
            expected: 29_839,
            found: 3
        }
    );
    assert_eq!(
        manifest.counts[&Role::Test],
        Count {
            expected: 200,
            found: 2
        }
    );
    assert_eq!((manifest.source.as_str(), manifest.failures), ("kitti", 0));
    assert_eq!(
        (manifest.image_width, manifest.image_height, manifest.kernel),
        (32, 16, Kernel::Area)
    );
    assert_eq!(manifest.cameras.len(), 2, "the raw day and the scenes");
    assert_eq!(
        ids(&set, Role::Train),
        [
            "2011_09_26_drive_0001/0000000004",
            "2011_09_26_drive_0002/0000000000",
            "2011_09_26_drive_0002/0000000003"
        ]
    );
    assert_eq!(ids(&set, Role::Val), ["2011_09_26_drive_0001/0000000005"]);
    assert_eq!(
        ids(&set, Role::Test),
        ["kitti2015/000000", "kitti2015/000006"]
    );

    let train = &set.samples(Role::Train).unwrap()[0];
    assert_eq!(
        (train.width, train.height, train.focal_px, train.baseline_m),
        (WIDTH, HEIGHT, 36.0, 0.5)
    );
    assert!(train.left_full.is_none() && train.depth_velodyne.is_none());
    let expected = resize::rgb(&picture(43), 32, 16, Kernel::Area);
    assert_eq!(
        image_files::read_rgb(&set.path(train.right.as_ref().unwrap())).unwrap(),
        expected
    );

    let val = &set.samples(Role::Val).unwrap()[0];
    let (velodyne, header) =
        exr::read_depth(&set.path(val.depth_velodyne.as_ref().unwrap())).unwrap();
    assert_eq!((velodyne.width, velodyne.height), (62, 20));
    assert!(velodyne.data.iter().all(|d| *d == 0.0 || *d == 8.0) && velodyne.data.contains(&8.0));
    assert_eq!(
        (header.axis.as_str(), header.frame.as_str()),
        ("velodyne-x", val.id.as_str())
    );
    let (camera, _) = exr::read_depth(&set.path(val.depth_camera.as_ref().unwrap())).unwrap();
    assert!(
        camera.data.contains(&8.25),
        "the camera is a quarter metre behind the scanner"
    );

    let [scene_0, scene_6] = set.samples(Role::Test).unwrap().try_into().unwrap();
    assert!(scene_0.depth_occ.is_none() && scene_6.depth_occ.is_some());
    let original = std::fs::read(world.path("stereo/training/image_3/000006_10.png")).unwrap();
    assert!(
        std::fs::read(set.path(scene_6.right_full.as_ref().unwrap())).unwrap() == original,
        "untouched"
    );
    let (depth, header) = exr::read_depth(&set.path(scene_6.depth_noc.as_ref().unwrap())).unwrap();
    assert_eq!(
        (header.baseline_m, header.focal_px, header.axis.as_str()),
        (0.54, 36.0, "camera-z")
    );
    let back: Vec<u16> = depth
        .data
        .iter()
        .map(|d| {
            if *d > 0.0 {
                (256.0 * 36.0 * 0.54 / f64::from(*d)).round() as u16
            } else {
                0
            }
        })
        .collect();
    assert_eq!(
        back,
        disparity(),
        "a reader recovers every disparity exactly"
    );
}

#[test]
fn the_eigen_set_tests_on_scans() {
    let world = World::new();
    let outcome = world.eigen("out", &["--allow-missing", "--train-depth"]);
    assert_eq!(outcome.code, 0, "{}", outcome.stderr);
    let set = world.open("out");
    // Published order, not frame order.
    assert_eq!(
        ids(&set, Role::Test),
        [
            "2011_09_26_drive_0002/0000000003",
            "2011_09_26_drive_0002/0000000000"
        ]
    );
    for sample in set.samples(Role::Test).unwrap() {
        assert!(sample.left_full.is_some() && sample.right_full.is_none());
        assert!(sample.depth_velodyne.is_some() && sample.depth_camera.is_some());
    }
    assert!(
        set.samples(Role::Train).unwrap()[0]
            .depth_velodyne
            .is_some(),
        "asked for with --train-depth"
    );
}

#[test]
fn the_result_depends_neither_on_threads_nor_on_a_second_run() {
    let world = World::new();
    assert_eq!(
        world.kitti("one", &["--allow-missing", "--jobs", "1"]).code,
        0
    );
    assert_eq!(
        world
            .kitti("four", &["--allow-missing", "--jobs", "4"])
            .code,
        0
    );
    assert_same_tree(&world.path("one"), &world.path("four"));

    let again = world.kitti("one", &["--allow-missing"]);
    assert_eq!(again.code, 0);
    assert_has(&again.stdout, &["0 files written"]);
    assert_same_tree(&world.path("one"), &world.path("four"));
}

#[test]
fn labels_are_passed_through() {
    let world = World::new();
    let labels = image_files::encode_png_gray8(WIDTH, HEIGHT, &[26; 1240]);
    let instances = image_files::encode_png_gray16(WIDTH, HEIGHT, &[26 * 256 + 1; 1240]);
    world.write("labels/training/semantic/000006_10.png", &labels);
    world.write("labels/training/instance/000006_10.png", &instances);
    let folder = world.path("labels").display().to_string();
    let outcome = world.kitti("out", &["--allow-missing", "--semantics", &folder]);
    assert_eq!(outcome.code, 0, "{}", outcome.stderr);
    assert_has(
        &outcome.stderr,
        &["199 of 200 label images (semantic) missing"],
    );
    let set = world.open("out");
    let [without, with] = set.samples(Role::Test).unwrap().try_into().unwrap();
    assert!(without.semantic.is_none());
    assert!(std::fs::read(set.path(with.semantic.as_ref().unwrap())).unwrap() == labels);
    assert!(std::fs::read(set.path(with.instance.as_ref().unwrap())).unwrap() == instances);
}

#[test]
fn the_codec_is_chosen_and_stated() {
    let world = World::new();
    let jpeg = ["--allow-missing", "--codec", "jpeg"];
    assert_eq!(world.eigen("out", &jpeg).code, 0);
    let set = world.open("out");
    assert_eq!(set.manifest.codec, "jpeg-92");
    let settings = std::fs::read_to_string(world.path("out/settings.yaml")).unwrap();
    assert_has(&settings, &["codec: jpeg-92"]);
    let left = &set.samples(Role::Train).unwrap()[0].left;
    assert!(left.path.ends_with(".jpg"));
    let expected =
        image_files::encode_jpeg_rgb(&resize::rgb(&picture(42), 32, 16, Kernel::Area), 92);
    assert!(std::fs::read(set.path(left)).unwrap() == expected);

    let other = [&jpeg[..], &["--quality", "80"]].concat();
    let outcome = world.eigen("out", &other);
    assert_eq!(outcome.code, 2);
    assert_has(&outcome.stderr, &["jpeg-92", "jpeg-80"]);
    let outcome = world.eigen("none", &["--quality", "80"]);
    assert_eq!(outcome.code, 2);
    assert_has(&outcome.stderr, &["--codec jpeg"]);
    assert_eq!(world.eigen("none", &["--quality", "0"]).code, 2);
}

#[test]
fn annotated_depth_goes_to_test_and_validation() {
    let world = World::new();
    let place = |drive: &str, frame: u32| {
        format!(
            "depth/train/2011_09_26_drive_{drive}_sync/proj_depth/groundtruth/image_02/{frame:010}.png"
        )
    };
    let values: Vec<u16> = (0..WIDTH * HEIGHT)
        .map(|i| (i * 16 % 20_000) as u16)
        .collect();
    let png = image_files::encode_png_gray16(WIDTH, HEIGHT, &values);
    for (drive, frame) in [("0001", 4), ("0001", 5), ("0002", 3)] {
        world.write(&place(drive, frame), &png);
    }
    world.write(
        &place("0002", 0),
        &image_files::encode_png_gray8(WIDTH, HEIGHT, &[9; 1240]),
    );
    world.pack("depth", &["train"], "data_depth_annotated.zip");
    let run = |from: &str, out: &str| {
        let from = world.path(from).display().to_string();
        world.eigen(out, &["--allow-missing", "--annotated", &from])
    };
    let outcome = run("depth", "out");
    assert_eq!(outcome.code, 1);
    assert_has(
        &outcome.stderr,
        &[
            "2 of 2 test images have it, 1 of 1 validation",
            "0000000000.png",
            "16-bit grey",
        ],
    );
    let set = world.open("out");
    let [frame_3, frame_0] = set.samples(Role::Test).unwrap().try_into().unwrap();
    let (depth, header) = exr::read_depth(&set.path(&frame_3.depth_annotated.unwrap())).unwrap();
    assert!(
        depth
            .data
            .iter()
            .zip(&values)
            .all(|(d, v)| *d == f32::from(*v) / 256.0)
    );
    assert_eq!(
        (header.source.as_str(), header.axis.as_str()),
        ("kitti-depth/groundtruth", "camera-z")
    );
    assert!(
        frame_0.depth_annotated.is_none(),
        "a damaged map costs itself only"
    );
    assert!(set.samples(Role::Val).unwrap()[0].depth_annotated.is_some());
    assert!(
        set.samples(Role::Train).unwrap()[0]
            .depth_annotated
            .is_none()
    );

    assert_eq!(run("data_depth_annotated.zip", "packed").code, 1);
    for table in ["test.csv", "val.csv", "train.csv"] {
        let [a, b] = ["out", "packed"]
            .map(|out| std::fs::read(world.path(&format!("{out}/{table}"))).unwrap());
        assert!(a == b, "{table}");
    }
    for (name, part) in [
        ("nowhere", "folder not found"),
        ("raw", "looked for train/"),
    ] {
        let outcome = run(name, "none");
        assert_eq!(outcome.code, 2);
        assert_has(
            &outcome.stderr,
            &["--annotated", part, "data_depth_annotated.zip"],
        );
    }
}

/// KITTI has no scans 177 to 180 of this drive, so nobody can download them.
#[test]
fn scans_that_never_were_are_not_missing() {
    let world = World::new();
    let drive = "2011_09_26/2011_09_26_drive_0009_sync";
    for frame in 175..183 {
        for side in [2, 3] {
            let name = format!("raw/{drive}/image_0{side}/data/{frame:010}.png");
            world.write(&name, &image_files::encode_png_rgb(&picture(frame + side)));
        }
        if !(177..=180).contains(&frame) {
            let name = format!("raw/{drive}/velodyne_points/data/{frame:010}.bin");
            world.write(&name, &scan());
        }
    }
    let raw = world.path("raw").display().to_string();
    let outcome = prep(&["verify", "--json", "--quiet", "--raw", &raw]);
    let report: serde_json::Value = serde_json::from_str(&outcome.stdout).unwrap();
    let findings = report["findings"].as_array().unwrap();
    let scans = findings
        .iter()
        .find(|finding| finding["place"] == "2011_09_26_drive_0009" && finding["kind"] == "scans");
    let scans = scans.unwrap();
    assert_eq!(
        (&scans["expected"], &scans["good"]),
        (&443.into(), &4.into())
    );
    let missing = scans["missing"].to_string();
    assert!(missing.contains("0000000183"), "{missing}");
    for never in 177..=180 {
        assert!(!missing.contains(&format!("{never:010}")), "{missing}");
    }
    // None of them is a test frame of either split, so a preparation has nothing to say of them.
    let outcome = world.eigen("out", &["--allow-missing"]);
    assert_eq!(outcome.code, 0, "{}", outcome.stderr);
    assert!(!outcome.stderr.contains("0000000177"), "{}", outcome.stderr);
}

#[test]
fn without_scan_calibration_images_still_go_in() {
    let world = World::new();
    world.remove("raw/2011_09_26/calib_velo_to_cam.txt");
    let outcome = world.eigen("out", &["--allow-missing"]);
    assert_eq!(outcome.code, 0, "{}", outcome.stderr);
    assert_has(
        &outcome.stderr,
        &[
            "no scan of 2011_09_26 can be used: ",
            "calib_velo_to_cam.txt is missing",
        ],
    );
    assert_has(
        &outcome.stdout,
        &["train 1 of 23158 pairs, val 1 of 330, test 0 of 697"],
    );
    assert!(
        world.open("out").samples(Role::Val).unwrap()[0]
            .depth_velodyne
            .is_none()
    );

    world.write(
        "raw/2011_09_26/calib_cam_to_cam.txt",
        CAM.replace("P_rect_02: 36", "P_rect_02: x").as_bytes(),
    );
    let outcome = world.eigen("none", &["--allow-missing"]);
    assert_eq!(outcome.code, 1);
    assert_has(
        &outcome.stderr,
        &[
            "nothing of the eigen split is there",
            "calib_cam_to_cam.txt: line 5: `P_rect_02` should have 12 finite numbers",
        ],
    );
}

#[test]
fn a_rendered_world_is_called_rendered() {
    let world = World::new();
    world.write("raw/RENDERED", b"");
    assert_eq!(world.eigen("out", &["--allow-missing", "--quiet"]).code, 0);
    assert_eq!(world.open("out").manifest.source, "rendered");
}
