//! One frame's world, ready for rays: shapes, ground, and grids that say which
//! shapes can stand between a point and the sun.

use std::cell::Cell;

use crate::synth::geometry::recess::{Recess, enter_window};
use crate::synth::geometry::shapes::{Entry, Material, Plane, Shape};
use crate::synth::geometry::street::{GroundHit, StreetProfile, Yard, Zone};
use crate::synth::noise::Textures;
use crate::synth::objects::builder::Footprint;
use crate::synth::objects::label;
use crate::synth::vector::{V3, floor_i32, smooth, v3};
use crate::synth::world::{Pose, World};

/// What a ray has met.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Hit {
    pub t: f32,
    /// Outward normal in world coordinates.
    pub normal: V3,
    pub on: On,
}

/// The thing a ray has met.
#[derive(Clone, Copy, Debug)]
pub(crate) enum On {
    Ground(GroundHit),
    Shape {
        index: u32,
        shell: u8,
        recess: Recess,
    },
}

/// A shape that a ray may meet and the least t at which it can.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Candidate {
    pub index: u32,
    pub nearest: f32,
}

/// Everything a ray can meet in one frame, relative to an origin near the camera.
pub(crate) struct Scene<'a> {
    pub shapes: Vec<Shape>,
    pub planes: Vec<Plane>,
    pub profile: StreetProfile,
    pub world: &'a World,
    pub textures: &'a Textures,
    pub pose: Pose,
    /// World coordinates of the scene's origin.
    pub origin: (f64, f64),
    shade: ShadeGrid,
    contact: Contact,
    /// The shape that shaded the point asked about before: a hint, without effect on results.
    last_shade: Cell<u32>,
}

/// Shapes farther than this from the camera cast no shadow.
const SHADOW_REACH_M: f32 = 125.0;

impl<'a> Scene<'a> {
    /// The world around the camera at frame `index`.
    pub fn new(world: &'a World, textures: &'a Textures, index: u32) -> Self {
        let pose = world.pose(index);
        // A multiple of every texture's period, so that textures stay put.
        let snap = |v: f64| (v / 128.0).floor() * 128.0;
        let origin = (snap(pose.x), snap(pose.y));
        let built = world.populate(&pose, origin.0, origin.1);
        let profile = StreetProfile::new(&world.street, pose.x, origin.0, origin.1);
        let eye = v3(
            (pose.x - origin.0) as f32,
            (pose.y - origin.1) as f32,
            pose.height_m as f32,
        );
        let shade = ShadeGrid::new(&built.shapes, world.light.sun, eye);
        let contact = Contact::new(&built.footprints, eye.x);
        Self {
            shapes: built.shapes,
            planes: built.planes,
            profile,
            world,
            textures,
            pose,
            origin,
            shade,
            contact,
            last_shade: Cell::new(u32::MAX),
        }
    }

    /// The nearest thing along a ray; `candidates` in order of their `nearest`.
    pub fn nearest(
        &self,
        candidates: impl Iterator<Item = Candidate>,
        origin: V3,
        direction: V3,
        spread: f32,
    ) -> Option<Hit> {
        let mut best: Option<(u32, Entry)> = None;
        let ground = self.profile.enter(origin, direction, 2500.0);
        let mut t_max = ground.map_or(1e6, |g| g.t);
        for candidate in candidates {
            if candidate.nearest > t_max {
                break;
            }
            let shape = &self.shapes[candidate.index as usize];
            if let Some(entry) = shape.enter(
                &self.planes,
                self.textures,
                origin,
                direction,
                t_max,
                spread,
            ) {
                t_max = entry.t;
                best = Some((candidate.index, entry));
            }
        }
        let Some((index, entry)) = best else {
            return ground.map(|g| Hit {
                t: g.t,
                normal: g.normal,
                on: On::Ground(g),
            });
        };
        let shape = &self.shapes[index as usize];
        let mut hit = Hit {
            t: entry.t,
            normal: entry.normal,
            on: On::Shape {
                index,
                shell: entry.shell,
                recess: Recess::Wall,
            },
        };
        if shape.skin.material == Material::Facade && entry.normal.z == 0.0 {
            let o = shape.local(origin);
            let d = shape.local_direction(direction);
            let (t, normal, recess) = enter_window(shape, o, d, entry);
            hit = Hit {
                t,
                normal,
                on: On::Shape {
                    index,
                    shell: 0,
                    recess,
                },
            };
        }
        hit.normal = shape.world_direction(hit.normal);
        Some(hit)
    }

    /// Cityscapes label and object number of what was met.
    pub fn labels(&self, hit: Option<&Hit>) -> (u8, u16) {
        match hit.map(|h| h.on) {
            None => (label::SKY, 0),
            Some(On::Shape { index, .. }) => {
                let shape = &self.shapes[index as usize];
                (shape.label, shape.object)
            }
            Some(On::Ground(ground)) => {
                let label = match ground.spot.zone {
                    Zone::Lane => label::ROAD,
                    Zone::Parking => label::PARKING,
                    Zone::Kerb | Zone::Walk => label::SIDEWALK,
                    Zone::Yard(Yard::Grass) => label::TERRAIN,
                    Zone::Yard(_) => label::PARKING,
                };
                (label, 0)
            }
        }
    }

