//! Files that appear whole or not at all, tables among them, and their hashes.
//!
//! Everything is written to a temporary file in the target's folder and renamed. There is
//! no fsync: after a power failure files may be missing, and a second run writes them again.

use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use fs_err as fs;
use serde::Serialize;
use tempfile::NamedTempFile;

use crate::error::{Error, Result};

/// Prefix of temporary files; what carries it is a leftover of a killed run.
pub const UNFINISHED_PREFIX: &str = ".unfinished-";

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
    pub out: BufWriter<NamedTempFile>,
}

impl Unfinished {
    pub fn create(path: &Path) -> Result<Self> {
        let folder = match path.parent() {
            Some(parent) if !parent.as_os_str().is_empty() => parent,
            _ => Path::new("."),
        };
        std::fs::create_dir_all(folder).map_err(|e| Error::io("create the folder", folder, e))?;
        let file = unfinished_in(folder).map_err(|e| Error::io("write", path, e))?;
        Ok(Self {
            path: path.to_owned(),
            out: BufWriter::with_capacity(1 << 16, file),
        })
    }

    pub fn finish(self) -> Result<()> {
        let written = self
            .out
            .into_inner()
            .map_err(io::IntoInnerError::into_error);
        let persisted = written.and_then(|file| file.persist(&self.path).map_err(|e| e.error));
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
        let mut table = csv::Writer::from_writer(file);
        for row in rows {
            table.serialize(row).map_err(io::Error::other)?;
        }
        table.flush()
    })
}

/// Copies a file byte by byte; the copy appears whole or not at all.
///
/// # Errors
/// `from` cannot be read or `to` not be written.
pub fn copy_atomic(from: &Path, to: &Path) -> Result<()> {
    let mut source = std::fs::File::open(from).map_err(|e| Error::io("read", from, e))?;
    write_atomic_with(to, |out| io::copy(&mut source, out).map(drop))
}

/// Reads a whole file.
///
/// # Errors
/// The file cannot be read; the message names it.
pub fn read(path: &Path) -> Result<Vec<u8>> {
    std::fs::read(path).map_err(|e| Error::io("read", path, e))
}

/// Removes a file or a folder with all that is in it; nothing there is as good.
///
/// # Errors
/// It cannot be removed.
pub fn remove(path: &Path) -> Result<()> {
    let removed = if path.is_dir() {
        std::fs::remove_dir_all(path)
    } else {
        std::fs::remove_file(path)
    };
    match removed {
        Err(e) if e.kind() != io::ErrorKind::NotFound => Err(Error::io("remove", path, e)),
        _ => Ok(()),
    }
}

/// Makes sure that `folder` exists and can be written to, by writing to it.
///
/// # Errors
/// It cannot be created or written to.
pub fn check_writable(folder: &Path) -> Result<()> {
    let written = std::fs::create_dir_all(folder).and_then(|()| unfinished_in(folder));
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
/// The file cannot be read.
pub fn blake3_file(path: &Path) -> Result<String> {
    let read = || {
        let mut hasher = blake3::Hasher::new();
        hasher.update_reader(fs::File::open(path)?)?;
        Ok(hasher.finalize().to_hex().to_string())
    };
    read().map_err(|e| Error::io("read", path, e))
}

fn unfinished_in(folder: &Path) -> io::Result<NamedTempFile> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(UNFINISHED_PREFIX);
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        // Temporary files are private by default; these become ordinary files.
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    builder.tempfile_in(folder)
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
    fn copies_and_hashes() {
        let folder = tempfile::tempdir().unwrap();
        let (from, to) = (folder.path().join("from"), folder.path().join("deep/to"));
        std::fs::write(&from, b"abc").unwrap();
        copy_atomic(&from, &to).unwrap();
        // The published test vector of BLAKE3 for "abc".
        let abc = "6437b3ac38465133ffb63b75273a8db548c558465d79db03fd359c6cd5bd9d85";
        assert_eq!(blake3_file(&to).unwrap(), abc);
        assert_eq!(blake3_hex(b"abc"), abc);

        let error = copy_atomic(&folder.path().join("nothing"), &to).unwrap_err();
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
