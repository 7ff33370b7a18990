//! What the workspace's own tests and the demo share: the steps of the demo.
//!
//! Each step is one of the three commands with the arguments a user would type,
//! so that what the demo does can be repeated by hand line by line. Nothing here
//! computes a figure itself.

pub mod steps;
