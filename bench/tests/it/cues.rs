//! `bench cues` from outside: models with a known answer, sprites of every kind, bad input.

#[allow(dead_code, reason = "the program that draws the sprites uses the rest")]
#[path = "../../sprites/draw.rs"]
mod draw;

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::{Path, PathBuf},
};

use image::{Rgb, RgbImage, Rgba, RgbaImage};
use prost::Message as _;
use strat_bench::cues::rows::{self, Condition, CueRow, Experiment};
use strat_onnx::{
    graph::{Filter, Geometry, GraphBuilder},
    proto::{ModelProto, NodeProto, TensorProto, data_type},
};
use strat_splits::{Role, Split};
use strat_store::{
    exr::{self, DepthHeader},
    files, image_files,
    raster::Plane,
    resize::Kernel,
    set::{Count, FORMAT, FileRef, Manifest, PreparedSet, Sample},
};

use crate::command::{Ran, bench};

/// A third of KITTI's size.
const WIDTH: u32 = 414;
const HEIGHT: u32 = 125;
const FOCAL_PX: f64 = 240.5;
/// The horizon of KITTI's camera, scaled.
const HORIZON: f64 = 172.854 / 3.0;
/// The models' input: the image's own size, so that no resizing blurs the answer.
const INPUT: (usize, usize) = (WIDTH as usize, HEIGHT as usize);

/// A folder with a set, sprites, models and results.
struct World {
    folder: tempfile::TempDir,
}

