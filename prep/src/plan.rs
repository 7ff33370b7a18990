//! `prep plan`: what a preparation needs before it starts.
//!
//! Which of KITTI's archives serve a split or a table follows from the drive table (PROTOCOL
//! 2.2). KITTI does not publish a machine-readable list of sizes, so sizes are marked as "about":
//! the archives of raw drives are reckoned from their frames and the 175 GB that all of them
//! take together. What is to be written and how long it takes is measured on a few frames of
//! the user's own, or, when there are none yet, on a rendered pattern of the same size.
//!
//! Nothing is downloaded and nothing is written.

use std::collections::BTreeSet;
use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::time::Instant;

use image::{Rgb, RgbImage};
use serde::Serialize;
use strat_splits::{
    Drive, DriveRole, FrameId, Split, counts, drives, eigen_test, kitti2015_origin,
};
use strat_store::image_files::{self, Codec};
use strat_store::resize::{self, Kernel};

use crate::cli::{parse_jobs, say};
use crate::error::{Error, Result};
use crate::input::raw::RawFolder;
use crate::input::stereo2015::{Kind, SceneFolder};
use crate::kitti::samples::SETTINGS;
use crate::set::space::{free_bytes, human_bytes};

/// Bytes of all 61 archives of KITTI raw, synced and rectified, by common report.
const ALL_OF_RAW: f64 = 175e9;

/// Bytes of a Velodyne depth map as EXR: about 15,000 points of 1242x375 pixels.
const SPARSE_DEPTH: u64 = 136_000;

/// Bytes of a stereo 2015 depth map as EXR: about 90,000 measured pixels.
const DENSE_DEPTH: u64 = 480_000;

/// Frames measured at most.
const MEASURED: usize = 6;

/// Arguments of `prep plan`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  prep plan --table 3.1                                  the least that table 3.1 needs
  prep plan --split eigen                                everything for training and evaluation
  prep plan --split kitti --raw kitti_raw --out sets/kitti   what of it is there, space and time")]
pub(crate) struct Args {
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
    /// Width in pixels of the network-size images.
    #[arg(long, default_value_t = 512, value_parser = clap::value_parser!(u32).range(8..=8192))]
    width: u32,
    /// Height in pixels of the network-size images.
    #[arg(long, default_value_t = 256, value_parser = clap::value_parser!(u32).range(8..=8192))]
    height: u32,
    /// How network-size images are stored: png, or jpeg of quality 92.
    #[arg(long, value_name = "CODEC", default_value = "png", value_parser = ["png", "jpeg"])]
    codec: String,
    /// Threads the preparation will use [default: all cores].
    #[arg(long, value_name = "N", value_parser = parse_jobs)]
    jobs: Option<usize>,
    /// Print the plan as JSON.
    #[arg(long)]
    json: bool,
}

/// An archive of KITTI.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Archive {
    /// Its name on KITTI's pages.
    pub name: String,
    /// What it is for.
    pub purpose: &'static str,
    /// About how many bytes it has.
    pub about_bytes: u64,
    /// Samples, or files of a calibration, that are taken from it.
    pub wanted: u64,
    /// How many of them are there already, packed or unpacked.
    pub found: u64,
}

impl Archive {
    /// Whether nothing of it is lacking.
    pub fn is_there(&self) -> bool {
        self.found == self.wanted
    }

    fn state(&self) -> String {
        match self.found {
            0 => "missing".to_owned(),
            _ if self.is_there() => "there".to_owned(),
            found => format!("{found} of {}", self.wanted),
        }
    }
}

/// What a preparation needs.
#[derive(Debug, Serialize)]
pub struct Plan {
    /// The split.
    pub split: Split,
    /// Whether only test images are to be prepared.
    pub test_only: bool,
    /// The command, with what is still to be filled in in capitals.
    pub command: String,
    /// Archives it reads.
    pub archives: Vec<Archive>,
    /// Samples it makes.
    pub samples: u64,
    /// About how many bytes it writes, less those of an earlier run.
    pub bytes_to_write: u64,
    /// Bytes that an earlier run has written there.
    pub bytes_written: u64,
    /// Free bytes where they are to be written; `None` if the system does not tell.
    pub free_bytes: Option<u64>,
    /// Threads reckoned with.
    pub threads: usize,
    /// About how many seconds it takes.
    pub seconds: f64,
    /// What time and size were measured on.
    pub measured_on: String,
}

