//! What surfaces look like: albedo, texture, markings, windows, and their shading.
//!
//! Patterns are filtered by the footprint of the pixel: noise through the pyramid
//! of [`crate::synth::noise`], edges by the share of the footprint that they cover.

use crate::synth::geometry::shapes::{
    Entry, LEAF_TEXELS_PER_M, Material, Shape, Skin, leaf_coordinates, leaf_scale, planar,
};
use crate::synth::geometry::street::{GroundHit, Spot, Theme, Yard, Zone};
use crate::synth::random::mix;
use crate::synth::scene::{Hit, On, Recess, Scene};
use crate::synth::vector::{Rgb, V3, blend, dim, floor_i32, least, most, smooth, v3};

/// Texels per metre of the fine and the coarse layer of grain. Their periods
/// (16/3 m and 64 m) divide the 128 m to which scene origins are snapped.
const FINE: f32 = 96.0;
const COARSE: f32 = 8.0;

/// How much a surface mirrors the sky, and its own colour.
struct Look {
    albedo: Rgb,
    gloss: f32,
    glow: f32,
}

fn matt(albedo: Rgb) -> Look {
    Look {
        albedo,
        gloss: 0.0,
        glow: 0.0,
    }
}

/// Share of the interval of width `foot` around `x` that lies between `low` and `high`.
fn band(x: f32, low: f32, high: f32, foot: f32) -> f32 {
    let f = most(foot, 1e-4);
    ((least(x + 0.5 * f, high) - most(x - 0.5 * f, low)) / f).clamp(0.0, 1.0)
}

/// Like [`band`] for a stripe `on` wide that repeats every `period`.
fn stripes(x: f32, period: f32, on: f32, foot: f32) -> f32 {
    let duty = on / period;
    if foot > period {
        return duty;
    }
    let phase = x - period * floor_i32(x / period) as f32;
    let here = band(phase, 0.0, on, foot)
        + band(phase, period, period + on, foot)
        + band(phase, -period, on - period, foot);
    let faded = smooth(0.5 * period, period, foot);
    here.min(1.0) * (1.0 - faded) + duty * faded
}

fn hash01(seed: u32, a: i32, b: i32) -> f32 {
    let h = mix(u64::from(seed) ^ ((a as u32 as u64) << 32) ^ (b as u32 as u64));
    (h >> 40) as f32 / 16_777_216.0
}

/// Radiance that comes back along a ray, and whether the sun shines where it ends.
pub(crate) fn radiance(
    scene: &Scene,
    hit: Option<&Hit>,
    origin: V3,
    direction: V3,
    spread: f32,
) -> (Rgb, bool) {
    let light = &scene.world.light;
    let Some(hit) = hit else {
        return (light.sky(scene.textures, direction), false);
    };
    let point = origin + direction * hit.t;
    let length = direction.length();
    let distance = hit.t * length;
    let foot = spread * hit.t;
    let facing = (-direction.dot(hit.normal) / length).clamp(0.02, 1.0);
    let (look, normal, of, open) = match hit.on {
        On::Ground(ground) => {
            let look = ground_look(scene, &ground, point, direction, foot, facing);
            let raised = if ground.spot.zone == Zone::Kerb {
                0.75
            } else {
                1.0
            };
            (
                look,
                hit.normal,
                None,
                raised * scene.openness(point.x, point.y),
            )
        }
        On::Shape {
            index,
            shell,
            recess,
        } => {
            let shape = &scene.shapes[index as usize];
            let local = shape.local(point);
            // Seen at a slant the footprint is longer; a compromise between both axes.
            let foot = if shape.skin.material == Material::Leaves {
                foot
            } else {
                foot / facing.max(0.12).sqrt()
            };
            let (look, normal) = shape_look(scene, shape, local, hit.normal, foot, shell, recess);
            let low = 0.72 + 0.28 * smooth(0.0, 0.8, point.z);
            let inside = match (shell, recess) {
                (1, _) => 0.75,
                (2, _) => 0.5,
                (_, Recess::Pane | Recess::Reveal) => 0.7,
                _ => 1.0,
            };
            (look, normal, Some(index), low * inside)
        }
    };
    let mut slope = normal.dot(light.sun);
    if let On::Shape { shell, index, .. } = hit.on
        && scene.shapes[index as usize].skin.material == Material::Leaves
    {
        // Leaves let light through and point every way.
        slope = 0.25 + 0.65 * slope - 0.12 * f32::from(shell);
    }
    let mut sun = 0.0;
    if slope > 0.0 {
        let lifted = point + hit.normal * (0.004 + 2e-4 * distance);
        sun = slope * scene.sunlight(lifted, of);
    }
    let ambient = open * (0.62 + 0.38 * normal.z);
    let bounce = 0.10 * open * (1.0 - normal.z);
    let mut rgb: Rgb = std::array::from_fn(|i| {
        let arriving = light.sun_rgb[i] * (sun + bounce * light.sun.z) + light.sky_rgb[i] * ambient;
        look.albedo[i] * (arriving * 0.8 + look.glow)
    });
    if look.gloss > 0.0 {
        let d = direction * (1.0 / length);
        let mirror = d - normal * (2.0 * d.dot(normal));
        let grazing = 1.0 - (-d.dot(normal)).clamp(0.0, 1.0);
        let share = look.gloss * (0.25 + 0.75 * grazing * grazing * grazing);
        let sky = light.reflection(mirror);
        let glint = sun.min(1.0) * smooth(0.985, 0.999, mirror.dot(light.sun)) * 4.0;
        for i in 0..3 {
            rgb[i] = rgb[i] * (1.0 - share)
                + share * (sky[i] * 0.95 * open.max(0.5) + glint * light.sun_rgb[i]);
        }
    }
    (light.through_haze(rgb, distance), sun > 0.0)
}

