//! A model's maps of a background as depth.
//!
//! Only the pixels that a measure needs are brought to full size, with the same interpolation as whole
//! maps. Disparity becomes depth by f B / (W d) with d at least 1e-4 (decision D8), and depth is clipped
//! to [1e-3, 80] metres. Where scale or camera are unknown, depth is the clean background's median value
//! over the value, or for depth without a unit the value over that median.

use strat_onnx::metadata::OutputMeaning;
use strat_store::raster::Plane;

use super::{backgrounds::Background, rows::Unit};
use crate::{
    model::Model,
    quantity::{Conversion, Quantity},
};

/// Depth is clipped to this, metres (PROTOCOL 5).
const DEPTH_RANGE_M: [f32; 2] = [1e-3, 80.0];
/// Least disparity as a fraction of image width (decision D8).
const DISPARITY_FLOOR: f32 = 1e-4;
/// Least value of a map without a scale, as a share of its median.
const RELATIVE_FLOOR: f32 = 1e-3;

/// How values of a map become depth.
#[derive(Clone, Copy, Debug)]
enum Reading {
    /// By the camera, in metres.
    Metres(Conversion, u32, f32),
    /// The median of the clean background's map over the value.
    Relative(f32),
    /// The value over the median of the clean background's map.
    RelativeDepth(f32),
}

/// A model's maps of one background as depth.
#[derive(Clone, Copy, Debug)]
pub struct Reader {
    reading: Reading,
    width: usize,
    height: usize,
    /// Pixels of the picture that one pixel of the network covers, along the coarser axis.
    network_pixel: f64,
}

impl Reader {
    /// `clean` is the model's map of the clean background.
    #[must_use]
    pub fn new(model: &Model, background: &Background, clean: &Plane) -> Self {
        let (meaning, input_width) = (
            model.description.output.meaning(),
            model.description.input.disparity_width(),
        );
        let floor = match meaning {
            OutputMeaning::DisparityFraction => DISPARITY_FLOOR,
            OutputMeaning::DisparityPx => DISPARITY_FLOOR * input_width as f32,
            OutputMeaning::Depth
            | OutputMeaning::DepthM
            | OutputMeaning::InverseDepth
            | OutputMeaning::InverseDepthPerM => 0.0,
        };
        let metres = Conversion::new(Quantity::DepthM, meaning, input_width, background.camera);
        let reading = match metres {
            Ok(conversion) => Reading::Metres(conversion, background.ground.width, floor),
            Err(_) => {
                let mut values: Vec<f64> = clean.data.iter().copied().map(f64::from).collect();
                let median = strat_metrics::median(&mut values).unwrap_or(0.0) as f32;
                // A map without a positive value has no depth; 1 lets it be a constant.
                let median = if median > 0.0 { median } else { 1.0 };
                match meaning {
                    OutputMeaning::Depth => Reading::RelativeDepth(median),
                    _ => Reading::Relative(median),
                }
            }
        };
        Self {
            reading,
            width: background.ground.width as usize,
            height: background.ground.height as usize,
            network_pixel: f64::max(
                f64::from(background.ground.width) / clean.width as f64,
                f64::from(background.ground.height) / clean.height as f64,
            ),
        }
    }

    /// What the depths are counted in.
    #[must_use]
    pub fn unit(&self) -> Unit {
        match self.reading {
            Reading::Metres(..) => Unit::M,
            Reading::Relative(_) | Reading::RelativeDepth(_) => Unit::Relative,
        }
    }

    /// Pixels of the picture for `count` pixels of the network, or `count` where the network's are the
    /// smaller ones.
    #[must_use]
    pub fn network_pixels(&self, count: i64) -> i64 {
        (count as f64 * self.network_pixel.max(1.0)).round() as i64
    }

    /// Depth at pixels of the full-size picture.
    #[must_use]
    pub fn depths(&self, map: &Plane, pixels: impl Iterator<Item = (usize, usize)>) -> Vec<f32> {
        let x_scale = map.width as f64 / self.width as f64;
        let y_scale = map.height as f64 / self.height as f64;
        let values: Vec<f32> = pixels
            .map(|(x, y)| {
                let (left, right, across) = neighbours(x, x_scale, map.width);
                let (upper, lower, down) = neighbours(y, y_scale, map.height);
                let along = |row: usize| {
                    let row = map.row(row);
                    row[left] * (1.0 - across) + row[right] * across
                };
                along(upper) * (1.0 - down) + along(lower) * down
            })
            .collect();
        self.convert(values)
    }

    /// The whole map at full size.
    #[must_use]
    pub fn whole(&self, map: &Plane) -> Plane {
        let (width, height) = (self.width, self.height);
        let pixels = (0..width * height).map(|index| (index % width, index / width));
        Plane {
            width,
            height,
            data: self.depths(map, pixels),
        }
    }

    fn convert(&self, mut values: Vec<f32>) -> Vec<f32> {
        match self.reading {
            Reading::Relative(median) => {
                for value in &mut values {
                    *value = median / value.max(RELATIVE_FLOOR * median);
                }
                values
            }
            Reading::RelativeDepth(median) => {
                for value in &mut values {
                    *value = value.max(RELATIVE_FLOOR * median) / median;
                }
                values
            }
            Reading::Metres(conversion, image_width, floor) => {
                for value in &mut values {
                    *value = value.max(floor);
                }
                let line = Plane {
                    width: values.len(),
                    height: 1,
                    data: values,
                };
                let mut depth = conversion.apply(line, image_width).data;
                let [nearest, farthest] = DEPTH_RANGE_M;
                for value in &mut depth {
                    *value = value.clamp(nearest, farthest);
                }
                depth
            }
        }
    }
}

/// The two samples around a position of the larger grid and the weight of the second (PROTOCOL 3.3).
fn neighbours(index: usize, scale: f64, length: usize) -> (usize, usize, f32) {
    let position = (index as f64 + 0.5) * scale - 0.5;
    if position < 0.0 {
        return (0, 0, 0.0);
    }
    let low = (position as usize).min(length - 1);
    if low == length - 1 {
        return (low, low, 0.0);
    }
    (low, low + 1, (position - position.floor()) as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reader(reading: Reading, network_pixel: f64) -> Reader {
        Reader {
            reading,
            width: 1242,
            height: 375,
            network_pixel,
        }
    }

    /// Without a unit, depth and its inverse tell the same: twice the median is twice as far or half.
    #[test]
    fn relative_depth_is_read_as_such() {
        let depths = |reading, values: &[f32]| reader(reading, 1.0).convert(values.to_vec());
        assert_eq!(
            depths(Reading::RelativeDepth(4.0), &[4.0, 8.0, -1.0]),
            [1.0, 2.0, 1e-3]
        );
        assert_eq!(depths(Reading::Relative(4.0), &[4.0, 2.0]), [1.0, 2.0]);
    }

    /// 1242 x 375 seen by 640 x 192: 1.94 and 1.95 pixels of the picture each, so three are 5.9.
    #[test]
    fn pixels_of_the_network_are_counted_in_the_picture() {
        let reader = |network_pixel| reader(Reading::Relative(1.0), network_pixel);
        assert_eq!(reader(375.0 / 192.0).network_pixels(3), 6);
        assert_eq!(reader(1242.0 / 512.0).network_pixels(3), 7);
        // A network that sees more than the picture has gains nothing.
        assert_eq!(reader(0.5).network_pixels(3), 3);
    }
}
