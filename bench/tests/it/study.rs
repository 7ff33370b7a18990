//! `bench study` from outside: from run folders to an answer, once and again, from one machine and from
//! two, and from rows alone.

use std::{
    fs,
    path::{Path, PathBuf},
};

use assert_cmd::Command;
use strat_splits::Split;

use crate::command::{Ran, run, text};
use crate::fixtures::write_model;
use crate::world::World;

/// Scenes of stereo 2015: those of 22 images lie in several drives.
const IMAGES: u32 = 22;

/// A run: variant, seed, the disparity that its network predicts, 0 where it is not finished.
type Made = (&'static str, u64, f32);

const ALL: [Made; 6] = [
    ("no-adv", 1, 0.058),
    ("strat", 1, 0.0502),
    ("no-adv", 2, 0.06),
    ("strat", 2, 0.0505),
    ("no-adv", 10, 0.059),
    ("strat", 10, 0.0503),
];

/// The folder of a study that lists all runs and has some of them.
fn study(world: &World, name: &str, runs: &[Made]) -> PathBuf {
    let folder = world.path(name);
    let set = text(&world.path("set"));
    let mut list = "name,variant,seed,split,data,folder\n".to_owned();
    for (variant, seed, _) in ALL {
        list += &format!("{variant}@{seed},{variant},{seed},kitti,{set},runs/{variant}@{seed}\n");
    }
    fs::create_dir_all(folder.join("runs")).unwrap();
    fs::write(folder.join("runs.csv"), list).unwrap();
    for &(variant, seed, disparity) in runs {
        finish(&folder, (variant, seed, disparity));
    }
    folder
}

fn finish(study: &Path, (variant, seed, disparity): Made) {
    let folder = study.join("runs").join(format!("{variant}@{seed}"));
    fs::create_dir_all(&folder).unwrap();
    write_model(&folder, "model", disparity, 0.002, "kitti");
    let validation = format!("step,epoch,abs_rel,rmse\n9,1,{disparity},3\n19,2,0.1,2\n");
    fs::write(folder.join("validation.csv"), validation).unwrap();
    fs::write(folder.join("run.json"), "{\"source\": \"kitti\"}").unwrap();
}

fn bench_study(folders: &[&Path], out: &Path, more: &[&str]) -> Ran {
    let mut command = Command::cargo_bin("bench").unwrap();
    command.args(["study", "--runtime", "embedded"]);
    command.args(folders).arg("--out").arg(out);
    run(command.args(more))
}

/// All files below a folder but records, which name paths and times.
fn files(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let mut found = Vec::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(below) = folders.pop() {
        for entry in fs::read_dir(below).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_none_or(|extension| extension != "yaml") {
                let name = path.strip_prefix(folder).unwrap().to_owned();
                found.push((name, fs::read(&path).unwrap()));
            }
        }
    }
    found.sort();
    found
}

