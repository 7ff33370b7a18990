//! Keys and values of a description, written and read.

use std::str::FromStr;

use serde::{Deserialize, Serialize};

use super::camera::TrainingCamera;
use super::probe::{PROBE_IMAGE, PROBE_POINTS, Probe};
use super::words::{InputRange, OutputMeaning, Weights};
use crate::proto::StringStringEntryProto;

/// Version of the keys that this program writes.
pub const FORMAT: u32 = 1;
const PREFIX: &str = "strat.";

/// What `train` tells `bench` about a model.
///
/// The first four fields decide how the model is used; without them the description is refused.
/// The others say where the model came from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ModelMetadata {
    /// What the output means.
    pub output: OutputMeaning,
    /// Interval of the input's colour values.
    pub input_range: InputRange,
    /// Width of the input in pixels.
    pub input_width: u32,
    /// Height of the input in pixels.
    pub input_height: u32,
    /// Kernel that the training images were resized with, as `prep` names it.
    pub kernel: Option<String>,
    /// Digest of the prepared set that the model was trained on.
    pub train_data_digest: Option<String>,
    /// Name of the split, as `prep` names it.
    pub split: Option<String>,
    /// Drives that the training images come from, so that an evaluation can tell whether it asks
    /// for places the model has seen. Empty when unknown.
    pub train_drives: Vec<String>,
    /// Where the training images came from: `kitti`, `rendered` or the name of a collection. None where
    /// unknown, or where the weights began with those of another training.
    #[serde(default)]
    pub train_source: Option<String>,
    /// BLAKE3 of the weights that the training began with, where it is unknown what those were
    /// trained on: `train_drives` is then not the whole list.
    #[serde(default)]
    pub unknown_start: Option<String>,
    /// The cameras of the training pairs; none where the set does not know them.
    #[serde(default)]
    pub camera: Option<TrainingCamera>,
    /// Name of the training variant.
    pub variant: Option<String>,
    /// Seed of the training run.
    pub seed: Option<u64>,
    /// Number of epochs that were completed.
    pub epoch: Option<u32>,
    /// Version of the program that wrote the file.
    pub tool_version: Option<String>,
    /// How the weights are stored.
    #[serde(default)]
    pub weights: Weights,
    /// Largest difference on the probe image between the training framework and the written file
    /// run by the embedded runtime, in units of the output.
    pub parity: Option<f64>,
    /// Expected output for a closed-form input.
    pub probe: Option<Probe>,
}

/// The result of reading metadata that may be absent or damaged.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Reading {
    /// The description, if the file has one that can be used.
    pub metadata: Option<ModelMetadata>,
    /// A sentence for every value that could not be used.
    pub problems: Vec<String>,
}

impl ModelMetadata {
    /// A description with the fields that are always needed; the rest is empty.
    #[must_use]
    pub const fn new(
        output: OutputMeaning,
        input_range: InputRange,
        input_width: u32,
        input_height: u32,
    ) -> Self {
        Self {
            output,
            input_range,
            input_width,
            input_height,
            kernel: None,
            train_data_digest: None,
            split: None,
            train_drives: Vec::new(),
            train_source: None,
            unknown_start: None,
            camera: None,
            variant: None,
            seed: None,
            epoch: None,
            tool_version: None,
            weights: Weights::F32,
            parity: None,
            probe: None,
        }
    }

