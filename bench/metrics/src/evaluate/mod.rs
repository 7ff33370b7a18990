//! Scores one image under a [`Protocol`].
//!
//! Order of steps, PROTOCOL 3.3 to 3.6 and 3.9: floor the disparity, turn it into depth, choose
//! the pixels, scale by medians if the protocol says so, clip, measure. Predictions arrive at
//! the size of the ground truth; how they were resized is the caller's business.
//!
//! # Precision
//!
//! The reference holds a prediction in single precision until it is compared: disparity in
//! pixels is `width * fraction` and depth `(focal * baseline) / disparity`, where the products
//! of plain numbers are double but the quotient is single. Both roundings are repeated here,
//! because a depth that is rounded otherwise may fall on the other side of an accuracy
//! threshold. Everything after that is double precision.

use std::borrow::Cow;

use crate::metrics::{CropBox, Metrics, crop_box, d1_all, depth_metrics, median};
use crate::protocol::{Camera, Group, Grouping, InfiniteDepth, LogBase, Protocol};

/// What is known of an image, row-major planes of `width * height` values.
#[derive(Clone, Copy, Debug)]
pub struct GroundTruth<'a> {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Depth in metres, 0 where there is none.
    pub depth_m: &'a [f32],
    /// Disparity in pixels, 0 where there is none. For stereo ground truth: depth is then
    /// computed from it in double precision, and it is what D1-all needs.
    pub disparity_px: Option<&'a [f32]>,
    /// Focal length in pixels of this image: the nominal one for a protocol with a nominal
    /// camera, that of the calibration otherwise; of no matter where the protocol brings its
    /// own camera or none.
    pub focal_px: f64,
    /// Baseline in metres from the calibration. A protocol with a nominal camera brings its
    /// own and does not look at this one.
    pub baseline_m: f64,
    /// Cityscapes label ids, for protocols with groups.
    pub labels: Option<&'a [u8]>,
    /// Where `depth_m` and `disparity_px` have something, if it was found before: worthwhile where
    /// several protocols look at the same planes.
    pub measured: Option<&'a MeasuredPixels>,
}

/// The pixels of an image that have ground truth, and that its planes hold nothing but usable
/// numbers.
#[derive(Clone, Debug)]
pub struct MeasuredPixels {
    width: usize,
    /// Row-major places in ascending order.
    places: Vec<u32>,
    /// Where each row begins in `places`, and the end.
    rows: Vec<usize>,
}

impl MeasuredPixels {
    /// Looks for them.
    ///
    /// # Errors
    /// Planes of wrong size, and values that are negative or not finite.
    pub fn find(truth: &GroundTruth<'_>) -> Result<Self, EvaluateError> {
        let (width, height) = (truth.width, truth.height);
        for (plane, what, values) in [
            ("depth ground truth", "depth", Some(truth.depth_m)),
            ("disparity ground truth", "disparity", truth.disparity_px),
        ] {
            let Some(values) = values else { continue };
            check_size(plane, values.len(), width, height)?;
            check_plane(values, width, |row, column, value| EvaluateError::Truth {
                what,
                row,
                column,
                value,
            })?;
        }
        // As many as a scan has, so that the list does not move while it grows.
        let mut places = Vec::with_capacity(truth.depth_m.len() / 16);
        let mut rows = Vec::with_capacity(height + 1);
        rows.push(0);
        for row in 0..height {
            let own = row * width..(row + 1) * width;
            match truth.disparity_px {
                None => find_in_row(&truth.depth_m[own.clone()], own.start, &mut places),
                // What has only one of the two is some protocol's ground truth as well.
                Some(disparity_px) => places.extend(
                    own.filter(|&place| truth.depth_m[place] != 0.0 || disparity_px[place] != 0.0)
                        .map(|place| place as u32),
                ),
            }
            rows.push(places.len());
        }
        Ok(Self {
            width,
            places,
            rows,
        })
    }

    /// Those within a part of the image, row by row.
    fn within(&self, crop: CropBox) -> impl Iterator<Item = usize> {
        (crop.top..crop.bottom).flat_map(move |row| {
            let own = &self.places[self.rows[row]..self.rows[row + 1]];
            let before = |column: usize| {
                let end = row * self.width + column;
                own.partition_point(|&place| (place as usize) < end)
            };
            own[before(crop.left)..before(crop.right)]
                .iter()
                .map(|&place| place as usize)
        })
    }
}

/// Nineteen of twenty pixels of a scan have nothing, most of them in runs: finding the others is
/// what takes time. Within a piece their places are gathered without a branch, since no processor
/// can foresee them.
fn find_in_row(row: &[f32], start: usize, found: &mut Vec<u32>) {
    for (start, piece) in (start..).step_by(PIECE).zip(row.chunks(PIECE)) {
        if piece.iter().fold(0, |all, value| all | value.to_bits()) == 0 {
            continue;
        }
        let (mut places, mut count) = ([0; PIECE], 0);
        for (place, value) in piece.iter().enumerate() {
            places[count % PIECE] = (start + place) as u32;
            count += usize::from(*value != 0.0);
        }
        found.extend_from_slice(&places[..count]);
    }
}

fn check_size(
    plane: &'static str,
    found: usize,
    width: usize,
    height: usize,
) -> Result<(), EvaluateError> {
    let expected = width.saturating_mul(height);
    if found == expected {
        Ok(())
    } else {
        Err(EvaluateError::Size {
            plane,
            found,
            expected,
            width,
            height,
        })
    }
}

/// Score of one image, or of one group of pixels in it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImageScore {
    /// The group, for protocols with groups.
    pub group: Option<Group>,
    /// The seven metrics.
    pub metrics: Metrics,
    /// D1-all in percent, where the protocol asks for it and the ground truth is disparity.
    pub d1_all: Option<f64>,
    /// Sum of squared errors in m^2, from which pooled errors are made.
    pub sum_squared_error: f64,
    /// Pixels scored; never 0.
    pub pixels: u64,
    /// Scored pixels whose disparity was raised to the floor.
    pub floored_pixels: u64,
}

