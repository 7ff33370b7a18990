//! What is in the KITTI and Eigen splits: drives, frames, roles, validation draw, digest, and what
//! was recorded together; and whether a test image comes from a training drive.
//!
//! Both splits are lists of complete drives of KITTI raw (PROTOCOL 2.1); training and
//! validation follow from the drive table, the test sets are the 200 KITTI stereo 2015
//! training scenes (`kitti`) and the 697 frames of Eigen et al. (`eigen`). The data files
//! lie in `splits/data` and are compiled in; their README states their origin.
//!
//! This crate does no I/O and knows nothing about folders, images or calibration.

mod frame;
mod leakage;
mod recording;
mod role;
mod split;
mod table;

pub use frame::{Date, DriveId, FrameId, ParseIdError};
pub use leakage::{Leakage, Training, leakage};
pub use recording::{Recording, recording};
pub use role::{ParseSplitError, Role, Split};
pub use split::{
    Counts, MAKE3D_TEST_IMAGES, VALIDATION_PER_DRIVE, counts, digest, kitti2015_id, test_ids,
    test_images, training, validation,
};
pub use table::{
    Category, Drive, DriveRole, drives, eigen_test, has_annotated_depth, kitti2015_origin,
};
