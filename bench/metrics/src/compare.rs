//! Tests of the difference between two models over the images that both were scored on.
//!
//! For each metric: the mean difference with its interval ([`Interval`]), the p value of a sign-flip
//! permutation test that flips whole [recordings](strat_splits::recording()) (the unit that is
//! independent; exact for up to 16, drawn otherwise), beside it Wilcoxon's signed-rank test over the
//! mean differences of the recordings, and the permutation's p corrected after Holm (1979) for the
//! tests of its family: the errors, or the accuracies, under one protocol.
//!
//! With k recordings p cannot fall below 2^(1 - k); what that means after Holm stands beside it.
//!
//! A small p says that the choice of test drives does not explain the difference. It does not
//! speak of the spread between training runs: for that, train several seeds.

use std::collections::{BTreeMap, BTreeSet};

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use strat_splits::{Recording, recording};

use crate::interval::{Range, check, ratio_interval};
use crate::metrics::{FurtherMetric, Metric};
use crate::protocol::Group;
use crate::rows::{ModelRows, Row};
use crate::statistics::{Clusters, Interval, NoInterval, mean};

/// Up to this many clusters all 2^n sign patterns are counted.
pub const EXACT_UP_TO: usize = 16;

/// Up to this many differences, without ties, Wilcoxon's distribution is counted.
const WILCOXON_EXACT_UP_TO: usize = 50;

/// How p values are drawn. The default is 10 000 sign patterns with seed 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TestOptions {
    /// Sign patterns that are drawn where there are too many to count.
    pub permutations: u32,
    /// Seed of the generator of patterns.
    pub seed: u64,
}

impl Default for TestOptions {
    fn default() -> Self {
        Self {
            permutations: 10_000,
            seed: 0,
        }
    }
}

impl TestOptions {
    /// The key of the ChaCha8 stream that patterns are drawn from, for programs that draw the same ones
    /// elsewhere. Patterns follow each other from the start of the stream; each is as many little-endian
    /// words of 64 bits as its signs need.
    #[must_use]
    pub fn key(&self) -> [u8; 32] {
        self.random().get_seed()
    }

    /// The generator of patterns.
    pub(crate) fn random(&self) -> ChaCha8Rng {
        ChaCha8Rng::seed_from_u64(self.seed)
    }
}

/// One metric of one pair of models under one protocol.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PairedTest {
    /// Name of the protocol.
    pub protocol: String,
    /// Group of pixels, for protocols with groups.
    pub group: Option<Group>,
    /// First model.
    pub model_a: String,
    /// Second model.
    pub model_b: String,
    /// Column name of the metric.
    pub metric: &'static str,
    /// True for errors, false for accuracies.
    pub lower_is_better: bool,
    /// Images that both models have.
    pub images: u64,
    /// Images that one of the two has and the other lacks; they count for nothing.
    pub unpaired_images: u64,
    /// Recordings: drives, runs of scenes of unknown drive, or images that say nothing of a drive.
    pub clusters: u64,
    /// The same by kind.
    pub recordings: Clusters,
    /// Mean of the first model over the common images.
    pub mean_a: f64,
    /// Mean of the second model over the common images.
    pub mean_b: f64,
    /// Mean of second minus first.
    pub difference: f64,
    /// 95 % interval of the difference.
    pub interval: Option<Interval>,
    /// Why there is none.
    pub no_interval: Option<NoInterval>,
    /// Two-sided p of the sign-flip test; `None` with fewer than two clusters.
    pub p_permutation: Option<f64>,
    /// The permutation's p was counted and not drawn.
    pub exact: bool,
    /// Two-sided p of Wilcoxon's test over the clusters' mean differences; `None` where all of
    /// them are zero or there are fewer than two clusters.
    pub p_wilcoxon: Option<f64>,
    /// `p_permutation` after Holm, within the family.
    pub p_holm: Option<f64>,
    /// Tests in the family: those of one call under the same protocol that are all about errors, or
    /// all about accuracies.
    pub family: usize,
    /// The smallest p that differences of this many recordings (and this many drawn patterns) can
    /// have.
    pub smallest_p: Option<f64>,
}

