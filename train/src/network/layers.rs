//! Layers of the two networks and the vocabulary the generator is written in.
//!
//! Definitions follow PROTOCOL 4.1: a convolution pads with (k - 1) / 2 zeros on every side, has a
//! bias and no normalisation; weights are Glorot uniform, biases zero. Every layer draws its
//! weights from its own ChaCha stream, chosen by the layer's name, so that two networks that share
//! a layer name and a seed share those weights whatever else differs between them.
//!
//! [`Ops`] is the list of operations a network topology may use. The topology is written once,
//! generic over it; [`TensorOps`] computes with burn tensors and the exporter implements the same
//! list with an ONNX graph, so that the exported graph cannot drift from the trained network.
//!
//! Not here: optimisation, losses, files.

use std::fmt;
use std::str::FromStr;

use burn::module::{Module, Param};
use burn::tensor::activation::{relu, sigmoid};
use burn::tensor::module::{interpolate, max_pool2d};
use burn::tensor::ops::{InterpolateMode, InterpolateOptions, MaxPoolOptions, PadMode};
use burn::tensor::{Device, Tensor, TensorData};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use serde::{Deserialize, Serialize};

use crate::kernels::activation::{Activation, activate};
use crate::kernels::conv::Convolving;
use crate::kernels::norm::normalise;
use crate::kernels::pool::largest_of_windows;
use crate::network::initial_weights::{InitialWeights, Parameter};

/// Multiplier on the number of channels of a network, as an exact fraction; `1` is full width.
///
/// Written as `"1"`, `"1/4"` in configuration files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(try_from = "WidthText", into = "String")]
pub struct Width {
    numerator: u32,
    denominator: u32,
}

/// A width as it may stand in a YAML file: a whole number or a text such as `1/4`.
#[derive(Deserialize)]
#[serde(untagged)]
enum WidthText {
    Whole(u32),
    Text(String),
}

/// A width multiplier that cannot be used.
#[derive(Debug, thiserror::Error)]
#[error(
    "the width multiplier {text:?} is not a positive fraction; write it as 1, 1/2, 1/4 or another fraction of at most 4"
)]
pub struct WidthError {
    text: String,
}

impl Width {
    /// The published width.
    pub const FULL: Self = Self {
        numerator: 1,
        denominator: 1,
    };

    /// `numerator / denominator`; neither may be zero and the fraction is at most 4.
    pub fn new(numerator: u32, denominator: u32) -> Result<Self, WidthError> {
        if numerator == 0
            || denominator == 0
            || u64::from(numerator) > 4 * u64::from(denominator)
            || denominator > 1024
        {
            return Err(WidthError {
                text: format!("{numerator}/{denominator}"),
            });
        }
        let divisor = greatest_common_divisor(numerator, denominator);
        Ok(Self {
            numerator: numerator / divisor,
            denominator: denominator / divisor,
        })
    }

    /// Number of channels a layer of `full` channels has at this width: rounded up, at least one.
    pub fn channels(self, full: usize) -> usize {
        (full * self.numerator as usize).div_ceil(self.denominator as usize)
    }
}

impl Default for Width {
    fn default() -> Self {
        Self::FULL
    }
}

impl fmt::Display for Width {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.denominator == 1 {
            write!(f, "{}", self.numerator)
        } else {
            write!(f, "{}/{}", self.numerator, self.denominator)
        }
    }
}

impl FromStr for Width {
    type Err = WidthError;

    fn from_str(text: &str) -> Result<Self, WidthError> {
        let (numerator, denominator) = text.split_once('/').unwrap_or((text, "1"));
        match (numerator.trim().parse(), denominator.trim().parse()) {
            (Ok(numerator), Ok(denominator)) => Self::new(numerator, denominator),
            _ => Err(WidthError {
                text: text.to_owned(),
            }),
        }
    }
}

impl TryFrom<WidthText> for Width {
    type Error = WidthError;

    fn try_from(text: WidthText) -> Result<Self, WidthError> {
        match text {
            WidthText::Whole(numerator) => Self::new(numerator, 1),
            WidthText::Text(text) => text.parse(),
        }
    }
}

impl From<Width> for String {
    fn from(width: Width) -> Self {
        width.to_string()
    }
}

fn greatest_common_divisor(a: u32, b: u32) -> u32 {
    if b == 0 {
        a
    } else {
        greatest_common_divisor(b, a % b)
    }
}

