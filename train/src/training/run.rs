//! A training run from its prepared set to its exported model.
//!
//! The run folder holds the resolved configuration (`config.yaml`), what it was run with
//! (`run.json`), every loss term of every step (`scalars.csv`), validation scores
//! (`validation.csv`), `checkpoints/`, `pictures/`, `tensorboard/` and, at the end, `model.onnx`. The model
//! is the network after the last step; the best checkpoint by validation is kept as well
//! (PROTOCOL 4.6, model selection: the last epoch).
//!
//! A run that is stopped (an interrupt, or `max_steps`) leaves a checkpoint of its last step
//! and is continued with `--resume`, bit for bit as if it had not been stopped on the CPU
//! backend.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use burn::tensor::Device;
use serde::{Deserialize, Serialize};
use strat_onnx::metadata::{InputRange, ModelMetadata, OutputMeaning, Weights};
use strat_splits::Role;
use strat_store::files;
use strat_store::progress::Progress;
use strat_store::set::PreparedSet;

use crate::config::Config;
use crate::data::{BatchPlan, Loader, Pairs};
use crate::device::DeviceChoice;
use crate::error::{Error, Result};
use crate::network::generator::Generator;
use crate::network::initial_weights::{self, StartWeights};
use crate::training::checkpoint::{Best, Checkpoint, Checkpoints, State};
use crate::training::memory::{self, Need};
use crate::training::tensorboard::EventWriter;
use crate::training::trainer::{Networks, StepReport};
use crate::training::validation::{Scores, Validation};

const CONFIG: &str = "config.yaml";
const RUN: &str = "run.json";
const SCALARS: &str = "scalars.csv";
const VALIDATION: &str = "validation.csv";
const CHECKPOINTS: &str = "checkpoints";
const PICTURES: &str = "pictures";

/// Event files for TensorBoard.
const EVENTS: &str = "tensorboard";
/// Name of the exported model in the run folder.
pub const MODEL: &str = "model.onnx";

/// Steps in a row with a dead or constant disparity before it is said.
const COLLAPSE_STEPS: u32 = 50;

/// Mean disparity, as a fraction of the width, below which nothing is predicted any more: a
/// KITTI camera sees 80 m at 0.0039, so a whole street at a quarter of that is none.
const DEAD_DISPARITY: f64 = 0.001;

/// What is to be run.
#[derive(Clone, Debug)]
pub struct Options {
    /// The settings; already checked.
    pub config: Config,
    /// Folder of the prepared set.
    pub data: PathBuf,
    /// Run folder.
    pub out: PathBuf,
    /// Where the networks are.
    pub device: DeviceChoice,
    /// Further devices that share the batches of a step.
    pub helpers: Vec<DeviceChoice>,
    /// Continue the run in the folder.
    pub resume: bool,
    /// Replace the run in the folder.
    pub force: bool,
    /// Show no progress.
    pub quiet: bool,
    /// Begin although the memory is predicted not to suffice.
    pub ignore_memory: bool,
    /// Set to true to stop after the current step.
    pub stop: Arc<AtomicBool>,
}

impl Options {
    /// All devices, as `--device` names them.
    #[must_use]
    pub fn device_names(&self) -> String {
        let devices = std::iter::once(&self.device).chain(&self.helpers);
        let names: Vec<String> = devices.map(ToString::to_string).collect();
        names.join(",")
    }
}

