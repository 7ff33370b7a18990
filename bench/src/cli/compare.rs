//! `bench compare`: tests the differences between models from rows files alone.

use std::path::PathBuf;

use anyhow::Context as _;
use clap::Args;
use strat_metrics::compare::TestOptions;
use strat_store::command::{DONE, print};

use crate::rows::compare;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bench compare results/rows.csv
  bench compare results-a/rows.csv results-b/rows.csv --model-a godard --model-b strat")]
pub(super) struct CompareArgs {
    /// Rows files; models of one file are compared as well
    #[arg(required = true, value_name = "ROWS.csv")]
    rows: Vec<PathBuf>,
    /// Only pairs with this model as the first
    #[arg(long, value_name = "NAME")]
    model_a: Option<String>,
    /// Only pairs with this model as the second
    #[arg(long, value_name = "NAME")]
    model_b: Option<String>,
    /// Only this protocol
    #[arg(long, value_name = "NAME")]
    protocol: Option<String>,
    /// Also the further metrics (SILog, log10, iRMSE, MAE, squared relative error), of runs with `--metrics`
    #[arg(long)]
    metrics: bool,
    /// Sign patterns that are drawn where there are too many to count
    #[arg(long, value_name = "N", default_value_t = 10_000,
          value_parser = clap::value_parser!(u32).range(1..=10_000_000))]
    draws: u32,
    /// Seed of the draws
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// Print JSON
    #[arg(long, conflicts_with = "csv")]
    json: bool,
    /// Print CSV
    #[arg(long)]
    csv: bool,
}

pub(super) fn run(args: &CompareArgs) -> anyhow::Result<u8> {
    let rows = compare::read_all(&args.rows)?;
    let options = TestOptions {
        permutations: args.draws,
        seed: args.seed,
    };
    let tests = compare::pairs(
        &rows,
        args.protocol.as_deref(),
        args.model_a.as_deref(),
        args.model_b.as_deref(),
        args.metrics,
        &options,
    )?;
    let text = if args.json {
        serde_json::to_string_pretty(&tests).context("the tests cannot be written as JSON")? + "\n"
    } else if args.csv {
        String::from_utf8_lossy(&compare::csv(&tests)?).into_owned()
    } else {
        compare::text(&tests, &options)
    };
    print(text)?;
    Ok(DONE)
}
