//! What a camera sees: one ray per pixel, more along outlines.

use super::camera::PinholeCamera;
use super::tiles::Tiles;
use crate::synth::geometry::shapes::Material;
use crate::synth::geometry::street::Zone;
use crate::synth::scene::{Hit, On, Scene};
use crate::synth::shading::radiance;
use crate::synth::vector::Rgb;

/// What a camera sees.
pub(crate) struct Picture {
    pub width: usize,
    pub height: usize,
    /// Linear radiance.
    pub rgb: Vec<Rgb>,
    /// Depth at the pixel's middle in metres, infinite for sky.
    pub depth_m: Vec<f32>,
    pub label: Vec<u8>,
    pub object: Vec<u16>,
}

/// Identity of what a pixel shows, to find outlines.
#[derive(Clone, Copy, PartialEq, Eq)]
struct Mark {
    thing: u32,
    leafy: bool,
}

/// Samples beside the pixel's middle that outlines get.
const BESIDE: [(f32, f32); 2] = [(-0.33, -0.25), (0.33, 0.25)];

/// Renders the scene through a camera.
pub(crate) fn render(scene: &Scene, camera: &PinholeCamera, tiles: &Tiles) -> Picture {
    let (width, height) = (camera.width, camera.height);
    let spread = camera.spread();
    let mut picture = Picture {
        width,
        height,
        rgb: vec![[0.0; 3]; width * height],
        depth_m: vec![f32::INFINITY; width * height],
        label: vec![0; width * height],
        object: vec![0; width * height],
    };
    let mut marks = vec![
        Mark {
            thing: 0,
            leafy: false
        };
        width * height
    ];
    for row in 0..height {
        for column in 0..width {
            let direction = camera.direction(column as f32, row as f32);
            let hit = scene.nearest(tiles.candidates(column, row), camera.eye, direction, spread);
            let at = row * width + column;
            let (rgb, lit) = radiance(scene, hit.as_ref(), camera.eye, direction, spread);
            picture.rgb[at] = rgb;
            (picture.label[at], picture.object[at]) = scene.labels(hit.as_ref());
            picture.depth_m[at] = hit.map_or(f32::INFINITY, |h| h.t);
            marks[at] = mark(scene, hit.as_ref(), lit);
        }
    }
    let differs = |a: usize, b: usize| {
        let (m, n) = (marks[a], marks[b]);
        if m == n {
            return false;
        }
        if m.leafy && n.leafy {
            let (p, q) = (picture.depth_m[a], picture.depth_m[b]);
            return (p - q).abs() > 0.15 * p.min(q);
        }
        true
    };
    let mut outline = vec![false; width * height];
    for row in 0..height {
        for column in 0..width {
            let at = row * width + column;
            if column + 1 < width && differs(at, at + 1) {
                outline[at] = true;
                outline[at + 1] = true;
            }
            if row + 1 < height && differs(at, at + width) {
                outline[at] = true;
                outline[at + width] = true;
            }
        }
    }
    for row in 0..height {
        for column in 0..width {
            let at = row * width + column;
            if !outline[at] {
                continue;
            }
            let mut sum = tame(picture.rgb[at]);
            for (dx, dy) in BESIDE {
                let direction = camera.direction(column as f32 + dx, row as f32 + dy);
                let hit =
                    scene.nearest(tiles.candidates(column, row), camera.eye, direction, spread);
                let rgb = tame(radiance(scene, hit.as_ref(), camera.eye, direction, spread).0);
                for i in 0..3 {
                    sum[i] += rgb[i];
                }
            }
            picture.rgb[at] = sum.map(|c| c / (1.0 + BESIDE.len() as f32));
        }
    }
    picture
}

/// Limits a sample, so that one glint does not outshine a whole outline.
fn tame(rgb: Rgb) -> Rgb {
    rgb.map(|c| c.min(2.0))
}

fn mark(scene: &Scene, hit: Option<&Hit>, lit: bool) -> Mark {
    match hit.map(|h| h.on) {
        None => Mark {
            thing: u32::MAX,
            leafy: false,
        },
        Some(On::Ground(ground)) => {
            let kind = match ground.spot.zone {
                Zone::Lane => 1,
                Zone::Parking => 2,
                Zone::Kerb => 3,
                Zone::Walk => 4,
                Zone::Yard(_) => 5,
            };
            Mark {
                thing: u32::MAX - 2 * kind - u32::from(lit),
                leafy: false,
            }
        }
        Some(On::Shape { index, recess, .. }) => {
            let leafy = scene.shapes[index as usize].skin.material == Material::Leaves;
            let part = if leafy {
                0
            } else {
                2 * recess as u32 + u32::from(lit)
            };
            Mark {
                thing: index * 8 + part,
                leafy,
            }
        }
    }
}
