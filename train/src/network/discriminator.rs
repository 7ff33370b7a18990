//! The discriminator: a stack of strided convolutions that judges every part of a patch
//! (PROTOCOL 4.5, decision D12), and the patches it is shown.
//!
//! Five convolutions 4x4 with stride 2 and padding 1, each followed by instance normalisation,
//! leaky ReLU and dropout, then a 4x4 convolution with stride 1 to one channel of logits. A patch
//! of 256 gives a grid of 7x7. There is no sigmoid: the losses take logits.
//!
//! Not here: the adversarial losses, the training loop.

use burn::module::Module;
use burn::tensor::{Device, Tensor, TensorData};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::network::initial_weights::{InitialWeights, Parameter};
use crate::network::layers::{Convolution, Initializer, InstanceNorm, Width, unit_interval};

/// Everything that determines the shape of a [`Discriminator`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DiscriminatorConfig {
    /// Multiplier on the filter counts.
    pub width: Width,
}

/// Filters of the five strided convolutions at full width.
const FILTERS: [usize; 5] = [64, 128, 256, 512, 512];
const KERNEL: usize = 4;
const PADDING: usize = 1;
const DROPOUT: f64 = 0.2;

/// Name of the network that judges both views, or the left one.
pub const NETWORK: &str = "discriminator";
/// Name of the network that judges the right view, where each has its own.
pub const RIGHT_NETWORK: &str = "discriminator-right";
const LAST: &str = "discriminator.last";

/// Names of the convolution and the normalisation of a stage.
fn stage_names(index: usize) -> [String; 2] {
    ["conv", "norm"].map(|part| format!("discriminator.stages.{index}.{part}"))
}

/// Side of the patches of the thesis.
pub const PATCH: usize = 256;

/// Smallest side of a patch that leaves at least one cell.
pub const SMALLEST_PATCH: usize = 64;

impl DiscriminatorConfig {
    /// Builds the network with weights that are a function of `seed` and the layer names alone.
    pub fn init(&self, seed: u64, device: &Device) -> Discriminator {
        self.init_from(seed, None, NETWORK, device)
    }

    /// The same, with what initial weights hold for the network `network` in the place of the seed's.
    pub fn init_from(
        &self,
        seed: u64,
        initial: Option<&InitialWeights>,
        network: &str,
        device: &Device,
    ) -> Discriminator {
        let init = Initializer::new(seed, device).with_initial(initial, Some(network));
        let mut inputs = 3;
        let stages = FILTERS
            .iter()
            .enumerate()
            .map(|(index, &filters)| {
                let outputs = self.width.channels(filters);
                let [conv, norm] = stage_names(index);
                let channels = [inputs, outputs];
                let stage = Stage {
                    conv: Convolution::with_padding(&init, &conv, channels, KERNEL, 2, PADDING),
                    norm: InstanceNorm::new(&init, &norm, outputs),
                };
                inputs = outputs;
                stage
            })
            .collect();
        let last = Convolution::with_padding(&init, LAST, [inputs, 1], KERNEL, 1, PADDING);
        Discriminator { stages, last }
    }
}

/// The discriminator network.
#[derive(Module, Debug)]
pub struct Discriminator {
    /// Strided convolutions with normalisation.
    pub stages: Vec<Stage>,
    /// Convolution to logits.
    pub last: Convolution,
}

/// A strided convolution and its normalisation.
#[derive(Module, Debug)]
pub struct Stage {
    /// 4x4, stride 2.
    pub conv: Convolution,
    /// Per sample and channel.
    pub norm: InstanceNorm,
}

/// The operations of a discriminator, so that its topology is written once.
pub trait Layers {
    /// A feature map `[n, c, h, w]`, or whatever stands for one.
    type Value;

    /// Convolution with bias.
    fn conv(&mut self, name: &str, layer: &Convolution, input: Self::Value) -> Self::Value;
    /// Instance normalisation, leaky ReLU and, in training, dropout.
    fn norm_leaky(&mut self, name: &str, layer: &InstanceNorm, input: Self::Value) -> Self::Value;
}

/// [`Layers`] on burn tensors, with what gives the dropout mask for a map.
struct TensorLayers<F>(F);

