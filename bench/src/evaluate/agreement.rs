//! How a model's depth lies beside the truth as a whole: its scale and its order.
//!
//! Two figures of each image, over about a thousand of its measured pixels: the ratio of the median
//! true depth to the median predicted depth, and the rank correlation of the two. A wrong `scale`, a
//! wrong camera, maps in another order and disparity that is called depth show here at once, while
//! Abs Rel only becomes larger. Not here: figures for tables; these are for warnings.

use serde::{Deserialize, Serialize};

/// Pixels of an image that are looked at, at least where there are as many.
const SAMPLED: usize = 1000;

/// Ratios of medians that need no explanation.
pub(super) const SENSIBLE_RATIO: std::ops::RangeInclusive<f64> = 0.75..=1.33;

/// Deviation of the ratios from image to image, by their mean, that needs none.
pub(super) const SENSIBLE_SPREAD: f64 = 0.35;

/// Rank correlation below which something is wrong.
const SENSIBLE_RANK: f64 = 0.5;

/// One image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImageAgreement {
    /// Median true depth by median predicted depth; none where the prediction has no scale.
    pub ratio: Option<f64>,
    /// Spearman's, from -1 to 1; none where all true depths are the same.
    pub rank_correlation: Option<f64>,
}

/// Compares pairs of true and predicted depth of one image.
pub(super) fn of_image(pairs: &[(f32, f32)], has_scale: bool) -> Option<ImageAgreement> {
    let (truth, predicted): (Vec<f32>, Vec<f32>) = pairs.iter().copied().unzip();
    let (truth_m, predicted_m) = (median(&truth)?, median(&predicted)?);
    let ratio = truth_m / predicted_m;
    Some(ImageAgreement {
        ratio: (has_scale && ratio.is_finite() && ratio > 0.0).then_some(ratio),
        rank_correlation: spearman(&truth, &predicted),
    })
}

/// Every how manyth of `count` measured pixels is looked at.
pub(super) fn stride(count: usize) -> usize {
    (count / SAMPLED).max(1)
}

fn median(values: &[f32]) -> Option<f64> {
    let mut values: Vec<f64> = values.iter().map(|&value| value.into()).collect();
    strat_metrics::median(&mut values)
}

/// Pearson's correlation of ranks, equal values sharing the mean of theirs. 0 where the prediction
/// is the same everywhere; none where the truth is.
pub(super) fn spearman(truth: &[f32], predicted: &[f32]) -> Option<f64> {
    let (a, b) = (ranks(truth), ranks(predicted));
    let mean = (a.len() as f64 - 1.0) / 2.0;
    let products = |a: &[f64], b: &[f64]| -> f64 {
        let pairs = a.iter().zip(b);
        pairs.map(|(a, b)| (a - mean) * (b - mean)).sum()
    };
    let (of_truth, of_predicted) = (products(&a, &a), products(&b, &b));
    if of_truth <= 0.0 {
        return None;
    }
    if of_predicted <= 0.0 {
        return Some(0.0);
    }
    Some(products(&a, &b) / (of_truth * of_predicted).sqrt())
}

fn ranks(values: &[f32]) -> Vec<f64> {
    // Whole numbers in the order of the values, with the places of these, are sorted without a look at them.
    let key = |value: f32| {
        let bits = value.to_bits();
        let is_negative = bits >> 31 == 1;
        if is_negative { !bits } else { bits | 1 << 31 }
    };
    let mut order: Vec<u64> = (0_u64..)
        .zip(values)
        .map(|(index, value)| u64::from(key(*value)) << 32 | index)
        .collect();
    order.sort_unstable();
    let value = |place: u64| values[(place & u64::from(u32::MAX)) as usize];
    let mut ranks = vec![0.0; values.len()];
    let mut first = 0;
    for run in order.chunk_by(|&a, &b| value(a) == value(b)) {
        let shared = first as f64 + (run.len() as f64 - 1.0) / 2.0;
        for &place in run {
            ranks[(place & u64::from(u32::MAX)) as usize] = shared;
        }
        first += run.len();
    }
    ranks
}

/// All images of a model.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Agreement {
    /// Images that were looked at.
    pub images: usize,
    /// Mean of the images' ratios of medians, true by predicted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub median_ratio: Option<f64>,
    /// Standard deviation of those ratios over the images.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub median_ratio_deviation: Option<f64>,
    /// Mean of the images' rank correlations.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rank_correlation: Option<f64>,
}

impl Agreement {
    /// Sums up images; none without any.
    #[must_use]
    pub fn of(images: &[ImageAgreement]) -> Option<Self> {
        let mean = |values: &[f64]| {
            let sum: f64 = values.iter().sum();
            (!values.is_empty()).then(|| sum / values.len() as f64)
        };
        let ratios: Vec<f64> = images.iter().filter_map(|image| image.ratio).collect();
        let ranks: Vec<f64> = images
            .iter()
            .filter_map(|image| image.rank_correlation)
            .collect();
        let ratio = mean(&ratios);
        let squares: Vec<f64> = ratio
            .map(|mean| ratios.iter().map(|ratio| (ratio - mean).powi(2)).collect())
            .unwrap_or_default();
        (!images.is_empty()).then(|| Self {
            images: images.len(),
            median_ratio: ratio,
            median_ratio_deviation: mean(&squares).map(f64::sqrt),
            rank_correlation: mean(&ranks),
        })
    }