/// Why an image was not scored.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum EvaluateError {
    /// A plane has another size than the ground truth.
    #[error("the {plane} has {found} values where {width} x {height} = {expected} are needed")]
    Size {
        /// Which plane.
        plane: &'static str,
        /// Its length.
        found: usize,
        /// Length needed.
        expected: usize,
        /// Columns of the ground truth.
        width: usize,
        /// Rows of the ground truth.
        height: usize,
    },
    /// A prediction that is negative or not finite.
    #[error(
        "the predicted {what} at row {row}, column {column} is {value}; predictions must be \
         finite and not negative, so the model or the way its output is read is at fault"
    )]
    Prediction {
        /// Disparity or depth.
        what: &'static str,
        /// 0-based row.
        row: usize,
        /// 0-based column.
        column: usize,
        /// The value.
        value: f32,
    },
    /// Ground truth that is negative or not finite.
    #[error(
        "the true {what} at row {row}, column {column} is {value}; ground truth must be finite \
         and not negative, so the file is damaged or no depth map"
    )]
    Truth {
        /// Disparity or depth.
        what: &'static str,
        /// 0-based row.
        row: usize,
        /// 0-based column.
        column: usize,
        /// The value.
        value: f32,
    },
    /// Focal length or baseline that is not a positive number.
    #[error("the {what} of the image is {value}; a positive number of common size is needed")]
    CameraValue {
        /// Focal length, baseline or their product.
        what: &'static str,
        /// The value.
        value: f64,
    },
    /// A protocol that cannot be followed, for instance one read from a file.
    #[error("protocol {name} cannot be followed: {reason}")]
    Protocol {
        /// Name of the protocol.
        name: String,
        /// What is wrong.
        reason: &'static str,
    },
    /// Something the protocol needs was not given.
    #[error("protocol {name} needs {what}, which this image does not have")]
    Missing {
        /// Name of the protocol.
        name: String,
        /// What it needs.
        what: &'static str,
    },
    /// No pixel passed the protocol's mask, or none of its groups occurs.
    #[error(
        "no pixel of this image is left under protocol {name} ({with_truth} pixels have ground \
         truth); an average over nothing is no number, so the image gets no score"
    )]
    NothingToScore {
        /// Name of the protocol.
        name: String,
        /// Pixels of the whole image with ground truth.
        with_truth: usize,
    },
    /// Half or more of the predicted depths are zero or infinite, so there is no median to
    /// scale by.
    #[error("the median of the predicted depth is {0} m; the prediction cannot be scaled by it")]
    Median(f64),
}

/// Scores a predicted disparity, given as a fraction of image width at the size of the ground
/// truth. Returns one score, or one per group that occurs in the image, in table order.
///
/// # Errors
/// Planes of wrong size, values that are negative or not finite, input that the protocol needs
/// and was not given, and an image without a pixel to score.
pub fn evaluate(
    protocol: &Protocol,
    truth: &GroundTruth<'_>,
    disparity_fraction: &[f32],
) -> Result<Vec<ImageScore>, EvaluateError> {
    let scene = Scene::new(protocol, truth)?;
    scene.check_prediction("disparity", disparity_fraction)?;
    let floor = protocol.disparity_floor_fraction as f32;
    let width = truth.width as f32;
    let focal_baseline = scene.focal_baseline as f32;
    let infinite = match protocol.infinite_depth {
        InfiniteDepth::FarLimit => f32::INFINITY,
        InfiniteDepth::NearLimit => 0.0,
    };
    scene.score(|index| {
        let disparity_px = width * disparity_fraction[index].max(floor);
        let depth_m = focal_baseline / disparity_px;
        Predicted {
            depth_m: if depth_m.is_infinite() {
                infinite
            } else {
                depth_m
            },
            disparity_px,
            floored: disparity_fraction[index] < floor,
        }
    })
}

/// Scores a predicted depth in metres at the size of the ground truth: for models that do not
/// predict disparity, and for baselines such as a constant map. A depth of 0 ends at the
/// near limit. The floor of the protocol does not apply.
///
/// # Errors
/// As for [`evaluate`].
pub fn evaluate_depth(
    protocol: &Protocol,
    truth: &GroundTruth<'_>,
    depth_m: &[f32],
) -> Result<Vec<ImageScore>, EvaluateError> {
    let scene = Scene::new(protocol, truth)?;
    scene.check_prediction("depth", depth_m)?;
    scene.score(|index| Predicted {
        depth_m: depth_m[index],
        disparity_px: (scene.focal_baseline / f64::from(depth_m[index])) as f32,
        floored: false,
    })
}

struct Predicted {
    depth_m: f32,
    disparity_px: f32,
    floored: bool,
}

/// A protocol and an image that were found to fit each other.
struct Scene<'a> {
    protocol: &'a Protocol,
    truth: &'a GroundTruth<'a>,
    measured: Cow<'a, MeasuredPixels>,
    /// Focal length times baseline: depth = this / disparity in pixels.
    focal_baseline: f64,
    /// Limits as the reference sees them beside single-precision depth.
    min_depth_m: f32,
    max_depth_m: f32,
}

struct Pixel {
    truth_m: f64,
    predicted_m: f32,
    /// True and predicted disparity in pixels.
    disparity_px: (f32, f32),
    floored: bool,
    group: Option<Group>,
}

