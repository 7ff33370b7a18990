//! ONNX files: writing a network, reading any model's description, and running it without a
//! system library.
//!
//! - [`graph`] builds a network operator by operator and encodes it (opset 17, IR 8).
//! - [`metadata`] is what `train` tells `bench` about a model, stored inside the file.
//! - [`model`] reads and checks an ONNX file before any runtime sees it.
//! - [`embedded`] runs a model with rten, a runtime in pure Rust.
//! - [`proto`] holds the messages of the format itself.
//!
//! This crate knows neither the training framework nor ONNX Runtime: `train` walks its network and
//! calls [`graph::GraphBuilder`], `bench` opens its sessions from a path that [`model::read`] has
//! accepted.

pub mod embedded;
pub mod graph;
pub mod metadata;
pub mod model;
pub mod proto;
