//! Inputs as they are handed out: KITTI's folders and archives, and MATLAB's files.
//!
//! A [`source`] is a file or an entry of a zip archive; [`raw`], [`stereo2015`] and [`annotated`] know
//! the layouts of KITTI's data sets, and [`mat`] reads the arrays of Make3D. Inputs are never changed.
//! Not here: what is made of them ([`crate::kitti`], [`crate::collections`]).

pub mod annotated;
pub mod mat;
pub mod raw;
pub mod source;
pub mod stereo2015;
