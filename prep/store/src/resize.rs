//! Resize kernels whose result is part of a protocol, and so must never change.
//!
//! `Area` follows OpenCV's `INTER_AREA` in value and rounding: a box filter with fractional
//! edge weights (PROTOCOL 3.10). `Bilinear` follows OpenCV's `INTER_LINEAR` convention:
//! half-pixel centres, repeated border, no antialiasing (PROTOCOL 3.3). `Lanczos3` is the
//! antialiased kernel of PIL. Coordinates are computed in `f64`.

use std::fmt;
use std::str::FromStr;

use fast_image_resize as fir;
use image::RgbImage;
use serde::{Deserialize, Serialize};

use crate::raster::Plane;

/// How an image is brought to another size.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kernel {
    /// Every target pixel is the mean of the source area it covers. Enlarging falls back to
    /// [`Kernel::Bilinear`].
    #[default]
    Area,
    /// Linear interpolation between the four nearest source pixels.
    Bilinear,
    /// Antialiased windowed sinc of three lobes.
    Lanczos3,
}

/// A name that is no kernel.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("there is no resize kernel `{0}`; the kernels are `area`, `bilinear` and `lanczos3`")]
pub struct ParseKernelError(String);

impl Kernel {
    /// All kernels.
    pub const ALL: [Self; 3] = [Self::Area, Self::Bilinear, Self::Lanczos3];

    /// `area`, `bilinear` or `lanczos3`.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Area => "area",
            Self::Bilinear => "bilinear",
            Self::Lanczos3 => "lanczos3",
        }
    }
}

impl fmt::Display for Kernel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

impl FromStr for Kernel {
    type Err = ParseKernelError;

    fn from_str(text: &str) -> Result<Self, ParseKernelError> {
        Self::ALL
            .into_iter()
            .find(|k| k.as_str() == text)
            .ok_or_else(|| ParseKernelError(text.to_owned()))
    }
}

/// Resizes an RGB image to `width` x `height`; the same size gives a copy.
///
/// # Panics
/// If an image has no pixels.
pub fn rgb(image: &RgbImage, width: u32, height: u32, kernel: Kernel) -> RgbImage {
    assert!(
        image.width() > 0 && image.height() > 0 && width > 0 && height > 0,
        "images have pixels"
    );
    if image.dimensions() == (width, height) {
        return image.clone();
    }
    let shrinks = image.width() >= width && image.height() >= height;
    match kernel {
        Kernel::Area if shrinks => area_rgb(image, width, height),
        Kernel::Area | Kernel::Bilinear => bilinear_rgb(image, width, height),
        Kernel::Lanczos3 => lanczos_rgb(image, width, height),
    }
}

/// Resizes a plane by area means; enlarging falls back to [`bilinear_f32`].
///
/// # Panics
/// If a plane has no pixels.
pub fn area_f32(source: &Plane, width: usize, height: usize) -> Plane {
    assert!(
        source.width > 0 && source.height > 0 && width > 0 && height > 0,
        "planes have pixels"
    );
    if width > source.width || height > source.height {
        return bilinear_f32(source, width, height);
    }
    let columns = area_cells(source.width, width);
    let rows = area_cells(source.height, height);
    let mut data = Vec::with_capacity(width * height);
    let mut sums = vec![0.0_f64; width];
    for cell in &rows {
        sums.fill(0.0);
        for (source_row, row_weight) in cell.weights() {
            let values = source.row(source_row);
            for (sum, cell) in sums.iter_mut().zip(&columns) {
                let mean: f64 = cell
                    .weights()
                    .map(|(column, weight)| weight * f64::from(values[column]))
                    .sum();
                *sum += row_weight * mean;
            }
        }
        data.extend(sums.iter().map(|sum| *sum as f32));
    }
    Plane {
        width,
        height,
        data,
    }
}