/// How a run ended.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Optimizer steps done.
    pub steps: u64,
    /// Steps of the whole run as configured.
    pub planned: u64,
    /// Whether it was stopped from outside.
    pub interrupted: bool,
    /// The exported model, unless interrupted.
    pub model: Option<PathBuf>,
    /// Largest difference between the trained network and the exported model.
    pub parity: Option<f64>,
    /// Scores of the last validation.
    pub scores: Option<Scores>,
    /// The best validation score.
    pub best: Option<Best>,
    /// Training pairs that could not be read.
    pub broken_pairs: usize,
    /// Seconds of training, validation included.
    pub seconds: f64,
    /// Share of the time spent waiting for images.
    pub wait_share: f64,
}

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
    /// Drives that the training pairs come from, and those of the start weights.
    pub train_drives: Vec<String>,
    /// BLAKE3 of the start weights, if there were any.
    #[serde(default)]
    pub start_weights: Option<String>,
    /// Whether there were start weights that do not say what they were trained on.
    #[serde(default)]
    pub unknown_start: bool,
    /// Trained values of the generator.
    pub generator_parameters: usize,
    /// Trained values of the discriminator.
    pub discriminator_parameters: usize,
}

/// Trains, and exports the model unless the run was interrupted.
///
/// # Errors
/// Before any work for everything that can be known then; later with the sentence of what
/// happened, the last checkpoint being kept.
pub fn run(options: &Options) -> Result<Outcome> {
    let config = &options.config;
    let folder = Folder::new(options.out.clone());
    let existing = folder.examine(options)?;
    let set = PreparedSet::open(&options.data)?;
    if set.manifest.content != config.split {
        return Err(Error::WrongSplit {
            root: options.data.clone(),
            found: set.manifest.content.to_string(),
            wanted: config.split.to_string(),
        });
    }
    let pairs = Pairs::from_set(
        &set,
        Role::Train,
        config.input.width,
        config.input.height,
        config.cache_mib,
    )?;
    let device = options.device.open()?;
    let helpers = options.helpers.iter().map(|choice| choice.open());
    let helpers = helpers.collect::<Result<Vec<_>>>()?;

    let config_digest = config.digest()?;
    let data_digest = set.manifest.data_digest.clone();
    let talk = Talk {
        quiet: options.quiet,
    };
    let resumed = if existing && options.resume {
        folder.check_same(config, &config_digest, &data_digest)?;
        folder.newest(&talk)?
    } else {
        None
    };
    let (networks, origin) = match &resumed {
        Some(checkpoint) => {
            let path = folder.checkpoints.path(checkpoint.state.step);
            let networks = Networks::from_checkpoint(config, &device, checkpoint, &path)?;
            let before = folder.info()?;
            let origin = Origin {
                drives: before.train_drives,
                start_weights: before.start_weights,
                unknown_start: before.unknown_start,
            };
            (networks, origin)
        }
        None => begin(config, &pairs, &device, &talk)?,
    };
    let networks = networks.with_helpers(&helpers);
    let (generator_parameters, discriminator_parameters) = networks.parameters();
    let info = RunInfo {
        format: 1,
        tool_version: env!("CARGO_PKG_VERSION").to_owned(),
        framework: "burn 0.22.1".to_owned(),
        device: options.device_names(),
        config_digest: config_digest.clone(),
        data_digest: data_digest.clone(),
        split_digest: set.manifest.split_digest.clone(),
        source: set.manifest.source.clone(),
        kernel: set.manifest.kernel.to_string(),
        train_pairs: pairs.len(),
        train_drives: origin.drives,
        start_weights: origin.start_weights,
        unknown_start: origin.unknown_start,
        generator_parameters,
        discriminator_parameters,
    };
    if options.device == DeviceChoice::Cpu && !options.ignore_memory {
        // The weights are there already.
        let free = memory::free() + 4.0 * (generator_parameters + discriminator_parameters) as f64;
        Need::predict(config, &networks).check(config, free)?;
    }
    folder.prepare(config, &info, resumed.is_some())?;
    let validation = Validation::open(&set, config)?;
    if let Some(validation) = &validation {
        for warning in &validation.warnings {
            talk.say(warning);
        }
    }
    talk.say(&introduction(config, &info, &pairs, validation.as_ref()));
    if let Some(checkpoint) = &resumed {
        talk.say(&format!(
            "resuming after step {} of {}",
            checkpoint.state.step,
            folder.checkpoints.path(checkpoint.state.step).display()
        ));
    }

    let steps_per_epoch = BatchPlan::steps_per_epoch(pairs.len(), config.batch, config.accumulate);
    let session = Session {
        options,
        folder: &folder,
        device,
        validation: validation.as_ref(),
        state: State::new(
            resumed
                .as_ref()
                .map_or(0, |checkpoint| checkpoint.state.step),
            steps_per_epoch,
            config_digest,
            data_digest,
            resumed.and_then(|checkpoint| checkpoint.state.best),
        ),
    };
    session.train(networks, pairs, &info)
}

