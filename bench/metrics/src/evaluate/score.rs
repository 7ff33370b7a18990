//! A protocol applied to one image: choose the pixels, scale, clip, measure.

use super::error::EvaluateError;
use super::truth::{GroundTruth, check_plane, check_size};
use crate::metrics::{Metrics, crop_box, d1_all, depth_metrics, median};
use crate::protocol::{Camera, Group, Grouping, InfiniteDepth, LogBase, Protocol};

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
    /// Pixels without a usable prediction: disparity that was raised to the floor and is scored
    /// there, or no depth at all, which is in none of the figures and not among `pixels`.
    pub floored_pixels: u64,
}

/// What one prediction was compared with, and how: what a picture of its error must show.
#[derive(Clone, Debug, PartialEq)]
pub struct Compared {
    /// Columns of the ground truth.
    pub width: usize,
    /// Rows of the ground truth.
    pub height: usize,
    /// What predicted depth was multiplied by (median scaling); 1 without.
    pub scale: f64,
    /// Scaled depth was clipped to this, in metres.
    pub limits_m: (f64, f64),
    /// The scored pixels, row by row; under a protocol with groups those of any group.
    pub pixels: Vec<ComparedPixel>,
    /// The whole prediction as depth in metres, scaled and clipped like the scored pixels; 0 where a
    /// map of depth has none.
    pub predicted_m: Vec<f32>,
}

/// A scored pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ComparedPixel {
    /// Row-major position within the ground truth.
    pub index: usize,
    /// True depth in metres.
    pub truth_m: f64,
    /// Predicted depth in metres, scaled and clipped.
    pub predicted_m: f64,
}

/// Scores with the pixels behind them.
pub(super) struct Scored {
    pub(super) scores: Vec<ImageScore>,
    pixels: Vec<Pixel>,
    scale: Option<f64>,
}

impl Scored {
    /// The scores, and what was compared; `depth_m` is the whole prediction.
    pub(super) fn with_pixels(
        self,
        scene: &Scene<'_>,
        depth_m: impl Iterator<Item = f32>,
    ) -> (Vec<ImageScore>, Compared) {
        let is_grouped = scene.protocol.grouping != Grouping::None;
        let scored_m = |depth_m| scene.scored_m(depth_m, self.scale);
        let of_pixel = |pixel: &Pixel| ComparedPixel {
            index: pixel.index,
            truth_m: pixel.truth_m,
            predicted_m: scored_m(pixel.predicted_m),
        };
        let scored = |pixel: &&Pixel| !is_grouped || pixel.group.is_some();
        let compared = Compared {
            width: scene.truth.width,
            height: scene.truth.height,
            scale: self.scale.unwrap_or(1.0),
            limits_m: (f64::from(scene.min_depth_m), f64::from(scene.max_depth_m)),
            pixels: self.pixels.iter().filter(scored).map(of_pixel).collect(),
            predicted_m: depth_m.map(|depth_m| scored_m(depth_m) as f32).collect(),
        };
        (self.scores, compared)
    }
}

pub(super) struct Predicted {
    pub(super) depth_m: f32,
    pub(super) disparity_px: f32,
    pub(super) floored: bool,
}

/// A protocol and an image that were found to fit each other.
pub(super) struct Scene<'a> {
    protocol: &'a Protocol,
    truth: &'a GroundTruth,
    /// Focal length times baseline: depth = this / disparity in pixels.
    pub(super) focal_baseline: f64,
    /// Limits as the reference sees them beside single-precision depth.
    min_depth_m: f32,
    max_depth_m: f32,
}

struct Pixel {
    index: usize,
    truth_m: f64,
    predicted_m: f32,
    /// True and predicted disparity in pixels.
    disparity_px: (f32, f32),
    floored: bool,
    group: Option<Group>,
}

impl<'a> Scene<'a> {
    pub(super) fn new(
        protocol: &'a Protocol,
        truth: &'a GroundTruth,
    ) -> Result<Self, EvaluateError> {
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
        if protocol.grouping == Grouping::Cityscapes && truth.labels.is_none() {
            return Err(missing("an image of Cityscapes labels"));
        }

        let crop = crop_box(protocol.crop, truth.width, truth.height);
        if crop.bottom > truth.height || crop.right > truth.width {
            return Err(EvaluateError::Crop {
                bottom: crop.bottom,
                right: crop.right,
                width: truth.width,
                height: truth.height,
            });
        }
        // The depth plane of stereo ground truth was made with the nominal baseline.
        if protocol.camera == Camera::Calibrated
            && protocol.ground_truth.is_stereo()
            && truth.disparity_px.is_none()
        {
            return Err(missing("ground truth as disparity"));
        }
        let camera = protocol.camera.resolve(&truth.camera, truth.width)?;
        Ok(Self {
            protocol,
            truth,
            focal_baseline: camera.focal_px * camera.baseline_m,
            min_depth_m,
            max_depth_m,
        })
    }

