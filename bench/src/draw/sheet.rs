//! Pictures of one size with captions, in rows, and the scales of their colours, each once.

use base64::{Engine as _, engine::general_purpose::STANDARD};
use image::RgbImage;
use maud::html;
use strat_store::{
    image_files,
    resize::{self, Kernel},
};

use super::{legend::Key, svg::document};

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
    /// The scale of its colours, below the caption.
    key: Option<Key>,
}

impl Tile {
    /// With the scale of the colours of its row.
    #[must_use]
    pub fn with_key(self, key: Key) -> Self {
        Self {
            key: Some(key),
            ..self
        }
    }

    /// A drawn picture as it is, without loss.
    #[must_use]
    pub fn drawn(picture: &RgbImage, caption: String) -> Self {
        Self {
            caption,
            data: image_files::encode_png_rgb(picture),
            format: "png",
            size: picture.dimensions(),
            key: None,
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
            key: None,
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
    /// Below all, the scales that hold for the whole sheet.
    pub keys: Vec<Key>,
}

impl Sheet {
    /// The sheet as SVG, its pictures within.
    #[must_use]
    pub fn svg(&self) -> String {
        const GAP: u32 = 10;
        const MARGIN: u32 = 16;
        const CAPTION: u32 = 28;
        let (mut top, mut widest) = (58, 520);
        let mut keys: Vec<(u32, u32, u32, &Key)> = Vec::new();
        let mut placed = Vec::new();
        for row in &self.rows {
            let (mut left, mut tallest) = (MARGIN, 0);
            for tile in row {
                placed.push((left, top, tile));
                if let Some(key) = &tile.key {
                    keys.push((left, top + tile.size.1 + CAPTION - 8, tile.size.0, key));
                }
                left += tile.size.0 + GAP;
                tallest = tallest.max(tile.size.1);
            }
            widest = widest.max(left - GAP + MARGIN);
            let has_key = row.iter().any(|tile| tile.key.is_some());
            top += tallest + CAPTION + if has_key { Key::HEIGHT } else { 0 };
        }
        let width = (widest - 2 * MARGIN).min(460);
        for key in &self.keys {
            keys.push((MARGIN, top, width, key));
            top += Key::HEIGHT + GAP;
        }
        let body = html! {
            @for (left, top, tile) in placed {
                image x=(left) y=(top) width=(tile.size.0) height=(tile.size.1)
                    href=(data_address(tile.format, &tile.data)) {}
                text x=(left) y=(top + tile.size.1 + 14) font-size="11" fill="#222222" { (tile.caption) }
            }
            @for (left, top, width, key) in keys { (key.svg(left, top, width)) }
        };
        let size = (f64::from(widest), f64::from(top));
        document(size, &self.title, &self.note, &body)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::{
        colour::cividis,
        legend::{Scale, ScaleUnit},
        png::png,
    };
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
            rows: vec![
                vec![tile([250, 0, 0]), tile([0, 250, 0])],
                vec![tile([0, 0, 250])],
            ],
            ..Sheet::default()
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

    /// The colours of a scale, from its dark end to its bright one, below the tiles or below its own.
    #[test]
    fn scales_stand_below_their_pictures() {
        let tile = || Tile::drawn(&RgbImage::from_pixel(100, 20, Rgb([9; 3])), "a".to_owned());
        let key = Key {
            words: "error".to_owned(),
            scale: Scale {
                unit: Some(ScaleUnit::AndMore),
                brightest: 0.5,
            },
            colour: cividis,
        };
        let sheet = Sheet {
            rows: vec![vec![tile(), tile().with_key(key.clone())], vec![tile()]],
            keys: vec![key],
            ..Sheet::default()
        };
        let svg = sheet.svg();
        for (text, count) in [(">error<", 2), (">0.5+<", 2), (">0.25<", 2)] {
            assert_eq!(svg.matches(text).count(), count, "{text}");
        }
        let drawn = image::load_from_memory(&png(&svg, 1.0).unwrap())
            .unwrap()
            .to_rgb8();
        let row = 20 + 28;
        assert_eq!(drawn.height(), 58 + 2 * row + 2 * Key::HEIGHT + 10);
        let own = 58 + row - 8 + Key::STRIP / 2;
        let last = 58 + 2 * row + Key::HEIGHT + Key::STRIP / 2;
        for (x, y, share) in [
            (126, own, 0.0),
            (225, own, 1.0),
            (16, last, 0.0),
            (475, last, 1.0),
        ] {
            assert_eq!(*drawn.get_pixel(x, y), cividis(share), "{x} {y}");
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
