//! One prediction under all protocols: resizing, the protocol's crop and camera, the metrics.
//!
//! Not here: what a metric is ([`strat_metrics`]) and how files become ground truth
//! ([`super::sample`]).

use std::{borrow::Cow, cell::OnceCell};

use image::RgbImage;
use strat_metrics::{
    Alignment, Camera, EvaluateError, GroundTruth, Grouping, ImageScore, PostProcessing, Protocol,
    Resize, RowContext, benchmark_box,
};
use strat_onnx::metadata::OutputMeaning;
use strat_store::{raster::Plane, resize};

use super::{
    agreement::{self, ImageAgreement},
    comparison::{self, Comparison},
    sample::{SampleError, Scene},
    suspicion::{self, Look},
};
use crate::{
    model,
    view::{NoCrop, View},
};

/// The median that inverse depth of unknown scale is brought to, as a disparity fraction: a
/// typical value, so that the protocol's disparity floor means what it means for other models.
/// Scaling by medians makes the choice irrelevant for the figures.
const TYPICAL_DISPARITY_FRACTION: f32 = 0.03;

/// A prediction at network size.
#[derive(Clone, Debug)]
pub(super) enum Prediction {
    /// Disparity as a fraction of the width of what is seen.
    DisparityFraction(Plane),
    /// Inverse depth in 1/m.
    InverseDepthPerM(Plane),
    /// Inverse depth in no unit.
    InverseDepth(Plane),
    /// Depth in metres, resized as depth: the form a model of depth gives.
    DepthM(Plane),
    /// Depth in no unit.
    Depth(Plane),
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
            OutputMeaning::InverseDepth => Self::InverseDepth(plane),
            OutputMeaning::InverseDepthPerM => Self::InverseDepthPerM(plane),
            OutputMeaning::Depth => Self::Depth(plane),
            OutputMeaning::DepthM => Self::DepthM(plane),
        }
    }

    /// Inverse depth in no unit as disparity of common size, and what it was multiplied by. A map
    /// without a positive median is scored as it is and fails on its own merits.
    fn as_typical_disparity(plane: &Plane) -> (Plane, f32) {
        let mut values: Vec<f64> = plane.data.iter().copied().map(f64::from).collect();
        let median = strat_metrics::median(&mut values).unwrap_or(0.0) as f32;
        let factor = if median > 0.0 {
            TYPICAL_DISPARITY_FRACTION / median
        } else {
            1.0
        };
        let data = plane.data.iter().map(|value| value * factor).collect();
        (Plane { data, ..*plane }, factor)
    }

    fn plane(&self) -> &Plane {
        match self {
            Self::DisparityFraction(plane)
            | Self::InverseDepthPerM(plane)
            | Self::InverseDepth(plane)
            | Self::DepthM(plane)
            | Self::Depth(plane)
            | Self::ConstantDepthM(plane) => plane,
        }
    }
}

/// What a predictor made of one view of an image.
pub(super) struct Seen {
    pub(super) view: View,
    plain: Form,
    /// Blended with the prediction for the mirrored image, where a protocol asks for it.
    flipped: Option<Form>,
}

impl Seen {
    pub(super) fn new(view: View, plain: Prediction, flipped: Option<Prediction>) -> Self {
        Self {
            view,
            plain: Form::new(plain),
            flipped: flipped.map(Form::new),
        }
    }

    pub(super) fn plain(&self) -> &Prediction {
        &self.plain.prediction
    }
}

/// A prediction, and what several protocols make of it alike.
struct Form {
    prediction: Prediction,
    /// At the size of the image and in its place; most predictions do not depend on the protocol's
    /// camera, so this is done once.
    at_image: OnceCell<Plane>,
    /// For protocols that scale by medians, where the prediction is inverse depth in no unit: as
    /// disparity, and what it was multiplied by.
    typical: OnceCell<(Box<Form>, f32)>,
}

impl Form {
    fn new(prediction: Prediction) -> Self {
        Self {
            prediction,
            at_image: OnceCell::new(),
            typical: OnceCell::new(),
        }
    }

    /// The form that a protocol scores, and what its numbers are multiples of.
    fn under(&self, protocol: &Protocol) -> (&Self, Option<f32>) {
        match &self.prediction {
            Prediction::InverseDepth(plane) if protocol.alignment == Alignment::Median => {
                let (form, factor) = self.typical.get_or_init(|| {
                    let (plane, factor) = Prediction::as_typical_disparity(plane);
                    let form = Self::new(Prediction::DisparityFraction(plane));
                    (Box::new(form), factor)
                });
                (form, Some(*factor))
            }
            _ => (self, None),
        }
    }

