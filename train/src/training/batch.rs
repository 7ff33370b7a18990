//! Forward and backward passes of one batch, on one device.
//!
//! The order is that of PROTOCOL 4.4 to 4.6: the generator runs forward once; each discriminator
//! gets its gradients on detached synthesised views; the generator is judged through a discriminator
//! that is held still, by the caller's choice before or after its own step.

use burn::module::Module;
use burn::optim::GradientsParams;
use burn::tensor::{Device, Tensor};

use super::report::StepReport;
use crate::config::Config;
use crate::data::loader::{Batch, to_tensor};
use crate::loss::{
    Weights, discriminator_adversarial, generator_adversarial, scalar, stereo_losses, synthesize,
};
use crate::network::discriminator::{ColourFactors, Discriminator, Patches};
use crate::network::generator::Generator;
use crate::random::{Draws, Purpose};

/// What all batches of a step have in common.
#[derive(Clone, Copy)]
pub(super) struct StepContext<'a> {
    pub config: &'a Config,
    pub weights: Weights,
    pub step: u64,
    pub baseline: f64,
    pub discriminator_rate: f64,
    /// Part of one batch in the averages of the step.
    pub share: f64,
}

/// What one batch contributes to a step, weighted by its share.
pub(super) struct BatchGradients {
    pub generator: GradientsParams,
    pub discriminators: Vec<GradientsParams>,
    pub report: StepReport,
}

/// The networks on one of several devices.
pub(super) struct Replica<'a> {
    pub generator: Generator,
    pub discriminators: Vec<Discriminator>,
    pub device: &'a Device,
}

impl Replica<'_> {
    /// What the `index`-th batch of a step gives, with its gradients on the device `home`. The
    /// generator is judged by the discriminators as they are.
    pub fn run(
        &self,
        context: &StepContext,
        batch: Batch,
        index: usize,
        home: &Device,
    ) -> BatchGradients {
        let home = home.clone().inner();
        let count = self.discriminators.len();
        let (mut pass, shown) =
            BatchPass::forward(context, &self.generator, batch, index, count, self.device);
        let mut of_discriminators = Vec::new();
        for (discriminator, (reals, fakes)) in self.discriminators.iter().zip(shown) {
            let gradients = pass.discriminator_gradients(reals, &fakes, discriminator);
            of_discriminators.push(gradients.to_device(&home, discriminator));
            pass.add_adversarial_term(fakes, discriminator);
        }
        let (gradients, report) = pass.finish(&self.generator);
        BatchGradients {
            generator: gradients.to_device(&home, &self.generator),
            discriminators: of_discriminators,
            report,
        }
    }
}

/// Synthesised images for one of the discriminators.
pub(super) struct Fakes {
    /// Which discriminator.
    number: usize,
    images: Tensor<4>,
}

/// A batch between the generator's forward pass and its backward pass.
pub(super) struct BatchPass<'a> {
    context: &'a StepContext<'a>,
    /// Number of the batch within its step.
    index: usize,
    discriminators: usize,
    total: Tensor<1>,
    report: StepReport,
}

impl<'a> BatchPass<'a> {
    /// Runs the generator and the stereo terms, and makes what each of the `discriminators` is
    /// shown: real and synthesised images.
    pub fn forward(
        context: &'a StepContext<'a>,
        generator: &Generator,
        batch: Batch,
        index: usize,
        discriminators: usize,
        device: &Device,
    ) -> (Self, Vec<(Tensor<4>, Fakes)>) {
        let share = context.share;
        let size = context.config.input.size();
        let left = to_tensor(batch.left, size, device);
        let right = to_tensor(batch.right, size, device);
        let disparities = generator.forward(left.clone());
        let (disparity_mean, disparity_spread) = describe(&disparities[0]);
        let terms = stereo_losses(left.clone(), right.clone(), &disparities, &context.weights);
        let mut report = StepReport {
            disparity_mean: share * disparity_mean,
            disparity_spread: share * disparity_spread,
            ..StepReport::default()
        };
        report.terms.add(&terms.values(), share);
        let views = match discriminators {
            0 => Vec::new(),
            count => {
                let [disparity, ..] = disparities;
                let (right_fake, left_fake) =
                    synthesize(left.clone(), right.clone(), disparity, context.baseline);
                if count == 1 {
                    vec![(
                        Tensor::cat(vec![left, right], 0),
                        Tensor::cat(vec![left_fake, right_fake], 0),
                    )]
                } else {
                    vec![(left, left_fake), (right, right_fake)]
                }
            }
        };
        let shown = views.into_iter().enumerate();
        let shown = shown.map(|(number, (reals, images))| (reals, Fakes { number, images }));
        let pass = Self {
            context,
            index,
            discriminators,
            total: terms.total,
            report,
        };
        (pass, shown.collect())
    }

