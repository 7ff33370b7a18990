//! Rays through the pixels of a rectified camera.
//!
//! Directions have unit depth, so that `t` is the camera's z in metres and
//! `focal_px * baseline_m / t` the disparity. Pixel (column, row) looks along image
//! point (column + 1, row + 1): the habit of counting from one that the reference
//! evaluation applies to projected scans (PROTOCOL 3.5, step 4), so that scans and
//! pictures agree there.

use crate::synth::vector::V3;

/// A camera of the rig in the scene's coordinates.
#[derive(Clone, Debug)]
pub(crate) struct PinholeCamera {
    pub width: usize,
    pub height: usize,
    pub focal_px: f32,
    pub cx: f32,
    pub cy: f32,
    pub eye: V3,
    pub right: V3,
    pub down: V3,
    pub forward: V3,
}

impl PinholeCamera {
    /// Ray direction of unit depth through a pixel position.
    pub fn direction(&self, column: f32, row: f32) -> V3 {
        self.right * ((column + 1.0 - self.cx) / self.focal_px)
            + self.down * ((row + 1.0 - self.cy) / self.focal_px)
            + self.forward
    }

    /// Metres per pixel at unit depth.
    pub fn spread(&self) -> f32 {
        1.0 / self.focal_px
    }

    /// A point in the camera's frame: right, down, forward.
    pub fn to_camera(&self, p: V3) -> V3 {
        let away = p - self.eye;
        V3 {
            x: away.dot(self.right),
            y: away.dot(self.down),
            z: away.dot(self.forward),
        }
    }
}
