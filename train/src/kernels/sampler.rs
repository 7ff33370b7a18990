//! Sampling along rows and its gradients, one pass over memory each. The definition is
//! [`crate::loss::sampler`].

use burn::backend::Flex;
use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::NoCheckpointing;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::tensor::Tensor;
use rayon::prelude::*;

use super::cpu::{
    Cpu, Tracked, cpu_tensor, dims, from_plain, from_tracked, is_f32, tracked, values,
};

/// Samples rows of `source`, `[n, c, h, w]`, at columns displaced by `offset_fraction`,
/// `[n, 1, h, w]`, on the CPU backend; `None` elsewhere. See [`crate::loss::sampler`] for the definition.
pub(crate) fn sample_horizontal(source: &Tensor<4>, offset: &Tensor<4>) -> Option<Tensor<4>> {
    if source.is_autodiff() || offset.is_autodiff() {
        let (source, offset) = (tracked(source)?, tracked(offset)?);
        let suits = is_f32(source.primitive()) && is_f32(offset.primitive());
        return suits.then(|| from_tracked(tracked_sample(source, offset)));
    }
    let source = source.clone().try_into_primitive::<Flex>().ok()?;
    let offset = offset.clone().try_into_primitive::<Flex>().ok()?;
    let suits = is_f32(&source) && is_f32(&offset);
    suits.then(|| from_plain(sample(&source.to_contiguous(), &offset.to_contiguous())))
}

/// The two columns a position lies between, counted in the image with a black column at either
/// side, the fraction of the way from the first to the second, and whether the position was moved
/// to the border.
#[inline(always)]
fn taps(column: usize, offset: f32, width: usize) -> (usize, usize, f32, bool) {
    let last = (width + 1) as f32;
    let wanted = offset * width as f32 + (column + 1) as f32;
    let position = wanted.clamp(0.0, last);
    let floor = position.floor();
    let first = floor as usize;
    let moved = wanted < 0.0 || wanted > last;
    (first, (first + 1).min(width + 1), position - floor, moved)
}

/// The sample of a row in the image with a black column at either side.
#[inline(always)]
fn padded(row: &[f32], column: usize) -> f32 {
    // Column 0 wraps to a number beyond every row.
    row.get(column.wrapping_sub(1)).copied().unwrap_or(0.0)
}

fn sample(source: &Cpu, offset: &Cpu) -> Cpu {
    let [_, channels, height, width] = dims(source);
    let (source_values, offset_values) = (values(source), values(offset));
    let plane = height * width;
    let mut output = vec![0.0_f32; source_values.len()];
    output
        .par_chunks_mut((channels * plane).max(1))
        .zip(source_values.par_chunks((channels * plane).max(1)))
        .zip(offset_values.par_chunks(plane.max(1)))
        .for_each(|((output, source), offset)| {
            for row in 0..height {
                let line = row * width;
                for column in 0..width {
                    let (first, second, fraction, _) = taps(column, offset[line + column], width);
                    for channel in 0..channels {
                        let start = channel * plane + line;
                        let source = &source[start..start + width];
                        let (low, high) = (padded(source, first), padded(source, second));
                        output[start + column] = low + fraction * (high - low);
                    }
                }
            }
        });
    cpu_tensor(output, &dims(source))
}

/// Backward step of the sampler.
#[derive(Debug)]
struct SampleGradient;

impl Backward<Flex, 2> for SampleGradient {
    type State = (Cpu, Cpu);

    fn backward(
        self,
        ops: Ops<Self::State, 2>,
        gradients: &mut Gradients,
        _checkpointer: &mut Checkpointer,
    ) {
        let [source_node, offset_node] = ops.parents;
        let (source, offset) = ops.state;
        let gradient = gradients.consume::<Flex>(&ops.node).to_contiguous();
        let [_, channels, height, width] = dims(&source);
        let plane = height * width;
        if let Some(node) = offset_node {
            let mut found = vec![0.0_f32; values(&offset).len()];
            found
                .par_chunks_mut(plane.max(1))
                .zip(values(&offset).par_chunks(plane.max(1)))
                .zip(values(&source).par_chunks((channels * plane).max(1)))
                .zip(values(&gradient).par_chunks((channels * plane).max(1)))
                .for_each(|(((found, offset), source), gradient)| {
                    for (index, (found, &offset)) in found.iter_mut().zip(offset).enumerate() {
                        let (line, column) = (index - index % width, index % width);
                        let (first, second, _, moved) = taps(column, offset, width);
                        if moved {
                            continue;
                        }
                        let slope: f32 = (0..channels)
                            .map(|channel| {
                                let start = channel * plane + line;
                                let source = &source[start..start + width];
                                let step = padded(source, second) - padded(source, first);
                                gradient[start + column] * step
                            })
                            .sum();
                        *found = slope * width as f32;
                    }
                });
            gradients.register::<Flex>(node.id, cpu_tensor(found, &dims(&offset)));
        }
        if let Some(node) = source_node {
            let mut found = vec![0.0_f32; values(&source).len()];
            found
                .par_chunks_mut((channels * plane).max(1))
                .zip(values(&offset).par_chunks(plane.max(1)))
                .zip(values(&gradient).par_chunks((channels * plane).max(1)))
                .for_each(|((found, offset), gradient)| {
                    for (index, &offset) in offset.iter().enumerate() {
                        let (line, column) = (index - index % width, index % width);
                        let (first, second, fraction, _) = taps(column, offset, width);
                        for channel in 0..channels {
                            let start = channel * plane + line;
                            let gradient = gradient[start + column];
                            let found = &mut found[start..start + width];
                            if let Some(found) = found.get_mut(first.wrapping_sub(1)) {
                                *found += (1.0 - fraction) * gradient;
                            }
                            if let Some(found) = found.get_mut(second.wrapping_sub(1)) {
                                *found += fraction * gradient;
                            }
                        }
                    }
                });
            gradients.register::<Flex>(node.id, cpu_tensor(found, &dims(&source)));
        }
    }
}

fn tracked_sample(source: Tracked, offset: Tracked) -> Tracked {
    let (source, source_node) = source.into_parts();
    let (offset, offset_node) = offset.into_parts();
    let (source, offset) = (source.to_contiguous(), offset.to_contiguous());
    let output = sample(&source, &offset);
    match SampleGradient
        .prepare::<NoCheckpointing>([source_node, offset_node])
        .compute_bound()
        .stateful()
    {
        OpsKind::Tracked(prepared) => prepared.finish((source, offset), output),
        OpsKind::UnTracked(prepared) => prepared.finish(output),
    }
}
