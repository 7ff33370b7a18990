//! The disparity network: ResNet-50 encoder, optional 1x1 bottleneck, decoder with skip
//! connections and four disparity heads (PROTOCOL 4.1, 4.2; decisions D9 and D10).
//!
//! The network predicts, from the left image alone, the disparity of the left and of the right
//! view as fractions of the image width, at full size and at a half, a quarter and an eighth of
//! it. The topology is written once in [`Generator::run`], generic over [`Ops`]; training and
//! export both go through it.
//!
//! Not here: losses, export to a file.

use burn::module::Module;
use burn::tensor::{Device, Tensor};
use serde::{Deserialize, Serialize};

use crate::network::initial_weights::{InitialWeights, Parameter};
use crate::network::layers::{
    Convolution, Initializer, LayerWeights, Ops, TensorOps, TransposedConvolution, Width,
};

/// How a decoder stage doubles its input.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Decoder {
    /// 4x4 transposed convolution, stride 2: the thesis.
    #[default]
    TransposedConv,
    /// Nearest neighbour, then a 3x3 convolution: monodepth.
    NearestConv,
}

/// What follows the last convolution of a disparity head.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Head {
    /// `max(x, 0)` with the bias starting at 0.03, a typical disparity: the thesis.
    #[default]
    Relu,
    /// `0.3 / (1 + exp(-x))`: monodepth.
    Sigmoid,
}

/// Which residual blocks have a 1x1 convolution on their shortcut.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Shortcut {
    /// All of them, as in the reference network.
    #[default]
    Always,
    /// Those that change the number of channels or the size.
    WhenNeeded,
}

/// Everything that determines the shape of a [`Generator`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GeneratorConfig {
    /// Multiplier on all channel counts except the three of the image and the two of a head.
    pub width: Width,
    /// How the decoder doubles its maps.
    pub decoder: Decoder,
    /// Non-linearity of the disparity.
    pub head: Head,
    /// Where shortcuts are projected.
    pub shortcut: Shortcut,
    /// Whether a 1x1 convolution to 512 channels follows the encoder.
    pub bottleneck: bool,
}

impl Default for GeneratorConfig {
    fn default() -> Self {
        Self {
            width: Width::FULL,
            decoder: Decoder::TransposedConv,
            head: Head::Relu,
            shortcut: Shortcut::Always,
            bottleneck: true,
        }
    }
}

/// Height and width of an input must be multiples of this.
pub const SIZE_MULTIPLE: usize = 64;

/// Number of scales at which disparity is predicted.
pub const SCALES: usize = 4;

/// Channels of the deepest residual block before expansion, and of the bottleneck.
const DEEPEST: usize = 512;

/// Bias at which a ReLU head starts: a typical disparity as a fraction of the width.
const RELU_BIAS: f32 = 0.03;
/// The same start for the sigmoid head: 0.3 / (1 + exp(-bias)) = 0.03. A zero bias would start at
/// half the largest disparity, ten times too near, and small runs would spend most of their steps on
/// leaving it.
const SIGMOID_BIAS: f32 = -2.197_224_6;

/// Largest disparity of a sigmoid head, as a fraction of the width.
const SIGMOID_LIMIT: f32 = 0.3;

/// Residual stages of the encoder: name, channels before expansion, number of blocks.
const STAGES: [(&str, usize, usize); 4] = [
    ("encoder.conv2", 64, 3),
    ("encoder.conv3", 128, 4),
    ("encoder.conv4", 256, 6),
    ("encoder.conv5", DEEPEST, 3),
];

/// Ratio of the channels a residual block returns to those it works on.
const EXPANSION: usize = 4;

/// Output channels of the decoder stages 6 to 1.
const DECODER_CHANNELS: [usize; 6] = [512, 256, 128, 64, 32, 16];

impl GeneratorConfig {
    /// Builds the network with weights that are a function of `seed` and the layer names alone.
    ///
    /// On an autodiff device the network is ready to be trained.
    pub fn init(&self, seed: u64, device: &Device) -> Generator {
        self.init_from(seed, None, device)
    }

