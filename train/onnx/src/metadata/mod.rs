//! What a model file says about itself, and a probe that any runtime can be checked with.
//!
//! Stored in ONNX `metadata_props` under keys that begin with `strat.`; [`FORMAT`] is their
//! version. Files of other programs have none of these keys, and a damaged value must not make a
//! model unusable: reading returns what is sound together with a sentence for each value that is
//! not. What the output of a foreign model means is not guessed here; `bench` has a description
//! file for that.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::proto::StringStringEntryProto;

/// Version of the keys that this program writes.
pub const FORMAT: u32 = 1;
const PREFIX: &str = "strat.";

/// What the numbers in a model's output are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum OutputMeaning {
    /// Disparity as a fraction of the image width.
    DisparityFraction,
    /// Disparity in pixels of the network's input.
    DisparityPx,
    /// Inverse depth up to an unknown scale.
    InverseDepth,
    /// Inverse depth in 1/m.
    InverseDepthPerM,
    /// Depth in metres.
    DepthM,
}

impl OutputMeaning {
    /// Every meaning, in the order of the documentation.
    pub const ALL: [Self; 5] = [
        Self::DisparityFraction,
        Self::DisparityPx,
        Self::InverseDepth,
        Self::InverseDepthPerM,
        Self::DepthM,
    ];

    /// The word used in files.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::DisparityFraction => "disparity_fraction",
            Self::DisparityPx => "disparity_px",
            Self::InverseDepth => "inverse_depth",
            Self::InverseDepthPerM => "inverse_depth_per_m",
            Self::DepthM => "depth_m",
        }
    }
}

/// The interval that the colour values of the input cover.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum InputRange {
    /// 8-bit values divided by 255.
    #[serde(rename = "0..1")]
    Unit,
    /// 8-bit values as they are.
    #[serde(rename = "0..255")]
    Bytes,
}

impl InputRange {
    /// The text used in files.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Unit => "0..1",
            Self::Bytes => "0..255",
        }
    }
}

/// How a file stores the weights of its convolutions; everything is computed in `f32`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Weights {
    /// As they were trained.
    #[default]
    F32,
    /// Rounded to half precision, half the size.
    F16,
}

impl Weights {
    /// The text used in files.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::F32 => "f32",
            Self::F16 => "f16",
        }
    }
}

macro_rules! text_enum {
    ($name:ident, $what:literal, [$($value:expr),+]) => {
        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(self.as_str())
            }
        }

        impl FromStr for $name {
            type Err = String;

            fn from_str(text: &str) -> Result<Self, String> {
                let known = [$($value),+];
                known.into_iter().find(|value| value.as_str() == text).ok_or_else(|| {
                    let known: Vec<&str> = known.iter().map(|value| value.as_str()).collect();
                    format!("\"{text}\" is not a known {}; known are {}", $what, known.join(", "))
                })
            }
        }
    };
}

text_enum!(
    OutputMeaning,
    "output meaning",
    [
        OutputMeaning::DisparityFraction,
        OutputMeaning::DisparityPx,
        OutputMeaning::InverseDepth,
        OutputMeaning::InverseDepthPerM,
        OutputMeaning::DepthM
    ]
);
text_enum!(Weights, "kind of weights", [Weights::F32, Weights::F16]);
text_enum!(
    InputRange,
    "input range",
    [InputRange::Unit, InputRange::Bytes]
);

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
    /// BLAKE3 of the weights that the training began with, where it is unknown what those were
    /// trained on: `train_drives` is then not the whole list.
    #[serde(default)]
    pub unknown_start: Option<String>,
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
            unknown_start: None,
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
        put("unknown_start", self.unknown_start.clone());
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
            metadata.unknown_start = fields.text("unknown_start");
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

/// Name and version of the formula behind [`probe_image`].
const PROBE_IMAGE: &str = "triangles-1";
const PROBE_GRID: u32 = 8;
const PROBE_POINTS: usize = (PROBE_GRID * PROBE_GRID) as usize;