/// Where the weights of a run come from.
struct Origin {
    drives: Vec<String>,
    start_weights: Option<String>,
    unknown_start: bool,
}

/// Networks before their first step.
fn begin(
    config: &Config,
    pairs: &Pairs,
    device: &Device,
    talk: &Talk,
) -> Result<(Networks, Origin)> {
    let start = config.start_weights.as_deref().map(StartWeights::read);
    let start = start.transpose()?;
    let networks = Networks::new(config, start.as_ref(), device);
    let mut drives = pairs.drives();
    if let Some(start) = &start {
        talk.say(&start.check(&networks.all_parameters())?);
        match start.drives() {
            Some(names) => drives.extend(names.iter().cloned()),
            None => talk.say(
                "warning: the start weights do not say what they were trained on; bench will not \
                 be able to check the model for leakage",
            ),
        }
        drives.sort();
        drives.dedup();
    }
    let origin = Origin {
        drives,
        start_weights: start.as_ref().map(|start| start.digest().to_owned()),
        unknown_start: start.is_some_and(|start| start.drives().is_none()),
    };
    Ok((networks, origin))
}

/// Whether [`export_run`] writes weights instead of a model to this file.
#[must_use]
pub fn is_weights_file(path: &Path) -> bool {
    path.extension()
        .is_some_and(|ending| ending == "safetensors")
}

/// What [`export_run`] has written.
#[derive(Clone, Debug, PartialEq)]
pub struct Exported {
    /// The file.
    pub path: PathBuf,
    /// Largest difference between the trained network and the file, in fractions of the image
    /// width; none for weights, which are written as they are.
    pub parity: Option<f64>,
}

/// Writes the model of a finished or interrupted run from its newest (or best) checkpoint: ONNX, or
/// the weights of all its networks where `out` ends in `.safetensors`.
///
/// # Errors
/// When the folder holds no run, no usable checkpoint, or the model cannot be written.
pub fn export_run(
    run: &Path,
    out: Option<&Path>,
    best: bool,
    weights: Weights,
) -> Result<Exported> {
    let folder = Folder::new(run.to_path_buf());
    let config: Config = folder.config()?;
    let info = folder.info()?;
    let talk = Talk { quiet: false };
    let checkpoint = folder.newest(&talk)?.ok_or_else(|| Error::NoRun {
        folder: run.to_path_buf(),
        reason: "it has no usable checkpoint".to_owned(),
    })?;
    let checkpoint = match (best, &checkpoint.state.best) {
        (false, _) => checkpoint,
        (true, Some(best)) => folder.checkpoints.load(best.step)?,
        (true, None) => {
            return Err(Error::NoRun {
                folder: run.to_path_buf(),
                reason: "no validation has named a best checkpoint".to_owned(),
            });
        }
    };
    let device = DeviceChoice::Cpu.open()?;
    let place = folder.checkpoints.path(checkpoint.state.step);
    let networks = Networks::from_checkpoint(&config, &device, &checkpoint, &place)?;
    let path = out.map_or_else(|| run.join(MODEL), Path::to_path_buf);
    if is_weights_file(&path) {
        // Without the list of drives the file says that its training is unknown, as it is.
        let drives = (!info.unknown_start).then_some(info.train_drives.as_slice());
        initial_weights::write(&networks.all_parameters(), drives, &path)?;
        return Ok(Exported { path, parity: None });
    }
    let state = &checkpoint.state;
    let generator = networks.generator();
    let parity = export_model(&generator, &config, &info, state, weights, &path)?;
    Ok(Exported {
        path,
        parity: Some(parity),
    })
}

