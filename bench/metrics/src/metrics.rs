//! The seven depth metrics, five further ones, D1-all, crop boxes and the median.
//!
//! Formulas: PROTOCOL 3.1, 3.2, 3.6, 10.2 and 10.3 (the traditional forms of Eigen et al.: squared error
//! is divided by depth, not by its square; logarithms are natural). All sums are taken in
//! double precision. What is a valid pixel is decided in [`evaluate`](crate::evaluate()).

use serde::{Deserialize, Serialize};

use crate::protocol::{Crop, D1Rule};

/// One of the seven metrics, in the order of the thesis' tables.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Metric {
    /// Mean of |g - p| / g.
    AbsRel,
    /// Mean of (g - p)^2 / g, metres.
    SqRel,
    /// Root of the mean of (g - p)^2, metres.
    Rmse,
    /// Root of the mean of (ln g - ln p)^2.
    RmseLog,
    /// Fraction of pixels with max(g/p, p/g) < 1.25.
    A1,
    /// The same with 1.25^2.
    A2,
    /// The same with 1.25^3.
    A3,
}

impl Metric {
    /// All seven, in the order of [`Metrics::to_array`].
    pub const ALL: [Self; 7] = [
        Self::AbsRel,
        Self::SqRel,
        Self::Rmse,
        Self::RmseLog,
        Self::A1,
        Self::A2,
        Self::A3,
    ];

    /// Column name in CSV files.
    pub fn name(self) -> &'static str {
        match self {
            Self::AbsRel => "abs_rel",
            Self::SqRel => "sq_rel",
            Self::Rmse => "rmse",
            Self::RmseLog => "rmse_log",
            Self::A1 => "a1",
            Self::A2 => "a2",
            Self::A3 => "a3",
        }
    }

    /// Heading for people.
    pub fn heading(self) -> &'static str {
        match self {
            Self::AbsRel => "Abs Rel",
            Self::SqRel => "Sq Rel",
            Self::Rmse => "RMSE",
            Self::RmseLog => "RMSE log",
            Self::A1 => "δ<1.25",
            Self::A2 => "δ<1.25²",
            Self::A3 => "δ<1.25³",
        }
    }

    /// True for errors, false for accuracies.
    pub fn lower_is_better(self) -> bool {
        !matches!(self, Self::A1 | Self::A2 | Self::A3)
    }
}

/// Values of the seven metrics for one image, or their means over images.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Metrics {
    /// Mean of |g - p| / g.
    pub abs_rel: f64,
    /// Mean of (g - p)^2 / g, metres.
    pub sq_rel: f64,
    /// Root of the mean of (g - p)^2, metres.
    pub rmse: f64,
    /// Root of the mean of (ln g - ln p)^2.
    pub rmse_log: f64,
    /// Fraction of pixels within a factor of 1.25.
    pub a1: f64,
    /// Fraction of pixels within a factor of 1.25^2.
    pub a2: f64,
    /// Fraction of pixels within a factor of 1.25^3.
    pub a3: f64,
}

impl Metrics {
    /// Values in the order of [`Metric::ALL`].
    pub fn to_array(self) -> [f64; 7] {
        [
            self.abs_rel,
            self.sq_rel,
            self.rmse,
            self.rmse_log,
            self.a1,
            self.a2,
            self.a3,
        ]
    }

    /// The inverse of [`Metrics::to_array`].
    pub fn from_array(values: [f64; 7]) -> Self {
        let [abs_rel, sq_rel, rmse, rmse_log, a1, a2, a3] = values;
        Self {
            abs_rel,
            sq_rel,
            rmse,
            rmse_log,
            a1,
            a2,
            a3,
        }
    }

    /// One value.
    pub fn get(self, metric: Metric) -> f64 {
        self.to_array()[metric as usize]
    }
}

