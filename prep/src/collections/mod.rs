//! The collections beside KITTI as prepared sets: own pairs, Make3D, Cityscapes.
//!
//! Each says which frames there are and how a sample is made of one; here is what they share. Not here:
//! KITTI's splits ([`crate::kitti`]), and the writing of a set ([`crate::set`]).

pub mod cityscapes;
pub mod make3d;
pub mod pairs;

use std::collections::BTreeMap;
use std::path::Path;

use strat_splits::Role;
use strat_store::set::{Content, Sample};

use crate::error::Result;
use crate::set::files::SetFiles;
use crate::set::results::Failure;
use crate::set::sample::{Frame, SampleResult};
use crate::set::settings::Settings;
use crate::set::writer::{Report, SetOptions, write_set};

/// Frames of a collection, and what of it could not be used before any was tried.
struct Frames<T> {
    frames: Vec<Frame<T>>,
    failures: Vec<Failure>,
    /// Samples the set should have per role.
    expected: BTreeMap<Role, u64>,
}

/// Makes all frames and writes the set, or the part of it that is asked for. Nothing is written into an
/// input folder.
///
/// # Errors
/// The output cannot be written. Bad inputs alone are no error here.
fn build<T: Sync>(
    content: Content,
    options: &SetOptions,
    inputs: &[&Path],
    frames: Frames<T>,
    make: impl Fn(&SetFiles<'_>, &Frame<T>) -> SampleResult<Sample> + Sync,
) -> Result<Report> {
    let settings = Settings::new(content, false, options.images);
    settings.check_output(&options.out, inputs)?;
    // A manifest counts all roles, those without samples too.
    let expected = |role| (role, frames.expected.get(&role).copied().unwrap_or(0));
    write_set(
        options,
        &settings,
        Role::ALL.map(expected).into(),
        &frames.frames,
        frames.failures,
        |files, frame, _| make(files, frame),
    )
}

/// Depth as it is stored: what is not positive and finite counts as not measured and becomes 0.
fn measured(depth_m: f64) -> f32 {
    let depth_m = depth_m as f32;
    if depth_m.is_finite() && depth_m > 0.0 {
        depth_m
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_not_measured_becomes_zero() {
        let depths = [1.5, 0.0, -1.0, f64::NAN, f64::INFINITY, 1e300, 1e-300];
        assert_eq!(depths.map(measured), [1.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    }
}
