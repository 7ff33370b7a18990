//! `prep pairs` and `prep export` on tiny pairs made up by closed formulas.

use std::path::{Path, PathBuf};

use assert_cmd::Command;
use image::{Rgb, RgbImage};
use strat_splits::Role;
use strat_store::set::{Content, PreparedSet};
use strat_store::{exr, image_files};
use tempfile::TempDir;

const WIDTH: u32 = 30;
const HEIGHT: u32 = 20;
const SIZE: &[&str] = &["--width", "16", "--height", "8", "--quiet"];

/// A folder with spaces and letters beyond ASCII in its name.
struct World(TempDir);

impl World {
    fn new() -> Self {
        let world = Self(TempDir::new().unwrap());
        for i in 0..4 {
            for side in ["links", "rechts"] {
                let image = picture(WIDTH, HEIGHT, i);
                let bytes = image_files::encode_png_rgb(&image);
                world.write(&format!("{side}/Bild {i}.png"), &bytes);
            }
        }
        world
    }

    fn root(&self) -> PathBuf {
        self.0.path().join("Straße nach Jena")
    }

    fn write(&self, path: &str, bytes: &[u8]) {
        let path = self.root().join(path);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, bytes).unwrap();
    }

    /// Runs `prep pairs`; exit code, stdout and stderr.
    fn prep(&self, csv: &str) -> (i32, String, String) {
        self.write("pairs.csv", csv.as_bytes());
        let csv = self.root().join("pairs.csv");
        let mut args = vec!["pairs", "--csv", csv.to_str().unwrap()];
        args.extend_from_slice(SIZE);
        let out = self.out();
        args.extend(["--out", out.to_str().unwrap()]);
        prep(&args)
    }

    fn out(&self) -> PathBuf {
        self.0.path().join("Menge eins")
    }
}

fn prep(args: &[&str]) -> (i32, String, String) {
    let output = Command::cargo_bin("prep")
        .unwrap()
        .args(args)
        .output()
        .unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    let code = output.status.code().unwrap();
    (code, text(output.stdout), text(output.stderr))
}

fn picture(width: u32, height: u32, seed: u32) -> RgbImage {
    RgbImage::from_fn(width, height, |x, y| {
        Rgb([(x * 7 + seed) as u8, (y * 11) as u8, (x * y + seed) as u8])
    })
}

fn disparity_png(value: impl Fn(u32) -> u16) -> Vec<u8> {
    let values: Vec<u16> = (0..WIDTH * HEIGHT).map(value).collect();
    image_files::encode_png_gray16(WIDTH, HEIGHT, &values)
}

/// Version 1.0 of NumPy's format, put together by its description.
fn npy(descr: &str, shape: &str, data: &[u8]) -> Vec<u8> {
    let header = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}\n");
    let length = (header.len() as u16).to_le_bytes();
    [b"\x93NUMPY\x01\x00", &length[..], header.as_bytes(), data].concat()
}

fn files_below(folder: &Path) -> usize {
    let entries = std::fs::read_dir(folder)
        .unwrap()
        .map(|e| e.unwrap().path());
    entries
        .map(|path| if path.is_dir() { files_below(&path) } else { 1 })
        .sum()
}

#[test]
fn disparity_becomes_depth_at_full_size_and_test_pairs_keep_their_image() {
    let world = World::new();
    // Value i at pixel i: 0 is no measurement; pixel 512 has 2 px.
    world.write("d/1.png", &disparity_png(|i| i as u16));
    let (code, out, err) = world.prep(
        "left,right,focal_px,baseline_m,split,disparity\n\
         links/Bild 0.png,rechts/Bild 0.png,700,0.5,train,\n\
         links/Bild 1.png,rechts/Bild 1.png,700,0.5,test,d/1.png\n",
    );
    assert_eq!(code, 0, "{err}");
    assert!(
        out.contains("train 1 of 1 pairs, val 0 of 0, test 1 of 1"),
        "{out}"
    );
    let set = PreparedSet::open(&world.out()).unwrap();
    assert_eq!(set.manifest.content, Content::Pairs);
    assert_eq!(set.manifest.cameras.len(), 1);
    let train = &set.samples(Role::Train).unwrap()[0];
    assert!(train.left_full.is_none() && train.depth_camera.is_none());
    let test = &set.samples(Role::Test).unwrap()[0];
    assert_eq!(test.id, "links/Bild 1");
    assert_eq!((test.width, test.height), (WIDTH, HEIGHT));
    let small = image_files::read_rgb(&set.path(test.right.as_ref().unwrap())).unwrap();
    assert_eq!(small.dimensions(), (16, 8));
    let original = std::fs::read(world.root().join("links/Bild 1.png")).unwrap();
    let kept = std::fs::read(set.path(test.left_full.as_ref().unwrap())).unwrap();
    assert_eq!(kept, original);
    let (depth, header) = exr::read_depth(&set.path(test.depth_camera.as_ref().unwrap())).unwrap();
    assert_eq!(
        (depth.width, depth.height),
        (WIDTH as usize, HEIGHT as usize)
    );
    assert_eq!(depth.data[0], 0.0);
    assert_eq!(depth.data[512], 175.0, "700 * 0.5 / 2");
    assert_eq!((header.focal_px, header.baseline_m), (700.0, 0.5));
}

