//! Convolutions and transposed convolutions with weight gradients of our own.
//!
//! burn's CPU backend runs a general convolution whose kernel is as large as the image for the weight
//! gradient, ten times slower than need be where channels are few and images large. Here it is a matrix
//! product over unfolded tiles. Forward convolutions are burn's own.

use burn::backend::Flex;
use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::NoCheckpointing;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::ops::{ConvOptions, ConvTransposeOptions, ModuleOps};
use burn::tensor::{Tensor, module};
use ndarray::linalg::general_mat_mul;
use ndarray::{ArrayView2, ArrayViewMut2};
use rayon::prelude::*;

use super::cpu::{Cpu, Tracked, cpu_tensor, dims, from_tracked, is_f32, tracked, values};

/// Convolution with bias: `[n, in, h, w]` with `[out, in, k, k]` and `[out]`.
pub(crate) fn conv2d(
    input: Tensor<4>,
    weight: Tensor<4>,
    bias: Tensor<1>,
    stride: usize,
    padding: usize,
) -> Tensor<4> {
    if let Some((input, weight, bias)) = tracked_inputs(&input, &weight, &bias) {
        return from_tracked(tracked_conv(
            ConvGradient {
                stride,
                padding,
                transposed: false,
            },
            input,
            weight,
            bias,
        ));
    }
    let options = ConvOptions::new([stride; 2], [padding; 2], [1, 1], 1);
    module::conv2d(input, weight, Some(bias), options)
}

/// Transposed convolution with bias: `[n, in, h, w]` with `[in, out, k, k]` and `[out]`.
pub(crate) fn conv_transpose2d(
    input: Tensor<4>,
    weight: Tensor<4>,
    bias: Tensor<1>,
    stride: usize,
    padding: usize,
) -> Tensor<4> {
    if let Some((input, weight, bias)) = tracked_inputs(&input, &weight, &bias) {
        return from_tracked(tracked_conv(
            ConvGradient {
                stride,
                padding,
                transposed: true,
            },
            input,
            weight,
            bias,
        ));
    }
    let options = transposed_options(stride, padding);
    module::conv_transpose2d(input, weight, Some(bias), options)
}

/// The three tensors as members of one graph on the CPU; `None` where that is not what they are.
fn tracked_inputs(
    input: &Tensor<4>,
    weight: &Tensor<4>,
    bias: &Tensor<1>,
) -> Option<(Tracked, Tracked, Tracked)> {
    if !(input.is_autodiff() || weight.is_autodiff() || bias.is_autodiff()) {
        return None;
    }
    let input = tracked(input)?;
    let weight = tracked(weight)?;
    let bias = tracked(bias)?;
    let all_f32 = [&input, &weight, &bias]
        .iter()
        .all(|tensor| is_f32(tensor.primitive()));
    all_f32.then_some((input, weight, bias))
}

fn transposed_options(stride: usize, padding: usize) -> ConvTransposeOptions<2> {
    ConvTransposeOptions::new([stride; 2], [padding; 2], [0, 0], [1, 1], 1)
}

/// Backward step of a convolution or a transposed one.
#[derive(Clone, Copy, Debug)]
struct ConvGradient {
    stride: usize,
    padding: usize,
    transposed: bool,
}

impl ConvGradient {
    fn forward(self, input: Cpu, weight: Cpu, bias: Option<Cpu>) -> Cpu {
        if self.transposed {
            let options = transposed_options(self.stride, self.padding);
            Flex::conv_transpose2d(input, weight, bias, options)
        } else {
            let options = ConvOptions::new([self.stride; 2], [self.padding; 2], [1, 1], 1);
            Flex::conv2d(input, weight, bias, options)
        }
    }

    fn input_gradient(self, input: Cpu, weight: Cpu, gradient: Cpu) -> Cpu {
        if self.transposed {
            let options = ConvOptions::new([self.stride; 2], [self.padding; 2], [1, 1], 1);
            Flex::conv2d(gradient, weight, None, options)
        } else {
            let options = ConvOptions::new([self.stride; 2], [self.padding; 2], [1, 1], 1);
            Flex::conv2d_x_backward(input, weight, gradient, options)
        }
    }

    fn weight_gradient(self, input: Cpu, weight: &Cpu, gradient: &Cpu) -> Cpu {
        let kernel = weight.layout().shape()[2];
        // A transposed convolution is the input gradient of a convolution from its large side to
        // its small one; the weights' gradient follows with the two sides exchanged.
        let (large, small) = if self.transposed {
            (gradient.to_contiguous(), input.to_contiguous())
        } else {
            (input.to_contiguous(), gradient.to_contiguous())
        };
        let unfolding = Unfolding::new(&large, &small, kernel, self.stride, self.padding);
        cpu_tensor(
            unfolding.weight_gradient(values(&large), values(&small)),
            weight.layout().shape().as_slice(),
        )
    }
}