    /// The same, with what initial weights hold in the place of the seed's.
    pub fn init_from(
        &self,
        seed: u64,
        initial: Option<&InitialWeights>,
        device: &Device,
    ) -> Generator {
        let init = Initializer::new(seed, device).with_initial(initial, None);
        let width = |channels| self.width.channels(channels);

        let mut inputs = width(64);
        let conv1 = Convolution::new(&init, "encoder.conv1", [3, inputs], 7, 2);
        let mut residuals = |(name, channels, blocks): (&str, usize, usize)| -> Vec<Residual> {
            (0..blocks)
                .map(|index| {
                    // A stage halves its map in the last block, not in the first.
                    let stride = if index + 1 == blocks { 2 } else { 1 };
                    let name = format!("{name}.{index}");
                    let channels = width(channels);
                    let block =
                        Residual::new(&init, &name, inputs, channels, stride, self.shortcut);
                    inputs = channels * EXPANSION;
                    block
                })
                .collect()
        };
        let [conv2, conv3, conv4, conv5] = STAGES.map(&mut residuals);

        let encoder = Encoder {
            conv1,
            conv2,
            conv3,
            conv4,
            conv5,
        };
        let bottleneck = self.bottleneck.then(|| {
            let outputs = width(DEEPEST);
            let layer = Convolution::new(&init, "bottleneck", [inputs, outputs], 1, 1);
            inputs = outputs;
            layer
        });

        // Channels of the skip connection of each decoder stage, and whether the stage also takes
        // the disparity of the scale below.
        let skips = [
            width(256) * EXPANSION,
            width(128) * EXPANSION,
            width(64) * EXPANSION,
            width(64),
            width(64),
            0,
        ];
        let mut stage = |number: usize| {
            let index = 6 - number;
            let outputs = width(DECODER_CHANNELS[index]);
            let disparity = if number <= 3 { 2 } else { 0 };
            let up_name = format!("decoder.up{number}");
            let up = match self.decoder {
                Decoder::TransposedConv => Up::Transposed(TransposedConvolution::new(
                    &init,
                    &up_name,
                    [inputs, outputs],
                )),
                Decoder::NearestConv => {
                    Up::Nearest(Convolution::new(&init, &up_name, [inputs, outputs], 3, 1))
                }
            };
            let merge = Convolution::new(
                &init,
                &format!("decoder.iconv{number}"),
                [outputs + skips[index] + disparity, outputs],
                3,
                1,
            );
            inputs = outputs;
            let head = (number <= SCALES).then(|| {
                let name = format!("decoder.disp{number}");
                let bias = match self.head {
                    Head::Relu => RELU_BIAS,
                    Head::Sigmoid => SIGMOID_BIAS,
                };
                Convolution::new(&init, &name, [outputs, 2], 3, 1).with_bias(&init, &name, bias)
            });
            DecoderStage { up, merge, head }
        };
        let decoder = (1..=6).rev().map(&mut stage).collect();

        Generator {
            encoder,
            bottleneck,
            decoder,
            head: self.head,
        }
    }
}

/// The disparity network.
#[derive(Module, Debug)]
pub struct Generator {
    /// Image to features at 1/64 of its size.
    pub encoder: Encoder,
    /// 1x1 convolution after the encoder.
    pub bottleneck: Option<Convolution>,
    /// Stages 6 (deepest) to 1 (full size).
    pub decoder: Vec<DecoderStage>,
    #[module(skip)]
    head: Head,
}

/// ResNet-50 without normalisation layers.
#[derive(Module, Debug)]
pub struct Encoder {
    /// 7x7, stride 2.
    pub conv1: Convolution,
    /// Three blocks, to 1/8 of the size.
    pub conv2: Vec<Residual>,
    /// Four blocks, to 1/16.
    pub conv3: Vec<Residual>,
    /// Six blocks, to 1/32.
    pub conv4: Vec<Residual>,
    /// Three blocks, to 1/64.
    pub conv5: Vec<Residual>,
}

/// Bottleneck residual block: 1x1, 3x3 (with the stride), 1x1 to four times the channels, plus the
/// shortcut, then ELU.
#[derive(Module, Debug)]
pub struct Residual {
    /// 1x1, ELU.
    pub conv1: Convolution,
    /// 3x3, ELU.
    pub conv2: Convolution,
    /// 1x1, linear.
    pub conv3: Convolution,
    /// 1x1, linear; none for an identity shortcut.
    pub shortcut: Option<Convolution>,
}

