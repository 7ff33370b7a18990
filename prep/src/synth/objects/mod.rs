//! Recipes: how cars, people, trees, houses and street furniture are put together
//! from [`crate::synth::geometry::shapes`].

use crate::synth::geometry::shapes::{Form, Material, Plane, Shape, Skin};
use crate::synth::random::Dice;
use crate::synth::vector::{Rgb, V3, blend, dim, v3};

/// Cityscapes label ids (PROTOCOL 1.3).
pub(crate) mod label {
    pub const STATIC: u8 = 4;
    pub const ROAD: u8 = 7;
    pub const SIDEWALK: u8 = 8;
    pub const PARKING: u8 = 9;
    pub const BUILDING: u8 = 11;
    pub const WALL: u8 = 12;
    pub const FENCE: u8 = 13;
    pub const GUARD_RAIL: u8 = 14;
    pub const POLE: u8 = 17;
    pub const TRAFFIC_LIGHT: u8 = 19;
    pub const TRAFFIC_SIGN: u8 = 20;
    pub const VEGETATION: u8 = 21;
    pub const TERRAIN: u8 = 22;
    pub const SKY: u8 = 23;
    pub const PERSON: u8 = 24;
    pub const RIDER: u8 = 25;
    pub const CAR: u8 = 26;
    pub const TRUCK: u8 = 27;
    pub const BUS: u8 = 28;
    pub const BICYCLE: u8 = 33;
}

/// A position on the ground with a heading.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Place {
    pub at: V3,
    pub cos: f32,
    pub sin: f32,
}

impl Place {
    /// A place given in this one's frame, heading turned by a quarter times `quarters`.
    pub fn offset(self, by: V3, quarters: u32) -> Place {
        let at = self.at + by.turned(self.cos, self.sin);
        let (cos, sin) = match quarters % 4 {
            0 => (self.cos, self.sin),
            1 => (-self.sin, self.cos),
            2 => (-self.cos, -self.sin),
            _ => (self.sin, -self.cos),
        };
        Place { at, cos, sin }
    }
}

/// Collects the shapes of one frame.
#[derive(Default)]
pub(crate) struct Builder {
    pub shapes: Vec<Shape>,
    pub planes: Vec<Plane>,
    /// Footprints of vehicles, for the shade under them.
    pub footprints: Vec<Footprint>,
    objects: u16,
}

/// A rectangle on the ground that something stands closely above.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Footprint {
    pub at: V3,
    pub cos: f32,
    pub sin: f32,
    pub half_length: f32,
    pub half_width: f32,
}

/// A skin with one colour.
pub(crate) fn skin(material: Material, paint: Rgb, seed: u32) -> Skin {
    Skin {
        material,
        paint,
        trim: dim(paint, 0.5),
        sizes: [0.0; 4],
        seed,
    }
}

impl Builder {
    /// Number for the next counted object.
    pub fn next_object(&mut self) -> u16 {
        self.objects = if self.objects >= 255 {
            255
        } else {
            self.objects + 1
        };
        self.objects
    }

    fn push(&mut self, place: Place, low: V3, high: V3, form: Form, skin: Skin, tag: Tag) {
        self.shapes.push(Shape {
            centre: place.at,
            cos: place.cos,
            sin: place.sin,
            low,
            high,
            form,
            skin,
            label: tag.0,
            object: tag.1,
        });
    }

    /// A block between two corners of the place's frame.
    pub fn block(&mut self, place: Place, low: V3, high: V3, skin: Skin, tag: Tag) {
        self.push(place, low, high, Form::Block, skin, tag);
    }

    /// An ellipsoid around a point of the place's frame.
    pub fn ellipsoid(&mut self, place: Place, centre: V3, radii: V3, skin: Skin, tag: Tag) {
        let inverse = v3(1.0 / radii.x, 1.0 / radii.y, 1.0 / radii.z);
        self.push(
            place.offset(centre, 0),
            -radii,
            radii,
            Form::Ellipsoid { inverse },
            skin,
            tag,
        );
    }

    /// An upright cylinder.
    pub fn pillar(
        &mut self,
        place: Place,
        foot: V3,
        radius: f32,
        height: f32,
        skin: Skin,
        tag: Tag,
    ) {
        self.push(
            place.offset(foot, 0),
            v3(-radius, -radius, 0.0),
            v3(radius, radius, height),
            Form::Pillar,
            skin,
            tag,
        );
    }

    /// A lying cylinder across the place's heading.
    pub fn drum(&mut self, place: Place, centre: V3, size: (f32, f32, f32), skin: Skin, tag: Tag) {
        let (radius, inner, half) = size;
        self.push(
            place.offset(centre, 0),
            v3(-radius, -half, -radius),
            v3(radius, half, radius),
            Form::Drum { inner },
            skin,
            tag,
        );
    }

    /// A rounded rod between two points of the place's frame.
    pub fn rod(&mut self, place: Place, from: V3, to: V3, radius: f32, skin: Skin, tag: Tag) {
        let r = v3(radius, radius, radius);
        self.push(
            place,
            from.min(to) - r,
            from.max(to) + r,
            Form::Rod { from, to, radius },
            skin,
            tag,
        );
    }

