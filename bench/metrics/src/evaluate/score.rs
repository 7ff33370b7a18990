//! A protocol applied to one image: choose the pixels, align, clip, measure.

use super::alignment::{Aligned, Fit};
use super::error::EvaluateError;
use super::prediction::Prediction;
use super::scratch::Scratch;
use super::truth::{GroundTruth, check_size, first_unusable};
use crate::metrics::{
    CropBox, FurtherMetrics, Metrics, Terms, benchmark_box, crop_box, d1_all, sums,
};
use crate::protocol::{
    Alignment, BenchmarkCrop, Camera, Group, Grouping, InfiniteDepth, LogBase, Protocol,
};

/// Score of one image, or of one group of pixels in it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImageScore {
    /// The group, for protocols with groups.
    pub group: Option<Group>,
    /// The seven metrics.
    pub metrics: Metrics,
    /// The metrics of PROTOCOL 10.3, where they were asked for.
    pub further: Option<FurtherMetrics>,
    /// D1-all in percent, where the protocol asks for it and the ground truth is disparity.
    pub d1_all: Option<f64>,
    /// Sum of squared errors in m^2, from which pooled errors are made.
    pub sum_squared_error: f64,
    /// Pixels scored; never 0.
    pub pixels: u64,
    /// Pixels without a usable prediction: disparity that was raised to the floor and is scored
    /// there, or no depth at all, which is in none of the figures and not among `pixels`.
    pub floored_pixels: u64,
    /// The numbers by which the image was aligned with its truth, under protocols that align.
    pub fit: Option<Fit>,
}

/// What one prediction was compared with, and how: what a picture of its error must show.
#[derive(Clone, Debug, PartialEq)]
pub struct Compared {
    /// Columns of the ground truth.
    pub width: usize,
    /// Rows of the ground truth.
    pub height: usize,
    /// The numbers by which the prediction was aligned; none without alignment.
    pub fit: Option<Fit>,
    /// Aligned depth was clipped to this, in metres.
    pub limits_m: (f64, f64),
    /// The scored pixels, row by row; under a protocol with groups those of any group.
    pub pixels: Vec<ComparedPixel>,
    /// The whole prediction as depth in metres, aligned and clipped like the scored pixels; 0 where
    /// it has none.
    pub predicted_m: Vec<f32>,
}

/// A scored pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ComparedPixel {
    /// Row-major position within the ground truth.
    pub index: usize,
    /// True depth in metres.
    pub truth_m: f64,
    /// Predicted depth in metres, aligned and clipped.
    pub predicted_m: f64,
}

/// What the values of a prediction stand for, in their order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Places {
    /// All pixels of the image.
    All,
    /// Its measured pixels.
    Measured,
}

/// Scores with the pixels behind them.
pub(super) struct Scored {
    pub(super) scores: Vec<ImageScore>,
    pixels: Vec<Pixel>,
    aligned: Aligned,
}

impl Scored {
    /// The scores, and what was compared, of a prediction for all pixels.
    pub(super) fn with_pixels(self, scene: &Scene<'_>) -> (Vec<ImageScore>, Compared) {
        let is_grouped = scene.protocol.grouping != Grouping::None;
        let of_pixel = |pixel: &Pixel| ComparedPixel {
            index: scene.truth.measured[pixel.place as usize] as usize,
            truth_m: pixel.truth_m,
            predicted_m: scene.scored_m(pixel.value, self.aligned),
        };
        let scored = |pixel: &&Pixel| !is_grouped || pixel.group.is_some();
        let whole = 0..scene.truth.width * scene.truth.height;
        let predicted_m = whole.map(|index| {
            let predicted = scene.predicted(index, index);
            predicted.map_or(0.0, |predicted| {
                scene.scored_m(predicted.value, self.aligned) as f32
            })
        });
        let compared = Compared {
            width: scene.truth.width,
            height: scene.truth.height,
            fit: self.aligned.fit,
            limits_m: (f64::from(scene.min_depth_m), f64::from(scene.max_depth_m)),
            pixels: self.pixels.iter().filter(scored).map(of_pixel).collect(),
            predicted_m: predicted_m.collect(),
        };
        (self.scores, compared)
    }
}

