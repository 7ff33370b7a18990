//! The solids that everything but the ground is made of, and where a ray meets them.
//!
//! A shape stands upright: it has a position, a yaw, and a form in its own frame
//! (x forward, y left, z up). Rays are given in world coordinates; `t` counts in
//! multiples of the ray's direction, which need not have unit length.

use crate::synth::noise::Textures;
use crate::synth::vector::{Rgb, V3, fast_max, fast_min, v3};

/// What a surface is made of; decides its look in [`crate::synth::shading`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Material {
    /// Plastered or brick front with a grid of windows on its upright faces.
    Facade,
    Plaster,
    Brick,
    Stone,
    Concrete,
    RoofTiles,
    Wood,
    /// Upright boards with gaps that can be seen through.
    Pickets,
    Bark,
    /// Foliage with holes (only on ellipsoids).
    Leaves,
    /// Foliage without holes.
    Hedge,
    Metal,
    CarBody,
    CarCabin,
    VanBody,
    CargoBox,
    BusBody,
    Tyre,
    Cloth,
    Skin,
    SignPlate,
    SignBack,
    SignalHead,
    Hill,
}

/// Appearance of a shape.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Skin {
    pub material: Material,
    pub paint: Rgb,
    /// Second colour: frames, trousers, stripes, window panes.
    pub trim: Rgb,
    /// Material-specific sizes in metres.
    pub sizes: [f32; 4],
    pub seed: u32,
}

/// Geometry in the shape's own frame.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Form {
    /// Between `low` and `high` of the shape.
    Block,
    /// Centred at the origin, radii = `high`, and one over them.
    Ellipsoid { inverse: V3 },
    /// Upright cylinder of radius `high.x`, from `low.z` to `high.z`.
    Pillar,
    /// Lying cylinder, axis along y, radius `high.x`, hollow within `inner`.
    Drum { inner: f32 },
    /// Rounded rod.
    Rod { from: V3, to: V3, radius: f32 },
    /// Convex body: planes `first..first + count` of the scene.
    Convex { first: u32, count: u32 },
}

/// A thing in the world.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Shape {
    pub centre: V3,
    pub cos: f32,
    pub sin: f32,
    pub low: V3,
    pub high: V3,
    pub form: Form,
    pub skin: Skin,
    /// Cityscapes label id (PROTOCOL 1.3).
    pub label: u8,
    /// Number of the object in the frame, 0 for stuff that is not counted.
    pub object: u16,
}

/// Points with `normal . p <= offset` are inside.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Plane {
    pub normal: V3,
    pub offset: f32,
}

/// Where a ray enters a shape.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Entry {
    pub t: f32,
    /// Outward normal in the shape's frame.
    pub normal: V3,
    /// For foliage: 0 outer shell, 1 middle, 2 core; else 0.
    pub shell: u8,
}

/// Nearest distance at which anything is seen.
const T_MIN: f32 = 1e-4;

/// Texels of the leaf tile per metre of foliage.
pub(crate) const LEAF_TEXELS_PER_M: f32 = 56.0;

impl Shape {
    /// World point to the shape's frame.
    pub fn local(&self, p: V3) -> V3 {
        (p - self.centre).turned(self.cos, -self.sin)
    }

    /// World direction to the shape's frame.
    pub fn local_direction(&self, d: V3) -> V3 {
        d.turned(self.cos, -self.sin)
    }

    /// Direction in the shape's frame to the world.
    pub fn world_direction(&self, d: V3) -> V3 {
        d.turned(self.cos, self.sin)
    }

    /// The eight corners of the bounding box in world coordinates.
    pub fn corners(&self) -> [V3; 8] {
        std::array::from_fn(|i| {
            let p = v3(
                if i & 1 == 0 { self.low.x } else { self.high.x },
                if i & 2 == 0 { self.low.y } else { self.high.y },
                if i & 4 == 0 { self.low.z } else { self.high.z },
            );
            self.centre + p.turned(self.cos, self.sin)
        })
    }

