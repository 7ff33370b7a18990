//! The folders that `train study` writes: which runs there are, and which of them are finished.
//!
//! `runs.csv` lists the runs (`name`, `variant`, `seed`, `split`, `data`, `folder`); a run is finished when
//! its folder has `model.onnx`. What was asked for the evaluation stands under `evaluation` in
//! `study.yaml`. Not here: what a run folder holds besides, see [`super::curves`].

use std::path::{Path, PathBuf};

use serde::Deserialize;
use strat_metrics::{Metric, tables::ThesisTable};
use strat_store::{
    claim, files,
    inputs::{self, Kind},
    yaml,
};

use super::StudyError;
use crate::evaluate::plan::TableChoice;

/// The list of runs.
const RUNS: &str = "runs.csv";
/// What was asked.
const RECORD: &str = "study.yaml";
/// What a run was made with.
const RUN: &str = "run.json";
/// What a finished run has.
const MODEL: &str = "model.onnx";

/// A run of a study.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StudyRun {
    /// What is compared.
    pub variant: String,
    /// Its seed.
    pub seed: u64,
    /// The split it is trained on.
    pub split: String,
    /// The prepared set it is trained on, where it lay then.
    pub data: PathBuf,
    /// Its folder.
    pub folder: PathBuf,
}

impl StudyRun {
    /// Its name in rows and tables.
    #[must_use]
    pub fn name(&self) -> String {
        format!("{}@{}", self.variant, self.seed)
    }

    /// Its exported model.
    #[must_use]
    pub fn model(&self) -> PathBuf {
        self.folder.join(MODEL)
    }

    /// Where its training images came from, such as `kitti` or `rendered`, if its record says so; none where
    /// its weights began with those of another training.
    #[must_use]
    pub fn source(&self) -> Option<String> {
        #[derive(Deserialize)]
        struct Run {
            source: String,
            #[serde(default)]
            initial_weights: Option<String>,
        }
        let bytes = inputs::read(&self.folder.join(RUN), Kind::Record).ok()?;
        let run: Run = serde_json::from_slice(&bytes).ok()?;
        Some(run.source).filter(|_| run.initial_weights.is_none())
    }

    /// Whether its model is there.
    #[must_use]
    pub fn is_finished(&self) -> bool {
        self.model().is_file()
    }
}

/// What a study asks `bench` for; each is overruled by the command line.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Evaluation {
    /// Table to fill: `3.1`, `3.2`, `3.3`, `make3d`, `eigen-652` or `all`.
    table: Option<String>,
    /// Further protocols.
    pub protocols: Vec<String>,
    /// Prepared sets other than those that the runs are trained on.
    pub data: Vec<PathBuf>,
    /// The metric of the answer.
    metric: Option<String>,
    /// The difference whose cost is told.
    pub effect: Option<f64>,
}

impl Evaluation {
    /// The table asked for.
    #[must_use]
    pub fn table(&self) -> Option<TableChoice> {
        let text = self.table.as_deref()?;
        table_named(text).ok()
    }

    /// The metric asked for.
    #[must_use]
    pub fn metric(&self) -> Option<Metric> {
        let text = self.metric.as_deref()?;
        metric_named(text).ok()
    }

    fn check(&self) -> Result<(), String> {
        self.table.as_deref().map(table_named).transpose()?;
        self.metric.as_deref().map(metric_named).transpose()?;
        match self.effect {
            Some(effect) if !(effect > 0.0 && effect.is_finite()) => {
                Err(format!("effect must be a number above 0, not {effect}"))
            }
            _ => Ok(()),
        }
    }
}

fn table_named(text: &str) -> Result<TableChoice, String> {
    if text == "all" {
        return Ok(TableChoice::All);
    }
    let table: ThesisTable = text.parse().map_err(|error| format!("{error}"))?;
    Ok(match table {
        ThesisTable::Table31 => TableChoice::Table31,
        ThesisTable::Table32 => TableChoice::Table32,
        ThesisTable::Table33 => TableChoice::Table33,
        ThesisTable::Make3d => TableChoice::Make3d,
        ThesisTable::Eigen652 => TableChoice::Eigen652,
    })
}

