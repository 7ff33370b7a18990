//! Runs ONNX depth models and produces the thesis' tables, rows and leaderboards.
//!
//! [`cli`] is the `bench` command. [`runtime`] finds, installs and opens ONNX Runtime and runs a
//! graph, [`model`] says what its tensors mean, [`evaluate`] takes a prepared set through models
//! and metrics and writes what comes out; [`rows`] works on rows alone. [`quantity`] turns
//! predictions into depth and files, [`view`] is what of an image a model is shown, [`draw`] makes pictures, [`matching`] asks how
//! often photometric matching is right, [`latency`] times models, [`cues`]
//! asks which depth cues they use, [`study`] which variant of several is better, [`report`] makes one
//! page of all results. [`protocol_file`]
//! reads rules of the user's own.
//!
//! This is the only crate that knows ONNX Runtime. Metrics, protocols and the contents of tables
//! are defined in `strat-metrics`, files of a prepared set in `strat-store`. Nothing is fetched
//! from a network except by [`runtime::install`].

pub mod cli;
pub mod cues;
pub mod draw;
pub mod evaluate;
pub mod figures;
pub mod images;
pub mod latency;
pub mod maps;
pub mod matching;
pub mod model;
mod notes;
pub mod protocol_file;
pub mod quantity;
pub mod report;
pub mod rows;
pub mod runtime;
pub mod study;
pub mod view;