/// Source of initial weights: one seed, one independent stream for each layer name. Initial weights
/// take the place of what they hold.
#[derive(Clone, Debug)]
pub struct Initializer<'a> {
    seed: u64,
    device: &'a Device,
    initial: Option<Initial<'a>>,
}

/// Initial weights and the network that looks for its own in them.
#[derive(Clone, Copy, Debug)]
struct Initial<'a> {
    weights: &'a InitialWeights,
    /// Stands in the place of the first part of a layer's name; `None` leaves names as they are.
    network: Option<&'a str>,
}

impl<'a> Initializer<'a> {
    /// Weights for `device`, all derived from `seed`.
    pub fn new(seed: u64, device: &'a Device) -> Self {
        Self {
            seed,
            device,
            initial: None,
        }
    }

    /// The same with initial weights, in which the layers of a network named `network` are looked for
    /// (`discriminator-right.last` for the layer `discriminator.last`).
    #[must_use]
    pub fn with_initial(
        mut self,
        weights: Option<&'a InitialWeights>,
        network: Option<&'a str>,
    ) -> Self {
        self.initial = weights.map(|weights| Initial { weights, network });
        self
    }

    /// Values for the part `part` (weight, bias) of the layer `name`, if there are initial weights.
    fn given(&self, name: &str, part: &str, shape: &[usize]) -> Option<Vec<f32>> {
        let initial = self.initial?;
        let name = parameter_name(initial.network, name, part);
        initial.weights.values(&name, shape)
    }

    /// Uniform values in `-limit..limit` from the stream of `name`.
    fn uniform<const D: usize>(
        &self,
        name: &str,
        shape: [usize; D],
        limit: f64,
    ) -> Param<Tensor<D>> {
        let values = self.given(name, WEIGHT, &shape).unwrap_or_else(|| {
            let mut stream = ChaCha8Rng::seed_from_u64(self.seed);
            stream.set_stream(stream_of(name));
            (0..shape.iter().product())
                .map(|_| ((2.0 * unit_interval(&mut stream) - 1.0) * limit) as f32)
                .collect()
        });
        self.values(values, shape)
    }

    /// One value everywhere, for the part `part` of the layer `name`.
    fn full(&self, name: &str, part: &str, count: usize, value: f32) -> Param<Tensor<1>> {
        let values = self.given(name, part, &[count]);
        self.values(values.unwrap_or_else(|| vec![value; count]), [count])
    }

    /// The tensor exists from the start: a lazily filled parameter would lose its gradient flag
    /// when a clone is frozen before first use.
    fn values<const D: usize>(&self, values: Vec<f32>, shape: [usize; D]) -> Param<Tensor<D>> {
        Param::from_tensor(Tensor::from_data(
            TensorData::new(values, shape),
            self.device,
        ))
    }
}

/// A number in `0..1` with 24 random bits, the same on every platform.
pub(crate) fn unit_interval(stream: &mut ChaCha8Rng) -> f64 {
    f64::from(stream.next_u32() >> 8) / f64::from(1_u32 << 24)
}

/// FNV-1a of the layer name: stable across versions, which the standard hasher is not.
fn stream_of(name: &str) -> u64 {
    name.bytes().fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3)
    })
}

/// Parts of a layer as files name them.
const WEIGHT: &str = "weight";
const BIAS: &str = "bias";

/// The name under which files hold a part of a layer of the network `network`.
fn parameter_name(network: Option<&str>, layer: &str, part: &str) -> String {
    match (network, layer.split_once('.')) {
        (Some(network), Some((_, rest))) => format!("{network}.{rest}.{part}"),
        _ => format!("{layer}.{part}"),
    }
}

/// Weights of one layer in the order ONNX expects.
#[derive(Clone, Debug)]
pub struct LayerWeights {
    /// OIHW for a convolution, IOHW for a transposed convolution.
    pub weight_shape: [usize; 4],
    /// Row-major.
    pub weight: Vec<f32>,
    /// One value per output channel.
    pub bias: Vec<f32>,
}

