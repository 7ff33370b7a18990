//! Rays through the pixels of a rectified camera, and the picture they make.
//!
//! Directions have unit depth, so that `t` is the camera's z in metres and
//! `focal_px * baseline_m / t` the disparity. Pixel (column, row) looks along image
//! point (column + 1, row + 1): the habit of counting from one that the reference
//! evaluation applies to projected scans (PROTOCOL 3.5, step 4), so that scans and
//! pictures agree there.

use crate::synth::geometry::shapes::Material;
use crate::synth::random::{key, mix};
use crate::synth::scene::{Candidate, Hit, On, Scene};
use crate::synth::shading::radiance;
use crate::synth::vector::{Rgb, V3, lerp};

/// A camera of the rig in the scene's coordinates.
#[derive(Clone, Debug)]
pub(crate) struct Camera {
    pub width: usize,
    pub height: usize,
    pub focal_px: f32,
    pub cx: f32,
    pub cy: f32,
    pub eye: V3,
    pub right: V3,
    pub down: V3,
    pub forward: V3,
}

impl Camera {
    /// Ray direction of unit depth through a pixel position.
    pub fn direction(&self, column: f32, row: f32) -> V3 {
        self.right * ((column + 1.0 - self.cx) / self.focal_px)
            + self.down * ((row + 1.0 - self.cy) / self.focal_px)
            + self.forward
    }

    /// Metres per pixel at unit depth.
    pub fn spread(&self) -> f32 {
        1.0 / self.focal_px
    }

    fn to_camera(&self, p: V3) -> V3 {
        let away = p - self.eye;
        V3 {
            x: away.dot(self.right),
            y: away.dot(self.down),
            z: away.dot(self.forward),
        }
    }
}

/// Side of a square of pixels that share a list of candidates.
const TILE: usize = 8;
/// Nothing is seen nearer than this.
const NEAR_M: f32 = 0.25;

/// Which shapes can be seen in which part of a picture.
pub(crate) struct Tiles {
    columns: usize,
    starts: Vec<u32>,
    /// Candidates with the pixels they can be seen in: columns and rows from, to.
    items: Vec<(Candidate, [u16; 4])>,
}

impl Tiles {
    pub fn new(scene: &Scene, camera: &Camera) -> Self {
        let columns = camera.width.div_ceil(TILE);
        let rows = camera.height.div_ceil(TILE);
        let mut seen: Vec<(f32, u32, [u16; 4])> = Vec::new();
        for (index, shape) in scene.shapes.iter().enumerate() {
            let corners = shape.corners().map(|c| camera.to_camera(c));
            let Some((low, high, nearest)) = screen_box(camera, &corners) else {
                continue;
            };
            let pixel = |v: f32, count: usize| (v.max(0.0) as usize).min(count - 1) as u16;
            // One pixel of slack for samples off the pixel's middle.
            if high.0 < -1.0
                || high.1 < -1.0
                || low.0 > camera.width as f32
                || low.1 > camera.height as f32
            {
                continue;
            }
            let span = [
                pixel(low.0 - 1.0, camera.width),
                pixel(low.1 - 1.0, camera.height),
                pixel(high.0 + 2.0, camera.width),
                pixel(high.1 + 2.0, camera.height),
            ];
            seen.push((nearest, index as u32, span));
        }
        seen.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let mut starts = vec![0_u32; columns * rows + 1];
        let tiles_of = |span: &[u16; 4]| span.map(|v| usize::from(v) / TILE);
        for (_, _, span) in &seen {
            let [c0, r0, c1, r1] = tiles_of(span);
            for row in r0..=r1 {
                for slot in &mut starts[row * columns + c0 + 1..=row * columns + c1 + 1] {
                    *slot += 1;
                }
            }
        }
        for i in 1..starts.len() {
            starts[i] += starts[i - 1];
        }
        let mut next = starts.clone();
        let nobody = (
            Candidate {
                index: 0,
                nearest: 0.0,
            },
            [0; 4],
        );
        let mut items = vec![nobody; starts[starts.len() - 1] as usize];
        for (nearest, index, span) in &seen {
            let [c0, r0, c1, r1] = tiles_of(span);
            for row in r0..=r1 {
                for slot in &mut next[row * columns + c0..=row * columns + c1] {
                    items[*slot as usize] = (
                        Candidate {
                            index: *index,
                            nearest: *nearest,
                        },
                        *span,
                    );
                    *slot += 1;
                }
            }
        }
        Self {
            columns,
            starts,
            items,
        }
    }

