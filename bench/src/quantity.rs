//! From a model's numbers to maps that other programs read: depth, disparity, files.
//!
//! A map has one [`Quantity`]. Depth follows from disparity by `focal_px * baseline_m /
//! disparity_px`, all at the width of the image the focal length belongs to; where the camera is
//! not known there is no depth, and nothing is guessed. Values are not clipped: limits belong to
//! the protocols of an evaluation.
//!
//! The files: OpenEXR (metres, see [`strat_store::exr`]), 16-bit PNG (value times 256, the
//! convention of the KITTI benchmarks, 0 = no value), NumPy (`f32`, rows by columns) and a
//! coloured picture with its scale drawn below.

use std::fmt;

use image::{Rgb, RgbImage};
use serde::{Deserialize, Serialize};
use strat_onnx::metadata::OutputMeaning;
use strat_store::raster::Plane;

use crate::draw::comparison;

/// What the values of a map are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
pub enum Quantity {
    /// Depth along the camera's axis in metres, 0 = none.
    DepthM,
    /// Disparity in pixels of the map's own width.
    DisparityPx,
    /// Disparity as a fraction of image width.
    DisparityFraction,
    /// Inverse depth, in 1/m where the scale is known.
    InverseDepth,
}

impl Quantity {
    /// The word used in files and messages.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::DepthM => "depth_m",
            Self::DisparityPx => "disparity_px",
            Self::DisparityFraction => "disparity_fraction",
            Self::InverseDepth => "inverse_depth",
        }
    }
}

impl fmt::Display for Quantity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

/// What depth needs to be made of disparity.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Rig {
    /// Focal length in pixels of the untouched image.
    pub focal_px: f64,
    /// Distance of the two cameras the model was trained with, in metres.
    pub baseline_m: f64,
}

/// A quantity that does not follow from what is known.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NoSuchQuantity {
    /// Depth and disparity need a camera to be exchanged.
    #[error(
        "{wanted} cannot be made of the model's {meaning} without the camera: give --focal-px and \
         --baseline-m, or ask for {instead}"
    )]
    NoCamera {
        /// What was asked for.
        wanted: Quantity,
        /// What the model gives.
        meaning: OutputMeaning,
        /// What can be had.
        instead: Quantity,
    },
    /// Inverse depth of unknown scale stays that.
    #[error(
        "{wanted} cannot be made of this model: its inverse depth has no known scale; ask for \
         inverse_depth"
    )]
    NoScale {
        /// What was asked for.
        wanted: Quantity,
    },
}

/// What a model of this meaning gives where nothing is asked for: depth when it can be had.
#[must_use]
pub fn natural(meaning: OutputMeaning, rig: Option<Rig>) -> Quantity {
    match (meaning, rig) {
        (OutputMeaning::InverseDepth, _) => Quantity::InverseDepth,
        (OutputMeaning::DepthM | OutputMeaning::InverseDepthPerM, _) | (_, Some(_)) => {
            Quantity::DepthM
        }
        (OutputMeaning::DisparityFraction | OutputMeaning::DisparityPx, None) => {
            Quantity::DisparityPx
        }
    }
}

/// How a model's numbers become one quantity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Conversion {
    /// What comes out.
    pub quantity: Quantity,
    meaning: OutputMeaning,
    /// Width of the network's input in pixels.
    input_width: u32,
    rig: Option<Rig>,
}

impl Conversion {
    /// Makes sure that `quantity` follows from what is known.
    ///
    /// # Errors
    /// The camera is missing, or the model's scale is unknown.
    pub fn new(
        quantity: Quantity,
        meaning: OutputMeaning,
        input_width: u32,
        rig: Option<Rig>,
    ) -> Result<Self, NoSuchQuantity> {
        let gives_disparity = matches!(
            meaning,
            OutputMeaning::DisparityFraction | OutputMeaning::DisparityPx
        );
        let wants_disparity = matches!(
            quantity,
            Quantity::DisparityFraction | Quantity::DisparityPx
        );
        if meaning == OutputMeaning::InverseDepth && quantity != Quantity::InverseDepth {
            return Err(NoSuchQuantity::NoScale { wanted: quantity });
        }
        let crosses = meaning != OutputMeaning::InverseDepth && gives_disparity != wants_disparity;
        if crosses && rig.is_none() {
            return Err(NoSuchQuantity::NoCamera {
                wanted: quantity,
                meaning,
                instead: natural(meaning, None),
            });
        }
        Ok(Self {
            quantity,
            meaning,
            input_width,
            rig,
        })
    }

