//! `published/*.csv`: rows that others have printed, with the work they stand in.
//!
//! They stand beside measured ones and are never ranked: without rows nothing can be tested.

use std::path::Path;

use serde::{Deserialize, Serialize};
use strat_metrics::tables::ThesisTable;
use strat_metrics::{FurtherMetric, Group, Metric, protocol, published};
use strat_store::files;
use strat_store::inputs::{self, Kind};

use crate::board::{BoardError, PUBLISHED};
use crate::card::shown;
use crate::submission::Problem;
use crate::text::{check_name, check_prose};

/// A printed row.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Published {
    /// Method as printed.
    pub method: String,
    /// Protocol under which comparable numbers are measured.
    pub protocol: String,
    /// Group of pixels, for protocols with groups.
    pub group: Option<String>,
    /// What the method was trained with.
    pub supervision: String,
    /// Where the numbers stand.
    pub citation: String,
    /// The seven metrics, where they were printed.
    pub abs_rel: Option<f64>,
    /// As `abs_rel`.
    pub sq_rel: Option<f64>,
    /// As `abs_rel`.
    pub rmse: Option<f64>,
    /// As `abs_rel`.
    pub rmse_log: Option<f64>,
    /// As `abs_rel`.
    pub a1: Option<f64>,
    /// As `abs_rel`.
    pub a2: Option<f64>,
    /// As `abs_rel`.
    pub a3: Option<f64>,
    /// Further metrics, where they were printed.
    pub silog: Option<f64>,
    /// As `silog`.
    pub log10: Option<f64>,
    /// What a reader should know.
    pub note: Option<String>,
}

impl Published {
    /// The seven metrics in the order of [`Metric::ALL`].
    #[must_use]
    pub fn metrics(&self) -> [Option<f64>; 7] {
        [
            self.abs_rel,
            self.sq_rel,
            self.rmse,
            self.rmse_log,
            self.a1,
            self.a2,
            self.a3,
        ]
    }

    fn set(&mut self, metrics: [Option<f64>; 7]) {
        [
            self.abs_rel,
            self.sq_rel,
            self.rmse,
            self.rmse_log,
            self.a1,
            self.a2,
            self.a3,
        ] = metrics;
    }

    fn problem(&self) -> Option<String> {
        let method = shown(&self.method);
        if let Err(why) = check_name(&self.method) {
            return Some(format!("the method {method} {why}"));
        }
        let prose = [
            ("citation", Some(&self.citation)),
            ("supervision", Some(&self.supervision)),
            ("note", self.note.as_ref()),
        ];
        for (column, text) in prose {
            if let Some(Err(why)) = text.map(|text| check_prose(text)) {
                return Some(format!("{method}: {column} {why}"));
            }
        }
        let Some(rules) = protocol(&self.protocol) else {
            return Some(format!(
                "{method}: {} is not a protocol of this version",
                shown(&self.protocol)
            ));
        };
        let group = self.group.as_deref().map(str::parse::<Group>);
        let fits = match &group {
            None => rules.grouping.groups().is_empty(),
            Some(group) => group
                .as_ref()
                .is_ok_and(|group| rules.grouping.groups().contains(group)),
        };
        if !fits {
            return Some(format!("{method}: the group is none of {}", rules.name));
        }
        let further = [self.silog, self.log10];
        let numbers = self.metrics().into_iter().chain(further).flatten();
        if numbers
            .clone()
            .any(|number| !(number.is_finite() && number >= 0.0))
        {
            return Some(format!("{method}: a number is not finite or below 0"));
        }
        (numbers.count() == 0).then(|| format!("{method} has no numbers"))
    }
}

/// The rows of the thesis' tables and of newer models, as this program has them: file names and
/// rows.
#[must_use]
pub fn built_in() -> [(&'static str, Vec<Published>); 2] {
    let of = |table: ThesisTable| {
        published::rows(table).iter().map(|row| {
            let mut one = Published {
                method: row.method.clone(),
                protocol: row.protocol.clone(),
                supervision: row.supervision.clone(),
                citation: row.citation(),
                silog: row.further[FurtherMetric::Silog as usize],
                log10: row.further[FurtherMetric::Log10 as usize],
                note: row.note.clone(),
                ..Published::default()
            };
            one.set(row.metrics);
            one
        })
    };
    let groups = published::groups().iter().map(|cell| {
        let mut metrics = [None; 7];
        metrics[Metric::Rmse as usize] = Some(cell.rmse);
        let mut one = Published {
            method: cell.method.clone(),
            protocol: cell.protocol.clone(),
            group: Some(cell.group.to_string()),
            supervision: "stereo".to_owned(),
            citation: cell.citation(),
            ..Published::default()
        };
        one.set(metrics);
        one
    });
    let thesis = of(ThesisTable::Table31)
        .chain(of(ThesisTable::Table33))
        .chain(groups);
    [
        ("thesis.csv", thesis.collect()),
        ("newer_models.csv", of(ThesisTable::Eigen652).collect()),
    ]
}

/// All published rows of a leaderboard, with what is wrong with others.
///
/// # Errors
/// The folder cannot be read.
pub fn read(folder: &Path) -> Result<(Vec<Published>, Vec<Problem>), BoardError> {
    let (mut rows, mut problems): (Vec<Published>, Vec<Problem>) = (Vec::new(), Vec::new());
    let own = folder.join(PUBLISHED);
    let mut names = files::names_in(&own)?;
    names.sort();
    for name in names {
        let text = name.to_string_lossy().into_owned();
        let mut tell = |sentence: String| {
            problems.push(Problem {
                path: format!("{PUBLISHED}/{}", shown(&text)),
                sentence,
            });
        };
        if text == "README.md" || text == ".gitkeep" {
            continue;
        }
        let path = own.join(&name);
        let is_file = path.symlink_metadata().is_ok_and(|found| found.is_file());
        if !text.ends_with(".csv") || !is_file {
            tell("only CSV files stand here, no links".to_owned());
            continue;
        }
        let bytes = match inputs::read(&path, Kind::Submission) {
            Ok(bytes) => bytes,
            Err(error) => {
                tell(error.to_string());
                continue;
            }
        };
        match strat_csv::Reader::new(bytes.as_slice()).deserialize::<Published>() {
            Err(error) => tell(format!("it cannot be read: {error}")),
            Ok(read) => {
                for one in read {
                    let key = |row: &Published| {
                        (
                            row.method.clone(),
                            row.protocol.clone(),
                            row.group.clone(),
                            row.citation.clone(),
                        )
                    };
                    if let Some(problem) = one.problem() {
                        tell(problem);
                    } else if rows.iter().any(|other| key(other) == key(&one)) {
                        tell(format!(
                            "{} is listed twice under {}",
                            one.method, one.protocol
                        ));
                    } else {
                        rows.push(one);
                    }
                }
            }
        }
    }
    Ok((rows, problems))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_built_in_rows_pass_their_own_check() {
        for (name, rows) in built_in() {
            assert!(!rows.is_empty());
            for row in &rows {
                assert_eq!(row.problem(), None, "{name}: {row:?}");
            }
        }
        let folder = tempfile::tempdir().unwrap();
        for (name, rows) in built_in() {
            files::write_csv(&folder.path().join(PUBLISHED).join(name), &rows).unwrap();
        }
        let (rows, problems) = read(folder.path()).unwrap();
        assert_eq!((rows.len(), problems), (6 + 17 + 15 + 9, Vec::new()));
        assert_eq!(
            rows[0],
            built_in()[1].1[0],
            "files are read in the order of their names"
        );
    }
}
