//! Forward and backward passes of one batch, on one device.
//!
//! The order is that of PROTOCOL 4.4 to 4.6: the generator runs forward once; each discriminator
//! gets its gradients on detached synthesised views; the generator is judged through a discriminator
//! that is held still, by the caller's choice before or after its own step.

use burn::module::Module;
use burn::optim::GradientsParams;
use burn::tensor::{Device, Tensor};

use super::report::{GradientNorms, StepReport};
use crate::config::Config;
use crate::data::loader::{Batch, to_tensor};
use crate::loss::{
    Term, Weights, discriminator_adversarial, generator_adversarial, scalar, stereo_losses,
    synthesize,
};
use crate::network::discriminator::{ColourFactors, Discriminator, Patches};
use crate::network::generator::{Generator, SCALES};
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
    /// Whether the first batch measures the gradients of the terms.
    pub diagnose: bool,
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
        let (gradients, report) = pass.finish(&self.generator, &self.discriminators);
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

impl Fakes {
    /// What each of the discriminators is shown of the views synthesised at the context's baseline:
    /// both, where there is one, else the left and the right one.
    fn of(
        context: &StepContext,
        discriminators: usize,
        [left, right]: [&Tensor<4>; 2],
        disparity: Tensor<4>,
    ) -> Vec<Self> {
        if discriminators == 0 {
            return Vec::new();
        }
        let (right, left) = synthesize(left.clone(), right.clone(), disparity, context.baseline);
        let images = match discriminators {
            1 => vec![Tensor::cat(vec![left, right], 0)],
            _ => vec![left, right],
        };
        let numbered = images.into_iter().enumerate();
        numbered
            .map(|(number, images)| Self { number, images })
            .collect()
    }

    /// What a discriminator is shown in its own pass (0) or the generator's (1) over the `index`-th
    /// batch of a step.
    fn input(&self, context: &StepContext, index: usize, pass: u64) -> DiscriminatorInput {
        let pass = 2 * index as u64 + pass;
        let [samples, ..] = self.images.dims();
        DiscriminatorInput::draw(
            context.config,
            context.step,
            pass | (self.number as u64) << 32,
            samples,
        )
    }

    /// What the discriminator, held still, makes of its images: the mean over its logits. The term of
    /// the generator is a sum over the views; both have as many logits, so where one network judges
    /// them together it is twice this mean.
    fn adversarial_term(
        self,
        context: &StepContext,
        index: usize,
        discriminator: &Discriminator,
    ) -> Tensor<1> {
        let input = self.input(context, index, 1);
        let logits = discriminator.clone().no_grad().forward_seeded(
            input.patches.cut(self.images, &input.fake_colour),
            input.dropout,
        );
        generator_adversarial(logits)
    }
}

/// A batch between the generator's forward pass and its backward pass.
pub(super) struct BatchPass<'a> {
    context: &'a StepContext<'a>,
    /// Number of the batch within its step.
    index: usize,
    discriminators: usize,
    total: Tensor<1>,
    report: StepReport,
    probe: Option<Probe>,
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
        let probe = (context.diagnose && index == 0).then(|| Probe {
            left: left.clone(),
            right: right.clone(),
            disparities: disparities.clone().map(Tensor::inner),
        });
        let [disparity, ..] = disparities;
        let fakes = Fakes::of(context, discriminators, [&left, &right], disparity);
        let reals = match discriminators {
            0 => Vec::new(),
            1 => vec![Tensor::cat(vec![left, right], 0)],
            _ => vec![left, right],
        };
        let pass = Self {
            context,
            index,
            discriminators,
            total: terms.total,
            report,
            probe,
        };
        (pass, reals.into_iter().zip(fakes).collect())
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
        let input = fakes.input(self.context, self.index, 0);
        let (loss, right) = input.objective(discriminator, reals, images);
        let share_of_one = share / self.discriminators as f64;
        self.report.discriminator += share_of_one * scalar(&loss);
        for (sum, right) in self.report.accuracy.iter_mut().zip(right) {
            *sum += share_of_one * right;
        }
        GradientsParams::from_grads((loss * share).backward(), discriminator)
    }

    /// Adds to the generator's loss what the discriminator, held still, makes of its images.
    pub fn add_adversarial_term(&mut self, fakes: Fakes, discriminator: &Discriminator) {
        let term = fakes.adversarial_term(self.context, self.index, discriminator)
            * (2.0 / self.discriminators as f64);
        self.report.adversarial += self.context.share * scalar(&term);
        self.total = self.total.clone() + term * self.context.weights.adversarial;
    }

    /// The generator's gradients, and the numbers of the batch. The `discriminators` are those that
    /// judged the generator.
    pub fn finish(
        mut self,
        generator: &Generator,
        discriminators: &[Discriminator],
    ) -> (GradientsParams, StepReport) {
        let share = self.context.share;
        self.report.total = share * scalar(&self.total);
        let gradients = (self.total * share).backward();
        let gradients = GradientsParams::from_grads(gradients, generator);
        // After the backward pass, whose memory is free again.
        let measured = self.probe.map(|p| p.norms(self.context, discriminators));
        self.report.gradients = measured;
        (gradients, self.report)
    }
}

