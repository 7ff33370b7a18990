//! `prep splits`: what a split consists of, beside the numbers the thesis states.

use std::fmt::Write;

use serde::Serialize;
use strat_splits::{
    DriveId, DriveRole, FrameId, Role, Split, counts, digest, drives, eigen_test, kitti2015_origin,
    test_ids, training, validation,
};
use strat_store::command::{CliError, DONE, print, print_line};

use super::args::parse_role;
use super::terminal::json;

/// Arguments of `prep splits`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  prep splits kitti
  prep splits eigen --list test           ids of the 697 images, one a line")]
pub(super) struct SplitsArgs {
    /// The split.
    split: Split,
    /// Print the names of one role instead, one a line.
    #[arg(long, value_name = "ROLE", value_parser = parse_role)]
    list: Option<Role>,
    /// Print counts, or with --list the names, as JSON.
    #[arg(long)]
    json: bool,
}

/// A split for scripts.
#[derive(Serialize)]
struct Described {
    split: String,
    digest: String,
    training_drives: usize,
    test_drives: usize,
    train: usize,
    val: usize,
    test: usize,
}

pub(super) fn splits(args: &SplitsArgs) -> Result<u8, CliError> {
    let lines = |frames: Vec<FrameId>| frames.iter().map(|frame| format!("{frame}\n")).collect();
    if args.json {
        let counted = counts(args.split);
        let text = match args.list {
            Some(role) => {
                let names: Vec<String> = match role {
                    Role::Train => training(args.split)
                        .iter()
                        .map(ToString::to_string)
                        .collect(),
                    Role::Val => validation(args.split)
                        .iter()
                        .map(ToString::to_string)
                        .collect(),
                    Role::Test => test_ids(args.split),
                };
                json(&names)?
            }
            None => json(&Described {
                split: args.split.to_string(),
                digest: digest(args.split),
                training_drives: counted.training_drives,
                test_drives: counted.test_drives,
                train: counted.train,
                val: counted.val,
                test: counted.test,
            })?,
        };
        print_line(text)?;
        return Ok(DONE);
    }
    print(match args.list {
        Some(Role::Train) => lines(training(args.split)),
        Some(Role::Val) => lines(validation(args.split)),
        Some(Role::Test) => test_ids(args.split).join("\n") + "\n",
        None => describe(args.split),
    })?;
    Ok(DONE)
}

fn describe(split: Split) -> String {
    let counted = counts(split);
    let thesis = match split {
        Split::Kitti => [33, 28, 30_159, 29_829, 330, 200],
        Split::Eigen => [32, 29, 23_488, 23_168, 320, 697],
    };
    let rows = [
        ("training drives", counted.training_drives),
        ("test drives", counted.test_drives),
        ("pairs of training drives", counted.train + counted.val),
        ("train", counted.train),
        ("val, ten per drive", counted.val),
        ("test images", counted.test),
    ];
    let mut text = format!("{split} split{:>19}{:>9}\n", "here", "thesis");
    for ((what, here), thesis) in rows.into_iter().zip(thesis) {
        let differs = if here == thesis { "" } else { "  differs" };
        let _ = writeln!(text, "{what:<26}{here:>8}{thesis:>9}{differs}");
    }
    let _ = writeln!(text, "digest {}\n{}", digest(split), why(split));
    text
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
