//! What is known of an image, and which of its pixels were measured.

use super::error::EvaluateError;
use crate::metrics::CropBox;

/// What is known of an image, row-major planes of `width * height` values.
#[derive(Clone, Copy, Debug)]
pub struct GroundTruth<'a> {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Depth in metres, 0 where there is none.
    pub depth_m: &'a [f32],
    /// Disparity in pixels, 0 where there is none. For stereo ground truth: depth is then
    /// computed from it in double precision, and it is what D1-all needs.
    pub disparity_px: Option<&'a [f32]>,
    /// Focal length in pixels of this image: the nominal one for a protocol with a nominal
    /// camera, that of the calibration otherwise; of no matter where the protocol brings its
    /// own camera or none.
    pub focal_px: f64,
    /// Baseline in metres from the calibration. A protocol with a nominal camera brings its
    /// own and does not look at this one.
    pub baseline_m: f64,
    /// Cityscapes label ids, for protocols with groups.
    pub labels: Option<&'a [u8]>,
    /// Where `depth_m` and `disparity_px` have something, if it was found before: worthwhile where
    /// several protocols look at the same planes.
    pub measured: Option<&'a MeasuredPixels>,
}

/// The pixels of an image that have ground truth, and that its planes hold nothing but usable
/// numbers.
#[derive(Clone, Debug)]
pub struct MeasuredPixels {
    pub(super) width: usize,
    /// Row-major places in ascending order.
    pub(super) places: Vec<u32>,
    /// Where each row begins in `places`, and the end.
    pub(super) rows: Vec<usize>,
}

impl MeasuredPixels {
    /// Looks for them.
    ///
    /// # Errors
    /// Planes of wrong size, and values that are negative or not finite.
    pub fn find(truth: &GroundTruth<'_>) -> Result<Self, EvaluateError> {
        let (width, height) = (truth.width, truth.height);
        for (plane, what, values) in [
            ("depth ground truth", "depth", Some(truth.depth_m)),
            ("disparity ground truth", "disparity", truth.disparity_px),
        ] {
            let Some(values) = values else { continue };
            check_size(plane, values.len(), width, height)?;
            check_plane(values, width, |row, column, value| EvaluateError::Truth {
                what,
                row,
                column,
                value,
            })?;
        }
        // As many as a scan has, so that the list does not move while it grows.
        let mut places = Vec::with_capacity(truth.depth_m.len() / 16);
        let mut rows = Vec::with_capacity(height + 1);
        rows.push(0);
        for row in 0..height {
            let own = row * width..(row + 1) * width;
            match truth.disparity_px {
                None => find_in_row(&truth.depth_m[own.clone()], own.start, &mut places),
                // What has only one of the two is some protocol's ground truth as well.
                Some(disparity_px) => places.extend(
                    own.filter(|&place| truth.depth_m[place] != 0.0 || disparity_px[place] != 0.0)
                        .map(|place| place as u32),
                ),
            }
            rows.push(places.len());
        }
        Ok(Self {
            width,
            places,
            rows,
        })
    }

    /// Those within a part of the image, row by row.
    pub(super) fn within(&self, crop: CropBox) -> impl Iterator<Item = usize> {
        (crop.top..crop.bottom).flat_map(move |row| {
            let own = &self.places[self.rows[row]..self.rows[row + 1]];
            let before = |column: usize| {
                let end = row * self.width + column;
                own.partition_point(|&place| (place as usize) < end)
            };
            own[before(crop.left)..before(crop.right)]
                .iter()
                .map(|&place| place as usize)
        })
    }
}

/// Nineteen of twenty pixels of a scan have nothing, most of them in runs: finding the others is
/// what takes time. Within a piece their places are gathered without a branch, since no processor
/// can foresee them.
fn find_in_row(row: &[f32], start: usize, found: &mut Vec<u32>) {
    for (start, piece) in (start..).step_by(PIECE).zip(row.chunks(PIECE)) {
        if piece.iter().fold(0, |all, value| all | value.to_bits()) == 0 {
            continue;
        }
        let (mut places, mut count) = ([0; PIECE], 0);
        for (place, value) in piece.iter().enumerate() {
            places[count % PIECE] = (start + place) as u32;
            count += usize::from(*value != 0.0);
        }
        found.extend_from_slice(&places[..count]);
    }
}

/// Pixels that are passed over in one go where nothing was measured.
const PIECE: usize = 16;

pub(super) fn check_size(
    plane: &'static str,
    found: usize,
    width: usize,
    height: usize,
) -> Result<(), EvaluateError> {
    let expected = width.saturating_mul(height);
    if found == expected {
        Ok(())
    } else {
        Err(EvaluateError::Size {
            plane,
            found,
            expected,
            width,
            height,
        })
    }
}

pub(super) fn check_plane(
    plane: &[f32],
    width: usize,
    error: impl Fn(usize, usize, f32) -> EvaluateError,
) -> Result<(), EvaluateError> {
    let usable = |value: &f32| *value >= 0.0 && *value <= f32::MAX;
    // Whole pieces without a way out are many values at a time for the processor.
    let piece = |values: &[f32]| values.iter().fold(true, |all, value| all & usable(value));
    if plane.chunks(1024).all(piece) {
        return Ok(());
    }
    match plane.iter().position(|value| !usable(value)) {
        Some(index) => Err(error(index / width, index % width, plane[index])),
        None => Ok(()),
    }
}
