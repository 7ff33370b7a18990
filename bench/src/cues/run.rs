//! From backgrounds, sprites and a model to rows.
//!
//! Composites are made and measured on rayon's threads while the model runs on the calling
//! thread, a bounded number of jobs ahead, as in [`crate::evaluate`]; rows come in the order of
//! the plan and do not depend on the number of threads. Only the pixels that a measure needs are
//! brought to full size, with the same interpolation as whole maps.
//!
//! Disparity becomes depth by f B / (W d) with d at least 1e-4 (decision D8), and depth is
//! clipped to [1e-3, 80] metres. Where scale or camera are unknown, depth is the clean
//! background's median value over the value.

use std::time::{Duration, Instant};

use image::RgbImage;
use rayon::prelude::*;
use strat_onnx::metadata::OutputMeaning;
use strat_splits::Role;
use strat_store::{
    progress::Progress,
    raster::Plane,
    set::{Content, PreparedSet, Sample},
};

use super::{
    CueError,
    composite::{Mask, paste},
    experiments::{Cast, Ground, Job, Paste, THESIS_BACKGROUNDS},
    horizon_row,
    rows::{Condition, CueRow, Experiment, Unit},
};
use crate::{
    evaluate::{self, SampleError},
    model::{self, InputDescription, Model, ModelError},
    quantity::{Conversion, Quantity, Rig},
};

/// Depth is clipped to this, metres (PROTOCOL 5).
const DEPTH_RANGE_M: [f32; 2] = [1e-3, 80.0];
/// Least disparity as a fraction of image width (decision D8).
const DISPARITY_FLOOR: f32 = 1e-4;
/// Least value of a map without a scale, as a share of its median.
const RELATIVE_FLOOR: f32 = 1e-3;
/// Baseline of the KITTI protocol, metres (PROTOCOL 3.4).
const KITTI_BASELINE_M: f64 = 0.54;
/// Pixels by which a sprite is eroded before its depth is taken.
const EROSION_PX: usize = 2;
/// Pixels on each side of an occluder's edge.
const BAND_PX: i64 = 3;
/// After this many failures without a single success the rest is not tried.
const HOPELESS_AFTER: usize = 10;
/// Labels of humans and vehicles (PROTOCOL 1.3).
const FOREGROUND_LABELS: std::ops::RangeInclusive<u8> = 24..=33;

/// A picture to paste into.
#[derive(Clone, Debug)]
pub struct Background {
    /// Image id.
    pub id: String,
    /// The untouched left image.
    pub image: RgbImage,
    /// Its sizes and camera.
    pub ground: Ground,
    /// What depth is made of disparity with.
    pub rig: Option<Rig>,
    /// Share of humans and vehicles where sprites go, where the set has labels.
    pub occupied: Option<f64>,
}

