//! KITTI raw, "synced and rectified" (PROTOCOL 1.1): unpacked folders, the zip archives as KITTI
//! hands them out, or both mixed.
//!
//! Only names are looked at and calibration files read; no image or scan is opened here.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::SystemTime;
use strat_store::inputs::Kind;

use strat_geometry::{CamToCam, VeloToCam, velodyne_projection};
use strat_splits::{Date, DriveId, FrameId};

use crate::error::{Error, Result};
use crate::input::source::{self, Source};

const OPTION: &str = "--raw";

/// Left images, right images and scans: their folders and extensions.
const KINDS: [(&str, &[&str]); 3] = [
    ("image_02", &IMAGE_EXTENSIONS),
    ("image_03", &IMAGE_EXTENSIONS),
    ("velodyne_points", &["bin"]),
];

/// Calibration of the cameras and of the scanner.
const CALIBRATIONS: [&str; 2] = ["calib_cam_to_cam.txt", "calib_velo_to_cam.txt"];

/// KITTI raw: what is there of calibrations, drives and frames.
///
/// A frame that is there more than once is taken from a folder rather than from an archive, and
/// of one place the PNG rather than the JPEG.
#[derive(Debug)]
pub struct RawFolder {
    /// The folder or archive.
    pub root: PathBuf,
    /// Whether it was rendered by `prep synth`.
    pub rendered: bool,
    /// Archives and folders that cannot be read, with the reason.
    pub broken: Vec<(PathBuf, String)>,
    /// Sentences about what is there and cannot serve.
    pub notes: Vec<String>,
    days: BTreeMap<Date, Day>,
    drives: BTreeMap<DriveId, Drive>,
}

/// Calibration of a recording day; the texts say why it is not there.
#[derive(Debug)]
pub struct Day {
    /// The cameras.
    pub cameras: std::result::Result<Arc<CamToCam>, String>,
    /// From Velodyne points to left pixels.
    pub projection: std::result::Result<[[f64; 4]; 3], String>,
    /// Files that are there and cannot be read or understood, with the reason.
    pub damaged: Vec<(PathBuf, String)>,
    /// When the later of the files was written or put into place.
    pub changed: Option<SystemTime>,
}

/// The files of a drive by kind (see [`KINDS`]) and frame number.
#[derive(Debug, Default)]
struct Drive([BTreeMap<u32, Source>; 3]);

/// What a walk through folders and archives has found so far.
#[derive(Default)]
struct Found {
    rendered: bool,
    broken: Vec<(PathBuf, String)>,
    calibrations: BTreeMap<(Date, &'static str), Source>,
    days: BTreeMap<Date, PathBuf>,
    drives: BTreeMap<DriveId, Drive>,
    unsynced: BTreeSet<DriveId>,
}

/// What the name of an entry says it is.
enum Meaning {
    Rendered,
    /// Part of a drive as it was before synchronising and rectifying.
    Unsynced(DriveId),
    Calibration(Date, &'static str),
    Frame(DriveId, usize, u32),
}

/// File that marks a folder as rendered by `prep synth`.
pub const RENDERED: &str = "RENDERED";

impl RawFolder {
    /// Looks through a folder with one sub-folder per recording day, or archives, or both; or
    /// through one archive. Archives are looked for in the folder and in those of the days.
    ///
    /// # Errors
    /// It is neither, cannot be read, or holds no recording day; the message says what it
    /// holds instead where that is recognised.
    pub fn open(root: &Path) -> Result<Self> {
        let wrong = |problem: String| Error::Input {
            option: OPTION,
            path: root.to_owned(),
            problem,
        };
        let mut found = Found::default();
        if root.is_file() && source::is_archive(&root.to_string_lossy()) {
            found.add_archive(root).map_err(wrong)?;
            if found.days.is_empty() {
                return Err(wrong(
                    "this is not an archive of KITTI raw: it holds no recording day, e.g. \
                     2011_09_26/2011_09_26_drive_0001_sync"
                        .to_owned(),
                ));
            }
        } else {
            let entries = list(root).map_err(|e| wrong(e.to_string()))?;
            found.rendered = root.join(RENDERED).is_file();
            let mut archives = archives_of(root, &entries);
            // The folder itself, and those into which archives were unpacked beside each other. Folders of
            // other names may hold other data, e.g. a rendered world.
            let beside = entries.iter().filter(|name| is_archive_stem(name));
            let beside = beside.map(|name| root.join(name));
            for folder in std::iter::once(root.to_owned()).chain(beside) {
                for date in Date::ALL {
                    let day = folder.join(date.as_str());
                    if day.is_dir() {
                        archives.extend(found.add_day(date, &day));
                    }
                }
            }
            for archive in archives {
                if let Err(problem) = found.add_archive(&archive) {
                    found.broken.push((archive, problem));
                }
            }
            if found.days.is_empty() {
                let broken = found.broken.first().map(|(_, problem)| problem.clone());
                return Err(wrong(broken.unwrap_or_else(|| explain(root, &entries))));
            }
        }
        let unsynced = found.unsynced.iter();
        let unsynced: Vec<_> = unsynced
            .filter(|id| !found.drives.contains_key(id))
            .map(ToString::to_string)
            .collect();
        let notes = match unsynced.len() {
            0 => Vec::new(),
            count => vec![format!(
                "{count} drives are there only as `_extract`, which is neither synchronised nor rectified and \
                 cannot be used; download them as `_sync`: {}",
                unsynced.join(", ")
            )],
        };
        let calibrations = found.calibrations;
        let day = |(date, place): (Date, PathBuf)| {
            let files = CALIBRATIONS.map(|name| calibrations.get(&(date, name)));
            (date, Day::read(&place, files))
        };
        Ok(Self {
            root: root.to_owned(),
            rendered: found.rendered,
            broken: found.broken,
            notes,
            days: found.days.into_iter().map(day).collect(),
            drives: found.drives,
        })
    }

