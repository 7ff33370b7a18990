//! Why a preparation stops, as sentences for users.

use std::path::PathBuf;

use strat_store::command::CliError;

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
}

impl Error {
    /// Whether the disk ran full while something was written.
    fn is_full_disk(&self) -> bool {
        matches!(self, Self::Store(strat_store::Error::Io { source, .. })
            if source.kind() == std::io::ErrorKind::StorageFull)
    }
}

impl From<Error> for CliError {
    /// Wrong usage where the command line named the wrong thing.
    fn from(error: Error) -> Self {
        if error.is_full_disk() {
            return Self::Failed(format!(
                "{error}\nThe disk is full. Make room and run the same command again: finished files are kept."
            ));
        }
        match error {
            Error::Input { .. } | Error::Output { .. } | Error::Usage(_) => Self::usage(error),
            Error::Incomplete(_) | Error::Space { .. } => Self::failed(error),
            Error::Store(error) => error.into(),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io;

    use strat_store::command::{FAILED, USAGE, exit_code};

    use super::*;

    #[test]
    fn a_full_disk_is_told_from_other_trouble() {
        let writing = |kind: io::ErrorKind| {
            let error = Error::from(strat_store::Error::Io {
                action: "write",
                path: PathBuf::from("images/a.png"),
                source: kind.into(),
            });
            CliError::from(error).to_string()
        };
        assert!(writing(io::ErrorKind::StorageFull).contains("images/a.png"));
        assert!(writing(io::ErrorKind::StorageFull).contains("Make room"));
        assert!(!writing(io::ErrorKind::PermissionDenied).contains("Make room"));
    }

    #[test]
    fn wrong_usage_has_its_code() {
        let code = |error: Error| exit_code(&CliError::from(error));
        let problem = String::new();
        let path = PathBuf::new();
        assert_eq!(code(Error::Usage(problem.clone())), USAGE);
        assert_eq!(code(Error::Incomplete(problem.clone())), FAILED);
        assert_eq!(
            code(Error::Output {
                path: path.clone(),
                problem: problem.clone()
            }),
            USAGE
        );
        assert_eq!(
            code(Error::Store(strat_store::Error::Set { path, problem })),
            USAGE
        );
    }
}
