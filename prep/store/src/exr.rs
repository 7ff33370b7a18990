//! Depth as OpenEXR: one `f32` channel named `Y`, metres, 0 = no measurement.
//!
//! `Y` is the name that OpenCV and the OpenEXR package both read; compression is ZIP16,
//! lossless. Unit, source and camera stand in the header, so that a file means something
//! on its own.

use std::io::Cursor;
use std::path::Path;

use exr::prelude::*;

use crate::error::{Error, Result};
use crate::files;
use crate::raster::Plane;

/// Deflate makes at most 1032 bytes of one; no method of the format makes more than this of a
/// picture that is worth reading.
const STRONGEST_COMPRESSION: usize = 4096;
/// Small enough for any machine, whatever the file: 64 MiB.
const ALWAYS_DECODED: usize = 64 << 20;

/// What a depth file says about itself.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthHeader {
    /// Where the values come from, e.g. `kitti2015/disp_noc_0` or `velodyne`.
    pub source: String,
    /// Along which axis depth is measured: `camera-z` or `velodyne-x`.
    pub axis: String,
    /// Focal length in pixels of the image this belongs to.
    pub focal_px: f64,
    /// Stereo baseline in metres.
    pub baseline_m: f64,
    /// Name of the frame, e.g. `kitti2015/000006`.
    pub frame: String,
}

const CHANNEL: &str = "Y";

/// Writes a depth file (see [`encode_depth`]); it appears whole or not at all.
///
/// # Errors
/// The plane cannot be encoded or the file not be written.
pub fn write_depth(path: &Path, depth_m: &Plane, header: &DepthHeader) -> Result<()> {
    let bytes = encode(depth_m, header).map_err(|problem| Error::Depth {
        path: path.to_owned(),
        problem,
    })?;
    files::write_atomic(path, &bytes)
}

/// The bytes of a depth file. The same input gives the same bytes.
///
/// # Errors
/// The plane has no pixels or its size contradicts its data.
pub fn encode_depth(depth_m: &Plane, header: &DepthHeader) -> Result<Vec<u8>> {
    encode(depth_m, header).map_err(|problem| Error::Depth {
        path: header.frame.clone().into(),
        problem,
    })
}

/// Reads a depth file written by [`write_depth`].
///
/// # Errors
/// The file cannot be read, is truncated or no EXR, has no channel `Y`, is not in metres, or
/// its header is incomplete.
pub fn read_depth(path: &Path) -> Result<(Plane, DepthHeader)> {
    decode_depth(&files::read(path)?, path)
}

/// Decodes the bytes of a depth file; `path` is used in messages.
///
/// # Errors
/// As [`read_depth`].
pub fn decode_depth(bytes: &[u8], path: &Path) -> Result<(Plane, DepthHeader)> {
    decode(bytes).map_err(|problem| Error::Depth {
        path: path.to_owned(),
        problem,
    })
}

/// The channel `Y`, or the only one there is, of any flat EXR file: whatever its pixel type, its
/// attributes and the program that wrote it.
///
/// # Errors
/// The bytes are truncated or no EXR, or several channels leave open which is meant.
pub fn decode_channel(bytes: &[u8]) -> std::result::Result<Plane, String> {
    let layer = first_layer(bytes, |other| format!("it is no usable EXR file: {other}"))?;
    let channels = &layer.channel_data.list;
    let channel = match channels.as_slice() {
        [only] => only,
        several => several
            .iter()
            .find(|channel| channel.name.eq(CHANNEL))
            .ok_or_else(|| {
                let names: Vec<_> = several.iter().map(|c| c.name.to_string()).collect();
                format!(
                    "its channels are {}; one should be called `{CHANNEL}` or be the only one",
                    names.join(", ")
                )
            })?,
    };
    let data = channel.sample_data.values_as_f32().collect();
    Plane::new(layer.size.x(), layer.size.y(), data)
        .ok_or_else(|| "its size contradicts its data".to_owned())
}