/// Resizes a plane by linear interpolation, first along rows, then along columns, in `f32`.
///
/// # Panics
/// If a plane has no pixels.
pub fn bilinear_f32(source: &Plane, width: usize, height: usize) -> Plane {
    assert!(
        source.width > 0 && source.height > 0 && width > 0 && height > 0,
        "planes have pixels"
    );
    let columns = linear_taps(source.width, width);
    let rows = linear_taps(source.height, height);
    let stretch = |row: usize, into: &mut Vec<f32>| {
        let values = source.row(row);
        into.clear();
        into.extend(columns.iter().map(|tap| {
            values[tap.low as usize] * tap.weights[0] + values[tap.high as usize] * tap.weights[1]
        }));
    };
    let mut data = Vec::with_capacity(width * height);
    // The two stretched source rows in use; enlarging uses each of them several times.
    let mut cached = [(usize::MAX, Vec::new()), (usize::MAX, Vec::new())];
    for tap in &rows {
        let (low, high) = (tap.low as usize, tap.high as usize);
        for wanted in [low, high] {
            if cached[wanted % 2].0 != wanted {
                stretch(wanted, &mut cached[wanted % 2].1);
                cached[wanted % 2].0 = wanted;
            }
        }
        let (low, high) = (&cached[low % 2].1, &cached[high % 2].1);
        let [of_low, of_high] = tap.weights;
        data.extend(low.iter().zip(high).map(|(a, b)| a * of_low + b * of_high));
    }
    Plane {
        width,
        height,
        data,
    }
}

/// The two neighbours of a target pixel along one axis and their weights; small, as every pixel of
/// a row asks for one.
struct Tap {
    low: u32,
    high: u32,
    weights: [f32; 2],
}

fn linear_taps(source: usize, target: usize) -> Vec<Tap> {
    let scale = source as f64 / target as f64;
    (0..target)
        .map(|index| {
            let position = (index as f64 + 0.5) * scale - 0.5;
            let floor = position.floor();
            if floor < 0.0 {
                return Tap {
                    low: 0,
                    high: 1.min(source - 1) as u32,
                    weights: [1.0, 0.0],
                };
            }
            let low = (floor as usize).min(source - 1);
            let weight = if low == source - 1 {
                0.0
            } else {
                (position - floor) as f32
            };
            Tap {
                low: low as u32,
                high: (low + 1).min(source - 1) as u32,
                weights: [1.0 - weight, weight],
            }
        })
        .collect()
}

/// The source pixels that a target pixel covers along one axis.
struct Cell {
    first: usize,
    weights: Vec<f64>,
}

impl Cell {
    fn weights(&self) -> impl Iterator<Item = (usize, f64)> {
        (self.first..).zip(self.weights.iter().copied())
    }
}

fn area_cells(source: usize, target: usize) -> Vec<Cell> {
    let scale = source as f64 / target as f64;
    (0..target)
        .map(|index| {
            let (start, end) = (index as f64 * scale, index as f64 * scale + scale);
            let first = (start.floor() as usize).min(source - 1);
            let last = (end.ceil() as usize).clamp(first + 1, source);
            let overlap = |pixel: usize| {
                (end.min((pixel + 1) as f64) - start.max(pixel as f64)).max(0.0) / scale
            };
            Cell {
                first,
                weights: (first..last).map(overlap).collect(),
            }
        })
        .collect()
}

/// OpenCV's `f32` weights of a target pixel: parts below a thousandth of a pixel are left out.
fn opencv_area_cells(source: usize, target: usize) -> Vec<(usize, Vec<f32>)> {
    let scale = source as f64 / target as f64;
    (0..target)
        .map(|index| {
            let start = index as f64 * scale;
            let end = start + scale;
            let cell = scale.min(source as f64 - start);
            let last_whole = (end.floor() as usize).min(source - 1);
            let first_whole = (start.ceil() as usize).min(last_whole);
            let mut first = first_whole;
            let mut weights = Vec::new();
            let before = first_whole as f64 - start;
            if before > 1e-3 {
                first -= 1;
                weights.push((before / cell) as f32);
            }
            weights.extend((first_whole..last_whole).map(|_| (1.0 / cell) as f32));
            let after = end - last_whole as f64;
            if after > 1e-3 {
                weights.push((after.min(1.0).min(cell) / cell) as f32);
            }
            (first, weights)
        })
        .collect()
}

