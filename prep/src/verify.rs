//! What is missing, cut off, unreadable or changed, in inputs and in prepared sets.
//!
//! Inputs are compared with the drive table (PROTOCOL 2.2) and the two hundred scenes of stereo
//! 2015. A quick look takes presence, size and the first and last bytes of every file, which
//! finds downloads that were cut off; a deep one decodes everything. A prepared set is compared
//! with its own tables: every file must have the BLAKE3 written down for it.
//!
//! Nothing is repaired and nothing is changed.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use rayon::prelude::*;
use serde::Serialize;
use strat_geometry::parse_velodyne;
use strat_splits::{DriveRole, FrameId, Role, Split, drives, kitti2015_origin};
use strat_store::inputs::Kind;
use strat_store::layout::{self, FAILURES, MANIFEST, SETTINGS};
use strat_store::progress::Progress;
use strat_store::set::{FileRef, PreparedSet};
use strat_store::{exr, files, image_files};

use crate::error::Result;
use crate::input::raw::RawFolder;
use crate::input::source::Source;
use crate::input::stereo2015::SceneFolder;

/// Names shown of each kind of trouble.
const SHOWN: usize = 3;

/// State of the files of one kind in one place.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// A drive, `stereo 2015`, or a role of a prepared set.
    pub place: String,
    /// Kind of file: `left`, `scans`, a column of a set's table, ...
    pub kind: String,
    /// Files that should be there.
    pub expected: u64,
    /// Files that are there and good, as far as was looked.
    pub good: u64,
    /// Names of files that are not there.
    pub missing: Vec<String>,
    /// Files that end too early, with the reason.
    pub truncated: Vec<String>,
    /// Files that are something else than they should be, with the reason.
    pub unreadable: Vec<String>,
    /// Files of a set that no longer have the content written down for them.
    pub changed: Vec<String>,
}

impl Finding {
    fn new(place: impl Into<String>, kind: impl Into<String>) -> Self {
        Self {
            place: place.into(),
            kind: kind.into(),
            expected: 0,
            good: 0,
            missing: Vec::new(),
            truncated: Vec::new(),
            unreadable: Vec::new(),
            changed: Vec::new(),
        }
    }

    /// Whether everything is there and good.
    pub fn is_complete(&self) -> bool {
        self.good == self.expected
    }

    fn add(&mut self, name: &str, state: State) {
        self.expected += 1;
        match state {
            State::Good => self.good += 1,
            State::Missing => self.missing.push(name.to_owned()),
            State::Truncated(why) => self.truncated.push(format!("{name} ({why})")),
            State::Unreadable(why) => self.unreadable.push(format!("{name} ({why})")),
            State::Changed => self.changed.push(name.to_owned()),
        }
    }

    /// `447 complete`, or what is wrong with the first few names.
    fn sentence(&self) -> String {
        if self.is_complete() {
            return format!("{} complete", self.expected);
        }
        if self.missing.len() as u64 == self.expected {
            return format!("all {} missing", self.expected);
        }
        let mut parts = vec![format!("{} of {} good", self.good, self.expected)];
        for (what, names) in [
            ("short by", &self.missing),
            ("truncated", &self.truncated),
            ("unreadable", &self.unreadable),
            ("changed", &self.changed),
        ] {
            if names.is_empty() {
                continue;
            }
            let more = if names.len() > SHOWN { ", ..." } else { "" };
            let first = names[..names.len().min(SHOWN)].join(", ");
            parts.push(format!("{what} {}: {first}{more}", names.len()));
        }
        parts.join("; ")
    }
}

/// Everything that was looked at.
#[derive(Debug, Default, Serialize)]
pub struct Report {
    /// Findings in the order of the drive table or of the set's tables.
    pub findings: Vec<Finding>,
    /// Whole drives that are not there.
    pub absent: Vec<String>,
    /// Sentences about archives, calibrations and files that belong to nothing.
    pub problems: Vec<String>,
    /// Sentences about what is as it should be and still worth knowing.
    #[serde(skip)]
    pub notes: Vec<String>,
}