/// One of the metrics of PROTOCOL 10.3, which newer papers print beside or instead of the seven.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum FurtherMetric {
    /// 100 times the standard deviation of ln p - ln g.
    Silog,
    /// Mean of |log10 p - log10 g|.
    Log10,
    /// Root of the mean of (1000 / p - 1000 / g)^2, 1/km.
    Irmse,
    /// Mean of |g - p|, metres.
    Mae,
    /// Mean of (g - p)^2 / g^2: what KITTI's development kit calls `sq_rel`.
    SqRel2,
}

impl FurtherMetric {
    /// All of them, in the order of [`FurtherMetrics::to_array`]. Each is an error: lower is better.
    pub const ALL: [Self; 5] = [
        Self::Silog,
        Self::Log10,
        Self::Irmse,
        Self::Mae,
        Self::SqRel2,
    ];

    /// Column name in CSV files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Silog => "silog",
            Self::Log10 => "log10",
            Self::Irmse => "irmse",
            Self::Mae => "mae",
            Self::SqRel2 => "sq_rel_2",
        }
    }

    /// Heading for people.
    pub fn heading(self) -> &'static str {
        match self {
            Self::Silog => "SILog",
            Self::Log10 => "log10",
            Self::Irmse => "iRMSE",
            Self::Mae => "MAE",
            Self::SqRel2 => "Sq Rel/g²",
        }
    }
}

/// Values of the further metrics for one image, or their means over images.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FurtherMetrics {
    /// 100 times the standard deviation of ln p - ln g.
    pub silog: f64,
    /// Mean of |log10 p - log10 g|.
    pub log10: f64,
    /// Root of the mean of (1000 / p - 1000 / g)^2, 1/km.
    pub irmse: f64,
    /// Mean of |g - p|, metres.
    pub mae: f64,
    /// Mean of (g - p)^2 / g^2.
    pub sq_rel_2: f64,
}

impl FurtherMetrics {
    /// Values in the order of [`FurtherMetric::ALL`].
    pub fn to_array(self) -> [f64; 5] {
        [self.silog, self.log10, self.irmse, self.mae, self.sq_rel_2]
    }

    /// The inverse of [`FurtherMetrics::to_array`].
    pub fn from_array(values: [f64; 5]) -> Self {
        let [silog, log10, irmse, mae, sq_rel_2] = values;
        Self {
            silog,
            log10,
            irmse,
            mae,
            sq_rel_2,
        }
    }

    /// One value.
    pub fn get(self, metric: FurtherMetric) -> f64 {
        self.to_array()[metric as usize]
    }
}

/// What the metrics sum up of one pixel: functions of its two depths alone, each of them costly.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Terms {
    /// True depth g in metres.
    truth_m: f64,
    /// Predicted depth p in metres.
    predicted_m: f64,
    ln_truth: f64,
    ln_predicted: f64,
    /// |g - p| / g.
    abs_rel: f64,
    /// (g - p)^2 / g.
    sq_rel: f64,
    /// max(g / p, p / g).
    ratio: f64,
}

impl Terms {
    pub(crate) fn new(truth_m: f64, predicted_m: f64) -> Self {
        Self::with_logarithm(truth_m, predicted_m, truth_m.ln())
    }

    /// These terms if they are those of two depths, or the terms of those.
    pub(crate) fn or_of(&self, truth_m: f64, predicted_m: f64) -> Self {
        if self.truth_m != truth_m {
            Self::new(truth_m, predicted_m)
        } else if self.predicted_m != predicted_m {
            Self::with_logarithm(truth_m, predicted_m, self.ln_truth)
        } else {
            *self
        }
    }

    fn with_logarithm(g: f64, p: f64, ln_truth: f64) -> Self {
        let error = g - p;
        Self {
            truth_m: g,
            predicted_m: p,
            ln_truth,
            ln_predicted: p.ln(),
            abs_rel: error.abs() / g,
            sq_rel: error * error / g,
            // The other one is at most 1.
            ratio: g.max(p) / g.min(p),
        }
    }
}

