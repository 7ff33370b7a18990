//! A GPU backend beside the processor.
//!
//! Compiled with `--features wgpu` only. A software driver (Debian's `mesa-vulkan-drivers`) will do:
//!
//! ```text
//! CUBECL_AUTOTUNE_LEVEL=minimal cargo test -p strat-train --features wgpu --test it gpu
//! ```
//!
//! `STRAT_GPU_SIZE=full` takes the full-width networks at 512x256 instead of the tiny ones.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use strat_train::config::{Config, Preset};
use strat_train::device::DeviceChoice;
use strat_train::training::check::{Part, check};
use strat_train::training::folder::RunInfo;
use strat_train::training::options::Options;
use strat_train::training::run::run;

const GPU: DeviceChoice = DeviceChoice::Wgpu(None);

fn assert_computes_right(settings: &[&str]) {
    let settings: Vec<String> = settings.iter().map(|s| (*s).to_owned()).collect();
    let config = Config::resolve("kitti-strat", None, &settings).unwrap();
    let full = std::env::var("STRAT_GPU_SIZE").is_ok_and(|size| size == "full");
    let findings = check(&config, GPU, full)
        .unwrap_or_else(|error| panic!("this test needs a Vulkan driver: {error}"));
    for part in Part::ALL {
        eprintln!("{part}: {:?}", findings.largest(part));
    }
    findings.verdict().unwrap();
}

#[test]
fn a_gpu_computes_what_the_processor_computes() {
    assert_computes_right(&[]);
}

#[test]
fn so_it_does_for_the_other_choices() {
    assert_computes_right(&[
        "discriminator.sharing=per-view",
        "network.decoder=nearest-conv",
        "network.head=sigmoid",
        "objective=monodepth",
    ]);
}

#[test]
fn a_run_says_how_far_its_device_is_from_the_processor() {
    let folder = tempfile::tempdir().unwrap();
    crate::prepared::write(&folder.path().join("set"), 2, 0);
    let settings = ["batch=1", "max_steps=1"].map(ToOwned::to_owned);
    let options = Options {
        config: Config::resolve("kitti-strat", Some(Preset::Tiny), &settings).unwrap(),
        data: folder.path().join("set"),
        out: folder.path().join("run"),
        device: GPU,
        replicas: Vec::new(),
        resume: false,
        force: false,
        quiet: true,
        ignore_memory: false,
        no_check: false,
        stop: Arc::new(AtomicBool::new(false)),
    };
    run(&options).unwrap();
    let info = std::fs::read(options.out.join("run.json")).unwrap();
    let info: RunInfo = serde_json::from_slice(&info).unwrap();
    assert_eq!(info.device_checks.len(), 1);
    let checked = &info.device_checks[0];
    assert_eq!(checked.differences.len(), Part::ALL.len());
    assert!(checked.differences.iter().all(|found| !found.is_wrong()));
}
