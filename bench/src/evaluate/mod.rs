//! From a prepared set and a predictor to one row per image and protocol, and the files of a run.
//!
//! The path is PROTOCOL 3.3: the untouched left image ([`sample`]) is resized to the model's input
//! size with the model's own kernel, the model runs, its left map is resized bilinearly to the size
//! of the ground truth, and [`strat_metrics`] scores it ([`score`](mod@score)). Where a
//! protocol says so, the model is shown a crop ([`crate::view`]); which protocols fit a model's numbers is
//! in [`fitting`]. [`pipeline`] overlaps these steps; results come out in the order of the set and do not depend on the number of threads.
//! Beside networks there are [`predictions`] in files and the [`median`] baseline.
//! [`plan`](mod@plan) says what a set can be measured by, [`record`] what a run leaves behind,
//! [`write`](mod@write) writes it; [`run`](mod@run) is one run of several models, [`journal`] lets it go on after an
//! interruption, [`shards`] puts the parts of a divided one together.
//!
//! A broken image costs itself only: it is named, left out, and reported as a [`Failure`].
//!
//! Not here: metrics and rules ([`strat_metrics`]), and what a model's tensors mean
//! ([`crate::model`]).

pub mod agreed;
pub mod agreement;
pub mod comparison;
pub mod findings;
pub mod fitting;
pub mod identity;
pub mod in_memory;
pub mod journal;
pub mod median;
pub mod ownership;
pub mod pipeline;
pub mod plan;
mod prediction;
pub mod predictions;
pub mod record;
pub mod request;
pub mod run;
pub mod sample;
pub mod score;
pub mod shards;
pub mod suspicion;
pub mod write;

use std::{collections::BTreeSet, ops::ControlFlow, path::PathBuf};

use image::RgbImage;
use strat_metrics::{PostProcessing, Protocol, Row, RowContext};
use strat_onnx::metadata::OutputMeaning;
use strat_store::{
    progress::Progress,
    raster::Plane,
    set::{PreparedSet, Sample},
};

use crate::{
    model::{self, InputDescription, Model, ModelInput, ValueEncoding},
    view::View,
};
use agreement::ImageAgreement;
use median::MedianDepth;
use pipeline::MAX_INITIAL_FAILURES;
use prediction::{Prediction, Seen};
use predictions::SavedPredictions;
use record::Failure;
use sample::{Scene, load_image};
use score::{Attention, Predicted, Scored};
use suspicion::{FIRST_IMAGES, Look};

pub use comparison::Comparison;
pub use sample::SampleError;

/// A model or saved predictions on the command line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NamedFile {
    /// Name in tables and figures.
    pub name: String,
    /// File or folder.
    pub file: PathBuf,
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

impl Predictor<'_> {
    /// What its numbers are; none of a baseline.
    fn encoding(&self) -> Option<ValueEncoding> {
        match self {
            Self::Model(model) => Some(model.description.output.encoding()),
            Self::Saved(saved) => Some(saved.description.encoding()),
            Self::MedianDepth(_) => None,
        }
    }

    /// Its maps hold depth in metres, where 0 is none.
    #[must_use]
    pub fn gives_depth(&self) -> bool {
        let meaning = match self {
            Self::Model(model) => model.description.output.meaning(),
            Self::Saved(saved) => saved.meaning(),
            // Becomes disparity before it is scored.
            Self::MedianDepth(_) => return false,
        };
        meaning == OutputMeaning::DepthM
    }
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
    /// The metrics of PROTOCOL 10.3 are wanted as well.
    pub further: bool,
    /// Predictions for whole images are wanted, whatever the protocols score.
    pub whole: bool,
}

impl Task<'_> {
    /// What a network has to be shown of each image.
    fn views(&self) -> Vec<View> {
        let mut views: Vec<View> = self.whole.then_some(View::Whole).into_iter().collect();
        for (protocol, _) in self.protocols {
            let view = View::under(protocol);
            if !views.contains(&view) {
                views.push(view);
            }
        }
        views
    }

    fn score(&self, sample: &Sample, predicted: Predicted) -> Scored {
        let scene = Scene::of_set(self.set, sample);
        score::score(scene, self.protocols, predicted, self.further)
    }
}

