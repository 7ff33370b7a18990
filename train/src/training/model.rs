//! The model of a run: what its file says of it, and its export from a checkpoint.

use std::path::{Path, PathBuf};

use strat_onnx::metadata::{
    DiscriminatorMetadata, InputRange, ModelMetadata, OutputMeaning, Weights,
};
use strat_store::claim;

use super::checkpoint::State;
use super::folder::{DISCRIMINATOR, MODEL, RunFolder, RunInfo};
use super::trainer::Trainer;
use crate::config::{Config, Objective};
use crate::device::DeviceChoice;
use crate::error::{Error, Result};
use crate::export;
use crate::network::generator::Generator;
use crate::network::initial_weights;

/// Whether [`export_run`] writes weights instead of a model to this file.
#[must_use]
pub fn is_weights_file(path: &Path) -> bool {
    path.extension()
        .is_some_and(|extension| extension == "safetensors")
}

/// What [`export_run`] has written.
#[derive(Clone, Debug, PartialEq)]
pub struct Exported {
    /// The file.
    pub path: PathBuf,
    /// Largest difference between the trained network and the file, in fractions of the image
    /// width, or of logits; none for weights, which are written as they are.
    pub parity: Option<f64>,
    /// Sentences about checkpoints that could not be used.
    pub warnings: Vec<String>,
}

/// Writes the model of a finished or interrupted run from its newest (or best) checkpoint: ONNX, or
/// the weights of all its networks where `out` ends in `.safetensors`. An export of another run is
/// replaced with `force` only.
///
/// # Errors
/// When `out` is another file than an export, the folder holds no run, no usable checkpoint, or the model
/// cannot be written.
pub fn export_run(
    run: &Path,
    out: Option<&Path>,
    best: bool,
    weights: Weights,
    force: bool,
) -> Result<Exported> {
    let what = if out.is_some_and(is_weights_file) {
        What::Weights
    } else {
        What::Model
    };
    let Opened {
        config,
        info,
        state,
        trainer,
        target,
        warnings,
    } = Opened::new(run, out, what, best, force)?;
    if what == What::Weights {
        // Without the list of drives the file says that its training is unknown, as it is.
        let drives = (!info.unknown_start).then_some(info.train_drives.as_slice());
        initial_weights::write(&trainer.all_parameters(), drives, &target)?;
        return Ok(Exported {
            path: target,
            parity: None,
            warnings,
        });
    }
    let generator = trainer.generator();
    let parity = export_model(&generator, &config, &info, &state, weights, &target)?;
    Ok(Exported {
        path: target,
        parity: Some(parity),
        warnings,
    })
}

/// Writes the discriminator of a run, where there are two that of the left view, from its newest (or
/// best) checkpoint. An export of another run is replaced with `force` only.
///
/// # Errors
/// As [`export_run`], or the run has no discriminator.
pub fn export_discriminator(
    run: &Path,
    out: Option<&Path>,
    best: bool,
    force: bool,
) -> Result<Exported> {
    let opened = Opened::new(run, out, What::Discriminator, best, force)?;
    let (config, info, state) = (&opened.config, &opened.info, &opened.state);
    let network = opened.trainer.left_discriminator();
    let network = network.ok_or_else(|| Error::NoRun {
        folder: run.to_path_buf(),
        reason: format!(
            "it was trained without a discriminator (variant {})",
            variant_name(config)
        ),
    })?;
    let [height, width] = config.input.size();
    let metadata = DiscriminatorMetadata {
        // Patches are never larger than the image.
        patch: config.discriminator.patch.min(height).min(width) as u32,
        image_width: config.input.width,
        image_height: config.input.height,
        kernel: info.kernel.clone(),
        train_data_digest: info.data_digest.clone(),
        variant: variant_name(config).to_owned(),
        seed: config.seed,
        epoch: epochs_of(state).unwrap_or_default(),
        tool_version: info.tool_version.clone(),
        parity: 0.0,
        expected: Vec::new(),
    };
    let parity = export::discriminator::export(&network, &metadata, &opened.target);
    Ok(Exported {
        parity: Some(parity.map_err(|error| Error::Export(error.to_string()))?),
        path: opened.target,
        warnings: opened.warnings,
    })
}

/// What is exported.
#[derive(Clone, Copy, PartialEq, Eq)]
enum What {
    Model,
    Weights,
    Discriminator,
}

/// A run whose networks are loaded, with the file that may be written.
struct Opened {
    config: Config,
    info: RunInfo,
    state: State,
    trainer: Trainer,
    target: PathBuf,
    warnings: Vec<String>,
}

impl Opened {
    fn new(run: &Path, out: Option<&Path>, what: What, best: bool, force: bool) -> Result<Self> {
        let folder = RunFolder::new(run.to_path_buf());
        let config: Config = folder.config()?;
        let info = folder.info()?;
        let usual = run.join(what.usual_name());
        let target = out.map_or_else(|| usual.clone(), Path::to_path_buf);
        check_replaceable(&target, (run, &usual), what, (&config, &info), force)?;
        claim::remove_leftovers_beside(&target)?;
        let (newest, warnings) = folder.newest(&info)?;
        let checkpoint = newest.ok_or_else(|| Error::NoRun {
            folder: run.to_path_buf(),
            reason: "it has no usable checkpoint".to_owned(),
        })?;
        let checkpoint = match (best, &checkpoint.state.best) {
            (false, _) => checkpoint,
            (true, Some(best)) => {
                let best = folder.checkpoints.load(best.step)?;
                folder.check_own(&best, &info)?;
                best
            }
            (true, None) => {
                return Err(Error::NoRun {
                    folder: run.to_path_buf(),
                    reason: "no validation has named a best checkpoint".to_owned(),
                });
            }
        };
        let device = DeviceChoice::Cpu.open()?;
        let path = folder.checkpoints.path(checkpoint.state.step);
        let trainer = Trainer::from_checkpoint(&config, &device, &checkpoint, &path)?;
        Ok(Self {
            config,
            info,
            state: checkpoint.state,
            trainer,
            target,
            warnings,
        })
    }
}

