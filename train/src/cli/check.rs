//! `train check`: a device held against the processor.

use clap::Args;
use strat_store::command::{CliError, DONE, FAILED, eprint_line, print_line};
use strat_store::human;

use super::estimate::measure_apart;
use super::setup::Setup;
use crate::config::Config;
use crate::device::DeviceChoice;
use crate::training::check::{self, Findings, Part};

/// The configuration where none is named.
const USUAL: &str = "kitti-strat";

/// Which device.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  train check --device cuda
  train check --device wgpu --config kitti-strat --full        one pair at the configured size")]
pub(super) struct CheckArgs {
    #[command(flatten)]
    setup: Setup,
    /// Compare one pair at the configured size instead of a small network.
    #[arg(long)]
    full: bool,
}

/// Checks the devices; the exit code.
pub(super) fn check(args: &CheckArgs) -> Result<u8, CliError> {
    let setup = &args.setup;
    let source = setup.config.as_deref().unwrap_or(USUAL);
    let config = setup.resolve(source, &setup.set)?;
    let (first, others) = setup.devices()?;
    let mut code = DONE;
    for device in std::iter::once(first).chain(others) {
        let findings = check::check(&config, device, args.full)?;
        print_differences(&findings)?;
        match findings.verdict() {
            Ok(()) => print_time(args, source, &config, device)?,
            Err(error) => {
                eprint_line(format_args!("error: {error}"));
                code = FAILED;
            }
        }
    }
    Ok(code)
}

fn print_differences(findings: &Findings) -> Result<(), CliError> {
    let device = &findings.device;
    print_line(format_args!(
        "{:32} difference  allowed  largest in",
        format!("{device} beside cpu")
    ))?;
    for part in Part::ALL {
        match findings.largest(part) {
            Some(found) => print_line(format_args!(
                "{part:32} {:10.1e}  {:7.0e}  {}{}",
                found.value,
                part.allowed(),
                found.name,
                if found.is_wrong() { "  WRONG" } else { "" }
            ))?,
            None => print_line(format_args!("{part:32}       none"))?,
        }
    }
    Ok(())
}

/// What a step takes at the configured size.
fn print_time(
    args: &CheckArgs,
    source: &str,
    config: &Config,
    device: DeviceChoice,
) -> Result<(), CliError> {
    let batch = u32::try_from(config.batch).map_err(CliError::failed)?;
    eprint_line(format_args!(
        "measuring a step of batch {batch} at {}x{}",
        config.input.width, config.input.height
    ));
    let measured = measure_apart(&args.setup, source, device, batch)?;
    print_line(format_args!(
        "a step of batch {batch} at {}x{} takes {:.2} s and {}",
        config.input.width,
        config.input.height,
        measured.step_seconds,
        human::bytes(measured.peak_bytes as u64)
    ))
}
