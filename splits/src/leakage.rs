//! Whether images come from drives that a model was trained on.
//!
//! The two splits share drives: half of the Eigen test images lie in training drives of the KITTI
//! split, and most stereo-2015 images with a known origin are Eigen training frames (PROTOCOL 2.3).
//! A model that names its drives is checked drive by drive; one that names only its split can be
//! warned about but not cleared. Not here: what follows from it.

use std::collections::BTreeSet;
use std::fmt;

use crate::role::Split;
use crate::table::kitti2015_origin;

/// What a model says of its training.
#[derive(Clone, Copy, Debug, Default)]
pub struct Training<'a> {
    /// Name of the split.
    pub split: Option<&'a str>,
    /// Drives of the training images; empty when unknown.
    pub drives: &'a [String],
    /// It began with weights of which nobody knows what they were trained on.
    pub unknown_start: bool,
}

impl Training<'_> {
    /// Whether it names a split or drives at all.
    #[must_use]
    pub fn is_told(&self) -> bool {
        self.split.is_some() || !self.drives.is_empty()
    }
}

/// What is known about training places among the test images.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Leakage {
    /// No test image comes from a drive of the training.
    None,
    /// Some do.
    Drives {
        /// The drives, sorted.
        drives: Vec<String>,
        /// Test images from them.
        images: usize,
    },
    /// The model was trained on the other split and does not name its drives.
    OtherSplit {
        /// Name of the training split.
        trained: String,
    },
    /// The model says nothing about its training, or not all of it.
    Unknown,
}

impl fmt::Display for Leakage {
    /// As in "trained on drives of 12 of the test images (2011_09_26_drive_0005)".
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::None => f.pad("no test image from a training drive"),
            Self::Drives { drives, images } => write!(
                f,
                "trained on drives of {images} of the test images ({})",
                drives.join(", ")
            ),
            Self::OtherSplit { trained } => write!(
                f,
                "trained on the {trained} split, whose drives may be among the test images"
            ),
            Self::Unknown => f.pad("training drives unknown"),
        }
    }
}

/// Compares the training of a model, if it says anything, with the ids of test images; `tested` is
/// the name of their split or collection.
///
/// Stereo-2015 images count as frames of the drive they were taken from, where that is known.
pub fn leakage<'i>(
    training: Option<Training<'_>>,
    tested: &str,
    images: impl IntoIterator<Item = &'i str>,
) -> Leakage {
    let Some(training) = training else {
        return Leakage::Unknown;
    };
    // A model that grew from other weights has seen what those had seen.
    let cleared = if training.unknown_start {
        Leakage::Unknown
    } else {
        Leakage::None
    };
    if training.drives.is_empty() {
        return match training.split {
            Some(trained) if trained == tested => cleared,
            // Other collections share no image with KITTI.
            Some(trained)
                if trained.parse::<Split>().is_ok() && tested.parse::<Split>().is_err() =>
            {
                cleared
            }
            Some(trained) => Leakage::OtherSplit {
                trained: trained.to_owned(),
            },
            None => Leakage::Unknown,
        };
    }
    let trained: BTreeSet<&str> = training.drives.iter().map(String::as_str).collect();
    let seen: Vec<String> = images
        .into_iter()
        .filter_map(drive_of)
        .filter(|drive| trained.contains(drive.as_str()))
        .collect();
    if seen.is_empty() {
        return cleared;
    }
    Leakage::Drives {
        images: seen.len(),
        drives: BTreeSet::from_iter(seen).into_iter().collect(),
    }
}

/// The drive of an image such as `2011_09_26_drive_0001/0000000005` or `kitti2015/000006`.
fn drive_of(id: &str) -> Option<String> {
    let (drive, name) = id.split_once('/').unwrap_or((id, id));
    if drive == "kitti2015" {
        let number: usize = name.rsplit('/').next()?.parse().ok()?;
        let origin = (*kitti2015_origin().get(number)?)?;
        return Some(origin.drive.to_string());
    }
    Some(drive.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_image_leaks_by_the_drive_it_came_from() {
        let drives = ["2011_09_26_drive_0005".to_owned()];
        let training = Training {
            split: Some("eigen"),
            drives: &drives,
            unknown_start: false,
        };
        // PROTOCOL 2.4: image 2 is frame 10 of drive 0005.
        let tested = ["kitti2015/000000", "kitti2015/000002", "kitti2015/000003"];
        let found = leakage(Some(training), "kitti", tested);
        assert_eq!(
            found.to_string(),
            "trained on drives of 2 of the test images (2011_09_26_drive_0005)"
        );
        assert_eq!(
            leakage(Some(training), "kitti", ["kitti2015/000000"]),
            Leakage::None
        );
        assert_eq!(leakage(None, "kitti", tested), Leakage::Unknown);
    }
}
