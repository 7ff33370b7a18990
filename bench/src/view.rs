//! What of an image a model is shown: all of it, or KITTI's benchmark crop (PROTOCOL 10.2).
//!
//! A map of the crop goes back to its place in a map of the whole image. Not here: which pixels are
//! scored, which is the protocol's business in [`strat_metrics`].

use image::RgbImage;
use serde::{Deserialize, Serialize};
use strat_metrics::{BenchmarkCrop, CropBox, Protocol, benchmark_box};
use strat_store::raster::Plane;

/// An image that the crop cannot be cut out of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "KITTI's benchmark crop is 1216x352 of an untouched image, and this one is {width}x{height}"
)]
pub struct NoCrop {
    /// Columns of the image.
    pub width: usize,
    /// Rows of the image.
    pub height: usize,
}

/// What a map shows, as descriptions say it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum View {
    /// The whole image.
    #[default]
    #[serde(rename = "none")]
    Whole,
    /// KITTI's benchmark crop: 352 rows and 1216 columns, bottom and middle.
    KittiBenchmark,
}

impl View {
    /// What models are shown under a protocol.
    #[must_use]
    pub fn under(protocol: &Protocol) -> Self {
        match protocol.benchmark_crop {
            BenchmarkCrop::None => Self::Whole,
            BenchmarkCrop::Image | BenchmarkCrop::ImageAndTruth => Self::KittiBenchmark,
        }
    }

    /// The part of an image of this size, columns and rows, that is seen.
    ///
    /// # Errors
    /// The image is smaller than the crop.
    pub fn part(self, (width, height): (usize, usize)) -> Result<CropBox, NoCrop> {
        match self {
            Self::Whole => Ok(CropBox {
                top: 0,
                bottom: height,
                left: 0,
                right: width,
            }),
            Self::KittiBenchmark => benchmark_box(width, height).ok_or(NoCrop { width, height }),
        }
    }

    /// Columns and rows of what is seen of an image of this size.
    ///
    /// # Errors
    /// The image is smaller than the crop.
    pub fn size(self, image: (usize, usize)) -> Result<(usize, usize), NoCrop> {
        Ok(self.part(image)?.size())
    }

    /// Cuts an image.
    ///
    /// # Errors
    /// The image is smaller than the crop, or has another size than `of`, that of the untouched one.
    pub fn cut(self, image: &RgbImage, of: (u32, u32)) -> Result<RgbImage, NoCrop> {
        let (width, height) = (image.width() as usize, image.height() as usize);
        match (self, benchmark_box(width, height)) {
            (Self::Whole, _) => Ok(image.clone()),
            (Self::KittiBenchmark, Some(cut)) if image.dimensions() == of => {
                let (columns, rows) = cut.size();
                let (left, top) = (cut.left as u32, cut.top as u32);
                let view = image::imageops::crop_imm(image, left, top, columns as u32, rows as u32);
                Ok(view.to_image())
            }
            (Self::KittiBenchmark, _) => Err(NoCrop { width, height }),
        }
    }

    /// Puts a map of what is seen into one of an image of this size, where 0 stands for nothing.
    ///
    /// # Errors
    /// The image is smaller than the crop.
    pub fn placed(self, map: Plane, (width, height): (usize, usize)) -> Result<Plane, NoCrop> {
        let cut = self.part((width, height))?;
        if self == Self::Whole {
            return Ok(map);
        }
        let mut whole = Plane::filled(width, height, 0.0);
        for (row, values) in (cut.top..cut.bottom).zip(map.data.chunks_exact(map.width)) {
            let start = row * width;
            whole.data[start + cut.left..start + cut.right].copy_from_slice(values);
        }
        Ok(whole)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The first pixel of the crop of 1242 x 375 is row 23, column 13 (PROTOCOL 10.2).
    #[test]
    fn a_map_of_the_crop_goes_to_its_place() {
        let data: Vec<f32> = (0..1216 * 352).map(|i| 1.0 + i as f32).collect();
        let map = Plane {
            width: 1216,
            height: 352,
            data,
        };
        let whole = View::KittiBenchmark
            .placed(map.clone(), (1242, 375))
            .unwrap();
        assert_eq!((whole.width, whole.height), (1242, 375));
        assert_eq!(whole.data[23 * 1242 + 13], 1.0);
        assert_eq!(whole.data[24 * 1242 + 13], 1217.0);
        assert_eq!(whole.data[374 * 1242 + 1228], map.data[1216 * 352 - 1]);
        assert_eq!(
            whole.data.iter().filter(|v| **v == 0.0).count(),
            1242 * 375 - 1216 * 352
        );
        assert_eq!(View::Whole.placed(map.clone(), (1216, 352)).unwrap(), map);
        assert!(View::KittiBenchmark.placed(map, (1215, 375)).is_err());
    }

    #[test]
    fn an_image_is_cut_where_its_map_goes() {
        let image = RgbImage::from_fn(1242, 375, |x, y| {
            image::Rgb([(x % 256) as u8, (x / 256) as u8, (y % 256) as u8])
        });
        let cut = View::KittiBenchmark.cut(&image, (1242, 375)).unwrap();
        assert_eq!(cut.dimensions(), (1216, 352));
        assert_eq!(cut.get_pixel(0, 0), image.get_pixel(13, 23));
        assert_eq!(cut.get_pixel(1215, 351), image.get_pixel(1228, 374));
        // What was shrunk already has no such crop.
        assert!(View::KittiBenchmark.cut(&image, (1300, 400)).is_err());
        let small = RgbImage::new(640, 192);
        let error = View::KittiBenchmark.cut(&small, (640, 192)).unwrap_err();
        assert!(error.to_string().contains("640x192"), "{error}");
    }
}