impl<F: FnMut(&Tensor<4>) -> Option<Tensor<4>>> Layers for TensorLayers<F> {
    type Value = Tensor<4>;

    fn conv(&mut self, _: &str, layer: &Convolution, input: Tensor<4>) -> Tensor<4> {
        layer.forward(input)
    }

    fn norm_leaky(&mut self, _: &str, layer: &InstanceNorm, input: Tensor<4>) -> Tensor<4> {
        let mask = (self.0)(&input);
        layer.forward_leaky(input, mask)
    }
}

impl Discriminator {
    /// Logits for `patches`, `[n, 3, s, s]` with `s` at least [`SMALLEST_PATCH`]: `[n, 1, g, g]`.
    ///
    /// Dropout is active when `patches` live on an autodiff device, drawn from that device's own
    /// generator; [`Self::forward_seeded`] draws it from a seed instead.
    pub fn forward(&self, patches: Tensor<4>) -> Tensor<4> {
        if patches.is_autodiff() {
            self.run(patches, |map| {
                let keep = map.random_like(burn::tensor::Distribution::Bernoulli(1.0 - DROPOUT));
                Some(keep * (1.0 / (1.0 - DROPOUT)))
            })
        } else {
            self.run(patches, |_| None)
        }
    }

    /// Logits with dropout whose masks are a function of `seed` alone, the same on every device.
    pub fn forward_seeded(&self, patches: Tensor<4>, seed: u64) -> Tensor<4> {
        let mut stream = ChaCha8Rng::seed_from_u64(seed);
        self.run(patches, |map| {
            Some(dropout_mask(&mut stream, map.dims(), &map.device()))
        })
    }

    fn run(
        &self,
        patches: Tensor<4>,
        dropout: impl FnMut(&Tensor<4>) -> Option<Tensor<4>>,
    ) -> Tensor<4> {
        self.run_with(&mut TensorLayers(dropout), patches)
    }

    /// The topology, for whatever stands for feature maps.
    pub fn run_with<L: Layers>(&self, layers: &mut L, patches: L::Value) -> L::Value {
        let mut x = patches;
        for (index, stage) in self.stages.iter().enumerate() {
            let [conv, norm] = stage_names(index);
            let map = layers.conv(&conv, &stage.conv, x);
            x = layers.norm_leaky(&norm, &stage.norm, map);
        }
        layers.conv(LAST, &self.last, x)
    }

    /// Side of the grid of logits for patches of side `patch`; `None` when the patch is too small.
    pub fn grid(patch: usize) -> Option<usize> {
        let mut side = patch;
        for _ in FILTERS {
            side = (side + 2 * PADDING).checked_sub(KERNEL)? / 2 + 1;
        }
        (patch >= SMALLEST_PATCH).then(|| side + 2 * PADDING + 1 - KERNEL)
    }

    /// All weights, biases and affine values, as files hold them for the network `network`
    /// ([`NETWORK`] or [`RIGHT_NETWORK`]).
    pub fn parameters(&self, network: &str) -> Vec<Parameter> {
        let network = Some(network);
        let stages = self.stages.iter().enumerate();
        let mut parameters: Vec<Parameter> = stages
            .flat_map(|(index, stage)| {
                let [conv, norm] = stage_names(index);
                let conv = stage.conv.weights().parameters(network, &conv);
                conv.into_iter()
                    .chain(stage.norm.parameters(network, &norm))
            })
            .collect();
        parameters.extend(self.last.weights().parameters(network, LAST));
        parameters
    }

    /// Number of weights, biases and affine values.
    pub fn parameter_count(&self) -> usize {
        self.num_params()
    }
}

