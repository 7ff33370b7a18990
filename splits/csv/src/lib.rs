//! CSV whose cells no spreadsheet runs, and the way back.
//!
//! A spreadsheet takes a cell that begins with `=`, `+`, `-`, `@`, a tab or a carriage return for a
//! formula, and formulas can send data away or start programs; names of models and images are other
//! people's. Such a cell is written with an apostrophe before it, as OWASP recommends ("CSV
//! Injection"), unless it is a number; reading takes the apostrophe off again, so that names stay
//! the same. All other bytes are those of the crate `csv`, which nothing else in the workspace
//! uses. Not here: what the columns are.

use std::borrow::Cow;
use std::io::{Read, Write};

use serde::Serialize;
use serde::de::DeserializeOwned;

pub use csv::{Error, Position, Result, StringRecord};

/// What makes text of a cell.
const GUARD: char = '\'';

/// Whether a spreadsheet would calculate with a cell, or could be led to by taking guards off.
fn is_formula(cell: &str) -> bool {
    let text = cell.trim_start_matches(GUARD);
    match text.bytes().next() {
        Some(b'=' | b'@' | b'\t' | b'\r') => true,
        // Of what is a number, nothing but its value can come.
        Some(b'+' | b'-') => text.len() < cell.len() || text.parse::<f64>().is_err(),
        _ => false,
    }
}

/// A cell as it is written.
pub fn guarded(cell: &str) -> Cow<'_, str> {
    match is_formula(cell) {
        true => Cow::Owned(format!("{GUARD}{cell}")),
        false => Cow::Borrowed(cell),
    }
}

/// The text of a cell as it was written: [`guarded`] undone.
pub fn unguarded(cell: &str) -> &str {
    match cell.strip_prefix(GUARD) {
        Some(text) if is_formula(text) => text,
        _ => cell,
    }
}

/// Writes tables.
#[derive(Debug)]
pub struct Writer<W: Write> {
    out: csv::Writer<W>,
    /// The names of the fields are still to be written.
    names_fields: bool,
}

impl<W: Write> Writer<W> {
    /// A table whose first serialized row is headed by the names of its fields.
    pub fn new(out: W) -> Self {
        Self {
            out: csv::Writer::from_writer(out),
            names_fields: true,
        }
    }

    /// Rows behind those that are there.
    pub fn appending(out: W) -> Self {
        Self {
            names_fields: false,
            ..Self::new(out)
        }
    }

    /// Writes a row of cells.
    ///
    /// # Errors
    /// It has another length than the first, or the writer fails.
    pub fn write_record<T: AsRef<str>>(
        &mut self,
        cells: impl IntoIterator<Item = T>,
    ) -> Result<()> {
        for cell in cells {
            self.out.write_field(guarded(cell.as_ref()).as_bytes())?;
        }
        self.out.write_record(None::<&[u8]>)
    }

    /// Writes a structure as a row.
    ///
    /// # Errors
    /// It is no flat structure, or as [`write_record`](Self::write_record).
    pub fn serialize(&mut self, row: impl Serialize) -> Result<()> {
        let mut rows = csv::WriterBuilder::new()
            .has_headers(self.names_fields)
            .from_writer(Vec::new());
        rows.serialize(row)?;
        let bytes = rows.into_inner().map_err(|error| error.into_error())?;
        self.names_fields = false;
        let rows = csv::ReaderBuilder::new()
            .has_headers(false)
            .from_reader(&*bytes)
            .into_records();
        for row in rows {
            self.write_record(&row?)?;
        }
        Ok(())
    }

    /// Hands on everything that was written.
    ///
    /// # Errors
    /// The writer fails.
    pub fn flush(&mut self) -> std::io::Result<()> {
        self.out.flush()
    }

    /// What was written to, with everything written.
    ///
    /// # Errors
    /// The writer fails.
    pub fn into_inner(self) -> std::io::Result<W> {
        self.out.into_inner().map_err(|error| error.into_error())
    }
}

/// Reads tables, with or without guards.
#[derive(Debug)]
pub struct Reader<R: Read>(csv::Reader<R>);

impl<R: Read> Reader<R> {
    /// A table headed by the names of its columns.
    pub fn new(input: R) -> Self {
        Self(csv::Reader::from_reader(input))
    }

    /// A table without a header.
    pub fn without_header(input: R) -> Self {
        let mut builder = csv::ReaderBuilder::new();
        Self(builder.has_headers(false).from_reader(input))
    }

    /// A table of which rows may be of different lengths.
    pub fn flexible(input: R) -> Self {
        Self(csv::ReaderBuilder::new().flexible(true).from_reader(input))
    }

    /// The names of the columns.
    ///
    /// # Errors
    /// The reader fails, or it is not text.
    pub fn headers(&mut self) -> Result<&StringRecord> {
        self.0.headers()
    }

