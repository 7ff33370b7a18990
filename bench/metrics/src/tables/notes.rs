//! The sentences above and below a table.

use super::coverage::{Coverage, Source};
use super::part::{Measured, Part, short};
use crate::metrics::Metric;
use crate::protocol::{LogBase, protocol};
use crate::thesis::ThesisTable;

pub(super) fn first_line(table: ThesisTable, parts: &[Part<'_>], coverage: &Coverage) -> String {
    // Truth that covers fewer images is the same for all sections of a table.
    let expected = parts.iter().map(|part| part.expected).min();
    let expected = expected.unwrap_or(coverage.expected_images);
    let counts: Vec<(&str, &str, u64)> = parts
        .iter()
        .flat_map(|part| {
            part.models.iter().map(|model| {
                let name = model.context().model.as_str();
                (part.protocol.as_str(), name, model.images())
            })
        })
        .collect();
    let covered = match counts.first() {
        None => format!("0 of {expected} images, nothing measured"),
        Some(&(_, _, images)) if counts.iter().all(|&(_, _, other)| other == images) => {
            format!("{images} of {expected} images")
        }
        Some(_) => {
            let each = counts.iter().map(|(protocol, model, images)| {
                format!("{images} of {expected} images for {model} under {protocol}")
            });
            each.collect::<Vec<_>>().join(", ")
        }
    };
    let protocols: Vec<String> = parts
        .iter()
        .map(|part| format!("{} {}", part.protocol, short(&part.digest)))
        .collect();
    let mut line = format!(
        "Table {table}, {}: {covered}; protocol {}",
        table.subject(),
        protocols.join(", ")
    );
    if let Some(part) = parts.iter().find(|part| !part.models.is_empty()) {
        line += &format!("; data {}", short(&part.data_digest()));
    }
    line
}

pub(super) fn remarks(table: ThesisTable, parts: &[Part<'_>], coverage: &Coverage) -> Vec<String> {
    let mut remarks = Vec::new();
    let measured = parts.iter().any(|part| !part.models.is_empty());
    let (own, name) = match table {
        ThesisTable::Make3d => (Source::from("make3d"), "Make3D"),
        _ => (Source::Kitti, "KITTI"),
    };
    if measured && coverage.source != own {
        remarks.push(format!(
            "The images are {}, not {name}: measured numbers cannot be compared with published \
             ones.",
            coverage.source
        ));
    }
    let incomplete = parts.iter().any(|part| {
        part.models
            .iter()
            .any(|model| model.images() < part.expected)
    });
    if incomplete {
        remarks
            .push("Only part of the images, so not ranked against published numbers.".to_owned());
    }
    let mut aligned: Vec<(&str, Vec<&str>)> = Vec::new();
    for part in parts {
        let fitted = protocol(&part.protocol).and_then(|protocol| protocol.alignment.fitted());
        let Some(fitted) = fitted else { continue };
        match aligned.iter_mut().find(|(known, _)| *known == fitted) {
            Some((_, names)) => names.push(&part.protocol),
            None => aligned.push((fitted, vec![&part.protocol])),
        }
    }
    for (fitted, names) in aligned {
        remarks.push(format!(
            "{}: aligned per image: {fitted}; saw the ground truth.",
            names.join(", ")
        ));
    }
    for part in parts.iter().filter(|part| !part.is_own()) {
        remarks.push(format!(
            "Measured under {}, published under {}: the two cannot be compared.",
            part.protocol, part.own
        ));
    }
    remarks
}

/// A metric's heading under a protocol.
pub(super) fn heading(metric: Metric, name: &str) -> &'static str {
    match (metric, protocol(name).map(|protocol| protocol.log_base)) {
        (Metric::RmseLog, Some(LogBase::Ten)) => "RMSE log10",
        _ => metric.heading(),
    }
}

pub(super) fn measured_notes(protocol: &str, model: &Measured<'_>) -> Vec<String> {
    let (name, summary) = (&model.context().model, &model.summary);
    let mut notes = Vec::new();
    // A mean over groups of one image would mix different numbers of pixels; table 3.2 has no
    // single row per model.
    let grouped = model
        .rows
        .rows()
        .iter()
        .any(|row| row.score.group.is_some());
    if let (Some(intervals), false) = (&summary.intervals, grouped) {
        let figures = Metric::ALL.map(|metric| {
            let interval = intervals[metric as usize];
            format!(
                "{} {:.3} to {:.3}",
                heading(metric, protocol),
                interval.low,
                interval.high
            )
        });
        notes.push(format!(
            "{name} under {protocol}, 95 % intervals over {}: {}.",
            summary.clusters,
            figures.join(", ")
        ));
        if let (Some(last), Some(d1)) = (notes.last_mut(), summary.d1_all_interval) {
            last.truncate(last.len() - 1);
            *last += &format!(", D1-all {:.3} to {:.3}.", d1.low, d1.high);
        }
    }
    if let (Some(reason), false) = (summary.no_interval, grouped) {
        notes.push(format!(
            "{name} under {protocol}: no intervals over {}; {reason}.",
            summary.clusters
        ));
    }
    if summary.floored_pixels > 0 {
        notes.push(format!(
            "{name} under {protocol}: the disparity of {} of {} pixels was raised to the floor.",
            summary.floored_pixels, summary.pixels
        ));
    }
    notes
}

pub(super) fn seeds_note(protocol: &str, seeds: &[&Measured<'_>]) -> String {
    let named: Vec<(&str, &str)> = seeds.iter().filter_map(|model| model.seed()).collect();
    let seeds: Vec<&str> = named.iter().map(|(_, seed)| *seed).collect();
    format!(
        "{} under {protocol}: mean ± standard deviation over the seeds {}.",
        named.first().map_or("", |(name, _)| name),
        seeds.join(", ")
    )
}
