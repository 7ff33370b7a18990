//! What a run has measured so far, so that an interrupted one goes on where it stopped.
//!
//! A file of rows per model in the output folder, to which the rows of each image are added as
//! soon as they are there, and beside it what they were measured with and how each image agrees with
//! the truth ([`ImageAgreement`]), which rows do not say. The next run of the same
//! models on the same data under the same protocols, with the same runtime and program, takes them
//! over; anything else is measured again, and it is said what has changed. A finished run removes
//! its journals.
//!
//! The last image of a journal may be there in part, so it is measured again as well, and so is one
//! whose agreement is not known.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
};

use serde::{Deserialize, Serialize};
use strat_metrics::{CsvError, Row, RowContext, rows};
use strat_store::files::{self, Appending};
use strat_store::inputs::{self, Kind};
use strat_store::yaml;

use super::{agreement::ImageAgreement, identity::Identity};

/// Beginning of the names of journals.
pub const PREFIX: &str = "unfinished-";

/// Why a journal cannot be kept.
#[derive(Debug, thiserror::Error)]
pub enum JournalError {
    /// The file could not be replaced.
    #[error(transparent)]
    Store(#[from] strat_store::Error),
    /// Rows could not be formed or added.
    #[error("{} cannot be written: {reason}", path.display())]
    Rows {
        /// The journal.
        path: PathBuf,
        /// Why.
        reason: CsvError,
    },
}

/// The open journal of one model.
pub struct Journal {
    path: PathBuf,
    rows: Appending,
    agreements: Appending,
}

/// What was measured of one image.
#[derive(Clone, Debug, PartialEq)]
pub struct OfImage {
    /// Its rows under all protocols.
    pub rows: Vec<Row>,
    /// How its depth lies beside the truth; none where no protocol scores it as a whole.
    pub agreement: Option<ImageAgreement>,
}

/// A line of the file of agreements.
#[derive(Serialize, Deserialize)]
struct Line {
    image: String,
    ratio: Option<f64>,
    rank_correlation: Option<f64>,
    /// Whether there is an agreement, which may be one of nothing known.
    is_known: bool,
}

impl Line {
    fn new(image: &str, agreement: Option<ImageAgreement>) -> Self {
        Self {
            image: image.to_owned(),
            ratio: agreement.and_then(|one| one.ratio),
            rank_correlation: agreement.and_then(|one| one.rank_correlation),
            is_known: agreement.is_some(),
        }
    }

    fn agreement(&self) -> Option<ImageAgreement> {
        self.is_known.then_some(ImageAgreement {
            ratio: self.ratio,
            rank_correlation: self.rank_correlation,
        })
    }
}

/// What an interrupted run has left.
#[derive(Debug, Default, PartialEq)]
pub struct Before {
    /// Images that have rows under each protocol and whose agreement is known, by their ids.
    pub images: BTreeMap<String, OfImage>,
    /// What has changed since, where rows cannot be used for it.
    pub changes: Option<String>,
}

/// Removes a journal.
///
/// # Errors
/// A file cannot be removed.
pub fn remove(path: &Path) -> Result<(), strat_store::Error> {
    files::remove(path)?;
    files::remove(&agreements_path(path))?;
    files::remove(&facts_path(path))
}

fn facts_path(path: &Path) -> PathBuf {
    path.with_extension("yaml")
}

/// Not of the extension of rows: `a.agreement` may be the name of another model.
fn agreements_path(path: &Path) -> PathBuf {
    path.with_extension("agreement")
}

impl Journal {
    /// Opens the journal at `path` and returns with it what an interrupted run left there that has
    /// one of `contexts`. `facts` are what the contexts depend on, one by one.
    ///
    /// # Errors
    /// The file cannot be written. One that cannot be read is begun anew.
    pub fn open(
        path: &Path,
        contexts: &[RowContext],
        facts: &Identity,
    ) -> Result<(Self, Before), JournalError> {
        let mut found = read(path);
        let is_other = |row: &Row| !contexts.contains(&row.context);
        let known: Option<Identity> = yaml::load(&facts_path(path)).ok();
        // Rows do not carry all that they depend on.
        let changes = (found.iter().any(is_other) || known.as_ref() != Some(facts)).then(|| {
            let changes = known.and_then(|known| known.changes_to(facts));
            changes.unwrap_or_else(|| "it is not known what it was measured with".to_owned())
        });
        let changes = changes.filter(|_| !found.is_empty());
        if changes.is_some() {
            found.clear();
        }
        let last = found.last().map(|row| row.image.clone());
        let mut by_image: BTreeMap<String, Vec<Row>> = BTreeMap::new();
        for row in found {
            if contexts.contains(&row.context) && Some(&row.image) != last.as_ref() {
                by_image.entry(row.image.clone()).or_default().push(row);
            }
        }
        by_image.retain(|_, rows| {
            let protocols: BTreeSet<&str> =
                rows.iter().map(|r| r.context.protocol.as_str()).collect();
            protocols.len() == contexts.len()
        });
        let agreements = read_agreements(&agreements_path(path));
        let images: BTreeMap<String, OfImage> = by_image
            .into_iter()
            .filter_map(|(image, rows)| {
                let agreement = *agreements.get(&image)?;
                Some((image, OfImage { rows, agreement }))
            })
            .collect();
        let failed = |reason| JournalError::Rows {
            path: path.to_path_buf(),
            reason,
        };
        let kept: Vec<Row> = images.values().flat_map(|one| one.rows.clone()).collect();
        let mut bytes = Vec::new();
        rows::begin(&kept, &mut bytes).map_err(failed)?;
        let lines = images
            .iter()
            .map(|(image, one)| Line::new(image, one.agreement));
        let lines = written(lines).map_err(failed)?;
        // Rows are of what the files beside them say, so these come when no other rows are there.
        if kept.is_empty() {
            files::remove(path)?;
        }
        files::write_atomic(&facts_path(path), yaml::to_string(facts)?.as_bytes())?;
        files::write_atomic(&agreements_path(path), &lines)?;
        files::write_atomic(path, &bytes)?;
        let journal = Self {
            path: path.to_path_buf(),
            rows: Appending::open(path)?,
            agreements: Appending::open(&agreements_path(path))?,
        };
        Ok((journal, Before { images, changes }))
    }

