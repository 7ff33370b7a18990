//! What changes while training goes on: the baseline fraction b and the learning rate.
//!
//! Source: PROTOCOL 4.6 (thesis 3.2.3, the structured adversarial schedule). The baseline
//! fraction `b` (thesis: b/B) says how far the synthesised view that the discriminator
//! judges lies from its source view. Photometric and consistency terms always use the
//! full baseline, because a real image exists only there; nothing here touches them.

use serde::{Deserialize, Serialize};

use crate::random::{Draws, Purpose};

/// How the baseline fraction of the adversarial term is chosen (thesis table 3.1).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Variant {
    /// Structured: grows linearly with the epoch, from `baseline_start` towards 1.
    Strat,
    /// Always the full baseline.
    Fixed,
    /// Uniform in [0, 1), drawn anew for each step, one value for the whole batch.
    Random,
    /// No adversarial term and no discriminator.
    NoAdv,
}

impl Variant {
    /// Whether a discriminator is trained at all.
    #[must_use]
    pub fn is_adversarial(self) -> bool {
        self != Self::NoAdv
    }

    /// The name used in configuration files and in the model's metadata.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Strat => "strat",
            Self::Fixed => "fixed",
            Self::Random => "random",
            Self::NoAdv => "no-adv",
        }
    }
}

/// How the learning rate falls.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Decay {
    /// Constant for the first half, then linear to zero at the end, updated per step.
    Linear,
    /// Halved after three fifths and again after four fifths (Godard et al.).
    Halve,
    /// Never changed.
    Constant,
}

/// Baseline fraction of the adversarial term in a 0-based epoch:
/// `start + (1 - start) * epoch / epochs`, so it starts at `start` and stays below 1.
#[must_use]
pub fn structured_baseline(epoch: u64, epochs: u64, start: f64) -> f64 {
    start + (1.0 - start) * epoch as f64 / epochs.max(1) as f64
}

/// Baseline fraction at a step. `epoch` and `step` are 0-based; `step` counts over the run.
#[must_use]
pub fn baseline_fraction(
    variant: Variant,
    start: f64,
    epoch: u64,
    epochs: u64,
    seed: u64,
    step: u64,
) -> f64 {
    match variant {
        Variant::Strat => structured_baseline(epoch, epochs, start),
        Variant::Fixed => 1.0,
        Variant::Random => f64::from(Draws::new(seed, Purpose::Baseline, step, 0).unit()),
        Variant::NoAdv => 0.0,
    }
}

/// Learning rate at a position in the run.
///
/// `position` is the number of epochs done, with its fraction (`step / steps_per_epoch`).
#[must_use]
pub fn learning_rate(base: f64, decay: Decay, position: f64, epochs: u64) -> f64 {
    let end = epochs.max(1) as f64;
    match decay {
        Decay::Linear => {
            let half = end / 2.0;
            if position < half {
                base
            } else {
                base * ((end - position) / half).max(0.0)
            }
        }
        Decay::Halve => {
            if position < end * 0.6 {
                base
            } else if position < end * 0.8 {
                base / 2.0
            } else {
                base / 4.0
            }
        }
        Decay::Constant => base,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    #[test]
    fn structured_baseline_equals_the_oracle() {
        // Recipe: make_golden.py train/schedule, `baseline`.
        for (epoch, expected) in [(0, 0.1), (1, 0.118), (25, 0.55), (49, 0.982)] {
            assert_relative_eq!(
                structured_baseline(epoch, 50, 0.1),
                expected,
                epsilon = 1e-15
            );
        }
        for (epoch, expected) in [(0, 0.2), (3, 0.4), (11, 0.933_333_333_333_333_3)] {
            assert_relative_eq!(
                structured_baseline(epoch, 12, 0.2),
                expected,
                epsilon = 1e-15
            );
        }
    }

    #[test]
    fn learning_rate_equals_the_oracle() {
        // Recipe: make_golden.py train/schedule, `learning_rate`.
        for (position, expected) in [
            (0.0, 1e-4),
            (24.99, 1e-4),
            (25.0, 1e-4),
            (37.5, 5e-5),
            (49.0, 4e-6),
            (49.5, 2e-6),
            (50.0, 0.0),
        ] {
            assert_relative_eq!(
                learning_rate(1e-4, Decay::Linear, position, 50),
                expected,
                epsilon = 1e-18
            );
        }
    }

    #[test]
    fn other_decays() {
        for (position, expected) in [(29.9, 1.0), (30.0, 0.5), (39.9, 0.5), (40.0, 0.25)] {
            assert_eq!(learning_rate(1.0, Decay::Halve, position, 50), expected);
        }
        assert_eq!(learning_rate(1.0, Decay::Constant, 50.0, 50), 1.0);
    }

    #[test]
    fn variants_choose_their_baseline() {
        let at = |variant, epoch, step| baseline_fraction(variant, 0.1, epoch, 50, 3, step);
        assert_eq!(at(Variant::Fixed, 0, 0), 1.0);
        assert_eq!(at(Variant::NoAdv, 10, 0), 0.0);
        assert_relative_eq!(at(Variant::Strat, 25, 9), 0.55);
        let drawn: Vec<f64> = (0..500).map(|step| at(Variant::Random, 0, step)).collect();
        assert!(drawn.iter().all(|b| (0.0..1.0).contains(b)));
        let mean = drawn.iter().sum::<f64>() / 500.0;
        assert!((mean - 0.5).abs() < 0.06, "mean {mean}");
        assert_eq!(drawn[7], at(Variant::Random, 40, 7));
    }
}
