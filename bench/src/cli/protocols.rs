//! `bench protocols`: the evaluation rules in words.

use anyhow::Context as _;
use clap::Args;
use serde::Serialize;
use strat_metrics::{Protocol, protocols, tables::ThesisTable};
use strat_store::{
    command::{CliError, DONE, print},
    files,
};

use crate::protocol_file;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bench protocols                                          all of them, a line each
  bench protocols eigen-80
  bench protocols diff eigen-80 eigen-monodepth2")]
pub(super) struct ProtocolsArgs {
    /// State the rules of this protocol (or YAML file) in words; `diff` compares two
    #[arg(value_name = "NAME | diff A B")]
    names: Vec<String>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// A protocol for scripts.
#[derive(Serialize)]
struct Described {
    name: String,
    version: u32,
    digest: String,
    tables: Vec<String>,
    rules: String,
}

impl Described {
    fn of(protocol: &Protocol) -> Self {
        let showing = ThesisTable::ALL.iter();
        Self {
            name: protocol.name.clone(),
            version: protocol.version,
            digest: protocol.digest(),
            tables: showing
                .filter(|table| table.protocols().contains(&protocol.name.as_str()))
                .map(ToString::to_string)
                .collect(),
            rules: protocol.describe(),
        }
    }
}

fn json(described: &impl Serialize) -> anyhow::Result<String> {
    let text = serde_json::to_string_pretty(described);
    Ok(text.context("the protocols cannot be written as JSON")? + "\n")
}

pub(super) fn run(args: &ProtocolsArgs) -> anyhow::Result<u8> {
    let resolve = |name: &str| protocol_file::resolve(name).map_err(CliError::usage);
    match args.names.as_slice() {
        [] => {}
        [name] if name != "diff" => {
            let protocol = resolve(name)?;
            if args.json {
                print(json(&Described::of(&protocol))?)?;
                return Ok(DONE);
            }
            print(format_args!(
                "{} (version {}, digest {})\n{}\n",
                protocol.name,
                protocol.version,
                protocol.digest(),
                protocol.describe()
            ))?;
            return Ok(DONE);
        }
        [word, a, b] if word == "diff" => {
            print(protocol_file::difference(&resolve(a)?, &resolve(b)?))?;
            return Ok(DONE);
        }
        _ => {
            return Err(CliError::Usage(
                "`bench protocols` takes nothing, one name, or `diff` and two names".to_owned(),
            )
            .into());
        }
    }
    let all: Vec<Described> = protocols().iter().map(Described::of).collect();
    if args.json {
        print(json(&all)?)?;
        return Ok(DONE);
    }
    let mut text = String::new();
    for one in &all {
        let tables: Vec<String> = one
            .tables
            .iter()
            .map(|table| format!("table {table}"))
            .collect();
        let line = format!(
            "{:<22} version {}  {}  {}",
            one.name,
            one.version,
            files::digest_prefix(&one.digest),
            tables.join(", ")
        );
        text += &format!("{}\n", line.trim_end());
    }
    text += "\nEach name also takes another crop (-nocrop, -garg, -eigencrop), -pp (flip post-processing), -distance\n\
             (scores by true depth) and an alignment (-median, -scale-depth, -affine-depth, -scale-disparity,\n\
             -affine-disparity), in any order. `bench protocols NAME` states the rules, `bench protocols diff A B` what differs.\n";
    print(text)?;
    Ok(DONE)
}
