//! Configurations and sizes that are part of the program.

use std::str::FromStr;

use super::settings::{Config, Input};
use crate::error::{Error, Result};
use crate::network::discriminator::PATCH;
use crate::network::layers::Width;

/// Configurations that are part of the program: name and text.
pub const BUILT_IN: [(&str, &str); 10] = [
    (
        "kitti-strat",
        include_str!("../../configs/kitti-strat.yaml"),
    ),
    (
        "kitti-fixed",
        include_str!("../../configs/kitti-fixed.yaml"),
    ),
    (
        "kitti-random",
        include_str!("../../configs/kitti-random.yaml"),
    ),
    (
        "kitti-noadv",
        include_str!("../../configs/kitti-noadv.yaml"),
    ),
    (
        "kitti-monodepth",
        include_str!("../../configs/kitti-monodepth.yaml"),
    ),
    (
        "eigen-strat",
        include_str!("../../configs/eigen-strat.yaml"),
    ),
    (
        "eigen-fixed",
        include_str!("../../configs/eigen-fixed.yaml"),
    ),
    (
        "eigen-random",
        include_str!("../../configs/eigen-random.yaml"),
    ),
    (
        "eigen-noadv",
        include_str!("../../configs/eigen-noadv.yaml"),
    ),
    ("demo", include_str!("../../configs/demo.yaml")),
];

/// Sizes that make a run smaller, for slower machines.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Preset {
    /// The thesis' network and input.
    Full,
    /// Half the channels.
    Half,
    /// A quarter of the channels, half the input size.
    Quarter,
    /// For tests: a sixteenth of the channels, 128x64.
    Tiny,
    /// The sizes of the `demo` configuration.
    Demo,
}

impl Preset {
    /// All presets with their names.
    pub const ALL: [(&'static str, Self); 5] = [
        ("full", Self::Full),
        ("half", Self::Half),
        ("quarter", Self::Quarter),
        ("tiny", Self::Tiny),
        ("demo", Self::Demo),
    ];

    /// The name that selects it.
    #[must_use]
    pub fn name(self) -> &'static str {
        let named = Self::ALL.iter().find(|(_, preset)| *preset == self);
        named.map_or("", |(name, _)| name)
    }

    pub(crate) fn apply(self, config: &mut Config) -> Result<()> {
        let (denominator, width, height, batch) = match self {
            Self::Full => (1, 512, 256, 8),
            Self::Half => (2, 512, 256, 8),
            Self::Quarter => (4, 256, 128, 8),
            Self::Tiny => (16, 128, 64, 4),
            Self::Demo => {
                let demo = Config::built_in("demo")?;
                config.network.width = demo.network.width;
                config.discriminator.width = demo.discriminator.width;
                config.discriminator.patch = demo.discriminator.patch;
                config.input = demo.input;
                config.batch = demo.batch;
                return Ok(());
            }
        };
        let fraction =
            Width::new(1, denominator).map_err(|error| Error::Config(error.to_string()))?;
        config.network.width = fraction;
        config.discriminator.width = fraction;
        config.discriminator.patch = PATCH.min(height as usize);
        config.input = Input { width, height };
        config.batch = batch;
        Ok(())
    }
}

impl FromStr for Preset {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        Self::ALL
            .iter()
            .find(|(name, _)| *name == text)
            .map(|(_, preset)| *preset)
            .ok_or_else(|| {
                let names: Vec<&str> = Self::ALL.iter().map(|(name, _)| *name).collect();
                Error::Config(format!(
                    "unknown preset `{text}`; choose one of {}",
                    names.join(", ")
                ))
            })
    }
}

impl Config {
    /// A configuration by its built-in name, unchecked.
    ///
    /// # Errors
    /// When there is none of that name.
    pub fn built_in(name: &str) -> Result<Self> {
        let (_, text) = BUILT_IN
            .iter()
            .find(|(known, _)| *known == name)
            .ok_or_else(|| Error::Config(no_such_config(name)))?;
        serde_yaml::from_str(text)
            .map_err(|error| Error::Config(format!("built-in configuration {name}: {error}")))
    }
}

pub(super) fn no_such_config(name: &str) -> String {
    let names: Vec<&str> = BUILT_IN.iter().map(|(name, _)| *name).collect();
    format!(
        "unknown configuration `{name}`: it is neither a file nor one of {}",
        names.join(", ")
    )
}
