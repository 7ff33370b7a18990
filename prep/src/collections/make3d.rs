//! Make3D's test images as a prepared set (PROTOCOL 1.4).
//!
//! The pictures stand upright, 2272 rows of 1704 pixels; the usual crop to 2:1 keeps rows 710 to
//! 1561 and, of the laser grid of 55 x 305, rows 17 to 37 with all columns. Focal length and
//! baseline are not known, so these images test a model and cannot train one.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};

use strat_splits::Role;
use strat_store::exr::DepthHeader;
use strat_store::inputs::Kind;
use strat_store::layout::{self, DepthKind, Side};
use strat_store::raster::Plane;
use strat_store::set::{Content, Sample, check_id};

use super::{Frames, build, measured};
use crate::error::{Error, Result};
use crate::input::mat::{self, Matrix};
use crate::input::source::Source;
use crate::set::files::SetFiles;
use crate::set::results::Failure;
use crate::set::sample::{BadInput, Frame, SampleError, SampleResult};
use crate::set::writer::{Report, SetOptions};

/// Width and height in pixels of the test images.
pub const IMAGE: (u32, u32) = (1704, 2272);
/// Image rows kept.
pub const IMAGE_ROWS: Range<u32> = 710..1562;
/// Rows, columns and channels of a laser grid; the fourth channel is depth in metres.
pub const GRID: [usize; 3] = [55, 305, 4];
/// Grid rows kept.
pub const GRID_ROWS: Range<usize> = 17..38;
/// Images of the published test set.
pub const TEST_IMAGES: u64 = strat_splits::MAKE3D_TEST_IMAGES as u64;

const VARIABLE: &str = "Position3DGrid";

/// The image of a frame and its laser grid.
struct Files {
    image: Source,
    grid: Source,
}

/// Makes the set of the images `img-*.jpg` in a folder and the grids `depth_sph_corr-*.mat` in another.
///
/// # Errors
/// The folders hold no such files, or the set cannot be written.
pub fn prepare(images: &Path, grids: &Path, options: &SetOptions) -> Result<Report> {
    let frames = look_through(images, grids)?;
    build(Content::Make3d, options, &[images, grids], frames, make)
}

fn look_through(image_folder: &Path, grid_folder: &Path) -> Result<Frames<Files>> {
    let images = stems("--images", image_folder, "img-", ".jpg")?;
    let grids = stems("--depth", grid_folder, "depth_sph_corr-", ".mat")?;
    let mut failures = Vec::new();
    let mut frames = Vec::new();
    // The archive of grids holds those of other pictures too.
    for (stem, image) in images {
        let (role, id) = (Role::Test, format!("make3d/{stem}"));
        let image = Source::File(image);
        match grids.get(&stem) {
            Some(grid) => frames.push(Frame {
                role,
                id,
                input: Files {
                    image,
                    grid: Source::File(grid.clone()),
                },
            }),
            None => {
                let bad = BadInput {
                    problem: format!(
                        "{image} has no laser grid depth_sph_corr-{stem}.mat in {}",
                        grid_folder.display()
                    ),
                    file: image.to_string(),
                };
                failures.push(Failure::of_sample(role, &id, bad));
            }
        }
    }
    if frames.is_empty() {
        return Err(Error::Incomplete(format!(
            "no image img-<name>.jpg in {} has its grid depth_sph_corr-<name>.mat in {}; nothing was written",
            image_folder.display(),
            grid_folder.display()
        )));
    }
    Ok(Frames {
        frames,
        failures,
        expected: BTreeMap::from([(Role::Test, TEST_IMAGES)]),
    })
}

/// The files `<before><stem><after>` of a folder, by stem.
fn stems(
    option: &'static str,
    folder: &Path,
    before: &str,
    after: &str,
) -> Result<BTreeMap<String, PathBuf>> {
    let wrong = |problem: String| Error::Input {
        option,
        path: folder.to_owned(),
        problem,
    };
    let entries =
        std::fs::read_dir(folder).map_err(|e| wrong(format!("cannot read this folder: {e}")))?;
    let mut found = BTreeMap::new();
    for entry in entries {
        let entry = entry.map_err(|e| wrong(format!("cannot read this folder: {e}")))?;
        let name = entry.file_name();
        let stem = name
            .to_str()
            .and_then(|name| name.strip_prefix(before)?.strip_suffix(after));
        if let Some(stem) = stem.filter(|stem| check_id(stem).is_ok()) {
            found.insert(stem.to_owned(), entry.path());
        }
    }
    if found.is_empty() {
        return Err(wrong(format!(
            "no files `{before}*{after}` are in this folder; give the one into which Make3D's archive was unpacked"
        )));
    }
    Ok(found)
}

