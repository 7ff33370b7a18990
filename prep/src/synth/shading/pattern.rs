//! What all surfaces share: the look of a point, and patterns filtered by the footprint of the pixel.

use crate::synth::scene::Scene;
use crate::synth::vector::{Rgb, fast_max, fast_min, floor_i32, smooth};

/// Texels per metre of the fine and the coarse layer of grain. Their periods
/// (16/3 m and 64 m) divide the 128 m to which scene origins are snapped.
pub(crate) const FINE: f32 = 96.0;

pub(crate) const COARSE: f32 = 8.0;

/// How much a surface mirrors the sky, and its own colour.
pub(crate) struct Look {
    pub albedo: Rgb,
    pub gloss: f32,
    pub glow: f32,
}

pub(crate) fn matt(albedo: Rgb) -> Look {
    Look {
        albedo,
        gloss: 0.0,
        glow: 0.0,
    }
}

/// Share of the interval of width `foot` around `x` that lies between `low` and `high`.
pub(crate) fn band(x: f32, low: f32, high: f32, foot: f32) -> f32 {
    let f = fast_max(foot, 1e-4);
    ((fast_min(x + 0.5 * f, high) - fast_max(x - 0.5 * f, low)) / f).clamp(0.0, 1.0)
}

/// Like [`band`] for a stripe `on` wide that repeats every `period`.
pub(crate) fn stripes(x: f32, period: f32, on: f32, foot: f32) -> f32 {
    let duty = on / period;
    if foot > period {
        return duty;
    }
    let phase = x - period * floor_i32(x / period) as f32;
    let here = band(phase, 0.0, on, foot)
        + band(phase, period, period + on, foot)
        + band(phase, -period, on - period, foot);
    let faded = smooth(0.5 * period, period, foot);
    here.min(1.0) * (1.0 - faded) + duty * faded
}

/// Grain around zero at metres (u, v).
pub(crate) fn grain(scene: &Scene, u: f32, v: f32, texels_per_m: f32, foot: f32) -> f32 {
    scene
        .textures
        .grain
        .at(u * texels_per_m, v * texels_per_m, foot * texels_per_m)
        - 0.5
}