/// Grain around zero at metres (u, v).
fn grain(scene: &Scene, u: f32, v: f32, texels_per_m: f32, foot: f32) -> f32 {
    scene
        .textures
        .grain
        .at(u * texels_per_m, v * texels_per_m, foot * texels_per_m)
        - 0.5
}

fn ground_look(
    scene: &Scene,
    ground: &GroundHit,
    point: V3,
    direction: V3,
    foot: f32,
    facing: f32,
) -> Look {
    let spot = &ground.spot;
    // The footprint is an ellipse, long away from the camera: several taps along it.
    let long = (foot / facing).min(40.0);
    let flat = v3(direction.x, direction.y, 0.0).unit();
    let taps = if ground.spot.zone == Zone::Kerb {
        1
    } else {
        ((long / foot) as i32).clamp(1, 3)
    };
    let step = long / taps as f32;
    let width = (step * 0.75).max(foot);
    let (mut fine, mut leafy) = (0.0, 0.0);
    let grassy = matches!(spot.zone, Zone::Yard(Yard::Grass | Yard::Gravel));
    for i in 0..taps {
        let shift = (i as f32 + 0.5) * step - 0.5 * long;
        let (x, y) = (point.x + flat.x * shift, point.y + flat.y * shift);
        fine += grain(scene, x, y, FINE, width);
        if grassy {
            leafy += scene.textures.leaves.at(x * 64.0, y * 64.0, width * 64.0) - 0.5;
        }
    }
    let fine = fine / taps as f32;
    let leafy = leafy / taps as f32;
    let coarse = grain(scene, point.x, point.y, COARSE, width);
    let across = foot.max(long * (1.0 - flat.x.abs()));
    let along = foot.max(long * flat.x.abs());
    match spot.zone {
        Zone::Lane | Zone::Parking => asphalt(scene, spot, (fine, coarse), across, along),
        Zone::Kerb => matt(dim([0.36, 0.35, 0.33], 1.0 + 0.9 * fine + 0.5 * coarse)),
        Zone::Walk => {
            let size = 0.4;
            let joint =
                stripes(spot.along, size, 0.03, along).max(stripes(spot.l, size, 0.03, across));
            let (a, b) = (floor_i32(spot.along / size), floor_i32(spot.l / size));
            let plate = (hash01(3, a, b) - 0.5) * (1.0 - smooth(0.2, 0.6, along));
            let kerbstone = band(spot.l.abs(), spot.edge - 0.05, spot.edge + 0.16, across);
            let base = dim(
                [0.29, 0.275, 0.255],
                1.0 + 0.8 * fine + 0.9 * coarse + 0.3 * plate,
            );
            let base = blend(base, [0.14, 0.135, 0.13], 0.5 * joint);
            matt(blend(
                base,
                dim([0.42, 0.41, 0.39], 1.0 + 0.8 * fine),
                kerbstone,
            ))
        }
        Zone::Yard(Yard::Grass) => {
            let dry = smooth(-0.15, 0.3, coarse);
            let base = blend([0.085, 0.135, 0.03], [0.19, 0.17, 0.07], dry);
            matt(dim(
                base,
                (1.0 + 1.1 * leafy + 0.9 * fine + 0.5 * coarse).max(0.15),
            ))
        }
        Zone::Yard(Yard::Gravel) => matt(dim(
            [0.33, 0.30, 0.26],
            1.0 + 0.7 * leafy + 0.7 * fine + 0.6 * coarse,
        )),
        Zone::Yard(Yard::Paved) => {
            let joint =
                stripes(spot.along, 0.22, 0.025, along).max(stripes(spot.l, 0.11, 0.02, across));
            let base = dim([0.26, 0.23, 0.21], 1.0 + 0.8 * fine + 1.1 * coarse);
            matt(blend(base, [0.12, 0.11, 0.10], 0.5 * joint))
        }
    }
}

