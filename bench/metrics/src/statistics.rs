//! Means over images, bootstrap intervals and paired differences.
//!
//! The mean is the protocol's: every image counts the same, whatever its number of pixels
//! (PROTOCOL 3.1). Neighbouring frames of a drive are far from independent, so whole drives
//! are drawn with replacement, not images; images without a drive in their id stand for
//! themselves. The resamples come from a seeded ChaCha generator and depend on nothing but
//! the seed and the sorted rows.
//!
//! Intervals describe the choice of test images only, not the spread between training runs.

use std::collections::{BTreeMap, BTreeSet};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use crate::metrics::{Metric, Metrics};
use crate::protocol::Group;
use crate::rows::Row;

/// How intervals are drawn. The default is 10 000 resamples, seed 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Bootstrap {
    /// Number of resamples; at least 1.
    pub resamples: u32,
    /// Seed of the generator.
    pub seed: u64,
}

impl Default for Bootstrap {
    fn default() -> Self {
        Self {
            resamples: 10_000,
            seed: 0,
        }
    }
}

/// A 95 % percentile interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Interval {
    /// 2.5th percentile.
    pub low: f64,
    /// 97.5th percentile.
    pub high: f64,
}

/// What a table says of a model.
#[derive(Clone, Debug, PartialEq)]
pub struct Summary {
    /// Number of images.
    pub images: u64,
    /// Number of drives, or of images where ids name no drive.
    pub clusters: u64,
    /// Pixels scored, over all images.
    pub pixels: u64,
    /// Pixels whose disparity was raised to the floor, over all images.
    pub floored_pixels: u64,
    /// Unweighted means over images.
    pub mean: Metrics,
    /// Mean of D1-all in percent, if every image has it.
    pub d1_all: Option<f64>,
    /// Root of the squared error pooled over the pixels of all images, metres.
    pub pooled_rmse: f64,
    /// Intervals of the means in the order of [`Metric::ALL`]; `None` where there are fewer
    /// than two clusters to draw from.
    pub intervals: Option<[Interval; 7]>,
    /// Interval of `d1_all`.
    pub d1_all_interval: Option<Interval>,
    /// Interval of `pooled_rmse`.
    pub pooled_rmse_interval: Option<Interval>,
}

/// Mean and interval of the difference between two models over the images both were scored on.
#[derive(Clone, Debug, PartialEq)]
pub struct PairedDifference {
    /// Images that both have.
    pub images: u64,
    /// Drives among them, or images where ids name no drive.
    pub clusters: u64,
    /// Mean of second minus first.
    pub mean: Metrics,
    /// Intervals of the mean; `None` with fewer than two clusters.
    pub intervals: Option<[Interval; 7]>,
    /// Per metric, the share of resamples in which the second model is better.
    pub second_better: Option<[f64; 7]>,
}

/// What is drawn as one: the drive of an image id, or the id itself.
pub fn cluster_of(image: &str) -> &str {
    match image.split_once('/') {
        Some((folder, _)) if folder.contains("_drive_") => folder,
        _ => image,
    }
}

/// An image, or a group of pixels in it: what a row is about.
type Key<'a> = (&'a str, Option<Group>);

fn key(row: &Row) -> Key<'_> {
    (&row.image, row.score.group)
}

