//! Matching costs along the epipolar line of a rectified pair (PROTOCOL 4.7).
//!
//! What a photometric loss asks of a left pixel is how alike the right image is where a disparity sends it.
//! Cost and truth are those of the images as they are, before any network. Not here: which pixels, and
//! what is made of them.

use image::RgbImage;

/// A measure of how unlike two places are; 0 where they are equal.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Cost {
    /// Mean absolute difference of a pixel's colours, of full scale.
    L1,
    /// (1 - SSIM) / 2 over 3x3 pixels, clipped to 0 and 1, mean over the colours (PROTOCOL 4.4).
    Dssim,
    /// What the thesis' stereo objective weighs: DSSIM + 0.1 L1 (PROTOCOL 4.4).
    Objective,
    /// What a trained discriminator makes of the view; see [`super::discriminator`].
    Discriminator,
}

impl Cost {
    /// Those that compare two images.
    pub const PHOTOMETRIC: [Self; 3] = [Self::L1, Self::Dssim, Self::Objective];
    const ALL: [Self; 4] = [Self::L1, Self::Dssim, Self::Objective, Self::Discriminator];

    /// Those that there are, with or without a discriminator.
    #[must_use]
    pub fn all(with_discriminator: bool) -> &'static [Self] {
        if with_discriminator {
            &Self::ALL
        } else {
            &Self::PHOTOMETRIC
        }
    }

    /// Name in tables.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::L1 => "l1",
            Self::Dssim => "dssim",
            Self::Objective => "objective",
            Self::Discriminator => "discriminator",
        }
    }

    /// Name for readers.
    #[must_use]
    pub fn heading(self) -> &'static str {
        match self {
            Self::L1 => "L1",
            Self::Dssim => "DSSIM 3x3",
            Self::Objective => "DSSIM + 0.1 L1",
            Self::Discriminator => "discriminator",
        }
    }
}

/// Colours as fractions of full scale, so that windows are summed up fast.
pub struct Pair {
    width: usize,
    height: usize,
    left: Vec<[f32; 3]>,
    right: Vec<[f32; 3]>,
}

/// The costs of all disparities of one left pixel: whole pixels from 0 on, as far as the line lies
/// within the right image.
#[derive(Clone, Debug, PartialEq)]
pub struct Line {
    /// By disparity, in the order of [`Cost::all`].
    pub costs: Vec<Vec<f64>>,
    /// The discriminator's cost of the left image as it is, where one was asked.
    pub untouched: Option<f64>,
}

impl Pair {
    /// Two images of one size.
    #[must_use]
    pub fn new(left: &RgbImage, right: &RgbImage) -> Option<Self> {
        if left.dimensions() != right.dimensions() {
            return None;
        }
        let values = |image: &RgbImage| {
            let pixels = image.pixels();
            pixels.map(|p| p.0.map(|c| f32::from(c) / 255.0)).collect()
        };
        Some(Self {
            width: left.width() as usize,
            height: left.height() as usize,
            left: values(left),
            right: values(right),
        })
    }

    /// Columns and rows.
    #[must_use]
    pub fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// Whether a pixel has all eight neighbours.
    #[must_use]
    pub fn is_inside(&self, x: usize, y: usize) -> bool {
        (1..self.width.saturating_sub(1)).contains(&x)
            && (1..self.height.saturating_sub(1)).contains(&y)
    }

    /// The costs of a left pixel that has all neighbours, for disparities up to `largest`; what its
    /// window finds outside the right image has none.
    #[must_use]
    pub fn line(&self, x: usize, y: usize, largest: usize) -> Line {
        let window = |image: &[[f32; 3]], x: usize| -> [[f32; 3]; 9] {
            std::array::from_fn(|index| image[(y + index / 3 - 1) * self.width + x + index % 3 - 1])
        };
        let left = window(&self.left, x);
        let mut costs = vec![Vec::new(); Cost::PHOTOMETRIC.len()];
        for disparity in 0..=largest.min(x.saturating_sub(1)) {
            let right = window(&self.right, x - disparity);
            let l1 = l1(left[4], right[4]);
            let dssim = dssim(&left, &right);
            for (costs, cost) in costs.iter_mut().zip([l1, dssim, dssim + 0.1 * l1]) {
                costs.push(cost);
            }
        }
        Line {
            costs,
            untouched: None,
        }
    }

    /// Where a patch of `side` begins that has a pixel as near to its middle as the image allows: column and
    /// row.
    fn patch_at(&self, (x, y): (usize, usize), side: usize) -> (usize, usize) {
        let begin =
            |at: usize, size: usize| at.saturating_sub(side / 2).min(size.saturating_sub(side));
        (begin(x, self.width), begin(y, self.height))
    }

    /// The square of `side` pixels around a left pixel, `[3, side, side]`, black where the image is smaller.
    #[must_use]
    pub fn patch(&self, at: (usize, usize), side: usize) -> Vec<f32> {
        let (left, top) = self.patch_at(at, side);
        let mut patch = vec![0.0; 3 * side * side];
        for row in 0..side.min(self.height) {
            for column in 0..side.min(self.width) {
                let pixel = self.left[(top + row) * self.width + left + column];
                for (channel, value) in pixel.into_iter().enumerate() {
                    patch[(channel * side + row) * side + column] = value;
                }
            }
        }
        patch
    }

