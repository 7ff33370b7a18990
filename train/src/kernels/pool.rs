//! The largest of 3x3 windows at every second place, and its gradient, row by row. The definition is
//! [`crate::network::layers::Ops::max_pool`].

use burn::backend::Flex;
use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::NoCheckpointing;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::tensor::Tensor;
use rayon::prelude::*;
use rten_simd::{Isa, SimdOp};

use super::cpu::{
    Cpu, Tracked, cpu_tensor, dims, from_plain, from_tracked, is_f32, tracked, values,
};

/// Side of a window.
const SIDE: usize = 3;
/// From one window to the next.
const STRIDE: usize = 2;

/// The largest of every window of `[n, c, h, w]` on the CPU backend, `[n, c, h / 2, w / 2]`; `None` elsewhere,
/// and where there is no window. The image has one row of zeros above it and one column of them to its left;
/// of values that are no numbers the last one wins, of equal ones the first.
pub(crate) fn largest_of_windows(input: &Tensor<4>) -> Option<Tensor<4>> {
    let [_, _, height, width] = input.dims();
    if height < STRIDE || width < STRIDE {
        return None;
    }
    if input.is_autodiff() {
        let input = tracked(input)?;
        return is_f32(input.primitive()).then(|| from_tracked(tracked_largest(input)));
    }
    let input = input.clone().try_into_primitive::<Flex>().ok()?;
    is_f32(&input).then(|| from_plain(largest(&input.to_contiguous()).0))
}

/// The largest values, and where in its window each of them was: row by row, from 0.
fn largest(input: &Cpu) -> (Cpu, Vec<u8>) {
    let [batch, channels, height, width] = dims(input);
    let [rows, columns] = [height / STRIDE, width / STRIDE];
    let count = batch * channels * rows * columns;
    let (mut output, mut places) = (vec![0.0_f32; count], vec![0_u8; count]);
    output
        .par_chunks_mut(rows * columns)
        .zip(places.par_chunks_mut(rows * columns))
        .zip(values(input).par_chunks(height * width))
        .for_each(|((found, places), values)| {
            Plane {
                values,
                width,
                found,
                places,
            }
            .dispatch();
        });
    let output = cpu_tensor(output, &[batch, channels, rows, columns]);
    (output, places)
}

/// One channel of one sample.
struct Plane<'a> {
    values: &'a [f32],
    width: usize,
    found: &'a mut [f32],
    places: &'a mut [u8],
}

impl SimdOp for Plane<'_> {
    type Output = ();

    #[inline(always)]
    fn eval<I: Isa>(self, _: I) {
        let columns = self.width / STRIDE;
        let mut candidates = vec![0.0_f32; columns];
        let mut numbers = vec![0_u32; columns];
        let found = self.found.chunks_exact_mut(columns);
        let places = self.places.chunks_exact_mut(columns);
        for (row, (found, places)) in found.zip(places).enumerate() {
            for number in 0..SIDE * SIDE {
                let [down, right] = [number / SIDE, number % SIDE];
                match (STRIDE * row + down).checked_sub(1) {
                    None => candidates.fill(0.0),
                    Some(line) => {
                        let line = &self.values[line * self.width..(line + 1) * self.width];
                        read(line, right, &mut candidates);
                    }
                }
                if number == 0 {
                    found.copy_from_slice(&candidates);
                    numbers.fill(0);
                    continue;
                }
                let windows = found.iter_mut().zip(&mut numbers);
                for ((found, place), &candidate) in windows.zip(&candidates) {
                    let is_larger = candidate > *found || candidate.is_nan();
                    *found = if is_larger { candidate } else { *found };
                    *place = if is_larger { number as u32 } else { *place };
                }
            }
            for (place, number) in places.iter_mut().zip(&numbers) {
                *place = *number as u8;
            }
        }
    }
}

/// What the windows of a row have in column `right` of theirs.
#[inline(always)]
fn read(line: &[f32], right: usize, candidates: &mut [f32]) {
    let (pairs, _) = line.as_chunks::<STRIDE>();
    match right {
        0 => {
            candidates[0] = 0.0;
            for (candidate, [_, odd]) in candidates[1..].iter_mut().zip(pairs) {
                *candidate = *odd;
            }
        }
        right => {
            for (candidate, pair) in candidates.iter_mut().zip(pairs) {
                *candidate = pair[right - 1];
            }
        }
    }
}

/// Backward step.
#[derive(Debug)]
struct LargestGradient;

impl Backward<Flex, 1> for LargestGradient {
    /// Height and width of the input, and where in its window each largest value was.
    type State = ([usize; 2], Vec<u8>);

    fn backward(
        self,
        ops: Ops<Self::State, 1>,
        gradients: &mut Gradients,
        _checkpointer: &mut Checkpointer,
    ) {
        let [node] = ops.parents;
        let (size, places) = ops.state;
        let gradient = gradients.consume::<Flex>(&ops.node).to_contiguous();
        let Some(node) = node else { return };
        gradients.register::<Flex>(node.id, spread(&gradient, &places, size));
    }
}

/// Each gradient where its value came from; those of the border of zeros go nowhere.
fn spread(gradient: &Cpu, places: &[u8], [height, width]: [usize; 2]) -> Cpu {
    let [batch, channels, rows, columns] = dims(gradient);
    let mut found = vec![0.0_f32; batch * channels * height * width];
    found
        .par_chunks_mut(height * width)
        .zip(values(gradient).par_chunks(rows * columns))
        .zip(places.par_chunks(rows * columns))
        .for_each(|((found, gradient), places)| {
            let windows = gradient.iter().zip(places).enumerate();
            for (window, (gradient, &place)) in windows {
                let [down, right] = [place as usize / SIDE, place as usize % SIDE];
                let row = (STRIDE * (window / columns) + down).checked_sub(1);
                let column = (STRIDE * (window % columns) + right).checked_sub(1);
                if let (Some(row), Some(column)) = (row, column) {
                    found[row * width + column] += gradient;
                }
            }
        });
    cpu_tensor(found, &[batch, channels, height, width])
}

fn tracked_largest(input: Tracked) -> Tracked {
    let (input, node) = input.into_parts();
    let [_, _, height, width] = dims(&input);
    let (output, places) = largest(&input.to_contiguous());
    match LargestGradient
        .prepare::<NoCheckpointing>([node])
        .compute_bound()
        .stateful()
    {
        OpsKind::Tracked(prepared) => prepared.finish(([height, width], places), output),
        OpsKind::UnTracked(prepared) => prepared.finish(output),
    }
}
