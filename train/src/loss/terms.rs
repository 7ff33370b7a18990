//! The terms of the stereo objective, their weights and their values.

use burn::tensor::{Device, Tensor};

use crate::network::generator::SCALES;

/// A term of the stereo objective; each is taken for both views, at every scale.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Term {
    /// Mean of clip((1 - SSIM) / 2, 0, 1).
    Ssim,
    /// Mean absolute colour difference.
    L1,
    /// Mean absolute difference of the two views' disparities.
    LeftRight,
    /// Edge-aware horizontal smoothness; halved at every coarser scale.
    Smoothness,
}

impl Term {
    /// Number of terms.
    pub const COUNT: usize = 4;

    /// All terms in the order of the columns of a run's table.
    pub const ALL: [Self; Self::COUNT] = [Self::Ssim, Self::L1, Self::LeftRight, Self::Smoothness];

    /// Its key among the weights.
    #[must_use]
    pub const fn key(self) -> &'static str {
        match self {
            Self::Ssim => "ssim",
            Self::L1 => "l1",
            Self::LeftRight => "left_right",
            Self::Smoothness => "smoothness",
        }
    }

    /// Columns of the left and the right view's value.
    #[must_use]
    pub const fn columns(self) -> [&'static str; 2] {
        match self {
            Self::Ssim => ["ssim_left", "ssim_right"],
            Self::L1 => ["l1_left", "l1_right"],
            Self::LeftRight => ["left_right_left", "left_right_right"],
            Self::Smoothness => ["smoothness_left", "smoothness_right"],
        }
    }

    /// What the term counts at a level, beside level 0.
    pub(super) fn share(self, level: usize) -> f64 {
        match self {
            Self::Smoothness => 1.0 / f64::from(1_u32 << level),
            Self::Ssim | Self::L1 | Self::LeftRight => 1.0,
        }
    }
}

/// Weights of the terms; a term of weight 0 is not computed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Weights {
    /// Structural dissimilarity, at every scale.
    pub ssim: f64,
    /// Absolute colour difference, at every scale.
    pub l1: f64,
    /// Left-right consistency of the disparities, at every scale.
    pub left_right: f64,
    /// Horizontal smoothness of the disparities; halved at every coarser scale.
    pub smoothness: f64,
    /// Adversarial term of the generator, at full size.
    pub adversarial: f64,
}

impl Weights {
    /// Weight of a stereo term.
    #[must_use]
    pub const fn of(&self, term: Term) -> f64 {
        match term {
            Term::Ssim => self.ssim,
            Term::L1 => self.l1,
            Term::LeftRight => self.left_right,
            Term::Smoothness => self.smoothness,
        }
    }

    /// These with only one of the stereo terms, and no adversarial one.
    #[must_use]
    pub fn only(&self, term: Term) -> Self {
        let kept = |other: Term| if other == term { self.of(other) } else { 0.0 };
        Self {
            ssim: kept(Term::Ssim),
            l1: kept(Term::L1),
            left_right: kept(Term::LeftRight),
            smoothness: kept(Term::Smoothness),
            adversarial: 0.0,
        }
    }

    /// The thesis: no smoothness.
    pub const STRAT: Self = Self {
        ssim: 1.0,
        l1: 0.1,
        left_right: 1.0,
        smoothness: 0.0,
        adversarial: 0.01,
    };

    /// The thesis without a discriminator.
    pub const PHOTOMETRIC: Self = Self {
        adversarial: 0.0,
        ..Self::STRAT
    };

    /// The monodepth baseline, with the horizontal smoothness term its released code has in effect.
    pub const MONODEPTH: Self = Self {
        ssim: 0.85,
        l1: 0.15,
        left_right: 1.0,
        smoothness: 0.1,
        adversarial: 0.0,
    };
}

impl Default for Weights {
    fn default() -> Self {
        Self::STRAT
    }
}

/// Terms of one view at one scale, unweighted, each `[1]`, by [`Term`]. A term of weight 0 is absent.
pub type SideTerms = [Option<Tensor<1>>; Term::COUNT];

/// All stereo terms of a batch.
#[derive(Clone, Debug)]
pub struct Terms {
    /// Weighted sum of all terms, `[1]`: what is minimised, without the adversarial term.
    pub total: Tensor<1>,
    /// Left and right view of every level, level 0 (full size) first.
    pub levels: [[SideTerms; 2]; SCALES],
}

impl Terms {
    /// Weighs and adds the terms of all levels.
    pub(super) fn new(
        levels: [[SideTerms; 2]; SCALES],
        weights: &Weights,
        device: &Device,
    ) -> Self {
        let mut total: Option<Tensor<1>> = None;
        for (level, sides) in levels.iter().enumerate() {
            for side in sides {
                for (term, value) in Term::ALL.into_iter().zip(side) {
                    let Some(value) = value else { continue };
                    let weighted = value.clone() * (weights.of(term) * term.share(level));
                    total = Some(match total.take() {
                        Some(sum) => sum + weighted,
                        None => weighted,
                    });
                }
            }
        }
        let total = total.unwrap_or_else(|| Tensor::zeros([1], device));
        Self { total, levels }
    }

    /// Reads all terms from the device.
    pub fn values(&self) -> TermValues {
        let sum = |term: Term, view: usize| {
            let levels = self.levels.iter().enumerate();
            levels
                .filter_map(|(level, sides)| {
                    let value = sides[view][term as usize].as_ref()?;
                    Some(scalar(value) * term.share(level))
                })
                .sum()
        };
        TermValues {
            total: scalar(&self.total),
            by_view: Term::ALL.map(|term| [sum(term, 0), sum(term, 1)]),
        }
    }
}

/// The terms as numbers for logs: unweighted, summed over scales, both views apart.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TermValues {
    /// Weighted sum, without the adversarial term.
    pub total: f64,
    /// Left and right value of each [`Term`]; smoothness is divided by 2^s at scale s.
    pub by_view: [[f64; 2]; Term::COUNT],
}

impl TermValues {
    /// The values with the names of their columns, without the total.
    pub fn columns(&self) -> impl Iterator<Item = (&'static str, f64)> {
        let terms = Term::ALL.into_iter().zip(self.by_view);
        terms.flat_map(|(term, values)| term.columns().into_iter().zip(values))
    }

    /// Sum of a term over both views.
    #[must_use]
    pub fn both(&self, term: Term) -> f64 {
        self.by_view[term as usize].iter().sum()
    }

    /// Adds `share` times other values.
    pub fn add(&mut self, other: &Self, share: f64) {
        self.total += share * other.total;
        let values = self.by_view.as_flattened_mut().iter_mut();
        for (sum, value) in values.zip(other.by_view.as_flattened()) {
            *sum += share * value;
        }
    }
}

/// The number in a tensor of one element.
pub fn scalar(tensor: &Tensor<1>) -> f64 {
    tensor
        .clone()
        .into_data()
        .iter::<f64>()
        .next()
        .unwrap_or(f64::NAN)
}