    /// A body with the convex side view `profile` (x, z; anticlockwise seen from the
    /// right, i.e. from -y) whose half width shrinks from `wide.0` at z = `wide.1`
    /// by `wide.2` per metre of height.
    pub fn hull(
        &mut self,
        place: Place,
        profile: &[(f32, f32)],
        wide: (f32, f32, f32),
        skin: Skin,
        tag: Tag,
    ) {
        let first = self.planes.len() as u32;
        let (mut low, mut high) = (v3(1e9, 0.0, 1e9), v3(-1e9, 0.0, -1e9));
        for (i, &(x, z)) in profile.iter().enumerate() {
            let (nx, nz) = profile[(i + 1) % profile.len()];
            let normal = v3(nz - z, 0.0, x - nx).unit();
            self.planes.push(Plane {
                normal,
                offset: normal.x * x + normal.z * z,
            });
            low = low.min(v3(x, 0.0, z));
            high = high.max(v3(x, 0.0, z));
        }
        let (half, at, shrink) = wide;
        for side in [1.0, -1.0] {
            let normal = v3(0.0, side, shrink).unit();
            self.planes.push(Plane {
                normal,
                offset: (half + shrink * at) * normal.y.abs(),
            });
        }
        let reach = half + (shrink * (at - low.z)).max(0.0) + (shrink * (at - high.z)).max(0.0);
        low.y = -reach;
        high.y = reach;
        let count = self.planes.len() as u32 - first;
        self.push(place, low, high, Form::Convex { first, count }, skin, tag);
    }

    fn shade(&mut self, place: Place, half_length: f32, half_width: f32) {
        self.footprints.push(Footprint {
            at: place.at,
            cos: place.cos,
            sin: place.sin,
            half_length,
            half_width,
        });
    }
}

/// Label and object number.
pub(crate) type Tag = (u8, u16);

const TYRE: Rgb = [0.025, 0.025, 0.027];

/// Colours that cars are sold in.
fn car_paint(dice: &mut Dice) -> Rgb {
    let base: Rgb = dice.pick(&[
        [0.45, 0.46, 0.48],
        [0.50, 0.51, 0.52],
        [0.30, 0.31, 0.33],
        [0.03, 0.03, 0.035],
        [0.04, 0.045, 0.05],
        [0.58, 0.58, 0.57],
        [0.50, 0.50, 0.48],
        [0.03, 0.06, 0.18],
        [0.05, 0.10, 0.24],
        [0.33, 0.02, 0.02],
        [0.42, 0.05, 0.03],
        [0.04, 0.12, 0.07],
        [0.55, 0.42, 0.08],
        [0.24, 0.20, 0.14],
    ]);
    dim(base, dice.range(0.85, 1.15))
}

/// A passenger car that stands or drives at `place` (origin on the ground below its middle).
pub(crate) fn car(b: &mut Builder, place: Place, dice: &mut Dice) {
    let tag = (label::CAR, b.next_object());
    let seed = dice.bits() as u32;
    let paint = car_paint(dice);
    let length = dice.range(3.7, 4.7);
    let (front, rear) = (length / 2.0, -length / 2.0);
    let half = dice.range(0.82, 0.92);
    let roof = dice.range(1.38, 1.58);
    let belt = dice.range(0.86, 0.96);
    let wheel = dice.range(0.29, 0.33);
    let (axle_front, axle_rear) = (front - 0.82, rear + 0.78);
    let body = Skin {
        material: Material::CarBody,
        paint,
        trim: [0.05, 0.05, 0.055],
        sizes: [front, axle_front, axle_rear, wheel],
        seed,
    };
    b.hull(
        place,
        &[
            (rear + 0.08, 0.24),
            (front - 0.10, 0.22),
            (front, 0.38),
            (front - 0.03, 0.60),
            (front - 0.25, 0.74),
            (front - 1.05, belt),
            (rear + 0.25, belt + 0.02),
            (rear + 0.04, belt - 0.06),
            (rear, 0.45),
        ],
        (half, 0.55, 0.10),
        body,
        tag,
    );
    let style = dice.below(3);
    let screen = front - dice.range(1.0, 1.25);
    // Hatchback, saloon, estate: where the roof ends and how the rear falls.
    let (roof_end, rear_foot) = match style {
        0 => (rear + 0.75, rear + 0.18),
        1 => (rear + 1.35, rear + 0.62),
        _ => (rear + 0.38, rear + 0.10),
    };
    let cabin = Skin {
        material: Material::CarCabin,
        sizes: [screen, roof, belt, rear_foot],
        ..body
    };
    b.hull(
        place,
        &[
            (rear_foot, belt - 0.02),
            (screen, belt - 0.04),
            (screen - 0.78, roof - 0.04),
            (screen - 1.10, roof),
            (roof_end + 0.25, roof - 0.01),
            (roof_end, roof - 0.07),
        ],
        (half - 0.07, belt, 0.24),
        cabin,
        tag,
    );
    for x in [axle_front, axle_rear] {
        for side in [1.0, -1.0] {
            let centre = v3(x, side * (half - 0.09), wheel);
            b.drum(place, centre, (wheel, 0.0, 0.105), wheel_skin(seed), tag);
        }
    }
    for side in [1.0, -1.0] {
        let mirror = v3(screen - 0.28, side * (half + 0.04), belt + 0.06);
        b.ellipsoid(
            place,
            mirror,
            v3(0.07, 0.10, 0.07),
            Skin {
                material: Material::Metal,
                ..body
            },
            tag,
        );
    }
    b.shade(place, length / 2.0, half);
}

