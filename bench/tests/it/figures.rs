//! `bench figures` from outside: sheets of models side by side, Make3D, and what is said of models
//! and images that cannot be drawn.

use std::{collections::BTreeMap, fs, path::Path};

use assert_cmd::Command;
use image::{Rgb, RgbImage};
use strat_bench::{
    evaluate::{self, Predictor, Task},
    model::Model,
    runtime::{Device, Runtime, RuntimeChoice},
};
use strat_metrics::{Row, RowContext};
use strat_splits::{Role, Split};
use strat_store::{
    exr::{self, DepthHeader},
    files, image_files,
    progress::Progress,
    raster::Plane,
    resize::Kernel,
    set::{Content, Count, FORMAT, FileRef, Manifest, PreparedSet, Sample},
};

use crate::command::{Ran, run, text};
use crate::fixtures::{
    HEIGHT, INPUT_HEIGHT, INPUT_WIDTH, WIDTH, metadata, network, write_discriminator, write_model,
};
use crate::world::World;

fn figures(set: &Path, out: &Path, more: &[&str]) -> Ran {
    let mut command = Command::cargo_bin("bench").unwrap();
    command.args(["figures", "--runtime", "embedded", "--quiet", "--data"]);
    run(command.arg(set).arg("--out").arg(out).args(more))
}

fn svg(out: &Path, name: &str) -> String {
    fs::read_to_string(out.join(format!("{name}.svg"))).unwrap()
}

#[test]
fn models_stand_side_by_side() {
    let world = World::new(Split::Kitti, 6, false);
    let a = write_model(world.folder.path(), "a", 0.05, 0.0, "kitti");
    let b = write_model(world.folder.path(), "b", 0.1, 0.01, "kitti");
    let models = [
        "--model",
        &text(&a),
        "--model",
        &format!("b & c={}", text(&b)),
    ];
    let (set, out) = (world.path("set"), world.path("out"));
    let ran = figures(&set, &out, &models);
    // Two sheets of both models, and one of each.
    assert_eq!(ran.code(0).out.lines().count(), 4, "{}", ran.out);
    let sheet = svg(&out, "comparison");
    for words in [
        "KITTI split: depth and its error under kitti2015",
        "kitti2015/000000",
        "a: depth",
        "b &amp; c: relative error",
        "ground truth, dilated",
    ] {
        assert!(sheet.contains(words), "no {words}");
    }
    // Input, truth, two maps and two errors for each of four images.
    assert_eq!(sheet.matches("<image").count(), 24);
    // Half of the constant is the right disparity: 0.025 of 32 columns moves by 0.8.
    let views = svg(&out, "fig_3_10");
    assert!(views.contains("a: right view") && views.contains("mean difference "));
    // The constant moves by 0.08 columns at a tenth of the baseline.
    let baselines = svg(&out, "fig_3_4_2");
    assert!(
        baselines.contains("growing baselines: b &amp; c") && baselines.contains("from b = 1: ")
    );
    assert!(out.join("fig_3_4_1.png").is_file());
    for name in ["comparison", "fig_3_10"] {
        let drawn = image_files::read_rgb(&out.join(format!("{name}.png"))).unwrap();
        assert!(drawn.width() > 300 && drawn.height() > 300, "{name}");
    }
    let record = fs::read_to_string(out.join("figures.yaml")).unwrap();
    assert!(record.contains("kitti2015/000004") && record.contains("blake3"));
    // The same again, byte for byte.
    figures(&set, &world.path("again"), &models).code(0);
    assert_eq!(sheet, svg(&world.path("again"), "comparison"));
}

