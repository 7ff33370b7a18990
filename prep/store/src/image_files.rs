//! Reading and writing of PNG and JPEG pictures.
//!
//! The format is told from the content, not from the name. A truncated file is an error even
//! where the decoder would fill the rest with grey. Pictures are turned as their EXIF data says, as
//! viewers and OpenCV show them; cameras and phones store portraits lying on their side.

use std::fmt;
use std::io::{BufRead, BufReader, Cursor, Seek};
use std::path::Path;
use std::str::FromStr;

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::metadata::Orientation;
use image::{
    DynamicImage, ExtendedColorType, ImageDecoder, ImageEncoder, ImageError, ImageFormat, RgbImage,
};
use jpeg_encoder::{ColorType, Encoder, SamplingFactor};

use crate::error::{Error, Result};
use crate::guard::guarded;
use crate::inputs::{self, Kind, MAX_PIXELS};

/// What decodes pictures, in sentences.
const DECODER: &str = "the image decoder";

/// Quality of JPEG where none is asked for.
pub const DEFAULT_QUALITY: u8 = 92;

/// How network-size images are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Codec {
    /// Without loss.
    Png,
    /// JPEG with 4:2:0 colour at a quality from 1 to 100.
    Jpeg(u8),
}

impl Codec {
    /// Extension of file names.
    pub fn extension(self) -> &'static str {
        match self {
            Self::Png => "png",
            Self::Jpeg(_) => "jpg",
        }
    }

    /// The bytes of a file.
    ///
    /// # Panics
    /// If a side is longer than JPEG allows (65,535 pixels).
    pub fn encode(self, image: &RgbImage) -> Vec<u8> {
        match self {
            Self::Png => encode_png_rgb(image),
            Self::Jpeg(quality) => encode_jpeg_rgb(image, quality),
        }
    }
}

impl fmt::Display for Codec {
    /// `png` or `jpeg-92`, as in manifests.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Png => f.pad("png"),
            Self::Jpeg(quality) => write!(f, "jpeg-{quality}"),
        }
    }
}

impl FromStr for Codec {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        if text == "png" {
            return Ok(Self::Png);
        }
        let quality = text.strip_prefix("jpeg-").and_then(|q| q.parse().ok());
        match quality.filter(|quality| (1..=100).contains(quality)) {
            Some(quality) => Ok(Self::Jpeg(quality)),
            None => Err(format!(
                "`{text}` is not a codec; the codecs are png and jpeg-1 to jpeg-100"
            )),
        }
    }
}

/// Reads a PNG or JPEG as 8-bit RGB.
///
/// # Errors
/// The file cannot be read, is truncated or is no image.
pub fn read_rgb(path: &Path) -> Result<RgbImage> {
    decode_rgb(
        &inputs::read(path, Kind::Image)?,
        &path.display().to_string(),
    )
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
    decode_gray16(
        &inputs::read(path, Kind::Image)?,
        &path.display().to_string(),
    )
}

/// Decodes the bytes of a single-channel 16-bit PNG; `name` is used in messages.
///
/// # Errors
/// The bytes are truncated, no image, or of another pixel type.
pub fn decode_gray16(bytes: &[u8], name: &str) -> Result<(usize, usize, Vec<u16>)> {
    match decode(bytes, name)? {
        DynamicImage::ImageLuma16(image) => Ok((
            image.width() as usize,
            image.height() as usize,
            image.into_raw(),
        )),
        other => Err(wrong_type(name, &other, "16-bit grey")),
    }
}

/// Reads a single-channel 8-bit PNG, e.g. label ids: width, height, values row by row.
///
/// # Errors
/// The file cannot be read, is truncated, no image, or of another pixel type.
pub fn read_gray8(path: &Path) -> Result<(usize, usize, Vec<u8>)> {
    decode_gray8(
        &inputs::read(path, Kind::Image)?,
        &path.display().to_string(),
    )
}

/// Decodes the bytes of a single-channel 8-bit PNG; `name` is used in messages.
///
/// # Errors
/// The bytes are truncated, no image, or of another pixel type.
pub fn decode_gray8(bytes: &[u8], name: &str) -> Result<(usize, usize, Vec<u8>)> {
    match decode(bytes, name)? {
        DynamicImage::ImageLuma8(image) => Ok((
            image.width() as usize,
            image.height() as usize,
            image.into_raw(),
        )),
        other => Err(wrong_type(name, &other, "8-bit grey")),
    }
}

