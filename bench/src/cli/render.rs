//! `bench render`: the thesis' tables from rows files alone.

use std::path::{Path, PathBuf};

use clap::Args;
use strat_metrics::tables::Source;
use strat_store::{
    claim::{self, Found, Mark},
    command::{CliError, DONE, eprint_line, print},
};

use super::args::ShowArgs;
use crate::{
    evaluate::{
        ownership, plan,
        record::ROWS,
        write::{self, Tables},
    },
    rows::{compare, leaderboard},
};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bench render --rows results/rows.csv -o tables
  bench render --rows mine/rows.csv yours/rows.csv -o tables")]
pub(super) struct RenderArgs {
    /// Rows files of one set; the first one's run.yaml says how many images there should be
    #[arg(long, value_name = "ROWS.csv", num_args = 1.., required = true)]
    rows: Vec<PathBuf>,
    /// Folder for the tables
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
    /// Images of the complete test set, instead of what run.yaml or the split says
    #[arg(long, value_name = "N")]
    expected: Option<u64>,
    /// Where the images come from, instead of what run.yaml says; numbers of `kitti` compete
    /// with published ones
    #[arg(long, value_name = "TEXT")]
    source: Option<String>,
    #[command(flatten)]
    show: ShowArgs,
}

/// Whose a folder of tables without their rows is.
const MARK: Mark = Mark {
    command: "bench render",
    record: "render.yaml",
    begins: "tool: bench render\n",
    writes: |name| name == "render.yaml" || ownership::is_table(name),
};

pub(super) fn run(args: &RenderArgs) -> anyhow::Result<u8> {
    let look = args.show.look()?;
    let rows = compare::read_all(&args.rows)?;
    let first = args
        .rows
        .first()
        .ok_or_else(|| CliError::Usage("`--rows` needs a file".to_owned()))?;
    let mut coverage = leaderboard::coverage_of(first, &rows)?;
    if let Some(expected) = args.expected {
        coverage.expected_images = expected;
    }
    if let Some(source) = &args.source {
        coverage.source = Source::from(source.as_str());
    }
    let measured = compare::protocols_of(&rows);
    let wanted = plan::tables_showing(measured.iter().map(String::as_str));
    if wanted.is_empty() {
        return Err(anyhow::anyhow!(plan::no_table_shows(&measured)));
    }
    // In the folder of a run its own tables are drawn again.
    let of_run = args.rows.len() == 1
        && claim::resolve(first)? == claim::resolve(&args.out.join(ROWS))?
        && matches!(ownership::MARK.examine(&args.out, &[]), Ok(Found::Record));
    if !of_run {
        let inputs: Vec<&Path> = args.rows.iter().map(PathBuf::as_path).collect();
        MARK.examine(&args.out, &inputs)?;
        MARK.begin(&args.out)?;
    }
    ownership::remove_tables(&args.out)?;
    let written = write::write_tables(&args.out, &wanted, &rows, &coverage, &look)?;
    if !of_run {
        MARK.finish(&args.out, MARK.begins.as_bytes())?;
    }
    for table in &written {
        for name in table.missing(&look.shown) {
            eprint_line(format_args!(
                "note: no row of table {} is called \"{name}\"",
                table.id()
            ));
        }
    }
    print(args.show.printed(&Tables {
        tables: written,
        beside: String::new(),
    })?)?;
    eprint_line(format_args!("the tables are in {}", args.out.display()));
    Ok(DONE)
}
