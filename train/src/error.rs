//! What can go wrong in training, as sentences for the person at the terminal.

use std::path::PathBuf;

use strat_store::command::{CliError, USAGE, exit_code};

/// Result of this crate.
pub type Result<T> = std::result::Result<T, Error>;

/// Failures of a training run; each says what was looked for, where, and what to do.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A file of the prepared set, the configuration or the run could not be used.
    #[error(transparent)]
    Store(#[from] strat_store::Error),

    /// Reading or writing failed. The system's sentence is part of this one, not a cause below it.
    #[error("{0}")]
    Io(String),

    /// The configuration names something unknown or holds an impossible value.
    #[error("{0}")]
    Config(String),

    /// The set has no line for the role.
    #[error(
        "the prepared set {} has no {role} pairs; prepare it with frames of that role \
         (`prep` prints how many it found)",
        root.display()
    )]
    EmptySet {
        /// Folder of the set.
        root: PathBuf,
        /// Role that was looked for.
        role: String,
    },

    /// The set was prepared for the other split.
    #[error(
        "the prepared set {} is of the {found} split, but the configuration trains on the \
         {wanted} split; choose the other configuration (`--config {found}-...`) or give the \
         other set",
        root.display()
    )]
    WrongSplit {
        /// Folder of the set.
        root: PathBuf,
        /// Split of the set.
        found: String,
        /// Split of the configuration.
        wanted: String,
    },

    /// More than one in a hundred pairs are unreadable.
    #[error(
        "{broken} of {pairs} training pairs could not be read (last: {last}); \
         run `prep verify` on the set and prepare it again"
    )]
    TooManyBroken {
        /// Unreadable pairs.
        broken: usize,
        /// All pairs.
        pairs: usize,
        /// The last reason.
        last: String,
    },

    /// A loss term became infinite or not a number.
    #[error(
        "the loss term `{term}` is {value} at step {step}; training stopped and the last \
         checkpoint was kept. A smaller learning rate (`--set learning_rate=...`) usually helps"
    )]
    NonFinite {
        /// Name of the term.
        term: String,
        /// Its value.
        value: f32,
        /// 0-based step.
        step: u64,
    },

    /// The output folder holds a run already.
    #[error(
        "{} already contains a training run; continue it with --resume, replace it with --force, \
         or name another folder",
        .0.display()
    )]
    RunExists(PathBuf),

    /// The output folder holds something that is no run.
    #[error(
        "{} exists and is not a training run; name a new or empty folder",
        .0.display()
    )]
    NotARun(PathBuf),

    /// Another process trains in the folder.
    #[error(
        "another training is running in {}; wait for it to end, or name another folder",
        .0.display()
    )]
    InUse(PathBuf),

    /// There is nothing to resume or export.
    #[error("no training run in {}: {reason}", folder.display())]
    NoRun {
        /// Folder that was looked into.
        folder: PathBuf,
        /// What is missing.
        reason: String,
    },

    /// A run is resumed with something that would change its result.
    #[error("the run in {} cannot be resumed: {reason}", folder.display())]
    CannotResume {
        /// Folder of the run.
        folder: PathBuf,
        /// What differs.
        reason: String,
    },

    /// A checkpoint is damaged.
    #[error("the checkpoint {} cannot be used: {reason}", folder.display())]
    Checkpoint {
        /// Folder of the checkpoint.
        folder: PathBuf,
        /// What is wrong with it.
        reason: String,
    },

    /// A study that cannot be understood, or a folder of another one.
    #[error("{0}")]
    Study(String),

    /// A device that this build does not know, or that is not there.
    #[error("{0}")]
    Device(String),

    /// A device that computes something else than the processor, or stops.
    #[error("{0}")]
    WrongDevice(String),

    /// A step that does not fit into memory, or memory that cannot be measured.
    #[error("{0}")]
    Memory(String),

    /// Initial weights that do not fit.
    #[error("{} cannot be used as initial weights: {reason}", path.display())]
    InitialWeights {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },

    /// Writing the model failed.
    #[error("the model could not be exported: {0}")]
    Export(String),

    /// No threads.
    #[error("cannot prepare batches: {0}")]
    Threads(String),
}

impl Error {
    /// Whether the command line is to blame: it names a folder, a setting or a device that cannot be
    /// used.
    #[must_use]
    pub fn is_usage(&self) -> bool {
        match self {
            Self::Store(error) => exit_code(error) == USAGE,
            Self::Config(_)
            | Self::Study(_)
            | Self::EmptySet { .. }
            | Self::WrongSplit { .. }
            | Self::RunExists(_)
            | Self::NotARun(_)
            | Self::InUse(_)
            | Self::NoRun { .. }
            | Self::CannotResume { .. }
            | Self::Device(_)
            | Self::InitialWeights { .. } => true,
            Self::Io(_)
            | Self::TooManyBroken { .. }
            | Self::NonFinite { .. }
            | Self::Checkpoint { .. }
            | Self::WrongDevice(_)
            | Self::Memory(_)
            | Self::Export(_)
            | Self::Threads(_) => false,
        }
    }
}

impl From<Error> for CliError {
    fn from(error: Error) -> Self {
        match error.is_usage() {
            true => Self::usage(error),
            false => Self::failed(error),
        }
    }
}

impl From<strat_csv::Error> for Error {
    fn from(error: strat_csv::Error) -> Self {
        Self::Io(error.to_string())
    }
}

impl From<std::io::Error> for Error {
    fn from(error: std::io::Error) -> Self {
        Self::Io(error.to_string())
    }
}