fn wheel_skin(seed: u32) -> Skin {
    Skin {
        material: Material::Tyre,
        paint: TYRE,
        trim: [0.35, 0.36, 0.38],
        sizes: [0.64, 0.0, 0.0, 0.0],
        seed,
    }
}

/// A delivery van.
pub(crate) fn van(b: &mut Builder, place: Place, dice: &mut Dice) {
    let tag = (label::CAR, b.next_object());
    let seed = dice.bits() as u32;
    let length = dice.range(4.7, 5.6);
    let (front, rear) = (length / 2.0, -length / 2.0);
    let half = dice.range(0.92, 1.0);
    let roof = dice.range(1.9, 2.5);
    let wheel = 0.33;
    let skin = Skin {
        material: Material::VanBody,
        paint: if dice.chance(0.6) {
            [0.56, 0.56, 0.54]
        } else {
            car_paint(dice)
        },
        trim: [0.04, 0.04, 0.045],
        sizes: [front, front - 0.85, rear + 0.95, roof],
        seed,
    };
    b.hull(
        place,
        &[
            (rear, 0.30),
            (front - 0.08, 0.28),
            (front, 0.45),
            (front - 0.08, 0.95),
            (front - 0.55, 1.15),
            (front - 1.25, roof - 0.1),
            (front - 1.55, roof),
            (rear + 0.08, roof),
            (rear, roof - 0.1),
        ],
        (half, 0.6, 0.035),
        skin,
        tag,
    );
    for x in [front - 0.85, rear + 0.95] {
        for side in [1.0, -1.0] {
            b.drum(
                place,
                v3(x, side * (half - 0.09), wheel),
                (wheel, 0.0, 0.11),
                wheel_skin(seed),
                tag,
            );
        }
    }
    b.shade(place, length / 2.0, half);
}

/// A lorry with a box.
pub(crate) fn truck(b: &mut Builder, place: Place, dice: &mut Dice) {
    let tag = (label::TRUCK, b.next_object());
    let seed = dice.bits() as u32;
    let length = dice.range(7.0, 10.0);
    let (front, rear) = (length / 2.0, -length / 2.0);
    let top = dice.range(3.1, 3.7);
    let cab = Skin {
        material: Material::VanBody,
        paint: car_paint(dice),
        trim: [0.04, 0.04, 0.045],
        sizes: [front, front - 0.9, -100.0, 2.9],
        seed,
    };
    b.hull(
        place,
        &[
            (front - 1.9, 0.5),
            (front, 0.45),
            (front, 1.3),
            (front - 0.12, 2.6),
            (front - 0.4, 2.9),
            (front - 1.9, 2.9),
        ],
        (1.18, 0.6, 0.01),
        cab,
        tag,
    );
    let cargo = Skin {
        material: Material::CargoBox,
        paint: blend(car_paint(dice), [0.60, 0.60, 0.58], 0.5),
        trim: car_paint(dice),
        sizes: [length, top, 0.0, 0.0],
        seed,
    };
    b.block(
        place,
        v3(rear, -1.25, 1.0),
        v3(front - 2.05, 1.25, top),
        cargo,
        tag,
    );
    let frame = skin(Material::Metal, [0.05, 0.05, 0.05], seed);
    b.block(
        place,
        v3(rear + 0.1, -0.9, 0.55),
        v3(front - 0.5, 0.9, 1.0),
        frame,
        tag,
    );
    for x in [front - 0.9, rear + 1.2, rear + 2.3] {
        for side in [1.0, -1.0] {
            b.drum(
                place,
                v3(x, side * 1.05, 0.48),
                (0.48, 0.0, 0.16),
                wheel_skin(seed),
                tag,
            );
        }
    }
    b.shade(place, length / 2.0, 1.25);
}

/// A city bus.
pub(crate) fn bus(b: &mut Builder, place: Place, dice: &mut Dice) {
    let tag = (label::BUS, b.next_object());
    let seed = dice.bits() as u32;
    let (front, rear) = (5.9, -5.9);
    let skin = Skin {
        material: Material::BusBody,
        paint: dice.pick(&[
            [0.60, 0.45, 0.05],
            [0.55, 0.06, 0.05],
            [0.65, 0.66, 0.66],
            [0.08, 0.2, 0.42],
        ]),
        trim: [0.03, 0.035, 0.04],
        sizes: [front, 3.0, 0.0, 0.0],
        seed,
    };
    b.hull(
        place,
        &[
            (rear, 0.35),
            (front, 0.33),
            (front, 1.1),
            (front - 0.15, 2.8),
            (front - 0.35, 3.0),
            (rear + 0.15, 3.0),
            (rear, 2.85),
        ],
        (1.25, 0.6, 0.01),
        skin,
        tag,
    );
    for x in [front - 2.6, rear + 3.2] {
        for side in [1.0, -1.0] {
            b.drum(
                place,
                v3(x, side * 1.12, 0.47),
                (0.47, 0.0, 0.15),
                wheel_skin(seed),
                tag,
            );
        }
    }
    b.shade(place, 5.9, 1.25);
}