fn asphalt(scene: &Scene, spot: &Spot, noise: (f32, f32), across: f32, along: f32) -> Look {
    let (fine, coarse) = noise;
    let strip = &scene.strip;
    let seed = strip.seed as u32;
    let tone = 0.105 + 0.07 * hash01(seed, 1, 1);
    let mut k = 1.0 + 0.95 * fine + 0.75 * coarse;
    let distance = spot.l.abs();
    // Mended patches and dark tracks where wheels run.
    let (a, b) = (floor_i32(spot.along / 7.3), floor_i32(spot.l / 1.9 + 40.0));
    let pick = hash01(seed, a, b);
    if pick < 0.2 {
        let (u, v) = (
            spot.along - a as f32 * 7.3,
            (spot.l / 1.9 + 40.0 - b as f32) * 1.9,
        );
        let length = 2.0 + 5.0 * hash01(seed ^ 9, a, b);
        let inside = band(u, 0.3, length, along) * band(v, 0.2, 1.6, across);
        let rim = inside - band(u, 0.38, length - 0.08, along) * band(v, 0.28, 1.52, across);
        k *= 1.0 + inside * (if pick < 0.13 { -0.32 } else { 0.25 }) - 0.35 * rim;
    }
    let track = stripes(distance - 0.55, strip.lane_m * 0.5, 0.5, across.max(0.3));
    k *= 1.0 - 0.10 * track;
    let mut base = dim([1.0, 0.99, 0.985], tone * k.max(0.2));
    if spot.zone == Zone::Parking {
        let joint = stripes(spot.along, 0.16, 0.02, along).max(stripes(spot.l, 0.16, 0.02, across));
        base = dim(
            [0.20, 0.185, 0.17],
            (1.0 + 0.9 * fine + 0.9 * coarse).max(0.2) * (1.0 - 0.4 * joint),
        );
    }
    let near_crossing = spot
        .crossing
        .map(|(off, half)| (off, half, off.abs() < half + 1.0));
    let mut paint = 0.0_f32;
    let open = spot
        .crossing
        .is_none_or(|(_, half)| near_crossing.is_some_and(|(off, _, _)| off.abs() > half + 5.0));
    if open && spot.zone == Zone::Lane {
        let dash = stripes(spot.along, 9.0, 3.2, along);
        if strip.divided {
            if strip.lanes == 1 {
                paint = paint.max(band(spot.l, -0.07, 0.07, across) * dash);
            } else {
                paint = paint.max(band(distance, 0.08, 0.22, across));
                paint = paint
                    .max(band(distance, strip.lane_m - 0.07, strip.lane_m + 0.07, across) * dash);
            }
        }
        let outer = strip.lanes as f32 * strip.lane_m;
        if strip.theme == Theme::Road {
            paint = paint.max(band(distance, outer, outer + 0.14, across));
        }
    }
    if spot.edge > spot.lanes_end + 0.5 && spot.crossing.is_none() {
        let box_line = stripes(spot.along, 6.0, 0.12, along)
            * band(distance, spot.lanes_end, spot.edge, across);
        paint = paint
            .max(band(distance, spot.lanes_end, spot.lanes_end + 0.12, across).max(box_line) * 0.8);
    }
    if let Some((off, half, _)) = near_crossing
        && strip.theme == Theme::City
    {
        let zebra = band(off.abs(), half + 1.2, half + 4.0, along)
            * stripes(spot.l + 50.0, 1.0, 0.5, across)
            * band(distance, 0.0, spot.lanes_end - 0.3, across);
        let stop = band(off.abs(), half + 4.6, half + 5.0, along)
            * band(spot.l * off.signum(), 0.1, spot.lanes_end - 0.3, across);
        paint = paint.max(zebra).max(stop);
    }
    let worn = (0.86 + 1.1 * fine + 0.9 * coarse).clamp(0.25, 1.0);
    matt(blend(
        base,
        dim([0.56, 0.56, 0.54], 1.0 + 0.5 * fine),
        paint * worn,
    ))
}

/// A window of a house front: the half-open cell that a point of the wall lies in.
struct Cell {
    /// Position relative to the window's middle and sill, metres.
    du: f32,
    dv: f32,
    half_width: f32,
    height: f32,
    column: i32,
    row: i32,
}

/// The cell of the window grid at a point of an upright face, if it has a window.
fn window_cell(shape: &Shape, local: V3, normal: V3) -> Option<Cell> {
    let [bay, storey, width, height] = shape.skin.sizes;
    let (u, low, high) = if normal.x != 0.0 {
        (local.y, shape.low.y, shape.high.y)
    } else {
        (local.x, shape.low.x, shape.high.x)
    };
    let length = high - low;
    let count = floor_i32(length / bay).max(1);
    let pitch = length / count as f32;
    let base = shape.low.z.max(0.0);
    let (fu, fv) = ((u - low) / pitch, (local.z - base) / storey);
    let (column, row) = (floor_i32(fu).clamp(0, count - 1), floor_i32(fv));
    if row < 0 || base + (row as f32 + 0.95) * storey > shape.high.z {
        return None;
    }
    let shop = shape.skin.seed & 1 == 1 && row == 0 && normal.y != 0.0;
    let (half_width, height, sill) = if shop {
        (0.42 * pitch, 0.68 * storey, 0.14 * storey)
    } else {
        (0.5 * width, height, 0.62 * (storey - height))
    };
    // Some bays of the sides are blind.
    if normal.x != 0.0 && hash01(shape.skin.seed, column, row + 71) < 0.45 {
        return None;
    }
    Some(Cell {
        du: (fu - column as f32 - 0.5) * pitch,
        dv: (fv - row as f32) * storey - sill,
        half_width,
        height,
        column,
        row,
    })
}

const WINDOW_DEPTH_M: f32 = 0.16;

/// Follows a ray that meets a house front into a window: to the pane or the reveal.
pub(crate) fn enter_window(shape: &Shape, o: V3, d: V3, entry: Entry) -> (f32, V3, Recess) {
    let wall = (entry.t, entry.normal, Recess::Wall);
    let p = o + d * entry.t;
    let Some(cell) = window_cell(shape, p, entry.normal) else {
        return wall;
    };
    if cell.du.abs() >= cell.half_width || cell.dv <= 0.0 || cell.dv >= cell.height {
        return wall;
    }
    let sideways = if entry.normal.x != 0.0 { d.y } else { d.x };
    let inward = -d.dot(entry.normal);
    if inward < 1e-6 {
        return wall;
    }
    let to_pane = WINDOW_DEPTH_M / inward;
    let side_gap = if sideways > 0.0 {
        cell.half_width - cell.du
    } else {
        cell.half_width + cell.du
    };
    let rise_gap = if d.z > 0.0 {
        cell.height - cell.dv
    } else {
        cell.dv
    };
    let to_side = side_gap / sideways.abs().max(1e-9);
    let to_edge = rise_gap / d.z.abs().max(1e-9);
    if to_pane <= to_side && to_pane <= to_edge {
        return (entry.t + to_pane, entry.normal, Recess::Pane);
    }
    let normal = if to_side < to_edge {
        if entry.normal.x != 0.0 {
            v3(0.0, -d.y.signum(), 0.0)
        } else {
            v3(-d.x.signum(), 0.0, 0.0)
        }
    } else {
        v3(0.0, 0.0, -d.z.signum())
    };
    (entry.t + to_side.min(to_edge), normal, Recess::Reveal)
}

