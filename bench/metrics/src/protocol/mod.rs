//! Named, versioned evaluation protocols.
//!
//! A [`Protocol`] holds every choice that can change a figure. The values are those of the
//! reference evaluation of Godard et al. (CVPR 2017), see PROTOCOL 3.1 to 3.9, and of models without
//! a scale PROTOCOL 10; where the
//! reference has a habit that one would not choose today (truncated crop fractions, ground
//! truth in a lidar axis, a nominal baseline), the habit is a field here and not a constant
//! in the arithmetic.
//!
//! The digest of a protocol stands on each row computed under it. Changing what a protocol
//! means therefore changes its digest, and rows of the two meanings no longer mix.
//!
//! `choices`, `camera` and `group` are the values that the `rules` of a protocol are made of,
//! `registry` has the protocols with names, `name` their suffixes, `text` writes one down and takes its digest.
//!
//! Not here: the arithmetic that follows a protocol, see [`evaluate`](crate::evaluate()).

mod camera;
mod choices;
mod group;
mod name;
mod registry;
mod rules;
#[cfg(test)]
mod tests;
mod text;

pub use camera::{Camera, CameraError, KnownCamera, StereoCamera};
pub use choices::{
    Alignment, BenchmarkCrop, Crop, D1Rule, GroundTruthKind, InfiniteDepth, LogBase,
    PostProcessing, Resize,
};
pub use group::{Group, Grouping, UnknownGroup};
pub(crate) use name::canonical;
pub use name::{ProtocolName, Suffix, protocol};
pub use registry::protocols;
pub use rules::Protocol;
