//! What holds across crates: the dependency rules, the whole way from images to tables, and real
//! frames where there are some.

mod aligned;
mod architecture;
mod documents;
mod golden;
mod kitti_samples;
mod modules;
mod oracle;
mod own_sets;
mod pipeline;
mod protocol;
mod python;
mod sources;
mod suspicions;
