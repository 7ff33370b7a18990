//! The world of one drive: what stands along its street and what moves on it.
//!
//! Everything is a function of the drive's seed, the block it stands in and, for
//! what moves, of time; a frame is populated from these without any history.

pub(crate) mod light;

use crate::synth::geometry::shapes::{Material, Skin};
use crate::synth::geometry::street::{BLOCK_M, Frontage, Section, Side, Street, Theme};
use crate::synth::objects::{self as make, Builder, House, Place, label, skin};
use crate::synth::random::{Dice, key};
use crate::synth::sensors::picture::Sensor;
use crate::synth::vector::{V3, dim, sin_cos, v3};
use crate::synth::world::light::Light;

/// A drive: street, light and everything placed by its seed.
#[derive(Clone, Debug)]
pub(crate) struct World {
    seed: u64,
    pub street: Street,
    pub light: Light,
    start_x: f64,
}

/// Where the camera car is, in world coordinates.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pose {
    pub x: f64,
    pub y: f64,
    pub height_m: f64,
    pub cos: f64,
    pub sin: f64,
    /// Nose up, radians.
    pub pitch: f64,
    /// Right side down, radians.
    pub roll: f64,
    pub seconds: f64,
}

/// How far ahead and behind things are placed.
const AHEAD_M: f64 = 270.0;
const BEHIND_M: f64 = 55.0;

/// Height of the rectified camera above the carriageway.
const CAMERA_HEIGHT_M: f64 = 1.65;

/// Converts street positions to places of the frame.
struct Frame<'a> {
    street: &'a Street,
    ox: f64,
    oy: f64,
    camera_x: f64,
}

impl Frame<'_> {
    fn place(&self, x: f64, l: f32, z: f32) -> Place {
        let (cos, sin) = self.street.heading(x);
        let y = self.street.centre(x) + f64::from(l) / cos;
        Place {
            at: v3((x - self.ox) as f32, (y - self.oy) as f32, z),
            cos: cos as f32,
            sin: sin as f32,
        }
    }

    /// A place whose -y side faces the street, whichever side of it it is on.
    fn facing(&self, x: f64, l: f32, z: f32) -> Place {
        let place = self.place(x, l, z);
        if l >= 0.0 {
            place
        } else {
            place.offset(V3::default(), 2)
        }
    }

    fn distance(&self, x: f64) -> f64 {
        (x - self.camera_x).abs()
    }

    fn visible(&self, x: f64) -> bool {
        x > self.camera_x - BEHIND_M && x < self.camera_x + AHEAD_M
    }
}

impl World {
    pub fn new(seed: u64, theme: Theme) -> Self {
        let start_x = f64::from(Dice::new(key(&[seed, 6])).range(100.0, 900.0));
        Self {
            seed,
            street: Street::new(seed, theme),
            light: Light::new(seed),
            start_x,
        }
    }

    /// Camera car at frame `index` of a recording at ten frames per second.
    pub fn pose(&self, index: u32) -> Pose {
        let seconds = f64::from(index) * 0.1;
        let x = self.start_x + self.street.speed_mps * seconds;
        let (cos, sin) = self.street.heading(x);
        let wobble = |rate: f64, phase: u64| {
            let shift = f64::from(Dice::new(key(&[self.seed, 7, phase])).angle());
            sin_cos(rate * seconds + shift).0 + 0.6 * sin_cos(2.7 * rate * seconds + 2.0 * shift).0
        };
        let yaw = 0.008 * wobble(0.9, 1);
        let l = f64::from(self.street.camera_l) + 0.12 * wobble(0.4, 2);
        let (ys, yc) = sin_cos(yaw);
        Pose {
            x,
            y: self.street.centre(x) + l / cos,
            height_m: CAMERA_HEIGHT_M + 0.015 * wobble(5.0, 3),
            cos: cos * yc - sin * ys,
            sin: sin * yc + cos * ys,
            pitch: 0.005 * wobble(3.1, 4) - 0.004,
            roll: 0.006 * wobble(2.3, 5),
            seconds,
        }
    }

    /// How camera 2 or 3 exposes a frame: the two differ a little in gain and colour.
    pub fn sensor(&self, camera: u64, frame_seed: u64) -> Sensor {
        let mut frame = Dice::new(key(&[frame_seed, 19]));
        let mut own = Dice::new(key(&[self.seed, 20, camera]));
        let gain = std::array::from_fn(|_| own.range(0.98, 1.02));
        Sensor {
            exposure: self.light.exposure * frame.range(0.93, 1.07) * own.range(0.975, 1.025),
            gain,
            seed: key(&[frame_seed, camera]),
        }
    }

