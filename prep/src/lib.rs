//! Builds prepared sets from KITTI and renders a stand-in world in KITTI's layouts.
//!
//! A preparation goes one way: the input folders are looked through ([`raw`], [`stereo2015`]),
//! compared with what the split asks for ([`inventory`]), and only then turned into files
//! ([`build`]). [`synth`] writes input folders instead of reading them. Inputs are never changed.
//!
//! What is in a split is defined in `strat-splits`, ground truth from scans in
//! `strat-geometry`, and the layout of the output in `strat-store`.

pub mod build;
pub mod cli;
mod error;
pub mod inventory;
pub mod raw;
pub mod stereo2015;
pub mod synth;

pub use error::{Error, Result};