struct Predicted {
    /// Depth, or inverse depth where that is aligned.
    value: f64,
    disparity_px: f32,
    floored: bool,
}

/// A protocol, an image and a prediction that were found to fit each other.
pub(super) struct Scene<'a> {
    protocol: &'a Protocol,
    truth: &'a GroundTruth,
    prediction: Prediction<'a>,
    places: Places,
    /// Focal length times baseline: depth = this / disparity in pixels. 0 where nothing depends on
    /// the camera.
    focal_baseline: f64,
    /// Limits as the reference sees them beside single-precision depth.
    min_depth_m: f32,
    max_depth_m: f32,
    /// Where a prediction is looked at: KITTI's benchmark crop.
    shown: Option<CropBox>,
    /// What is scored.
    crop: CropBox,
}

struct Pixel {
    truth_m: f64,
    /// As in [`Predicted`].
    value: f64,
    /// In the list of measured pixels.
    place: u32,
    /// Predicted.
    disparity_px: f32,
    floored: bool,
    group: Option<Group>,
}

impl<'a> Scene<'a> {
    pub(super) fn new(
        protocol: &'a Protocol,
        truth: &'a GroundTruth,
        prediction: Prediction<'a>,
        places: Places,
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

        // The depth plane of stereo ground truth was made with the nominal baseline.
        if protocol.camera == Camera::Calibrated
            && protocol.ground_truth.is_stereo()
            && truth.disparity_px.is_none()
        {
            return Err(missing("ground truth as disparity"));
        }
        // Relative values need no camera.
        let needs_camera = protocol.ground_truth.is_stereo()
            || !matches!(
                prediction,
                Prediction::Depth(_) | Prediction::InverseDepth(_)
            );
        let focal_baseline = if needs_camera {
            let camera = protocol.camera.resolve(&truth.camera, truth.width)?;
            camera.focal_px * camera.baseline_m
        } else {
            0.0
        };
        let (width, height) = truth.size();
        let shown = match protocol.benchmark_crop {
            BenchmarkCrop::None => None,
            BenchmarkCrop::Image | BenchmarkCrop::ImageAndTruth => {
                let too_small = || EvaluateError::TooSmall {
                    name: protocol.name.clone(),
                    width,
                    height,
                };
                Some(benchmark_box(width, height).ok_or_else(too_small)?)
            }
        };
        // Where the crop's own rows and columns count from.
        let whole = CropBox {
            top: 0,
            bottom: height,
            left: 0,
            right: width,
        };
        let base = match (protocol.benchmark_crop, shown) {
            (BenchmarkCrop::ImageAndTruth, Some(shown)) => shown,
            _ => whole,
        };
        let (width, height) = base.size();
        let crop = crop_box(protocol.crop, width, height);
        if crop.bottom > height || crop.right > width {
            return Err(EvaluateError::Crop {
                bottom: crop.bottom,
                right: crop.right,
                width,
                height,
            });
        }
        let crop = base.placed(crop);
        let scene = Self {
            protocol,
            truth,
            prediction,
            places,
            focal_baseline,
            min_depth_m,
            max_depth_m,
            shown,
            crop,
        };
        scene.check_prediction()?;
        Ok(scene)
    }

