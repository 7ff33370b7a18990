//! The camera of maps as ROS' `camera_info` YAML, which other programs read beside depth pictures.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use strat_store::files;

use super::jobs::ImageJob;

/// Writes `camera_info.yaml` into a folder, or `camera_info-WIDTHxHEIGHT.yaml` for each size where maps have
/// several. `focal_px` is that of the images' own width. The principal point is taken to be the centre, and
/// the images to be rectified.
///
/// # Errors
/// A file cannot be written.
pub fn write_camera_info(
    out: &Path,
    jobs: &[ImageJob],
    focal_px: f64,
) -> Result<Vec<PathBuf>, strat_store::Error> {
    let sizes = jobs
        .iter()
        .filter_map(|job| image::image_dimensions(&job.image).ok());
    let sizes: BTreeSet<(u32, u32)> = sizes.collect();
    let mut written = Vec::new();
    for &(width, height) in &sizes {
        let path = out.join(match sizes.len() {
            1 => "camera_info.yaml".to_owned(),
            _ => format!("camera_info-{width}x{height}.yaml"),
        });
        files::write_atomic(&path, text(width, height, focal_px).as_bytes())?;
        written.push(path);
    }
    Ok(written)
}

fn text(width: u32, height: u32, focal_px: f64) -> String {
    let f = focal_px;
    let (cx, cy) = (f64::from(width - 1) / 2.0, f64::from(height - 1) / 2.0);
    format!(
        "image_width: {width}\nimage_height: {height}\ncamera_name: camera\n\
         camera_matrix:\n  rows: 3\n  cols: 3\n  data: [{f}, 0, {cx}, 0, {f}, {cy}, 0, 0, 1]\n\
         distortion_model: plumb_bob\n\
         distortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [0, 0, 0, 0, 0]\n\
         rectification_matrix:\n  rows: 3\n  cols: 3\n  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]\n\
         projection_matrix:\n  rows: 3\n  cols: 4\n  data: [{f}, 0, {cx}, 0, 0, {f}, {cy}, 0, 0, 0, 1, 0]\n"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_camera_is_that_of_the_maps() {
        let own = text(101, 51, 70.0);
        assert!(
            own.contains("data: [70, 0, 50, 0, 70, 25, 0, 0, 1]"),
            "{own}"
        );
    }
}
