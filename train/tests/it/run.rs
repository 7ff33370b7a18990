//! Whole runs on a tiny set: resuming, learning, stopping, damaged files.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use strat_onnx::metadata::Weights;
use strat_train::config::{Config, Preset, Sharing};
use strat_train::device::DeviceChoice;
use strat_train::network::initial_weights::InitialWeights;
use strat_train::training::folder::RunInfo;
use strat_train::training::model::{export_discriminator, export_run};
use strat_train::training::options::{Options, Outcome};
use strat_train::training::run::run;
use strat_train::training::trainer::Trainer;

const SMALL: [&str; 6] = [
    "network.width=1/32",
    "discriminator.width=1/16",
    "epochs=3",
    "batch=2",
    "pictures.every=0",
    "learning_rate=0.001",
];

fn options(root: &Path, out: &str, settings: &[&str]) -> Options {
    let settings: Vec<String> = SMALL
        .iter()
        .chain(settings)
        .map(|setting| (*setting).to_owned())
        .collect();
    Options {
        config: Config::resolve("kitti-strat", Some(Preset::Tiny), &settings).unwrap(),
        data: root.join("set"),
        out: root.join(out),
        device: DeviceChoice::Cpu,
        replicas: Vec::new(),
        resume: false,
        force: false,
        quiet: true,
        ignore_memory: false,
        no_check: false,
        stop: Arc::new(AtomicBool::new(false)),
    }
}

fn set() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    crate::prepared::write(&folder.path().join("set"), 7, 3);
    folder
}

fn bytes(folder: &Path, name: &str) -> Vec<u8> {
    std::fs::read(folder.join(name)).unwrap()
}

fn go(options: &Options) -> Outcome {
    run(options).unwrap_or_else(|error| panic!("{error}"))
}

/// Everything a run computes: the weights (in the model) and every number of every step.
fn assert_same_run(a: &Path, b: &Path) {
    for name in ["scalars.csv", "validation.csv", "diagnostics.csv"] {
        assert_eq!(
            String::from_utf8(bytes(a, name)).unwrap(),
            String::from_utf8(bytes(b, name)).unwrap()
        );
    }
    assert!(bytes(a, "model.onnx") == bytes(b, "model.onnx"));
}

#[test]
fn a_resumed_run_equals_an_uninterrupted_one_bit_for_bit() {
    let folder = set();
    for (name, settings) in [
        ("strat", &[][..]),
        ("random", &["variant=random", "accumulate=2", "batch=1"][..]),
        ("noadv", &["variant=no-adv"][..]),
        ("per-view", &["discriminator.sharing=per-view"][..]),
    ] {
        let whole = options(folder.path(), &format!("{name}-whole"), settings);
        let outcome = go(&whole);
        assert_eq!((outcome.steps, outcome.planned), (9, 9));

        // Stopped in the middle of the second epoch, with the prefetched batches thrown away.
        let mut parts = options(folder.path(), &format!("{name}-parts"), settings);
        parts.config.max_steps = Some(4);
        parts.config.workers = 1;
        assert_eq!(go(&parts).steps, 4);
        parts.config.max_steps = None;
        parts.config.workers = 3;
        parts.resume = true;
        assert_eq!(go(&parts).steps, 9);
        assert_same_run(&whole.out, &parts.out);
    }
}

/// Killed after its last checkpoint, or typed once more.
#[test]
fn a_run_that_is_done_loses_nothing_when_it_is_resumed() {
    let folder = set();
    let tables = ["scalars.csv", "validation.csv", "diagnostics.csv"];
    // Within an epoch and at the end of one.
    for steps in [5, 6] {
        let mut run = options(folder.path(), &format!("run-{steps}"), &[]);
        run.config.max_steps = Some(steps);
        go(&run);
        let before = tables.map(|name| bytes(&run.out, name));
        let model = bytes(&run.out, "model.onnx");
        std::fs::remove_file(run.out.join("model.onnx")).unwrap();
        run.resume = true;
        for limit in [steps, 2] {
            run.config.max_steps = Some(limit);
            assert_eq!(go(&run).steps, steps);
            assert!(tables.map(|name| bytes(&run.out, name)) == before);
            assert!(bytes(&run.out, "model.onnx") == model);
        }
    }
}

