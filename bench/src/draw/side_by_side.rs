//! Sheets that compare models on the same images (figures 3.3 and 3.6 to 3.10 of the thesis).
//!
//! A comparison sheet has two rows for each image: the input with the depth of each model, and
//! below it the ground truth, dilated so that sparse points can be seen, with each model's error.
//! What is drawn is what was scored ([`Comparison`]): grey was not. All maps of an image share one
//! scale. Depth is coloured as inverse depth (magma, bright is near), the relative depth error
//! |p - g| / g with cividis, which grows in lightness alone for colour-blind readers too.
//!
//! A synthesis sheet shows the right view that each model makes of the left one at the widest
//! baseline: `R'(x) = L(x + w d_R(x))` with linear interpolation along rows and black outside
//! (PROTOCOL 4.3), beside the real right view, with the absolute difference. It takes a model that
//! gives the right view's disparity too.

use image::{Rgb, RgbImage};
use strat_store::{raster::Plane, resize};

use super::{
    colour::{brightest_of, cividis, magma, percentile_95},
    comparison::{NOTHING, WORST_ERROR, widened},
    legend::{Key, Scale, ScaleUnit, uncaptioned},
    sheet::{Sheet, Tile, tile_size},
};
use crate::evaluate::Comparison;

/// Width of a picture within a sheet.
const TILE_WIDTH: u32 = 460;
/// JPEG quality of photographs within a sheet.
const PICTURE_QUALITY: u8 = 88;
/// Absolute difference of grey levels at the bright end.
pub(super) const WORST_DIFFERENCE: f32 = 64.0;
/// Images on one sheet.
pub const PER_SHEET: usize = 4;

/// What a model made of an image, or a sentence about why it made nothing.
pub type Shown<T> = Result<T, String>;

/// An image of a comparison sheet.
pub struct Frame<'a> {
    /// Its id.
    pub image: &'a str,
    /// Models in order, with what they made of it.
    pub models: Vec<(&'a str, Shown<&'a Comparison>)>,
}

/// A right view that a model has made, of the left view's size.
pub struct Synthesis {
    /// The left view it was made of.
    pub left: RgbImage,
    /// The right view's disparity, a fraction of the width.
    pub disparity: Plane,
    /// The view at the widest baseline.
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

/// The right view of `left` at a fraction `b` of the baseline, under the right view's disparity, a
/// fraction of the width: each pixel is taken from `x + b w d(x)`, between two columns linearly; what
/// comes from outside is black (PROTOCOL 4.3).
///
/// # Panics
/// If image and disparity differ in size.
#[must_use]
pub fn synthesize_right(left: &RgbImage, disparity_fraction: &Plane, b: f32) -> RgbImage {
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
        let offset = b * disparity_fraction.row(y as usize)[x as usize] * width as f32;
        let from = (x as f32 + offset).clamp(-1.0, width as f32);
        let (low, share) = (from.floor(), from - from.floor());
        Rgb([0, 1, 2].map(|channel| {
            let (a, b) = (tap(low, y, channel), tap(low + 1.0, y, channel));
            (a + share * (b - a)).round() as u8
        }))
    })
}

