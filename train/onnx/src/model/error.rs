//! Why a model file is refused.

use std::io;
use std::path::{Path, PathBuf};

/// Why a model file was refused. `path` is the name of the file as it was given.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The file system refused.
    #[error("cannot read the model {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// A folder was given.
    #[error("{} is a folder; a model is one .onnx file", path.display())]
    Folder {
        /// The folder.
        path: PathBuf,
    },
    /// A pipe or device was given, which may never end.
    #[error("{} is not a regular file; a model is one .onnx file on disk", path.display())]
    NotAFile {
        /// The path.
        path: PathBuf,
    },
    /// No byte in the file.
    #[error("the model {} is empty; copy or export it again", path.display())]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// Larger than the format allows.
    #[error(
        "the model {} has {bytes} bytes; an ONNX file is limited to 2 GiB, larger weights go into external data",
        path.display()
    )]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// Its size.
        bytes: u64,
    },
    /// The placeholder that git-lfs leaves for a file it has not fetched.
    #[error(
        "{} is a git-lfs pointer and not the model itself; run `git lfs pull` in its repository",
        path.display()
    )]
    GitLfsPointer {
        /// The file.
        path: PathBuf,
    },
    /// Something else by its first bytes.
    #[error("{} is not an ONNX model: it looks like {kind}", path.display())]
    OtherKind {
        /// The file.
        path: PathBuf,
        /// What it looks like.
        kind: &'static str,
    },
    /// The protobuf is malformed.
    #[error(
        "{} is not a complete ONNX model (truncated, damaged, or another kind of file): {reason}",
        path.display()
    )]
    Malformed {
        /// The file.
        path: PathBuf,
        /// Where decoding stopped or what is missing.
        reason: String,
    },
    /// Decoded, but no runtime should be given it.
    #[error("the model {} is refused: {problem}", path.display())]
    Unsafe {
        /// The file.
        path: PathBuf,
        /// What is wrong, naming the node or tensor.
        problem: String,
    },
    /// A part of the weights cannot be had.
    #[error("the model {} keeps weights in other files: {problem}", path.display())]
    ExternalData {
        /// The file.
        path: PathBuf,
        /// What is wrong, naming the tensor and file.
        problem: String,
    },
}

pub(super) fn malformed(path: &Path, reason: impl Into<String>) -> ReadError {
    ReadError::Malformed {
        path: path.to_owned(),
        reason: reason.into(),
    }
}
