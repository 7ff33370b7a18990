//! Event files that TensorBoard opens: scalars and pictures of a run.
//!
//! An event file is a sequence of TFRecords (length, masked CRC-32C of the length, bytes, masked
//! CRC-32C of the bytes; all little-endian), each holding one protobuf `Event`. The messages here
//! are the subset of TensorFlow's `event.proto` and `summary.proto` that is written; field numbers
//! are theirs. Nothing is read back, and no other kind of summary is known.

use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use image::RgbImage;
use prost::{Message, Oneof};
use strat_store::files::{self, Appending};
use strat_store::image_files::encode_png_rgb;

use crate::error::Result;

/// `SessionLog.SessionStatus.START`: what earlier files say of this step and later ones is void.
const SESSION_START: i32 = 1;

/// `DataType.DT_STRING`.
const STRING: i32 = 7;

/// `Summary.Image.colorspace` of red, green, blue.
const COLORSPACE_RGB: i32 = 3;

#[derive(Clone, PartialEq, Message)]
struct Event {
    #[prost(double, tag = "1")]
    wall_time: f64,
    #[prost(int64, tag = "2")]
    step: i64,
    #[prost(oneof = "What", tags = "3, 5, 7")]
    what: Option<What>,
}

#[derive(Clone, PartialEq, Oneof)]
enum What {
    #[prost(string, tag = "3")]
    FileVersion(String),
    #[prost(message, tag = "5")]
    Summary(Summary),
    #[prost(message, tag = "7")]
    SessionLog(SessionLog),
}

#[derive(Clone, PartialEq, Message)]
struct SessionLog {
    #[prost(int32, tag = "1")]
    status: i32,
}

#[derive(Clone, PartialEq, Message)]
struct Summary {
    #[prost(message, repeated, tag = "1")]
    value: Vec<Value>,
}

#[derive(Clone, PartialEq, Message)]
struct Value {
    #[prost(string, tag = "1")]
    tag: String,
    #[prost(oneof = "Content", tags = "2, 4, 8")]
    content: Option<Content>,
    #[prost(message, optional, tag = "9")]
    metadata: Option<Metadata>,
}

#[derive(Clone, PartialEq, Oneof)]
enum Content {
    #[prost(float, tag = "2")]
    SimpleValue(f32),
    #[prost(message, tag = "4")]
    Image(Picture),
    #[prost(message, tag = "8")]
    Tensor(TextTensor),
}

/// `TensorProto` of strings, one of them without a shape.
#[derive(Clone, PartialEq, Message)]
struct TextTensor {
    #[prost(int32, tag = "1")]
    dtype: i32,
    #[prost(string, repeated, tag = "8")]
    string_val: Vec<String>,
}

#[derive(Clone, PartialEq, Message)]
struct Metadata {
    #[prost(message, optional, tag = "1")]
    plugin_data: Option<PluginData>,
}

#[derive(Clone, PartialEq, Message)]
struct PluginData {
    #[prost(string, tag = "1")]
    plugin_name: String,
}

#[derive(Clone, PartialEq, Message)]
struct Picture {
    #[prost(int32, tag = "1")]
    height: i32,
    #[prost(int32, tag = "2")]
    width: i32,
    #[prost(int32, tag = "3")]
    colorspace: i32,
    #[prost(bytes = "vec", tag = "4")]
    encoded_image_string: Vec<u8>,
}

/// An event file that grows while a run goes on.
#[derive(Debug)]
pub struct EventWriter {
    file: Appending,
    path: PathBuf,
}