/// Runs the command and returns its exit code: 1 if the disk has no room.
pub(crate) fn run(args: &Args) -> Result<u8> {
    let plan = plan(args)?;
    if args.json {
        let text = serde_json::to_string_pretty(&plan);
        say(text.map_err(|e| Error::Incomplete(format!("the plan is no JSON: {e}")))?);
    } else {
        say(plan.text(&args.out).trim_end());
    }
    Ok(u8::from(
        plan.free_bytes
            .is_some_and(|free| free < plan.bytes_to_write),
    ))
}

fn plan(args: &Args) -> Result<Plan> {
    let table = args.table.as_deref();
    let split = match (args.split, table) {
        (Some(split), _) => split,
        (None, Some("3.3")) => Split::Eigen,
        (None, _) => Split::Kitti,
    };
    let test_only = table.is_some();
    let raw = args.raw.as_deref().map(RawFolder::open).transpose()?;
    let open = |path: &Option<PathBuf>, kind| {
        let path = path.as_deref();
        path.map(|path| SceneFolder::open(path, kind)).transpose()
    };
    let stereo = open(&args.stereo2015, Kind::Stereo)?;
    let semantics = open(&args.semantics, Kind::Semantics)?;

    let mut archives = Vec::new();
    if split == Split::Kitti {
        let scenes = kitti2015_origin().len();
        let mut scene = |name: &str, purpose, about_bytes, is_there: &dyn Fn(usize) -> bool| {
            archives.push(Archive {
                name: name.to_owned(),
                purpose,
                about_bytes,
                wanted: scenes as u64,
                found: (0..scenes).filter(|number| is_there(*number)).count() as u64,
            });
        };
        let has = |folder: &Option<SceneFolder>, kind, number| {
            let folder = folder.as_ref();
            folder.is_some_and(|folder| folder.picture(kind, number).is_some())
        };
        scene(
            "data_scene_flow.zip",
            "test images and disparities",
            2_000_000_000,
            &|number| {
                let kinds = ["image_2", "image_3", "disp_noc_0"];
                kinds.iter().all(|kind| has(&stereo, kind, number))
            },
        );
        scene(
            "data_scene_flow_calib.zip",
            "their cameras",
            2_000_000,
            &|number| {
                let stereo = stereo.as_ref();
                stereo.is_some_and(|stereo| stereo.calibration(number).is_some())
            },
        );
        if table != Some("3.1") {
            scene(
                "data_semantics.zip",
                "labels of the test images (table 3.2)",
                314_000_000,
                &|number| has(&semantics, "semantic", number),
            );
        }
    }
    archives.extend(raw_archives(split, test_only, raw.as_ref()));

    let counted = counts(split);
    let test = counted.test as u64;
    let others = if test_only {
        0
    } else {
        (counted.train + counted.val) as u64
    };
    let threads = match args.jobs {
        Some(jobs) => jobs,
        None => std::thread::available_parallelism().map_or(1, usize::from),
    };
    let sample = measure(args, raw.as_ref(), stereo.as_ref())?;
    // Validation frames of both splits have depth from scans, as the Eigen test frames have.
    let (originals, dense, mut sparse) = match split {
        Split::Kitti => (2 * test, 2 * test, 0),
        Split::Eigen => (test, 0, 2 * test),
    };
    if !test_only {
        sparse += 2 * counted.val as u64;
    }
    let bytes = 2 * sample.small_bytes * (test + others)
        + sample.full_bytes * originals
        + DENSE_DEPTH * dense
        + SPARSE_DEPTH * sparse;
    let bytes_written = written(&args.out);
    let mut command = match (split, test_only) {
        (Split::Kitti, true) => {
            let labels = if table == Some("3.2") {
                " --semantics PATH"
            } else {
                ""
            };
            format!("prep kitti --test-only --stereo2015 PATH{labels} --out DIR")
        }
        (Split::Kitti, false) => {
            "prep kitti --raw DIR --stereo2015 PATH --semantics PATH --out DIR".to_owned()
        }
        (Split::Eigen, true) => "prep eigen --test-only --raw DIR --out DIR".to_owned(),
        (Split::Eigen, false) => "prep eigen --raw DIR --out DIR".to_owned(),
    };
    if args.codec == "jpeg" {
        command += " --codec jpeg";
    }
    Ok(Plan {
        split,
        test_only,
        command,
        archives,
        samples: test + others,
        bytes_to_write: bytes.saturating_sub(bytes_written),
        bytes_written,
        free_bytes: free_bytes(&args.out).ok(),
        threads,
        seconds: 2.0 * sample.seconds * (test + others) as f64 / threads as f64,
        measured_on: sample.source,
    })
}

