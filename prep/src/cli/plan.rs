//! `prep plan`.

use std::path::PathBuf;

use strat_splits::Split;
use strat_store::command::{CliError, DONE, FAILED, print, print_line};

use super::args::{ImageArgs, JobsArg};
use super::terminal::json;
use crate::input::raw::RawFolder;
use crate::input::stereo2015::{Kind, SceneFolder};
use crate::plan::{Goal, Request, plan as find_out};

/// Arguments of `prep plan`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  prep plan --table 3.1                                  the least that table 3.1 needs
  prep plan --split eigen                                everything for training and evaluation
  prep plan --split kitti --raw kitti_raw --out sets/kitti   what of it is there, space and time
  prep plan --table 3.1 --urls                           addresses to download, for wget -c -i -")]
pub(super) struct PlanArgs {
    /// The split, for training and evaluation.
    #[arg(long, required_unless_present = "table", conflicts_with = "table")]
    split: Option<Split>,
    /// A table of the thesis, evaluation alone: 3.1, 3.2 or 3.3.
    #[arg(long, value_parser = ["3.1", "3.2", "3.3"])]
    table: Option<String>,
    /// KITTI raw, as far as it is there.
    #[arg(long, value_name = "PATH")]
    raw: Option<PathBuf>,
    /// KITTI stereo 2015, if it is there.
    #[arg(long, value_name = "PATH")]
    stereo2015: Option<PathBuf>,
    /// KITTI semantics, if it is there.
    #[arg(long, value_name = "PATH")]
    semantics: Option<PathBuf>,
    /// Where the set is to be written, to look for free space.
    #[arg(long, value_name = "DIR", default_value = ".")]
    out: PathBuf,
    #[command(flatten)]
    images: ImageArgs,
    #[command(flatten)]
    jobs: JobsArg,
    /// Print the plan as JSON.
    #[arg(long)]
    json: bool,
    /// Print only the download addresses of the archives that are missing, one a line.
    #[arg(long, conflicts_with = "json")]
    urls: bool,
}

/// [`FAILED`] if the disk has no room.
pub(super) fn plan(args: &PlanArgs) -> Result<u8, CliError> {
    let goal = match (args.split, args.table.as_deref()) {
        (Some(split), _) => Goal::Split(split),
        (None, Some("3.2")) => Goal::Table32,
        (None, Some("3.3")) => Goal::Table33,
        (None, _) => Goal::Table31,
    };
    let open = |path: &Option<PathBuf>, kind| {
        let path = path.as_deref();
        path.map(|path| SceneFolder::open(path, kind)).transpose()
    };
    let plan = find_out(&Request {
        goal,
        raw: args.raw.as_deref().map(RawFolder::open).transpose()?,
        stereo2015: open(&args.stereo2015, Kind::Stereo)?,
        semantics: open(&args.semantics, Kind::Semantics)?,
        out: args.out.clone(),
        images: args.images.options()?,
        threads: args.jobs.threads(),
    })?;
    match args.json {
        _ if args.urls => print(plan.urls())?,
        true => print_line(json(&plan)?)?,
        false => print_line(plan.text(&args.out).trim_end())?,
    }
    Ok(if plan.needs_space() { FAILED } else { DONE })
}
