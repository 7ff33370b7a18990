//! The `bench` command from outside: files in, tables and exit codes out.

use std::collections::BTreeSet;
use std::fs;

use assert_cmd::Command;
use strat_metrics::Row;
use strat_onnx::metadata::Probe;
use strat_splits::Split;

use crate::command::{bench, run, text};
use crate::fixtures::{
    INPUT_HEIGHT, INPUT_WIDTH, metadata, network, onnxruntime, write_model, write_set,
};
use crate::npy;
use crate::world::World;

#[test]
fn a_constant_prediction_scores_what_is_worked_out_by_hand() {
    let world = World::new(Split::Kitti, 3, false);
    // 4 % of the width where 6.199 px of 124 px are true.
    let model = write_model(world.folder.path(), "four", 0.04, 0.0, "kitti");
    let ran = world.bench("3.1", "out", &["--model", &text(&model)]);
    ran.code(0).says("note: 3 of 200 test images");
    assert!(ran.out.contains("3 of 200 images"), "{}", ran.out);
    assert!(ran.out.contains("published"), "{}", ran.out);

    let truth_px = crate::fixtures::DISPARITY_PX;
    let predicted_px = 0.04 * 124.0;
    // Depth is proportional to 1 / disparity.
    let abs_rel = (1.0 - truth_px / predicted_px).abs();
    let depth_m = crate::fixtures::FOCAL_PX * 0.54 / truth_px;
    let rows = world.rows("out");
    assert_eq!(rows.len(), 3);
    for row in &rows {
        let m = row.score.metrics;
        assert!((m.abs_rel - abs_rel).abs() < 1e-6, "{}", m.abs_rel);
        assert!((m.sq_rel - abs_rel * abs_rel * depth_m).abs() < 1e-5);
        assert!((m.rmse - abs_rel * depth_m).abs() < 1e-5, "{}", m.rmse);
        assert!((m.rmse_log - (truth_px / predicted_px).ln()).abs() < 1e-6);
        // A ratio of 1.2498.
        assert_eq!([m.a1, m.a2, m.a3], [1.0, 1.0, 1.0]);
        assert_eq!(row.score.d1_all, Some(0.0));
        assert_eq!(row.score.pixels, 124 * 30);
        assert_eq!(row.context.provider, "rten CPU");
        assert_eq!(row.context.variant.as_deref(), Some("strat"));
    }
    let images: Vec<&str> = rows.iter().map(|row| row.image.as_str()).collect();
    assert_eq!(
        images,
        ["kitti2015/000000", "kitti2015/000001", "kitti2015/000002"]
    );
    for file in [
        "table_3_1.txt",
        "table_3_1.md",
        "table_3_1.tex",
        "table_3_1.csv",
        "leaderboard.csv",
        "run.yaml",
    ] {
        assert!(world.path("out").join(file).is_file(), "{file}");
    }
    assert!(!world.path("out/failures.csv").exists());
    let record = fs::read_to_string(world.path("out/run.yaml")).unwrap();
    assert!(record.contains("probe_max_difference: 0"), "{record}");
    let first = ran.out.lines().next().unwrap();
    let file = fs::read_to_string(world.path("out/table_3_1.txt")).unwrap();
    assert!(file.starts_with(first));
}

#[test]
fn threads_do_not_change_a_byte() {
    let world = World::new(Split::Kitti, 9, true);
    let model = write_model(world.folder.path(), "looks", 0.02, 0.05, "kitti");
    let other = write_model(world.folder.path(), "other", 0.05, 0.0, "kitti");
    for (out, jobs) in [("one", "1"), ("three", "3")] {
        let more = [
            "--model",
            &text(&model),
            "--model",
            &format!("Second={}", text(&other)),
            "--jobs",
            jobs,
            "--quiet",
        ];
        let ran = world.bench("all", out, &more);
        ran.code(0);
        assert_eq!(ran.err, "");
    }
    for file in [
        "rows.csv",
        "leaderboard.csv",
        "table_3_1.csv",
        "table_3_2.txt",
    ] {
        let of = |out: &str| fs::read(world.path(out).join(file)).unwrap();
        assert!(of("one") == of("three"), "{file} depends on the threads");
    }
    let rows = world.rows("one");
    // 9 images: one row each for table 3.1, two groups each for table 3.2, two models.
    assert_eq!(rows.len(), 2 * (9 + 18));
    // The network that looks at the picture sees different ones.
    let looks = |image: usize| rows[image].score.metrics.abs_rel;
    assert_ne!(looks(0), looks(8));
}

