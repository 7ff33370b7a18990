//! `bench model-process`: the process that `bench` starts for each model; nothing for users.

use std::path::PathBuf;

use clap::Args;
use strat_store::command::{CliError, DONE};

use crate::runtime::{Device, RuntimeChoice, serve::serve};

#[derive(Debug, Args)]
pub(super) struct ModelProcessArgs {
    #[arg(value_enum)]
    runtime: RuntimeChoice,
    device: Device,
    threads: usize,
    model: PathBuf,
}

pub(super) fn run(args: &ModelProcessArgs) -> anyhow::Result<u8> {
    serve(args.runtime, &args.model, args.device, args.threads).map_err(CliError::failed)?;
    Ok(DONE)
}
