//! Texture: two tiles of noise, each with a pyramid of averaged copies.
//!
//! A look-up states how large a patch of the surface the pixel covers and gets
//! noise averaged over about that patch. Detail finer than a pixel is thereby
//! faded out and both cameras see the same surface the same way.

use crate::synth::random::{key, mix};
use crate::synth::vector::{fast_max, fast_min, lerp};

/// Texels along one side of a tile.
const SIZE: usize = 512;

/// A square, periodic tile of noise with its pyramid.
pub(crate) struct Tile {
    levels: Vec<Vec<u8>>,
}

/// Both tiles.
pub(crate) struct Textures {
    /// Equal contrast in every octave: grain of asphalt, plaster, cloth, grass.
    pub grain: Tile,
    /// Rounded cells with gaps, uniformly distributed values: leaves, gravel.
    pub leaves: Tile,
}

impl Textures {
    /// Makes both tiles (a fraction of a second; made once per run).
    pub fn new() -> Self {
        Self {
            grain: Tile::from_values(&grain()),
            leaves: Tile::from_values(&leaves()),
        }
    }
}

impl Tile {
    fn from_values(values: &[f32]) -> Self {
        let base: Vec<u8> = values
            .iter()
            .map(|v| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8)
            .collect();
        let mut levels = vec![base];
        let mut size = SIZE;
        while size > 1 {
            let above = &levels[levels.len() - 1];
            let half = size / 2;
            let mut next = vec![0_u8; half * half];
            for row in 0..half {
                for col in 0..half {
                    let at =
                        |r: usize, c: usize| u32::from(above[(2 * row + r) * size + 2 * col + c]);
                    next[row * half + col] =
                        ((at(0, 0) + at(0, 1) + at(1, 0) + at(1, 1) + 2) / 4) as u8;
                }
            }
            levels.push(next);
            size = half;
        }
        Self { levels }
    }

    /// Value in 0..1 at texel coordinates (u, v), averaged over about `width` texels.
    pub fn at(&self, u: f32, v: f32, width: f32) -> f32 {
        if width <= 1.0 {
            return self.bilinear(0, u, v);
        }
        // log2 from the exponent and a straight line through the mantissa.
        let bits = width.to_bits();
        let level = (bits >> 23) as f32 - 127.0 + (bits & 0x007F_FFFF) as f32 / 8_388_608.0;
        let coarsest = self.levels.len() - 1;
        if level >= coarsest as f32 {
            return f32::from(self.levels[coarsest][0]) / 255.0;
        }
        let low = level as usize;
        // Blending over the middle half of a level alone saves half of the look-ups.
        let share = (2.0 * (level - low as f32) - 0.5).clamp(0.0, 1.0);
        if share == 0.0 {
            return self.bilinear(low, u, v);
        }
        let rough = self.bilinear(low + 1, u, v);
        if share == 1.0 {
            rough
        } else {
            lerp(self.bilinear(low, u, v), rough, share)
        }
    }

    /// In whole numbers throughout: positions to 1/256 of a texel.
    fn bilinear(&self, level: usize, u: f32, v: f32) -> f32 {
        let texels = self.levels[level].as_slice();
        let shift = 9 - level as u32;
        let mask = (1_i32 << shift) - 1;
        let scale = 256.0 / (1_u32 << level) as f32;
        let (x, y) = ((u * scale - 128.0) as i32, (v * scale - 128.0) as i32);
        let (fx, fy) = ((x & 255) as u32, (y & 255) as u32);
        let (x, y) = (x >> 8, y >> 8);
        let left = (x & mask) as usize;
        let right = (x.wrapping_add(1) & mask) as usize;
        let top = ((y & mask) as usize) << shift;
        let bottom = ((y.wrapping_add(1) & mask) as usize) << shift;
        let mix = |a: u32, b: u32, f: u32| {
            a.wrapping_mul(256_u32.wrapping_sub(f))
                .wrapping_add(b.wrapping_mul(f))
        };
        let at = |i: usize| u32::from(texels[i]);
        let a = mix(at(top | left), at(top | right), fx);
        let b = mix(at(bottom | left), at(bottom | right), fx);
        mix(a, b, fy) as f32 * (1.0 / (255.0 * 65_536.0))
    }
}

/// Hash of a lattice point to 0..1.
fn lattice(seed: u64, x: usize, y: usize) -> f32 {
    (mix(seed ^ ((x as u64) << 20) ^ y as u64) >> 40) as f32 / 16_777_216.0
}

