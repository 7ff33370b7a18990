//! What the collections beside KITTI share: settings of their sets, the frames of a set made on
//! many threads, files kept from an earlier run, failures that cost one frame only.
//!
//! KITTI itself, with archives, shards and splits, is [`crate::build`].

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Component, Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::SystemTime;

use image::RgbImage;
use image::imageops;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use strat_splits::Role;
use strat_store::image_files::{self, Codec};
use strat_store::progress::Progress;
use strat_store::resize::{self, Kernel};
use strat_store::set::{
    CameraEntry, Content, Count, FORMAT, FileRef, Manifest, PreparedSet, Sample,
};
use strat_store::{files, yaml};

use crate::build::{FAILURES, Failure, Report, SETTINGS};
use crate::cli::{parse_jobs, say, tell};
use crate::error::{Error, Result};
use crate::inventory::summary;
use crate::output::{self, FAILURES_SHOWN, Output, write_failures};
pub(crate) use crate::output::{Piece, Stop};
use crate::source::Source;

/// Options of every collection.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct Options {
    /// Width in pixels of the network-size images.
    #[arg(long, default_value_t = 512, value_parser = clap::value_parser!(u32).range(8..=8192))]
    pub width: u32,
    /// Height in pixels of the network-size images.
    #[arg(long, default_value_t = 256, value_parser = clap::value_parser!(u32).range(8..=8192))]
    pub height: u32,
    /// Resize kernel: area (as the thesis' code), bilinear or lanczos3.
    #[arg(long, default_value_t = Kernel::Area)]
    pub kernel: Kernel,
    /// How network-size images are stored: png (without loss) or jpeg-QUALITY, e.g. jpeg-92.
    #[arg(long, value_name = "CODEC", default_value_t = Codec::Png)]
    pub codec: Codec,
    /// Threads to use [default: all cores].
    #[arg(long, value_name = "N", value_parser = parse_jobs)]
    pub jobs: Option<usize>,
    /// Show no progress.
    #[arg(long)]
    pub quiet: bool,
    /// Folder to write to: new, empty, or of an earlier run with the same options.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
}

/// What every file of such a set depends on. Sets of different settings do not mix.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Settings {
    format: u32,
    content: Content,
    image_width: u32,
    image_height: u32,
    kernel: Kernel,
    codec: String,
}

/// A frame to be made.
#[derive(Debug)]
pub(crate) struct Frame<T> {
    pub role: Role,
    /// Unique, and a path of ordinary parts: see [`check_id`].
    pub id: String,
    pub input: T,
}

/// Whether an id can be part of file names of a set on every system.
pub(crate) fn check_id(id: &str) -> std::result::Result<(), String> {
    let inside = !id.is_empty()
        && Path::new(id)
            .components()
            .all(|part| matches!(part, Component::Normal(_)))
        && !id.ends_with('/')
        && !id.contains("//")
        && !id.contains("/./")
        && !id.contains(|c: char| c.is_control() || "\\:*?\"<>|".contains(c));
    if inside {
        return Ok(());
    }
    Err(format!(
        "`{id}` is no usable id: it becomes a file name in the set, so it should be a plain name or \
         a path without `..`, without a slash at its ends and without \\ : * ? \" < > |"
    ))
}

/// Makes sure that `out` is new, empty or an earlier state of the same set, and in no input folder.
fn check_output(out: &Path, inputs: &[&Path], settings: &Settings) -> Result<()> {
    if !output::holds_a_set(out, inputs)? {
        return Ok(());
    }
    match yaml::load::<Settings>(&out.join(SETTINGS)) {
        Ok(before) if before == *settings => Ok(()),
        _ => Err(Error::Output {
            path: out.to_owned(),
            problem: format!(
                "this folder holds a set of other data or made with other options ({SETTINGS} in it \
                 says which); give another folder or the same options"
            ),
        }),
    }
}

