//! What a preparation needs before it starts.
//!
//! Which of KITTI's archives serve a split or a table follows from the drive table (PROTOCOL
//! 2.2). KITTI does not publish a machine-readable list of sizes, so sizes are marked as "about":
//! the archives of raw drives are estimated from their frames and the 175 GB that all of them
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
use strat_store::image_files::{self, Codec, DEFAULT_QUALITY};
use strat_store::inputs::Kind;
use strat_store::layout::SETTINGS;
use strat_store::{human, layout, resize};

use crate::error::Result;
use crate::input::raw::RawFolder;
use crate::input::stereo2015::SceneFolder;
use crate::set::settings::ImageOptions;
use crate::set::space::free_bytes;

/// Bytes of all 61 archives of KITTI raw, synced and rectified, by common report.
const ALL_OF_RAW: f64 = 175e9;

/// Bytes of a Velodyne depth map as EXR: about 15,000 points of 1242x375 pixels.
const SPARSE_DEPTH: u64 = 136_000;

/// Bytes of a stereo 2015 depth map as EXR: about 90,000 measured pixels.
const DENSE_DEPTH: u64 = 480_000;

/// Where KITTI's archives lie.
const DOWNLOADS: &str = "https://s3.eu-central-1.amazonaws.com/avg-kitti";

/// Frames measured at most.
const MEASURED: usize = 6;

/// What a preparation is to make, and what of it is there.
#[derive(Debug)]
pub struct Request {
    /// What is prepared.
    pub goal: Goal,
    /// KITTI raw, as far as it is there.
    pub raw: Option<RawFolder>,
    /// KITTI stereo 2015, if it is there.
    pub stereo2015: Option<SceneFolder>,
    /// KITTI semantics, if it is there.
    pub semantics: Option<SceneFolder>,
    /// Folder of the set.
    pub out: PathBuf,
    /// Its network-size images.
    pub images: ImageOptions,
    /// Threads the preparation will use; 0 for one for each core.
    pub threads: usize,
}

/// What is prepared.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Goal {
    /// A split, for training and evaluation.
    Split(Split),
    /// The test images of table 3.1.
    Table31,
    /// The test images and labels of table 3.2.
    Table32,
    /// The test images of table 3.3.
    Table33,
}

impl Goal {
    fn split(self) -> Split {
        match self {
            Self::Split(split) => split,
            Self::Table31 | Self::Table32 => Split::Kitti,
            Self::Table33 => Split::Eigen,
        }
    }

    fn test_only(self) -> bool {
        !matches!(self, Self::Split(_))
    }

    /// The command, with what is still to be filled in in capitals.
    fn command(self, codec: Codec) -> String {
        let inputs = match self {
            Self::Split(Split::Kitti) => {
                "kitti --raw DIR --stereo2015 PATH --semantics PATH --out DIR"
            }
            Self::Split(Split::Eigen) => "eigen --raw DIR --out DIR",
            Self::Table31 => "kitti --test-only --stereo2015 PATH --out DIR",
            Self::Table32 => "kitti --test-only --stereo2015 PATH --semantics PATH --out DIR",
            Self::Table33 => "eigen --test-only --raw DIR --out DIR",
        };
        let codec = match codec {
            Codec::Png => String::new(),
            Codec::Jpeg(DEFAULT_QUALITY) => " --codec jpeg".to_owned(),
            Codec::Jpeg(quality) => format!(" --codec jpeg --quality {quality}"),
        };
        format!("prep {inputs}{codec}")
    }
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
    /// Where it can be downloaded, under the terms on KITTI's pages.
    pub url: String,
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
    /// Threads it is estimated for.
    pub threads: usize,
    /// About how many seconds it takes.
    pub seconds: f64,
    /// What time and size were measured on.
    pub measured_on: String,
}