impl LayerWeights {
    /// The two parts as files hold them, for a layer `name` of the network `network` (see
    /// [`Initializer::with_initial`]).
    pub(crate) fn parameters(self, network: Option<&str>, name: &str) -> [Parameter; 2] {
        [
            Parameter {
                name: parameter_name(network, name, WEIGHT),
                shape: self.weight_shape.to_vec(),
                values: self.weight,
            },
            Parameter {
                name: parameter_name(network, name, BIAS),
                shape: vec![self.bias.len()],
                values: self.bias,
            },
        ]
    }
}

/// Square convolution with zero padding of (k - 1) / 2, bias, no activation (PROTOCOL 4.1).
#[derive(Module, Debug)]
pub struct Convolution {
    /// `[out, in, k, k]`
    pub weight: Param<Tensor<4>>,
    /// `[out]`
    pub bias: Param<Tensor<1>>,
    /// Step in both directions.
    pub stride: usize,
    /// Zeros added on every side.
    pub padding: usize,
}

impl Convolution {
    /// `inputs` to `outputs` channels, odd kernel of `kernel` x `kernel`, named `name`.
    pub fn new(
        init: &Initializer,
        name: &str,
        [inputs, outputs]: [usize; 2],
        kernel: usize,
        stride: usize,
    ) -> Self {
        Self::with_padding(
            init,
            name,
            [inputs, outputs],
            kernel,
            stride,
            (kernel - 1) / 2,
        )
    }

    /// The same with an explicit padding, for even kernels.
    pub fn with_padding(
        init: &Initializer,
        name: &str,
        [inputs, outputs]: [usize; 2],
        kernel: usize,
        stride: usize,
        padding: usize,
    ) -> Self {
        let limit = glorot_limit(inputs, outputs, kernel);
        Self {
            weight: init.uniform(name, [outputs, inputs, kernel, kernel], limit),
            bias: init.full(name, BIAS, outputs, 0.0),
            stride,
            padding,
        }
    }

    /// Sets every bias to `value`, for heads that must not start at zero. `name` as in [`Self::new`].
    #[must_use]
    pub fn with_bias(mut self, init: &Initializer, name: &str, value: f32) -> Self {
        let [outputs] = self.bias.val().dims();
        self.bias = init.full(name, BIAS, outputs, value);
        self
    }

    /// `[n, in, h, w]` to `[n, out, (h + 2p - k) / s + 1, ...]`.
    pub fn forward(&self, input: Tensor<4>) -> Tensor<4> {
        self.apply(input, None, None)
    }

    /// The same, with something of the result's shape added and an activation applied.
    fn apply(
        &self,
        input: Tensor<4>,
        added: Option<Tensor<4>>,
        activation: Option<Activation>,
    ) -> Tensor<4> {
        let convolving = self.convolving(activation);
        convolving.apply(input, self.weight.val(), self.bias.val(), added)
    }

    fn convolving(&self, activation: Option<Activation>) -> Convolving {
        Convolving {
            stride: self.stride,
            padding: self.padding,
            transposed: false,
            activation,
        }
    }

    /// The weights as plain numbers, OIHW.
    pub fn weights(&self) -> LayerWeights {
        layer_weights(&self.weight, &self.bias)
    }
}

/// Transposed convolution 4x4, stride 2, padding 1: doubles height and width exactly
/// (PROTOCOL 4.1, the thesis' decoder).
#[derive(Module, Debug)]
pub struct TransposedConvolution {
    /// `[in, out, 4, 4]`
    pub weight: Param<Tensor<4>>,
    /// `[out]`
    pub bias: Param<Tensor<1>>,
}

impl TransposedConvolution {
    /// Kernel size.
    pub const KERNEL: usize = 4;
    /// Factor by which height and width grow.
    pub const STRIDE: usize = 2;
    /// Rows and columns removed on every side of the full result.
    pub const PADDING: usize = 1;

    /// `inputs` to `outputs` channels, named `name`.
    pub fn new(init: &Initializer, name: &str, [inputs, outputs]: [usize; 2]) -> Self {
        let limit = glorot_limit(inputs, outputs, Self::KERNEL);
        Self {
            weight: init.uniform(name, [inputs, outputs, Self::KERNEL, Self::KERNEL], limit),
            bias: init.full(name, BIAS, outputs, 0.0),
        }
    }

    /// `[n, in, h, w]` to `[n, out, 2h, 2w]`.
    pub fn forward(&self, input: Tensor<4>) -> Tensor<4> {
        self.apply(input, None)
    }

