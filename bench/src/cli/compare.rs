//! Commands that need rows files only, neither models nor data: `bench compare`,
//! `bench publish`, `bench verify-leaderboard` and `bench render`.

use std::path::PathBuf;

use anyhow::Context as _;
use clap::Args;
use strat_metrics::{
    compare::TestOptions,
    tables::{Source, ThesisTable},
};
use strat_store::files;

use super::{DONE, FAILED, Usage, print};
use crate::{evaluate::write, rows::compare, rows::leaderboard};

#[derive(Debug, Args)]
#[command(after_help = "\
Example:
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

pub(super) fn compare(args: &CompareArgs) -> anyhow::Result<u8> {
    let rows = compare::read_all(&args.rows)?;
    let options = TestOptions {
        permutations: args.draws,
        seed: args.seed,
        ..TestOptions::default()
    };
    let tests = compare::pairs(
        &rows,
        args.protocol.as_deref(),
        args.model_a.as_deref(),
        args.model_b.as_deref(),
        &options,
    )?;
    let text = if args.json {
        serde_json::to_string_pretty(&tests).context("the tests cannot be written as JSON")? + "\n"
    } else if args.csv {
        String::from_utf8_lossy(&compare::csv(&tests)?).into_owned()
    } else {
        compare::text(&tests, &options)
    };
    print(&text)?;
    Ok(DONE)
}

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

pub(super) fn publish(args: &PublishArgs) -> anyhow::Result<u8> {
    match &args.rows {
        Some(rows) => {
            let (measured, lines) = leaderboard::append(rows, args.expected, &args.to)?;
            eprintln!(
                "{} has {lines} lines now; {measured} of them are about {}",
                args.to.display(),
                rows.display()
            );
        }
        None => {
            let lines = leaderboard::merge(&args.merge, &args.to)?;
            eprintln!("{} has {lines} lines", args.to.display());
        }
    }
    Ok(DONE)
}

#[derive(Debug, Args)]
pub(super) struct VerifyArgs {
    /// The leaderboard
    leaderboard: PathBuf,
    /// The rows files its measured lines were made of
    #[arg(long, value_name = "ROWS.csv", num_args = 1.., required = true)]
    rows: Vec<PathBuf>,
}

pub(super) fn verify(args: &VerifyArgs) -> anyhow::Result<u8> {
    let outcome = leaderboard::verify(&args.leaderboard, &args.rows)?;
    for sentence in &outcome.bad {
        eprintln!("error: {sentence}");
    }
    print(&format!(
        "{} measured lines follow from their rows to the last digit, {} published lines are the \
         thesis', {} lines are not as they should be\n",
        outcome.good,
        outcome.published,
        outcome.bad.len()
    ))?;
    Ok(if outcome.bad.is_empty() { DONE } else { FAILED })
}

#[derive(Debug, Args)]
#[command(after_help = "\
Example:
  bench render --rows results/rows.csv --out tables")]
pub(super) struct RenderArgs {
    /// Rows files of one set; the first one's run.yaml says how many images there should be
    #[arg(long, value_name = "ROWS.csv", num_args = 1.., required = true)]
    rows: Vec<PathBuf>,
    /// Folder for the tables
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Images of the complete test set, instead of what run.yaml or the split says
    #[arg(long, value_name = "N")]
    expected: Option<u64>,
    /// Where the images come from, instead of what run.yaml says; figures of `kitti` compete
    /// with published ones
    #[arg(long, value_name = "TEXT")]
    source: Option<String>,
}

pub(super) fn render(args: &RenderArgs) -> anyhow::Result<u8> {
    let rows = compare::read_all(&args.rows)?;
    let first = args
        .rows
        .first()
        .ok_or_else(|| Usage("`--rows` needs a file".to_owned()))?;
    let mut coverage = leaderboard::coverage_of(first, &rows)?;
    if let Some(expected) = args.expected {
        coverage.expected_images = expected;
    }
    if let Some(source) = &args.source {
        coverage.source = Source::from(source.as_str());
    }
    let measured = compare::protocols_of(&rows);
    let shown: Vec<ThesisTable> = measured
        .iter()
        .filter_map(|name| ThesisTable::showing(name))
        .map(|(table, _)| table)
        .collect();
    let wanted: Vec<ThesisTable> = ThesisTable::ALL
        .into_iter()
        .filter(|table| shown.contains(table))
        .collect();
    if wanted.is_empty() {
        return Err(anyhow::anyhow!(
            "no table of the thesis is about {}; the tables are made of rows under kitti2015, \
             semantic, eigen-80, eigen-50 and make3d-c1",
            measured.join(", ")
        ));
    }
    files::check_writable(&args.out)?;
    let written = write::write_tables(&args.out, &wanted, &rows, &coverage)?;
    let texts: Vec<String> = written.iter().map(|table| table.text()).collect();
    print(&texts.join("\n"))?;
    eprintln!("the tables are in {}", args.out.display());
    Ok(DONE)
}
