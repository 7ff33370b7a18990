//! A run that is divided among machines, and its parts put together.
//!
//! Every machine gets the same data, models, options and output folder, and a
//! [`Shard`]. A part leaves what any run leaves (`rows.csv`, `failures.csv`, `run.yaml`), the
//! list of its images and how each of them agrees with the truth ([`agreed`]) in a folder of its own,
//! `parts/0003-of-0008/`. [`merge`] checks that all parts are there and of one kind and puts their rows
//! into the order of an undivided run, so that tables and leaderboard come out byte for byte the same, and so
//! does what is said of each model.
//!
//! Nothing here starts processes on other machines; that is the work of Slurm or any other queue.

use std::{
    collections::HashMap,
    path::{Path, PathBuf},
};

use serde::{Deserialize, Serialize};
use strat_metrics::{Row, rows};
use strat_onnx::metadata::OutputMeaning;
use strat_store::inputs::{self, Kind};
use strat_store::{
    files,
    shard::{PARTS, Shard},
    yaml,
};

use super::{
    agreed::{self, AGREEMENTS},
    agreement::{Agreement, ImageAgreement},
    findings::{Remark, remarks},
    record::{self, FAILURES, Failure, Outcome, RECORD, ROWS, RunRecord},
    suspicion::{FIRST_IMAGES, Look, suspicions},
};

/// The images of a part with their positions in the test list.
pub const IMAGES: &str = "images.csv";

/// Why parts cannot be put together.
#[derive(Debug, thiserror::Error)]
pub enum ShardsError {
    /// A file could not be read or written.
    #[error(transparent)]
    Store(#[from] strat_store::Error),
    /// A file is not what a run has written.
    #[error("{} cannot be used: {reason}", path.display())]
    Unusable {
        /// The file or folder.
        path: PathBuf,
        /// A sentence.
        reason: String,
    },
    /// Parts that were never measured, or not to the end.
    #[error(
        "{} of {count} parts in {} are missing or unfinished: run again with the same options and \
         --shard {}", missing.len(), folder.display(), missing.join(", --shard ")
    )]
    Missing {
        /// The output folder.
        folder: PathBuf,
        /// The parts as `--shard` takes them.
        missing: Vec<String>,
        /// How many there should be.
        count: u32,
    },
    /// Parts of different runs.
    #[error(
        "parts {first} and {other} in {} do not belong together: {what}; measure one of them \
         again", folder.display()
    )]
    Different {
        /// The output folder.
        folder: PathBuf,
        /// A part.
        first: Shard,
        /// Another.
        other: Shard,
        /// What differs, as a sentence.
        what: String,
    },
}

#[derive(Serialize, Deserialize)]
struct ListedImage {
    position: usize,
    image: String,
}

/// Lists the images of the part in `folder`; `order` is the whole test list.
///
/// # Errors
/// The folder cannot be written to.
pub fn begin(folder: &Path, order: &[String], shard: Shard) -> Result<(), ShardsError> {
    files::write_atomic_with(&folder.join(IMAGES), |file| {
        let mut csv = strat_csv::Writer::new(file);
        for (position, image) in order.iter().enumerate() {
            if shard.has(image) {
                let image = image.clone();
                csv.serialize(ListedImage { position, image })
                    .map_err(std::io::Error::other)?;
            }
        }
        csv.flush()
    })?;
    Ok(())
}

struct Part {
    shard: Shard,
    images: Vec<ListedImage>,
    outcome: Outcome,
}

