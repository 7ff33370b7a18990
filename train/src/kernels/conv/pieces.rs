//! How passes are divided into pieces of work, by shape alone, and what each of them sees.

use std::cell::RefCell;
use std::ops::Range;

use rayon::prelude::*;

use super::images::Images;
use super::windows::{Layout, Rows, Windows};

/// Pieces that a pass is divided into where it can be, for any number of threads.
pub(super) const PIECES: usize = 16;
/// Fewest and most positions of a piece: its share of packing, and what caches hold.
pub(super) const FEWEST_POSITIONS: usize = 256;
pub(super) const MOST_POSITIONS: usize = 2048;
/// Fewest channels of a piece.
pub(super) const FEWEST_CHANNELS: usize = 64;
/// Positions that are multiplied at a time.
const CHUNK: usize = 512;

thread_local! {
    static BLOCK: RefCell<Vec<f32>> = RefCell::default();
    static KEPT: RefCell<Vec<f32>> = RefCell::default();
}

/// Runs `work` on `count` numbers of memory that stays with the thread: what a pass needs for a moment
/// is as large as weights are, and pages that the system has to clear cost more than the pass.
pub(super) fn with_kept<T>(count: usize, work: impl FnOnce(&mut [f32]) -> T) -> T {
    // Not borrowed: while this thread waits for others it may get here again.
    let mut kept = KEPT.take();
    if kept.len() < count {
        drop(kept);
        kept = vec![0.0; count];
    }
    let result = work(&mut kept[..count]);
    KEPT.set(kept);
    result
}

/// A part of a pass: rows and channels of its result, with the memory of either.
pub(super) struct Piece<'a> {
    pub rows: Rows,
    pub channels: Range<usize>,
    /// Of every sample and channel the rows.
    pub out: Vec<&'a mut [f32]>,
}

/// Divides a result `[n, c, h, w]`, given plane by plane, by rows, and those by channels; `scale` rows of it
/// belong to each of the rows that the division counts.
pub(super) fn pieces<'a>(
    mut planes: impl Iterator<Item = &'a mut [f32]>,
    batch: usize,
    [channels, height, width]: [usize; 3],
    scale: usize,
) -> Vec<Vec<Piece<'a>>> {
    let size = [height.div_ceil(scale), width.div_ceil(scale)];
    let wanted = (batch * size[0] * size[1] / PIECES).clamp(FEWEST_POSITIONS, MOST_POSITIONS);
    let divided = Rows::divide(batch, size, wanted);
    let blocks = (PIECES / divided.len().max(1)).clamp(1, channels.div_ceil(FEWEST_CHANNELS));
    let together = channels.div_ceil(blocks).next_multiple_of(8);
    let blocks = channels.div_ceil(together);
    let mut pieces: Vec<Vec<Piece>> = divided
        .iter()
        .map(|&rows| {
            let piece = |block: usize| Piece {
                rows,
                channels: block * together..((block + 1) * together).min(channels),
                out: Vec::new(),
            };
            (0..blocks).map(piece).collect()
        })
        .collect();
    for sample in 0..batch {
        for channel in 0..channels {
            let mut rest = planes.next().expect("a plane for every channel");
            let mut begin = 0;
            for (number, rows) in divided.iter().enumerate() {
                if !(rows.sample..rows.sample + rows.samples).contains(&sample) {
                    continue;
                }
                let end = ((rows.first + rows.count) * scale).min(height);
                let (part, others) = rest.split_at_mut((end - begin) * width);
                pieces[number][channel / together].out.push(part);
                (rest, begin) = (others, end);
            }
        }
    }
    pieces
}

/// Where windows lie on an image.
pub(super) struct Source<'a> {
    /// One, where there is no layout.
    pub images: Images<'a>,
    pub size: [usize; 3],
    /// `None` where they are single pixels one after the other, so that the image needs no block.
    pub layout: Option<Layout>,
}

impl Source<'_> {
    /// Runs `work` on the windows of the channels `of`, for each of several lists of places in them.
    pub fn with_windows(
        &self,
        rows: Rows,
        of: Range<usize>,
        places: &[Vec<[usize; 2]>],
        work: impl FnOnce(&[Windows]),
    ) {
        let Some(layout) = self.layout else {
            let (values, _) = self.images.0[0];
            return work(&[Windows::planes(values, self.size, rows, of)]);
        };
        // Not borrowed: while this thread waits for others it may get here again.
        let mut block = BLOCK.take();
        layout.block(self.images, self.size, rows, of.clone(), &mut block);
        let windows = places
            .iter()
            .map(|places| layout.windows(&block, of.len(), rows, places));
        work(&windows.collect::<Vec<_>>());
        BLOCK.set(block);
    }

    /// Runs `work` on all pieces of a result, with the windows that each is made of.
    pub fn each_piece(
        &self,
        pieces: Vec<Vec<Piece>>,
        places: &[Vec<[usize; 2]>],
        work: impl Fn(Piece, &[Windows]) + Sync,
    ) {
        pieces.into_par_iter().for_each(|pieces| {
            let Some(first) = pieces.first() else { return };
            self.with_windows(first.rows, 0..self.size[0], places, |windows| {
                pieces
                    .into_par_iter()
                    .for_each(|piece| work(piece, windows));
            });
        });
    }
}

/// Calls `visit` for chunks of consecutive positions.
pub(super) fn each_chunk(positions: usize, mut visit: impl FnMut(Range<usize>)) {
    for begin in (0..positions).step_by(CHUNK) {
        visit(begin..(begin + CHUNK).min(positions));
    }
}

/// Calls `visit` for every sample that has a part in columns: the sample, their places among the
/// columns, and the first of them within the sample.
#[inline(always)]
pub(super) fn each_sample(
    columns: Range<usize>,
    of_sample: usize,
    mut visit: impl FnMut(usize, Range<usize>, usize),
) {
    let mut column = columns.start;
    while column < columns.end {
        let (sample, first) = (column / of_sample, column % of_sample);
        let end = ((sample + 1) * of_sample).min(columns.end);
        visit(sample, column - columns.start..end - columns.start, first);
        column = end;
    }
}
