//! The two splits, and what a frame is used for in one.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// An unknown split.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("unknown split `{0}`; the splits are `kitti` and `eigen`")]
pub struct ParseSplitError(String);

/// One of the two ways KITTI raw is divided for unsupervised depth.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Split {
    /// Tested on the 200 KITTI stereo 2015 training scenes (tables 3.1 and 3.2).
    Kitti,
    /// Tested on the 697 frames of Eigen et al. against Velodyne scans (table 3.3).
    Eigen,
}

impl Split {
    /// Both splits.
    pub const ALL: [Self; 2] = [Self::Kitti, Self::Eigen];

    /// `kitti` or `eigen`.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Kitti => "kitti",
            Self::Eigen => "eigen",
        }
    }
}

impl fmt::Display for Split {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

impl FromStr for Split {
    type Err = ParseSplitError;

    fn from_str(text: &str) -> Result<Self, ParseSplitError> {
        Self::ALL
            .into_iter()
            .find(|s| s.as_str() == text)
            .ok_or_else(|| ParseSplitError(text.to_owned()))
    }
}

/// What a frame is used for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// The network learns from it.
    Train,
    /// Watched while training, never learned from.
    Val,
    /// Only looked at by the final evaluation.
    Test,
}

impl Role {
    /// All roles.
    pub const ALL: [Self; 3] = [Self::Train, Self::Val, Self::Test];

    /// `train`, `val` or `test`.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Train => "train",
            Self::Val => "val",
            Self::Test => "test",
        }
    }
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}