const SKIN_TONES: [Rgb; 4] = [
    [0.60, 0.40, 0.30],
    [0.52, 0.33, 0.24],
    [0.32, 0.19, 0.12],
    [0.16, 0.09, 0.06],
];

fn cloth(dice: &mut Dice) -> Rgb {
    let c: Rgb = dice.pick(&[
        [0.05, 0.06, 0.10],
        [0.03, 0.03, 0.03],
        [0.40, 0.06, 0.05],
        [0.10, 0.20, 0.42],
        [0.55, 0.53, 0.48],
        [0.16, 0.24, 0.12],
        [0.62, 0.45, 0.10],
        [0.22, 0.15, 0.10],
        [0.68, 0.68, 0.70],
        [0.30, 0.12, 0.30],
    ]);
    dim(c, dice.range(0.8, 1.2))
}

/// A person; `stride` is the phase of walking in radians' stead, -1..1.
pub(crate) fn person(b: &mut Builder, place: Place, stride: f32, dice: &mut Dice) {
    let tag = (label::PERSON, b.next_object());
    let seed = dice.bits() as u32;
    let h = dice.range(1.55, 1.9) / 1.75;
    let trousers = skin(Material::Cloth, cloth(dice), seed);
    let coat = skin(Material::Cloth, cloth(dice), seed ^ 77);
    let face = skin(Material::Skin, dice.pick(&SKIN_TONES), seed);
    let hair = skin(
        Material::Cloth,
        dice.pick(&[[0.03, 0.02, 0.015], [0.15, 0.09, 0.04], [0.35, 0.32, 0.3]]),
        seed,
    );
    let p = |x: f32, y: f32, z: f32| v3(x * h, y * h, z * h);
    let step = 0.28 * stride;
    for (side, swing) in [(1.0_f32, step), (-1.0, -step)] {
        let hip = p(0.0, 0.09 * side, 0.88);
        let knee = p(0.5 * swing + 0.04, 0.09 * side, 0.48);
        let foot = p(swing, 0.09 * side, 0.07);
        b.rod(place, hip, knee, 0.085 * h, trousers, tag);
        b.rod(place, knee, foot, 0.065 * h, trousers, tag);
        b.rod(place, foot, foot + p(0.14, 0.0, -0.02), 0.05 * h, hair, tag);
        let shoulder = p(0.0, 0.21 * side, 1.40);
        let elbow = p(-0.5 * swing, 0.26 * side, 1.12);
        let hand = p(-0.8 * swing + 0.08, 0.25 * side, 0.88);
        b.rod(place, shoulder, elbow, 0.06 * h, coat, tag);
        b.rod(place, elbow, hand, 0.05 * h, coat, tag);
        b.ellipsoid(place, hand, p(0.05, 0.04, 0.06), face, tag);
    }
    b.ellipsoid(place, p(0.0, 0.0, 1.17), p(0.15, 0.22, 0.37), coat, tag);
    b.ellipsoid(place, p(0.01, 0.0, 1.61), p(0.10, 0.085, 0.125), face, tag);
    b.ellipsoid(
        place,
        p(-0.02, 0.0, 1.645),
        p(0.105, 0.095, 0.105),
        hair,
        tag,
    );
    b.shade(place, 0.12, 0.16);
}

