//! The drive table, the 697 Eigen test frames and the origin of the stereo 2015 scenes,
//! read from the text files in `splits/data` (PROTOCOL 2.2, 2.4).

use std::fmt;
use std::sync::LazyLock;

use serde::{Deserialize, Serialize};

use crate::frame::{DriveId, FrameId};
use crate::role::Split;

/// What a drive is used for in a split: all of its frames on one side.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DriveRole {
    /// Training and validation frames come from it.
    Train,
    /// Only test frames may come from it.
    Test,
}

/// KITTI's own scene category of a drive.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Category {
    /// Inner city.
    City,
    /// Residential streets.
    Residential,
    /// Roads outside of town.
    Road,
}

impl fmt::Display for Category {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::City => "city",
            Self::Residential => "residential",
            Self::Road => "road",
        })
    }
}

/// A row of the drive table.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Drive {
    /// Name of the drive.
    pub id: DriveId,
    /// Scene category.
    pub category: Category,
    /// Stereo pairs; they are numbered `0..frames` without a gap.
    pub frames: u32,
    /// Width in pixels of its rectified images.
    pub width: u32,
    /// Height in pixels of its rectified images.
    pub height: u32,
    /// Role in the KITTI split.
    pub kitti: DriveRole,
    /// Role in the Eigen split.
    pub eigen: DriveRole,
    /// Frames without a Velodyne scan in the published data.
    pub missing_scans: &'static [u32],
}

impl Drive {
    /// The role of this drive in a split.
    pub fn role(&self, split: Split) -> DriveRole {
        match split {
            Split::Kitti => self.kitti,
            Split::Eigen => self.eigen,
        }
    }

    /// All frames of this drive in order.
    pub fn frame_ids(&self) -> impl Iterator<Item = FrameId> + use<> {
        let drive = self.id;
        (0..self.frames).map(move |index| FrameId { drive, index })
    }
}

/// All 61 drives, in table order (day, then number).
pub fn drives() -> &'static [Drive] {
    static DRIVES: LazyLock<Vec<Drive>> = LazyLock::new(|| {
        let rows = include_str!("../data/drives.csv").lines().skip(1);
        rows.map(|row| {
            drive_row(row).unwrap_or_else(|| panic!("splits/data/drives.csv is damaged: {row}"))
        })
        .collect()
    });
    &DRIVES
}

/// The 697 test frames of the Eigen split, in the order of the published list.
pub fn eigen_test() -> &'static [FrameId] {
    static FRAMES: LazyLock<Vec<FrameId>> = LazyLock::new(|| {
        let rows = include_str!("../data/eigen_test_697.txt").lines();
        rows.map(|row| {
            row.parse().unwrap_or_else(|error| {
                panic!("splits/data/eigen_test_697.txt is damaged: {error}")
            })
        })
        .collect()
    });
    &FRAMES
}

/// True for frames with KITTI's annotated ("improved") depth: scans of eleven frames are put
/// together, so the first and last five frames of a drive have none (PROTOCOL 2.5).
pub fn has_annotated_depth(frame: FrameId) -> bool {
    let drive = drives().iter().find(|drive| drive.id == frame.drive);
    drive.is_some_and(|drive| frame.index >= 5 && frame.index + 5 < drive.frames)
}

/// The raw frame behind each of the 200 stereo 2015 training scenes; `None` for the 58
/// scenes whose recording is not part of the public raw data.
pub fn kitti2015_origin() -> &'static [Option<FrameId>] {
    static ORIGIN: LazyLock<Vec<Option<FrameId>>> = LazyLock::new(|| {
        let rows = include_str!("../data/kitti2015_to_raw.txt")
            .lines()
            .enumerate();
        rows.map(|(number, row)| {
            origin_row(number, row)
                .unwrap_or_else(|| panic!("splits/data/kitti2015_to_raw.txt is damaged: {row}"))
        })
        .collect()
    });
    &ORIGIN
}