/// Chooses and reads backgrounds: those asked for, else the `count` whose path is freest of humans
/// and vehicles by their labels, else (without labels) `count` evenly spread ones.
///
/// # Errors
/// There are fewer than five, one asked for is missing, or one cannot be read.
pub fn backgrounds(
    set: &PreparedSet,
    ids: &[String],
    count: usize,
    horizon: Option<f64>,
    pool: &rayon::ThreadPool,
) -> Result<Vec<Background>, CueError> {
    let samples: Vec<Sample> = set
        .samples(Role::Test)?
        .into_iter()
        .filter(|sample| sample.left_full.is_some())
        .collect();
    let folder = set.root.display().to_string();
    let few = |found| CueError::TooFewBackgrounds {
        set: folder.clone(),
        found,
        needed: THESIS_BACKGROUNDS,
    };
    if samples.len() < THESIS_BACKGROUNDS {
        return Err(few(samples.len()));
    }
    let failed = |sample: &Sample| {
        let id = sample.id.clone();
        move |source: SampleError| CueError::Background { id, source }
    };
    let content = set.manifest.content;
    let row_of = |sample: &Sample| {
        horizon.unwrap_or_else(|| horizon_row(content, sample.width, sample.height).0)
    };
    let occupied = |sample: &Sample| -> Result<Option<f64>, CueError> {
        if sample.semantic.is_none() {
            return Ok(None);
        }
        let labels = evaluate::sample::load_labels(set, sample).map_err(failed(sample))?;
        Ok(Some(path_share(&labels, sample, row_of(sample))))
    };
    let chosen: Vec<(&Sample, Option<f64>)> = if ids.is_empty() {
        let shares: Vec<Option<f64>> =
            pool.install(|| samples.par_iter().map(occupied).collect::<Result<_, _>>())?;
        let count = count.min(samples.len());
        let mut order: Vec<usize> = if shares.iter().all(Option::is_some) {
            let mut order: Vec<usize> = (0..samples.len()).collect();
            let share = |index: usize| shares[index].unwrap_or(1.0);
            order.sort_by(|&a, &b| share(a).total_cmp(&share(b)).then(a.cmp(&b)));
            order.truncate(count);
            order
        } else {
            (0..count).map(|i| i * samples.len() / count).collect()
        };
        order.sort_unstable();
        order
            .into_iter()
            .map(|index| (&samples[index], shares[index]))
            .collect()
    } else {
        let find = |id: &String| {
            samples
                .iter()
                .find(|sample| sample.id == *id)
                .ok_or_else(|| CueError::NoSuchBackground {
                    set: folder.clone(),
                    id: id.clone(),
                })
        };
        ids.iter()
            .map(|id| find(id).and_then(|sample| Ok((sample, occupied(sample)?))))
            .collect::<Result<_, _>>()?
    };
    if chosen.len() < THESIS_BACKGROUNDS {
        return Err(few(chosen.len()));
    }
    let read = |(sample, occupied): &(&Sample, Option<f64>)| {
        let row = row_of(sample);
        // The experiments need ground below the horizon.
        if !(0.0..0.9 * f64::from(sample.height)).contains(&row) {
            return Err(CueError::Horizon {
                id: sample.id.clone(),
                row,
                height: sample.height,
            });
        }
        let image = evaluate::sample::load_image(set, sample).map_err(failed(sample))?;
        let focal_px = (sample.focal_px > 0.0).then_some(sample.focal_px);
        let baseline_m = match content {
            Content::Kitti | Content::Eigen => KITTI_BASELINE_M,
            _ => sample.baseline_m,
        };
        Ok(Background {
            id: sample.id.clone(),
            image,
            ground: Ground {
                width: sample.width,
                height: sample.height,
                horizon_row: row,
                focal_px,
            },
            rig: focal_px.filter(|_| baseline_m > 0.0).map(|focal_px| Rig {
                focal_px,
                baseline_m,
            }),
            occupied: *occupied,
        })
    };
    pool.install(|| chosen.par_iter().map(read).collect())
}

/// Share of humans and vehicles in the middle third below the horizon.
fn path_share(labels: &[u8], sample: &Sample, horizon: f64) -> f64 {
    let (width, first) = (sample.width as usize, horizon.max(0.0) as usize);
    let columns = width / 3..2 * width / 3;
    let (mut all, mut taken) = (0_u32, 0_u32);
    for row in labels.chunks_exact(width).skip(first) {
        for label in &row[columns.clone()] {
            all += 1;
            taken += u32::from(FOREGROUND_LABELS.contains(label));
        }
    }
    f64::from(taken) / f64::from(all.max(1))
}

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

/// How values of a map become depth.
#[derive(Clone, Copy, Debug)]
enum Reading {
    /// By the camera, in metres.
    Metres(Conversion, u32, f32),
    /// The median of the clean background's map over the value.
    Relative(f32),
}

/// A model's maps of one background as depth.
#[derive(Clone, Copy, Debug)]
pub struct Reader {
    reading: Reading,
    width: usize,
    height: usize,
}

