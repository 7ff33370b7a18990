//! Convolutions and transposed convolutions with bias, a second image to add and an activation, and their
//! gradients: one operation of the graph each, computed by [`passes`].
//!
//! On other backends, and for other element types, burn's own operations take their place.

mod geometry;
mod images;
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
use images::Images;
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
        self.apply_to(vec![input], weight, bias, added)
    }

    /// The same of several inputs whose channels follow each other.
    pub fn apply_to(
        self,
        mut inputs: Vec<Tensor<4>>,
        weight: Tensor<4>,
        bias: Tensor<1>,
        added: Option<Tensor<4>>,
    ) -> Tensor<4> {
        assert!(
            !(self.transposed && added.is_some()),
            "nothing can be added"
        );
        let [.., kernel] = weight.dims();
        let apart = !self.transposed && kernel > 1 && inputs.len() + added.iter().len() <= MOST;
        if inputs.len() > 1 && !apart {
            inputs = vec![Tensor::cat(inputs, 1)];
        }
        let in_graph = inputs.iter().chain([&weight]).any(Tensor::is_autodiff)
            || bias.is_autodiff()
            || added.as_ref().is_some_and(Tensor::is_autodiff);
        let tensors = (&inputs[..], &weight, &bias, added.as_ref());
        let on_cpu = if in_graph {
            let operands = Operands::of(tensors, tracked, tracked);
            let operands = operands.filter(|operands| operands.all(|t| is_f32(t.primitive())));
            operands.map(|operands| from_tracked(self.forward_tracked(operands)))
        } else {
            let operands = Operands::of(tensors, plain, plain);
            operands.map(|operands| from_plain(self.forward(&operands)))
        };
        on_cpu.unwrap_or_else(|| self.by_parts(Tensor::cat(inputs, 1), weight, bias, added))
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

    /// All operands contiguous.
    fn forward(self, operands: &Operands<Cpu>) -> Cpu {
        let Operands {
            inputs,
            weight,
            bias,
            added,
        } = operands;
        let geometry = self.geometry(together(inputs), dims(weight));
        let finish = Finish {
            bias: Some(values(bias)),
            added: added.as_ref().map(values),
            activation: self.activation,
        };
        let weight = values(weight);
        let (output, [channels, height, width]) = if self.transposed {
            let channels = [geometry.large[0]];
            let mut output = geometry.scatter(values(&inputs[0]), weight, finish, &channels);
            (output.swap_remove(0), geometry.large)
        } else {
            let output = geometry.gather(Images(&images(inputs)), weight, finish);
            (output, geometry.small)
        };
        cpu_tensor(output, &[geometry.batch, channels, height, width])
    }

    fn forward_tracked(self, operands: Operands<Tracked>) -> Tracked {
        let mut nodes = Vec::new();
        let operands = operands.map(|tensor| {
            let (tensor, node) = tensor.into_parts();
            nodes.push(node);
            tensor.to_contiguous()
        });
        let output = self.forward(&operands);
        let state = State {
            inputs: operands.inputs,
            weight: operands.weight,
            output: self.activation.map(|_| output.clone()),
        };
        // What a node is has no name outside burn, so that no function can take an array of them.
        macro_rules! with_parents {
            ($count:literal, $nodes:expr) => {
                match <[_; $count]>::try_from($nodes) {
                    Ok(parents) => {
                        let node = ConvGradient(self).prepare::<NoCheckpointing>(parents);
                        return match node.compute_bound().stateful() {
                            OpsKind::Tracked(prepared) => prepared.finish(state, output),
                            OpsKind::UnTracked(prepared) => prepared.finish(output),
                        };
                    }
                    Err(nodes) => nodes,
                }
            };
        }
        let nodes = with_parents!(3, nodes);
        let nodes = with_parents!(4, nodes);
        with_parents!(5, nodes);
        unreachable!("a convolution has one to {MOST} inputs, with what is added")
    }
}

/// Most inputs of a convolution, with what is added.
const MOST: usize = 3;

/// The tensors of a convolution, as they are computed with.
struct Operands<T> {
    inputs: Vec<T>,
    weight: T,
    bias: T,
    added: Option<T>,
}

