//! Which frames a preset renders: real drive names and frame numbers, so that the
//! roles, validation draw and test lists of [`strat_splits`] apply to them.

use std::collections::BTreeSet;

use strat_splits::{
    Category, Date, Drive, DriveId, DriveRole, FrameId, Split, drives, eigen_test,
    kitti2015_origin, validation,
};

use crate::synth::geometry::street::Theme;
use crate::synth::random::{Rng, key_of_name};

/// How much is rendered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Preset {
    /// A handful of frames at a third of the native size, for tests (seconds).
    Tiny,
    /// About 460 stereo pairs at native size: enough to train a small network (minutes).
    Demo,
    /// Some 700 pairs at half the native size from all drives of the Eigen split: enough to
    /// compare trainings drive by drive (minutes).
    Miniature,
    /// Thousands of pairs at half the native size: all training drives thinned out, all
    /// test frames of both splits (tens of minutes).
    Study,
}

impl Preset {
    /// All presets.
    pub const ALL: [Self; 4] = [Self::Tiny, Self::Demo, Self::Miniature, Self::Study];

    /// What it is for, as `--help` says it.
    pub fn about(self) -> &'static str {
        match self {
            Self::Tiny => "A handful of frames at a third of the native size, for tests (seconds)",
            Self::Demo => {
                "About 460 stereo pairs at native size: enough to train a small network (minutes)"
            }
            Self::Miniature => {
                "Some 700 stereo pairs at half the native size, from all drives of the Eigen split: enough to \
                 compare trainings drive by drive (minutes)"
            }
            Self::Study => {
                "Thousands of pairs at half the native size: all training drives thinned out, all test \
                 frames of both splits (tens of minutes)"
            }
        }
    }

    /// Name on the command line and in `WORLD.yaml`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Tiny => "tiny",
            Self::Demo => "demo",
            Self::Miniature => "miniature",
            Self::Study => "study",
        }
    }

    /// Native image size divided by this.
    pub(crate) fn divisor(self) -> u32 {
        match self {
            Self::Tiny => 3,
            Self::Demo => 1,
            Self::Miniature | Self::Study => 2,
        }
    }

    /// Rays per beam over the front half circle.
    pub(crate) fn scan_steps(self) -> usize {
        match self {
            Self::Tiny => 360,
            Self::Demo => 1000,
            Self::Miniature | Self::Study => 720,
        }
    }
}

/// What is looked at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum View {
    /// A frame of a raw drive.
    Frame(FrameId),
    /// A stereo 2015 training scene, 0 to 199.
    Stereo(usize),
}

/// One stereo pair to render.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Shot {
    /// Name of the world it is taken in: a drive or a stereo 2015 scene of its own.
    pub world: String,
    pub theme: Theme,
    pub date: Date,
    /// Frame number within the world.
    pub index: u32,
    pub purpose: Purpose,
}

/// Where a shot goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Purpose {
    /// A frame of a raw drive, with a scan unless the published data lack it.
    Raw { frame: FrameId, scan: bool },
    /// A stereo 2015 scene by number, with disparities and labels.
    Stereo { number: usize },
}

/// Frames of some training drives and of some Eigen test drives.
struct Choice {
    training: fn() -> Vec<&'static Drive>,
    per_drive: u32,
    /// Frames between two of one drive.
    stride: u32,
    validation: usize,
    testing: fn() -> Vec<&'static Drive>,
    tests: usize,
    stereo: &'static [usize],
}

const TINY: Choice = Choice {
    training: || named(&["2011_09_26_drive_0001", "2011_09_29_drive_0026"]),
    per_drive: 4,
    stride: 16,
    validation: 2,
    testing: || {
        named(&[
            "2011_09_26_drive_0013",
            "2011_09_26_drive_0101",
            "2011_10_03_drive_0047",
        ])
    },
    tests: 1,
    stereo: &[2, 155, 170],
};