#[test]
fn the_eigen_tables_come_from_one_pass() {
    let world = World::new(Split::Eigen, 2, false);
    // Exactly the true disparity: 72 px * 0.5 m / 10 m = 3.6 px of 124 px.
    let model = write_model(world.folder.path(), "right", 3.6 / 124.0, 0.0, "eigen");
    let ran = world.bench("3.3", "out", &["--model", &text(&model)]);
    ran.code(0);
    let rows = world.rows("out");
    let protocols: Vec<&str> = rows
        .iter()
        .map(|row| row.context.protocol.as_str())
        .collect();
    assert_eq!(protocols, ["eigen-80", "eigen-80", "eigen-50", "eigen-50"]);
    for row in &rows {
        assert!(row.score.metrics.abs_rel < 1e-6);
    }
    let more = ["--model", &text(&model), "--protocol", "eigen-cameraz-80"];
    let ran = world.bench("3.3", "more", &more);
    let told = &ran.code(0).out;
    // What no table shows is told beside them; 0.25 / 9.75 is 0.026.
    let line = told
        .lines()
        .find(|line| line.contains("under eigen-cameraz-80"));
    let line = line.unwrap_or_else(|| panic!("{told}"));
    assert!(line.contains("2 of 697 images: Abs Rel 0.026"), "{line}");
    assert!(!told.contains("under eigen-80,"), "{told}");
    let camera = world.rows("more").pop().unwrap();
    assert_eq!(camera.context.protocol, "eigen-cameraz-80");
    let expected = 0.25 / 9.75;
    assert!((camera.score.metrics.abs_rel - expected).abs() < 1e-6);
}

#[test]
fn flip_post_processing_leaves_the_plain_rows_alone() {
    let world = World::new(Split::Kitti, 2, false);
    let looks = write_model(world.folder.path(), "looks", 0.02, 0.1, "kitti");
    let even = write_model(world.folder.path(), "even", 0.04, 0.0, "kitti");
    let models = ["--model", &text(&looks), "--model", &text(&even)];
    world.bench("3.1", "plain", &models).code(0);
    let mut more = models.to_vec();
    more.extend(["--protocol", "kitti2015-pp"]);
    world.bench("3.1", "both", &more).code(0);
    let of = |out: &str, model: &str, protocol: &str| -> Vec<Row> {
        let mut rows = world.rows(out);
        rows.retain(|row| row.context.model == model && row.context.protocol == protocol);
        assert_eq!(rows.len(), 2);
        rows
    };
    for model in ["looks", "even"] {
        assert_eq!(
            of("plain", model, "kitti2015"),
            of("both", model, "kitti2015")
        );
    }
    let rmse = |rows: &[Row]| rows[0].score.metrics.rmse;
    let (plain, flipped) = (
        of("both", "looks", "kitti2015"),
        of("both", "looks", "kitti2015-pp"),
    );
    assert!((rmse(&plain) - rmse(&flipped)).abs() > 1e-3);
    // The mirrored picture of a network that ignores pictures changes nothing.
    let (plain, flipped) = (
        of("both", "even", "kitti2015"),
        of("both", "even", "kitti2015-pp"),
    );
    assert!((rmse(&plain) - rmse(&flipped)).abs() < 1e-6);
}

#[test]
fn the_median_baseline_is_the_median_of_the_scans() {
    let world = World::new(Split::Eigen, 2, false);
    world.bench("3.3", "out", &["--median-baseline"]).code(0);
    let rows = world.rows("out");
    assert_eq!(rows.len(), 4);
    for row in &rows {
        assert_eq!(row.context.model, "Median depth (constant)");
        // The training scans are 8 m, 10 m and 12 m away, the test scans 10 m.
        assert!(
            row.score.metrics.abs_rel < 1e-6,
            "{}",
            row.score.metrics.abs_rel
        );
    }
    let kitti = World::new(Split::Kitti, 2, false);
    kitti
        .bench("3.1", "out", &["--median-baseline"])
        .code(1)
        .says("--train-depth");
}

