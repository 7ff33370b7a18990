//! Steps on a GPU backend beside the same steps on the processor.
//!
//! Compiled with `--features wgpu` only. A software driver (Debian's `mesa-vulkan-drivers`) will do:
//!
//! ```text
//! CUBECL_AUTOTUNE_LEVEL=minimal cargo test -p strat-train --features wgpu --test it gpu
//! ```
//!
//! `STRAT_GPU_SIZE=full` takes the full-width networks at 512x256 instead of the tiny ones.

use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor, TensorData};
use strat_onnx::metadata::{InputRange, ModelMetadata, OutputMeaning};
use strat_train::config::{Config, Preset};
use strat_train::data::loader::Batch;
use strat_train::device::DeviceChoice;
use strat_train::export::export;
use strat_train::loss::{
    discriminator_adversarial, generator_adversarial, stereo_losses, synthesize,
};
use strat_train::network::discriminator::{ColourFactors, Patches};
use strat_train::network::generator::Layer;
use strat_train::training::report::StepReport;
use strat_train::training::schedule::Timeline;
use strat_train::training::trainer::Trainer;

fn config() -> Config {
    let preset = match std::env::var("STRAT_GPU_SIZE").as_deref() {
        Ok("full") => Preset::Full,
        _ => Preset::Tiny,
    };
    Config::resolve("kitti-strat", Some(preset), &["batch=1".to_owned()]).unwrap()
}

/// Two views of waves, three pixels apart.
fn batch(config: &Config) -> Batch {
    let view = |shift: f32| {
        let mut values = Vec::new();
        for channel in 0..3 {
            for row in 0..config.input.height {
                for column in 0..config.input.width {
                    let (u, v, c) = (column as f32 + shift, row as f32, channel as f32);
                    let wave = (0.31 * u + 0.11 * v + c).sin() + (0.083 * u - 0.27 * v).cos();
                    values.push(0.5 + 0.2 * wave);
                }
            }
        }
        values
    };
    Batch {
        left: view(0.0),
        right: view(3.0),
        samples: 1,
        indices: vec![0],
        warnings: Vec::new(),
    }
}

fn gpu() -> Device {
    DeviceChoice::Wgpu(None)
        .open()
        .unwrap_or_else(|error| panic!("this test needs a Vulkan driver: {error}"))
}

/// Gradients of both networks, all of one network in one list.
fn gradients(config: &Config, device: &Device) -> [Vec<f32>; 2] {
    let device = device.clone().autodiff();
    let generator = config.network.init(3, &device);
    let judge = config.discriminator.network().init(4, &device);
    let batch = batch(config);
    let [height, width] = [config.input.height as usize, config.input.width as usize];
    let tensor =
        |values| Tensor::<4>::from_data(TensorData::new(values, [1, 3, height, width]), &device);
    let (left, right) = (tensor(batch.left), tensor(batch.right));
    let disparities = generator.forward(left.clone());
    let terms = stereo_losses(
        left.clone(),
        right.clone(),
        &disparities,
        &config.loss_weights(),
    );
    let [disparity, ..] = disparities;
    let (right_fake, _) = synthesize(left, right.clone(), disparity, 0.5);
    let patches = Patches {
        size: config.discriminator.patch,
        rows: vec![0],
        columns: vec![width - config.discriminator.patch],
    };
    let colours = ColourFactors(vec![[0.9, 1.0, 1.1]]);
    let judged = |view: Tensor<4>| judge.forward_seeded(patches.cut(view, &colours), 9);
    let loss = discriminator_adversarial(judged(right), judged(right_fake.clone().detach()));
    let of_judge = loss.backward();
    let still = judge.clone().no_grad();
    let logits = still.forward_seeded(patches.cut(right_fake, &colours), 9);
    let of_generator = (terms.total + generator_adversarial(logits)).backward();

    fn values<const D: usize>(
        parameter: &Param<Tensor<D>>,
        gradients: &burn::tensor::Gradients,
    ) -> Vec<f32> {
        let gradient = parameter.val().grad(gradients).expect("a gradient");
        gradient.into_data().iter::<f32>().collect()
    }
    let mut first = Vec::new();
    for (_, layer) in generator.layers() {
        let (weight, bias) = match layer {
            Layer::Convolution(layer) => (&layer.weight, &layer.bias),
            Layer::Transposed(layer) => (&layer.weight, &layer.bias),
        };
        first.extend(values(weight, &of_generator));
        first.extend(values(bias, &of_generator));
    }
    let mut second = Vec::new();
    for stage in &judge.stages {
        // The bias before a normalisation has no gradient but noise.
        second.extend(values(&stage.conv.weight, &of_judge));
        second.extend(values(&stage.norm.scale, &of_judge));
        second.extend(values(&stage.norm.shift, &of_judge));
    }
    second.extend(values(&judge.last.weight, &of_judge));
    second.extend(values(&judge.last.bias, &of_judge));
    [first, second]
}

/// Norm of the difference in relation to the norm.
fn difference(found: &[f32], expected: &[f32]) -> f64 {
    assert_eq!(found.len(), expected.len());
    let norm = |values: &mut dyn Iterator<Item = f64>| values.map(|v| v * v).sum::<f64>().sqrt();
    let pairs = found.iter().zip(expected);
    let apart = norm(&mut pairs.map(|(a, b)| f64::from(*a) - f64::from(*b)));
    apart / norm(&mut expected.iter().map(|v| f64::from(*v)))
}

#[test]
fn gradients_are_those_of_the_processor() {
    let config = config();
    let expected = gradients(&config, &DeviceChoice::Cpu.open().unwrap());
    let found = gradients(&config, &gpu());
    for (name, (found, expected)) in ["generator", "discriminator"]
        .iter()
        .zip(found.iter().zip(&expected))
    {
        let apart = difference(found, expected);
        eprintln!(
            "{name}: {} gradients, relative difference {apart:.1e}",
            found.len()
        );
        assert!(apart < 1e-3, "{name}: {apart}");
    }
}

#[test]
fn a_step_is_that_of_the_processor_and_its_model_passes_the_gate() {
    let config = config();
    let timeline = Timeline::new(&config, 10 * config.batch);
    let run = |device: &Device| -> (StepReport, Trainer) {
        let mut trainer = Trainer::new(&config, None, device);
        let report = trainer
            .step(&config, &timeline, 0, vec![batch(&config)])
            .unwrap();
        (report, trainer)
    };
    let (expected, _) = run(&DeviceChoice::Cpu.open().unwrap());
    let (found, trainer) = run(&gpu());
    for (name, found, expected) in [
        ("total", found.total, expected.total),
        ("adversarial", found.adversarial, expected.adversarial),
        ("discriminator", found.discriminator, expected.discriminator),
        ("disparity", found.disparity_mean, expected.disparity_mean),
    ] {
        let apart = (found - expected).abs() / expected.abs();
        eprintln!("{name}: {found} on the GPU, relative difference {apart:.1e}");
        assert!(apart < 1e-4, "{name}: {found} instead of {expected}");
    }
    let metadata = ModelMetadata::new(
        OutputMeaning::DisparityFraction,
        InputRange::Unit,
        config.input.width,
        config.input.height,
    );
    let folder = tempfile::tempdir().unwrap();
    let parity = export(
        &trainer.generator(),
        &metadata,
        &folder.path().join("m.onnx"),
    )
    .unwrap();
    eprintln!("parity of the exported model: {parity:.1e}");
}
