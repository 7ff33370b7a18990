//! Draws the embedded sprites: a car and a pedestrian from behind and from the side, and a crate.
//!
//! Each is a solid given by its distance function and met by marching along the rays of a pinhole
//! camera 1.65 m above the ground and 14 m away: lit by a sun and a sky, smoothed by 4x4 rays a
//! pixel, with a faint shadow on the ground (alpha below one half, so that it is no part of the
//! object). Only additions, multiplications, divisions and square roots are used, which give the
//! same bits on every platform.
//!
//! `cargo run -p strat-bench --example draw_sprites` writes the files anew; a test of
//! `bench/tests/it/cues.rs` holds the committed ones against this program.

use std::ops::{Add, Mul, Sub};

/// A sprite to draw.
#[derive(Clone, Copy)]
pub struct Drawing {
    /// Its file.
    pub file: &'static str,
    pub width: u32,
    pub height: u32,
    /// Pixel (column, row) where the vertical axis of the front plane meets the ground.
    pub anchor: [f64; 2],
    /// Pixels per metre in the plane of the object's front.
    pub scale: f64,
    /// How far the front plane is before the object's middle, metres.
    front: f64,
    /// Cosine and sine of the turn about the vertical axis.
    turn: [f64; 2],
    solid: fn(V) -> Sample,
}

/// All sprites.
pub const DRAWINGS: [Drawing; 5] = [
    Drawing {
        file: "car_rear.png",
        width: 330,
        height: 250,
        anchor: [165.0, 234.0],
        scale: 148.0,
        front: 2.05,
        turn: [1.0, 0.0],
        solid: car,
    },
    Drawing {
        file: "car_side.png",
        width: 490,
        height: 182,
        anchor: [245.0, 166.0],
        scale: 106.0,
        front: 0.88,
        turn: [0.0, 1.0],
        solid: car,
    },
    Drawing {
        file: "pedestrian_rear.png",
        width: 140,
        height: 256,
        anchor: [70.0, 240.0],
        scale: 134.0,
        front: 0.15,
        turn: [1.0, 0.0],
        solid: pedestrian,
    },
    Drawing {
        file: "pedestrian_side.png",
        width: 170,
        height: 256,
        anchor: [85.0, 240.0],
        scale: 134.0,
        front: 0.22,
        turn: [0.0, 1.0],
        solid: pedestrian,
    },
    Drawing {
        file: "crate.png",
        width: 380,
        height: 246,
        anchor: [190.0, 228.0],
        scale: 190.0,
        front: 0.68,
        turn: [0.921_060_994, 0.389_418_342],
        solid: crate_box,
    },
];

const CAMERA_HEIGHT: f64 = 1.65;
const CAMERA_DISTANCE: f64 = 14.0;
/// Rays along each side of a pixel.
const RAYS: u32 = 4;
/// Towards the sun, of unit length: above, to the left and behind the camera.
const SUN: V = V(-0.48, 0.64, 0.6);

#[derive(Clone, Copy)]
pub struct V(f64, f64, f64);

impl Add for V {
    type Output = V;
    fn add(self, o: V) -> V {
        V(self.0 + o.0, self.1 + o.1, self.2 + o.2)
    }
}

impl Sub for V {
    type Output = V;
    fn sub(self, o: V) -> V {
        V(self.0 - o.0, self.1 - o.1, self.2 - o.2)
    }
}

impl Mul<f64> for V {
    type Output = V;
    fn mul(self, k: f64) -> V {
        V(self.0 * k, self.1 * k, self.2 * k)
    }
}

impl V {
    fn dot(self, o: V) -> f64 {
        self.0 * o.0 + self.1 * o.1 + self.2 * o.2
    }
    fn length(self) -> f64 {
        self.dot(self).sqrt()
    }
    fn unit(self) -> V {
        self * (1.0 / self.length())
    }
    fn each(self, o: V) -> V {
        V(self.0 * o.0, self.1 * o.1, self.2 * o.2)
    }
}

/// Distance to a solid and what is there.
#[derive(Clone, Copy)]
pub struct Sample {
    distance: f64,
    colour: V,
    /// Share of light that is mirrored when seen from the front.
    gloss: f64,
}

fn thing(distance: f64, colour: V, gloss: f64) -> Sample {
    Sample {
        distance,
        colour,
        gloss,
    }
}

