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
    /// The disk has no room for the set.
    #[error(
        "--out {}: about {needed} will be written and {free} are free; make room, give a folder on \
         another disk, or write less with --codec jpeg",
        path.display()
    )]
    Space {
        /// The folder.
        path: PathBuf,
        /// What the set needs at least.
        needed: String,
        /// What is free.
        free: String,
    },
    /// Options that contradict each other.
    #[error("{0}")]
    Usage(String),
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
    /// Whether the disk ran full while something was written.
    pub fn is_full_disk(&self) -> bool {
        matches!(self, Self::Store(strat_store::Error::Io { source, .. })
            if source.kind() == std::io::ErrorKind::StorageFull)
    }

    /// Exit code of the command: 2 where the command line named the wrong thing, else 1.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Input { .. } | Self::Output { .. } | Self::Usage(_) => 2,
            Self::Incomplete(_) | Self::Space { .. } | Self::Store(_) | Self::Threads { .. } => 1,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io;

    use super::*;

    #[test]
    fn a_full_disk_is_told_from_other_trouble() {
        let writing = |kind: io::ErrorKind| {
            Error::from(strat_store::Error::Io {
                action: "write",
                path: PathBuf::from("images/a.png"),
                source: kind.into(),
            })
        };
        assert!(writing(io::ErrorKind::StorageFull).is_full_disk());
        assert!(!writing(io::ErrorKind::PermissionDenied).is_full_disk());
        assert!(!Error::Usage(String::new()).is_full_disk());
    }
}
