//! The folder of a leaderboard: what lies in it, and `leaderboard.yaml`, which names the data sets
//! whose rows are taken.
//!
//! ```text
//! leaderboard.yaml            title and data sets, kept by the maintainers
//! published/*.csv             rows that others have printed, with citations
//! submissions/METHOD/         what `bench publish` has written: rows, lines, run.yaml, card.yaml
//! ```

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use strat_metrics::tables::{Coverage, Source};
use strat_splits::Role;
use strat_store::claim::Mark;
use strat_store::set::PreparedSet;
use strat_store::{files, yaml};

use crate::text::{check_digest, check_name};

/// Version of the layout, the first key of `leaderboard.yaml`.
pub const FORMAT: u32 = 1;

/// The file that makes a folder a leaderboard.
pub const BOARD: &str = "leaderboard.yaml";

/// The folder of submissions.
pub const SUBMISSIONS: &str = "submissions";

/// The folder of published rows.
pub const PUBLISHED: &str = "published";

/// Whose a leaderboard's folder is. `init` takes none with anything in it.
pub const MARK: Mark = Mark {
    command: "bench leaderboard init",
    record: BOARD,
    begins: "strat_leaderboard: 1\n",
    writes: |_| true,
};

/// Why a leaderboard cannot be used at all.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BoardError {
    /// A file cannot be read or written.
    #[error(transparent)]
    Store(#[from] strat_store::Error),
    /// The folder is none.
    #[error(
        "{folder} is not a leaderboard: it has no {BOARD}; `bench leaderboard init {folder}` lays one out",
        folder = .0.display()
    )]
    None(PathBuf),
    /// `leaderboard.yaml` says something impossible.
    #[error("{}: {problem}", path.display())]
    Config {
        /// The file.
        path: PathBuf,
        /// A sentence.
        problem: String,
    },
    /// A table cannot be written.
    #[error(transparent)]
    Csv(#[from] strat_metrics::CsvError),
}

/// `leaderboard.yaml`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Board {
    /// [`FORMAT`].
    pub strat_leaderboard: u32,
    /// What stands above the pages.
    pub title: String,
    /// The data sets whose rows are taken.
    #[serde(default)]
    pub data: Vec<DataSet>,
}

/// A prepared set that submissions may be measured on.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DataSet {
    /// Digest of the prepared set (`data_digest` in its manifest and in each row).
    pub digest: String,
    /// Name for people.
    pub name: String,
    /// `kitti`, `rendered`, or the name of another collection.
    pub source: String,
    /// Name of the split, as rows have it.
    pub split: String,
    /// Test images that the set has.
    pub images: u64,
}

impl DataSet {
    /// Describes a prepared set.
    ///
    /// # Errors
    /// The folder is no prepared set.
    pub fn of(folder: &Path) -> Result<Self, strat_store::Error> {
        let set = PreparedSet::open(folder)?;
        let images = set.samples(Role::Test)?.len() as u64;
        let manifest = &set.manifest;
        let split = manifest.content.to_string();
        let name = match manifest.source.as_str() {
            "rendered" => format!("Rendered world, {split} split"),
            "kitti" => format!("KITTI, {split} split"),
            other => format!("{other}, {split}"),
        };
        Ok(Self {
            digest: manifest.data_digest.clone(),
            name,
            source: manifest.source.clone(),
            split,
            images,
        })
    }

    /// Images of the published test set of this split, or else those of the set.
    #[must_use]
    pub fn of_split(&self) -> u64 {
        let split = strat_splits::test_images(&self.split).map_or(0, |images| images as u64);
        split.max(self.images)
    }

    /// Images that a complete submission has under a protocol.
    #[must_use]
    pub fn under(&self, protocol: &str) -> u64 {
        self.coverage(self.images).under(protocol)
    }

    /// Images that the whole published test set has under a protocol.
    #[must_use]
    pub fn split_under(&self, protocol: &str) -> u64 {
        self.coverage(self.of_split()).under(protocol)
    }

    /// Whether its numbers stand beside published ones: recorded by KITTI, and every image.
    #[must_use]
    pub fn competes(&self) -> bool {
        Source::from(self.source.as_str()).competes() && self.images == self.of_split()
    }

    fn coverage(&self, expected_images: u64) -> Coverage {
        Coverage {
            expected_images,
            source: Source::from(self.source.as_str()),
        }
    }

    /// The lines of `leaderboard.yaml` that admit it.
    #[must_use]
    pub fn yaml(&self) -> String {
        format!(
            "  - digest: {}\n    name: {}\n    source: {}\n    split: {}\n    images: {}\n",
            self.digest,
            quoted(&self.name),
            quoted(&self.source),
            quoted(&self.split),
            self.images
        )
    }
}

/// A text as YAML takes it whatever it says: JSON is YAML.
pub(crate) fn quoted(text: &str) -> String {
    serde_json::Value::from(text).to_string()
}

impl Board {
    /// Reads `leaderboard.yaml`.
    ///
    /// # Errors
    /// There is none, or it is not usable.
    pub fn open(folder: &Path) -> Result<Self, BoardError> {
        let path = folder.join(BOARD);
        if !path.is_file() {
            return Err(BoardError::None(folder.to_owned()));
        }
        let board: Self = yaml::load(&path)?;
        match board.problem() {
            Some(problem) => Err(BoardError::Config { path, problem }),
            None => Ok(board),
        }
    }

    fn problem(&self) -> Option<String> {
        if self.strat_leaderboard != FORMAT {
            return Some(format!(
                "strat_leaderboard is {}; this version of bench reads {FORMAT}",
                self.strat_leaderboard
            ));
        }
        if let Err(why) = check_name(&self.title) {
            return Some(format!("the title {:?} {why}", self.title));
        }
        for (index, data) in self.data.iter().enumerate() {
            let texts = [
                ("name", &data.name),
                ("source", &data.source),
                ("split", &data.split),
            ];
            for (key, text) in texts {
                if let Err(why) = check_name(text) {
                    return Some(format!("data: {key} {text:?} {why}"));
                }
            }
            if let Err(why) = check_digest(&data.digest) {
                return Some(format!("data: digest {:?} {why}", data.digest));
            }
            if data.images == 0 {
                return Some(format!("data: {} has no images", data.name));
            }
            if self.data[..index]
                .iter()
                .any(|other| other.digest == data.digest)
            {
                return Some(format!("data: {:.12} is listed twice", data.digest));
            }
        }
        None
    }

    /// The data set of a digest.
    #[must_use]
    pub fn data_set(&self, digest: &str) -> Option<&DataSet> {
        self.data.iter().find(|data| data.digest == digest)
    }
}

/// The names of all submissions, sorted; a sentence for what is none.
pub(crate) fn submissions(folder: &Path) -> Result<(Vec<String>, Vec<String>), BoardError> {
    let (mut names, mut problems) = (Vec::new(), Vec::new());
    for name in files::names_in(&folder.join(SUBMISSIONS))? {
        let text = name.to_string_lossy().into_owned();
        let path = folder.join(SUBMISSIONS).join(&name);
        // Explains an empty folder, or keeps it in git.
        if ["README.md", ".gitkeep"].contains(&text.as_str()) {
            continue;
        }
        if let Err(why) = crate::text::check_folder(&text) {
            problems.push(format!("the folder {text:?} {why}"));
        } else if path.symlink_metadata().is_ok_and(|found| found.is_dir()) {
            names.push(text);
        } else {
            problems.push(format!(
                "{text} is not a folder (links are not followed); each submission is a folder that `bench publish` wrote"
            ));
        }
    }
    names.sort();
    problems.sort();
    Ok((names, problems))
}
