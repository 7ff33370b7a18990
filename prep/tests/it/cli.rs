//! The `prep` command on tiny inputs in KITTI's layouts, made up by closed formulas.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};

use assert_cmd::Command;
use image::{Rgb, RgbImage};
use strat_splits::Role;
use strat_store::resize::{self, Kernel};
use strat_store::set::{Count, PreparedSet};
use strat_store::{exr, image_files};
use tempfile::TempDir;

const WIDTH: u32 = 62;
const HEIGHT: u32 = 20;
const DRIVE_1: &str = "2011_09_26/2011_09_26_drive_0001_sync";
const DRIVE_2: &str = "2011_09_26/2011_09_26_drive_0002_sync";
const CAM: &str = "calib_time: 09-Jan-2012 13:57:47
S_rect_02: 6.2e+01 2.0e+01
R_rect_00: 1 0 0 0 1 0 0 0 1
P_rect_00: 1,1+02 0 31 0 0 36 10 0 0 0 1 0
P_rect_02: 36 0 31 0 0 36 10 0 0 0 1 0
P_rect_03: 36 0 31 -18 0 36 10 0 0 0 1 0
";
const VELO: &str = "R: 0 -1 0 0 0 -1 1 0 0\nT: 0 0 0.25\n";

/// A folder with `raw` and `stereo`, and room for outputs.
struct World(TempDir);

