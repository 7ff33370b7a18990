//! Gradients of every layer shape the networks use, and optimisation steps end to end.

use burn::module::{Module, Param};
use burn::optim::{AdamConfig, GradientsParams};
use burn::tensor::{Device, Tensor, TensorData};
use strat_train::loss::sampler::sample_horizontal;
use strat_train::loss::{
    self, Weights, discriminator_adversarial, dssim, generator_adversarial, stereo_losses,
    synthesize,
};
use strat_train::network::discriminator::{
    ColourFactors, Discriminator, DiscriminatorConfig, Patches,
};
use strat_train::network::generator::{Decoder, GeneratorConfig, Head, Shortcut};
use strat_train::network::initial_weights::{self, InitialWeights, Parameter};
use strat_train::network::layers::{
    Convolution, InstanceNorm, Ops, TensorOps, TransposedConvolution, Width, elu, leaky_relu,
};

/// Numbers without a pattern, in -1..1, from a Weyl sequence.
fn numbers(count: usize, salt: f64) -> Vec<f32> {
    (0..count)
        .map(|i| {
            let x = ((i as f64 + 1.0) * 0.754_877_666 + salt * 0.569_840_291).fract();
            (2.0 * ((x * 7.31).fract()) - 1.0) as f32
        })
        .collect()
}

fn tensor(values: &[f32], shape: [usize; 4], device: &Device) -> Tensor<4> {
    Tensor::from_data(TensorData::new(values.to_vec(), shape), device)
}

fn floats<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.into_data().iter::<f32>().collect()
}

/// A fixed projection of a map, summed in f64 so that differences of it are meaningful.
fn project(map: Tensor<4>) -> f64 {
    let values = floats(map);
    let weights = numbers(values.len(), 3.0);
    values
        .iter()
        .zip(weights)
        .map(|(v, w)| f64::from(*v) * f64::from(w))
        .sum()
}

/// Compares the gradients of `function` at `inputs` with central differences of step `step`, to
/// 0.4 % of the largest.
fn check_gradients(
    name: &str,
    inputs: &[(Vec<f32>, [usize; 4])],
    step: f32,
    function: impl Fn(&[Tensor<4>]) -> Tensor<4>,
) {
    check_gradients_within(4e-3, name, inputs, step, function);
}

/// The same to the part `tolerance` of the largest gradient.
fn check_gradients_within(
    tolerance: f64,
    name: &str,
    inputs: &[(Vec<f32>, [usize; 4])],
    step: f32,
    function: impl Fn(&[Tensor<4>]) -> Tensor<4>,
) {
    let device = Device::flex().autodiff();
    let leaves: Vec<Tensor<4>> = inputs
        .iter()
        .map(|(values, shape)| tensor(values, *shape, &device).require_grad())
        .collect();
    let output = function(&leaves);
    let weights = numbers(output.shape().num_elements(), 3.0);
    let weights = tensor(&weights, output.dims(), &device);
    let gradients = (output * weights).sum().backward();

    let plain = Device::flex();
    let value = |inputs: &[(Vec<f32>, [usize; 4])]| {
        let tensors: Vec<Tensor<4>> = inputs
            .iter()
            .map(|(values, shape)| tensor(values, *shape, &plain))
            .collect();
        project(function(&tensors))
    };
    for (index, leaf) in leaves.iter().enumerate() {
        let found = floats(leaf.grad(&gradients).expect("a gradient"));
        let scale = found.iter().fold(1e-3_f32, |m, g| m.max(g.abs()));
        for (position, found) in found.iter().enumerate() {
            let mut moved = inputs.to_vec();
            moved[index].0[position] += step;
            let above = value(&moved);
            moved[index].0[position] = inputs[index].0[position] - step;
            let below = value(&moved);
            let expected = (above - below) / (2.0 * f64::from(step));
            assert!(
                (f64::from(*found) - expected).abs() < tolerance * f64::from(scale),
                "{name}: input {index}, position {position}: {found} instead of {expected}"
            );
        }
    }
}

fn param4(tensor: Tensor<4>) -> Param<Tensor<4>> {
    Param::initialized(burn::module::ParamId::new(), tensor)
}

