//! `prep` from outside, as it is typed: one program, so that it is linked once.

mod cityscapes;
mod cli;
mod damage;
mod inputs;
#[cfg(unix)]
mod kills;
mod make3d;
mod pairs;
mod parts;
#[cfg(unix)]
mod permissions;
mod plan;
mod sets;
mod shards;
mod world;
