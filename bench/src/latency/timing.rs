//! All combinations of threads and batches for one model.

use std::path::Path;

use strat_splits::Role;
use strat_store::{
    command::error_chain, failures::Failures, progress::Progress, set::PreparedSet, spread, threads,
};

use super::{
    measure::{Bench, ImageFile, LatencyError, MAX_IMAGES, Measured, Minimum, clock},
    rows::{FORMAT, LatencyRow, Scenario, Stage},
};
use crate::{
    evaluate::record::TOOL_VERSION,
    images,
    model::{Description, Model, ModelError, description_path, draft::Draft, vet::vet},
    notes::Notes,
    quantity::StereoCamera,
    runtime::{Device, Runtime, inventory::Processor, placement_text},
};

/// What stays the same for all models.
pub struct Timing {
    /// The inference library.
    pub runtime: Runtime,
    /// Where models run.
    pub device: Device,
    /// The images to take turns with.
    pub images: Vec<ImageFile>,
    /// Thread counts to try.
    pub threads: Vec<usize>,
    /// Batch sizes to try.
    pub batches: Vec<usize>,
    /// When a measurement is long enough.
    pub minimum: Minimum,
    /// What the machine has.
    pub processor: Processor,
}

/// At most [`MAX_IMAGES`] test images of a set, spread evenly, with their cameras.
///
/// # Errors
/// The set cannot be read.
pub fn images_of_set(set: &PreparedSet) -> Result<Vec<ImageFile>, strat_store::Error> {
    let samples = set.samples(Role::Test)?;
    let few = spread::evenly(samples.len(), MAX_IMAGES).map(|index| &samples[index]);
    let image = few.map(|sample| {
        // The focal length belongs to the untouched image; 0 is not known.
        let is_known =
            sample.left_full.is_some() && sample.focal_px > 0.0 && sample.baseline_m > 0.0;
        ImageFile {
            path: set.path(sample.left_full.as_ref().unwrap_or(&sample.left)),
            camera: is_known.then_some(StereoCamera {
                focal_px: sample.focal_px,
                baseline_m: sample.baseline_m,
            }),
        }
    });
    Ok(image.collect())
}

/// At most [`MAX_IMAGES`] images below a folder, spread evenly, taken by one camera.
///
/// # Errors
/// The folder cannot be read.
pub fn images_of_folder(
    folder: &Path,
    camera: Option<StereoCamera>,
) -> Result<Vec<ImageFile>, strat_store::Error> {
    let paths = images::below(folder)?.images;
    let few = spread::evenly(paths.len(), MAX_IMAGES).map(|index| paths[index].clone());
    Ok(few.map(|path| ImageFile { path, camera }).collect())
}

impl Timing {
    /// Measures one model in every combination. A combination that fails is named and left out.
    ///
    /// # Errors
    /// The model cannot be used, or its probe fails: what computes something else is not timed.
    pub fn model(
        &self,
        name: &str,
        file: &Path,
        rows: &mut Vec<LatencyRow>,
        notes: &mut Notes,
    ) -> Result<(), LatencyError> {
        let draft = drafted(file)?;
        if draft.is_some() {
            notes.note(&format!(
                "model {name} has no description, so only the session is timed; with one (`bench describe`) the \
                 way from a file to a map is, too"
            ));
        }
        let open = |threads| match &draft {
            None => Model::open(name, file, &self.runtime, self.device, threads),
            Some(description) => {
                let file = strat_onnx::model::read(file)?;
                let description = description.clone();
                Model::described(name, file, description, &self.runtime, self.device, threads)
            }
        };
        let mut accuracy = open(self.processor.threads)?;
        let vetting = vet(&mut accuracy, None)?;
        vetting.notes.iter().for_each(|note| notes.note(note));
        if vetting.probe_failed() {
            return Err(LatencyError::Probe(vetting.warnings.join("; ")));
        }
        vetting
            .warnings
            .into_iter()
            .for_each(|warning| notes.warn(warning));
        if let Some(placement) = placement_text(accuracy.placement()) {
            notes.note(&format!("model {name}: {placement}"));
        }
        let mut batches = self.batches.clone();
        if !accuracy.takes_batches() && batches.iter().any(|&batch| batch > 1) {
            notes.note(&format!(
                "model {name} has a fixed batch of 1, so other batches are left out; export it with an \
                 open first dimension to time them"
            ));
            batches.retain(|&batch| batch == 1);
        }
        let bench = Bench::new(&self.images, &mut accuracy, &batches)?;
        let mut failures = Failures::default();
        for (image, error) in bench.broken() {
            let said = failures.add(&image.display().to_string(), &error_chain(error));
            said.into_iter().for_each(|sentence| notes.fail(sentence));
        }
        failures
            .repeated()
            .into_iter()
            .for_each(|sentence| notes.fail(sentence));
        drop(accuracy);
        for &threads in &self.threads {
            let pool = threads::pool("bench", threads)?;
            let mut model = open(threads)?;
            for &batch in &batches {
                let setting = Setting {
                    threads,
                    batch,
                    pool: &pool,
                };
                match self.setting(&bench, &mut model, &setting, draft.is_none(), notes.quiet) {
                    Ok(measured) => {
                        let doubts = measured.iter().filter_map(disturbed);
                        doubts.for_each(|sentence| notes.warn(sentence));
                        rows.extend(measured);
                    }
                    Err(error) => notes.fail(format!(
                        "model {name}, {threads} thread(s), batch {batch}: {}",
                        error_chain(&error)
                    )),
                }
                if model.has_ended() {
                    break;
                }
            }
        }
        Ok(())
    }

