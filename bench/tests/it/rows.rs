//! Commands that work on rows alone: compare, publish, verify-leaderboard, render.

use std::{fs, path::Path};

use assert_cmd::Command;
use strat_splits::Split;

use crate::command::{Ran, run, text};
use crate::fixtures::write_model;
use crate::world::World;

fn bench(words: &[&str]) -> Ran {
    run(Command::cargo_bin("bench").unwrap().args(words))
}

/// Results of two models on the same images, in `a` and `b`.
fn two_runs() -> World {
    let world = World::new(Split::Kitti, 12, false);
    for (out, constant) in [("a", 0.04), ("b", 0.045)] {
        // Looks at the picture, so that images differ.
        let model = write_model(world.folder.path(), out, constant, 0.01, "kitti");
        world.bench("3.1", out, &["--model", &text(&model)]).code(0);
    }
    world
}

fn rows(world: &World, out: &str) -> String {
    text(&world.path(out).join("rows.csv"))
}

fn lines(path: &Path) -> Vec<Vec<String>> {
    let mut reader = strat_csv::Reader::without_header(fs::File::open(path).unwrap());
    let records = reader.records();
    records
        .map(|record| record.unwrap().iter().map(str::to_owned).collect())
        .collect()
}

#[test]
fn a_model_that_is_better_on_every_image_of_few_drives_is_told_as_that() {
    let world = two_runs();
    let (a, b) = (rows(&world, "a"), rows(&world, "b"));
    let ran = bench(&["compare", &a, &b, "--json"]);
    let tests: serde_json::Value = serde_json::from_str(&ran.code(0).out).unwrap();
    let abs_rel = tests
        .as_array()
        .unwrap()
        .iter()
        .find(|test| test["metric"] == "abs_rel")
        .unwrap_or_else(|| panic!("{tests}"));
    let mean = |out: &str| {
        let rows = world.rows(out);
        let sum: f64 = rows.iter().map(|row| row.score.metrics.abs_rel).sum();
        sum / rows.len() as f64
    };
    let difference = abs_rel["difference"].as_f64().unwrap();
    assert!(
        (difference.abs() - (mean("b") - mean("a")).abs()).abs() < 1e-12,
        "{abs_rel}"
    );
    // The 12 images are of 4 drives or runs: 2 of the 2^4 sign patterns are as one-sided as that.
    let p = abs_rel["p_permutation"].as_f64().unwrap();
    assert!((p - 2.0 / 16.0).abs() < 1e-9, "{abs_rel}");
    // Which is too little for a word.
    let told = bench(&["compare", &a, &b]);
    assert!(told.code(0).out.contains("WARNING: 0.05"), "{}", told.out);
    assert!(
        !told.out.contains("a better") && !told.out.contains("b better"),
        "{}",
        told.out
    );
    bench(&["compare", &a]).code(1);
    let nothing = text(&world.path("nothing.csv"));
    bench(&["compare", &a, &nothing])
        .code(1)
        .says("nothing.csv");
    fs::write(&nothing, "model,protocol\nx,y\n").unwrap();
    bench(&["compare", &a, &nothing])
        .code(1)
        .says("nothing.csv");
}

#[test]
fn a_published_line_is_verified_and_a_changed_one_found() {
    let world = two_runs();
    let (a, b) = (rows(&world, "a"), rows(&world, "b"));
    let board = world.path("board.csv");
    let to = text(&board);
    bench(&["publish", "--rows", &a, "--to", &to]).code(0);
    let first = fs::read(&board).unwrap();
    bench(&["publish", "--rows", &b, "--to", &to]).code(0);
    let both = fs::read(&board).unwrap();
    assert!(both.len() > first.len());
    // The same again changes nothing.
    bench(&["publish", "--rows", &a, "--to", &to]).code(0);
    assert_eq!(fs::read(&board).unwrap(), both);
    let verified = bench(&["verify-leaderboard", &to, "--rows", &a, &b]);
    assert!(
        verified.code(0).out.starts_with("2 measured lines")
            && verified.out.ends_with("; 0 mismatches\n"),
        "{}",
        verified.out
    );
    bench(&["verify-leaderboard", &to, "--rows", &a])
        .code(1)
        .says("error: ");

    // The files of two people.
    let (mine, yours, all) = ("mine.csv", "yours.csv", "all.csv");
    let path = |name: &str| text(&world.path(name));
    bench(&["publish", "--rows", &a, "--to", &path(mine)]).code(0);
    bench(&["publish", "--rows", &b, "--to", &path(yours)]).code(0);
    bench(&[
        "publish",
        "--merge",
        &path(yours),
        &path(mine),
        "--to",
        &path(all),
    ])
    .code(0);
    assert_eq!(fs::read(world.path(all)).unwrap(), both);

    // A figure that was made a little better.
    let records = lines(&board);
    let column = |name: &str| records[0].iter().position(|known| known == name).unwrap();
    let (abs_rel, digest) = (column("abs_rel"), column("protocol_digest"));
    let line = records
        .iter()
        .position(|line| line[column("method")] == "a")
        .unwrap();
    let write = |name: &str, column: usize, value: &str| {
        let mut changed = records.clone();
        changed[line][column] = value.to_owned();
        let mut csv = strat_csv::Writer::new(fs::File::create(world.path(name)).unwrap());
        for record in changed {
            csv.write_record(record).unwrap();
        }
        csv.flush().unwrap();
    };
    write("better.csv", abs_rel, "0.001");
    bench(&["verify-leaderboard", &path("better.csv"), "--rows", &a, &b])
        .code(1)
        .says("abs_rel");
    bench(&[
        "publish",
        "--merge",
        &to,
        &path("better.csv"),
        "--to",
        &path(all),
    ])
    .code(1)
    .says("abs_rel");
    // Other rules under the same name.
    write("rules.csv", digest, "0123");
    bench(&[
        "publish",
        "--merge",
        &to,
        &path("rules.csv"),
        "--to",
        &path(all),
    ])
    .code(1)
    .says("kitti2015");
    assert_eq!(fs::read(world.path(all)).unwrap(), both);
}

#[test]
fn tables_come_back_from_rows() {
    let world = two_runs();
    let out = text(&world.path("tables"));
    let ran = bench(&["render", "--rows", &rows(&world, "a"), "--out", &out]);
    ran.code(0);
    for name in [
        "table_3_1.txt",
        "table_3_1.tex",
        "table_3_1.md",
        "table_3_1.csv",
    ] {
        let of = |out: &str| fs::read_to_string(world.path(out).join(name)).unwrap();
        assert_eq!(of("a"), of("tables"), "{name}");
    }
    let both = bench(&[
        "render",
        "--rows",
        &rows(&world, "a"),
        &rows(&world, "b"),
        "--out",
        &out,
    ]);
    assert!(both.code(0).out.contains("\nb "), "{}", both.out);
}
