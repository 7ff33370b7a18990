//! `bench --table`: models over a prepared set, into rows and tables.

use std::path::{Path, PathBuf};

use clap::Args;
use strat_metrics::tables::ThesisTable;
use strat_store::{
    command::{CliError, DONE, FAILED, eprint_line, print},
    shard::Shard,
};

use super::args::{ReplaceArgs, RuntimeArgs, ThreadArgs, named_files};
use crate::{
    draw::comparison,
    evaluate::{
        median,
        plan::TableChoice,
        record::{FAILURES, Outcome},
        request::{Request, RunError},
        run, write,
    },
    notes::Notes,
};

#[derive(Debug, Args)]
pub(super) struct EvaluateArgs {
    /// Table to fill; `all` is whatever tables of the thesis the data offers
    #[arg(long, value_enum)]
    table: TableChoice,
    /// Folder that `prep` has written
    #[arg(long, value_name = "DIR")]
    data: PathBuf,
    /// ONNX file, with the name it shall have in tables; may be given several times
    #[arg(long = "model", value_name = "[NAME=]FILE.onnx")]
    models: Vec<String>,
    /// Predictions that some program has saved (npy, npz, or a folder of 16-bit PNG, EXR or npy),
    /// with the name they shall have in tables; may be given several times
    #[arg(long = "predictions", value_name = "[NAME=]PATH")]
    predictions: Vec<String>,
    /// Folder for rows, tables and the run record
    #[arg(long, value_name = "DIR")]
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
    let constant = args.median_baseline.then_some(median::NAME);
    let models = named_files("model", &args.models, constant.as_slice())?;
    let mut taken: Vec<&str> = models.iter().map(|given| given.name.as_str()).collect();
    taken.extend(constant);
    let predictions = named_files("predictions", &args.predictions, &taken)?;
    let pool = args.threads.pool()?;
    let quiet = args.runtime.quiet;
    let request = Request {
        data: &args.data,
        table: args.table,
        protocols: &args.protocols,
        models: &models,
        predictions: &predictions,
        further: args.metrics,
        median_baseline: args.median_baseline,
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
        None => {
            let asked = !models.is_empty() || !predictions.is_empty() || args.median_baseline;
            conclude(outcome, folder, &finished.tables, asked, quiet)?
        }
    };
    finished.remove_journals()?;
    print(tables)?;
    Ok(code)
}

/// Writes everything that follows from the rows of a whole run; the tables, to be printed last, and
/// the exit code. Without rows there are none, which is a failure where something `was_asked` for.
pub(super) fn conclude(
    outcome: &Outcome,
    out: &Path,
    wanted: &[ThesisTable],
    was_asked: bool,
    quiet: bool,
) -> anyhow::Result<(String, u8)> {
    outcome.write(out)?;
    if outcome.rows.is_empty() && was_asked {
        eprint_line("error: nothing could be measured, so there is no table");
        return Ok((String::new(), FAILED));
    }
    let tables = write::derived(outcome, out, wanted)?;
    Notes::new(quiet).say(&format!("results are in {}", out.display()));
    if !outcome.failures.is_empty() {
        eprint_line(format_args!(
            "error: {} result(s) are missing; they are listed in {}",
            outcome.failures.len(),
            out.join(FAILURES).display()
        ));
    }
    let complete = outcome.record.complete;
    Ok((tables, if complete { DONE } else { FAILED }))
}
