//! One optimizer step of both networks, and what is carried from step to step.
//!
//! Source: PROTOCOL 4.4 to 4.6 and D14. For each batch the generator runs forward once; the
//! discriminator takes its step on detached synthesised views; the generator takes its step
//! through the discriminator, which is held still. With gradient accumulation the gradients
//! of several batches are averaged first, both networks then step at the end, and the
//! generator's adversarial term is judged by the discriminator as it was before the step.
//!
//! Every forward pass here is followed by a backward pass: burn keeps the memory of one that
//! is not. Evaluation belongs on `valid()` networks (see [`crate::training::validation`]).

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::path::Path;

use burn::module::Module;
use burn::optim::{
    AdamConfig, GradientsAccumulator, GradientsParams, ModuleOptimizer, OptimizerRecord,
};
use burn::store::{ModuleRecord, RecordError};
use burn::tensor::{Bytes, Device, Tensor, TensorData};

use crate::config::{Config, Judges};
use crate::data::Batch;
use crate::error::{Error, Result};
use crate::loss::{
    TermValues, Weights, discriminator_adversarial, generator_adversarial, scalar, stereo_losses,
    synthesize,
};
use crate::network::discriminator::{
    ColourFactors, Discriminator, NETWORK, Patches, RIGHT_NETWORK,
};
use crate::network::generator::Generator;
use crate::network::initial_weights::{Parameter, StartWeights};
use crate::random::{Draws, Purpose};
use crate::training::checkpoint::Checkpoint;
use crate::training::schedule::{baseline_fraction, learning_rate};

const GENERATOR: &str = "generator.bpk";
const GENERATOR_OPTIMIZER: &str = "generator-optimizer.bpk";
/// Weights and optimizer state of the discriminator (of the left view, where each has its own), and
/// of the right view's.
const DISCRIMINATORS: [[&str; 2]; 2] = [
    ["discriminator.bpk", "discriminator-optimizer.bpk"],
    [
        "discriminator-right.bpk",
        "discriminator-right-optimizer.bpk",
    ],
];

/// What a step did, as numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepReport {
    /// 0-based step.
    pub step: u64,
    /// Epochs done before the step, with their fraction.
    pub position: f64,
    /// Learning rate of the generator.
    pub learning_rate: f64,
    /// Baseline fraction of the adversarial term.
    pub baseline: f64,
    /// Stereo terms, unweighted except for their total.
    pub terms: TermValues,
    /// Adversarial term of the generator, both views, unweighted.
    pub adversarial: f64,
    /// Objective of the discriminator.
    pub discriminator: f64,
    /// What the generator minimised.
    pub total: f64,
    /// Mean predicted disparity of both views, fraction of the width.
    pub disparity_mean: f64,
    /// Mean over images and views of the standard deviation within a disparity map.
    pub disparity_spread: f64,
}

impl StepReport {
    /// Adds what one batch contributes.
    fn add(&mut self, part: &Self) {
        add(&mut self.terms, &part.terms, 1.0);
        self.adversarial += part.adversarial;
        self.discriminator += part.discriminator;
        self.total += part.total;
        self.disparity_mean += part.disparity_mean;
        self.disparity_spread += part.disparity_spread;
    }

    /// The first term that is not a finite number.
    fn check(&self) -> Result<()> {
        let terms = &self.terms;
        for (name, value) in [
            ("ssim_left", terms.ssim_left),
            ("ssim_right", terms.ssim_right),
            ("l1_left", terms.l1_left),
            ("l1_right", terms.l1_right),
            ("left_right_left", terms.left_right_left),
            ("left_right_right", terms.left_right_right),
            ("smoothness_left", terms.smoothness_left),
            ("smoothness_right", terms.smoothness_right),
            ("adversarial", self.adversarial),
            ("discriminator", self.discriminator),
            ("total", self.total),
            ("disparity", self.disparity_mean),
        ] {
            if !value.is_finite() {
                return Err(Error::NonFinite {
                    term: name.to_owned(),
                    value: value as f32,
                    step: self.step,
                });
            }
        }
        Ok(())
    }
}

/// A discriminator with its optimizer.
struct Adversary {
    network: Discriminator,
    optimizer: ModuleOptimizer,
}

/// All networks with their optimizers.
pub struct Networks {
    generator: Generator,
    optimizer: ModuleOptimizer,
    /// None without an adversarial term, one that judges both views, or one for each (left, right).
    adversaries: Vec<Adversary>,
    /// Where batches run; the networks and their optimizers live on the first.
    devices: Vec<Device>,
}