impl Residual {
    fn new(
        init: &Initializer,
        name: &str,
        inputs: usize,
        channels: usize,
        stride: usize,
        shortcut: Shortcut,
    ) -> Self {
        let outputs = channels * EXPANSION;
        let conv = |part: &str, channels, kernel, stride| {
            Convolution::new(init, &format!("{name}.{part}"), channels, kernel, stride)
        };
        let projected = match shortcut {
            Shortcut::Always => true,
            Shortcut::WhenNeeded => inputs != outputs || stride != 1,
        };
        Self {
            conv1: conv("conv1", [inputs, channels], 1, 1),
            conv2: conv("conv2", [channels, channels], 3, stride),
            conv3: conv("conv3", [channels, outputs], 1, 1),
            shortcut: projected.then(|| conv("shortcut", [inputs, outputs], 1, stride)),
        }
    }

    fn run<O: Ops>(&self, ops: &mut O, name: &str, input: O::Value) -> O::Value {
        let x = ops.conv_elu(&format!("{name}.conv1"), &self.conv1, input.clone());
        let x = ops.conv_elu(&format!("{name}.conv2"), &self.conv2, x);
        ops.join_elu(
            (&format!("{name}.conv3"), &self.conv3, x),
            (&format!("{name}.shortcut"), self.shortcut.as_ref(), input),
        )
    }
}

/// The doubling layer of a decoder stage.
#[derive(Module, Debug)]
pub enum Up {
    /// Transposed convolution.
    Transposed(TransposedConvolution),
    /// Nearest neighbour, then convolution.
    Nearest(Convolution),
}

/// One decoder stage: double, concatenate the skip connection and the coarser disparity, merge.
#[derive(Module, Debug)]
pub struct DecoderStage {
    /// Doubles height and width, ELU.
    pub up: Up,
    /// 3x3, ELU.
    pub merge: Convolution,
    /// 3x3 to two channels, on the last four stages.
    pub head: Option<Convolution>,
}

impl DecoderStage {
    /// Returns the stage's features and, where it has a head, its disparity.
    fn run<O: Ops>(
        &self,
        ops: &mut O,
        number: usize,
        non_linearity: Head,
        input: O::Value,
        skip: Option<O::Value>,
        coarser: Option<O::Value>,
    ) -> (O::Value, Option<O::Value>) {
        let name = format!("decoder.up{number}");
        let up = match &self.up {
            Up::Transposed(layer) => ops.conv_transpose_elu(&name, layer, input),
            Up::Nearest(layer) => {
                let doubled = ops.upsample(input);
                ops.conv_elu(&name, layer, doubled)
            }
        };
        let mut parts = vec![up];
        parts.extend(skip);
        if let Some(disparity) = coarser {
            parts.push(ops.upsample(disparity));
        }
        let merge_name = format!("decoder.iconv{number}");
        let features = if parts.len() == 1 {
            ops.conv_elu(&merge_name, &self.merge, parts.remove(0))
        } else {
            ops.merge_elu(&merge_name, &self.merge, parts)
        };
        let disparity = self.head.as_ref().map(|layer| {
            let raw = ops.conv(&format!("decoder.disp{number}"), layer, features.clone());
            match non_linearity {
                Head::Relu => ops.relu(raw),
                Head::Sigmoid => {
                    let unit = ops.sigmoid(raw);
                    ops.scale(unit, SIGMOID_LIMIT)
                }
            }
        });
        (features, disparity)
    }
}

/// A layer of a [`Generator`] with its name, for exporters and inspection.
#[derive(Clone, Copy, Debug)]
pub enum Layer<'a> {
    /// A convolution.
    Convolution(&'a Convolution),
    /// A transposed convolution.
    Transposed(&'a TransposedConvolution),
}

impl Layer<'_> {
    /// Weights in ONNX order: OIHW, or IOHW for a transposed convolution.
    pub fn weights(&self) -> LayerWeights {
        match self {
            Self::Convolution(layer) => layer.weights(),
            Self::Transposed(layer) => layer.weights(),
        }
    }
}

impl Generator {
    /// Disparities for `images`, `[n, 3, h, w]` RGB in 0..1 with `h` and `w` multiples of
    /// [`SIZE_MULTIPLE`].
    ///
    /// Level `s` is `[n, 2, h / 2^s, w / 2^s]`, channel 0 the left and channel 1 the right view's
    /// disparity, as fractions of the width.
    ///
    /// For evaluation call it on `valid()` with tensors without autodiff: a forward pass on an
    /// autodiff device that no backward pass follows keeps its memory.
    pub fn forward(&self, images: Tensor<4>) -> [Tensor<4>; SCALES] {
        self.run(&mut TensorOps, images)
    }