/// A bicycle, with its rider if `ridden`.
pub(crate) fn bicycle(b: &mut Builder, place: Place, ridden: bool, pedal: f32, dice: &mut Dice) {
    let object = b.next_object();
    let tag = (label::BICYCLE, object);
    let seed = dice.bits() as u32;
    let metal = skin(Material::Metal, car_paint(dice), seed);
    let tyre = Skin {
        trim: TYRE,
        ..wheel_skin(seed)
    };
    for x in [-0.53, 0.53] {
        b.drum(place, v3(x, 0.0, 0.34), (0.34, 0.30, 0.022), tyre, tag);
        b.drum(place, v3(x, 0.0, 0.34), (0.04, 0.0, 0.05), metal, tag);
    }
    let (crank, saddle, head) = (
        v3(-0.08, 0.0, 0.32),
        v3(-0.22, 0.0, 0.88),
        v3(0.36, 0.0, 0.86),
    );
    for (from, to) in [
        (crank, saddle),
        (crank, head),
        (saddle, head),
        (v3(-0.53, 0.0, 0.34), crank),
        (v3(-0.53, 0.0, 0.34), saddle),
        (v3(0.53, 0.0, 0.34), v3(0.33, 0.0, 1.02)),
        (v3(0.28, 0.27, 1.05), v3(0.28, -0.27, 1.05)),
    ] {
        b.rod(place, from, to, 0.022, metal, tag);
    }
    b.rod(
        place,
        v3(-0.32, 0.0, 0.93),
        v3(-0.12, 0.0, 0.94),
        0.05,
        skin(Material::Cloth, TYRE, seed),
        tag,
    );
    if !ridden {
        return;
    }
    let tag = (label::RIDER, b.next_object());
    let trousers = skin(Material::Cloth, cloth(dice), seed);
    let coat = skin(Material::Cloth, cloth(dice), seed ^ 99);
    let face = skin(Material::Skin, dice.pick(&SKIN_TONES), seed);
    let helmet = skin(Material::Metal, cloth(dice), seed);
    for (side, phase) in [(1.0_f32, pedal), (-1.0, -pedal)] {
        let hip = v3(-0.20, 0.09 * side, 0.98);
        let foot = v3(-0.05 + 0.05 * phase, 0.11 * side, 0.30 - 0.16 * phase);
        let knee = v3(0.20, 0.11 * side, 0.70 - 0.10 * phase);
        b.rod(place, hip, knee, 0.085, trousers, tag);
        b.rod(place, knee, foot, 0.06, trousers, tag);
        b.rod(place, foot, foot + v3(0.13, 0.0, 0.0), 0.05, helmet, tag);
        let shoulder = v3(0.08, 0.20 * side, 1.45);
        b.rod(
            place,
            shoulder,
            v3(0.18, 0.26 * side, 1.20),
            0.055,
            coat,
            tag,
        );
        b.rod(
            place,
            v3(0.18, 0.26 * side, 1.20),
            v3(0.28, 0.24 * side, 1.07),
            0.045,
            coat,
            tag,
        );
    }
    b.rod(
        place,
        v3(-0.18, 0.0, 1.05),
        v3(0.02, 0.0, 1.38),
        0.185,
        coat,
        tag,
    );
    b.ellipsoid(place, v3(0.14, 0.0, 1.66), v3(0.10, 0.085, 0.12), face, tag);
    b.ellipsoid(
        place,
        v3(0.12, 0.0, 1.71),
        v3(0.13, 0.10, 0.09),
        helmet,
        tag,
    );
    b.shade(place, 0.5, 0.1);
}

/// Colour of foliage: green, and now and then yellow, brown or red.
pub(crate) fn leaf_colour(dice: &mut Dice) -> Rgb {
    let base: Rgb = dice.pick(&[
        [0.10, 0.17, 0.035],
        [0.08, 0.14, 0.03],
        [0.13, 0.19, 0.04],
        [0.06, 0.12, 0.035],
        [0.17, 0.19, 0.045],
        [0.22, 0.18, 0.04],
        [0.20, 0.11, 0.04],
    ]);
    dim(base, dice.range(0.8, 1.3))
}

/// A broad-leaved tree; `blobs` sets how finely the crown is made.
pub(crate) fn tree(b: &mut Builder, place: Place, height: f32, blobs: usize, dice: &mut Dice) {
    let tag = (label::VEGETATION, 0);
    let seed = dice.bits() as u32;
    let colour = leaf_colour(dice);
    let bark = skin(
        Material::Bark,
        dim([0.16, 0.12, 0.085], dice.range(0.6, 1.3)),
        seed,
    );
    let spread = height * dice.range(0.20, 0.34);
    let stem = height * dice.range(0.24, 0.40);
    let radius = 0.05 + height * 0.018;
    b.pillar(
        place,
        v3(0.0, 0.0, -0.1),
        radius,
        stem + 0.3 * (height - stem),
        bark,
        tag,
    );
    let crown = 0.5 * (height - stem);
    let middle = stem + crown;
    for i in 0..4.min(blobs) {
        // Boughs from the top of the stem into the crown.
        let a = i as f32 * 1.7 + dice.unit();
        let (s, c) = crate::synth::vector::sin_cos(f64::from(a));
        let to = v3(c as f32 * spread * 0.6, s as f32 * spread * 0.6, middle);
        b.rod(
            place,
            v3(0.0, 0.0, stem * 0.95),
            to,
            radius * 0.45,
            bark,
            tag,
        );
    }
    for i in 0..blobs {
        let turn = f64::from(i as u32) * 2.399_963 + f64::from(dice.range(0.0, 0.8));
        let (s, c) = crate::synth::vector::sin_cos(turn);
        let level = (i as f32 + 0.5) / blobs as f32 * 2.0 - 1.0;
        let ring = (1.0 - level * level * 0.8).sqrt() * spread * dice.range(0.35, 0.75);
        let centre = v3(
            c as f32 * ring,
            s as f32 * ring,
            middle + level * crown * 0.72,
        );
        let size = spread * dice.range(0.50, 0.72) * (1.0 - 0.25 * level.max(0.0));
        let radii = v3(
            size,
            size * dice.range(0.9, 1.1),
            size * dice.range(0.7, 0.95),
        );
        let leaves = Skin {
            material: Material::Leaves,
            paint: dim(colour, dice.range(0.85, 1.15)),
            trim: dim(colour, 0.4),
            sizes: [middle - crown + 0.3, 2.0 * crown, 0.0, 0.0],
            seed: seed.wrapping_add(i as u32 * 7919),
        };
        b.ellipsoid(place, centre, radii, leaves, tag);
    }
}

