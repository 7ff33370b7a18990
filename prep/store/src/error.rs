//! What can go wrong with files and threads, as sentences for users.

use std::io;
use std::path::{Path, PathBuf};

use crate::human;

/// Result of this crate.
pub type Result<T> = std::result::Result<T, Error>;

/// A file or folder that could not be read, written or understood; the message names it.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The operating system refused.
    #[error("cannot {action} {}: {source}", path.display())]
    Io {
        /// What was tried: "read", "write", "create".
        action: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// The reason given.
        source: io::Error,
    },
    /// A folder, pipe or device where a file should be.
    #[error("{} is {found}; {wanted} in a regular file is needed", path.display())]
    NotAFile {
        /// What was given.
        path: PathBuf,
        /// What it is.
        found: &'static str,
        /// What was looked for.
        wanted: &'static str,
    },
    /// A file larger than anything of its kind.
    #[error(
        "{} has {}, but {wanted} has at most {}; is it another kind of file?",
        path.display(), human::bytes(*bytes), human::bytes(*largest)
    )]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// Its size.
        bytes: u64,
        /// What was looked for.
        wanted: &'static str,
        /// The most bytes that are read.
        largest: u64,
    },
    /// A folder that results should go to cannot be made or written to.
    #[error("cannot write to the folder {}: {}", path.display(), why(source))]
    Unwritable {
        /// The folder.
        path: PathBuf,
        /// The reason given.
        source: io::Error,
    },
    /// The operating system would not start threads.
    #[error("cannot start {threads} threads: {reason}; ask for fewer")]
    Threads {
        /// Threads asked for; 0 for one for each core.
        threads: usize,
        /// The reason given.
        reason: String,
    },
    /// Not a usable picture.
    #[error("{path} is not a usable image: {problem}")]
    Image {
        /// File name, or the name the caller gave to the bytes.
        path: String,
        /// What is wrong with it.
        problem: String,
    },
    /// Not a depth file of this project.
    #[error("{} is not a usable depth file: {problem}", path.display())]
    Depth {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        problem: String,
    },
    /// Text that is no valid YAML for its purpose.
    #[error("cannot use {}: {problem}", path.display())]
    Yaml {
        /// The file.
        path: PathBuf,
        /// Key, line and column, and what is wrong there.
        problem: String,
    },
    /// A bad line in a CSV file.
    #[error("{}, line {line}: {problem}", path.display())]
    Table {
        /// The file.
        path: PathBuf,
        /// 1-based line number.
        line: u64,
        /// What is wrong with it.
        problem: String,
    },
    /// A folder that is not a finished prepared set.
    #[error("{} is not a finished prepared set: {problem}", path.display())]
    Set {
        /// The folder.
        path: PathBuf,
        /// What is missing or contradictory, and what to do.
        problem: String,
    },
    /// A prepared set whose tables are not those of its manifest.
    #[error("{} is not a finished prepared set: {problem}", path.display())]
    DamagedSet {
        /// The folder.
        path: PathBuf,
        /// What contradicts what, and what to do.
        problem: String,
    },
    /// An output that is in the way of something, or that belongs to someone else.
    #[error("cannot write to {}: {problem}", path.display())]
    Output {
        /// The folder or file as given.
        path: PathBuf,
        /// What is there and what to do.
        problem: String,
    },
    /// A signal ended the work; what is done is kept.
    #[error(
        "interrupted; what is done is kept: run the same command again, and it goes on from there"
    )]
    Interrupted,
    /// A value that could not be turned into text.
    #[error("cannot write this as YAML: {0}")]
    ToYaml(String),
}

/// The reason why a folder cannot be made, in other words than the system's where those mislead.
fn why(source: &io::Error) -> String {
    match source.kind() {
        io::ErrorKind::AlreadyExists | io::ErrorKind::NotADirectory => {
            "a file is in its place".to_owned()
        }
        _ => source.to_string(),
    }
}

impl Error {
    pub(crate) fn io(action: &'static str, path: &Path, source: io::Error) -> Self {
        Self::Io {
            action,
            path: path.to_owned(),
            source,
        }
    }

    /// Whether the cause is a file that does not exist.
    pub fn is_not_found(&self) -> bool {
        matches!(self, Self::Io { source, .. } if source.kind() == io::ErrorKind::NotFound)
    }
}
