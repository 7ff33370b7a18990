//! Builds the ONNX graph of a convolutional network and encodes it.
//!
//! Operators follow the ONNX specification at opset 17 (IR version 8). Every attribute that a
//! runtime could default is written out: some runtimes refuse a `Conv` without `strides`. Shapes
//! are inferred while building, so a wrong channel count is an error at the call that caused it
//! and not at the first run in some runtime.
//!
//! Only what an encoder-decoder for images needs is here: `f32` values in `NCHW` order. Weights
//! stay inside the file, which the format limits to 2 GiB.

mod builder;
mod encode;
mod ops;
mod shapes;

pub use builder::{GraphBuilder, IR_VERSION, OPSET, PRODUCER, Value};
pub use shapes::{Dim, Filter, Geometry, GraphError, dims_text};
