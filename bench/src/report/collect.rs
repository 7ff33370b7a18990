//! Finds and reads the results below a folder.

use std::{
    collections::HashSet,
    fs,
    path::{Path, PathBuf},
};

use strat_metrics::{Row, RowContext, rows, tables::Coverage};
use strat_store::inputs::{self, Kind};
use strat_store::{shard::PARTS, yaml};

use super::study::StudyResults;
use crate::{
    cues::rows::{self as cue_rows, CueRow},
    draw::comparison,
    evaluate::record::{self, RunRecord},
    latency::{self, LatencyRow},
    rows::compare,
    rows::leaderboard,
    study::measure::MEASURED,
};

/// Folders below the one that is asked for, at most.
const DEEPEST: usize = 4;

/// Why there is no page.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// No such folder.
    #[error("results folder not found: {}", .0.display())]
    NoFolder(PathBuf),
    /// Nothing to report.
    #[error(
        "no results below {}: no folder with rows.csv, latency.csv or cues.csv; \
         `bench --table all --data SET --model MODEL.onnx --out {folder}` makes some",
        .0.display(), folder = .0.display()
    )]
    Empty(PathBuf),
    /// Results that all cannot be read.
    #[error("nothing below {} can be read: {}", folder.display(), problems.join("; "))]
    Unreadable {
        /// The folder.
        folder: PathBuf,
        /// A sentence for each file.
        problems: Vec<String>,
    },
}

/// All results below a folder.
#[derive(Debug, Default)]
pub struct Collected {
    /// Runs by the data they were measured on.
    pub data_sets: Vec<DataSet>,
    /// All measurements of time.
    pub latency: Vec<LatencyRow>,
    /// Tests of depth cues.
    pub cues: Vec<CueResults>,
    /// Answers of studies.
    pub studies: Vec<StudyResults>,
    /// A sentence for each file that could not be read or used.
    pub problems: Vec<String>,
}

/// Runs over the same data.
#[derive(Debug)]
pub struct DataSet {
    /// The runs, by path.
    pub runs: Vec<Run>,
    /// Their rows.
    pub rows: Vec<Row>,
    /// What they are part of.
    pub coverage: Coverage,
}

/// A folder with rows.
#[derive(Debug)]
pub struct Run {
    /// The folder.
    pub folder: PathBuf,
    /// What ran, where `run.yaml` says so.
    pub record: Option<RunRecord>,
}

/// A folder of `bench cues`.
#[derive(Debug)]
pub struct CueResults {
    /// The folder.
    pub folder: PathBuf,
    /// Its rows.
    pub rows: Vec<CueRow>,
}

/// Reads everything below a folder. What cannot be read is named in [`Collected::problems`] and
/// costs itself only.
///
/// # Errors
/// There is no such folder, or nothing in it.
pub fn collect(folder: &Path) -> Result<Collected, ReportError> {
    if !folder.is_dir() {
        return Err(ReportError::NoFolder(folder.to_owned()));
    }
    let mut collected = Collected::default();
    visit(folder, 0, &mut collected);
    // The order of the thesis.
    let rank = |set: &DataSet| {
        let split = set.rows.first().map(|row| row.context.split.as_str());
        split.and_then(|split| ["kitti", "eigen"].iter().position(|known| split == *known))
    };
    collected
        .data_sets
        .sort_by_key(|set| rank(set).unwrap_or(usize::MAX));
    let Collected {
        data_sets,
        latency,
        cues,
        studies,
        problems,
    } = &collected;
    match (
        data_sets.is_empty() && latency.is_empty() && cues.is_empty() && studies.is_empty(),
        problems.is_empty(),
    ) {
        (false, _) => Ok(collected),
        (true, true) => Err(ReportError::Empty(folder.to_owned())),
        (true, false) => Err(ReportError::Unreadable {
            folder: folder.to_owned(),
            problems: collected.problems,
        }),
    }
}

