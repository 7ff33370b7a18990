//! What the rows of a model or of saved predictions are identified by: everything about it that can
//! change their numbers.
//!
//! The file alone is not enough: the description beside it says what its numbers mean, how images
//! are resized for it and whose map is whose. [`Identity::digest`] is what rows, journals, the parts
//! of a divided run and leaderboards carry as `model_hash`. Not here: runtime and provider, which
//! rows carry in columns of their own, and protocol and data, which have digests.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use serde_yaml::Value;
use strat_store::files;

use super::predictions::{SavedDescription, SavedPredictions};
use crate::model::Model;

/// The fact that is there for every model: the BLAKE3 of its file with all external data.
const FILE: &str = "file";

/// Facts by name, such as `output.scale`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Identity(BTreeMap<String, String>);

impl Identity {
    /// What is known by its bytes alone.
    #[must_use]
    pub fn of_bytes(blake3: &str) -> Self {
        Self(BTreeMap::from([(FILE.to_owned(), blake3.to_owned())]))
    }

    /// The file of a model, with the description beside it. A description within the file is part
    /// of its bytes.
    #[must_use]
    pub fn of_model(model: &Model) -> Self {
        let mut identity = Self::of_bytes(&model.file.blake3);
        if model.is_described_beside {
            identity.describe(&model.description);
        }
        identity
    }

    /// Saved maps, what they mean, and whose they are.
    #[must_use]
    pub fn of_saved(saved: &SavedPredictions) -> Self {
        Self::of_maps(&saved.blake3, &saved.description, &saved.images_digest)
    }

    /// Maps of the BLAKE3 `blake3`, what they mean, and the digest of the list of images whose
    /// they are.
    #[must_use]
    pub fn of_maps(blake3: &str, description: &SavedDescription, images_digest: &str) -> Self {
        let mut identity = Self::of_bytes(blake3);
        identity.describe(description);
        identity.add("images", images_digest);
        identity
    }

    /// Takes in all values of a description under their keys.
    fn describe(&mut self, description: &impl Serialize) {
        // A description was read from YAML, so it can be written as YAML.
        let value = serde_yaml::to_value(description).unwrap_or(Value::Null);
        self.flatten("", &value);
    }

    fn flatten(&mut self, key: &str, value: &Value) {
        match value {
            Value::Mapping(mapping) => {
                for (name, value) in mapping {
                    let name = name.as_str().unwrap_or_default();
                    let dot = if key.is_empty() { "" } else { "." };
                    self.flatten(&format!("{key}{dot}{name}"), value);
                }
            }
            value => {
                let text = serde_yaml::to_string(value).unwrap_or_default();
                let text = text.trim_end().replace("\n- ", ", ");
                self.add(key, text.trim_start_matches("- "));
            }
        }
    }

    /// One more fact.
    pub fn add(&mut self, what: &str, value: &str) {
        self.0.insert(what.to_owned(), value.to_owned());
    }

    /// Nothing is known: the record of an earlier version.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Two identities have the same digest if nothing that is known of them differs. What is known
    /// by one value alone has this value: the BLAKE3 of a file remains what other programs compute.
    #[must_use]
    pub fn digest(&self) -> String {
        let mut values = self.0.values();
        if let (Some(only), None) = (values.next(), values.next()) {
            return only.clone();
        }
        let lines: Vec<String> = self
            .0
            .iter()
            .map(|(what, v)| format!("{what}={v}\n"))
            .collect();
        files::blake3_hex(lines.concat().as_bytes())
    }

    /// What differs, for the middle of a sentence: `output.scale was 5.4 and is 10.8`; `None` where
    /// nothing does.
    #[must_use]
    pub fn changes_to(&self, now: &Self) -> Option<String> {
        let all: std::collections::BTreeSet<&String> = self.0.keys().chain(now.0.keys()).collect();
        let shown = |value: &str| {
            let is_digest = value.len() == 64 && value.bytes().all(|b| b.is_ascii_hexdigit());
            if is_digest {
                files::digest_prefix(value).to_owned()
            } else {
                value.to_owned()
            }
        };
        let changes: Vec<String> = all
            .into_iter()
            .filter_map(|what| match (self.0.get(what), now.0.get(what)) {
                (Some(before), Some(after)) if before == after => None,
                (Some(before), Some(after)) => Some(format!(
                    "{what} was {} and is {}",
                    shown(before),
                    shown(after)
                )),
                (Some(before), None) => {
                    Some(format!("{what} was {} and is not there", shown(before)))
                }
                (None, Some(after)) => {
                    Some(format!("{what} was not there and is {}", shown(after)))
                }
                (None, None) => None,
            })
            .collect();
        (!changes.is_empty()).then(|| changes.join(", "))
    }
}

#[cfg(test)]
mod tests {
    use strat_onnx::metadata::OutputMeaning;

    use super::*;

    fn described(scale: Option<f64>) -> Identity {
        let mut identity = Identity::of_bytes("ab");
        identity.describe(&SavedDescription {
            scale,
            ..SavedDescription::plain(OutputMeaning::DepthM)
        });
        identity
    }

    /// The digest of two facts is worked out from its definition.
    #[test]
    fn a_digest_is_that_of_all_facts_and_of_one_alone_the_fact() {
        assert_eq!(Identity::of_bytes("ab").digest(), "ab");
        let expected = blake3_of("file=ab\nmeaning=depth_m\n");
        assert_eq!(described(None).digest(), expected);
        let expected = blake3_of("file=ab\nmeaning=depth_m\nscale=5.4\n");
        assert_eq!(described(Some(5.4)).digest(), expected);
    }

    fn blake3_of(text: &str) -> String {
        files::blake3_hex(text.as_bytes())
    }

    #[test]
    fn what_changed_is_named() {
        let (old, new) = (described(Some(5.4)), described(Some(10.8)));
        assert_eq!(old.changes_to(&new).unwrap(), "scale was 5.4 and is 10.8");
        assert_eq!(
            old.changes_to(&described(None)).unwrap(),
            "scale was 5.4 and is not there"
        );
        assert_eq!(old.changes_to(&old), None);
        let hash = |c: &str| Identity::of_bytes(&c.repeat(64));
        assert_eq!(
            hash("a").changes_to(&hash("b")).unwrap(),
            "file was aaaaaaaaaaaa and is bbbbbbbbbbbb"
        );
    }

    #[test]
    fn lists_and_nested_keys_are_facts() {
        let mut identity = Identity::default();
        let value: Value =
            serde_yaml::from_str("{input: {std: [1.0, 0.5], kernel: area}}").unwrap();
        identity.describe(&value);
        let facts: Vec<(&str, &str)> = identity
            .0
            .iter()
            .map(|(k, v)| (k.as_str(), v.as_str()))
            .collect();
        assert_eq!(facts, [("input.kernel", "area"), ("input.std", "1.0, 0.5")]);
    }
}
