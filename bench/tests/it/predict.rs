//! `bench predict` from outside: images in, maps out.

use std::{
    fs,
    path::{Path, PathBuf},
};

use image::{Rgb, RgbImage};
use strat_bench::{
    draw::legend,
    model::{self, Model},
    runtime::{Device, Runtime, RuntimeChoice},
};
use strat_store::{exr, image_files};

use crate::broken::{Fault, write_spoilt};
use crate::command::{Ran, bench};
use crate::fixtures::{
    HEIGHT, INPUT_HEIGHT, INPUT_WIDTH, WIDTH, metadata, network, onnxruntime, write_model,
};
use crate::npy;

/// A folder of images and a place for results.
struct World {
    folder: tempfile::TempDir,
}

impl World {
    /// `photos/a.png` and `photos/deep/b.jpg`, of different sizes.
    fn new() -> Self {
        let world = Self {
            folder: tempfile::tempdir().unwrap(),
        };
        let picture = |width, height| {
            RgbImage::from_fn(width, height, |x, y| Rgb([x as u8, (3 * y) as u8, 90]))
        };
        world.put(
            "photos/a.png",
            &image_files::encode_png_rgb(&picture(WIDTH, HEIGHT)),
        );
        world.put(
            "photos/deep/b.jpg",
            &image_files::encode_jpeg_rgb(&picture(WIDTH, HEIGHT / 2), 90),
        );
        world
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn put(&self, name: &str, bytes: &[u8]) {
        let path = self.path(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, bytes).unwrap();
    }

    fn text(&self, name: &str) -> String {
        self.path(name).to_str().unwrap().to_owned()
    }

    /// `bench predict photos --model MODEL --out out --runtime embedded` and more arguments.
    fn predict(&self, model: &str, more: &[&str]) -> Ran {
        let (photos, out) = (self.text("photos"), self.text("out"));
        let mut arguments = vec!["predict", &photos, "--model", model, "--out", &out];
        if !more.contains(&"--runtime") {
            arguments.extend(["--runtime", "embedded"]);
        }
        arguments.extend(more);
        bench(&arguments)
    }

    fn constant(&self) -> String {
        let path = write_model(self.folder.path(), "four", 0.04, 0.0, "kitti");
        path.to_str().unwrap().to_owned()
    }

    /// All files below the output folder, relative to it.
    fn written(&self) -> Vec<String> {
        fn walk(folder: &Path, root: &Path, found: &mut Vec<String>) {
            for entry in fs::read_dir(folder).into_iter().flatten() {
                let path = entry.unwrap().path();
                if path.is_dir() {
                    walk(&path, root, found);
                } else {
                    let name = path.strip_prefix(root).unwrap();
                    found.push(name.to_str().unwrap().replace('\\', "/"));
                }
            }
        }
        let (root, mut found) = (self.path("out"), Vec::new());
        walk(&root, &root, &mut found);
        found.sort();
        found
    }
}

const CAMERA: [&str; 4] = ["--focal-px", "72", "--baseline-m", "0.5"];

/// 4 % of 124 px are 4.96 px; 72 px * 0.5 m / 4.96 px = 7.258 m.
#[test]
fn depth_is_what_is_worked_out_by_hand() {
    let world = World::new();
    let mut more = vec!["--format", "exr,png16,color,npy,ply"];
    more.extend(CAMERA);
    let ran = world.predict(&world.constant(), &more);
    ran.code(0);
    assert!(
        ran.out.starts_with("2 images in ") && ran.out.lines().count() == 1,
        "{}",
        ran.out
    );
    assert_eq!(
        world.written(),
        [
            "a.color.png",
            "a.colormap.png",
            "a.depth.png",
            "a.exr",
            "a.npy",
            "a.ply",
            &format!("camera_info-{WIDTH}x{}.yaml", HEIGHT / 2),
            &format!("camera_info-{WIDTH}x{HEIGHT}.yaml"),
            "deep/b.color.png",
            "deep/b.colormap.png",
            "deep/b.depth.png",
            "deep/b.exr",
            "deep/b.npy",
            "deep/b.ply",
            "predict.yaml",
        ]
    );
    let depth_m = 72.0 * 0.5 / (0.04 * 124.0);
    let (plane, header) = exr::read_depth(&world.path("out/a.exr")).unwrap();
    assert_eq!(
        (plane.width, plane.height),
        (WIDTH as usize, HEIGHT as usize)
    );
    assert!(
        plane
            .data
            .iter()
            .all(|v| (f64::from(*v) - depth_m).abs() < 1e-5)
    );
    assert_eq!((header.focal_px, header.baseline_m), (72.0, 0.5));
    assert_eq!(header.frame, "a.png");
    assert!(
        header.source.starts_with("model four, BLAKE3 "),
        "{}",
        header.source
    );
    // Depth depends on the width alone.
    let (plane, _) = exr::read_depth(&world.path("out/deep/b.exr")).unwrap();
    assert!((f64::from(plane.data[0]) - depth_m).abs() < 1e-5);

    let (_, _, values) = image_files::read_gray16(&world.path("out/a.depth.png")).unwrap();
    assert!(
        values
            .iter()
            .all(|&v| v == (depth_m * 256.0).round() as u16)
    );
    let (shape, values) = npy::read(&world.path("out/a.npy"));
    assert_eq!(shape, [HEIGHT as usize, WIDTH as usize]);
    assert!((f64::from(values[3 * WIDTH as usize + 3]) - depth_m).abs() < 1e-5);
    let colour = image_files::read_rgb(&world.path("out/a.color.png")).unwrap();
    assert_eq!(
        colour.dimensions(),
        (WIDTH, HEIGHT + legend::legend_height(WIDTH))
    );
    let own_size = image_files::read_rgb(&world.path("out/a.colormap.png")).unwrap();
    assert_eq!(own_size.dimensions(), (WIDTH, HEIGHT));
    assert_eq!(own_size.get_pixel(3, 2), colour.get_pixel(3, 2));
    let cloud = fs::read(world.path("out/a.ply")).unwrap();
    let vertices = format!("element vertex {}\n", WIDTH * HEIGHT);
    assert!(String::from_utf8_lossy(&cloud).contains(&vertices));
    let record = fs::read_to_string(world.path("out/predict.yaml")).unwrap();
    for line in [
        "focal_px: 72",
        "png16: depth_m",
        "color: inverse_depth",
        "failed: 0",
    ] {
        assert!(record.contains(line), "no {line:?} in {record}");
    }
}

#[test]
fn without_a_camera_there_is_disparity_only() {
    let world = World::new();
    let model = world.constant();
    world
        .predict(&model, &["--format", "exr"])
        .code(2)
        .says("`--format exr`: depth-m cannot be derived")
        .says("--focal-px and --baseline-m");
    world
        .predict(&model, &["--format", "ply", "--baseline-m", "0.5"])
        .code(2)
        .says("--focal-px");
    assert_eq!(world.written(), Vec::<String>::new());
    world
        .predict(&model, &[])
        .code(0)
        .says("with both, --format exr, png16 and ply hold metres");
    assert_eq!(
        world.written()[..3],
        ["a.color.png", "a.colormap.png", "a.npy"]
    );
    world
        .predict(&model, &["--format", "npy,png16,color", "--force"])
        .code(0)
        .says("only disparity is written");
    let (_, values) = npy::read(&world.path("out/a.npy"));
    assert!((values[0] - 4.96).abs() < 1e-5);
    let (_, _, values) = image_files::read_gray16(&world.path("out/a.disparity.png")).unwrap();
    // 4.96 * 256 = 1269.76
    assert!(values.iter().all(|&value| value == 1270));
    for (more, sentence) in [
        (&["--baseline-m", "72"][..], "--focal-px"),
        (
            &["--format", "npy", "--focal-px", "0", "--baseline-m", "1"],
            "above 0",
        ),
        (
            &["--format", "npy", "--quantity", "depth-m"],
            "without the camera",
        ),
        (
            &["--format", "png16", "--quantity", "disparity-fraction"],
            "png16",
        ),
        (&["--format", "color", "--nearest-m", "3"], "--nearest-m"),
        (
            &["--format", "exr", "--quantity", "disparity-px"],
            "depth in metres only",
        ),
    ] {
        world.predict(&model, more).code(2).says(sentence);
    }
}

/// The maps are those that the accuracy path scores.
#[test]
fn maps_of_the_networks_size_are_the_networks_own() {
    let world = World::new();
    let model = write_model(world.folder.path(), "looks", 0.02, 0.05, "kitti");
    let more = [
        "--format",
        "npy",
        "--quantity",
        "disparity-fraction",
        "--network-size",
    ];
    world.predict(model.to_str().unwrap(), &more).code(0);
    let (runtime, _) = Runtime::resolve(RuntimeChoice::Embedded, Device::Cpu).unwrap();
    let mut model = Model::open("looks", &model, &runtime, Device::Cpu, 1).unwrap();
    for (image, map) in [
        ("photos/a.png", "out/a.npy"),
        ("photos/deep/b.jpg", "out/deep/b.npy"),
    ] {
        let image = image_files::read_rgb(&world.path(image)).unwrap();
        let input = model::prepare_input(&image, &model.description.input, None).unwrap();
        let expected = model.predict(&input).unwrap();
        let (shape, found) = npy::read(&world.path(map));
        assert_eq!(shape, [INPUT_HEIGHT as usize, INPUT_WIDTH as usize]);
        assert!(found == expected.data, "{map}");
    }
    // The header names the camera of the map, not of the image.
    let mut more = vec!["--network-size", "--force"];
    more.extend(CAMERA);
    world.predict(&world.constant(), &more).code(0);
    let (plane, header) = exr::read_depth(&world.path("out/a.exr")).unwrap();
    assert!((header.focal_px - 72.0 * 32.0 / 124.0).abs() < 1e-9);
    assert!((f64::from(plane.data[0]) - 36.0 / 4.96).abs() < 1e-5);
}

/// At twice the width 72 px are another camera: depth would be half of what it is.
#[test]
fn one_focal_length_is_not_that_of_images_of_several_widths() {
    let world = World::new();
    let wide = RgbImage::from_pixel(2 * WIDTH, HEIGHT, Rgb([90; 3]));
    world.put("photos/wide.png", &image_files::encode_png_rgb(&wide));
    let ran = world.predict(&world.constant(), &CAMERA);
    ran.code(2)
        .says("is 124 pixels wide")
        .says("wide.png 248")
        .says("--focal-px");
    assert!(world.written().is_empty());
    // Disparity needs no camera.
    let more = ["--format", "npy"];
    world.predict(&world.constant(), &more).code(0);
}

#[test]
fn a_bad_image_costs_itself_only() {
    let world = World::new();
    let whole = fs::read(world.path("photos/a.png")).unwrap();
    world.put("photos/cut.png", &whole[..whole.len() / 2]);
    world.put("photos/text.jpg", b"not an image");
    let ran = world.predict(&world.constant(), &["--format", "npy"]);
    ran.code(1)
        .says("cut.png is not a usable image: it is truncated")
        .says("text.jpg is not a usable image")
        .says("2 of 4 images have no result");
    assert_eq!(world.written(), ["a.npy", "deep/b.npy", "predict.yaml"]);
    let missing = world.text("nothing.png");
    world
        .predict(&world.constant(), &["--format", "npy", &missing])
        .code(1)
        .says("nothing.png");
}

/// 10 times 7.258 m in a unit of millimetres; and what is done is left alone.
#[test]
fn millimetres_and_images_that_are_done() {
    let world = World::new();
    world.put("photos/other.webp", b"");
    let mut more = vec![
        "--format",
        "png16",
        "--png-scale",
        "1000",
        "--skip-existing",
        "--json",
    ];
    more.extend(CAMERA);
    let ran = world.predict(&world.constant(), &more);
    ran.code(0)
        .says("1 picture skipped, because only PNG and JPEG are read: other.webp");
    assert!(
        ran.out.contains("\"images\": 2") && ran.out.contains("a.depth.png"),
        "{}",
        ran.out
    );
    let (_, _, values) = image_files::read_gray16(&world.path("out/a.depth.png")).unwrap();
    assert!(values.iter().all(|&value| value == 7258), "{}", values[0]);
    fs::remove_file(world.path("out/deep/b.depth.png")).unwrap();
    let changed = |name: &str| world.path(name).metadata().unwrap().modified().unwrap();
    let before = changed("out/a.depth.png");
    world
        .predict(&world.constant(), &more)
        .code(0)
        .says("1 of 2 images were done before and are left alone");
    assert_eq!(changed("out/a.depth.png"), before);
    assert!(world.path("out/deep/b.depth.png").is_file());
}

#[test]
fn names_that_collide_are_refused_before_anything_is_written() {
    let world = World::new();
    world.put("photos/a.jpg", b"whatever");
    world
        .predict(&world.constant(), &["--format", "npy"])
        .code(2)
        .says("would both be written to a.npy");
    let empty = world.text("empty");
    fs::create_dir(&empty).unwrap();
    fs::remove_file(world.path("photos/a.jpg")).unwrap();
    world
        .predict(&world.constant(), &["--format", "npy", &empty])
        .code(1)
        .says("no PNG or JPEG images in");
    let photos = world.text("photos");
    let inside = world.text("photos/out");
    let model = world.constant();
    bench(&["predict", &photos, "--model", &model, "--out", &inside])
        .code(2)
        .says("is inside the input folder");
    assert_eq!(world.written(), Vec::<String>::new());
}

/// A foreign model says in a file beside it what it gives.
#[test]
fn foreign_models_are_taken_at_their_word() {
    let world = World::new();
    let model = world.text("foreign.onnx");
    fs::write(&model, network(5.0, 0.0, None)).unwrap();
    let describe = |meaning: &str| {
        world.put(
            "foreign.yaml",
            format!(
                "input: {{width: {INPUT_WIDTH}, height: {INPUT_HEIGHT}, range: 0..1}}\n\
                 output: {{meaning: {meaning}}}\n"
            )
            .as_bytes(),
        );
    };
    world
        .predict(&model, &[])
        .code(1)
        .says("does not say what its tensors mean");
    describe("depth_m");
    world
        .predict(&model, &["--format", "exr,color", "--nearest-m", "5"])
        .code(0);
    let (plane, header) = exr::read_depth(&world.path("out/a.exr")).unwrap();
    assert!(plane.data.iter().all(|value| (value - 5.0).abs() < 1e-5));
    assert_eq!(header.focal_px, 0.0, "not known");
    // 5 m at a nearest depth of 5 m is the brightest colour, as at the scale's right end.
    let colour = image_files::read_rgb(&world.path("out/a.color.png")).unwrap();
    assert_eq!(colour.get_pixel(0, 0), colour.get_pixel(WIDTH - 1, HEIGHT));
    describe("inverse_depth");
    let mut more = vec!["--format", "exr"];
    more.extend(CAMERA);
    world.predict(&model, &more).code(2).says("no known scale");
    world
        .predict(&model, &["--format", "color,npy"])
        .code(2)
        .says("`description`");
    world
        .predict(&model, &["--format", "color,npy", "--force"])
        .code(0);
    let (_, values) = npy::read(&world.path("out/a.npy"));
    assert_eq!(values[0], 5.0);
}

#[test]
fn a_model_that_fails_on_its_way_is_a_sentence() {
    let mut runtimes = vec!["embedded"];
    runtimes.extend(onnxruntime().map(|_| "ort"));
    for runtime in runtimes {
        let world = World::new();
        // 7 x 7 pixels cannot be made of 32 x 16.
        let fault = Fault::Reshape([1, 2, 7, 7]);
        let model = write_spoilt(world.folder.path(), "spoilt", &metadata("kitti"), fault);
        let ran = world.predict(&model, &["--format", "npy", "--runtime", runtime]);
        eprintln!("{runtime}: {}", ran.err);
        ran.code(1)
            .says("a.png: ")
            .says("2 of 2 images have no result");
        assert!(!ran.err.contains(".cc:"), "{}", ran.err);
        assert_eq!(world.written(), ["predict.yaml"]);

        world.put("cut.onnx", &fs::read(&model).unwrap()[..200]);
        let ran = world.predict(&world.text("cut.onnx"), &["--runtime", runtime]);
        ran.code(1).says("cut.onnx");
    }
}
