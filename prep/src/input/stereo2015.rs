//! KITTI stereo 2015 and KITTI semantics, training part (PROTOCOL 1.2, 1.3): unpacked folders or
//! the zip archives as KITTI hands them out.
//!
//! Only names are looked at; no image is opened here.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use strat_splits::Date;

use crate::error::{Error, Result};
use crate::input::raw::{IMAGE_EXTENSIONS, RENDERED, names};
use crate::input::source::{self, Source};

/// Which data set a folder should be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Stereo 2015: images and disparities.
    Stereo,
    /// Semantics: label images.
    Semantics,
}

/// A `training` folder of numbered scenes, on disk or in archives. What occurs twice is taken
/// from the folder.
#[derive(Debug)]
pub struct SceneFolder {
    /// The folder or archive.
    pub root: PathBuf,
    /// Whether it was rendered by `prep synth`.
    pub rendered: bool,
    /// Archives that cannot be read, with the reason.
    pub broken: Vec<(PathBuf, String)>,
    training: PathBuf,
    /// Files in archives by their name below `training/`.
    packed: BTreeMap<String, Source>,
}

impl SceneFolder {
    /// Checks that `root/training` has the sub-folders of its kind, or that `root` is or holds
    /// the archives that have them.
    ///
    /// # Errors
    /// It is neither, or lacks what every download of this kind has.
    pub fn open(root: &Path, kind: Kind) -> Result<Self> {
        let (option, archive, needed): (_, _, &[&str]) = match kind {
            Kind::Stereo => (
                "--stereo2015",
                "data_scene_flow",
                &["image_2", "image_3", "disp_noc_0"],
            ),
            Kind::Semantics => ("--semantics", "data_semantics", &["semantic"]),
        };
        let wrong = |problem: String| Error::Input {
            option,
            path: root.to_owned(),
            problem,
        };
        if !root.exists() {
            return Err(wrong(format!(
                "folder not found; give the one that holds training/{}",
                needed.join(", training/")
            )));
        }
        let layout = format!("looked for training/{}", needed.join(", training/"));
        if needed.iter().all(|name| root.join(name).is_dir()) {
            let above = root
                .parent()
                .map_or(String::new(), |p| p.display().to_string());
            return Err(wrong(format!(
                "this is the `training` folder itself; {layout}. Give the folder above it: {option} {above}"
            )));
        }
        let training = root.join("training");
        let mut packed = BTreeMap::new();
        let mut broken = Vec::new();
        let folders = needed.iter().map(|name| training.join(name));
        for folder in std::iter::once(training.clone()).chain(folders) {
            if let Err(error) = names(&folder)
                && error.kind() == std::io::ErrorKind::PermissionDenied
            {
                broken.push((folder, error.to_string()));
            }
        }
        for path in archives(root, archive) {
            match source::entries(&path, |name| below_training(name).is_some()) {
                Ok(entries) => packed.extend(entries.into_iter().filter_map(|entry| {
                    let name = below_training(entry.name())?.to_owned();
                    Some((name, Source::Entry(entry)))
                })),
                Err(problem) if path == root => return Err(wrong(problem)),
                Err(problem) => broken.push((path, problem)),
            }
        }
        let is_packed = |folder: &str| {
            let first = packed.range(format!("{folder}/")..).next();
            first.is_some_and(|(name, _)| name.starts_with(&format!("{folder}/")))
        };
        let missing: Vec<_> = needed
            .iter()
            .filter(|name| !training.join(name).is_dir() && !is_packed(name))
            .collect();
        if missing.len() == needed.len() {
            if let Some((_, problem)) = broken.first() {
                return Err(wrong(problem.clone()));
            }
            let empty = root.is_dir()
                && std::fs::read_dir(root).is_ok_and(|mut entries| entries.next().is_none());
            let what = if empty {
                "the folder is empty"
            } else {
                "none of these is there"
            };
            return Err(wrong(format!(
                "{layout}; {what}. Give the archive {archive}.zip or the folder into which it was unpacked"
            )));
        }
        if let Some(missing) = missing.first() {
            return Err(wrong(format!(
                "{layout}; training/{missing} is not there. Unpack the whole archive"
            )));
        }
        Ok(Self {
            root: root.to_owned(),
            rendered: root.join(RENDERED).is_file(),
            broken,
            training,
            packed,
        })
    }