impl EventWriter {
    /// Starts a new event file in `folder`; TensorBoard reads all files of a folder as one run.
    ///
    /// With `first_step` above 0 the run is resumed: what earlier files of the folder say of that
    /// step and later ones is declared void, so that no curve runs back in time.
    ///
    /// # Errors
    /// The folder or the file cannot be made.
    pub fn create(folder: &Path, first_step: u64) -> Result<Self> {
        files::make_folder(folder)?;
        let seconds = SystemTime::now()
            .duration_since(UNIX_EPOCH)
            .map_or(0, |since| since.as_secs());
        // TensorBoard orders the files of a folder by name and wants `tfevents` in it; two starts
        // within one second get names of their own.
        let mut names = (0..).map(|number: u32| {
            folder.join(format!(
                "events.out.tfevents.{seconds:010}.{number:04}.strat"
            ))
        });
        let free = names.find(|path| !path.exists());
        let path = free.unwrap_or_else(|| folder.join("events.out.tfevents.strat"));
        let file = Appending::open(&path)?;
        let mut writer = Self { file, path };
        writer.event(0, What::FileVersion("brain.Event:2".to_owned()))?;
        if first_step > 0 {
            writer.event(
                first_step,
                What::SessionLog(SessionLog {
                    status: SESSION_START,
                }),
            )?;
        }
        Ok(writer)
    }

    /// Where it writes.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Adds numbers of a step; what is not finite is shown as such by TensorBoard.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn scalars(
        &mut self,
        step: u64,
        values: impl IntoIterator<Item = (String, f64)>,
    ) -> Result<()> {
        let value = |(tag, number): (String, f64)| Value {
            tag,
            content: Some(Content::SimpleValue(number as f32)),
            metadata: None,
        };
        let value = values.into_iter().map(value).collect();
        self.event(step, What::Summary(Summary { value }))
    }

    /// Adds a picture of a step.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn picture(&mut self, step: u64, tag: &str, picture: &RgbImage) -> Result<()> {
        let (width, height) = picture.dimensions();
        let picture = Picture {
            height: height as i32,
            width: width as i32,
            colorspace: COLORSPACE_RGB,
            encoded_image_string: encode_png_rgb(picture),
        };
        let value = vec![Value {
            tag: tag.to_owned(),
            content: Some(Content::Image(picture)),
            metadata: None,
        }];
        self.event(step, What::Summary(Summary { value }))
    }

    /// Adds a text, shown as it is.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn text(&mut self, step: u64, tag: &str, text: &str) -> Result<()> {
        // TensorBoard takes texts as Markdown, where four spaces begin what is shown unchanged.
        let lines = text.lines().map(|line| format!("    {line}\n"));
        let tensor = TextTensor {
            dtype: STRING,
            string_val: vec![lines.collect()],
        };
        let plugin_data = Some(PluginData {
            plugin_name: "text".to_owned(),
        });
        let value = vec![Value {
            tag: tag.to_owned(),
            content: Some(Content::Tensor(tensor)),
            metadata: Some(Metadata { plugin_data }),
        }];
        self.event(step, What::Summary(Summary { value }))
    }

    fn event(&mut self, step: u64, what: What) -> Result<()> {
        let wall_time = SystemTime::now()
            .duration_since(UNIX_EPOCH)
            .map_or(0.0, |since| since.as_secs_f64());
        let event = Event {
            wall_time,
            step: i64::try_from(step).unwrap_or(i64::MAX),
            what: Some(what),
        };
        // One write per record: a killed run leaves at most one broken record, at the end.
        Ok(self.file.add(&record(&event.encode_to_vec()))?)
    }
}

/// A TFRecord around `bytes`.
fn record(bytes: &[u8]) -> Vec<u8> {
    let length = (bytes.len() as u64).to_le_bytes();
    let mut record = Vec::with_capacity(bytes.len() + 16);
    record.extend(length);
    record.extend(masked_crc(&length).to_le_bytes());
    record.extend(bytes);
    record.extend(masked_crc(bytes).to_le_bytes());
    record
}

