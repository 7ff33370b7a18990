//! Saved predictions as other programs lay them out, read image by image.

use std::fs;
use std::io::Write;
use std::path::Path;

use strat_store::set::{Content, FileRef, Sample};
use strat_store::{image_files, npy};

use super::{SavedError, SavedPredictions};

const DRIVE: &str = "2011_09_26_drive_0002";

fn sample(id: &str) -> Sample {
    let file = FileRef {
        path: "x".to_owned(),
        blake3: String::new(),
    };
    Sample::new(id, (4, 2), 700.0, 0.5, file)
}

fn frames() -> [Sample; 2] {
    ["0000000069", "0000000054"].map(|frame| sample(&format!("{DRIVE}/{frame}")))
}

fn open(path: &Path, samples: &[Sample]) -> Result<SavedPredictions, SavedError> {
    SavedPredictions::open("x", path, Content::Eigen, samples)
}

/// The first value of the map of each image.
fn firsts(path: &Path, samples: &[Sample]) -> Vec<f32> {
    let saved = open(path, samples).unwrap();
    let first = |sample: &Sample| saved.map(&sample.id).unwrap().data[0];
    samples.iter().map(first).collect()
}

fn describe(path: &Path) {
    fs::write(path, "meaning: depth_m\n").unwrap();
}

/// Depth in metres as 16-bit PNG, times 256.
fn png(metres: u16) -> Vec<u8> {
    image_files::encode_png_gray16(4, 2, &[256 * metres; 8])
}

#[test]
fn folders_of_bts_and_of_stereo_2015_are_read() {
    let folder = tempfile::tempdir().unwrap();
    describe(&folder.path().join("predictions.yaml"));
    for (metres, frame) in [(7, "0000000069"), (9, "0000000054")] {
        let name = format!("{DRIVE}_sync_{frame}.png");
        fs::write(folder.path().join(name), png(metres)).unwrap();
    }
    assert_eq!(firsts(folder.path(), &frames()), [7.0, 9.0]);
    fs::write(folder.path().join("000006_10.png"), png(5)).unwrap();
    let scene = [sample("kitti2015/000006")];
    assert_eq!(firsts(folder.path(), &scene), [5.0]);
}

#[test]
fn a_picture_beside_the_numbers_is_not_taken_for_them() {
    for other in ["npy", "exr", "pfm", "npz"] {
        let folder = tempfile::tempdir().unwrap();
        describe(&folder.path().join("predictions.yaml"));
        let stem = format!("{DRIVE}_0000000069");
        fs::write(folder.path().join(format!("{stem}.png")), png(7)).unwrap();
        assert!(open(folder.path(), &frames()).is_ok());
        fs::write(folder.path().join(format!("{stem}.{other}")), b"").unwrap();
        let error = open(folder.path(), &frames()).unwrap_err().to_string();
        for part in [format!("{stem}.png"), format!("{stem}.{other}")] {
            assert!(error.contains(&part), "{error}");
        }
    }
}

#[test]
fn an_archive_of_an_array_for_each_image_is_read_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("all.npz");
    describe(&path.with_extension("yaml"));
    let mut zip = zip::ZipWriter::new(fs::File::create(&path).unwrap());
    let options = zip::write::SimpleFileOptions::default();
    // In another order than the set's, and with one that the set does not have.
    for (metres, frame) in [
        (9.0, "0000000054"),
        (3.0, "0000000099"),
        (7.0, "0000000069"),
    ] {
        zip.start_file(format!("{DRIVE}/{frame}.npy"), options)
            .unwrap();
        zip.write_all(&npy::encode(4, 2, &[metres; 8])).unwrap();
    }
    zip.finish().unwrap();
    assert_eq!(firsts(&path, &frames()), [7.0, 9.0]);
    let saved = open(&path, &frames()).unwrap();
    assert!(matches!(saved.map("a/1"), Err(SavedError::Missing { .. })));
}

/// An array of 16-bit integers, 1 x H x W for each of the values.
fn integers(values: &[u16]) -> Vec<u8> {
    let text = format!(
        "{{'descr': '<u2', 'fortran_order': False, 'shape': ({}, 2, 4), }}\n",
        values.len()
    );
    let length = u16::try_from(text.len()).unwrap().to_le_bytes();
    let mut bytes = [b"\x93NUMPY\x01\x00", &length[..], text.as_bytes()].concat();
    bytes.extend(
        values
            .iter()
            .flat_map(|v| [*v; 8])
            .flat_map(u16::to_le_bytes),
    );
    bytes
}

#[test]
fn integers_of_an_array_are_divided_as_those_of_a_png() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.npy");
    fs::write(&path, integers(&[7 * 256, 9 * 256])).unwrap();
    describe(&path.with_extension("yaml"));
    assert_eq!(firsts(&path, &frames()), [7.0, 9.0]);
    let millimetres = "meaning: depth_m\npng_divisor: 1000\n";
    fs::write(path.with_extension("yaml"), millimetres).unwrap();
    fs::write(&path, integers(&[7000, 9000])).unwrap();
    assert_eq!(firsts(&path, &frames()), [7.0, 9.0]);
}

#[test]
fn lists_are_read_in_the_forms_in_which_they_are_published() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.npy");
    describe(&path.with_extension("yaml"));
    let values: Vec<f32> = [9.0_f32, 7.0].iter().flat_map(|v| [*v; 8]).collect();
    let mut writer = npy::PlaneWriter::create(&path).unwrap();
    for data in values.chunks(8) {
        let plane = strat_store::raster::Plane::new(4, 2, data.to_vec()).unwrap();
        writer.push(&plane).unwrap();
    }
    writer.finish().unwrap();
    let day = "2011_09_26";
    for line in [
        format!("{DRIVE}/FRAME"),
        format!("{day}/{DRIVE}_sync FRAME l"),
        format!("{day}/{DRIVE}_sync/image_02/data/FRAME.png None 721.5377"),
    ] {
        let lines = ["0000000054", "0000000069"].map(|frame| line.replace("FRAME", frame));
        let text = format!("\u{feff}{}\r\n\r\n \n", lines.join("\r\n"));
        fs::write(path.with_extension("ids.txt"), text).unwrap();
        assert_eq!(firsts(&path, &frames()), [7.0, 9.0], "{line}");
    }
    // An id of a set is itself, whatever it looks like.
    let own = ["a", "b"].map(|side| sample(&format!("{day}/{DRIVE}_sync/{side}/0000000054")));
    let ids = own.each_ref().map(|sample| sample.id.as_str()).join("\n");
    fs::write(path.with_extension("ids.txt"), ids).unwrap();
    assert_eq!(firsts(&path, &own), [9.0, 7.0]);
}
