//! How much memory a training step takes: predicted before the first step, measured on request.
//!
//! The prediction counts what the networks keep for their backward passes and what the optimizers
//! keep for each weight; the factors that turn these counts into bytes were fitted to measured
//! peaks of the CPU backend (`train estimate`). It is there to refuse a run that cannot fit before
//! it has taken the machine's memory, so it may be wrong by a quarter, not by a multiple.
//!
//! A measurement runs real steps on noise in a process of its own, whose peak the system reports.
//!
//! Not here: the memory of GPUs before a step, which burn does not tell; a measurement on a GPU
//! reports what its backend has reserved after the steps.

use std::iter::once;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::Instant;

use burn::tensor::Device;
use serde::{Deserialize, Serialize};
use strat_store::human;
use strat_store::set::PreparedSet;
use sysinfo::{MemoryRefreshKind, RefreshKind, System};

use crate::config::{Config, Preset, Sharing};
use crate::data::loader::Batch;
use crate::device::DeviceChoice;
use crate::error::{Error, Result};
use crate::network::discriminator::Discriminator;
use crate::network::generator::Generator;
use crate::network::layers::{Convolution, Ops, TransposedConvolution};
use crate::random::{Draws, Purpose};
use crate::training::awake::computing_on;
use crate::training::schedule::Timeline;
use crate::training::trainer::Trainer;
use crate::training::validation::Validation;

/// Bytes of the program itself with its threads and buffers.
const PROGRAM: f64 = 18e6;
/// Copies of every weight at the peak of a step: itself, two moments of Adam, the gradients, and what the
/// allocator keeps of those of the step before.
const COPIES: f64 = 4.6;
/// Bytes for each value that the generator computes; many are overwritten by the next operation.
const PER_VALUE: f64 = 1.4;
/// Bytes for each value that a discriminator computes.
const PER_DISCRIMINATED: f64 = 4.0;
/// Bytes for each value of the two images in the losses (pyramids, samples, structural terms), and
/// what the adversarial term adds to that.
const PER_PIXEL: [f64; 2] = [80.0, 10.0];

/// Predicted bytes of a training step, as a line in the number of pairs per batch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Need {
    /// What does not depend on the batch.
    pub fixed: f64,
    /// What every pair of a batch adds.
    pub per_pair: f64,
}

impl Need {
    /// The prediction for these networks on the CPU backend.
    #[must_use]
    pub fn predict(config: &Config, trainer: &Trainer) -> Self {
        let (generator, discriminators) = trainer.parameters();
        let [height, width] = config.input.size();
        let mut counter = Counter { values: 0 };
        Generator::run(&trainer.generator(), &mut counter, [3, height, width]);
        let views = match config.discriminator.sharing {
            Sharing::Shared => 2,
            Sharing::PerView => 1,
        };
        let discriminator = trainer.discriminator();
        let discriminated = discriminator.as_ref().map_or(0, |network| {
            views * discriminator_values(network, config.discriminator.patch)
        });
        let [stereo, adversarial] = PER_PIXEL;
        let per_pixel = stereo
            + if discriminator.is_some() {
                adversarial
            } else {
                0.0
            };
        Self {
            fixed: PROGRAM + 4.0 * COPIES * (generator + discriminators) as f64,
            per_pair: PER_VALUE * counter.values as f64
                + PER_DISCRIMINATED * discriminated as f64
                + per_pixel * (2 * 3 * height * width) as f64,
        }
    }

    /// The line through measured peaks (least squares); `None` for fewer than two batch sizes.
    #[must_use]
    pub fn through(measured: &[Measured]) -> Option<Self> {
        let count = measured.len() as f64;
        let mean = |value: fn(&Measured) -> f64| measured.iter().map(value).sum::<f64>() / count;
        let (batch, peak) = (mean(|m| m.batch as f64), mean(|m| m.peak_bytes));
        let sum = |value: &dyn Fn(&Measured) -> f64| measured.iter().map(value).sum::<f64>();
        let spread = sum(&|m| (m.batch as f64 - batch).powi(2));
        let per_pair = sum(&|m| (m.batch as f64 - batch) * (m.peak_bytes - peak)) / spread;
        (spread > 0.0 && per_pair > 0.0).then_some(Self {
            fixed: peak - per_pair * batch,
            per_pair,
        })
    }

