//! Tables 3.1 and 3.3 and the one of Make3D: a line per method.

use super::coverage::Coverage;
use super::notes::{heading, seeds_note};
use super::part::{Measured, Part};
use super::table::{Cell, Column, Line, Table, mark_best, plain};
use crate::metrics::Metric;
use crate::protocol::protocol;
use crate::published::{self, PublishedRow};
use crate::thesis::ThesisTable;

impl Table {
    /// Tables 3.1 and 3.3: a line per method.
    pub(super) fn fill_methods(&mut self, parts: &[Part<'_>], coverage: &Coverage) {
        let with_d1 = self.id == ThesisTable::Table31;
        self.columns = [
            ("method", "Method"),
            ("origin", "Origin"),
            ("supervision", "Supervision"),
            ("images", "Images"),
        ]
        .map(|(key, heading)| plain(key, heading, false))
        .into();
        self.columns.extend(Metric::ALL.map(|metric| Column {
            key: metric.name().to_owned(),
            heading: heading(metric, parts.first().map_or("", |part| &part.protocol)).to_owned(),
            latex: match metric {
                Metric::A1 => Some(r"$\delta<1.25$"),
                Metric::A2 => Some(r"$\delta<1.25^2$"),
                Metric::A3 => Some(r"$\delta<1.25^3$"),
                _ => None,
            },
            numeric: true,
        }));
        if with_d1 {
            self.columns.push(plain("d1_all", "D1-all", true));
        }

        for part in parts {
            let heading = (self.id == ThesisTable::Table33).then(|| {
                let max = protocol(&part.protocol).map(|protocol| protocol.max_depth_m);
                max.map_or_else(
                    || part.protocol.clone(),
                    |max| format!("Up to {max} m ({})", part.protocol),
                )
            });
            let mut section = part.section(heading, coverage);
            for row in published::rows(self.id)
                .iter()
                .filter(|row| row.protocol == part.own)
            {
                section
                    .lines
                    .push(published_line(row, part.is_own(), with_d1));
                if let Some(note) = &row.note {
                    self.notes.push(format!(
                        "{} (row {} of the printed table): {}.",
                        named(&row.method, row.reference),
                        row.row,
                        note.trim_end_matches('.')
                    ));
                }
            }
            for method in part.methods() {
                let &[model] = method.as_slice() else {
                    section
                        .lines
                        .push(seeds_line(part, &method, coverage, with_d1));
                    self.notes.push(seeds_note(&part.protocol, &method));
                    continue;
                };
                let mut line = Line {
                    measured: true,
                    grey: false,
                    comparable: part.competes(model, coverage),
                    cells: vec![
                        Cell::text(model.display_name()),
                        Cell::text("measured"),
                        Cell::text("-"),
                        Cell {
                            value: Some(model.images() as f64),
                            ..Cell::text(format!("{}/{}", model.images(), coverage.expected_images))
                        },
                    ],
                };
                let summary = &model.summary;
                line.push_metrics(summary.mean, summary.intervals);
                if with_d1 {
                    line.cells.push(Cell {
                        interval: summary.d1_all_interval,
                        ..Cell::figure(summary.d1_all)
                    });
                }
                section.lines.push(line);
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

/// One line for several seeds: mean and standard deviation of the seeds' figures.
fn seeds_line(
    part: &Part<'_>,
    seeds: &[&Measured<'_>],
    coverage: &Coverage,
    with_d1: bool,
) -> Line {
    let name = seeds.first().and_then(|model| model.seed());
    let fewest = seeds.iter().map(|model| model.images()).min();
    let fewest = fewest.unwrap_or(0);
    let mut line = Line {
        measured: true,
        grey: false,
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
                ..Cell::text(format!("{fewest}/{}", coverage.expected_images))
            },
        ],
    };
    line.cells.extend(Metric::ALL.map(|metric| {
        let values: Vec<f64> = seeds
            .iter()
            .map(|model| model.summary.mean.get(metric))
            .collect();
        Cell::spread(&values)
    }));
    if with_d1 {
        let values: Option<Vec<f64>> = seeds.iter().map(|model| model.summary.d1_all).collect();
        line.cells.push(match values {
            Some(values) => Cell::spread(&values),
            None => Cell::figure(None),
        });
    }
    line
}

fn published_line(row: &PublishedRow, own_protocol: bool, with_d1: bool) -> Line {
    let mut line = Line {
        measured: false,
        grey: row.grey,
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
    line.push_metrics(row.metrics, None);
    if with_d1 {
        line.cells.push(Cell::figure(None));
    }
    line
}

pub(super) fn named(method: &str, reference: Option<u32>) -> String {
    match reference {
        Some(reference) => format!("{method} [{reference}]"),
        None => method.to_owned(),
    }
}