fn area_rgb(image: &RgbImage, width: u32, height: u32) -> RgbImage {
    let (source_width, source_height) = (image.width() as usize, image.height() as usize);
    let (target_width, target_height) = (width as usize, height as usize);
    if source_width % target_width == 0 && source_height % target_height == 0 {
        return block_mean_rgb(image, width, height);
    }
    let columns = opencv_area_cells(source_width, target_width);
    let few = fixed_weights(&columns);
    // Compiled for the vector units of this machine. The order of additions is that of the code, so
    // the bytes are the same on all of them.
    pulp::Arch::new().dispatch(|| match &few {
        Some(columns) => narrow_rows(image, width, height, |values, narrowed| {
            narrow_row_by_few(values, columns, narrowed);
        }),
        None => narrow_rows(image, width, height, |values, narrowed| {
            narrow_row(values, &columns, narrowed);
        }),
    })
}

/// Area means of rows that `narrow` has made of the source's rows; both are given one number more
/// than there are, and the source's also what [`FEW`] weights may ask for: pixels are read and written
/// four lanes at a time.
#[inline(always)]
fn narrow_rows(
    image: &RgbImage,
    width: u32,
    height: u32,
    narrow: impl Fn(&[f32], &mut [f32]),
) -> RgbImage {
    let (target_width, target_height) = (width as usize, height as usize);
    let rows = opencv_area_cells(image.height() as usize, target_height);
    let stride = 3 * image.width() as usize;
    let mut values = vec![0.0_f32; stride + 3 * FEW + 1];
    let mut narrowed = vec![0.0_f32; 3 * target_width + 1];
    let mut narrowed_row = None;
    let mut sums = vec![0.0_f32; 3 * target_width];
    let mut data = Vec::with_capacity(3 * target_width * target_height);
    for (first_row, row_weights) in &rows {
        sums.fill(0.0);
        for (row, row_weight) in (*first_row..).zip(row_weights) {
            // A source row on the border of two target rows is narrowed once for both.
            if narrowed_row != Some(row) {
                let line = &image.as_raw()[row * stride..(row + 1) * stride];
                values
                    .iter_mut()
                    .zip(line)
                    .for_each(|(value, byte)| *value = f32::from(*byte));
                narrow(&values, &mut narrowed);
                narrowed_row = Some(row);
            }
            sums.iter_mut()
                .zip(&narrowed)
                .for_each(|(sum, mean)| *sum += row_weight * mean);
        }
        data.extend(sums.iter().map(|sum| mean_to_byte(*sum)));
    }
    RgbImage::from_raw(width, height, data).expect("one value per pixel and channel")
}

/// Weighted sums along a row of RGB values, in the order of OpenCV's additions.
#[inline(always)]
fn narrow_row(values: &[f32], columns: &[(usize, Vec<f32>)], narrowed: &mut [f32]) {
    for (target, (first, weights)) in narrowed.chunks_exact_mut(3).zip(columns) {
        // Four lanes, the last one idle: what the vector units of every machine can do.
        let mut sum = [0.0_f32; 4];
        for (at, weight) in (3 * first..).step_by(3).zip(weights) {
            for (sum, value) in sum.iter_mut().zip(&values[at..at + 4]) {
                *sum += value * weight;
            }
        }
        target.copy_from_slice(&sum[..3]);
    }
}

/// Most weights for which there is a loop without a loop: KITTI's images at the network's size have
/// three or four.
const FEW: usize = 4;

/// The same weights, filled up with zeros, unless there are more than [`FEW`].
fn fixed_weights(columns: &[(usize, Vec<f32>)]) -> Option<Vec<(usize, [f32; FEW])>> {
    let fixed = columns.iter().map(|(first, weights)| {
        let mut few = [0.0; FEW];
        few.get_mut(..weights.len())?.copy_from_slice(weights);
        Some((*first, few))
    });
    fixed.collect()
}

