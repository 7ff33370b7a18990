//! The way from a small image to a large one by a stride: interleaved images, each with its own part of
//! the weights.

use rayon::prelude::*;

use super::geometry::Geometry;

/// Rows of rearranged weights, and elements of each, that are written together.
const ROWS: usize = 32;
const ELEMENTS: usize = 256;
/// Elements between those rows, so that they do not all fall into the same places of a cache.
const GAP: usize = 16;

/// One of the interleaved images that a large one consists of, in one direction.
pub(super) struct Phase {
    /// First place of a window that meets it; the others follow by the stride.
    first: usize,
    pub taps: usize,
    /// Small pixel of the first place, counted from the own one.
    pub shift: usize,
}

impl Phase {
    pub fn new(geometry: &Geometry, remainder: usize) -> Self {
        let Geometry {
            kernel,
            stride,
            padding,
            ..
        } = *geometry;
        let first = (remainder + padding) % stride;
        Self {
            first,
            taps: kernel.saturating_sub(first).div_ceil(stride),
            shift: (remainder + padding) / stride,
        }
    }

    /// Places in a window that meet it.
    fn places(&self, stride: usize) -> impl Iterator<Item = usize> {
        (self.first..).step_by(stride).take(self.taps)
    }

    /// Small pixels that belong to these places, counted from `before` pixels before the own one.
    pub fn offsets(&self, before: usize) -> impl Iterator<Item = usize> {
        let last = before + self.shift;
        (0..self.taps).map(move |tap| last - tap)
    }
}

/// All pairs of a vertical and a horizontal phase.
pub(super) fn pairs(phases: &[Phase]) -> impl Iterator<Item = [&Phase; 2]> {
    let pair = |vertical| phases.iter().map(move |horizontal| [vertical, horizontal]);
    phases.iter().flat_map(pair)
}

/// Writes the weights as `[large channels, pair of phases, small channels, its taps]`.
pub(super) fn arrange(geometry: &Geometry, weight: &[f32], phases: &[Phase], arranged: &mut [f32]) {
    let Geometry { kernel, stride, .. } = *geometry;
    let ([large, ..], [small, ..]) = (geometry.large, geometry.small);
    let area = kernel * kernel;
    let together = (ELEMENTS / area).max(1);
    let line = together * area + GAP;
    // Of every place of a window: where it belongs among those of one small channel, and how far
    // the next channel's is.
    let mut places = vec![[0; 2]; area];
    let mut parts = Vec::new();
    let mut before = 0;
    for [vertical, horizontal] in pairs(phases) {
        let taps = vertical.taps * horizontal.taps;
        let rows = vertical.places(stride);
        let pair = rows.flat_map(|y| horizontal.places(stride).map(move |x| y * kernel + x));
        for (tap, place) in pair.enumerate() {
            places[place] = [before * together + tap, taps];
        }
        parts.push((before, taps));
        before += taps;
    }
    let blocks = arranged.par_chunks_mut((ROWS * small * area).max(1));
    blocks.enumerate().for_each(|(block, arranged)| {
        let rows = arranged.len() / (small * area);
        let mut piece = vec![0.0_f32; rows * line];
        let mut targets = vec![0; area];
        for first in (0..small).step_by(together) {
            let count = together.min(small - first);
            for from in 0..count {
                let start = ((first + from) * large + block * ROWS) * area;
                let weights = weight[start..start + rows * area].chunks_exact(area);
                let lines = weights.zip(piece.chunks_exact_mut(line));
                if let [[place, next]] = places[..] {
                    lines.for_each(|(weight, line)| line[place + from * next] = weight[0]);
                    continue;
                }
                for (target, [place, next]) in targets.iter_mut().zip(&places) {
                    *target = place + from * next;
                }
                for (weights, line) in lines {
                    for (&weight, &target) in weights.iter().zip(&targets) {
                        line[target] = weight;
                    }
                }
            }
            let lines = piece.chunks_exact(line);
            for (line, out) in lines.zip(arranged.chunks_exact_mut(small * area)) {
                for &(before, taps) in &parts {
                    let out = &mut out[before * small + first * taps..][..count * taps];
                    out.copy_from_slice(&line[before * together..][..count * taps]);
                }
            }
        }
    });
}

/// Writes consecutive values of one of the interleaved images, from its `first` on, where rows of it
/// have `columns`, into rows of `width`.
#[inline(always)]
pub(super) fn interleave(
    out: &mut [f32],
    values: &[f32],
    first: usize,
    columns: usize,
    width: usize,
    [stride, ry, rx]: [usize; 3],
) {
    let mut done = 0;
    while done < values.len() {
        let (row, column) = ((first + done) / columns, (first + done) % columns);
        let length = (columns - column).min(values.len() - done);
        let start = (row * stride + ry) * width + column * stride + rx;
        let end = ((row * stride + ry + 1) * width).min(out.len());
        // An odd height or width has fewer pixels of the last phases.
        if start < end {
            let pixels = out[start..end].iter_mut().step_by(stride);
            for (out, value) in pixels.zip(&values[done..done + length]) {
                *out = *value;
            }
        }
        done += length;
    }
}
