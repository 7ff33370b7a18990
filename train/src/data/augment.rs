//! Augmentation of the training pairs.
//!
//! Source: PROTOCOL 4.6 (D15, after Godard et al.). A pair is mirrored and its views
//! exchanged with probability 0.5; with probability 0.5 both views get the same gamma, then
//! brightness, then a factor per colour channel, and are clipped to [0, 1]. The augmented
//! pair is both the input and the target. Every draw depends on the seed, the epoch and the
//! pair's index only, never on the order of work.
//!
//! Not here: what is done to the discriminator's input ([`crate::network::discriminator`]).

use image::RgbImage;
use serde::{Deserialize, Serialize};

use crate::random::{Draws, Purpose};

/// Probabilities and ranges of the augmentation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AugmentConfig {
    /// Probability of mirroring the pair and exchanging its views.
    pub flip: f32,
    /// Probability of changing the colours.
    pub colour: f32,
    /// Range of the exponent applied to intensities in [0, 1].
    pub gamma: [f32; 2],
    /// Range of the factor common to the three channels.
    pub brightness: [f32; 2],
    /// Range of the factor of each single channel.
    pub channel: [f32; 2],
}

impl Default for AugmentConfig {
    fn default() -> Self {
        Self {
            flip: 0.5,
            colour: 0.5,
            gamma: [0.8, 1.2],
            brightness: [0.5, 2.0],
            channel: [0.8, 1.2],
        }
    }
}

/// Colour change of a pair.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Colour {
    /// Exponent applied first.
    pub gamma: f32,
    /// Factor common to the channels.
    pub brightness: f32,
    /// Factor of red, green and blue.
    pub channel: [f32; 3],
}

/// What is done to one training pair.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Augmentation {
    /// Mirror both views left to right and exchange them.
    pub flip: bool,
    /// The colour change, if any.
    pub colour: Option<Colour>,
}

impl Augmentation {
    /// Leaves a pair as it is.
    pub const NONE: Self = Self {
        flip: false,
        colour: None,
    };

    /// The augmentation of pair `index` in a 0-based epoch.
    #[must_use]
    pub fn draw(config: &AugmentConfig, seed: u64, epoch: u64, index: usize) -> Self {
        let mut draws = Draws::new(seed, Purpose::Augmentation, epoch, index as u64);
        let flip = draws.chance(config.flip);
        let colour = draws.chance(config.colour).then(|| Colour {
            gamma: draws.within(config.gamma),
            brightness: draws.within(config.brightness),
            channel: [
                draws.within(config.channel),
                draws.within(config.channel),
                draws.within(config.channel),
            ],
        });
        Self { flip, colour }
    }

    /// For each channel, the intensity in [0, 1] that each of the 256 levels becomes.
    fn tables(&self) -> [[f32; 256]; 3] {
        let mut tables = [[0.0; 256]; 3];
        for (channel, table) in tables.iter_mut().enumerate() {
            for (level, value) in table.iter_mut().enumerate() {
                let plain = level as f32 / 255.0;
                *value = match self.colour {
                    None => plain,
                    // In f64, so that the platform's `pow` decides nothing after rounding.
                    Some(colour) => {
                        let raised = (level as f64 / 255.0).powf(f64::from(colour.gamma)) as f32;
                        (raised * colour.brightness * colour.channel[channel]).clamp(0.0, 1.0)
                    }
                };
            }
        }
        tables
    }

    /// Writes the augmented pair as planes: `[3, height, width]` per view, RGB, in [0, 1].
    ///
    /// Both slices must hold `3 * width * height` values of images of equal size.
    pub fn apply(
        &self,
        left: &RgbImage,
        right: &RgbImage,
        left_out: &mut [f32],
        right_out: &mut [f32],
    ) {
        let tables = self.tables();
        let (first, second) = if self.flip {
            (right, left)
        } else {
            (left, right)
        };
        write_planes(first, &tables, self.flip, left_out);
        write_planes(second, &tables, self.flip, right_out);
    }
}

