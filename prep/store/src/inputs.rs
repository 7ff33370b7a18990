//! Files that are read: regular ones, no larger than their kind can be.
//!
//! What a stranger hands over may be a pipe that never ends, a folder, or 20 GB of zeros under the
//! name of a scan. Every reader opens its files here and says what kind it looks for, so that such
//! a file costs a sentence and neither memory nor time. The sizes are far above what the kinds
//! have in practice. ONNX files have limits of their own, in strat-onnx.

use std::fs::{File, Metadata};
use std::io::Read;
use std::path::Path;

use crate::error::{Error, Result};

/// Most pixels of a picture or map that is decoded, 134 million: a few bytes of a file can promise
/// any number.
pub const MAX_PIXELS: u64 = 1 << 27;

const MB: u64 = 1_000_000;
const GB: u64 = 1000 * MB;

/// What a file is looked for as.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// PNG or JPEG: pictures, labels, disparities.
    Image,
    /// OpenEXR with one map.
    Exr,
    /// A Velodyne scan; KITTI's largest have 2 MB.
    Scan,
    /// A camera's calibration, as text or JSON.
    Calibration,
    /// Settings, descriptions, manifests.
    Yaml,
    /// CSV and lists of ids.
    Table,
    /// Rows and lines that somebody submits to a leaderboard.
    Submission,
    /// A NumPy array with one map.
    Map,
    /// A NumPy array (or an archive of them) with the maps of many images, read one by one.
    Maps,
    /// A MATLAB file.
    Matlab,
    /// A zip archive, read entry by entry.
    Archive,
    /// Facts about a run as JSON.
    Record,
    /// Weights and states of training.
    Weights,
    /// Any file of a prepared set, of which only the digest is taken.
    Content,
}

impl Kind {
    /// The most bytes that a file of this kind may have.
    pub const fn largest(self) -> u64 {
        match self {
            Self::Calibration | Self::Yaml => MB,
            Self::Submission => 32 * MB,
            Self::Scan | Self::Matlab | Self::Record => 64 * MB,
            Self::Image | Self::Exr => 256 * MB,
            Self::Map => 512 * MB,
            Self::Table | Self::Content => GB,
            Self::Weights => 8 * GB,
            Self::Maps => 16 * GB,
            Self::Archive => 1000 * GB,
        }
    }

    /// What is looked for, as it stands in a sentence.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Image => "an image (PNG or JPEG)",
            Self::Exr => "an EXR file",
            Self::Scan => "a Velodyne scan",
            Self::Calibration => "a camera's calibration",
            Self::Yaml => "a YAML file",
            Self::Table => "a table or list",
            Self::Submission => "a file of a submission",
            Self::Map => "a map as NumPy array",
            Self::Maps => "maps as NumPy arrays",
            Self::Matlab => "a MATLAB file",
            Self::Archive => "a zip archive",
            Self::Record => "a record of a run",
            Self::Weights => "weights",
            Self::Content => "a file of a prepared set",
        }
    }

    /// The kind that a file's extension, in small letters, stands for where pictures, maps and
    /// arrays are admitted.
    pub fn of_extension(extension: &str) -> Self {
        match extension {
            "exr" => Self::Exr,
            "npy" => Self::Map,
            _ => Self::Image,
        }
    }

    /// Holds a number of bytes against [`Kind::largest`].
    ///
    /// # Errors
    /// It is larger; `path` names the file.
    pub fn check(self, path: &Path, bytes: u64) -> Result<()> {
        if bytes > self.largest() {
            return Err(Error::TooLarge {
                path: path.to_owned(),
                bytes,
                wanted: self.name(),
                largest: self.largest(),
            });
        }
        Ok(())
    }
}

/// Opens a file.
///
/// # Errors
/// It is not there, no regular file, or larger than its kind can be.
pub fn open(path: &Path, kind: Kind) -> Result<File> {
    let io = |e| Error::io("read", path, e);
    let check = |found: &Metadata| {
        if !found.is_file() {
            return Err(Error::NotAFile {
                path: path.to_owned(),
                found: if found.is_dir() {
                    "a folder"
                } else {
                    "a pipe or device"
                },
                wanted: kind.name(),
            });
        }
        kind.check(path, found.len())
    };
    // Before it is opened: that alone waits for ever at a pipe nobody writes to.
    check(&std::fs::metadata(path).map_err(io)?)?;
    let file = File::open(path).map_err(io)?;
    check(&file.metadata().map_err(io)?)?;
    Ok(file)
}

/// Reads a whole file.
///
/// # Errors
/// As [`open`], or the system refuses.
pub fn read(path: &Path, kind: Kind) -> Result<Vec<u8>> {
    let file = open(path, kind)?;
    let length = file.metadata().map_or(0, |found| found.len());
    let mut bytes = Vec::with_capacity(usize::try_from(length).unwrap_or(0));
    // It may grow meanwhile.
    file.take(kind.largest() + 1)
        .read_to_end(&mut bytes)
        .map_err(|e| Error::io("read", path, e))?;
    kind.check(path, bytes.len() as u64)?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    const KINDS: [Kind; 14] = [
        Kind::Image,
        Kind::Exr,
        Kind::Scan,
        Kind::Calibration,
        Kind::Yaml,
        Kind::Table,
        Kind::Submission,
        Kind::Map,
        Kind::Maps,
        Kind::Matlab,
        Kind::Archive,
        Kind::Record,
        Kind::Weights,
        Kind::Content,
    ];

    #[test]
    fn a_file_larger_than_its_kind_is_refused_unread() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("0000000001.bin");
        let file = File::create(&path).unwrap();
        for kind in KINDS {
            // Holes take no room on the disk.
            if file.set_len(kind.largest() + 1).is_err() {
                eprintln!(
                    "could not run: no file of {} bytes here",
                    kind.largest() + 1
                );
                continue;
            }
            let error = open(&path, kind).unwrap_err().to_string();
            for part in ["0000000001.bin", kind.name(), "at most"] {
                assert!(error.contains(part), "{error}");
            }
            assert_eq!(read(&path, kind).unwrap_err().to_string(), error);
        }
        file.set_len(20_000_000_000).unwrap();
        let error = read(&path, Kind::Scan).unwrap_err().to_string();
        assert!(
            error.contains("20.0 GB") && error.contains("64.0 MB"),
            "{error}"
        );
        file.set_len(Kind::Calibration.largest()).unwrap();
        let whole = read(&path, Kind::Calibration).unwrap();
        assert_eq!(whole.len() as u64, Kind::Calibration.largest());
    }

    #[test]
    fn what_is_no_regular_file_is_never_opened() {
        let folder = tempfile::tempdir().unwrap();
        let error = open(folder.path(), Kind::Image).unwrap_err().to_string();
        assert!(
            error.contains("a folder") && error.contains("an image"),
            "{error}"
        );
        assert!(
            read(&folder.path().join("none"), Kind::Yaml)
                .unwrap_err()
                .is_not_found()
        );
        #[cfg(unix)]
        {
            let endless = read(Path::new("/dev/zero"), Kind::Yaml)
                .unwrap_err()
                .to_string();
            assert!(endless.contains("pipe or device"), "{endless}");
            let pipe = folder.path().join("a.yaml");
            let made = std::process::Command::new("mkfifo").arg(&pipe).status();
            if made.is_ok_and(|status| status.success()) {
                let pipe = read(&pipe, Kind::Yaml).unwrap_err().to_string();
                assert!(pipe.contains("a pipe or device"), "{pipe}");
            }
        }
    }
}
