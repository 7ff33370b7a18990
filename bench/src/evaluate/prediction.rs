//! A prediction in the forms that can be scored, brought to the size of its truth (PROTOCOL 3.3).
//!
//! Most pixels of a scan were never measured, so a prediction is resized at the measured ones alone, to the
//! same bits, wherever nobody looks at the whole map. Not here: what is scored ([`super::score`](mod@super::score)).

use std::{borrow::Cow, cell::OnceCell};

use strat_metrics::{Alignment, GroundTruth, GroundTruthKind, Protocol, Resize};
use strat_onnx::metadata::OutputMeaning;
use strat_store::{raster::Plane, resize};

use super::sample::SampleError;
use crate::{model, view::View};

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
    pub(super) plain: Form,
    /// Blended with the prediction for the mirrored image, where a protocol asks for it.
    pub(super) flipped: Option<Form>,
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
pub(super) struct Form {
    pub(super) prediction: Prediction,
    /// At the size of the image and in its place; most predictions do not depend on the protocol's
    /// camera, so this is done once.
    at_image: OnceCell<Plane>,
    /// The same at the measured pixels of a ground truth, which most protocols of a run share.
    at_measured: OnceCell<(GroundTruthKind, Vec<f32>)>,
    /// For protocols that scale by medians, where the prediction is inverse depth in no unit: as
    /// disparity, and what it was multiplied by.
    typical: OnceCell<(Box<Form>, f32)>,
}

impl Form {
    fn new(prediction: Prediction) -> Self {
        Self {
            prediction,
            at_image: OnceCell::new(),
            at_measured: OnceCell::new(),
            typical: OnceCell::new(),
        }
    }

    /// The form that a protocol scores, and what its numbers are multiples of.
    pub(super) fn under(&self, protocol: &Protocol) -> (&Self, Option<f32>) {
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

    /// What is resized: the prediction, which a camera makes a disparity of where it is a constant depth.
    fn source(&self, depth_at_width_m: f32) -> Cow<'_, Plane> {
        match &self.prediction {
            Prediction::ConstantDepthM(plane) => Cow::Owned(reciprocal(plane, depth_at_width_m)),
            prediction => Cow::Borrowed(prediction.plane()),
        }
    }

    /// Of a fraction of a part of an image makes one of the image.
    fn of_image(&self, values: &mut [f32], part_width: usize, image_width: usize) {
        if part_width != image_width && matches!(self.prediction, Prediction::DisparityFraction(_))
        {
            let share = part_width as f32 / image_width as f32;
            values.iter_mut().for_each(|value| *value *= share);
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
        let plane = self.source(depth_at_width_m);
        let mut resized = match resize {
            Resize::DepthNearest => nearest(&plane, width, height),
            Resize::DisparityBilinear => resize::bilinear_f32(&plane, width, height),
        };
        if resize == Resize::DisparityBilinear && matches!(self.prediction, Prediction::DepthM(_)) {
            model::clear_mixed(&mut resized.data, &plane, |there| {
                resize::bilinear_f32(there, width, height).data
            });
        }
        self.of_image(&mut resized.data, width, size.0);
        Ok(view.placed(resized, size)?)
    }

    /// The values of [`resized`](Self::resized) at measured pixels alone.
    fn resized_at(
        &self,
        view: View,
        resize: Resize,
        truth: &GroundTruth,
        depth_at_width_m: f32,
    ) -> Result<Vec<f32>, SampleError> {
        let size = truth.size();
        let part = view.part(size)?;
        let (width, height) = part.size();
        let measured = truth.measured();
        let in_part = |&index: &u32| {
            let (row, column) = (index as usize / size.0, index as usize % size.0);
            let is_inside = part.has(row, column);
            is_inside.then(|| ((row - part.top) * width + column - part.left) as u32)
        };
        let indices: Cow<'_, [u32]> = match view {
            View::Whole => Cow::Borrowed(measured),
            View::KittiBenchmark => measured.iter().filter_map(in_part).collect(),
        };
        let plane = self.source(depth_at_width_m);
        let mut values = match resize {
            Resize::DepthNearest => nearest_at(&plane, width, height, &indices),
            Resize::DisparityBilinear => resize::bilinear_at(&plane, width, height, &indices),
        };
        if resize == Resize::DisparityBilinear && matches!(self.prediction, Prediction::DepthM(_)) {
            model::clear_mixed(&mut values, &plane, |there| {
                resize::bilinear_at(there, width, height, &indices)
            });
        }
        self.of_image(&mut values, width, size.0);
        if values.len() == measured.len() {
            return Ok(values);
        }
        let mut values = values.into_iter();
        let placed = measured.iter().map(|index| match in_part(index) {
            Some(_) => values.next().unwrap_or(0.0),
            None => 0.0,
        });
        Ok(placed.collect())
    }