    fn check_prediction(&self) -> Result<(), EvaluateError> {
        use Alignment as A;
        let (plane, what, fitting): (_, _, &'static [Alignment]) = match self.prediction {
            Prediction::DisparityFraction(plane) => (plane, "disparity", &A::ALL),
            Prediction::DepthM(plane) => (plane, "depth", &A::ALL),
            Prediction::InverseDepth(plane) => (
                plane,
                "inverse depth without unit",
                &[A::ScaleDisparity, A::AffineDisparity],
            ),
            Prediction::Depth(plane) => (
                plane,
                "depth without unit",
                &[A::Median, A::ScaleDepth, A::AffineDepth],
            ),
        };
        let Protocol {
            name, alignment, ..
        } = self.protocol;
        if !fitting.contains(alignment) {
            return Err(EvaluateError::Alignment {
                name: name.clone(),
                alignment: *alignment,
                what,
                fitting,
            });
        }
        let (width, height) = self.truth.size();
        match self.places {
            Places::All => check_size("prediction", plane.len(), width, height)?,
            // Made for this truth by whoever calls.
            Places::Measured => assert_eq!(
                plane.len(),
                self.truth.measured.len(),
                "a value for each measured pixel"
            ),
        }
        let is_relative = matches!(
            self.prediction,
            Prediction::InverseDepth(_) | Prediction::Depth(_)
        );
        let unusable = match is_relative {
            true => first_unusable(plane, f32::is_finite),
            false => first_unusable(plane, |value| (0.0..=f32::MAX).contains(&value)),
        };
        let Some(first) = unusable else {
            return Ok(());
        };
        let index = match self.places {
            Places::All => first,
            Places::Measured => self.truth.measured[first] as usize,
        };
        let (row, column, value) = (index / width, index % width, plane[first]);
        Err(match is_relative {
            true => EvaluateError::Infinite {
                what,
                row,
                column,
                value,
            },
            false => EvaluateError::Prediction {
                what,
                row,
                column,
                value,
            },
        })
    }

    /// What is predicted at a pixel, whose value is the one at `at`; `None` where nothing is.
    fn predicted(&self, index: usize, at: usize) -> Option<Predicted> {
        if let Some(shown) = self.shown {
            let width = self.truth.width;
            if !shown.has(index / width, index % width) {
                return None;
            }
        }
        let of_value = |value: f32| Predicted {
            value: f64::from(value),
            disparity_px: 0.0,
            floored: false,
        };
        let aligns_inverse_depth = self.protocol.alignment.is_of_inverse_depth();
        match self.prediction {
            Prediction::DisparityFraction(plane) if aligns_inverse_depth => {
                Some(of_value(plane[at]))
            }
            Prediction::DisparityFraction(plane) => Some(self.of_disparity(plane[at])),
            Prediction::DepthM(plane) => {
                let depth_m = plane[at];
                let value = f64::from(depth_m);
                (depth_m != 0.0).then(|| Predicted {
                    value: if aligns_inverse_depth {
                        1.0 / value
                    } else {
                        value
                    },
                    disparity_px: (self.focal_baseline / value) as f32,
                    floored: false,
                })
            }
            Prediction::InverseDepth(plane) | Prediction::Depth(plane) => Some(of_value(plane[at])),
        }
    }

    /// A disparity, a fraction of the width, as depth; see the precision above.
    fn of_disparity(&self, fraction: f32) -> Predicted {
        let floor = self.protocol.disparity_floor_fraction as f32;
        let disparity_px = self.truth.width as f32 * fraction.max(floor);
        let depth_m = self.focal_baseline as f32 / disparity_px;
        let infinite = match self.protocol.infinite_depth {
            InfiniteDepth::FarLimit => f32::INFINITY,
            InfiniteDepth::NearLimit => 0.0,
        };
        Predicted {
            value: f64::from(if depth_m.is_infinite() {
                infinite
            } else {
                depth_m
            }),
            disparity_px,
            floored: fraction < floor,
        }
    }

    /// What was measured, 0 where something else was, and whether it is disparity in pixels rather than
    /// depth in metres.
    fn measured_values(&self) -> (&'a [f32], bool) {
        match &self.truth.disparity_px {
            Some(disparity_px) if self.protocol.ground_truth.is_stereo() => (disparity_px, true),
            _ => (&self.truth.depth_m, false),
        }
    }

