//! Resize kernels whose result is part of a protocol, and so must never change.
//!
//! [`Kernel::Area`] follows OpenCV's `INTER_AREA` in value and rounding: a box filter with fractional
//! edge weights (PROTOCOL 3.10). [`Kernel::Bilinear`] follows OpenCV's `INTER_LINEAR` convention:
//! half-pixel centres, repeated border, no antialiasing (PROTOCOL 3.3). [`Kernel::OpencvCubic`] follows
//! OpenCV's `INTER_CUBIC` within a grey level, [`Kernel::Lanczos3`] and [`Kernel::PillowBicubic`] follow
//! Pillow's `LANCZOS` and `BICUBIC` in value and rounding (PROTOCOL 10.5). Coordinates are computed in
//! `f64`.

mod area;
mod bilinear;
mod interpolate;
mod pillow;

use std::fmt;
use std::str::FromStr;

use image::RgbImage;
use serde::{Deserialize, Serialize};

pub use self::area::area_f32;
pub use self::bilinear::{bilinear_at, bilinear_f32};
pub use self::interpolate::{Alignment, Interpolation, interpolate_f32};

/// How an image is brought to another size.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kernel {
    /// Every target pixel is the mean of the source area it covers. Enlarging falls back to
    /// [`Kernel::Bilinear`].
    #[default]
    Area,
    /// Linear interpolation between the four nearest source pixels, as OpenCV's `INTER_LINEAR`.
    #[serde(alias = "opencv-linear")]
    Bilinear,
    /// Antialiased windowed sinc of three lobes, as Pillow's `LANCZOS`.
    #[serde(alias = "lanczos")]
    Lanczos3,
    /// Cubic interpolation between the sixteen nearest source pixels, as OpenCV's `INTER_CUBIC`; not
    /// antialiased.
    #[serde(rename = "opencv-cubic")]
    OpencvCubic,
    /// Antialiased cubic of another shape, as Pillow's `BICUBIC`.
    #[serde(rename = "pillow-bicubic")]
    PillowBicubic,
}

/// A name that is no kernel.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "unknown resize kernel `{0}`; the kernels are `area`, `bilinear` (or `opencv-linear`), `lanczos3`, \
     `opencv-cubic` and `pillow-bicubic`"
)]
pub struct ParseKernelError(String);

impl Kernel {
    /// All kernels.
    pub const ALL: [Self; 5] = [
        Self::Area,
        Self::Bilinear,
        Self::Lanczos3,
        Self::OpencvCubic,
        Self::PillowBicubic,
    ];

    /// The name in settings, manifests and descriptions.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Area => "area",
            Self::Bilinear => "bilinear",
            Self::Lanczos3 => "lanczos3",
            Self::OpencvCubic => "opencv-cubic",
            Self::PillowBicubic => "pillow-bicubic",
        }
    }
}

impl fmt::Display for Kernel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

impl FromStr for Kernel {
    type Err = ParseKernelError;

    fn from_str(text: &str) -> Result<Self, ParseKernelError> {
        match text {
            // As Pillow and others call it.
            "lanczos" => Ok(Self::Lanczos3),
            "opencv-linear" => Ok(Self::Bilinear),
            text => (Self::ALL.into_iter().find(|k| k.as_str() == text))
                .ok_or_else(|| ParseKernelError(text.to_owned())),
        }
    }
}

