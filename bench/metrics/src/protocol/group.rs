//! Groups of pixels: what they show (thesis table 3.2), or how far away they are.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// Whether an image is scored as a whole, by what its pixels show, or by how far away they are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Grouping {
    /// One score per image.
    None,
    /// One score per image and semantic [`Group`] that the image contains.
    Cityscapes,
    /// One score per image and distance: by the true depth of a pixel.
    Distance,
}

impl Grouping {
    /// Its groups, in the order of tables and curves.
    #[must_use]
    pub fn groups(self) -> &'static [Group] {
        match self {
            Self::None => &[],
            Self::Cityscapes => &Group::SEMANTIC,
            Self::Distance => &Group::DISTANCES,
        }
    }
}

/// A group of pixels: what they show (the rows of thesis table 3.2, groups of Cityscapes label
/// ids), or how far away they are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Group {
    /// Road, sidewalk, parking, rail track.
    Flat,
    /// Person, rider.
    Human,
    /// Cars to bicycles.
    Vehicle,
    /// Building, wall, fence, guard rail, bridge, tunnel.
    Construction,
    /// Poles, traffic lights and signs.
    Object,
    /// True depth up to 5 m.
    To5m,
    /// True depth above 5 m and up to 10 m.
    To10m,
    /// Above 10 m and up to 15 m.
    To15m,
    /// Above 15 m and up to 20 m.
    To20m,
    /// Above 20 m and up to 30 m.
    To30m,
    /// Above 30 m and up to 40 m.
    To40m,
    /// Above 40 m and up to 50 m.
    To50m,
    /// Above 50 m and up to 60 m.
    To60m,
    /// Above 60 m and up to 80 m.
    To80m,
    /// True depth above 80 m.
    Over80m,
}

impl Group {
    /// Groups of labels in the order of the thesis' table.
    pub const SEMANTIC: [Self; 5] = [
        Self::Flat,
        Self::Human,
        Self::Vehicle,
        Self::Construction,
        Self::Object,
    ];

    /// Groups of distance, near to far.
    pub const DISTANCES: [Self; 10] = [
        Self::To5m,
        Self::To10m,
        Self::To15m,
        Self::To20m,
        Self::To30m,
        Self::To40m,
        Self::To50m,
        Self::To60m,
        Self::To80m,
        Self::Over80m,
    ];

    /// All groups.
    pub fn all() -> impl Iterator<Item = Self> {
        Self::SEMANTIC.into_iter().chain(Self::DISTANCES)
    }

    /// First and last Cityscapes label id of a semantic group; the ids of each are contiguous.
    pub fn label_ids(self) -> Option<(u8, u8)> {
        match self {
            Self::Flat => Some((7, 10)),
            Self::Human => Some((24, 25)),
            Self::Vehicle => Some((26, 33)),
            Self::Construction => Some((11, 16)),
            Self::Object => Some((17, 20)),
            _ => None,
        }
    }

    /// True depth in metres of a group of distance: above the first number, up to the second,
    /// which is infinite for the last group.
    pub fn distance_m(self) -> Option<(f64, f64)> {
        let index = Self::DISTANCES.iter().position(|group| *group == self)?;
        let bounds = [
            0.0,
            5.0,
            10.0,
            15.0,
            20.0,
            30.0,
            40.0,
            50.0,
            60.0,
            80.0,
            f64::INFINITY,
        ];
        Some((bounds[index], bounds[index + 1]))
    }

    /// Group of a Cityscapes label id; void, nature and sky belong to none.
    pub fn of_label(id: u8) -> Option<Self> {
        Self::SEMANTIC.into_iter().find(|group| {
            group
                .label_ids()
                .is_some_and(|(first, last)| (first..=last).contains(&id))
        })
    }

    /// Group of a true depth in metres; none for zero and for what is not a number.
    pub fn of_depth(depth_m: f64) -> Option<Self> {
        Self::DISTANCES.into_iter().find(|group| {
            group
                .distance_m()
                .is_some_and(|(above, end)| depth_m > above && depth_m <= end)
        })
    }

    /// Lower-case name as it stands in `rows.csv`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Flat => "flat",
            Self::Human => "human",
            Self::Vehicle => "vehicle",
            Self::Construction => "construction",
            Self::Object => "object",
            Self::To5m => "0-5m",
            Self::To10m => "5-10m",
            Self::To15m => "10-15m",
            Self::To20m => "15-20m",
            Self::To30m => "20-30m",
            Self::To40m => "30-40m",
            Self::To50m => "40-50m",
            Self::To60m => "50-60m",
            Self::To80m => "60-80m",
            Self::Over80m => "over-80m",
        }
    }
}

impl Serialize for Group {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name())
    }
}

impl fmt::Display for Group {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// Text that is no [`Group`].
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "the groups are flat, human, vehicle, construction and object, and distances from 0-5m to \
     over-80m, not {0:?}"
)]
pub struct UnknownGroup(pub String);

impl FromStr for Group {
    type Err = UnknownGroup;

    fn from_str(text: &str) -> Result<Self, UnknownGroup> {
        Self::all()
            .find(|group| group.name() == text)
            .ok_or_else(|| UnknownGroup(text.to_owned()))
    }
}