    /// Adds one image, if it has rows.
    ///
    /// # Errors
    /// The disk is full or gone.
    pub fn add(
        &mut self,
        rows: &[Row],
        agreement: Option<ImageAgreement>,
    ) -> Result<(), JournalError> {
        let Some(first) = rows.first() else {
            return Ok(());
        };
        let failed = |reason| JournalError::Rows {
            path: self.path.clone(),
            reason,
        };
        let line = written([Line::new(&first.image, agreement)]).map_err(failed)?;
        let mut bytes = Vec::new();
        rows::append(rows, &mut bytes).map_err(failed)?;
        self.agreements.add(&line)?;
        // One call of the system for each image, so that images stay together.
        Ok(self.rows.add(&bytes)?)
    }
}

/// Lines of the file of agreements, which has no header.
fn written(lines: impl IntoIterator<Item = Line>) -> Result<Vec<u8>, CsvError> {
    let mut csv = strat_csv::Writer::appending(Vec::new());
    for line in lines {
        csv.serialize(line)?;
    }
    Ok(csv.into_inner()?)
}

/// The rows of a file; none if it is not there or something else.
fn read(path: &Path) -> Vec<Row> {
    rows::read(whole_lines(path).as_slice()).unwrap_or_default()
}

/// The agreements of a file by image, of which each may have none.
fn read_agreements(path: &Path) -> BTreeMap<String, Option<ImageAgreement>> {
    let bytes = whole_lines(path);
    let lines = strat_csv::Reader::without_header(bytes.as_slice()).deserialize::<Line>();
    let lines = lines.unwrap_or_default().into_iter();
    lines
        .map(|line| (line.image.clone(), line.agreement()))
        .collect()
}

/// A file up to its last whole line; nothing if it is not there.
fn whole_lines(path: &Path) -> Vec<u8> {
    let mut bytes = inputs::read(path, Kind::Table).unwrap_or_default();
    let end = bytes.iter().rposition(|&b| b == b'\n');
    bytes.truncate(end.map_or(0, |at| at + 1));
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;
    use strat_metrics::{ImageScore, Metrics};

    fn contexts() -> Vec<RowContext> {
        ["a", "b"]
            .map(|protocol| RowContext {
                model: "m".to_owned(),
                protocol: protocol.to_owned(),
                protocol_digest: "d".to_owned(),
                data_digest: "e".to_owned(),
                ..RowContext::default()
            })
            .into()
    }

    fn facts(data: &str) -> Identity {
        let mut facts = Identity::of_bytes("f");
        facts.add("prepared set", data);
        facts
    }

    fn rows_of(image: &str) -> Vec<Row> {
        let metrics = Metrics {
            abs_rel: 0.1,
            sq_rel: 1.0 / 3.0,
            rmse: 4.0,
            rmse_log: 0.2,
            a1: 0.9,
            a2: 0.95,
            a3: 0.99,
        };
        let score = ImageScore {
            group: None,
            metrics,
            further: None,
            d1_all: None,
            sum_squared_error: 16.0,
            pixels: 1,
            floored_pixels: 0,
            fit: None,
        };
        let row = |context: &RowContext| Row::new(context, image, score);
        contexts().iter().map(row).collect()
    }

    const AGREEMENT: Option<ImageAgreement> = Some(ImageAgreement {
        ratio: Some(1.0 / 3.0),
        rank_correlation: None,
    });

    /// A journal of three images.
    fn written(folder: &Path) -> PathBuf {
        let path = folder.join("unfinished-m.csv");
        let (mut journal, before) = Journal::open(&path, &contexts(), &facts("e")).unwrap();
        assert_eq!(before, Before::default());
        for image in ["x/1", "x/2", "x/3"] {
            journal.add(&rows_of(image), AGREEMENT).unwrap();
        }
        path
    }

    fn images(path: &Path, contexts: &[RowContext]) -> Vec<String> {
        let (_, found) = Journal::open(path, contexts, &facts("e")).unwrap();
        found.images.into_keys().collect()
    }

    #[test]
    fn wherever_it_was_cut_only_whole_images_come_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = written(folder.path());
        let whole = std::fs::read(&path).unwrap();
        let agreements = std::fs::read(agreements_path(&path)).unwrap();
        let mut most = 0;
        for end in 0..=whole.len() {
            std::fs::write(&path, &whole[..end]).unwrap();
            let (_, found) = Journal::open(&path, &contexts(), &facts("e")).unwrap();
            let found = found.images;
            for (image, one) in &found {
                assert_eq!(one.rows, rows_of(image));
                assert_eq!(one.agreement, AGREEMENT);
            }
            std::fs::write(agreements_path(&path), &agreements).unwrap();
            assert!(found.len() >= most, "cut at {end}");
            most = found.len();
        }
        assert_eq!(most, 2);
    }

