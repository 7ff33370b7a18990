//! Writes a trained generator as an ONNX file that says how it was checked.
//!
//! The graph comes from [`Generator::run`], the same topology that was trained, through an
//! implementation of [`Ops`] that builds nodes instead of computing. Before the file appears under
//! its name, the embedded runtime computes what burn computed, for a closed-form picture and for
//! random ones; the largest difference stands in the file, with the expected outputs for the
//! picture, so that every other runtime can be held against training.
//!
//! Input `image` `[N, 3, height, width]`, output `disparity` `[N, 2, height, width]` (left, right;
//! fractions of the width), any batch size.
//!
//! Not here: reading models, other output levels; discriminators are in [`discriminator`].

pub mod discriminator;

use std::path::{Path, PathBuf};

use burn::module::Module;
use burn::tensor::{Tensor, TensorData};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use strat_onnx::embedded::{EmbeddedError, EmbeddedSession};
use strat_onnx::graph::{Dim, Filter, Geometry, GraphBuilder, GraphError, Value};
use strat_onnx::metadata::{ModelMetadata, Probe, ProbeError, probe_image};

use crate::network::discriminator::SMALLEST_PATCH;
use crate::network::generator::{Generator, SIZE_MULTIPLE};
use crate::network::layers::{
    Convolution, LayerWeights, Ops, TransposedConvolution, unit_interval, values_of,
};

/// Largest difference between burn and the written model that is accepted, in fractions of the
/// image width: a twentieth of a pixel at 512.
pub const TOLERANCE: f64 = 1e-4;

/// Random pictures that are compared besides the closed-form one.
const RANDOM_PICTURES: usize = 2;

/// Why a network was not written.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// The size in the metadata is not one the network can take.
    #[error(
        "a model for images of {width} x {height} cannot be exported: both sides must be \
         multiples of {SIZE_MULTIPLE}"
    )]
    Size {
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// The graph could not be built.
    #[error(transparent)]
    Graph(#[from] GraphError),
    /// The embedded runtime refused the graph.
    #[error(transparent)]
    Run(#[from] EmbeddedError),
    /// The network computes values that are no numbers.
    #[error(
        "the network's output cannot be recorded: {0}; train it again or take an earlier checkpoint"
    )]
    Probe(#[from] ProbeError),
    /// The patches are too small for a discriminator.
    #[error("patches of {patch} px are smaller than the {SMALLEST_PATCH} px a discriminator needs")]
    Patch {
        /// Side in pixels.
        patch: u32,
    },
    /// Runtime and training disagree.
    #[error(
        "{what} by {difference:e}, more than {tolerance:e} is not accepted; {} was not written",
        path.display()
    )]
    Parity {
        /// What differs from what, in which unit.
        what: &'static str,
        /// What would be accepted.
        tolerance: f64,
        /// Largest difference; infinite where one of them is not a number.
        difference: f64,
        /// Where the file would have been.
        path: PathBuf,
    },
    /// The file could not be written.
    #[error(transparent)]
    Write(#[from] strat_store::Error),
}

/// Writes `generator` to `path` for images of the size and with the weights that stand in
/// `metadata`, whose fields `parity` and `probe` are filled here. Returns the parity: the largest difference between burn
/// and the embedded runtime, in fractions of the image width.
///
/// # Errors
/// The size is no multiple of 64, the network's outputs are not finite, the runtime differs by
/// more than [`TOLERANCE`], or the file cannot be written. No file appears then.
pub fn export(
    generator: &Generator,
    metadata: &ModelMetadata,
    path: &Path,
) -> Result<f64, ExportError> {
    // Without autodiff: a forward pass that is never followed by a backward pass keeps its memory.
    let generator = generator.valid();
    let (mut metadata, parity) = compare(&generator, metadata, &path.display().to_string())?;
    let what =
        "the exported model differs from the trained network, in fractions of the image width,";
    accept(parity, TOLERANCE, what, path)?;
    metadata.parity = Some(parity);
    strat_store::files::write_atomic(path, &model_bytes(&generator, &metadata)?)?;
    Ok(parity)
}

/// The parity of what [`export`] would write, however large.
///
/// # Errors
/// As [`export`], but for the difference and the file.
pub fn parity(generator: &Generator, metadata: &ModelMetadata) -> Result<f64, ExportError> {
    let (_, parity) = compare(&generator.valid(), metadata, "the exported model")?;
    Ok(parity)
}

/// Refuses a difference above `tolerance`, and one that is not a number.
fn accept(
    difference: f64,
    tolerance: f64,
    what: &'static str,
    path: &Path,
) -> Result<(), ExportError> {
    if difference <= tolerance {
        return Ok(());
    }
    Err(ExportError::Parity {
        what,
        tolerance,
        difference,
        path: path.to_owned(),
    })
}