impl Report {
    /// Whether nothing is wrong.
    pub fn is_clean(&self) -> bool {
        self.absent.is_empty()
            && self.problems.is_empty()
            && self.findings.iter().all(Finding::is_complete)
    }

    /// How many files were looked for.
    pub fn files(&self) -> u64 {
        self.findings.iter().map(|finding| finding.expected).sum()
    }

    /// The findings as a table with sentences.
    pub fn text(&self) -> String {
        let wide = |column: fn(&Finding) -> &str| {
            let widths = self.findings.iter().map(|f| column(f).chars().count());
            widths.max().unwrap_or(0)
        };
        let (place, kind) = (wide(|f| &f.place), wide(|f| &f.kind));
        let mut text = String::new();
        for finding in &self.findings {
            text += &format!(
                "{:<place$}  {:<kind$}  {}\n",
                finding.place,
                finding.kind,
                finding.sentence()
            );
        }
        if !self.absent.is_empty() {
            text += &format!(
                "{} drives are not there: {}\n",
                self.absent.len(),
                self.absent.join(" ")
            );
        }
        for problem in &self.problems {
            text += &format!("{problem}\n");
        }
        text
    }
}

/// What is to be known of a file.
enum State {
    Good,
    Missing,
    Truncated(String),
    Unreadable(String),
    Changed,
}

/// How a file's content is judged.
#[derive(Clone, Copy)]
enum Form {
    Picture,
    Gray16,
    Scan,
    Text,
}

impl Form {
    fn kind(self) -> Kind {
        match self {
            Self::Picture | Self::Gray16 => Kind::Image,
            Self::Scan => Kind::Scan,
            Self::Text => Kind::Calibration,
        }
    }
}

/// How closely files are looked at.
#[derive(Debug, Clone, Copy)]
pub struct Check {
    /// Decodes every file instead of looking at its ends.
    pub deep: bool,
    /// Shows no progress.
    pub quiet: bool,
}

/// Finds the file of one kind of a frame.
type Look = fn(&RawFolder, FrameId) -> Option<&Source>;

/// Compares KITTI raw with the drive table: with all 61 drives, or with those that a split uses. Runs on
/// the threads of the pool it is called in.
pub fn raw(folder: &RawFolder, split: Option<Split>, check: Check, report: &mut Report) {
    let mut work = Vec::new();
    for drive in drives() {
        let used = |split: Split| drive.role(split) == DriveRole::Train;
        let tested = |split: Split| split == Split::Eigen && !used(split);
        if split.is_some_and(|split| !used(split) && !tested(split)) {
            continue;
        }
        if !folder.has_drive(drive.id) {
            report.absent.push(drive.id.to_string());
            continue;
        }
        let kinds: [(_, _, Look); 3] = [
            ("left", Form::Picture, |raw, frame| raw.left(frame)),
            ("right", Form::Picture, |raw, frame| raw.right(frame)),
            ("scans", Form::Scan, |raw, frame| raw.scan(frame)),
        ];
        for (kind, form, look) in kinds {
            // Nobody has the scans that KITTI itself lacks.
            let never =
                |frame: &FrameId| kind == "scans" && drive.missing_scans.contains(&frame.index);
            let files = drive
                .frame_ids()
                .map(|frame| (frame, look(folder, frame).cloned()))
                .filter(|(frame, file)| file.is_some() || !never(frame))
                .map(|(frame, file)| (frame.stem(), file))
                .collect();
            work.push((Finding::new(drive.id.to_string(), kind), form, files));
        }
        if let Some(day) = folder.day(drive.id.date) {
            let problem = match (&day.cameras, &day.projection) {
                (Err(problem), _) | (Ok(_), Err(problem)) => Some(problem.to_string()),
                (Ok(_), Ok(_)) => None,
            };
            let problem = problem.map(|p| format!("{}: {p}", drive.id.date));
            report
                .problems
                .extend(problem.filter(|p| !report.problems.contains(p)));
        }
    }
    let broken = folder.broken.iter().map(|(_, problem)| problem.clone());
    report.problems.extend(broken);
    look_at(work, check, "files of KITTI raw", report);
}