fn nearer(a: Sample, b: Sample) -> Sample {
    if b.distance < a.distance { b } else { a }
}

/// A box of these half sizes with edges rounded off by `radius`.
fn rounded_box(p: V, half: V, radius: f64) -> f64 {
    let q = V(
        p.0.abs() - half.0 + radius,
        p.1.abs() - half.1 + radius,
        p.2.abs() - half.2 + radius,
    );
    let outside = V(q.0.max(0.0), q.1.max(0.0), q.2.max(0.0)).length();
    outside + q.0.max(q.1).max(q.2).min(0.0) - radius
}

/// A rod from `a` to `b`, of radius `ra` here and `rb` there.
fn rod(p: V, a: V, b: V, ra: f64, rb: f64) -> f64 {
    let (pa, ba) = (p - a, b - a);
    let along = (pa.dot(ba) / ba.dot(ba)).clamp(0.0, 1.0);
    (pa - ba * along).length() - (ra + (rb - ra) * along)
}

fn ellipsoid(p: V, radii: V) -> f64 {
    let q = V(p.0 / radii.0, p.1 / radii.1, p.2 / radii.2).length();
    (q - 1.0) * radii.0.min(radii.1).min(radii.2)
}

/// A disc with its axis along x and a rounded rim.
fn disc(p: V, radius: f64, half: f64) -> f64 {
    let round = 0.03;
    let (r, x) = (
        (p.1 * p.1 + p.2 * p.2).sqrt() - radius + round,
        p.0.abs() - half + round,
    );
    let outside = (r.max(0.0) * r.max(0.0) + x.max(0.0) * x.max(0.0)).sqrt();
    outside + r.max(x).min(0.0) - round
}

/// The lesser of two distances with the crease filled over `width`.
fn blend(a: f64, b: f64, width: f64) -> f64 {
    let h = (0.5 + 0.5 * (b - a) / width).clamp(0.0, 1.0);
    b + (a - b) * h - width * h * (1.0 - h)
}

fn between(x: f64, low: f64, high: f64) -> bool {
    x >= low && x <= high
}

