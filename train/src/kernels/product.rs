//! The matrix product that convolutions and their gradients are made of.
//!
//! `C = A B`, where neither `A` nor `B` need exist: both are asked for pieces of their rows, so that an
//! unfolded image stays an image. Pieces are packed into panels that lie in the caches, and tiles of `C`
//! stay in registers over a block of the depth (Goto and van de Geijn, Anatomy of High-Performance Matrix
//! Multiplication, ACM TOMS 34, 2008). The loops are compiled for the vector units of the machine at
//! hand.
//!
//! Every element of `C` is summed in the order of the depth, block by block, whatever the size of a
//! vector and the number of threads.
//!
//! Not here: threads. One product is the work of one thread; callers divide theirs.

use std::cell::RefCell;
use std::ops::Range;

use pulp::{Simd, WithSimd};

/// Most rows of `C` that are worked on together.
const ROWS: usize = 8;
/// Rows and columns of a block of the depth: panels of it stay in the first-level cache.
const DEPTH: usize = 256;
/// Elements of the right side that are kept packed.
const KEPT: usize = 1 << 17;
/// Registers from which on a tile of two vectors may have all [`ROWS`], and its rows where there are fewer.
const MANY_REGISTERS: usize = 32;
const FEWER_ROWS: usize = 6;

/// The left side of a product.
pub(super) trait Left {
    /// Writes the elements `columns` of the row `row`.
    fn read(&self, row: usize, columns: Range<usize>, out: &mut [f32]);
}

/// The right side of a product.
pub(super) trait Right {
    /// Writes the elements `columns` of several rows, one row after the other, `width` elements each;
    /// what is left of `width` is zero.
    fn read_panel(&self, rows: Range<usize>, columns: Range<usize>, width: usize, out: &mut [f32]);
}

/// A matrix in memory, row after row.
pub(super) struct Dense<'a> {
    pub values: &'a [f32],
    pub columns: usize,
}

impl Left for Dense<'_> {
    #[inline(always)]
    fn read(&self, row: usize, columns: Range<usize>, out: &mut [f32]) {
        let start = row * self.columns;
        out.copy_from_slice(&self.values[start + columns.start..start + columns.end]);
    }
}

/// Memory that a thread keeps from product to product.
#[derive(Default)]
struct Scratch {
    product: Vec<f32>,
    left: Vec<f32>,
    right: Vec<f32>,
}

thread_local! {
    static SCRATCH: RefCell<Scratch> = RefCell::default();
}

/// The first `count` elements, after growing to as many.
fn grown(values: &mut Vec<f32>, count: usize) -> &mut [f32] {
    if values.len() < count {
        values.resize(count, 0.0);
    }
    &mut values[..count]
}

/// Multiplies `rows` of `left` with `columns` of `right` over the whole `depth`, and hands `finish` every
/// row's number, counted from the first, and its elements.
pub(super) fn multiply(
    left: &impl Left,
    right: &impl Right,
    rows: Range<usize>,
    columns: Range<usize>,
    depth: usize,
    finish: impl FnMut(usize, &mut [f32]),
) {
    SCRATCH.with_borrow_mut(|scratch| {
        pulp::Arch::new().dispatch(Product {
            left,
            right,
            rows,
            columns,
            depth,
            finish,
            scratch,
        });
    });
}

struct Product<'a, L, R, F> {
    left: &'a L,
    right: &'a R,
    rows: Range<usize>,
    columns: Range<usize>,
    depth: usize,
    finish: F,
    scratch: &'a mut Scratch,
}

impl<L: Left, R: Right, F: FnMut(usize, &mut [f32])> WithSimd for Product<'_, L, R, F> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let narrow = self.columns.len() <= lanes::<S>();
        match (S::REGISTER_COUNT >= MANY_REGISTERS, narrow) {
            (true, true) => self.run::<S, ROWS, 1>(simd),
            (true, false) => self.run::<S, ROWS, 2>(simd),
            (false, true) => self.run::<S, ROWS, 1>(simd),
            (false, false) => self.run::<S, FEWER_ROWS, 2>(simd),
        }
    }
}

#[inline(always)]
fn lanes<S: Simd>() -> usize {
    size_of::<S::f32s>() / size_of::<f32>()
}

