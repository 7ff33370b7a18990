//! Makes the samples of KITTI's splits from the jobs of an inventory.
//!
//! What an earlier run finished is kept, unless its input was replaced since. A bad input file costs
//! its own sample only.

use std::path::Path;

use image::RgbImage;
use strat_geometry::{
    CamToCam, DepthAxis, NOMINAL_BASELINE_M, ScanDepth, depth_from_disparity_px, nominal_focal_px,
};
use strat_splits::{FrameId, Role, Split};
use strat_store::exr::DepthHeader;
use strat_store::image_files::{self, Codec};
use strat_store::raster::Plane;
use strat_store::resize::{self, Kernel};
use strat_store::set::{FORMAT, FileRef, Sample};

use crate::error::{Error, Result};
use crate::input::raw::{Day, RawFolder};
use crate::input::source::Source;
use crate::input::stereo2015::camera_by_size;
use crate::kitti::inventory::{Input, Inventory, Job};
use crate::set::shards::Shard;
use crate::set::space::{free_bytes, human_bytes};
pub use crate::set::writer::{FAILURES, Failure, Report, SETTINGS, Settings, check_output};
use crate::set::writer::{Made, Output, Piece, Run, Stop};

impl Settings {
    /// Settings of a set made from `raw`.
    pub fn new(
        split: Split,
        raw: &RawFolder,
        image_width: u32,
        image_height: u32,
        kernel: Kernel,
        codec: Codec,
    ) -> Self {
        let source = if raw.rendered { "rendered" } else { "kitti" };
        Self {
            format: FORMAT,
            content: split.into(),
            source: source.to_owned(),
            image_width,
            image_height,
            kernel,
            codec,
        }
    }
}

/// Bytes a pixel takes as PNG and as JPEG of quality 92, and a depth map takes; the least seen on
/// frames of KITTI, so that no run is refused that would fit.
const BYTES: (f64, f64, u64) = (1.5, 0.3, 100_000);

/// Bytes the jobs (of a shard) will write at least; of pairs whose left image is in `out` already,
/// none.
pub fn bytes_to_write(
    out: &Path,
    settings: &Settings,
    inventory: &Inventory,
    shard: Option<Shard>,
) -> u64 {
    let pixels = f64::from(settings.image_width) * f64::from(settings.image_height);
    let small = match settings.codec {
        Codec::Png => pixels * BYTES.0,
        Codec::Jpeg(quality) => pixels * BYTES.1 * f64::from(quality) / 92.0,
    };
    let mine = |job: &&Job| shard.is_none_or(|shard| shard.has(&job.id));
    let bytes = inventory.jobs.iter().filter(mine).map(|job| {
        let (place, stem) = job.id.split_once('/').unwrap_or(("", &job.id));
        let ending = settings.codec.ending();
        if out
            .join(format!("images/{place}/left/{stem}.{ending}"))
            .is_file()
        {
            return 0;
        }
        let more = match &job.input {
            Input::Raw { left, scan, .. } => {
                let full = if job.role == Role::Test {
                    left.len()
                } else {
                    0
                };
                full + 2 * BYTES.2 * u64::from(scan.is_some())
            }
            Input::Scene { left, right, .. } => left.len() + right.len() + BYTES.2,
        };
        2 * small as u64 + more
    });
    bytes.sum()
}

/// Makes sure that the disk has room for what is to be written.
///
/// # Errors
/// It has not; the message says how much is needed and free.
pub fn check_space(
    out: &Path,
    settings: &Settings,
    inventory: &Inventory,
    shard: Option<Shard>,
) -> Result<()> {
    // A file system that does not tell is no reason to refuse.
    let Ok(free) = free_bytes(out) else {
        return Ok(());
    };
    let needed = bytes_to_write(out, settings, inventory, shard);
    if needed <= free {
        return Ok(());
    }
    Err(Error::Space {
        path: out.to_owned(),
        needed: human_bytes(needed),
        free: human_bytes(free),
    })
}