fn read(path: &Path) -> String {
    fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

#[test]
fn finished_runs_become_an_answer_and_are_measured_once() {
    let world = World::new(Split::Kitti, IMAGES, false);
    let folder = study(&world, "study", &ALL);
    let out = world.path("out");
    let ran = bench_study(&[&folder], &out, &[]);
    ran.code(0).says("measuring strat@10 on kitti (6 of 6)");
    let results = out.join("kitti");
    // What was recorded is not what was rendered, whatever the drives are called.
    assert!(!ran.err.contains("LEAKAGE"), "{}", ran.err);
    ran.says("leakage on kitti: 6 of 6 models were trained on no place of its 22 test images; 6 on kitti ")
        .says("images, while these are rendered: other places, also where drives have the same names\n");
    let answer = read(&results.join("answer.txt"));
    assert!(ran.out.ends_with(&answer), "{}", ran.out);
    assert!(
        answer.contains("Abs Rel under kitti2015: 22 images of "),
        "{answer}"
    );
    assert!(answer.contains("strat is better than no-adv: "), "{answer}");
    let table = read(&results.join("ablation_3_1.tex"));
    assert!(
        table.contains("tab:strat-3-1-ablation") && table.contains("$\\pm$"),
        "{table}"
    );
    assert!(read(&results.join("ablation_3_1.txt")).contains("The images are rendered"));
    assert!(read(&results.join("table_3_1.txt")).contains("strat (3 seeds)"));
    let differences = read(&results.join("differences.csv"));
    assert!(
        differences.contains("kitti2015,,abs_rel,no-adv,strat,3,3,22,"),
        "{differences}"
    );
    let variants = read(&results.join("variants.csv"));
    assert!(variants.contains("\nkitti2015,,strat,3,22,"), "{variants}");
    assert!(read(&results.join("curves/curves.csv")).contains("no-adv,validation,abs_rel,1,3,"));
    assert!(read(&results.join("curves/learning.svg")).contains("strat (3 seeds)"));
    let views = read(&results.join("figures/fig_3_10.svg"));
    assert!(views.contains("no-adv@1: right view") && views.contains("strat@1: right view"));
    assert!(read(&results.join("study-results.yaml")).contains("measured: true"));

    let before = files(&out);
    let again = bench_study(&[&folder], &out, &[]);
    again
        .code(0)
        .says("6 of 6 finished runs were measured on kitti before");
    assert!(!again.err.contains("measuring"), "{}", again.err);
    assert_eq!(before, files(&out));
    // A model that is another by now is measured again, and no other.
    finish(&folder, ("strat", 2, 0.07));
    let other = bench_study(&[&folder], &out, &["--force", "--quiet"]);
    other.code(0);
    assert_ne!(answer, read(&results.join("answer.txt")));
    // Results of a run that is gone stay.
    fs::remove_file(folder.join("runs/strat@2/model.onnx")).unwrap();
    bench_study(&[&folder], &out, &[])
        .code(2)
        .says("1 of 6 runs on kitti are not finished: strat@2")
        .says("results of strat@2, which could not be measured now");
    assert!(read(&results.join("answer.txt")).contains("3 seeds"));
}

/// As after a kill at each of the moments that leave something which the next run could stumble over.
#[test]
fn what_an_interruption_left_is_gone_on_with() {
    let world = World::new(Split::Kitti, IMAGES, false);
    let folder = study(&world, "study", &ALL);
    let out = world.path("out");
    let results = out.join("kitti");
    let again = || bench_study(&[&folder], &out, &[]);
    again().code(0);
    let whole = files(&out);
    // A run was measured, and what was kept of the work not yet taken away.
    let measured = results.join("measured").join("strat@1");
    let left = measured.join("unfinished-run.yaml");
    fs::copy(measured.join("run.yaml"), &left).unwrap();
    again().code(0).says("measuring strat@1 on kitti (1 of 1)");
    assert!(!left.exists());
    assert_eq!(files(&out), whole);
    // The first collection had written rows, and neither the record of the rows nor its own.
    let begun = results.join("unfinished-study-results.yaml");
    fs::rename(results.join("study-results.yaml"), &begun).unwrap();
    let rows_begun = results.join("unfinished-run.yaml");
    fs::rename(results.join("run.yaml"), &rows_begun).unwrap();
    fs::write(&rows_begun, "tool: bench\n").unwrap();
    fs::remove_file(results.join("answer.txt")).unwrap();
    again().code(0);
    assert!(!begun.exists() && !rows_begun.exists() && results.join("run.yaml").exists());
    assert_eq!(files(&out), whole);
    // A picture that cannot be written.
    let picture = results.join("figures").join("comparison.svg");
    fs::remove_file(&picture).unwrap();
    fs::create_dir(&picture).unwrap();
    again()
        .code(1)
        .says("no pictures of what variants make of images");
    fs::remove_dir(&picture).unwrap();
    again().code(0);
    assert_eq!(files(&out), whole);
}

#[test]
fn folders_of_two_machines_give_what_one_gives() {
    let world = World::new(Split::Kitti, IMAGES, false);
    let whole = study(&world, "whole", &ALL);
    let (first, second) = ALL.split_at(3);
    let parts = [study(&world, "a", first), study(&world, "b", second)];
    bench_study(&[&whole], &world.path("one"), &["--quiet"]).code(0);
    bench_study(&[&parts[0], &parts[1]], &world.path("two"), &["--quiet"]).code(0);
    assert_eq!(files(&world.path("one")), files(&world.path("two")));
    // Measured one by one, as tasks of a cluster do, in any order.
    let three = world.path("three");
    for number in [4, 0, 5, 1, 3, 2] {
        let only = ["--quiet", "--index", &number.to_string()];
        let ran = bench_study(&[&whole], &three, &only);
        assert_eq!(ran.code(0).out, "");
    }
    let ran = bench_study(&[&whole], &three, &[]);
    ran.code(0)
        .says("6 of 6 finished runs were measured on kitti before");
    assert_eq!(files(&world.path("one")), files(&three));

    // The answer is made of rows alone.
    let rows = world.path("one/kitti/rows.csv");
    let mut command = Command::cargo_bin("bench").unwrap();
    command
        .args(["study", "--rows"])
        .arg(&rows)
        .arg("--out")
        .arg(world.path("rows"));
    let ran = run(&mut command);
    let answer = read(&world.path("one/kitti/answer.txt"));
    assert!(ran.code(0).out.ends_with(&answer), "{}", ran.out);
    for name in [
        "answer.txt",
        "variants.csv",
        "differences.csv",
        "ablation_3_1.md",
    ] {
        let of = |folder: &str| read(&world.path(folder).join(name));
        assert_eq!(of("one/kitti"), of("rows"), "{name}");
    }
}

/// The page has the answer's sentences, and no verdicts between seeds.
#[test]
fn a_report_has_a_section_of_the_study() {
    let world = World::new(Split::Kitti, IMAGES, false);
    let folder = study(&world, "study", &ALL);
    for (variant, seed, _) in ALL {
        let run = folder.join(format!("runs/{variant}@{seed}"));
        let scalars = "step,epoch,discriminator,accuracy_real\n0,1,1.3,0.5\n1,2,1.2,0.75\n";
        fs::write(run.join("scalars.csv"), scalars).unwrap();
        let pulls = format!("step,epoch,gradient_adversarial\n0,1,0.{seed}\n1,2,0.{seed}\n");
        fs::write(run.join("diagnostics.csv"), pulls).unwrap();
    }
    let out = world.path("out");
    bench_study(&[&folder], &out, &["--no-figures"]).code(0);
    let mut command = Command::cargo_bin("bench").unwrap();
    run(command.arg("report").arg(&out)).code(0);
    let page = read(&out.join("report.html"));
    assert!(page.contains("<h2 id=\"study\">Study</h2>"));
    let answer = read(&out.join("kitti/answer.txt"));
    let sentence = answer
        .lines()
        .find(|line| line.starts_with("strat is better than no-adv"));
    let sentence = sentence.unwrap().replace('<', "&lt;");
    assert!(page.contains(&sentence), "{sentence}");
    for part in [
        "Ablation. ",
        "Real patches",
        "Adversarial",
        "strat (3 seeds)",
        "At the last epoch",
    ] {
        assert!(page.contains(part), "{part}");
    }
    // Three runs with one number each, and one mean of seeds 1, 2 and 10: 0.1, 0.2 and 0.10.
    assert!(
        page.contains("0.133 ± 0.058"),
        "the gradients at the last epoch"
    );
    assert!(!page.contains("Which is better, by how much"));

    // Of an answer from rows alone, where these still are.
    let rows = out.join("kitti/rows.csv");
    let alone = world.path("alone");
    let of_rows = ["study", "--rows", &text(&rows), "--out", &text(&alone)];
    run(Command::cargo_bin("bench").unwrap().args(of_rows)).code(0);
    run(Command::cargo_bin("bench")
        .unwrap()
        .arg("report")
        .arg(&alone))
    .code(0);
    assert!(read(&alone.join("report.html")).contains(&sentence));
    fs::remove_file(rows).unwrap();
    run(Command::cargo_bin("bench")
        .unwrap()
        .arg("report")
        .arg(&alone))
    .code(1)
    .says("rows.csv");
}

#[test]
fn another_set_and_another_metric_may_be_asked_for() {
    let world = World::new(Split::Kitti, IMAGES, false);
    let folder = study(&world, "study", &ALL);
    let asked = "tool: train study\nevaluation: {metric: a1, effect: 0.05}\n";
    fs::write(folder.join("study.yaml"), asked).unwrap();
    let other = World::new(Split::Eigen, 4, false);
    let set = text(&other.path("set"));
    let out = world.path("out");
    for (variant, seed, _) in ALL {
        let run = folder.join(format!("runs/{variant}@{seed}/run.json"));
        fs::write(run, "{\"source\": \"rendered\"}").unwrap();
    }
    let ran = bench_study(&[&folder], &out, &["--data", &set, "--no-figures"]);
    // It was trained on the other split and does not name its drives.
    ran.code(0)
        .says("LEAKAGE: model strat@1 was trained on the kitti split")
        .says("leakage on set: 0 of 6 models were trained on no place of its 4 test images; LEAKAGE: no-adv@1,");
    let answer = read(&out.join("set/answer.txt"));
    assert!(
        answer.contains("δ<1.25 under eigen-80: 4 images of 1 drive\n"),
        "{answer}"
    );
    assert!(
        answer.contains("cannot be said: over the drives, it takes at least 3"),
        "{answer}"
    );
    assert!(read(&out.join("set/differences.csv")).contains(",0.05,"));
}

#[test]
fn what_cannot_be_done_is_said() {
    let world = World::new(Split::Kitti, IMAGES, false);
    let folder = study(&world, "study", &[]);
    let out = world.path("out");
    bench_study(&[&folder], &out, &[])
        .code(1)
        .says("no run of the study is finished");
    bench_study(&[&world.path("set")], &out, &[])
        .code(2)
        .says("not the folder of a study");
    finish(&folder, ALL[0]);
    let ran = bench_study(&[&folder], &out, &["--no-figures"]);
    ran.code(1)
        .says("5 of 6 runs on kitti are not finished")
        .says("one variant only");
    assert!(ran.out.contains("1 seed"), "{}", ran.out);
    bench_study(&[&folder], &out, &["--only", "strat@3"])
        .code(2)
        .says("no run strat@3; its runs are, from 0 to 5: no-adv@1, strat@1, no-adv@2");
    bench_study(&[&folder], &out, &["--index", "6"])
        .code(2)
        .says("no run 6");
    bench_study(&[&folder], &out, &["--only", "strat@1"])
        .code(1)
        .says("1 of 1 runs on kitti are not finished: strat@1");
    bench_study(&[&folder], &out, &["--metric", "abs"])
        .code(2)
        .says("the metrics are abs_rel");
    bench_study(&[&folder], &out, &["--table", "3.3"])
        .code(2)
        .says("3.1");
    bench_study(&[&folder], &folder.join("runs/no-adv@1"), &[])
        .code(2)
        .says("inside the input folder");
    fs::create_dir_all(world.path("mine/kitti")).unwrap();
    fs::write(world.path("mine/kitti/answer.txt"), "42").unwrap();
    bench_study(&[&folder], &world.path("mine"), &[])
        .code(2)
        .says("answer.txt");
    // A model that is none costs itself only.
    finish(&folder, ALL[1]);
    fs::write(folder.join("runs/strat@1/model.onnx"), "broken").unwrap();
    bench_study(&[&folder], &out, &["--no-figures"])
        .code(1)
        .says("strat@1");
    let mut command = Command::cargo_bin("bench").unwrap();
    run(command
        .args(["study", "--rows"])
        .arg(world.path("none.csv")))
    .code(1)
    .says("none.csv");
}