    /// Keys and values in a fixed order; absent fields have no key.
    #[must_use]
    pub fn to_props(&self) -> Vec<(String, String)> {
        let mut props = Vec::new();
        let mut put = |key: &str, value: Option<String>| {
            if let Some(value) = value {
                props.push((format!("{PREFIX}{key}"), value));
            }
        };
        put("format", Some(FORMAT.to_string()));
        put("output", Some(self.output.to_string()));
        put("input_range", Some(self.input_range.to_string()));
        put("input_width", Some(self.input_width.to_string()));
        put("input_height", Some(self.input_height.to_string()));
        put("kernel", self.kernel.clone());
        put("train_data_digest", self.train_data_digest.clone());
        put("split", self.split.clone());
        put(
            "train_drives",
            (!self.train_drives.is_empty()).then(|| self.train_drives.join(" ")),
        );
        put("train_source", self.train_source.clone());
        put("unknown_start", self.unknown_start.clone());
        if let Some(camera) = &self.camera {
            put(
                "train_focal_fraction",
                Some(camera.focal_fraction.to_string()),
            );
            put("train_baseline_m", Some(camera.baseline_m.to_string()));
        }
        put("variant", self.variant.clone());
        put("seed", self.seed.map(|seed| seed.to_string()));
        put("epoch", self.epoch.map(|epoch| epoch.to_string()));
        put("tool_version", self.tool_version.clone());
        // Plain weights have no key, as in files that know of no others.
        put(
            "weights",
            (self.weights != Weights::F32).then(|| self.weights.to_string()),
        );
        put("parity", self.parity.map(|parity| parity.to_string()));
        if let Some(probe) = &self.probe {
            put("probe.image", Some(PROBE_IMAGE.to_owned()));
            put("probe.width", Some(probe.width.to_string()));
            put("probe.height", Some(probe.height.to_string()));
            put("probe.expected", Some(numbers_to_text(&probe.expected)));
        }
        // Properties end the file, so a file cut there still decodes; the count tells.
        props.push((format!("{PREFIX}keys"), (props.len() + 1).to_string()));
        props
    }

    pub(crate) fn is_own_key(key: &str) -> bool {
        key.starts_with(PREFIX)
    }

    pub(crate) fn to_entries(&self) -> Vec<StringStringEntryProto> {
        let entry = |(key, value)| StringStringEntryProto::new(key, value);
        self.to_props().into_iter().map(entry).collect()
    }

    /// Reads keys and values of a model file. Keys of others are ignored.
    #[must_use]
    pub fn from_props<'a>(props: impl IntoIterator<Item = (&'a str, &'a str)>) -> Reading {
        let mut fields = Fields {
            props: props
                .into_iter()
                .filter_map(|(key, value)| Some((key.strip_prefix(PREFIX)?, value)))
                .collect(),
            problems: Vec::new(),
        };
        if fields.props.is_empty() {
            return Reading::default();
        }
        match fields.parse::<u32>("format", "a version number") {
            Some(format) if format > FORMAT => fields.problems.push(format!(
                "the description has format {format}, this program knows up to {FORMAT}; newer fields are ignored"
            )),
            Some(_) => {}
            None if fields.get("format").is_none() => {
                fields.problems.push(format!("\"{PREFIX}format\" is missing"));
            }
            None => {}
        }
        match fields.parse::<usize>("keys", "a number of keys") {
            Some(keys) if keys == fields.props.len() => {}
            Some(keys) => fields.problems.push(format!(
                "the description has {} of {keys} keys; the file was cut or edited",
                fields.props.len()
            )),
            None if fields.get("keys").is_some() => {}
            None => fields.problems.push(format!(
                "the description has no end mark \"{PREFIX}keys\"; the file was cut or edited"
            )),
        }
        let output = fields.required("output", "an output meaning");
        let input_range = fields.required("input_range", "an input range");
        let input_width = fields.required("input_width", "a number of pixels");
        let input_height = fields.required("input_height", "a number of pixels");
        let metadata = (|| {
            let mut metadata =
                ModelMetadata::new(output?, input_range?, input_width?, input_height?);
            if metadata.input_width == 0 || metadata.input_height == 0 {
                fields.problems.push(format!(
                    "the input size {} x {} is empty",
                    metadata.input_width, metadata.input_height
                ));
                return None;
            }
            metadata.kernel = fields.text("kernel");
            metadata.train_data_digest = fields.text("train_data_digest");
            metadata.split = fields.text("split");
            metadata.train_drives = fields
                .get("train_drives")
                .map(|names| names.split_whitespace().map(str::to_owned).collect())
                .unwrap_or_default();
            metadata.train_source = fields.text("train_source");
            metadata.unknown_start = fields.text("unknown_start");
            metadata.camera = fields.camera();
            metadata.variant = fields.text("variant");
            metadata.seed = fields.parse("seed", "a whole number");
            metadata.epoch = fields.parse("epoch", "a whole number");
            metadata.tool_version = fields.text("tool_version");
            metadata.weights = fields
                .parse("weights", "a kind of weights")
                .unwrap_or_default();
            metadata.parity = fields
                .parse("parity", "a number")
                .filter(|p: &f64| !p.is_nan());
            metadata.probe = fields.probe();
            Some(metadata)
        })();
        Reading {
            metadata,
            problems: fields.problems,
        }
    }
}