    /// Bytes at the peak of a step.
    #[must_use]
    pub fn bytes(&self, batch: usize) -> f64 {
        self.fixed + self.per_pair * batch as f64
    }

    /// Largest batch whose step fits into so many bytes.
    #[must_use]
    pub fn largest_batch(&self, bytes: f64) -> usize {
        ((bytes - self.fixed) / self.per_pair).max(0.0) as usize
    }

    /// Refuses a batch that does not fit into the memory that is free.
    ///
    /// # Errors
    /// With what is needed, what is free, and the settings that fit.
    pub fn check(&self, config: &Config, free: f64) -> Result<()> {
        let needed = self.bytes(config.batch);
        if needed <= free {
            return Ok(());
        }
        let fits = self.largest_batch(free);
        let advice = if fits == 0 {
            "not even a batch of 1 fits: choose a smaller --preset or input".to_owned()
        } else {
            let accumulate = (config.batch * config.accumulate).div_ceil(fits);
            format!(
                "--set batch={fits} --set accumulate={accumulate} fits and averages as many pairs \
                 a step"
            )
        };
        Err(Error::Memory(format!(
            "a step of batch {} at {}x{} needs about {} of memory, but {} are free; {advice}. \
             `train estimate` measures it; --ignore-memory continues anyway",
            config.batch,
            config.input.width,
            config.input.height,
            human::bytes(needed as u64),
            human::bytes(free as u64),
        )))
    }
}

/// Values per sample that a discriminator computes for a patch: of every stage the convolution,
/// the normalisation, the activation and the dropout.
fn discriminator_values(network: &Discriminator, patch: usize) -> usize {
    let mut side = patch;
    let stages = network.stages.iter().map(|stage| {
        side /= 2;
        let [filters, ..] = stage.conv.weight.val().dims();
        4 * filters * side * side
    });
    stages.sum()
}

/// [`Ops`] that counts the values of every result.
struct Counter {
    values: usize,
}

impl Counter {
    fn made(&mut self, shape: [usize; 3]) -> [usize; 3] {
        self.values += shape.iter().product::<usize>();
        shape
    }
}

impl Ops for Counter {
    /// Channels, rows, columns.
    type Value = [usize; 3];

    fn conv(&mut self, _: &str, layer: &Convolution, [_, h, w]: [usize; 3]) -> [usize; 3] {
        let [outputs, ..] = layer.weight.val().dims();
        self.made([outputs, h.div_ceil(layer.stride), w.div_ceil(layer.stride)])
    }

    fn conv_transpose(
        &mut self,
        _: &str,
        layer: &TransposedConvolution,
        [_, h, w]: [usize; 3],
    ) -> [usize; 3] {
        let [_, outputs, ..] = layer.weight.val().dims();
        let stride = TransposedConvolution::STRIDE;
        self.made([outputs, stride * h, stride * w])
    }

    fn merge_elu(
        &mut self,
        name: &str,
        layer: &Convolution,
        inputs: Vec<[usize; 3]>,
    ) -> [usize; 3] {
        // The maps are read where they are, and not put together.
        let channels = inputs.iter().map(|[channels, ..]| channels).sum();
        let [_, height, width] = inputs.first().copied().unwrap_or_default();
        self.conv_elu(name, layer, [channels, height, width])
    }

    fn elu(&mut self, input: [usize; 3]) -> [usize; 3] {
        self.made(input)
    }

    fn relu(&mut self, input: [usize; 3]) -> [usize; 3] {
        self.made(input)
    }

    fn sigmoid(&mut self, input: [usize; 3]) -> [usize; 3] {
        self.made(input)
    }

    fn scale(&mut self, input: [usize; 3], _: f32) -> [usize; 3] {
        self.made(input)
    }

