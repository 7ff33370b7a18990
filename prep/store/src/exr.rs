//! Depth as OpenEXR: one `f32` channel named `Y`, metres, 0 = no measurement.
//!
//! `Y` is the name that OpenCV and the OpenEXR package both read; compression is ZIP16,
//! lossless. Unit, source and camera stand in the header, so that a file means something
//! on its own.

mod unzip;

use std::io::Cursor;
use std::iter::once;
use std::path::Path;

use exr::block::chunk::Chunk;
use exr::block::writer::ChunksWriter;
use exr::block::{self, UncompressedBlock};
use exr::compression::Compression;
use exr::math::Vec2;
use exr::meta::attribute::{AttributeValue, ChannelDescription, LineOrder, SampleType, Text};
use exr::meta::header::{Header, LayerAttributes};
use exr::meta::{BlockDescription, MetaData};
use exr::prelude::f16;

use crate::error::{Error, Result};
use crate::files;
use crate::guard::guarded;
use crate::inputs::{self, Kind, MAX_PIXELS};
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
    let bytes = encode(depth_m, header).map_err(unusable(path))?;
    files::write_atomic(path, &bytes)
}

/// The bytes of a depth file. The same input gives the same bytes.
///
/// # Errors
/// The plane has no pixels or its size contradicts its data.
pub fn encode_depth(depth_m: &Plane, header: &DepthHeader) -> Result<Vec<u8>> {
    encode(depth_m, header).map_err(unusable(header.frame.as_ref()))
}

/// Reads a depth file written by [`write_depth`].
///
/// # Errors
/// The file cannot be read, is truncated or no EXR, has no channel `Y`, is not in metres, or
/// its header is incomplete.
pub fn read_depth(path: &Path) -> Result<(Plane, DepthHeader)> {
    decode_depth(&inputs::read(path, Kind::Exr)?, path)
}

/// Decodes the bytes of a depth file; `path` is used in messages.
///
/// # Errors
/// As [`read_depth`].
pub fn decode_depth(bytes: &[u8], path: &Path) -> Result<(Plane, DepthHeader)> {
    DepthFile::open(bytes, path)?.plane()
}

/// A depth file of which nothing but the header has been decoded. Ground truth is sparse: whoever looks for what
/// was measured need not hold all the rest.
pub struct DepthFile<'a> {
    path: &'a Path,
    header: DepthHeader,
    channel: Channel<'a>,
}

impl<'a> DepthFile<'a> {
    /// Reads the header; `path` is used in messages.
    ///
    /// # Errors
    /// As [`read_depth`], as far as the header says it.
    pub fn open(bytes: &'a [u8], path: &'a Path) -> Result<Self> {
        let opened = Channel::open(bytes, |_| Ok(CHANNEL.to_owned())).and_then(|channel| {
            let header = depth_header(&channel)?;
            Ok(Self {
                path,
                header,
                channel,
            })
        });
        opened.map_err(unusable(path))
    }

    /// Columns and rows.
    #[must_use]
    pub fn size(&self) -> (usize, usize) {
        self.channel.size()
    }

    /// What the file says about itself.
    #[must_use]
    pub fn header(&self) -> &DepthHeader {
        &self.header
    }

    /// Hands out all values in metres, one or several whole rows at a time, from the first to the last.
    ///
    /// # Errors
    /// The file is truncated or damaged; what was handed out until then is of no use.
    pub fn rows(self, take: impl FnMut(&[f32])) -> Result<()> {
        self.channel.rows(take).map_err(unusable(self.path))
    }

    /// All values, and what the file says about itself.
    ///
    /// # Errors
    /// As [`rows`](Self::rows).
    pub fn plane(self) -> Result<(Plane, DepthHeader)> {
        let plane = self.channel.plane().map_err(unusable(self.path))?;
        Ok((plane, self.header))
    }
}

/// What is wrong with a depth file, with its name.
fn unusable(path: &Path) -> impl FnOnce(String) -> Error {
    move |problem| Error::Depth {
        path: path.to_owned(),
        problem,
    }
}

