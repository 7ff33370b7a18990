//! The files of one image of a prepared set: picture, ground truth, labels.
//!
//! Every file must be the one that was prepared (BLAKE3 of `test.csv`). [`SampleError`] is why one
//! image has no row. Not here: what is made of the files; see [`super::score`](mod@super::score).

use image::RgbImage;
use strat_metrics::{
    EvaluateError, GroundTruth, GroundTruthKind, Grouping, KnownCamera, Protocol, StereoCamera,
};
use strat_store::{
    exr, files, image_files,
    set::{FileRef, PreparedSet, Sample},
};

use super::predictions::SavedError;
use crate::model::ModelError;

/// Why one image has no row.
#[derive(Debug, thiserror::Error)]
pub enum SampleError {
    /// A file could not be read or decoded.
    #[error(transparent)]
    Store(#[from] strat_store::Error),
    /// A file is not the one that was prepared.
    #[error(
        "{path} has changed since the set was prepared (its BLAKE3 is not the one in test.csv); \
         prepare the set again"
    )]
    Changed {
        /// The file, relative to the set.
        path: String,
    },
    /// The set has no such file for this image.
    #[error("the prepared set has no {what} for this image")]
    Missing {
        /// What is missing.
        what: &'static str,
    },
    /// A file has another size than the row says.
    #[error("{path} is {found_width}x{found_height}, but test.csv says {width}x{height}")]
    Size {
        /// The file, relative to the set.
        path: String,
        /// Width of the file.
        found_width: usize,
        /// Height of the file.
        found_height: usize,
        /// Width in the row.
        width: u32,
        /// Height in the row.
        height: u32,
    },
    /// The model failed on this image.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// There is no usable saved prediction for this image.
    #[error(transparent)]
    Saved(#[from] SavedError),
    /// Ground truth that is none.
    #[error("{path}: {reason}")]
    GroundTruth {
        /// The file, relative to the set.
        path: String,
        /// Why.
        reason: EvaluateError,
    },
    /// The image cannot be scored under a protocol.
    #[error("{protocol}: {reason}")]
    Evaluate {
        /// Name of the protocol.
        protocol: String,
        /// Why.
        reason: EvaluateError,
    },
}

impl SampleError {
    /// What is wrong is wrong with all maps, not with this image.
    pub(super) fn condemns_all(&self) -> bool {
        matches!(
            self,
            Self::Model(
                ModelError::Implausible { .. }
                    | ModelError::OutputShape { .. }
                    | ModelError::NoOutput { .. }
            ) | Self::Saved(SavedError::Implausible { .. })
        )
    }
}

/// The image that a model is shown: the untouched one where the set has it.
pub(crate) fn load_image(set: &PreparedSet, sample: &Sample) -> Result<RgbImage, SampleError> {
    let file = sample.left_full.as_ref().unwrap_or(&sample.left);
    let image = image_files::decode_rgb(&checked_bytes(set, file)?, &file.path)?;
    if sample.left_full.is_some() && image.dimensions() != (sample.width, sample.height) {
        return Err(SampleError::Size {
            path: file.path.clone(),
            found_width: image.width() as usize,
            found_height: image.height() as usize,
            width: sample.width,
            height: sample.height,
        });
    }
    Ok(image)
}

/// The semantic labels of an image, a byte for each pixel.
pub(crate) fn load_labels(set: &PreparedSet, sample: &Sample) -> Result<Vec<u8>, SampleError> {
    let file = sample.semantic.as_ref().ok_or(SampleError::Missing {
        what: "semantic labels",
    })?;
    let bytes = checked_bytes(set, file)?;
    let (width, height, labels) = image_files::decode_gray8(&bytes, &file.path)?;
    if (width, height) != (sample.width as usize, sample.height as usize) {
        return Err(SampleError::Size {
            path: file.path.clone(),
            found_width: width,
            found_height: height,
            width: sample.width,
            height: sample.height,
        });
    }
    Ok(labels)
}