    /// First entry of a ray before `t_max`. `spread` is the width of the ray's
    /// footprint per unit of t: holes finer than that are closed.
    pub fn enter(
        &self,
        planes: &[Plane],
        textures: &Textures,
        origin: V3,
        direction: V3,
        t_max: f32,
        spread: f32,
    ) -> Option<Entry> {
        let o = self.local(origin);
        let d = self.local_direction(direction);
        let entry = match self.form {
            Form::Block => block(o, d, self.low, self.high)?,
            Form::Ellipsoid { inverse } => {
                if self.skin.material == Material::Leaves {
                    return foliage(self, textures, (o, d, inverse), t_max, spread);
                }
                ellipsoid(o, d, inverse)?
            }
            Form::Pillar => pillar(o, d, self.high.x, self.low.z, self.high.z)?,
            Form::Drum { inner } => drum(o, d, self.high.x, inner, self.high.y)?,
            Form::Rod { from, to, radius } => rod(o, d, from, to, radius)?,
            Form::Convex { first, count } => {
                convex(o, d, &planes[first as usize..(first + count) as usize])?
            }
        };
        if entry.t >= t_max {
            return None;
        }
        if self.skin.material == Material::Pickets {
            return pickets(self, o, d, entry, t_max);
        }
        Some(entry)
    }
}

fn reciprocal(d: V3) -> V3 {
    let safe = |x: f32| if x.abs() < 1e-12 { 1e12 } else { 1.0 / x };
    v3(safe(d.x), safe(d.y), safe(d.z))
}

fn block(o: V3, d: V3, low: V3, high: V3) -> Option<Entry> {
    let inv = reciprocal(d);
    let (ax, bx) = ((low.x - o.x) * inv.x, (high.x - o.x) * inv.x);
    let (ay, by) = ((low.y - o.y) * inv.y, (high.y - o.y) * inv.y);
    let (az, bz) = ((low.z - o.z) * inv.z, (high.z - o.z) * inv.z);
    let (nx, ny, nz) = (fast_min(ax, bx), fast_min(ay, by), fast_min(az, bz));
    let near = fast_max(fast_max(nx, ny), nz);
    let far = fast_min(
        fast_min(fast_max(ax, bx), fast_max(ay, by)),
        fast_max(az, bz),
    );
    if near > far || near < T_MIN {
        return None;
    }
    let normal = if near == nx {
        v3(-d.x.signum(), 0.0, 0.0)
    } else if near == ny {
        v3(0.0, -d.y.signum(), 0.0)
    } else {
        v3(0.0, 0.0, -d.z.signum())
    };
    Some(Entry {
        t: near,
        normal,
        shell: 0,
    })
}

fn ellipsoid(o: V3, d: V3, k: V3) -> Option<Entry> {
    let (so, sd) = (
        v3(o.x * k.x, o.y * k.y, o.z * k.z),
        v3(d.x * k.x, d.y * k.y, d.z * k.z),
    );
    let (a, b, c) = (sd.dot(sd), so.dot(sd), so.dot(so) - 1.0);
    let h = b * b - a * c;
    if h < 0.0 {
        return None;
    }
    let t = (-b - h.sqrt()) / a;
    if t < T_MIN {
        return None;
    }
    let p = so + sd * t;
    Some(Entry {
        t,
        normal: v3(p.x * k.x, p.y * k.y, p.z * k.z).unit(),
        shell: 0,
    })
}

/// Scale of the shells of a foliage blob and the share of each that is leaf, at the
/// outline and in the middle. Little leaf at the outline makes it ragged.
const SHELLS: [(f32, f32, f32); 3] = [(1.0, 0.28, 0.52), (0.86, 0.45, 0.72), (0.70, 1.0, 1.0)];

/// Foliage shows ever larger clumps the farther it is, so that some are always a few
/// pixels wide: the factor on texture coordinates for a footprint in texels.
pub(crate) fn leaf_scale(width: f32) -> f32 {
    let mut scale = 1.0;
    while width * scale > 3.0 && scale > 0.07 {
        scale *= 0.5;
    }
    scale
}

