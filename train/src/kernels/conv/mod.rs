//! Convolutions and transposed convolutions with bias, a second image to add and an activation, and their
//! gradients: one operation of the graph each, computed by [`passes`].
//!
//! On other backends, and for other element types, burn's own operations take their place.

mod geometry;
mod passes;
mod phases;
mod pieces;
#[cfg(test)]
mod tests;
mod weights;
mod windows;

use burn::backend::Flex;
use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::NoCheckpointing;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::ops::{ConvOptions, ConvTransposeOptions};
use burn::tensor::{Tensor, module};
use rayon::prelude::*;

use super::activation::{Activation, activate, activation_gradient};
use super::cpu::{
    Cpu, Tracked, cpu_tensor, dims, from_plain, from_tracked, is_f32, plain, sum, tracked, values,
};
use geometry::Geometry;
use passes::Finish;

/// Which convolution, and what follows it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Convolving {
    pub stride: usize,
    pub padding: usize,
    /// From the small side to the large one.
    pub transposed: bool,
    pub activation: Option<Activation>,
}

impl Convolving {
    /// Of `input` `[n, in, h, w]` with `weight` `[out, in, k, k]` (`[in, out, k, k]` where it is
    /// transposed) and `bias` `[out]`; `added`, which a transposed one cannot have, has the shape of the
    /// result.
    pub fn apply(
        self,
        input: Tensor<4>,
        weight: Tensor<4>,
        bias: Tensor<1>,
        added: Option<Tensor<4>>,
    ) -> Tensor<4> {
        assert!(
            !(self.transposed && added.is_some()),
            "nothing can be added"
        );
        let on_cpu = match [&input, &weight].iter().any(|tensor| tensor.is_autodiff())
            || bias.is_autodiff()
            || added.as_ref().is_some_and(Tensor::is_autodiff)
        {
            true => self.on_cpu_tracked(&input, &weight, &bias, added.as_ref()),
            false => self.on_cpu(&input, &weight, &bias, added.as_ref()),
        };
        on_cpu.unwrap_or_else(|| self.by_parts(input, weight, bias, added))
    }

    /// The same in burn's own operations, for every backend.
    fn by_parts(
        self,
        input: Tensor<4>,
        weight: Tensor<4>,
        bias: Tensor<1>,
        added: Option<Tensor<4>>,
    ) -> Tensor<4> {
        let (stride, padding) = ([self.stride; 2], [self.padding; 2]);
        let mut output = if self.transposed {
            let options = ConvTransposeOptions::new(stride, padding, [0, 0], [1, 1], 1);
            module::conv_transpose2d(input, weight, Some(bias), options)
        } else {
            let options = ConvOptions::new(stride, padding, [1, 1], 1);
            module::conv2d(input, weight, Some(bias), options)
        };
        if let Some(added) = added {
            output = output + added;
        }
        match self.activation {
            Some(activation) => activate(activation, output),
            None => output,
        }
    }

    fn on_cpu(
        self,
        input: &Tensor<4>,
        weight: &Tensor<4>,
        bias: &Tensor<1>,
        added: Option<&Tensor<4>>,
    ) -> Option<Tensor<4>> {
        let added = match added {
            Some(added) => Some(plain(added)?),
            None => None,
        };
        let (input, weight, bias) = (plain(input)?, plain(weight)?, plain(bias)?);
        Some(from_plain(self.forward(
            &input,
            &weight,
            &bias,
            added.as_ref(),
        )))
    }

    fn on_cpu_tracked(
        self,
        input: &Tensor<4>,
        weight: &Tensor<4>,
        bias: &Tensor<1>,
        added: Option<&Tensor<4>>,
    ) -> Option<Tensor<4>> {
        let added = match added {
            Some(added) => Some(tracked(added)?),
            None => None,
        };
        let (input, weight, bias) = (tracked(input)?, tracked(weight)?, tracked(bias)?);
        let suits = [Some(&input), Some(&weight), Some(&bias), added.as_ref()]
            .iter()
            .flatten()
            .all(|tensor| is_f32(tensor.primitive()));
        suits.then(|| from_tracked(self.forward_tracked(input, weight, bias, added)))
    }

    fn geometry(self, input: [usize; 4], weight: [usize; 4]) -> Geometry {
        let [batch, input @ ..] = input;
        let [first, second, kernel, _] = weight;
        let Self {
            stride, padding, ..
        } = self;
        let [_, height, width] = input;
        let (large, small) = if self.transposed {
            let larger = |side: usize| (side.max(1) - 1) * stride + kernel - 2 * padding;
            ([second, larger(height), larger(width)], input)
        } else {
            let smaller = |side: usize| (side + 2 * padding - kernel) / stride + 1;
            (input, [first, smaller(height), smaller(width)])
        };
        Geometry {
            batch,
            large,
            small,
            kernel,
            stride,
            padding,
        }
    }

    /// All tensors contiguous.
    fn forward(self, input: &Cpu, weight: &Cpu, bias: &Cpu, added: Option<&Cpu>) -> Cpu {
        let geometry = self.geometry(dims(input), dims(weight));
        let finish = Finish {
            bias: Some(values(bias)),
            added: added.map(values),
            activation: self.activation,
        };
        let (output, [channels, height, width]) = if self.transposed {
            let output = geometry.scatter(values(input), values(weight), finish);
            (output, geometry.large)
        } else {
            let output = geometry.gather(values(input), values(weight), finish);
            (output, geometry.small)
        };
        cpu_tensor(output, &[geometry.batch, channels, height, width])
    }