/// Comparison sheets of [`PER_SHEET`] images each, as SVG.
#[must_use]
pub fn comparisons(title: &str, frames: &[Frame<'_>]) -> Vec<String> {
    let note = format!(
        "Depth: magma, bright is near, one scale for an image. Error: |predicted - true| / true, \
         cividis, dark 0, bright {WORST_ERROR} and more. Grey was not scored."
    );
    let error = key("relative error", WORST_ERROR, cividis);
    sheets(title, &note, &error, frames, rows_of)
}

/// Synthesis sheets of [`PER_SHEET`] images each, as SVG.
#[must_use]
pub fn syntheses(title: &str, frames: &[SynthesisFrame<'_>]) -> Vec<String> {
    let note = format!(
        "Synthesised from the left view at its own size. Difference: mean over the colours, black \
         0, bright {WORST_DIFFERENCE} grey levels and more."
    );
    let grey = key("difference, grey levels", WORST_DIFFERENCE, magma);
    sheets(title, &note, &grey, frames, synthesis_rows)
}

/// A scale from 0 to a value and more.
fn key(words: &str, brightest: f32, colour: fn(f32) -> Rgb<u8>) -> Key {
    Key {
        words: words.to_owned(),
        scale: Scale {
            unit: Some(ScaleUnit::AndMore),
            brightest,
        },
        colour,
    }
}

fn sheets<F>(
    title: &str,
    note: &str,
    key: &Key,
    frames: &[F],
    rows_of: impl Fn(&F) -> [Vec<Tile>; 2],
) -> Vec<String> {
    let count = frames.len().div_ceil(PER_SHEET);
    let sheet = |(index, frames): (usize, &[F])| {
        let sheet = Sheet {
            title: if count > 1 {
                format!("{title} ({} of {count})", index + 1)
            } else {
                title.to_owned()
            },
            note: note.to_owned(),
            rows: frames.iter().flat_map(&rows_of).collect(),
            keys: vec![key.clone()],
        };
        sheet.svg()
    };
    frames.chunks(PER_SHEET).enumerate().map(sheet).collect()
}

/// The two rows of one image.
fn rows_of(frame: &Frame<'_>) -> [Vec<Tile>; 2] {
    let found = || {
        frame
            .models
            .iter()
            .filter_map(|(_, shown)| shown.as_ref().ok().copied())
    };
    // Ground truth is the same for all; a model that could not be scored has none.
    let some = found().find(|one| one.scored.is_some()).or(found().next());
    let Some(some) = some else {
        let tile = |(name, shown): &(&str, Shown<&Comparison>)| {
            let why = shown.as_ref().err().map_or("", String::as_str);
            let size = (TILE_WIDTH, TILE_WIDTH / 4);
            blank(size, format!("{name}: no depth: {why}"))
        };
        return [frame.models.iter().map(tile).collect(), Vec::new()];
    };
    let size = tile_size(some.input.width(), some.input.height(), TILE_WIDTH);
    let truth = some.truth();
    // The scale is the ground truth's, so that no model chooses it.
    let brightest = match percentile_95(truth.data.iter().copied().filter(|v| *v > 0.0)) {
        0.0 => found()
            .map(|one| brightest_of(&one.predicted))
            .fold(f32::MIN_POSITIVE, f32::max),
        of_truth => of_truth,
    };
    let scale = Scale {
        unit: Some(ScaleUnit::Metres),
        brightest,
    };
    let mut above = vec![photograph(&some.input, size, frame.image.to_owned())];
    let depth = Key {
        words: "depth".to_owned(),
        scale,
        colour: magma,
    };
    let mut below = vec![truth_tile(&truth, size, scale).with_key(depth)];
    for (name, shown) in &frame.models {
        match shown {
            Ok(one) => {
                let small = resize::area_f32(&one.predicted, size.0 as usize, size.1 as usize);
                above.push(Tile::drawn(
                    &uncaptioned(&small, scale),
                    format!("{name}: depth"),
                ));
                below.push(error_tile(one, size, name));
            }
            Err(reason) => {
                above.push(blank(size, format!("{name}: no depth: {reason}")));
                below.push(blank(size, format!("{name}: no error")));
            }
        }
    }
    [above, below]
}

pub(super) fn photograph(picture: &RgbImage, size: (u32, u32), caption: String) -> Tile {
    Tile::photograph(picture, size, PICTURE_QUALITY, caption)
}

fn blank((width, height): (u32, u32), caption: String) -> Tile {
    Tile::drawn(&RgbImage::from_pixel(width, height, NOTHING), caption)
}

/// For each pixel of a tile what `choose` makes of the values that lie below it and are not
/// negative; none where there are none.
fn pooled(
    plane: &Plane,
    (width, height): (u32, u32),
    choose: impl Fn(&[f32]) -> f32,
) -> Vec<Option<f32>> {
    let below = |index: usize, count: u32, from: usize| {
        let (count, first) = (count as usize, index * from / count as usize);
        let end = ((index + 1) * from).div_ceil(count).max(first + 1);
        first..end.min(from)
    };
    let mut found = Vec::new();
    let mut values = Vec::with_capacity(width as usize * height as usize);
    for y in 0..height as usize {
        for x in 0..width as usize {
            found.clear();
            for row in below(y, height, plane.height) {
                let own = &plane.row(row)[below(x, width, plane.width)];
                found.extend(own.iter().copied().filter(|value| *value >= 0.0));
            }
            values.push((!found.is_empty()).then(|| choose(&found)));
        }
    }
    values
}

fn truth_tile(truth: &Plane, size: (u32, u32), scale: Scale) -> Tile {
    let nearest = |values: &[f32]| values.iter().copied().fold(0.0, f32::max);
    let values = pooled(&widened(truth), size, nearest);
    let small = Plane {
        width: size.0 as usize,
        height: size.1 as usize,
        data: values.iter().map(|value| value.unwrap_or(0.0)).collect(),
    };
    let mut picture = uncaptioned(&small, scale);
    for (index, _) in small.data.iter().enumerate().filter(|(_, v)| **v <= 0.0) {
        picture.put_pixel(index as u32 % size.0, index as u32 / size.0, NOTHING);
    }
    let words = if small.data.iter().any(|value| *value > 0.0) {
        "ground truth, dilated"
    } else {
        "no ground truth"
    };
    Tile::drawn(&picture, words.to_owned())
}

fn error_tile(comparison: &Comparison, size: (u32, u32), name: &str) -> Tile {
    let mean = |values: &[f32]| values.iter().sum::<f32>() / values.len() as f32;
    let values = pooled(&comparison.error(), size, mean);
    let picture = RgbImage::from_fn(size.0, size.1, |x, y| {
        values[(y * size.0 + x) as usize].map_or(NOTHING, |error| cividis(error / WORST_ERROR))
    });
    let caption = match (&comparison.scored, comparison.abs_rel()) {
        (None, _) => format!("{name}: no ground truth to compare with"),
        (Some(_), None) => format!("{name}: relative error"),
        (Some(_), Some(abs_rel)) => format!(
            "{name}: relative error; Abs Rel {abs_rel:.3} under {}",
            comparison.context.protocol
        ),
    };
    Tile::drawn(&picture, caption)
}

fn synthesis_rows(frame: &SynthesisFrame<'_>) -> [Vec<Tile>; 2] {
    let size = frame.left.map_or((TILE_WIDTH, TILE_WIDTH / 2), |left| {
        tile_size(left.width(), left.height(), TILE_WIDTH)
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
                let difference = difference(&synthesis.right, &synthesis.real);
                let mean = difference.data.iter().sum::<f32>() / difference.data.len() as f32;
                let (width, height) = (size.0 as usize, size.1 as usize);
                let small = resize::area_f32(&difference, width, height);
                let picture = RgbImage::from_fn(size.0, size.1, |x, y| {
                    magma(small.row(y as usize)[x as usize] / WORST_DIFFERENCE)
                });
                above.push(photograph(
                    &synthesis.right,
                    size,
                    format!("{name}: right view"),
                ));
                below.push(Tile::drawn(
                    &picture,
                    format!("{name}: mean difference {mean:.1} grey levels"),
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

/// Mean absolute difference over the colours of two pictures of one size, in grey levels.
pub(super) fn difference(a: &RgbImage, b: &RgbImage) -> Plane {
    let pixels = a.pixels().zip(b.pixels());
    Plane {
        width: a.width() as usize,
        height: a.height() as usize,
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
    use crate::draw::comparison::tests::example;

    fn stripes(width: u32, height: u32) -> RgbImage {
        RgbImage::from_fn(width, height, |x, y| {
            Rgb([(7 * x) as u8, (x * x) as u8, y as u8])
        })
    }

    #[test]
    fn views_are_shifted_by_their_disparity() {
        let left = stripes(16, 4);
        let constant = |px: f32| Plane::filled(16, 4, px / 16.0);
        assert_eq!(synthesize_right(&left, &constant(0.0), 1.0), left);
        let three = synthesize_right(&left, &constant(3.0), 1.0);
        for (x, y, pixel) in three.enumerate_pixels() {
            let expected = if x + 3 < 16 {
                *left.get_pixel(x + 3, y)
            } else {
                Rgb([0; 3])
            };
            assert_eq!(*pixel, expected, "{x} {y}");
        }
        assert_eq!(synthesize_right(&left, &constant(6.0), 0.5), three);
        // Halfway between two columns; the last one fades to black over a pixel.
        let half = synthesize_right(&left, &constant(0.5), 1.0);
        assert_eq!(
            half.get_pixel(2, 1).0[0],
            18,
            "(14 + 21) / 2, away from zero"
        );
        assert_eq!(half.get_pixel(15, 1).0[0], 53, "105 / 2");
        // Far outside is outside.
        let far = synthesize_right(&left, &constant(100.0), 1.0);
        assert!(far.pixels().all(|pixel| pixel.0 == [0; 3]));
    }

    /// A model that predicts `predicted_m` everywhere; true depth is 10 m in every fifth pixel.
    fn comparison(predicted_m: f64) -> Comparison {
        example(32, 16, predicted_m, (0..512).step_by(5))
    }

    #[test]
    fn sheets_say_what_is_missing() {
        let good = comparison(12.5);
        let bare = Comparison {
            scored: None,
            ..comparison(12.5)
        };
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
            "relative error; Abs Rel 0.250 under eigen-80",
            ">0.5+<",
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

    /// 12.5 m of 10 m is an error of 0.25 in every fifth pixel, whatever is pooled; grey between.
    #[test]
    fn the_error_tile_shows_the_scored_error_and_grey() {
        let picture = |tile: &Tile| image::load_from_memory(tile.data()).unwrap().to_rgb8();
        let tile = picture(&error_tile(&comparison(12.5), (32, 16), "a"));
        for index in 0..512_u32 {
            let expected = if index % 5 == 0 {
                cividis(0.25 / WORST_ERROR)
            } else {
                NOTHING
            };
            assert_eq!(*tile.get_pixel(index % 32, index / 32), expected, "{index}");
        }
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