/// Drives and calibrations of KITTI raw, in the order of the drive table.
fn raw_archives(split: Split, test_only: bool, raw: Option<&RawFolder>) -> Vec<Archive> {
    let frames: f64 = drives().iter().map(|drive| f64::from(drive.frames)).sum();
    let used = drives().iter().filter(|drive| match drive.role(split) {
        DriveRole::Train => !test_only,
        // The KITTI split is tested on stereo 2015, not on drives.
        DriveRole::Test => split == Split::Eigen,
    });
    // Of a test drive only the test frames are read, but with their scans.
    let frames_of = |drive: &Drive| -> Vec<FrameId> {
        match drive.role(split) {
            DriveRole::Train => drive.frame_ids().collect(),
            DriveRole::Test => {
                let tested = eigen_test().iter().copied();
                tested.filter(|frame| frame.drive == drive.id).collect()
            }
        }
    };
    let is_there = |frame: &FrameId| {
        let tested = split == Split::Eigen && eigen_test().contains(frame);
        raw.is_some_and(|raw| {
            let images = raw.left(*frame).is_some() && raw.right(*frame).is_some();
            images && (!tested || raw.scan(*frame).is_some())
        })
    };
    let (mut archives, mut days) = (Vec::new(), BTreeSet::new());
    for drive in used {
        days.insert(drive.id.date);
        archives.push(Archive {
            name: format!("{}_sync.zip", drive.id),
            purpose: match drive.role(split) {
                DriveRole::Train => "training",
                DriveRole::Test => "test",
            },
            about_bytes: (ALL_OF_RAW * f64::from(drive.frames) / frames) as u64,
            wanted: frames_of(drive).len() as u64,
            found: frames_of(drive).into_iter().filter(is_there).count() as u64,
        });
    }
    archives.extend(days.into_iter().map(|date| {
        let day = raw.and_then(|raw| raw.day(date));
        Archive {
            name: format!("{date}_calib.zip"),
            purpose: "cameras of the day",
            about_bytes: 4_000,
            wanted: 2,
            found: day.map_or(0, |day| {
                u64::from(day.cameras.is_ok()) + u64::from(day.projection.is_ok())
            }),
        }
    }));
    archives
}

/// Bytes of a set that is in `out` already, finished or not.
fn written(out: &Path) -> u64 {
    fn below(folder: &Path) -> u64 {
        let Ok(entries) = std::fs::read_dir(folder) else {
            return 0;
        };
        let size = |entry: std::fs::DirEntry| match entry.metadata() {
            Ok(metadata) if metadata.is_dir() => below(&entry.path()),
            Ok(metadata) => metadata.len(),
            Err(_) => 0,
        };
        entries.flatten().map(size).sum()
    }
    if !out.join(SETTINGS).is_file() {
        return 0;
    }
    let folders = ["images", "full", "depth"];
    folders.iter().map(|name| below(&out.join(name))).sum()
}

/// Work and size of one image.
struct Sample {
    seconds: f64,
    small_bytes: u64,
    full_bytes: u64,
    source: String,
}

/// Decodes, resizes and encodes a few images as a preparation would.
fn measure(args: &Args, raw: Option<&RawFolder>, stereo: Option<&SceneFolder>) -> Result<Sample> {
    let of_raw = raw.into_iter().flat_map(|raw| {
        drives()
            .iter()
            .flat_map(|drive| drive.frame_ids())
            .filter_map(|frame| raw.left(frame).cloned())
    });
    let scenes = stereo.into_iter().flat_map(|stereo| {
        (0..kitti2015_origin().len()).filter_map(|number| stereo.picture("image_2", number))
    });
    let mut images = Vec::new();
    for source in of_raw.chain(scenes).take(MEASURED) {
        let bytes = source.read()?;
        // A damaged frame is `prep verify`'s to tell of; here it is only no measure.
        if image_files::decode_rgb(&bytes, "").is_ok() {
            images.push(bytes);
        }
    }
    let source = match images.len() {
        0 => {
            images.push(image_files::encode_png_rgb(&pattern()));
            "a made-up image of 1242x375, since no frame is there yet".to_owned()
        }
        1 => "one of your images".to_owned(),
        n => format!("{n} of your images"),
    };
    let codec = match args.codec.as_str() {
        "jpeg" => Codec::Jpeg(92),
        _ => Codec::Png,
    };
    let (mut seconds, mut small, mut full) = (0.0, 0, 0);
    for bytes in &images {
        let started = Instant::now();
        let image = image_files::decode_rgb(bytes, "the sample")?;
        let resized = resize::rgb(&image, args.width, args.height, Kernel::Area);
        let encoded = black_box(codec.encode(&resized));
        seconds += started.elapsed().as_secs_f64();
        small += encoded.len() as u64;
        full += bytes.len() as u64;
    }
    let count = images.len() as u64;
    Ok(Sample {
        seconds: seconds / count as f64,
        small_bytes: small / count,
        full_bytes: full / count,
        source,
    })
}

