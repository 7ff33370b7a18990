//! What is known of an image, and which of its pixels were measured.

use std::ops::Range;

use super::error::EvaluateError;
use crate::metrics::CropBox;
use crate::protocol::KnownCamera;

/// What is known of an image, of whose planes each value was looked at once.
///
/// Nineteen of twenty pixels of a scan have nothing, and several protocols look at the same image: what
/// was measured is found when the planes come in, and nothing else is kept of them.
#[derive(Clone, Debug)]
pub struct GroundTruth {
    pub(super) width: usize,
    pub(super) height: usize,
    /// Depth in metres of each measured pixel, 0 where it has disparity alone.
    pub(super) depth_m: Vec<f32>,
    /// Disparity in pixels of each measured pixel, 0 where it has depth alone.
    pub(super) disparity_px: Option<Vec<f32>>,
    /// Of all pixels.
    pub(super) labels: Option<Vec<u8>>,
    pub(super) camera: KnownCamera,
    /// Row-major indices of the pixels with ground truth, in ascending order.
    pub(super) measured: Vec<u32>,
    /// Where each row begins in `measured`, and the end.
    rows: Vec<usize>,
}

impl GroundTruth {
    /// Depth in metres at `size` (columns, rows), row-major, 0 where there is none.
    ///
    /// # Errors
    /// A plane of wrong size, and values that are negative or not finite.
    pub fn new(
        size: (usize, usize),
        depth_m: &[f32],
        camera: KnownCamera,
    ) -> Result<Self, EvaluateError> {
        let mut rows = TruthRows::new(size, camera);
        rows.add(depth_m);
        rows.finish()
    }

    /// The same with disparity in pixels, 0 where there is none: stereo ground truth, whose depth
    /// is computed from it in double precision, and what D1-all needs.
    ///
    /// # Errors
    /// As for [`GroundTruth::new`].
    pub fn stereo(
        size: (usize, usize),
        depth_m: &[f32],
        disparity_px: &[f32],
        camera: KnownCamera,
    ) -> Result<Self, EvaluateError> {
        let (width, height) = size;
        check_size("depth ground truth", depth_m.len(), width, height)?;
        check_truth(depth_m, "depth", width)?;
        check_size("disparity ground truth", disparity_px.len(), width, height)?;
        check_truth(disparity_px, "disparity", width)?;
        let mut truth = Self::empty(size, camera);
        let mut disparities_px = Vec::new();
        for row in 0..height {
            for index in row * width..(row + 1) * width {
                let (depth_m, disparity_px) = (depth_m[index], disparity_px[index]);
                // What has only one of the two is some protocol's ground truth as well.
                if depth_m != 0.0 || disparity_px != 0.0 {
                    truth.measured.push(index as u32);
                    truth.depth_m.push(depth_m);
                    disparities_px.push(disparity_px);
                }
            }
            truth.rows.push(truth.measured.len());
        }
        truth.disparity_px = Some(disparities_px);
        Ok(truth)
    }

    fn empty((width, height): (usize, usize), camera: KnownCamera) -> Self {
        // As many as a scan has, so that the lists do not move while they grow.
        let expected = width.saturating_mul(height) / 16;
        let mut rows = Vec::with_capacity(height + 1);
        rows.push(0);
        Self {
            width,
            height,
            depth_m: Vec::with_capacity(expected),
            disparity_px: None,
            labels: None,
            camera,
            measured: Vec::with_capacity(expected),
            rows,
        }
    }

    /// Indices of all measured pixels, row by row.
    #[must_use]
    pub fn measured(&self) -> &[u32] {
        &self.measured
    }

    /// Adds Cityscapes label ids, for protocols with groups.
    ///
    /// # Errors
    /// A plane of wrong size.
    pub fn set_labels(&mut self, labels: Vec<u8>) -> Result<(), EvaluateError> {
        check_size("label image", labels.len(), self.width, self.height)?;
        self.labels = Some(labels);
        Ok(())
    }

    /// Whether labels were added.
    #[must_use]
    pub fn has_labels(&self) -> bool {
        self.labels.is_some()
    }

    /// Columns and rows.
    #[must_use]
    pub fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// Depth in metres of each [measured](Self::measured) pixel, 0 where it has disparity alone.
    #[must_use]
    pub fn depth_m(&self) -> &[f32] {
        &self.depth_m
    }

    /// What is known of the camera.
    #[must_use]
    pub fn camera(&self) -> &KnownCamera {
        &self.camera
    }