impl Reader {
    /// `clean` is the model's map of the clean background.
    #[must_use]
    pub fn new(model: &Model, background: &Background, clean: &Plane) -> Self {
        let (meaning, input_width) = (
            model.description.output.meaning(),
            model.description.input.width,
        );
        let floor = match meaning {
            OutputMeaning::DisparityFraction => DISPARITY_FLOOR,
            OutputMeaning::DisparityPx => DISPARITY_FLOOR * input_width as f32,
            OutputMeaning::DepthM
            | OutputMeaning::InverseDepth
            | OutputMeaning::InverseDepthPerM => 0.0,
        };
        let metres = Conversion::new(Quantity::DepthM, meaning, input_width, background.rig);
        let reading = match metres {
            Ok(conversion) => Reading::Metres(conversion, background.ground.width, floor),
            Err(_) => {
                let mut values: Vec<f64> = clean.data.iter().copied().map(f64::from).collect();
                let median = strat_metrics::median(&mut values).unwrap_or(0.0) as f32;
                // A map without a positive value has no depth; 1 lets it be a constant.
                Reading::Relative(if median > 0.0 { median } else { 1.0 })
            }
        };
        Self {
            reading,
            width: background.ground.width as usize,
            height: background.ground.height as usize,
        }
    }

    /// What the depths are counted in.
    #[must_use]
    pub fn unit(&self) -> Unit {
        match self.reading {
            Reading::Metres(..) => Unit::M,
            Reading::Relative(_) => Unit::Relative,
        }
    }

    /// Depth at pixels of the full-size picture.
    #[must_use]
    pub fn depths(&self, map: &Plane, pixels: impl Iterator<Item = (usize, usize)>) -> Vec<f32> {
        let x_scale = map.width as f64 / self.width as f64;
        let y_scale = map.height as f64 / self.height as f64;
        let values: Vec<f32> = pixels
            .map(|(x, y)| {
                let (left, right, across) = neighbours(x, x_scale, map.width);
                let (upper, lower, down) = neighbours(y, y_scale, map.height);
                let along = |row: usize| {
                    let row = map.row(row);
                    row[left] * (1.0 - across) + row[right] * across
                };
                along(upper) * (1.0 - down) + along(lower) * down
            })
            .collect();
        self.convert(values)
    }

    /// The whole map at full size.
    #[must_use]
    pub fn whole(&self, map: &Plane) -> Plane {
        let (width, height) = (self.width, self.height);
        let pixels = (0..width * height).map(|index| (index % width, index / width));
        Plane {
            width,
            height,
            data: self.depths(map, pixels),
        }
    }

    fn convert(&self, mut values: Vec<f32>) -> Vec<f32> {
        match self.reading {
            Reading::Relative(median) => {
                for value in &mut values {
                    *value = median / value.max(RELATIVE_FLOOR * median);
                }
                values
            }
            Reading::Metres(conversion, image_width, floor) => {
                for value in &mut values {
                    *value = value.max(floor);
                }
                let line = Plane {
                    width: values.len(),
                    height: 1,
                    data: values,
                };
                let mut depth = conversion.apply(line, image_width).data;
                let [nearest, farthest] = DEPTH_RANGE_M;
                for value in &mut depth {
                    *value = value.clamp(nearest, farthest);
                }
                depth
            }
        }
    }
}

/// The two samples around a place of the larger grid and the weight of the second (PROTOCOL 3.3).
fn neighbours(index: usize, scale: f64, length: usize) -> (usize, usize, f32) {
    let place = (index as f64 + 0.5) * scale - 0.5;
    if place < 0.0 {
        return (0, 0, 0.0);
    }
    let low = (place as usize).min(length - 1);
    if low == length - 1 {
        return (low, low, 0.0);
    }
    (low, low + 1, (place - place.floor()) as f32)
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
    tensors: Vec<Vec<f32>>,
    masks: Vec<Mask>,
}

