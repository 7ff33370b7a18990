//! A first description of a foreign model: what its graph says, what a family of models is known to want,
//! and what a look at one map tells.
//!
//! Nothing here decides: a line is *read from the file*, stands in a family's own code (its template says
//! where), or is *to be confirmed*, and `bench` warns as long as a description in use has such a line. Not
//! here: what the keys mean ([`super::Description`]).

use std::fmt::{self, Write as _};

use strat_onnx::{
    graph::Dim,
    model::{ElementType, ModelFile, TensorInfo},
};
use strat_store::raster::Plane;

use super::{
    description::{Description, TO_CONFIRM},
    input::tensor_text,
};
use crate::runtime::Output;

/// Marks a line that the graph states.
const READ: &str = "read from the file";

/// What one family of models wants, as a description with a source for each line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Family {
    /// Name on the command line.
    pub name: &'static str,
    /// The description.
    pub text: &'static str,
}

macro_rules! families {
    ($($name:literal),* $(,)?) => {
        /// All families, in the order of the documentation.
        pub const FAMILIES: &[Family] = &[
            $(Family { name: $name, text: include_str!(concat!("families/", $name, ".yaml")) }),*
        ];
    };
}

families![
    "depth-anything-v2",
    "depth-anything-v2-metric",
    "depth-anything-v1",
    "depth-anything-transformers",
    "midas-v21",
    "dpt",
    "zoedepth",
    "metric3d",
    "monodepth2",
];

#[derive(Clone, Debug, PartialEq)]
struct Line {
    key: String,
    value: String,
    note: String,
}

/// A description on its way.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Draft {
    head: Vec<String>,
    input: Vec<Line>,
    output: Vec<Line>,
}

fn set(lines: &mut Vec<Line>, key: &str, value: &str, note: &str) {
    let line = Line {
        key: key.to_owned(),
        value: value.to_owned(),
        note: note.to_owned(),
    };
    match lines.iter_mut().find(|line| line.key == key) {
        Some(known) => *known = line,
        None => lines.push(line),
    }
}

fn set_first(lines: &mut Vec<Line>, key: &str, value: &str, note: &str) {
    lines.retain(|line| line.key != key);
    let mut first = Vec::new();
    set(&mut first, key, value, note);
    lines.splice(..0, first);
}

impl Draft {
    /// The template of a family, without a file.
    #[must_use]
    pub fn of_family(family: &Family) -> Self {
        let mut draft = Self::default();
        let mut section = None;
        for line in family.text.lines() {
            if let Some(note) = line.strip_prefix("# ") {
                draft.head.push(note.to_owned());
            } else if let Some((key, rest)) = line.trim().split_once(": ") {
                let (value, note) = rest.split_once(" # ").unwrap_or((rest, ""));
                let lines = match section {
                    Some("output:") => &mut draft.output,
                    _ => &mut draft.input,
                };
                set(lines, key, value.trim(), note.trim());
            } else {
                section = Some(line.trim());
            }
        }
        draft
    }

