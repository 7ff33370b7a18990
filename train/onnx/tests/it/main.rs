//! ONNX files as others write, read and damage them.

mod forms;
mod network;
mod robustness;
