//! A device held against the processor before anything is trained on it.
//!
//! A small network of the configuration's own kind computes on both, from the same weights and images,
//! with the training's own code: the forward pass, every loss term, the gradients of all networks, a step of
//! the optimizer from the same gradients, and the exported model against the embedded runtime. What may
//! differ is rounding (down to the ten bits that some GPUs multiply with), so the tolerances lie far above
//! it and far below what a wrong operation does.
//!
//! Not here: how long a step takes and what it needs ([`super::memory`]); whether a device computes the
//! same twice.

use std::fmt;

use burn::module::{Module, ModuleMapper, ModuleVisitor, Param};
use burn::optim::GradientsParams;
use burn::tensor::{Device, Tensor};
use serde::{Deserialize, Serialize};
use strat_onnx::metadata::{InputRange, ModelMetadata, OutputMeaning};

use super::batch::{Replica, StepContext};
use super::trainer::adam;
use crate::config::{Config, Preset, Sharing};
use crate::data::loader::{Batch, to_tensor};
use crate::device::{DeviceChoice, guarded};
use crate::error::{Error, Result};
use crate::export;
use crate::network::discriminator::{Discriminator, NETWORK, RIGHT_NETWORK};
use crate::network::generator::{Generator, Layer};
use crate::network::initial_weights::Parameter;
use crate::network::layers::values_of;

/// What is compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Part {
    /// The disparities of every level.
    Forward,
    /// The numbers of a step: every term, and what is told of the disparities.
    LossTerms,
    /// Gradients of the generator, parameter by parameter.
    GeneratorGradients,
    /// Gradients of the discriminators, parameter by parameter.
    DiscriminatorGradients,
    /// What a step of the optimizer changes, parameter by parameter.
    OptimizerStep,
    /// The exported model run by the embedded runtime, in fractions of the image width.
    ExportedModel,
}

impl Part {
    /// All parts in the order in which they build on each other.
    pub const ALL: [Self; 6] = [
        Self::Forward,
        Self::LossTerms,
        Self::GeneratorGradients,
        Self::DiscriminatorGradients,
        Self::OptimizerStep,
        Self::ExportedModel,
    ];

    /// Largest difference that is accepted: the norm of the difference in relation to the norm of what
    /// the processor computes, but for the exported model.
    #[must_use]
    pub const fn allowed(self) -> f64 {
        match self {
            Self::Forward | Self::LossTerms | Self::OptimizerStep => 1e-3,
            Self::GeneratorGradients | Self::DiscriminatorGradients => 1e-2,
            Self::ExportedModel => export::TOLERANCE,
        }
    }
}

impl fmt::Display for Part {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Forward => "forward pass",
            Self::LossTerms => "loss terms",
            Self::GeneratorGradients => "gradients of the generator",
            Self::DiscriminatorGradients => "gradients of the discriminator",
            Self::OptimizerStep => "optimizer step",
            Self::ExportedModel => "exported model",
        })
    }
}

/// How far a device is from the processor in one number, map or parameter.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Difference {
    /// What it belongs to.
    pub part: Part,
    /// Level, term or parameter.
    pub name: String,
    /// See [`Part::allowed`]; infinite where something is no number.
    pub value: f64,
}

impl Difference {
    /// Whether it is larger than rounding explains.
    #[must_use]
    pub fn is_wrong(&self) -> bool {
        self.value.is_nan() || self.value > self.part.allowed()
    }
}

/// All differences of a device, in the order of the parts and within them from the image on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Findings {
    /// The device.
    pub device: String,
    /// The differences.
    pub differences: Vec<Difference>,
}

impl Findings {
    /// The largest difference of a part; none where the configuration does without it.
    #[must_use]
    pub fn largest(&self, part: Part) -> Option<&Difference> {
        let of_part = self.differences.iter().filter(|found| found.part == part);
        of_part.max_by(|a, b| a.value.total_cmp(&b.value))
    }

