//! What a submission's `run.yaml` says of the run: the record that `bench` wrote, of which other
//! versions may have more keys.

use serde::Deserialize;
use serde_yaml::Value;
use strat_splits::Training;

/// The parts of `run.yaml` that a leaderboard uses.
#[derive(Clone, Debug, Deserialize)]
pub struct Run {
    /// Version of the program that measured.
    pub tool_version: String,
    /// The data.
    pub data: RunData,
    /// Device asked for.
    #[serde(default)]
    pub device: String,
    /// The models; in a submission one.
    pub models: Vec<RunModel>,
    /// The protocols.
    #[serde(default)]
    pub protocols: Vec<RunProtocol>,
    /// Everything that was warned about.
    #[serde(default)]
    pub warnings: Vec<String>,
}

/// The data of a run.
#[derive(Clone, Debug, Deserialize)]
pub struct RunData {
    /// Recorded or rendered.
    pub source: String,
    /// Digest of the prepared set.
    pub data_digest: String,
    /// Test images that the split has.
    pub test_images_expected: u64,
    /// Test images in the set.
    pub test_images_found: u64,
}

/// One model of a run.
#[derive(Clone, Debug, Deserialize)]
pub struct RunModel {
    /// Name in tables.
    pub name: String,
    /// BLAKE3 of the file.
    pub blake3: String,
    /// What its trainer says about it.
    #[serde(default)]
    pub metadata: Option<Metadata>,
    /// Number of weights.
    #[serde(default)]
    pub parameters: Option<u64>,
    /// Runtime and version.
    #[serde(default)]
    pub runtime: String,
    /// Execution provider that really ran.
    #[serde(default)]
    pub provider: String,
    /// A sentence where more is to be said.
    #[serde(default)]
    pub note: Option<String>,
}

/// What a trainer says about a model.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default)]
pub struct Metadata {
    /// Name of the training split.
    pub split: Option<String>,
    /// Digest of the training set.
    pub train_data_digest: Option<String>,
    /// Drives of the training images.
    pub train_drives: Vec<String>,
    /// Weights of unknown training that it began with.
    pub unknown_start: Option<String>,
    /// Training variant.
    pub variant: Option<String>,
    /// Seed of the training.
    pub seed: Option<u64>,
    /// Epochs completed.
    pub epoch: Option<u32>,
}

/// One protocol of a run.
#[derive(Clone, Debug, Deserialize)]
pub struct RunProtocol {
    /// Name.
    pub name: String,
    /// Digest of the rules.
    pub digest: String,
}

impl RunModel {
    /// What it says of its training.
    #[must_use]
    pub fn training(&self) -> Option<Training<'_>> {
        self.metadata.as_ref().map(|metadata| Training {
            split: metadata.split.as_deref(),
            drives: &metadata.train_drives,
            unknown_start: metadata.unknown_start.is_some(),
        })
    }
}

/// Whether a sentence is about something of that name: the name with nothing on either side that
/// could belong to a longer one.
pub(crate) fn mentions(sentence: &str, name: &str) -> bool {
    let is_part = |c: char| c.is_alphanumeric() || "-_@".contains(c);
    sentence.match_indices(name).any(|(at, _)| {
        let before = sentence[..at].chars().next_back();
        let after = sentence[at + name.len()..].chars().next();
        !before.is_some_and(is_part) && !after.is_some_and(is_part)
    })
}

/// A record reduced to one model of it, without the folders of the machine that it ran on.
pub(crate) fn reduced(mut record: Value, model: &str) -> Value {
    let names: Vec<String> = models(&record)
        .filter_map(name_of)
        .map(str::to_owned)
        .collect();
    let others: Vec<&String> = names.iter().filter(|name| *name != model).collect();
    if let Some(models) = record.get_mut("models").and_then(Value::as_sequence_mut) {
        models.retain(|one| name_of(one) == Some(model));
        for one in models {
            shorten(one.get_mut("file"));
        }
    }
    shorten(record.get_mut("data").and_then(|data| data.get_mut("path")));
    shorten(record.get_mut("runtime_library"));
    if let Some(arguments) = record.get_mut("arguments").and_then(Value::as_sequence_mut) {
        arguments
            .iter_mut()
            .for_each(|argument| shorten(Some(argument)));
    }
    if let Some(warnings) = record.get_mut("warnings").and_then(Value::as_sequence_mut) {
        warnings.retain(|warning| {
            let about = |name: &str| warning.as_str().is_some_and(|text| mentions(text, name));
            about(model) || !others.iter().any(|name| about(name))
        });
    }
    record
}

fn models(record: &Value) -> impl Iterator<Item = &Value> {
    record
        .get("models")
        .and_then(Value::as_sequence)
        .into_iter()
        .flatten()
}

fn name_of(model: &Value) -> Option<&str> {
    model.get("name").and_then(Value::as_str)
}

/// Leaves the last part of a path, also behind `NAME=`.
fn shorten(value: Option<&mut Value>) {
    let Some(Value::String(text)) = value else {
        return;
    };
    if let Some(cut) = text.trim_end_matches(['/', '\\']).rfind(['/', '\\']) {
        let name = text.find('=').filter(|equals| *equals < cut);
        let kept = name.map_or("", |equals| &text[..=equals]);
        *text = format!("{kept}{}", &text[cut + 1..]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_is_reduced_to_one_model() {
        let record = "tool: bench\narguments: [--data, /home/me/sets/eigen, --model, a=/x/a.onnx]\n\
                      data: {path: /home/me/sets/eigen/}\nmodels: [{name: a, file: /x/a.onnx}, {name: a2}]\n\
                      warnings: ['LEAKAGE: model a2 saw it', 'model a: doubt', 'only 40 images']\n";
        let value = reduced(serde_yaml::from_str(record).unwrap(), "a");
        let text = serde_yaml::to_string(&value).unwrap();
        assert!(
            !text.contains("/home") && !text.contains("/x/") && !text.contains("a2"),
            "{text}"
        );
        for kept in [
            "a=a.onnx",
            "path: eigen",
            "model a: doubt",
            "only 40 images",
        ] {
            assert!(text.contains(kept), "{text}");
        }
        assert!(mentions("model a, b", "a") && !mentions("model a@1", "a") && !mentions("aa", "a"));
    }
}