/// A conifer.
pub(crate) fn conifer(b: &mut Builder, place: Place, height: f32, tiers: usize, dice: &mut Dice) {
    let tag = (label::VEGETATION, 0);
    let seed = dice.bits() as u32;
    let colour = dim([0.045, 0.085, 0.035], dice.range(0.8, 1.4));
    let bark = skin(Material::Bark, [0.12, 0.08, 0.06], seed);
    b.pillar(
        place,
        v3(0.0, 0.0, -0.1),
        0.06 + height * 0.012,
        height * 0.5,
        bark,
        tag,
    );
    let width = height * dice.range(0.16, 0.22);
    for i in 0..tiers {
        let level = i as f32 / tiers as f32;
        let size = width * (1.05 - level);
        let leaves = Skin {
            material: Material::Leaves,
            paint: colour,
            trim: dim(colour, 0.4),
            sizes: [0.5, height, 0.0, 0.0],
            seed: seed.wrapping_add(i as u32 * 104_729),
        };
        let z = height * (0.16 + 0.80 * level);
        b.ellipsoid(
            place,
            v3(0.0, 0.0, z),
            v3(size, size, height / tiers as f32 * 0.95),
            leaves,
            tag,
        );
    }
}

/// A bush of a few blobs.
pub(crate) fn bush(b: &mut Builder, place: Place, size: f32, dice: &mut Dice) {
    let colour = leaf_colour(dice);
    for _ in 0..2 + dice.below(2) {
        let leaves = Skin {
            material: Material::Leaves,
            paint: dim(colour, dice.range(0.8, 1.2)),
            trim: dim(colour, 0.4),
            sizes: [0.0, 1.6 * size, 0.0, 0.0],
            seed: dice.bits() as u32,
        };
        let at = v3(
            dice.range(-0.6, 0.6) * size,
            dice.range(-0.4, 0.4) * size,
            0.5 * size,
        );
        let r = size * dice.range(0.55, 0.9);
        b.ellipsoid(place, at, v3(r, r, 0.8 * r), leaves, (label::VEGETATION, 0));
    }
}

/// What a building looks like.
#[derive(Clone, Copy, Debug)]
pub(crate) struct House {
    /// Along the street.
    pub width: f32,
    /// Away from the street.
    pub depth: f32,
    pub storeys: u32,
    pub gabled: bool,
    pub shop: bool,
}

fn wall_colour(dice: &mut Dice) -> Rgb {
    let c: Rgb = dice.pick(&[
        [0.62, 0.55, 0.40],
        [0.66, 0.62, 0.54],
        [0.58, 0.57, 0.54],
        [0.50, 0.36, 0.24],
        [0.42, 0.20, 0.13],
        [0.34, 0.16, 0.12],
        [0.60, 0.46, 0.26],
        [0.40, 0.44, 0.46],
        [0.70, 0.68, 0.64],
        [0.48, 0.50, 0.38],
        [0.55, 0.40, 0.34],
    ]);
    dim(c, dice.range(0.75, 1.1))
}

fn roof_colour(dice: &mut Dice) -> Rgb {
    let c: Rgb = dice.pick(&[
        [0.30, 0.11, 0.06],
        [0.24, 0.09, 0.06],
        [0.12, 0.08, 0.07],
        [0.10, 0.10, 0.11],
    ]);
    dim(c, dice.range(0.8, 1.2))
}