impl<T> Operands<T> {
    /// `None` where one of the tensors cannot be had in this form.
    fn of(
        (inputs, weight, bias, added): (&[Tensor<4>], &Tensor<4>, &Tensor<1>, Option<&Tensor<4>>),
        large: fn(&Tensor<4>) -> Option<T>,
        small: fn(&Tensor<1>) -> Option<T>,
    ) -> Option<Self> {
        Some(Self {
            inputs: inputs.iter().map(large).collect::<Option<_>>()?,
            weight: large(weight)?,
            bias: small(bias)?,
            added: added.map_or(Some(None), |added| large(added).map(Some))?,
        })
    }

    fn all(&self, suits: impl Fn(&T) -> bool) -> bool {
        let others = [&self.weight, &self.bias];
        let all = self.inputs.iter().chain(others).chain(&self.added);
        all.into_iter().all(suits)
    }

    /// In the order of a node's parents.
    fn map<U>(self, mut to: impl FnMut(T) -> U) -> Operands<U> {
        Operands {
            inputs: self.inputs.into_iter().map(&mut to).collect(),
            weight: to(self.weight),
            bias: to(self.bias),
            added: self.added.map(to),
        }
    }
}

/// Shape of images whose channels follow each other.
fn together(images: &[Cpu]) -> [usize; 4] {
    let [batch, _, height, width] = dims(&images[0]);
    let channels = images.iter().map(|image| dims(image)[1]).sum();
    [batch, channels, height, width]
}

fn images(images: &[Cpu]) -> Vec<(&[f32], usize)> {
    let images = images.iter();
    images
        .map(|image| (values(image), dims(image)[1]))
        .collect()
}

/// What the gradients need.
#[derive(Clone, Debug)]
struct State {
    inputs: Vec<Cpu>,
    weight: Cpu,
    /// Where an activation follows: its slope is known from its output.
    output: Option<Cpu>,
}

/// Backward step of a convolution, whose parents are its inputs, weight, bias, and what is added.
#[derive(Clone, Copy, Debug)]
struct ConvGradient(Convolving);

impl<const N: usize> Backward<Flex, N> for ConvGradient {
    type State = State;

    fn backward(self, ops: Ops<State, N>, gradients: &mut Gradients, _: &mut Checkpointer) {
        let Self(convolving) = self;
        let gradient = gradients.consume::<Flex>(&ops.node);
        let State {
            inputs,
            weight,
            output,
        } = ops.state;
        let gradient = match (convolving.activation, output) {
            (Some(activation), Some(output)) => activation_gradient(activation, gradient, &output),
            _ => gradient.to_contiguous(),
        };
        let geometry = convolving.geometry(together(&inputs), dims(&weight));
        let (of_inputs, others) = ops.parents.split_at(inputs.len());
        let mut found = Vec::new();
        if let [_, of_bias @ Some(_), ..] = others {
            found.push((of_bias, bias_gradient(&gradient)));
        }
        if let [of_weight @ Some(_), ..] = others {
            let (outer, input) = ([(values(&gradient), dims(&gradient)[1])], images(&inputs));
            let sums = if convolving.transposed {
                geometry.weight_gradient(Images(&outer), values(&inputs[0]))
            } else {
                geometry.weight_gradient(Images(&input), values(&gradient))
            };
            found.push((of_weight, cpu_tensor(sums, &dims(&weight))));
        }
        if of_inputs.iter().any(Option::is_some) {
            let (outer, weight) = (values(&gradient), values(&weight));
            let of_images = if convolving.transposed {
                let outer = [(outer, dims(&gradient)[1])];
                vec![geometry.gather(Images(&outer), weight, Finish::NOTHING)]
            } else {
                let channels: Vec<usize> = inputs.iter().map(|input| dims(input)[1]).collect();
                geometry.scatter(outer, weight, Finish::NOTHING, &channels)
            };
            let of_images = of_images.into_iter().zip(&inputs);
            let of_images = of_images.map(|(found, input)| cpu_tensor(found, &dims(input)));
            found.extend(of_inputs.iter().zip(of_images));
        }
        if let [_, _, of_added] = others {
            found.push((of_added, gradient));
        }
        for (node, found) in found {
            if let Some(node) = node {
                gradients.register::<Flex>(node.id, found);
            }
        }
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