/// Expected outputs for a closed-form input, so that any runtime or provider can be held against
/// the training framework without a picture at hand.
///
/// The input is [`probe_image`]; the outputs are those of the left and the right map at the
/// centres of an 8 x 8 division of the image.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Probe {
    width: u32,
    height: u32,
    /// 64 values of the left map in row-major order, then 64 of the right one.
    expected: Vec<f32>,
}

/// Why a probe could not be used.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub enum ProbeError {
    /// The output has another size.
    #[error(
        "the probe needs an output of 2 maps of {width} x {height} pixels, {expected} values; the model gave {found}"
    )]
    Size {
        /// Width of the probe image.
        width: u32,
        /// Height of the probe image.
        height: u32,
        /// Number of values wanted.
        expected: usize,
        /// Number of values given.
        found: usize,
    },
    /// The model computes something that is no number.
    #[error("the model's output for the probe image is not finite at row {row}, column {column}")]
    NotFinite {
        /// Row of the first such value.
        row: usize,
        /// Column of the first such value.
        column: usize,
    },
}

impl Probe {
    /// Keeps the output `[1, 2, height, width]` that belongs to [`probe_image`] of that size.
    ///
    /// # Errors
    /// The output has another size or a value at a probed position is not finite.
    pub fn record(width: u32, height: u32, output: &[f32]) -> Result<Self, ProbeError> {
        let expected = sample(width, height, output)?;
        for (index, value) in expected.iter().enumerate() {
            if !value.is_finite() {
                let (row, column) = position(width, height, index % PROBE_POINTS);
                return Err(ProbeError::NotFinite { row, column });
            }
        }
        Ok(Self {
            width,
            height,
            expected,
        })
    }

    /// Width of the probe image in pixels.
    #[must_use]
    pub const fn width(&self) -> u32 {
        self.width
    }

    /// Height of the probe image in pixels.
    #[must_use]
    pub const fn height(&self) -> u32 {
        self.height
    }

    /// The input that the expected values belong to, `[1, 3, height, width]`.
    #[must_use]
    pub fn image(&self) -> Vec<f32> {
        probe_image(self.width, self.height)
    }

    /// Largest absolute difference to the recorded values; infinite where the output is not a
    /// number.
    ///
    /// # Errors
    /// The output has another size.
    pub fn max_difference(&self, output: &[f32]) -> Result<f32, ProbeError> {
        let found = sample(self.width, self.height, output)?;
        let difference = |(found, expected): (&f32, &f32)| {
            let difference = (found - expected).abs();
            if difference.is_nan() {
                f32::INFINITY
            } else {
                difference
            }
        };
        Ok(found
            .iter()
            .zip(&self.expected)
            .map(difference)
            .fold(0.0, f32::max))
    }
}

fn position(width: u32, height: u32, point: usize) -> (usize, usize) {
    let grid = PROBE_GRID as usize;
    let centre = |index: usize, size: u32| (2 * index + 1) * size as usize / (2 * grid);
    (centre(point / grid, height), centre(point % grid, width))
}

fn sample(width: u32, height: u32, output: &[f32]) -> Result<Vec<f32>, ProbeError> {
    let plane = width as usize * height as usize;
    if plane == 0 || output.len() != 2 * plane {
        return Err(ProbeError::Size {
            width,
            height,
            expected: 2 * plane,
            found: output.len(),
        });
    }
    let at = |map: &[f32], point| {
        let (row, column) = position(width, height, point);
        map[row * width as usize + column]
    };
    let (left, right) = output.split_at(plane);
    let values = [left, right]
        .into_iter()
        .flat_map(|map| (0..PROBE_POINTS).map(move |p| at(map, p)));
    Ok(values.collect())
}

