//! `bench leaderboard`: a leaderboard that people host, submit to and believe.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use strat_leaderboard::board::BoardError;
use strat_leaderboard::{check, init, show, site};
use strat_store::command::{CliError, DONE, FAILED, eprint_line, print, print_line};
use strat_store::human;

use crate::rows::leaderboard;

#[derive(Debug, Args)]
#[command(
    after_help = "\
Examples:
  bench leaderboard init depth-board --title Depth --data prepared/eigen
  bench publish --rows results/rows.csv --submission depth-board/submissions/strat
  bench leaderboard check depth-board
  bench leaderboard page depth-board --out site
  bench leaderboard show results/leaderboard.csv",
    arg_required_else_help = true
)]
pub(super) struct LeaderboardArgs {
    #[command(subcommand)]
    command: LeaderboardCommand,
}

#[derive(Debug, Subcommand)]
enum LeaderboardCommand {
    /// Lay out a repository: submissions, published rows, README and workflow
    Init(InitArgs),
    /// Verify every submission from its own rows
    Check(CheckArgs),
    /// Print a leaderboard file, protocol by protocol, best mean first
    Show(ShowArgs),
    /// Build a static site: rankings, methods, comparisons, downloads, badges
    Page(PageArgs),
}

#[derive(Debug, Args)]
struct InitArgs {
    /// A new or empty folder
    folder: PathBuf,
    /// What stands above the pages
    #[arg(long, default_value = "Depth leaderboard")]
    title: String,
    /// A prepared set whose rows are taken; can be given several times
    #[arg(long, value_name = "SET")]
    data: Vec<PathBuf>,
    /// The git address of strat, from which the workflow builds `bench`
    #[arg(long, value_name = "ADDRESS")]
    strat: Option<String>,
}

#[derive(Debug, Args)]
struct CheckArgs {
    /// The leaderboard
    folder: PathBuf,
}

#[derive(Debug, Args)]
struct ShowArgs {
    /// A leaderboard.csv
    file: PathBuf,
}

#[derive(Debug, Args)]
struct PageArgs {
    /// The leaderboard
    folder: PathBuf,
    /// The folder of the site; an earlier site there is replaced
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
}

pub(super) fn run(args: &LeaderboardArgs) -> anyhow::Result<u8> {
    match &args.command {
        LeaderboardCommand::Init(args) => {
            let strat = args.strat.as_deref();
            let data = init::init(&args.folder, &args.title, &args.data, strat).map_err(usage)?;
            eprint_line(init::next_steps(&args.folder, &data, strat));
            Ok(DONE)
        }
        LeaderboardCommand::Check(args) => run_check(args),
        LeaderboardCommand::Page(args) => run_page(args),
        LeaderboardCommand::Show(args) => {
            print(show::text(&leaderboard::read(&args.file)?))?;
            Ok(DONE)
        }
    }
}

/// Problems cost their submissions their place, not the others the page.
fn run_page(args: &PageArgs) -> anyhow::Result<u8> {
    site::examine(&args.out, &args.folder).map_err(usage)?;
    let checked = check::check(&args.folder, true).map_err(usage)?;
    for problem in &checked.problems {
        eprint_line(format_args!("left out: {problem}"));
    }
    let written = site::write(&checked, &args.out).map_err(usage)?;
    print_line(format_args!(
        "{}: {}, {} of {} in {}",
        args.out.join("index.html").display(),
        count(checked.submissions.len(), "method"),
        count(written.files, "file"),
        human::bytes(written.bytes),
        count(written.sections, "ranking"),
    ))?;
    Ok(if checked.problems.is_empty() {
        DONE
    } else {
        FAILED
    })
}

fn run_check(args: &CheckArgs) -> anyhow::Result<u8> {
    let checked = check::check(&args.folder, false).map_err(usage)?;
    for problem in &checked.problems {
        eprint_line(format_args!("error: {problem}"));
    }
    let lines: usize = checked.submissions.iter().map(|one| one.lines()).sum();
    print_line(format_args!(
        "{}, {} derived again from their rows; {}",
        count(checked.submissions.len(), "good submission"),
        count(lines, "line"),
        count(checked.problems.len(), "problem"),
    ))?;
    Ok(if checked.problems.is_empty() {
        DONE
    } else {
        FAILED
    })
}

/// A folder that is no leaderboard is wrong usage.
fn usage(error: BoardError) -> anyhow::Error {
    match error {
        BoardError::None(_) => CliError::usage(error).into(),
        // By itself, so that its own exit code is seen.
        BoardError::Store(error) => error.into(),
        other => other.into(),
    }
}

fn count(number: usize, one: &str) -> String {
    match number {
        1 => format!("1 {one}"),
        number => format!("{number} {one}s"),
    }
}