/// Looks at the two hundred scenes of stereo 2015, on the threads of the pool it is called in.
pub fn scenes(folder: &SceneFolder, check: Check, report: &mut Report) {
    let numbers = 0..kitti2015_origin().len();
    let pictures = [
        ("image_2", Form::Picture),
        ("image_3", Form::Picture),
        ("disp_noc_0", Form::Gray16),
        ("disp_occ_0", Form::Gray16),
    ];
    let mut work: Vec<_> = pictures
        .into_iter()
        .map(|(kind, form)| {
            let file = |number| (format!("{number:06}_10"), folder.picture(kind, number));
            let files = numbers.clone().map(file).collect();
            (Finding::new("stereo 2015", kind), form, files)
        })
        .collect();
    let file = |number| (format!("{number:06}"), folder.calibration(number));
    let files = numbers.map(file).collect();
    let finding = Finding::new("stereo 2015", "calib_cam_to_cam");
    work.push((finding, Form::Text, files));
    let broken = folder.broken.iter().map(|(_, problem)| problem.clone());
    report.problems.extend(broken);
    look_at(work, check, "files of stereo 2015", report);
}

type Work = (Finding, Form, Vec<(String, Option<Source>)>);

/// Looks at the files of all findings on all threads.
fn look_at(work: Vec<Work>, check: Check, unit: &str, report: &mut Report) {
    let total = work.iter().map(|(_, _, files)| files.len() as u64).sum();
    let progress = Progress::new("prep verify", total, unit, check.quiet);
    let looked = work.into_par_iter().map(|(mut finding, form, files)| {
        let states: Vec<_> = files
            .into_par_iter()
            .map(|(name, source)| {
                let state = match source {
                    None => State::Missing,
                    Some(source) => state_of(&source, form, check.deep),
                };
                progress.add(1);
                (name, state)
            })
            .collect();
        for (name, state) in states {
            finding.add(&name, state);
        }
        finding
    });
    let mut looked: Vec<_> = looked.collect();
    progress.finish();
    report.findings.append(&mut looked);
}

fn state_of(source: &Source, form: Form, deep: bool) -> State {
    // The directory of an archive says what a folder says: the length. More than that means to
    // inflate the file, and then it can be looked at altogether.
    if !deep && !source.is_file() {
        let length = source.len();
        return match form {
            _ if length == 0 => State::Truncated("it is empty".to_owned()),
            Form::Scan if !length.is_multiple_of(16) => no_scan(length),
            _ => State::Good,
        };
    }
    let bytes = match source.read(form.kind()) {
        Ok(bytes) if bytes.is_empty() => return State::Truncated("it is empty".to_owned()),
        Ok(bytes) => bytes,
        Err(error) => return State::Unreadable(error.to_string()),
    };
    if let Some(why) = ends_early(&bytes, form) {
        return State::Truncated(why);
    }
    let name = source.to_string();
    let read: std::result::Result<(), String> = match form {
        _ if !deep => match form {
            Form::Picture | Form::Gray16 => image_files::decode_size(&bytes, &name)
                .map(drop)
                .map_err(|e| e.to_string()),
            Form::Scan | Form::Text => Ok(()),
        },
        Form::Picture => image_files::decode_rgb(&bytes, &name)
            .map(drop)
            .map_err(|e| e.to_string()),
        Form::Gray16 => image_files::decode_gray16(&bytes, &name)
            .map(drop)
            .map_err(|e| e.to_string()),
        Form::Scan => parse_velodyne(&bytes).map(drop).map_err(|e| e.to_string()),
        Form::Text => strat_geometry::CamToCam::parse(&String::from_utf8_lossy(&bytes))
            .map(drop)
            .map_err(|e| e.to_string()),
    };
    read.map_or_else(State::Unreadable, |()| State::Good)
}

fn no_scan(length: u64) -> State {
    State::Truncated(format!("{length} bytes are not a whole number of points"))
}

