//! The folder of a run: what lies in it, what it was made with, and whether it may be used.
//!
//! It holds the resolved configuration (`config.yaml`), what it was run with (`run.json`), every loss
//! term of every step (`scalars.csv`), validation scores (`validation.csv`), how hard each term pulls
//! (`diagnostics.csv`), `checkpoints/`, `pictures/`, `tensorboard/` and, at the end, `model.onnx`.

use std::fs::{File, TryLockError};
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::time::Duration;

use serde::{Deserialize, Serialize};
use strat_onnx::metadata::TrainingCamera;
use strat_store::inputs::{self, Kind};
use strat_store::{fault, files};

use super::check::Findings;
use super::checkpoint::{Checkpoint, Checkpoints};
use crate::config::Config;
use crate::error::{Error, Result};

pub(crate) const CONFIG: &str = "config.yaml";
const RUN: &str = "run.json";
/// Locked while a training runs in the folder; it holds nothing.
const LOCK: &str = ".lock";
const CHECKPOINTS: &str = "checkpoints";
pub(super) const SCALARS: &str = "scalars.csv";
pub(super) const VALIDATION: &str = "validation.csv";
pub(super) const DIAGNOSTICS: &str = "diagnostics.csv";
pub(super) const PICTURES: &str = "pictures";
/// Event files for TensorBoard.
pub(super) const EVENTS: &str = "tensorboard";
/// Name of the exported model in the run folder.
pub const MODEL: &str = "model.onnx";
/// Name of the exported discriminator in the run folder.
pub const DISCRIMINATOR: &str = "discriminator.onnx";

/// What a run was made with; `run.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunInfo {
    /// Layout version of the run folder.
    pub format: u32,
    /// Version of this program.
    pub tool_version: String,
    /// Deep-learning library and version.
    pub framework: String,
    /// Device it was started on.
    pub device: String,
    /// How far each device but the processor was from it before the training; empty where that was not
    /// looked at.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub device_checks: Vec<Findings>,
    /// Digest of the settings that decide the weights.
    pub config_digest: String,
    /// Digest of the prepared set.
    pub data_digest: String,
    /// Digest of the split, where the data is a split of KITTI.
    pub split_digest: Option<String>,
    /// "kitti" or "rendered".
    pub source: String,
    /// Kernel that the prepared images were resized with.
    pub kernel: String,
    /// Training pairs.
    pub train_pairs: usize,
    /// Drives that the training pairs come from, and those of the initial weights.
    pub train_drives: Vec<String>,
    /// BLAKE3 of the initial weights, if there were any.
    #[serde(default, alias = "start_weights")]
    pub initial_weights: Option<String>,
    /// Whether there were initial weights that do not say what they were trained on.
    #[serde(default)]
    pub unknown_start: bool,
    /// The cameras of the training pairs; none where the set does not know them.
    #[serde(default)]
    pub camera: Option<TrainingCamera>,
    /// Trained values of the generator.
    pub generator_parameters: usize,
    /// Trained values of the discriminator.
    pub discriminator_parameters: usize,
}

/// What lies in the folder of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Found {
    /// No run, and nothing that would be in the way of one.
    Nothing,
    /// A run with the settings and the data that were asked for.
    Run {
        /// Steps of its newest checkpoint, if there is one.
        step: Option<u64>,
        /// Epochs that its model has seen, if there is one.
        model_epoch: Option<u64>,
    },
}

/// Looks for a run of these settings on this data. Nothing is written.
///
/// # Errors
/// The folder holds another run or something else, or cannot be read.
pub fn find(root: &Path, config: &Config, data_digest: &str) -> Result<Found> {
    let folder = RunFolder::new(root.to_path_buf());
    if !folder.is_run() {
        folder.check_free()?;
        return Ok(Found::Nothing);
    }
    folder.check_same(config, &config.digest()?, data_digest)?;
    let model = strat_onnx::model::read(folder.path(MODEL)).ok();
    let metadata = model.and_then(|model| model.info.metadata().cloned());
    Ok(Found::Run {
        step: folder.checkpoints.steps()?.last().copied(),
        model_epoch: metadata.and_then(|m| m.epoch).map(u64::from),
    })
}

