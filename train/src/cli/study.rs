//! `train study`: the runs of a study, listed or done.

use std::path::PathBuf;

use clap::Args;
use strat_store::command::{CliError, DONE, FAILED, eprint_line, print_line};
use strat_store::human;
use strat_store::signals::Watch;

use super::setup::devices_of;
use crate::device::DeviceChoice;
use crate::study::cost::{self, Cost, Costs};
use crate::study::file::{BUILT_IN, StudyFile};
use crate::study::folder;
use crate::study::plan::{Study, StudyRun};
use crate::study::state::State;
use crate::study::work::{Options, work};
use crate::training::memory;

const EXAMPLES: &str = "Examples:
  train study study-kitti --data prepared/kitti --out studies/kitti --dry-run
  train study study-kitti --data prepared/kitti --out studies/kitti --device cuda
  train study my-study.yaml --out studies/mine --jobs 4
  train study my-study.yaml --out studies/mine --index 7     one run of the list, for a cluster

The same command goes on where it was stopped or killed. What comes out: `bench study`.";

/// A study and what to do of it.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct StudyArgs {
    /// The study: a YAML file, or a built-in one (study-kitti, study-rendered).
    #[arg(value_name = "FILE|NAME")]
    study: Option<String>,
    /// Folder of the study; its runs lie in runs/VARIANT@SEED.
    #[arg(short, long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Prepared set, in place of those in the study; given several times, each set gets all runs.
    #[arg(long, value_name = "DIR")]
    data: Vec<PathBuf>,
    /// Where to train, as for a single run.
    #[arg(
        long,
        default_value = "cpu",
        value_name = "DEVICE",
        value_delimiter = ','
    )]
    device: Vec<DeviceChoice>,
    /// Most runs side by side; fewer where the memory does not suffice. They share the cores.
    #[arg(long, value_name = "N", default_value = "1", value_parser = clap::value_parser!(u32).range(1..))]
    jobs: u32,
    /// Only the run of this name, e.g. strat@1; may be repeated.
    #[arg(long, value_name = "NAME", conflicts_with = "index")]
    only: Vec<String>,
    /// Only the run at this place of the list, from 0: for the tasks of an array job.
    #[arg(long, value_name = "I")]
    index: Option<usize>,
    /// List the runs, how far they are and what the rest costs, from a few real steps; write nothing.
    #[arg(long)]
    dry_run: bool,
    /// Begin although a step is predicted not to fit into the memory that is free.
    #[arg(long)]
    ignore_memory: bool,
    /// Show no progress.
    #[arg(short, long)]
    quiet: bool,
}

/// Lists the runs or does them; the exit code.
pub(super) fn study(args: &StudyArgs) -> Result<u8, CliError> {
    let source = args.study.as_deref().ok_or_else(|| {
        let names = BUILT_IN.map(|(name, _)| name);
        CliError::Usage(format!(
            "which study? Give a YAML file or one of {}",
            names.join(", ")
        ))
    })?;
    let out = args.out.as_deref().ok_or_else(|| {
        CliError::Usage(
            "where to? Give --out with a folder for the study, e.g. --out studies/first".to_owned(),
        )
    })?;
    let (device, replicas) = devices_of(&args.device)?;
    let mut file = StudyFile::load(source)?;
    if !args.data.is_empty() {
        file.data.clone_from(&args.data);
    }
    let study = Study::new(file)?;
    let mut only = args.only.clone();
    if let Some(index) = args.index {
        let run = study.runs.get(index).ok_or_else(|| {
            CliError::Usage(format!(
                "--index {index}: the study has {} runs, counted from 0",
                study.runs.len()
            ))
        })?;
        only.push(run.name.clone());
    }
    let runs = study.select(&only)?;
    if args.dry_run {
        list(&study, &runs, args, device)?;
        return Ok(DONE);
    }
    device.open()?;
    folder::claim(&study, out)?;
    let watch = Watch::new("stopping; each run ends its step and keeps a checkpoint");
    let names = std::iter::once(&device).chain(&replicas);
    let names: Vec<String> = names.map(ToString::to_string).collect();
    let options = Options {
        out,
        device,
        devices: names.join(","),
        jobs: args.jobs as usize,
        ignore_memory: args.ignore_memory,
        quiet: args.quiet,
        stop: watch.flag(),
    };
    let outcome = work(&study, &runs, &options);
    print_line(out.join(folder::RUNS).display())?;
    let all = runs.len();
    if !args.quiet {
        eprint_line(format_args!(
            "{} of {all} runs are finished",
            outcome.finished
        ));
    }
    if !outcome.failed.is_empty() {
        let names = outcome.failed.iter().map(|(name, _)| name.as_str());
        let names: Vec<&str> = names.collect();
        eprint_line(format_args!(
            "{} of {all} runs failed: {}; the same command tries them again",
            names.len(),
            names.join(", ")
        ));
    }
    if outcome.stopped {
        eprint_line("interrupted; the same command goes on");
    }
    let whole = outcome.finished == all;
    Ok(if whole { DONE } else { FAILED })
}

