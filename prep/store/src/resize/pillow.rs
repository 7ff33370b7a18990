//! Antialiased filters, byte for byte as Pillow's: the windowed sinc of three lobes (`Image.LANCZOS`) and the
//! cubic of Keys with a = -0.5 (`Image.BICUBIC`).
//!
//! Rows are filtered first and rounded to bytes, then columns; weights are rounded to multiples of
//! 2^-22. A direction that keeps its size is not filtered. So does Pillow 11; Pillow 13 filters columns
//! first where that is less work, as when only the width grows, with other bytes. For KITTI's images at
//! the networks' usual sizes both agree.

use std::f64::consts::PI;

use image::RgbImage;

/// What the weights of a pixel are taken from.
#[derive(Debug, Clone, Copy)]
pub enum Filter {
    Lanczos3,
    Bicubic,
}

impl Filter {
    /// Pixels on each side of the centre, where nothing shrinks.
    fn radius(self) -> f64 {
        match self {
            Self::Lanczos3 => 3.0,
            Self::Bicubic => 2.0,
        }
    }

    fn at(self, x: f64) -> f64 {
        match self {
            Self::Lanczos3 if (-3.0..3.0).contains(&x) => sinc(x) * sinc(x / 3.0),
            Self::Lanczos3 => 0.0,
            Self::Bicubic => cubic(x.abs()),
        }
    }
}

fn cubic(x: f64) -> f64 {
    const A: f64 = -0.5;
    if x < 1.0 {
        ((A + 2.0) * x - (A + 3.0)) * x * x + 1.0
    } else if x < 2.0 {
        (((x - 5.0) * x + 8.0) * x - 4.0) * A
    } else {
        0.0
    }
}

/// Bits behind the point of a weight: 32, less 8 of a pixel and 2 for sums above its range.
const BITS: u32 = 22;

/// The weights of a target pixel along one axis.
struct Taps {
    first: usize,
    weights: Vec<i32>,
}

/// Resizes an image.
pub fn rgb(image: &RgbImage, width: u32, height: u32, filter: Filter) -> RgbImage {
    let (source_width, source_height) = (image.width() as usize, image.height() as usize);
    let mut data = image.as_raw().clone();
    if width as usize != source_width {
        data = filter_rows(
            &data,
            source_width,
            &taps(source_width, width as usize, filter),
        );
    }
    if height as usize != source_height {
        data = filter_columns(
            &data,
            3 * width as usize,
            &taps(source_height, height as usize, filter),
        );
    }
    RgbImage::from_raw(width, height, data).expect("one value per pixel and channel")
}

fn sinc(x: f64) -> f64 {
    if x == 0.0 {
        1.0
    } else {
        (PI * x).sin() / (PI * x)
    }
}

fn taps(source: usize, target: usize, filter: Filter) -> Vec<Taps> {
    let scale = source as f64 / target as f64;
    // Shrinking widens the kernel, so that no source pixel is passed over.
    let stretch = scale.max(1.0);
    let support = filter.radius() * stretch;
    (0..target)
        .map(|index| {
            let center = (index as f64 + 0.5) * scale;
            let first = (center - support + 0.5).max(0.0) as usize;
            let end = ((center + support + 0.5) as usize).min(source);
            let weight = |pixel: usize| filter.at((pixel as f64 - center + 0.5) * stretch.recip());
            let weights: Vec<f64> = (first..end).map(weight).collect();
            let sum: f64 = weights.iter().sum();
            let fixed = |weight: &f64| (weight / sum * f64::from(1 << BITS)).round() as i32;
            Taps {
                first,
                weights: weights.iter().map(fixed).collect(),
            }
        })
        .collect()
}

/// Makes every row of RGB pixels as long as there are taps.
fn filter_rows(data: &[u8], width: usize, taps: &[Taps]) -> Vec<u8> {
    let mut filtered = Vec::with_capacity(data.len() / width * taps.len());
    for row in data.chunks_exact(3 * width) {
        for Taps { first, weights } in taps {
            let mut sums = [1 << (BITS - 1); 3];
            for (pixel, weight) in row[3 * first..].chunks_exact(3).zip(weights) {
                for (sum, value) in sums.iter_mut().zip(pixel) {
                    *sum += i32::from(*value) * weight;
                }
            }
            filtered.extend(sums.map(to_byte));
        }
    }
    filtered
}

