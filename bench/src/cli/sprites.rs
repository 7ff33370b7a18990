//! `bench sprites`: sprites for `bench cues` from a labelled set's own images.

use std::path::PathBuf;

use clap::Args;
use strat_store::{
    command::{DONE, FAILED, eprint_line, print},
    set::PreparedSet,
};

use crate::cues::cutouts;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bench sprites --data kitti_set -o sprites
  bench sprites --data kitti_set -o sprites --each 4       and then `bench cues --sprites sprites`")]
pub(super) struct SpritesArgs {
    /// Folder that `prep` has written, with label and instance maps and ground truth
    #[arg(long, value_name = "DIR")]
    data: PathBuf,
    /// Folder for the sprites and their sprites.yaml
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
    /// Sprites of each kind (cars and pedestrians)
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=100))]
    each: u16,
    /// No notes
    #[arg(short, long)]
    quiet: bool,
}

/// Cuts sprites out of a labelled set.
pub(super) fn run(args: &SpritesArgs) -> anyhow::Result<u8> {
    let set = PreparedSet::open(&args.data)?;
    cutouts::MARK.examine(&args.out, &[&args.data])?;
    cutouts::MARK.begin(&args.out)?;
    let found = cutouts::cut(&set, usize::from(args.each), args.quiet)?;
    let paths = cutouts::write(&args.out, &found)?;
    let lines: String = paths
        .iter()
        .map(|path| format!("{}\n", path.display()))
        .collect();
    print(lines)?;
    for failure in &found.failures {
        eprint_line(format_args!("error: {failure}"));
    }
    if !args.quiet {
        eprint_line(format_args!(
            "they are cut from {} images, whose licence they keep; next: bench cues --data {} -m MODEL.onnx \
             --sprites {} -o cues",
            set.manifest.source,
            args.data.display(),
            args.out.display()
        ));
    }
    Ok(if found.failures.is_empty() {
        DONE
    } else {
        FAILED
    })
}
