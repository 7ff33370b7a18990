//! The tables of the thesis that are filled here.

use std::fmt;
use std::str::FromStr;

use crate::protocol::{ProtocolName, Suffix};

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

    /// The same with the scale set by medians; empty where it always is.
    #[must_use]
    pub fn protocols_at(self, scale: Scale) -> Vec<String> {
        let own = self
            .protocols()
            .iter()
            .map(|name| ProtocolName::parse(name));
        match scale {
            Scale::Own => own.map(|name| name.to_string()).collect(),
            Scale::Median if self == Self::Make3d => Vec::new(),
            Scale::Median => own
                .map(|name| name.with(Suffix::Median).to_string())
                .collect(),
        }
    }

    /// The table that shows figures under a protocol, and at which scale.
    #[must_use]
    pub fn showing(protocol: &str) -> Option<(Self, Scale)> {
        let name = ProtocolName::parse(protocol);
        let scale = if name.has(Suffix::Median) {
            Scale::Median
        } else {
            Scale::Own
        };
        let own = name.without(Suffix::Median).to_string();
        let table = Self::ALL
            .into_iter()
            .find(|table| table.protocols().contains(&own.as_str()))?;
        Some((table, scale))
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

/// Where the scale of a table's figures comes from. Figures of the two are never compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Scale {
    /// The model's own, or what the protocol says without a suffix.
    Own,
    /// Medians of the ground truth, for models of unknown scale.
    Median,
}

impl Scale {
    /// Both.
    pub const ALL: [Self; 2] = [Self::Own, Self::Median];

    /// What the names of protocols and files then end in.
    #[must_use]
    pub fn suffix(self) -> &'static str {
        match self {
            Self::Own => "",
            Self::Median => Suffix::Median.as_str(),
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_know_their_protocols_at_both_scales() {
        let scaled = ThesisTable::Table33.protocols_at(Scale::Median);
        assert_eq!(scaled, ["eigen-80-median", "eigen-50-median"]);
        assert!(ThesisTable::Make3d.protocols_at(Scale::Median).is_empty());
        for table in ThesisTable::ALL {
            for scale in Scale::ALL {
                for name in table.protocols_at(scale) {
                    assert_eq!(ThesisTable::showing(&name), Some((table, scale)), "{name}");
                    assert!(crate::protocol(&name).is_some(), "{name}");
                }
            }
        }
        for other in [
            "eigen-80-pp",
            "eigen-80-distance-median",
            "eigen-60",
            "mine-median",
        ] {
            assert_eq!(ThesisTable::showing(other), None, "{other}");
        }
    }
}
