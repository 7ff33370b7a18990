//! Reading and writing of PNG and JPEG pictures.
//!
//! The format is told from the content, not from the name. A truncated file is an error even
//! where the decoder would fill the rest with grey.

use std::path::Path;

use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{DynamicImage, ExtendedColorType, ImageEncoder, ImageFormat, RgbImage};

use crate::error::{Error, Result};
use crate::files;

/// Reads a PNG or JPEG as 8-bit RGB.
///
/// # Errors
/// The file cannot be read, is truncated or is no image.
pub fn read_rgb(path: &Path) -> Result<RgbImage> {
    decode_rgb(&files::read(path)?, &path.display().to_string())
}

/// Decodes PNG or JPEG bytes as 8-bit RGB; `name` is used in messages.
///
/// # Errors
/// The bytes are truncated or no image.
pub fn decode_rgb(bytes: &[u8], name: &str) -> Result<RgbImage> {
    Ok(decode(bytes, name)?.into_rgb8())
}

/// Reads a single-channel 16-bit PNG, e.g. disparity times 256: width, height, values row by row.
///
/// # Errors
/// The file cannot be read, is truncated, no image, or of another pixel type.
pub fn read_gray16(path: &Path) -> Result<(usize, usize, Vec<u16>)> {
    match decode(&files::read(path)?, &path.display().to_string())? {
        DynamicImage::ImageLuma16(image) => Ok((
            image.width() as usize,
            image.height() as usize,
            image.into_raw(),
        )),
        other => Err(wrong_type(path, &other, "16-bit grey")),
    }
}

/// Reads a single-channel 8-bit PNG, e.g. label ids: width, height, values row by row.
///
/// # Errors
/// The file cannot be read, is truncated, no image, or of another pixel type.
pub fn read_gray8(path: &Path) -> Result<(usize, usize, Vec<u8>)> {
    match decode(&files::read(path)?, &path.display().to_string())? {
        DynamicImage::ImageLuma8(image) => Ok((
            image.width() as usize,
            image.height() as usize,
            image.into_raw(),
        )),
        other => Err(wrong_type(path, &other, "8-bit grey")),
    }
}

/// Width and height of a PNG or JPEG, from its first bytes alone.
///
/// # Errors
/// The file cannot be read or does not begin like an image.
pub fn read_size(path: &Path) -> Result<(u32, u32)> {
    let reader = image::ImageReader::open(path).and_then(image::ImageReader::with_guessed_format);
    reader
        .map_err(|e| Error::io("read", path, e))?
        .into_dimensions()
        .map_err(|error| Error::Image {
            path: path.display().to_string(),
            problem: format!("its size cannot be read ({error})"),
        })
}

/// PNG bytes of an RGB image, compressed fast rather than small.
pub fn encode_png_rgb(image: &RgbImage) -> Vec<u8> {
    encode_png(
        image.as_raw(),
        image.width(),
        image.height(),
        ExtendedColorType::Rgb8,
    )
}

/// PNG bytes of an 8-bit grey image.
///
/// # Panics
/// If `values` are not `width * height`.
pub fn encode_png_gray8(width: u32, height: u32, values: &[u8]) -> Vec<u8> {
    encode_png(values, width, height, ExtendedColorType::L8)
}

/// PNG bytes of a 16-bit grey image.
///
/// # Panics
/// If `values` are not `width * height`.
pub fn encode_png_gray16(width: u32, height: u32, values: &[u16]) -> Vec<u8> {
    // The encoder takes native byte order and writes big-endian.
    let bytes: Vec<u8> = values
        .iter()
        .flat_map(|value| value.to_ne_bytes())
        .collect();
    encode_png(&bytes, width, height, ExtendedColorType::L16)
}

/// JPEG bytes of an RGB image; `quality` from 1 to 100.
///
/// # Panics
/// If a side is longer than JPEG allows (65,535 pixels).
pub fn encode_jpeg_rgb(image: &RgbImage, quality: u8) -> Vec<u8> {
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, quality)
        .write_image(
            image.as_raw(),
            image.width(),
            image.height(),
            ExtendedColorType::Rgb8,
        )
        .expect("an RGB image within JPEG's size limits can be encoded into memory");
    bytes
}

fn encode_png(pixels: &[u8], width: u32, height: u32, color: ExtendedColorType) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(pixels.len() / 2);
    PngEncoder::new_with_quality(&mut bytes, CompressionType::Fast, FilterType::Adaptive)
        .write_image(pixels, width, height, color)
        .expect("pixels that fill the image can be encoded into memory");
    bytes
}