/// The channel `Y`, or the only one there is, of any flat EXR file: whatever its pixel type, its
/// attributes and the program that wrote it. The plane is the file's display window; pixels without
/// data, as of a crop, are 0.
///
/// # Errors
/// The bytes are truncated or no EXR, or several channels leave open which is meant.
pub fn decode_channel(bytes: &[u8]) -> std::result::Result<Plane, String> {
    let channel = Channel::open(bytes, |channels| match channels {
        [only] => Ok(only.clone()),
        several if several.iter().any(|name| name == CHANNEL) => Ok(CHANNEL.to_owned()),
        several => Err(format!(
            "its channels are {}; one should be called `{CHANNEL}` or be the only one",
            several.join(", ")
        )),
    })?;
    channel.plane()
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
    let mut bytes = write_channel(depth_m, attributes).map_err(|e| e.to_string())?;
    sort_attributes(&mut bytes).ok_or("its header was written in an unknown layout")?;
    Ok(bytes)
}

/// A file of one 32-bit channel, block by block: the encoder's interface for whole images is compiled
/// anew for every way of giving the pixels.
fn write_channel(plane: &Plane, attributes: LayerAttributes) -> exr::error::Result<Vec<u8>> {
    let size = Vec2(plane.width, plane.height);
    let channel = ChannelDescription::named(CHANNEL, SampleType::F32);
    let header = Header::new(Text::from(""), size, once(channel).collect())
        .with_attributes(attributes)
        .with_encoding(
            Compression::ZIP16,
            BlockDescription::ScanLines,
            LineOrder::Increasing,
        );
    let mut bytes = Cursor::new(Vec::new());
    block::write(&mut bytes, once(header).collect(), true, |meta, chunks| {
        for (number, index) in block::enumerate_ordered_header_block_indices(&meta.headers) {
            let first = index.pixel_position.y() * plane.width;
            let values = &plane.data[first..first + index.pixel_size.area()];
            let block = UncompressedBlock {
                index,
                data: values
                    .iter()
                    .flat_map(|value| value.to_ne_bytes())
                    .collect(),
            };
            chunks.write_chunk(number, block.compress_to_chunk(&meta.headers)?)?;
        }
        Ok(())
    })?;
    Ok(bytes.into_inner())
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

/// What is named where [`exr`] panics.
const DECODER: &str = "the EXR decoder";

/// A channel of the first flat layer of a file.
struct Channel<'a> {
    bytes: &'a [u8],
    reader: block::reader::Reader<Cursor<&'a [u8]>>,
    layer: usize,
    /// Of the channel in the layer.
    number: usize,
}

impl<'a> Channel<'a> {
    /// Finds the channel that `choose` picks from the names of all.
    fn open(
        bytes: &'a [u8],
        choose: impl FnOnce(&[String]) -> std::result::Result<String, String>,
    ) -> std::result::Result<Self, String> {
        let reader = guarded(DECODER, || block::read(Cursor::new(bytes), false))?;
        let reader = reader.map_err(|error| in_words(&error, bytes))?;
        let headers = reader.headers();
        for header in headers {
            check_promise(header, bytes.len())?;
        }
        let mut layers = headers.iter().enumerate();
        let (layer, header) = layers
            .find(|(_, header)| !header.deep)
            .ok_or("it holds deep data only")?;
        let channels = &header.channels.list;
        let names: Vec<_> = channels.iter().map(|c| c.name.to_string()).collect();
        let chosen = choose(&names)?;
        let number = (names.iter().position(|name| *name == chosen))
            .ok_or_else(|| format!("it has no channel `{chosen}`"))?;
        if channels
            .iter()
            .any(|channel| channel.sampling != Vec2(1, 1))
        {
            return Err("some of its channels are subsampled".to_owned());
        }
        Ok(Self {
            bytes,
            reader,
            layer,
            number,
        })
    }

    /// Of the layer.
    fn header(&self) -> &Header {
        &self.reader.headers()[self.layer]
    }

    /// Columns and rows of the display window.
    fn size(&self) -> (usize, usize) {
        let Vec2(width, height) = self.header().shared_attributes.display_window.size;
        (width, height)
    }

