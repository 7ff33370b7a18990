//! One image, scored in memory.

use std::borrow::Cow;

use numpy::PyReadonlyArray2;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use strat_bench::evaluate::in_memory::evaluate_map;
use strat_bench::evaluate::predictions::SavedDescription;
use strat_bench::evaluate::sample::truth_of_depth;
use strat_bench::model::Sigmoid;
use strat_bench::protocol_file::resolve;
use strat_geometry::{NOMINAL_BASELINE_M, depth_from_disparity_px, nominal_focal_px};
use strat_metrics::{Camera, Protocol, Row, RowContext, StereoCamera};
use strat_onnx::metadata::OutputMeaning;

use crate::arrays::{contiguous, plane, size, values};
use crate::errors::raised;
use crate::rows::score_dict;

/// What the numbers of a map are, as the words of Python say it.
#[derive(FromPyObject)]
pub struct Meaning {
    meaning: String,
    sigmoid: Option<(f64, f64)>,
    scale: Option<f64>,
    stretched: bool,
}

impl Meaning {
    /// The same as a description of saved predictions says it.
    pub fn description(self) -> PyResult<SavedDescription> {
        let known = OutputMeaning::ALL.into_iter();
        let meaning = known.clone().find(|known| known.as_str() == self.meaning);
        let meaning = meaning.ok_or_else(|| {
            let words: Vec<&str> = known.map(OutputMeaning::as_str).collect();
            PyValueError::new_err(format!(
                "unknown meaning \"{}\"; known: {}",
                self.meaning,
                words.join(", ")
            ))
        })?;
        let sigmoid = self.sigmoid.map(|(min_depth, max_depth)| Sigmoid {
            min_depth,
            max_depth,
        });
        Ok(SavedDescription {
            sigmoid,
            scale: self.scale,
            stretched: self.stretched,
            ..SavedDescription::plain(meaning)
        })
    }
}

/// Scores of a prediction under protocols, a dict each, in the order of the protocols and groups.
#[pyfunction]
#[allow(clippy::too_many_arguments, reason = "Python names each of them")]
pub fn evaluate<'py>(
    py: Python<'py>,
    prediction: PyReadonlyArray2<'py, f32>,
    truth: PyReadonlyArray2<'py, f32>,
    protocols: Vec<String>,
    meaning: Meaning,
    camera: Option<(f64, f64)>,
    truth_is_disparity: bool,
    labels: Option<PyReadonlyArray2<'py, u8>>,
    metrics: bool,
) -> PyResult<Vec<Bound<'py, PyDict>>> {
    let map = plane(&prediction)?;
    let description = meaning.description()?;
    let protocols: Vec<Protocol> = protocols
        .iter()
        .map(|name| resolve(name).map_err(raised))
        .collect::<PyResult<_>>()?;
    let truth_size = size(&truth);
    let stereo = stereo_camera(&protocols, truth_size.0)?;
    let truth = contiguous(&truth)?;
    let depth_m = match (truth_is_disparity, stereo) {
        (false, _) => Cow::Borrowed(truth),
        (true, Some(camera)) => Cow::Owned(depth_of(truth, camera)),
        (true, None) => {
            return Err(PyValueError::new_err(
                "only protocols of stereo 2015 compare with disparity; give the truth as depth in metres",
            ));
        }
    };
    let calibration = calibration(&protocols, &description, camera)?;
    // While the interpreter is held nobody writes to it; the little that was measured is kept.
    let truth = truth_of_depth(truth_size, &depth_m, calibration, stereo);
    let mut truth = truth.map_err(raised)?;
    if let Some(labels) = labels {
        truth.set_labels(values(&labels)).map_err(raised)?;
    }
    let scores =
        py.detach(|| evaluate_map(&protocols, truth, map, &description, metrics).map_err(raised))?;
    scores
        .into_iter()
        .map(|(protocol, score)| {
            let context = RowContext {
                protocol,
                ..RowContext::default()
            };
            score_dict(py, &Row::new(&context, "", score))
        })
        .collect()
}

/// The camera that made depth out of the disparity of stereo 2015, for protocols that compare with it.
fn stereo_camera(protocols: &[Protocol], width: usize) -> PyResult<Option<StereoCamera>> {
    let of_stereo = |protocol: &&Protocol| protocol.ground_truth.is_stereo();
    match protocols.iter().filter(of_stereo).count() {
        0 => Ok(None),
        count if count < protocols.len() => Err(PyValueError::new_err(
            "one truth cannot be that of stereo 2015 and a scan; evaluate under protocols of one kind",
        )),
        _ => {
            let focal_px = u32::try_from(width).ok().and_then(nominal_focal_px);
            let focal_px = focal_px.ok_or_else(|| {
                PyValueError::new_err(format!(
                    "the nominal focal length of stereo 2015 is known for images 1242, 1241, 1238 and \
                     1224 pixels wide, and this truth is {width} wide"
                ))
            })?;
            Ok(Some(StereoCamera {
                focal_px,
                baseline_m: NOMINAL_BASELINE_M,
            }))
        }
    }
}

/// Depth in metres as `prep` makes it of disparity in pixels; 0 and what is no disparity stay.
fn depth_of(disparity_px: &[f32], camera: StereoCamera) -> Vec<f32> {
    let StereoCamera {
        focal_px,
        baseline_m,
    } = camera;
    let depth_m = |&disparity: &f32| {
        if disparity > 0.0 {
            depth_from_disparity_px(focal_px, baseline_m, f64::from(disparity)) as f32
        } else {
            disparity
        }
    };
    disparity_px.iter().map(depth_m).collect()
}

/// The image's own camera, which a protocol may do without.
fn calibration(
    protocols: &[Protocol],
    description: &SavedDescription,
    camera: Option<(f64, f64)>,
) -> PyResult<StereoCamera> {
    if let Some((focal_px, baseline_m)) = camera {
        return Ok(StereoCamera {
            focal_px,
            baseline_m,
        });
    }
    let gives_depth = matches!(
        description.meaning_taken(),
        OutputMeaning::Depth | OutputMeaning::DepthM
    );
    let needing = protocols.iter().find(|protocol| {
        protocol.camera == Camera::Calibrated && (protocol.ground_truth.is_stereo() || !gives_depth)
    });
    match needing {
        Some(protocol) => Err(PyValueError::new_err(format!(
            "protocol {} turns disparity into depth by the image's own camera; give focal_px (of an image \
             as wide as the truth) and baseline_m",
            protocol.name
        ))),
        // Nothing asks for it.
        None => Ok(StereoCamera {
            focal_px: 1.0,
            baseline_m: 1.0,
        }),
    }
}

/// Names of the protocols.
#[pyfunction]
pub fn protocols() -> Vec<String> {
    let known = strat_metrics::protocols().into_iter();
    known.map(|protocol| protocol.name).collect()
}

/// The rules of a protocol, by name or file, in words.
#[pyfunction]
pub fn describe(name: &str) -> PyResult<String> {
    let protocol = resolve(name).map_err(raised)?;
    Ok(format!(
        "{} (version {}, digest {})\n{}\n",
        protocol.name,
        protocol.version,
        protocol.digest(),
        protocol.describe()
    ))
}