#[test]
fn images_are_chosen_by_id_or_by_their_error() {
    let world = World::new(Split::Kitti, 6, false);
    let model = text(&write_model(world.folder.path(), "m", 0.04, 0.01, "kitti"));
    world.bench("3.1", "run", &["--model", &model]).code(0);
    let mut rows = world.rows("run");
    rows.sort_by(|a, b| a.score.metrics.abs_rel.total_cmp(&b.score.metrics.abs_rel));
    let (best, worst) = (&rows[0].image, &rows[5].image);
    assert_ne!(rows[0].score.metrics.abs_rel, rows[5].score.metrics.abs_rel);
    let (set, out) = (world.path("set"), world.path("out"));
    let file = text(&world.path("run/rows.csv"));
    let chosen = |more: &[&str]| -> Vec<String> {
        let more = [&["--model", &model, "--force"], more].concat();
        figures(&set, &out, &more).code(0);
        let record = fs::read_to_string(out.join("figures.yaml")).unwrap();
        let lines = record.lines().map(|line| line.trim_start_matches("- "));
        lines
            .filter(|line| line.starts_with("kitti2015/") && !line.contains(','))
            .map(str::to_owned)
            .collect()
    };
    assert_eq!(chosen(&["--rows", &file, "--worst", "1"]), [worst.as_str()]);
    assert_eq!(
        chosen(&["--rows", &file, "--worst", "1", "--best", "1"]),
        [worst.as_str(), best.as_str()]
    );
    assert_eq!(
        chosen(&["--frames", "kitti2015/000003,kitti2015/000001"]),
        ["kitti2015/000003", "kitti2015/000001"]
    );
    assert_eq!(
        chosen(&["--count", "2"]),
        ["kitti2015/000000", "kitti2015/000003"]
    );

    let wrong = |more: &[&str]| figures(&set, &out, &[&["--model", &model], more].concat());
    wrong(&["--frames", "kitti2015/000777"])
        .code(1)
        .says("no test image kitti2015/000777; one that it has is kitti2015/000000");
    wrong(&["--rows", &file]).code(2).says("--worst");
    wrong(&["--worst", "2"]).code(2).says("--rows");
    wrong(&["--protocol", "eigen-80"]).code(2).says("Velodyne");
    figures(&set, &out, &[]).code(2).says("--model");
    figures(&world.path("nowhere"), &out, &["--model", &model])
        .code(2)
        .says("nowhere");
}

#[test]
fn what_cannot_be_drawn_is_said_and_the_rest_is_drawn() {
    let world = World::new(Split::Eigen, 3, false);
    let good = text(&write_model(world.folder.path(), "good", 0.1, 0.0, "eigen"));
    let nan = world.path("nan.onnx");
    fs::write(&nan, network(f32::NAN, 0.0, Some(&metadata("eigen")))).unwrap();
    let garbage = world.path("garbage.onnx");
    fs::write(&garbage, b"garbage").unwrap();
    let (set, out) = (world.path("set"), world.path("out"));
    let models = [
        "--model",
        &good,
        "--model",
        &text(&nan),
        "--model",
        &text(&garbage),
    ];
    figures(&set, &out, &models)
        .code(1)
        .says("nan, image")
        .says("garbage");
    let sheet = svg(&out, "comparison");
    assert!(sheet.contains("good: depth") && sheet.contains("nan: no depth: "));
    assert!(!sheet.contains("garbage"));
    // Nothing but broken models.
    figures(&set, &world.path("none"), &["--model", &text(&garbage)]).code(1);
    assert!(!world.path("none/comparison.svg").exists());
}

