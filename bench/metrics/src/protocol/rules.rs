//! All choices of a protocol in one value.

use serde::{Deserialize, Serialize};

use super::camera::Camera;
use super::choices::{
    Alignment, BenchmarkCrop, Crop, D1Rule, GroundTruthKind, InfiniteDepth, LogBase,
    PostProcessing, Resize,
};
use super::group::Grouping;

/// A complete set of evaluation rules.
///
/// Every protocol averages images without weights.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Protocol {
    /// Name used on command lines and in files.
    pub name: String,
    /// Counts the changes of meaning under this name.
    pub version: u32,
    /// What predictions are compared with.
    pub ground_truth: GroundTruthKind,
    /// Focal length and baseline.
    pub camera: Camera,
    /// Part of the image that is scored; fractions are multiplied in double precision and
    /// truncated.
    pub crop: Crop,
    /// Near limit in metres, to which predictions are clipped.
    pub min_depth_m: f64,
    /// Far limit in metres, to which predictions are clipped.
    pub max_depth_m: f64,
    /// Leave out pixels whose true depth is outside the two limits. Otherwise each measured
    /// pixel counts, with its true depth unclipped.
    pub mask_ground_truth: bool,
    /// A value on a limit is outside: depth limits of the mask and accuracy thresholds.
    pub strict_comparisons: bool,
    /// Smaller disparities, as a fraction of image width, are raised to this value and
    /// counted; 0 switches the floor off.
    pub disparity_floor_fraction: f64,
    /// What becomes of infinite depth where there is no floor.
    pub infinite_depth: InfiniteDepth,
    /// How each prediction is fitted to the truth before clipping. Only for methods that cannot
    /// know the scale.
    #[serde(default, alias = "median_scaling")]
    pub alignment: Alignment,
    /// What is done with the disparity before it is resized.
    pub post_processing: PostProcessing,
    /// How D1-all counts, for protocols that report it.
    pub d1_rule: Option<D1Rule>,
    /// Whole images, or groups of label ids.
    pub grouping: Grouping,
    /// What is resized to the size of the ground truth, and how.
    #[serde(default)]
    pub resize: Resize,
    /// Base of the logarithm in `rmse_log`.
    #[serde(default)]
    pub log_base: LogBase,
    /// Whether models are shown KITTI's benchmark crop of an image.
    #[serde(default)]
    pub benchmark_crop: BenchmarkCrop,
}

impl Protocol {
    /// A sentence if choices contradict each other or a number cannot be used.
    ///
    /// # Errors
    /// That sentence, without the protocol's name.
    pub fn check(&self) -> Result<(), String> {
        let plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
        if self.name.is_empty() || !self.name.chars().all(plain) {
            return Err("its name must be made of letters, digits, `-`, `_` and `.`".to_owned());
        }
        let (min, max) = (self.min_depth_m as f32, self.max_depth_m as f32);
        if !(min > 0.0 && min < max && max.is_finite()) {
            return Err(format!(
                "its depth limits are {} and {}, but must be 0 < min < max",
                self.min_depth_m, self.max_depth_m
            ));
        }
        let floor = self.disparity_floor_fraction;
        if !(0.0..1.0).contains(&floor) {
            return Err(format!(
                "its disparity floor is {floor}, but must be a fraction of the width from 0 up"
            ));
        }
        let positive = |what: &str, value: f64| {
            if value > 0.0 && (value as f32).is_normal() {
                Ok(())
            } else {
                Err(format!("its {what} is {value}, but must be positive"))
            }
        };
        match self.camera {
            Camera::Nominal { baseline_m } => positive("baseline", baseline_m)?,
            Camera::Agreed {
                focal_fraction,
                baseline_m,
            } => {
                positive("baseline", baseline_m)?;
                positive("focal length", focal_fraction)?;
            }
            Camera::Calibrated | Camera::Unknown => {}
        }
        if let Crop::Pixels {
            rows: [top, bottom],
            columns: [left, right],
        } = self.crop
            && (top >= bottom || left >= right)
        {
            return Err(format!(
                "its crop is rows {top} to {bottom} and columns {left} to {right}, which is not a box"
            ));
        }
        if matches!(self.camera, Camera::Nominal { .. }) && !self.ground_truth.is_stereo() {
            return Err(
                "a nominal camera is known for stereo 2015 ground truth only; use `calibrated`"
                    .to_owned(),
            );
        }
        if self.ground_truth.is_stereo()
            && matches!(self.camera, Camera::Agreed { .. } | Camera::Unknown)
        {
            return Err(
                "stereo ground truth becomes depth with the camera of the image, so the camera \
                 must be nominal or calibrated"
                    .to_owned(),
            );
        }
        if self.ground_truth == GroundTruthKind::Laser
            && self.camera == Camera::Calibrated
            && self.alignment == Alignment::None
        {
            return Err(
                "the laser's grid has other columns than the image whose calibration it would \
                 take, so it needs an alignment, such as `alignment: median`, or another camera"
                    .to_owned(),
            );
        }
        if self.benchmark_crop != BenchmarkCrop::None && self.ground_truth == GroundTruthKind::Laser
        {
            return Err("the laser's grid has no crop of KITTI's benchmark".to_owned());
        }
        if self.d1_rule.is_some() && !self.ground_truth.is_stereo() {
            return Err("D1-all needs ground truth that is disparity".to_owned());
        }
        if self.grouping != Grouping::None && self.ground_truth == GroundTruthKind::Laser {
            return Err("the laser grid has no labels".to_owned());
        }
        Ok(())
    }
}
