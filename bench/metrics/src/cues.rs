//! Statistics of the depth-cue experiments (PROTOCOL 5, chapter 4 of the thesis).
//!
//! Curves of depth against a stimulus are described by a straight line, its elasticity, a rank
//! correlation and the range over the mean; pairs of curves by their differences. Every figure
//! can be given a percentile interval by drawing whole clusters (backgrounds) with replacement
//! ([`estimate`]). A verdict compares an interval with a stated threshold ([`judge`]).
//!
//! Not here: composites, models and files; see `strat-bench`.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use crate::statistics::{Bootstrap, Interval, percentile};

/// A straight line through points by least squares.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Line {
    /// Change of y for one unit of x.
    pub slope: f64,
    /// y at x = 0.
    pub intercept: f64,
    /// Share of the variance of y about its mean that the line explains; below 0 for a line
    /// through the origin that is worse than the mean. 0 where y does not vary.
    pub r_squared: f64,
}

/// Fits y = intercept + slope x; `None` with fewer than two different x.
#[must_use]
pub fn fit_line(points: &[(f64, f64)]) -> Option<Line> {
    let (mean_x, mean_y) = (mean(points, |p| p.0)?, mean(points, |p| p.1)?);
    let (mut xx, mut xy) = (0.0, 0.0);
    for &(x, y) in points {
        xx += (x - mean_x) * (x - mean_x);
        xy += (x - mean_x) * (y - mean_y);
    }
    if xx <= 0.0 {
        return None;
    }
    let slope = xy / xx;
    let intercept = mean_y - slope * mean_x;
    Some(Line {
        slope,
        intercept,
        r_squared: r_squared(points, mean_y, |x| intercept + slope * x),
    })
}

/// Fits y = slope x; `None` where every x is 0.
#[must_use]
pub fn fit_through_origin(points: &[(f64, f64)]) -> Option<Line> {
    let mean_y = mean(points, |p| p.1)?;
    let xx: f64 = points.iter().map(|(x, _)| x * x).sum();
    if xx <= 0.0 {
        return None;
    }
    let slope = points.iter().map(|(x, y)| x * y).sum::<f64>() / xx;
    Some(Line {
        slope,
        intercept: 0.0,
        r_squared: r_squared(points, mean_y, |x| slope * x),
    })
}

fn mean(points: &[(f64, f64)], of: impl Fn(&(f64, f64)) -> f64) -> Option<f64> {
    (!points.is_empty()).then(|| points.iter().map(of).sum::<f64>() / points.len() as f64)
}

fn r_squared(points: &[(f64, f64)], mean_y: f64, line: impl Fn(f64) -> f64) -> f64 {
    let (mut rest, mut all) = (0.0, 0.0);
    for &(x, y) in points {
        rest += (y - line(x)) * (y - line(x));
        all += (y - mean_y) * (y - mean_y);
    }
    // Rounding leaves a constant a variance of some 1e-30.
    if all > 1e-20 * mean_y * mean_y * points.len() as f64 {
        1.0 - rest / all
    } else {
        0.0
    }
}

/// Slope of ln y over ln x: by how many per cent y grows where x grows by one. Depth that is
/// proportional to its ideal has 1, depth that ignores it 0; no unit matters.
///
/// `None` where a value is not positive, or with fewer than two different x.
#[must_use]
pub fn elasticity(points: &[(f64, f64)]) -> Option<f64> {
    let logs: Vec<(f64, f64)> = points
        .iter()
        .map(|&(x, y)| (x > 0.0 && y > 0.0).then(|| (libm::log(x), libm::log(y))))
        .collect::<Option<_>>()?;
    fit_line(&logs).map(|line| line.slope)
}

