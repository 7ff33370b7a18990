//! Means over images and what they are worth: intervals over the drives.
//!
//! The mean is the protocol's: every image counts the same, whatever its number of pixels
//! (PROTOCOL 3.1). Images that were recorded together are alike, so intervals count
//! [recordings](strat_splits::recording()), not images; how, is [`Interval`]'s business.
//!
//! Intervals describe the choice of test images only, not the spread between training runs.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use serde::{Deserialize, Serialize};
use strat_splits::{Recording, recording};

pub use crate::interval::{Interval, MIN_CLUSTERS, NoInterval, mean_interval};
use crate::interval::{Range, check, ratio_interval};
use crate::metrics::{FurtherMetrics, Metric, Metrics};
use crate::protocol::Group;
use crate::rows::Row;

/// How resamples are drawn where a figure needs them ([`cues`](crate::cues)). The default is
/// 10 000 resamples, seed 0.
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

/// How many recordings of which kind there are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Clusters {
    /// Known drives.
    pub drives: u64,
    /// Runs of stereo 2015 scenes whose drive is unknown.
    pub runs: u64,
    /// Images that say nothing about their origin and stand for themselves.
    pub images: u64,
}

impl Clusters {
    pub(crate) fn count<'a>(recordings: impl IntoIterator<Item = Recording<'a>>) -> Self {
        let mut counted = Self::default();
        for recording in recordings {
            match recording {
                Recording::Drive(_) | Recording::Folder(_) => counted.drives += 1,
                Recording::Scenes(..) => counted.runs += 1,
                Recording::Image(_) => counted.images += 1,
            }
        }
        counted
    }

    /// All of them.
    #[must_use]
    pub fn total(&self) -> u64 {
        self.drives + self.runs + self.images
    }
}

impl fmt::Display for Clusters {
    /// As in "29 drives and 10 runs of scenes of unknown drive".
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let parts: Vec<String> = [
            (self.drives, "drive", "drives"),
            (
                self.runs,
                "run of scenes of unknown drive",
                "runs of scenes of unknown drive",
            ),
            (self.images, "image", "images"),
        ]
        .into_iter()
        .filter(|(count, ..)| *count > 0)
        .map(|(count, one, many)| format!("{count} {}", if count == 1 { one } else { many }))
        .collect();
        f.pad(&parts.join(" and "))
    }
}

/// What a table says of a model.
#[derive(Clone, Debug, PartialEq)]
pub struct Summary {
    /// Number of images.
    pub images: u64,
    /// What they were recorded in.
    pub clusters: Clusters,
    /// Pixels scored, over all images.
    pub pixels: u64,
    /// Pixels whose disparity was raised to the floor, over all images.
    pub floored_pixels: u64,
    /// Unweighted means over images.
    pub mean: Metrics,
    /// Means of the further metrics, if every image has them.
    pub further: Option<FurtherMetrics>,
    /// Mean of D1-all in percent, if every image has it.
    pub d1_all: Option<f64>,
    /// Root of the squared error pooled over the pixels of all images, metres.
    pub pooled_rmse: f64,
    /// Why there are no intervals.
    pub no_interval: Option<NoInterval>,
    /// Intervals of the means in the order of [`Metric::ALL`].
    pub intervals: Option<[Interval; 7]>,
    /// Intervals of `further`, in the order of [`FurtherMetric::ALL`](crate::FurtherMetric::ALL).
    pub further_intervals: Option<[Interval; 5]>,
    /// Interval of `d1_all`.
    pub d1_all_interval: Option<Interval>,
    /// Interval of `pooled_rmse`; none either where one recording has more than half of the pixels.
    pub pooled_rmse_interval: Option<Interval>,
}

/// An image, or a group of pixels in it: what a row is about.
type Key<'a> = (&'a str, Option<Group>);

/// Sums over the rows of one recording.
#[derive(Clone, Copy, Default)]
struct Sums {
    rows: f64,
    metrics: [f64; 7],
    further: [f64; 5],
    d1_all: f64,
    squared_error: f64,
    pixels: f64,
}

