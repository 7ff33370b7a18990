//! Names of recording days, drives and frames, as KITTI raw writes them (PROTOCOL 1.1).

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// Text that does not name a KITTI day, drive or frame.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{text}` is not a KITTI {kind} name; expected something like `{example}`")]
pub struct ParseIdError {
    kind: &'static str,
    example: &'static str,
    text: String,
}

impl ParseIdError {
    fn date(text: &str) -> Self {
        Self {
            kind: "recording day",
            example: "2011_09_26",
            text: text.to_owned(),
        }
    }
    fn drive(text: &str) -> Self {
        Self {
            kind: "drive",
            example: "2011_09_26_drive_0001",
            text: text.to_owned(),
        }
    }
    fn frame(text: &str) -> Self {
        Self {
            kind: "frame",
            example: "2011_09_26_drive_0001/0000000005",
            text: text.to_owned(),
        }
    }
}

/// One of the five recording days of KITTI raw. All drives of a day share one calibration.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Date {
    /// 2011_09_26
    D2011_09_26,
    /// 2011_09_28
    D2011_09_28,
    /// 2011_09_29
    D2011_09_29,
    /// 2011_09_30
    D2011_09_30,
    /// 2011_10_03
    D2011_10_03,
}

impl Date {
    /// All days in calendar order.
    pub const ALL: [Self; 5] = [
        Self::D2011_09_26,
        Self::D2011_09_28,
        Self::D2011_09_29,
        Self::D2011_09_30,
        Self::D2011_10_03,
    ];

    /// The day as KITTI writes it, `2011_09_26`.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::D2011_09_26 => "2011_09_26",
            Self::D2011_09_28 => "2011_09_28",
            Self::D2011_09_29 => "2011_09_29",
            Self::D2011_09_30 => "2011_09_30",
            Self::D2011_10_03 => "2011_10_03",
        }
    }

    /// Width and height in pixels of the rectified colour images of this day (PROTOCOL 1.1).
    pub fn image_size(self) -> (u32, u32) {
        match self {
            Self::D2011_09_26 => (1242, 375),
            Self::D2011_09_28 => (1224, 370),
            Self::D2011_09_29 => (1238, 374),
            Self::D2011_09_30 => (1226, 370),
            Self::D2011_10_03 => (1241, 376),
        }
    }
}

impl fmt::Display for Date {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

impl FromStr for Date {
    type Err = ParseIdError;

    fn from_str(text: &str) -> Result<Self, ParseIdError> {
        Self::ALL
            .into_iter()
            .find(|date| date.as_str() == text)
            .ok_or_else(|| ParseIdError::date(text))
    }
}

/// A drive: its day and its number on that day.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct DriveId {
    /// Recording day.
    pub date: Date,
    /// Number within the day, at most 9999.
    pub number: u16,
}

impl DriveId {
    /// The folder name of the synchronised and rectified drive, `2011_09_26_drive_0001_sync`.
    pub fn folder(self) -> String {
        format!("{self}_sync")
    }
}

impl fmt::Display for DriveId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}_drive_{:04}", self.date, self.number)
    }
}

impl FromStr for DriveId {
    type Err = ParseIdError;

    /// Reads `2011_09_26_drive_0001`, with or without `_sync` at the end.
    fn from_str(text: &str) -> Result<Self, ParseIdError> {
        let error = || ParseIdError::drive(text);
        let name = text.strip_suffix("_sync").unwrap_or(text);
        let (date, number) = name.split_once("_drive_").ok_or_else(error)?;
        Ok(Self {
            date: date.parse().map_err(|_| error())?,
            number: digits(number, 4)
                .and_then(|n| u16::try_from(n).ok())
                .ok_or_else(error)?,
        })
    }
}

/// A frame of a drive; the stereo pair, not one image of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct FrameId {
    /// The drive.
    pub drive: DriveId,
    /// 0-based frame number.
    pub index: u32,
}

