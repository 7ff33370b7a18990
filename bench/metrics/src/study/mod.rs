//! Variants trained with several seeds: means, spread between seeds, and differences whose intervals
//! hold the choice of seeds and the choice of drives (PROTOCOL 11.1).
//!
//! A model called `VARIANT@SEED` is one seed of a variant. Every other name is a model by itself,
//! whose numbers are taken as they are: a constant map has no seeds.
//!
//! Seeds of two variants are taken as independent, also where they have the same number: a seed
//! decides initial weights and the order of images, of which little is left after training. If equal
//! seeds did make runs alike, the intervals would be too wide, not too narrow.
//!
//! [`crate::compare`] asks the narrower question whether two given models differ.

mod variance;

#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet};

use strat_splits::{Recording, recording};

use self::variance::{Runs, estimate};
use crate::compare::holm;
use crate::interval::{check, two_sided_tail};
use crate::metrics::Metric;
use crate::protocol::Group;
use crate::rows::{ModelRows, Row, RowsError, by_model};
use crate::statistics::{Clusters, Interval, NoInterval, mean};

/// Differences are called by this level after Holm.
pub const LEVEL: f64 = 0.05;

/// What a study says under one protocol.
#[derive(Clone, Debug, PartialEq)]
pub struct Study {
    /// Name of the protocol.
    pub protocol: String,
    /// The difference that [`Needed`] is about, in the metric's unit.
    pub effect: f64,
    /// One part, or one for each group of pixels where the protocol has groups.
    pub parts: Vec<Part>,
}

/// A study over the pixels of one group, or over all.
#[derive(Clone, Debug, PartialEq)]
pub struct Part {
    /// The group.
    pub group: Option<Group>,
    /// Images that all models were scored on; nothing else is counted.
    pub images: u64,
    /// Models without some images that others have, and how many.
    pub lacking: Vec<(String, u64)>,
    /// What the images were recorded in.
    pub clusters: Clusters,
    /// The variants in the order of their first row.
    pub variants: Vec<Variant>,
    /// All pairs of variants, the earlier one first, in the order of [`Metric::ALL`] for each.
    pub differences: Vec<Difference>,
}

/// A variant over its seeds.
#[derive(Clone, Debug, PartialEq)]
pub struct Variant {
    /// Its name.
    pub name: String,
    /// Its seeds in ascending order; none for a model by itself.
    pub seeds: Vec<String>,
    /// Means over images for each seed, in the order of [`Metric::ALL`].
    pub by_seed: Vec<[f64; 7]>,
    /// Means over seeds.
    pub mean: [f64; 7],
    /// Sample standard deviations between seeds; `None` with fewer than two.
    pub deviation: Option<[f64; 7]>,
}

/// One metric of two variants.
#[derive(Clone, Debug, PartialEq)]
pub struct Difference {
    /// The metric.
    pub metric: Metric,
    /// Name of the first variant.
    pub first: String,
    /// Name of the second variant.
    pub second: String,
    /// Means of both.
    pub means: [f64; 2],
    /// Seeds of both.
    pub seeds: [usize; 2],
    /// Mean of the second less that of the first.
    pub difference: f64,
    /// How sure it is, or why that is not known.
    pub certainty: Result<Certainty, Unknown>,
}

/// How sure a difference is.
#[derive(Clone, Debug, PartialEq)]
pub struct Certainty {
    /// 95 % interval over seeds and drives.
    pub interval: Interval,
    /// Standard error.
    pub error: f64,
    /// Share of the squared standard error that only more seeds would lessen.
    pub of_seeds: f64,
    /// Share that only more drives would lessen; what is left, both would.
    pub of_drives: f64,
    /// Degrees of freedom.
    pub degrees: f64,
    /// Two-sided p.
    pub p: f64,
    /// p after Holm over the family.
    pub p_holm: f64,
    /// Tests in the family: all pairs of variants in this metric under one protocol, over all groups.
    /// Pairs with a model by itself are a family of their own.
    pub family: usize,
    /// What it takes to find the study's effect.
    pub needed: Needed,
}