#[test]
fn a_damaged_checkpoint_costs_steps_but_not_the_result() {
    let folder = set();
    let whole = options(folder.path(), "whole", &[]);
    go(&whole);
    let mut damaged = options(folder.path(), "damaged", &["max_steps=7"]);
    go(&damaged);
    let newest = damaged.out.join("checkpoints/step-00000007/generator.bpk");
    let mut content = std::fs::read(&newest).unwrap();
    content.truncate(1000);
    std::fs::write(&newest, content).unwrap();
    damaged.config.max_steps = None;
    damaged.resume = true;
    go(&damaged);
    assert_same_run(&whole.out, &damaged.out);
}

#[test]
fn the_photometric_error_falls_and_the_model_is_exported() {
    let folder = set();
    let options = options(
        folder.path(),
        "learn",
        &[
            "epochs=25",
            "network.width=1/16",
            "validation.every=0",
            "pictures.every=25",
        ],
    );
    let outcome = go(&options);
    assert_eq!(outcome.model, Some(options.out.join("model.onnx")));
    assert!(outcome.parity.unwrap() < 1e-4);
    let scalars = String::from_utf8(bytes(&options.out, "scalars.csv")).unwrap();
    let stereo: Vec<f64> = scalars
        .lines()
        .skip(1)
        .map(|line| line.split(',').nth(5).unwrap().parse().unwrap())
        .collect();
    assert_eq!(stereo.len(), 75);
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let (first, last) = (mean(&stereo[..10]), mean(&stereo[65..]));
    assert!(last < 0.9 * first, "from {first} to {last}");
    assert_eq!(
        std::fs::read_dir(options.out.join("pictures"))
            .unwrap()
            .count(),
        3
    );
    // The same model comes out of the checkpoint.
    let exported = export_run(
        &options.out,
        Some(&folder.path().join("again.onnx")),
        false,
        Weights::F32,
        false,
    )
    .unwrap();
    assert_eq!(
        std::fs::read(exported.path).unwrap(),
        bytes(&options.out, "model.onnx")
    );
}

#[test]
fn validation_measures_depth_and_names_the_best_checkpoint() {
    let folder = set();
    let outcome = go(&options(folder.path(), "validated", &[]));
    let scores = outcome.scores.unwrap();
    assert_eq!((scores.images, scores.depth_images), (3, 3));
    assert!(scores.depth.unwrap().abs_rel.is_finite());
    let best = outcome.best.unwrap();
    assert_eq!(best.score, "abs_rel");
    let kept: PathBuf = folder
        .path()
        .join(format!("validated/checkpoints/step-{:08}", best.step));
    assert!(kept.is_dir());
}

#[test]
fn accumulated_gradients_are_averaged() {
    // One batch of two equals two batches of one. Without a discriminator the terms are means
    // over samples of equal size, so only rounding differs.
    let folder = set();
    let settings = [
        "variant=no-adv",
        "epochs=1",
        "max_steps=1",
        "validation.every=0",
    ];
    let single = options(folder.path(), "single", &settings);
    let mut two = options(folder.path(), "two", &settings);
    two.config.batch = 1;
    two.config.accumulate = 2;
    go(&single);
    go(&two);
    let line = |options: &Options| -> Vec<f64> {
        let text = String::from_utf8(bytes(&options.out, "scalars.csv")).unwrap();
        let line = text.lines().nth(1).unwrap().to_owned();
        line.split(',').map(|cell| cell.parse().unwrap()).collect()
    };
    for (a, b) in line(&single).iter().zip(line(&two)) {
        assert!((a - b).abs() <= 1e-5 * (1.0 + a.abs()), "{a} and {b}");
    }
}

fn run_info(folder: &Path) -> RunInfo {
    serde_json::from_slice(&bytes(folder, "run.json")).unwrap()
}

