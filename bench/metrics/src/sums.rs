//! The seven depth metrics and the five further ones, as sums over pixels.
//!
//! Formulas: PROTOCOL 3.1 and 10.3 (the traditional forms of Eigen et al.: squared error is divided by depth, not
//! by its square; logarithms are natural). All sums are taken in double precision, pixel after pixel in the order
//! in which they come. What is a valid pixel is decided in [`evaluate`](crate::evaluate()).

use crate::logarithm::ln;
use crate::metrics::{FurtherMetrics, Metrics};

/// Pixels that are worked on together: few enough to stay in the processor's nearest memory.
pub(crate) const AT_A_TIME: usize = 256;

/// What the metrics sum up of one pixel: functions of its two depths alone, each of them costly.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Terms {
    /// True depth g in metres.
    truth_m: f64,
    /// Predicted depth p in metres.
    predicted_m: f64,
    /// ln g - ln p.
    log_error: f64,
    /// |g - p| / g.
    abs_rel: f64,
    /// (g - p)^2 / g.
    sq_rel: f64,
    /// max(g / p, p / g).
    ratio: f64,
}

impl Terms {
    pub(crate) fn new(g: f64, p: f64) -> Self {
        Self {
            truth_m: g,
            predicted_m: p,
            log_error: log_error(g, p),
            abs_rel: abs_rel(g, p),
            sq_rel: sq_rel(g, p),
            ratio: ratio(g, p),
        }
    }

    /// Whether they are those of two depths.
    #[inline]
    pub(crate) fn is_of(&self, truth_m: f64, predicted_m: f64) -> bool {
        self.truth_m == truth_m && self.predicted_m == predicted_m
    }

    /// Adds the terms of pixels, of which there are at most [`AT_A_TIME`], to a list; the processor works
    /// out several at once.
    ///
    /// # Panics
    /// If there are more.
    pub(crate) fn extend(list: &mut Vec<Self>, truth_m: &[f64], predicted_m: &[f64]) {
        // Compiled for the vector units of this machine; the bits are the same on all of them.
        pulp::Arch::new().dispatch(Extend {
            list,
            truth_m,
            predicted_m,
        });
    }
}

/// The work of [`Terms::extend`]. Not a closure: what is compiled for vector units is what is inlined where they are
/// known, and a closure cannot be told to be.
struct Extend<'a> {
    list: &'a mut Vec<Terms>,
    truth_m: &'a [f64],
    predicted_m: &'a [f64],
}

impl pulp::NullaryFnOnce for Extend<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self {
            list,
            truth_m,
            predicted_m,
        } = self;
        let mut columns = [[0.0; AT_A_TIME]; 4];
        let [log_errors, abs_rels, sq_rels, ratios] = &mut columns;
        of_each(log_errors, truth_m, predicted_m, log_error);
        of_each(abs_rels, truth_m, predicted_m, abs_rel);
        of_each(sq_rels, truth_m, predicted_m, sq_rel);
        of_each(ratios, truth_m, predicted_m, ratio);
        let depths = truth_m.iter().zip(predicted_m);
        let quotients = abs_rels.iter().zip(sq_rels.iter()).zip(ratios.iter());
        let terms = depths.zip(log_errors.iter()).zip(quotients).map(
            |(((&truth_m, &predicted_m), &log_error), ((&abs_rel, &sq_rel), &ratio))| Terms {
                truth_m,
                predicted_m,
                log_error,
                abs_rel,
                sq_rel,
                ratio,
            },
        );
        list.extend(terms);
    }
}

/// A function of two depths at each of some pixels.
#[inline(always)]
fn of_each(
    found: &mut [f64; AT_A_TIME],
    truth_m: &[f64],
    predicted_m: &[f64],
    term: impl Fn(f64, f64) -> f64,
) {
    let found = &mut found[..truth_m.len()];
    for ((found, &g), &p) in found.iter_mut().zip(truth_m).zip(predicted_m) {
        *found = term(g, p);
    }
}

#[inline(always)]
fn log_error(g: f64, p: f64) -> f64 {
    ln(g) - ln(p)
}

#[inline(always)]
fn abs_rel(g: f64, p: f64) -> f64 {
    (g - p).abs() / g
}

