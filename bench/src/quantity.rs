//! From a model's numbers to a map of one quantity: depth, disparity or inverse depth.
//!
//! Depth follows from disparity by `focal_px * baseline_m / disparity_px`, all at the width of the image
//! the focal length belongs to; where the camera is not known there is no depth, and nothing is guessed.
//! Values are not clipped: limits belong to the protocols of an evaluation.

use std::fmt;

use serde::{Deserialize, Serialize};
pub use strat_metrics::StereoCamera;
use strat_onnx::metadata::OutputMeaning;
use strat_store::raster::Plane;

/// What the values of a map are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Quantity {
    /// Depth along the camera's axis in metres, 0 = none.
    DepthM,
    /// Disparity in pixels of the map's own width.
    DisparityPx,
    /// Disparity as a fraction of image width.
    DisparityFraction,
    /// Inverse depth, in 1/m where the scale is known.
    InverseDepth,
}

impl Quantity {
    /// All of them.
    pub const ALL: [Self; 4] = [
        Self::DepthM,
        Self::DisparityPx,
        Self::DisparityFraction,
        Self::InverseDepth,
    ];

    /// The word used in files and messages.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::DepthM => "depth_m",
            Self::DisparityPx => "disparity_px",
            Self::DisparityFraction => "disparity_fraction",
            Self::InverseDepth => "inverse_depth",
        }
    }
}

impl Quantity {
    /// The word of `--quantity`.
    #[must_use]
    pub fn option(self) -> String {
        self.as_str().replace('_', "-")
    }
}

impl fmt::Display for Quantity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

/// A quantity that does not follow from what is known.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NoSuchQuantity {
    /// Depth and disparity need a camera to be converted into each other.
    #[error(
        "{} cannot be derived from the model's {meaning} without the camera: give --focal-px and \
         --baseline-m, or --format npy,color with --quantity {}", wanted.option(), instead.option()
    )]
    NoCamera {
        /// What was requested.
        wanted: Quantity,
        /// What the model gives.
        meaning: OutputMeaning,
        /// What is available.
        instead: Quantity,
    },
    /// Depth and inverse depth of unknown scale stay that.
    #[error(
        "{} cannot be derived from this model: its {meaning} has no known scale; give --format npy,color, or \
         `scale` in its description", wanted.option()
    )]
    NoScale {
        /// What was requested.
        wanted: Quantity,
        /// What the model gives.
        meaning: OutputMeaning,
    },
}

/// The quantity of a model of this meaning where the user names none: depth if it follows.
#[must_use]
pub fn default_quantity(meaning: OutputMeaning, camera: Option<StereoCamera>) -> Quantity {
    match (meaning, camera) {
        (OutputMeaning::InverseDepth | OutputMeaning::Depth, _) => Quantity::InverseDepth,
        (OutputMeaning::DepthM | OutputMeaning::InverseDepthPerM, _) | (_, Some(_)) => {
            Quantity::DepthM
        }
        (OutputMeaning::DisparityFraction | OutputMeaning::DisparityPx, None) => {
            Quantity::DisparityPx
        }
    }
}

/// How a model's numbers become one quantity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Conversion {
    /// What comes out.
    pub quantity: Quantity,
    meaning: OutputMeaning,
    /// Width of the network's input in pixels.
    input_width: u32,
    camera: Option<StereoCamera>,
}

impl Conversion {
    /// Makes sure that `quantity` follows from what is known.
    ///
    /// # Errors
    /// The camera is missing, or the model's scale is unknown.
    pub fn new(
        quantity: Quantity,
        meaning: OutputMeaning,
        input_width: u32,
        camera: Option<StereoCamera>,
    ) -> Result<Self, NoSuchQuantity> {
        let gives_disparity = matches!(
            meaning,
            OutputMeaning::DisparityFraction | OutputMeaning::DisparityPx
        );
        let wants_disparity = matches!(
            quantity,
            Quantity::DisparityFraction | Quantity::DisparityPx
        );
        if !meaning.has_scale() && quantity != Quantity::InverseDepth {
            return Err(NoSuchQuantity::NoScale {
                wanted: quantity,
                meaning,
            });
        }
        let crosses = meaning.has_scale() && gives_disparity != wants_disparity;
        if crosses && camera.is_none() {
            return Err(NoSuchQuantity::NoCamera {
                wanted: quantity,
                meaning,
                instead: default_quantity(meaning, None),
            });
        }
        Ok(Self {
            quantity,
            meaning,
            input_width,
            camera,
        })
    }

