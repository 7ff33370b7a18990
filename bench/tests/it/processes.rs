//! Models in processes of their own: what one does costs itself alone.

use std::collections::BTreeMap;

use strat_splits::Split;

use crate::{
    broken::{Fault, with_input, write_spoilt},
    command::{bench_with, text},
    fixtures::{metadata, network, onnxruntime, write_model},
    world::World,
};

const FAULT: &str = "STRAT_MODEL_FAULT";

/// A set of three images and two models: `a` is asked its probe first, `b` has none.
fn world() -> (World, String, String) {
    let world = World::new(Split::Kitti, 3, false);
    let a = text(&write_model(world.folder.path(), "a", 0.04, 0.1, "eigen"));
    let b = world.path("b.onnx");
    std::fs::write(&b, network(0.05, 0.1, Some(&metadata("eigen")))).unwrap();
    (world, a, text(&b))
}

/// Rows of a table run, counted by model.
fn counted(world: &World, out: &str) -> BTreeMap<String, usize> {
    let mut count = BTreeMap::new();
    for row in world.rows(out) {
        *count.entry(row.context.model).or_default() += 1;
    }
    count
}

fn table(
    world: &World,
    out: &str,
    models: &[&str],
    more: &[&str],
    fault: &str,
) -> crate::command::Ran {
    let (data, out) = (text(&world.path("set")), text(&world.path(out)));
    let mut arguments = vec!["--table", "3.1", "--data", &data, "--out", &out];
    if !more.contains(&"--runtime") {
        arguments.extend(["--runtime", "embedded"]);
    }
    models
        .iter()
        .for_each(|model| arguments.extend(["--model", model]));
    arguments.extend(more);
    bench_with(&arguments, &[(FAULT, fault)])
}

#[test]
fn a_crash_costs_one_model_what_it_has_not_done_yet() {
    let (world, a, b) = world();
    // The probe and two images, then it dies; the other model is asked thrice.
    let ran = table(&world, "out", &[&a, &b], &["--quiet"], "abort@4");
    ran.code(1).says("the process that ran it ended by itself");
    assert_eq!(ran.err.matches("ended by itself").count(), 1, "{}", ran.err);
    let expected = [("a".to_owned(), 2), ("b".to_owned(), 3)];
    assert_eq!(counted(&world, "out"), BTreeMap::from(expected));
    // In the middle of the images, the rest is not tried.
    let ran = table(&world, "early", &[&a, &b], &["--quiet"], "abort@2");
    ran.code(1).says("the rest was not tried");
    let expected = [("b".to_owned(), 1)];
    assert_eq!(counted(&world, "early"), BTreeMap::from(expected));
}

#[test]
fn a_panic_costs_one_image_and_is_a_sentence() {
    let (world, a, b) = world();
    let ran = table(&world, "out", &[&a, &b], &["--quiet"], "panic@2");
    ran.code(1)
        .says("the runtime gave up on it (a fault for a test)");
    let expected = [("a".to_owned(), 2), ("b".to_owned(), 2)];
    assert_eq!(counted(&world, "out"), BTreeMap::from(expected));
}

#[test]
fn what_takes_more_than_it_may_is_ended() {
    let (world, a, _) = world();
    let ran = table(&world, "out", &[&a], &["--max-memory", "0.001"], "");
    ran.code(1)
        .says("it took more than 1.0 MB of memory; --max-memory allows more");
    table(&world, "out", &[&a], &["--max-memory", "0"], "").code(2);
    table(
        &world,
        "out",
        &[&a],
        &["--max-memory", "1", "--in-process"],
        "",
    )
    .code(2);
}

#[test]
fn rows_do_not_depend_on_the_process() {
    let (world, a, b) = world();
    let rows = |out: &str, more: &[&str]| {
        table(&world, out, &[&a, &b], more, "").code(0);
        std::fs::read(world.path(out).join("rows.csv")).unwrap()
    };
    assert_eq!(rows("apart", &[]), rows("within", &["--in-process"]));
}

