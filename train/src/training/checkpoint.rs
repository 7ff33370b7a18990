//! Checkpoints: everything a run needs to go on exactly where it was.
//!
//! A checkpoint is a folder `step-NNNNNNNN` with the weights and the optimizer state of both
//! networks (burnpack files), `state.json` (step, settings digest, best score) and
//! `checksums.b3` (BLAKE3 of each file, in the format of `b3sum --check`). It is written
//! under another name and renamed when complete, so a folder with the final name is whole.
//! The random state is the seed and the step (see [`crate::random`]), so nothing else is kept.
//!
//! This module moves bytes; what they mean to the networks is the business of
//! [`crate::training::run`].

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use strat_store::files;
use strat_store::inputs::{self, Kind};

use crate::error::{Error, Result};

/// Version of the layout of the folder.
const FORMAT: u32 = 1;
const STATE: &str = "state.json";
const CHECKSUMS: &str = "checksums.b3";
/// Begins the name of a checkpoint that is being written.
const PARTIAL: &str = ".partial-";
const PREFIX: &str = "step-";

/// The best validation score so far.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Best {
    /// Step after which it was measured.
    pub step: u64,
    /// Epochs done at that step.
    pub epoch: u64,
    /// Name of the score; lower is better.
    pub score: String,
    /// Its value.
    pub value: f64,
}

/// What is known about a run at a checkpoint.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct State {
    /// Layout version of the checkpoint.
    pub format: u32,
    /// Optimizer steps done.
    pub step: u64,
    /// Optimizer steps per epoch.
    pub steps_per_epoch: u64,
    /// Digest of the settings that decide the result.
    pub config_digest: String,
    /// Digest of the prepared set.
    pub data_digest: String,
    /// Best validation score so far, if validation ran.
    pub best: Option<Best>,
    /// Version of the program that wrote it.
    pub tool_version: String,
}

impl State {
    /// A state of the current format and program version.
    #[must_use]
    pub fn new(
        step: u64,
        steps_per_epoch: u64,
        config_digest: String,
        data_digest: String,
        best: Option<Best>,
    ) -> Self {
        Self {
            format: FORMAT,
            step,
            steps_per_epoch,
            config_digest,
            data_digest,
            best,
            tool_version: env!("CARGO_PKG_VERSION").to_owned(),
        }
    }
}

/// A checkpoint in memory.
#[derive(Clone, Debug)]
pub struct Checkpoint {
    /// The run's state.
    pub state: State,
    /// Files by name: weights and optimizer states.
    pub parts: BTreeMap<String, Vec<u8>>,
}

impl Checkpoint {
    /// A part by name.
    ///
    /// # Errors
    /// When the checkpoint does not hold it.
    pub fn part(&self, folder: &Path, name: &str) -> Result<&[u8]> {
        self.parts
            .get(name)
            .map(Vec::as_slice)
            .ok_or_else(|| damaged(folder, format!("it holds no {name}")))
    }
}

fn damaged(folder: &Path, reason: impl Into<String>) -> Error {
    Error::Checkpoint {
        folder: folder.to_path_buf(),
        reason: reason.into(),
    }
}

/// The checkpoints of one run.
#[derive(Clone, Debug)]
pub struct Checkpoints {
    folder: PathBuf,
}

impl Checkpoints {
    /// The checkpoints in `folder`, which need not exist yet.
    #[must_use]
    pub fn new(folder: PathBuf) -> Self {
        Self { folder }
    }

    /// Folder of the checkpoint after `step` steps.
    #[must_use]
    pub fn path(&self, step: u64) -> PathBuf {
        self.folder.join(format!("{PREFIX}{step:08}"))
    }

    /// Steps of the complete checkpoints, ascending.
    ///
    /// # Errors
    /// When the folder exists and cannot be listed.
    pub fn steps(&self) -> Result<Vec<u64>> {
        if !self.folder.exists() {
            return Ok(Vec::new());
        }
        let mut steps = Vec::new();
        for entry in fs_err::read_dir(&self.folder)? {
            let name = entry?.file_name();
            if let Some(step) = name
                .to_str()
                .and_then(|name| name.strip_prefix(PREFIX))
                .and_then(|digits| digits.parse().ok())
            {
                steps.push(step);
            }
        }
        steps.sort_unstable();
        Ok(steps)
    }

