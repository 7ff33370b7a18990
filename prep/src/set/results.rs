//! Everything the tables of a set are written from, in the order of its frames.

use std::collections::{BTreeMap, HashMap};
use std::path::Path;

use serde::{Deserialize, Serialize};
use strat_splits::{DriveId, Role};
use strat_store::files;
use strat_store::layout::{FAILURES, FRAMES, MANIFEST};
use strat_store::set::{CameraEntry, Content, Count, FORMAT, Manifest, PreparedSet, Sample};
use strat_store::shard::Shard;

use super::sample::BadInput;
use super::settings::Settings;
use crate::error::Result;

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

impl Failure {
    /// What a bad input costs a sample.
    pub fn of_sample(role: Role, id: &str, bad: BadInput) -> Self {
        Self {
            role: Some(role),
            id: id.to_owned(),
            file: bad.file,
            problem: bad.problem,
        }
    }

    /// An archive or folder of many inputs that cannot be read.
    pub fn of_many(path: &Path, problem: impl Into<String>) -> Self {
        Self {
            role: None,
            id: String::new(),
            file: path.display().to_string(),
            problem: problem.into(),
        }
    }
}

/// Position of every frame in their list, by role and id.
pub type Order = HashMap<(Role, String), usize>;

/// The order of a list of frames.
pub fn order<'a>(frames: impl Iterator<Item = (Role, &'a str)>) -> Order {
    frames
        .enumerate()
        .map(|(position, (role, id))| ((role, id.to_owned()), position))
        .collect()
}

/// Everything the tables of a set are written from.
#[derive(Debug, Default)]
pub struct Results {
    /// Samples the set should have per role.
    pub expected: BTreeMap<Role, u64>,
    /// Samples made.
    pub samples: BTreeMap<Role, Vec<Sample>>,
    /// Inputs that could not be used.
    pub failures: Vec<Failure>,
}

impl Results {
    /// Brings everything into the order of the frames. Failures of no frame, such as archives and lines
    /// of a list, come last.
    pub fn sort(&mut self, order: &Order) {
        let position = |role: Role, id: &str| order.get(&(role, id.to_owned())).copied();
        for (role, samples) in &mut self.samples {
            samples.sort_by_cached_key(|sample| position(*role, &sample.id));
        }
        self.failures.sort_by_cached_key(|failure| {
            failure
                .role
                .and_then(|role| position(role, &failure.id))
                .map_or((1, 0), |position| (0, position))
        });
    }

    /// Writes the list of failures, the tables and, last, the manifest into `folder`.
    ///
    /// # Errors
    /// A file cannot be written.
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
        let path = folder.join(FAILURES);
        if self.failures.is_empty() {
            files::remove(&path)?;
        } else {
            files::write_csv(&path, &self.failures)?;
        }
        Ok(PreparedSet::write(folder, manifest, &self.samples)?)
    }

    /// Writes the tables of one part of a set; the returned set is that part.
    ///
    /// Of a split everyone knows the samples and their order. Of other collections the part says them,
    /// `frames`, so that it can be seen that all parts are of one list.
    ///
    /// # Errors
    /// A file cannot be written.
    pub fn write_part<'a>(
        &self,
        out: &Path,
        settings: &Settings,
        shard: Shard,
        frames: impl Iterator<Item = (Role, &'a str)>,
    ) -> Result<PreparedSet> {
        let folder = shard.folder(out);
        // An earlier manifest would call a half-written part complete.
        files::remove(&folder.join(MANIFEST))?;
        files::check_writable(&folder)?;
        if settings.content.split().is_none() {
            files::write_csv(&folder.join(FRAMES), frames)?;
        }
        self.write(&folder, settings)
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
