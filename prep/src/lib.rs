//! Builds prepared sets from KITTI and renders a stand-in world in KITTI's layouts.
//!
//! A preparation goes one way: the inputs, folders or zip archives ([`input`]), are compared with what
//! a split asks for and turned into samples ([`kitti`]), as are other data sets ([`collections`]); the
//! samples become files and tables ([`set`]). [`plan`] says beforehand what a run needs, [`verify`]
//! looks for damage in inputs and sets, [`export`] writes ground truth for other programs, and
//! [`synth`] writes input folders instead of reading them. Inputs are never changed.
//!
//! What is in a split is defined in `strat-splits`, ground truth from scans in
//! `strat-geometry`, and the layout of the output in `strat-store`.

pub mod cli;
pub mod collections;
mod error;
pub mod export;
pub mod input;
pub mod kitti;
mod pickle;
pub mod plan;
pub mod set;
pub mod synth;
pub mod verify;

pub use error::{Error, Result};