    pub(super) fn check_prediction(
        &self,
        what: &'static str,
        plane: &[f32],
    ) -> Result<(), EvaluateError> {
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

    /// A disparity, a fraction of the width, as depth; see the precision above.
    pub(super) fn of_disparity(&self, fraction: f32) -> Predicted {
        let floor = self.protocol.disparity_floor_fraction as f32;
        let disparity_px = self.truth.width as f32 * fraction.max(floor);
        let depth_m = self.focal_baseline as f32 / disparity_px;
        let infinite = match self.protocol.infinite_depth {
            InfiniteDepth::FarLimit => f32::INFINITY,
            InfiniteDepth::NearLimit => 0.0,
        };
        Predicted {
            depth_m: if depth_m.is_infinite() {
                infinite
            } else {
                depth_m
            },
            disparity_px,
            floored: fraction < floor,
        }
    }

    /// What was measured, 0 where nothing was, and whether it is disparity in pixels rather than
    /// depth in metres.
    fn measured_plane(&self) -> (&'a [f32], bool) {
        match &self.truth.disparity_px {
            Some(disparity_px) if self.protocol.ground_truth.is_stereo() => (disparity_px, true),
            _ => (&self.truth.depth_m, false),
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

    pub(super) fn score(
        &self,
        predict: impl Fn(usize) -> Option<Predicted>,
    ) -> Result<Scored, EvaluateError> {
        let (protocol, truth) = (self.protocol, self.truth);
        let crop = crop_box(protocol.crop, truth.width, truth.height);
        let mut pixels = Vec::with_capacity(truth.measured.len());
        let mut unpredicted: Vec<Option<Group>> = Vec::new();
        for index in truth.within(crop) {
            let Some(truth_m) = self.truth_m(index) else {
                continue;
            };
            let group = match protocol.grouping {
                Grouping::None => None,
                Grouping::Cityscapes => truth
                    .labels
                    .as_ref()
                    .and_then(|ids| Group::of_label(ids[index])),
                Grouping::Distance => Group::of_depth(truth_m),
            };
            let Some(predicted) = predict(index) else {
                unpredicted.push(group);
                continue;
            };
            pixels.push(Pixel {
                index,
                truth_m,
                predicted_m: predicted.depth_m,
                disparity_px: (
                    truth
                        .disparity_px
                        .as_ref()
                        .map_or(0.0, |plane| plane[index]),
                    predicted.disparity_px,
                ),
                floored: predicted.floored,
                group,
            });
        }

        let scale = if protocol.median_scaling {
            self.median_ratio(&pixels)?
        } else {
            None
        };
        let mut scores: Vec<ImageScore> = match protocol.grouping {
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
        for score in &mut scores {
            let missing = unpredicted.iter().filter(|group| **group == score.group);
            score.floored_pixels += missing.count() as u64;
        }
        if scores.is_empty() && !unpredicted.is_empty() {
            return Err(EvaluateError::NothingPredicted {
                pixels: unpredicted.len(),
            });
        }
        if scores.is_empty() {
            return Err(EvaluateError::NothingToScore {
                name: protocol.name.clone(),
                with_truth: truth.depth_m.iter().filter(|&&depth| depth > 0.0).count(),
            });
        }
        Ok(Scored {
            scores,
            pixels,
            scale,
        })
    }

    /// A prediction as it is compared: scaled, then clipped.
    fn scored_m(&self, depth_m: f32, scale: Option<f64>) -> f64 {
        let scaled = f64::from(depth_m) * scale.unwrap_or(1.0);
        scaled.clamp(f64::from(self.min_depth_m), f64::from(self.max_depth_m))
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
        let compared = |pixel: &Pixel| (pixel.truth_m, self.scored_m(pixel.predicted_m, scale));
        let pairs = pixels.clone().map(compared);
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