    /// Candidates for a pixel, nearest first.
    pub fn candidates(&self, column: usize, row: usize) -> impl Iterator<Item = Candidate> + '_ {
        let tile = row / TILE * self.columns + column / TILE;
        let (column, row) = (column as u16, row as u16);
        self.items[self.starts[tile] as usize..self.starts[tile + 1] as usize]
            .iter()
            .filter(move |(_, [c0, r0, c1, r1])| {
                column >= *c0 && column <= *c1 && row >= *r0 && row <= *r1
            })
            .map(|(candidate, _)| *candidate)
    }
}

type Corner = (f32, f32);

/// Pixel rectangle of a box and its least depth; `None` if it is behind the camera.
fn screen_box(camera: &Camera, corners: &[V3; 8]) -> Option<(Corner, Corner, f32)> {
    let nearest = corners.iter().map(|c| c.z).fold(f32::MAX, f32::min);
    let farthest = corners.iter().map(|c| c.z).fold(f32::MIN, f32::max);
    if farthest < NEAR_M {
        return None;
    }
    let (mut low, mut high) = ((f32::MAX, f32::MAX), (f32::MIN, f32::MIN));
    let mut take = |p: V3| {
        let x = p.x / p.z * camera.focal_px + camera.cx - 1.0;
        let y = p.y / p.z * camera.focal_px + camera.cy - 1.0;
        low = (low.0.min(x), low.1.min(y));
        high = (high.0.max(x), high.1.max(y));
    };
    for (i, &corner) in corners.iter().enumerate() {
        if corner.z >= NEAR_M {
            take(corner);
        }
        // Edges that pass through the near plane end on it.
        for bit in [1, 2, 4] {
            let other = corners[i ^ bit];
            if corner.z < NEAR_M && other.z >= NEAR_M {
                let w = (NEAR_M - corner.z) / (other.z - corner.z);
                take(corner + (other - corner) * w);
            }
        }
    }
    Some((low, high, nearest.max(0.0)))
}

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
pub(crate) fn render(scene: &Scene, camera: &Camera, tiles: &Tiles) -> Picture {
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
                crate::synth::geometry::street::Zone::Lane => 1,
                crate::synth::geometry::street::Zone::Parking => 2,
                crate::synth::geometry::street::Zone::Kerb => 3,
                crate::synth::geometry::street::Zone::Walk => 4,
                crate::synth::geometry::street::Zone::Yard(_) => 5,
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

/// How a camera turns radiance into bytes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sensor {
    pub exposure: f32,
    /// Gain of each channel beside the exposure.
    pub gain: Rgb,
    pub seed: u64,
}

/// Steps of the response curve over the square root of the exposure.
const STEPS: usize = 4096;

/// The response curve: straight, then a shoulder, then a power of 7/16 (close to the
/// usual 1/2.2 and made of square roots alone).
fn response() -> Vec<f32> {
    (0..=STEPS)
        .map(|i| {
            let root = i as f32 / STEPS as f32 * 2.0;
            let x = root * root;
            let bent = if x < 0.7 {
                x
            } else {
                0.7 + 0.3 * (x - 0.7) / (x - 0.4)
            };
            let quarter = bent.sqrt().sqrt();
            let eighth = quarter.sqrt();
            let level = quarter * eighth * eighth.sqrt();
            // A little more contrast, as cameras on cars are set.
            255.0 * lerp(level, level * level * (3.0 - 2.0 * level), 0.35)
        })
        .collect()
}

/// Picture elements as the camera would store them: 8-bit RGB, row-major.
pub(crate) fn develop(picture: &Picture, sensor: &Sensor) -> Vec<u8> {
    let curve = response();
    let mut bytes = Vec::with_capacity(picture.rgb.len() * 3);
    let seed = key(&[sensor.seed, 8]);
    for (at, rgb) in picture.rgb.iter().enumerate() {
        let noise = mix(seed ^ at as u64);
        for (i, &value) in rgb.iter().enumerate() {
            let exposed = (value * sensor.exposure * sensor.gain[i]).clamp(0.0, 4.0);
            let level = curve[(exposed.sqrt() * (0.5 * STEPS as f32)) as usize];
            // Sum of three 7-bit numbers: near enough to a bell of width 1.5 levels.
            let n = noise >> (21 * i);
            let bell = ((n & 127) + ((n >> 7) & 127) + ((n >> 14) & 127)) as f32 - 190.5;
            bytes.push((level + bell * (1.5 / 63.5) + 0.5).clamp(0.0, 255.0) as u8);
        }
    }
    bytes
}
