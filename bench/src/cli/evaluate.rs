//! `bench eval`, also `bench --table`: models over a prepared set, into rows and tables.

use std::path::{Path, PathBuf};

use clap::Args;
use strat_metrics::tables::ThesisTable;
use strat_store::{
    command::{CliError, DONE, FAILED, eprint_line, print},
    shard::Shard,
};

use super::args::{ReplaceArgs, RuntimeArgs, ShowArgs, ThreadArgs, named_files};
use crate::{
    draw::comparison,
    evaluate::{
        NamedFile, median,
        plan::TableChoice,
        record::{FAILURES, Outcome},
        request::{Request, RunError},
        run, write,
    },
    notes::Notes,
};

/// Below `bench eval --help`. Not an attribute of the arguments, which stand at `bench` itself as well.
pub(super) const EXAMPLES: &str = "\
Examples:
  bench eval --table 3.1 --data kitti_set -m strat=model.onnx -o results
      table 3.1 for one model
  bench eval --table 3.3 --data eigen_set -m a.onnx -m b.onnx -o results --device cuda
      two models side by side on an NVIDIA device
  bench eval --table all --data kitti_set -m model.onnx --median-baseline --pictures 8 -o results
      all tables the set offers, a constant baseline, and pictures
  bench eval --table 3.1 --data kitti_set -m model.onnx --median-baseline-from rendered=world_set -o results
      a model that was trained on another set, beside the constant map of that set
  bench eval --table 3.3 --data eigen_set --predictions godard=disparities.npy -o results
      predictions that another program has saved, without a model
  bench eval --table 3.3 --data eigen_set -m model.onnx -o results --shard 0/8
      one of eight parts, on as many machines; `bench merge results` merges them

Models of other projects need a description beside the file (`bench describe --help`), and so do saved
predictions (disps.yaml for disps.npy or disps.npz, predictions.yaml in a folder of PNG, EXR or npy files), with
meaning, sigmoid, scale and png_divisor:
  meaning: disparity_fraction  # of the image width; or disparity_px, inverse_depth, inverse_depth_per_m, depth, depth_m

A run that was interrupted goes on where it stopped when the same command is run again.";

#[derive(Debug, Args)]
pub(super) struct EvaluateArgs {
    /// Table to fill; `all` is whatever tables of the thesis the data offers
    #[arg(long, value_enum)]
    table: TableChoice,
    /// Folder that `prep` has written
    #[arg(long, value_name = "DIR")]
    data: PathBuf,
    /// ONNX file, with the name shown in tables; may be given several times
    #[arg(short, long = "model", value_name = "[NAME=]FILE.onnx")]
    models: Vec<String>,
    /// Predictions that some program has saved (npy, npz, or a folder of 16-bit PNG, EXR or npy),
    /// with the name shown in tables; may be given several times
    #[arg(long = "predictions", value_name = "[NAME=]PATH")]
    predictions: Vec<String>,
    /// Folder for rows, tables and the run record
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
    /// Further protocols for rows.csv and leaderboard.csv, by name (see `bench protocols`) or as
    /// a YAML file of your own
    #[arg(long = "protocol", value_name = "NAME|FILE.yaml")]
    protocols: Vec<String>,
    /// Measure SILog, log10, iRMSE, MAE and Sq Rel over g² as well: columns of rows.csv,
    /// leaderboard.csv and the tables
    #[arg(long)]
    metrics: bool,
    /// Add a measured row: the median depth of the training scans at each place in the picture
    #[arg(long)]
    median_baseline: bool,
    /// Add the same row of the training scans of another prepared set, which shows what a model trained
    /// there has learnt beyond the mean of its places; may be given several times
    #[arg(long = "median-baseline-from", value_name = "[NAME=]DIR")]
    medians_of: Vec<String>,
    /// Also write predictions.npy (disparity fractions at network size), with the ids of the
    /// images and the description that --predictions needs beside it
    #[arg(long, conflicts_with = "shard")]
    save_predictions: bool,
    /// Measure only one of N parts of the test images, numbered from 0; see `bench merge`
    #[arg(long, value_name = "I/N")]
    shard: Option<Shard>,
    /// Write this many comparison pictures per model
    #[arg(long, value_name = "N", default_value_t = 0)]
    pictures: usize,
    /// Write comparison pictures of the N best and the N worst images of each model too, which
    /// `bench report` shows
    #[arg(long, value_name = "N", default_value_t = 0, conflicts_with = "shard")]
    extremes: usize,
    #[command(flatten)]
    runtime: RuntimeArgs,
    #[command(flatten)]
    threads: ThreadArgs,
    #[command(flatten)]
    replace: ReplaceArgs,
    #[command(flatten)]
    show: ShowArgs,
}