    fn apply(&self, input: Tensor<4>, activation: Option<Activation>) -> Tensor<4> {
        let convolving = Convolving {
            stride: Self::STRIDE,
            padding: Self::PADDING,
            transposed: true,
            activation,
        };
        convolving.apply(input, self.weight.val(), self.bias.val(), None)
    }

    /// The weights as plain numbers, IOHW.
    pub fn weights(&self) -> LayerWeights {
        layer_weights(&self.weight, &self.bias)
    }
}

/// Bound of the Glorot uniform distribution for a square kernel.
fn glorot_limit(inputs: usize, outputs: usize, kernel: usize) -> f64 {
    (6.0 / ((inputs + outputs) * kernel * kernel) as f64).sqrt()
}

fn layer_weights(weight: &Param<Tensor<4>>, bias: &Param<Tensor<1>>) -> LayerWeights {
    let weight = weight.val();
    LayerWeights {
        weight_shape: weight.dims(),
        weight: values_of(weight),
        bias: values_of(bias.val()),
    }
}

/// All values of a float tensor, row-major.
pub(crate) fn values_of<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.into_data().iter::<f32>().collect()
}

/// Instance normalisation with an affine part: every channel of every sample gets mean 0 and
/// variance 1 over its own pixels, epsilon 1e-5, no running statistics (PROTOCOL 4.5).
#[derive(Module, Debug)]
pub struct InstanceNorm {
    /// `[channels]`, starts at 1.
    pub scale: Param<Tensor<1>>,
    /// `[channels]`, starts at 0.
    pub shift: Param<Tensor<1>>,
}

impl InstanceNorm {
    /// Added to the variance.
    pub const EPSILON: f64 = 1e-5;

    /// Normalisation of `channels` channels, named `name`.
    pub fn new(init: &Initializer, name: &str, channels: usize) -> Self {
        Self {
            scale: init.full(name, WEIGHT, channels, 1.0),
            shift: init.full(name, BIAS, channels, 0.0),
        }
    }

    /// Scale and shift as files hold them (see [`Initializer::with_initial`]).
    pub(crate) fn parameters(&self, network: Option<&str>, name: &str) -> [Parameter; 2] {
        [(WEIGHT, &self.scale), (BIAS, &self.shift)].map(|(part, values)| {
            let values = values_of(values.val());
            Parameter {
                name: parameter_name(network, name, part),
                shape: vec![values.len()],
                values,
            }
        })
    }

    /// The same, then leaky ReLU, then the product with `mask` where there is one.
    pub(crate) fn forward_leaky(&self, input: Tensor<4>, mask: Option<Tensor<4>>) -> Tensor<4> {
        let affine = [self.scale.val(), self.shift.val()];
        let epsilon = Self::EPSILON as f32;
        let fused = normalise(&input, affine.each_ref(), mask.as_ref(), epsilon);
        fused.unwrap_or_else(|| self.forward_leaky_by_parts(input, mask))
    }

    /// The same in burn's own operations, for every backend.
    fn forward_leaky_by_parts(&self, input: Tensor<4>, mask: Option<Tensor<4>>) -> Tensor<4> {
        let output = leaky_relu(self.forward(input));
        match mask {
            Some(mask) => output * mask,
            None => output,
        }
    }

    /// `[n, c, h, w]`, shape unchanged. The variance is the biased one.
    pub fn forward(&self, input: Tensor<4>) -> Tensor<4> {
        let [batch, channels, height, width] = input.dims();
        let flat = input.reshape([batch, channels, height * width]);
        let centred = flat.clone() - flat.mean_dim(2);
        let variance = (centred.clone() * centred.clone()).mean_dim(2);
        let scale = self.scale.val().reshape([1, channels, 1]);
        let shift = self.shift.val().reshape([1, channels, 1]);
        let gain = (variance + Self::EPSILON).sqrt().recip() * scale;
        (centred * gain + shift).reshape([batch, channels, height, width])
    }
}

/// Exponential linear unit: `x` for positive and `exp(x) - 1` for negative `x`.
///
/// Not burn's own: its gradient is NaN for large positive `x`, where the exponential of the unused
/// branch overflows.
pub fn elu(input: Tensor<4>) -> Tensor<4> {
    activate(Activation::Elu, input)
}

/// `x` for positive and `0.2 x` for negative `x`.
pub fn leaky_relu(input: Tensor<4>) -> Tensor<4> {
    activate(Activation::LeakyRelu, input)
}

