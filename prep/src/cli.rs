//! The `prep` command line. Results go to stdout, everything else to stderr.
//!
//! Exit codes: 0 done; 1 failed or incomplete; 2 wrong usage.
#![allow(
    clippy::print_stdout,
    reason = "this module is where results are printed"
)]

use std::ffi::OsString;
use std::fmt::Display;
use std::io::Write;
use std::path::{Path, PathBuf};

use clap::{Parser, Subcommand};
use strat_splits::{Role, Split, counts, digest, test_ids, training, validation};
use strat_store::resize::Kernel;

use crate::build::{self, FAILURES, Report, Settings};
use crate::error::{Error, Result};
use crate::inventory::{self, Inventory};
use crate::raw::RawFolder;
use crate::stereo2015::{Kind, SceneFolder};
use crate::synth;

const EXAMPLES: &str = "\
Examples:
  prep kitti --raw kitti_raw --stereo2015 kitti2015 --semantics kitti_semantics --out sets/kitti
  prep eigen --raw kitti_raw --out sets/eigen
  prep eigen --raw kitti_raw --allow-missing --out sets/part      what is there of it
  prep splits kitti                                               what the split consists of
  prep synth --preset tiny --out world                            a rendered stand-in for KITTI

A second run with the same options makes only what is missing.
Exit codes: 0 done, 1 failed or incomplete, 2 wrong usage.";

/// Builds prepared sets for training and evaluation from KITTI.
#[derive(Debug, Parser)]
#[command(name = "prep", version, after_help = EXAMPLES)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Prepare the KITTI split: 29,839 training pairs, tested on stereo 2015 (tables 3.1 and 3.2).
    Kitti {
        #[command(flatten)]
        common: Common,
        /// Folder into which KITTI stereo 2015 was unpacked; holds `training/image_2`.
        #[arg(long, value_name = "DIR")]
        stereo2015: PathBuf,
        /// Folder into which KITTI semantics was unpacked; holds `training/semantic` (table 3.2).
        #[arg(long, value_name = "DIR")]
        semantics: Option<PathBuf>,
    },
    /// Prepare the Eigen split: 23,158 training pairs, tested on 697 Velodyne scans (table 3.3).
    Eigen {
        #[command(flatten)]
        common: Common,
    },
    /// Show what a split consists of, beside the numbers the thesis states.
    Splits {
        /// The split.
        split: Split,
        /// Print the names of one role instead, one a line.
        #[arg(long, value_name = "ROLE", value_parser = parse_role)]
        list: Option<Role>,
    },
    /// Render a street world in KITTI's own layouts.
    Synth(synth::Args),
}

