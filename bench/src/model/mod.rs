//! A depth model ready to be asked: the file, what its tensors mean, and a session that runs it.
//!
//! A model of this project says in its metadata what it takes and what it gives
//! ([`strat_onnx::metadata`]). Any other ONNX depth model is described by a small YAML file of
//! the same name beside it ([`Description`]); nothing about a model is guessed from its numbers.
//!
//! Not here: where images come from and how predictions are scored; see [`crate::evaluate`].

mod description;
pub mod draft;
mod error;
mod input;
pub mod leakage;
mod output;
pub mod plausible;
pub mod vet;

use std::path::Path;

use strat_onnx::{
    metadata::OutputMeaning,
    model::{ModelFile, TensorInfo},
};
use strat_store::raster::Plane;

use crate::runtime::{Device, Output, Runtime, Session, process::Transport};
use description::describe;
use input::{check_input, tensor_text};
use output::{find, left_plane, to_image};

pub use description::{
    ChannelOrder, Description, Fit, InputCrop, InputDescription, Layout, OutputDescription,
    Sigmoid, ValueEncoding, description_path, unconfirmed,
};
pub use error::{Implausible, ModelError};
pub use input::{ModelInput, mirror_input, prepare_input};
pub use output::clear_mixed;

/// Largest difference to the trainer's own output that passes without a warning, in units of the
/// output. Runtimes differ by about 1e-6 of full scale; a wrong layer differs by far more.
pub const PROBE_TOLERANCE: f32 = 1e-4;

/// The result of running the probe that the trainer left in the file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProbeResult {
    /// Largest difference to the trainer's own output, in units of the output.
    pub max_difference: f32,
}

impl ProbeResult {
    /// The runtime computes what was trained.
    #[must_use]
    pub fn passes(self) -> bool {
        self.max_difference <= PROBE_TOLERANCE
    }
}

/// A loaded model.
#[derive(Debug)]
pub struct Model {
    /// Name used in tables.
    pub name: String,
    /// The file and what it says.
    pub file: ModelFile,
    /// What its tensors mean.
    pub description: Description,
    /// The description stands in a file beside the model, not in the model itself.
    pub is_described_beside: bool,
    /// Threads within an operation, on which the last bits of its numbers may depend.
    pub threads: usize,
    /// Lines of that description that are still to be confirmed.
    pub unconfirmed: usize,
    input: String,
    output: String,
    session: Session,
}

impl Model {
    /// Reads, checks and loads a model.
    ///
    /// # Errors
    /// The file is broken or dangerous, nobody says what its tensors mean, the graph does not fit
    /// its description, or the runtime refuses it.
    pub fn open(
        name: &str,
        path: &Path,
        runtime: &Runtime,
        device: Device,
        threads: usize,
    ) -> Result<Self, ModelError> {
        let file = strat_onnx::model::read(path)?;
        let (description, unconfirmed) = describe(&file)?;
        Ok(Self {
            is_described_beside: unconfirmed.is_some(),
            unconfirmed: unconfirmed.unwrap_or(0),
            ..Self::described(name, file, description, runtime, device, threads)?
        })
    }

    /// Loads a model that has been read, with a description that stands in no file.
    ///
    /// # Errors
    /// The graph does not fit the description, or the runtime refuses it.
    pub fn described(
        name: &str,
        file: ModelFile,
        description: Description,
        runtime: &Runtime,
        device: Device,
        threads: usize,
    ) -> Result<Self, ModelError> {
        let path = file.path.clone();
        let misfit = |reason: String| ModelError::Graph {
            model: path.clone(),
            reason,
        };
        let input = pick(
            "input",
            &file.info.inputs,
            description.input.name.as_deref(),
            "image",
        )
        .map_err(misfit)?;
        let others = file
            .info
            .inputs
            .iter()
            .filter(|other| other.name != input.name);
        let others: Vec<String> = others.map(tensor_text).collect();
        if !others.is_empty() {
            return Err(misfit(format!(
                "it takes more than an image: {}; a model that must be told the camera cannot be asked here, \
                 so export it with that input as a constant, or save its predictions (`--predictions`)",
                others.join(", ")
            )));
        }
        check_input(input, &description.input).map_err(misfit)?;
        let output = pick(
            "output",
            &file.info.outputs,
            description.output.name.as_deref(),
            "disparity",
        )
        .map_err(misfit)?;
        let (input, output) = (input.name.clone(), output.name.clone());
        let session = runtime.load(&path, device, threads)?;
        Ok(Self {
            name: name.to_owned(),
            file,
            description,
            is_described_beside: false,
            unconfirmed: 0,
            threads,
            input,
            output,
            session,
        })
    }