#[inline(always)]
fn sq_rel(g: f64, p: f64) -> f64 {
    (g - p) * (g - p) / g
}

/// The other quotient is at most 1.
#[inline(always)]
fn ratio(g: f64, p: f64) -> f64 {
    let (most, least) = if g > p { (g, p) } else { (p, g) };
    most / least
}

/// Sums over pixels.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Tally {
    count: u64,
    abs_rel: f64,
    sq_rel: f64,
    squared: f64,
    squared_log: f64,
    /// With ratios below 1.25, its square and its cube.
    within: [u64; 3],
    log: f64,
    abs_log: f64,
    absolute: f64,
    squared_ratio: f64,
    squared_inverse: f64,
}

impl Tally {
    /// Adds pixels one after the other, whose sums stay in the processor's registers meanwhile.
    pub(crate) fn add_all<const FURTHER: bool>(&mut self, terms: &[Terms], strict: bool) {
        let mut sums = *self;
        for terms in terms {
            sums.add::<FURTHER>(terms, strict);
        }
        *self = sums;
    }

    /// Adds a pixel; what the further metrics need only if `FURTHER`. With `strict`, a ratio equal to a
    /// threshold lies outside it.
    #[inline]
    pub(crate) fn add<const FURTHER: bool>(&mut self, terms: &Terms, strict: bool) {
        let error = terms.truth_m - terms.predicted_m;
        let log_error = terms.log_error;
        self.count += 1;
        self.abs_rel += terms.abs_rel;
        self.sq_rel += terms.sq_rel;
        self.squared += error * error;
        self.squared_log += log_error * log_error;
        for (hits, threshold) in
            self.within
                .iter_mut()
                .zip([1.25_f64, 1.25 * 1.25, 1.25 * 1.25 * 1.25])
        {
            // Below the next number lies the threshold itself as well.
            let limit = if strict {
                threshold
            } else {
                threshold.next_up()
            };
            *hits += u64::from(terms.ratio < limit);
        }
        if FURTHER {
            self.log += log_error;
            self.abs_log += log_error.abs();
            self.absolute += error.abs();
            self.squared_ratio += terms.abs_rel * terms.abs_rel;
            // (1/p - 1/g) = (g - p) / (g p), whose sign is lost in the square.
            let inverse = terms.abs_rel / terms.predicted_m;
            self.squared_inverse += inverse * inverse;
        }
    }

    /// How many pixels there are.
    pub(crate) fn count(&self) -> u64 {
        self.count
    }

    /// Sum of squared errors in m^2.
    pub(crate) fn sum_squared_error(&self) -> f64 {
        self.squared
    }

    /// `None` without pixels.
    pub(crate) fn metrics(&self) -> Option<Metrics> {
        if self.count == 0 {
            return None;
        }
        let n = self.count as f64;
        let [a1, a2, a3] = self.within.map(|hits| hits as f64 / n);
        Some(Metrics {
            abs_rel: self.abs_rel / n,
            sq_rel: self.sq_rel / n,
            rmse: (self.squared / n).sqrt(),
            rmse_log: (self.squared_log / n).sqrt(),
            a1,
            a2,
            a3,
        })
    }

    /// Of pixels that were added with what these need; `None` without pixels.
    pub(crate) fn further_metrics(&self) -> Option<FurtherMetrics> {
        if self.count == 0 {
            return None;
        }
        let n = self.count as f64;
        let mean_log = self.log / n;
        let variance = self.squared_log / n - mean_log * mean_log;
        Some(FurtherMetrics {
            // Rounding may leave less than nothing of a spread of zero.
            silog: 100.0 * variance.max(0.0).sqrt(),
            log10: self.abs_log / n / std::f64::consts::LN_10,
            irmse: 1000.0 * (self.squared_inverse / n).sqrt(),
            mae: self.absolute / n,
            sq_rel_2: self.squared_ratio / n,
        })
    }
}

/// Metrics and sum of squared errors (m^2) over pairs of true and predicted depth in metres,
/// all positive and finite; `None` without pairs. With `strict`, a ratio equal to a threshold
/// lies outside it, as in the reference.
pub fn depth_metrics(
    pairs: impl IntoIterator<Item = (f64, f64)>,
    strict: bool,
) -> Option<(Metrics, f64)> {
    let tally = tally::<false>(pairs, strict);
    Some((tally.metrics()?, tally.sum_squared_error()))
}