/// Resizes an RGB image to `width` x `height`; the same size gives a copy.
///
/// # Panics
/// If an image has no pixels.
pub fn rgb(image: &RgbImage, width: u32, height: u32, kernel: Kernel) -> RgbImage {
    assert!(
        image.width() > 0 && image.height() > 0 && width > 0 && height > 0,
        "images have pixels"
    );
    if image.dimensions() == (width, height) {
        return image.clone();
    }
    let shrinks = image.width() >= width && image.height() >= height;
    match kernel {
        Kernel::Area if shrinks => area::rgb(image, width, height),
        Kernel::Area | Kernel::Bilinear => bilinear::rgb(image, width, height),
        Kernel::Lanczos3 => pillow::rgb(image, width, height, pillow::Filter::Lanczos3),
        Kernel::OpencvCubic => interpolate::cubic_rgb(image, width, height),
        Kernel::PillowBicubic => pillow::rgb(image, width, height, pillow::Filter::Bicubic),
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::raster::Plane;

    /// (31 x + 17 y + 71 c + 3 (x y mod 97)) mod 256
    pub fn picture(width: u32, height: u32) -> RgbImage {
        RgbImage::from_fn(width, height, |x, y| {
            image::Rgb([0, 1, 2].map(|c| ((31 * x + 17 * y + 71 * c + x * y % 97 * 3) % 256) as u8))
        })
    }

    /// The red channel of [`picture`] over 256.
    pub fn plane() -> Plane {
        let data = picture(61, 37)
            .pixels()
            .map(|p| f32::from(p.0[0]) / 256.0)
            .collect();
        Plane {
            width: 61,
            height: 37,
            data,
        }
    }

    /// Sum of value times 1-based index, modulo 2^64.
    pub fn fingerprint(values: impl IntoIterator<Item = u64>) -> u64 {
        values
            .into_iter()
            .zip(1_u64..)
            .fold(0, |sum, (v, i)| sum.wrapping_add(v.wrapping_mul(i)))
    }

    #[test]
    fn enlarging_by_area_is_bilinear() {
        let image = picture(20, 30);
        for (width, height) in [(40, 60), (10, 60), (40, 15)] {
            assert_eq!(
                rgb(&image, width, height, Kernel::Area),
                rgb(&image, width, height, Kernel::Bilinear)
            );
        }
        assert_eq!(area_f32(&plane(), 70, 10), bilinear_f32(&plane(), 70, 10));
    }

    #[test]
    fn kernel_names() {
        for kernel in Kernel::ALL {
            assert_eq!(kernel.to_string().parse(), Ok(kernel));
        }
        assert_eq!("lanczos".parse(), Ok(Kernel::Lanczos3));
        assert_eq!(
            serde_yaml::from_str::<Kernel>("lanczos").unwrap(),
            Kernel::Lanczos3
        );
        assert_eq!(
            serde_yaml::from_str::<Kernel>("lanczos3").unwrap(),
            Kernel::Lanczos3
        );
        assert!(
            "cubic"
                .parse::<Kernel>()
                .unwrap_err()
                .to_string()
                .contains("`lanczos3`, `opencv-cubic` and")
        );
        assert_eq!("opencv-linear".parse(), Ok(Kernel::Bilinear));
        for kernel in Kernel::ALL {
            let text = serde_yaml::to_string(&kernel).unwrap();
            assert_eq!(text.trim(), kernel.as_str());
            assert_eq!(serde_yaml::from_str::<Kernel>(&text).unwrap(), kernel);
        }
    }

    proptest! {
        #[test]
        fn results_stay_within_the_range_of_the_source(
            (width, height) in (1_usize..40, 1_usize..40), (to_width, to_height) in (1_usize..60, 1_usize..60), seed: u32
        ) {
            let data: Vec<f32> = (0..width * height)
                .map(|i| ((i as u32).wrapping_mul(2_654_435_761).wrapping_add(seed) >> 16) as f32)
                .collect();
            let low = data.iter().copied().fold(f32::INFINITY, f32::min);
            let high = data.iter().copied().fold(f32::NEG_INFINITY, f32::max);
            let plane = Plane::new(width, height, data).unwrap();
            for other in [area_f32(&plane, to_width, to_height), bilinear_f32(&plane, to_width, to_height)] {
                prop_assert_eq!((other.width, other.height, other.data.len()), (to_width, to_height, to_width * to_height));
                let slack = 1e-5 * high;
                prop_assert!(other.data.iter().all(|v| (low - slack..=high + slack).contains(v)));
            }
        }

        #[test]
        fn byte_images_agree_with_planes_up_to_rounding(
            (width, height) in (1_u32..50, 1_u32..50), (to_width, to_height) in (1_u32..50, 1_u32..50)
        ) {
            let image = picture(width, height);
            let data = image.pixels().map(|p| f32::from(p.0[1])).collect();
            let plane = Plane::new(width as usize, height as usize, data).unwrap();
            let exact = area_f32(&plane, to_width as usize, to_height as usize);
            let bytes = rgb(&image, to_width, to_height, Kernel::Area);
            for (pixel, value) in bytes.pixels().zip(&exact.data) {
                prop_assert!((f32::from(pixel.0[1]) - value).abs() < 0.51 + 0.3, "{} {value}", pixel.0[1]);
            }
        }
    }
}