fn export_model(
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
    metadata.unknown_start = info.start_weights.clone().filter(|_| info.unknown_start);
    metadata.variant = Some(variant_name(config).to_owned());
    metadata.seed = Some(config.seed);
    metadata.epoch = u32::try_from(state.step / state.steps_per_epoch.max(1)).ok();
    metadata.tool_version = Some(info.tool_version.clone());
    metadata.weights = weights;
    crate::export::export(generator, &metadata, path)
        .map_err(|error| Error::Export(error.to_string()))
}

/// What the model's metadata calls the method.
fn variant_name(config: &Config) -> &'static str {
    match config.objective {
        crate::config::Objective::Strat => config.variant.name(),
        crate::config::Objective::Monodepth => "monodepth",
    }
}

/// Messages to the person at the terminal that are no progress bar.
struct Talk {
    quiet: bool,
}

impl Talk {
    fn say(&self, text: &str) {
        if !self.quiet {
            eprintln!("{text}");
        }
    }
}

fn introduction(
    config: &Config,
    info: &RunInfo,
    pairs: &Pairs,
    validation: Option<&Validation>,
) -> String {
    let million = |count: usize| count as f64 / 1e6;
    let adversary = if info.discriminator_parameters > 0 {
        format!(
            ", discriminator {:.2} M",
            million(info.discriminator_parameters)
        )
    } else {
        String::new()
    };
    let validation = match validation {
        None => "no validation pairs".to_owned(),
        Some(validation) if validation.has_depth() => {
            format!("{} validation pairs with depth", validation.len())
        }
        Some(validation) => format!("{} validation pairs without depth", validation.len()),
    };
    format!(
        "{} on {} pairs of the {} split ({}), {validation}\n\
         generator {:.2} M parameters{adversary}, input {}x{}, batch {}{}, {} epochs, device {}",
        variant_name(config),
        pairs.len(),
        config.split,
        info.source,
        million(info.generator_parameters),
        config.input.width,
        config.input.height,
        config.batch,
        if config.accumulate > 1 {
            format!(" x {}", config.accumulate)
        } else {
            String::new()
        },
        config.epochs,
        info.device,
    )
}

/// The run folder.
struct Folder {
    root: PathBuf,
    checkpoints: Checkpoints,
}

impl Folder {
    fn new(root: PathBuf) -> Self {
        let checkpoints = Checkpoints::new(root.join(CHECKPOINTS));
        Self { root, checkpoints }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.root.join(name)
    }

    /// Looks at the output folder before any work. True when it holds a run.
    fn examine(&self, options: &Options) -> Result<bool> {
        let is_run = self.path(RUN).exists() && self.path(CONFIG).exists();
        if is_run && !options.resume && !options.force {
            return Err(Error::RunExists(self.root.clone()));
        }
        if !is_run && options.resume {
            return Err(Error::NoRun {
                folder: self.root.clone(),
                reason: format!("there is no {RUN}, so nothing can be resumed"),
            });
        }
        if !is_run && self.root.exists() {
            // What a run leaves that was killed while it began is no reason to refuse.
            let begun = |name: &str| name == CONFIG || name.starts_with(files::UNFINISHED_PREFIX);
            for entry in fs_err::read_dir(&self.root)? {
                if !begun(&entry?.file_name().to_string_lossy()) {
                    return Err(Error::NotARun(self.root.clone()));
                }
            }
        }
        // Find out now, not after hours, whether the folder can be written.
        files::check_writable(&self.root)?;
        Ok(is_run)
    }

    fn config(&self) -> Result<Config> {
        let path = self.path(CONFIG);
        if !path.exists() {
            return Err(Error::NoRun {
                folder: self.root.clone(),
                reason: format!("there is no {CONFIG}"),
            });
        }
        Ok(strat_store::yaml::load(&path)?)
    }