#[test]
fn each_view_can_have_a_discriminator_of_its_own() {
    let folder = set();
    let settings = ["max_steps=1", "validation.every=0"];
    let shared = options(folder.path(), "shared", &settings);
    let mut own = options(folder.path(), "own", &settings);
    own.config.discriminator.sharing = Sharing::PerView;
    go(&shared);
    go(&own);
    let (one, two) = (run_info(&shared.out), run_info(&own.out));
    assert_eq!(one.generator_parameters, two.generator_parameters);
    assert_eq!(
        2 * one.discriminator_parameters,
        two.discriminator_parameters
    );
    // Both are trained: neither is what it was before the step, nor are they alike.
    let file = folder.path().join("own.safetensors");
    export_run(&own.out, Some(&file), false, Weights::F32, false).unwrap();
    let trained = InitialWeights::read(&file).unwrap();
    let before = Trainer::new(&own.config, None, &DeviceChoice::Cpu.open().unwrap());
    for parameter in before.all_parameters() {
        if parameter.name.ends_with("stages.0.conv.weight") {
            let after = trained.values(&parameter.name, &parameter.shape).unwrap();
            assert_ne!(after, parameter.values, "{}", parameter.name);
        }
    }
    let shape = [4, 3, 4, 4];
    let of = |network| {
        let name = format!("{network}.stages.0.conv.weight");
        trained.values(&name, &shape).unwrap()
    };
    assert_ne!(of("discriminator"), of("discriminator-right"));
}

#[test]
fn a_run_begins_with_the_weights_of_another() {
    let folder = set();
    let settings = ["max_steps=2", "validation.every=0"];
    let first = options(folder.path(), "first", &settings);
    go(&first);
    let file = folder.path().join("start.safetensors");
    let exported = export_run(&first.out, Some(&file), false, Weights::F32, false).unwrap();
    assert_eq!((&exported.path, exported.parity), (&file, None));

    // The networks are those of the first run, whatever the seed.
    let mut second = options(folder.path(), "second", &["seed=5", "max_steps=1"]);
    second.config.initial_weights = Some(file.clone());
    let device = DeviceChoice::Cpu.open().unwrap();
    let start = InitialWeights::read(&file).unwrap();
    let trainer = Trainer::new(&second.config, Some(&start), &device);
    let parameters = trainer.all_parameters();
    assert!(
        start
            .check(&parameters)
            .unwrap()
            .contains("of the networks")
    );
    for parameter in &parameters {
        let stored = start.values(&parameter.name, &parameter.shape);
        assert_eq!(
            stored.as_ref(),
            Some(&parameter.values),
            "{}",
            parameter.name
        );
    }
    go(&second);
    let info = run_info(&second.out);
    assert_eq!(info.initial_weights.as_deref(), Some(start.digest()));
    assert!(!info.unknown_start);

    // The drives of the first run are remembered, also by a run that is resumed.
    let drives = vec!["2011_09_26_drive_0001".to_owned(), "elsewhere".to_owned()];
    strat_train::network::initial_weights::write(&parameters, Some(&drives[1..]), &file).unwrap();
    second.force = true;
    go(&second);
    assert_eq!(run_info(&second.out).train_drives, drives);
    (second.force, second.resume) = (false, true);
    second.config.max_steps = Some(2);
    std::fs::remove_file(&file).unwrap();
    go(&second);
    assert_eq!(run_info(&second.out).train_drives, drives);

    // A file that does not say what it was trained on leaves its mark in the model.
    strat_train::network::initial_weights::write(&parameters, None, &file).unwrap();
    (second.force, second.resume) = (true, false);
    go(&second);
    let model = strat_onnx::model::read(second.out.join("model.onnx")).unwrap();
    let metadata = model.info.metadata().unwrap().clone();
    assert_eq!(
        metadata.unknown_start,
        Some(InitialWeights::read(&file).unwrap().digest().to_owned())
    );

    // A network of another width is refused before anything of the old run is removed.
    second.config.network.width = strat_train::network::layers::Width::new(1, 16).unwrap();
    let text = run(&second).unwrap_err().to_string();
    assert!(text.contains("initial weights"), "{text}");
    assert!(second.out.join("model.onnx").is_file());
}