/// Spearman's rank correlation, ties at their mean rank. 0 where one side does not vary: order
/// then says nothing. `None` without points.
#[must_use]
pub fn spearman(points: &[(f64, f64)]) -> Option<f64> {
    let x = ranks(points, |p| p.0);
    let y = ranks(points, |p| p.1);
    let ranked: Vec<(f64, f64)> = x.into_iter().zip(y).collect();
    let (mean_x, mean_y) = (mean(&ranked, |p| p.0)?, mean(&ranked, |p| p.1)?);
    let (mut xx, mut yy, mut xy) = (0.0, 0.0, 0.0);
    for (x, y) in ranked {
        xx += (x - mean_x) * (x - mean_x);
        yy += (y - mean_y) * (y - mean_y);
        xy += (x - mean_x) * (y - mean_y);
    }
    Some(if xx > 0.0 && yy > 0.0 {
        xy / (xx * yy).sqrt()
    } else {
        0.0
    })
}

fn ranks(points: &[(f64, f64)], of: impl Fn(&(f64, f64)) -> f64) -> Vec<f64> {
    let values: Vec<f64> = points.iter().map(of).collect();
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|&a, &b| values[a].total_cmp(&values[b]));
    let mut ranks = vec![0.0; values.len()];
    let mut first = 0;
    while first < order.len() {
        let same = order[first..]
            .iter()
            .take_while(|&&i| values[i] == values[order[first]])
            .count();
        for &index in &order[first..first + same] {
            ranks[index] = first as f64 + (same as f64 - 1.0) / 2.0;
        }
        first += same;
    }
    ranks
}

/// (max - min) / mean of a curve; `None` without values or where the mean is not positive.
#[must_use]
pub fn range_over_mean(values: &[f64]) -> Option<f64> {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let low = values.iter().copied().fold(f64::INFINITY, f64::min);
    (mean > 0.0).then(|| (high - low) / mean)
}

/// Largest and root-mean-square difference of two curves at the same places; `None` without any.
#[must_use]
pub fn curve_difference(pairs: &[(f64, f64)]) -> Option<(f64, f64)> {
    let squares = mean(pairs, |(a, b)| (a - b) * (a - b))?;
    let largest = pairs.iter().map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    Some((largest, squares.sqrt()))
}

/// mean |a - b| / mean a: what changes where only b's condition changes (PROTOCOL 5.3, ablation).
#[must_use]
pub fn relative_change(pairs: &[(f64, f64)]) -> Option<f64> {
    let of = mean(pairs, |(a, _)| *a)?;
    (of > 0.0)
        .then(|| mean(pairs, |(a, b)| (a - b).abs()))?
        .map(|change| change / of)
}

/// The camera height that makes the ground at `depth_m` appear `rows_below_horizon` rows below
/// the horizon: depth (v - cy) / f, in metres (PROTOCOL 5.3).
#[must_use]
pub fn implied_camera_height_m(depth_m: f64, rows_below_horizon: f64, focal_px: f64) -> f64 {
    depth_m * rows_below_horizon / focal_px
}

/// Direction of a picture row below the horizon, in degrees from straight down: 90 at the
/// horizon (the "height in the visual field" of equation 4.1, as a true angle).
#[must_use]
pub fn visual_angle_deg(rows_below_horizon: f64, focal_px: f64) -> f64 {
    90.0 - libm::atan(rows_below_horizon / focal_px).to_degrees()
}

/// The rescaled row that the thesis' 0 to 60 degrees can only be: 0 at the bottom row, 90 at the
/// horizon.
#[must_use]
pub fn pseudo_angle_deg(contact_row: f64, bottom_row: f64, horizon_row: f64) -> f64 {
    90.0 * (bottom_row - contact_row) / (bottom_row - horizon_row)
}

/// The smaller of two effects where they agree in sign, else 0: what both measures support.
#[must_use]
pub fn common_effect(a: f64, b: f64) -> f64 {
    if a * b <= 0.0 {
        0.0
    } else if a.abs() < b.abs() {
        a
    } else {
        b
    }
}

/// A figure and how far it would move with other backgrounds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    /// The figure over all clusters.
    pub value: f64,
    /// Its 95 % interval; none with fewer than two clusters, or where the figure is undefined
    /// for some of the draws.
    pub interval: Option<Interval>,
    /// Clusters it comes from.
    pub clusters: usize,
}

