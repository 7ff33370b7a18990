//! `train` from outside: the command as it is typed, and the library's networks and runs.
//!
//! Not here: `growth`, which measures the memory of its own process.

mod cli;
#[cfg(feature = "wgpu")]
mod gpu;
#[cfg(unix)]
mod kills;
mod memory;
mod nets;
mod prepared;
mod run;
#[cfg(unix)]
mod study;
