//! What measured rows are part of, which rows themselves do not say.

use std::fmt;

/// What the measured rows are part of.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Coverage {
    /// Images that the complete test set has.
    pub expected_images: u64,
    /// Where the images come from.
    pub source: Source,
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