fn adam() -> ModuleOptimizer {
    // PROTOCOL 4.6: beta 0.9 and 0.999, epsilon 1e-8, no weight decay.
    AdamConfig::new()
        .with_beta_1(0.9)
        .with_beta_2(0.999)
        .with_epsilon(1e-8)
        .init()
}

/// Images of a batch as a tensor `[n, 3, height, width]`.
pub(crate) fn images(
    values: Vec<f32>,
    samples: usize,
    config: &Config,
    device: &Device,
) -> Tensor<4> {
    let shape = [
        samples,
        3,
        config.input.height as usize,
        config.input.width as usize,
    ];
    Tensor::from_data(TensorData::new(values, shape), device)
}

impl Networks {
    /// New networks with the weights that the seed gives, or those of `start` where it has them.
    ///
    /// `device` is a plain device; the networks live on its autodiff side. Whether all of `start`
    /// found its place is for [`StartWeights::check`] to say, with [`Self::all_parameters`].
    #[must_use]
    pub fn new(config: &Config, start: Option<&StartWeights>, device: &Device) -> Self {
        let device = device.clone().autodiff();
        let seed = |purpose, index| Draws::new(config.seed, purpose, 0, index).integer();
        let names: &[&str] = match (config.variant.is_adversarial(), config.discriminator.judges) {
            (false, _) => &[],
            (true, Judges::Shared) => &[NETWORK],
            (true, Judges::PerView) => &[NETWORK, RIGHT_NETWORK],
        };
        let adversaries = (0..)
            .zip(names)
            .map(|(index, name)| {
                let seed = seed(Purpose::Discriminator, index);
                let network = config.discriminator.network();
                Adversary {
                    network: network.init_from(seed, start, name, &device),
                    optimizer: adam(),
                }
            })
            .collect();
        let own_seed = seed(Purpose::Generator, 0);
        Self {
            generator: config.network.init_from(own_seed, start, &device),
            optimizer: adam(),
            adversaries,
            devices: vec![device],
        }
    }

    /// The same with more devices that share the batches of a step: the first batch runs where the
    /// networks are, the next on the next device, and so on. Each gets a copy of the weights before
    /// a step; gradients are averaged on the first. On equal devices the result is that of one.
    #[must_use]
    pub fn with_helpers(mut self, devices: &[Device]) -> Self {
        let helpers = devices.iter().map(|device| device.clone().autodiff());
        self.devices.extend(helpers);
        self
    }

    /// The generator, for evaluation and export: no gradients, on the plain device.
    #[must_use]
    pub fn generator(&self) -> Generator {
        self.generator.valid()
    }

    /// The discriminator that judges right views, without gradients and dropout, to look at what
    /// it thinks.
    #[must_use]
    pub fn discriminator(&self) -> Option<Discriminator> {
        self.adversaries
            .last()
            .map(|adversary| adversary.network.valid())
    }

    /// Number of trained values: generator, all discriminators together.
    #[must_use]
    pub fn parameters(&self) -> (usize, usize) {
        let counts = self.adversaries.iter().map(|a| a.network.num_params());
        (self.generator.num_params(), counts.sum())
    }

    /// Every weight of every network, under the names that files use.
    #[must_use]
    pub fn all_parameters(&self) -> Vec<Parameter> {
        let mut parameters = self.generator.parameters();
        for (adversary, name) in self.adversaries.iter().zip([NETWORK, RIGHT_NETWORK]) {
            parameters.extend(adversary.network.parameters(name));
        }
        parameters
    }