fn encode(depth_m: &Plane, header: &DepthHeader) -> std::result::Result<Vec<u8>, String> {
    let (width, height) = (depth_m.width, depth_m.height);
    if width == 0 || height == 0 || width.checked_mul(height) != Some(depth_m.data.len()) {
        return Err(format!(
            "{} values do not fill {width} x {height} pixels",
            depth_m.data.len()
        ));
    }
    let mut attributes = LayerAttributes::default();
    let text = |value: &str| {
        AttributeValue::Text(Text::new_or_none(value).unwrap_or_else(|| Text::from("")))
    };
    for (key, value) in [
        ("unit", text("m")),
        ("source", text(&header.source)),
        ("axis", text(&header.axis)),
        ("frame", text(&header.frame)),
        ("focal_px", AttributeValue::F64(header.focal_px)),
        ("baseline_m", AttributeValue::F64(header.baseline_m)),
    ] {
        attributes.other.insert(Text::from(key), value);
    }
    let channels = SpecificChannels::build()
        .with_channel::<f32>(CHANNEL)
        .with_pixel_fn(|at: Vec2<usize>| (depth_m.data[at.y() * width + at.x()],));
    let encoding = Encoding {
        compression: Compression::ZIP16,
        blocks: Blocks::ScanLines,
        line_order: LineOrder::Increasing,
    };
    let image = Image::from_layer(Layer::new((width, height), attributes, encoding, channels));
    let mut bytes = Cursor::new(Vec::new());
    // Frames are written by many threads; a pool per file would only get in their way.
    image
        .write()
        .non_parallel()
        .to_buffered(&mut bytes)
        .map_err(|e| e.to_string())?;
    let mut bytes = bytes.into_inner();
    sort_attributes(&mut bytes).ok_or("its header was written in an unknown layout")?;
    Ok(bytes)
}

/// Puts the attributes of the header in the order of their names. The encoder takes ours
/// from a hash map, so without this no two runs would write the same bytes; their order has
/// no meaning and their total length stays, so that offsets behind the header hold.
fn sort_attributes(bytes: &mut [u8]) -> Option<()> {
    // Magic number and version, then name\0 type\0 length value ... \0
    let start = 8;
    let mut end = start;
    let mut attributes = Vec::new();
    while *bytes.get(end)? != 0 {
        let from = end;
        for _ in 0..2 {
            end += bytes.get(end..)?.iter().position(|byte| *byte == 0)? + 1;
        }
        let length = bytes
            .get(end..end + 4)?
            .try_into()
            .ok()
            .map(u32::from_le_bytes)?;
        end = end.checked_add(4 + length as usize)?;
        attributes.push(bytes.get(from..end)?.to_vec());
    }
    attributes.sort_unstable();
    bytes[start..end].copy_from_slice(&attributes.concat());
    Some(())
}

/// All channels of the first layer; `describe` puts into words what is neither read nor truncated.
fn first_layer(
    bytes: &[u8],
    describe: impl FnOnce(exr::error::Error) -> String,
) -> std::result::Result<Layer<AnyChannels<FlatSamples>>, String> {
    let in_words = |error| match error {
        exr::error::Error::Io(_) => format!("it is truncated ({} bytes)", bytes.len()),
        other => describe(other),
    };
    // The decoder makes room for what the header promises before it has seen any of it.
    let headers = match MetaData::read_from_buffered(Cursor::new(bytes), false) {
        Ok(metadata) => metadata.headers,
        Err(error) => return Err(in_words(error)),
    };
    for header in &headers {
        let (width, height) = (header.layer_size.x(), header.layer_size.y());
        let decoded = width
            .checked_mul(height)
            .and_then(|pixels| pixels.checked_mul(header.channels.bytes_per_pixel));
        let possible = ALWAYS_DECODED.max(bytes.len().saturating_mul(STRONGEST_COMPRESSION));
        if decoded.is_none_or(|decoded| decoded > possible) {
            return Err(format!(
                "its header promises {width} x {height} pixels, more than its {} bytes can hold",
                bytes.len()
            ));
        }
    }
    let image = read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .non_parallel()
        .from_buffered(Cursor::new(bytes))
        .map_err(in_words)?;
    Ok(image.layer_data)
}