impl World {
    /// Drive 0001 (training in both splits): frames 4 and 5, of which 5 is drawn for validation.
    /// Drive 0002 (training in KITTI, test in Eigen): frames 0 and 3, both Eigen test frames.
    /// Stereo 2015: scenes 0 and 6, of which only 6 has `disp_occ_0`.
    fn new() -> Self {
        let world = Self(TempDir::new().unwrap());
        world.write("raw/2011_09_26/calib_cam_to_cam.txt", CAM.as_bytes());
        world.write("raw/2011_09_26/calib_velo_to_cam.txt", VELO.as_bytes());
        for (drive, frames) in [(DRIVE_1, [4, 5]), (DRIVE_2, [0, 3])] {
            for frame in frames {
                for side in [2, 3] {
                    let bytes = image_files::encode_png_rgb(&picture(frame * 10 + side));
                    world.write(
                        &format!("raw/{drive}/image_0{side}/data/{frame:010}.png"),
                        &bytes,
                    );
                }
                world.write(
                    &format!("raw/{drive}/velodyne_points/data/{frame:010}.bin"),
                    &scan(),
                );
            }
        }
        for scene in [0, 6] {
            for side in [2, 3] {
                let bytes = image_files::encode_png_rgb(&picture(700 + scene * 10 + side));
                world.write(
                    &format!("stereo/training/image_{side}/{scene:06}_10.png"),
                    &bytes,
                );
            }
            let png = image_files::encode_png_gray16(WIDTH, HEIGHT, &disparity());
            world.write(
                &format!("stereo/training/disp_noc_0/{scene:06}_10.png"),
                &png,
            );
            if scene == 6 {
                world.write(
                    &format!("stereo/training/disp_occ_0/{scene:06}_10.png"),
                    &png,
                );
            }
            world.write(
                &format!("stereo/training/calib_cam_to_cam/{scene:06}.txt"),
                CAM.as_bytes(),
            );
        }
        world
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn write(&self, name: &str, bytes: &[u8]) {
        let path = self.path(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, bytes).unwrap();
    }

    fn remove(&self, name: &str) {
        std::fs::remove_file(self.path(name)).unwrap();
    }

    /// Cuts a file in half.
    fn truncate(&self, name: &str) -> Vec<u8> {
        let bytes = std::fs::read(self.path(name)).unwrap();
        self.write(name, &bytes[..bytes.len() / 2 + 1]);
        bytes
    }

    fn eigen(&self, out: &str, more: &[&str]) -> Outcome {
        self.run("eigen", &[], out, more)
    }

    fn kitti(&self, out: &str, more: &[&str]) -> Outcome {
        let stereo = self.path("stereo");
        self.run(
            "kitti",
            &["--stereo2015", stereo.to_str().unwrap()],
            out,
            more,
        )
    }

    fn run(&self, split: &str, inputs: &[&str], out: &str, more: &[&str]) -> Outcome {
        let mut args = vec![
            split.to_owned(),
            "--raw".to_owned(),
            self.path("raw").display().to_string(),
        ];
        args.extend(inputs.iter().chain(more).map(ToString::to_string));
        if !more.contains(&"--width") {
            args.extend(["--width", "32", "--height", "16"].map(String::from));
        }
        args.extend(["--out".to_owned(), self.path(out).display().to_string()]);
        prep(&args)
    }

    /// Packs what lies below `root/inner`, with its names below `root`, into an archive.
    fn pack(&self, root: &str, inner: &[&str], archive: &str) {
        let path = self.path(archive);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        let mut zip = zip::ZipWriter::new(std::fs::File::create(path).unwrap());
        for (number, (name, content)) in tree(&self.path(root)).into_iter().enumerate() {
            if !inner.iter().any(|inner| name.starts_with(inner)) {
                continue;
            }
            let method = match number % 3 {
                0 => zip::CompressionMethod::Stored,
                _ => zip::CompressionMethod::Deflated,
            };
            let options = zip::write::SimpleFileOptions::default().compression_method(method);
            zip.start_file(name.to_str().unwrap(), options).unwrap();
            zip.write_all(&content).unwrap();
        }
        zip.finish().unwrap();
    }

    /// The archives of everything, laid out as somebody might have downloaded them.
    fn pack_all(&self) {
        self.pack(
            "raw",
            &[DRIVE_1],
            "zips/2011_09_26/2011_09_26_drive_0001_sync.zip",
        );
        self.pack("raw", &[DRIVE_2], "zips/2011_09_26_drive_0002_sync.zip");
        let calibrations = ["cam_to_cam", "velo_to_cam"];
        let calibrations = calibrations.map(|name| format!("2011_09_26/calib_{name}.txt"));
        let calibrations = calibrations.each_ref().map(String::as_str);
        self.pack("raw", &calibrations, "zips/2011_09_26_calib.zip");
        self.pack(
            "stereo",
            &["training/calib_cam_to_cam"],
            "scenes/data_scene_flow_calib.zip",
        );
        let images = ["image_2", "image_3", "disp_noc_0", "disp_occ_0"];
        let images = images.map(|name| format!("training/{name}"));
        let images = images.each_ref().map(String::as_str);
        self.pack("stereo", &images, "scenes/data_scene_flow.zip");
    }

    fn kitti_from(&self, raw: &str, stereo: &str, out: &str) -> Outcome {
        let path = |name: &str| self.path(name).display().to_string();
        prep(&[
            "kitti".to_owned(),
            "--raw".to_owned(),
            path(raw),
            "--stereo2015".to_owned(),
            path(stereo),
            "--allow-missing".to_owned(),
            "--width=32".to_owned(),
            "--height=16".to_owned(),
            "--out".to_owned(),
            path(out),
        ])
    }

    fn open(&self, out: &str) -> PreparedSet {
        PreparedSet::open(&self.path(out)).unwrap()
    }
}

struct Outcome {
    code: i32,
    stdout: String,
    stderr: String,
}

fn prep(args: &[impl AsRef<str>]) -> Outcome {
    let args = args.iter().map(AsRef::as_ref);
    let output = Command::new(env!("CARGO_BIN_EXE_prep"))
        .args(args)
        .output()
        .unwrap();
    let text = |bytes: &[u8]| String::from_utf8(bytes.to_vec()).unwrap();
    let outcome = Outcome {
        code: output.status.code().unwrap(),
        stdout: text(&output.stdout),
        stderr: text(&output.stderr),
    };
    assert!(!outcome.stderr.contains("panicked"), "{}", outcome.stderr);
    outcome
}

#[track_caller]
fn assert_has(text: &str, parts: &[&str]) {
    for part in parts {
        assert!(text.contains(part), "`{part}` is not in:\n{text}");
    }
}

fn picture(seed: u32) -> RgbImage {
    RgbImage::from_fn(WIDTH, HEIGHT, |x, y| {
        Rgb([0, 1, 2].map(|c| ((x * 7 + y * 11 + c * 53 + seed * 29 + x * y % 13) % 256) as u8))
    })
}

/// A wall eight metres ahead of the scanner, in little-endian `f32`.
fn scan() -> Vec<u8> {
    let points = (0..400).map(|i| {
        [
            8.0,
            (i % 40 - 20) as f32 / 4.0,
            (i / 40 - 5) as f32 / 4.0,
            0.5_f32,
        ]
    });
    points.flatten().flat_map(f32::to_le_bytes).collect()
}

/// Every third pixel measured, in 1/256 px.
fn disparity() -> Vec<u16> {
    (0..WIDTH * HEIGHT)
        .map(|i| if i % 3 == 0 { 0 } else { (300 + i * 7) as u16 })
        .collect()
}

/// All files below a folder with their content.
fn tree(root: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut files = BTreeMap::new();
    let mut folders = vec![root.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                files.insert(
                    path.strip_prefix(root).unwrap().to_owned(),
                    std::fs::read(&path).unwrap(),
                );
            }
        }
    }
    files
}