    #[test]
    fn what_was_kept_is_kept_again() {
        let folder = tempfile::tempdir().unwrap();
        let path = written(folder.path());
        assert_eq!(images(&path, &contexts()), ["x/1", "x/2"]);
        let (mut journal, _) = Journal::open(&path, &contexts(), &facts("e")).unwrap();
        journal.add(&rows_of("x/9"), None).unwrap();
        drop(journal);
        assert_eq!(images(&path, &contexts()), ["x/1"]);
    }

    #[test]
    fn images_without_their_agreement_are_measured_again() {
        let folder = tempfile::tempdir().unwrap();
        let path = written(folder.path());
        let agreements = std::fs::read_to_string(agreements_path(&path)).unwrap();
        let first: String = agreements.split_inclusive('\n').take(1).collect();
        std::fs::write(agreements_path(&path), first + "x/2,0.5").unwrap();
        assert_eq!(images(&path, &contexts()), ["x/1"]);
        std::fs::remove_file(agreements_path(&path)).unwrap();
        assert!(images(&path, &contexts()).is_empty());
    }

    #[test]
    fn what_has_changed_is_said() {
        let folder = tempfile::tempdir().unwrap();
        let path = written(folder.path());
        let mut other = contexts();
        for context in &mut other {
            context.data_digest = "other".to_owned();
        }
        let (_, before) = Journal::open(&path, &other, &facts("other")).unwrap();
        assert!(before.images.is_empty());
        assert_eq!(before.changes.unwrap(), "prepared set was e and is other");
        // Once said, it is begun anew.
        let (_, before) = Journal::open(&path, &other, &facts("other")).unwrap();
        assert_eq!(before.changes, None);
        remove(&path).unwrap();
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }

    #[test]
    fn other_models_data_and_protocols_are_measured_again() {
        let folder = tempfile::tempdir().unwrap();
        let path = written(folder.path());
        let mut other = contexts();
        other[1].protocol_digest = "changed".to_owned();
        assert!(images(&path, &other).is_empty());
        let path = written(folder.path());
        let more = [contexts(), vec![RowContext::default()]].concat();
        assert!(images(&path, &more).is_empty());
        std::fs::write(&path, b"something\nelse\n").unwrap();
        assert!(images(&path, &contexts()).is_empty());
    }
}
