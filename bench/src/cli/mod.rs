//! The `bench` command: which subcommands there are, and exit codes.
//!
//! One file for each subcommand parses its arguments, calls the library and prints; [`args`] is what
//! several share. Results go to stdout, everything else to stderr; [`strat_store::command`] has the
//! exit codes. A broken image or model costs itself only and ends in code 1; what was good is kept.

mod args;
mod compare;
mod cues;
mod describe;
mod devices;
mod evaluate;
mod figures;
mod latency;
mod leaderboard;
mod merge;
mod model_process;
mod predict;
mod protocols;
mod publish;
mod render;
mod report;
mod setup;
mod sprites;
mod study;
mod verify;

use std::ffi::OsString;

use clap::{Args as _, CommandFactory as _, FromArgMatches as _, Parser, Subcommand};
use strat_store::command::{CliError, DONE, USAGE, fail, utf8_arguments};

use self::evaluate::EvaluateArgs;
use crate::{evaluate::plan::PlanError, runtime::process};

const EXAMPLES: &str = "\
Examples:
  bench setup
      put ONNX Runtime into a folder of its own, once
  bench --table 3.1 --data kitti_set --model strat=model.onnx --out results
      table 3.1 for one model
  bench --table 3.3 --data eigen_set --model a.onnx --model b.onnx --out results --device cuda
      two models side by side on an NVIDIA device
  bench --table all --data kitti_set --model model.onnx --median-baseline --pictures 8 --out results
      all tables the set offers, a constant baseline, and pictures
  bench report results
      one HTML page about all runs below a folder: tables, intervals, curves, best and worst images
  bench study studies/kitti --out results/study
      which variant is better, from the finished runs of `train study`
  bench protocols
      the evaluation rules by name
  bench devices
      what this machine can run models on, and why not on the rest
  bench --table 3.3 --data eigen_set --predictions godard=disparities.npy --out results
      predictions that another program has saved, without a model
  bench --table 3.3 --data eigen_set --model model.onnx --out results --shard 0/8
      one of eight parts, on as many machines; `bench merge results` puts them together
  bench describe model.onnx --image street.png
      a first description of a downloaded model, for you to confirm
  bench predict --model model.onnx photos --out depth --format exr,color --focal-px 721.5 --baseline-m 0.54
      depth maps and coloured pictures of a folder of images
  bench latency --model model.onnx --images photos --threads 1,2 --batch 1,4 --out speed
      percentiles and throughput, from file to depth and for the session alone
  bench figures --data kitti_set --model a.onnx --model b.onnx --out figures
      depth and error of models side by side, and the right views they make
  bench cues --data kitti_set --model model.onnx --out cues
      which depth cues the model uses, with figures 4.3 to 4.10

Models of other projects need a description beside the file (model.yaml for model.onnx):
  input:  {width: 640, height: 192, range: 0..1, mean: [0.485, 0.456, 0.406],
           std: [0.229, 0.224, 0.225], channels: rgb, layout: nchw, kernel: lanczos}
  output: {name: disp, meaning: inverse_depth, sigmoid: {min_depth: 0.1, max_depth: 100},
           scale: 5.4, channel: 0, layout: nchw}
`bench describe` drafts one; README.md of bench has all keys. There
meaning is disparity_fraction, disparity_px, inverse_depth or depth (of unknown scale unless
`scale` says how many metres the unit is), inverse_depth_per_m or depth_m.

Saved predictions need one too (disps.yaml for disps.npy or disps.npz, predictions.yaml in a folder
of PNG, EXR or npy files), with meaning, sigmoid, scale and png_divisor:
  meaning: disparity_fraction

Exit codes: 0 done, 1 failed or incomplete, 2 wrong usage.";

#[derive(Debug, Parser)]
#[command(
    name = "bench",
    version,
    about = "Evaluates ONNX depth models and writes the tables 3.1, 3.2 and 3.3",
    after_help = EXAMPLES,
    args_conflicts_with_subcommands = true,
    subcommand_negates_reqs = true,
    arg_required_else_help = true
)]
struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
}

