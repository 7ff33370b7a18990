//! Writes a trained discriminator as an ONNX file, for a look at what it makes of patches.
//!
//! Input `patches` `[N, 3, patch, patch]` in 0..1, output `logits` `[N, 1, g, g]`, without dropout, as no
//! training pass was. The file appears only where the embedded runtime gives the logits of burn.

use std::path::Path;

use burn::module::Module;
use burn::tensor::{Tensor, TensorData};
use strat_onnx::embedded::EmbeddedSession;
use strat_onnx::graph::{Geometry, GraphBuilder, GraphError, Value};
use strat_onnx::metadata::{DiscriminatorMetadata, probe_image};

use super::{ExportError, RANDOM_PICTURES, accept, filter, largest_of_runs, random_pictures};
use crate::kernels::activation::LEAK;
use crate::network::discriminator::{Discriminator, Layers};
use crate::network::layers::{Convolution, InstanceNorm, values_of};

/// Largest difference of a logit between burn and the written file that is accepted. Instance
/// normalisation of a map of few pixels enlarges the last bits of what it is given.
pub const TOLERANCE: f64 = 1e-3;

const INPUT: &str = "patches";
const OUTPUT: &str = "logits";

/// Writes `discriminator` to `path` for patches of the size in `metadata`, whose fields `parity` and
/// `expected` are filled here. Returns the parity: the largest difference of a logit between burn and the
/// embedded runtime.
///
/// # Errors
/// The patches are too small, the runtime differs by more than [`TOLERANCE`], or the file cannot be
/// written. No file appears then.
pub fn export(
    discriminator: &Discriminator,
    metadata: &DiscriminatorMetadata,
    path: &Path,
) -> Result<f64, ExportError> {
    let discriminator = discriminator.valid();
    let patch = metadata.patch as usize;
    if Discriminator::grid(patch).is_none() {
        return Err(ExportError::Patch {
            patch: metadata.patch,
        });
    }
    let probe = probe_image(metadata.patch, metadata.patch);
    let random = random_pictures(RANDOM_PICTURES * 3 * patch * patch);
    let logits = compute(&discriminator, &probe, [1, patch]);
    let mut metadata = DiscriminatorMetadata {
        expected: logits.clone(),
        ..metadata.clone()
    };
    let name = path.display().to_string();
    let session =
        EmbeddedSession::from_bytes(model_bytes(&discriminator, &metadata)?, &name, None)?;
    let of_random = compute(&discriminator, &random, [RANDOM_PICTURES, patch]);
    let parity = largest_of_runs(
        &session,
        INPUT,
        [patch, patch],
        [(&probe, 1, &logits), (&random, RANDOM_PICTURES, &of_random)],
    )?;
    let what = "the logits of the exported discriminator differ from the trained one's";
    accept(parity, TOLERANCE, what, path)?;
    metadata.parity = parity;
    strat_store::files::write_atomic(path, &model_bytes(&discriminator, &metadata)?)?;
    Ok(parity)
}

/// Logits of `[batch, 3, patch, patch]`.
fn compute(discriminator: &Discriminator, patches: &[f32], [batch, patch]: [usize; 2]) -> Vec<f32> {
    let device = discriminator.last.weight.val().device();
    let patches = TensorData::new(patches.to_vec(), [batch, 3, patch, patch]);
    values_of(discriminator.forward(Tensor::from_data(patches, &device)))
}

fn model_bytes(
    discriminator: &Discriminator,
    metadata: &DiscriminatorMetadata,
) -> Result<Vec<u8>, GraphError> {
    let side = metadata.patch as usize;
    let mut graph = GraphBuilder::new("strat discriminator");
    let patches = graph.input(INPUT, &["N".into(), 3.into(), side.into(), side.into()])?;
    let mut layers = GraphLayers(graph);
    let logits = discriminator.run_with(&mut layers, Ok(patches))?;
    let mut graph = layers.0;
    graph.output(OUTPUT, logits)?;
    graph.finish_with(metadata.to_props(), Some(metadata.tool_version.clone()))
}

/// [`Layers`] that appends nodes to a graph; the first error is what the last layer gives.
struct GraphLayers(GraphBuilder);

impl Layers for GraphLayers {
    type Value = Result<Value, GraphError>;

