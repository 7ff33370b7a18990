//! Street furniture: lamps, poles, signs, traffic lights, bins and the like.

use super::builder::{Builder, Placement, skin};
use super::label;
use super::paint::cloth;
use crate::synth::geometry::shapes::{Material, Skin};
use crate::synth::random::Rng;
use crate::synth::vector::v3;

/// A lamp post with an arm over the street (towards local -y).
pub(crate) fn street_lamp(b: &mut Builder, place: Placement, height: f32) {
    let tag = (label::POLE, 0);
    let metal = skin(Material::Metal, [0.22, 0.24, 0.24], 5);
    b.pillar(place, v3(0.0, 0.0, 0.0), 0.08, height, metal, tag);
    b.pillar(place, v3(0.0, 0.0, 0.0), 0.12, 1.1, metal, tag);
    b.rod(
        place,
        v3(0.0, 0.0, height - 0.05),
        v3(0.0, -1.5, height + 0.25),
        0.05,
        metal,
        tag,
    );
    b.block(
        place,
        v3(-0.12, -2.1, height + 0.16),
        v3(0.12, -1.3, height + 0.32),
        skin(Material::Metal, [0.40, 0.40, 0.38], 6),
        tag,
    );
}

/// A wooden pole for wires.
pub(crate) fn wire_pole(b: &mut Builder, place: Placement) {
    let wood = skin(Material::Bark, [0.20, 0.15, 0.11], 9);
    b.pillar(place, v3(0.0, 0.0, 0.0), 0.13, 8.5, wood, (label::POLE, 0));
    b.rod(
        place,
        v3(0.0, -0.9, 7.9),
        v3(0.0, 0.9, 7.9),
        0.06,
        wood,
        (label::POLE, 0),
    );
}

/// A traffic sign that faces traffic coming along +x (it looks towards -x).
pub(crate) fn traffic_sign(b: &mut Builder, place: Placement, rng: &mut Rng) {
    let post = skin(Material::Metal, [0.42, 0.43, 0.44], 3);
    let height = rng.range(2.2, 2.7);
    b.pillar(
        place,
        v3(0.0, 0.0, 0.0),
        0.038,
        height + 0.5,
        post,
        (label::POLE, 0),
    );
    let tag = (label::TRAFFIC_SIGN, 0);
    let kind = rng.below(4) as u32;
    let plate = Skin {
        material: Material::SignPlate,
        paint: [0.78, 0.78, 0.76],
        trim: [
            [0.55, 0.02, 0.02],
            [0.02, 0.10, 0.45],
            [0.70, 0.52, 0.03],
            [0.55, 0.02, 0.02],
        ][kind as usize],
        sizes: [0.0, 0.0, 0.0, 0.0],
        seed: (rng.bits() as u32 & !3) | kind,
    };
    // Discs lie across the heading of a place turned by a quarter.
    let turned = place.offset(v3(-0.07, 0.0, height), 1);
    match kind {
        0 | 1 => b.drum(turned, v3(0.0, 0.0, 0.0), (0.32, 0.0, 0.015), plate, tag),
        2 => b.block(
            turned,
            v3(-0.32, -0.015, -0.32),
            v3(0.32, 0.015, 0.32),
            plate,
            tag,
        ),
        _ => {
            let profile = [(-0.45, -0.30), (0.45, -0.30), (0.0, 0.50)];
            b.hull(turned, &profile, (0.015, 0.0, 0.0), plate, tag);
        }
    }
    if rng.chance(0.4) {
        b.block(
            turned,
            v3(-0.30, -0.015, -0.72),
            v3(0.30, 0.015, -0.40),
            Skin {
                seed: 2,
                trim: [0.05, 0.05, 0.05],
                ..plate
            },
            tag,
        );
    }
}

/// A traffic light that faces traffic coming along +x.
pub(crate) fn signal(b: &mut Builder, place: Placement, phase: u32) {
    let post = skin(Material::Metal, [0.25, 0.27, 0.26], 4);
    b.pillar(place, v3(0.0, 0.0, 0.0), 0.075, 3.6, post, (label::POLE, 0));
    let head = Skin {
        material: Material::SignalHead,
        paint: [0.02, 0.025, 0.022],
        trim: [0.5, 0.5, 0.5],
        sizes: [2.55, 0.30, 0.0, 0.0],
        seed: phase % 3,
    };
    let tag = (label::TRAFFIC_LIGHT, 0);
    b.block(
        place,
        v3(-0.26, -0.17, 2.55),
        v3(-0.06, 0.17, 3.45),
        head,
        tag,
    );
}

/// Small things on the pavement: bollard, bin, cabinet, advertising column.
pub(crate) fn furniture(b: &mut Builder, place: Placement, rng: &mut Rng) {
    let seed = rng.bits() as u32;
    match rng.below(5) {
        0 | 1 => {
            let post = skin(Material::SignBack, [0.55, 0.10, 0.08], seed);
            b.pillar(place, v3(0.0, 0.0, 0.0), 0.06, 0.95, post, (label::POLE, 0));
        }
        2 => {
            let bin = skin(
                Material::Concrete,
                rng.pick(&[[0.05, 0.06, 0.05], [0.30, 0.20, 0.03], [0.03, 0.09, 0.20]]),
                seed,
            );
            b.block(
                place,
                v3(-0.32, -0.28, 0.0),
                v3(0.32, 0.28, 1.1),
                bin,
                (label::STATIC, 0),
            );
        }
        3 => {
            let cabinet = skin(Material::Plaster, [0.36, 0.38, 0.35], seed);
            b.block(
                place,
                v3(-0.55, -0.2, 0.0),
                v3(0.55, 0.2, 1.25),
                cabinet,
                (label::STATIC, 0),
            );
        }
        _ => {
            let column = Skin {
                material: Material::CargoBox,
                paint: [0.62, 0.60, 0.52],
                trim: cloth(rng),
                sizes: [1.2, 2.6, 0.0, 0.0],
                seed,
            };
            b.pillar(
                place,
                v3(0.0, 0.0, 0.0),
                0.6,
                2.7,
                column,
                (label::STATIC, 0),
            );
        }
    }
}
