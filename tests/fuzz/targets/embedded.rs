//! ONNX files loaded and run by the embedded runtime. What panics inside the runtime is a sentence; nothing
//! else may, and nothing may take long or fill the memory.
#![no_main]

mod damage;
mod small;

use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use strat_onnx::embedded::EmbeddedSession;

static VALID: LazyLock<Vec<u8>> =
    LazyLock::new(|| small::network().expect("a small model is built"));

fuzz_target!(|data: &[u8]| {
    let bytes = damage::damaged(&VALID, data);
    let Ok(session) = EmbeddedSession::from_bytes(bytes, "x.onnx", Some(1)) else {
        return;
    };
    let Some(input) = session.inputs().first() else {
        return;
    };
    let [channels, height, width] = small::INPUT;
    let values = vec![0.5; channels * height * width];
    if let Ok(outputs) = session.run(&input.name, &[1, channels, height, width], &values) {
        for (_, shape, values) in outputs {
            assert_eq!(shape.iter().product::<usize>(), values.len());
        }
    }
});