    /// The prediction at the size of the ground truth, `everywhere` or at its measured pixels, shared
    /// between protocols where it can be.
    pub(super) fn at_truth(
        &self,
        view: View,
        protocol: &Protocol,
        truth: &GroundTruth,
        image: (usize, usize),
        depth_at_width_m: f32,
        everywhere: bool,
    ) -> Result<Cow<'_, [f32]>, SampleError> {
        let kind = protocol.ground_truth;
        let is_shared = protocol.resize == Resize::DisparityBilinear
            && truth.size() == image
            && !matches!(self.prediction, Prediction::ConstantDepthM(_));
        if everywhere {
            let resized = || self.resized(view, protocol.resize, truth.size(), depth_at_width_m);
            if !is_shared {
                return resized().map(|plane| Cow::Owned(plane.data));
            }
            if let Some(plane) = self.at_image.get() {
                return Ok(Cow::Borrowed(&plane.data));
            }
            let plane = resized()?;
            return Ok(Cow::Borrowed(&self.at_image.get_or_init(|| plane).data));
        }
        match self.at_measured.get() {
            Some((known, values)) if is_shared && *known == kind => {
                return Ok(Cow::Borrowed(values));
            }
            _ => {}
        }
        let values = self.resized_at(view, protocol.resize, truth, depth_at_width_m)?;
        if !is_shared || self.at_measured.get().is_some() {
            return Ok(Cow::Owned(values));
        }
        let (_, values) = self.at_measured.get_or_init(|| (kind, values));
        Ok(Cow::Borrowed(values))
    }
}

/// Of pixel `i` of `to`, the nearest of `from`: (i + 1/2) * from / to, rounded down, in whole numbers.
fn nearest_index(i: usize, from: usize, to: usize) -> usize {
    ((2 * i + 1) * from / (2 * to)).min(from - 1)
}

/// The nearest sample for the centre of each pixel of another size.
fn nearest(source: &Plane, width: usize, height: usize) -> Plane {
    let mut data = Vec::with_capacity(width * height);
    for row in 0..height {
        let values = source.row(nearest_index(row, source.height, height));
        data.extend((0..width).map(|column| values[nearest_index(column, source.width, width)]));
    }
    Plane {
        width,
        height,
        data,
    }
}

/// The values of [`nearest`] at some pixels alone, by their row-major indices.
fn nearest_at(source: &Plane, width: usize, height: usize, indices: &[u32]) -> Vec<f32> {
    let value = |&index: &u32| {
        let (row, column) = (index as usize / width, index as usize % width);
        source.row(nearest_index(row, source.height, height))
            [nearest_index(column, source.width, width)]
    };
    indices.iter().map(value).collect()
}

/// Depth to disparity or back: `factor / value`, where 0 stays 0 (no measurement).
fn reciprocal(plane: &Plane, factor: f32) -> Plane {
    Plane {
        data: inverse(&plane.data, factor),
        ..*plane
    }
}

