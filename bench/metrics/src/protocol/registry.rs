//! The protocols that have names, without suffixes.

use std::sync::LazyLock;

use super::camera::Camera;
use super::choices::{
    Alignment, BenchmarkCrop, Crop, D1Rule, GroundTruthKind, InfiniteDepth, LogBase,
    PostProcessing, Resize,
};
use super::group::Grouping;
use super::rules::Protocol;

impl Protocol {
    fn kitti2015(name: &str, ground_truth: GroundTruthKind) -> Self {
        Self {
            name: name.to_owned(),
            version: 1,
            ground_truth,
            camera: Camera::Nominal { baseline_m: 0.54 },
            crop: Crop::None,
            min_depth_m: 1e-3,
            max_depth_m: 80.0,
            mask_ground_truth: false,
            strict_comparisons: true,
            disparity_floor_fraction: 1e-4,
            infinite_depth: InfiniteDepth::FarLimit,
            alignment: Alignment::None,
            post_processing: PostProcessing::None,
            d1_rule: Some(D1Rule::Inclusive),
            grouping: Grouping::None,
            resize: Resize::DisparityBilinear,
            log_base: LogBase::Natural,
            benchmark_crop: BenchmarkCrop::None,
        }
    }

    fn eigen(name: &str, ground_truth: GroundTruthKind, min_m: f64, max_m: f64) -> Self {
        Self {
            name: name.to_owned(),
            version: 1,
            ground_truth,
            camera: Camera::Calibrated,
            crop: Crop::Garg,
            min_depth_m: min_m,
            max_depth_m: max_m,
            mask_ground_truth: true,
            strict_comparisons: true,
            disparity_floor_fraction: 1e-4,
            infinite_depth: InfiniteDepth::NearLimit,
            alignment: Alignment::None,
            post_processing: PostProcessing::None,
            d1_rule: None,
            grouping: Grouping::None,
            resize: Resize::DisparityBilinear,
            log_base: LogBase::Natural,
            benchmark_crop: BenchmarkCrop::None,
        }
    }

    /// PROTOCOL 10.4: what models up to scale and shift are published under.
    fn eigen_affine(alignment: Alignment) -> Self {
        let name = format!("eigen-{alignment}");
        Self {
            crop: Crop::Eigen,
            alignment,
            benchmark_crop: BenchmarkCrop::ImageAndTruth,
            ..Self::eigen(&name, GroundTruthKind::Annotated, 1e-5, 80.0)
        }
    }
}

/// All named protocols, those of the thesis' tables first.
#[must_use]
pub fn protocols() -> Vec<Protocol> {
    use GroundTruthKind::{Annotated, CameraZ, Laser, StereoNoc, StereoOcc, VelodyneX};
    vec![
        Protocol::kitti2015("kitti2015", StereoNoc),
        Protocol {
            d1_rule: None,
            grouping: Grouping::Cityscapes,
            ..Protocol::kitti2015("semantic", StereoNoc)
        },
        Protocol::eigen("eigen-80", VelodyneX, 1e-3, 80.0),
        Protocol::eigen("eigen-50", VelodyneX, 1e-3, 50.0),
        Protocol::kitti2015("kitti2015-occ", StereoOcc),
        Protocol {
            camera: Camera::Calibrated,
            ..Protocol::kitti2015("kitti2015-calibrated", StereoNoc)
        },
        Protocol::eigen("eigen-50-min1", VelodyneX, 1.0, 50.0),
        Protocol::eigen("eigen-cameraz-80", CameraZ, 1e-3, 80.0),
        Protocol::eigen("eigen-cameraz-50", CameraZ, 1e-3, 50.0),
        // PROTOCOL 3.8, `eigen_benchmark`: every measured pixel counts, whatever its depth.
        Protocol {
            crop: Crop::None,
            mask_ground_truth: false,
            ..Protocol::eigen("eigen-improved", Annotated, 1e-3, 80.0)
        },
        // PROTOCOL 3.8: monodepth2 masks, scales and clips as here, and its order gives the
        // figures of eigen-80. What differs is its camera: depth in metres is 5.4 times the
        // network's depth, which was trained with a focal length of 0.58 widths and a baseline
        // of 0.1 for 0.54 m, for every image; and nothing keeps disparity from being small.
        Protocol {
            camera: Camera::Agreed {
                focal_fraction: 0.58,
                baseline_m: 0.54,
            },
            disparity_floor_fraction: 0.0,
            infinite_depth: InfiniteDepth::FarLimit,
            ..Protocol::eigen("eigen-monodepth2", VelodyneX, 1e-3, 80.0)
        },
        // PROTOCOL 1.4, criterion C1.
        Protocol {
            camera: Camera::Unknown,
            crop: Crop::None,
            alignment: Alignment::Median,
            resize: Resize::DepthNearest,
            log_base: LogBase::Ten,
            ..Protocol::eigen("make3d-c1", Laser, 1e-3, 70.0)
        },
        // PROTOCOL 10.4. Version 1 of this name was `eigen-improved` with Garg's crop, where every
        // measured pixel counted, whatever its depth.
        Protocol {
            version: 2,
            ..Protocol::eigen("eigen-improved-garg", Annotated, 1e-3, 80.0)
        },
        Protocol {
            benchmark_crop: BenchmarkCrop::Image,
            ..Protocol::eigen("eigen-kb-garg", Annotated, 1e-3, 80.0)
        },
        Protocol::eigen_affine(Alignment::AffineDisparity),
        Protocol::eigen_affine(Alignment::AffineDepth),
    ]
}

/// The protocol of exactly that name.
pub(super) fn named(name: &str) -> Option<&'static Protocol> {
    static ALL: LazyLock<Vec<Protocol>> = LazyLock::new(protocols);
    ALL.iter().find(|known| known.name == name)
}
