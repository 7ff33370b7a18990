//! The numbers of a step, under the names of their columns.

use crate::error::{Error, Result};
use crate::loss::{Term, TermValues};

/// Euclidean norms of the gradients of the weighted terms at the predicted disparities of all levels,
/// on one batch: how hard each term pulls. A term that has no weight is 0.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GradientNorms {
    /// By [`Term`], both views together.
    pub stereo: [f64; Term::COUNT],
    /// The generator's adversarial term.
    pub adversarial: f64,
}

impl GradientNorms {
    /// Every norm under its name.
    pub fn columns(&self) -> impl Iterator<Item = (&'static str, f64)> {
        let stereo = Term::ALL.map(Term::key).into_iter().zip(self.stereo);
        stereo.chain([("adversarial", self.adversarial)])
    }
}

/// What a step did, as numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepReport {
    /// 0-based step.
    pub step: u64,
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
    /// Fractions of the real and of the synthesised patches' cells that the discriminator was right
    /// about before its step; 0 without one.
    pub accuracy: [f64; 2],
    /// At the steps that measure them.
    pub gradients: Option<GradientNorms>,
}

impl StepReport {
    /// Every number under its column of a run's table.
    #[must_use]
    pub fn columns(&self) -> Vec<(&'static str, f64)> {
        let mut columns = vec![
            ("learning_rate", self.learning_rate),
            ("baseline_fraction", self.baseline),
            ("total", self.total),
            ("stereo", self.terms.total),
        ];
        columns.extend(self.terms.columns());
        columns.extend([
            ("adversarial", self.adversarial),
            ("discriminator", self.discriminator),
            ("disparity_mean", self.disparity_mean),
            ("disparity_spread", self.disparity_spread),
            ("accuracy_real", self.accuracy[0]),
            ("accuracy_synthesised", self.accuracy[1]),
        ]);
        columns
    }

    /// Adds the numbers of another report to these.
    pub fn add(&mut self, other: &Self) {
        self.terms.add(&other.terms, 1.0);
        self.adversarial += other.adversarial;
        self.discriminator += other.discriminator;
        self.total += other.total;
        self.disparity_mean += other.disparity_mean;
        self.disparity_spread += other.disparity_spread;
        for (sum, value) in self.accuracy.iter_mut().zip(other.accuracy) {
            *sum += value;
        }
        self.gradients = self.gradients.or(other.gradients);
    }

    /// Refuses a number that is not finite, naming a term rather than the sum it spoils.
    pub(super) fn check(&self) -> Result<()> {
        let columns = self.columns();
        let (sums, terms) = columns.split_at(4);
        let mut all = terms.iter().chain(sums);
        match all.find(|(_, value)| !value.is_finite()) {
            None => Ok(()),
            Some((term, value)) => Err(Error::NonFinite {
                term: (*term).to_owned(),
                value: *value as f32,
                step: self.step,
            }),
        }
    }
}
