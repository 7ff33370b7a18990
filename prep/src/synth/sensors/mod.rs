//! What the car carries: cameras and the laser scanner, and where they are mounted.
//!
//! A picture is made in three steps: rays through the pixels ([`camera`], [`tiles`]), what they see
//! ([`picture`]), and what the chip makes of it ([`sensor`]). Not here: how a surface looks
//! (`shading`).

pub(crate) mod camera;
pub(crate) mod lidar;
pub(crate) mod picture;
pub(crate) mod rig;
pub(crate) mod sensor;
pub(crate) mod tiles;