/// Octaves of smoothly interpolated lattice noise, all of the same strength.
fn octaves(seed: u64, from: usize, to: usize) -> Vec<f32> {
    let mut sum = vec![0.0_f32; SIZE * SIZE];
    let mut cell = from;
    while cell <= to {
        let cells = SIZE / cell;
        let octave = key(&[seed, cell as u64]);
        let values: Vec<f32> = (0..cells * cells)
            .map(|i| lattice(octave, i % cells, i / cells))
            .collect();
        for row in 0..SIZE {
            let (r0, fr) = (row / cell, (row % cell) as f32 / cell as f32);
            let r1 = (r0 + 1) % cells;
            let wr = fr * fr * (3.0 - 2.0 * fr);
            for col in 0..SIZE {
                let (c0, fc) = (col / cell, (col % cell) as f32 / cell as f32);
                let c1 = (c0 + 1) % cells;
                let wc = fc * fc * (3.0 - 2.0 * fc);
                let a = lerp(values[r0 * cells + c0], values[r0 * cells + c1], wc);
                let b = lerp(values[r1 * cells + c0], values[r1 * cells + c1], wc);
                sum[row * SIZE + col] += lerp(a, b, wr) - 0.5;
            }
        }
        cell *= 2;
    }
    sum
}

fn grain() -> Vec<f32> {
    let sum = octaves(11, 1, 128);
    let power = sum.iter().map(|v| v * v).sum::<f32>() / sum.len() as f32;
    let scale = 0.2 / power.sqrt();
    sum.iter().map(|v| 0.5 + v * scale).collect()
}

/// Distance to the nearest jittered cell centre, roughened, then spread so that
/// the share of values below q is q.
fn leaves() -> Vec<f32> {
    const CELL: usize = 8;
    let cells = SIZE / CELL;
    let rough = octaves(23, 16, 128);
    let centres: Vec<(f32, f32)> = (0..cells * cells)
        .map(|i| {
            let (cx, cy) = (i % cells, i / cells);
            (
                lattice(31, cx, cy) * CELL as f32,
                lattice(37, cx, cy) * CELL as f32,
            )
        })
        .collect();
    let mut values = vec![0.0_f32; SIZE * SIZE];
    for row in 0..SIZE {
        for col in 0..SIZE {
            let (x, y) = ((col % CELL) as f32, (row % CELL) as f32);
            let mut best = f32::MAX;
            for (dy, oy) in [(cells - 1, -1.0_f32), (0, 0.0), (1, 1.0)] {
                let line = (row / CELL + dy) % cells * cells;
                for (dx, ox) in [(cells - 1, -1.0_f32), (0, 0.0), (1, 1.0)] {
                    let (jx, jy) = centres[line + (col / CELL + dx) % cells];
                    let (u, v) = (ox * CELL as f32 + jx - x, oy * CELL as f32 + jy - y);
                    best = fast_min(best, u * u + v * v);
                }
            }
            let at = row * SIZE + col;
            values[at] = -best.sqrt() / CELL as f32 + 0.9 * rough[at];
        }
    }
    equalised(&values)
}

/// Replaces each value by the share of values below it, to 1/65536 of their range.
fn equalised(values: &[f32]) -> Vec<f32> {
    const BINS: usize = 1 << 16;
    let low = values.iter().copied().fold(f32::MAX, fast_min);
    let high = values.iter().copied().fold(f32::MIN, fast_max);
    let bin = |v: f32| (((v - low) / (high - low) * BINS as f32) as usize).min(BINS - 1);
    let mut below = vec![0_u32; BINS + 1];
    for &v in values {
        below[bin(v) + 1] += 1;
    }
    for i in 0..BINS {
        below[i + 1] += below[i];
    }
    values
        .iter()
        .map(|&v| below[bin(v)] as f32 / values.len() as f32)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wide_patches_average_out_and_narrow_ones_do_not() {
        let textures = Textures::new();
        for tile in [&textures.grain, &textures.leaves] {
            let spread = |width: f32| {
                let v: Vec<f32> = (0..2000)
                    .map(|i| tile.at(i as f32 * 3.7, i as f32 * 11.3, width))
                    .collect();
                let m = v.iter().sum::<f32>() / 2000.0;
                (
                    m,
                    (v.iter().map(|x| (x - m) * (x - m)).sum::<f32>() / 2000.0).sqrt(),
                )
            };
            let (mean, fine) = spread(1.0);
            let (_, wide) = spread(64.0);
            assert!((mean - 0.5).abs() < 0.05, "{mean}");
            assert!(fine > 0.12 && wide < 0.6 * fine, "{fine} {wide}");
            // Periodic without a seam.
            assert_eq!(tile.at(5.0, 9.0, 1.0), tile.at(517.0, 9.0 - 512.0, 1.0));
        }
    }
}
