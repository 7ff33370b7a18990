//! A network of three layers as ONNX.

use strat_onnx::graph::{Filter, Geometry, GraphBuilder, GraphError};
use strat_onnx::metadata::{InputRange, ModelMetadata, OutputMeaning, Probe};

/// Shape of its input but for the first size, which is free.
pub const INPUT: [usize; 3] = [1, 4, 4];

/// The file, with metadata and a probe.
pub fn network() -> Result<Vec<u8>, GraphError> {
    let mut graph = GraphBuilder::new("small");
    let [channels, height, width] = INPUT;
    let dims = ["N".into(), channels.into(), height.into(), width.into()];
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
