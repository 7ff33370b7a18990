//! What measured rows are part of, which rows themselves do not say.

use std::fmt;

use strat_splits::{eigen_test, has_annotated_depth};

use crate::protocol::GroundTruthKind;

/// What the measured rows are part of.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Coverage {
    /// Images that the complete test set has.
    pub expected_images: u64,
    /// Where the images come from.
    pub source: Source,
}

impl Coverage {
    /// Images that a protocol can be measured on: ground truth that is known to cover fewer of them
    /// makes a test set complete with those.
    #[must_use]
    pub fn under(&self, protocol: &str) -> u64 {
        let truth = crate::protocol(protocol).map(|protocol| protocol.ground_truth);
        let eigen = eigen_test();
        match truth {
            Some(GroundTruthKind::Annotated) if self.expected_images == eigen.len() as u64 => {
                eigen.iter().filter(|f| has_annotated_depth(**f)).count() as u64
            }
            _ => self.expected_images,
        }
    }
}

/// Where the images of a prepared set come from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Source {
    /// Recorded by KITTI: the only figures that compete with published ones.
    Kitti,
    /// The rendered world.
    Rendered,
    /// Another collection, by its name.
    Collection(String),
    /// Nobody wrote it down.
    Unknown,
}

impl Source {
    /// Whether figures measured on such images compete with the thesis' own.
    #[must_use]
    pub fn competes(&self) -> bool {
        *self == Self::Kitti
    }
}

impl From<&str> for Source {
    /// The text in manifests and `run.yaml`.
    fn from(text: &str) -> Self {
        match text {
            "kitti" => Self::Kitti,
            "rendered" => Self::Rendered,
            name => Self::Collection(name.to_owned()),
        }
    }
}

impl fmt::Display for Source {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Kitti => "kitti",
            Self::Rendered => "rendered",
            Self::Collection(name) => name,
            Self::Unknown => "of unknown source",
        })
    }
}
