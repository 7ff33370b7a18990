//! Images as matrices: every column a position, every row what the windows of all positions have at one
//! place (an unfolded image that is never written down).

use std::ops::Range;

use super::super::product::{InPlace, Left, Right};
use super::images::Images;

/// Rows of an image that one piece of work looks at: of one sample, or all of several.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Rows {
    /// First sample and number of samples.
    pub sample: usize,
    pub samples: usize,
    /// First row and number of rows, in each of the samples.
    pub first: usize,
    pub count: usize,
}

impl Rows {
    /// All rows of `samples` images of `rows` by `columns`, in pieces of about `positions`.
    pub fn divide(samples: usize, [rows, columns]: [usize; 2], positions: usize) -> Vec<Self> {
        let plane = (rows * columns).max(1);
        if plane >= positions {
            let count = (positions / columns.max(1)).clamp(1, rows.max(1));
            let of_sample = move |sample| {
                (0..rows).step_by(count).map(move |first| Self {
                    sample,
                    samples: 1,
                    first,
                    count: count.min(rows - first),
                })
            };
            return (0..samples).flat_map(of_sample).collect();
        }
        let together = positions / plane;
        (0..samples)
            .step_by(together)
            .map(|sample| Self {
                sample,
                samples: together.min(samples - sample),
                first: 0,
                count: rows,
            })
            .collect()
    }

    /// Positions, where a row has `columns`.
    pub fn positions(&self, columns: usize) -> usize {
        self.samples * self.count * columns
    }
}

/// Places of an image as a matrix: the element of row `r` and column `c` is
/// `values[taps[r] + lines[c / width] + c % width]`.
pub(super) struct Windows<'a> {
    values: &'a [f32],
    taps: Vec<usize>,
    lines: Vec<usize>,
    width: usize,
    /// Rows of an image of a power of two fall into the same places of a cache; those of a block do not.
    in_block: bool,
}

impl<'a> Windows<'a> {
    /// The image itself: a row for every channel of `[n, c, rows, columns]`.
    pub fn planes(
        values: &'a [f32],
        [channels, height, width]: [usize; 3],
        rows: Rows,
        of: Range<usize>,
    ) -> Self {
        let plane = height * width;
        let samples = rows.sample..rows.sample + rows.samples;
        Self {
            values,
            taps: of.map(|channel| channel * plane).collect(),
            lines: samples
                .map(|sample| sample * channels * plane + rows.first * width)
                .collect(),
            width: rows.count * width,
            in_block: false,
        }
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.taps.len()
    }

    /// What consecutive columns are: their places among those asked for, and the start in a line.
    #[inline(always)]
    fn pieces(&self, columns: Range<usize>) -> impl Iterator<Item = (Range<usize>, usize)> {
        let (mut line, mut offset) = (columns.start / self.width, columns.start % self.width);
        let mut place = 0;
        std::iter::from_fn(move || {
            if place == columns.len() {
                return None;
            }
            let length = (self.width - offset).min(columns.len() - place);
            let piece = (place..place + length, self.lines[line] + offset);
            place += length;
            offset = 0;
            line += 1;
            Some(piece)
        })
    }
}

impl Left for Windows<'_> {
    #[inline(always)]
    fn read(&self, row: usize, columns: Range<usize>, out: &mut [f32]) {
        let values = &self.values[self.taps[row]..];
        for (place, start) in self.pieces(columns) {
            let length = place.len();
            out[place].copy_from_slice(&values[start..start + length]);
        }
    }
}

impl Right for Windows<'_> {
    #[inline(always)]
    fn read_panel(&self, rows: Range<usize>, columns: Range<usize>, width: usize, out: &mut [f32]) {
        let count = columns.len();
        let taps = &self.taps[rows];
        for (place, start) in self.pieces(columns) {
            match (place.len(), width) {
                (32, 32) => copy_whole::<32>(self.values, taps, start, out),
                (16, 16) => copy_whole::<16>(self.values, taps, start, out),
                (8, 8) => copy_whole::<8>(self.values, taps, start, out),
                (16, _) => copy_part::<16>(self.values, taps, start, place, width, out),
                (8, _) => copy_part::<8>(self.values, taps, start, place, width, out),
                (length, _) => {
                    for (tap, out) in taps.iter().zip(out.chunks_exact_mut(width)) {
                        let from = tap + start;
                        out[place.clone()].copy_from_slice(&self.values[from..from + length]);
                    }
                }
            }
        }
        if count < width {
            for out in out.chunks_exact_mut(width) {
                out[count..].fill(0.0);
            }
        }
    }

    #[inline(always)]
    fn in_place(&self, columns: Range<usize>) -> Option<InPlace<'_>> {
        let (line, first) = (columns.start / self.width, columns.start % self.width);
        (self.in_block && first + columns.len() <= self.width).then(|| InPlace {
            values: self.values,
            starts: &self.taps,
            offset: self.lines[line] + first,
        })
    }
}

/// Windows with rows and columns exchanged.
pub(super) struct Turned<'a>(pub &'a Windows<'a>);

impl Right for Turned<'_> {
    #[inline(always)]
    fn read_panel(&self, rows: Range<usize>, columns: Range<usize>, width: usize, out: &mut [f32]) {
        /// Rows that are turned at a time: what the first-level cache holds.
        const TOGETHER: usize = 64;
        let taps = &self.0.taps[columns];
        let firsts = rows.clone().step_by(TOGETHER);
        for (first, out) in firsts.zip(out.chunks_mut(TOGETHER * width)) {
            let rows = first..(first + TOGETHER).min(rows.end);
            for (place, start) in self.0.pieces(rows) {
                let out = &mut out[place.start * width..place.end * width];
                for (column, tap) in taps.iter().enumerate() {
                    let from = tap + start;
                    let values = &self.0.values[from..from + place.len()];
                    for (out, &value) in out.chunks_exact_mut(width).zip(values) {
                        out[column] = value;
                    }
                }
            }
            for out in out.chunks_exact_mut(width) {
                out[taps.len()..].fill(0.0);
            }
        }
    }
}

