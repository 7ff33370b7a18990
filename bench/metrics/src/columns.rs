//! CSV with a fixed set of named columns: what `rows.csv` and leaderboard files share.
//!
//! Columns are found by name, so their order is free; a missing, doubled or unknown column is
//! an error (a few may be left out, where no line has anything in them), and every complaint about a value names its line and column.

use std::collections::BTreeMap;
use std::fmt::Display;
use std::io::Read;
use std::str::FromStr;

/// Why a CSV text could not be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CsvError {
    /// Not CSV, or the reader failed.
    #[error("the CSV cannot be read: {0}")]
    Csv(#[from] strat_csv::Error),
    /// The writer failed.
    #[error("the CSV cannot be written: {0}")]
    Write(#[from] std::io::Error),
    /// A column is not there.
    #[error("line 1 has no column {column:?}; the columns are {expected}")]
    MissingColumn {
        /// Its name.
        column: &'static str,
        /// All names.
        expected: String,
    },
    /// A column that should not be there.
    #[error(
        "line 1 has the column {column:?}, which is unknown or occurs twice; the columns are {expected}"
    )]
    UnknownColumn {
        /// Its name.
        column: String,
        /// All names.
        expected: String,
    },
    /// A value that cannot stand in its column.
    #[error("line {line}, column {column:?}: {value:?} is not {expected}")]
    Value {
        /// Line in the file, from 1.
        line: u64,
        /// Name of the column.
        column: &'static str,
        /// What stands there.
        value: String,
        /// What should stand there.
        expected: &'static str,
    },
    /// Lines of two definitions of one protocol.
    #[error(
        "{methods} were measured under two definitions of {protocol} (digests \
         {digests}) and cannot stand in one file; measure again with \
         one version, or give one of the protocols another name"
    )]
    Definition {
        /// Name of the protocol.
        protocol: String,
        /// Two methods.
        methods: String,
        /// Their digests.
        digests: String,
    },
    /// Two lines about one thing that differ.
    #[error(
        "{what} occurs twice with different contents ({difference}); the files were not made by \
         the same run, so decide which one is right and leave the other out"
    )]
    Conflict {
        /// Model, protocol and image.
        what: String,
        /// First column that differs, with both values.
        difference: String,
    },
}

