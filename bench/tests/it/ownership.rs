//! Whose results a folder holds: nothing that was measured before, and nothing of anyone else, is lost.

use std::{collections::BTreeMap, fs, path::Path};

use strat_splits::Split;

use crate::command::{bench, text};
use crate::fixtures::{HEIGHT, WIDTH, write_model};
use crate::npy;
use crate::world::World;

/// A set, and predictions of one depth each: `near.npy` and `far.npy`.
fn world() -> World {
    let world = World::new(Split::Eigen, 2, false);
    for (name, depth_m) in [("near", 9.0_f32), ("far", 11.0)] {
        let path = world.path(name).with_extension("npy");
        let shape = [2, HEIGHT as usize, WIDTH as usize];
        npy::write(
            &path,
            &shape,
            std::iter::repeat_n(depth_m, shape.iter().product()),
        );
        fs::write(path.with_extension("yaml"), "meaning: depth_m\n").unwrap();
    }
    world
}

/// `--predictions NAME=FILE.npy`.
fn predictions(world: &World, name: &str, file: &str) -> [String; 2] {
    let file = text(&world.path(file).with_extension("npy"));
    ["--predictions".to_owned(), format!("{name}={file}")]
}

/// Files by name, without journals.
fn files_in(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap())
        .filter(|entry| entry.path().is_file())
        .map(|entry| {
            let name = entry.file_name().into_string().unwrap();
            (name, fs::read(entry.path()).unwrap())
        })
        .filter(|(name, _)| !name.starts_with("unfinished-"))
        .collect()
}

#[test]
fn a_failing_or_another_run_replaces_nothing() {
    let world = world();
    let run = |name: &str, file: &str, more: &[&str]| {
        let given = predictions(&world, name, file);
        let mut arguments: Vec<&str> = given.iter().map(String::as_str).collect();
        arguments.extend(more);
        world.bench("3.3", "out", &arguments)
    };
    run("a", "near", &[]).code(0);
    let before = files_in(&world.path("out"));
    assert!(before.contains_key("rows.csv") && before.contains_key("table_3_3.txt"));
    let unchanged = || assert!(files_in(&world.path("out")) == before);

    run("b", "far", &[])
        .code(2)
        .says("has results of a, which is not measured now");
    unchanged();
    // What the name stands for now is known only when it is read.
    run("a", "far", &[])
        .code(2)
        .says("has results of another file under the name a");
    unchanged();
    run("a", "typo", &[])
        .code(1)
        .says("has results of a, which could not be measured now");
    unchanged();
    let typo = format!("a={}", text(&world.path("typo.onnx")));
    world
        .bench("3.3", "out", &["--model", &typo])
        .code(2)
        .says("--force");
    unchanged();

    // The same again, and more, is no other run.
    run("a", "near", &[]).code(0);
    let far = predictions(&world, "b", "far");
    run("a", "near", &[&far[0], &far[1]]).code(0);
    assert_eq!(world.rows("out").len(), 2 * world_rows(&before));
    run("b", "far", &["--force"]).code(0);
    assert!(world.rows("out").iter().all(|row| row.context.model == "b"));
}

fn world_rows(files: &BTreeMap<String, Vec<u8>>) -> usize {
    let rows = String::from_utf8_lossy(&files["rows.csv"]);
    rows.lines().count() - 1
}

#[test]
fn files_of_others_stay() {
    let world = world();
    let near = predictions(&world, "a", "near");
    for foreign in ["rows.csv", "table_3_3.md", "run.yaml"] {
        let folder = world.path("taken");
        fs::create_dir_all(&folder).unwrap();
        fs::write(folder.join(foreign), "somebody's\n").unwrap();
        world
            .bench("3.3", "taken", &[&near[0], &near[1]])
            .code(2)
            .says(foreign);
        let files = files_in(&folder);
        assert_eq!(files.len(), 1, "{:?}", files.keys());
        assert_eq!(files[foreign], b"somebody's\n");
        fs::remove_file(folder.join(foreign)).unwrap();
    }
    // What a run never writes is in nobody's way.
    fs::write(world.path("taken/notes.txt"), "mine").unwrap();
    world.bench("3.3", "taken", &[&near[0], &near[1]]).code(0);
    assert_eq!(fs::read(world.path("taken/notes.txt")).unwrap(), b"mine");
    // Into the set itself, however the path is written.
    for out in ["set/results", "none/../set/results"] {
        world
            .bench("3.3", out, &[&near[0], &near[1]])
            .code(2)
            .says("inside the input folder");
    }
    assert!(!world.path("none").exists() && !world.path("set/results").exists());
}

