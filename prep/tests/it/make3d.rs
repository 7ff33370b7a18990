//! `prep make3d` on one made-up picture and grid in Make3D's layout.

use std::io::Write;
use std::path::Path;

use assert_cmd::Command;
use flate2::Compression;
use flate2::write::ZlibEncoder;
use image::{Rgb, RgbImage};
use strat_splits::Role;
use strat_store::image_files;
use strat_store::set::{Content, PreparedSet};
use strat_store::{exr, resize};

const ROWS: usize = 55;
const COLUMNS: usize = 305;

fn write(path: &Path, bytes: &[u8]) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(path, bytes).unwrap();
}

/// A compressed MATLAB 5 file of one double array, put together by the format's description.
fn mat(name: &str, dims: [u32; 3], values: &[f64]) -> Vec<u8> {
    let element = |kind: u32, data: Vec<u8>| {
        let mut bytes = [kind.to_le_bytes(), (data.len() as u32).to_le_bytes()].concat();
        bytes.extend(data);
        bytes.resize(bytes.len().next_multiple_of(8), 0);
        bytes
    };
    let matrix = [
        element(6, vec![6, 0, 0, 0, 0, 0, 0, 0]),
        element(5, dims.iter().flat_map(|side| side.to_le_bytes()).collect()),
        element(1, name.into()),
        element(9, values.iter().flat_map(|v| v.to_le_bytes()).collect()),
    ];
    let mut zlib = ZlibEncoder::new(Vec::new(), Compression::fast());
    zlib.write_all(&element(14, matrix.concat())).unwrap();
    let packed = zlib.finish().unwrap();
    let mut bytes = vec![b' '; 124];
    bytes.extend_from_slice(b"\x00\x01IM\x0f\x00\x00\x00");
    bytes.extend((packed.len() as u32).to_le_bytes());
    bytes.extend(packed);
    bytes
}

fn grid() -> Vec<f64> {
    let depth = |i: usize| (i % ROWS) as f64 + (i / ROWS) as f64 / 1000.0 + 0.5;
    let mut values = vec![-1.0; ROWS * COLUMNS * 3];
    values.extend((0..ROWS * COLUMNS).map(depth));
    values
}

fn prep(root: &Path) -> (i32, String, String) {
    let output = Command::cargo_bin("prep")
        .unwrap()
        .arg("make3d")
        .args(["--width", "32", "--height", "16", "--quiet", "--images"])
        .arg(root.join("Test134"))
        .arg("--depth")
        .arg(root.join("Gridlaserdata"))
        .arg("--out")
        .arg(root.join("set"))
        .output()
        .unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    (
        output.status.code().unwrap(),
        text(output.stdout),
        text(output.stderr),
    )
}

#[test]
fn picture_and_grid_are_cropped() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    // PNG bytes under the name of a JPEG: the content counts, and PNG has the pixels as they are.
    let image = RgbImage::from_fn(1704, 2272, |x, y| Rgb([x as u8, y as u8, (y >> 8) as u8]));
    write(
        &root.join("Test134/img-op1-p-1t000.jpg"),
        &image_files::encode_png_rgb(&image),
    );
    let name = "Gridlaserdata/depth_sph_corr-op1-p-1t000.mat";
    write(
        &root.join(name),
        &mat("Position3DGrid", [55, 305, 4], &grid()),
    );
    // A grid whose picture belongs to the training part is no trouble.
    write(&root.join("Gridlaserdata/depth_sph_corr-other.mat"), b"");

    let (code, out, err) = prep(root);
    assert_eq!(code, 0, "{err}");
    assert!(out.contains("test 1 of 134"), "{out}");
    assert!(err.contains("has 134 images"), "{err}");
    let set = PreparedSet::open(&root.join("set")).unwrap();
    assert_eq!(set.manifest.content, Content::Make3d);
    let sample = &set.samples(Role::Test).unwrap()[0];
    assert_eq!(sample.id, "make3d/op1-p-1t000");
    assert_eq!((sample.width, sample.height), (1704, 852));
    assert_eq!((sample.focal_px, sample.baseline_m), (0.0, 0.0));
    assert!(sample.right.is_none());
    let full = image_files::read_rgb(&set.path(sample.left_full.as_ref().unwrap())).unwrap();
    assert_eq!(full.dimensions(), (1704, 852));
    assert_eq!(full.get_pixel(5, 0), image.get_pixel(5, 710));
    assert_eq!(full.get_pixel(1703, 851), image.get_pixel(1703, 1561));
    let small = image_files::read_rgb(&set.path(&sample.left)).unwrap();
    assert_eq!(small, resize::rgb(&full, 32, 16, set.manifest.kernel));
    let (depth, _) = exr::read_depth(&set.path(sample.depth_laser.as_ref().unwrap())).unwrap();
    assert_eq!((depth.width, depth.height), (305, 21));
    assert_eq!(depth.row(0)[0], 17.5);
    assert_eq!(depth.row(20)[304], (37.0 + 0.304 + 0.5) as f32);

    let (code, out, _) = prep(root);
    assert!(
        code == 0 && out.contains("0 files written, 3 kept"),
        "{out}"
    );
}

