//! Turns the jobs of an inventory into a prepared set.
//!
//! Jobs run on many threads and share nothing; the tables are written at the end in the
//! order of the split, so the result does not depend on the number of threads. What an
//! earlier run finished is kept. A bad input file costs its own sample only.

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use image::RgbImage;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use strat_geometry::{
    CamToCam, DepthAxis, NOMINAL_BASELINE_M, depth_from_disparity_px, nominal_focal_px,
    parse_velodyne, velodyne_depth,
};
use strat_splits::{FrameId, Role, Split};
use strat_store::exr::{DepthHeader, encode_depth};
use strat_store::progress::Progress;
use strat_store::raster::Plane;
use strat_store::resize::{self, Kernel};
use strat_store::set::{
    CameraEntry, Content, Count, FORMAT, FileRef, Manifest, PreparedSet, Sample,
};
use strat_store::{files, image_files, yaml};

use crate::error::{Error, Result};
use crate::inventory::{Input, Inventory, Job};
use crate::raw::RawFolder;
use crate::stereo2015::camera_by_size;

/// File that marks a folder as the output of a preparation, finished or not.
pub const SETTINGS: &str = "settings.yaml";

/// File that lists inputs which could not be used.
pub const FAILURES: &str = "failures.csv";

/// Failures told one by one on stderr; the rest is in [`FAILURES`].
const FAILURES_SHOWN: u64 = 20;

/// What every file of a set depends on. Sets of different settings do not mix.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Version of the layout.
    pub format: u32,
    /// The split.
    pub split: Split,
    /// `kitti` or `rendered`.
    pub source: String,
    /// Width in pixels of the network-size images.
    pub image_width: u32,
    /// Height in pixels of the network-size images.
    pub image_height: u32,
    /// How they are made.
    pub kernel: Kernel,
}

impl Settings {
    /// Settings of a set made from `raw`.
    pub fn new(
        split: Split,
        raw: &RawFolder,
        image_width: u32,
        image_height: u32,
        kernel: Kernel,
    ) -> Self {
        let source = if raw.rendered { "rendered" } else { "kitti" };
        Self {
            format: FORMAT,
            split,
            source: source.to_owned(),
            image_width,
            image_height,
            kernel,
        }
    }
}

/// An input that could not be used.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Failure {
    /// Role of its sample.
    pub role: Role,
    /// Name of its sample.
    pub id: String,
    /// The file.
    pub file: String,
    /// What is wrong with it.
    pub problem: String,
}

/// What a preparation did.
#[derive(Debug)]
pub struct Report {
    /// The finished set.
    pub set: PreparedSet,
    /// What could not be used.
    pub failures: Vec<Failure>,
    /// Files written by this run.
    pub written: u64,
    /// Files an earlier run had written.
    pub kept: u64,
}

/// Makes sure that `out` is new, empty or an earlier state of the same set, and lies in no input folder.
///
/// # Errors
/// It is something else; the message says what and what to do.
pub fn check_output(out: &Path, inputs: &[&Path], settings: &Settings) -> Result<()> {
    let wrong = |problem: String| Error::Output {
        path: out.to_owned(),
        problem,
    };
    let resolved = |path: &Path| {
        // The nearest ancestor that exists tells where a folder still to be made will be.
        path.ancestors()
            .filter(|a| !a.as_os_str().is_empty())
            .find_map(|a| a.canonicalize().ok())
    };
    for input in inputs {
        if let (Some(out), Ok(input)) = (resolved(out), input.canonicalize())
            && out.starts_with(&input)
        {
            return Err(wrong(format!(
                "this lies inside the input folder {}, which is never written to; give another folder",
                input.display()
            )));
        }
    }
    if out.is_file() {
        return Err(wrong("this is a file; give a folder".to_owned()));
    }
    let path = out.join(SETTINGS);
    if !path.is_file() {
        if std::fs::read_dir(out).is_ok_and(|mut entries| entries.next().is_some()) {
            return Err(wrong(
                "this folder holds other things and no prepared set; give a new or an empty folder"
                    .to_owned(),
            ));
        }
        return Ok(());
    }
    let there: Settings = yaml::load(&path)?;
    if there.split != settings.split {
        return Err(wrong(format!(
            "this folder holds the {} split. The test images of one split are training images of the other, \
             so a folder with both would leak them into training; give another folder for the {} split",
            there.split, settings.split
        )));
    }
    if there != *settings {
        let state = |s: &Settings| {
            format!(
                "{} data at {}x{} by `{}` (format {})",
                s.source, s.image_width, s.image_height, s.kernel, s.format
            )
        };
        return Err(wrong(format!(
            "this folder holds {}, not {}; give another folder or the same options",
            state(&there),
            state(settings)
        )));
    }
    Ok(())
}

