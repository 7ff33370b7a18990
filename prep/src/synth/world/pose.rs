//! Where the camera car is.

use crate::synth::geometry::street::Street;
use crate::synth::random::{Rng, key};
use crate::synth::vector::sin_cos;

/// Height of the rectified camera above the carriageway.
const CAMERA_HEIGHT_M: f64 = 1.65;

/// Where the camera car is, in world coordinates.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pose {
    pub x: f64,
    pub y: f64,
    pub height_m: f64,
    pub cos: f64,
    pub sin: f64,
    /// Nose up, radians.
    pub pitch: f64,
    /// Right side down, radians.
    pub roll: f64,
    pub seconds: f64,
}

impl Pose {
    /// Camera car at frame `index` of a recording at ten frames per second.
    pub fn new(street: &Street, seed: u64, start_x: f64, index: u32) -> Self {
        let seconds = f64::from(index) * 0.1;
        let x = start_x + street.speed_mps * seconds;
        let (cos, sin) = street.heading(x);
        let wobble = |rate: f64, phase: u64| {
            let shift = f64::from(Rng::new(key(&[seed, 7, phase])).angle());
            sin_cos(rate * seconds + shift).0 + 0.6 * sin_cos(2.7 * rate * seconds + 2.0 * shift).0
        };
        let yaw = 0.008 * wobble(0.9, 1);
        let l = f64::from(street.camera_l) + 0.12 * wobble(0.4, 2);
        let (ys, yc) = sin_cos(yaw);
        Self {
            x,
            y: street.centre(x) + l / cos,
            height_m: CAMERA_HEIGHT_M + 0.015 * wobble(5.0, 3),
            cos: cos * yc - sin * ys,
            sin: sin * yc + cos * ys,
            pitch: 0.005 * wobble(3.1, 4) - 0.004,
            roll: 0.006 * wobble(2.3, 5),
            seconds,
        }
    }
}
