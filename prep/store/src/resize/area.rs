//! Means over the area that a target pixel covers, as OpenCV's `INTER_AREA` computes them.

use image::RgbImage;

use super::bilinear::{bilinear_f32, to_byte};
use crate::raster::Plane;

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

/// Shrinks an image; both target sides are at most the source's.
pub fn rgb(image: &RgbImage, width: u32, height: u32) -> RgbImage {
    let (source_width, source_height) = (image.width() as usize, image.height() as usize);
    let (target_width, target_height) = (width as usize, height as usize);
    if source_width % target_width == 0 && source_height % target_height == 0 {
        return block_mean_rgb(image, width, height);
    }
    let columns = opencv_area_cells(source_width, target_width);
    let few = fixed_weights(&columns);
    // Compiled for the vector units of this machine. The order of additions is that of the code, so
    // the bytes are the same on all of them.
    pulp::Arch::new().dispatch(Shrink {
        image,
        size: (width, height),
        columns: &columns,
        few: few.as_deref(),
    })
}

/// The work of [`rgb`]. Not a closure: what is compiled for vector units is what is inlined where they are
/// known, and a closure cannot be told to be.
struct Shrink<'a> {
    image: &'a RgbImage,
    size: (u32, u32),
    columns: &'a [(usize, Vec<f32>)],
    few: Option<&'a [(usize, [f32; FEW])]>,
}

impl pulp::NullaryFnOnce for Shrink<'_> {
    type Output = RgbImage;

    #[inline(always)]
    fn call(self) -> RgbImage {
        let Self {
            image,
            size: (width, height),
            columns,
            few,
        } = self;
        match few {
            Some(columns) => narrow_rows(image, width, height, columns),
            None => narrow_rows(image, width, height, columns),
        }
    }
}

/// How a row becomes as narrow as the target: three numbers a pixel in both.
trait Narrow {
    fn narrow(&self, values: &[f32], narrowed: &mut [f32]);
}

/// Area means of rows that `narrow` has made of the source's rows; both are given one number more
/// than there are, and the source's also what [`FEW`] weights may ask for: pixels are read and written
/// four lanes at a time.
#[inline(always)]
fn narrow_rows(image: &RgbImage, width: u32, height: u32, by: &(impl Narrow + ?Sized)) -> RgbImage {
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
                by.narrow(&values, &mut narrowed);
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

/// Weighted sums in the order of OpenCV's additions.
impl Narrow for [(usize, Vec<f32>)] {
    #[inline(always)]
    fn narrow(&self, values: &[f32], narrowed: &mut [f32]) {
        for (target, (first, weights)) in narrowed.chunks_exact_mut(3).zip(self) {
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
}

/// Most weights for which the loop is unrolled: KITTI's images at the network's size have
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

/// The same: adding a number times zero changes no sum.
impl Narrow for [(usize, [f32; FEW])] {
    #[inline(always)]
    fn narrow(&self, values: &[f32], narrowed: &mut [f32]) {
        for (at, (first, weights)) in self.iter().enumerate() {
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

#[cfg(test)]
mod tests {
    use super::super::tests::{fingerprint, picture, plane};
    use super::super::{Kernel, rgb as resize};
    use super::*;

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
            let small = resize(&picture(width, height), to_width, to_height, Kernel::Area);
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
            let many = narrow_rows(&image, width, 4, columns.as_slice());
            assert!(rgb(&image, width, 4) == many, "{width}");
        }
        assert!(fixed_weights(&opencv_area_cells(1242, 200)).is_none());
    }
}
