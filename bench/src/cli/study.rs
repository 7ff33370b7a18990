//! `bench study`: from the finished runs of a study, or from rows alone, to which variant is better.

use std::path::{Path, PathBuf};

use clap::Args;
use serde::Serialize;
use strat_metrics::Metric;
use strat_store::{
    command::{CliError, DONE, FAILED, print},
    yaml,
};

use super::args::{ReplaceArgs, RuntimeArgs, ThreadArgs, positive};
use crate::{
    evaluate::{
        ownership,
        plan::TableChoice,
        record::{Outcome, TOOL_VERSION},
        request::RunError,
        write as tables,
    },
    notes::Notes,
    rows::{compare, leaderboard, study::EFFECT},
    study::{
        StudyError,
        curves::Curves,
        folder::{self, Study, StudyRun, metric_named},
        measure::{self, Measuring, OnSet, StudySet},
        pictures,
        write::{self, Answer, FIGURES, MARK, Question},
    },
};

#[derive(Debug, Args)]
#[command(after_help = "\
STUDY is a folder of `train study`; several are parts of one study from several machines. Every
finished run is measured once and kept below DIR/SET/measured, so the same command again goes on
where it stopped and takes in what was finished since. Beside the tables, DIR/SET gets answer.txt
(one sentence a pair), variants.csv, differences.csv, ablation_* and, from the run folders, curves
and what each variant makes of the same images.

Examples:
  bench study studies/kitti --out results/study
  bench study machine1/study machine2/study --out results/study
      one study whose runs were trained on two machines
  bench study studies/rendered --data real_set --out results/transfer
      the same models on another set; leakage is checked
  bench study --rows results/study/eigen/rows.csv
      the answer again, from rows alone
  bench study studies/kitti --out results/study --index 3
      measure one run and nothing else, as a task of a cluster does (bench/slurm)")]
pub(super) struct StudyArgs {
    /// Folders that `train study` has written
    #[arg(
        value_name = "STUDY",
        required_unless_present = "rows",
        conflicts_with = "rows"
    )]
    studies: Vec<PathBuf>,
    /// Answer from these rows alone; may be given several times
    #[arg(long, value_name = "ROWS.csv")]
    rows: Vec<PathBuf>,
    /// Folder for results, with a folder in it for each prepared set; with --rows, where the files go
    /// [default with --rows: the answer is only printed]
    #[arg(short, long, value_name = "DIR", required_unless_present = "rows")]
    out: Option<PathBuf>,
    /// Prepared sets to measure on [default: those that the runs are trained on]
    #[arg(long = "data", value_name = "SET", conflicts_with = "rows")]
    data: Vec<PathBuf>,
    /// Table to fill [default: what the study says, else all that the set offers]
    #[arg(long, value_enum, conflicts_with = "rows")]
    table: Option<TableChoice>,
    /// Further protocols, by name or as a YAML file
    #[arg(
        long = "protocol",
        value_name = "NAME|FILE.yaml",
        conflicts_with = "rows"
    )]
    protocols: Vec<String>,
    /// Measure these runs only, by name, and write no answer
    #[arg(
        long,
        value_name = "RUN",
        value_delimiter = ',',
        conflicts_with = "rows"
    )]
    only: Vec<String>,
    /// The same by its line in runs.csv, from 0, as `train study --index` counts
    #[arg(long, value_name = "N", conflicts_with_all = ["rows", "only"])]
    index: Option<usize>,
    /// Metric of the sentences [default: what the study says, else abs_rel]
    #[arg(long, value_name = "METRIC", value_parser = metric_named)]
    metric: Option<Metric>,
    /// Difference whose cost in seeds and drives is told [default: what the study says, else 0.01]
    #[arg(long, value_name = "X", value_parser = positive)]
    effect: Option<f64>,
    /// Draw no pictures of what variants make of images
    #[arg(long)]
    no_figures: bool,
    #[command(flatten)]
    runtime: RuntimeArgs,
    #[command(flatten)]
    threads: ThreadArgs,
    #[command(flatten)]
    replace: ReplaceArgs,
}

