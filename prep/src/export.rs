//! `prep export`: ground truth out of a prepared set, for other programs.
//!
//! Values are metres, 0 where nothing was measured. `npz` is one archive with one `f32` array
//! (rows, columns) per frame named by its id, `npy` one such file per frame, `png16` one 16-bit
//! picture per frame of metres times 256, as KITTI stores depth. Nothing is resized or masked.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use clap::ValueEnum;
use strat_splits::Role;
use strat_store::raster::Plane;
use strat_store::set::{FileRef, PreparedSet, Sample};
use strat_store::{exr, files, image_files, npy};
use zip::ZipWriter;
use zip::write::SimpleFileOptions;

use crate::cli::{parse_role, say, tell};
use crate::error::{Error, Result};

/// Arguments of `prep export`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  prep export sets/eigen --kind velodyne --format npz --out gt      gt/test-velodyne.npz
  prep export sets/own --format png16 --role val --out gt          gt/<id>.png, metres times 256")]
pub(crate) struct Args {
    /// A prepared set.
    #[arg(value_name = "SET")]
    set: PathBuf,
    /// Folder to write to; files of the same names are replaced.
    #[arg(long, value_name = "DIR")]
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

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Format {
    /// One NumPy archive of all frames.
    Npz,
    /// A 16-bit picture per frame, metres times 256.
    Png16,
    /// A NumPy file per frame.
    Npy,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
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

impl Kind {
    fn name(self) -> &'static str {
        match self {
            Self::Velodyne => "velodyne",
            Self::Camera => "camera",
            Self::Noc => "noc",
            Self::Occ => "occ",
            Self::Annotated => "annotated",
            Self::Laser => "laser",
        }
    }

    fn file(self, sample: &Sample) -> Option<&FileRef> {
        match self {
            Self::Velodyne => &sample.depth_velodyne,
            Self::Camera => &sample.depth_camera,
            Self::Noc => &sample.depth_noc,
            Self::Occ => &sample.depth_occ,
            Self::Annotated => &sample.depth_annotated,
            Self::Laser => &sample.depth_laser,
        }
        .as_ref()
    }
}

/// What came of the frames.
#[derive(Debug, Default)]
struct Done {
    frames: u64,
    without: u64,
    clipped: u64,
    failed: u64,
}

/// Exports and returns the exit code: 1 if a frame could not be read.
pub(crate) fn run(args: &Args) -> Result<u8> {
    let set = PreparedSet::open(&args.set)?;
    let samples = set.samples(args.role)?;
    let kind = choose(args.kind, &samples, &set, args.role)?;
    let inside = |out: &Path| {
        let out = out
            .ancestors()
            .find_map(|folder| folder.canonicalize().ok());
        let set = set.root.canonicalize().ok();
        matches!((out, set), (Some(out), Some(set)) if out.starts_with(&set))
    };
    let absolute = std::path::absolute(&args.out).unwrap_or_else(|_| args.out.clone());
    if inside(&absolute) {
        return Err(Error::Output {
            path: args.out.clone(),
            problem: "this lies inside the set; give another folder".to_owned(),
        });
    }
    files::check_writable(&args.out)?;

    let mut done = Done::default();
    let target = match args.format {
        Format::Npz => {
            let path = args.out.join(format!("{}-{}.npz", args.role, kind.name()));
            files::write_atomic_with(&path, |out| {
                let mut zip = ZipWriter::new_stream(out);
                // No date of writing, so that the same set gives the same bytes.
                let options = SimpleFileOptions::default()
                    .compression_method(zip::CompressionMethod::Deflated)
                    .last_modified_time(zip::DateTime::default());
                each(&set, &samples, kind, &mut done, |id, plane, _| {
                    zip.start_file(format!("{id}.npy"), options)
                        .map_err(io::Error::other)?;
                    zip.write_all(&npy::encode(plane.width, plane.height, &plane.data))
                })?;
                zip.finish().map_err(io::Error::other)?;
                Ok(())
            })?;
            path
        }
        Format::Npy | Format::Png16 => {
            let ending = match args.format {
                Format::Npy => "npy",
                _ => "png",
            };
            let write = |id: &str, plane: &Plane, clipped: &mut u64| {
                let bytes = match args.format {
                    Format::Npy => npy::encode(plane.width, plane.height, &plane.data),
                    _ => png16(plane, clipped),
                };
                let mut path = args.out.clone();
                path.extend(format!("{id}.{ending}").split('/'));
                files::write_atomic(&path, &bytes).map_err(io::Error::other)
            };
            each(&set, &samples, kind, &mut done, write).map_err(|e| Error::Output {
                path: args.out.clone(),
                problem: e.to_string(),
            })?;
            args.out.clone()
        }
    };
    say(format_args!(
        "{} {} frames of {} ground truth: {}",
        done.frames,
        args.role,
        kind.name(),
        target.display()
    ));
    if done.without > 0 {
        tell(format_args!(
            "{} {} samples have no {} ground truth and were left out",
            done.without,
            args.role,
            kind.name()
        ));
    }
    if done.clipped > 0 {
        tell(format_args!(
            "{} pixels are beyond 255.996 m, the most that 16 bits hold, and were written as that",
            done.clipped
        ));
    }
    Ok(u8::from(done.failed > 0))
}

/// The kind asked for, or the only one there is.
fn choose(asked: Option<Kind>, samples: &[Sample], set: &PreparedSet, role: Role) -> Result<Kind> {
    let there: Vec<Kind> = Kind::value_variants()
        .iter()
        .copied()
        .filter(|kind| samples.iter().any(|sample| kind.file(sample).is_some()))
        .collect();
    let names: Vec<_> = there.iter().map(|kind| kind.name()).collect();
    let root = set.root.display();
    match (asked, &*there) {
        (_, []) => Err(Error::Usage(format!(
            "the {role} samples of {root} have no ground truth"
        ))),
        (Some(kind), there) if there.contains(&kind) => Ok(kind),
        (Some(kind), _) => Err(Error::Usage(format!(
            "the {role} samples of {root} have no {} ground truth; there is {}",
            kind.name(),
            names.join(", ")
        ))),
        (None, [only]) => Ok(*only),
        (None, _) => Err(Error::Usage(format!(
            "the {role} samples of {root} have several kinds of ground truth; choose one with --kind: {}",
            names.join(", ")
        ))),
    }
}

/// Hands every readable map to `write`; the others are told by name and counted. `write` counts
/// pixels that its format cannot hold.
fn each(
    set: &PreparedSet,
    samples: &[Sample],
    kind: Kind,
    done: &mut Done,
    mut write: impl FnMut(&str, &Plane, &mut u64) -> io::Result<()>,
) -> io::Result<()> {
    for sample in samples {
        let Some(file) = kind.file(sample) else {
            done.without += 1;
            continue;
        };
        match exr::read_depth(&set.path(file)) {
            Ok((plane, _)) => {
                write(&sample.id, &plane, &mut done.clipped)?;
                done.frames += 1;
            }
            Err(error) => {
                done.failed += 1;
                tell(format_args!("error: {} left out: {error}", sample.id));
            }
        }
    }
    Ok(())
}

/// Metres times 256. What was measured stays so: it is at least 1.
fn png16(plane: &Plane, clipped: &mut u64) -> Vec<u8> {
    let value = |depth_m: &f32| {
        if *depth_m <= 0.0 {
            return 0;
        }
        let value = (f64::from(*depth_m) * 256.0).round_ties_even();
        if value > f64::from(u16::MAX) {
            *clipped += 1;
        }
        value.clamp(1.0, f64::from(u16::MAX)) as u16
    };
    let values: Vec<u16> = plane.data.iter().map(value).collect();
    image_files::encode_png_gray16(plane.width as u32, plane.height as u32, &values)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sixteen_bits_hold_metres_times_256() {
        let depths = vec![0.0, 1.0, 80.0, 0.001, 255.996_1, 300.0];
        let mut clipped = 0;
        let bytes = png16(&Plane::new(3, 2, depths).unwrap(), &mut clipped);
        let (width, height, values) = image_files::decode_gray16(&bytes, "map").unwrap();
        assert_eq!((width, height), (3, 2));
        assert_eq!(values, [0, 256, 20_480, 1, 65_535, 65_535]);
        assert_eq!(clipped, 1);
    }
}
