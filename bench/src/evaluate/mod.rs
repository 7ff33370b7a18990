//! From a prepared set and a predictor to one row per image and protocol.
//!
//! The path is PROTOCOL 3.3: the untouched left image is resized to the model's input size with
//! the model's own kernel, the model runs, its left map is resized bilinearly to the size of the
//! ground truth, and [`strat_metrics`] scores it. Decoding, resizing and scoring happen on
//! rayon's threads while the model runs on the calling thread, a bounded number of images ahead;
//! results come out in the order of the set and do not depend on the number of threads.
//!
//! A broken image costs itself only: it is named, left out, and reported as a [`Failure`].
//!
//! Not here: choosing protocols and writing files; see [`crate::evaluate::write`].

pub mod journal;
pub mod median;
pub mod predictions;
pub mod shards;
pub mod write;

use std::collections::BTreeSet;

use image::RgbImage;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use strat_metrics::{
    Camera, EvaluateError, GroundTruth, GroundTruthKind, Grouping, ImageScore, MeasuredPixels,
    PostProcessing, Protocol, Resize, Row, RowContext,
};
use strat_onnx::metadata::OutputMeaning;
use strat_store::{
    exr, files, image_files,
    progress::Progress,
    raster::Plane,
    resize,
    set::{FileRef, PreparedSet, Sample},
};

use crate::{
    evaluate::median::MedianDepth,
    evaluate::predictions::{SavedError, SavedPredictions},
    model::{self, InputDescription, Model, ModelError},
};

/// After this many failures without a single success the rest is not tried.
const HOPELESS_AFTER: usize = 10;

/// The median that inverse depth of unknown scale is brought to, as a disparity fraction: a
/// typical value, so that the protocol's disparity floor means what it means for other models.
/// Median scaling makes the choice irrelevant for the figures.
const TYPICAL_DISPARITY_FRACTION: f32 = 0.03;

/// Why one image has no row.
#[derive(Debug, thiserror::Error)]
pub enum SampleError {
    /// A file could not be read or decoded.
    #[error(transparent)]
    Store(#[from] strat_store::Error),
    /// A file is not the one that was prepared.
    #[error(
        "{path} has changed since the set was prepared (its BLAKE3 is not the one in test.csv); \
         prepare the set again"
    )]
    Changed {
        /// The file, relative to the set.
        path: String,
    },
    /// The set has no such file for this image.
    #[error("the prepared set has no {what} for this image")]
    Missing {
        /// What is missing.
        what: &'static str,
    },
    /// A file has another size than the row says.
    #[error("{path} is {found_width}x{found_height}, but test.csv says {width}x{height}")]
    Size {
        /// The file, relative to the set.
        path: String,
        /// Width of the file.
        found_width: usize,
        /// Height of the file.
        found_height: usize,
        /// Width in the row.
        width: u32,
        /// Height in the row.
        height: u32,
    },
    /// The model failed on this image.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// There is no usable saved prediction for this image.
    #[error(transparent)]
    Saved(#[from] SavedError),
    /// Ground truth that is none.
    #[error("{path}: {source}")]
    GroundTruth {
        /// The file, relative to the set.
        path: String,
        /// Why.
        source: EvaluateError,
    },
    /// The image cannot be scored under a protocol.
    #[error("{protocol}: {source}")]
    Evaluate {
        /// Name of the protocol.
        protocol: String,
        /// Why.
        source: EvaluateError,
    },
}

/// An image without a row, or with fewer rows than protocols.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Failure {
    /// Name of the model.
    pub model: String,
    /// Image id.
    pub image: String,
    /// A sentence.
    pub reason: String,
}

