//! Free space of the file system a set is written to.
//!
//! Asked before hours of work, not during it: other programs write to the same disk, so the
//! answer is a reason to stop, never a promise.

use std::io;
use std::path::Path;

use strat_store::human;

use crate::error::{Error, Result};

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
        return Err(io::Error::other("no files can be kept here"));
    }
    fs4::available_space(there)
}

/// Makes sure that the disk has room for `needed` bytes below `out`.
///
/// # Errors
/// It has not; the message says how much is needed and free.
pub fn check_space(out: &Path, needed: u64) -> Result<()> {
    match free_bytes(out) {
        Ok(free) if free < needed => Err(Error::Space {
            path: out.to_owned(),
            needed: human::bytes(needed),
            free: human::bytes(free),
        }),
        // A file system that does not tell is no reason to refuse.
        _ => Ok(()),
    }
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
    fn what_cannot_fit_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        check_space(folder.path(), 1).unwrap();
        let error = check_space(folder.path(), 600_000_000_000_000_000).unwrap_err();
        let text = error.to_string();
        assert!(text.contains("about 600000.0 TB will be written"), "{text}");
        let code = strat_store::command::exit_code(&strat_store::command::CliError::from(error));
        assert_eq!(code, strat_store::command::FAILED);
    }
}
