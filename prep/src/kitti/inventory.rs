//! What a split asks for against what the input folders have.
//!
//! The result is a list of jobs in the order of the split and a list of gaps. Deciding
//! what to do about gaps is left to the caller.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::SystemTime;

use strat_geometry::CamToCam;
use strat_splits::{
    Date, DriveId, FrameId, Role, Split, eigen_test, kitti2015_id, kitti2015_origin, training,
    validation,
};
use strat_store::set::Count;

use crate::input::annotated::AnnotatedFolder;
use crate::input::raw::RawFolder;
use crate::input::source::Source;
use crate::input::stereo2015::SceneFolder;
use crate::set::sample::Frame;

/// One sample to be made.
pub type Job = Frame<Input>;

/// What a sample is made from.
#[derive(Debug)]
pub enum Input {
    /// A frame of a raw drive.
    Raw(RawInput),
    /// A scene of stereo 2015.
    Scene(SceneInput),
}

/// Input files of a frame of a raw drive.
#[derive(Debug)]
pub struct RawInput {
    /// Left image.
    pub left: Source,
    /// Right image; only test frames can do without.
    pub right: Option<Source>,
    /// The cameras of its day.
    pub cameras: Arc<CamToCam>,
    /// Velodyne scan, where depth is to be made of it.
    pub scan: Option<ScanInput>,
    /// Annotated depth.
    pub annotated: Option<Source>,
}

/// A Velodyne scan and where its points fall.
#[derive(Debug)]
pub struct ScanInput {
    /// The scan.
    pub file: Source,
    /// From its points to left pixels.
    pub projection: [[f64; 4]; 3],
    /// When the calibration behind the projection was written or put into place.
    pub calibration_changed: Option<SystemTime>,
}

/// Input files of a scene of stereo 2015.
#[derive(Debug)]
pub struct SceneInput {
    /// Left image.
    pub left: Source,
    /// Right image.
    pub right: Source,
    /// Disparity of pixels visible in both images.
    pub noc: Source,
    /// Disparity of all measured pixels.
    pub occ: Option<Source>,
    /// Calibration text.
    pub calibration: Option<Source>,
    /// Label ids.
    pub semantic: Option<Source>,
    /// Instance ids.
    pub instance: Option<Source>,
}

/// Jobs, counts and gaps of a split.
#[derive(Debug, Default)]
pub struct Inventory {
    /// What can be made, in the order of the split.
    pub jobs: Vec<Job>,
    /// Samples expected and possible per role.
    pub counts: BTreeMap<Role, Count>,
    /// Archives and folders of the input that cannot be read, with the reason.
    pub broken: Vec<(PathBuf, String)>,
    needed: Gaps,
    useful: Gaps,
    notes: Vec<String>,
}

/// What is missing of one kind in one place.
#[derive(Debug, Default)]
struct Gap {
    wanted: u64,
    missing: u64,
    first: Vec<String>,
}

/// Gaps by place (a drive, "stereo 2015") and kind of file.
type Gaps = BTreeMap<(Place, &'static str), Gap>;

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Place {
    Drive(DriveId),
    Scenes,
}

/// Kind of gap of a drive that has no folder at all.
const NO_FOLDER: &str = "folder";

/// What of a split is asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Roles {
    /// The test images alone.
    Test,
    /// All roles; depth for validation and test images.
    All,
    /// All roles, with depth for training images too.
    AllWithDepth,
}

impl Inventory {
    /// Looks up everything the KITTI split asks for; its test images need no KITTI raw.
    pub fn kitti(
        raw: Option<&RawFolder>,
        stereo: &SceneFolder,
        semantics: Option<&SceneFolder>,
        roles: Roles,
    ) -> Self {
        let mut inventory = Self::default();
        inventory.add_raw(raw, Split::Kitti, roles, None);
        inventory.broken.extend(stereo.broken.iter().cloned());
        if let Some(semantics) = semantics {
            inventory.broken.extend(semantics.broken.iter().cloned());
        }
        for number in 0..kitti2015_origin().len() {
            inventory.count(Role::Test, 1, 0);
            let name = format!("{number:06}_10");
            let mut look = |gaps: fn(&mut Self) -> &mut Gaps, kind, found: Option<Source>| {
                tally(
                    gaps(&mut inventory),
                    Place::Scenes,
                    kind,
                    &name,
                    found.is_some(),
                );
                found
            };
            let left = look(
                |i| &mut i.needed,
                "left images (image_2)",
                stereo.picture("image_2", number),
            );
            let right = look(
                |i| &mut i.needed,
                "right images (image_3)",
                stereo.picture("image_3", number),
            );
            let noc = look(
                |i| &mut i.needed,
                "disparities (disp_noc_0)",
                stereo.picture("disp_noc_0", number),
            );
            let occ = look(
                |i| &mut i.useful,
                "disparities (disp_occ_0)",
                stereo.picture("disp_occ_0", number),
            );
            let calibration = look(
                |i| &mut i.useful,
                "calibrations (calib_cam_to_cam)",
                stereo.calibration(number),
            );
            let semantic = semantics.and_then(|s| {
                look(
                    |i| &mut i.needed,
                    "label images (semantic)",
                    s.picture("semantic", number),
                )
            });
            let instance = semantics.and_then(|s| {
                look(
                    |i| &mut i.useful,
                    "instance images (instance)",
                    s.picture("instance", number),
                )
            });
            if let (Some(left), Some(right), Some(noc)) = (left, right, noc) {
                inventory.count(Role::Test, 0, 1);
                inventory.jobs.push(Job {
                    role: Role::Test,
                    id: kitti2015_id(number),
                    input: Input::Scene(SceneInput {
                        left,
                        right,
                        noc,
                        occ,
                        calibration,
                        semantic,
                        instance,
                    }),
                });
            }
        }
        inventory.finished()
    }

