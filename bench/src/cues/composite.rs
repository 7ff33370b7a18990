//! Sprites pasted into pictures, and which pixels they cover.
//!
//! Places are pixel centres: row 0 is the middle of the first row. A sprite is scaled and placed
//! to fractions of a pixel (area means where it shrinks, linear interpolation where it grows), so
//! that a series of sizes has no steps of its own. Colours are blended as they are encoded, with
//! the alpha of the sprite.

use image::RgbImage;

use super::sprites::Sprite;

/// Where a sprite stands in a picture, and how high it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// Column of its anchor.
    pub column: f64,
    /// Row of its anchor: where the object touches the ground.
    pub contact_row: f64,
    /// Pixels from the top of the object to its anchor.
    pub height_px: f64,
}

/// A set of pixels of a picture.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Mask {
    left: usize,
    top: usize,
    width: usize,
    height: usize,
    bits: Vec<bool>,
}

impl Mask {
    /// Whether a pixel belongs to it; coordinates may lie anywhere.
    fn has(&self, x: i64, y: i64) -> bool {
        let (column, row) = (x - self.left as i64, y - self.top as i64);
        (0..self.width as i64).contains(&column)
            && (0..self.height as i64).contains(&row)
            && self.bits[row as usize * self.width + column as usize]
    }

    /// The pixels (column, row), row by row.
    pub fn pixels(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        let of = |index: usize| {
            (
                self.left + index % self.width,
                self.top + index / self.width,
            )
        };
        self.bits
            .iter()
            .enumerate()
            .filter(|&(_, &set)| set)
            .map(move |(index, _)| of(index))
    }

    /// Number of pixels.
    #[must_use]
    pub fn count(&self) -> usize {
        self.bits.iter().filter(|&&set| set).count()
    }

    /// The pixels that satisfy a condition on their coordinates.
    fn retain(&self, keep: impl Fn(i64, i64) -> bool) -> Self {
        let mut kept = self.clone();
        for (index, bit) in kept.bits.iter_mut().enumerate() {
            let (x, y) = (
                self.left + index % self.width,
                self.top + index / self.width,
            );
            *bit = *bit && keep(x as i64, y as i64);
        }
        kept
    }

    /// Pixels whose whole neighbourhood of `radius` pixels belongs to it.
    #[must_use]
    pub fn eroded(&self, radius: usize) -> Self {
        let mut mask = self.clone();
        for _ in 0..radius {
            let before = mask.clone();
            mask = mask
                .retain(|x, y| (-1..=1).all(|dy| (-1..=1).all(|dx| before.has(x + dx, y + dy))));
        }
        mask
    }

    /// Erosion by `radius`, or by as much less as leaves a pixel; with the radius taken.
    #[must_use]
    pub fn eroded_at_most(&self, radius: usize) -> (Self, usize) {
        (0..=radius)
            .rev()
            .map(|radius| (self.eroded(radius), radius))
            .find(|(mask, radius)| *radius == 0 || mask.count() > 0)
            .unwrap_or_default()
    }

    /// The pixels that are not in the other.
    #[must_use]
    pub fn without(&self, other: &Self) -> Self {
        self.retain(|x, y| !other.has(x, y))
    }

    /// The pixels with one of the other's within `radius` rows and columns.
    #[must_use]
    pub fn near(&self, other: &Self, radius: i64) -> Self {
        self.retain(|x, y| {
            (-radius..=radius).any(|dy| (-radius..=radius).any(|dx| other.has(x + dx, y + dy)))
        })
    }
}

/// The edges of what is opaque once it is pasted: left, top, right and bottom, as pixel edges.
#[must_use]
pub fn extent(sprite: &Sprite, place: Place) -> [f64; 4] {
    let scale = place.height_px / sprite.height_px();
    let (x, y) = (place.column + 0.5, place.contact_row + 0.5);
    [
        x + (sprite.opaque[0] - sprite.anchor[0]) * scale,
        y + (sprite.opaque[1] - sprite.anchor[1]) * scale,
        x + (sprite.opaque[2] - sprite.anchor[0]) * scale,
        y + (sprite.opaque[3] - sprite.anchor[1]) * scale,
    ]
}

