//! What a model file says about itself, and a probe that any runtime can be checked with.
//!
//! Stored in ONNX `metadata_props` under keys that begin with `strat.`; [`FORMAT`] is their
//! version. Files of other programs have none of these keys, and a damaged value must not make a
//! model unusable: reading returns what is sound together with a sentence for each value that is
//! not. What the output of a foreign model means is not guessed here; `bench` has a description
//! file for that.

mod camera;
mod description;
mod discriminator;
mod probe;
mod words;

pub use camera::{Spread, TrainingCamera};
pub use description::{FORMAT, ModelMetadata, Reading};
pub use discriminator::DiscriminatorMetadata;
pub use probe::{Probe, ProbeError, probe_image};
pub use words::{InputRange, OutputMeaning, Weights};

#[cfg(test)]
mod tests;