impl From<StudyError> for CliError {
    fn from(error: StudyError) -> Self {
        match error {
            StudyError::Store(error) => error.into(),
            StudyError::Run(RunError::Plan(error)) => Self::usage(error),
            StudyError::Run(error) => error.into(),
            StudyError::NoStudy(_)
            | StudyError::NoRun { .. }
            | StudyError::SetNames(_)
            | StudyError::TwoModels { .. } => Self::usage(error),
            error => Self::failed(error),
        }
    }
}

/// What was done; written beside the answer.
#[derive(Serialize)]
struct Record<'a> {
    tool: &'static str,
    tool_version: &'static str,
    arguments: &'a [String],
    #[serde(skip_serializing_if = "<[_]>::is_empty")]
    studies: &'a [PathBuf],
    #[serde(skip_serializing_if = "<[_]>::is_empty")]
    rows: &'a [PathBuf],
    #[serde(skip_serializing_if = "Option::is_none")]
    data: Option<&'a Path>,
    #[serde(skip_serializing_if = "Option::is_none")]
    leakage: Option<String>,
    metric: &'static str,
    effect: f64,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    runs: Vec<RunState>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    figures: Vec<String>,
    /// What was warned about.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    warnings: Vec<String>,
}

#[derive(Serialize)]
struct RunState {
    name: String,
    folder: PathBuf,
    measured: bool,
}

pub(super) fn run(args: &StudyArgs, arguments: Vec<String>) -> anyhow::Result<u8> {
    let code = if args.rows.is_empty() {
        of_study(args, &arguments)
    } else {
        of_rows(args, &arguments)
    };
    Ok(code.map_err(CliError::from)?)
}

/// The answer of rows, printed and, with `--out`, written.
fn of_rows(args: &StudyArgs, arguments: &[String]) -> Result<u8, StudyError> {
    let rows = compare::read_all_in_order(&args.rows)?;
    let coverage = leaderboard::coverage_of(&args.rows[0], &rows)?;
    let asked = Question {
        metric: args.metric.unwrap_or(Metric::AbsRel),
        effect: args.effect.unwrap_or(EFFECT),
    };
    let answer = Answer::of(&rows, &coverage, asked)?;
    if let Some(out) = &args.out {
        let inputs: Vec<&Path> = args.rows.iter().map(PathBuf::as_path).collect();
        MARK.examine(out, &inputs)?;
        MARK.begin(out)?;
        answer.write(out)?;
        let record = Record {
            rows: &args.rows,
            ..Record::new(arguments, asked)
        };
        MARK.finish(out, yaml::to_string(&record)?.as_bytes())?;
    }
    Ok(conclude(&answer, &mut Notes::new(args.runtime.quiet)))
}

impl<'a> Record<'a> {
    fn new(arguments: &'a [String], asked: Question) -> Self {
        Self {
            tool: "bench study",
            tool_version: TOOL_VERSION,
            arguments,
            studies: &[],
            rows: &[],
            data: None,
            leakage: None,
            metric: asked.metric.name(),
            effect: asked.effect,
            runs: Vec::new(),
            figures: Vec::new(),
            warnings: Vec::new(),
        }
    }
}

/// Prints an answer; the exit code.
fn conclude(answer: &Answer, notes: &mut Notes) -> u8 {
    if !answer.has_pairs() {
        notes.note("there is one variant only, so there is nothing to compare");
    }
    let printed = print(answer.text());
    if printed.is_err() || notes.incomplete {
        FAILED
    } else {
        DONE
    }
}

