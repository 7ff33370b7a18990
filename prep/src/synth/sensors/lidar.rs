//! A turn of the 64-beam laser scanner on the roof, front half.
//!
//! Beam angles follow the HDL-64E: 32 beams a third of a degree apart from +2
//! degrees down, 32 beams half a degree apart below them.

use crate::synth::random::{Rng, key};
use crate::synth::scene::{Candidate, Hit, On, Scene};
use crate::synth::vector::{V3, atan2, sin_cos};

/// The laser scanner: how densely it measures.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lidar {
    /// Rays of one beam over the front half circle.
    pub steps: usize,
    pub seed: u64,
}

const SECTORS: usize = 120;
const RANGE_M: f32 = 95.0;
/// Footprint of a ray per metre: a camera pixel's, so that both see the same leaves.
const SPREAD: f32 = 1.0 / 721.5;

impl Lidar {
    /// Points of the scan: x forward, y left, z up in metres, reflectance 0..1.
    pub fn scan(self, scene: &Scene, eye: V3, axes: [V3; 3]) -> Vec<[f32; 4]> {
        let sectors = sectors(scene, eye, axes);
        let mut rng = Rng::new(key(&[self.seed, 9]));
        let mut points = Vec::with_capacity(self.steps * 56);
        for beam in 0..64 {
            let degrees = if beam < 32 {
                2.0 - f64::from(beam) / 3.0
            } else {
                -8.83 - 0.5 * f64::from(beam - 32)
            };
            let (rise, level) = sin_cos(degrees.to_radians());
            for step in 0..self.steps {
                let turn = (step as f64 + 0.5) / self.steps as f64 * std::f64::consts::PI
                    - std::f64::consts::FRAC_PI_2;
                let (sin, cos) = sin_cos(turn);
                let local = [(level * cos) as f32, (level * sin) as f32, rise as f32];
                let direction = axes[0] * local[0] + axes[1] * local[1] + axes[2] * local[2];
                let sector = (step * SECTORS / self.steps).min(SECTORS - 1);
                let hit = scene.nearest(sectors[sector].iter().copied(), eye, direction, SPREAD);
                let blur = (rng.unit() + rng.unit() + rng.unit() - 1.5) * 0.03;
                let lost = rng.unit();
                let Some(hit) = hit.filter(|h| h.t < RANGE_M) else {
                    continue;
                };
                let cosine = (-direction.dot(hit.normal)).max(0.0);
                // Dark or slanted surfaces far away return nothing.
                let chance = 1.35 - hit.t / RANGE_M * (1.15 - 0.5 * cosine);
                if lost > chance {
                    continue;
                }
                let bright = reflectance(scene, &hit);
                let range = hit.t + blur;
                points.push([
                    local[0] * range,
                    local[1] * range,
                    local[2] * range,
                    ((0.1 + 0.8 * bright) * (0.4 + 0.6 * cosine) * 100.0) as u8 as f32 / 100.0,
                ]);
            }
        }
        points
    }
}

/// How bright a surface is to the laser: its paint, without texture.
fn reflectance(scene: &Scene, hit: &Hit) -> f32 {
    let [r, g, b] = match hit.on {
        On::Ground(_) => [0.25; 3],
        On::Shape { index, .. } => scene.shapes[index as usize].skin.paint,
    };
    (0.3 * r + 0.5 * g + 0.2 * b).clamp(0.0, 1.0)
}

/// For each slice of the front half circle the shapes that reach into it, nearest first.
fn sectors(scene: &Scene, eye: V3, axes: [V3; 3]) -> Vec<Vec<Candidate>> {
    let mut sectors = vec![Vec::new(); SECTORS];
    let pi = std::f32::consts::PI;
    let width = pi / SECTORS as f32;
    for (index, shape) in scene.shapes.iter().enumerate() {
        let middle = shape
            .corners()
            .iter()
            .fold(V3::default(), |a, &b| a + b * 0.125)
            - eye;
        let radius = 0.5 * (shape.high - shape.low).length();
        let (x, y) = (middle.dot(axes[0]), middle.dot(axes[1]));
        let distance = (x * x + y * y).sqrt();
        let nearest = middle.length() - radius;
        if nearest > RANGE_M {
            continue;
        }
        let candidate = Candidate {
            index: index as u32,
            nearest: nearest.max(0.0),
        };
        // Tan instead of arc sine of the half angle errs on the wide side.
        let angle = atan2(y, x);
        let half = if distance > 1.5 * radius {
            let along = (distance * distance - radius * radius).sqrt();
            atan2(radius, along) + 0.01
        } else {
            pi
        };
        let from = ((angle - half + 0.5 * pi) / width).max(0.0);
        let to = (angle + half + 0.5 * pi) / width;
        // A shape behind, seen past the end of the circle, may show at either end.
        if to < 0.0 || from >= SECTORS as f32 {
            continue;
        }
        for sector in &mut sectors[from as usize..=(to as usize).min(SECTORS - 1)] {
            sector.push(candidate);
        }
    }
    for sector in &mut sectors {
        sector.sort_by(|a, b| a.nearest.total_cmp(&b.nearest).then(a.index.cmp(&b.index)));
    }
    sectors
}
