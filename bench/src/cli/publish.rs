//! `bench publish`: adds measured lines to a leaderboard, or merges leaderboards.

use std::path::PathBuf;

use clap::Args;
use strat_store::command::{DONE, eprint_line};

use crate::rows::leaderboard;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bench publish --rows results/rows.csv --to leaderboard.csv
  bench publish --merge mine.csv yours.csv --to leaderboard.csv")]
pub(super) struct PublishArgs {
    /// Add the lines of this rows file
    #[arg(long, value_name = "ROWS.csv", required_unless_present = "merge")]
    rows: Option<PathBuf>,
    /// Put these leaderboards together
    #[arg(long, value_name = "CSV", num_args = 1.., conflicts_with = "rows")]
    merge: Vec<PathBuf>,
    /// The leaderboard; replaced as a whole
    #[arg(long, value_name = "CSV")]
    to: PathBuf,
    /// Images of the complete test set, instead of what run.yaml or the split says
    #[arg(long, value_name = "N")]
    expected: Option<u64>,
}

pub(super) fn run(args: &PublishArgs) -> anyhow::Result<u8> {
    match &args.rows {
        Some(rows) => {
            let (measured, lines) = leaderboard::append(rows, args.expected, &args.to)?;
            eprint_line(format_args!(
                "{} has {lines} lines now; {measured} of them are about {}",
                args.to.display(),
                rows.display()
            ));
        }
        None => {
            let lines = leaderboard::merge(&args.merge, &args.to)?;
            eprint_line(format_args!("{} has {lines} lines", args.to.display()));
        }
    }
    Ok(DONE)
}