    /// The topology, in terms of `ops`. Level 0 first.
    pub fn run<O: Ops>(&self, ops: &mut O, image: O::Value) -> [O::Value; SCALES] {
        let skip1 = ops.conv_elu("encoder.conv1", &self.encoder.conv1, image);
        let skip2 = ops.max_pool(skip1.clone());
        let mut stage = |name: &str, blocks: &[Residual], input: O::Value| {
            let mut x = input;
            for (index, block) in blocks.iter().enumerate() {
                x = block.run(ops, &format!("{name}.{index}"), x);
            }
            x
        };
        let skip3 = stage(STAGES[0].0, &self.encoder.conv2, skip2.clone());
        let skip4 = stage(STAGES[1].0, &self.encoder.conv3, skip3.clone());
        let skip5 = stage(STAGES[2].0, &self.encoder.conv4, skip4.clone());
        let mut x = stage(STAGES[3].0, &self.encoder.conv5, skip5.clone());
        if let Some(layer) = &self.bottleneck {
            x = ops.conv_elu("bottleneck", layer, x);
        }

        let skips = [
            Some(skip5),
            Some(skip4),
            Some(skip3),
            Some(skip2),
            Some(skip1),
            None,
        ];
        let mut disparities: Vec<O::Value> = Vec::with_capacity(SCALES);
        for (index, (stage, skip)) in self.decoder.iter().zip(skips).enumerate() {
            let coarser = disparities.last().cloned();
            let (features, disparity) = stage.run(ops, 6 - index, self.head, x, skip, coarser);
            x = features;
            disparities.extend(disparity);
        }
        disparities.reverse();
        match disparities.try_into() {
            Ok(levels) => levels,
            Err(_) => unreachable!("`GeneratorConfig::init` gives a head to four stages"),
        }
    }

    /// All layers with their names, in the order they are applied.
    pub fn layers(&self) -> Vec<(String, Layer<'_>)> {
        let mut layers = vec![(
            "encoder.conv1".to_owned(),
            Layer::Convolution(&self.encoder.conv1),
        )];
        let encoder = &self.encoder;
        let stages = [
            &encoder.conv2,
            &encoder.conv3,
            &encoder.conv4,
            &encoder.conv5,
        ];
        for ((name, ..), blocks) in STAGES.iter().zip(stages) {
            for (index, block) in blocks.iter().enumerate() {
                let parts = [
                    ("conv1", Some(&block.conv1)),
                    ("conv2", Some(&block.conv2)),
                    ("conv3", Some(&block.conv3)),
                    ("shortcut", block.shortcut.as_ref()),
                ];
                for (part, layer) in parts {
                    layers.extend(
                        layer.map(|l| (format!("{name}.{index}.{part}"), Layer::Convolution(l))),
                    );
                }
            }
        }
        layers.extend(
            self.bottleneck
                .iter()
                .map(|l| ("bottleneck".to_owned(), Layer::Convolution(l))),
        );
        for (index, stage) in self.decoder.iter().enumerate() {
            let number = 6 - index;
            let up = match &stage.up {
                Up::Transposed(layer) => Layer::Transposed(layer),
                Up::Nearest(layer) => Layer::Convolution(layer),
            };
            layers.push((format!("decoder.up{number}"), up));
            layers.push((
                format!("decoder.iconv{number}"),
                Layer::Convolution(&stage.merge),
            ));
            layers.extend(
                stage
                    .head
                    .iter()
                    .map(|l| (format!("decoder.disp{number}"), Layer::Convolution(l))),
            );
        }
        layers
    }

    /// All weights and biases under the names of the exported model.
    pub fn parameters(&self) -> Vec<Parameter> {
        let layers = self.layers().into_iter();
        layers
            .flat_map(|(name, layer)| layer.weights().parameters(None, &name))
            .collect()
    }