fn shape_look(
    scene: &Scene,
    shape: &Shape,
    local: V3,
    normal: V3,
    foot: f32,
    shell: u8,
    recess: Recess,
) -> (Look, V3) {
    let skin = &shape.skin;
    let own = shape.local_direction(normal);
    let (u, v) = planar(local, own);
    let (su, sv) = (
        u + (skin.seed & 63) as f32 * 0.37,
        v + (skin.seed >> 26) as f32 * 0.41,
    );
    let fine = || grain(scene, su, sv, FINE, foot);
    let coarse = || grain(scene, su, sv, COARSE, foot);
    let upright = own.z.abs() < 0.7;
    let look = match skin.material {
        Material::Facade => facade(scene, shape, local, own, foot, recess, (fine(), coarse())),
        Material::Plaster | Material::SignBack => {
            matt(dim(skin.paint, 1.0 + 0.45 * fine() + 0.7 * coarse()))
        }
        Material::Concrete => {
            let seams = stripes(u, 2.4, 0.03, foot).max(stripes(v, 1.2, 0.02, foot));
            matt(dim(
                skin.paint,
                (1.0 + 0.6 * fine() + 1.0 * coarse()) * (1.0 - 0.4 * seams),
            ))
        }
        Material::Brick => brick(skin.paint, u, v, foot, fine(), coarse()),
        Material::Stone => {
            let row = floor_i32(v / 0.35);
            let shifted = u + 0.37 * (row & 1) as f32;
            let joint = stripes(v, 0.35, 0.03, foot).max(stripes(shifted, 0.62, 0.03, foot));
            let block = (hash01(skin.seed, floor_i32(shifted / 0.62), row) - 0.5)
                * (1.0 - smooth(0.2, 0.5, foot));
            matt(dim(
                skin.paint,
                (1.0 + 0.8 * fine() + 0.7 * coarse() + 0.5 * block) * (1.0 - 0.45 * joint),
            ))
        }
        Material::RoofTiles => {
            // Rows of tiles down the slope.
            let down = (local.x.abs() + local.z.abs()) * 0.75;
            let row = floor_i32(down / 0.32);
            let lip = stripes(down, 0.32, 0.07, foot)
                .max(0.6 * stripes(local.y + 0.13 * (row & 1) as f32, 0.26, 0.04, foot));
            let tile = (hash01(skin.seed, floor_i32(local.y / 0.26), row) - 0.5)
                * (1.0 - smooth(0.15, 0.4, foot));
            matt(dim(
                skin.paint,
                (1.0 + 0.7 * fine() + 1.0 * coarse() + 0.5 * tile) * (1.0 - 0.5 * lip),
            ))
        }
        Material::Wood | Material::Pickets => {
            let gap = stripes(u, 0.14, 0.015, foot);
            let board =
                (hash01(skin.seed, floor_i32(u / 0.14), 0) - 0.5) * (1.0 - smooth(0.07, 0.2, foot));
            let streak = grain(scene, u * 0.9 + 3.0, v * 0.12, FINE, foot);
            matt(dim(
                skin.paint,
                (1.0 + 0.6 * streak + 0.6 * board + 0.7 * coarse()) * (1.0 - 0.6 * gap),
            ))
        }
        Material::Bark => {
            let streak = grain(scene, (u + v * 0.05) * 1.4, v * 0.35, FINE, foot);
            matt(dim(
                skin.paint,
                (1.0 + 1.3 * streak + 0.7 * coarse()).max(0.2),
            ))
        }
        Material::Leaves => return leaves(scene, shape, local, normal, own, foot, shell),
        Material::Hedge => {
            let (lu, lv) = (su * 64.0, sv * 64.0);
            let leaf = scene.textures.leaves.at(lu, lv, foot * 64.0) - 0.5;
            let big = scene.textures.leaves.at(lu * 0.2, lv * 0.2, foot * 13.0) - 0.5;
            let k = (0.9 + 1.1 * leaf + 0.3 * big + 0.7 * coarse()).max(0.12);
            matt(dim(skin.paint, k))
        }
        Material::Metal => Look {
            gloss: 0.10,
            ..matt(dim(skin.paint, 1.0 + 0.4 * fine() + 0.7 * coarse()))
        },
        Material::CarBody => car_body(skin, local, own, foot, fine(), coarse()),
        Material::CarCabin => car_cabin(skin, local, own, foot, coarse()),
        Material::VanBody => van_body(skin, local, own, foot, fine(), coarse()),
        Material::CargoBox => cargo(skin, local, own, foot, fine(), coarse()),
        Material::BusBody => bus_body(skin, local, own, foot, fine(), coarse()),
        Material::Tyre => {
            let r = (local.x * local.x + local.z * local.z).sqrt() / shape.high.x;
            let rim = band(r, 0.0, skin.sizes[0], foot / shape.high.x);
            let angle = crate::synth::vector::atan2(local.z, local.x) * 0.795_774_7;
            let spoke = stripes(angle + (skin.seed & 7) as f32 * 0.1, 1.0, 0.55, foot * 3.0);
            matt(blend(
                dim(skin.paint, 1.0 + fine()),
                dim(skin.trim, 0.35 + 0.65 * spoke),
                rim,
            ))
        }
        Material::Cloth => {
            let check = if skin.seed & 3 == 0 {
                0.35 * (stripes(v, 0.14, 0.07, foot) - 0.5)
            } else {
                0.0
            };
            let fold = grain(scene, su * 2.0, sv * 0.8, FINE, foot);
            matt(dim(
                skin.paint,
                (1.0 + 0.9 * fold + 0.5 * coarse() + check).max(0.15),
            ))
        }
        Material::Skin => matt(dim(skin.paint, 1.0 + 0.4 * fine())),
        Material::SignPlate => sign_plate(skin, local, own, foot),
        Material::SignalHead => {
            // Three lamps one above the other on the face towards the traffic.
            let [bottom, pitch, ..] = skin.sizes;
            let mut look = matt(skin.paint);
            if own.x < -0.5 {
                for (i, colour) in [[0.1, 0.9, 0.45], [1.0, 0.6, 0.05], [1.0, 0.08, 0.04]]
                    .iter()
                    .enumerate()
                {
                    let z = bottom + 0.15 + pitch * i as f32;
                    let r = (local.y * local.y + (local.z - z) * (local.z - z)).sqrt();
                    let disc = band(r, -0.1, 0.10, foot);
                    let on = skin.seed as usize == i;
                    look.albedo =
                        blend(look.albedo, dim(*colour, if on { 1.0 } else { 0.06 }), disc);
                    look.glow += if on { 2.0 * disc } else { 0.0 };
                }
            }
            look
        }
        Material::Hill => {
            let wide = grain(scene, su * 0.02, sv * 0.02, COARSE, foot * 0.02);
            let k = 1.0 + 0.9 * grain(scene, su * 0.3, sv * 0.3, COARSE, foot * 0.3) + wide;
            let field = smooth(0.02, 0.12, wide);
            matt(dim(
                blend(skin.paint, [0.24, 0.23, 0.09], field),
                k.max(0.2),
            ))
        }
    };
    // Rain runs down upright walls and leaves streaks.
    let look = if upright
        && matches!(
            skin.material,
            Material::Plaster | Material::Facade | Material::Concrete
        )
        && recess == Recess::Wall
    {
        let streak = grain(scene, u * 0.8, v * 0.07, FINE, foot);
        Look {
            albedo: dim(look.albedo, 1.0 + 0.35 * streak),
            ..look
        }
    } else {
        look
    };
    (look, normal)
}