    /// Places in [`measured`](Self::measured) of what lies in a part of the image, a range for each row.
    pub(super) fn within(&self, crop: CropBox) -> impl Iterator<Item = Range<usize>> {
        (crop.top..crop.bottom).map(move |row| {
            let start = self.rows[row];
            let own = &self.measured[start..self.rows[row + 1]];
            let before = |column: usize| {
                let end = row * self.width + column;
                start + own.partition_point(|&index| (index as usize) < end)
            };
            before(crop.left)..before(crop.right)
        })
    }
}

/// Ground truth of a size whose rows come one after the other: a decoder need not hold all of them.
#[derive(Debug)]
pub struct TruthRows {
    truth: GroundTruth,
    /// Values that came.
    count: usize,
    /// Room for the places of what is measured in a row.
    positions: Vec<u32>,
}

impl TruthRows {
    /// None yet, of `size` (columns, rows).
    #[must_use]
    pub fn new(size: (usize, usize), camera: KnownCamera) -> Self {
        Self {
            truth: GroundTruth::empty(size, camera),
            count: 0,
            positions: Vec::new(),
        }
    }

    /// Adds whole rows of depth in metres, 0 where there is none.
    pub fn add(&mut self, depth_m: &[f32]) {
        let Self {
            truth,
            count,
            positions,
        } = self;
        for row in depth_m.chunks(truth.width.max(1)) {
            positions.resize(row.len() + FEW, 0);
            let found = find(row, positions);
            let positions = &positions[..found];
            let start = *count as u32;
            let measured = positions.iter().map(|position| start + position);
            truth.measured.extend(measured);
            let depth_m = positions.iter().map(|position| row[*position as usize]);
            truth.depth_m.extend(depth_m);
            truth.rows.push(truth.measured.len());
            *count += row.len();
        }
    }

    /// The ground truth, once all rows were added.
    ///
    /// # Errors
    /// More or fewer values than the size has, and values that are negative or not finite.
    pub fn finish(self) -> Result<GroundTruth, EvaluateError> {
        let Self { truth, count, .. } = self;
        let (width, height) = truth.size();
        check_size("depth ground truth", count, width, height)?;
        match first_unusable(&truth.depth_m, is_measurable) {
            None => Ok(truth),
            Some(place) => {
                let index = truth.measured[place] as usize;
                Err(no_measurement("depth", index, width, truth.depth_m[place]))
            }
        }
    }
}

/// Pixels that are looked through at a time.
const PIECE: usize = 64;

/// What few pieces have more of.
const FEW: usize = 8;

/// Writes down where a row has something, into room for as many as it has and [`FEW`] more. Says how many
/// positions there are.
fn find(row: &[f32], positions: &mut [u32]) -> usize {
    #[cfg(target_arch = "x86_64")]
    if let Some(simd) = pulp::x86::V3::try_new() {
        return simd.vectorize(x86::Find {
            simd,
            row,
            positions,
        });
    }
    find_with(OneByOne, row, positions)
}

/// Nineteen of twenty pixels have nothing, and finding the others is what takes time: which ones have
/// something becomes a bit each, for many pixels at a time, and then a position for each bit, as many for every
/// piece as few pieces exceed, because a guess of how many there are fails.
#[inline(always)]
fn find_with(measured: impl Measured, row: &[f32], positions: &mut [u32]) -> usize {
    let mut count = 0;
    let (pieces, rest) = row.as_chunks::<PIECE>();
    // Beyond the end there is nothing.
    let mut last = [0.0; PIECE];
    last[..rest.len()].copy_from_slice(rest);
    for (first, piece) in (0..).step_by(PIECE).zip(pieces.iter().chain([&last])) {
        let mut bits = measured.bits(piece);
        // The sky has none, row after row.
        if bits == 0 {
            continue;
        }
        let end = count + bits.count_ones() as usize;
        let mut next = || {
            let position = first + bits.trailing_zeros();
            bits &= bits.wrapping_sub(1);
            position
        };
        for position in &mut positions[count..count + FEW] {
            *position = next();
        }
        for position in positions.iter_mut().take(end).skip(count + FEW) {
            *position = next();
        }
        count = end;
    }
    count
}

/// Which pixels have something.
trait Measured {
    /// A bit for each pixel.
    fn bits(&self, piece: &[f32; PIECE]) -> u64;
}

struct OneByOne;

impl Measured for OneByOne {
    #[inline(always)]
    fn bits(&self, piece: &[f32; PIECE]) -> u64 {
        let values = piece.iter().rev();
        values.fold(0, |bits, value| bits << 1 | u64::from(*value != 0.0))
    }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use std::arch::x86_64::_CMP_NEQ_UQ;

    use super::{Measured, PIECE, find_with};

    /// Eight pixels at a time.
    struct EightAtATime(pulp::x86::V3);