/// How many seeds and drives find a difference of a given size with a probability of 0.8 at 0.05, at
/// the spread seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Needed {
    /// What is there finds it already.
    pub enough: bool,
    /// Seeds of each variant on these drives; `None` if no number of seeds would do.
    pub seeds: Option<u32>,
    /// Drives with these seeds; `None` if no number of drives would do.
    pub drives: Option<u32>,
    /// Seeds and drives where neither alone does, both grown by one factor.
    pub both: Option<(u32, u32)>,
}

/// Why the certainty of a difference is not known.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Unknown {
    /// One seed shows no spread.
    #[error("the spread between seeds takes at least 2 seeds of each variant")]
    Seeds,
    /// Too few or too unequal drives.
    #[error("over the drives, {0}")]
    Drives(NoInterval),
}

/// What a difference says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// The second variant is better than the first.
    Better,
    /// The second variant is worse than the first.
    Worse,
    /// The two are not told apart.
    Open,
}

impl Difference {
    /// Better, worse or not told apart, at [`LEVEL`] after Holm.
    #[must_use]
    pub fn verdict(&self) -> Verdict {
        match &self.certainty {
            Ok(certainty) if certainty.p_holm < LEVEL => {
                if (self.difference < 0.0) == self.metric.lower_is_better() {
                    Verdict::Better
                } else {
                    Verdict::Worse
                }
            }
            _ => Verdict::Open,
        }
    }

    fn has_model_by_itself(&self) -> bool {
        self.seeds.contains(&0)
    }
}

/// Why there is no study.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum StudyError {
    /// Rows that do not belong together.
    #[error(transparent)]
    Rows(#[from] RowsError),
    /// Two data sets, or two definitions of one protocol.
    #[error(
        "models {first} and {second} were measured under {protocol} with different {what}, so their \
         difference says nothing about the variants; measure both on the same set with the same version"
    )]
    Different {
        /// A model.
        first: String,
        /// Another model.
        second: String,
        /// Name of the protocol.
        protocol: String,
        /// Which digest differs.
        what: &'static str,
    },
    /// Seeds that are copies.
    #[error(
        "models {first} and {second} are the same file; a seed that is counted twice makes the spread \
         between seeds too small"
    )]
    Same {
        /// A seed.
        first: String,
        /// Another seed of the same variant.
        second: String,
    },
    /// Models without a common image.
    #[error(
        "the models have no image in common under {protocol}; the rows of {least} are the fewest"
    )]
    NothingInCommon {
        /// Name of the protocol.
        protocol: String,
        /// The model with the fewest images.
        least: String,
    },
}

/// Means, spread and differences of all variants among the rows under a protocol, and what it would take to
/// find a difference of `effect` (in the metric's unit). `None` where no row is under the protocol.
///
/// # Errors
/// Rows that do not belong together; see [`StudyError`].
pub fn study(rows: &[Row], protocol: &str, effect: f64) -> Result<Option<Study>, StudyError> {
    let models = by_model(rows, protocol)?;
    let Some(first) = models.first() else {
        return Ok(None);
    };
    let first = first.context();
    for other in models.iter().map(ModelRows::context) {
        let what = if other.data_digest != first.data_digest {
            "digests of the data"
        } else if other.protocol_digest != first.protocol_digest {
            "digests of the protocol"
        } else {
            continue;
        };
        return Err(StudyError::Different {
            first: first.model.clone(),
            second: other.model.clone(),
            protocol: protocol.to_owned(),
            what,
        });
    }
    let variants = variants_of(&models)?;
    let mut study = Study {
        protocol: protocol.to_owned(),
        effect,
        parts: Vec::new(),
    };
    for group in std::iter::once(None).chain(Group::all().map(Some)) {
        if models.iter().any(|model| !model.of_group(group).is_empty()) {
            study.parts.push(part(&variants, group, effect)?);
        }
    }
    study.correct();
    Ok(Some(study))
}

/// A variant and its models, in ascending order of their seeds.
struct Models<'a> {
    name: &'a str,
    fixed: bool,
    seeds: Vec<(&'a str, &'a ModelRows<'a>)>,
}