impl<'a> Scene<'a> {
    fn new(protocol: &'a Protocol, truth: &'a GroundTruth<'a>) -> Result<Self, EvaluateError> {
        let invalid = |reason| EvaluateError::Protocol {
            name: protocol.name.clone(),
            reason,
        };
        let (min_depth_m, max_depth_m) = (protocol.min_depth_m as f32, protocol.max_depth_m as f32);
        if !(min_depth_m > 0.0 && min_depth_m < max_depth_m && max_depth_m.is_finite()) {
            return Err(invalid("its depth limits are not 0 < min < max"));
        }
        let floor = protocol.disparity_floor_fraction;
        if !(floor.is_finite() && floor >= 0.0) {
            return Err(invalid("its disparity floor is not a number from 0 up"));
        }

        let missing = |what| EvaluateError::Missing {
            name: protocol.name.clone(),
            what,
        };
        let measured = match truth.measured {
            Some(found) => Cow::Borrowed(found),
            None => Cow::Owned(MeasuredPixels::find(truth)?),
        };
        for (plane, found) in [
            ("depth ground truth", Some(truth.depth_m.len())),
            (
                "disparity ground truth",
                truth.disparity_px.map(<[f32]>::len),
            ),
            ("label image", truth.labels.map(<[u8]>::len)),
        ] {
            let Some(found) = found else { continue };
            check_size(plane, found, truth.width, truth.height)?;
        }
        if (measured.width, measured.rows.len()) != (truth.width, truth.height + 1) {
            return Err(missing("measured pixels of this very image"));
        }
        if protocol.grouping == Grouping::Cityscapes && truth.labels.is_none() {
            return Err(missing("an image of Cityscapes labels"));
        }

        let width = truth.width as f64;
        let (focal_px, baseline_m) = match protocol.camera {
            Camera::Nominal { baseline_m } => (truth.focal_px, baseline_m),
            Camera::Calibrated => (truth.focal_px, truth.baseline_m),
            Camera::Agreed {
                focal_fraction,
                baseline_m,
            } => (focal_fraction * width, baseline_m),
            // One metre for a disparity of the whole width: the scale is the median's anyway.
            Camera::Unknown if protocol.median_scaling => (width, 1.0),
            Camera::Unknown => {
                return Err(invalid("it has no camera, so it needs median scaling"));
            }
        };
        // The depth plane of stereo ground truth was made with the nominal baseline.
        if protocol.camera == Camera::Calibrated
            && protocol.ground_truth.is_stereo()
            && truth.disparity_px.is_none()
        {
            return Err(missing("ground truth as disparity"));
        }
        let focal_baseline = focal_px * baseline_m;
        for (what, value) in [
            ("focal length in pixels", focal_px),
            ("baseline in metres", baseline_m),
            ("product of focal length and baseline", focal_baseline),
        ] {
            if !(value > 0.0 && (value as f32).is_normal()) {
                return Err(EvaluateError::CameraValue { what, value });
            }
        }
        Ok(Self {
            protocol,
            truth,
            measured,
            focal_baseline,
            min_depth_m,
            max_depth_m,
        })
    }

    fn check_prediction(&self, what: &'static str, plane: &[f32]) -> Result<(), EvaluateError> {
        check_size(
            "prediction",
            plane.len(),
            self.truth.width,
            self.truth.height,
        )?;
        check_plane(plane, self.truth.width, |row, column, value| {
            EvaluateError::Prediction {
                what,
                row,
                column,
                value,
            }
        })
    }

    /// What was measured, 0 where nothing was, and whether it is disparity in pixels rather than
    /// depth in metres.
    fn measured_plane(&self) -> (&'a [f32], bool) {
        match self.truth.disparity_px {
            Some(disparity_px) if self.protocol.ground_truth.is_stereo() => (disparity_px, true),
            _ => (self.truth.depth_m, false),
        }
    }

    /// True depth of a pixel in metres; `None` where there is none or the protocol masks it.
    fn truth_m(&self, index: usize) -> Option<f64> {
        let (measured, is_disparity) = self.measured_plane();
        let measured = f64::from(measured[index]);
        if measured == 0.0 {
            return None;
        }
        let truth_m = if is_disparity {
            self.focal_baseline / measured
        } else {
            measured
        };
        let (min, max) = (f64::from(self.min_depth_m), f64::from(self.max_depth_m));
        let counts = if !self.protocol.mask_ground_truth {
            truth_m > 0.0
        } else if self.protocol.strict_comparisons {
            truth_m > min && truth_m < max
        } else {
            truth_m >= min && truth_m <= max
        };
        counts.then_some(truth_m)
    }

    fn score(
        &self,
        predict: impl Fn(usize) -> Predicted,
    ) -> Result<Vec<ImageScore>, EvaluateError> {
        let (protocol, truth) = (self.protocol, self.truth);
        let crop = crop_box(protocol.crop, truth.width, truth.height);
        let mut pixels = Vec::with_capacity(self.measured.places.len());
        for index in self.measured.within(crop) {
            let Some(truth_m) = self.truth_m(index) else {
                continue;
            };
            let predicted = predict(index);
            pixels.push(Pixel {
                truth_m,
                predicted_m: predicted.depth_m,
                disparity_px: (
                    truth.disparity_px.map_or(0.0, |plane| plane[index]),
                    predicted.disparity_px,
                ),
                floored: predicted.floored,
                group: match protocol.grouping {
                    Grouping::None => None,
                    Grouping::Cityscapes => {
                        truth.labels.and_then(|ids| Group::of_label(ids[index]))
                    }
                    Grouping::Distance => Group::of_depth(truth_m),
                },
            });
        }

        let scale = if protocol.median_scaling {
            self.median_ratio(&pixels)?
        } else {
            None
        };
        let scores: Vec<ImageScore> = match protocol.grouping {
            Grouping::None => self
                .summarise(None, pixels.iter(), scale)
                .into_iter()
                .collect(),
            grouping => grouping
                .groups()
                .iter()
                .filter_map(|&group| {
                    let members = pixels.iter().filter(|pixel| pixel.group == Some(group));
                    self.summarise(Some(group), members, scale)
                })
                .collect(),
        };
        if scores.is_empty() {
            return Err(EvaluateError::NothingToScore {
                name: protocol.name.clone(),
                with_truth: truth.depth_m.iter().filter(|&&depth| depth > 0.0).count(),
            });
        }
        Ok(scores)
    }

    /// median(true) / median(predicted) over all scored pixels; `None` without pixels.
    fn median_ratio(&self, pixels: &[Pixel]) -> Result<Option<f64>, EvaluateError> {
        let mut truth: Vec<f64> = pixels.iter().map(|pixel| pixel.truth_m).collect();
        let mut predicted: Vec<f64> = pixels.iter().map(|p| f64::from(p.predicted_m)).collect();
        let (Some(truth), Some(predicted)) = (median(&mut truth), median(&mut predicted)) else {
            return Ok(None);
        };
        if !(predicted.is_finite() && predicted > 0.0) {
            return Err(EvaluateError::Median(predicted));
        }
        Ok(Some(truth / predicted))
    }