/// A constant map of another set shows what a model that was trained there could know without looking.
#[test]
fn the_median_baseline_can_come_from_another_set() {
    let world = World::new(Split::Kitti, 2, false);
    // Its scans are 10 m away in the median, and the stereo images everywhere 72 * 0.54 / 6.199 m.
    write_set(&world.path("scanned"), Split::Eigen, 1, false);
    let from = text(&world.path("scanned"));
    let named = format!("world={from}");
    let more = [
        "--median-baseline-from",
        &from,
        "--median-baseline-from",
        &named,
    ];
    let ran = world.bench("3.1", "out", &more);
    ran.code(0);
    assert!(!ran.err.contains("LEAKAGE"), "{}", ran.err);
    let rows = world.rows("out");
    let names: Vec<&str> = rows.iter().map(|row| row.context.model.as_str()).collect();
    let (own, given) = ("Median depth (scanned)", "Median depth (world)");
    assert_eq!(names, [own, own, given, given]);
    let truth_m = crate::fixtures::FOCAL_PX * 0.54 / crate::fixtures::DISPARITY_PX;
    for row in &rows {
        let abs_rel = (10.0 - truth_m) / truth_m;
        assert!(
            (row.score.metrics.abs_rel - abs_rel).abs() < 1e-5,
            "{} instead of {abs_rel}",
            row.score.metrics.abs_rel
        );
    }
    let record = fs::read_to_string(world.path("out/run.yaml")).unwrap();
    assert!(record.contains("3 of 3 training scans"), "{record}");
    assert!(
        record.contains("scanned (eigen, rendered, data "),
        "{record}"
    );

    // The same again replaces the same.
    world.bench("3.1", "out", &more).code(0);
    let nothing = text(&world.path("set"));
    let more = ["--median-baseline-from", &nothing];
    world
        .bench("3.1", "none", &more)
        .code(1)
        .says("--train-depth");
    let more = ["--median-baseline-from", "nowhere"];
    world
        .bench("3.1", "none", &more)
        .code(1)
        .says("folder not found");
    let constant = format!("constant={from}");
    let more = ["--median-baseline", "--median-baseline-from", &constant];
    world.bench("3.1", "none", &more).code(2).says("NAME=DIR");
}

#[test]
fn saved_predictions_are_what_the_network_gave() {
    let world = World::new(Split::Kitti, 3, false);
    let model = write_model(world.folder.path(), "four", 0.04, 0.0, "kitti");
    let more = [
        "--model",
        &text(&model),
        "--save-predictions",
        "--pictures",
        "2",
    ];
    world.bench("3.1", "out", &more).code(0);
    let (shape, values) = npy::read(&world.path("out/predictions.npy"));
    assert_eq!(shape, [3, INPUT_HEIGHT as usize, INPUT_WIDTH as usize]);
    assert!(values.iter().all(|&value| value == 0.04));
    let ids = fs::read_to_string(world.path("out/predictions.ids.txt")).unwrap();
    assert_eq!(ids.lines().count(), 3);
    let pictures = fs::read_dir(world.path("out/pictures/four")).unwrap();
    assert_eq!(pictures.count(), 2);
}

#[test]
fn both_runtimes_give_the_same_table() {
    if onnxruntime().is_none() {
        return;
    }
    let world = World::new(Split::Kitti, 3, true);
    let model = write_model(world.folder.path(), "looks", 0.02, 0.05, "kitti");
    for runtime in ["ort", "embedded"] {
        let more = ["--model", &text(&model), "--runtime", runtime];
        let ran = world.bench("all", runtime, &more);
        ran.code(0)
            .says("largest difference to the trainer's own output");
    }
    let (ort, embedded) = (world.rows("ort"), world.rows("embedded"));
    assert_eq!(ort.len(), embedded.len());
    for (a, b) in ort.iter().zip(&embedded) {
        assert_eq!((&a.image, a.score.group), (&b.image, b.score.group));
        assert_eq!(a.context.provider, "CPUExecutionProvider");
        let difference = (a.score.metrics.rmse - b.score.metrics.rmse).abs();
        assert!(difference < 1e-4, "{difference}");
    }
}