#[test]
fn depth_is_read_from_npy_and_exr_and_scaled() {
    let world = World::new();
    let metres = |i: u32| 1.0 + i as f32 / 4.0;
    let doubles: Vec<u8> = (0..WIDTH * HEIGHT)
        .flat_map(|i| (f64::from(metres(i)) * 1000.0).to_le_bytes())
        .collect();
    world.write("d/0.npy", &npy("<f8", "(20, 30)", &doubles));
    let header = exr::DepthHeader {
        source: "test".to_owned(),
        axis: "camera-z".to_owned(),
        focal_px: 1.0,
        baseline_m: 1.0,
        frame: String::new(),
    };
    let plane = strat_store::raster::Plane::new(
        WIDTH as usize,
        HEIGHT as usize,
        (0..WIDTH * HEIGHT).map(metres).collect(),
    );
    let plane = plane.unwrap();
    world.write("d/1.exr", &exr::encode_depth(&plane, &header).unwrap());
    world.write("d/2.png", &disparity_png(|i| (metres(i) * 256.0) as u16));
    let (code, _, err) = world.prep(
        "id,left,right,focal_px,baseline_m,split,depth,depth_scale\n\
         a,links/Bild 0.png,rechts/Bild 0.png,700,0.5,val,d/0.npy,1000\n\
         b,links/Bild 1.png,rechts/Bild 1.png,700,0.5,val,d/1.exr,\n\
         c,links/Bild 2.png,rechts/Bild 2.png,700,0.5,val,d/2.png,\n",
    );
    assert_eq!(code, 0, "{err}");
    let set = PreparedSet::open(&world.out()).unwrap();
    let samples = set.samples(Role::Val).unwrap();
    assert_eq!(samples.len(), 3);
    for sample in samples {
        let file = set.path(sample.depth_camera.as_ref().unwrap());
        assert_eq!(exr::read_depth(&file).unwrap().0, plane, "{}", sample.id);
    }
}

