//! A training run from its prepared set to its exported model.
//!
//! The model is the network after the last step; the best checkpoint by validation is kept as well
//! (PROTOCOL 4.6, model selection: the last epoch). What the run folder holds is
//! said in [`super::folder`].
//!
//! A run that is stopped (an interrupt, or `max_steps`) leaves a checkpoint of its last step
//! and is continued with `--resume`, bit for bit as if it had not been stopped on the CPU
//! backend.

use std::time::Instant;

use burn::tensor::Device;
use strat_splits::Role;
use strat_store::command::eprint_line;
use strat_store::human;
use strat_store::set::PreparedSet;

use super::check::{Findings, Part, check};
use super::checkpoint::State;
use super::folder::{RunFolder, RunInfo};
use super::memory::{self, Need};
use super::model::variant_name;
use super::options::{Options, Outcome};
use super::schedule::Timeline;
use super::session::Session;
use super::trainer::Trainer;
use super::validation::Validation;
use crate::config::Config;
use crate::data::pairs::Pairs;
use crate::device::DeviceChoice;
use crate::error::{Error, Result};
use crate::network::initial_weights::InitialWeights;

/// The deep-learning library and the version that the workspace pins.
const FRAMEWORK: &str = "burn 0.22.1";

/// Trains, and exports the model unless the run was interrupted.
///
/// # Errors
/// Before any work for everything that can be known then; later with the sentence of what
/// happened, the last checkpoint being kept.
pub fn run(options: &Options) -> Result<Outcome> {
    let config = &options.config;
    let set = PreparedSet::open(&options.data)?;
    let folder = RunFolder::new(options.out.clone());
    folder.examine(options.resume, options.force)?;
    let _lock = folder.lock()?;
    // Another training may have ended here since.
    let existing = folder.examine(options.resume, options.force)?;
    if set.manifest.content != config.split {
        return Err(Error::WrongSplit {
            root: options.data.clone(),
            found: set.manifest.content.to_string(),
            wanted: config.split.to_string(),
        });
    }
    let [height, width] = [config.input.height, config.input.width];
    let pairs = Pairs::from_set(&set, Role::Train, width, height, config.cache_mib)?;
    let device = options.device.open()?;
    let replicas = options.replicas.iter().map(|choice| choice.open());
    let replicas = replicas.collect::<Result<Vec<_>>>()?;

    let mut config_digest = config.digest()?;
    let data_digest = set.manifest.data_digest.clone();
    let say = |text: &str| {
        if !options.quiet {
            eprint_line(text);
        }
    };
    let device_checks = check_devices(options, &say)?;
    let mut before = None;
    let mut resumed = None;
    if existing && options.resume {
        let info = folder.check_same(config, &config_digest, &data_digest)?;
        let (newest, warnings) = folder.newest(&info)?;
        warnings.iter().for_each(|warning| say(warning));
        // A run keeps its digest: its checkpoints bear it.
        config_digest.clone_from(&info.config_digest);
        resumed = newest;
        before = Some(info);
    }
    let (trainer, origin) = match (&resumed, before) {
        (Some(checkpoint), Some(before)) => {
            let path = folder.checkpoints.path(checkpoint.state.step);
            let trainer = Trainer::from_checkpoint(config, &device, checkpoint, &path)?;
            let origin = Origin {
                drives: before.train_drives,
                initial_weights: before.initial_weights,
                unknown_start: before.unknown_start,
            };
            (trainer, origin)
        }
        _ => begin(config, &pairs, &device, &say)?,
    };
    let trainer = trainer.with_replicas(&replicas);
    let (generator_parameters, discriminator_parameters) = trainer.parameters();
    let info = RunInfo {
        format: 1,
        tool_version: env!("CARGO_PKG_VERSION").to_owned(),
        framework: FRAMEWORK.to_owned(),
        device: options.device_names(),
        device_checks,
        config_digest: config_digest.clone(),
        data_digest: data_digest.clone(),
        split_digest: set.manifest.split_digest.clone(),
        source: set.manifest.source.clone(),
        kernel: set.manifest.kernel.to_string(),
        train_pairs: pairs.count(),
        train_drives: origin.drives,
        initial_weights: origin.initial_weights,
        unknown_start: origin.unknown_start,
        camera: pairs.camera(),
        generator_parameters,
        discriminator_parameters,
    };
    if options.device == DeviceChoice::Cpu && !options.ignore_memory {
        // The weights are there already.
        let free = memory::free() + 4.0 * (generator_parameters + discriminator_parameters) as f64;
        Need::predict(config, &trainer).check(config, free)?;
    }
    folder.prepare(config, &info, resumed.is_some())?;
    let validation = Validation::open(&set, config)?;
    for warning in validation
        .iter()
        .flat_map(|validation| &validation.warnings)
    {
        say(warning);
    }
    say(&introduction(config, &info, &pairs, validation.as_ref()));
    if let Some(checkpoint) = &resumed {
        say(&format!(
            "resuming after step {} of {}",
            checkpoint.state.step,
            folder.checkpoints.path(checkpoint.state.step).display()
        ));
    }

    let mut timeline = Timeline::new(config, pairs.count());
    let done = resumed.as_ref();
    let done = done.map_or(0, |checkpoint| checkpoint.state.step);
    // Whatever `max_steps` says now, steps that were taken are not taken back.
    timeline.end = timeline.end.max(done);
    let state = State::new(
        done,
        timeline.steps_per_epoch,
        config_digest,
        data_digest,
        resumed.and_then(|checkpoint| checkpoint.state.best),
    );
    let session = Session {
        options,
        folder: &folder,
        device,
        validation: validation.as_ref(),
        timeline,
        state,
    };
    // On a thread of those that share the work: from outside, every pass of every layer would wake one of them and
    // sleep until it has ended.
    rayon::scope(|_| session.train(trainer, pairs, &info))
}

