//! Pictures that compare models on the same images (figures 3.3 and 3.6 to 3.10 of the thesis).
//!
//! A comparison sheet has two rows for each image: the input with the depth of each model, and
//! below it the ground truth, dilated so that sparse points can be seen, with each model's error.
//! All maps of an image share one scale. Depth is coloured as inverse depth (magma, bright is
//! near), the relative depth error |p - g| / g with cividis, which grows in lightness alone for
//! colour-blind readers too. Predictions without a unit are scaled by medians first, as their
//! protocol does it.
//!
//! A synthesis sheet shows the right view that each model makes of the left one at the widest
//! baseline: `R'(x) = L(x + w d_R(x))` with linear interpolation along rows and black outside
//! (PROTOCOL 4.3), beside the real right view, with the absolute difference. It takes a model that
//! gives the right view's disparity too.
//!
//! Pictures illustrate; no figure of a table is computed from them.

use image::{Rgb, RgbImage};
use strat_store::{
    image_files,
    raster::Plane,
    resize::{self, Kernel},
};

use crate::{
    draw::chart::{Sheet, Tile},
    draw::comparison,
    evaluate::Comparison,
    quantity::{self, Scale, ScaleUnit},
};

/// Width of a picture within a sheet.
const TILE_WIDTH: u32 = 460;
/// JPEG quality of photographs within a sheet.
const PICTURE_QUALITY: u8 = 88;
/// Relative error, and absolute difference of grey levels, at the bright end.
const WORST_ERROR: f32 = 0.5;
const WORST_DIFFERENCE: f32 = 64.0;
/// Images on one sheet.
pub const PER_SHEET: usize = 4;
/// What was not measured, and what is missing.
const NOTHING: Rgb<u8> = Rgb([96, 96, 96]);

/// What a model made of an image, or a sentence about why it made nothing.
pub type Shown<T> = Result<T, String>;

/// An image of a comparison sheet.
pub struct Frame<'a> {
    /// Its id.
    pub image: &'a str,
    /// Models in order, with what they made of it.
    pub models: Vec<(&'a str, Shown<&'a Comparison>)>,
}

/// A right view that a model has made, at network size.
pub struct Synthesis {
    /// The view.
    pub right: RgbImage,
    /// The real one.
    pub real: RgbImage,
}

/// An image of a synthesis sheet.
pub struct SynthesisFrame<'a> {
    /// Its id.
    pub image: &'a str,
    /// The left view.
    pub left: Option<&'a RgbImage>,
    /// Models in order, with the view they made.
    pub models: Vec<(&'a str, Shown<&'a Synthesis>)>,
}

/// The right view of `left` under the right view's disparity, a fraction of the width: each pixel
/// is taken from `x + w d(x)`, between two columns linearly; what comes from outside is black.
///
/// # Panics
/// If image and disparity differ in size.
#[must_use]
pub fn synthesize_right(left: &RgbImage, disparity_fraction: &Plane) -> RgbImage {
    let (width, height) = left.dimensions();
    assert_eq!(
        (width as usize, height as usize),
        (disparity_fraction.width, disparity_fraction.height),
        "image and disparity of one size"
    );
    let tap = |column: f32, row: u32, channel: usize| -> f32 {
        if column < 0.0 || column >= width as f32 {
            return 0.0;
        }
        f32::from(left.get_pixel(column as u32, row).0[channel])
    };
    RgbImage::from_fn(width, height, |x, y| {
        let offset = disparity_fraction.row(y as usize)[x as usize] * width as f32;
        let place = (x as f32 + offset).clamp(-1.0, width as f32);
        let (low, share) = (place.floor(), place - place.floor());
        Rgb([0, 1, 2].map(|channel| {
            let (a, b) = (tap(low, y, channel), tap(low + 1.0, y, channel));
            (a + share * (b - a)).round() as u8
        }))
    })
}

