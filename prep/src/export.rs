//! Ground truth out of a prepared set, for other programs.
//!
//! Values are metres, 0 where nothing was measured. `npz` is one archive with one `f32` array
//! (rows, columns) per frame named by its id, `npy` one such file per frame, `png16` one 16-bit
//! picture per frame of metres times 256, as KITTI stores depth. Nothing is resized or masked.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use strat_splits::Role;
use strat_store::claim::{Found, Mark};
use strat_store::layout::DepthKind;
use strat_store::raster::Plane;
use strat_store::set::{PreparedSet, Sample};
use strat_store::signals::Watch;
use strat_store::{exr, files, image_files, npy, yaml};
use zip::ZipWriter;
use zip::write::SimpleFileOptions;

use crate::error::{Error, Result};
use crate::pickle;

/// What is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// One NumPy archive of all frames.
    Npz,
    /// A 16-bit picture per frame, metres times 256.
    Png16,
    /// A NumPy file per frame.
    Npy,
    /// `gt_depths.npz` as monodepth2's `evaluate_depth.py` reads it: one array `data` of all frames in their
    /// order.
    Monodepth2,
}

impl Format {
    /// The name on the command line.
    fn name(self) -> &'static str {
        match self {
            Self::Npz => "npz",
            Self::Png16 => "png16",
            Self::Npy => "npy",
            Self::Monodepth2 => "monodepth2",
        }
    }
}

/// What came of the frames.
#[derive(Debug)]
pub struct Exported {
    /// The ground truth that was written.
    pub kind: DepthKind,
    /// The file or folder written to.
    pub target: PathBuf,
    /// Frames written.
    pub frames: u64,
    /// Samples without this ground truth.
    pub without: u64,
    /// Pixels beyond what the format holds.
    pub clipped: u64,
    /// Frames that could not be read, with the reason.
    pub failed: Vec<String>,
}

/// Writes the ground truth of a role's samples into `out`, of the given kind or of the only one there
/// is. The folder is new, empty, or one of exports; only those of the same ground truth are replaced.
///
/// # Errors
/// The set cannot be read or has no such ground truth, or `out` lies inside it, holds other things or
/// cannot be written.
pub fn export(
    set: &PreparedSet,
    role: Role,
    kind: Option<DepthKind>,
    format: Format,
    out: &Path,
) -> Result<Exported> {
    let samples = set.samples(role)?;
    let kind = choose(kind, &samples, set, role)?;
    let export = Export {
        set_digest: set.manifest.data_digest.clone(),
        role: role.to_string(),
        kind: kind.as_str().to_owned(),
        format: format.name().to_owned(),
    };
    let record = claim(set, export, out)?;
    let mut done = Exported {
        kind,
        target: out.to_owned(),
        frames: 0,
        without: 0,
        clipped: 0,
        failed: Vec::new(),
    };
    match format {
        Format::Npz => {
            done.target = out.join(format!("{role}-{}.npz", kind.as_str()));
            let path = done.target.clone();
            files::write_atomic_with(&path, |out| {
                let mut zip = ZipWriter::new_stream(out);
                // No date of writing, so that the same set gives the same bytes.
                let options = SimpleFileOptions::default()
                    .compression_method(zip::CompressionMethod::Deflated)
                    .last_modified_time(zip::DateTime::default());
                each(set, &samples, &mut done, |id, plane, _| {
                    zip.start_file(format!("{id}.npy"), options)
                        .map_err(io::Error::other)?;
                    zip.write_all(&npy::encode(plane.width, plane.height, &plane.data))
                })?;
                zip.finish().map_err(io::Error::other)?;
                Ok(())
            })?;
        }
        Format::Monodepth2 => {
            done.target = out.join("gt_depths.npz");
            let path = done.target.clone();
            let count = samples
                .iter()
                .filter(|sample| kind.of(sample).is_some())
                .count();
            files::write_atomic_with(&path, |out| {
                let mut zip = ZipWriter::new_stream(out);
                let options = SimpleFileOptions::default()
                    .compression_method(zip::CompressionMethod::Deflated)
                    .last_modified_time(zip::DateTime::default());
                // Of 697 maps of KITTI's size more than a gigabyte.
                let options = options.large_file(true);
                zip.start_file("data.npy", options)
                    .map_err(io::Error::other)?;
                pickle::begin(&mut zip, count)?;
                each(set, &samples, &mut done, |_, plane, _| {
                    pickle::map(&mut zip, plane)
                })?;
                pickle::end(&mut zip)?;
                // A gap would move all later frames to other images.
                if let Some(problem) = done.failed.first() {
                    return Err(io::Error::other(format!(
                        "{problem}; without it the order would be wrong"
                    )));
                }
                zip.finish().map_err(io::Error::other)?;
                Ok(())
            })?;
        }
        Format::Npy | Format::Png16 => {
            let write = |id: &str, plane: &Plane, clipped: &mut u64| {
                let (extension, bytes) = match format {
                    Format::Png16 => ("png", png16(plane, clipped)),
                    _ => ("npy", npy::encode(plane.width, plane.height, &plane.data)),
                };
                let path = out.join(format!("{id}.{extension}"));
                files::write_atomic(&path, &bytes).map_err(io::Error::other)
            };
            each(set, &samples, &mut done, write).map_err(|error| {
                let problem = error.to_string();
                match error.downcast::<strat_store::Error>() {
                    Ok(error) => Error::Store(error),
                    Err(_) => Error::Output {
                        path: out.to_owned(),
                        problem,
                    },
                }
            })?;
        }
    }
    MARK.finish(out, yaml::to_string(&record)?.as_bytes())?;
    Ok(done)
}

