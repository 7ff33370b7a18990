//! Street positions as places of one frame, and the stretch of a block that is built on.

use crate::synth::geometry::street::{Section, Side, Street};
use crate::synth::objects::builder::Placement;
use crate::synth::vector::{V3, v3};

/// How far ahead and behind things are placed.
pub(crate) const AHEAD_M: f64 = 270.0;

pub(crate) const BEHIND_M: f64 = 55.0;

/// Converts street positions to places of the frame.
pub(crate) struct Frame<'a> {
    pub street: &'a Street,
    /// Seed of the drive.
    pub seed: u64,
    pub ox: f64,
    pub oy: f64,
    pub camera_x: f64,
}

impl Frame<'_> {
    pub fn place(&self, x: f64, l: f32, z: f32) -> Placement {
        let (cos, sin) = self.street.heading(x);
        let y = self.street.centre(x) + f64::from(l) / cos;
        Placement {
            at: v3((x - self.ox) as f32, (y - self.oy) as f32, z),
            cos: cos as f32,
            sin: sin as f32,
        }
    }

    /// A place whose -y side faces the street, whichever side of it it is on.
    pub fn facing(&self, x: f64, l: f32, z: f32) -> Placement {
        let place = self.place(x, l, z);
        if l >= 0.0 {
            place
        } else {
            place.offset(V3::default(), 2)
        }
    }

    pub fn distance(&self, x: f64) -> f64 {
        (x - self.camera_x).abs()
    }

    pub fn visible(&self, x: f64) -> bool {
        x > self.camera_x - BEHIND_M && x < self.camera_x + AHEAD_M
    }

    pub fn kerb(&self) -> f32 {
        self.street.kerb_m
    }
}

/// The stretch of one side of a block that may be built on.
pub(crate) struct Lot {
    pub side: Side,
    pub from: f64,
    pub to: f64,
    /// Lateral distance of the kerb.
    pub edge: f32,
    pub section: Section,
}

/// How finely crowns are made at a distance.
pub(crate) fn detail(frame: &Frame, x: f64) -> usize {
    match frame.distance(x) {
        d if d < 45.0 => 12,
        d if d < 110.0 => 8,
        _ => 4,
    }
}
