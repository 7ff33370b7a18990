//! What stands between kerb and frontage: parked cars, street trees, lamps, signs, people.

use super::frame::{Frame, Lot, detail};
use crate::synth::geometry::shapes::Material;
use crate::synth::geometry::street::Theme;
use crate::synth::objects::builder::{Builder, skin};
use crate::synth::objects::furniture::{furniture, street_lamp, traffic_sign};
use crate::synth::objects::label;
use crate::synth::objects::people::{bicycle, person};
use crate::synth::objects::plants::tree;
use crate::synth::objects::vehicles::{car, van};
use crate::synth::random::Rng;
use crate::synth::vector::{V3, v3};

/// Parked cars, street trees, lamps, signs, people: what stands between kerb and frontage.
pub(crate) fn pavement(b: &mut Builder, frame: &Frame, lot: &Lot, rng: &mut Rng) {
    let sign = lot.side.sign();
    if lot.section.parking_m > 0.0 {
        let share = rng.range(0.15, 0.95);
        let l = lot.edge - lot.section.parking_m / 2.0;
        let mut x = lot.from + 4.0;
        while x < lot.to - 3.0 {
            let mut own = Rng::new(rng.bits());
            let step = f64::from(own.range(5.2, 6.4));
            if own.chance(share) && frame.visible(x) {
                let mut place = frame.place(x, sign * (l + own.range(-0.15, 0.2)), 0.0);
                // On the left cars face the other way.
                if sign > 0.0 {
                    place = place.offset(V3::default(), 2);
                }
                if own.chance(0.12) {
                    van(b, place, &mut own);
                } else {
                    car(b, place, &mut own);
                }
            }
            x += step;
        }
    }
    if lot.section.walk_m <= 0.0 {
        // Posts with reflectors along the open road, a rail on some stretches.
        if rng.chance(0.35) {
            guard_rail(b, frame, lot, lot.edge + 0.7);
        } else {
            let mut x = (lot.from / 16.0).ceil() * 16.0;
            while x < lot.to {
                let white = skin(Material::SignBack, [0.75, 0.75, 0.73], 1);
                let place = frame.place(x, sign * (lot.edge + 0.6), frame.kerb());
                b.block(
                    place,
                    v3(-0.06, -0.05, 0.0),
                    v3(0.06, 0.05, 1.0),
                    white,
                    (label::POLE, 0),
                );
                x += 16.0;
            }
        }
        return;
    }
    if lot.section.walk_m > 2.0 && rng.chance(0.45) {
        let gap = f64::from(rng.range(7.0, 13.0));
        let height = rng.range(6.0, 10.0);
        let mut x = lot.from + 3.0;
        while x < lot.to {
            let mut own = Rng::new(rng.bits());
            if own.chance(0.85) && frame.visible(x) {
                let place = frame.place(x, sign * (lot.edge + 0.7), frame.kerb());
                let tall = height * own.range(0.85, 1.15);
                tree(b, place, tall, detail(frame, x), &mut own);
            }
            x += gap;
        }
    }
    let lamp = lot.from + 8.0 + f64::from(rng.range(0.0, 16.0));
    if rng.chance(0.7) && frame.visible(lamp) {
        let place = frame.facing(lamp, sign * (lot.edge + 0.5), frame.kerb());
        street_lamp(b, place, rng.range(5.0, 8.0));
    }
    for _ in 0..rng.below(3) {
        let mut own = Rng::new(rng.bits());
        let x = lot.from + f64::from(own.unit()) * (lot.to - lot.from);
        if !frame.visible(x) {
            continue;
        }
        let mut place = frame.place(x, sign * (lot.edge + own.range(0.35, 0.6)), frame.kerb());
        if sign > 0.0 && own.chance(0.5) {
            place = place.offset(V3::default(), 2);
        }
        traffic_sign(b, place, &mut own);
    }
    for _ in 0..rng.below(4) {
        let mut own = Rng::new(rng.bits());
        let x = lot.from + f64::from(own.unit()) * (lot.to - lot.from);
        let l = lot.edge
            + if own.chance(0.6) {
                0.5
            } else {
                lot.section.walk_m - 0.4
            };
        if frame.visible(x) {
            furniture(b, frame.place(x, sign * l, frame.kerb()), &mut own);
        }
    }
    if frame.street.theme != Theme::Road && rng.chance(0.3) {
        let mut own = Rng::new(rng.bits());
        let x = lot.from + f64::from(own.unit()) * (lot.to - lot.from);
        if frame.visible(x) {
            let place = frame.place(
                x,
                sign * (lot.edge + lot.section.walk_m - 0.5),
                frame.kerb(),
            );
            bicycle(
                b,
                place.offset(V3::default(), own.below(4) as u32),
                false,
                0.0,
                &mut own,
            );
        }
    }
    // People who stand and talk; those who walk are part of the traffic.
    if frame.street.theme != Theme::Road && rng.chance(0.25) {
        let mut own = Rng::new(rng.bits());
        let x = lot.from + f64::from(own.unit()) * (lot.to - lot.from);
        if frame.visible(x) {
            for i in 0..1 + own.below(3) {
                let l = lot.edge + own.range(0.5, lot.section.walk_m.max(0.8));
                let place = frame.place(x + 0.5 * i as f64, sign * l, frame.kerb());
                person(
                    b,
                    place.offset(V3::default(), own.below(4) as u32),
                    0.1,
                    &mut own,
                );
            }
        }
    }
}

pub(crate) fn guard_rail(b: &mut Builder, frame: &Frame, lot: &Lot, l: f32) {
    let sign = lot.side.sign();
    let rail = skin(Material::Metal, [0.40, 0.41, 0.42], 2);
    let mut x = (lot.from / 4.0).ceil() * 4.0;
    while x < lot.to {
        if frame.visible(x) {
            let place = frame.place(x + 2.0, sign * l, frame.kerb());
            let tag = (label::GUARD_RAIL, 0);
            b.block(
                place,
                v3(-2.06, -0.04, 0.45),
                v3(2.06, 0.04, 0.76),
                rail,
                tag,
            );
            b.block(place, v3(-0.06, 0.04, 0.0), v3(0.06, 0.14, 0.70), rail, tag);
        }
        x += 4.0;
    }
}
