//! Interpolation between the nearest pixels without antialiasing: linear over two pixels a direction, cubic
//! over four, with either convention for where the pixels of two sizes lie.
//!
//! Cubic is the convolution of Keys with a = -0.75, as in OpenCV's `INTER_CUBIC` and PyTorch's `bicubic`
//! (PROTOCOL 10.5). Beyond the border the outermost pixel is repeated.

use image::RgbImage;

use super::bilinear::{self, bilinear_f32};
use crate::raster::Plane;

/// How many pixels a value is made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Interpolation {
    /// The two nearest in each direction.
    Linear,
    /// The four nearest in each direction; values may leave the range of the source.
    Cubic,
}

/// Where the pixels of two sizes lie.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Alignment {
    /// The outer edges coincide, so pixel i of n lies at (i + 1/2) / n: OpenCV, and PyTorch with
    /// `align_corners=False`.
    Edges,
    /// The centres of the corner pixels coincide, so pixel i of n lies at i / (n - 1): PyTorch with
    /// `align_corners=True`.
    Corners,
}

/// Keys' parameter.
const A: f64 = -0.75;

/// The first of four neighbours, which may lie outside, and the weights of all four.
struct Tap {
    first: i64,
    weights: [f32; 4],
}

/// Resizes a plane, first along rows, then along columns, in `f32`.
///
/// # Panics
/// If a plane has no pixels.
pub fn interpolate_f32(
    source: &Plane,
    width: usize,
    height: usize,
    interpolation: Interpolation,
    alignment: Alignment,
) -> Plane {
    if (interpolation, alignment) == (Interpolation::Linear, Alignment::Edges) {
        return bilinear_f32(source, width, height);
    }
    assert!(
        source.width > 0 && source.height > 0 && width > 0 && height > 0,
        "planes have pixels"
    );
    let columns = taps(source.width, width, interpolation, alignment);
    let rows = taps(source.height, height, interpolation, alignment);
    let mut wide = Vec::with_capacity(width * source.height);
    for row in 0..source.height {
        let values = source.row(row);
        wide.extend(columns.iter().map(|tap| {
            let value = |k: i64| values[inside(tap.first + k, source.width)];
            let [a, b, c, d] = tap.weights;
            value(0) * a + value(1) * b + value(2) * c + value(3) * d
        }));
    }
    let mut data = Vec::with_capacity(width * height);
    for tap in &rows {
        let row = |k: i64| {
            let row = inside(tap.first + k, source.height);
            &wide[row * width..(row + 1) * width]
        };
        let [a, b, c, d] = tap.weights;
        let upper = row(0).iter().zip(row(1));
        let lower = row(2).iter().zip(row(3));
        data.extend(
            upper
                .zip(lower)
                .map(|((p, q), (r, s))| p * a + q * b + r * c + s * d),
        );
    }
    Plane {
        width,
        height,
        data,
    }
}

fn inside(index: i64, count: usize) -> usize {
    index.clamp(0, count as i64 - 1) as usize
}

fn taps(
    source: usize,
    target: usize,
    interpolation: Interpolation,
    alignment: Alignment,
) -> Vec<Tap> {
    let position = |index: usize| match alignment {
        Alignment::Edges => (index as f64 + 0.5) * (source as f64 / target as f64) - 0.5,
        Alignment::Corners if target == 1 => 0.0,
        Alignment::Corners => index as f64 * ((source as f64 - 1.0) / (target as f64 - 1.0)),
    };
    (0..target)
        .map(|index| {
            let position = position(index);
            let t = position - position.floor();
            Tap {
                first: position.floor() as i64 - 1,
                weights: match interpolation {
                    Interpolation::Linear => [0.0, 1.0 - t, t, 0.0],
                    Interpolation::Cubic => {
                        let [outer, near] = [far(1.0 + t), close(t)];
                        let next = close(1.0 - t);
                        [outer, near, next, 1.0 - outer - near - next]
                    }
                }
                .map(|weight| weight as f32),
            }
        })
        .collect()
}

/// The kernel at a distance of 0 to 1.
fn close(x: f64) -> f64 {
    ((A + 2.0) * x - (A + 3.0)) * x * x + 1.0
}

/// The kernel at a distance of 1 to 2.
fn far(x: f64) -> f64 {
    ((A * x - 5.0 * A) * x + 8.0 * A) * x - 4.0 * A
}

/// Resizes an image by cubic interpolation, each channel as a plane, rounded to grey levels.
pub fn cubic_rgb(image: &RgbImage, width: u32, height: u32) -> RgbImage {
    bilinear::by_planes(image, width, height, |plane, width, height| {
        interpolate_f32(plane, width, height, Interpolation::Cubic, Alignment::Edges)
    })
}