    impl Measured for EightAtATime {
        #[inline(always)]
        fn bits(&self, piece: &[f32; PIECE]) -> u64 {
            let avx = self.0.avx;
            let eights: [[f32; 8]; PIECE / 8] = pulp::cast(*piece);
            let mut bits = [0; PIECE / 8];
            // From the first to the last: memory is fetched ahead in the order in which it is asked for.
            for (bits, eight) in bits.iter_mut().zip(eights) {
                let found =
                    avx._mm256_cmp_ps::<_CMP_NEQ_UQ>(pulp::cast(eight), avx._mm256_setzero_ps());
                *bits = avx._mm256_movemask_ps(found) as u8;
            }
            u64::from_le_bytes(bits)
        }
    }

    pub(super) struct Find<'a> {
        pub(super) simd: pulp::x86::V3,
        pub(super) row: &'a [f32],
        pub(super) positions: &'a mut [u32],
    }

    impl pulp::NullaryFnOnce for Find<'_> {
        type Output = usize;

        #[inline(always)]
        fn call(self) -> usize {
            find_with(EightAtATime(self.simd), self.row, self.positions)
        }
    }
}

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

/// A measurement, or none.
fn is_measurable(value: f32) -> bool {
    (0.0..=f32::MAX).contains(&value)
}

fn check_truth(plane: &[f32], what: &'static str, width: usize) -> Result<(), EvaluateError> {
    match first_unusable(plane, is_measurable) {
        None => Ok(()),
        Some(index) => Err(no_measurement(what, index, width, plane[index])),
    }
}

/// A value that is neither a measurement nor none, at a row-major index.
fn no_measurement(what: &'static str, index: usize, width: usize, value: f32) -> EvaluateError {
    EvaluateError::Truth {
        what,
        row: index / width,
        column: index % width,
        value,
    }
}

/// Where the first value is that cannot be used.
pub(super) fn first_unusable(values: &[f32], usable: impl Fn(f32) -> bool) -> Option<usize> {
    // Whole pieces without a way out are many values at a time for the processor.
    let piece = |values: &[f32]| values.iter().fold(true, |all, value| all & usable(*value));
    if values.chunks(1024).all(piece) {
        return None;
    }
    values.iter().position(|value| !usable(*value))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::protocol::StereoCamera;

    #[test]
    fn rows_make_the_truth_that_the_plane_makes() {
        let camera = KnownCamera {
            calibration: StereoCamera {
                focal_px: 700.0,
                baseline_m: 0.5,
            },
            nominal_focal_px: None,
        };
        let (width, height) = (71, 9);
        let value = |index: usize| if index % 5 == 2 { index as f32 } else { 0.0 };
        let plane: Vec<f32> = (0..width * height).map(value).collect();
        let whole = GroundTruth::new((width, height), &plane, camera).unwrap();
        for rows_at_a_time in [1, 2, 4, height] {
            let mut rows = TruthRows::new((width, height), camera);
            for some in plane.chunks(rows_at_a_time * width) {
                rows.add(some);
            }
            let truth = rows.finish().unwrap();
            assert_eq!(truth.measured, whole.measured);
            assert_eq!(truth.depth_m, whole.depth_m);
            assert_eq!(truth.rows, whole.rows);
        }
        let mut short = TruthRows::new((width, height), camera);
        short.add(&plane[width..]);
        let error = short.finish().unwrap_err();
        let found = width * (height - 1);
        assert!(
            matches!(error, EvaluateError::Size { found: size, .. } if size == found),
            "{error}"
        );
    }

    /// Rows of any length, with and without vector units.
    #[test]
    fn measured_pixels_are_found_in_every_place() {
        for length in 0..200_usize {
            for one_in in [1, 2, 7, 50, usize::MAX] {
                let is_measured =
                    |index: &usize| (index * index + index / 3).is_multiple_of(one_in);
                let value = |index: usize| match is_measured(&index) {
                    true => 0.5 + index as f32,
                    // No less nothing than without the sign.
                    false => [0.0, -0.0][index % 2],
                };
                let row: Vec<f32> = (0..length).map(value).collect();
                let expected: Vec<u32> = (0..length)
                    .filter(|&index| row[index] != 0.0)
                    .map(|index| index as u32)
                    .collect();
                let mut positions = vec![0; length + FEW];
                let count = find(&row, &mut positions);
                assert_eq!(positions[..count], expected, "{length}, one in {one_in}");
                let count = find_with(OneByOne, &row, &mut positions);
                assert_eq!(positions[..count], expected, "{length}, one in {one_in}");
            }
        }
    }
}