impl From<RunError> for CliError {
    fn from(error: RunError) -> Self {
        match error {
            RunError::Store(error) => error.into(),
            RunError::Plan(error) => Self::usage(error),
            error => Self::failed(error),
        }
    }
}

pub(super) fn run(args: &EvaluateArgs, arguments: Vec<String>) -> anyhow::Result<u8> {
    let constants = args.median_baseline || !args.medians_of.is_empty();
    if args.models.is_empty() && args.predictions.is_empty() && !constants {
        return Err(CliError::Usage(
            "nothing to measure: give --model FILE.onnx, --predictions PATH or --median-baseline"
                .to_owned(),
        )
        .into());
    }
    // What cannot be shown is said before anything is measured.
    args.show.look()?;
    let medians_of = medians_of(args)?;
    let mut taken: Vec<&str> = medians_of.iter().map(|given| given.name.as_str()).collect();
    taken.extend(args.median_baseline.then_some(median::NAME));
    let models = named_files("model", &args.models, &taken)?;
    taken.extend(models.iter().map(|given| given.name.as_str()));
    let predictions = named_files("predictions", &args.predictions, &taken)?;
    let pool = args.threads.pool()?;
    let quiet = args.runtime.quiet;
    let request = Request {
        data: &args.data,
        table: args.table,
        protocols: &args.protocols,
        models: &models,
        predictions: &predictions,
        training_source: None,
        further: args.metrics,
        median_baseline: args.median_baseline,
        medians_of: &medians_of,
        out: &args.out,
        shard: args.shard,
        force: args.replace.force,
        save_predictions: args.save_predictions,
        pictures: args.pictures,
        extremes: args.extremes,
        runtime: args.runtime.runtime,
        device: args.runtime.device,
        limits: args.runtime.limits(),
        threads: args.threads.within_model(),
        pool: &pool,
        quiet,
    };
    let finished = run::run(&request, arguments, &comparison::write).map_err(CliError::from)?;
    finished.check_replacement().map_err(CliError::failed)?;
    let (outcome, folder) = (&finished.outcome, &finished.folder);
    let (tables, code) = match args.shard {
        Some(shard) => {
            outcome.write(folder)?;
            Notes::new(quiet).say(&format!(
                "part {shard} is done; when all are, `bench merge {}` puts them together",
                args.out.display()
            ));
            let complete = outcome.record.complete;
            (String::new(), if complete { DONE } else { FAILED })
        }
        None => conclude(outcome, folder, &finished.tables, &args.show, quiet)?,
    };
    finished.remove_journals()?;
    print(tables)?;
    Ok(code)
}

/// The sets whose constant maps are asked for, by the names of their rows.
fn medians_of(args: &EvaluateArgs) -> Result<Vec<NamedFile>, CliError> {
    const OPTION: &str = "median-baseline-from";
    let mut given = named_files(OPTION, &args.medians_of, &[])?;
    for set in &mut given {
        set.name = median::name_of(&set.name);
        if args.median_baseline && set.name == median::NAME {
            return Err(CliError::Usage(format!(
                "the row of --median-baseline is called \"{}\" already; name the other one with \
                 `--{OPTION} NAME=DIR`",
                median::NAME
            )));
        }
    }
    Ok(given)
}

/// Writes everything that follows from the rows of a whole run; the tables, to be printed last, and
/// the exit code. Without rows there are none, which is a failure.
pub(super) fn conclude(
    outcome: &Outcome,
    out: &Path,
    wanted: &[ThesisTable],
    show: &ShowArgs,
    quiet: bool,
) -> anyhow::Result<(String, u8)> {
    outcome.write(out)?;
    if outcome.rows.is_empty() {
        eprint_line("error: nothing could be measured; no table was written");
        return Ok((String::new(), FAILED));
    }
    let look = show.look()?;
    let tables = write::derived(outcome, out, wanted, &look)?;
    let notes = Notes::new(quiet);
    for table in &tables.tables {
        for name in table.missing(&look.shown) {
            notes.note(&format!(
                "no row of table {} is called \"{name}\"",
                table.id()
            ));
        }
    }
    let folder = out.display();
    notes.say(&format!(
        "results are in {folder} (rows, tables as text, Markdown, LaTeX and CSV, notes and intervals); next: bench \
         report {folder}"
    ));
    if !outcome.failures.is_empty() {
        eprint_line(format_args!(
            "error: {} result(s) are missing; they are listed in {}",
            outcome.failures.len(),
            out.join(FAILURES).display()
        ));
    }
    let complete = outcome.record.complete;
    let tables = show.printed(&tables)?;
    Ok((tables, if complete { DONE } else { FAILED }))
}
