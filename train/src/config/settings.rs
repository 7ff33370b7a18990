//! The tree of settings and their defaults.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use strat_store::set::Content;

use super::choices::{Decay, Objective, Sharing, Variant};
use crate::data::augment::AugmentConfig;
use crate::error::Result;
use crate::loss::Weights;
use crate::network::discriminator::{DiscriminatorConfig, PATCH};
use crate::network::generator::GeneratorConfig;
use crate::network::layers::Width;

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

impl Input {
    /// Rows and columns.
    #[must_use]
    pub fn size(&self) -> [usize; 2] {
        [self.height as usize, self.width as usize]
    }
}

/// The discriminator and what it sees.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DiscriminatorSettings {
    /// One for both views, or one for each.
    #[serde(alias = "judges")]
    pub sharing: Sharing,
    /// Multiplier on the filter counts.
    pub width: Width,
    /// Side of the square patches, at most the input's shorter side.
    pub patch: usize,
}

impl Default for DiscriminatorSettings {
    fn default() -> Self {
        Self {
            sharing: Sharing::Shared,
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

impl From<Weights> for WeightSettings {
    fn from(weights: Weights) -> Self {
        Self {
            ssim: Some(weights.ssim),
            l1: Some(weights.l1),
            left_right: Some(weights.left_right),
            smoothness: Some(weights.smoothness),
            adversarial: Some(weights.adversarial),
        }
    }
}

/// When and how validation runs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ValidationSettings {
    /// Epochs between validations; 0 = never.
    pub every: u64,
    /// Validation pairs used, evenly spread over all; 0 = all.
    pub images: usize,
    /// Evaluation protocol: scans or annotated depth, whole images, one prediction each.
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

/// What is measured to see why a run learns what it learns; without effect on its weights.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DiagnosticSettings {
    /// Epochs between measurements of the gradients of each term; 0 = never.
    pub every: u64,
}

impl Default for DiagnosticSettings {
    fn default() -> Self {
        Self { every: 1 }
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
    #[serde(alias = "start_weights")]
    pub initial_weights: Option<PathBuf>,
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
    /// Diagnostics; absent only in the text that the digest is taken of, so that runs from before
    /// this group keep theirs.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub diagnostics: Option<DiagnosticSettings>,
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
            initial_weights: None,
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
            diagnostics: Some(DiagnosticSettings::default()),
        }
    }
}

impl Config {
    /// When diagnostics are taken.
    #[must_use]
    pub fn diagnostics(&self) -> DiagnosticSettings {
        self.diagnostics.unwrap_or_default()
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
            adversarial: match self.variant.is_adversarial() {
                true => own.adversarial.unwrap_or(defaults.adversarial),
                false => 0.0,
            },
        }
    }

    /// Learning rate of the discriminator before any decay.
    #[must_use]
    pub fn discriminator_rate(&self) -> f64 {
        self.discriminator_learning_rate
            .unwrap_or(self.learning_rate)
    }

    /// The YAML text of all settings.
    ///
    /// # Errors
    /// When a value cannot be written, which no checked configuration has.
    pub fn to_yaml(&self) -> Result<String> {
        Ok(strat_store::yaml::to_string(self)?)
    }

    /// A sentence for each line of the settings that is another in `now`.
    ///
    /// # Errors
    /// As [`Self::to_yaml`].
    pub fn differences(&self, now: &Self) -> Result<Vec<String>> {
        let (before, now) = (self.to_yaml()?, now.to_yaml()?);
        let lines = before.lines().zip(now.lines());
        let changed = lines.filter(|(before, now)| before != now);
        let sentence =
            |(before, now): (&str, &str)| format!("`{}` is now `{}`", before.trim(), now.trim());
        Ok(changed.map(sentence).collect())
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
            diagnostics: None,
            ..self.clone()
        };
        Ok(strat_store::files::blake3_hex(
            deciding.to_yaml()?.as_bytes(),
        ))
    }
}
