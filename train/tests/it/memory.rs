//! What is predicted and told of the memory of a step, beside what steps take.

use assert_cmd::Command;
use strat_train::config::{Config, Preset};
use strat_train::device::DeviceChoice;
use strat_train::training::memory::{Measured, Need};
use strat_train::training::trainer::Trainer;

/// Peak memory of three steps, measured in a process of its own.
fn measured(preset: &str, settings: &[&str]) -> Measured {
    let mut command = Command::cargo_bin("train").unwrap();
    command.args(["measure", "--config", "kitti-strat", "--preset", preset]);
    for setting in settings {
        command.args(["--set", setting]);
    }
    let output = command.output().unwrap();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    serde_json::from_slice(&output.stdout).unwrap()
}

#[cfg(unix)]
#[test]
fn the_prediction_is_near_the_measurement() {
    for (name, preset, batch, settings) in [
        ("quarter", Preset::Quarter, 2, &[][..]),
        (
            "quarter",
            Preset::Quarter,
            8,
            &["discriminator.sharing=per-view"][..],
        ),
        (
            "quarter",
            Preset::Quarter,
            8,
            &["network.decoder=nearest-conv", "variant=no-adv"][..],
        ),
    ] {
        let batch_setting = format!("batch={batch}");
        let settings: Vec<&str> = settings.iter().copied().chain([&*batch_setting]).collect();
        let owned: Vec<String> = settings.iter().map(|s| (*s).to_owned()).collect();
        let config = Config::resolve("kitti-strat", Some(preset), &owned).unwrap();
        let trainer = Trainer::new(&config, None, &DeviceChoice::Cpu.open().unwrap());
        let predicted = Need::predict(&config, &trainer).bytes(batch);
        let found = measured(name, &settings).peak_bytes;
        let ratio = predicted / found;
        eprintln!("{name} {settings:?}: {found} bytes measured, {ratio:.2} of it predicted");
        assert!(
            (0.75..1.33).contains(&ratio),
            "{name} {settings:?}: {ratio}"
        );
    }
}

#[cfg(unix)]
#[test]
fn estimate_tells_memory_and_time_by_batch_size() {
    let train = |words: &str| {
        let output = Command::cargo_bin("train")
            .unwrap()
            .args(words.split_whitespace())
            .output()
            .unwrap();
        let out = String::from_utf8(output.stdout).unwrap();
        assert!(output.status.success(), "{out}");
        out
    };
    let out = train("estimate --config kitti-strat --preset tiny --measure 1,4");
    assert!(out.starts_with("batch  memory"), "{out}");
    assert_eq!(out.matches("measured\n").count(), 2, "{out}");
    assert_eq!(out.matches("extrapolated\n").count(), 3, "{out}");
    assert!(out.contains("free: up to batch"), "{out}");
    let out = train("estimate --config kitti-strat --preset tiny --measure 4 --json");
    let told: serde_json::Value = serde_json::from_str(&out).unwrap();
    assert_eq!(told["measured"][0]["batch"], 4);
    assert!(told["measured"][0]["peak_bytes"].as_f64().unwrap() > 1e7);
    assert!(told["measured"][0]["step_seconds"].as_f64().unwrap() > 0.0);
    assert!(told["largest_batch"].is_null());
}