/// The operations a network topology may use.
///
/// Values are feature maps `[n, c, h, w]`. `name` is the layer's path in the network, for example
/// `encoder.conv2.0.conv1`.
pub trait Ops {
    /// A feature map, or whatever stands for one.
    type Value: Clone;

    /// Convolution with bias.
    fn conv(&mut self, name: &str, layer: &Convolution, input: Self::Value) -> Self::Value;
    /// Transposed convolution with bias.
    fn conv_transpose(
        &mut self,
        name: &str,
        layer: &TransposedConvolution,
        input: Self::Value,
    ) -> Self::Value;
    /// Convolution with bias, then ELU.
    fn conv_elu(&mut self, name: &str, layer: &Convolution, input: Self::Value) -> Self::Value {
        let result = self.conv(name, layer, input);
        self.elu(result)
    }
    /// Convolution with bias of several maps whose channels follow each other, then ELU.
    fn merge_elu(
        &mut self,
        name: &str,
        layer: &Convolution,
        inputs: Vec<Self::Value>,
    ) -> Self::Value {
        let merged = self.concat(inputs);
        self.conv_elu(name, layer, merged)
    }
    /// ELU of the sum of two branches: a convolution, and one that may be a convolution.
    fn join_elu(
        &mut self,
        (name, layer, input): (&str, &Convolution, Self::Value),
        (shortcut_name, shortcut, shortcut_input): (&str, Option<&Convolution>, Self::Value),
    ) -> Self::Value {
        let result = self.conv(name, layer, input);
        let shortcut = match shortcut {
            Some(layer) => self.conv(shortcut_name, layer, shortcut_input),
            None => shortcut_input,
        };
        let sum = self.add(result, shortcut);
        self.elu(sum)
    }
    /// Transposed convolution with bias, then ELU.
    fn conv_transpose_elu(
        &mut self,
        name: &str,
        layer: &TransposedConvolution,
        input: Self::Value,
    ) -> Self::Value {
        let result = self.conv_transpose(name, layer, input);
        self.elu(result)
    }
    /// Exponential linear unit.
    fn elu(&mut self, input: Self::Value) -> Self::Value;
    /// Rectified linear unit.
    fn relu(&mut self, input: Self::Value) -> Self::Value;
    /// Logistic function.
    fn sigmoid(&mut self, input: Self::Value) -> Self::Value;
    /// Product with a constant.
    fn scale(&mut self, input: Self::Value, factor: f32) -> Self::Value;
    /// Sum of two feature maps of one shape.
    fn add(&mut self, left: Self::Value, right: Self::Value) -> Self::Value;
    /// Concatenation of channels.
    fn concat(&mut self, inputs: Vec<Self::Value>) -> Self::Value;
    /// Largest of every 3x3 window, stride 2, on the map padded with one zero on every side.
    fn max_pool(&mut self, input: Self::Value) -> Self::Value;
    /// Twice the height and width, every pixel repeated.
    fn upsample(&mut self, input: Self::Value) -> Self::Value;
}

/// [`Ops`] on burn tensors.
#[derive(Clone, Copy, Debug, Default)]
pub struct TensorOps;

impl Ops for TensorOps {
    type Value = Tensor<4>;

    fn conv(&mut self, _name: &str, layer: &Convolution, input: Tensor<4>) -> Tensor<4> {
        layer.forward(input)
    }

    fn conv_transpose(
        &mut self,
        _name: &str,
        layer: &TransposedConvolution,
        input: Tensor<4>,
    ) -> Tensor<4> {
        layer.forward(input)
    }

    fn conv_elu(&mut self, _name: &str, layer: &Convolution, input: Tensor<4>) -> Tensor<4> {
        layer.apply(input, None, Some(Activation::Elu))
    }

    fn merge_elu(&mut self, _name: &str, layer: &Convolution, inputs: Vec<Tensor<4>>) -> Tensor<4> {
        let convolving = layer.convolving(Some(Activation::Elu));
        convolving.apply_to(inputs, layer.weight.val(), layer.bias.val(), None)
    }

