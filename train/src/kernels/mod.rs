//! What the CPU backend computes slowly, written out.
//!
//! burn's CPU backend unfolds images in memory for a convolution, has no kernel for the gradient of its
//! weights, asks for every value of a pool's window by itself, and evaluates an activation, a normalisation, a
//! sampling along rows, a structural similarity, a step of Adam, and their gradients, as many passes over
//! memory. The operations here give the same numbers: convolutions through one [`product`] that packs windows
//! straight from the image, with bias and activation in its last pass, and the rest in single passes. On every
//! other backend, and for element types other than `f32`, burn's own operations are used instead: by the
//! operations here themselves, or by their callers.
//!
//! Results do not depend on the number of threads: work is divided by shape alone and partial sums
//! are added in a fixed order.
//!
//! Not here: anything that is as fast in burn already.

pub(crate) mod activation;
pub(crate) mod adam;
pub(crate) mod conv;
mod cpu;
pub(crate) mod dssim;
pub(crate) mod norm;
pub(crate) mod pool;
mod product;
pub(crate) mod sampler;
