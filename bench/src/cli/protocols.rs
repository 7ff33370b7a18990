//! `bench protocols`: the evaluation rules in words.

use clap::Args;
use strat_metrics::{protocols, tables::ThesisTable};
use strat_store::{
    command::{CliError, DONE, print},
    files,
};

use crate::protocol_file;

#[derive(Debug, Args)]
pub(super) struct ProtocolsArgs {
    /// State the rules of this protocol (or YAML file) in words; `diff` compares two
    #[arg(value_name = "NAME | diff A B")]
    names: Vec<String>,
}

pub(super) fn run(args: &ProtocolsArgs) -> anyhow::Result<u8> {
    let resolve = |name: &str| protocol_file::resolve(name).map_err(CliError::usage);
    match args.names.as_slice() {
        [] => {}
        [name] if name != "diff" => {
            let protocol = resolve(name)?;
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
    let mut text = String::new();
    for protocol in protocols() {
        let digest = protocol.digest();
        let tables: Vec<String> = ThesisTable::ALL
            .iter()
            .filter(|table| table.protocols().contains(&protocol.name.as_str()))
            .map(|table| format!("table {table}"))
            .collect();
        text += &format!(
            "{:<22} version {}  {}  {}\n",
            protocol.name,
            protocol.version,
            files::digest_prefix(&digest),
            tables.join(", ")
        );
    }
    text += "\nEach name also takes another crop (-nocrop, -garg, -eigencrop), -pp (flip post-processing), -distance\n\
             (scores by true depth) and an alignment (-median, -scale-depth, -affine-depth, -scale-disparity,\n\
             -affine-disparity), in any order. `bench protocols NAME` states the rules, `bench protocols diff A B` what differs.\n";
    print(text)?;
    Ok(DONE)
}
