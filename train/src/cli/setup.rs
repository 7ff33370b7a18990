//! Which configuration, and where it runs: arguments that `train` and `train estimate` share.

use clap::Args;
use strat_store::command::CliError;

use crate::config::{BUILT_IN, Config, Preset};
use crate::device::DeviceChoice;

/// Which configuration, and where it runs.
#[derive(Debug, Args)]
pub(super) struct Setup {
    /// Configuration: a built-in name (`train configs` lists them) or a YAML file.
    #[arg(long, value_name = "NAME|FILE")]
    pub config: Option<String>,
    /// Sizes of the networks and their input: full, half, quarter, tiny or demo.
    #[arg(long, value_name = "NAME")]
    pub preset: Option<Preset>,
    /// Change one setting, e.g. --set epochs=10 or --set network.width=1/2.
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Where to train: cpu, wgpu or cuda, for a second GPU e.g. cuda:1. Several, as in cuda:0,cuda:1,
    /// share the batches of a step (`accumulate` of them).
    #[arg(
        long,
        default_value = "cpu",
        value_name = "DEVICE",
        value_delimiter = ','
    )]
    pub device: Vec<DeviceChoice>,
}

impl Setup {
    /// The configuration that --config names.
    pub fn named(&self) -> Result<&str, CliError> {
        self.config.as_deref().ok_or_else(|| {
            let names: Vec<&str> = BUILT_IN.iter().map(|(name, _)| *name).collect();
            CliError::Usage(format!(
                "which configuration? Give --config with a YAML file or one of {}",
                names.join(", ")
            ))
        })
    }

    /// The configuration `source` with the preset and the `settings`.
    pub fn resolve(&self, source: &str, settings: &[String]) -> Result<Config, CliError> {
        Config::resolve(source, self.preset, settings).map_err(CliError::usage)
    }

    /// The device of the networks, and those that share its work.
    pub fn devices(&self) -> Result<(DeviceChoice, Vec<DeviceChoice>), CliError> {
        devices_of(&self.device)
    }
}

/// The device of the networks, and those that share its work.
pub(super) fn devices_of(
    named: &[DeviceChoice],
) -> Result<(DeviceChoice, Vec<DeviceChoice>), CliError> {
    for (index, device) in named.iter().enumerate() {
        if named[..index].contains(device) {
            return Err(CliError::Usage(format!(
                "the device {device} is named twice; several devices must be different ones"
            )));
        }
    }
    match named.split_first() {
        Some((first, others)) => Ok((*first, others.to_vec())),
        None => Err(CliError::Usage(
            "which device? Give --device cpu".to_owned(),
        )),
    }
}