    /// Takes one optimizer step (0-based over the run) on its batches.
    ///
    /// # Errors
    /// When a term is not finite; the networks are then of no use any more.
    pub fn step(
        &mut self,
        config: &Config,
        weights: &Weights,
        batches: Vec<Batch>,
        step: u64,
        steps_per_epoch: u64,
    ) -> Result<StepReport> {
        let position = step as f64 / steps_per_epoch as f64;
        let rate = |base| learning_rate(base, config.decay, position, config.epochs);
        let baseline = baseline_fraction(
            config.variant,
            config.baseline_start,
            step / steps_per_epoch,
            config.epochs,
            config.seed,
            step,
        );
        let mut report = StepReport {
            step,
            position,
            learning_rate: rate(config.learning_rate),
            baseline,
            ..StepReport::default()
        };
        let pass = Pass {
            config,
            weights,
            step,
            baseline,
            share: 1.0 / batches.len() as f64,
        };
        let discriminator_rate = rate(config.discriminator_rate());
        let mut own = GradientsAccumulator::<Generator>::new();
        match <[Batch; 1]>::try_from(batches) {
            Ok([batch]) => {
                let judges = self.judges();
                let adversaries = &mut self.adversaries;
                let learned = |index: usize, gradients| {
                    adversaries[index].step(discriminator_rate, gradients);
                    adversaries[index].network.clone()
                };
                let part = pass.run(&self.generator, judges, &self.devices[0], 0, batch, learned);
                report.add(&part.report);
                own.accumulate(&self.generator, part.gradients);
                report.check()?;
            }
            Err(batches) => {
                let mut others: Vec<_> = (0..self.adversaries.len())
                    .map(|_| GradientsAccumulator::<Discriminator>::new())
                    .collect();
                // Added in the order of the batches, so that the number of devices changes no sum.
                self.parts(&pass, batches, |part| {
                    report.add(&part.report);
                    own.accumulate(&self.generator, part.gradients);
                    let judged = self.adversaries.iter().zip(&mut others);
                    for ((adversary, other), gradients) in judged.zip(part.judges) {
                        other.accumulate(&adversary.network, gradients);
                    }
                });
                report.check()?;
                for (adversary, other) in self.adversaries.iter_mut().zip(&mut others) {
                    adversary.step(discriminator_rate, other.grads());
                }
            }
        }
        self.generator =
            self.optimizer
                .step(report.learning_rate, self.generator.clone(), own.grads());
        Ok(report)
    }

    fn judges(&self) -> Vec<Discriminator> {
        self.adversaries.iter().map(|a| a.network.clone()).collect()
    }

    /// Runs batches that share a step, as many at a time as there are devices, and hands over what
    /// each gave in the order of the batches, its gradients on the first device.
    fn parts(&self, pass: &Pass, batches: Vec<Batch>, mut take: impl FnMut(Part)) {
        let home = &self.devices[0];
        // The other devices get the weights anew for every step: only the first has optimizers.
        let replicas: Vec<Replica> = self
            .devices
            .iter()
            .map(|device| Replica {
                generator: self.generator.clone().fork(device),
                judges: self.judges().fork(device),
                device,
            })
            .collect();
        let mut numbered = batches.into_iter().enumerate();
        loop {
            let round: Vec<_> = numbered.by_ref().take(replicas.len()).collect();
            let work = round.into_iter().zip(&replicas);
            let done: Vec<Part> = match replicas.len() {
                1 => work
                    .map(|((index, batch), replica)| replica.run(pass, index, batch, home))
                    .collect(),
                _ => std::thread::scope(|scope| {
                    let threads: Vec<_> = work
                        .map(|((index, batch), replica)| {
                            scope.spawn(move || replica.run(pass, index, batch, home))
                        })
                        .collect();
                    let join = |thread: std::thread::ScopedJoinHandle<Part>| {
                        thread.join().unwrap_or_else(|panic| resume_unwind(panic))
                    };
                    threads.into_iter().map(join).collect()
                }),
            };
            if done.is_empty() {
                break;
            }
            done.into_iter().for_each(&mut take);
        }
    }

    /// The weights and optimizer states as files of a checkpoint.
    ///
    /// # Errors
    /// When burn cannot write them.
    pub fn to_parts(&self) -> Result<BTreeMap<String, Vec<u8>>> {
        let wrong = |error: RecordError| Error::Export(error.to_string());
        let mut parts = BTreeMap::new();
        let mut put = |name: &str, bytes: Bytes| parts.insert(name.to_owned(), bytes.to_vec());
        let generator = self.generator.clone().into_record().into_bytes();
        put(GENERATOR, generator.map_err(wrong)?);
        put(
            GENERATOR_OPTIMIZER,
            self.optimizer.to_record().into_bytes().map_err(wrong)?,
        );
        for (adversary, [network_name, optimizer_name]) in
            self.adversaries.iter().zip(DISCRIMINATORS)
        {
            let network = adversary.network.clone().into_record().into_bytes();
            put(network_name, network.map_err(wrong)?);
            let optimizer = adversary.optimizer.to_record().into_bytes();
            put(optimizer_name, optimizer.map_err(wrong)?);
        }
        Ok(parts)
    }

