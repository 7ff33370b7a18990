//! One prediction beside its ground truth: input, prediction, truth and error in one PNG, each with its name,
//! and both scales below. The scale of depth is the ground truth's, so that the same truth looks alike in
//! the pictures of all models.
//!
//! What is drawn is what was scored ([`Comparison`]): the pixels that the protocol looks at, and the
//! prediction scaled and clipped as the protocol does it. Everything else is grey. Sparse points are
//! drawn three pixels wide to be seen at all. A list beside the pictures ([`INDEX`]) says under which
//! protocol each was drawn and which Abs Rel its row has.

use std::path::{Path, PathBuf};

use image::{Rgb, RgbImage};
use serde::{Deserialize, Serialize};
use strat_metrics::Row;
use strat_store::inputs::{self, Kind};
use strat_store::{files, image_files, raster::Plane};

use super::colour::{brightest_of, cividis, magma, percentile_95};
use super::legend::{self, Scale, ScaleUnit, draw_legend, draw_words};
use crate::evaluate::{
    Comparison,
    record::{PICTURES, slug},
};

/// Relative depth error at the bright end of the error map.
pub const WORST_ERROR: f32 = 0.5;

/// Pixels between two tiles.
const GAP: u32 = 6;

/// What was not scored, and what is missing: lighter than the grey in the middle of cividis.
pub(super) const NOTHING: Rgb<u8> = Rgb([222; 3]);

/// What the four tiles are, for a text beside the pictures.
const LEGEND: &str = "\
top left      input image
top right     predicted inverse depth (magma: dark = far, bright = near), scaled and clipped as scored
bottom left   true inverse depth, same scale; points are dilated
bottom right  relative depth error |predicted - true| / true (cividis: dark = 0, bright = 0.5 or more)

The scale of depth is that of the ground truth's 95th percentile. Light grey was not scored: nothing was measured there, or the protocol leaves it out (crop, depth limits).
pictures.csv names the protocol and the Abs Rel of each picture.
";

/// Folder of the pictures within that of the results.
pub const FOLDER: &str = PICTURES;

/// The list of the pictures within [`FOLDER`].
pub const INDEX: &str = "pictures.csv";

/// A line of [`INDEX`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PictureRow {
    /// Name of the model.
    pub model: String,
    /// Image id.
    pub image: String,
    /// Name of the protocol whose scoring is drawn.
    pub protocol: String,
    /// Digest of its rules.
    pub protocol_digest: String,
    /// Abs Rel of the image's row under this protocol.
    pub abs_rel: Option<f64>,
    /// What the predicted depth was multiplied by (median scaling), 1 without.
    pub scale: Option<f64>,
    /// Pixels scored.
    pub pixels: usize,
    /// The picture, below [`FOLDER`].
    pub file: PathBuf,
}

/// Draws one comparison for the model of this name below the folder of results and adds it to the
/// list there.
///
/// # Errors
/// A file cannot be written.
pub fn write(out: &Path, model: &str, comparison: &Comparison) -> Result<(), strat_store::Error> {
    let folder = out.join(FOLDER);
    let scored = comparison.scored.as_ref();
    let row = PictureRow {
        model: model.to_owned(),
        image: comparison.image.clone(),
        protocol: comparison.context.protocol.clone(),
        protocol_digest: comparison.context.protocol_digest.clone(),
        abs_rel: comparison.abs_rel(),
        scale: scored.map(|scored| scored.compared.fit.map_or(1.0, |fit| fit.scale)),
        pixels: scored.map_or(0, |scored| scored.compared.pixels.len()),
        file: file(model, &comparison.image),
    };
    let picture = image_files::encode_png_rgb(&draw(comparison));
    files::write_atomic(&folder.join(&row.file), &picture)?;
    let mut rows = index(out);
    rows.retain(|other| (&other.model, &other.image) != (&row.model, &row.image));
    rows.push(row);
    files::write_csv(&folder.join(INDEX), &rows)?;
    files::write_atomic(&folder.join("LEGEND.txt"), LEGEND.as_bytes())
}

