//! What divides a plot from the street: hedges, walls, fences.

use super::frame::{Frame, Lot};
use crate::synth::geometry::shapes::{Material, Skin};
use crate::synth::objects::builder::{Builder, skin};
use crate::synth::objects::label;
use crate::synth::random::Rng;
use crate::synth::vector::{dim, v3};

/// Hedge, wall or fence along the street from one x to another.
pub(crate) fn boundary(
    b: &mut Builder,
    frame: &Frame,
    lot: &Lot,
    (from, to): (f64, f64),
    l: f32,
    rng: &mut Rng,
) {
    let sign = lot.side.sign();
    let kind = rng.below(6);
    let height = rng.range(0.7, 1.7);
    let seed = rng.bits() as u32;
    let colour = rng.pick(&[
        [0.08, 0.14, 0.03],
        [0.10, 0.16, 0.04],
        [0.06, 0.10, 0.03],
        [0.15, 0.16, 0.05],
    ]);
    // Short pieces follow the bends.
    let pieces = ((to - from) / 8.0).ceil().max(1.0);
    let step = (to - from) / pieces;
    for i in 0..pieces as i32 {
        let middle = from + (f64::from(i) + 0.5) * step;
        if !frame.visible(middle) {
            continue;
        }
        let half = (step / 2.0) as f32 * 1.02;
        let place = frame.place(middle, sign * l, frame.kerb());
        match kind {
            0 | 1 => {
                let hedge = Skin {
                    trim: dim(colour, 0.4),
                    ..skin(Material::Hedge, colour, seed)
                };
                b.block(
                    place,
                    v3(-half, -0.35, 0.0),
                    v3(half, 0.35, height),
                    hedge,
                    (label::VEGETATION, 0),
                );
            }
            2 => {
                let wall = skin(Material::Brick, [0.36, 0.17, 0.12], seed);
                b.block(
                    place,
                    v3(-half, -0.12, 0.0),
                    v3(half, 0.12, height),
                    wall,
                    (label::WALL, 0),
                );
            }
            3 => {
                let wall = skin(Material::Stone, [0.42, 0.39, 0.34], seed);
                b.block(
                    place,
                    v3(-half, -0.15, 0.0),
                    v3(half, 0.15, height * 0.8),
                    wall,
                    (label::WALL, 0),
                );
            }
            4 => {
                let fence = Skin {
                    sizes: [0.17, 0.10, 0.0, 0.0],
                    ..skin(Material::Pickets, [0.38, 0.26, 0.16], seed)
                };
                b.block(
                    place,
                    v3(-half, -0.03, 0.0),
                    v3(half, 0.03, height),
                    fence,
                    (label::FENCE, 0),
                );
            }
            _ => {
                let fence = skin(Material::Wood, [0.26, 0.17, 0.10], seed);
                b.block(
                    place,
                    v3(-half, -0.04, 0.0),
                    v3(half, 0.04, height),
                    fence,
                    (label::FENCE, 0),
                );
            }
        }
    }
}
