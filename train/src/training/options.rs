//! What a run is asked for, and what comes of it.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use super::checkpoint::Best;
use super::validation::Scores;
use crate::config::Config;
use crate::device::DeviceChoice;

/// What is to be run.
#[derive(Clone, Debug)]
pub struct Options {
    /// The settings; already checked.
    pub config: Config,
    /// Folder of the prepared set.
    pub data: PathBuf,
    /// Run folder.
    pub out: PathBuf,
    /// Where the networks are.
    pub device: DeviceChoice,
    /// Further devices that share the batches of a step.
    pub replicas: Vec<DeviceChoice>,
    /// Continue the run in the folder.
    pub resume: bool,
    /// Replace the run in the folder.
    pub force: bool,
    /// Show no progress.
    pub quiet: bool,
    /// Begin although the memory is predicted not to suffice.
    pub ignore_memory: bool,
    /// Begin although nothing has shown that the devices compute what the processor computes.
    pub no_check: bool,
    /// Set to true to stop after the current step.
    pub stop: Arc<AtomicBool>,
}

impl Options {
    /// All devices, the networks' own first.
    pub fn devices(&self) -> impl Iterator<Item = DeviceChoice> {
        std::iter::once(self.device).chain(self.replicas.iter().copied())
    }

    /// All devices, as `--device` names them.
    #[must_use]
    pub fn device_names(&self) -> String {
        let names: Vec<String> = self.devices().map(|device| device.to_string()).collect();
        names.join(",")
    }
}

/// How a run ended.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Optimizer steps done.
    pub steps: u64,
    /// Steps of the whole run as configured.
    pub planned: u64,
    /// Whether it was stopped from outside.
    pub interrupted: bool,
    /// The exported model, unless interrupted.
    pub model: Option<PathBuf>,
    /// Largest difference between the trained network and the exported model.
    pub parity: Option<f64>,
    /// Scores of the last validation.
    pub scores: Option<Scores>,
    /// The best validation score.
    pub best: Option<Best>,
    /// Training pairs that could not be read.
    pub broken_pairs: usize,
    /// Seconds of training, validation included.
    pub seconds: f64,
    /// Share of the time spent waiting for images.
    pub wait_share: f64,
}
