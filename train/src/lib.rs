//! Structured adversarial training for stereo-supervised monocular depth, in burn.
//!
//! The only crate of the workspace that knows burn. The networks, their losses and the export
//! to ONNX are in [`generator`], [`discriminator`], [`layers`], [`sampler`], [`losses`] and
//! [`export`]; what trains them is in [`config`], [`schedule`], [`augment`], [`data`],
//! [`step`], [`validation`], [`tensorboard`], [`checkpoint`] and [`run`]; [`cli`] is the `train` command.
//!
//! Formulas and decisions are those of PROTOCOL section 4. Evaluation for the tables is not
//! here: `bench` does it from the exported model.

pub mod augment;
pub mod checkpoint;
pub mod cli;
pub mod config;
pub mod data;
pub mod device;
pub mod discriminator;
pub mod error;
pub mod export;
pub mod generator;
mod kernels;
pub mod layers;
pub mod losses;
pub mod memory;
pub mod random;
pub mod run;
pub mod sampler;
pub mod schedule;
pub mod start;
pub mod step;
pub mod tensorboard;
pub mod validation;

pub use error::{Error, Result};