/// What predicts.
pub enum Predictor<'a> {
    /// A network.
    Model(&'a mut Model),
    /// What a network once gave. There is no mirrored image, so protocols with post-processing
    /// are not for it.
    Saved(&'a SavedPredictions),
    /// The same depth map for every image.
    MedianDepth(&'a MedianDepth),
}

/// What is to be evaluated, the same for all predictors of a run.
pub struct Task<'a> {
    /// The prepared set.
    pub set: &'a PreparedSet,
    /// Its test samples, in order.
    pub samples: &'a [Sample],
    /// Protocols with the context of their rows.
    pub protocols: &'a [(Protocol, RowContext)],
    /// Ids of samples of which a picture is wanted.
    pub pictures: &'a BTreeSet<String>,
}

/// Is told what an evaluation has found while it goes on, in the order of the images, on the
/// calling thread. An error ends the evaluation.
pub trait Observer {
    /// Why it goes no further.
    type Error;

    /// A network gave this disparity as a fraction of image width, at network size; `None` from
    /// networks that give something else.
    ///
    /// # Errors
    /// The evaluation is to end.
    fn predicted(
        &mut self,
        image: &str,
        disparity_fraction: Option<&Plane>,
    ) -> Result<(), Self::Error>;

    /// These are all rows of one image.
    ///
    /// # Errors
    /// The evaluation is to end.
    fn scored(&mut self, rows: &[Row]) -> Result<(), Self::Error>;
}

/// Everything needed to draw one comparison.
#[derive(Clone, Debug)]
pub struct Comparison {
    /// Image id.
    pub image: String,
    /// The left image at full resolution.
    pub input: RgbImage,
    /// Predicted disparity as a fraction of image width, at the size of the image.
    pub predicted: Plane,
    /// True disparity as a fraction of image width, 0 = none.
    pub truth: Plane,
    /// Depth in metres at a disparity of the whole width, by the first protocol's camera.
    pub depth_at_width_m: f32,
    /// Where the first protocol scales by medians: the true depths in metres between which it
    /// takes them.
    pub median_within_m: Option<(f32, f32)>,
}

/// The outcome of one predictor.
#[derive(Debug, Default)]
pub struct Evaluation {
    /// Rows in the order protocol, image, group.
    pub rows: Vec<Row>,
    /// What went wrong, in the order of the images.
    pub failures: Vec<Failure>,
    /// Comparisons of the images that were asked for.
    pub comparisons: Vec<Comparison>,
    /// The run was given up because nothing worked.
    pub gave_up: bool,
}

/// A prediction at network size.
#[derive(Clone, Debug)]
enum Prediction {
    /// Disparity as a fraction of image width.
    DisparityFraction(Plane),
    /// Inverse depth in 1/m.
    InverseDepthPerM(Plane),
    /// Depth in metres, resized as depth: the form a model of depth gives.
    DepthM(Plane),
    /// Depth in metres of a baseline; becomes the disparity of each image's camera first.
    ConstantDepthM(Plane),
}

/// Predictions that need no network.
#[derive(Clone, Copy)]
enum Given<'a> {
    Saved(&'a SavedPredictions),
    MedianDepth(&'a MedianDepth),
}

/// What [`model::prepare_input`] gives, on its way to the network; the image itself where a
/// picture is wanted.
struct Prepared {
    tensor: Vec<f32>,
    image: Option<RgbImage>,
}

/// A prediction on its way to the metrics.
struct Predicted {
    plain: Prediction,
    /// Blended with the prediction for the mirrored image, where a protocol asks for it.
    flipped: Option<Prediction>,
    image: Option<RgbImage>,
}

/// The scores of one image, by protocol.
struct Scored {
    scores: Vec<Result<Vec<ImageScore>, SampleError>>,
    comparison: Option<Comparison>,
}

/// Predicts and scores all samples of a task.
///
/// # Errors
/// Only what the observer returns; everything that concerns one image is a [`Failure`].
pub fn evaluate<O: Observer>(
    task: &Task<'_>,
    name: &str,
    predictor: &mut Predictor<'_>,
    pool: &rayon::ThreadPool,
    progress: &Progress,
    observer: &mut O,
) -> Result<Evaluation, O::Error> {
    let mut collector = Collector {
        task,
        name,
        progress,
        images: 0,
        rows: vec![Vec::new(); task.protocols.len()],
        outcome: Evaluation::default(),
    };
    match predictor {
        Predictor::Model(model) => run_network(&mut collector, model, pool, observer)?,
        Predictor::Saved(saved) => {
            score_given(&mut collector, Given::Saved(saved), pool, observer)?
        }
        Predictor::MedianDepth(median) => {
            score_given(&mut collector, Given::MedianDepth(median), pool, observer)?;
        }
    }
    let Collector {
        rows, mut outcome, ..
    } = collector;
    outcome.rows = rows.into_iter().flatten().collect();
    Ok(outcome)
}

/// Each image from its files to its scores on one thread, a chunk at a time.
fn score_given<O: Observer>(
    collector: &mut Collector<'_>,
    given: Given<'_>,
    pool: &rayon::ThreadPool,
    observer: &mut O,
) -> Result<(), O::Error> {
    let task = collector.task;
    // All threads wait for the last one of a chunk; scores are small, so chunks may be large.
    for chunk in task.samples.chunks(32 * pool.current_num_threads().max(1)) {
        let score_one = |sample: &Sample| Ok(score(task, sample, take_given(task, sample, given)?));
        let scored = pool.install(|| chunk.par_iter().map(score_one).collect());
        collector.add(chunk, scored, observer)?;
        if collector.is_hopeless() {
            break;
        }
    }
    Ok(())
}

/// Three stages, one chunk apart: while one chunk is decoded and another is scored on the pool, the
/// one between runs through the network here.
fn run_network<O: Observer>(
    collector: &mut Collector<'_>,
    model: &mut Model,
    pool: &rayon::ThreadPool,
    observer: &mut O,
) -> Result<(), O::Error> {
    let task = collector.task;
    let flip = task
        .protocols
        .iter()
        .any(|(protocol, _)| protocol.post_processing == PostProcessing::Flip);
    let input = &model.description.input.clone();
    let chunk_size = 2 * pool.current_num_threads().max(1);
    let chunks: Vec<&[Sample]> = task.samples.chunks(chunk_size).collect();
    let mut prepared: Vec<Result<Prepared, SampleError>> = Vec::new();
    let mut predicted: Vec<Result<Predicted, SampleError>> = Vec::new();
    for step in 0..chunks.len() + 2 {
        let (mut next_prepared, mut next_predicted) = (Vec::new(), Vec::new());
        let mut scored: Vec<Result<Scored, SampleError>> = Vec::new();
        let to_score = std::mem::take(&mut predicted);
        let to_run = std::mem::take(&mut prepared);
        let mut told = Ok(());
        pool.in_place_scope(|scope| {
            if let Some(chunk) = chunks.get(step) {
                let next_prepared = &mut next_prepared;
                scope.spawn(move |_| {
                    *next_prepared = chunk
                        .par_iter()
                        .map(|sample| prepare(task, sample, input))
                        .collect();
                });
            }
            if let Some(chunk) = step.checked_sub(2).and_then(|s| chunks.get(s)) {
                let scored = &mut scored;
                scope.spawn(move |_| {
                    *scored = chunk
                        .par_iter()
                        .zip(to_score)
                        .map(|(sample, predicted)| Ok(score(task, sample, predicted?)))
                        .collect();
                });
            }
            if let Some(chunk) = step.checked_sub(1).and_then(|s| chunks.get(s)) {
                for (sample, prepared) in chunk.iter().zip(to_run) {
                    let result = prepared.and_then(|prepared| run(model, prepared, flip));
                    if let (Ok(()), Ok(Predicted { plain, .. })) = (&told, &result) {
                        let disparity = match plain {
                            Prediction::DisparityFraction(plane) => Some(plane),
                            _ => None,
                        };
                        told = observer.predicted(&sample.id, disparity);
                    }
                    next_predicted.push(result);
                }
            }
        });
        told?;
        prepared = next_prepared;
        predicted = next_predicted;
        if let Some(chunk) = step.checked_sub(2).and_then(|s| chunks.get(s)) {
            collector.add(chunk, scored, observer)?;
        }
        if collector.is_hopeless() {
            break;
        }
    }
    Ok(())
}

/// Puts results together in the order of the images.
struct Collector<'a> {
    task: &'a Task<'a>,
    name: &'a str,
    progress: &'a Progress,
    /// Images so far.
    images: usize,
    /// By protocol.
    rows: Vec<Vec<Row>>,
    outcome: Evaluation,
}

impl Collector<'_> {
    fn add<O: Observer>(
        &mut self,
        chunk: &[Sample],
        scored: Vec<Result<Scored, SampleError>>,
        observer: &mut O,
    ) -> Result<(), O::Error> {
        for (sample, scored) in chunk.iter().zip(scored) {
            let own = collect(self.task, self.name, sample, scored, &mut self.outcome);
            observer.scored(&own.concat())?;
            for (rows, own) in self.rows.iter_mut().zip(own) {
                rows.extend(own);
            }
            self.images += 1;
            self.progress.add(1);
        }
        Ok(())
    }

    /// Whether nothing has worked so far, so that the rest need not be tried.
    fn is_hopeless(&mut self) -> bool {
        let hopeless =
            self.outcome.failures.len() >= HOPELESS_AFTER && self.rows.iter().all(Vec::is_empty);
        self.outcome.gave_up = hopeless && self.images < self.task.samples.len();
        hopeless
    }
}