#[test]
fn damaged_and_lonely_files_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let image = |stem: &str, width, height| {
        let bytes = image_files::encode_png_rgb(&RgbImage::new(width, height));
        write(&root.join(format!("Test134/img-{stem}.jpg")), &bytes);
    };
    let depth = |stem: &str, bytes: &[u8]| {
        write(
            &root.join(format!("Gridlaserdata/depth_sph_corr-{stem}.mat")),
            bytes,
        );
    };
    let whole = mat("Position3DGrid", [55, 305, 4], &grid());
    for stem in ["cut", "name", "shape", "lonely"] {
        image(stem, 1704, 2272);
    }
    image("wide", 2272, 1704);
    depth("wide", &whole);
    depth("cut", &whole[..whole.len() / 2]);
    depth("name", &mat("Grid", [55, 305, 4], &grid()));
    depth("shape", &mat("Position3DGrid", [305, 55, 4], &grid()));
    let (code, out, err) = prep(root);
    assert_eq!(code, 1, "{out}{err}");
    let failures = std::fs::read_to_string(root.join("set/failures.csv")).unwrap();
    for reason in [
        "it is 2272x1704, but the test images of Make3D are 1704x2272",
        "depth_sph_corr-cut.mat: it is cut off",
        "depth_sph_corr-name.mat: it holds no array `Position3DGrid`",
        "has the shape [305, 55, 4]",
        "has no laser grid depth_sph_corr-lonely.mat",
    ] {
        assert!(
            failures.contains(reason),
            "{reason} should be in\n{failures}"
        );
    }

    std::fs::remove_dir_all(root.join("set")).unwrap();
    std::fs::remove_dir_all(root.join("Gridlaserdata")).unwrap();
    let (code, _, err) = prep(root);
    assert!(code == 2 && err.starts_with("error: --depth"), "{err}");
    assert!(!root.join("set").exists());
}

#[test]
fn merged_parts_are_the_set_of_a_single_run() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let grid = mat("Position3DGrid", [55, 305, 4], &grid());
    let image = RgbImage::from_fn(1704, 2272, |x, y| Rgb([x as u8, y as u8, 0]));
    let jpeg = image_files::encode_jpeg_rgb(&image, 60);
    for stem in ["a", "b", "c", "d", "e"] {
        write(&root.join(format!("Test134/img-{stem}.jpg")), &jpeg);
        // One picture has no grid.
        if stem != "b" {
            let name = format!("Gridlaserdata/depth_sph_corr-{stem}.mat");
            write(&root.join(name), &grid);
        }
    }
    crate::parts::assert_parts_make_the_whole(1, |out, more| {
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_prep"));
        command.args(["make3d", "--width", "32", "--height", "16", "--quiet"]);
        command.arg("--images").arg(root.join("Test134"));
        command.arg("--depth").arg(root.join("Gridlaserdata"));
        command.args(more).arg("--out").arg(out);
        command
    });
}
