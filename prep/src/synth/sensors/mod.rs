//! What the car carries: cameras and the laser scanner, and where they are mounted.

pub(crate) mod lidar;
pub(crate) mod picture;
pub(crate) mod rig;