fn leaves(
    scene: &Scene,
    shape: &Shape,
    local: V3,
    normal: V3,
    own: V3,
    foot: f32,
    shell: u8,
) -> (Look, V3) {
    let skin = &shape.skin;
    let (lu, lv) = leaf_coordinates(shape, local, own);
    let width = foot * LEAF_TEXELS_PER_M;
    let scale = leaf_scale(width);
    let (lu, lv, width) = (lu * scale, lv * scale, width * scale);
    let leaf = scene.textures.leaves.at(lu, lv, width) - 0.5;
    let clump = scene.textures.grain.at(lu * 0.23, lv * 0.23, width * 0.23) - 0.5;
    let bump = scene
        .textures
        .grain
        .at(lu * 0.35 + 190.0, lv * 0.35, width * 0.35)
        - 0.5;
    let deep = 1.0 - 0.22 * f32::from(shell);
    let k = (0.95 + 0.75 * leaf + 1.0 * clump).max(0.12) * deep;
    let tint = blend(skin.paint, skin.trim, (0.3 - 1.2 * clump).clamp(0.0, 0.6));
    let bent = (normal + v3(1.6 * bump, 1.6 * clump, 0.9 * leaf)).unit();
    (matt(dim(tint, k)), bent)
}

fn brick(paint: Rgb, u: f32, v: f32, foot: f32, fine: f32, coarse: f32) -> Look {
    let row = floor_i32(v / 0.085);
    let shifted = u + 0.125 * (row & 1) as f32;
    let joint = stripes(v, 0.085, 0.014, foot).max(stripes(shifted, 0.25, 0.014, foot));
    let stone =
        (hash01(17, floor_i32(shifted / 0.25), row) - 0.5) * (1.0 - smooth(0.05, 0.16, foot));
    let body = dim(
        paint,
        (1.0 + 0.7 * fine + 1.0 * coarse + 0.7 * stone).max(0.2),
    );
    matt(blend(body, [0.40, 0.38, 0.35], 0.7 * joint))
}