/// Pastes a sprite and returns the pixels where its alpha is above one half. What lies outside
/// the picture is cut off.
pub fn paste(picture: &mut RgbImage, sprite: &Sprite, place: Place) -> Mask {
    let scale = place.height_px / sprite.height_px();
    let columns = Taps::new(
        sprite.image.width(),
        place.column + 0.5 - sprite.anchor[0] * scale,
        scale,
        picture.width(),
    );
    let rows = Taps::new(
        sprite.image.height(),
        place.contact_row + 0.5 - sprite.anchor[1] * scale,
        scale,
        picture.height(),
    );
    let width = columns.taps.len();
    // First along the rows of the sprite, premultiplied, as far as they are needed.
    let source_width = sprite.image.width() as usize;
    let pixels: &[u8] = sprite.image.as_raw();
    let mut narrow = vec![[0.0_f32; 4]; width * sprite.image.height() as usize];
    for row in rows.used() {
        let line = &pixels[4 * row * source_width..4 * (row + 1) * source_width];
        for (target, (first, weights)) in narrow[row * width..].iter_mut().zip(&columns.taps) {
            for (pixel, weight) in line[4 * first..].chunks_exact(4).zip(weights) {
                let alpha = weight * f32::from(pixel[3]) / 255.0;
                for (sum, &value) in target.iter_mut().zip(&pixel[..3]) {
                    *sum += alpha * f32::from(value);
                }
                target[3] += alpha;
            }
        }
    }
    let mut mask = Mask {
        left: columns.start,
        top: rows.start,
        width,
        height: rows.taps.len(),
        bits: Vec::with_capacity(width * rows.taps.len()),
    };
    let picture_width = picture.width() as usize;
    let buffer: &mut [u8] = picture;
    for (offset, (first, weights)) in rows.taps.iter().enumerate() {
        let start = 3 * ((rows.start + offset) * picture_width + columns.start);
        let line = &mut buffer[start..start + 3 * width];
        for (column, pixel) in line.chunks_exact_mut(3).enumerate() {
            let mut sum = [0.0_f32; 4];
            for (row, weight) in weights.iter().enumerate() {
                let value = narrow[(first + row) * width + column];
                for (sum, value) in sum.iter_mut().zip(value) {
                    *sum += weight * value;
                }
            }
            for (byte, colour) in pixel.iter_mut().zip(sum) {
                *byte = (colour + (1.0 - sum[3]) * f32::from(*byte)).round() as u8;
            }
            mask.bits.push(sum[3] > 0.5);
        }
    }
    mask
}

/// Which source samples make up each target pixel along one axis, and with which weights.
struct Taps {
    /// First target pixel.
    start: usize,
    /// First source sample and the weights from there on.
    taps: Vec<(usize, Vec<f32>)>,
}

impl Taps {
    /// `origin` is the target coordinate of the source's first edge.
    fn new(source: u32, origin: f64, scale: f64, target: u32) -> Self {
        let length = f64::from(source);
        let first = origin.floor().clamp(0.0, f64::from(target));
        let last = (origin + length * scale)
            .ceil()
            .clamp(first, f64::from(target));
        // What a target pixel covers of the source; at least one sample, which interpolates.
        let reach = (1.0 / scale).max(1.0);
        let taps = (first as usize..last as usize)
            .map(|index| {
                let centre = (index as f64 + 0.5 - origin) / scale;
                let (from, to) = (centre - 0.5 * reach, centre + 0.5 * reach);
                let begin = from.floor().clamp(0.0, length - 1.0);
                let end = to.ceil().clamp(begin + 1.0, length);
                // What lies outside the sprite is transparent: its weight is left out.
                let weights = (begin as usize..end as usize)
                    .map(|sample| {
                        let sample = sample as f64;
                        let overlap = (to.min(sample + 1.0) - from.max(sample)).max(0.0);
                        (overlap / reach) as f32
                    })
                    .collect();
                (begin as usize, weights)
            })
            .collect();
        Self {
            start: first as usize,
            taps,
        }
    }

