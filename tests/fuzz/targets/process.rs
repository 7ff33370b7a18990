//! What the process of a model answers: frames, and whatever a library prints in between.
#![no_main]

mod damage;

use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use strat_bench::runtime::process::frame;

static VALID: LazyLock<Vec<u8>> = LazyLock::new(|| {
    let mut bytes = Vec::new();
    frame::write(&mut bytes, &("disparity", [1, 1, 2, 3]), &[0.5; 6]).expect("a frame");
    frame::write(&mut bytes, &("end", [0; 4]), &[]).expect("a frame");
    bytes
});

fuzz_target!(|data: &[u8]| {
    let bytes = damage::damaged(&VALID, data);
    let mut input = bytes.as_slice();
    while let Ok(Some(((name, shape), values))) = frame::read::<(String, [usize; 4])>(&mut input) {
        assert!(name.len() + shape.len() + values.len() * 4 <= bytes.len());
    }
});
