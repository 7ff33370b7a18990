//! The simplest honest predictor: for every place in the picture the median depth that the
//! training scans have there, whatever the picture shows.
//!
//! A network that does not beat this has learnt nothing from its input. Its row is measured, not
//! published: the depths come from the training samples of the prepared set, or of another one, and
//! the row is evaluated under the same protocols on the same images as the models.

use rayon::prelude::*;
use strat_splits::Role;
use strat_store::{
    exr, files,
    progress::Progress,
    raster::Plane,
    set::{PreparedSet, Sample},
};

use super::sample::{SampleError, checked_bytes};

/// Name of the row in tables.
pub const NAME: &str = "Median depth (constant)";

/// Name of the row of the training scans of another set, which is called `set`.
#[must_use]
pub fn name_of(set: &str) -> String {
    format!("Median depth ({set})")
}

/// Cells across; with [`GRID_HEIGHT`], about the shape of a KITTI image.
pub const GRID_WIDTH: usize = 416;
/// Cells down.
pub const GRID_HEIGHT: usize = 128;

/// More scans than this do not move a median, but fill the memory; they are drawn evenly.
const MAX_IMAGES: usize = 1000;

/// Why there is no such row.
#[derive(Debug, thiserror::Error)]
pub enum BaselineError {
    /// The set was prepared without training depth.
    #[error(
        "the prepared set has no depth for its training images, which the median baseline is made \
         of; prepare it again with `--train-depth`"
    )]
    NoTrainingDepth,
    /// There is depth, but no pixel has any.
    #[error("the training depth maps of the prepared set hold no measurement at all")]
    Empty,
    /// The table of the training samples or a depth map could not be read.
    #[error("the median baseline cannot be made: {0}")]
    Sample(#[from] SampleError),
}

/// The constant prediction.
#[derive(Clone, Debug, PartialEq)]
pub struct MedianDepth {
    /// Depth in metres on the grid.
    pub depth_m: Plane,
    /// Training images used.
    pub images: usize,
    /// Training images with depth.
    pub available: usize,
}

impl MedianDepth {
    /// Makes the map from the Velodyne depth of a set's training samples.
    ///
    /// # Errors
    /// The set has no training depth, or a depth map is broken.
    pub fn of_training(
        set: &PreparedSet,
        pool: &rayon::ThreadPool,
        quiet: bool,
    ) -> Result<Self, BaselineError> {
        let samples: Vec<Sample> = set
            .samples(Role::Train)
            .map_err(SampleError::from)?
            .into_iter()
            .filter(|sample| sample.depth_velodyne.is_some())
            .collect();
        if samples.is_empty() {
            return Err(BaselineError::NoTrainingDepth);
        }
        let used = samples.len().min(MAX_IMAGES);
        let chosen: Vec<&Sample> = (0..used)
            .map(|index| &samples[index * samples.len() / used])
            .collect();
        let progress = Progress::new("median baseline", used as u64, "scans", quiet);
        let mut cells: Vec<Vec<f32>> = vec![Vec::new(); GRID_WIDTH * GRID_HEIGHT];
        for chunk in chosen.chunks(4 * pool.current_num_threads().max(1)) {
            let parts: Vec<Result<Vec<(usize, f32)>, SampleError>> = pool.install(|| {
                chunk
                    .par_iter()
                    .map(|sample| {
                        let Some(file) = &sample.depth_velodyne else {
                            return Ok(Vec::new());
                        };
                        let bytes = checked_bytes(set, file)?;
                        let (depth, _) = exr::decode_depth(&bytes, &set.path(file))?;
                        Ok(binned(&depth))
                    })
                    .collect()
            });
            for part in parts {
                for (cell, depth_m) in part? {
                    cells[cell].push(depth_m);
                }
            }
            progress.add(chunk.len() as u64);
        }
        progress.finish();
        let medians = cells.into_iter().map(median).collect();
        Ok(Self {
            depth_m: fill(medians, GRID_WIDTH, GRID_HEIGHT).ok_or(BaselineError::Empty)?,
            images: used,
            available: samples.len(),
        })
    }

    /// A sentence of what the map was made of.
    #[must_use]
    pub fn origin(&self) -> String {
        format!(
            "per-place median of {} of {} training scans on a grid of {GRID_WIDTH}x{GRID_HEIGHT}",
            self.images, self.available
        )
    }

