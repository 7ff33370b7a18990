//! Walls of brick, and house fronts with their windows.

use super::pattern::{FINE, Look, band, grain, matt, stripes};
use crate::synth::geometry::recess::{Recess, window_cell};
use crate::synth::geometry::shapes::{Shape, planar};
use crate::synth::random::hash01;
use crate::synth::scene::Scene;
use crate::synth::vector::{Rgb, V3, blend, dim, floor_i32, smooth};

pub(crate) fn brick(paint: Rgb, u: f32, v: f32, foot: f32, fine: f32, coarse: f32) -> Look {
    let row = floor_i32(v / 0.085);
    let shifted = u + 0.125 * (row & 1) as f32;
    let joint = stripes(v, 0.085, 0.014, foot).max(stripes(shifted, 0.25, 0.014, foot));
    let stone =
        (hash01(17, floor_i32(shifted / 0.25), row) - 0.5) * (1.0 - smooth(0.05, 0.16, foot));
    let body = dim(
        paint,
        (1.0 + 0.7 * fine + 1.0 * coarse + 0.7 * stone).max(0.2),
    );
    matt(blend(body, [0.40, 0.38, 0.35], 0.7 * joint))
}

pub(crate) fn facade(
    scene: &Scene,
    shape: &Shape,
    local: V3,
    own: V3,
    foot: f32,
    recess: Recess,
    noise: (f32, f32),
) -> Look {
    let skin = &shape.skin;
    let (fine, coarse) = noise;
    let (u, v) = planar(local, own);
    let bricks = skin.seed & 2 != 0;
    let wall = if bricks {
        brick(skin.paint, u, v, foot, fine, coarse).albedo
    } else {
        dim(skin.paint, (1.0 + 0.5 * fine + 0.8 * coarse).max(0.2))
    };
    if own.z != 0.0 && recess == Recess::Wall {
        return matt(dim([0.22, 0.21, 0.20], 1.0 + 0.8 * fine + coarse));
    }
    if recess == Recess::Reveal {
        return matt(dim(skin.trim, 0.85 + 0.3 * fine));
    }
    let Some(cell) = window_cell(shape, local, own) else {
        return matt(wall);
    };
    let seed = skin.seed ^ 0x55;
    let state = hash01(seed, cell.column, cell.row);
    if recess == Recess::Wall {
        // A frame of the second colour around the opening, a band between storeys.
        let outer = band(
            cell.du,
            -cell.half_width - 0.13,
            cell.half_width + 0.13,
            foot,
        ) * band(cell.dv, -0.16, cell.height + 0.13, foot);
        let belt = band(cell.dv, -0.55 - 0.12, -0.55, foot) * 0.6;
        return matt(blend(
            wall,
            dim(skin.trim, 1.0 + 0.5 * fine + 0.4 * coarse),
            outer.max(belt),
        ));
    }
    // The pane: sash bars, then shutter, curtain or dark room behind glass.
    let bar = 1.0
        - band(cell.du.abs(), 0.035, cell.half_width - 0.07, foot)
            * band(cell.dv, 0.07, cell.height - 0.07, foot);
    let cross = band(cell.dv, 0.66 * cell.height, 0.66 * cell.height + 0.05, foot);
    let sash = bar.max(cross);
    let down = cell.dv / cell.height;
    let (inside, gloss) = if state < 0.16 {
        // Roller shutter, partly or wholly down.
        let slats = stripes(cell.dv, 0.06, 0.02, foot);
        (dim([0.50, 0.48, 0.43], 1.0 - 0.35 * slats), 0.02)
    } else if state < 0.55 {
        let folds = grain(
            scene,
            cell.du * 1.5 + state * 9.0,
            cell.dv * 0.1,
            FINE,
            foot,
        );
        let drawn = if down > 0.3 || state < 0.35 {
            1.0
        } else {
            0.25
        };
        (
            dim([0.36, 0.35, 0.33], drawn * (0.7 + 0.9 * folds).max(0.1)),
            0.18,
        )
    } else {
        let things = grain(
            scene,
            cell.du * 0.7 + state * 31.0,
            cell.dv * 0.7,
            FINE,
            foot,
        );
        (
            dim([0.055, 0.06, 0.07], (1.0 + 2.4 * things).max(0.2)),
            0.28,
        )
    };
    let frame: Rgb = if skin.seed & 4 != 0 {
        [0.66, 0.65, 0.62]
    } else {
        [0.20, 0.14, 0.09]
    };
    Look {
        albedo: blend(inside, dim(frame, 1.0 + 0.4 * fine), sash),
        gloss: gloss * (1.0 - sash),
        glow: 0.0,
    }
}
