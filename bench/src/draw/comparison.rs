//! Comparison pictures: input, prediction, ground truth and error in one PNG.
//!
//! Four tiles of the image's own size: the input (top left), the predicted disparity (top
//! right), the true disparity (bottom left) and the relative depth error (bottom right). Both
//! disparities share one scale, black at 0 and bright at the prediction's 95th percentile; the
//! error goes from blue at 0 to red at [`WORST_ERROR`] and above. Pixels without ground truth
//! are grey. Sparse points are drawn three pixels wide to be seen at all.
//!
//! Pictures illustrate; no figure is computed from them.

use std::path::{Path, PathBuf};

use image::{Rgb, RgbImage};
use strat_store::{files, image_files, raster::Plane};

use crate::evaluate::{Comparison, record::slug};

/// Relative depth error at the red end of the error map.
pub const WORST_ERROR: f32 = 0.5;

/// Pixels between two tiles.
const GAP: u32 = 6;
const NO_TRUTH: Rgb<u8> = Rgb([70, 70, 70]);

/// What the four tiles are, for a text beside the pictures.
pub const LEGEND: &str = "\
top left      input image
top right     predicted disparity (magma: dark = far, bright = near)
bottom left   true disparity, same scale; grey = not measured
bottom right  relative depth error |predicted - true| / true, blue = 0, red = 0.5 or more
";

/// Folder of the pictures within that of the results.
pub const FOLDER: &str = "pictures";

/// Draws a comparison of a model into the folder of its results, with a text that explains it.
///
/// # Errors
/// A file cannot be written.
pub fn write(
    results: &Path,
    model: &str,
    comparison: &Comparison,
) -> Result<(), strat_store::Error> {
    let folder = results.join(FOLDER);
    let picture = image_files::encode_png_rgb(&draw(comparison));
    files::write_atomic(&folder.join(file(model, &comparison.image)), &picture)?;
    files::write_atomic(&folder.join("LEGEND.txt"), LEGEND.as_bytes())
}

/// Place of a picture within [`FOLDER`].
#[must_use]
pub fn file(model: &str, image: &str) -> PathBuf {
    Path::new(&slug(model)).join(format!("{}.png", slug(image)))
}

/// Draws one comparison.
#[must_use]
pub fn draw(comparison: &Comparison) -> RgbImage {
    let (width, height) = comparison.input.dimensions();
    let mut canvas = RgbImage::from_pixel(2 * width + GAP, 2 * height + GAP, Rgb([255, 255, 255]));
    let brightest = percentile_95(&comparison.predicted).max(f32::MIN_POSITIVE);
    let truth = widened(&comparison.truth);
    let mut put = |left: u32, top: u32, colour: &dyn Fn(usize, u32, u32) -> Rgb<u8>| {
        for row in 0..height {
            for column in 0..width {
                let index = row as usize * width as usize + column as usize;
                canvas.put_pixel(left + column, top + row, colour(index, column, row));
            }
        }
    };
    let at = |plane: &Plane, index: usize| plane.data.get(index).copied().unwrap_or(0.0);
    let (right, bottom) = (width + GAP, height + GAP);
    put(0, 0, &|_, column, row| {
        *comparison.input.get_pixel(column, row)
    });
    put(right, 0, &|index, _, _| {
        magma(at(&comparison.predicted, index) / brightest)
    });
    put(0, bottom, &|index, _, _| match at(&truth, index) {
        0.0 => NO_TRUTH,
        disparity => magma(disparity / brightest),
    });
    put(right, bottom, &|index, _, _| {
        let (true_disparity, predicted) = (at(&truth, index), at(&comparison.predicted, index));
        if true_disparity == 0.0 {
            return NO_TRUTH;
        }
        // Depth is the reciprocal of disparity: |p - g| / g in depth.
        let error = (true_disparity / predicted - 1.0).abs();
        let place = if error.is_finite() {
            (error / WORST_ERROR).min(1.0)
        } else {
            1.0
        };
        // The gradient runs from red to blue.
        rgb(colorous::RED_YELLOW_BLUE, 1.0 - place)
    });
    canvas
}

pub(crate) fn magma(place: f32) -> Rgb<u8> {
    rgb(colorous::MAGMA, place)
}

pub(crate) fn rgb(gradient: colorous::Gradient, place: f32) -> Rgb<u8> {
    let place = if place.is_finite() {
        f64::from(place.clamp(0.0, 1.0))
    } else {
        0.0
    };
    let colour = gradient.eval_continuous(place);
    Rgb([colour.r, colour.g, colour.b])
}

pub(crate) fn percentile_95(plane: &Plane) -> f32 {
    let mut values: Vec<f32> = plane
        .data
        .iter()
        .copied()
        .filter(|value| value.is_finite())
        .collect();
    if values.is_empty() {
        return 0.0;
    }
    let place = (values.len() - 1) * 95 / 100;
    *values.select_nth_unstable_by(place, f32::total_cmp).1
}

/// Every measured pixel spreads to its eight neighbours, the nearest surface on top.
pub(crate) fn widened(plane: &Plane) -> Plane {
    let (width, height) = (plane.width, plane.height);
    let mut data = plane.data.clone();
    for row in 0..height {
        for column in 0..width {
            let value = plane.data[row * width + column];
            if value == 0.0 {
                continue;
            }
            for near_row in row.saturating_sub(1)..(row + 2).min(height) {
                for near_column in column.saturating_sub(1)..(column + 2).min(width) {
                    let index = near_row * width + near_column;
                    // A measured pixel keeps its own value.
                    if plane.data[index] == 0.0 && data[index] < value {
                        data[index] = value;
                    }
                }
            }
        }
    }
    Plane {
        width,
        height,
        data,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_lie_where_the_legend_says() {
        let plane = |data: Vec<f32>| Plane {
            width: 8,
            height: 4,
            data,
        };
        let mut truth = vec![0.0; 32];
        truth[0] = 0.1;
        let comparison = Comparison {
            image: "x".to_owned(),
            input: RgbImage::from_pixel(8, 4, Rgb([1, 2, 3])),
            predicted: plane(vec![0.1; 32]),
            truth: plane(truth),
            depth_at_width_m: 1.0,
            median_within_m: None,
        };
        let picture = draw(&comparison);
        assert_eq!(picture.dimensions(), (8 * 2 + GAP, 4 * 2 + GAP));
        assert_eq!(*picture.get_pixel(7, 3), Rgb([1, 2, 3]));
        let brightest = magma(1.0);
        assert_eq!(*picture.get_pixel(8 + GAP, 0), brightest);
        assert_eq!(*picture.get_pixel(0, 4 + GAP), brightest);
        // Widened to its neighbour, nothing further away.
        assert_eq!(*picture.get_pixel(1, 5 + GAP), brightest);
        assert_eq!(*picture.get_pixel(2, 4 + GAP), NO_TRUTH);
        // No error there: the blue end.
        assert_eq!(
            *picture.get_pixel(8 + GAP, 4 + GAP),
            rgb(colorous::RED_YELLOW_BLUE, 1.0)
        );
    }

    #[test]
    fn numbers_that_are_none_do_not_stop_a_picture() {
        assert_eq!(magma(f32::NAN), magma(0.0));
        assert_eq!(magma(7.0), magma(1.0));
    }

    #[test]
    fn names_become_file_names() {
        assert_eq!(slug("Ours - StrAT (f=2)"), "Ours_-_StrAT__f_2_");
        assert_eq!(
            slug("2011_09_26_drive_0001/0000000005"),
            "2011_09_26_drive_0001_0000000005"
        );
        assert_eq!(slug(".."), "_");
    }
}
