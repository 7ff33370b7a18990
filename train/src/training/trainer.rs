//! One optimizer step of both networks, and what is carried from step to step.
//!
//! Source: PROTOCOL 4.4 to 4.6 and D14. With one batch per step the discriminator takes its step
//! before it judges the generator. With gradient accumulation the gradients of several batches
//! are averaged first, both networks then step at the end, and the generator's adversarial term
//! is judged by the discriminator as it was before the step.
//!
//! Every forward pass here is followed by a backward pass: burn keeps the memory of one that
//! is not. Evaluation belongs on `valid()` networks (see [`crate::training::validation`]).

use std::collections::BTreeMap;
use std::panic::resume_unwind;
use std::path::Path;

use burn::module::Module;
use burn::optim::{GradientsAccumulator, GradientsParams, ModuleOptimizer, OptimizerRecord};
use burn::store::{ModuleRecord, RecordError};
use burn::tensor::{Bytes, Device};

use strat_store::guard::guarded;

use super::batch::{BatchGradients, BatchPass, Replica, StepContext};
use super::checkpoint::Checkpoint;
use super::report::StepReport;
use super::schedule::{Timeline, baseline_fraction, learning_rate};
use crate::config::{Config, Sharing};
use crate::data::loader::Batch;
use crate::error::{Error, Result};
use crate::kernels::adam::FusedAdam;
use crate::network::discriminator::{Discriminator, NETWORK, RIGHT_NETWORK};
use crate::network::generator::Generator;
use crate::network::initial_weights::{InitialWeights, Parameter};
use crate::random::{Draws, Purpose};

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

/// A discriminator with its optimizer.
struct Adversary {
    network: Discriminator,
    optimizer: ModuleOptimizer,
}

/// All networks with their optimizers.
pub struct Trainer {
    generator: Generator,
    optimizer: ModuleOptimizer,
    /// None without an adversarial term, one for both views, or one for each (left, right).
    adversaries: Vec<Adversary>,
    /// Where batches run; the networks and their optimizers live on the first.
    devices: Vec<Device>,
}

/// The optimizer of every network: Adam with beta 0.9 and 0.999, epsilon 1e-8, no weight decay
/// (PROTOCOL 4.6).
#[must_use]
pub fn adam() -> ModuleOptimizer {
    FusedAdam::new(0.9, 0.999, 1e-8).into()
}

impl Trainer {
    /// New networks with the weights that the seed gives, or those of `initial` where it has them.
    ///
    /// `device` is a plain device; the networks live on its autodiff side. Whether every tensor of
    /// `initial` was used is for [`InitialWeights::check`] to say, with [`Self::all_parameters`].
    #[must_use]
    pub fn new(config: &Config, initial: Option<&InitialWeights>, device: &Device) -> Self {
        let device = device.clone().autodiff();
        let seed = |purpose, index| Draws::new(config.seed, purpose, 0, index).integer();
        let names: &[&str] = match (
            config.variant.is_adversarial(),
            config.discriminator.sharing,
        ) {
            (false, _) => &[],
            (true, Sharing::Shared) => &[NETWORK],
            (true, Sharing::PerView) => &[NETWORK, RIGHT_NETWORK],
        };
        let adversaries = (0..)
            .zip(names)
            .map(|(index, name)| {
                let seed = seed(Purpose::Discriminator, index);
                let network = config.discriminator.network();
                Adversary {
                    network: network.init_from(seed, initial, name, &device),
                    optimizer: adam(),
                }
            })
            .collect();
        let own_seed = seed(Purpose::Generator, 0);
        Self {
            generator: config.network.init_from(own_seed, initial, &device),
            optimizer: adam(),
            adversaries,
            devices: vec![device],
        }
    }

    /// The same with more devices that share the batches of a step: the first batch runs where the
    /// networks are, the next on the next device, and so on. Each gets a copy of the weights before
    /// a step; gradients are averaged on the first. On equal devices the result is that of one.
    #[must_use]
    pub fn with_replicas(mut self, devices: &[Device]) -> Self {
        let replicas = devices.iter().map(|device| device.clone().autodiff());
        self.devices.extend(replicas);
        self
    }