/// What the gradients of the terms are measured on: a batch and the disparities of its forward pass,
/// cut off from the networks.
struct Probe {
    left: Tensor<4>,
    right: Tensor<4>,
    disparities: [Tensor<4>; SCALES],
}

impl Probe {
    /// The gradient norms of every weighted term. Graphs of their own: nothing of the step changes.
    fn norms(&self, context: &StepContext, discriminators: &[Discriminator]) -> GradientNorms {
        let stereo = Term::ALL.map(|term| {
            let weight = context.weights.of(term);
            if weight == 0.0 {
                return 0.0;
            }
            let alone = context.weights.only(term);
            self.norm(|disparities| {
                let (left, right) = (self.left.clone(), self.right.clone());
                stereo_losses(left, right, disparities, &alone).total
            })
        });
        let adversarial = if discriminators.is_empty() {
            0.0
        } else {
            self.norm(|[disparity, ..]| {
                let count = discriminators.len();
                let views = [&self.left, &self.right];
                let fakes = Fakes::of(context, count, views, disparity.clone());
                let terms = fakes.into_iter().zip(discriminators);
                let terms = terms.map(|(f, network)| f.adversarial_term(context, 0, network));
                let sum = Tensor::cat(terms.collect(), 0).sum();
                sum * (2.0 / count as f64 * context.weights.adversarial)
            })
        };
        GradientNorms {
            stereo,
            adversarial,
        }
    }

    /// Euclidean norm of a loss' gradient at the disparities of all levels together.
    fn norm(&self, loss: impl FnOnce(&[Tensor<4>; SCALES]) -> Tensor<1>) -> f64 {
        let leaves = self
            .disparities
            .clone()
            .map(|disparity| Tensor::from_inner(disparity).require_grad());
        let gradients = loss(&leaves).backward();
        let squares = leaves.iter().filter_map(|leaf| leaf.grad(&gradients));
        let squares = squares.map(|gradient| scalar(&(gradient.clone() * gradient).sum()));
        squares.sum::<f64>().sqrt()
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

    /// The discriminator's objective on real and detached synthesised images, and the fractions of
    /// each that it is right about.
    fn objective(
        &self,
        network: &Discriminator,
        reals: Tensor<4>,
        fakes: Tensor<4>,
    ) -> (Tensor<1>, [f64; 2]) {
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
        let right = right_about(&logits);
        let objective = discriminator_adversarial(
            logits.clone().narrow(0, 0, samples),
            logits.narrow(0, samples, samples),
        );
        (objective, right)
    }
}

/// Of logits whose first half is of real images and whose second half of synthesised ones: the
/// fraction of each that has the right sign.
fn right_about(logits: &Tensor<4>) -> [f64; 2] {
    let logits: Vec<f64> = logits.clone().into_data().iter::<f64>().collect();
    let (real, fake) = logits.split_at(logits.len() / 2);
    let fraction = |of: &[f64], right: fn(f64) -> bool| {
        of.iter().filter(|logit| right(**logit)).count() as f64 / of.len().max(1) as f64
    };
    [fraction(real, |x| x > 0.0), fraction(fake, |x| x < 0.0)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn real_patches_have_positive_logits_and_synthesised_ones_negative() {
        let device = Device::flex();
        let logits = [[0.1, 2.0, 3.0, -1.0], [-0.1, 1.0, -3.0, 0.0]];
        let logits: Tensor<2> = Tensor::from_floats(logits, &device);
        assert_eq!(right_about(&logits.reshape([4, 1, 1, 2])), [0.75, 0.5]);
    }
}