#[track_caller]
fn assert_same_tree(a: &Path, b: &Path) {
    let (a, b) = (tree(a), tree(b));
    assert_eq!(a.keys().collect::<Vec<_>>(), b.keys().collect::<Vec<_>>());
    for (path, content) in &a {
        assert!(content == &b[path], "{} differs", path.display());
    }
}

fn ids(set: &PreparedSet, role: Role) -> Vec<String> {
    set.samples(role)
        .unwrap()
        .into_iter()
        .map(|sample| sample.id)
        .collect()
}

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
    for (name, part) in [("nowhere", "no such folder"), ("raw", "looked for train/")] {
        let outcome = run(name, "none");
        assert_eq!(outcome.code, 2);
        assert_has(
            &outcome.stderr,
            &["--annotated", part, "data_depth_annotated.zip"],
        );
    }
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

/// `prep` as a user to whom permissions apply, which they do not to the superuser; `None` where that
/// cannot be done. The program is copied to where everyone may read it.
#[cfg(unix)]
fn as_nobody(world: &World, args: &[&str]) -> Option<Outcome> {
    use std::os::unix::fs::PermissionsExt;
    use std::os::unix::process::CommandExt;

    const NOBODY: u32 = 65534;
    let program = world.path("prep");
    if !program.exists() {
        std::fs::copy(env!("CARGO_BIN_EXE_prep"), &program).unwrap();
        std::fs::set_permissions(world.0.path(), PermissionsExt::from_mode(0o777)).unwrap();
    }
    let closed = world.path("closed");
    std::fs::create_dir_all(&closed).unwrap();
    std::fs::set_permissions(&closed, PermissionsExt::from_mode(0o000)).unwrap();
    let mut command = std::process::Command::new(&program);
    command.args(args);
    if std::fs::read_dir(&closed).is_ok() {
        command.gid(NOBODY).uid(NOBODY);
    }
    let output = match command.output() {
        Ok(output) => output,
        Err(error) => {
            eprintln!(
                "skipped: cannot run {} as another user: {error}",
                program.display()
            );
            return None;
        }
    };
    Some(Outcome {
        code: output.status.code().unwrap(),
        stdout: String::from_utf8(output.stdout).unwrap(),
        stderr: String::from_utf8(output.stderr).unwrap(),
    })
}

