//! What a set is as a whole: its content, its cameras, how many samples it has.

use std::collections::BTreeMap;
use std::fmt;
use std::path::Path;

use serde::{Deserialize, Serialize};
use strat_splits::{Role, Split};

use crate::error::{Error, Result};
use crate::inputs::{self, Kind};
use crate::resize::Kernel;
use crate::{files, yaml};

/// The format this version writes and reads.
pub const FORMAT: u32 = 2;

/// What a set was made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Content {
    /// The KITTI split, tested on stereo 2015.
    Kitti,
    /// The Eigen split of KITTI raw.
    Eigen,
    /// A user's own rectified stereo pairs.
    Pairs,
    /// The Make3D test images.
    Make3d,
    /// Cityscapes.
    Cityscapes,
}

impl Content {
    /// All kinds.
    pub const ALL: [Self; 5] = [
        Self::Kitti,
        Self::Eigen,
        Self::Pairs,
        Self::Make3d,
        Self::Cityscapes,
    ];

    /// The name in manifests and configurations.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Kitti => "kitti",
            Self::Eigen => "eigen",
            Self::Pairs => "pairs",
            Self::Make3d => "make3d",
            Self::Cityscapes => "cityscapes",
        }
    }

    /// The split of KITTI it is, if it is one.
    pub fn split(self) -> Option<Split> {
        match self {
            Self::Kitti => Some(Split::Kitti),
            Self::Eigen => Some(Split::Eigen),
            Self::Pairs | Self::Make3d | Self::Cityscapes => None,
        }
    }
}

impl From<Split> for Content {
    fn from(split: Split) -> Self {
        match split {
            Split::Kitti => Self::Kitti,
            Split::Eigen => Self::Eigen,
        }
    }
}

impl fmt::Display for Content {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

/// Samples a role should have and has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Count {
    /// Samples the split has in this role.
    pub expected: u64,
    /// Samples in this set.
    pub found: u64,
}

/// A camera that took some of the images.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraEntry {
    /// Recording day or another name of the rig.
    pub name: String,
    /// Width in pixels of its images.
    pub width: u32,
    /// Height in pixels of its images.
    pub height: u32,
    /// Focal length in pixels.
    pub focal_px: f64,
    /// Stereo baseline in metres.
    pub baseline_m: f64,
}

/// What a set is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// Version of this layout, see [`FORMAT`].
    pub format: u32,
    /// What it was made of: a split of KITTI or another collection.
    pub content: Content,
    /// Digest of that split's lists; collections that are no split of KITTI have none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub split_digest: Option<String>,
    /// `kitti` for recorded, `rendered` for synthetic data, else the name of the collection.
    pub source: String,
    /// Width in pixels of the network-size images.
    pub image_width: u32,
    /// Height in pixels of the network-size images.
    pub image_height: u32,
    /// Kernel that made the network-size images.
    pub kernel: Kernel,
    /// How they are stored: `png`, or `jpeg-92` with the quality.
    pub codec: String,
    /// Samples expected and found per role.
    pub counts: BTreeMap<Role, Count>,
    /// Inputs that could not be used; they are listed in `failures.csv`.
    pub failures: u64,
    /// The cameras.
    pub cameras: Vec<CameraEntry>,
    /// Version of the program that wrote it.
    pub tool_version: String,
    /// BLAKE3 over the sample tables, and so over all content.
    pub data_digest: String,
}

impl Manifest {
    /// Whether a role has all samples of its split.
    pub fn is_complete(&self, role: Role) -> bool {
        self.counts
            .get(&role)
            .is_some_and(|count| count.found == count.expected)
    }
}

/// Key of the last line of a manifest: the BLAKE3 of everything above it.
const SEAL: &str = "manifest_digest: ";

/// A manifest and, as its last line, the digest of its words.
pub(super) fn to_bytes(manifest: &Manifest) -> Result<Vec<u8>> {
    let text = yaml::to_string(manifest)?;
    let seal = files::blake3_hex(text.as_bytes());
    Ok(format!("{text}{SEAL}{seal}\n").into_bytes())
}

/// The words of a manifest and the digest of them that it states.
pub(super) fn seal_of(bytes: &[u8]) -> Option<(&[u8], &str)> {
    let text = std::str::from_utf8(bytes).ok()?;
    let start = text.rfind(SEAL).filter(|at| text[..*at].ends_with('\n'))?;
    Some((&bytes[..start], text[start + SEAL.len()..].trim_end()))
}

/// Reads a manifest. One with a digest of its words must have those words.
pub(super) fn load(path: &Path) -> Result<Manifest> {
    let wrong = |problem: String| Error::Yaml {
        path: path.to_owned(),
        problem,
    };
    let bytes = inputs::read(path, Kind::Yaml)?;
    let words = match seal_of(&bytes) {
        None => &bytes[..],
        Some((words, seal)) if files::blake3_hex(words) == seal => words,
        Some(_) => {
            return Err(wrong(
                "it was edited: its last line is not the digest of what stands above it; run the `prep` \
                 command again"
                    .to_owned(),
            ));
        }
    };
    yaml::parse(words).map_err(wrong)
}