/// The metric of a column name.
///
/// # Errors
/// A sentence with those that there are.
pub fn metric_named(text: &str) -> Result<Metric, String> {
    let found = Metric::ALL.into_iter().find(|metric| metric.name() == text);
    found.ok_or_else(|| {
        format!(
            "unknown metric {text:?}; the metrics are {}",
            Metric::ALL.map(Metric::name).join(", ")
        )
    })
}

/// One study, from one folder or from several that hold parts of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Study {
    /// The runs, in the order of the lists, which `train study --index` counts by.
    pub runs: Vec<StudyRun>,
    /// What is asked for.
    pub evaluation: Evaluation,
}

/// The record, as far as it is read here.
#[derive(Deserialize)]
struct Record {
    #[serde(default)]
    evaluation: Option<Evaluation>,
}

#[derive(Deserialize)]
struct Line {
    variant: String,
    seed: u64,
    split: String,
    data: PathBuf,
    folder: PathBuf,
}

/// Reads the folders of one study. A run that several list is taken where it is finished.
///
/// # Errors
/// A folder is no study's, or two of them have different models of one run.
pub fn read(folders: &[PathBuf]) -> Result<Study, StudyError> {
    let mut runs: Vec<StudyRun> = Vec::new();
    let mut evaluation = None;
    for folder in folders {
        let (own, asked) = read_one(folder)?;
        evaluation = evaluation.or(asked);
        for run in own {
            let same =
                |known: &&mut StudyRun| (known.name(), &known.split) == (run.name(), &run.split);
            match runs.iter_mut().find(same) {
                None => runs.push(run),
                Some(known) if !run.is_finished() || is_same_folder(known, &run) => {}
                Some(known) if !known.is_finished() => *known = run,
                Some(known) => {
                    let digest = |run: &StudyRun| files::blake3_file(&run.model(), Kind::Weights);
                    if digest(known)? != digest(&run)? {
                        return Err(StudyError::TwoModels {
                            name: run.name(),
                            first: known.folder.clone(),
                            second: run.folder,
                        });
                    }
                }
            }
        }
    }
    Ok(Study {
        runs,
        evaluation: evaluation.unwrap_or_default(),
    })
}

impl Study {
    /// The runs by variant, in the order of the list, and by seed: the order of rows and tables, wherever
    /// runs were trained.
    #[must_use]
    pub fn by_variant(&self) -> Vec<StudyRun> {
        let mut variants: Vec<&str> = Vec::new();
        for run in &self.runs {
            if !variants.contains(&run.variant.as_str()) {
                variants.push(&run.variant);
            }
        }
        let mut runs = self.runs.clone();
        runs.sort_by_key(|run| (variants.iter().position(|v| *v == run.variant), run.seed));
        runs
    }
}

fn is_same_folder(a: &StudyRun, b: &StudyRun) -> bool {
    let resolved = |run: &StudyRun| claim::resolve(&run.folder).ok();
    resolved(a) == resolved(b)
}

