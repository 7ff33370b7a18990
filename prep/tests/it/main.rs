//! `prep` from outside, as it is typed: one program, so that it is linked once.

mod cityscapes;
mod cli;
mod make3d;
mod pairs;
mod parts;
mod plan;
mod shards;