/// The list of pictures of a folder of results; empty where there is none that can be read.
#[must_use]
pub fn index(out: &Path) -> Vec<PictureRow> {
    let Ok(file) = inputs::open(&out.join(FOLDER).join(INDEX), Kind::Table) else {
        return Vec::new();
    };
    strat_csv::Reader::new(file)
        .deserialize()
        .unwrap_or_default()
}

/// The picture that shows what a row scored: same model, image, protocol and Abs Rel.
#[must_use]
pub fn picture_of(out: &Path, row: &Row) -> Option<PathBuf> {
    let of_row = |picture: &PictureRow| {
        picture.model == row.context.model
            && picture.image == row.image
            && picture.protocol_digest == row.context.protocol_digest
            && picture.abs_rel == Some(row.score.metrics.abs_rel)
    };
    let found = index(out).into_iter().find(of_row)?;
    // The list may have come from elsewhere; the name is made here.
    let path = out.join(FOLDER).join(file(&found.model, &found.image));
    path.is_file().then_some(path)
}

/// Path of a picture below [`FOLDER`].
fn file(model: &str, image: &str) -> PathBuf {
    Path::new(&slug(model)).join(format!("{}.png", slug(image)))
}

/// Where the four tiles lie: their size, the corners of the upper left and of the lower right one, and the
/// size of the whole.
struct Layout {
    tile: (u32, u32),
    first: (u32, u32),
    last: (u32, u32),
    whole: (u32, u32),
}

impl Layout {
    fn of((width, height): (u32, u32)) -> Self {
        let words = legend::words_height(width);
        let last = (width + GAP, 2 * words + height);
        Self {
            tile: (width, height),
            first: (0, words),
            last,
            whole: (
                2 * width + GAP,
                last.1 + height + legend::legend_height(width),
            ),
        }
    }
}

/// Draws one comparison: four tiles of the size of the image, their names above and the scales below.
#[must_use]
pub fn draw(comparison: &Comparison) -> RgbImage {
    let (width, height) = comparison.input.dimensions();
    let truth = comparison.truth();
    let brightest = match percentile_95(truth.data.iter().copied().filter(|v| *v > 0.0)) {
        0.0 => brightest_of(&comparison.predicted),
        of_truth => of_truth,
    };
    let truth = widened(&truth);
    let error = widened_error(&comparison.error());
    let layout = Layout::of((width, height));
    let mut canvas = RgbImage::new(layout.whole.0, layout.whole.1);
    // The nearest value: a laser's grid is coarser than the image.
    let nearest = |index: u32, count: u32, from: usize| {
        ((2 * index as usize + 1) * from / (2 * count as usize)).min(from - 1)
    };
    let at = |plane: &Plane, x: u32, y: u32| {
        plane.row(nearest(y, height, plane.height))[nearest(x, width, plane.width)]
    };
    let (left, top) = layout.first;
    let (right, bottom) = layout.last;
    for (x, y, pixel) in comparison.input.enumerate_pixels() {
        canvas.put_pixel(left + x, top + y, *pixel);
        let predicted = magma(at(&comparison.predicted, x, y) / brightest);
        canvas.put_pixel(right + x, top + y, predicted);
        let truth = match at(&truth, x, y) {
            0.0 => NOTHING,
            inverse => magma(inverse / brightest),
        };
        canvas.put_pixel(left + x, bottom + y, truth);
        let error = match at(&error, x, y) {
            error if error < 0.0 => NOTHING,
            error => cividis(error / WORST_ERROR),
        };
        canvas.put_pixel(right + x, bottom + y, error);
    }
    name_tiles(&mut canvas, &layout, comparison);
    let below = bottom + layout.tile.1;
    let depth = Scale {
        unit: Some(ScaleUnit::Metres),
        brightest,
    };
    let errors = Scale {
        unit: Some(ScaleUnit::AndMore),
        brightest: WORST_ERROR,
    };
    draw_legend(&mut canvas, (left, below), width, depth, magma);
    draw_legend(&mut canvas, (right, below), width, errors, cividis);
    canvas
}