/// Makes rows of the result of one image, by protocol, and puts the rest where it belongs.
fn collect(
    task: &Task<'_>,
    name: &str,
    sample: &Sample,
    scored: Result<Scored, SampleError>,
    outcome: &mut Evaluation,
) -> Vec<Vec<Row>> {
    let mut rows = Vec::new();
    let mut fail = |error: SampleError| {
        outcome.failures.push(Failure {
            model: name.to_owned(),
            image: sample.id.clone(),
            reason: error.to_string(),
        });
    };
    match scored {
        Err(error) => fail(error),
        Ok(scored) => {
            for (result, (_, context)) in scored.scores.into_iter().zip(task.protocols) {
                let scores = result.unwrap_or_else(|error| {
                    fail(error);
                    Vec::new()
                });
                let row = |score| Row::new(context, sample.id.clone(), score);
                rows.push(scores.into_iter().map(row).collect());
            }
            outcome.comparisons.extend(scored.comparison);
        }
    }
    rows
}

/// The image that a model is shown: the untouched one where the set has it.
pub(crate) fn load_image(set: &PreparedSet, sample: &Sample) -> Result<RgbImage, SampleError> {
    let file = sample.left_full.as_ref().unwrap_or(&sample.left);
    let image = image_files::decode_rgb(&checked_bytes(set, file)?, &file.path)?;
    if sample.left_full.is_some() && image.dimensions() != (sample.width, sample.height) {
        return Err(SampleError::Size {
            path: file.path.clone(),
            found_width: image.width() as usize,
            found_height: image.height() as usize,
            width: sample.width,
            height: sample.height,
        });
    }
    Ok(image)
}

