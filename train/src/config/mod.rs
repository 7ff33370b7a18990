//! The configuration of a training run: one tree of settings, defaults in one place.
//!
//! A configuration is built in layers: the defaults below (the thesis' KITTI run), a YAML
//! file (built in or the user's), a preset of sizes, single settings from the command line.
//! Each layer refuses keys it does not know. The result is checked once and then does not
//! change; it is what `--print-config` shows and what is saved beside the weights.
//!
//! Values come from PROTOCOL 4.4 to 4.6; every one is explained in `configs/kitti-strat.yaml`.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use strat_store::set::Content;

use crate::data::augment::AugmentConfig;
use crate::error::{Error, Result};
use crate::loss::Weights;
use crate::network::discriminator::{DiscriminatorConfig, PATCH, SMALLEST_PATCH};
use crate::network::generator::{GeneratorConfig, SIZE_MULTIPLE};
use crate::network::layers::Width;
use crate::training::schedule::{Decay, Variant};

/// Which objective is minimised.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Objective {
    /// The thesis: SSIM, L1 and left-right consistency, adversarial term by variant.
    Strat,
    /// The monodepth baseline: other weights and a smoothness term.
    Monodepth,
}

impl Objective {
    /// Weights of this objective.
    #[must_use]
    pub fn weights(self) -> Weights {
        match self {
            Self::Strat => Weights::STRAT,
            Self::Monodepth => Weights::MONODEPTH,
        }
    }
}

/// Size of the network's input.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Input {
    /// Columns, a multiple of 64.
    pub width: u32,
    /// Rows, a multiple of 64.
    pub height: u32,
}

impl Default for Input {
    fn default() -> Self {
        Self {
            width: 512,
            height: 256,
        }
    }
}

/// Who judges the two views (PROTOCOL 4.5; the thesis does not say).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Judges {
    /// One discriminator sees both views.
    #[default]
    Shared,
    /// Each view has a discriminator of its own.
    PerView,
}

/// The discriminator and what it sees.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DiscriminatorSettings {
    /// One for both views, or one for each.
    pub judges: Judges,
    /// Multiplier on the filter counts.
    pub width: Width,
    /// Side of the square patches, at most the input's shorter side.
    pub patch: usize,
}

impl Default for DiscriminatorSettings {
    fn default() -> Self {
        Self {
            judges: Judges::Shared,
            width: Width::FULL,
            patch: PATCH,
        }
    }
}

impl DiscriminatorSettings {
    /// The network's own configuration.
    #[must_use]
    pub fn network(&self) -> DiscriminatorConfig {
        DiscriminatorConfig { width: self.width }
    }
}

/// Weights of the loss terms; what is not given is that of the objective.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct WeightSettings {
    /// Structural dissimilarity.
    pub ssim: Option<f64>,
    /// Absolute colour difference.
    pub l1: Option<f64>,
    /// Left-right consistency.
    pub left_right: Option<f64>,
    /// Horizontal smoothness.
    pub smoothness: Option<f64>,
    /// Adversarial term; 0 without effect in the variant `no-adv`.
    pub adversarial: Option<f64>,
}

/// When and how validation runs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ValidationSettings {
    /// Epochs between validations; 0 = never.
    pub every: u64,
    /// Validation pairs used, evenly spread over all; 0 = all.
    pub images: usize,
    /// Evaluation protocol for pairs with Velodyne depth.
    pub protocol: String,
}

impl Default for ValidationSettings {
    fn default() -> Self {
        Self {
            every: 1,
            images: 0,
            protocol: "eigen-80".to_owned(),
        }
    }
}

/// When checkpoints are written and which are kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CheckpointSettings {
    /// Epochs between checkpoints.
    pub every: u64,
    /// Newest checkpoints kept; the best by validation is kept besides.
    pub keep: usize,
}

impl Default for CheckpointSettings {
    fn default() -> Self {
        Self { every: 1, keep: 2 }
    }
}

/// Pictures of validation pairs, to look at while training goes on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PictureSettings {
    /// Epochs between pictures; 0 = never.
    pub every: u64,
    /// Pairs shown.
    pub images: usize,
}