    fn conv(&mut self, name: &str, layer: &Convolution, input: Self::Value) -> Self::Value {
        let geometry = Geometry::new(layer.stride, layer.padding);
        self.0.conv(name, input?, filter(layer.weights()), geometry)
    }

    fn norm_leaky(&mut self, name: &str, layer: &InstanceNorm, input: Self::Value) -> Self::Value {
        let [scale, shift] = [&layer.scale, &layer.shift].map(|values| values_of(values.val()));
        let epsilon = InstanceNorm::EPSILON as f32;
        let normal = self
            .0
            .instance_norm(name, input?, [&scale, &shift], epsilon)?;
        self.0.leaky_relu(&format!("{name}.leaky"), normal, LEAK)
    }
}

#[cfg(test)]
mod tests {
    use burn::module::Param;
    use burn::tensor::Device;

    use super::*;
    use crate::network::discriminator::DiscriminatorConfig;
    use crate::network::layers::Width;

    fn metadata(patch: u32) -> DiscriminatorMetadata {
        DiscriminatorMetadata {
            patch,
            image_width: 256,
            image_height: 128,
            kernel: "area".to_owned(),
            train_data_digest: "00".to_owned(),
            variant: "strat".to_owned(),
            seed: 1,
            epoch: 2,
            tool_version: "0.0.0".to_owned(),
            parity: 0.0,
            expected: Vec::new(),
        }
    }

    fn small(device: &Device) -> Discriminator {
        let width = Width::new(1, 16).expect("a valid width");
        DiscriminatorConfig { width }.init(7, device)
    }

    /// Also where scales and shifts are not those of a new network.
    #[test]
    fn exported_discriminators_compute_what_burn_computes() {
        let folder = tempfile::tempdir().expect("a folder");
        let device = Device::flex();
        let mut network = small(&device.clone().autodiff());
        for (stage, number) in network.stages.iter_mut().zip(1..) {
            let channels = stage.norm.scale.val().dims()[0];
            let values = |offset: f32| {
                let values: Vec<f32> = (0..channels)
                    .map(|c| offset + (c as f32 * 0.7 + number as f32).sin())
                    .collect();
                Tensor::<1>::from_data(TensorData::new(values, [channels]), &device).autodiff()
            };
            stage.norm.scale = Param::from_tensor(values(1.2));
            stage.norm.shift = Param::from_tensor(values(0.1));
        }
        for (patch, grid) in [(64, 1), (128, 3)] {
            let path = folder.path().join(format!("{patch}.onnx"));
            let parity = export(&network, &metadata(patch), &path).expect("the export succeeds");
            assert!(parity < 1e-4, "{patch}: {parity:e}");

            let model = strat_onnx::model::read(&path).expect("the file is sound");
            assert_eq!(model.info.metadata(), None, "it is no depth model");
            let kept = model.info.discriminator().expect("sound").expect("keys");
            assert_eq!(kept.parity, parity);
            let session = EmbeddedSession::load(&path, None).expect("the file loads");
            let side = patch as usize;
            let outputs = session
                .run(INPUT, &[1, 3, side, side], &kept.probe_image())
                .expect("the model runs");
            assert_eq!(outputs[0].1, [1, 1, grid, grid]);
            let difference = kept.max_difference(&outputs[0].2);
            assert!(difference < 1e-4, "{patch}: {difference:e}");
        }
    }

    #[test]
    fn patches_that_are_too_small_are_refused() {
        let error = export(
            &small(&Device::flex()),
            &metadata(63),
            Path::new("never.onnx"),
        );
        let error = error.expect_err("refused").to_string();
        assert!(error.contains("63 px"), "{error}");
    }

    #[test]
    fn a_network_that_computes_no_numbers_is_refused() {
        let folder = tempfile::tempdir().expect("a folder");
        let device = Device::flex();
        let mut network = small(&device);
        network.last.bias = Param::from_tensor(Tensor::full([1], f32::NAN, &device));
        let path = folder.path().join("broken.onnx");
        let error = export(&network, &metadata(64), &path).expect_err("refused");
        assert!(matches!(error, ExportError::Parity { .. }), "{error}");
        assert!(!path.exists());
    }
}