/// Zeros with probability 0.2, else 1 / 0.8. A byte decides each element.
fn dropout_mask(stream: &mut ChaCha8Rng, shape: [usize; 4], device: &Device) -> Tensor<4> {
    // 51 of 256 byte values would be 0.1992; two bytes give 0.2 to four digits.
    const DROPPED_BELOW: u16 = (DROPOUT * 65_536.0) as u16;
    const KEPT: f32 = (1.0 / (1.0 - DROPOUT)) as f32;
    /// Elements that are drawn at a time; two of them use a word of the stream.
    const PIECE: usize = 1 << 14;
    let mut values = vec![0.0_f32; shape.iter().product()];
    // The stream can be entered anywhere, so that threads draw what one would.
    let begin = stream.get_word_pos();
    let pieces = values.par_chunks_mut(PIECE).enumerate();
    pieces.for_each(|(number, values)| {
        let mut stream = stream.clone();
        stream.set_word_pos(begin + (number * PIECE / 2) as u128);
        let mut bytes = [0_u8; 2 * PIECE];
        let bytes = &mut bytes[..2 * values.len()];
        stream.fill_bytes(bytes);
        for (value, pair) in values.iter_mut().zip(bytes.as_chunks().0) {
            let dropped = u16::from_le_bytes(*pair) < DROPPED_BELOW;
            *value = if dropped { 0.0 } else { KEPT };
        }
    });
    stream.set_word_pos(begin + values.len().div_ceil(2) as u128);
    Tensor::from_data(TensorData::new(values, shape), device)
}

/// Where a batch of patches is cut out and how its colours are scaled (PROTOCOL 4.5).
#[derive(Clone, Debug, PartialEq)]
pub struct Patches {
    /// Side of the square patches.
    pub size: usize,
    /// First row, per sample.
    pub rows: Vec<usize>,
    /// First column, per sample.
    pub columns: Vec<usize>,
}

impl Patches {
    /// Draws one position per sample; images are `height` x `width`.
    ///
    /// The side is `size`, or the shorter side of the image where that is less.
    pub fn draw(
        stream: &mut ChaCha8Rng,
        samples: usize,
        [height, width]: [usize; 2],
        size: usize,
    ) -> Self {
        let size = size.min(height).min(width);
        let mut below =
            |bound: usize| ((unit_interval(stream) * bound as f64) as usize).min(bound - 1);
        let (rows, columns) = (0..samples)
            .map(|_| (below(height - size + 1), below(width - size + 1)))
            .unzip();
        Self {
            size,
            rows,
            columns,
        }
    }

    /// Cuts the patches out of `images`, `[n, 3, h, w]`, and multiplies every colour channel of
    /// every sample by its factor. Differentiable; nothing is clipped.
    pub fn cut(&self, images: Tensor<4>, factors: &ColourFactors) -> Tensor<4> {
        let patches: Vec<Tensor<4>> = self
            .rows
            .iter()
            .zip(&self.columns)
            .enumerate()
            .map(|(sample, (&row, &column))| {
                images.clone().slice([
                    sample..sample + 1,
                    0..3,
                    row..row + self.size,
                    column..column + self.size,
                ])
            })
            .collect();
        let patches = Tensor::cat(patches, 0);
        let factors = Tensor::<4>::from_data(
            TensorData::new(factors.0.concat(), [factors.0.len(), 3, 1, 1]),
            &patches.device(),
        );
        patches * factors
    }
}

/// One factor for every colour channel of every sample.
#[derive(Clone, Debug, PartialEq)]
pub struct ColourFactors(pub Vec<[f32; 3]>);

