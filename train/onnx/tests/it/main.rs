//! ONNX files as others write, read and damage them.

mod network;
mod robustness;
