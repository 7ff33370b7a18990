//! Holds predictions against those of the accuracy path, and times queries.

use std::{
    path::PathBuf,
    time::{Duration, Instant},
};

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use strat_store::{image_files, raster::Plane, resize};

use super::rows::Stage;
use crate::{
    model::{self, InputDescription, Model, ModelError, ModelInput},
    quantity::{Conversion, NoSuchQuantity, Quantity, StereoCamera, default_quantity},
    runtime::process::Transport,
};

/// Images of a set that are used, spread evenly: as many as stay in memory without harm.
pub const MAX_IMAGES: usize = 64;

/// Queries before the clock starts.
pub const WARM_UP: u64 = 5;

/// Largest difference to the accuracy path, relative to the largest value of the prediction.
/// Sums in another order differ by about 1e-6; another image or a wrong layer by far more.
pub const AGREEMENT: f32 = 1e-4;

/// Why there is no measurement.
#[derive(Debug, thiserror::Error)]
pub enum LatencyError {
    /// A file could not be read.
    #[error(transparent)]
    Store(#[from] strat_store::Error),
    /// The model failed.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The map cannot be made.
    #[error(transparent)]
    Quantity(#[from] NoSuchQuantity),
    /// What would be timed is not what is evaluated.
    #[error(
        "with {threads} thread(s) and a batch of {batch} the prediction for {} differs from that \
         of the accuracy path by {difference:.1e} of its largest value (more than {AGREEMENT:.0e}); \
         such a run is not timed",
        image.display()
    )]
    Differs {
        /// Threads of the session.
        threads: usize,
        /// Images in the batch.
        batch: usize,
        /// The image.
        image: PathBuf,
        /// Largest difference divided by the largest magnitude.
        difference: f32,
    },
    /// Images that the model takes in several sizes.
    #[error(
        "the size of the model's input depends on the image: {}x{} for {}, {}x{} for {}; time images of \
         one size",
        size.0, size.1, first.display(), other.0, other.1, image.display()
    )]
    Sizes {
        /// The first image.
        first: PathBuf,
        /// Width and height for it.
        size: (u32, u32),
        /// One of another size.
        image: PathBuf,
        /// Width and height for that.
        other: (u32, u32),
    },
    /// The runtime computes something else than what was trained.
    #[error("{0}; a runtime that computes something else is not timed")]
    Probe(String),
}

/// When a measurement is long enough; both must be reached.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Minimum {
    /// Seconds.
    pub seconds: f64,
    /// Queries; images in the offline scenario.
    pub queries: u64,
}

impl Default for Minimum {
    /// LoadGen's own defaults.
    fn default() -> Self {
        Self {
            seconds: 10.0,
            queries: 100,
        }
    }
}

/// An image to be timed.
#[derive(Clone, Debug, PartialEq)]
pub struct ImageFile {
    /// The file.
    pub path: PathBuf,
    /// Its camera, where it is known.
    pub camera: Option<StereoCamera>,
}

/// Predictions that are compared, at minimum.
const COMPARED: usize = 4;

/// Latencies in milliseconds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Latencies {
    /// Arithmetic mean.
    pub mean_ms: f64,
    /// Shortest.
    pub min_ms: f64,
    /// The value at the index `floor(n / 2)`.
    pub p50_ms: f64,
    /// The value at the index `floor(0.9 n)`, LoadGen's figure for single stream.
    pub p90_ms: f64,
    /// The value at the index `floor(0.95 n)`.
    pub p95_ms: f64,
    /// The value at the index `floor(0.99 n)`, LoadGen's figure for multi stream.
    pub p99_ms: f64,
    /// Longest.
    pub max_ms: f64,
}

impl Latencies {
    /// Of the latencies of all queries; none when there are none.
    #[must_use]
    pub fn of(latencies: &[Duration]) -> Option<Self> {
        let mut sorted = latencies.to_vec();
        sorted.sort_unstable();
        let ms = |duration: Duration| duration.as_secs_f64() * 1e3;
        let at = |percent| percentile(&sorted, percent).map(ms);
        Some(Self {
            mean_ms: ms(sorted.iter().sum::<Duration>()) / sorted.len() as f64,
            min_ms: ms(*sorted.first()?),
            p50_ms: at(50)?,
            p90_ms: at(90)?,
            p95_ms: at(95)?,
            p99_ms: at(99)?,
            max_ms: ms(*sorted.last()?),
        })
    }
}

/// The value at the index `floor(n * percent / 100)` of ascending values, as LoadGen takes it; the
/// largest for 100 and above, none of nothing.
#[must_use]
pub fn percentile<T: Copy>(ascending: &[T], percent: usize) -> Option<T> {
    let index = ascending.len() * percent / 100;
    ascending.get(index).or(ascending.last()).copied()
}