/// Makes as many rows of `stride` bytes as there are taps.
fn filter_columns(data: &[u8], stride: usize, taps: &[Taps]) -> Vec<u8> {
    let mut filtered = Vec::with_capacity(stride * taps.len());
    let mut sums = vec![0; stride];
    for Taps { first, weights } in taps {
        sums.fill(1 << (BITS - 1));
        for (row, weight) in data[first * stride..].chunks_exact(stride).zip(weights) {
            for (sum, value) in sums.iter_mut().zip(row) {
                *sum += i32::from(*value) * weight;
            }
        }
        filtered.extend(sums.iter().copied().map(to_byte));
    }
    filtered
}

fn to_byte(sum: i32) -> u8 {
    (sum >> BITS).clamp(0, 255) as u8
}

#[cfg(test)]
mod tests {
    use super::super::tests::{fingerprint, picture};
    use super::super::{Kernel, rgb as resize};
    use super::*;

    #[test]
    fn bytes_equal_pillow() {
        // Recipe: make_golden.py store/lanczos-bytes, which asks Pillow itself (11.3.0): the sum of value
        // times 1-based index, and the pixel in column 5 of row 3. The KITTI case, a narrower
        // day, enlarging, one direction alone, one up and one down.
        let cases = [
            ((1242, 375), (512, 256), 9_862_074_842_543, [141, 192, 55]),
            ((1224, 370), (640, 192), 8_668_088_755_797, [73, 190, 141]),
            ((61, 37), (150, 90), 104_628_501_182, [75, 146, 241]),
            ((120, 80), (60, 40), 3_312_627_413, [120, 217, 88]),
            ((100, 50), (99, 50), 14_022_893_623, [242, 70, 139]),
            ((100, 50), (100, 33), 6_233_044_562, [31, 122, 214]),
            ((61, 37), (17, 90), 1_343_987_199, [162, 127, 68]),
            ((7, 300), (300, 7), 2_518_611_226, [129, 130, 135]),
        ];
        for ((width, height), (to_width, to_height), expected, pixel) in cases {
            let image = picture(width, height);
            let other = resize(&image, to_width, to_height, Kernel::Lanczos3);
            assert_eq!(
                other.get_pixel(5, 3).0,
                pixel,
                "{width}x{height} to {to_width}x{to_height}"
            );
            let values = other.as_raw().iter().map(|v| u64::from(*v));
            assert_eq!(
                fingerprint(values),
                expected,
                "{width}x{height} to {to_width}x{to_height}"
            );
        }
    }

    #[test]
    fn bicubic_bytes_equal_pillow() {
        // Recipe: make_golden.py store/bicubic-bytes, as above.
        let cases = [
            ((1242, 375), (512, 256), 9_862_124_540_369, [138, 182, 65]),
            ((61, 37), (150, 90), 104_626_487_861, [75, 146, 234]),
            ((61, 37), (17, 90), 1_343_978_709, [161, 124, 70]),
        ];
        for ((width, height), (to_width, to_height), expected, pixel) in cases {
            let image = picture(width, height);
            let other = resize(&image, to_width, to_height, Kernel::PillowBicubic);
            assert_eq!(other.get_pixel(5, 3).0, pixel, "{to_width}x{to_height}");
            let values = other.as_raw().iter().map(|v| u64::from(*v));
            assert_eq!(fingerprint(values), expected, "{to_width}x{to_height}");
        }
    }

    #[test]
    fn lanczos_keeps_a_flat_image_flat() {
        let flat = RgbImage::from_pixel(90, 60, image::Rgb([10, 130, 250]));
        let small = resize(&flat, 41, 22, Kernel::Lanczos3);
        assert_eq!(
            small,
            RgbImage::from_pixel(41, 22, image::Rgb([10, 130, 250]))
        );
    }
}
