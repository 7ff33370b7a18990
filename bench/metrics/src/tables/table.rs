//! A table of cells, whatever it is about: what the four formats are written from.

use crate::published::Marker;
use crate::statistics::Interval;
use crate::thesis::ThesisTable;

/// A table ready to be written in one of four formats.
#[derive(Clone, Debug)]
pub struct Table {
    pub(super) id: ThesisTable,
    /// It compares measured variants with each other; nothing published stands beside them.
    pub(super) ablation: bool,
    pub(super) first_line: String,
    pub(super) remarks: Vec<String>,
    pub(super) columns: Vec<Column>,
    pub(super) sections: Vec<Section>,
    pub(super) notes: Vec<String>,
}

/// A column of a [`Table`].
#[derive(Clone, Debug)]
pub struct Column {
    /// Name in CSV files.
    pub key: String,
    /// Name for readers.
    pub heading: String,
    /// Heading in LaTeX where it is not the plain one.
    pub(super) latex: Option<&'static str>,
    /// Holds figures.
    pub numeric: bool,
}

/// Lines under one protocol.
#[derive(Clone, Debug)]
pub struct Section {
    /// What sets the section apart, where the table has several.
    pub heading: Option<String>,
    /// Protocol of the measured figures.
    pub protocol: String,
    pub(super) protocol_digest: String,
    pub(super) data_digest: String,
    pub(super) expected_images: u64,
    /// The lines in the order of the table.
    pub lines: Vec<Line>,
}

/// A line of a [`Section`].
#[derive(Clone, Debug, Default)]
pub struct Line {
    /// Belongs to the protocol and data of its section; published lines do not.
    pub measured: bool,
    /// Printed in grey in the thesis.
    pub grey: bool,
    pub(super) comparable: bool,
    /// A cell for each column.
    pub cells: Vec<Cell>,
}

/// A cell of a [`Line`].
#[derive(Clone, Debug, Default)]
pub struct Cell {
    /// What is printed, without marks.
    pub text: String,
    /// The mark of the thesis beside it.
    pub marker: Option<Marker>,
    /// The exact figure, which CSV shows in place of the text.
    pub value: Option<f64>,
    /// 95 % interval of a measured figure.
    pub interval: Option<Interval>,
    /// The best of its column among comparable lines.
    pub best: bool,
}

impl Cell {
    pub(super) fn text(text: impl Into<String>) -> Self {
        Self {
            text: text.into(),
            ..Self::default()
        }
    }

    pub(super) fn figure(value: Option<f64>) -> Self {
        Self {
            text: value.map_or_else(|| "-".to_owned(), |value| format!("{value:.3}")),
            value,
            ..Self::default()
        }
    }

    /// Mean and sample standard deviation over seeds.
    pub(super) fn spread(values: &[f64]) -> Self {
        let count = values.len() as f64;
        let mean = values.iter().sum::<f64>() / count;
        let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
        let deviation = (squares / (count - 1.0)).sqrt();
        Self {
            text: format!("{mean:.3} ± {deviation:.3}"),
            value: Some(mean),
            ..Self::default()
        }
    }

    /// The figure as printed, so that figures that look alike are alike; of a spread the mean.
    pub(super) fn printed(&self) -> Option<f64> {
        let figure = self.text.split(' ').next()?;
        self.value.and_then(|_| figure.parse().ok())
    }
}

impl Table {
    /// Which table it is.
    pub fn id(&self) -> ThesisTable {
        self.id
    }

    /// The line about images, protocol and data.
    pub fn first_line(&self) -> &str {
        &self.first_line
    }

    /// Sentences that limit what the figures say.
    pub fn remarks(&self) -> &[String] {
        &self.remarks
    }

    /// The columns.
    pub fn columns(&self) -> &[Column] {
        &self.columns
    }

    /// The lines, by protocol.
    pub fn sections(&self) -> &[Section] {
        &self.sections
    }

    /// Sentences below the table.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }
}

impl Line {
    pub(super) fn push_figures<const N: usize>(
        &mut self,
        values: [Option<f64>; N],
        intervals: Option<[Interval; N]>,
    ) {
        let intervals = intervals.map_or([None; N], |intervals| intervals.map(Some));
        let figures = values.into_iter().zip(intervals);
        self.cells.extend(figures.map(|(value, interval)| Cell {
            interval,
            ..Cell::figure(value)
        }));
    }
}

pub(super) fn mark_best<'a>(cells: impl Iterator<Item = &'a mut Cell>, lower_is_better: bool) {
    let sign = if lower_is_better { 1.0 } else { -1.0 };
    let mut cells: Vec<(&mut Cell, f64)> = cells
        .filter_map(|cell| cell.printed().map(|printed| (cell, sign * printed)))
        .collect();
    let best = cells.iter().map(|(_, value)| *value).min_by(f64::total_cmp);
    // One figure alone is the best of nothing.
    let Some(best) = best.filter(|_| cells.len() > 1) else {
        return;
    };
    for (cell, value) in &mut cells {
        cell.best = *value == best;
    }
}

pub(super) fn plain(key: &str, heading: &str, numeric: bool) -> Column {
    Column {
        key: key.to_owned(),
        heading: heading.to_owned(),
        latex: None,
        numeric,
    }
}

pub(super) fn figure_column(heading: String) -> Column {
    Column {
        key: heading.clone(),
        heading,
        latex: None,
        numeric: true,
    }
}
