//! The images of a sample: at network size and, where it is kept, the original.

use std::ops::Range;

use image::{RgbImage, imageops};
use strat_store::image_files;
use strat_store::inputs::Kind;
use strat_store::layout::{self, Side};
use strat_store::resize;
use strat_store::set::FileRef;

use super::files::SetFiles;
use super::sample::{SampleError, SampleResult};
use crate::input::source::Source;

/// An image of the set, and the size in pixels of what it was made from, after cropping.
#[derive(Debug)]
pub struct Picture {
    /// At network size.
    pub small: FileRef,
    /// The original, if it is kept.
    pub full: Option<FileRef>,
    /// Width and height in pixels of the original.
    pub size: (u32, u32),
}

/// Which rows of an image of this width and height are used; an error says why it cannot be.
pub type Crop = fn((u32, u32)) -> Result<Range<u32>, String>;

impl SetFiles<'_> {
    /// An image at network size and, if `keep_full`, at its own: the file as it is, or what is left of
    /// it after cropping as PNG.
    ///
    /// # Errors
    /// The image cannot be used, or the set not be written.
    pub fn picture(
        &self,
        side: Side,
        id: &str,
        from: &Source,
        crop: Option<Crop>,
        keep_full: bool,
    ) -> SampleResult<Picture> {
        let input = |problem: strat_store::Error| SampleError::input(from, problem);
        let rows = |size: (u32, u32)| match crop {
            Some(crop) => crop(size).map_err(|problem| SampleError::about(from, problem)),
            None => Ok(0..size.1),
        };
        let settings = self.settings;
        let small = layout::image(settings.content, side, id, settings.codec.extension());
        let full = keep_full.then(|| {
            let extension = match crop {
                None => from.extension(),
                Some(_) => "png".to_owned(),
            };
            layout::full_image(settings.content, side, id, &extension)
        });
        let changed = from.changed();
        let kept_small = self.kept(&small, changed)?;
        let kept_full = match &full {
            Some(path) => self.kept(path, changed)?,
            None => None,
        };
        if let Some(small) = &kept_small
            && kept_full.is_some() == full.is_some()
        {
            let size = from.image_size().map_err(input)?;
            let rows = rows(size)?;
            return Ok(Picture {
                small: small.clone(),
                full: kept_full,
                size: (size.0, rows.end - rows.start),
            });
        }
        let bytes = from.read(Kind::Image).map_err(input)?;
        let mut image = image_files::decode_rgb(&bytes, &from.to_string()).map_err(input)?;
        if crop.is_some() {
            image = crop_rows(&image, rows(image.dimensions())?);
        }
        let small = match kept_small {
            Some(small) => small,
            None => {
                let (width, height) = (settings.image_width, settings.image_height);
                let resized = resize::rgb(&image, width, height, settings.kernel);
                self.put(small, &settings.codec.encode(&resized))?
            }
        };
        let full = match (kept_full, full) {
            (None, Some(path)) if crop.is_some() => {
                Some(self.put(path, &image_files::encode_png_rgb(&image))?)
            }
            (None, Some(path)) => Some(self.put(path, &bytes)?),
            (kept, _) => kept,
        };
        Ok(Picture {
            small,
            full,
            size: image.dimensions(),
        })
    }
}

fn crop_rows(image: &RgbImage, rows: Range<u32>) -> RgbImage {
    let height = rows.end.saturating_sub(rows.start);
    imageops::crop_imm(image, 0, rows.start, image.width(), height).to_image()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_cut_out() {
        let image = RgbImage::from_fn(3, 10, |x, y| image::Rgb([x as u8, y as u8, 7]));
        let cut = crop_rows(&image, 2..5);
        assert_eq!(cut.dimensions(), (3, 3));
        assert_eq!(cut.get_pixel(1, 0).0, [1, 2, 7]);
        assert_eq!(cut.get_pixel(2, 2).0, [2, 4, 7]);
    }
}