    /// Calibration of a day; `None` if nothing of the day is there.
    pub fn day(&self, date: Date) -> Option<&Day> {
        self.days.get(&date)
    }

    /// Whether anything of a drive is there.
    pub fn has_drive(&self, drive: DriveId) -> bool {
        self.drives.contains_key(&drive)
    }

    /// The left image of a frame.
    pub fn left(&self, frame: FrameId) -> Option<&Source> {
        self.file(frame, 0)
    }

    /// The right image of a frame.
    pub fn right(&self, frame: FrameId) -> Option<&Source> {
        self.file(frame, 1)
    }

    /// The Velodyne scan of a frame.
    pub fn scan(&self, frame: FrameId) -> Option<&Source> {
        self.file(frame, 2)
    }

    fn file(&self, frame: FrameId, kind: usize) -> Option<&Source> {
        self.drives.get(&frame.drive)?.0[kind].get(&frame.index)
    }
}

impl Found {
    /// Adds the folder of a day and returns the archives in it. What cannot be listed is noted
    /// and costs nothing else.
    fn add_day(&mut self, date: Date, folder: &Path) -> Vec<PathBuf> {
        let day = self.days.entry(date);
        day.or_insert_with(|| folder.to_owned());
        for name in CALIBRATIONS {
            let path = folder.join(name);
            if path.exists() {
                let file = self.calibrations.entry((date, name));
                file.or_insert(Source::File(path));
            }
        }
        let Some(entries) = self.noted(folder) else {
            return Vec::new();
        };
        for name in &entries {
            let path = folder.join(name);
            match name.parse::<DriveId>() {
                Ok(id) if id.date == date && path.is_dir() => self.add_drive(id, &path),
                _ => self
                    .unsynced
                    .extend(unsynced(name).filter(|id| id.date == date)),
            }
        }
        archives_of(folder, &entries)
    }

    fn add_drive(&mut self, id: DriveId, folder: &Path) {
        self.drives.entry(id).or_default();
        if self.noted(folder).is_none() {
            return;
        }
        for (kind, (name, extensions)) in KINDS.iter().enumerate() {
            // Some copies leave out the level `data`.
            for place in [folder.join(name).join("data"), folder.join(name)] {
                if !place.is_dir() {
                    continue;
                }
                for name in self.noted(&place).unwrap_or_default() {
                    if let Some(index) = frame_number(&name, extensions) {
                        let source = Source::File(place.join(&name));
                        self.add_file(id, kind, index, source);
                    }
                }
            }
        }
    }

    fn add_archive(&mut self, path: &Path) -> std::result::Result<(), String> {
        let entries = source::entries(path, |name| meaning(name).is_some())?;
        for entry in entries {
            match meaning(entry.name()) {
                Some(Meaning::Unsynced(id)) => {
                    self.unsynced.insert(id);
                }
                Some(Meaning::Rendered) => self.rendered = true,
                Some(Meaning::Calibration(date, name)) => {
                    self.days.entry(date).or_insert_with(|| path.to_owned());
                    let file = self.calibrations.entry((date, name));
                    file.or_insert(Source::Entry(entry));
                }
                Some(Meaning::Frame(id, kind, index)) => {
                    self.days.entry(id.date).or_insert_with(|| path.to_owned());
                    self.add_file(id, kind, index, Source::Entry(entry));
                }
                None => {}
            }
        }
        Ok(())
    }