fn param1(tensor: &Tensor<4>) -> Param<Tensor<1>> {
    let [_, channels, _, _] = tensor.dims();
    Param::initialized(
        burn::module::ParamId::new(),
        tensor.clone().reshape([channels]),
    )
}

/// All (kernel, stride, padding) the two networks use.
const CONVOLUTIONS: [(usize, usize, usize); 7] = [
    (1, 1, 0),
    (1, 2, 0),
    (3, 1, 1),
    (3, 2, 1),
    (7, 2, 3),
    (4, 2, 1),
    (4, 1, 1),
];

fn convolution(tensors: &[Tensor<4>], stride: usize, padding: usize) -> Tensor<4> {
    Convolution {
        weight: param4(tensors[1].clone()),
        bias: param1(&tensors[2]),
        stride,
        padding,
    }
    .forward(tensors[0].clone())
}

#[test]
fn convolutions_have_right_gradients() {
    for (kernel, stride, padding) in CONVOLUTIONS {
        let inputs = [
            (numbers(2 * 3 * 6 * 8, 0.0), [2, 3, 6, 8]),
            (
                numbers(4 * 3 * kernel * kernel, 1.0),
                [4, 3, kernel, kernel],
            ),
            (numbers(4, 2.0), [1, 4, 1, 1]),
        ];
        // Linear in each input, so a large step has no error of its own.
        let name = format!("convolution {kernel}x{kernel} stride {stride}");
        check_gradients(&name, &inputs, 0.5, |t| convolution(t, stride, padding));
    }
}

#[test]
fn convolutions_compute_the_defining_sum() {
    let device = Device::flex();
    let (batch, inputs, outputs) = (2, 5, 3);
    for (height, width) in [(8, 8), (6, 10), (16, 16)] {
        for (kernel, stride, padding) in CONVOLUTIONS {
            let x = numbers(batch * inputs * height * width, 0.0);
            let w = numbers(outputs * inputs * kernel * kernel, 1.0);
            let b = numbers(outputs, 2.0);
            let found = convolution(
                &[
                    tensor(&x, [batch, inputs, height, width], &device),
                    tensor(&w, [outputs, inputs, kernel, kernel], &device),
                    tensor(&b, [1, outputs, 1, 1], &device),
                ],
                stride,
                padding,
            );
            let rows = (height + 2 * padding - kernel) / stride + 1;
            let columns = (width + 2 * padding - kernel) / stride + 1;
            assert_eq!(found.dims(), [batch, outputs, rows, columns]);
            let found = floats(found);
            let mut index = 0;
            for n in 0..batch {
                for o in 0..outputs {
                    for row in 0..rows {
                        for column in 0..columns {
                            let mut sum = f64::from(b[o]);
                            for i in 0..inputs {
                                for ky in 0..kernel {
                                    for kx in 0..kernel {
                                        let y = (row * stride + ky).checked_sub(padding);
                                        let x_ = (column * stride + kx).checked_sub(padding);
                                        if let (Some(y), Some(x_)) = (y, x_)
                                            && y < height
                                            && x_ < width
                                        {
                                            let value =
                                                x[((n * inputs + i) * height + y) * width + x_];
                                            let weight =
                                                w[((o * inputs + i) * kernel + ky) * kernel + kx];
                                            sum += f64::from(value) * f64::from(weight);
                                        }
                                    }
                                }
                            }
                            let found = f64::from(found[index]);
                            assert!(
                                (found - sum).abs() < 1e-4,
                                "kernel {kernel} stride {stride}: {found} instead of {sum}"
                            );
                            index += 1;
                        }
                    }
                }
            }
        }
    }
}