/// Why a file that begins rightly is cut off, if it is: PNG ends with an `IEND` chunk, JPEG with
/// an end-of-image marker, a scan with a whole point.
fn ends_early(bytes: &[u8], form: Form) -> Option<String> {
    const PNG: &[u8] = b"\x89PNG\r\n\x1a\n";
    const PNG_END: &[u8] = b"\0\0\0\0IEND\xaeB`\x82";
    const JPEG: &[u8] = b"\xff\xd8\xff";
    const JPEG_END: &[u8] = b"\xff\xd9";
    let cut = |end: &str| Some(format!("it ends after {} bytes without {end}", bytes.len()));
    match form {
        Form::Scan if !bytes.len().is_multiple_of(16) => Some(format!(
            "{} bytes are not a whole number of points",
            bytes.len()
        )),
        Form::Scan | Form::Text => None,
        // Some programs append bytes of their own after the end, so it is looked for, not at.
        _ if bytes.starts_with(PNG) => {
            let tail = &bytes[bytes.len().saturating_sub(4096)..];
            let ended = tail.windows(PNG_END.len()).any(|w| w == PNG_END);
            if ended { None } else { cut("its IEND chunk") }
        }
        _ if bytes.starts_with(JPEG) => {
            let tail = &bytes[bytes.len().saturating_sub(4096)..];
            let ended = tail.windows(JPEG_END.len()).any(|w| w == JPEG_END);
            if ended { None } else { cut("its end marker") }
        }
        _ => None,
    }
}