fn facade(
    scene: &Scene,
    shape: &Shape,
    local: V3,
    own: V3,
    foot: f32,
    recess: Recess,
    noise: (f32, f32),
) -> Look {
    let skin = &shape.skin;
    let (fine, coarse) = noise;
    let (u, v) = planar(local, own);
    let bricks = skin.seed & 2 != 0;
    let wall = if bricks {
        brick(skin.paint, u, v, foot, fine, coarse).albedo
    } else {
        dim(skin.paint, (1.0 + 0.5 * fine + 0.8 * coarse).max(0.2))
    };
    if own.z != 0.0 && recess == Recess::Wall {
        return matt(dim([0.22, 0.21, 0.20], 1.0 + 0.8 * fine + coarse));
    }
    if recess == Recess::Reveal {
        return matt(dim(skin.trim, 0.85 + 0.3 * fine));
    }
    let Some(cell) = window_cell(shape, local, own) else {
        return matt(wall);
    };
    let seed = skin.seed ^ 0x55;
    let state = hash01(seed, cell.column, cell.row);
    if recess == Recess::Wall {
        // A frame of the second colour around the opening, a band between storeys.
        let outer = band(
            cell.du,
            -cell.half_width - 0.13,
            cell.half_width + 0.13,
            foot,
        ) * band(cell.dv, -0.16, cell.height + 0.13, foot);
        let belt = band(cell.dv, -0.55 - 0.12, -0.55, foot) * 0.6;
        return matt(blend(
            wall,
            dim(skin.trim, 1.0 + 0.5 * fine + 0.4 * coarse),
            outer.max(belt),
        ));
    }
    // The pane: sash bars, then shutter, curtain or dark room behind glass.
    let bar = 1.0
        - band(cell.du.abs(), 0.035, cell.half_width - 0.07, foot)
            * band(cell.dv, 0.07, cell.height - 0.07, foot);
    let cross = band(cell.dv, 0.66 * cell.height, 0.66 * cell.height + 0.05, foot);
    let sash = bar.max(cross);
    let down = cell.dv / cell.height;
    let (inside, gloss) = if state < 0.16 {
        // Roller shutter, partly or wholly down.
        let slats = stripes(cell.dv, 0.06, 0.02, foot);
        (dim([0.50, 0.48, 0.43], 1.0 - 0.35 * slats), 0.02)
    } else if state < 0.55 {
        let folds = grain(
            scene,
            cell.du * 1.5 + state * 9.0,
            cell.dv * 0.1,
            FINE,
            foot,
        );
        let drawn = if down > 0.3 || state < 0.35 {
            1.0
        } else {
            0.25
        };
        (
            dim([0.36, 0.35, 0.33], drawn * (0.7 + 0.9 * folds).max(0.1)),
            0.18,
        )
    } else {
        let things = grain(
            scene,
            cell.du * 0.7 + state * 31.0,
            cell.dv * 0.7,
            FINE,
            foot,
        );
        (
            dim([0.055, 0.06, 0.07], (1.0 + 2.4 * things).max(0.2)),
            0.28,
        )
    };
    let frame: Rgb = if skin.seed & 4 != 0 {
        [0.66, 0.65, 0.62]
    } else {
        [0.20, 0.14, 0.09]
    };
    Look {
        albedo: blend(inside, dim(frame, 1.0 + 0.4 * fine), sash),
        gloss: gloss * (1.0 - sash),
        glow: 0.0,
    }
}

fn painted(skin: &Skin, fine: f32, coarse: f32, height: f32) -> Rgb {
    // Road dirt towards the sills.
    let dirt = (0.5 - height).clamp(0.0, 0.5) * 1.2 + 0.10 + 0.5 * coarse.max(0.0);
    blend(
        dim(skin.paint, 1.0 + 0.35 * fine + 0.5 * coarse),
        [0.13, 0.12, 0.10],
        dirt.clamp(0.0, 0.7),
    )
}

fn car_body(skin: &Skin, p: V3, n: V3, foot: f32, fine: f32, coarse: f32) -> Look {
    let [front, axle_front, axle_rear, wheel] = skin.sizes;
    let mut rgb = painted(skin, fine, coarse, p.z);
    let mut gloss = 0.22;
    let mut dark = band(p.z, 0.0, 0.30, foot);
    let mut glow = 0.0;
    if n.y.abs() > 0.7 {
        for axle in [axle_front, axle_rear] {
            let r = ((p.x - axle) * (p.x - axle) + (p.z - wheel) * (p.z - wheel)).sqrt();
            dark = dark.max(band(r, -1.0, wheel + 0.07, foot));
        }
        // Gaps around the doors, a trim strip, handles.
        let gaps = band(p.x, axle_front - 0.62, axle_front - 0.60, foot)
            .max(band(p.x, -0.16, -0.14, foot))
            .max(band(p.x, axle_rear + 0.42, axle_rear + 0.44, foot));
        rgb = blend(
            rgb,
            [0.02, 0.02, 0.02],
            0.8 * gaps * band(p.z, 0.32, 2.0, foot),
        );
        rgb = blend(rgb, skin.trim, 0.7 * band(p.z, 0.50, 0.56, foot));
        let handle = band(p.z, 0.74, 0.78, foot) * stripes(p.x + 10.0, 1.05, 0.16, foot);
        rgb = blend(rgb, [0.03, 0.03, 0.03], handle);
    } else if n.x < -0.5 {
        let side = p.y.abs();
        let lamp = band(side, 0.50, 0.80, foot) * band(p.z, 0.62, 0.84, foot);
        rgb = blend(rgb, [0.42, 0.015, 0.015], lamp);
        glow += 0.25 * lamp;
        let plate = band(side, -1.0, 0.26, foot) * band(p.z, 0.50, 0.61, foot);
        let letters = stripes(p.y + 5.0, 0.075, 0.03, foot);
        rgb = blend(rgb, dim([0.70, 0.70, 0.68], 1.0 - 0.6 * letters), plate);
        dark = dark.max(band(p.z, 0.30, 0.44, foot) * 0.7);
        rgb = blend(rgb, [0.02, 0.02, 0.02], 0.7 * band(p.z, 0.855, 0.875, foot));
    } else if n.x > 0.5 {
        let side = p.y.abs();
        let lamp = band(side, 0.46, 0.80, foot) * band(p.z, 0.56, 0.72, foot);
        rgb = blend(
            rgb,
            dim(
                [0.34, 0.35, 0.37],
                1.0 + 0.8 * stripes(side, 0.1, 0.05, foot),
            ),
            lamp,
        );
        let grille = band(side, -1.0, 0.40, foot) * band(p.z, 0.54, 0.70, foot);
        rgb = blend(
            rgb,
            dim([0.05, 0.05, 0.05], 1.0 + stripes(p.z, 0.05, 0.02, foot)),
            grille,
        );
        let plate = band(side, -1.0, 0.26, foot) * band(p.z, 0.38, 0.49, foot);
        rgb = blend(
            rgb,
            dim(
                [0.70, 0.70, 0.68],
                1.0 - 0.6 * stripes(p.y + 5.0, 0.075, 0.03, foot),
            ),
            plate,
        );
        dark = dark.max(band(p.z, 0.28, 0.36, foot) * 0.8);
    } else {
        let seam = band(p.y.abs(), 0.62, 0.65, foot)
            .max(band(p.x, front - 0.36, front - 0.33, foot) * band(p.y.abs(), -1.0, 0.62, foot));
        rgb = blend(rgb, [0.02, 0.02, 0.02], 0.7 * seam);
    }
    gloss *= 1.0 - dark;
    Look {
        albedo: blend(rgb, [0.02, 0.02, 0.02], dark),
        gloss,
        glow,
    }
}

