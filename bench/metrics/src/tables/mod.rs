//! Thesis tables 3.1, 3.2 and 3.3, and those of Make3D and of newer models, with measured models beside
//! the published rows.
//!
//! A [`Table`] is a pure function of rows, of the published figures and of a [`Coverage`]; its
//! first line says how many of how many images stand behind it, under which protocol and on
//! which data. What is measured and what is published is written on every line.
//!
//! The best figure of a column is marked among comparable rows only: published rows under the
//! table's crop that are not printed in grey, and measured rows that cover all images of the
//! real data set under the table's own protocol. Figures are compared as printed, to three
//! decimals, so ties are all marked.
//!
//! Models called `NAME@SEED` are seeds of one method: from two of them on, tables 3.1 and 3.3
//! give them one line with mean and sample standard deviation over the seeds' figures. Table 3.2
//! keeps a column for each. The notes have the interval of each seed. [`mod@ablation`] has the variants
//! of a study alone.
//!
//! `table` holds the cells, `methods`, `groups` and `ablation` fill them, `notes` writes the sentences around
//! them; `terminal`, `latex` and `render` (Markdown, CSV) write them. Measured lines come before published
//! ones. Not here: which tables a prepared set can fill, and files.

mod ablation;
mod coverage;
mod error;
mod groups;
mod latex;
mod methods;
mod notes;
mod part;
mod render;
mod table;
mod terminal;
#[cfg(test)]
mod tests;

pub use self::ablation::ablation;
pub use self::coverage::{Coverage, Source};
pub use self::error::TableError;
pub use self::latex::REFERENCES;
pub use self::table::{Cell, Column, Line, Section, Shown, Table};
pub use self::terminal::FILE_WIDTH;
pub use crate::thesis::{ThesisTable, UnknownTable};

use self::notes::{first_line, measured_notes, remarks};
use self::part::{Part, one_data_set};
use crate::rows::Row;

/// Builds a table of all models among the rows, in the order of their first row.
///
/// # Errors
/// Rows that cannot stand in one table; see [`TableError`].
pub fn build(table: ThesisTable, rows: &[Row], coverage: &Coverage) -> Result<Table, TableError> {
    build_with(table, table.protocols(), rows, coverage)
}

/// Like [`build`], but under other protocols than the table's own, one per section, for
/// example `eigen-cameraz-80` and `eigen-cameraz-50`. Published rows are shown, but nothing is
/// compared across protocols.
///
/// # Errors
/// As for [`build`], and if the number of protocols is not that of the sections.
pub fn build_with(
    table: ThesisTable,
    protocols: &[&str],
    rows: &[Row],
    coverage: &Coverage,
) -> Result<Table, TableError> {
    let own = table.protocols();
    if protocols.len() != own.len() {
        return Err(TableError::Sections {
            table,
            expected: own.len(),
            found: protocols.len(),
        });
    }
    let parts: Vec<Part<'_>> = protocols
        .iter()
        .zip(own)
        .map(|(protocol, own)| Part::new(protocol, own, rows, coverage))
        .collect::<Result<_, _>>()?;
    one_data_set(&parts)?;

    let mut built = Table {
        id: table,
        ablation: false,
        first_line: first_line(table, &parts, coverage),
        remarks: remarks(table, &parts, coverage),
        columns: Vec::new(),
        sections: Vec::new(),
        notes: Vec::new(),
        has_further: false,
        resampled: parts
            .iter()
            .flat_map(|part| &part.models)
            .find(|model| model.summary.intervals.is_some())
            .map(|model| model.summary.clusters.to_string()),
    };
    if table == ThesisTable::Table32 {
        built.fill_groups(&parts[0], coverage);
    } else {
        built.fill_methods(&parts, coverage);
    }
    for part in &parts {
        for model in &part.models {
            built.notes.extend(measured_notes(&part.protocol, model));
        }
    }
    Ok(built)
}
