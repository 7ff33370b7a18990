//! What a study is asked for: a YAML file.

use std::path::{Path, PathBuf};

use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_yaml::{Mapping, Value};

use crate::config::{Preset, nearest};
use crate::error::{Error, Result};

/// Studies that are part of the program: name and text.
pub const BUILT_IN: [(&str, &str); 2] = [
    (
        "study-kitti",
        include_str!("../../configs/study-kitti.yaml"),
    ),
    (
        "study-rendered",
        include_str!("../../configs/study-rendered.yaml"),
    ),
];

const KEYS: [&str; 7] = [
    "base",
    "preset",
    "settings",
    "variants",
    "seeds",
    "data",
    "evaluation",
];

/// A study as its file names it. Paths are those of the command line: from the current folder.
#[derive(Clone, Debug, PartialEq)]
pub struct StudyFile {
    /// The configuration that all runs begin with: a built-in name or a YAML file.
    pub base: String,
    /// Sizes of the networks and their input.
    pub preset: Option<Preset>,
    /// Names of what is compared, each with its `key=value` settings, those of all variants first.
    pub variants: Vec<(String, Vec<String>)>,
    /// Seeds of each variant.
    pub seeds: Vec<u64>,
    /// Prepared sets; each gets all runs.
    pub data: Vec<PathBuf>,
    /// What `bench` shall measure; handed on as it is.
    pub evaluation: Value,
}

#[derive(Deserialize)]
#[serde(untagged)]
enum Folders {
    One(PathBuf),
    Several(Vec<PathBuf>),
}

impl StudyFile {
    /// The study named `source`: a built-in name or a path to a YAML file.
    ///
    /// # Errors
    /// With the file and the key of what is wrong.
    pub fn load(source: &str) -> Result<Self> {
        if let Some((name, text)) = BUILT_IN.iter().find(|(name, _)| *name == source) {
            let parsed: std::result::Result<Value, String> =
                strat_store::yaml::parse(text.as_bytes());
            let tree = parsed.map_err(|problem| Error::Study(format!("{name}: {problem}")))?;
            return Self::from_tree(tree, name);
        }
        if !Path::new(source).exists() {
            let names = BUILT_IN.map(|(name, _)| name);
            return Err(Error::Study(format!(
                "unknown study `{source}`: it is neither a file nor one of {}",
                names.join(", ")
            )));
        }
        Self::from_tree(strat_store::yaml::load(Path::new(source))?, source)
    }

    fn from_tree(tree: Value, source: &str) -> Result<Self> {
        let refuse = |problem: String| Error::Study(format!("{source}: {problem}"));
        let Value::Mapping(keys) = &tree else {
            return Err(refuse(format!(
                "a study is a list of keys and values: {}",
                KEYS.join(", ")
            )));
        };
        for key in keys.keys() {
            let key = text_of(key);
            if !KEYS.contains(&key.as_str()) {
                let hint = nearest(&key, KEYS);
                return Err(refuse(format!(
                    "unknown key `{key}`{hint}; known here: {}",
                    KEYS.join(", ")
                )));
            }
        }
        let name: Option<String> = field(keys, "preset").map_err(refuse)?;
        let preset = name.map(|name| name.parse()).transpose()?;
        let base: Option<String> = field(keys, "base").map_err(refuse)?;
        let base = base.ok_or_else(|| {
            refuse(
                "`base` is missing: the configuration that all runs begin with, e.g. demo".into(),
            )
        })?;
        let settings: Option<Mapping> = field(keys, "settings").map_err(refuse)?;
        let common = leaves(&settings.unwrap_or_default()).map_err(refuse)?;
        let named: Option<Mapping> = field(keys, "variants").map_err(refuse)?;
        let mut variants: Vec<(String, Vec<String>)> = Vec::new();
        for (name, settings) in named.unwrap_or_default() {
            let name = text_of(&name);
            check_name(&name).map_err(refuse)?;
            let settings = match settings {
                Value::Null => Vec::new(),
                Value::Mapping(settings) => {
                    leaves(&settings).map_err(|p| refuse(format!("variant `{name}`: {p}")))?
                }
                _ => {
                    return Err(refuse(format!(
                        "variant `{name}` must be settings with their values, e.g. {{variant: fixed}}"
                    )));
                }
            };
            let settings = common.iter().cloned().chain(settings).collect();
            variants.push((name, settings));
        }
        if variants.is_empty() {
            return Err(refuse(
                "`variants` is missing: names of what is compared, each with its settings"
                    .to_owned(),
            ));
        }
        let seeds: Option<Vec<u64>> = field(keys, "seeds").map_err(refuse)?;
        let seeds = seeds.unwrap_or_default();
        if seeds.is_empty() {
            return Err(refuse(
                "`seeds` is missing: one run of each variant for each, e.g. [1, 2, 3]".to_owned(),
            ));
        }
        for (index, seed) in seeds.iter().enumerate() {
            if seeds[..index].contains(seed) {
                return Err(refuse(format!("`seeds` names {seed} twice")));
            }
        }
        Ok(Self {
            base,
            preset,
            variants,
            seeds,
            data: match field(keys, "data").map_err(refuse)? {
                None => Vec::new(),
                Some(Folders::One(folder)) => vec![folder],
                Some(Folders::Several(folders)) => folders,
            },
            evaluation: keys.get("evaluation").cloned().unwrap_or_default(),
        })
    }
}