#[test]
fn broken_models_are_sentences_and_the_good_one_counts() {
    let world = World::new(Split::Kitti, 2, false);
    let good = write_model(world.folder.path(), "good", 0.04, 0.0, "kitti");
    let bytes = fs::read(&good).unwrap();
    fs::write(world.path("garbage.onnx"), b"this is no model").unwrap();
    fs::write(world.path("cut.onnx"), &bytes[..bytes.len() / 2]).unwrap();
    fs::write(
        world.path("pointer.onnx"),
        b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n",
    )
    .unwrap();
    fs::write(world.path("foreign.onnx"), network(0.04, 0.0, None)).unwrap();
    let mut more = Vec::new();
    for name in ["garbage", "cut", "pointer", "foreign", "missing", "good"] {
        more.push("--model".to_owned());
        more.push(text(&world.path(&format!("{name}.onnx"))));
    }
    let more: Vec<&str> = more.iter().map(String::as_str).collect();
    let ran = world.bench("3.1", "out", &more);
    ran.code(1)
        .says("model garbage: ")
        .says("is not a complete ONNX model")
        .says("model cut: ")
        .says("git lfs pull")
        .says("is missing")
        .says("model missing: cannot read the model");
    assert_eq!(world.rows("out").len(), 2);
    assert!(ran.out.contains("good"), "{}", ran.out);
}

#[test]
fn a_network_of_nan_has_no_row() {
    let world = World::new(Split::Kitti, 3, false);
    let path = world.path("nan.onnx");
    fs::write(&path, network(f32::NAN, 0.0, Some(&metadata("kitti")))).unwrap();
    world
        .bench("3.1", "out", &["--model", &text(&path)])
        .code(1)
        .says("is not a number at row 0, column 0 (512 of 512 values are NaN or infinite)")
        .says("nothing could be measured");
    let failures = fs::read_to_string(world.path("out/failures.csv")).unwrap();
    assert_eq!(failures.lines().count(), 4);
}

#[test]
fn a_hopeless_run_is_given_up() {
    let world = World::new(Split::Kitti, 60, false);
    let path = world.path("nan.onnx");
    fs::write(&path, network(f32::NAN, 0.0, Some(&metadata("kitti")))).unwrap();
    let more = ["--model", &text(&path), "--jobs", "2"];
    world
        .bench("3.1", "out", &more)
        .code(1)
        .says("the rest was not tried");
    let failures = fs::read_to_string(world.path("out/failures.csv")).unwrap();
    assert!(failures.lines().count() < 30, "{failures}");
}

#[test]
fn a_damaged_image_costs_itself_only() {
    let world = World::new(Split::Kitti, 4, false);
    let model = write_model(world.folder.path(), "four", 0.04, 0.0, "kitti");
    fs::write(world.path("set/f/000001.png"), b"not what was prepared").unwrap();
    fs::remove_file(world.path("set/noc/000003.exr")).unwrap();
    let ran = world.bench("3.1", "out", &["--model", &text(&model)]);
    ran.code(1)
        .says("image kitti2015/000001: f/000001.png has changed since the set was prepared")
        .says("image kitti2015/000003: cannot read")
        .says("failures.csv");
    assert!(ran.out.contains("2 of 200 images"), "{}", ran.out);
    assert_eq!(world.rows("out").len(), 2);
    let failures = fs::read_to_string(world.path("out/failures.csv")).unwrap();
    assert!(failures.contains("kitti2015/000001"), "{failures}");
}