    fn setting(
        &self,
        bench: &Bench,
        model: &mut Model,
        &Setting {
            threads,
            batch,
            pool,
        }: &Setting<'_>,
        from_files: bool,
        quiet: bool,
    ) -> Result<Vec<LatencyRow>, LatencyError> {
        let before = bench.verify(model, threads, batch)?;
        let stream = self.minimum;
        // A query of the offline scenario is whatever keeps all threads busy.
        let at_once = batch * (2 * threads).div_ceil(batch);
        let offline = |images_per_query: usize| Minimum {
            queries: stream.queries.div_ceil(images_per_query as u64),
            ..stream
        };
        let streaming = if batch == 1 {
            Scenario::SingleStream
        } else {
            Scenario::MultiStream
        };
        let label = format!("{}, threads {threads}, batch {batch}", model.name);
        let planned = if from_files { 4 } else { 2 };
        let progress = Progress::new(&label, planned, "measurements", quiet);
        let mut measured: Vec<(Stage, Scenario, Measured)> = Vec::new();
        let file = bench.file_stage();
        for (stage, scenario) in [
            (Stage::Session, streaming),
            (Stage::Session, Scenario::Offline),
            (file, streaming),
            (file, Scenario::Offline),
        ]
        .into_iter()
        .filter(|(stage, _)| from_files || *stage == Stage::Session)
        {
            let clock = clock(model.transport());
            let result = match (stage, scenario) {
                (Stage::Session, Scenario::Offline) => {
                    bench.time_session(model, batch, offline(batch), clock)?
                }
                (Stage::Session, _) => bench.time_session(model, batch, stream, clock)?,
                (_, Scenario::Offline) => {
                    bench.time_files(model, batch, at_once, pool, offline(at_once), clock)?
                }
                _ => bench.time_files(model, batch, batch, pool, stream, clock)?,
            };
            measured.push((stage, scenario, result));
            progress.add(1);
        }
        progress.finish();
        // A session that went wrong on its way has no figures either.
        let max_difference = before.max(bench.verify(model, threads, batch)?);
        let row = |(stage, scenario, measured): (Stage, Scenario, Measured)| {
            let latencies = measured.latencies.filter(|_| scenario != Scenario::Offline);
            LatencyRow {
                format: FORMAT,
                model: model.name.clone(),
                model_hash: model.file.blake3.clone(),
                device: self.device.to_string(),
                provider: model.provider().to_owned(),
                runtime: model.runtime().to_owned(),
                threads,
                batch,
                scenario,
                stage,
                input_width: bench.input_size().0,
                input_height: bench.input_size().1,
                samples: bench.images(),
                queries: measured.queries,
                images: measured.images,
                seconds: measured.seconds,
                images_per_second: measured.images as f64 / measured.seconds.max(1e-9),
                mean_ms: latencies.map(|l| l.mean_ms),
                min_ms: latencies.map(|l| l.min_ms),
                p50_ms: latencies.map(|l| l.p50_ms),
                p90_ms: latencies.map(|l| l.p90_ms),
                p95_ms: latencies.map(|l| l.p95_ms),
                p99_ms: latencies.map(|l| l.p99_ms),
                max_ms: latencies.map(|l| l.max_ms),
                max_difference,
                processor: self.processor.model.clone(),
                processor_threads: self.processor.threads,
                tool_version: TOOL_VERSION.to_owned(),
            }
        };
        Ok(measured.into_iter().map(row).collect())
    }
}

/// What can be told of the tensors of a file that nobody has described, from its graph alone: enough to run
/// it, not to know what comes out. `None` for a file that is described.
fn drafted(path: &Path) -> Result<Option<Description>, ModelError> {
    let file = strat_onnx::model::read(path)?;
    if file.info.metadata().is_some() || description_path(path).exists() {
        return Ok(None);
    }
    let misfit = |reason: String| ModelError::Graph {
        model: path.to_path_buf(),
        reason,
    };
    let draft = Draft::of_file(&file, None).map_err(misfit)?;
    draft.description().map(Some).map_err(misfit)
}

/// A sentence about a measurement that something else seems to have disturbed: queries of one model take
/// about the same time.
fn disturbed(row: &LatencyRow) -> Option<String> {
    let (median, late, worst) = (row.p50_ms?, row.p99_ms?, row.max_ms?);
    (late > 1.5 * median).then(|| {
        format!(
            "{}, {}, {} threads, batch {}: one query in a hundred took {late:.1} ms or more (the longest \
             {worst:.1}), the median {median:.1}; other programs may have been at work, so time again on an \
             idle machine",
            row.model, row.stage, row.threads, row.batch
        )
    })
}

struct Setting<'a> {
    threads: usize,
    batch: usize,
    pool: &'a rayon::ThreadPool,
}