fn visit(folder: &Path, depth: usize, collected: &mut Collected) {
    match StudyResults::read(folder) {
        Ok(found) => collected.studies.extend(found),
        Err(problem) => collected.problems.push(problem),
    }
    if let Err(problem) = read(folder, collected) {
        collected.problems.push(problem);
    }
    if depth == DEEPEST {
        return;
    }
    let entries = match fs::read_dir(folder) {
        Ok(entries) => entries,
        Err(error) => {
            let problem = format!("{} cannot be listed: {error}", folder.display());
            return collected.problems.push(problem);
        }
    };
    let mut below: Vec<PathBuf> = entries
        .flatten()
        // A link could lead back here.
        .filter(|entry| entry.file_type().is_ok_and(|kind| kind.is_dir()))
        .filter(|entry| {
            let name = entry.file_name();
            ![PARTS, comparison::FOLDER, MEASURED]
                .iter()
                .any(|known| name == *known)
        })
        .map(|entry| entry.path())
        .collect();
    below.sort();
    for folder in below {
        visit(&folder, depth + 1, collected);
    }
}

impl Collected {
    /// Whether the rows of a run are those of a study, whose models are seeds of its variants.
    pub(super) fn is_of_study(&self, run: &Run) -> bool {
        self.studies.iter().any(|study| study.folder == run.folder)
    }
}

/// Reads what lies in one folder; a sentence about the first file that cannot be read.
fn read(folder: &Path, collected: &mut Collected) -> Result<(), String> {
    let latency = folder.join("latency.csv");
    if latency.is_file() {
        let told = |error: &dyn std::fmt::Display| format!("{}: {error}", latency.display());
        let file = inputs::open(&latency, Kind::Table).map_err(|error| error.to_string())?;
        let rows = latency::read_rows(file).map_err(|error| told(&error))?;
        collected.latency.extend(rows);
    }
    if folder.join(cue_rows::ROWS).is_file() {
        let rows = cue_rows::read(folder).map_err(|error| error.to_string())?;
        collected.cues.push(CueResults {
            folder: folder.to_owned(),
            rows,
        });
    }
    let file = folder.join(record::ROWS);
    if !file.is_file() {
        return Ok(());
    }
    let rows = compare::read_rows(&file).map_err(|error| error.to_string())?;
    if rows.is_empty() {
        return Err(format!(
            "{} has no rows: nothing was measured",
            file.display()
        ));
    }
    let record_file = folder.join(record::RECORD);
    let record: Option<RunRecord> = if record_file.is_file() {
        Some(yaml::load(&record_file).map_err(|error| error.to_string())?)
    } else {
        None
    };
    let coverage = leaderboard::coverage_of(&file, &rows).map_err(|error| error.to_string())?;
    add(
        Run {
            folder: folder.to_owned(),
            record,
        },
        rows,
        coverage,
        &mut collected.data_sets,
    )
    .map_err(|problem| format!("{}: {problem}", file.display()))
}

/// Puts a run with others over the same data.
fn add(
    run: Run,
    rows: Vec<Row>,
    coverage: Coverage,
    data_sets: &mut Vec<DataSet>,
) -> Result<(), strat_metrics::CsvError> {
    let digest = |rows: &[Row]| rows.first().map(|row| row.context.data_digest.clone());
    let same =
        |known: &&mut DataSet| digest(&known.rows) == digest(&rows) && known.coverage == coverage;
    match data_sets.iter_mut().find(same) {
        None => data_sets.push(DataSet {
            runs: vec![run],
            rows,
            coverage,
        }),
        Some(known) => {
            // Models keep the order in which they were found; a run that was copied counts once.
            let both = [known.rows.clone(), rows.clone()];
            rows::merge(both)?;
            let key = |row: &Row| {
                let RowContext {
                    model, protocol, ..
                } = &row.context;
                (
                    model.clone(),
                    protocol.clone(),
                    row.image.clone(),
                    row.score.group,
                )
            };
            let before: HashSet<_> = known.rows.iter().map(key).collect();
            known
                .rows
                .extend(rows.into_iter().filter(|row| !before.contains(&key(row))));
            known.runs.push(run);
        }
    }
    Ok(())
}