/// An image of KITTI's size with about as much detail as a street has.
fn pattern() -> RgbImage {
    RgbImage::from_fn(1242, 375, |x, y| {
        // A hash of the place makes the grain, slow waves make the shapes.
        let grain = (x.wrapping_mul(2_654_435_761) ^ y.wrapping_mul(2_246_822_519)) >> 28;
        let wave = 100.0 + 60.0 * (f64::from(x) / 90.0).sin() + 50.0 * (f64::from(y) / 40.0).cos();
        let level = (wave + f64::from(grain)).clamp(0.0, 255.0) as u8;
        Rgb([level, level.saturating_add(9), level.saturating_sub(9)])
    })
}

impl Plan {
    fn text(&self, out: &Path) -> String {
        let what = if self.test_only {
            "test images only"
        } else {
            "training and test"
        };
        let mut text = format!("{} split, {what}\n\n", self.split);
        for archive in &self.archives {
            text += &format!(
                "{:<34} {:>15}  {:<12} {}\n",
                archive.name,
                format!("about {}", human_bytes(archive.about_bytes)),
                archive.state(),
                archive.purpose
            );
        }
        let sum = |there: bool| {
            let some = self.archives.iter().filter(|a| a.is_there() == there);
            (
                some.clone().count(),
                some.map(|a| a.about_bytes).sum::<u64>(),
            )
        };
        let ((there, there_bytes), (missing, missing_bytes)) = (sum(true), sum(false));
        text += &format!(
            "\n{there} archives are there (about {}), {missing} are to be downloaded (about {}); they need \
             not be unpacked\n",
            human_bytes(there_bytes),
            human_bytes(missing_bytes)
        );
        text += &format!(
            "to be written  about {} for {} samples{}\n",
            human_bytes(self.bytes_to_write),
            self.samples,
            match self.bytes_written {
                0 => String::new(),
                bytes => format!("; {} are there of an earlier run", human_bytes(bytes)),
            }
        );
        match self.free_bytes {
            Some(free) => {
                text += &format!("free           {} at {}", human_bytes(free), out.display());
                text += if free < self.bytes_to_write {
                    ": NOT ENOUGH\n"
                } else {
                    "\n"
                };
            }
            None => text += "free           the system does not tell\n",
        }
        text += &format!(
            "time           about {} on {} threads, measured on {}\n",
            duration(self.seconds),
            self.threads,
            self.measured_on
        );
        text += &format!("command        {}\n", self.command);
        text
    }
}

fn duration(seconds: f64) -> String {
    match seconds {
        s if s < 90.0 => format!("{:.0} s", s.max(1.0)),
        s if s < 5400.0 => format!("{:.0} min", s / 60.0),
        s => format!("{:.1} h", s / 3600.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn archives(split: Split, test_only: bool) -> (usize, f64) {
        let archives = raw_archives(split, test_only, None);
        let bytes: u64 = archives.iter().map(|a| a.about_bytes).sum();
        (archives.len(), bytes as f64 / 1e9)
    }

    #[test]
    fn archives_follow_from_the_drive_table() {
        // PROTOCOL 2.1: 32 training drives of the KITTI split, 33 + 28 of the Eigen split, on five
        // days; 29,000 + 1,159 of 42,382 pairs are in the former.
        assert_eq!(archives(Split::Kitti, true), (0, 0.0));
        let (count, size) = archives(Split::Kitti, false);
        assert_eq!(count, 32 + 5);
        assert!((size - 175.0 * 30_159.0 / 42_382.0).abs() < 0.01, "{size}");
        let (count, size) = archives(Split::Eigen, false);
        assert_eq!(count, 61 + 5);
        assert!((size - 175.0).abs() < 0.01, "{size}");
        let (count, size) = archives(Split::Eigen, true);
        assert_eq!(count, 28 + 5);
        assert!(
            (size - 175.0 * (42_382.0 - 23_488.0) / 42_382.0).abs() < 0.01,
            "{size}"
        );
    }

    #[test]
    fn durations_are_readable() {
        assert_eq!(duration(0.2), "1 s");
        assert_eq!(duration(600.0), "10 min");
        assert_eq!(duration(7200.0), "2.0 h");
    }
}
