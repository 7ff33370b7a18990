//! `bench publish`: writes a submission, adds measured lines to a leaderboard file, or merges files.

use std::path::PathBuf;

use clap::Args;
use strat_leaderboard::{publish, submission};
use strat_store::command::{DONE, eprint_line};

use crate::rows::leaderboard;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bench publish --rows results/rows.csv --submission board/submissions/strat
  bench publish --rows results/rows.csv --model strat --submission board/submissions/strat
  bench publish --rows results/rows.csv --to leaderboard.csv
  bench publish --merge mine.csv yours.csv --to leaderboard.csv")]
pub(super) struct PublishArgs {
    /// The rows file, with run.yaml beside it
    #[arg(long, value_name = "ROWS.csv", required_unless_present = "merge")]
    rows: Option<PathBuf>,
    /// Put these leaderboards together
    #[arg(long, value_name = "CSV", num_args = 1.., conflicts_with = "rows")]
    merge: Vec<PathBuf>,
    /// Write a folder ready to commit into a leaderboard's submissions: compressed rows, lines, run.yaml
    /// and a card to fill in
    #[arg(long, value_name = "FOLDER", conflicts_with_all = ["merge", "to", "expected"])]
    submission: Option<PathBuf>,
    /// The model that is submitted, where the rows are of several
    #[arg(long, value_name = "NAME", requires = "submission")]
    model: Option<String>,
    /// Add lines to this leaderboard file; replaced as a whole
    #[arg(long, value_name = "CSV", required_unless_present = "submission")]
    to: Option<PathBuf>,
    /// Images of the complete test set, instead of what run.yaml or the split says
    #[arg(long, value_name = "N")]
    expected: Option<u64>,
}

pub(super) fn run(args: &PublishArgs) -> anyhow::Result<u8> {
    match (&args.rows, &args.submission, &args.to) {
        (Some(rows), Some(folder), _) => {
            let written =
                publish::publish(rows, args.model.as_deref(), folder).map_err(|error| {
                    match error {
                        // By itself, so that its own exit code is seen.
                        publish::PublishError::Store(error) => anyhow::Error::from(error),
                        other => other.into(),
                    }
                })?;
            eprint_line(format_args!(
                "{} has {} rows of {} under {}",
                folder.display(),
                written.rows,
                written.method,
                written.protocols.join(", ")
            ));
            let card = folder.join(submission::CARD);
            eprint_line(match written.kept_card {
                true => format!("{} stays as it was", card.display()),
                false => format!(
                    "next: fill in {}, then `bench leaderboard check`",
                    card.display()
                ),
            });
        }
        (Some(rows), None, Some(to)) => {
            let (measured, lines) = leaderboard::append(rows, args.expected, to)?;
            eprint_line(format_args!(
                "{} has {lines} lines now; {measured} of them are about {}",
                to.display(),
                rows.display()
            ));
        }
        (None, _, Some(to)) => {
            let lines = leaderboard::merge(&args.merge, to)?;
            eprint_line(format_args!("{} has {lines} lines", to.display()));
        }
        // clap asks for one of them.
        (_, _, None) => {}
    }
    Ok(DONE)
}