/// Means over rows of one model and one protocol, pooled error and intervals; `None` without
/// rows. For a protocol with groups, give the rows of one group.
pub fn summarise(rows: &[&Row]) -> Option<Summary> {
    // Sorted, so that sums do not depend on the order of the rows.
    let sorted: BTreeMap<Key<'_>, &Row> = rows
        .iter()
        .map(|row| ((row.image.as_str(), row.score.group), *row))
        .collect();
    let mean = mean(
        sorted
            .iter()
            .map(|((image, _), row)| (*image, row.score.metrics.to_array())),
    )?;
    let mut recordings: BTreeMap<Recording<'_>, Sums> = BTreeMap::new();
    for ((image, _), row) in &sorted {
        let sums = recordings.entry(recording(image)).or_default();
        sums.rows += 1.0;
        for (sum, value) in sums.metrics.iter_mut().zip(row.score.metrics.to_array()) {
            *sum += value;
        }
        let further = row.score.further.unwrap_or_default().to_array();
        for (sum, value) in sums.further.iter_mut().zip(further) {
            *sum += value;
        }
        sums.d1_all += row.score.d1_all.unwrap_or_default();
        sums.squared_error += row.score.sum_squared_error;
        sums.pixels += row.score.pixels as f64;
    }
    let sizes: Vec<f64> = recordings.values().map(|sums| sums.rows).collect();
    let pixel_counts: Vec<f64> = recordings.values().map(|sums| sums.pixels).collect();
    let no_interval = check(&sizes).err();
    let interval = |figure: &dyn Fn(&Sums) -> (f64, f64), range| {
        let clusters: Vec<(f64, f64)> = recordings.values().map(figure).collect();
        no_interval
            .is_none()
            .then(|| ratio_interval(&clusters, range))
    };
    let intervals = Metric::ALL.map(|metric| {
        let range = if metric.lower_is_better() {
            Range::Positive
        } else {
            Range::Fraction
        };
        interval(&|sums| (sums.metrics[metric as usize], sums.rows), range)
    });
    let intervals: Option<Vec<Interval>> = intervals.into_iter().collect();
    let further: Option<Vec<(&str, [f64; 5])>> = sorted
        .iter()
        .map(|((image, _), row)| Some((*image, row.score.further?.to_array())))
        .collect();
    let further = further.and_then(|values| self::mean(values.into_iter()));
    let further_intervals: Option<Vec<Interval>> = (further.is_some())
        .then(|| {
            let of =
                |index: usize| interval(&|sums| (sums.further[index], sums.rows), Range::Positive);
            (0..5).map(of).collect()
        })
        .flatten();
    let sum = |value: fn(&Row) -> u64| sorted.values().map(|row| value(row)).sum::<u64>();
    let pixels = sum(|row| row.score.pixels);
    let squared: f64 = sorted.values().map(|row| row.score.sum_squared_error).sum();
    let d1: Option<Vec<f64>> = sorted.values().map(|row| row.score.d1_all).collect();
    let has_d1 = d1.is_some();
    let images: BTreeSet<&str> = sorted.keys().map(|(image, _)| *image).collect();
    Some(Summary {
        images: images.len() as u64,
        clusters: Clusters::count(recordings.keys().copied()),
        pixels,
        floored_pixels: sum(|row| row.score.floored_pixels),
        mean: Metrics::from_array(mean),
        further: further.map(FurtherMetrics::from_array),
        d1_all: d1.map(|values| values.iter().sum::<f64>() / values.len() as f64),
        pooled_rmse: (squared / pixels as f64).sqrt(),
        no_interval,
        intervals: intervals.and_then(|intervals| intervals.try_into().ok()),
        further_intervals: further_intervals.and_then(|intervals| intervals.try_into().ok()),
        d1_all_interval: interval(&|sums| (0.01 * sums.d1_all, sums.rows), Range::Fraction)
            .filter(|_| has_d1)
            .map(|interval| interval.map(|bound| 100.0 * bound)),
        pooled_rmse_interval: interval(&|sums| (sums.squared_error, sums.pixels), Range::Positive)
            .filter(|_| check(&pixel_counts).is_ok())
            .map(|interval| interval.map(f64::sqrt)),
    })
}

/// A share with its interval over recordings.
#[derive(Clone, Debug, PartialEq)]
pub struct Ratio {
    /// Hits of all images over tries of all images.
    pub value: f64,
    /// Its interval.
    pub interval: Option<Interval>,
    /// Why there is none.
    pub no_interval: Option<NoInterval>,
    /// What the images were recorded in.
    pub clusters: Clusters,
}

