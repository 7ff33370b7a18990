//! A leaderboard from the command line: what was measured is published, checked and shown.

use std::fs;

use assert_cmd::Command;
use strat_splits::Split;

use crate::command::{Ran, run, text};
use crate::fixtures::write_model;
use crate::world::World;

fn bench(words: &[&str]) -> Ran {
    run(Command::cargo_bin("bench").unwrap().args(words))
}

#[test]
fn what_was_measured_is_published_checked_and_shown() {
    let world = World::new(Split::Kitti, 12, false);
    for (out, constant) in [("a", 0.04), ("b", 0.045)] {
        let model = write_model(world.folder.path(), out, constant, 0.01, "kitti");
        let other = write_model(world.folder.path(), "other", 0.05, 0.01, "kitti");
        let models = ["--model", &text(&model), "--model", &text(&other)];
        world.bench("3.1", out, &models).code(0);
    }
    let path = |name: &str| text(&world.path(name));
    let (board, site) = (path("board"), path("site"));
    bench(&["leaderboard", "check", &board])
        .code(2)
        .says("bench leaderboard init");
    bench(&[
        "leaderboard",
        "init",
        &board,
        "--title",
        "Ours",
        "--data",
        &path("set"),
    ])
    .code(0);
    bench(&["leaderboard", "init", &board])
        .code(2)
        .says("a leaderboard already");
    let rows = |out: &str| text(&world.path(out).join("rows.csv"));
    let to = |id: &str| text(&world.path("board/submissions").join(id));
    bench(&["publish", "--rows", &rows("a"), "--submission", &to("a")])
        .code(1)
        .says("--model names");
    for out in ["a", "b"] {
        bench(&[
            "publish",
            "--rows",
            &rows(out),
            "--model",
            out,
            "--submission",
            &to(out),
        ])
        .code(0)
        .says("fill in");
    }
    let told = bench(&["leaderboard", "check", &board]);
    told.code(1)
        .says("submissions/a/card.yaml: `licence` is still to be filled in");
    assert!(told.out.starts_with("0 good submissions"), "{}", told.out);
    for out in ["a", "b"] {
        let card = world.path("board/submissions").join(out).join("card.yaml");
        let filled = fs::read_to_string(&card)
            .unwrap()
            .replace("fill in", "nobody");
        fs::write(card, filled).unwrap();
    }
    let good = bench(&["leaderboard", "check", &board]);
    assert!(
        good.code(0)
            .out
            .starts_with("2 good submissions, 2 lines derived again"),
        "{}",
        good.out
    );
    bench(&["leaderboard", "page", &board, "--out", &site]).code(0);
    bench(&["leaderboard", "page", &board, "--out", &path("a")]).code(0);
    bench(&["leaderboard", "page", &board, "--out", &to("a")])
        .code(2)
        .says("inside the input");
    let page = fs::read_to_string(world.path("site/protocols/kitti2015.html")).unwrap();
    assert!(page.contains("Rendered images, not KITTI") && page.contains(">published<"));
    // A leaderboard file is printed, and lines are added to one as before.
    let lines = path("lines.csv");
    bench(&["publish", "--rows", &rows("a"), "--to", &lines]).code(0);
    let shown = bench(&["leaderboard", "show", &lines]);
    assert!(
        shown.code(0).out.contains("Ours - StrAT") && shown.out.contains("12/200"),
        "{}",
        shown.out
    );
    bench(&["publish", "--rows", &rows("a")]).code(2);
}
