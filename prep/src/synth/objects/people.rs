//! People on foot, and bicycles with and without a rider.

use super::builder::{Builder, Placement, skin};
use super::label;
use super::paint::{TYRE, car_paint, cloth, wheel_skin};
use crate::synth::geometry::shapes::{Material, Skin};
use crate::synth::random::Rng;
use crate::synth::vector::{Rgb, v3};

const SKIN_TONES: [Rgb; 4] = [
    [0.60, 0.40, 0.30],
    [0.52, 0.33, 0.24],
    [0.32, 0.19, 0.12],
    [0.16, 0.09, 0.06],
];

/// A person; `stride` is the phase of walking in radians' stead, -1..1.
pub(crate) fn person(b: &mut Builder, place: Placement, stride: f32, rng: &mut Rng) {
    let tag = (label::PERSON, b.next_object());
    let seed = rng.bits() as u32;
    let h = rng.range(1.55, 1.9) / 1.75;
    let trousers = skin(Material::Cloth, cloth(rng), seed);
    let coat = skin(Material::Cloth, cloth(rng), seed ^ 77);
    let face = skin(Material::Skin, rng.pick(&SKIN_TONES), seed);
    let hair = skin(
        Material::Cloth,
        rng.pick(&[[0.03, 0.02, 0.015], [0.15, 0.09, 0.04], [0.35, 0.32, 0.3]]),
        seed,
    );
    let p = |x: f32, y: f32, z: f32| v3(x * h, y * h, z * h);
    let step = 0.28 * stride;
    for (side, swing) in [(1.0_f32, step), (-1.0, -step)] {
        let hip = p(0.0, 0.09 * side, 0.88);
        let knee = p(0.5 * swing + 0.04, 0.09 * side, 0.48);
        let foot = p(swing, 0.09 * side, 0.07);
        b.rod(place, hip, knee, 0.085 * h, trousers, tag);
        b.rod(place, knee, foot, 0.065 * h, trousers, tag);
        b.rod(place, foot, foot + p(0.14, 0.0, -0.02), 0.05 * h, hair, tag);
        let shoulder = p(0.0, 0.21 * side, 1.40);
        let elbow = p(-0.5 * swing, 0.26 * side, 1.12);
        let hand = p(-0.8 * swing + 0.08, 0.25 * side, 0.88);
        b.rod(place, shoulder, elbow, 0.06 * h, coat, tag);
        b.rod(place, elbow, hand, 0.05 * h, coat, tag);
        b.ellipsoid(place, hand, p(0.05, 0.04, 0.06), face, tag);
    }
    b.ellipsoid(place, p(0.0, 0.0, 1.17), p(0.15, 0.22, 0.37), coat, tag);
    b.ellipsoid(place, p(0.01, 0.0, 1.61), p(0.10, 0.085, 0.125), face, tag);
    b.ellipsoid(
        place,
        p(-0.02, 0.0, 1.645),
        p(0.105, 0.095, 0.105),
        hair,
        tag,
    );
    b.shade(place, 0.12, 0.16);
}

/// A bicycle, with its rider if `ridden`.
pub(crate) fn bicycle(b: &mut Builder, place: Placement, ridden: bool, pedal: f32, rng: &mut Rng) {
    let object = b.next_object();
    let tag = (label::BICYCLE, object);
    let seed = rng.bits() as u32;
    let metal = skin(Material::Metal, car_paint(rng), seed);
    let tyre = Skin {
        trim: TYRE,
        ..wheel_skin(seed)
    };
    for x in [-0.53, 0.53] {
        b.drum(place, v3(x, 0.0, 0.34), (0.34, 0.30, 0.022), tyre, tag);
        b.drum(place, v3(x, 0.0, 0.34), (0.04, 0.0, 0.05), metal, tag);
    }
    let (crank, saddle, head) = (
        v3(-0.08, 0.0, 0.32),
        v3(-0.22, 0.0, 0.88),
        v3(0.36, 0.0, 0.86),
    );
    for (from, to) in [
        (crank, saddle),
        (crank, head),
        (saddle, head),
        (v3(-0.53, 0.0, 0.34), crank),
        (v3(-0.53, 0.0, 0.34), saddle),
        (v3(0.53, 0.0, 0.34), v3(0.33, 0.0, 1.02)),
        (v3(0.28, 0.27, 1.05), v3(0.28, -0.27, 1.05)),
    ] {
        b.rod(place, from, to, 0.022, metal, tag);
    }
    b.rod(
        place,
        v3(-0.32, 0.0, 0.93),
        v3(-0.12, 0.0, 0.94),
        0.05,
        skin(Material::Cloth, TYRE, seed),
        tag,
    );
    if !ridden {
        return;
    }
    let tag = (label::RIDER, b.next_object());
    let trousers = skin(Material::Cloth, cloth(rng), seed);
    let coat = skin(Material::Cloth, cloth(rng), seed ^ 99);
    let face = skin(Material::Skin, rng.pick(&SKIN_TONES), seed);
    let helmet = skin(Material::Metal, cloth(rng), seed);
    for (side, phase) in [(1.0_f32, pedal), (-1.0, -pedal)] {
        let hip = v3(-0.20, 0.09 * side, 0.98);
        let foot = v3(-0.05 + 0.05 * phase, 0.11 * side, 0.30 - 0.16 * phase);
        let knee = v3(0.20, 0.11 * side, 0.70 - 0.10 * phase);
        b.rod(place, hip, knee, 0.085, trousers, tag);
        b.rod(place, knee, foot, 0.06, trousers, tag);
        b.rod(place, foot, foot + v3(0.13, 0.0, 0.0), 0.05, helmet, tag);
        let shoulder = v3(0.08, 0.20 * side, 1.45);
        b.rod(
            place,
            shoulder,
            v3(0.18, 0.26 * side, 1.20),
            0.055,
            coat,
            tag,
        );
        b.rod(
            place,
            v3(0.18, 0.26 * side, 1.20),
            v3(0.28, 0.24 * side, 1.07),
            0.045,
            coat,
            tag,
        );
    }
    b.rod(
        place,
        v3(-0.18, 0.0, 1.05),
        v3(0.02, 0.0, 1.38),
        0.185,
        coat,
        tag,
    );
    b.ellipsoid(place, v3(0.14, 0.0, 1.66), v3(0.10, 0.085, 0.12), face, tag);
    b.ellipsoid(
        place,
        v3(0.12, 0.0, 1.71),
        v3(0.13, 0.10, 0.09),
        helmet,
        tag,
    );
    b.shade(place, 0.5, 0.1);
}