/// Makes everything the inventory found possible and writes the set or the part of it.
///
/// # Errors
/// The output cannot be written. Bad inputs are no error here: see [`Report::failures`].
pub(crate) fn build(run: &Run<'_>, raw: &RawFolder, inventory: &Inventory) -> Result<Report> {
    // Archives and folders that cannot be read cost many samples at once, unless all of these are
    // there elsewhere.
    let broken = inventory.broken.iter().map(|(path, problem)| Failure {
        role: None,
        id: String::new(),
        file: path.display().to_string(),
        problem: problem.clone(),
    });
    let broken = match inventory.is_complete() {
        true => Vec::new(),
        false => broken.collect(),
    };
    let expected = inventory.counts.iter();
    let expected = expected.map(|(role, count)| (*role, count.expected));
    run.make(expected.collect(), &inventory.jobs, broken, |files, job| {
        let workshop = Workshop {
            files,
            settings: run.settings,
            raw,
        };
        workshop.make(job)
    })
}

struct Workshop<'a> {
    files: &'a Output<'a>,
    settings: &'a Settings,
    raw: &'a RawFolder,
}

/// The two versions of an image in the set, and its native size.
struct Picture {
    small: FileRef,
    full: Option<FileRef>,
    size: (u32, u32),
}

impl Workshop<'_> {
    fn make(&self, job: &Job) -> Result<Made> {
        let mut failures = Vec::new();
        let piece = match &job.input {
            Input::Raw {
                frame,
                left,
                right,
                scan,
                annotated,
            } => self.raw_pair(
                job,
                *frame,
                (left, right),
                scan.as_ref(),
                annotated.as_ref(),
                &mut failures,
            ),
            Input::Scene { .. } => self.scene(job),
        };
        match piece {
            Ok(sample) => Ok(Made { sample, failures }),
            Err(stop) => {
                failures.push(failure(job, stop)?);
                Ok(Made {
                    sample: None,
                    failures,
                })
            }
        }
    }

    fn raw_pair(
        &self,
        job: &Job,
        frame: FrameId,
        (left, right): (&Source, &Source),
        scan: Option<&Source>,
        annotated: Option<&Source>,
        failures: &mut Vec<Failure>,
    ) -> Piece<Option<Sample>> {
        let no_calibration = || Stop::input(left, "this recording day has no usable calibration");
        let day = self.raw.day(frame.drive.date).ok_or_else(no_calibration)?;
        let cameras = day.cameras.as_ref().map_err(|_| no_calibration())?;
        let (drive, stem) = (frame.drive.to_string(), frame.stem());
        let full = (job.role == Role::Test).then_some(Side::Left);
        let (left_picture, right_picture) = self.pair(&drive, &stem, left, right, full)?;
        if left_picture.size != (cameras.width, cameras.height) {
            let ((w, h), (cw, ch)) = (left_picture.size, (cameras.width, cameras.height));
            return Err(Stop::input(
                left,
                format!("{left} is {w}x{h}, but its calibration is for {cw}x{ch}"),
            ));
        }
        let mut depth = None;
        if let (Some(scan), Ok(projection)) = (scan, &day.projection) {
            match self.velodyne(&drive, &stem, scan, day, cameras, projection) {
                Ok(files) => depth = Some(files),
                // Worthless as a test sample without ground truth; still a good pair elsewhere.
                Err(stop) if job.role == Role::Test => return Err(stop),
                Err(stop) => failures.push(failure(job, stop).map_err(Stop::Output)?),
            }
        }
        let (depth_velodyne, depth_camera) = depth.unzip();
        let mut depth_annotated = None;
        if let Some(from) = annotated {
            match self.annotated(&drive, &stem, from, cameras) {
                Ok(file) => depth_annotated = Some(file),
                Err(stop) => failures.push(failure(job, stop).map_err(Stop::Output)?),
            }
        }
        Ok(Some(Sample {
            right: Some(right_picture.small),
            left_full: left_picture.full,
            right_full: right_picture.full,
            depth_velodyne,
            depth_camera,
            depth_annotated,
            ..Sample::new(
                &job.id,
                left_picture.size,
                cameras.focal_px(),
                cameras.baseline_m(),
                left_picture.small,
            )
        }))
    }

    fn scene(&self, job: &Job) -> Piece<Option<Sample>> {
        let Input::Scene {
            number,
            left,
            right,
            noc,
            occ,
            calibration,
            semantic,
            instance,
        } = &job.input
        else {
            return Ok(None);
        };
        let stem = format!("{number:06}");
        let (left_picture, right_picture) =
            self.pair("kitti2015", &stem, left, right, Some(Side::Both))?;
        let size = left_picture.size;
        let (focal_px, baseline_m) = match calibration {
            Some(path) => {
                let bytes = path.read().map_err(|e| Stop::input(path, e))?;
                let cameras = CamToCam::parse(&String::from_utf8_lossy(&bytes))
                    .map_err(|e| Stop::input(path, format!("{path}: {e}")))?;
                if (cameras.width, cameras.height) != size {
                    let (w, h) = size;
                    let problem = format!(
                        "{path} is for {}x{}, but the image is {w}x{h}",
                        cameras.width, cameras.height
                    );
                    return Err(Stop::input(path, problem));
                }
                (cameras.focal_px(), cameras.baseline_m())
            }
            None => camera_by_size(size.0, size.1).ok_or_else(|| {
                let (w, h) = size;
                Stop::input(
                    left,
                    format!("{left} is {w}x{h}, which is no KITTI size, and has no calibration"),
                )
            })?,
        };
        let disparity =
            |kind: &str, from: &Source| self.disparity(job, kind, &stem, from, size, focal_px);
        let label = |kind: &str, from: &Option<Source>, check: Check| {
            from.as_ref()
                .map(|from| self.label(kind, &stem, from, size, check))
                .transpose()
        };
        Ok(Some(Sample {
            right: Some(right_picture.small),
            left_full: left_picture.full,
            right_full: right_picture.full,
            depth_noc: Some(disparity("noc", noc)?),
            depth_occ: occ.as_ref().map(|occ| disparity("occ", occ)).transpose()?,
            semantic: label("semantic", semantic, |bytes, name| {
                image_files::decode_gray8(bytes, name).map(|(w, h, _)| (w, h))
            })?,
            instance: label("instance", instance, |bytes, name| {
                image_files::decode_gray16(bytes, name).map(|(w, h, _)| (w, h))
            })?,
            ..Sample::new(&job.id, size, focal_px, baseline_m, left_picture.small)
        }))
    }

    /// Both images of a pair, which must be of one size. `full` says which originals are kept.
    fn pair(
        &self,
        drive: &str,
        stem: &str,
        left: &Source,
        right: &Source,
        full: Option<Side>,
    ) -> Piece<(Picture, Picture)> {
        let left_picture = self.picture(drive, stem, "left", left, full.is_some())?;
        let right_picture = self.picture(drive, stem, "right", right, full == Some(Side::Both))?;
        if left_picture.size != right_picture.size {
            let ((w, h), (rw, rh)) = (left_picture.size, right_picture.size);
            return Err(Stop::input(
                right,
                format!("{right} is {rw}x{rh}, but its left image is {w}x{h}"),
            ));
        }
        Ok((left_picture, right_picture))
    }

    fn picture(
        &self,
        drive: &str,
        stem: &str,
        side: &str,
        from: &Source,
        keep_full: bool,
    ) -> Piece<Picture> {
        let small = format!(
            "images/{drive}/{side}/{stem}.{}",
            self.settings.codec.ending()
        );
        let full = keep_full.then(|| format!("full/{drive}/{side}/{stem}.{}", from.ending()));
        let changed = from.changed();
        let kept_small = self.files.kept(&small, changed)?;
        let kept_full = full
            .as_deref()
            .map(|path| self.files.kept(path, changed))
            .transpose()?
            .flatten();
        if let Some(small) = &kept_small
            && kept_full.is_some() == full.is_some()
        {
            let size = match from {
                Source::File(path) => image_files::read_size(path),
                Source::Entry(_) => from
                    .read()
                    .and_then(|bytes| image_files::decode_size(&bytes, &from.to_string())),
            };
            let size = size.map_err(|e| Stop::input(from, e))?;
            return Ok(Picture {
                small: small.clone(),
                full: kept_full,
                size,
            });
        }
        let bytes = from.read().map_err(|e| Stop::input(from, e))?;
        let image =
            image_files::decode_rgb(&bytes, &from.to_string()).map_err(|e| Stop::input(from, e))?;
        let small = match kept_small {
            Some(small) => small,
            None => self.files.put(small, &self.network_size(&image))?,
        };
        let full = match (kept_full, full) {
            (None, Some(path)) => Some(self.files.put(path, &bytes)?),
            (kept, _) => kept,
        };
        Ok(Picture {
            small,
            full,
            size: image.dimensions(),
        })
    }

    fn network_size(&self, image: &RgbImage) -> Vec<u8> {
        let Settings {
            image_width,
            image_height,
            kernel,
            codec,
            ..
        } = *self.settings;
        codec.encode(&resize::rgb(image, image_width, image_height, kernel))
    }

    /// Ground truth of a scan: along the scanner's axis and along the camera's.
    fn velodyne(
        &self,
        drive: &str,
        stem: &str,
        scan: &Source,
        day: &Day,
        cameras: &CamToCam,
        projection: &[[f64; 4]; 3],
    ) -> Piece<(FileRef, FileRef)> {
        let [velodyne, camera] =
            ["velodyne", "camera"].map(|kind| format!("depth/{kind}/{drive}/{stem}.exr"));
        // It depends on the calibration as much as on the scan.
        let changed = scan.changed().max(day.changed);
        let kept = (
            self.files.kept(&velodyne, changed)?,
            self.files.kept(&camera, changed)?,
        );
        if let (Some(velodyne), Some(camera)) = kept {
            return Ok((velodyne, camera));
        }
        let (width, height) = (cameras.width as usize, cameras.height as usize);
        let axes = [DepthAxis::VelodyneX, DepthAxis::CameraZ];
        let mut depth = ScanDepth::new(projection, width, height, axes);
        scan.read_in_pieces(|bytes| depth.add(bytes))
            .map_err(|e| Stop::input(scan, e))?;
        let depth = depth
            .finish()
            .map_err(|e| Stop::input(scan, format!("{scan}: {e}")))?;
        let [along_scanner, along_camera] = depth.map(|data| Plane {
            width,
            height,
            data,
        });
        let header = |axis: &str| DepthHeader {
            source: "velodyne".to_owned(),
            axis: axis.to_owned(),
            focal_px: cameras.focal_px(),
            baseline_m: cameras.baseline_m(),
            frame: format!("{drive}/{stem}"),
        };
        if along_scanner.data.iter().all(|depth_m| *depth_m == 0.0) {
            return Err(Stop::input(
                scan,
                format!("{scan}: no point of the scan falls into the image"),
            ));
        }
        Ok((
            self.files
                .put_depth(velodyne, &along_scanner, &header("velodyne-x"))?,
            self.files
                .put_depth(camera, &along_camera, &header("camera-z"))?,
        ))
    }

    /// Annotated depth of KITTI depth: 16-bit metres times 256, 0 where nothing is known.
    fn annotated(
        &self,
        drive: &str,
        stem: &str,
        from: &Source,
        cameras: &CamToCam,
    ) -> Piece<FileRef> {
        let path = format!("depth/annotated/{drive}/{stem}.exr");
        if let Some(kept) = self.files.kept(&path, from.changed())? {
            return Ok(kept);
        }
        let (width, height, raw) = self.gray16(from, (cameras.width, cameras.height))?;
        let header = DepthHeader {
            source: "kitti-depth/groundtruth".to_owned(),
            axis: "camera-z".to_owned(),
            focal_px: cameras.focal_px(),
            baseline_m: cameras.baseline_m(),
            frame: format!("{drive}/{stem}"),
        };
        let depth_m = raw.iter().map(|value| f32::from(*value) / 256.0);
        self.files.put_depth(
            path,
            &Plane {
                width,
                height,
                data: depth_m.collect(),
            },
            &header,
        )
    }

    /// A 16-bit map of the size of its image with at least one measurement.
    fn gray16(&self, from: &Source, size: (u32, u32)) -> Piece<(usize, usize, Vec<u16>)> {
        let bytes = from.read().map_err(|e| Stop::input(from, e))?;
        let (width, height, raw) = image_files::decode_gray16(&bytes, &from.to_string())
            .map_err(|e| Stop::input(from, e))?;
        same_size(from, (width, height), size)?;
        if raw.iter().all(|value| *value == 0) {
            return Err(Stop::input(from, format!("{from} has no measured pixel")));
        }
        Ok((width, height, raw))
    }

    /// Ground truth of a stereo 2015 disparity map, in metres of the nominal rig (PROTOCOL 3.4).
    fn disparity(
        &self,
        job: &Job,
        kind: &str,
        stem: &str,
        from: &Source,
        size: (u32, u32),
        focal_px: f64,
    ) -> Piece<FileRef> {
        let path = format!("depth/{kind}/kitti2015/{stem}.exr");
        if let Some(kept) = self.files.kept(&path, from.changed())? {
            return Ok(kept);
        }
        let (width, height, raw) = self.gray16(from, size)?;
        let focal_px = nominal_focal_px(size.0).unwrap_or(focal_px);
        // Disparity is stored times 256; 0 means no measurement.
        let depth_m = raw.iter().map(|value| match value {
            0 => 0.0,
            value => {
                depth_from_disparity_px(focal_px, NOMINAL_BASELINE_M, f64::from(*value) / 256.0)
                    as f32
            }
        });
        let header = DepthHeader {
            source: format!("kitti2015/disp_{kind}_0"),
            axis: "camera-z".to_owned(),
            focal_px,
            baseline_m: NOMINAL_BASELINE_M,
            frame: job.id.clone(),
        };
        self.files.put_depth(
            path,
            &Plane {
                width,
                height,
                data: depth_m.collect(),
            },
            &header,
        )
    }

    /// A label image, copied as it is after a look at it.
    fn label(
        &self,
        kind: &str,
        stem: &str,
        from: &Source,
        size: (u32, u32),
        check: Check,
    ) -> Piece<FileRef> {
        let path = format!("labels/{kind}/kitti2015/{stem}.png");
        if let Some(kept) = self.files.kept(&path, from.changed())? {
            return Ok(kept);
        }
        let bytes = from.read().map_err(|e| Stop::input(from, e))?;
        let found = check(&bytes, &from.to_string()).map_err(|e| Stop::input(from, e))?;
        same_size(from, found, size)?;
        self.files.put(path, &bytes)
    }
}