fn of_study(args: &StudyArgs, arguments: &[String]) -> Result<u8, StudyError> {
    let study = folder::read(&args.studies)?;
    let evaluation = &study.evaluation;
    let chosen = chosen(&study, args)?;
    let whole = args.only.is_empty() && args.index.is_none();
    let given = if args.data.is_empty() {
        &evaluation.data
    } else {
        &args.data
    };
    let sets = measure::sets(&study, given)?;
    let pool = args.threads.pool()?;
    let protocols = if args.protocols.is_empty() {
        &evaluation.protocols
    } else {
        &args.protocols
    };
    let measuring = Measuring {
        out: args.out.as_deref().unwrap_or(Path::new("")),
        table: args
            .table
            .or(evaluation.table())
            .unwrap_or(TableChoice::All),
        protocols,
        runtime: args.runtime.runtime,
        device: args.runtime.device,
        limits: args.runtime.limits(),
        threads: args.threads.within_model(),
        pool: &pool,
        quiet: args.runtime.quiet,
    };
    let asked = Question {
        metric: args
            .metric
            .or(evaluation.metric())
            .unwrap_or(Metric::AbsRel),
        effect: args.effect.or(evaluation.effect).unwrap_or(EFFECT),
    };
    let mut notes = Notes::new(args.runtime.quiet);
    if !study.runs.iter().any(StudyRun::is_finished) {
        return Err(StudyError::NothingFinished);
    }
    let mut code = DONE;
    for set in &sets {
        let collecting = Collecting {
            args,
            arguments,
            set,
            measuring: &measuring,
            on: OnSet::open(&measuring, set)?,
            asked,
        };
        if whole {
            collecting.claim()?;
        }
        collecting.measure(&chosen, &mut notes)?;
        if whole {
            code = code.max(collecting.collect(&mut notes)?);
        }
    }
    Ok(if notes.incomplete { FAILED } else { code })
}

/// The runs that are asked for by name or index; all without any.
fn chosen<'a>(study: &'a Study, args: &StudyArgs) -> Result<Vec<&'a StudyRun>, StudyError> {
    let none = |given: String| {
        let names: Vec<String> = study.runs.iter().map(StudyRun::name).collect();
        StudyError::NoRun {
            given,
            last: study.runs.len().saturating_sub(1),
            names: names.join(", "),
        }
    };
    if let Some(index) = args.index {
        let run = study.runs.get(index);
        return Ok(vec![run.ok_or_else(|| none(index.to_string()))?]);
    }
    if args.only.is_empty() {
        return Ok(study.runs.iter().collect());
    }
    let mut chosen = Vec::new();
    for given in &args.only {
        let before = chosen.len();
        chosen.extend(study.runs.iter().filter(|run| run.name() == *given));
        if chosen.len() == before {
            return Err(none(given.clone()));
        }
    }
    Ok(chosen)
}

/// The work on one set.
struct Collecting<'a> {
    args: &'a StudyArgs,
    arguments: &'a [String],
    set: &'a StudySet,
    measuring: &'a Measuring<'a>,
    on: OnSet<'a>,
    asked: Question,
}