    /// Everything around a pose, relative to the origin (ox, oy).
    pub fn populate(&self, pose: &Pose, ox: f64, oy: f64) -> Builder {
        let frame = Frame {
            street: &self.street,
            ox,
            oy,
            camera_x: pose.x,
        };
        let mut b = Builder::default();
        self.traffic(&mut b, &frame, pose);
        let first = ((pose.x - BEHIND_M) / BLOCK_M).floor() as i64;
        let last = ((pose.x + AHEAD_M) / BLOCK_M).floor() as i64;
        for block in first..=last {
            for side in Side::BOTH {
                self.block(&mut b, &frame, side, block);
            }
            if let Some(half) = self.street.crossing(block) {
                self.crossing(&mut b, &frame, block, half);
            }
        }
        self.distance(&mut b, &frame);
        b
    }

    fn kerb(&self) -> f32 {
        self.street.kerb_m
    }

    /// One side of one block.
    fn block(&self, b: &mut Builder, frame: &Frame, side: Side, block: i64) {
        let section = self.street.section(side, block);
        let mut dice = Dice::new(key(&[self.seed, 10, side as u64, block as u64]));
        let start = block as f64 * BLOCK_M;
        let margin = |crossing: Option<f32>| crossing.map_or(0.0, |half| f64::from(half) + 2.6);
        let from = start + margin(self.street.crossing(block));
        let to = start + BLOCK_M - margin(self.street.crossing(block + 1));
        let lot = Lot {
            side,
            from,
            to,
            edge: self.street.lanes_m() + section.parking_m,
            section,
        };
        self.pavement(b, frame, &lot, &mut dice);
        match section.frontage {
            Frontage::Terrace => self.terrace(b, frame, &lot, &mut dice),
            Frontage::Houses => self.houses(b, frame, &lot, &mut dice),
            Frontage::Park => self.park(b, frame, &lot, &mut dice),
            Frontage::Depot => self.depot(b, frame, &lot, &mut dice),
            Frontage::LongWall => self.long_wall(b, frame, &lot, &mut dice),
            Frontage::Forest => self.forest(b, frame, &lot, &mut dice),
            Frontage::Field => self.field(b, frame, &lot, &mut dice),
        }
    }

    /// Parked cars, street trees, lamps, signs, people: what stands between kerb and frontage.
    fn pavement(&self, b: &mut Builder, frame: &Frame, lot: &Lot, dice: &mut Dice) {
        let sign = lot.side.sign();
        if lot.section.parking_m > 0.0 {
            let share = dice.range(0.15, 0.95);
            let l = lot.edge - lot.section.parking_m / 2.0;
            let mut x = lot.from + 4.0;
            while x < lot.to - 3.0 {
                let mut own = Dice::new(dice.bits());
                let step = f64::from(own.range(5.2, 6.4));
                if own.chance(share) && frame.visible(x) {
                    let mut place = frame.place(x, sign * (l + own.range(-0.15, 0.2)), 0.0);
                    // On the left cars face the other way.
                    if sign > 0.0 {
                        place = place.offset(V3::default(), 2);
                    }
                    if own.chance(0.12) {
                        make::van(b, place, &mut own);
                    } else {
                        make::car(b, place, &mut own);
                    }
                }
                x += step;
            }
        }
        if lot.section.walk_m <= 0.0 {
            // Posts with reflectors along the open road, a rail on some stretches.
            if dice.chance(0.35) {
                self.guard_rail(b, frame, lot, lot.edge + 0.7);
            } else {
                let mut x = (lot.from / 16.0).ceil() * 16.0;
                while x < lot.to {
                    let white = skin(Material::SignBack, [0.75, 0.75, 0.73], 1);
                    let place = frame.place(x, sign * (lot.edge + 0.6), self.kerb());
                    b.block(
                        place,
                        v3(-0.06, -0.05, 0.0),
                        v3(0.06, 0.05, 1.0),
                        white,
                        (label::POLE, 0),
                    );
                    x += 16.0;
                }
            }
            return;
        }
        if lot.section.walk_m > 2.0 && dice.chance(0.45) {
            let gap = f64::from(dice.range(7.0, 13.0));
            let height = dice.range(6.0, 10.0);
            let mut x = lot.from + 3.0;
            while x < lot.to {
                let mut own = Dice::new(dice.bits());
                if own.chance(0.85) && frame.visible(x) {
                    let place = frame.place(x, sign * (lot.edge + 0.7), self.kerb());
                    let tall = height * own.range(0.85, 1.15);
                    make::tree(b, place, tall, detail(frame, x), &mut own);
                }
                x += gap;
            }
        }
        let lamp = lot.from + 8.0 + f64::from(dice.range(0.0, 16.0));
        if dice.chance(0.7) && frame.visible(lamp) {
            let place = frame.facing(lamp, sign * (lot.edge + 0.5), self.kerb());
            make::street_lamp(b, place, dice.range(5.0, 8.0));
        }
        for _ in 0..dice.below(3) {
            let mut own = Dice::new(dice.bits());
            let x = lot.from + f64::from(own.unit()) * (lot.to - lot.from);
            if !frame.visible(x) {
                continue;
            }
            let mut place = frame.place(x, sign * (lot.edge + own.range(0.35, 0.6)), self.kerb());
            if sign > 0.0 && own.chance(0.5) {
                place = place.offset(V3::default(), 2);
            }
            make::sign(b, place, &mut own);
        }
        for _ in 0..dice.below(4) {
            let mut own = Dice::new(dice.bits());
            let x = lot.from + f64::from(own.unit()) * (lot.to - lot.from);
            let l = lot.edge
                + if own.chance(0.6) {
                    0.5
                } else {
                    lot.section.walk_m - 0.4
                };
            if frame.visible(x) {
                make::furniture(b, frame.place(x, sign * l, self.kerb()), &mut own);
            }
        }
        if self.street.theme != Theme::Road && dice.chance(0.3) {
            let mut own = Dice::new(dice.bits());
            let x = lot.from + f64::from(own.unit()) * (lot.to - lot.from);
            if frame.visible(x) {
                let place =
                    frame.place(x, sign * (lot.edge + lot.section.walk_m - 0.5), self.kerb());
                make::bicycle(
                    b,
                    place.offset(V3::default(), own.below(4) as u32),
                    false,
                    0.0,
                    &mut own,
                );
            }
        }
        // People who stand and talk; those who walk are part of the traffic.
        if self.street.theme != Theme::Road && dice.chance(0.25) {
            let mut own = Dice::new(dice.bits());
            let x = lot.from + f64::from(own.unit()) * (lot.to - lot.from);
            if frame.visible(x) {
                for i in 0..1 + own.below(3) {
                    let l = lot.edge + own.range(0.5, lot.section.walk_m.max(0.8));
                    let place = frame.place(x + 0.5 * i as f64, sign * l, self.kerb());
                    make::person(
                        b,
                        place.offset(V3::default(), own.below(4) as u32),
                        0.1,
                        &mut own,
                    );
                }
            }
        }
    }

