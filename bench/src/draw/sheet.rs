//! Pictures with captions, in rows.

use base64::{Engine as _, engine::general_purpose::STANDARD};
use image::RgbImage;
use maud::html;
use strat_store::{
    image_files,
    resize::{self, Kernel},
};

use super::svg::document;

/// A picture within a sheet.
#[derive(Clone, Debug)]
pub struct Tile {
    /// Below it.
    pub caption: String,
    /// An encoded picture.
    data: Vec<u8>,
    /// What it is encoded as: `png` or `jpeg`.
    format: &'static str,
    /// Its size in pixels.
    size: (u32, u32),
}

impl Tile {
    /// A drawn picture as it is, without loss.
    #[must_use]
    pub fn drawn(picture: &RgbImage, caption: String) -> Self {
        Self {
            caption,
            data: image_files::encode_png_rgb(picture),
            format: "png",
            size: picture.dimensions(),
        }
    }

    /// The encoded picture.
    #[cfg(test)]
    pub(super) fn data(&self) -> &[u8] {
        &self.data
    }

    /// A photograph of this size, as JPEG.
    #[must_use]
    pub fn photograph(
        picture: &RgbImage,
        (width, height): (u32, u32),
        quality: u8,
        caption: String,
    ) -> Self {
        let small = resize::rgb(picture, width, height, Kernel::Area);
        Self {
            caption,
            data: image_files::encode_jpeg_rgb(&small, quality),
            format: "jpeg",
            size: (width, height),
        }
    }
}

/// The size of a picture that is shown at most `widest` pixels wide.
#[must_use]
pub fn tile_size(width: u32, height: u32, widest: u32) -> (u32, u32) {
    let narrow = widest.min(width);
    (narrow, (height * narrow).div_ceil(width.max(1)).max(1))
}

/// An encoded picture as a `data:` address.
#[must_use]
pub fn data_address(format: &str, data: &[u8]) -> String {
    format!("data:image/{format};base64,{}", STANDARD.encode(data))
}

/// Pictures in rows.
#[derive(Clone, Debug, Default)]
pub struct Sheet {
    /// Above all.
    pub title: String,
    /// A sentence below the title.
    pub note: String,
    /// The pictures.
    pub rows: Vec<Vec<Tile>>,
}

impl Sheet {
    /// The sheet as SVG, its pictures within.
    #[must_use]
    pub fn svg(&self) -> String {
        const GAP: u32 = 10;
        const MARGIN: u32 = 16;
        let (mut top, mut widest) = (58, 520);
        let mut placed = Vec::new();
        for row in &self.rows {
            let (mut left, mut tallest) = (MARGIN, 0);
            for tile in row {
                placed.push((left, top, tile));
                left += tile.size.0 + GAP;
                tallest = tallest.max(tile.size.1);
            }
            widest = widest.max(left - GAP + MARGIN);
            top += tallest + 28;
        }
        let body = html! {
            @for (left, top, tile) in placed {
                image x=(left) y=(top) width=(tile.size.0) height=(tile.size.1)
                    href=(data_address(tile.format, &tile.data)) {}
                text x=(left) y=(top + tile.size.1 + 14) font-size="11" fill="#222222" { (tile.caption) }
            }
        };
        let size = (f64::from(widest), f64::from(top));
        document(size, &self.title, &self.note, &body)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::png::png;
    use image::Rgb;

    /// Two tiles beside each other and one below: each colour is found where its tile was put.
    #[test]
    fn tiles_stand_in_rows() {
        let tile = |colour: [u8; 3]| {
            Tile::drawn(
                &RgbImage::from_pixel(40, 20, Rgb(colour)),
                "a & b".to_owned(),
            )
        };
        let sheet = Sheet {
            title: "t".to_owned(),
            note: String::new(),
            rows: vec![
                vec![tile([250, 0, 0]), tile([0, 250, 0])],
                vec![tile([0, 0, 250])],
            ],
        };
        let svg = sheet.svg();
        assert_eq!(svg.matches("a &amp; b").count(), 3);
        let drawn = image::load_from_memory(&png(&svg, 1.0).unwrap())
            .unwrap()
            .to_rgb8();
        assert_eq!(drawn.dimensions(), (520, 58 + 2 * 48));
        for (x, y, colour) in [
            (17, 59, [250, 0, 0]),
            (55, 77, [250, 0, 0]),
            (67, 59, [0, 250, 0]),
            (17, 107, [0, 0, 250]),
            (60, 59, [255; 3]),
        ] {
            assert_eq!(drawn.get_pixel(x, y).0, colour, "{x} {y}");
        }
    }

    #[test]
    fn addresses_are_base64_of_the_standard() {
        assert_eq!(
            data_address("png", b"foob"),
            "data:image/png;base64,Zm9vYg=="
        );
    }

    #[test]
    fn tiles_keep_their_aspect() {
        assert_eq!(tile_size(1242, 375, 460), (460, 139));
        assert_eq!(tile_size(100, 50, 460), (100, 50));
        assert_eq!(tile_size(4000, 1, 460), (460, 1));
    }
}