/// Metrics and sum of squared errors (m^2) over pairs of true and predicted depth in metres,
/// all positive and finite; `None` without pairs. With `strict`, a ratio equal to a threshold
/// lies outside it, as in the reference.
pub fn depth_metrics(
    pairs: impl IntoIterator<Item = (f64, f64)>,
    strict: bool,
) -> Option<(Metrics, f64)> {
    let terms = pairs.into_iter().map(|(g, p)| Terms::new(g, p));
    let (metrics, _, squared) = sums::<false>(terms, strict)?;
    Some((metrics, squared))
}

/// As [`depth_metrics`], with the further metrics from the same pass.
pub fn all_metrics(
    pairs: impl IntoIterator<Item = (f64, f64)>,
    strict: bool,
) -> Option<(Metrics, FurtherMetrics, f64)> {
    let terms = pairs.into_iter().map(|(g, p)| Terms::new(g, p));
    sums::<true>(terms, strict)
}

/// The further metrics are zeros where nobody asked for them.
pub(crate) fn sums<const FURTHER: bool>(
    pixels: impl IntoIterator<Item = Terms>,
    strict: bool,
) -> Option<(Metrics, FurtherMetrics, f64)> {
    let (mut abs_rel, mut sq_rel, mut squared, mut squared_log) = (0.0, 0.0, 0.0, 0.0);
    let (mut log, mut abs_log, mut squared_inverse) = (0.0, 0.0, 0.0);
    let (mut absolute, mut squared_ratio) = (0.0, 0.0);
    let mut within = [0_u64; 3];
    let mut count = 0_u64;
    for terms in pixels {
        let error = terms.truth_m - terms.predicted_m;
        let log_error = terms.ln_truth - terms.ln_predicted;
        abs_rel += terms.abs_rel;
        sq_rel += terms.sq_rel;
        squared += error * error;
        squared_log += log_error * log_error;
        if FURTHER {
            log += log_error;
            abs_log += log_error.abs();
            // (1/p - 1/g) = (g - p) / (g p), whose sign is lost in the square.
            let inverse = terms.abs_rel / terms.predicted_m;
            squared_ratio += terms.abs_rel * terms.abs_rel;
            squared_inverse += inverse * inverse;
            absolute += error.abs();
        }
        let ratio = terms.ratio;
        for (hits, threshold) in within
            .iter_mut()
            .zip([1.25, 1.25 * 1.25, 1.25 * 1.25 * 1.25])
        {
            *hits += u64::from(ratio < threshold || (!strict && ratio == threshold));
        }
        count += 1;
    }
    if count == 0 {
        return None;
    }
    let n = count as f64;
    let [a1, a2, a3] = within.map(|hits| hits as f64 / n);
    let metrics = Metrics {
        abs_rel: abs_rel / n,
        sq_rel: sq_rel / n,
        rmse: (squared / n).sqrt(),
        rmse_log: (squared_log / n).sqrt(),
        a1,
        a2,
        a3,
    };
    let mean_log = log / n;
    let further = FurtherMetrics {
        // Rounding may leave less than nothing of a spread of zero.
        silog: 100.0 * (squared_log / n - mean_log * mean_log).max(0.0).sqrt(),
        log10: abs_log / n / std::f64::consts::LN_10,
        irmse: 1000.0 * (squared_inverse / n).sqrt(),
        mae: absolute / n,
        sq_rel_2: squared_ratio / n,
    };
    Some((metrics, further, squared))
}

/// Percentage of wrong disparities over pairs of true and predicted disparity in pixels; pairs
/// without ground truth (0) are passed over; `None` where nothing is left.
///
/// Single precision throughout: the limits are met exactly by quarter-pixel disparities, and
/// the reference decides those cases in single precision.
pub fn d1_all(pairs: impl IntoIterator<Item = (f32, f32)>, rule: D1Rule) -> Option<f64> {
    let (mut wrong, mut count) = (0_u64, 0_u64);
    for (g, p) in pairs {
        if g > 0.0 {
            wrong += u64::from(is_wrong_disparity(g, p, rule));
            count += 1;
        }
    }
    (count > 0).then(|| 100.0 * wrong as f64 / count as f64)
}

