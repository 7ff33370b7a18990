//! The small choices of a protocol: what is compared, where, and how it is counted.

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

/// What is done with the network's disparity before it is resized.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PostProcessing {
    /// Nothing.
    None,
    /// Blend with the prediction for the mirrored image, see [`flip_blend`](crate::flip_blend).
    Flip,
}
