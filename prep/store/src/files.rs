//! Files that appear whole or not at all, tables among them, and their hashes.
//!
//! Everything is written to a temporary file in the target's folder and renamed. There is
//! no fsync: after a power failure files may be missing, and a second run writes them again.
//!
//! A killed process leaves its temporary file behind. It is known by its name ([`is_leftover`]),
//! and [`remove_leftovers`] removes it; a lock that dies with its process keeps the files that
//! another process is still writing.
//!
//! Every change to the file system is made here and passes [`fault`], so that tests can try a kill or
//! an error at each of them.

use std::ffi::OsString;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use serde::Serialize;
use tempfile::NamedTempFile;

use crate::error::{Error, Result};
use crate::fault::{self, Counted};
use crate::inputs::{self, Kind};

/// Prefix of temporary files.
pub const UNFINISHED_PREFIX: &str = ".unfinished-";

/// Random letters and digits behind the prefix.
const RANDOM_LENGTH: usize = 6;

/// Whether a file of this name in an output folder is half-written: a killed run has left it, or a
/// running one is about to rename it.
pub fn is_leftover(name: &str) -> bool {
    name.strip_prefix(UNFINISHED_PREFIX).is_some_and(|rest| {
        rest.len() == RANDOM_LENGTH && rest.bytes().all(|b| b.is_ascii_alphanumeric())
    })
}

/// Writes bytes to `path`, replacing what is there in one step. Creates parent folders.
///
/// # Errors
/// The folder cannot be created or written to.
pub fn write_atomic(path: &Path, bytes: &[u8]) -> Result<()> {
    write_atomic_with(path, |out| out.write_all(bytes))
}