    /// One line for people.
    #[must_use]
    pub fn text(&self) -> String {
        let images = self.images;
        let ratio = match (self.median_ratio, self.median_ratio_deviation) {
            (Some(ratio), Some(deviation)) => {
                format!("true/predicted median {ratio:.2} ± {deviation:.2} over {images} images")
            }
            _ => format!("scale unknown, {images} images"),
        };
        match self.rank_correlation {
            Some(rank) => format!("{ratio}, rank correlation {rank:.2}"),
            None => ratio,
        }
    }

    /// What is outside sensible bounds, with the likely causes.
    #[must_use]
    pub fn doubts(&self) -> Vec<String> {
        let mut doubts = Vec::new();
        if let Some(rank) = self.rank_correlation.filter(|rank| *rank < SENSIBLE_RANK) {
            doubts.push(if rank < -0.2 {
                format!(
                    "what is far is predicted near and the reverse (rank correlation {rank:.2}): is \
                     `meaning` depth where the numbers are disparity, or the reverse?"
                )
            } else {
                format!(
                    "predicted depth hardly follows the true one (rank correlation {rank:.2}): are maps \
                     in another order than the images, is `channel` another map, or has the model \
                     learnt nothing?"
                )
            });
        }
        if let (Some(ratio), Some(deviation)) = (self.median_ratio, self.median_ratio_deviation) {
            if !SENSIBLE_RATIO.contains(&ratio) {
                doubts.push(format!(
                    "true depth is {ratio:.2} times the predicted one in the median: are `scale`, \
                     `meaning`, baseline and focal length those of this model?"
                ));
            }
            if deviation > SENSIBLE_SPREAD * ratio {
                doubts.push(format!(
                    "the scale of its depth differs from image to image ({ratio:.2} ± {deviation:.2}): \
                     are maps in another order than the images, or is the scale unknown \
                     (`meaning: inverse_depth` without `scale`)?"
                ));
            }
        }
        doubts
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Recipe: scipy 1.17.1, `scipy.stats.spearmanr([1, 2, 2, 4, 8], [3, 1, 4, 4, 9])`, worked out
    /// by hand as well: ranks 0, 1.5, 1.5, 3, 4 and 1, 0, 2.5, 2.5, 4; sums of products of their
    /// deviations 7.25, 9.5 and 9.5.
    #[test]
    fn ranks_correlate_as_by_hand() {
        let rank = spearman(&[1.0, 2.0, 2.0, 4.0, 8.0], &[3.0, 1.0, 4.0, 4.0, 9.0]).unwrap();
        assert!((rank - 7.25 / 9.5).abs() < 1e-12, "{rank}");
        assert_eq!(spearman(&[1.0, 2.0], &[5.0, 5.0]), Some(0.0));
        assert_eq!(spearman(&[2.0, 2.0], &[1.0, 5.0]), None);
        assert_eq!(
            spearman(&[1.0, 2.0, 3.0], &[9.0, 8.0, f32::NEG_INFINITY]),
            Some(-1.0)
        );
    }

    #[test]
    fn an_image_has_a_ratio_and_an_order() {
        let pairs = [(10.0, 5.0), (20.0, 10.0), (40.0, 20.0)];
        let image = of_image(&pairs, true).unwrap();
        assert_eq!(
            (image.ratio, image.rank_correlation),
            (Some(2.0), Some(1.0))
        );
        assert_eq!(of_image(&pairs, false).unwrap().ratio, None);
        assert_eq!(of_image(&[], true), None);
    }

    fn of(ratios: &[f64], rank: f64) -> Agreement {
        let images: Vec<ImageAgreement> = ratios
            .iter()
            .map(|ratio| ImageAgreement {
                ratio: Some(*ratio),
                rank_correlation: Some(rank),
            })
            .collect();
        Agreement::of(&images).unwrap()
    }

    #[test]
    fn the_line_says_scale_spread_and_order() {
        let good = of(&[0.98, 1.02, 1.06], 0.97);
        assert_eq!(
            good.text(),
            "true/predicted median 1.02 ± 0.03 over 3 images, rank correlation 0.97"
        );
        assert!(good.doubts().is_empty());
    }

    #[test]
    fn what_is_outside_sensible_bounds_is_doubted_with_its_cause() {
        let scale = of(&[2.0, 2.02], 0.97).doubts().join("\n");
        assert!(
            scale.contains("`scale`") && !scale.contains("order"),
            "{scale}"
        );
        let order = of(&[0.5, 1.5], 0.9).doubts().join("\n");
        assert!(order.contains("another order"), "{order}");
        let reversed = of(&[500.0, 510.0], -0.95).doubts().join("\n");
        assert!(reversed.contains("the reverse"), "{reversed}");
        assert!(!of(&[1.0], 0.1).doubts().is_empty());
    }
}