    /// Share of the sun that reaches a point (0 or 1); `of` is the shape it is on.
    pub fn sunlight(&self, point: V3, of: Option<u32>) -> f32 {
        let sun = self.world.light.sun;
        let blocks = |index: u32| {
            let shape = &self.shapes[index as usize];
            let entry = shape.enter(&self.planes, self.textures, point, sun, 1e3, 0.004);
            Some(index) != of && entry.is_some()
        };
        let above = self.shade.above(point);
        // What shaded the last point often shades this one.
        let last = self.last_shade.get();
        if above.contains(&last) && blocks(last) {
            return 0.0;
        }
        for &index in above {
            if Some(index) != of && index != last && blocks(index) {
                self.last_shade.set(index);
                return 0.0;
            }
        }
        1.0
    }

    /// Share of the sky's light that reaches the ground at (x, y).
    pub fn openness(&self, x: f32, y: f32) -> f32 {
        self.contact.openness(x, y)
    }
}

/// A grid across the direction of the sun: each cell lists the shapes whose shadow
/// can fall through it.
struct ShadeGrid {
    u: V3,
    v: V3,
    low: (f32, f32),
    columns: usize,
    rows: usize,
    starts: Vec<u32>,
    items: Vec<u32>,
}

const SHADE_CELL_M: f32 = 0.8;

impl ShadeGrid {
    fn new(shapes: &[Shape], sun: V3, eye: V3) -> Self {
        let u = v3(-sun.y, sun.x, 0.0).unit();
        let v = sun.cross(u);
        let mut spans = Vec::new();
        let (mut low, mut high) = ((f32::MAX, f32::MAX), (f32::MIN, f32::MIN));
        for (index, shape) in shapes.iter().enumerate() {
            let away = shape.centre - eye;
            if away.x.abs() > SHADOW_REACH_M
                || away.y.abs() > SHADOW_REACH_M
                || shape.skin.material == Material::Hill
            {
                continue;
            }
            let mut span = (f32::MAX, f32::MAX, f32::MIN, f32::MIN);
            for corner in shape.corners() {
                let (a, b) = (corner.dot(u), corner.dot(v));
                span = (span.0.min(a), span.1.min(b), span.2.max(a), span.3.max(b));
            }
            low = (low.0.min(span.0), low.1.min(span.1));
            high = (high.0.max(span.2), high.1.max(span.3));
            spans.push((index as u32, span));
        }
        if spans.is_empty() {
            (low, high) = ((0.0, 0.0), (0.0, 0.0));
        }
        let columns = ((high.0 - low.0) / SHADE_CELL_M) as usize + 1;
        let rows = ((high.1 - low.1) / SHADE_CELL_M) as usize + 1;
        let cells = |span: &(f32, f32, f32, f32)| {
            let column = |a: f32| (((a - low.0) / SHADE_CELL_M) as usize).min(columns - 1);
            let row = |b: f32| (((b - low.1) / SHADE_CELL_M) as usize).min(rows - 1);
            (column(span.0), row(span.1), column(span.2), row(span.3))
        };
        let mut starts = vec![0_u32; columns * rows + 1];
        for (_, span) in &spans {
            let (c0, r0, c1, r1) = cells(span);
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
        let mut items = vec![0_u32; starts[starts.len() - 1] as usize];
        for (index, span) in &spans {
            let (c0, r0, c1, r1) = cells(span);
            for row in r0..=r1 {
                for slot in &mut next[row * columns + c0..=row * columns + c1] {
                    items[*slot as usize] = *index;
                    *slot += 1;
                }
            }
        }
        Self {
            u,
            v,
            low,
            columns,
            rows,
            starts,
            items,
        }
    }

    fn above(&self, point: V3) -> &[u32] {
        let column = floor_i32((point.dot(self.u) - self.low.0) / SHADE_CELL_M);
        let row = floor_i32((point.dot(self.v) - self.low.1) / SHADE_CELL_M);
        if column < 0 || row < 0 || column as usize >= self.columns || row as usize >= self.rows {
            return &[];
        }
        let cell = row as usize * self.columns + column as usize;
        &self.items[self.starts[cell] as usize..self.starts[cell + 1] as usize]
    }
}

/// Bins along x with the vehicle footprints that darken the ground there.
struct Contact {
    first_x: f32,
    bins: Vec<Vec<Footprint>>,
}

const CONTACT_BIN_M: f32 = 3.0;
const CONTACT_REACH_M: f32 = 0.9;

impl Contact {
    fn new(footprints: &[Footprint], eye_x: f32) -> Self {
        let first_x = eye_x - 60.0;
        let mut bins = vec![Vec::new(); 70];
        for footprint in footprints {
            let reach = footprint.half_length.max(footprint.half_width) + CONTACT_REACH_M;
            let bin =
                |x: f32| floor_i32((x - first_x) / CONTACT_BIN_M).clamp(0, bins_last(70)) as usize;
            for slot in &mut bins[bin(footprint.at.x - reach)..=bin(footprint.at.x + reach)] {
                slot.push(*footprint);
            }
        }
        Self { first_x, bins }
    }

    fn openness(&self, x: f32, y: f32) -> f32 {
        let bin = floor_i32((x - self.first_x) / CONTACT_BIN_M);
        let Some(footprints) = usize::try_from(bin).ok().and_then(|i| self.bins.get(i)) else {
            return 1.0;
        };
        let mut open = 1.0_f32;
        for f in footprints {
            let local = (v3(x, y, 0.0) - v3(f.at.x, f.at.y, 0.0)).turned(f.cos, -f.sin);
            let (dx, dy) = (local.x.abs() - f.half_length, local.y.abs() - f.half_width);
            let outside = dx.max(dy).max(-0.5);
            if outside < CONTACT_REACH_M {
                open = open.min(0.15 + 0.85 * smooth(-0.5, CONTACT_REACH_M, outside));
            }
        }
        open
    }
}

fn bins_last(count: i32) -> i32 {
    count - 1
}