    fn info(&self) -> Result<RunInfo> {
        let bytes = fs_err::read(self.path(RUN))?;
        serde_json::from_slice(&bytes).map_err(|error| Error::NoRun {
            folder: self.root.clone(),
            reason: format!("{RUN} is damaged: {error}"),
        })
    }

    /// Refuses to resume with settings or data that would give other weights.
    fn check_same(&self, config: &Config, config_digest: &str, data_digest: &str) -> Result<()> {
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
            let (before, now) = (own.to_yaml()?, config.to_yaml()?);
            let changed: Vec<String> = before
                .lines()
                .zip(now.lines())
                .filter(|(before, now)| before != now)
                .map(|(before, now)| format!("`{}` is now `{}`", before.trim(), now.trim()))
                .collect();
            return refuse(format!("its settings differ: {}", changed.join("; ")));
        }
        Ok(())
    }

    fn newest(&self, talk: &Talk) -> Result<Option<Checkpoint>> {
        let (checkpoint, warnings) = self.checkpoints.load_newest()?;
        for warning in warnings {
            talk.say(&warning);
        }
        Ok(checkpoint)
    }

    /// Writes what is known at the start; a new run first removes what an old one left.
    fn prepare(&self, config: &Config, info: &RunInfo, resumed: bool) -> Result<()> {
        if !resumed {
            for name in [SCALARS, VALIDATION, MODEL] {
                let path = self.path(name);
                if path.exists() {
                    fs_err::remove_file(path)?;
                }
            }
            for name in [CHECKPOINTS, PICTURES, EVENTS] {
                let path = self.path(name);
                if path.exists() {
                    fs_err::remove_dir_all(path)?;
                }
            }
        }
        files::write_atomic(&self.path(CONFIG), config.to_yaml()?.as_bytes())?;
        let mut text =
            serde_json::to_string_pretty(info).map_err(|error| Error::Config(error.to_string()))?;
        text.push('\n');
        files::write_atomic(&self.path(RUN), text.as_bytes())?;
        Ok(())
    }

    /// Opens a table for appending after those of its lines whose step is to be kept.
    ///
    /// Lines of later steps were written after the checkpoint that is resumed from.
    fn table(&self, name: &str, header: &str, keep: impl Fn(u64) -> bool) -> Result<Table> {
        let path = self.path(name);
        let mut kept = String::from(header);
        kept.push('\n');
        if path.exists() {
            for line in fs_err::read_to_string(&path)?.lines().skip(1) {
                let number = line.split(',').next().and_then(|cell| cell.parse().ok());
                if number.is_some_and(&keep) {
                    kept.push_str(line);
                    kept.push('\n');
                }
            }
        }
        files::write_atomic(&path, kept.as_bytes())?;
        let file = fs_err::OpenOptions::new().append(true).open(&path)?;
        Ok(Table {
            file: file.into_parts().0,
        })
    }
}

/// A CSV file that grows by a line at a time.
struct Table {
    file: File,
}

impl Table {
    fn line(&mut self, cells: &[String]) -> Result<()> {
        use std::io::Write;
        let mut line = cells.join(",");
        line.push('\n');
        Ok(self.file.write_all(line.as_bytes())?)
    }
}

const SCALARS_HEADER: &str = "step,epoch,learning_rate,baseline_fraction,total,stereo,ssim_left,\
ssim_right,l1_left,l1_right,left_right_left,left_right_right,smoothness_left,smoothness_right,\
adversarial,discriminator,disparity_mean,disparity_spread";

fn scalars(report: &StepReport) -> Vec<String> {
    let terms = &report.terms;
    let mut cells = vec![
        report.step.to_string(),
        (report.position as u64).to_string(),
    ];
    cells.extend(
        [
            report.learning_rate,
            report.baseline,
            report.total,
            terms.total,
            terms.ssim_left,
            terms.ssim_right,
            terms.l1_left,
            terms.l1_right,
            terms.left_right_left,
            terms.left_right_right,
            terms.smoothness_left,
            terms.smoothness_right,
            report.adversarial,
            report.discriminator,
            report.disparity_mean,
            report.disparity_spread,
        ]
        .map(|value| value.to_string()),
    );
    cells
}