    /// Adds a file; of two of the same frame the better one stays.
    fn add_file(&mut self, id: DriveId, kind: usize, index: u32, source: Source) {
        let files = &mut self.drives.entry(id).or_default().0[kind];
        let rank = |source: &Source| (source.is_file(), source.extension() == "png");
        match files.get(&index) {
            Some(known) if rank(known) >= rank(&source) => {}
            _ => {
                files.insert(index, source);
            }
        }
    }

    fn noted(&mut self, folder: &Path) -> Option<Vec<String>> {
        match names(folder) {
            Ok(names) => Some(names),
            Err(error) => {
                self.broken.push((folder.to_owned(), error.to_string()));
                None
            }
        }
    }
}

impl Day {
    /// Reads the calibration files of a day that was found at `place`.
    fn read(place: &Path, [cam_to_cam, velo_to_cam]: [Option<&Source>; 2]) -> Self {
        let read = |file: Option<&Source>, name: &str| {
            let file = file.ok_or_else(|| {
                if place.is_dir() {
                    format!("{} is missing", place.join(name).display())
                } else {
                    format!("{name} is missing; it is in the archive <day>_calib.zip")
                }
            })?;
            let bytes = file.read(Kind::Calibration).map_err(|e| e.to_string())?;
            // Whatever is not text can only spoil its own line.
            Ok::<_, String>((
                file.to_string(),
                String::from_utf8_lossy(&bytes).into_owned(),
            ))
        };
        let cameras = read(cam_to_cam, CALIBRATIONS[0])
            .and_then(|(file, text)| CamToCam::parse(&text).map_err(|e| format!("{file}: {e}")))
            .map(Arc::new);
        let projection = read(velo_to_cam, CALIBRATIONS[1])
            .and_then(|(file, text)| VeloToCam::parse(&text).map_err(|e| format!("{file}: {e}")))
            .and_then(|velo| {
                Ok(velodyne_projection(
                    cameras.as_ref().map_err(Clone::clone)?,
                    &velo,
                ))
            });
        let files = [cam_to_cam, velo_to_cam].into_iter().flatten();
        let mut damaged = Vec::new();
        if let (Some(file), Err(problem)) = (cam_to_cam, &cameras) {
            damaged.push((file.to_string().into(), problem.clone()));
        }
        if let (Some(file), Ok(_), Err(problem)) = (velo_to_cam, &cameras, &projection) {
            damaged.push((file.to_string().into(), problem.clone()));
        }
        Self {
            cameras,
            projection,
            damaged,
            changed: files.filter_map(Source::changed).max(),
        }
    }
}

/// The frame number of a name like `0000000005.png` with one of the extensions, in any case.
fn frame_number(name: &str, extensions: &[&str]) -> Option<u32> {
    let (stem, extension) = name.rsplit_once('.')?;
    let digits = stem.len() == 10 && stem.bytes().all(|b| b.is_ascii_digit());
    let known = |known: &&str| known.eq_ignore_ascii_case(extension);
    (digits && extensions.iter().any(known))
        .then(|| stem.parse().ok())
        .flatten()
}

/// What an entry of an archive is, from its name as KITTI ships it; folders around the day's are
/// passed over.
fn meaning(name: &str) -> Option<Meaning> {
    if name == RENDERED {
        return Some(Meaning::Rendered);
    }
    let parts: Vec<_> = name.split('/').collect();
    let day = |part: &&str| Date::ALL.into_iter().find(|date| date.as_str() == *part);
    let at = parts.iter().position(|part| day(part).is_some())?;
    let date = day(&parts[at])?;
    match parts[at + 1..] {
        [file] => {
            let name = CALIBRATIONS.into_iter().find(|name| *name == file)?;
            Some(Meaning::Calibration(date, name))
        }
        [drive, ..] if unsynced(drive).is_some() => unsynced(drive).map(Meaning::Unsynced),
        [drive, folder, "data", file] | [drive, folder, file] => {
            let id: DriveId = drive.parse().ok().filter(|id: &DriveId| id.date == date)?;
            let kind = KINDS.iter().position(|(name, _)| *name == folder)?;
            Some(Meaning::Frame(id, kind, frame_number(file, KINDS[kind].1)?))
        }
        _ => None,
    }
}

/// The drive of a folder `2011_09_26_drive_0001_extract`.
fn unsynced(name: &str) -> Option<DriveId> {
    name.strip_suffix("_extract")?.parse().ok()
}

/// Whether a folder is called as one of KITTI's archives: `2011_09_26_drive_0001_sync`,
/// `2011_09_26_calib`.
fn is_archive_stem(name: &str) -> bool {
    let calibration = |date: Date| name.strip_prefix(date.as_str()) == Some("_calib");
    name.parse::<DriveId>().is_ok() || Date::ALL.into_iter().any(calibration)
}

/// The archives among the entries of a folder.
fn archives_of(folder: &Path, entries: &[String]) -> Vec<PathBuf> {
    let archives = entries.iter().filter(|name| source::is_archive(name));
    archives
        .map(|name| folder.join(name))
        .filter(|path| path.is_file())
        .collect()
}

/// Extensions of images, of which PNG is preferred: it is the original.
pub(crate) const IMAGE_EXTENSIONS: [&str; 3] = ["png", "jpg", "jpeg"];

/// The names in a folder, sorted; an error says that there is no folder or what else is wrong.
fn list(folder: &Path) -> std::io::Result<Vec<String>> {
    if !folder.exists() {
        return Err(std::io::Error::other(
            "folder not found; give the one that holds KITTI raw's recording days, e.g. \
             2011_09_26",
        ));
    }
    if !folder.is_dir() {
        return Err(std::io::Error::other(
            "this is a file; a folder or one of KITTI's zip archives is needed",
        ));
    }
    names(folder)
}

/// The names in a folder, sorted. One whose names alone may be read is refused too: what is in it
/// would look as if it were missing.
pub(crate) fn names(folder: &Path) -> std::io::Result<Vec<String>> {
    let read = || {
        std::fs::metadata(folder.join("."))?;
        let entries = std::fs::read_dir(folder)?;
        let mut names = Vec::new();
        for entry in entries {
            // Names that are no UTF-8 are none of KITTI's.
            names.extend(entry?.file_name().into_string());
        }
        names.sort_unstable();
        Ok(names)
    };
    read().map_err(|e: std::io::Error| {
        std::io::Error::new(
            e.kind(),
            format!("cannot list the folder {}: {e}", folder.display()),
        )
    })
}

/// What to tell somebody whose folder has no recording day.
fn explain(root: &Path, entries: &[String]) -> String {
    const LAYOUT: &str = "looked for sub-folders of recording days, e.g. \
                          2011_09_26/2011_09_26_drive_0001_sync/image_02/data";
    if entries.is_empty() {
        return format!("the folder is empty; {LAYOUT}");
    }
    let above = |steps: usize| {
        root.ancestors()
            .nth(steps)
            .map_or(String::new(), |p| p.display().to_string())
    };
    if let Some(drive) = entries.iter().find(|name| unsynced(name).is_some()) {
        return format!(
            "{LAYOUT}; {drive} is neither synchronised nor rectified. Download the drive as `_sync`"
        );
    }
    if entries.iter().any(|name| name.parse::<DriveId>().is_ok()) {
        return format!(
            "this is the folder of one recording day; {LAYOUT}. Give the folder above it: {OPTION} {}",
            above(1)
        );
    }
    if entries
        .iter()
        .any(|name| name == "image_02" || name == "velodyne_points")
    {
        return format!(
            "this is the folder of one drive; {LAYOUT}. Give the folder two above it: {OPTION} {}",
            above(2)
        );
    }
    let holds_days = |folder: &PathBuf| {
        Date::ALL
            .iter()
            .any(|date| folder.join(date.as_str()).is_dir())
    };
    if let Some(inner) = entries.iter().map(|name| root.join(name)).find(holds_days) {
        return format!(
            "{LAYOUT}. They are one folder deeper: {OPTION} {}",
            inner.display()
        );
    }
    if let Some(archive) = entries.iter().find(|name| source::is_archive(name)) {
        return format!(
            "{LAYOUT}, or the archives as KITTI ships them; {archive} is not an archive of KITTI raw"
        );
    }
    if entries.iter().any(|name| name == "training") {
        return format!(
            "{LAYOUT}. There is a `training` folder, as in the stereo 2015 data; that belongs to --stereo2015"
        );
    }
    format!(
        "{LAYOUT}, and found none of the five days among its {} entries ({}, ...)",
        entries.len(),
        entries[0]
    )
}
