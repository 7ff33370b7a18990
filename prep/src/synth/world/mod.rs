//! The world of one drive: what stands along its street and what moves on it.
//!
//! Everything is a function of the drive's seed, the block it stands in and, for
//! what moves, of time; a frame is populated from these without any history.
//! Not here: how each thing is made (`objects`) and the course of the street (`geometry`).

mod boundary;
mod crossing;
mod frame;
mod frontage;
pub(crate) mod light;
mod pavement;
mod pose;
mod traffic;

pub(crate) use pose::Pose;

use crate::synth::geometry::shapes::Material;
use crate::synth::geometry::street::{BLOCK_M, Frontage, Side, Street, Theme};
use crate::synth::objects::builder::{Builder, skin};
use crate::synth::objects::label;
use crate::synth::random::{Rng, key};
use crate::synth::vector::{V3, v3};
use frame::{AHEAD_M, BEHIND_M, Frame, Lot};
use light::Light;

/// A drive: street, light and everything placed by its seed.
#[derive(Clone, Debug)]
pub(crate) struct World {
    pub seed: u64,
    pub street: Street,
    pub light: Light,
    start_x: f64,
}

impl World {
    pub fn new(seed: u64, theme: Theme) -> Self {
        let start_x = f64::from(Rng::new(key(&[seed, 6])).range(100.0, 900.0));
        Self {
            seed,
            street: Street::new(seed, theme),
            light: Light::new(seed),
            start_x,
        }
    }

    /// Camera car at frame `index` of a recording at ten frames per second.
    pub fn pose(&self, index: u32) -> Pose {
        Pose::new(&self.street, self.seed, self.start_x, index)
    }

    /// Everything around a pose, relative to the origin (ox, oy).
    pub fn populate(&self, pose: &Pose, ox: f64, oy: f64) -> Builder {
        let frame = Frame {
            street: &self.street,
            seed: self.seed,
            ox,
            oy,
            camera_x: pose.x,
        };
        let mut b = Builder::default();
        traffic::traffic(&mut b, &frame, pose);
        let first = ((pose.x - BEHIND_M) / BLOCK_M).floor() as i64;
        let last = ((pose.x + AHEAD_M) / BLOCK_M).floor() as i64;
        for block in first..=last {
            for side in Side::BOTH {
                populate_block(&mut b, &frame, side, block);
            }
            if let Some(half) = self.street.crossing(block) {
                crossing::crossing(&mut b, &frame, block, half);
            }
        }
        hills(&mut b, &frame);
        b
    }
}

/// One side of one block.
fn populate_block(b: &mut Builder, frame: &Frame, side: Side, block: i64) {
    let section = frame.street.section(side, block);
    let mut rng = Rng::new(key(&[frame.seed, 10, side as u64, block as u64]));
    let start = block as f64 * BLOCK_M;
    let margin = |crossing: Option<f32>| crossing.map_or(0.0, |half| f64::from(half) + 2.6);
    let from = start + margin(frame.street.crossing(block));
    let to = start + BLOCK_M - margin(frame.street.crossing(block + 1));
    let lot = Lot {
        side,
        from,
        to,
        edge: frame.street.lanes_m() + section.parking_m,
        section,
    };
    pavement::pavement(b, frame, &lot, &mut rng);
    match section.frontage {
        Frontage::Terrace => frontage::terrace(b, frame, &lot, &mut rng),
        Frontage::Houses => frontage::houses(b, frame, &lot, &mut rng),
        Frontage::Park => frontage::park(b, frame, &lot, &mut rng),
        Frontage::Depot => frontage::depot(b, frame, &lot, &mut rng),
        Frontage::LongWall => frontage::long_wall(b, frame, &lot, &mut rng),
        Frontage::Forest => frontage::forest(b, frame, &lot, &mut rng),
        Frontage::Field => frontage::field(b, frame, &lot, &mut rng),
    }
}

/// Hills at the horizon.
fn hills(b: &mut Builder, frame: &Frame) {
    let cell = (frame.camera_x / 400.0).floor() as i64;
    for i in cell..cell + 4 {
        let mut rng = Rng::new(key(&[frame.seed, 18, i as u64]));
        for side in Side::BOTH {
            let x = i as f64 * 400.0 + f64::from(rng.range(0.0, 400.0));
            let l = side.sign() * rng.range(260.0, 520.0);
            let radii = v3(
                rng.range(200.0, 420.0),
                rng.range(120.0, 220.0),
                rng.range(18.0, 55.0),
            );
            let mut place = frame.place(x, 0.0, 0.0);
            place.at.y += l;
            let hill = skin(Material::Hill, [0.10, 0.14, 0.06], rng.bits() as u32);
            if x - frame.camera_x > f64::from(radii.x) * 0.5 {
                b.ellipsoid(place, V3::default(), radii, hill, (label::VEGETATION, 0));
            }
        }
    }
}