    fn add(&mut self, left: [usize; 3], _: [usize; 3]) -> [usize; 3] {
        self.made(left)
    }

    fn concat(&mut self, inputs: Vec<[usize; 3]>) -> [usize; 3] {
        let channels = inputs.iter().map(|[channels, ..]| channels).sum();
        let [_, height, width] = inputs.first().copied().unwrap_or_default();
        self.made([channels, height, width])
    }

    fn max_pool(&mut self, [channels, height, width]: [usize; 3]) -> [usize; 3] {
        self.made([channels, height / 2, width / 2])
    }

    fn upsample(&mut self, [channels, height, width]: [usize; 3]) -> [usize; 3] {
        self.made([channels, 2 * height, 2 * width])
    }
}

/// Bytes of memory that this process may still take: what the system calls available, or what its
/// control group leaves, whichever is less.
#[must_use]
pub fn free() -> f64 {
    let what = RefreshKind::nothing().with_memory(MemoryRefreshKind::nothing().with_ram());
    let system = System::new_with_specifics(what);
    let group = system
        .cgroup_limits()
        .map_or(u64::MAX, |limits| limits.free_memory);
    system.available_memory().min(group) as f64
}

/// What steps of one batch size took.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Measured {
    /// Pairs per batch.
    pub batch: usize,
    /// Peak memory of the process, or on a GPU the bytes its backend has reserved.
    pub peak_bytes: f64,
    /// Seconds of the fastest optimizer step but the first.
    pub step_seconds: f64,
    /// Seconds that the validation of a pair took; none where no set was given, or it has no such pairs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub validation_seconds: Option<f64>,
}

/// Takes optimizer steps on noise and reports what they took, and what it takes to validate pairs of a set
/// where one is given; meant to be the only work of its process.
///
/// # Errors
/// When the device does not answer, a step fails, the set cannot be read, or the system does not tell peaks.
pub fn measure(
    config: &Config,
    device: DeviceChoice,
    set: Option<&PreparedSet>,
) -> Result<Measured> {
    /// The first step lacks the moments of Adam.
    const STEPS: u64 = 3;
    let open = device.open()?;
    let mut trainer = Trainer::new(config, None, &open);
    let timeline = Timeline {
        steps_per_epoch: STEPS,
        epochs: config.epochs,
        end: STEPS,
    };
    let mut fastest = f64::INFINITY;
    for step in 0..STEPS {
        let batches = (0..config.accumulate as u64).map(|part| noise(config, step, part));
        let batches = batches.collect();
        let started = Instant::now();
        let take = || trainer.step(config, &timeline, step, batches);
        computing_on(once(device), take)?;
        if step > 0 {
            fastest = fastest.min(started.elapsed().as_secs_f64());
        }
    }
    // Of the steps alone.
    let peak_bytes = reserved(&open).map_or_else(peak_of_process, Ok)?;
    let validation_seconds = match set {
        Some(set) => {
            let validate = || validation_of_a_pair(set, config, &trainer, &open);
            computing_on(once(device), validate)?
        }
        None => None,
    };
    Ok(Measured {
        batch: config.batch,
        peak_bytes,
        step_seconds: fastest,
        validation_seconds,
    })
}

/// Seconds that the validation of a pair takes, from a few of them.
fn validation_of_a_pair(
    set: &PreparedSet,
    config: &Config,
    trainer: &Trainer,
    device: &Device,
) -> Result<Option<f64>> {
    if config.validation.every == 0 {
        return Ok(None);
    }
    // As many as a run scores at a time, twice, so that batches are full.
    let mut few = config.clone();
    few.validation.images = 2 * config.batch;
    let Some(validation) = Validation::open(set, &few)? else {
        return Ok(None);
    };
    let mut seconds = f64::INFINITY;
    for _ in 0..2 {
        let started = Instant::now();
        let scores = validation.score(&trainer.generator(), &few, device);
        // An untrained network may give maps that cannot be scored; the time is the same.
        drop(scores);
        seconds = seconds.min(started.elapsed().as_secs_f64());
    }
    Ok(Some(seconds / validation.count() as f64))
}