impl Collecting<'_> {
    /// Looks whether the folder for the answer may be written to, before anything is measured.
    fn claim(&self) -> Result<(), StudyError> {
        let mut inputs: Vec<&Path> = vec![&self.set.data];
        inputs.extend(self.set.runs.iter().map(|run| run.folder.as_path()));
        MARK.examine(&self.on.folder(), &inputs)?;
        Ok(())
    }

    /// Measures what is finished and was not measured.
    fn measure(&self, chosen: &[&StudyRun], notes: &mut Notes) -> Result<(), StudyError> {
        let of_set = self.set.runs.iter().filter(|run| chosen.contains(run));
        let (finished, left): (Vec<&StudyRun>, Vec<&StudyRun>) =
            of_set.partition(|run| run.is_finished());
        if !left.is_empty() {
            let names: Vec<String> = left.iter().map(|run| run.name()).collect();
            notes.fail(format!(
                "{} of {} runs on {} are not finished: {}",
                left.len(),
                left.len() + finished.len(),
                self.set.name,
                names.join(", ")
            ));
        }
        let to_do = finished
            .iter()
            .copied()
            .filter(|run| !self.on.is_measured(run));
        let to_do: Vec<&StudyRun> = to_do.collect();
        if to_do.len() < finished.len() {
            notes.note(&format!(
                "{} of {} finished runs were measured on {} before",
                finished.len() - to_do.len(),
                finished.len(),
                self.set.name
            ));
        }
        for (index, run) in to_do.iter().enumerate() {
            notes.say(&format!(
                "measuring {} on {} ({} of {})",
                run.name(),
                self.set.name,
                index + 1,
                to_do.len()
            ));
            if !self.on.measure(run, self.arguments.to_vec())? {
                notes.fail(format!("{} could not be measured as a whole", run.name()));
            }
        }
        Ok(())
    }

    /// Writes and prints the answer of all that was measured.
    fn collect(&self, notes: &mut Notes) -> Result<u8, StudyError> {
        let folder = self.on.folder();
        let together = self.on.together(self.arguments.to_vec())?;
        let Some(outcome) = together.filter(|outcome| !outcome.rows.is_empty()) else {
            notes.fail(format!("nothing was measured on {}", self.set.name));
            return Ok(FAILED);
        };
        self.check_replacement(&folder, &outcome)?;
        let leakage = self.on.leakage(&outcome);
        notes.say(&leakage);
        let coverage = tables::coverage(&outcome);
        let answer = Answer::of(&outcome.rows, &coverage, self.asked)?;
        for sentence in measure::mixed(&outcome.rows) {
            notes.warn(sentence);
        }
        // The rows have a mark of their own, which comes first: rows beside the answer's alone would look like
        // somebody else's after a kill.
        ownership::MARK.begin(&folder)?;
        MARK.begin(&folder)?;
        MARK.reopen(&folder)?;
        outcome.write(&folder)?;
        tables::derived(
            &outcome,
            &folder,
            self.on.tables(),
            &tables::Look::default(),
        )?;
        answer.write(&folder)?;
        let curves = Curves::read(&self.set.runs);
        for problem in &curves.problems {
            notes.warn(problem.clone());
        }
        write::curves(&curves, &folder)?;
        let figures = if self.args.no_figures {
            Vec::new()
        } else {
            self.figures(&folder, notes)
        };
        let measured = |run: &StudyRun| {
            let mut models = outcome.record.models.iter();
            models.any(|model| model.name == run.name() && model.images > 0)
        };
        let runs = self.set.runs.iter().map(|run| RunState {
            name: run.name(),
            folder: run.folder.clone(),
            measured: measured(run),
        });
        let record = Record {
            studies: &self.args.studies,
            data: Some(&self.set.data),
            leakage: Some(leakage),
            runs: runs.collect(),
            figures,
            warnings: notes.warnings.clone(),
            ..Record::new(self.arguments, self.asked)
        };
        MARK.finish(&folder, yaml::to_string(&record)?.as_bytes())?;
        let code = conclude(&answer, notes);
        notes.say(&format!("everything is in {}", folder.display()));
        Ok(code)
    }

    /// Makes sure that no result of an earlier collection is lost.
    fn check_replacement(&self, folder: &Path, outcome: &Outcome) -> Result<(), StudyError> {
        if self.args.replace.force {
            return Ok(());
        }
        let earlier = ownership::earlier_results(folder, &[])?;
        match earlier.and_then(|earlier| ownership::loses(&earlier, &outcome.record)) {
            Some(what) => Err(ownership::refuse(folder, &what).into()),
            None => Ok(()),
        }
    }

    /// Draws what variants make of the same images. What fails leaves the results incomplete: rows and answer
    /// are there without it.
    fn figures(&self, folder: &Path, notes: &mut Notes) -> Vec<String> {
        let runtime = self.args.runtime.resolve().map_err(CliError::failed);
        let drawn = runtime.and_then(|runtime| {
            let out = folder.join(FIGURES);
            pictures::write(&out, self.set, self.measuring, &runtime).map_err(CliError::from)
        });
        drawn.unwrap_or_else(|error| {
            notes.fail(format!(
                "no pictures of what variants make of images: {error}; the next `bench study` draws them, and \
                 --no-figures goes without"
            ));
            Vec::new()
        })
    }
}