impl Task<'_> {
    /// After the first images it is said what is suspected.
    fn attention(&self, sample: &Sample) -> Attention {
        let mut first = self.samples.iter().take(FIRST_IMAGES);
        Attention::of(first.any(|first| first.id == sample.id))
    }
}

/// Is told what an evaluation has found while it goes on, in the order of the images, on the
/// calling thread. An error ends the evaluation.
///
/// `()` is for a second look at images whose rows stand already.
pub trait Observer {
    /// Why it goes no further.
    type Error;

    /// What the first images let suspect is said.
    const IS_FIRST_LOOK: bool = true;

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

    /// These are all rows of one image, and how its depth lies beside the truth.
    ///
    /// # Errors
    /// The evaluation is to end.
    fn scored(
        &mut self,
        rows: &[Row],
        agreement: Option<ImageAgreement>,
    ) -> Result<(), Self::Error>;
}

/// Why not all images were tried.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GaveUp {
    /// The first images all failed.
    Failing,
    /// The first image shows that no map is what its description says.
    Refused,
    /// The process that ran the model is over.
    Over,
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
    /// How depth lies beside the truth, by the ids of images, for those that could be scored.
    pub agreements: Vec<(String, ImageAgreement)>,
    /// What the first images show, by their ids.
    pub looks: Vec<(String, Look)>,
    /// What is suspected after the first images; said already.
    pub suspicions: Vec<String>,
    /// Why the rest was not tried.
    pub gave_up: Option<GaveUp>,
}

impl Observer for () {
    type Error = std::convert::Infallible;
    const IS_FIRST_LOOK: bool = false;

    fn predicted(&mut self, _: &str, _: Option<&Plane>) -> Result<(), Self::Error> {
        Ok(())
    }

    fn scored(&mut self, _: &[Row], _: Option<ImageAgreement>) -> Result<(), Self::Error> {
        Ok(())
    }
}

/// Why no further images are taken.
enum Ended<E> {
    /// Nothing has worked.
    Failing,
    /// The first image shows that no map is what it is said to be.
    Refused,
    /// The process that ran the model is over.
    Over,
    /// The observer wants no more.
    ByObserver(E),
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
        encoding: predictor.encoding().filter(|_| O::IS_FIRST_LOOK),
        task,
        name,
        progress,
        images: 0,
        rows: vec![Vec::new(); task.protocols.len()],
        outcome: Evaluation::default(),
    };
    let ended = match predictor {
        Predictor::Model(model) => run_network(&mut collector, model, pool, observer),
        Predictor::Saved(saved) => {
            let take = |sample: &Sample| {
                let map = saved.map_of(sample)?;
                let width = map.width as f32;
                let prediction = Prediction::new(map, saved.meaning(), width);
                Ok(Seen::new(saved.description.crop, prediction, None))
            };
            let has_scale = saved.meaning().has_scale();
            score_given(&mut collector, take, has_scale, pool, observer)
        }
        Predictor::MedianDepth(median) => {
            let take = |_: &Sample| {
                let prediction = Prediction::ConstantDepthM(median.depth_m.clone());
                Ok(Seen::new(View::Whole, prediction, None))
            };
            score_given(&mut collector, take, true, pool, observer)
        }
    };
    collector.suspect();
    let Collector {
        rows,
        mut outcome,
        images,
        ..
    } = collector;
    match ended {
        ControlFlow::Continue(()) => {}
        ControlFlow::Break(Ended::Refused) => outcome.gave_up = Some(GaveUp::Refused),
        ControlFlow::Break(Ended::Over) => outcome.gave_up = Some(GaveUp::Over),
        ControlFlow::Break(Ended::Failing) => {
            outcome.gave_up = (images < task.samples.len()).then_some(GaveUp::Failing);
        }
        ControlFlow::Break(Ended::ByObserver(error)) => return Err(error),
    }
    outcome.rows = rows.into_iter().flatten().collect();
    Ok(outcome)
}