    fn guard_rail(&self, b: &mut Builder, frame: &Frame, lot: &Lot, l: f32) {
        let sign = lot.side.sign();
        let rail = skin(Material::Metal, [0.40, 0.41, 0.42], 2);
        let mut x = (lot.from / 4.0).ceil() * 4.0;
        while x < lot.to {
            if frame.visible(x) {
                let place = frame.place(x + 2.0, sign * l, self.kerb());
                let tag = (label::GUARD_RAIL, 0);
                b.block(
                    place,
                    v3(-2.06, -0.04, 0.45),
                    v3(2.06, 0.04, 0.76),
                    rail,
                    tag,
                );
                b.block(place, v3(-0.06, 0.04, 0.0), v3(0.06, 0.14, 0.70), rail, tag);
            }
            x += 4.0;
        }
    }

    fn terrace(&self, b: &mut Builder, frame: &Frame, lot: &Lot, dice: &mut Dice) {
        let sign = lot.side.sign();
        let setback = if dice.chance(0.3) {
            dice.range(0.5, 3.0)
        } else {
            0.05
        };
        let front = lot.edge + lot.section.walk_m + setback;
        let mut x = lot.from;
        while x < lot.to - 4.0 {
            let mut own = Dice::new(dice.bits());
            let left = (lot.to - x) as f32;
            let mut width = own.range(8.0, 17.0).min(left);
            if left - width < 5.0 {
                width = left;
            }
            // Now and then a gap lets the second row and the sky be seen.
            if own.chance(0.12) && width < 12.0 {
                let tall = own.range(5.0, 9.0);
                let place = frame.place(
                    x + f64::from(width) / 2.0,
                    sign * (front + 4.0),
                    self.kerb(),
                );
                make::tree(b, place, tall, detail(frame, x), &mut own);
                x += f64::from(width);
                continue;
            }
            let depth = own.range(9.0, 12.0);
            let middle = x + f64::from(width) / 2.0;
            if frame.visible(middle) {
                let jut = own.range(0.0, 0.5);
                let place = frame.facing(middle, sign * (front + jut + depth / 2.0), self.kerb());
                let storeys = match self.street.theme {
                    Theme::City => 3 + own.below(3) as u32,
                    _ => 2 + own.below(2) as u32,
                };
                let style = House {
                    width,
                    depth,
                    storeys,
                    gabled: own.chance(0.7),
                    shop: own.chance(0.35),
                };
                make::house(b, place, style, &mut own);
            }
            x += f64::from(width);
        }
        self.second_row(b, frame, lot, front + 22.0, dice);
    }

