//! How sure the difference of two variants is: seeds and drives as crossed random effects.
//!
//! The mean of a variant is one over its seeds and over images. It would be another with other seeds,
//! and another with other drives, so the variance of a difference has three parts: what seeds do on
//! all drives alike, what drives do to the difference on all seeds alike, and what a seed does on one
//! drive. The first is estimated from the spread of the seeds' means, of which the third is taken off;
//! the second and third together by the jackknife over drives of [`crate::statistics`], applied to the
//! means over seeds. The degrees of freedom of the sum are Satterthwaite's (PROTOCOL 11.1).
//!
//! Not here: which rows make a variant, and what its numbers mean.

use crate::interval::{degrees_of_freedom, jackknife, student_t};

/// Seeds and drives that are said to be not enough, when this many are not.
const MOST: u32 = 100_000;

/// One metric of one variant: for each of its seeds the sums over the images of each drive.
pub(super) struct Runs {
    /// `sums[seed][drive]`.
    pub(super) sums: Vec<Vec<f64>>,
    /// One model that is no seed of a variant: it has no spread between seeds.
    pub(super) fixed: bool,
}

/// Variances that add up to that of a difference, of each of both variants where there are two.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Parts {
    /// What seeds do on all drives alike.
    seeds: [f64; 2],
    /// What drives do to the difference on all seeds alike.
    drives: f64,
    /// What a seed does on one drive.
    both: [f64; 2],
}

/// A difference of two variants and what is known of its uncertainty.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Estimate {
    /// Second less first.
    pub(super) difference: f64,
    /// Its variance.
    pub(super) variance: f64,
    /// Degrees of freedom of the variance.
    pub(super) degrees: f64,
    parts: Parts,
    seeds: [Option<usize>; 2],
    drives: usize,
    drives_degrees: f64,
}

/// What it takes to see a difference; see [`super::Needed`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Sizes {
    pub(super) enough: bool,
    pub(super) seeds: Option<u32>,
    pub(super) drives: Option<u32>,
    pub(super) both: Option<(u32, u32)>,
}

/// Variances of the mean of one variant.
#[derive(Clone, Copy, Default)]
struct OfVariant {
    /// That of the mean over seeds, with what seeds do on single drives.
    seeds: f64,
    /// What of it seeds do on single drives.
    both: f64,
}

/// Estimates the difference of two variants over the same drives, of which `sizes` are the images:
/// at least two drives, and two seeds where a variant is not fixed.
pub(super) fn estimate(first: &Runs, second: &Runs, sizes: &[f64]) -> Estimate {
    let drives_degrees = degrees_of_freedom(sizes);
    let total: f64 = sizes.iter().sum();
    let means = [first, second].map(|runs| drive_means(&runs.sums));
    let clusters: Vec<(f64, f64)> = means[0]
        .iter()
        .zip(&means[1])
        .zip(sizes)
        .map(|((first, second), size)| (second - first, *size))
        .collect();
    let (difference, of_drives) = jackknife(&clusters);
    let of = |runs: &Runs, means: &[f64]| {
        if runs.fixed {
            OfVariant::default()
        } else {
            of_variant(&runs.sums, means, sizes, total)
        }
    };
    let sides = [of(first, &means[0]), of(second, &means[1])];
    let seeds = [first, second].map(|runs| (!runs.fixed).then_some(runs.sums.len()));
    let net = sides.map(|side| (side.seeds - side.both).max(0.0));
    let interaction: f64 = sides.iter().map(|side| side.both).sum();
    // The jackknife over drives holds the interaction, and cannot hold more than all of it.
    let share = if interaction > of_drives {
        of_drives / interaction
    } else {
        1.0
    };
    let both = sides.map(|side| side.both * share);
    Estimate {
        difference,
        variance: net.iter().sum::<f64>() + of_drives,
        degrees: satterthwaite(
            sides.map(|side| (side.seeds, side.both)),
            seeds.map(|seeds| seeds.map(|count| count as f64 - 1.0)),
            of_drives,
            drives_degrees,
        ),
        parts: Parts {
            seeds: net,
            drives: (of_drives - both[0] - both[1]).max(0.0),
            both,
        },
        seeds,
        drives: sizes.len(),
        drives_degrees,
    }
}

/// Mean over seeds of the sums of each drive.
fn drive_means(sums: &[Vec<f64>]) -> Vec<f64> {
    let count = sums.len() as f64;
    let drives = sums.first().map_or(0, Vec::len);
    (0..drives)
        .map(|drive| sums.iter().map(|seed| seed[drive]).sum::<f64>() / count)
        .collect()
}

fn of_variant(sums: &[Vec<f64>], means: &[f64], sizes: &[f64], total: f64) -> OfVariant {
    let count = sums.len() as f64;
    let mean = means.iter().sum::<f64>() / total;
    let squares: f64 = sums
        .iter()
        .map(|seed| (seed.iter().sum::<f64>() / total - mean).powi(2))
        .sum();
    // What a seed does on each drive beside the mean over seeds, drives left out in turn.
    let on_drives: f64 = sums
        .iter()
        .map(|seed| {
            let apart = seed.iter().zip(means).zip(sizes);
            let apart: Vec<(f64, f64)> = apart
                .map(|((sum, mean), size)| (sum - mean, *size))
                .collect();
            jackknife(&apart).1
        })
        .sum();
    OfVariant {
        seeds: squares / (count - 1.0) / count,
        both: on_drives / (count - 1.0) / count,
    }
}

