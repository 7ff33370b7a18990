//! Cars, vans, lorries and buses.

use super::builder::{Builder, Placement, skin};
use super::label;
use super::paint::{car_paint, wheel_skin};
use crate::synth::geometry::shapes::{Material, Skin};
use crate::synth::random::Rng;
use crate::synth::vector::{blend, v3};

/// A passenger car that stands or drives at `place` (origin on the ground below its middle).
pub(crate) fn car(b: &mut Builder, place: Placement, rng: &mut Rng) {
    let tag = (label::CAR, b.next_object());
    let seed = rng.bits() as u32;
    let paint = car_paint(rng);
    let length = rng.range(3.7, 4.7);
    let (front, rear) = (length / 2.0, -length / 2.0);
    let half = rng.range(0.82, 0.92);
    let roof = rng.range(1.38, 1.58);
    let belt = rng.range(0.86, 0.96);
    let wheel = rng.range(0.29, 0.33);
    let (axle_front, axle_rear) = (front - 0.82, rear + 0.78);
    let body = Skin {
        material: Material::CarBody,
        paint,
        trim: [0.05, 0.05, 0.055],
        sizes: [front, axle_front, axle_rear, wheel],
        seed,
    };
    b.hull(
        place,
        &[
            (rear + 0.08, 0.24),
            (front - 0.10, 0.22),
            (front, 0.38),
            (front - 0.03, 0.60),
            (front - 0.25, 0.74),
            (front - 1.05, belt),
            (rear + 0.25, belt + 0.02),
            (rear + 0.04, belt - 0.06),
            (rear, 0.45),
        ],
        (half, 0.55, 0.10),
        body,
        tag,
    );
    let style = rng.below(3);
    let screen = front - rng.range(1.0, 1.25);
    // Hatchback, saloon, estate: where the roof ends and how the rear falls.
    let (roof_end, rear_foot) = match style {
        0 => (rear + 0.75, rear + 0.18),
        1 => (rear + 1.35, rear + 0.62),
        _ => (rear + 0.38, rear + 0.10),
    };
    let cabin = Skin {
        material: Material::CarCabin,
        sizes: [screen, roof, belt, rear_foot],
        ..body
    };
    b.hull(
        place,
        &[
            (rear_foot, belt - 0.02),
            (screen, belt - 0.04),
            (screen - 0.78, roof - 0.04),
            (screen - 1.10, roof),
            (roof_end + 0.25, roof - 0.01),
            (roof_end, roof - 0.07),
        ],
        (half - 0.07, belt, 0.24),
        cabin,
        tag,
    );
    for x in [axle_front, axle_rear] {
        for side in [1.0, -1.0] {
            let centre = v3(x, side * (half - 0.09), wheel);
            b.drum(place, centre, (wheel, 0.0, 0.105), wheel_skin(seed), tag);
        }
    }
    for side in [1.0, -1.0] {
        let mirror = v3(screen - 0.28, side * (half + 0.04), belt + 0.06);
        b.ellipsoid(
            place,
            mirror,
            v3(0.07, 0.10, 0.07),
            Skin {
                material: Material::Metal,
                ..body
            },
            tag,
        );
    }
    b.shade(place, length / 2.0, half);
}

/// A delivery van.
pub(crate) fn van(b: &mut Builder, place: Placement, rng: &mut Rng) {
    let tag = (label::CAR, b.next_object());
    let seed = rng.bits() as u32;
    let length = rng.range(4.7, 5.6);
    let (front, rear) = (length / 2.0, -length / 2.0);
    let half = rng.range(0.92, 1.0);
    let roof = rng.range(1.9, 2.5);
    let wheel = 0.33;
    let skin = Skin {
        material: Material::VanBody,
        paint: if rng.chance(0.6) {
            [0.56, 0.56, 0.54]
        } else {
            car_paint(rng)
        },
        trim: [0.04, 0.04, 0.045],
        sizes: [front, front - 0.85, rear + 0.95, roof],
        seed,
    };
    b.hull(
        place,
        &[
            (rear, 0.30),
            (front - 0.08, 0.28),
            (front, 0.45),
            (front - 0.08, 0.95),
            (front - 0.55, 1.15),
            (front - 1.25, roof - 0.1),
            (front - 1.55, roof),
            (rear + 0.08, roof),
            (rear, roof - 0.1),
        ],
        (half, 0.6, 0.035),
        skin,
        tag,
    );
    for x in [front - 0.85, rear + 0.95] {
        for side in [1.0, -1.0] {
            b.drum(
                place,
                v3(x, side * (half - 0.09), wheel),
                (wheel, 0.0, 0.11),
                wheel_skin(seed),
                tag,
            );
        }
    }
    b.shade(place, length / 2.0, half);
}