    /// Number of weights and biases.
    pub fn parameter_count(&self) -> usize {
        self.num_params()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn small() -> GeneratorConfig {
        GeneratorConfig {
            width: Width::new(1, 16).expect("a valid width"),
            ..GeneratorConfig::default()
        }
    }

    /// PROTOCOL 4.1: the four counts of the full-width network.
    #[test]
    fn full_width_networks_have_the_documented_parameter_counts() {
        let thesis = GeneratorConfig::default();
        let monodepth = GeneratorConfig {
            decoder: Decoder::NearestConv,
            bottleneck: false,
            ..thesis
        };
        for (config, shortcut, expected) in [
            (monodepth, Shortcut::Always, 58_452_008),
            (monodepth, Shortcut::WhenNeeded, 49_466_152),
            (thesis, Shortcut::Always, 55_480_360),
            (thesis, Shortcut::WhenNeeded, 46_494_504),
        ] {
            let generator = GeneratorConfig { shortcut, ..config }.init(0, &Device::flex());
            assert_eq!(generator.parameter_count(), expected);
            let listed: usize = generator
                .layers()
                .iter()
                .map(|(_, layer)| match layer {
                    Layer::Convolution(l) => l.num_params(),
                    Layer::Transposed(l) => l.num_params(),
                })
                .sum();
            assert_eq!(listed, expected);
        }
    }

    #[test]
    fn four_scales_of_two_disparities_come_out() {
        let device = Device::flex();
        let generator = small().init(3, &device);
        let images = Tensor::ones([2, 3, 64, 128], &device);
        let levels = generator.forward(images);
        let dims: Vec<_> = levels.iter().map(Tensor::dims).collect();
        assert_eq!(
            dims,
            [
                [2, 2, 64, 128],
                [2, 2, 32, 64],
                [2, 2, 16, 32],
                [2, 2, 8, 16]
            ]
        );
    }

    #[test]
    fn heads_start_near_the_typical_disparity() {
        let device = Device::flex();
        let images = Tensor::zeros([1, 3, 64, 64], &device);
        // Without light all features are zero, so the coarsest output is its head's bias alone.
        let sigmoid = GeneratorConfig {
            head: Head::Sigmoid,
            ..small()
        };
        for config in [small(), sigmoid] {
            let [.., coarsest] = config.init(3, &device).forward(images.clone());
            let values = crate::network::layers::values_of(coarsest);
            let largest = values.iter().fold(0.0_f32, |m, v| m.max((v - 0.03).abs()));
            assert!(largest < 1e-6, "{:?}: off by {largest}", config.head);
        }
    }

    #[test]
    fn layers_are_listed_under_the_names_the_topology_uses() {
        #[derive(Default)]
        struct Names(Vec<String>);
        impl Ops for Names {
            type Value = ();
            fn conv(&mut self, name: &str, _: &Convolution, (): ()) {
                self.0.push(name.to_owned());
            }
            fn conv_transpose(&mut self, name: &str, _: &TransposedConvolution, (): ()) {
                self.0.push(name.to_owned());
            }
            fn elu(&mut self, (): ()) {}
            fn relu(&mut self, (): ()) {}
            fn sigmoid(&mut self, (): ()) {}
            fn scale(&mut self, (): (), _: f32) {}
            fn add(&mut self, (): (), (): ()) {}
            fn concat(&mut self, _: Vec<()>) {}
            fn max_pool(&mut self, (): ()) {}
            fn upsample(&mut self, (): ()) {}
        }
        for decoder in [Decoder::TransposedConv, Decoder::NearestConv] {
            for shortcut in [Shortcut::Always, Shortcut::WhenNeeded] {
                let config = GeneratorConfig {
                    decoder,
                    shortcut,
                    ..small()
                };
                let generator = config.init(0, &Device::flex());
                let mut names = Names::default();
                generator.run(&mut names, ());
                let listed: Vec<String> = generator.layers().into_iter().map(|l| l.0).collect();
                assert_eq!(names.0, listed);
                assert!(listed.contains(&"encoder.conv2.0.conv1".to_owned()));
            }
        }
    }

    #[test]
    fn a_seed_determines_the_network() {
        let device = Device::flex();
        let weights = |seed| {
            let generator = small().init(seed, &device);
            let layers = generator.layers();
            layers
                .iter()
                .map(|l| l.1.weights().weight)
                .collect::<Vec<_>>()
        };
        assert_eq!(weights(1), weights(1));
        assert_ne!(weights(1), weights(2));
    }

    #[test]
    fn configurations_survive_yaml() {
        let config = GeneratorConfig {
            decoder: Decoder::NearestConv,
            ..small()
        };
        let text = serde_yaml::to_string(&config).expect("written");
        assert!(text.contains("decoder: nearest-conv"), "{text}");
        let read: GeneratorConfig = serde_yaml::from_str(&text).expect("read");
        assert_eq!(read, config);
        assert!(serde_yaml::from_str::<GeneratorConfig>("depth: 3").is_err());
    }
}
