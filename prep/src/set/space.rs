//! Free space of the file system a set is written to.
//!
//! Asked before hours of work, not during it: other programs write to the same disk, so the
//! answer is a reason to stop, never a promise.

use std::io;
use std::path::Path;

/// Bytes that an ordinary user can still write below `path`. The nearest folder that exists is
/// asked, so a folder still to be made gives the answer of the place where it will be.
///
/// # Errors
/// The file system does not say.
pub fn free_bytes(path: &Path) -> io::Result<u64> {
    let absolute = std::path::absolute(path)?;
    let there = absolute.ancestors().find(|folder| folder.is_dir());
    let there = there.unwrap_or(&absolute);
    // /proc and the like hold nothing; that is another trouble than a full disk.
    if fs4::total_space(there)? == 0 {
        return Err(io::Error::other("this is no place for files"));
    }
    fs4::available_space(there)
}

/// A size as people read it: `1.4 GB`, in powers of ten as disks are sold.
pub fn human_bytes(bytes: u64) -> String {
    let mut size = bytes as f64;
    for unit in ["bytes", "kB", "MB", "GB"] {
        if size < 1000.0 {
            return match unit {
                "bytes" => format!("{bytes} bytes"),
                _ => format!("{size:.1} {unit}"),
            };
        }
        size /= 1000.0;
    }
    format!("{size:.1} TB")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_to_be_made_has_the_space_of_its_place() {
        let folder = tempfile::tempdir().unwrap();
        let deep = folder.path().join("not/there/yet");
        assert!(free_bytes(folder.path()).is_ok());
        assert!(free_bytes(&deep).is_ok());
        assert!(!folder.path().join("not").exists(), "nothing is made");
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn what_holds_no_files_is_not_called_full() {
        assert!(free_bytes(Path::new("/proc/set")).is_err());
    }

    #[test]
    fn sizes_are_readable() {
        assert_eq!(human_bytes(999), "999 bytes");
        assert_eq!(human_bytes(1_400), "1.4 kB");
        assert_eq!(human_bytes(15_250_000_000), "15.2 GB");
        assert_eq!(human_bytes(2_000_000_000_000), "2.0 TB");
    }
}