    /// The same with the largest difference of each part alone.
    #[must_use]
    pub fn summary(self) -> Self {
        let largest = Part::ALL
            .iter()
            .filter_map(|part| self.largest(*part).cloned());
        Self {
            differences: largest.collect(),
            ..self
        }
    }

    /// Refuses a device that computes something else than the processor.
    ///
    /// # Errors
    /// With the first part that is wrong, and of gradients the layer nearest to the loss: a wrong one spoils
    /// those of all layers before it.
    pub fn verdict(&self) -> Result<()> {
        let wrong = |part: &Part| {
            let of_part = self.differences.iter().filter(|found| found.part == *part);
            of_part.filter(|found| found.is_wrong()).collect::<Vec<_>>()
        };
        for part in Part::ALL {
            let found = wrong(&part);
            let (Some(last), others) = (found.last(), found.len().saturating_sub(1)) else {
                continue;
            };
            let others = match others {
                0 => String::new(),
                count => format!(" (and {count} before it)"),
            };
            return Err(Error::WrongDevice(format!(
                "the device {} computes the {part} wrong: {}{others} differs from the cpu's by {:.1e}, \
                 and {:.0e} is allowed. What it trains could not be trusted, so it trains nothing; use \
                 another device or driver. `train check --device {}` shows all differences, --no-check \
                 trains anyway",
                self.device,
                last.name,
                last.value,
                part.allowed(),
                self.device,
            )));
        }
        Ok(())
    }
}

/// The configuration with the sizes of the small network.
fn small(config: &Config) -> Result<Config> {
    let mut small = config.clone();
    Preset::Tiny.apply(&mut small)?;
    small.batch = 2;
    small.initial_weights = None;
    Ok(small)
}

/// Holds a device against the processor, with a small network or with one pair at the configuration's own
/// size.
///
/// # Errors
/// When the device does not answer, or stops before it has computed everything.
pub fn check(config: &Config, choice: DeviceChoice, full: bool) -> Result<Findings> {
    let config = match full {
        true => Config {
            batch: 1,
            ..config.clone()
        },
        false => small(config)?,
    };
    let processor = DeviceChoice::Cpu.open()?;
    let device = choice.open()?;
    let reference = Networks::new(&config, &processor);
    let expected = reference.compute(&config);
    let found = guarded(|| -> Result<Vec<Difference>> {
        let networks = reference.on(&device);
        let mut found = networks.compute(&config);
        if choice == DeviceChoice::Faulty {
            spoil(&mut found.generator);
        }
        let mut differences = found.differences(&expected);
        differences.extend(networks.step_differences(&reference, &expected));
        differences.push(networks.model_difference(&config)?);
        Ok(differences)
    });
    let stopped = |problem: String| {
        Error::WrongDevice(format!(
            "the device {choice} stopped while it was checked: {problem}. Use another device or driver"
        ))
    };
    Ok(Findings {
        device: choice.to_string(),
        differences: found.map_err(stopped)??,
    })
}

/// Networks of one device with the same weights as on every other.
struct Networks {
    generator: Generator,
    discriminators: Vec<Discriminator>,
    device: Device,
}

impl Networks {
    fn new(config: &Config, device: &Device) -> Self {
        let device = device.clone().autodiff();
        let count = match (
            config.variant.is_adversarial(),
            config.discriminator.sharing,
        ) {
            (false, _) => 0,
            (true, Sharing::Shared) => 1,
            (true, Sharing::PerView) => 2,
        };
        let judge = |seed| config.discriminator.network().init(seed, &device);
        Self {
            generator: config.network.init(config.seed, &device),
            discriminators: (0..count).map(judge).collect(),
            device,
        }
    }

    /// The same weights under the same identities on another device.
    fn on(&self, device: &Device) -> Self {
        let device = device.clone().autodiff();
        Self {
            generator: self.generator.clone().fork(&device),
            discriminators: self.discriminators.clone().fork(&device),
            device,
        }
    }

