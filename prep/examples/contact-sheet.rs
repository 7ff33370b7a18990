//! Draws a picture of the rendered world: street views of three drives and, of one stereo
//! scene and one scan, what is measured there.
//!
//! ```text
//! cargo run -p strat-prep --example contact-sheet -- tests/world.jpg
//! ```
//!
//! Nothing in it is recorded: pictures, disparities, labels and scans are those of
//! `prep synth` with seed 1 at KITTI's native size, halved.

use std::path::PathBuf;

use anyhow::{Context, Result};
use image::{Rgb, RgbImage};
use strat_geometry::{CamToCam, DepthAxis, VeloToCam, velodyne_depth, velodyne_projection};
use strat_prep::synth::{RenderedTruth, Renderer, View};
use strat_store::resize::{self, Kernel};
use strat_store::{files, image_files};

const PANEL: (u32, u32) = (620, 186);
const GAP: u32 = 4;
const QUALITY: u8 = 82;
/// Bright end of the depth colours; disparities are inverse depths on the same scale.
const NEAREST_M: f32 = 6.0;

fn main() -> Result<()> {
    let out = std::env::args_os()
        .nth(1)
        .context("say where to write the picture, for example tests/world.jpg")?;
    let renderer = Renderer::new(1, 1);
    let street = |frame: &str| -> Result<RgbImage> {
        Ok(renderer.render(View::Frame(frame.parse()?))?.left)
    };
    let scene = renderer.render(View::Stereo(11))?;
    let truth = scene
        .truth
        .context("a stereo scene comes with ground truth")?;
    let panels = [
        street("2011_09_26_drive_0013/0000000040")?,
        street("2011_09_26_drive_0035/0000000100")?,
        street("2011_09_30_drive_0028/0000001000")?,
        scanned(&renderer, "2011_09_26_drive_0101/0000000300")?,
        disparity(&scene.left, &truth, &CamToCam::parse(&scene.cam_to_cam)?),
        labelled(&scene.left, &truth.semantic),
    ];
    let (width, height) = PANEL;
    let rows = panels.len().div_ceil(2) as u32;
    let mut sheet = RgbImage::from_pixel(
        2 * width + GAP,
        rows * (height + GAP) - GAP,
        Rgb([255, 255, 255]),
    );
    for (at, panel) in (0_u32..).zip(&panels) {
        let small = resize::rgb(panel, width, height, Kernel::Area);
        let (left, top) = (at % 2 * (width + GAP), at / 2 * (height + GAP));
        image::imageops::replace(&mut sheet, &small, left.into(), top.into());
    }
    files::write_atomic(
        &PathBuf::from(out),
        &image_files::encode_jpeg_rgb(&sheet, QUALITY),
    )?;
    Ok(())
}

/// A picture with the points of its scan, coloured by depth.
fn scanned(renderer: &Renderer, frame: &str) -> Result<RgbImage> {
    let frame = renderer.render(View::Frame(frame.parse()?))?;
    let points = frame.scan.context("this frame has no scan")?;
    let cam = CamToCam::parse(&frame.cam_to_cam)?;
    let projection = velodyne_projection(&cam, &VeloToCam::parse(&frame.velo_to_cam)?);
    let (width, height) = frame.left.dimensions();
    let depth_m = velodyne_depth(
        &points,
        &projection,
        width as usize,
        height as usize,
        DepthAxis::CameraZ,
    );
    Ok(drawn_over(&frame.left, &depth_m))
}

/// The measured disparities of a scene, coloured by depth.
fn disparity(left: &RgbImage, truth: &RenderedTruth, cam: &CamToCam) -> RgbImage {
    let reach = (cam.focal_px() * cam.baseline_m()) as f32 * 256.0;
    let depth_m = truth.occ.iter().map(|&stored| match stored {
        0 => 0.0,
        stored => reach / f32::from(stored),
    });
    let dark = RgbImage::new(left.width(), left.height());
    drawn_over(&dark, &depth_m.collect::<Vec<_>>())
}

/// Depths as dots of three by three pixels, the nearest on top, over a dimmed picture.
fn drawn_over(picture: &RgbImage, depth_m: &[f32]) -> RgbImage {
    let mut drawn = picture.clone();
    for pixel in drawn.pixels_mut() {
        pixel.0 = pixel.0.map(|value| value / 2);
    }
    let (width, height) = (picture.width() as usize, picture.height() as usize);
    for row in 0..height {
        for column in 0..width {
            let rows = row.saturating_sub(1)..(row + 2).min(height);
            let nearest = rows
                .flat_map(|r| {
                    let columns = column.saturating_sub(1)..(column + 2).min(width);
                    columns.map(move |c| r * width + c)
                })
                .map(|at| depth_m[at])
                .filter(|depth| *depth > 0.0)
                .fold(f32::INFINITY, f32::min);
            if nearest.is_finite() {
                let colour =
                    colorous::TURBO.eval_continuous(f64::from((NEAREST_M / nearest).min(1.0)));
                drawn.put_pixel(
                    column as u32,
                    row as u32,
                    Rgb([colour.r, colour.g, colour.b]),
                );
            }
        }
    }
    drawn
}

/// Labels in colours of their own over the picture's brightness.
fn labelled(left: &RgbImage, labels: &[u8]) -> RgbImage {
    let mut drawn = left.clone();
    for (pixel, &label) in drawn.pixels_mut().zip(labels) {
        let [r, g, b] = pixel.0.map(u16::from);
        let grey = (r + g + b) / 3;
        pixel.0 = colour_of(label).map(|c| ((u16::from(c) * 3 + grey) / 4) as u8);
    }
    drawn
}

/// Colours of Cityscapes ids as its own tools draw them; what is not listed is black.
fn colour_of(label: u8) -> [u8; 3] {
    match label {
        7 => [128, 64, 128],
        8 => [244, 35, 232],
        9 => [250, 170, 160],
        11 => [70, 70, 70],
        12 => [102, 102, 156],
        13 => [190, 153, 153],
        14 => [180, 165, 180],
        17 | 18 => [153, 153, 153],
        19 => [250, 170, 30],
        20 => [220, 220, 0],
        21 => [107, 142, 35],
        22 => [152, 251, 152],
        23 => [70, 130, 180],
        24 => [220, 20, 60],
        25 => [255, 0, 0],
        26 => [0, 0, 142],
        27 => [0, 0, 70],
        28 => [0, 60, 100],
        32 => [0, 0, 230],
        33 => [119, 11, 32],
        _ => [0, 0, 0],
    }
}