    /// Buildings and trees behind the first row, so that gaps do not show emptiness.
    fn second_row(&self, b: &mut Builder, frame: &Frame, lot: &Lot, l: f32, dice: &mut Dice) {
        let sign = lot.side.sign();
        let mut x = lot.from - 6.0;
        while x < lot.to {
            let mut own = Dice::new(dice.bits());
            let width = own.range(12.0, 22.0);
            let middle = x + f64::from(width) / 2.0;
            if frame.visible(middle) {
                let l = sign * (l + own.range(0.0, 8.0));
                if own.chance(0.55) {
                    let style = House {
                        width,
                        depth: 10.0,
                        storeys: 2 + own.below(3) as u32,
                        gabled: own.chance(0.6),
                        shop: false,
                    };
                    make::house(b, frame.facing(middle, l, self.kerb()), style, &mut own);
                } else {
                    for i in 0..2 {
                        let place = frame.place(middle + 5.0 * f64::from(i), l, self.kerb());
                        let tall = own.range(7.0, 13.0);
                        make::tree(b, place, tall, 5, &mut own);
                    }
                }
            }
            x += f64::from(width) + 3.0;
        }
    }

    fn houses(&self, b: &mut Builder, frame: &Frame, lot: &Lot, dice: &mut Dice) {
        let sign = lot.side.sign();
        let front = lot.edge + lot.section.walk_m;
        let garden = dice.range(3.0, 8.0);
        let mut x = lot.from;
        while x < lot.to - 6.0 {
            let mut own = Dice::new(dice.bits());
            let width = own.range(13.0, 20.0).min((lot.to - x) as f32);
            let middle = x + f64::from(width) / 2.0;
            if frame.visible(middle) {
                let depth = own.range(8.0, 11.0);
                let house_width = (width - own.range(3.0, 6.0)).max(6.0);
                let place =
                    frame.facing(middle, sign * (front + garden + depth / 2.0), self.kerb());
                let style = House {
                    width: house_width,
                    depth,
                    storeys: 1 + own.below(2) as u32,
                    gabled: own.chance(0.9),
                    shop: false,
                };
                make::house(b, place, style, &mut own);
                self.boundary(
                    b,
                    frame,
                    lot,
                    (x + 0.2, x + f64::from(width) - 3.0),
                    front + 0.25,
                    &mut own,
                );
                for _ in 0..own.below(3) {
                    let at = x + f64::from(own.range(0.1, 0.9) * width);
                    let place = frame.place(
                        at,
                        sign * (front + own.range(1.2, garden - 0.8)),
                        self.kerb(),
                    );
                    if own.chance(0.5) {
                        let size = own.range(0.5, 1.1);
                        make::bush(b, place, size, &mut own);
                    } else if own.chance(0.3) {
                        let tall = own.range(4.0, 9.0);
                        make::conifer(
                            b,
                            place,
                            tall,
                            if frame.distance(at) < 60.0 { 6 } else { 4 },
                            &mut own,
                        );
                    } else {
                        let tall = own.range(3.5, 7.5);
                        make::tree(b, place, tall, detail(frame, at), &mut own);
                    }
                }
                if own.chance(0.4) && garden > 4.0 {
                    let at = x + f64::from(width) - 1.6;
                    let place = frame.facing(at, sign * (front + garden * 0.5 + 1.5), self.kerb());
                    make::car(
                        b,
                        place.offset(V3::default(), 1 + 2 * own.below(2) as u32),
                        &mut own,
                    );
                }
            }
            x += f64::from(width);
        }
        self.second_row(b, frame, lot, front + garden + 24.0, dice);
    }

    /// Hedge, wall or fence along the street from one x to another.
    fn boundary(
        &self,
        b: &mut Builder,
        frame: &Frame,
        lot: &Lot,
        (from, to): (f64, f64),
        l: f32,
        dice: &mut Dice,
    ) {
        let sign = lot.side.sign();
        let kind = dice.below(6);
        let height = dice.range(0.7, 1.7);
        let seed = dice.bits() as u32;
        let colour = dice.pick(&[
            [0.08, 0.14, 0.03],
            [0.10, 0.16, 0.04],
            [0.06, 0.10, 0.03],
            [0.15, 0.16, 0.05],
        ]);
        // Short pieces follow the bends.
        let pieces = ((to - from) / 8.0).ceil().max(1.0);
        let step = (to - from) / pieces;
        for i in 0..pieces as i32 {
            let middle = from + (f64::from(i) + 0.5) * step;
            if !frame.visible(middle) {
                continue;
            }
            let half = (step / 2.0) as f32 * 1.02;
            let place = frame.place(middle, sign * l, self.kerb());
            match kind {
                0 | 1 => {
                    let hedge = Skin {
                        trim: dim(colour, 0.4),
                        ..skin(Material::Hedge, colour, seed)
                    };
                    b.block(
                        place,
                        v3(-half, -0.35, 0.0),
                        v3(half, 0.35, height),
                        hedge,
                        (label::VEGETATION, 0),
                    );
                }
                2 => {
                    let wall = skin(Material::Brick, [0.36, 0.17, 0.12], seed);
                    b.block(
                        place,
                        v3(-half, -0.12, 0.0),
                        v3(half, 0.12, height),
                        wall,
                        (label::WALL, 0),
                    );
                }
                3 => {
                    let wall = skin(Material::Stone, [0.42, 0.39, 0.34], seed);
                    b.block(
                        place,
                        v3(-half, -0.15, 0.0),
                        v3(half, 0.15, height * 0.8),
                        wall,
                        (label::WALL, 0),
                    );
                }
                4 => {
                    let fence = Skin {
                        sizes: [0.17, 0.10, 0.0, 0.0],
                        ..skin(Material::Pickets, [0.38, 0.26, 0.16], seed)
                    };
                    b.block(
                        place,
                        v3(-half, -0.03, 0.0),
                        v3(half, 0.03, height),
                        fence,
                        (label::FENCE, 0),
                    );
                }
                _ => {
                    let fence = skin(Material::Wood, [0.26, 0.17, 0.10], seed);
                    b.block(
                        place,
                        v3(-half, -0.04, 0.0),
                        v3(half, 0.04, height),
                        fence,
                        (label::FENCE, 0),
                    );
                }
            }
        }
    }