    fn compute(&self, config: &Config) -> Computed {
        let context = StepContext {
            config,
            weights: config.loss_weights(),
            step: 0,
            baseline: 0.5,
            discriminator_rate: 0.0,
            share: 1.0,
            diagnose: false,
        };
        let images = batch(config);
        let plain = self.device.clone().inner();
        let left = to_tensor(images.left.clone(), config.input.size(), &plain);
        let levels = self.generator.valid().forward(left).map(values_of);
        let replica = Replica {
            generator: self.generator.clone(),
            discriminators: self.discriminators.clone(),
            device: &self.device,
        };
        let of_batch = replica.run(&context, images, 0, &self.device);
        let judges = self.discriminators.iter().zip(of_batch.discriminators);
        Computed {
            levels,
            terms: of_batch.report.columns(),
            generator: in_place(&self.generator, of_batch.generator),
            discriminators: judges.map(|(network, of)| in_place(network, of)).collect(),
        }
    }

    /// What a step of the optimizer does with the processor's gradients, here and there.
    fn step_differences(&self, reference: &Self, gradients: &Computed) -> Vec<Difference> {
        /// Large beside the rounding of a weight.
        const RATE: f64 = 0.01;
        let plain = self.device.clone().inner();
        let before = reference.generator.parameters();
        let step = |generator: &Generator, gradients: GradientsParams| {
            let after = adam().step(RATE, generator.clone(), gradients).parameters();
            let changes = after.into_iter().zip(&before).map(|(mut after, before)| {
                let values = after.values.iter_mut().zip(&before.values);
                values.for_each(|(after, before)| *after -= before);
                after
            });
            changes.collect::<Vec<_>>()
        };
        let expected = step(&reference.generator, taken(&gradients.generator));
        let moved = taken(&gradients.generator).to_device(&plain, &self.generator);
        let found = step(&self.generator, moved);
        between(Part::OptimizerStep, &found, &expected)
    }

    fn model_difference(&self, config: &Config) -> Result<Difference> {
        let metadata = ModelMetadata::new(
            OutputMeaning::DisparityFraction,
            InputRange::Unit,
            config.input.width,
            config.input.height,
        );
        let parity = export::parity(&self.generator, &metadata);
        Ok(Difference {
            part: Part::ExportedModel,
            name: "disparity".to_owned(),
            value: parity.map_err(|error| Error::Export(error.to_string()))?,
        })
    }
}