    /// Replaces the pixels of a [`patch`](Self::patch) that are at most `half` from its pixel by those of the
    /// right image that lie `disparity` to the left; black beyond its edge, as where views are synthesised.
    pub fn move_window(
        &self,
        patch: &mut [f32],
        at: (usize, usize),
        side: usize,
        half: usize,
        disparity: usize,
    ) {
        let (left, top) = self.patch_at(at, side);
        let (right, bottom) = ((left + side).min(self.width), (top + side).min(self.height));
        for y in at.1.saturating_sub(half).max(top)..(at.1 + half + 1).min(bottom) {
            for x in at.0.saturating_sub(half).max(left)..(at.0 + half + 1).min(right) {
                let source = x.checked_sub(disparity);
                let pixel = source.map_or([0.0; 3], |x| self.right[y * self.width + x]);
                for (channel, value) in pixel.into_iter().enumerate() {
                    patch[(channel * side + y - top) * side + x - left] = value;
                }
            }
        }
    }

    /// Texture around a pixel that has all neighbours: mean absolute difference of horizontal neighbours
    /// over its 3x3 window and the colours, in grey levels. Along rows, because there the matching
    /// searches.
    #[must_use]
    pub fn texture(&self, x: usize, y: usize) -> f64 {
        let mut sum = 0.0;
        for row in y - 1..=y + 1 {
            let row = &self.left[row * self.width + x - 1..][..3];
            for pair in row.windows(2) {
                let differences = pair[0].iter().zip(&pair[1]);
                sum += differences
                    .map(|(a, b)| f64::from((a - b).abs()))
                    .sum::<f64>();
            }
        }
        255.0 * sum / 18.0
    }
}

fn l1(left: [f32; 3], right: [f32; 3]) -> f64 {
    let differences = left.iter().zip(&right);
    differences
        .map(|(a, b)| f64::from((a - b).abs()))
        .sum::<f64>()
        / 3.0
}

/// Windows without padding, biased variances, constants for full scale 1 (PROTOCOL 4.4).
fn dssim(left: &[[f32; 3]; 9], right: &[[f32; 3]; 9]) -> f64 {
    const C1: f64 = 0.01 * 0.01;
    const C2: f64 = 0.03 * 0.03;
    let mut sum = 0.0;
    for colour in 0..3 {
        let of = |window: &[[f32; 3]; 9]| window.map(|pixel| f64::from(pixel[colour]));
        let (a, b) = (of(left), of(right));
        let mean = |values: &[f64; 9]| values.iter().sum::<f64>() / 9.0;
        let (mean_a, mean_b) = (mean(&a), mean(&b));
        let (mut var_a, mut var_b, mut both) = (0.0, 0.0, 0.0);
        for (a, b) in a.iter().zip(&b) {
            var_a += (a - mean_a).powi(2) / 9.0;
            var_b += (b - mean_b).powi(2) / 9.0;
            both += (a - mean_a) * (b - mean_b) / 9.0;
        }
        let ssim = (2.0 * mean_a * mean_b + C1) * (2.0 * both + C2)
            / ((mean_a * mean_a + mean_b * mean_b + C1) * (var_a + var_b + C2));
        sum += ((1.0 - ssim) / 2.0).clamp(0.0, 1.0);
    }
    sum / 3.0
}

impl Line {
    /// Costs of one kind by disparity.
    #[must_use]
    pub fn of(&self, cost: Cost) -> &[f64] {
        self.costs.get(cost as usize).map_or(&[], Vec::as_slice)
    }

    /// The kinds of cost that it has.
    #[must_use]
    pub fn kinds(&self) -> &'static [Cost] {
        Cost::all(self.costs.len() > Cost::PHOTOMETRIC.len())
    }

    /// The disparities of the lowest cost; several where they are equal.
    #[must_use]
    pub fn cheapest(&self, cost: Cost) -> Vec<usize> {
        let costs = self.of(cost);
        let Some(lowest) = costs.iter().copied().min_by(f64::total_cmp) else {
            return Vec::new();
        };
        // Equal windows may differ in the last digits of their sums.
        let equal =
            |(disparity, cost): (usize, &f64)| (*cost <= lowest + 1e-12).then_some(disparity);
        costs.iter().enumerate().filter_map(equal).collect()
    }

    /// The share of the cheapest disparities that lie within `near` pixels of the truth. Of equal ones
    /// none is preferred: a flat wall has many, of which a search takes one by chance.
    #[must_use]
    pub fn found(&self, cost: Cost, truth: f64, near: f64) -> f64 {
        let cheapest = self.cheapest(cost);
        let close = cheapest
            .iter()
            .filter(|d| (**d as f64 - truth).abs() < near);
        close.count() as f64 / cheapest.len().max(1) as f64
    }
}

#[cfg(test)]
mod tests {
    use image::Rgb;

