//! Maps of a user's own images: which images, which formats, and the files (`bench predict`).
//!
//! Images go through the pipeline of the evaluation; a broken one costs itself only. `request` says what is
//! wanted, `jobs` of which images, `write` makes the files, `cloud` a point cloud, `camera` what other programs
//! want to know of the camera. Not here: what a quantity is ([`crate::quantity`]) and how maps are coloured
//! ([`crate::draw::legend`]).

mod camera;
mod cloud;
mod jobs;
mod predict;
mod request;
mod write;

pub use self::camera::write_camera_info;
pub use self::jobs::{ImageJob, jobs, one_width, refuse_collisions};
pub use self::predict::{Outcome, predict};
pub use self::request::{Format, Request, Target, advice, has_scale, targets};
pub use self::write::{MapError, Writer};