/// The value of a key; none where it is absent or null.
fn field<T: DeserializeOwned>(keys: &Mapping, key: &str) -> std::result::Result<Option<T>, String> {
    let value = keys.get(key).cloned().unwrap_or_default();
    serde_yaml::from_value(value).map_err(|error| format!("`{key}`: {error}"))
}

/// What may be the name of a folder everywhere, and of a row of `bench`, whose seed stands behind `@`.
fn check_name(name: &str) -> std::result::Result<(), String> {
    let known = |c: char| c.is_ascii_alphanumeric() || "-_.+".contains(c);
    if name.is_empty() || name.starts_with('.') || !name.chars().all(known) {
        return Err(format!(
            "`{name}` cannot be the name of a variant: use letters, digits, `-`, `_`, `+` and `.`"
        ));
    }
    Ok(())
}

/// Nested settings as `key=value` texts with dotted keys.
fn leaves(settings: &Mapping) -> std::result::Result<Vec<String>, String> {
    let mut found = Vec::new();
    for (key, value) in settings {
        let key = text_of(key);
        if ["seed", "split"].contains(&key.as_str()) {
            return Err(match key.as_str() {
                "seed" => "`seed` is not a setting of a variant; `seeds` lists them".to_owned(),
                _ => "`split` is not a setting of a variant; it is that of each set in `data`"
                    .to_owned(),
            });
        }
        match value {
            Value::Mapping(below) => {
                let below = leaves(below)?;
                found.extend(below.into_iter().map(|setting| format!("{key}.{setting}")));
            }
            _ => {
                let value = serde_yaml::to_string(value).map_err(|error| error.to_string())?;
                found.push(format!("{key}={}", value.trim_end()));
            }
        }
    }
    Ok(found)
}

fn text_of(key: &Value) -> String {
    match key {
        Value::String(text) => text.clone(),
        other => serde_yaml::to_string(other)
            .map_or_else(|_| String::new(), |text| text.trim_end().to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parsed(text: &str) -> Result<StudyFile> {
        StudyFile::from_tree(serde_yaml::from_str(text).unwrap(), "s.yaml")
    }

    #[test]
    fn settings_are_nested_or_dotted() {
        let text = "base: demo\nsettings: {epochs: 8}\nvariants:\n  none:\n  wide: {network: {width: 1/4}, \
                    augment.gamma: [0.9, 1.1]}\n  7: {variant: fixed}\nseeds: [3, 1]\ndata: sets/eigen\n";
        let study = parsed(text).unwrap();
        let of = |name: &str| {
            study
                .variants
                .iter()
                .find(|(n, _)| n == name)
                .unwrap()
                .1
                .clone()
        };
        assert_eq!(of("none"), ["epochs=8"]);
        let wide = of("wide");
        assert_eq!(wide[..2], ["epochs=8", "network.width=1/4"]);
        let gamma: Vec<f64> =
            serde_yaml::from_str(wide[2].strip_prefix("augment.gamma=").unwrap()).unwrap();
        assert_eq!(gamma, [0.9, 1.1]);
        assert_eq!(of("7"), ["epochs=8", "variant=fixed"]);
        assert_eq!(study.data, [PathBuf::from("sets/eigen")]);
    }

    #[test]
    fn mistakes_are_named() {
        let whole = "base: demo\nvariants: {a: {}}\nseeds: [1]\n";
        assert!(parsed(whole).is_ok());
        for (text, part) in [
            ("[1]", "keys and values"),
            (&format!("{whole}sedes: [1]"), "did you mean `seeds`?"),
            ("variants: {a: {}}\nseeds: [1]", "`base` is missing"),
            ("base: demo\nseeds: [1]", "`variants` is missing"),
            ("base: demo\nvariants: {a: {}}", "`seeds` is missing"),
            ("base: demo\nvariants: {a: {}}\nseeds: [1, 2, 1]", "1 twice"),
            ("base: demo\nvariants: {a@b: {}}\nseeds: [1]", "`a@b`"),
            ("base: demo\nvariants: {..: {}}\nseeds: [1]", "`..`"),
            ("base: demo\nvariants: {a: 3}\nseeds: [1]", "variant `a`"),
            (
                "base: demo\nvariants: {a: {seed: 3}}\nseeds: [1]",
                "`seeds` lists",
            ),
            (
                "base: demo\nvariants: {a: {}}\nseeds: one",
                "`seeds`: invalid type",
            ),
            (&format!("{whole}preset: huge"), "huge"),
        ] {
            let sentence = parsed(text).unwrap_err().to_string();
            assert!(sentence.contains(part), "{text}: {sentence}");
        }
    }

    #[test]
    fn those_of_the_program_can_be_read() {
        for (name, _) in BUILT_IN {
            let study = StudyFile::load(name).unwrap();
            for (variant, settings) in &study.variants {
                crate::config::Config::resolve(&study.base, study.preset, settings)
                    .unwrap_or_else(|error| panic!("{name}, {variant}: {error}"));
            }
        }
        assert!(
            StudyFile::load("none")
                .unwrap_err()
                .to_string()
                .contains("study-kitti")
        );
    }
}
