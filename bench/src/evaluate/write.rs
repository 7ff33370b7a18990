//! The files of a run: `rows.csv`, `leaderboard.csv`, the tables in four formats, `failures.csv`
//! and `run.yaml`.
//!
//! The contents of tables are [`strat_metrics::tables`]'s: a pure function of rows.

use std::path::Path;

use strat_metrics::{
    Alignment, FurtherMetric, Metric, Row, Suffix, leaderboard,
    published::PublishedRow,
    rows,
    tables::{self, Coverage, Shown, Source, Table, TableError, ThesisTable},
};
use strat_store::{files, yaml};

use super::agreed;
use super::ownership::{self, MARK};
use super::record::{FAILURES, Failure, LEADERBOARD, Outcome, ROWS};

/// Why results could not be written.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// A file could not be written.
    #[error(transparent)]
    Store(#[from] strat_store::Error),
    /// The rows do not make a table.
    #[error(transparent)]
    Table(#[from] TableError),
    /// The rows do not make a leaderboard.
    #[error(transparent)]
    Rows(#[from] rows::RowsError),
    /// CSV could not be formed.
    #[error(transparent)]
    Csv(#[from] strat_metrics::CsvError),
}

impl Outcome {
    /// Writes `rows.csv`, `failures.csv`, for a part `agreements.csv`, and, last, `run.yaml`; no `rows.csv`
    /// without rows.
    ///
    /// # Errors
    /// A file cannot be written.
    pub fn write(&self, out: &Path) -> Result<(), WriteError> {
        let mut bytes = Vec::new();
        rows::write(&self.rows, &mut bytes)?;
        let text = yaml::to_string(&self.record)?;
        MARK.reopen(out)?;
        if self.rows.is_empty() {
            files::remove(&out.join(ROWS))?;
        } else {
            files::write_atomic(&out.join(ROWS), &bytes)?;
        }
        write_failures(out, &self.failures)?;
        if self.record.shard.is_some() {
            agreed::write(out, &self.agreed)?;
        }
        Ok(MARK.finish(out, text.as_bytes())?)
    }
}

/// How tables are shown; CSV always has all rows.
#[derive(Clone, Debug, Default)]
pub struct Look {
    /// Which rows.
    pub shown: Shown,
    /// Published numbers of the user's own.
    pub published: Vec<PublishedRow>,
}

/// Tables, and what was measured that none of them shows.
#[derive(Debug)]
pub struct Tables {
    /// The tables.
    pub tables: Vec<Table>,
    /// See [`beside_tables`].
    pub beside: String,
}

impl Tables {
    /// All of it in the words of `form`.
    pub fn joined(&self, form: impl Fn(&Table) -> String) -> String {
        let mut texts: Vec<String> = self.tables.iter().map(form).collect();
        texts.extend(Some(self.beside.clone()).filter(|text| !text.is_empty()));
        texts.join("\n")
    }
}

/// Writes all that follows from the rows of a whole run, leaderboard and tables, and returns the tables.
///
/// # Errors
/// The rows do not fit together, or a file cannot be written.
pub fn derived(
    outcome: &Outcome,
    out: &Path,
    wanted: &[ThesisTable],
    look: &Look,
) -> Result<Tables, WriteError> {
    ownership::remove_tables(out)?;
    let (coverage, rows) = (coverage(outcome), &outcome.rows);
    let entries = write_leaderboard(out, rows, coverage.expected_images)?;
    Ok(Tables {
        tables: write_tables(out, wanted, rows, &coverage, look)?,
        beside: beside_tables(&entries, wanted),
    })
}

/// What [`derived`] returns as text, without a file.
///
/// # Errors
/// The rows do not fit together.
pub fn text(outcome: &Outcome, wanted: &[ThesisTable]) -> Result<String, WriteError> {
    let (coverage, rows) = (coverage(outcome), &outcome.rows);
    let entries = leaderboard_of(rows, coverage.expected_images)?;
    let tables = tables_of(wanted, rows, &coverage)?;
    let tables = Tables {
        tables: tables.into_iter().map(|(_, table)| table).collect(),
        beside: beside_tables(&entries, wanted),
    };
    Ok(tables.joined(Table::text))
}

/// What the rows of a run are part of.
#[must_use]
pub fn coverage(outcome: &Outcome) -> Coverage {
    let data = &outcome.record.data;
    Coverage {
        expected_images: data.test_images_expected,
        source: Source::from(data.source.as_str()),
    }
}

/// Writes the tables in four formats, with the references of the LaTeX one, and returns them for printing.
///
/// # Errors
/// The rows do not fit together, or a file cannot be written.
pub fn write_tables(
    out: &Path,
    tables: &[ThesisTable],
    rows: &[Row],
    coverage: &Coverage,
    look: &Look,
) -> Result<Vec<Table>, WriteError> {
    let mut written = Vec::new();
    for (stem, table) in tables_of(tables, rows, coverage)? {
        let all = table.with_published(&look.published);
        let table = all.clone().only(&look.shown);
        for (extension, text) in [
            ("txt", table.text()),
            ("md", table.markdown()),
            ("tex", table.latex()),
            ("csv", all.csv()?),
        ] {
            let path = out.join(format!("{stem}.{extension}"));
            files::write_atomic(&path, text.as_bytes())?;
        }
        written.push(table);
    }
    files::write_atomic(
        &out.join("table_references.bib"),
        tables::REFERENCES.as_bytes(),
    )?;
    Ok(written)
}

/// The tables, each with the name of its file without extension.
///
/// Models that were aligned with the ground truth stand in tables of their own (`-median`,
/// `-affine-disparity` and so on), since their figures are not comparable with the others'.
///
/// # Errors
/// The rows do not fit together.
pub fn tables_of(
    tables: &[ThesisTable],
    rows: &[Row],
    coverage: &Coverage,
) -> Result<Vec<(String, Table)>, TableError> {
    let mut made = Vec::new();
    for &id in tables {
        let any = |names: &[String]| rows.iter().any(|row| names.contains(&row.context.protocol));
        let mut alignments: Vec<Alignment> = Alignment::ALL
            .into_iter()
            .filter(|alignment| any(&id.protocols_at(*alignment)))
            .collect();
        if alignments.is_empty() {
            alignments.push(Alignment::None);
        }
        for alignment in alignments {
            let protocols = id.protocols_at(alignment);
            let stem = format!(
                "table_{}{}",
                id.to_string().replace(['.', '-'], "_"),
                Suffix::of_alignment(alignment).map_or("", Suffix::as_str)
            );
            let protocols: Vec<&str> = protocols.iter().map(String::as_str).collect();
            made.push((stem, tables::build_with(id, &protocols, rows, coverage)?));
        }
    }
    Ok(made)
}

/// Writes `leaderboard.csv` with the lines of [`leaderboard_of`].
///
/// # Errors
/// The rows do not fit together, or the file cannot be written.
pub fn write_leaderboard(
    out: &Path,
    rows: &[Row],
    expected_images: u64,
) -> Result<Vec<leaderboard::Entry>, WriteError> {
    let entries = leaderboard_of(rows, expected_images)?;
    let mut bytes = Vec::new();
    leaderboard::write(&entries, &mut bytes)?;
    files::write_atomic(&out.join(LEADERBOARD), &bytes)?;
    Ok(entries)
}

/// The lines of a leaderboard: the measured ones and the published ones of the same protocols.
///
/// # Errors
/// The rows do not fit together.
pub fn leaderboard_of(
    rows: &[Row],
    expected_images: u64,
) -> Result<Vec<leaderboard::Entry>, WriteError> {
    let mut protocols: Vec<&str> = Vec::new();
    for row in rows {
        let name = row.context.protocol.as_str();
        if !protocols.contains(&name) {
            protocols.push(name);
        }
    }
    let mut entries = Vec::new();
    for name in &protocols {
        entries.extend(leaderboard::measured(rows, name, expected_images)?);
    }
    entries.extend(
        leaderboard::published()
            .into_iter()
            .filter(|entry| protocols.contains(&entry.protocol.as_str())),
    );
    Ok(leaderboard::merge([entries])?)
}

/// Measured lines under protocols that none of the tables shows, as text; empty if there are none.
/// Distances of one model share a line, with Abs Rel alone.
#[must_use]
pub fn beside_tables(entries: &[leaderboard::Entry], tables: &[ThesisTable]) -> String {
    let mut text = String::new();
    let mut by_distance: Vec<((&str, &str), String)> = Vec::new();
    for entry in entries {
        let shown = ThesisTable::showing(&entry.protocol);
        if entry.origin != leaderboard::Origin::Measured
            || shown.is_some_and(|(table, _)| tables.contains(&table))
        {
            continue;
        }
        if let (Some(group), [Some(abs_rel), ..]) = (
            entry.group.filter(|group| group.distance_m().is_some()),
            &entry.metrics,
        ) {
            let key = (entry.method.as_str(), entry.protocol.as_str());
            let figure = format!(" {group} {abs_rel:.3}");
            match by_distance.iter_mut().find(|(known, _)| *known == key) {
                Some((_, figures)) => *figures += &figure,
                None => by_distance.push((key, figure)),
            }
            continue;
        }
        let group = entry
            .group
            .map_or(String::new(), |group| format!(", {group}"));
        let images = entry.images.unwrap_or_default();
        text += &format!(
            "{} under {}{group}, {images} of {} images:",
            entry.method,
            entry.protocol,
            entry.expected_images.unwrap_or(images)
        );
        let seven = Metric::ALL.map(Metric::heading).into_iter();
        let seven = seven.zip(entry.metrics.iter().zip(&entry.intervals));
        let further = FurtherMetric::ALL.map(FurtherMetric::heading).into_iter();
        let further = further.zip(entry.further.iter().zip(&entry.further_intervals));
        for (heading, (mean, interval)) in seven.chain(further) {
            let Some(mean) = mean else { continue };
            text += &format!(" {heading} {mean:.3}");
            if let Some(interval) = interval {
                text += &format!(" ({:.3} to {:.3})", interval.low, interval.high);
            }
        }
        text.push('\n');
    }
    for ((method, protocol), figures) in by_distance {
        text += &format!("{method} under {protocol}, Abs Rel by true depth:{figures}\n");
    }
    text
}

/// Writes `failures.csv`, or removes that of an earlier run when nothing failed.
fn write_failures(out: &Path, failures: &[Failure]) -> Result<(), strat_store::Error> {
    let path = out.join(FAILURES);
    if failures.is_empty() {
        files::remove(&path)
    } else {
        files::write_csv(&path, failures)
    }
}