    /// A picture of a scene, e.g. `image_2/000006_10.png`, in any case of the extension.
    pub fn picture(&self, folder: &str, number: usize) -> Option<Source> {
        let shouted = IMAGE_EXTENSIONS.map(str::to_uppercase);
        let extensions = IMAGE_EXTENSIONS.iter().copied();
        let extensions = extensions.chain(shouted.iter().map(String::as_str));
        let names: Vec<_> = extensions
            .map(|extension| format!("{folder}/{number:06}_10.{extension}"))
            .collect();
        let on_disk = names.iter().find_map(|name| self.unpacked(name));
        on_disk.or_else(|| names.iter().find_map(|name| self.packed.get(name).cloned()))
    }

    /// The camera calibration of a scene.
    pub fn calibration(&self, number: usize) -> Option<Source> {
        let name = format!("calib_cam_to_cam/{number:06}.txt");
        self.unpacked(&name)
            .or_else(|| self.packed.get(&name).cloned())
    }

    fn unpacked(&self, name: &str) -> Option<Source> {
        let path = self.training.join(name);
        path.is_file().then_some(Source::File(path))
    }
}

/// The archives to look into: the one given and, beside it or in the folder given, those whose
/// name begins as KITTI's do. Calibration files come in an archive of their own.
fn archives(root: &Path, beginning: &str) -> Vec<PathBuf> {
    let given = root.is_file().then(|| root.to_owned());
    let folder = match &given {
        Some(file) => file.parent().unwrap_or(Path::new("")),
        None => root,
    };
    let folder = if folder.as_os_str().is_empty() {
        Path::new(".")
    } else {
        folder
    };
    let beside = names(folder).unwrap_or_default().into_iter();
    let beside = beside.filter(|name| name.starts_with(beginning) && source::is_archive(name));
    let beside = beside.map(|name| folder.join(name));
    let others = beside.filter(|path| path.is_file() && path.file_name() != root.file_name());
    given.iter().cloned().chain(others).collect()
}

/// What follows the folder `training` in the name of an entry.
fn below_training(name: &str) -> Option<&str> {
    match name.split_once("training/")? {
        (before, rest) if before.is_empty() || before.ends_with('/') => Some(rest),
        _ => None,
    }
}

/// Focal length in pixels and baseline in metres of a scene without a calibration file.
///
/// Every scene was taken on one of the raw recording days, which its image size gives away
/// (PROTOCOL 1.1 and 1.2); `None` for a size of no such day.
pub fn camera_by_size(width: u32, height: u32) -> Option<(f64, f64)> {
    let date = Date::ALL
        .into_iter()
        .find(|date| date.image_size() == (width, height))?;
    Some(match date {
        Date::D2011_09_26 => (721.5377, 0.532_725_428),
        Date::D2011_09_28 => (707.0493, 0.537_255_903),
        Date::D2011_09_29 => (718.3351, 0.530_140_487),
        Date::D2011_09_30 => (707.0912, 0.537_904_488),
        Date::D2011_10_03 => (718.856, 0.532_331_858),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_stereo_2015_size_has_its_camera() {
        // The last column of the calibration table in PROTOCOL 1.1: focal length times baseline.
        for (size, product) in [
            ((1242, 375), 384.3815),
            ((1224, 370), 379.8664),
            ((1238, 374), 380.8185),
            ((1226, 370), 380.3475),
            ((1241, 376), 382.6700),
        ] {
            let (focal_px, baseline_m) = camera_by_size(size.0, size.1).unwrap();
            assert!((focal_px * baseline_m - product).abs() < 1e-4, "{size:?}");
        }
        assert_eq!(camera_by_size(1242, 376), None);
    }
}
