//! Runs without a model, in parts, and broken off: what comes out is what one run would give.

use std::{
    fs,
    io::Write as _,
    path::Path,
    process::{Command as Process, Stdio},
};

use assert_cmd::Command;
use strat_bench::evaluate::record::RunRecord;
use strat_onnx::graph::{Filter, Geometry, GraphBuilder};
use strat_splits::Split;
use strat_store::{
    exr::{self, DepthHeader},
    fault, image_files,
    raster::Plane,
    yaml,
};

use crate::command::{Ran, run, text};
use crate::fixtures::{
    HEIGHT, INPUT_HEIGHT, INPUT_WIDTH, SCAN_DEPTH_M, WIDTH, network, onnxruntime, write_model,
};
use crate::npy;
use crate::world::World;

/// Files that must not depend on how a run was divided or interrupted.
const RESULTS: [&str; 3] = ["rows.csv", "leaderboard.csv", "table_3_1.csv"];

fn merge(world: &World, out: &str) -> Ran {
    let mut command = Command::cargo_bin("bench").unwrap();
    run(command.arg("merge").arg(world.path(out)))
}

#[track_caller]
fn same_results(world: &World, a: &str, b: &str) {
    for file in RESULTS {
        let of = |out: &str| fs::read_to_string(world.path(out).join(file)).unwrap();
        assert_eq!(of(a), of(b), "{file}");
    }
}

/// What two runs say of each model, in their records.
#[track_caller]
fn same_findings(world: &World, a: &str, b: &str) {
    let of = |out: &str| {
        let record: RunRecord = yaml::load(&world.path(out).join("run.yaml")).unwrap();
        let agreements: Vec<_> = record.models.iter().map(|model| model.agreement).collect();
        (agreements, record.warnings)
    };
    assert!(of(a).0.iter().all(Option::is_some));
    assert_eq!(of(a), of(b));
}

/// The change of files before which a run is killed: the one that adds the rows of the last image.
const KILLED_AT: &str = "39";

/// Saves an array `[count, rows, columns]` of one value, with its description.
fn save(path: &Path, shape: (usize, usize, usize), value: f32, description: &str) {
    let (count, rows, columns) = shape;
    let values = std::iter::repeat_n(value, count * rows * columns);
    npy::write(path, &[count, rows, columns], values);
    fs::write(path.with_extension("yaml"), description).unwrap();
}

#[test]
fn what_a_run_saves_scores_as_the_model_did() {
    let world = World::new(Split::Kitti, 5, false);
    let model = write_model(world.folder.path(), "looks", 0.02, 0.05, "kitti");
    let more = ["--model", &text(&model), "--save-predictions"];
    world.bench("3.1", "model", &more).code(0);
    let saved = text(&world.path("model/predictions.npy"));
    let named = format!("looks={saved}");
    let ran = world.bench("3.1", "saved", &["--predictions", &named]);
    ran.code(0).says("leakage cannot");
    let (from_model, from_file) = (world.rows("model"), world.rows("saved"));
    assert_eq!(from_model.len(), 5);
    for (a, b) in from_model.iter().zip(&from_file) {
        assert_eq!((&a.image, a.score), (&b.image, b.score));
        assert_eq!(b.context.runtime, "none");
    }
    // The same maps compressed, beside the same list of images.
    let bytes = fs::read(&saved).unwrap();
    let packed = world.path("model/packed.npz");
    let mut zip = zip::ZipWriter::new(fs::File::create(&packed).unwrap());
    let options = zip::write::SimpleFileOptions::default();
    zip.start_file("disparities.npy", options).unwrap();
    zip.write_all(&bytes).unwrap();
    zip.finish().unwrap();
    for ending in ["ids.txt", "yaml"] {
        let from = world.path("model/predictions").with_extension(ending);
        fs::copy(from, packed.with_extension(ending)).unwrap();
    }
    let ran = world.bench("3.1", "packed", &["--predictions", &text(&packed)]);
    ran.code(0);
    for (a, b) in from_file.iter().zip(&world.rows("packed")) {
        assert_eq!(a.score, b.score);
    }
}