/// Degrees of freedom of a sum of estimated variances: of what seeds do on all drives alike
/// (`sides`: the spread of their means, and what is taken off it), and of what drives do. At least the
/// fewest of a part.
fn satterthwaite(
    sides: [(f64, f64); 2],
    seeds_degrees: [Option<f64>; 2],
    of_drives: f64,
    drives_degrees: f64,
) -> f64 {
    let (mut variance, mut fourth) = (of_drives, of_drives * of_drives / drives_degrees);
    let mut fewest = drives_degrees;
    for ((spread, taken_off), degrees) in sides.into_iter().zip(seeds_degrees) {
        let Some(degrees) = degrees else { continue };
        fewest = fewest.min(degrees);
        if spread > taken_off {
            variance += spread - taken_off;
            fourth +=
                spread * spread / degrees + taken_off * taken_off / (degrees * drives_degrees);
        }
    }
    if fourth > 0.0 {
        (variance * variance / fourth).max(fewest)
    } else {
        fewest
    }
}

impl Estimate {
    /// The part of the variance that comes from the choice of seeds alone.
    pub(super) fn of_seeds(&self) -> f64 {
        self.parts.seeds.iter().sum()
    }

    /// The part that comes from the choice of drives alone.
    pub(super) fn of_drives(&self) -> f64 {
        self.parts.drives
    }

    /// Half the width of the 95 % interval.
    pub(super) fn half_width(&self) -> f64 {
        student_t(self.degrees, 0.05) * self.variance.sqrt()
    }

    /// How many seeds of each variant and how many drives it takes to find a difference of `effect`
    /// with a probability of 0.8, at the spread seen.
    pub(super) fn sizes_for(&self, effect: f64) -> Sizes {
        // Of two variants of unequal numbers of seeds the smaller one limits.
        let seeds = self.seeds.iter().flatten().min().copied();
        let (seeds_now, drives_now) = (seeds.unwrap_or(2) as u32, self.drives as u32);
        let finds = |seeds: f64, drives: f64| {
            let (variance, degrees) = self.at(seeds, drives);
            let t = student_t(degrees, 0.05) + student_t(degrees, 0.4);
            t * variance.sqrt() <= effect
        };
        let enough = {
            let t = student_t(self.degrees, 0.05) + student_t(self.degrees, 0.4);
            t * self.variance.sqrt() <= effect
        };
        let has_seeds = seeds.is_some();
        let of_seeds = has_seeds
            .then(|| smallest(2, |seeds| finds(f64::from(seeds), self.drives as f64)))
            .flatten();
        let of_drives = smallest(3, |drives| finds(f64::from(seeds_now), f64::from(drives)));
        let together = |seeds: u32| {
            let drives = f64::from(seeds) * f64::from(drives_now) / f64::from(seeds_now);
            drives.ceil().max(3.0)
        };
        let both = (has_seeds && of_seeds.is_none() && of_drives.is_none())
            .then(|| smallest(2, |seeds| finds(f64::from(seeds), together(seeds))))
            .flatten();
        Sizes {
            enough,
            seeds: of_seeds,
            drives: of_drives,
            both: both.map(|seeds| (seeds, together(seeds) as u32)),
        }
    }

    /// Variance and degrees of freedom with other numbers of seeds of each variant and of drives like
    /// these.
    fn at(&self, seeds: f64, drives: f64) -> (f64, f64) {
        let per_drive = self.drives as f64 / drives;
        let mut sides = [(0.0, 0.0); 2];
        for (side, index) in sides.iter_mut().zip(0..) {
            let per_seed = self.seeds[index].map_or(0.0, |count| count as f64 / seeds);
            let both = self.parts.both[index] * per_seed * per_drive;
            *side = (self.parts.seeds[index] * per_seed + both, both);
        }
        let of_drives = self.parts.drives * per_drive + sides[0].1 + sides[1].1;
        let net: f64 = sides.iter().map(|(spread, both)| spread - both).sum();
        let degrees = satterthwaite(
            sides,
            self.seeds.map(|count| count.map(|_| seeds - 1.0)),
            of_drives,
            // At least 1, as Student's t needs them.
            (self.drives_degrees * (drives - 1.0) / (self.drives as f64 - 1.0)).max(1.0),
        );
        (net + of_drives, degrees)
    }
}

/// The smallest number from `least` on that is enough, if one up to [`MOST`] is; what is enough stays so
/// for larger ones.
fn smallest(least: u32, is_enough: impl Fn(u32) -> bool) -> Option<u32> {
    let (mut low, mut high) = (least, least);
    while !is_enough(high) {
        low = high + 1;
        high = high.saturating_mul(2);
        if high > MOST {
            return None;
        }
    }
    while low < high {
        let middle = low + (high - low) / 2;
        if is_enough(middle) {
            high = middle;
        } else {
            low = middle + 1;
        }
    }
    Some(high)
}