impl FrameId {
    /// The stem of the frame's files, `0000000005`.
    pub fn stem(self) -> String {
        format!("{:010}", self.index)
    }
}

impl fmt::Display for FrameId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{:010}", self.drive, self.index)
    }
}

impl FromStr for FrameId {
    type Err = ParseIdError;

    fn from_str(text: &str) -> Result<Self, ParseIdError> {
        let error = || ParseIdError::frame(text);
        let (drive, index) = text.split_once('/').ok_or_else(error)?;
        Ok(Self {
            drive: drive.parse().map_err(|_| error())?,
            index: digits(index, 10)
                .and_then(|n| u32::try_from(n).ok())
                .ok_or_else(error)?,
        })
    }
}

/// Exactly `count` ASCII digits as a number; `str::parse` alone would take a sign.
fn digits(text: &str, count: usize) -> Option<u64> {
    (text.len() == count && text.bytes().all(|b| b.is_ascii_digit())).then(|| text.parse().ok())?
}

macro_rules! serde_as_text {
    ($($name:ty),*) => {$(
        impl Serialize for $name {
            fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                serializer.collect_str(self)
            }
        }
        impl<'de> Deserialize<'de> for $name {
            fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                let text = String::deserialize(deserializer)?;
                text.parse().map_err(serde::de::Error::custom)
            }
        }
    )*};
}
serde_as_text!(Date, DriveId, FrameId);

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn names_are_written_as_kitti_writes_them() {
        let frame: FrameId = "2011_09_26_drive_0001/0000000005".parse().unwrap();
        assert_eq!(frame.index, 5);
        assert_eq!(
            frame.drive,
            DriveId {
                date: Date::D2011_09_26,
                number: 1
            }
        );
        assert_eq!(frame.stem(), "0000000005");
        assert_eq!(frame.drive.folder(), "2011_09_26_drive_0001_sync");
        assert_eq!(
            "2011_10_03_drive_0047_sync"
                .parse::<DriveId>()
                .unwrap()
                .to_string(),
            "2011_10_03_drive_0047"
        );
    }

    #[test]
    fn what_is_no_name_is_refused_with_an_example() {
        for text in ["", "2011_09_27", "2011_9_26", "2011_09_26_drive_1"] {
            assert!(text.parse::<Date>().is_err(), "{text}");
        }
        for text in [
            "2011_09_26_drive_1",
            "2011_09_26_drive_+001",
            "2011_09_26_drive_00001",
            "drive_0001",
        ] {
            assert!(text.parse::<DriveId>().is_err(), "{text}");
        }
        for text in [
            "2011_09_26_drive_0001/5",
            "2011_09_26_drive_0001 0000000005",
            "2011_09_26_drive_0001/9999999999",
        ] {
            let error = text.parse::<FrameId>().unwrap_err().to_string();
            assert!(
                error.contains("2011_09_26_drive_0001/0000000005"),
                "{error}"
            );
        }
    }

    proptest! {
        #[test]
        fn frames_survive_being_written_and_read(day in 0usize..5, number in 0u16..10_000, index: u32) {
            let frame = FrameId { drive: DriveId { date: Date::ALL[day], number }, index };
            prop_assert_eq!(frame.to_string().parse::<FrameId>().unwrap(), frame);
        }

        #[test]
        fn any_text_is_read_or_refused_without_a_panic(text in ".*") {
            let _ = text.parse::<FrameId>();
            let _ = text.parse::<DriveId>();
        }

        #[test]
        fn names_order_like_frames(a in 0u32..20_000, b in 0u32..20_000) {
            let drive = DriveId { date: Date::D2011_09_30, number: 18 };
            let (x, y) = (FrameId { drive, index: a }, FrameId { drive, index: b });
            prop_assert_eq!(x.cmp(&y), x.to_string().cmp(&y.to_string()));
        }
    }
}
