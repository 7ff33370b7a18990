//! What the collections beside KITTI share: their options, and pictures that may be cropped.
//!
//! KITTI itself, with archives and splits, is [`crate::kitti::samples`].

pub mod cityscapes;
pub mod make3d;
pub mod pairs;

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Component, Path, PathBuf};
use std::time::SystemTime;

use image::RgbImage;
use image::imageops;
use strat_splits::Role;
use strat_store::files;
use strat_store::image_files::{self, Codec};
use strat_store::resize::{self, Kernel};
use strat_store::set::{Content, FORMAT, FileRef, Sample};

use crate::cli::parse_jobs;
use crate::error::Result;
use crate::input::source::Source;
use crate::set::shards::Shard;
use crate::set::writer::{self as output, Failure, Made, Output, Report, Run, Settings};
pub(crate) use crate::set::writer::{Frame, Piece, Stop};

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
    /// Prepare only one of N parts, numbered from 0; `prep merge` makes a set of all of them.
    #[arg(long, value_name = "I/N")]
    pub shard: Option<Shard>,
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

/// Makes all frames and writes the set, or the part of it that is asked for. `before` are failures
/// found before any frame was tried, with which `expected` counts where their role is known.
///
/// # Errors
/// The output cannot be written. Bad inputs alone are no error here.
pub(crate) fn build<T: Sync>(
    content: Content,
    options: &Options,
    inputs: &[&Path],
    expected: &BTreeMap<Role, u64>,
    frames: &[Frame<T>],
    before: Vec<Failure>,
    make: impl Fn(&Workshop<'_>, &Frame<T>) -> Piece<Sample> + Sync,
) -> Result<Report> {
    let settings = Settings {
        format: FORMAT,
        content,
        source: content.to_string(),
        image_width: options.width,
        image_height: options.height,
        kernel: options.kernel,
        codec: options.codec,
    };
    output::check_output(&options.out, inputs, &settings)?;
    let run = Run {
        out: &options.out,
        settings: &settings,
        shard: options.shard,
        threads: options.jobs,
        quiet: options.quiet,
    };
    let expected = Role::ALL.map(|role| (role, expected.get(&role).copied().unwrap_or(0)));
    run.make(expected.into(), frames, before, |files, frame| {
        let workshop = Workshop { options, files };
        let mut made = Made::default();
        match make(&workshop, frame) {
            Ok(sample) => made.sample = Some(sample),
            Err(stop) => made.failures.push(stop.failure(frame.role, &frame.id)?),
        }
        Ok(made)
    })
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
    pub files: &'a Output<'a>,
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
