//! Linear interpolation between the four nearest pixels, as OpenCV's `INTER_LINEAR` places them.

use image::RgbImage;

use crate::raster::Plane;

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

/// The values of [`bilinear_f32`] at some pixels of the resized plane alone, given by their row-major
/// indices: the same to the last bit.
///
/// # Panics
/// If a plane has no pixels, or an index is none of the resized plane.
pub fn bilinear_at(source: &Plane, width: usize, height: usize, indices: &[u32]) -> Vec<f32> {
    assert!(
        source.width > 0 && source.height > 0 && width > 0 && height > 0,
        "planes have pixels"
    );
    let columns = linear_taps(source.width, width);
    let rows = linear_taps(source.height, height);
    let mut values = Vec::with_capacity(indices.len());
    let mut left = indices;
    while let Some(&first) = left.first() {
        let row = first as usize / width;
        let (start, end) = (row * width, (row + 1) * width);
        let is_of_row = |&&index: &&u32| (start..end).contains(&(index as usize));
        let count = left.iter().take_while(is_of_row).count();
        let (own, rest) = left.split_at(count);
        let tap = &rows[row];
        let (low, high) = (source.row(tap.low as usize), source.row(tap.high as usize));
        let [of_low, of_high] = tap.weights;
        values.extend(own.iter().map(|&index| {
            let tap = &columns[index as usize - start];
            let stretched = |values: &[f32]| {
                values[tap.low as usize] * tap.weights[0]
                    + values[tap.high as usize] * tap.weights[1]
            };
            stretched(low) * of_low + stretched(high) * of_high
        }));
        left = rest;
    }
    values
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

/// Resizes an image, each channel as a plane.
pub fn rgb(image: &RgbImage, width: u32, height: u32) -> RgbImage {
    by_planes(image, width, height, bilinear_f32)
}

/// Resizes an image channel by channel, rounded to grey levels.
pub(super) fn by_planes(
    image: &RgbImage,
    width: u32,
    height: u32,
    resize: impl Fn(&Plane, usize, usize) -> Plane,
) -> RgbImage {
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
        resize(&plane, width as usize, height as usize)
    });
    let data = (0..planes[0].data.len())
        .flat_map(|i| planes.each_ref().map(|plane| to_byte(plane.data[i])))
        .collect();
    RgbImage::from_raw(width, height, data).expect("one value per pixel and channel")
}

/// Rounds half to even, as OpenCV does.
pub(super) fn to_byte(value: f32) -> u8 {
    value.round_ties_even().clamp(0.0, 255.0) as u8
}

#[cfg(test)]
mod tests {
    use super::super::tests::{fingerprint, plane};
    use super::*;

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
        for (width, height) in [(150, 90), (17, 20), (61, 37), (7, 90)] {
            let whole = bilinear_f32(&plane(), width, height).data;
            let some: Vec<u32> = (0..whole.len() as u32)
                .filter(|i| i % 7 == 0 || i % 5 == 3)
                .collect();
            let bits = |value: f32| value.to_bits();
            let expected: Vec<u32> = some.iter().map(|&i| bits(whole[i as usize])).collect();
            let found: Vec<u32> = bilinear_at(&plane(), width, height, &some)
                .into_iter()
                .map(bits)
                .collect();
            assert_eq!(found, expected, "{width}x{height}");
        }
        assert_eq!(bilinear_at(&plane(), 7, 90, &[]), [0.0; 0]);
        let row = Plane::new(2, 1, vec![0.0, 1.0]).unwrap();
        assert_eq!(bilinear_f32(&row, 4, 1).data, [0.0, 0.25, 0.75, 1.0]);
        assert_eq!(bilinear_f32(&row, 2, 3).data, [0.0, 1.0].repeat(3));
    }
}