/// One measurement.
#[derive(Clone, Debug, PartialEq)]
pub struct Measured {
    /// Queries that were timed.
    pub queries: u64,
    /// Images in them.
    pub images: u64,
    /// From the first query's beginning to the last one's end.
    pub seconds: f64,
    /// Of the queries.
    pub latencies: Option<Latencies>,
}

/// The images and what the accuracy path says about them.
pub struct Bench {
    /// Those that can be used.
    files: Vec<ImageFile>,
    /// Sentences about those that cannot.
    broken: Vec<(PathBuf, LatencyError)>,
    quantity: Quantity,
    /// What the model takes of every image; all of one size.
    inputs: Vec<ModelInput>,
    /// Of the first images: the prediction at network size.
    references: Vec<Plane>,
}

impl Bench {
    /// Decodes all images and predicts the first ones with `model`, which is the reference. An image that
    /// cannot be used costs itself only; see [`Self::broken`].
    ///
    /// # Errors
    /// No image can be used, or the model fails.
    ///
    /// # Panics
    /// If there are no images.
    pub fn new(
        files: &[ImageFile],
        model: &mut Model,
        batches: &[usize],
    ) -> Result<Self, LatencyError> {
        assert!(!files.is_empty(), "there must be images");
        let input = &model.description.input;
        let prepared: Vec<Result<ModelInput, LatencyError>> =
            files.par_iter().map(|file| prepare(file, input)).collect();
        let (mut usable, mut inputs, mut broken) = (Vec::new(), Vec::new(), Vec::new());
        for (file, prepared) in files.iter().zip(prepared) {
            match prepared {
                Ok(input) => {
                    usable.push(file.clone());
                    inputs.push(input);
                }
                Err(error) => broken.push((file.path.clone(), error)),
            }
        }
        if inputs.is_empty() && !broken.is_empty() {
            return Err(broken.swap_remove(0).1);
        }
        let files = usable;
        let size = inputs[0].size;
        if let Some(other) = inputs.iter().position(|input| input.size != size) {
            return Err(LatencyError::Sizes {
                first: files[0].path.clone(),
                size,
                image: files[other].path.clone(),
                other: inputs[other].size,
            });
        }
        let meaning = model.description.output.meaning();
        let camera = files.iter().all(|file| file.camera.is_some());
        let quantity = default_quantity(meaning, files[0].camera.filter(|_| camera));
        let compared = batches
            .iter()
            .copied()
            .fold(COMPARED, usize::max)
            .min(files.len());
        let references = inputs[..compared]
            .iter()
            .map(|input| model.predict(input))
            .collect::<Result<Vec<_>, _>>()?;
        Ok(Self {
            files,
            broken,
            quantity,
            inputs,
            references,
        })
    }

    /// The images that cannot be used, with the reasons.
    #[must_use]
    pub fn broken(&self) -> &[(PathBuf, LatencyError)] {
        &self.broken
    }

    /// Images that are timed.
    #[must_use]
    pub fn images(&self) -> usize {
        self.files.len()
    }

    /// Width and height of the network's input.
    #[must_use]
    pub fn input_size(&self) -> (u32, u32) {
        self.inputs[0].size
    }

    /// The name of the stage that begins with a file.
    #[must_use]
    pub fn file_stage(&self) -> Stage {
        match self.quantity {
            Quantity::DepthM => Stage::FileToDepth,
            Quantity::InverseDepth => Stage::FileToInverseDepth,
            Quantity::DisparityPx | Quantity::DisparityFraction => Stage::FileToDisparity,
        }
    }

    /// Holds the first predictions of `model`, made in batches, against the accuracy path, and
    /// returns the largest difference.
    ///
    /// # Errors
    /// The model fails, or predicts something else.
    pub fn verify(
        &self,
        model: &mut Model,
        threads: usize,
        batch: usize,
    ) -> Result<f32, LatencyError> {
        let mut worst = 0.0_f32;
        let mut first = 0;
        while first < self.references.len() {
            let images: Vec<usize> = (first..first + batch).collect();
            let inputs = images
                .iter()
                .map(|image| &self.inputs[image % self.inputs.len()]);
            let planes = model.predict_batch(&inputs.collect::<Vec<_>>())?;
            for (image, plane) in images.iter().zip(&planes) {
                // A batch may reach beyond the compared images, or go round.
                let Some(reference) = self.references.get(image % self.files.len()) else {
                    continue;
                };
                let difference = difference(reference, plane);
                if difference.is_nan() || difference > AGREEMENT {
                    return Err(LatencyError::Differs {
                        threads,
                        batch,
                        image: self.files[image % self.files.len()].path.clone(),
                        difference,
                    });
                }
                worst = worst.max(difference);
            }
            first += batch;
        }
        Ok(worst)
    }

