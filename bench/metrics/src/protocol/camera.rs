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
    /// No camera: depth is 1 / disparity (as a fraction of width) in no unit, so disparity can be
    /// scored under protocols with median scaling only. Predicted metres need no camera.
    Unknown,
}

/// Two cameras side by side: depth in metres = focal length * baseline / disparity in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct StereoCamera {
    /// Focal length in pixels.
    pub focal_px: f64,
    /// Distance of the two cameras in metres.
    pub baseline_m: f64,
}

impl StereoCamera {
    /// Depth in metres at a disparity as wide as an image of that width: what turns depth into
    /// disparity as a fraction of image width and back.
    #[must_use]
    pub fn depth_at_width_m(self, width: usize) -> f64 {
        self.focal_px * self.baseline_m / width as f64
    }
}

/// What is known of the camera of one image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KnownCamera {
    /// Focal length and baseline of the image's own calibration.
    pub calibration: StereoCamera,
    /// The focal length that is nominal for the image width, for stereo 2015.
    pub nominal_focal_px: Option<f64>,
}

/// Why a protocol's camera cannot be had for an image.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum CameraError {
    /// A value that is not a positive number.
    #[error(
        "the {what} of the image is {value}; a positive number of common size is needed (a protocol \
         with `camera: unknown` needs none to score predicted metres)"
    )]
    Value {
        /// Focal length, baseline or their product.
        what: &'static str,
        /// The value.
        value: f64,
    },
    /// No nominal focal length.
    #[error(
        "the protocol takes the focal length that is nominal for the width of a stereo 2015 image, \
         and for this image there is none"
    )]
    NoNominal,
}

impl Camera {
    /// The camera through which a protocol sees an image: the one place where this is decided.
    /// `width` in pixels is that of the image or, for ground truth with a grid of its own, of the
    /// grid.
    ///
    /// # Errors
    /// What the protocol asks for is not known or not a positive number.
    pub fn resolve(self, known: &KnownCamera, width: usize) -> Result<StereoCamera, CameraError> {
        let camera = match self {
            Self::Nominal { baseline_m } => StereoCamera {
                focal_px: known.nominal_focal_px.ok_or(CameraError::NoNominal)?,
                baseline_m,
            },
            Self::Calibrated => known.calibration,
            Self::Agreed {
                focal_fraction,
                baseline_m,
            } => StereoCamera {
                focal_px: focal_fraction * width as f64,
                baseline_m,
            },
            // One metre for a disparity of the whole width: the scale is the median's anyway.
            Self::Unknown => StereoCamera {
                focal_px: width as f64,
                baseline_m: 1.0,
            },
        };
        for (what, value) in [
            ("focal length in pixels", camera.focal_px),
            ("baseline in metres", camera.baseline_m),
            (
                "product of focal length and baseline",
                camera.focal_px * camera.baseline_m,
            ),
        ] {
            if !(value > 0.0 && (value as f32).is_normal()) {
                return Err(CameraError::Value { what, value });
            }
        }
        Ok(camera)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const KNOWN: KnownCamera = KnownCamera {
        calibration: StereoCamera {
            focal_px: 700.0,
            baseline_m: 0.53,
        },
        nominal_focal_px: Some(721.5377),
    };

    #[test]
    fn a_protocol_chooses_its_camera() {
        let of = |camera: Camera, known: &KnownCamera| {
            let found = camera.resolve(known, 1242)?;
            Ok((found.focal_px, found.baseline_m))
        };
        let nominal = Camera::Nominal { baseline_m: 0.54 };
        assert_eq!(of(nominal, &KNOWN), Ok((721.5377, 0.54)));
        assert_eq!(of(Camera::Calibrated, &KNOWN), Ok((700.0, 0.53)));
        let agreed = Camera::Agreed {
            focal_fraction: 0.5,
            baseline_m: 0.1,
        };
        assert_eq!(of(agreed, &KNOWN), Ok((621.0, 0.1)));
        assert_eq!(of(Camera::Unknown, &KNOWN), Ok((1242.0, 1.0)));

        let mut unknown = KNOWN;
        unknown.nominal_focal_px = None;
        assert_eq!(of(nominal, &unknown), Err(CameraError::NoNominal));
        for value in [0.0, -0.5, f64::NAN, f64::INFINITY, 1e-60] {
            unknown.calibration.baseline_m = value;
            assert!(of(Camera::Calibrated, &unknown).is_err(), "{value}");
        }
    }

    #[test]
    fn depth_is_disparity_upside_down() {
        let camera = StereoCamera {
            focal_px: 700.0,
            baseline_m: 0.5,
        };
        // 35 px of 1000 are 10 m.
        assert!((camera.depth_at_width_m(1000) / 0.035 - 10.0).abs() < 1e-12);
    }
}
