//! What one frame costs: the picture's way to network size, its scan's way to ground truth, and
//! rendering it: `cargo bench -p strat-prep --bench frames`.
//!
//! All on one thread, on rendered frames of KITTI's native 1242 x 375: the median and the range of the
//! repetitions of two seconds.
#![allow(clippy::print_stdout, reason = "a measurement is printed")]

use std::hint::black_box;
use std::time::{Duration, Instant};

use image::RgbImage;
use strat_geometry::{CamToCam, DepthAxis, VeloToCam, velodyne_depth, velodyne_projection};
use strat_prep::synth::{Rendered, Renderer, View};
use strat_store::resize::{self, Kernel};
use strat_store::{image_files, raster::Plane};

/// Repeats `work` for two seconds, and five times at least; the first time does not count.
fn measure<T>(name: &str, work: impl Fn() -> T) {
    black_box(work());
    let start = Instant::now();
    let mut times = Vec::new();
    while times.len() < 5 || start.elapsed() < Duration::from_secs(2) {
        let start = Instant::now();
        black_box(work());
        times.push(start.elapsed());
    }
    times.sort_unstable();
    println!(
        "{name}: {:.3?} ({:.3?} to {:.3?}, {} times)",
        times[times.len() / 2],
        times[0],
        times[times.len() - 1],
        times.len()
    );
}

fn view() -> View {
    let frame = "2011_09_26_drive_0001/0000000040";
    View::Frame(frame.parse().expect("a frame of KITTI"))
}

fn rendered() -> Rendered {
    Renderer::new(1, 1).render(view()).expect("it is rendered")
}

fn pictures() {
    let left = rendered().left;
    let native = image_files::encode_png_rgb(&left);
    let decode = || image_files::decode_rgb(&native, "in memory").expect("own file");
    let shrink = |image: &RgbImage| resize::rgb(image, 512, 256, Kernel::Area);
    let small = shrink(&left);
    measure("picture, decode PNG", decode);
    measure("picture, area to 512x256", || shrink(black_box(&left)));
    measure("picture, encode PNG 512x256", || {
        image_files::encode_png_rgb(black_box(&small))
    });
    measure("picture, decode, area, encode", || {
        image_files::encode_png_rgb(&shrink(&decode()))
    });
    let coarse = Plane::filled(512, 256, 0.03);
    measure("disparity 512x256 to 1242x375", || {
        resize::bilinear_f32(black_box(&coarse), 1242, 375)
    });
}

fn scans() {
    let frame = rendered();
    let cam = CamToCam::parse(&frame.cam_to_cam).expect("own calibration");
    let velo = VeloToCam::parse(&frame.velo_to_cam).expect("own calibration");
    let projection = velodyne_projection(&cam, &velo);
    let points = frame.scan.expect("this frame has a scan");
    measure(
        &format!("depth of a scan of {} points", points.len()),
        || {
            velodyne_depth(
                black_box(&points),
                &projection,
                1242,
                375,
                DepthAxis::VelodyneX,
            )
        },
    );
}

fn rendering() {
    let renderer = Renderer::new(1, 1);
    measure("render a stereo pair and its scan", || {
        renderer.render(view()).expect("it is rendered")
    });
    measure("render a stereo scene with ground truth", || {
        renderer.render(View::Stereo(11)).expect("it is rendered")
    });
}

fn main() {
    pictures();
    scans();
    rendering();
}
