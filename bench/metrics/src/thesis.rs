//! The tables of the thesis that are filled here.

use std::fmt;
use std::str::FromStr;

/// A table of the thesis, or the one that belongs beside its figure 3.6.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum ThesisTable {
    /// KITTI split.
    Table31,
    /// Errors by what pixels show.
    Table32,
    /// Eigen split, 80 m above and 50 m below.
    Table33,
    /// Make3D, of which the thesis shows pictures only (figure 3.6; PROTOCOL 1.4).
    Make3d,
}

impl ThesisTable {
    /// All tables.
    pub const ALL: [Self; 4] = [Self::Table31, Self::Table32, Self::Table33, Self::Make3d];

    /// Names of the protocols behind the table, section by section.
    pub fn protocols(self) -> &'static [&'static str] {
        match self {
            Self::Table31 => &["kitti2015"],
            Self::Table32 => &["semantic"],
            Self::Table33 => &["eigen-80", "eigen-50"],
            Self::Make3d => &["make3d-c1"],
        }
    }

    pub(crate) fn subject(self) -> &'static str {
        match self {
            Self::Table31 => "KITTI split",
            Self::Table32 => "RMSE in metres by semantic group",
            Self::Table33 => "Eigen split",
            Self::Make3d => "beside figure 3.6",
        }
    }
}

impl fmt::Display for ThesisTable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Table31 => "3.1",
            Self::Table32 => "3.2",
            Self::Table33 => "3.3",
            Self::Make3d => "make3d",
        })
    }
}

impl FromStr for ThesisTable {
    type Err = UnknownTable;

    fn from_str(text: &str) -> Result<Self, UnknownTable> {
        Self::ALL
            .into_iter()
            .find(|table| table.to_string() == text)
            .ok_or_else(|| UnknownTable(text.to_owned()))
    }
}

/// Text that is no [`ThesisTable`].
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("there is no table {0:?}; the tables are 3.1, 3.2, 3.3 and make3d")]
pub struct UnknownTable(pub String);
