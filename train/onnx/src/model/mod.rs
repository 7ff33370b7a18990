//! Reads an ONNX file's description and refuses files that would harm a runtime.
//!
//! Everything is judged from the decoded protobuf, before a runtime sees the file. That gives the
//! same sentences whatever runtime follows, and stops files that crash or hang one: a convolution
//! with a group, stride or dilation below 1 (ONNX Runtime 1.31 divides by it), constants whose
//! length contradicts their shape, external data outside the model's folder, and bytes that are no
//! well-formed protobuf (rten 0.27 can loop on them). It does not prove a model harmless: one that
//! asks for more memory than there is can still end the process, so models from strangers belong
//! in a process of their own.
//!
//! Operators are counted but not interpreted; any opset and any operator is accepted here.

mod error;
mod external;
mod file;
mod info;
mod walk;

pub use error::ReadError;
pub(crate) use file::inspect_owned;
pub use file::{inspect, read, read_with_bytes, with_metadata};
pub use info::{ElementType, ModelFile, ModelInfo, TensorInfo};