fn decode(bytes: &[u8]) -> std::result::Result<(Plane, DepthHeader), String> {
    let layer = first_layer(bytes, |other| format!("{other} ({} bytes)", bytes.len()))?;
    let attribute = |key: &str| {
        let found = layer.attributes.other.get(&Text::from(key));
        found.ok_or_else(|| format!("its header has no attribute `{key}`"))
    };
    let text = |key: &str| match attribute(key)? {
        AttributeValue::Text(text) => Ok(text.to_string()),
        _ => Err(format!("its header attribute `{key}` is no text")),
    };
    let number = |key: &str| match attribute(key)? {
        AttributeValue::F64(number) => Ok(*number),
        _ => Err(format!("its header attribute `{key}` is no 64-bit number")),
    };
    let unit = text("unit")?;
    if unit != "m" {
        return Err(format!("its unit is `{unit}`, not `m`"));
    }
    let header = DepthHeader {
        source: text("source")?,
        axis: text("axis")?,
        focal_px: number("focal_px")?,
        baseline_m: number("baseline_m")?,
        frame: text("frame")?,
    };
    let channel = layer
        .channel_data
        .list
        .into_iter()
        .find(|channel| channel.name.eq(CHANNEL));
    let Some(AnyChannel {
        sample_data: FlatSamples::F32(data),
        ..
    }) = channel
    else {
        return Err(format!("it has no 32-bit channel `{CHANNEL}`"));
    };
    let plane =
        Plane::new(layer.size.x(), layer.size.y(), data).ok_or("its size contradicts its data")?;
    Ok((plane, header))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header() -> DepthHeader {
        DepthHeader {
            source: "velodyne".to_owned(),
            axis: "camera-z".to_owned(),
            focal_px: 721.5377,
            baseline_m: 0.532_725_428,
            frame: "2011_09_26_drive_0001/0000000005".to_owned(),
        }
    }

    /// Sparse, with values that only survive lossless storage.
    fn depth() -> Plane {
        let value = |i: u32| {
            if i.is_multiple_of(7) {
                1.0 + i as f32 / 3.0
            } else {
                0.0
            }
        };
        Plane::new(61, 37, (0..61 * 37).map(value).collect()).unwrap()
    }

    #[test]
    fn depth_survives_bit_for_bit_with_its_header() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a/depth.exr");
        write_depth(&path, &depth(), &header()).unwrap();
        assert_eq!(read_depth(&path).unwrap(), (depth(), header()));
        assert_eq!(
            std::fs::read(&path).unwrap(),
            encode_depth(&depth(), &header()).unwrap()
        );
    }

    #[test]
    fn bytes_depend_on_the_content_alone() {
        assert_eq!(
            encode_depth(&depth(), &header()).unwrap(),
            encode_depth(&depth(), &header()).unwrap()
        );
    }

    #[test]
    fn damaged_files_are_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("depth.exr");
        let bytes = encode_depth(&depth(), &header()).unwrap();
        for broken in [
            &bytes[..0],
            &bytes[..3],
            &bytes[..200],
            &bytes[..bytes.len() - 5],
            b"not an exr file at all",
        ] {
            std::fs::write(&path, broken).unwrap();
            let error = read_depth(&path).unwrap_err().to_string();
            assert!(
                error.contains("depth.exr is not a usable depth file"),
                "{error}"
            );
        }
        let feet = bytes.windows(5).position(|name| name == b"unit\0").unwrap();
        let mut other = bytes.clone();
        // name\0 type\0 size, then the one letter of the unit
        let value = feet + "unit\0string\0".len() + 4;
        assert_eq!(other[value], b'm');
        other[value] = b'f';
        std::fs::write(&path, other).unwrap();
        assert!(
            read_depth(&path)
                .unwrap_err()
                .to_string()
                .contains("its unit is `f`, not `m`")
        );
    }

    /// Found by fuzzing: room was made for whatever the header promised, and the program aborted.
    #[test]
    fn promises_that_no_file_can_keep_are_refused() {
        let mut bytes = encode(&depth(), &header()).unwrap();
        let window = b"dataWindow\0box2i\0";
        let place = bytes.windows(window.len()).position(|part| part == window);
        // The name, the length, two zeros, then the last column and row.
        let ends = place.unwrap() + window.len() + 4 + 8;
        bytes[ends..ends + 4].copy_from_slice(&1_000_000_000_i32.to_le_bytes());
        bytes[ends + 4..ends + 8].copy_from_slice(&1_000_000_000_i32.to_le_bytes());
        for problem in [
            decode(&bytes).unwrap_err(),
            decode_channel(&bytes).unwrap_err(),
        ] {
            assert!(problem.contains("1000000001 x 1000000001"), "{problem}");
        }
    }

    #[test]
    fn foreign_files_are_read_by_channel() {
        let file = |names: [&str; 2]| {
            let at = |i: usize| f16::from_f32(i as f32 / 2.0);
            let values = FlatSamples::F16((0..6).map(at).collect());
            let list = names.map(|name| AnyChannel::new(name, values.clone()));
            let channels = AnyChannels::sort(list.into_iter().collect());
            let mut bytes = Cursor::new(Vec::new());
            let image = Image::from_channels((3, 2), channels);
            image.write().to_buffered(&mut bytes).unwrap();
            bytes.into_inner()
        };
        let plane = decode_channel(&file(["A", "Y"])).unwrap();
        assert_eq!((plane.width, plane.height), (3, 2));
        assert_eq!(plane.data, [0.0, 0.5, 1.0, 1.5, 2.0, 2.5]);
        assert_eq!(
            decode_channel(&encode_depth(&depth(), &header()).unwrap()),
            Ok(depth())
        );
        assert!(
            decode_channel(&file(["A", "B"]))
                .unwrap_err()
                .contains("its channels are A, B")
        );
        assert!(decode_channel(b"no exr").is_err());
    }

    #[test]
    fn an_empty_plane_is_refused() {
        let nothing = Plane {
            width: 0,
            height: 3,
            data: Vec::new(),
        };
        assert!(encode_depth(&nothing, &header()).is_err());
        let short = Plane {
            width: 4,
            height: 3,
            data: vec![0.0; 11],
        };
        assert!(
            encode_depth(&short, &header())
                .unwrap_err()
                .to_string()
                .contains("4 x 3")
        );
    }
}