/// Whether a process is training in the folder.
#[must_use]
pub fn in_use(root: &Path) -> bool {
    let lock = File::open(root.join(LOCK));
    lock.is_ok_and(|file| matches!(file.try_lock(), Err(TryLockError::WouldBlock)))
}

/// The newest step that the run in the folder has written down, from 0.
#[must_use]
pub fn newest_step(root: &Path) -> Option<u64> {
    /// Longer than any line.
    const TAIL: u64 = 4096;
    let mut file = File::open(root.join(SCALARS)).ok()?;
    let length = file.metadata().ok()?.len();
    file.seek(SeekFrom::Start(length.saturating_sub(TAIL)))
        .ok()?;
    let mut tail = Vec::new();
    file.take(TAIL).read_to_end(&mut tail).ok()?;
    let tail = String::from_utf8_lossy(&tail);
    let (lines, _unfinished) = tail.rsplit_once('\n')?;
    let (_, line) = lines.rsplit_once('\n').unwrap_or(("", lines));
    line.split(',').next()?.parse().ok()
}

/// The run folder.
pub(super) struct RunFolder {
    root: PathBuf,
    pub checkpoints: Checkpoints,
}

impl RunFolder {
    pub fn new(root: PathBuf) -> Self {
        let checkpoints = Checkpoints::new(root.join(CHECKPOINTS));
        Self { root, checkpoints }
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.root.join(name)
    }

    /// Whether there is a run in the folder.
    pub fn is_run(&self) -> bool {
        self.path(RUN).exists() && self.path(CONFIG).exists()
    }

    /// Looks at the output folder before any work. True when it holds a run.
    pub fn examine(&self, resume: bool, force: bool) -> Result<bool> {
        let is_run = self.is_run();
        if is_run && !resume && !force {
            return Err(Error::RunExists(self.root.clone()));
        }
        if !is_run && resume {
            return Err(Error::NoRun {
                folder: self.root.clone(),
                reason: if self.path(CONFIG).exists() {
                    "it was ended before its first step; start it again without --resume".to_owned()
                } else {
                    format!("{RUN} is missing, so nothing can be resumed")
                },
            });
        }
        if !is_run {
            self.check_free()?;
        }
        // Find out now, not after hours, whether the folder can be written.
        files::check_writable(&self.root)?;
        files::remove_leftovers(&self.root)?;
        Ok(is_run)
    }

    /// Refuses a folder that holds what no run has left.
    fn check_free(&self) -> Result<()> {
        // What a run leaves that was killed while it began is no reason to refuse.
        let begun = |name: &str| {
            [CONFIG, LOCK].contains(&name) || name.starts_with(files::UNFINISHED_PREFIX)
        };
        if self.root.exists() {
            for entry in fs_err::read_dir(&self.root)? {
                if !begun(&entry?.file_name().to_string_lossy()) {
                    return Err(Error::NotARun(self.root.clone()));
                }
            }
        }
        Ok(())
    }

    /// Keeps other trainings out of the folder until the lock is dropped or its process ends,
    /// however it ends.
    ///
    /// # Errors
    /// Another training is running there.
    pub fn lock(&self) -> Result<File> {
        let mut options = fs_err::OpenOptions::new();
        let file = options.create(true).truncate(false).write(true);
        fault::point()?;
        let file = file.open(self.path(LOCK))?.into_parts().0;
        // A program that this process is just starting holds all its locks for an instant.
        for tries_left in (0..10).rev() {
            match file.try_lock() {
                Ok(()) => return Ok(file),
                Err(TryLockError::WouldBlock) if tries_left > 0 => {
                    std::thread::sleep(Duration::from_millis(20));
                }
                Err(TryLockError::WouldBlock) => break,
                Err(TryLockError::Error(error)) => return Err(error.into()),
            }
        }
        Err(Error::InUse(self.root.clone()))
    }