struct Fields<'a> {
    props: Vec<(&'a str, &'a str)>,
    problems: Vec<String>,
}

impl<'a> Fields<'a> {
    fn get(&self, key: &str) -> Option<&'a str> {
        let found = self.props.iter().find(|(name, _)| *name == key);
        found.map(|(_, value)| *value)
    }

    fn text(&self, key: &str) -> Option<String> {
        self.get(key).map(str::to_owned)
    }

    fn parse<T: FromStr>(&mut self, key: &str, kind: &str) -> Option<T> {
        let text = self.get(key)?;
        let value = text.parse().ok();
        if value.is_none() {
            let shown = shorten(text);
            self.problems.push(format!(
                "\"{PREFIX}{key}\" is \"{shown}\", which is not {kind}"
            ));
        }
        value
    }

    fn required<T: FromStr>(&mut self, key: &str, kind: &str) -> Option<T> {
        if self.get(key).is_none() {
            self.problems.push(format!("\"{PREFIX}{key}\" is missing"));
        }
        self.parse(key, kind)
    }

    fn camera(&mut self) -> Option<TrainingCamera> {
        let kind = "a number or a mean between its bounds";
        let focal_fraction = self.parse("train_focal_fraction", kind);
        let baseline_m = self.parse("train_baseline_m", kind);
        Some(TrainingCamera {
            focal_fraction: focal_fraction?,
            baseline_m: baseline_m?,
        })
    }

    fn probe(&mut self) -> Option<Probe> {
        let image = self.get("probe.image")?;
        if image != PROBE_IMAGE {
            let shown = shorten(image);
            self.problems.push(format!(
                "the probe uses the image \"{shown}\", this program knows \"{PROBE_IMAGE}\""
            ));
            return None;
        }
        let width = self.required("probe.width", "a number of pixels")?;
        let height = self.required("probe.height", "a number of pixels")?;
        let Some(text) = self.get("probe.expected") else {
            self.problems
                .push(format!("\"{PREFIX}probe.expected\" is missing"));
            return None;
        };
        let expected: Option<Vec<f32>> = text
            .split_ascii_whitespace()
            .map(|number| number.parse().ok().filter(|value: &f32| value.is_finite()))
            .collect();
        match expected {
            Some(expected) if expected.len() == 2 * PROBE_POINTS && width > 0 && height > 0 => {
                Some(Probe {
                    width,
                    height,
                    expected,
                })
            }
            _ => {
                self.problems.push(format!(
                    "\"{PREFIX}probe.expected\" does not hold {} numbers for an image of at least one pixel",
                    2 * PROBE_POINTS
                ));
                None
            }
        }
    }
}

/// Cuts a foreign value for a message.
fn shorten(text: &str) -> String {
    const LONGEST: usize = 40;
    if text.chars().count() <= LONGEST {
        return text.to_owned();
    }
    let start: String = text.chars().take(LONGEST).collect();
    format!("{start}...")
}

fn numbers_to_text(numbers: &[f32]) -> String {
    // Rust prints the shortest decimal that reads back as the same f32.
    let numbers: Vec<String> = numbers.iter().map(f32::to_string).collect();
    numbers.join(" ")
}