/// The metadata with its probe, and the largest difference between burn and the embedded runtime;
/// `name` stands in errors.
fn compare(
    generator: &Generator,
    metadata: &ModelMetadata,
    name: &str,
) -> Result<(ModelMetadata, f64), ExportError> {
    let (width, height) = (metadata.input_width, metadata.input_height);
    let multiple = |size: u32| size > 0 && (size as usize).is_multiple_of(SIZE_MULTIPLE);
    if !multiple(width) || !multiple(height) {
        return Err(ExportError::Size { width, height });
    }
    let picture = probe_image(width, height);
    let expected = compute(
        generator,
        picture.clone(),
        [1, height as usize, width as usize],
    );
    let mut metadata = metadata.clone();
    metadata.parity = None;
    metadata.probe = Some(Probe::record(width, height, &expected)?);

    let bytes = model_bytes(generator, &metadata)?;
    let session = EmbeddedSession::from_bytes(bytes, name, None)?;
    let random = random_pictures(3 * RANDOM_PICTURES * (width * height) as usize);
    let random_shape = [RANDOM_PICTURES, height as usize, width as usize];
    let expected_random = compute(generator, random.clone(), random_shape);
    let parity = largest_of_runs(
        &session,
        INPUT,
        [height as usize, width as usize],
        [
            (&picture, 1, &expected),
            (&random, RANDOM_PICTURES, &expected_random),
        ],
    )?;
    Ok((metadata, parity))
}

/// The largest difference between what the session makes of pictures, so many of `[height, width]` at a
/// time, and what is expected of them.
fn largest_of_runs(
    session: &EmbeddedSession,
    input: &str,
    [height, width]: [usize; 2],
    runs: [(&[f32], usize, &[f32]); 2],
) -> Result<f64, EmbeddedError> {
    let mut largest = 0.0_f64;
    for (pictures, batch, expected) in runs {
        let outputs = session.run(input, &[batch, 3, height, width], pictures)?;
        let found = outputs.first().map_or(&[][..], |(_, _, values)| values);
        largest = largest.max(largest_difference(found, expected));
    }
    Ok(largest)
}

const INPUT: &str = "image";
const OUTPUT: &str = "disparity";

/// Level 0 for `pictures`, `[batch, 3, height, width]`.
fn compute(
    generator: &Generator,
    pictures: Vec<f32>,
    [batch, height, width]: [usize; 3],
) -> Vec<f32> {
    let device = generator.encoder.conv1.weight.val().device();
    let images = Tensor::from_data(
        TensorData::new(pictures, [batch, 3, height, width]),
        &device,
    );
    let [disparity, ..] = generator.forward(images);
    values_of(disparity)
}

/// Values in 0..1, always the same.
fn random_pictures(values: usize) -> Vec<f32> {
    let mut stream = ChaCha8Rng::seed_from_u64(0);
    (0..values)
        .map(|_| unit_interval(&mut stream) as f32)
        .collect()
}

/// Infinite where the lengths differ or a value is not a number.
fn largest_difference(found: &[f32], expected: &[f32]) -> f64 {
    if found.len() != expected.len() {
        return f64::INFINITY;
    }
    found.iter().zip(expected).fold(0.0, |largest, (a, b)| {
        let difference = (f64::from(*a) - f64::from(*b)).abs();
        if difference.is_nan() {
            f64::INFINITY
        } else {
            largest.max(difference)
        }
    })
}

fn model_bytes(generator: &Generator, metadata: &ModelMetadata) -> Result<Vec<u8>, GraphError> {
    let mut graph = GraphBuilder::new("strat").with_weights(metadata.weights);
    let (height, width) = (
        metadata.input_height as usize,
        metadata.input_width as usize,
    );
    let image = graph.input(INPUT, &["N".into(), 3.into(), height.into(), width.into()])?;
    let mut ops = GraphOps {
        graph,
        nodes: 0,
        error: None,
    };
    let [disparity, ..] = generator.run(&mut ops, Some(image));
    let GraphOps {
        mut graph, error, ..
    } = ops;
    match (error, disparity) {
        (None, Some(disparity)) => {
            let dims: [Dim; 4] = ["N".into(), 2.into(), height.into(), width.into()];
            graph.output_with_dims(OUTPUT, disparity, &dims)?;
            graph.finish(Some(metadata))
        }
        (Some(error), _) => Err(error),
        (None, None) => unreachable!("a missing value has left its error behind"),
    }
}

/// [`Ops`] that appends nodes to a graph. The first error is kept; from then on values are absent.
struct GraphOps {
    graph: GraphBuilder,
    /// Number of operations without weights so far, which have no names of their own.
    nodes: usize,
    error: Option<GraphError>,
}

