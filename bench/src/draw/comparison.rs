//! One prediction beside its ground truth: input, prediction, truth and error in one PNG.
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

use super::colour::{NOTHING, blue_to_red, brightest_of, magma};
use crate::evaluate::{
    Comparison,
    record::{PICTURES, slug},
};

/// Relative depth error at the red end of the error map.
pub const WORST_ERROR: f32 = 0.5;

/// Pixels between two tiles.
const GAP: u32 = 6;

/// What the four tiles are, for a text beside the pictures.
const LEGEND: &str = "\
top left      input image
top right     predicted inverse depth (magma: dark = far, bright = near), scaled and clipped as scored
bottom left   true inverse depth, same scale
bottom right  relative depth error |predicted - true| / true, blue = 0, red = 0.5 or more

Grey was not scored: nothing was measured there, or the protocol leaves it out (crop, depth limits).
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

/// Draws one comparison: four tiles of the size of the image.
#[must_use]
pub fn draw(comparison: &Comparison) -> RgbImage {
    let (width, height) = comparison.input.dimensions();
    let brightest = brightest_of(&comparison.predicted);
    let truth = widened(&comparison.truth());
    let error = widened_error(&comparison.error());
    let mut canvas = RgbImage::from_pixel(2 * width + GAP, 2 * height + GAP, Rgb([255, 255, 255]));
    // The nearest value: a laser's grid is coarser than the image.
    let nearest = |index: u32, count: u32, from: usize| {
        ((2 * index as usize + 1) * from / (2 * count as usize)).min(from - 1)
    };
    let at = |plane: &Plane, x: u32, y: u32| {
        plane.row(nearest(y, height, plane.height))[nearest(x, width, plane.width)]
    };
    let (right, bottom) = (width + GAP, height + GAP);
    for (x, y, pixel) in comparison.input.enumerate_pixels() {
        canvas.put_pixel(x, y, *pixel);
        let predicted = magma(at(&comparison.predicted, x, y) / brightest);
        canvas.put_pixel(right + x, y, predicted);
        let truth = match at(&truth, x, y) {
            0.0 => NOTHING,
            inverse => magma(inverse / brightest),
        };
        canvas.put_pixel(x, bottom + y, truth);
        let error = match at(&error, x, y) {
            error if error < 0.0 => NOTHING,
            error => blue_to_red(error / WORST_ERROR),
        };
        canvas.put_pixel(right + x, bottom + y, error);
    }
    canvas
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
        assert_eq!(picture.dimensions(), (8 * 2 + GAP, 4 * 2 + GAP));
        assert_eq!(*picture.get_pixel(7, 3), Rgb([1, 2, 3]));
        // The prediction is its own 95th percentile; the nearer truth is brighter than that.
        assert_eq!(*picture.get_pixel(8 + GAP, 0), magma(1.0));
        assert_eq!(*picture.get_pixel(0, 4 + GAP), magma(1.25));
        // Widened to its neighbour, nothing further away.
        assert_eq!(*picture.get_pixel(1, 5 + GAP), magma(1.25));
        assert_eq!(*picture.get_pixel(2, 4 + GAP), NOTHING);
        // 12.5 m of 10 m: half of the way to the red end.
        let error = |x, y| *picture.get_pixel(8 + GAP + x, 4 + GAP + y);
        assert_eq!(error(0, 0), blue_to_red(0.25 / WORST_ERROR));
        assert_eq!((error(1, 1), error(2, 0)), (error(0, 0), NOTHING));
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
        let error = |x, y| *picture.get_pixel(16 + GAP + x, 8 + GAP + y);
        assert_eq!(error(0, 0), blue_to_red(0.5));
        // Widened by one pixel of the coarse grid.
        assert_eq!((error(3, 3), error(4, 3)), (blue_to_red(0.5), NOTHING));
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
