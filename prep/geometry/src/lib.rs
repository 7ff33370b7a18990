//! KITTI calibration files, rectified cameras, Velodyne projection, disparity and depth.
//!
//! Definitions follow PROTOCOL 1.1 (files), 3.4 (nominal rig) and 3.5 (ground truth from
//! Velodyne scans). Everything is a pure function of its arguments: this crate reads no
//! files and knows no splits. Projection is done in `f64`.

mod calibration;
mod frustum;
mod stereo;
mod velodyne;

pub use calibration::{CalibrationError, CamToCam, VeloToCam};
pub use stereo::{NOMINAL_BASELINE_M, depth_from_disparity_px, nominal_focal_px};
pub use velodyne::{
    DepthAxis, ScanDepth, ScanError, parse_velodyne, velodyne_depth, velodyne_projection,
};