/// Like [`write_atomic`] for content that is produced piece by piece. If `fill` fails,
/// nothing appears at `path`.
///
/// # Errors
/// The folder cannot be created or written to, or `fill` fails.
pub fn write_atomic_with(
    path: &Path,
    fill: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> Result<()> {
    let mut file = Unfinished::create(path)?;
    fill(&mut file.out).map_err(|e| Error::io("write", path, e))?;
    file.finish()
}

/// A file that is being written and appears at its path when it is finished; dropped before, it
/// leaves nothing.
#[derive(Debug)]
pub(crate) struct Unfinished {
    path: PathBuf,
    pub out: BufWriter<Counted<NamedTempFile>>,
}

impl Unfinished {
    pub fn create(path: &Path) -> Result<Self> {
        let folder = match path.parent() {
            Some(parent) if !parent.as_os_str().is_empty() => parent,
            _ => Path::new("."),
        };
        make_folder(folder)?;
        let file = unfinished_in(folder).map_err(|e| Error::io("write", path, e))?;
        Ok(Self {
            path: path.to_owned(),
            out: BufWriter::with_capacity(1 << 16, Counted(file)),
        })
    }

    pub fn finish(self) -> Result<()> {
        let written = self
            .out
            .into_inner()
            .map_err(io::IntoInnerError::into_error);
        let persisted = written.and_then(|Counted(file)| {
            fault::point()?;
            file.persist(&self.path).map_err(|e| e.error)
        });
        persisted
            .map(drop)
            .map_err(|e| Error::io("write", &self.path, e))
    }
}

/// Writes rows as CSV, headed by the names of their fields; no rows make an empty file. The table
/// appears whole or not at all.
///
/// # Errors
/// A row is no flat structure, or the file cannot be written.
pub fn write_csv<T: Serialize>(path: &Path, rows: impl IntoIterator<Item = T>) -> Result<()> {
    write_atomic_with(path, |file| {
        let mut table = strat_csv::Writer::new(file);
        for row in rows {
            table.serialize(row).map_err(io::Error::other)?;
        }
        table.flush()
    })
}

/// Renames a file or a folder, which replaces a file of the new name.
///
/// # Errors
/// It cannot be renamed.
pub fn rename(from: &Path, to: &Path) -> Result<()> {
    let renamed = fault::point().and_then(|()| std::fs::rename(from, to));
    renamed.map_err(|e| Error::io("rename", from, e))
}

/// Removes a file or a folder with all that is in it; nothing there is as good.
///
/// # Errors
/// It cannot be removed.
pub fn remove(path: &Path) -> Result<()> {
    let removed = path.symlink_metadata().and_then(|found| {
        fault::point()?;
        if found.is_dir() {
            std::fs::remove_dir_all(path)
        } else {
            std::fs::remove_file(path)
        }
    });
    match removed {
        Err(e) if e.kind() != io::ErrorKind::NotFound => Err(Error::io("remove", path, e)),
        _ => Ok(()),
    }
}

/// Removes a folder in one step: it is renamed to what the next run knows as a leftover, then
/// deleted.
///
/// # Errors
/// It cannot be renamed or removed.
pub fn remove_folder_atomic(folder: &Path) -> Result<()> {
    let wrong = |e| Error::io("remove", folder, e);
    let parent = folder.parent().unwrap_or(Path::new("."));
    let name = unfinished_in(parent).map_err(wrong)?.into_temp_path();
    let doomed = name.to_path_buf();
    name.close().map_err(wrong)?;
    rename(folder, &doomed)?;
    remove(&doomed)
}

/// Removes what killed runs have left half-written in a folder of outputs and in all folders below
/// it. Files that a process is still writing stay.
///
/// # Errors
/// A folder cannot be read or a leftover not be removed.
pub fn remove_leftovers(folder: &Path) -> Result<()> {
    remove_leftovers_among(folder, |_| true)
}

/// Like [`remove_leftovers`] in a folder that others use as well: only in folders of names that are
/// one's `own`.
///
/// # Errors
/// A folder cannot be read or a leftover not be removed.
pub fn remove_leftovers_among(folder: &Path, own: impl Fn(&str) -> bool) -> Result<()> {
    for name in names_in(folder)? {
        let path = folder.join(&name);
        let name = name.to_string_lossy();
        let is_folder = path.symlink_metadata().is_ok_and(|found| found.is_dir());
        match (is_leftover(&name), is_folder) {
            (true, true) => remove(&path)?,
            (true, false) => {
                // Whoever is writing it holds the lock.
                let unused =
                    inputs::open(&path, Kind::Archive).is_ok_and(|file| file.try_lock().is_ok());
                if unused {
                    remove(&path)?;
                }
            }
            (false, true) if own(&name) => remove_leftovers(&path)?,
            (false, _) => {}
        }
    }
    Ok(())
}

/// The names in a folder; none if it is not there.
pub fn names_in(folder: &Path) -> Result<Vec<OsString>> {
    let names = match std::fs::read_dir(folder) {
        Ok(entries) => entries.map(|entry| Ok(entry?.file_name())).collect(),
        Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(Vec::new()),
        Err(e) => Err(e),
    };
    names.map_err(|e| Error::io("read the folder", folder, e))
}

/// Makes sure that `folder` exists and can be written to, by writing to it.
///
/// # Errors
/// It cannot be created or written to.
pub fn check_writable(folder: &Path) -> Result<()> {
    let written = made(folder).and_then(|()| unfinished_in(folder));
    written.map(drop).map_err(|source| Error::Unwritable {
        path: folder.to_owned(),
        source,
    })
}

/// The first twelve characters of a digest: enough to tell two apart in a heading.
pub fn digest_prefix(digest: &str) -> &str {
    digest.get(..12).unwrap_or(digest)
}

/// BLAKE3 of bytes in hex.
pub fn blake3_hex(bytes: &[u8]) -> String {
    blake3::hash(bytes).to_hex().to_string()
}

/// BLAKE3 of a file's content in hex.
///
/// # Errors
/// The file cannot be read, or cannot be of its `kind`.
pub fn blake3_file(path: &Path, kind: Kind) -> Result<String> {
    let mut hasher = blake3::Hasher::new();
    hasher
        .update_reader(inputs::open(path, kind)?)
        .map_err(|e| Error::io("read", path, e))?;
    Ok(hasher.finalize().to_hex().to_string())
}

/// Makes a folder with all above it, where it is not there.
///
/// # Errors
/// It cannot be made.
pub fn make_folder(folder: &Path) -> Result<()> {
    made(folder).map_err(|e| Error::io("create the folder", folder, e))
}

fn made(folder: &Path) -> io::Result<()> {
    if !folder.is_dir() {
        fault::point()?;
        std::fs::create_dir_all(folder)?;
    }
    Ok(())
}

/// A file at whose end lines are added, each of them at once: a process that is killed leaves whole
/// ones and at most the beginning of one.
#[derive(Debug)]
pub struct Appending {
    path: PathBuf,
    file: std::fs::File,
}

impl Appending {
    /// Opens a file, which is made where it is not there.
    ///
    /// # Errors
    /// It cannot be opened.
    pub fn open(path: &Path) -> Result<Self> {
        let open = |()| {
            std::fs::File::options()
                .append(true)
                .create(true)
                .open(path)
        };
        Ok(Self {
            path: path.to_owned(),
            file: fault::point()
                .and_then(open)
                .map_err(|e| Error::io("write", path, e))?,
        })
    }

    /// Adds bytes at the end.
    ///
    /// # Errors
    /// The disk is full or gone.
    pub fn add(&mut self, bytes: &[u8]) -> Result<()> {
        let written = Counted(&mut self.file).write_all(bytes);
        written.map_err(|e| Error::io("write", &self.path, e))
    }
}

fn unfinished_in(folder: &Path) -> io::Result<NamedTempFile> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(UNFINISHED_PREFIX).rand_bytes(RANDOM_LENGTH);
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        // Temporary files are private by default; these become ordinary files.
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    loop {
        fault::point()?;
        let file = builder.tempfile_in(folder)?;
        // A file system without locks has no leftovers removed either.
        let _ = file.as_file().lock();
        // Another process may have taken it for a leftover before the lock was there.
        if file.path().exists() {
            return Ok(file);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<_> = std::fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn files_are_replaced_and_folders_made() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a/b/c.txt");
        write_atomic(&path, b"one").unwrap();
        write_atomic(&path, b"two").unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"two");
        assert_eq!(
            names(path.parent().unwrap()),
            ["c.txt"],
            "no temporary file stays"
        );
    }

    #[test]
    fn a_failing_writer_leaves_the_old_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("rows.csv");
        write_atomic(&path, b"old").unwrap();
        let error = write_atomic_with(&path, |out| {
            out.write_all(b"half of")?;
            Err(io::Error::other("the pen broke"))
        })
        .unwrap_err();
        assert!(
            error.to_string().contains("rows.csv") && error.to_string().contains("the pen broke"),
            "{error}"
        );
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        assert_eq!(names(folder.path()), ["rows.csv"]);
    }

    #[test]
    fn leftovers_go_and_what_is_being_written_stays() {
        let folder = tempfile::tempdir().unwrap();
        let deep = folder.path().join("images/left");
        std::fs::create_dir_all(&deep).unwrap();
        std::fs::write(deep.join(".unfinished-abcDEF"), b"half").unwrap();
        // Not of the shape that this program gives: a user's own.
        std::fs::write(deep.join(".unfinished-essay"), b"all of it").unwrap();
        let mut busy = String::new();
        write_atomic_with(&deep.join("a.png"), |out| {
            out.write_all(b"pixels")?;
            remove_leftovers(folder.path()).map_err(io::Error::other)?;
            busy = names(&deep).join(" ");
            Ok(())
        })
        .unwrap();
        assert_eq!(busy.split(' ').count(), 2, "{busy}");
        assert_eq!(names(&deep), [".unfinished-essay", "a.png"]);
    }

    #[test]
    fn folders_go_in_one_step() {
        let folder = tempfile::tempdir().unwrap();
        let parts = folder.path().join("parts");
        write_atomic(&parts.join("0/test.csv"), b"id").unwrap();
        remove_folder_atomic(&parts).unwrap();
        assert!(names(folder.path()).is_empty());
    }

    #[test]
    fn files_are_hashed() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        std::fs::write(&file, b"abc").unwrap();
        // The published test vector of BLAKE3 for "abc".
        let abc = "6437b3ac38465133ffb63b75273a8db548c558465d79db03fd359c6cd5bd9d85";
        assert_eq!(blake3_file(&file, Kind::Content).unwrap(), abc);
        assert_eq!(blake3_hex(b"abc"), abc);

        let error = blake3_file(&folder.path().join("nothing"), Kind::Content).unwrap_err();
        assert!(
            error.is_not_found() && error.to_string().contains("nothing"),
            "{error}"
        );
    }

    #[test]
    fn a_file_where_a_folder_should_be_is_reported() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        std::fs::write(&file, b"").unwrap();
        let error = check_writable(&file).unwrap_err();
        assert!(matches!(error, Error::Unwritable { .. }), "{error:?}");
        assert!(
            error.to_string().contains(&*file.display().to_string()),
            "{error}"
        );
        assert!(write_atomic(&file.join("x"), b"").is_err());
        check_writable(&folder.path().join("new/folder")).unwrap();
        assert!(names(&folder.path().join("new/folder")).is_empty());
    }

    #[derive(Serialize)]
    struct Row {
        id: &'static str,
        depth_m: Option<f64>,
    }

    #[test]
    fn rows_become_a_table_or_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("out/rows.csv");
        let row = |id, depth_m| Row { id, depth_m };
        write_csv(&path, [row("a,b", Some(1.5)), row("c", None)]).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        assert_eq!(text, "id,depth_m\n\"a,b\",1.5\nc,\n");
        // A map is no row of a table; what was there stays.
        let no_row = std::collections::BTreeMap::from([("id", 1)]);
        assert!(write_csv(&path, [no_row]).is_err());
        assert_eq!(std::fs::read_to_string(&path).unwrap(), text);
        assert_eq!(names(path.parent().unwrap()), ["rows.csv"]);
        write_csv(&path, [] as [Row; 0]).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"");
    }

    #[test]
    fn digests_are_shortened() {
        assert_eq!(digest_prefix(&blake3_hex(b"abc")), "6437b3ac3846");
        assert_eq!(digest_prefix("none"), "none");
    }
}