#[test]
fn transposed_convolutions_have_right_values_and_gradients() {
    let layer = |t: &[Tensor<4>]| {
        TransposedConvolution {
            weight: param4(t[1].clone()),
            bias: param1(&t[2]),
        }
        .forward(t[0].clone())
    };
    let inputs = [
        (numbers(2 * 3 * 3 * 4, 0.0), [2, 3, 3, 4]),
        (numbers(3 * 2 * 4 * 4, 1.0), [3, 2, 4, 4]),
        (numbers(2, 2.0), [1, 2, 1, 1]),
    ];
    check_gradients("transposed convolution", &inputs, 0.5, layer);

    // Every input pixel (y, x) adds its weight (ky, kx) at (2 y + ky - 1, 2 x + kx - 1).
    let device = Device::flex();
    let tensors: Vec<_> = inputs.iter().map(|(v, s)| tensor(v, *s, &device)).collect();
    let found = layer(&tensors);
    assert_eq!(found.dims(), [2, 2, 6, 8]);
    let mut expected = vec![0.0_f64; 2 * 2 * 6 * 8];
    for n in 0..2 {
        for o in 0..2 {
            for cell in &mut expected[(n * 2 + o) * 48..(n * 2 + o + 1) * 48] {
                *cell = f64::from(inputs[2].0[o]);
            }
            for i in 0..3 {
                for (y, x) in (0..3).flat_map(|y| (0..4).map(move |x| (y, x))) {
                    for (ky, kx) in (0..4).flat_map(|ky| (0..4).map(move |kx| (ky, kx))) {
                        let (row, column) = (2 * y + ky, 2 * x + kx);
                        if (1..=6).contains(&row) && (1..=8).contains(&column) {
                            let value = inputs[0].0[((n * 3 + i) * 3 + y) * 4 + x];
                            let weight = inputs[1].0[((i * 2 + o) * 4 + ky) * 4 + kx];
                            expected[((n * 2 + o) * 6 + row - 1) * 8 + column - 1] +=
                                f64::from(value) * f64::from(weight);
                        }
                    }
                }
            }
        }
    }
    for (found, expected) in floats(found).iter().zip(expected) {
        assert!(
            (f64::from(*found) - expected).abs() < 1e-5,
            "{found} {expected}"
        );
    }
}

#[test]
fn element_wise_and_pooling_layers_have_right_gradients() {
    // Away from the kinks at zero by more than the step.
    let away: Vec<f32> = numbers(2 * 2 * 4 * 6, 0.0)
        .into_iter()
        .map(|v| v + 0.05 * v.signum())
        .collect();
    let input = [(away, [2, 2, 4, 6])];
    check_gradients("elu", &input, 1e-2, |t| elu(t[0].clone()));
    check_gradients("leaky relu", &input, 1e-2, |t| leaky_relu(t[0].clone()));
    check_gradients("upsample", &input, 0.5, |t| {
        TensorOps.upsample(t[0].clone())
    });
    // Distinct values, farther apart than the step.
    let distinct: Vec<f32> = (0..2 * 4 * 6)
        .map(|i| ((i * 29) % 48) as f32 * 0.1 - 2.05)
        .collect();
    let input = [(distinct, [1, 2, 4, 6])];
    check_gradients("max pool", &input, 0.02, |t| {
        TensorOps.max_pool(t[0].clone())
    });
}

#[test]
fn instance_norm_has_right_gradients() {
    let inputs = [
        (numbers(2 * 3 * 4 * 4, 0.0), [2, 3, 4, 4]),
        (numbers(3, 1.0), [1, 3, 1, 1]),
        (numbers(3, 2.0), [1, 3, 1, 1]),
    ];
    check_gradients("instance norm", &inputs, 1e-2, |t| {
        InstanceNorm {
            scale: param1(&t[1]),
            shift: param1(&t[2]),
        }
        .forward(t[0].clone())
    });
}

#[test]
fn the_sampler_has_right_gradients() {
    let (width, height) = (8, 3);
    // Displacements whose fraction stays between 0.2 and 0.8, some beyond the borders.
    let offset: Vec<f32> = numbers(2 * height * width, 5.0)
        .iter()
        .enumerate()
        .map(|(i, v)| (((i * 5) % 9) as f32 - 4.0 + 0.5 + 0.3 * v) / width as f32)
        .collect();
    let inputs = [
        (numbers(2 * 3 * height * width, 0.0), [2, 3, height, width]),
        (offset, [2, 1, height, width]),
    ];
    check_gradients("sampler", &inputs, 0.01, |t| {
        sample_horizontal(t[0].clone(), t[1].clone())
    });
}

