//! What belongs to a split: training, the validation draw, test lists, counts and the digest
//! (PROTOCOL 2.1 and 2.6).

use sha2::{Digest, Sha256};

use crate::frame::FrameId;
use crate::role::{Role, Split};
use crate::table::{Drive, DriveRole, drives, eigen_test, kitti2015_origin};

/// Validation frames drawn from each training drive.
pub const VALIDATION_PER_DRIVE: usize = 10;

/// The frames to learn from: all frames of the training drives except those of
/// [`validation`], in table order.
pub fn training(split: Split) -> Vec<FrameId> {
    training_drives(split)
        .flat_map(|drive| {
            let held_out = drawn(drive);
            drive
                .frame_ids()
                .filter(move |frame| held_out.binary_search(frame).is_err())
        })
        .collect()
}

/// The validation frames: [`VALIDATION_PER_DRIVE`] frames of each training drive, those
/// whose name `<drive>/<frame, ten digits>` has the smallest SHA-256; in table order.
///
/// The draw depends on names alone, so it is the same in every language and for
/// every future version of this crate.
pub fn validation(split: Split) -> Vec<FrameId> {
    training_drives(split).flat_map(drawn).collect()
}

/// Names of the test samples of a split in published order: `kitti2015/000006` for the
/// KITTI split, frame names for the Eigen split.
pub fn test_ids(split: Split) -> Vec<String> {
    match split {
        Split::Kitti => (0..kitti2015_origin().len()).map(kitti2015_id).collect(),
        Split::Eigen => eigen_test().iter().map(ToString::to_string).collect(),
    }
}

/// Images of the published test set of Make3D.
pub const MAKE3D_TEST_IMAGES: usize = 134;

/// How many images a published test set has, by the name that rows carry: `kitti`, `eigen` or
/// `make3d`. `None` for what has no such list, as a user's own pairs.
pub fn test_images(name: &str) -> Option<usize> {
    match name {
        "make3d" => Some(MAKE3D_TEST_IMAGES),
        split => Some(match split.parse().ok()? {
            Split::Kitti => kitti2015_origin().len(),
            Split::Eigen => eigen_test().len(),
        }),
    }
}

/// The name of a stereo 2015 training scene, `kitti2015/000006`.
pub fn kitti2015_id(number: usize) -> String {
    format!("kitti2015/{number:06}")
}

/// Sizes of a split.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Counts {
    /// Drives whose frames are trained or validated on.
    pub training_drives: usize,
    /// Drives kept away from training.
    pub test_drives: usize,
    /// Frames to learn from.
    pub train: usize,
    /// Validation frames.
    pub val: usize,
    /// Test samples.
    pub test: usize,
}

/// Counts a split (PROTOCOL 2.1, column "counted").
pub fn counts(split: Split) -> Counts {
    let training_drives = training_drives(split).count();
    Counts {
        training_drives,
        test_drives: drives().len() - training_drives,
        train: training(split).len(),
        val: validation(split).len(),
        test: test_ids(split).len(),
    }
}

/// SHA-256 (hex) over all rows of a split, `<role> <name>\n` each: training, validation,
/// test, every list in its own order. Two prepared sets of the same split carry the same digest.
pub fn digest(split: Split) -> String {
    let mut hash = Sha256::new();
    let mut row = |role: Role, id: &str| hash.update(format!("{role} {id}\n"));
    for frame in training(split) {
        row(Role::Train, &frame.to_string());
    }
    for frame in validation(split) {
        row(Role::Val, &frame.to_string());
    }
    for id in test_ids(split) {
        row(Role::Test, &id);
    }
    hex(&hash.finalize())
}

fn training_drives(split: Split) -> impl Iterator<Item = &'static Drive> {
    drives()
        .iter()
        .filter(move |drive| drive.role(split) == DriveRole::Train)
}