fn variants_of<'a>(models: &'a [ModelRows<'a>]) -> Result<Vec<Models<'a>>, StudyError> {
    let mut variants: Vec<Models<'a>> = Vec::new();
    for model in models {
        let context = model.context();
        let (name, seed) = context.seed().unwrap_or((&context.model, ""));
        let fixed = seed.is_empty();
        let known = variants
            .iter_mut()
            .find(|known| (known.name, known.fixed) == (name, fixed));
        match known {
            Some(variant) => variant.seeds.push((seed, model)),
            None => variants.push(Models {
                name,
                fixed,
                seeds: vec![(seed, model)],
            }),
        }
    }
    for variant in &mut variants {
        variant
            .seeds
            .sort_by_key(|(seed, _)| (seed.parse::<u64>().unwrap_or(u64::MAX), *seed));
        let mut files: BTreeMap<&str, &str> = BTreeMap::new();
        for context in variant.seeds.iter().map(|(_, model)| model.context()) {
            if context.model_hash.is_empty() {
                continue;
            }
            if let Some(first) = files.insert(&context.model_hash, &context.model) {
                return Err(StudyError::Same {
                    first: first.to_owned(),
                    second: context.model.clone(),
                });
            }
        }
    }
    Ok(variants)
}

/// Rows of one model in one group by image.
type ByImage<'a> = BTreeMap<&'a str, [f64; 7]>;

fn by_image<'a>(model: &ModelRows<'a>, group: Option<Group>) -> ByImage<'a> {
    let rows = model.of_group(group).into_iter();
    rows.map(|row| (row.image.as_str(), row.score.metrics.to_array()))
        .collect()
}

fn part(variants: &[Models<'_>], group: Option<Group>, effect: f64) -> Result<Part, StudyError> {
    let maps: Vec<Vec<ByImage<'_>>> = variants
        .iter()
        .map(|variant| {
            let seeds = variant.seeds.iter();
            seeds.map(|(_, model)| by_image(model, group)).collect()
        })
        .collect();
    let all: BTreeSet<&str> = maps
        .iter()
        .flatten()
        .flat_map(|map| map.keys().copied())
        .collect();
    let common: Vec<&str> = all
        .iter()
        .copied()
        .filter(|image| maps.iter().flatten().all(|map| map.contains_key(image)))
        .collect();
    let names = || {
        let models = variants.iter().flat_map(|variant| &variant.seeds);
        models.map(|(_, model)| model.context())
    };
    let lacking: Vec<(String, u64)> = names()
        .zip(maps.iter().flatten())
        .map(|(context, map)| (context.model.clone(), (all.len() - map.len()) as u64))
        .filter(|(_, lacks)| *lacks > 0)
        .collect();
    if common.is_empty() {
        let least = lacking.iter().max_by_key(|(_, lacks)| *lacks);
        return Err(StudyError::NothingInCommon {
            protocol: names().next().map_or(String::new(), |c| c.protocol.clone()),
            least: least.map_or(String::new(), |(name, _)| name.clone()),
        });
    }
    let mut sizes: BTreeMap<Recording<'_>, f64> = BTreeMap::new();
    for image in &common {
        *sizes.entry(recording(image)).or_default() += 1.0;
    }
    let clusters = Clusters::count(sizes.keys().copied());
    let order: BTreeMap<Recording<'_>, usize> = sizes.keys().copied().zip(0..).collect();
    let sizes: Vec<f64> = sizes.into_values().collect();

    let described = variants
        .iter()
        .zip(&maps)
        .map(|(models, maps)| described(models, maps, &common))
        .collect();
    let mut part = Part {
        group,
        images: common.len() as u64,
        lacking,
        clusters,
        variants: described,
        differences: Vec::new(),
    };
    let runs = |variant: usize, metric: Metric| Runs {
        sums: maps[variant]
            .iter()
            .map(|map| {
                let mut sums = vec![0.0; sizes.len()];
                for image in &common {
                    sums[order[&recording(image)]] += map[image][metric as usize];
                }
                sums
            })
            .collect(),
        fixed: variants[variant].fixed,
    };
    for first in 0..variants.len() {
        for second in first + 1..variants.len() {
            for metric in Metric::ALL {
                let [a, b] = [first, second].map(|index| runs(index, metric));
                let difference = part.difference(metric, [first, second], [&a, &b], &sizes, effect);
                part.differences.push(difference);
            }
        }
    }
    Ok(part)
}

/// Means of a variant over the common images.
fn described(models: &Models<'_>, maps: &[ByImage<'_>], common: &[&str]) -> Variant {
    let by_seed: Vec<[f64; 7]> = maps
        .iter()
        .filter_map(|map| mean(common.iter().map(|image| (*image, map[image]))))
        .collect();
    let count = by_seed.len() as f64;
    let mean: [f64; 7] =
        std::array::from_fn(|index| by_seed.iter().map(|seed| seed[index]).sum::<f64>() / count);
    let deviation = (by_seed.len() > 1).then(|| {
        std::array::from_fn(|index| {
            let squares: f64 = by_seed
                .iter()
                .map(|v| (v[index] - mean[index]).powi(2))
                .sum();
            (squares / (count - 1.0)).sqrt()
        })
    });
    let seeds = models.seeds.iter().map(|(seed, _)| (*seed).to_owned());
    Variant {
        name: models.name.to_owned(),
        seeds: seeds.filter(|seed| !seed.is_empty()).collect(),
        by_seed,
        mean,
        deviation,
    }
}

