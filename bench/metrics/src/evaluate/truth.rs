//! What is known of an image, and which of its pixels were measured.

use super::error::EvaluateError;
use crate::metrics::CropBox;
use crate::protocol::KnownCamera;

/// What is known of an image: row-major planes, of which each value was looked at once.
///
/// Several protocols look at the same planes, so where something was measured is found when the
/// planes come in.
#[derive(Clone, Debug)]
pub struct GroundTruth {
    pub(super) width: usize,
    pub(super) height: usize,
    /// Depth in metres, 0 where there is none.
    pub(super) depth_m: Vec<f32>,
    pub(super) disparity_px: Option<Vec<f32>>,
    pub(super) labels: Option<Vec<u8>>,
    pub(super) camera: KnownCamera,
    /// Row-major indices of the pixels with ground truth, in ascending order.
    pub(super) measured: Vec<u32>,
    /// Where each row begins in `measured`, and the end.
    rows: Vec<usize>,
}

impl GroundTruth {
    /// Depth in metres at `size` (columns, rows), 0 where there is none.
    ///
    /// # Errors
    /// A plane of wrong size, and values that are negative or not finite.
    pub fn new(
        size: (usize, usize),
        depth_m: Vec<f32>,
        camera: KnownCamera,
    ) -> Result<Self, EvaluateError> {
        Self::of_planes(size, depth_m, None, camera)
    }

    /// The same with disparity in pixels, 0 where there is none: stereo ground truth, whose depth
    /// is computed from it in double precision, and what D1-all needs.
    ///
    /// # Errors
    /// As for [`GroundTruth::new`].
    pub fn stereo(
        size: (usize, usize),
        depth_m: Vec<f32>,
        disparity_px: Vec<f32>,
        camera: KnownCamera,
    ) -> Result<Self, EvaluateError> {
        Self::of_planes(size, depth_m, Some(disparity_px), camera)
    }

    fn of_planes(
        (width, height): (usize, usize),
        depth_m: Vec<f32>,
        disparity_px: Option<Vec<f32>>,
        camera: KnownCamera,
    ) -> Result<Self, EvaluateError> {
        for (plane, what, values) in [
            ("depth ground truth", "depth", Some(&depth_m)),
            ("disparity ground truth", "disparity", disparity_px.as_ref()),
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
        let mut measured = Vec::with_capacity(depth_m.len() / 16);
        let mut rows = Vec::with_capacity(height + 1);
        rows.push(0);
        for row in 0..height {
            let own = row * width..(row + 1) * width;
            match &disparity_px {
                None => find_in_row(&depth_m[own.clone()], own.start, &mut measured),
                // What has only one of the two is some protocol's ground truth as well.
                Some(disparity_px) => measured.extend(
                    own.filter(|&index| depth_m[index] != 0.0 || disparity_px[index] != 0.0)
                        .map(|index| index as u32),
                ),
            }
            rows.push(measured.len());
        }
        Ok(Self {
            width,
            height,
            depth_m,
            disparity_px,
            labels: None,
            camera,
            measured,
            rows,
        })
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

    /// Depth in metres, 0 where there is none.
    #[must_use]
    pub fn depth_m(&self) -> &[f32] {
        &self.depth_m
    }

    /// What is known of the camera.
    #[must_use]
    pub fn camera(&self) -> &KnownCamera {
        &self.camera
    }

    /// Indices of measured pixels within a part of the image, row by row.
    pub(super) fn within(&self, crop: CropBox) -> impl Iterator<Item = usize> {
        (crop.top..crop.bottom).flat_map(move |row| {
            let own = &self.measured[self.rows[row]..self.rows[row + 1]];
            let before = |column: usize| {
                let end = row * self.width + column;
                own.partition_point(|&index| (index as usize) < end)
            };
            own[before(crop.left)..before(crop.right)]
                .iter()
                .map(|&index| index as usize)
        })
    }
}

/// Nineteen of twenty pixels of a scan have nothing, most of them in runs: finding the others is
/// what takes time. Within a piece their indices are gathered without a branch, since no processor
/// can foresee them.
fn find_in_row(row: &[f32], start: usize, found: &mut Vec<u32>) {
    for (start, piece) in (start..).step_by(PIECE).zip(row.chunks(PIECE)) {
        if piece.iter().fold(0, |all, value| all | value.to_bits()) == 0 {
            continue;
        }
        let (mut indices, mut count) = ([0; PIECE], 0);
        for (index, value) in piece.iter().enumerate() {
            indices[count % PIECE] = (start + index) as u32;
            count += usize::from(*value != 0.0);
        }
        found.extend_from_slice(&indices[..count]);
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

/// Every value is finite and not negative.
pub(super) fn check_plane(
    plane: &[f32],
    width: usize,
    error: impl Fn(usize, usize, f32) -> EvaluateError,
) -> Result<(), EvaluateError> {
    check_values(
        plane,
        width,
        |value| (0.0..=f32::MAX).contains(&value),
        error,
    )
}

/// Every value is finite.
pub(super) fn check_finite(
    plane: &[f32],
    width: usize,
    error: impl Fn(usize, usize, f32) -> EvaluateError,
) -> Result<(), EvaluateError> {
    check_values(plane, width, f32::is_finite, error)
}

fn check_values(
    plane: &[f32],
    width: usize,
    usable: impl Fn(f32) -> bool,
    error: impl Fn(usize, usize, f32) -> EvaluateError,
) -> Result<(), EvaluateError> {
    // Whole pieces without a way out are many values at a time for the processor.
    let piece = |values: &[f32]| values.iter().fold(true, |all, value| all & usable(*value));
    if plane.chunks(1024).all(piece) {
        return Ok(());
    }
    match plane.iter().position(|value| !usable(*value)) {
        Some(index) => Err(error(index / width, index % width, plane[index])),
        None => Ok(()),
    }
}
