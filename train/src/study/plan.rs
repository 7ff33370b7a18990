//! The runs of a study.

use std::path::{Path, PathBuf};

use strat_splits::Role;
use strat_store::claim;
use strat_store::set::{Content, PreparedSet};

use super::file::StudyFile;
use crate::config::{Config, nearest};
use crate::data::pairs::Pairs;
use crate::error::{Error, Result};
use crate::training::schedule::Timeline;

/// A prepared set of a study.
#[derive(Clone, Debug, PartialEq)]
pub struct StudySet {
    /// Its folder, absolute.
    pub folder: PathBuf,
    /// What it is made of.
    pub content: Content,
    /// Digest of its data.
    pub digest: String,
    /// Training pairs.
    pub pairs: usize,
    /// Validation pairs.
    pub validation_pairs: usize,
}

impl StudySet {
    /// Opens the set in a folder.
    ///
    /// # Errors
    /// There is no set, or none to train on.
    pub fn open(folder: &Path) -> Result<Self> {
        let set = PreparedSet::open(folder)?;
        // Sizes and the cache are irrelevant: the pairs are only counted.
        let pairs = Pairs::from_set(&set, Role::Train, 1, 1, 0)?.count();
        let held_out = set.samples(Role::Val)?;
        let held_out = held_out.iter().filter(|sample| sample.right.is_some());
        Ok(Self {
            folder: claim::resolve(folder)?,
            content: set.manifest.content,
            digest: set.manifest.data_digest,
            pairs,
            validation_pairs: held_out.count(),
        })
    }
}

/// A run of a study.
#[derive(Clone, Debug)]
pub struct StudyRun {
    /// `VARIANT@SEED`, where there are several sets `VARIANT-SET@SEED`.
    pub name: String,
    /// What is compared.
    pub variant: String,
    /// Its seed.
    pub seed: u64,
    /// Which of the sets.
    pub set: usize,
    /// All its settings.
    pub config: Config,
    /// The same as `key=value` texts on top of the study's base.
    pub settings: Vec<String>,
    /// Its steps and epochs.
    pub timeline: Timeline,
}

impl StudyRun {
    /// Its folder within that of the study, with `/`.
    #[must_use]
    pub fn folder(&self) -> String {
        format!("runs/{}", self.name)
    }
}

/// A study with all its runs.
#[derive(Clone, Debug)]
pub struct Study {
    /// What was asked.
    pub file: StudyFile,
    /// The sets.
    pub sets: Vec<StudySet>,
    /// The runs: all variants with the first seed, then all with the next.
    pub runs: Vec<StudyRun>,
}

impl Study {
    /// Resolves the settings of every run. The split is that of its set.
    ///
    /// # Errors
    /// Settings or sets that cannot be used, with the variant's name.
    pub fn new(file: StudyFile) -> Result<Self> {
        if file.data.is_empty() {
            return Err(Error::Study(
                "which prepared set? Give --data with a folder that `prep` has written, or `data:` in \
                 the study"
                    .to_owned(),
            ));
        }
        let sets = file.data.iter().map(|folder| StudySet::open(folder));
        let sets = sets.collect::<Result<Vec<_>>>()?;
        for (index, set) in sets.iter().enumerate() {
            if sets[..index]
                .iter()
                .any(|other| other.content == set.content)
            {
                return Err(Error::Study(format!(
                    "two of the sets are made of {}, so their runs would have the same names; make two \
                     studies",
                    set.content
                )));
            }
        }
        let mut runs = Vec::new();
        for seed in &file.seeds {
            for (index, set) in sets.iter().enumerate() {
                for (variant, settings) in &file.variants {
                    let own = [format!("split={}", set.content), format!("seed={seed}")];
                    let settings: Vec<String> = settings.iter().cloned().chain(own).collect();
                    let config = Config::resolve(&file.base, file.preset, &settings)
                        .map_err(|error| Error::Study(format!("variant `{variant}`: {error}")))?;
                    runs.push(StudyRun {
                        name: match sets.len() {
                            1 => format!("{variant}@{seed}"),
                            _ => format!("{variant}-{}@{seed}", set.content),
                        },
                        variant: variant.clone(),
                        seed: *seed,
                        set: index,
                        timeline: Timeline::new(&config, set.pairs),
                        config,
                        settings,
                    });
                }
            }
        }
        for (index, run) in runs.iter().enumerate() {
            if runs[..index].iter().any(|other| other.name == run.name) {
                return Err(Error::Study(format!(
                    "two runs would be called {}; rename a variant",
                    run.name
                )));
            }
        }
        Ok(Self { file, sets, runs })
    }

    /// The runs of these names, in the study's order; without names all.
    ///
    /// # Errors
    /// There is none of a name.
    pub fn select(&self, names: &[String]) -> Result<Vec<&StudyRun>> {
        for name in names {
            if !self.runs.iter().any(|run| run.name == *name) {
                let known = self.runs.iter().map(|run| run.name.as_str());
                return Err(Error::Study(format!(
                    "the study has no run {name}{}; `--dry-run` lists its {} runs",
                    nearest(name, known),
                    self.runs.len()
                )));
            }
        }
        let chosen = |run: &&StudyRun| names.is_empty() || names.contains(&run.name);
        Ok(self.runs.iter().filter(chosen).collect())
    }

    /// The set of a run.
    #[must_use]
    pub fn set(&self, run: &StudyRun) -> &StudySet {
        &self.sets[run.set]
    }
}