impl PairedTest {
    /// The smallest p after Holm that this test can have in its family.
    #[must_use]
    pub fn smallest_p_holm(&self) -> Option<f64> {
        self.smallest_p.map(|p| (p * self.family as f64).min(1.0))
    }

    fn family(&self) -> (String, bool) {
        (self.protocol.clone(), self.lower_is_better)
    }
}

/// Why models cannot be compared.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum CompareError {
    /// Two definitions of one protocol, or two data sets.
    #[error(
        "models {models} were measured under {protocol} with different {what} \
         ({values}), so their difference says nothing about the models; \
         measure both on the same set with the same version"
    )]
    Different {
        /// Both models.
        models: String,
        /// Name of the protocol.
        protocol: String,
        /// Which digest differs.
        what: &'static str,
        /// The digests in the models' rows.
        values: String,
    },
    /// The further metrics were not measured.
    #[error(
        "models {first} and {second} have no image under {protocol} that both have the further metrics of \
         (columns silog to sq_rel_2); measure them again with `--metrics`"
    )]
    NotMeasured {
        /// A model.
        first: String,
        /// Another model.
        second: String,
        /// Name of the protocol.
        protocol: String,
    },
    /// Two models without a common image.
    #[error("models {first} and {second} have no image in common under {protocol}")]
    NothingInCommon {
        /// A model.
        first: String,
        /// Another model.
        second: String,
        /// Name of the protocol.
        protocol: String,
    },
}

/// Tests the given pairs of models, all groups and the seven metrics, with `further` also those of
/// PROTOCOL 10.3 where both models have them. Tests of one call under one protocol are corrected
/// together, errors and accuracies apart, so give all pairs at once.
///
/// # Errors
/// A pair of different protocols, data sets or images, and further metrics that a model lacks.
pub fn compare(
    pairs: &[(&ModelRows<'_>, &ModelRows<'_>)],
    further: bool,
    options: &TestOptions,
) -> Result<Vec<PairedTest>, CompareError> {
    let mut tests = Vec::new();
    for (a, b) in pairs {
        tests.extend(one_pair(a, b, further, options)?);
    }
    let families: BTreeSet<(String, bool)> = tests.iter().map(PairedTest::family).collect();
    for family in families {
        let mut members: Vec<&mut PairedTest> = tests
            .iter_mut()
            .filter(|test| test.p_permutation.is_some() && test.family() == family)
            .collect();
        let p: Vec<f64> = members
            .iter()
            .filter_map(|test| test.p_permutation)
            .collect();
        for (test, adjusted) in members.iter_mut().zip(holm(&p)) {
            test.p_holm = Some(adjusted);
            test.family = p.len();
        }
    }
    Ok(tests)
}

fn one_pair(
    a: &ModelRows<'_>,
    b: &ModelRows<'_>,
    further: bool,
    options: &TestOptions,
) -> Result<Vec<PairedTest>, CompareError> {
    let (first, second) = (a.context(), b.context());
    for (what, x, y) in [
        (
            "digests of the protocol",
            &first.protocol_digest,
            &second.protocol_digest,
        ),
        (
            "digests of the data",
            &first.data_digest,
            &second.data_digest,
        ),
    ] {
        if x != y {
            return Err(CompareError::Different {
                models: format!("{} and {}", first.model, second.model),
                protocol: first.protocol.clone(),
                what,
                values: format!("{x:.12} and {y:.12}"),
            });
        }
    }
    let mut tests = Vec::new();
    for group in std::iter::once(None).chain(Group::all().map(Some)) {
        let seven = Metric::ALL.map(|metric| (metric.name(), metric.lower_is_better()));
        let seven = (seven, |row: &Row| Some(row.score.metrics.to_array()));
        tests.extend(of_group(a, b, group, seven, options));
        if further {
            let more = FurtherMetric::ALL.map(|metric| (metric.name(), true));
            let more = (more, |row: &Row| Some(row.score.further?.to_array()));
            tests.extend(of_group(a, b, group, more, options));
        }
    }
    if tests.is_empty() {
        return Err(CompareError::NothingInCommon {
            first: first.model.clone(),
            second: second.model.clone(),
            protocol: first.protocol.clone(),
        });
    }
    let is_further = |test: &PairedTest| {
        let mut names = FurtherMetric::ALL.iter().map(|metric| metric.name());
        names.any(|name| name == test.metric)
    };
    if further && !tests.iter().any(is_further) {
        return Err(CompareError::NotMeasured {
            first: first.model.clone(),
            second: second.model.clone(),
            protocol: first.protocol.clone(),
        });
    }
    Ok(tests)
}