    fn park(&self, b: &mut Builder, frame: &Frame, lot: &Lot, dice: &mut Dice) {
        let sign = lot.side.sign();
        let front = lot.edge + lot.section.walk_m;
        if dice.chance(0.5) {
            self.boundary(b, frame, lot, (lot.from, lot.to), front + 0.4, dice);
        }
        for _ in 0..9 {
            let mut own = Dice::new(dice.bits());
            let x = lot.from + f64::from(own.unit()) * (lot.to - lot.from);
            let l = front + own.range(2.5, 26.0);
            if !frame.visible(x) {
                continue;
            }
            let place = frame.place(x, sign * l, self.kerb());
            match own.below(6) {
                0 => {
                    let size = own.range(0.6, 1.6);
                    make::bush(b, place, size, &mut own);
                }
                1 => {
                    let tall = own.range(6.0, 12.0);
                    make::conifer(b, place, tall, 6, &mut own);
                }
                _ => {
                    let tall = own.range(6.0, 13.0);
                    make::tree(b, place, tall, detail(frame, x), &mut own);
                }
            }
        }
        if self.street.theme != Theme::Road {
            self.second_row(b, frame, lot, front + 36.0, dice);
        } else {
            self.tree_line(b, frame, lot, front + 36.0, dice);
        }
    }

    fn depot(&self, b: &mut Builder, frame: &Frame, lot: &Lot, dice: &mut Dice) {
        let sign = lot.side.sign();
        let front = lot.edge + lot.section.walk_m;
        if dice.chance(0.6) {
            self.boundary(b, frame, lot, (lot.from, lot.to - 8.0), front + 0.3, dice);
        }
        let yard = dice.range(9.0, 18.0);
        let size = v3(
            dice.range(22.0, 40.0),
            dice.range(14.0, 24.0),
            dice.range(5.5, 10.0),
        );
        let middle = 0.5 * (lot.from + lot.to);
        if frame.visible(middle) {
            let place = frame.facing(middle, sign * (front + yard + size.y / 2.0), self.kerb());
            make::hall(b, place, size, dice);
        }
        let mut x = lot.from + 3.0;
        while x < lot.to - 2.0 {
            let mut own = Dice::new(dice.bits());
            if own.chance(0.5) && frame.visible(x) {
                let place = frame.facing(x, sign * (front + yard - 3.2), self.kerb());
                let place = place.offset(V3::default(), 1 + 2 * own.below(2) as u32);
                match own.below(9) {
                    0 => make::van(b, place, &mut own),
                    1 => make::truck(b, place, &mut own),
                    _ => make::car(b, place, &mut own),
                }
            }
            x += 2.9;
        }
        self.tree_line(b, frame, lot, front + yard + size.y + 6.0, dice);
    }

    fn long_wall(&self, b: &mut Builder, frame: &Frame, lot: &Lot, dice: &mut Dice) {
        let sign = lot.side.sign();
        let l = lot.edge + lot.section.walk_m + dice.range(0.3, 2.5);
        let height = dice.range(1.9, 3.8);
        let seed = dice.bits() as u32;
        let (material, paint) = dice.pick(&[
            (Material::Brick, [0.36, 0.16, 0.11]),
            (Material::Stone, [0.44, 0.40, 0.34]),
            (Material::Concrete, [0.46, 0.45, 0.43]),
            (Material::Plaster, [0.58, 0.54, 0.46]),
        ]);
        let pieces = 6;
        let step = (lot.to - lot.from) / f64::from(pieces);
        for i in 0..pieces {
            let middle = lot.from + (f64::from(i) + 0.5) * step;
            if !frame.visible(middle) {
                continue;
            }
            let half = (step / 2.0) as f32 * 1.02;
            let place = frame.place(middle, sign * l, self.kerb());
            let tag = (label::WALL, 0);
            b.block(
                place,
                v3(-half, -0.15, 0.0),
                v3(half, 0.15, height),
                skin(material, paint, seed),
                tag,
            );
            let cap = skin(Material::Concrete, [0.42, 0.41, 0.38], seed);
            b.block(
                place,
                v3(-half, -0.22, height),
                v3(half, 0.22, height + 0.12),
                cap,
                tag,
            );
            b.block(
                place,
                v3(-half, -0.24, 0.0),
                v3(-half + 0.45, 0.24, height + 0.05),
                skin(material, dim(paint, 0.85), seed ^ 5),
                tag,
            );
        }
        let mut x = lot.from;
        while x < lot.to {
            let mut own = Dice::new(dice.bits());
            if own.chance(0.6) && frame.visible(x) {
                let place = frame.place(x, sign * (l + own.range(2.5, 7.0)), self.kerb());
                let tall = own.range(5.0, 10.0);
                make::tree(b, place, tall, detail(frame, x), &mut own);
            }
            x += f64::from(own.range(5.0, 9.0));
        }
        self.second_row(b, frame, lot, l + 18.0, dice);
    }