impl Backward<Flex, 3> for ConvGradient {
    type State = (Cpu, Cpu);

    fn backward(
        self,
        ops: Ops<Self::State, 3>,
        gradients: &mut Gradients,
        _checkpointer: &mut Checkpointer,
    ) {
        let [input_node, weight_node, bias_node] = ops.parents;
        let gradient = gradients.consume::<Flex>(&ops.node);
        let (input, weight) = ops.state;
        if let Some(node) = bias_node {
            gradients.register::<Flex>(node.id, bias_gradient(&gradient.to_contiguous()));
        }
        if let Some(node) = weight_node {
            let found = self.weight_gradient(input.clone(), &weight, &gradient);
            gradients.register::<Flex>(node.id, found);
        }
        if let Some(node) = input_node {
            let found = self.input_gradient(input, weight, gradient);
            gradients.register::<Flex>(node.id, found);
        }
    }
}

fn tracked_conv(gradient: ConvGradient, input: Tracked, weight: Tracked, bias: Tracked) -> Tracked {
    let (input, input_node) = input.into_parts();
    let (weight, weight_node) = weight.into_parts();
    let (bias, bias_node) = bias.into_parts();
    let state = (input.clone(), weight.clone());
    let output = gradient.forward(input, weight, Some(bias));
    match gradient
        .prepare::<NoCheckpointing>([input_node, weight_node, bias_node])
        .compute_bound()
        .stateful()
    {
        OpsKind::Tracked(prepared) => prepared.finish(state, output),
        OpsKind::UnTracked(prepared) => prepared.finish(output),
    }
}

/// Sums over everything but channels.
fn bias_gradient(gradient: &Cpu) -> Cpu {
    let [batch, channels, height, width] = dims(gradient);
    let plane = height * width;
    let values = values(gradient);
    let sums: Vec<f32> = (0..channels)
        .map(|channel| {
            (0..batch)
                .map(|sample| {
                    let start = (sample * channels + channel) * plane;
                    sum(&values[start..start + plane])
                })
                .sum()
        })
        .collect();
    cpu_tensor(sums, &[channels])
}

/// Sum in eight lanes, which is both faster and more exact than one running sum.
fn sum(values: &[f32]) -> f32 {
    let mut lanes = [0.0_f32; 8];
    let chunks = values.chunks_exact(8);
    let rest: f32 = chunks.remainder().iter().sum();
    for chunk in chunks {
        for (lane, value) in lanes.iter_mut().zip(chunk) {
            *lane += value;
        }
    }
    lanes.iter().sum::<f32>() + rest
}

/// How the windows of a convolution lie on the image they slide over.
struct Unfolding {
    batch: usize,
    /// Channels, height and width of the image.
    image: [usize; 3],
    /// Channels, rows and columns of what the windows produce.
    output: [usize; 3],
    kernel: usize,
    stride: usize,
    padding: usize,
}

/// Elements of an unfolded tile: about what a core's second-level cache holds.
const TILE_ELEMENTS: usize = 1 << 17;
/// Most partial sums of a weight gradient, and the elements all of them may take.
const MOST_PARTS: usize = 16;
const PART_ELEMENTS: usize = 1 << 23;

impl Unfolding {
    fn new(image: &Cpu, output: &Cpu, kernel: usize, stride: usize, padding: usize) -> Self {
        let [batch, image @ ..] = dims(image);
        let [_, output @ ..] = dims(output);
        Self {
            batch,
            image,
            output,
            kernel,
            stride,
            padding,
        }
    }

    /// Length of a window: channels times kernel area.
    fn window(&self) -> usize {
        self.image[0] * self.kernel * self.kernel
    }