/// Paint, glass, lamps and gaps of a hatchback of 4.1 m x 1.76 m x 1.47 m; +z is its rear.
fn car(p: V) -> Sample {
    let paint = V(0.075, 0.135, 0.24);
    let dark = V(0.020, 0.021, 0.023);
    let glass = V(0.015, 0.020, 0.024);
    let x = p.0.abs();
    // The flanks lean in above the belt line, and the nose is lower than the tail.
    let lean = ((p.1 - 0.62) * 0.10).max(0.0);
    let slope = ((-p.2 - 0.6) * 0.11).max(0.0);
    let body = rounded_box(
        V(p.0 * (1.0 + lean), p.1 - 0.575 + 0.5 * slope, p.2),
        V(0.875, 0.375 - 0.5 * slope, 2.04),
        0.16,
    );
    let rise = ((p.1 - 0.85) / 0.6).clamp(0.0, 1.0);
    let (half_width, rear, nose) = (0.80 - 0.17 * rise, 1.86 - 0.42 * rise, -1.05 + 0.62 * rise);
    let middle = 0.5 * (rear + nose);
    let cabin = rounded_box(
        V(p.0, p.1 - 1.06, p.2 - middle),
        V(half_width, 0.405, 0.5 * (rear - nose)),
        0.15,
    ) * 0.88;
    let mut shell = blend(body, cabin, 0.10);
    // Wheel arches are open to the outside.
    for z in [-1.24, 1.26] {
        let q = V(x - 0.95, p.1 - 0.33, p.2 - z);
        shell = shell.max(-disc(q, 0.385, 0.32));
    }
    let at_rear = p.2 > 1.3;
    let flank = p.0.abs() > half_width - 0.10;
    // Panes end well before the roof's edge.
    let pane_rear = at_rear && between(p.1, 0.98, 1.33) && x < half_width - 0.12;
    let pane_side = flank
        && between(p.1, 0.98, 1.34)
        && between(p.2, nose + 0.34, rear - 0.26)
        && !between(p.2, 0.26, 0.34);
    let screen = p.2 < nose + 0.25 && p.1 > 0.97 && p.1 < 1.36 && x < half_width - 0.10;
    let lamp = p.2 > 1.75 && between(x, 0.56, 0.86) && between(p.1, 0.70, 0.93);
    let indicator = lamp && between(p.1, 0.70, 0.755);
    let plate = p.2 > 1.9 && x < 0.26 && between(p.1, 0.50, 0.615);
    let plate_rim = plate && (x > 0.245 || !between(p.1, 0.512, 0.603));
    let letters = plate && !plate_rim && between(p.1, 0.532, 0.585) && x < 0.22 && {
        let cell = (p.0 + 0.22) / 0.055;
        let (index, place) = (cell.floor(), cell - cell.floor());
        place > 0.25 && (index - 3.0).abs() > 0.5
    };
    let bumper = p.1 < 0.345 && p.2.abs() > 1.3;
    let sill = p.1 < 0.275;
    let lid = p.2 > 1.5
        && p.1 < 0.98
        && ((p.1 - 0.455).abs() < 0.008 && x < 0.80
            || (x - 0.80).abs() < 0.007 && p.1 > 0.455 && !lamp);
    let door = flank_line(p, x);
    let handle = x > 0.78
        && between(p.1, 0.80, 0.835)
        && (between(p.2, 0.05, 0.22) || between(p.2, 1.02, 1.17));
    let head_lamp = p.2 < -1.72 && between(p.1, 0.58, 0.74) && x > 0.45;
    let car = if pane_rear || pane_side || screen {
        thing(shell, glass, 0.10)
    } else if head_lamp {
        thing(shell, V(0.55, 0.57, 0.58), 0.2)
    } else if indicator {
        thing(shell, V(0.75, 0.35, 0.06), 0.10)
    } else if lamp {
        thing(shell, V(0.50, 0.012, 0.012), 0.12)
    } else if letters || plate_rim {
        thing(shell, dark, 0.0)
    } else if plate {
        thing(shell, V(0.72, 0.72, 0.69), 0.02)
    } else if bumper || sill || lid || door {
        thing(shell, dark, 0.02)
    } else if handle {
        thing(shell, paint * 0.5, 0.10)
    } else {
        thing(shell, paint, 0.06)
    };
    let mut all = car;
    for z in [-1.24, 1.26] {
        let q = V(x - 0.755, p.1 - 0.315, p.2 - z);
        let r = (q.1 * q.1 + q.2 * q.2).sqrt();
        // Ten spokes: five lines through the hub.
        let spoke = [
            (1.0, 0.0),
            (0.309, 0.951),
            (-0.809, 0.588),
            (-0.809, -0.588),
            (0.309, -0.951),
        ]
        .iter()
        .any(|&(c, s): &(f64, f64)| (q.1 * c + q.2 * s).abs() < 0.018 + 0.04 * r);
        let rim = r < 0.215 && q.0 > 0.0;
        let colour = if rim && (spoke || !between(r, 0.05, 0.19)) {
            V(0.42, 0.43, 0.45)
        } else if rim {
            V(0.05, 0.05, 0.055)
        } else {
            V(0.018, 0.018, 0.019)
        };
        let wheel = disc(q, 0.315, 0.115);
        all = nearer(all, thing(wheel, colour, if rim { 0.08 } else { 0.0 }));
    }
    // Mirrors.
    let mirror = ellipsoid(V(x - 0.94, p.1 - 0.98, p.2 + 0.62), V(0.10, 0.07, 0.06));
    nearer(all, thing(mirror, paint, 0.06))
}

/// Gaps of the doors on a flank.
fn flank_line(p: V, x: f64) -> bool {
    x > 0.6
        && between(p.1, 0.36, 0.97)
        && [-0.72, 0.30, 1.28]
            .iter()
            .any(|z: &f64| (p.2 - z).abs() < 0.009)
}

