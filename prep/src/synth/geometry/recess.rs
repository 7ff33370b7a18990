//! The windows of house fronts: a grid of openings whose panes lie behind the wall.

use super::shapes::{Entry, Shape};
use crate::synth::random::hash01;
use crate::synth::vector::{V3, floor_i32, v3};

/// Where on a house front a ray ended: windows lie behind the wall.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Recess {
    Wall,
    Pane,
    Reveal,
}

/// A window of a house front: the half-open cell that a point of the wall lies in.
pub(crate) struct Cell {
    /// Position relative to the window's middle and sill, metres.
    pub du: f32,
    pub dv: f32,
    pub half_width: f32,
    pub height: f32,
    pub column: i32,
    pub row: i32,
}

/// The cell of the window grid at a point of an upright face, if it has a window.
pub(crate) fn window_cell(shape: &Shape, local: V3, normal: V3) -> Option<Cell> {
    let [bay, storey, width, height] = shape.skin.sizes;
    let (u, low, high) = if normal.x != 0.0 {
        (local.y, shape.low.y, shape.high.y)
    } else {
        (local.x, shape.low.x, shape.high.x)
    };
    let length = high - low;
    let count = floor_i32(length / bay).max(1);
    let pitch = length / count as f32;
    let base = shape.low.z.max(0.0);
    let (fu, fv) = ((u - low) / pitch, (local.z - base) / storey);
    let (column, row) = (floor_i32(fu).clamp(0, count - 1), floor_i32(fv));
    if row < 0 || base + (row as f32 + 0.95) * storey > shape.high.z {
        return None;
    }
    let shop = shape.skin.seed & 1 == 1 && row == 0 && normal.y != 0.0;
    let (half_width, height, sill) = if shop {
        (0.42 * pitch, 0.68 * storey, 0.14 * storey)
    } else {
        (0.5 * width, height, 0.62 * (storey - height))
    };
    // Some bays of the sides are blind.
    if normal.x != 0.0 && hash01(shape.skin.seed, column, row + 71) < 0.45 {
        return None;
    }
    Some(Cell {
        du: (fu - column as f32 - 0.5) * pitch,
        dv: (fv - row as f32) * storey - sill,
        half_width,
        height,
        column,
        row,
    })
}

pub(crate) const WINDOW_DEPTH_M: f32 = 0.16;

/// Follows a ray that meets a house front into a window: to the pane or the reveal.
pub(crate) fn enter_window(shape: &Shape, o: V3, d: V3, entry: Entry) -> (f32, V3, Recess) {
    let wall = (entry.t, entry.normal, Recess::Wall);
    let p = o + d * entry.t;
    let Some(cell) = window_cell(shape, p, entry.normal) else {
        return wall;
    };
    if cell.du.abs() >= cell.half_width || cell.dv <= 0.0 || cell.dv >= cell.height {
        return wall;
    }
    let sideways = if entry.normal.x != 0.0 { d.y } else { d.x };
    let inward = -d.dot(entry.normal);
    if inward < 1e-6 {
        return wall;
    }
    let to_pane = WINDOW_DEPTH_M / inward;
    let side_gap = if sideways > 0.0 {
        cell.half_width - cell.du
    } else {
        cell.half_width + cell.du
    };
    let rise_gap = if d.z > 0.0 {
        cell.height - cell.dv
    } else {
        cell.dv
    };
    let to_side = side_gap / sideways.abs().max(1e-9);
    let to_edge = rise_gap / d.z.abs().max(1e-9);
    if to_pane <= to_side && to_pane <= to_edge {
        return (entry.t + to_pane, entry.normal, Recess::Pane);
    }
    let normal = if to_side < to_edge {
        if entry.normal.x != 0.0 {
            v3(0.0, -d.y.signum(), 0.0)
        } else {
            v3(-d.x.signum(), 0.0, 0.0)
        }
    } else {
        v3(0.0, 0.0, -d.z.signum())
    };
    (entry.t + to_side.min(to_edge), normal, Recess::Reveal)
}