    /// What the graph of a file says, over the template of its family where that is known.
    ///
    /// # Errors
    /// The model takes no image, or gives no map; a sentence.
    pub fn of_file(file: &ModelFile, family: Option<&Family>) -> Result<Self, String> {
        let mut draft = family.map_or_else(Self::guessed, Self::of_family);
        let info = &file.info;
        let name = file.path.file_name().unwrap_or_default().to_string_lossy();
        let producer = [&info.producer, &info.producer_version];
        let producer: Vec<&str> = producer.into_iter().flatten().map(String::as_str).collect();
        let opset = info
            .opset
            .map_or_else(|| "none".to_owned(), |opset| opset.to_string());
        let mut facts = format!("{name}: opset {opset}, {} weights", info.parameters);
        if !producer.is_empty() {
            let _ = write!(facts, ", written by {}", producer.join(" "));
        }
        draft.head.push(facts);
        for (key, value) in &info.properties {
            let value: String = value.chars().filter(|c| !c.is_control()).take(80).collect();
            draft.head.push(format!("property {key}: {value}"));
        }
        for (what, tensors) in [("input", &info.inputs), ("output", &info.outputs)] {
            let texts = tensors.iter().map(tensor_text);
            draft
                .head
                .extend(texts.map(|text| format!("{what} {text}")));
        }
        let input = info.inputs.iter().find(|tensor| is_image(tensor));
        let input = input.ok_or_else(|| {
            let texts: Vec<String> = info.inputs.iter().map(tensor_text).collect();
            format!(
                "none of its inputs is an image of three channels with four dimensions: {}",
                texts.join(", ")
            )
        })?;
        draft.take_input(input, family.is_some());
        let output = likely_output(&info.outputs).ok_or("it has no output")?;
        let dims = output.dims.as_deref();
        set_first(&mut draft.output, "name", &quoted(&output.name), READ);
        if info.outputs.len() > 1 {
            let others = info.outputs.len() - 1;
            let note = format!("{TO_CONFIRM}: it has {others} other outputs, listed above");
            set_first(&mut draft.output, "name", &quoted(&output.name), &note);
        }
        if let Some([_, channels, _, last]) = dims {
            let is_nhwc = last.fixed().is_some_and(|n| n <= 4) && channels.fixed() != Some(1);
            if is_nhwc {
                set(&mut draft.output, "layout", "nhwc", READ);
            }
            let count = if is_nhwc { last } else { channels };
            if count.fixed() != Some(1) {
                let note =
                    format!("{TO_CONFIRM}: the output has several channels, or does not say");
                set(&mut draft.output, "channel", "0", &note);
            }
        }
        Ok(draft)
    }

    /// What is often so, all of it to be confirmed.
    fn guessed() -> Self {
        let mut draft = Self::default();
        for (key, value, note) in [
            ("range", "0..1", ""),
            ("mean", "[0.485, 0.456, 0.406]", ": ImageNet's, or none"),
            ("std", "[0.229, 0.224, 0.225]", ": ImageNet's, or none"),
            ("channels", "rgb", ""),
            (
                "kernel",
                "opencv-cubic",
                ": area, opencv-linear, lanczos3, pillow-bicubic?",
            ),
        ] {
            set(&mut draft.input, key, value, &format!("{TO_CONFIRM}{note}"));
        }
        for (key, value, note) in [
            (
                "meaning",
                "inverse_depth",
                ": `bench eval --help` has the meanings",
            ),
            ("kernel", "opencv-linear", ": or opencv-cubic"),
            ("align_corners", "false", ""),
        ] {
            set(
                &mut draft.output,
                key,
                value,
                &format!("{TO_CONFIRM}{note}"),
            );
        }
        draft
    }

    fn take_input(&mut self, tensor: &TensorInfo, has_family: bool) {
        let lines = &mut self.input;
        let dims = tensor.dims.as_deref().unwrap_or_default();
        let is_nhwc = dims.get(3).and_then(Dim::fixed) == Some(3)
            && dims.get(1).and_then(Dim::fixed) != Some(3);
        let (height, width) = if is_nhwc { (1, 2) } else { (2, 3) };
        let fixed = |index: usize| dims.get(index).and_then(Dim::fixed);
        if is_nhwc {
            set(lines, "layout", "nhwc", READ);
        }
        let value = |lines: &[Line], key: &str| {
            lines
                .iter()
                .find(|line| line.key == key)
                .map(|line| line.value.clone())
        };
        match (fixed(width), fixed(height)) {
            (Some(width), Some(height)) => {
                let is_padded = value(lines, "pad").is_some();
                lines.retain(|line| !matches!(&*line.key, "shorter_side" | "multiple_of"));
                if !is_padded && value(lines, "fit").as_deref() != Some("stretch") {
                    let note = format!(
                        "{TO_CONFIRM}: the file has one size, so images are stretched to it"
                    );
                    set_first(lines, "fit", "stretch", &note);
                }
                set_first(lines, "height", &height.to_string(), READ);
                set_first(lines, "width", &width.to_string(), READ);
            }
            _ if !has_family => {
                let open = format!("{TO_CONFIRM}: height and width are open");
                let network = format!("{TO_CONFIRM}: 14 and 32 are usual");
                set_first(lines, "multiple_of", "14", &network);
                set_first(
                    lines,
                    "shorter_side",
                    "518",
                    &format!("{TO_CONFIRM}: 518 and 384 are usual"),
                );
                set_first(lines, "fit", "keep-aspect", &open);
            }
            _ => {}
        }
        if tensor.element == Some(ElementType::U8) {
            lines.retain(|line| !matches!(&*line.key, "mean" | "std"));
            set(
                lines,
                "range",
                "0..255",
                &format!("{READ}: the input takes u8"),
            );
        }
        set_first(lines, "name", &quoted(&tensor.name), READ);
    }