/// A synthetic colour image with gradients, slanted waves, edges and blocks, `[1, 3, height,
/// width]`, values in 0..1.
///
/// With `u = (column + 0.5) / width`, `v = (row + 0.5) / height` and the triangle wave
/// `t(a) = |2 (a - floor(a)) - 1|`, channel `c` of 0, 1, 2 is
///
/// `0.4 v + 0.3 t((3 + 2 c) u + (2 + c) v) + 0.2 b + 0.1 t(11 u)`
///
/// where `b` is 1 if `floor(8 u) + floor(4 v) + c` is even and 0 otherwise. Sums and products are
/// evaluated in `f64` from left to right and rounded once to `f32`; there is no transcendental
/// function and no random number in it, so every machine computes the same bits.
#[must_use]
pub fn probe_image(width: u32, height: u32) -> Vec<f32> {
    let triangle = |a: f64| (2.0 * (a - a.floor()) - 1.0).abs();
    let mut image = Vec::with_capacity(3 * width as usize * height as usize);
    for c in 0..3_u32 {
        for row in 0..height {
            let v = (f64::from(row) + 0.5) / f64::from(height);
            for column in 0..width {
                let u = (f64::from(column) + 0.5) / f64::from(width);
                let wave = triangle(f64::from(3 + 2 * c) * u + f64::from(2 + c) * v);
                let block = (8.0 * u).floor() + (4.0 * v).floor() + f64::from(c);
                let block = if block % 2.0 == 0.0 { 1.0 } else { 0.0 };
                let value = 0.4 * v + 0.3 * wave + 0.2 * block + 0.1 * triangle(11.0 * u);
                image.push(value as f32);
            }
        }
    }
    image
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn full() -> ModelMetadata {
        ModelMetadata {
            kernel: Some("area".into()),
            train_data_digest: Some("00ff".into()),
            split: Some("eigen".into()),
            train_drives: vec![
                "2011_09_26_drive_0001".into(),
                "2011_09_30_drive_0020".into(),
            ],
            unknown_start: Some("ff00".into()),
            variant: Some("strat".into()),
            seed: Some(u64::MAX),
            epoch: Some(50),
            tool_version: Some("0.1.0".into()),
            parity: Some(4.5e-8),
            probe: Some(Probe::record(16, 8, &[0.1; 256]).unwrap()),
            ..ModelMetadata::new(OutputMeaning::DisparityFraction, InputRange::Unit, 512, 256)
        }
    }

    fn read(props: &[(String, String)]) -> Reading {
        ModelMetadata::from_props(props.iter().map(|(k, v)| (k.as_str(), v.as_str())))
    }

    /// The properties of `full` with one value replaced, or removed for `None`.
    fn with(key: &str, value: Option<&str>) -> Reading {
        let mut props = full().to_props();
        match value {
            Some(value) => props.iter_mut().find(|(k, _)| k == key).unwrap().1 = value.to_owned(),
            None => props.retain(|(k, _)| k != key),
        }
        read(&props)
    }

    #[test]
    fn a_full_description_comes_back() {
        let reading = read(&full().to_props());
        assert_eq!(reading.problems, Vec::<String>::new());
        assert_eq!(reading.metadata, Some(full()));
    }

    #[test]
    fn properties_of_others_are_no_description() {
        let props = [("author".to_owned(), "someone".to_owned())];
        assert_eq!(read(&props), Reading::default());
    }

    #[test]
    fn broken_values_are_sentences_and_cost_only_themselves() {
        let reading = with("strat.seed", Some("seven"));
        assert_eq!(
            reading.problems,
            ["\"strat.seed\" is \"seven\", which is not a whole number"]
        );
        let expected = ModelMetadata {
            seed: None,
            ..full()
        };
        assert_eq!(reading.metadata, Some(expected));

        for (key, value) in [
            ("strat.probe.image", "lena"),
            ("strat.probe.expected", "1 2 3"),
            ("strat.probe.width", "0"),
            ("strat.probe.height", "-3"),
        ] {
            let reading = with(key, Some(value));
            assert_eq!(reading.problems.len(), 1, "{:?}", reading.problems);
            assert_eq!(
                reading.metadata,
                Some(ModelMetadata {
                    probe: None,
                    ..full()
                })
            );
        }
        let newer = with("strat.format", Some("2"));
        assert!(newer.problems[0].contains("format 2"));
        assert_eq!(newer.metadata, Some(full()));
    }

    #[test]
    fn what_decides_the_use_must_be_there() {
        for key in ["output", "input_range", "input_width", "input_height"] {
            let key = format!("strat.{key}");
            for value in [None, Some("?"), Some("")] {
                let reading = with(&key, value);
                assert_eq!(reading.metadata, None);
                assert!(
                    reading.problems.iter().any(|p| p.contains(&key)),
                    "{:?}",
                    reading.problems
                );
            }
        }
        assert_eq!(with("strat.input_width", Some("0")).metadata, None);
    }

    #[test]
    fn a_missing_key_shows_in_the_count() {
        for (key, _) in full().to_props() {
            assert!(!with(&key, None).problems.is_empty(), "{key}");
        }
    }

    /// Worked by hand: at width 2, height 1 the first pixel has u = 1/4, v = 1/2. Channel 0:
    /// 3u + 2v = 1.75, t = |2 * 0.75 - 1| = 0.5; block 2 + 2 + 0 is even; 11u = 2.75, t = 0.5;
    /// 0.4 / 2 + 0.3 / 2 + 0.2 + 0.1 / 2 = 0.6. Channel 1: 5u + 3v = 2.75, t = 0.5; block odd:
    /// 0.4. Channel 2: 7u + 4v = 3.75: 0.6 again.
    #[test]
    fn the_probe_image_follows_its_formula() {
        let image = probe_image(2, 1);
        assert_eq!(image.len(), 6);
        for (found, expected) in [image[0], image[2], image[4]]
            .into_iter()
            .zip([0.6, 0.4, 0.6])
        {
            assert!((found - expected).abs() < 1e-6, "{image:?}");
        }
        let image = probe_image(512, 256);
        let (least, most) = image
            .iter()
            .fold((1.0_f32, 0.0_f32), |(a, b), &v| (a.min(v), b.max(v)));
        assert!(
            least >= 0.0 && most <= 1.0 && most - least > 0.8,
            "{least}..{most}"
        );
    }

    /// A probe notices swapped maps, a mirrored map, and a map that is shifted by a pixel.
    #[test]
    fn a_probe_is_not_blind() {
        let (width, height) = (64_usize, 32_usize);
        let plane = width * height;
        let output: Vec<f32> = (0..2 * plane)
            .map(|i| (i / plane) as f32 * 0.01 + (i % plane % width) as f32 / 1000.0)
            .collect();
        let probe = Probe::record(64, 32, &output).unwrap();
        assert_eq!(probe.max_difference(&output), Ok(0.0));
        let swapped = [&output[plane..], &output[..plane]].concat();
        let mirrored: Vec<f32> = output
            .chunks(width)
            .flat_map(|r| r.iter().rev().copied())
            .collect();
        let mut shifted = output.clone();
        shifted.rotate_right(1);
        for other in [&swapped, &mirrored, &shifted] {
            assert!(probe.max_difference(other).unwrap() > 5e-4);
        }
        let nan = vec![f32::NAN; 2 * plane];
        assert_eq!(probe.max_difference(&nan), Ok(f32::INFINITY));
        assert!(matches!(
            Probe::record(64, 32, &nan),
            Err(ProbeError::NotFinite { row: 2, column: 4 })
        ));
        assert!(matches!(
            probe.max_difference(&output[1..]),
            Err(ProbeError::Size { .. })
        ));
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

        #[test]
        fn numbers_come_back_bit_for_bit(
            expected in proptest::collection::vec(-1e30_f32..1e30, 2 * PROBE_POINTS),
            parity in proptest::option::of(0.0_f64..1.0),
            seed in proptest::option::of(any::<u64>()),
            variant in ".*",
        ) {
            let metadata = ModelMetadata {
                probe: Some(Probe { width: 9, height: 9, expected }),
                parity,
                seed,
                variant: Some(variant),
                ..full()
            };
            prop_assert_eq!(read(&metadata.to_props()).metadata, Some(metadata));
        }

        #[test]
        fn any_properties_can_be_read(
            props in proptest::collection::vec(("(strat\\.)?[a-z_.]{0,12}", ".{0,60}"), 0..20),
            key in 0_usize..17,
            value in ".{0,60}",
        ) {
            let _ = read(&props);
            let mut props = full().to_props();
            let key = key % props.len();
            props[key].1 = value;
            let _ = read(&props);
        }
    }
}