/// Closed forms: depth that is the truth, and 1.1 times the truth.
#[test]
fn a_perfect_predictor_and_one_that_is_a_tenth_too_far() {
    let world = World::new(Split::Eigen, 2, false);
    let size = (2, HEIGHT as usize, WIDTH as usize);
    let camera_m = SCAN_DEPTH_M - 0.25;
    save(
        &world.path("perfect.npy"),
        size,
        camera_m,
        "meaning: depth_m\n",
    );
    // The same depth in a unit of 5.4 m, through a sigmoid, as monodepth2 saves it.
    let sigmoid = (5.4 / f64::from(camera_m) - 0.01) / 9.99;
    let description =
        "meaning: inverse_depth\nscale: 5.4\nsigmoid: {min_depth: 0.1, max_depth: 100}\n";
    save(
        &world.path("sigmoid.npy"),
        size,
        sigmoid as f32,
        description,
    );
    save(
        &world.path("far.npy"),
        size,
        camera_m,
        "meaning: depth_m\nscale: 1.1\n",
    );
    let mut more: Vec<String> = vec!["--protocol".into(), "eigen-cameraz-80".into()];
    for name in ["perfect", "sigmoid", "far"] {
        more.push("--predictions".into());
        more.push(text(&world.path(&format!("{name}.npy"))));
    }
    let more: Vec<&str> = more.iter().map(String::as_str).collect();
    world.bench("3.3", "out", &more).code(0);
    let rows = world.rows("out");
    let metrics = |model: &str, protocol: &str| {
        let mut own = rows.iter().filter(|row| {
            (row.context.model.as_str(), row.context.protocol.as_str()) == (model, protocol)
        });
        own.next().unwrap().score.metrics
    };
    for model in ["perfect", "sigmoid"] {
        let m = metrics(model, "eigen-cameraz-80");
        assert!(m.abs_rel < 1e-6 && m.rmse < 1e-5, "{model}: {m:?}");
        // The scanner's own axis is 0.25 m longer.
        let legacy = metrics(model, "eigen-80");
        assert!((legacy.abs_rel - 0.025).abs() < 1e-6, "{model}: {legacy:?}");
        assert!((legacy.rmse - 0.25).abs() < 1e-5, "{model}: {legacy:?}");
    }
    let m = metrics("far", "eigen-cameraz-80");
    assert!((m.abs_rel - 0.1).abs() < 1e-6, "{m:?}");
    assert!(
        (m.sq_rel - 0.01 * f64::from(camera_m)).abs() < 1e-6,
        "{m:?}"
    );
    assert!((m.rmse_log - 1.1_f64.ln()).abs() < 1e-6, "{m:?}");
    assert_eq!([m.a1, m.a2, m.a3], [1.0; 3]);
}

#[test]
fn a_folder_of_pictures_is_read_by_the_names_of_the_images() {
    let world = World::new(Split::Kitti, 3, false);
    let folder = world.path("maps");
    fs::create_dir(&folder).unwrap();
    let pixels = (WIDTH * HEIGHT) as usize;
    // 4 % of the width, as KITTI's own disparity files have it: times 256.
    let units = (0.04 * f64::from(WIDTH) * 256.0).round() as u16;
    let png = image_files::encode_png_gray16(WIDTH, HEIGHT, &vec![units; pixels]);
    fs::write(folder.join("000000.png"), png).unwrap();
    let disparity_px = f32::from(units) / 256.0;
    let plane = Plane::filled(WIDTH as usize, HEIGHT as usize, disparity_px);
    let header = DepthHeader {
        source: "test".to_owned(),
        axis: "z".to_owned(),
        focal_px: 1.0,
        baseline_m: 1.0,
        frame: "test".to_owned(),
    };
    let exr = exr::encode_depth(&plane, &header).unwrap();
    fs::write(folder.join("kitti2015_000001.exr"), exr).unwrap();
    fs::create_dir(folder.join("kitti2015")).unwrap();
    let shape = [1, HEIGHT as usize, WIDTH as usize];
    let values = std::iter::repeat_n(disparity_px, pixels);
    npy::write(&folder.join("kitti2015/000002.npy"), &shape, values);
    let asked = ["--predictions", &text(&folder)];
    world
        .bench("3.1", "none", &asked)
        .code(1)
        .says("is missing");
    fs::write(folder.join("predictions.yaml"), "meaning: disparity_px\n").unwrap();
    world.bench("3.1", "out", &asked).code(0);
    let rows = world.rows("out");
    let expected = (1.0 - crate::fixtures::DISPARITY_PX / f64::from(disparity_px)).abs();
    assert_eq!(rows.len(), 3);
    for row in &rows {
        let abs_rel = row.score.metrics.abs_rel;
        assert!(
            (abs_rel - expected).abs() < 1e-6,
            "{}: {abs_rel}",
            row.image
        );
    }
    // A map that is not there costs its own image only.
    fs::remove_file(folder.join("kitti2015_000001.exr")).unwrap();
    world
        .bench("3.1", "less", &asked)
        .code(1)
        .says("image kitti2015/000001: ")
        .says("has no map for this image");
    assert_eq!(world.rows("less").len(), 2);
}