impl GraphOps {
    fn keep(&mut self, result: Result<Value, GraphError>) -> Option<Value> {
        match result {
            Ok(value) => Some(value),
            Err(error) => {
                self.error.get_or_insert(error);
                None
            }
        }
    }

    fn unnamed(
        &mut self,
        kind: &str,
        build: impl FnOnce(&mut GraphBuilder, &str) -> Result<Value, GraphError>,
    ) -> Option<Value> {
        self.nodes += 1;
        let name = format!("{kind}_{}", self.nodes);
        let result = build(&mut self.graph, &name);
        self.keep(result)
    }
}

fn filter(weights: LayerWeights) -> Filter {
    Filter {
        shape: weights.weight_shape,
        weights: weights.weight,
        bias: weights.bias,
    }
}

impl Ops for GraphOps {
    type Value = Option<Value>;

    fn conv(&mut self, name: &str, layer: &Convolution, input: Self::Value) -> Self::Value {
        let geometry = Geometry::new(layer.stride, layer.padding);
        let result = self
            .graph
            .conv(name, input?, filter(layer.weights()), geometry);
        self.keep(result)
    }

    fn conv_transpose(
        &mut self,
        name: &str,
        layer: &TransposedConvolution,
        input: Self::Value,
    ) -> Self::Value {
        let geometry = Geometry::new(
            TransposedConvolution::STRIDE,
            TransposedConvolution::PADDING,
        );
        let result = self
            .graph
            .conv_transpose(name, input?, filter(layer.weights()), geometry);
        self.keep(result)
    }

    fn elu(&mut self, input: Self::Value) -> Self::Value {
        let input = input?;
        self.unnamed("elu", |graph, name| graph.elu(name, input))
    }

    fn relu(&mut self, input: Self::Value) -> Self::Value {
        let input = input?;
        self.unnamed("relu", |graph, name| graph.relu(name, input))
    }

    fn sigmoid(&mut self, input: Self::Value) -> Self::Value {
        let input = input?;
        self.unnamed("sigmoid", |graph, name| graph.sigmoid(name, input))
    }

    fn scale(&mut self, input: Self::Value, factor: f32) -> Self::Value {
        let input = input?;
        self.unnamed("scale", |graph, name| graph.scale(name, input, factor))
    }

    fn add(&mut self, left: Self::Value, right: Self::Value) -> Self::Value {
        let (left, right) = (left?, right?);
        self.unnamed("add", |graph, name| graph.add(name, left, right))
    }

    fn concat(&mut self, inputs: Vec<Self::Value>) -> Self::Value {
        let inputs: Vec<Value> = inputs.into_iter().collect::<Option<_>>()?;
        self.unnamed("concat", |graph, name| graph.concat(name, &inputs, 1))
    }

    fn max_pool(&mut self, input: Self::Value) -> Self::Value {
        let input = input?;
        // Padded by a node of its own: the pool's own padding counts as minus infinity.
        let padded = self.unnamed("pad", |graph, name| {
            graph.pad_zero(name, input, [1, 1, 0, 0])
        })?;
        // Changes no number. It keeps ONNX Runtime (seen in 1.31.1) from folding the padding into
        // the pool, where the zeros would become minus infinity and the output differ near the
        // upper and left border.
        let kept = self.unnamed("pad_kept", |graph, name| {
            graph.at_least(name, padded, f32::MIN)
        })?;
        self.unnamed("max_pool", |graph, name| {
            graph.max_pool(name, kept, 3, Geometry::new(2, 0))
        })
    }

    fn upsample(&mut self, input: Self::Value) -> Self::Value {
        let input = input?;
        self.unnamed("upsample", |graph, name| graph.nearest_x2(name, input))
    }
}

#[cfg(test)]
mod tests {
    use burn::tensor::Device;
    use strat_onnx::metadata::{InputRange, OutputMeaning, Weights};

    use super::*;
    use crate::network::generator::{Decoder, GeneratorConfig, Head, Shortcut};
    use crate::network::layers::Width;

    fn metadata() -> ModelMetadata {
        ModelMetadata::new(OutputMeaning::DisparityFraction, InputRange::Unit, 128, 64)
    }

    fn small(config: GeneratorConfig) -> GeneratorConfig {
        GeneratorConfig {
            width: Width::new(1, 16).expect("a valid width"),
            ..config
        }
    }

