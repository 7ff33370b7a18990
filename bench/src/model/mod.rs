//! A depth model ready to be asked: the file, what its tensors mean, and a session that runs it.
//!
//! A model of this project says in its metadata what it takes and what it gives
//! ([`strat_onnx::metadata`]). Any other ONNX depth model is described by a small YAML file of
//! the same name beside it ([`Description`]); nothing about a model is guessed from its numbers.
//!
//! Not here: where images come from and how predictions are scored; see [`crate::evaluate`].

pub mod leakage;

use std::path::{Path, PathBuf};

use image::RgbImage;
use serde::{Deserialize, Serialize};
use strat_onnx::{
    graph::{Dim, dims_text},
    metadata::{InputRange, OutputMeaning, ProbeError},
    model::{ElementType, ModelFile, ReadError, TensorInfo},
};
use strat_store::{raster::Plane, resize::Kernel};

use crate::runtime::{Device, Output, Runtime, RuntimeError, Session};

/// Largest difference to the trainer's own output that passes without a warning, in units of the
/// output. Runtimes differ by about 1e-6 of full scale; a wrong layer differs by far more.
pub const PROBE_TOLERANCE: f32 = 1e-4;

/// Why a model cannot be used, or what it did wrong.
#[derive(Debug, thiserror::Error)]
pub enum ModelError {
    /// The file was refused before any runtime saw it.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The runtime refused the model or failed.
    #[error(transparent)]
    Runtime(#[from] RuntimeError),
    /// The file beside the model could not be used.
    #[error(transparent)]
    DescriptionFile(strat_store::Error),
    /// Nobody says what the tensors mean.
    #[error(
        "{} does not say what its tensors mean, and there is no description at {}; \
         write one with the keys input (width, height, range) and output (meaning), \
         see `bench --help`",
        model.display(), yaml.display()
    )]
    Undescribed {
        /// The model file.
        model: PathBuf,
        /// Where a description was looked for.
        yaml: PathBuf,
    },
    /// The model's metadata has a value this program does not understand.
    #[error("the metadata of {} cannot be used: {reason}", model.display())]
    Metadata {
        /// The model file.
        model: PathBuf,
        /// What is wrong, as a sentence.
        reason: String,
    },
    /// The graph does not fit its description.
    #[error("{} does not fit its description: {reason}", model.display())]
    Graph {
        /// The model file.
        model: PathBuf,
        /// What does not fit.
        reason: String,
    },
    /// The model ran, but an output is missing.
    #[error("the model gave no output `{wanted}`; its outputs are {found}")]
    NoOutput {
        /// Name looked for.
        wanted: String,
        /// Names there.
        found: String,
    },
    /// The model ran, but gave another shape.
    #[error("the model's output `{name}` has the shape {found:?}, but {expected} is needed")]
    OutputShape {
        /// The output.
        name: String,
        /// Shape given.
        found: Vec<usize>,
        /// Shape needed.
        expected: String,
    },
    /// The model ran, but gave something that is not a number.
    #[error(
        "the model's output `{name}` is not a number at row {row}, column {column} \
         ({count} of {total} values are NaN or infinite)"
    )]
    NotFinite {
        /// The output.
        name: String,
        /// First such row, from 0.
        row: usize,
        /// First such column, from 0.
        column: usize,
        /// How many.
        count: usize,
        /// Of how many.
        total: usize,
    },
    /// The probe that the trainer left cannot be held against this model.
    #[error("the model's own check cannot be made: {0}")]
    Probe(#[from] ProbeError),
}

/// Order of the colour channels that a model was trained with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ChannelOrder {
    /// Red first.
    #[default]
    Rgb,
    /// Blue first.
    Bgr,
}

/// Order of a tensor's dimensions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Layout {
    /// Batch, channel, row, column (PyTorch).
    #[default]
    Nchw,
    /// Batch, row, column, channel (TensorFlow).
    Nhwc,
}

/// A sigmoid that stands for inverse depth between two limits, as monodepth2's does: a value s is
/// 1/max + (1/min - 1/max) s.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sigmoid {
    /// Depth where the sigmoid is 1, in the model's own unit.
    pub min_depth: f64,
    /// Depth where it is 0.
    pub max_depth: f64,
}

/// What numbers that speak of depth are: the part of a description that models and saved
/// predictions have in common.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Numbers {
    /// What they are, after the sigmoid and before the scale.
    pub meaning: OutputMeaning,
    /// The sigmoid that they went through.
    pub sigmoid: Option<Sigmoid>,
    /// Depth in metres is this many times the depth that the numbers say.
    pub scale: Option<f64>,
}