const DEMO: Choice = Choice {
    // Every drive that both splits train on: a model that has seen few streets learns those
    // streets instead of depth.
    training: || {
        named(&[
            "2011_09_26_drive_0001",
            "2011_09_26_drive_0035",
            "2011_09_26_drive_0039",
            "2011_09_26_drive_0060",
            "2011_09_26_drive_0061",
            "2011_09_26_drive_0079",
            "2011_09_26_drive_0087",
            "2011_09_26_drive_0091",
            "2011_09_26_drive_0095",
            "2011_09_26_drive_0113",
            "2011_09_28_drive_0001",
            "2011_09_29_drive_0026",
            "2011_09_30_drive_0020",
            "2011_09_30_drive_0028",
            "2011_09_30_drive_0033",
            "2011_09_30_drive_0034",
            "2011_10_03_drive_0034",
            "2011_10_03_drive_0042",
        ])
    },
    per_drive: 20,
    stride: 40,
    validation: 2,
    testing: || {
        named(&[
            "2011_09_26_drive_0009",
            "2011_09_26_drive_0013",
            "2011_09_26_drive_0027",
            "2011_09_26_drive_0036",
            "2011_09_26_drive_0046",
            "2011_09_26_drive_0096",
            "2011_09_26_drive_0101",
            "2011_09_28_drive_0002",
            "2011_09_29_drive_0071",
            "2011_10_03_drive_0047",
        ])
    },
    tests: 4,
    stereo: &[
        0, 2, 5, 11, 19, 27, 36, 44, 53, 61, 70, 79, 88, 97, 108, 117, 126, 137, 148, 155, 160,
        170, 181, 193,
    ],
};

const MINIATURE: Choice = Choice {
    training: || of_eigen(DriveRole::Train),
    per_drive: 14,
    stride: 40,
    validation: 1,
    testing: || of_eigen(DriveRole::Test),
    tests: 8,
    stereo: &[],
};

/// The shots of a preset, raw drives first.
pub(crate) fn shots(preset: Preset) -> Vec<Shot> {
    let (raw, stereo): (BTreeSet<FrameId>, Vec<usize>) = match preset {
        Preset::Tiny => chosen(&TINY),
        Preset::Demo => chosen(&DEMO),
        Preset::Miniature => chosen(&MINIATURE),
        Preset::Study => {
            let mut raw: BTreeSet<FrameId> = eigen_test().iter().copied().collect();
            for split in [Split::Kitti, Split::Eigen] {
                raw.extend(validation(split));
                let training = drives()
                    .iter()
                    .filter(|d| d.role(split) == DriveRole::Train);
                raw.extend(training.flat_map(|d| d.frame_ids().step_by(12)));
            }
            (raw, (0..kitti2015_origin().len()).collect())
        }
    };
    let mut shots: Vec<Shot> = raw.into_iter().filter_map(raw_shot).collect();
    shots.extend(stereo.into_iter().map(stereo_shot));
    shots
}

fn chosen(choice: &Choice) -> (BTreeSet<FrameId>, Vec<usize>) {
    let held_out: BTreeSet<FrameId> = validation(Split::Kitti)
        .into_iter()
        .chain(validation(Split::Eigen))
        .collect();
    let mut raw = BTreeSet::new();
    for drive in (choice.training)() {
        let stride = choice.stride.min(drive.frames / choice.per_drive).max(1);
        let mut taken = 0;
        let mut index = 0;
        while taken < choice.per_drive && index < drive.frames {
            let frame = FrameId {
                drive: drive.id,
                index,
            };
            if held_out.contains(&frame) {
                index += 1;
                continue;
            }
            raw.insert(frame);
            taken += 1;
            index += stride;
        }
        raw.extend(
            held_out
                .iter()
                .filter(|f| f.drive == drive.id)
                .take(choice.validation),
        );
    }
    for drive in (choice.testing)() {
        let frames: Vec<FrameId> = eigen_test()
            .iter()
            .copied()
            .filter(|f| f.drive == drive.id)
            .collect();
        let step = (frames.len() / choice.tests).max(1);
        raw.extend(frames.into_iter().step_by(step).take(choice.tests));
    }
    (raw, choice.stereo.to_vec())
}

fn named(names: &[&str]) -> Vec<&'static Drive> {
    let wanted: Vec<DriveId> = names.iter().filter_map(|n| n.parse().ok()).collect();
    drives().iter().filter(|d| wanted.contains(&d.id)).collect()
}

fn of_eigen(role: DriveRole) -> Vec<&'static Drive> {
    let eigen = drives().iter();
    eigen.filter(|d| d.role(Split::Eigen) == role).collect()
}

