//! Runs ONNX depth models and produces the thesis' tables, rows and leaderboards.
//!
//! The `bench` command ([`cli`]) in parts: [`setup`] finds or installs ONNX Runtime, [`runtime`]
//! runs a graph with it or with the embedded runtime, [`model`] says what the tensors mean,
//! [`predict`] takes a prepared set through a model and the metrics, [`tables`] writes what comes
//! out. [`maps`] turns predictions into depth and files for `bench predict`, [`latency`] times
//! models, [`devices`] says what there is to run them on. [`baseline`], [`predictions`] and [`pictures`] are what their names say.
//! [`cues`] asks which depth cues a model uses, [`figures`] draws models side by side, [`report`] makes one page of all results.
//! [`protocols`] reads rules of the user's own; [`compare`] and [`publish`] work on rows alone.
//!
//! This is the only crate that knows ONNX Runtime. Metrics, protocols and the contents of tables
//! are defined in `strat-metrics`, files of a prepared set in `strat-store`. Nothing is fetched
//! from a network except by [`setup::install`] and [`setup::ensure_runtime`].

pub mod baseline;
pub mod cli;
pub mod compare;
pub mod cues;
pub mod devices;
pub mod figures;
pub mod journal;
pub mod latency;
pub mod leakage;
pub mod maps;
pub mod model;
mod native;
pub mod parts;
pub mod pictures;
pub mod plot;
pub mod predict;
pub mod predictions;
pub mod protocols;
pub mod publish;
pub mod report;
pub mod runtime;
pub mod saved;
pub mod setup;
pub mod tables;

pub use native::CudaUnavailable;
