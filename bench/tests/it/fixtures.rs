//! A tiny prepared set and small networks for the command-line tests.
//!
//! The numbers are chosen so that results can be worked out by hand: every image is one colour,
//! ground truth is one disparity or depth, and the constant networks predict one disparity.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use image::{Rgb, RgbImage};
use strat_bench::runtime::install::{Availability, ensure_runtime};
use strat_needs::Need;
use strat_onnx::{
    embedded::EmbeddedSession,
    graph::{Filter, Geometry, GraphBuilder},
    metadata::{
        DiscriminatorMetadata, InputRange, ModelMetadata, OutputMeaning, Probe, probe_image,
    },
};
use strat_splits::{Role, Split};
use strat_store::{
    exr::{self, DepthHeader},
    files, image_files,
    raster::Plane,
    resize::Kernel,
    set::{Count, FORMAT, FileRef, Manifest, PreparedSet, Sample},
};

/// Size of the untouched images.
pub const WIDTH: u32 = 124;
pub const HEIGHT: u32 = 40;
/// Size of the networks' input.
pub const INPUT_WIDTH: u32 = 32;
pub const INPUT_HEIGHT: u32 = 16;
pub const FOCAL_PX: f64 = 72.0;
pub const BASELINE_M: f64 = 0.5;
/// True disparity of the stereo images: 5 % of the width, 6.2 px; representable to 1/256 px.
pub const DISPARITY_PX: f64 = 1587.0 / 256.0;
/// True depth of the scans.
pub const SCAN_DEPTH_M: f32 = 10.0;

fn put(root: &Path, path: &str, bytes: &[u8]) -> FileRef {
    files::write_atomic(&root.join(path), bytes).unwrap();
    FileRef {
        path: path.to_owned(),
        blake3: files::blake3_hex(bytes),
    }
}

fn picture(root: &Path, path: &str, width: u32, height: u32, grey: u8) -> FileRef {
    // A gradient, so that resizing and channel order matter to networks that look at it.
    let image = RgbImage::from_fn(width, height, |x, y| {
        Rgb([grey, (x * 200 / width) as u8, (y * 200 / height) as u8])
    });
    put(root, path, &image_files::encode_png_rgb(&image))
}

fn depth(root: &Path, path: &str, frame: &str, baseline_m: f64, depth_m: f32) -> FileRef {
    let mut plane = Plane::filled(WIDTH as usize, HEIGHT as usize, depth_m);
    // Nothing is measured in the upper quarter.
    plane.data[..(WIDTH * HEIGHT / 4) as usize].fill(0.0);
    let header = DepthHeader {
        source: "test".to_owned(),
        axis: "z".to_owned(),
        focal_px: FOCAL_PX,
        baseline_m,
        frame: frame.to_owned(),
    };
    put(root, path, &exr::encode_depth(&plane, &header).unwrap())
}

fn labels(root: &Path, path: &str) -> FileRef {
    // Left half road (flat), right half car (vehicle).
    let values: Vec<u8> = (0..WIDTH * HEIGHT)
        .map(|index| if index % WIDTH < WIDTH / 2 { 7 } else { 26 })
        .collect();
    put(
        root,
        path,
        &image_files::encode_png_gray8(WIDTH, HEIGHT, &values),
    )
}

/// Writes a set with `tests` test images of the given split.
pub fn write_set(root: &Path, split: Split, tests: u32, with_labels: bool) -> PreparedSet {
    let mut samples = BTreeMap::new();
    let list: Vec<Sample> = (0..tests)
        .map(|index| {
            let (id, stem) = match split {
                Split::Kitti => (format!("kitti2015/{index:06}"), format!("{index:06}")),
                Split::Eigen => (
                    format!("2011_09_26_drive_0002/{index:010}"),
                    format!("{index:010}"),
                ),
            };
            let grey = (40 * index) as u8;
            let stereo_m = (FOCAL_PX * 0.54 / DISPARITY_PX) as f32;
            let kitti = split == Split::Kitti;
            let at = |kind: &str| format!("{kind}/{stem}.exr");
            let left = picture(
                root,
                &format!("l/{stem}.png"),
                INPUT_WIDTH,
                INPUT_HEIGHT,
                grey,
            );
            Sample {
                right: Some(picture(
                    root,
                    &format!("r/{stem}.png"),
                    INPUT_WIDTH,
                    INPUT_HEIGHT,
                    grey,
                )),
                left_full: Some(picture(root, &format!("f/{stem}.png"), WIDTH, HEIGHT, grey)),
                depth_noc: kitti.then(|| depth(root, &at("noc"), &id, 0.54, stereo_m)),
                depth_occ: kitti.then(|| depth(root, &at("occ"), &id, 0.54, stereo_m)),
                depth_velodyne: (!kitti)
                    .then(|| depth(root, &at("velo"), &id, BASELINE_M, SCAN_DEPTH_M)),
                depth_camera: (!kitti)
                    .then(|| depth(root, &at("cam"), &id, BASELINE_M, SCAN_DEPTH_M - 0.25)),
                semantic: with_labels.then(|| labels(root, &format!("s/{stem}.png"))),
                ..Sample::new(id, (WIDTH, HEIGHT), FOCAL_PX, BASELINE_M, left)
            }
        })
        .collect();
    samples.insert(Role::Test, list);
    let train: Vec<Sample> = (0..3_u32)
        .map(|index| {
            let id = format!("2011_09_26_drive_0001/{index:010}");
            let left = picture(
                root,
                &format!("tl/{index}.png"),
                INPUT_WIDTH,
                INPUT_HEIGHT,
                9,
            );
            Sample {
                right: Some(picture(
                    root,
                    &format!("tr/{index}.png"),
                    INPUT_WIDTH,
                    INPUT_HEIGHT,
                    9,
                )),
                // 8 m, 10 m, 12 m: the median is the true depth of the test scans.
                depth_velodyne: (split == Split::Eigen).then(|| {
                    let depth_m = 8.0 + 2.0 * index as f32;
                    depth(root, &format!("td/{index}.exr"), &id, BASELINE_M, depth_m)
                }),
                ..Sample::new(id, (WIDTH, HEIGHT), FOCAL_PX, BASELINE_M, left)
            }
        })
        .collect();
    samples.insert(Role::Train, train);
    let expected = match split {
        Split::Kitti => 200,
        Split::Eigen => 697,
    };
    let manifest = Manifest {
        format: FORMAT,
        content: split.into(),
        split_digest: Some("test".to_owned()),
        source: "rendered".to_owned(),
        image_width: INPUT_WIDTH,
        image_height: INPUT_HEIGHT,
        kernel: Kernel::Area,
        codec: "png".to_owned(),
        counts: BTreeMap::from([(
            Role::Test,
            Count {
                expected,
                found: u64::from(tests),
            },
        )]),
        failures: 0,
        cameras: Vec::new(),
        tool_version: "test".to_owned(),
        data_digest: String::new(),
    };
    PreparedSet::write(root, manifest, &samples).unwrap()
}

