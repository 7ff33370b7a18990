//! Training objectives (PROTOCOL 4.4): photometric, left-right and adversarial terms, and the
//! objective of the monodepth baseline.
//!
//! All reductions are means over batch, channels and pixels; the published weights presume that.
//! Photometric and left-right terms are taken at four scales and always at the full baseline; only
//! the fakes the discriminator sees are synthesised at a fraction of it.
//!
//! Not here: the discriminator, augmentation, schedules.

mod adversarial;
mod photometric;
pub mod sampler;
mod terms;

pub use adversarial::{discriminator_adversarial, generator_adversarial, synthesize};
pub use photometric::{area_pyramid, dssim, horizontal_smoothness, stereo_losses};
pub use terms::{SideTerms, Term, TermValues, Terms, Weights, scalar};

#[cfg(test)]
mod tests;
