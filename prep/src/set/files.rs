//! The files of a set while it is made: those that are there and those that are added.

use std::collections::{BTreeMap, HashMap};
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::SystemTime;

use strat_splits::Role;
use strat_store::exr::{DepthHeader, encode_depth};
use strat_store::files;
use strat_store::inputs::Kind;
use strat_store::raster::Plane;
use strat_store::set::{FileRef, PreparedSet};

use super::sample::{SampleError, SampleResult};
use super::settings::Settings;
use crate::input::source::Source;

/// The files of a set while it is made.
pub struct SetFiles<'a> {
    out: &'a Path,
    /// What they depend on.
    pub settings: &'a Settings,
    /// Hashes stated by the tables of an earlier finished run.
    known: HashMap<String, String>,
    written: AtomicU64,
    kept: AtomicU64,
    doubts: Mutex<BTreeMap<Doubt, (u64, String)>>,
}

/// Something about ground truth that is not an error and yet may be a mistake.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Doubt {
    /// Disparities below 0, which count as not measured.
    NegativeDisparity,
    /// Depth at which the cameras see less than a tenth of a pixel of disparity.
    BeyondSight,
}

impl Doubt {
    /// What may be wrong, for a sentence that begins with how many maps it concerns.
    fn explanation(self) -> &'static str {
        match self {
            Self::NegativeDisparity => {
                "have negative disparities, which count as not measured; if the cameras' principal points \
                 differ (`doffs` of Middlebury), give the difference in the column `disparity_offset_px`, \
                 and if they stand for pixels without a measurement, name them in the column `invalid`"
            }
            Self::BeyondSight => {
                "have depth at which these cameras see less than a tenth of a pixel of disparity; depth \
                 and baseline should be metres, and what was not measured 0"
            }
        }
    }
}

impl<'a> SetFiles<'a> {
    /// The folder, with what an earlier finished run says of its files.
    pub fn open(out: &'a Path, settings: &'a Settings) -> Self {
        Self {
            out,
            settings,
            known: known_hashes(out),
            written: 0.into(),
            kept: 0.into(),
            doubts: Mutex::default(),
        }
    }

    /// Notes that some pixels of a map are doubtful.
    pub fn doubt(&self, doubt: Doubt, map: &Source, pixels: usize) {
        let example = format!("{map}: {pixels} pixels");
        let mut doubts = self.doubts.lock().unwrap_or_else(PoisonError::into_inner);
        let (count, first) = doubts.entry(doubt).or_insert((0, example.clone()));
        *count += 1;
        // The same one, whichever thread came first.
        if example < *first {
            *first = example;
        }
    }

    /// The doubts as sentences.
    pub fn doubts(&self) -> Vec<String> {
        let doubts = self.doubts.lock().unwrap_or_else(PoisonError::into_inner);
        let sentence = |(doubt, (count, first)): (&Doubt, &(u64, String))| {
            format!("{count} maps {} (first: {first})", doubt.explanation())
        };
        doubts.iter().map(sentence).collect()
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
    ///
    /// # Errors
    /// It is there and cannot be read.
    pub fn kept(&self, path: &str, changed: Option<SystemTime>) -> SampleResult<Option<FileRef>> {
        let file = self.out.join(path);
        let Ok(metadata) = std::fs::metadata(&file) else {
            return Ok(None);
        };
        let outdated = changed.is_some_and(|at| metadata.modified().is_ok_and(|made| made < at));
        if outdated || !metadata.is_file() {
            return Ok(None);
        }
        let blake3 =
            files::blake3_file(&file, Kind::Content).map_err(|e| SampleError::Output(e.into()))?;
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
    ///
    /// # Errors
    /// It cannot be written.
    pub fn put(&self, path: String, bytes: &[u8]) -> SampleResult<FileRef> {
        files::write_atomic(&self.out.join(&path), bytes)
            .map_err(|e| SampleError::Output(e.into()))?;
        self.written.fetch_add(1, Ordering::Relaxed);
        Ok(FileRef {
            blake3: files::blake3_hex(bytes),
            path,
        })
    }

    /// Writes ground truth in metres.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn put_depth(
        &self,
        path: String,
        depth_m: &Plane,
        header: &DepthHeader,
    ) -> SampleResult<FileRef> {
        let bytes = encode_depth(depth_m, header).map_err(|e| SampleError::Output(e.into()))?;
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
