//! One prediction under all protocols: the protocol's crop and camera, the metrics, the picture.
//!
//! Not here: what a metric is ([`strat_metrics`]), how a prediction comes to the size of its truth
//! ([`super::prediction`]) and how files become ground truth ([`super::sample`]).

use std::borrow::Cow;

use image::RgbImage;
use strat_metrics::{
    Alignment, Camera, EvaluateError, GroundTruth, Grouping, ImageScore, PostProcessing, Protocol,
    RowContext,
};
use strat_store::{raster::Plane, resize};

use super::{
    agreement::{self, ImageAgreement},
    comparison::{self, Comparison},
    prediction::{Prediction, Seen, inverse},
    sample::{SampleError, Scene},
    suspicion::{self, Look},
};
use crate::view::{NoCrop, View};

/// A prediction on its way to the metrics.
pub(super) struct Predicted {
    /// By what was seen of the image.
    pub(super) seen: Vec<Seen>,
    /// A map of the whole image is cut where a protocol is about a crop: what was saved is all there
    /// is. A network is shown the crop instead.
    pub(super) is_cut: bool,
    /// Its depth is in metres, given a camera.
    pub(super) has_scale: bool,
    /// The image, where a picture is wanted.
    pub(super) image: Option<RgbImage>,
    /// What it is looked at for, beside its scores.
    pub(super) attention: Attention,
}

/// How closely a prediction is looked at beside its truth.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Attention {
    /// Scores are all that is wanted.
    None,
    /// Its scale and order are wanted, for what is said of all images.
    Agreement,
    /// As one of the first images, it is searched for signs of a wrong description.
    Close,
}

