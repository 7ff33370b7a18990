//! Tables 3.1 and 3.3, those of Make3D and of newer models: a line per method.

use super::coverage::Coverage;
use super::notes::{heading, seeds_note};
use super::part::{Measured, Part};
use super::table::{Cell, Column, Line, Table, errors, mark_best, plain};
use crate::metrics::{FurtherMetric, FurtherMetrics, Metric};
use crate::protocol::{Alignment, BenchmarkCrop, protocol};
use crate::published::{self, PublishedRow};
use crate::thesis::ThesisTable;

impl Table {
    /// A line per method. Further metrics have columns where something printed or measured has them.
    pub(super) fn fill_methods(&mut self, parts: &[Part<'_>], coverage: &Coverage) {
        let shown = Shown {
            d1_all: self.id == ThesisTable::Table31,
            further: parts.iter().any(Part::has_further)
                || published::rows(self.id)
                    .iter()
                    .any(|row| row.further != [None; 5]),
        };
        self.columns = [
            ("method", "Method"),
            ("origin", "Origin"),
            ("supervision", "Supervision"),
            ("images", "Images"),
        ]
        .map(|(key, heading)| plain(key, heading, false))
        .into();
        let protocol = parts.first().map_or("", |part| &part.protocol);
        self.columns.extend(metric_columns(protocol));
        if shown.d1_all {
            self.columns.push(errors("d1_all", "D1-all", "%"));
        }
        if shown.further {
            let columns =
                FurtherMetric::ALL.map(|one| errors(one.name(), one.heading(), one.unit()));
            self.columns.extend(columns);
        }

        for part in parts {
            let heading = match self.id {
                ThesisTable::Table33 => Some(range_of(&part.protocol)),
                ThesisTable::Eigen652 => Some(rules_of(&part.protocol)),
                _ => None,
            };
            let mut section = part.section(heading);
            for method in part.methods() {
                let &[model] = method.as_slice() else {
                    section
                        .lines
                        .push(seeds_line(part, &method, coverage, shown));
                    self.notes.push(seeds_note(&part.protocol, &method));
                    continue;
                };
                let mut line = Line {
                    measured: true,
                    comparable: part.competes(model, coverage),
                    cells: vec![
                        Cell::text(model.display_name()),
                        Cell::text("measured"),
                        Cell::text("-"),
                        Cell {
                            value: Some(model.images() as f64),
                            ..Cell::text(format!("{}/{}", model.images(), part.expected))
                        },
                    ],
                    ..Line::default()
                };
                let summary = &model.summary;
                line.push_figures(summary.mean.to_array().map(Some), summary.intervals);
                if shown.d1_all {
                    line.cells.push(Cell {
                        interval: summary.d1_all_interval,
                        ..Cell::figure(summary.d1_all)
                    });
                }
                if shown.further {
                    let values = summary.further.map(FurtherMetrics::to_array);
                    let values = values.map_or([None; 5], |values| values.map(Some));
                    line.push_figures(values, summary.further_intervals);
                }
                section.lines.push(line);
            }
            for row in published::rows(self.id)
                .iter()
                .filter(|row| row.protocol == part.own)
            {
                section
                    .lines
                    .push(published_line(row, part.is_own(), shown));
                let name = named(&row.method, row.reference);
                if let Some(source) = &row.source {
                    self.notes.push(format!("{name}, published: {source}."));
                }
                if let Some(note) = &row.note {
                    let place = match row.source {
                        Some(_) => String::new(),
                        None => format!(" (row {} of the printed table)", row.row),
                    };
                    self.notes
                        .push(format!("{name}{place}: {}.", note.trim_end_matches('.')));
                }
            }
            for (index, column) in self.columns.iter().enumerate().filter(|(_, c)| c.numeric) {
                let lower = !matches!(column.key.as_str(), "a1" | "a2" | "a3");
                let cells = section.lines.iter_mut().filter(|line| line.comparable);
                mark_best(cells.filter_map(|line| line.cells.get_mut(index)), lower);
            }
            self.sections.push(section);
        }

        self.notes.push(
            match self.id {
                ThesisTable::Make3d => {
                    "The thesis has pictures of Make3D only. Criterion C1: depths up to 70 m, each \
                     prediction scaled by medians, central crop of 2:1."
                }
                ThesisTable::Eigen652 => {
                    "Published rows stand in the works cited and were measured by their scripts; they \
                     are not ranked. SILog is 100 times the standard deviation of the logarithms' \
                     difference, iRMSE is in 1/km."
                }
                ThesisTable::Table33 => {
                    "Marks: * trained with measured depth, † with synthetic images and their \
                     depth. Rows trained on monocular video were scaled by medians. Rows marked \
                     later are printed in grey in the thesis and appeared after its paper."
                }
                _ => "Marks: * trained on monocular video.",
            }
            .to_owned(),
        );
    }
}

/// Columns of the seven metrics under a protocol.
pub(super) fn metric_columns(protocol: &str) -> [Column; 7] {
    Metric::ALL.map(|metric| Column {
        key: metric.name().to_owned(),
        heading: heading(metric, protocol).to_owned(),
        unit: metric.unit(),
        lower_is_better: Some(metric.lower_is_better()),
        numeric: true,
        ..Column::default()
    })
}

/// One line for several seeds: mean and standard deviation of the seeds' figures.
fn seeds_line(part: &Part<'_>, seeds: &[&Measured<'_>], coverage: &Coverage, shown: Shown) -> Line {
    let name = seeds.first().and_then(|model| model.seed());
    let fewest = seeds.iter().map(|model| model.images()).min();
    let fewest = fewest.unwrap_or(0);
    let mut line = Line {
        measured: true,
        comparable: seeds.iter().all(|model| part.competes(model, coverage)),
        cells: vec![
            Cell::text(format!(
                "{} ({} seeds)",
                name.map_or("", |(name, _)| name),
                seeds.len()
            )),
            Cell::text("measured"),
            Cell::text("-"),
            Cell {
                value: Some(fewest as f64),
                ..Cell::text(format!("{fewest}/{}", part.expected))
            },
        ],
        ..Line::default()
    };
    line.cells.extend(Metric::ALL.map(|metric| {
        let values: Vec<f64> = seeds
            .iter()
            .map(|model| model.summary.mean.get(metric))
            .collect();
        Cell::spread(&values)
    }));
    let spread = |value: &dyn Fn(&Measured<'_>) -> Option<f64>| {
        let values: Option<Vec<f64>> = seeds.iter().map(|model| value(model)).collect();
        match values {
            Some(values) => Cell::spread(&values),
            None => Cell::figure(None),
        }
    };
    if shown.d1_all {
        line.cells.push(spread(&|model| model.summary.d1_all));
    }
    if shown.further {
        let of = |metric| spread(&move |model| Some(model.summary.further?.get(metric)));
        line.cells.extend(FurtherMetric::ALL.map(of));
    }
    line
}