#[derive(Debug, clap::Args)]
struct Common {
    /// KITTI raw, "synced and rectified"; holds one folder per recording day.
    #[arg(long, value_name = "DIR")]
    raw: PathBuf,
    /// Prepare what is there although parts of the split are missing.
    #[arg(long)]
    allow_missing: bool,
    /// Make depth from the scans of training frames too (validation and test have it anyway).
    #[arg(long)]
    train_depth: bool,
    /// Width in pixels of the network-size images.
    #[arg(long, default_value_t = 512, value_parser = clap::value_parser!(u32).range(8..=8192))]
    width: u32,
    /// Height in pixels of the network-size images.
    #[arg(long, default_value_t = 256, value_parser = clap::value_parser!(u32).range(8..=8192))]
    height: u32,
    /// Resize kernel: area (as the thesis' code), bilinear or lanczos3.
    #[arg(long, default_value_t = Kernel::Area)]
    kernel: Kernel,
    /// Threads to use [default: all cores].
    #[arg(long, value_name = "N", value_parser = parse_jobs)]
    jobs: Option<usize>,
    /// Show no progress.
    #[arg(long)]
    quiet: bool,
    /// Folder to write to: new, empty, or of an earlier run with the same options.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

/// Runs the command and returns its exit code. The first argument is the program's name.
pub fn main(args: impl IntoIterator<Item = OsString>) -> u8 {
    let cli = match Cli::try_parse_from(args) {
        Ok(cli) => cli,
        Err(error) => {
            // Help and version are no errors: they go to stdout with code 0.
            let _ = error.print();
            return u8::try_from(error.exit_code()).unwrap_or(2);
        }
    };
    let done = match cli.command {
        Command::Kitti {
            common,
            stereo2015,
            semantics,
        } => kitti(&common, &stereo2015, semantics.as_deref()),
        Command::Eigen { common } => eigen(&common),
        Command::Splits { split, list } => {
            splits(split, list);
            Ok(0)
        }
        Command::Synth(args) => {
            return synth::run(&args).unwrap_or_else(|error| {
                tell(format_args!("error: {error:#}"));
                1
            });
        }
    };
    done.unwrap_or_else(|error| {
        tell(format_args!("error: {error}"));
        error.exit_code()
    })
}

fn kitti(common: &Common, stereo2015: &Path, semantics: Option<&Path>) -> Result<u8> {
    let raw = RawFolder::open(&common.raw)?;
    let stereo = SceneFolder::open(stereo2015, Kind::Stereo)?;
    let labels = semantics
        .map(|path| SceneFolder::open(path, Kind::Semantics))
        .transpose()?;
    let inventory = Inventory::kitti(&raw, &stereo, labels.as_ref(), common.train_depth);
    let inputs: Vec<_> = [Some(&*common.raw), Some(stereo2015), semantics]
        .into_iter()
        .flatten()
        .collect();
    prepare(Split::Kitti, common, &raw, &inventory, &inputs)
}

fn eigen(common: &Common) -> Result<u8> {
    let raw = RawFolder::open(&common.raw)?;
    let inventory = Inventory::eigen(&raw, common.train_depth);
    prepare(Split::Eigen, common, &raw, &inventory, &[&common.raw])
}

fn prepare(
    split: Split,
    common: &Common,
    raw: &RawFolder,
    inventory: &Inventory,
    inputs: &[&Path],
) -> Result<u8> {
    let settings = Settings::new(split, raw, common.width, common.height, common.kernel);
    build::check_output(&common.out, inputs, &settings)?;
    let looked_in: Vec<_> = inputs
        .iter()
        .map(|path| path.display().to_string())
        .collect();
    let gaps = inventory.describe_gaps();
    if inventory.jobs.is_empty() {
        return Err(Error::Incomplete(format!(
            "nothing of the {split} split is there, looked for in {}:\n{gaps}",
            looked_in.join(", ")
        )));
    }
    if !inventory.is_complete() && !common.allow_missing {
        return Err(Error::Incomplete(format!(
            "the {split} split is incomplete, so nothing was written: {}.\n\
             Missing, looked for in {}:\n{gaps}\
             Download what is missing (a drive is the archive <drive>_sync.zip of KITTI raw, a day's calibration \
             <day>_calib.zip), or prepare what is there with --allow-missing.",
            inventory.summary(),
            looked_in.join(", ")
        )));
    }
    if !common.quiet && !gaps.is_empty() {
        tell(format_args!(
            "not everything is there, looked for in {}:\n{}",
            looked_in.join(", "),
            gaps.trim_end()
        ));
    }
    let report = build::build(
        &common.out,
        &settings,
        raw,
        inventory,
        common.jobs,
        common.quiet,
    )?;
    conclude(&common.out, &report);
    Ok(u8::from(!report.failures.is_empty()))
}

fn conclude(out: &Path, report: &Report) {
    let manifest = &report.set.manifest;
    say(inventory::summary(&manifest.counts));
    say(format_args!(
        "{} files written, {} kept",
        report.written, report.kept
    ));
    say(format_args!(
        "set {} ({} split, {} data)",
        out.display(),
        manifest.content,
        manifest.source
    ));
    say(format_args!("digest {}", manifest.data_digest));
    if !report.failures.is_empty() {
        tell(format_args!(
            "error: {} input files could not be used; they are listed in {}. Replace them and run the same \
             command again: only what is missing is made.",
            report.failures.len(),
            out.join(FAILURES).display()
        ));
    }
}

fn splits(split: Split, list: Option<Role>) {
    match list {
        Some(Role::Train) => training(split).iter().for_each(say),
        Some(Role::Val) => validation(split).iter().for_each(say),
        Some(Role::Test) => test_ids(split).iter().for_each(say),
        None => {
            let counted = counts(split);
            // Drive counts of the two splits are swapped in the thesis, and the validation and
            // training sizes follow from them (PROTOCOL 2.1).
            let thesis = match split {
                Split::Kitti => [33, 28, 30_159, 29_829, 330, 200],
                Split::Eigen => [32, 29, 23_488, 23_168, 320, 697],
            };
            say(format_args!("{split} split{:>19}{:>9}", "here", "thesis"));
            let rows = [
                ("training drives", counted.training_drives),
                ("test drives", counted.test_drives),
                ("pairs of training drives", counted.train + counted.val),
                ("train", counted.train),
                ("val, ten per drive", counted.val),
                ("test images", counted.test),
            ];
            for ((what, here), thesis) in rows.into_iter().zip(thesis) {
                say(format_args!(
                    "{what:<26}{here:>8}{thesis:>9}{}",
                    if here == thesis { "" } else { "  differs" }
                ));
            }
            say(format_args!("digest {}", digest(split)));
        }
    }
}

fn parse_role(text: &str) -> std::result::Result<Role, String> {
    let role = Role::ALL.into_iter().find(|role| role.as_str() == text);
    role.ok_or_else(|| "the roles are train, val and test".to_owned())
}

fn parse_jobs(text: &str) -> std::result::Result<usize, String> {
    let jobs = text.parse().ok().filter(|jobs| (1..=4096).contains(jobs));
    jobs.ok_or_else(|| "give a number of threads from 1 to 4096".to_owned())
}

/// A line on stdout. A reader that went away is no reason to fail.
fn say(line: impl Display) {
    let _ = writeln!(std::io::stdout().lock(), "{line}");
}

/// A line on stderr.
fn tell(line: impl Display) {
    let _ = writeln!(std::io::stderr().lock(), "{line}");
}