impl ColourFactors {
    /// Uniform in 0.8..1.2, independent per sample and channel.
    pub fn draw(stream: &mut ChaCha8Rng, samples: usize) -> Self {
        let mut factor = || (0.8 + 0.4 * unit_interval(stream)) as f32;
        Self(
            (0..samples)
                .map(|_| std::array::from_fn(|_| factor()))
                .collect(),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::network::layers::values_of;

    fn small(device: &Device) -> Discriminator {
        DiscriminatorConfig {
            width: Width::new(1, 16).expect("a valid width"),
        }
        .init(7, device)
    }

    /// PROTOCOL 4.5: weights and biases, and the affine part of the normalisation.
    #[test]
    fn the_full_network_has_the_documented_parameter_count() {
        let network = DiscriminatorConfig::default().init(0, &Device::flex());
        assert_eq!(network.parameter_count(), 6_959_553 + 2_944);
    }

    #[test]
    fn a_patch_of_256_gives_7_by_7() {
        let device = Device::flex();
        let network = small(&device);
        for (patch, grid) in [(64, 1), (128, 3), (256, 7)] {
            let logits = network.forward(Tensor::ones([1, 3, patch, patch], &device));
            assert_eq!(logits.dims(), [1, 1, grid, grid]);
            assert_eq!(Discriminator::grid(patch), Some(grid));
        }
        assert_eq!(Discriminator::grid(63), None);
        assert_eq!(Discriminator::grid(0), None);
    }

    #[test]
    fn dropout_follows_its_seed_and_is_off_without_autodiff() {
        let device = Device::flex();
        let network = small(&device);
        let patches = Tensor::<4>::random(
            [1, 3, 64, 64],
            burn::tensor::Distribution::Uniform(0.0, 1.0),
            &device,
        );
        let plain = values_of(network.forward(patches.clone()));
        assert_eq!(plain, values_of(network.forward(patches.clone())));
        let seeded = |seed| values_of(network.forward_seeded(patches.clone(), seed));
        assert_eq!(seeded(1), seeded(1));
        assert_ne!(seeded(1), seeded(2));
        assert_ne!(seeded(1), plain);
    }

    #[test]
    fn dropout_keeps_four_of_five_and_the_mean() {
        let mut stream = ChaCha8Rng::seed_from_u64(0);
        let mask = values_of(dropout_mask(&mut stream, [1, 4, 100, 100], &Device::flex()));
        assert!(mask.iter().all(|&v| v == 0.0 || v == 1.25));
        let kept = mask.iter().filter(|&&v| v > 0.0).count() as f64 / mask.len() as f64;
        assert!((kept - 0.8).abs() < 0.01, "{kept}");
    }

    #[test]
    fn masks_are_drawn_as_one_thread_would() {
        let mut stream = ChaCha8Rng::seed_from_u64(3);
        let mut single = stream.clone();
        // Twice, because the second begins where the first ends; an odd number ends within a word.
        for shape in [[1, 3, 101, 111], [2, 4, 100, 100]] {
            let mask = values_of(dropout_mask(&mut stream, shape, &Device::flex()));
            let mut bytes = vec![0_u8; 2 * mask.len()];
            single.fill_bytes(&mut bytes);
            for (value, pair) in mask.iter().zip(bytes.as_chunks().0) {
                assert_eq!(*value == 0.0, u16::from_le_bytes(*pair) < 13_107);
            }
        }
    }

    #[test]
    fn patches_are_cut_where_drawn_and_scaled_by_colour() {
        let device = Device::flex();
        let values: Vec<f32> = (0..2 * 3 * 2 * 4).map(|v| v as f32).collect();
        let images = Tensor::from_data(TensorData::new(values, [2, 3, 2, 4]), &device);
        let patches = Patches {
            size: 2,
            rows: vec![0, 0],
            columns: vec![1, 2],
        };
        let factors = ColourFactors(vec![[1.0, 2.0, 0.5], [1.0, 1.0, 1.0]]);
        let cut = patches.cut(images, &factors);
        assert_eq!(cut.dims(), [2, 3, 2, 2]);
        let expected = [
            1.0, 2.0, 5.0, 6.0, 18.0, 20.0, 26.0, 28.0, 8.5, 9.0, 10.5, 11.0, //
            26.0, 27.0, 30.0, 31.0, 34.0, 35.0, 38.0, 39.0, 42.0, 43.0, 46.0, 47.0,
        ];
        assert_eq!(values_of(cut), expected);
    }

    #[test]
    fn draws_stay_in_the_image_and_reach_both_ends() {
        let mut stream = ChaCha8Rng::seed_from_u64(1);
        let patches = Patches::draw(&mut stream, 2000, [256, 512], PATCH);
        assert_eq!(patches.size, 256);
        assert!(patches.rows.iter().all(|&row| row == 0));
        assert_eq!(patches.columns.iter().max(), Some(&256));
        assert_eq!(patches.columns.iter().min(), Some(&0));
        let small = Patches::draw(&mut stream, 2, [64, 128], PATCH);
        assert_eq!(small.size, 64);
        let factors = ColourFactors::draw(&mut stream, 1000).0.concat();
        assert!(factors.iter().all(|f| (0.8..=1.2).contains(f)));
        let mean = factors.iter().sum::<f32>() / factors.len() as f32;
        assert!((mean - 1.0).abs() < 0.01, "{mean}");
    }
}
