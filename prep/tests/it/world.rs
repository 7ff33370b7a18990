//! A folder with two drives and two scenes in KITTI's layouts, made up by closed formulas, and `prep`
//! run over it.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};

use assert_cmd::Command;
use image::{Rgb, RgbImage};
use strat_splits::Role;
use strat_store::image_files;
use strat_store::set::PreparedSet;
use tempfile::TempDir;

pub const WIDTH: u32 = 62;
pub const HEIGHT: u32 = 20;
pub const DRIVE_1: &str = "2011_09_26/2011_09_26_drive_0001_sync";
pub const DRIVE_2: &str = "2011_09_26/2011_09_26_drive_0002_sync";
pub const CAM: &str = "calib_time: 09-Jan-2012 13:57:47
S_rect_02: 6.2e+01 2.0e+01
R_rect_00: 1 0 0 0 1 0 0 0 1
P_rect_00: 1,1+02 0 31 0 0 36 10 0 0 0 1 0
P_rect_02: 36 0 31 0 0 36 10 0 0 0 1 0
P_rect_03: 36 0 31 -18 0 36 10 0 0 0 1 0
";

pub const VELO: &str = "R: 0 -1 0 0 0 -1 1 0 0\nT: 0 0 0.25\n";

/// A folder with `raw` and `stereo`, and room for outputs.
pub struct World(pub TempDir);

impl World {
    /// Drive 0001 (training in both splits): frames 4 and 5, of which 5 is drawn for validation.
    /// Drive 0002 (training in KITTI, test in Eigen): frames 0 and 3, both Eigen test frames.
    /// Stereo 2015: scenes 0 and 6, of which only 6 has `disp_occ_0`.
    pub fn new() -> Self {
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

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub fn write(&self, name: &str, bytes: &[u8]) {
        let path = self.path(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, bytes).unwrap();
    }

    pub fn remove(&self, name: &str) {
        std::fs::remove_file(self.path(name)).unwrap();
    }

    /// Cuts a file in half.
    pub fn truncate(&self, name: &str) -> Vec<u8> {
        let bytes = std::fs::read(self.path(name)).unwrap();
        self.write(name, &bytes[..bytes.len() / 2 + 1]);
        bytes
    }

    pub fn eigen(&self, out: &str, more: &[&str]) -> Outcome {
        self.run("eigen", &[], out, more)
    }

    pub fn kitti(&self, out: &str, more: &[&str]) -> Outcome {
        let stereo = self.path("stereo");
        self.run(
            "kitti",
            &["--stereo2015", stereo.to_str().unwrap()],
            out,
            more,
        )
    }

    pub fn run(&self, split: &str, inputs: &[&str], out: &str, more: &[&str]) -> Outcome {
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
    pub fn pack(&self, root: &str, inner: &[&str], archive: &str) {
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
    pub fn pack_all(&self) {
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

    pub fn kitti_from(&self, raw: &str, stereo: &str, out: &str) -> Outcome {
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

    pub fn open(&self, out: &str) -> PreparedSet {
        PreparedSet::open(&self.path(out)).unwrap()
    }
}

pub struct Outcome {
    pub code: i32,
    pub stdout: String,
    pub stderr: String,
}

pub fn prep(args: &[impl AsRef<str>]) -> Outcome {
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
pub fn assert_has(text: &str, parts: &[&str]) {
    for part in parts {
        assert!(text.contains(part), "`{part}` is not in:\n{text}");
    }
}

pub fn picture(seed: u32) -> RgbImage {
    RgbImage::from_fn(WIDTH, HEIGHT, |x, y| {
        Rgb([0, 1, 2].map(|c| ((x * 7 + y * 11 + c * 53 + seed * 29 + x * y % 13) % 256) as u8))
    })
}

/// A wall eight metres ahead of the scanner, in little-endian `f32`.
pub fn scan() -> Vec<u8> {
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
pub fn disparity() -> Vec<u16> {
    (0..WIDTH * HEIGHT)
        .map(|i| if i % 3 == 0 { 0 } else { (300 + i * 7) as u16 })
        .collect()
}

/// All files below a folder with their content.
pub fn tree(root: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
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
pub fn assert_same_tree(a: &Path, b: &Path) {
    let (a, b) = (tree(a), tree(b));
    assert_eq!(a.keys().collect::<Vec<_>>(), b.keys().collect::<Vec<_>>());
    for (path, content) in &a {
        assert!(content == &b[path], "{} differs", path.display());
    }
}

pub fn ids(set: &PreparedSet, role: Role) -> Vec<String> {
    set.samples(role)
        .unwrap()
        .into_iter()
        .map(|sample| sample.id)
        .collect()
}