#[test]
fn leakage_and_a_failing_probe_are_shouted() {
    let world = World::new(Split::Kitti, 2, false);
    let path = world.path("wrong.onnx");
    let mut metadata = metadata("eigen");
    let other = vec![0.5; 2 * (INPUT_WIDTH * INPUT_HEIGHT) as usize];
    metadata.probe = Some(Probe::record(INPUT_WIDTH, INPUT_HEIGHT, &other).unwrap());
    fs::write(&path, network(0.04, 0.0, Some(&metadata))).unwrap();
    world
        .bench("3.1", "out", &["--model", &text(&path), "--quiet"])
        .code(0)
        .says("LEAKAGE: model wrong was trained on the eigen split")
        .says("PROBE FAILED: model wrong on rten CPU differs");
    let record = fs::read_to_string(world.path("out/run.yaml")).unwrap();
    assert!(record.contains("LEAKAGE"), "{record}");
    // Whatever else is done with such a model.
    let (set, out) = (text(&world.path("set")), text(&world.path("figures")));
    let model = text(&path);
    let own = ["--data", &set, "--model", &model, "--out", &out];
    let ran = bench(&[&["figures", "--runtime", "embedded"][..], &own].concat());
    ran.code(0)
        .says("LEAKAGE: model wrong was trained on the eigen split")
        .says("PROBE FAILED: model wrong on rten CPU differs");
    let (images, out) = (text(&world.path("set/f")), text(&world.path("maps")));
    let own = ["--model", &model, "--out", &out, "--format", "npy", &images];
    bench(&[&["predict", "--runtime", "embedded"][..], &own].concat())
        .code(0)
        .says("PROBE FAILED: model wrong on rten CPU differs");
}

#[test]
fn a_foreign_model_is_read_with_its_description() {
    let world = World::new(Split::Kitti, 2, false);
    let model = world.path("other.onnx");
    // Disparity in pixels of the input: 0.04 of 32 columns.
    fs::write(&model, network(0.04 * INPUT_WIDTH as f32, 0.0, None)).unwrap();
    let description = |meaning: &str| {
        format!(
            "input: {{width: {INPUT_WIDTH}, height: {INPUT_HEIGHT}, range: 0..1}}\n\
             output: {{meaning: {meaning}}}\n"
        )
    };
    let yaml = world.path("other.yaml");
    let more = ["--model", &text(&model)];

    fs::write(&yaml, description("disparity_px")).unwrap();
    world
        .bench("3.1", "px", &more)
        .code(0)
        .says("leakage cannot be");
    let expected = (1.0 - crate::fixtures::DISPARITY_PX / (0.04 * 124.0)).abs();
    let abs_rel = world.rows("px")[0].score.metrics.abs_rel;
    assert!((abs_rel - expected).abs() < 1e-6, "{abs_rel}");

    // A constant of unknown scale is perfect once it is scaled.
    fs::write(&yaml, description("inverse_depth")).unwrap();
    world
        .bench("3.1", "inverse", &more)
        .code(0)
        .says("unknown scale");
    let row = world.rows("inverse").remove(0);
    assert_eq!(row.context.protocol, "kitti2015-median");
    assert!(row.score.metrics.abs_rel < 1e-6);
    assert!(world.path("inverse/table_3_1-median.txt").is_file());
    // Asked for with the suffix as well, and in two orders: one protocol each, also the second time.
    let suffixes = ["-median", "-median-pp", "-pp-median"].map(|s| format!("kitti2015{s}"));
    let mut asked = more.to_vec();
    for name in &suffixes {
        asked.extend(["--protocol", name]);
    }
    for _ in 0..2 {
        world.bench("3.1", "asked", &asked).code(0);
        let rows = world.rows("asked");
        let names: BTreeSet<_> = rows.iter().map(|row| &row.context.protocol).collect();
        assert_eq!(
            Vec::from_iter(names),
            ["kitti2015-median", "kitti2015-pp-median"]
        );
        assert_eq!(rows.len(), 4, "two images each");
    }

    // 1.28 m where 6.27 m are true.
    fs::write(&yaml, description("depth_m")).unwrap();
    world.bench("3.1", "depth", &more).code(0);
    let saving = ["--model", &text(&model), "--save-predictions"];
    world
        .bench("3.1", "saving", &saving)
        .code(1)
        .says("leave out --save-predictions");
    let true_m = crate::fixtures::FOCAL_PX * 0.54 / crate::fixtures::DISPARITY_PX;
    let expected = (true_m - 0.04 * f64::from(INPUT_WIDTH)) / true_m;
    let abs_rel = world.rows("depth")[0].score.metrics.abs_rel;
    assert!((abs_rel - expected).abs() < 1e-6, "{abs_rel}");

    fs::write(&yaml, description("disparity_miles")).unwrap();
    world
        .bench("3.1", "miles", &more)
        .code(1)
        .says("other.yaml");
}

