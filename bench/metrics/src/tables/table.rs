//! A table of cells, whatever it is about: what the four formats are written from.

use std::convert::Infallible;
use std::str::FromStr;

use serde::{Serialize, Serializer};

use crate::metrics::{FurtherMetric, Metric};
use crate::published::{Marker, PublishedRow};
use crate::statistics::Interval;
use crate::thesis::ThesisTable;

/// A table ready to be written in one of its formats; serialised it is the whole table with exact
/// numbers.
#[derive(Clone, Debug, Serialize)]
pub struct Table {
    #[serde(rename = "table", serialize_with = "as_text")]
    pub(super) id: ThesisTable,
    /// It compares measured variants with each other; nothing published stands beside them.
    pub(super) ablation: bool,
    pub(super) first_line: String,
    pub(super) remarks: Vec<String>,
    pub(super) columns: Vec<Column>,
    pub(super) sections: Vec<Section>,
    pub(super) notes: Vec<String>,
    /// What the intervals resample, as "28 drives".
    pub(super) resampled: Option<String>,
    /// Published numbers were added to those that come with the program.
    #[serde(skip)]
    pub(super) has_further: bool,
}

/// A column of a [`Table`].
#[derive(Clone, Debug, Default, Serialize)]
pub struct Column {
    /// Name in CSV files.
    pub key: String,
    /// Name for readers.
    pub heading: String,
    /// Unit of the numbers; empty where there is none.
    pub unit: &'static str,
    /// Whether the lower or the higher of two numbers is the better one, where one is.
    pub lower_is_better: Option<bool>,
    /// Holds numbers.
    pub numeric: bool,
    /// All its numbers are published ones (table 3.2).
    pub published: bool,
    /// Key of the work that its numbers are from, in the file of references.
    #[serde(skip)]
    pub(super) cite: Option<&'static str>,
}

impl Column {
    /// What stands above the numbers: unit and direction, as `m ↓`.
    pub fn direction(&self) -> String {
        let arrow = match self.lower_is_better {
            Some(true) => "↓",
            Some(false) => "↑",
            None => "",
        };
        format!("{} {arrow}", self.unit).trim().to_owned()
    }

    /// Name, unit and direction: `RMSE m ↓`.
    pub fn head(&self) -> String {
        format!("{} {}", self.heading, self.direction())
            .trim()
            .to_owned()
    }
}

/// Lines under one protocol.
#[derive(Clone, Debug, Serialize)]
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
#[derive(Clone, Debug, Default, Serialize)]
pub struct Line {
    /// Belongs to the protocol and data of its section; published lines do not.
    pub measured: bool,
    /// Printed in grey in the thesis.
    pub grey: bool,
    pub(super) comparable: bool,
    /// Key of the work that a published line is from, in the file of references.
    #[serde(skip)]
    pub(super) cite: Option<&'static str>,
    /// A cell for each column.
    pub cells: Vec<Cell>,
}

/// A cell of a [`Line`].
#[derive(Clone, Debug, Default, Serialize)]
pub struct Cell {
    /// What is printed, without marks.
    pub text: String,
    /// The mark of the thesis beside it.
    #[serde(skip)]
    pub marker: Option<Marker>,
    /// The exact figure, which CSV shows in place of the text.
    pub value: Option<f64>,
    /// 95 % interval of a measured figure.
    pub interval: Option<Interval>,
    /// The best of its column among comparable lines.
    pub best: bool,
    /// The second best of three or more comparable lines.
    pub second: bool,
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

/// Which lines, and in table 3.2 which columns, a table shows.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Shown {
    /// Measured and published ones.
    #[default]
    All,
    /// Measured ones alone.
    Measured,
    /// Those of the methods named, as they stand in the table, in this order.
    Named(Vec<String>),
}

impl FromStr for Shown {
    type Err = Infallible;

    /// `all`, `measured`, or names of methods between commas.
    fn from_str(text: &str) -> Result<Self, Infallible> {
        Ok(match text {
            "all" => Self::All,
            "measured" => Self::Measured,
            names => Self::Named(
                names
                    .split(',')
                    .map(|name| name.trim().to_owned())
                    .collect(),
            ),
        })
    }
}

