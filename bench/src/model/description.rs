//! What the tensors of a model mean: its own metadata, or a YAML file beside it.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use strat_onnx::{
    metadata::{InputRange, OutputMeaning},
    model::ModelFile,
};
use strat_store::{
    inputs::{self, Kind},
    resize::{Alignment, Interpolation, Kernel},
};

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

/// What becomes of the aspect of an image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Fit {
    /// The image is stretched to the width and height of the input.
    #[default]
    Stretch,
    /// The image keeps its aspect, up to rounding: the input's size follows from it, or where that is
    /// fixed, the rest is padded.
    KeepAspect,
}

/// The part of an image that a model is shown. Its map is put back to its place; elsewhere there is none.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum InputCrop {
    /// 352 rows at the bottom and 1216 columns in the middle (PROTOCOL 10.2).
    KittiBenchmark,
    /// A box in pixels of the image.
    Pixels {
        /// First row and one past the last.
        rows: [u32; 2],
        /// First column and one past the last.
        columns: [u32; 2],
    },
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
    /// Width in pixels; none where it depends on the image.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub width: Option<u32>,
    /// Height in pixels; none where it depends on the image.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub height: Option<u32>,
    /// What becomes of the aspect of an image.
    #[serde(default, skip_serializing_if = "is_default")]
    pub fit: Fit,
    /// Where the size depends on the image: what its shorter side is brought to, at least. The image
    /// keeps its size without.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shorter_side: Option<u32>,
    /// Where the size depends on the image: both sides are rounded to multiples of this.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub multiple_of: Option<u32>,
    /// Colour (R, G, B, grey levels from 0 to 255) around a picture that does not fill the input;
    /// black without.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pad: Option<[f32; 3]>,
    /// The part of the image that is shown; all of it without.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub crop: Option<InputCrop>,
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

impl InputDescription {
    /// An input of one size, in the habit of this project's own models.
    #[must_use]
    pub fn fixed(width: u32, height: u32, range: InputRange) -> Self {
        Self {
            name: None,
            width: Some(width),
            height: Some(height),
            fit: Fit::Stretch,
            shorter_side: None,
            multiple_of: None,
            pad: None,
            crop: None,
            range,
            mean: [0.0; 3],
            std: ones(),
            channels: ChannelOrder::Rgb,
            layout: Layout::Nchw,
            kernel: area(),
        }
    }

    /// The width that disparity in pixels is counted in. Where it depends on the image no output has
    /// that meaning, and this is 1.
    #[must_use]
    pub fn disparity_width(&self) -> u32 {
        self.width.unwrap_or(1)
    }

    /// The size in words.
    #[must_use]
    pub fn size_text(&self) -> String {
        match (self.width, self.height) {
            (Some(width), Some(height)) => format!("{width}x{height}"),
            _ => {
                let side = self.shorter_side.map_or_else(
                    || "as the image".to_owned(),
                    |side| format!("shorter side {side}"),
                );
                let multiple = self.multiple_of.unwrap_or(1);
                format!("{side}, multiples of {multiple}")
            }
        }
    }
}

fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
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
    /// Kernel with which a map is brought to the size of the image: `bilinear`, unless it is
    /// `opencv-cubic`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub kernel: Option<Kernel>,
    /// For that, the centres of the corner pixels coincide and not the outer edges.
    #[serde(default, skip_serializing_if = "is_default")]
    pub align_corners: bool,
    /// Depth in metres is what the numbers say times the focal length in pixels of what the network
    /// was shown, over this one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub canonical_focal_px: Option<f64>,
}

impl OutputDescription {
    /// Numbers of this meaning in the only channel, brought back as this project's own are.
    #[must_use]
    pub fn plain(meaning: OutputMeaning) -> Self {
        Self {
            name: None,
            meaning,
            sigmoid: None,
            scale: None,
            channel: 0,
            layout: Layout::Nchw,
            kernel: None,
            align_corners: false,
            canonical_focal_px: None,
        }
    }

    /// How a map is brought to the size of the image.
    pub(super) fn way_back(&self) -> (Interpolation, Alignment) {
        let interpolation = match self.kernel {
            Some(Kernel::OpencvCubic) => Interpolation::Cubic,
            _ => Interpolation::Linear,
        };
        let alignment = match self.align_corners {
            true => Alignment::Corners,
            false => Alignment::Edges,
        };
        (interpolation, alignment)
    }