/// Whatever a model gives and a protocol leaves out: the mean of the error that is drawn is the Abs Rel
/// of the row.
#[test]
fn the_drawn_error_is_the_scored_one() {
    let world = World::new(Split::Eigen, 3, false);
    let metric = write_model(world.folder.path(), "metric", 0.05, 0.04, "eigen");
    // The same network, said to give inverse depth of unknown scale.
    let unscaled = world.path("unscaled.onnx");
    fs::write(&unscaled, network(0.05, 0.04, None)).unwrap();
    let description = format!(
        "input: {{width: {INPUT_WIDTH}, height: {INPUT_HEIGHT}, range: 0..1}}\n\
         output: {{meaning: inverse_depth}}\n"
    );
    fs::write(world.path("unscaled.yaml"), description).unwrap();
    let (runtime, _) = Runtime::resolve(RuntimeChoice::Embedded, Device::Cpu).unwrap();
    let set = PreparedSet::open(&world.path("set")).unwrap();
    let samples = set.samples(Role::Test).unwrap();
    let pictures = samples.iter().map(|sample| sample.id.clone()).collect();
    let pool = strat_store::threads::pool("test", 2).unwrap();
    let mut seen = Vec::new();
    for (file, protocol, is_scaled, is_cropped) in [
        (&metric, "eigen-80", false, true),
        (&metric, "eigen-80-nocrop", false, false),
        (&unscaled, "eigen-80-median", true, true),
        (&unscaled, "eigen-80-nocrop-median", true, false),
    ] {
        let mut model = Model::open("m", file, &runtime, Device::Cpu, 1).unwrap();
        let protocol = strat_metrics::protocol(protocol).unwrap();
        let context = RowContext {
            protocol: protocol.name.clone(),
            ..RowContext::default()
        };
        let task = Task {
            set: &set,
            samples: &samples,
            protocols: &[(protocol, context)],
            pictures: &pictures,
            further: false,
            whole: false,
        };
        let progress = Progress::new("test", 3, "images", true);
        let predictor = &mut Predictor::Model(&mut model);
        let Ok(found) = evaluate::evaluate(&task, "m", predictor, &pool, &progress, &mut ());
        assert_eq!((found.rows.len(), found.comparisons.len()), (3, 3));
        for (row, comparison) in found.rows.iter().zip(&found.comparisons) {
            assert_eq!(row.image, comparison.image);
            let error = comparison.error();
            let drawn: Vec<f64> = error
                .data
                .iter()
                .filter(|error| **error >= 0.0)
                .map(|error| f64::from(*error))
                .collect();
            let mean = drawn.iter().sum::<f64>() / drawn.len() as f64;
            let abs_rel = row.score.metrics.abs_rel;
            assert!((mean / abs_rel - 1.0).abs() < 1e-6, "{mean} {abs_rel}");
            assert_eq!(comparison.abs_rel(), Some(abs_rel));
            // Nothing is measured in the upper quarter, and the crop leaves more out.
            let measured = (WIDTH * HEIGHT * 3 / 4) as usize;
            assert_eq!(drawn.len() == measured, !is_cropped);
            let scale = comparison
                .scored
                .as_ref()
                .unwrap()
                .compared
                .fit
                .map_or(1.0, |fit| fit.scale);
            assert_eq!(scale != 1.0, is_scaled);
            seen.push(abs_rel);
        }
    }
    // The images and protocols differ, so the equality above is no accident.
    seen.sort_by(f64::total_cmp);
    assert!(
        seen.windows(2).any(|pair| pair[1] > 1.01 * pair[0]),
        "{seen:?}"
    );
}

/// Captions and the list of pictures have the numbers of the rows, under the protocol that they name.
#[test]
fn captions_have_the_numbers_of_the_rows() {
    let world = World::new(Split::Eigen, 3, false);
    let model = text(&write_model(world.folder.path(), "m", 0.05, 0.04, "eigen"));
    let more = ["--model", &model, "--protocol", "eigen-80-distance"];
    let more = [&more[..], &["--extremes", "1", "--pictures", "3"]].concat();
    world.bench("3.3", "run", &more).code(0);
    let rows = world.rows("run");
    let list = fs::read_to_string(world.path("run/pictures/pictures.csv")).unwrap();
    let first = &rows[0].context.protocol;
    for row in rows.iter().filter(|row| row.context.protocol == *first) {
        let expected = format!(
            "m,{},{first},{},{},",
            row.image, row.context.protocol_digest, row.score.metrics.abs_rel
        );
        assert_eq!(
            list.matches(&expected).count(),
            1,
            "no {expected} in {list}"
        );
    }
    let (set, out) = (world.path("set"), world.path("out"));
    let file = text(&world.path("run/rows.csv"));
    let chosen = ["--rows", &file, "--worst", "1", "--protocol", "eigen-50"];
    figures(&set, &out, &[&["--model", &model], &chosen[..]].concat()).code(0);
    let of_50 = rows.iter().filter(|row| row.context.protocol == "eigen-50");
    let error = |row: &&Row| row.score.metrics.abs_rel;
    let worst = of_50.max_by(|a, b| error(a).total_cmp(&error(b))).unwrap();
    let caption = format!(
        "m: relative error; Abs Rel {:.3} under eigen-50",
        worst.score.metrics.abs_rel
    );
    let sheet = svg(&out, "comparison");
    assert!(sheet.contains(&caption), "no {caption}");
    assert!(sheet.contains(&worst.image));
    // Rows say nothing about a protocol that they were not measured under.
    let chosen = [
        "--rows",
        &file,
        "--worst",
        "1",
        "--protocol",
        "eigen-cameraz-80",
    ];
    figures(&set, &out, &[&["--model", &model], &chosen[..]].concat())
        .code(2)
        .says("no images under eigen-cameraz-80; they are about eigen-50, eigen-80, eigen-80-distance");
}