#[test]
fn structural_dissimilarity_has_right_gradients() {
    let positive = |salt| {
        numbers(2 * 2 * 5 * 6, salt)
            .iter()
            .map(|v| 0.5 + 0.3 * v)
            .collect::<Vec<f32>>()
    };
    let shape = [2, 2, 5, 6];
    let inputs = [(positive(0.0), shape), (positive(1.0), shape)];
    check_gradients("dssim", &inputs, 2e-3, |t| {
        dssim(t[0].clone(), t[1].clone())
    });
}

fn sixteenth() -> Width {
    Width::new(1, 16).expect("a valid width")
}

/// A pair of pictures with two pixels of disparity.
fn pair(device: &Device) -> (Tensor<4>, Tensor<4>) {
    let (height, width) = (64, 128);
    let view = |shift: f64| {
        let mut values = Vec::new();
        for n in 0..2 {
            for c in 0..3 {
                for y in 0..height {
                    for x in 0..width {
                        let x = x as f64 + shift;
                        let y = y as f64;
                        let value = 0.5
                            + 0.25 * (0.21 * x + 0.13 * y + f64::from(c + n)).sin()
                            + 0.2 * (0.05 * x * f64::from(c + 1) - 0.31 * y).cos();
                        values.push(value as f32);
                    }
                }
            }
        }
        tensor(&values, [2, 3, height, width], device)
    };
    (view(0.0), view(2.0))
}

#[test]
fn ten_steps_lower_the_loss_of_a_fixed_batch() {
    let device = Device::flex().autodiff();
    for (decoder, head, weights) in [
        (Decoder::TransposedConv, Head::Relu, Weights::STRAT),
        (Decoder::NearestConv, Head::Sigmoid, Weights::MONODEPTH),
    ] {
        let config = GeneratorConfig {
            width: sixteenth(),
            decoder,
            head,
            shortcut: Shortcut::Always,
            bottleneck: true,
        };
        let mut generator = config.init(11, &device);
        let mut optimizer = AdamConfig::new().init();
        let (left, right) = pair(&device);
        let mut totals = Vec::new();
        for _ in 0..10 {
            let disparities = generator.forward(left.clone());
            let terms = stereo_losses(left.clone(), right.clone(), &disparities, &weights);
            totals.push(loss::scalar(&terms.total));
            let gradients = GradientsParams::from_grads(terms.total.backward(), &generator);
            generator = optimizer.step(1e-3, generator, gradients);
        }
        let (first, last) = (totals[0], totals[9]);
        assert!(last < 0.97 * first, "{totals:?}");
    }
}

#[test]
fn adversarial_steps_train_both_networks() {
    let device = Device::flex().autodiff();
    let generator = GeneratorConfig {
        width: sixteenth(),
        ..GeneratorConfig::default()
    }
    .init(11, &device);
    let mut critic: Discriminator = DiscriminatorConfig { width: sixteenth() }.init(12, &device);
    let mut optimizer = AdamConfig::new().init();
    let (left, right) = pair(&device);
    let patches = Patches {
        size: 64,
        rows: vec![0, 0],
        columns: vec![10, 40],
    };
    let plain = ColourFactors(vec![[1.0; 3]; 2]);

    // The discriminator learns to tell a fixed batch of fakes from the real images.
    let [disparity, ..] = generator.valid().forward(left.clone().inner());
    let (fake, _) = synthesize(left.clone().inner(), right.clone().inner(), disparity, 1.0);
    let fake = Tensor::from_inner(fake);
    let mut first = None;
    let mut last = f64::NAN;
    for step in 0..10 {
        let real = critic.forward_seeded(patches.cut(right.clone(), &plain), 2 * step);
        let faked = critic.forward_seeded(patches.cut(fake.clone(), &plain), 2 * step + 1);
        let loss = discriminator_adversarial(real, faked);
        last = loss::scalar(&loss);
        first.get_or_insert(last);
        let gradients = GradientsParams::from_grads(loss.backward(), &critic);
        critic = optimizer.step(2e-3, critic, gradients);
    }
    assert!(last < 0.9 * first.expect("ten steps"), "{first:?} {last}");

    // Its judgement reaches every layer of the generator, and a frozen copy keeps none for itself.
    let frozen = critic.clone().no_grad();
    let levels = generator.forward(left.clone());
    let (fake_right, fake_left) = synthesize(left, right, levels[0].clone(), 0.5);
    let fakes = patches.cut(fake_right, &plain) + patches.cut(fake_left, &plain);
    let loss = generator_adversarial(frozen.forward_seeded(fakes, 99));
    let gradients = loss.backward();
    for (name, layer) in generator.layers() {
        let weight = match layer {
            strat_train::network::generator::Layer::Convolution(l) => l.weight.val(),
            strat_train::network::generator::Layer::Transposed(l) => l.weight.val(),
        };
        let gradient = floats(weight.grad(&gradients).unwrap_or_else(|| panic!("{name}")));
        assert!(gradient.iter().any(|g| *g != 0.0), "{name}");
        assert!(gradient.iter().all(|g| g.is_finite()), "{name}");
    }
    assert!(frozen.last.weight.val().grad(&gradients).is_none());
}