    /// The networks as they were at a checkpoint; `folder` is named in errors.
    ///
    /// # Errors
    /// When a part is missing or belongs to another network.
    pub fn from_checkpoint(
        config: &Config,
        device: &Device,
        checkpoint: &Checkpoint,
        folder: &Path,
    ) -> Result<Self> {
        let wrong = |name: &str, error: RecordError| Error::Checkpoint {
            folder: folder.to_path_buf(),
            reason: format!("{name}: {error}"),
        };
        let bytes = |name: &str| -> Result<Bytes> {
            Ok(Bytes::from_bytes_vec(
                checkpoint.part(folder, name)?.to_vec(),
            ))
        };
        let module =
            |name: &str| ModuleRecord::from_bytes(bytes(name)?).map_err(|error| wrong(name, error));
        let optimizer = |name: &str| {
            let record =
                OptimizerRecord::from_bytes(bytes(name)?).map_err(|error| wrong(name, error))?;
            // burn rebuilds the state on its default device first, which in a build with GPU
            // backends is a GPU, and panics where none answers.
            catch_unwind(AssertUnwindSafe(|| adam().load_record(record))).map_err(|_| {
                Error::Device(
                    "no GPU answers, and this build looks for one to resume a run even on the \
                     cpu; set BURN_DEVICE=flex in the environment"
                        .to_owned(),
                )
            })
        };
        let mut networks = Self::new(config, None, device);
        networks.generator = networks
            .generator
            .try_load_record(module(GENERATOR)?)
            .map_err(|error| wrong(GENERATOR, error))?;
        networks.optimizer = optimizer(GENERATOR_OPTIMIZER)?;
        for (adversary, [network_name, optimizer_name]) in
            networks.adversaries.iter_mut().zip(DISCRIMINATORS)
        {
            adversary.network = adversary
                .network
                .clone()
                .try_load_record(module(network_name)?)
                .map_err(|error| wrong(network_name, error))?;
            adversary.optimizer = optimizer(optimizer_name)?;
        }
        Ok(networks)
    }
}

impl Adversary {
    fn step(&mut self, rate: f64, gradients: GradientsParams) {
        self.network = self.optimizer.step(rate, self.network.clone(), gradients);
    }
}

/// What all batches of a step have in common.
#[derive(Clone, Copy)]
struct Pass<'a> {
    config: &'a Config,
    weights: &'a Weights,
    step: u64,
    baseline: f64,
    /// Part of one batch in the averages of the step.
    share: f64,
}

/// What one batch contributes to a step, weighted by its share.
struct Part {
    gradients: GradientsParams,
    judges: Vec<GradientsParams>,
    report: StepReport,
}

/// The networks on one of several devices.
struct Replica<'a> {
    generator: Generator,
    judges: Vec<Discriminator>,
    device: &'a Device,
}

impl Replica<'_> {
    /// What the `index`-th batch of a step gives, with its gradients on the device `home`.
    fn run(&self, pass: &Pass, index: usize, batch: Batch, home: &Device) -> Part {
        let home = home.clone().inner();
        let mut judged = Vec::new();
        let learned = |judge: usize, gradients: GradientsParams| {
            let judge = &self.judges[judge];
            judged.push(gradients.to_device(&home, judge));
            judge.clone()
        };
        let judges = self.judges.clone();
        let part = pass.run(&self.generator, judges, self.device, index, batch, learned);
        Part {
            gradients: part.gradients.to_device(&home, &self.generator),
            judges: judged,
            report: part.report,
        }
    }
}