/// Width and height of a PNG or JPEG, from its first bytes alone, as it is shown.
///
/// # Errors
/// The file cannot be read or does not begin like an image.
pub fn read_size(path: &Path) -> Result<(u32, u32)> {
    let file = inputs::open(path, Kind::Image)?;
    size(BufReader::new(file), &path.display().to_string())
}

/// Width and height of a PNG or JPEG from its bytes, as it is shown; `name` is used in messages.
///
/// # Errors
/// They do not begin like an image.
pub fn decode_size(bytes: &[u8], name: &str) -> Result<(u32, u32)> {
    size(Cursor::new(bytes), name)
}

fn size(input: impl BufRead + Seek, name: &str) -> Result<(u32, u32)> {
    guarded(DECODER, || size_unguarded(input, name)).unwrap_or_else(|problem| {
        Err(Error::Image {
            path: name.to_owned(),
            problem,
        })
    })
}

fn size_unguarded(input: impl BufRead + Seek, name: &str) -> Result<(u32, u32)> {
    let reader = image::ImageReader::new(input).with_guessed_format();
    let decoder = reader
        .map_err(ImageError::IoError)
        .and_then(image::ImageReader::into_decoder);
    let shown = decoder.and_then(|mut decoder| {
        let (width, height) = decoder.dimensions();
        Ok(match decoder.orientation()? {
            Orientation::Rotate90
            | Orientation::Rotate270
            | Orientation::Rotate90FlipH
            | Orientation::Rotate270FlipH => (height, width),
            _ => (width, height),
        })
    });
    shown.map_err(|error| Error::Image {
        path: name.to_owned(),
        problem: format!("its size cannot be read ({error})"),
    })
}

/// PNG bytes of an RGB image, compressed fast: the run-length Huffman coding of `fdeflate` over rows
/// that each choose their filter.
///
/// On ten frames of KITTI at 512x256 this takes 1.0 ms and 258 kB an image; deflate at level 1 takes
/// 3.4 ms and 256 kB, at level 6 18 ms and 259 kB, and OpenCV 5.0 with its own settings 4.8 ms and
/// 269 kB. A fixed filter for all rows is up to 12 % larger and not faster. The bytes are the same on
/// every machine.
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

/// JPEG bytes of an RGB image with 4:2:0 colour; `quality` from 1 to 100 on libjpeg's scale.
///
/// # Panics
/// If a side is longer than JPEG allows (65,535 pixels).
pub fn encode_jpeg_rgb(image: &RgbImage, quality: u8) -> Vec<u8> {
    const FITS: &str = "an RGB image within JPEG's size limits can be encoded into memory";
    let side = |pixels: u32| u16::try_from(pixels).expect(FITS);
    let mut bytes = Vec::new();
    let mut encoder = Encoder::new(&mut bytes, quality);
    encoder.set_sampling_factor(SamplingFactor::R_4_2_0);
    encoder
        .encode(
            image.as_raw(),
            side(image.width()),
            side(image.height()),
            ColorType::Rgb,
        )
        .expect(FITS);
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
    guarded(DECODER, || decode_unguarded(bytes, name)).unwrap_or_else(|problem| {
        Err(Error::Image {
            path: name.to_owned(),
            problem,
        })
    })
}

