//! Which images are drawn, and under which protocol.

use std::collections::{BTreeSet, HashMap};

use strat_metrics::{Alignment, Protocol, Row, Suffix};
use strat_store::{
    set::{Content, PreparedSet, Sample},
    spread,
};

use super::FigureError;
use crate::{
    evaluate::plan::{self, TableChoice},
    protocol_file,
};

/// Which test images are drawn.
#[derive(Clone, Debug)]
pub enum Choice {
    /// These ids.
    Images(Vec<String>),
    /// So many, spread evenly.
    Evenly(usize),
    /// By their Abs Rel in the mean over the models of these rows.
    Ranked {
        /// The rows.
        rows: Vec<Row>,
        /// So many of the worst images, the worst first.
        worst: usize,
        /// So many of the best, the best first.
        best: usize,
    },
}

/// The protocol that figures are drawn under: the one given by name, else the first without groups
/// that the rows to choose by were measured under, else that of the set's first table. Own pairs and
/// Cityscapes have no table.
///
/// # Errors
/// The set has no such ground truth, or the rows were measured by other rules.
pub fn protocol_for(
    given: Option<&str>,
    choice: &Choice,
    set: &PreparedSet,
    samples: &[Sample],
) -> Result<Protocol, FigureError> {
    let content = set.manifest.content;
    let of_rows = match choice {
        Choice::Ranked { rows, .. } => rows.iter().find(|row| row.score.group.is_none()),
        _ => None,
    };
    let of_rows = of_rows.map(|row| &row.context);
    let wanted = given.or(of_rows.map(|context| context.protocol.as_str()));
    let wanted: Vec<String> = match (wanted, content) {
        (Some(name), _) => vec![name.to_owned()],
        (None, Content::Pairs | Content::Cityscapes) => vec!["eigen-cameraz-80".to_owned()],
        (None, _) => Vec::new(),
    };
    let count = plan::test_count(set, samples);
    let plan = plan::plan(TableChoice::All, &wanted, content, samples, count)?;
    let found = match wanted.first() {
        // One that a table has too stands in the table's position of the plan.
        Some(name) => protocol_file::resolve(name).ok(),
        None => plan.protocols.into_iter().next(),
    };
    let found = found.ok_or(FigureError::NoProtocol)?;
    match of_rows.filter(|_| given.is_none()) {
        Some(context) if context.protocol_digest != found.digest() => {
            Err(FigureError::OtherRules(found.name))
        }
        _ => Ok(found),
    }
}

/// The test images to be drawn.
///
/// # Errors
/// One is not in the set, or the rows have none under the protocol.
pub fn choose(
    choice: &Choice,
    protocol: &Protocol,
    set: &PreparedSet,
    samples: &[Sample],
) -> Result<Vec<Sample>, FigureError> {
    let by_id = |id: &str| {
        let found = samples.iter().find(|sample| sample.id == id);
        found.cloned().ok_or_else(|| {
            let drive = id.split('/').next().unwrap_or(id);
            let near = samples.iter().find(|sample| sample.id.starts_with(drive));
            let example = near.or(samples.first());
            FigureError::NoSuchImage {
                set: set.root.display().to_string(),
                id: id.to_owned(),
                example: example.map_or_else(String::new, |sample| sample.id.clone()),
            }
        })
    };
    match choice {
        Choice::Images(ids) => ids.iter().map(|id| by_id(id.trim())).collect(),
        Choice::Evenly(count) => {
            let indices = spread::evenly(samples.len(), *count);
            Ok(indices.map(|index| samples[index].clone()).collect())
        }
        Choice::Ranked { rows, worst, best } => {
            let ranked = ranked(rows, protocol);
            if ranked.is_empty() {
                let names = rows.iter().map(|row| row.context.protocol.clone());
                let names: BTreeSet<String> = names.collect();
                return Err(FigureError::NotRanked {
                    wanted: protocol.name.clone(),
                    found: names.into_iter().collect(),
                });
            }
            let mut seen = BTreeSet::new();
            let bounds = ranked.iter().rev().take(*worst);
            bounds
                .chain(ranked.iter().take(*best))
                .filter(|id| seen.insert(**id))
                .map(|id| by_id(id))
                .collect()
        }
    }
}

/// Images by their Abs Rel under a protocol, in the mean over the models, best first. Models of
/// unknown scale are scored by medians under it.
fn ranked<'a>(rows: &'a [Row], protocol: &Protocol) -> Vec<&'a str> {
    let scaled = protocol.clone().with(Suffix::Align(Alignment::Median));
    let digests = [protocol.digest(), scaled.digest()];
    let mut sums: HashMap<&str, (f64, f64)> = HashMap::new();
    for row in rows {
        if row.score.group.is_none() && digests.contains(&row.context.protocol_digest) {
            let (sum, count) = sums.entry(&row.image).or_default();
            *sum += row.score.metrics.abs_rel;
            *count += 1.0;
        }
    }
    let mut ranked: Vec<(&str, f64)> = sums
        .into_iter()
        .map(|(image, (sum, count))| (image, sum / count))
        .collect();
    ranked.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(b.0)));
    ranked.into_iter().map(|(image, _)| image).collect()
}
