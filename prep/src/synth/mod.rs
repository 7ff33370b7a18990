//! `prep synth`: a procedural street world, ray cast, written in KITTI's own layouts.
//!
//! Every drive is a street of its own ([`world`]): carriageway, pavements, houses, trees,
//! vehicles and people placed by the hash of the drive's name and a seed. The same rays
//! make the stereo pictures ([`sensors::picture`]), the laser scans ([`sensors::lidar`]) and the disparities
//! and labels ([`truth`]), so that all of them agree. Files go where KITTI has them
//! (PROTOCOL 1.1-1.3), under the names of real drives and frames ([`preset`]); every
//! reader of the project is used on them unchanged. The same preset and seed give the
//! same bytes for any number of threads.
//!
//! It is a stand-in for testing and demonstration: no figure obtained on it says
//! anything about KITTI.

mod geometry;
mod noise;
mod objects;
mod preset;
mod random;
mod scene;
mod sensors;
mod shading;
#[cfg(test)]
mod tests;
mod truth;
mod vector;
mod world;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use anyhow::Context;
use image::RgbImage;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use strat_splits::FrameId;
use strat_store::progress::Progress;
use strat_store::{files, image_files, yaml};

use crate::input::raw::RENDERED;

pub use preset::Preset;
use preset::{Purpose, Shot};
use sensors::{lidar, picture, rig};

/// Arguments of `prep synth`.
#[derive(clap::Args, Clone, Debug)]
pub struct Args {
    /// How much to render.
    #[arg(long, value_enum)]
    pub preset: Preset,
    /// Another seed gives another world.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Threads to use [default: all cores].
    #[arg(long)]
    pub jobs: Option<usize>,
    /// Show no progress.
    #[arg(long)]
    pub quiet: bool,
    /// Folder to write to; what is already there is not rendered again.
    #[arg(long)]
    pub out: PathBuf,
}

/// `WORLD.yaml`: what the folder holds and how it came to be.
#[derive(Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct WorldFile {
    rendered: bool,
    world_version: u32,
    preset: String,
    seed: u64,
    size_divisor: u32,
    stereo_pairs: usize,
    notes: Vec<String>,
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

/// Renders what is missing of a preset.
///
/// Returns the exit code: 0 when everything is there, 1 when some frames failed (each is
/// named on stderr, the others are kept).
///
/// # Errors
/// The folder holds another world or cannot be written to, or threads cannot be started.
pub fn run(args: &Args) -> anyhow::Result<u8> {
    let shots = preset::shots(args.preset);
    let file = WorldFile {
        rendered: true,
        world_version: WORLD_VERSION,
        preset: args.preset.name().to_owned(),
        seed: args.seed,
        size_divisor: args.preset.divisor(),
        stereo_pairs: shots.len(),
        notes: NOTES.map(str::to_owned).to_vec(),
    };
    claim(&args.out, &file)?;
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(args.jobs.unwrap_or(0))
        .build()
        .context("The threads for rendering could not be started; try a smaller --jobs.")?;
    let missing: Vec<&Shot> = shots.iter().filter(|s| !is_there(&args.out, s)).collect();
    let renderer = Renderer {
        scan_steps: args.preset.scan_steps(),
        ..Renderer::new(args.seed, args.preset.divisor())
    };
    let progress = Progress::new("synth", missing.len() as u64, "frames", args.quiet);
    let failures = Mutex::new(Vec::new());
    pool.install(|| {
        missing.par_iter().for_each(|shot| {
            if let Err(error) = write(&args.out, shot, &renderer) {
                let line = format!("{} frame {}: {error:#}", shot.world, shot.index);
                progress.println(&line);
                failures
                    .lock()
                    .unwrap_or_else(std::sync::PoisonError::into_inner)
                    .push(line);
            }
            progress.add(1);
        });
    });
    progress.finish();
    let failed = failures
        .into_inner()
        .unwrap_or_else(std::sync::PoisonError::into_inner)
        .len();
    if failed > 0 {
        progress.println(&format!(
            "{failed} of {} frames failed; run the same command again to render what is missing.",
            shots.len()
        ));
        return Ok(1);
    }
    Ok(0)
}

