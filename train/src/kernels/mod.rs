//! What the CPU backend computes slowly, written out.
//!
//! burn's CPU backend has no kernel for the weight gradient of a convolution: it runs a general
//! convolution whose kernel is as large as the image, ten times slower than need be where channels
//! are few and images large. It evaluates an activation, a sampling along rows or a structural
//! similarity, and their gradients, as many passes over memory. The operations here give the same
//! numbers through matrix products over unfolded tiles and single passes. On every other backend,
//! and for element types other than `f32`, burn's own operations are used instead: by the
//! convolutions here themselves, otherwise by the callers.
//!
//! Results do not depend on the number of threads: work is divided by shape alone and partial sums
//! are added in a fixed order.
//!
//! Not here: anything that is as fast in burn already, such as forward convolutions.

use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::NoCheckpointing;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::ops::{ConvOptions, ConvTransposeOptions, ModuleOps};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Flex};
use burn::tensor::{Tensor, TensorData, module};
use ndarray::linalg::general_mat_mul;
use ndarray::{ArrayView2, ArrayViewMut2};
use rayon::prelude::*;

/// A tensor of the CPU backend.
type Cpu = FloatTensor<Flex>;
/// A tensor of the CPU backend in a graph.
type Tracked = FloatTensor<Autodiff<Flex>>;

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

/// An activation function that is its own derivative's witness: the output tells the slope.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Activation {
    /// `x` for positive and `exp(x) - 1` for negative `x`.
    Elu,
    /// `x` for positive and `0.2 x` for negative `x`.
    LeakyRelu,
}

/// Slope of the leaky ReLU below zero.
pub(crate) const LEAK: f32 = 0.2;

impl Activation {
    #[inline(always)]
    fn value(self, x: f32) -> f32 {
        // Both sides are computed and added, so that the loop has no branch and NaN stays NaN.
        let (negative, positive) = if x < 0.0 { (x, 0.0) } else { (0.0, x) };
        match self {
            Self::Elu => positive + exp_minus_one(negative),
            Self::LeakyRelu => positive + LEAK * negative,
        }
    }

    #[inline(always)]
    fn slope(self, output: f32) -> f32 {
        match self {
            Self::Elu => 1.0 + if output < 0.0 { output } else { 0.0 },
            Self::LeakyRelu => {
                if output < 0.0 {
                    LEAK
                } else {
                    1.0
                }
            }
        }
    }
}

/// Applies an activation on the CPU backend; `None` elsewhere.
pub(crate) fn activate(activation: Activation, input: &Tensor<4>) -> Option<Tensor<4>> {
    if input.is_autodiff() {
        let input = tracked(input)?;
        return is_f32(input.primitive())
            .then(|| from_tracked(tracked_activation(activation, input)));
    }
    let input = input.clone().try_into_primitive::<Flex>().ok()?;
    is_f32(&input).then(|| from_plain(activation_forward(activation, input)))
}