/// Each image from its files to its scores on one thread.
fn score_given<O: Observer>(
    collector: &mut Collector<'_>,
    take: impl Fn(&Sample) -> Result<Seen, SampleError> + Sync,
    has_scale: bool,
    pool: &rayon::ThreadPool,
    observer: &mut O,
) -> ControlFlow<Ended<O::Error>> {
    let task = collector.task;
    pipeline::run(
        task.samples,
        // All threads wait for the last one of a chunk; scores are small, so chunks may be large.
        16 * pipeline::chunk_size(pool),
        pool,
        |_| (),
        |_, ()| ControlFlow::Continue(()),
        |sample, ()| {
            // There is no prediction for the mirrored image.
            let seen = take(sample)?;
            // The image is for the picture alone; without it there is none.
            let wanted = task.pictures.contains(&sample.id);
            let image = wanted.then(|| load_image(task.set, sample).ok()).flatten();
            let predicted = Predicted {
                seen: vec![seen],
                is_cut: true,
                has_scale,
                image,
                attention: task.attention(sample),
            };
            Ok(task.score(sample, predicted))
        },
        |sample, scored| collector.add(sample, scored, observer),
    )
}

fn run_network<O: Observer>(
    collector: &mut Collector<'_>,
    model: &mut Model,
    pool: &rayon::ThreadPool,
    observer: &mut O,
) -> ControlFlow<Ended<O::Error>> {
    let task = collector.task;
    let mut protocols = task.protocols.iter();
    let flip = protocols.any(|(protocol, _)| protocol.post_processing == PostProcessing::Flip);
    let input = model.description.input.clone();
    let views = task.views();
    // Both stages on the calling thread tell it what they have.
    let observer = std::cell::RefCell::new(observer);
    pipeline::run(
        task.samples,
        pipeline::chunk_size(pool),
        pool,
        |sample| prepare(task, sample, &input, &views),
        |sample, prepared| {
            if model.has_ended() {
                return ControlFlow::Break(Ended::Over);
            }
            let attention = task.attention(sample);
            let result = prepared.and_then(|prepared| predict(model, prepared, flip, attention));
            if let Ok(Predicted { seen, .. }) = &result {
                let whole = seen.iter().find(|seen| seen.view == View::Whole);
                let disparity = match whole.map(Seen::plain) {
                    Some(Prediction::DisparityFraction(plane)) => Some(plane),
                    _ => None,
                };
                if let Err(error) = observer.borrow_mut().predicted(&sample.id, disparity) {
                    return ControlFlow::Break(Ended::ByObserver(error));
                }
            }
            ControlFlow::Continue(result)
        },
        |sample, predicted| Ok(task.score(sample, predicted?)),
        |sample, scored| collector.add(sample, scored, &mut **observer.borrow_mut()),
    )
}

/// What [`model::prepare_input`] gives, by what is seen of the image, on its way to the network; the
/// image itself where a picture is wanted.
struct Prepared {
    inputs: Vec<(View, ModelInput)>,
    image: Option<RgbImage>,
}

fn prepare(
    task: &Task<'_>,
    sample: &Sample,
    input: &InputDescription,
    views: &[View],
) -> Result<Prepared, SampleError> {
    let image = load_image(task.set, sample)?;
    let focal_px = Some(sample.focal_px).filter(|focal_px| *focal_px > 0.0);
    let mut inputs = Vec::with_capacity(views.len());
    for &view in views {
        let prepared = match view {
            View::Whole => model::prepare_input(&image, input, focal_px)?,
            // What cannot be cut is missed by the protocols that need it, and by them alone.
            View::KittiBenchmark => match view.cut(&image, (sample.width, sample.height)) {
                Ok(cut) => model::prepare_input(&cut, input, focal_px)?,
                Err(_) => continue,
            },
        };
        inputs.push((view, prepared));
    }
    Ok(Prepared {
        inputs,
        image: task.pictures.contains(&sample.id).then_some(image),
    })
}