#[test]
fn arrays_of_the_whole_split_are_in_published_order() {
    let world = World::new(Split::Eigen, 1, false);
    let id = "2011_09_26_drive_0002/0000000000";
    let list = strat_splits::test_ids(Split::Eigen);
    let place = list.iter().position(|known| known == id).unwrap();
    let path = world.path("all.npy");
    let describe = "meaning: disparity_fraction\n";
    let array = |place: usize, count: usize| {
        let value = |map| if map == place { 3.6 / 124.0 } else { 0.5 };
        let values = (0..count).flat_map(|map| [value(map); 8]);
        npy::write(&path, &[count, 2, 4], values);
    };
    save(&path, (1, 2, 4), 0.5, describe);
    array(place, list.len());
    let asked = ["--predictions", &text(&path)];
    world.bench("3.3", "out", &asked).code(0);
    let abs_rel = |out: &str| world.rows(out)[0].score.metrics.abs_rel;
    assert!(abs_rel("out") < 1e-6, "{}", abs_rel("out"));
    // Names beside the array say otherwise.
    array(1, 3);
    let names = path.with_extension("ids.txt");
    fs::write(&names, format!("a/1\n{id}\nb/2\n")).unwrap();
    world.bench("3.3", "named", &asked).code(0);
    assert!(abs_rel("named") < 1e-6, "{}", abs_rel("named"));
    fs::write(&names, format!("{id}\n{id}\nb/2\n")).unwrap();
    world
        .bench("3.3", "twice", &asked)
        .code(1)
        .says("it names an image twice");
    fs::write(&names, "a/1\nb/2\nc/3\n").unwrap();
    world
        .bench("3.3", "others", &asked)
        .code(1)
        .says("has no map for this image");
}

#[test]
fn predictions_that_cannot_be_used_are_sentences() {
    let world = World::new(Split::Kitti, 2, false);
    let describe = |name: &str, text: &str| {
        fs::write(world.path(&format!("{name}.yaml")), text).unwrap();
    };
    let fraction = "meaning: disparity_fraction\n";
    save(&world.path("many.npy"), (7, 2, 4), 0.03, fraction);
    save(&world.path("nan.npy"), (2, 2, 4), f32::NAN, fraction);
    save(
        &world.path("odd.npy"),
        (2, 2, 4),
        0.03,
        "meaning: fractions\n",
    );
    save(
        &world.path("scale.npy"),
        (2, 2, 4),
        0.03,
        "meaning: depth_m\nscale: 0\n",
    );
    fs::write(world.path("text.npy"), b"no array").unwrap();
    describe("text", fraction);
    fs::write(world.path("cut.npz"), b"PK\x03\x04").unwrap();
    describe("cut", fraction);
    let whole = fs::read(world.path("many.npy")).unwrap();
    fs::write(world.path("short.npy"), &whole[..whole.len() - 8]).unwrap();
    describe("short", fraction);
    for (name, sentence) in [
        ("many.npy", "it has 7 maps for the 2 test images of the set"),
        ("nan.npy", "is not a number at row 0, column 0"),
        ("odd.npy", "odd.yaml"),
        ("scale.npy", "`scale` must be a positive number"),
        ("text.npy", "it is not a NumPy array"),
        ("cut.npz", "it is not a usable .npz"),
        ("short.npy", "incomplete or damaged"),
        ("nothing.npy", "cannot read"),
    ] {
        let path = text(&world.path(name));
        world
            .bench("3.1", &format!("out-{name}"), &["--predictions", &path])
            .code(1)
            .says(sentence);
    }
    let pp = text(&world.path("odd.npy"));
    describe("odd", fraction);
    let more = ["--predictions", &pp, "--protocol", "kitti2015-pp"];
    world
        .bench("3.1", "pp", &more)
        .code(1)
        .says("kitti2015-pp needs predictions of mirrored images");
    assert_eq!(world.rows("pp").len(), 2);
}