/// Metadata as `train` writes it.
pub fn metadata(split: &str) -> ModelMetadata {
    let mut metadata = ModelMetadata::new(
        OutputMeaning::DisparityFraction,
        InputRange::Unit,
        INPUT_WIDTH,
        INPUT_HEIGHT,
    );
    metadata.kernel = Some("area".to_owned());
    metadata.split = Some(split.to_owned());
    metadata.variant = Some("strat".to_owned());
    metadata
}

/// The bytes of a network that adds `factor` times a 3x3 blur of the image to a constant, with
/// the constant and the factor of the right map halved. The blur leans to the left, so that a
/// mirrored image does not give the mirrored result.
pub fn network(constant: f32, factor: f32, metadata: Option<&ModelMetadata>) -> Vec<u8> {
    let mut graph = GraphBuilder::new("test");
    let image = graph
        .input(
            "image",
            &[
                "N".into(),
                3.into(),
                (INPUT_HEIGHT as usize).into(),
                (INPUT_WIDTH as usize).into(),
            ],
        )
        .unwrap();
    let blur = |strength: f32| (0..27).map(move |tap| strength * [2.0, 1.0, 0.0][tap % 3] / 27.0);
    let weights: Vec<f32> = blur(factor).chain(blur(factor / 2.0)).collect();
    let filter = Filter {
        shape: [2, 3, 3, 3],
        weights,
        bias: vec![constant, constant / 2.0],
    };
    let disparity = graph
        .conv("conv", image, filter, Geometry::new(1, 1))
        .unwrap();
    graph.output("disparity", disparity).unwrap();
    graph.finish(metadata).unwrap()
}

/// Writes a network with metadata and a probe recorded by the embedded runtime.
pub fn write_model(folder: &Path, name: &str, constant: f32, factor: f32, split: &str) -> PathBuf {
    let mut metadata = metadata(split);
    let plain = network(constant, factor, Some(&metadata));
    let session = EmbeddedSession::from_bytes(plain, name, None).unwrap();
    let (height, width) = (INPUT_HEIGHT as usize, INPUT_WIDTH as usize);
    let input = probe_image(INPUT_WIDTH, INPUT_HEIGHT);
    let outputs = session
        .run("image", &[1, 3, height, width], &input)
        .unwrap();
    metadata.probe = Some(Probe::record(INPUT_WIDTH, INPUT_HEIGHT, &outputs[0].2).unwrap());
    let path = folder.join(format!("{name}.onnx"));
    std::fs::write(&path, network(constant, factor, Some(&metadata))).unwrap();
    path
}

/// The library of ONNX Runtime, installed where it was missing.
pub fn onnxruntime() -> Option<PathBuf> {
    match ensure_runtime() {
        Availability::Ready(library) => Some(library),
        Availability::Unavailable(reason) => {
            Need::OnnxRuntime.is_lacking(reason);
            None
        }
    }
}

/// The file of a discriminator for patches of 16 px of the set's images: every pixel has minus its green as its
/// logit, so the darkest window is the cheapest.
pub fn write_discriminator(path: &Path) {
    let mut graph = GraphBuilder::new("green");
    let dims = ["N".into(), 3.into(), 16.into(), 16.into()];
    let patches = graph.input("patches", &dims).unwrap();
    let filter = Filter {
        shape: [1, 3, 1, 1],
        weights: vec![0.0, -1.0, 0.0],
        bias: vec![0.0],
    };
    let logits = graph.conv("green", patches, filter, Geometry::new(1, 0));
    graph.output("logits", logits.unwrap()).unwrap();
    let metadata = DiscriminatorMetadata {
        patch: 16,
        image_width: INPUT_WIDTH,
        image_height: INPUT_HEIGHT,
        kernel: Kernel::Area.to_string(),
        train_data_digest: "00".to_owned(),
        variant: "strat".to_owned(),
        seed: 1,
        epoch: 1,
        tool_version: "0.0.0".to_owned(),
        parity: 0.0,
        expected: probe_image(16, 16)[256..512]
            .iter()
            .map(|green| -green)
            .collect(),
    };
    let bytes = graph.finish_with(metadata.to_props(), None).unwrap();
    files::write_atomic(path, &bytes).unwrap();
}
