//! `train export`: the model or the weights of a run.

use std::path::PathBuf;

use clap::Args;
use strat_onnx::metadata::Weights;
use strat_store::command::{CliError, eprint_line, print_line};

use crate::training::model;

/// Which run, and what to write.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  train export runs/strat --best -o strat.onnx
  train export runs/strat --discriminator            for `bench figures --matching --discriminator runs/strat`
  train export runs/strat -o start.safetensors       weights for --set initial_weights=FILE")]
pub(super) struct ExportArgs {
    /// Run folder.
    #[arg(value_name = "RUN")]
    run: PathBuf,
    /// File to write [default: model.onnx in the run folder]. One that ends in .safetensors gets the
    /// weights of all networks instead, for `initial_weights` or another program.
    #[arg(short, long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Export the best checkpoint by validation instead of the newest.
    #[arg(long)]
    best: bool,
    /// Export the discriminator instead (that of the left view, where there are two), as
    /// discriminator.onnx.
    #[arg(long, conflicts_with = "f16")]
    discriminator: bool,
    /// Store the weights in half precision: half the size; refused where that changes the output
    /// by more than the tolerance.
    #[arg(long)]
    f16: bool,
    /// Replace an export of another run at --out.
    #[arg(long)]
    force: bool,
}

pub(super) fn export(args: &ExportArgs) -> Result<(), CliError> {
    let weights = if args.f16 { Weights::F16 } else { Weights::F32 };
    let plain = args.out.as_deref().is_some_and(model::is_weights_file);
    if args.f16 && plain {
        return Err(CliError::Usage(
            "--f16 is for the ONNX model; initial weights are written as they are".to_owned(),
        ));
    }
    let out = args.out.as_deref();
    if args.discriminator {
        return discriminator(args);
    }
    let exported = model::export_run(&args.run, out, args.best, weights, args.force)?;
    for warning in &exported.warnings {
        eprint_line(warning);
    }
    if let Some(parity) = exported.parity {
        eprint_line(format_args!(
            "check passed: ONNX and trained network agree to {parity:.1e} of the image width"
        ));
    }
    print_line(exported.path.display())
}

fn discriminator(args: &ExportArgs) -> Result<(), CliError> {
    let out = args.out.as_deref();
    if out.is_some_and(model::is_weights_file) {
        return Err(CliError::Usage(
            "--discriminator writes ONNX; a file that ends in .safetensors gets the weights of all networks, \
             without it"
                .to_owned(),
        ));
    }
    let exported = model::export_discriminator(&args.run, out, args.best, args.force)?;
    for warning in &exported.warnings {
        eprint_line(warning);
    }
    if let Some(parity) = exported.parity {
        eprint_line(format_args!(
            "check passed: logits of the ONNX file and of the trained discriminator agree to {parity:.1e}"
        ));
    }
    print_line(exported.path.display())
}
