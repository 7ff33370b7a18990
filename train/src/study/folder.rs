//! The folder of a study: what was asked and the list of runs, written before any run.
//!
//! Several processes may work in it, each on runs of its own (tasks of a cluster): what they write here is
//! the same, under a lock.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use serde_yaml::Value;
use strat_store::claim::Mark;
use strat_store::{fault, files, yaml};

use super::plan::{Study, StudyRun};
use crate::config::Config;
use crate::error::{Error, Result};

const RECORD: &str = "study.yaml";
/// The list of runs.
pub const RUNS: &str = "runs.csv";
/// Locked while the two files are looked at and written; it holds nothing.
const LOCK: &str = ".lock";

/// What tells the folder of a study from others. Runs bear marks of their own.
const MARK: Mark = Mark {
    command: "train study",
    record: RECORD,
    begins: "tool: train study\n",
    writes: |name| [RECORD, RUNS].contains(&name),
};

/// `study.yaml`.
#[derive(Serialize, Deserialize)]
struct Record {
    tool: String,
    version: String,
    base: String,
    seeds: Vec<u64>,
    data: Vec<SetRecord>,
    evaluation: Value,
    variants: Vec<VariantRecord>,
}

#[derive(Serialize, Deserialize)]
struct SetRecord {
    folder: PathBuf,
    split: String,
    digest: String,
}

/// A variant with all settings that it has on the first set, under the first seed.
#[derive(Serialize, Deserialize)]
struct VariantRecord {
    name: String,
    config: Config,
}

/// A line of `runs.csv`.
#[derive(Serialize)]
struct Line<'a> {
    name: &'a str,
    variant: &'a str,
    seed: u64,
    split: &'a str,
    data: String,
    folder: String,
}

/// Writes what is asked and the list of runs, and makes sure that they continue what is there: a study may
/// get more variants, seeds and sets, but none that it had may be another or be gone.
///
/// # Errors
/// The folder is another study's or no study's, or cannot be written to.
pub fn claim(study: &Study, out: &Path) -> Result<()> {
    let inputs: Vec<&Path> = study.sets.iter().map(|set| set.folder.as_path()).collect();
    MARK.examine(out, &inputs)?;
    MARK.go_on(out)?;
    fault::point()?;
    let mut options = fs_err::OpenOptions::new();
    let lock = options.create(true).truncate(false).write(true);
    let lock = lock.open(out.join(LOCK))?.into_parts().0;
    lock.lock()?;
    let record = out.join(RECORD);
    if record.exists() {
        compare(study, &yaml::load(&record)?, out)?;
    }
    let write = |name: &str, bytes: Vec<u8>| -> Result<()> {
        let path = out.join(name);
        // Unchanged, it is left alone: others may be reading it.
        if !std::fs::read(&path).is_ok_and(|before| before == bytes) {
            files::write_atomic(&path, &bytes)?;
        }
        Ok(())
    };
    write(RECORD, yaml::to_string(&record_of(study))?.into_bytes())?;
    let mut table = strat_csv::Writer::new(Vec::new());
    for run in &study.runs {
        let set = study.set(run);
        table.serialize(Line {
            name: &run.name,
            variant: &run.variant,
            seed: run.seed,
            split: set.content.as_str(),
            data: set.folder.display().to_string(),
            folder: run.folder(),
        })?;
    }
    write(RUNS, table.into_inner()?)
}

fn record_of(study: &Study) -> Record {
    let variant = |(name, _): &(String, Vec<String>)| {
        let run = study.runs.iter().find(|run| run.variant == *name);
        run.map(|run| VariantRecord {
            name: name.clone(),
            config: run.config.clone(),
        })
    };
    Record {
        tool: "train study".to_owned(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        base: study.file.base.clone(),
        seeds: study.file.seeds.clone(),
        data: study
            .sets
            .iter()
            .map(|set| SetRecord {
                folder: set.folder.clone(),
                split: set.content.to_string(),
                digest: set.digest.clone(),
            })
            .collect(),
        evaluation: study.file.evaluation.clone(),
        variants: study.file.variants.iter().filter_map(variant).collect(),
    }
}

fn compare(study: &Study, before: &Record, out: &Path) -> Result<()> {
    let refuse = |problem: String| {
        Err(Error::Study(format!(
            "{} holds another study: {problem}; give another folder",
            out.display()
        )))
    };
    for set in &before.data {
        match study.sets.iter().find(|s| s.content.as_str() == set.split) {
            None => {
                return refuse(format!(
                    "it has the {} split, which the study file no longer names",
                    set.split
                ));
            }
            Some(now) if now.digest != set.digest => {
                return refuse(format!(
                    "its {} set had other data (digest {:.12}, now {:.12})",
                    set.split, set.digest, now.digest
                ));
            }
            Some(_) => {}
        }
    }
    if let Some(seed) = before.seeds.iter().find(|s| !study.file.seeds.contains(s)) {
        return refuse(format!(
            "it has the seed {seed}, which the study file no longer names"
        ));
    }
    let first = |name: &str| -> Option<&StudyRun> { study.runs.iter().find(|r| r.variant == name) };
    for VariantRecord { name, config } in &before.variants {
        let Some(run) = first(name) else {
            return refuse(format!(
                "it has the variant `{name}`, which the study file no longer names"
            ));
        };
        // Which seed and which set comes first may change while all stay.
        let now = Config {
            seed: config.seed,
            split: config.split,
            ..run.config.clone()
        };
        if now.digest()? != config.digest()? {
            return refuse(format!(
                "of the variant `{name}`, {}",
                config.differences(&now)?.join("; ")
            ));
        }
    }
    Ok(())
}