    /// Converts a map of the model's numbers that belongs to an image of `image_width` pixels.
    ///
    /// The map may have another width than the image; disparity in pixels is in pixels of the map.
    #[must_use]
    pub fn apply(&self, mut map: Plane, image_width: u32) -> Plane {
        let width = map.width as f64;
        // Depth times disparity as a fraction of image width; unused where there is no camera.
        let product = self.rig.map_or(0.0, |rig| {
            rig.focal_px * rig.baseline_m / f64::from(image_width)
        });
        // Disparity as a fraction of image width is `value * fraction`.
        let fraction = match self.meaning {
            OutputMeaning::DisparityPx => 1.0 / f64::from(self.input_width),
            _ => 1.0,
        };
        let over = |factor: f64| {
            let factor = factor as f32;
            move |value: f32| if value > 0.0 { factor / value } else { 0.0 }
        };
        let times = |factor: f64| {
            let factor = factor as f32;
            move |value: f32| value * factor
        };
        let data = &mut map.data;
        match (self.meaning, self.quantity) {
            (OutputMeaning::InverseDepth, _)
            | (OutputMeaning::InverseDepthPerM, Quantity::InverseDepth)
            | (OutputMeaning::DepthM, Quantity::DepthM) => {}
            (OutputMeaning::InverseDepthPerM, Quantity::DepthM) => each(data, over(1.0)),
            (OutputMeaning::InverseDepthPerM, Quantity::DisparityFraction) => {
                each(data, times(product));
            }
            (OutputMeaning::InverseDepthPerM, Quantity::DisparityPx) => {
                each(data, times(product * width));
            }
            (OutputMeaning::DepthM, Quantity::InverseDepth) => each(data, over(1.0)),
            (OutputMeaning::DepthM, Quantity::DisparityFraction) => each(data, over(product)),
            (OutputMeaning::DepthM, Quantity::DisparityPx) => each(data, over(product * width)),
            (_, Quantity::DisparityFraction) => each(data, times(fraction)),
            (_, Quantity::DisparityPx) => each(data, times(fraction * width)),
            (_, Quantity::DepthM) => each(data, over(product / fraction)),
            (_, Quantity::InverseDepth) => each(data, times(fraction / product)),
        }
        // A depth that single precision cannot hold is none.
        if self.quantity == Quantity::DepthM {
            each(data, |value| {
                if value.is_finite() && value > 0.0 {
                    value
                } else {
                    0.0
                }
            });
        }
        map
    }
}

fn each(data: &mut [f32], change: impl Fn(f32) -> f32) {
    for value in data {
        *value = change(*value);
    }
}

/// A map as 16-bit PNG: the value times 256, rounded; 0 where there is none.
///
/// Returns the bytes, and how many values are too large for the format (above 255.99) and were
/// written as 0, because a clipped value would look like a measured one.
///
/// # Panics
/// If the plane's size contradicts its data.
#[must_use]
pub fn encode_png16(map: &Plane) -> (Vec<u8>, usize) {
    let mut too_large = 0;
    let values: Vec<u16> = map
        .data
        .iter()
        .map(|&value| {
            let units = (f64::from(value) * 256.0).round();
            if units > f64::from(u16::MAX) {
                too_large += 1;
                0
            } else {
                // A float below 0 becomes 0.
                units as u16
            }
        })
        .collect();
    let bytes =
        strat_store::image_files::encode_png_gray16(map.width as u32, map.height as u32, &values);
    (bytes, too_large)
}

/// A map as NumPy array `[height, width]`, little-endian `f32`.
#[must_use]
pub fn encode_npy(map: &Plane) -> Vec<u8> {
    let mut header = format!(
        "{{'descr': '<f4', 'fortran_order': False, 'shape': ({}, {}), }}",
        map.height, map.width
    );
    // Format 1.0: magic, version and length take ten bytes, and data begins at a multiple of 64.
    let padded = (10 + header.len() + 1).next_multiple_of(64) - 10;
    header.extend(std::iter::repeat_n(' ', padded - 1 - header.len()));
    header.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes.extend(map.data.iter().flat_map(|value| value.to_le_bytes()));
    bytes
}

/// The scale of a coloured picture: black at 0, brightest at this value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scale {
    /// What is coloured: inverse depth in 1/m, disparity in pixels, or inverse depth without a
    /// unit when [`None`].
    pub unit: Option<ScaleUnit>,
    /// The value of the brightest colour.
    pub brightest: f32,
}

