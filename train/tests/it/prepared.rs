//! A tiny prepared set: textured planes at a constant distance, 128x64.

use std::collections::BTreeMap;
use std::path::Path;

use image::RgbImage;
use strat_splits::{Role, Split};
use strat_store::exr::{DepthHeader, write_depth};
use strat_store::files::{blake3_file, write_atomic};
use strat_store::image_files::encode_png_rgb;
use strat_store::inputs::Kind;
use strat_store::raster::Plane;
use strat_store::resize::Kernel;
use strat_store::set::{Content, Count, FORMAT, FileRef, Manifest, PreparedSet, Sample};

pub const WIDTH: u32 = 128;
pub const HEIGHT: u32 = 64;
const FOCAL_PX: f64 = 75.0;
const BASELINE_M: f64 = 0.54;

/// A texture that repeats nowhere near, seen `shift` pixels further right.
fn view(seed: u32, shift: f64) -> RgbImage {
    RgbImage::from_fn(WIDTH, HEIGHT, |x, y| {
        let (u, v) = (f64::from(x) + shift, f64::from(y));
        let s = f64::from(seed);
        image::Rgb(std::array::from_fn(|channel| {
            let c = channel as f64;
            let wave = (0.31 * u + 0.11 * v + s).sin()
                + (0.083 * u - 0.27 * v + 1.7 * s + c).sin()
                + (0.57 * u + 0.05 * v * (1.0 + c)).cos();
            (127.5 + 40.0 * wave).round() as u8
        }))
    })
}

fn file(root: &Path, path: String, bytes: &[u8]) -> FileRef {
    write_atomic(&root.join(&path), bytes).unwrap();
    let blake3 = blake3_file(&root.join(&path), Kind::Content).unwrap();
    FileRef { path, blake3 }
}

fn sample(root: &Path, role: Role, index: u32) -> Sample {
    let disparity_px = 4.0 + f64::from(index % 3);
    let stem = format!("images/{role}");
    let left = encode_png_rgb(&view(index, 0.0));
    let right = encode_png_rgb(&view(index, disparity_px));
    let depth_velodyne = (role == Role::Val).then(|| {
        let depth_m = FOCAL_PX * BASELINE_M / disparity_px;
        let plane = Plane::filled(WIDTH as usize, HEIGHT as usize, depth_m as f32);
        let path = format!("depth/velodyne/{index:010}.exr");
        let header = DepthHeader {
            source: "closed form".to_owned(),
            axis: "velodyne-x".to_owned(),
            focal_px: FOCAL_PX,
            baseline_m: BASELINE_M,
            frame: index.to_string(),
        };
        write_depth(&root.join(&path), &plane, &header).unwrap();
        let blake3 = blake3_file(&root.join(&path), Kind::Content).unwrap();
        FileRef { path, blake3 }
    });
    let at = |side: &str| format!("{stem}/{side}/{index:010}.png");
    Sample {
        right: Some(file(root, at("right"), &right)),
        depth_velodyne,
        ..Sample::new(
            format!("2011_09_26_drive_0001/{index:010}"),
            (WIDTH, HEIGHT),
            FOCAL_PX,
            BASELINE_M,
            file(root, at("left"), &left),
        )
    }
}

/// Writes a set of the KITTI split with so many training and validation pairs.
pub fn write(root: &Path, train: u32, val: u32) -> PreparedSet {
    let samples = |role, count| {
        (0..count)
            .map(|i| sample(root, role, i))
            .collect::<Vec<_>>()
    };
    let roles = BTreeMap::from([
        (Role::Train, samples(Role::Train, train)),
        (Role::Val, samples(Role::Val, val)),
        (Role::Test, Vec::new()),
    ]);
    let counts = roles
        .iter()
        .map(|(role, samples)| {
            let count = samples.len() as u64;
            (
                *role,
                Count {
                    expected: count,
                    found: count,
                },
            )
        })
        .collect();
    let manifest = Manifest {
        format: FORMAT,
        content: Content::Kitti,
        split_digest: Some(strat_splits::digest(Split::Kitti)),
        source: "rendered".to_owned(),
        image_width: WIDTH,
        image_height: HEIGHT,
        kernel: Kernel::Area,
        codec: "png".to_owned(),
        counts,
        failures: 0,
        cameras: Vec::new(),
        tool_version: "0".to_owned(),
        data_digest: String::new(),
    };
    PreparedSet::write(root, manifest, &roles).unwrap()
}
