//! Side streets.

use super::frame::Frame;
use crate::synth::geometry::street::{BLOCK_M, Side, Theme};
use crate::synth::objects::builder::Builder;
use crate::synth::objects::buildings::{House, house};
use crate::synth::objects::furniture::signal;
use crate::synth::objects::vehicles::car;
use crate::synth::random::{Rng, key};
use crate::synth::vector::{V3, v3};

/// A side street: traffic lights or signs, a waiting car.
pub(crate) fn crossing(b: &mut Builder, frame: &Frame, block: i64, half: f32) {
    let mut rng = Rng::new(key(&[frame.seed, 11, block as u64]));
    let x = block as f64 * BLOCK_M;
    let edge = frame.street.lanes_m() + 0.8;
    let lights = frame.street.theme == Theme::City && rng.chance(0.7);
    if lights {
        let phase = rng.below(3) as u32;
        for (dx, l) in [(-1.0, -edge), (1.0, edge), (-1.0, edge), (1.0, -edge)] {
            let at = x + dx * (f64::from(half) + 1.2);
            let section = frame
                .street
                .section(if l > 0.0 { Side::Left } else { Side::Right }, block);
            let l = l + section.parking_m * l.signum();
            if frame.visible(at) {
                let place = frame.place(at, l, frame.kerb());
                let place = if dx > 0.0 {
                    place.offset(V3::default(), 2)
                } else {
                    place
                };
                signal(b, place, phase);
            }
        }
    }
    for side in Side::BOTH {
        let mut own = Rng::new(rng.bits());
        let section = frame.street.section(side, block);
        let l = side.sign() * (edge + section.parking_m + own.range(2.6, 7.0));
        if own.chance(0.55) && frame.visible(x) {
            // Waits to turn in: looks at the street.
            let place = frame.facing(x, l, 0.0);
            let place = place.offset(v3(1.6, 0.0, 0.0), 3);
            car(b, place, &mut own);
        }
        if own.chance(0.7) {
            let place = frame.place(x, side.sign() * own.range(45.0, 70.0), frame.kerb());
            let style = House {
                width: 16.0,
                depth: 10.0,
                storeys: 3,
                gabled: true,
                shop: false,
            };
            house(
                b,
                if l > 0.0 {
                    place
                } else {
                    place.offset(V3::default(), 2)
                },
                style,
                &mut own,
            );
        }
    }
}