/// How the ticks of a scale are labelled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ScaleUnit {
    /// Values are 1/m; labels are metres.
    Metres,
    /// Values and labels are pixels.
    Pixels,
}

/// The brightest value where none is given: the 95th percentile, so that one near pixel does not
/// darken the rest.
#[must_use]
pub fn brightest_of(map: &Plane) -> f32 {
    comparison::percentile_95(map).max(f32::MIN_POSITIVE)
}

/// Colours inverse depth or disparity (magma: dark is far, bright is near) and draws the scale
/// below, so that the picture is [`legend_height`] taller than the map.
#[must_use]
pub fn colour(map: &Plane, scale: Scale) -> RgbImage {
    let (width, height) = (map.width as u32, map.height as u32);
    let mut picture = RgbImage::new(width, height + legend_height(width));
    for (index, &value) in map.data.iter().enumerate() {
        let (column, row) = (index % map.width, index / map.width);
        let colour = comparison::magma(value / scale.brightest);
        picture.put_pixel(column as u32, row as u32, colour);
    }
    draw_legend(&mut picture, height, scale);
    picture
}

/// Rows below the map: a strip of colours and its labels.
#[must_use]
pub fn legend_height(width: u32) -> u32 {
    // Strip, tick, gap, letters, gap.
    (6 + 2 + 1 + GLYPH_HEIGHT + 2) * magnification(width)
}

fn magnification(width: u32) -> u32 {
    if width < 600 { 1 } else { 2 }
}

const GLYPH_WIDTH: u32 = 5;
const GLYPH_HEIGHT: u32 = 7;
const PAPER: Rgb<u8> = Rgb([0, 0, 0]);
const INK: Rgb<u8> = Rgb([230, 230, 230]);

/// Places and texts of the labels, from the dark end to the bright one; `place` is 0 to 1.
fn ticks(scale: Scale) -> Vec<(f32, String)> {
    let brightest = scale.brightest;
    match scale.unit {
        None => vec![(0.0, "0".to_owned()), (1.0, short(brightest))],
        Some(ScaleUnit::Pixels) => (0..=4_u8)
            .map(|quarter| {
                let place = f32::from(quarter) / 4.0;
                (place, format!("{} px", short(place * brightest)))
            })
            .collect(),
        Some(ScaleUnit::Metres) => {
            // 1, 2, 5, 10, ... metres, as far as they lie on the scale; far ones come first.
            let mut places = Vec::new();
            for exponent in (-3..=4_i32).rev() {
                for step in [5.0_f32, 2.0, 1.0] {
                    let metres = step * 10_f32.powi(exponent);
                    let place = 1.0 / (metres * brightest);
                    if (0.0..=1.0).contains(&place) {
                        places.push((place, format!("{} m", short(metres))));
                    }
                }
            }
            places.push((1.0, format!("{} m", short(1.0 / brightest))));
            places
        }
    }
}

/// At most three digits that matter.
fn short(value: f32) -> String {
    let text = if value >= 100.0 || value == 0.0 {
        format!("{value:.0}")
    } else if value >= 10.0 {
        format!("{value:.1}")
    } else if value >= 0.01 {
        format!("{value:.2}")
    } else {
        format!("{value:.1e}")
    };
    if text.contains('.') && !text.contains('e') {
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        text
    }
}

fn draw_legend(picture: &mut RgbImage, top: u32, scale: Scale) {
    let (width, zoom) = (picture.width(), magnification(picture.width()));
    for row in top..picture.height() {
        for column in 0..width {
            picture.put_pixel(column, row, PAPER);
        }
    }
    let last = width.saturating_sub(1).max(1);
    for column in 0..width {
        let colour = comparison::magma(column as f32 / last as f32);
        for row in top..top + 6 * zoom {
            picture.put_pixel(column, row, colour);
        }
    }
    // The ends matter most, so they are placed first; what would touch a label is left out.
    let mut labels = ticks(scale);
    labels.sort_by(|a, b| {
        let inner = |place: f32| place > 0.0 && place < 1.0;
        (inner(a.0), b.0)
            .partial_cmp(&(inner(b.0), a.0))
            .unwrap_or(std::cmp::Ordering::Equal)
    });
    let mut taken: Vec<(u32, u32)> = Vec::new();
    for (place, text) in labels {
        let length = text.chars().count() as u32 * (GLYPH_WIDTH + 1) * zoom;
        if length > width {
            continue;
        }
        let at = (place * last as f32).round() as u32;
        let left = at.saturating_sub(length / 2).min(width - length);
        let gap = 2 * GLYPH_WIDTH * zoom;
        if taken
            .iter()
            .any(|&(from, to)| left < to + gap && from < left + length + gap)
        {
            continue;
        }
        taken.push((left, left + length));
        for row in top + 6 * zoom..top + 8 * zoom {
            for column in at..(at + zoom).min(width) {
                picture.put_pixel(column, row, INK);
            }
        }
        write_text(picture, left, top + 9 * zoom, zoom, &text);
    }
}

