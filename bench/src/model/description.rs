//! What the tensors of a model mean: its own metadata, or a YAML file beside it.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use strat_onnx::{
    metadata::{InputRange, OutputMeaning},
    model::ModelFile,
};
use strat_store::resize::Kernel;

use super::error::ModelError;

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
pub struct ValueEncoding {
    /// What they are, after the sigmoid and before the scale.
    pub meaning: OutputMeaning,
    /// The sigmoid that they went through.
    pub sigmoid: Option<Sigmoid>,
    /// Depth in metres is this many times the depth that the numbers say.
    pub scale: Option<f64>,
}

impl ValueEncoding {
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
            (OutputMeaning::Depth, Some(_)) => OutputMeaning::DepthM,
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
                OutputMeaning::Depth | OutputMeaning::DepthM => scale,
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
    pub fn encoding(&self) -> ValueEncoding {
        ValueEncoding {
            meaning: self.meaning,
            sigmoid: self.sigmoid,
            scale: self.scale,
        }
    }

    /// What the numbers of [`Model::predict`](super::Model::predict) are.
    #[must_use]
    pub fn meaning(&self) -> OutputMeaning {
        self.encoding().meaning()
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

/// Where the description of a foreign model is looked for.
#[must_use]
pub fn description_path(model: &Path) -> PathBuf {
    model.with_extension("yaml")
}

/// What the model's tensors mean: the YAML file beside it when there is one (`true`), else its
/// metadata.
pub(super) fn describe(file: &ModelFile) -> Result<(Description, bool), ModelError> {
    let model = &file.path;
    let yaml = description_path(model);
    if yaml.is_file() {
        let description: Description =
            strat_store::yaml::load(&yaml).map_err(ModelError::DescriptionFile)?;
        let checked = description.input.check();
        let checked = checked.and_then(|()| description.output.encoding().check());
        checked.map_err(|reason| ModelError::Metadata {
            model: yaml,
            reason,
        })?;
        return Ok((description, true));
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
    let description = Description {
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
    };
    Ok((description, false))
}

#[cfg(test)]
mod tests {
    use super::*;

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
        let mut numbers = ValueEncoding {
            meaning: OutputMeaning::InverseDepth,
            sigmoid: Some(Sigmoid {
                min_depth: 0.1,
                max_depth: 100.0,
            }),
            scale: None,
        };
        assert_eq!(numbers.meaning(), OutputMeaning::InverseDepth);
        let applied = |numbers: &ValueEncoding, value: f32| {
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
        numbers.meaning = OutputMeaning::Depth;
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