/// `factor / value`, where what is not above 0 becomes 0.
pub(super) fn inverse(values: &[f32], factor: f32) -> Vec<f32> {
    let inverse = |&value: &f32| if value > 0.0 { factor / value } else { 0.0 };
    values.iter().map(inverse).collect()
}

#[cfg(test)]
mod tests {
    use strat_metrics::{KnownCamera, StereoCamera};

    use super::*;

    const SIZE: (usize, usize) = (1242, 375);

    /// Every fifth pixel or so was measured.
    fn truth() -> GroundTruth {
        let depth_m: Vec<f32> = (0..SIZE.0 * SIZE.1)
            .map(|i| if i % 5 == 0 || i % 37 == 3 { 5.0 } else { 0.0 })
            .collect();
        let calibration = StereoCamera {
            focal_px: 721.5,
            baseline_m: 0.54,
        };
        let camera = KnownCamera {
            calibration,
            nominal_focal_px: None,
        };
        GroundTruth::new(SIZE, &depth_m, camera).unwrap()
    }

    /// A map with a hole where nothing is predicted.
    fn map() -> Plane {
        let value = |i: usize| {
            let (row, column) = (i / 160, i % 160);
            let is_hole = (20..30).contains(&row) && (40..70).contains(&column);
            if is_hole {
                0.0
            } else {
                1.0 + (i as f32 / 31.0).sin()
            }
        };
        Plane::new(160, 48, (0..160 * 48).map(value).collect()).unwrap()
    }

    /// At measured pixels stands what stands there in the whole map, to the last bit.
    #[test]
    fn measured_pixels_have_the_values_of_the_whole_map() {
        let truth = truth();
        let kinds: [fn(Plane) -> Prediction; 4] = [
            Prediction::DisparityFraction,
            Prediction::InverseDepth,
            Prediction::DepthM,
            Prediction::ConstantDepthM,
        ];
        for kind in kinds {
            let form = Form::new(kind(map()));
            for view in [View::Whole, View::KittiBenchmark] {
                for resize in [Resize::DisparityBilinear, Resize::DepthNearest] {
                    let whole = form.resized(view, resize, SIZE, 384.0).unwrap();
                    let expected: Vec<u32> = truth
                        .measured()
                        .iter()
                        .map(|&index| whole.data[index as usize].to_bits())
                        .collect();
                    let found = form.resized_at(view, resize, &truth, 384.0).unwrap();
                    let found: Vec<u32> = found.into_iter().map(f32::to_bits).collect();
                    assert!(
                        found == expected,
                        "{:?} {view:?} {resize:?}",
                        form.prediction
                    );
                }
            }
        }
        let form = Form::new(Prediction::Depth(map()));
        let small = GroundTruth::new((640, 192), &[1.0; 640 * 192], *truth.camera()).unwrap();
        let refused = form.resized_at(View::KittiBenchmark, Resize::DepthNearest, &small, 1.0);
        assert!(matches!(refused, Err(SampleError::NoCrop(_))));
    }

    /// Protocols with the same ground truth share what was resized; with another one they do not.
    #[test]
    fn each_ground_truth_has_its_own_pixels() {
        let scan = truth();
        let camera = GroundTruth::new(SIZE, &vec![4.0; SIZE.0 * SIZE.1], *scan.camera()).unwrap();
        let form = Form::new(Prediction::DisparityFraction(map()));
        for _ in 0..2 {
            for (name, truth) in [
                ("eigen-80", &scan),
                ("eigen-cameraz-80", &camera),
                ("eigen-50", &scan),
            ] {
                let protocol = strat_metrics::protocol(name).unwrap();
                let at = |everywhere| {
                    form.at_truth(View::Whole, &protocol, truth, SIZE, 1.0, everywhere)
                        .unwrap()
                };
                let whole = at(true);
                let expected: Vec<f32> = truth
                    .measured()
                    .iter()
                    .map(|&index| whole[index as usize])
                    .collect();
                assert_eq!(*at(false), expected, "{name}");
            }
        }
    }
}