    fn join_elu(
        &mut self,
        (_, layer, input): (&str, &Convolution, Tensor<4>),
        (_, shortcut, shortcut_input): (&str, Option<&Convolution>, Tensor<4>),
    ) -> Tensor<4> {
        let shortcut = match shortcut {
            Some(layer) => layer.forward(shortcut_input),
            None => shortcut_input,
        };
        layer.apply(input, Some(shortcut), Some(Activation::Elu))
    }

    fn conv_transpose_elu(
        &mut self,
        _name: &str,
        layer: &TransposedConvolution,
        input: Tensor<4>,
    ) -> Tensor<4> {
        layer.apply(input, Some(Activation::Elu))
    }

    fn elu(&mut self, input: Tensor<4>) -> Tensor<4> {
        elu(input)
    }

    fn relu(&mut self, input: Tensor<4>) -> Tensor<4> {
        relu(input)
    }

    fn sigmoid(&mut self, input: Tensor<4>) -> Tensor<4> {
        sigmoid(input)
    }

    fn scale(&mut self, input: Tensor<4>, factor: f32) -> Tensor<4> {
        input * factor
    }

    fn add(&mut self, left: Tensor<4>, right: Tensor<4>) -> Tensor<4> {
        left + right
    }

    fn concat(&mut self, inputs: Vec<Tensor<4>>) -> Tensor<4> {
        Tensor::cat(inputs, 1)
    }

    fn max_pool(&mut self, input: Tensor<4>) -> Tensor<4> {
        largest_of_windows(&input).unwrap_or_else(|| max_pool_by_parts(input))
    }

    fn upsample(&mut self, input: Tensor<4>) -> Tensor<4> {
        let [_, _, height, width] = input.dims();
        interpolate(
            input,
            InterpolateOptions::new(InterpolateMode::Nearest)
                .with_output_size([2 * height, 2 * width]),
        )
    }
}