/// As NYU Depth (millimetres), DIODE (rows, columns, 1), Middlebury (`doffs`) and ETH3D (infinite where
/// nothing was measured) store their truth.
#[test]
fn images_alone_are_sets_to_test_on() {
    let world = World::new();
    let floats = |value: fn(u32) -> f32| -> Vec<u8> {
        let values = (0..WIDTH * HEIGHT).map(value);
        values.flat_map(f32::to_le_bytes).collect()
    };
    // Pixel 0 says that it was not measured, pixel 1 has 2 m.
    let millimetres = |i| match i {
        0 => 65535,
        _ => 2000,
    };
    world.write("d/0.png", &disparity_png(millimetres));
    let metres = floats(|i| if i == 0 { 0.0 } else { 2.0 });
    world.write("d/1.npy", &npy("<f4", "(20, 30, 1)", &metres));
    let (code, out, err) = world.prep(
        "left,depth,depth_scale,invalid\n\
         links/Bild 0.png,d/0.png,1000,65535\n\
         links/Bild 1.png,d/1.npy,,\n",
    );
    assert_eq!(code, 0, "{err}");
    assert!(out.contains("test 2 of 2") && err.is_empty(), "{out}{err}");
    let depths = |set: &PreparedSet| -> Vec<[f32; 2]> {
        let samples = set.samples(Role::Test).unwrap();
        let depth = |sample: &strat_store::set::Sample| {
            let file = set.path(sample.depth_camera.as_ref().unwrap());
            let plane = exr::read_depth(&file).unwrap().0;
            [plane.data[0], plane.data[1]]
        };
        samples.iter().map(depth).collect()
    };
    let set = PreparedSet::open(&world.out()).unwrap();
    assert_eq!(depths(&set), [[0.0, 2.0]; 2]);
    assert!(set.manifest.cameras.is_empty());
    let sample = &set.samples(Role::Test).unwrap()[0];
    assert!(sample.right.is_none() && sample.left_full.is_some());
    assert_eq!((sample.focal_px, sample.baseline_m), (0.0, 0.0));
    let (code, out, _) = prep(&["verify", world.out().to_str().unwrap()]);
    assert_eq!(code, 0, "{out}");

    std::fs::remove_dir_all(world.out()).unwrap();
    let disparity = floats(|i| if i == 0 { f32::INFINITY } else { 0.0 });
    world.write("d/2.npy", &npy("<f4", "(20, 30)", &disparity));
    let row = |offset: &str, invalid: &str, right: &str| {
        format!("links/Bild 2.png,{right},700,0.5,test,d/2.npy,{offset},{invalid}\n")
    };
    let head = "left,right,focal_px,baseline_m,split,disparity,disparity_offset_px,invalid\n";
    let (code, _, err) = world.prep(&[head, &row("35", "inf", "")].concat());
    assert_eq!(code, 0, "{err}");
    let set = PreparedSet::open(&world.out()).unwrap();
    // 700 * 0.5 / (0 + 35); 0 is a measured disparity where another value is the invalid one.
    assert_eq!(depths(&set), [[0.0, 10.0]]);
    let (code, _, err) = world.prep(&[head, &row("35", "", "rechts/Bild 2.png")].concat());
    assert_eq!(code, 1, "{err}");
    assert!(err.contains("no measured pixel"), "{err}");
    let (code, _, err) = world.prep(&[head, &row("-1", "inf", "")].concat());
    assert_eq!(code, 1, "{err}");
}

#[test]
fn merged_parts_are_the_set_of_a_single_run() {
    let world = World::new();
    world.write("d/1.png", &disparity_png(|i| i as u16));
    let mut csv = "id,left,right,focal_px,baseline_m,split,disparity\n".to_owned();
    for i in 0..12 {
        let role = ["train", "val", "test"][i % 3];
        let (image, gone) = (i % 4, if i == 7 { "x" } else { "" });
        csv += &format!(
            "p{i},links/Bild {image}.png{gone},rechts/Bild {image}.png,700,0.5,{role},d/1.png\n"
        );
    }
    // Bad lines belong to no part: one without a name, one of a name that is there already.
    csv += ",,,,,,\np3,links/Bild 0.png,rechts/Bild 0.png,700,0.5,train,\n";
    world.write("pairs.csv", csv.as_bytes());
    let list = world.root().join("pairs.csv");
    let command = |out: &Path, more: &[&str]| {
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_prep"));
        command.arg("pairs").args(SIZE).args(more);
        command.arg("--csv").arg(&list).arg("--out").arg(out);
        command
    };
    crate::parts::assert_parts_make_the_whole(1, command);

    // A list that has changed between the parts is no list of one set.
    let out = world.out();
    command(&out, &["--shard", "0/2"]).output().unwrap();
    world.write("pairs.csv", csv.replace("p0,", "first,").as_bytes());
    command(&out, &["--shard", "1/2"]).output().unwrap();
    let refused = crate::parts::merge(&out);
    let told = String::from_utf8_lossy(&refused.stderr);
    assert_eq!(refused.status.code(), Some(2), "{told}");
    assert!(told.contains("made from different frames"), "{told}");
    assert!(!out.join("manifest.yaml").exists());
}

