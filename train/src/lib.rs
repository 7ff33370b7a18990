//! Structured adversarial training for stereo-supervised monocular depth, in burn.
//!
//! The only crate of the workspace that knows burn. [`network`] holds the two networks, [`loss`] what
//! they minimise, [`data`] the pairs they learn from, [`training`] the run itself, [`study`] many of them, [`config`] its
//! settings and [`export`] the way to ONNX; [`cli`] is the `train` command.
//!
//! Formulas and decisions are those of PROTOCOL section 4. Evaluation for the tables is not
//! here: `bench` does it from the exported model.

pub mod cli;
pub mod config;
pub mod data;
pub mod device;
pub mod error;
pub mod export;
mod kernels;
pub mod loss;
pub mod network;
pub mod random;
pub mod study;
pub mod training;

pub use error::{Error, Result};