/// Reads all records of a text whose header is a permutation of `names`, of which the `optional` ones
/// may be missing: their cells are empty.
pub(crate) fn read<T>(
    reader: impl Read,
    names: &[&'static str],
    optional: &[&'static str],
    parse: impl Fn(&Fields<'_>) -> Result<T, CsvError>,
) -> Result<Vec<T>, CsvError> {
    let mut csv = strat_csv::Reader::new(reader);
    let expected = || names.join(", ");
    let mut indices = BTreeMap::new();
    for (index, name) in csv.headers()?.iter().enumerate() {
        // A spreadsheet may have put a byte order mark in front.
        let name = name.trim_start_matches('\u{feff}');
        match names.iter().find(|known| **known == name) {
            Some(known) if indices.insert(*known, index).is_none() => {}
            _ => {
                return Err(CsvError::UnknownColumn {
                    column: name.to_owned(),
                    expected: expected(),
                });
            }
        }
    }
    let is_missing = |name: &&&str| !indices.contains_key(**name) && !optional.contains(*name);
    if let Some(column) = names.iter().find(is_missing) {
        return Err(CsvError::MissingColumn {
            column,
            expected: expected(),
        });
    }
    let mut items = Vec::new();
    for record in csv.records() {
        let record = record?;
        let line = record.position().map_or(0, strat_csv::Position::line);
        items.push(parse(&Fields {
            record: &record,
            indices: &indices,
            line,
        })?);
    }
    Ok(items)
}

/// One record with its columns by name.
pub(crate) struct Fields<'a> {
    record: &'a strat_csv::StringRecord,
    indices: &'a BTreeMap<&'static str, usize>,
    line: u64,
}

impl Fields<'_> {
    fn raw(&self, column: &'static str) -> &str {
        self.indices
            .get(column)
            .and_then(|index| self.record.get(*index))
            .unwrap_or("")
    }

    pub(crate) fn error(&self, column: &'static str, expected: &'static str) -> CsvError {
        CsvError::Value {
            line: self.line,
            column,
            value: self.raw(column).to_owned(),
            expected,
        }
    }

    /// Text, possibly empty.
    pub(crate) fn text(&self, column: &'static str) -> String {
        self.raw(column).to_owned()
    }

    /// Text, or nothing where the cell is empty.
    pub(crate) fn optional_text(&self, column: &'static str) -> Option<String> {
        Some(self.text(column)).filter(|text| !text.is_empty())
    }

    /// Text that must be there.
    pub(crate) fn required(&self, column: &'static str) -> Result<String, CsvError> {
        if self.raw(column).is_empty() {
            return Err(self.error(column, "a text, which must not be empty"));
        }
        Ok(self.text(column))
    }

    /// A value, or nothing where the cell is empty.
    pub(crate) fn optional<T: FromStr>(
        &self,
        column: &'static str,
        expected: &'static str,
    ) -> Result<Option<T>, CsvError> {
        if self.raw(column).is_empty() {
            return Ok(None);
        }
        self.value(column, expected).map(Some)
    }

    pub(crate) fn value<T: FromStr>(
        &self,
        column: &'static str,
        expected: &'static str,
    ) -> Result<T, CsvError> {
        self.raw(column)
            .parse()
            .map_err(|_| self.error(column, expected))
    }

    /// A finite number from 0 up: metrics and sums of squares.
    pub(crate) fn measure(&self, column: &'static str) -> Result<f64, CsvError> {
        self.optional_measure(column)?
            .ok_or_else(|| self.error(column, MEASURE))
    }

    /// The same, or nothing where the cell is empty.
    pub(crate) fn optional_measure(&self, column: &'static str) -> Result<Option<f64>, CsvError> {
        match self.optional::<f64>(column, MEASURE)? {
            Some(value) if !(value.is_finite() && value >= 0.0) => Err(self.error(column, MEASURE)),
            value => Ok(value),
        }
    }

    /// Numbers that stand together or not at all, from 0 up.
    pub(crate) fn measures<const N: usize>(
        &self,
        columns: [&'static str; N],
    ) -> Result<Option<[f64; N]>, CsvError> {
        self.together(columns, |column| self.measure(column))
    }

    /// Finite numbers that stand together or not at all.
    pub(crate) fn numbers<const N: usize>(
        &self,
        columns: [&'static str; N],
    ) -> Result<Option<[f64; N]>, CsvError> {
        self.together(columns, |column| {
            match self.value::<f64>(column, "a finite number")? {
                value if value.is_finite() => Ok(value),
                _ => Err(self.error(column, "a finite number")),
            }
        })
    }

    fn together<const N: usize>(
        &self,
        columns: [&'static str; N],
        value: impl Fn(&'static str) -> Result<f64, CsvError>,
    ) -> Result<Option<[f64; N]>, CsvError> {
        if columns.iter().all(|column| self.raw(column).is_empty()) {
            return Ok(None);
        }
        let mut values = [0.0; N];
        for (found, column) in values.iter_mut().zip(columns) {
            *found = value(column)?;
        }
        Ok(Some(values))
    }
}

const MEASURE: &str = "a finite number from 0 up";

/// Cell of something that may be absent.
pub(crate) fn cell(value: Option<impl Display>) -> String {
    value.map(|value| value.to_string()).unwrap_or_default()
}

/// First column in which two records differ, with both values.
pub(crate) fn difference(names: &[&str], a: &[String], b: &[String]) -> Option<String> {
    names
        .iter()
        .zip(a.iter().zip(b))
        .find(|(_, (a, b))| a != b)
        .map(|(name, (a, b))| format!("{name}: {a:?} and {b:?}"))
}