    /// Identifies the map in rows, where a model has the digest of its file.
    #[must_use]
    pub fn digest(&self) -> String {
        let bytes: Vec<u8> = self
            .depth_m
            .data
            .iter()
            .flat_map(|value| value.to_le_bytes())
            .collect();
        files::blake3_hex(&bytes)
    }
}

/// The measured pixels of a depth map with the grid cell each falls into.
fn binned(depth: &Plane) -> Vec<(usize, f32)> {
    let mut found = Vec::new();
    for row in 0..depth.height {
        let cell_row = row * GRID_HEIGHT / depth.height;
        for (column, &depth_m) in depth.row(row).iter().enumerate() {
            if depth_m > 0.0 && depth_m.is_finite() {
                let cell_column = column * GRID_WIDTH / depth.width;
                found.push((cell_row * GRID_WIDTH + cell_column, depth_m));
            }
        }
    }
    found
}

/// The lower median: a depth that was measured, also for an even count.
fn median(mut values: Vec<f32>) -> Option<f32> {
    let middle = values.len().checked_sub(1)? / 2;
    let (_, median, _) = values.select_nth_unstable_by(middle, f32::total_cmp);
    Some(*median)
}

/// Fills empty cells from the nearest filled row of their column, then empty columns from the
/// nearest filled column; of two equally near ones the lower row and the left column.
///
/// Scans have no points above the horizon, so what is nearest there is the row below.
fn fill(cells: Vec<Option<f32>>, width: usize, height: usize) -> Option<Plane> {
    let nearest = |index: usize, count: usize, prefer_larger: bool, at: &dyn Fn(usize) -> bool| {
        (0..count).filter(|&other| at(other)).min_by_key(|&other| {
            let farther_side = (other < index) == prefer_larger;
            (index.abs_diff(other), farther_side)
        })
    };
    let column_of: Vec<Option<usize>> = (0..width)
        .map(|column| {
            nearest(column, width, false, &|other| {
                (0..height).any(|row| cells[row * width + other].is_some())
            })
        })
        .collect();
    let mut data = Vec::with_capacity(width * height);
    for row in 0..height {
        for source in &column_of {
            let column = (*source)?;
            let row = nearest(row, height, true, &|other| {
                cells[other * width + column].is_some()
            })?;
            data.push(cells[row * width + column]?);
        }
    }
    Some(Plane {
        width,
        height,
        data,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn empty_cells_take_the_nearest_row_then_column() {
        let none = None;
        // Column 0 is empty; column 1 is filled in rows 1 and 3; column 2 in row 0.
        let cells = vec![
            none,
            none,
            Some(7.0),
            none,
            Some(1.0),
            none,
            none,
            none,
            none,
            none,
            Some(3.0),
            none,
        ];
        let plane = fill(cells, 3, 4).unwrap();
        assert_eq!(
            plane.data,
            [
                1.0, 1.0, 7.0, // row 0
                1.0, 1.0, 7.0, // row 1
                3.0, 3.0, 7.0, // row 2: rows 1 and 3 are equally near, the lower one counts
                3.0, 3.0, 7.0, // row 3
            ]
        );
        assert_eq!(fill(vec![None; 4], 2, 2), None);
    }

    #[test]
    fn pixels_fall_into_their_cell() {
        let mut depth = Plane {
            width: 832,
            height: 256,
            data: vec![0.0; 832 * 256],
        };
        depth.data[0] = 5.0;
        depth.data[255 * 832 + 831] = 9.0;
        depth.data[3 * 832 + 5] = 2.0;
        assert_eq!(
            binned(&depth),
            [
                (0, 5.0),
                (GRID_WIDTH + 2, 2.0),
                (GRID_WIDTH * GRID_HEIGHT - 1, 9.0)
            ]
        );
    }

    #[test]
    fn the_median_is_a_measured_value() {
        assert_eq!(median(vec![]), None);
        assert_eq!(median(vec![3.0, 1.0, 2.0]), Some(2.0));
        assert_eq!(median(vec![4.0, 1.0, 2.0, 3.0]), Some(2.0));
    }
}
