//! 95 % intervals of figures over images that were recorded drive by drive.
//!
//! The images of a drive are alike, so what is independent is the drive, and drives are few and of
//! unequal length. A figure here is a ratio of two sums over drives: of a metric and of images for
//! a mean, of squared errors and of pixels for a pooled error. Its standard error is that of the
//! delete-one jackknife: what the figure does when one drive at a time is left out. It is
//! multiplied by Student's t with the degrees of freedom of Bell and McCaffrey (2002), which are
//! the drives less one where all are of equal length and fewer where they are not. Errors are
//! taken on a logarithmic scale and shares on a logistic one, where few drives are nearer to
//! normal and no bound leaves the possible values (PROTOCOL 11 compares coverages).
//!
//! Not here: which images belong together, see `strat_splits::recording`.

use serde::{Deserialize, Serialize};

/// A 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Interval {
    /// Lower bound.
    pub low: f64,
    /// Upper bound.
    pub high: f64,
}

impl Interval {
    /// The same interval of a figure that grows with this one.
    pub(crate) fn map(self, figure: impl Fn(f64) -> f64) -> Self {
        Self {
            low: figure(self.low),
            high: figure(self.high),
        }
    }
}

/// Fewer drives get no interval.
pub const MIN_CLUSTERS: usize = 3;

/// Why a figure has no interval.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, thiserror::Error)]
#[serde(rename_all = "kebab-case")]
pub enum NoInterval {
    /// Fewer than [`MIN_CLUSTERS`].
    #[error("it takes at least {MIN_CLUSTERS} of them")]
    TooFew,
    /// What one drive does, no other can show.
    #[error("one of them has more than half of the images")]
    OneDominates,
}

/// The values that a figure can have at all.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Range {
    /// Any number: differences.
    Any,
    /// 0 and above: errors.
    Positive,
    /// 0 to 1: accuracies and shares.
    Fraction,
}

/// Checks that clusters of these sizes carry an interval.
pub(crate) fn check(sizes: &[f64]) -> Result<(), NoInterval> {
    let total: f64 = sizes.iter().sum();
    if sizes.len() < MIN_CLUSTERS {
        Err(NoInterval::TooFew)
    } else if sizes.iter().any(|size| *size > 0.5 * total) {
        Err(NoInterval::OneDominates)
    } else {
        Ok(())
    }
}

/// 95 % t interval of the mean of independent values; none for fewer than [`MIN_CLUSTERS`].
#[must_use]
pub fn mean_interval(values: &[f64]) -> Option<Interval> {
    let clusters: Vec<(f64, f64)> = values.iter().map(|value| (*value, 1.0)).collect();
    check(&vec![1.0; values.len()]).ok()?;
    Some(ratio_interval(&clusters, Range::Any))
}

/// Interval of the ratio of the totals of both sums over clusters, each `(numerator, denominator)`
/// with a denominator above 0; there must be at least two.
pub(crate) fn ratio_interval(clusters: &[(f64, f64)], range: Range) -> Interval {
    let (ratio, variance) = jackknife(clusters);
    let sizes: Vec<f64> = clusters
        .iter()
        .map(|(_, denominator)| *denominator)
        .collect();
    let half_width = student_t(degrees_of_freedom(&sizes), 0.05) * variance.sqrt();
    let (low, high) = match range {
        // Also a figure at the edge of what is possible, where every cluster has to be.
        _ if half_width == 0.0 => (ratio, ratio),
        Range::Fraction if ratio <= 0.0 || ratio >= 1.0 => (ratio, ratio),
        Range::Any => (ratio - half_width, ratio + half_width),
        Range::Positive => {
            let factor = libm::exp(half_width / ratio);
            (ratio / factor, ratio * factor)
        }
        Range::Fraction => {
            let odds = ratio / (1.0 - ratio);
            let factor = libm::exp(half_width / (ratio * (1.0 - ratio)));
            let share = |odds: f64| odds / (1.0 + odds);
            (share(odds / factor), share(odds * factor))
        }
    };
    Interval { low, high }
}