/// The share of hits among tries, each a sum over an image: `(image, hits, tries)`. `None` without any
/// try.
pub fn ratio<'a>(images: impl Iterator<Item = (&'a str, f64, f64)>) -> Option<Ratio> {
    let mut recordings: BTreeMap<Recording<'_>, (f64, f64)> = BTreeMap::new();
    for (image, hits, tries) in images {
        let sums = recordings.entry(recording(image)).or_default();
        sums.0 += hits;
        sums.1 += tries;
    }
    let clusters = Clusters::count(recordings.keys().copied());
    let sums: Vec<(f64, f64)> = recordings.into_values().collect();
    let tries: Vec<f64> = sums.iter().map(|(_, tries)| *tries).collect();
    let total: f64 = tries.iter().sum();
    if total == 0.0 {
        return None;
    }
    let no_interval = check(&tries).err();
    Some(Ratio {
        value: sums.iter().map(|(hits, _)| hits).sum::<f64>() / total,
        interval: no_interval
            .is_none()
            .then(|| ratio_interval(&sums, Range::Fraction)),
        no_interval,
        clusters,
    })
}

/// Mean over images of sorted ids; `None` without any. Added up drive by drive where ids name one:
/// another order would change the last digits of figures that people have published.
pub(crate) fn mean<'a, const N: usize>(
    values: impl Iterator<Item = (&'a str, [f64; N])>,
) -> Option<[f64; N]> {
    let mut folders: BTreeMap<&str, [f64; N]> = BTreeMap::new();
    let mut count = 0.0;
    let add = |sums: &mut [f64; N], values: &[f64; N]| {
        for (sum, value) in sums.iter_mut().zip(values) {
            *sum += value;
        }
    };
    for (image, values) in values {
        let folder = match image.split_once('/') {
            Some((folder, _)) if folder.contains("_drive_") => folder,
            _ => image,
        };
        add(folders.entry(folder).or_insert([0.0; N]), &values);
        count += 1.0;
    }
    let mut total = [0.0; N];
    for sums in folders.values() {
        add(&mut total, sums);
    }
    (count > 0.0).then(|| total.map(|sum| sum / count))
}