    fn summarise<'p>(
        &self,
        group: Option<Group>,
        pixels: impl Iterator<Item = &'p Pixel> + Clone,
        scale: Option<f64>,
    ) -> Option<ImageScore> {
        let clipped = |pixel: &Pixel| {
            let scaled = f64::from(pixel.predicted_m) * scale.unwrap_or(1.0);
            scaled.clamp(f64::from(self.min_depth_m), f64::from(self.max_depth_m))
        };
        let pairs = pixels.clone().map(|pixel| (pixel.truth_m, clipped(pixel)));
        let (mut metrics, sum_squared_error) =
            depth_metrics(pairs, self.protocol.strict_comparisons)?;
        if self.protocol.log_base == LogBase::Ten {
            metrics.rmse_log /= std::f64::consts::LN_10;
        }
        // Scaled depth no longer belongs to the disparity it was made of.
        let d1_all = match self.protocol.d1_rule {
            Some(rule) if scale.is_none() => {
                d1_all(pixels.clone().map(|pixel| pixel.disparity_px), rule)
            }
            _ => None,
        };
        Some(ImageScore {
            group,
            metrics,
            d1_all,
            sum_squared_error,
            pixels: pixels.clone().count() as u64,
            floored_pixels: pixels.filter(|pixel| pixel.floored).count() as u64,
        })
    }
}

/// Pixels that are passed over in one go where nothing was measured.
const PIECE: usize = 16;

fn check_plane(
    plane: &[f32],
    width: usize,
    error: impl Fn(usize, usize, f32) -> EvaluateError,
) -> Result<(), EvaluateError> {
    let usable = |value: &f32| *value >= 0.0 && *value <= f32::MAX;
    // Whole pieces without a way out are many values at a time for the processor.
    let piece = |values: &[f32]| values.iter().fold(true, |all, value| all & usable(value));
    if plane.chunks(1024).all(piece) {
        return Ok(());
    }
    match plane.iter().position(|value| !usable(value)) {
        Some(index) => Err(error(index / width, index % width, plane[index])),
        None => Ok(()),
    }
}