/// A person of 1.75 m, walking away; +z is the back.
fn pedestrian(p: V) -> Sample {
    let jacket = V(0.30, 0.055, 0.045);
    let trousers = V(0.050, 0.062, 0.095);
    let shoes = V(0.028, 0.025, 0.022);
    let skin = V(0.52, 0.33, 0.24);
    let hair = V(0.050, 0.032, 0.020);
    // The left leg is behind, the right one in front; arms swing against them.
    let (hip_l, hip_r) = (V(-0.095, 0.90, 0.0), V(0.095, 0.90, 0.0));
    let (knee_l, knee_r) = (V(-0.105, 0.49, 0.07), V(0.105, 0.50, -0.15));
    let (foot_l, foot_r) = (V(-0.11, 0.10, 0.25), V(0.11, 0.085, -0.20));
    let legs = rod(p, hip_l, knee_l, 0.098, 0.068)
        .min(rod(p, knee_l, foot_l, 0.070, 0.052))
        .min(rod(p, hip_r, knee_r, 0.098, 0.068))
        .min(rod(p, knee_r, foot_r, 0.070, 0.052));
    let shoe = |foot: V, lift: f64| {
        rod(
            p,
            V(foot.0, 0.052 + lift, foot.2 + 0.03),
            V(foot.0, 0.045, foot.2 - 0.16),
            0.055,
            0.045,
        )
    };
    let feet = shoe(foot_l, 0.035).min(shoe(foot_r, 0.0));
    // Flattened from front to back.
    let q = V(p.0, p.1, p.2 * 1.45);
    let chest = rod(q, V(-0.105, 1.33, 0.0), V(0.105, 1.33, 0.0), 0.135, 0.135);
    let waist = rod(q, V(-0.085, 0.95, 0.0), V(0.085, 0.95, 0.0), 0.135, 0.135);
    let trunk = blend(
        blend(chest, waist, 0.25),
        rod(q, V(0.0, 1.0, 0.0), V(0.0, 1.38, 0.0), 0.165, 0.155),
        0.12,
    ) * 0.72;
    let arm = |side: f64, elbow_z: f64, hand_z: f64| {
        let shoulder = V(side * 0.195, 1.395, 0.0);
        let elbow = V(side * 0.265, 1.12, elbow_z);
        let wrist = V(side * 0.255, 0.885, hand_z);
        (
            rod(p, shoulder, elbow, 0.070, 0.055).min(rod(p, elbow, wrist, 0.055, 0.045)),
            rod(p, wrist, V(side * 0.25, 0.80, hand_z - 0.02), 0.038, 0.034),
        )
    };
    let ((sleeve_l, hand_l), (sleeve_r, hand_r)) = (arm(-1.0, -0.02, -0.16), arm(1.0, 0.10, 0.09));
    let cloth = blend(trunk, sleeve_l.min(sleeve_r), 0.05);
    let neck = rod(p, V(0.0, 1.44, 0.01), V(0.0, 1.55, 0.0), 0.056, 0.052);
    let head = ellipsoid(V(p.0, p.1 - 1.632, p.2 + 0.015), V(0.078, 0.117, 0.098)) * 0.9;
    let mane = ellipsoid(V(p.0, p.1 - 1.655, p.2 - 0.012), V(0.087, 0.102, 0.100)) * 0.9;
    let skull = blend(neck, head, 0.03);
    let mut all = thing(legs, trousers, 0.0);
    // The hem of the jacket and a seam down its back.
    let seam = p.2 > 0.0 && p.0.abs() < 0.004 && p.1 > 0.95;
    let hem = between(p.1, 0.865, 0.885);
    let shade = if seam || hem { jacket * 0.55 } else { jacket };
    all = nearer(all, thing(cloth, shade, 0.01));
    all = nearer(all, thing(feet, shoes, 0.02));
    all = nearer(all, thing(hand_l.min(hand_r), skin, 0.01));
    all = nearer(all, thing(skull, skin, 0.01));
    nearer(all, thing(mane, hair, 0.02))
}

