//! The KITTI and the Eigen split as prepared sets.
//!
//! [`inventory`] compares what is there with what a split asks for; [`samples`] makes a sample of each
//! frame that can be made. Not here: how the inputs are laid out ([`crate::input`]), and the writing of
//! a set ([`crate::set`]).

pub mod inventory;
pub mod samples;
