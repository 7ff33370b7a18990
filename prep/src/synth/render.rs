//! One view at a time, in memory: pictures, scan and truth of a frame or a stereo scene.

use image::RgbImage;

use super::noise::Textures;
use super::preset::{self, Preset, Purpose, Shot, View};
use super::scene::Scene;
use super::sensors::camera::PinholeCamera;
use super::sensors::lidar::Lidar;
use super::sensors::picture::{self, Picture};
use super::sensors::rig::{self, Rig};
use super::sensors::sensor::{Sensor, develop};
use super::sensors::tiles::Tiles;
use super::world::World;
use super::{random, truth};
use crate::error::{Error, Result};

/// Renders single frames in memory, without a folder of files.
pub struct Renderer {
    textures: Textures,
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
            textures: Textures::new(),
            seed,
            divisor,
            scan_steps: Preset::Demo.scan_steps(),
        }
    }

    /// The renderer of a preset: its picture size and the density of its scans.
    pub(super) fn of(preset: Preset, seed: u64) -> Self {
        Self {
            scan_steps: preset.scan_steps(),
            ..Self::new(seed, preset.divisor())
        }
    }

    /// Renders one view.
    ///
    /// # Errors
    /// The drive or the scene is not one of KITTI's.
    pub fn render(&self, view: View) -> Result<Rendered> {
        let shot = preset::shot(view).ok_or_else(|| {
            Error::Usage(format!(
                "KITTI has no {view:?}, so nothing can be rendered for it"
            ))
        })?;
        Ok(self.shoot(&shot))
    }

    pub(super) fn shoot(&self, shot: &Shot) -> Rendered {
        let rig = Rig::new(rig::day(shot.date), self.divisor);
        let world = world_of(shot, self.seed);
        let pair = render_pair(&world, &self.textures, rig, shot.index);
        let seed = random::key(&[
            random::key_of_name(&shot.world),
            self.seed,
            u64::from(shot.index),
        ]);
        let image = |which, picture: &Picture| {
            let bytes = develop(&picture.rgb, &Sensor::new(&world, which, seed));
            RgbImage::from_raw(rig.width, rig.height, bytes)
                .expect("a picture has the size of its camera")
        };
        let (left, right) = (image(2, &pair.left), image(3, &pair.right));
        let scan = matches!(shot.purpose, Purpose::Raw { scan: true, .. }).then(|| {
            let (eye, axes) = rig.scanner(&pair.scene);
            let lidar = Lidar {
                steps: self.scan_steps,
                seed,
            };
            lidar.scan(&pair.scene, eye, axes)
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
        Rendered {
            left,
            right,
            scan,
            truth,
            cam_to_cam: rig.cam_to_cam(),
            velo_to_cam: rig.velo_to_cam(),
        }
    }
}

/// A rendered stereo pair with everything needed to derive truth from it.
pub(super) struct Pair<'a> {
    pub scene: Scene<'a>,
    pub left: Picture,
    pub right: Picture,
    pub right_camera: PinholeCamera,
    pub right_tiles: Tiles,
}

pub(super) fn world_of(shot: &Shot, seed: u64) -> World {
    World::new(
        random::key(&[random::key_of_name(&shot.world), seed]),
        shot.theme,
    )
}

pub(super) fn render_pair<'a>(
    world: &'a World,
    textures: &'a Textures,
    rig: Rig,
    index: u32,
) -> Pair<'a> {
    let scene = Scene::new(world, textures, index);
    let left_camera = rig.camera(&scene, 0);
    let right_camera = rig.camera(&scene, 1);
    let left = picture::render(&scene, &left_camera, &Tiles::new(&scene, &left_camera));
    let right_tiles = Tiles::new(&scene, &right_camera);
    let right = picture::render(&scene, &right_camera, &right_tiles);
    Pair {
        scene,
        left,
        right,
        right_camera,
        right_tiles,
    }
}
