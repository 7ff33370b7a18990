//! The `train` command: arguments, what it says, exit codes.
//!
//! Results go to stdout, everything else to stderr. Exit codes: 0 done, 1 failed or
//! interrupted, 2 wrong usage. What the subcommands do is in [`crate::training`].
mod check;
mod estimate;
mod export;
mod setup;
mod study;
mod train;

use std::ffi::OsString;

use clap::{FromArgMatches as _, Parser, Subcommand};
use strat_store::command::{CliError, DONE, USAGE, fail, print_line, utf8_arguments};
use strat_store::shell::{self, ColourArg, CompletionsArgs, take_colour};

use self::check::CheckArgs;
use self::estimate::{EstimateArgs, MeasureArgs};
use self::export::ExportArgs;
use self::study::StudyArgs;
use self::train::TrainArgs;
use crate::config::BUILT_IN;
use crate::device;

const EXAMPLES: &str = "Examples:
  train --config kitti-strat --data prepared/kitti --out runs/strat --device cuda
  train --config eigen-fixed --preset half --data prepared/eigen --out runs/half
  train --config demo --data prepared/demo --out runs/demo --set epochs=10
  train --resume --data prepared/kitti --out runs/strat
  train --config kitti-strat --print-config
  train export runs/strat --out strat.onnx
  train export runs/strat --out start.safetensors       weights for --set initial_weights=FILE
  train estimate --config kitti-strat                   memory and time by batch size
  train check --device wgpu                             does it compute what the cpu computes?
  train study study-kitti --data prepared/kitti --out studies/kitti
  train devices

Exit codes: 0 done, 1 failed or interrupted, 2 wrong usage.";

/// Trains a monocular depth network on the stereo pairs of a prepared set.
#[derive(Debug, Parser)]
#[command(name = "train", version, after_help = EXAMPLES, args_conflicts_with_subcommands = true)]
struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    train: TrainArgs,
    #[command(flatten)]
    colour: ColourArg,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Does many runs, variants x seeds, as one piece of work that can be stopped and goes on.
    Study(StudyArgs),
    /// Writes the ONNX model, or the weights, of a run from its newest checkpoint.
    Export(ExportArgs),
    /// Measures memory and time of a step by batch size, on noise.
    Estimate(EstimateArgs),
    /// Holds a device against the cpu: forward pass, losses, gradients, a step, an exported model.
    Check(CheckArgs),
    /// One measurement of `estimate`, in a process of its own.
    #[command(hide = true)]
    Measure(MeasureArgs),
    /// Lists the devices that --device can name.
    #[command(after_help = "\
Examples:
  train devices
  train --config kitti-strat --data prepared/kitti -o runs/strat --device cpu")]
    Devices,
    /// Lists the built-in configurations.
    #[command(after_help = "\
Examples:
  train configs
  train --config kitti-strat --print-config       all settings, to be saved and changed")]
    Configs,
    /// Prints completions for a shell, or writes manual pages.
    #[command(after_help = "\
Examples:
  train completions bash                 for ~/.local/share/bash-completion/completions/train
  train completions --man man/man1       train.1 and a page for each subcommand")]
    Completions(CompletionsArgs),
}

/// The parser of the command line, for tests of what guides tell users to type.
pub fn command() -> clap::Command {
    <Cli as clap::CommandFactory>::command()
}

/// Runs the command with the arguments after the program's own name first; the exit code.
pub fn main(args: impl IntoIterator<Item = OsString>) -> u8 {
    let args = match utf8_arguments(args) {
        Ok(args) => args,
        Err(error) => return fail(&error),
    };
    let (args, colour) = take_colour(args);
    let parsed = command().color(colour).try_get_matches_from(args);
    let cli = match parsed.and_then(|matches| Cli::from_arg_matches(&matches)) {
        Ok(cli) => cli,
        Err(error) => {
            // Help and version are no errors and go to stdout; clap knows which is which.
            let _ = error.print();
            return u8::try_from(error.exit_code()).unwrap_or(USAGE);
        }
    };
    let done = |result: Result<(), CliError>| result.map(|()| DONE);
    let ended = match cli.command {
        None => train::train(&cli.train),
        Some(Command::Study(args)) => study::study(&args),
        Some(Command::Export(args)) => done(export::export(&args)),
        Some(Command::Estimate(args)) => done(estimate::estimate(&args)),
        Some(Command::Check(args)) => check::check(&args),
        Some(Command::Measure(args)) => done(estimate::measure(&args)),
        Some(Command::Devices) => done(devices()),
        Some(Command::Configs) => done(configs()),
        Some(Command::Completions(args)) => shell::completions(&args, command()),
    };
    ended.unwrap_or_else(|error| fail(&error))
}

fn devices() -> Result<(), CliError> {
    device::list().iter().try_for_each(|line| {
        let mark = if line.usable { "yes" } else { "no " };
        print_line(format_args!("{:8} {mark}  {}", line.name, line.note))
    })
}

fn configs() -> Result<(), CliError> {
    BUILT_IN.iter().try_for_each(|(name, text)| {
        let first = text.lines().next().unwrap_or_default();
        print_line(format_args!("{name:16} {}", first.trim_start_matches("# ")))
    })
}