fn car_cabin(skin: &Skin, p: V3, n: V3, foot: f32, coarse: f32) -> Look {
    let [screen, roof, belt, rear_foot] = skin.sizes;
    if n.z > 0.85 {
        return Look {
            gloss: 0.22,
            ..matt(dim(skin.paint, 1.0 + 0.4 * coarse))
        };
    }
    let glass = if n.y.abs() > 0.6 {
        // Side windows between leaning pillars.
        let lean = (p.z - belt) / (roof - belt);
        let from = rear_foot + 0.22 + 0.5 * lean;
        let to = screen - 0.16 - 0.80 * lean;
        let post = band(p.x, -0.20, -0.08, foot)
            .max(band(p.x, 0.5 * (from - 0.12), 0.5 * (from - 0.12) + 0.05, foot) * 0.5);
        band(p.x, from, to, foot) * band(p.z, belt + 0.04, roof - 0.11, foot) * (1.0 - post)
    } else {
        band(p.y.abs(), -1.0, 0.66 - 0.24 * (p.z - belt), foot)
            * band(p.z, belt + 0.05, roof - 0.09, foot)
    };
    // Seats and heads behind the glass.
    let seat = band(p.y.abs(), 0.18, 0.55, foot) * band(p.z, 0.0, roof - 0.27, foot);
    let pane = dim([0.045, 0.05, 0.055], 1.0 - 0.5 * seat + coarse);
    Look {
        albedo: blend(dim(skin.paint, 1.0 + 0.3 * coarse), pane, glass),
        gloss: 0.22 + 0.25 * glass,
        glow: 0.0,
    }
}

fn van_body(skin: &Skin, p: V3, n: V3, foot: f32, fine: f32, coarse: f32) -> Look {
    let [front, axle_front, axle_rear, roof] = skin.sizes;
    let mut rgb = painted(skin, fine, coarse, p.z);
    let mut glass = 0.0_f32;
    let mut dark = band(p.z, 0.0, 0.42, foot) * 0.8;
    if n.y.abs() > 0.7 {
        for axle in [axle_front, axle_rear] {
            let r = ((p.x - axle) * (p.x - axle) + (p.z - 0.33) * (p.z - 0.33)).sqrt();
            dark = dark.max(band(r, -1.0, 0.41, foot));
        }
        let lean = (p.z - 1.15).max(0.0);
        glass = band(p.x, front - 2.1, front - 0.75 - 0.62 * lean, foot)
            * band(p.z, 1.15, roof.min(2.1) - 0.28, foot);
        let stripe = band(p.z, 0.72, 0.80, foot);
        let door = band(p.x, front - 2.22, front - 2.19, foot).max(band(
            p.x,
            front - 3.35,
            front - 3.32,
            foot,
        ));
        rgb = blend(rgb, [0.03, 0.03, 0.03], 0.8 * door.max(stripe * 0.6));
        // A name on the side of some.
        if skin.seed & 3 == 0 {
            let words = stripes(p.x + 20.0, 0.30, 0.18, foot)
                * band(p.z, 1.05, 1.35, foot)
                * band(p.x, front - 4.6, front - 2.6, foot);
            rgb = blend(rgb, [0.45, 0.05, 0.05], words);
        }
    } else if n.x > 0.3 {
        glass = band(p.y.abs(), -1.0, 0.80, foot) * band(p.z, 1.22, roof - 0.22, foot);
        let lamp = band(p.y.abs(), 0.52, 0.86, foot) * band(p.z, 0.70, 0.90, foot);
        rgb = blend(rgb, [0.72, 0.73, 0.74], lamp);
        rgb = blend(
            rgb,
            [0.04, 0.04, 0.04],
            band(p.y.abs(), -1.0, 0.48, foot) * band(p.z, 0.68, 0.90, foot),
        );
    } else if n.x < -0.3 {
        glass = band(p.y.abs(), 0.06, 0.78, foot) * band(p.z, 1.22, roof.min(2.2) - 0.25, foot);
        let lamp = band(p.y.abs(), 0.80, 0.95, foot) * band(p.z, 0.72, 1.15, foot);
        rgb = blend(rgb, [0.42, 0.02, 0.015], lamp);
        let split = band(p.y.abs(), -1.0, 0.012, foot);
        rgb = blend(rgb, [0.03, 0.03, 0.03], split * 0.8);
        let plate = band(p.y.abs(), -1.0, 0.26, foot) * band(p.z, 0.66, 0.77, foot);
        rgb = blend(
            rgb,
            dim(
                [0.70, 0.70, 0.68],
                1.0 - 0.6 * stripes(p.y + 5.0, 0.075, 0.03, foot),
            ),
            plate,
        );
    }
    let pane = [0.04, 0.045, 0.05];
    Look {
        albedo: blend(blend(rgb, pane, glass), [0.02, 0.02, 0.02], dark),
        gloss: (0.14 + 0.3 * glass) * (1.0 - dark),
        glow: 0.0,
    }
}