#[test]
#[cfg(unix)]
fn what_may_not_be_read_is_named_and_the_rest_is_made() {
    use std::os::unix::fs::PermissionsExt;

    let world = World::new();
    let allow = |name: &str, mode: u32| {
        std::fs::set_permissions(world.path(name), PermissionsExt::from_mode(mode)).unwrap();
    };
    let run = |out: &str| {
        let (raw, out) = (world.path("raw"), world.path(out));
        let [raw, out] = [&raw, &out].map(|path| path.to_str().unwrap());
        let sizes = [
            "--width",
            "32",
            "--height",
            "16",
            "--allow-missing",
            "--quiet",
        ];
        as_nobody(
            &world,
            &[&["eigen", "--raw", raw, "--out", out], &sizes[..]].concat(),
        )
    };
    let drive = format!("raw/{DRIVE_2}");
    let scans = format!("raw/{DRIVE_2}/velodyne_points/data");
    let image = format!("raw/{DRIVE_1}/image_03/data/0000000004.png");
    for (number, (name, file)) in [(&drive, false), (&scans, false), (&image, true)]
        .into_iter()
        .enumerate()
    {
        allow(name, 0o000);
        let outcome = run(&format!("out-{number}"));
        allow(name, if file { 0o644 } else { 0o755 });
        let Some(outcome) = outcome else { return };
        assert_eq!(outcome.code, 1, "{}", outcome.stderr);
        assert_has(&outcome.stderr, &[name, "Permission denied"]);
        assert_has(&outcome.stdout, &["val 1 of 330"]);
        let failures = world.path(&format!("out-{number}/failures.csv"));
        let failures = std::fs::read_to_string(failures).unwrap();
        assert_has(&failures, &[name, "Permission denied"]);
    }

    allow("raw", 0o000);
    let outcome = run("none").unwrap();
    allow("raw", 0o755);
    assert_eq!(outcome.code, 2, "{}", outcome.stderr);
    assert_has(
        &outcome.stderr,
        &["cannot list the folder", "Permission denied"],
    );
    // Names can be listed, but nothing behind them looked at.
    allow("raw", 0o444);
    let outcome = run("none").unwrap();
    allow("raw", 0o755);
    assert_eq!(outcome.code, 2, "{}", outcome.stderr);
    assert_has(
        &outcome.stderr,
        &["cannot list the folder", "Permission denied"],
    );

    let noc = "stereo/training/disp_noc_0";
    let [raw, stereo, out] = ["raw", "stereo", "scenes"].map(|name| world.path(name));
    let [raw, stereo, out] = [&raw, &stereo, &out].map(|path| path.to_str().unwrap());
    allow(noc, 0o000);
    let args = [
        "kitti",
        "--raw",
        raw,
        "--stereo2015",
        stereo,
        "--out",
        out,
        "--allow-missing",
    ];
    let outcome = as_nobody(&world, &args);
    allow(noc, 0o755);
    let outcome = outcome.unwrap();
    assert_eq!(outcome.code, 1, "{}", outcome.stderr);
    assert_has(&outcome.stderr, &[noc, "Permission denied"]);

    let city = "cityscapes/leftImg8bit/train/aachen";
    let files = [
        (format!("{city}/aachen_000000_000019_leftImg8bit.png"), 40),
        (
            city.replace("aachen", "bochum") + "/bochum_000000_000019_leftImg8bit.png",
            41,
        ),
    ];
    for (name, seed) in &files {
        let png = image_files::encode_png_rgb(&picture(*seed));
        world.write(name, &png);
        world.write(&name.replace("left", "right"), &png);
        let camera = name
            .replace("leftImg8bit.png", "camera.json")
            .replace("leftImg8bit", "camera");
        world.write(
            &camera,
            br#"{"extrinsic": {"baseline": 0.2}, "intrinsic": {"fx": 44.2}}"#,
        );
    }
    allow(city, 0o000);
    let (root, out) = (world.path("cityscapes"), world.path("city-set"));
    let args = ["cityscapes", "--quiet", "--root", root.to_str().unwrap()];
    let outcome = as_nobody(
        &world,
        &[&args[..], &["--out", out.to_str().unwrap()]].concat(),
    );
    allow(city, 0o755);
    let outcome = outcome.unwrap();
    assert_eq!(outcome.code, 1, "{}", outcome.stderr);
    assert_has(&outcome.stderr, &[city, "Permission denied"]);
    assert_has(&outcome.stdout, &["train 1 of 1 pairs"]);

    std::fs::create_dir(world.path("theirs")).unwrap();
    allow("theirs", 0o555);
    let outcome = run("theirs/set").unwrap();
    assert_eq!(outcome.code, 1, "{}", outcome.stderr);
    assert_has(&outcome.stderr, &["theirs/set", "Permission denied"]);
    assert!(!world.path("none").exists());
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
        ("nowhere", &["there is no such folder"][..]),
        ("raw/RENDERED", &["there is no such folder"]),
        ("raw/2011_09_26/calib_cam_to_cam.txt", &["this is a file"]),
        (
            "archives/2011_09_26_drive_0001_sync.zip",
            &["0001_sync.zip is no whole zip archive"],
        ),
        ("empty", &["the folder is empty", "looked for"]),
        ("raw/2011_09_26", &["one recording day", &right]),
        (&format!("raw/{DRIVE_1}"), &["one drive", &two_up]),
        ("", &[&deeper]),
        ("stereo", &["--stereo2015"]),
        ("archives", &["0001_sync.zip is no whole zip archive"]),
        ("other", &["none of the five days"]),
    ] {
        let outcome = raw(name);
        assert_eq!(outcome.code, 2, "{name}: {}", outcome.stderr);
        assert_has(&outcome.stderr, &["error: --raw "]);
        assert_has(&outcome.stderr, parts);
    }
    for (name, part) in [
        ("nowhere", "there is no such folder"),
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
