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
use strat_splits::{
    DriveId, DriveRole, Role, Split, counts, digest, drives, eigen_test, kitti2015_origin,
    test_ids, training, validation,
};
use strat_store::image_files::Codec;
use strat_store::resize::Kernel;

use crate::collections::{cityscapes, make3d, pairs};
use crate::error::{Error, Result};
use crate::export;
use crate::input::annotated::AnnotatedFolder;
use crate::input::raw::{RENDERED, RawFolder};
use crate::input::stereo2015::{Kind, SceneFolder};
use crate::kitti::inventory::{self, Inventory, Roles};
use crate::kitti::samples::{self as build, FAILURES, Report, Settings};
use crate::plan;
use crate::set::shards::{self as merge, Shard};
use crate::set::writer::Run;
use crate::synth;
use crate::verify;

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
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Prepare the KITTI split: 29,839 training pairs, tested on stereo 2015 (tables 3.1 and 3.2).
    Kitti {
        #[command(flatten)]
        common: Common,
        /// KITTI stereo 2015: `data_scene_flow.zip` (with `data_scene_flow_calib.zip` beside it), the
        /// folder of these, or the folder into which they were unpacked; holds `training/image_2`.
        #[arg(long, value_name = "PATH")]
        stereo2015: PathBuf,
        /// KITTI semantics: `data_semantics.zip`, or the folder into which it was unpacked; holds
        /// `training/semantic` (table 3.2).
        #[arg(long, value_name = "PATH")]
        semantics: Option<PathBuf>,
    },
    /// Prepare the Eigen split: 23,158 training pairs, tested on 697 Velodyne scans (table 3.3).
    Eigen {
        #[command(flatten)]
        common: Common,
        /// Annotated ("improved") depth of KITTI depth, for validation and test images:
        /// `data_depth_annotated.zip`, or the folder into which it was unpacked; holds `train` and `val`.
        #[arg(long, value_name = "PATH")]
        annotated: Option<PathBuf>,
    },
    /// Prepare your own rectified stereo pairs, named in a CSV file.
    Pairs(pairs::Args),
    /// Prepare the test images of Make3D.
    Make3d(make3d::Args),
    /// Prepare Cityscapes.
    Cityscapes(cityscapes::Args),
    /// Write ground truth of a prepared set for other programs: NumPy or 16-bit PNG.
    Export(export::Args),
    /// Make one set of the parts that runs with --shard have written.
    Merge {
        /// The folder that all of them were given as --out.
        #[arg(value_name = "DIR")]
        out: PathBuf,
    },
    /// Say what a preparation needs before it starts: archives, disk space, time.
    Plan(plan::Args),
    /// Check inputs or a prepared set: what is missing, cut off, unreadable or changed.
    Verify(verify::Args),
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
    /// KITTI raw, "synced and rectified": a folder with one folder per recording day, with the zip
    /// archives as downloaded, or with both; or one archive.
    #[arg(long, value_name = "PATH", required_unless_present = "test_only")]
    raw: Option<PathBuf>,
    /// Prepare the test images alone, to evaluate models; the KITTI split then needs no --raw.
    #[arg(long)]
    test_only: bool,
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
    /// How network-size images are stored: png (without loss) or jpeg (4:2:0, a fraction of the size).
    #[arg(long, value_name = "CODEC", default_value = "png", value_parser = ["png", "jpeg"])]
    codec: String,
    /// Quality of --codec jpeg, from 1 to 100 [default: 92].
    #[arg(long, value_name = "Q", value_parser = clap::value_parser!(u8).range(1..=100))]
    quality: Option<u8>,
    /// Prepare only one of N parts, numbered from 0; `prep merge` makes a set of all of them.
    #[arg(long, value_name = "I/N")]
    shard: Option<Shard>,
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

impl Common {
    fn roles(&self) -> Roles {
        match (self.test_only, self.train_depth) {
            (true, _) => Roles::Test,
            (false, false) => Roles::All,
            (false, true) => Roles::AllWithDepth,
        }
    }

    fn codec(&self) -> Result<Codec> {
        match (self.codec.as_str(), self.quality) {
            ("jpeg", quality) => Ok(Codec::Jpeg(quality.unwrap_or(92))),
            (_, None) => Ok(Codec::Png),
            (_, Some(_)) => Err(Error::Usage(
                "--quality is for --codec jpeg; PNG loses nothing".to_owned(),
            )),
        }
    }
}

/// The parser of the command line, for tests of what guides tell users to type.
pub fn command() -> clap::Command {
    <Cli as clap::CommandFactory>::command()
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
        Command::Eigen { common, annotated } => eigen(&common, annotated.as_deref()),
        Command::Pairs(args) => pairs::run(&args),
        Command::Make3d(args) => make3d::run(&args),
        Command::Cityscapes(args) => cityscapes::run(&args),
        Command::Export(args) => export::run(&args),
        Command::Merge { out } => merge(&out),
        Command::Plan(args) => plan::run(&args),
        Command::Verify(args) => verify::run(&args),
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
        if error.is_full_disk() {
            tell(
                "The disk is full. Make room and run the same command again: finished files are kept.",
            );
        }
        error.exit_code()
    })
}

fn kitti(common: &Common, stereo2015: &Path, semantics: Option<&Path>) -> Result<u8> {
    let raw = match (&common.raw, common.test_only) {
        (Some(root), false) => RawFolder::open(root)?,
        _ => RawFolder::none(stereo2015.join(RENDERED).is_file()),
    };
    let stereo = SceneFolder::open(stereo2015, Kind::Stereo)?;
    let labels = semantics
        .map(|path| SceneFolder::open(path, Kind::Semantics))
        .transpose()?;
    let roles = common.roles();
    let inventory = Inventory::kitti(&raw, &stereo, labels.as_ref(), roles);
    let inputs: Vec<_> = [common.raw.as_deref(), Some(stereo2015), semantics]
        .into_iter()
        .flatten()
        .collect();
    prepare(Split::Kitti, common, &raw, &inventory, &inputs)
}

