//! Houses and halls.

use super::builder::{Builder, Placement, skin};
use super::label;
use crate::synth::geometry::shapes::{Material, Skin};
use crate::synth::random::Rng;
use crate::synth::vector::{Rgb, V3, blend, dim, v3};

/// What a building looks like.
#[derive(Clone, Copy, Debug)]
pub(crate) struct House {
    /// Along the street.
    pub width: f32,
    /// Away from the street.
    pub depth: f32,
    pub storeys: u32,
    pub gabled: bool,
    pub shop: bool,
}

fn wall_colour(rng: &mut Rng) -> Rgb {
    let c: Rgb = rng.pick(&[
        [0.62, 0.55, 0.40],
        [0.66, 0.62, 0.54],
        [0.58, 0.57, 0.54],
        [0.50, 0.36, 0.24],
        [0.42, 0.20, 0.13],
        [0.34, 0.16, 0.12],
        [0.60, 0.46, 0.26],
        [0.40, 0.44, 0.46],
        [0.70, 0.68, 0.64],
        [0.48, 0.50, 0.38],
        [0.55, 0.40, 0.34],
    ]);
    dim(c, rng.range(0.75, 1.1))
}

fn roof_colour(rng: &mut Rng) -> Rgb {
    let c: Rgb = rng.pick(&[
        [0.30, 0.11, 0.06],
        [0.24, 0.09, 0.06],
        [0.12, 0.08, 0.07],
        [0.10, 0.10, 0.11],
    ]);
    dim(c, rng.range(0.8, 1.2))
}