impl What {
    /// Name of the file within the run folder that is replaced whenever the run is exported.
    fn usual_name(self) -> &'static str {
        match self {
            Self::Model | Self::Weights => MODEL,
            Self::Discriminator => DISCRIMINATOR,
        }
    }
}

/// Makes sure that an export replaces nothing but an export of the same run, or with `force` one of
/// another; never another file of a run.
fn check_replaceable(
    path: &Path,
    (run, usual): (&Path, &Path),
    what: What,
    made_with: (&Config, &RunInfo),
    force: bool,
) -> Result<()> {
    let refuse = |problem: &str| {
        Err(Error::Store(strat_store::Error::Output {
            path: path.to_path_buf(),
            problem: problem.to_owned(),
        }))
    };
    let (here, run) = (claim::resolve(path)?, claim::resolve(run)?);
    let usual = claim::resolve(usual)?;
    if here.is_dir() {
        return refuse("this is a folder; give a file");
    }
    let in_run = |folder: &&Path| RunFolder::new(folder.to_path_buf()).is_run();
    let of_run = here.ancestors().skip(1).find(in_run);
    if of_run.is_some_and(|folder| folder != run) {
        return refuse("this lies in the folder of another run; give another name");
    }
    if !here.exists() || here == usual && !is_foreign(&here) {
        return Ok(());
    }
    if is_foreign(&here) {
        return refuse(
            "this file was not written by `train export`; give another name or remove it",
        );
    }
    if of_run.is_some() || force || is_of_run(&here, what, made_with) {
        return Ok(());
    }
    refuse(
        "this is an export of another run or network; give another name, or replace it with --force",
    )
}

/// Whether a file is no export.
fn is_foreign(path: &Path) -> bool {
    if is_weights_file(path) {
        return initial_weights::drives_of_own(path).is_none();
    }
    let producer = strat_onnx::model::read(path).map(|model| model.info.producer);
    !producer.is_ok_and(|producer| producer.as_deref() == Some(strat_onnx::graph::PRODUCER))
}

/// Whether an export says of its training what this run was made with, as far as it says anything.
fn is_of_run(path: &Path, what: What, (config, info): (&Config, &RunInfo)) -> bool {
    if what == What::Weights {
        return initial_weights::drives_of_own(path) == Some(info.train_drives.clone());
    }
    let Ok(model) = strat_onnx::model::read(path) else {
        return false;
    };
    if what == What::Discriminator {
        return model.info.discriminator().is_ok_and(|found| {
            found.is_some_and(|found| {
                found.train_data_digest == info.data_digest
                    && found.variant == variant_name(config)
                    && found.seed == config.seed
                    && (found.image_width, found.image_height)
                        == (config.input.width, config.input.height)
            })
        });
    }
    let metadata = model.info.metadata().cloned();
    metadata.is_some_and(|metadata| {
        metadata.train_data_digest.as_ref() == Some(&info.data_digest)
            && metadata.train_drives == info.train_drives
            && metadata.variant.as_deref() == Some(variant_name(config))
            && metadata.seed == Some(config.seed)
            && (metadata.input_width, metadata.input_height)
                == (config.input.width, config.input.height)
    })
}

pub(super) fn export_model(
    generator: &Generator,
    config: &Config,
    info: &RunInfo,
    state: &State,
    weights: Weights,
    path: &Path,
) -> Result<f64> {
    let mut metadata = ModelMetadata::new(
        OutputMeaning::DisparityFraction,
        InputRange::Unit,
        config.input.width,
        config.input.height,
    );
    metadata.kernel = Some(info.kernel.clone());
    metadata.train_data_digest = Some(info.data_digest.clone());
    metadata.split = Some(config.split.to_string());
    metadata.train_drives = info.train_drives.clone();
    // Weights that began elsewhere have seen other images too.
    metadata.train_source = Some(info.source.clone()).filter(|_| info.initial_weights.is_none());
    metadata.unknown_start = info.initial_weights.clone().filter(|_| info.unknown_start);
    metadata.camera = info.camera;
    metadata.variant = Some(variant_name(config).to_owned());
    metadata.seed = Some(config.seed);
    metadata.epoch = epochs_of(state);
    metadata.tool_version = Some(info.tool_version.clone());
    metadata.weights = weights;
    export::export(generator, &metadata, path).map_err(|error| Error::Export(error.to_string()))
}

/// Epochs that were completed.
fn epochs_of(state: &State) -> Option<u32> {
    u32::try_from(state.step / state.steps_per_epoch.max(1)).ok()
}

/// What the model's metadata calls the method.
pub(super) fn variant_name(config: &Config) -> &'static str {
    match config.objective {
        Objective::Strat => config.variant.name(),
        Objective::Monodepth => "monodepth",
    }
}
