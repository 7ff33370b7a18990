//! A picture of one `f32` per pixel: depth, disparity.

/// One `f32` channel, row by row from the top left; `data.len() == width * height`.
#[derive(Debug, Clone, PartialEq)]
pub struct Plane {
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Values, row-major.
    pub data: Vec<f32>,
}

impl Plane {
    /// A plane over existing values; `None` if their number is not `width * height`.
    pub fn new(width: usize, height: usize, data: Vec<f32>) -> Option<Self> {
        (width.checked_mul(height) == Some(data.len())).then_some(Self {
            width,
            height,
            data,
        })
    }

    /// A plane of one value.
    pub fn filled(width: usize, height: usize, value: f32) -> Self {
        Self {
            width,
            height,
            data: vec![value; width * height],
        }
    }

    /// A row of the plane; panics outside of it, like slice indexing.
    pub fn row(&self, row: usize) -> &[f32] {
        &self.data[row * self.width..(row + 1) * self.width]
    }
}

/// Values of bytes that were read in little-endian order, which is that of nearly all machines.
pub(crate) fn from_little_endian(values: &mut [f32]) {
    if cfg!(target_endian = "big") {
        for value in values {
            *value = f32::from_le_bytes(value.to_ne_bytes());
        }
    }
}
