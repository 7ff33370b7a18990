//! Leaderboard files: adding measured lines, merging files, and checking lines against the rows
//! they were made of.
//!
//! The lines themselves are [`strat_metrics::leaderboard`]'s. Files are replaced as a whole, so a
//! leaderboard is never half written.

use std::path::{Path, PathBuf};

use serde::Deserialize;
use strat_metrics::{
    Row,
    leaderboard::{self, Entry, Origin},
    rows::RowsError,
    tables::{Coverage, Source},
};
use strat_store::inputs::{self, Kind};
use strat_store::{claim, files, yaml};

use crate::rows::compare::{CompareError, protocols_of, read_rows};

/// Why a leaderboard could not be made or checked.
#[derive(Debug, thiserror::Error)]
pub enum PublishError {
    /// A file cannot be read or written.
    #[error(transparent)]
    Store(#[from] strat_store::Error),
    /// A rows file is none.
    #[error(transparent)]
    Rows(#[from] CompareError),
    /// Rows that do not belong together.
    #[error(transparent)]
    Mixed(#[from] RowsError),
    /// A file is no leaderboard.
    #[error("{path}: {reason}")]
    Csv {
        /// The file.
        path: PathBuf,
        /// Why.
        reason: strat_metrics::CsvError,
    },
    /// Files that contradict each other.
    #[error(transparent)]
    Merge(#[from] strat_metrics::CsvError),
}

/// The parts of `run.yaml` that rows do not carry.
#[derive(Deserialize)]
struct Run {
    data: RunData,
}

#[derive(Deserialize)]
struct RunData {
    source: String,
    test_images_expected: u64,
}

/// What rows are part of: what the `run.yaml` beside the file says, or else the size of the
/// split that the rows name, with a source that competes with nothing.
///
/// # Errors
/// There is a `run.yaml` that cannot be read.
pub fn coverage_of(rows_file: &Path, rows: &[Row]) -> Result<Coverage, PublishError> {
    let beside = rows_file.with_file_name("run.yaml");
    if beside.is_file() {
        let run: Run = yaml::load(&beside)?;
        return Ok(Coverage {
            expected_images: run.data.test_images_expected,
            source: Source::from(run.data.source.as_str()),
        });
    }
    let images: std::collections::BTreeSet<&str> =
        rows.iter().map(|row| row.image.as_str()).collect();
    let found = images.len() as u64;
    let of_split = rows
        .first()
        .and_then(|row| strat_splits::test_images(&row.context.split))
        .map_or(found, |images| images as u64);
    Ok(Coverage {
        expected_images: found.max(of_split),
        source: Source::Unknown,
    })
}

/// Reads a leaderboard.
///
/// # Errors
/// It cannot be read or is none.
pub fn read(path: &Path) -> Result<Vec<Entry>, PublishError> {
    leaderboard::read(inputs::read(path, Kind::Table)?.as_slice()).map_err(|reason| {
        PublishError::Csv {
            path: path.to_owned(),
            reason,
        }
    })
}

fn write(path: &Path, entries: &[Entry]) -> Result<(), PublishError> {
    let mut bytes = Vec::new();
    leaderboard::write(entries, &mut bytes)?;
    claim::remove_leftovers_beside(path)?;
    Ok(files::write_atomic(path, &bytes)?)
}

/// Adds the lines of a rows file to a leaderboard, which is made if it is not there, with the
/// published lines of the same protocols. Returns the number of measured lines and of all.
///
/// # Errors
/// Files that cannot be read or contradict each other; the leaderboard then stays as it was.
pub fn append(
    rows_file: &Path,
    expected_images: Option<u64>,
    to: &Path,
) -> Result<(usize, usize), PublishError> {
    let rows = read_rows(rows_file)?;
    let expected = match expected_images {
        Some(expected) => expected,
        None => coverage_of(rows_file, &rows)?.expected_images,
    };
    let protocols = protocols_of(&rows);
    let mut measured = Vec::new();
    for protocol in &protocols {
        measured.extend(leaderboard::measured(&rows, protocol, expected)?);
    }
    let count = measured.len();
    let published = leaderboard::published()
        .into_iter()
        .filter(|entry| protocols.contains(&entry.protocol))
        .collect();
    let before = if to.is_file() { read(to)? } else { Vec::new() };
    let merged = leaderboard::merge([before, measured, published])?;
    write(to, &merged)?;
    Ok((count, merged.len()))
}

/// Merges leaderboards into one file, with what it has already, and returns its number of lines.
///
/// # Errors
/// Files that cannot be read, or that contradict each other in a figure or a protocol.
pub fn merge(parts: &[PathBuf], to: &Path) -> Result<usize, PublishError> {
    let before = to.is_file().then_some(to);
    let entries: Vec<Vec<Entry>> = parts
        .iter()
        .map(PathBuf::as_path)
        .chain(before)
        .map(read)
        .collect::<Result<_, _>>()?;
    let merged = leaderboard::merge(entries)?;
    write(to, &merged)?;
    Ok(merged.len())
}

/// Outcome of [`verify`].
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Verified {
    /// Measured lines that follow from their rows to the last digit.
    pub good: usize,
    /// Lines that do not, or have no rows here: a sentence each.
    pub bad: Vec<String>,
    /// Published lines that are those of this program.
    pub published: usize,
}

/// Derives every measured line of a leaderboard again from rows files, and compares published
/// ones with this program's copy of the thesis' tables.
///
/// # Errors
/// A file that cannot be read. Lines that do not agree are part of the outcome.
pub fn verify(board: &Path, rows_files: &[PathBuf]) -> Result<Verified, PublishError> {
    let entries = read(board)?;
    let rows: Vec<Vec<Row>> = rows_files
        .iter()
        .map(|path| read_rows(path))
        .collect::<Result<_, _>>()?;
    let published = leaderboard::published();
    let mut derived: Vec<((String, u64), Vec<Entry>)> = Vec::new();
    let mut outcome = Verified::default();
    for entry in &entries {
        let about = format!(
            "{} under {} ({})",
            entry.method, entry.protocol, entry.origin
        );
        let candidates = if entry.origin == Origin::Published {
            &published
        } else {
            let key = (entry.protocol.clone(), entry.expected_images.unwrap_or(0));
            let index = match derived.iter().position(|(known, _)| *known == key) {
                Some(index) => index,
                None => {
                    let mut made = Vec::new();
                    for rows in &rows {
                        made.extend(leaderboard::measured(rows, &key.0, key.1)?);
                    }
                    derived.push((key, made));
                    derived.len() - 1
                }
            };
            &derived[index].1
        };
        let same: Vec<&Entry> = candidates
            .iter()
            .filter(|other| entry.same_measurement(other))
            .collect();
        if same.iter().any(|other| entry.difference(other).is_none()) {
            match entry.origin {
                Origin::Measured => outcome.good += 1,
                Origin::Published => outcome.published += 1,
            }
        } else if let Some(difference) = same.first().and_then(|other| entry.difference(other)) {
            let verdict = match entry.origin {
                Origin::Measured => "does not follow from its rows",
                Origin::Published => "is not what the thesis prints",
            };
            outcome.bad.push(format!("{about} {verdict}: {difference}"));
        } else if entry.origin == Origin::Published {
            outcome
                .bad
                .push(format!("{about} stands in no table of the thesis"));
        } else {
            outcome
                .bad
                .push(format!("{about} has no rows in the files given"));
        }
    }
    Ok(outcome)
}

#[cfg(test)]
mod tests {
    use strat_metrics::{
        GroundTruth, KnownCamera, RowContext, StereoCamera, evaluate_depth, protocol, rows,
    };

    use super::*;

    fn rows_file(folder: &Path, model: &str, factor: f32) -> PathBuf {
        let rules = protocol("eigen-80-nocrop").unwrap();
        let context = RowContext {
            model: model.to_owned(),
            protocol: rules.name.clone(),
            protocol_digest: rules.digest(),
            data_digest: "digest".to_owned(),
            split: "eigen".to_owned(),
            ..RowContext::default()
        };
        let made: Vec<Row> = (0..6_u8)
            .map(|i| {
                let depth_m = [10.0 + f32::from(i), 20.0];
                let camera = KnownCamera {
                    calibration: StereoCamera {
                        focal_px: 700.0,
                        baseline_m: 0.5,
                    },
                    nominal_focal_px: None,
                };
                let truth = GroundTruth::new((2, 1), &depth_m, camera).unwrap();
                let predicted = depth_m.map(|depth| depth * factor + f32::from(i));
                let score = evaluate_depth(&rules, &truth, &predicted).unwrap()[0];
                Row::new(
                    &context,
                    format!("2011_09_26_drive_000{}/{i}", i / 2),
                    score,
                )
            })
            .collect();
        let mut bytes = Vec::new();
        rows::write(&made, &mut bytes).unwrap();
        let path = folder.join(format!("{model}.csv"));
        files::write_atomic(&path, &bytes).unwrap();
        path
    }

    #[test]
    fn lines_are_added_merged_and_derived_again() {
        let folder = tempfile::tempdir().unwrap();
        let (a, b) = (
            rows_file(folder.path(), "a", 1.1),
            rows_file(folder.path(), "b", 1.2),
        );
        let [board, other, all] = ["x", "y", "z"].map(|name| folder.path().join(name));
        assert_eq!(append(&a, None, &board).unwrap(), (1, 1));
        assert_eq!(read(&board).unwrap()[0].expected_images, Some(697));
        // Twice is once.
        assert_eq!(append(&a, None, &board).unwrap(), (1, 1));
        assert_eq!(append(&b, None, &other).unwrap(), (1, 1));
        assert_eq!(merge(&[board.clone(), other], &all).unwrap(), 2);
        let good = verify(&all, &[a.clone(), b.clone()]).unwrap();
        assert_eq!((good.good, good.bad.len()), (2, 0));

        // Rows that are not there, and a figure changed in its last digit.
        let missing = verify(&all, std::slice::from_ref(&a)).unwrap();
        assert!(missing.good == 1 && missing.bad[0].contains("no rows"));
        let mut entries = read(&all).unwrap();
        entries[0].metrics[0] = entries[0].metrics[0].map(f64::next_up);
        write(&all, &entries).unwrap();
        let changed = verify(&all, &[a.clone(), b]).unwrap();
        assert!(changed.bad[0].contains("abs_rel"), "{changed:?}");
        // A contradiction leaves the file as it was.
        let before = std::fs::read(&all).unwrap();
        assert!(append(&a, None, &all).is_err());
        assert_eq!(std::fs::read(&all).unwrap(), before);
    }
}
