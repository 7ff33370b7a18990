//! Measures the models of finished runs, each into a folder of its own, and puts what was measured
//! together.
//!
//! `OUT/SET/measured/VARIANT@SEED` is an ordinary folder of `bench --table`, made by its pipeline with all
//! that this brings: self-test, leakage, journal, resuming. What was measured is kept while model, set,
//! rules, threads and version stay the same, so machines that share a disk can measure a run each.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use strat_metrics::{Row, tables::ThesisTable};
use strat_splits::Role;
use strat_store::{
    claim, files,
    inputs::{self, Kind},
    set::{Content, PreparedSet, Sample},
    yaml,
};

use super::{
    StudyError,
    folder::{Study, StudyRun},
};
use crate::{
    draw::comparison,
    evaluate::{
        NamedFile, journal,
        plan::{self, Plan, TableChoice},
        record::{FAILURES, Failure, Outcome, RECORD, ROWS, RunRecord, TOOL_VERSION},
        request::{Request, RunError},
        run,
    },
    model::leakage::{self, Leakage, Tested},
    rows::compare,
    runtime::{Device, RuntimeChoice, process::Limits},
};

/// The folder of what was measured, within that of a set.
pub const MEASURED: &str = "measured";

/// A prepared set, and the runs that are measured on it.
#[derive(Clone, Debug, PartialEq)]
pub struct StudySet {
    /// Its name: that of the split, or of its folder where it was given.
    pub name: String,
    /// Its folder.
    pub data: PathBuf,
    /// The runs by variant and seed.
    pub runs: Vec<StudyRun>,
}

/// The sets of a study: those that the runs are trained on, or the ones `given`. Where runs were
/// trained on several splits, a given set gets those of its own.
///
/// # Errors
/// A given set is none, or two have one name.
pub fn sets(study: &Study, given: &[PathBuf]) -> Result<Vec<StudySet>, StudyError> {
    let mut splits: Vec<&str> = Vec::new();
    for run in &study.runs {
        if !splits.contains(&run.split.as_str()) {
            splits.push(&run.split);
        }
    }
    let ordered = study.by_variant();
    let of_split = |split: &str| -> Vec<StudyRun> {
        let runs = ordered.iter();
        runs.filter(|run| run.split == split).cloned().collect()
    };
    if given.is_empty() {
        let set = |split: &&str| {
            let runs = of_split(split);
            // Machines may have the same set in different places.
            let there = runs.iter().find(|run| run.data.is_dir());
            let data = there.or(runs.first()).map(|run| run.data.clone());
            StudySet {
                name: (*split).to_owned(),
                data: data.unwrap_or_default(),
                runs,
            }
        };
        return Ok(splits.iter().map(set).collect());
    }
    let mut sets: Vec<StudySet> = Vec::new();
    for data in given {
        let name = claim::resolve(data)?.file_name().map_or_else(
            || "set".to_owned(),
            |name| name.to_string_lossy().into_owned(),
        );
        if sets.iter().any(|set| set.name == name) {
            return Err(StudyError::SetNames(name));
        }
        let content = PreparedSet::open(data)?.manifest.content.to_string();
        let runs = if splits.len() > 1 && splits.contains(&content.as_str()) {
            of_split(&content)
        } else {
            ordered.clone()
        };
        sets.push(StudySet {
            name,
            data: data.clone(),
            runs,
        });
    }
    Ok(sets)
}

/// How runs are measured.
#[derive(Clone, Copy, Debug)]
pub struct Measuring<'a> {
    /// Folder for the results of the study.
    pub out: &'a Path,
    /// Tables to fill.
    pub table: TableChoice,
    /// Further protocols, by name or file.
    pub protocols: &'a [String],
    /// Which runtime.
    pub runtime: RuntimeChoice,
    /// Where models run.
    pub device: Device,
    /// What a model may take in a process of its own.
    pub limits: Option<Limits>,
    /// Threads within a model.
    pub threads: usize,
    /// Threads beside the model.
    pub pool: &'a rayon::ThreadPool,
    /// No progress and no notes.
    pub quiet: bool,
}

/// A set that is ready to be measured on.
pub struct OnSet<'a> {
    measuring: &'a Measuring<'a>,
    set: &'a StudySet,
    data_digest: String,
    content: Content,
    source: String,
    samples: Vec<Sample>,
    plan: Plan,
}

