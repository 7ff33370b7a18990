//! The tables of the thesis that are filled here.

use std::fmt;
use std::str::FromStr;

use crate::protocol::{Alignment, ProtocolName, Suffix};

/// A table of the thesis, the one that belongs beside its figure 3.6, or the one of newer models.
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
    /// Eigen split with improved ground truth, 652 images: models with and without a scale under the
    /// rules of their own papers (PROTOCOL 10.4).
    Eigen652,
}

impl ThesisTable {
    /// All tables.
    pub const ALL: [Self; 5] = [
        Self::Table31,
        Self::Table32,
        Self::Table33,
        Self::Make3d,
        Self::Eigen652,
    ];

    /// Names of the protocols behind the table, section by section.
    pub fn protocols(self) -> &'static [&'static str] {
        match self {
            Self::Table31 => &["kitti2015"],
            Self::Table32 => &["semantic"],
            Self::Table33 => &["eigen-80", "eigen-50"],
            Self::Make3d => &["make3d-c1"],
            Self::Eigen652 => &[
                "eigen-improved-garg",
                "eigen-kb-garg",
                "eigen-affine-disparity",
                "eigen-affine-depth",
            ],
        }
    }

    /// The same with an alignment; empty for tables whose protocols say themselves how they align.
    #[must_use]
    pub fn protocols_at(self, alignment: Alignment) -> Vec<String> {
        let own = self
            .protocols()
            .iter()
            .map(|name| ProtocolName::parse(name));
        match Suffix::of_alignment(alignment) {
            None => own.map(|name| name.to_string()).collect(),
            Some(_) if matches!(self, Self::Make3d | Self::Eigen652) => Vec::new(),
            Some(suffix) => own.map(|name| name.with(suffix).to_string()).collect(),
        }
    }

    /// The table that shows figures under a protocol, and with which alignment beside its own.
    #[must_use]
    pub fn showing(protocol: &str) -> Option<(Self, Alignment)> {
        let all = Self::ALL.into_iter();
        all.flat_map(|table| Alignment::ALL.map(|alignment| (table, alignment)))
            .find(|(table, alignment)| {
                let names = table.protocols_at(*alignment);
                let canonical = ProtocolName::parse(protocol).to_string();
                names.contains(&canonical)
            })
    }

    pub(crate) fn subject(self) -> &'static str {
        match self {
            Self::Table31 => "KITTI split",
            Self::Table32 => "RMSE in metres by semantic group",
            Self::Table33 => "Eigen split",
            Self::Make3d => "beside figure 3.6",
            Self::Eigen652 => "Eigen split, improved ground truth",
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
            Self::Eigen652 => "eigen-652",
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
#[error("unknown table {0:?}; the tables are 3.1, 3.2, 3.3, make3d and eigen-652")]
pub struct UnknownTable(pub String);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_know_their_protocols_with_every_alignment() {
        let scaled = ThesisTable::Table33.protocols_at(Alignment::Median);
        assert_eq!(scaled, ["eigen-80-median", "eigen-50-median"]);
        let affine = ThesisTable::Table31.protocols_at(Alignment::AffineDisparity);
        assert_eq!(affine, ["kitti2015-affine-disparity"]);
        assert!(
            ThesisTable::Make3d
                .protocols_at(Alignment::Median)
                .is_empty()
        );
        for table in ThesisTable::ALL {
            for alignment in Alignment::ALL {
                for name in table.protocols_at(alignment) {
                    assert_eq!(
                        ThesisTable::showing(&name),
                        Some((table, alignment)),
                        "{name}"
                    );
                    assert!(crate::protocol(&name).is_some(), "{name}");
                }
            }
        }
        for other in [
            "eigen-80-pp",
            "eigen-80-distance-median",
            "eigen-60",
            "mine-median",
            "make3d-c1-affine-depth",
        ] {
            assert_eq!(ThesisTable::showing(other), None, "{other}");
        }
    }
}