/// A wooden crate of 1 m: boards between a frame.
fn crate_box(p: V) -> Sample {
    let q = V(p.0, p.1 - 0.5, p.2);
    let (ax, ay, az) = (q.0.abs(), q.1.abs(), q.2.abs());
    // Coordinates on the face that is nearest: across and up the boards.
    let (across, up, face) = if ax >= ay && ax >= az {
        (q.2, q.1, 1.0)
    } else if az >= ay {
        (q.0, q.1, 2.0)
    } else {
        (q.0, q.2, 3.0)
    };
    let frame = across.abs() > 0.40 || up.abs() > 0.40;
    let brace = !frame && (across - up).abs() < 0.085;
    let inner = rounded_box(q, V(0.475, 0.475, 0.475), 0.01);
    let outer = rounded_box(q, V(0.5, 0.5, 0.5), 0.012);
    let solid = if frame || brace { outer } else { inner };
    // Along the grain and across it.
    let (board, along, cross) = if brace {
        (9.0, (across + up) * 0.7, across - up)
    } else if across.abs() > 0.40 {
        (if across > 0.0 { 7.0 } else { 8.0 }, up, across)
    } else if up.abs() > 0.40 {
        (if up > 0.0 { 5.0 } else { 6.0 }, across, up)
    } else {
        (((up + 0.40) / 0.16).floor(), across, up)
    };
    let place = (up + 0.40) / 0.16;
    let gap = !frame && !brace && (place - place.floor() < 0.05);
    let seam = (across.abs() - 0.40).abs() < 0.006 && up.abs() < 0.5
        || (up.abs() - 0.40).abs() < 0.006 && across.abs() < 0.40
        || !frame && ((across - up).abs() - 0.085).abs() < 0.008;
    let nail = frame && across.abs() > 0.40 && {
        let (dx, dy) = (
            across.abs() - 0.45,
            (up.abs() - 0.45).abs().min((up.abs() - 0.15).abs()),
        );
        dx * dx + dy * dy < 0.0002
    };
    let tint = 0.86 + 0.28 * hash((board + 11.0 * face) as i64, 3);
    let grain = 0.80
        + 0.22 * noise(along * 5.0 + 17.0 * board, cross * 70.0)
        + 0.14 * noise(along * 22.0, cross * 190.0 + 5.0 * board);
    let wood = V(0.50, 0.315, 0.155) * (tint * grain);
    let colour = if nail {
        V(0.07, 0.07, 0.075)
    } else if gap || seam {
        wood * 0.22
    } else {
        wood
    };
    // Crossing from frame to boards the distance jumps, so steps are kept short.
    thing(solid * 0.7, colour, 0.0)
}

