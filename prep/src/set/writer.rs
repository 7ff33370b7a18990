//! The making of a set, whatever it is made of: whether its folder may be written to, its frames on
//! many threads or in parts, the files that are there and those that are added, and what could not
//! be used.
//!
//! A frame is made by the module of its collection ([`crate::kitti::samples`] for KITTI, else
//! [`crate::collections`] and its users); a bad input costs its own frame only.

use std::collections::{BTreeMap, HashMap};
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::SystemTime;

use rayon::prelude::*;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use strat_splits::{DriveId, Role};
use strat_store::exr::{DepthHeader, encode_depth};
use strat_store::image_files::Codec;
use strat_store::progress::Progress;
use strat_store::raster::Plane;
use strat_store::resize::Kernel;
use strat_store::set::{
    CameraEntry, Content, Count, FORMAT, FileRef, Manifest, PreparedSet, Sample,
};
use strat_store::{files, yaml};

use crate::error::{Error, Result};
use crate::set::shards::{self as merge, Shard};

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
    /// What it is made of; `split` in the files of earlier versions.
    #[serde(alias = "split")]
    pub content: Content,
    /// `kitti` or `rendered`; of other collections, their name.
    pub source: String,
    /// Width in pixels of the network-size images.
    pub image_width: u32,
    /// Height in pixels of the network-size images.
    pub image_height: u32,
    /// How they are made.
    pub kernel: Kernel,
    /// How they are stored: `png` or `jpeg-92`.
    #[serde(serialize_with = "as_text", deserialize_with = "from_text")]
    pub codec: Codec,
}

fn as_text<S: Serializer>(codec: &Codec, to: S) -> std::result::Result<S::Ok, S::Error> {
    to.collect_str(codec)
}

fn from_text<'de, D: Deserializer<'de>>(from: D) -> std::result::Result<Codec, D::Error> {
    let text = String::deserialize(from)?;
    text.parse().map_err(serde::de::Error::custom)
}

/// A frame to be made.
#[derive(Debug)]
pub struct Frame<T> {
    /// What it is for.
    pub role: Role,
    /// Name of its sample.
    pub id: String,
    /// What it is made of.
    pub input: T,
}

/// What a preparation did.
#[derive(Debug)]
pub struct Report {
    /// The finished set, or part of one.
    pub set: PreparedSet,
    /// What could not be used.
    pub failures: Vec<Failure>,
    /// Files written by this run.
    pub written: u64,
    /// Files an earlier run had written.
    pub kept: u64,
}

/// An input that could not be used.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Failure {
    /// Role of its sample; none where it is an archive or folder of many.
    pub role: Option<Role>,
    /// Name of its sample, else empty.
    pub id: String,
    /// The file.
    pub file: String,
    /// What is wrong with it.
    pub problem: String,
}

/// Why a piece of a sample is not there: a bad input, or an output that cannot be written,
/// which ends everything.
pub(crate) enum Stop {
    Input { file: String, problem: String },
    Output(Error),
}

pub(crate) type Piece<T> = std::result::Result<T, Stop>;

impl Stop {
    /// A bad input by its name.
    pub fn input(file: impl ToString, problem: impl ToString) -> Self {
        Self::Input {
            file: file.to_string(),
            problem: problem.to_string(),
        }
    }

    /// A bad input that is a file of a folder.
    pub fn path(file: &Path, problem: impl ToString) -> Self {
        Self::input(file.display(), problem)
    }

    /// The same, of a problem that does not yet name it.
    pub fn about(file: &Path, problem: impl std::fmt::Display) -> Self {
        Self::path(file, format!("{}: {problem}", file.display()))
    }

    /// What it costs the sample `id`.
    ///
    /// # Errors
    /// It is an output that cannot be written.
    pub fn failure(self, role: Role, id: &str) -> Result<Failure> {
        match self {
            Self::Input { file, problem } => Ok(Failure {
                role: Some(role),
                id: id.to_owned(),
                file,
                problem,
            }),
            Self::Output(error) => Err(error),
        }
    }
}