impl<L: Left, R: Right, F: FnMut(usize, &mut [f32])> Product<'_, L, R, F> {
    /// With tiles of `HEIGHT` rows and `VECTORS` vectors.
    #[inline(always)]
    fn run<S: Simd, const HEIGHT: usize, const VECTORS: usize>(mut self, simd: S) {
        let (rows, columns) = (self.rows.len(), self.columns.len());
        let width = VECTORS * lanes::<S>();
        let stride = columns.next_multiple_of(width);
        let product = grown(
            &mut self.scratch.product,
            rows.next_multiple_of(HEIGHT) * stride,
        );
        let left = grown(&mut self.scratch.left, HEIGHT * DEPTH);
        // As much of the right side as stays in the second-level cache.
        let kept = (KEPT / stride / DEPTH).max(1) * DEPTH;
        let right = grown(&mut self.scratch.right, self.depth.min(kept) * stride);
        if self.depth == 0 {
            product.fill(0.0);
        }
        for first in (0..self.depth).step_by(kept) {
            let blocks = || {
                let end = (first + kept).min(self.depth);
                let block = move |first: usize| first..(first + DEPTH).min(end);
                (first..end).step_by(DEPTH).map(block)
            };
            for (depth, right) in blocks().zip(right.chunks_mut(DEPTH * stride)) {
                let panels = right.chunks_exact_mut(depth.len() * width);
                for (number, out) in panels.take(stride / width).enumerate() {
                    let begin = self.columns.start + number * width;
                    let end = (begin + width).min(self.columns.end);
                    self.right.read_panel(depth.clone(), begin..end, width, out);
                }
            }
            for (block, product) in product.chunks_exact_mut(HEIGHT * stride).enumerate() {
                for (depth, right) in blocks().zip(right.chunks(DEPTH * stride)) {
                    for (row, out) in left.chunks_exact_mut(DEPTH).enumerate() {
                        let row = block * HEIGHT + row;
                        if row < rows {
                            let row = self.rows.start + row;
                            self.left.read(row, depth.clone(), &mut out[..depth.len()]);
                        } else {
                            out.fill(0.0);
                        }
                    }
                    let panels = right.chunks_exact(depth.len() * width).take(stride / width);
                    for (number, right) in panels.enumerate() {
                        let product = &mut product[number * width..];
                        let sums = tile::<S, HEIGHT, VECTORS>(simd, left, right, depth.len());
                        put(simd, sums, product, stride, depth.start == 0);
                    }
                }
            }
        }
        for (row, product) in product.chunks_exact_mut(stride).take(rows).enumerate() {
            (self.finish)(row, &mut product[..columns]);
        }
    }
}

/// Products of `HEIGHT` rows of a left block, [`DEPTH`] elements each, with a right panel, summed over
/// the first `depth` elements.
#[inline(always)]
#[allow(
    clippy::needless_range_loop,
    reason = "with iterators the sums leave the registers"
)]
fn tile<S: Simd, const HEIGHT: usize, const VECTORS: usize>(
    simd: S,
    left: &[f32],
    right: &[f32],
    depth: usize,
) -> [[S::f32s; VECTORS]; HEIGHT] {
    let (left, _) = left.as_chunks::<DEPTH>();
    let left: &[[f32; DEPTH]; HEIGHT] = left.try_into().expect("a block has the rows of a tile");
    let (right, _) = S::as_simd_f32s(right);
    let (right, _) = right.as_chunks::<VECTORS>();
    // Known bounds: the loop checks none. Written with indices, so that the sums stay in registers.
    let depth = depth.min(DEPTH).min(right.len());
    let mut sums = [[simd.splat_f32s(0.0); VECTORS]; HEIGHT];
    for k in 0..depth {
        let right = right[k];
        for row in 0..HEIGHT {
            let value = simd.splat_f32s(left[row][k]);
            for vector in 0..VECTORS {
                sums[row][vector] = simd.mul_add_e_f32s(value, right[vector], sums[row][vector]);
            }
        }
    }
    sums
}

/// Writes a tile over what is there, or adds it.
#[inline(always)]
#[allow(
    clippy::needless_range_loop,
    reason = "with iterators the sums leave the registers"
)]
fn put<S: Simd, const HEIGHT: usize, const VECTORS: usize>(
    simd: S,
    sums: [[S::f32s; VECTORS]; HEIGHT],
    product: &mut [f32],
    stride: usize,
    over: bool,
) {
    for row in 0..HEIGHT {
        let (line, _) = S::as_mut_simd_f32s(&mut product[row * stride..]);
        for vector in 0..VECTORS {
            line[vector] = match over {
                true => sums[row][vector],
                false => simd.add_f32s(line[vector], sums[row][vector]),
            };
        }
    }
}