    fn forest(&self, b: &mut Builder, frame: &Frame, lot: &Lot, dice: &mut Dice) {
        let sign = lot.side.sign();
        let front = lot.edge + lot.section.walk_m;
        let clear = dice.range(1.8, 5.0);
        for row in 0..3 {
            let mut x = lot.from + f64::from(row);
            while x < lot.to {
                let mut own = Dice::new(dice.bits());
                let l = front + clear + row as f32 * 4.5 + own.range(0.0, 2.5);
                if frame.visible(x) {
                    let place = frame.place(x, sign * l, self.kerb());
                    let tall = own.range(7.0, 13.0);
                    if own.chance(0.25) {
                        make::conifer(b, place, tall, 6, &mut own);
                    } else {
                        make::tree(
                            b,
                            place,
                            tall,
                            detail(frame, x).min(if row > 0 { 6 } else { 12 }),
                            &mut own,
                        );
                    }
                    if row == 0 && own.chance(0.6) {
                        let size = own.range(0.6, 1.2);
                        make::bush(b, place.offset(v3(1.5, 0.0, 0.0), 0), size, &mut own);
                    }
                }
                x += f64::from(own.range(3.0, 5.5));
            }
        }
        self.tree_line(b, frame, lot, front + clear + 20.0, dice);
    }

    /// A far row of large crowns.
    fn tree_line(&self, b: &mut Builder, frame: &Frame, lot: &Lot, l: f32, dice: &mut Dice) {
        let sign = lot.side.sign();
        let colour = make::leaf_colour(dice);
        let mut x = lot.from - 2.0;
        while x < lot.to + 2.0 {
            let mut own = Dice::new(dice.bits());
            if frame.visible(x) {
                let r = own.range(3.0, 5.5);
                let place = frame.place(x, sign * (l + own.range(0.0, 5.0)), self.kerb());
                let leaves = Skin {
                    material: Material::Leaves,
                    paint: dim(colour, own.range(0.7, 1.1)),
                    trim: dim(colour, 0.35),
                    sizes: [0.0, 2.0 * r, 0.0, 0.0],
                    seed: own.bits() as u32,
                };
                let tag = (label::VEGETATION, 0);
                b.ellipsoid(place, v3(0.0, 0.0, r * 0.8), v3(r, r * 0.8, r), leaves, tag);
                b.ellipsoid(
                    place,
                    v3(2.0, 0.5, r * 0.4),
                    v3(r * 0.8, r * 0.7, r * 0.7),
                    leaves,
                    tag,
                );
            }
            x += f64::from(own.range(3.5, 6.0));
        }
    }

    fn field(&self, b: &mut Builder, frame: &Frame, lot: &Lot, dice: &mut Dice) {
        let sign = lot.side.sign();
        let pole = lot.from + f64::from(dice.range(4.0, 30.0));
        if dice.chance(0.6) && frame.visible(pole) {
            make::wire_pole(b, frame.place(pole, sign * (lot.edge + 4.0), self.kerb()));
        }
        for _ in 0..dice.below(5) {
            let mut own = Dice::new(dice.bits());
            let x = lot.from + f64::from(own.unit()) * (lot.to - lot.from);
            let l = lot.edge + own.range(3.5, 40.0);
            if frame.visible(x) {
                let place = frame.place(x, sign * l, self.kerb());
                if own.chance(0.4) {
                    let size = own.range(0.6, 1.8);
                    make::bush(b, place, size, &mut own);
                } else {
                    let tall = own.range(5.0, 12.0);
                    make::tree(b, place, tall, detail(frame, x), &mut own);
                }
            }
        }
        if dice.chance(0.3) {
            self.boundary(b, frame, lot, (lot.from, lot.to), lot.edge + 6.0, dice);
        }
        let mut own = Dice::new(dice.bits());
        if own.chance(0.2) {
            let middle = 0.5 * (lot.from + lot.to);
            if frame.visible(middle) {
                let style = House {
                    width: 14.0,
                    depth: 9.0,
                    storeys: 2,
                    gabled: true,
                    shop: false,
                };
                make::house(
                    b,
                    frame.facing(middle, sign * 30.0, self.kerb()),
                    style,
                    &mut own,
                );
            }
        }
        let l = own.range(35.0, 70.0);
        self.tree_line(b, frame, lot, l, dice);
    }