    /// The display window.
    fn plane(self) -> std::result::Result<Plane, String> {
        let (width, height) = self.size();
        let mut data = Vec::with_capacity(width * height);
        self.rows(|rows| data.extend_from_slice(rows))?;
        Ok(Plane {
            width,
            height,
            data,
        })
    }

    /// Hands out the display window from the first row to the last, one or several at a time.
    fn rows(self, mut take: impl FnMut(&[f32])) -> std::result::Result<(), String> {
        let (width, height) = self.size();
        let Self {
            bytes,
            reader,
            layer,
            number,
        } = self;
        let in_words = |error| in_words(&error, bytes);
        let meta = reader.meta_data().clone();
        let header = &meta.headers[layer];
        let chunks = guarded(DECODER, || reader.all_chunks(false))?.map_err(in_words)?;
        let mut chunks = chunks.filter(|chunk| {
            let of_layer = |chunk: &Chunk| chunk.layer_index == layer;
            chunk.as_ref().map_or(true, of_layer)
        });
        if !(unzip::is_packed(header) && is_in_order(header)) {
            let mut window = Window::new(header);
            let mut place = || {
                chunks.try_for_each(|chunk| place_block(&mut window, chunk?, &meta, layer, number))
            };
            guarded(DECODER, &mut place)?.map_err(in_words)?;
            take(&window.plane.data);
            return Ok(());
        }
        let mut unpack = |values: &mut Vec<f32>| match chunks.next() {
            Some(chunk) => unzip::lines(&chunk?, header, values).map(Some),
            None => Ok(None),
        };
        let (mut row, mut values) = (0, Vec::new());
        while let Some(first) = guarded(DECODER, || unpack(&mut values))?.map_err(in_words)? {
            if first != row {
                return Err("its lines are not in the order that its header says".to_owned());
            }
            row += values.len() / width.max(1);
            take(&values);
        }
        match row == height {
            true => Ok(()),
            false => Err(format!("it has {row} of {height} lines")),
        }
    }
}

fn in_words(error: &exr::error::Error, bytes: &[u8]) -> String {
    match error {
        exr::error::Error::Io(_) => format!("it is truncated ({} bytes)", bytes.len()),
        other => format!("it is not a usable EXR file: {other}"),
    }
}

/// Whether the values of a layer are those of the display window, and come line after line.
fn is_in_order(header: &Header) -> bool {
    let display = header.shared_attributes.display_window;
    header.line_order == LineOrder::Increasing
        && header.layer_size == display.size
        && header.own_attributes.layer_position == display.position
}

/// Takes the values of a block, of any kind, that are of a channel.
fn place_block(
    window: &mut Window,
    chunk: Chunk,
    meta: &MetaData,
    layer: usize,
    number: usize,
) -> exr::error::Result<()> {
    let channels = &meta.headers[layer].channels;
    let block = UncompressedBlock::decompress_chunk(chunk, meta, false)?;
    if block.index.level == Vec2(0, 0) {
        let lines = block.lines(channels);
        for line in lines.filter(|line| line.location.channel == number) {
            let Vec2(column, row) = line.location.position;
            let kind = channels.list[number].sample_type;
            window.place(column, row, &samples(kind, line.value));
        }
    }
    Ok(())
}

/// Refuses a header that promises more than the file can hold: room is made for what it promises.
fn check_promise(header: &Header, file_bytes: usize) -> std::result::Result<(), String> {
    let possible = ALWAYS_DECODED.max(file_bytes.saturating_mul(STRONGEST_COMPRESSION));
    let display = header.shared_attributes.display_window.size;
    for Vec2(width, height) in [header.layer_size, display] {
        let pixels = width.checked_mul(height);
        if pixels.is_none_or(|pixels| pixels as u64 > MAX_PIXELS) {
            return Err(format!(
                "its header promises {width} x {height} pixels; at most {MAX_PIXELS} are read"
            ));
        }
        let decoded =
            pixels.and_then(|pixels| pixels.checked_mul(header.channels.bytes_per_pixel.max(4)));
        if decoded.is_none_or(|decoded| decoded > possible) {
            return Err(format!(
                "its header promises {width} x {height} pixels, more than its {file_bytes} bytes can hold"
            ));
        }
    }
    Ok(())
}