impl Part {
    fn difference(
        &self,
        metric: Metric,
        pair: [usize; 2],
        runs: [&Runs; 2],
        sizes: &[f64],
        effect: f64,
    ) -> Difference {
        let [first, second] = pair.map(|index| &self.variants[index]);
        let means = [first, second].map(|variant| variant.mean[metric as usize]);
        let enough_seeds = runs.iter().all(|runs| runs.fixed || runs.sums.len() > 1);
        let certainty = match check(sizes) {
            Err(reason) => Err(Unknown::Drives(reason)),
            Ok(()) if !enough_seeds => Err(Unknown::Seeds),
            Ok(()) => Ok(certainty(runs, sizes, effect)),
        };
        Difference {
            metric,
            first: first.name.clone(),
            second: second.name.clone(),
            means,
            seeds: [first, second].map(|variant| variant.seeds.len()),
            difference: means[1] - means[0],
            certainty,
        }
    }
}

fn certainty([first, second]: [&Runs; 2], sizes: &[f64], effect: f64) -> Certainty {
    let found = estimate(first, second, sizes);
    let half_width = found.half_width();
    let error = found.variance.sqrt();
    // Runs without any spread differ for certain, or not at all.
    let p = match (found.difference == 0.0, error == 0.0) {
        (true, _) => 1.0,
        (false, true) => 0.0,
        (false, false) => two_sided_tail(found.difference.abs() / error, found.degrees),
    };
    let share = |part: f64| {
        if error == 0.0 {
            0.0
        } else {
            part / found.variance
        }
    };
    let sizes = found.sizes_for(effect);
    Certainty {
        interval: Interval {
            low: found.difference - half_width,
            high: found.difference + half_width,
        },
        error,
        of_seeds: share(found.of_seeds()),
        of_drives: share(found.of_drives()),
        degrees: found.degrees,
        p,
        p_holm: p,
        family: 1,
        needed: Needed {
            enough: sizes.enough,
            seeds: sizes.seeds,
            drives: sizes.drives,
            both: sizes.both,
        },
    }
}

impl Study {
    /// Corrects p over all pairs and groups, metric by metric.
    fn correct(&mut self) {
        for metric in Metric::ALL {
            for by_itself in [false, true] {
                let differences = self.parts.iter_mut().flat_map(|part| &mut part.differences);
                let mut members: Vec<&mut Certainty> = differences
                    .filter(|one| one.metric == metric && one.has_model_by_itself() == by_itself)
                    .filter_map(|one| one.certainty.as_mut().ok())
                    .collect();
                let p: Vec<f64> = members.iter().map(|one| one.p).collect();
                for (one, adjusted) in members.iter_mut().zip(holm(&p)) {
                    one.p_holm = adjusted;
                    one.family = p.len();
                }
            }
        }
    }
}
