//! PNG and JPEG pictures, 8-bit and 16-bit grey PNGs.
#![no_main]

mod damage;

use std::sync::LazyLock;

use image::RgbImage;
use libfuzzer_sys::fuzz_target;
use strat_store::image_files;

static VALID: LazyLock<[Vec<u8>; 4]> = LazyLock::new(|| {
    let picture = RgbImage::from_fn(19, 11, |x, y| {
        image::Rgb([(x * 13) as u8, (y * 20) as u8, 90])
    });
    let values: Vec<u16> = (0..12).map(|i| i * 5_001).collect();
    [
        image_files::encode_png_rgb(&picture),
        image_files::encode_jpeg_rgb(&picture, 90),
        image_files::encode_png_gray16(4, 3, &values),
        image_files::encode_png_gray8(2, 2, &[7, 26, 0, 23]),
    ]
});

fuzz_target!(|data: &[u8]| {
    let Some((which, data)) = data.split_first() else {
        return;
    };
    let bytes = damage::damaged(&VALID[usize::from(which % 4)], data);
    let _ = image_files::decode_rgb(&bytes, "x");
    if let Ok((width, height, values)) = image_files::decode_gray16(&bytes, "x") {
        assert_eq!(width * height, values.len());
    }
    if let Ok((width, height, values)) = image_files::decode_gray8(&bytes, "x") {
        assert_eq!(width * height, values.len());
    }
    let _ = image_files::decode_size(&bytes, "x");
});