fn eigen(common: &Common, annotated: Option<&Path>) -> Result<u8> {
    let Some(root) = &common.raw else {
        return Err(Error::Usage(
            "the test images of the Eigen split are frames of KITTI raw: give it with --raw"
                .to_owned(),
        ));
    };
    let raw = RawFolder::open(root)?;
    let folder = annotated.map(AnnotatedFolder::open).transpose()?;
    let inventory = Inventory::eigen(&raw, folder.as_ref(), common.roles());
    let inputs: Vec<_> = [common.raw.as_deref(), annotated]
        .into_iter()
        .flatten()
        .collect();
    prepare(Split::Eigen, common, &raw, &inventory, &inputs)
}

fn prepare(
    split: Split,
    common: &Common,
    raw: &RawFolder,
    inventory: &Inventory,
    inputs: &[&Path],
) -> Result<u8> {
    let settings = Settings::new(
        split,
        raw,
        common.width,
        common.height,
        common.kernel,
        common.codec()?,
    );
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
             <day>_calib.zip; they need not be unpacked), or prepare what is there with --allow-missing.",
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
    build::check_space(&common.out, &settings, inventory, common.shard)?;
    let run = Run {
        out: &common.out,
        settings: &settings,
        shard: common.shard,
        threads: common.jobs,
        quiet: common.quiet,
    };
    let report = build::build(&run, raw, inventory)?;
    Ok(conclude(&common.out, common.shard, &report))
}

fn merge(out: &Path) -> Result<u8> {
    let (set, failures) = merge::merge(out)?;
    let report = Report {
        set,
        failures,
        written: 0,
        kept: 0,
    };
    Ok(conclude(out, None, &report))
}

/// Prints what was made; 1 if something could not be used.
pub(crate) fn conclude(out: &Path, shard: Option<Shard>, report: &Report) -> u8 {
    let manifest = &report.set.manifest;
    let content = match manifest.content.split() {
        Some(split) => format!("{split} split, {} data", manifest.source),
        None => manifest.content.to_string(),
    };
    let out = out.display();
    say(inventory::summary(&manifest.counts));
    if report.written + report.kept > 0 {
        say(format_args!(
            "{} files written, {} kept",
            report.written, report.kept
        ));
    }
    match shard {
        Some(shard) => say(format_args!(
            "part {shard} of {out} ({content}); when all parts are there: prep merge {out}"
        )),
        None => {
            say(format_args!("set {out} ({content})"));
            say(format_args!("digest {}", manifest.data_digest));
        }
    }
    if !report.failures.is_empty() {
        tell(format_args!(
            "error: {} inputs could not be used; they are listed in {}. Put them right and run the same \
             command again: only what is missing is made.",
            report.failures.len(),
            report.set.root.join(FAILURES).display()
        ));
    }
    u8::from(!report.failures.is_empty())
}

fn splits(split: Split, list: Option<Role>) {
    match list {
        Some(Role::Train) => training(split).iter().for_each(say),
        Some(Role::Val) => validation(split).iter().for_each(say),
        Some(Role::Test) => test_ids(split).iter().for_each(say),
        None => {
            let counted = counts(split);
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
            say(why(split));
        }
    }
}

/// Why the counts differ from the thesis' (PROTOCOL 2.1), and what must not be done with the
/// other split (PROTOCOL 2.3).
fn why(split: Split) -> String {
    let trains = |drive: DriveId, split: Split| {
        let row = drives().iter().find(|row| row.id == drive);
        row.is_some_and(|row| row.role(split) == DriveRole::Train)
    };
    let counted = counts(split);
    let reason = format!(
        "The thesis has the drive counts of the two splits exchanged: its {} pairs are those of the {} drives \
         counted here. Ten validation pairs of each make {} and leave {} to train on.",
        counted.train + counted.val,
        counted.training_drives,
        counted.val,
        counted.train
    );
    let leak = match split {
        Split::Kitti => {
            let frames = kitti2015_origin().iter().flatten();
            let (known, seen) = (
                frames.clone().count(),
                frames.filter(|f| trains(f.drive, Split::Eigen)).count(),
            );
            format!(
                "Never test a model of the Eigen split on this one: {seen} of the {known} test images whose \
                 recording is known come from its training drives."
            )
        }
        Split::Eigen => {
            let frames = eigen_test().iter();
            let seen = frames.filter(|f| trains(f.drive, Split::Kitti)).count();
            format!(
                "Never test a model of the KITTI split on this one: {seen} of the {} test images come from its \
                 training drives.",
                eigen_test().len()
            )
        }
    };
    format!("\n{reason}\n{leak}")
}

pub(crate) fn parse_role(text: &str) -> std::result::Result<Role, String> {
    let role = Role::ALL.into_iter().find(|role| role.as_str() == text);
    role.ok_or_else(|| "the roles are train, val and test".to_owned())
}

pub(crate) fn parse_jobs(text: &str) -> std::result::Result<usize, String> {
    let jobs = text.parse().ok().filter(|jobs| (1..=4096).contains(jobs));
    jobs.ok_or_else(|| "give a number of threads from 1 to 4096".to_owned())
}

/// A line on stdout. A reader that went away is no reason to fail.
pub(crate) fn say(line: impl Display) {
    let _ = writeln!(std::io::stdout().lock(), "{line}");
}

/// A line on stderr.
pub(crate) fn tell(line: impl Display) {
    let _ = writeln!(std::io::stderr().lock(), "{line}");
}