fn prepare(
    task: &Task<'_>,
    sample: &Sample,
    input: &InputDescription,
) -> Result<Prepared, SampleError> {
    let image = load_image(task.set, sample)?;
    Ok(Prepared {
        tensor: model::prepare_input(&image, input),
        image: task.pictures.contains(&sample.id).then_some(image),
    })
}

fn take_given(
    task: &Task<'_>,
    sample: &Sample,
    given: Given<'_>,
) -> Result<Predicted, SampleError> {
    let plain = match given {
        Given::Saved(saved) => {
            let map = saved.map(&sample.id)?;
            let width = map.width as f32;
            as_prediction(map, saved.meaning(), width)
        }
        Given::MedianDepth(median) => Prediction::ConstantDepthM(median.depth_m.clone()),
    };
    // The image is for the picture alone; without it there is none.
    let wanted = task.pictures.contains(&sample.id);
    let image = wanted.then(|| load_image(task.set, sample).ok()).flatten();
    Ok(Predicted {
        plain,
        // There is no prediction for the mirrored image.
        flipped: None,
        image,
    })
}

/// Runs the model once, or twice where flip post-processing is wanted as well.
fn run(model: &mut Model, prepared: Prepared, flip: bool) -> Result<Predicted, SampleError> {
    let Prepared { mut tensor, image } = prepared;
    let plain = model.predict(&tensor)?;
    let mut flipped = None;
    if flip {
        model::mirror_input(&mut tensor, &model.description.input);
        let mirrored = model.predict(&tensor)?;
        flipped = Some(Plane {
            data: strat_metrics::flip_blend(&plain.data, &mirrored.data, plain.width),
            ..plain
        });
    }
    let width = model.description.input.width as f32;
    let meaning = model.description.output.meaning();
    Ok(Predicted {
        plain: as_prediction(plain, meaning, width),
        flipped: flipped.map(|plane| as_prediction(plane, meaning, width)),
        image,
    })
}