/// The ratio of the totals of both sums over clusters, as in [`ratio_interval`], and its variance by
/// the delete-one jackknife.
pub(crate) fn jackknife(clusters: &[(f64, f64)]) -> (f64, f64) {
    let count = clusters.len() as f64;
    let numerators: f64 = clusters.iter().map(|(numerator, _)| numerator).sum();
    let total: f64 = clusters.iter().map(|(_, denominator)| denominator).sum();
    let ratio = numerators / total;
    // Leaving out a cluster changes the ratio by -(numerator - ratio * denominator) / rest.
    let squares: f64 = clusters
        .iter()
        .map(|(numerator, denominator)| {
            let change = (numerator - ratio * denominator) / (total - denominator);
            change * change
        })
        .sum();
    (ratio, (count - 1.0) / count * squares)
}

/// Degrees of freedom of the jackknife's variance for clusters of these sizes, as Bell and
/// McCaffrey have them: those of the chi-squared distribution with the same mean and variance as
/// the sum of squared residuals of independent images, each cluster's residual divided by
/// one minus its share.
pub(crate) fn degrees_of_freedom(sizes: &[f64]) -> f64 {
    let total: f64 = sizes.iter().sum();
    let (mut trace, mut squares, mut outer, mut outer_squares) = (0.0, 0.0, 0.0, 0.0);
    for size in sizes {
        let own = size / (1.0 - size / total);
        let with_others = own * own / total;
        trace += own;
        squares += own * own;
        outer += with_others;
        outer_squares += with_others * with_others;
    }
    trace * trace / (squares + outer * outer - outer_squares)
}