/// Makes everything the inventory found possible and writes the set.
///
/// # Errors
/// The output cannot be written. Bad inputs are no error here: see [`Report::failures`].
pub fn build(
    out: &Path,
    settings: &Settings,
    raw: &RawFolder,
    inventory: &Inventory,
    jobs: Option<usize>,
    quiet: bool,
) -> Result<Report> {
    files::check_writable(out)?;
    files::write_atomic(&out.join(SETTINGS), yaml::to_string(settings)?.as_bytes())?;

    let workshop = Workshop {
        out,
        settings,
        raw,
        known: known_hashes(out),
        written: 0.into(),
        kept: 0.into(),
    };
    let label = format!("prep {}", settings.split);
    let progress = Progress::new(&label, inventory.jobs.len() as u64, "pairs", quiet);
    let told = AtomicU64::new(0);
    let threads = jobs.unwrap_or(0);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    let pool = pool.map_err(|e| Error::Threads {
        jobs: threads,
        reason: e.to_string(),
    })?;
    let made: Vec<Made> = pool.install(|| {
        let work = inventory.jobs.par_iter().map(|job| {
            let made = workshop.make(job)?;
            for failure in &made.failures {
                if told.fetch_add(1, Ordering::Relaxed) < FAILURES_SHOWN {
                    progress.println(&format!(
                        "{} {} skipped: {}",
                        failure.role, failure.id, failure.problem
                    ));
                }
            }
            progress.add(1);
            Ok::<_, Error>(made)
        });
        work.collect::<Result<_>>()
    })?;
    progress.finish();

    let mut samples: BTreeMap<Role, Vec<Sample>> = BTreeMap::new();
    let mut cameras: Vec<CameraEntry> = Vec::new();
    let mut failures = Vec::new();
    for (job, made) in inventory.jobs.iter().zip(made) {
        failures.extend(made.failures);
        let Some(sample) = made.sample else { continue };
        let camera = camera_entry(job, &sample);
        if !cameras.contains(&camera) {
            cameras.push(camera);
        }
        samples.entry(job.role).or_default().push(sample);
    }
    cameras.sort_by(|a, b| {
        a.name
            .cmp(&b.name)
            .then(a.width.cmp(&b.width))
            .then(a.focal_px.total_cmp(&b.focal_px))
    });
    let counts = inventory.counts.iter().map(|(role, count)| {
        let found = samples.get(role).map_or(0, Vec::len) as u64;
        (
            *role,
            Count {
                expected: count.expected,
                found,
            },
        )
    });
    let manifest = Manifest {
        format: FORMAT,
        content: Content::from(settings.split),
        split_digest: Some(strat_splits::digest(settings.split)),
        source: settings.source.clone(),
        image_width: settings.image_width,
        image_height: settings.image_height,
        kernel: settings.kernel,
        codec: "png".to_owned(),
        counts: counts.collect(),
        failures: failures.len() as u64,
        cameras,
        tool_version: env!("CARGO_PKG_VERSION").to_owned(),
        data_digest: String::new(),
    };
    write_failures(out, &failures)?;
    let set = PreparedSet::write(out, manifest, &samples)?;
    Ok(Report {
        set,
        failures,
        written: workshop.written.into_inner(),
        kept: workshop.kept.into_inner(),
    })
}

struct Made {
    sample: Option<Sample>,
    failures: Vec<Failure>,
}

/// Why a piece of a sample is not there: a bad input, or an output that cannot be written,
/// which ends everything.
enum Stop {
    Input { file: PathBuf, problem: String },
    Output(Error),
}

impl Stop {
    fn input(file: &Path, problem: impl ToString) -> Self {
        Self::Input {
            file: file.to_owned(),
            problem: problem.to_string(),
        }
    }
}