#[test]
fn the_discriminator_has_right_gradients_with_respect_to_patches() {
    let device = Device::flex();
    let critic = DiscriminatorConfig { width: sixteenth() }.init(12, &device);
    let inputs = [(numbers(3 * 64 * 64, 0.0), [1, 3, 64, 64])];
    let tracked = tensor(&inputs[0].0, inputs[0].1, &device.clone().autodiff()).require_grad();
    let trained = critic.clone().train();
    let logits = trained.forward_seeded(tracked.clone(), 4);
    let gradients = logits.sum().backward();
    let found = floats(tracked.grad(&gradients).expect("a gradient"));
    // The directional derivative along the gradient is its squared length.
    let length: f64 = found.iter().map(|g| f64::from(*g).powi(2)).sum();
    let value = |step: f64| {
        let moved: Vec<f32> = inputs[0]
            .0
            .iter()
            .zip(&found)
            .map(|(v, g)| v + (step * f64::from(*g) / length.sqrt()) as f32)
            .collect();
        let logits = critic.forward_seeded(tensor(&moved, inputs[0].1, &device), 4);
        f64::from(floats(logits)[0])
    };
    let slope = (value(0.002) - value(-0.002)) / 0.004;
    assert!(
        (slope / length.sqrt() - 1.0).abs() < 0.05,
        "{slope} instead of {}",
        length.sqrt()
    );
}

/// Disparities of four scales without a kink nearby: samples fall between pixels (a fraction of 0.35
/// to 0.65), and those of the right view are so much larger than those of the left that their
/// difference keeps its sign where samples fade out at the borders.
fn disparities_between_pixels(height: usize, width: usize) -> Vec<(Vec<f32>, [usize; 4])> {
    (0..4)
        .map(|level| {
            let (h, w) = (height >> level, width >> level);
            let values = numbers(2 * h * w, 7.0 + level as f64);
            let disparity = |(i, v): (usize, &f32)| {
                let whole = if i < h * w { 0 } else { 5 + i * 7 % 2 };
                (whole as f32 + 0.5 + 0.15 * v) / w as f32
            };
            (
                values.iter().enumerate().map(disparity).collect(),
                [1, 2, h, w],
            )
        })
        .collect()
}

/// The stereo objective with these weights as a function of the four disparities.
fn check_objective(name: &str, weights: &Weights, step: f32) {
    let (height, width) = (24, 32);
    // The left view is so much brighter that it stays so where it fades out at the border: no
    // colour difference changes its sign.
    let view = |brightness: f32, salt| -> Vec<f32> {
        let values = numbers(3 * height * width, salt);
        values.iter().map(|v| brightness + 0.05 * v).collect()
    };
    let views = [view(0.8, 21.0), view(0.1, 22.0)];
    let inputs = disparities_between_pixels(height, width);
    // The objective is a single f32: its rounding is a visible part of a difference.
    check_gradients_within(1e-2, name, &inputs, step, |t| {
        let device = t[0].device();
        let shape = [1, 3, height, width];
        let [left, right] = views.each_ref().map(|v| tensor(v, shape, &device));
        let levels = std::array::from_fn(|level| t[level].clone());
        let terms = stereo_losses(left, right, &levels, weights);
        terms.total.reshape([1, 1, 1, 1])
    });
}