    /// Looks up everything the Eigen split asks for.
    pub fn eigen(raw: &RawFolder, annotated: Option<&AnnotatedFolder>, roles: Roles) -> Self {
        let mut inventory = Self::default();
        inventory.add_raw(Some(raw), Split::Eigen, roles, annotated);
        for frame in eigen_test() {
            inventory.add_frame(raw, *frame, Role::Test, true, annotated);
        }
        if annotated.is_some() {
            inventory.note_annotated();
        }
        inventory.finished()
    }

    /// Forgets what was looked up and found.
    fn finished(mut self) -> Self {
        for gaps in [&mut self.needed, &mut self.useful] {
            gaps.retain(|_, gap| gap.missing > 0);
        }
        self
    }

    /// Whether every sample of the split can be made and no label that was asked for is missing.
    pub fn is_complete(&self) -> bool {
        self.needed.is_empty()
    }

    /// `train 22 of 29839 pairs, val 6 of 320, test 36 of 200`
    pub fn summary(&self) -> String {
        summary(&self.counts)
    }

    /// Lines that say what is missing, drive by drive, with the first few names. First what
    /// samples need, then what they could do without.
    pub fn describe_gaps(&self) -> String {
        let mut text = String::new();
        describe(&mut text, &self.needed);
        if !self.useful.is_empty() {
            text.push_str("Optional; samples are written without them:\n");
            describe(&mut text, &self.useful);
        }
        for (_, problem) in &self.broken {
            let _ = writeln!(text, "  {problem}");
        }
        for note in &self.notes {
            let _ = writeln!(text, "  {note}");
        }
        text
    }

    fn add_raw(
        &mut self,
        raw: Option<&RawFolder>,
        split: Split,
        roles: Roles,
        annotated: Option<&AnnotatedFolder>,
    ) {
        if let Some(raw) = raw {
            self.broken.extend(raw.broken.iter().cloned());
            self.notes.extend(raw.notes.iter().cloned());
            self.note_calibrations(raw, split);
        }
        let (Some(raw), Roles::All | Roles::AllWithDepth) = (raw, roles) else {
            // The split has them still, and the set will say that it has none of them.
            self.count(Role::Train, training(split).len() as u64, 0);
            self.count(Role::Val, validation(split).len() as u64, 0);
            return;
        };
        let train_depth = roles == Roles::AllWithDepth;
        for frame in training(split) {
            self.add_frame(raw, frame, Role::Train, train_depth, None);
        }
        for frame in validation(split) {
            self.add_frame(raw, frame, Role::Val, true, annotated);
        }
    }

    fn add_frame(
        &mut self,
        raw: &RawFolder,
        frame: FrameId,
        role: Role,
        depth: bool,
        annotated: Option<&AnnotatedFolder>,
    ) {
        self.count(role, 1, 0);
        let place = Place::Drive(frame.drive);
        if !raw.has_drive(frame.drive) {
            tally(&mut self.needed, place, NO_FOLDER, &frame.stem(), false);
            return;
        }
        let day = raw.day(frame.drive.date);
        let mut look = |kind, present: bool| {
            tally(&mut self.needed, place, kind, &frame.stem(), present);
        };
        let cameras = day.and_then(|day| day.cameras.as_ref().ok());
        look("pairs with a camera calibration", cameras.is_some());
        let (left, right) = (raw.left(frame), raw.right(frame));
        look("left images (image_02)", left.is_some());
        let is_test = role == Role::Test;
        // No protocol looks at the right image of a test frame.
        let gaps = if is_test {
            &mut self.useful
        } else {
            &mut self.needed
        };
        let kind = "right images (image_03)";
        tally(gaps, place, kind, &frame.stem(), right.is_some());
        let has_images = left.is_some() && (right.is_some() || is_test);
        let mut scan = None;
        // A missing pair is told once; a test frame is nothing without its ground truth.
        if depth && (has_images || is_test) {
            scan = day.and_then(|day| {
                Some(ScanInput {
                    file: raw.scan(frame)?.clone(),
                    projection: *day.projection.as_ref().ok()?,
                    calibration_changed: day.changed,
                })
            });
            let gaps = if is_test {
                &mut self.needed
            } else {
                &mut self.useful
            };
            let kind = "usable scans (velodyne_points)";
            tally(gaps, place, kind, &frame.stem(), scan.is_some());
            if is_test && scan.is_none() {
                return;
            }
        }
        if let (Some(left), Some(cameras), true) = (left, cameras, has_images) {
            self.count(role, 0, 1);
            self.jobs.push(Job {
                role,
                id: frame.to_string(),
                input: Input::Raw(RawInput {
                    left: left.clone(),
                    right: right.cloned(),
                    cameras: Arc::clone(cameras),
                    scan,
                    annotated: annotated.and_then(|folder| folder.depth(frame)),
                }),
            });
        }
    }

