//! How far the runs of a study are, from their folders alone.

use std::path::Path;

use super::plan::{Study, StudyRun};
use crate::error::Result;
use crate::training::folder::{Found, find};

/// How far a run is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum State {
    /// There is none.
    NotBegun,
    /// It has done some steps.
    Begun {
        /// Steps of its newest checkpoint.
        step: u64,
    },
    /// Its model is there.
    Finished,
    /// Its folder holds something else; why it cannot be used.
    Foreign(String),
}

impl State {
    /// How far a run is in the folder of its study.
    ///
    /// # Errors
    /// A folder cannot be read.
    pub fn of(study: &Study, run: &StudyRun, out: &Path) -> Result<Self> {
        let folder = out.join(run.folder());
        Ok(match find(&folder, &run.config, &study.set(run).digest) {
            Ok(Found::Nothing) => Self::NotBegun,
            Ok(Found::Run { step, model_epoch }) => {
                let end = run.timeline.end;
                // A model from before is one of fewer epochs; checkpoints may have been removed since.
                let whole = model_epoch == Some(end / run.timeline.steps_per_epoch);
                if whole && step.is_none_or(|step| step >= end) {
                    Self::Finished
                } else {
                    Self::Begun {
                        step: step.unwrap_or(0),
                    }
                }
            }
            Err(error) if error.is_usage() => Self::Foreign(error.to_string()),
            Err(error) => return Err(error),
        })
    }

    /// Steps that are done.
    #[must_use]
    pub fn steps(&self, run: &StudyRun) -> u64 {
        match self {
            Self::NotBegun | Self::Foreign(_) => 0,
            Self::Begun { step } => *step,
            Self::Finished => run.timeline.end,
        }
    }

    /// As a table shows it.
    #[must_use]
    pub fn word(&self, run: &StudyRun) -> String {
        match self {
            Self::NotBegun => "not begun".to_owned(),
            Self::Begun { step } => format!(
                "begun, epoch {} of {}",
                run.timeline.epoch_number(*step).min(run.timeline.epochs),
                run.timeline.epochs
            ),
            Self::Finished => "finished".to_owned(),
            Self::Foreign(_) => "cannot be used".to_owned(),
        }
    }
}