#[test]
fn bad_frames_cost_themselves_only_and_a_second_run_completes() {
    let world = World::new();
    world.write(
        "rechts/klein.png",
        &image_files::encode_png_rgb(&picture(29, 20, 0)),
    );
    world.write("d/klein.npy", &npy("<f4", "(1, 2)", &[0; 8]));
    world.write("d/ganz.npy", &npy("<i8", "(1, 1)", &[0; 8]));
    world.write("d/leer.png", &disparity_png(|_| 0));
    world.write("d/text.tif", b"");
    let csv = "id,left,right,focal_px,baseline_m,split,disparity\n\
         good,links/Bild 0.png,rechts/Bild 0.png,700,0.5,train,\n\
         focal,links/Bild 0.png,rechts/Bild 0.png,long,0.5,train,\n\
         gone,links/Bild 9.png,rechts/Bild 0.png,700,0.5,train,\n\
         sizes,links/Bild 0.png,rechts/klein.png,700,0.5,train,\n\
         truth,links/Bild 0.png,rechts/Bild 0.png,700,0.5,train,d/klein.npy\n\
         whole,links/Bild 0.png,rechts/Bild 0.png,700,0.5,train,d/ganz.npy\n\
         empty,links/Bild 0.png,rechts/Bild 0.png,700,0.5,train,d/leer.png\n\
         kind,links/Bild 0.png,rechts/Bild 0.png,700,0.5,train,d/text.tif\n\
         late,links/Bild 3.png,rechts/spät.png,700,0.5,test,\n";
    let (code, out, err) = world.prep(csv);
    assert_eq!(code, 1, "{err}");
    assert!(
        out.contains("train 1 of 8 pairs") && out.contains("test 0 of 1"),
        "{out}"
    );
    let failures = std::fs::read_to_string(world.out().join("failures.csv")).unwrap();
    for reason in [
        "line 3: `focal_px` should be a positive number, but is `long`",
        "Bild 9.png",
        "klein.png is 29x20, but its left image is 30x20",
        "klein.npy is 2x1, but its left image is 30x20",
        "ganz.npy: its type is `<i8`",
        "leer.png: it has no measured pixel",
        "text.tif: ground truth is read from .png",
        "spät.png",
    ] {
        assert!(
            failures.contains(reason),
            "{reason} should be in\n{failures}"
        );
    }
    assert_eq!(failures.lines().count(), 9, "{failures}");

    let late = image_files::encode_png_rgb(&picture(WIDTH, HEIGHT, 3));
    world.write("rechts/spät.png", &late);
    let rows: Vec<_> = csv
        .lines()
        .enumerate()
        .filter(|(i, _)| [0, 1, 9].contains(i))
        .collect();
    let rows: String = rows.iter().map(|(_, row)| format!("{row}\n")).collect();
    let (code, out, err) = world.prep(&rows);
    assert_eq!(code, 0, "{err}");
    // Of the late pair the left image and its original were there already.
    assert!(out.contains("1 files written, 4 kept"), "{out}");
    assert!(!world.out().join("failures.csv").exists());
    let files = files_below(&world.out());
    let (code, out, _) = world.prep(&rows);
    assert_eq!((code, files_below(&world.out())), (0, files));
    assert!(out.contains("0 files written, 5 kept"), "{out}");
}

#[test]
fn wrong_lists_and_folders_are_refused_before_anything_is_written() {
    let world = World::new();
    for (csv, reason) in [
        ("left,right,focal_px\n", "`baseline_m` is missing"),
        (
            "left,right,focal_px,baseline_m,depht\n",
            "unknown column `depht`",
        ),
        ("left,right,focal_px,baseline_m\n", "no rows"),
        (
            "left,right,focal_px,baseline_m\na,b,c,d\n",
            "no row can be used",
        ),
    ] {
        let (code, _, err) = world.prep(csv);
        assert_eq!(code, 2, "{err}");
        assert!(err.contains(reason) && err.lines().count() == 1, "{err}");
        assert!(!world.out().exists());
    }
    let (code, _, err) = prep(&["pairs", "--csv", "none.csv", "--out", "x"]);
    assert!(code == 2 && err.contains("none.csv"), "{err}");
    std::fs::create_dir(world.out()).unwrap();
    std::fs::write(world.out().join("letter.txt"), b"dear").unwrap();
    let row = "left,right,focal_px,baseline_m\nlinks/Bild 0.png,rechts/Bild 0.png,700,0.5\n";
    let (code, _, err) = world.prep(row);
    assert!(code == 2 && err.contains("holds other things"), "{err}");
}