    /// Gradients of a discriminator's objective on the real and the detached synthesised images.
    pub fn discriminator_gradients(
        &mut self,
        reals: Tensor<4>,
        fakes: &Fakes,
        discriminator: &Discriminator,
    ) -> GradientsParams {
        let share = self.context.share;
        let images = fakes.images.clone().detach();
        let input = self.input(fakes, 0);
        let loss = input.objective(discriminator, reals, images);
        self.report.discriminator += share / self.discriminators as f64 * scalar(&loss);
        GradientsParams::from_grads((loss * share).backward(), discriminator)
    }

    /// Adds to the generator's loss what the discriminator, held still, makes of its images.
    pub fn add_adversarial_term(&mut self, fakes: Fakes, discriminator: &Discriminator) {
        let input = self.input(&fakes, 1);
        let logits = discriminator.clone().no_grad().forward_seeded(
            input.patches.cut(fakes.images, &input.fake_colour),
            input.dropout,
        );
        // A sum over the views. Both have as many logits, so where one network judges them
        // together it is twice the mean.
        let term = generator_adversarial(logits) * (2.0 / self.discriminators as f64);
        self.report.adversarial += self.context.share * scalar(&term);
        self.total = self.total.clone() + term * self.context.weights.adversarial;
    }

    /// The generator's gradients, and the numbers of the batch.
    pub fn finish(mut self, generator: &Generator) -> (GradientsParams, StepReport) {
        let share = self.context.share;
        self.report.total = share * scalar(&self.total);
        let gradients = (self.total * share).backward();
        (
            GradientsParams::from_grads(gradients, generator),
            self.report,
        )
    }

    /// What a discriminator is shown in its own pass (0) or the generator's (1).
    fn input(&self, fakes: &Fakes, pass: u64) -> DiscriminatorInput {
        let pass = 2 * self.index as u64 + pass;
        let [samples, ..] = fakes.images.dims();
        DiscriminatorInput::draw(
            self.context.config,
            self.context.step,
            pass | (fakes.number as u64) << 32,
            samples,
        )
    }
}

/// Mean disparity, and the mean standard deviation within the maps.
fn describe(disparity: &Tensor<4>) -> (f64, f64) {
    // Without gradients: these numbers are looked at, never learned from.
    let maps = disparity.clone().inner();
    let [samples, views, height, width] = maps.dims();
    let flat: Tensor<2> = maps.reshape([samples * views, height * width]);
    let mean = flat.clone().mean_dim(1);
    let centred = flat - mean.clone();
    let spread = (centred.clone() * centred).mean_dim(1).sqrt();
    (scalar(&mean.mean()), scalar(&spread.mean()))
}

/// Where the discriminator looks in one pass, in which colours, and its dropout masks.
struct DiscriminatorInput {
    patches: Patches,
    real_colour: ColourFactors,
    fake_colour: ColourFactors,
    dropout: u64,
}

impl DiscriminatorInput {
    fn draw(config: &Config, step: u64, pass: u64, samples: usize) -> Self {
        let mut draws = Draws::new(config.seed, Purpose::Patches, step, pass);
        let stream = draws.generator();
        let patch = config.discriminator.patch;
        Self {
            patches: Patches::draw(stream, samples, config.input.size(), patch),
            real_colour: ColourFactors::draw(stream, samples),
            fake_colour: ColourFactors::draw(stream, samples),
            dropout: Draws::new(config.seed, Purpose::Dropout, step, pass).integer(),
        }
    }

    /// The discriminator's objective on real and detached synthesised images.
    fn objective(&self, network: &Discriminator, reals: Tensor<4>, fakes: Tensor<4>) -> Tensor<1> {
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
