//! What every file of a set depends on, and whether a folder may take files of such settings.

use std::path::Path;

use serde::{Deserialize, Deserializer, Serialize, Serializer};
use strat_store::claim::{Found, Mark};
use strat_store::image_files::Codec;
use strat_store::layout::SETTINGS;
use strat_store::resize::Kernel;
use strat_store::set::{Content, FORMAT};
use strat_store::{files, yaml};

use crate::error::{Error, Result};

/// Whose the folder of a set is. The settings are its mark; they are written first.
pub const MARK: Mark = Mark {
    command: "prep",
    record: SETTINGS,
    begins: "format: ",
    writes: |_| true,
};

/// How network-size images are made and stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ImageOptions {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// How they are made of the originals.
    pub kernel: Kernel,
    /// How they are stored.
    pub codec: Codec,
}

/// What every file of a set depends on. Sets of different settings do not mix.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Version of the layout.
    pub format: u32,
    /// What it is made of; `split` in the files of earlier versions.
    #[serde(alias = "split")]
    pub content: Content,
    /// `kitti` or `rendered`; of other collections, their name.
    pub source: String,
    /// Width in pixels of the network-size images.
    pub image_width: u32,
    /// Height in pixels of the network-size images.
    pub image_height: u32,
    /// How they are made.
    pub kernel: Kernel,
    /// How they are stored: `png` or `jpeg-92`.
    #[serde(serialize_with = "as_text", deserialize_with = "from_text")]
    pub codec: Codec,
}

fn as_text<S: Serializer>(codec: &Codec, to: S) -> std::result::Result<S::Ok, S::Error> {
    to.collect_str(codec)
}

fn from_text<'de, D: Deserializer<'de>>(from: D) -> std::result::Result<Codec, D::Error> {
    let text = String::deserialize(from)?;
    text.parse().map_err(serde::de::Error::custom)
}

impl Settings {
    /// Settings of a set of a collection; `rendered` says whether it stands in for recorded KITTI.
    pub fn new(content: Content, rendered: bool, images: ImageOptions) -> Self {
        let source = match (content.split(), rendered) {
            (Some(_), true) => "rendered".to_owned(),
            (Some(_), false) => "kitti".to_owned(),
            (None, _) => content.to_string(),
        };
        Self {
            format: FORMAT,
            content,
            source,
            image_width: images.width,
            image_height: images.height,
            kernel: images.kernel,
            codec: images.codec,
        }
    }

    /// Reads the settings of a folder.
    ///
    /// # Errors
    /// They cannot be read or understood.
    pub fn load(out: &Path) -> Result<Self> {
        Ok(yaml::load(&out.join(SETTINGS))?)
    }

    /// Writes the settings into a folder.
    ///
    /// # Errors
    /// The folder cannot be written to.
    pub fn save(&self, out: &Path) -> Result<()> {
        let text = yaml::to_string(self)?;
        Ok(files::write_atomic(&out.join(SETTINGS), text.as_bytes())?)
    }

    /// Makes sure that `out` is new, empty or an earlier state of the same set, and lies in no input
    /// folder.
    ///
    /// # Errors
    /// It is something else; the message says what and what to do.
    pub fn check_output(&self, out: &Path, inputs: &[&Path]) -> Result<()> {
        let wrong = |problem: String| Error::Output {
            path: out.to_owned(),
            problem,
        };
        if MARK.examine(out, inputs)? != Found::Record {
            return Ok(());
        }
        let there = Self::load(out)?;
        if let (Some(there), Some(split)) = (there.content.split(), self.content.split())
            && there != split
        {
            return Err(wrong(format!(
                "this folder holds the {there} split. The test images of one split are training images of \
                 the other, so a folder with both would leak them into training; give another folder for \
                 the {split} split"
            )));
        }
        if there != *self {
            return Err(wrong(format!(
                "this folder holds {}, not {}; give another folder or the same options",
                there.describe(),
                self.describe()
            )));
        }
        Ok(())
    }

    fn describe(&self) -> String {
        let data = match self.content.split() {
            Some(_) => self.source.clone(),
            None => self.content.to_string(),
        };
        format!(
            "{data} data at {}x{} by `{}` as {} (format {})",
            self.image_width, self.image_height, self.kernel, self.codec, self.format
        )
    }
}