/// The numbers of a table's line with the names of their columns; a line without depth has gaps.
fn tagged<'a>(
    header: &'static str,
    cells: &'a [String],
) -> impl Iterator<Item = (&'static str, f64)> + 'a {
    let named = header.split(',').zip(cells).skip(1);
    named.filter_map(|(name, cell)| Some((name, cell.parse().ok()?)))
}

const VALIDATION_HEADER: &str =
    "step,epoch,images,photometric,depth_images,abs_rel,sq_rel,rmse,rmse_log,a1,a2,a3";

/// `step` is the last step done, so that a resumed run keeps or repeats the line with it.
fn validation_line(step: u64, epoch: u64, scores: &Scores) -> Vec<String> {
    let mut cells = vec![
        step.to_string(),
        epoch.to_string(),
        scores.images.to_string(),
        scores.photometric.to_string(),
        scores.depth_images.to_string(),
    ];
    cells.extend(match scores.depth {
        Some(metrics) => metrics.to_array().map(|value| value.to_string()),
        None => std::array::from_fn(|_| String::new()),
    });
    cells
}

/// Watches the disparity for the two ways it can die.
#[derive(Default)]
struct Collapse {
    dead: u32,
    constant: u32,
    said: bool,
}

impl Collapse {
    /// A sentence, once, when the disparity has been dead or constant for a while.
    fn watch(&mut self, report: &StepReport) -> Option<String> {
        let count = |counter: &mut u32, condition: bool| {
            *counter = if condition { *counter + 1 } else { 0 };
            *counter >= COLLAPSE_STEPS
        };
        let dead = count(&mut self.dead, report.disparity_mean < DEAD_DISPARITY);
        let constant = count(
            &mut self.constant,
            report.disparity_spread < 0.01 * report.disparity_mean,
        );
        if self.said || !(dead || constant) {
            return None;
        }
        self.said = true;
        Some(if dead {
            format!(
                "warning: the predicted disparity has been next to zero for {COLLAPSE_STEPS} steps: \
                 the relu head is dying and will hardly recover. Start again with a smaller \
                 learning_rate, another seed (--set seed=2) or --set network.head=sigmoid"
            )
        } else {
            format!(
                "warning: the predicted disparity has been constant over the image for \
                 {COLLAPSE_STEPS} steps; if it stays so, start again with a smaller \
                 learning_rate or more data"
            )
        })
    }
}

/// Running means of an epoch, for its line.
#[derive(Default)]
struct EpochMeans {
    steps: f64,
    total: f64,
    ssim: f64,
    l1: f64,
    left_right: f64,
    adversarial: f64,
    discriminator: f64,
    disparity: f64,
}

impl EpochMeans {
    fn add(&mut self, report: &StepReport) {
        let terms = &report.terms;
        self.steps += 1.0;
        self.total += report.total;
        self.ssim += terms.ssim_left + terms.ssim_right;
        self.l1 += terms.l1_left + terms.l1_right;
        self.left_right += terms.left_right_left + terms.left_right_right;
        self.adversarial += report.adversarial;
        self.discriminator += report.discriminator;
        self.disparity += report.disparity_mean;
    }

    fn sentence(&self, adversarial: bool) -> String {
        let mean = |sum: f64| sum / self.steps.max(1.0);
        let adversary = if adversarial {
            format!(
                ", adversarial {:.3}, discriminator {:.3}",
                mean(self.adversarial),
                mean(self.discriminator)
            )
        } else {
            String::new()
        };
        format!(
            "loss {:.4} (ssim {:.4}, l1 {:.4}, left-right {:.4}{adversary}), disparity {:.4}",
            mean(self.total),
            mean(self.ssim),
            mean(self.l1),
            mean(self.left_right),
            mean(self.disparity),
        )
    }
}

/// Everything that stays the same while a run goes on, and its state.
struct Session<'a> {
    options: &'a Options,
    folder: &'a Folder,
    device: Device,
    validation: Option<&'a Validation>,
    state: State,
}