fn decode_unguarded(bytes: &[u8], name: &str) -> Result<DynamicImage> {
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
    let damaged = |error: ImageError| bad(format!("it is damaged ({error})"));
    let reader = image::ImageReader::with_format(Cursor::new(bytes), format);
    let mut decoder = reader.into_decoder().map_err(damaged)?;
    let (width, height) = decoder.dimensions();
    if u64::from(width) * u64::from(height) > MAX_PIXELS {
        return Err(bad(format!(
            "it is {width} x {height} pixels large; at most {MAX_PIXELS} are read"
        )));
    }
    let decode = || {
        let orientation = decoder.orientation()?;
        let mut image = DynamicImage::from_decoder(decoder)?;
        image.apply_orientation(orientation);
        Ok(image)
    };
    decode().map_err(damaged)
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

fn wrong_type(name: &str, image: &DynamicImage, expected: &str) -> Error {
    Error::Image {
        path: name.to_owned(),
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
    fn jpeg_is_stored_with_colour_at_half_size() {
        let bytes = encode_jpeg_rgb(&picture(), 92);
        // Baseline frame header: length, 8 bits, height, width, three components of which the
        // first is sampled 2x2 and the others 1x1 (ITU-T T.81, B.2.2).
        let frame = [0xff, 0xc0, 0, 17, 8, 0, 37, 0, 61, 3];
        let at = bytes.windows(10).position(|w| w == frame).unwrap() + 10;
        let sampling = [1, 4, 7].map(|offset| bytes[at + offset]);
        assert_eq!(sampling, [0x22, 0x11, 0x11]);
        assert_eq!(decode_size(&bytes, "x").unwrap(), (61, 37));
        assert!(bytes.len() > encode_jpeg_rgb(&picture(), 50).len());
    }

    #[test]
    fn codecs_have_names() {
        for codec in [Codec::Png, Codec::Jpeg(92), Codec::Jpeg(1)] {
            assert_eq!(codec.to_string().parse(), Ok(codec));
            let back = decode_rgb(&codec.encode(&picture()), "x").unwrap();
            assert_eq!(back.dimensions(), (61, 37));
        }
        for wrong in ["jpeg", "jpeg-0", "jpeg-101", "PNG", ""] {
            assert!(wrong.parse::<Codec>().is_err(), "{wrong}");
        }
    }

    /// EXIF data with an orientation and nothing else: a big-endian TIFF header and a directory of
    /// one entry (tag 0x112, a short), as CIPA DC-008 lays it out.
    fn exif(orientation: u8) -> Vec<u8> {
        let mut data = b"MM\0\x2a\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0".to_vec();
        data.extend([orientation, 0, 0, 0, 0, 0, 0]);
        data
    }

    #[test]
    fn pictures_are_turned_as_their_exif_data_says() {
        // Columns are brighter to the right and rows to the bottom, all eight pixels different.
        let stored = RgbImage::from_fn(4, 2, |x, y| image::Rgb([20 * x as u8 + 100 * y as u8; 3]));
        let rows = |image: &RgbImage| -> Vec<Vec<u8>> {
            image
                .rows()
                .map(|row| row.map(|pixel| pixel.0[0]).collect())
                .collect()
        };
        // What each value means, by the definition: where row 0 and column 0 of the file are shown.
        let upright = vec![vec![0, 20, 40, 60], vec![100, 120, 140, 160]];
        let half_turn = vec![vec![160, 140, 120, 100], vec![60, 40, 20, 0]];
        let to_the_right = vec![vec![100, 0], vec![120, 20], vec![140, 40], vec![160, 60]];
        let to_the_left = vec![vec![60, 160], vec![40, 140], vec![20, 120], vec![0, 100]];
        for (orientation, shown) in [
            (1, upright),
            (3, half_turn),
            (6, to_the_right),
            (8, to_the_left),
        ] {
            let mut bytes = Vec::new();
            let mut encoder = PngEncoder::new(&mut bytes);
            encoder.set_exif_metadata(exif(orientation)).unwrap();
            encoder
                .write_image(&stored, 4, 2, ExtendedColorType::Rgb8)
                .unwrap();
            let image = decode_rgb(&bytes, "x").unwrap();
            assert_eq!(rows(&image), shown, "{orientation}");
            assert_eq!(decode_size(&bytes, "x").unwrap(), image.dimensions());
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("a.png");
            std::fs::write(&path, &bytes).unwrap();
            assert_eq!(read_size(&path).unwrap(), image.dimensions());
        }
        // JPEG has it in a segment APP1 behind the start marker.
        let plain = encode_jpeg_rgb(&picture(), 90);
        let data = [b"Exif\0\0", &*exif(6)].concat();
        let length = u16::try_from(data.len() + 2).unwrap().to_be_bytes();
        let turned = [&plain[..2], b"\xff\xe1", &length, &data, &plain[2..]].concat();
        let upright = decode_rgb(&plain, "x").unwrap();
        assert_eq!(
            decode_rgb(&turned, "x").unwrap(),
            image::imageops::rotate90(&upright)
        );
        assert_eq!(decode_size(&turned, "x").unwrap(), (37, 61));
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
        // A header of 100,000 x 100,000 with its checksum, in a file of a few hundred bytes.
        let mut huge = encode_png_rgb(&picture());
        let side = 100_000_u32.to_be_bytes();
        huge[16..20].copy_from_slice(&side);
        huge[20..24].copy_from_slice(&side);
        let checksum = {
            // CRC-32 of PNG (ISO 3309), bit by bit.
            let shift = |c: u32| (c >> 1) ^ (0xedb8_8320 & 0u32.wrapping_sub(c & 1));
            let byte = |c: u32, b: &u8| (0..8).fold(c ^ u32::from(*b), |c, _| shift(c));
            !huge[12..29].iter().fold(u32::MAX, byte)
        };
        huge[29..33].copy_from_slice(&checksum.to_be_bytes());
        let error = decode_rgb(&huge, "x").unwrap_err().to_string();
        assert!(error.contains("100000 x 100000"), "{error}");

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