#[test]
fn a_merge_takes_only_its_parts_away() {
    let world = world();
    let near = predictions(&world, "a", "near");
    for shard in ["0/2", "1/2"] {
        world
            .bench("3.3", "out", &[&near[0], &near[1], "--shard", shard])
            .code(0);
    }
    let notes = world.path("out/parts/0001-of-0002/notes.txt");
    fs::write(&notes, "mine").unwrap();
    let out = text(&world.path("out"));
    bench(&["merge", &out])
        .code(0)
        .says("notes.txt is not of this run and stays");
    assert_eq!(fs::read(&notes).unwrap(), b"mine");
    assert!(!world.path("out/parts/0000-of-0002").exists());

    // A merge replaces no results of another run either.
    let other = text(&world.path("other"));
    world
        .bench(
            "3.3",
            "other",
            &predictions(&world, "b", "far")
                .each_ref()
                .map(String::as_str),
        )
        .code(0);
    for shard in ["0/2", "1/2"] {
        world
            .bench("3.3", "other", &[&near[0], &near[1], "--shard", shard])
            .code(0);
    }
    let before = files_in(&world.path("other"));
    bench(&["merge", &other]).code(2).says("has results of b");
    assert!(files_in(&world.path("other")) == before);
}

#[test]
fn pages_figures_and_times_replace_only_their_own() {
    let world = world();
    let near = predictions(&world, "a", "near");
    world.bench("3.3", "out", &[&near[0], &near[1]]).code(0);
    let out = text(&world.path("out"));
    let rows = world.path("out/rows.csv");
    let before = fs::read(&rows).unwrap();
    bench(&["report", &out, "--out", &text(&rows)])
        .code(2)
        .says("not written by `bench report`");
    assert_eq!(fs::read(&rows).unwrap(), before);
    for _ in 0..2 {
        bench(&["report", &out]).code(0);
    }

    let set = text(&world.path("set"));
    let model = write_model(world.folder.path(), "looks", 0.02, 0.05, "eigen");
    let taken = world.path("taken");
    fs::create_dir(&taken).unwrap();
    for (name, arguments) in [
        (
            "latency.csv",
            vec![
                "latency",
                "--model",
                "MODEL",
                "--data",
                &set,
                "--runtime",
                "embedded",
            ],
        ),
        (
            "drawing.svg",
            vec![
                "figures",
                "--model",
                "MODEL",
                "--data",
                &set,
                "--runtime",
                "embedded",
            ],
        ),
        (
            "summary.md",
            vec![
                "cues",
                "--model",
                "MODEL",
                "--data",
                &set,
                "--runtime",
                "embedded",
            ],
        ),
        (
            "photo.exr",
            vec![
                "predict",
                "--model",
                "MODEL",
                "--runtime",
                "embedded",
                "PHOTO",
            ],
        ),
    ] {
        fs::write(taken.join(name), "mine").unwrap();
        let (model, photo) = (text(&model), text(&world.path("photo.png")));
        let mut arguments: Vec<&str> = arguments
            .into_iter()
            .map(|argument| match argument {
                "MODEL" => &model,
                "PHOTO" => &photo,
                other => other,
            })
            .collect();
        let folder = text(&taken);
        arguments.extend(["--out", &folder]);
        bench(&arguments).code(2).says("cannot write to");
        let files = files_in(&taken);
        assert_eq!(files.len(), 1, "{name}: {:?}", files.keys());
        assert_eq!(files[name], b"mine");
        fs::remove_file(taken.join(name)).unwrap();
    }
}
