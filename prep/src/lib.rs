//! Builds prepared sets from KITTI and renders a stand-in world in KITTI's layouts.
//!
//! A preparation goes one way: the inputs, folders or zip archives
//! ([`source`]), are looked through ([`raw`], [`stereo2015`], [`annotated`]),
//! compared with what the split asks for ([`inventory`]), and only then turned into files
//! ([`build`]). [`merge`] makes one set of the parts that several
//! machines prepared, [`plan`] says beforehand what a run needs, [`verify`] looks for damage in inputs and sets, and [`synth`] writes input folders instead of reading them. Inputs are never changed.
//!
//! What is in a split is defined in `strat-splits`, ground truth from scans in
//! `strat-geometry`, and the layout of the output in `strat-store`.

pub mod annotated;
pub mod build;
pub mod cityscapes;
pub mod cli;
pub mod disk;
mod error;
pub mod export;
pub mod inventory;
pub mod make3d;
pub mod mat;
pub mod merge;
mod output;
pub mod pairs;
pub mod plan;
pub mod raw;
pub mod source;
pub mod stereo2015;
pub mod synth;
pub mod verify;
mod workshop;

pub use error::{Error, Result};