    /// Tensors of some images, one behind the other; indices go round.
    fn joined(&self, images: &[usize]) -> Vec<f32> {
        images
            .iter()
            .flat_map(|image| &self.inputs[image % self.inputs.len()].tensor)
            .copied()
            .collect()
    }

    /// Times the session alone.
    ///
    /// # Errors
    /// The model fails.
    pub fn time_session(
        &self,
        model: &mut Model,
        batch: usize,
        minimum: Minimum,
        clock: impl FnMut() -> Duration,
    ) -> Result<Measured, LatencyError> {
        let rounds = self.inputs.len().div_ceil(batch);
        let inputs: Vec<Vec<f32>> = (0..rounds)
            .map(|round| {
                let images: Vec<usize> = (round * batch..(round + 1) * batch).collect();
                self.joined(&images)
            })
            .collect();
        let size = self.input_size();
        let mut query = |number: u64| {
            let input = &inputs[number as usize % inputs.len()];
            model
                .run(input, size, batch)
                .map(|output| drop(std::hint::black_box(output)))
        };
        for number in 0..WARM_UP {
            query(number)?;
        }
        Ok(repeat(minimum, batch, clock, query)?)
    }

    /// Times the way from file to map, `per_query` images at a time: decoding and resizing on the
    /// pool, the session in batches between them.
    ///
    /// # Errors
    /// A file cannot be read any more, or the model fails.
    pub fn time_files(
        &self,
        model: &mut Model,
        batch: usize,
        per_query: usize,
        pool: &rayon::ThreadPool,
        minimum: Minimum,
        clock: impl FnMut() -> Duration,
    ) -> Result<Measured, LatencyError> {
        let mut query = |number: u64| {
            let first = (number as usize).wrapping_mul(per_query);
            let images: Vec<usize> = (first..first + per_query).collect();
            self.file_query(model, &images, batch, pool)
                .map(|maps| drop(std::hint::black_box(maps)))
        };
        let warm_up = WARM_UP.div_ceil(per_query as u64);
        for number in 0..warm_up {
            query(number)?;
        }
        repeat(minimum, per_query, clock, query)
    }

    /// Files to maps; the number of images is a multiple of the batch.
    fn file_query(
        &self,
        model: &mut Model,
        images: &[usize],
        batch: usize,
        pool: &rayon::ThreadPool,
    ) -> Result<Vec<Plane>, LatencyError> {
        let input = &model.description.input;
        let file = |image: &usize| &self.files[image % self.files.len()];
        let prepared: Vec<ModelInput> = pool.install(|| {
            images
                .par_iter()
                .map(|image| prepare(file(image), input))
                .collect::<Result<_, _>>()
        })?;
        let mut planes = Vec::with_capacity(images.len());
        for chunk in prepared.chunks(batch) {
            planes.extend(model.predict_batch(&chunk.iter().collect::<Vec<_>>())?);
        }
        let (meaning, width) = (
            model.description.output.meaning(),
            model.description.input.disparity_width(),
        );
        pool.install(|| {
            images
                .par_iter()
                .zip(planes)
                .zip(prepared)
                .map(|((image, plane), input)| {
                    let size = input.image;
                    let conversion =
                        Conversion::new(self.quantity, meaning, width, file(image).camera)?;
                    let full = resize::bilinear_f32(&plane, size.0 as usize, size.1 as usize);
                    Ok(conversion.apply(full, size.0))
                })
                .collect()
        })
    }
}

/// A file as the model's input.
fn prepare(file: &ImageFile, input: &InputDescription) -> Result<ModelInput, LatencyError> {
    let image = image_files::read_rgb(&file.path)?;
    let focal_px = file.camera.map(|camera| camera.focal_px);
    Ok(model::prepare_input(&image, input, focal_px)?)
}

/// Largest difference, relative to the largest magnitude of the reference.
fn difference(reference: &Plane, other: &Plane) -> f32 {
    if (reference.width, reference.height) != (other.width, other.height) {
        return f32::INFINITY;
    }
    let largest = reference
        .data
        .iter()
        .fold(0.0_f32, |most, v| most.max(v.abs()));
    let worst = reference
        .data
        .iter()
        .zip(&other.data)
        .map(|(a, b)| (a - b).abs())
        .fold(
            0.0_f32,
            |most, d| if most.is_nan() || d <= most { most } else { d },
        );
    if worst == 0.0 { 0.0 } else { worst / largest }
}

