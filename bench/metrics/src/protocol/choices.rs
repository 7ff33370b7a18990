//! The small choices of a protocol: what is compared, where, and how it is counted.

use std::fmt;

use serde::de::{self, Deserializer, Visitor};
use serde::{Deserialize, Serialize};

/// Which measured depth a prediction is compared with.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum GroundTruthKind {
    /// KITTI stereo 2015, `disp_noc_0`: pixels whose match lies inside the right image.
    StereoNoc,
    /// KITTI stereo 2015, `disp_occ_0`: every measured pixel.
    StereoOcc,
    /// Velodyne scan projected into the left image; the value is the scanner's own forward
    /// axis, about 0.27 m to 0.33 m more than the depth seen by the camera.
    VelodyneX,
    /// Velodyne scan projected into the left image; the value is the depth along the axis of
    /// the rectified camera.
    CameraZ,
    /// KITTI depth ("improved" ground truth): scans of eleven frames put together and checked
    /// against stereo; depth along the camera's axis. 652 of the 697 Eigen test images have it.
    Annotated,
    /// Make3D's laser grid, 305 columns x 21 rows after the central crop of PROTOCOL 1.4;
    /// distance in metres.
    Laser,
}

impl GroundTruthKind {
    /// True for ground truth that is stored as disparity.
    pub fn is_stereo(self) -> bool {
        matches!(self, Self::StereoNoc | Self::StereoOcc)
    }
}

/// What is resized to the size of the ground truth, and how. The caller does it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Resize {
    /// Disparity, bilinear (PROTOCOL 3.3).
    #[default]
    DisparityBilinear,
    /// Depth, nearest neighbour (PROTOCOL 1.4); taking the nearest disparity is the same.
    DepthNearest,
}

/// Base of the logarithm in the metric `rmse_log`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LogBase {
    /// Natural logarithm, as everywhere on KITTI.
    #[default]
    Natural,
    /// Base 10, as on Make3D.
    Ten,
}

/// Part of the image that is scored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Crop {
    /// The whole image.
    None,
    /// Crop of Garg et al. (ECCV 2016).
    Garg,
    /// Crop of Eigen et al. (NIPS 2014).
    Eigen,
    /// A box in pixels, for sets whose images all have one size, such as NYU Depth's.
    Pixels {
        /// First row and one past the last.
        rows: [u32; 2],
        /// First column and one past the last.
        columns: [u32; 2],
    },
}

impl Crop {
    /// First row, end row, first column, end column as fractions of height and width; none of a crop
    /// that is not given by fractions.
    pub fn fractions(self) -> Option<[f64; 4]> {
        match self {
            Self::None | Self::Pixels { .. } => None,
            Self::Garg => Some([0.408_108_11, 0.991_891_89, 0.035_947_71, 0.964_052_29]),
            Self::Eigen => Some([0.332_432_4, 0.913_513_51, 0.035_947_7, 0.964_052_29]),
        }
    }
}

/// What becomes of the infinite depth of a pixel whose disparity is exactly zero. It can be
/// met only where the disparity floor is switched off.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum InfiniteDepth {
    /// It is clipped to the far limit (reference, KITTI split).
    FarLimit,
    /// It is set to zero first and so ends at the near limit (reference, Eigen split).
    NearLimit,
}

/// When a disparity counts as wrong in D1-all: error of 3 px and 5 % of the true disparity.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum D1Rule {
    /// Errors equal to a limit count as wrong (reference evaluation of Godard et al.).
    Inclusive,
    /// Only errors above both limits count as wrong (KITTI 2015 development kit).
    Strict,
}

/// How a prediction is fitted to the true depth of its own image before it is clipped
/// (PROTOCOL 10.1): over the scored pixels, by one or two numbers that have seen the truth.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Alignment {
    /// Not at all: depth is compared as it is.
    #[default]
    None,
    /// Depth times median(true) / median(predicted).
    Median,
    /// Depth times the scale of least squares to true depth.
    ScaleDepth,
    /// Depth times scale plus shift, by least squares to true depth.
    AffineDepth,
    /// Inverse depth times the scale of least squares to 1 / true depth.
    ScaleDisparity,
    /// Inverse depth times scale plus shift, by least squares to 1 / true depth.
    AffineDisparity,
}

impl Alignment {
    /// All of them.
    pub const ALL: [Self; 6] = [
        Self::None,
        Self::Median,
        Self::ScaleDepth,
        Self::AffineDepth,
        Self::ScaleDisparity,
        Self::AffineDisparity,
    ];

    /// The word in names of protocols and in files.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Median => "median",
            Self::ScaleDepth => "scale-depth",
            Self::AffineDepth => "affine-depth",
            Self::ScaleDisparity => "scale-disparity",
            Self::AffineDisparity => "affine-disparity",
        }
    }

    /// Whether inverse depth is fitted, to 1 / true depth; otherwise depth is, to true depth.
    #[must_use]
    pub const fn is_of_inverse_depth(self) -> bool {
        matches!(self, Self::ScaleDisparity | Self::AffineDisparity)
    }

    /// Whether a shift is fitted beside the scale.
    #[must_use]
    pub const fn has_shift(self) -> bool {
        matches!(self, Self::AffineDepth | Self::AffineDisparity)
    }

    /// What the numbers of an aligned image are, for people; `None` without alignment.
    #[must_use]
    pub const fn fitted(self) -> Option<&'static str> {
        match self {
            Self::None => None,
            Self::AffineDepth | Self::AffineDisparity => Some("scale and shift"),
            Self::Median | Self::ScaleDepth | Self::ScaleDisparity => Some("scale"),
        }
    }
}

impl fmt::Display for Alignment {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

/// Also reads `median_scaling: true` or `false`, as earlier versions wrote it.
impl<'de> Deserialize<'de> for Alignment {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Word;
        impl Visitor<'_> for Word {
            type Value = Alignment;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                let words = Alignment::ALL.map(Alignment::as_str).join(", ");
                write!(f, "one of {words}")
            }

            fn visit_bool<E: de::Error>(self, is_median: bool) -> Result<Alignment, E> {
                Ok(if is_median {
                    Alignment::Median
                } else {
                    Alignment::None
                })
            }

            fn visit_str<E: de::Error>(self, text: &str) -> Result<Alignment, E> {
                let mut all = Alignment::ALL.into_iter();
                all.find(|known| known.as_str() == text)
                    .ok_or_else(|| E::invalid_value(de::Unexpected::Str(text), &self))
            }
        }
        deserializer.deserialize_any(Word)
    }
}

/// Whether KITTI's benchmark crop is in the way (PROTOCOL 10.2): 352 rows and 1216 columns, at the
/// bottom and in the middle of an image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BenchmarkCrop {
    /// The model is shown the whole image.
    #[default]
    None,
    /// The model is shown the crop, its prediction goes back to its place, and the rest of the
    /// image has none. The crop that is scored is that of the whole image.
    Image,
    /// Image and ground truth are cut, and the crop that is scored is that of what is left.
    ImageAndTruth,
}

/// What is done with the network's disparity before it is resized.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PostProcessing {
    /// Nothing.
    None,
    /// Blend with the prediction for the mirrored image, see [`flip_blend`](crate::flip_blend).
    Flip,
}