/// A house whose front (local -y side faces the street when `place` is turned so)
/// stands along x; both upright face pairs carry windows.
pub(crate) fn house(b: &mut Builder, place: Place, house: House, dice: &mut Dice) {
    let tag = (label::BUILDING, 0);
    let seed = dice.bits() as u32;
    let storey = dice.range(2.8, 3.4);
    let height = house.storeys as f32 * storey + dice.range(0.3, 0.8);
    let paint = wall_colour(dice);
    let bay = dice.range(1.9, 3.1);
    let facade = Skin {
        material: Material::Facade,
        paint,
        trim: if dice.chance(0.6) {
            [0.72, 0.71, 0.68]
        } else {
            dim(paint, 0.45)
        },
        sizes: [
            bay,
            storey,
            bay * dice.range(0.38, 0.6),
            storey * dice.range(0.42, 0.6),
        ],
        seed: (seed & !7) | u32::from(house.shop) | (u32::from(dice.chance(0.35)) << 1),
    };
    let (hw, hd) = (house.width / 2.0, house.depth / 2.0);
    b.block(place, v3(-hw, -hd, -0.5), v3(hw, hd, height), facade, tag);
    // Plinth and cornice stand out a little: small steps in depth along the front.
    let plinth = skin(
        Material::Stone,
        dim(blend(paint, [0.3, 0.3, 0.3], 0.6), 0.7),
        seed,
    );
    let tall = dice.range(0.4, 0.9);
    b.block(
        place,
        v3(-hw - 0.06, -hd - 0.06, -0.5),
        v3(hw + 0.06, hd + 0.06, tall),
        plinth,
        tag,
    );
    let cornice = skin(Material::Plaster, facade.trim, seed);
    b.block(
        place,
        v3(-hw - 0.2, -hd - 0.3, height - 0.25),
        v3(hw + 0.2, hd + 0.3, height),
        cornice,
        tag,
    );
    let roof = skin(Material::RoofTiles, roof_colour(dice), seed);
    if house.gabled {
        let rise = dice.range(0.6, 0.95) * hd;
        let (half, profile) = (
            hw + 0.2,
            [
                (-hd - 0.45, height - 0.05),
                (hd + 0.45, height - 0.05),
                (0.0, height + rise),
            ],
        );
        // The ridge runs along the street: the profile lies across it.
        b.hull(
            place.offset(v3(0.0, 0.0, 0.0), 1),
            &profile,
            (half, height, 0.0),
            roof,
            tag,
        );
        if dice.chance(0.7) {
            let x = dice.range(-0.6, 0.6) * hw;
            let y = dice.range(-0.3, 0.3) * hd;
            let brick = skin(Material::Brick, [0.30, 0.13, 0.09], seed);
            b.block(
                place,
                v3(x - 0.35, y - 0.3, height),
                v3(x + 0.35, y + 0.3, height + rise + 0.8),
                brick,
                tag,
            );
        }
        let dormers = dice.below(3);
        for i in 0..dormers {
            let x = ((i as f32 + 1.0) / (dormers as f32 + 1.0) * 2.0 - 1.0) * hw;
            for side in [1.0_f32, -1.0] {
                let y0 = side * hd * 0.72;
                let y1 = side * hd * 0.1;
                let window = Skin {
                    sizes: [1.5, 1.5, 0.9, 0.9],
                    seed: seed & !7,
                    ..facade
                };
                b.block(
                    place,
                    v3(x - 0.75, y0.min(y1), height),
                    v3(x + 0.75, y0.max(y1), height + rise * 0.28 + 1.3),
                    window,
                    tag,
                );
            }
        }
    } else {
        let parapet = skin(Material::Concrete, [0.40, 0.39, 0.37], seed);
        b.block(
            place,
            v3(-hw - 0.1, -hd - 0.1, height),
            v3(hw + 0.1, hd + 0.1, height + 0.5),
            parapet,
            tag,
        );
        if dice.chance(0.5) {
            b.block(
                place,
                v3(-1.8, -1.5, height),
                v3(1.6, 1.7, height + 2.6),
                parapet,
                tag,
            );
        }
    }
    if house.storeys >= 2 && dice.chance(0.4) {
        // Balconies on some bays of the street front.
        let bays = (house.width / bay) as usize;
        let every = 2 + dice.below(2);
        let slab = skin(Material::Concrete, [0.45, 0.44, 0.42], seed);
        let rail = skin(Material::Metal, dim(facade.trim, 0.6), seed);
        for i in (0..bays).step_by(every).take(5) {
            let x = ((i as f32 + 0.5) / bays as f32 * 2.0 - 1.0) * hw;
            for level in 1..house.storeys.min(5) {
                let z = level as f32 * storey - 0.1;
                b.block(
                    place,
                    v3(x - 1.0, -hd - 1.0, z),
                    v3(x + 1.0, -hd, z + 0.15),
                    slab,
                    tag,
                );
                b.block(
                    place,
                    v3(x - 1.0, -hd - 1.0, z + 0.15),
                    v3(x + 1.0, -hd - 0.93, z + 1.05),
                    rail,
                    tag,
                );
            }
        }
    }
}

/// A hall with few openings.
pub(crate) fn hall(b: &mut Builder, place: Place, size: V3, dice: &mut Dice) {
    let tag = (label::BUILDING, 0);
    let seed = dice.bits() as u32;
    let paint = dice.pick(&[
        [0.52, 0.53, 0.54],
        [0.30, 0.38, 0.46],
        [0.55, 0.50, 0.42],
        [0.36, 0.17, 0.12],
    ]);
    let facade = Skin {
        material: Material::Facade,
        paint,
        trim: dim(paint, 0.5),
        sizes: [5.0, size.z * 0.5, 3.2, 1.2],
        seed: seed & !7,
    };
    let (hx, hy) = (size.x / 2.0, size.y / 2.0);
    b.block(place, v3(-hx, -hy, -0.5), v3(hx, hy, size.z), facade, tag);
    let edge = skin(Material::Metal, dim(paint, 0.6), seed);
    b.block(
        place,
        v3(-hx - 0.1, -hy - 0.1, size.z),
        v3(hx + 0.1, hy + 0.1, size.z + 0.6),
        edge,
        tag,
    );
}

/// A lamp post with an arm over the street (towards local -y).
pub(crate) fn street_lamp(b: &mut Builder, place: Place, height: f32) {
    let tag = (label::POLE, 0);
    let metal = skin(Material::Metal, [0.22, 0.24, 0.24], 5);
    b.pillar(place, v3(0.0, 0.0, 0.0), 0.08, height, metal, tag);
    b.pillar(place, v3(0.0, 0.0, 0.0), 0.12, 1.1, metal, tag);
    b.rod(
        place,
        v3(0.0, 0.0, height - 0.05),
        v3(0.0, -1.5, height + 0.25),
        0.05,
        metal,
        tag,
    );
    b.block(
        place,
        v3(-0.12, -2.1, height + 0.16),
        v3(0.12, -1.3, height + 0.32),
        skin(Material::Metal, [0.40, 0.40, 0.38], 6),
        tag,
    );
}