/// The record of a run without what is of one run alone: its command line and how long it took.
fn record_of_any(world: &World, out: &str) -> serde_yaml::Value {
    let mut record: serde_yaml::Value = yaml::load(&world.path(out).join("run.yaml")).unwrap();
    record["arguments"] = serde_yaml::Value::Null;
    for model in record["models"].as_sequence_mut().unwrap() {
        model["seconds"] = serde_yaml::Value::Null;
    }
    record
}

#[test]
fn parts_merge_into_the_bytes_of_one_run() {
    let world = World::new(Split::Kitti, 11, true);
    // Both are of another scale, which is said after the first images.
    let model = write_model(world.folder.path(), "looks", 0.06, 0.15, "kitti");
    let other = write_model(world.folder.path(), "other", 0.02, 0.0, "kitti");
    fs::write(world.path("set/f/000004.png"), b"not what was prepared").unwrap();
    fs::remove_file(world.path("set/noc/000007.exr")).unwrap();
    let asked = ["--model", &text(&model), "--model", &text(&other)];
    let whole = world.bench("all", "whole", &asked);
    whole.code(1);
    let part = |shard: &str, asked: &[&str]| {
        let more = [asked, &["--shard", shard]].concat();
        world.bench("all", "parts", &more)
    };
    merge(&world, "parts").code(1).says("cannot be used");
    for shard in ["0/3", "2/3"] {
        assert_eq!(part(shard, &asked).out, "");
    }
    merge(&world, "parts")
        .code(1)
        .says("1 of 3 parts")
        .says("--shard 1/3");
    part("1/3", &asked[..2]);
    merge(&world, "parts")
        .code(1)
        .says("parts 0/3 and 1/3")
        .says("the list of models");
    let threads = [&asked[..], &["--threads", "1"]].concat();
    part("1/3", &threads);
    merge(&world, "parts")
        .code(1)
        .says("of model looks, threads within the model was 2 and is 1");
    part("1/3", &asked);
    let merged = merge(&world, "parts");
    merged.code(1).says("failures.csv");
    assert_eq!(merged.out, whole.out);
    same_results(&world, "whole", "parts");
    for file in ["failures.csv", "table_3_2.txt"] {
        let of = |out: &str| fs::read_to_string(world.path(out).join(file)).unwrap();
        assert_eq!(of("whole"), of("parts"), "{file}");
    }
    assert!(!world.path("parts/parts").exists());
    // What is said of the models is said of all images and of the first ones of the whole.
    let records = ["whole", "parts"].map(|out| record_of_any(&world, out));
    assert_eq!(records[0], records[1]);
    let said = |ran: &Ran| -> Vec<String> {
        let own = |line: &&str| line.contains("warning: ") || line.contains("true/predicted");
        let lines = ran.err.lines().filter(own);
        // Once for each model is said while it is measured.
        lines
            .filter(|line| !line.contains("LEAKAGE"))
            .map(str::to_owned)
            .collect()
    };
    assert!(said(&whole).len() >= 4, "{:?}", said(&whole));
    assert_eq!(said(&whole), said(&merged));
    let record = fs::read_to_string(world.path("parts/run.yaml")).unwrap();
    assert!(record.contains("images: 9"), "{record}");
    part("3/3", &asked).code(2).says("the last of 3 is 2/3");
}

/// Images are decoded and scored side by side, and only the model's own threads divide a sum.
#[test]
fn rows_do_not_depend_on_the_number_of_jobs() {
    let world = World::new(Split::Kitti, 9, true);
    let model = text(&write_model(world.folder.path(), "m", 0.02, 0.05, "eigen"));
    // With the runtime that a user has.
    let runtimes = match onnxruntime() {
        Some(_) => vec!["embedded", "ort"],
        None => vec!["embedded"],
    };
    for runtime in runtimes {
        let rows = |jobs: &str| {
            let out = format!("{runtime}-{jobs}");
            let more = ["--model", &model, "--runtime", runtime, "--jobs", jobs];
            world.bench("all", &out, &more).code(0);
            fs::read(world.path(&out).join("rows.csv")).unwrap()
        };
        let one = rows("1");
        assert!(one == rows("2") && one == rows("4"), "{runtime}");
    }
}

