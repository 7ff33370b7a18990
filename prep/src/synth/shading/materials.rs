//! The look of a shape by its material.

use super::facade::{brick, facade};
use super::pattern::{COARSE, FINE, Look, band, grain, matt, stripes};
use super::vehicles::{bus_body, car_body, car_cabin, cargo, van_body};
use crate::synth::geometry::recess::Recess;
use crate::synth::geometry::shapes::{
    LEAF_TEXELS_PER_M, Material, Shape, Skin, leaf_coordinates, leaf_scale, planar,
};
use crate::synth::random::hash01;
use crate::synth::scene::Scene;
use crate::synth::vector::{V3, atan2, blend, dim, floor_i32, smooth, v3};

pub(crate) fn shape_look(
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
            let angle = atan2(local.z, local.x) * 0.795_774_7;
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

pub(crate) fn leaves(
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

pub(crate) fn sign_plate(skin: &Skin, p: V3, n: V3, foot: f32) -> Look {
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
