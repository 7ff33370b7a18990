//! `bench publish --submission`: the rows of one model as a folder ready to commit.

use std::collections::BTreeSet;
use std::io::Write;
use std::path::{Path, PathBuf};

use flate2::{Compression, GzBuilder};
use serde_yaml::Value;
use strat_metrics::tables::{Coverage, Source};
use strat_metrics::{Row, leaderboard, rows};
use strat_store::claim::Mark;
use strat_store::inputs::{self, Kind};
use strat_store::{files, yaml};

use crate::card;
use crate::rows::{ROWS, ROWS_GZ, by_protocol};
use crate::run::{Run, reduced};
use crate::submission::{CARD, LINES, RUN};
use crate::text::check_name;

/// Whose a submission's folder is. Its card is the contributor's once it is there.
pub const MARK: Mark = Mark {
    command: "bench publish",
    record: RUN,
    begins: "tool: bench\n",
    writes: |name| [ROWS, ROWS_GZ, LINES, RUN, CARD].contains(&name),
};

/// Why there is no submission.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PublishError {
    /// A file cannot be read or written.
    #[error(transparent)]
    Store(#[from] strat_store::Error),
    /// The rows file is none.
    #[error("{path}: {reason}")]
    Rows {
        /// The file.
        path: PathBuf,
        /// Why.
        reason: strat_metrics::CsvError,
    },
    /// Rows that do not belong together.
    #[error(transparent)]
    Mixed(#[from] rows::RowsError),
    /// A table cannot be written.
    #[error(transparent)]
    Csv(#[from] strat_metrics::CsvError),
    /// The rows have no such model, or several.
    #[error("{0}")]
    Choice(String),
    /// There is no record of the run.
    #[error("{} is missing: a submission needs the record that `bench` writes beside the rows", .0.display())]
    NoRun(PathBuf),
}

/// What was written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Written {
    /// The method.
    pub method: String,
    /// Number of rows.
    pub rows: usize,
    /// The protocols.
    pub protocols: Vec<String>,
    /// Images are missing, which the card has to explain.
    pub partial: bool,
    /// A card of the contributor's was there and stays.
    pub kept_card: bool,
}

/// Writes the rows of a model (the only one, unless `model` names it), with the `run.yaml` beside
/// them, into the folder `to`. A card that is there stays as it is.
///
/// # Errors
/// Files that cannot be read or written, several models, or a folder that holds something else.
pub fn publish(rows_file: &Path, model: Option<&str>, to: &Path) -> Result<Written, PublishError> {
    let found = MARK.examine(to, &[rows_file]);
    let record_file = rows_file.with_file_name(RUN);
    if !record_file.is_file() {
        return Err(PublishError::NoRun(record_file));
    }
    found?;
    let record: Value = yaml::load(&record_file)?;
    let run: Run = yaml::load(&record_file)?;
    let all = rows::read(inputs::read(rows_file, Kind::Table)?.as_slice()).map_err(|reason| {
        PublishError::Rows {
            path: rows_file.to_owned(),
            reason,
        }
    })?;
    let model = choose(&all, model, rows_file)?;
    let Some(recorded) = run.models.iter().find(|one| one.name == model) else {
        return Err(PublishError::Choice(format!(
            "{} says nothing of model \"{model}\"; it is not the record of these rows",
            record_file.display()
        )));
    };
    if let Err(why) = check_name(&model) {
        return Err(PublishError::Choice(format!(
            "the name {model:?} {why}; measure again with `--model NAME=FILE`"
        )));
    }
    let own: Vec<Row> = all
        .into_iter()
        .filter(|row| row.context.model == model)
        .collect();
    let coverage = |expected_images| Coverage {
        expected_images,
        source: Source::Unknown,
    };
    let mut lines = Vec::new();
    let mut protocols = Vec::new();
    let mut partial = false;
    for (protocol, rows) in by_protocol(&own) {
        lines.extend(leaderboard::measured(
            &own,
            protocol,
            run.data.test_images_expected,
        )?);
        let images: BTreeSet<&str> = rows.iter().map(|row| row.image.as_str()).collect();
        partial |= (images.len() as u64) < coverage(run.data.test_images_found).under(protocol);
        protocols.push(protocol.to_owned());
    }
    MARK.begin(to)?;
    files::write_atomic(&to.join(ROWS_GZ), &compressed(&own)?)?;
    files::remove(&to.join(ROWS))?;
    let mut bytes = Vec::new();
    leaderboard::write(&lines, &mut bytes)?;
    files::write_atomic(&to.join(LINES), &bytes)?;
    let kept_card = to.join(CARD).exists();
    if !kept_card {
        files::write_atomic(
            &to.join(CARD),
            card::draft(&run, recorded, partial).as_bytes(),
        )?;
    }
    let record = reduced(record, &model);
    MARK.finish(to, yaml::to_string(&record)?.as_bytes())?;
    Ok(Written {
        method: model,
        rows: own.len(),
        protocols,
        partial,
        kept_card,
    })
}

fn choose(rows: &[Row], wanted: Option<&str>, file: &Path) -> Result<String, PublishError> {
    let names: BTreeSet<&str> = rows.iter().map(|row| row.context.model.as_str()).collect();
    let listed = || names.iter().copied().collect::<Vec<_>>().join(", ");
    match (wanted, names.len()) {
        (_, 0) => Err(PublishError::Choice(format!(
            "{} has no rows",
            file.display()
        ))),
        (Some(wanted), _) if names.contains(wanted) => Ok(wanted.to_owned()),
        (Some(wanted), _) => Err(PublishError::Choice(format!(
            "{} has no rows of model \"{wanted}\"; it has {}",
            file.display(),
            listed()
        ))),
        (None, 1) => Ok(listed()),
        (None, _) => Err(PublishError::Choice(format!(
            "{} has rows of several models ({}); a submission is of one, which --model names",
            file.display(),
            listed()
        ))),
    }
}

/// Rows as gzip, the same bytes for the same rows.
fn compressed(own: &[Row]) -> Result<Vec<u8>, PublishError> {
    let mut out = GzBuilder::new()
        .mtime(0)
        .write(Vec::new(), Compression::best());
    rows::write(own, &mut out)?;
    out.flush()
        .and_then(|()| out.finish())
        .map_err(strat_metrics::CsvError::from)
        .map_err(PublishError::from)
}