impl<'a> OnSet<'a> {
    /// Opens a set.
    ///
    /// # Errors
    /// There is none, or it cannot serve what is asked for.
    pub fn open(measuring: &'a Measuring<'a>, set: &'a StudySet) -> Result<Self, StudyError> {
        let prepared = PreparedSet::open(&set.data)?;
        let samples = prepared.samples(Role::Test)?;
        let count = plan::test_count(&prepared, &samples);
        let plan = plan::plan(
            measuring.table,
            measuring.protocols,
            prepared.manifest.content,
            &samples,
            count,
        );
        Ok(Self {
            measuring,
            set,
            data_digest: prepared.manifest.data_digest,
            content: prepared.manifest.content,
            source: prepared.manifest.source,
            samples,
            plan: plan.map_err(RunError::from)?,
        })
    }

    /// The tables that the set offers.
    #[must_use]
    pub fn tables(&self) -> &[ThesisTable] {
        &self.plan.tables
    }

    /// The folder of all results on this set.
    #[must_use]
    pub fn folder(&self) -> PathBuf {
        self.measuring.out.join(&self.set.name)
    }

    fn folder_of(&self, run: &StudyRun) -> PathBuf {
        self.folder().join(MEASURED).join(run.name())
    }

    /// Whether the model of a finished run was measured as it would be now, and nothing is left of the work.
    /// What cannot be read is measured again, and named then.
    #[must_use]
    pub fn is_measured(&self, run: &StudyRun) -> bool {
        let folder = self.folder_of(run);
        let path = folder.join(RECORD);
        // The journals of a run that was killed while it took them away; they are read, and taken away then.
        let is_left = |name: &OsString| name.to_string_lossy().starts_with(journal::PREFIX);
        if !path.is_file()
            || !files::names_in(&folder).is_ok_and(|names| !names.iter().any(is_left))
        {
            return false;
        }
        let Ok(record) = yaml::load::<RunRecord>(&path) else {
            return false;
        };
        let [model] = record.models.as_slice() else {
            return false;
        };
        let measured = |digest: String| record.protocols.iter().any(|p| p.digest == digest);
        let plan = &self.plan;
        let needed = plan
            .protocols
            .iter()
            .filter(|p| !plan.sections.contains(&p.name));
        record.complete
            && record.tool_version == TOOL_VERSION
            && record.data.data_digest == self.data_digest
            && record.threads == self.measuring.threads
            && model.name == run.name()
            && model.images > 0
            && needed
                .into_iter()
                .all(|protocol| measured(protocol.digest()))
            && strat_onnx::model::read(run.model()).is_ok_and(|file| file.blake3 == model.blake3)
    }

    /// What is known of training drives among the test images, in a sentence over all measured models.
    #[must_use]
    pub fn leakage(&self, outcome: &Outcome) -> String {
        let (mut clear, mut unknown, mut seen, mut elsewhere) = (0, 0, Vec::new(), Vec::new());
        for model in &outcome.record.models {
            let run = self.set.runs.iter().find(|run| run.name() == model.name);
            let source = run.and_then(StudyRun::source);
            let tested = Tested {
                content: self.content,
                source: &self.source,
                samples: &self.samples,
                training_source: source.as_deref(),
            };
            let metadata = model.metadata.as_ref();
            match leakage::check(metadata, &tested) {
                Leakage::None => {
                    clear += 1;
                    elsewhere.extend(tested.other_world(metadata).map(str::to_owned));
                }
                Leakage::Unknown => unknown += 1,
                Leakage::Drives { .. } | Leakage::OtherSplit { .. } => {
                    seen.push(model.name.as_str())
                }
            }
        }
        let all = outcome.record.models.len();
        let mut text = format!(
            "leakage on {}: {clear} of {all} models were trained on no place of its {} test images",
            self.set.name,
            self.samples.len()
        );
        if let Some(source) = elsewhere.first() {
            text += &format!(
                "; {} on {source} images, while these are {}: other places, also where drives have the same \
                 names",
                elsewhere.len(),
                self.source
            );
        }
        if unknown > 0 {
            text += &format!("; {unknown} do not say what they were trained on");
        }
        if !seen.is_empty() {
            text += &format!("; LEAKAGE: {} were or may have been", seen.join(", "));
        }
        text
    }