#[test]
fn ground_truth_is_exported() {
    let world = World::new();
    world.write("d/1.png", &disparity_png(|i| i as u16));
    let (code, _, err) = world.prep(
        "id,left,right,focal_px,baseline_m,split,disparity\n\
         ort/b1,links/Bild 1.png,rechts/Bild 1.png,700,0.5,test,d/1.png\n\
         ort/b2,links/Bild 2.png,rechts/Bild 2.png,700,0.5,test,\n",
    );
    assert_eq!(code, 0, "{err}");
    let set = PreparedSet::open(&world.out()).unwrap();
    let file = set
        .samples(Role::Test)
        .unwrap()
        .remove(0)
        .depth_camera
        .unwrap();
    let (depth, _) = exr::read_depth(&set.path(&file)).unwrap();
    let target = world.0.path().join("für andere");
    let run = |format: &str, more: &[&str]| {
        let (set, out) = (world.out(), target.clone());
        let mut args = vec![
            "export",
            set.to_str().unwrap(),
            "--out",
            out.to_str().unwrap(),
        ];
        args.extend(["--format", format]);
        args.extend(more);
        prep(&args)
    };

    let (code, out, err) = run("npz", &[]);
    assert_eq!(code, 0, "{err}");
    assert!(
        out.contains("1 test frames of camera ground truth"),
        "{out}"
    );
    assert!(
        err.contains("1 test samples have no camera ground truth"),
        "{err}"
    );
    let npz = std::fs::read(target.join("test-camera.npz")).unwrap();
    let mut zip = zip::ZipArchive::new(std::io::Cursor::new(&npz)).unwrap();
    let mut entry = zip.by_name("ort/b1.npy").unwrap();
    let mut bytes = Vec::new();
    std::io::Read::read_to_end(&mut entry, &mut bytes).unwrap();
    let values = bytes[bytes.len() - depth.data.len() * 4..].chunks_exact(4);
    let values: Vec<f32> = values
        .map(|v| f32::from_le_bytes(v.try_into().unwrap()))
        .collect();
    assert_eq!(values, depth.data);
    drop(entry);
    assert_eq!(run("npz", &[]).0, 0);
    assert_eq!(
        std::fs::read(target.join("test-camera.npz")).unwrap(),
        npz,
        "same set, same bytes"
    );

    assert_eq!(run("npy", &["--kind", "camera"]).0, 0);
    assert_eq!(std::fs::read(target.join("ort/b1.npy")).unwrap(), bytes);
    let (code, _, err) = run("png16", &[]);
    assert_eq!(code, 0, "{err}");
    assert!(err.contains("pixels are beyond 255.996 m"), "{err}");
    let (_, _, values) = image_files::read_gray16(&target.join("ort/b1.png")).unwrap();
    assert_eq!((values[0], values[512]), (0, 175 * 256));

    let (code, _, err) = run("npz", &["--kind", "laser"]);
    assert!(
        code == 2 && err.contains("no laser ground truth; there is camera"),
        "{err}"
    );
    let (code, _, err) = run("npz", &["--role", "val"]);
    assert!(code == 2 && err.contains("no ground truth"), "{err}");
    std::fs::write(set.path(&file), b"damaged").unwrap();
    let (code, _, err) = run("npy", &[]);
    assert!(code == 1 && err.contains("ort/b1 left out"), "{err}");
}

/// A PNG that lies on its side: its EXIF data, a big-endian TIFF directory of one entry, says that it is
/// to be turned by 90 degrees to the right (CIPA DC-008, orientation 6).
fn lying(upright: &RgbImage) -> Vec<u8> {
    use image::ImageEncoder;
    let stored = image::imageops::rotate270(upright);
    let mut exif = b"MM\0\x2a\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0".to_vec();
    exif.extend([6, 0, 0, 0, 0, 0, 0]);
    let mut bytes = Vec::new();
    let mut encoder = image::codecs::png::PngEncoder::new(&mut bytes);
    encoder.set_exif_metadata(exif).unwrap();
    let (width, height) = stored.dimensions();
    encoder
        .write_image(&stored, width, height, image::ExtendedColorType::Rgb8)
        .unwrap();
    bytes
}