    fn forward_tracked(
        self,
        input: Tracked,
        weight: Tracked,
        bias: Tracked,
        added: Option<Tracked>,
    ) -> Tracked {
        let (input, input_node) = input.into_parts();
        let (weight, weight_node) = weight.into_parts();
        let (bias, bias_node) = bias.into_parts();
        let (input, weight) = (input.to_contiguous(), weight.to_contiguous());
        let bias = bias.to_contiguous();
        match added {
            None => {
                let output = self.forward(&input, &weight, &bias, None);
                let state = self.state(input, weight, &output);
                match ConvGradient(self)
                    .prepare::<NoCheckpointing>([input_node, weight_node, bias_node])
                    .compute_bound()
                    .stateful()
                {
                    OpsKind::Tracked(prepared) => prepared.finish(state, output),
                    OpsKind::UnTracked(prepared) => prepared.finish(output),
                }
            }
            Some(added) => {
                let (added, added_node) = added.into_parts();
                let output = self.forward(&input, &weight, &bias, Some(&added.to_contiguous()));
                let state = self.state(input, weight, &output);
                match AddedConvGradient(self)
                    .prepare::<NoCheckpointing>([input_node, weight_node, bias_node, added_node])
                    .compute_bound()
                    .stateful()
                {
                    OpsKind::Tracked(prepared) => prepared.finish(state, output),
                    OpsKind::UnTracked(prepared) => prepared.finish(output),
                }
            }
        }
    }

    fn state(self, input: Cpu, weight: Cpu, output: &Cpu) -> State {
        State {
            input,
            weight,
            output: self.activation.map(|_| output.clone()),
        }
    }
}

/// What the gradients need.
#[derive(Clone, Debug)]
struct State {
    input: Cpu,
    weight: Cpu,
    /// Where an activation follows: its slope is known from its output.
    output: Option<Cpu>,
}

/// Gradients with respect to input, weight and bias as far as they are wanted, and before the activation.
fn backward(
    convolving: Convolving,
    state: State,
    gradient: Cpu,
    wanted: [bool; 3],
) -> ([Option<Cpu>; 3], Cpu) {
    let State {
        input,
        weight,
        output,
    } = state;
    let gradient = match (convolving.activation, output) {
        (Some(activation), Some(output)) => activation_gradient(activation, gradient, &output),
        _ => gradient.to_contiguous(),
    };
    let geometry = convolving.geometry(dims(&input), dims(&weight));
    let [of_input, of_weight, of_bias] = wanted;
    let of_bias = of_bias.then(|| bias_gradient(&gradient));
    let of_weight = of_weight.then(|| {
        let found = if convolving.transposed {
            geometry.weight_gradient(values(&gradient), values(&input))
        } else {
            geometry.weight_gradient(values(&input), values(&gradient))
        };
        cpu_tensor(found, &dims(&weight))
    });
    let of_input = of_input.then(|| {
        let (gradient, weight) = (values(&gradient), values(&weight));
        let found = if convolving.transposed {
            geometry.gather(gradient, weight, Finish::NOTHING)
        } else {
            geometry.scatter(gradient, weight, Finish::NOTHING)
        };
        cpu_tensor(found, &dims(&input))
    });
    ([of_input, of_weight, of_bias], gradient)
}

/// Hands the parents of a node their gradients: input, weight, bias, and where there is a fourth, what
/// was added.
fn register<const N: usize>(convolving: Convolving, ops: Ops<State, N>, gradients: &mut Gradients) {
    let gradient = gradients.consume::<Flex>(&ops.node);
    let wanted = [0, 1, 2].map(|parent: usize| ops.parents[parent].is_some());
    let (found, before) = backward(convolving, ops.state, gradient, wanted);
    let found = found.into_iter().chain([Some(before)]);
    for (node, found) in ops.parents.into_iter().zip(found) {
        if let (Some(node), Some(found)) = (node, found) {
            gradients.register::<Flex>(node.id, found);
        }
    }
}

/// Backward step of a convolution.
#[derive(Clone, Copy, Debug)]
struct ConvGradient(Convolving);

impl Backward<Flex, 3> for ConvGradient {
    type State = State;

    fn backward(self, ops: Ops<State, 3>, gradients: &mut Gradients, _: &mut Checkpointer) {
        register(self.0, ops, gradients);
    }
}

/// Backward step of a convolution to which something is added.
#[derive(Clone, Copy, Debug)]
struct AddedConvGradient(Convolving);

impl Backward<Flex, 4> for AddedConvGradient {
    type State = State;

    fn backward(self, ops: Ops<State, 4>, gradients: &mut Gradients, _: &mut Checkpointer) {
        register(self.0, ops, gradients);
    }
}

/// Sums over everything but channels.
fn bias_gradient(gradient: &Cpu) -> Cpu {
    let [batch, channels, height, width] = dims(gradient);
    let plane = height * width;
    let values = values(gradient);
    let sums: Vec<f32> = (0..channels)
        .into_par_iter()
        .map(|channel| {
            (0..batch)
                .map(|sample| {
                    let start = (sample * channels + channel) * plane;
                    sum([&values[start..start + plane]], |[value]| value)
                })
                .sum()
        })
        .collect();
    cpu_tensor(sums, &[channels])
}