    /// `[out, window]`: for every output channel the sum over all positions of the output's
    /// gradient times the window there.
    fn weight_gradient(&self, image: &[f32], gradient: &[f32]) -> Vec<f32> {
        let [outputs, rows, columns] = self.output;
        let window = self.window();
        let all_rows = self.batch * rows;
        let tile_rows = (TILE_ELEMENTS / (window * columns).max(1)).clamp(1, all_rows.max(1));
        let tiles = all_rows.div_ceil(tile_rows);
        let parts = (PART_ELEMENTS / (outputs * window).max(1))
            .clamp(1, MOST_PARTS)
            .min(tiles.max(1));
        let partial: Vec<Vec<f32>> = (0..parts)
            .into_par_iter()
            .map(|part| {
                let mut sum = vec![0.0; outputs * window];
                let mut unfolded = vec![0.0; window * tile_rows * columns];
                let mut gathered = vec![0.0; outputs * tile_rows * columns];
                for tile in (part * tiles / parts)..((part + 1) * tiles / parts) {
                    let first = tile * tile_rows;
                    let count = tile_rows.min(all_rows - first);
                    let positions = count * columns;
                    self.unfold(image, first, count, &mut unfolded[..window * positions]);
                    self.gather(gradient, first, count, &mut gathered[..outputs * positions]);
                    multiply_transposed(
                        &gathered[..outputs * positions],
                        &unfolded[..window * positions],
                        [outputs, window, positions],
                        &mut sum,
                    );
                }
                sum
            })
            .collect();
        let mut partial = partial.into_iter();
        let mut total = partial.next().expect("there is at least one part");
        for part in partial {
            for (sum, value) in total.iter_mut().zip(part) {
                *sum += value;
            }
        }
        total
    }

    /// Writes the windows of `count` output rows, counted over all samples from `first`, as
    /// `[window, count * columns]`.
    fn unfold(&self, image: &[f32], first: usize, count: usize, unfolded: &mut [f32]) {
        let [channels, height, width] = self.image;
        let [_, rows, columns] = self.output;
        let mut lines = unfolded.chunks_exact_mut(columns);
        for channel in 0..channels {
            for ky in 0..self.kernel {
                for kx in 0..self.kernel {
                    for (row, line) in (first..first + count).zip(&mut lines) {
                        let (sample, row) = (row / rows, row % rows);
                        let y = (row * self.stride + ky).wrapping_sub(self.padding);
                        if y >= height {
                            line.fill(0.0);
                            continue;
                        }
                        let start = ((sample * channels + channel) * height + y) * width;
                        self.unfold_line(&image[start..start + width], kx, line);
                    }
                }
            }
        }
    }

    /// One row of windows: `line[i] = source[i * stride + kx - padding]`, zero outside.
    fn unfold_line(&self, source: &[f32], kx: usize, line: &mut [f32]) {
        let Self {
            stride, padding, ..
        } = *self;
        // Positions whose source column lies inside the image.
        let begin = padding.saturating_sub(kx).div_ceil(stride).min(line.len());
        let end = (source.len() + padding)
            .saturating_sub(kx)
            .div_ceil(stride)
            .clamp(begin, line.len());
        line[..begin].fill(0.0);
        line[end..].fill(0.0);
        if begin == end {
            return;
        }
        let source = &source[begin * stride + kx - padding..];
        let line = &mut line[begin..end];
        if stride == 1 {
            line.copy_from_slice(&source[..line.len()]);
        } else {
            for (value, source) in line.iter_mut().zip(source.iter().step_by(stride)) {
                *value = *source;
            }
        }
    }

    /// Writes `count` output rows of all channels as `[out, count * columns]`.
    fn gather(&self, output: &[f32], first: usize, count: usize, gathered: &mut [f32]) {
        let [channels, rows, columns] = self.output;
        let mut lines = gathered.chunks_exact_mut(columns);
        for channel in 0..channels {
            for (row, line) in (first..first + count).zip(&mut lines) {
                let (sample, row) = (row / rows, row % rows);
                let start = ((sample * channels + channel) * rows + row) * columns;
                line.copy_from_slice(&output[start..start + columns]);
            }
        }
    }
}

/// `sum += left * right^T` for `left` `[m, k]`, `right` `[n, k]`, `sum` `[m, n]`.
fn multiply_transposed(left: &[f32], right: &[f32], [m, n, k]: [usize; 3], sum: &mut [f32]) {
    let left = ArrayView2::from_shape((m, k), left).expect("left is m x k");
    let right = ArrayView2::from_shape((n, k), right).expect("right is n x k");
    let mut sum = ArrayViewMut2::from_shape((m, n), sum).expect("sum is m x n");
    general_mat_mul(1.0, &left, &right.t(), 1.0, &mut sum);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_take_all_elements() {
        let values: Vec<f32> = (1..=21).map(|v| v as f32).collect();
        assert_eq!(sum(&values), 231.0);
        assert_eq!(sum(&[]), 0.0);
    }

    #[test]
    #[should_panic(expected = "m x k")]
    fn sides_that_do_not_fit_are_not_skipped() {
        multiply_transposed(&[1.0; 5], &[1.0; 6], [2, 2, 3], &mut [0.0; 4]);
    }
}