/// As [`narrow_row`]: adding a number times zero changes no sum.
#[inline(always)]
fn narrow_row_by_few(values: &[f32], columns: &[(usize, [f32; FEW])], narrowed: &mut [f32]) {
    for (at, (first, weights)) in columns.iter().enumerate() {
        let values = &values[3 * first..3 * first + 3 * FEW + 1];
        let mut sum = [0.0_f32; 4];
        for (pixel, weight) in weights.iter().enumerate() {
            for lane in 0..4 {
                sum[lane] += values[3 * pixel + lane] * weight;
            }
        }
        // The fourth lane is written over by the next pixel.
        narrowed[3 * at..3 * at + 4].copy_from_slice(&sum);
    }
}

/// Rounds a mean of bytes half to even, as [`to_byte`] does; without SSE4.1 the standard method is
/// a library call.
#[inline(always)]
fn mean_to_byte(mean: f32) -> u8 {
    // From this number on neighbours are one apart, so the addition rounds and leaves the result
    // in the last bits.
    const SHIFT: f32 = 12_582_912.0;
    ((mean + SHIFT).to_bits() - SHIFT.to_bits()).min(255) as u8
}

/// Area mean where every target pixel covers whole source pixels. OpenCV sums integers here
/// and rounds halves up for 2 x 2 blocks, to even otherwise.
fn block_mean_rgb(image: &RgbImage, width: u32, height: u32) -> RgbImage {
    let (block_width, block_height) = (image.width() / width, image.height() / height);
    let area = block_width * block_height;
    let scale = 1.0 / area as f32;
    RgbImage::from_fn(width, height, |x, y| {
        let mut sum = [0_u64; 3];
        for row in y * block_height..(y + 1) * block_height {
            for column in x * block_width..(x + 1) * block_width {
                for (sum, value) in sum.iter_mut().zip(image.get_pixel(column, row).0) {
                    *sum += u64::from(value);
                }
            }
        }
        image::Rgb(sum.map(|sum| match (block_width, block_height) {
            (2, 2) => ((sum + 2) / 4) as u8,
            _ => to_byte(sum as f32 * scale),
        }))
    })
}

fn bilinear_rgb(image: &RgbImage, width: u32, height: u32) -> RgbImage {
    let planes: [Plane; 3] = std::array::from_fn(|channel| {
        let data = image
            .pixels()
            .map(|pixel| f32::from(pixel.0[channel]))
            .collect();
        let plane = Plane {
            width: image.width() as usize,
            height: image.height() as usize,
            data,
        };
        bilinear_f32(&plane, width as usize, height as usize)
    });
    let data = (0..planes[0].data.len())
        .flat_map(|i| planes.each_ref().map(|plane| to_byte(plane.data[i])))
        .collect();
    RgbImage::from_raw(width, height, data).expect("one value per pixel and channel")
}

fn lanczos_rgb(image: &RgbImage, width: u32, height: u32) -> RgbImage {
    // Images whose type of pixel is known only when it runs would compile the loops of all types,
    // which takes a minute and a half.
    use fir::images::{TypedImage, TypedImageRef};
    use fir::pixels::U8x3;

    let source = TypedImageRef::<U8x3>::from_buffer(image.width(), image.height(), image.as_raw())
        .expect("an RGB image has three bytes a pixel");
    let mut target = RgbImage::new(width, height);
    let mut view = TypedImage::<U8x3>::from_buffer(width, height, &mut target)
        .expect("an RGB image has three bytes a pixel");
    let options = fir::ResizeOptions::new()
        .resize_alg(fir::ResizeAlg::Convolution(fir::FilterType::Lanczos3));
    fir::Resizer::new()
        .resize_typed(&source, &mut view, &options)
        .expect("both images have pixels");
    target
}