impl Numbers {
    /// # Errors
    /// The values contradict each other or are out of range; a sentence.
    pub fn check(&self) -> Result<(), String> {
        let inverse = matches!(
            self.meaning,
            OutputMeaning::InverseDepth | OutputMeaning::InverseDepthPerM
        );
        if let Some(Sigmoid {
            min_depth,
            max_depth,
        }) = self.sigmoid
        {
            if !inverse {
                return Err(format!(
                    "`sigmoid` makes inverse depth, so the meaning must be inverse_depth, not {}",
                    self.meaning
                ));
            }
            if !(min_depth > 0.0 && min_depth < max_depth && max_depth.is_finite()) {
                return Err(format!(
                    "`sigmoid` needs 0 < min_depth < max_depth, not {min_depth} and {max_depth}"
                ));
            }
        }
        match self.scale {
            Some(scale) if !(scale > 0.0 && scale.is_finite()) => Err(format!(
                "`scale` must be a positive number, not {scale}; a scale that is to be found \
                 image by image is left out"
            )),
            _ => Ok(()),
        }
    }

    /// What the numbers are once [`apply`](Self::apply) has been over them.
    #[must_use]
    pub fn meaning(&self) -> OutputMeaning {
        match (self.meaning, self.scale) {
            (OutputMeaning::InverseDepth, Some(_)) => OutputMeaning::InverseDepthPerM,
            (meaning, _) => meaning,
        }
    }

    /// Undoes the sigmoid and brings in the scale. Both are linear, so it does not matter whether
    /// a map is resized before or after.
    pub fn apply(&self, data: &mut [f32]) {
        let (mut factor, mut offset) = (1.0, 0.0);
        if let Some(sigmoid) = self.sigmoid {
            offset = 1.0 / sigmoid.max_depth;
            factor = 1.0 / sigmoid.min_depth - offset;
        }
        if let Some(scale) = self.scale {
            let scale = match self.meaning {
                OutputMeaning::DepthM => scale,
                _ => 1.0 / scale,
            };
            factor *= scale;
            offset *= scale;
        }
        if (factor, offset) != (1.0, 0.0) {
            for value in data {
                *value = (f64::from(*value) * factor + offset) as f32;
            }
        }
    }
}

/// What a model takes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InputDescription {
    /// Name of the input; the graph's only input when left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Interval of the colour values before normalisation.
    pub range: InputRange,
    /// Subtracted from each channel (R, G, B), in units of `range`.
    #[serde(default)]
    pub mean: [f32; 3],
    /// Each channel (R, G, B) is divided by this after `mean` was subtracted.
    #[serde(default = "ones")]
    pub std: [f32; 3],
    /// Order of the channels.
    #[serde(default)]
    pub channels: ChannelOrder,
    /// Order of the dimensions.
    #[serde(default)]
    pub layout: Layout,
    /// Kernel with which an image is brought to the input size.
    #[serde(default = "area")]
    pub kernel: Kernel,
}

fn ones() -> [f32; 3] {
    [1.0; 3]
}

fn area() -> Kernel {
    Kernel::Area
}

/// What a model gives.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OutputDescription {
    /// Name of the output; the graph's only output when left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// What its numbers are.
    pub meaning: OutputMeaning,
    /// A sigmoid to be undone first.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sigmoid: Option<Sigmoid>,
    /// Depth in metres is this many times the depth that the numbers say.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scale: Option<f64>,
    /// Which channel belongs to the left image.
    #[serde(default)]
    pub channel: usize,
    /// Order of the dimensions.
    #[serde(default)]
    pub layout: Layout,
}

impl OutputDescription {
    /// What its numbers are, before anything is done to them.
    #[must_use]
    pub fn numbers(&self) -> Numbers {
        Numbers {
            meaning: self.meaning,
            sigmoid: self.sigmoid,
            scale: self.scale,
        }
    }

    /// What the numbers of [`Model::predict`] are.
    #[must_use]
    pub fn meaning(&self) -> OutputMeaning {
        self.numbers().meaning()
    }
}