/// A lorry with a box.
pub(crate) fn truck(b: &mut Builder, place: Placement, rng: &mut Rng) {
    let tag = (label::TRUCK, b.next_object());
    let seed = rng.bits() as u32;
    let length = rng.range(7.0, 10.0);
    let (front, rear) = (length / 2.0, -length / 2.0);
    let top = rng.range(3.1, 3.7);
    let cab = Skin {
        material: Material::VanBody,
        paint: car_paint(rng),
        trim: [0.04, 0.04, 0.045],
        sizes: [front, front - 0.9, -100.0, 2.9],
        seed,
    };
    b.hull(
        place,
        &[
            (front - 1.9, 0.5),
            (front, 0.45),
            (front, 1.3),
            (front - 0.12, 2.6),
            (front - 0.4, 2.9),
            (front - 1.9, 2.9),
        ],
        (1.18, 0.6, 0.01),
        cab,
        tag,
    );
    let cargo = Skin {
        material: Material::CargoBox,
        paint: blend(car_paint(rng), [0.60, 0.60, 0.58], 0.5),
        trim: car_paint(rng),
        sizes: [length, top, 0.0, 0.0],
        seed,
    };
    b.block(
        place,
        v3(rear, -1.25, 1.0),
        v3(front - 2.05, 1.25, top),
        cargo,
        tag,
    );
    let frame = skin(Material::Metal, [0.05, 0.05, 0.05], seed);
    b.block(
        place,
        v3(rear + 0.1, -0.9, 0.55),
        v3(front - 0.5, 0.9, 1.0),
        frame,
        tag,
    );
    for x in [front - 0.9, rear + 1.2, rear + 2.3] {
        for side in [1.0, -1.0] {
            b.drum(
                place,
                v3(x, side * 1.05, 0.48),
                (0.48, 0.0, 0.16),
                wheel_skin(seed),
                tag,
            );
        }
    }
    b.shade(place, length / 2.0, 1.25);
}

/// A city bus.
pub(crate) fn bus(b: &mut Builder, place: Placement, rng: &mut Rng) {
    let tag = (label::BUS, b.next_object());
    let seed = rng.bits() as u32;
    let (front, rear) = (5.9, -5.9);
    let skin = Skin {
        material: Material::BusBody,
        paint: rng.pick(&[
            [0.60, 0.45, 0.05],
            [0.55, 0.06, 0.05],
            [0.65, 0.66, 0.66],
            [0.08, 0.2, 0.42],
        ]),
        trim: [0.03, 0.035, 0.04],
        sizes: [front, 3.0, 0.0, 0.0],
        seed,
    };
    b.hull(
        place,
        &[
            (rear, 0.35),
            (front, 0.33),
            (front, 1.1),
            (front - 0.15, 2.8),
            (front - 0.35, 3.0),
            (rear + 0.15, 3.0),
            (rear, 2.85),
        ],
        (1.25, 0.6, 0.01),
        skin,
        tag,
    );
    for x in [front - 2.6, rear + 3.2] {
        for side in [1.0, -1.0] {
            b.drum(
                place,
                v3(x, side * 1.12, 0.47),
                (0.47, 0.0, 0.15),
                wheel_skin(seed),
                tag,
            );
        }
    }
    b.shade(place, 5.9, 1.25);
}
