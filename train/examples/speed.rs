//! Times the layers that dominate a training step on the CPU, and whole steps.
//!
//! `cargo run -p strat-train --example speed [-- steps]`. Prints the best of several runs in
//! milliseconds: forward, and forward with backward. Measure on a quiet machine.
//! `speed one WIDTH COLUMNS ROWS BATCH STEPS` times one kind of step, `speed forward ...` the generator
//! alone; `tests/peers/train_step.py` sets them beside the same in PyTorch.
#![allow(clippy::print_stdout, reason = "printing is what this program is for")]

use std::time::Instant;

use burn::module::Module;
use burn::optim::GradientsParams;
use burn::tensor::{Device, Distribution, Tensor};
use strat_train::loss::sampler::sample_horizontal;
use strat_train::loss::{
    Weights, discriminator_adversarial, dssim, generator_adversarial, stereo_losses, synthesize,
};
use strat_train::network::discriminator::{ColourFactors, DiscriminatorConfig, Patches};
use strat_train::network::generator::GeneratorConfig;
use strat_train::network::layers::{
    Convolution, Initializer, InstanceNorm, Ops, TensorOps, TransposedConvolution, Width, elu,
};
use strat_train::training::awake::keep_awake;
use strat_train::training::trainer::adam;

/// As `train` does.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

const RUNS: usize = 4;

fn best(mut work: impl FnMut()) -> f64 {
    (0..RUNS)
        .map(|_| {
            let start = Instant::now();
            work();
            start.elapsed().as_secs_f64() * 1e3
        })
        .fold(f64::INFINITY, f64::min)
}

fn noise(shape: [usize; 4], device: &Device) -> Tensor<4> {
    Tensor::random(shape, Distribution::Uniform(0.0, 1.0), device)
}

/// Forward without autodiff, then forward and backward with it.
fn layer(name: &str, shape: [usize; 4], forward: impl Fn(&Device, Tensor<4>) -> Tensor<4>) {
    let plain = Device::flex();
    let x = noise(shape, &plain);
    let alone = best(|| {
        let _result = forward(&plain, x.clone());
    });
    let device = Device::flex().autodiff();
    let tracked = noise(shape, &device).require_grad();
    let both = best(|| {
        let _gradients = forward(&device, tracked.clone()).sum().backward();
    });
    println!("{name:<44} {alone:>9.1} {both:>9.1}");
}

fn convolution(
    channels: [usize; 2],
    kernel: usize,
    stride: usize,
    padding: usize,
    shape: [usize; 4],
) {
    let name = format!(
        "conv {kernel}x{kernel}/{stride} {}->{} {}x{}x{}",
        channels[0], channels[1], shape[0], shape[2], shape[3]
    );
    let build = |device: &Device| {
        let init = Initializer::new(0, device);
        Convolution::with_padding(&init, "layer", channels, kernel, stride, padding)
    };
    let (plain, trained) = (build(&Device::flex()), build(&Device::flex().autodiff()));
    layer(&name, shape, |device, x| {
        if device.is_autodiff() {
            trained.forward(x)
        } else {
            plain.forward(x)
        }
    });
}

fn layers() {
    println!(
        "{:<44} {:>9} {:>9}",
        "layer, best of runs in ms", "forward", "both"
    );
    convolution([18, 16], 3, 1, 1, [4, 18, 128, 256]);
    convolution([64, 64], 3, 1, 1, [4, 64, 32, 64]);
    convolution([66, 32], 3, 1, 1, [4, 66, 64, 128]);
    convolution([64, 64], 3, 2, 1, [4, 64, 64, 128]);
    convolution([3, 64], 7, 2, 3, [4, 3, 128, 256]);
    convolution([64, 256], 1, 1, 0, [4, 64, 32, 64]);
    convolution([16, 2], 3, 1, 1, [4, 16, 128, 256]);
    convolution([64, 128], 4, 2, 1, [4, 64, 64, 64]);
    let build = |device: &Device| {
        TransposedConvolution::new(&Initializer::new(0, device), "layer", [32, 16])
    };
    let (plain, trained) = (build(&Device::flex()), build(&Device::flex().autodiff()));
    layer(
        "transposed conv 32->16 4x64x128",
        [4, 32, 64, 128],
        |device, x| {
            if device.is_autodiff() {
                trained.forward(x)
            } else {
                plain.forward(x)
            }
        },
    );
    layer("elu 4x64x64x128", [4, 64, 64, 128], |_, x| elu(x - 0.5));
    layer("max pool 4x64x64x128", [4, 64, 64, 128], |_, x| {
        TensorOps.max_pool(x)
    });
    layer("upsample 4x64x64x128", [4, 64, 64, 128], |_, x| {
        TensorOps.upsample(x)
    });
    layer("instance norm 4x64x64x64", [4, 64, 64, 64], |device, x| {
        InstanceNorm::new(&Initializer::new(0, device), "layer", 64).forward(x)
    });
    layer(
        "sampler of an image 4x128x256",
        [4, 1, 128, 256],
        |device, x| sample_horizontal(noise([4, 3, 128, 256], device), x * 0.1),
    );
    layer(
        "sampler of a disparity 4x128x256",
        [4, 1, 128, 256],
        |_, x| sample_horizontal(x.clone(), x * 0.1),
    );
    layer("dssim 4x3x128x256", [4, 3, 128, 256], |device, x| {
        dssim(x, noise([4, 3, 128, 256], device))
    });
}