/// A set as `prep make3d` makes it: one picture, and a coarse laser grid of its middle.
fn make3d(root: &Path) {
    let put = |path: &str, bytes: &[u8]| {
        files::write_atomic(&root.join(path), bytes).unwrap();
        FileRef {
            path: path.to_owned(),
            blake3: files::blake3_hex(bytes),
        }
    };
    let samples: Vec<Sample> = ["a", "b", "c"]
        .iter()
        .map(|stem| {
            let picture = |width, height| {
                let image = RgbImage::from_fn(width, height, |x, y| {
                    Rgb([
                        (x * 200 / width) as u8,
                        (y * 200 / height) as u8,
                        stem.as_bytes()[0],
                    ])
                });
                image_files::encode_png_rgb(&image)
            };
            // 5 m below, 40 m above.
            let depth = (0..305 * 21).map(|i| 40.0 - 35.0 * (i / 305) as f32 / 20.0);
            let grid = Plane::new(305, 21, depth.collect()).unwrap();
            let header = DepthHeader {
                source: "laser".to_owned(),
                axis: "ray".to_owned(),
                focal_px: 0.0,
                baseline_m: 0.0,
                frame: (*stem).to_owned(),
            };
            let laser = exr::encode_depth(&grid, &header).unwrap();
            let left = put(&format!("l/{stem}.png"), &picture(32, 16));
            Sample {
                left_full: Some(put(&format!("f/{stem}.png"), &picture(426, 213))),
                depth_laser: Some(put(&format!("d/{stem}.exr"), &laser)),
                ..Sample::new(format!("make3d/{stem}"), (426, 213), 0.0, 0.0, left)
            }
        })
        .collect();
    let manifest = Manifest {
        format: FORMAT,
        content: Content::Make3d,
        split_digest: None,
        source: "drawn".to_owned(),
        image_width: 32,
        image_height: 16,
        kernel: Kernel::Area,
        codec: "png".to_owned(),
        counts: BTreeMap::from([(
            Role::Test,
            Count {
                expected: 134,
                found: 3,
            },
        )]),
        failures: 0,
        cameras: Vec::new(),
        tool_version: "test".to_owned(),
        data_digest: String::new(),
    };
    PreparedSet::write(root, manifest, &BTreeMap::from([(Role::Test, samples)])).unwrap();
}

#[test]
fn make3d_has_panels_and_a_table() {
    let world = World::new(Split::Kitti, 1, false);
    let set = world.path("make3d");
    make3d(&set);
    let model = text(&write_model(world.folder.path(), "m", 0.05, 0.02, "kitti"));
    let out = world.path("out");
    figures(&set, &out, &["--model", &model]).code(0);
    let sheet = svg(&out, "fig_3_6");
    assert!(sheet.contains("Make3D: depth and its error under make3d-c1"));
    assert_eq!(sheet.matches("<image").count(), 12);
    assert!(
        !out.join("fig_3_10.svg").exists(),
        "there are no right views"
    );

    let mut command = Command::cargo_bin("bench").unwrap();
    command.args([
        "--table",
        "make3d",
        "--runtime",
        "embedded",
        "--model",
        &model,
    ]);
    let ran = run(command.arg("--data").arg(&set).arg("--out").arg(&out));
    let line = ran.code(0).out.lines().next().unwrap().to_owned();
    assert!(
        line.starts_with("Table make3d, beside figure 3.6: 3 of 134 images; protocol make3d-c1"),
        "{line}"
    );
    assert!(ran.out.contains("RMSE log10"), "{}", ran.out);
    for ending in ["txt", "md", "tex", "csv"] {
        assert!(
            out.join(format!("table_make3d.{ending}")).is_file(),
            "{ending}"
        );
    }
    // A table of KITTI is refused, and this one for KITTI.
    world
        .bench("make3d", "other", &["--model", &model])
        .code(2)
        .says("make3d");
}

