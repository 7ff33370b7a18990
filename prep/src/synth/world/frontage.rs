//! What stands along one side of a block, by its kind of frontage.

use super::boundary::boundary;
use super::frame::{Frame, Lot, detail};
use crate::synth::geometry::shapes::{Material, Skin};
use crate::synth::geometry::street::Theme;
use crate::synth::objects::builder::{Builder, skin};
use crate::synth::objects::buildings::{House, hall, house};
use crate::synth::objects::furniture::wire_pole;
use crate::synth::objects::label;
use crate::synth::objects::plants::{bush, conifer, leaf_colour, tree};
use crate::synth::objects::vehicles::{car, truck, van};
use crate::synth::random::Rng;
use crate::synth::vector::{V3, dim, v3};

pub(crate) fn terrace(b: &mut Builder, frame: &Frame, lot: &Lot, rng: &mut Rng) {
    let sign = lot.side.sign();
    let setback = if rng.chance(0.3) {
        rng.range(0.5, 3.0)
    } else {
        0.05
    };
    let front = lot.edge + lot.section.walk_m + setback;
    let mut x = lot.from;
    while x < lot.to - 4.0 {
        let mut own = Rng::new(rng.bits());
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
                frame.kerb(),
            );
            tree(b, place, tall, detail(frame, x), &mut own);
            x += f64::from(width);
            continue;
        }
        let depth = own.range(9.0, 12.0);
        let middle = x + f64::from(width) / 2.0;
        if frame.visible(middle) {
            let jut = own.range(0.0, 0.5);
            let place = frame.facing(middle, sign * (front + jut + depth / 2.0), frame.kerb());
            let storeys = match frame.street.theme {
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
            house(b, place, style, &mut own);
        }
        x += f64::from(width);
    }
    second_row(b, frame, lot, front + 22.0, rng);
}

/// Buildings and trees behind the first row, so that gaps do not show emptiness.
pub(crate) fn second_row(b: &mut Builder, frame: &Frame, lot: &Lot, l: f32, rng: &mut Rng) {
    let sign = lot.side.sign();
    let mut x = lot.from - 6.0;
    while x < lot.to {
        let mut own = Rng::new(rng.bits());
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
                house(b, frame.facing(middle, l, frame.kerb()), style, &mut own);
            } else {
                for i in 0..2 {
                    let place = frame.place(middle + 5.0 * f64::from(i), l, frame.kerb());
                    let tall = own.range(7.0, 13.0);
                    tree(b, place, tall, 5, &mut own);
                }
            }
        }
        x += f64::from(width) + 3.0;
    }
}

pub(crate) fn houses(b: &mut Builder, frame: &Frame, lot: &Lot, rng: &mut Rng) {
    let sign = lot.side.sign();
    let front = lot.edge + lot.section.walk_m;
    let garden = rng.range(3.0, 8.0);
    let mut x = lot.from;
    while x < lot.to - 6.0 {
        let mut own = Rng::new(rng.bits());
        let width = own.range(13.0, 20.0).min((lot.to - x) as f32);
        let middle = x + f64::from(width) / 2.0;
        if frame.visible(middle) {
            let depth = own.range(8.0, 11.0);
            let house_width = (width - own.range(3.0, 6.0)).max(6.0);
            let place = frame.facing(middle, sign * (front + garden + depth / 2.0), frame.kerb());
            let style = House {
                width: house_width,
                depth,
                storeys: 1 + own.below(2) as u32,
                gabled: own.chance(0.9),
                shop: false,
            };
            house(b, place, style, &mut own);
            boundary(
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
                    frame.kerb(),
                );
                if own.chance(0.5) {
                    let size = own.range(0.5, 1.1);
                    bush(b, place, size, &mut own);
                } else if own.chance(0.3) {
                    let tall = own.range(4.0, 9.0);
                    conifer(
                        b,
                        place,
                        tall,
                        if frame.distance(at) < 60.0 { 6 } else { 4 },
                        &mut own,
                    );
                } else {
                    let tall = own.range(3.5, 7.5);
                    tree(b, place, tall, detail(frame, at), &mut own);
                }
            }
            if own.chance(0.4) && garden > 4.0 {
                let at = x + f64::from(width) - 1.6;
                let place = frame.facing(at, sign * (front + garden * 0.5 + 1.5), frame.kerb());
                car(
                    b,
                    place.offset(V3::default(), 1 + 2 * own.below(2) as u32),
                    &mut own,
                );
            }
        }
        x += f64::from(width);
    }
    second_row(b, frame, lot, front + garden + 24.0, rng);
}

pub(crate) fn park(b: &mut Builder, frame: &Frame, lot: &Lot, rng: &mut Rng) {
    let sign = lot.side.sign();
    let front = lot.edge + lot.section.walk_m;
    if rng.chance(0.5) {
        boundary(b, frame, lot, (lot.from, lot.to), front + 0.4, rng);
    }
    for _ in 0..9 {
        let mut own = Rng::new(rng.bits());
        let x = lot.from + f64::from(own.unit()) * (lot.to - lot.from);
        let l = front + own.range(2.5, 26.0);
        if !frame.visible(x) {
            continue;
        }
        let place = frame.place(x, sign * l, frame.kerb());
        match own.below(6) {
            0 => {
                let size = own.range(0.6, 1.6);
                bush(b, place, size, &mut own);
            }
            1 => {
                let tall = own.range(6.0, 12.0);
                conifer(b, place, tall, 6, &mut own);
            }
            _ => {
                let tall = own.range(6.0, 13.0);
                tree(b, place, tall, detail(frame, x), &mut own);
            }
        }
    }
    if frame.street.theme != Theme::Road {
        second_row(b, frame, lot, front + 36.0, rng);
    } else {
        tree_line(b, frame, lot, front + 36.0, rng);
    }
}