fn name_tiles(canvas: &mut RgbImage, layout: &Layout, comparison: &Comparison) {
    let words = legend::words_height(layout.tile.0);
    let error = match comparison.abs_rel() {
        Some(abs_rel) => format!("relative error, Abs Rel {abs_rel:.3}"),
        None => "relative error".to_owned(),
    };
    let (left, right) = (layout.first.0, layout.last.0);
    let (above, below) = (layout.first.1 - words, layout.last.1 - words);
    for (corner, text) in [
        ((left, above), comparison.image.clone()),
        (
            (right, above),
            format!("{}: depth", comparison.context.model),
        ),
        ((left, below), "ground truth, dilated".to_owned()),
        ((right, below), error),
    ] {
        draw_words(canvas, corner, layout.tile.0, &text);
    }
}

/// Every pixel that has something spreads to its eight neighbours that have nothing; of several the
/// largest value, which is the nearest surface.
pub(super) fn widened(plane: &Plane) -> Plane {
    spread(plane, 0.0)
}

/// The same for errors, where nothing is -1; of several the worst.
pub(super) fn widened_error(plane: &Plane) -> Plane {
    spread(plane, -1.0)
}

fn spread(plane: &Plane, nothing: f32) -> Plane {
    let (width, height) = (plane.width, plane.height);
    let mut wide = plane.clone();
    for (index, &value) in plane
        .data
        .iter()
        .enumerate()
        .filter(|(_, v)| **v != nothing)
    {
        let (row, column) = (index / width, index % width);
        for near_row in row.saturating_sub(1)..(row + 2).min(height) {
            for near_column in column.saturating_sub(1)..(column + 2).min(width) {
                let near = near_row * width + near_column;
                // A pixel keeps its own value.
                if plane.data[near] == nothing && wide.data[near] < value {
                    wide.data[near] = value;
                }
            }
        }
    }
    wide
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::evaluate::comparison::Scored;
    use strat_metrics::{Compared, ComparedPixel, ImageScore, Metrics, RowContext};

    /// A model that predicts one depth everywhere, scored in some pixels where true depth is 10 m.
    pub(in crate::draw) fn example(
        width: u32,
        height: u32,
        predicted_m: f64,
        scored: impl Iterator<Item = usize>,
    ) -> Comparison {
        let (columns, rows) = (width as usize, height as usize);
        let pixels: Vec<ComparedPixel> = scored
            .map(|index| ComparedPixel {
                index,
                truth_m: 10.0,
                predicted_m,
            })
            .collect();
        let abs_rel = (predicted_m - 10.0).abs() / 10.0;
        let score = ImageScore {
            group: None,
            metrics: Metrics {
                abs_rel,
                sq_rel: 0.0,
                rmse: 0.0,
                rmse_log: 0.0,
                a1: 1.0,
                a2: 1.0,
                a3: 1.0,
            },
            further: None,
            d1_all: None,
            sum_squared_error: 0.0,
            pixels: pixels.len() as u64,
            floored_pixels: 0,
            fit: None,
        };
        Comparison {
            image: "drive/1".to_owned(),
            input: RgbImage::from_pixel(width, height, Rgb([1, 2, 3])),
            predicted: Plane::filled(columns, rows, 1.0 / predicted_m as f32),
            context: RowContext {
                protocol: "eigen-80".to_owned(),
                protocol_digest: "d".to_owned(),
                model: "m".to_owned(),
                ..RowContext::default()
            },
            scored: Some(Scored {
                scores: vec![score],
                compared: Compared {
                    width: columns,
                    height: rows,
                    fit: None,
                    limits_m: (1e-3, 80.0),
                    pixels,
                    predicted_m: vec![predicted_m as f32; columns * rows],
                },
            }),
        }
    }

    #[test]
    fn tiles_lie_where_the_legend_says() {
        let picture = draw(&example(8, 4, 12.5, [0].into_iter()));
        let layout = Layout::of((8, 4));
        assert_eq!(picture.dimensions(), layout.whole);
        let ((left, top), (right, bottom)) = (layout.first, layout.last);
        assert_eq!(*picture.get_pixel(left + 7, top + 3), Rgb([1, 2, 3]));
        // The scale is the ground truth's, whatever was predicted: 10 m are brightest, 12.5 m less so.
        assert_eq!(
            *picture.get_pixel(right, top),
            magma((1.0 / 12.5_f32) / (1.0 / 10.0_f32))
        );
        assert_eq!(*picture.get_pixel(left, bottom), magma(1.0));
        // Widened to its neighbour, nothing further away.
        assert_eq!(*picture.get_pixel(left + 1, bottom + 1), magma(1.0));
        assert_eq!(*picture.get_pixel(left + 2, bottom), NOTHING);
        // 12.5 m of 10 m: half of the way to the bright end.
        let error = |x, y| *picture.get_pixel(right + x, bottom + y);
        assert_eq!(error(0, 0), cividis(0.25 / WORST_ERROR));
        assert_eq!((error(1, 1), error(2, 0)), (error(0, 0), NOTHING));
    }

    #[test]
    fn the_same_truth_looks_alike_for_every_model() {
        let [near, far] = [5.0, 40.0].map(|depth| draw(&example(8, 4, depth, [0].into_iter())));
        let layout = Layout::of((8, 4));
        let (left, bottom) = (layout.first.0, layout.last.1);
        for (x, y) in [(0, 0), (5, 2)] {
            assert_eq!(
                near.get_pixel(left + x, bottom + y),
                far.get_pixel(left + x, bottom + y)
            );
        }
    }

    #[test]
    fn planes_hold_what_was_compared_and_nothing_else() {
        let comparison = example(8, 4, 12.5, [3, 9].into_iter());
        let (truth, error) = (comparison.truth(), comparison.error());
        for index in 0..32 {
            let expected = if [3, 9].contains(&index) {
                (0.1, 0.25)
            } else {
                (0.0, -1.0)
            };
            assert_eq!((truth.data[index], error.data[index]), expected, "{index}");
        }
        let unscored = Comparison {
            scored: None,
            ..comparison
        };
        assert!(unscored.error().data.iter().all(|error| *error == -1.0));
        assert_eq!(unscored.abs_rel(), None);
    }

    /// A ground truth of half the size: each of its pixels covers four of the image.
    #[test]
    fn coarse_ground_truth_covers_the_image() {
        let mut coarse = example(8, 4, 12.5, [0].into_iter());
        coarse.input = RgbImage::new(16, 8);
        let picture = draw(&coarse);
        let (right, bottom) = Layout::of((16, 8)).last;
        let error = |x, y| *picture.get_pixel(right + x, bottom + y);
        assert_eq!(error(0, 0), cividis(0.5));
        // Widened by one pixel of the coarse grid.
        assert_eq!((error(3, 3), error(4, 3)), (cividis(0.5), NOTHING));
    }

    #[test]
    fn pictures_are_found_by_what_they_show() {
        let folder = tempfile::tempdir().unwrap();
        let comparison = example(8, 4, 12.5, [0].into_iter());
        write(folder.path(), "m", &comparison).unwrap();
        let scored = comparison.scored.as_ref().unwrap();
        let row = Row::new(
            &comparison.context,
            comparison.image.clone(),
            scored.scores[0],
        );
        let path = picture_of(folder.path(), &row).unwrap();
        assert!(path.ends_with("pictures/m/drive_1.png"));
        // Another protocol, another score, another image: not the picture of that.
        let mut other = row.clone();
        other.context.protocol_digest = "e".to_owned();
        assert_eq!(picture_of(folder.path(), &other), None);
        let mut other = row.clone();
        other.score.metrics.abs_rel += 1e-9;
        assert_eq!(picture_of(folder.path(), &other), None);
        let mut other = row.clone();
        other.image = "drive/2".to_owned();
        assert_eq!(picture_of(folder.path(), &other), None);
        // Written again it stands in the list once, beside those of other images.
        let second = Comparison {
            image: "drive/2".to_owned(),
            ..comparison.clone()
        };
        write(folder.path(), "m", &second).unwrap();
        write(folder.path(), "m", &comparison).unwrap();
        let images: Vec<String> = index(folder.path())
            .into_iter()
            .map(|row| row.image)
            .collect();
        assert_eq!(images, ["drive/2", "drive/1"]);
    }
}
