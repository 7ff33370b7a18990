//! The making of a prepared set, whatever it is made of.
//!
//! [`writer`] takes frames through many threads to files, tables and the list of failures; [`shards`]
//! merges what several machines have made; [`space`] asks for room before hours of work. Not here: how
//! a sample of a collection is made, and the format of a set, which `strat_store::set` owns.

pub mod shards;
pub mod space;
pub mod writer;