/// `ray`: origin and direction in the shape's frame, and one over the radii.
fn foliage(
    shape: &Shape,
    textures: &Textures,
    ray: (V3, V3, V3),
    t_max: f32,
    spread: f32,
) -> Option<Entry> {
    let (o, d, k) = ray;
    let (so, sd) = (
        v3(o.x * k.x, o.y * k.y, o.z * k.z),
        v3(d.x * k.x, d.y * k.y, d.z * k.z),
    );
    let (a, b, oo) = (sd.dot(sd), so.dot(sd), so.dot(so));
    let length = d.length();
    for (shell, &(scale, outline, middle)) in SHELLS.iter().enumerate() {
        let h = b * b - a * (oo - scale * scale);
        if h < 0.0 {
            return None;
        }
        let t = (-b - h.sqrt()) / a;
        if t >= t_max {
            return None;
        }
        if t < T_MIN {
            continue;
        }
        let p = so + sd * t;
        let normal = v3(p.x * k.x, p.y * k.y, p.z * k.z).unit();
        if outline < 1.0 {
            let (u, v) = leaf_coordinates(shape, o + d * t, normal);
            let facing = (-normal.dot(d) / length).clamp(0.0, 1.0);
            let cover = outline + (middle - outline) * facing;
            let width = spread * t * LEAF_TEXELS_PER_M;
            let scale = leaf_scale(width);
            if textures
                .leaves
                .at(u * scale, v * scale, 0.6 * width * scale)
                < 1.0 - cover
            {
                continue;
            }
        }
        return Some(Entry {
            t,
            normal,
            shell: shell as u8,
        });
    }
    None
}

/// Where on the leaf tile a point of a foliage blob lies (texels).
pub(crate) fn leaf_coordinates(shape: &Shape, local: V3, normal: V3) -> (f32, f32) {
    let (u, v) = planar(local, normal);
    let seed = shape.skin.seed;
    (
        u * LEAF_TEXELS_PER_M + (seed & 511) as f32,
        v * LEAF_TEXELS_PER_M + ((seed >> 9) & 511) as f32,
    )
}

/// Two of the three coordinates: those across the axis that the normal follows most.
pub(crate) fn planar(p: V3, normal: V3) -> (f32, f32) {
    let (x, y, z) = (normal.x.abs(), normal.y.abs(), normal.z.abs());
    if z >= x && z >= y {
        (p.x, p.y)
    } else if x >= y {
        (p.y, p.z)
    } else {
        (p.x, p.z)
    }
}

/// A board fence: passes through gaps between boards of the front face to the back.
fn pickets(shape: &Shape, o: V3, d: V3, entry: Entry, t_max: f32) -> Option<Entry> {
    let [pitch, board, ..] = shape.skin.sizes;
    let solid = |p: V3| {
        let phase = (p.x - shape.low.x) / pitch;
        let inside = (phase - floor(phase)) * pitch < board;
        let height = (p.z - shape.low.z) / (shape.high.z - shape.low.z);
        let rail = (height - 0.2).abs() < 0.05 || (height - 0.8).abs() < 0.05;
        inside || rail
    };
    if entry.normal.y == 0.0 || solid(o + d * entry.t) {
        return Some(entry);
    }
    // The far side of the same thin box.
    let back = if d.y > 0.0 { shape.high.y } else { shape.low.y };
    let t = (back - o.y) / d.y;
    let p = o + d * t;
    let within = p.x > shape.low.x && p.x < shape.high.x && p.z > shape.low.z && p.z < shape.high.z;
    (t < t_max && t > T_MIN && within && solid(p)).then_some(Entry { t, ..entry })
}

fn floor(x: f32) -> f32 {
    crate::synth::vector::floor_i32(x) as f32
}

