//! The making of a prepared set, whatever it is made of.
//!
//! [`writer`] takes frames through many threads to files ([`files`], [`images`]), tables and the list
//! of failures ([`results`]); [`settings`] keeps sets of different options apart, [`shards`] merges
//! what several machines have made, and [`space`] asks for room before hours of work. Not here: how a
//! sample of a collection is made ([`crate::kitti`], [`crate::collections`]), and the format of a set,
//! which `strat_store` owns.

pub mod files;
pub mod images;
pub mod results;
pub mod sample;
pub mod settings;
pub mod shards;
pub mod space;
pub mod writer;