fn theme(category: Category) -> Theme {
    match category {
        Category::City => Theme::City,
        Category::Residential => Theme::Residential,
        Category::Road => Theme::Road,
    }
}

fn raw_shot(frame: FrameId) -> Option<Shot> {
    let drive = drives().iter().find(|d| d.id == frame.drive)?;
    Some(Shot {
        world: drive.id.to_string(),
        theme: theme(drive.category),
        date: drive.id.date,
        index: frame.index,
        purpose: Purpose::Raw {
            frame,
            scan: !drive.missing_scans.contains(&frame.index),
        },
    })
}

/// The shot of a view; `None` if KITTI has no such frame or scene.
pub(crate) fn shot(view: View) -> Option<Shot> {
    match view {
        View::Frame(frame) => {
            let drive = drives().iter().find(|d| d.id == frame.drive)?;
            (frame.index < drive.frames).then(|| raw_shot(frame))?
        }
        View::Stereo(number) => (number < kitti2015_origin().len()).then(|| stereo_shot(number)),
    }
}

/// Scenes cut from public drives show that drive; the others have worlds of their own.
fn stereo_shot(number: usize) -> Shot {
    let purpose = Purpose::Stereo { number };
    let origin = kitti2015_origin().get(number).copied().flatten();
    if let Some(shot) = origin.and_then(raw_shot) {
        return Shot { purpose, ..shot };
    }
    let world = format!("kitti2015/{number:06}");
    let mut rng = Rng::new(key_of_name(&world));
    // Image sizes by number: PROTOCOL 1.2.
    let date = match number {
        0..=154 => Date::D2011_09_26,
        155..=156 => Date::D2011_09_28,
        157..=169 => Date::D2011_09_29,
        _ => Date::D2011_10_03,
    };
    let theme = rng.pick(&[Theme::City, Theme::City, Theme::Residential, Theme::Road]);
    Shot {
        world,
        theme,
        date,
        index: rng.below(300) as u32,
        purpose,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use strat_splits::training;

    fn raw_frames(preset: Preset) -> BTreeSet<FrameId> {
        shots(preset)
            .into_iter()
            .filter_map(|s| match s.purpose {
                Purpose::Raw { frame, .. } => Some(frame),
                Purpose::Stereo { .. } => None,
            })
            .collect()
    }

    /// Counts of train, validation and Eigen test frames, and of stereo scenes.
    fn counts(preset: Preset, split: Split) -> (usize, usize, usize, usize) {
        let raw = raw_frames(preset);
        let within = |frames: Vec<FrameId>| frames.iter().filter(|f| raw.contains(f)).count();
        let stereo = shots(preset).len() - raw.len();
        (
            within(training(split)),
            within(validation(split)),
            within(eigen_test().to_vec()),
            stereo,
        )
    }

    #[test]
    fn presets_serve_both_splits_alike() {
        for split in [Split::Kitti, Split::Eigen] {
            assert_eq!(counts(Preset::Tiny, split), (8, 4, 3, 3));
            assert_eq!(counts(Preset::Demo, split), (360, 36, 40, 24));
            let (train, val, test, stereo) = counts(Preset::Study, split);
            assert!(train > 1900, "{train}");
            assert_eq!(val, validation(split).len());
            assert_eq!((test, stereo), (697, 200));
        }
    }

    #[test]
    fn the_miniature_has_every_drive_of_the_eigen_split() {
        let raw = raw_frames(Preset::Miniature);
        let drives_of = |frames: &[FrameId]| {
            let there = frames.iter().filter(|f| raw.contains(f));
            there.map(|f| f.drive).collect::<BTreeSet<_>>().len()
        };
        assert_eq!(drives_of(&training(Split::Eigen)), 33);
        assert_eq!(drives_of(eigen_test()), 28);
        assert_eq!(counts(Preset::Miniature, Split::Eigen), (462, 33, 224, 0));
    }

    #[test]
    fn stereo_scenes_have_the_size_that_belongs_to_their_number() {
        for shot in shots(Preset::Study) {
            let Purpose::Stereo { number } = shot.purpose else {
                continue;
            };
            let expected = match number {
                0..=154 => (1242, 375),
                155..=156 => (1224, 370),
                157..=169 => (1238, 374),
                _ => (1241, 376),
            };
            assert_eq!(shot.date.image_size(), expected, "{number}");
        }
    }
}