/// Where threads of rayon are counted.
const THREADS: &str = "RAYON_NUM_THREADS";

/// Divides the cores among `jobs` processes like this one, unless the environment says something else.
pub(crate) fn share_cores(command: &mut Command, jobs: usize) {
    if jobs > 1 && std::env::var_os(THREADS).is_none() {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        command.env(THREADS, (cores / jobs).max(1).to_string());
    }
}

/// [`measure`] in a process of its own, so that its peak is no other's: `train measure` with the
/// configuration `source`, the preset and the `key=value` settings.
///
/// # Errors
/// When the process cannot be started, or ends without a measurement.
pub fn measure_apart(
    source: &str,
    preset: Option<Preset>,
    settings: &[String],
    device: DeviceChoice,
) -> Result<Measured> {
    let mut command = measurement((source, preset), settings, device, None)?;
    read_measurement(command.output()?)
}

/// The same as often as `jobs` says, side by side as runs of a study are, and with the validation of pairs
/// of the set in the folder `set`: the mean.
///
/// # Errors
/// As [`measure_apart`].
pub fn measure_side_by_side(
    base: (&str, Option<Preset>),
    settings: &[String],
    device: DeviceChoice,
    set: &Path,
    jobs: usize,
) -> Result<Measured> {
    let mut children = Vec::new();
    for _ in 0..jobs {
        let mut command = measurement(base, settings, device, Some(set))?;
        share_cores(&mut command, jobs);
        children.push(command.stdout(Stdio::piped()).spawn()?);
    }
    // All of them are waited for, also where one has failed.
    let ended: Vec<_> = children
        .into_iter()
        .map(|child| read_measurement(child.wait_with_output()?))
        .collect();
    let measured = ended.into_iter().collect::<Result<Vec<_>>>()?;
    let count = measured.len().max(1) as f64;
    let mean = |value: fn(&Measured) -> f64| measured.iter().map(value).sum::<f64>() / count;
    let validated = measured.iter().all(|m| m.validation_seconds.is_some());
    Ok(Measured {
        batch: measured.first().map_or(0, |first| first.batch),
        peak_bytes: mean(|m| m.peak_bytes),
        step_seconds: mean(|m| m.step_seconds),
        validation_seconds: validated.then(|| mean(|m| m.validation_seconds.unwrap_or_default())),
    })
}

fn measurement(
    (source, preset): (&str, Option<Preset>),
    settings: &[String],
    device: DeviceChoice,
    set: Option<&Path>,
) -> Result<Command> {
    let mut command = Command::new(std::env::current_exe()?);
    command.args(["measure", "--config", source]);
    command.args(["--device", &device.to_string()]);
    if let Some(preset) = preset {
        command.args(["--preset", preset.name()]);
    }
    for setting in settings {
        command.args(["--set", setting]);
    }
    if let Some(set) = set {
        command.arg("--data").arg(set);
    }
    command.stderr(Stdio::inherit());
    Ok(command)
}

fn read_measurement(output: Output) -> Result<Measured> {
    if !output.status.success() {
        return Err(Error::Memory(format!(
            "the measurement of steps ended with {}; it may have run out of memory",
            output.status
        )));
    }
    serde_json::from_slice(&output.stdout)
        .map_err(|error| Error::Memory(format!("the measurement cannot be read: {error}")))
}

fn noise(config: &Config, step: u64, part: u64) -> Batch {
    let mut draws = Draws::new(config.seed, Purpose::Augmentation, step, part);
    let [height, width] = config.input.size();
    let size = 3 * height * width;
    let mut view = || (0..config.batch * size).map(|_| draws.unit()).collect();
    Batch {
        left: view(),
        right: view(),
        samples: config.batch,
        indices: vec![0; config.batch],
        warnings: Vec::new(),
    }
}

/// What a GPU's backend has reserved; pools of the backend keep what they once needed.
fn reserved(device: &Device) -> Option<f64> {
    let usage = device.memory_pool_usage()?;
    Some(usage.bytes_reserved as f64)
}