#[test]
fn devices_that_share_a_step_change_nothing_in_its_result() {
    let folder = set();
    for judges in ["shared", "per-view"] {
        let judges = format!("discriminator.sharing={judges}");
        let settings = ["batch=1", "accumulate=4", "epochs=1", &judges];
        let one = options(folder.path(), &format!("one-{judges}"), &settings);
        let mut three = options(folder.path(), &format!("three-{judges}"), &settings);
        three.replicas = vec![DeviceChoice::Cpu; 2];
        go(&one);
        go(&three);
        assert_same_run(&one.out, &three.out);
        assert_eq!(run_info(&three.out).device, "cpu,cpu,cpu");
    }
}

#[test]
fn an_interrupt_leaves_a_checkpoint_and_no_model() {
    let folder = set();
    let whole = options(folder.path(), "whole", &[]);
    go(&whole);
    let mut stopped = options(folder.path(), "stopped", &[]);
    stopped.stop = Arc::new(AtomicBool::new(true));
    let outcome = go(&stopped);
    assert!(outcome.interrupted && outcome.model.is_none());
    assert_eq!(outcome.steps, 1);
    assert!(stopped.out.join("checkpoints/step-00000001").is_dir());
    stopped.stop = Arc::new(AtomicBool::new(false));
    stopped.resume = true;
    go(&stopped);
    assert_same_run(&whole.out, &stopped.out);
}

#[test]
fn a_run_is_neither_overwritten_nor_resumed_with_other_settings() {
    let folder = set();
    let mut options = options(
        folder.path(),
        "first",
        &["max_steps=1", "validation.every=0"],
    );
    go(&options);
    let message = |options: &Options| run(options).unwrap_err().to_string();
    assert!(message(&options).contains("--resume"));
    options.resume = true;
    options.config.seed = 9;
    let text = message(&options);
    assert!(
        text.contains("seed: 1") && text.contains("seed: 9"),
        "{text}"
    );
    options.resume = false;
    options.force = true;
    assert_eq!(go(&options).steps, 1);
}

#[test]
fn a_number_that_is_none_stops_the_run_and_keeps_the_checkpoint() {
    let folder = set();
    let mut options = options(
        folder.path(),
        "explodes",
        &["validation.every=0", "variant=no-adv", "epochs=30"],
    );
    // A learning rate no configuration may have, to blow the network up.
    options.config.learning_rate = 1e12;
    let text = run(&options).unwrap_err().to_string();
    assert!(
        text.contains("at step") && text.contains("learning_rate"),
        "{text}"
    );
}

#[test]
fn a_folder_is_for_one_run_at_a_time() {
    let folder = set();
    let mut first = options(folder.path(), "run", &["max_steps=1"]);
    go(&first);
    // As long as some process trains there, no other may, whatever it is allowed to replace.
    let lock = std::fs::File::options()
        .write(true)
        .open(first.out.join(".lock"))
        .unwrap();
    lock.lock().unwrap();
    let scalars = bytes(&first.out, "scalars.csv");
    for (resume, force) in [(true, false), (false, true)] {
        (first.resume, first.force) = (resume, force);
        let text = run(&first).unwrap_err().to_string();
        assert!(text.contains("another training is running"), "{text}");
    }
    assert_eq!(bytes(&first.out, "scalars.csv"), scalars);
    // The lock ends with its holder; the file stays.
    drop(lock);
    go(&first);
}

