//! `prep pairs`, `prep make3d` and `prep cityscapes`.

use std::path::PathBuf;

use strat_splits::Role;
use strat_store::command::{CliError, eprint_line};

use super::args::SetArgs;
use super::terminal::conclude;
use crate::collections::make3d::TEST_IMAGES;
use crate::collections::pairs::Shares;
use crate::collections::{cityscapes, make3d, pairs};

/// Arguments of `prep pairs`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Columns of the CSV, which begins with their names; files are looked for from its folder:
  left, right    rectified images, PNG or JPEG; `right` is empty where an image stands alone
  focal_px       focal length in pixels of the left image
  baseline_m     distance in metres between the cameras
  id             name of the pair [default: the path of the left image without its extension]
  split          train, val or test [default: drawn by --val-share and --test-share]
  depth          ground truth in metres: 16-bit .png (metres times 256), .npy or .exr
  disparity      ground truth in pixels of the left image instead, in the same kinds of files
  depth_scale    what the values of that file are divided by [default: 256 for .png, else 1]
  invalid        the value of that file that says \"not measured\" [default: 0]
  disparity_offset_px  added to measured disparity (`doffs` of Middlebury) [default: 0]

An image without a right one is for testing alone and needs ground truth; its focal length and baseline may be
empty where they are not known. A list of such images alone needs no columns but `left` and `depth`.

Which pairs are drawn depends on their ids alone, so more rows move none of the earlier ones.
Frames of one video look alike: give them one role with the column split.

Examples:
  prep pairs --csv pairs.csv -o sets/own
  prep pairs --csv pairs.csv --val-share 0.05 --test-share 0.2 -o sets/own")]
pub(super) struct PairsArgs {
    /// The list of pairs.
    #[arg(long, value_name = "FILE")]
    csv: PathBuf,
    /// Share of the pairs drawn for validation, if there is no column `split`.
    #[arg(long, value_name = "SHARE", default_value_t = 0.1, value_parser = parse_share)]
    val_share: f64,
    /// Share of the pairs drawn for testing, if there is no column `split`.
    #[arg(long, value_name = "SHARE", default_value_t = 0.1, value_parser = parse_share)]
    test_share: f64,
    #[command(flatten)]
    set: SetArgs,
}

/// Arguments of `prep make3d`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  prep make3d --images Test134 --depth Gridlaserdata -o sets/make3d
  prep make3d --images Test134 --depth Gridlaserdata --codec jpeg -o sets/make3d")]
pub(super) struct Make3dArgs {
    /// Folder of the test images, `img-*.jpg`.
    #[arg(long, value_name = "DIR")]
    images: PathBuf,
    /// Folder of their laser grids, `depth_sph_corr-*.mat`.
    #[arg(long, value_name = "DIR")]
    depth: PathBuf,
    #[command(flatten)]
    set: SetArgs,
}

/// Arguments of `prep cityscapes`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  prep cityscapes --root cityscapes -o sets/cityscapes
  prep cityscapes --root cityscapes --shard 0/8 -o sets/cityscapes")]
pub(super) struct CityscapesArgs {
    /// Folder of `leftImg8bit`, `rightImg8bit`, `camera` and, if wanted, `gtFine`.
    #[arg(long, value_name = "DIR")]
    root: PathBuf,
    #[command(flatten)]
    set: SetArgs,
}

fn parse_share(text: &str) -> Result<f64, String> {
    let share = text.parse().ok();
    share
        .filter(|share| (0.0..=1.0).contains(share))
        .ok_or_else(|| "give a share from 0 to 1".to_owned())
}

pub(super) fn pairs(args: &PairsArgs) -> Result<u8, CliError> {
    let shares = Shares {
        val: args.val_share,
        test: args.test_share,
    };
    if shares.val + shares.test > 1.0 {
        return Err(CliError::Usage(
            "--val-share and --test-share are more than 1 together".to_owned(),
        ));
    }
    let options = args.set.options()?;
    let report = pairs::prepare(&args.csv, shares, &options)?;
    conclude(&options.out, options.shard, options.quiet, &report)
}

pub(super) fn make3d(args: &Make3dArgs) -> Result<u8, CliError> {
    let options = args.set.options()?;
    let report = make3d::prepare(&args.images, &args.depth, &options)?;
    let code = conclude(&options.out, options.shard, options.quiet, &report)?;
    if options.shard.is_none() && !report.set.manifest.is_complete(Role::Test) {
        eprint_line(format_args!(
            "the published test set has {TEST_IMAGES} images; numbers from fewer are not comparable with it"
        ));
    }
    Ok(code)
}

pub(super) fn cityscapes(args: &CityscapesArgs) -> Result<u8, CliError> {
    let options = args.set.options()?;
    let report = cityscapes::prepare(&args.root, &options)?;
    conclude(&options.out, options.shard, options.quiet, &report)
}
