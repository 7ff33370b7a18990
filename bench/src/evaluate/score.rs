//! One prediction under all protocols: resizing, the protocol's camera, the metrics.
//!
//! Not here: what a metric is ([`strat_metrics`]) and how files become ground truth
//! ([`super::sample`]).

use image::RgbImage;
use strat_metrics::{
    Camera, EvaluateError, GroundTruth, Grouping, ImageScore, PostProcessing, Protocol, Resize,
    RowContext,
};
use strat_onnx::metadata::OutputMeaning;
use strat_store::{raster::Plane, resize};

use crate::model;

use super::{
    agreement::{self, ImageAgreement},
    comparison::{self, Comparison},
    sample::{SampleError, Scene},
    suspicion::{self, Look},
};

/// The median that inverse depth of unknown scale is brought to, as a disparity fraction: a
/// typical value, so that the protocol's disparity floor means what it means for other models.
/// Median scaling makes the choice irrelevant for the figures.
const TYPICAL_DISPARITY_FRACTION: f32 = 0.03;

/// A prediction at network size.
#[derive(Clone, Debug)]
pub(super) enum Prediction {
    /// Disparity as a fraction of image width.
    DisparityFraction(Plane),
    /// Inverse depth in 1/m.
    InverseDepthPerM(Plane),
    /// Depth in metres, resized as depth: the form a model of depth gives.
    DepthM(Plane),
    /// Depth in metres of a baseline; becomes the disparity of each image's camera first.
    ConstantDepthM(Plane),
}

impl Prediction {
    /// Brings numbers of depth into one of the forms that can be scored. `input_width` is what
    /// disparity in pixels is relative to.
    pub(super) fn new(mut plane: Plane, meaning: OutputMeaning, input_width: f32) -> Self {
        match meaning {
            OutputMeaning::DisparityFraction => Self::DisparityFraction(plane),
            OutputMeaning::DisparityPx => {
                for value in &mut plane.data {
                    *value /= input_width;
                }
                Self::DisparityFraction(plane)
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
                Self::DisparityFraction(plane)
            }
            OutputMeaning::InverseDepthPerM => Self::InverseDepthPerM(plane),
            OutputMeaning::Depth | OutputMeaning::DepthM => Self::DepthM(plane),
        }
    }

    /// The map at another size, where it does not depend on a protocol's camera.
    fn resized(&self, width: usize, height: usize) -> Option<Plane> {
        match self {
            Self::DisparityFraction(plane) | Self::InverseDepthPerM(plane) => {
                Some(resize::bilinear_f32(plane, width, height))
            }
            Self::DepthM(plane) => Some(resized_depth(plane, width, height)),
            Self::ConstantDepthM(_) => None,
        }
    }
}

/// A prediction on its way to the metrics.
pub(super) struct Predicted {
    pub(super) plain: Prediction,
    /// Its depth is in metres, given a camera.
    pub(super) has_scale: bool,
    /// Blended with the prediction for the mirrored image, where a protocol asks for it.
    pub(super) flipped: Option<Prediction>,
    /// The image, where a picture is wanted.
    pub(super) image: Option<RgbImage>,
    /// One of the first images, which are looked at more closely.
    pub(super) is_early: bool,
}

/// The scores of one image.
pub(super) struct Scored {
    /// By protocol, in the order in which they were given.
    pub(super) scores: Vec<Result<Vec<ImageScore>, SampleError>>,
    /// Under the first protocol that scores images as wholes.
    pub(super) agreement: Option<ImageAgreement>,
    /// Of one of the first images, under the same protocol.
    pub(super) look: Option<Look>,
    /// What a picture shows: the score under the first protocol without groups that gives one.
    pub(super) comparison: Option<Comparison>,
}