/// A wooden pole for wires.
pub(crate) fn wire_pole(b: &mut Builder, place: Place) {
    let wood = skin(Material::Bark, [0.20, 0.15, 0.11], 9);
    b.pillar(place, v3(0.0, 0.0, 0.0), 0.13, 8.5, wood, (label::POLE, 0));
    b.rod(
        place,
        v3(0.0, -0.9, 7.9),
        v3(0.0, 0.9, 7.9),
        0.06,
        wood,
        (label::POLE, 0),
    );
}

/// A traffic sign that faces traffic coming along +x (it looks towards -x).
pub(crate) fn sign(b: &mut Builder, place: Place, dice: &mut Dice) {
    let post = skin(Material::Metal, [0.42, 0.43, 0.44], 3);
    let height = dice.range(2.2, 2.7);
    b.pillar(
        place,
        v3(0.0, 0.0, 0.0),
        0.038,
        height + 0.5,
        post,
        (label::POLE, 0),
    );
    let tag = (label::TRAFFIC_SIGN, 0);
    let kind = dice.below(4) as u32;
    let plate = Skin {
        material: Material::SignPlate,
        paint: [0.78, 0.78, 0.76],
        trim: [
            [0.55, 0.02, 0.02],
            [0.02, 0.10, 0.45],
            [0.70, 0.52, 0.03],
            [0.55, 0.02, 0.02],
        ][kind as usize],
        sizes: [0.0, 0.0, 0.0, 0.0],
        seed: (dice.bits() as u32 & !3) | kind,
    };
    // Discs lie across the heading of a place turned by a quarter.
    let turned = place.offset(v3(-0.07, 0.0, height), 1);
    match kind {
        0 | 1 => b.drum(turned, v3(0.0, 0.0, 0.0), (0.32, 0.0, 0.015), plate, tag),
        2 => b.block(
            turned,
            v3(-0.32, -0.015, -0.32),
            v3(0.32, 0.015, 0.32),
            plate,
            tag,
        ),
        _ => {
            let profile = [(-0.45, -0.30), (0.45, -0.30), (0.0, 0.50)];
            b.hull(turned, &profile, (0.015, 0.0, 0.0), plate, tag);
        }
    }
    if dice.chance(0.4) {
        b.block(
            turned,
            v3(-0.30, -0.015, -0.72),
            v3(0.30, 0.015, -0.40),
            Skin {
                seed: 2,
                trim: [0.05, 0.05, 0.05],
                ..plate
            },
            tag,
        );
    }
}

/// A traffic light that faces traffic coming along +x.
pub(crate) fn signal(b: &mut Builder, place: Place, phase: u32) {
    let post = skin(Material::Metal, [0.25, 0.27, 0.26], 4);
    b.pillar(place, v3(0.0, 0.0, 0.0), 0.075, 3.6, post, (label::POLE, 0));
    let head = Skin {
        material: Material::SignalHead,
        paint: [0.02, 0.025, 0.022],
        trim: [0.5, 0.5, 0.5],
        sizes: [2.55, 0.30, 0.0, 0.0],
        seed: phase % 3,
    };
    let tag = (label::TRAFFIC_LIGHT, 0);
    b.block(
        place,
        v3(-0.26, -0.17, 2.55),
        v3(-0.06, 0.17, 3.45),
        head,
        tag,
    );
}

/// Small things on the pavement: bollard, bin, cabinet, advertising column.
pub(crate) fn furniture(b: &mut Builder, place: Place, dice: &mut Dice) {
    let seed = dice.bits() as u32;
    match dice.below(5) {
        0 | 1 => {
            let post = skin(Material::SignBack, [0.55, 0.10, 0.08], seed);
            b.pillar(place, v3(0.0, 0.0, 0.0), 0.06, 0.95, post, (label::POLE, 0));
        }
        2 => {
            let bin = skin(
                Material::Concrete,
                dice.pick(&[[0.05, 0.06, 0.05], [0.30, 0.20, 0.03], [0.03, 0.09, 0.20]]),
                seed,
            );
            b.block(
                place,
                v3(-0.32, -0.28, 0.0),
                v3(0.32, 0.28, 1.1),
                bin,
                (label::STATIC, 0),
            );
        }
        3 => {
            let cabinet = skin(Material::Plaster, [0.36, 0.38, 0.35], seed);
            b.block(
                place,
                v3(-0.55, -0.2, 0.0),
                v3(0.55, 0.2, 1.25),
                cabinet,
                (label::STATIC, 0),
            );
        }
        _ => {
            let column = Skin {
                material: Material::CargoBox,
                paint: [0.62, 0.60, 0.52],
                trim: cloth(dice),
                sizes: [1.2, 2.6, 0.0, 0.0],
                seed,
            };
            b.pillar(
                place,
                v3(0.0, 0.0, 0.0),
                0.6,
                2.7,
                column,
                (label::STATIC, 0),
            );
        }
    }
}