/// Marks the folder as this world's, or refuses it if it is another's.
fn claim(out: &Path, file: &WorldFile) -> anyhow::Result<()> {
    let path = out.join("WORLD.yaml");
    if path.exists() {
        let there: WorldFile = yaml::load(&path)?;
        if there != *file {
            anyhow::bail!(
                "{} holds another world (preset {}, seed {}, version {}; asked for: preset {}, seed {}, version {}). Choose another folder with --out or remove that one.",
                out.display(),
                there.preset,
                there.seed,
                there.world_version,
                file.preset,
                file.seed,
                file.world_version,
            );
        }
    } else {
        files::write_atomic(&path, yaml::to_string(file)?.as_bytes())?;
    }
    let rig_of = |name: &str| rig::day(name).map(|day| rig::Rig::new(day, file.size_divisor));
    let raw = out.join("kitti_raw");
    // Each of the folders may be used without the other.
    for folder in [&raw, &out.join("kitti2015")] {
        files::write_atomic(
            &folder.join(RENDERED),
            b"This is a rendered world, see WORLD.yaml.\n",
        )?;
    }
    let dates: BTreeSet<&str> = rig::DAYS.iter().map(|d| d.name).collect();
    for date in dates {
        let Some(rig) = rig_of(date) else { continue };
        let folder = raw.join(date);
        files::write_atomic(
            &folder.join("calib_cam_to_cam.txt"),
            rig.cam_to_cam().as_bytes(),
        )?;
        files::write_atomic(
            &folder.join("calib_velo_to_cam.txt"),
            rig.velo_to_cam().as_bytes(),
        )?;
        files::write_atomic(
            &folder.join("calib_imu_to_velo.txt"),
            rig::Rig::imu_to_velo().as_bytes(),
        )?;
    }
    Ok(())
}

/// The files of a shot.
struct Targets {
    left: PathBuf,
    right: PathBuf,
    scan: Option<PathBuf>,
    /// Further files of a stereo 2015 scene.
    truth: Option<Truth>,
}

struct Truth {
    noc: PathBuf,
    occ: PathBuf,
    semantic: PathBuf,
    instance: PathBuf,
    calibration: PathBuf,
}

fn targets(out: &Path, shot: &Shot) -> Targets {
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

fn is_there(out: &Path, shot: &Shot) -> bool {
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

/// What is looked at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum View {
    /// A frame of a raw drive.
    Frame(FrameId),
    /// A stereo 2015 training scene, 0 to 199.
    Stereo(usize),
}

/// Renders single frames in memory, without a folder of files.
pub struct Renderer {
    textures: noise::Textures,
    seed: u64,
    divisor: u32,
    scan_steps: usize,
}

/// A rendered stereo pair and what was measured with it.
pub struct Rendered {
    /// Picture of camera 2.
    pub left: RgbImage,
    /// Picture of camera 3.
    pub right: RgbImage,
    /// Points of the scan (frames of a drive, unless the published data lack the scan): x forward,
    /// y left, z up in metres, reflectance 0 to 1.
    pub scan: Option<Vec<[f32; 4]>>,
    /// Ground truth of a stereo scene.
    pub truth: Option<RenderedTruth>,
    /// Text of the camera calibration.
    pub cam_to_cam: String,
    /// Text of the scanner's calibration.
    pub velo_to_cam: String,
}

/// Ground truth of a stereo scene, a value per pixel of the left picture, row by row.
pub struct RenderedTruth {
    /// Disparity of what both cameras see, pixels times 256; 0 is none.
    pub noc: Vec<u16>,
    /// Disparity of everything that was measured, pixels times 256; 0 is none.
    pub occ: Vec<u16>,
    /// Cityscapes label ids.
    pub semantic: Vec<u8>,
    /// Label id times 256 plus the number of the object.
    pub instance: Vec<u16>,
}

impl Renderer {
    /// A renderer of the world of a seed, with pictures of 1/`divisor` of KITTI's sizes.
    ///
    /// # Panics
    /// If `divisor` is 0 or larger than 100.
    pub fn new(seed: u64, divisor: u32) -> Self {
        assert!((1..=100).contains(&divisor), "pictures have pixels");
        Self {
            textures: noise::Textures::new(),
            seed,
            divisor,
            scan_steps: Preset::Demo.scan_steps(),
        }
    }

    /// Renders one view.
    ///
    /// # Errors
    /// The drive or the scene is not one of KITTI's.
    pub fn render(&self, view: View) -> anyhow::Result<Rendered> {
        let shot = preset::shot(view).with_context(|| {
            format!("KITTI has no {view:?}, so nothing can be rendered for it.")
        })?;
        self.shoot(&shot)
    }

    fn shoot(&self, shot: &Shot) -> anyhow::Result<Rendered> {
        let day = rig::day(shot.date.as_str()).context("This recording day has no calibration.")?;
        let rig = rig::Rig::new(day, self.divisor);
        let world = world_of(shot, self.seed);
        let pair = render_pair(&world, &self.textures, rig, shot.index);
        let seed = random::key(&[
            random::key_of_name(&shot.world),
            self.seed,
            u64::from(shot.index),
        ]);
        let image = |which, picture| {
            let bytes = picture::develop(picture, &world.sensor(which, seed));
            RgbImage::from_raw(rig.width, rig.height, bytes)
                .context("The picture does not have the size of its camera.")
        };
        let (left, right) = (image(2, &pair.left)?, image(3, &pair.right)?);
        let scan = matches!(shot.purpose, Purpose::Raw { scan: true, .. }).then(|| {
            let (eye, axes) = rig.scanner(&pair.scene);
            let scanner = lidar::Scanner {
                steps: self.scan_steps,
                seed,
            };
            lidar::scan(&pair.scene, eye, axes, scanner)
        });
        let truth = matches!(shot.purpose, Purpose::Stereo { .. }).then(|| {
            let right = (&pair.right_camera, &pair.right_tiles);
            let baseline_m = rig.baseline_m() as f32;
            let truth::Disparities { noc, occ } =
                truth::disparities(&pair.scene, &pair.left, right, baseline_m, seed);
            let ids = pair.left.label.iter().zip(&pair.left.object);
            RenderedTruth {
                noc,
                occ,
                instance: ids
                    .map(|(&label, &object)| u16::from(label) * 256 + object)
                    .collect(),
                semantic: pair.left.label,
            }
        });
        Ok(Rendered {
            left,
            right,
            scan,
            truth,
            cam_to_cam: rig.cam_to_cam(),
            velo_to_cam: rig.velo_to_cam(),
        })
    }
}

/// A rendered stereo pair with everything needed to derive truth from it.
struct Pair<'a> {
    scene: scene::Scene<'a>,
    left: picture::Picture,
    right: picture::Picture,
    right_camera: picture::Camera,
    right_tiles: picture::Tiles,
}