fn is_f32(tensor: &Cpu) -> bool {
    tensor.dtype() == burn::tensor::DType::F32
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

fn tracked<const D: usize>(tensor: &Tensor<D>) -> Option<Tracked> {
    tensor
        .clone()
        .autodiff()
        .try_into_primitive::<Autodiff<Flex>>()
        .ok()
}

fn from_plain(tensor: Cpu) -> Tensor<4> {
    Tensor::from_primitive::<Flex>(tensor)
}

fn from_tracked(tensor: Tracked) -> Tensor<4> {
    Tensor::from_primitive::<Autodiff<Flex>>(tensor)
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

fn dims(tensor: &Cpu) -> [usize; 4] {
    let shape = tensor.layout().shape();
    [shape[0], shape[1], shape[2], shape[3]]
}

/// Elements of a contiguous tensor.
fn values(tensor: &Cpu) -> &[f32] {
    tensor.as_slice::<f32>().unwrap_or_default()
}

fn cpu_tensor(values: Vec<f32>, shape: &[usize]) -> Cpu {
    Cpu::from_data(TensorData::new(values, shape.to_vec()))
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
        let mut total = partial.next().unwrap_or_default();
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
    if let (Ok(left), Ok(right), Ok(mut sum)) = (
        ArrayView2::from_shape((m, k), left),
        ArrayView2::from_shape((n, k), right),
        ArrayViewMut2::from_shape((m, n), sum),
    ) {
        general_mat_mul(1.0, &left, &right.t(), 1.0, &mut sum);
    }
}

/// Elements that one thread works on at a time in element-wise passes.
const PIECE: usize = 1 << 15;

fn activation_forward(activation: Activation, input: Cpu) -> Cpu {
    let shape = dims(&input);
    let input = input.to_contiguous();
    let source = values(&input);
    let mut output = vec![0.0_f32; source.len()];
    output
        .par_chunks_mut(PIECE)
        .zip(source.par_chunks(PIECE))
        .for_each(|(output, source)| {
            // One loop per function, each without a choice inside.
            match activation {
                Activation::Elu => apply(output, source, |x| Activation::Elu.value(x)),
                Activation::LeakyRelu => apply(output, source, |x| Activation::LeakyRelu.value(x)),
            }
        });
    cpu_tensor(output, &shape)
}

#[inline(always)]
fn apply(output: &mut [f32], source: &[f32], function: impl Fn(f32) -> f32) {
    for (output, &source) in output.iter_mut().zip(source) {
        *output = function(source);
    }
}

/// `exp(x) - 1` for `x <= 0` to within one unit in the last place of 1, in steps a compiler can
/// turn into vector instructions. NaN stays NaN.
#[inline(always)]
fn exp_minus_one(x: f32) -> f32 {
    // x = n ln 2 + r with |r| <= ln 2 / 2. Adding and subtracting 1.5 * 2^23 rounds to an integer.
    const ROUND: f32 = 12_582_912.0;
    const LN2_HIGH: f32 = 0.693_359_4;
    const LN2_LOW: f32 = -2.121_944_4e-4;
    // Below -87 the result is -1 to all digits and 2^n would leave the range of exponents.
    let x = if x < -87.0 { -87.0 } else { x };
    let rounded = x * std::f32::consts::LOG2_E + ROUND;
    let n = rounded - ROUND;
    let r = (x - n * LN2_HIGH) - n * LN2_LOW;
    // Taylor series of exp(r) - 1; the remainder is below 1e-8.
    let series = r
        * (1.0
            + r * (0.5
                + r * (1.0 / 6.0
                    + r * (1.0 / 24.0 + r * (1.0 / 120.0 + r * (1.0 / 720.0 + r / 5040.0))))));
    // The last bits of the rounded number are n; moved into the exponent they make 2^n.
    let power = f32::from_bits((rounded.to_bits() << 23).wrapping_add(127 << 23));
    series * power + (power - 1.0)
}

/// Backward step of an activation.
#[derive(Debug)]
struct ActivationGradient;

impl Backward<Flex, 1> for ActivationGradient {
    type State = (Activation, Cpu);

    fn backward(
        self,
        ops: Ops<Self::State, 1>,
        gradients: &mut Gradients,
        _checkpointer: &mut Checkpointer,
    ) {
        let [node] = ops.parents;
        let (activation, output) = ops.state;
        let gradient = gradients.consume::<Flex>(&ops.node).to_contiguous();
        let Some(node) = node else { return };
        let mut found = vec![0.0_f32; values(&gradient).len()];
        found
            .par_chunks_mut(PIECE)
            .zip(values(&gradient).par_chunks(PIECE))
            .zip(values(&output).par_chunks(PIECE))
            .for_each(|((found, gradient), output)| {
                let pieces = found.iter_mut().zip(gradient).zip(output);
                match activation {
                    Activation::Elu => pieces.for_each(|((found, gradient), &y)| {
                        *found = gradient * Activation::Elu.slope(y);
                    }),
                    Activation::LeakyRelu => pieces.for_each(|((found, gradient), &y)| {
                        *found = gradient * Activation::LeakyRelu.slope(y);
                    }),
                }
            });
        gradients.register::<Flex>(node.id, cpu_tensor(found, &dims(&gradient)));
    }
}

fn tracked_activation(activation: Activation, input: Tracked) -> Tracked {
    let (input, node) = input.into_parts();
    let output = activation_forward(activation, input);
    match ActivationGradient
        .prepare::<NoCheckpointing>([node])
        .compute_bound()
        .stateful()
    {
        OpsKind::Tracked(prepared) => prepared.finish((activation, output.clone()), output),
        OpsKind::UnTracked(prepared) => prepared.finish(output),
    }
}

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

/// Structural dissimilarity of 3x3 windows on the CPU backend, `[n, c, h - 2, w - 2]`; `None`
/// elsewhere. See [`crate::loss::dssim`] for the definition.
pub(crate) fn dssim(x: &Tensor<4>, y: &Tensor<4>) -> Option<Tensor<4>> {
    if x.is_autodiff() || y.is_autodiff() {
        let (x, y) = (tracked(x)?, tracked(y)?);
        let suits = is_f32(x.primitive()) && is_f32(y.primitive());
        return suits.then(|| from_tracked(tracked_dssim(x, y)));
    }
    let x = x.clone().try_into_primitive::<Flex>().ok()?;
    let y = y.clone().try_into_primitive::<Flex>().ok()?;
    let suits = is_f32(&x) && is_f32(&y);
    suits.then(|| from_plain(similarity(&x.to_contiguous(), &y.to_contiguous())))
}

/// Windows are evaluated around half brightness: variances do not change, their rounding errors
/// shrink.
const MIDDLE: f32 = 0.5;

/// Statistics of one window of two images: means of the centred values, and the four factors of
/// S = A1 A2 / (B1 B2).
struct Window {
    centred_x: f32,
    centred_y: f32,
    /// 2 mu_x mu_y + C1 and mu_x^2 + mu_y^2 + C1.
    luminance: (f32, f32),
    /// 2 sigma_xy + C2 and sigma_x^2 + sigma_y^2 + C2.
    contrast: (f32, f32),
}

impl Window {
    /// From the sums of x, y, x^2, y^2 and xy over the window, centred.
    #[inline(always)]
    fn new(sums: [f32; 5]) -> Self {
        const C1: f32 = 0.01 * 0.01;
        const C2: f32 = 0.03 * 0.03;
        let [a, b, aa, bb, ab] = sums.map(|sum| sum * (1.0 / 9.0));
        let (x, y) = (a + MIDDLE, b + MIDDLE);
        Self {
            centred_x: a,
            centred_y: b,
            luminance: (2.0 * x * y + C1, x * x + y * y + C1),
            contrast: (2.0 * (ab - a * b) + C2, (aa - a * a) + (bb - b * b) + C2),
        }
    }

    #[inline(always)]
    fn similarity(&self) -> f32 {
        (self.luminance.0 * self.contrast.0) / (self.luminance.1 * self.contrast.1)
    }
}

/// Sums of x, y, x^2, y^2 and xy, centred, over the three rows of a row of windows, per column.
struct ColumnSums([Vec<f32>; 5]);

impl ColumnSums {
    fn new(width: usize) -> Self {
        Self(std::array::from_fn(|_| vec![0.0; width]))
    }

    /// Fills the sums for the windows whose first row is `row`.
    fn fill(&mut self, x: &[f32], y: &[f32], row: usize) {
        let [a, b, aa, bb, ab] = &mut self.0;
        let width = a.len();
        for sums in [&mut *a, &mut *b, &mut *aa, &mut *bb, &mut *ab] {
            sums.fill(0.0);
        }
        for line in row..row + 3 {
            let x = &x[line * width..(line + 1) * width];
            let y = &y[line * width..(line + 1) * width];
            for (sum, x) in a.iter_mut().zip(x) {
                *sum += x - MIDDLE;
            }
            for (sum, y) in b.iter_mut().zip(y) {
                *sum += y - MIDDLE;
            }
            for (sum, x) in aa.iter_mut().zip(x) {
                *sum += (x - MIDDLE) * (x - MIDDLE);
            }
            for (sum, y) in bb.iter_mut().zip(y) {
                *sum += (y - MIDDLE) * (y - MIDDLE);
            }
            for ((sum, x), y) in ab.iter_mut().zip(x).zip(y) {
                *sum += (x - MIDDLE) * (y - MIDDLE);
            }
        }
    }

    /// Calls `visit` with every window of the row and its column.
    #[inline(always)]
    fn windows(&self, mut visit: impl FnMut(usize, Window)) {
        let [a, b, aa, bb, ab] = &self.0;
        let columns = a.len() - 2;
        // Slices of one length let the compiler drop the bounds checks.
        let (a, b) = (&a[..columns + 2], &b[..columns + 2]);
        let (aa, bb, ab) = (&aa[..columns + 2], &bb[..columns + 2], &ab[..columns + 2]);
        for column in 0..columns {
            let sum = |values: &[f32]| values[column] + values[column + 1] + values[column + 2];
            visit(
                column,
                Window::new([sum(a), sum(b), sum(aa), sum(bb), sum(ab)]),
            );
        }
    }
}

fn similarity(x: &Cpu, y: &Cpu) -> Cpu {
    let [batch, channels, height, width] = dims(x);
    let (rows, columns) = (height - 2, width - 2);
    let plane = height * width;
    let mut output = vec![0.0_f32; batch * channels * rows * columns];
    output
        .par_chunks_mut((rows * columns).max(1))
        .zip(values(x).par_chunks(plane))
        .zip(values(y).par_chunks(plane))
        .for_each(|((output, x), y)| {
            let mut sums = ColumnSums::new(width);
            for (row, line) in output.chunks_exact_mut(columns.max(1)).enumerate() {
                sums.fill(x, y, row);
                sums.windows(|column, window| {
                    line[column] = ((1.0 - window.similarity()) * 0.5).clamp(0.0, 1.0);
                });
            }
        });
    cpu_tensor(output, &[batch, channels, rows, columns])
}

/// Gradient of the dissimilarity with respect to its first image.
///
/// With S = A1 A2 / (B1 B2) of [`Window`], a window's value depends on its pixels through the means
/// of x, of x^2 and of xy; each pixel collects the three derivatives of the windows it is in.
fn similarity_gradient(x: &Cpu, y: &Cpu, gradient: &Cpu) -> Cpu {
    let [_, _, height, width] = dims(x);
    let (rows, columns) = (height - 2, width - 2);
    let plane = height * width;
    let mut found = vec![0.0_f32; values(x).len()];
    found
        .par_chunks_mut(plane)
        .zip(values(x).par_chunks(plane))
        .zip(values(y).par_chunks(plane))
        .zip(values(gradient).par_chunks((rows * columns).max(1)))
        .for_each(|(((found, x), y), gradient)| {
            let mut sums = ColumnSums::new(width);
            // Derivatives by the means of x, x^2 and xy: of a row of windows, with two columns of
            // zeros on either side, and collected by pixel.
            let mut line: [Vec<f32>; 3] = std::array::from_fn(|_| vec![0.0; width + 2]);
            let mut collected: [Vec<f32>; 3] = std::array::from_fn(|_| vec![0.0; plane]);
            for row in 0..rows {
                sums.fill(x, y, row);
                let outer = &gradient[row * columns..(row + 1) * columns];
                let [by_mean, by_square, by_product] = &mut line;
                sums.windows(|column, window| {
                    let similarity = window.similarity();
                    let value = (1.0 - similarity) * 0.5;
                    let inside = (0.0..=1.0).contains(&value);
                    let outer = if inside { -0.5 * outer[column] } else { 0.0 };
                    let (a1, b1) = window.luminance;
                    let (a2, b2) = window.contrast;
                    let (a, b) = (window.centred_x, window.centred_y);
                    let both = 1.0 / (b1 * b2);
                    by_mean[column + 2] = outer
                        * (2.0 * both * ((b + MIDDLE) * a2 - b * a1)
                            + 2.0 * similarity * (a / b2 - (a + MIDDLE) / b1));
                    by_square[column + 2] = outer * -similarity / b2;
                    by_product[column + 2] = outer * 2.0 * a1 * both;
                });
                for (line, collected) in line.iter().zip(&mut collected) {
                    let parts = line[..width].iter().zip(&line[1..]).zip(&line[2..]);
                    let spread = &mut collected[row * width..(row + 3) * width];
                    let (first, rest) = spread.split_at_mut(width);
                    let (second, third) = rest.split_at_mut(width);
                    let pixels = first.iter_mut().zip(second).zip(third);
                    for (((first, second), third), ((a, b), c)) in pixels.zip(parts) {
                        let sum = a + b + c;
                        *first += sum;
                        *second += sum;
                        *third += sum;
                    }
                }
            }
            let [by_mean, by_square, by_product] = &collected;
            let derivatives = by_mean.iter().zip(by_square).zip(by_product);
            for ((found, (x, y)), ((mean, square), product)) in
                found.iter_mut().zip(x.iter().zip(y)).zip(derivatives)
            {
                *found =
                    (mean + 2.0 * (x - MIDDLE) * square + (y - MIDDLE) * product) * (1.0 / 9.0);
            }
        });
    cpu_tensor(found, &dims(x))
}

/// Backward step of the dissimilarity, which is symmetric in its two images.
#[derive(Debug)]
struct DssimGradient;

impl Backward<Flex, 2> for DssimGradient {
    type State = (Cpu, Cpu);

    fn backward(
        self,
        ops: Ops<Self::State, 2>,
        gradients: &mut Gradients,
        _checkpointer: &mut Checkpointer,
    ) {
        let [x_node, y_node] = ops.parents;
        let (x, y) = ops.state;
        let gradient = gradients.consume::<Flex>(&ops.node).to_contiguous();
        if let Some(node) = x_node {
            gradients.register::<Flex>(node.id, similarity_gradient(&x, &y, &gradient));
        }
        if let Some(node) = y_node {
            gradients.register::<Flex>(node.id, similarity_gradient(&y, &x, &gradient));
        }
    }
}

fn tracked_dssim(x: Tracked, y: Tracked) -> Tracked {
    let (x, x_node) = x.into_parts();
    let (y, y_node) = y.into_parts();
    let (x, y) = (x.to_contiguous(), y.to_contiguous());
    let output = similarity(&x, &y);
    match DssimGradient
        .prepare::<NoCheckpointing>([x_node, y_node])
        .compute_bound()
        .stateful()
    {
        OpsKind::Tracked(prepared) => prepared.finish((x, y), output),
        OpsKind::UnTracked(prepared) => prepared.finish(output),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exponentials_are_exact_to_a_unit_of_one() {
        for step in 0..200_000 {
            let x = -(step as f32) * 5e-4;
            let expected = f64::from(x).exp_m1();
            let found = f64::from(exp_minus_one(x));
            assert!((found - expected).abs() < 1.2e-7, "{x}: {found} {expected}");
        }
        assert_eq!(exp_minus_one(f32::NEG_INFINITY), -1.0);
        assert!(exp_minus_one(f32::NAN).is_nan());
        assert_eq!(exp_minus_one(0.0), 0.0);
        // Close to zero the relative error counts.
        let found = f64::from(exp_minus_one(-1e-4));
        assert!((found / (-1e-4_f64).exp_m1() - 1.0).abs() < 2e-7);
    }

    #[test]
    fn sums_take_all_elements() {
        let values: Vec<f32> = (1..=21).map(|v| v as f32).collect();
        assert_eq!(sum(&values), 231.0);
        assert_eq!(sum(&[]), 0.0);
    }
}
