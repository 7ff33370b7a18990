//! The model of a run: what its file says of it, and its export from a checkpoint.

use std::path::{Path, PathBuf};

use strat_onnx::metadata::{InputRange, ModelMetadata, OutputMeaning, Weights};
use strat_store::claim;

use super::checkpoint::State;
use super::folder::{MODEL, RunFolder, RunInfo};
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
    /// width; none for weights, which are written as they are.
    pub parity: Option<f64>,
    /// Sentences about checkpoints that could not be used.
    pub warnings: Vec<String>,
}

/// Writes the model of a finished or interrupted run from its newest (or best) checkpoint: ONNX, or
/// the weights of all its networks where `out` ends in `.safetensors`. An export of another run is
/// replaced with `force` only.
///
/// # Errors
/// When `out` is another file than an export, the folder holds no run, no usable checkpoint, or the model cannot be written.
pub fn export_run(
    run: &Path,
    out: Option<&Path>,
    best: bool,
    weights: Weights,
    force: bool,
) -> Result<Exported> {
    let folder = RunFolder::new(run.to_path_buf());
    let config: Config = folder.config()?;
    let info = folder.info()?;
    let target = out.map_or_else(|| run.join(MODEL), Path::to_path_buf);
    check_replaceable(&target, run, (&config, &info), force)?;
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
    if is_weights_file(&target) {
        // Without the list of drives the file says that its training is unknown, as it is.
        let drives = (!info.unknown_start).then_some(info.train_drives.as_slice());
        initial_weights::write(&trainer.all_parameters(), drives, &target)?;
        return Ok(Exported {
            path: target,
            parity: None,
            warnings,
        });
    }
    let state = &checkpoint.state;
    let generator = trainer.generator();
    let parity = export_model(&generator, &config, &info, state, weights, &target)?;
    Ok(Exported {
        path: target,
        parity: Some(parity),
        warnings,
    })
}

/// Makes sure that an export replaces nothing but an export of the same run, or with `force` one of
/// another; never another file of a run.
fn check_replaceable(
    path: &Path,
    run: &Path,
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
    if here.is_dir() {
        return refuse("this is a folder; give a file");
    }
    let in_run = |folder: &&Path| RunFolder::new(folder.to_path_buf()).is_run();
    let of_run = here.ancestors().skip(1).find(in_run);
    if of_run.is_some_and(|folder| folder != run) {
        return refuse("this lies in the folder of another run; give another name");
    }
    if !here.exists() || here == run.join(MODEL) && !is_foreign(&here) {
        return Ok(());
    }
    if is_foreign(&here) {
        return refuse(
            "this file was not written by `train export`; give another name or remove it",
        );
    }
    if of_run.is_some() || force || is_of_run(&here, made_with) {
        return Ok(());
    }
    refuse("this is an export of another run; give another name, or replace it with --force")
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
fn is_of_run(path: &Path, (config, info): (&Config, &RunInfo)) -> bool {
    if is_weights_file(path) {
        return initial_weights::drives_of_own(path) == Some(info.train_drives.clone());
    }
    let model = strat_onnx::model::read(path);
    let metadata = model.ok().and_then(|model| model.info.metadata().cloned());
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
    metadata.epoch = u32::try_from(state.step / state.steps_per_epoch.max(1)).ok();
    metadata.tool_version = Some(info.tool_version.clone());
    metadata.weights = weights;
    export::export(generator, &metadata, path).map_err(|error| Error::Export(error.to_string()))
}

/// What the model's metadata calls the method.
pub(super) fn variant_name(config: &Config) -> &'static str {
    match config.objective {
        Objective::Strat => config.variant.name(),
        Objective::Monodepth => "monodepth",
    }
}
