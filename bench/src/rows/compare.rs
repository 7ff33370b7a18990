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
use strat_store::inputs::{self, Kind};

/// Why there is no comparison.
#[derive(Debug, thiserror::Error)]
pub enum CompareError {
    /// A file cannot be read.
    #[error(transparent)]
    Store(#[from] strat_store::Error),
    /// A file is no rows file.
    #[error("{path}: {reason}")]
    Csv {
        /// The file.
        path: PathBuf,
        /// Why.
        reason: strat_metrics::CsvError,
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
    rows::read(inputs::read(path, Kind::Table)?.as_slice()).map_err(|reason| CompareError::Csv {
        path: path.to_owned(),
        reason,
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

/// Reads several rows files as one, one after the other as they are; a row that two have counts once.
///
/// # Errors
/// As for [`read_all`].
pub fn read_all_in_order(paths: &[PathBuf]) -> Result<Vec<Row>, CompareError> {
    let parts: Vec<Vec<Row>> = paths
        .iter()
        .map(|path| read_rows(path))
        .collect::<Result<_, _>>()?;
    let merged = rows::merge(parts.clone())?.len();
    let mut all = parts.concat();
    if merged < all.len() {
        let mut seen = std::collections::HashSet::new();
        all.retain(|row| seen.insert(row.cells()));
    }
    Ok(all)
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
/// protocol (or the one given) as one family; with `further` the metrics of PROTOCOL 10.3 as well.
///
/// # Errors
/// Models or a protocol that are not there, and rows that cannot be compared.
pub fn pairs(
    rows: &[Row],
    protocol: Option<&str>,
    model_a: Option<&str>,
    model_b: Option<&str>,
    further: bool,
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
        for (index, a) in models.iter().enumerate() {
            for b in &models[index + 1..] {
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
    Ok(compare(&chosen, further, options)?)
}

const HEADER: [&str; 19] = [
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
    "family",
    "smallest_p",
];

/// The tests as CSV with exact figures.
///
/// # Errors
/// The CSV writer's own; none in practice.
pub fn csv(tests: &[PairedTest]) -> Result<Vec<u8>, strat_metrics::CsvError> {
    let cell = |value: Option<f64>| value.map(|value| value.to_string()).unwrap_or_default();
    let mut csv = strat_csv::Writer::new(Vec::new());
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
            test.family.to_string(),
            cell(test.smallest_p),
        ])?;
    }
    Ok(csv.into_inner()?)
}

/// The tests for a terminal: one block per pair, a line per metric. Differences are those of the
/// second model to the first.
#[must_use]
pub fn text(tests: &[PairedTest], options: &TestOptions) -> String {
    let mut text = String::new();
    let block = |a: &PairedTest, b: &PairedTest| {
        (&a.protocol, a.group, &a.model_a, &a.model_b)
            == (&b.protocol, b.group, &b.model_a, &b.model_b)
    };
    for tests in tests.chunk_by(block) {
        text += &block_text(tests);
        text.push('\n');
    }
    text += &format!(
        "Difference: second model less first, with its 95 % t interval over drives. p: sign flips of \
         whole drives (counted up to {} drives, else {} drawn, seed {}); Wilcoxon over the drives' \
         means; Holm within a protocol, errors and accuracies apart. A model is called better where \
         p is below 0.05 after Holm.\n",
        strat_metrics::compare::EXACT_UP_TO,
        options.permutations,
        options.seed,
    );
    text
}

/// One pair of models under one protocol.
fn block_text(tests: &[PairedTest]) -> String {
    let Some(first) = tests.first() else {
        return String::new();
    };
    let (a, b) = (&first.model_a, &first.model_b);
    let mut text = format!("{a} against {b} under {}", first.protocol);
    if let Some(group) = first.group {
        text += &format!(", {group}");
    }
    text += &format!(": {} images", first.images);
    if first.clusters != first.images {
        text += &format!(" of {}", first.recordings);
    }
    if first.unpaired_images > 0 {
        text += &format!(", {} more in one of them only", first.unpaired_images);
    }
    let [of_a, of_b] = [a, b].map(|name| name.chars().count().max(9));
    text += &format!(
        "\n{:<9} {a:>of_a$} {b:>of_b$} {:>11}  {:<23} {:>8} {:>8} {:>8}\n",
        "metric", "difference", "95 % interval", "p", "Wilcoxon", "Holm",
    );
    for test in tests {
        let interval = test.interval.map_or_else(
            || "-".to_owned(),
            |interval| format!("{:+.5} .. {:+.5}", interval.low, interval.high),
        );
        let verdict = match test.p_holm {
            Some(p) if p < 0.05 => {
                let second = (test.difference < 0.0) == test.lower_is_better;
                format!("  {} better", if second { b } else { a })
            }
            _ => String::new(),
        };
        text += &format!(
            "{:<9} {:>of_a$.4} {:>of_b$.4} {:>+11.5}  {interval:<23} {:>8} {:>8} {:>8}{verdict}\n",
            test.metric,
            test.mean_a,
            test.mean_b,
            test.difference,
            p_text(test.p_permutation),
            p_text(test.p_wilcoxon),
            p_text(test.p_holm),
        );
    }
    text + &limits(tests)
}

pub(crate) fn p_text(value: Option<f64>) -> String {
    match value {
        None => "-".to_owned(),
        Some(value) if value < 1e-4 => "<0.0001".to_owned(),
        Some(value) => format!("{value:.4}"),
    }
}

/// What the number of drives keeps these tests from showing.
fn limits(tests: &[PairedTest]) -> String {
    let limit = |p: f64| {
        if p < 1e-4 {
            format!("{p:.0e}")
        } else {
            format!("{p:.4}")
        }
    };
    let mut text = String::new();
    let without = tests
        .iter()
        .find_map(|test| Some((test, test.no_interval?)));
    if let Some((test, reason)) = without {
        text += &format!("No intervals over {}: {reason}.\n", test.recordings);
    }
    // The family that is hardest to pass; where nothing differs, more drives would not help.
    let hardest = tests
        .iter()
        .filter(|test| test.difference != 0.0)
        .filter_map(|test| Some((test, test.smallest_p?, test.smallest_p_holm()?)))
        .max_by(|a, b| a.2.total_cmp(&b.2));
    if let Some((test, smallest, corrected)) = hardest {
        text += &format!(
            "Over {} p cannot fall below {}, and after Holm over {} tests not below {}.",
            test.recordings,
            limit(smallest),
            test.family,
            limit(corrected),
        );
        if corrected >= 0.05 {
            text += " WARNING: 0.05 cannot be reached, whatever the difference; compare fewer \
                     models or groups at once (--protocol, --model-a, --model-b), or on more drives";
            text += if test.exact {
                "."
            } else {
                ", or with more --draws."
            };
        }
        text.push('\n');
    }
    text
}

#[cfg(test)]
mod tests {
    use strat_metrics::{ImageScore, Metrics, RowContext};

    use super::*;

    /// Rows of a model over two images of each drive.
    fn rows(model: &str, drives: usize, abs_rel: f64) -> Vec<Row> {
        let context = RowContext {
            model: model.to_owned(),
            protocol: "eigen-80".to_owned(),
            protocol_digest: "digest".to_owned(),
            data_digest: "digest".to_owned(),
            ..RowContext::default()
        };
        (0..2 * drives)
            .map(|i| {
                let metrics = Metrics {
                    abs_rel: abs_rel + 0.001 * i as f64,
                    ..Metrics::default()
                };
                let score = ImageScore {
                    group: None,
                    metrics,
                    further: None,
                    d1_all: None,
                    sum_squared_error: 1.0,
                    pixels: 1,
                    floored_pixels: 0,
                    fit: None,
                };
                let image = format!("2011_09_26_drive_{:04}/{i:010}", i / 2);
                Row::new(&context, image, score)
            })
            .collect()
    }

    fn compared(drives: usize) -> String {
        let all = [rows("old", drives, 0.2), rows("better", drives, 0.1)].concat();
        let options = TestOptions::default();
        text(
            &pairs(&all, None, None, None, false, &options).unwrap(),
            &options,
        )
    }

    /// Columns are in the order of the heading, and the model that is called better is the one with
    /// the smaller error.
    #[test]
    fn the_first_model_is_the_first_column() {
        let text = compared(12);
        let lines: Vec<&str> = text.lines().collect();
        assert!(lines[0].starts_with("old against better under eigen-80: 24 images of 12 drives"));
        let words: Vec<&str> = lines[1].split_whitespace().collect();
        assert_eq!(words[..4], ["metric", "old", "better", "difference"]);
        let words: Vec<&str> = lines[2].split_whitespace().collect();
        assert_eq!(words[..4], ["abs_rel", "0.2115", "0.1115", "-0.10000"]);
        assert!(lines[2].ends_with("better better"), "{text}");
        assert!(!text.contains("WARNING"), "{text}");
    }

    /// Four drives: p is 2^-3 at best, and 0.5 after Holm over four errors, of which three do not
    /// differ and have p 1.
    #[test]
    fn what_few_drives_cannot_show_is_said() {
        let text = compared(4);
        assert!(text.contains("p cannot fall below"), "{text}");
        assert!(text.contains("WARNING: 0.05 cannot be reached"), "{text}");
        assert!(!text.contains("No intervals"), "{text}");
        assert!(compared(2).contains("No intervals over 2 drives: it takes at least 3 of them."));
    }
}