fn world_of(shot: &Shot, seed: u64) -> world::World {
    world::World::new(
        random::key(&[random::key_of_name(&shot.world), seed]),
        shot.theme,
    )
}

fn render_pair<'a>(
    world: &'a world::World,
    textures: &'a noise::Textures,
    rig: rig::Rig,
    index: u32,
) -> Pair<'a> {
    let scene = scene::Scene::new(world, textures, index);
    let left_camera = rig.camera(&scene, 0);
    let right_camera = rig.camera(&scene, 1);
    let left = picture::render(
        &scene,
        &left_camera,
        &picture::Tiles::new(&scene, &left_camera),
    );
    let right_tiles = picture::Tiles::new(&scene, &right_camera);
    let right = picture::render(&scene, &right_camera, &right_tiles);
    Pair {
        scene,
        left,
        right,
        right_camera,
        right_tiles,
    }
}

/// Renders a shot and writes its files.
fn write(out: &Path, shot: &Shot, renderer: &Renderer) -> anyhow::Result<()> {
    let rendered = renderer.shoot(shot)?;
    let targets = targets(out, shot);
    for (path, image) in [
        (&targets.left, &rendered.left),
        (&targets.right, &rendered.right),
    ] {
        files::write_atomic(path, &image_files::encode_png_rgb(image))?;
    }
    if let (Some(path), Some(points)) = (&targets.scan, &rendered.scan) {
        let bytes: Vec<u8> = points
            .iter()
            .flatten()
            .flat_map(|v| v.to_le_bytes())
            .collect();
        files::write_atomic(path, &bytes)?;
    }
    if let (Some(to), Some(truth)) = (&targets.truth, &rendered.truth) {
        let (width, height) = rendered.left.dimensions();
        let gray16 = |values: &[u16]| image_files::encode_png_gray16(width, height, values);
        files::write_atomic(&to.noc, &gray16(&truth.noc))?;
        files::write_atomic(&to.occ, &gray16(&truth.occ))?;
        let semantic = image_files::encode_png_gray8(width, height, &truth.semantic);
        files::write_atomic(&to.semantic, &semantic)?;
        files::write_atomic(&to.instance, &gray16(&truth.instance))?;
        files::write_atomic(&to.calibration, rendered.cam_to_cam.as_bytes())?;
    }
    Ok(())
}