/// One full step: generator, losses at four scales, discriminator step, generator step.
fn step(width: Width, [height, columns]: [usize; 2], batch: usize, steps: usize) {
    let device = Device::flex().autodiff();
    let mut generator = GeneratorConfig {
        width,
        ..GeneratorConfig::default()
    }
    .init(1, &device);
    let mut critic = DiscriminatorConfig { width }.init(2, &device);
    let (mut generator_optimizer, mut critic_optimizer) = (adam(), adam());
    let left = noise([batch, 3, height, columns], &device);
    let right = noise([batch, 3, height, columns], &device);
    let reals = Tensor::cat(vec![left.clone(), right.clone()], 0);
    let patches = Patches {
        size: height,
        rows: vec![0; 2 * batch],
        columns: vec![0; 2 * batch],
    };
    let factors = ColourFactors(vec![[1.0; 3]; 2 * batch]);
    let cut = |image: Tensor<4>| patches.cut(image, &factors);
    let mut parts = [f64::INFINITY; 5];
    for number in 0..steps as u64 {
        let mut times = [0.0; 5];
        let mut clock = Instant::now();
        let mut lap = |index: usize| {
            times[index] = clock.elapsed().as_secs_f64() * 1e3;
            clock = Instant::now();
        };
        let levels = generator.forward(left.clone());
        lap(0);
        let terms = stereo_losses(left.clone(), right.clone(), &levels, &Weights::STRAT);
        let (fake_right, fake_left) =
            synthesize(left.clone(), right.clone(), levels[0].clone(), 0.5);
        lap(1);
        // Both views, and real and synthesised images, in one pass, as the training does it.
        let fakes = Tensor::cat(vec![fake_left, fake_right], 0);
        let shown = vec![cut(reals.clone()), cut(fakes.clone().detach())];
        let logits = critic.forward_seeded(Tensor::cat(shown, 0), 2 * number);
        let loss = discriminator_adversarial(
            logits.clone().narrow(0, 0, 2 * batch),
            logits.narrow(0, 2 * batch, 2 * batch),
        ) * 2.0;
        let gradients = GradientsParams::from_grads(loss.backward(), &critic);
        critic = critic_optimizer.step(1e-4, critic, gradients);
        lap(2);
        let frozen = critic.clone().no_grad();
        let judged = frozen.forward_seeded(cut(fakes), 2 * number + 1);
        let loss = terms.total + generator_adversarial(judged) * 0.02;
        let gradients = loss.backward();
        lap(3);
        let gradients = GradientsParams::from_grads(gradients, &generator);
        generator = generator_optimizer.step(1e-4, generator, gradients);
        lap(4);
        for (part, time) in parts.iter_mut().zip(times) {
            *part = part.min(time);
        }
    }
    let total: f64 = parts.iter().sum();
    println!(
        "step width {width} {columns}x{height} batch {batch}: {total:.0} ms \
         (forward {:.0}, losses {:.0}, discriminator {:.0}, backward {:.0}, optimizer {:.0})",
        parts[0], parts[1], parts[2], parts[3], parts[4]
    );
}

/// The generator alone, without a graph, as in validation.
fn forward(width: Width, [height, columns]: [usize; 2], batch: usize, times: usize) {
    let device = Device::flex();
    let config = GeneratorConfig {
        width,
        ..GeneratorConfig::default()
    };
    let generator = config.init(1, &device);
    let images = noise([batch, 3, height, columns], &device);
    let time = (0..times)
        .map(|_| {
            let start = Instant::now();
            let _levels = generator.forward(images.clone());
            start.elapsed().as_secs_f64() * 1e3
        })
        .fold(f64::INFINITY, f64::min);
    println!("forward width {width} {columns}x{height} batch {batch}: {time:.0} ms");
}

/// Highest resident memory of this process, where the system tells.
fn peak_mib() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix("VmHWM:"))?;
    line.trim()
        .strip_suffix("kB")?
        .trim()
        .parse::<u64>()
        .ok()
        .map(|kib| kib / 1024)
}

fn main() {
    // As `train` takes its steps.
    keep_awake(time);
}

fn time() {
    let quarter: Width = "1/4".parse().unwrap_or_default();
    let words: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    if let [
        kind @ ("one" | "forward"),
        width,
        columns,
        height,
        batch,
        steps,
    ] = words[..]
    {
        let number = |text: &str| text.parse().unwrap_or(1);
        let size = [number(height), number(columns)];
        let width = width.parse().unwrap_or_default();
        match kind {
            "one" => step(width, size, number(batch), number(steps)),
            _ => forward(width, size, number(batch), number(steps)),
        }
        if let Some(mib) = peak_mib() {
            println!("highest memory, {mib} MiB");
        }
        return;
    }
    if words != ["steps"] {
        layers();
    }
    step(quarter, [64, 128], 8, 4);
    step(quarter, [128, 256], 4, 3);
    step(quarter, [128, 256], 8, 3);
}