type Piece<T> = std::result::Result<T, Stop>;

struct Workshop<'a> {
    out: &'a Path,
    settings: &'a Settings,
    raw: &'a RawFolder,
    /// Hashes stated by the tables of an earlier finished run.
    known: HashMap<String, String>,
    written: AtomicU64,
    kept: AtomicU64,
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
            } => self.raw_pair(job, *frame, left, right, scan.as_deref(), &mut failures),
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
        left: &Path,
        right: &Path,
        scan: Option<&Path>,
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
                format!(
                    "{} is {w}x{h}, but its calibration is for {cw}x{ch}",
                    left.display()
                ),
            ));
        }
        let mut depth = None;
        if let (Some(scan), Ok(projection)) = (scan, &day.projection) {
            match self.velodyne(&drive, &stem, scan, cameras, projection) {
                Ok(files) => depth = Some(files),
                // Worthless as a test sample without ground truth; still a good pair elsewhere.
                Err(stop) if job.role == Role::Test => return Err(stop),
                Err(stop) => failures.push(failure(job, stop).map_err(Stop::Output)?),
            }
        }
        let (depth_velodyne, depth_camera) = depth.unzip();
        Ok(Some(Sample {
            right: Some(right_picture.small),
            left_full: left_picture.full,
            right_full: right_picture.full,
            depth_velodyne,
            depth_camera,
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
                let bytes = files::read(path).map_err(|e| Stop::input(path, e))?;
                let cameras = CamToCam::parse(&String::from_utf8_lossy(&bytes))
                    .map_err(|e| Stop::input(path, format!("{}: {e}", path.display())))?;
                if (cameras.width, cameras.height) != size {
                    let (w, h) = size;
                    let problem = format!(
                        "{} is for {}x{}, but the image is {w}x{h}",
                        path.display(),
                        cameras.width,
                        cameras.height
                    );
                    return Err(Stop::input(path, problem));
                }
                (cameras.focal_px(), cameras.baseline_m())
            }
            None => camera_by_size(size.0, size.1).ok_or_else(|| {
                let (w, h) = size;
                Stop::input(
                    left,
                    format!(
                        "{} is {w}x{h}, which is no KITTI size, and has no calibration",
                        left.display()
                    ),
                )
            })?,
        };
        let disparity =
            |kind: &str, from: &Path| self.disparity(job, kind, &stem, from, size, focal_px);
        let label = |kind: &str,
                     from: &Option<PathBuf>,
                     check: fn(&Path) -> strat_store::Result<(usize, usize)>| {
            from.as_deref()
                .map(|from| self.label(kind, &stem, from, size, check))
                .transpose()
        };
        Ok(Some(Sample {
            right: Some(right_picture.small),
            left_full: left_picture.full,
            right_full: right_picture.full,
            depth_noc: Some(disparity("noc", noc)?),
            depth_occ: occ
                .as_deref()
                .map(|occ| disparity("occ", occ))
                .transpose()?,
            semantic: label("semantic", semantic, |path| {
                image_files::read_gray8(path).map(|(w, h, _)| (w, h))
            })?,
            instance: label("instance", instance, |path| {
                image_files::read_gray16(path).map(|(w, h, _)| (w, h))
            })?,
            ..Sample::new(&job.id, size, focal_px, baseline_m, left_picture.small)
        }))
    }

    /// Both images of a pair, which must be of one size. `full` says which originals are kept.
    fn pair(
        &self,
        drive: &str,
        stem: &str,
        left: &Path,
        right: &Path,
        full: Option<Side>,
    ) -> Piece<(Picture, Picture)> {
        let left_picture = self.picture(drive, stem, "left", left, full.is_some())?;
        let right_picture = self.picture(drive, stem, "right", right, full == Some(Side::Both))?;
        if left_picture.size != right_picture.size {
            let ((w, h), (rw, rh)) = (left_picture.size, right_picture.size);
            return Err(Stop::input(
                right,
                format!(
                    "{} is {rw}x{rh}, but its left image is {w}x{h}",
                    right.display()
                ),
            ));
        }
        Ok((left_picture, right_picture))
    }

    fn picture(
        &self,
        drive: &str,
        stem: &str,
        side: &str,
        from: &Path,
        keep_full: bool,
    ) -> Piece<Picture> {
        let small = format!("images/{drive}/{side}/{stem}.png");
        let ending = from
            .extension()
            .map_or_else(String::new, |e| e.to_string_lossy().into_owned());
        let full = keep_full.then(|| format!("full/{drive}/{side}/{stem}.{ending}"));
        let kept_small = self.kept(&small)?;
        let kept_full = full
            .as_deref()
            .map(|path| self.kept(path))
            .transpose()?
            .flatten();
        if let Some(small) = &kept_small
            && kept_full.is_some() == full.is_some()
        {
            let size = image_files::read_size(from).map_err(|e| Stop::input(from, e))?;
            return Ok(Picture {
                small: small.clone(),
                full: kept_full,
                size,
            });
        }
        let bytes = files::read(from).map_err(|e| Stop::input(from, e))?;
        let image = image_files::decode_rgb(&bytes, &from.display().to_string())
            .map_err(|e| Stop::input(from, e))?;
        let small = match kept_small {
            Some(small) => small,
            None => self.put(small, &self.network_size(&image))?,
        };
        let full = match (kept_full, full) {
            (None, Some(path)) => Some(self.put(path, &bytes)?),
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
            ..
        } = *self.settings;
        image_files::encode_png_rgb(&resize::rgb(image, image_width, image_height, kernel))
    }

    /// Ground truth of a scan: along the scanner's axis and along the camera's.
    fn velodyne(
        &self,
        drive: &str,
        stem: &str,
        scan: &Path,
        cameras: &CamToCam,
        projection: &[[f64; 4]; 3],
    ) -> Piece<(FileRef, FileRef)> {
        let [velodyne, camera] =
            ["velodyne", "camera"].map(|kind| format!("depth/{kind}/{drive}/{stem}.exr"));
        if let (Some(velodyne), Some(camera)) = (self.kept(&velodyne)?, self.kept(&camera)?) {
            return Ok((velodyne, camera));
        }
        let bytes = files::read(scan).map_err(|e| Stop::input(scan, e))?;
        let points = parse_velodyne(&bytes)
            .map_err(|e| Stop::input(scan, format!("{}: {e}", scan.display())))?;
        let (width, height) = (cameras.width as usize, cameras.height as usize);
        let depth = |axis| Plane {
            width,
            height,
            data: velodyne_depth(&points, projection, width, height, axis),
        };
        let header = |axis: &str| DepthHeader {
            source: "velodyne".to_owned(),
            axis: axis.to_owned(),
            focal_px: cameras.focal_px(),
            baseline_m: cameras.baseline_m(),
            frame: format!("{drive}/{stem}"),
        };
        let along_scanner = depth(DepthAxis::VelodyneX);
        if along_scanner.data.iter().all(|depth_m| *depth_m == 0.0) {
            return Err(Stop::input(
                scan,
                format!(
                    "{}: no point of the scan falls into the image",
                    scan.display()
                ),
            ));
        }
        Ok((
            self.put_depth(velodyne, &along_scanner, &header("velodyne-x"))?,
            self.put_depth(camera, &depth(DepthAxis::CameraZ), &header("camera-z"))?,
        ))
    }

    /// Ground truth of a stereo 2015 disparity map, in metres of the nominal rig (PROTOCOL 3.4).
    fn disparity(
        &self,
        job: &Job,
        kind: &str,
        stem: &str,
        from: &Path,
        size: (u32, u32),
        focal_px: f64,
    ) -> Piece<FileRef> {
        let path = format!("depth/{kind}/kitti2015/{stem}.exr");
        if let Some(kept) = self.kept(&path)? {
            return Ok(kept);
        }
        let (width, height, raw) =
            image_files::read_gray16(from).map_err(|e| Stop::input(from, e))?;
        same_size(from, (width, height), size)?;
        if raw.iter().all(|value| *value == 0) {
            return Err(Stop::input(
                from,
                format!("{} has no measured pixel", from.display()),
            ));
        }
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
        self.put_depth(
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
        from: &Path,
        size: (u32, u32),
        check: fn(&Path) -> strat_store::Result<(usize, usize)>,
    ) -> Piece<FileRef> {
        let path = format!("labels/{kind}/kitti2015/{stem}.png");
        if let Some(kept) = self.kept(&path)? {
            return Ok(kept);
        }
        same_size(from, check(from).map_err(|e| Stop::input(from, e))?, size)?;
        self.put(path, &files::read(from).map_err(|e| Stop::input(from, e))?)
    }

    /// A file of an earlier run. Files appear whole, so its being there is enough, unless a
    /// finished table knows it with another content.
    fn kept(&self, path: &str) -> Piece<Option<FileRef>> {
        let place = self.out.join(path);
        if !place.is_file() {
            return Ok(None);
        }
        let blake3 = files::blake3_file(&place).map_err(|e| Stop::Output(e.into()))?;
        if self.known.get(path).is_some_and(|known| *known != blake3) {
            return Ok(None);
        }
        self.kept.fetch_add(1, Ordering::Relaxed);
        Ok(Some(FileRef {
            path: path.to_owned(),
            blake3,
        }))
    }

    fn put(&self, path: String, bytes: &[u8]) -> Piece<FileRef> {
        files::write_atomic(&self.out.join(&path), bytes).map_err(|e| Stop::Output(e.into()))?;
        self.written.fetch_add(1, Ordering::Relaxed);
        Ok(FileRef {
            blake3: files::blake3_hex(bytes),
            path,
        })
    }

    fn put_depth(&self, path: String, depth_m: &Plane, header: &DepthHeader) -> Piece<FileRef> {
        let bytes = encode_depth(depth_m, header).map_err(|e| Stop::Output(e.into()))?;
        self.put(path, &bytes)
    }
}