    /// Takes in what a map of a photograph shows, where no family says what it means.
    pub fn take_look(&mut self, look: &Look, image: &str) {
        let (meaning, reason) = match look.lean() {
            Some(Lean::NearIsLarge) => ("inverse_depth", "larger below than above, as near is"),
            Some(Lean::FarIsLarge) => (
                "depth_m",
                "smaller below than above, as depth is (`depth` without a unit)",
            ),
            None => return,
        };
        let open = |line: &Line| line.key == "meaning" && line.note.starts_with(TO_CONFIRM);
        if self.output.iter().any(open) {
            let note = format!("{TO_CONFIRM}: on {image} values are {reason}");
            set(&mut self.output, "meaning", meaning, &note);
        }
    }

    /// The description that the text says.
    ///
    /// # Errors
    /// It contradicts itself; a sentence.
    pub fn description(&self) -> Result<Description, String> {
        let text = self.to_string();
        let read: Description = strat_store::yaml::parse(text.as_bytes())?;
        read.check()?;
        Ok(read)
    }
}

/// As a YAML file.
impl fmt::Display for Draft {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for line in &self.head {
            writeln!(f, "# {line}")?;
        }
        for (section, lines) in [("input", &self.input), ("output", &self.output)] {
            writeln!(f, "{section}:")?;
            let texts = lines
                .iter()
                .map(|line| format!("  {}: {}", line.key, line.value));
            let texts: Vec<String> = texts.collect();
            let width = texts
                .iter()
                .map(|text| text.chars().count())
                .max()
                .unwrap_or(0);
            for (text, line) in texts.iter().zip(lines) {
                match &*line.note {
                    "" => writeln!(f, "{text}")?,
                    note => writeln!(f, "{text:<width$}  # {note}")?,
                }
            }
        }
        Ok(())
    }
}

/// A name as YAML takes it back.
fn quoted(name: &str) -> String {
    serde_yaml::to_string(name)
        .unwrap_or_default()
        .trim()
        .to_owned()
}

fn is_image(tensor: &TensorInfo) -> bool {
    let Some(dims) = &tensor.dims else {
        return true;
    };
    let may_be_three = |index: usize| dims[index].fixed().is_none_or(|size| size == 3);
    dims.len() == 4 && (may_be_three(1) || may_be_three(3))
}

/// The output whose name speaks of depth, or the first one.
fn likely_output(outputs: &[TensorInfo]) -> Option<&TensorInfo> {
    let speaks = |tensor: &&TensorInfo| {
        let name = tensor.name.to_lowercase();
        ["depth", "disp"].iter().any(|word| name.contains(word))
    };
    outputs.iter().find(speaks).or(outputs.first())
}

/// What the values of an output look like.
#[derive(Clone, Debug, PartialEq)]
pub struct Look {
    /// Name and shape.
    pub output: String,
    /// Smallest and largest finite value.
    pub range: Option<(f32, f32)>,
    /// Values that are NaN or infinite.
    pub not_finite: usize,
    /// Values below 0.
    pub negative: usize,
    /// Means of the upper and of the lower third of the rows, of the map that is read.
    pub thirds: Option<(f64, f64)>,
}

/// Which way the values of a photograph's map grow.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lean {
    /// As disparity and inverse depth do.
    NearIsLarge,
    /// As depth does.
    FarIsLarge,
}

impl Look {
    /// A look at an output as it comes, and at the map that was read from it.
    #[must_use]
    pub fn new(output: &Output, map: Option<&Plane>) -> Self {
        let finite = || {
            output
                .data
                .iter()
                .copied()
                .filter(|value| value.is_finite())
        };
        let range = finite().fold(None, |range: Option<(f32, f32)>, value| {
            Some(range.map_or((value, value), |(low, high)| {
                (low.min(value), high.max(value))
            }))
        });
        let mean = |values: &[f32]| {
            let sum: f64 = values.iter().map(|value| f64::from(*value)).sum();
            sum / values.len().max(1) as f64
        };
        let thirds = map.filter(|map| map.height >= 3).map(|map| {
            let third = map.height / 3 * map.width;
            (
                mean(&map.data[..third]),
                mean(&map.data[map.data.len() - third..]),
            )
        });
        Self {
            output: format!("{} {:?}", output.name, output.shape),
            range,
            not_finite: output.data.len() - finite().count(),
            negative: finite().filter(|value| *value < 0.0).count(),
            thirds,
        }
    }

