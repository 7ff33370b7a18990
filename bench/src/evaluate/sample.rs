//! The files of one image of a prepared set: picture, ground truth, labels.
//!
//! Every file must be the one that was prepared (BLAKE3 of `test.csv`). [`SampleError`] is why one
//! image has no row. Not here: what is made of the files; see [`super::score`](mod@super::score).

use image::RgbImage;
use strat_metrics::{
    EvaluateError, GroundTruth, GroundTruthKind, Grouping, KnownCamera, Protocol, Scratch,
    StereoCamera, TruthRows,
};
use strat_store::inputs::{self, Kind};
use strat_store::{
    exr, files, image_files,
    set::{FileRef, PreparedSet, Sample},
};

use super::predictions::{MapFault, SavedError};
use crate::{model::ModelError, view::NoCrop};

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
    /// The image has no such crop.
    #[error(transparent)]
    NoCrop(#[from] NoCrop),
    /// The model failed on this image.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// There is not a usable saved prediction for this image.
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
            ) | Self::Saved(SavedError::Map {
                fault: MapFault::Implausible(_),
                ..
            })
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
///
/// # Errors
/// The file cannot be read, or has changed.
pub fn checked_bytes(set: &PreparedSet, file: &FileRef) -> Result<Vec<u8>, SampleError> {
    let extension = file.path.rsplit_once('.').map_or("", |(_, e)| e);
    let bytes = inputs::read(&set.path(file), Kind::of_extension(extension))?;
    if files::blake3_hex(&bytes) == file.blake3 {
        Ok(bytes)
    } else {
        Err(SampleError::Changed {
            path: file.path.clone(),
        })
    }
}

/// What one prediction is compared with.
pub(super) struct Scene<'a> {
    /// Id of the image.
    pub(super) image: &'a str,
    /// Columns and rows of the image.
    pub(super) size: (usize, usize),
    truths: Truths<'a>,
}

/// Where ground truth comes from.
enum Truths<'a> {
    /// Files of a set, read when a protocol first needs them.
    Files {
        set: &'a PreparedSet,
        sample: &'a Sample,
        read: Vec<(GroundTruthKind, GroundTruth, Scratch)>,
    },
    /// Handed over, whatever protocol asks.
    Given(GroundTruth, Scratch),
}

impl<'a> Scene<'a> {
    /// An image of a set.
    pub(super) fn of_set(set: &'a PreparedSet, sample: &'a Sample) -> Self {
        Self {
            image: &sample.id,
            size: (sample.width as usize, sample.height as usize),
            truths: Truths::Files {
                set,
                sample,
                read: Vec::new(),
            },
        }
    }

    /// An image of which nothing but its ground truth, of the image's size, is known.
    pub(super) fn given(truth: GroundTruth) -> Self {
        Self {
            image: "",
            size: truth.size(),
            truths: Truths::Given(truth, Scratch::default()),
        }
    }

    /// The ground truth that a protocol compares with, with labels where it groups by them, and what other
    /// protocols have found there. `None` where the protocol is not about this image.
    pub(super) fn needed_by(
        &mut self,
        protocol: &Protocol,
    ) -> Result<Option<(&GroundTruth, &mut Scratch)>, SampleError> {
        let (set, sample, read) = match &mut self.truths {
            Truths::Given(truth, scratch) => return Ok(Some((truth, scratch))),
            Truths::Files { set, sample, read } => (set, sample, read),
        };
        let kind = protocol.ground_truth;
        // 45 of the 697 images were never given such depth: no failure, the protocol is about the
        // other 652 (PROTOCOL 1.2).
        if kind == GroundTruthKind::Annotated && sample.depth_annotated.is_none() {
            return Ok(None);
        }
        let known = read.iter().position(|(known, ..)| *known == kind);
        let index = match known {
            Some(index) => index,
            None => {
                let truth = load_truth(set, sample, kind)?;
                read.push((kind, truth, Scratch::default()));
                read.len() - 1
            }
        };
        let (_, truth, scratch) = &mut read[index];
        if protocol.grouping == Grouping::Cityscapes && !truth.has_labels() {
            let labels = load_labels(set, sample)?;
            truth
                .set_labels(labels)
                .map_err(|reason| SampleError::Evaluate {
                    protocol: protocol.name.clone(),
                    reason,
                })?;
        }
        Ok(Some((truth, scratch)))
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
    let path = set.path(file);
    let depth = exr::DepthFile::open(&bytes, &path)?;
    let (width, height) = depth.size();
    // The laser measured a grid of its own.
    if kind != GroundTruthKind::Laser
        && (width, height) != (sample.width as usize, sample.height as usize)
    {
        return Err(SampleError::Size {
            path: file.path.clone(),
            found_width: width,
            found_height: height,
            width: sample.width,
            height: sample.height,
        });
    }
    let calibration = StereoCamera {
        focal_px: sample.focal_px,
        baseline_m: sample.baseline_m,
    };
    let truth = if kind.is_stereo() {
        // What made depth out of disparity.
        let stereo = StereoCamera {
            focal_px: depth.header().focal_px,
            baseline_m: depth.header().baseline_m,
        };
        let (depth, _) = depth.plane()?;
        truth_of_depth((width, height), &depth.data, calibration, Some(stereo))
    } else {
        let camera = KnownCamera {
            calibration,
            nominal_focal_px: None,
        };
        let mut rows = TruthRows::new((width, height), camera);
        depth.rows(|depth_m| rows.add(depth_m))?;
        rows.finish()
    };
    truth.map_err(|reason| SampleError::GroundTruth {
        path: file.path.clone(),
        reason,
    })
}

/// Depth in metres of a size (columns, rows), 0 where there is none, as ground truth seen by a
/// calibrated camera. Where the depth was made of disparity, `stereo` is the camera that made it, and
/// the disparity comes back.
///
/// # Errors
/// A plane of wrong size, and values that are negative or not finite.
pub fn truth_of_depth(
    size: (usize, usize),
    depth_m: &[f32],
    calibration: StereoCamera,
    stereo: Option<StereoCamera>,
) -> Result<GroundTruth, EvaluateError> {
    let camera = KnownCamera {
        calibration,
        nominal_focal_px: stereo.map(|camera| camera.focal_px),
    };
    let Some(stereo) = stereo else {
        return GroundTruth::new(size, depth_m, camera);
    };
    let focal_baseline = stereo.focal_px * stereo.baseline_m;
    // Measured disparities are multiples of 1/256 px, so they come back exactly.
    let disparity_px = |&depth_m: &f32| {
        if depth_m > 0.0 {
            let units = (256.0 * focal_baseline / f64::from(depth_m)).round();
            (units / 256.0) as f32
        } else {
            0.0
        }
    };
    let disparity_px: Vec<f32> = depth_m.iter().map(disparity_px).collect();
    GroundTruth::stereo(size, depth_m, &disparity_px, camera)
}
