//! The folder a set is written to, whatever it is made of: whether it may be, the files that are
//! there and those that are added, and what could not be used.
//!
//! What is made and from what is known to [`crate::build`] and to the modules of the collections.

use std::collections::HashMap;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::SystemTime;

use serde::{Deserialize, Serialize};
use strat_splits::Role;
use strat_store::exr::{DepthHeader, encode_depth};
use strat_store::files;
use strat_store::raster::Plane;
use strat_store::set::{FileRef, PreparedSet};

use crate::error::{Error, Result};

/// File that marks a folder as the output of a preparation, finished or not.
pub const SETTINGS: &str = "settings.yaml";

/// File that lists inputs which could not be used.
pub const FAILURES: &str = "failures.csv";

/// Failures told one by one on stderr; the rest is in [`FAILURES`].
pub(crate) const FAILURES_SHOWN: u64 = 20;

/// An input that could not be used.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Failure {
    /// Role of its sample; none where it is an archive or folder of many.
    pub role: Option<Role>,
    /// Name of its sample, else empty.
    pub id: String,
    /// The file.
    pub file: String,
    /// What is wrong with it.
    pub problem: String,
}

/// Why a piece of a sample is not there: a bad input, or an output that cannot be written,
/// which ends everything.
pub(crate) enum Stop {
    Input { file: String, problem: String },
    Output(Error),
}

pub(crate) type Piece<T> = std::result::Result<T, Stop>;

impl Stop {
    /// A bad input by its name.
    pub fn input(file: impl ToString, problem: impl ToString) -> Self {
        Self::Input {
            file: file.to_string(),
            problem: problem.to_string(),
        }
    }

    /// A bad input that is a file of a folder.
    pub fn path(file: &Path, problem: impl ToString) -> Self {
        Self::input(file.display(), problem)
    }

    /// The same, of a problem that does not yet name it.
    pub fn about(file: &Path, problem: impl std::fmt::Display) -> Self {
        Self::path(file, format!("{}: {problem}", file.display()))
    }

    /// What it costs the sample `id`.
    ///
    /// # Errors
    /// It is an output that cannot be written.
    pub fn failure(self, role: Role, id: &str) -> Result<Failure> {
        match self {
            Self::Input { file, problem } => Ok(Failure {
                role: Some(role),
                id: id.to_owned(),
                file,
                problem,
            }),
            Self::Output(error) => Err(error),
        }
    }
}

/// As many threads as asked for, or one for each core.
pub(crate) fn threads(jobs: Option<usize>) -> Result<rayon::ThreadPool> {
    let jobs = jobs.unwrap_or(0);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(jobs).build();
    pool.map_err(|e| Error::Threads {
        jobs,
        reason: e.to_string(),
    })
}

/// Makes sure that `out` lies in no input folder and is new, empty, or the output of an earlier
/// preparation; `true` for the last, whose settings are still to be compared.
///
/// # Errors
/// It is something else; the message says what and what to do.
pub(crate) fn holds_a_set(out: &Path, inputs: &[&Path]) -> Result<bool> {
    let wrong = |problem: String| Error::Output {
        path: out.to_owned(),
        problem,
    };
    // The nearest ancestor that exists tells where a folder still to be made will be.
    let place = out
        .ancestors()
        .filter(|folder| !folder.as_os_str().is_empty())
        .find_map(|folder| folder.canonicalize().ok());
    for input in inputs {
        if let (Some(place), Ok(input)) = (&place, input.canonicalize())
            && place.starts_with(&input)
        {
            return Err(wrong(format!(
                "this lies inside the input folder {}, which is never written to; give another folder",
                input.display()
            )));
        }
    }
    if out.is_file() {
        return Err(wrong("this is a file; give a folder".to_owned()));
    }
    if out.join(SETTINGS).is_file() {
        return Ok(true);
    }
    if std::fs::read_dir(out).is_ok_and(|mut entries| entries.next().is_some()) {
        return Err(wrong(
            "this folder holds other things and no prepared set; give a new or an empty folder"
                .to_owned(),
        ));
    }
    Ok(false)
}

/// The files of a set while it is made.
pub(crate) struct Output<'a> {
    out: &'a Path,
    /// Hashes stated by the tables of an earlier finished run.
    known: HashMap<String, String>,
    written: AtomicU64,
    kept: AtomicU64,
}

impl<'a> Output<'a> {
    /// The folder, with what an earlier finished run says of its files.
    pub fn open(out: &'a Path) -> Self {
        Self {
            out,
            known: known_hashes(out),
            written: 0.into(),
            kept: 0.into(),
        }
    }

    /// How many files were written.
    pub fn written(&self) -> u64 {
        self.written.load(Ordering::Relaxed)
    }

    /// How many files of an earlier run were kept.
    pub fn kept_files(&self) -> u64 {
        self.kept.load(Ordering::Relaxed)
    }

    /// A file of an earlier run. Files appear whole, so its being there is enough, unless a
    /// finished table knows it with another content, or its input is newer: `changed` says when
    /// that was last written or put into its place.
    pub fn kept(&self, path: &str, changed: Option<SystemTime>) -> Piece<Option<FileRef>> {
        let place = self.out.join(path);
        let Ok(metadata) = std::fs::metadata(&place) else {
            return Ok(None);
        };
        let outdated = changed.is_some_and(|at| metadata.modified().is_ok_and(|made| made < at));
        if outdated || !metadata.is_file() {
            return Ok(None);
        }
        let blake3 = files::blake3_file(&place).map_err(|e| Stop::Output(e.into()))?;
        if self.known.get(path).is_some_and(|known| *known != blake3) {
            return Ok(None);
        }
        self.kept.fetch_add(1, Ordering::Relaxed);
        Ok(Some(FileRef {
            path: path.to_owned(),
            blake3,
        }))
    }

    /// Writes a file.
    pub fn put(&self, path: String, bytes: &[u8]) -> Piece<FileRef> {
        files::write_atomic(&self.out.join(&path), bytes).map_err(|e| Stop::Output(e.into()))?;
        self.written.fetch_add(1, Ordering::Relaxed);
        Ok(FileRef {
            blake3: files::blake3_hex(bytes),
            path,
        })
    }

    /// Writes ground truth in metres.
    pub fn put_depth(&self, path: String, depth_m: &Plane, header: &DepthHeader) -> Piece<FileRef> {
        let bytes = encode_depth(depth_m, header).map_err(|e| Stop::Output(e.into()))?;
        self.put(path, &bytes)
    }
}

/// Hashes by path, from the tables of an earlier finished run; empty if there is none.
fn known_hashes(out: &Path) -> HashMap<String, String> {
    let Ok(set) = PreparedSet::open(out) else {
        return HashMap::new();
    };
    let samples = Role::ALL
        .into_iter()
        .filter_map(|role| set.samples(role).ok())
        .flatten();
    samples
        .flat_map(|sample| {
            let files = sample.files();
            files
                .map(|(_, file)| (file.path.clone(), file.blake3.clone()))
                .collect::<Vec<_>>()
        })
        .collect()
}

/// Writes the list of failures, or removes that of an earlier run if there are none.
pub(crate) fn write_failures(out: &Path, failures: &[Failure]) -> Result<()> {
    let path = out.join(FAILURES);
    if failures.is_empty() {
        return Ok(files::remove(&path)?);
    }
    files::write_atomic_with(&path, |file| {
        let mut table = csv::Writer::from_writer(file);
        for failure in failures {
            table.serialize(failure).map_err(std::io::Error::other)?;
        }
        table.flush()
    })?;
    Ok(())
}