    /// Converts a map of the model's numbers that belongs to an image of `image_width` pixels.
    ///
    /// The map may have another width than the image; disparity in pixels is in pixels of the map.
    #[must_use]
    pub fn apply(&self, mut map: Plane, image_width: u32) -> Plane {
        let width = map.width as f64;
        // Depth times disparity as a fraction of image width; unused where there is no camera.
        let product = self.camera.map_or(0.0, |camera| {
            camera.focal_px * camera.baseline_m / f64::from(image_width)
        });
        // Disparity as a fraction of image width is `value * fraction`.
        let fraction = match self.meaning {
            OutputMeaning::DisparityPx => 1.0 / f64::from(self.input_width),
            _ => 1.0,
        };
        let over = |factor: f64| {
            let factor = factor as f32;
            move |value: f32| if value > 0.0 { factor / value } else { 0.0 }
        };
        let times = |factor: f64| {
            let factor = factor as f32;
            move |value: f32| value * factor
        };
        let data = &mut map.data;
        match (self.meaning, self.quantity) {
            (OutputMeaning::InverseDepth, _)
            | (OutputMeaning::InverseDepthPerM, Quantity::InverseDepth)
            | (OutputMeaning::DepthM, Quantity::DepthM) => {}
            (OutputMeaning::InverseDepthPerM, Quantity::DepthM) => each(data, over(1.0)),
            (OutputMeaning::InverseDepthPerM, Quantity::DisparityFraction) => {
                each(data, times(product));
            }
            (OutputMeaning::InverseDepthPerM, Quantity::DisparityPx) => {
                each(data, times(product * width));
            }
            (OutputMeaning::Depth, _) | (OutputMeaning::DepthM, Quantity::InverseDepth) => {
                each(data, over(1.0));
            }
            (OutputMeaning::DepthM, Quantity::DisparityFraction) => each(data, over(product)),
            (OutputMeaning::DepthM, Quantity::DisparityPx) => each(data, over(product * width)),
            (_, Quantity::DisparityFraction) => each(data, times(fraction)),
            (_, Quantity::DisparityPx) => each(data, times(fraction * width)),
            (_, Quantity::DepthM) => each(data, over(product / fraction)),
            (_, Quantity::InverseDepth) => each(data, times(fraction / product)),
        }
        // A depth that single precision cannot hold is none.
        if self.quantity == Quantity::DepthM {
            each(data, |value| {
                if value.is_finite() && value > 0.0 {
                    value
                } else {
                    0.0
                }
            });
        }
        map
    }
}

fn each(data: &mut [f32], change: impl Fn(f32) -> f32) {
    for value in data {
        *value = change(*value);
    }
}