/// Brings numbers of depth into one of the forms that can be scored. `input_width` is what
/// disparity in pixels is relative to.
fn as_prediction(mut plane: Plane, meaning: OutputMeaning, input_width: f32) -> Prediction {
    match meaning {
        OutputMeaning::DisparityFraction => Prediction::DisparityFraction(plane),
        OutputMeaning::DisparityPx => {
            for value in &mut plane.data {
                *value /= input_width;
            }
            Prediction::DisparityFraction(plane)
        }
        OutputMeaning::InverseDepth => {
            let mut values: Vec<f64> = plane.data.iter().copied().map(f64::from).collect();
            let median = strat_metrics::median(&mut values).unwrap_or(0.0) as f32;
            // A map without a positive median is scored as it is and fails on its own merits.
            if median > 0.0 {
                for value in &mut plane.data {
                    *value *= TYPICAL_DISPARITY_FRACTION / median;
                }
            }
            Prediction::DisparityFraction(plane)
        }
        OutputMeaning::InverseDepthPerM => Prediction::InverseDepthPerM(plane),
        OutputMeaning::DepthM => Prediction::DepthM(plane),
    }
}

/// What is known of an image under one kind of ground truth.
struct Truth {
    depth: Plane,
    disparity_px: Option<Vec<f32>>,
    /// Where it was measured, for all protocols.
    measured: MeasuredPixels,
    /// Focal length that made depth out of disparity, for stereo ground truth.
    nominal_focal_px: f64,
}

/// Loads what a protocol needs and no protocol before it has loaded.
fn load_needed(
    set: &PreparedSet,
    sample: &Sample,
    protocol: &Protocol,
    truths: &mut Vec<(GroundTruthKind, Truth)>,
    labels: &mut Option<Vec<u8>>,
) -> Result<(), SampleError> {
    let kind = protocol.ground_truth;
    if !truths.iter().any(|(known, _)| *known == kind) {
        truths.push((kind, load_truth(set, sample, kind)?));
    }
    if protocol.grouping == Grouping::Cityscapes && labels.is_none() {
        *labels = Some(load_labels(set, sample)?);
    }
    Ok(())
}

fn load_truth(
    set: &PreparedSet,
    sample: &Sample,
    kind: GroundTruthKind,
) -> Result<Truth, SampleError> {
    let (file, what) = match kind {
        GroundTruthKind::StereoNoc => (&sample.depth_noc, "disp_noc ground truth"),
        GroundTruthKind::StereoOcc => (&sample.depth_occ, "disp_occ ground truth"),
        GroundTruthKind::VelodyneX => (&sample.depth_velodyne, "Velodyne ground truth"),
        GroundTruthKind::CameraZ => (&sample.depth_camera, "camera-z ground truth"),
        GroundTruthKind::Annotated => (&sample.depth_annotated, "KITTI depth ground truth"),
        GroundTruthKind::Laser => (&sample.depth_laser, "laser ground truth"),
    };
    let file = file.as_ref().ok_or(SampleError::Missing { what })?;
    let bytes = checked_bytes(set, file)?;
    let (depth, header) = exr::decode_depth(&bytes, &set.path(file))?;
    // The laser measured a grid of its own.
    if kind != GroundTruthKind::Laser
        && (depth.width, depth.height) != (sample.width as usize, sample.height as usize)
    {
        return Err(SampleError::Size {
            path: file.path.clone(),
            found_width: depth.width,
            found_height: depth.height,
            width: sample.width,
            height: sample.height,
        });
    }
    // Measured disparities are multiples of 1/256 px, so they come back exactly.
    let disparity_px: Option<Vec<f32>> = kind.is_stereo().then(|| {
        let focal_baseline = header.focal_px * header.baseline_m;
        depth
            .data
            .iter()
            .map(|&depth_m| {
                if depth_m > 0.0 {
                    let units = (256.0 * focal_baseline / f64::from(depth_m)).round();
                    (units / 256.0) as f32
                } else {
                    0.0
                }
            })
            .collect()
    });
    let unusable = |source| SampleError::GroundTruth {
        path: file.path.clone(),
        source,
    };
    let measured = MeasuredPixels::find(&GroundTruth {
        width: depth.width,
        height: depth.height,
        depth_m: &depth.data,
        disparity_px: disparity_px.as_deref(),
        focal_px: header.focal_px,
        baseline_m: header.baseline_m,
        labels: None,
        measured: None,
    })
    .map_err(unusable)?;
    Ok(Truth {
        measured,
        depth,
        disparity_px,
        nominal_focal_px: header.focal_px,
    })
}

