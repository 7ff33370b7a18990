//! The prepared set in both directions: manifest, images, EXR depth, resize kernels, hashes,
//! atomic writes.
//!
//! `prep` writes a prepared set, `train` and `bench` read it; this crate alone owns its
//! format ([`set`], [`layout`]). The parts it is made of can be used one by one: [`image_files`] and
//! [`resize`] for pictures, [`exr`] for depth, [`npy`] for NumPy's arrays, [`files`] for writing,
//! [`inputs`] for reading what may be anything,
//! [`yaml`] for configuration. [`command`] (exit codes, errors, printing), [`shell`] (completions, manual
//! pages, colour), [`progress`], [`human`], [`guard`], [`threads`], [`signals`], [`shard`] and [`spread`]
//! are what the three commands do alike. It knows nothing about where data comes from, nor the options of
//! any command.

pub mod claim;
pub mod command;
mod error;
pub mod exr;
pub mod failures;
pub mod fault;
pub mod files;
pub mod guard;
pub mod human;
pub mod image_files;
pub mod inputs;
pub mod npy;
pub mod progress;
pub mod raster;
pub mod resize;
pub mod set;
pub mod shard;
pub mod shell;
pub mod signals;
pub mod spread;
pub mod threads;
pub mod yaml;

pub use error::{Error, Result};
pub use set::layout;