impl Table {
    /// The table with some of its lines only. Marks stay: they are about all comparable lines.
    #[must_use]
    pub fn only(mut self, shown: &Shown) -> Self {
        let rank = |name: &str, published: bool| match shown {
            Shown::All => Some(0),
            Shown::Measured => (!published).then_some(0),
            Shown::Named(names) => names
                .iter()
                .position(|wanted| without_number(name) == *wanted),
        };
        if self.id == ThesisTable::Table32 {
            let kept: Vec<bool> = self
                .columns
                .iter()
                .map(|column| {
                    let name = column
                        .heading
                        .rsplit_once(" (")
                        .map_or("", |(name, _)| name);
                    !column.numeric
                        || column.unit.is_empty()
                        || rank(name, column.published).is_some()
                })
                .collect();
            retain(&mut self.columns, &kept);
            for line in self
                .sections
                .iter_mut()
                .flat_map(|section| &mut section.lines)
            {
                retain(&mut line.cells, &kept);
            }
            return self;
        }
        for section in &mut self.sections {
            let of = |line: &Line| {
                rank(
                    line.cells.first().map_or("", |cell| &cell.text),
                    !line.measured,
                )
            };
            section.lines.retain(|line| of(line).is_some());
            section.lines.sort_by_key(of);
        }
        self
    }

    /// The table with further published lines (columns in table 3.2), in the sections of their protocols.
    /// They are not ranked.
    #[must_use]
    pub fn with_published(mut self, rows: &[PublishedRow]) -> Self {
        let mut protocols = self.sections.iter().map(|section| &section.protocol);
        self.has_further = protocols.any(|own| rows.iter().any(|row| row.protocol == *own));
        if self.id == ThesisTable::Table32 {
            self.add_published_groups(rows);
            return self;
        }
        for section in &mut self.sections {
            for row in rows.iter().filter(|row| row.protocol == section.protocol) {
                let cells = self.columns.iter().map(|column| match column.key.as_str() {
                    "method" => Cell::text(row.method.clone()),
                    "origin" => Cell::text("published"),
                    "supervision" => Cell::text(row.supervision.clone()),
                    key => {
                        let seven = Metric::ALL.map(Metric::name).into_iter().zip(row.metrics);
                        let further = FurtherMetric::ALL.map(FurtherMetric::name);
                        let mut all = seven.chain(further.into_iter().zip(row.further));
                        Cell::figure(
                            all.find(|(name, _)| *name == key)
                                .and_then(|(_, value)| value),
                        )
                    }
                });
                section.lines.push(Line {
                    cells: cells.collect(),
                    ..Line::default()
                });
                if let Some(source) = &row.source {
                    self.notes
                        .push(format!("{}, published: {source}.", row.method));
                }
            }
        }
        self
    }

    /// Names that were asked for and are not those of any line or column.
    pub fn missing<'a>(&self, shown: &'a Shown) -> Vec<&'a str> {
        let Shown::Named(names) = shown else {
            return Vec::new();
        };
        let lines = self.sections.iter().flat_map(|section| &section.lines);
        let first = lines.filter_map(|line| line.cells.first());
        let heads = self.columns.iter().map(|column| {
            let name = column.heading.rsplit_once(" (");
            name.map_or(column.heading.as_str(), |(name, _)| name)
        });
        let known: Vec<&str> = first
            .map(|cell| cell.text.as_str())
            .chain(heads)
            .map(without_number)
            .collect();
        let names = names.iter().map(String::as_str);
        names.filter(|name| !known.contains(name)).collect()
    }

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

    /// What the intervals resample, as "28 drives"; none where there are no intervals.
    pub fn resampled(&self) -> Option<&str> {
        self.resampled.as_deref()
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
    let rest = cells.iter().map(|(_, value)| *value);
    let second = rest.filter(|value| *value != best).min_by(f64::total_cmp);
    let second = second.filter(|_| cells.len() > 2);
    for (cell, value) in &mut cells {
        cell.best = *value == best;
        cell.second = Some(*value) == second;
    }
}

fn retain<T>(all: &mut Vec<T>, kept: &[bool]) {
    let mut kept = kept.iter();
    all.retain(|_| kept.next().copied().unwrap_or(true));
}

/// A method's name without the number of its reference.
pub(super) fn without_number(name: &str) -> &str {
    match name
        .strip_suffix(']')
        .and_then(|rest| rest.rsplit_once(" ["))
    {
        Some((method, number)) if number.bytes().all(|byte| byte.is_ascii_digit()) => method,
        _ => name,
    }
}

fn as_text<S: Serializer>(id: &ThesisTable, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_str(id)
}

pub(super) fn plain(key: &str, heading: &str, numeric: bool) -> Column {
    Column {
        key: key.to_owned(),
        heading: heading.to_owned(),
        numeric,
        ..Column::default()
    }
}

/// A column of numbers for which lower is better.
pub(super) fn errors(key: &str, heading: &str, unit: &'static str) -> Column {
    Column {
        unit,
        lower_is_better: Some(true),
        ..plain(key, heading, true)
    }
}