/// Scores one prediction under all protocols.
pub(super) fn score(
    mut scene: Scene<'_>,
    protocols: &[(Protocol, RowContext)],
    predicted: Predicted,
) -> Scored {
    let (image_id, size) = (scene.image, scene.size);
    let (width, height) = size;
    let Predicted {
        plain,
        has_scale,
        flipped,
        image,
        is_early,
    } = predicted;
    // Most predictions do not depend on the protocol's camera, so they are resized once.
    let at_image_size = |prediction: Prediction| {
        let resized = prediction.resized(width, height);
        (prediction, resized)
    };
    let plain = at_image_size(plain);
    let flipped = flipped.map(at_image_size);
    let mut comparison: Option<Comparison> = None;
    let (mut agreement, mut look) = (None, None);
    let scores_whole_images = |protocol: &Protocol| protocol.grouping == Grouping::None;
    let is_any_whole = protocols
        .iter()
        .any(|(protocol, _)| scores_whole_images(protocol));
    let mut score_under = |protocol: &Protocol, context: &RowContext| {
        // What one protocol lacks does not cost the others their rows.
        let Some(truth) = scene.needed_by(protocol)? else {
            return Ok(Vec::new());
        };
        let unscored = |reason| SampleError::Evaluate {
            protocol: protocol.name.clone(),
            reason,
        };
        let (prediction, shared) = match (&flipped, protocol.post_processing) {
            (Some(flipped), PostProcessing::Flip) => flipped,
            _ => &plain,
        };
        if protocol.camera == Camera::Unknown
            && !protocol.median_scaling
            && matches!(prediction, Prediction::DisparityFraction(_))
        {
            let name = protocol.name.clone();
            return Err(unscored(EvaluateError::NoCamera { name }));
        }
        let camera = protocol
            .camera
            .resolve(truth.camera(), width)
            .map_err(|error| unscored(error.into()))?;
        let depth_at_width_m = camera.depth_at_width_m(width) as f32;
        let compared = compared(
            protocol,
            truth,
            size,
            depth_at_width_m,
            prediction,
            shared.as_ref(),
        );
        let compared = compared.as_ref();
        let gives_depth = matches!(prediction, Prediction::DepthM(_));
        if agreement.is_none() && scores_whole_images(protocol) {
            let width_m = (!gives_depth).then_some(depth_at_width_m);
            let pairs = pairs(protocol, truth, &compared.data, width_m);
            agreement = agreement::of_image(&pairs, has_scale);
            let camera = (width as u32, truth.camera().calibration.focal_px);
            look = agreement.filter(|_| is_early).map(|agreement| {
                suspicion::look(
                    protocol,
                    truth,
                    &compared.data,
                    !gives_depth,
                    agreement,
                    camera,
                )
            });
        }
        let has_picture = comparison.as_ref().is_some_and(|one| one.scored.is_some());
        let is_drawn = !has_picture && (scores_whole_images(protocol) || !is_any_whole);
        let Some(input) = image.as_ref().filter(|_| is_drawn) else {
            let scores = if gives_depth {
                strat_metrics::evaluate_depth(protocol, truth, &compared.data)
            } else {
                strat_metrics::evaluate(protocol, truth, &compared.data)
            };
            return scores.map_err(unscored);
        };
        let prediction = if gives_depth {
            strat_metrics::Prediction::DepthM(&compared.data)
        } else {
            strat_metrics::Prediction::DisparityFraction(&compared.data)
        };
        let result = strat_metrics::evaluate_with_pixels(protocol, truth, prediction);
        let inverse = match &result {
            Ok((_, pixels)) => inverse(&pixels.predicted_m, 1.0),
            // Not scored, so neither scaled nor clipped, but it can be looked at.
            Err(_) if gives_depth => inverse(&compared.data, 1.0),
            Err(_) => {
                let values = compared.data.iter();
                values.map(|d| d / depth_at_width_m).collect()
            }
        };
        let predicted = Plane {
            data: inverse,
            ..*compared
        };
        let (scores, scored) = match result {
            Ok((scores, compared)) => (
                Ok(scores.clone()),
                Some(comparison::Scored { scores, compared }),
            ),
            Err(source) => (Err(unscored(source)), None),
        };
        comparison = Some(Comparison {
            image: image_id.to_owned(),
            input: input.clone(),
            // A laser's grid is coarser than the image.
            predicted: resize::bilinear_f32(&predicted, width, height),
            context: context.clone(),
            scored,
        });
        scores
    };
    let protocols = protocols.iter();
    Scored {
        scores: protocols
            .map(|(protocol, context)| score_under(protocol, context))
            .collect(),
        agreement,
        look,
        comparison,
    }
}

