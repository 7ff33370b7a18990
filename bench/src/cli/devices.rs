//! `bench devices`.

use anyhow::Context as _;
use clap::Args;
use strat_store::command::{DONE, print};

use crate::runtime::inventory::Report;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bench devices
  bench devices --json")]
pub(super) struct DevicesArgs {
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &DevicesArgs) -> anyhow::Result<u8> {
    let report = Report::collect();
    let text = if args.json {
        serde_json::to_string_pretty(&report).context("the report cannot be written as JSON")?
            + "\n"
    } else {
        report.text()
    };
    print(text)?;
    Ok(DONE)
}