    /// # Errors
    /// Values that contradict each other or are out of range; a sentence.
    pub(super) fn check(&self) -> Result<(), String> {
        if let Some(kernel) = self.kernel
            && !matches!(kernel, Kernel::Bilinear | Kernel::OpencvCubic)
        {
            return Err(format!(
                "maps are brought to the size of the image by `bilinear` (`opencv-linear`) or \
                 `opencv-cubic`, not by `{kernel}`"
            ));
        }
        if let Some(focal_px) = self.canonical_focal_px {
            if !(focal_px > 0.0 && focal_px.is_finite()) {
                return Err(format!(
                    "`canonical_focal_px` must be a positive number of pixels, not {focal_px}"
                ));
            }
            if self.encoding().meaning() != OutputMeaning::DepthM {
                return Err(format!(
                    "`canonical_focal_px` makes metres of depth, so the meaning must be depth_m, not {}",
                    self.meaning
                ));
            }
        }
        self.encoding().check()
    }

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

impl Description {
    /// # Errors
    /// What no model has, or what contradicts itself; a sentence.
    pub fn check(&self) -> Result<(), String> {
        self.input.check()?;
        self.output.check()?;
        if self.output.meaning == OutputMeaning::DisparityPx && self.input.width.is_none() {
            return Err(
                "`meaning: disparity_px` is counted in pixels of the input's width, which depends on the \
                 image here; write `width` and `height`, or another meaning"
                    .to_owned(),
            );
        }
        Ok(())
    }
}

/// Marks a line of a draft that a person has to look at.
pub(super) const TO_CONFIRM: &str = "to be confirmed";

/// How many lines of a description are still marked `to be confirmed`.
#[must_use]
pub fn unconfirmed(text: &str) -> usize {
    let notes = text.lines().filter_map(|line| line.split_once('#'));
    notes
        .filter(|(key, note)| !key.trim().is_empty() && note.contains(TO_CONFIRM))
        .count()
}

/// Where the description of a foreign model is looked for.
#[must_use]
pub fn description_path(model: &Path) -> PathBuf {
    model.with_extension("yaml")
}

/// What the model's tensors mean: the YAML file beside it when there is one (with a number), else its
/// metadata. The number is of lines that are still to be confirmed.
pub(super) fn describe(file: &ModelFile) -> Result<(Description, Option<usize>), ModelError> {
    let model = &file.path;
    let yaml = description_path(model);
    if yaml.is_file() {
        let description: Description =
            strat_store::yaml::load(&yaml).map_err(ModelError::DescriptionFile)?;
        let text = inputs::read(&yaml, Kind::Yaml).map_err(ModelError::DescriptionFile)?;
        let left = unconfirmed(&String::from_utf8_lossy(&text));
        description.check().map_err(|reason| ModelError::Metadata {
            model: yaml,
            reason,
        })?;
        return Ok((description, Some(left)));
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
    let (width, height) = (metadata.input_width, metadata.input_height);
    let description = Description {
        input: InputDescription {
            kernel,
            ..InputDescription::fixed(width, height, metadata.input_range)
        },
        output: OutputDescription::plain(metadata.output),
    };
    Ok((description, None))
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

    #[test]
    fn lines_with_a_key_are_to_be_confirmed() {
        let text =
            "# to be confirmed\na: 1  # to be confirmed\nb: 2\nc: 3  # to be confirmed: why\n";
        assert_eq!(unconfirmed(text), 2);
    }

    /// What was written before later keys existed is written as before, so that its identity stays.
    #[test]
    fn keys_that_are_not_used_are_not_written() {
        let description = Description {
            input: InputDescription::fixed(64, 32, InputRange::Unit),
            output: OutputDescription::plain(OutputMeaning::DepthM),
        };
        let text = serde_yaml::to_string(&description).unwrap();
        let keys: Vec<&str> = text
            .lines()
            .filter_map(|line| line.split(':').next())
            .collect();
        let expected = [
            "input",
            "  width",
            "  height",
            "  range",
            "  mean",
            "  - 0.0",
            "  - 0.0",
            "  - 0.0",
            "  std",
            "  - 1.0",
            "  - 1.0",
            "  - 1.0",
            "  channels",
            "  layout",
            "  kernel",
            "output",
            "  meaning",
            "  channel",
            "  layout",
        ];
        assert_eq!(keys, expected);
    }

    #[test]
    fn contradictions_are_refused_with_the_key() {
        let check = |input: &str, output: &str| {
            let text = format!("input: {{range: 0..1, {input}}}\noutput: {{meaning: {output}}}\n");
            serde_yaml::from_str::<Description>(&text).unwrap().check()
        };
        let dynamic = "fit: keep-aspect, shorter_side: 518, multiple_of: 14";
        assert_eq!(check(dynamic, "inverse_depth, align_corners: true"), Ok(()));
        assert_eq!(
            check("width: 8, height: 4", "depth_m, kernel: opencv-cubic"),
            Ok(())
        );
        for (input, output, word) in [
            ("width: 8", "depth_m", "`height`"),
            ("fit: stretch", "depth_m", "`width` and `height`"),
            (
                "width: 8, height: 4, shorter_side: 4",
                "depth_m",
                "`shorter_side`",
            ),
            (
                "width: 8, height: 4, multiple_of: 4",
                "depth_m",
                "`multiple_of`",
            ),
            ("width: 8, height: 4, pad: [0, 0, 0]", "depth_m", "`pad`"),
            ("fit: keep-aspect, pad: [0, 0, 0]", "depth_m", "`pad`"),
            (
                "fit: keep-aspect, multiple_of: 0",
                "depth_m",
                "`multiple_of`",
            ),
            ("fit: keep-aspect", "disparity_px", "disparity_px"),
            ("width: 8, height: 4", "depth_m, kernel: area", "`area`"),
            (
                "width: 8, height: 4",
                "inverse_depth, canonical_focal_px: 9",
                "depth_m",
            ),
            (
                "width: 8, height: 4",
                "depth_m, canonical_focal_px: 0",
                "positive",
            ),
            (
                "width: 8, height: 4, crop: !pixels {rows: [4, 4], columns: [0, 9]}",
                "depth_m",
                "`crop`",
            ),
        ] {
            let error = check(input, output).unwrap_err();
            assert!(error.contains(word), "{input} {output}: {error}");
        }
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