fn decode(bytes: &[u8], name: &str) -> Result<DynamicImage> {
    let bad = |problem: String| Error::Image {
        path: name.to_owned(),
        problem,
    };
    if bytes.is_empty() {
        return Err(bad("the file is empty".to_owned()));
    }
    let format = match image::guess_format(bytes) {
        Ok(format @ (ImageFormat::Png | ImageFormat::Jpeg)) => format,
        _ if bytes.starts_with(b"version https://git-lfs") => {
            return Err(bad(
                "it is a git-lfs pointer; fetch the file itself (`git lfs pull`)".to_owned(),
            ));
        }
        _ => return Err(bad("its content is neither PNG nor JPEG".to_owned())),
    };
    let whole = if format == ImageFormat::Png {
        png_is_whole(bytes)
    } else {
        jpeg_is_whole(bytes)
    };
    if !whole {
        return Err(bad(format!(
            "it is truncated (no end marker in its {} bytes)",
            bytes.len()
        )));
    }
    image::load_from_memory_with_format(bytes, format)
        .map_err(|error| bad(format!("it is damaged ({error})")))
}

/// Whether the end chunk is there.
fn png_is_whole(bytes: &[u8]) -> bool {
    const END: &[u8] = b"IEND\xae\x42\x60\x82";
    bytes
        .windows(END.len())
        .rposition(|window| window == END)
        .is_some()
}

/// Whether an end marker follows the last start of scan; neither can occur inside
/// entropy-coded data, and an embedded thumbnail lies before the scan.
fn jpeg_is_whole(bytes: &[u8]) -> bool {
    let last = |marker: [u8; 2]| bytes.windows(2).rposition(|pair| pair == marker);
    match (last([0xff, 0xda]), last([0xff, 0xd9])) {
        (Some(scan), Some(end)) => end > scan,
        _ => false,
    }
}

fn wrong_type(path: &Path, image: &DynamicImage, expected: &str) -> Error {
    Error::Image {
        path: path.display().to_string(),
        problem: format!(
            "it should be a {expected} PNG, but its pixels are {:?}",
            image.color()
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture() -> RgbImage {
        RgbImage::from_fn(61, 37, |x, y| {
            image::Rgb([(x * 4) as u8, (y * 6) as u8, ((x * y) % 251) as u8])
        })
    }

    #[test]
    fn png_keeps_every_bit() {
        let image = picture();
        assert_eq!(decode_rgb(&encode_png_rgb(&image), "x").unwrap(), image);

        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("d.png");
        let values: Vec<u16> = (0..12).map(|i| i * 5_001).collect();
        std::fs::write(&path, encode_png_gray16(4, 3, &values)).unwrap();
        assert_eq!(read_gray16(&path).unwrap(), (4, 3, values));
        let error = read_gray8(&path).unwrap_err().to_string();
        assert!(
            error.contains("d.png") && error.contains("8-bit grey") && error.contains("L16"),
            "{error}"
        );

        let labels = [7_u8, 26, 0, 23];
        std::fs::write(&path, encode_png_gray8(2, 2, &labels)).unwrap();
        assert_eq!(read_gray8(&path).unwrap(), (2, 2, labels.to_vec()));
        assert!(read_gray16(&path).is_err());
        assert_eq!(read_rgb(&path).unwrap().get_pixel(1, 0).0, [26; 3]);
        assert_eq!(read_size(&path).unwrap(), (2, 2));
        std::fs::write(&path, b"no image").unwrap();
        assert!(read_size(&path).unwrap_err().to_string().contains("d.png"));
    }

    #[test]
    fn jpeg_comes_back_alike() {
        let image = RgbImage::from_fn(64, 48, |x, y| image::Rgb([x as u8 * 3, y as u8 * 4, 90]));
        let back = decode_rgb(&encode_jpeg_rgb(&image, 95), "x").unwrap();
        let worst = image
            .as_raw()
            .iter()
            .zip(back.as_raw())
            .map(|(a, b)| a.abs_diff(*b))
            .max();
        assert!(worst.unwrap() <= 12, "{worst:?}");
    }

    #[test]
    fn truncated_files_are_called_truncated() {
        let image = picture();
        for bytes in [encode_png_rgb(&image), encode_jpeg_rgb(&image, 90)] {
            for cut in [40, bytes.len() / 2, bytes.len() - 2] {
                let error = decode_rgb(&bytes[..cut], "frame.png")
                    .unwrap_err()
                    .to_string();
                assert!(
                    error.starts_with("frame.png is not a usable image: it is truncated"),
                    "{cut}: {error}"
                );
            }
        }
    }

    #[test]
    fn what_is_no_image_is_refused() {
        for (bytes, word) in [
            (&b""[..], "empty"),
            (
                b"version https://git-lfs.github.com/spec/v1\noid sha256:0",
                "git-lfs",
            ),
            (b"<html>404</html>", "neither PNG nor JPEG"),
            (b"GIF89a..........", "neither PNG nor JPEG"),
        ] {
            let error = decode_rgb(bytes, "frame.png").unwrap_err().to_string();
            assert!(
                error.contains("frame.png") && error.contains(word),
                "{error}"
            );
        }
        let mut damaged = encode_png_rgb(&picture());
        damaged[60] ^= 0xff;
        assert!(decode_rgb(&damaged, "x").is_err());
        assert!(
            read_rgb(Path::new("/no/such/file.png"))
                .unwrap_err()
                .is_not_found()
        );
    }
}