/// A house whose front (local -y side faces the street when `place` is turned so)
/// stands along x; both upright face pairs carry windows.
pub(crate) fn house(b: &mut Builder, place: Placement, house: House, rng: &mut Rng) {
    let tag = (label::BUILDING, 0);
    let seed = rng.bits() as u32;
    let storey = rng.range(2.8, 3.4);
    let height = house.storeys as f32 * storey + rng.range(0.3, 0.8);
    let paint = wall_colour(rng);
    let bay = rng.range(1.9, 3.1);
    let facade = Skin {
        material: Material::Facade,
        paint,
        trim: if rng.chance(0.6) {
            [0.72, 0.71, 0.68]
        } else {
            dim(paint, 0.45)
        },
        sizes: [
            bay,
            storey,
            bay * rng.range(0.38, 0.6),
            storey * rng.range(0.42, 0.6),
        ],
        seed: (seed & !7) | u32::from(house.shop) | (u32::from(rng.chance(0.35)) << 1),
    };
    let (hw, hd) = (house.width / 2.0, house.depth / 2.0);
    b.block(place, v3(-hw, -hd, -0.5), v3(hw, hd, height), facade, tag);
    // Plinth and cornice stand out a little: small steps in depth along the front.
    let plinth = skin(
        Material::Stone,
        dim(blend(paint, [0.3, 0.3, 0.3], 0.6), 0.7),
        seed,
    );
    let tall = rng.range(0.4, 0.9);
    b.block(
        place,
        v3(-hw - 0.06, -hd - 0.06, -0.5),
        v3(hw + 0.06, hd + 0.06, tall),
        plinth,
        tag,
    );
    let cornice = skin(Material::Plaster, facade.trim, seed);
    b.block(
        place,
        v3(-hw - 0.2, -hd - 0.3, height - 0.25),
        v3(hw + 0.2, hd + 0.3, height),
        cornice,
        tag,
    );
    let roof = skin(Material::RoofTiles, roof_colour(rng), seed);
    if house.gabled {
        let rise = rng.range(0.6, 0.95) * hd;
        let (half, profile) = (
            hw + 0.2,
            [
                (-hd - 0.45, height - 0.05),
                (hd + 0.45, height - 0.05),
                (0.0, height + rise),
            ],
        );
        // The ridge runs along the street: the profile lies across it.
        b.hull(
            place.offset(v3(0.0, 0.0, 0.0), 1),
            &profile,
            (half, height, 0.0),
            roof,
            tag,
        );
        if rng.chance(0.7) {
            let x = rng.range(-0.6, 0.6) * hw;
            let y = rng.range(-0.3, 0.3) * hd;
            let brick = skin(Material::Brick, [0.30, 0.13, 0.09], seed);
            b.block(
                place,
                v3(x - 0.35, y - 0.3, height),
                v3(x + 0.35, y + 0.3, height + rise + 0.8),
                brick,
                tag,
            );
        }
        let dormers = rng.below(3);
        for i in 0..dormers {
            let x = ((i as f32 + 1.0) / (dormers as f32 + 1.0) * 2.0 - 1.0) * hw;
            for side in [1.0_f32, -1.0] {
                let y0 = side * hd * 0.72;
                let y1 = side * hd * 0.1;
                let window = Skin {
                    sizes: [1.5, 1.5, 0.9, 0.9],
                    seed: seed & !7,
                    ..facade
                };
                b.block(
                    place,
                    v3(x - 0.75, y0.min(y1), height),
                    v3(x + 0.75, y0.max(y1), height + rise * 0.28 + 1.3),
                    window,
                    tag,
                );
            }
        }
    } else {
        let parapet = skin(Material::Concrete, [0.40, 0.39, 0.37], seed);
        b.block(
            place,
            v3(-hw - 0.1, -hd - 0.1, height),
            v3(hw + 0.1, hd + 0.1, height + 0.5),
            parapet,
            tag,
        );
        if rng.chance(0.5) {
            b.block(
                place,
                v3(-1.8, -1.5, height),
                v3(1.6, 1.7, height + 2.6),
                parapet,
                tag,
            );
        }
    }
    if house.storeys >= 2 && rng.chance(0.4) {
        // Balconies on some bays of the street front.
        let bays = (house.width / bay) as usize;
        let every = 2 + rng.below(2);
        let slab = skin(Material::Concrete, [0.45, 0.44, 0.42], seed);
        let rail = skin(Material::Metal, dim(facade.trim, 0.6), seed);
        for i in (0..bays).step_by(every).take(5) {
            let x = ((i as f32 + 0.5) / bays as f32 * 2.0 - 1.0) * hw;
            for level in 1..house.storeys.min(5) {
                let z = level as f32 * storey - 0.1;
                b.block(
                    place,
                    v3(x - 1.0, -hd - 1.0, z),
                    v3(x + 1.0, -hd, z + 0.15),
                    slab,
                    tag,
                );
                b.block(
                    place,
                    v3(x - 1.0, -hd - 1.0, z + 0.15),
                    v3(x + 1.0, -hd - 0.93, z + 1.05),
                    rail,
                    tag,
                );
            }
        }
    }
}

/// A hall with few openings.
pub(crate) fn hall(b: &mut Builder, place: Placement, size: V3, rng: &mut Rng) {
    let tag = (label::BUILDING, 0);
    let seed = rng.bits() as u32;
    let paint = rng.pick(&[
        [0.52, 0.53, 0.54],
        [0.30, 0.38, 0.46],
        [0.55, 0.50, 0.42],
        [0.36, 0.17, 0.12],
    ]);
    let facade = Skin {
        material: Material::Facade,
        paint,
        trim: dim(paint, 0.5),
        sizes: [5.0, size.z * 0.5, 3.2, 1.2],
        seed: seed & !7,
    };
    let (hx, hy) = (size.x / 2.0, size.y / 2.0);
    b.block(place, v3(-hx, -hy, -0.5), v3(hx, hy, size.z), facade, tag);
    let edge = skin(Material::Metal, dim(paint, 0.6), seed);
    b.block(
        place,
        v3(-hx - 0.1, -hy - 0.1, size.z),
        v3(hx + 0.1, hy + 0.1, size.z + 0.6),
        edge,
        tag,
    );
}
