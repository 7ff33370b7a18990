//! What a run of `bench --table` is asked for, and what it gives back.

use std::path::{Path, PathBuf};

use strat_metrics::tables::ThesisTable;
use strat_store::shard::Shard;

use super::{
    Comparison, NamedFile,
    journal::{self, JournalError},
    ownership,
    plan::{PlanError, TableChoice},
    predictions::SaveError,
    record::{Outcome, RunRecord},
    shards::ShardsError,
};
use crate::runtime::{Device, RuntimeChoice, RuntimeError, process::Limits};

/// What is to be measured, and how.
#[derive(Debug)]
pub struct Request<'a> {
    /// Folder of the prepared set.
    pub data: &'a Path,
    /// Tables to fill.
    pub table: TableChoice,
    /// Further protocols, by name or file.
    pub protocols: &'a [String],
    /// ONNX files.
    pub models: &'a [NamedFile],
    /// Predictions that some program has saved.
    pub predictions: &'a [NamedFile],
    /// Where the training images of models came from that do not say it themselves: `kitti`, `rendered`, ...
    pub training_source: Option<&'a str>,
    /// Measure the metrics of PROTOCOL 10.3 too.
    pub further: bool,
    /// Measure the median depth of the training scans, too.
    pub median_baseline: bool,
    /// Folders of other prepared sets, whose training scans give such a row each.
    pub medians_of: &'a [NamedFile],
    /// Folder for the results.
    pub out: &'a Path,
    /// Measure one part of the test images only.
    pub shard: Option<Shard>,
    /// Replace results of another run, too.
    pub force: bool,
    /// Save what models predict.
    pub save_predictions: bool,
    /// Comparison pictures for each predictor, spread evenly over the test images.
    pub pictures: usize,
    /// Comparison pictures of as many best and as many worst images.
    pub extremes: usize,
    /// Which runtime.
    pub runtime: RuntimeChoice,
    /// Where models run.
    pub device: Device,
    /// What a model may take in a process of its own; `None` runs it in this one.
    pub limits: Option<Limits>,
    /// Threads within a model.
    pub threads: usize,
    /// Threads beside the model.
    pub pool: &'a rayon::ThreadPool,
    /// No progress and no notes.
    pub quiet: bool,
}

/// Draws one comparison for the model of this name below the folder of results.
pub type Draw<'a> = &'a dyn Fn(&Path, &str, &Comparison) -> Result<(), strat_store::Error>;

/// Why a run ended without results.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// A file or folder cannot be used.
    #[error(transparent)]
    Store(#[from] strat_store::Error),
    /// The set cannot serve what was asked for.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// The folder of the part cannot be used.
    #[error(transparent)]
    Shards(#[from] ShardsError),
    /// There is no such runtime, or not on that device.
    #[error(transparent)]
    Runtime(#[from] RuntimeError),
    /// Predictions cannot be saved.
    #[error(transparent)]
    Save(#[from] SaveError),
    /// What was measured cannot be put down.
    #[error(transparent)]
    Journal(#[from] JournalError),
}

/// What a run has found; nothing of it is written yet but pictures, saved predictions and journals.
#[derive(Debug)]
pub struct Finished {
    /// Record, rows and failures.
    pub outcome: Outcome,
    /// Tables to write.
    pub tables: Vec<ThesisTable>,
    /// Where the results belong: the folder for results, or that of one part.
    pub folder: PathBuf,
    pub(super) earlier: Option<RunRecord>,
    pub(super) journals: Vec<PathBuf>,
}

impl Finished {
    /// Makes sure that nothing is lost where the results replace those of an earlier run.
    ///
    /// # Errors
    /// The earlier run has more.
    pub fn check_replacement(&self) -> Result<(), strat_store::Error> {
        let earlier = self.earlier.as_ref();
        match earlier.and_then(|earlier| ownership::loses(earlier, &self.outcome.record)) {
            Some(what) => Err(ownership::refuse(&self.folder, &what)),
            None => Ok(()),
        }
    }

    /// Removes what an interrupted run would have gone on from; for when the results are written.
    ///
    /// # Errors
    /// A file cannot be removed.
    pub fn remove_journals(&self) -> Result<(), strat_store::Error> {
        self.journals
            .iter()
            .try_for_each(|path| journal::remove(path))
    }
}
