//! The two networks: layers, the disparity network, the discriminator, and where their first weights
//! come from.
//!
//! The topology is written once, generic over [`layers::Ops`]; training and the ONNX export both run it.
//! Not here: what is minimised ([`crate::loss`]) and how ([`crate::training`]).

pub mod discriminator;
pub mod generator;
pub mod initial_weights;
pub mod layers;