    /// Of a view at the size of the ground truth, in its place.
    fn resized(
        &self,
        view: View,
        resize: Resize,
        size: (usize, usize),
        depth_at_width_m: f32,
    ) -> Result<Plane, SampleError> {
        let (width, height) = view.size(size)?;
        let disparity;
        let plane = match &self.prediction {
            Prediction::ConstantDepthM(plane) => {
                disparity = reciprocal(plane, depth_at_width_m);
                &disparity
            }
            prediction => prediction.plane(),
        };
        let mut resized = match (resize, &self.prediction) {
            (Resize::DepthNearest, _) => nearest(plane, width, height),
            (Resize::DisparityBilinear, Prediction::DepthM(_)) => {
                resized_depth(plane, width, height)
            }
            (Resize::DisparityBilinear, _) => resize::bilinear_f32(plane, width, height),
        };
        if width != size.0 && matches!(self.prediction, Prediction::DisparityFraction(_)) {
            // A fraction of what is seen becomes one of the image.
            let share = width as f32 / size.0 as f32;
            resized.data.iter_mut().for_each(|value| *value *= share);
        }
        Ok(view.placed(resized, size)?)
    }

    /// The prediction at the size of the ground truth, shared between protocols where it can be.
    fn at_truth(
        &self,
        view: View,
        protocol: &Protocol,
        truth: (usize, usize),
        image: (usize, usize),
        depth_at_width_m: f32,
    ) -> Result<Cow<'_, Plane>, SampleError> {
        let is_shared = protocol.resize == Resize::DisparityBilinear
            && truth == image
            && !matches!(self.prediction, Prediction::ConstantDepthM(_));
        let resized = || self.resized(view, protocol.resize, truth, depth_at_width_m);
        if !is_shared {
            return resized().map(Cow::Owned);
        }
        if let Some(plane) = self.at_image.get() {
            return Ok(Cow::Borrowed(plane));
        }
        let plane = resized()?;
        Ok(Cow::Borrowed(self.at_image.get_or_init(|| plane)))
    }
}

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
        is_early,
    } = predicted;
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
        let mut compared =
            form.at_truth(seen.view, protocol, truth.size(), size, depth_at_width_m)?;
        let aligns_inverse_depth = protocol.alignment.is_of_inverse_depth();
        if matches!(prediction, Prediction::InverseDepthPerM(_)) && !aligns_inverse_depth {
            // Inverse depth in metres becomes disparity with whatever camera the protocol assumes.
            let values = compared.data.iter();
            let data = values.map(|value| value * depth_at_width_m).collect();
            compared = Cow::Owned(Plane { data, ..*compared });
        }
        let compared = compared.as_ref();
        let gives_depth = matches!(prediction, Prediction::DepthM(_) | Prediction::Depth(_));
        if agreement.is_none() && scores_whole_images(protocol) {
            let width_m = (!gives_depth).then_some(depth_at_width_m);
            let pairs = pairs(protocol, truth, &compared.data, width_m);
            agreement = agreement::of_image(&pairs, has_scale);
            let camera = (width as u32, truth.camera().calibration.focal_px);
            // Of maps of whole images alone: around a crop is nothing to look at.
            let is_looked_at = is_early && view == View::Whole;
            look = agreement.filter(|_| is_looked_at).map(|agreement| {
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
        let values = compared.data.as_slice();
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
        let Some(input) = image.as_ref().filter(|_| is_drawn) else {
            let scores = strat_metrics::evaluate_prediction(protocol, truth, prediction, further);
            let mut scores = scores.map_err(unscored)?;
            in_own_numbers(&mut scores);
            return Ok(scores);
        };
        let result = strat_metrics::evaluate_with_pixels(protocol, truth, prediction, further);
        let inverse = match &result {
            Ok((_, pixels)) => inverse(&pixels.predicted_m, 1.0),
            // Not scored, so neither aligned nor clipped, but it can be looked at.
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
/// evenly. A disparity, a fraction of the width, is `depth_at_width_m` of depth away.
fn pairs(
    protocol: &Protocol,
    truth: &GroundTruth,
    predicted: &[f32],
    depth_at_width_m: Option<f32>,
) -> Vec<(f32, f32)> {
    let limits = protocol.min_depth_m as f32..=protocol.max_depth_m as f32;
    let (width, height) = truth.size();
    let shown = match View::under(protocol) {
        View::Whole => None,
        View::KittiBenchmark => benchmark_box(width, height),
    };
    let is_shown = |index: usize| shown.is_none_or(|cut| cut.has(index / width, index % width));
    let indices = truth.measured();
    let some = indices.iter().step_by(agreement::stride(indices.len()));
    some.map(|&index| index as usize)
        .filter(|&index| limits.contains(&truth.depth_m()[index]) && is_shown(index))
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