/// Finds out what a preparation needs.
///
/// # Errors
/// One of the images to measure on cannot be read.
pub fn plan(request: &Request) -> Result<Plan> {
    let (split, test_only) = (request.goal.split(), request.goal.test_only());
    let (raw, stereo) = (request.raw.as_ref(), request.stereo2015.as_ref());
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
                url: format!("{DOWNLOADS}/{name}"),
            });
        };
        let has = |folder: Option<&SceneFolder>, kind, number| {
            folder.is_some_and(|folder| folder.picture(kind, number).is_some())
        };
        scene(
            "data_scene_flow.zip",
            "test images and disparities",
            2_000_000_000,
            &|number| {
                let kinds = ["image_2", "image_3", "disp_noc_0"];
                kinds.iter().all(|kind| has(stereo, kind, number))
            },
        );
        scene(
            "data_scene_flow_calib.zip",
            "their cameras",
            2_000_000,
            &|number| stereo.is_some_and(|stereo| stereo.calibration(number).is_some()),
        );
        if request.goal != Goal::Table31 {
            scene(
                "data_semantics.zip",
                "labels of the test images (table 3.2)",
                314_000_000,
                &|number| has(request.semantics.as_ref(), "semantic", number),
            );
        }
    }
    archives.extend(raw_archives(split, test_only, raw));

    let counted = counts(split);
    let test = counted.test as u64;
    let others = if test_only {
        0
    } else {
        (counted.train + counted.val) as u64
    };
    let threads = match request.threads {
        0 => std::thread::available_parallelism().map_or(1, usize::from),
        threads => threads,
    };
    let sample = measure(request.images, raw, stereo)?;
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
    let bytes_written = written(&request.out);
    Ok(Plan {
        split,
        test_only,
        command: request.goal.command(request.images.codec),
        archives,
        samples: test + others,
        bytes_to_write: bytes.saturating_sub(bytes_written),
        bytes_written,
        free_bytes: free_bytes(&request.out).ok(),
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
            url: format!("{DOWNLOADS}/raw_data/{0}/{0}_sync.zip", drive.id),
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
            url: format!("{DOWNLOADS}/raw_data/{date}_calib.zip"),
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
    layout::FOLDERS
        .iter()
        .map(|name| below(&out.join(name)))
        .sum()
}

/// Work and size of one image.
struct Sample {
    seconds: f64,
    small_bytes: u64,
    full_bytes: u64,
    source: String,
}

/// Decodes, resizes and encodes a few images as a preparation would.
fn measure(
    images: ImageOptions,
    raw: Option<&RawFolder>,
    stereo: Option<&SceneFolder>,
) -> Result<Sample> {
    let of_raw = raw.into_iter().flat_map(|raw| {
        drives()
            .iter()
            .flat_map(|drive| drive.frame_ids())
            .filter_map(|frame| raw.left(frame).cloned())
    });
    let scenes = stereo.into_iter().flat_map(|stereo| {
        (0..kitti2015_origin().len()).filter_map(|number| stereo.picture("image_2", number))
    });
    let mut originals = Vec::new();
    for source in of_raw.chain(scenes).take(MEASURED) {
        let bytes = source.read(Kind::Image)?;
        // A damaged frame is reported by `prep verify`; it only cannot be measured on.
        if image_files::decode_rgb(&bytes, "").is_ok() {
            originals.push(bytes);
        }
    }
    let source = match originals.len() {
        0 => {
            originals.push(image_files::encode_png_rgb(&pattern()));
            "a synthetic image of 1242x375, since no frame is there yet".to_owned()
        }
        1 => "one of your images".to_owned(),
        n => format!("{n} of your images"),
    };
    let (mut seconds, mut small, mut full) = (0.0, 0, 0);
    for bytes in &originals {
        let started = Instant::now();
        let image = image_files::decode_rgb(bytes, "the sample")?;
        let resized = resize::rgb(&image, images.width, images.height, images.kernel);
        let encoded = black_box(images.codec.encode(&resized));
        seconds += started.elapsed().as_secs_f64();
        small += encoded.len() as u64;
        full += bytes.len() as u64;
    }
    let count = originals.len() as u64;
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
    /// Whether the disk has no room for what is to be written.
    pub fn needs_space(&self) -> bool {
        self.free_bytes
            .is_some_and(|free| free < self.bytes_to_write)
    }

    /// Addresses of the archives that are not there, or not whole, one a line.
    pub fn urls(&self) -> String {
        let lacking = self.archives.iter().filter(|archive| !archive.is_there());
        lacking
            .map(|archive| format!("{}\n", archive.url))
            .collect()
    }

    /// The plan as a table with sentences; `out` is the folder of the set.
    pub fn text(&self, out: &Path) -> String {
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
                format!("about {}", human::bytes(archive.about_bytes)),
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
            "\nHave {there} of {} archives (about {}); about {} to download{}; zip archives need not be unpacked\n",
            there + missing,
            human::bytes(there_bytes),
            human::bytes(missing_bytes),
            if missing > 0 {
                ", whose addresses `--urls` prints"
            } else {
                ""
            }
        );
        text += &format!(
            "to be written  about {} for {} samples{}\n",
            human::bytes(self.bytes_to_write),
            self.samples,
            match self.bytes_written {
                0 => String::new(),
                bytes => format!("; {} are there of an earlier run", human::bytes(bytes)),
            }
        );
        match self.free_bytes {
            Some(free) => {
                text += &format!("free           {} at {}", human::bytes(free), out.display());
                text += if self.needs_space() {
                    ": NOT ENOUGH\n"
                } else {
                    "\n"
                };
            }
            None => text += "free           the system does not tell\n",
        }
        text += &format!(
            "time           about {} on {} threads, measured on {}\n",
            human::duration(self.seconds.max(1.0)),
            self.threads,
            self.measured_on
        );
        text += &format!("command        {}\n", self.command);
        text
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
        let urls: Vec<String> = raw_archives(Split::Eigen, true, None)
            .into_iter()
            .map(|archive| archive.url)
            .collect();
        assert_eq!(
            urls[0],
            "https://s3.eu-central-1.amazonaws.com/avg-kitti/raw_data/2011_09_26_drive_0002/\
             2011_09_26_drive_0002_sync.zip"
        );
        assert!(
            urls.last()
                .unwrap()
                .ends_with("avg-kitti/raw_data/2011_10_03_calib.zip")
        );
        let (count, size) = archives(Split::Eigen, true);
        assert_eq!(count, 28 + 5);
        assert!(
            (size - 175.0 * (42_382.0 - 23_488.0) / 42_382.0).abs() < 0.01,
            "{size}"
        );
    }
}
