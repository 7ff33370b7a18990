//! From composites and a model to rows.
//!
//! Composites are made and measured on rayon's threads while the model runs on the calling thread
//! ([`pipeline`]); rows come in the order of the plan and do not depend on the number of threads.

use std::{
    collections::HashMap,
    ops::ControlFlow,
    time::{Duration, Instant},
};

use image::RgbImage;
use strat_store::{progress::Progress, raster::Plane};

use super::{
    backgrounds::Background,
    composite::{Mask, paste},
    experiments::{Cast, Job, Paste},
    reader::Reader,
    rows::{Condition, CueRow, Experiment, Key},
};
use crate::{
    evaluate::pipeline::{self, MAX_INITIAL_FAILURES},
    model::{self, InputDescription, Model, ModelError, ModelInput},
};

/// Pixels by which a sprite is eroded before its depth is taken.
const EROSION_PX: usize = 2;
/// Pixels of the network on each side of an occluder's edge (PROTOCOL 5.2: 3, there of the picture). A
/// band of 3 pixels of the picture lies within the blur of a network that sees half of its resolution.
const BAND_PX: i64 = 3;

/// A composite without a row.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Failure {
    /// The background's image id.
    pub background: String,
    /// A sentence.
    pub reason: String,
}

/// What came out for one model.
#[derive(Debug, Default)]
pub struct Outcome {
    /// One row for each composite, in the order of the plan.
    pub rows: Vec<CueRow>,
    /// What went wrong.
    pub failures: Vec<Failure>,
    /// Jobs that were not tried because nothing worked.
    pub not_tried: usize,
    /// Wall-clock time.
    pub wall: Duration,
    /// Of it, time in which the model ran.
    pub model: Duration,
}

impl Outcome {
    /// Share of the wall time that was not the model's: what compositing and measuring cost.
    #[must_use]
    pub fn overhead(&self) -> f64 {
        let wall = self.wall.as_secs_f64();
        if wall > 0.0 {
            (wall - self.model.as_secs_f64()) / wall
        } else {
            0.0
        }
    }
}

/// A composite and the pixels of its sprites, in the order they were pasted.
#[must_use]
pub fn compose(cast: &Cast, background: &Background, pastes: &[Paste]) -> (RgbImage, Vec<Mask>) {
    let mut picture = background.image.clone();
    let masks = pastes
        .iter()
        .map(|item| paste(&mut picture, &cast.sprites[item.sprite], item.place))
        .collect();
    (picture, masks)
}

/// The composites of a job, ready for the model.
struct Prepared {
    inputs: Vec<ModelInput>,
    masks: Vec<Mask>,
}

fn prepare(
    cast: &Cast,
    background: &Background,
    job: &Job,
    input: &InputDescription,
) -> Result<Prepared, ModelError> {
    let mut inputs = Vec::with_capacity(job.composites.len());
    let mut masks = Vec::new();
    for (_, pastes) in &job.composites {
        let (picture, covered) = compose(cast, background, pastes);
        let focal_px = background.ground.focal_px;
        inputs.push(model::prepare_input(&picture, input, focal_px)?);
        // All composites of a job cover the same pixels.
        masks = covered;
    }
    Ok(Prepared { inputs, masks })
}

/// Maps of a job's composites and the pixels of its sprites.
struct Predicted {
    maps: Vec<Plane>,
    masks: Vec<Mask>,
}

/// The model's map of every clean background.
///
/// # Errors
/// The model fails on all of them; the first reason is given.
pub fn predict_clean(
    model: &mut Model,
    backgrounds: &[Background],
) -> Result<Vec<Result<Plane, String>>, ModelError> {
    let mut first_error = None;
    let mut maps = Vec::with_capacity(backgrounds.len());
    for background in backgrounds {
        let (input, focal_px) = (&model.description.input, background.ground.focal_px);
        let prepared = model::prepare_input(&background.image, input, focal_px);
        match prepared.and_then(|prepared| model.predict(&prepared)) {
            Ok(map) => maps.push(Ok(map)),
            Err(error) => {
                maps.push(Err(error.to_string()));
                first_error.get_or_insert(error);
            }
        }
    }
    match first_error {
        Some(error) if maps.iter().all(Result::is_err) => Err(error),
        _ => Ok(maps),
    }
}

/// What a model is asked about.
#[derive(Clone, Copy)]
pub struct Composites<'a> {
    /// The sprites.
    pub cast: &'a Cast,
    /// The pictures they are pasted into.
    pub backgrounds: &'a [Background],
    /// The composites.
    pub jobs: &'a [Job],
}