#[cfg(unix)]
fn peak_of_process() -> Result<f64> {
    use nix::sys::resource::{UsageWho, getrusage};
    let usage = getrusage(UsageWho::RUSAGE_SELF)
        .map_err(|error| Error::Memory(format!("the system does not tell peak memory: {error}")))?;
    // The only system that counts in bytes.
    let unit = if cfg!(target_vendor = "apple") {
        1.0
    } else {
        1024.0
    };
    Ok(usage.max_rss() as f64 * unit)
}

#[cfg(not(unix))]
fn peak_of_process() -> Result<f64> {
    Err(Error::Memory(
        "peak memory is measured on Unix systems only".to_owned(),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tiny(settings: &[&str]) -> (Config, Trainer) {
        let settings: Vec<String> = settings.iter().map(|s| (*s).to_owned()).collect();
        let config = Config::resolve("kitti-strat", Some(Preset::Tiny), &settings).unwrap();
        let trainer = Trainer::new(&config, None, &Device::flex());
        (config, trainer)
    }

    #[test]
    fn the_counter_sees_the_shapes_that_the_network_has() {
        let (config, trainer) = tiny(&["network.head=sigmoid"]);
        let mut counter = Counter { values: 0 };
        let levels = trainer.generator().run(&mut counter, [3, 64, 128]);
        assert_eq!(levels, [[2, 64, 128], [2, 32, 64], [2, 16, 32], [2, 8, 16]]);
        let given: usize = levels.iter().map(|l| l.iter().product::<usize>()).sum();
        assert!(counter.values > 10 * given, "{}", counter.values);
        let patch = config.discriminator.patch;
        assert_eq!(patch, 64);
        // Filters 4, 8, 16, 32, 32 on maps of 32, 16, 8, 4, 2.
        let expected = 4 * (4 * 1024 + 8 * 256 + 16 * 64 + 32 * 16 + 32 * 4);
        let network = trainer.discriminator().unwrap();
        assert_eq!(discriminator_values(&network, patch), expected);
    }

    #[test]
    fn more_pairs_and_a_discriminator_need_more() {
        let (config, trainer) = tiny(&[]);
        let with = Need::predict(&config, &trainer);
        assert!(with.bytes(8) > with.bytes(4));
        let (config, trainer) = tiny(&["variant=no-adv"]);
        let without = Need::predict(&config, &trainer);
        assert!(with.bytes(4) > without.bytes(4));
    }

    #[test]
    fn what_cannot_fit_is_refused_with_settings_that_fit() {
        let (config, _) = tiny(&["batch=8"]);
        let need = Need {
            fixed: 100e6,
            per_pair: 100e6,
        };
        assert_eq!(need.largest_batch(450e6), 3);
        assert!(need.check(&config, 900e6).is_ok());
        let text = need.check(&config, 450e6).unwrap_err().to_string();
        for part in ["900.0 MB", "450.0 MB", "batch=3", "accumulate=3", "128x64"] {
            assert!(text.contains(part), "{part}: {text}");
        }
        let text = need.check(&config, 150e6).unwrap_err().to_string();
        assert!(text.contains("not even"), "{text}");
    }

    #[test]
    fn the_line_goes_through_what_was_measured() {
        let at = |batch, peak_bytes| Measured {
            batch,
            peak_bytes,
            step_seconds: 1.0,
            validation_seconds: None,
        };
        let line = Need::through(&[at(1, 30.0), at(2, 40.0), at(4, 60.0)]).unwrap();
        assert!((line.fixed - 20.0).abs() < 1e-9 && (line.per_pair - 10.0).abs() < 1e-9);
        assert_eq!(Need::through(&[at(1, 30.0)]), None);
        assert_eq!(Need::through(&[at(1, 30.0), at(1, 31.0)]), None);
    }

    #[test]
    fn the_system_tells_how_much_is_free() {
        let bytes = free();
        assert!(bytes > 16e6, "{bytes}");
    }
}