pub(crate) fn depot(b: &mut Builder, frame: &Frame, lot: &Lot, rng: &mut Rng) {
    let sign = lot.side.sign();
    let front = lot.edge + lot.section.walk_m;
    if rng.chance(0.6) {
        boundary(b, frame, lot, (lot.from, lot.to - 8.0), front + 0.3, rng);
    }
    let yard = rng.range(9.0, 18.0);
    let size = v3(
        rng.range(22.0, 40.0),
        rng.range(14.0, 24.0),
        rng.range(5.5, 10.0),
    );
    let middle = 0.5 * (lot.from + lot.to);
    if frame.visible(middle) {
        let place = frame.facing(middle, sign * (front + yard + size.y / 2.0), frame.kerb());
        hall(b, place, size, rng);
    }
    let mut x = lot.from + 3.0;
    while x < lot.to - 2.0 {
        let mut own = Rng::new(rng.bits());
        if own.chance(0.5) && frame.visible(x) {
            let place = frame.facing(x, sign * (front + yard - 3.2), frame.kerb());
            let place = place.offset(V3::default(), 1 + 2 * own.below(2) as u32);
            match own.below(9) {
                0 => van(b, place, &mut own),
                1 => truck(b, place, &mut own),
                _ => car(b, place, &mut own),
            }
        }
        x += 2.9;
    }
    tree_line(b, frame, lot, front + yard + size.y + 6.0, rng);
}

pub(crate) fn long_wall(b: &mut Builder, frame: &Frame, lot: &Lot, rng: &mut Rng) {
    let sign = lot.side.sign();
    let l = lot.edge + lot.section.walk_m + rng.range(0.3, 2.5);
    let height = rng.range(1.9, 3.8);
    let seed = rng.bits() as u32;
    let (material, paint) = rng.pick(&[
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
        let place = frame.place(middle, sign * l, frame.kerb());
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
        let mut own = Rng::new(rng.bits());
        if own.chance(0.6) && frame.visible(x) {
            let place = frame.place(x, sign * (l + own.range(2.5, 7.0)), frame.kerb());
            let tall = own.range(5.0, 10.0);
            tree(b, place, tall, detail(frame, x), &mut own);
        }
        x += f64::from(own.range(5.0, 9.0));
    }
    second_row(b, frame, lot, l + 18.0, rng);
}

pub(crate) fn forest(b: &mut Builder, frame: &Frame, lot: &Lot, rng: &mut Rng) {
    let sign = lot.side.sign();
    let front = lot.edge + lot.section.walk_m;
    let clear = rng.range(1.8, 5.0);
    for row in 0..3 {
        let mut x = lot.from + f64::from(row);
        while x < lot.to {
            let mut own = Rng::new(rng.bits());
            let l = front + clear + row as f32 * 4.5 + own.range(0.0, 2.5);
            if frame.visible(x) {
                let place = frame.place(x, sign * l, frame.kerb());
                let tall = own.range(7.0, 13.0);
                if own.chance(0.25) {
                    conifer(b, place, tall, 6, &mut own);
                } else {
                    tree(
                        b,
                        place,
                        tall,
                        detail(frame, x).min(if row > 0 { 6 } else { 12 }),
                        &mut own,
                    );
                }
                if row == 0 && own.chance(0.6) {
                    let size = own.range(0.6, 1.2);
                    bush(b, place.offset(v3(1.5, 0.0, 0.0), 0), size, &mut own);
                }
            }
            x += f64::from(own.range(3.0, 5.5));
        }
    }
    tree_line(b, frame, lot, front + clear + 20.0, rng);
}

/// A far row of large crowns.
pub(crate) fn tree_line(b: &mut Builder, frame: &Frame, lot: &Lot, l: f32, rng: &mut Rng) {
    let sign = lot.side.sign();
    let colour = leaf_colour(rng);
    let mut x = lot.from - 2.0;
    while x < lot.to + 2.0 {
        let mut own = Rng::new(rng.bits());
        if frame.visible(x) {
            let r = own.range(3.0, 5.5);
            let place = frame.place(x, sign * (l + own.range(0.0, 5.0)), frame.kerb());
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

pub(crate) fn field(b: &mut Builder, frame: &Frame, lot: &Lot, rng: &mut Rng) {
    let sign = lot.side.sign();
    let pole = lot.from + f64::from(rng.range(4.0, 30.0));
    if rng.chance(0.6) && frame.visible(pole) {
        wire_pole(b, frame.place(pole, sign * (lot.edge + 4.0), frame.kerb()));
    }
    for _ in 0..rng.below(5) {
        let mut own = Rng::new(rng.bits());
        let x = lot.from + f64::from(own.unit()) * (lot.to - lot.from);
        let l = lot.edge + own.range(3.5, 40.0);
        if frame.visible(x) {
            let place = frame.place(x, sign * l, frame.kerb());
            if own.chance(0.4) {
                let size = own.range(0.6, 1.8);
                bush(b, place, size, &mut own);
            } else {
                let tall = own.range(5.0, 12.0);
                tree(b, place, tall, detail(frame, x), &mut own);
            }
        }
    }
    if rng.chance(0.3) {
        boundary(b, frame, lot, (lot.from, lot.to), lot.edge + 6.0, rng);
    }
    let mut own = Rng::new(rng.bits());
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
            house(
                b,
                frame.facing(middle, sign * 30.0, frame.kerb()),
                style,
                &mut own,
            );
        }
    }
    let l = own.range(35.0, 70.0);
    tree_line(b, frame, lot, l, rng);
}