    use super::*;

    fn noise(width: u32, height: u32, shift: u32) -> RgbImage {
        RgbImage::from_fn(width, height, |x, y| {
            let mix = |salt: u32| {
                ((x + shift).wrapping_mul(73) ^ y.wrapping_mul(151) ^ salt).wrapping_mul(97) % 251
            };
            Rgb([mix(1) as u8, mix(7) as u8, mix(13) as u8])
        })
    }

    /// The right image is the left one moved by five pixels: every cost is 0 there and nowhere else.
    #[test]
    fn the_cheapest_disparity_of_a_moved_image_is_the_move() {
        let pair = Pair::new(&noise(40, 12, 0), &noise(40, 12, 5)).unwrap();
        let line = pair.line(20, 6, 12);
        assert_eq!(line.of(Cost::L1).len(), 13);
        for cost in Cost::PHOTOMETRIC {
            assert_eq!(line.cheapest(cost), [5], "{cost:?}");
            assert!(line.of(cost)[5].abs() < 1e-12 && line.of(cost)[4] > 0.01);
            assert_eq!(line.found(cost, 7.5, 3.0), 1.0);
            assert_eq!(line.found(cost, 8.0, 3.0), 0.0, "3 px are wrong, as in D1");
        }
        // The line ends with the image.
        assert_eq!(pair.line(4, 6, 12).of(Cost::L1).len(), 4);
        assert!(Pair::new(&noise(4, 4, 0), &noise(5, 4, 0)).is_none());
    }

    /// By hand: 51 levels are 0.2 of full scale. Without variance SSIM is
    /// (2 * 0.2 * 0.4 + C1) / (0.04 + 0.16 + C1).
    #[test]
    fn costs_are_those_of_their_formulas() {
        let flat = |level: u8| RgbImage::from_pixel(9, 5, Rgb([level; 3]));
        let line = Pair::new(&flat(51), &flat(102)).unwrap().line(4, 2, 0);
        assert!((line.of(Cost::L1)[0] - 0.2).abs() < 1e-7);
        let ssim = 0.1601 / 0.2001;
        assert!((line.of(Cost::Dssim)[0] - (1.0 - ssim) / 2.0).abs() < 1e-6);
        let both = line.of(Cost::Dssim)[0] + 0.1 * line.of(Cost::L1)[0];
        assert_eq!(line.of(Cost::Objective)[0], both);
    }

    /// On a flat wall all are equally cheap, and seven of thirteen lie within 3 px (3.5 to both sides).
    #[test]
    fn equal_costs_count_by_their_share() {
        let flat = RgbImage::from_pixel(30, 5, Rgb([90; 3]));
        let pair = Pair::new(&flat, &flat).unwrap();
        let line = pair.line(20, 2, 12);
        assert_eq!(line.cheapest(Cost::L1).len(), 13);
        assert!((line.found(Cost::Dssim, 6.0, 3.5) - 7.0 / 13.0).abs() < 1e-12);
        assert_eq!(pair.texture(20, 2), 0.0);
        let ramp = RgbImage::from_fn(30, 5, |x, _| Rgb([4 * x as u8; 3]));
        let texture = Pair::new(&ramp, &flat).unwrap().texture(9, 3);
        assert!((texture - 4.0).abs() < 1e-4, "{texture}");
    }

    /// A patch with the window of another disparity: what lies in the window is the right image's, the rest the
    /// left one's, and at the right disparity nothing changes.
    #[test]
    fn a_window_is_taken_from_the_right_image() {
        let (left, right) = (noise(40, 20, 0), noise(40, 20, 5));
        let pair = Pair::new(&left, &right).unwrap();
        let value =
            |image: &RgbImage, x: u32, y: u32| f32::from(image.get_pixel(x, y).0[1]) / 255.0;
        // A patch of 8 around (2, 18) begins at (0, 12).
        let at = (2, 18);
        let plain = pair.patch(at, 8);
        assert_eq!(plain.len(), 3 * 64);
        assert_eq!(plain[64 + 3 * 8 + 4], value(&left, 4, 15));
        let mut moved = plain.clone();
        pair.move_window(&mut moved, at, 8, 1, 1);
        for (row, column) in (0..8).flat_map(|row| (0..8).map(move |column| (row, column))) {
            let (x, y) = (column as u32, 12 + row as u32);
            let inside = (1..=3).contains(&x) && (17..=19).contains(&y);
            let expected = if inside {
                value(&right, x - 1, y)
            } else {
                value(&left, x, y)
            };
            assert_eq!(moved[64 + row * 8 + column], expected, "{x} {y}");
        }
        // Beyond the right image it is black, and where the images agree nothing changes.
        let mut beyond = plain.clone();
        pair.move_window(&mut beyond, at, 8, 1, 3);
        assert_eq!(beyond[6 * 8 + 2], 0.0);
        let plain = pair.patch((20, 10), 8);
        let mut same = plain.clone();
        pair.move_window(&mut same, (20, 10), 8, 2, 5);
        assert_eq!(same, plain);
    }
}