    /// A side street: traffic lights or signs, a waiting car.
    fn crossing(&self, b: &mut Builder, frame: &Frame, block: i64, half: f32) {
        let mut dice = Dice::new(key(&[self.seed, 11, block as u64]));
        let x = block as f64 * BLOCK_M;
        let edge = self.street.lanes_m() + 0.8;
        let lights = self.street.theme == Theme::City && dice.chance(0.7);
        if lights {
            let phase = dice.below(3) as u32;
            for (dx, l) in [(-1.0, -edge), (1.0, edge), (-1.0, edge), (1.0, -edge)] {
                let at = x + dx * (f64::from(half) + 1.2);
                let section = self
                    .street
                    .section(if l > 0.0 { Side::Left } else { Side::Right }, block);
                let l = l + section.parking_m * l.signum();
                if frame.visible(at) {
                    let place = frame.place(at, l, self.kerb());
                    let place = if dx > 0.0 {
                        place.offset(V3::default(), 2)
                    } else {
                        place
                    };
                    make::signal(b, place, phase);
                }
            }
        }
        for side in Side::BOTH {
            let mut own = Dice::new(dice.bits());
            let section = self.street.section(side, block);
            let l = side.sign() * (edge + section.parking_m + own.range(2.6, 7.0));
            if own.chance(0.55) && frame.visible(x) {
                // Waits to turn in: looks at the street.
                let place = frame.facing(x, l, 0.0);
                let place = place.offset(v3(1.6, 0.0, 0.0), 3);
                make::car(b, place, &mut own);
            }
            if own.chance(0.7) {
                let place = frame.place(x, side.sign() * own.range(45.0, 70.0), self.kerb());
                let style = House {
                    width: 16.0,
                    depth: 10.0,
                    storeys: 3,
                    gabled: true,
                    shop: false,
                };
                make::house(
                    b,
                    if l > 0.0 {
                        place
                    } else {
                        place.offset(V3::default(), 2)
                    },
                    style,
                    &mut own,
                );
            }
        }
    }

    /// Cars in both directions, cyclists, walkers.
    fn traffic(&self, b: &mut Builder, frame: &Frame, pose: &Pose) {
        let t = pose.seconds;
        let mut dice = Dice::new(key(&[self.seed, 12]));
        let lane = f64::from(self.street.lane_m);
        let wave = |amplitude: f64, rate: f64, shift: f64| amplitude * sin_cos(rate * t + shift).0;
        // Ahead in the own direction, per lane: one or two cars whose gap breathes.
        for i in 0..self.street.lanes {
            let l = -((f64::from(i) + 0.5) * lane) as f32;
            let own_lane = (l - self.street.camera_l).abs() < 1.0;
            let mut gap = if own_lane { 6.0 } else { -12.0 };
            for n in 0..3 {
                let base = f64::from(dice.range(5.0, 30.0));
                let swing = f64::from(dice.range(0.25, 0.9)) * base;
                let (rate, shift) = (f64::from(dice.range(0.12, 0.4)), f64::from(dice.angle()));
                let mut own = Dice::new(key(&[self.seed, 13, u64::from(i), n]));
                let present = own.chance(if n == 0 { 0.8 } else { 0.6 });
                gap += base
                    + wave(swing * 0.6, rate, shift)
                    + wave(swing * 0.3, 2.3 * rate, 2.0 * shift);
                let x = pose.x + gap;
                if present && frame.visible(x) {
                    let place = frame.place(x, l + own.range(-0.25, 0.25), 0.0);
                    vehicle(b, place, &mut own);
                }
                gap += 9.0;
            }
        }
        // Oncoming: an endless queue with uneven gaps.
        for i in 0..self.street.lanes {
            let speed = f64::from(dice.range(7.0, 13.0));
            let spacing = f64::from(dice.range(22.0, 90.0));
            let l = ((f64::from(i) + 0.5) * lane) as f32;
            stream(
                frame,
                [self.seed, 14, u64::from(i)],
                spacing,
                -speed * t,
                |x, own| {
                    if own.chance(0.8) {
                        let place = frame.place(x, l + own.range(-0.25, 0.25), 0.0);
                        vehicle(b, place.offset(V3::default(), 2), own);
                    }
                },
            );
        }
        let kerb = self.kerb();
        if self.street.theme != Theme::Road || dice.chance(0.5) {
            let spacing = f64::from(dice.range(35.0, 130.0));
            let l = -(self.street.lanes_m() - 0.75);
            stream(frame, [self.seed, 15, 0], spacing, 4.6 * t, |x, own| {
                let pedal = sin_cos(5.0 * t + x).0 as f32;
                make::bicycle(
                    b,
                    frame.place(x, l + own.range(-0.2, 0.3), 0.0),
                    true,
                    pedal,
                    own,
                );
            });
            stream(
                frame,
                [self.seed, 15, 1],
                1.6 * spacing,
                -4.2 * t,
                |x, own| {
                    let pedal = sin_cos(5.0 * t + x).0 as f32;
                    let place = frame.place(x, -l + own.range(-0.3, 0.2), 0.0);
                    make::bicycle(b, place.offset(V3::default(), 2), true, pedal, own);
                },
            );
        }
        let spacing = match self.street.theme {
            Theme::City => f64::from(dice.range(7.0, 22.0)),
            Theme::Residential => f64::from(dice.range(18.0, 50.0)),
            Theme::Road => 160.0,
        };
        for side in Side::BOTH {
            for (queue, speed) in [(0_u64, 1.3), (1, -1.25)] {
                stream(
                    frame,
                    [self.seed, 16, 2 * side as u64 + queue],
                    spacing,
                    speed * t,
                    |x, own| {
                        let section = self.street.section(side, (x / BLOCK_M).floor() as i64);
                        if section.walk_m < 1.0 {
                            return;
                        }
                        let l = self.street.lanes_m()
                            + section.parking_m
                            + own.range(0.5, section.walk_m - 0.3);
                        let place = frame.place(x, side.sign() * l, kerb);
                        let place = if speed < 0.0 {
                            place.offset(V3::default(), 2)
                        } else {
                            place
                        };
                        let stride = sin_cos(6.0 * t + 3.0 * x).0 as f32;
                        make::person(b, place, stride, own);
                    },
                );
            }
        }
        // Someone crosses the street now and then.
        if self.street.theme != Theme::Road {
            stream(frame, [self.seed, 17, 0], 140.0, 0.0, |x, own| {
                let l =
                    (1.2 * (t + f64::from(own.range(0.0, 60.0)))).rem_euclid(60.0) as f32 - 30.0;
                if l.abs() < self.street.lanes_m() && (x - pose.x).abs() > 6.0 {
                    let place = frame.place(x, l, 0.0).offset(V3::default(), 1);
                    make::person(b, place, sin_cos(6.0 * t).0 as f32, own);
                }
            });
        }
    }

