//! Which shapes can be seen in which part of a picture.

use super::camera::PinholeCamera;
use crate::synth::scene::{Candidate, Scene};
use crate::synth::vector::V3;

/// Side of a square of pixels that share a list of candidates.
const TILE: usize = 8;

/// Nothing is seen nearer than this.
const NEAR_M: f32 = 0.25;

/// Which shapes can be seen in which part of a picture.
pub(crate) struct Tiles {
    columns: usize,
    starts: Vec<u32>,
    /// Candidates with the pixels they can be seen in: columns and rows from, to.
    items: Vec<(Candidate, [u16; 4])>,
}

impl Tiles {
    pub fn new(scene: &Scene, camera: &PinholeCamera) -> Self {
        let columns = camera.width.div_ceil(TILE);
        let rows = camera.height.div_ceil(TILE);
        let mut seen: Vec<(f32, u32, [u16; 4])> = Vec::new();
        for (index, shape) in scene.shapes.iter().enumerate() {
            let corners = shape.corners().map(|c| camera.to_camera(c));
            let Some((low, high, nearest)) = screen_box(camera, &corners) else {
                continue;
            };
            let pixel = |v: f32, count: usize| (v.max(0.0) as usize).min(count - 1) as u16;
            // One pixel of slack for samples off the pixel's middle.
            if high.0 < -1.0
                || high.1 < -1.0
                || low.0 > camera.width as f32
                || low.1 > camera.height as f32
            {
                continue;
            }
            let span = [
                pixel(low.0 - 1.0, camera.width),
                pixel(low.1 - 1.0, camera.height),
                pixel(high.0 + 2.0, camera.width),
                pixel(high.1 + 2.0, camera.height),
            ];
            seen.push((nearest, index as u32, span));
        }
        seen.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let mut starts = vec![0_u32; columns * rows + 1];
        let tiles_of = |span: &[u16; 4]| span.map(|v| usize::from(v) / TILE);
        for (_, _, span) in &seen {
            let [c0, r0, c1, r1] = tiles_of(span);
            for row in r0..=r1 {
                for slot in &mut starts[row * columns + c0 + 1..=row * columns + c1 + 1] {
                    *slot += 1;
                }
            }
        }
        for i in 1..starts.len() {
            starts[i] += starts[i - 1];
        }
        let mut next = starts.clone();
        let nobody = (
            Candidate {
                index: 0,
                nearest: 0.0,
            },
            [0; 4],
        );
        let mut items = vec![nobody; starts[starts.len() - 1] as usize];
        for (nearest, index, span) in &seen {
            let [c0, r0, c1, r1] = tiles_of(span);
            for row in r0..=r1 {
                for slot in &mut next[row * columns + c0..=row * columns + c1] {
                    items[*slot as usize] = (
                        Candidate {
                            index: *index,
                            nearest: *nearest,
                        },
                        *span,
                    );
                    *slot += 1;
                }
            }
        }
        Self {
            columns,
            starts,
            items,
        }
    }

    /// Candidates for a pixel, nearest first.
    pub fn candidates(&self, column: usize, row: usize) -> impl Iterator<Item = Candidate> + '_ {
        let tile = row / TILE * self.columns + column / TILE;
        let (column, row) = (column as u16, row as u16);
        self.items[self.starts[tile] as usize..self.starts[tile + 1] as usize]
            .iter()
            .filter(move |(_, [c0, r0, c1, r1])| {
                column >= *c0 && column <= *c1 && row >= *r0 && row <= *r1
            })
            .map(|(candidate, _)| *candidate)
    }
}

type Corner = (f32, f32);

/// Pixel rectangle of a box and its least depth; `None` if it is behind the camera.
fn screen_box(camera: &PinholeCamera, corners: &[V3; 8]) -> Option<(Corner, Corner, f32)> {
    let nearest = corners.iter().map(|c| c.z).fold(f32::MAX, f32::min);
    let farthest = corners.iter().map(|c| c.z).fold(f32::MIN, f32::max);
    if farthest < NEAR_M {
        return None;
    }
    let (mut low, mut high) = ((f32::MAX, f32::MAX), (f32::MIN, f32::MIN));
    let mut take = |p: V3| {
        let x = p.x / p.z * camera.focal_px + camera.cx - 1.0;
        let y = p.y / p.z * camera.focal_px + camera.cy - 1.0;
        low = (low.0.min(x), low.1.min(y));
        high = (high.0.max(x), high.1.max(y));
    };
    for (i, &corner) in corners.iter().enumerate() {
        if corner.z >= NEAR_M {
            take(corner);
        }
        // Edges that pass through the near plane end on it.
        for bit in [1, 2, 4] {
            let other = corners[i ^ bit];
            if corner.z < NEAR_M && other.z >= NEAR_M {
                let w = (NEAR_M - corner.z) / (other.z - corner.z);
                take(corner + (other - corner) * w);
            }
        }
    }
    Some((low, high, nearest.max(0.0)))
}
