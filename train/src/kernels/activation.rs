//! Activations and their gradients in one pass over memory each.

use burn::backend::Flex;
use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::NoCheckpointing;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::tensor::{Tensor, activation};
use rayon::prelude::*;
use rten_simd::{Isa, SimdOp};

use super::cpu::{
    Cpu, Tracked, cpu_tensor, dims, from_plain, from_tracked, is_f32, tracked, values,
};

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
    pub(super) fn value(self, x: f32) -> f32 {
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

/// Applies an activation: in one pass on the CPU backend, with burn's operations elsewhere.
pub(crate) fn activate(activation: Activation, input: Tensor<4>) -> Tensor<4> {
    on_cpu(activation, &input).unwrap_or_else(|| by_parts(activation, input))
}

/// The same in burn's own operations, for every backend.
pub(crate) fn by_parts(activation: Activation, input: Tensor<4>) -> Tensor<4> {
    match activation {
        // The exponential never sees a positive number: burn's own function has NaN gradients there.
        Activation::Elu => activation::relu(input.clone()) + (input.clamp_max(0.0).exp() - 1.0),
        Activation::LeakyRelu => activation::leaky_relu(input, f64::from(LEAK)),
    }
}

fn on_cpu(activation: Activation, input: &Tensor<4>) -> Option<Tensor<4>> {
    if input.is_autodiff() {
        let input = tracked(input)?;
        return is_f32(input.primitive())
            .then(|| from_tracked(tracked_activation(activation, input)));
    }
    let input = input.clone().try_into_primitive::<Flex>().ok()?;
    is_f32(&input).then(|| from_plain(activation_forward(activation, input)))
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
            let piece = Piece {
                activation,
                output,
                source,
            };
            piece.dispatch();
        });
    cpu_tensor(output, &shape)
}

/// Numbers and where they go through an activation.
struct Piece<'a> {
    activation: Activation,
    output: &'a mut [f32],
    source: &'a [f32],
}

impl SimdOp for Piece<'_> {
    type Output = ();

    #[inline(always)]
    fn eval<I: Isa>(self, _: I) {
        let pairs = self.output.iter_mut().zip(self.source);
        // One loop per function, each without a choice inside.
        match self.activation {
            Activation::Elu => pairs.for_each(|(output, &x)| *output = Activation::Elu.value(x)),
            Activation::LeakyRelu => {
                pairs.for_each(|(output, &x)| *output = Activation::LeakyRelu.value(x));
            }
        }
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
                    + r * (1.0 / 24.0 + r * (1.0 / 120.0 + r * (1.0 / 720.0 + seventh(r)))))));
    // The last bits of the rounded number are n; moved into the exponent they make 2^n.
    let power = f32::from_bits((rounded.to_bits() << 23).wrapping_add(127 << 23));
    series * power + (power - 1.0)
}

/// `r / 5040`, rounded as a division is, which takes longer than all the rest of the series (Markstein,
/// Computation of elementary functions on the IBM RISC System/6000 processor, IBM J. Res. Dev. 34, 1990).
#[inline(always)]
fn seventh(r: f32) -> f32 {
    const FACTORIAL: f32 = 5040.0;
    const RECIPROCAL: f32 = 1.0 / FACTORIAL;
    let quotient = r * RECIPROCAL;
    let rest = (-quotient).mul_add(FACTORIAL, r);
    rest.mul_add(RECIPROCAL, quotient)
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
        let gradient = gradients.consume::<Flex>(&ops.node);
        let Some(node) = node else { return };
        let found = activation_gradient(activation, gradient, &output);
        gradients.register::<Flex>(node.id, found);
    }
}

/// The gradient before an activation, from that after it and the activation's contiguous output. Takes
/// the place of `gradient` where nothing else holds that.
pub(super) fn activation_gradient(activation: Activation, gradient: Cpu, output: &Cpu) -> Cpu {
    let mut whole = gradient.to_contiguous();
    // The last other hold on the numbers, where there is none elsewhere.
    drop(gradient);
    let outputs = values(output);
    let gradients: &mut [f32] = whole.storage_mut();
    assert_eq!(gradients.len(), outputs.len(), "one gradient per output");
    gradients
        .par_chunks_mut(PIECE)
        .zip(outputs.par_chunks(PIECE))
        .for_each(|(gradient, output)| {
            let pieces = gradient.iter_mut().zip(output);
            match activation {
                Activation::Elu => pieces.for_each(|(gradient, &y)| {
                    *gradient *= Activation::Elu.slope(y);
                }),
                Activation::LeakyRelu => pieces.for_each(|(gradient, &y)| {
                    *gradient *= Activation::LeakyRelu.slope(y);
                }),
            }
        });
    whole
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
    fn a_division_by_another_way_has_the_same_bits() {
        let (first, last) = (1e-6_f32.to_bits(), 0.36_f32.to_bits());
        for bits in (first..last).step_by(97) {
            let r = f32::from_bits(bits);
            assert_eq!(seventh(r).to_bits(), (r / 5040.0).to_bits(), "{r}");
            assert_eq!(seventh(-r).to_bits(), (-r / 5040.0).to_bits(), "{r}");
        }
    }
}