/// Lists the runs, how far they are and what the rest costs.
fn list(
    study: &Study,
    runs: &[&StudyRun],
    args: &StudyArgs,
    device: DeviceChoice,
) -> Result<(), CliError> {
    let out = args
        .out
        .as_deref()
        .unwrap_or_else(|| std::path::Path::new(""));
    let states = runs.iter().map(|run| State::of(study, run, out));
    let states = states.collect::<Result<Vec<_>, _>>()?;
    let open = |state: &State| matches!(state, State::NotBegun | State::Begun { .. });
    let ahead = runs.iter().copied().zip(&states);
    let ahead: Vec<&StudyRun> = ahead.filter(|(_, s)| open(s)).map(|(run, _)| run).collect();
    let jobs = args.jobs as usize;
    let measured = Costs::measure(study, &ahead, device, jobs, |text| eprint_line(text))?;
    let width = runs
        .iter()
        .map(|run| run.name.len())
        .max()
        .unwrap_or(0)
        .max(3);
    print_line(format_args!(
        "{:width$}  {:22}  {:>8}  {:>12}  memory",
        "run", "state", "steps", "time"
    ))?;
    let mut costs = Vec::new();
    for (run, state) in runs.iter().zip(&states) {
        let cost = measured.of(study, run, state)?;
        let (time, memory) = if open(state) {
            let memory = human::bytes(cost.bytes as u64);
            (human::duration(cost.seconds), memory)
        } else {
            Default::default()
        };
        let line = format!(
            "{:width$}  {:22}  {:>8}  {time:>12}  {memory}",
            run.name,
            state.word(run),
            cost.steps
        );
        print_line(line.trim_end())?;
        costs.push(cost);
    }
    let count = |word: fn(&State) -> bool| states.iter().filter(|state| word(state)).count();
    let sum = |value: fn(&Cost) -> f64| costs.iter().map(value).sum::<f64>();
    let steps: u64 = costs.iter().map(|cost| cost.steps).sum();
    let validations: u64 = costs.iter().map(|cost| cost.validations).sum();
    let together = match jobs {
        1 => format!("{} one after another", human::duration(sum(|c| c.seconds))),
        _ => {
            // The memory of a GPU is not known.
            let memory = match device {
                DeviceChoice::Cpu if !args.ignore_memory => memory::free(),
                _ => f64::INFINITY,
            };
            let seconds = cost::side_by_side(&costs, jobs, memory);
            format!("{} with {jobs} side by side", human::duration(seconds))
        }
    };
    print_line(format_args!(
        "{} runs: {} finished, {} begun, {} not begun; {steps} steps and {validations} validations, about \
         {together}; validations are {:.0} % of the work",
        runs.len(),
        count(|s| matches!(s, State::Finished)),
        count(|s| matches!(s, State::Begun { .. })),
        count(|s| matches!(s, State::NotBegun)),
        100.0 * sum(|c| c.validation_seconds) / sum(|c| c.seconds).max(f64::MIN_POSITIVE),
    ))?;
    for (run, state) in runs.iter().zip(&states) {
        if let State::Foreign(reason) = state {
            print_line(format_args!("{} cannot be used: {reason}", run.name))?;
        }
    }
    Ok(())
}
