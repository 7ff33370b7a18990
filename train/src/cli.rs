//! The `train` command: arguments, talk and exit codes.
//!
//! Results go to stdout, everything else to stderr. Exit codes: 0 done, 1 failed or
//! interrupted, 2 wrong usage.
#![allow(
    clippy::print_stdout,
    reason = "this module is the command's terminal output"
)]

use std::ffi::OsString;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Context;
use clap::{Args, Parser, Subcommand};
use strat_onnx::metadata::Weights;

use crate::config::{BUILT_IN, Config, Preset};
use crate::device::{self, DeviceChoice};
use crate::run::{self, Options, Outcome};

const EXAMPLES: &str = "Examples:
  train --config kitti-strat --data prepared/kitti --out runs/strat --device cuda
  train --config eigen-fixed --preset half --data prepared/eigen --out runs/half
  train --config demo --data prepared/demo --out runs/demo --set epochs=10
  train --resume --data prepared/kitti --out runs/strat
  train --config kitti-strat --print-config
  train export --run runs/strat --out strat.onnx
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
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Writes the ONNX model of a run from its newest checkpoint.
    Export(ExportArgs),
    /// Lists the devices that --device can name.
    Devices,
    /// Lists the built-in configurations.
    Configs,
}

#[derive(Debug, Args)]
struct TrainArgs {
    /// Configuration: a built-in name (`train configs` lists them) or a YAML file.
    #[arg(long, value_name = "NAME|FILE")]
    config: Option<String>,
    /// Sizes of the networks and their input: full, half, quarter, tiny or demo.
    #[arg(long, value_name = "NAME")]
    preset: Option<String>,
    /// Change one setting, e.g. --set epochs=10 or --set network.width=1/2.
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Folder of the prepared set.
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Run folder to write.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Continue the run in --out; its configuration is used unless --config is given.
    #[arg(long, conflicts_with = "force")]
    resume: bool,
    /// Replace the run in --out.
    #[arg(long)]
    force: bool,
    /// Where to train: cpu, wgpu or cuda, for a second GPU e.g. cuda:1.
    #[arg(long, default_value = "cpu", value_name = "DEVICE")]
    device: String,
    /// Stop after this many optimizer steps in all; the schedules stay those of the epochs.
    #[arg(long, value_name = "N")]
    max_steps: Option<u64>,
    /// Show no progress.
    #[arg(long)]
    quiet: bool,
    /// Show the resolved configuration and stop.
    #[arg(long)]
    print_config: bool,
}

#[derive(Debug, Args)]
struct ExportArgs {
    /// Run folder.
    #[arg(long, value_name = "DIR")]
    run: PathBuf,
    /// File to write [default: model.onnx in the run folder].
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Export the best checkpoint by validation instead of the newest.
    #[arg(long)]
    best: bool,
    /// Store the weights in half precision: half the size; refused where that changes the output
    /// by more than the tolerance.
    #[arg(long)]
    f16: bool,
}

/// Why the command ended without its result.
enum Stop {
    /// Arguments that make no sense: exit code 2.
    Usage(String),
    /// Everything else: exit code 1.
    Failed(anyhow::Error),
}

impl<E: Into<anyhow::Error>> From<E> for Stop {
    fn from(error: E) -> Self {
        Self::Failed(error.into())
    }
}

/// Runs the command with the arguments after the program's own name first; the exit code.
pub fn main(args: impl IntoIterator<Item = OsString>) -> u8 {
    let cli = match Cli::try_parse_from(args) {
        Ok(cli) => cli,
        Err(error) => {
            // Help and version are no errors and go to stdout; clap knows which is which.
            let _ = error.print();
            return u8::try_from(error.exit_code()).unwrap_or(2);
        }
    };
    let ended = match cli.command {
        None => train(&cli.train),
        Some(Command::Export(args)) => export(&args),
        Some(Command::Devices) => {
            devices();
            Ok(0)
        }
        Some(Command::Configs) => {
            for (name, text) in BUILT_IN {
                let first = text.lines().next().unwrap_or_default();
                println!("{name:16} {}", first.trim_start_matches("# "));
            }
            Ok(0)
        }
    };
    match ended {
        Ok(code) => code,
        Err(Stop::Usage(sentence)) => {
            eprintln!("error: {sentence}");
            2
        }
        Err(Stop::Failed(error)) => {
            eprintln!("error: {error:#}");
            1
        }
    }
}