fn pillar(o: V3, d: V3, radius: f32, low: f32, high: f32) -> Option<Entry> {
    let a = d.x * d.x + d.y * d.y;
    let b = o.x * d.x + o.y * d.y;
    let c = o.x * o.x + o.y * o.y - radius * radius;
    let h = b * b - a * c;
    if h < 0.0 {
        return None;
    }
    if a > 1e-14 {
        let t = (-b - h.sqrt()) / a;
        let z = o.z + t * d.z;
        if t > T_MIN && z >= low && z <= high {
            let normal = v3((o.x + t * d.x) / radius, (o.y + t * d.y) / radius, 0.0);
            return Some(Entry {
                t,
                normal,
                shell: 0,
            });
        }
    }
    let (cap, up) = if d.z < 0.0 { (high, 1.0) } else { (low, -1.0) };
    let t = (cap - o.z) / d.z;
    let (x, y) = (o.x + t * d.x, o.y + t * d.y);
    (t > T_MIN && x * x + y * y <= radius * radius).then_some(Entry {
        t,
        normal: v3(0.0, 0.0, up),
        shell: 0,
    })
}

fn drum(o: V3, d: V3, radius: f32, inner: f32, half: f32) -> Option<Entry> {
    let a = d.x * d.x + d.z * d.z;
    let b = o.x * d.x + o.z * d.z;
    let oo = o.x * o.x + o.z * o.z;
    let h = b * b - a * (oo - radius * radius);
    if h < 0.0 {
        return None;
    }
    let mut best: Option<Entry> = None;
    let mut offer = |t: f32, normal: V3| {
        if t > T_MIN && best.is_none_or(|e| t < e.t) {
            best = Some(Entry {
                t,
                normal,
                shell: 0,
            });
        }
    };
    if a > 1e-14 {
        let t = (-b - h.sqrt()) / a;
        if (o.y + t * d.y).abs() <= half {
            offer(
                t,
                v3((o.x + t * d.x) / radius, 0.0, (o.z + t * d.z) / radius),
            );
        }
        let hollow = b * b - a * (oo - inner * inner);
        if inner > 0.0 && hollow > 0.0 {
            // Inner wall, met on the way out of the hole.
            let t = (-b + hollow.sqrt()) / a;
            if (o.y + t * d.y).abs() <= half {
                offer(
                    t,
                    v3(-(o.x + t * d.x) / inner, 0.0, -(o.z + t * d.z) / inner),
                );
            }
        }
    }
    if d.y.abs() > 1e-12 {
        let side = -d.y.signum();
        let t = (side * half - o.y) / d.y;
        let (x, z) = (o.x + t * d.x, o.z + t * d.z);
        let r2 = x * x + z * z;
        if r2 <= radius * radius && r2 >= inner * inner {
            offer(t, v3(0.0, side, 0.0));
        }
    }
    best
}

fn rod(o: V3, d: V3, from: V3, to: V3, radius: f32) -> Option<Entry> {
    let ba = to - from;
    let oa = o - from;
    let (dd, baba, bard) = (d.dot(d), ba.dot(ba), ba.dot(d));
    let (baoa, rdoa, oaoa) = (ba.dot(oa), d.dot(oa), oa.dot(oa));
    let a = baba * dd - bard * bard;
    let b = baba * rdoa - baoa * bard;
    let c = baba * oaoa - baoa * baoa - radius * radius * baba;
    let h = b * b - a * c;
    if h < 0.0 {
        return None;
    }
    let t = (-b - h.sqrt()) / a.max(1e-20);
    let y = baoa + t * bard;
    if y > 0.0 && y < baba {
        let normal = (oa + d * t - ba * (y / baba)) * (1.0 / radius);
        return (t > T_MIN).then_some(Entry {
            t,
            normal,
            shell: 0,
        });
    }
    let oc = if y <= 0.0 { oa } else { o - to };
    let b = d.dot(oc);
    let h = b * b - dd * (oc.dot(oc) - radius * radius);
    if h < 0.0 {
        return None;
    }
    let t = (-b - h.sqrt()) / dd;
    (t > T_MIN).then(|| Entry {
        t,
        normal: (oc + d * t) * (1.0 / radius),
        shell: 0,
    })
}

