//! Why a preparation stops, as sentences for users.

use std::path::PathBuf;

/// Result of this crate.
pub type Result<T> = std::result::Result<T, Error>;

/// A preparation that cannot start or go on.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// An input folder is not what the option asks for.
    #[error("{option} {}: {problem}", path.display())]
    Input {
        /// The option that named the folder.
        option: &'static str,
        /// The folder.
        path: PathBuf,
        /// What was looked for, what is there, what to do.
        problem: String,
    },
    /// The output folder cannot take this set.
    #[error("--out {}: {problem}", path.display())]
    Output {
        /// The folder.
        path: PathBuf,
        /// What is in the way and what to do.
        problem: String,
    },
    /// Parts of the split are missing and that was not allowed.
    #[error("{0}")]
    Incomplete(String),
    /// Reading or writing a file failed.
    #[error(transparent)]
    Store(#[from] strat_store::Error),
    /// The operating system would not start the threads asked for.
    #[error("cannot start {jobs} threads: {reason}")]
    Threads {
        /// Threads asked for.
        jobs: usize,
        /// The reason given.
        reason: String,
    },
}

impl Error {
    /// Exit code of the command: 2 where the command line named the wrong thing, else 1.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Input { .. } | Self::Output { .. } => 2,
            Self::Incomplete(_) | Self::Store(_) | Self::Threads { .. } => 1,
        }
    }
}