    /// True depth in metres of a measured pixel; `None` where there is none or the protocol masks it.
    fn truth_m(&self, place: usize) -> Option<f64> {
        let (measured, is_disparity) = self.measured_values();
        let measured = f64::from(measured[place]);
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
        further: bool,
        scratch: &mut Scratch,
    ) -> Result<Scored, EvaluateError> {
        let (protocol, truth) = (self.protocol, self.truth);
        let mut pixels = Vec::with_capacity(truth.measured.len());
        let mut unpredicted: Vec<Option<Group>> = Vec::new();
        for place in truth.within(self.crop) {
            let Some(truth_m) = self.truth_m(place) else {
                continue;
            };
            let index = truth.measured[place] as usize;
            let group = match protocol.grouping {
                Grouping::None => None,
                Grouping::Cityscapes => truth
                    .labels
                    .as_ref()
                    .and_then(|ids| Group::of_label(ids[index])),
                Grouping::Distance => Group::of_depth(truth_m),
            };
            let at = match self.places {
                Places::All => index,
                Places::Measured => place,
            };
            let Some(predicted) = self.predicted(index, at) else {
                unpredicted.push(group);
                continue;
            };
            pixels.push(Pixel {
                truth_m,
                value: predicted.value,
                place: place as u32,
                disparity_px: predicted.disparity_px,
                floored: predicted.floored,
                group,
            });
        }

        let pairs = pixels.iter().map(|pixel| (pixel.value, pixel.truth_m));
        let aligned = Aligned::of_pairs(protocol.alignment, pairs)?;
        if protocol.alignment.is_of_inverse_depth() {
            for pixel in &mut pixels {
                pixel.floored = aligned.is_floored(pixel.value);
            }
        }
        let compared = pixels.iter().map(|pixel| {
            let predicted_m = self.scored_m(pixel.value, aligned);
            (pixel.place, pixel.truth_m, predicted_m)
        });
        let terms = scratch.terms(compared);
        let all = || pixels.iter().zip(terms);
        let mut scores: Vec<ImageScore> = match protocol.grouping {
            Grouping::None => self
                .summarise(None, all(), aligned, further)
                .into_iter()
                .collect(),
            grouping => grouping
                .groups()
                .iter()
                .filter_map(|&group| {
                    let members = all().filter(|(pixel, _)| pixel.group == Some(group));
                    self.summarise(Some(group), members, aligned, further)
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
            aligned,
        })
    }

    /// A prediction as it is compared: aligned, then clipped.
    fn scored_m(&self, value: f64, aligned: Aligned) -> f64 {
        let depth_m = aligned.depth_m(value);
        depth_m.clamp(f64::from(self.min_depth_m), f64::from(self.max_depth_m))
    }

    fn summarise<'p>(
        &self,
        group: Option<Group>,
        members: impl Iterator<Item = (&'p Pixel, &'p Terms)> + Clone,
        aligned: Aligned,
        further: bool,
    ) -> Option<ImageScore> {
        let strict = self.protocol.strict_comparisons;
        let terms = members.clone().map(|(_, terms)| *terms);
        let (mut metrics, further, sum_squared_error) = if further {
            let (metrics, further, squared) = sums::<true>(terms, strict)?;
            (metrics, Some(further), squared)
        } else {
            let (metrics, _, squared) = sums::<false>(terms, strict)?;
            (metrics, None, squared)
        };
        if self.protocol.log_base == LogBase::Ten {
            metrics.rmse_log /= std::f64::consts::LN_10;
        }
        // Aligned depth no longer belongs to the disparity it was made of.
        let d1_all = match (self.protocol.d1_rule, &self.truth.disparity_px) {
            (Some(rule), Some(true_px)) if aligned.fit.is_none() => {
                let pairs = members.clone();
                let pairs =
                    pairs.map(|(pixel, _)| (true_px[pixel.place as usize], pixel.disparity_px));
                d1_all(pairs, rule)
            }
            _ => None,
        };
        Some(ImageScore {
            group,
            metrics,
            further,
            d1_all,
            sum_squared_error,
            pixels: members.clone().count() as u64,
            floored_pixels: members.filter(|(pixel, _)| pixel.floored).count() as u64,
            fit: aligned.fit,
        })
    }
}