/// Means over rows of one model and one protocol, pooled error and intervals; `None` without
/// rows. For a protocol with groups, give the rows of one group.
pub fn summarise(rows: &[&Row], bootstrap: &Bootstrap) -> Option<Summary> {
    // Sorted, so that sums do not depend on the order of the rows.
    let sorted: BTreeMap<Key<'_>, &Row> = rows.iter().map(|row| (key(row), *row)).collect();
    let figures = sorted.iter().map(|(key, row)| {
        let [a, b, c, d, e, f, g] = row.score.metrics.to_array();
        let (squared, pixels) = (row.score.sum_squared_error, row.score.pixels as f64);
        let d1 = row.score.d1_all.unwrap_or_default();
        (*key, [a, b, c, d, e, f, g, d1, squared, pixels])
    });
    let clusters = Clusters::new(figures);
    let [a, b, c, d, e, f, g, ..] = clusters.mean()?;
    let mean = Metrics::from_array([a, b, c, d, e, f, g]);
    let draws = clusters.resample(bootstrap);
    let images: BTreeSet<&str> = sorted.keys().map(|(image, _)| *image).collect();
    let sum = |value: fn(&Row) -> u64| sorted.values().map(|row| value(row)).sum::<u64>();
    let pixels = sum(|row| row.score.pixels);
    let squared: f64 = sorted.values().map(|row| row.score.sum_squared_error).sum();
    let d1: Option<Vec<f64>> = sorted.values().map(|row| row.score.d1_all).collect();
    let has_d1 = d1.is_some();
    let interval = |figure: fn(&[f64; 10]) -> f64| draws.as_ref().map(|d| interval(d, figure));
    Some(Summary {
        images: images.len() as u64,
        clusters: clusters.0.len() as u64,
        pixels,
        floored_pixels: sum(|row| row.score.floored_pixels),
        mean,
        d1_all: d1.map(|values| values.iter().sum::<f64>() / values.len() as f64),
        pooled_rmse: (squared / pixels as f64).sqrt(),
        intervals: draws.as_deref().map(intervals),
        d1_all_interval: interval(|draw| draw[7]).filter(|_| has_d1),
        pooled_rmse_interval: interval(|draw| (draw[8] / draw[9]).sqrt()),
    })
}

/// Compares two models on the images and groups that both have rows for; the same resamples
/// serve both. `None` without a common image.
pub fn paired(first: &[&Row], second: &[&Row], bootstrap: &Bootstrap) -> Option<PairedDifference> {
    let of_first: BTreeMap<_, _> = first
        .iter()
        .map(|row| (key(row), row.score.metrics))
        .collect();
    let differences: BTreeMap<Key<'_>, [f64; 7]> = second
        .iter()
        .filter_map(|row| {
            let a = of_first.get(&key(row))?;
            let b = row.score.metrics;
            Some((
                key(row),
                Metric::ALL.map(|metric| b.get(metric) - a.get(metric)),
            ))
        })
        .collect();
    let images: BTreeSet<&str> = differences.keys().map(|(image, _)| *image).collect();
    let clusters = Clusters::new(differences.iter().map(|(key, value)| (*key, *value)));
    let mean = Metrics::from_array(clusters.mean()?);
    let draws = clusters.resample(bootstrap);
    let second_better = draws.as_ref().map(|draws| {
        Metric::ALL.map(|metric| {
            let better = draws.iter().filter(|draw| {
                let difference = draw[metric as usize];
                if metric.lower_is_better() {
                    difference < 0.0
                } else {
                    difference > 0.0
                }
            });
            better.count() as f64 / draws.len() as f64
        })
    });
    Some(PairedDifference {
        images: images.len() as u64,
        clusters: clusters.0.len() as u64,
        mean,
        intervals: draws.as_deref().map(intervals),
        second_better,
    })
}

/// Per cluster, in the order of their names: sums of `N` figures over its rows and the number of
/// rows. The first seven figures are the metrics.
struct Clusters<const N: usize>(Vec<([f64; N], u32)>);

impl<const N: usize> Clusters<N> {
    fn new<'a>(values: impl Iterator<Item = (Key<'a>, [f64; N])>) -> Self {
        let mut sums: BTreeMap<&str, ([f64; N], u32)> = BTreeMap::new();
        for ((image, _), values) in values {
            let (sum, count) = sums.entry(cluster_of(image)).or_insert(([0.0; N], 0));
            add(sum, &values);
            *count += 1;
        }
        Self(sums.into_values().collect())
    }

    fn mean(&self) -> Option<[f64; N]> {
        (!self.0.is_empty()).then(|| mean_of(self.0.iter()))
    }

    /// Means of resamples; `None` if there are no two clusters to choose between.
    fn resample(&self, bootstrap: &Bootstrap) -> Option<Vec<[f64; N]>> {
        let clusters = &self.0;
        let count = u32::try_from(clusters.len()).ok()?;
        if count < 2 {
            return None;
        }
        let mut random = ChaCha8Rng::seed_from_u64(bootstrap.seed);
        let draws = (0..bootstrap.resamples.max(1)).map(|_| {
            let drawn = (0..count).map(|_| &clusters[random.random_range(0..count) as usize]);
            mean_of(drawn)
        });
        Some(draws.collect())
    }
}

