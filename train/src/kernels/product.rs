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

use rten_simd::ops::{BitOps, NumOps};
use rten_simd::{Isa, SimdOp};

/// Rows of `C` that are worked on together.
const ROWS: usize = 8;
/// The same where registers are few.
const FEWER_ROWS: usize = 6;
/// Rows and columns of a block of the depth: panels of it stay in the first-level cache.
const DEPTH: usize = 256;
/// Tiles one below the other that meet a panel of the right side while it lies in the first-level cache.
const TOGETHER: usize = 8;
/// Elements of the right side that are kept packed.
const KEPT: usize = 1 << 17;
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

    /// The elements `columns` where they lie, if they are neighbours in every row and can be read from
    /// there as fast as from a panel.
    #[inline(always)]
    fn in_place(&self, _columns: Range<usize>) -> Option<InPlace<'_>> {
        None
    }
}

/// Columns of a right side where they lie: those of row `r` begin at `values[starts[r] + offset]`.
pub(super) struct InPlace<'a> {
    pub values: &'a [f32],
    pub starts: &'a [usize],
    pub offset: usize,
}

impl<'a> InPlace<'a> {
    /// The first `width` of the columns in these rows.
    #[inline(always)]
    fn lines(&self, rows: Range<usize>, width: usize) -> impl Iterator<Item = &'a [f32]> {
        let (values, offset) = (self.values, self.offset);
        let line = move |start: &usize| &values[start + offset..][..width];
        self.starts[rows].iter().map(line)
    }
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
        let product = Product {
            left,
            right,
            rows,
            columns,
            depth,
            finish,
            scratch,
        };
        product.dispatch();
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

impl<L: Left, R: Right, F: FnMut(usize, &mut [f32])> SimdOp for Product<'_, L, R, F> {
    type Output = ();

    #[inline(always)]
    fn eval<I: Isa>(self, isa: I) {
        let lanes = isa.f32().len();
        // With vectors of 16 there are 32 registers, as on Arm; with those of 8 there are 16.
        let few_registers = lanes == 8;
        match (self.rows.len(), few_registers) {
            _ if self.columns.len() <= lanes => self.run::<I, ROWS, 1>(isa),
            (..=2, _) => self.run::<I, 2, 4>(isa),
            (..=4, _) => self.run::<I, 4, 3>(isa),
            (_, false) => self.run::<I, ROWS, 2>(isa),
            (_, true) => self.run::<I, FEWER_ROWS, 2>(isa),
        }
    }
}

