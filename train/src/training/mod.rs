//! A training run: its schedule, its steps, its validation, its checkpoints and its folder.
//!
//! [`run`] goes from a prepared set to an exported model; [`trainer`] takes the steps; [`memory`]
//! predicts what they need, [`check`] proves a device. Not here: the networks ([`crate::network`]), the objectives
//! ([`crate::loss`]), reading and augmenting images ([`crate::data`]).

pub mod awake;
mod batch;
pub mod check;
pub mod checkpoint;
pub mod folder;
mod log;
pub mod memory;
pub mod model;
pub mod options;
pub mod report;
pub mod run;
pub mod schedule;
mod session;
pub mod tensorboard;
pub mod trainer;
pub mod validation;
mod watch;
