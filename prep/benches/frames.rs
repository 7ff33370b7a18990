//! What one frame costs: the picture's way to network size, its scan's way to ground truth, and
//! rendering it.
//!
//! ```text
//! cargo bench -p strat-prep --bench frames
//! ```
//!
//! All on one thread, on rendered frames of KITTI's native 1242 x 375.
#![allow(missing_docs, reason = "criterion's macros write public functions")]

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use image::RgbImage;
use strat_geometry::{CamToCam, DepthAxis, VeloToCam, velodyne_depth, velodyne_projection};
use strat_prep::synth::{Rendered, Renderer, View};
use strat_store::resize::{self, Kernel};
use strat_store::{image_files, raster::Plane};

fn view() -> View {
    let frame = "2011_09_26_drive_0001/0000000040";
    View::Frame(frame.parse().expect("a frame of KITTI"))
}

fn rendered() -> Rendered {
    Renderer::new(1, 1).render(view()).expect("it is rendered")
}

fn pictures(c: &mut Criterion) {
    let left = rendered().left;
    let native = image_files::encode_png_rgb(&left);
    let decode = || image_files::decode_rgb(&native, "in memory").expect("own file");
    let shrink = |image: &RgbImage| resize::rgb(image, 512, 256, Kernel::Area);
    let small = shrink(&left);
    let mut group = c.benchmark_group("picture 1242x375");
    group.bench_function("decode PNG", |b| b.iter(decode));
    group.bench_function("area to 512x256", |b| b.iter(|| shrink(black_box(&left))));
    group.bench_function("encode PNG 512x256", |b| {
        b.iter(|| image_files::encode_png_rgb(black_box(&small)))
    });
    group.bench_function("decode, area, encode", |b| {
        b.iter(|| image_files::encode_png_rgb(&shrink(&decode())))
    });
    group.finish();

    let coarse = Plane::filled(512, 256, 0.03);
    c.bench_function("disparity 512x256 to 1242x375", |b| {
        b.iter(|| resize::bilinear_f32(black_box(&coarse), 1242, 375))
    });
}

fn scans(c: &mut Criterion) {
    let frame = rendered();
    let cam = CamToCam::parse(&frame.cam_to_cam).expect("own calibration");
    let velo = VeloToCam::parse(&frame.velo_to_cam).expect("own calibration");
    let projection = velodyne_projection(&cam, &velo);
    let points = frame.scan.expect("this frame has a scan");
    let name = format!("depth of a scan of {} points", points.len());
    c.bench_function(&name, |b| {
        b.iter(|| {
            velodyne_depth(
                black_box(&points),
                &projection,
                1242,
                375,
                DepthAxis::VelodyneX,
            )
        })
    });
}

fn rendering(c: &mut Criterion) {
    let renderer = Renderer::new(1, 1);
    let mut group = c.benchmark_group("render 1242x375");
    group.sample_size(10);
    group.bench_function("stereo pair and scan", |b| {
        b.iter(|| renderer.render(view()).expect("it is rendered"))
    });
    group.bench_function("stereo scene with ground truth", |b| {
        b.iter(|| renderer.render(View::Stereo(11)).expect("it is rendered"))
    });
    group.finish();
}

criterion_group!(benches, pictures, scans, rendering);
criterion_main!(benches);