    #[test]
    fn exported_models_compute_what_burn_computes() {
        let folder = tempfile::tempdir().expect("a folder");
        let thesis = GeneratorConfig::default();
        let monodepth = GeneratorConfig {
            decoder: Decoder::NearestConv,
            head: Head::Sigmoid,
            shortcut: Shortcut::WhenNeeded,
            bottleneck: false,
            ..thesis
        };
        for (name, config) in [("thesis", thesis), ("monodepth", monodepth)] {
            let generator = small(config).init(5, &Device::flex().autodiff());
            let path = folder.path().join(format!("{name}.onnx"));
            let parity = export(&generator, &metadata(), &path).expect("the export succeeds");
            assert!(parity < 1e-6, "{name}: {parity:e}");

            let model = strat_onnx::model::read(&path).expect("the file is sound");
            let kept = model.info.description.metadata.expect("metadata");
            assert_eq!(kept.parity, Some(parity));
            let probe = kept.probe.expect("a probe");
            let session = EmbeddedSession::load(&path, None).expect("the file loads");
            let outputs = session
                .run("image", &[1, 3, 64, 128], &probe.image())
                .expect("the model runs");
            assert_eq!(outputs[0].0, "disparity");
            assert_eq!(outputs[0].1, [1, 2, 64, 128]);
            let difference = probe.max_difference(&outputs[0].2).expect("the size fits");
            assert!(difference < 1e-6, "{name}: {difference:e}");
        }
    }

    /// Half the bytes, and what half precision costs is within the tolerance and written down; an
    /// untrained network whose outputs are large and unbounded loses more and is refused.
    #[test]
    fn half_precision_halves_the_file() {
        let folder = tempfile::tempdir().expect("a folder");
        let device = Device::flex().autodiff();
        let unbounded = small(GeneratorConfig::default()).init(5, &device);
        let path = folder.path().join("refused.onnx");
        let mut half = metadata();
        half.weights = Weights::F16;
        let error = export(&unbounded, &half, &path).expect_err("refused");
        assert!(matches!(error, ExportError::Parity { .. }), "{error}");
        assert!(!path.exists());

        let generator = small(GeneratorConfig {
            head: Head::Sigmoid,
            ..GeneratorConfig::default()
        })
        .init(5, &device);
        let write = |weights| {
            let path = folder.path().join(format!("{weights}.onnx"));
            let mut metadata = metadata();
            metadata.weights = weights;
            let parity = export(&generator, &metadata, &path).expect("the export succeeds");
            let model = strat_onnx::model::read(&path).expect("the file is sound");
            let kept = model.info.description.metadata.expect("metadata");
            assert_eq!((kept.weights, kept.parity), (weights, Some(parity)));
            let session = EmbeddedSession::load(&path, None).expect("the file loads");
            let outputs = session
                .run("image", &[1, 3, 64, 128], &probe_image(128, 64))
                .expect("the model runs");
            let bytes = std::fs::metadata(&path).expect("a file").len();
            (bytes, parity, model.info.parameters, outputs[0].2.clone())
        };
        let (whole, exact, parameters, plain) = write(Weights::F32);
        let (half, rounded, of_half, other) = write(Weights::F16);
        let ratio = half as f64 / whole as f64;
        assert!((0.5..0.62).contains(&ratio), "{half} of {whole} bytes");
        assert_eq!(parameters, of_half);
        assert!(
            exact < rounded && rounded < TOLERANCE,
            "{exact:e} {rounded:e}"
        );
        let difference = largest_difference(&plain, &other);
        assert!(difference > 0.0 && difference < TOLERANCE, "{difference:e}");
    }

    #[test]
    fn sizes_that_are_no_multiples_of_64_are_refused() {
        let generator = small(GeneratorConfig::default()).init(5, &Device::flex());
        let wrong = ModelMetadata::new(OutputMeaning::DisparityFraction, InputRange::Unit, 100, 64);
        let error = export(&generator, &wrong, Path::new("never.onnx")).expect_err("refused");
        assert!(error.to_string().contains("100 x 64"), "{error}");
        assert!(!Path::new("never.onnx").exists());
    }

    #[test]
    fn a_network_that_computes_no_numbers_is_refused() {
        let folder = tempfile::tempdir().expect("a folder");
        let device = Device::flex();
        let mut generator = small(GeneratorConfig {
            head: Head::Sigmoid,
            ..GeneratorConfig::default()
        })
        .init(5, &device);
        generator.encoder.conv1.bias = burn::module::Param::from_tensor(Tensor::full(
            generator.encoder.conv1.bias.val().dims(),
            f32::NAN,
            &device,
        ));
        let path = folder.path().join("broken.onnx");
        export(&generator, &metadata(), &path).expect_err("refused");
        assert!(!path.exists());
    }

    #[test]
    fn differences_count_where_values_are_no_numbers() {
        assert_eq!(largest_difference(&[1.0, 2.0], &[1.0, 2.5]), 0.5);
        assert_eq!(largest_difference(&[1.0], &[f32::NAN]), f64::INFINITY);
        assert_eq!(largest_difference(&[1.0], &[1.0, 1.0]), f64::INFINITY);
    }
}