    /// Writes a checkpoint; afterwards the folder of its step is there and complete.
    ///
    /// # Errors
    /// When the disk refuses.
    pub fn save(&self, checkpoint: &Checkpoint) -> Result<PathBuf> {
        let target = self.path(checkpoint.state.step);
        let partial = self
            .folder
            .join(format!("{PARTIAL}{:08}", checkpoint.state.step));
        for name in files::names_in(&self.folder)? {
            // What a killed run has left, of whichever step.
            if name.to_string_lossy().starts_with(PARTIAL) {
                files::remove(&self.folder.join(name))?;
            }
        }
        let mut state = serde_json::to_vec_pretty(&checkpoint.state)
            .map_err(|error| damaged(&target, error.to_string()))?;
        state.push(b'\n');
        let mut checksums = String::new();
        let files = checkpoint
            .parts
            .iter()
            .map(|(name, bytes)| (name.as_str(), bytes.as_slice()))
            .chain([(STATE, state.as_slice())]);
        for (name, bytes) in files {
            files::write_atomic(&partial.join(name), bytes)?;
            checksums.push_str(&format!("{}  {name}\n", files::blake3_hex(bytes)));
        }
        files::write_atomic(&partial.join(CHECKSUMS), checksums.as_bytes())?;
        if target.exists() {
            files::remove_folder_atomic(&target)?;
        }
        files::rename(&partial, &target)?;
        Ok(target)
    }

    /// Deletes all but the newest `keep` checkpoints and the one after `best` steps.
    ///
    /// # Errors
    /// When a folder cannot be removed.
    pub fn prune(&self, keep: usize, best: Option<u64>) -> Result<()> {
        let steps = self.steps()?;
        let old = steps.len().saturating_sub(keep.max(1));
        for step in &steps[..old] {
            if Some(*step) != best {
                files::remove_folder_atomic(&self.path(*step))?;
            }
        }
        Ok(())
    }

    /// Reads the checkpoint after `step` steps and compares every file with its hash.
    ///
    /// # Errors
    /// With a sentence that names the folder and what is wrong with it.
    pub fn load(&self, step: u64) -> Result<Checkpoint> {
        let folder = self.path(step);
        let bytes = |name: &str| {
            inputs::read(&folder.join(name), Kind::Weights)
                .map_err(|error| damaged(&folder, error.to_string()))
        };
        let checksums = String::from_utf8(bytes(CHECKSUMS)?)
            .map_err(|_| damaged(&folder, format!("{CHECKSUMS} is not text")))?;
        let mut parts = BTreeMap::new();
        for line in checksums.lines() {
            let Some((hash, name)) = line.split_once("  ") else {
                return Err(damaged(&folder, format!("{CHECKSUMS} has a broken line")));
            };
            if name.contains(['/', '\\']) {
                return Err(damaged(
                    &folder,
                    format!("{CHECKSUMS} names another folder"),
                ));
            }
            let content = bytes(name)?;
            if files::blake3_hex(&content) != hash {
                return Err(damaged(
                    &folder,
                    format!("{name} was changed or cut off after it was written"),
                ));
            }
            parts.insert(name.to_owned(), content);
        }
        let state = parts
            .remove(STATE)
            .ok_or_else(|| damaged(&folder, format!("{CHECKSUMS} does not list {STATE}")))?;
        let state: State = serde_json::from_slice(&state)
            .map_err(|error| damaged(&folder, format!("{STATE}: {error}")))?;
        if state.format != FORMAT {
            return Err(damaged(
                &folder,
                format!(
                    "it has layout {}, this program reads layout {FORMAT}",
                    state.format
                ),
            ));
        }
        Ok(Checkpoint { state, parts })
    }

