//! A protocol, an image and a prediction, which must fit each other; and what the three say of a pixel.
//!
//! Not here: what is made of the pixels ([`super::score`](mod@super::score)).

use super::error::EvaluateError;
use super::prediction::Prediction;
use super::truth::{GroundTruth, check_size, first_unusable};
use crate::metrics::{CropBox, benchmark_box, crop_box};
use crate::protocol::{Alignment, BenchmarkCrop, Camera, Grouping, InfiniteDepth, Protocol};

/// What the values of a prediction stand for, in their order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Places {
    /// All pixels of the image.
    All,
    /// Its measured pixels.
    Measured,
}

pub(super) struct Predicted {
    /// Depth, or inverse depth where that is aligned.
    pub(super) value: f64,
    pub(super) disparity_px: f32,
    pub(super) floored: bool,
}

/// A protocol, an image and a prediction that were found to fit each other.
pub(super) struct Scene<'a> {
    pub(super) protocol: &'a Protocol,
    pub(super) truth: &'a GroundTruth,
    pub(super) prediction: Prediction<'a>,
    pub(super) places: Places,
    /// Focal length times baseline: depth = this / disparity in pixels. 0 where nothing depends on
    /// the camera.
    pub(super) focal_baseline: f64,
    /// Limits as the reference sees them beside single-precision depth.
    pub(super) min_depth_m: f32,
    pub(super) max_depth_m: f32,
    /// The nearest and the farthest true depth that counts.
    pub(super) counted_m: [f64; 2],
    /// Where a prediction is looked at: KITTI's benchmark crop.
    pub(super) shown: Option<CropBox>,
    /// What is scored.
    pub(super) crop: CropBox,
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
            counted_m: counted_m(protocol, [min_depth_m, max_depth_m].map(f64::from)),
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

    /// Whether a prediction is looked at there.
    #[inline]
    pub(super) fn is_shown(&self, index: usize) -> bool {
        let width = self.truth.width;
        self.shown
            .is_none_or(|shown| shown.has(index / width, index % width))
    }

    /// What the value at `at` says of a pixel that is shown; `None` where that is nothing.
    #[inline]
    pub(super) fn predicted(&self, at: usize) -> Option<Predicted> {
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
    #[inline]
    pub(super) fn of_disparity(&self, fraction: f32) -> Predicted {
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
    #[inline]
    pub(super) fn measured_values(&self) -> (&'a [f32], bool) {
        match &self.truth.disparity_px {
            Some(disparity_px) if self.protocol.ground_truth.is_stereo() => (disparity_px, true),
            _ => (&self.truth.depth_m, false),
        }
    }
}

/// The nearest and the farthest true depth that counts between the protocol's limits.
fn counted_m(protocol: &Protocol, [min, max]: [f64; 2]) -> [f64; 2] {
    match (protocol.mask_ground_truth, protocol.strict_comparisons) {
        (false, _) => [0.0_f64.next_up(), f64::INFINITY],
        (true, true) => [min.next_up(), max.next_down()],
        (true, false) => [min, max],
    }
}
