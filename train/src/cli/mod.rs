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
use serde::Serialize;
use strat_onnx::metadata::Weights;

use crate::config::{BUILT_IN, Config, Preset};
use crate::device::{self, DeviceChoice};
use crate::training::memory::{self, Measured, Need};
use crate::training::run::{self, Options, Outcome};

const EXAMPLES: &str = "Examples:
  train --config kitti-strat --data prepared/kitti --out runs/strat --device cuda
  train --config eigen-fixed --preset half --data prepared/eigen --out runs/half
  train --config demo --data prepared/demo --out runs/demo --set epochs=10
  train --resume --data prepared/kitti --out runs/strat
  train --config kitti-strat --print-config
  train export runs/strat --out strat.onnx
  train export runs/strat --out start.safetensors       weights for --set start_weights=FILE
  train estimate --config kitti-strat                   memory and time by batch size
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
    /// Writes the ONNX model, or the weights, of a run from its newest checkpoint.
    Export(ExportArgs),
    /// Measures memory and time of a step by batch size, on noise.
    Estimate(EstimateArgs),
    /// One measurement of `estimate`, in a process of its own.
    #[command(hide = true)]
    Measure(EstimateArgs),
    /// Lists the devices that --device can name.
    Devices,
    /// Lists the built-in configurations.
    Configs,
}

/// Which configuration, and where it runs.
#[derive(Debug, Args)]
struct Setup {
    /// Configuration: a built-in name (`train configs` lists them) or a YAML file.
    #[arg(long, value_name = "NAME|FILE")]
    config: Option<String>,
    /// Sizes of the networks and their input: full, half, quarter, tiny or demo.
    #[arg(long, value_name = "NAME")]
    preset: Option<String>,
    /// Change one setting, e.g. --set epochs=10 or --set network.width=1/2.
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Where to train: cpu, wgpu or cuda, for a second GPU e.g. cuda:1. Several, as in cuda:0,cuda:1,
    /// share the batches of a step (`accumulate` of them).
    #[arg(
        long,
        default_value = "cpu",
        value_name = "DEVICE",
        value_delimiter = ','
    )]
    device: Vec<String>,
}

#[derive(Debug, Args)]
struct TrainArgs {
    #[command(flatten)]
    setup: Setup,
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
    /// Begin although the step is predicted not to fit into the memory that is free.
    #[arg(long)]
    ignore_memory: bool,
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
struct EstimateArgs {
    #[command(flatten)]
    setup: Setup,
    /// Batch sizes to measure; larger ones are reckoned from these.
    #[arg(long, value_name = "N,N", value_delimiter = ',', default_value = "1,2",
          value_parser = clap::value_parser!(u32).range(1..=1024))]
    measure: Vec<u32>,
    /// Print one line of JSON for scripts.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Args)]
struct ExportArgs {
    /// Run folder.
    #[arg(value_name = "RUN")]
    run: PathBuf,
    /// File to write [default: model.onnx in the run folder]. One that ends in .safetensors gets the
    /// weights of all networks instead, for `start_weights` or another program.
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

/// The parser of the command line, for tests of what guides tell users to type.
pub fn command() -> clap::Command {
    <Cli as clap::CommandFactory>::command()
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
        Some(Command::Estimate(args)) => estimate(&args),
        Some(Command::Measure(args)) => measure(&args),
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
    let source = match (&args.setup.config, args.resume, &args.out) {
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
        _ => args.setup.named()?.to_owned(),
    };
    let mut settings = args.setup.set.clone();
    if let Some(steps) = args.max_steps {
        settings.push(format!("max_steps={steps}"));
    } else if args.resume && args.setup.config.is_none() {
        // The run's own limit is where it stopped; resuming means to go on from there.
        settings.push("max_steps=null".to_owned());
    }
    args.setup.resolve(&source, &settings)
}

impl Setup {
    /// The configuration that --config names.
    fn named(&self) -> Result<&str, Stop> {
        self.config.as_deref().ok_or_else(|| {
            let names: Vec<&str> = BUILT_IN.iter().map(|(name, _)| *name).collect();
            Stop::Usage(format!(
                "which configuration? Give --config with a YAML file or one of {}",
                names.join(", ")
            ))
        })
    }

    fn resolve(&self, source: &str, settings: &[String]) -> Result<Config, Stop> {
        let preset: Option<Preset> = self
            .preset
            .as_deref()
            .map(|name| name.parse().map_err(usage))
            .transpose()?;
        Config::resolve(source, preset, settings).map_err(usage)
    }