#[test]
fn a_checkpoint_of_another_configuration_is_refused() {
    let folder = set();
    let mut own = options(folder.path(), "own", &["max_steps=2"]);
    go(&own);
    let other = options(folder.path(), "other", &["max_steps=3", "seed=2"]);
    go(&other);
    let step = "checkpoints/step-00000003";
    std::fs::create_dir(own.out.join(step)).unwrap();
    for entry in std::fs::read_dir(other.out.join(step)).unwrap() {
        let file = entry.unwrap();
        std::fs::copy(file.path(), own.out.join(step).join(file.file_name())).unwrap();
    }
    own.config.max_steps = None;
    own.resume = true;
    let text = run(&own).unwrap_err().to_string();
    assert!(
        text.contains("another configuration") && text.contains(step),
        "{text}"
    );
    let text = export_run(&own.out, None, false, Weights::F32, false)
        .unwrap_err()
        .to_string();
    assert!(text.contains("another configuration"), "{text}");
    std::fs::remove_dir_all(own.out.join(step)).unwrap();
    go(&own);
}

#[test]
fn an_export_replaces_only_exports_of_its_own_run() {
    let folder = set();
    let at = |name: &str| folder.path().join(name);
    let settings = ["max_steps=1", "validation.every=0"];
    let first = options(folder.path(), "first", &settings);
    let second = options(
        folder.path(),
        "second",
        &[&settings[..], &["seed=9"]].concat(),
    );
    go(&first);
    go(&second);
    let export = |run: &Options, out: &Path, force: bool| {
        let done = export_run(&run.out, Some(out), false, Weights::F32, force);
        done.map(drop).map_err(|error| error.to_string())
    };
    let refused = |run: &Options, out: &Path, force: bool, sentence: &str| {
        let before = std::fs::read(out).ok();
        let text = export(run, out, force).unwrap_err();
        assert!(text.contains(sentence), "{text}");
        assert_eq!(std::fs::read(out).ok(), before, "{}", out.display());
    };
    for name in ["model.onnx", "weights.safetensors"] {
        let out = at(name);
        std::fs::write(&out, b"somebody's").unwrap();
        refused(&first, &out, true, "not written by `train export`");
        std::fs::remove_file(&out).unwrap();
        export(&first, &out, false).unwrap();
        export(&first, &out, false).unwrap();
    }
    refused(
        &second,
        &at("model.onnx"),
        false,
        "an export of another run",
    );
    export(&second, &at("model.onnx"), true).unwrap();
    for name in [
        "scalars.csv",
        "run.json",
        "checkpoints/step-00000001/state.json",
    ] {
        refused(&first, &first.out.join(name), true, "not written by");
    }
    let theirs = second.out.join("model.onnx");
    refused(&first, &theirs, true, "in the folder of another run");
    refused(
        &first,
        &at("none/../second/new.onnx"),
        true,
        "in the folder of another run",
    );
    refused(&first, folder.path(), false, "this is a folder");
    assert!(!at("none").exists());
    export(&first, &first.out.join("best.onnx"), false).unwrap();
    export_run(&first.out, None, false, Weights::F32, false).unwrap();
}

/// The file holds the discriminator of the left view, and replaces none of another run.
#[test]
fn discriminators_are_exported() {
    let folder = set();
    let settings = ["max_steps=1", "validation.every=0"];
    let with = |name: &str, more: &[&str]| {
        let options = options(folder.path(), name, &[&settings[..], more].concat());
        go(&options);
        options
    };
    let one = with("one", &[]);
    let two = with("two", &["discriminator.sharing=per-view"]);
    for run in [&one, &two] {
        let exported = export_discriminator(&run.out, None, false, false).unwrap();
        assert_eq!(exported.path, run.out.join("discriminator.onnx"));
        let model = strat_onnx::model::read(&exported.path).unwrap();
        let metadata = model.info.discriminator().unwrap().unwrap();
        let input = run.config.input;
        assert_eq!(metadata.patch, input.width.min(input.height));
        assert_eq!(metadata.variant, "strat");
        assert!(!metadata.expected.is_empty());
        // Its weights are those of the left view.
        let file = run.out.join("weights.safetensors");
        export_run(&run.out, Some(&file), false, Weights::F32, false).unwrap();
        let weights = std::fs::read(&file).unwrap();
        let tensors = safetensors::SafeTensors::deserialize(&weights).unwrap();
        let last = tensors.tensor("discriminator.last.weight").unwrap();
        let onnx = std::fs::read(&exported.path).unwrap();
        let holds = |part: &[u8]| onnx.windows(part.len()).any(|bytes| bytes == part);
        assert!(holds(last.data()));
        if let Ok(right) = tensors.tensor("discriminator-right.last.weight") {
            assert!(!holds(right.data()));
        }
    }
    let again = export_discriminator(&one.out, None, false, false);
    assert!(again.is_ok());
    let out = folder.path().join("d.onnx");
    export_discriminator(&one.out, Some(&out), false, false).unwrap();
    export_discriminator(&one.out, Some(&out), false, false).unwrap();
    let text = export_run(&one.out, Some(&out), false, Weights::F32, false);
    let text = text.unwrap_err().to_string();
    assert!(text.contains("export of another run"), "{text}");
    let none = with("none", &["variant=no-adv"]);
    let text = export_discriminator(&none.out, None, false, false);
    let text = text.unwrap_err().to_string();
    assert!(text.contains("without a discriminator"), "{text}");
}