/// The prediction in the numbers and at the size of the ground truth. `shared` is its map at the
/// size of the image.
fn compared<'a>(
    protocol: &Protocol,
    truth: &GroundTruth,
    image_size: (usize, usize),
    depth_at_width_m: f32,
    prediction: &Prediction,
    shared: Option<&'a Plane>,
) -> std::borrow::Cow<'a, Plane> {
    use std::borrow::Cow;
    let (width, height) = truth.size();
    let to_truth = |plane: &Plane| match protocol.resize {
        Resize::DisparityBilinear if matches!(prediction, Prediction::DepthM(_)) => {
            resized_depth(plane, width, height)
        }
        Resize::DisparityBilinear => resize::bilinear_f32(plane, width, height),
        Resize::DepthNearest => nearest(plane, width, height),
    };
    let as_shared = protocol.resize == Resize::DisparityBilinear && (width, height) == image_size;
    let resized = match (shared, prediction) {
        (Some(plane), _) if as_shared => Cow::Borrowed(plane),
        (_, Prediction::ConstantDepthM(plane)) => {
            Cow::Owned(to_truth(&reciprocal(plane, depth_at_width_m)))
        }
        (
            _,
            Prediction::DisparityFraction(plane)
            | Prediction::InverseDepthPerM(plane)
            | Prediction::DepthM(plane),
        ) => Cow::Owned(to_truth(plane)),
    };
    if !matches!(prediction, Prediction::InverseDepthPerM(_)) {
        return resized;
    }
    // Inverse depth in metres becomes disparity with whatever camera the protocol assumes.
    let values = resized.data.iter();
    Cow::Owned(Plane {
        data: values.map(|value| value * depth_at_width_m).collect(),
        ..*resized
    })
}

/// True and predicted depth in metres of some measured pixels within the protocol's limits, spread
/// evenly. A disparity, a fraction of the width, is `depth_at_width_m` of depth away.
fn pairs(
    protocol: &Protocol,
    truth: &GroundTruth,
    predicted: &[f32],
    depth_at_width_m: Option<f32>,
) -> Vec<(f32, f32)> {
    let limits = protocol.min_depth_m as f32..=protocol.max_depth_m as f32;
    let indices = truth.measured();
    let some = indices.iter().step_by(agreement::stride(indices.len()));
    some.map(|&index| index as usize)
        .filter(|&index| limits.contains(&truth.depth_m()[index]))
        .filter_map(|index| {
            let predicted_m = match depth_at_width_m {
                // No disparity is as far as can be.
                Some(depth_m) => depth_m / predicted[index].max(f32::MIN_POSITIVE),
                // No depth is no prediction.
                None => Some(predicted[index]).filter(|depth_m| *depth_m > 0.0)?,
            };
            Some((truth.depth_m()[index], predicted_m))
        })
        .collect()
}

/// Depth at another size. 0 is none, so a pixel that would be mixed with none has none.
fn resized_depth(plane: &Plane, width: usize, height: usize) -> Plane {
    let mut resized = resize::bilinear_f32(plane, width, height);
    model::clear_mixed(&mut resized, plane, resize::Alignment::Edges);
    resized
}

/// The nearest sample for the centre of each pixel of another size.
fn nearest(source: &Plane, width: usize, height: usize) -> Plane {
    // (i + 1/2) * from / to, rounded down, in whole numbers.
    let index = |i: usize, from: usize, to: usize| ((2 * i + 1) * from / (2 * to)).min(from - 1);
    let mut data = Vec::with_capacity(width * height);
    for row in 0..height {
        let start = index(row, source.height, height) * source.width;
        data.extend(
            (0..width).map(|column| source.data[start + index(column, source.width, width)]),
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
        data: inverse(&plane.data, factor),
        ..*plane
    }
}

fn inverse(values: &[f32], factor: f32) -> Vec<f32> {
    let inverse = |&value: &f32| if value > 0.0 { factor / value } else { 0.0 };
    values.iter().map(inverse).collect()
}