/// Compares a prepared set with its tables, on the threads of the pool it is called in.
///
/// # Errors
/// A table cannot be read.
pub fn set(set: &PreparedSet, check: Check, report: &mut Report) -> Result<()> {
    let root = &set.root;
    let mut files: BTreeMap<(Role, &'static str), Vec<FileRef>> = BTreeMap::new();
    let mut known: BTreeSet<String> = [MANIFEST, SETTINGS, FAILURES].map(str::to_owned).into();
    known.extend(Role::ALL.map(layout::table_name));
    for role in Role::ALL {
        for sample in set.samples(role)? {
            for (column, file) in sample.files() {
                known.insert(file.path.clone());
                files.entry((role, column)).or_default().push(file.clone());
            }
        }
    }
    let total = files.values().map(|files| files.len() as u64).sum();
    let progress = Progress::new("prep verify", total, "files of the set", check.quiet);
    for ((role, column), files) in files {
        let states: Vec<_> = files
            .into_par_iter()
            .map(|file| {
                let state = state_in_set(set, &file, column, check.deep);
                progress.add(1);
                (file.path, state)
            })
            .collect();
        let mut finding = Finding::new(role.to_string(), column);
        for (name, state) in states {
            finding.add(&name, state);
        }
        report.findings.push(finding);
    }
    progress.finish();
    let mut strangers = Vec::new();
    strange_files(root, root, &known, &mut strangers);
    if !strangers.is_empty() {
        strangers.sort();
        let more = if strangers.len() > SHOWN { ", ..." } else { "" };
        report.problems.push(format!(
            "{} files belong to no sample and can be removed: {}{more}",
            strangers.len(),
            strangers[..strangers.len().min(SHOWN)].join(", ")
        ));
    }
    if !set.seals_manifest()? {
        report.notes.push(format!(
            "{MANIFEST} carries no digest of its own words, as that of sets by earlier versions: whether it \
             was edited cannot be told"
        ));
    }
    for (role, count) in &set.manifest.counts {
        if count.found < count.expected {
            // A set of part of a split is whole in itself.
            report.notes.push(format!(
                "{} of {} {role} samples are in this set",
                count.found, count.expected
            ));
        }
    }
    Ok(())
}

fn state_in_set(set: &PreparedSet, file: &FileRef, column: &str, deep: bool) -> State {
    let path = set.path(file);
    if !path.is_file() {
        return State::Missing;
    }
    match files::blake3_file(&path, Kind::Content) {
        Err(error) => return State::Unreadable(error.to_string()),
        Ok(found) if found != file.blake3 => return State::Changed,
        Ok(_) => {}
    }
    if !deep {
        return State::Good;
    }
    let read = match column {
        "semantic" => image_files::read_gray8(&path).map(drop),
        "instance" => image_files::read_gray16(&path).map(drop),
        column if column.starts_with("depth_") => exr::read_depth(&path).map(drop),
        _ => image_files::read_rgb(&path).map(drop),
    };
    read.map_or_else(|e| State::Unreadable(e.to_string()), |()| State::Good)
}

/// Files below `folder` that no table of the set names. Links are not followed.
fn strange_files(
    root: &Path,
    folder: &Path,
    known: &BTreeSet<String>,
    strangers: &mut Vec<String>,
) {
    let Ok(entries) = std::fs::read_dir(folder) else {
        strangers.push(format!("{} (cannot be read)", folder.display()));
        return;
    };
    for entry in entries.flatten() {
        let path = entry.path();
        if entry.file_type().is_ok_and(|kind| kind.is_dir()) {
            strange_files(root, &path, known, strangers);
            continue;
        }
        let Ok(inside) = path.strip_prefix(root) else {
            continue;
        };
        let parts: Vec<_> = inside.iter().map(|part| part.to_string_lossy()).collect();
        let name = parts.join("/");
        let half_written = parts.iter().any(|part| files::is_leftover(part));
        if !known.contains(&name) && !half_written {
            strangers.push(name);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn png() -> Vec<u8> {
        image_files::encode_png_gray8(3, 2, &[1, 2, 3, 4, 5, 6])
    }

    fn state(bytes: &[u8], form: Form, deep: bool) -> &'static str {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        std::fs::write(&path, bytes).unwrap();
        match state_of(&Source::File(path), form, deep) {
            State::Good => "good",
            State::Missing => "missing",
            State::Truncated(_) => "truncated",
            State::Unreadable(_) => "unreadable",
            State::Changed => "changed",
        }
    }

    #[test]
    fn a_quick_look_finds_files_that_were_cut_off() {
        let png = png();
        assert_eq!(state(&png, Form::Picture, false), "good");
        assert_eq!(
            state(&png[..png.len() - 3], Form::Picture, false),
            "truncated"
        );
        assert_eq!(state(b"", Form::Picture, false), "truncated");
        assert_eq!(state(b"<html>", Form::Picture, false), "unreadable");
        assert_eq!(state(&[0; 32], Form::Scan, false), "good");
        assert_eq!(state(&[0; 17], Form::Scan, false), "truncated");
    }

    #[test]
    fn only_a_deep_look_finds_damage_within() {
        let mut png = png();
        let middle = png.windows(4).position(|w| w == b"IDAT").unwrap() + 8;
        png[middle] ^= 0xff;
        assert_eq!(state(&png, Form::Picture, false), "good");
        assert_eq!(state(&png, Form::Picture, true), "unreadable");
        assert_eq!(state(b"no calibration", Form::Text, false), "good");
        assert_eq!(state(b"no calibration", Form::Text, true), "unreadable");
        let gray8 = image_files::encode_png_gray8(1, 1, &[1]);
        assert_eq!(state(&gray8, Form::Gray16, true), "unreadable");
    }

    #[test]
    fn findings_are_sentences() {
        let mut finding = Finding::new("2011_09_26_drive_0009", "scans");
        for index in 0..4 {
            let state = if index == 3 {
                State::Missing
            } else {
                State::Good
            };
            finding.add(&format!("{index:010}"), state);
        }
        assert_eq!(finding.sentence(), "3 of 4 good; short by 1: 0000000003");
        finding.add("0000000004", State::Truncated("it is empty".to_owned()));
        assert!(
            finding
                .sentence()
                .ends_with("truncated 1: 0000000004 (it is empty)")
        );
        let mut all = Finding::new("d", "left");
        all.add("a", State::Good);
        assert_eq!(all.sentence(), "1 complete");
        let mut none = Finding::new("d", "left");
        none.add("a", State::Missing);
        assert_eq!(none.sentence(), "all 1 missing");
    }
}