fn convex(o: V3, d: V3, planes: &[Plane]) -> Option<Entry> {
    let (mut near, mut far) = (-1e30_f32, 1e30_f32);
    let mut normal = v3(0.0, 0.0, 1.0);
    for plane in planes {
        let towards = plane.normal.dot(d);
        let gap = plane.offset - plane.normal.dot(o);
        if towards.abs() < 1e-12 {
            if gap < 0.0 {
                return None;
            }
            continue;
        }
        let t = gap / towards;
        if towards < 0.0 {
            if t > near {
                near = t;
                normal = plane.normal;
            }
        } else {
            far = fast_min(far, t);
        }
        if near > far {
            return None;
        }
    }
    (near > T_MIN).then_some(Entry {
        t: near,
        normal,
        shell: 0,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shape(form: Form, low: V3, high: V3) -> Shape {
        Shape {
            centre: v3(10.0, 0.0, 0.0),
            cos: 0.8,
            sin: 0.6,
            low,
            high,
            form,
            skin: Skin {
                material: Material::Plaster,
                paint: [0.5; 3],
                trim: [0.5; 3],
                sizes: [0.0; 4],
                seed: 0,
            },
            label: 11,
            object: 0,
        }
    }

    /// Every form, hit from all around, is entered at a point of its surface that
    /// lies in its bounding box, with an outward normal that faces the ray.
    #[test]
    fn entries_lie_on_the_surface_and_face_the_ray() {
        let planes = [
            Plane {
                normal: v3(1.0, 0.0, 0.0),
                offset: 1.0,
            },
            Plane {
                normal: v3(-0.6, 0.0, 0.8),
                offset: 1.0,
            },
            Plane {
                normal: v3(0.0, 1.0, 0.0),
                offset: 0.5,
            },
            Plane {
                normal: v3(0.0, -1.0, 0.0),
                offset: 0.5,
            },
            Plane {
                normal: v3(0.0, 0.0, -1.0),
                offset: 0.0,
            },
        ];
        let textures = Textures::new();
        let (low, high) = (v3(-1.0, -0.5, -0.7), v3(1.0, 0.5, 0.7));
        let forms = [
            (Form::Block, low, high),
            (
                Form::Ellipsoid {
                    inverse: v3(1.0, 2.0, 1.0 / 0.7),
                },
                low,
                high,
            ),
            (Form::Pillar, v3(-0.6, -0.6, -0.7), v3(0.6, 0.6, 0.7)),
            (
                Form::Drum { inner: 0.4 },
                v3(-0.6, -0.2, -0.6),
                v3(0.6, 0.2, 0.6),
            ),
            (
                Form::Rod {
                    from: v3(-0.5, 0.1, -0.3),
                    to: v3(0.6, -0.2, 0.4),
                    radius: 0.1,
                },
                v3(-0.6, -0.3, -0.4),
                v3(0.7, 0.2, 0.5),
            ),
            (
                Form::Convex { first: 0, count: 5 },
                v3(-1.7, -0.5, 0.0),
                v3(1.0, 0.5, 2.0),
            ),
        ];
        for (form, low, high) in forms {
            let shape = shape(form, low, high);
            let mut hits = 0;
            for i in 0..400_i16 {
                let a = f32::from(i) * 0.7;
                let target = v3(10.0 + (a * 0.7).sin() * 0.5, (a * 1.3).cos() * 0.3, 0.2);
                let origin = v3(10.0 + 6.0 * a.cos(), 6.0 * a.sin(), (a * 0.37).sin() * 3.0);
                let d = target - origin;
                let Some(entry) = shape.enter(&planes, &textures, origin, d, 1e9, 0.0) else {
                    continue;
                };
                hits += 1;
                let p = shape.local(origin + d * entry.t);
                let slack = 1e-3;
                assert!(
                    p.x > low.x - slack
                        && p.x < high.x + slack
                        && p.y > low.y - slack
                        && p.y < high.y + slack
                        && p.z > low.z - slack
                        && p.z < high.z + slack,
                    "{form:?} {p:?}"
                );
                assert!(
                    (entry.normal.length() - 1.0).abs() < 1e-3,
                    "{form:?} {entry:?}"
                );
                assert!(entry.normal.dot(shape.local_direction(d)) < 0.0, "{form:?}");
            }
            assert!(hits > 60, "{form:?}: {hits}");
        }
    }
}