#[test]
fn images_that_lie_on_their_side_are_turned() {
    let rows = "left,right,focal_px,baseline_m,split,id,disparity\n\
                links/Bild 1.png,rechts/Bild 1.png,700,0.5,test,a,d/1.png\n";
    let made = |lie: bool| {
        let world = World::new();
        world.write("d/1.png", &disparity_png(|i| i as u16));
        if lie {
            let bytes = lying(&picture(WIDTH, HEIGHT, 1));
            world.write("links/Bild 1.png", &bytes);
            world.write("rechts/Bild 1.png", &bytes);
        }
        let (code, _, err) = world.prep(rows);
        assert_eq!(code, 0, "{err}");
        let set = PreparedSet::open(&world.out()).unwrap();
        let sample = set.samples(Role::Test).unwrap().remove(0);
        let full = image_files::read_rgb(&set.path(sample.left_full.as_ref().unwrap())).unwrap();
        // A second run takes the size from the first bytes alone; truth depends on the new list.
        let again = world.prep(rows);
        assert!(again.1.contains("1 files written, 3 kept"), "{}", again.1);
        (
            sample.left,
            sample.right,
            sample.depth_camera,
            sample.width,
            full,
        )
    };
    assert_eq!(made(true), made(false));
}

#[test]
fn integers_are_not_taken_for_metres() {
    let world = World::new();
    let values: Vec<u8> = (0..WIDTH * HEIGHT)
        .flat_map(|_| 2560_u16.to_le_bytes())
        .collect();
    world.write("d/1.npy", &npy("<u2", "(20, 30)", &values));
    let row = |scale: &str| {
        format!(
            "left,right,focal_px,baseline_m,split,depth,depth_scale\n\
             links/Bild 1.png,rechts/Bild 1.png,700,0.5,test,d/1.npy,{scale}\n"
        )
    };
    let (code, _, err) = world.prep(&row(""));
    assert_eq!(code, 1);
    assert!(
        err.contains("16-bit integers") && err.contains("depth_scale"),
        "{err}"
    );
    let (code, _, err) = world.prep(&row("256"));
    assert_eq!(code, 0, "{err}");
    let set = PreparedSet::open(&world.out()).unwrap();
    let sample = set.samples(Role::Test).unwrap().remove(0);
    let (depth, _) = exr::read_depth(&set.path(sample.depth_camera.as_ref().unwrap())).unwrap();
    assert!(depth.data.iter().all(|depth_m| *depth_m == 10.0));
}

#[test]
fn doubtful_ground_truth_is_said() {
    let world = World::new();
    let floats = |value: f32| -> Vec<u8> {
        // One good value, the others as given.
        let values = (0..WIDTH * HEIGHT).map(|i| if i == 0 { 8.0 } else { value });
        values.flat_map(f32::to_le_bytes).collect()
    };
    world.write("d/negative.npy", &npy("<f4", "(20, 30)", &floats(-3.0)));
    // 700 px * 0.5 m / 0.1 px = 3500 m is the farthest that this pair sees.
    world.write("d/seen.npy", &npy("<f4", "(20, 30)", &floats(3499.0)));
    world.write(
        "d/millimetres.npy",
        &npy("<f4", "(20, 30)", &floats(9000.0)),
    );
    let head = "left,right,focal_px,baseline_m,split,id,";
    let images = "links/Bild 1.png,rechts/Bild 1.png,700,0.5,test";
    let run = |kind: &str, names: &[&str]| {
        let rows: String = names
            .iter()
            .map(|n| format!("{images},{kind} {n},d/{n}.npy\n"))
            .collect();
        let _ = std::fs::remove_dir_all(world.out());
        let (code, _, err) = world.prep(&format!("{head}{kind}\n{rows}"));
        assert_eq!(code, 0, "{err}");
        err
    };
    let err = run("disparity", &["negative"]);
    let all_but_one = format!("negative.npy: {} pixels", WIDTH * HEIGHT - 1);
    for part in [
        "warning: 1 maps have negative disparities",
        "doffs",
        &all_but_one,
    ] {
        assert!(err.contains(part), "{part} should be in {err}");
    }
    assert_eq!(run("depth", &["seen"]), "");
    let err = run("depth", &["seen", "millimetres"]);
    assert!(
        err.contains("warning: 1 maps have depth at which these cameras see less"),
        "{err}"
    );
    assert!(err.contains("millimetres.npy: 599 pixels"), "{err}");

    let _ = std::fs::remove_dir_all(world.out());
    let (_, _, err) = world.prep(
        "left,right,focal_px,baseline_m\n\
         links/Bild 1.png,rechts/Bild 1.png,700,540\n\
         links/Bild 2.png,rechts/Bild 2.png,700,0.54\n",
    );
    assert!(
        err.contains("1 pairs have a baseline of more than 5 m (first: links/Bild 1, 540 m)"),
        "{err}"
    );
}