#[test]
fn both_tables_count_epochs_from_one() {
    let folder = set();
    let options = options(folder.path(), "run", &["max_steps=4"]);
    go(&options);
    let epochs = |name: &str| -> Vec<String> {
        let text = String::from_utf8(bytes(&options.out, name)).unwrap();
        let lines = text
            .lines()
            .skip(1)
            .map(|line| line.split(',').nth(1).unwrap().to_owned());
        lines.collect()
    };
    // Three steps an epoch.
    assert_eq!(epochs("scalars.csv"), ["1", "1", "1", "2"]);
    assert_eq!(epochs("validation.csv"), ["1", "2"]);
}

/// Lines of a run's table as cells, its head first.
fn table(folder: &Path, name: &str) -> Vec<Vec<String>> {
    let text = String::from_utf8(bytes(folder, name)).unwrap();
    let cells = |line: &str| line.split(',').map(str::to_owned).collect();
    text.lines().map(cells).collect()
}

#[test]
fn diagnostics_change_no_bit_of_the_weights() {
    let folder = set();
    for (name, settings) in [
        ("strat", &[][..]),
        ("noadv", &["variant=no-adv"][..]),
        ("per-view", &["discriminator.sharing=per-view"][..]),
        ("several", &["batch=1", "accumulate=2"][..]),
    ] {
        let of = |every: &str| {
            let settings = [settings, &[every]].concat();
            let options = options(folder.path(), &format!("{name}-{every}"), &settings);
            go(&options);
            options
        };
        let (with, without) = (of("diagnostics.every=1"), of("diagnostics.every=0"));
        assert_eq!(
            with.config.digest().unwrap(),
            without.config.digest().unwrap()
        );
        for file in ["model.onnx", "scalars.csv", "validation.csv"] {
            assert!(
                bytes(&with.out, file) == bytes(&without.out, file),
                "{name}: {file}"
            );
        }
        // The discriminators too, which the model lacks.
        let weights = |run: &Options| {
            let file = run.out.join("weights.safetensors");
            export_run(&run.out, Some(&file), false, Weights::F32, false).unwrap();
            std::fs::read(file).unwrap()
        };
        assert!(weights(&with) == weights(&without), "{name}");
        assert_eq!(table(&without.out, "diagnostics.csv").len(), 1);
        // Once an epoch, of three steps each, at its last step.
        let lines = table(&with.out, "diagnostics.csv");
        let head = "step,epoch,gradient_ssim,gradient_l1,gradient_left_right,gradient_smoothness,\
                    gradient_adversarial";
        assert_eq!(lines[0].join(","), head);
        let steps: Vec<&str> = lines[1..].iter().map(|line| line[0].as_str()).collect();
        assert_eq!(steps, ["2", "5", "8"]);
        for line in &lines[1..] {
            let norms: Vec<f64> = line[2..].iter().map(|cell| cell.parse().unwrap()).collect();
            let pulls = [true, true, true, false, name != "noadv"];
            for (norm, pulls) in norms.iter().zip(pulls) {
                assert_eq!(*norm > 0.0 && norm.is_finite(), pulls, "{name}: {norms:?}");
            }
        }
    }
}