/// Whose a folder of exports is. Frames are named by their ids, so the whole folder is.
const MARK: Mark = Mark {
    command: "prep export",
    record: "export.yaml",
    begins: "tool: prep export\n",
    writes: |_| true,
};

/// What a folder of exports holds.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Record {
    tool: String,
    exports: Vec<Export>,
}

/// Ground truth of one role of a set in one format.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Export {
    set_digest: String,
    role: String,
    kind: String,
    format: String,
}

impl Export {
    /// Whether two exports write files of the same names.
    fn collides(&self, other: &Self) -> bool {
        let names = |export: &Self| match export.format.as_str() {
            "npz" => Some((export.role.clone(), export.kind.clone())),
            // One name for all of them.
            "monodepth2" => Some((String::new(), String::new())),
            _ => None,
        };
        self.format == other.format
            && names(self) == names(other)
            && (self.role == other.role || self.format == "monodepth2")
    }
}

/// Looks at the folder and marks it; what it will hold when `export` is there.
fn claim(set: &PreparedSet, export: Export, out: &Path) -> Result<Record> {
    let mut record = Record {
        tool: MARK.command.to_owned(),
        exports: Vec::new(),
    };
    if MARK.examine(out, &[&set.root])? == Found::Record {
        record = yaml::load(&out.join(MARK.record))?;
    }
    let mut others = record.exports.iter().filter(|other| **other != export);
    if let Some(other) = others.find(|other| other.collides(&export)) {
        return Err(Error::Output {
            path: out.to_owned(),
            problem: format!(
                "this folder holds {} ground truth of the {} samples of a set with digest {:.12} under the \
                 names that would be written; give another folder",
                other.kind, other.role, other.set_digest
            ),
        });
    }
    MARK.begin(out)?;
    if !record.exports.contains(&export) {
        record.exports.push(export);
    }
    Ok(record)
}

/// The given kind, or the only one there is.
fn choose(
    given: Option<DepthKind>,
    samples: &[Sample],
    set: &PreparedSet,
    role: Role,
) -> Result<DepthKind> {
    let there: Vec<DepthKind> = DepthKind::ALL
        .into_iter()
        .filter(|kind| samples.iter().any(|sample| kind.of(sample).is_some()))
        .collect();
    let names: Vec<_> = there.iter().map(|kind| kind.as_str()).collect();
    let root = set.root.display();
    match (given, &*there) {
        (_, []) => Err(Error::Usage(format!(
            "the {role} samples of {root} have no ground truth"
        ))),
        (Some(kind), there) if there.contains(&kind) => Ok(kind),
        (Some(kind), _) => Err(Error::Usage(format!(
            "the {role} samples of {root} have no {} ground truth; there is {}",
            kind.as_str(),
            names.join(", ")
        ))),
        (None, [only]) => Ok(*only),
        (None, _) => Err(Error::Usage(format!(
            "the {role} samples of {root} have several kinds of ground truth; choose one with --kind: {}",
            names.join(", ")
        ))),
    }
}

/// Hands every readable map to `write`; the others are noted by name. `write` counts pixels that its
/// format cannot hold.
fn each(
    set: &PreparedSet,
    samples: &[Sample],
    done: &mut Exported,
    mut write: impl FnMut(&str, &Plane, &mut u64) -> io::Result<()>,
) -> io::Result<()> {
    let watch = Watch::new("stopping after this map");
    for sample in samples {
        watch.check().map_err(io::Error::other)?;
        let Some(file) = done.kind.of(sample) else {
            done.without += 1;
            continue;
        };
        match exr::read_depth(&set.path(file)) {
            Ok((plane, _)) => {
                write(&sample.id, &plane, &mut done.clipped)?;
                done.frames += 1;
            }
            Err(error) => done.failed.push(format!("{} left out: {error}", sample.id)),
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
