//! One optimizer step of both networks, and what is carried from step to step.
//!
//! Source: PROTOCOL 4.4 to 4.6 and D14. For each batch the generator runs forward once; the
//! discriminator takes its step on detached synthesised views; the generator takes its step
//! through the discriminator, which is held still. With gradient accumulation the gradients
//! of several batches are averaged first, both networks then step at the end, and the
//! generator's adversarial term is judged by the discriminator as it was before the step.
//!
//! Every forward pass here is followed by a backward pass: burn keeps the memory of one that
//! is not. Evaluation belongs on `valid()` networks (see [`crate::validation`]).

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

use burn::module::Module;
use burn::optim::{
    AdamConfig, GradientsAccumulator, GradientsParams, ModuleOptimizer, OptimizerRecord,
};
use burn::store::{ModuleRecord, RecordError};
use burn::tensor::{Bytes, Device, Tensor, TensorData};

use crate::checkpoint::Checkpoint;
use crate::config::Config;
use crate::data::Batch;
use crate::discriminator::{ColourFactors, Discriminator, Patches};
use crate::error::{Error, Result};
use crate::generator::Generator;
use crate::losses::{
    TermValues, Weights, discriminator_adversarial, generator_adversarial, scalar, stereo_losses,
    synthesize,
};
use crate::random::{Draws, Purpose};
use crate::schedule::{baseline_fraction, learning_rate};

const GENERATOR: &str = "generator.bpk";
const GENERATOR_OPTIMIZER: &str = "generator-optimizer.bpk";
const DISCRIMINATOR: &str = "discriminator.bpk";
const DISCRIMINATOR_OPTIMIZER: &str = "discriminator-optimizer.bpk";

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

/// The discriminator with its optimizer.
struct Adversary {
    network: Discriminator,
    optimizer: ModuleOptimizer,
}

/// Both networks with their optimizers.
pub struct Networks {
    generator: Generator,
    optimizer: ModuleOptimizer,
    adversary: Option<Adversary>,
    device: Device,
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
    /// New networks with the weights that the seed gives.
    ///
    /// `device` is a plain device; the networks live on its autodiff side.
    #[must_use]
    pub fn new(config: &Config, device: &Device) -> Self {
        let device = device.clone().autodiff();
        let seed = |purpose| Draws::new(config.seed, purpose, 0, 0).integer();
        let adversary = config.variant.is_adversarial().then(|| Adversary {
            network: config
                .discriminator
                .network()
                .init(seed(Purpose::Discriminator), &device),
            optimizer: adam(),
        });
        Self {
            generator: config.network.init(seed(Purpose::Generator), &device),
            optimizer: adam(),
            adversary,
            device,
        }
    }

    /// The generator, for evaluation and export: no gradients, on the plain device.
    #[must_use]
    pub fn generator(&self) -> Generator {
        self.generator.valid()
    }

    /// The discriminator without gradients and dropout, to look at what it thinks.
    #[must_use]
    pub fn discriminator(&self) -> Option<Discriminator> {
        self.adversary
            .as_ref()
            .map(|adversary| adversary.network.valid())
    }

