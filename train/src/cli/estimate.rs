//! `train estimate`: memory and time of a step by batch size, measured in processes of their own.

use std::path::PathBuf;

use clap::Args;
use serde::Serialize;
use strat_store::command::{CliError, eprint_line, print_line};
use strat_store::human;
use strat_store::set::PreparedSet;

use super::setup::Setup;
use crate::device::DeviceChoice;
use crate::training::memory::{self, Measured, Need};

/// What to measure.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  train estimate --config kitti-strat
  train estimate --config kitti-strat --measure 1,4 --json")]
pub(super) struct EstimateArgs {
    #[command(flatten)]
    setup: Setup,
    /// Batch sizes to measure; larger ones are extrapolated.
    #[arg(long, value_name = "N,N", value_delimiter = ',', default_value = "1,2",
          value_parser = clap::value_parser!(u32).range(1..=1024))]
    measure: Vec<u32>,
    /// Print one line of JSON for scripts.
    #[arg(long)]
    json: bool,
}

/// One measurement.
#[derive(Debug, Args)]
pub(super) struct MeasureArgs {
    #[command(flatten)]
    of: EstimateArgs,
    /// Prepared set of whose pairs some are validated.
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
}

/// What `estimate` tells, for scripts.
#[derive(Serialize)]
struct Estimate {
    device: String,
    measured: Vec<Measured>,
    free_bytes: f64,
    largest_batch: Option<usize>,
}

/// Measures the batch sizes and tells what fits.
pub(super) fn estimate(args: &EstimateArgs) -> Result<(), CliError> {
    let config = args.setup.resolve(args.setup.named()?, &args.setup.set)?;
    let (device, _) = args.setup.devices()?;
    // Opened here first for its sentence; the measurements are processes of their own.
    device.open()?;
    let mut measured = Vec::new();
    for batch in &args.measure {
        eprint_line(format_args!("measuring batch {batch}"));
        measured.push(measure_apart(
            &args.setup,
            args.setup.named()?,
            device,
            *batch,
        )?);
    }
    let free = memory::free();
    let line = Need::through(&measured);
    // A GPU's own memory is not known.
    let on_cpu = device == DeviceChoice::Cpu;
    let largest = line.filter(|_| on_cpu).map(|line| line.largest_batch(free));
    if args.json {
        return print_json(&Estimate {
            device: device.to_string(),
            measured,
            free_bytes: free,
            largest_batch: largest,
        });
    }
    print_line("batch  memory     step      images/s  origin")?;
    for m in &measured {
        print_line(format_args!(
            "{:5}  {:9}  {:6.2} s  {:8.2}  measured",
            m.batch,
            bytes(m.peak_bytes),
            m.step_seconds,
            (m.batch * config.accumulate) as f64 / m.step_seconds
        ))?;
    }
    if let Some(line) = line {
        let last = measured.iter().map(|m| m.batch).max().unwrap_or(0);
        for batch in [2, 4, 8, 16, 32].into_iter().filter(|batch| *batch > last) {
            let bytes = bytes(line.bytes(batch));
            print_line(format_args!(
                "{batch:5}  {bytes:9}                      extrapolated"
            ))?;
        }
    }
    let free = bytes(free);
    print_line(match largest {
        Some(0) => format!("{free} free: not even batch 1 fits"),
        Some(fits) => format!("{free} free: up to batch {fits} fits"),
        None if on_cpu => format!("{free} free"),
        None => "the memory of the device is not known; compare with its data sheet".to_owned(),
    })
}

fn bytes(count: f64) -> String {
    human::bytes(count as u64)
}

fn print_json(value: &impl Serialize) -> Result<(), CliError> {
    print_line(serde_json::to_string(value).map_err(CliError::failed)?)
}

/// Measures one batch size of the configuration `source` in a process of its own, so that its peak is no
/// other's.
pub(super) fn measure_apart(
    setup: &Setup,
    source: &str,
    device: DeviceChoice,
    batch: u32,
) -> Result<Measured, CliError> {
    let settings = setup.set.iter().cloned();
    let settings: Vec<String> = settings.chain([format!("batch={batch}")]).collect();
    Ok(memory::measure_apart(
        source,
        setup.preset,
        &settings,
        device,
    )?)
}

/// One measurement, in this process.
pub(super) fn measure(args: &MeasureArgs) -> Result<(), CliError> {
    let setup = &args.of.setup;
    let config = setup.resolve(setup.named()?, &setup.set)?;
    let (device, _) = setup.devices()?;
    let set = args.data.as_deref().map(PreparedSet::open).transpose()?;
    print_json(&memory::measure(&config, device, set.as_ref())?)
}