    /// The newest checkpoint that is whole, and a sentence for each newer one that is not.
    ///
    /// # Errors
    /// When the folder cannot be listed.
    pub fn load_newest(&self) -> Result<(Option<Checkpoint>, Vec<String>)> {
        let mut warnings = Vec::new();
        for step in self.steps()?.into_iter().rev() {
            match self.load(step) {
                Ok(checkpoint) => return Ok((Some(checkpoint), warnings)),
                Err(error) => warnings.push(format!("warning: {error}; trying the one before it")),
            }
        }
        Ok((None, warnings))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn checkpoint(step: u64) -> Checkpoint {
        Checkpoint {
            state: State::new(step, 10, "c".into(), "d".into(), None),
            parts: BTreeMap::from([
                ("generator.bpk".to_owned(), vec![step as u8; 100]),
                ("discriminator.bpk".to_owned(), vec![1, 2, 3]),
            ]),
        }
    }

    fn three() -> (tempfile::TempDir, Checkpoints) {
        let folder = tempfile::tempdir().unwrap();
        let checkpoints = Checkpoints::new(folder.path().join("checkpoints"));
        for step in [5, 10, 15] {
            checkpoints.save(&checkpoint(step)).unwrap();
        }
        (folder, checkpoints)
    }

    #[test]
    fn what_was_saved_is_loaded() {
        let (_folder, checkpoints) = three();
        assert_eq!(checkpoints.steps().unwrap(), [5, 10, 15]);
        let (newest, warnings) = checkpoints.load_newest().unwrap();
        let newest = newest.unwrap();
        assert_eq!(newest.state, checkpoint(15).state);
        assert_eq!(newest.parts, checkpoint(15).parts);
        assert!(warnings.is_empty());
    }

    #[test]
    fn saving_again_replaces_and_leaves_nothing_half_written() {
        let (_folder, checkpoints) = three();
        let mut again = checkpoint(15);
        again.parts.insert("generator.bpk".into(), vec![9]);
        checkpoints.save(&again).unwrap();
        assert_eq!(checkpoints.load(15).unwrap().parts, again.parts);
        let names: Vec<String> = std::fs::read_dir(&checkpoints.folder)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        assert!(
            names.iter().all(|name| name.starts_with(PREFIX)),
            "{names:?}"
        );
    }

    #[test]
    fn a_damaged_checkpoint_is_named_and_the_one_before_is_used() {
        let (_folder, checkpoints) = three();
        let file = checkpoints.path(15).join("generator.bpk");
        let mut bytes = std::fs::read(&file).unwrap();
        bytes.truncate(50);
        std::fs::write(&file, bytes).unwrap();
        let (newest, warnings) = checkpoints.load_newest().unwrap();
        assert_eq!(newest.unwrap().state.step, 10);
        assert_eq!(warnings.len(), 1);
        assert!(
            warnings[0].contains("step-00000015") && warnings[0].contains("generator.bpk"),
            "{}",
            warnings[0]
        );
        std::fs::remove_file(checkpoints.path(10).join(CHECKSUMS)).unwrap();
        std::fs::write(checkpoints.path(5).join(STATE), b"{}").unwrap();
        let (none, warnings) = checkpoints.load_newest().unwrap();
        assert!(none.is_none());
        assert_eq!(warnings.len(), 3);
    }

    #[test]
    fn pruning_keeps_the_newest_and_the_best() {
        let (_folder, checkpoints) = three();
        checkpoints.save(&checkpoint(20)).unwrap();
        checkpoints.prune(2, Some(5)).unwrap();
        assert_eq!(checkpoints.steps().unwrap(), [5, 15, 20]);
        checkpoints.prune(0, None).unwrap();
        assert_eq!(checkpoints.steps().unwrap(), [20]);
    }

    #[test]
    fn no_folder_means_no_checkpoint() {
        let folder = tempfile::tempdir().unwrap();
        let checkpoints = Checkpoints::new(folder.path().join("none"));
        assert!(checkpoints.load_newest().unwrap().0.is_none());
    }
}