impl Composites<'_> {
    /// The composites of a job, as the keys of their rows.
    fn keys(&self, job: &Job) -> Vec<Key> {
        let background = &self.backgrounds[job.background].id;
        let key = |(condition, pastes): &(Condition, Vec<Paste>)| {
            let sprite = &self.cast.sprites[pastes.last()?.sprite].name;
            let (sprite, background) = (sprite.clone(), background.clone());
            Some((job.experiment, sprite, background, *condition, job.step))
        };
        job.composites.iter().filter_map(key).collect()
    }

    /// Parts the jobs by rows that are there already: the rows of whole jobs, and the jobs that are left.
    #[must_use]
    pub fn part(&self, rows: Vec<CueRow>) -> (Vec<CueRow>, Vec<Job>) {
        let mut found = by_key(rows);
        let (mut whole, mut left) = (Vec::new(), Vec::new());
        for job in self.jobs {
            let own: Option<Vec<CueRow>> =
                self.keys(job).iter().map(|key| found.remove(key)).collect();
            match own {
                Some(rows) => whole.extend(rows),
                None => left.push(job.clone()),
            }
        }
        (whole, left)
    }

    /// Rows in the order of the jobs.
    #[must_use]
    pub fn in_order(&self, rows: Vec<CueRow>) -> Vec<CueRow> {
        let mut found = by_key(rows);
        let keys = self.jobs.iter().flat_map(|job| self.keys(job));
        keys.filter_map(|key| found.remove(&key)).collect()
    }
}

fn by_key(rows: Vec<CueRow>) -> HashMap<Key, CueRow> {
    rows.into_iter().map(|row| (row.key(), row)).collect()
}

/// Asks a model about composites. `clean` are its maps of the backgrounds; `found` is told the rows of
/// each job as soon as they are there, and ends the work by an error.
///
/// # Errors
/// Only what `found` returns.
pub fn run<E>(
    model: &mut Model,
    plan: &Composites<'_>,
    clean: &[Result<Plane, String>],
    pool: &rayon::ThreadPool,
    progress: &Progress,
    mut found: impl FnMut(&[CueRow]) -> Result<(), E>,
) -> Result<Outcome, E> {
    let &Composites {
        cast,
        backgrounds,
        jobs,
    } = plan;
    let input = model.description.input.clone();
    let name = model.name.clone();
    let readers: Vec<Option<Reader>> = backgrounds
        .iter()
        .zip(clean)
        .map(|(background, clean)| Some(Reader::new(model, background, clean.as_ref().ok()?)))
        .collect();
    let started = Instant::now();
    let mut outcome = Outcome::default();
    let (mut in_model, mut tried) = (Duration::ZERO, 0);
    let ended = pipeline::run(
        jobs,
        pipeline::chunk_size(pool),
        pool,
        |job| prepare(cast, &backgrounds[job.background], job, &input),
        |_, prepared| {
            if model.has_ended() {
                return ControlFlow::Break(None);
            }
            let asked = Instant::now();
            let predicted = prepared.and_then(|Prepared { inputs, masks }| {
                let maps = inputs.iter().map(|input| model.predict(input));
                let maps = maps.collect::<Result<_, _>>()?;
                Ok(Predicted { maps, masks })
            });
            in_model += asked.elapsed();
            ControlFlow::Continue(predicted)
        },
        |job, predicted: Result<Predicted, ModelError>| -> Result<Vec<CueRow>, String> {
            let predicted = predicted.map_err(|error| error.to_string())?;
            let clean = clean[job.background].as_ref().map_err(Clone::clone)?;
            let background = &backgrounds[job.background];
            Ok(readers[job.background].map_or_else(Vec::new, |reader| {
                measure(&name, job, cast, background, clean, reader, &predicted)
            }))
        },
        |job, result| {
            tried += 1;
            progress.add(job.composites.len() as u64);
            match result {
                Ok(rows) => {
                    if let Err(error) = found(&rows) {
                        return ControlFlow::Break(Some(error));
                    }
                    outcome.rows.extend(rows);
                }
                Err(reason) => {
                    let background = backgrounds[job.background].id.clone();
                    progress.println(&format!(
                        "error: model {name}, background {background}: {reason}"
                    ));
                    outcome.failures.push(Failure { background, reason });
                }
            }
            if outcome.failures.len() >= MAX_INITIAL_FAILURES && outcome.rows.is_empty() {
                return ControlFlow::Break(None);
            }
            ControlFlow::Continue(())
        },
    );
    if let ControlFlow::Break(Some(error)) = ended {
        return Err(error);
    }
    outcome.not_tried = jobs.len() - tried;
    outcome.wall = started.elapsed();
    outcome.model = in_model;
    Ok(outcome)
}