/// Comparison sheets of [`PER_SHEET`] images each, as SVG.
#[must_use]
pub fn comparisons(title: &str, frames: &[Frame<'_>]) -> Vec<String> {
    let sheets: Vec<&[Frame<'_>]> = frames.chunks(PER_SHEET).collect();
    let sheet = |(place, frames): (usize, &&[Frame<'_>])| {
        let sheet = Sheet {
            title: numbered(title, place, sheets.len()),
            note: format!(
                "Depth: magma, bright is near, one scale for an image. Error: |predicted - true| / \
                 true, cividis, dark 0, bright {WORST_ERROR} and more. Grey was not measured."
            ),
            rows: frames.iter().flat_map(rows_of).collect(),
        };
        sheet.svg()
    };
    sheets.iter().enumerate().map(sheet).collect()
}

fn numbered(title: &str, place: usize, count: usize) -> String {
    if count > 1 {
        format!("{title} ({} of {count})", place + 1)
    } else {
        title.to_owned()
    }
}

/// The two rows of one image.
fn rows_of(frame: &Frame<'_>) -> [Vec<Tile>; 2] {
    let some = frame
        .models
        .iter()
        .find_map(|(_, shown)| shown.as_ref().ok());
    let Some(some) = some else {
        let tiles = |words: &str| {
            let tile = |(name, shown): &(&str, Shown<&Comparison>)| {
                let why = shown.as_ref().err().map_or("", String::as_str);
                blank(
                    (TILE_WIDTH, TILE_WIDTH / 4),
                    format!("{name}: {words}{why}"),
                )
            };
            frame.models.iter().map(tile).collect()
        };
        return [tiles("no depth: "), Vec::new()];
    };
    let size = tile_size(some.input.width(), some.input.height());
    let truth = in_metres(&some.truth, some.depth_at_width_m, 1.0);
    let of_model: Vec<(&str, Shown<(Plane, Plane)>)> = frame
        .models
        .iter()
        .map(|(name, shown)| {
            let maps = shown.clone().map(|comparison| {
                let scale = median_ratio(comparison).unwrap_or(1.0);
                let depth = in_metres(&comparison.predicted, comparison.depth_at_width_m, scale);
                let error = relative_error(&depth, &truth);
                (depth, error)
            });
            (*name, maps)
        })
        .collect();
    // The scale is the ground truth's, so that no model chooses it.
    let measured: Vec<f32> = truth.data.iter().copied().filter(|v| *v > 0.0).collect();
    let brightest = if measured.is_empty() {
        let maps = of_model.iter().filter_map(|(_, maps)| maps.as_ref().ok());
        maps.map(|(depth, _)| quantity::brightest_of(depth))
            .fold(f32::MIN_POSITIVE, f32::max)
    } else {
        let count = measured.len();
        comparison::percentile_95(&Plane {
            width: count,
            height: 1,
            data: measured,
        })
    };
    let scale = Scale {
        unit: Some(ScaleUnit::Metres),
        brightest,
    };
    let mut above = vec![photograph(&some.input, size, frame.image.to_owned())];
    let mut below = vec![truth_tile(&truth, size, scale)];
    for (name, maps) in &of_model {
        match maps {
            Ok((depth, error)) => {
                let (width, height) = (size.0 as usize, size.1 as usize);
                let small = resize::area_f32(depth, width, height);
                above.push(tile(
                    &quantity::colour(&small, scale),
                    format!("{name}: depth"),
                ));
                below.push(error_tile(error, size, name));
            }
            Err(reason) => {
                above.push(blank(size, format!("{name}: no depth: {reason}")));
                below.push(blank(size, format!("{name}: no error")));
            }
        }
    }
    [above, below]
}

/// Inverse depth in 1/m of disparity as a fraction of the width, 0 where there is none.
fn in_metres(disparity: &Plane, depth_at_width_m: f32, scale: f32) -> Plane {
    let inverse = |value: &f32| value / (depth_at_width_m * scale);
    Plane {
        data: disparity.data.iter().map(inverse).collect(),
        ..*disparity
    }
}

/// median(true depth) / median(predicted depth) over the true depths that the protocol takes them
/// from; `None` where it does not scale.
fn median_ratio(comparison: &Comparison) -> Option<f32> {
    let (min_m, max_m) = comparison.median_within_m?;
    let pairs = comparison.truth.data.iter().zip(&comparison.predicted.data);
    let (mut truth, mut predicted): (Vec<f64>, Vec<f64>) = pairs
        .filter(|(truth, predicted)| {
            let true_m = comparison.depth_at_width_m / **truth;
            **truth > 0.0 && **predicted > 0.0 && true_m > min_m && true_m < max_m
        })
        .map(|(truth, predicted)| (1.0 / f64::from(*truth), 1.0 / f64::from(*predicted)))
        .unzip();
    let truth = strat_metrics::median(&mut truth)?;
    let ratio = truth / strat_metrics::median(&mut predicted)?;
    Some(ratio as f32)
}

/// |p - g| / g of depths that are given as inverse depth; -1 where nothing was measured.
fn relative_error(predicted: &Plane, truth: &Plane) -> Plane {
    let error = |(p, g): (&f32, &f32)| {
        if *g > 0.0 {
            // Nothing predicted is infinitely far away.
            if *p > 0.0 {
                (g / p - 1.0).abs()
            } else {
                f32::INFINITY
            }
        } else {
            -1.0
        }
    };
    Plane {
        data: predicted.data.iter().zip(&truth.data).map(error).collect(),
        ..*truth
    }
}

fn tile_size(width: u32, height: u32) -> (u32, u32) {
    let narrow = TILE_WIDTH.min(width);
    (narrow, (height * narrow).div_ceil(width.max(1)).max(1))
}

fn tile(picture: &RgbImage, caption: String) -> Tile {
    Tile {
        caption,
        data: image_files::encode_png_rgb(picture),
        format: "png",
        size: picture.dimensions(),
    }
}

fn photograph(picture: &RgbImage, (width, height): (u32, u32), caption: String) -> Tile {
    let small = resize::rgb(picture, width, height, Kernel::Area);
    Tile {
        data: image_files::encode_jpeg_rgb(&small, PICTURE_QUALITY),
        format: "jpeg",
        ..tile(&small, caption)
    }
}

fn blank((width, height): (u32, u32), caption: String) -> Tile {
    tile(&RgbImage::from_pixel(width, height, NOTHING), caption)
}

/// For each pixel of a tile what `choose` makes of the values that lie below it and are not
/// negative; none where there are none.
fn pooled(
    plane: &Plane,
    (width, height): (u32, u32),
    choose: impl Fn(&[f32]) -> f32,
) -> Vec<Option<f32>> {
    let (width, height) = (width as usize, height as usize);
    let part = |place: usize, count: usize, from: usize| {
        let first = place * from / count;
        first
            ..((place + 1) * from)
                .div_ceil(count)
                .max(first + 1)
                .min(from)
    };
    let mut below = Vec::new();
    let mut values = Vec::with_capacity(width * height);
    for y in 0..height {
        for x in 0..width {
            below.clear();
            for row in part(y, height, plane.height) {
                let own = &plane.row(row)[part(x, width, plane.width)];
                below.extend(own.iter().copied().filter(|value| *value >= 0.0));
            }
            values.push((!below.is_empty()).then(|| choose(&below)));
        }
    }
    values
}

fn truth_tile(truth: &Plane, size: (u32, u32), scale: Scale) -> Tile {
    let wide = comparison::widened(truth);
    let nearest = |values: &[f32]| values.iter().copied().fold(0.0, f32::max);
    let values = pooled(&wide, size, nearest);
    let small = Plane {
        width: size.0 as usize,
        height: size.1 as usize,
        data: values.iter().map(|value| value.unwrap_or(0.0)).collect(),
    };
    let mut picture = quantity::colour(&small, scale);
    let mut any = false;
    for (index, value) in small.data.iter().enumerate() {
        if *value > 0.0 {
            any = true;
        } else {
            let (x, y) = (index as u32 % size.0, index as u32 / size.0);
            picture.put_pixel(x, y, NOTHING);
        }
    }
    let words = if any {
        "ground truth, dilated"
    } else {
        "no ground truth"
    };
    tile(&picture, words.to_owned())
}

fn error_tile(error: &Plane, size: (u32, u32), name: &str) -> Tile {
    let mean = |values: &[f32]| values.iter().sum::<f32>() / values.len() as f32;
    let values = pooled(error, size, mean);
    let strip = 8;
    let picture = RgbImage::from_fn(size.0, size.1 + strip, |x, y| {
        if y >= size.1 {
            let place = x as f32 / (size.0 - 1).max(1) as f32;
            return if y < size.1 + 2 {
                Rgb([0; 3])
            } else {
                cividis(place)
            };
        }
        values[(y * size.0 + x) as usize].map_or(NOTHING, |error| cividis(error / WORST_ERROR))
    });
    let all: Vec<f64> = error
        .data
        .iter()
        .filter(|e| **e >= 0.0)
        .map(|e| f64::from(*e))
        .collect();
    let caption = if all.is_empty() {
        format!("{name}: no ground truth to compare with")
    } else {
        format!("{name}: relative error, 0 to {WORST_ERROR}")
    };
    tile(&picture, caption)
}

fn cividis(place: f32) -> Rgb<u8> {
    comparison::rgb(colorous::CIVIDIS, if place.is_nan() { 1.0 } else { place })
}

/// Synthesis sheets of [`PER_SHEET`] images each, as SVG.
#[must_use]
pub fn syntheses(title: &str, frames: &[SynthesisFrame<'_>]) -> Vec<String> {
    let sheets: Vec<&[SynthesisFrame<'_>]> = frames.chunks(PER_SHEET).collect();
    let sheet = |(place, frames): (usize, &&[SynthesisFrame<'_>])| {
        let sheet = Sheet {
            title: numbered(title, place, sheets.len()),
            note: format!(
                "Made of the left view at network size. Difference: mean over the colours, black 0, \
                 bright {WORST_DIFFERENCE} grey levels and more."
            ),
            rows: frames.iter().flat_map(synthesis_rows).collect(),
        };
        sheet.svg()
    };
    sheets.iter().enumerate().map(sheet).collect()
}

fn synthesis_rows(frame: &SynthesisFrame<'_>) -> [Vec<Tile>; 2] {
    let size = frame.left.map_or((TILE_WIDTH, TILE_WIDTH / 2), |left| {
        tile_size(left.width(), left.height())
    });
    let photo = |picture: Option<&RgbImage>, words: String| match picture {
        Some(picture) => photograph(picture, size, words),
        None => blank(size, words),
    };
    let mut above = vec![photo(frame.left, format!("{}: left", frame.image))];
    let real = frame
        .models
        .iter()
        .find_map(|(_, shown)| shown.as_ref().ok());
    let mut below = vec![photo(
        real.map(|shown| &shown.real),
        "real right view".to_owned(),
    )];
    for (name, shown) in &frame.models {
        match shown {
            Ok(synthesis) => {
                let difference = difference(synthesis);
                let mean = difference.data.iter().sum::<f32>() / difference.data.len() as f32;
                let (width, height) = (size.0 as usize, size.1 as usize);
                let small = resize::area_f32(&difference, width, height);
                let picture = RgbImage::from_fn(size.0, size.1, |x, y| {
                    comparison::magma(small.row(y as usize)[x as usize] / WORST_DIFFERENCE)
                });
                above.push(photograph(
                    &synthesis.right,
                    size,
                    format!("{name}: right view"),
                ));
                below.push(tile(
                    &picture,
                    format!("{name}: difference, {mean:.1} grey levels in the mean"),
                ));
            }
            Err(reason) => {
                above.push(blank(size, format!("{name}: {reason}")));
                below.push(blank(size, format!("{name}: no difference")));
            }
        }
    }
    [above, below]
}

/// Mean absolute difference over the colours, in grey levels.
fn difference(synthesis: &Synthesis) -> Plane {
    let pixels = synthesis.right.pixels().zip(synthesis.real.pixels());
    Plane {
        width: synthesis.right.width() as usize,
        height: synthesis.right.height() as usize,
        data: pixels
            .map(|(a, b)| {
                let channels = a.0.iter().zip(&b.0);
                channels
                    .map(|(a, b)| f32::from(a.abs_diff(*b)))
                    .sum::<f32>()
                    / 3.0
            })
            .collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stripes(width: u32, height: u32) -> RgbImage {
        RgbImage::from_fn(width, height, |x, y| {
            Rgb([(7 * x) as u8, (x * x) as u8, y as u8])
        })
    }

    #[test]
    fn views_are_shifted_by_their_disparity() {
        let left = stripes(16, 4);
        let constant = |px: f32| Plane::filled(16, 4, px / 16.0);
        assert_eq!(synthesize_right(&left, &constant(0.0)), left);
        let three = synthesize_right(&left, &constant(3.0));
        for (x, y, pixel) in three.enumerate_pixels() {
            let expected = if x + 3 < 16 {
                *left.get_pixel(x + 3, y)
            } else {
                Rgb([0; 3])
            };
            assert_eq!(*pixel, expected, "{x} {y}");
        }
        // Halfway between two columns; the last one fades to black over a pixel.
        let half = synthesize_right(&left, &constant(0.5));
        assert_eq!(
            half.get_pixel(2, 1).0[0],
            18,
            "(14 + 21) / 2, away from zero"
        );
        assert_eq!(half.get_pixel(15, 1).0[0], 53, "105 / 2");
        // Far outside is outside.
        let far = synthesize_right(&left, &constant(100.0));
        assert!(far.pixels().all(|pixel| pixel.0 == [0; 3]));
    }

    /// True depth is 10 m in every fifth pixel.
    fn comparison(predicted: f32, median_within_m: Option<(f32, f32)>) -> Comparison {
        let mut truth = Plane::filled(32, 16, 0.0);
        for place in (0..512).step_by(5) {
            truth.data[place] = 0.05;
        }
        Comparison {
            image: "x".to_owned(),
            input: stripes(32, 16),
            predicted: Plane::filled(32, 16, predicted),
            truth,
            depth_at_width_m: 0.5,
            median_within_m,
        }
    }

    #[test]
    fn errors_are_those_of_depth() {
        let inverse = |comparison: &Comparison, scale| {
            in_metres(&comparison.predicted, comparison.depth_at_width_m, scale)
        };
        // Half the disparity is twice the depth: an error of 1.
        let far = comparison(0.025, None);
        let truth = in_metres(&far.truth, far.depth_at_width_m, 1.0);
        assert_eq!(truth.data[0], 0.1, "10 m");
        let error = relative_error(&inverse(&far, 1.0), &truth);
        assert_eq!((error.data[0], error.data[1]), (1.0, -1.0));
        assert!(relative_error(&Plane::filled(32, 16, 0.0), &truth).data[0].is_infinite());
        // Without a unit the median makes up for it.
        let mut relative = comparison(0.4, Some((1.0, 70.0)));
        // 100 m away and not looked at.
        relative.truth.data[0] = 0.005;
        let ratio = median_ratio(&relative).unwrap();
        assert!((ratio - 8.0).abs() < 1e-5, "{ratio}");
        let error = relative_error(&inverse(&relative, ratio), &truth);
        assert!(error.data[5] < 1e-5);
        let mut without = comparison(0.4, Some((1.0, 70.0)));
        without.truth = Plane::filled(32, 16, 0.0);
        assert_eq!(median_ratio(&without), None);
        assert_eq!(median_ratio(&far), None);
    }

    #[test]
    fn sheets_say_what_is_missing() {
        let good = comparison(0.04, None);
        let mut bare = comparison(0.04, None);
        bare.truth = Plane::filled(32, 16, 0.0);
        fn frame(shown: &Comparison) -> Frame<'_> {
            Frame {
                image: "a/b",
                models: vec![
                    ("good <1>", Ok(shown)),
                    ("bad", Err("it gave NaN".to_owned())),
                ],
            }
        }
        let sheets = comparisons("KITTI", &[frame(&good)]);
        assert_eq!(sheets.len(), 1);
        let svg = &sheets[0];
        for text in [
            "good &lt;1&gt;: depth",
            "ground truth, dilated",
            "bad: no depth: it gave NaN",
            "relative error, 0 to 0.5",
        ] {
            assert!(svg.contains(text), "no {text}");
        }
        assert_eq!(svg.matches("<image").count(), 6);
        assert!(comparisons("KITTI", &[frame(&bare)])[0].contains("no ground truth"));
        let five: Vec<Frame<'_>> = (0..5).map(|_| frame(&good)).collect();
        let sheets = comparisons("KITTI", &five);
        assert!(sheets.len() == 2 && sheets[1].contains("KITTI (2 of 2)"));
        let none = Frame {
            image: "a/b",
            models: vec![("bad", Err("it gave NaN".to_owned()))],
        };
        assert!(comparisons("KITTI", &[none])[0].contains("bad: no depth: it gave NaN"));
    }

    #[test]
    fn sparse_points_survive_the_way_to_a_tile() {
        let mut plane = Plane::filled(920, 40, -1.0);
        plane.data[5 * 920 + 7] = 0.25;
        let values = pooled(&plane, (460, 20), |values| values[0]);
        assert_eq!(values.iter().filter(|value| value.is_some()).count(), 1);
        assert_eq!(values[2 * 460 + 3], Some(0.25));
    }
}