/// As many threads as asked for, or one for each core.
pub(crate) fn threads(jobs: Option<usize>) -> Result<rayon::ThreadPool> {
    let jobs = jobs.unwrap_or(0);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(jobs).build();
    pool.map_err(|e| Error::Threads {
        jobs,
        reason: e.to_string(),
    })
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
    if !holds_a_set(out, inputs)? {
        return Ok(());
    }
    let there: Settings = yaml::load(&out.join(SETTINGS))?;
    if let (Some(there), Some(split)) = (there.content.split(), settings.content.split())
        && there != split
    {
        return Err(wrong(format!(
            "this folder holds the {there} split. The test images of one split are training images of the other, \
             so a folder with both would leak them into training; give another folder for the {split} split"
        )));
    }
    if there != *settings {
        let state = |s: &Settings| {
            let data = match s.content.split() {
                Some(_) => s.source.clone(),
                None => s.content.to_string(),
            };
            format!(
                "{data} data at {}x{} by `{}` as {} (format {})",
                s.image_width, s.image_height, s.kernel, s.codec, s.format
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

/// Makes sure that `out` lies in no input folder and is new, empty, or the output of an earlier
/// preparation; `true` for the last, whose settings are still to be compared.
fn holds_a_set(out: &Path, inputs: &[&Path]) -> Result<bool> {
    let wrong = |problem: String| Error::Output {
        path: out.to_owned(),
        problem,
    };
    // The nearest ancestor that exists tells where a folder still to be made will be.
    let place = out
        .ancestors()
        .filter(|folder| !folder.as_os_str().is_empty())
        .find_map(|folder| folder.canonicalize().ok());
    for input in inputs {
        if let (Some(place), Ok(input)) = (&place, input.canonicalize())
            && place.starts_with(&input)
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
    if out.join(SETTINGS).is_file() {
        return Ok(true);
    }
    if std::fs::read_dir(out).is_ok_and(|mut entries| entries.next().is_some()) {
        return Err(wrong(
            "this folder holds other things and no prepared set; give a new or an empty folder"
                .to_owned(),
        ));
    }
    Ok(false)
}

/// How the frames of a set are made.
pub(crate) struct Run<'a> {
    pub out: &'a Path,
    pub settings: &'a Settings,
    /// Only what falls to it is made, and its part of the tables (see [`crate::set::shards`]).
    pub shard: Option<Shard>,
    pub threads: Option<usize>,
    pub quiet: bool,
}

/// What became of a frame: a sample, what could not be used, or both.
#[derive(Default)]
pub(crate) struct Made {
    pub sample: Option<Sample>,
    pub failures: Vec<Failure>,
}

impl Run<'_> {
    /// Makes the frames and writes the set or the part of it. `expected` are the samples it should
    /// have; `before` is what is known to be unusable before any frame was tried.
    ///
    /// # Errors
    /// The output cannot be written, or `make` says so. Bad inputs are no error: see
    /// [`Report::failures`].
    pub fn make<T: Sync>(
        &self,
        expected: BTreeMap<Role, u64>,
        frames: &[Frame<T>],
        before: Vec<Failure>,
        make: impl Fn(&Output<'_>, &Frame<T>) -> Result<Made> + Sync,
    ) -> Result<Report> {
        let Self {
            out,
            settings,
            shard,
            ..
        } = *self;
        files::check_writable(out)?;
        files::write_atomic(&out.join(SETTINGS), yaml::to_string(settings)?.as_bytes())?;
        let output = Output::open(out);
        let mine: Vec<&Frame<T>> = frames
            .iter()
            .filter(|frame| shard.is_none_or(|shard| shard.has(&frame.id)))
            .collect();
        let label = format!("prep {}", settings.content);
        let progress = Progress::new(&label, mine.len() as u64, "frames", self.quiet);
        let told = AtomicU64::new(0);
        let tell_of = |failure: &Failure| {
            if told.fetch_add(1, Ordering::Relaxed) < FAILURES_SHOWN {
                let role = failure.role.map_or("", Role::as_str);
                let line = format!("{role} {} skipped: {}", failure.id, failure.problem);
                progress.println(line.trim_start());
            }
        };
        // Of the parts of a set, the first tells of what belongs to no frame.
        let mut failures = match shard {
            Some(shard) if shard.index != 0 => Vec::new(),
            _ => before,
        };
        failures.iter().for_each(tell_of);
        let made: Vec<Made> = threads(self.threads)?.install(|| {
            let work = mine.par_iter().map(|frame| {
                let made = make(&output, frame)?;
                made.failures.iter().for_each(tell_of);
                progress.add(1);
                Ok::<_, Error>(made)
            });
            work.collect::<Result<_>>()
        })?;
        progress.finish();

        let mut samples: BTreeMap<Role, Vec<Sample>> = BTreeMap::new();
        for (frame, made) in mine.iter().zip(made) {
            failures.extend(made.failures);
            if let Some(sample) = made.sample {
                samples.entry(frame.role).or_default().push(sample);
            }
        }
        let mut results = Results {
            expected,
            samples,
            failures,
        };
        let names = frames.iter().map(|frame| (frame.role, &*frame.id));
        results.sort(&places(names.clone()));
        let set = match shard {
            Some(shard) => merge::write_part(out, settings, shard, names, &results)?,
            None => results.write(out, settings)?,
        };
        Ok(Report {
            set,
            failures: results.failures,
            written: output.written(),
            kept: output.kept_files(),
        })
    }
}

/// The place of every frame in their list, by role and name.
pub(crate) type Places = HashMap<(Role, String), usize>;

pub(crate) fn places<'a>(names: impl Iterator<Item = (Role, &'a str)>) -> Places {
    names
        .enumerate()
        .map(|(place, (role, id))| ((role, id.to_owned()), place))
        .collect()
}

/// Everything the tables of a set are written from.
pub(crate) struct Results {
    /// Samples the set should have per role.
    pub expected: BTreeMap<Role, u64>,
    /// Samples made.
    pub samples: BTreeMap<Role, Vec<Sample>>,
    /// Inputs that could not be used.
    pub failures: Vec<Failure>,
}

impl Results {
    /// Brings everything into the order of the frames. Failures of no frame, as archives and lines
    /// of a list, come last.
    pub fn sort(&mut self, places: &Places) {
        let place = |role: Role, id: &str| places.get(&(role, id.to_owned())).copied();
        for (role, samples) in &mut self.samples {
            samples.sort_by_cached_key(|sample| place(*role, &sample.id));
        }
        self.failures.sort_by_cached_key(|failure| {
            failure
                .role
                .and_then(|role| place(role, &failure.id))
                .map_or((1, 0), |place| (0, place))
        });
    }

    /// Writes the list of failures, the tables and, last, the manifest into `folder`.
    pub fn write(&self, folder: &Path, settings: &Settings) -> Result<PreparedSet> {
        let counts = self.expected.iter().map(|(role, expected)| {
            let found = self.samples.get(role).map_or(0, Vec::len) as u64;
            let expected = *expected;
            (*role, Count { expected, found })
        });
        let manifest = Manifest {
            format: FORMAT,
            content: settings.content,
            split_digest: settings.content.split().map(strat_splits::digest),
            source: settings.source.clone(),
            image_width: settings.image_width,
            image_height: settings.image_height,
            kernel: settings.kernel,
            codec: settings.codec.to_string(),
            counts: counts.collect(),
            failures: self.failures.len() as u64,
            cameras: cameras(settings.content, self.samples.values().flatten()),
            tool_version: env!("CARGO_PKG_VERSION").to_owned(),
            data_digest: String::new(),
        };
        write_failures(folder, &self.failures)?;
        Ok(PreparedSet::write(folder, manifest, &self.samples)?)
    }
}

/// The different cameras of the samples, sorted; those that are not known are left out.
fn cameras<'a>(content: Content, samples: impl Iterator<Item = &'a Sample>) -> Vec<CameraEntry> {
    let mut cameras: Vec<CameraEntry> = Vec::new();
    for sample in samples.filter(|sample| sample.focal_px > 0.0) {
        let name = match (content.split(), sample.drive().parse::<DriveId>()) {
            (None, _) => content.to_string(),
            (Some(_), Ok(drive)) => drive.date.to_string(),
            (Some(_), Err(_)) => sample.drive().to_owned(),
        };
        let camera = CameraEntry {
            name,
            width: sample.width,
            height: sample.height,
            focal_px: sample.focal_px,
            baseline_m: sample.baseline_m,
        };
        if !cameras.contains(&camera) {
            cameras.push(camera);
        }
    }
    cameras.sort_by(|a, b| {
        let numbers = |c: &CameraEntry| (c.width, c.height);
        (a.name.cmp(&b.name))
            .then(numbers(a).cmp(&numbers(b)))
            .then(a.focal_px.total_cmp(&b.focal_px))
            .then(a.baseline_m.total_cmp(&b.baseline_m))
    });
    cameras
}

/// The files of a set while it is made.
pub(crate) struct Output<'a> {
    out: &'a Path,
    /// Hashes stated by the tables of an earlier finished run.
    known: HashMap<String, String>,
    written: AtomicU64,
    kept: AtomicU64,
}