fn published_line(row: &PublishedRow, own_protocol: bool, shown: Shown) -> Line {
    let mut line = Line {
        measured: false,
        grey: row.grey,
        cite: row.cite_key(),
        comparable: own_protocol && row.comparable && !row.grey,
        cells: vec![
            Cell {
                marker: row.marker,
                ..Cell::text(named(&row.method, row.reference))
            },
            Cell::text(if row.grey {
                "published, later"
            } else {
                "published"
            }),
            Cell::text(row.supervision.clone()),
            Cell::text("-"),
        ],
    };
    line.push_figures(row.metrics, None);
    if shown.d1_all {
        line.cells.push(Cell::figure(None));
    }
    if shown.further {
        line.push_figures(row.further, None);
    }
    line
}

/// Which columns there are beside the seven metrics.
#[derive(Clone, Copy)]
struct Shown {
    d1_all: bool,
    further: bool,
}

pub(super) fn range_of(name: &str) -> String {
    match protocol(name) {
        Some(protocol) => format!("Up to {} m ({name})", protocol.max_depth_m),
        None => name.to_owned(),
    }
}

/// What sets a section of newer models apart: what a model is shown, and what its depth may be.
fn rules_of(name: &str) -> String {
    let Some(protocol) = protocol(name) else {
        return name.to_owned();
    };
    let image = match protocol.benchmark_crop {
        BenchmarkCrop::None => "whole image",
        BenchmarkCrop::Image => "benchmark crop of the image",
        BenchmarkCrop::ImageAndTruth => "benchmark crop of image and truth",
    };
    let depth = match protocol.alignment {
        Alignment::None => "depth in metres".to_owned(),
        alignment => format!("aligned ({alignment})"),
    };
    format!("{depth}, {image} ({name})")
}

pub(super) fn named(method: &str, reference: Option<u32>) -> String {
    match reference {
        Some(reference) => format!("{method} [{reference}]"),
        None => method.to_owned(),
    }
}