    /// Measures the model of a finished run; whether nothing failed.
    ///
    /// # Errors
    /// The set, the folder or the runtime cannot be used, or it was interrupted. What concerns images
    /// stands in the record.
    pub fn measure(&self, run: &StudyRun, arguments: Vec<String>) -> Result<bool, StudyError> {
        let Measuring {
            table,
            protocols,
            runtime,
            device,
            limits,
            threads,
            pool,
            quiet,
            ..
        } = *self.measuring;
        let folder = self.folder_of(run);
        let models = [NamedFile {
            name: run.name(),
            file: run.model(),
        }];
        let source = run.source();
        let request = Request {
            data: &self.set.data,
            table,
            protocols,
            models: &models,
            predictions: &[],
            training_source: source.as_deref(),
            further: false,
            median_baseline: false,
            medians_of: &[],
            out: &folder,
            shard: None,
            // What is there is the same run's, measured otherwise.
            force: true,
            save_predictions: false,
            pictures: 0,
            extremes: 0,
            runtime,
            device,
            limits,
            threads,
            pool,
            quiet,
        };
        let finished = run::run(&request, arguments, &comparison::write)?;
        finished.outcome.write(&folder)?;
        finished.remove_journals()?;
        Ok(finished.outcome.record.complete)
    }

    /// Everything that was measured on the set, in the order of the study; `None` where nothing was.
    ///
    /// # Errors
    /// What was measured cannot be read.
    pub fn together(&self, arguments: Vec<String>) -> Result<Option<Outcome>, StudyError> {
        let mut whole: Option<Outcome> = None;
        for run in &self.set.runs {
            let folder = self.folder_of(run);
            if !run.is_finished() || !folder.join(RECORD).is_file() {
                continue;
            }
            let part = read(&folder)?;
            match &mut whole {
                None => whole = Some(part),
                Some(whole) => add(whole, part),
            }
        }
        if let Some(whole) = &mut whole {
            whole.record.arguments = arguments;
            whole.record.data.path.clone_from(&self.set.data);
            whole.record.failures = whole.failures.len();
        }
        Ok(whole)
    }
}

/// The results of one run.
fn read(folder: &Path) -> Result<Outcome, StudyError> {
    let record: RunRecord = yaml::load(&folder.join(RECORD))?;
    let path = folder.join(ROWS);
    let rows: Vec<Row> = if path.is_file() {
        compare::read_rows(&path)?
    } else {
        Vec::new()
    };
    let path = folder.join(FAILURES);
    let failures: Vec<Failure> = if path.is_file() {
        let file = inputs::open(&path, Kind::Table)?;
        strat_csv::Reader::new(file)
            .deserialize()
            .map_err(|error| StudyError::Unusable {
                path,
                reason: error.to_string(),
            })?
    } else {
        Vec::new()
    };
    Ok(Outcome {
        record,
        rows,
        failures,
        agreed: Vec::new(),
    })
}

fn add(whole: &mut Outcome, part: Outcome) {
    whole.rows.extend(part.rows);
    whole.failures.extend(part.failures);
    let record = &mut whole.record;
    record.complete &= part.record.complete;
    record.models.extend(part.record.models);
    for protocol in part.record.protocols {
        if !record.protocols.contains(&protocol) {
            record.protocols.push(protocol);
        }
    }
    for warning in part.record.warnings {
        if !record.warnings.contains(&warning) {
            record.warnings.push(warning);
        }
    }
}

/// Sentences about rows that were not all measured alike.
#[must_use]
pub fn mixed(rows: &[Row]) -> Vec<String> {
    let of = |what: &str, value: fn(&Row) -> &str| {
        let mut found: Vec<&str> = rows.iter().map(value).collect();
        found.sort_unstable();
        found.dedup();
        (found.len() > 1).then(|| {
            format!(
                "rows were measured with different {what} ({}); last digits may differ for that alone",
                found.join(", ")
            )
        })
    };
    [
        of("runtimes", |row| &row.context.runtime),
        of("devices", |row| &row.context.provider),
        of("versions of bench", |row| &row.context.tool_version),
    ]
    .into_iter()
    .flatten()
    .collect()
}
