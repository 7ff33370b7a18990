//! `prep verify`.

use std::path::PathBuf;

use strat_splits::Split;
use strat_store::command::{CliError, DONE, FAILED, eprint_line, print_line};
use strat_store::set::PreparedSet;
use strat_store::threads;

use super::args::JobsArg;
use super::terminal::json;
use crate::input::raw::RawFolder;
use crate::input::stereo2015::{Kind, SceneFolder};
use crate::verify::{self, Check, Report};

/// Arguments of `prep verify`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  prep verify --raw kitti_raw                          presence, sizes and ends of all 61 drives
  prep verify --raw kitti_raw --split eigen --deep     decode everything the Eigen split uses
  prep verify --stereo2015 kitti2015
  prep verify sets/kitti                               a prepared set against its own digests")]
pub(super) struct VerifyArgs {
    /// A prepared set.
    #[arg(value_name = "SET", required_unless_present_any = ["raw", "stereo2015"])]
    set: Option<PathBuf>,
    /// KITTI raw: folders, zip archives or both.
    #[arg(long, value_name = "DIR", conflicts_with = "set")]
    raw: Option<PathBuf>,
    /// KITTI stereo 2015.
    #[arg(long, value_name = "DIR", conflicts_with = "set")]
    stereo2015: Option<PathBuf>,
    /// Look only at the drives that this split uses [default: all 61].
    #[arg(long, conflicts_with = "set")]
    split: Option<Split>,
    /// Decode every file instead of looking at its ends.
    #[arg(long)]
    deep: bool,
    /// Print the result as JSON.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    jobs: JobsArg,
    /// Show no progress.
    #[arg(short, long)]
    quiet: bool,
}

/// [`FAILED`] if something is missing or bad.
pub(super) fn verify(args: &VerifyArgs) -> Result<u8, CliError> {
    let check = Check {
        deep: args.deep,
        quiet: args.quiet,
    };
    let mut report = Report::default();
    threads::pool("prep", args.jobs.threads())?.install(|| {
        if let Some(root) = &args.set {
            verify::set(&PreparedSet::open(root)?, check, &mut report)?;
        }
        if let Some(root) = &args.raw {
            verify::raw(&RawFolder::open(root)?, args.split, check, &mut report);
        }
        if let Some(root) = &args.stereo2015 {
            let folder = SceneFolder::open(root, Kind::Stereo)?;
            verify::scenes(&folder, check, &mut report);
        }
        Ok::<_, CliError>(())
    })?;
    for note in &report.notes {
        eprint_line(format_args!("note: {note}"));
    }
    let clean = report.is_clean();
    if args.json {
        print_line(json(&report)?)?;
    } else {
        print_line(report.text().trim_end())?;
        let files = report.files();
        eprint_line(match (clean, args.deep || args.set.is_some()) {
            (true, true) => format!("all {files} files are good"),
            (true, false) => format!("all {files} files are there and whole; --deep decodes them"),
            (false, _) => "error: some files are missing or damaged".to_owned(),
        });
    }
    Ok(if clean { DONE } else { FAILED })
}
