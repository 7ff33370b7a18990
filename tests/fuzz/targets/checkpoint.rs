//! Checkpoints of a training, whose files bear the right digests.
#![no_main]

mod damage;

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use strat_train::config::{Config, Preset};
use strat_train::device::DeviceChoice;
use strat_train::training::{
    checkpoint::{Checkpoint, State},
    trainer::Trainer,
};

struct Valid {
    config: Config,
    parts: BTreeMap<String, Vec<u8>>,
}

static VALID: LazyLock<Valid> = LazyLock::new(|| {
    let settings = ["network.width=1/32", "discriminator.width=1/32"];
    let config = Config::resolve(
        "kitti-strat",
        Some(Preset::Tiny),
        &settings.map(str::to_owned),
    )
    .expect("a small network");
    let device = DeviceChoice::Cpu.open().expect("the processor");
    let parts = Trainer::new(&config, None, &device).to_parts();
    Valid {
        parts: parts.expect("a checkpoint"),
        config,
    }
});

fuzz_target!(|data: &[u8]| {
    let Some((which, data)) = data.split_first() else {
        return;
    };
    let mut parts = VALID.parts.clone();
    let chosen = usize::from(*which) % parts.len();
    if let Some(part) = parts.values_mut().nth(chosen) {
        *part = damage::damaged(part, data);
    }
    let checkpoint = Checkpoint {
        state: State::new(1, 1, String::new(), String::new(), None),
        parts,
    };
    let device = DeviceChoice::Cpu.open().expect("the processor");
    let _ = Trainer::from_checkpoint(&VALID.config, &device, &checkpoint, Path::new("step-1"));
});