    /// Source samples that any target pixel needs.
    fn used(&self) -> std::ops::Range<usize> {
        let first = self.taps.first().map_or(0, |(first, _)| *first);
        let last = self
            .taps
            .last()
            .map_or(first, |(first, weights)| first + weights.len());
        first..last
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cues::sprites::SpriteEntry;
    use image::{Rgb, Rgba, RgbaImage};

    /// A red block of 20x40 pixels with a margin of 5.
    fn block() -> Sprite {
        let image = RgbaImage::from_fn(30, 50, |x, y| {
            let inside = (5..25).contains(&x) && (5..45).contains(&y);
            Rgba([200, 0, 0, if inside { 255 } else { 0 }])
        });
        let mut bytes = std::io::Cursor::new(Vec::new());
        image.write_to(&mut bytes, image::ImageFormat::Png).unwrap();
        let entry = SpriteEntry {
            file: "block.png".to_owned(),
            name: "block".to_owned(),
            view: None,
            familiar: false,
            height_m: 1.0,
            anchor: None,
        };
        Sprite::decode(bytes.get_ref(), &entry, std::path::Path::new("block.png")).unwrap()
    }

    #[test]
    fn a_sprite_of_its_own_size_is_copied() {
        let mut picture = RgbImage::from_pixel(60, 60, Rgb([0, 0, 100]));
        let place = Place {
            column: 29.5,
            contact_row: 49.5,
            height_px: 40.0,
        };
        let mask = paste(&mut picture, &block(), place);
        assert_eq!(extent(&block(), place), [20.0, 10.0, 40.0, 50.0]);
        assert_eq!(mask.count(), 20 * 40);
        assert!(
            mask.pixels()
                .all(|(x, y)| (20..40).contains(&x) && (10..50).contains(&y))
        );
        for (x, y, pixel) in picture.enumerate_pixels() {
            let inside = (20..40).contains(&x) && (10..50).contains(&y);
            assert_eq!(pixel.0, if inside { [200, 0, 0] } else { [0, 0, 100] });
        }
    }

    /// However it is scaled and placed, a sprite keeps its amount of colour, and its edges are
    /// where they should be.
    #[test]
    fn scaled_sprites_cover_what_they_should() {
        for (height_px, column, contact_row) in
            [(13.3, 30.2, 40.7), (31.7, 28.9, 52.1), (55.0, 30.0, 58.0)]
        {
            let mut picture = RgbImage::new(64, 64);
            let place = Place {
                column,
                contact_row,
                height_px,
            };
            paste(&mut picture, &block(), place);
            let sum: f64 = picture.pixels().map(|p| f64::from(p.0[0]) / 200.0).sum();
            let expected = 0.5 * height_px * height_px;
            assert!((sum / expected - 1.0).abs() < 0.01, "{sum} {expected}");
            let mean_row: f64 = picture
                .enumerate_pixels()
                .map(|(_, y, p)| (f64::from(y) + 0.5) * f64::from(p.0[0]) / 200.0)
                .sum::<f64>()
                / sum;
            let expected = contact_row + 0.5 - 0.5 * height_px;
            assert!((mean_row - expected).abs() < 0.02, "{mean_row} {expected}");
        }
    }

    #[test]
    fn what_lies_outside_is_cut_off() {
        // The block is 20 x 40 at this size. At column -5 it covers 5 whole columns and 20 whole rows, at
        // column 63 and row 70 the last 10 and 33; its outermost pixels are covered by half.
        for (column, contact_row, count) in [
            (-5.0, 20.0, 5 * 20),
            (63.0, 70.0, 10 * 33),
            (500.0, 500.0, 0),
        ] {
            let mut picture = RgbImage::new(64, 64);
            let place = Place {
                column,
                contact_row,
                height_px: 40.0,
            };
            let mask = paste(&mut picture, &block(), place);
            assert_eq!(mask.count(), count, "{column} {contact_row}");
            for (x, y) in mask.pixels() {
                assert!(picture.get_pixel(x as u32, y as u32).0[0] > 100, "{x} {y}");
            }
            let red = picture.pixels().filter(|pixel| pixel.0[0] > 100).count();
            assert_eq!(red, count);
        }
    }

    #[test]
    fn masks_shrink_and_meet() {
        let mut picture = RgbImage::new(60, 60);
        let place = |column| Place {
            column,
            contact_row: 49.5,
            height_px: 40.0,
        };
        let front = paste(&mut picture, &block(), place(29.5));
        let back = paste(&mut picture, &block(), place(41.5)).without(&front);
        assert_eq!(front.eroded(2).count(), 16 * 36);
        assert_eq!(back.count(), 12 * 40);
        assert_eq!(front.near(&back, 3).count(), 3 * 40);
        assert_eq!(back.near(&front, 3).count(), 3 * 40);
        let (small, radius) = paste(
            &mut picture,
            &block(),
            Place {
                height_px: 6.0,
                ..place(10.0)
            },
        )
        .eroded_at_most(2);
        assert!(small.count() > 0 && radius == 1, "{radius}");
    }
}
