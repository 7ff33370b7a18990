//! Trees, conifers and bushes.

use super::builder::{Builder, Placement, skin};
use super::label;
use crate::synth::geometry::shapes::{Material, Skin};
use crate::synth::random::Rng;
use crate::synth::vector::{Rgb, dim, v3};

/// Colour of foliage: green, and now and then yellow, brown or red.
pub(crate) fn leaf_colour(rng: &mut Rng) -> Rgb {
    let base: Rgb = rng.pick(&[
        [0.10, 0.17, 0.035],
        [0.08, 0.14, 0.03],
        [0.13, 0.19, 0.04],
        [0.06, 0.12, 0.035],
        [0.17, 0.19, 0.045],
        [0.22, 0.18, 0.04],
        [0.20, 0.11, 0.04],
    ]);
    dim(base, rng.range(0.8, 1.3))
}

/// A broad-leaved tree; `blobs` sets how finely the crown is made.
pub(crate) fn tree(b: &mut Builder, place: Placement, height: f32, blobs: usize, rng: &mut Rng) {
    let tag = (label::VEGETATION, 0);
    let seed = rng.bits() as u32;
    let colour = leaf_colour(rng);
    let bark = skin(
        Material::Bark,
        dim([0.16, 0.12, 0.085], rng.range(0.6, 1.3)),
        seed,
    );
    let spread = height * rng.range(0.20, 0.34);
    let stem = height * rng.range(0.24, 0.40);
    let radius = 0.05 + height * 0.018;
    b.pillar(
        place,
        v3(0.0, 0.0, -0.1),
        radius,
        stem + 0.3 * (height - stem),
        bark,
        tag,
    );
    let crown = 0.5 * (height - stem);
    let middle = stem + crown;
    for i in 0..4.min(blobs) {
        // Boughs from the top of the stem into the crown.
        let a = i as f32 * 1.7 + rng.unit();
        let (s, c) = crate::synth::vector::sin_cos(f64::from(a));
        let to = v3(c as f32 * spread * 0.6, s as f32 * spread * 0.6, middle);
        b.rod(
            place,
            v3(0.0, 0.0, stem * 0.95),
            to,
            radius * 0.45,
            bark,
            tag,
        );
    }
    for i in 0..blobs {
        let turn = f64::from(i as u32) * 2.399_963 + f64::from(rng.range(0.0, 0.8));
        let (s, c) = crate::synth::vector::sin_cos(turn);
        let level = (i as f32 + 0.5) / blobs as f32 * 2.0 - 1.0;
        let ring = (1.0 - level * level * 0.8).sqrt() * spread * rng.range(0.35, 0.75);
        let centre = v3(
            c as f32 * ring,
            s as f32 * ring,
            middle + level * crown * 0.72,
        );
        let size = spread * rng.range(0.50, 0.72) * (1.0 - 0.25 * level.max(0.0));
        let radii = v3(
            size,
            size * rng.range(0.9, 1.1),
            size * rng.range(0.7, 0.95),
        );
        let leaves = Skin {
            material: Material::Leaves,
            paint: dim(colour, rng.range(0.85, 1.15)),
            trim: dim(colour, 0.4),
            sizes: [middle - crown + 0.3, 2.0 * crown, 0.0, 0.0],
            seed: seed.wrapping_add(i as u32 * 7919),
        };
        b.ellipsoid(place, centre, radii, leaves, tag);
    }
}

/// A conifer.
pub(crate) fn conifer(b: &mut Builder, place: Placement, height: f32, tiers: usize, rng: &mut Rng) {
    let tag = (label::VEGETATION, 0);
    let seed = rng.bits() as u32;
    let colour = dim([0.045, 0.085, 0.035], rng.range(0.8, 1.4));
    let bark = skin(Material::Bark, [0.12, 0.08, 0.06], seed);
    b.pillar(
        place,
        v3(0.0, 0.0, -0.1),
        0.06 + height * 0.012,
        height * 0.5,
        bark,
        tag,
    );
    let width = height * rng.range(0.16, 0.22);
    for i in 0..tiers {
        let level = i as f32 / tiers as f32;
        let size = width * (1.05 - level);
        let leaves = Skin {
            material: Material::Leaves,
            paint: colour,
            trim: dim(colour, 0.4),
            sizes: [0.5, height, 0.0, 0.0],
            seed: seed.wrapping_add(i as u32 * 104_729),
        };
        let z = height * (0.16 + 0.80 * level);
        b.ellipsoid(
            place,
            v3(0.0, 0.0, z),
            v3(size, size, height / tiers as f32 * 0.95),
            leaves,
            tag,
        );
    }
}

/// A bush of a few blobs.
pub(crate) fn bush(b: &mut Builder, place: Placement, size: f32, rng: &mut Rng) {
    let colour = leaf_colour(rng);
    for _ in 0..2 + rng.below(2) {
        let leaves = Skin {
            material: Material::Leaves,
            paint: dim(colour, rng.range(0.8, 1.2)),
            trim: dim(colour, 0.4),
            sizes: [0.0, 1.6 * size, 0.0, 0.0],
            seed: rng.bits() as u32,
        };
        let at = v3(
            rng.range(-0.6, 0.6) * size,
            rng.range(-0.4, 0.4) * size,
            0.5 * size,
        );
        let r = size * rng.range(0.55, 0.9);
        b.ellipsoid(place, at, v3(r, r, 0.8 * r), leaves, (label::VEGETATION, 0));
    }
}