    /// The rows.
    pub fn records(&mut self) -> impl Iterator<Item = Result<StringRecord>> {
        self.0.records().map(|row| Ok(as_written(row?)))
    }

    /// The rows as structures of the names of the columns.
    ///
    /// # Errors
    /// A row does not fit; the message names it.
    pub fn deserialize<T: DeserializeOwned>(&mut self) -> Result<Vec<T>> {
        let header = match self.0.has_headers() {
            true => Some(self.0.headers()?.clone()),
            false => None,
        };
        self.records()
            .map(|row| row?.deserialize(header.as_ref()))
            .collect()
    }
}

fn as_written(row: StringRecord) -> StringRecord {
    if row.iter().all(|cell| unguarded(cell).len() == cell.len()) {
        return row;
    }
    let mut cells: StringRecord = row.iter().map(unguarded).collect();
    cells.set_position(row.position().cloned());
    cells
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use serde::Deserialize;

    use super::*;

    #[test]
    fn formulas_become_text_and_nothing_else_changes() {
        for (cell, written) in [
            ("=1+1", "'=1+1"),
            ("@SUM(A1)", "'@SUM(A1)"),
            ("+cmd|' /C calc'!A0", "'+cmd|' /C calc'!A0"),
            ("-2+3", "'-2+3"),
            ("\tx", "'\tx"),
            ("\r", "'\r"),
            ("-", "'-"),
            ("'=x", "''=x"),
            ("-0.5", "-0.5"),
            ("+1e-7", "+1e-7"),
            ("-inf", "-inf"),
            ("'-0.5", "''-0.5"),
            ("StrAT", "StrAT"),
            ("'quoted'", "'quoted'"),
            ("a=b", "a=b"),
            ("", ""),
        ] {
            assert_eq!(guarded(cell), written);
            assert_eq!(unguarded(written), cell);
        }
    }

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    struct Row {
        name: String,
        value: Option<f64>,
    }

    #[test]
    fn structures_come_back() {
        let row = |name: &str, value| Row {
            name: name.to_owned(),
            value,
        };
        let rows = [row("=HYPERLINK(\"x\")", Some(-1.5)), row("a, b", None)];
        let mut table = Writer::new(Vec::new());
        rows.iter().for_each(|row| table.serialize(row).unwrap());
        let bytes = table.into_inner().unwrap();
        let text = "name,value\n\"'=HYPERLINK(\"\"x\"\")\",-1.5\n\"a, b\",\n";
        assert_eq!(String::from_utf8(bytes.clone()).unwrap(), text);
        assert_eq!(Reader::new(&*bytes).deserialize::<Row>().unwrap(), rows);
        // What a spreadsheet or an earlier version has written is read as it stands.
        let bare = Reader::new(&b"name,value\n=1,2\n"[..]).deserialize::<Row>();
        assert_eq!(bare.unwrap(), [row("=1", Some(2.0))]);
    }

    fn cells() -> impl Strategy<Value = Vec<String>> {
        let cell = prop_oneof!["['=+@\t\r0-9,\"\n.e-]{0,5}", "\\PC{0,6}"];
        proptest::collection::vec(cell, 1..5)
    }

    proptest! {
        #[test]
        fn any_cells_come_back_and_none_is_a_formula(cells in cells()) {
            let mut table = Writer::new(Vec::new());
            table.write_record(&cells).unwrap();
            table.write_record(&cells).unwrap();
            let bytes = table.into_inner().unwrap();
            let mut plain = csv::ReaderBuilder::new().has_headers(false).from_reader(&*bytes);
            for cell in plain.records().next().unwrap().unwrap().iter() {
                let starts = cell.starts_with(['=', '@', '\t', '\r']);
                let signed = cell.starts_with(['+', '-']) && cell.parse::<f64>().is_err();
                prop_assert!(!starts && !signed, "{cell:?}");
            }
            let mut read = Reader::without_header(&*bytes);
            let rows: Vec<Vec<String>> = read
                .records()
                .map(|row| row.unwrap().iter().map(str::to_owned).collect())
                .collect();
            prop_assert_eq!(rows, vec![cells.clone(), cells]);
        }

        #[test]
        fn without_formulas_the_bytes_are_those_of_plain_csv(cells in proptest::collection::vec("[a-z0-9 ,\"']{0,5}", 1..5)) {
            let mut table = Writer::new(Vec::new());
            table.write_record(&cells).unwrap();
            let mut plain = csv::Writer::from_writer(Vec::new());
            plain.write_record(&cells).unwrap();
            prop_assert_eq!(table.into_inner().unwrap(), plain.into_inner().unwrap());
        }
    }
}