fn make(files: &SetFiles<'_>, frame: &Frame<Files>) -> SampleResult<Sample> {
    let Files { image, grid } = &frame.input;
    let picture = files.picture(Side::Left, &frame.id, image, Some(rows), true)?;
    let path = layout::depth(DepthKind::Laser, &frame.id);
    let depth = match files.kept(&path, grid.changed())? {
        Some(kept) => kept,
        None => {
            let bytes = grid
                .read(Kind::Matlab)
                .map_err(|e| SampleError::input(grid, e))?;
            let depth_m = mat::read(&bytes, VARIABLE)
                .and_then(|grid| depth(&grid))
                .map_err(|problem| SampleError::about(grid, problem))?;
            let header = DepthHeader {
                source: "make3d/Gridlaserdata".to_owned(),
                axis: "laser".to_owned(),
                focal_px: 0.0,
                baseline_m: 0.0,
                frame: frame.id.clone(),
            };
            files.put_depth(path, &depth_m, &header)?
        }
    };
    Ok(Sample {
        left_full: picture.full,
        depth_laser: Some(depth),
        ..Sample::new(&frame.id, picture.size, 0.0, 0.0, picture.small)
    })
}

fn rows((width, height): (u32, u32)) -> std::result::Result<Range<u32>, String> {
    if (width, height) == IMAGE {
        return Ok(IMAGE_ROWS);
    }
    let (w, h) = IMAGE;
    Err(format!(
        "it is {width}x{height}, but the test images of Make3D are {w}x{h}"
    ))
}

/// The kept rows of the depth channel, 305 x 21 metres; 0 where nothing was measured.
///
/// # Errors
/// The grid has another shape or no depth.
pub fn depth(grid: &Matrix) -> std::result::Result<Plane, String> {
    if grid.dims != GRID {
        return Err(format!(
            "its {VARIABLE} has the shape {:?}, which should be {GRID:?}",
            grid.dims
        ));
    }
    let [rows, columns, _] = GRID;
    let at = |row, column| grid.values[row + rows * column + 3 * rows * columns];
    let data: Vec<f32> = GRID_ROWS
        .flat_map(|row| (0..columns).map(move |column| (row, column)))
        .map(|(row, column)| measured(at(row, column)))
        .collect();
    if data.iter().all(|depth_m| *depth_m == 0.0) {
        return Err("no pixel of the grid was measured".to_owned());
    }
    Ok(Plane {
        width: columns,
        height: GRID_ROWS.len(),
        data,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_fourth_channel_is_cut_to_its_middle_rows() {
        let [rows, columns, channels] = GRID;
        let mut values = vec![0.0; rows * columns * channels];
        for row in 0..rows {
            for column in 0..columns {
                values[row + rows * column + 3 * rows * columns] =
                    row as f64 * 1000.0 + column as f64;
                values[row + rows * column + 2 * rows * columns] = 7.0;
            }
        }
        let grid = Matrix {
            dims: GRID.to_vec(),
            values,
        };
        let plane = depth(&grid).unwrap();
        assert_eq!((plane.width, plane.height), (305, 21));
        assert_eq!(plane.row(0)[..2], [17_000.0, 17_001.0]);
        assert_eq!(plane.row(20)[304], 37_304.0);
    }

    #[test]
    fn other_grids_are_refused() {
        let grid = |dims: Vec<usize>| Matrix {
            values: vec![0.0; dims.iter().product()],
            dims,
        };
        assert!(
            depth(&grid(vec![305, 55, 4]))
                .unwrap_err()
                .contains("[305, 55, 4]")
        );
        assert!(
            depth(&grid(GRID.to_vec()))
                .unwrap_err()
                .contains("no pixel")
        );
    }

    #[test]
    fn the_crop_is_two_to_one() {
        assert_eq!(IMAGE_ROWS.len() * 2, IMAGE.0 as usize);
        assert_eq!(rows(IMAGE), Ok(IMAGE_ROWS));
        assert!(rows((2272, 1704)).unwrap_err().contains("2272x1704"));
    }
}