    /// The runtime and its version.
    #[must_use]
    pub fn runtime(&self) -> &str {
        self.session.runtime()
    }

    /// The execution provider that really runs the graph.
    #[must_use]
    pub fn provider(&self) -> &str {
        self.session.provider()
    }

    /// The process of the model has ended: nothing more comes of it.
    #[must_use]
    pub fn has_ended(&self) -> bool {
        self.session.has_ended()
    }

    /// Time that goes into the way to the process of the model and back; see [`Session::transport`].
    #[must_use]
    pub fn transport(&self) -> Transport {
        self.session.transport()
    }

    /// Runs the check that the trainer left in the file; none when the file has none.
    ///
    /// # Errors
    /// The model fails to run, or gives an output of another size.
    pub fn probe(&mut self) -> Result<Option<ProbeResult>, ModelError> {
        let Some(probe) = self
            .file
            .info
            .metadata()
            .and_then(|metadata| metadata.probe.clone())
        else {
            return Ok(None);
        };
        let shape = [1, 3, probe.height() as usize, probe.width() as usize];
        let outputs = self
            .session
            .run(&self.input, shape, &probe.image(), &self.output)?;
        let output = find(outputs, &self.output)?;
        Ok(Some(ProbeResult {
            max_difference: probe.max_difference(&output.data)?,
        }))
    }

    /// How many nodes of the graph each provider holds; see [`Session::placement`].
    #[must_use]
    pub fn placement(&self) -> &[(String, usize)] {
        self.session.placement()
    }

    /// Whether several images can be given at once: the input's first dimension is not fixed.
    #[must_use]
    pub fn takes_batches(&self) -> bool {
        let input = self.file.info.inputs.iter().find(|t| t.name == self.input);
        input.is_some_and(|tensor| {
            let batch = tensor.dims.as_ref().and_then(|dims| dims.first());
            batch.is_none_or(|dim| dim.fixed().is_none())
        })
    }

    /// Runs the model on an input of [`prepare_input`] and returns the plane that belongs to the
    /// left image; its numbers are [`OutputDescription::meaning`]. It is as large as the network's
    /// output where it shows the whole image and is to be resized bilinearly, as all maps are, and as
    /// large as the image where the description says otherwise (a crop, padding, another kernel,
    /// `align_corners`); 0 where the model was not shown the image.
    ///
    /// # Errors
    /// The runtime fails, the output is missing, has another shape, holds NaN or infinity, cannot
    /// be what it is said to be, or needs a focal length that is not known.
    pub fn predict(&mut self, input: &ModelInput) -> Result<Plane, ModelError> {
        let output = self.run(&input.tensor, input.size, 1)?;
        self.plane(output, input)
    }

    fn plane(&self, output: Output, input: &ModelInput) -> Result<Plane, ModelError> {
        let description = &self.description.output;
        let plane = left_plane(output, input.size, description)?;
        to_image(plane, input, description)
    }

    /// The disparity of the right view as a fraction of the width, in the right view's own
    /// coordinates; `None` unless the model was trained here and gives both views.
    ///
    /// # Errors
    /// As [`predict`](Self::predict).
    pub fn predict_right(&mut self, input: &ModelInput) -> Result<Option<Plane>, ModelError> {
        let left = &self.description.output;
        if self.file.info.metadata().is_none()
            || left.meaning != OutputMeaning::DisparityFraction
            || left.channel > 1
            || !input.is_whole()
        {
            return Ok(None);
        }
        let right = OutputDescription {
            channel: 1 - left.channel,
            ..left.clone()
        };
        let output = self.run(&input.tensor, input.size, 1)?;
        if !matches!(output.shape.as_slice(), &[1, 2, _, _]) {
            return Ok(None);
        }
        left_plane(output, input.size, &right).map(Some)
    }