/// Reads all parts in `out` and puts them together; with what there is to say about the models, which the
/// record has as far as it is a warning.
///
/// # Errors
/// There are none, some are missing or unfinished, they do not belong together, or a file is
/// broken.
pub fn merge(out: &Path) -> Result<(Outcome, Vec<Remark>), ShardsError> {
    let wrong = |reason: &str| ShardsError::Unusable {
        path: out.to_path_buf(),
        reason: reason.to_owned(),
    };
    // A merge that was killed while it removed the parts has left what was left of them.
    files::remove_leftovers_among(out, |name| name == PARTS)?;
    let found = Shard::found_in(out).map_err(|reason| wrong(&reason))?;
    let Some(count) = found.first().map(|shard| shard.count) else {
        return Err(wrong(if out.join(RECORD).is_file() {
            "it has no parts and is a finished run: nothing is left to merge"
        } else {
            "it has no parts; run `bench --table ... --shard 0/N` to N-1/N with this folder as --out \
             first"
        }));
    };
    if found.iter().any(|shard| shard.count != count) {
        return Err(wrong(&format!(
            "it has parts of different divisions; remove those that are not meant from {PARTS}/"
        )));
    }
    let (mut parts, mut missing) = (Vec::new(), Vec::new());
    for index in 0..count {
        let shard = Shard { index, count };
        let folder = shard.folder(out);
        if folder.join(RECORD).is_file() {
            parts.push(read(&folder, shard)?);
        } else {
            missing.push(shard.to_string());
        }
    }
    if !missing.is_empty() {
        return Err(ShardsError::Missing {
            folder: out.to_path_buf(),
            missing,
            count,
        });
    }
    for pair in parts.windows(2) {
        if let [a, b] = pair
            && let Some(what) = difference(&a.outcome.record, &b.outcome.record)
        {
            return Err(ShardsError::Different {
                folder: out.to_path_buf(),
                first: a.shard,
                other: b.shard,
                what,
            });
        }
    }
    let mut images: Vec<ListedImage> = Vec::new();
    for part in &mut parts {
        images.append(&mut part.images);
    }
    images.sort_by_key(|image| image.position);
    if images.iter().enumerate().any(|(at, p)| p.position != at) {
        return Err(wrong(
            "its parts do not cover the test list, or images are in two of them; measure all again",
        ));
    }
    let order: Vec<String> = images.into_iter().map(|image| image.image).collect();
    let mut beside = Vec::new();
    for part in &parts {
        let found = beside_findings(&part.outcome.record).map_err(|reason| {
            let path = part.shard.folder(out).join(RECORD);
            ShardsError::Unusable { path, reason }
        })?;
        beside.push(found.into_iter().map(<[String]>::to_vec).collect());
    }
    let mut whole = joined(parts, &order).ok_or_else(|| wrong("it has no parts"))?;
    let said = find(&mut whole, &beside, &order);
    Ok((whole, said))
}

/// The parts in the order of an undivided run, but for what follows from rows and maps.
fn joined(parts: Vec<Part>, order: &[String]) -> Option<Outcome> {
    let mut parts = parts.into_iter().map(|part| part.outcome);
    let mut whole = parts.next()?;
    let record = &mut whole.record;
    record.shard = None;
    for part in parts {
        whole.rows.extend(part.rows);
        whole.failures.extend(part.failures);
        whole.agreed.extend(part.agreed);
        record.complete &= part.record.complete;
        for (model, own) in record.models.iter_mut().zip(part.record.models) {
            model.images += own.images;
            model.seconds += own.seconds;
        }
    }
    record.failures = whole.failures.len();
    let models: Vec<&str> = record.models.iter().map(|m| m.name.as_str()).collect();
    let protocols: Vec<&str> = record.protocols.iter().map(|p| p.name.as_str()).collect();
    let images: Vec<&str> = order.iter().map(String::as_str).collect();
    record::sort_rows(&mut whole.rows, &models, &protocols, &images);
    let positions: HashMap<&str, usize> = images.into_iter().zip(0..).collect();
    whole.failures.sort_by_key(|failure| {
        (
            models.iter().position(|model| *model == failure.model),
            positions.get(failure.image.as_str()).copied(),
        )
    });
    whole.agreed.sort_by_key(|agreed| {
        (
            models.iter().position(|model| *model == agreed.model),
            positions.get(agreed.image.as_str()).copied(),
        )
    });
    Some(whole)
}

/// What a part warned of that does not follow from its rows and maps: before what followed of each model,
/// and after the last.
fn beside_findings(record: &RunRecord) -> Result<Vec<&[String]>, String> {
    let mut left = record.warnings.as_slice();
    let mut taken = 0;
    let mut beside = Vec::new();
    for model in &record.models {
        let [first, end] = model.findings.unwrap_or_default();
        let own = first.checked_sub(taken).filter(|own| *own <= left.len());
        let findings = end.checked_sub(first);
        let (Some(own), Some(findings)) = (own, findings) else {
            return Err(format!(
                "`findings` of the model {} are none of its warnings; measure the part again",
                model.name
            ));
        };
        let (before, rest) = left.split_at(own);
        beside.push(before);
        left = rest.get(findings..).unwrap_or_default();
        taken = end;
    }
    beside.push(left);
    Ok(beside)
}

