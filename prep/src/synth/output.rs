//! The folder of a rendered world: what marks it, where each file goes, what is there already.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use strat_store::claim::{Found, Mark};
use strat_store::inputs::{self, Kind};
use strat_store::{files, image_files, yaml};

use super::preset::{Preset, Purpose, Shot};
use super::render::Rendered;
use super::sensors::rig::{self, Rig};
use crate::error::{Error, Result};
use crate::input::raw::RENDERED;

/// `WORLD.yaml`: what the folder holds and how it came to be.
#[derive(Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct WorldFile {
    pub rendered: bool,
    pub world_version: u32,
    pub preset: String,
    pub seed: u64,
    pub size_divisor: u32,
    pub stereo_pairs: usize,
    pub notes: Vec<String>,
}

impl WorldFile {
    /// What the world of a preset and a seed is marked with.
    pub fn new(preset: Preset, seed: u64, stereo_pairs: usize) -> Self {
        Self {
            rendered: true,
            world_version: WORLD_VERSION,
            preset: preset.name().to_owned(),
            seed,
            size_divisor: preset.divisor(),
            stereo_pairs,
            notes: NOTES.map(str::to_owned).to_vec(),
        }
    }
}

/// Raised whenever the same seed no longer gives the same bytes.
const WORLD_VERSION: u32 = 1;

const NOTES: [&str; 5] = [
    "Rendered, not recorded: drive names and frame numbers are KITTI's so that its splits apply, the content is invented.",
    "Image sizes, focal lengths, principal points, baselines and R_rect_00 are those of the recording day, divided by size_divisor where that is not 1.",
    "The cameras differ by a sideways shift alone: the second and third row of the fourth column of P_rect are 0.",
    "The scanner's rotation is that of 2011_09_26 on every day; its translation is the day's own for 2011_09_30 and 2011_10_03, else that of 2011_09_26.",
    "Image points count from 1: the middle of the first pixel is at (1, 1), as the reference evaluation takes it for projected scans.",
];

/// Whose a folder is.
const MARK: Mark = Mark {
    command: "prep synth",
    record: "WORLD.yaml",
    begins: "rendered: true\n",
    writes: |_| true,
};

/// Marks the folder as this world's, or refuses it if it holds anything else: a world is written
/// under the names of real data, which must never be mistaken for it or replaced by it.
///
/// # Errors
/// The folder is not empty and holds no world, or another one, or files under the names of this
/// one that are not its own.
pub(super) fn claim(out: &Path, file: &WorldFile) -> Result<()> {
    let refuse = |problem: String| Error::Output {
        path: out.to_owned(),
        problem,
    };
    let path = out.join(MARK.record);
    let found = MARK.examine(out, &[])?;
    if found == Found::Record {
        let there: WorldFile = yaml::load(&path)?;
        if there != *file {
            return Err(refuse(format!(
                "this folder holds another world (preset {}, seed {}, version {}; requested: preset {}, \
                 seed {}, version {}); give another folder, or remove that one",
                there.preset,
                there.seed,
                there.world_version,
                file.preset,
                file.seed,
                file.world_version,
            )));
        }
    }
    let shared = shared_files(out, file.size_divisor);
    for (path, text) in &shared {
        let foreign = match inputs::read(path, Kind::Calibration) {
            Ok(there) => there != text.as_bytes(),
            Err(error) => !error.is_not_found(),
        };
        if foreign {
            return Err(refuse(format!(
                "{} is not this world's: real data may lie between the rendered; nothing was written. Take \
                 one or the other out of this folder",
                path.display()
            )));
        }
    }
    if found == Found::Nothing {
        // First of all, so that what an interrupted run leaves is known as its own.
        files::write_atomic(&path, yaml::to_string(file)?.as_bytes())?;
    }
    files::remove_leftovers(out)?;
    for (path, text) in &shared {
        add(path, text.as_bytes())?;
    }
    Ok(())
}