#[test]
fn wrong_requests_end_with_code_2() {
    let eigen = World::new(Split::Eigen, 1, false);
    let model = write_model(eigen.folder.path(), "m", 0.04, 0.0, "eigen");
    let more = ["--model", &text(&model)];
    eigen
        .bench("3.1", "out", &more)
        .code(2)
        .says("table 3.1 is about the kitti split");
    assert!(!eigen.path("out").exists());
    let kitti = World::new(Split::Kitti, 1, false);
    kitti.bench("3.3", "out", &more).code(2).says("eigen");
    kitti.bench("3.2", "out", &more).code(2).says("--semantics");
    kitti
        .bench(
            "3.1",
            "out",
            &["--median-baseline", "--protocol", "nonsense"],
        )
        .code(2)
        .says("bench protocols");
    kitti.bench("9.9", "out", &more).code(2).says("3.1");
    let twice = ["--model", &text(&model), "--model", &text(&model)];
    kitti
        .bench("3.1", "out", &twice)
        .code(2)
        .says("two models are called");
    kitti
        .bench("3.1", "out", &[])
        .code(2)
        .says("nothing to measure");
    let bare = run(&mut Command::cargo_bin("bench").unwrap());
    assert_eq!(bare.code, 2);
}

#[test]
fn a_missing_or_unfinished_set_is_named() {
    let world = World::new(Split::Kitti, 1, false);
    fs::remove_file(world.path("set/manifest.yaml")).unwrap();
    world
        .bench("3.1", "out", &["--median-baseline"])
        .code(2)
        .says("is not a finished prepared set");
    fs::remove_dir_all(world.path("set")).unwrap();
    world
        .bench("3.1", "out", &["--median-baseline"])
        .code(2)
        .says("folder not found");
}

#[test]
fn an_output_folder_that_cannot_be_is_found_before_the_work() {
    let world = World::new(Split::Kitti, 1, false);
    fs::write(world.path("out"), b"a file").unwrap();
    world
        .bench("3.1", "out", &["--median-baseline"])
        .code(2)
        .says("out");
}

#[test]
fn cuda_without_a_device_is_a_sentence() {
    let world = World::new(Split::Kitti, 1, false);
    let model = write_model(world.folder.path(), "m", 0.04, 0.0, "kitti");
    let more = ["--model", &text(&model), "--device", "cuda"];
    // The embedded runtime never has CUDA, whatever the machine.
    world.bench("3.1", "out", &more).code(1).says("CPU only");
    assert!(!world.path("out/rows.csv").exists());
}

#[test]
fn without_a_library_auto_says_so_in_one_line() {
    let world = World::new(Split::Kitti, 1, false);
    let model = write_model(world.folder.path(), "m", 0.04, 0.0, "kitti");
    let mut command = Command::cargo_bin("bench").unwrap();
    command
        .args(["--table", "3.1", "--quiet", "--data"])
        .arg(world.path("set"))
        .arg("--out")
        .arg(world.path("out"))
        .arg("--model")
        .arg(&model)
        .env("ORT_DYLIB_PATH", world.path("nowhere.so"));
    let ran = run(&mut command);
    ran.code(0).says("`bench setup`");
    assert_eq!(ran.err.lines().count(), 1, "{}", ran.err);
    let ran = run(command.args(["--runtime", "ort"]));
    ran.code(1).says("ONNX Runtime was not found");
}

#[test]
fn setup_without_python_says_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let mut command = Command::cargo_bin("bench").unwrap();
    let ran = run(command
        .args(["setup", "--dir"])
        .arg(folder.path().join("home"))
        .env("PATH", folder.path()));
    ran.code(1).says("python3 was not found");
}

#[test]
fn protocols_are_listed_and_stated() {
    let list = run(Command::cargo_bin("bench").unwrap().arg("protocols"));
    list.code(0);
    for name in ["kitti2015", "semantic", "eigen-80", "eigen-50"] {
        assert!(list.out.contains(name), "{}", list.out);
    }
    let one = run(Command::cargo_bin("bench")
        .unwrap()
        .args(["protocols", "eigen-50"]));
    one.code(0);
    assert!(one.out.contains("Garg"), "{}", one.out);
    let none = run(Command::cargo_bin("bench")
        .unwrap()
        .args(["protocols", "eigen-51"]));
    none.code(2);
}
