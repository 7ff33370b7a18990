//! The folders of KITTI stereo 2015 and of KITTI semantics, training part (PROTOCOL 1.2, 1.3).
//!
//! Only names are looked at; no image is opened here.

use std::path::{Path, PathBuf};

use strat_splits::Date;

use crate::error::{Error, Result};
use crate::raw::IMAGE_ENDINGS;

/// Which data set a folder should be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Stereo 2015: images and disparities.
    Stereo,
    /// Semantics: label images.
    Semantics,
}

/// A folder with a `training` sub-folder of numbered scenes.
#[derive(Debug)]
pub struct SceneFolder {
    /// The folder.
    pub root: PathBuf,
    training: PathBuf,
}

impl SceneFolder {
    /// Checks that `root/training` has the sub-folders of its kind.
    ///
    /// # Errors
    /// It is no folder or lacks what every download of this kind has.
    pub fn open(root: &Path, kind: Kind) -> Result<Self> {
        let (option, needed): (_, &[&str]) = match kind {
            Kind::Stereo => ("--stereo2015", &["image_2", "image_3", "disp_noc_0"]),
            Kind::Semantics => ("--semantics", &["semantic"]),
        };
        let wrong = |problem: String| Error::Input {
            option,
            path: root.to_owned(),
            problem,
        };
        if !root.exists() {
            return Err(wrong(format!(
                "there is no such folder; give the one that holds training/{}",
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
        let missing: Vec<_> = needed
            .iter()
            .filter(|name| !training.join(name).is_dir())
            .collect();
        if missing.len() == needed.len() {
            let empty = root.is_dir()
                && std::fs::read_dir(root).is_ok_and(|mut entries| entries.next().is_none());
            let what = if empty {
                "the folder is empty"
            } else {
                "none of these is there"
            };
            return Err(wrong(format!(
                "{layout}; {what}. Give the folder into which the archive was unpacked"
            )));
        }
        if let Some(missing) = missing.first() {
            return Err(wrong(format!(
                "{layout}; training/{missing} is not there. Unpack the whole archive"
            )));
        }
        Ok(Self {
            root: root.to_owned(),
            training,
        })
    }

    /// A picture of a scene, e.g. `image_2/000006_10.png`.
    pub fn picture(&self, folder: &str, number: usize) -> Option<PathBuf> {
        let stem = self.training.join(folder).join(format!("{number:06}_10"));
        IMAGE_ENDINGS
            .iter()
            .map(|ending| stem.with_extension(ending))
            .find(|path| path.is_file())
    }

    /// The camera calibration of a scene.
    pub fn calibration(&self, number: usize) -> Option<PathBuf> {
        let path = self
            .training
            .join("calib_cam_to_cam")
            .join(format!("{number:06}.txt"));
        path.is_file().then_some(path)
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