impl<'a> Output<'a> {
    /// The folder, with what an earlier finished run says of its files.
    pub fn open(out: &'a Path) -> Self {
        Self {
            out,
            known: known_hashes(out),
            written: 0.into(),
            kept: 0.into(),
        }
    }

    /// How many files were written.
    pub fn written(&self) -> u64 {
        self.written.load(Ordering::Relaxed)
    }

    /// How many files of an earlier run were kept.
    pub fn kept_files(&self) -> u64 {
        self.kept.load(Ordering::Relaxed)
    }

    /// A file of an earlier run. Files appear whole, so its being there is enough, unless a
    /// finished table knows it with another content, or its input is newer: `changed` says when
    /// that was last written or put into its place.
    pub fn kept(&self, path: &str, changed: Option<SystemTime>) -> Piece<Option<FileRef>> {
        let place = self.out.join(path);
        let Ok(metadata) = std::fs::metadata(&place) else {
            return Ok(None);
        };
        let outdated = changed.is_some_and(|at| metadata.modified().is_ok_and(|made| made < at));
        if outdated || !metadata.is_file() {
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

    /// Writes a file.
    pub fn put(&self, path: String, bytes: &[u8]) -> Piece<FileRef> {
        files::write_atomic(&self.out.join(&path), bytes).map_err(|e| Stop::Output(e.into()))?;
        self.written.fetch_add(1, Ordering::Relaxed);
        Ok(FileRef {
            blake3: files::blake3_hex(bytes),
            path,
        })
    }

    /// Writes ground truth in metres.
    pub fn put_depth(&self, path: String, depth_m: &Plane, header: &DepthHeader) -> Piece<FileRef> {
        let bytes = encode_depth(depth_m, header).map_err(|e| Stop::Output(e.into()))?;
        self.put(path, &bytes)
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
        return Ok(files::remove(&path)?);
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