/// Scores one prediction under all protocols.
fn score(task: &Task<'_>, sample: &Sample, predicted: Predicted) -> Scored {
    let mut truths: Vec<(GroundTruthKind, Truth)> = Vec::new();
    let mut labels = None;
    let (width, height) = (sample.width as usize, sample.height as usize);
    let mut scores = Vec::with_capacity(task.protocols.len());
    let mut comparison = None;
    // Most predictions do not depend on the protocol's camera, so they are resized once.
    let resize_once = |prediction: &Prediction| match prediction {
        Prediction::DisparityFraction(plane)
        | Prediction::InverseDepthPerM(plane)
        | Prediction::DepthM(plane) => Some(resize::bilinear_f32(plane, width, height)),
        Prediction::ConstantDepthM(_) => None,
    };
    let shared_plain = resize_once(&predicted.plain);
    let shared_flipped = predicted.flipped.as_ref().and_then(resize_once);
    for (protocol, _) in task.protocols {
        // 45 of the 697 images were never given such depth: no failure, the protocol is about the
        // other 652 (PROTOCOL 1.2).
        if protocol.ground_truth == GroundTruthKind::Annotated && sample.depth_annotated.is_none() {
            scores.push(Ok(Vec::new()));
            continue;
        }
        // What one protocol lacks does not cost the others their rows.
        let needed = load_needed(task.set, sample, protocol, &mut truths, &mut labels);
        if let Err(error) = needed {
            scores.push(Err(error));
            continue;
        }
        let Some((_, truth)) = truths
            .iter()
            .find(|(kind, _)| *kind == protocol.ground_truth)
        else {
            continue;
        };
        let (focal_px, baseline_m) = match protocol.camera {
            Camera::Nominal { baseline_m } => (truth.nominal_focal_px, baseline_m),
            Camera::Calibrated => (sample.focal_px, sample.baseline_m),
            Camera::Agreed {
                focal_fraction,
                baseline_m,
            } => (focal_fraction * f64::from(sample.width), baseline_m),
            Camera::Unknown => (f64::from(sample.width), 1.0),
        };
        let (truth_width, truth_height) = (truth.depth.width, truth.depth.height);
        let ground_truth = GroundTruth {
            width: truth_width,
            height: truth_height,
            depth_m: &truth.depth.data,
            disparity_px: truth.disparity_px.as_deref(),
            focal_px,
            baseline_m,
            labels: labels.as_deref(),
            measured: Some(&truth.measured),
        };
        // Depth in metres to disparity as a fraction of image width and back.
        let focal_baseline_fraction = (focal_px * baseline_m / f64::from(sample.width)) as f32;
        let (prediction, shared) = match (&predicted.flipped, protocol.post_processing) {
            (Some(flipped), PostProcessing::Flip) => (flipped, &shared_flipped),
            _ => (&predicted.plain, &shared_plain),
        };
        let to_truth = |plane: &Plane| match protocol.resize {
            Resize::DisparityBilinear => resize::bilinear_f32(plane, truth_width, truth_height),
            Resize::DepthNearest => nearest(plane, truth_width, truth_height),
        };
        let as_shared = protocol.resize == Resize::DisparityBilinear
            && (truth_width, truth_height) == (width, height);
        let mut own;
        let resized = match (shared, prediction) {
            (Some(plane), _) if as_shared => plane,
            (_, Prediction::ConstantDepthM(plane)) => {
                own = to_truth(&reciprocal(plane, focal_baseline_fraction));
                &own
            }
            (
                _,
                Prediction::DisparityFraction(plane)
                | Prediction::InverseDepthPerM(plane)
                | Prediction::DepthM(plane),
            ) => {
                own = to_truth(plane);
                &own
            }
        };
        // Inverse depth in metres becomes disparity with whatever camera the protocol assumes.
        let resized = if let Prediction::InverseDepthPerM(_) = prediction {
            own = Plane {
                data: resized
                    .data
                    .iter()
                    .map(|value| value * focal_baseline_fraction)
                    .collect(),
                ..*resized
            };
            &own
        } else {
            resized
        };
        let gives_depth = matches!(prediction, Prediction::DepthM(_));
        let result = if gives_depth {
            strat_metrics::evaluate_depth(protocol, &ground_truth, &resized.data)
        } else {
            strat_metrics::evaluate(protocol, &ground_truth, &resized.data)
        };
        scores.push(result.map_err(|source| SampleError::Evaluate {
            protocol: protocol.name.clone(),
            source,
        }));
        if comparison.is_none()
            && let Some(input) = &predicted.image
        {
            let predicted = if gives_depth {
                reciprocal(resized, focal_baseline_fraction)
            } else {
                resized.clone()
            };
            let true_disparity = reciprocal(&truth.depth, focal_baseline_fraction);
            // A laser's grid is coarser than the image.
            let (predicted, true_disparity) = if (truth_width, truth_height) == (width, height) {
                (predicted, true_disparity)
            } else {
                (
                    resize::bilinear_f32(&predicted, width, height),
                    nearest(&true_disparity, width, height),
                )
            };
            comparison = Some(Comparison {
                image: sample.id.clone(),
                input: input.clone(),
                predicted,
                truth: true_disparity,
                depth_at_width_m: focal_baseline_fraction,
                median_within_m: protocol
                    .median_scaling
                    .then_some(if protocol.mask_ground_truth {
                        (protocol.min_depth_m as f32, protocol.max_depth_m as f32)
                    } else {
                        (0.0, f32::INFINITY)
                    }),
            });
        }
    }
    Scored { scores, comparison }
}