fn drive_row(row: &str) -> Option<Drive> {
    let fields: [&str; 8] = row.split(',').collect::<Vec<_>>().try_into().ok()?;
    let [id, category, frames, width, height, kitti, eigen, missing] = fields;
    let role = |text| match text {
        "train" => Some(DriveRole::Train),
        "test" => Some(DriveRole::Test),
        _ => None,
    };
    let missing: Option<Vec<u32>> = missing.split_whitespace().map(|n| n.parse().ok()).collect();
    Some(Drive {
        id: id.parse().ok()?,
        category: match category {
            "city" => Category::City,
            "residential" => Category::Residential,
            "road" => Category::Road,
            _ => return None,
        },
        frames: frames.parse().ok()?,
        width: width.parse().ok()?,
        height: height.parse().ok()?,
        kitti: role(kitti)?,
        eigen: role(eigen)?,
        // Read once for the life of the process.
        missing_scans: Vec::leak(missing?),
    })
}

fn origin_row(number: usize, row: &str) -> Option<Option<FrameId>> {
    let (index, frame) = row.split_once(' ')?;
    if index.parse() != Ok(number) {
        return None;
    }
    if frame == "-" {
        Some(None)
    } else {
        Some(Some(frame.parse().ok()?))
    }
}

#[cfg(test)]
mod tests {
    use std::collections::{BTreeMap, BTreeSet};

    use super::*;
    use crate::Date;

    fn total(keep: impl Fn(&Drive) -> bool) -> (usize, u32) {
        let kept: Vec<_> = drives().iter().filter(|drive| keep(drive)).collect();
        (kept.len(), kept.iter().map(|drive| drive.frames).sum())
    }

    #[test]
    fn the_table_has_the_counts_of_kitti_raw() {
        // PROTOCOL 1.1 and 2.1
        assert_eq!(total(|_| true), (61, 42_382));
        assert_eq!(total(|d| d.category == Category::City), (28, 8_311));
        assert_eq!(total(|d| d.category == Category::Residential), (21, 28_277));
        assert_eq!(total(|d| d.category == Category::Road), (12, 5_794));
        let pairs = [15_884, 482, 1_556, 13_246, 11_214];
        for (date, pairs) in Date::ALL.into_iter().zip(pairs) {
            assert_eq!(total(|d| d.id.date == date).1, pairs, "{date}");
        }
        for drive in drives() {
            assert_eq!(
                (drive.width, drive.height),
                drive.id.date.image_size(),
                "{}",
                drive.id
            );
        }
        assert!(
            drives().is_sorted_by(|a, b| a.id < b.id),
            "table order is name order"
        );
    }

    #[test]
    fn drives_by_role_in_both_splits() {
        // PROTOCOL 2.2, last line
        use DriveRole::{Test, Train};
        for (kitti, eigen, expected) in [
            (Train, Train, (18, 18_135)),
            (Train, Test, (14, 12_024)),
            (Test, Train, (15, 5_353)),
            (Test, Test, (14, 6_870)),
        ] {
            assert_eq!(
                total(|d| d.kitti == kitti && d.eigen == eigen),
                expected,
                "{kitti:?}/{eigen:?}"
            );
        }
        assert_eq!(total(|d| d.kitti == Train), (32, 30_159));
        assert_eq!(total(|d| d.kitti == Test), (29, 12_223));
        assert_eq!(total(|d| d.eigen == Train), (33, 23_488));
        assert_eq!(total(|d| d.eigen == Test), (28, 42_382 - 23_488));
    }

    #[test]
    fn only_one_drive_lacks_scans() {
        for drive in drives() {
            let expected: &[u32] = if drive.id.to_string() == "2011_09_26_drive_0009" {
                &[177, 178, 179, 180]
            } else {
                &[]
            };
            assert_eq!(drive.missing_scans, expected, "{}", drive.id);
            for index in drive.missing_scans {
                let frame = FrameId {
                    drive: drive.id,
                    index: *index,
                };
                assert!(
                    !eigen_test().contains(&frame),
                    "every test frame has a scan"
                );
            }
        }
    }