/// Which originals of a pair are kept.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Side {
    Left,
    Both,
}

/// Width and height of a label image, after a look at its bytes; the name is for messages.
type Check = fn(&[u8], &str) -> strat_store::Result<(usize, usize)>;

fn same_size(file: &Source, found: (usize, usize), image: (u32, u32)) -> Piece<()> {
    if found == (image.0 as usize, image.1 as usize) {
        return Ok(());
    }
    let ((w, h), (iw, ih)) = (found, image);
    Err(Stop::input(
        file,
        format!("{file} is {w}x{h}, but its left image is {iw}x{ih}"),
    ))
}

fn failure(job: &Job, stop: Stop) -> Result<Failure> {
    stop.failure(job.role, &job.id)
}

#[cfg(test)]
mod tests {
    use strat_store::files;
    use strat_store::set::Content;

    use super::*;

    #[test]
    fn a_set_that_cannot_fit_is_not_begun() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path();
        let job = |index| {
            let drive = strat_splits::drives()[0].id;
            let source = Source::File(out.join("no file"));
            Job {
                role: Role::Train,
                id: FrameId { drive, index }.to_string(),
                input: Input::Raw {
                    frame: FrameId { drive, index },
                    left: source.clone(),
                    right: source,
                    scan: None,
                    annotated: None,
                },
            }
        };
        let mut inventory = Inventory::default();
        inventory.jobs.extend((0..1000).map(job));
        let mut settings = Settings {
            format: FORMAT,
            content: Content::Kitti,
            source: "kitti".to_owned(),
            image_width: 512,
            image_height: 256,
            kernel: Kernel::Area,
            codec: Codec::Png,
        };
        let png = bytes_to_write(out, &settings, &inventory, None);
        assert_eq!(png, 1000 * 2 * 196_608, "1.5 bytes a pixel");
        let first = &inventory.jobs[0].id;
        files::write_atomic(
            &out.join(format!("images/{}.png", first.replace('/', "/left/"))),
            b"",
        )
        .unwrap();
        let rest = bytes_to_write(out, &settings, &inventory, None);
        assert_eq!(rest, 999 * 2 * 196_608, "what is there needs no room");
        settings.codec = Codec::Jpeg(92);
        let jpeg = bytes_to_write(out, &settings, &inventory, None);
        assert!(jpeg < png / 4, "{jpeg}");

        (settings.image_width, settings.image_height) = (1_000_000, 1_000_000);
        let error = check_space(out, &settings, &inventory, None).unwrap_err();
        assert_eq!(error.exit_code(), 1);
        let text = error.to_string();
        assert!(text.contains("about 600.0 TB will be written"), "{text}");
    }
}
