//! Ground truth of a stereo 2015 scene: sparse disparities, labels, instances.

use crate::synth::random::{Rng, key};
use crate::synth::scene::Scene;
use crate::synth::sensors::camera::PinholeCamera;
use crate::synth::sensors::picture::Picture;
use crate::synth::sensors::tiles::Tiles;
use crate::synth::vector::sin_cos;

/// Disparities as KITTI stores them: pixels times 256, 0 for none.
pub(crate) struct Disparities {
    pub noc: Vec<u16>,
    pub occ: Vec<u16>,
}

/// Rows higher above the horizon than this (a slope) have no measurements.
const TOP_SLOPE: f32 = 0.045;
const REACH_M: f32 = 85.0;

/// Disparities of the left picture where the scanner would have measured.
pub(crate) fn disparities(
    scene: &Scene,
    left: &Picture,
    right: (&PinholeCamera, &Tiles),
    baseline_m: f32,
    seed: u64,
) -> Disparities {
    let (camera, tiles) = right;
    let fb = camera.focal_px * baseline_m;
    let mut rng = Rng::new(key(&[seed, 21]));
    let size = left.width * left.height;
    let mut truth = Disparities {
        noc: vec![0; size],
        occ: vec![0; size],
    };
    let pattern = Pattern::new(&mut rng, camera.focal_px);
    for row in 0..left.height {
        let above = (camera.cy - row as f32 - 1.0) / camera.focal_px;
        for column in 0..left.width {
            let at = row * left.width + column;
            let depth = left.depth_m[at];
            // Random numbers are drawn for every pixel, so that one does not move the next.
            let lost = rng.unit();
            if above > TOP_SLOPE || depth > REACH_M || lost < 0.18 || !pattern.holds(column, row) {
                continue;
            }
            let disparity = fb / depth;
            let stored = (disparity * 256.0 + 0.5) as u32;
            let Ok(stored @ 1..) = u16::try_from(stored) else {
                continue;
            };
            truth.occ[at] = stored;
            if seen_from(
                scene,
                camera,
                tiles,
                column as f32 - disparity,
                row as f32,
                depth,
            ) {
                truth.noc[at] = stored;
            }
        }
    }
    truth
}

/// Whether the right camera sees what lies at a position of its picture and a depth.
pub(crate) fn seen_from(
    scene: &Scene,
    camera: &PinholeCamera,
    tiles: &Tiles,
    column: f32,
    row: f32,
    depth_m: f32,
) -> bool {
    if column < 0.0 || column > (camera.width - 1) as f32 {
        return false;
    }
    let nearest = tiles.candidates((column + 0.5) as usize, row as usize);
    let direction = camera.direction(column, row);
    scene
        .nearest(nearest, camera.eye, direction, camera.spread())
        .is_some_and(|hit| hit.t > depth_m * 0.995 - 0.02)
}

/// Lines of measurement, wavy as the car rolls on.
struct Pattern {
    pitch: f32,
    waves: [(f32, f32, f32); 2],
}

impl Pattern {
    fn new(rng: &mut Rng, focal_px: f32) -> Self {
        let k = focal_px / 721.5;
        let mut wave = |height: f32, length: f32| {
            (
                height * k * rng.range(0.7, 1.3),
                1.0 / (length * k),
                rng.angle(),
            )
        };
        Self {
            pitch: 2.3,
            waves: [wave(3.0, 180.0), wave(1.1, 37.0)],
        }
    }

    fn holds(&self, column: usize, row: usize) -> bool {
        let bend: f32 = self
            .waves
            .iter()
            .map(|&(height, rate, shift)| {
                height * sin_cos(f64::from(column as f32 * rate + shift)).0 as f32
            })
            .sum();
        let line = (row as f32 + bend + 100.0) / self.pitch;
        line - (line as i32) as f32 <= 1.0 / self.pitch
    }
}