/// CRC-32C, rotated and shifted as TFRecords have it, so that a checksum of data that holds
/// checksums is still a good one.
fn masked_crc(bytes: &[u8]) -> u32 {
    crc32c::crc32c(bytes)
        .rotate_right(15)
        .wrapping_add(0xa282_ead8)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Reads a file back, checking both checksums of every record.
    fn read(path: &Path) -> Vec<Event> {
        let bytes = std::fs::read(path).unwrap();
        let mut rest = &bytes[..];
        let mut events = Vec::new();
        let number = |bytes: &[u8]| u32::from_le_bytes(bytes.try_into().unwrap());
        while !rest.is_empty() {
            let length = u64::from_le_bytes(rest[..8].try_into().unwrap()) as usize;
            assert_eq!(number(&rest[8..12]), masked_crc(&rest[..8]));
            let data = &rest[12..12 + length];
            assert_eq!(number(&rest[12 + length..16 + length]), masked_crc(data));
            events.push(Event::decode(data).unwrap());
            rest = &rest[16 + length..];
        }
        events
    }

    #[test]
    fn the_checksum_is_the_masked_castagnoli_one() {
        // RFC 3720 B.4: the CRC-32C of 32 zero bytes is 8a9136aa. Its low 15 bits to the front and
        // a282ead8 added, modulo 2^32, by hand.
        assert_eq!(masked_crc(&[0; 32]), 0x0fd7_fffa);
    }

    #[test]
    fn scalars_and_pictures_come_back_with_their_step() {
        let folder = tempfile::tempdir().unwrap();
        let mut writer = EventWriter::create(folder.path(), 0).unwrap();
        let scalars = [("train/loss", 0.5), ("schedule/rate", 1e-4)];
        let scalars = scalars.map(|(tag, value)| (tag.to_owned(), value));
        writer.scalars(7, scalars).unwrap();
        let picture = RgbImage::from_pixel(3, 2, image::Rgb([1, 2, 3]));
        writer.picture(8, "left", &picture).unwrap();
        let events = read(writer.path());
        assert_eq!(
            events[0].what,
            Some(What::FileVersion("brain.Event:2".to_owned()))
        );
        let Some(What::Summary(summary)) = &events[1].what else {
            panic!("{events:?}");
        };
        assert_eq!(events[1].step, 7);
        assert_eq!(summary.value[0].tag, "train/loss");
        assert_eq!(summary.value[0].content, Some(Content::SimpleValue(0.5)));
        let Some(What::Summary(summary)) = &events[2].what else {
            panic!("{events:?}");
        };
        let Some(Content::Image(image)) = &summary.value[0].content else {
            panic!("{summary:?}");
        };
        assert_eq!((image.width, image.height), (3, 2));
        let decoded =
            strat_store::image_files::decode_rgb(&image.encoded_image_string, "test").unwrap();
        assert_eq!(decoded, picture);
    }

    #[test]
    fn a_text_is_a_string_for_the_text_plugin() {
        let folder = tempfile::tempdir().unwrap();
        let mut writer = EventWriter::create(folder.path(), 0).unwrap();
        writer.text(3, "configuration", "a: 1\nb: 2\n").unwrap();
        let Some(What::Summary(summary)) = &read(writer.path())[1].what else {
            panic!("no summary");
        };
        let Some(Content::Tensor(tensor)) = &summary.value[0].content else {
            panic!("{summary:?}");
        };
        assert_eq!((tensor.dtype, tensor.string_val.len()), (7, 1));
        assert_eq!(tensor.string_val[0], "    a: 1\n    b: 2\n");
        let plugin = summary.value[0].metadata.clone().unwrap().plugin_data;
        assert_eq!(plugin.unwrap().plugin_name, "text");
    }

    #[test]
    fn a_resumed_run_voids_what_came_after_its_checkpoint() {
        let folder = tempfile::tempdir().unwrap();
        let first = EventWriter::create(folder.path(), 0).unwrap();
        let second = EventWriter::create(folder.path(), 40).unwrap();
        assert_ne!(first.path(), second.path());
        assert!(first.path() < second.path(), "read in the order of writing");
        let events = read(second.path());
        assert_eq!(events[1].step, 40);
        assert_eq!(
            events[1].what,
            Some(What::SessionLog(SessionLog {
                status: SESSION_START
            }))
        );
    }
}