impl Default for PictureSettings {
    fn default() -> Self {
        Self {
            every: 5,
            images: 4,
        }
    }
}

/// Everything that decides a training run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// What the prepared set must be made of: a split of KITTI or another collection.
    pub split: Content,
    /// How the baseline of the adversarial term is chosen.
    pub variant: Variant,
    /// Which objective is minimised.
    pub objective: Objective,
    /// Passes over the training pairs.
    pub epochs: u64,
    /// Stop after this many optimizer steps; the schedules still aim at `epochs`.
    pub max_steps: Option<u64>,
    /// Pairs per forward pass.
    pub batch: usize,
    /// Forward passes per optimizer step.
    pub accumulate: usize,
    /// Learning rate of the generator.
    pub learning_rate: f64,
    /// Learning rate of the discriminator; none = that of the generator.
    pub discriminator_learning_rate: Option<f64>,
    /// How both learning rates fall.
    pub decay: Decay,
    /// Baseline fraction in the first epoch of the structured variant.
    pub baseline_start: f64,
    /// Seed of everything random.
    pub seed: u64,
    /// Safetensors file of weights to begin with; none = those of the seed.
    pub start_weights: Option<PathBuf>,
    /// Threads that decode images; 0 = one per core.
    pub workers: usize,
    /// Keep decoded pairs in memory if all of them fit into this many MiB.
    pub cache_mib: u64,
    /// Size of the network's input.
    pub input: Input,
    /// The disparity network.
    pub network: GeneratorConfig,
    /// The discriminator.
    pub discriminator: DiscriminatorSettings,
    /// Weights of the loss terms.
    pub weights: WeightSettings,
    /// Augmentation of the training pairs.
    pub augment: AugmentConfig,
    /// Validation.
    pub validation: ValidationSettings,
    /// Checkpoints.
    pub checkpoint: CheckpointSettings,
    /// Pictures.
    pub pictures: PictureSettings,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            split: Content::Kitti,
            variant: Variant::Strat,
            objective: Objective::Strat,
            epochs: 50,
            max_steps: None,
            batch: 8,
            accumulate: 1,
            learning_rate: 1e-4,
            discriminator_learning_rate: None,
            decay: Decay::Linear,
            baseline_start: 0.1,
            seed: 1,
            start_weights: None,
            workers: 0,
            cache_mib: 1024,
            input: Input::default(),
            network: GeneratorConfig::default(),
            discriminator: DiscriminatorSettings::default(),
            weights: WeightSettings::default(),
            augment: AugmentConfig::default(),
            validation: ValidationSettings::default(),
            checkpoint: CheckpointSettings::default(),
            pictures: PictureSettings::default(),
        }
    }
}

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

    fn apply(self, config: &mut Config) -> Result<()> {
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
        Ok(strat_store::yaml::load(path)?)
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
                "`{setting}` is no setting; write --set key=value, e.g. --set epochs=10"
            ))
        })?;
        let key = key.trim();
        let value: serde_yaml::Value = serde_yaml::from_str(value.trim())
            .map_err(|error| Error::Config(format!("value of `{key}`: {error}")))?;
        let mut tree =
            serde_yaml::to_value(self).map_err(|error| Error::Config(error.to_string()))?;
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
        serde_yaml::from_value(tree)
            .map_err(|error| Error::Config(format!("setting `{setting}`: {error}")))
    }

    /// Writes out the values that depend on others.
    fn fill(&mut self) {
        let defaults = self.objective.weights();
        let weights = &mut self.weights;
        weights.ssim.get_or_insert(defaults.ssim);
        weights.l1.get_or_insert(defaults.l1);
        weights.left_right.get_or_insert(defaults.left_right);
        weights.smoothness.get_or_insert(defaults.smoothness);
        weights.adversarial.get_or_insert(defaults.adversarial);
        if !self.variant.is_adversarial() {
            weights.adversarial = Some(0.0);
        }
        self.discriminator_learning_rate
            .get_or_insert(self.learning_rate);
        let shorter = self.input.width.min(self.input.height) as usize;
        self.discriminator.patch = self.discriminator.patch.min(shorter);
    }

    /// The weights of the loss terms.
    #[must_use]
    pub fn loss_weights(&self) -> Weights {
        let defaults = self.objective.weights();
        let own = &self.weights;
        Weights {
            ssim: own.ssim.unwrap_or(defaults.ssim),
            l1: own.l1.unwrap_or(defaults.l1),
            left_right: own.left_right.unwrap_or(defaults.left_right),
            smoothness: own.smoothness.unwrap_or(defaults.smoothness),
            adversarial: if self.variant.is_adversarial() {
                own.adversarial.unwrap_or(defaults.adversarial)
            } else {
                0.0
            },
        }
    }

    /// Learning rate of the discriminator before any decay.
    #[must_use]
    pub fn discriminator_rate(&self) -> f64 {
        self.discriminator_learning_rate
            .unwrap_or(self.learning_rate)
    }

    fn check(&self) -> Result<()> {
        let refuse = |condition: bool, sentence: String| {
            if condition {
                Err(Error::Config(sentence))
            } else {
                Ok(())
            }
        };
        for (key, value) in [
            ("epochs", self.epochs),
            ("batch", self.batch as u64),
            ("accumulate", self.accumulate as u64),
            ("checkpoint.every", self.checkpoint.every),
            ("checkpoint.keep", self.checkpoint.keep as u64),
        ] {
            refuse(value == 0, format!("`{key}` is 0; it must be at least 1"))?;
        }
        refuse(
            self.max_steps == Some(0),
            "`max_steps` is 0; leave it out to train all epochs".to_owned(),
        )?;
        let rate = |key: &str, value: f64| {
            refuse(
                !(value > 0.0 && value <= 1.0),
                format!("`{key}` is {value}; it must be above 0 and at most 1"),
            )
        };
        rate("learning_rate", self.learning_rate)?;
        rate("discriminator_learning_rate", self.discriminator_rate())?;
        refuse(
            !(0.0..=1.0).contains(&self.baseline_start),
            format!(
                "`baseline_start` is {}; it must be between 0 and 1",
                self.baseline_start
            ),
        )?;
        for (key, value) in [
            ("input.width", self.input.width),
            ("input.height", self.input.height),
        ] {
            refuse(
                value == 0 || !(value as usize).is_multiple_of(SIZE_MULTIPLE) || value > 8192,
                format!(
                    "`{key}` is {value}; the network needs a multiple of {SIZE_MULTIPLE}, \
                     at most 8192"
                ),
            )?;
        }
        refuse(
            self.discriminator.patch < SMALLEST_PATCH,
            format!(
                "`discriminator.patch` is {}; the discriminator needs at least {SMALLEST_PATCH}",
                self.discriminator.patch
            ),
        )?;
        let weights = self.loss_weights();
        for (key, value) in [
            ("ssim", weights.ssim),
            ("l1", weights.l1),
            ("left_right", weights.left_right),
            ("smoothness", weights.smoothness),
            ("adversarial", weights.adversarial),
        ] {
            refuse(
                !(value.is_finite() && value >= 0.0),
                format!("`weights.{key}` is {value}; it must be a number of at least 0"),
            )?;
        }
        refuse(
            weights.ssim == 0.0 && weights.l1 == 0.0,
            "`weights.ssim` and `weights.l1` are both 0; then nothing ties the disparity to \
             the images"
                .to_owned(),
        )?;
        refuse(
            self.variant.is_adversarial() && weights.adversarial == 0.0,
            format!(
                "`weights.adversarial` is 0 in the variant `{}`; use `variant: no-adv` instead",
                self.variant.name()
            ),
        )?;
        let augment = &self.augment;
        for (key, value) in [("flip", augment.flip), ("colour", augment.colour)] {
            refuse(
                !(0.0..=1.0).contains(&value),
                format!("`augment.{key}` is {value}; it is a probability"),
            )?;
        }
        for (key, [low, high]) in [
            ("gamma", augment.gamma),
            ("brightness", augment.brightness),
            ("channel", augment.channel),
        ] {
            refuse(
                !(low > 0.0 && low <= high && high.is_finite()),
                format!("`augment.{key}` is [{low}, {high}]; it must ascend from above 0"),
            )?;
        }
        let protocol = strat_metrics::protocol(&self.validation.protocol);
        refuse(
            protocol.as_ref().is_none_or(|p| {
                p.ground_truth.is_stereo() || p.grouping != strat_metrics::Grouping::None
            }),
            format!(
                "`validation.protocol` is `{}`; choose a Velodyne protocol such as eigen-80 \
                 (`bench protocols` lists all)",
                self.validation.protocol
            ),
        )
    }

    /// The YAML text of all settings.
    ///
    /// # Errors
    /// When a value cannot be written, which no checked configuration has.
    pub fn to_yaml(&self) -> Result<String> {
        Ok(strat_store::yaml::to_string(self)?)
    }

    /// Digest of the settings that decide the weights: a run is resumed only with the same.
    ///
    /// # Errors
    /// As [`Self::to_yaml`].
    pub fn digest(&self) -> Result<String> {
        let defaults = Self::default();
        let deciding = Self {
            max_steps: None,
            workers: 0,
            cache_mib: 0,
            validation: defaults.validation,
            checkpoint: defaults.checkpoint,
            pictures: defaults.pictures,
            ..self.clone()
        };
        Ok(strat_store::files::blake3_hex(
            deciding.to_yaml()?.as_bytes(),
        ))
    }
}