/// Percentile of sorted values with linear interpolation between neighbours.
#[must_use]
pub fn percentile(sorted: &[f64], fraction: f64) -> f64 {
    let position = fraction * (sorted.len() - 1) as f64;
    let below = position.floor() as usize;
    let above = (below + 1).min(sorted.len() - 1);
    sorted[below] + (position - below as f64) * (sorted[above] - sorted[below])
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
            further: None,
            d1_all: Some(10.0 * abs_rel),
            sum_squared_error: 100.0 * abs_rel,
            pixels: 50,
            floored_pixels: 1,
            fit: None,
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
        let summary = summarise(&refs(&rows)).unwrap();
        assert!((summary.mean.abs_rel - 0.2).abs() < 1e-15);
        assert!((summary.d1_all.unwrap() - 2.0).abs() < 1e-14);
        assert!((summary.pooled_rmse - (40.0_f64 / 200.0).sqrt()).abs() < 1e-15);
        assert_eq!(
            (summary.images, summary.pixels, summary.floored_pixels),
            (2, 200, 2)
        );
        assert_eq!(summarise(&[]), None);
    }

    /// Nine drives of four images, the last with one, and more pixels from drive to drive. Recipe:
    /// make_golden.py metrics/drives.
    #[test]
    fn every_figure_has_its_interval() {
        let mut rows = frames(9, 4, |drive, frame| {
            f64::from(drive * 5 + frame * 3 % 7) / 100.0
        });
        rows.truncate(33);
        for (index, row) in rows.iter_mut().enumerate() {
            row.score.pixels = 50 + 10 * (index as u64 / 4);
        }
        let summary = summarise(&refs(&rows)).unwrap();
        assert_eq!(summary.clusters.to_string(), "9 drives");
        let intervals = summary.intervals.unwrap();
        for (interval, low, high) in [
            (
                intervals[Metric::AbsRel as usize],
                0.1293331281308483,
                0.33607732740968804,
            ),
            (
                intervals[Metric::A1 as usize],
                0.6749897978884614,
                0.8740578954078839,
            ),
            (
                summary.d1_all_interval.unwrap(),
                1.290633559672254,
                3.3512054123633255,
            ),
            (
                summary.pooled_rmse_interval.unwrap(),
                0.433731560637292,
                0.5565735369066294,
            ),
        ] {
            assert!((interval.low - low).abs() < 1e-10, "{interval:?} {low}");
            assert!((interval.high - high).abs() < 1e-10, "{interval:?} {high}");
        }
        let before = summarise(&refs(&rows));
        rows.reverse();
        assert_eq!(before, summarise(&refs(&rows)), "whatever the order");
        rows[3].score.d1_all = None;
        let summary = summarise(&refs(&rows)).unwrap();
        assert_eq!((summary.d1_all, summary.d1_all_interval), (None, None));
    }

    #[test]
    fn few_drives_have_no_interval_but_a_reason() {
        let rows = frames(2, 25, |drive, frame| f64::from(drive + frame));
        let summary = summarise(&refs(&rows)).unwrap();
        assert_eq!((summary.clusters.total(), summary.intervals), (2, None));
        assert_eq!(summary.pooled_rmse_interval, None);
        assert_eq!(summary.no_interval, Some(NoInterval::TooFew));
        let rows = frames(3, 25, |drive, frame| f64::from(drive + frame));
        assert_eq!(summarise(&refs(&rows)).unwrap().no_interval, None);
        let unequal = summarise(&refs(&rows[20..])).unwrap();
        assert_eq!(unequal.no_interval, None, "5, 25 and 25 images");
        let unequal = summarise(&refs(&rows[22..52])).unwrap();
        assert_eq!(unequal.no_interval, Some(NoInterval::OneDominates));
        // Equal in images but not in pixels.
        let mut rows = rows;
        rows[0].score.pixels = 1_000_000;
        let unequal = summarise(&refs(&rows)).unwrap();
        assert!(unequal.intervals.is_some() && unequal.pooled_rmse_interval.is_none());
    }

    #[test]
    fn equal_images_have_an_interval_of_no_width() {
        let rows = frames(5, 3, |_, _| 0.25);
        let summary = summarise(&refs(&rows)).unwrap();
        let interval = summary.intervals.unwrap()[Metric::AbsRel as usize];
        assert_eq!((interval.low, interval.high), (0.25, 0.25));
    }

    /// For n independent values of standard deviation s the interval is near mean +- 1.96 s/sqrt(n).
    #[test]
    fn interval_of_independent_images_follows_the_normal_approximation() {
        let rows: Vec<Row> = (0..400)
            .map(|i| row(&format!("mine/{i:06}"), f64::from(i * 37 % 400)))
            .collect();
        let summary = summarise(&refs(&rows)).unwrap();
        let half_width = 1.96 * (400.0_f64.powi(2) / 12.0).sqrt() / 20.0;
        let interval = summary.intervals.unwrap()[Metric::AbsRel as usize];
        assert_eq!(summary.clusters.to_string(), "400 images");
        assert!((interval.low - (199.5 - half_width)).abs() < 0.08 * half_width);
        assert!((interval.high - (199.5 + half_width)).abs() < 0.08 * half_width);
    }

    /// 25 alike frames of a drive tell no more than one: the interval must not shrink.
    #[test]
    fn drives_count_as_a_whole() {
        let by_drive = |drive: u32, _| f64::from(drive * 7 % 12);
        let one = frames(12, 1, by_drive);
        let many = frames(12, 25, by_drive);
        let of = |rows: &[Row]| summarise(&refs(rows)).unwrap().intervals.unwrap()[0];
        let (one, many) = (of(&one), of(&many));
        assert!((one.low - many.low).abs() < 1e-12 && (one.high - many.high).abs() < 1e-12);
        assert!(one.high - one.low > 3.0);
    }

    /// The same for stereo 2015, whose ids say nothing of drives.
    #[test]
    fn stereo_2015_scenes_count_by_their_drives() {
        let rows: Vec<Row> = strat_splits::test_ids(strat_splits::Split::Kitti)
            .iter()
            .map(|id| row(id, 0.1))
            .collect();
        let summary = summarise(&refs(&rows)).unwrap();
        assert_eq!(
            summary.clusters.to_string(),
            "29 drives and 10 runs of scenes of unknown drive"
        );
        assert_eq!(summary.clusters.total(), 39);
    }

    #[test]
    fn percentiles_interpolate() {
        assert_eq!(percentile(&[0.0, 10.0], 0.025), 0.25);
        assert_eq!(percentile(&[1.0, 2.0, 3.0], 0.5), 2.0);
        assert_eq!(percentile(&[4.0], 0.975), 4.0);
    }
}