    /// Number of trained values: generator, discriminator.
    #[must_use]
    pub fn parameters(&self) -> (usize, usize) {
        let adversary = self.adversary.as_ref();
        (
            self.generator.num_params(),
            adversary.map_or(0, |adversary| adversary.network.num_params()),
        )
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
        let parts = batches.len();
        let share = 1.0 / parts as f64;
        let mut own = GradientsAccumulator::<Generator>::new();
        let mut other = GradientsAccumulator::<Discriminator>::new();

        for (part, batch) in batches.into_iter().enumerate() {
            let samples = batch.samples;
            let left = images(batch.left, samples, config, &self.device);
            let right = images(batch.right, samples, config, &self.device);
            let disparities = self.generator.forward(left.clone());
            self.describe(&mut report, &disparities[0], share);
            let terms = stereo_losses(left.clone(), right.clone(), &disparities, weights);
            let mut total = terms.total.clone();

            let mut adversarial = None;
            if let Some(adversary) = &mut self.adversary {
                let (right_fake, left_fake) = synthesize(
                    left.clone(),
                    right.clone(),
                    disparities[0].clone(),
                    baseline,
                );
                let fakes = Tensor::cat(vec![left_fake, right_fake], 0);
                let reals = Tensor::cat(vec![left, right], 0);
                let look =
                    |pass: u64| Look::draw(config, step, 2 * part as u64 + pass, 2 * samples);

                let looked = look(0);
                let loss = looked.judge(&adversary.network, reals, fakes.clone().detach());
                report.discriminator += share * scalar(&loss);
                let gradients =
                    GradientsParams::from_grads((loss * share).backward(), &adversary.network);
                other.accumulate(&adversary.network, gradients);
                if parts == 1 {
                    adversary.step(rate(config.discriminator_rate()), &mut other);
                }

                let still = adversary.network.clone().no_grad();
                let looked = look(1);
                let logits = still.forward_seeded(
                    looked.patches.cut(fakes, &looked.fake_colour),
                    looked.dropout,
                );
                // Both views have as many logits, so the sum of their means is twice the mean.
                let term = generator_adversarial(logits) * 2.0;
                total = total + term.clone() * weights.adversarial;
                adversarial = Some(term);
            }

            if let Some(term) = &adversarial {
                report.adversarial += share * scalar(term);
            }
            report.total += share * scalar(&total);
            add(&mut report.terms, &terms.values(), share);
            let gradients =
                GradientsParams::from_grads((total * share).backward(), &self.generator);
            own.accumulate(&self.generator, gradients);
        }
        report.check()?;
        if parts > 1
            && let Some(adversary) = &mut self.adversary
        {
            adversary.step(rate(config.discriminator_rate()), &mut other);
        }
        self.generator =
            self.optimizer
                .step(report.learning_rate, self.generator.clone(), own.grads());
        Ok(report)
    }

    /// Adds the mean disparity and its spread within the maps to the report.
    fn describe(&self, report: &mut StepReport, disparity: &Tensor<4>, share: f64) {
        // Without gradients: these numbers are looked at, never learned from.
        let maps = disparity.clone().inner();
        let [samples, views, height, width] = maps.dims();
        let flat: Tensor<2> = maps.reshape([samples * views, height * width]);
        let mean = flat.clone().mean_dim(1);
        let centred = flat - mean.clone();
        let spread = (centred.clone() * centred).mean_dim(1).sqrt();
        report.disparity_mean += share * scalar(&mean.mean());
        report.disparity_spread += share * scalar(&spread.mean());
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
        if let Some(adversary) = &self.adversary {
            let network = adversary.network.clone().into_record().into_bytes();
            put(DISCRIMINATOR, network.map_err(wrong)?);
            let optimizer = adversary.optimizer.to_record().into_bytes();
            put(DISCRIMINATOR_OPTIMIZER, optimizer.map_err(wrong)?);
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
        let mut networks = Self::new(config, device);
        networks.generator = networks
            .generator
            .try_load_record(module(GENERATOR)?)
            .map_err(|error| wrong(GENERATOR, error))?;
        networks.optimizer = optimizer(GENERATOR_OPTIMIZER)?;
        if let Some(adversary) = networks.adversary {
            networks.adversary = Some(Adversary {
                network: adversary
                    .network
                    .try_load_record(module(DISCRIMINATOR)?)
                    .map_err(|error| wrong(DISCRIMINATOR, error))?,
                optimizer: optimizer(DISCRIMINATOR_OPTIMIZER)?,
            });
        }
        Ok(networks)
    }

    /// The generator of a checkpoint alone, for export.
    ///
    /// # Errors
    /// As [`Self::from_checkpoint`].
    pub fn generator_from_checkpoint(
        config: &Config,
        device: &Device,
        checkpoint: &Checkpoint,
        folder: &Path,
    ) -> Result<Generator> {
        Ok(Self::from_checkpoint(config, device, checkpoint, folder)?.generator())
    }
}

impl Adversary {
    fn step(&mut self, rate: f64, gradients: &mut GradientsAccumulator<Discriminator>) {
        self.network = self
            .optimizer
            .step(rate, self.network.clone(), gradients.grads());
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