/// The value that Student's t with that many degrees of freedom (at least 1) exceeds in size with
/// probability `tail`, at least 0.04.
pub(crate) fn student_t(degrees: f64, tail: f64) -> f64 {
    let (mut low, mut high) = (0.0, 20.0);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if two_sided_tail(middle, degrees) > tail {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
}

/// P(|T| > t): the regularised incomplete beta function I_x(degrees / 2, 1 / 2) at
/// x = degrees / (degrees + t^2).
pub(crate) fn two_sided_tail(t: f64, degrees: f64) -> f64 {
    let (a, b) = (0.5 * degrees, 0.5);
    let x = degrees / (degrees + t * t);
    if x >= 1.0 {
        return 1.0;
    }
    let front = libm::exp(
        libm::lgamma(a + b) - libm::lgamma(a) - libm::lgamma(b)
            + a * libm::log(x)
            + b * libm::log1p(-x),
    );
    // The continued fraction converges fast on one side of its mean.
    if x < (a + 1.0) / (a + b + 2.0) {
        front * beta_fraction(a, b, x) / a
    } else {
        1.0 - front * beta_fraction(b, a, 1.0 - x) / b
    }
}

/// Continued fraction of the incomplete beta function (NIST DLMF 8.17.22), by Lentz's method.
fn beta_fraction(a: f64, b: f64, x: f64) -> f64 {
    const TINY: f64 = 1e-300;
    let away_from_zero = |value: f64| if value.abs() < TINY { TINY } else { value };
    let mut numerator = 1.0;
    let mut denominator = 1.0 / away_from_zero(1.0 - (a + b) * x / (a + 1.0));
    let mut fraction = denominator;
    for step in 1..300 {
        let m = f64::from(step);
        let even = m * (b - m) * x / ((a + 2.0 * m - 1.0) * (a + 2.0 * m));
        let odd = -(a + m) * (a + b + m) * x / ((a + 2.0 * m) * (a + 2.0 * m + 1.0));
        let mut last = 0.0;
        for coefficient in [even, odd] {
            denominator = 1.0 / away_from_zero(1.0 + coefficient * denominator);
            numerator = away_from_zero(1.0 + coefficient / numerator);
            last = numerator * denominator;
            fraction *= last;
        }
        if (last - 1.0).abs() < 1e-15 {
            break;
        }
    }
    fraction
}

#[cfg(test)]
mod tests {
    use rand::{RngExt as _, SeedableRng as _};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    /// Drives of the 200 stereo 2015 images: known drives, then runs of unknown ones (PROTOCOL 2.2
    /// and 11).
    const STEREO_2015: [u32; 39] = [
        2, 6, 5, 4, 12, 9, 4, 7, 3, 3, 2, 8, 2, 10, 2, 2, 11, 7, 6, 10, 2, 3, 3, 5, 2, 1, 8, 2, 1,
        2, 3, 1, 1, 6, 8, 4, 1, 3, 29,
    ];

    fn close(found: f64, expected: f64) {
        assert!((found - expected).abs() < 1e-10, "{found} {expected}");
    }

    /// Recipe: make_golden.py metrics/t. These digits, and the last value, are those of scipy 1.17.1,
    /// `stats.t.ppf(0.975, df)`.
    #[test]
    fn quantiles_are_those_of_scipy() {
        for (degrees, expected) in [
            (1.0, 12.706204736174694),
            (1.64, 5.347480918139666),
            (2.5, 3.5746548420036817),
            (9.0, 2.262157162798205),
            (27.0, 2.0518305164802846),
            (38.25, 2.0239597418010455),
            (1e4, 1.960201239890626),
        ] {
            close(student_t(degrees, 0.05), expected);
        }
    }

    /// Recipe: make_golden.py metrics/degrees, with the matrices of which this is the short form. Equal
    /// drives have one degree less than their number.
    #[test]
    fn degrees_of_freedom_are_those_of_the_matrices() {
        close(
            degrees_of_freedom(&[3.0, 5.0, 2.0, 9.0]),
            1.8978971710395711,
        );
        let mut eigen = [25.0; 28];
        eigen[27] = 22.0;
        close(degrees_of_freedom(&eigen), 26.98512018192871);
        close(degrees_of_freedom(&[7.0; 10]), 9.0);
        close(
            degrees_of_freedom(&STEREO_2015.map(f64::from)),
            17.821819063920255,
        );
    }

    /// Recipe: make_golden.py metrics/intervals, from the ratios without each drive in turn.
    #[test]
    fn intervals_of_four_drives_are_those_of_numpy() {
        let drives = [(0.31, 3.0), (0.64, 5.0), (0.18, 2.0), (1.35, 9.0)];
        for (range, low, high) in [
            (Range::Any, 0.05639423323483002, 0.20465839834411736),
            (Range::Positive, 0.07396762173439039, 0.23033211983956753),
            (Range::Fraction, 0.07245863904655783, 0.22389598992396803),
        ] {
            let interval = ratio_interval(&drives, range);
            close(interval.low, low);
            close(interval.high, high);
        }
    }

    #[test]
    fn alike_drives_have_an_interval_of_no_width() {
        for range in [Range::Any, Range::Positive, Range::Fraction] {
            for value in [0.0, 0.25, 1.0] {
                let drives = [3.0, 5.0, 2.0].map(|n| (value * n, n));
                let interval = ratio_interval(&drives, range);
                assert_eq!((interval.low, interval.high), (value, value), "{range:?}");
            }
        }
    }

    /// By hand: 1, 2, 3 have the mean 2, a standard error of 1/sqrt(3), and t of 2 degrees is 4.3027.
    #[test]
    fn the_mean_of_independent_values_has_students_interval() {
        let interval = mean_interval(&[1.0, 2.0, 3.0]).unwrap();
        close(interval.high, 2.0 + 4.302_652_729_911_275 / 3.0_f64.sqrt());
        close(interval.low, 2.0 - 4.302_652_729_911_275 / 3.0_f64.sqrt());
        assert_eq!(mean_interval(&[1.0, 2.0]), None);
    }

    #[test]
    fn too_few_and_too_unequal_drives_have_none() {
        assert_eq!(check(&[5.0, 5.0]), Err(NoInterval::TooFew));
        assert_eq!(check(&[5.0, 5.0, 11.0]), Err(NoInterval::OneDominates));
        assert_eq!(check(&[5.0, 5.0, 10.0]), Ok(()));
        assert_eq!(check(&STEREO_2015.map(f64::from)), Ok(()));
    }

    /// Kinds of figures in the simulation below.
    #[derive(Clone, Copy, Debug)]
    enum Kind {
        /// Mean of an error; drives differ by a lognormal factor.
        Error,
        /// Squared errors per pixel.
        Pooled,
        /// An accuracy near 1; what is missing from 1 differs by a lognormal factor.
        Accuracy,
        /// Difference of two models.
        Difference,
    }

    struct World(ChaCha8Rng);

    impl World {
        fn normal(&mut self) -> f64 {
            (0..12).map(|_| self.0.random::<f64>()).sum::<f64>() - 6.0
        }

        /// A lognormal factor with mean 1.
        fn factor(&mut self, deviation: f64) -> f64 {
            (deviation * self.normal() - 0.5 * deviation * deviation).exp()
        }

        /// Whether the interval of a drawn world has its true figure in it. About half of the
        /// variance lies between the drives.
        fn covers(&mut self, kind: Kind, images: &[u32]) -> bool {
            const BETWEEN: f64 = 0.4;
            let drives: Vec<(f64, f64)> = images
                .iter()
                .map(|&images| {
                    let of_drive = match kind {
                        Kind::Difference => self.normal(),
                        _ => self.factor(BETWEEN),
                    };
                    let mut sums = (0.0, 0.0);
                    for _ in 0..images {
                        let pixels = match kind {
                            Kind::Pooled => 0.5 + self.0.random::<f64>(),
                            _ => 1.0,
                        };
                        sums.0 += pixels
                            * match kind {
                                Kind::Error | Kind::Pooled => of_drive * self.factor(0.4),
                                Kind::Accuracy => {
                                    1.0 - (0.05 * of_drive * self.factor(0.4)).min(1.0)
                                }
                                Kind::Difference => of_drive + 0.8 * self.normal(),
                            };
                        sums.1 += pixels;
                    }
                    sums
                })
                .collect();
            let (range, truth) = match kind {
                Kind::Error | Kind::Pooled => (Range::Positive, 1.0),
                Kind::Accuracy => (Range::Fraction, 0.95),
                Kind::Difference => (Range::Any, 0.0),
            };
            let interval = ratio_interval(&drives, range);
            interval.low <= truth && truth <= interval.high
        }
    }

    /// The promise: 95 of 100 intervals contain the true figure, from three drives to many, equal or
    /// not, whatever the figure. The percentile bootstrap of whole drives covers 0.79 with four and
    /// 0.89 with ten (PROTOCOL 11).
    #[test]
    fn intervals_cover_the_truth_as_often_as_they_say() {
        const WORLDS: usize = 1000;
        let mut world = World(ChaCha8Rng::seed_from_u64(5));
        let patterns: [&[u32]; 7] = [
            &[10, 7, 13],
            &[25, 25, 25, 22],
            &[4, 9, 14, 19, 24, 8],
            &[4; 10],
            &[
                12, 5, 20, 7, 9, 27, 15, 11, 6, 18, 22, 8, 14, 10, 13, 17, 25, 7, 19, 9,
            ],
            &[6; 28],
            &STEREO_2015,
        ];
        for kind in [Kind::Error, Kind::Pooled, Kind::Accuracy, Kind::Difference] {
            for images in patterns {
                let covered = (0..WORLDS).filter(|_| world.covers(kind, images)).count();
                let share = covered as f64 / WORLDS as f64;
                // Standard deviation of the share at 0.95: 0.007.
                assert!(
                    (0.915..=0.98).contains(&share),
                    "{kind:?}, {} drives: {share}",
                    images.len()
                );
            }
        }
    }
}