fn prepare(cast: &Cast, background: &Background, job: &Job, input: &InputDescription) -> Prepared {
    let mut tensors = Vec::with_capacity(job.composites.len());
    let mut masks = Vec::new();
    for (_, pastes) in &job.composites {
        let (picture, covered) = compose(cast, background, pastes);
        tensors.push(model::prepare_input(&picture, input));
        // All composites of a job cover the same pixels.
        masks = covered;
    }
    Prepared { tensors, masks }
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
        let tensor = model::prepare_input(&background.image, &model.description.input);
        match model.predict(&tensor) {
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

/// Asks a model about all composites of a plan.
pub fn run(
    model: &mut Model,
    cast: &Cast,
    backgrounds: &[Background],
    clean: &[Result<Plane, String>],
    jobs: &[Job],
    pool: &rayon::ThreadPool,
    progress: &Progress,
) -> Outcome {
    let input = model.description.input.clone();
    let name = model.name.clone();
    let readers: Vec<Option<Reader>> = backgrounds
        .iter()
        .zip(clean)
        .map(|(background, clean)| Some(Reader::new(model, background, clean.as_ref().ok()?)))
        .collect();
    let measure = |job: &Job, predicted: &Predicted| -> Result<Vec<CueRow>, String> {
        let clean = clean[job.background].as_ref().map_err(Clone::clone)?;
        let background = &backgrounds[job.background];
        Ok(readers[job.background].map_or_else(Vec::new, |reader| {
            measure(&name, job, cast, background, clean, reader, predicted)
        }))
    };
    let started = Instant::now();
    let mut outcome = Outcome::default();
    let chunks: Vec<&[Job]> = jobs.chunks(4 * pool.current_num_threads().max(1)).collect();
    // Three stages, one chunk apart, as in `crate::evaluate`.
    let mut prepared: Vec<Prepared> = Vec::new();
    let mut predicted: Vec<Result<Predicted, ModelError>> = Vec::new();
    let mut tried = 0;
    for step in 0..chunks.len() + 2 {
        let (to_measure, to_run) = (
            std::mem::take(&mut predicted),
            std::mem::take(&mut prepared),
        );
        let mut next_prepared = Vec::new();
        let mut measured: Vec<Result<Vec<CueRow>, String>> = Vec::new();
        let (name, measure) = (&name, &measure);
        let input = &input;
        pool.in_place_scope(|scope| {
            if let Some(&chunk) = chunks.get(step) {
                let next_prepared = &mut next_prepared;
                scope.spawn(move |_| {
                    *next_prepared = chunk
                        .par_iter()
                        .map(|job| prepare(cast, &backgrounds[job.background], job, input))
                        .collect();
                });
            }
            if let Some(&chunk) = step.checked_sub(2).and_then(|s| chunks.get(s)) {
                let measured = &mut measured;
                scope.spawn(move |_| {
                    *measured = chunk
                        .par_iter()
                        .zip(to_measure)
                        .map(|(job, predicted)| {
                            let predicted = predicted.map_err(|error| error.to_string())?;
                            measure(job, &predicted)
                        })
                        .collect();
                });
            }
            let asked = Instant::now();
            predicted = to_run
                .into_iter()
                .map(|Prepared { tensors, masks }| {
                    let maps = tensors
                        .iter()
                        .map(|tensor| model.predict(tensor))
                        .collect::<Result<_, _>>()?;
                    Ok(Predicted { maps, masks })
                })
                .collect();
            outcome.model += asked.elapsed();
        });
        prepared = next_prepared;
        if let Some(&chunk) = step.checked_sub(2).and_then(|s| chunks.get(s)) {
            tried += chunk.len();
            for (job, result) in chunk.iter().zip(measured) {
                match result {
                    Ok(rows) => outcome.rows.extend(rows),
                    Err(reason) => {
                        let background = backgrounds[job.background].id.clone();
                        progress.println(&format!(
                            "error: model {name}, background {background}: {reason}"
                        ));
                        outcome.failures.push(Failure { background, reason });
                    }
                }
            }
            progress.add(chunk.iter().map(|job| job.composites.len() as u64).sum());
        }
        if outcome.failures.len() >= HOPELESS_AFTER && outcome.rows.is_empty() {
            outcome.not_tried = jobs.len() - tried;
            break;
        }
    }
    outcome.wall = started.elapsed();
    outcome
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
    let bands = (job.experiment == Experiment::Occlusion)
        .then(|| predicted.masks.first().map(|rear| Bands::new(top, rear)))
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
    fn new(front: &Mask, rear: &Mask) -> Self {
        let rear = rear.without(front);
        let (inside, outside) = (front.near(&rear, BAND_PX), rear.near(front, BAND_PX));
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