    /// The generator, for evaluation and export: no gradients, on the plain device.
    #[must_use]
    pub fn generator(&self) -> Generator {
        self.generator.valid()
    }

    /// The discriminator of the right view, without gradients and dropout, to look at what
    /// it thinks.
    #[must_use]
    pub fn discriminator(&self) -> Option<Discriminator> {
        self.adversaries
            .last()
            .map(|adversary| adversary.network.valid())
    }

    /// The discriminator that judges left views, without gradients and dropout; none without an
    /// adversarial term.
    #[must_use]
    pub fn left_discriminator(&self) -> Option<Discriminator> {
        self.adversaries
            .first()
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
    /// When a term is not finite; the networks are then unusable.
    pub fn step(
        &mut self,
        config: &Config,
        timeline: &Timeline,
        step: u64,
        batches: Vec<Batch>,
    ) -> Result<StepReport> {
        let rate = |base| {
            let position = timeline.position(step);
            learning_rate(base, config.decay, position, timeline.epochs)
        };
        let context = StepContext {
            config,
            weights: config.loss_weights(),
            step,
            baseline: baseline_fraction(config, timeline, step),
            discriminator_rate: rate(config.discriminator_rate()),
            share: 1.0 / batches.len() as f64,
            diagnose: timeline.is_due(config.diagnostics().every, step),
        };
        let mut report = StepReport {
            step,
            learning_rate: rate(config.learning_rate),
            baseline: context.baseline,
            ..StepReport::default()
        };
        let gradients = match <[Batch; 1]>::try_from(batches) {
            Ok([batch]) => self.run_one(&context, batch, &mut report)?,
            Err(batches) => self.run_several(&context, batches, &mut report)?,
        };
        self.generator =
            self.optimizer
                .step(report.learning_rate, self.generator.clone(), gradients);
        Ok(report)
    }

    /// The only batch of a step: each discriminator takes its step before it judges the generator.
    fn run_one(
        &mut self,
        context: &StepContext,
        batch: Batch,
        report: &mut StepReport,
    ) -> Result<GradientsParams> {
        let count = self.adversaries.len();
        let (mut pass, shown) =
            BatchPass::forward(context, &self.generator, batch, 0, count, &self.devices[0]);
        for (adversary, (reals, fakes)) in self.adversaries.iter_mut().zip(shown) {
            let gradients = pass.discriminator_gradients(reals, &fakes, &adversary.network);
            adversary.step(context.discriminator_rate, gradients);
            pass.add_adversarial_term(fakes, &adversary.network);
        }
        let judges: Vec<Discriminator> =
            self.adversaries.iter().map(|a| a.network.clone()).collect();
        let (gradients, of_batch) = pass.finish(&self.generator, &judges);
        report.add(&of_batch);
        report.check()?;
        Ok(gradients)
    }

    /// Several batches of a step: gradients are averaged in the order of the batches, whatever the
    /// number of devices, and the discriminators take their steps after all batches.
    fn run_several(
        &mut self,
        context: &StepContext,
        batches: Vec<Batch>,
        report: &mut StepReport,
    ) -> Result<GradientsParams> {
        let mut of_generator = GradientsAccumulator::<Generator>::new();
        let mut of_discriminators: Vec<_> = (0..self.adversaries.len())
            .map(|_| GradientsAccumulator::<Discriminator>::new())
            .collect();
        self.run_on_replicas(context, batches, |batch| {
            report.add(&batch.report);
            of_generator.accumulate(&self.generator, batch.generator);
            let sums = self.adversaries.iter().zip(&mut of_discriminators);
            for ((adversary, sum), gradients) in sums.zip(batch.discriminators) {
                sum.accumulate(&adversary.network, gradients);
            }
        });
        report.check()?;
        for (adversary, sum) in self.adversaries.iter_mut().zip(&mut of_discriminators) {
            adversary.step(context.discriminator_rate, sum.grads());
        }
        Ok(of_generator.grads())
    }

    /// Runs batches that share a step, as many at a time as there are devices, and hands over what
    /// each gave in the order of the batches, its gradients on the first device.
    fn run_on_replicas(
        &self,
        context: &StepContext,
        batches: Vec<Batch>,
        mut take: impl FnMut(BatchGradients),
    ) {
        let home = &self.devices[0];
        let discriminators: Vec<Discriminator> =
            self.adversaries.iter().map(|a| a.network.clone()).collect();
        // The other devices get the weights anew for every step: only the first has optimizers.
        let replicas: Vec<Replica> = self
            .devices
            .iter()
            .map(|device| Replica {
                generator: self.generator.clone().fork(device),
                discriminators: discriminators.clone().fork(device),
                device,
            })
            .collect();
        let mut numbered = batches.into_iter().enumerate();
        loop {
            let round: Vec<_> = numbered.by_ref().take(replicas.len()).collect();
            let work = round.into_iter().zip(&replicas);
            let done: Vec<BatchGradients> = match replicas.len() {
                1 => work
                    .map(|((index, batch), replica)| replica.run(context, batch, index, home))
                    .collect(),
                _ => std::thread::scope(|scope| {
                    let threads: Vec<_> = work
                        .map(|((index, batch), replica)| {
                            scope.spawn(move || replica.run(context, batch, index, home))
                        })
                        .collect();
                    let join = |thread: std::thread::ScopedJoinHandle<BatchGradients>| {
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
        let read = |name: &str| -> Result<Bytes> {
            Ok(Bytes::from_bytes_vec(
                checkpoint.part(folder, name)?.to_vec(),
            ))
        };
        let module = |name: &str| reading(folder, name, read(name)?, ModuleRecord::from_bytes);
        let optimizer = |name: &str| {
            let record = reading(folder, name, read(name)?, OptimizerRecord::from_bytes)?;
            // burn rebuilds the state on its default device first, which in a build with GPU backends is a
            // GPU, and panics where none answers.
            reading(folder, name, record, |record| Ok(adam().load_record(record))).map_err(|error| {
                match cfg!(any(feature = "wgpu", feature = "cuda")) {
                    true => Error::Device(format!(
                        "{error}; this build looks for a GPU to resume a run even on the cpu, and where none \
                         answers, set BURN_DEVICE=flex in the environment"
                    )),
                    false => error,
                }
            })
        };
        let mut trainer = Self::new(config, None, device);
        let generator = trainer.generator;
        trainer.generator = reading(folder, GENERATOR, module(GENERATOR)?, |record| {
            generator.try_load_record(record)
        })?;
        trainer.optimizer = optimizer(GENERATOR_OPTIMIZER)?;
        for (adversary, [network_name, optimizer_name]) in
            trainer.adversaries.iter_mut().zip(DISCRIMINATORS)
        {
            let network = adversary.network.clone();
            adversary.network = reading(folder, network_name, module(network_name)?, |record| {
                network.try_load_record(record)
            })?;
            adversary.optimizer = optimizer(optimizer_name)?;
        }
        Ok(trainer)
    }
}

/// Does what burn does with a part of a checkpoint, which it may panic at; `name` and `folder` are named in
/// errors.
fn reading<T, U>(
    folder: &Path,
    name: &str,
    part: T,
    work: impl FnOnce(T) -> std::result::Result<U, RecordError>,
) -> Result<U> {
    let done = guarded("burn", || work(part));
    let done = done.and_then(|done| done.map_err(|error| error.to_string()));
    done.map_err(|reason| Error::Checkpoint {
        folder: folder.to_path_buf(),
        reason: format!("{name}: {reason}"),
    })
}

impl Adversary {
    fn step(&mut self, rate: f64, gradients: GradientsParams) {
        self.network = self.optimizer.step(rate, self.network.clone(), gradients);
    }
}
