//! `prep cityscapes` on tiny files in Cityscapes' layout.

use std::path::Path;

use assert_cmd::Command;
use image::{Rgb, RgbImage};
use strat_splits::Role;
use strat_store::image_files;
use strat_store::set::{Content, PreparedSet};

const WIDTH: u32 = 40;
const HEIGHT: u32 = 22;
/// Four fifths of 22, whole rows.
const KEPT: u32 = 17;
const CAMERA: &str = r#"{"extrinsic": {"baseline": 0.209313, "pitch": 0.038},
    "intrinsic": {"fx": 44.2, "fy": 44.3, "u0": 21.4, "v0": 10.0}}"#;

fn write(path: &Path, bytes: &[u8]) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(path, bytes).unwrap();
}

fn picture(seed: u32) -> RgbImage {
    RgbImage::from_fn(WIDTH, HEIGHT, |x, y| {
        Rgb([(x * 5 + seed) as u8, (y * 9) as u8, seed as u8])
    })
}

fn labels(width: u32) -> Vec<u8> {
    let ids: Vec<u8> = (0..width * HEIGHT).map(|i| (i / width) as u8).collect();
    image_files::encode_png_gray8(width, HEIGHT, &ids)
}

/// Left, right and camera of a frame.
fn frame(root: &Path, folder: &str, city: &str, number: u32) -> String {
    let stem = format!("{city}_{number:06}_000019");
    let png = |seed| image_files::encode_png_rgb(&picture(seed));
    for (kind, bytes) in [
        ("leftImg8bit.png", png(number)),
        ("rightImg8bit.png", png(number + 100)),
        ("camera.json", CAMERA.into()),
    ] {
        let kind_folder = kind.split_once('.').unwrap().0;
        write(
            &root.join(format!("{kind_folder}/{folder}/{city}/{stem}_{kind}")),
            &bytes,
        );
    }
    stem
}

fn prep(root: &Path, out: &Path) -> (i32, String, String) {
    let output = Command::cargo_bin("prep")
        .unwrap()
        .arg("cityscapes")
        .args(["--width", "16", "--height", "8", "--quiet", "--root"])
        .arg(root)
        .arg("--out")
        .arg(out)
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
fn roles_follow_the_folders_and_the_bonnet_goes() {
    let folder = tempfile::tempdir().unwrap();
    let (root, out) = (
        folder.path().join("Städte bei Nacht"),
        folder.path().join("set"),
    );
    frame(&root, "train", "aachen", 1);
    frame(&root, "train_extra", "erlangen", 2);
    let val = frame(&root, "val", "lindau", 3);
    frame(&root, "test", "berlin", 4);
    let name = format!("gtFine/val/lindau/{val}_gtFine_labelIds.png");
    write(&root.join(name), &labels(WIDTH));
    let (code, stdout, err) = prep(&root, &out);
    assert_eq!(code, 0, "{err}");
    assert!(
        stdout.contains("train 2 of 2 pairs, val 1 of 1, test 1 of 1"),
        "{stdout}"
    );

    let set = PreparedSet::open(&out).unwrap();
    assert_eq!(set.manifest.content, Content::Cityscapes);
    let sample = &set.samples(Role::Val).unwrap()[0];
    assert_eq!(sample.id, "lindau/lindau_000003_000019");
    assert_eq!((sample.width, sample.height), (WIDTH, KEPT));
    assert_eq!((sample.focal_px, sample.baseline_m), (44.2, 0.209313));
    assert!(sample.left_full.is_none() && sample.right.is_some());
    let (width, height, ids) =
        image_files::read_gray8(&set.path(sample.semantic.as_ref().unwrap())).unwrap();
    assert_eq!((width as u32, height as u32), (WIDTH, KEPT));
    assert_eq!((ids[0], *ids.last().unwrap()), (0, (KEPT - 1) as u8));
    let test = &set.samples(Role::Test).unwrap()[0];
    let full = image_files::read_rgb(&set.path(test.left_full.as_ref().unwrap())).unwrap();
    assert_eq!(full.dimensions(), (WIDTH, KEPT));
    assert!(
        full.enumerate_pixels()
            .all(|(x, y, pixel)| pixel == picture(4).get_pixel(x, y))
    );

    let (code, stdout, _) = prep(&root, &out);
    assert!(
        code == 0 && stdout.contains("0 files written, 10 kept"),
        "{stdout}"
    );
}

#[test]
fn what_is_missing_or_contradictory_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let (root, out) = (folder.path().join("root"), folder.path().join("set"));
    frame(&root, "train", "aachen", 1);
    let place = |kind: &str, stem: &str, after: &str| {
        root.join(format!("{kind}/train/aachen/{stem}_{after}"))
    };
    let stem = frame(&root, "train", "aachen", 2);
    std::fs::remove_file(place("rightImg8bit", &stem, "rightImg8bit.png")).unwrap();
    let stem = frame(&root, "train", "aachen", 3);
    let camera = CAMERA.replace("\"baseline\"", "\"bottomline\"");
    write(&place("camera", &stem, "camera.json"), camera.as_bytes());
    let stem = frame(&root, "train", "aachen", 4);
    write(
        &place("gtFine", &stem, "gtFine_labelIds.png"),
        &labels(WIDTH - 1),
    );
    let stem = frame(&root, "train", "aachen", 5);
    let small = image_files::encode_png_rgb(&RgbImage::new(WIDTH, HEIGHT - 5));
    write(&place("rightImg8bit", &stem, "rightImg8bit.png"), &small);

    let (code, stdout, err) = prep(&root, &out);
    assert_eq!(code, 1, "{err}");
    assert!(stdout.contains("train 1 of 5 pairs"), "{stdout}");
    let failures = std::fs::read_to_string(out.join("failures.csv")).unwrap();
    for reason in [
        "aachen_000002_000019_rightImg8bit.png",
        "missing field `baseline`",
        "without its bottom fifth it is 39x17, but its left image is 40x17",
        "without its bottom fifth it is 40x13, but its left image is 40x17",
    ] {
        assert!(
            failures.contains(reason),
            "{reason} should be in\n{failures}"
        );
    }

    let (code, _, err) = prep(&root.join("leftImg8bit"), &folder.path().join("other"));
    assert!(code == 2 && err.contains("no folder leftImg8bit"), "{err}");
    let (code, _, err) = prep(&root, &root.join("set"));
    assert!(
        code == 2 && err.contains("lies inside the input folder"),
        "{err}"
    );
}

#[test]
fn merged_parts_are_the_set_of_a_single_run() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    for number in 0..9 {
        let place = [("train", "aachen"), ("val", "lindau"), ("test", "berlin")];
        let (folder, city) = place[number as usize % 3];
        frame(root, folder, city, number);
    }
    let broken = "rightImg8bit/val/lindau/lindau_000004_000019_rightImg8bit.png";
    write(&root.join(broken), b"no picture");
    crate::parts::assert_parts_make_the_whole(1, |out, more| {
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_prep"));
        command.args(["cityscapes", "--width", "16", "--height", "8", "--quiet"]);
        command.arg("--root").arg(root);
        command.args(more).arg("--out").arg(out);
        command
    });
}