/// The bytes of a file of the set, which must be those that were prepared.
pub(crate) fn checked_bytes(set: &PreparedSet, file: &FileRef) -> Result<Vec<u8>, SampleError> {
    let bytes = files::read(&set.path(file))?;
    if files::blake3_hex(&bytes) == file.blake3 {
        Ok(bytes)
    } else {
        Err(SampleError::Changed {
            path: file.path.clone(),
        })
    }
}

/// What the set knows of one image besides its picture, read when a protocol first needs it.
pub(super) struct Scene<'a> {
    set: &'a PreparedSet,
    pub(super) sample: &'a Sample,
    truths: Vec<(GroundTruthKind, GroundTruth)>,
}

impl<'a> Scene<'a> {
    pub(super) fn new(set: &'a PreparedSet, sample: &'a Sample) -> Self {
        Self {
            set,
            sample,
            truths: Vec::new(),
        }
    }

    /// The ground truth that a protocol compares with, with labels where it groups by them.
    pub(super) fn needed_by(&mut self, protocol: &Protocol) -> Result<&GroundTruth, SampleError> {
        let kind = protocol.ground_truth;
        let known = self.truths.iter().position(|(known, _)| *known == kind);
        let index = match known {
            Some(index) => index,
            None => {
                let truth = load_truth(self.set, self.sample, kind)?;
                self.truths.push((kind, truth));
                self.truths.len() - 1
            }
        };
        let truth = &mut self.truths[index].1;
        if protocol.grouping == Grouping::Cityscapes && !truth.has_labels() {
            let labels = load_labels(self.set, self.sample)?;
            truth
                .set_labels(labels)
                .map_err(|reason| SampleError::Evaluate {
                    protocol: protocol.name.clone(),
                    reason,
                })?;
        }
        Ok(truth)
    }
}

fn load_truth(
    set: &PreparedSet,
    sample: &Sample,
    kind: GroundTruthKind,
) -> Result<GroundTruth, SampleError> {
    let (file, what) = match kind {
        GroundTruthKind::StereoNoc => (&sample.depth_noc, "disp_noc ground truth"),
        GroundTruthKind::StereoOcc => (&sample.depth_occ, "disp_occ ground truth"),
        GroundTruthKind::VelodyneX => (&sample.depth_velodyne, "Velodyne ground truth"),
        GroundTruthKind::CameraZ => (&sample.depth_camera, "camera-z ground truth"),
        GroundTruthKind::Annotated => (&sample.depth_annotated, "KITTI depth ground truth"),
        GroundTruthKind::Laser => (&sample.depth_laser, "laser ground truth"),
    };
    let file = file.as_ref().ok_or(SampleError::Missing { what })?;
    let bytes = checked_bytes(set, file)?;
    let (depth, header) = exr::decode_depth(&bytes, &set.path(file))?;
    // The laser measured a grid of its own.
    if kind != GroundTruthKind::Laser
        && (depth.width, depth.height) != (sample.width as usize, sample.height as usize)
    {
        return Err(SampleError::Size {
            path: file.path.clone(),
            found_width: depth.width,
            found_height: depth.height,
            width: sample.width,
            height: sample.height,
        });
    }
    // Measured disparities are multiples of 1/256 px, so they come back exactly.
    let disparity_px: Option<Vec<f32>> = kind.is_stereo().then(|| {
        let focal_baseline = header.focal_px * header.baseline_m;
        depth
            .data
            .iter()
            .map(|&depth_m| {
                if depth_m > 0.0 {
                    let units = (256.0 * focal_baseline / f64::from(depth_m)).round();
                    (units / 256.0) as f32
                } else {
                    0.0
                }
            })
            .collect()
    });
    let camera = KnownCamera {
        calibration: StereoCamera {
            focal_px: sample.focal_px,
            baseline_m: sample.baseline_m,
        },
        // What made depth out of disparity.
        nominal_focal_px: kind.is_stereo().then_some(header.focal_px),
    };
    let size = (depth.width, depth.height);
    match disparity_px {
        Some(disparity_px) => GroundTruth::stereo(size, depth.data, disparity_px, camera),
        None => GroundTruth::new(size, depth.data, camera),
    }
    .map_err(|reason| SampleError::GroundTruth {
        path: file.path.clone(),
        reason,
    })
}