/// As [`depth_metrics`], with the further metrics from the same pass.
pub fn all_metrics(
    pairs: impl IntoIterator<Item = (f64, f64)>,
    strict: bool,
) -> Option<(Metrics, FurtherMetrics, f64)> {
    let tally = tally::<true>(pairs, strict);
    Some((
        tally.metrics()?,
        tally.further_metrics()?,
        tally.sum_squared_error(),
    ))
}

fn tally<const FURTHER: bool>(pairs: impl IntoIterator<Item = (f64, f64)>, strict: bool) -> Tally {
    let mut tally = Tally::default();
    for (g, p) in pairs {
        tally.add::<FURTHER>(&Terms::new(g, p), strict);
    }
    tally
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::FurtherMetric;

    #[test]
    fn perfect_prediction() {
        let (m, sse) = depth_metrics([2.0, 10.0, 40.0].map(|g| (g, g)), true).unwrap();
        assert_eq!(m.to_array(), [0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0]);
        assert_eq!(sse, 0.0);
    }

    /// Worked by hand: errors 1 and -2 for depths 2 and 8.
    #[test]
    fn two_pixels_by_hand() {
        let (m, sse) = depth_metrics([(2.0, 1.0), (8.0, 10.0)], true).unwrap();
        assert_eq!(m.abs_rel, (0.5 + 0.25) / 2.0);
        assert_eq!(m.sq_rel, (0.5 + 0.5) / 2.0);
        assert_eq!(m.rmse, 2.5_f64.sqrt());
        let log = ((2.0_f64.ln().powi(2) + 0.8_f64.ln().powi(2)) / 2.0).sqrt();
        assert!((m.rmse_log - log).abs() < 1e-15);
        // Ratios 2 and exactly 1.25: the second is not below 1.25, the first not below 1.953.
        assert_eq!([m.a1, m.a2, m.a3], [0.0, 0.5, 0.5]);
        assert_eq!(sse, 5.0);
        let (lenient, _) = depth_metrics([(2.0, 1.0), (8.0, 10.0)], false).unwrap();
        assert_eq!(lenient.a1, 0.5);
    }

    /// By hand: a depth that is right up to a factor has no scale-invariant error.
    #[test]
    fn further_metrics_by_hand() {
        let pairs = [(2.0, 2.2), (10.0, 11.0), (40.0, 44.0)];
        let (seven, further, squared) = all_metrics(pairs, true).unwrap();
        assert_eq!(depth_metrics(pairs, true), Some((seven, squared)));
        assert!(further.silog < 1e-6, "{further:?}");
        assert!((further.log10 - 1.1_f64.log10()).abs() < 1e-12);
        assert!((further.mae - (0.2 + 1.0 + 4.0) / 3.0).abs() < 1e-12);
        assert!((further.sq_rel_2 - 0.01).abs() < 1e-12);
        // 1/2.2 - 1/2 = -0.0454..., 1/11 - 1/10 = -0.0090..., 1/44 - 1/40 = -0.0022...
        let inverse = [1.0 / 22.0, 1.0 / 110.0, 1.0 / 440.0].map(|e: f64| 1e6 * e * e);
        assert!((further.irmse - (inverse.iter().sum::<f64>() / 3.0).sqrt()).abs() < 1e-9);
        // d = ln(p/g) of ln 2 and -ln 2: no mean, a spread of ln 2.
        let (_, further, _) = all_metrics([(1.0, 2.0), (4.0, 2.0)], true).unwrap();
        assert!((further.silog - 100.0 * 2.0_f64.ln()).abs() < 1e-9);
        assert_eq!(
            FurtherMetric::ALL.map(|m| further.get(m)),
            further.to_array()
        );
        assert_eq!(FurtherMetrics::from_array(further.to_array()), further);
    }

    #[test]
    fn nothing_to_score() {
        assert_eq!(depth_metrics([], true), None);
        assert_eq!(all_metrics([], true), None);
    }
}
