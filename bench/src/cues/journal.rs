//! What a run has measured so far, so that an interrupted one goes on where it stopped.
//!
//! A file of rows per model in the output folder, to which the rows of each job are added as soon as
//! they are there. Its name carries a digest of everything that can change a row: another model, other
//! sprites, backgrounds or options have another journal. A finished run removes its journals.

use std::path::{Path, PathBuf};

use strat_store::files::{self, Appending};
use strat_store::inputs::{self, Kind};

use super::{error::CueError, rows::CueRow};
use crate::evaluate::record::slug;

/// The open journal of one model.
pub struct Journal {
    path: PathBuf,
    file: Appending,
    /// The header line is written with the first row.
    has_header: bool,
}

impl Journal {
    /// Opens the journal of `model` in `folder` and returns with it the rows that an interrupted run left
    /// there. `identity` is a digest of everything that can change a row.
    ///
    /// # Errors
    /// The file cannot be written. One that cannot be read is begun anew.
    pub fn open(
        folder: &Path,
        model: &str,
        identity: &str,
    ) -> Result<(Self, Vec<CueRow>), CueError> {
        let name = format!(
            "unfinished-cues-{}-{}.csv",
            slug(model),
            files::digest_prefix(identity)
        );
        let path = folder.join(name);
        let found = read(&path);
        files::write_csv(&path, &found)?;
        let file = Appending::open(&path)?;
        let journal = Self {
            has_header: !found.is_empty(),
            path,
            file,
        };
        Ok((journal, found))
    }

    /// Adds the rows of one job.
    ///
    /// # Errors
    /// The disk is full or gone.
    pub fn add(&mut self, rows: &[CueRow]) -> Result<(), CueError> {
        let mut writer = match self.has_header {
            true => strat_csv::Writer::appending(Vec::new()),
            false => strat_csv::Writer::new(Vec::new()),
        };
        for row in rows {
            writer
                .serialize(row)
                .map_err(|error| unwritable(&self.path, std::io::Error::other(error)))?;
        }
        self.has_header |= !rows.is_empty();
        let bytes = writer
            .into_inner()
            .map_err(|error| unwritable(&self.path, error))?;
        // One call of the system for each job, so that its rows stay together.
        Ok(self.file.add(&bytes)?)
    }

    /// Removes the journal, whose rows are in the results, and those of other runs of the model, which
    /// nothing can go on from any more.
    ///
    /// # Errors
    /// One cannot be removed.
    pub fn finish(self) -> Result<(), CueError> {
        drop(self.file);
        let name = |path: &Path| {
            path.file_name()
                .map(|name| name.to_string_lossy().into_owned())
        };
        let own = name(&self.path).unwrap_or_default();
        let prefix = own.rsplit_once('-').map_or("", |(prefix, _)| prefix);
        let folder = self.path.parent().unwrap_or(Path::new("."));
        for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
            let other = name(&entry.path()).unwrap_or_default();
            if other.len() == own.len() && other.rsplit_once('-').is_some_and(|(p, _)| p == prefix)
            {
                files::remove(&entry.path())?;
            }
        }
        Ok(())
    }
}

fn unwritable(path: &Path, source: std::io::Error) -> CueError {
    CueError::Journal {
        path: path.to_path_buf(),
        source,
    }
}

/// The rows of a file up to its last whole line; none if it is not there or something else.
fn read(path: &Path) -> Vec<CueRow> {
    let Ok(mut bytes) = inputs::read(path, Kind::Table) else {
        return Vec::new();
    };
    let end = bytes.iter().rposition(|&byte| byte == b'\n');
    bytes.truncate(end.map_or(0, |end| end + 1));
    strat_csv::Reader::new(bytes.as_slice())
        .deserialize()
        .unwrap_or_default()
}
