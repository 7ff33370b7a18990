//! Expected outputs for a closed-form image, which any runtime can be held against.

use serde::{Deserialize, Serialize};

/// Name and version of the formula behind [`probe_image`].
pub(super) const PROBE_IMAGE: &str = "triangles-1";
const PROBE_GRID: u32 = 8;
pub(super) const PROBE_POINTS: usize = (PROBE_GRID * PROBE_GRID) as usize;

/// Expected outputs for a closed-form input, so that any runtime or provider can be held against
/// the training framework without a picture at hand.
///
/// The input is [`probe_image`]; the outputs are those of the left and the right map at the
/// centres of an 8 x 8 division of the image.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Probe {
    pub(super) width: u32,
    pub(super) height: u32,
    /// 64 values of the left map in row-major order, then 64 of the right one.
    pub(super) expected: Vec<f32>,
}

/// Why a probe could not be used.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub enum ProbeError {
    /// The output has another size.
    #[error(
        "the probe needs an output of 2 maps of {width} x {height} pixels, {expected} values; the model gave {found}"
    )]
    Size {
        /// Width of the probe image.
        width: u32,
        /// Height of the probe image.
        height: u32,
        /// Number of values wanted.
        expected: usize,
        /// Number of values given.
        found: usize,
    },
    /// The model computes something that is no number.
    #[error("the model's output for the probe image is not finite at row {row}, column {column}")]
    NotFinite {
        /// Row of the first such value.
        row: usize,
        /// Column of the first such value.
        column: usize,
    },
}

impl Probe {
    /// Keeps the output `[1, 2, height, width]` that belongs to [`probe_image`] of that size.
    ///
    /// # Errors
    /// The output has another size or a value at a probed position is not finite.
    pub fn record(width: u32, height: u32, output: &[f32]) -> Result<Self, ProbeError> {
        let expected = sample(width, height, output)?;
        for (index, value) in expected.iter().enumerate() {
            if !value.is_finite() {
                let (row, column) = position(width, height, index % PROBE_POINTS);
                return Err(ProbeError::NotFinite { row, column });
            }
        }
        Ok(Self {
            width,
            height,
            expected,
        })
    }

    /// Width of the probe image in pixels.
    #[must_use]
    pub const fn width(&self) -> u32 {
        self.width
    }

    /// Height of the probe image in pixels.
    #[must_use]
    pub const fn height(&self) -> u32 {
        self.height
    }

    /// The input that the expected values belong to, `[1, 3, height, width]`.
    #[must_use]
    pub fn image(&self) -> Vec<f32> {
        probe_image(self.width, self.height)
    }

    /// Largest absolute difference to the recorded values; infinite where the output is not a
    /// number.
    ///
    /// # Errors
    /// The output has another size.
    pub fn max_difference(&self, output: &[f32]) -> Result<f32, ProbeError> {
        let found = sample(self.width, self.height, output)?;
        let difference = |(found, expected): (&f32, &f32)| {
            let difference = (found - expected).abs();
            if difference.is_nan() {
                f32::INFINITY
            } else {
                difference
            }
        };
        Ok(found
            .iter()
            .zip(&self.expected)
            .map(difference)
            .fold(0.0, f32::max))
    }
}

fn position(width: u32, height: u32, point: usize) -> (usize, usize) {
    let grid = PROBE_GRID as usize;
    let centre = |index: usize, size: u32| (2 * index + 1) * size as usize / (2 * grid);
    (centre(point / grid, height), centre(point % grid, width))
}

fn sample(width: u32, height: u32, output: &[f32]) -> Result<Vec<f32>, ProbeError> {
    let plane = width as usize * height as usize;
    if plane == 0 || output.len() != 2 * plane {
        return Err(ProbeError::Size {
            width,
            height,
            expected: 2 * plane,
            found: output.len(),
        });
    }
    let at = |map: &[f32], point| {
        let (row, column) = position(width, height, point);
        map[row * width as usize + column]
    };
    let (left, right) = output.split_at(plane);
    let values = [left, right]
        .into_iter()
        .flat_map(|map| (0..PROBE_POINTS).map(move |p| at(map, p)));
    Ok(values.collect())
}

/// A synthetic colour image with gradients, slanted waves, edges and blocks, `[1, 3, height,
/// width]`, values in 0..1.
///
/// With `u = (column + 0.5) / width`, `v = (row + 0.5) / height` and the triangle wave
/// `t(a) = |2 (a - floor(a)) - 1|`, channel `c` of 0, 1, 2 is
///
/// `0.4 v + 0.3 t((3 + 2 c) u + (2 + c) v) + 0.2 b + 0.1 t(11 u)`
///
/// where `b` is 1 if `floor(8 u) + floor(4 v) + c` is even and 0 otherwise. Sums and products are
/// evaluated in `f64` from left to right and rounded once to `f32`; there is no transcendental
/// function and no random number in it, so every machine computes the same bits.
#[must_use]
pub fn probe_image(width: u32, height: u32) -> Vec<f32> {
    let triangle = |a: f64| (2.0 * (a - a.floor()) - 1.0).abs();
    let mut image = Vec::with_capacity(3 * width as usize * height as usize);
    for c in 0..3_u32 {
        for row in 0..height {
            let v = (f64::from(row) + 0.5) / f64::from(height);
            for column in 0..width {
                let u = (f64::from(column) + 0.5) / f64::from(width);
                let wave = triangle(f64::from(3 + 2 * c) * u + f64::from(2 + c) * v);
                let block = (8.0 * u).floor() + (4.0 * v).floor() + f64::from(c);
                let block = if block % 2.0 == 0.0 { 1.0 } else { 0.0 };
                let value = 0.4 * v + 0.3 * wave + 0.2 * block + 0.1 * triangle(11.0 * u);
                image.push(value as f32);
            }
        }
    }
    image
}
