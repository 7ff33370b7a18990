//! ONNX files and the metadata in them.
#![no_main]

mod damage;
mod small;

use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use strat_onnx::model;

static VALID: LazyLock<Vec<u8>> =
    LazyLock::new(|| small::network().expect("a small model is built"));

fuzz_target!(|data: &[u8]| {
    let bytes = damage::damaged(&VALID, data);
    match model::inspect(&bytes, "x.onnx") {
        Ok(info) => assert!(info.external_files.is_empty()),
        Err(error) => assert!(!error.to_string().is_empty()),
    }
});