#[test]
fn every_command_survives_a_crash() {
    let (world, a, b) = world();
    let (set, photos) = (text(&world.path("set")), text(&world.path("set/f")));
    let out = text(&world.path("out"));
    let crash = |arguments: &[&str], fault: &str| {
        let common = ["--out", &out, "--runtime", "embedded", "--quiet"];
        let ran = bench_with(&[arguments, &common].concat(), &[(FAULT, fault)]);
        ran.code(1).says("ended by itself");
        assert_eq!(ran.err.matches("ended by itself").count(), 1, "{}", ran.err);
    };
    crash(
        &["predict", "--model", &b, &photos, "--format", "npy"],
        "abort@2",
    );
    crash(&["figures", "--data", &set, "--model", &b], "abort@2");
    let quick = ["--seconds", "0", "--queries", "1", "--threads", "1"];
    let latency = ["latency", "--model", &a, "--data", &set];
    crash(&[&latency[..], &quick].concat(), "abort@3");
}

/// A network whose input is declared to be 100,000 pixels wide and high, and one whose output becomes so: what
/// they would need is 120 GB and 40 GB.
#[test]
fn a_model_of_impossible_size_costs_one_sentence() {
    let (world, _, b) = world();
    let wide = world.path("wide.onnx");
    let plain = network(0.04, 0.1, Some(&metadata("eigen")));
    std::fs::write(&wide, with_input(&plain, 100_000)).unwrap();
    let described = world.path("described.onnx");
    std::fs::write(&described, with_input(&network(0.04, 0.1, None), 100_000)).unwrap();
    std::fs::write(
        world.path("described.yaml"),
        "input: {width: 100000, height: 100000, range: 0..1}\noutput: {meaning: disparity_fraction}\n",
    )
    .unwrap();
    let grown = write_spoilt(
        world.folder.path(),
        "grown",
        &metadata("eigen"),
        Fault::Grows(100_000),
    );
    let mut runtimes = vec!["embedded"];
    runtimes.extend(onnxruntime().map(|_| "ort"));
    for runtime in runtimes {
        for (model, sentence) in [
            (text(&wide), "has the shape [N, 3, 100000, 100000], but"),
            (text(&described), "its input of 100000x100000 has more than"),
            (grown.clone(), "model grown, image "),
        ] {
            let out = format!("{runtime}-{}", model.rsplit('/').next().unwrap());
            let ran = table(
                &world,
                &out,
                &[&model, &b],
                &["--runtime", runtime, "--quiet"],
                "",
            );
            ran.code(1);
            let flat = ran.err.replace("error: grown, ", "error: model grown, ");
            assert_eq!(flat.matches(sentence).count(), 1, "{runtime}: {}", ran.err);
            assert_eq!(counted(&world, &out), BTreeMap::from([("b".to_owned(), 3)]));
        }
    }
}

#[test]
fn endless_and_bottomless_models_leave_the_others_alone() {
    if onnxruntime().is_none() {
        return;
    }
    let (world, _, b) = world();
    let spoilt =
        |name: &str, fault| write_spoilt(world.folder.path(), name, &metadata("eigen"), fault);
    let endless = spoilt("endless", Fault::Loops);
    let bottomless = spoilt("bottomless", Fault::Fills(1 << 32));
    let impossible = spoilt("impossible", Fault::Fills(1_000_000_000_000));
    let (rows, ort) = (BTreeMap::from([("b".to_owned(), 3)]), ["--runtime", "ort"]);
    let limited = [&ort[..], &["--max-seconds", "2"]].concat();
    table(&world, "time", &[&endless, &b], &limited, "")
        .code(1)
        .says("it took more than 2 s for an image");
    assert_eq!(counted(&world, "time"), rows);
    let limited = [&ort[..], &["--max-memory", "0.4"]].concat();
    table(
        &world,
        "memory",
        &[&bottomless, &impossible, &b],
        &limited,
        "",
    )
    .code(1)
    .says("it took more than 400.0 MB of memory")
    .says("impossible, image ");
    assert_eq!(counted(&world, "memory"), rows);
}