    /// Says once per day why its calibration is not usable, where drives of it are there.
    fn note_calibrations(&mut self, raw: &RawFolder, split: Split) {
        for date in Date::ALL {
            let drives = strat_splits::drives()
                .iter()
                .filter(|d| d.id.date == date && raw.has_drive(d.id))
                .count();
            let Some(day) = raw.day(date).filter(|_| drives > 0) else {
                continue;
            };
            // What is damaged is an input that could not be used, unlike what was never there.
            self.broken.extend(day.damaged.iter().cloned());
            match (&day.cameras, &day.projection) {
                (Err(problem), _) => {
                    self.notes.push(format!(
                        "no pair of {date} can be used in the {split} split: {problem}"
                    ));
                }
                (Ok(_), Err(problem)) => self
                    .notes
                    .push(format!("no scan of {date} can be used: {problem}")),
                (Ok(_), Ok(_)) => {}
            }
        }
    }

    /// Says how many frames have annotated depth. It is no gap where one has not: KITTI depth
    /// leaves out the ends of every drive.
    fn note_annotated(&mut self) {
        let of = |role| {
            let jobs = self.jobs.iter().filter(|job| job.role == role);
            let with = jobs
                .clone()
                .filter(|job| matches!(&job.input, Input::Raw(input) if input.annotated.is_some()));
            (with.count(), jobs.count())
        };
        let ((test, tests), (val, vals)) = (of(Role::Test), of(Role::Val));
        self.notes.push(format!(
            "annotated depth: {test} of {tests} test images have it, {val} of {vals} validation images \
             (of all 697 test images 652 can)"
        ));
    }

    fn count(&mut self, role: Role, expected: u64, found: u64) {
        let count = self.counts.entry(role).or_default();
        count.expected += expected;
        count.found += found;
    }
}

/// `train 22 of 29839 pairs, val 6 of 320, test 36 of 200`
pub fn summary(counts: &BTreeMap<Role, Count>) -> String {
    let of = |role| {
        let count = counts.get(&role).copied().unwrap_or_default();
        format!("{} of {}", count.found, count.expected)
    };
    format!(
        "train {} pairs, val {}, test {}",
        of(Role::Train),
        of(Role::Val),
        of(Role::Test)
    )
}

fn tally(gaps: &mut Gaps, place: Place, kind: &'static str, name: &str, present: bool) {
    let gap = gaps.entry((place, kind)).or_default();
    gap.wanted += 1;
    if !present {
        gap.missing += 1;
        if gap.first.len() < 3 {
            gap.first.push(name.to_owned());
        }
    }
}

fn describe(text: &mut String, gaps: &Gaps) {
    for date in Date::ALL {
        let absent: Vec<_> = gaps
            .iter()
            .filter_map(|((place, kind), gap)| match place {
                Place::Drive(drive) if drive.date == date && *kind == NO_FOLDER => {
                    Some((drive.number, gap.missing))
                }
                _ => None,
            })
            .collect();
        if !absent.is_empty() {
            let frames: u64 = absent.iter().map(|(_, frames)| frames).sum();
            let numbers: Vec<_> = absent
                .iter()
                .map(|(number, _)| format!("{number:04}"))
                .collect();
            let _ = writeln!(
                text,
                "  {date}: no folder for {} {} ({frames} pairs): {}",
                absent.len(),
                if absent.len() == 1 { "drive" } else { "drives" },
                numbers.join(" ")
            );
        }
    }
    for ((place, kind), gap) in gaps.iter().filter(|((_, kind), _)| *kind != NO_FOLDER) {
        let place = match place {
            Place::Drive(drive) => drive.to_string(),
            Place::Scenes => "stereo 2015".to_owned(),
        };
        let more = if gap.missing > gap.first.len() as u64 {
            ", ..."
        } else {
            ""
        };
        let _ = writeln!(
            text,
            "  {place}: {} of {} {kind} missing: {}{more}",
            gap.missing,
            gap.wanted,
            gap.first.join(", ")
        );
    }
}
