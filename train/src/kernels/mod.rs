//! What the CPU backend computes slowly, written out.
//!
//! burn's CPU backend is slow in the weight gradient of a convolution and evaluates an activation, a
//! sampling along rows or a structural similarity, and their gradients, as many passes over memory. The
//! operations here give the same numbers through matrix products over unfolded tiles and single
//! passes. On every other backend, and for element types other than `f32`, burn's own operations
//! are used instead: by the convolutions here themselves, otherwise by the callers.
//!
//! Results do not depend on the number of threads: work is divided by shape alone and partial sums
//! are added in a fixed order.
//!
//! Not here: anything that is as fast in burn already, such as forward convolutions.

pub(crate) mod activation;
pub(crate) mod conv;
mod cpu;
pub(crate) mod dssim;
pub(crate) mod sampler;