/// Holds every device but the processor against it.
fn check_devices(options: &Options, say: &impl Fn(&str)) -> Result<Vec<Findings>> {
    let mut checked: Vec<Findings> = Vec::new();
    let others = options
        .devices()
        .filter(|device| *device != DeviceChoice::Cpu);
    for device in others.filter(|_| !options.no_check) {
        let started = Instant::now();
        let findings = check(&options.config, device, false)?;
        findings.verdict()?;
        let gradients = [Part::GeneratorGradients, Part::DiscriminatorGradients];
        let gradients = gradients
            .iter()
            .filter_map(|part| findings.largest(*part))
            .fold(0.0, |largest: f64, found| largest.max(found.value));
        say(&format!(
            "the device {device} computes what the cpu computes: gradients of a small network differ \
             by {gradients:.1e} at most ({})",
            human::duration(started.elapsed().as_secs_f64())
        ));
        checked.push(findings.summary());
    }
    Ok(checked)
}

/// Where the weights of a run come from.
struct Origin {
    drives: Vec<String>,
    initial_weights: Option<String>,
    unknown_start: bool,
}

/// Networks before their first step.
fn begin(
    config: &Config,
    pairs: &Pairs,
    device: &Device,
    say: &impl Fn(&str),
) -> Result<(Trainer, Origin)> {
    let initial = config.initial_weights.as_deref().map(InitialWeights::read);
    let initial = initial.transpose()?;
    let trainer = Trainer::new(config, initial.as_ref(), device);
    let mut drives = pairs.drives();
    if let Some(initial) = &initial {
        say(&initial.check(&trainer.all_parameters())?);
        match initial.drives() {
            Some(names) => drives.extend(names.iter().cloned()),
            None => say(
                "warning: the initial weights do not say what they were trained on; bench will not \
                 be able to check the model for leakage",
            ),
        }
        drives.sort();
        drives.dedup();
    }
    let origin = Origin {
        drives,
        initial_weights: initial.as_ref().map(|initial| initial.digest().to_owned()),
        unknown_start: initial.is_some_and(|initial| initial.drives().is_none()),
    };
    Ok((trainer, origin))
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
            format!("{} validation pairs with depth", validation.count())
        }
        Some(validation) => format!("{} validation pairs without depth", validation.count()),
    };
    format!(
        "{} on {} pairs of the {} split ({}), {validation}\n\
         generator {:.2} M parameters{adversary}, input {}x{}, batch {}{}, {} epochs, device {}",
        variant_name(config),
        pairs.count(),
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_framework_named_is_the_one_that_is_built() {
        let lock = concat!(env!("CARGO_MANIFEST_DIR"), "/../Cargo.lock");
        let lock = std::fs::read_to_string(lock).unwrap();
        let (name, version) = FRAMEWORK.split_once(' ').unwrap();
        let package = format!("name = \"{name}\"\nversion = \"{version}\"\n");
        assert!(lock.contains(&package), "{FRAMEWORK}");
    }
}