/// [`Ops::max_pool`] in burn's own operations, for every backend.
fn max_pool_by_parts(input: Tensor<4>) -> Tensor<4> {
    // The reference pads with zeros before it pools; the pool's own padding would not count.
    // Of the even sizes that occur, the last padded row and column lie outside every window.
    let padded = input.pad([(1, 0), (1, 0)], PadMode::Constant(0.0));
    max_pool2d(padded, MaxPoolOptions::new([3, 3]).with_stride([2, 2]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::activation::by_parts;

    #[test]
    fn widths_are_exact_fractions_rounded_up() {
        let quarter: Width = "1/4".parse().expect("a fraction");
        assert_eq!(quarter, Width::new(2, 8).expect("a fraction"));
        assert_eq!(quarter.channels(64), 16);
        assert_eq!(quarter.channels(2), 1);
        assert_eq!(quarter.to_string(), "1/4");
        assert_eq!(Width::FULL.channels(512), 512);
        assert_eq!("1".parse::<Width>().expect("whole"), Width::FULL);
        for wrong in ["0", "1/0", "5", "-1", "half", "1/4/2", ""] {
            let error = wrong.parse::<Width>().expect_err("refused");
            assert!(error.to_string().contains("1/4"), "{error}");
        }
    }

    #[test]
    fn widths_are_read_from_numbers_and_texts() {
        let read = |text: &str| serde_yaml::from_str::<Width>(text).map(|w| w.to_string());
        assert_eq!(read("1").expect("whole"), "1");
        assert_eq!(read("'1/4'").expect("text"), "1/4");
        assert_eq!(read("1/4").expect("plain text"), "1/4");
        assert!(read("0.25").is_err());
        let width = Width::new(1, 8).expect("a fraction");
        let text = serde_yaml::to_string(&width).expect("written");
        assert_eq!(read(&text).expect("read back"), "1/8");
    }

    #[test]
    fn weights_depend_on_seed_and_name_alone() {
        let device = Device::flex();
        let layer = |seed, name: &str, channels| {
            let init = Initializer::new(seed, &device);
            Convolution::new(&init, name, channels, 3, 1).weights()
        };
        let a = layer(1, "a", [2, 3]);
        assert_eq!(a.weight_shape, [3, 2, 3, 3]);
        assert_eq!(a.weight, layer(1, "a", [2, 3]).weight);
        assert_ne!(a.weight, layer(1, "b", [2, 3]).weight);
        assert_ne!(a.weight, layer(2, "a", [2, 3]).weight);
        assert_eq!(a.bias, [0.0; 3]);
        // Pinned: other first numbers would mean that a seed no longer gives the same network.
        let first = [-0.351_534_25, 0.044_986_214, -0.040_715_575];
        assert_all_close(&a.weight[..3], &first, 1e-7);
        let limit = (6.0_f64 / (5.0 * 9.0)).sqrt();
        assert!(a.weight.iter().all(|w| f64::from(w.abs()) <= limit));
        let largest = a.weight.iter().fold(0.0_f32, |m, w| m.max(w.abs()));
        assert!(f64::from(largest) > 0.8 * limit);
    }

    /// Values and gradient of `function` at `inputs`.
    fn evaluate(inputs: &[f32], function: fn(Tensor<4>) -> Tensor<4>) -> (Vec<f32>, Vec<f32>) {
        let device = Device::flex().autodiff();
        let data = TensorData::new(inputs.to_vec(), [1, 1, 1, inputs.len()]);
        let x = Tensor::<4>::from_data(data, &device).require_grad();
        let y = function(x.clone());
        let gradients = y.clone().sum().backward();
        let gradient = x.grad(&gradients).expect("a gradient");
        (values_of(y.inner()), values_of(gradient))
    }

    fn assert_all_close(found: &[f32], expected: &[f32], tolerance: f32) {
        assert_eq!(found.len(), expected.len());
        for (found, expected) in found.iter().zip(expected) {
            assert!((found - expected).abs() <= tolerance, "{found} {expected}");
        }
    }

    fn elu_by_parts(x: Tensor<4>) -> Tensor<4> {
        by_parts(Activation::Elu, x)
    }

    fn leaky_relu_by_parts(x: Tensor<4>) -> Tensor<4> {
        by_parts(Activation::LeakyRelu, x)
    }

    #[test]
    fn elu_has_finite_gradients_everywhere() {
        let slope = (-1.0_f32).exp();
        for function in [elu, elu_by_parts] {
            let (values, gradient) = evaluate(&[-200.0, -1.0, 0.5, 200.0], function);
            assert_all_close(&values, &[-1.0, slope - 1.0, 0.5, 200.0], 1e-6);
            assert_all_close(&gradient, &[0.0, slope, 1.0, 1.0], 1e-6);
        }
        assert!(evaluate(&[f32::NAN], elu).0[0].is_nan());
    }

    #[test]
    fn activations_equal_those_of_burn() {
        let inputs: Vec<f32> = (-500..500).map(|i| i as f32 * 0.013 + 0.001).collect();
        let (values, gradient) = evaluate(&inputs, elu);
        let (expected, expected_gradient) = evaluate(&inputs, elu_by_parts);
        assert_all_close(&values, &expected, 3e-7);
        assert_all_close(&gradient, &expected_gradient, 3e-7);
        let (values, gradient) = evaluate(&inputs, leaky_relu);
        let (expected, expected_gradient) = evaluate(&inputs, leaky_relu_by_parts);
        assert_all_close(&values, &expected, 1e-7);
        assert_all_close(&gradient, &expected_gradient, 0.0);
    }

    #[test]
    fn pooling_pads_with_zeros_at_the_top_and_left() {
        let device = Device::flex();
        let values: Vec<f32> = (1..=16).map(|v| -(v as f32)).collect();
        let x = Tensor::<4>::from_data(TensorData::new(values, [1, 1, 4, 4]), &device);
        let y = TensorOps.max_pool(x);
        assert_eq!(y.dims(), [1, 1, 2, 2]);
        // -1 .. -16 row by row: only the window that starts inside the map has no zero in it.
        assert_eq!(values_of(y), [0.0, 0.0, 0.0, -6.0]);
    }

    #[test]
    fn pools_and_their_gradients_equal_those_of_burn() {
        let device = Device::flex().autodiff();
        for [height, width] in [[2, 2], [4, 6], [5, 7], [32, 70], [1, 4]] {
            let shape = [2, 3, height, width];
            let count = shape.iter().product::<usize>();
            // Few different numbers: many windows have their largest one twice. Half of them are negative.
            let mut inputs: Vec<f32> = (0..count)
                .map(|i| ((i * 7919 + i * i) % 13) as f32 - 6.0)
                .collect();
            inputs[count / 2] = f32::NAN;
            let evaluate = |pool: fn(Tensor<4>) -> Tensor<4>| {
                let data = TensorData::new(inputs.clone(), shape);
                let x = Tensor::<4>::from_data(data, &device).require_grad();
                let y = pool(x.clone());
                let factors = (0..y.shape().num_elements()).map(|i| (i % 11) as f32 - 4.5);
                let factors = TensorData::new(factors.collect::<Vec<f32>>(), y.dims());
                let loss = (y.clone() * Tensor::from_data(factors, &device)).sum();
                let gradient = x.grad(&loss.backward()).expect("a gradient");
                let bits = |values: Vec<f32>| values.into_iter().map(f32::to_bits);
                let plain = values_of(pool(x.inner()));
                (
                    bits(values_of(y.inner())).collect::<Vec<_>>(),
                    bits(plain).collect::<Vec<_>>(),
                    bits(values_of(gradient)).collect::<Vec<_>>(),
                )
            };
            if height > 1 {
                let found = evaluate(|x| TensorOps.max_pool(x));
                assert_eq!(found, evaluate(max_pool_by_parts), "{height}x{width}");
                assert_eq!(found.0, found.1);
            } else {
                let x = Tensor::<4>::zeros(shape, &device);
                assert!(largest_of_windows(&x).is_none());
            }
        }
    }

    #[test]
    fn upsampling_repeats_pixels() {
        let device = Device::flex();
        let x = Tensor::<4>::from_data([[[[1.0, 2.0], [3.0, 4.0]]]], &device);
        let y = TensorOps.upsample(x);
        assert_eq!(
            values_of(y),
            [
                1.0, 1.0, 2.0, 2.0, 1.0, 1.0, 2.0, 2.0, 3.0, 3.0, 4.0, 4.0, 3.0, 3.0, 4.0, 4.0
            ]
        );
    }

    #[test]
    fn the_fused_normalisation_equals_its_parts() {
        let plain = Device::flex();
        let random = |shape: [usize; 4]| {
            let range = burn::tensor::Distribution::Uniform(-1.0, 1.0);
            Tensor::<4>::random(shape, range, &plain)
        };
        for (shape, masked) in [
            ([2, 3, 5, 7], true),
            ([1, 2, 1, 1], true),
            ([3, 4, 8, 8], false),
        ] {
            let device = plain.clone().autodiff();
            let mut norm = InstanceNorm::new(&Initializer::new(0, &device), "norm", shape[1]);
            let affine = |offset: f64| (random([1, 1, 1, shape[1]]) + offset).reshape([shape[1]]);
            norm.scale = Param::from_tensor(affine(1.5).autodiff());
            norm.shift = Param::from_tensor(affine(0.1).autodiff());
            let (input, outer, mask) = (random(shape), random(shape), random(shape));
            let run = |function: fn(&InstanceNorm, Tensor<4>, Option<Tensor<4>>) -> Tensor<4>| {
                let input = input.clone().autodiff().require_grad();
                let mask = masked.then(|| mask.clone().autodiff());
                let output = function(&norm, input.clone(), mask);
                let gradients = (output.clone() * outer.clone().autodiff()).sum().backward();
                [
                    values_of(output.inner()),
                    values_of(input.grad(&gradients).expect("a gradient")),
                    values_of(norm.scale.val().grad(&gradients).expect("a gradient")),
                    values_of(norm.shift.val().grad(&gradients).expect("a gradient")),
                ]
            };
            let found = run(InstanceNorm::forward_leaky);
            let expected = run(InstanceNorm::forward_leaky_by_parts);
            for (found, expected) in found.iter().zip(&expected) {
                assert_all_close(found, expected, 2e-5);
            }
        }
    }

    #[test]
    fn instance_norm_gives_mean_zero_and_variance_one() {
        let device = Device::flex();
        let norm = InstanceNorm::new(&Initializer::new(0, &device), "norm", 2);
        let x = Tensor::<4>::from_data(
            [[[[1.0, 3.0], [1.0, 3.0]], [[10.0, 10.0], [10.0, 50.0]]]],
            &device,
        );
        // Channel 0: mean 2, variance 1. Channel 1: mean 20, variance 300.
        let expected = [
            -1.0, 1.0, -1.0, 1.0, -0.577_35, -0.577_35, -0.577_35, 1.732_05,
        ];
        for (value, expected) in values_of(norm.forward(x)).iter().zip(expected) {
            assert!((value - expected).abs() < 1e-4, "{value} {expected}");
        }
    }
}