fn write_text(picture: &mut RgbImage, left: u32, top: u32, zoom: u32, text: &str) {
    for (index, letter) in text.chars().enumerate() {
        let left = left + index as u32 * (GLYPH_WIDTH + 1) * zoom;
        for (row, bits) in glyph(letter).into_iter().enumerate() {
            for column in 0..GLYPH_WIDTH {
                if bits & (1 << (GLYPH_WIDTH - 1 - column)) == 0 {
                    continue;
                }
                for y in 0..zoom {
                    for x in 0..zoom {
                        let place = (left + column * zoom + x, top + row as u32 * zoom + y);
                        if place.0 < picture.width() && place.1 < picture.height() {
                            picture.put_pixel(place.0, place.1, INK);
                        }
                    }
                }
            }
        }
    }
}

/// The few letters that a scale needs, a bit per pixel, top row first.
fn glyph(letter: char) -> [u8; 7] {
    match letter {
        '0' => [
            0b01110, 0b10001, 0b10011, 0b10101, 0b11001, 0b10001, 0b01110,
        ],
        '1' => [
            0b00100, 0b01100, 0b00100, 0b00100, 0b00100, 0b00100, 0b01110,
        ],
        '2' => [
            0b01110, 0b10001, 0b00001, 0b00110, 0b01000, 0b10000, 0b11111,
        ],
        '3' => [
            0b01110, 0b10001, 0b00001, 0b00110, 0b00001, 0b10001, 0b01110,
        ],
        '4' => [
            0b00010, 0b00110, 0b01010, 0b10010, 0b11111, 0b00010, 0b00010,
        ],
        '5' => [
            0b11111, 0b10000, 0b11110, 0b00001, 0b00001, 0b10001, 0b01110,
        ],
        '6' => [
            0b00110, 0b01000, 0b10000, 0b11110, 0b10001, 0b10001, 0b01110,
        ],
        '7' => [
            0b11111, 0b00001, 0b00010, 0b00100, 0b01000, 0b01000, 0b01000,
        ],
        '8' => [
            0b01110, 0b10001, 0b10001, 0b01110, 0b10001, 0b10001, 0b01110,
        ],
        '9' => [
            0b01110, 0b10001, 0b10001, 0b01111, 0b00001, 0b00010, 0b01100,
        ],
        '.' => [0, 0, 0, 0, 0, 0b01100, 0b01100],
        '-' => [0, 0, 0, 0b11111, 0, 0, 0],
        'e' => [0, 0, 0b01110, 0b10001, 0b11111, 0b10000, 0b01110],
        'm' => [0, 0, 0b11010, 0b10101, 0b10101, 0b10101, 0b10101],
        'p' => [0, 0, 0b11110, 0b10001, 0b11110, 0b10000, 0b10000],
        'x' => [0, 0, 0b10001, 0b01010, 0b00100, 0b01010, 0b10001],
        _ => [0; 7],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RIG: Rig = Rig {
        focal_px: 700.0,
        baseline_m: 0.5,
    };

    fn convert(quantity: Quantity, meaning: OutputMeaning, value: f32) -> f32 {
        let conversion = Conversion::new(quantity, meaning, 500, Some(RIG)).unwrap();
        // The map has half the width of its image.
        conversion.apply(Plane::filled(500, 1, value), 1000).data[0]
    }

    /// By hand: focal 700 px and 0.5 m at a width of 1000 px: 35 px (0.035 of the width) are 10 m.
    #[test]
    fn quantities_follow_from_each_other() {
        use OutputMeaning as From;
        use Quantity as To;
        for (meaning, value) in [
            (From::DisparityFraction, 0.035),
            (From::DisparityPx, 17.5),
            (From::InverseDepthPerM, 0.1),
            (From::DepthM, 10.0),
        ] {
            for (quantity, expected) in [
                (To::DepthM, 10.0),
                (To::DisparityFraction, 0.035),
                (To::DisparityPx, 17.5),
                (To::InverseDepth, 0.1),
            ] {
                let found = convert(quantity, meaning, value);
                assert!(
                    (found / expected - 1.0).abs() < 1e-6,
                    "{meaning} to {quantity}: {found}"
                );
            }
        }
        for nothing in [0.0, -0.1] {
            assert_eq!(convert(To::DepthM, From::DisparityFraction, nothing), 0.0);
            assert_eq!(convert(To::DepthM, From::DepthM, nothing), 0.0);
        }
        // 0.35 / 1e-40 is beyond single precision.
        assert_eq!(convert(To::DepthM, From::DisparityFraction, 1e-40), 0.0);
    }

    #[test]
    fn depth_is_not_guessed() {
        use OutputMeaning as From;
        let new = |quantity, meaning, rig| Conversion::new(quantity, meaning, 500, rig);
        let error = new(Quantity::DepthM, From::DisparityFraction, None).unwrap_err();
        assert!(error.to_string().contains("--focal-px"), "{error}");
        assert!(error.to_string().contains("disparity_px"), "{error}");
        let error = new(Quantity::DepthM, From::InverseDepth, Some(RIG)).unwrap_err();
        assert!(error.to_string().contains("no known scale"), "{error}");
        assert!(new(Quantity::DepthM, From::DepthM, None).is_ok());
        assert!(new(Quantity::InverseDepth, From::DepthM, None).is_ok());
        assert!(new(Quantity::DisparityPx, From::DepthM, None).is_err());
        assert_eq!(natural(From::DisparityPx, None), Quantity::DisparityPx);
        assert_eq!(natural(From::DisparityPx, Some(RIG)), Quantity::DepthM);
        assert_eq!(
            natural(From::InverseDepth, Some(RIG)),
            Quantity::InverseDepth
        );
        for meaning in OutputMeaning::ALL {
            for rig in [None, Some(RIG)] {
                assert!(new(natural(meaning, rig), meaning, rig).is_ok());
            }
        }
    }

    #[test]
    fn sixteen_bits_hold_what_they_can() {
        let map = Plane::new(5, 1, vec![10.0, 0.0, 255.99, 256.0, 1.0 / 512.0]).unwrap();
        let (bytes, too_large) = encode_png16(&map);
        assert_eq!(too_large, 1);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("d.png");
        std::fs::write(&path, bytes).unwrap();
        let (_, _, values) = strat_store::image_files::read_gray16(&path).unwrap();
        assert_eq!(values, [2560, 0, 65533, 0, 1]);
    }

    #[test]
    fn numpy_reads_the_array() {
        let map = Plane::new(3, 2, (0..6_u8).map(f32::from).collect()).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("d.npy");
        let bytes = encode_npy(&map);
        assert_eq!((bytes.len() - 24) % 64, 0);
        std::fs::write(&path, bytes).unwrap();
        let array: ndarray::Array2<f32> = ndarray_npy::read_npy(&path).unwrap();
        assert_eq!(array.shape(), [2, 3]);
        assert_eq!(array[[1, 2]], 5.0);
    }

    #[test]
    fn the_legend_has_the_colours_of_the_picture() {
        let map = Plane::new(300, 1, (0..300_u16).map(f32::from).collect()).unwrap();
        let scale = Scale {
            unit: Some(ScaleUnit::Pixels),
            brightest: 299.0,
        };
        let picture = colour(&map, scale);
        assert_eq!(picture.dimensions(), (300, 1 + legend_height(300)));
        for column in 0..300 {
            assert_eq!(picture.get_pixel(column, 0), picture.get_pixel(column, 3));
        }
        // Beyond the scale nothing is brighter.
        assert_eq!(
            colour(&Plane::filled(1, 1, 1e9), scale).get_pixel(0, 0),
            picture.get_pixel(299, 0)
        );
        // Some label is written.
        assert!(picture.pixels().filter(|pixel| **pixel == INK).count() > 20);
    }

    #[test]
    fn ticks_are_round_metres() {
        // Brightest at 1/4 m.
        let scale = Scale {
            unit: Some(ScaleUnit::Metres),
            brightest: 0.25,
        };
        let ticks = ticks(scale);
        let place = |text: &str| ticks.iter().find(|(_, t)| t == text).map(|(p, _)| *p);
        assert_eq!(place("4 m"), Some(1.0));
        assert_eq!(place("5 m"), Some(0.8));
        assert_eq!(place("20 m"), Some(0.2));
        assert_eq!(place("2 m"), None);
        for (value, text) in [
            (0.0, "0"),
            (123.4, "123"),
            (12.34, "12.3"),
            (2.0, "2"),
            (0.5, "0.5"),
        ] {
            assert_eq!(short(value), text);
        }
    }
}