fn keys(value: &serde_yaml::Value) -> Vec<String> {
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
    format!(
        "unknown setting `{key}`: there is no `{part}`; known here: {}",
        known.join(", ")
    )
}

fn no_such_config(name: &str) -> String {
    let names: Vec<&str> = BUILT_IN.iter().map(|(name, _)| *name).collect();
    format!(
        "there is no configuration `{name}`: it is neither a file nor one of {}",
        names.join(", ")
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::network::generator::{Decoder, Head};

    fn resolved(name: &str) -> Config {
        Config::resolve(name, None, &[]).unwrap()
    }

    /// The defaults with their dependent values written out.
    fn base() -> Config {
        let mut config = Config::default();
        config.fill();
        config
    }

    fn without_discriminator(mut config: Config) -> Config {
        config.variant = Variant::NoAdv;
        config.weights.adversarial = Some(0.0);
        config
    }

    #[test]
    fn the_thesis_configurations_differ_from_the_defaults_as_stated() {
        assert_eq!(resolved("kitti-strat"), base());
        for (name, split) in [("kitti", Content::Kitti), ("eigen", Content::Eigen)] {
            let of = |variant| Config {
                split,
                variant,
                ..base()
            };
            assert_eq!(resolved(&format!("{name}-strat")), of(Variant::Strat));
            assert_eq!(resolved(&format!("{name}-fixed")), of(Variant::Fixed));
            assert_eq!(resolved(&format!("{name}-random")), of(Variant::Random));
            assert_eq!(
                resolved(&format!("{name}-noadv")),
                without_discriminator(of(Variant::NoAdv))
            );
        }
    }

    #[test]
    fn the_monodepth_configuration_is_the_reference_baseline() {
        let mut expected = without_discriminator(base());
        expected.objective = Objective::Monodepth;
        expected.decay = Decay::Halve;
        expected.network = GeneratorConfig {
            decoder: Decoder::NearestConv,
            head: Head::Sigmoid,
            bottleneck: false,
            ..GeneratorConfig::default()
        };
        expected.weights = WeightSettings {
            ssim: Some(0.85),
            l1: Some(0.15),
            left_right: Some(1.0),
            smoothness: Some(0.1),
            adversarial: Some(0.0),
        };
        assert_eq!(resolved("kitti-monodepth"), expected);
    }

    #[test]
    fn the_demo_keeps_the_thesis_method() {
        let demo = resolved("demo");
        assert_eq!(demo.split, Content::Eigen);
        assert_eq!(demo.variant, Variant::Strat);
        assert_eq!(demo.objective, Objective::Strat);
        assert_eq!(demo.loss_weights(), Weights::STRAT);
        assert_eq!(demo.baseline_start, 0.1);
    }

    #[test]
    fn kitti_strat_names_every_setting() {
        // The commented file is the reference of the settings: it must show all of them.
        let (_, text) = BUILT_IN[0];
        let shown: serde_yaml::Value = serde_yaml::from_str(text).unwrap();
        let all = serde_yaml::to_value(Config::default()).unwrap();
        assert_eq!(keys(&shown), keys(&all));
        for key in keys(&all) {
            assert_eq!(
                keys(&shown[key.as_str()]),
                keys(&all[key.as_str()]),
                "{key}"
            );
        }
    }

    #[test]
    fn every_line_of_a_built_in_file_is_preceded_by_or_ends_in_a_comment() {
        for (name, text) in BUILT_IN {
            let mut commented = false;
            for line in text.lines() {
                let line = line.trim();
                if line.is_empty() {
                    commented = false;
                } else if line.starts_with('#') {
                    commented = true;
                } else {
                    assert!(commented || line.contains(" # "), "{name}: `{line}`");
                    commented = false;
                }
            }
        }
    }

    #[test]
    fn settings_change_one_value_and_refuse_unknown_keys() {
        let settings = [
            "epochs=3".to_owned(),
            "network.width=1/4".to_owned(),
            "augment.gamma=[1.0, 1.0]".to_owned(),
            "max_steps=7".to_owned(),
        ];
        let config = Config::resolve("kitti-strat", None, &settings).unwrap();
        assert_eq!(config.epochs, 3);
        assert_eq!(config.network.width, Width::new(1, 4).unwrap());
        assert_eq!(config.augment.gamma, [1.0, 1.0]);
        assert_eq!(config.max_steps, Some(7));
        for (setting, part) in [
            ("epoch=3", "`epoch`"),
            ("network.depth=3", "`depth`"),
            ("epochs.x=3", "nothing is below"),
            ("network=3", "group of settings"),
            ("epochs", "key=value"),
            ("epochs=many", "epochs"),
            ("batch=0", "`batch`"),
            ("input.width=500", "`input.width`"),
            ("weights.adversarial=0", "no-adv"),
            ("learning_rate=.nan", "`learning_rate`"),
            ("validation.protocol=kitti2015", "Velodyne"),
            ("variant=best", "variant"),
        ] {
            let message = Config::resolve("kitti-strat", None, &[setting.to_owned()])
                .expect_err(setting)
                .to_string();
            assert!(message.contains(part), "{setting}: {message}");
        }
    }

    #[test]
    fn an_unknown_key_in_a_file_is_named_with_its_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mine.yaml");
        std::fs::write(&path, "split: eigen\nepochs: 3\nlearning_rates: 0.1\n").unwrap();
        let message = Config::load(path.to_str().unwrap())
            .unwrap_err()
            .to_string();
        assert!(message.contains("learning_rates"), "{message}");
        assert!(message.contains("line 3"), "{message}");
        assert!(message.contains("mine.yaml"), "{message}");
    }

    #[test]
    fn presets_set_the_sizes_only() {
        for (name, preset) in Preset::ALL {
            assert_eq!(name.parse::<Preset>().unwrap(), preset);
            let config = Config::resolve("eigen-fixed", Some(preset), &[]).unwrap();
            let expected = Config {
                network: GeneratorConfig {
                    width: config.network.width,
                    ..GeneratorConfig::default()
                },
                discriminator: config.discriminator,
                input: config.input,
                batch: config.batch,
                ..resolved("eigen-fixed")
            };
            assert_eq!(config, expected, "{name}");
        }
        assert!("huge".parse::<Preset>().is_err());
    }

    #[test]
    fn the_printed_configuration_reads_back_as_itself() {
        let config = resolved("kitti-monodepth");
        let text = config.to_yaml().unwrap();
        let again: Config = serde_yaml::from_str(&text).unwrap();
        assert_eq!(again, config);
    }

    #[test]
    fn the_digest_covers_what_decides_the_weights_only() {
        let config = base();
        let digest = config.digest().unwrap();
        for (setting, same) in [
            ("workers=7", true),
            ("max_steps=7", true),
            ("checkpoint.keep=7", true),
            ("seed=7", false),
            ("network.head=sigmoid", false),
        ] {
            let other = config.with_setting(setting).unwrap().digest().unwrap();
            assert_eq!(other == digest, same, "{setting}");
        }
    }
}