/// Says of the whole what an undivided run says of it, where `parts` have warned of their own; `order` is
/// the whole test list.
fn find(whole: &mut Outcome, parts: &[Vec<Vec<String>>], order: &[String]) -> Vec<Remark> {
    let mut said = Vec::new();
    let mut warnings: Vec<String> = Vec::new();
    let take_over = |warnings: &mut Vec<String>, place: usize| {
        for warning in parts.iter().filter_map(|part| part.get(place)).flatten() {
            if !warnings.contains(warning) {
                warnings.push(warning.clone());
            }
        }
    };
    let first = &order[..order.len().min(FIRST_IMAGES)];
    for (place, model) in whole.record.models.iter_mut().enumerate() {
        take_over(&mut warnings, place);
        let agreed = || whole.agreed.iter().filter(|one| one.model == model.name);
        let agreements: Vec<ImageAgreement> = agreed().map(|one| one.agreement).collect();
        let looks: Vec<Look> = agreed()
            .filter(|one| first.contains(&one.image))
            .filter_map(|one| one.look.clone())
            .collect();
        model.agreement = Agreement::of(&agreements);
        model.findings = None;
        let encoding = model.encoding();
        let suspicions = encoding.map_or_else(Vec::new, |encoding| suspicions(&looks, &encoding));
        let rows: Vec<Row> = whole
            .rows
            .iter()
            .filter(|row| row.context.model == model.name)
            .cloned()
            .collect();
        let gives_depth =
            encoding.is_some_and(|encoding| encoding.meaning() == OutputMeaning::DepthM);
        let is_suspected = !suspicions.is_empty();
        let suspicions = suspicions.into_iter();
        let suspicions = suspicions.map(|text| Remark::Warning(format!("{}: {text}", model.name)));
        let mut found: Vec<Remark> = suspicions.collect();
        found.extend(remarks(
            &model.name,
            &rows,
            model.agreement,
            gives_depth,
            is_suspected,
        ));
        warnings.extend(found.iter().filter_map(|remark| match remark {
            Remark::Warning(text) => Some(text.clone()),
            Remark::Figure(_) | Remark::Note(_) => None,
        }));
        said.extend(found);
    }
    take_over(&mut warnings, whole.record.models.len());
    whole.record.warnings = warnings;
    said
}

/// What makes two parts parts of different runs.
fn difference(a: &RunRecord, b: &RunRecord) -> Option<String> {
    let names = |record: &RunRecord| -> Vec<String> {
        let models = record.models.iter();
        models.map(|model| model.name.clone()).collect()
    };
    let digests = |record: &RunRecord| -> Vec<(String, String)> {
        let protocols = record.protocols.iter();
        protocols
            .map(|p| (p.name.clone(), p.digest.clone()))
            .collect()
    };
    if a.data.data_digest != b.data.data_digest {
        return Some("the digest of the prepared set differs".to_owned());
    }
    if a.tool_version != b.tool_version {
        return Some("the version of bench differs".to_owned());
    }
    if names(a) != names(b) {
        return Some("the list of models differs".to_owned());
    }
    if digests(a) != digests(b) || a.tables != b.tables {
        return Some("the list of tables or protocols differs".to_owned());
    }
    a.models.iter().zip(&b.models).find_map(|(a, b)| {
        let changes = a.facts().changes_to(&b.facts())?;
        Some(format!("of model {}, {changes}", a.name))
    })
}

fn read(folder: &Path, shard: Shard) -> Result<Part, ShardsError> {
    let unusable = |name: &str, reason: String| ShardsError::Unusable {
        path: folder.join(name),
        reason,
    };
    let record: RunRecord = yaml::load(&folder.join(RECORD))?;
    let is_empty = record.models.iter().all(|model| model.images == 0);
    // A part without rows has no file of them.
    let rows = match inputs::read(&folder.join(ROWS), Kind::Table) {
        Ok(bytes) => rows::read(bytes.as_slice()).map_err(|e| unusable(ROWS, e.to_string()))?,
        Err(error) if error.is_not_found() && is_empty => Vec::new(),
        Err(error) => return Err(error.into()),
    };
    let images: Vec<ListedImage> = table(&inputs::read(&folder.join(IMAGES), Kind::Table)?)
        .map_err(|error| unusable(IMAGES, error.to_string()))?;
    let failures: Vec<Failure> = match inputs::read(&folder.join(FAILURES), Kind::Table) {
        Ok(bytes) => table(&bytes).map_err(|error| unusable(FAILURES, error.to_string()))?,
        Err(error) if error.is_not_found() => Vec::new(),
        Err(error) => return Err(error.into()),
    };
    if failures.len() != record.failures {
        let reason = format!(
            "it lists {} failures, but the run had {}; measure the part again",
            failures.len(),
            record.failures
        );
        return Err(unusable(FAILURES, reason));
    }
    let agreed = agreed::read(folder).map_err(|reason| unusable(AGREEMENTS, reason))?;
    Ok(Part {
        shard,
        images,
        outcome: Outcome {
            record,
            rows,
            failures,
            agreed,
        },
    })
}

fn table<T: serde::de::DeserializeOwned>(bytes: &[u8]) -> Result<Vec<T>, strat_csv::Error> {
    strat_csv::Reader::new(bytes).deserialize()
}