/// Which originals of a pair are kept.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Side {
    Left,
    Both,
}

fn same_size(file: &Path, found: (usize, usize), image: (u32, u32)) -> Piece<()> {
    if found == (image.0 as usize, image.1 as usize) {
        return Ok(());
    }
    let ((w, h), (iw, ih)) = (found, image);
    Err(Stop::input(
        file,
        format!(
            "{} is {w}x{h}, but its left image is {iw}x{ih}",
            file.display()
        ),
    ))
}

fn failure(job: &Job, stop: Stop) -> Result<Failure> {
    match stop {
        Stop::Input { file, problem } => Ok(Failure {
            role: job.role,
            id: job.id.clone(),
            file: file.display().to_string(),
            problem,
        }),
        Stop::Output(error) => Err(error),
    }
}

fn camera_entry(job: &Job, sample: &Sample) -> CameraEntry {
    let name = match &job.input {
        Input::Raw { frame, .. } => frame.drive.date.to_string(),
        Input::Scene { .. } => "kitti2015".to_owned(),
    };
    let Sample {
        width,
        height,
        focal_px,
        baseline_m,
        ..
    } = *sample;
    CameraEntry {
        name,
        width,
        height,
        focal_px,
        baseline_m,
    }
}

/// Hashes by path, from the tables of an earlier finished run; empty if there is none.
fn known_hashes(out: &Path) -> HashMap<String, String> {
    let Ok(set) = PreparedSet::open(out) else {
        return HashMap::new();
    };
    let samples = Role::ALL
        .into_iter()
        .filter_map(|role| set.samples(role).ok())
        .flatten();
    samples
        .flat_map(|sample| {
            let files = sample.files();
            files
                .map(|(_, file)| (file.path.clone(), file.blake3.clone()))
                .collect::<Vec<_>>()
        })
        .collect()
}

/// Writes the list of failures, or removes that of an earlier run if there are none.
fn write_failures(out: &Path, failures: &[Failure]) -> Result<()> {
    let path = out.join(FAILURES);
    if failures.is_empty() {
        return match std::fs::remove_file(&path) {
            Err(e) if e.kind() != std::io::ErrorKind::NotFound => Err(Error::Output {
                path: out.to_owned(),
                problem: format!("the outdated {FAILURES} cannot be removed: {e}"),
            }),
            _ => Ok(()),
        };
    }
    files::write_atomic_with(&path, |file| {
        let mut table = csv::Writer::from_writer(file);
        for failure in failures {
            table.serialize(failure).map_err(std::io::Error::other)?;
        }
        table.flush()
    })?;
    Ok(())
}