impl<L: Left, R: Right, F: FnMut(usize, &mut [f32])> Product<'_, L, R, F> {
    /// With tiles of `HEIGHT` rows and `VECTORS` vectors.
    #[inline(always)]
    fn run<I: Isa, const HEIGHT: usize, const VECTORS: usize>(self, isa: I) {
        let Self {
            left: left_side,
            right: right_side,
            rows: all_rows,
            columns: all_columns,
            depth: whole_depth,
            mut finish,
            scratch,
        } = self;
        let (rows, columns) = (all_rows.len(), all_columns.len());
        let width = VECTORS * isa.f32().len();
        let stride = columns.next_multiple_of(width);
        let of_panel = |number: usize| {
            let begin = all_columns.start + number * width;
            begin..(begin + width).min(all_columns.end)
        };
        let in_place = |number: usize| {
            let columns = of_panel(number);
            let whole = columns.len() == width;
            whole.then(|| right_side.in_place(columns)).flatten()
        };
        let padded = rows.next_multiple_of(HEIGHT);
        let product = grown(&mut scratch.product, padded * stride);
        let left = grown(&mut scratch.left, padded.min(TOGETHER * HEIGHT) * DEPTH);
        // As much of the right side as stays in the second-level cache.
        let kept = (KEPT / stride / DEPTH).max(1) * DEPTH;
        let right = grown(&mut scratch.right, whole_depth.min(kept) * stride);
        if whole_depth == 0 {
            product.fill(0.0);
        }
        for first in (0..whole_depth).step_by(kept) {
            let blocks = || {
                let end = (first + kept).min(whole_depth);
                let block = move |first: usize| first..(first + DEPTH).min(end);
                (first..end).step_by(DEPTH).map(block)
            };
            for (depth, right) in blocks().zip(right.chunks_mut(DEPTH * stride)) {
                let panels = right.chunks_exact_mut(depth.len() * width);
                for (number, out) in panels.take(stride / width).enumerate() {
                    if in_place(number).is_none() {
                        right_side.read_panel(depth.clone(), of_panel(number), width, out);
                    }
                }
            }
            let groups = product.chunks_mut(TOGETHER * HEIGHT * stride);
            for (group, product) in groups.enumerate() {
                let first_row = group * TOGETHER * HEIGHT;
                let left = &mut left[..product.len() / stride * DEPTH];
                for (depth, right) in blocks().zip(right.chunks(DEPTH * stride)) {
                    for (row, out) in left.chunks_exact_mut(DEPTH).enumerate() {
                        let row = first_row + row;
                        if row < rows {
                            let row = all_rows.start + row;
                            left_side.read(row, depth.clone(), &mut out[..depth.len()]);
                        } else {
                            out.fill(0.0);
                        }
                    }
                    let panels = right.chunks_exact(depth.len() * width).take(stride / width);
                    for (number, right) in panels.enumerate() {
                        let in_place = in_place(number);
                        let left = left.chunks_exact(HEIGHT * DEPTH);
                        for (left, product) in left.zip(product.chunks_exact_mut(HEIGHT * stride)) {
                            let sums: [[I::F32; VECTORS]; HEIGHT] = match &in_place {
                                None => tile(isa, left, right.chunks_exact(width)),
                                Some(right) => tile(isa, left, right.lines(depth.clone(), width)),
                            };
                            let product = &mut product[number * width..];
                            put(isa, sums, product, stride, depth.start == 0);
                        }
                    }
                }
            }
        }
        for (row, product) in product.chunks_exact_mut(stride).take(rows).enumerate() {
            finish(row, &mut product[..columns]);
        }
    }
}

/// Products of `HEIGHT` rows of a left block, [`DEPTH`] elements each, with the rows of a right panel, summed over
/// all of those.
#[inline(always)]
#[allow(
    clippy::needless_range_loop,
    reason = "with iterators the sums leave the registers"
)]
fn tile<'a, I: Isa, const HEIGHT: usize, const VECTORS: usize>(
    isa: I,
    left: &[f32],
    right: impl Iterator<Item = &'a [f32]>,
) -> [[I::F32; VECTORS]; HEIGHT] {
    let ops = isa.f32();
    let (left, _) = left.as_chunks::<DEPTH>();
    let left: &[[f32; DEPTH]; HEIGHT] = left.try_into().expect("a block has the rows of a tile");
    let mut sums = [[ops.zero(); VECTORS]; HEIGHT];
    // Of a known number: the loop checks no bounds.
    for (k, right) in right.take(DEPTH).enumerate() {
        let vectors: [I::F32; VECTORS] = ops.load_many(right);
        for row in 0..HEIGHT {
            let value = ops.splat(left[row][k]);
            for vector in 0..VECTORS {
                sums[row][vector] = ops.mul_add(value, vectors[vector], sums[row][vector]);
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
fn put<I: Isa, const HEIGHT: usize, const VECTORS: usize>(
    isa: I,
    sums: [[I::F32; VECTORS]; HEIGHT],
    product: &mut [f32],
    stride: usize,
    over: bool,
) {
    let ops = isa.f32();
    let lanes = ops.len();
    for row in 0..HEIGHT {
        let line = &mut product[row * stride..row * stride + VECTORS * lanes];
        for vector in 0..VECTORS {
            let part = &mut line[vector * lanes..(vector + 1) * lanes];
            let sum = match over {
                true => sums[row][vector],
                false => ops.add(ops.load(part), sums[row][vector]),
            };
            ops.store(sum, part);
        }
    }
}