/// The nearest sample for the centre of each pixel of another size.
fn nearest(source: &Plane, width: usize, height: usize) -> Plane {
    // (i + 1/2) * from / to, rounded down, in whole numbers.
    let place = |i: usize, from: usize, to: usize| ((2 * i + 1) * from / (2 * to)).min(from - 1);
    let mut data = Vec::with_capacity(width * height);
    for row in 0..height {
        let start = place(row, source.height, height) * source.width;
        data.extend(
            (0..width).map(|column| source.data[start + place(column, source.width, width)]),
        );
    }
    Plane {
        width,
        height,
        data,
    }
}

/// Depth to disparity or back: `factor / value`, where 0 stays 0 (no measurement).
fn reciprocal(plane: &Plane, factor: f32) -> Plane {
    Plane {
        width: plane.width,
        height: plane.height,
        data: plane
            .data
            .iter()
            .map(|&value| if value > 0.0 { factor / value } else { 0.0 })
            .collect(),
    }
}

pub(crate) fn load_labels(set: &PreparedSet, sample: &Sample) -> Result<Vec<u8>, SampleError> {
    let file = sample.semantic.as_ref().ok_or(SampleError::Missing {
        what: "semantic labels",
    })?;
    let bytes = checked_bytes(set, file)?;
    let (width, height, labels) = image_files::decode_gray8(&bytes, &file.path)?;
    if (width, height) != (sample.width as usize, sample.height as usize) {
        return Err(SampleError::Size {
            path: file.path.clone(),
            found_width: width,
            found_height: height,
            width: sample.width,
            height: sample.height,
        });
    }
    Ok(labels)
}

/// The bytes of a file of the set, which must be those that were prepared.
pub(crate) fn checked_bytes(set: &PreparedSet, file: &FileRef) -> Result<Vec<u8>, SampleError> {
    let bytes = files::read(&set.path(file))?;
    if files::blake3_hex(&bytes) == file.blake3 {
        Ok(bytes)
    } else {
        Err(SampleError::Changed {
            path: file.path.clone(),
        })
    }
}
