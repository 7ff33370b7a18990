//! Memory over many steps; a process of its own, so that no other test's memory counts.
#![cfg(target_os = "linux")]

use strat_train::config::{Config, Preset};
use strat_train::data::loader::Batch;
use strat_train::device::DeviceChoice;
use strat_train::training::schedule::Timeline;
use strat_train::training::trainer::Trainer;

/// As `train` has it.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Bytes of memory that this process holds.
fn resident() -> f64 {
    let text = std::fs::read_to_string("/proc/self/statm").unwrap();
    let pages: f64 = text.split_whitespace().nth(1).unwrap().parse().unwrap();
    pages * 4096.0
}

#[test]
fn five_hundred_steps_take_no_more_memory_than_a_hundred() {
    let settings = [
        "network.width=1/32",
        "discriminator.width=1/32",
        "batch=1",
        "input.width=64",
    ];
    let settings = settings.map(str::to_owned);
    let config = Config::resolve("kitti-strat", Some(Preset::Tiny), &settings).unwrap();
    let timeline = Timeline::new(&config, 100);
    let mut trainer = Trainer::new(&config, None, &DeviceChoice::Cpu.open().unwrap());
    let mut after_a_hundred = 0.0;
    for step in 0..500 {
        let view = |salt: u64| {
            let wave = |i: u64| 0.5 + 0.4 * ((i * 37 + step * 11 + salt) as f32 * 0.01).sin();
            (0..3 * 64 * 64).map(wave).collect()
        };
        let batch = Batch {
            left: view(0),
            right: view(5),
            samples: 1,
            indices: vec![0],
            warnings: Vec::new(),
        };
        trainer.step(&config, &timeline, step, vec![batch]).unwrap();
        if step == 99 {
            after_a_hundred = resident();
        }
    }
    let growth = resident() - after_a_hundred;
    // A forward pass whose graph stays behind holds 1.1 MB: 400 of them are 450 MB.
    eprintln!("{growth} bytes more after 500 steps than after 100");
    assert!(growth < 8e6, "{growth} bytes");
}
