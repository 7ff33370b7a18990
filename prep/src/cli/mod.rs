//! The `prep` command line: parse, call, print. Results go to stdout, everything else to stderr.
//!
//! Exit codes are those of [`strat_store::command`]. Not here: any work; the rest of the crate knows
//! neither arguments nor the terminal.

mod args;
mod collections;
mod export;
mod kitti;
mod plan;
mod splits;
mod synth;
mod terminal;
mod verify;

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use clap::{FromArgMatches as _, Parser, Subcommand};
use strat_store::command::{CliError, DONE, USAGE, fail, utf8_arguments};
use strat_store::shell::{self, ColourArg, CompletionsArgs, take_colour};

use self::terminal::conclude;
use crate::set::shards;

const EXAMPLES: &str = "\
Examples:
  prep kitti --raw kitti_raw --stereo2015 kitti2015 --semantics kitti_semantics --out sets/kitti
  prep eigen --raw kitti_raw --out sets/eigen
  prep eigen --raw downloads --annotated data_depth_annotated.zip --codec jpeg --out sets/eigen
  prep eigen --raw kitti_raw --allow-missing --out sets/part      what is there of it
  prep splits kitti                                               what the split consists of
  prep pairs --csv pairs.csv --out sets/own                       your own rectified pairs
  prep export sets/eigen --kind velodyne --format npz --out gt    ground truth for NumPy
  prep pairs --csv pairs.csv --shard 0/8 --out sets/own           one of eight parts, on any machine
  prep merge sets/own                                             one set of all parts
  prep synth --preset tiny --out world                            a rendered stand-in for KITTI

A second run with the same options makes only what is missing.
Exit codes: 0 done, 1 failed or incomplete, 2 wrong usage.";

/// Builds prepared sets for training and evaluation from KITTI.
#[derive(Debug, Parser)]
#[command(name = "prep", version, after_help = EXAMPLES)]
struct Cli {
    #[command(subcommand)]
    command: Command,
    #[command(flatten)]
    colour: ColourArg,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Prepare the KITTI split: 29,839 training pairs, tested on stereo 2015 (tables 3.1 and 3.2).
    Kitti(kitti::KittiArgs),
    /// Prepare the Eigen split: 23,158 training pairs, tested on 697 Velodyne scans (table 3.3).
    Eigen(kitti::EigenArgs),
    /// Prepare your own rectified stereo pairs, named in a CSV file.
    Pairs(collections::PairsArgs),
    /// Prepare the test images of Make3D.
    Make3d(collections::Make3dArgs),
    /// Prepare Cityscapes.
    Cityscapes(collections::CityscapesArgs),
    /// Write ground truth of a prepared set for other programs: NumPy or 16-bit PNG.
    Export(export::ExportArgs),
    /// Merge the parts that runs with --shard have written into one set.
    #[command(after_help = "\
Examples:
  prep pairs --csv pairs.csv --shard 0/2 -o sets/own
  prep pairs --csv pairs.csv --shard 1/2 -o sets/own
  prep merge sets/own")]
    Merge {
        /// The folder that all of them were given as --out.
        #[arg(value_name = "DIR")]
        out: PathBuf,
    },
    /// Show what a preparation needs before it starts: archives, disk space, time.
    Plan(plan::PlanArgs),
    /// Check inputs or a prepared set: what is missing, cut off, unreadable or changed.
    Verify(verify::VerifyArgs),
    /// Show what a split consists of, beside the numbers the thesis states.
    Splits(splits::SplitsArgs),
    /// Render a street world in KITTI's own layouts.
    Synth(synth::SynthArgs),
    /// Print completions for a shell, or write manual pages.
    #[command(after_help = "\
Examples:
  prep completions bash                 for ~/.local/share/bash-completion/completions/prep
  prep completions --man man/man1       prep.1 and a page for each subcommand")]
    Completions(CompletionsArgs),
}

/// The parser of the command line, for tests of what guides tell users to type.
pub fn command() -> clap::Command {
    <Cli as clap::CommandFactory>::command()
}

/// Runs the command and returns its exit code. The first argument is the program's name.
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
            // Help and version are no errors: they go to stdout with code 0.
            let _ = error.print();
            return if error.use_stderr() { USAGE } else { DONE };
        }
    };
    let done = match cli.command {
        Command::Kitti(args) => kitti::kitti(&args),
        Command::Eigen(args) => kitti::eigen(&args),
        Command::Pairs(args) => collections::pairs(&args),
        Command::Make3d(args) => collections::make3d(&args),
        Command::Cityscapes(args) => collections::cityscapes(&args),
        Command::Export(args) => export::export(&args),
        Command::Merge { out } => merge(&out),
        Command::Plan(args) => plan::plan(&args),
        Command::Verify(args) => verify::verify(&args),
        Command::Splits(args) => splits::splits(&args),
        Command::Synth(args) => synth::synth(&args),
        Command::Completions(args) => shell::completions(&args, command()),
    };
    done.unwrap_or_else(|error| fail(&error))
}

fn merge(out: &Path) -> Result<u8, CliError> {
    conclude(out, None, false, &shards::merge(out)?)
}