/// Makes all frames and writes the set. `before` are failures found before any frame was tried,
/// with which `expected` counts where their role is known.
///
/// # Errors
/// The output cannot be written or nothing could be made. Bad inputs alone are no error here.
pub(crate) fn build<T: Sync>(
    content: Content,
    options: &Options,
    inputs: &[&Path],
    expected: BTreeMap<Role, u64>,
    frames: &[Frame<T>],
    before: Vec<Failure>,
    make: impl Fn(&Workshop<'_>, &Frame<T>) -> Piece<Sample> + Sync,
) -> Result<Report> {
    let out = &*options.out;
    let settings = Settings {
        format: FORMAT,
        content,
        image_width: options.width,
        image_height: options.height,
        kernel: options.kernel,
        codec: options.codec.to_string(),
    };
    check_output(out, inputs, &settings)?;
    files::check_writable(out)?;
    files::write_atomic(&out.join(SETTINGS), yaml::to_string(&settings)?.as_bytes())?;
    let workshop = Workshop {
        options,
        files: Output::open(out),
    };
    let label = format!("prep {content}");
    let progress = Progress::new(&label, frames.len() as u64, "frames", options.quiet);
    let told = AtomicU64::new(0);
    let tell_of = |failure: &Failure| {
        if told.fetch_add(1, Ordering::Relaxed) < FAILURES_SHOWN {
            progress.println(&format!("skipped {}: {}", failure.id, failure.problem));
        }
    };
    before.iter().for_each(tell_of);
    let pool = output::threads(options.jobs)?;
    let made: Vec<std::result::Result<Sample, Failure>> = pool.install(|| {
        let work = frames.par_iter().map(|frame| {
            let made = match make(&workshop, frame) {
                Ok(sample) => Ok(sample),
                Err(stop) => {
                    let failure = stop.failure(frame.role, &frame.id)?;
                    tell_of(&failure);
                    Err(failure)
                }
            };
            progress.add(1);
            Ok(made)
        });
        work.collect::<Result<_>>()
    })?;
    progress.finish();

    let mut samples: BTreeMap<Role, Vec<Sample>> = BTreeMap::new();
    let mut failures = before;
    for (frame, made) in frames.iter().zip(made) {
        match made {
            Ok(sample) => samples.entry(frame.role).or_default().push(sample),
            Err(failure) => failures.push(failure),
        }
    }
    let counts = Role::ALL.into_iter().map(|role| {
        let found = samples.get(&role).map_or(0, Vec::len) as u64;
        let expected = expected.get(&role).copied().unwrap_or(0);
        (role, Count { expected, found })
    });
    let manifest = Manifest {
        format: FORMAT,
        content,
        split_digest: None,
        source: content.to_string(),
        image_width: options.width,
        image_height: options.height,
        kernel: options.kernel,
        codec: settings.codec.clone(),
        counts: counts.collect(),
        failures: failures.len() as u64,
        cameras: cameras(content, samples.values().flatten()),
        tool_version: env!("CARGO_PKG_VERSION").to_owned(),
        data_digest: String::new(),
    };
    write_failures(out, &failures)?;
    let set = PreparedSet::write(out, manifest, &samples)?;
    Ok(Report {
        set,
        failures,
        written: workshop.files.written(),
        kept: workshop.files.kept_files(),
    })
}

/// The different cameras of the samples; those that are not known are left out.
fn cameras<'a>(content: Content, samples: impl Iterator<Item = &'a Sample>) -> Vec<CameraEntry> {
    let mut cameras = BTreeMap::new();
    for sample in samples.filter(|sample| sample.focal_px > 0.0) {
        let numbers = [sample.focal_px.to_bits(), sample.baseline_m.to_bits()];
        let entry = CameraEntry {
            name: content.to_string(),
            width: sample.width,
            height: sample.height,
            focal_px: sample.focal_px,
            baseline_m: sample.baseline_m,
        };
        cameras.insert((sample.width, sample.height, numbers), entry);
    }
    cameras.into_values().collect()
}

/// Prints what was made; 1 if something could not be used.
pub(crate) fn conclude(report: &Report) -> u8 {
    let root = &report.set.root;
    let manifest = &report.set.manifest;
    say(summary(&manifest.counts));
    say(format_args!(
        "{} files written, {} kept",
        report.written, report.kept
    ));
    say(format_args!(
        "set {} ({})",
        root.display(),
        manifest.content
    ));
    say(format_args!("digest {}", manifest.data_digest));
    if !report.failures.is_empty() {
        tell(format_args!(
            "error: {} inputs could not be used; they are listed in {}. Put them right and run the same \
             command again: only what is missing is made.",
            report.failures.len(),
            root.join(FAILURES).display()
        ));
    }
    u8::from(!report.failures.is_empty())
}

/// A picture in the set, and the size in pixels of what it was made from, after cropping.
pub(crate) struct Picture {
    pub small: FileRef,
    pub full: Option<FileRef>,
    pub size: (u32, u32),
}

/// Which rows of an image of this width and height are used; an error says why it cannot be.
pub(crate) type Crop = fn((u32, u32)) -> std::result::Result<Range<u32>, String>;

