//! ONNX files and the metadata in them.
#![no_main]

mod damage;

use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use strat_onnx::graph::{Filter, Geometry, GraphBuilder, GraphError};
use strat_onnx::metadata::{InputRange, ModelMetadata, OutputMeaning, Probe};
use strat_onnx::model;

static VALID: LazyLock<Vec<u8>> = LazyLock::new(|| valid().expect("a small model is built"));

fn valid() -> Result<Vec<u8>, GraphError> {
    let mut graph = GraphBuilder::new("small");
    let dims = ["N".into(), 1.into(), 4.into(), 4.into()];
    let input = graph.input("image", &dims)?;
    let filter = |shape: [usize; 4]| Filter {
        shape,
        weights: vec![0.25; shape.iter().product()],
        bias: vec![0.5; 2],
    };
    let x = graph.conv("conv", input, filter([2, 1, 3, 3]), Geometry::new(1, 1))?;
    let x = graph.max_pool("pool", x, 2, Geometry::new(2, 0))?;
    let x = graph.conv_transpose("up", x, filter([2, 2, 4, 4]), Geometry::new(2, 1))?;
    graph.output("disparity", x)?;
    let mut metadata = ModelMetadata::new(OutputMeaning::DisparityFraction, InputRange::Unit, 4, 4);
    metadata.probe = Probe::record(4, 4, &[0.125; 32]).ok();
    graph.finish(Some(&metadata))
}

fuzz_target!(|data: &[u8]| {
    let bytes = damage::damaged(&VALID, data);
    match model::inspect(&bytes, "x.onnx") {
        Ok(info) => assert!(info.external_files.is_empty()),
        Err(error) => assert!(!error.to_string().is_empty()),
    }
});
