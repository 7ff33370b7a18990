//! The folders of KITTI raw, "synced and rectified" (PROTOCOL 1.1).
//!
//! Only names are looked at and calibration files read; no image or scan is opened here.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use strat_geometry::{CamToCam, VeloToCam, velodyne_projection};
use strat_splits::{Date, DriveId, FrameId};

use crate::error::{Error, Result};

const OPTION: &str = "--raw";

/// A KITTI raw folder: what it has of calibrations, drives and frames.
#[derive(Debug)]
pub struct RawFolder {
    /// The folder.
    pub root: PathBuf,
    /// Whether it was rendered by `prep synth`.
    pub rendered: bool,
    days: BTreeMap<Date, Day>,
    drives: BTreeMap<DriveId, DriveFolder>,
}

/// Calibration of a recording day; the texts say why it is not there.
#[derive(Debug)]
pub struct Day {
    /// The cameras.
    pub cameras: std::result::Result<CamToCam, String>,
    /// From Velodyne points to left pixels.
    pub projection: std::result::Result<[[f64; 4]; 3], String>,
}

/// The files of a drive by frame number.
#[derive(Debug, Default)]
struct DriveFolder {
    left: BTreeMap<u32, PathBuf>,
    right: BTreeMap<u32, PathBuf>,
    scans: BTreeMap<u32, PathBuf>,
}

impl RawFolder {
    /// Looks through a folder with one sub-folder per recording day.
    ///
    /// # Errors
    /// It is no folder, cannot be read, or holds no recording day; the message says what it
    /// holds instead where that is recognised.
    pub fn open(root: &Path) -> Result<Self> {
        let wrong = |problem: String| Error::Input {
            option: OPTION,
            path: root.to_owned(),
            problem,
        };
        let entries = list(root).map_err(|e| wrong(e.to_string()))?;
        let mut days = BTreeMap::new();
        let mut drives = BTreeMap::new();
        for date in Date::ALL {
            let folder = root.join(date.as_str());
            if !folder.is_dir() {
                continue;
            }
            days.insert(date, Day::read(&folder));
            for name in list(&folder).map_err(|e| wrong(e.to_string()))? {
                let Ok(id) = name.parse::<DriveId>() else {
                    continue;
                };
                let path = folder.join(&name);
                if id.date == date && path.is_dir() {
                    let drive: &mut DriveFolder = drives.entry(id).or_default();
                    drive.add(&path).map_err(|e| wrong(e.to_string()))?;
                }
            }
        }
        if days.is_empty() {
            return Err(wrong(explain(root, &entries)));
        }
        Ok(Self {
            root: root.to_owned(),
            rendered: root.join("RENDERED").is_file(),
            days,
            drives,
        })
    }

    /// Calibration of a day; `None` if the day has no folder.
    pub fn day(&self, date: Date) -> Option<&Day> {
        self.days.get(&date)
    }

    /// Whether a drive has a folder.
    pub fn has_drive(&self, drive: DriveId) -> bool {
        self.drives.contains_key(&drive)
    }

    /// The left image of a frame.
    pub fn left(&self, frame: FrameId) -> Option<&Path> {
        self.drives
            .get(&frame.drive)?
            .left
            .get(&frame.index)
            .map(PathBuf::as_path)
    }

    /// The right image of a frame.
    pub fn right(&self, frame: FrameId) -> Option<&Path> {
        self.drives
            .get(&frame.drive)?
            .right
            .get(&frame.index)
            .map(PathBuf::as_path)
    }

    /// The Velodyne scan of a frame.
    pub fn scan(&self, frame: FrameId) -> Option<&Path> {
        self.drives
            .get(&frame.drive)?
            .scans
            .get(&frame.index)
            .map(PathBuf::as_path)
    }
}

impl Day {
    fn read(folder: &Path) -> Self {
        let read = |name: &str| {
            let path = folder.join(name);
            let bytes = std::fs::read(&path).map_err(|e| match e.kind() {
                std::io::ErrorKind::NotFound => format!("{} is missing", path.display()),
                _ => format!("{} cannot be read: {e}", path.display()),
            })?;
            // Whatever is not text can only spoil its own line.
            Ok::<_, String>((path, String::from_utf8_lossy(&bytes).into_owned()))
        };
        let cameras = read("calib_cam_to_cam.txt").and_then(|(path, text)| {
            CamToCam::parse(&text).map_err(|e| format!("{}: {e}", path.display()))
        });
        let projection = read("calib_velo_to_cam.txt")
            .and_then(|(path, text)| {
                VeloToCam::parse(&text).map_err(|e| format!("{}: {e}", path.display()))
            })
            .and_then(|velo| {
                Ok(velodyne_projection(
                    cameras.as_ref().map_err(Clone::clone)?,
                    &velo,
                ))
            });
        Self {
            cameras,
            projection,
        }
    }
}

impl DriveFolder {
    /// Adds the files of a drive folder; what is known already stays.
    fn add(&mut self, folder: &Path) -> std::io::Result<()> {
        for (files, place) in [
            (&mut self.left, "image_02/data"),
            (&mut self.right, "image_03/data"),
            (&mut self.scans, "velodyne_points/data"),
        ] {
            let place = folder.join(place);
            if !place.is_dir() {
                continue;
            }
            for name in names(&place)? {
                let Some((stem, ending)) = name.rsplit_once('.') else {
                    continue;
                };
                let wanted: &[&str] = if place.ends_with("velodyne_points/data") {
                    &["bin"]
                } else {
                    IMAGE_ENDINGS
                };
                if stem.len() != 10
                    || !stem.bytes().all(|b| b.is_ascii_digit())
                    || !wanted.contains(&ending)
                {
                    continue;
                }
                let Ok(index) = stem.parse() else { continue };
                let path = place.join(&name);
                match files.get(&index) {
                    // Names come sorted, so a PNG is seen after a JPEG of the same frame.
                    Some(known)
                        if ending != "png" || known.extension().is_some_and(|e| e == "png") => {}
                    _ => {
                        files.insert(index, path);
                    }
                }
            }
        }
        Ok(())
    }
}

/// Endings of images, of which PNG is preferred: it is the original.
pub(crate) const IMAGE_ENDINGS: &[&str] = &["png", "jpg", "jpeg"];

/// The names in a folder, sorted; an error says that there is no folder or what else is wrong.
fn list(folder: &Path) -> std::io::Result<Vec<String>> {
    if !folder.exists() {
        return Err(std::io::Error::other(
            "there is no such folder; give the one that holds KITTI raw's recording days, e.g. \
             2011_09_26",
        ));
    }
    if !folder.is_dir() {
        return Err(std::io::Error::other("this is a file; a folder is needed"));
    }
    names(folder)
}

pub(crate) fn names(folder: &Path) -> std::io::Result<Vec<String>> {
    let read = || {
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
    if let Some(archive) = entries
        .iter()
        .find(|name| name.starts_with("2011_") && name.ends_with(".zip"))
    {
        return format!("{LAYOUT}. There are archives ({archive}); unpack them here first");
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