/// Where frames are made.
pub(crate) struct Workshop<'a> {
    options: &'a Options,
    /// The files of the set.
    pub files: Output<'a>,
}

impl Workshop<'_> {
    /// A picture at network size and, if asked for, at its own: the file as it is, or what is left
    /// of it after cropping as PNG.
    pub fn picture(
        &self,
        side: &str,
        id: &str,
        from: &Path,
        crop: Option<Crop>,
        keep_full: bool,
    ) -> Piece<Picture> {
        let input = |problem: strat_store::Error| Stop::path(from, problem);
        let rows = |size: (u32, u32)| match crop {
            Some(crop) => crop(size).map_err(|problem| Stop::about(from, problem)),
            None => Ok(0..size.1),
        };
        let ending = match crop {
            None => ending(from).unwrap_or_else(|| "png".to_owned()),
            Some(_) => "png".to_owned(),
        };
        let small = format!("images/{side}/{id}.{}", self.options.codec.ending());
        let full = keep_full.then(|| format!("full/{side}/{id}.{ending}"));
        let changed = changed(from);
        let kept_small = self.files.kept(&small, changed)?;
        let kept_full = match &full {
            Some(path) => self.files.kept(path, changed)?,
            None => None,
        };
        if let Some(small) = &kept_small
            && kept_full.is_some() == full.is_some()
        {
            let size = image_files::read_size(from).map_err(input)?;
            let rows = rows(size)?;
            return Ok(Picture {
                small: small.clone(),
                full: kept_full,
                size: (size.0, rows.end - rows.start),
            });
        }
        let bytes = files::read(from).map_err(input)?;
        let name = from.display().to_string();
        let mut image = image_files::decode_rgb(&bytes, &name).map_err(input)?;
        let rows = rows(image.dimensions())?;
        if crop.is_some() {
            image = crop_rows(&image, rows);
        }
        let Options {
            width,
            height,
            kernel,
            codec,
            ..
        } = *self.options;
        let small = match kept_small {
            Some(small) => small,
            None => self.files.put(
                small,
                &codec.encode(&resize::rgb(&image, width, height, kernel)),
            )?,
        };
        let full = match (kept_full, full) {
            (None, Some(path)) if crop.is_some() => {
                Some(self.files.put(path, &image_files::encode_png_rgb(&image))?)
            }
            (None, Some(path)) => Some(self.files.put(path, &bytes)?),
            (kept, _) => kept,
        };
        Ok(Picture {
            small,
            full,
            size: image.dimensions(),
        })
    }
}

/// When a file was last written or put into its place.
pub(crate) fn changed(path: &Path) -> Option<SystemTime> {
    Source::File(path.to_owned()).changed()
}

/// The ending of a file name in small letters.
pub(crate) fn ending(path: &Path) -> Option<String> {
    Some(path.extension()?.to_str()?.to_lowercase())
}

/// Depth as it is stored: what is not positive and finite counts as not measured and becomes 0.
pub(crate) fn measured(depth_m: f64) -> f32 {
    let depth_m = depth_m as f32;
    if depth_m.is_finite() && depth_m > 0.0 {
        depth_m
    } else {
        0.0
    }
}

pub(crate) fn crop_rows(image: &RgbImage, rows: Range<u32>) -> RgbImage {
    let height = rows.end.saturating_sub(rows.start);
    imageops::crop_imm(image, 0, rows.start, image.width(), height).to_image()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_stay_inside_the_set() {
        for good in ["a", "straße 7/bild 0001", "a/b/c.d", "...", "0"] {
            assert_eq!(check_id(good), Ok(()), "{good}");
        }
        for bad in [
            "", "/a", "../a", "a/../b", "a/", "a//b", "a/./b", ".", "a\\b", "C:a", "a\nb",
        ] {
            assert!(check_id(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn what_was_not_measured_becomes_zero() {
        let depths = [1.5, 0.0, -1.0, f64::NAN, f64::INFINITY, 1e300, 1e-300];
        assert_eq!(depths.map(measured), [1.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    }

    #[test]
    fn rows_are_cut_out() {
        let image = RgbImage::from_fn(3, 10, |x, y| image::Rgb([x as u8, y as u8, 7]));
        let cut = crop_rows(&image, 2..5);
        assert_eq!(cut.dimensions(), (3, 3));
        assert_eq!(cut.get_pixel(1, 0).0, [1, 2, 7]);
        assert_eq!(cut.get_pixel(2, 2).0, [2, 4, 7]);
    }
}