#[cfg(test)]
mod tests {
    use super::super::tests::{picture, plane};
    use super::super::{Kernel, rgb};
    use super::*;

    #[test]
    fn planes_equal_the_oracle() {
        use Alignment::{Corners, Edges};
        use Interpolation::{Cubic, Linear};
        // Recipe: make_golden.py store/interpolate: the sum of all values, and three of them.
        let cases = [
            (
                Cubic,
                Edges,
                (150, 90),
                [6696.916174543, -0.020486707, 0.283292871, 0.98934486],
            ),
            (
                Cubic,
                Edges,
                (17, 20),
                [171.453240534, 0.189621287, 0.75243101, 0.690720379],
            ),
            (
                Cubic,
                Corners,
                (150, 90),
                [6699.409030069, 0.0, 0.35823303, 0.841544482],
            ),
            (
                Cubic,
                Corners,
                (17, 20),
                [169.560060296, 0.0, 0.957232349, 0.122406006],
            ),
            (
                Linear,
                Corners,
                (150, 90),
                [6696.281805258, 0.0, 0.353027675, 0.797346896],
            ),
            (
                Linear,
                Corners,
                (17, 20),
                [169.600688734, 0.0, 0.803402549, 0.1640625],
            ),
        ];
        for (interpolation, alignment, (width, height), expected) in cases {
            let other = interpolate_f32(&plane(), width, height, interpolation, alignment);
            assert_eq!((other.width, other.height), (width, height));
            let sum: f64 = other.data.iter().map(|v| f64::from(*v)).sum();
            let at = |row: usize, column: usize| f64::from(other.data[row * width + column]);
            let found = [sum, at(0, 0), at(3, 5), at(height - 1, width - 2)];
            for (found, expected) in found.into_iter().zip(expected) {
                let difference = (found - expected).abs();
                assert!(
                    difference < 1e-6 * expected.abs().max(1.0),
                    "{interpolation:?} {alignment:?} {width}x{height}: {found} is not {expected}"
                );
            }
        }
    }

    #[test]
    fn corners_stay_where_they_are() {
        let row = Plane::new(3, 1, vec![0.0, 1.0, 4.0]).unwrap();
        let wide = |n| interpolate_f32(&row, n, 1, Interpolation::Linear, Alignment::Corners).data;
        assert_eq!(wide(5), [0.0, 0.5, 1.0, 2.5, 4.0]);
        assert_eq!(wide(1), [0.0]);
        let same = interpolate_f32(&plane(), 61, 37, Interpolation::Cubic, Alignment::Corners);
        assert_eq!(same, plane());
    }

    #[test]
    fn bytes_are_those_of_opencv_within_a_grey_level() {
        // Recipe: make_golden.py store/cubic-bytes, which asks OpenCV itself (5.0.0): the green channel.
        let cases: [((u32, u32), &[u8]); 2] = [
            (
                (16, 9),
                &[
                    67, 83, 109, 128, 149, 172, 191, 254, 165, 0, 8, 43, 64, 83, 108, 124, 78, 95,
                    122, 142, 165, 197, 214, 123, 36, 21, 40, 68, 91, 111, 138, 155, 93, 111, 141,
                    162, 184, 232, 255, 74, 0, 54, 77, 103, 127, 147, 188, 219, 106, 126, 157, 180,
                    218, 237, 214, 92, 34, 82, 106, 134, 162, 196, 196, 179, 119, 139, 173, 197,
                    252, 189, 30, 36, 81, 108, 133, 163, 193, 241, 130, 0, 131, 153, 194, 225, 125,
                    32, 39, 68, 106, 133, 157, 219, 231, 93, 27, 36, 144, 165, 218, 255, 105, 0,
                    68, 100, 131, 163, 228, 195, 91, 24, 39, 88, 159, 192, 212, 187, 92, 45, 94,
                    126, 166, 191, 185, 87, 0, 53, 106, 128, 170, 223, 183, 13, 18, 84, 113, 145,
                    199, 209, 43, 0, 63, 92, 133, 158,
                ],
            ),
            (
                (5, 4),
                &[
                    92, 164, 143, 51, 123, 127, 216, 39, 124, 199, 158, 67, 93, 197, 16, 210, 57,
                    153, 62, 115,
                ],
            ),
        ];
        for ((width, height), expected) in cases {
            let other = rgb(&picture(11, 7), width, height, Kernel::OpencvCubic);
            assert_eq!(expected.len(), (width * height) as usize);
            for (pixel, expected) in other.pixels().zip(expected) {
                assert!(
                    pixel.0[1].abs_diff(*expected) <= 1,
                    "{} {expected}",
                    pixel.0[1]
                );
            }
        }
    }
}