#[test]
fn the_discriminator_is_right_about_a_fraction_of_the_patches() {
    let folder = set();
    let options = options(folder.path(), "run", &["epochs=1"]);
    go(&options);
    let lines = table(&options.out, "scalars.csv");
    let cells = lines[0].len();
    assert_eq!(
        lines[0][cells - 2..],
        ["accuracy_real", "accuracy_synthesised"]
    );
    let values = lines[1..].iter().flat_map(|line| &line[cells - 2..]);
    let values: Vec<f64> = values.map(|cell| cell.parse().unwrap()).collect();
    // Before it has learned, it is right about the one as often as it is wrong about the other.
    assert!((values[0] + values[1] - 1.0).abs() < 0.5, "{values:?}");
    assert!(values.iter().all(|value| (0.0..=1.0).contains(value)));
}

#[test]
fn a_run_from_before_diagnostics_goes_on() {
    let folder = set();
    let whole = options(folder.path(), "whole", &[]);
    go(&whole);
    let mut older = options(folder.path(), "older", &["max_steps=4"]);
    go(&older);
    // What earlier versions wrote: no such settings, two columns fewer, no third table.
    let path = older.out.join("config.yaml");
    let config = std::fs::read_to_string(&path).unwrap();
    let (before, _) = config.split_once("diagnostics:\n").unwrap();
    std::fs::write(&path, before).unwrap();
    let lines = table(&older.out, "scalars.csv");
    let old: Vec<String> = lines
        .iter()
        .map(|line| line[..line.len() - 2].join(","))
        .collect();
    std::fs::write(older.out.join("scalars.csv"), old.join("\n") + "\n").unwrap();
    std::fs::remove_file(older.out.join("diagnostics.csv")).unwrap();
    older.config.max_steps = None;
    older.resume = true;
    go(&older);
    assert!(bytes(&whole.out, "model.onnx") == bytes(&older.out, "model.onnx"));
    let (all, gone_on) = (
        table(&whole.out, "scalars.csv"),
        table(&older.out, "scalars.csv"),
    );
    assert_eq!(gone_on.len(), 10);
    for (index, (all, gone_on)) in all.iter().zip(&gone_on).enumerate() {
        let known = if (1..=4).contains(&index) {
            all.len() - 2
        } else {
            all.len()
        };
        assert_eq!(all[..known], gone_on[..known]);
        assert!(gone_on[known..].iter().all(String::is_empty));
        assert_eq!(gone_on.len(), all.len());
    }
    let steps: Vec<String> = table(&older.out, "diagnostics.csv")
        .iter()
        .map(|l| l[0].clone())
        .collect();
    assert_eq!(steps, ["step", "5", "8"]);
}

#[test]
fn validation_without_its_ground_truth_is_said() {
    let folder = set();
    let options = options(
        folder.path(),
        "run",
        &["validation.protocol=eigen-improved"],
    );
    let set = strat_store::set::PreparedSet::open(&options.data).unwrap();
    let validation = strat_train::training::validation::Validation::open(&set, &options.config);
    let warnings = validation.unwrap().unwrap().warnings;
    assert_eq!(warnings.len(), 1, "{warnings:?}");
    assert!(warnings[0].contains("eigen-improved"), "{}", warnings[0]);
}

#[test]
fn a_model_names_the_camera_it_was_trained_with() {
    let folder = set();
    let options = options(folder.path(), "run", &["max_steps=1"]);
    let outcome = go(&options);
    let model = strat_onnx::model::read(outcome.model.unwrap()).unwrap();
    let camera = model.info.metadata().unwrap().camera.unwrap();
    // 75 px of 128, 0.54 m, the same for all pairs.
    assert_eq!(camera.focal_fraction.to_string(), "0.5859375");
    assert_eq!(camera.baseline_m.to_string(), "0.54");
}
