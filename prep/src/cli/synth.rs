//! `prep synth`: arguments.

use std::path::PathBuf;

use clap::ValueEnum;
use clap::builder::PossibleValue;

use strat_store::command::{CliError, DONE, eprint_line};

use super::args::JobsArg;
use crate::synth::{self, Options, Preset};

#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  prep synth --preset tiny -o world
  prep synth --preset demo --seed 2 -o world")]
pub(super) struct SynthArgs {
    /// How much to render.
    #[arg(long, value_enum)]
    preset: Preset,
    /// Another seed gives another world.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    jobs: JobsArg,
    /// Show no progress.
    #[arg(short, long)]
    quiet: bool,
    /// Folder to write to: new, empty, or of an earlier run with the same options, of which only what is
    /// missing is rendered.
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
}

impl ValueEnum for Preset {
    fn value_variants<'a>() -> &'a [Self] {
        &Self::ALL
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        Some(PossibleValue::new(self.name()).help(self.about()))
    }
}

pub(super) fn synth(args: &SynthArgs) -> Result<u8, CliError> {
    let code = synth::run(&Options {
        preset: args.preset,
        seed: args.seed,
        threads: args.jobs.threads(),
        quiet: args.quiet,
        out: args.out.clone(),
    })?;
    if code == DONE && !args.quiet {
        eprint_line(format_args!(
            "next: prep kitti --raw {world}/kitti_raw --stereo2015 {world}/kitti2015 --semantics {world}/kitti2015 \
             --allow-missing --out sets/kitti, or prep eigen --raw {world}/kitti_raw --allow-missing --out sets/eigen",
            world = args.out.display()
        ));
    }
    Ok(code)
}