/// Runs the model once for each view, or twice where flip post-processing is wanted as well.
fn predict(
    model: &mut Model,
    prepared: Prepared,
    flip: bool,
    attention: Attention,
) -> Result<Predicted, SampleError> {
    let width = model.description.input.disparity_width() as f32;
    let meaning = model.description.output.meaning();
    let mut seen = Vec::with_capacity(prepared.inputs.len());
    for (view, mut input) in prepared.inputs {
        let plain = model.predict(&input)?;
        let mut flipped = None;
        if flip {
            model::mirror_input(&mut input, &model.description.input);
            let mirrored = model.predict(&input)?;
            flipped = Some(Plane {
                data: strat_metrics::flip_blend(&plain.data, &mirrored.data, plain.width),
                ..plain
            });
        }
        let prediction = |plane| Prediction::new(plane, meaning, width);
        seen.push(Seen::new(view, prediction(plain), flipped.map(prediction)));
    }
    Ok(Predicted {
        seen,
        is_cut: false,
        has_scale: meaning.has_scale(),
        image: prepared.image,
        attention,
    })
}

/// Puts results together in the order of the images.
struct Collector<'a> {
    task: &'a Task<'a>,
    name: &'a str,
    progress: &'a Progress,
    /// What the numbers are; none of a baseline, which is not suspected.
    encoding: Option<ValueEncoding>,
    /// Images so far.
    images: usize,
    /// By protocol.
    rows: Vec<Vec<Row>>,
    outcome: Evaluation,
}

impl Collector<'_> {
    fn add<O: Observer>(
        &mut self,
        sample: &Sample,
        scored: Result<Scored, SampleError>,
        observer: &mut O,
    ) -> ControlFlow<Ended<O::Error>> {
        let is_first = self.images == 0;
        let is_refused = is_first && scored.as_ref().is_err_and(SampleError::condemns_all);
        let agreement = scored.as_ref().ok().and_then(|scored| scored.agreement);
        let own = self.rows_of(sample, scored);
        if let Err(error) = observer.scored(&own.concat(), agreement) {
            return ControlFlow::Break(Ended::ByObserver(error));
        }
        for (rows, own) in self.rows.iter_mut().zip(own) {
            rows.extend(own);
        }
        self.images += 1;
        if self.images == FIRST_IMAGES {
            self.suspect();
        }
        self.progress.add(1);
        if is_refused {
            return ControlFlow::Break(Ended::Refused);
        }
        let failed = self.outcome.failures.len() >= MAX_INITIAL_FAILURES;
        if failed && self.rows.iter().all(Vec::is_empty) {
            return ControlFlow::Break(Ended::Failing);
        }
        ControlFlow::Continue(())
    }

    /// Says what is suspected after the first images, or after all where there are fewer.
    fn suspect(&mut self) {
        let Some(encoding) = self.encoding.take() else {
            return;
        };
        let looks = self.outcome.looks.iter().map(|(_, look)| look.clone());
        let looks: Vec<Look> = looks.collect();
        for text in suspicion::suspicions(&looks, &encoding) {
            let text = format!("{}: {text}", self.name);
            self.progress.println(&format!("warning: {text}"));
            self.outcome.suspicions.push(text);
        }
    }

    /// Makes rows of the result of one image, by protocol, and puts the rest where it belongs.
    fn rows_of(&mut self, sample: &Sample, scored: Result<Scored, SampleError>) -> Vec<Vec<Row>> {
        let outcome = &mut self.outcome;
        let mut fail = |error: SampleError| {
            outcome.failures.push(Failure {
                model: self.name.to_owned(),
                image: sample.id.clone(),
                reason: error.to_string(),
            });
        };
        let Scored {
            scores,
            agreement,
            look,
            comparison,
        } = match scored {
            Ok(scored) => scored,
            Err(error) => {
                fail(error);
                return Vec::new();
            }
        };
        let mut rows = Vec::with_capacity(scores.len());
        for (result, (_, context)) in scores.into_iter().zip(self.task.protocols) {
            let scores = result.unwrap_or_else(|error| {
                fail(error);
                Vec::new()
            });
            let row = |score| Row::new(context, sample.id.clone(), score);
            rows.push(scores.into_iter().map(row).collect());
        }
        outcome.comparisons.extend(comparison);
        let agreement = agreement.map(|agreement| (sample.id.clone(), agreement));
        outcome.agreements.extend(agreement);
        let look = look.map(|look| (sample.id.clone(), look));
        outcome.looks.extend(look);
        rows
    }
}
