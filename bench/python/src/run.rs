//! The test images of a prepared set, measured while a network predicts them.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

use image::RgbImage;
use numpy::PyReadonlyArray2;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use strat_bench::evaluate::SampleError;
use strat_bench::evaluate::in_memory::InMemoryRun;
use strat_bench::evaluate::write;
use strat_metrics::tables::{Coverage, Source};
use strat_metrics::{FurtherMetric, Metric, leaderboard};

use crate::arrays::{of_image, plane};
use crate::errors::raised;
use crate::evaluate::Meaning;
use crate::prefetch::Prefetch;
use crate::rows::Rows;

/// One run of one model.
#[pyclass(frozen, module = "strat._strat")]
pub struct Run {
    run: Arc<InMemoryRun>,
}

#[pymethods]
impl Run {
    #[new]
    fn new(
        py: Python<'_>,
        data: PathBuf,
        model: String,
        protocols: Option<Vec<String>>,
        meaning: Meaning,
        metrics: bool,
    ) -> PyResult<Self> {
        let description = meaning.description()?;
        let run = py.detach(|| {
            InMemoryRun::open(&data, &model, protocols.as_deref(), description, metrics)
                .map_err(raised)
        })?;
        Ok(Self { run: Arc::new(run) })
    }

    /// Ids of the test images, in the order of the set.
    fn ids(&self) -> Vec<&str> {
        let samples = self.run.samples().iter();
        samples.map(|sample| sample.id.as_str()).collect()
    }

    /// Names of the protocols that it measures under.
    fn protocols(&self) -> Vec<&str> {
        let protocols = self.run.protocols();
        protocols.map(|protocol| protocol.name.as_str()).collect()
    }

    /// All test images, read ahead by threads.
    fn images(&self, threads: usize) -> PyResult<Images> {
        let run = Arc::clone(&self.run);
        let read = move |index| run.image(index);
        let count = self.run.samples().len();
        let ahead = Prefetch::new(threads, count, read).map_err(raised)?;
        Ok(Images {
            run: Arc::clone(&self.run),
            ahead: Mutex::new((0, ahead)),
        })
    }

    /// Measures the map of one image; says what the first images let suspect.
    fn add(
        &self,
        py: Python<'_>,
        image: &str,
        map: PyReadonlyArray2<'_, f32>,
    ) -> PyResult<Vec<String>> {
        let map = plane(&map)?;
        py.detach(|| self.run.add(image, map).map_err(raised))
    }

    /// Ids of the images without a map.
    fn missing(&self) -> Vec<String> {
        self.run.missing()
    }

    /// Images without a row, or with fewer rows than protocols: id and reason.
    fn failures(&self, py: Python<'_>) -> Vec<(String, String)> {
        let outcome = py.detach(|| self.run.outcome());
        let failures = outcome.failures.into_iter();
        failures
            .map(|failure| (failure.image, failure.reason))
            .collect()
    }

    /// Reasons to doubt the numbers, in sentences.
    fn warnings(&self, py: Python<'_>) -> Vec<String> {
        py.detach(|| self.run.outcome()).record.warnings
    }

    fn rows(&self, py: Python<'_>) -> Rows {
        let outcome = py.detach(|| self.run.outcome());
        let data = &outcome.record.data;
        Rows {
            coverage: Coverage {
                expected_images: data.test_images_expected,
                source: Source::from(data.source.as_str()),
            },
            rows: outcome.rows,
        }
    }

    /// What `bench --table` prints.
    fn table(&self, py: Python<'_>) -> PyResult<String> {
        py.detach(|| write::text(&self.run.outcome(), self.run.tables()).map_err(raised))
    }

    /// Lines of protocol, group, name of the value, and the value.
    #[allow(clippy::type_complexity, reason = "a line of a table")]
    fn summary(
        &self,
        py: Python<'_>,
    ) -> PyResult<Vec<(String, Option<String>, &'static str, Mean)>> {
        py.detach(|| {
            let outcome = self.run.outcome();
            let expected = outcome.record.data.test_images_expected;
            let mut lines = Vec::new();
            for protocol in self.run.protocols() {
                let entries = leaderboard::measured(&outcome.rows, &protocol.name, expected);
                for entry in entries.map_err(raised)? {
                    let images = entry.images.unwrap_or_default();
                    let group = entry.group.map(|group| group.to_string());
                    let means = Metric::ALL.into_iter().map(Metric::name);
                    let means = means.zip(entry.metrics.into_iter().zip(entry.intervals));
                    let further = FurtherMetric::ALL.into_iter().map(FurtherMetric::name);
                    let values = entry.further.into_iter().zip(entry.further_intervals);
                    let means = means.chain(further.zip(values));
                    let more = [
                        (
                            "rmse_pooled",
                            (entry.rmse_pooled, entry.rmse_pooled_interval),
                        ),
                        ("d1_all", (entry.d1_all, entry.d1_all_interval)),
                    ];
                    for (name, (value, interval)) in means.chain(more) {
                        let Some(value) = value else { continue };
                        let bounds = interval.map(|interval| (interval.low, interval.high));
                        let mean = (value, bounds, images);
                        lines.push((protocol.name.clone(), group.clone(), name, mean));
                    }
                }
            }
            Ok(lines)
        })
    }

    /// Writes the files of a run and returns reasons to doubt its numbers.
    fn write(
        &self,
        py: Python<'_>,
        out: PathBuf,
        incomplete: bool,
        force: bool,
    ) -> PyResult<Vec<String>> {
        let outcome = py.detach(|| self.run.write(&out, incomplete, force));
        Ok(outcome.map_err(raised)?.record.warnings)
    }
}

/// A mean over images, the bounds of its 95 % interval, and how many images.
type Mean = (f64, Option<(f64, f64)>, u64);

/// The test images one by one.
#[pyclass(frozen, module = "strat._strat")]
pub struct Images {
    run: Arc<InMemoryRun>,
    /// The next index, and what is being read.
    ahead: Mutex<(usize, Prefetch<Result<RgbImage, SampleError>>)>,
}

#[pymethods]
impl Images {
    /// Id, image, focal length in pixels and baseline in metres.
    fn next<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyDict>>> {
        // The lock is never held with the interpreter's.
        let next = py.detach(|| {
            let mut ahead = self.ahead.lock().unwrap_or_else(PoisonError::into_inner);
            let (index, prefetch) = &mut *ahead;
            let image = prefetch.take()?;
            *index += 1;
            Some((*index - 1, image))
        });
        let Some((index, image)) = next else {
            return Ok(None);
        };
        let sample = &self.run.samples()[index];
        let item = PyDict::new(py);
        item.set_item("id", &sample.id)?;
        item.set_item("image", of_image(py, image.map_err(raised)?)?)?;
        item.set_item("focal_px", sample.focal_px)?;
        item.set_item("baseline_m", sample.baseline_m)?;
        Ok(Some(item))
    }
}