/// The display window of a file: what a viewer shows. The data window, of which there are values, may
/// be a part of it, as of a crop, or reach beyond.
struct Window {
    plane: Plane,
    /// Column and row of the first value.
    left: i64,
    top: i64,
}

impl Window {
    fn new(header: &Header) -> Self {
        let display = header.shared_attributes.display_window;
        let data = header.own_attributes.layer_position;
        Self {
            plane: Plane::filled(display.size.width(), display.size.height(), 0.0),
            left: i64::from(data.x()) - i64::from(display.position.x()),
            top: i64::from(data.y()) - i64::from(display.position.y()),
        }
    }

    /// Takes values of a row of the data window.
    fn place(&mut self, column: usize, row: usize, values: &[f32]) {
        let Plane {
            width,
            height,
            data,
        } = &mut self.plane;
        let Some(row) = usize::try_from(self.top + row as i64)
            .ok()
            .filter(|row| row < height)
        else {
            return;
        };
        let line = &mut data[row * *width..(row + 1) * *width];
        let left = self.left + column as i64;
        let outside = usize::try_from(-left).unwrap_or(0).min(values.len());
        let inside = usize::try_from(left).unwrap_or(0).min(line.len());
        let (line, values) = (&mut line[inside..], &values[outside..]);
        let count = line.len().min(values.len());
        line[..count].copy_from_slice(&values[..count]);
    }
}

/// Values as the decoder gives them, in the byte order of this machine.
fn samples(kind: SampleType, bytes: &[u8]) -> Vec<f32> {
    let (pairs, fours) = (bytes.as_chunks().0, bytes.as_chunks().0);
    match kind {
        SampleType::F16 => pairs
            .iter()
            .map(|b| f16::from_ne_bytes(*b).to_f32())
            .collect(),
        SampleType::F32 => fours.iter().map(|b| f32::from_ne_bytes(*b)).collect(),
        SampleType::U32 => fours
            .iter()
            .map(|b| u32::from_ne_bytes(*b) as f32)
            .collect(),
    }
}

/// What the header of a layer says of depth in a channel.
fn depth_header(channel: &Channel<'_>) -> std::result::Result<DepthHeader, String> {
    let header = channel.header();
    let attributes = &header.own_attributes.other;
    let attribute = |key: &str| {
        let found = attributes.get(&Text::from(key));
        found.ok_or_else(|| format!("its header has no attribute `{key}`"))
    };
    let text = |key: &str| match attribute(key)? {
        AttributeValue::Text(text) => Ok(text.to_string()),
        _ => Err(format!("its header attribute `{key}` is not text")),
    };
    let number = |key: &str| match attribute(key)? {
        AttributeValue::F64(number) => Ok(*number),
        _ => Err(format!(
            "its header attribute `{key}` is not a 64-bit number"
        )),
    };
    let unit = text("unit")?;
    if unit != "m" {
        return Err(format!("its unit is `{unit}`, not `m`"));
    }
    if header.channels.list[channel.number].sample_type != SampleType::F32 {
        return Err(format!("its channel `{CHANNEL}` has no 32-bit values"));
    }
    Ok(DepthHeader {
        source: text("source")?,
        axis: text("axis")?,
        focal_px: number("focal_px")?,
        baseline_m: number("baseline_m")?,
        frame: text("frame")?,
    })
}

#[cfg(test)]
mod tests {
    use exr::prelude::{AnyChannel, AnyChannels, FlatSamples, Image, IntegerBounds, WritableImage};

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

