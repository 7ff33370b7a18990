//! The configuration of a training run: one tree of settings, defaults in one place.
//!
//! A configuration is built in layers: the defaults in `settings` (the thesis' KITTI run), a YAML
//! file (built in or the user's), a preset of sizes, single settings from the command line.
//! Each layer refuses keys it does not know. The result is checked once and then does not
//! change; it is what `--print-config` shows and what is saved beside the weights.
//!
//! Values come from PROTOCOL 4.4 to 4.6; every one is explained in `configs/kitti-strat.yaml`.

mod check;
mod choices;
mod presets;
mod resolve;
mod settings;

pub use choices::{Decay, Objective, Sharing, Variant};
pub use presets::{BUILT_IN, Preset};
pub(crate) use resolve::nearest;
pub use settings::{
    CheckpointSettings, Config, DiagnosticSettings, DiscriminatorSettings, Input, PictureSettings,
    ValidationSettings, WeightSettings,
};

#[cfg(test)]
mod tests;