fn is_wrong_disparity(g: f32, p: f32, rule: D1Rule) -> bool {
    let error = (g - p).abs();
    match rule {
        D1Rule::Inclusive => error >= 3.0 && error / g >= 0.05,
        D1Rule::Strict => error > 3.0 && error / g > 0.05,
    }
}

/// Half-open box of rows and columns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CropBox {
    /// First row.
    pub top: usize,
    /// One past the last row.
    pub bottom: usize,
    /// First column.
    pub left: usize,
    /// One past the last column.
    pub right: usize,
}

/// Box of a crop in an image. The fractions are multiplied in double precision and truncated;
/// rounding, or single precision, would move an edge for some KITTI sizes.
///
/// A box in pixels is returned as it is, and may be larger than the image.
pub fn crop_box(crop: Crop, width: usize, height: usize) -> CropBox {
    if let Crop::Pixels { rows, columns } = crop {
        let [top, bottom, left, right] =
            [rows[0], rows[1], columns[0], columns[1]].map(|edge| edge as usize);
        return CropBox {
            top,
            bottom,
            left,
            right,
        };
    }
    match crop.fractions() {
        None => CropBox {
            top: 0,
            bottom: height,
            left: 0,
            right: width,
        },
        Some([top, bottom, left, right]) => CropBox {
            top: (top * height as f64) as usize,
            bottom: (bottom * height as f64) as usize,
            left: (left * width as f64) as usize,
            right: (right * width as f64) as usize,
        },
    }
}

/// Rows and columns of KITTI's benchmark crop: at the bottom and in the middle; `None` for images
/// that are smaller (PROTOCOL 10.2).
pub fn benchmark_box(width: usize, height: usize) -> Option<CropBox> {
    const WIDTH: usize = 1216;
    const HEIGHT: usize = 352;
    let top = height.checked_sub(HEIGHT)?;
    let left = width.checked_sub(WIDTH)? / 2;
    Some(CropBox {
        top,
        bottom: height,
        left,
        right: left + WIDTH,
    })
}

impl CropBox {
    /// Columns and rows of it.
    #[must_use]
    pub fn size(self) -> (usize, usize) {
        (self.right - self.left, self.bottom - self.top)
    }

    /// Whether a pixel lies inside.
    #[must_use]
    pub fn has(self, row: usize, column: usize) -> bool {
        (self.top..self.bottom).contains(&row) && (self.left..self.right).contains(&column)
    }

    /// A box within this one, given by its own rows and columns, in those of the image.
    #[must_use]
    pub fn placed(self, inner: Self) -> Self {
        Self {
            top: self.top + inner.top,
            bottom: self.top + inner.bottom,
            left: self.left + inner.left,
            right: self.left + inner.right,
        }
    }
}

/// Median; the mean of the two middle values for an even count; `None` for an empty slice.
/// Reorders the values.
pub fn median(values: &mut [f64]) -> Option<f64> {
    let middle = values.len() / 2;
    if values.is_empty() {
        return None;
    }
    let even = values.len().is_multiple_of(2);
    let (lower, upper, _) = values.select_nth_unstable_by(middle, f64::total_cmp);
    let upper = *upper;
    if !even {
        return Some(upper);
    }
    let lower = lower.iter().copied().max_by(f64::total_cmp)?;
    Some((lower + upper) / 2.0)
}

#[cfg(test)]
mod tests {
    use super::*;

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

    #[test]
    fn nothing_to_score() {
        assert_eq!(depth_metrics([], true), None);
        assert_eq!(d1_all([(0.0, 9.0)], D1Rule::Inclusive), None);
    }

    #[test]
    fn d1_limits() {
        // By hand: error 3 px of 10 px; 2.9 px; 4 px but only 4 %; no ground truth.
        let pairs = [(10.0, 13.0), (10.0, 12.9), (100.0, 104.0), (0.0, 9.0)];
        assert_eq!(d1_all(pairs, D1Rule::Inclusive), Some(100.0 / 3.0));
        assert_eq!(d1_all(pairs, D1Rule::Strict), Some(0.0));
        // Error of exactly 5 %.
        assert_eq!(d1_all([(80.0, 84.0)], D1Rule::Inclusive), Some(100.0));
        assert_eq!(d1_all([(80.0, 84.0)], D1Rule::Strict), Some(0.0));
    }