#[test]
fn an_interrupted_run_goes_on_and_ends_the_same() {
    let world = World::new(Split::Kitti, 12, true);
    let model = write_model(world.folder.path(), "looks", 0.02, 0.05, "kitti");
    let asked = ["--model", &text(&model)];
    world.bench("all", "whole", &asked).code(0);
    let left_over = |out: &str| {
        let names = fs::read_dir(world.path(out)).unwrap();
        let mut names = names.map(|entry| entry.unwrap().file_name().into_string().unwrap());
        names.any(|name| name.starts_with("unfinished"))
    };
    assert!(!left_over("whole"));
    // What a killed run leaves: eleven images, of which the last could be there in part.
    let interrupt = || {
        let mut process = Command::cargo_bin("bench").unwrap();
        process
            .args(["--table", "all", "--runtime", "embedded", "--data"])
            .arg(world.path("set"))
            .arg("--out")
            .arg(world.path("again"))
            .args(asked)
            .env(fault::AT, KILLED_AT);
        assert!(!process.output().unwrap().status.success());
    };
    let place = world.path("again/unfinished-looks.csv");
    interrupt();
    // The first eight are measured again, since they are what is suspected of a model.
    world
        .bench("all", "again", &asked)
        .code(0)
        .says("2 of 12 images were measured before");
    same_results(&world, "whole", "again");
    same_findings(&world, "whole", "again");
    assert!(!left_over("again"));
    // A sum divided among more threads may be another one.
    interrupt();
    let threads = [&asked[..], &["--threads", "1"]].concat();
    world
        .bench("all", "again", &threads)
        .code(0)
        .says("is measured again")
        .says("threads within the model was 2 and is 1");
    // Rows of which nobody knows what they were measured with are no rows.
    interrupt();
    fs::remove_file(place.with_extension("yaml")).unwrap();
    let ran = world.bench("all", "again", &asked);
    assert!(!ran.code(0).err.contains("measured before"), "{}", ran.err);
    // Another model is not mixed in, whatever it is called.
    interrupt();
    let other = write_model(world.folder.path(), "other", 0.05, 0.0, "kitti");
    let renamed = format!("looks={}", text(&other));
    world
        .bench("all", "again", &["--model", &renamed])
        .code(2)
        .says("results of another file under the name looks");
    let ran = world.bench("all", "again", &["--model", &renamed, "--force"]);
    assert!(!ran.code(0).err.contains("measured before"), "{}", ran.err);
}

/// Kills real processes. By default few of them; `STRAT_KILLS=50` for more.
#[test]
fn killed_at_any_moment_the_next_run_completes_it() {
    let kills: u64 = std::env::var("STRAT_KILLS").map_or(3, |kills| kills.parse().unwrap());
    let world = World::new(Split::Kitti, 40, false);
    let model = write_model(world.folder.path(), "looks", 0.02, 0.05, "kitti");
    world
        .bench("3.1", "whole", &["--model", &text(&model)])
        .code(0);
    let rows = fs::read_to_string(world.path("whole/rows.csv"))
        .unwrap()
        .len();
    for kill in 0..kills {
        let mut process = Process::new(assert_cmd::cargo::cargo_bin("bench"))
            .args([
                "--table",
                "3.1",
                "--runtime",
                "embedded",
                "--quiet",
                "--data",
            ])
            .arg(world.path("set"))
            .arg("--out")
            .arg(world.path("killed"))
            .arg("--model")
            .arg(&model)
            .stdout(Stdio::null())
            .spawn()
            .unwrap();
        // Killed when the journal has grown to a share of the rows, not after some time.
        let wanted = rows as u64 * (kill + 1) / (kills + 1);
        let journal = world.path("killed/unfinished-looks.csv");
        while fs::metadata(&journal).map_or(0, |file| file.len()) < wanted {
            if process.try_wait().unwrap().is_some() {
                break;
            }
            std::thread::yield_now();
        }
        process.kill().unwrap();
        process.wait().unwrap();
    }
    world
        .bench("3.1", "killed", &["--model", &text(&model)])
        .code(0);
    same_results(&world, "whole", "killed");
    same_findings(&world, "whole", "killed");
}