impl Attention {
    /// In a run, where the first images are looked at closely.
    pub(super) fn of(is_early: bool) -> Self {
        match is_early {
            true => Self::Close,
            false => Self::Agreement,
        }
    }
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

/// Scores one prediction under all protocols, if wanted with the `further` metrics.
pub(super) fn score(
    mut scene: Scene<'_>,
    protocols: &[(Protocol, RowContext)],
    predicted: Predicted,
    further: bool,
) -> Scored {
    let (image_id, size) = (scene.image, scene.size);
    let (width, height) = size;
    let Predicted {
        seen,
        is_cut,
        has_scale,
        image,
        attention,
    } = predicted;
    let mut comparison: Option<Comparison> = None;
    let (mut agreement, mut look) = (None, None);
    let scores_whole_images = |protocol: &Protocol| protocol.grouping == Grouping::None;
    let is_any_whole = protocols
        .iter()
        .any(|(protocol, _)| scores_whole_images(protocol));
    let mut score_under = |protocol: &Protocol, context: &RowContext| {
        // What one protocol lacks does not cost the others their rows.
        let Some((truth, scratch)) = scene.needed_by(protocol)? else {
            return Ok(Vec::new());
        };
        let unscored = |reason| SampleError::Evaluate {
            protocol: protocol.name.clone(),
            reason,
        };
        let view = View::under(protocol);
        let is_wanted = |seen: &&Seen| seen.view == view || (is_cut && seen.view == View::Whole);
        let no_crop = NoCrop { width, height };
        let seen = seen.iter().find(is_wanted).ok_or(no_crop)?;
        let form = match (&seen.flipped, protocol.post_processing) {
            (Some(flipped), PostProcessing::Flip) => flipped,
            _ => &seen.plain,
        };
        let (form, factor) = form.under(protocol);
        let prediction = &form.prediction;
        if protocol.camera == Camera::Unknown
            && protocol.alignment == Alignment::None
            && matches!(prediction, Prediction::DisparityFraction(_))
        {
            let name = protocol.name.clone();
            return Err(unscored(EvaluateError::NoCamera { name }));
        }
        // Depth and inverse depth in no unit need no camera.
        let depth_at_width_m = match prediction {
            Prediction::InverseDepth(_) | Prediction::Depth(_) => 1.0,
            _ => {
                let camera = protocol.camera.resolve(truth.camera(), width);
                let camera = camera.map_err(|error| unscored(error.into()))?;
                camera.depth_at_width_m(width) as f32
            }
        };
        let is_compared =
            attention != Attention::None && agreement.is_none() && scores_whole_images(protocol);
        // Of maps of whole images alone: around a crop is nothing to look at.
        let is_looked_at = is_compared && attention == Attention::Close && view == View::Whole;
        let has_picture = comparison.as_ref().is_some_and(|one| one.scored.is_some());
        let is_drawn = !has_picture && (scores_whole_images(protocol) || !is_any_whole);
        let drawn = image.as_ref().filter(|_| is_drawn);
        // Most pixels were never measured, and only a look at the whole map needs them.
        let everywhere = is_looked_at || drawn.is_some();
        let mut compared = form.at_truth(
            seen.view,
            protocol,
            truth,
            size,
            depth_at_width_m,
            everywhere,
        )?;
        let aligns_inverse_depth = protocol.alignment.is_of_inverse_depth();
        if matches!(prediction, Prediction::InverseDepthPerM(_)) && !aligns_inverse_depth {
            // Inverse depth in metres becomes disparity with whatever camera the protocol assumes.
            let values = compared.iter().map(|value| value * depth_at_width_m);
            compared = Cow::Owned(values.collect());
        }
        let values = compared.as_ref();
        let gives_depth = matches!(prediction, Prediction::DepthM(_) | Prediction::Depth(_));
        if is_compared {
            let width_m = (!gives_depth).then_some(depth_at_width_m);
            let pairs = pairs(protocol, truth, values, everywhere, width_m);
            agreement = agreement::of_image(&pairs, has_scale);
            let camera = (width as u32, truth.camera().calibration.focal_px);
            look = agreement.filter(|_| is_looked_at).map(|agreement| {
                suspicion::look(protocol, truth, values, !gives_depth, agreement, camera)
            });
        }
        let prediction = match prediction {
            Prediction::DepthM(_) => strat_metrics::Prediction::DepthM(values),
            Prediction::Depth(_) => strat_metrics::Prediction::Depth(values),
            Prediction::InverseDepth(_) => strat_metrics::Prediction::InverseDepth(values),
            Prediction::InverseDepthPerM(_) if aligns_inverse_depth => {
                strat_metrics::Prediction::InverseDepth(values)
            }
            Prediction::DisparityFraction(_)
            | Prediction::InverseDepthPerM(_)
            | Prediction::ConstantDepthM(_) => strat_metrics::Prediction::DisparityFraction(values),
        };
        // The scale is said in the model's own numbers.
        let in_own_numbers = |scores: &mut [ImageScore]| {
            let Some(factor) = factor else { return };
            for fit in scores.iter_mut().filter_map(|score| score.fit.as_mut()) {
                fit.scale *= f64::from(depth_at_width_m) / f64::from(factor);
            }
        };
        let Some(input) = drawn else {
            let scores = match everywhere {
                true => strat_metrics::evaluate_prediction(protocol, truth, prediction, further),
                false => {
                    strat_metrics::evaluate_measured(protocol, truth, prediction, further, scratch)
                }
            };
            let mut scores = scores.map_err(unscored)?;
            in_own_numbers(&mut scores);
            return Ok(scores);
        };
        let result = strat_metrics::evaluate_with_pixels(protocol, truth, prediction, further);
        let inverse = match &result {
            Ok((_, pixels)) => inverse(&pixels.predicted_m, 1.0),
            // Not scored, so neither aligned nor clipped, but it can be looked at.
            Err(_) if gives_depth => inverse(values, 1.0),
            Err(_) => values.iter().map(|d| d / depth_at_width_m).collect(),
        };
        let (truth_width, truth_height) = truth.size();
        let predicted = Plane {
            width: truth_width,
            height: truth_height,
            data: inverse,
        };
        let (scores, scored) = match result {
            Ok((mut scores, compared)) => {
                in_own_numbers(&mut scores);
                let scored = comparison::Scored {
                    scores: scores.clone(),
                    compared,
                };
                (Ok(scores), Some(scored))
            }
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

/// True and predicted depth in metres of some measured pixels within the protocol's limits, spread
/// evenly. There is a predicted value for each measured pixel, or for each pixel `everywhere`. A
/// disparity, a fraction of the width, is `depth_at_width_m` of depth away.
fn pairs(
    protocol: &Protocol,
    truth: &GroundTruth,
    predicted: &[f32],
    everywhere: bool,
    depth_at_width_m: Option<f32>,
) -> Vec<(f32, f32)> {
    let limits = protocol.min_depth_m as f32..=protocol.max_depth_m as f32;
    let width = truth.size().0;
    // A truth that has no such part is not scored.
    let Ok(shown) = View::under(protocol).part(truth.size()) else {
        return Vec::new();
    };
    let measured = truth.measured().iter().zip(truth.depth_m()).enumerate();
    let some = measured.step_by(agreement::stride(truth.measured().len()));
    some.map(|(place, (&index, &true_m))| (place, index as usize, true_m))
        .filter(|&(_, index, true_m)| {
            limits.contains(&true_m) && shown.has(index / width, index % width)
        })
        .filter_map(|(place, index, true_m)| {
            let predicted = predicted[if everywhere { index } else { place }];
            let predicted_m = match depth_at_width_m {
                // No disparity is as far as can be.
                Some(depth_m) => depth_m / predicted.max(f32::MIN_POSITIVE),
                // No depth is no prediction.
                None => Some(predicted).filter(|depth_m| *depth_m > 0.0)?,
            };
            Some((true_m, predicted_m))
        })
        .collect()
}