    /// Which way it leans, where upper and lower thirds differ by a fifth of their size.
    #[must_use]
    pub fn lean(&self) -> Option<Lean> {
        let (above, below) = self.thirds?;
        let clear = 0.2 * above.abs().max(below.abs());
        if below - above > clear {
            Some(Lean::NearIsLarge)
        } else if above - below > clear {
            Some(Lean::FarIsLarge)
        } else {
            None
        }
    }

    /// One line for people.
    #[must_use]
    pub fn text(&self) -> String {
        let mut text = self.output.clone();
        match self.range {
            Some((low, high)) => {
                let _ = write!(text, ": {low:.6} to {high:.6}, {} negative", self.negative);
            }
            None => text += ": no number",
        }
        if self.not_finite > 0 {
            let _ = write!(text, ", {} NaN or infinite", self.not_finite);
        }
        if let Some((above, below)) = self.thirds {
            let word = match self.lean() {
                Some(Lean::NearIsLarge) => "; like inverse depth, if the ground is below",
                Some(Lean::FarIsLarge) => "; like depth, if the ground is below",
                None => "",
            };
            let _ = write!(text, ", mean {above:.4} above and {below:.4} below{word}");
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use strat_onnx::metadata::OutputMeaning;

    use super::super::description::unconfirmed;
    use super::*;

    #[test]
    fn templates_are_descriptions_whose_lines_have_a_source() {
        for family in FAMILIES {
            let draft = Draft::of_family(family);
            let name = family.name;
            draft
                .description()
                .unwrap_or_else(|error| panic!("{name}: {error}"));
            assert!(!draft.head.is_empty(), "{name}");
            for line in draft.input.iter().chain(&draft.output) {
                assert!(!line.note.is_empty(), "{name}: {}", line.key);
            }
            assert_eq!(unconfirmed(&draft.to_string()), 0, "{name}");
            let direct: Description = serde_yaml::from_str(family.text).unwrap();
            assert_eq!(draft.description().unwrap(), direct, "{name}");
        }
    }

    fn output(shape: &[usize], data: Vec<f32>) -> Output {
        Output {
            name: "map".to_owned(),
            shape: shape.to_vec(),
            data,
        }
    }

    #[test]
    fn a_look_says_range_sign_and_which_way_values_grow() {
        let data = vec![-1.0, 0.0, 2.0, f32::NAN, 4.0, 6.0];
        let plane = Plane::new(2, 3, vec![-1.0, 0.0, 2.0, 2.0, 4.0, 6.0]).unwrap();
        let look = Look::new(&output(&[1, 3, 2], data), Some(&plane));
        assert_eq!(look.range, Some((-1.0, 6.0)));
        assert_eq!((look.not_finite, look.negative), (1, 1));
        assert_eq!(look.lean(), Some(Lean::NearIsLarge));
        let text = look.text();
        for word in [
            "map [1, 3, 2]",
            "-1.000000 to 6.000000",
            "1 negative",
            "1 NaN",
            "inverse depth",
        ] {
            assert!(text.contains(word), "{word}: {text}");
        }
        let mut draft = Draft::guessed();
        set(&mut draft.input, "width", "8", READ);
        set(&mut draft.input, "height", "8", READ);
        let upright = Plane::new(1, 3, vec![9.0, 5.0, 1.0]).unwrap();
        let look = Look::new(&output(&[3, 1], upright.data.clone()), Some(&upright));
        draft.take_look(&look, "a.png");
        let text = draft.to_string();
        assert_eq!(
            draft.description().unwrap().output.meaning,
            OutputMeaning::DepthM
        );
        assert!(text.contains("on a.png values are smaller below"), "{text}");
        assert_eq!(unconfirmed(&text), 8, "{text}");
        let flat = Plane::filled(1, 3, 1.0);
        assert_eq!(
            Look::new(&output(&[3, 1], flat.data.clone()), Some(&flat)).lean(),
            None
        );
    }
}