/// A network of TensorFlow's layout: the convolution sees rows as channels, so that one by one it
/// leaves everything where it is.
#[test]
fn both_layouts_see_the_same_picture() {
    let world = World::new(Split::Kitti, 3, false);
    let (height, width) = (INPUT_HEIGHT as usize, INPUT_WIDTH as usize);
    let one_by_one =
        |inputs: usize, outputs: usize, picks: fn(usize, usize) -> bool, dims: [usize; 3]| {
            let mut graph = GraphBuilder::new("layout");
            let [a, b, c] = dims;
            let dims = ["N".into(), a.into(), b.into(), c.into()];
            let image = graph.input("image", &dims).unwrap();
            let weight = |at: usize| {
                if picks(at / inputs, at % inputs) {
                    0.05
                } else {
                    0.0
                }
            };
            let filter = Filter {
                shape: [outputs, inputs, 1, 1],
                weights: (0..inputs * outputs).map(weight).collect(),
                bias: vec![0.02; outputs],
            };
            let out = graph
                .conv("conv", image, filter, Geometry::new(1, 0))
                .unwrap();
            graph.output("disparity", out).unwrap();
            graph.finish(None).unwrap()
        };
    let first = one_by_one(3, 3, |o, i| o == i, [3, height, width]);
    let last = one_by_one(height, height, |o, i| o == i, [height, width, 3]);
    fs::write(world.path("nchw.onnx"), first).unwrap();
    fs::write(world.path("nhwc.onnx"), last).unwrap();
    for layout in ["nchw", "nhwc"] {
        let description = format!(
            "input: {{width: {width}, height: {height}, range: 0..1, layout: {layout}}}\n\
             output: {{meaning: disparity_fraction, channel: 1, layout: {layout}}}\n"
        );
        fs::write(world.path(&format!("{layout}.yaml")), description).unwrap();
        let path = text(&world.path(&format!("{layout}.onnx")));
        let more = ["--model", &path, "--protocol", "kitti2015-pp"];
        world.bench("3.1", layout, &more).code(0);
    }
    let (a, b) = (world.rows("nchw"), world.rows("nhwc"));
    assert_eq!(a.len(), 6);
    for (a, b) in a.iter().zip(&b) {
        let (a, b) = (a.score.metrics.to_array(), b.score.metrics.to_array());
        for (a, b) in a.into_iter().zip(b) {
            assert!((a - b).abs() < 1e-6, "{a} and {b}");
        }
    }
    // The wrong layout is a sentence, and so is a map of the wrong rank.
    let yaml = fs::read_to_string(world.path("nchw.yaml")).unwrap();
    fs::write(
        world.path("nchw.yaml"),
        yaml.replace("0..1, layout: nchw", "0..1, layout: nhwc"),
    )
    .unwrap();
    let path = text(&world.path("nchw.onnx"));
    world
        .bench("3.1", "wrong", &["--model", &path])
        .code(1)
        .says("does not fit its description")
        .says("layout: nchw");
    fs::write(
        world.path("nchw.yaml"),
        yaml.replace("channel: 1", "channel: 3"),
    )
    .unwrap();
    world
        .bench("3.1", "channel", &["--model", &path])
        .code(1)
        .says("has the shape [1, 3, 16, 32], but [1, 4 or more, height, width] is needed");
}

#[test]
fn an_output_of_zeros_is_counted_and_called_dead() {
    let world = World::new(Split::Kitti, 2, false);
    let path = world.path("zero.onnx");
    fs::write(
        &path,
        network(0.0, 0.0, Some(&crate::fixtures::metadata("kitti"))),
    )
    .unwrap();
    world
        .bench("3.1", "out", &["--model", &text(&path)])
        .code(0)
        .says("7440 of 7440 pixels scored under kitti2015")
        .says("DEAD OUTPUT: model zero gives no disparity above the floor in 2 of 2 images");
}