/// What a command line asks for: a subcommand, or tables.
enum Asked {
    Command(Command),
    Tables(EvaluateArgs),
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Install ONNX Runtime into a folder of its own (needs python3 with pip, once)
    Setup(setup::SetupArgs),
    /// Put the parts of a divided run (--shard) together
    Merge(merge::MergeArgs),
    /// Show what this machine can run models on, and why not on the rest
    Devices(devices::DevicesArgs),
    /// Draft the description that a model of another project needs, for you to confirm
    Describe(describe::DescribeArgs),
    /// Write depth, disparity or coloured pictures of images
    Predict(predict::PredictArgs),
    /// Time models over threads and batches, after MLPerf's LoadGen
    Latency(latency::LatencyArgs),
    /// Test which depth cues models use (figures 4.3 to 4.10)
    Cues(cues::CuesArgs),
    /// Cut sprites for `bench cues` out of a labelled set's own images
    Sprites(sprites::SpritesArgs),
    /// Draw what models make of the same images (figures 3.3 and 3.6 to 3.10)
    Figures(figures::FiguresArgs),
    /// List the evaluation protocols, or state the rules of one
    Protocols(protocols::ProtocolsArgs),
    /// Test the differences between models over the images both have
    Compare(compare::CompareArgs),
    /// Host a leaderboard: lay it out, check its submissions
    Leaderboard(leaderboard::LeaderboardArgs),
    /// Write a submission to a leaderboard, add lines to a leaderboard file, or merge files
    Publish(publish::PublishArgs),
    /// Derive every measured line of a leaderboard again from its rows
    VerifyLeaderboard(verify::VerifyArgs),
    /// Write the thesis' tables from rows alone
    Render(render::RenderArgs),
    /// Say which variant of a study is better, over seeds and drives (see `train study`)
    Study(study::StudyArgs),
    /// Write one HTML page about everything below a folder of results
    Report(report::ReportArgs),
    /// Run one model for the process that starts this
    #[command(name = process::COMMAND, hide = true)]
    ModelProcess(model_process::ModelProcessArgs),
}

/// The parser of the command line.
pub fn command() -> clap::Command {
    EvaluateArgs::augment_args(Cli::command())
}

/// clap's derive never finds an optional group of options that contains another, so the options of
/// `bench --table` are read here, where no subcommand is named.
fn parse(args: &[OsString]) -> Result<Asked, clap::Error> {
    let matches = command().try_get_matches_from(args)?;
    Ok(match Cli::from_arg_matches(&matches)?.command {
        Some(command) => Asked::Command(command),
        None => Asked::Tables(EvaluateArgs::from_arg_matches(&matches)?),
    })
}

/// Runs the command with the given arguments, the program's name first, and returns the exit
/// code.
pub fn main(args: impl IntoIterator<Item = OsString>) -> u8 {
    let args = match utf8_arguments(args) {
        Ok(args) => args,
        Err(error) => return fail(&error),
    };
    let arguments: Vec<String> = args
        .iter()
        .skip(1)
        .map(|argument| argument.to_string_lossy().into_owned())
        .collect();
    let asked = match parse(&args) {
        Ok(asked) => asked,
        Err(error) => {
            // clap knows which of its messages are help (stdout, success) and which are not.
            let _ = error.print();
            return if error.use_stderr() { USAGE } else { DONE };
        }
    };
    run(asked, arguments).unwrap_or_else(|error| match error.downcast::<PlanError>() {
        Ok(error) => fail(&CliError::usage(error)),
        Err(error) => fail(error.as_ref()),
    })
}

fn run(asked: Asked, arguments: Vec<String>) -> anyhow::Result<u8> {
    let command = match asked {
        Asked::Tables(args) => return evaluate::run(&args, arguments),
        Asked::Command(command) => command,
    };
    match command {
        Command::Setup(args) => setup::run(&args),
        Command::Merge(args) => merge::run(&args),
        Command::Devices(args) => devices::run(&args),
        Command::Describe(args) => describe::run(&args),
        Command::Predict(args) => predict::run(&args, arguments),
        Command::Latency(args) => latency::run(&args),
        Command::Cues(args) => cues::run(&args, arguments),
        Command::Sprites(args) => sprites::run(&args),
        Command::Figures(args) => figures::run(&args, arguments),
        Command::Protocols(args) => protocols::run(&args),
        Command::Compare(args) => compare::run(&args),
        Command::Leaderboard(args) => leaderboard::run(&args),
        Command::Publish(args) => publish::run(&args),
        Command::VerifyLeaderboard(args) => verify::run(&args),
        Command::Render(args) => render::run(&args),
        Command::Study(args) => study::run(&args, arguments),
        Command::Report(args) => report::run(&args),
        Command::ModelProcess(args) => model_process::run(&args),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arguments_are_well_formed() {
        command().debug_assert();
    }

    #[test]
    fn a_table_and_a_subcommand_are_told_apart() {
        let asked = |line: &str| parse(&line.split(' ').map(OsString::from).collect::<Vec<_>>());
        let table = asked("bench --table 3.1 --data set --out results --model a.onnx");
        assert!(matches!(table, Ok(Asked::Tables(_))));
        let other = asked("bench report results");
        assert!(matches!(other, Ok(Asked::Command(Command::Report(_)))));
        assert!(
            asked("bench --table 3.1 --out results").is_err(),
            "--data is missing"
        );
    }
}