/// The rows of one job.
fn measure(
    model: &str,
    job: &Job,
    cast: &Cast,
    background: &Background,
    clean: &Plane,
    reader: Reader,
    predicted: &Predicted,
) -> Vec<CueRow> {
    let Some(top) = predicted.masks.last() else {
        return Vec::new();
    };
    let median_of = |values: Vec<f32>| {
        let mut values: Vec<f64> = values.into_iter().map(f64::from).collect();
        strat_metrics::median(&mut values)
    };
    let (eroded, eroded_px) = top.eroded_at_most(EROSION_PX);
    let band_px = reader.network_pixels(BAND_PX);
    let bands = (job.experiment == Experiment::Occlusion)
        .then(|| {
            predicted
                .masks
                .first()
                .map(|rear| Bands::new(top, rear, band_px))
        })
        .flatten();
    let change = (bands.as_ref())
        .zip(predicted.maps.first().zip(predicted.maps.get(1)))
        .map(|(bands, (same, contrast))| bands.change(&reader, same, contrast));
    let mut rows = Vec::new();
    for ((condition, pastes), map) in job.composites.iter().zip(&predicted.maps) {
        let Some(measured) = pastes.last() else {
            continue;
        };
        let (Some(depth), Some(reference_depth)) = (
            median_of(reader.depths(map, eroded.pixels())),
            median_of(reader.depths(clean, eroded.pixels())),
        ) else {
            continue;
        };
        let step = |map: &Plane| {
            let bands = bands.as_ref()?;
            let outside = median_of(reader.depths(map, bands.outside.pixels()))?;
            Some(outside - median_of(reader.depths(map, bands.inside.pixels()))?)
        };
        let sprite = &cast.sprites[measured.sprite];
        let change = change
            .flatten()
            .filter(|_| *condition == Condition::Contrast);
        rows.push(CueRow {
            model: model.to_owned(),
            experiment: job.experiment,
            sprite: sprite.name.clone(),
            familiar: sprite.familiar,
            background: background.id.clone(),
            thesis: job.thesis,
            condition: *condition,
            step: job.step,
            height_px: measured.place.height_px,
            contact_row: measured.place.contact_row,
            horizon_row: background.ground.horizon_row,
            bottom_row: f64::from(background.ground.height) - 1.0,
            focal_px: background.ground.focal_px,
            ideal_depth_m: job.ideal_depth_m,
            unit: reader.unit(),
            depth,
            reference_depth,
            pixels: eroded.count(),
            eroded_px,
            step_depth: step(map),
            clean_step_depth: step(clean),
            band_px: bands.as_ref().map(|_| band_px),
            band_change: change.map(|(band, _)| band),
            rest_change: change.map(|(_, rest)| rest),
        });
    }
    rows
}

/// The pixels along the edge between an occluder and what it hides, and the rest of both.
struct Bands {
    inside: Mask,
    outside: Mask,
    rest: [Mask; 2],
}

impl Bands {
    fn new(front: &Mask, rear: &Mask, band_px: i64) -> Self {
        let rear = rear.without(front);
        let (inside, outside) = (front.near(&rear, band_px), rear.near(front, band_px));
        Self {
            rest: [front.without(&inside), rear.without(&outside)],
            inside,
            outside,
        }
    }

    /// Mean absolute difference of two maps' depths in the band and in the rest.
    fn change(&self, reader: &Reader, a: &Plane, b: &Plane) -> Option<(f64, f64)> {
        let mean = |masks: [&Mask; 2]| {
            let pixels = || masks.into_iter().flat_map(Mask::pixels);
            let (a, b) = (reader.depths(a, pixels()), reader.depths(b, pixels()));
            let sum: f64 = a
                .iter()
                .zip(&b)
                .map(|(a, b)| f64::from((a - b).abs()))
                .sum();
            (!a.is_empty()).then(|| sum / a.len() as f64)
        };
        Some((
            mean([&self.inside, &self.outside])?,
            mean([&self.rest[0], &self.rest[1]])?,
        ))
    }
}