fn cargo(skin: &Skin, p: V3, n: V3, foot: f32, fine: f32, coarse: f32) -> Look {
    let top = skin.sizes[1];
    let mut rgb = dim(skin.paint, 1.0 + 0.4 * fine + 0.7 * coarse);
    let stripe = band(p.z, top * 0.62, top * 0.74, foot);
    rgb = blend(rgb, skin.trim, stripe);
    let along = if n.y.abs() > 0.5 { p.x } else { p.y };
    let words = stripes(along + 30.0, 0.62, 0.38, foot)
        * band(p.z, top * 0.40, top * 0.56, foot)
        * (1.0 - stripes(p.z, 0.22, 0.05, foot));
    rgb = blend(rgb, dim(skin.trim, 0.7), words);
    if n.x < -0.5 {
        rgb = blend(rgb, [0.05, 0.05, 0.05], band(p.y.abs(), -1.0, 0.02, foot));
        let lamp = band(p.y.abs(), 0.95, 1.2, foot) * band(p.z, 1.0, 1.15, foot);
        rgb = blend(rgb, [0.42, 0.02, 0.015], lamp);
        rgb = blend(
            rgb,
            [0.35, 0.36, 0.37],
            stripes(p.y + 9.0, 0.6, 0.04, foot) * 0.8,
        );
    }
    let seam = stripes(along + 30.0, 1.25, 0.03, foot);
    Look {
        gloss: 0.04,
        ..matt(dim(rgb, 1.0 - 0.3 * seam))
    }
}

fn bus_body(skin: &Skin, p: V3, n: V3, foot: f32, fine: f32, coarse: f32) -> Look {
    let mut rgb = painted(skin, fine, coarse, p.z);
    let glass = if n.y.abs() > 0.6 {
        band(p.z, 1.15, 2.35, foot) * (1.0 - stripes(p.x + 20.0, 1.5, 0.12, foot))
    } else if n.x.abs() > 0.6 {
        band(p.z, 1.1, 2.4, foot) * band(p.y.abs(), -1.0, 1.12, foot)
    } else {
        0.0
    };
    let display = band(p.z, 2.5, 2.75, foot) * band(p.y.abs(), -1.0, 0.7, foot) * n.x.abs();
    rgb = blend(rgb, [0.02, 0.02, 0.02], display);
    rgb = blend(rgb, [0.6, 0.6, 0.58], band(p.z, 0.75, 0.95, foot));
    if n.x < -0.5 {
        rgb = blend(
            rgb,
            [0.42, 0.02, 0.015],
            band(p.y.abs(), 0.95, 1.15, foot) * band(p.z, 0.8, 1.05, foot),
        );
    }
    Look {
        albedo: blend(rgb, skin.trim, glass),
        gloss: 0.12 + 0.3 * glass,
        glow: 0.0,
    }
}

fn sign_plate(skin: &Skin, p: V3, n: V3, foot: f32) -> Look {
    // Plates are made lying along their own x; the painted face looks to +y.
    if n.y < 0.5 {
        return matt([0.30, 0.31, 0.32]);
    }
    let r = (p.x * p.x + p.z * p.z).sqrt();
    let rgb = match skin.seed & 3 {
        0 => {
            let rim = band(r, 0.23, 0.35, foot);
            let mark = band(p.x.abs(), -1.0, 0.10, foot)
                * band(p.z.abs(), -1.0, 0.12, foot)
                * stripes(p.x + 1.0, 0.1, 0.06, foot);
            blend(blend(skin.paint, skin.trim, rim), [0.02, 0.02, 0.02], mark)
        }
        1 => {
            let arrow = band((p.x + p.z).abs(), -1.0, 0.05, foot) * band(r, 0.0, 0.2, foot);
            let rim = band(r, 0.29, 0.31, foot);
            blend(skin.trim, skin.paint, arrow.max(rim))
        }
        2 => {
            let rim = 1.0 - band(p.x.abs(), -1.0, 0.27, foot) * band(p.z.abs(), -1.0, 2.0, foot);
            let words = stripes(p.z + 1.0, 0.13, 0.05, foot) * band(p.x.abs(), -1.0, 0.2, foot);
            blend(skin.paint, skin.trim, rim.max(words))
        }
        _ => {
            // Triangle: distance to the rim from the three edges.
            let edge = (p.z + 0.30).min(0.30 - p.z * 0.56 - p.x.abs() * 0.9 + 0.02);
            let rim = 1.0 - band(edge, 0.09, 9.0, foot);
            let mark = band(p.x.abs(), -1.0, 0.03, foot) * band(p.z, -0.16, 0.14, foot);
            blend(blend(skin.paint, skin.trim, rim), [0.02, 0.02, 0.02], mark)
        }
    };
    Look {
        glow: 0.1,
        ..matt(rgb)
    }
}