/// What a device has computed.
struct Computed {
    levels: [Vec<f32>; crate::network::generator::SCALES],
    terms: Vec<(&'static str, f64)>,
    /// The networks with gradients in the place of their weights.
    generator: Generator,
    discriminators: Vec<Discriminator>,
}

impl Computed {
    fn differences(&self, expected: &Self) -> Vec<Difference> {
        let levels = self.levels.iter().zip(&expected.levels).enumerate();
        let levels = levels.map(|(level, (found, expected))| Difference {
            part: Part::Forward,
            name: format!("level {level}"),
            value: relative(found, expected, norm(expected)),
        });
        let terms = self.terms.iter().zip(&expected.terms);
        let terms = terms.map(|((name, found), (_, expected))| Difference {
            part: Part::LossTerms,
            name: (*name).to_owned(),
            value: ratio((found - expected).abs(), expected.abs()),
        });
        let mut differences: Vec<Difference> = levels.chain(terms).collect();
        let of_generators = [self, expected].map(|computed| computed.generator.parameters());
        let of_judges = [self, expected].map(|computed| {
            let judges = computed.discriminators.iter().zip([NETWORK, RIGHT_NETWORK]);
            judges
                .flat_map(|(network, name)| network.parameters(name))
                .collect::<Vec<_>>()
        });
        for (part, [found, expected]) in [
            (Part::GeneratorGradients, of_generators),
            (Part::DiscriminatorGradients, of_judges),
        ] {
            differences.extend(between(part, &found, &expected));
        }
        differences
    }
}

/// Differences parameter by parameter.
fn between(part: Part, found: &[Parameter], expected: &[Parameter]) -> Vec<Difference> {
    let mut of_weight = 0.0;
    let pairs = found.iter().zip(expected);
    let differences = pairs.map(|(found, expected)| {
        let mut scale = norm(&expected.values);
        if part == Part::DiscriminatorGradients && expected.name.ends_with(".conv.bias") {
            // A normalisation follows: the true gradient is 0, and what is computed is noise, to be held
            // against the gradient of the layer's weight.
            scale = of_weight;
        }
        of_weight = scale;
        Difference {
            part,
            name: expected.name.clone(),
            value: relative(&found.values, &expected.values, scale),
        }
    });
    differences.collect()
}

fn norm(values: &[f32]) -> f64 {
    let squares = values
        .iter()
        .map(|value| f64::from(*value) * f64::from(*value));
    squares.sum::<f64>().sqrt()
}

/// Norm of the difference in relation to `scale`; infinite where the numbers are not as many.
fn relative(found: &[f32], expected: &[f32], scale: f64) -> f64 {
    if found.len() != expected.len() {
        return f64::INFINITY;
    }
    let apart = found.iter().zip(expected).map(|(found, expected)| {
        let apart = f64::from(*found) - f64::from(*expected);
        apart * apart
    });
    ratio(apart.sum::<f64>().sqrt(), scale)
}

/// `apart / scale`; 0 where nothing differs, infinite where something is no number.
fn ratio(apart: f64, scale: f64) -> f64 {
    match apart / scale {
        _ if apart == 0.0 => 0.0,
        ratio if ratio.is_nan() => f64::INFINITY,
        ratio => ratio,
    }
}

/// A network with its gradients in the place of its weights, under the same identities. A gradient that
/// is missing is no number.
fn in_place<M: Module>(network: &M, gradients: GradientsParams) -> M {
    struct Place(GradientsParams);
    impl ModuleMapper for Place {
        fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
            let gradient = self.0.remove::<D>(param.id);
            param.map(|weight| gradient.unwrap_or_else(|| weight * f32::NAN))
        }
    }
    network.valid().map(&mut Place(gradients))
}

/// What [`in_place`] has put there.
fn taken<M: Module>(network: &M) -> GradientsParams {
    #[derive(Default)]
    struct Take(GradientsParams);
    impl ModuleVisitor for Take {
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            self.0.register(param.id, param.val());
        }
    }
    let mut take = Take::default();
    network.visit(&mut take);
    take.0
}

/// What makes the device `faulty` one: the gradient of one layer is a tenth too large.
fn spoil(gradients: &mut Generator) {
    struct Spoil(burn::module::ParamId);
    impl ModuleMapper for Spoil {
        fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
            let own = param.id == self.0;
            param.map(|gradient| if own { gradient * 1.1 } else { gradient })
        }
    }
    let layers = gradients.layers();
    let spoilt = layers.iter().find_map(|(name, layer)| match layer {
        Layer::Convolution(layer) if name == SPOILT => Some(layer.weight.id),
        _ => None,
    });
    drop(layers);
    if let Some(id) = spoilt {
        *gradients = gradients.clone().map(&mut Spoil(id));
    }
}

/// The layer whose gradient the device `faulty` spoils.
const SPOILT: &str = "decoder.iconv3";