fn to_byte(value: f32) -> u8 {
    value.round_ties_even().clamp(0.0, 255.0) as u8
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// (31 x + 17 y + 71 c + 3 (x y mod 97)) mod 256
    fn picture(width: u32, height: u32) -> RgbImage {
        RgbImage::from_fn(width, height, |x, y| {
            image::Rgb([0, 1, 2].map(|c| ((31 * x + 17 * y + 71 * c + x * y % 97 * 3) % 256) as u8))
        })
    }

    /// The red channel of [`picture`] over 256.
    fn plane() -> Plane {
        let data = picture(61, 37)
            .pixels()
            .map(|p| f32::from(p.0[0]) / 256.0)
            .collect();
        Plane {
            width: 61,
            height: 37,
            data,
        }
    }

    /// Sum of value times 1-based index, modulo 2^64.
    fn fingerprint(values: impl IntoIterator<Item = u64>) -> u64 {
        values
            .into_iter()
            .zip(1_u64..)
            .fold(0, |sum, (v, i)| sum.wrapping_add(v.wrapping_mul(i)))
    }

    #[test]
    fn area_bytes_equal_opencv() {
        // Recipe: make_golden.py store/area-bytes, which asks OpenCV itself (5.0.0).
        // The KITTI case, a narrower day, 2 x 2 and 3 x 4 blocks, barely shrinking both ways and one way.
        let cases = [
            ((1242, 375), (512, 256), 9_862_116_551_447, [142, 179, 66]),
            ((1224, 370), (512, 256), 9_862_302_608_471, [131, 182, 71]),
            ((120, 80), (60, 40), 3_316_965_423, [129, 200, 79]),
            ((120, 80), (40, 20), 368_269_288, [157, 122, 107]),
            ((61, 37), (17, 36), 215_129_398, [65, 128, 150]),
            ((100, 50), (99, 50), 14_022_187_139, [238, 68, 139]),
        ];
        for ((width, height), (to_width, to_height), expected, pixel) in cases {
            let small = rgb(&picture(width, height), to_width, to_height, Kernel::Area);
            assert_eq!(small.get_pixel(5, 3).0, pixel, "{width}x{height}");
            let values = small.as_raw().iter().map(|v| u64::from(*v));
            assert_eq!(fingerprint(values), expected, "{width}x{height}");
        }
    }

    #[test]
    fn area_planes_equal_the_oracle() {
        // Recipe: make_golden.py store/area: the sum, row 3 column 5, and the last value.
        let small = area_f32(&plane(), 17, 20);
        let sum: f64 = small.data.iter().map(|v| f64::from(*v)).sum();
        assert!((sum - 168.654_810_035_445_28).abs() < 1e-5, "{sum}");
        assert!((f64::from(small.row(3)[5]) - 0.577_019_065_684_537).abs() < 1e-7);
        assert!((f64::from(small.row(19)[16]) - 0.532_802_461_785_556).abs() < 1e-7);
        assert_eq!(
            area_f32(&plane(), 61, 37),
            plane(),
            "the same size changes nothing"
        );
        // [0, 3, 6] over two pixels: (0 + 3/2) / 1.5 and (3/2 + 6) / 1.5
        let row = Plane::new(3, 1, vec![0.0, 3.0, 6.0]).unwrap();
        assert_eq!(area_f32(&row, 2, 1).data, [1.0, 5.0]);
    }

    #[test]
    fn bilinear_planes_equal_the_oracle_bit_for_bit() {
        // Recipe: make_golden.py store/bilinear: fingerprints of the values' bits.
        for (width, height, expected) in [
            (150, 90, 96_195_221_251_962_079),
            (17, 20, 61_203_743_935_254),
            (7, 90, 209_712_445_192_895),
        ] {
            let other = bilinear_f32(&plane(), width, height);
            let bits = other.data.iter().map(|v| u64::from(v.to_bits()));
            assert_eq!(fingerprint(bits), expected, "{width}x{height}");
        }
        let row = Plane::new(2, 1, vec![0.0, 1.0]).unwrap();
        assert_eq!(bilinear_f32(&row, 4, 1).data, [0.0, 0.25, 0.75, 1.0]);
        assert_eq!(bilinear_f32(&row, 2, 3).data, [0.0, 1.0].repeat(3));
    }

    #[test]
    fn enlarging_by_area_is_bilinear() {
        let image = picture(20, 30);
        for (width, height) in [(40, 60), (10, 60), (40, 15)] {
            assert_eq!(
                rgb(&image, width, height, Kernel::Area),
                rgb(&image, width, height, Kernel::Bilinear)
            );
        }
        assert_eq!(area_f32(&plane(), 70, 10), bilinear_f32(&plane(), 70, 10));
    }

    #[test]
    fn lanczos_keeps_a_flat_image_flat() {
        let flat = RgbImage::from_pixel(90, 60, image::Rgb([10, 130, 250]));
        let small = rgb(&flat, 41, 22, Kernel::Lanczos3);
        assert_eq!(
            small,
            RgbImage::from_pixel(41, 22, image::Rgb([10, 130, 250]))
        );
    }

    #[test]
    fn kernel_names() {
        for kernel in Kernel::ALL {
            assert_eq!(kernel.to_string().parse(), Ok(kernel));
        }
        assert!(
            "cubic"
                .parse::<Kernel>()
                .unwrap_err()
                .to_string()
                .contains("`area`, `bilinear` and `lanczos3`")
        );
    }

    #[test]
    fn few_weights_give_the_bytes_of_many() {
        let image = RgbImage::from_fn(1242, 9, |x, y| {
            image::Rgb([
                (x * 7 + y) as u8,
                (x * x + 3 * y) as u8,
                (x ^ (y * 50)) as u8,
            ])
        });
        for width in [512, 415, 1000, 1241] {
            let columns = opencv_area_cells(1242, width as usize);
            assert!(fixed_weights(&columns).is_some(), "{width}");
            let many = narrow_rows(&image, width, 4, |values, narrowed| {
                narrow_row(values, &columns, narrowed);
            });
            assert!(area_rgb(&image, width, 4) == many, "{width}");
        }
        assert!(fixed_weights(&opencv_area_cells(1242, 200)).is_none());
    }

    proptest! {
        #[test]
        fn results_stay_within_the_range_of_the_source(
            (width, height) in (1_usize..40, 1_usize..40), (to_width, to_height) in (1_usize..60, 1_usize..60), seed: u32
        ) {
            let data: Vec<f32> = (0..width * height)
                .map(|i| ((i as u32).wrapping_mul(2_654_435_761).wrapping_add(seed) >> 16) as f32)
                .collect();
            let low = data.iter().copied().fold(f32::INFINITY, f32::min);
            let high = data.iter().copied().fold(f32::NEG_INFINITY, f32::max);
            let plane = Plane::new(width, height, data).unwrap();
            for other in [area_f32(&plane, to_width, to_height), bilinear_f32(&plane, to_width, to_height)] {
                prop_assert_eq!((other.width, other.height, other.data.len()), (to_width, to_height, to_width * to_height));
                let slack = 1e-5 * high;
                prop_assert!(other.data.iter().all(|v| (low - slack..=high + slack).contains(v)));
            }
        }

        #[test]
        fn byte_images_agree_with_planes_up_to_rounding(
            (width, height) in (1_u32..50, 1_u32..50), (to_width, to_height) in (1_u32..50, 1_u32..50)
        ) {
            let image = picture(width, height);
            let data = image.pixels().map(|p| f32::from(p.0[1])).collect();
            let plane = Plane::new(width as usize, height as usize, data).unwrap();
            let exact = area_f32(&plane, to_width as usize, to_height as usize);
            let bytes = rgb(&image, to_width, to_height, Kernel::Area);
            for (pixel, value) in bytes.pixels().zip(&exact.data) {
                prop_assert!((f32::from(pixel.0[1]) - value).abs() < 0.51 + 0.3, "{} {value}", pixel.0[1]);
            }
        }
    }
}