/// A map as 16-bit PNG: the value times `scale`, rounded; 0 where there is none.
///
/// Returns the bytes, and how many values are too large for the format (above 255.99 at a scale of 256) and
/// were written as 0, because a clipped value would look like a measured one.
///
/// # Panics
/// If the plane's size contradicts its data.
#[must_use]
pub fn encode_png16(map: &Plane, scale: f64) -> (Vec<u8>, usize) {
    let mut too_large = 0;
    let values: Vec<u16> = map
        .data
        .iter()
        .map(|&value| {
            let units = (f64::from(value) * scale).round();
            if units > f64::from(u16::MAX) {
                too_large += 1;
                0
            } else {
                // A float below 0 becomes 0.
                units as u16
            }
        })
        .collect();
    let bytes =
        strat_store::image_files::encode_png_gray16(map.width as u32, map.height as u32, &values);
    (bytes, too_large)
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAMERA: StereoCamera = StereoCamera {
        focal_px: 700.0,
        baseline_m: 0.5,
    };

    fn convert(quantity: Quantity, meaning: OutputMeaning, value: f32) -> f32 {
        let conversion = Conversion::new(quantity, meaning, 500, Some(CAMERA)).unwrap();
        // The map has half the width of its image.
        conversion.apply(Plane::filled(500, 1, value), 1000).data[0]
    }

    /// By hand: focal 700 px and 0.5 m at a width of 1000 px: 35 px (0.035 of the width) are 10 m.
    #[test]
    fn quantities_follow_from_each_other() {
        use OutputMeaning as From;
        use Quantity as To;
        for (meaning, value) in [
            (From::DisparityFraction, 0.035),
            (From::DisparityPx, 17.5),
            (From::InverseDepthPerM, 0.1),
            (From::DepthM, 10.0),
        ] {
            for (quantity, expected) in [
                (To::DepthM, 10.0),
                (To::DisparityFraction, 0.035),
                (To::DisparityPx, 17.5),
                (To::InverseDepth, 0.1),
            ] {
                let found = convert(quantity, meaning, value);
                assert!(
                    (found / expected - 1.0).abs() < 1e-6,
                    "{meaning} to {quantity}: {found}"
                );
            }
        }
        for nothing in [0.0, -0.1] {
            assert_eq!(convert(To::DepthM, From::DisparityFraction, nothing), 0.0);
            assert_eq!(convert(To::DepthM, From::DepthM, nothing), 0.0);
        }
        // 0.35 / 1e-40 is beyond single precision.
        assert_eq!(convert(To::DepthM, From::DisparityFraction, 1e-40), 0.0);
    }

    #[test]
    fn depth_is_not_guessed() {
        use OutputMeaning as From;
        let new = |quantity, meaning, camera| Conversion::new(quantity, meaning, 500, camera);
        let error = new(Quantity::DepthM, From::DisparityFraction, None).unwrap_err();
        assert!(error.to_string().contains("--focal-px"), "{error}");
        assert!(error.to_string().contains("disparity-px"), "{error}");
        let error = new(Quantity::DepthM, From::InverseDepth, Some(CAMERA)).unwrap_err();
        assert!(error.to_string().contains("no known scale"), "{error}");
        let error = new(Quantity::DepthM, From::Depth, Some(CAMERA)).unwrap_err();
        assert!(
            error.to_string().contains("its depth has no known scale"),
            "{error}"
        );
        assert_eq!(convert(Quantity::InverseDepth, From::Depth, 4.0), 0.25);
        assert!(new(Quantity::DepthM, From::DepthM, None).is_ok());
        assert!(new(Quantity::InverseDepth, From::DepthM, None).is_ok());
        assert!(new(Quantity::DisparityPx, From::DepthM, None).is_err());
        assert_eq!(
            default_quantity(From::DisparityPx, None),
            Quantity::DisparityPx
        );
        assert_eq!(
            default_quantity(From::DisparityPx, Some(CAMERA)),
            Quantity::DepthM
        );
        assert_eq!(
            default_quantity(From::InverseDepth, Some(CAMERA)),
            Quantity::InverseDepth
        );
        for meaning in OutputMeaning::ALL {
            for camera in [None, Some(CAMERA)] {
                assert!(new(default_quantity(meaning, camera), meaning, camera).is_ok());
            }
        }
    }

    #[test]
    fn sixteen_bits_hold_what_they_can() {
        let map = Plane::new(5, 1, vec![10.0, 0.0, 255.99, 256.0, 1.0 / 512.0]).unwrap();
        let (bytes, too_large) = encode_png16(&map, 256.0);
        assert_eq!(too_large, 1);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("d.png");
        std::fs::write(&path, bytes).unwrap();
        let (_, _, values) = strat_store::image_files::read_gray16(&path).unwrap();
        assert_eq!(values, [2560, 0, 65533, 0, 1]);
    }
}