    /// Hills at the horizon.
    fn distance(&self, b: &mut Builder, frame: &Frame) {
        let cell = (frame.camera_x / 400.0).floor() as i64;
        for i in cell..cell + 4 {
            let mut dice = Dice::new(key(&[self.seed, 18, i as u64]));
            for side in Side::BOTH {
                let x = i as f64 * 400.0 + f64::from(dice.range(0.0, 400.0));
                let l = side.sign() * dice.range(260.0, 520.0);
                let radii = v3(
                    dice.range(200.0, 420.0),
                    dice.range(120.0, 220.0),
                    dice.range(18.0, 55.0),
                );
                let mut place = frame.place(x, 0.0, 0.0);
                place.at.y += l;
                let hill = skin(Material::Hill, [0.10, 0.14, 0.06], dice.bits() as u32);
                if x - frame.camera_x > f64::from(radii.x) * 0.5 {
                    b.ellipsoid(place, V3::default(), radii, hill, (label::VEGETATION, 0));
                }
            }
        }
    }
}

/// The stretch of one side of a block that may be built on.
struct Lot {
    side: Side,
    from: f64,
    to: f64,
    /// Lateral distance of the kerb.
    edge: f32,
    section: Section,
}

/// How finely crowns are made at a distance.
fn detail(frame: &Frame, x: f64) -> usize {
    match frame.distance(x) {
        d if d < 45.0 => 12,
        d if d < 110.0 => 8,
        _ => 4,
    }
}

fn vehicle(b: &mut Builder, place: Place, dice: &mut Dice) {
    match dice.below(20) {
        0 => make::bus(b, place, dice),
        1 | 2 => make::truck(b, place, dice),
        3..=5 => make::van(b, place, dice),
        _ => make::car(b, place, dice),
    }
}

/// Calls `f` for every member of an endless queue that is now near the camera. The
/// members stand `spacing` apart (give or take a third), all moved by `moved`.
fn stream(
    frame: &Frame,
    seed: [u64; 3],
    spacing: f64,
    moved: f64,
    mut f: impl FnMut(f64, &mut Dice),
) {
    let first = ((frame.camera_x - BEHIND_M - moved) / spacing).floor() as i64 - 1;
    let last = ((frame.camera_x + 200.0 - moved) / spacing).floor() as i64 + 1;
    for i in first..=last {
        let mut own = Dice::new(key(&[seed[0], seed[1], seed[2], i as u64]));
        let x = (i as f64 + f64::from(own.range(-0.33, 0.33))) * spacing + moved;
        if frame.visible(x) {
            f(x, &mut own);
        }
    }
}