fn add<const N: usize>(sum: &mut [f64; N], values: &[f64; N]) {
    for (sum, value) in sum.iter_mut().zip(values) {
        *sum += value;
    }
}

fn mean_of<'a, const N: usize>(clusters: impl Iterator<Item = &'a ([f64; N], u32)>) -> [f64; N] {
    let mut total = [0.0; N];
    let mut rows = 0;
    for (sum, count) in clusters {
        add(&mut total, sum);
        rows += count;
    }
    total.map(|value| value / f64::from(rows))
}

fn intervals<const N: usize>(draws: &[[f64; N]]) -> [Interval; 7] {
    Metric::ALL.map(|metric| interval(draws, |draw| draw[metric as usize]))
}

fn interval<const N: usize>(draws: &[[f64; N]], figure: impl Fn(&[f64; N]) -> f64) -> Interval {
    let mut values: Vec<f64> = draws.iter().map(figure).collect();
    values.sort_by(f64::total_cmp);
    Interval {
        low: percentile(&values, 0.025),
        high: percentile(&values, 0.975),
    }
}

/// Percentile of sorted values with linear interpolation between neighbours.
pub(crate) fn percentile(sorted: &[f64], fraction: f64) -> f64 {
    let place = fraction * (sorted.len() - 1) as f64;
    let below = place.floor() as usize;
    let above = (below + 1).min(sorted.len() - 1);
    sorted[below] + (place - below as f64) * (sorted[above] - sorted[below])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluate::ImageScore;
    use crate::rows::RowContext;

    fn row(image: &str, abs_rel: f64) -> Row {
        let metrics = Metrics {
            abs_rel,
            a1: 1.0 - abs_rel,
            ..Metrics::default()
        };
        let score = ImageScore {
            group: None,
            metrics,
            d1_all: Some(10.0 * abs_rel),
            sum_squared_error: 100.0 * abs_rel,
            pixels: 50,
            floored_pixels: 1,
        };
        Row::new(&RowContext::default(), image, score)
    }

    fn frames(drives: u32, per_drive: u32, value: impl Fn(u32, u32) -> f64) -> Vec<Row> {
        (0..drives)
            .flat_map(|drive| (0..per_drive).map(move |frame| (drive, frame)))
            .map(|(drive, frame)| {
                let image = format!("2011_09_26_drive_{drive:04}/{frame:010}");
                row(&image, value(drive, frame))
            })
            .collect()
    }

    fn refs(rows: &[Row]) -> Vec<&Row> {
        rows.iter().collect()
    }

    #[test]
    fn means_are_unweighted_and_the_pooled_error_is_not() {
        let mut rows = vec![row("a", 0.1), row("b", 0.3)];
        rows[1].score.pixels = 150;
        let summary = summarise(&refs(&rows), &Bootstrap::default()).unwrap();
        assert!((summary.mean.abs_rel - 0.2).abs() < 1e-15);
        assert!((summary.d1_all.unwrap() - 2.0).abs() < 1e-14);
        assert!((summary.pooled_rmse - (40.0_f64 / 200.0).sqrt()).abs() < 1e-15);
        assert_eq!(
            (summary.images, summary.pixels, summary.floored_pixels),
            (2, 200, 2)
        );
        assert_eq!(summarise(&[], &Bootstrap::default()), None);
    }

    /// In these rows D1 is ten times Abs Rel, and the pooled error ten times the root of a fiftieth
    /// of its mean: their intervals follow from that of Abs Rel.
    #[test]
    fn every_figure_has_its_interval() {
        let rows = frames(9, 4, |drive, frame| f64::from(drive * 5 + frame * 3 % 7));
        let summary = summarise(&refs(&rows), &Bootstrap::default()).unwrap();
        let abs_rel = summary.intervals.unwrap()[Metric::AbsRel as usize];
        let d1 = summary.d1_all_interval.unwrap();
        assert!((d1.low - 10.0 * abs_rel.low).abs() < 1e-9, "{d1:?}");
        assert!((d1.high - 10.0 * abs_rel.high).abs() < 1e-9, "{d1:?}");
        let pooled = summary.pooled_rmse_interval.unwrap();
        // Percentiles fall on draws here, so the root may be taken before or after.
        assert!(
            (pooled.low - (2.0 * abs_rel.low).sqrt()).abs() < 1e-3,
            "{pooled:?}"
        );
        assert!(
            (pooled.high - (2.0 * abs_rel.high).sqrt()).abs() < 1e-3,
            "{pooled:?}"
        );
        assert!(pooled.low < summary.pooled_rmse && summary.pooled_rmse < pooled.high);
        let mut without = rows;
        without[3].score.d1_all = None;
        let summary = summarise(&refs(&without), &Bootstrap::default()).unwrap();
        assert_eq!((summary.d1_all, summary.d1_all_interval), (None, None));
    }

    #[test]
    fn a_single_drive_has_no_interval() {
        let rows = frames(1, 25, |_, frame| f64::from(frame));
        let summary = summarise(&refs(&rows), &Bootstrap::default()).unwrap();
        assert_eq!((summary.clusters, summary.intervals), (1, None));
    }

    #[test]
    fn equal_images_have_an_interval_of_no_width() {
        let rows = frames(5, 3, |_, _| 0.25);
        let summary = summarise(&refs(&rows), &Bootstrap::default()).unwrap();
        let interval = summary.intervals.unwrap()[Metric::AbsRel as usize];
        assert_eq!((interval.low, interval.high), (0.25, 0.25));
    }

    /// For n independent values of standard deviation s the interval is near mean +- 1.96 s/sqrt(n).
    #[test]
    fn interval_of_independent_images_follows_the_normal_approximation() {
        let rows: Vec<Row> = (0..400)
            .map(|i| row(&format!("kitti2015/{i:06}"), f64::from(i * 37 % 400)))
            .collect();
        let bootstrap = Bootstrap {
            resamples: 4000,
            seed: 3,
        };
        let summary = summarise(&refs(&rows), &bootstrap).unwrap();
        let half_width = 1.96 * (400.0_f64.powi(2) / 12.0).sqrt() / 20.0;
        let interval = summary.intervals.unwrap()[Metric::AbsRel as usize];
        assert_eq!(summary.clusters, 400);
        assert!((interval.low - (199.5 - half_width)).abs() < 0.08 * half_width);
        assert!((interval.high - (199.5 + half_width)).abs() < 0.08 * half_width);
    }

    /// 25 alike frames of a drive tell no more than one: the interval must not shrink.
    #[test]
    fn drives_are_drawn_as_a_whole() {
        let by_drive = |drive: u32, _| f64::from(drive * 7 % 12);
        let one = frames(12, 1, by_drive);
        let many = frames(12, 25, by_drive);
        let bootstrap = Bootstrap::default();
        let of = |rows: &[Row]| {
            summarise(&refs(rows), &bootstrap)
                .unwrap()
                .intervals
                .unwrap()[0]
        };
        let (one, many) = (of(&one), of(&many));
        assert!((one.low - many.low).abs() < 1e-12 && (one.high - many.high).abs() < 1e-12);
        assert!(one.high - one.low > 3.0);
    }

    #[test]
    fn same_seed_same_interval_whatever_the_order() {
        let mut rows = frames(9, 4, |drive, frame| f64::from(drive * 5 + frame * 3 % 7));
        // Few resamples, since the ends of many would be the same for every seed.
        let bootstrap = Bootstrap {
            resamples: 100,
            seed: 0,
        };
        let before = summarise(&refs(&rows), &bootstrap);
        rows.reverse();
        assert_eq!(before, summarise(&refs(&rows), &bootstrap));
        let other = Bootstrap {
            seed: 1,
            ..bootstrap
        };
        assert_ne!(before, summarise(&refs(&rows), &other));
    }

    /// Pins the generator: a change of these numbers changes every interval. The mean is 20 of
    /// the drives and 11/4 of the frames; the ends are those of the first run, near the
    /// normal approximation 22.75 +- 1.96 * 12.9 / 3.
    #[test]
    fn drawn_numbers_do_not_change() {
        let rows = frames(9, 4, |drive, frame| f64::from(drive * 5 + frame * 3 % 7));
        let summary = summarise(&refs(&rows), &Bootstrap::default()).unwrap();
        let interval = summary.intervals.unwrap()[0];
        assert_eq!(summary.mean.abs_rel, 22.75);
        assert!((interval.low - 14.416_666_666_666_666).abs() < 1e-12);
        assert!((interval.high - 31.083_333_333_333_332).abs() < 1e-12);
    }

    #[test]
    fn a_constant_gain_is_certain_however_much_images_differ() {
        let first = frames(6, 5, |drive, frame| {
            f64::from(drive * 11 + frame) / 100.0 + 0.1
        });
        let second = frames(6, 5, |drive, frame| {
            f64::from(drive * 11 + frame) / 100.0 + 0.08
        });
        let paired = paired(&refs(&first), &refs(&second[1..]), &Bootstrap::default()).unwrap();
        assert_eq!((paired.images, paired.clusters), (29, 6));
        let interval = paired.intervals.unwrap()[0];
        for value in [paired.mean.abs_rel, interval.low, interval.high] {
            assert!((value + 0.02).abs() < 1e-12, "{value}");
        }
        let better = paired.second_better.unwrap();
        assert_eq!(
            (better[Metric::AbsRel as usize], better[Metric::A1 as usize]),
            (1.0, 1.0)
        );
        assert_eq!(better[Metric::Rmse as usize], 0.0);
    }

    /// Of the intervals over simulated drives about 95 % contain the true mean, although the
    /// frames of a drive are alike and drives differ in length. 60 drives: with few of them a
    /// percentile interval is known to be too narrow.
    #[test]
    fn intervals_cover_the_truth_as_often_as_they_say() {
        let mut random = ChaCha8Rng::seed_from_u64(5);
        let mut normal = || (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
        const WORLDS: usize = 1500;
        let mut covered = 0;
        for world in 0..WORLDS {
            let clusters = (0..60_u32)
                .map(|drive| {
                    let frames = 5 + drive % 7;
                    let of_drive = normal();
                    let sum: f64 = (0..frames).map(|_| of_drive + 0.5 * normal()).sum();
                    let mut sums = [0.0; 7];
                    sums[0] = 3.0 * f64::from(frames) + sum;
                    (sums, frames)
                })
                .collect();
            let bootstrap = Bootstrap {
                resamples: 400,
                seed: world as u64,
            };
            let interval = intervals(&Clusters(clusters).resample(&bootstrap).unwrap())[0];
            covered += usize::from(interval.low <= 3.0 && 3.0 <= interval.high);
        }
        let share = covered as f64 / WORLDS as f64;
        assert!((0.93..=0.97).contains(&share), "{share}");
    }

    #[test]
    fn drives_are_read_from_image_ids() {
        assert_eq!(
            cluster_of("2011_09_26_drive_0001/0000000005"),
            "2011_09_26_drive_0001"
        );
        assert_eq!(cluster_of("kitti2015/000006"), "kitti2015/000006");
        assert_eq!(cluster_of("picture"), "picture");
    }

    #[test]
    fn percentiles_interpolate() {
        assert_eq!(percentile(&[0.0, 10.0], 0.025), 0.25);
        assert_eq!(percentile(&[1.0, 2.0, 3.0], 0.5), 2.0);
        assert_eq!(percentile(&[4.0], 0.975), 4.0);
    }
}