/// What the tensors of a model mean; the YAML file beside a foreign model holds exactly this.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Description {
    /// What the model takes.
    pub input: InputDescription,
    /// What the model gives.
    pub output: OutputDescription,
}

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
        let description = describe(&file)?;
        let misfit = |reason: String| ModelError::Graph {
            model: path.to_path_buf(),
            reason,
        };
        let input = pick(
            "input",
            &file.info.inputs,
            description.input.name.as_deref(),
            "image",
        )
        .map_err(misfit)?;
        check_input(input, &description.input).map_err(misfit)?;
        let output = pick(
            "output",
            &file.info.outputs,
            description.output.name.as_deref(),
            "disparity",
        )
        .map_err(misfit)?;
        let (input, output) = (input.name.clone(), output.name.clone());
        let session = runtime.load(path, device, threads)?;
        Ok(Self {
            name: name.to_owned(),
            file,
            description,
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
        let outputs = self.session.run(&self.input, shape, &probe.image())?;
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
    /// left image; its numbers are [`OutputDescription::meaning`].
    ///
    /// # Errors
    /// The runtime fails, the output is missing, has another shape, or holds NaN or infinity.
    pub fn predict(&mut self, input: &[f32]) -> Result<Plane, ModelError> {
        let output = self.run(input, 1)?;
        left_plane(output, &self.description.output)
    }

    /// The disparity of the right view as a fraction of the width, in the right view's own
    /// coordinates; `None` unless the model was trained here and gives both views.
    ///
    /// # Errors
    /// As [`predict`](Self::predict).
    pub fn predict_right(&mut self, input: &[f32]) -> Result<Option<Plane>, ModelError> {
        let left = &self.description.output;
        if self.file.info.metadata().is_none()
            || left.meaning != OutputMeaning::DisparityFraction
            || left.channel > 1
        {
            return Ok(None);
        }
        let right = OutputDescription {
            channel: 1 - left.channel,
            ..left.clone()
        };
        let output = self.run(input, 1)?;
        if !matches!(output.shape.as_slice(), &[1, 2, _, _]) {
            return Ok(None);
        }
        left_plane(output, &right).map(Some)
    }

    /// As [`predict`](Self::predict) for `count` inputs laid one behind the other; one plane each.
    ///
    /// # Errors
    /// As [`predict`](Self::predict), or the output is not one map for each image.
    pub fn predict_batch(&mut self, input: &[f32], count: usize) -> Result<Vec<Plane>, ModelError> {
        if count == 1 {
            return Ok(vec![self.predict(input)?]);
        }
        let output = self.run(input, count)?;
        let each = output.data.len() / count.max(1);
        let (first, rest) = match output.shape.split_first() {
            Some((&first, rest)) if first == count && rest.iter().product::<usize>() == each => {
                (first, rest)
            }
            _ => {
                return Err(ModelError::OutputShape {
                    expected: format!("[{count}, channels, height, width]"),
                    found: output.shape,
                    name: output.name,
                });
            }
        };
        (0..first)
            .map(|index| {
                let one = Output {
                    name: output.name.clone(),
                    shape: [&[1], rest].concat(),
                    data: output.data[index * each..(index + 1) * each].to_vec(),
                };
                left_plane(one, &self.description.output)
            })
            .collect()
    }

    /// Runs the session alone on `count` inputs and returns the output as it comes.
    ///
    /// # Errors
    /// The runtime fails or the output is missing.
    pub fn run(&mut self, input: &[f32], count: usize) -> Result<Output, ModelError> {
        let (width, height) = (
            self.description.input.width as usize,
            self.description.input.height as usize,
        );
        let shape = match self.description.input.layout {
            Layout::Nchw => [count, 3, height, width],
            Layout::Nhwc => [count, height, width, 3],
        };
        let outputs = self.session.run(&self.input, shape, input)?;
        find(outputs, &self.output)
    }
}

/// Brings an image to the input size and into the input's numbers, `[3, height, width]` or, where
/// the input is laid out so, `[height, width, 3]`.
#[must_use]
pub fn prepare_input(image: &RgbImage, input: &InputDescription) -> Vec<f32> {
    let resized;
    let image = if image.dimensions() == (input.width, input.height) {
        image
    } else {
        resized = strat_store::resize::rgb(image, input.width, input.height, input.kernel);
        &resized
    };
    let plane = input.width as usize * input.height as usize;
    let mut tensor = vec![0.0; 3 * plane];
    for (place, values) in tensor.chunks_exact_mut(plane).enumerate() {
        let channel = match input.channels {
            ChannelOrder::Rgb => place,
            ChannelOrder::Bgr => 2 - place,
        };
        let (mean, std) = (input.mean[channel], input.std[channel]);
        for (value, pixel) in values.iter_mut().zip(image.pixels()) {
            let byte = f32::from(pixel.0[channel]);
            let colour = match input.range {
                InputRange::Unit => byte / 255.0,
                InputRange::Bytes => byte,
            };
            *value = (colour - mean) / std;
        }
    }
    match input.layout {
        Layout::Nchw => tensor,
        Layout::Nhwc => {
            let [red, green, blue] = [0, 1, 2].map(|place| &tensor[place * plane..][..plane]);
            let pixels = red.iter().zip(green).zip(blue);
            pixels.flat_map(|((r, g), b)| [*r, *g, *b]).collect()
        }
    }
}

/// Mirrors an input of [`prepare_input`] left to right, in place.
pub fn mirror_input(tensor: &mut [f32], input: &InputDescription) {
    let width = input.width as usize;
    match input.layout {
        Layout::Nchw => tensor.chunks_exact_mut(width).for_each(<[f32]>::reverse),
        Layout::Nhwc => {
            for row in tensor.chunks_exact_mut(3 * width) {
                row.reverse();
                // The channels of each pixel were turned round as well.
                row.chunks_exact_mut(3).for_each(<[f32]>::reverse);
            }
        }
    }
}

/// Where the description of a foreign model is looked for.
#[must_use]
pub fn description_path(model: &Path) -> PathBuf {
    model.with_extension("yaml")
}

/// What the model's tensors mean: the YAML file beside it when there is one, else its metadata.
fn describe(file: &ModelFile) -> Result<Description, ModelError> {
    let model = &file.path;
    let yaml = description_path(model);
    if yaml.is_file() {
        let description: Description =
            strat_store::yaml::load(&yaml).map_err(ModelError::DescriptionFile)?;
        let input = &description.input;
        let usable = input.width > 0
            && input.height > 0
            && input.std.iter().all(|std| std.is_finite() && *std != 0.0)
            && input.mean.iter().all(|mean| mean.is_finite());
        if !usable {
            return Err(ModelError::Metadata {
                model: yaml,
                reason: "width and height must be at least 1, mean and std finite, std not 0"
                    .to_owned(),
            });
        }
        let numbers = description.output.numbers().check();
        numbers.map_err(|reason| ModelError::Metadata {
            model: yaml,
            reason,
        })?;
        return Ok(description);
    }
    let Some(metadata) = file.info.metadata() else {
        // Metadata that is there but damaged explains itself; nothing at all needs a file.
        return Err(match file.info.description.problems.as_slice() {
            [] => ModelError::Undescribed {
                model: model.clone(),
                yaml,
            },
            problems => ModelError::Metadata {
                model: model.clone(),
                reason: problems.join("; "),
            },
        });
    };
    let kernel = match &metadata.kernel {
        None => Kernel::Area,
        Some(name) => name.parse().map_err(|_| ModelError::Metadata {
            model: model.clone(),
            reason: format!("the resize kernel \"{name}\" is not known"),
        })?,
    };
    Ok(Description {
        input: InputDescription {
            name: None,
            width: metadata.input_width,
            height: metadata.input_height,
            range: metadata.input_range,
            mean: [0.0; 3],
            std: ones(),
            channels: ChannelOrder::Rgb,
            layout: Layout::Nchw,
            kernel,
        },
        output: OutputDescription {
            name: None,
            meaning: metadata.output,
            sigmoid: None,
            scale: None,
            channel: 0,
            layout: Layout::Nchw,
        },
    })
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

/// Finds a wrong description before an image is decoded for nothing.
fn check_input(tensor: &TensorInfo, input: &InputDescription) -> Result<(), String> {
    if let Some(element) = tensor
        .element
        .filter(|&element| element != ElementType::F32)
    {
        return Err(format!(
            "the input `{}` takes {element}, only f32 is supported",
            tensor.name
        ));
    }
    let (height, width) = (input.height as usize, input.width as usize);
    let wanted = match input.layout {
        Layout::Nchw => [1, 3, height, width],
        Layout::Nhwc => [1, height, width, 3],
    };
    let fits = tensor.dims.as_ref().is_none_or(|dims| {
        dims.len() == wanted.len()
            && dims
                .iter()
                .zip(wanted)
                .all(|(dim, size)| Dim::fixed(dim).is_none_or(|fixed| fixed == size))
    });
    if fits {
        return Ok(());
    }
    let other = match input.layout {
        Layout::Nchw => "nhwc",
        Layout::Nhwc => "nchw",
    };
    Err(format!(
        "the input `{}` has the shape {}, but {wanted:?} is to be given (width, height and \
         `layout: {other}` of the description decide)",
        tensor.name,
        tensor.dims.as_deref().map(dims_text).unwrap_or_default()
    ))
}

fn find(outputs: Vec<Output>, wanted: &str) -> Result<Output, ModelError> {
    let names: Vec<String> = outputs.iter().map(|output| output.name.clone()).collect();
    outputs
        .into_iter()
        .find(|output| output.name == wanted)
        .ok_or_else(|| ModelError::NoOutput {
            wanted: wanted.to_owned(),
            found: names.join(", "),
        })
}

/// Takes the left image's channel out of `[1, c, h, w]` or `[1, h, w, c]`, `[1, h, w]` or
/// `[h, w]`, and undoes what the description says was done to it.
fn left_plane(output: Output, description: &OutputDescription) -> Result<Plane, ModelError> {
    let channel = description.channel;
    let (channels, height, width) = match (output.shape.as_slice(), description.layout) {
        (&[1, c, h, w], Layout::Nchw) | (&[1, h, w, c], Layout::Nhwc) => (c, h, w),
        (&[1, h, w] | &[h, w], _) => (1, h, w),
        _ => (0, 0, 0),
    };
    let plane = height.saturating_mul(width);
    let start = channel.saturating_mul(plane);
    if plane == 0 || channel >= channels || output.data.len() != channels.saturating_mul(plane) {
        return Err(ModelError::OutputShape {
            expected: match description.layout {
                Layout::Nchw => format!("[1, {} or more, height, width]", channel + 1),
                Layout::Nhwc => format!("[1, height, width, {} or more]", channel + 1),
            },
            found: output.shape,
            name: output.name,
        });
    }
    let mut data = output.data;
    match description.layout {
        Layout::Nchw => {
            data.truncate(start + plane);
            data.drain(..start);
        }
        Layout::Nhwc => data = data.into_iter().skip(channel).step_by(channels).collect(),
    }
    if let Some(first) = data.iter().position(|value| !value.is_finite()) {
        return Err(ModelError::NotFinite {
            name: output.name,
            row: first / width,
            column: first % width,
            count: data.iter().filter(|value| !value.is_finite()).count(),
            total: plane,
        });
    }
    description.numbers().apply(&mut data);
    Ok(Plane {
        width,
        height,
        data,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Disparity in the given channel, channels first.
    fn channel(channel: usize) -> OutputDescription {
        OutputDescription {
            name: None,
            meaning: OutputMeaning::DisparityFraction,
            sigmoid: None,
            scale: None,
            channel,
            layout: Layout::Nchw,
        }
    }

    fn output(shape: &[usize], data: Vec<f32>) -> Output {
        Output {
            name: "disparity".to_owned(),
            shape: shape.to_vec(),
            data,
        }
    }

    #[test]
    fn the_left_plane_is_the_stated_channel() {
        let data: Vec<f32> = (0..12_u8).map(f32::from).collect();
        let plane = left_plane(output(&[1, 2, 2, 3], data.clone()), &channel(0)).unwrap();
        assert_eq!(plane.data, data[..6]);
        let plane = left_plane(output(&[1, 2, 2, 3], data.clone()), &channel(1)).unwrap();
        assert_eq!(plane.data, data[6..]);
        assert_eq!((plane.width, plane.height), (3, 2));
        let plane = left_plane(output(&[1, 3, 4], data.clone()), &channel(0)).unwrap();
        assert_eq!((plane.width, plane.height), (4, 3));
        let last = OutputDescription {
            layout: Layout::Nhwc,
            ..channel(1)
        };
        let plane = left_plane(output(&[1, 2, 3, 2], data.clone()), &last).unwrap();
        assert_eq!(plane.data, [1.0, 3.0, 5.0, 7.0, 9.0, 11.0]);
        assert_eq!((plane.width, plane.height), (3, 2));
        for (shape, number) in [(&[2, 1, 2, 3][..], 0), (&[1, 2, 2, 3], 2), (&[12], 0)] {
            let error = left_plane(output(shape, data.clone()), &channel(number)).unwrap_err();
            assert!(error.to_string().contains("shape"), "{error}");
        }
    }

    #[test]
    fn a_value_that_is_no_number_is_named_with_its_place() {
        let mut data = vec![0.1; 6];
        data[4] = f32::NAN;
        data[5] = f32::INFINITY;
        let error = left_plane(output(&[1, 1, 2, 3], data), &channel(0)).unwrap_err();
        assert!(
            error.to_string().contains("row 1, column 1 (2 of 6 values"),
            "{error}"
        );
    }

    #[test]
    fn inputs_are_normalised_by_channel() {
        let mut image = RgbImage::new(2, 1);
        image.put_pixel(0, 0, image::Rgb([255, 0, 51]));
        image.put_pixel(1, 0, image::Rgb([0, 102, 255]));
        let mut input = InputDescription {
            name: None,
            width: 2,
            height: 1,
            range: InputRange::Unit,
            mean: [0.0; 3],
            std: [1.0; 3],
            channels: ChannelOrder::Rgb,
            layout: Layout::Nchw,
            kernel: Kernel::Area,
        };
        assert_eq!(
            prepare_input(&image, &input),
            [1.0, 0.0, 0.0, 0.4, 0.2, 1.0]
        );
        input.channels = ChannelOrder::Bgr;
        input.mean = [0.5, 0.0, 0.0];
        input.std = [0.5, 1.0, 1.0];
        assert_eq!(
            prepare_input(&image, &input),
            [0.2, 1.0, 0.0, 0.4, 1.0, -1.0]
        );
        let mut tensor = prepare_input(&image, &input);
        mirror_input(&mut tensor, &input);
        assert_eq!(tensor, [1.0, 0.2, 0.4, 0.0, -1.0, 1.0]);

        input.layout = Layout::Nhwc;
        let mut tensor = prepare_input(&image, &input);
        assert_eq!(tensor, [0.2, 0.0, 1.0, 1.0, 0.4, -1.0]);
        mirror_input(&mut tensor, &input);
        assert_eq!(tensor, [1.0, 0.4, -1.0, 0.2, 0.0, 1.0]);
    }

    #[test]
    fn descriptions_refuse_unknown_keys() {
        let text = "input: {width: 64, height: 32, range: 0..1}\noutput: {meaning: depth_m}\n";
        let description: Description = serde_yaml::from_str(text).unwrap();
        assert_eq!(description.input.std, [1.0; 3]);
        assert_eq!(description.output.meaning, OutputMeaning::DepthM);
        let wrong = text.replace("meaning", "meanin");
        assert!(serde_yaml::from_str::<Description>(&wrong).is_err());
    }

    /// monodepth2's own numbers: a sigmoid between 0.1 and 100, depth times 5.4 for stereo models.
    #[test]
    fn sigmoid_and_scale_make_metres() {
        let mut numbers = Numbers {
            meaning: OutputMeaning::InverseDepth,
            sigmoid: Some(Sigmoid {
                min_depth: 0.1,
                max_depth: 100.0,
            }),
            scale: None,
        };
        assert_eq!(numbers.meaning(), OutputMeaning::InverseDepth);
        let applied = |numbers: &Numbers, value: f32| {
            numbers.check().unwrap();
            let mut data = [value];
            numbers.apply(&mut data);
            data[0]
        };
        assert_eq!(applied(&numbers, 0.0), 0.01);
        assert_eq!(applied(&numbers, 1.0), 10.0);
        numbers.scale = Some(5.4);
        assert_eq!(numbers.meaning(), OutputMeaning::InverseDepthPerM);
        // Depth 1 / (0.01 + 9.99 * 0.05) = 1.96270854 in the model's unit, 10.5986 m.
        let depth_m = 1.0 / applied(&numbers, 0.05);
        assert!((depth_m - 5.4 / 0.5095).abs() < 1e-5, "{depth_m}");

        numbers.sigmoid = None;
        assert_eq!(applied(&numbers, 2.7), 0.5);
        numbers.meaning = OutputMeaning::DepthM;
        assert_eq!(applied(&numbers, 2.0), 10.8);
        assert_eq!(numbers.meaning(), OutputMeaning::DepthM);

        numbers.scale = Some(0.0);
        assert!(numbers.check().unwrap_err().contains("positive number"));
        numbers.scale = None;
        numbers.sigmoid = Some(Sigmoid {
            min_depth: 0.1,
            max_depth: 100.0,
        });
        assert!(numbers.check().unwrap_err().contains("inverse_depth"));
        numbers.meaning = OutputMeaning::InverseDepth;
        numbers.sigmoid = Some(Sigmoid {
            min_depth: 2.0,
            max_depth: 1.0,
        });
        assert!(numbers.check().unwrap_err().contains("min_depth"));
    }
}
