//! The charts of the page, from tables and rows alone.

use strat_metrics::{
    Group, Grouping, Metric, Row,
    rows::{ModelRows, RowsError, by_model},
    statistics::{Summary, summarise},
    tables::{Line, Section, Table},
};

use crate::draw::{
    chart::{Chart, Curve, Panel},
    whiskers::{Mark, Whiskers},
};

/// Metrics that are drawn with their intervals; the rest is in the tables.
const DRAWN: [Metric; 3] = [Metric::AbsRel, Metric::Rmse, Metric::A1];

/// Axis label of a metric.
fn axis(metric: Metric) -> String {
    let unit = match metric {
        Metric::SqRel | Metric::Rmse => " (m)",
        _ => "",
    };
    let better = if metric.lower_is_better() {
        "lower"
    } else {
        "higher"
    };
    format!("{}{unit}, {better} is better", metric.heading())
}

/// The figures of a section of table 3.1 or 3.3 with their intervals, a diagram per metric.
pub(super) fn of_section(table: &Table, section: &Section) -> Vec<String> {
    let drawn = DRAWN.iter().filter_map(|metric| {
        let index = table
            .columns()
            .iter()
            .position(|column| column.key == metric.name())?;
        let mark = |line: &Line| {
            let cell = line.cells.get(index)?;
            Some(Mark {
                label: line.cells.first()?.text.clone(),
                value: cell.value?,
                interval: cell.interval.map(|bounds| (bounds.low, bounds.high)),
                published: !line.measured,
            })
        };
        let diagram = Whiskers {
            title: metric.heading().to_owned(),
            x: axis(*metric),
            marks: section.lines.iter().filter_map(mark).collect(),
        };
        Some(diagram.svg())
    });
    drawn.collect()
}

/// The groups of the first section of table 3.2 with their intervals, a diagram per group.
pub(super) fn of_groups(table: &Table) -> Vec<String> {
    let Some(section) = table.sections().first() else {
        return Vec::new();
    };
    let diagram = |line: &Line| {
        let marks = table.columns().iter().zip(&line.cells);
        Whiskers {
            title: line
                .cells
                .first()
                .map_or(String::new(), |cell| cell.text.clone()),
            x: axis(Metric::Rmse),
            marks: marks
                .filter_map(|(column, cell)| {
                    let published = column.heading.strip_suffix(" (published)");
                    let label = published.or_else(|| column.heading.strip_suffix(" (measured)"))?;
                    Some(Mark {
                        label: label.to_owned(),
                        value: cell.value?,
                        interval: cell.interval.map(|bounds| (bounds.low, bounds.high)),
                        published: published.is_some(),
                    })
                })
                .collect(),
        }
        .svg()
    };
    section.lines.iter().map(diagram).collect()
}

/// What one model scored at one distance.
pub(super) struct AtDistance {
    pub(super) model: String,
    pub(super) group: Group,
    pub(super) summary: Summary,
}

/// Summaries by model and distance under a protocol with such groups; empty under another.
pub(super) fn distances(rows: &[Row], protocol: &str) -> Result<Vec<AtDistance>, RowsError> {
    let of_model = |model: &ModelRows<'_>| -> Vec<AtDistance> {
        let name = model.context().model.clone();
        let groups = Grouping::Distance.groups().iter();
        groups
            .filter_map(|&group| {
                let summary = summarise(&model.of_group(Some(group)))?;
                Some(AtDistance {
                    model: name.clone(),
                    group,
                    summary,
                })
            })
            .collect()
    };
    Ok(by_model(rows, protocol)?
        .iter()
        .flat_map(of_model)
        .collect())
}

/// Error against distance, a chart for each of two metrics. Points stand in the middle of their
/// distances; what is beyond the last end has none and is in the table only.
pub(super) fn of_distances(found: &[AtDistance]) -> Vec<String> {
    let mut models: Vec<&str> = found.iter().map(|at| at.model.as_str()).collect();
    models.dedup();
    let chart = |metric: Metric| {
        let curve = |model: &str| {
            let mut curve = Curve {
                label: model.to_owned(),
                ..Curve::default()
            };
            for at in found.iter().filter(|at| at.model == model) {
                let Some((above, end)) =
                    at.group.distance_m().filter(|bounds| bounds.1.is_finite())
                else {
                    continue;
                };
                let mean = at.summary.mean.get(metric);
                curve.points.push((0.5 * (above + end), mean));
                let interval = at.summary.intervals.map(|all| all[metric as usize]);
                curve
                    .band
                    .push(interval.map_or((mean, mean), |bounds| (bounds.low, bounds.high)));
            }
            curve
        };
        let panel = Panel {
            x: "true depth (m)".to_owned(),
            y: axis(metric),
            curves: models.iter().map(|model| curve(model)).collect(),
            ..Panel::default()
        };
        Chart {
            title: format!("{} against distance", metric.heading()),
            note: "mean over images; band: 95 % interval".to_owned(),
            panels: vec![panel],
        }
        .svg()
    };
    [Metric::AbsRel, Metric::Rmse].map(chart).into()
}

/// Abs Rel of all images in ascending order, a curve per model.
pub(super) fn of_images(rows: &[Row], protocol: &str) -> Result<String, RowsError> {
    let curves = by_model(rows, protocol)?
        .iter()
        .map(|model| {
            let mut errors: Vec<f64> = model
                .rows()
                .iter()
                .map(|row| row.score.metrics.abs_rel)
                .collect();
            errors.sort_by(f64::total_cmp);
            let share = |index: usize| 100.0 * (index as f64 + 0.5) / errors.len() as f64;
            Curve {
                label: model.context().model.clone(),
                points: errors
                    .iter()
                    .enumerate()
                    .map(|(i, e)| (share(i), *e))
                    .collect(),
                ..Curve::default()
            }
        })
        .collect();
    let panel = Panel {
        x: "share of the images (%)".to_owned(),
        y: "Abs Rel".to_owned(),
        curves,
        ..Panel::default()
    };
    Ok(Chart {
        title: "Abs Rel of every image".to_owned(),
        note: "images in ascending order of their error".to_owned(),
        panels: vec![panel],
    }
    .svg())
}