/// A statistic over clusters with a percentile interval from drawing whole clusters.
///
/// `None` where the statistic is undefined for all clusters together.
pub fn estimate<T>(
    clusters: &[T],
    bootstrap: &Bootstrap,
    statistic: impl Fn(&[&T]) -> Option<f64>,
) -> Option<Estimate> {
    let all: Vec<&T> = clusters.iter().collect();
    let value = statistic(&all).filter(|value| value.is_finite())?;
    let interval = u32::try_from(clusters.len())
        .ok()
        .filter(|&count| count >= 2)
        .and_then(|count| {
            let mut random = ChaCha8Rng::seed_from_u64(bootstrap.seed);
            let mut draws = (0..bootstrap.resamples.max(1))
                .map(|_| {
                    let drawn: Vec<&T> = (0..count)
                        .map(|_| &clusters[random.random_range(0..count) as usize])
                        .collect();
                    statistic(&drawn).filter(|value| value.is_finite())
                })
                .collect::<Option<Vec<f64>>>()?;
            draws.sort_by(f64::total_cmp);
            Some(Interval {
                low: percentile(&draws, 0.025),
                high: percentile(&draws, 0.975),
            })
        });
    Some(Estimate {
        value,
        interval,
        clusters: clusters.len(),
    })
}

/// Whether a model uses a cue.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// The whole interval lies above the threshold.
    Yes,
    /// The whole interval lies within the threshold on both sides.
    No,
    /// The whole interval lies below minus the threshold: the opposite of the cue.
    Reversed,
    /// The interval crosses a threshold, or there is none.
    Undecided,
}

impl Verdict {
    /// The word in tables.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Yes => "yes",
            Self::No => "no",
            Self::Reversed => "reversed",
            Self::Undecided => "undecided",
        }
    }
}