#[test]
fn left_right_consistency_and_photometric_terms_have_right_gradients() {
    let none = Weights {
        ssim: 0.0,
        l1: 0.0,
        left_right: 0.0,
        smoothness: 0.0,
        adversarial: 0.0,
    };
    // Both are linear between their kinks, which lie a third of a pixel of 1/32 away.
    let linear = 4e-3;
    let left_right = Weights {
        left_right: 1.0,
        ..none
    };
    check_objective("left-right", &left_right, linear);
    check_objective("l1", &Weights { l1: 1.0, ..none }, linear);
    check_objective("ssim", &Weights { ssim: 1.0, ..none }, 2e-3);
}

/// Along the gradient of every layer in turn, the objective rises as fast as the gradient is long.
#[test]
fn the_whole_objective_has_right_gradients_in_every_layer() {
    let plain = Device::flex();
    let config = GeneratorConfig {
        width: Width::new(1, 32).expect("a valid width"),
        ..GeneratorConfig::default()
    };
    let critic = DiscriminatorConfig { width: sixteenth() }.init(12, &plain);
    let patches = Patches {
        size: 64,
        rows: vec![0, 0],
        columns: vec![3, 40],
    };
    let plain_colours = ColourFactors(vec![[1.0; 3]; 2]);
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("weights.safetensors");
    let weights = Weights {
        // As much as the stereo terms, so that a wrong gradient of it shows.
        adversarial: 1.0,
        ..Weights::STRAT
    };
    let objective = |generator: &strat_train::network::generator::Generator,
                     critic: &Discriminator| {
        let device = generator.encoder.conv1.weight.val().device();
        let (left, right) = pair(&device);
        let levels = generator.forward(left.clone());
        let terms = stereo_losses(left.clone(), right.clone(), &levels, &weights);
        let (fake, _) = synthesize(left, right, levels[0].clone(), 0.7);
        let logits = critic.forward_seeded(patches.cut(fake, &plain_colours), 5);
        terms.total + generator_adversarial(logits) * weights.adversarial
    };

    let with = |parameters: &[Parameter], device: &Device| {
        initial_weights::write(parameters, None, &path).expect("written");
        let weights = InitialWeights::read(&path).expect("read");
        config.init_from(0, Some(&weights), device)
    };
    // Disparities of 5.5 and 4.5 pixels: samples between pixels, views that do not agree. At whole
    // pixels and at agreement the objective has kinks.
    let mut parameters = config.init(11, &plain).parameters();
    for parameter in &mut parameters {
        if parameter.name.starts_with("decoder.disp") && parameter.name.ends_with("bias") {
            parameter.values = vec![0.0431, 0.0352];
        }
    }
    let generator = with(&parameters, &Device::flex().autodiff());
    let still = critic.clone().train().no_grad();
    let gradients = objective(&generator, &still).backward();
    let value = |index: usize, direction: &[f32], step: f64| {
        let mut moved = parameters.clone();
        for (value, slope) in moved[index].values.iter_mut().zip(direction) {
            *value += (step * f64::from(*slope)) as f32;
        }
        f64::from(floats(objective(&with(&moved, &plain), &critic))[0])
    };
    for (number, (name, layer)) in generator.layers().into_iter().enumerate() {
        let weight = match layer {
            strat_train::network::generator::Layer::Convolution(l) => l.weight.val(),
            strat_train::network::generator::Layer::Transposed(l) => l.weight.val(),
        };
        let gradient = floats(weight.grad(&gradients).expect("a gradient"));
        let length = gradient
            .iter()
            .map(|g| f64::from(*g).powi(2))
            .sum::<f64>()
            .sqrt();
        // A change of the objective well above the rounding of its f32, below its curvature.
        let step = 5e-5 / length;
        let direction: Vec<f32> = gradient
            .iter()
            .map(|g| (f64::from(*g) / length) as f32)
            .collect();
        let index = 2 * number;
        assert_eq!(parameters[index].name, format!("{name}.weight"));
        let slope =
            (value(index, &direction, step) - value(index, &direction, -step)) / (2.0 * step);
        assert!(
            (slope / length - 1.0).abs() < 0.03,
            "{name}: {slope} instead of {length}"
        );
    }
}
