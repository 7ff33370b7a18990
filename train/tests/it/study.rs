//! Studies as they are typed: done, killed, resumed, refused.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

const BASE: &str = "\
network: {width: 1/32}
discriminator: {width: 1/16, patch: 64}
input: {width: 128, height: 64}
epochs: 4
batch: 2
pictures: {every: 0}
validation: {every: 2}
learning_rate: 0.001
";

const STUDY: &str = "\
variants:
  no-adv: {variant: no-adv}
  strat:
seeds: [1, 2]
";

const NAMES: [&str; 4] = ["no-adv@1", "strat@1", "no-adv@2", "strat@2"];

/// A folder with a set, a base and a study.
struct Place(tempfile::TempDir);

impl Place {
    fn new() -> Self {
        let place = Self(tempfile::tempdir().unwrap());
        crate::prepared::write(&place.at("set"), 7, 3);
        place.write("base.yaml", BASE);
        let base = place.at("base.yaml");
        place.write("study.yaml", &format!("base: {}\n{STUDY}", base.display()));
        place
    }

    fn at(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn write(&self, name: &str, text: &str) {
        std::fs::write(self.at(name), text).unwrap();
    }

    /// The study in `out`.
    fn study(&self, out: &str, more: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_train"));
        command.arg("study").arg(self.at("study.yaml"));
        command.arg("--out").arg(self.at(out));
        command.arg("--data").arg(self.at("set")).args(more);
        command
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        command
    }

    fn run(&self, out: &str, more: &[&str]) -> (Option<i32>, String, String) {
        ended(self.study(out, more).spawn().unwrap())
    }

    /// A run made by hand.
    fn by_hand(&self, out: &str, name: &str, settings: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_train"));
        command.arg("--config").arg(self.at("base.yaml"));
        command.arg("--data").arg(self.at("set"));
        command
            .arg("--out")
            .arg(self.at(out).join("runs").join(name));
        command.arg("--quiet");
        for setting in settings {
            command.args(["--set", setting]);
        }
        command
    }
}

fn ended(child: Child) -> (Option<i32>, String, String) {
    let output = child.wait_with_output().unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    (
        output.status.code(),
        text(output.stdout),
        text(output.stderr),
    )
}

/// Everything that the runs compute: weights, every number of every step, scores.
fn assert_same_study(a: &Path, b: &Path) {
    for name in NAMES {
        for file in [
            "model.onnx",
            "scalars.csv",
            "validation.csv",
            "diagnostics.csv",
            "config.yaml",
        ] {
            let bytes =
                |study: &Path| std::fs::read(study.join("runs").join(name).join(file)).unwrap();
            assert!(bytes(a) == bytes(b), "{file} of {name} differs");
        }
    }
    for file in ["study.yaml", "runs.csv"] {
        let text = |study: &Path| std::fs::read_to_string(study.join(file)).unwrap();
        assert_eq!(text(a), text(b));
    }
}

/// Steps that the runs of a study have written down.
fn steps(study: &Path) -> usize {
    let of = |name: &&str| {
        let table = study.join("runs").join(name).join("scalars.csv");
        std::fs::read_to_string(table).map_or(0, |text| text.lines().skip(1).count())
    };
    NAMES.iter().map(of).sum()
}

#[test]
fn a_study_killed_again_and_again_ends_with_the_same_files() {
    // The number of kills can be raised: STRAT_KILLS=20 cargo test --test it a_study_killed
    let kills: usize = std::env::var("STRAT_KILLS").map_or(5, |text| text.parse().unwrap());
    let place = Place::new();
    let (code, out, text) = place.run("whole", &["--quiet"]);
    assert_eq!(code, Some(0), "{text}");
    assert!(out.trim_end().ends_with("runs.csv"), "{out}");
    let list = std::fs::read_to_string(place.at("whole/runs.csv")).unwrap();
    let lines: Vec<&str> = list.lines().collect();
    assert_eq!(lines[0], "name,variant,seed,split,data,folder");
    assert!(lines[1].starts_with("no-adv@1,no-adv,1,kitti,"), "{list}");
    assert!(lines[4].ends_with(",runs/strat@2"), "{list}");

    let mut random = ChaCha8Rng::seed_from_u64(3);
    let mut below = |bound: u32| (random.next_u32() % bound) as usize;
    let (mut hit, mut rounds) = (0, 0);
    while hit < kills {
        rounds += 1;
        let name = format!("parts-{rounds}");
        let parts = place.at(&name);
        for kill in 0..4 {
            if kill % 2 == 0 {
                // The study and whichever of its runs comes that far end before a change of the file
                // system, as in a power cut.
                let mut command = place.study(&name, &["--quiet"]);
                command.env("STRAT_FAULT_AT", (1 + below(60)).to_string());
                let (code, _, text) = ended(command.spawn().unwrap());
                assert_ne!(code, Some(2), "{text}");
                hit += usize::from(code != Some(0));
            } else {
                let mut child = place
                    .study(&name, &["--quiet", "--jobs", "2"])
                    .spawn()
                    .unwrap();
                let wanted = steps(&parts) + below(20);
                while steps(&parts) < wanted && child.try_wait().unwrap().is_none() {
                    std::thread::yield_now();
                }
                hit += usize::from(child.try_wait().unwrap().is_none());
                // Its runs end by themselves.
                child.kill().unwrap();
                let (code, _, text) = ended(child);
                assert!(matches!(code, None | Some(0)), "{code:?}: {text}");
            }
        }
        let (code, _, text) = place.run(&name, &["--quiet"]);
        assert_eq!(code, Some(0), "{text}");
        assert_same_study(&place.at("whole"), &parts);
    }
}

#[test]
fn a_signal_ends_a_study_with_checkpoints_and_the_next_call_goes_on() {
    let place = Place::new();
    let (code, _, text) = place.run("whole", &["--quiet"]);
    assert_eq!(code, Some(0), "{text}");
    let child = {
        let mut child = place.study("parts", &["--jobs", "2"]).spawn().unwrap();
        while steps(&place.at("parts")) < 3 && child.try_wait().unwrap().is_none() {
            std::thread::yield_now();
        }
        child
    };
    let told = Command::new("kill")
        .args(["-TERM", &child.id().to_string()])
        .status();
    assert!(told.unwrap().success());
    let (code, _, text) = ended(child);
    assert_eq!(code, Some(1), "{text}");
    assert!(
        text.contains("interrupted; the same command goes on"),
        "{text}"
    );
    assert!(!text.contains("failed"), "{text}");
    // What was written down is in a checkpoint.
    for name in &NAMES[..2] {
        let run = place.at("parts/runs").join(name);
        let lines =
            std::fs::read_to_string(run.join("scalars.csv")).map_or(0, |t| t.lines().count());
        if lines > 1 && !run.join("model.onnx").exists() {
            let newest = run.join(format!("checkpoints/step-{:08}", lines - 1));
            assert!(newest.is_dir(), "{} is missing", newest.display());
        }
    }
    let (code, _, text) = place.run("parts", &[]);
    assert_eq!(code, Some(0), "{text}");
    assert!(text.contains("strat@2 finished after"), "{text}");
    assert!(text.contains("4 of 4 runs are finished"), "{text}");
    assert_same_study(&place.at("whole"), &place.at("parts"));
}

#[test]
fn runs_made_by_hand_are_taken_and_listed() {
    let place = Place::new();
    let by_hand = |name: &str, settings: &[&str]| {
        let output = place.by_hand("s", name, settings).output().unwrap();
        assert!(
            output.status.success(),
            "{}",
            String::from_utf8_lossy(&output.stderr)
        );
    };
    by_hand("no-adv@1", &["variant=no-adv", "seed=1"]);
    by_hand("strat@2", &["seed=2", "max_steps=4", "validation.every=0"]);
    by_hand("strat@1", &["seed=7"]);
    let model = std::fs::read(place.at("s/runs/no-adv@1/model.onnx")).unwrap();

    let (code, out, text) = place.run("s", &["--dry-run"]);
    assert_eq!(code, Some(0), "{text}");
    let state = |name: &str| {
        let line = out.lines().find(|line| line.starts_with(name)).unwrap();
        line.split_whitespace()
            .skip(1)
            .collect::<Vec<_>>()
            .join(" ")
    };
    assert!(state("no-adv@1").starts_with("finished 0"), "{out}");
    assert!(
        state("strat@2").starts_with("begun, epoch 2 of 4 8 "),
        "{out}"
    );
    assert!(state("no-adv@2").starts_with("not begun 12 "), "{out}");
    assert!(state("strat@1").starts_with("cannot be used 0"), "{out}");
    assert!(out.contains("`seed: 7` is now `seed: 1`"), "{out}");
    assert!(
        out.contains("4 runs: 1 finished, 1 begun, 1 not begun; 20 steps and 4 validations, about"),
        "{out}"
    );
    assert!(out.contains("one after another; validations are "), "{out}");
    let (code, out, text) = place.run("s", &["--dry-run", "--jobs", "2"]);
    assert_eq!(code, Some(0), "{text}");
    assert!(
        out.contains("with 2 side by side; validations are "),
        "{out}"
    );
    assert!(!place.at("s/study.yaml").exists());

    // What cannot be used costs itself.
    let (code, _, text) = place.run("s", &["--quiet"]);
    assert_eq!(code, Some(1), "{text}");
    assert!(text.contains("1 of 4 runs failed: strat@1"), "{text}");
    assert!(place.at("s/runs/strat@2/model.onnx").exists());
    assert!(place.at("s/runs/no-adv@2/model.onnx").exists());
    assert_eq!(
        std::fs::read(place.at("s/runs/no-adv@1/model.onnx")).unwrap(),
        model
    );
    std::fs::remove_dir_all(place.at("s/runs/strat@1")).unwrap();
    let (code, _, text) = place.run("s", &["--quiet", "--index", "1"]);
    assert_eq!(code, Some(0), "{text}");

    // The same weights as of a study alone.
    let (code, _, text) = place.run("whole", &["--quiet", "--only", "strat@2"]);
    assert_eq!(code, Some(0), "{text}");
    let model =
        |study: &str| std::fs::read(place.at(study).join("runs/strat@2/model.onnx")).unwrap();
    assert!(model("s") == model("whole"));
}

#[test]
fn a_study_may_grow_but_not_change() {
    let place = Place::new();
    let change = |from: &str, to: &str| {
        let text = std::fs::read_to_string(place.at("study.yaml")).unwrap();
        assert!(text.contains(from));
        place.write("study.yaml", &text.replace(from, to));
    };
    change("[1, 2]", "[1]");
    let (code, _, text) = place.run("s", &["--quiet", "--only", "no-adv@1"]);
    assert_eq!(code, Some(0), "{text}");
    change("[1]", "[2, 1]");
    let (code, _, text) = place.run("s", &["--quiet", "--only", "no-adv@1"]);
    assert_eq!(code, Some(0), "{text}");
    let list = std::fs::read_to_string(place.at("s/runs.csv")).unwrap();
    assert_eq!(list.lines().count(), 5, "{list}");
    for (from, to, part) in [
        ("[2, 1]", "[2]", "it has the seed 1"),
        (
            "strat:\n",
            "strat: {learning_rate: 0.002}\n",
            "of the variant `strat`, `learning_rate: 0.001` is now",
        ),
        ("  strat:\n", "", "it has the variant `strat`"),
    ] {
        let before = std::fs::read_to_string(place.at("study.yaml")).unwrap();
        change(from, to);
        let (code, _, text) = place.run("s", &["--quiet"]);
        assert_eq!(code, Some(2), "{text}");
        assert!(
            text.contains("another study") && text.contains(part),
            "{text}"
        );
        place.write("study.yaml", &before);
    }
    assert_eq!(
        std::fs::read_to_string(place.at("s/runs.csv")).unwrap(),
        list
    );
}

#[test]
fn mistakes_are_told_before_any_work() {
    let place = Place::new();
    let text = std::fs::read_to_string(place.at("study.yaml")).unwrap();
    for (study, more, part) in [
        (
            format!("{text}sedes: 1\n"),
            &[][..],
            "did you mean `seeds`?",
        ),
        (
            text.replace("  strat:\n", "  strat: {epoch: 3}\n"),
            &[],
            "variant `strat`: unknown setting `epoch`: no `epoch` (did you mean `epochs`?)",
        ),
        (text.clone(), &["--only", "strat@7"], "no run strat@7"),
        (text.clone(), &["--index", "4"], "has 4 runs"),
        (
            text.replace("base.yaml", "nowhere.yaml"),
            &[],
            "nowhere.yaml",
        ),
    ] {
        place.write("study.yaml", &study);
        let (code, _, text) = place.run("s", more);
        assert_eq!(code, Some(2), "{text}");
        assert!(text.contains(part), "{text}");
        assert!(!place.at("s").exists());
    }
    place.write("study.yaml", &text);
    std::fs::create_dir(place.at("theirs")).unwrap();
    place.write("theirs/study.yaml", "mine: true\n");
    let (code, _, text) = place.run("theirs", &[]);
    assert_eq!(code, Some(2), "{text}");
    assert!(text.contains("not written by `train study`"), "{text}");
}
