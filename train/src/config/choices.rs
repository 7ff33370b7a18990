//! The choices between named alternatives: objective, variant, decay, discriminators.

use serde::{Deserialize, Serialize};

use crate::loss::Weights;

/// Which objective is minimised.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Objective {
    /// The thesis: SSIM, L1 and left-right consistency, adversarial term by variant.
    Strat,
    /// The monodepth baseline: other weights and a smoothness term.
    Monodepth,
}

impl Objective {
    /// Weights of this objective.
    #[must_use]
    pub fn weights(self) -> Weights {
        match self {
            Self::Strat => Weights::STRAT,
            Self::Monodepth => Weights::MONODEPTH,
        }
    }
}

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

/// Which discriminator sees which view (PROTOCOL 4.5; the thesis does not say).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Sharing {
    /// One discriminator sees both views.
    #[default]
    Shared,
    /// Each view has a discriminator of its own.
    PerView,
}