/// What belongs to no frame: what says that the data are rendered, and the calibration of each day.
fn shared_files(out: &Path, size_divisor: u32) -> Vec<(PathBuf, String)> {
    let raw = out.join("kitti_raw");
    let note = "This is a rendered world, see WORLD.yaml.\n".to_owned();
    // Each of the folders may be used without the other.
    let mut shared = vec![
        (raw.join(RENDERED), note.clone()),
        (out.join("kitti2015").join(RENDERED), note),
    ];
    for day in &rig::DAYS {
        let rig = Rig::new(day, size_divisor);
        let folder = raw.join(day.date.as_str());
        shared.extend([
            (folder.join("calib_cam_to_cam.txt"), rig.cam_to_cam()),
            (folder.join("calib_velo_to_cam.txt"), rig.velo_to_cam()),
            (folder.join("calib_imu_to_velo.txt"), Rig::imu_to_velo()),
        ]);
    }
    shared
}

/// Writes a file that is not there; one that is there is never replaced.
fn add(path: &Path, bytes: &[u8]) -> Result<()> {
    if path.exists() {
        return Ok(());
    }
    Ok(files::write_atomic(path, bytes)?)
}

/// The files of a shot.
pub(super) struct Targets {
    pub left: PathBuf,
    pub right: PathBuf,
    pub scan: Option<PathBuf>,
    /// Further files of a stereo 2015 scene.
    pub truth: Option<Truth>,
}

pub(super) struct Truth {
    pub noc: PathBuf,
    pub occ: PathBuf,
    pub semantic: PathBuf,
    pub instance: PathBuf,
    pub calibration: PathBuf,
}

pub(super) fn targets(out: &Path, shot: &Shot) -> Targets {
    match shot.purpose {
        Purpose::Raw { frame, scan } => {
            let drive = out
                .join("kitti_raw")
                .join(frame.drive.date.as_str())
                .join(frame.drive.folder());
            let file = |kind: &str, extension: &str| {
                drive
                    .join(kind)
                    .join("data")
                    .join(format!("{}.{extension}", frame.stem()))
            };
            Targets {
                left: file("image_02", "png"),
                right: file("image_03", "png"),
                scan: scan.then(|| file("velodyne_points", "bin")),
                truth: None,
            }
        }
        Purpose::Stereo { number } => {
            let root = out.join("kitti2015").join("training");
            let file = |kind: &str| root.join(kind).join(format!("{number:06}_10.png"));
            Targets {
                left: file("image_2"),
                right: file("image_3"),
                scan: None,
                truth: Some(Truth {
                    noc: file("disp_noc_0"),
                    occ: file("disp_occ_0"),
                    semantic: file("semantic"),
                    instance: file("instance"),
                    calibration: root
                        .join("calib_cam_to_cam")
                        .join(format!("{number:06}.txt")),
                }),
            }
        }
    }
}

pub(super) fn is_there(out: &Path, shot: &Shot) -> bool {
    let t = targets(out, shot);
    let truth = t
        .truth
        .iter()
        .flat_map(|t| [&t.noc, &t.occ, &t.semantic, &t.instance, &t.calibration]);
    [&t.left, &t.right]
        .into_iter()
        .chain(&t.scan)
        .chain(truth)
        .all(|path| path.is_file())
}

/// Writes those files of a rendered shot that are not there.
pub(super) fn write(out: &Path, shot: &Shot, rendered: &Rendered) -> Result<()> {
    let targets = targets(out, shot);
    for (path, image) in [
        (&targets.left, &rendered.left),
        (&targets.right, &rendered.right),
    ] {
        add(path, &image_files::encode_png_rgb(image))?;
    }
    if let (Some(path), Some(points)) = (&targets.scan, &rendered.scan) {
        let bytes: Vec<u8> = points
            .iter()
            .flatten()
            .flat_map(|v| v.to_le_bytes())
            .collect();
        add(path, &bytes)?;
    }
    if let (Some(to), Some(truth)) = (&targets.truth, &rendered.truth) {
        let (width, height) = rendered.left.dimensions();
        let gray16 = |values: &[u16]| image_files::encode_png_gray16(width, height, values);
        add(&to.noc, &gray16(&truth.noc))?;
        add(&to.occ, &gray16(&truth.occ))?;
        let semantic = image_files::encode_png_gray8(width, height, &truth.semantic);
        add(&to.semantic, &semantic)?;
        add(&to.instance, &gray16(&truth.instance))?;
        add(&to.calibration, rendered.cam_to_cam.as_bytes())?;
    }
    Ok(())
}