/// Judges an effect that is 0 without the cue: an effect within `threshold` of 0 counts as none.
#[must_use]
pub fn judge(effect: Option<&Estimate>, threshold: f64) -> Verdict {
    let Some(Interval { low, high }) = effect.and_then(|effect| effect.interval) else {
        return Verdict::Undecided;
    };
    if low > threshold {
        Verdict::Yes
    } else if high < -threshold {
        Verdict::Reversed
    } else if low >= -threshold && high <= threshold {
        Verdict::No
    } else {
        Verdict::Undecided
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(found: f64, expected: f64) {
        assert!((found - expected).abs() < 1e-12, "{found} {expected}");
    }

    #[test]
    fn lines_are_fitted() {
        let line = fit_line(&[(1.0, 5.0), (2.0, 7.0), (3.0, 9.0)]).unwrap();
        close(line.slope, 2.0);
        close(line.intercept, 3.0);
        close(line.r_squared, 1.0);
        // By hand: mean (1, 2/3), slope 1/2, residuals 1/6, -1/3, 1/6 of a total of 2/3.
        let line = fit_line(&[(0.0, 0.0), (1.0, 1.0), (2.0, 1.0)]).unwrap();
        close(line.slope, 0.5);
        close(line.r_squared, 0.75);
        let flat = fit_line(&[(0.0, 0.3), (1.0, 0.3), (2.0, 0.3)]).unwrap();
        assert_eq!((flat.slope, flat.r_squared), (0.0, 0.0));
        assert_eq!(fit_line(&[(1.0, 2.0), (1.0, 3.0)]), None);
        let ray = fit_through_origin(&[(1.0, 3.0), (2.0, 6.0)]).unwrap();
        close(ray.slope, 3.0);
        close(ray.r_squared, 1.0);
        assert_eq!(fit_through_origin(&[(0.0, 1.0)]), None);
    }

    #[test]
    fn elasticity_has_no_unit() {
        let points: Vec<(f64, f64)> = (1..=50)
            .map(|k| (f64::from(k), 7.0 * f64::from(k).sqrt()))
            .collect();
        close(elasticity(&points).unwrap(), 0.5);
        assert_eq!(elasticity(&[(1.0, 1.0), (2.0, 0.0)]), None);
    }

    #[test]
    fn rank_correlation_takes_ties_at_their_mean() {
        close(
            spearman(&[(1.0, 1.0), (2.0, 8.0), (3.0, 9.0)]).unwrap(),
            1.0,
        );
        close(
            spearman(&[(1.0, 3.0), (2.0, 2.0), (3.0, 1.0)]).unwrap(),
            -1.0,
        );
        assert_eq!(spearman(&[(1.0, 2.0), (2.0, 2.0)]), Some(0.0));
        // Ranks 0, 1, 2 against 0, 1.5, 1.5: covariance 1.5, variances 2 and 1.5.
        let expected = 1.5 / (2.0_f64 * 1.5).sqrt();
        close(
            spearman(&[(1.0, 1.0), (2.0, 4.0), (3.0, 4.0)]).unwrap(),
            expected,
        );
        assert_eq!(spearman(&[]), None);
    }

    #[test]
    fn curves_are_compared() {
        close(range_over_mean(&[1.0, 2.0, 3.0]).unwrap(), 1.0);
        assert_eq!(range_over_mean(&[]), None);
        let (largest, rms) = curve_difference(&[(1.0, 1.0), (2.0, 5.0)]).unwrap();
        close(largest, 3.0);
        close(rms, (9.0_f64 / 2.0).sqrt());
        close(relative_change(&[(4.0, 3.0), (6.0, 8.0)]).unwrap(), 0.3);
    }

    /// PROTOCOL 5.3: the bottom row of 1242x375 is at 74.4 degrees.
    #[test]
    fn angles_are_those_of_the_camera() {
        let (focal, horizon) = (721.5377, 172.854);
        assert!((visual_angle_deg(374.0 - horizon, focal) - 74.4).abs() < 0.05);
        close(visual_angle_deg(0.0, focal), 90.0);
        close(pseudo_angle_deg(374.0, 374.0, horizon), 0.0);
        close(pseudo_angle_deg(horizon, 374.0, horizon), 90.0);
        let depth = focal * 1.65 / 60.0;
        close(implied_camera_height_m(depth, 60.0, focal), 1.65);
    }

    #[test]
    fn only_what_both_measures_show_counts() {
        assert_eq!(common_effect(0.8, 0.3), 0.3);
        assert_eq!(common_effect(-0.8, -0.9), -0.8);
        assert_eq!(common_effect(-0.8, 0.9), 0.0);
    }

    #[test]
    fn intervals_come_from_whole_clusters() {
        let mean = |drawn: &[&f64]| Some(drawn.iter().copied().sum::<f64>() / drawn.len() as f64);
        let bootstrap = Bootstrap {
            resamples: 2000,
            seed: 1,
        };
        let values: Vec<f64> = (0..100).map(f64::from).collect();
        let found = estimate(&values, &bootstrap, mean).unwrap();
        let interval = found.interval.unwrap();
        // 1.96 * 28.87 / 10
        assert!((found.value - 49.5).abs() < 1e-12);
        assert!(
            (interval.high - interval.low - 2.0 * 5.66).abs() < 0.9,
            "{interval:?}"
        );
        assert_eq!(found, estimate(&values, &bootstrap, mean).unwrap());
        assert_eq!(estimate(&[3.0], &bootstrap, mean).unwrap().interval, None);
        assert_eq!(estimate(&[1.0, 2.0], &bootstrap, |_| None), None);
    }

    #[test]
    fn verdicts_need_the_whole_interval() {
        let effect = |low, high| Estimate {
            value: 0.5 * (low + high),
            interval: Some(Interval { low, high }),
            clusters: 5,
        };
        assert_eq!(judge(Some(&effect(0.2, 0.9)), 0.1), Verdict::Yes);
        assert_eq!(judge(Some(&effect(-0.1, 0.1)), 0.1), Verdict::No);
        assert_eq!(judge(Some(&effect(-0.9, -0.2)), 0.1), Verdict::Reversed);
        assert_eq!(judge(Some(&effect(0.0, 0.9)), 0.1), Verdict::Undecided);
        assert_eq!(judge(None, 0.1), Verdict::Undecided);
    }
}
