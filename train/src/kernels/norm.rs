//! Instance normalisation, leaky ReLU and dropout, and their gradients, in a few passes over each plane
//! while it lies in a cache. Each is defined in [`crate::network`].

use burn::backend::Flex;
use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::NoCheckpointing;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::tensor::Tensor;
use rayon::prelude::*;
use rten_simd::{Isa, SimdOp};

use super::activation::LEAK;
use super::cpu::{
    Cpu, Tracked, cpu_tensor, dims, from_plain, from_tracked, is_f32, plain, sum, tracked, values,
};

/// `leaky(normalised * scale + shift) * mask` on the CPU backend; `None` elsewhere.
///
/// `input` and `mask` are `[n, c, h, w]`, `scale` and `shift` `[c]`; a plane is normalised with its own
/// mean and its variance plus `epsilon`. No gradient reaches the mask.
pub(crate) fn normalise(
    input: &Tensor<4>,
    [scale, shift]: [&Tensor<1>; 2],
    mask: Option<&Tensor<4>>,
    epsilon: f32,
) -> Option<Tensor<4>> {
    let mask = match mask {
        Some(mask) => Some(plain(&mask.clone().inner())?),
        None => None,
    };
    if input.is_autodiff() || scale.is_autodiff() || shift.is_autodiff() {
        let (input, scale, shift) = (tracked(input)?, tracked(scale)?, tracked(shift)?);
        let suits = [&input, &scale, &shift]
            .iter()
            .all(|tensor| is_f32(tensor.primitive()));
        return suits.then(|| from_tracked(normalise_tracked(input, scale, shift, mask, epsilon)));
    }
    let (input, scale, shift) = (plain(input)?, plain(scale)?, plain(shift)?);
    let (output, _) = forward(&input, &scale, &shift, mask.as_ref(), epsilon);
    Some(from_plain(output))
}

/// Mean and reciprocal standard deviation of a plane.
type Moments = [f32; 2];

/// The result, and the moments of every plane.
fn forward(
    input: &Cpu,
    scale: &Cpu,
    shift: &Cpu,
    mask: Option<&Cpu>,
    epsilon: f32,
) -> (Cpu, Vec<Moments>) {
    let [batch, channels, height, width] = dims(input);
    let plane = height * width;
    let (scale, shift, mask) = (values(scale), values(shift), mask.map(values));
    let mut output = vec![0.0_f32; batch * channels * plane];
    let moments = output
        .par_chunks_mut(plane.max(1))
        .zip(values(input).par_chunks(plane.max(1)))
        .enumerate()
        .map(|(number, (output, input))| {
            let plane = Forward {
                input,
                output,
                affine: [scale[number % channels], shift[number % channels]],
                mask: mask.map(|mask| &mask[number * plane..(number + 1) * plane]),
                epsilon,
            };
            plane.dispatch()
        })
        .collect();
    (cpu_tensor(output, &dims(input)), moments)
}

/// The forward pass of a plane; its moments.
struct Forward<'a> {
    input: &'a [f32],
    output: &'a mut [f32],
    affine: [f32; 2],
    mask: Option<&'a [f32]>,
    epsilon: f32,
}

impl SimdOp for Forward<'_> {
    type Output = Moments;

    #[inline(always)]
    fn eval<I: Isa>(self, _: I) -> Moments {
        let Self {
            input,
            output,
            affine: [scale, shift],
            mask,
            epsilon,
        } = self;
        let count = input.len() as f32;
        let mean = sum([input], |[x]| x) / count;
        let variance = sum([input], |[x]| (x - mean) * (x - mean)) / count;
        let reciprocal = 1.0 / (variance + epsilon).sqrt();
        let gain = reciprocal * scale;
        for (output, x) in output.iter_mut().zip(input) {
            let normal = (x - mean) * gain + shift;
            *output = if normal < 0.0 { LEAK * normal } else { normal };
        }
        if let Some(mask) = mask {
            output
                .iter_mut()
                .zip(mask)
                .for_each(|(output, mask)| *output *= mask);
        }
        [mean, reciprocal]
    }
}

/// What the gradients need.
#[derive(Clone, Debug)]
struct State {
    input: Cpu,
    scale: Cpu,
    shift: Cpu,
    mask: Option<Cpu>,
    moments: Vec<Moments>,
}