    pub fn config(&self) -> Result<Config> {
        let path = self.path(CONFIG);
        if !path.exists() {
            return Err(Error::NoRun {
                folder: self.root.clone(),
                reason: format!("{CONFIG} is missing"),
            });
        }
        Ok(strat_store::yaml::load(&path)?)
    }

    pub fn info(&self) -> Result<RunInfo> {
        let bytes = inputs::read(&self.path(RUN), Kind::Record)?;
        serde_json::from_slice(&bytes).map_err(|error| Error::NoRun {
            folder: self.root.clone(),
            reason: format!("{RUN} is damaged: {error}"),
        })
    }

    /// What the run was made with; refuses to resume with settings or data that would give other weights.
    pub fn check_same(
        &self,
        config: &Config,
        config_digest: &str,
        data_digest: &str,
    ) -> Result<RunInfo> {
        let info = self.info()?;
        let refuse = |reason: String| {
            Err(Error::CannotResume {
                folder: self.root.clone(),
                reason,
            })
        };
        if info.data_digest != data_digest {
            return refuse(format!(
                "it was trained on another prepared set (digest {:.12}, now {data_digest:.12})",
                info.data_digest
            ));
        }
        // The run may be older than some setting: then its digest lacks that setting's default.
        let own = self.config()?;
        if info.config_digest != config_digest && own.digest()? != config_digest {
            let changed = own.differences(config)?;
            return refuse(format!("its settings differ: {}", changed.join("; ")));
        }
        Ok(info)
    }

    /// The newest checkpoint that is whole, and a sentence for each newer one that is not.
    ///
    /// # Errors
    /// When it was not made by this run, or the folder cannot be read.
    pub fn newest(&self, info: &RunInfo) -> Result<(Option<Checkpoint>, Vec<String>)> {
        let (newest, warnings) = self.checkpoints.load_newest()?;
        if let Some(checkpoint) = &newest {
            self.check_own(checkpoint, info)?;
        }
        Ok((newest, warnings))
    }

    /// Refuses a checkpoint of another configuration or another prepared set.
    pub fn check_own(&self, checkpoint: &Checkpoint, info: &RunInfo) -> Result<()> {
        let state = &checkpoint.state;
        let refuse = |what: &str, found: &str, own: &str| {
            Err(Error::Checkpoint {
                folder: self.checkpoints.path(state.step),
                reason: format!(
                    "it was made with another {what} (digest {found:.12}, this run has {own:.12}), so \
                     it belongs to another run; move it away"
                ),
            })
        };
        if state.config_digest != info.config_digest {
            return refuse("configuration", &state.config_digest, &info.config_digest);
        }
        if state.data_digest != info.data_digest {
            return refuse("prepared set", &state.data_digest, &info.data_digest);
        }
        Ok(())
    }

    /// Writes what is known at the start; a new run first removes what an old one left.
    pub fn prepare(&self, config: &Config, info: &RunInfo, resumed: bool) -> Result<()> {
        if !resumed {
            // First what could be resumed, last what makes the folder a run: killed between, it can be
            // replaced again.
            if self.path(CHECKPOINTS).exists() {
                files::remove_folder_atomic(&self.path(CHECKPOINTS))?;
            }
            let tables = [SCALARS, VALIDATION, DIAGNOSTICS];
            let rest = [MODEL, DISCRIMINATOR, RUN];
            for name in [PICTURES, EVENTS].into_iter().chain(tables).chain(rest) {
                files::remove(&self.path(name))?;
            }
        }
        files::write_atomic(&self.path(CONFIG), config.to_yaml()?.as_bytes())?;
        let mut text =
            serde_json::to_string_pretty(info).map_err(|error| Error::Config(error.to_string()))?;
        text.push('\n');
        files::write_atomic(&self.path(RUN), text.as_bytes())?;
        Ok(())
    }
}