    /// The table of PROTOCOL 3.6.
    #[test]
    fn crop_boxes_of_all_kitti_sizes() {
        let table = [
            (375, 1242, [153, 371, 44, 1197], [124, 342, 44, 1197]),
            (370, 1224, [151, 366, 43, 1180], [122, 337, 43, 1180]),
            (370, 1226, [151, 366, 44, 1181], [122, 337, 44, 1181]),
            (374, 1238, [152, 370, 44, 1193], [124, 341, 44, 1193]),
            (376, 1241, [153, 372, 44, 1196], [124, 343, 44, 1196]),
        ];
        for (height, width, garg, eigen) in table {
            for (crop, edges) in [(Crop::Garg, garg), (Crop::Eigen, eigen)] {
                let [top, bottom, left, right] = edges;
                let expected = CropBox {
                    top,
                    bottom,
                    left,
                    right,
                };
                assert_eq!(crop_box(crop, width, height), expected, "{width}x{height}");
            }
        }
        let whole = crop_box(Crop::None, 7, 3);
        assert_eq!((whole.bottom, whole.right), (3, 7));
        let nyu = Crop::Pixels {
            rows: [45, 471],
            columns: [41, 601],
        };
        let nyu = crop_box(nyu, 640, 480);
        assert_eq!(
            [nyu.top, nyu.bottom, nyu.left, nyu.right],
            [45, 471, 41, 601]
        );
    }

    /// By hand from the table of PROTOCOL 10.2: rows 23 to 374, columns 13 to 1228.
    #[test]
    fn the_benchmark_crop_is_at_the_bottom_and_in_the_middle() {
        let cut = benchmark_box(1242, 375).unwrap();
        assert_eq!(
            [cut.top, cut.bottom, cut.left, cut.right],
            [23, 375, 13, 1229]
        );
        let odd = benchmark_box(1241, 376).unwrap();
        assert_eq!([odd.top, odd.left, odd.right], [24, 12, 1228]);
        assert_eq!(cut.size(), (1216, 352));
        assert_eq!(benchmark_box(1216, 351), None);
        assert_eq!(benchmark_box(1215, 352), None);
        // Garg's and Eigen's boxes of all KITTI sizes lie inside; Eigen's of the cut image is moved.
        for (height, width) in [
            (375, 1242),
            (370, 1224),
            (370, 1226),
            (374, 1238),
            (376, 1241),
        ] {
            let cut = benchmark_box(width, height).unwrap();
            for crop in [Crop::Garg, Crop::Eigen] {
                let inner = crop_box(crop, width, height);
                assert!(cut.has(inner.top, inner.left), "{width}x{height}");
                assert!(
                    cut.has(inner.bottom - 1, inner.right - 1),
                    "{width}x{height}"
                );
            }
        }
        let eigen = cut.placed(crop_box(Crop::Eigen, 1216, 352));
        assert_eq!(
            [eigen.top, eigen.bottom, eigen.left, eigen.right],
            [23 + 117, 23 + 321, 13 + 43, 13 + 1172]
        );
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
    fn medians() {
        assert_eq!(median(&mut []), None);
        assert_eq!(median(&mut [3.0, 1.0, 2.0]), Some(2.0));
        assert_eq!(median(&mut [4.0, 1.0, 3.0, 2.0]), Some(2.5));
        assert_eq!(median(&mut [5.0, 5.0]), Some(5.0));
    }

    #[test]
    fn arrays_keep_the_order() {
        let values = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0];
        let metrics = Metrics::from_array(values);
        assert_eq!(metrics.to_array(), values);
        assert_eq!(Metric::ALL.map(|m| metrics.get(m)), values);
        assert_eq!(metrics.rmse_log, metrics.get(Metric::RmseLog));
    }
}
