//! A configuration put together from its layers.

use std::path::Path;

use strat_store::{human, yaml};

use super::presets::{BUILT_IN, Preset, no_such_config};
use super::settings::{Config, WeightSettings};
use crate::error::{Error, Result};

/// Dotted keys of earlier versions and what they are called now.
const RENAMED: [(&str, &str); 2] = [
    ("discriminator.judges", "discriminator.sharing"),
    ("start_weights", "initial_weights"),
];

impl Config {
    /// The configuration named `source`: a built-in name or a path to a YAML file.
    ///
    /// # Errors
    /// With the file, line and key of what is wrong.
    pub fn load(source: &str) -> Result<Self> {
        if BUILT_IN.iter().any(|(name, _)| *name == source) {
            return Self::built_in(source);
        }
        let path = Path::new(source);
        if !path.exists() {
            return Err(Error::Config(no_such_config(source)));
        }
        Ok(yaml::load(path)?)
    }

    /// Puts all layers together and checks the result.
    ///
    /// `settings` are `key=value` texts with dotted keys.
    ///
    /// # Errors
    /// With the name of the key, preset or file that is wrong.
    pub fn resolve(source: &str, preset: Option<Preset>, settings: &[String]) -> Result<Self> {
        let mut config = Self::load(source)?;
        if let Some(preset) = preset {
            preset.apply(&mut config)?;
        }
        for setting in settings {
            config = config.with_setting(setting)?;
        }
        config.fill();
        config.check()?;
        Ok(config)
    }

    /// The configuration with one `key=value` changed.
    ///
    /// # Errors
    /// When the key is unknown or the value does not fit it.
    pub fn with_setting(&self, setting: &str) -> Result<Self> {
        let (key, value) = setting.split_once('=').ok_or_else(|| {
            Error::Config(format!(
                "`{setting}` is not a setting; write --set key=value, e.g. --set epochs=10"
            ))
        })?;
        let key = key.trim();
        let value: serde_yaml::Value = serde_yaml::from_str(value.trim())
            .map_err(|error| Error::Config(format!("value of `{key}`: {error}")))?;
        let mut tree =
            serde_yaml::to_value(self).map_err(|error| Error::Config(error.to_string()))?;
        let renamed = RENAMED.iter().find(|(old, _)| *old == key);
        let key = renamed.map_or(key, |(_, new)| new);
        let mut place = &mut tree;
        let mut known = Vec::new();
        for part in key.split('.') {
            known = keys(place);
            place = place
                .get_mut(part)
                .ok_or_else(|| Error::Config(unknown_key(key, part, &known)))?;
        }
        if matches!(place, serde_yaml::Value::Mapping(_)) {
            return Err(Error::Config(format!(
                "`{key}` is a group of settings; name one of {} after a dot",
                keys(place).join(", ")
            )));
        }
        drop(known);
        *place = value;
        serde_yaml::from_value(tree).map_err(|error| {
            let problem = yaml::plain(&error.to_string());
            Error::Config(format!("setting `{setting}`: {problem}"))
        })
    }

    /// Writes out the values that depend on others.
    pub(super) fn fill(&mut self) {
        self.weights = WeightSettings::from(self.loss_weights());
        self.discriminator_learning_rate
            .get_or_insert(self.learning_rate);
        self.diagnostics.get_or_insert_default();
        let shorter = self.input.width.min(self.input.height) as usize;
        self.discriminator.patch = self.discriminator.patch.min(shorter);
    }
}

pub(super) fn keys(value: &serde_yaml::Value) -> Vec<String> {
    match value {
        serde_yaml::Value::Mapping(mapping) => mapping
            .keys()
            .filter_map(|key| key.as_str().map(str::to_owned))
            .collect(),
        _ => Vec::new(),
    }
}

fn unknown_key(key: &str, part: &str, known: &[String]) -> String {
    if known.is_empty() {
        return format!("unknown setting `{key}`: nothing is below `{part}`");
    }
    let hint = nearest(part, known.iter().map(String::as_str));
    format!(
        "unknown setting `{key}`: no `{part}`{hint}; known here: {}",
        known.join(", ")
    )
}

/// ` (did you mean `X`?)` with the known word that is nearest to what was written; empty where none is near.
pub(crate) fn nearest<'a>(written: &str, known: impl IntoIterator<Item = &'a str>) -> String {
    human::closest(written, known)
        .map_or(String::new(), |word| format!(" (did you mean `{word}`?)"))
}