fn normalise_tracked(
    input: Tracked,
    scale: Tracked,
    shift: Tracked,
    mask: Option<Cpu>,
    epsilon: f32,
) -> Tracked {
    let (input, input_node) = input.into_parts();
    let (scale, scale_node) = scale.into_parts();
    let (shift, shift_node) = shift.into_parts();
    let [input, scale, shift] = [input, scale, shift].map(|tensor| tensor.to_contiguous());
    let (output, moments) = forward(&input, &scale, &shift, mask.as_ref(), epsilon);
    match NormaliseGradient
        .prepare::<NoCheckpointing>([input_node, scale_node, shift_node])
        .compute_bound()
        .stateful()
    {
        OpsKind::Tracked(prepared) => {
            let state = State {
                input,
                scale,
                shift,
                mask,
                moments,
            };
            prepared.finish(state, output)
        }
        OpsKind::UnTracked(prepared) => prepared.finish(output),
    }
}

/// Backward step of the normalisation with what follows it.
#[derive(Debug)]
struct NormaliseGradient;

impl Backward<Flex, 3> for NormaliseGradient {
    type State = State;

    fn backward(
        self,
        ops: Ops<State, 3>,
        gradients: &mut Gradients,
        _checkpointer: &mut Checkpointer,
    ) {
        let [input_node, scale_node, shift_node] = ops.parents;
        let state = ops.state;
        let outer = gradients.consume::<Flex>(&ops.node);
        // The gradient takes the place of that of the result, where nothing else holds that.
        let mut found = outer.to_contiguous();
        drop(outer);
        let [_, channels, height, width] = dims(&state.input);
        let plane = height * width;
        let (scale, shift) = (values(&state.scale), values(&state.shift));
        let mask = state.mask.as_ref().map(values);
        let input = values(&state.input);
        let numbers: &mut [f32] = found.storage_mut();
        let sums: Vec<[f32; 2]> = numbers
            .par_chunks_mut(plane.max(1))
            .zip(input.par_chunks(plane.max(1)))
            .zip(&state.moments)
            .enumerate()
            .map(|(number, ((gradient, input), &moments))| {
                let plane = Reverse {
                    input,
                    gradient,
                    affine: [scale[number % channels], shift[number % channels]],
                    mask: mask.map(|mask| &mask[number * plane..(number + 1) * plane]),
                    moments,
                };
                plane.dispatch()
            })
            .collect();
        for (place, node) in [scale_node, shift_node].into_iter().enumerate() {
            let Some(node) = node else { continue };
            let mut of_channels = vec![0.0_f32; channels];
            for (number, sums) in sums.iter().enumerate() {
                of_channels[number % channels] += sums[place];
            }
            gradients.register::<Flex>(node.id, cpu_tensor(of_channels, &[channels]));
        }
        if let Some(node) = input_node {
            gradients.register::<Flex>(node.id, found);
        }
    }
}

/// Turns the gradient of the result into that of the input; returns the plane's part of the gradients
/// of scale and shift.
///
/// With z = (x - mean) / deviation and d the gradient before the leaky ReLU, the gradient of x is
/// scale / deviation * (d - mean of d - z * mean of d z).
struct Reverse<'a> {
    input: &'a [f32],
    gradient: &'a mut [f32],
    affine: [f32; 2],
    mask: Option<&'a [f32]>,
    moments: Moments,
}

impl SimdOp for Reverse<'_> {
    type Output = [f32; 2];

    #[inline(always)]
    fn eval<I: Isa>(self, _: I) -> [f32; 2] {
        let Self {
            input,
            gradient,
            affine: [scale, shift],
            mask,
            moments: [mean, reciprocal],
        } = self;
        if let Some(mask) = mask {
            gradient
                .iter_mut()
                .zip(mask)
                .for_each(|(gradient, mask)| *gradient *= mask);
        }
        // The same number as in the forward pass, whose sign decides.
        let gain = reciprocal * scale;
        for (gradient, x) in gradient.iter_mut().zip(input) {
            let negative = (x - mean) * gain + shift < 0.0;
            *gradient = if negative {
                LEAK * *gradient
            } else {
                *gradient
            };
        }
        let count = input.len() as f32;
        let total = sum([&*gradient], |[gradient]| gradient);
        let along = sum([&*gradient, input], |[gradient, x]| {
            gradient * ((x - mean) * reciprocal)
        });
        let (mean_total, mean_along) = (total / count, along / count);
        for (gradient, x) in gradient.iter_mut().zip(input) {
            let z = (x - mean) * reciprocal;
            *gradient = gain * (*gradient - mean_total - z * mean_along);
        }
        [along, total]
    }
}