/// Tests of some metrics, given by name and whether lower is better with their values in a row, over the
/// images of a group that have them in both models; none where there is no such image.
fn of_group<const N: usize>(
    a: &ModelRows<'_>,
    b: &ModelRows<'_>,
    group: Option<Group>,
    (metrics, values): ([(&'static str, bool); N], impl Fn(&Row) -> Option<[f64; N]>),
    options: &TestOptions,
) -> Vec<PairedTest> {
    let (first, second) = (a.context(), b.context());
    let (of_a, of_b) = (a.of_group(group), b.of_group(group));
    let by_image: BTreeMap<&str, [f64; N]> = of_a
        .iter()
        .filter_map(|row| Some((row.image.as_str(), values(row)?)))
        .collect();
    let mut common: Vec<(&str, [f64; N], [f64; N])> = of_b
        .iter()
        .filter_map(|row| {
            let a = by_image.get(row.image.as_str())?;
            Some((row.image.as_str(), *a, values(row)?))
        })
        .collect();
    common.sort_by_key(|(image, ..)| *image);
    let difference = mean(common.iter().map(|(image, a, b)| {
        let difference: [f64; N] = std::array::from_fn(|index| b[index] - a[index]);
        (*image, difference)
    }));
    let Some(difference) = difference else {
        return Vec::new();
    };
    let all: BTreeSet<&str> = of_a.iter().chain(&of_b).map(|r| r.image.as_str()).collect();
    let count = common.len() as f64;
    let test = |(index, (name, lower_is_better)): (usize, (&'static str, bool))| {
        let mut sums: BTreeMap<Recording<'_>, (f64, f64)> = BTreeMap::new();
        for (image, a, b) in &common {
            let (sum, images) = sums.entry(recording(image)).or_default();
            *sum += b[index] - a[index];
            *images += 1.0;
        }
        let recordings = Clusters::count(sums.keys().copied());
        let sums: Vec<(f64, f64)> = sums.into_values().collect();
        let totals: Vec<f64> = sums.iter().map(|(sum, _)| *sum).collect();
        let means: Vec<f64> = sums.iter().map(|(sum, images)| sum / images).collect();
        let sizes: Vec<f64> = sums.iter().map(|(_, images)| *images).collect();
        let no_interval = check(&sizes).err();
        PairedTest {
            protocol: first.protocol.clone(),
            group,
            model_a: first.model.clone(),
            model_b: second.model.clone(),
            metric: name,
            lower_is_better,
            images: common.len() as u64,
            unpaired_images: (all.len() - common.len()) as u64,
            clusters: recordings.total(),
            recordings,
            mean_a: common.iter().map(|(_, a, _)| a[index]).sum::<f64>() / count,
            mean_b: common.iter().map(|(_, _, b)| b[index]).sum::<f64>() / count,
            difference: difference[index],
            interval: no_interval
                .is_none()
                .then(|| ratio_interval(&sums, Range::Any)),
            no_interval,
            p_permutation: sign_flip(&totals, options.permutations, options.seed),
            exact: totals.len() <= EXACT_UP_TO,
            p_wilcoxon: wilcoxon(&means),
            p_holm: None,
            family: 0,
            smallest_p: smallest_p(&totals, options.permutations),
        }
    };
    metrics.into_iter().enumerate().map(test).collect()
}

/// Two-sided p of the hypothesis that the sign of each difference is a coin's: the share of sign
/// patterns whose absolute sum is at least the observed one. Up to [`EXACT_UP_TO`] differences
/// all patterns are counted; beyond, `draws` of them are drawn and the observed one is added to
/// both counts, so that p is never 0. `None` with fewer than two differences.
pub fn sign_flip(differences: &[f64], draws: u32, seed: u64) -> Option<f64> {
    let count = differences.len();
    if count < 2 {
        return None;
    }
    let observed = differences.iter().sum::<f64>().abs();
    // Sums of the same numbers in another sign pattern may differ in the last digits.
    let slack = 1e-12 * differences.iter().map(|value| value.abs()).sum::<f64>();
    let reaches = |sum: f64| sum.abs() >= observed - slack;
    let flipped = |bits: &dyn Fn(usize) -> bool| -> f64 {
        differences
            .iter()
            .enumerate()
            .map(|(index, value)| if bits(index) { -value } else { *value })
            .sum()
    };
    if count <= EXACT_UP_TO {
        let patterns = 1_u32 << count;
        let hits = (0..patterns)
            .filter(|pattern| reaches(flipped(&|index| pattern >> index & 1 == 1)))
            .count();
        return Some(hits as f64 / f64::from(patterns));
    }
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut words = vec![0_u64; count.div_ceil(64)];
    let mut hits = 1_u32;
    for _ in 0..draws {
        for word in &mut words {
            *word = random.next_u64();
        }
        let sum = flipped(&|index| words[index / 64] >> (index % 64) & 1 == 1);
        hits += u32::from(reaches(sum));
    }
    Some(f64::from(hits) / (f64::from(draws) + 1.0))
}

/// The smallest p that [`sign_flip`] can give for this many differences, of which those of zero
/// decide nothing.
#[must_use]
pub fn smallest_p(differences: &[f64], draws: u32) -> Option<f64> {
    let count = differences.len();
    if count < 2 {
        return None;
    }
    let deciding = differences.iter().filter(|value| **value != 0.0).count();
    let all_alike = libm::exp2(1.0 - deciding.max(1) as f64);
    Some(if count <= EXACT_UP_TO {
        all_alike
    } else {
        all_alike.max(1.0 / (f64::from(draws) + 1.0))
    })
}

/// Two-sided p of Wilcoxon's signed-rank test. Differences of zero are left out and equal
/// absolute values share their ranks. Without ties or zeros and up to 50 differences the
/// distribution is counted; otherwise it is the normal approximation with the variance
/// corrected for ties and without correction for continuity. `None` with fewer than two
/// differences, or without one that is not zero.
pub fn wilcoxon(differences: &[f64]) -> Option<f64> {
    let mut values: Vec<f64> = differences.iter().copied().filter(|d| *d != 0.0).collect();
    let count = values.len();
    if differences.len() < 2 || count == 0 {
        return None;
    }
    values.sort_by(|a, b| a.abs().total_cmp(&b.abs()));
    let (mut positive, mut ties) = (0.0, 0.0);
    let mut start = 0;
    while start < count {
        let same = values[start..]
            .iter()
            .take_while(|value| value.abs() == values[start].abs())
            .count();
        let rank = start as f64 + (same as f64 + 1.0) / 2.0;
        let above = values[start..start + same].iter().filter(|v| **v > 0.0);
        positive += rank * above.count() as f64;
        ties += (same as f64).powi(3) - same as f64;
        start += same;
    }
    let n = count as f64;
    let total = n * (n + 1.0) / 2.0;
    let smaller = f64::min(positive, total - positive);
    if ties == 0.0 && count == differences.len() && count <= WILCOXON_EXACT_UP_TO {
        // Share of the subsets of 1..=n whose sum is at most the smaller rank sum.
        let mut ways = vec![0.0_f64; total as usize + 1];
        ways[0] = 1.0;
        for rank in 1..=count {
            for sum in (rank..ways.len()).rev() {
                ways[sum] += ways[sum - rank];
            }
        }
        let below: f64 = ways[..=smaller as usize].iter().sum();
        return Some((2.0 * below / 2.0_f64.powi(count as i32)).min(1.0));
    }
    let variance = (n * (n + 1.0) * (2.0 * n + 1.0) - ties / 2.0) / 24.0;
    let z = (smaller - total / 2.0) / variance.sqrt();
    Some(libm::erfc(z.abs() / std::f64::consts::SQRT_2).min(1.0))
}

/// Holm's step-down correction: p values in the order given, each the chance that this or a
/// smaller one of them turns up somewhere in the family.
pub fn holm(p: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..p.len()).collect();
    order.sort_by(|a, b| p[*a].total_cmp(&p[*b]));
    let mut adjusted = vec![0.0; p.len()];
    let mut highest = 0.0_f64;
    for (done, index) in order.into_iter().enumerate() {
        highest = highest.max(((p.len() - done) as f64 * p[index]).min(1.0));
        adjusted[index] = highest;
    }
    adjusted
}

#[cfg(test)]
mod tests {
    use rand::RngExt as _;

    use super::*;
    use crate::FurtherMetrics;
    use crate::rows::tests::sample;
    use crate::rows::{Row, by_model};

    const TEN: [f64; 10] = [0.5, -0.3, 1.2, 0.8, -0.1, 0.9, 0.4, 1.1, -0.6, 0.7];

    /// Recipe: make_golden.py metrics/exact-p. scipy 1.17.1 gives the same:
    /// `permutation_test((x,), numpy.mean, permutation_type='samples', n_resamples=numpy.inf).pvalue`
    /// and `wilcoxon(x, method='exact').pvalue`.
    #[test]
    fn exact_p_values_are_those_of_scipy() {
        assert_eq!(sign_flip(&TEN, 1, 0), Some(0.05078125));
        assert!((wilcoxon(&TEN).unwrap() - 0.048828125).abs() < 1e-12);
    }

    /// Recipe: make_golden.py metrics/wilcoxon-ties, with a zero and ties. scipy 1.17.1 gives the same:
    /// `wilcoxon(x, method='asymptotic', zero_method='wilcox', correction=False).pvalue`.
    #[test]
    fn approximate_p_with_ties_and_a_zero_is_that_of_scipy() {
        let ties = [
            0.5, -0.5, 0.5, 1.0, 1.0, 0.0, 2.0, -0.25, 3.0, 4.0, -1.0, 2.5,
        ];
        assert!((wilcoxon(&ties).unwrap() - 0.0400647731321969).abs() < 1e-12);
    }

    #[test]
    fn small_families_by_hand() {
        // Of the 8 patterns only all plus and all minus reach the sum.
        assert_eq!(sign_flip(&[1.0, 2.0, 3.0], 1, 0), Some(0.25));
        assert_eq!(sign_flip(&[1.0, -1.0], 1, 0), Some(1.0));
        assert_eq!(sign_flip(&[1.0], 1, 0), None);
        assert_eq!(wilcoxon(&[0.0, 0.0]), None);
        // Holm's own steps: 3 * 0.01, 2 * 0.02, then not below the one before.
        let adjusted = holm(&[0.03, 0.01, 0.02, 0.9]);
        for (a, b) in adjusted.iter().zip([0.06, 0.04, 0.06, 0.9]) {
            assert!((a - b).abs() < 1e-15, "{adjusted:?}");
        }
        assert_eq!(holm(&[0.6, 0.7]), [1.0, 1.0]);
    }

    /// The drawn test agrees with the counted one where both can be had: 17 differences, of which
    /// the last is so small that it decides nothing.
    #[test]
    fn drawn_p_values_come_near_the_counted_ones() {
        let sixteen: Vec<f64> = (0..16).map(|i| f64::from(i * 7 % 16) - 5.5).collect();
        let mut seventeen = sixteen.clone();
        seventeen.push(1e-9);
        let exact = sign_flip(&sixteen, 1, 0).unwrap();
        let drawn = sign_flip(&seventeen, 10_000, 4).unwrap();
        assert!((exact - drawn).abs() < 0.02, "{exact} {drawn}");
        assert_eq!(Some(drawn), sign_flip(&seventeen, 10_000, 4));
        // A certain difference has the smallest p there is.
        assert_eq!(sign_flip(&[1.0; 40], 9_999, 0), Some(1e-4));
    }

    /// Under the null hypothesis one test in twenty is below 0.05; correlated frames of a drive
    /// must not change that. A test that flips images instead of drives rejects far more often.
    #[test]
    fn the_test_holds_its_level_on_clustered_rows() {
        let mut random = ChaCha8Rng::seed_from_u64(11);
        let mut normal = || (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
        let (mut by_drive, mut by_image) = (0, 0);
        const WORLDS: usize = 400;
        for world in 0..WORLDS {
            let (mut totals, mut images) = (Vec::new(), Vec::new());
            for _ in 0..20 {
                let drive = normal();
                let frames: Vec<f64> = (0..8).map(|_| drive + 0.5 * normal()).collect();
                totals.push(frames.iter().sum());
                images.extend(frames);
            }
            let below = |p: Option<f64>| usize::from(p.unwrap() < 0.05);
            by_drive += below(sign_flip(&totals, 400, world as u64));
            by_image += below(sign_flip(&images, 100, world as u64));
        }
        // 400 tests at 5 %: 20 +- 4.4.
        assert!((8..=34).contains(&by_drive), "{by_drive}");
        assert!(by_image > 120, "{by_image}");
    }

    fn rows(model: &str, gain: f64) -> Vec<Row> {
        (0..24_u32)
            .map(|i| {
                let image = format!("2011_09_26_drive_{:04}/{i:010}", i / 3);
                sample(
                    model,
                    "eigen-80",
                    &image,
                    0.1 + 0.01 * f64::from(i % 7) - gain,
                )
            })
            .collect()
    }

    #[test]
    fn a_constant_gain_is_found_in_all_metrics() {
        let mut all = rows("a", 0.0);
        all.extend(rows("b", 0.01).into_iter().skip(1));
        let models = by_model(&all, "eigen-80").unwrap();
        let pairs = [(&models[0], &models[1])];
        let tests = compare(&pairs, false, &TestOptions::default()).unwrap();
        assert_eq!(tests.len(), 7);
        for test in &tests {
            assert_eq!(
                (test.images, test.unpaired_images, test.clusters),
                (23, 1, 8)
            );
            assert!((test.mean_b - test.mean_a - test.difference).abs() < 1e-12);
            assert_eq!(test.difference < 0.0, test.lower_is_better, "{test:?}");
            // Two of 2^8 patterns; four errors and three accuracies.
            assert!(
                test.exact && test.p_permutation == Some(2.0 / 256.0),
                "{test:?}"
            );
            let family = if test.lower_is_better { 4 } else { 3 };
            assert_eq!(test.family, family);
            assert_eq!(test.p_holm, Some(2.0 * family as f64 / 256.0));
            assert_eq!(test.smallest_p, test.p_permutation);
            assert_eq!(test.smallest_p_holm(), test.p_holm);
            // However much images differ, a constant gain is certain.
            let interval = test.interval.unwrap();
            for bound in [interval.low, interval.high] {
                assert!((bound - test.difference).abs() < 1e-9, "{test:?}");
            }
        }
    }

    /// Recipe: make_golden.py metrics/difference, for differences of -0.01 + 0.002 (i mod 5) in images 1
    /// to 23 of eight drives.
    #[test]
    fn the_interval_of_a_difference_is_that_of_numpy() {
        let mut all = rows("a", 0.0);
        all.remove(0);
        let mut b = rows("b", 0.01);
        for (i, row) in b.iter_mut().enumerate() {
            row.score.metrics.abs_rel += 0.002 * (i % 5) as f64;
        }
        all.extend(b);
        let models = by_model(&all, "eigen-80").unwrap();
        let tests = compare(&[(&models[0], &models[1])], false, &TestOptions::default()).unwrap();
        let interval = tests[0].interval.unwrap();
        assert!((tests[0].difference + 0.006).abs() < 1e-12);
        assert!(
            (interval.low + 0.007039013676984793).abs() < 1e-10,
            "{interval:?}"
        );
        assert!(
            (interval.high + 0.004960986323015207).abs() < 1e-10,
            "{interval:?}"
        );
    }

    /// Fifteen stereo 2015 scenes of four drives (scenes 7 to 21): as independent images p would be
    /// 2^-14 where sign flips by drive cannot go below 2^-3, whatever the difference.
    #[test]
    fn stereo_2015_scenes_are_flipped_by_drive() {
        let mut all = Vec::new();
        for (model, value) in [("a", 0.2), ("b", 0.1)] {
            all.extend((7..22).map(|i| {
                let image = strat_splits::kitti2015_id(i);
                sample(model, "kitti2015", &image, value)
            }));
        }
        let models = by_model(&all, "kitti2015").unwrap();
        let tests = compare(&[(&models[0], &models[1])], false, &TestOptions::default()).unwrap();
        let drives = tests[0].clusters;
        assert_eq!(tests[0].recordings.drives, drives, "all known");
        assert!(drives < 8, "{drives}");
        let smallest = 2.0_f64.powi(1 - drives as i32);
        assert_eq!(tests[0].p_permutation, Some(smallest));
        assert_eq!(tests[0].smallest_p_holm(), Some((4.0 * smallest).min(1.0)));
    }

    #[test]
    fn families_are_protocols_and_kinds_of_metrics() {
        let mut all = rows("a", 0.0);
        all.extend(rows("b", 0.01));
        let mut capped = all.clone();
        for row in &mut capped {
            row.context.protocol = "eigen-50".to_owned();
        }
        let (near, far) = (by_model(&capped, "eigen-50"), by_model(&all, "eigen-80"));
        let (near, far) = (near.unwrap(), far.unwrap());
        let pairs = [(&far[0], &far[1]), (&near[0], &near[1])];
        let tests = compare(&pairs, false, &TestOptions::default()).unwrap();
        assert_eq!(tests.len(), 14);
        for test in &tests {
            assert_eq!(test.family, if test.lower_is_better { 4 } else { 3 });
        }
    }

    /// Further metrics are errors among the others, over the images that both models have them for; the
    /// seven stay what they are.
    #[test]
    fn further_metrics_are_tested_where_they_were_measured() {
        let mut all = rows("a", 0.0);
        all.extend(rows("b", 0.01));
        let seven = {
            let models = by_model(&all, "eigen-80").unwrap();
            let options = TestOptions::default();
            let refused = compare(&[(&models[0], &models[1])], true, &options);
            let error = refused.unwrap_err().to_string();
            assert!(error.contains("`--metrics`"), "{error}");
            compare(&[(&models[0], &models[1])], false, &options).unwrap()
        };
        for (i, row) in all.iter_mut().enumerate().skip(1) {
            let silog = 10.0 + row.score.metrics.abs_rel + i as f64;
            row.score.further = Some(FurtherMetrics {
                silog,
                ..FurtherMetrics::default()
            });
        }
        let models = by_model(&all, "eigen-80").unwrap();
        let pair = [(&models[0], &models[1])];
        let tests = compare(&pair, true, &TestOptions::default()).unwrap();
        assert_eq!(tests.len(), 12);
        for (with, without) in tests.iter().zip(&seven) {
            assert_eq!(with.p_permutation, without.p_permutation);
            assert_eq!(with.difference, without.difference);
            assert_eq!(with.family, if with.lower_is_better { 9 } else { 3 });
        }
        let (abs_rel, silog) = (&tests[0], &tests[7]);
        assert_eq!((silog.metric, silog.lower_is_better), ("silog", true));
        // The first image of the first model has none.
        assert_eq!(silog.images, abs_rel.images - 1);
        assert_eq!(silog.unpaired_images, 1);
        let offset = rows("a", 0.0).len() as f64;
        assert!((silog.difference - abs_rel.difference - offset).abs() < 1e-9);
    }

    #[test]
    fn the_smallest_p_is_that_of_differences_of_one_sign() {
        for count in [2, 5, 16] {
            let alike = vec![0.3; count];
            assert_eq!(smallest_p(&alike, 99), sign_flip(&alike, 99, 0));
        }
        assert_eq!(
            smallest_p(&[1.0, 2.0, 0.0], 99),
            sign_flip(&[1.0, 2.0, 0.0], 99, 0)
        );
        assert_eq!(smallest_p(&[1.0; 40], 9_999), Some(1e-4));
        assert_eq!(smallest_p(&[1.0], 99), None);
    }

    #[test]
    fn different_rules_data_or_images_are_refused() {
        let refused = |change: &dyn Fn(&mut Row)| {
            let mut all = rows("a", 0.0);
            let mut b = rows("b", 0.01);
            b.iter_mut().for_each(change);
            all.extend(b);
            let models = by_model(&all, "eigen-80").unwrap();
            compare(&[(&models[0], &models[1])], false, &TestOptions::default())
                .unwrap_err()
                .to_string()
        };
        let text = refused(&|row| row.context.protocol_digest = "other".to_owned());
        assert!(text.contains("different digests of the protocol"), "{text}");
        let text = refused(&|row| row.context.data_digest = "other".to_owned());
        assert!(text.contains("different digests of the data"), "{text}");
        let text = refused(&|row| row.image.push('x'));
        assert!(text.contains("no image in common"), "{text}");
    }
}
