//! Comparison of models from rows files, for people and as CSV.
//!
//! The tests are [`strat_metrics::compare`]'s; this module reads files, chooses pairs and writes
//! the outcome. It needs neither models nor data.

use std::path::{Path, PathBuf};

use strat_metrics::{
    Row,
    compare::{PairedTest, TestOptions, compare},
    rows::{self, ModelRows, by_model},
};
use strat_store::files;

/// Why there is no comparison.
#[derive(Debug, thiserror::Error)]
pub enum CompareError {
    /// A file cannot be read.
    #[error(transparent)]
    Store(#[from] strat_store::Error),
    /// A file is no rows file.
    #[error("{path}: {source}")]
    Csv {
        /// The file.
        path: PathBuf,
        /// Why.
        source: strat_metrics::CsvError,
    },
    /// Two files contradict each other.
    #[error(transparent)]
    Merge(#[from] strat_metrics::CsvError),
    /// Rows that do not belong together.
    #[error(transparent)]
    Rows(#[from] rows::RowsError),
    /// Rows that cannot be compared.
    #[error(transparent)]
    Compare(#[from] strat_metrics::compare::CompareError),
    /// Too few models.
    #[error("{0}")]
    Choice(String),
}

/// Reads one rows file.
///
/// # Errors
/// It cannot be read or is no rows file.
pub fn read_rows(path: &Path) -> Result<Vec<Row>, CompareError> {
    rows::read(files::read(path)?.as_slice()).map_err(|source| CompareError::Csv {
        path: path.to_owned(),
        source,
    })
}

/// Reads several rows files as one.
///
/// # Errors
/// As for [`read_rows`], and files that contradict each other.
pub fn read_all(paths: &[PathBuf]) -> Result<Vec<Row>, CompareError> {
    let parts: Vec<Vec<Row>> = paths
        .iter()
        .map(|path| read_rows(path))
        .collect::<Result<_, _>>()?;
    Ok(rows::merge(parts)?)
}

/// Names of the protocols among rows, in the order of their first row.
#[must_use]
pub fn protocols_of(rows: &[Row]) -> Vec<String> {
    let mut names: Vec<String> = Vec::new();
    for row in rows {
        if !names.contains(&row.context.protocol) {
            names.push(row.context.protocol.clone());
        }
    }
    names
}

/// Tests all pairs of models, or the pairs with `model_a` first and `model_b` second, under each
/// protocol (or the one given) as one family.
///
/// # Errors
/// Models or a protocol that are not there, and rows that cannot be compared.
pub fn pairs(
    rows: &[Row],
    protocol: Option<&str>,
    model_a: Option<&str>,
    model_b: Option<&str>,
    options: &TestOptions,
) -> Result<Vec<PairedTest>, CompareError> {
    let names: Vec<String> = protocols_of(rows)
        .into_iter()
        .filter(|name| protocol.is_none_or(|wanted| wanted == name))
        .collect();
    let mut by_protocol: Vec<Vec<ModelRows<'_>>> = Vec::new();
    for name in &names {
        by_protocol.push(by_model(rows, name)?);
    }
    let known = |wanted: Option<&str>| {
        wanted.is_none_or(|wanted| {
            let mut models = by_protocol.iter().flatten();
            models.any(|model| model.context().model == wanted)
        })
    };
    if let Some(missing) = [model_a, model_b].into_iter().find(|model| !known(*model)) {
        return Err(CompareError::Choice(format!(
            "the rows have no model \"{}\" under {}",
            missing.unwrap_or_default(),
            protocol.unwrap_or("any protocol")
        )));
    }
    let mut chosen = Vec::new();
    for models in &by_protocol {
        for (place, a) in models.iter().enumerate() {
            for b in &models[place + 1..] {
                let is = |model: &ModelRows<'_>, wanted: Option<&str>| {
                    wanted.is_none_or(|wanted| model.context().model == wanted)
                };
                if is(a, model_a) && is(b, model_b) {
                    chosen.push((a, b));
                } else if is(b, model_a) && is(a, model_b) {
                    chosen.push((b, a));
                }
            }
        }
    }
    if chosen.is_empty() {
        return Err(CompareError::Choice(format!(
            "a comparison needs rows of two models under {}; give rows files that hold both",
            protocol.unwrap_or("one protocol")
        )));
    }
    Ok(compare(&chosen, options)?)
}

const HEADER: [&str; 17] = [
    "protocol",
    "group",
    "model_a",
    "model_b",
    "metric",
    "images",
    "unpaired_images",
    "clusters",
    "mean_a",
    "mean_b",
    "difference",
    "low",
    "high",
    "p_permutation",
    "exact",
    "p_wilcoxon",
    "p_holm",
];

/// The tests as CSV with exact figures.
///
/// # Errors
/// The CSV writer's own; none in practice.
pub fn csv(tests: &[PairedTest]) -> Result<Vec<u8>, strat_metrics::CsvError> {
    let cell = |value: Option<f64>| value.map(|value| value.to_string()).unwrap_or_default();
    let mut csv = csv::Writer::from_writer(Vec::new());
    csv.write_record(HEADER)?;
    for test in tests {
        csv.write_record([
            test.protocol.clone(),
            test.group
                .map(|group| group.to_string())
                .unwrap_or_default(),
            test.model_a.clone(),
            test.model_b.clone(),
            test.metric.to_owned(),
            test.images.to_string(),
            test.unpaired_images.to_string(),
            test.clusters.to_string(),
            test.mean_a.to_string(),
            test.mean_b.to_string(),
            test.difference.to_string(),
            cell(test.interval.map(|interval| interval.low)),
            cell(test.interval.map(|interval| interval.high)),
            cell(test.p_permutation),
            test.exact.to_string(),
            cell(test.p_wilcoxon),
            cell(test.p_holm),
        ])?;
    }
    Ok(csv.into_inner().map_err(|error| error.into_error())?)
}

/// The tests for a terminal: one block per pair, a line per metric.
#[must_use]
pub fn text(tests: &[PairedTest], options: &TestOptions) -> String {
    let p = |value: Option<f64>| match value {
        None => "-".to_owned(),
        Some(value) if value < 1e-4 => "<0.0001".to_owned(),
        Some(value) => format!("{value:.4}"),
    };
    let mut text = String::new();
    let mut heading = String::new();
    for test in tests {
        let mut next = format!(
            "{} against {} under {}",
            test.model_b, test.model_a, test.protocol
        );
        if let Some(group) = test.group {
            next += &format!(", {group}");
        }
        next += &format!(": {} images of {} drives", test.images, test.clusters);
        if test.clusters == test.images {
            next = next.replace(&format!(" of {} drives", test.clusters), "");
        }
        if test.unpaired_images > 0 {
            next += &format!(", {} more in one of them only", test.unpaired_images);
        }
        if next != heading {
            if !heading.is_empty() {
                text.push('\n');
            }
            text += &format!(
                "{next}\n{:<9} {:>9} {:>9} {:>11}  {:<23} {:>8} {:>8} {:>8}\n",
                "metric", "first", "second", "difference", "95 % interval", "p", "Wilcoxon", "Holm"
            );
            heading = next;
        }
        let interval = test.interval.map_or_else(
            || "-".to_owned(),
            |interval| format!("{:+.5} .. {:+.5}", interval.low, interval.high),
        );
        let verdict = match test.p_holm {
            Some(p) if p < 0.05 => {
                if (test.difference < 0.0) == test.lower_is_better {
                    "  better"
                } else {
                    "  worse"
                }
            }
            _ => "",
        };
        text += &format!(
            "{:<9} {:>9.4} {:>9.4} {:>+11.5}  {interval:<23} {:>8} {:>8} {:>8}{verdict}\n",
            test.metric,
            test.mean_a,
            test.mean_b,
            test.difference,
            p(test.p_permutation),
            p(test.p_wilcoxon),
            p(test.p_holm),
        );
    }
    text += &format!(
        "\np: sign flips of whole drives (counted up to {} drives, else {} drawn, seed {}); \
         Wilcoxon over the drives' means; Holm over all {} tests here. \"better\" and \"worse\" \
         are said below 0.05 after Holm.\n",
        strat_metrics::compare::EXACT_UP_TO,
        options.permutations,
        options.seed,
        tests.len()
    );
    text
}
