//! Training pairs from a prepared set: reading ([`pairs`]), augmentation ([`augment`]), batches ahead of
//! time ([`loader`]).
//!
//! A pair whose files cannot be read is replaced by the next one in the epoch's order and
//! named once; training stops when more than one in a hundred pairs are like that.
//!
//! Nothing is downloaded, written or checked against hashes here: `prep verify` does that.

pub mod augment;
pub mod loader;
pub mod pairs;
