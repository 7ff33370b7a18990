//! `bench merge`: the parts of a sharded run become one.

use std::path::PathBuf;

use clap::Args;
use strat_metrics::tables::ThesisTable;
use strat_store::{
    command::{eprint_line, print},
    shard::Shard,
};

use super::{
    args::{ReplaceArgs, ShowArgs},
    evaluate::conclude,
};
use crate::{
    evaluate::{
        ownership::{self, MARK},
        shards,
    },
    notes::Notes,
};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bench eval --table 3.3 --data set -m model.onnx -o results --shard 0/2
  bench eval --table 3.3 --data set -m model.onnx -o results --shard 1/2
  bench merge results")]
pub(super) struct MergeArgs {
    /// The folder that all parts had as --out; their own folders in it are removed
    out: PathBuf,
    /// No notes; errors still show
    #[arg(short, long)]
    quiet: bool,
    #[command(flatten)]
    replace: ReplaceArgs,
    #[command(flatten)]
    show: ShowArgs,
}

pub(super) fn run(args: &MergeArgs) -> anyhow::Result<u8> {
    let earlier = ownership::earlier_results(&args.out, &[])?;
    let (outcome, said) = shards::merge(&args.out)?;
    let earlier = earlier.filter(|_| !args.replace.force);
    if let Some(what) = earlier.and_then(|earlier| ownership::loses(&earlier, &outcome.record)) {
        return Err(ownership::refuse(&args.out, &what).into());
    }
    MARK.begin(&args.out)?;
    let tables: Vec<ThesisTable> = outcome
        .record
        .tables
        .iter()
        .filter_map(|name| name.parse().ok())
        .collect();
    let mut notes = Notes::new(args.quiet);
    said.into_iter().for_each(|remark| remark.say(&mut notes));
    let (tables, code) = conclude(&outcome, &args.out, &tables, &args.show, args.quiet)?;
    for path in Shard::remove_all(&args.out, ownership::is_of_part)? {
        eprint_line(format_args!(
            "note: {} is not of this run and stays",
            path.display()
        ));
    }
    print(tables)?;
    Ok(code)
}
