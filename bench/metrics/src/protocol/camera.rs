//! Where focal length and baseline come from when disparity becomes depth.

use serde::{Deserialize, Serialize};

/// Where focal length and baseline come from when disparity becomes depth.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Camera {
    /// One agreed baseline for every image; the focal length is the one nominal for the image
    /// width and is given by the caller.
    Nominal {
        /// Distance of the two cameras in metres.
        baseline_m: f64,
    },
    /// Focal length and baseline of the image's own calibration, both given by the caller.
    Calibrated,
    /// One agreed camera for every image, whatever its calibration: for disparity d as a
    /// fraction of width, depth = focal_fraction * baseline_m / d.
    Agreed {
        /// Focal length as a fraction of image width.
        focal_fraction: f64,
        /// Distance of the two cameras in metres.
        baseline_m: f64,
    },
    /// No camera: depth is 1 / disparity (as a fraction of width) in no unit, so only
    /// protocols with median scaling can use it.
    Unknown,
}