/// Blends the disparity of an image with that of its mirror image (PROTOCOL 3.7), both
/// row-major at network size; `of_mirrored` as the network returned it, not mirrored back.
///
/// The left 5 % of the columns come from the mirrored pass and the right 5 % from the plain
/// one, where each knows what the other cannot see; up to 10 % one hands over to the average
/// of both.
///
/// # Panics
/// If the planes differ in length or are no whole number of rows.
pub fn flip_blend(disparity: &[f32], of_mirrored: &[f32], width: usize) -> Vec<f32> {
    assert_eq!(disparity.len(), of_mirrored.len(), "planes of one size");
    assert!(
        width > 0 && disparity.len().is_multiple_of(width),
        "whole rows"
    );
    let left_weight = |column: usize| {
        let t = column as f64 / (width.max(2) - 1) as f64;
        1.0 - (20.0 * (t - 0.05)).clamp(0.0, 1.0)
    };
    let mut blended = Vec::with_capacity(disparity.len());
    for (plain, mirrored) in disparity.chunks(width).zip(of_mirrored.chunks(width)) {
        for column in 0..width {
            let (l, r) = (left_weight(column), left_weight(width - 1 - column));
            let d = f64::from(plain[column]);
            let back = f64::from(mirrored[width - 1 - column]);
            blended.push((r * d + l * back + (1.0 - l - r) * 0.5 * (d + back)) as f32);
        }
    }
    blended
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::metrics::Metric;
    use crate::protocol::{Crop, protocol};

    const WIDTH: usize = 1242;
    const HEIGHT: usize = 375;
    const FOCAL_PX: f64 = 721.5377;
    const BASELINE_M: f64 = 0.532_725_428;

    /// Plain bilinear resizing in single precision, as `oracle.resize_bilinear` does it.
    fn resize(source: &[f32], (width, height): (usize, usize)) -> Vec<f32> {
        let taps = |from: usize, to: usize| -> Vec<(usize, usize, f32)> {
            (0..to)
                .map(|i| {
                    let x = (i as f64 + 0.5) * (from as f64 / to as f64) - 0.5;
                    let inside = x >= 0.0 && x.floor() < (from - 1) as f64;
                    let near = (x.floor().max(0.0) as usize).min(from - 1);
                    let weight = if inside { x - x.floor() } else { 0.0 };
                    (near, (near + 1).min(from - 1), weight as f32)
                })
                .collect()
        };
        let columns = taps(width, WIDTH);
        let blend = |row: usize| -> Vec<f32> {
            let row = &source[row * width..(row + 1) * width];
            columns
                .iter()
                .map(|&(a, b, f)| row[a] * (1.0 - f) + row[b] * f)
                .collect()
        };
        taps(height, HEIGHT)
            .into_iter()
            .flat_map(|(a, b, f)| {
                let (a, b) = (blend(a), blend(b));
                a.into_iter()
                    .zip(b)
                    .map(move |(a, b)| a * (1.0 - f) + b * f)
            })
            .collect()
    }

    /// Closed formulas of `oracle.fixtures`: (`pred`, `mirror`), 512 x 256.
    fn network_outputs() -> (Vec<f32>, Vec<f32>) {
        let plane = |value: &dyn Fn(f64, f64, f64) -> f64| {
            (0..256 * 512)
                .map(|i| {
                    let (y, x) = (f64::from(i / 512), f64::from(i % 512));
                    value(y, x, (y - 90.0).max(0.0) / 165.0) as f32
                })
                .collect::<Vec<f32>>()
        };
        (
            plane(&|y, x, ramp| {
                0.0012 + 0.062 * ramp + 0.0006 * (x / 17.0).sin() * (y / 11.0).cos()
            }),
            plane(&|y, x, ramp| {
                0.0012 + 0.060 * ramp + 0.0006 * ((511.0 - x) / 19.0).sin() * (y / 13.0).cos()
            }),
        )
    }

    struct Fixture {
        predicted: Vec<f32>,
        mirror: Vec<f32>,
        disparity_px: Vec<f32>,
        depth_m: Vec<f32>,
    }

    /// `pred`, `mirror`, `gt_disp` and `gt_depth` of `oracle.fixtures` at 1242 x 375.
    fn fixture() -> Fixture {
        let (predicted, mirror) = network_outputs();
        let disparity_px: Vec<f32> = (0..HEIGHT * WIDTH)
            .map(|i| {
                let (y, x) = (i / WIDTH, i % WIDTH);
                if y <= 120 || (x * 7 + y * 13) % 5 != 0 {
                    return 0.0;
                }
                let (y, x) = (y as f64, x as f64);
                let px = 5.0 + 76.0 * (y - 120.0) / 255.0 + 2.0 * (x / 40.0).sin();
                ((px * 256.0).floor() / 256.0) as f32
            })
            .collect();
        let depth_m = disparity_px
            .iter()
            .map(|&px| {
                if px > 0.0 {
                    384.38148_f32 / px + 0.27
                } else {
                    0.0
                }
            })
            .collect();
        Fixture {
            predicted: resize(&predicted, (512, 256)),
            mirror: resize(&mirror, (512, 256)),
            disparity_px,
            depth_m,
        }
    }

    fn close(found: Metrics, expected: [f64; 7]) {
        for (metric, expected) in Metric::ALL.into_iter().zip(expected) {
            let found = found.get(metric);
            assert!(
                (found - expected).abs() < 1e-6,
                "{metric:?}: {found} is not {expected}"
            );
        }
    }

    /// Expected figures: `python3 oracle.py fixtures OUT.npz`, the keys named beside them. The
    /// oracle has no floor, and the fixture's smallest disparity, 0.0006 of the width, is above it.
    #[test]
    fn eigen_figures_of_the_oracle() {
        let fixture = fixture();
        let truth = GroundTruth {
            width: WIDTH,
            height: HEIGHT,
            depth_m: &fixture.depth_m,
            disparity_px: None,
            focal_px: FOCAL_PX,
            baseline_m: BASELINE_M,
            labels: None,
            measured: None,
        };
        let named = |name: &str| protocol(name).unwrap();
        let uncropped = Protocol {
            crop: Crop::None,
            ..named("eigen-80")
        };
        #[rustfmt::skip]
        let cases = [
            // eigen80_garg
            (named("eigen-80"), 50_271, [0.144_551_977_515_220_64, 1.089_973_449_707_031_2,
                4.733_181_953_430_176, 0.189_052_745_699_882_5, 0.816_395_138_350_142_2,
                0.954_665_711_841_817_4, 0.992_162_479_361_858_8]),
            // eigen50_garg
            (named("eigen-50"), 50_271, [0.144_480_556_249_618_53, 1.086_107_969_284_057_6,
                4.723_513_126_373_291, 0.188_918_426_632_881_16, 0.816_395_138_350_142_2,
                0.954_665_711_841_817_4, 0.992_202_263_730_580_1]),
            // eigen50_garg_min1
            (named("eigen-50-min1"), 50_271, [0.144_480_556_249_618_53, 1.086_107_969_284_057_6,
                4.723_513_126_373_291, 0.188_918_426_632_881_16, 0.816_395_138_350_142_2,
                0.954_665_711_841_817_4, 0.992_202_263_730_580_1]),
            // eigen80_median
            (named("eigen-80-median"), 50_271, [0.118_900_977_075_099_95, 0.716_745_138_168_335,
                3.870_397_329_330_444_3, 0.156_806_990_504_264_83, 0.881_581_826_500_368,
                0.970_559_567_146_068_3, 0.997_175_309_820_771_4]),
            // eigen80_nocrop
            (uncropped, 62_686, [0.233_354_464_173_316_96, 5.019_251_823_425_293,
                12.753_135_681_152_344, 0.288_388_252_258_300_8, 0.730_210_892_384_264_4,
                0.869_747_631_049_995_2, 0.941_964_713_014_070_1]),
        ];
        for (protocol, pixels, expected) in cases {
            let scores = evaluate(&protocol, &truth, &fixture.predicted).unwrap();
            assert_eq!(scores.len(), 1, "{}", protocol.name);
            close(scores[0].metrics, expected);
            assert_eq!((scores[0].pixels, scores[0].floored_pixels), (pixels, 0));
            assert_eq!((scores[0].group, scores[0].d1_all), (None, None));
        }
    }

    /// `kitti_metrics` and `kitti_d1` of the same recipe.
    #[test]
    fn kitti_figures_of_the_oracle() {
        let fixture = fixture();
        // Stored depth of the same pixels; the figures must come from the disparity.
        let stored: Vec<f32> = fixture.disparity_px.iter().map(|&px| px.min(1.0)).collect();
        let truth = GroundTruth {
            width: WIDTH,
            height: HEIGHT,
            depth_m: &stored,
            disparity_px: Some(&fixture.disparity_px),
            focal_px: FOCAL_PX,
            // Not the nominal baseline: the protocol brings its own.
            baseline_m: BASELINE_M,
            labels: None,
            measured: None,
        };
        let scores = evaluate(&protocol("kitti2015").unwrap(), &truth, &fixture.predicted).unwrap();
        let expected = [
            0.256_518_230_686_986_65,
            5.105_656_785_576_712,
            12.863_553_774_099_625,
            0.295_884_723_440_720_14,
            0.707_717_179_401_835_4,
            0.867_703_232_737_726_7,
            0.941_403_959_234_784_8,
        ];
        close(scores[0].metrics, expected);
        assert!((scores[0].d1_all.unwrap() - 74.886_278_984_990_41).abs() < 1e-9);
        assert_eq!((scores[0].pixels, scores[0].floored_pixels), (63_093, 0));
        let pooled = (scores[0].sum_squared_error / 63_093.0).sqrt();
        assert!((pooled - scores[0].metrics.rmse).abs() < 1e-12);
    }

    /// Distances divide the pixels of an image: together they say what the image says.
    #[test]
    fn distances_add_up_to_the_image() {
        let fixture = fixture();
        let truth = GroundTruth {
            width: WIDTH,
            height: HEIGHT,
            depth_m: &fixture.disparity_px,
            disparity_px: Some(&fixture.disparity_px),
            focal_px: FOCAL_PX,
            baseline_m: BASELINE_M,
            labels: None,
            measured: None,
        };
        let score =
            |name: &str| evaluate(&protocol(name).unwrap(), &truth, &fixture.predicted).unwrap();
        let whole = score("kitti2015")[0];
        let parts = score("kitti2015-distance");
        let groups: Vec<Group> = parts.iter().filter_map(|part| part.group).collect();
        assert!(
            groups.len() == parts.len() && groups.len() > 4,
            "{groups:?}"
        );
        assert!(groups.is_sorted(), "{groups:?}");
        let sum = |of: &dyn Fn(&ImageScore) -> f64| parts.iter().map(of).sum::<f64>();
        let pixels = |score: &ImageScore| score.pixels as f64;
        assert_eq!(sum(&pixels), pixels(&whole));
        let squared = sum(&|part| part.sum_squared_error);
        assert!((squared / whole.sum_squared_error - 1.0).abs() < 1e-12);
        let abs_rel = sum(&|part| part.metrics.abs_rel * pixels(part)) / pixels(&whole);
        assert!((abs_rel / whole.metrics.abs_rel - 1.0).abs() < 1e-12);
    }

    /// Two images under `oracle.category_rmse`: ground truth and prediction `pred` as for
    /// `eval_kitti_image` at f = 721.5377, B = 0.54, limits 1e-3 and 80; labels
    /// (row / 5 + column / 7) % 34 with whole divisions; then prediction `mirror` with the ids
    /// 24 and 25 made 0. Per group: pooled, mean over images, pixels, images.
    #[test]
    fn group_errors_of_the_oracle() {
        let fixture = fixture();
        let labels: Vec<u8> = (0..HEIGHT * WIDTH)
            .map(|i| ((i / WIDTH / 5 + i % WIDTH / 7) % 34) as u8)
            .collect();
        let without_humans: Vec<u8> = labels
            .iter()
            .map(|&id| if id == 24 || id == 25 { 0 } else { id })
            .collect();
        let truth = |labels| GroundTruth {
            width: WIDTH,
            height: HEIGHT,
            depth_m: &fixture.disparity_px,
            disparity_px: Some(&fixture.disparity_px),
            focal_px: FOCAL_PX,
            baseline_m: BASELINE_M,
            labels: Some(labels),
            measured: None,
        };
        let semantic = protocol("semantic").unwrap();
        let mut scores = evaluate(&semantic, &truth(&labels), &fixture.predicted).unwrap();
        assert_eq!(scores.len(), 5);
        scores.extend(evaluate(&semantic, &truth(&without_humans), &fixture.mirror).unwrap());
        let expected = [
            (
                Group::Flat,
                14.575_118_925_304_231,
                14.574_164_845_849_374,
                14_916,
                2,
            ),
            (
                Group::Human,
                9.748_885_335_192_725,
                9.748_885_335_192_725,
                3678,
                1,
            ),
            (
                Group::Vehicle,
                12.452_536_239_635_725,
                12.447_170_725_783_476,
                29_926,
                2,
            ),
            (
                Group::Construction,
                13.297_244_858_690_72,
                13.296_504_134_255_116,
                22_020,
                2,
            ),
            (
                Group::Object,
                11.488_341_892_593_198,
                11.488_089_895_813_552,
                14_640,
                2,
            ),
        ];
        for (group, pooled, mean, pixels, images) in expected {
            let members: Vec<&ImageScore> = scores
                .iter()
                .filter(|score| score.group == Some(group))
                .collect();
            assert_eq!(members.len(), images);
            let count: u64 = members.iter().map(|score| score.pixels).sum();
            assert_eq!(count, pixels);
            let squared: f64 = members.iter().map(|score| score.sum_squared_error).sum();
            assert!(((squared / count as f64).sqrt() - pooled).abs() < 1e-6);
            let roots: f64 = members.iter().map(|score| score.metrics.rmse).sum();
            assert!((roots / images as f64 - mean).abs() < 1e-6);
        }
    }

    /// `postprocessed` of the same recipe (double precision there): row 200 at six columns.
    #[test]
    fn flip_blending_of_the_oracle() {
        let (predicted, mirror) = network_outputs();
        let blended = flip_blend(&predicted, &mirror, 512);
        let expected = [
            (0, 0.041_200_000_792_741_776),
            (30, 0.040_837_024_570_007_15),
            (40, 0.041_320_422_799_153_336),
            (256, 0.041_784_960_776_567_46),
            (480, 0.042_399_665_687_065_54),
            (511, 0.042_072_914_540_767_7),
        ];
        for (column, value) in expected {
            assert!(
                (f64::from(blended[200 * 512 + column]) - value).abs() < 4e-9,
                "{column}"
            );
        }
    }

    /// A 2 x 2 image with depths 10, 20, 90 m and a pixel without.
    const DEPTH_M: [f32; 4] = [10.0, 20.0, 90.0, 0.0];

    fn small<'a>() -> GroundTruth<'a> {
        GroundTruth {
            width: 2,
            height: 2,
            depth_m: &DEPTH_M,
            disparity_px: None,
            focal_px: 100.0,
            baseline_m: 0.5,
            labels: None,
            measured: None,
        }
    }

    fn uncropped(name: &str) -> Protocol {
        Protocol {
            crop: Crop::None,
            ..protocol(name).unwrap()
        }
    }

    #[test]
    fn mask_and_clip_by_hand() {
        // 50 m px over 2 columns: fractions of 2.5, 1.25 give 10 m and 20 m, 0.25 gives 100 m.
        let predicted = [2.5, 0.25, 0.25, 0.25];
        let eigen = evaluate(&uncropped("eigen-80"), &small(), &predicted).unwrap()[0];
        // 90 m is masked out; 100 m becomes 80 m against 20 m.
        assert_eq!((eigen.pixels, eigen.sum_squared_error), (2, 3600.0));
        let kitti = Protocol {
            camera: Camera::Nominal { baseline_m: 0.5 },
            ..protocol("kitti2015").unwrap()
        };
        let kitti = evaluate(&kitti, &small(), &predicted).unwrap()[0];
        // 90 m counts, and its prediction of 100 m becomes 80 m.
        assert_eq!((kitti.pixels, kitti.sum_squared_error), (3, 3600.0 + 100.0));
        assert_eq!(kitti.d1_all, None, "no disparity, no D1");
    }

    #[test]
    fn limits_of_the_mask_are_outside_unless_comparisons_are_loose() {
        let depth_m = [10.0, 50.0, 1.0, 0.0];
        let truth = GroundTruth {
            depth_m: &depth_m,
            ..small()
        };
        let strict = uncropped("eigen-50-min1");
        let loose = Protocol {
            strict_comparisons: false,
            ..strict.clone()
        };
        let pixels = |protocol| evaluate(protocol, &truth, &[1.0; 4]).unwrap()[0].pixels;
        assert_eq!((pixels(&strict), pixels(&loose)), (1, 3));
    }

    #[test]
    fn zero_disparity_is_floored_and_counted_or_follows_the_reference() {
        let predicted = [0.0, 1.25, 0.0, 0.0];
        let eigen = uncropped("eigen-80");
        let floored = evaluate(&eigen, &small(), &predicted).unwrap()[0];
        // 1e-4 of two columns is 250 km, so 80 m; the pixels outside the mask do not count.
        assert_eq!(
            (floored.floored_pixels, floored.sum_squared_error),
            (1, 4900.0)
        );
        let unfloored = Protocol {
            disparity_floor_fraction: 0.0,
            ..eigen
        };
        let near = evaluate(&unfloored, &small(), &predicted).unwrap()[0];
        let limit = f64::from(1e-3_f32);
        assert_eq!(
            (near.floored_pixels, near.sum_squared_error),
            (0, (10.0 - limit).powi(2))
        );
        let far = Protocol {
            infinite_depth: InfiniteDepth::FarLimit,
            ..unfloored
        };
        assert_eq!(
            evaluate(&far, &small(), &predicted).unwrap()[0].sum_squared_error,
            4900.0
        );
    }

    #[test]
    fn median_scaling_takes_out_the_scale_and_happens_before_clipping() {
        let protocol = Protocol {
            crop: Crop::None,
            ..protocol("eigen-80-median").unwrap()
        };
        // 7 times too far: 140 m would be clipped if clipping came first.
        let depths = [70.0, 140.0, 7.0, 7.0];
        let score = evaluate_depth(&protocol, &small(), &depths).unwrap()[0];
        assert!(score.metrics.abs_rel < 1e-15 && score.metrics.a1 == 1.0);
        let zeros = evaluate_depth(&protocol, &small(), &[0.0; 4]);
        assert_eq!(zeros, Err(EvaluateError::Median(0.0)));
    }

    /// By hand for truth x 1.1 and for a perfect prediction, under every protocol by name: the
    /// relative error is 0.1, that of the logarithm ln 1.1 (or log10 1.1), and all pixels lie
    /// within 1.25. Where medians set the scale nothing is left of the error.
    #[test]
    fn ten_percent_too_far_is_ten_percent_under_every_protocol() {
        let depth_m: Vec<f32> = (0..64 * 32).map(|i| 5.0 + (i % 37) as f32).collect();
        let labels: Vec<u8> = (0..64 * 32).map(|i| [7, 24, 26, 11, 17][i % 5]).collect();
        for known in crate::protocol::protocols() {
            let truth = GroundTruth {
                width: 64,
                height: 32,
                depth_m: &depth_m,
                disparity_px: None,
                focal_px: 100.0,
                baseline_m: 0.5,
                labels: Some(&labels),
                measured: None,
            };
            let disparity_px: Vec<f32> = depth_m.iter().map(|depth| 54.0 / depth).collect();
            let truth = GroundTruth {
                disparity_px: known.ground_truth.is_stereo().then_some(&disparity_px[..]),
                ..truth
            };
            for factor in [1.0, 1.1] {
                let baseline = match known.camera {
                    Camera::Nominal { baseline_m } => baseline_m,
                    _ => truth.baseline_m,
                };
                // What the protocol itself takes for the truth.
                let predicted: Vec<f32> = match truth.disparity_px {
                    Some(plane) => plane
                        .iter()
                        .map(|d| (100.0 * baseline / f64::from(*d) * factor) as f32)
                        .collect(),
                    None => depth_m
                        .iter()
                        .map(|d| (f64::from(*d) * factor) as f32)
                        .collect(),
                };
                let error: f64 = if known.median_scaling { 1.0 } else { factor };
                let log = match known.log_base {
                    LogBase::Natural => error.ln(),
                    LogBase::Ten => error.log10(),
                };
                for score in evaluate_depth(&known, &truth, &predicted).unwrap() {
                    let m = score.metrics;
                    assert!(
                        (m.abs_rel - (error - 1.0)).abs() < 2e-7,
                        "{} {m:?}",
                        known.name
                    );
                    assert!((m.rmse_log - log).abs() < 2e-7, "{} {m:?}", known.name);
                    assert_eq!((m.a1, m.a3), (1.0, 1.0), "{}", known.name);
                }
            }
        }
    }

    /// Make3D: 1 / disparity in any unit, brought to metres by medians, clipped at 70 m, and
    /// the logarithm to base 10. By hand: truth 10, 20, 60; disparities 4, 2, 0.25 are depths in
    /// the ratio 1 : 2 : 16, the medians agree at 20 m, so 10, 20 and 160, clipped to 70.
    #[test]
    fn make3d_by_hand() {
        let depth_m = [10.0, 20.0, 60.0, 71.0];
        let truth = GroundTruth {
            depth_m: &depth_m,
            focal_px: 0.0,
            baseline_m: 0.0,
            ..small()
        };
        let rules = protocol("make3d-c1").unwrap();
        let score = evaluate(&rules, &truth, &[0.4, 0.2, 0.025, 0.4]).unwrap()[0];
        assert_eq!(score.pixels, 3);
        let m = score.metrics;
        assert!((m.abs_rel - 10.0 / 60.0 / 3.0).abs() < 1e-6, "{m:?}");
        assert!((m.rmse - (100.0_f64 / 3.0).sqrt()).abs() < 1e-5, "{m:?}");
        let log = (70.0_f64 / 60.0).log10() / 3.0_f64.sqrt();
        assert!((m.rmse_log - log).abs() < 1e-6, "{m:?}");
    }

    /// One camera for all images: 0.58 * 0.54 m / d, whatever the calibration says.
    #[test]
    fn an_agreed_camera_overrides_the_calibration() {
        let rules = Protocol {
            crop: Crop::None,
            ..protocol("eigen-monodepth2").unwrap()
        };
        let depth_m = [10.44_f32, 0.0, 0.0, 0.0];
        let truth = GroundTruth {
            depth_m: &depth_m,
            focal_px: f64::NAN,
            baseline_m: 3.0,
            ..small()
        };
        let score = evaluate(&rules, &truth, &[0.03, 0.0, 0.0, 0.0]).unwrap()[0];
        assert!(score.metrics.abs_rel < 1e-6, "{score:?}");
    }

    #[test]
    fn depth_and_disparity_of_the_same_scene_score_alike() {
        let disparities = [2.0, 1.0, 0.5, 3.0];
        let depths = disparities.map(|fraction: f32| 50.0 / (2.0 * fraction));
        let disparity_px = [5.0, 2.5, 0.625, 0.0];
        let truth = GroundTruth {
            disparity_px: Some(&disparity_px),
            ..small()
        };
        for protocol in [
            uncropped("eigen-80"),
            Protocol {
                camera: Camera::Calibrated,
                ..protocol("kitti2015").unwrap()
            },
        ] {
            let a = evaluate(&protocol, &truth, &disparities).unwrap();
            assert_eq!(a, evaluate_depth(&protocol, &truth, &depths).unwrap());
        }
    }

    #[test]
    fn a_calibrated_stereo_protocol_needs_disparity() {
        let calibrated = protocol("kitti2015-calibrated").unwrap();
        let error = evaluate(&calibrated, &small(), &[1.0; 4]).unwrap_err();
        assert!(matches!(error, EvaluateError::Missing { .. }), "{error}");
    }

    #[test]
    fn bad_values_are_errors_that_name_the_place() {
        let eigen = uncropped("eigen-80");
        for bad in [f32::NAN, f32::INFINITY, -0.1] {
            // The place is outside the mask: a broken model is broken everywhere.
            let error = evaluate(&eigen, &small(), &[0.1, 0.1, 0.1, bad]).unwrap_err();
            let text = error.to_string();
            assert!(text.contains("disparity at row 1, column 1"), "{text}");
            let error = evaluate_depth(&eigen, &small(), &[0.1, 0.1, bad, 0.1]).unwrap_err();
            assert!(error.to_string().contains("depth at row 1, column 0"));
            let depth_m = [1.0, bad, 1.0, 1.0];
            let truth = GroundTruth {
                depth_m: &depth_m,
                ..small()
            };
            let error = evaluate(&eigen, &truth, &[0.1; 4]).unwrap_err();
            assert!(
                matches!(
                    error,
                    EvaluateError::Truth {
                        row: 0,
                        column: 1,
                        ..
                    }
                ),
                "{error}"
            );
        }
        for focal_px in [0.0, f64::NAN, -1.0] {
            let truth = GroundTruth {
                focal_px,
                ..small()
            };
            assert!(evaluate(&eigen, &truth, &[0.1; 4]).is_err());
        }
        let error = evaluate(&eigen, &small(), &[0.1; 3]).unwrap_err();
        assert_eq!(
            error.to_string(),
            "the prediction has 3 values where 2 x 2 = 4 are needed"
        );
        let upside_down = Protocol {
            min_depth_m: 90.0,
            ..eigen
        };
        assert!(evaluate(&upside_down, &small(), &[0.1; 4]).is_err());
    }

    #[test]
    fn an_image_without_a_pixel_to_score_gets_no_score() {
        let depth_m = [0.0, 90.0, 0.0, 0.0];
        let truth = GroundTruth {
            depth_m: &depth_m,
            ..small()
        };
        let error = evaluate(&uncropped("eigen-80"), &truth, &[0.1; 4]).unwrap_err();
        assert!(
            matches!(error, EvaluateError::NothingToScore { with_truth: 1, .. }),
            "{error}"
        );
        let labels = [23, 23, 0, 7];
        let truth = GroundTruth {
            labels: Some(&labels),
            ..small()
        };
        let semantic = protocol("semantic").unwrap();
        assert!(matches!(
            evaluate(&semantic, &truth, &[0.1; 4]),
            Err(EvaluateError::NothingToScore { .. })
        ));
        assert!(matches!(
            evaluate(&semantic, &small(), &[0.1; 4]),
            Err(EvaluateError::Missing { .. })
        ));
    }

    fn scene() -> impl Strategy<Value = (Protocol, usize, Vec<[f32; 2]>, Vec<u8>)> {
        const NAMES: [&str; 5] = [
            "kitti2015",
            "semantic",
            "eigen-80",
            "eigen-50",
            "eigen-80-median",
        ];
        let value = || {
            prop_oneof![
                Just(0.0_f32),
                1e-6_f32..2.0,
                Just(f32::MIN_POSITIVE),
                Just(1e30)
            ]
        };
        (
            proptest::sample::select(&NAMES[..]),
            1_usize..9,
            proptest::collection::vec([value(), value()], 72),
            proptest::collection::vec(0_u8..40, 72),
        )
            .prop_map(|(name, width, planes, labels)| (uncropped(name), width, planes, labels))
    }

    proptest! {
        #[test]
        fn a_score_is_always_made_of_numbers((protocol, width, planes, labels) in scene()) {
            let count = 72 / width * width;
            let depth_m: Vec<f32> = planes[..count].iter().map(|p| p[0] * 60.0).collect();
            let disparity_px: Vec<f32> = planes[..count].iter().map(|p| p[0]).collect();
            let truth = GroundTruth {
                width,
                height: count / width,
                depth_m: &depth_m,
                disparity_px: protocol.ground_truth.is_stereo().then_some(&disparity_px[..]),
                focal_px: 700.0,
                baseline_m: 0.5,
                labels: Some(&labels[..count]),
                measured: None,
            };
            let predicted: Vec<f32> = planes[..count].iter().map(|p| p[1]).collect();
            for scores in [
                evaluate(&protocol, &truth, &predicted),
                evaluate_depth(&protocol, &truth, &predicted),
            ] {
                for score in scores.unwrap_or_default() {
                    let m = score.metrics;
                    prop_assert!(m.to_array().iter().all(|v| v.is_finite() && *v >= 0.0), "{m:?}");
                    prop_assert!(m.a1 <= m.a2 && m.a2 <= m.a3 && m.a3 <= 1.0);
                    prop_assert!(score.floored_pixels <= score.pixels && score.pixels > 0);
                    prop_assert!(score.d1_all.is_none_or(|d1| (0.0..=100.0).contains(&d1)));
                }
            }
        }

        #[test]
        fn after_median_scaling_the_unit_of_depth_is_of_no_matter(
            depths in proptest::collection::vec([1.0_f32..79.0, 1.0_f32..79.0], 4),
        ) {
            let depth_m: Vec<f32> = depths.iter().map(|d| d[0]).collect();
            let truth = GroundTruth { depth_m: &depth_m, ..small() };
            let score = |unit: f32| {
                let predicted: Vec<f32> = depths.iter().map(|d| d[1] * unit).collect();
                evaluate_depth(&uncropped("eigen-80-median"), &truth, &predicted)
            };
            prop_assert_eq!(score(1.0), score(1024.0));
            prop_assert_eq!(score(1.0), score(1.0 / 64.0));
        }
    }
}