/// The validation frames of one drive, ascending.
fn drawn(drive: &Drive) -> Vec<FrameId> {
    let mut ranked: Vec<_> = drive
        .frame_ids()
        .map(|frame| (Sha256::digest(frame.to_string()), frame))
        .collect();
    ranked.sort_unstable();
    let mut frames: Vec<_> = ranked
        .into_iter()
        .take(VALIDATION_PER_DRIVE)
        .map(|(_, frame)| frame)
        .collect();
    frames.sort_unstable();
    frames
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn sizes_are_those_counted_in_the_public_lists() {
        // PROTOCOL 2.1: 320/29,839 and 330/23,158, where the thesis swapped the drive counts.
        assert_eq!(
            counts(Split::Kitti),
            Counts {
                training_drives: 32,
                test_drives: 29,
                train: 29_839,
                val: 320,
                test: 200
            }
        );
        assert_eq!(
            counts(Split::Eigen),
            Counts {
                training_drives: 33,
                test_drives: 28,
                train: 23_158,
                val: 330,
                test: 697
            }
        );
    }

    #[test]
    fn training_and_validation_share_no_frame_and_fill_the_drives() {
        for split in Split::ALL {
            let train: BTreeSet<_> = training(split).into_iter().collect();
            let val: BTreeSet<_> = validation(split).into_iter().collect();
            assert!(train.is_disjoint(&val));
            let all: u32 = training_drives(split).map(|d| d.frames).sum();
            assert_eq!(train.len() + val.len(), all as usize);
            assert!(train.union(&val).all(|f| f.index < 10_000));
        }
        let eigen: BTreeSet<_> = training(Split::Eigen)
            .into_iter()
            .chain(validation(Split::Eigen))
            .collect();
        assert!(eigen_test().iter().all(|frame| !eigen.contains(frame)));
    }

    #[test]
    fn names_hash_as_stated() {
        // The two check values of PROTOCOL 2.6.
        let start = |name: &str| hex(&Sha256::digest(name)[..8]);
        assert_eq!(
            start("2011_09_26_drive_0001/0000000005"),
            "10d9f18aa85d2a5b"
        );
        assert_eq!(
            start("2011_09_26_drive_0001/0000000000"),
            "ad37256045241c47"
        );
    }

    #[test]
    fn the_validation_draw_is_the_published_one() {
        let first: Vec<u32> = validation(Split::Kitti)[..10]
            .iter()
            .map(|f| f.index)
            .collect();
        assert_eq!(first, [5, 7, 14, 18, 36, 53, 66, 68, 91, 97]);
        // Recipe: make_golden.py splits/validation: SHA-256 of "<drive>/<frame, ten digits>\n" over
        // the drawn frames, drives in table order, frames ascending.
        for (split, expected) in [
            (
                Split::Kitti,
                "71e1878fc82be2fde51e842d964dbac8d9762637971a7fff3c1f2c93517d0a4f",
            ),
            (
                Split::Eigen,
                "633d340f1a5462e8d1c1f10fc0cc3c5729c20197b50fdd67ec92a2882cdc1cc2",
            ),
        ] {
            let rows: String = validation(split)
                .iter()
                .map(|frame| format!("{frame}\n"))
                .collect();
            assert_eq!(hex(&Sha256::digest(rows)), expected, "{split}");
        }
    }

    #[test]
    fn digests_differ_and_never_change() {
        // A change here changes the identity of every prepared set and every result row.
        assert_eq!(
            digest(Split::Kitti),
            "7c12dd4a54f302c87e1c44155a6d5824dd8ef3d1f1d23afb7b2068f19b08044b"
        );
        assert_eq!(
            digest(Split::Eigen),
            "f9adf189b02287a00ebd73f184c6054e225f5bad762ae56d9ee0626fc334fcc0"
        );
    }

    #[test]
    fn names_of_splits_and_roles() {
        for split in Split::ALL {
            assert_eq!(split.to_string().parse(), Ok(split));
        }
        assert!(
            "KITTI"
                .parse::<Split>()
                .unwrap_err()
                .to_string()
                .contains("`kitti` and `eigen`")
        );
        assert_eq!(Role::Val.to_string(), "val");
        assert_eq!(test_ids(Split::Kitti)[6], "kitti2015/000006");
        for (name, images) in [("kitti", 200), ("eigen", 697), ("make3d", 134)] {
            assert_eq!(test_images(name), Some(images));
        }
        assert_eq!(test_images("pairs"), None);
    }
}
