//! The annotated ("improved") depth of KITTI depth (Uhrig et al., 3DV 2017), unpacked or as the
//! zip archive `data_depth_annotated.zip`.
//!
//! It lies in `train|val/<drive>_sync/proj_depth/groundtruth/image_02/<10 digits>.png`: 16-bit
//! metres times 256, 0 where nothing is known. 652 of the 697 Eigen test images have it. Only names
//! are looked at; no image is opened here.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use strat_splits::{DriveId, FrameId};

use crate::error::{Error, Result};
use crate::input::source::{self, Source};

/// Folder of a drive in which the left images' ground truth lies.
const SUBFOLDER: &str = "proj_depth/groundtruth/image_02";

/// The parts into which KITTI depth divides the drives.
const PARTS: [&str; 2] = ["train", "val"];

/// A folder or archive of annotated depth.
#[derive(Debug)]
pub struct AnnotatedFolder {
    /// The folder or archive.
    pub root: PathBuf,
    packed: BTreeMap<FrameId, Source>,
}

impl AnnotatedFolder {
    /// Checks that `root` holds `train` or `val`, or is an archive with maps in it.
    ///
    /// # Errors
    /// It is neither; the message says what was looked for.
    pub fn open(root: &Path) -> Result<Self> {
        let wrong = |problem: String| Error::Input {
            option: "--annotated",
            path: root.to_owned(),
            problem,
        };
        let layout = format!(
            "looked for train/<drive>_sync/{SUBFOLDER} and val/<drive>_sync/{SUBFOLDER}; give the archive \
             data_depth_annotated.zip or the folder into which it was unpacked"
        );
        let mut packed = BTreeMap::new();
        if root.is_file() {
            let entries = source::entries(root, |name| frame_of(name).is_some()).map_err(wrong)?;
            packed.extend(entries.into_iter().filter_map(|entry| {
                let frame = frame_of(entry.name())?;
                Some((frame, Source::Entry(entry)))
            }));
            if packed.is_empty() {
                return Err(wrong(format!("none of its entries fits; {layout}")));
            }
        } else if !root.exists() {
            return Err(wrong(format!("folder not found; {layout}")));
        } else if !PARTS.iter().any(|part| root.join(part).is_dir()) {
            return Err(wrong(format!("neither is there; {layout}")));
        }
        Ok(Self {
            root: root.to_owned(),
            packed,
        })
    }

    /// The depth of a frame's left image.
    pub fn depth(&self, frame: FrameId) -> Option<Source> {
        let stem = format!("{}_sync/{SUBFOLDER}/{}", frame.drive, frame.stem());
        let paths = ["png", "PNG"].into_iter().flat_map(|extension| {
            let name = format!("{stem}.{extension}");
            PARTS.map(|part| self.root.join(part).join(&name))
        });
        let on_disk = paths.into_iter().find(|path| path.is_file());
        on_disk
            .map(Source::File)
            .or_else(|| self.packed.get(&frame).cloned())
    }
}

/// The frame an entry of the archive belongs to.
fn frame_of(name: &str) -> Option<FrameId> {
    let parts: Vec<_> = name.split('/').collect();
    let at = parts.iter().position(|part| PARTS.contains(part))?;
    let [drive, place @ .., file] = &parts[at + 1..] else {
        return None;
    };
    let (stem, extension) = file.rsplit_once('.')?;
    (stem.len() == 10 && extension.eq_ignore_ascii_case("png")).then_some(())?;
    (place.join("/") == SUBFOLDER).then_some(())?;
    Some(FrameId {
        drive: drive.parse::<DriveId>().ok()?,
        index: stem.parse().ok()?,
    })
}