/// Sends queries one after the other until both limits are reached.
///
/// `clock` tells the time since some beginning; it is read before and after every query.
fn repeat<E>(
    minimum: Minimum,
    images_per_query: usize,
    mut clock: impl FnMut() -> Duration,
    mut query: impl FnMut(u64) -> Result<(), E>,
) -> Result<Measured, E> {
    let mut latencies = Vec::new();
    let begin = clock();
    let mut end = begin;
    let mut queries = 0;
    while queries < minimum.queries.max(1) || (end - begin).as_secs_f64() < minimum.seconds {
        let sent = clock();
        query(queries)?;
        end = clock();
        latencies.push(end - sent);
        queries += 1;
    }
    Ok(Measured {
        queries,
        images: queries * images_per_query as u64,
        seconds: (end - begin).as_secs_f64(),
        latencies: Latencies::of(&latencies),
    })
}

/// A clock for [`Bench::time_session`] and [`Bench::time_files`], which stands still while tensors go
/// to the process of a model and back: that is the price of this program's protection, not of the model.
pub fn clock(transport: Transport) -> impl FnMut() -> Duration {
    let (begin, before) = (Instant::now(), transport.so_far());
    move || begin.elapsed().saturating_sub(transport.so_far() - before)
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn ms(milliseconds: u64) -> Duration {
        Duration::from_millis(milliseconds)
    }

    /// LoadGen's `sample_latencies[sample_count * percentile]`: of 1 to 100 the 90th percentile
    /// is 91, where the usual nearest rank would give 90.
    #[test]
    fn percentiles_are_loadgens() {
        let hundred: Vec<u32> = (1..=100).collect();
        for (percent, value) in [(0, 1), (50, 51), (90, 91), (95, 96), (99, 100), (100, 100)] {
            assert_eq!(percentile(&hundred, percent), Some(value), "{percent}");
        }
        let seven = [10, 20, 30, 40, 50, 60, 70];
        // 3.5, 6.3 and 6.93 rounded down are the indices 3, 6 and 6.
        for (percent, value) in [(50, 40), (90, 70), (99, 70)] {
            assert_eq!(percentile(&seven, percent), Some(value), "{percent}");
        }
        assert_eq!(percentile(&[5], 99), Some(5));
        assert_eq!(percentile::<u32>(&[], 50), None);
    }

    #[test]
    fn latencies_are_sorted_and_in_milliseconds() {
        let found = Latencies::of(&[ms(30), ms(10), ms(20), ms(40)]).unwrap();
        assert_eq!(
            [found.min_ms, found.p50_ms, found.p90_ms, found.max_ms],
            [10.0, 30.0, 40.0, 40.0]
        );
        assert!((found.mean_ms - 25.0).abs() < 1e-9);
        assert_eq!(Latencies::of(&[]), None);
    }

    /// A clock that stands still except while a query runs.
    fn run(minimum: Minimum, query_ms: u64, images: usize) -> Measured {
        let now = std::cell::Cell::new(ms(500));
        repeat(
            minimum,
            images,
            || now.get(),
            |_| {
                now.set(now.get() + ms(query_ms));
                Ok::<(), ()>(())
            },
        )
        .unwrap()
    }

    #[test]
    fn both_limits_must_be_reached() {
        let minimum = |seconds, queries| Minimum { seconds, queries };
        // Duration decides: 1 s of 100 ms.
        let measured = run(minimum(1.0, 3), 100, 4);
        assert_eq!((measured.queries, measured.images), (10, 40));
        assert!((measured.seconds - 1.0).abs() < 1e-9);
        // The number decides.
        let measured = run(minimum(0.1, 30), 100, 1);
        assert_eq!(measured.queries, 30);
        let latencies = measured.latencies.unwrap();
        assert!((latencies.p99_ms - 100.0).abs() < 1e-9);
        // Something is always measured.
        assert_eq!(run(minimum(0.0, 0), 1, 1).queries, 1);
    }

    #[test]
    fn a_failing_query_ends_the_measurement() {
        let minimum = Minimum {
            seconds: 0.0,
            queries: 10,
        };
        let clock = || Duration::ZERO;
        let outcome = repeat(minimum, 1, clock, |number| {
            if number < 3 { Ok(()) } else { Err(number) }
        });
        assert_eq!(outcome.unwrap_err(), 3);
    }

    #[test]
    fn differences_are_relative_and_notice_what_is_no_number() {
        let plane = |data: &[f32]| Plane::new(data.len(), 1, data.to_vec()).unwrap();
        let reference = plane(&[0.1, -0.4]);
        assert_eq!(difference(&reference, &reference), 0.0);
        let found = difference(&reference, &plane(&[0.1, -0.2]));
        assert!((found - 0.5).abs() < 1e-6, "{found}");
        assert_eq!(difference(&reference, &plane(&[0.1])), f32::INFINITY);
        assert!(difference(&reference, &plane(&[f32::NAN, -0.4])).is_nan());
        // Nothing but zeros agrees with itself alone.
        assert_eq!(difference(&plane(&[0.0]), &plane(&[0.0])), 0.0);
        assert!(difference(&plane(&[0.0]), &plane(&[0.1])).is_infinite());
    }
}