    #[test]
    fn eigen_test_has_25_frames_in_each_test_drive() {
        assert_eq!(eigen_test().len(), 697);
        assert_eq!(
            eigen_test().iter().collect::<BTreeSet<_>>().len(),
            697,
            "no frame twice"
        );
        let mut per_drive = BTreeMap::new();
        for frame in eigen_test() {
            *per_drive.entry(frame.drive).or_insert(0) += 1;
        }
        for drive in drives() {
            let expected = match (drive.eigen, drive.id.to_string().as_str()) {
                (DriveRole::Train, _) => None,
                (DriveRole::Test, "2011_09_26_drive_0048") => Some(22),
                (DriveRole::Test, _) => Some(25),
            };
            assert_eq!(per_drive.get(&drive.id).copied(), expected, "{}", drive.id);
        }
        for frame in eigen_test() {
            let drive = drives().iter().find(|d| d.id == frame.drive).unwrap();
            assert!(frame.index < drive.frames);
        }
        // The reference order, not a sorted one.
        assert_eq!(
            eigen_test()[0].to_string(),
            "2011_09_26_drive_0002/0000000069"
        );
        assert!(!eigen_test().is_sorted());
    }

    #[test]
    fn improved_ground_truth_covers_652_test_frames() {
        // PROTOCOL 2.5: accumulation over eleven frames leaves out five at either end.
        let without = eigen_test().iter().filter(|f| !has_annotated_depth(**f));
        assert_eq!(without.count(), 45);
    }

    #[test]
    fn stereo_2015_scenes_come_from_the_kitti_test_drives() {
        // PROTOCOL 2.1, 2.4 and the K15 column of 2.2
        assert_eq!(kitti2015_origin().len(), 200);
        let mapped: Vec<_> = kitti2015_origin().iter().flatten().collect();
        assert_eq!(mapped.len(), 142);
        let touched: BTreeSet<_> = mapped.iter().map(|frame| frame.drive).collect();
        let test: BTreeSet<_> = drives()
            .iter()
            .filter(|d| d.kitti == DriveRole::Test)
            .map(|d| d.id)
            .collect();
        assert_eq!(touched, test);

        let blanks: [std::ops::RangeInclusive<usize>; 11] = [
            0..=1,
            4..=6,
            82..=82,
            87..=87,
            99..=104,
            133..=140,
            151..=154,
            156..=156,
            165..=167,
            170..=198,
            999..=999,
        ];
        for (number, origin) in kitti2015_origin().iter().enumerate() {
            let blank = blanks.iter().any(|range| range.contains(&number));
            assert_eq!(origin.is_none(), blank, "scene {number}");
        }
        for (drive, count) in [
            ("2011_09_26_drive_0014", 12),
            ("2011_09_26_drive_0051", 11),
            ("2011_10_03_drive_0047", 1),
        ] {
            let drive: DriveId = drive.parse().unwrap();
            assert_eq!(
                mapped.iter().filter(|frame| frame.drive == drive).count(),
                count
            );
        }
    }

    #[test]
    fn the_splits_leak_into_each_other() {
        // PROTOCOL 2.3: why a model is trained once per split.
        let role = |frame: &FrameId, split| {
            drives()
                .iter()
                .find(|d| d.id == frame.drive)
                .unwrap()
                .role(split)
        };
        let eigen_in_kitti = eigen_test()
            .iter()
            .filter(|f| role(f, Split::Kitti) == DriveRole::Train);
        assert_eq!(eigen_in_kitti.count(), 347);
        let kitti_in_eigen = kitti2015_origin()
            .iter()
            .flatten()
            .filter(|f| role(f, Split::Eigen) == DriveRole::Train);
        assert_eq!(kitti_in_eigen.count(), 92);
    }

    #[test]
    fn damaged_rows_are_seen() {
        assert!(drive_row("2011_09_26_drive_0001,city,108,1242,375,train,train").is_none());
        assert!(drive_row("2011_09_26_drive_0001,campus,108,1242,375,train,train,").is_none());
        assert!(origin_row(3, "000004 -").is_none());
    }
}