/// Two views of waves, three pixels apart.
fn batch(config: &Config) -> Batch {
    let [height, width] = config.input.size();
    let view = |shift: f32| {
        let pixel = move |place: usize| {
            let (column, row) = ((place % width) as f32 + shift, (place / width) as f32);
            // Channels and samples follow each other as rows do, and differ by their phase.
            let wave = (0.31 * column + 0.11 * row).sin() + (0.083 * column - 0.27 * row).cos();
            0.5 + 0.2 * wave
        };
        (0..config.batch * 3 * height * width).map(pixel).collect()
    };
    Batch {
        left: view(0.0),
        right: view(3.0),
        samples: config.batch,
        indices: vec![0; config.batch],
        warnings: Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn findings(settings: &[&str], choice: DeviceChoice) -> Findings {
        let settings: Vec<String> = settings.iter().map(|s| (*s).to_owned()).collect();
        let config = Config::resolve("kitti-strat", None, &settings).unwrap();
        check(&config, choice, false).unwrap()
    }

    #[test]
    fn the_processor_computes_what_it_computes() {
        for (settings, with_judge) in [
            (&[][..], true),
            (&["discriminator.sharing=per-view"], true),
            (&["variant=no-adv", "network.decoder=nearest-conv"], false),
        ] {
            let found = findings(settings, DeviceChoice::Cpu);
            found.verdict().unwrap();
            for part in Part::ALL {
                let largest = found.largest(part);
                let expected = with_judge || part != Part::DiscriminatorGradients;
                assert_eq!(largest.is_some(), expected, "{part}");
                let allowed = match part {
                    // Burn against the embedded runtime.
                    Part::ExportedModel => 1e-5,
                    _ => 0.0,
                };
                assert!(largest.is_none_or(|found| found.value <= allowed), "{part}");
            }
        }
    }

    #[test]
    fn a_spoilt_gradient_is_found_and_its_layer_named() {
        let found = findings(&[], DeviceChoice::Faulty);
        let wrong: Vec<&Difference> = found.differences.iter().filter(|f| f.is_wrong()).collect();
        assert_eq!(wrong.len(), 1, "{wrong:?}");
        assert_eq!(wrong[0].name, format!("{SPOILT}.weight"));
        assert!((wrong[0].value - 0.1).abs() < 1e-3, "{}", wrong[0].value);
        let sentence = found.verdict().unwrap_err().to_string();
        for part in ["faulty", "decoder.iconv3.weight", "gradients", "--no-check"] {
            assert!(sentence.contains(part), "{part}: {sentence}");
        }
    }

    #[test]
    fn every_parameter_is_compared_and_a_missing_gradient_is_wrong() {
        let config = Config::resolve("kitti-strat", Some(Preset::Tiny), &[]).unwrap();
        let networks = Networks::new(&config, &Device::flex());
        let expected = networks.compute(&config);
        let mut gradients = taken(&expected.generator);
        let lost = networks.generator.encoder.conv1.weight.id;
        assert!(gradients.remove::<4>(lost).is_some());
        let found = in_place(&networks.generator, gradients).parameters();
        let expected = expected.generator.parameters();
        let differences = between(Part::GeneratorGradients, &found, &expected);
        assert_eq!(differences.len(), networks.generator.parameters().len());
        let wrong: Vec<&Difference> = differences.iter().filter(|f| f.is_wrong()).collect();
        assert_eq!(wrong.len(), 1);
        assert_eq!(wrong[0].name, "encoder.conv1.weight");
        assert_eq!(wrong[0].value, f64::INFINITY);
    }

    #[test]
    fn of_wrong_gradients_the_one_nearest_to_the_loss_is_named() {
        let difference = |name: &str, value| Difference {
            part: Part::GeneratorGradients,
            name: name.to_owned(),
            value,
        };
        let found = Findings {
            device: "cuda".to_owned(),
            differences: vec![
                difference("encoder.conv1.weight", 0.5),
                difference("decoder.up3.weight", f64::INFINITY),
                difference("decoder.iconv1.weight", 1e-6),
            ],
        };
        let sentence = found.verdict().unwrap_err().to_string();
        assert!(
            sentence.contains("decoder.up3.weight (and 1 before it)"),
            "{sentence}"
        );
        assert_eq!(found.summary().differences.len(), 1);
    }

    #[test]
    fn what_is_no_number_is_wrong_and_nothing_equals_nothing() {
        assert_eq!(relative(&[0.0], &[0.0], 0.0), 0.0);
        assert_eq!(relative(&[1.0], &[0.0], 0.0), f64::INFINITY);
        assert_eq!(relative(&[f32::NAN], &[1.0], 1.0), f64::INFINITY);
        assert_eq!(relative(&[1.0], &[1.0, 2.0], 1.0), f64::INFINITY);
        assert_eq!(relative(&[3.0, 4.0], &[0.0, 0.0], 2.5), 2.0);
    }
}