impl Pass<'_> {
    /// Forward and backward passes of one batch, the `index`-th of its step.
    ///
    /// `learned` gets the gradients of each judge and returns the network that judges the
    /// generator: the same, or the one that has taken its step.
    fn run(
        &self,
        generator: &Generator,
        judges: Vec<Discriminator>,
        device: &Device,
        index: usize,
        batch: Batch,
        mut learned: impl FnMut(usize, GradientsParams) -> Discriminator,
    ) -> Part {
        let (config, share) = (self.config, self.share);
        let mut report = StepReport::default();
        let samples = batch.samples;
        let left = images(batch.left, samples, config, device);
        let right = images(batch.right, samples, config, device);
        let disparities = generator.forward(left.clone());
        self.describe(&mut report, &disparities[0]);
        let terms = stereo_losses(left.clone(), right.clone(), &disparities, self.weights);
        let mut total = terms.total.clone();

        if !judges.is_empty() {
            let (right_fake, left_fake) = synthesize(
                left.clone(),
                right.clone(),
                disparities[0].clone(),
                self.baseline,
            );
            let shown = if judges.len() == 1 {
                vec![(
                    Tensor::cat(vec![left, right], 0),
                    Tensor::cat(vec![left_fake, right_fake], 0),
                )]
            } else {
                vec![(left, left_fake), (right, right_fake)]
            };
            let count = judges.len() as f64;
            for (number, (judge, (reals, fakes))) in judges.into_iter().zip(shown).enumerate() {
                let [samples, ..] = reals.dims();
                let look = |pass: u64| {
                    let pass = 2 * index as u64 + pass;
                    Look::draw(config, self.step, pass | (number as u64) << 32, samples)
                };
                let loss = look(0).judge(&judge, reals, fakes.clone().detach());
                report.discriminator += share / count * scalar(&loss);
                let gradients = GradientsParams::from_grads((loss * share).backward(), &judge);
                let still = learned(number, gradients).no_grad();

                let looked = look(1);
                let logits = still.forward_seeded(
                    looked.patches.cut(fakes, &looked.fake_colour),
                    looked.dropout,
                );
                // A sum over the views. Both have as many logits, so where one network judges them
                // together it is twice the mean.
                let term = generator_adversarial(logits) * (2.0 / count);
                report.adversarial += share * scalar(&term);
                total = total + term * self.weights.adversarial;
            }
        }

        report.total = share * scalar(&total);
        add(&mut report.terms, &terms.values(), share);
        Part {
            gradients: GradientsParams::from_grads((total * share).backward(), generator),
            judges: Vec::new(),
            report,
        }
    }

    /// Adds the mean disparity and its spread within the maps to the report.
    fn describe(&self, report: &mut StepReport, disparity: &Tensor<4>) {
        // Without gradients: these numbers are looked at, never learned from.
        let maps = disparity.clone().inner();
        let [samples, views, height, width] = maps.dims();
        let flat: Tensor<2> = maps.reshape([samples * views, height * width]);
        let mean = flat.clone().mean_dim(1);
        let centred = flat - mean.clone();
        let spread = (centred.clone() * centred).mean_dim(1).sqrt();
        report.disparity_mean = self.share * scalar(&mean.mean());
        report.disparity_spread = self.share * scalar(&spread.mean());
    }
}

/// Where the discriminator looks in one pass, in which colours, and its dropout masks.
struct Look {
    patches: Patches,
    real_colour: ColourFactors,
    fake_colour: ColourFactors,
    dropout: u64,
}

impl Look {
    fn draw(config: &Config, step: u64, pass: u64, samples: usize) -> Self {
        let size = [config.input.height as usize, config.input.width as usize];
        let mut draws = Draws::new(config.seed, Purpose::Patches, step, pass);
        let stream = draws.generator();
        Self {
            patches: Patches::draw(stream, samples, size, config.discriminator.patch),
            real_colour: ColourFactors::draw(stream, samples),
            fake_colour: ColourFactors::draw(stream, samples),
            dropout: Draws::new(config.seed, Purpose::Dropout, step, pass).integer(),
        }
    }

    /// The discriminator's objective on real and detached synthesised images.
    fn judge(&self, network: &Discriminator, reals: Tensor<4>, fakes: Tensor<4>) -> Tensor<1> {
        let [samples, ..] = reals.dims();
        // One pass over both: the network treats every sample on its own.
        let shown = Tensor::cat(
            vec![
                self.patches.cut(reals, &self.real_colour),
                self.patches.cut(fakes, &self.fake_colour),
            ],
            0,
        );
        let logits = network.forward_seeded(shown, self.dropout);
        discriminator_adversarial(
            logits.clone().narrow(0, 0, samples),
            logits.narrow(0, samples, samples),
        )
    }
}

fn add(sum: &mut TermValues, part: &TermValues, share: f64) {
    sum.total += share * part.total;
    sum.ssim_left += share * part.ssim_left;
    sum.ssim_right += share * part.ssim_right;
    sum.l1_left += share * part.l1_left;
    sum.l1_right += share * part.l1_right;
    sum.left_right_left += share * part.left_right_left;
    sum.left_right_right += share * part.left_right_right;
    sum.smoothness_left += share * part.smoothness_left;
    sum.smoothness_right += share * part.smoothness_right;
}