    /// The device of the networks, and those that share its work.
    fn devices(&self) -> Result<(DeviceChoice, Vec<DeviceChoice>), Stop> {
        let mut devices = Vec::new();
        for name in &self.device {
            let device: DeviceChoice = name.parse().map_err(usage)?;
            if devices.contains(&device) {
                return Err(Stop::Usage(format!(
                    "the device {device} is named twice; several devices must be different ones"
                )));
            }
            devices.push(device);
        }
        match devices.split_first() {
            Some((first, others)) => Ok((*first, others.to_vec())),
            None => Err(Stop::Usage("which device? Give --device cpu".to_owned())),
        }
    }
}

/// A mistake in the arguments.
fn usage(error: crate::error::Error) -> Stop {
    Stop::Usage(error.to_string())
}

fn train(args: &TrainArgs) -> Result<u8, Stop> {
    let config = configuration(args)?;
    if args.print_config {
        print!("{}", config.to_yaml()?);
        return Ok(0);
    }
    let (device, helpers) = args.setup.devices()?;
    if config.accumulate <= helpers.len() {
        return Err(Stop::Usage(format!(
            "{} devices share the batches of a step, but `accumulate` is {}; --set accumulate={} \
             gives each of them one",
            helpers.len() + 1,
            config.accumulate,
            helpers.len() + 1
        )));
    }
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
        helpers,
        resume: args.resume,
        force: args.force,
        quiet: args.quiet,
        ignore_memory: args.ignore_memory,
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
            options.device_names()
        );
        return 1;
    }
    0
}

fn export(args: &ExportArgs) -> Result<u8, Stop> {
    let weights = if args.f16 { Weights::F16 } else { Weights::F32 };
    let plain = args.out.as_deref().is_some_and(run::is_weights_file);
    if args.f16 && plain {
        return Err(Stop::Usage(
            "--f16 is for the ONNX model; start weights are written as they are".to_owned(),
        ));
    }
    let exported = run::export_run(&args.run, args.out.as_deref(), args.best, weights)
        .with_context(|| format!("exporting the run {}", args.run.display()))?;
    if let Some(parity) = exported.parity {
        eprintln!(
            "the model differs from the trained network by at most {parity:.1e} of the image width"
        );
    }
    println!("{}", exported.path.display());
    Ok(0)
}

/// What `estimate` tells, for scripts.
#[derive(Serialize)]
struct Estimate {
    device: String,
    measured: Vec<Measured>,
    free_bytes: f64,
    largest_batch: Option<usize>,
}

fn estimate(args: &EstimateArgs) -> Result<u8, Stop> {
    let config = args.setup.resolve(args.setup.named()?, &args.setup.set)?;
    let (device, _) = args.setup.devices()?;
    // Opened here first for its sentence; the measurements are processes of their own.
    device.open()?;
    let mut measured = Vec::new();
    for batch in &args.measure {
        eprintln!("measuring batch {batch}");
        measured.push(measure_apart(args, *batch)?);
    }
    let free = memory::free();
    let line = Need::through(&measured);
    // A GPU's own memory is not known.
    let on_cpu = device == DeviceChoice::Cpu;
    let largest = line.filter(|_| on_cpu).map(|line| line.largest_batch(free));
    if args.json {
        let told = Estimate {
            device: device.to_string(),
            measured,
            free_bytes: free,
            largest_batch: largest,
        };
        println!("{}", serde_json::to_string(&told)?);
        return Ok(0);
    }
    println!("batch  memory     step      images/s  origin");
    for m in &measured {
        println!(
            "{:5}  {:9}  {:6.2} s  {:8.2}  measured",
            m.batch,
            memory::human(m.peak_bytes),
            m.step_seconds,
            (m.batch * config.accumulate) as f64 / m.step_seconds
        );
    }
    if let Some(line) = line {
        let last = measured.iter().map(|m| m.batch).max().unwrap_or(0);
        for batch in [2, 4, 8, 16, 32].into_iter().filter(|batch| *batch > last) {
            let bytes = memory::human(line.bytes(batch));
            println!("{batch:5}  {bytes:9}                      line through the measured");
        }
    }
    match largest {
        Some(0) => println!("{} are free: not even batch 1 fits", memory::human(free)),
        Some(fits) => println!("{} are free: up to batch {fits} fits", memory::human(free)),
        None if on_cpu => println!("{} are free", memory::human(free)),
        None => println!("the memory of the device is not known; compare with its data sheet"),
    }
    Ok(0)
}

/// Measures one batch size in a process of its own, so that its peak is no other's.
fn measure_apart(args: &EstimateArgs, batch: u32) -> Result<Measured, Stop> {
    let mut command = std::process::Command::new(std::env::current_exe()?);
    command
        .arg("measure")
        .args(["--device", &args.setup.device.join(",")]);
    command.args(["--config", args.setup.named()?]);
    if let Some(preset) = &args.setup.preset {
        command.args(["--preset", preset]);
    }
    let settings = args.setup.set.iter().cloned();
    for setting in settings.chain([format!("batch={batch}")]) {
        command.args(["--set", &setting]);
    }
    let output = command.stderr(std::process::Stdio::inherit()).output()?;
    if !output.status.success() {
        return Err(Stop::Failed(anyhow::anyhow!(
            "the measurement of batch {batch} ended with {}; it may have run out of memory",
            output.status
        )));
    }
    serde_json::from_slice(&output.stdout)
        .with_context(|| format!("the measurement of batch {batch} cannot be read"))
        .map_err(Stop::Failed)
}

fn measure(args: &EstimateArgs) -> Result<u8, Stop> {
    let config = args.setup.resolve(args.setup.named()?, &args.setup.set)?;
    let (device, _) = args.setup.devices()?;
    let measured = memory::measure(&config, device)?;
    println!("{}", serde_json::to_string(&measured)?);
    Ok(0)
}

fn devices() {
    for line in device::list() {
        let mark = if line.usable { "yes" } else { "no " };
        println!("{:8} {mark}  {}", line.name, line.note);
    }
}
