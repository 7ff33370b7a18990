//! What the seven depth metrics and the five further ones are called; D1-all, crop boxes and the median.
//!
//! Formulas: PROTOCOL 3.2, 3.6 and 10.2. What is a valid pixel is decided in [`evaluate`](crate::evaluate()), and
//! what the metrics of its pixels are in [`crate::sums`].

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

    /// Unit; empty where it is a ratio.
    pub fn unit(self) -> &'static str {
        match self {
            Self::SqRel | Self::Rmse => "m",
            _ => "",
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

    /// Unit; empty where there is none.
    pub fn unit(self) -> &'static str {
        match self {
            Self::Irmse => "1/km",
            Self::Mae => "m",
            Self::Silog | Self::Log10 | Self::SqRel2 => "",
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

/// Percentage of wrong disparities over pairs of true and predicted disparity in pixels; pairs
/// without ground truth (0) are passed over; `None` where nothing is left.
///
/// Single precision throughout: the limits are met exactly by quarter-pixel disparities, and
/// the reference decides those cases in single precision.
pub fn d1_all(pairs: impl IntoIterator<Item = (f32, f32)>, rule: D1Rule) -> Option<f64> {
    let mut wrong = WrongDisparities::default();
    for (g, p) in pairs {
        wrong.add(g, p, rule);
    }
    wrong.percentage()
}

/// Counts what [`d1_all`] is the percentage of.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct WrongDisparities {
    wrong: u64,
    count: u64,
}

impl WrongDisparities {
    /// A true and a predicted disparity in pixels; nothing where there is no true one (0).
    pub(crate) fn add(&mut self, g: f32, p: f32, rule: D1Rule) {
        if g > 0.0 {
            self.wrong += u64::from(is_wrong_disparity(g, p, rule));
            self.count += 1;
        }
    }

    /// `None` where nothing was counted.
    pub(crate) fn percentage(self) -> Option<f64> {
        (self.count > 0).then(|| 100.0 * self.wrong as f64 / self.count as f64)
    }
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
    fn no_disparity_is_not_wrong() {
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