fn read_one(folder: &Path) -> Result<(Vec<StudyRun>, Option<Evaluation>), StudyError> {
    let list = folder.join(RUNS);
    if !list.is_file() {
        return Err(StudyError::NoStudy(folder.to_owned()));
    }
    let file = inputs::open(&list, Kind::Table)?;
    let lines: Result<Vec<Line>, _> = strat_csv::Reader::new(file).deserialize();
    let lines = lines.map_err(|error| StudyError::Unusable {
        path: list.clone(),
        reason: error.to_string(),
    })?;
    let mut runs = Vec::new();
    for line in lines {
        // The names become names of folders and of rows.
        let plain = |c: char| c.is_ascii_alphanumeric() || "-_.+".contains(c);
        if line.variant.is_empty()
            || line.variant.starts_with('.')
            || !line.variant.chars().all(plain)
        {
            return Err(StudyError::Unusable {
                path: list,
                reason: format!("{:?} is not the name of a variant", line.variant),
            });
        }
        runs.push(StudyRun {
            folder: folder.join(&line.folder),
            variant: line.variant,
            seed: line.seed,
            split: line.split,
            data: line.data,
        });
    }
    let record = folder.join(RECORD);
    let evaluation = if record.is_file() {
        let found: Record = yaml::load(&record)?;
        found.evaluation
    } else {
        None
    };
    if let Some(problem) = evaluation.as_ref().and_then(|asked| asked.check().err()) {
        return Err(StudyError::Unusable {
            path: record,
            reason: format!("evaluation: {problem}"),
        });
    }
    Ok((runs, evaluation))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn study(folder: &Path, runs: &[(&str, u64)], finished: &[&str]) {
        std::fs::create_dir_all(folder).unwrap();
        let mut list = "name,variant,seed,split,data,folder\n".to_owned();
        for (variant, seed) in runs {
            let name = format!("{variant}@{seed}");
            list += &format!("{name},{variant},{seed},eigen,/sets/eigen,runs/{name}\n");
            std::fs::create_dir_all(folder.join("runs").join(&name)).unwrap();
        }
        std::fs::write(folder.join(RUNS), list).unwrap();
        for name in finished {
            std::fs::write(folder.join("runs").join(name).join(MODEL), name).unwrap();
        }
    }

    #[test]
    fn folders_of_two_machines_are_one_study() {
        let scratch = tempfile::tempdir().unwrap();
        let [one, two] = ["one", "two"].map(|name| scratch.path().join(name));
        let all = [
            ("strat", 1),
            ("no-adv", 1),
            ("strat", 10),
            ("no-adv", 10),
            ("strat", 2),
        ];
        study(&one, &all, &["strat@1", "no-adv@1"]);
        study(&two, &all, &["strat@10", "no-adv@10", "strat@2"]);
        let found = read(&[one.clone(), two.clone()]).unwrap();
        let names =
            |runs: &[StudyRun]| -> Vec<String> { runs.iter().map(StudyRun::name).collect() };
        let ordered = ["strat@1", "strat@2", "strat@10", "no-adv@1", "no-adv@10"];
        assert_eq!(names(&found.by_variant()), ordered);
        assert_eq!(names(&found.runs)[..3], ["strat@1", "no-adv@1", "strat@10"]);
        assert!(found.runs.iter().all(StudyRun::is_finished));
        assert_eq!(found.by_variant()[1].folder, two.join("runs/strat@2"));
        // A copy of a model is the model; another one is not.
        std::fs::copy(
            one.join("runs/strat@1").join(MODEL),
            two.join("runs/strat@1").join(MODEL),
        )
        .unwrap();
        assert_eq!(read(&[one.clone(), two.clone()]).unwrap().runs.len(), 5);
        std::fs::write(two.join("runs/strat@1").join(MODEL), "other").unwrap();
        let text = read(&[one.clone(), two]).unwrap_err().to_string();
        assert!(
            text.contains("strat@1") && text.contains("another model"),
            "{text}"
        );
        assert_eq!(read(&[one.clone(), one]).unwrap().runs.len(), 5);
    }

    #[test]
    fn mistakes_are_named() {
        let scratch = tempfile::tempdir().unwrap();
        let folder = scratch.path().join("study");
        let refused = || read(std::slice::from_ref(&folder)).unwrap_err().to_string();
        assert!(refused().contains("train study"), "{}", refused());
        study(&folder, &[("strat", 1)], &[]);
        let evaluation = |text: &str| std::fs::write(folder.join(RECORD), text).unwrap();
        evaluation("tool: train study\nevaluation: {table: '3.3', metric: rmse, effect: 0.1}\n");
        let asked = read(std::slice::from_ref(&folder)).unwrap().evaluation;
        assert_eq!(asked.table(), Some(TableChoice::Table33));
        assert_eq!(asked.metric(), Some(Metric::Rmse));
        for (text, part) in [
            ("evaluation: {table: '3.4'}", "3.4"),
            ("evaluation: {metric: abs}", "the metrics are abs_rel"),
            ("evaluation: {effect: -1}", "above 0"),
            ("evaluation: {tables: all}", "tables"),
        ] {
            evaluation(text);
            assert!(refused().contains(part), "{text}: {}", refused());
        }
        std::fs::write(folder.join(RUNS), "name,variant\na,b\n").unwrap();
        assert!(refused().contains("runs.csv"), "{}", refused());
        std::fs::write(
            folder.join(RUNS),
            "variant,seed,split,data,folder\n../x,1,eigen,d,runs/x\n",
        )
        .unwrap();
        assert!(
            refused().contains("not the name of a variant"),
            "{}",
            refused()
        );
    }
}
