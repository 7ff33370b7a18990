//! `prep kitti` and `prep eigen`.

use std::path::{Path, PathBuf};

use strat_splits::Split;
use strat_store::command::{CliError, eprint_line};

use super::args::SetArgs;
use super::terminal::conclude;
use crate::input::annotated::AnnotatedFolder;
use crate::input::raw::RawFolder;
use crate::input::stereo2015::{Kind, SceneFolder};
use crate::kitti::inventory::{Inventory, Roles};
use crate::kitti::samples;
use crate::set::settings::Settings;
use crate::set::space::check_space;

/// Arguments of `prep kitti`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  prep kitti --raw kitti_raw --stereo2015 kitti2015 --semantics kitti_semantics -o sets/kitti
  prep kitti --stereo2015 data_scene_flow.zip --test-only -o sets/test")]
pub(super) struct KittiArgs {
    #[command(flatten)]
    split: SplitArgs,
    /// KITTI stereo 2015: `data_scene_flow.zip` (with `data_scene_flow_calib.zip` beside it), the
    /// folder of these, or the folder into which they were unpacked; holds `training/image_2`.
    #[arg(long, value_name = "PATH")]
    stereo2015: PathBuf,
    /// KITTI semantics: `data_semantics.zip`, or the folder into which it was unpacked; holds
    /// `training/semantic` (table 3.2).
    #[arg(long, value_name = "PATH")]
    semantics: Option<PathBuf>,
}

/// Arguments of `prep eigen`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  prep eigen --raw kitti_raw -o sets/eigen
  prep eigen --raw downloads --annotated data_depth_annotated.zip --codec jpeg -o sets/eigen")]
pub(super) struct EigenArgs {
    #[command(flatten)]
    split: SplitArgs,
    /// Annotated ("improved") depth of KITTI depth, for validation and test images:
    /// `data_depth_annotated.zip`, or the folder into which it was unpacked; holds `train` and `val`.
    #[arg(long, value_name = "PATH")]
    annotated: Option<PathBuf>,
}

/// What both splits ask for.
#[derive(Debug, clap::Args)]
struct SplitArgs {
    /// KITTI raw, "synced and rectified": a folder with one folder per recording day, with the zip
    /// archives as downloaded, or with both; or one archive.
    #[arg(long, value_name = "PATH", required_unless_present = "test_only")]
    raw: Option<PathBuf>,
    /// Prepare the test images alone, to evaluate models; the KITTI split then needs no --raw, and the
    /// Eigen split no right images.
    #[arg(long)]
    test_only: bool,
    /// Prepare what is there although parts of the split are missing.
    #[arg(long)]
    allow_missing: bool,
    /// Make depth from the scans of training frames too (validation and test have it anyway).
    #[arg(long)]
    train_depth: bool,
    #[command(flatten)]
    set: SetArgs,
}

impl SplitArgs {
    fn roles(&self) -> Roles {
        match (self.test_only, self.train_depth) {
            (true, _) => Roles::Test,
            (false, false) => Roles::All,
            (false, true) => Roles::AllWithDepth,
        }
    }
}

pub(super) fn kitti(args: &KittiArgs) -> Result<u8, CliError> {
    let raw = match (&args.split.raw, args.split.test_only) {
        (Some(root), false) => Some(RawFolder::open(root)?),
        _ => None,
    };
    let stereo = SceneFolder::open(&args.stereo2015, Kind::Stereo)?;
    let labels = args.semantics.as_deref();
    let labels = labels
        .map(|path| SceneFolder::open(path, Kind::Semantics))
        .transpose()?;
    let roles = args.split.roles();
    let inventory = Inventory::kitti(raw.as_ref(), &stereo, labels.as_ref(), roles);
    let rendered = raw.map_or(stereo.rendered, |raw| raw.rendered);
    let more = [Some(&*args.stereo2015), args.semantics.as_deref()];
    prepare(Split::Kitti, rendered, &args.split, more, &inventory)
}

pub(super) fn eigen(args: &EigenArgs) -> Result<u8, CliError> {
    let Some(root) = &args.split.raw else {
        return Err(CliError::Usage(
            "the test images of the Eigen split are frames of KITTI raw: give it with --raw"
                .to_owned(),
        ));
    };
    let raw = RawFolder::open(root)?;
    let folder = args.annotated.as_deref().map(AnnotatedFolder::open);
    let roles = args.split.roles();
    let inventory = Inventory::eigen(&raw, folder.transpose()?.as_ref(), roles);
    let more = [args.annotated.as_deref(), None];
    prepare(Split::Eigen, raw.rendered, &args.split, more, &inventory)
}

fn prepare(
    split: Split,
    rendered: bool,
    args: &SplitArgs,
    more_inputs: [Option<&Path>; 2],
    inventory: &Inventory,
) -> Result<u8, CliError> {
    let options = args.set.options()?;
    let settings = Settings::new(split.into(), rendered, options.images);
    let inputs = [args.raw.as_deref()].into_iter().chain(more_inputs);
    let inputs: Vec<&Path> = inputs.flatten().collect();
    settings.check_output(&options.out, &inputs)?;
    let searched = inputs.iter().map(|path| path.display().to_string());
    let searched = searched.collect::<Vec<_>>().join(", ");
    let gaps = inventory.describe_gaps();
    if inventory.jobs.is_empty() {
        return Err(CliError::Failed(format!(
            "nothing of the {split} split is there (searched in {searched}):\n{gaps}"
        )));
    }
    if !inventory.is_complete() && !args.allow_missing {
        return Err(CliError::Failed(format!(
            "the {split} split is incomplete, so nothing was written: {}.\n\
             Missing (searched in {searched}):\n{gaps}\
             Download what is missing (a drive is the archive <drive>_sync.zip of KITTI raw, a day's calibration \
             <day>_calib.zip; they need not be unpacked), or prepare what is there with --allow-missing.",
            inventory.summary(),
        )));
    }
    if !options.quiet && !gaps.is_empty() {
        eprint_line(format_args!(
            "Some inputs are missing (searched in {searched}):\n{}",
            gaps.trim_end()
        ));
    }
    let needed = samples::bytes_to_write(&options.out, &settings, inventory, options.shard);
    check_space(&options.out, needed)?;
    let report = samples::build(&options, &settings, inventory)?;
    conclude(&options.out, options.shard, options.quiet, &report)
}