/// The configuration that the arguments ask for.
fn configuration(args: &TrainArgs) -> Result<Config, Stop> {
    let usage = |error: crate::error::Error| Stop::Usage(error.to_string());
    let preset: Option<Preset> = args
        .preset
        .as_deref()
        .map(|name| name.parse().map_err(usage))
        .transpose()?;
    let source = match (&args.config, args.resume, &args.out) {
        (Some(source), ..) => source.clone(),
        (None, true, Some(out)) => {
            let path = out.join("config.yaml");
            if !path.exists() {
                return Err(Stop::Usage(format!(
                    "no training run in {}: there is no config.yaml, so nothing can be resumed",
                    out.display()
                )));
            }
            path.to_string_lossy().into_owned()
        }
        _ => {
            let names: Vec<&str> = BUILT_IN.iter().map(|(name, _)| *name).collect();
            return Err(Stop::Usage(format!(
                "which configuration? Give --config with a YAML file or one of {}",
                names.join(", ")
            )));
        }
    };
    let mut settings = args.set.clone();
    if let Some(steps) = args.max_steps {
        settings.push(format!("max_steps={steps}"));
    } else if args.resume && args.config.is_none() {
        // The run's own limit is where it stopped; resuming means to go on from there.
        settings.push("max_steps=null".to_owned());
    }
    Config::resolve(&source, preset, &settings).map_err(usage)
}

fn train(args: &TrainArgs) -> Result<u8, Stop> {
    let config = configuration(args)?;
    if args.print_config {
        print!("{}", config.to_yaml()?);
        return Ok(0);
    }
    let device: DeviceChoice = args
        .device
        .parse()
        .map_err(|error: crate::error::Error| Stop::Usage(error.to_string()))?;
    let needed = |value: &Option<PathBuf>, sentence: &str| {
        value
            .clone()
            .ok_or_else(|| Stop::Usage(sentence.to_owned()))
    };
    let data = needed(
        &args.data,
        "which prepared set? Give --data with a folder that `prep` has written",
    )?;
    let out = needed(
        &args.out,
        "where to? Give --out with a folder for the run, e.g. --out runs/first",
    )?;
    if !data.is_dir() {
        return Err(Stop::Usage(format!(
            "there is no folder {}; --data must name a prepared set (`prep` writes one)",
            data.display()
        )));
    }
    let stop = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stop);
    // A second interrupt does not wait for the step to end. A handler that is already there
    // (the command called twice in one process) stays.
    let _ = ctrlc::set_handler(move || {
        if flag.swap(true, Ordering::Relaxed) {
            std::process::exit(130);
        }
        eprintln!("stopping after this step; interrupt again to stop at once");
    });
    let options = Options {
        config,
        data,
        out: out.clone(),
        device,
        resume: args.resume,
        force: args.force,
        quiet: args.quiet,
        stop,
    };
    let outcome = run::run(&options)?;
    Ok(conclude(&outcome, &options))
}

fn conclude(outcome: &Outcome, options: &Options) -> u8 {
    let say = |text: String| {
        if !options.quiet {
            eprintln!("{text}");
        }
    };
    say(format!(
        "{} of {} steps in {:.0} s, {:.1} % of it waiting for images",
        outcome.steps,
        outcome.planned,
        outcome.seconds,
        100.0 * outcome.wait_share
    ));
    if outcome.broken_pairs > 0 {
        eprintln!(
            "{} training pairs could not be read and were replaced by others",
            outcome.broken_pairs
        );
    }
    if let Some(best) = &outcome.best {
        say(format!(
            "best validation {} {:.4} after epoch {}",
            best.score, best.value, best.epoch
        ));
    }
    if let (Some(model), Some(parity)) = (&outcome.model, outcome.parity) {
        say(format!(
            "the model differs from the trained network by at most {parity:.1e} of the image width"
        ));
        println!("{}", model.display());
    }
    if outcome.interrupted {
        eprintln!(
            "interrupted after step {}; continue with: train --resume --data {} --out {} --device {}",
            outcome.steps,
            options.data.display(),
            options.out.display(),
            options.device
        );
        return 1;
    }
    0
}

fn export(args: &ExportArgs) -> Result<u8, Stop> {
    let weights = if args.f16 { Weights::F16 } else { Weights::F32 };
    let (path, parity) = run::export_run(&args.run, args.out.as_deref(), args.best, weights)
        .with_context(|| format!("exporting the run {}", args.run.display()))?;
    eprintln!(
        "the model differs from the trained network by at most {parity:.1e} of the image width"
    );
    println!("{}", path.display());
    Ok(0)
}

fn devices() {
    for line in device::list() {
        let mark = if line.usable { "yes" } else { "no " };
        println!("{:8} {mark}  {}", line.name, line.note);
    }
}
