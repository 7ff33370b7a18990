//! Colours and skins that several kinds of objects share.

use crate::synth::geometry::shapes::{Material, Skin};
use crate::synth::random::Rng;
use crate::synth::vector::{Rgb, dim};

pub(crate) const TYRE: Rgb = [0.025, 0.025, 0.027];

/// Colours that cars are sold in.
pub(crate) fn car_paint(rng: &mut Rng) -> Rgb {
    let base: Rgb = rng.pick(&[
        [0.45, 0.46, 0.48],
        [0.50, 0.51, 0.52],
        [0.30, 0.31, 0.33],
        [0.03, 0.03, 0.035],
        [0.04, 0.045, 0.05],
        [0.58, 0.58, 0.57],
        [0.50, 0.50, 0.48],
        [0.03, 0.06, 0.18],
        [0.05, 0.10, 0.24],
        [0.33, 0.02, 0.02],
        [0.42, 0.05, 0.03],
        [0.04, 0.12, 0.07],
        [0.55, 0.42, 0.08],
        [0.24, 0.20, 0.14],
    ]);
    dim(base, rng.range(0.85, 1.15))
}

pub(crate) fn wheel_skin(seed: u32) -> Skin {
    Skin {
        material: Material::Tyre,
        paint: TYRE,
        trim: [0.35, 0.36, 0.38],
        sizes: [0.64, 0.0, 0.0, 0.0],
        seed,
    }
}

pub(crate) fn cloth(rng: &mut Rng) -> Rgb {
    let c: Rgb = rng.pick(&[
        [0.05, 0.06, 0.10],
        [0.03, 0.03, 0.03],
        [0.40, 0.06, 0.05],
        [0.10, 0.20, 0.42],
        [0.55, 0.53, 0.48],
        [0.16, 0.24, 0.12],
        [0.62, 0.45, 0.10],
        [0.22, 0.15, 0.10],
        [0.68, 0.68, 0.70],
        [0.30, 0.12, 0.30],
    ]);
    dim(c, rng.range(0.8, 1.2))
}