/// A number in 0..1 from whole numbers.
fn hash(x: i64, y: i64) -> f64 {
    let mut h = (x as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15)
        ^ (y as u64).wrapping_mul(0xc2b2_ae3d_27d4_eb4f);
    h = (h ^ (h >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    h = (h ^ (h >> 32)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((h ^ (h >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
}

/// Smooth noise in 0..1 on a unit grid.
fn noise(x: f64, y: f64) -> f64 {
    let (fx, fy) = (x.floor(), y.floor());
    let smooth = |t: f64| t * t * (3.0 - 2.0 * t);
    let (u, v) = (smooth(x - fx), smooth(y - fy));
    let at = |dx: i64, dy: i64| hash(fx as i64 + dx, fy as i64 + dy);
    let top = at(0, 0) + (at(1, 0) - at(0, 0)) * u;
    let bottom = at(0, 1) + (at(1, 1) - at(0, 1)) * u;
    top + (bottom - top) * v
}

/// Light from a direction of the sky: bright above, grey ground below.
fn sky(direction: V) -> V {
    if direction.1 > 0.0 {
        let up = direction.1.min(1.0);
        V(0.80, 0.86, 0.95) * (1.0 - 0.45 * up) + V(-0.10, 0.0, 0.10) * up
    } else {
        V(0.20, 0.195, 0.185)
    }
}

impl Drawing {
    fn solid(&self, p: V) -> Sample {
        let [cos, sin] = self.turn;
        (self.solid)(V(p.0 * cos - p.2 * sin, p.1, p.0 * sin + p.2 * cos))
    }

    fn normal(&self, p: V) -> V {
        let e = 5e-4;
        let d = |o: V| self.solid(p + o).distance - self.solid(p - o).distance;
        V(d(V(e, 0.0, 0.0)), d(V(0.0, e, 0.0)), d(V(0.0, 0.0, e))).unit()
    }

    /// Where a ray enters the solid.
    fn march(&self, from: V, direction: V, start: f64, end: f64) -> Option<f64> {
        let mut t = start;
        for _ in 0..160 {
            let distance = self.solid(from + direction * t).distance;
            if distance < 4e-4 {
                return Some(t);
            }
            t += distance;
            if t > end {
                return None;
            }
        }
        None
    }

    /// How open a place is along its normal, 0 to 1.
    fn openness(&self, p: V, normal: V) -> f64 {
        let mut closed = 0.0;
        let mut weight = 0.55;
        for step in 1..=5 {
            let reach = 0.05 * f64::from(step);
            let q = p + normal * reach;
            let distance = self.solid(q).distance.min(q.1.max(0.0));
            closed += weight * (reach - distance).max(0.0) / reach;
            weight *= 0.6;
        }
        (1.0 - closed).clamp(0.0, 1.0)
    }

    fn shaded(&self, p: V, view: V) -> V {
        let normal = self.normal(p);
        let what = self.solid(p);
        let facing = normal.dot(SUN).max(0.0);
        let lit = if facing > 0.0 && self.march(p + normal * 0.01, SUN, 0.0, 4.0).is_none() {
            facing
        } else {
            0.0
        };
        let open = self.openness(p, normal);
        // Half from the sky, half from what the ground sends back.
        let above = 0.5 + 0.5 * normal.1;
        let ambient =
            V(0.42, 0.46, 0.52) * (above * open) + V(0.17, 0.165, 0.155) * ((1.0 - above) * open);
        let mut light = what.colour.each(V(1.50, 1.42, 1.28) * lit + ambient);
        if what.gloss > 0.0 {
            let mirrored = view - normal * (2.0 * view.dot(normal));
            let away = 1.0 + view.dot(normal).min(0.0);
            let strength = what.gloss + (1.0 - what.gloss) * away * away * away * away * away;
            let mut seen = sky(mirrored) * open;
            let glint = mirrored.dot(SUN).max(0.0);
            let sharp = glint * glint * glint * glint;
            let sharp = sharp * sharp * sharp * sharp;
            if lit > 0.0 {
                seen = seen + V(2.2, 2.1, 1.9) * (sharp * sharp);
            }
            light = light * (1.0 - strength) + seen * strength;
        }
        light
    }

    /// Alpha of the shadow on the ground; below one half everywhere.
    fn shadow(&self, p: V) -> f64 {
        let mut open: f64 = 1.0;
        for step in 1..=8 {
            let reach = 0.06 * f64::from(step);
            open = open.min(self.solid(p + V(0.0, reach, 0.0)).distance.max(0.0) / reach);
        }
        // Gone a quarter of a metre beside the object.
        let beside = self.solid(V(p.0, 0.3, p.2)).distance.max(0.0);
        let near = (1.0 - 4.0 * beside).clamp(0.0, 1.0);
        let dark = (1.0 - open) * near;
        0.46 * dark * (2.0 - dark)
    }

    /// Red, green, blue and alpha (not premultiplied) of one pixel.
    pub fn pixel(&self, column: u32, row: u32) -> [u8; 4] {
        let eye = V(0.0, CAMERA_HEIGHT, CAMERA_DISTANCE + self.front);
        let (mut sum, mut cover) = (V(0.0, 0.0, 0.0), 0.0);
        for ray in 0..RAYS * RAYS {
            let (i, j) = (ray % RAYS, ray / RAYS);
            let u = f64::from(column) + (f64::from(i) + 0.5) / f64::from(RAYS);
            let v = f64::from(row) + (f64::from(j) + 0.5) / f64::from(RAYS);
            let target = V(
                (u - self.anchor[0]) / self.scale,
                (self.anchor[1] - v) / self.scale,
                self.front,
            );
            let direction = (target - eye).unit();
            let (start, end) = (CAMERA_DISTANCE - 1.0, CAMERA_DISTANCE + 6.0);
            if let Some(t) = self.march(eye, direction, start, end) {
                sum = sum + self.shaded(eye + direction * t, direction);
                cover += 1.0;
            } else if direction.1 < 0.0 {
                let ground = eye + direction * (-eye.1 / direction.1);
                cover += self.shadow(ground);
            }
        }
        let rays = f64::from(RAYS * RAYS);
        let byte = |x: f64| (255.0 * x.clamp(0.0, 1.0) + 0.5) as u8;
        if cover == 0.0 {
            return [0; 4];
        }
        // The square root stands for the display's curve.
        let tone = |x: f64| byte((x / cover).clamp(0.0, 1.0).sqrt());
        [tone(sum.0), tone(sum.1), tone(sum.2), byte(cover / rays)]
    }

    /// The whole sprite, row by row, four bytes a pixel.
    pub fn pixels(&self) -> Vec<u8> {
        (0..self.width * self.height)
            .flat_map(|index| self.pixel(index % self.width, index / self.width))
            .collect()
    }
}
