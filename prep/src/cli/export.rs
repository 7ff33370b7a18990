//! `prep export`.

use std::path::PathBuf;

use clap::ValueEnum;
use strat_splits::Role;
use strat_store::command::{CliError, DONE, FAILED, eprint_line, print_line};
use strat_store::layout::DepthKind;
use strat_store::set::PreparedSet;

use super::args::parse_role;
use crate::export;

/// Arguments of `prep export`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  prep export sets/eigen --kind velodyne --format npz --out gt      gt/test-velodyne.npz
  prep export sets/own --format png16 --role val --out gt          gt/<id>.png, metres times 256
  prep export sets/eigen --kind velodyne --format monodepth2 --out gt    gt/gt_depths.npz")]
pub(super) struct ExportArgs {
    /// A prepared set.
    #[arg(value_name = "SET")]
    set: PathBuf,
    /// Folder to write to: new, empty, or of an earlier export; nothing else is replaced.
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
    /// What is written.
    #[arg(long, value_enum)]
    format: Format,
    /// The samples.
    #[arg(long, value_name = "ROLE", value_parser = parse_role, default_value = "test")]
    role: Role,
    /// The ground truth [default: the only one these samples have].
    #[arg(long, value_enum)]
    kind: Option<Kind>,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Format {
    /// One NumPy archive of all frames.
    Npz,
    /// A 16-bit picture per frame, metres times 256.
    Png16,
    /// A NumPy file per frame.
    Npy,
    /// gt_depths.npz for monodepth2's evaluate_depth.py; --kind annotated for its eigen_benchmark.
    Monodepth2,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Kind {
    /// Scan, along the scanner's x axis.
    Velodyne,
    /// Along the optical axis: scan, or ground truth of own pairs.
    Camera,
    /// Stereo 2015, pixels visible in both images.
    Noc,
    /// Stereo 2015, all measured pixels.
    Occ,
    /// Annotated depth of KITTI depth.
    Annotated,
    /// Laser grid of Make3D.
    Laser,
}

impl From<Format> for export::Format {
    fn from(format: Format) -> Self {
        match format {
            Format::Npz => Self::Npz,
            Format::Png16 => Self::Png16,
            Format::Npy => Self::Npy,
            Format::Monodepth2 => Self::Monodepth2,
        }
    }
}

impl From<Kind> for DepthKind {
    fn from(kind: Kind) -> Self {
        match kind {
            Kind::Velodyne => Self::Velodyne,
            Kind::Camera => Self::Camera,
            Kind::Noc => Self::Noc,
            Kind::Occ => Self::Occ,
            Kind::Annotated => Self::Annotated,
            Kind::Laser => Self::Laser,
        }
    }
}

pub(super) fn export(args: &ExportArgs) -> Result<u8, CliError> {
    let set = PreparedSet::open(&args.set)?;
    let (role, kind) = (args.role, args.kind.map(DepthKind::from));
    let done = export::export(&set, role, kind, args.format.into(), &args.out)?;
    for problem in &done.failed {
        eprint_line(format_args!("error: {problem}"));
    }
    let kind = done.kind.as_str();
    print_line(format_args!(
        "{} {role} frames of {kind} ground truth: {}",
        done.frames,
        done.target.display()
    ))?;
    if done.without > 0 {
        eprint_line(format_args!(
            "{} {role} samples have no {kind} ground truth and were left out",
            done.without
        ));
    }
    if done.clipped > 0 {
        eprint_line(format_args!(
            "{} pixels are beyond 255.996 m, the most that 16 bits hold, and were written as that",
            done.clipped
        ));
    }
    if done.frames > 0 {
        eprint_line(next_step(args.format, &done));
    }
    Ok(if done.failed.is_empty() { DONE } else { FAILED })
}

/// How another program reads what was written.
fn next_step(format: Format, done: &export::Exported) -> String {
    let target = done.target.display();
    match format {
        Format::Npz => format!(
            "next: in Python, numpy.load(\"{target}\")[ID] has metres, 0 where nothing was measured"
        ),
        Format::Npy => format!(
            "next: in Python, numpy.load(\"{target}/ID.npy\") has metres, 0 where nothing was measured"
        ),
        Format::Png16 => format!(
            "next: in Python, cv2.imread(\"{target}/ID.png\", cv2.IMREAD_UNCHANGED) / 256 has metres, 0 where nothing \
             was measured"
        ),
        Format::Monodepth2 => format!(
            "next: copy {target} to splits/eigen of monodepth2, whose evaluate_depth.py reads it there"
        ),
    }
}