fn write_planes(image: &RgbImage, tables: &[[f32; 256]; 3], mirror: bool, out: &mut [f32]) {
    let (width, height) = (image.width() as usize, image.height() as usize);
    let plane = width * height;
    for (row, pixels) in image.as_raw().chunks_exact(3 * width).enumerate() {
        for (column, pixel) in pixels.chunks_exact(3).enumerate() {
            let target = if mirror { width - 1 - column } else { column };
            for channel in 0..3 {
                out[channel * plane + row * width + target] =
                    tables[channel][usize::from(pixel[channel])];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_abs_diff_eq;

    fn pair() -> (RgbImage, RgbImage) {
        let left = RgbImage::from_fn(4, 2, |x, y| image::Rgb([(10 * x) as u8, (20 * y) as u8, 5]));
        let right = RgbImage::from_fn(4, 2, |x, y| {
            image::Rgb([(100 + x) as u8, (200 + y) as u8, 55])
        });
        (left, right)
    }

    fn applied(augmentation: &Augmentation) -> (Vec<f32>, Vec<f32>) {
        let (left, right) = pair();
        let (mut a, mut b) = (vec![0.0; 24], vec![0.0; 24]);
        augmentation.apply(&left, &right, &mut a, &mut b);
        (a, b)
    }

    #[test]
    fn nothing_drawn_scales_levels_to_the_unit_range_in_planes() {
        let (a, b) = applied(&Augmentation::NONE);
        // Row 1, column 3: red 30, green 20, blue 5.
        assert_eq!(
            [a[7], a[15], a[23]],
            [30.0 / 255.0, 20.0 / 255.0, 5.0 / 255.0]
        );
        assert_eq!(
            [b[7], b[15], b[23]],
            [103.0 / 255.0, 201.0 / 255.0, 55.0 / 255.0]
        );
    }

    #[test]
    fn mirroring_exchanges_the_views() {
        let (plain_left, plain_right) = applied(&Augmentation::NONE);
        let (left, right) = applied(&Augmentation {
            flip: true,
            colour: None,
        });
        for channel in 0..3 {
            for row in 0..2 {
                for column in 0..4 {
                    let at = channel * 8 + row * 4 + column;
                    let mirrored = channel * 8 + row * 4 + 3 - column;
                    assert_eq!(left[at], plain_right[mirrored]);
                    assert_eq!(right[at], plain_left[mirrored]);
                }
            }
        }
    }

    #[test]
    fn colours_follow_the_formula_and_are_clipped() {
        let colour = Colour {
            gamma: 0.9,
            brightness: 1.5,
            channel: [1.1, 0.8, 1.0],
        };
        let (left, right) = applied(&Augmentation {
            flip: false,
            colour: Some(colour),
        });
        let expected = (30.0_f64 / 255.0).powf(0.9) * 1.5 * 1.1;
        assert_abs_diff_eq!(f64::from(left[7]), expected, epsilon = 1e-6);
        // (201/255)^0.9 * 1.5 * 0.8 = 0.969, and for green of row 0 (0) it is 0.
        assert_abs_diff_eq!(
            f64::from(right[15]),
            (201.0_f64 / 255.0).powf(0.9) * 1.2,
            epsilon = 1e-6
        );
        let bright = Augmentation {
            flip: false,
            colour: Some(Colour {
                brightness: 2.0,
                ..colour
            }),
        };
        let (_, right) = applied(&bright);
        assert_eq!(right[15], 1.0);
    }

    #[test]
    fn draws_match_their_probabilities_and_ranges() {
        let config = AugmentConfig::default();
        let all: Vec<Augmentation> = (0..2000)
            .map(|index| Augmentation::draw(&config, 5, 1, index))
            .collect();
        let flips = all.iter().filter(|a| a.flip).count();
        assert!((900..1100).contains(&flips), "{flips}");
        let colours: Vec<Colour> = all.iter().filter_map(|a| a.colour).collect();
        assert!((900..1100).contains(&colours.len()));
        assert!(colours.iter().all(|c| (0.8..=1.2).contains(&c.gamma)
            && (0.5..=2.0).contains(&c.brightness)
            && c.channel.iter().all(|v| (0.8..=1.2).contains(v))));
        // Flip and colour are independent: both happen to about a quarter of the pairs.
        let both = all.iter().filter(|a| a.flip && a.colour.is_some()).count();
        assert!((420..580).contains(&both), "{both}");
        assert_eq!(all[17], Augmentation::draw(&config, 5, 1, 17));
        assert_ne!(all[17], Augmentation::draw(&config, 5, 2, 17));
    }
}
