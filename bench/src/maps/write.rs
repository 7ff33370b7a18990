//! The files of one image: everything is encoded before the first of them appears.

use std::path::{Path, PathBuf};

use strat_store::{
    exr::{self, DepthHeader},
    files, image_files, npy,
    raster::Plane,
    resize,
};

use super::{
    cloud,
    jobs::{ImageJob, output_name},
    request::{Format, Request, Target},
};
use crate::{
    draw::{
        colour::brightest_of,
        legend::{self, Scale, ScaleUnit, coloured},
    },
    model::ModelError,
    quantity::{self, Quantity},
};

/// Why one image has no map.
#[derive(Debug, thiserror::Error)]
pub enum MapError {
    /// A file could not be read or written.
    #[error(transparent)]
    Store(#[from] strat_store::Error),
    /// The model failed.
    #[error(transparent)]
    Model(#[from] ModelError),
}

/// Turns predictions into files.
pub struct Writer<'a> {
    /// What maps are to be.
    pub request: &'a Request,
    /// What each format holds.
    pub targets: &'a [Target],
    /// Folder for the results.
    pub out: &'a Path,
    /// Depth has a scale.
    pub in_metres: bool,
    /// Who predicted, for headers.
    pub source: String,
}

impl Writer<'_> {
    /// Splits images into the files of those that are done and those that are left: without all of their
    /// files, or changed since. With `begun`, a file must also be newer than the run which that marks.
    #[must_use]
    pub fn split(&self, begun: Option<&Path>, jobs: &[ImageJob]) -> (Vec<PathBuf>, Vec<ImageJob>) {
        let changed = |path: &Path| path.metadata().and_then(|found| found.modified()).ok();
        let (mut done, mut left) = (Vec::new(), Vec::new());
        for job in jobs {
            let newest = changed(&job.image).max(begun.and_then(changed));
            let suffixes = self.targets.iter().flat_map(|target| target.suffixes());
            let paths = suffixes.map(|suffix| self.out.join(output_name(&job.name, suffix)));
            let paths: Vec<PathBuf> = paths.collect();
            if paths.iter().all(|path| changed(path) > newest) {
                done.extend(paths);
            } else {
                left.push(job.clone());
            }
        }
        (done, left)
    }

    /// Writes all formats of one image, or none. Returns the files, and how many values did not
    /// fit into 16 bits.
    pub(super) fn write(
        &self,
        job: &ImageJob,
        plane: &Plane,
        size: (u32, u32),
    ) -> Result<(Vec<PathBuf>, usize), MapError> {
        let resized = if self.request.network_size {
            plane.clone()
        } else {
            resize::bilinear_f32(plane, size.0 as usize, size.1 as usize)
        };
        let mut too_large = 0;
        let mut encoded: Vec<(PathBuf, Vec<u8>)> = Vec::new();
        for target in self.targets {
            let map = target.conversion.apply(resized.clone(), size.0);
            let contents: Vec<Vec<u8>> = match target.format {
                Format::Exr => vec![exr::encode_depth(&map, &self.header(job, &map, size.0))?],
                Format::Npy => vec![npy::encode(map.width, map.height, &map.data)],
                Format::Png16 => {
                    let (bytes, clipped) = quantity::encode_png16(&map, self.request.png_scale);
                    too_large += clipped;
                    vec![bytes]
                }
                Format::Color => {
                    let scale = self.scale(&map, target.conversion.quantity);
                    let pictures = [coloured(&map, scale), legend::uncaptioned(&map, scale)];
                    pictures.iter().map(image_files::encode_png_rgb).collect()
                }
                Format::Ply => {
                    let image = image_files::read_rgb(&job.image)?;
                    let focal =
                        self.request.focal_px.unwrap_or_default() / f64::from(image.width());
                    let to = self.request.cloud_to_m;
                    vec![cloud::encode(&map, &image, focal, to, &self.source)]
                }
            };
            let paths = target.suffixes().iter();
            let paths = paths.map(|suffix| self.out.join(output_name(&job.name, suffix)));
            encoded.extend(paths.zip(contents));
        }
        for (path, bytes) in &encoded {
            files::write_atomic(path, bytes)?;
        }
        Ok((
            encoded.into_iter().map(|(path, _)| path).collect(),
            too_large,
        ))
    }

    /// Names the camera of the map, which is not the image's where the sizes differ; 0 is not known.
    fn header(&self, job: &ImageJob, map: &Plane, image_width: u32) -> DepthHeader {
        DepthHeader {
            source: self.source.clone(),
            axis: "camera-z".to_owned(),
            focal_px: self.request.camera.map_or(0.0, |camera| {
                camera.focal_px * map.width as f64 / f64::from(image_width)
            }),
            baseline_m: self.request.camera.map_or(0.0, |camera| camera.baseline_m),
            frame: job.name.display().to_string(),
        }
    }

    fn scale(&self, map: &Plane, quantity: Quantity) -> Scale {
        Scale {
            unit: match quantity {
                Quantity::InverseDepth if self.in_metres => Some(ScaleUnit::Metres),
                Quantity::DisparityPx => Some(ScaleUnit::Pixels),
                _ => None,
            },
            brightest: self
                .request
                .nearest_m
                .map_or_else(|| brightest_of(map), |nearest| (1.0 / nearest) as f32),
        }
    }
}
