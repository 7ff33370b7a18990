//! `bench merge`: the parts of a divided run become one.

use std::path::PathBuf;

use clap::Args;
use strat_metrics::tables::ThesisTable;
use strat_store::{files, shard::PARTS};

use super::evaluate::conclude;
use crate::evaluate::shards;

#[derive(Debug, Args)]
#[command(after_help = "\
Example:
  bench --table 3.3 --data set --model model.onnx --out results --shard 0/2
  bench --table 3.3 --data set --model model.onnx --out results --shard 1/2
  bench merge results")]
pub(super) struct MergeArgs {
    /// The folder that all parts had as --out; their own folders in it are removed
    out: PathBuf,
    /// No notes; errors still show
    #[arg(long)]
    quiet: bool,
}

pub(super) fn run(args: &MergeArgs) -> anyhow::Result<u8> {
    let outcome = shards::merge(&args.out)?;
    let tables: Vec<ThesisTable> = outcome
        .record
        .tables
        .iter()
        .filter_map(|name| name.parse().ok())
        .collect();
    let code = conclude(&outcome, &args.out, &tables, true, args.quiet)?;
    files::remove(&args.out.join(PARTS))?;
    Ok(code)
}