impl Session<'_> {
    fn train(mut self, mut networks: Networks, pairs: Pairs, info: &RunInfo) -> Result<Outcome> {
        let config = &self.options.config;
        let weights = config.loss_weights();
        let steps_per_epoch = self.state.steps_per_epoch;
        let planned = config.epochs * steps_per_epoch;
        let end = config.max_steps.map_or(planned, |limit| limit.min(planned));
        let first = self.state.step.min(end);
        let per_step = (config.batch * config.accumulate) as u64;
        let plan = BatchPlan {
            seed: config.seed,
            augment: Some(config.augment.clone()),
            batch: config.batch,
            accumulate: config.accumulate,
            steps_per_epoch,
            workers: config.workers,
        };
        let mut scalars_table = self
            .folder
            .table(SCALARS, SCALARS_HEADER, |step| step < first)?;
        // A run that was stopped within an epoch was validated there; going on, it was not.
        let mut validation_table = self.folder.table(VALIDATION, VALIDATION_HEADER, |step| {
            step < first && (step + 1).is_multiple_of(steps_per_epoch)
        })?;
        let mut events = EventWriter::create(&self.folder.path(EVENTS), first)?;
        let mut loader = Loader::start(pairs.clone(), plan, first, end)?;
        let progress = Progress::new(
            "training",
            (end - first) * per_step,
            "images",
            self.options.quiet,
        );
        let started = Instant::now();
        let mut collapse = Collapse::default();
        let mut means = EpochMeans::default();
        let mut scores = None;
        let mut interrupted = false;
        let mut saved = first;

        for step in first..end {
            let batches = loader.next_step()?;
            for warning in batches.iter().flat_map(|batch| &batch.warnings) {
                progress.println(warning);
            }
            let report = networks.step(config, &weights, batches, step, steps_per_epoch)?;
            let cells = scalars(&report);
            scalars_table.line(&cells)?;
            events.scalars(step, tagged(SCALARS_HEADER, &cells))?;
            means.add(&report);
            if let Some(sentence) = collapse.watch(&report) {
                progress.println(&sentence);
            }
            let done = step + 1;
            self.state.step = done;
            let epoch = done.div_ceil(steps_per_epoch);
            progress.note(&format!(
                "epoch {epoch}/{}, loss {:.4}",
                config.epochs, report.total
            ));
            progress.add(per_step);

            let epoch_ends = done % steps_per_epoch == 0;
            if epoch_ends || done == end {
                let last = done == end;
                let due = |every: u64| every > 0 && (last || epoch.is_multiple_of(every));
                let mut line = format!(
                    "epoch {epoch}/{}: {}",
                    config.epochs,
                    means.sentence(config.variant.is_adversarial())
                );
                means = EpochMeans::default();
                let mut improved = false;
                if let Some(validation) = self.validation {
                    let generator = networks.generator();
                    if due(config.validation.every) {
                        let new = validation.score(&generator, config, &self.device)?;
                        let cells = validation_line(step, epoch, &new);
                        validation_table.line(&cells)?;
                        events.scalars(step, tagged(VALIDATION_HEADER, &cells))?;
                        let (name, value) = new.deciding();
                        line.push_str(&format!("; validation {name} {value:.4}"));
                        improved = self.note_score(name, value, epoch);
                        scores = Some(new);
                    }
                    if due(config.pictures.every) {
                        let folder = self.folder.path(PICTURES);
                        let discriminator = networks.discriminator();
                        for shown in validation.pictures(
                            &generator,
                            discriminator.as_ref(),
                            report.baseline,
                            config,
                            &self.device,
                        ) {
                            shown.write(&folder, epoch)?;
                            for (what, picture) in [
                                ("left", Some(&shown.left)),
                                ("disparity", Some(&shown.disparity)),
                                ("right at b", Some(&shown.synthesised)),
                                ("discriminator, real and made", shown.judged.as_ref()),
                            ] {
                                if let Some(picture) = picture {
                                    let tag = format!("{}/{what}", shown.id);
                                    events.picture(step, &tag, picture)?;
                                }
                            }
                        }
                    }
                }
                // The bar's own lines are shown even when quiet; this one is no warning.
                if !self.options.quiet {
                    progress.println(&line);
                }
                if improved || due(config.checkpoint.every) {
                    self.save(&networks)?;
                    saved = done;
                }
            }
            if self.options.stop.load(Ordering::Relaxed) && done < end {
                interrupted = true;
                break;
            }
        }
        progress.finish();
        if saved != self.state.step {
            self.save(&networks)?;
        }
        let wait_share = loader.wait_share();
        drop(loader);
        let seconds = started.elapsed().as_secs_f64();

        let (model, parity) = if interrupted {
            (None, None)
        } else {
            let path = self.folder.path(MODEL);
            let generator = networks.generator();
            let parity = export_model(&generator, config, info, &self.state, Weights::F32, &path)?;
            (Some(path), Some(parity))
        };
        Ok(Outcome {
            steps: self.state.step,
            planned,
            interrupted,
            model,
            parity,
            scores,
            best: self.state.best,
            broken_pairs: pairs.broken(),
            seconds,
            wait_share,
        })
    }

    /// Remembers a score that is better than all before; true when it is.
    fn note_score(&mut self, name: &str, value: f64, epoch: u64) -> bool {
        let better = self
            .state
            .best
            .as_ref()
            .is_none_or(|best| best.score != name || value < best.value);
        if better {
            self.state.best = Some(Best {
                step: self.state.step,
                epoch,
                score: name.to_owned(),
                value,
            });
        }
        better
    }

    fn save(&self, networks: &Networks) -> Result<()> {
        self.folder.checkpoints.save(&Checkpoint {
            state: self.state.clone(),
            parts: networks.to_parts()?,
        })?;
        self.folder.checkpoints.prune(
            self.options.config.checkpoint.keep,
            self.state.best.as_ref().map(|best| best.step),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_dead_or_constant_disparity_is_said_once() {
        let report = |mean: f64, spread: f64| StepReport {
            disparity_mean: mean,
            disparity_spread: spread,
            ..StepReport::default()
        };
        let sentences = |mean, spread| -> Vec<String> {
            let mut collapse = Collapse::default();
            (0..100)
                .filter_map(|_| collapse.watch(&report(mean, spread)))
                .collect()
        };
        assert_eq!(sentences(0.03, 0.01).len(), 0);
        let dead = sentences(0.0, 0.0);
        assert!(dead.len() == 1 && dead[0].contains("dying"), "{dead:?}");
        let constant = sentences(0.03, 1e-6);
        assert!(constant.len() == 1 && constant[0].contains("constant"));
        // A few bad steps among good ones are no collapse.
        let mut collapse = Collapse::default();
        for step in 0..200 {
            let mean = if step % 20 == 0 { 0.03 } else { 0.0 };
            assert!(collapse.watch(&report(mean, 0.01)).is_none());
        }
    }

    #[test]
    fn a_table_keeps_the_lines_before_the_resumed_step() {
        let temporary = tempfile::tempdir().unwrap();
        let folder = Folder::new(temporary.path().to_path_buf());
        let mut table = folder.table("t.csv", "step,x", |_| true).unwrap();
        for step in 0..5 {
            table.line(&[step.to_string(), "a".into()]).unwrap();
        }
        let mut table = folder.table("t.csv", "step,x", |step| step < 2).unwrap();
        table.line(&["2".into(), "b".into()]).unwrap();
        assert_eq!(
            std::fs::read_to_string(temporary.path().join("t.csv")).unwrap(),
            "step,x\n0,a\n1,a\n2,b\n"
        );
    }
}