    #[test]
    fn lines_that_are_not_in_their_place_are_refused() {
        let bytes = encode_depth(&depth(), &header()).unwrap();
        // Three offsets of blocks stand before the first block, which begins with the number of its first line.
        let number = |at: usize| u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap());
        let table = (8..bytes.len() - 8).find(|&at| number(at) == at as u64 + 24);
        let block = table.unwrap() + 24;
        assert_eq!(bytes[block..block + 4], [0; 4]);
        for line in [16, 32] {
            let mut moved = bytes.clone();
            moved[block] = line;
            let error = decode_depth(&moved, Path::new("a.exr")).unwrap_err();
            let error = error.to_string();
            assert!(
                error.contains("a.exr is not a usable depth file"),
                "{error}"
            );
        }
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
        // The number of blocks of 16 rows goes with it.
        let count = b"chunkCount\0int\0";
        let count = bytes
            .windows(count.len())
            .position(|part| part == count)
            .unwrap()
            + count.len()
            + 4;
        bytes[count..count + 4].copy_from_slice(&62_500_001_i32.to_le_bytes());
        for problem in [
            decode_depth(&bytes, Path::new("")).unwrap_err().to_string(),
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

    /// Whatever the decoder of every kind of file makes of it.
    #[test]
    fn packed_blocks_are_what_the_decoder_makes_of_them() {
        let noise = |i: u32| f32::from_bits(0x3f80_0000 | i.wrapping_mul(2_654_435_761) >> 9);
        let planes = [
            depth(),
            Plane::filled(19, 33, 0.0),
            // Deflate makes nothing smaller here.
            Plane::new(40, 17, (0..40 * 17).map(noise).collect()).unwrap(),
            Plane::new(1, 1, vec![3.5]).unwrap(),
        ];
        for plane in planes {
            let values = FlatSamples::F32(plane.data.clone());
            for compression in [Compression::ZIP16, Compression::ZIP1, Compression::RLE] {
                let channels =
                    AnyChannels::sort(once(AnyChannel::new("Y", values.clone())).collect());
                let mut image = Image::from_channels((plane.width, plane.height), channels);
                image.layer_data.encoding.compression = compression;
                let mut bytes = Cursor::new(Vec::new());
                image.write().to_buffered(&mut bytes).unwrap();
                let found = decode_channel(&bytes.into_inner());
                assert_eq!(found.as_ref(), Ok(&plane), "{compression:?}");
            }
        }
    }

    /// A file of 3 x 2 values from 1 to 6 whose data window lies elsewhere than its display window.
    fn shifted(data: Vec2<i32>, display: (Vec2<i32>, Vec2<usize>)) -> Vec<u8> {
        let values = FlatSamples::F32((1..7).map(|v| v as f32).collect());
        let channels = AnyChannels::sort(once(AnyChannel::new("Y", values)).collect());
        let mut image = Image::from_channels((3, 2), channels);
        image.layer_data.attributes.layer_position = data;
        image.attributes.display_window = IntegerBounds::new(display.0, display.1);
        let mut bytes = Cursor::new(Vec::new());
        image.write().to_buffered(&mut bytes).unwrap();
        bytes.into_inner()
    }

    #[test]
    fn values_are_put_where_the_display_window_has_them() {
        // Values begin in column 1 of row 1 of a 5 x 3 picture; what is outside of them is 0.
        let inner = shifted(Vec2(11, -4), (Vec2(10, -5), Vec2(5, 3)));
        let plane = decode_channel(&inner).unwrap();
        assert_eq!((plane.width, plane.height), (5, 3));
        let rows = [
            [0.0; 5],
            [0.0, 1.0, 2.0, 3.0, 0.0],
            [0.0, 4.0, 5.0, 6.0, 0.0],
        ];
        assert_eq!(plane.data, rows.concat());
        // Values of more than the picture are cut off: its first pixel is in column 1 of row 1.
        let outer = shifted(Vec2(-1, -1), (Vec2(0, 0), Vec2(2, 1)));
        let plane = decode_channel(&outer).unwrap();
        assert_eq!(
            (plane.width, plane.height, &*plane.data),
            (2, 1, &[5.0, 6.0][..])
        );
        let beside = shifted(Vec2(100, 100), (Vec2(0, 0), Vec2(2, 1)));
        assert_eq!(decode_channel(&beside).unwrap().data, [0.0; 2]);
    }

    #[test]
    fn own_files_never_change() {
        // Recipe: BLAKE3 of `encode_depth` at version 0.1.0, when whole images were given to the encoder.
        let bytes = encode_depth(&depth(), &header()).unwrap();
        assert_eq!(
            files::blake3_hex(&bytes),
            "2b71f6806c3ea922da1a3fb5a41a447af4d06b91e6890c9dca45e8427d32a251"
        );
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