/// Copies `N` elements for every tap: of a known length, because a call costs as much as the copy.
#[inline(always)]
fn copy_whole<const N: usize>(values: &[f32], taps: &[usize], start: usize, out: &mut [f32]) {
    let (out, _) = out.as_chunks_mut::<N>();
    for (tap, out) in taps.iter().zip(out) {
        *out = *piece(values, tap + start);
    }
}

/// The same into a part of every panel row.
#[inline(always)]
fn copy_part<const N: usize>(
    values: &[f32],
    taps: &[usize],
    start: usize,
    place: Range<usize>,
    width: usize,
    out: &mut [f32],
) {
    for (tap, out) in taps.iter().zip(out.chunks_exact_mut(width)) {
        out[place.start..place.start + N].copy_from_slice(piece::<N>(values, tap + start));
    }
}

#[inline(always)]
fn piece<const N: usize>(values: &[f32], start: usize) -> &[f32; N] {
    values[start..]
        .first_chunk()
        .expect("windows lie in their block")
}

/// How windows of `size` by `size` lie on an image: the first of them `before` pixels outside, each
/// `stride` after the other.
#[derive(Clone, Copy, Debug)]
pub(super) struct Layout {
    pub size: usize,
    pub stride: usize,
    pub before: usize,
    /// Windows in a row.
    pub columns: usize,
}

impl Layout {
    /// Columns of a block's line: those of one remainder by the stride.
    fn line(&self) -> usize {
        self.columns + (self.size.max(1) - 1) / self.stride
    }

    /// Rows of a block for `count` rows of windows.
    fn rows(&self, count: usize) -> usize {
        (count.max(1) - 1) * self.stride + self.size
    }

    /// Copies what the windows of `rows` see of the channels `of` of images `[n, c, h, w]` into `block`, with
    /// zeros where that is outside: `[sample, channel, row, remainder by the stride, column]`, so that
    /// whatever place of a window is asked for, neighbours lie side by side.
    pub fn block(
        &self,
        images: Images,
        [_, height, width]: [usize; 3],
        rows: Rows,
        of: Range<usize>,
        block: &mut Vec<f32>,
    ) {
        let (line, count) = (self.line(), self.rows(rows.count));
        let size = rows.samples * of.len() * count * self.stride * line;
        if block.len() < size {
            block.resize(size, 0.0);
        }
        let mut lines = block.chunks_exact_mut(line);
        for sample in rows.sample..rows.sample + rows.samples {
            for channel in of.clone() {
                let plane = images.plane(sample, channel, height * width);
                for row in 0..count {
                    let y = (rows.first * self.stride + row).wrapping_sub(self.before);
                    for (remainder, line) in (0..self.stride).zip(&mut lines) {
                        if row % self.stride >= self.size || remainder >= self.size {
                            // Between the windows.
                            continue;
                        }
                        if y < height {
                            self.spread(&plane[y * width..(y + 1) * width], remainder, line);
                        } else {
                            line.fill(0.0);
                        }
                    }
                }
            }
        }
    }

    /// `line[i] = source[i * stride + first - before]`, zero outside.
    fn spread(&self, source: &[f32], first: usize, line: &mut [f32]) {
        let Self { stride, before, .. } = *self;
        // Columns that lie inside the image.
        let begin = before
            .saturating_sub(first)
            .div_ceil(stride)
            .min(line.len());
        let end = (source.len() + before)
            .saturating_sub(first)
            .div_ceil(stride)
            .clamp(begin, line.len());
        line[..begin].fill(0.0);
        line[end..].fill(0.0);
        if begin == end {
            return;
        }
        let source = &source[begin * stride + first - before..];
        let line = &mut line[begin..end];
        if stride == 1 {
            line.copy_from_slice(&source[..line.len()]);
        } else if stride == 2 && source.len() >= 2 * line.len() {
            let (pairs, _) = source.as_chunks::<2>();
            for (value, [source, _]) in line.iter_mut().zip(pairs) {
                *value = *source;
            }
        } else {
            for (value, source) in line.iter_mut().zip(source.iter().step_by(stride)) {
                *value = *source;
            }
        }
    }

    /// The places `places` (row and column in a window) of `channels` channels as rows of a matrix
    /// over a block that [`Self::block`] wrote for `rows`.
    pub fn windows<'a>(
        &self,
        block: &'a [f32],
        channels: usize,
        rows: Rows,
        places: &[[usize; 2]],
    ) -> Windows<'a> {
        let (line, count) = (self.line(), self.rows(rows.count));
        let plane = count * self.stride * line;
        let place =
            |[y, x]: [usize; 2]| (y * self.stride + x % self.stride) * line + x / self.stride;
        Windows {
            values: block,
            taps: (0..channels)
                .flat_map(|channel| places.iter().map(move |&at| channel * plane + place(at)))
                .collect(),
            lines: (0..rows.samples)
                .flat_map(|sample| {
                    let start = sample * channels * plane;
                    (0..rows.count).map(move |row| start + row * self.stride * self.stride * line)
                })
                .collect(),
            width: self.columns,
            in_block: true,
        }
    }
}