    /// As [`predict`](Self::predict) for several inputs of one size at once; one plane each.
    ///
    /// # Errors
    /// As [`predict`](Self::predict), or the output is not one map for each image.
    pub fn predict_batch(&mut self, inputs: &[&ModelInput]) -> Result<Vec<Plane>, ModelError> {
        let &[first, ..] = inputs else {
            return Ok(Vec::new());
        };
        let count = inputs.len();
        if count == 1 {
            return Ok(vec![self.predict(first)?]);
        }
        let tensors: Vec<&[f32]> = inputs.iter().map(|input| &*input.tensor).collect();
        let output = self.run(&tensors.concat(), first.size, count)?;
        let each = output.data.len() / count.max(1);
        let rest = match output.shape.split_first() {
            Some((&first, rest)) if first == count && rest.iter().product::<usize>() == each => {
                rest
            }
            _ => {
                return Err(ModelError::OutputShape {
                    expected: format!("[{count}, channels, height, width]"),
                    found: output.shape,
                    name: output.name,
                });
            }
        };
        let planes = inputs.iter().enumerate();
        planes
            .map(|(index, input)| {
                let one = Output {
                    name: output.name.clone(),
                    shape: [&[1], rest].concat(),
                    data: output.data[index * each..(index + 1) * each].to_vec(),
                };
                self.plane(one, input)
            })
            .collect()
    }

    /// The output as it comes, and the map that is read from it before anything is said of its meaning.
    ///
    /// # Errors
    /// The runtime fails, or the output is missing.
    pub fn look(
        &mut self,
        input: &ModelInput,
    ) -> Result<(Output, Result<Plane, ModelError>), ModelError> {
        let output = self.run(&input.tensor, input.size, 1)?;
        let meaningless = OutputDescription {
            sigmoid: None,
            scale: None,
            meaning: OutputMeaning::InverseDepth,
            ..self.description.output.clone()
        };
        let map = left_plane(output.clone(), input.size, &meaningless);
        Ok((output, map))
    }

    /// Dimensions of `count` tensors of a size, width and height.
    fn shape(&self, size: (u32, u32), count: usize) -> [usize; 4] {
        let (width, height) = (size.0 as usize, size.1 as usize);
        match self.description.input.layout {
            Layout::Nchw => [count, 3, height, width],
            Layout::Nhwc => [count, height, width, 3],
        }
    }

    /// Runs the session alone on `count` tensors of a size, width and height, and returns the output as
    /// it comes.
    ///
    /// # Errors
    /// The runtime fails or the output is missing.
    pub fn run(
        &mut self,
        tensors: &[f32],
        size: (u32, u32),
        count: usize,
    ) -> Result<Output, ModelError> {
        let shape = self.shape(size, count);
        let outputs = self
            .session
            .run(&self.input, shape, tensors, &self.output)?;
        find(outputs, &self.output)
    }
}

/// The tensor of that name, or the only one, or the one with this project's usual name.
fn pick<'a>(
    what: &str,
    tensors: &'a [TensorInfo],
    name: Option<&str>,
    usual: &str,
) -> Result<&'a TensorInfo, String> {
    let found = match (name, tensors) {
        (Some(name), _) => tensors.iter().find(|tensor| tensor.name == name),
        (None, [only]) => Some(only),
        (None, _) => tensors.iter().find(|tensor| tensor.name == usual),
    };
    found.ok_or_else(|| {
        let names: Vec<&str> = tensors.iter().map(|tensor| tensor.name.as_str()).collect();
        format!(
            "it has no {what} `{}`; its {what}s are {names:?}",
            name.unwrap_or(usual)
        )
    })
}
