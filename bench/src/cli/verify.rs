//! `bench verify-leaderboard`: derives measured lines again from their rows.

use std::path::PathBuf;

use clap::Args;
use strat_store::command::{DONE, FAILED, eprint_line, print};

use crate::rows::leaderboard;

#[derive(Debug, Args)]
pub(super) struct VerifyArgs {
    /// The leaderboard
    leaderboard: PathBuf,
    /// The rows files its measured lines were made of
    #[arg(long, value_name = "ROWS.csv", num_args = 1.., required = true)]
    rows: Vec<PathBuf>,
}

pub(super) fn run(args: &VerifyArgs) -> anyhow::Result<u8> {
    let outcome = leaderboard::verify(&args.leaderboard, &args.rows)?;
    for sentence in &outcome.bad {
        eprint_line(format_args!("error: {sentence}"));
    }
    print(format_args!(
        "{} measured lines follow from their rows to the last digit, {} published lines are those of the \
         thesis; {}\n",
        outcome.good,
        outcome.published,
        match outcome.bad.len() {
            1 => "1 mismatch".to_owned(),
            count => format!("{count} mismatches"),
        }
    ))?;
    Ok(if outcome.bad.is_empty() { DONE } else { FAILED })
}
