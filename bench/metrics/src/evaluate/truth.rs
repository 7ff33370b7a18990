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
        let (width, height) = size;
        check_size("depth ground truth", depth_m.len(), width, height)?;
        let mut truth = Self::empty(size, camera, depth_m.len());
        let mut is_usable = true;
        let mut positions = Vec::new();
        for row in 0..height {
            let own = row * width..(row + 1) * width;
            is_usable &= truth.find_in_row(&depth_m[own.clone()], own.start, &mut positions);
            truth.rows.push(truth.measured.len());
        }
        if !is_usable {
            check_truth(depth_m, "depth", width)?;
        }
        Ok(truth)
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
        let mut truth = Self::empty(size, camera, depth_m.len());
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

    fn empty((width, height): (usize, usize), camera: KnownCamera, pixels: usize) -> Self {
        // As many as a scan has, so that the lists do not move while they grow.
        let expected = pixels / 16;
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

    /// Adds what a row has. Says whether every value is a measurement or none. `positions` is room for those of
    /// a row.
    fn find_in_row(&mut self, row: &[f32], start: usize, positions: &mut Vec<u32>) -> bool {
        positions.resize(row.len() + FEW, 0);
        let count = find(row, positions);
        let positions = &positions[..count];
        let known = self.depth_m.len();
        self.measured
            .extend(positions.iter().map(|position| start as u32 + position));
        self.depth_m
            .extend(positions.iter().map(|position| row[*position as usize]));
        first_unusable(&self.depth_m[known..], is_measurable).is_none()
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
    for (first, piece) in (0..).step_by(PIECE).zip(row.chunks(PIECE)) {
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
    /// A bit for each of at most [`PIECE`] pixels.
    fn bits(&self, piece: &[f32]) -> u64;
}

struct OneByOne;

impl Measured for OneByOne {
    #[inline(always)]
    fn bits(&self, piece: &[f32]) -> u64 {
        let values = piece.iter().rev();
        values.fold(0, |bits, value| bits << 1 | u64::from(*value != 0.0))
    }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use std::arch::x86_64::_CMP_NEQ_UQ;

    use super::{Measured, OneByOne, find_with};

    /// Eight pixels at a time.
    struct EightAtATime(pulp::x86::V3);

    impl Measured for EightAtATime {
        #[inline(always)]
        fn bits(&self, piece: &[f32]) -> u64 {
            let avx = self.0.avx;
            let (eights, rest) = piece.as_chunks::<8>();
            let mut bits = OneByOne.bits(rest);
            for eight in eights.iter().rev() {
                let found =
                    avx._mm256_cmp_ps::<_CMP_NEQ_UQ>(pulp::cast(*eight), avx._mm256_setzero_ps());
                bits = bits << 8 | u64::from(avx._mm256_movemask_ps(found) as u32);
            }
            bits
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
        Some(index) => Err(EvaluateError::Truth {
            what,
            row: index / width,
            column: index % width,
            value: plane[index],
        }),
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