/// Matching takes no model. Every image of the set is a ramp along its rows, the same on both sides: the
/// cheapest disparity is 0 everywhere, the true one is not, so nothing is found.
#[test]
fn matching_costs_are_drawn_without_a_model() {
    let world = World::new(Split::Kitti, 22, false);
    let (set, out) = (world.path("set"), world.path("out"));
    let ran = figures(&set, &out, &["--matching"]);
    ran.code(0);
    assert!(
        ran.out
            .contains("22 images searched, 0 of them in native size"),
        "{}",
        ran.out
    );
    assert!(ran.out.contains("all textures: L1 0.0 %"), "{}", ran.out);
    let costs = svg(&out, "fig_3_2");
    assert!(
        costs.contains("L1: cheapest at 0 px") && costs.contains("true: 6.2 px"),
        "{costs}"
    );
    assert!(svg(&out, "fig_3_2_places").contains("kitti2015/000000"));
    assert!(svg(&out, "fig_3_2_found_dssim").contains("DSSIM 3x3: the cheapest place is true"));
    let table = fs::read_to_string(out.join("matching.csv")).unwrap();
    assert!(
        table.starts_with("texture_from,texture_to,cost,pixels,drives,found,low,high,chance\n")
    );
    assert!(
        table.lines().last().unwrap().starts_with(",,objective,"),
        "{table}"
    );
    // The same again replaces its own.
    figures(&set, &out, &["--matching", "--pixel", "20,12"]).code(0);
    figures(&set, &out, &["--matching", "--pixel", "400,12"])
        .code(2)
        .says("no true disparity within 8 pixels");
    figures(&set, &out, &["--matching", "--pixel", "31"])
        .code(2)
        .says("a column and a row");
    figures(&set, &out, &["--pixel", "3,4"])
        .code(2)
        .says("--matching");
}

/// Green grows to the right, so that what is taken from farthest left is darkest.
#[test]
fn a_discriminator_is_one_more_cost() {
    let world = World::new(Split::Kitti, 22, false);
    let (set, out) = (world.path("set"), world.path("out"));
    let run = world.path("run");
    let more = [
        "--matching",
        "--pixel",
        "20,12",
        "--discriminator",
        &text(&run),
    ];
    fs::create_dir(&run).unwrap();
    figures(&set, &out, &more).code(2).says("train export");
    write_discriminator(&run.join("discriminator.onnx"));
    let ran = figures(&set, &out, &more);
    ran.code(0);
    assert!(ran.out.contains("up to 8 pixels of each"), "{}", ran.out);
    assert!(ran.out.contains(" discriminator "), "{}", ran.out);
    // A fifth of 32 px is 6, and a pixel is 3.875 native ones.
    let costs = svg(&out, "fig_3_2");
    assert!(costs.contains("): cheapest at 23 px"), "{costs}");
    assert!(
        costs.contains("discriminator of the left image: "),
        "{costs}"
    );
    assert!(svg(&out, "fig_3_2_places").contains("Blue: by the discriminator."));
    let table = fs::read_to_string(out.join("matching.csv")).unwrap();
    assert!(
        table
            .lines()
            .last()
            .unwrap()
            .starts_with(",,discriminator,176,"),
        "{table}"
    );
    let record = fs::read_to_string(out.join("figures.yaml")).unwrap();
    assert!(record.contains("discriminator.onnx"), "{record}");
}
