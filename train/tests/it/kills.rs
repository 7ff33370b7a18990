//! Runs that are killed or interrupted, and go on as if nothing had happened.

use std::path::Path;
use std::process::{Child, Command, Stdio};

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

const SETTINGS: [&str; 9] = [
    "network.width=1/32",
    "discriminator.width=1/16",
    "epochs=16",
    "batch=2",
    "pictures.every=0",
    "validation.every=2",
    "checkpoint.every=1",
    "learning_rate=0.001",
    "seed=5",
];

/// Starts a run, or goes on with the one in `out` if there is one.
fn start(data: &Path, out: &Path) -> Child {
    let mut command = Command::new(env!("CARGO_BIN_EXE_train"));
    command.args(["--config", "kitti-strat", "--preset", "tiny", "--quiet"]);
    for setting in SETTINGS {
        command.args(["--set", setting]);
    }
    if out.join("run.json").exists() {
        command.arg("--resume");
    }
    command.arg("--data").arg(data).arg("--out").arg(out);
    command.stdout(Stdio::null()).stderr(Stdio::piped());
    command.spawn().unwrap()
}

/// Steps written down so far.
fn steps(out: &Path) -> usize {
    std::fs::read_to_string(out.join("scalars.csv")).map_or(0, |text| text.lines().count())
}

/// Waits until the run has written `more` further steps or has ended.
fn watch(child: &mut Child, out: &Path, more: usize) {
    let wanted = steps(out) + more;
    while steps(out) < wanted && child.try_wait().unwrap().is_none() {
        std::thread::yield_now();
    }
}

fn finish(child: Child) -> (Option<i32>, String) {
    let output = child.wait_with_output().unwrap();
    (
        output.status.code(),
        String::from_utf8_lossy(&output.stderr).into_owned(),
    )
}

fn assert_same_run(a: &Path, b: &Path) {
    for name in ["scalars.csv", "validation.csv", "model.onnx"] {
        let bytes = |folder: &Path| std::fs::read(folder.join(name)).unwrap();
        assert!(bytes(a) == bytes(b), "{name} differs");
    }
}

#[test]
fn a_run_killed_again_and_again_ends_with_the_same_weights() {
    // The number of kills can be raised: STRAT_KILLS=20 cargo test --test it kills
    let kills: usize = std::env::var("STRAT_KILLS").map_or(5, |text| text.parse().unwrap());
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("set");
    crate::prepared::write(&data, 7, 3);
    let whole = folder.path().join("whole");
    let (code, text) = finish(start(&data, &whole));
    assert_eq!(code, Some(0), "{text}");

    let mut random = ChaCha8Rng::seed_from_u64(1);
    let mut below = |bound: u32| (random.next_u32() % bound) as usize;
    let (mut hit, mut rounds) = (0, 0);
    while hit < kills {
        rounds += 1;
        assert!(
            rounds < 20 * kills,
            "{hit} of {kills} kills hit a run in {rounds} rounds"
        );
        let parts = folder.path().join(format!("parts-{rounds}"));
        for kill in 0..5 {
            let mut child = start(&data, &parts);
            // The first before anything is there, later ones anywhere within the next epochs.
            watch(&mut child, &parts, if kill == 0 { 0 } else { below(7) });
            for _ in 0..below(2000) {
                std::thread::yield_now();
            }
            let running = child.try_wait().unwrap().is_none();
            child.kill().unwrap();
            let (code, text) = finish(child);
            // Killed, or done before it could be.
            assert!(matches!(code, None | Some(0)), "{code:?}: {text}");
            hit += usize::from(running);
            if !running {
                break;
            }
        }
        let (code, text) = finish(start(&data, &parts));
        assert_eq!(code, Some(0), "{text}");
        assert_same_run(&whole, &parts);
    }
}

#[test]
fn a_signal_ends_with_a_checkpoint_of_the_last_step() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("set");
    crate::prepared::write(&data, 7, 3);
    let whole = folder.path().join("whole");
    finish(start(&data, &whole));

    // Ctrl-C, a cluster's time limit, a closed terminal.
    for signal in ["-INT", "-TERM", "-HUP"] {
        let parts = folder.path().join(signal);
        let mut child = start(&data, &parts);
        watch(&mut child, &parts, 3);
        let told = Command::new("kill")
            .args([signal, &child.id().to_string()])
            .status();
        assert!(told.unwrap().success());
        let (code, text) = finish(child);
        assert_eq!(code, Some(1), "{text}");
        assert!(text.contains("interrupted after step"), "{text}");
        // The header and one line a step; the checkpoint is of the last of them.
        let done = steps(&parts) - 1;
        let newest = parts.join(format!("checkpoints/step-{done:08}"));
        assert!(newest.is_dir(), "{} is missing", newest.display());
        assert!(!parts.join("model.onnx").exists());

        let (code, text) = finish(start(&data, &parts));
        assert_eq!(code, Some(0), "{text}");
        assert_same_run(&whole, &parts);
    }
}