impl World {
    /// `set/` with `count` grey backgrounds (red equals green, so that only sprites are magenta),
    /// and `sprites/` of flat magenta.
    fn new(count: u32) -> Self {
        let world = Self {
            folder: tempfile::tempdir().unwrap(),
        };
        let root = world.path("set");
        let samples: Vec<Sample> = (0..count)
            .map(|index| {
                let image = RgbImage::from_fn(WIDTH, HEIGHT, |x, y| {
                    let grey = ((x * (index + 2) / 3 + y * 5) % 160) as u8 + 40;
                    Rgb([grey, grey, (grey / 2).wrapping_add((y % 60) as u8)])
                });
                let bytes = image_files::encode_png_rgb(&image);
                let path = format!("full/{index:06}.png");
                files::write_atomic(&root.join(&path), &bytes).unwrap();
                let file = FileRef {
                    path,
                    blake3: files::blake3_hex(&bytes),
                };
                Sample {
                    left_full: Some(file.clone()),
                    ..Sample::new(
                        format!("kitti2015/{index:06}"),
                        (WIDTH, HEIGHT),
                        FOCAL_PX,
                        0.54,
                        file,
                    )
                }
            })
            .collect();
        let manifest = Manifest {
            format: FORMAT,
            content: Split::Kitti.into(),
            split_digest: None,
            source: "rendered".to_owned(),
            image_width: WIDTH,
            image_height: HEIGHT,
            kernel: Kernel::Area,
            codec: "png".to_owned(),
            counts: BTreeMap::from([(
                Role::Test,
                Count {
                    expected: 200,
                    found: u64::from(count),
                },
            )]),
            failures: 0,
            cameras: Vec::new(),
            tool_version: "test".to_owned(),
            data_digest: String::new(),
        };
        PreparedSet::write(&root, manifest, &BTreeMap::from([(Role::Test, samples)])).unwrap();
        world.flat_sprites(30);
        world
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn text(&self, name: &str) -> String {
        self.path(name).to_str().unwrap().to_owned()
    }

    /// `sprites/`: a car and a crate of `width` x 40 opaque magenta pixels within a margin.
    fn flat_sprites(&self, width: u32) {
        let image = RgbaImage::from_fn(width + 10, 50, |x, y| {
            let inside = (5..width + 5).contains(&x) && (5..45).contains(&y);
            // Dark, so that there is room for a contrast.
            Rgba([120, 0, 60, if inside { 255 } else { 0 }])
        });
        fs::create_dir_all(self.path("sprites")).unwrap();
        image.save(self.path("sprites/flat.png")).unwrap();
        let entry = |name: &str, familiar: bool| {
            format!("  - {{file: flat.png, name: {name}, familiar: {familiar}, height_m: 1.5}}\n")
        };
        let text = format!("sprites:\n{}{}", entry("car", true), entry("crate", false));
        fs::write(self.path("sprites/sprites.yaml"), text).unwrap();
    }

    /// Writes a model with its description.
    fn model(&self, name: &str, meaning: &str, bytes: Vec<u8>) {
        fs::write(self.path(&format!("{name}.onnx")), bytes).unwrap();
        let (width, height) = INPUT;
        let text = format!(
            "input: {{width: {width}, height: {height}, range: 0..1}}\noutput: {{meaning: {meaning}}}\n"
        );
        fs::write(self.path(&format!("{name}.yaml")), text).unwrap();
    }

    /// `bench cues ... --runtime embedded` with these models and more arguments.
    fn cues(&self, models: &[&str], more: &[&str]) -> Ran {
        let (set, out) = (self.text("set"), self.text("out"));
        let mut arguments = vec![
            "cues",
            "--data",
            &set,
            "--out",
            &out,
            "--runtime",
            "embedded",
        ];
        let files: Vec<String> = models
            .iter()
            .map(|name| self.text(&format!("{name}.onnx")))
            .collect();
        for file in &files {
            arguments.extend(["--model", file]);
        }
        let sprites = self.text("sprites");
        if !more.contains(&"--sprites") {
            arguments.extend(["--sprites", &sprites]);
        }
        arguments.extend(more);
        bench(&arguments)
    }

    fn rows(&self) -> Vec<CueRow> {
        rows::read(&self.path("out")).unwrap()
    }

    /// The words of every cue, by model and cue: one where all objects and sizes have the same.
    fn words(&self) -> BTreeMap<(String, String), BTreeSet<String>> {
        let mut reader =
            strat_csv::Reader::new(fs::File::open(self.path("out/summary.csv")).unwrap());
        let mut words: BTreeMap<_, BTreeSet<String>> = BTreeMap::new();
        for record in reader.records() {
            let record = record.unwrap();
            let key = (record[0].to_owned(), record[1].to_owned());
            words.entry(key).or_default().insert(record[2].to_owned());
        }
        words
    }
}

/// How a network with a known answer makes its map from the picture's magenta.
enum Known<'a> {
    /// The same everywhere.
    Constant(f32),
    /// A map that no picture changes.
    Map(&'a [f32]),
    /// The square root of the mean magenta, times a factor, everywhere.
    RootOfMean(f32),
    /// The magenta itself, added to a constant, times a factor.
    Local(f32, f32),
}

fn node(op: &str, inputs: &[&str], output: &str) -> NodeProto {
    NodeProto {
        input: inputs.iter().map(ToString::to_string).collect(),
        output: vec![output.to_owned()],
        name: Some(format!("{output}_{op}")),
        op_type: Some(op.to_owned()),
        ..NodeProto::default()
    }
}

/// A network whose answer is known, written with strat-onnx. The graph holds red minus green,
/// which is 0 on every background, and what is made of it.
fn known(answer: &Known<'_>) -> Vec<u8> {
    let (width, height) = INPUT;
    let mut graph = GraphBuilder::new("known answer");
    let image = graph
        .input("image", &[1.into(), 3.into(), height.into(), width.into()])
        .unwrap();
    let (gain, bias) = match answer {
        Known::Constant(value) => (0.0, *value),
        Known::Map(_) => (0.0, 0.0),
        Known::RootOfMean(_) => (1.0, 0.0),
        Known::Local(value, gain) => (*gain, *value),
    };
    let filter = Filter {
        shape: [1, 3, 1, 1],
        weights: vec![gain, -gain, 0.0],
        bias: vec![bias],
    };
    let magenta = graph
        .conv("conv", image, filter, Geometry::new(1, 0))
        .unwrap();
    graph.output("depth", magenta).unwrap();
    let mut model = ModelProto::decode(graph.finish(None).unwrap().as_slice()).unwrap();
    let graph = model.graph.as_mut().unwrap();
    if let Known::Map(_) | Known::RootOfMean(_) = answer {
        for output in graph.node.iter_mut().flat_map(|node| &mut node.output) {
            "magenta".clone_into(output);
        }
    }
    let mut constant = |name: &str, dims: Vec<i64>, values: Vec<f32>| {
        graph.initializer.push(TensorProto {
            dims,
            data_type: Some(data_type::FLOAT),
            float_data: values,
            name: Some(name.to_owned()),
            ..TensorProto::default()
        });
    };
    match answer {
        Known::Map(map) => {
            constant("map", vec![1, 1, height as i64, width as i64], map.to_vec());
            graph.node.push(node("Add", &["magenta", "map"], "depth"));
        }
        Known::RootOfMean(factor) => {
            constant("factor", vec![], vec![*factor]);
            // Zeros of the map's size, to spread the answer over it.
            constant("none", vec![], vec![0.0]);
            constant("floor", vec![], vec![1e-12]);
            let nodes = [
                node("GlobalAveragePool", &["magenta"], "mean"),
                node("Max", &["mean", "floor"], "positive"),
                node("Sqrt", &["positive"], "root"),
                node("Mul", &["root", "factor"], "answer"),
                node("Mul", &["magenta", "none"], "zeros"),
                node("Add", &["zeros", "answer"], "depth"),
            ];
            graph.node.extend(nodes);
        }
        Known::Constant(_) | Known::Local(..) => {}
    }
    model.encode_to_vec()
}

/// Disparity of the ground seen from 1.65 m as a fraction of image width, at least a little: B (v -
/// horizon) / (1.65 W) with the protocol's B of 0.54 m.
fn ground() -> Vec<f32> {
    let (width, height) = INPUT;
    (0..height)
        .flat_map(|row| {
            let below = (row as f64 - HORIZON).max(0.5);
            let disparity = 0.54 * below / (1.65 * f64::from(WIDTH));
            std::iter::repeat_n(disparity as f32, width)
        })
        .collect()
}

const HEIGHT_CUE: &str = "height in the visual field";
const SIZE_CUE: &str = "relative size of familiar objects";
const CONTRAST_CUE: &str = "luminance contrast of familiar objects";

/// A car and a pedestrian that stand where their ground truth puts them, and a car whose depth would
/// make it a toy: the first two are cut, whole, with their real height.
#[test]
fn sprites_are_cut_from_labelled_images() {
    let world = World::new(5);
    // left, top, width, height, instance id, depth in metres.
    let objects = [
        (40, 40, 60, 52, 26 * 256 + 1, 7.0_f32),
        (160, 40, 24, 56, 24 * 256 + 2, 7.3),
        (260, 40, 60, 52, 26 * 256 + 3, 1.0),
    ];
    let mut instances = vec![0_u16; (WIDTH * HEIGHT) as usize];
    let mut depth = Plane::filled(WIDTH as usize, HEIGHT as usize, 0.0);
    for (left, top, width, height, id, depth_m) in objects {
        for y in top..top + height {
            for x in left..left + width {
                let place = (y * WIDTH + x) as usize;
                (instances[place], depth.data[place]) = (id, depth_m);
            }
        }
    }
    let root = world.path("set");
    let set = PreparedSet::open(&root).unwrap();
    let put = |path: &str, bytes: &[u8]| {
        files::write_atomic(&root.join(path), bytes).unwrap();
        Some(FileRef {
            path: path.to_owned(),
            blake3: files::blake3_hex(bytes),
        })
    };
    let header = DepthHeader {
        source: "test".to_owned(),
        axis: "z".to_owned(),
        focal_px: FOCAL_PX,
        baseline_m: 0.54,
        frame: "0".to_owned(),
    };
    let mut samples = set.samples(Role::Test).unwrap();
    samples[2].instance = put(
        "i.png",
        &image_files::encode_png_gray16(WIDTH, HEIGHT, &instances),
    );
    samples[2].depth_noc = put("d.exr", &exr::encode_depth(&depth, &header).unwrap());
    let samples = BTreeMap::from([(Role::Test, samples)]);
    PreparedSet::write(&root, set.manifest, &samples).unwrap();

    let (data, out) = (world.text("set"), world.text("cut"));
    bench(&["sprites", "--data", &data, "--out", &out, "--each", "2"]).code(0);
    let text = fs::read_to_string(world.path("cut/sprites.yaml")).unwrap();
    let cut: serde_yaml::Value = serde_yaml::from_str(&text).unwrap();
    let found: Vec<(&str, f64)> = cut["sprites"]
        .as_sequence()
        .unwrap()
        .iter()
        .map(|entry| {
            let height = entry["height_m"].as_f64().unwrap();
            (entry["name"].as_str().unwrap(), height)
        })
        .collect();
    // height_px * depth / f.
    let round = |value: f64| (1000.0 * value).round() / 1000.0;
    assert_eq!(found[0], ("car", round(52.0 * 7.0 / FOCAL_PX)));
    let pedestrian = round(56.0 * f64::from(7.3_f32) / FOCAL_PX);
    assert_eq!(found[1], ("pedestrian", pedestrian));
    assert_eq!((found.len(), found[2].0), (3, "crate"));
    let file = cut["sprites"][0]["file"].as_str().unwrap();
    let sprite = image::open(world.path("cut").join(file))
        .unwrap()
        .to_rgba8();
    assert_eq!(sprite.dimensions(), (68, 60), "with a margin of 4");
    assert_eq!(
        (sprite.get_pixel(0, 0).0[3], sprite.get_pixel(30, 30).0[3]),
        (0, 255)
    );
    let original = image_files::read_rgb(&root.join("full/000002.png")).unwrap();
    let pixel = sprite.get_pixel(30, 30).0;
    assert_eq!(pixel[..3], original.get_pixel(40 + 26, 40 + 26).0);
    // They serve as sprites.
    world.model("constant", "depth_m", known(&Known::Constant(8.0)));
    let model = world.text("constant.onnx");
    bench(&[
        "cues",
        "height",
        "--data",
        &data,
        "--sprites",
        &out,
        "--model",
        &model,
        "--out",
        &world.text("cues"),
        "--backgrounds",
        "5",
        "--runtime",
        "embedded",
        "--quiet",
    ])
    .code(0);
}

#[test]
fn cues_are_found_where_they_are_and_nowhere_else() {
    let world = World::new(6);
    world.model("row", "disparity_fraction", known(&Known::Map(&ground())));
    world.model("size", "disparity_fraction", known(&Known::RootOfMean(0.2)));
    world.model(
        "constant",
        "disparity_fraction",
        known(&Known::Constant(0.03)),
    );
    let ran = world.cues(&["row", "size", "constant"], &["--scales", "12"]);
    ran.code(0);
    let words = world.words();
    let word = |model: &str, cue: &str| -> Vec<String> {
        words[&(model.to_owned(), cue.to_owned())]
            .iter()
            .cloned()
            .collect()
    };
    for (model, cue, expected) in [
        ("row", HEIGHT_CUE, "yes"),
        ("row", SIZE_CUE, "no"),
        ("size", HEIGHT_CUE, "no"),
        ("size", SIZE_CUE, "yes"),
        ("constant", HEIGHT_CUE, "no"),
        ("constant", SIZE_CUE, "no"),
        ("row", CONTRAST_CUE, "no (cite the numbers)"),
        ("constant", CONTRAST_CUE, "no (cite the numbers)"),
        ("constant", "occlusion of familiar objects", "no"),
        ("constant", "size relative to a second object", "no"),
    ] {
        assert_eq!(word(model, cue), [expected], "{model}, {cue}\n{}", ran.out);
    }
    // The answers themselves, beyond the words.
    let rows = world.rows();
    let of = |model: &str, experiment, condition| -> Vec<&CueRow> {
        rows.iter()
            .filter(|row| {
                row.model == model && row.experiment == experiment && row.condition == condition
            })
            .collect()
    };
    for row in of("row", Experiment::Height, Condition::SizeFixed) {
        // The median row of the block is half its height above the contact.
        let below = row.contact_row - 0.5 * row.height_px + 0.5 - HORIZON;
        let expected = (FOCAL_PX * 1.65 / below.max(0.5)).min(80.0);
        assert!(
            (row.depth / expected - 1.0).abs() < 0.15,
            "{} {expected}",
            row.depth
        );
    }
    let sized = of("size", Experiment::Size, Condition::Single);
    let first = sized.iter().find(|row| row.step == 1).unwrap();
    for row in &sized {
        // Depth is proportional to 1 / size, so it lies on the ideal line up to a factor.
        let expected = first.depth * first.height_px / row.height_px;
        assert!(
            (row.depth / expected.min(80.0) - 1.0).abs() < 0.03,
            "{} {expected}",
            row.depth
        );
        let ideal = FOCAL_PX * 1.5 / row.height_px;
        assert!((row.ideal_depth_m.unwrap() - ideal).abs() < 1e-9);
    }
    let flat = 240.5 * 0.54 / (0.03 * 414.0);
    for row in rows.iter().filter(|row| row.model == "constant") {
        assert!((row.depth - flat).abs() < 1e-3 && (row.relative_depth() - 1.0).abs() < 1e-6);
    }
    // 12 sizes of 2 sprites and a pair, 10 occlusions of 2 sprites twice, 40 places twice.
    let each = 6 * (12 * 3 + 10 * 2 * 2 + 40 * 2);
    assert_eq!(rows.len(), 3 * each);
    for name in ["row", "size", "constant"] {
        for figure in [
            "fig_4_3",
            "fig_4_4",
            "fig_4_5",
            "fig_4_6",
            "fig_4_7",
            "fig_4_7_steps",
            "fig_4_8",
            "fig_4_9",
            "fig_4_10",
        ] {
            let path = |ending: &str| world.path(&format!("out/figures/{name}/{figure}.{ending}"));
            let svg = fs::read_to_string(path("svg")).unwrap();
            assert!(svg.contains("</text>") && !svg.contains("NaN"), "{figure}");
            assert!(image::open(path("png")).unwrap().width() > 400);
        }
    }
}

/// A model that makes the contrast, and nothing else, nearer is found out.
#[test]
fn a_step_that_grows_with_contrast_is_found() {
    let world = World::new(5);
    // Inverse depth grows with the sprite's own magenta, which the contrast changes.
    world.model("local", "inverse_depth", known(&Known::Local(0.02, 0.02)));
    world.cues(&["local"], &["occlusion"]).code(0);
    let rows = world.rows();
    let contrast: Vec<&CueRow> = rows
        .iter()
        .filter(|row| row.condition == Condition::Contrast)
        .collect();
    assert_eq!(contrast.len(), 5 * 10 * 2);
    for row in contrast {
        let same = rows
            .iter()
            .find(|other| {
                other.condition == Condition::Same
                    && (&other.background, &other.sprite, other.step)
                        == (&row.background, &row.sprite, row.step)
            })
            .unwrap();
        // Alike objects have no step but that of their soft edges; the change lies in the whole
        // occluder, which is a part of the band.
        let (same_step, step) = (
            same.step_depth.unwrap().abs(),
            row.step_depth.unwrap().abs(),
        );
        assert!(
            same_step < 0.02 && step > 3.0 * same_step,
            "{same_step} {step}"
        );
        assert!(row.band_change.unwrap() > 0.0 && row.rest_change.unwrap() > 0.0);
        // The network sees the picture's own resolution.
        assert_eq!(row.band_px, Some(3));
        assert_eq!((same.band_change, same.rest_change), (None, None));
    }
}

#[test]
fn models_without_a_scale_are_judged_too() {
    let world = World::new(5);
    world.model("row", "inverse_depth", known(&Known::Map(&ground())));
    let ran = world.cues(&["row"], &["height", "--json"]);
    ran.code(0);
    let summary: serde_json::Value = serde_json::from_str(&ran.out).unwrap();
    assert_eq!(summary["findings"][0]["uses"], "yes", "{}", ran.out);
    assert!(
        !ran.out.contains("implied camera height"),
        "it needs metres"
    );
    assert!(world.rows().iter().all(|row| row.depth > 0.0));
    // The ground of equation 4.1, in metres: the camera's height comes back.
    world.model("row", "disparity_fraction", known(&Known::Map(&ground())));
    world.cues(&["row"], &["height", "--force"]).code(0);
    let text = fs::read_to_string(world.path("out/summary.md")).unwrap();
    assert!(text.contains("implied camera height"), "{text}");
}

/// What comes of rows alone is what came with the model.
#[test]
fn a_folder_is_drawn_again_from_its_rows() {
    let world = World::new(5);
    world.model("row", "disparity_fraction", known(&Known::Map(&ground())));
    let first = world.cues(&["row"], &["size", "height", "--scales", "5"]);
    first.code(0);
    let files = [
        "summary.csv",
        "statistics.csv",
        "summary.md",
        "figures/row/fig_4_5.svg",
        "figures/row/fig_4_9.png",
    ];
    let read = |name: &str| fs::read(world.path(&format!("out/{name}"))).unwrap();
    let before: Vec<Vec<u8>> = files.iter().map(|name| read(name)).collect();
    for name in files {
        fs::remove_file(world.path(&format!("out/{name}"))).unwrap();
    }
    let out = world.text("out");
    let again = bench(&["cues", "--render", &out]);
    again.code(0).says("drawn again");
    assert_eq!(first.out, again.out);
    for (name, before) in files.iter().zip(before) {
        assert!(read(name) == before, "{name}");
    }
    let empty = world.text("set");
    bench(&["cues", "--render", &empty])
        .code(1)
        .says("cues.csv");
    fs::write(world.path("out/cues.csv"), "model,experiment\nx,y\n").unwrap();
    bench(&["cues", "--render", &out])
        .code(1)
        .says("that `bench cues` wrote");
    bench(&["cues", "--render", &out, "--data", &empty]).code(2);
    bench(&["cues", "--out", &out]).code(2).says("--data");
}

/// A run that ended before its results were written goes on where it stopped, and ends with the same
/// files as one that was never interrupted.
#[test]
fn an_interrupted_run_goes_on() {
    let world = World::new(5);
    world.model("row", "disparity_fraction", known(&Known::Map(&ground())));
    let more = ["occlusion", "height"];
    world.cues(&["row"], &more).code(0);
    let whole = [
        "cues.csv",
        "summary.csv",
        "summary.md",
        "figures/row/fig_4_9.svg",
    ];
    let read = |name: &str| fs::read(world.path(&format!("out/{name}"))).unwrap();
    let expected: Vec<Vec<u8>> = whole.iter().map(|name| read(name)).collect();
    fs::remove_dir_all(world.path("out")).unwrap();
    // A folder where the rows should go: everything is measured, and nothing can be written.
    fs::create_dir_all(world.path("out/cues.csv")).unwrap();
    fs::write(world.path("out/unfinished-cues.yaml"), "tool: bench cues\n").unwrap();
    world.cues(&["row"], &more).code(1).says("cues.csv");
    let journals = || -> Vec<PathBuf> {
        let entries = fs::read_dir(world.path("out")).unwrap();
        let paths = entries.map(|entry| entry.unwrap().path());
        let is_journal = |path: &PathBuf| {
            let name = path.file_name().unwrap().to_str().unwrap();
            name.starts_with("unfinished-cues-row-")
        };
        paths.filter(is_journal).collect()
    };
    let [journal] = <[PathBuf; 1]>::try_from(journals()).unwrap();
    fs::remove_dir(world.path("out/cues.csv")).unwrap();
    let bytes = fs::read(&journal).unwrap();
    let lines = bytes.iter().filter(|&&byte| byte == b'\n').count();
    assert_eq!(lines, 1 + 5 * (2 * 10 * 2 + 2 * 40));
    // Cut within a line: that row and its job are measured again.
    fs::write(&journal, &bytes[..bytes.len() / 2]).unwrap();
    let ran = world.cues(&["row"], &more);
    ran.code(0).says("of 600 composites were measured before");
    for (name, expected) in whole.iter().zip(expected) {
        assert!(read(name) == expected, "{name}");
    }
    assert_eq!(journals(), Vec::<PathBuf>::new());

    // Another description is another run: nothing is taken over.
    fs::remove_file(world.path("out/cues.csv")).unwrap();
    fs::create_dir_all(world.path("out/cues.csv")).unwrap();
    world.cues(&["row"], &more).code(1);
    fs::remove_dir(world.path("out/cues.csv")).unwrap();
    world.model("row", "inverse_depth", known(&Known::Map(&ground())));
    let ran = world.cues(&["row"], &[&more[..], &["--force"]].concat());
    ran.code(0);
    assert!(!ran.err.contains("were measured before"), "{}", ran.err);
    assert_eq!(
        journals(),
        Vec::<PathBuf>::new(),
        "nor that of the other run"
    );
    world.model("row", "disparity_fraction", known(&Known::Map(&ground())));
    world
        .cues(&["row"], &more)
        .code(1)
        .says("rows under another description of row");
}

/// The number of threads changes nothing.
#[test]
fn rows_do_not_depend_on_threads() {
    let world = World::new(5);
    world.model("size", "disparity_fraction", known(&Known::RootOfMean(0.2)));
    let mut seen = Vec::new();
    for jobs in ["1", "3"] {
        world
            .cues(&["size"], &["occlusion", "--jobs", jobs, "--quiet"])
            .code(0);
        seen.push(fs::read(world.path("out/cues.csv")).unwrap());
    }
    assert!(seen[0] == seen[1]);
}

#[test]
fn bad_sprites_are_named() {
    let world = World::new(5);
    world.model("constant", "depth_m", known(&Known::Constant(9.0)));
    let try_it = |code: i32, words: &str| {
        world.cues(&["constant"], &["size"]).code(code).says(words);
        assert!(!world.path("out").join("cues.csv").exists());
    };
    RgbImage::new(20, 20)
        .save(world.path("sprites/flat.png"))
        .unwrap();
    try_it(1, "flat.png has no alpha channel");
    RgbaImage::from_pixel(20, 20, Rgba([1, 2, 3, 255]))
        .save(world.path("sprites/flat.png"))
        .unwrap();
    try_it(1, "flat.png is opaque everywhere");
    RgbaImage::new(20, 20)
        .save(world.path("sprites/flat.png"))
        .unwrap();
    try_it(1, "flat.png is opaque nowhere");
    fs::write(world.path("sprites/flat.png"), b"no picture").unwrap();
    try_it(1, "flat.png is not a usable PNG");
    // 73 px high, this would be 1100 px wide in a picture of 414.
    world.flat_sprites(600);
    try_it(1, "does not fit into a background of 414x125");
    RgbaImage::new(5000, 2)
        .save(world.path("sprites/flat.png"))
        .unwrap();
    try_it(1, "is 5000x2; at most 4096");
    world.flat_sprites(30);
    fs::write(world.path("sprites/sprites.yaml"), "sprites: []\n").unwrap();
    try_it(1, "has no sprite");
    let one = "sprites: [{file: flat.png, name: car, familiar: true, height_m: 1.5}]\n";
    fs::write(world.path("sprites/sprites.yaml"), one).unwrap();
    try_it(1, "has no unfamiliar sprite");
    fs::write(world.path("sprites/sprites.yaml"), one.replace("1.5", "-1")).unwrap();
    try_it(1, "`height_m` must be a number above 0");
    fs::write(
        world.path("sprites/sprites.yaml"),
        one.replace("name", "nam"),
    )
    .unwrap();
    try_it(1, "sprites.yaml");
    fs::remove_file(world.path("sprites/sprites.yaml")).unwrap();
    try_it(1, "sprites.yaml");
}

#[test]
fn bad_models_and_sets_are_sentences() {
    let world = World::new(5);
    world.model(
        "nan",
        "disparity_fraction",
        known(&Known::Constant(f32::NAN)),
    );
    world.model(
        "constant",
        "disparity_fraction",
        known(&Known::Constant(0.03)),
    );
    let ran = world.cues(&["nan", "constant"], &["height"]);
    ran.code(1)
        .says("model nan")
        .says("is not a number at row 0, column 0");
    // The sound model keeps its results.
    assert!(world.rows().iter().all(|row| row.model == "constant"));
    assert_eq!(
        world.words()[&("constant".to_owned(), HEIGHT_CUE.to_owned())],
        BTreeSet::from(["no".to_owned()])
    );
    let few = World::new(4);
    few.model(
        "constant",
        "disparity_fraction",
        known(&Known::Constant(0.03)),
    );
    few.cues(&["constant"], &[])
        .code(1)
        .says("has 4 test images at full size, and the experiments need at least 5");
    world
        .cues(
            &["constant"],
            &["--frames", "kitti2015/000001,kitti2015/000077"],
        )
        .code(1)
        .says("no test image \"kitti2015/000077\"");
    world
        .cues(&["constant"], &["--horizon-row", "400"])
        .code(1)
        .says("the horizon at row 400");
    world.cues(&["constant"], &["--backgrounds", "3"]).code(2);
    world
        .cues(&["nothing"], &["--force"])
        .code(1)
        .says("nothing.onnx");
    let set = world.text("set");
    let out = world.text("cut");
    bench(&["sprites", "--data", &set, "--out", &out])
        .code(1)
        .says("no instance maps");
}

/// The committed sprites are those that the program draws.
#[test]
fn embedded_sprites_are_drawn_by_the_recipe() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("sprites");
    let mut bytes = 0;
    for drawing in draw::DRAWINGS {
        let path = folder.join(drawing.file);
        bytes += fs::metadata(&path).unwrap().len();
        let image = image::open(&path).unwrap().into_rgba8();
        assert_eq!(image.dimensions(), (drawing.width, drawing.height));
        // Every pixel of each seventh row and column; all of them take a minute.
        for y in (3..drawing.height).step_by(7) {
            for x in (3..drawing.width).step_by(7) {
                let pixel = image.get_pixel(x, y).0;
                assert_eq!(pixel, drawing.pixel(x, y), "{} at {x}, {y}", drawing.file);
            }
        }
    }
    assert!(bytes < 300_000, "{bytes}");
}
