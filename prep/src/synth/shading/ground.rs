//! The ground: asphalt with its markings, pavement, kerb, yards.

use super::pattern::{COARSE, FINE, Look, band, grain, matt, stripes};
use crate::synth::geometry::street::{GroundHit, Spot, Theme, Yard, Zone};
use crate::synth::random::hash01;
use crate::synth::scene::Scene;
use crate::synth::vector::{V3, blend, dim, floor_i32, smooth, v3};

pub(crate) fn ground_look(
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

pub(crate) fn asphalt(
    scene: &Scene,
    spot: &Spot,
    noise: (f32, f32),
    across: f32,
    along: f32,
) -> Look {
    let (fine, coarse) = noise;
    let profile = &scene.profile;
    let seed = profile.seed as u32;
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
    let track = stripes(distance - 0.55, profile.lane_m * 0.5, 0.5, across.max(0.3));
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
        if profile.divided {
            if profile.lanes == 1 {
                paint = paint.max(band(spot.l, -0.07, 0.07, across) * dash);
            } else {
                paint = paint.max(band(distance, 0.08, 0.22, across));
                paint = paint.max(
                    band(
                        distance,
                        profile.lane_m - 0.07,
                        profile.lane_m + 0.07,
                        across,
                    ) * dash,
                );
            }
        }
        let outer = profile.lanes as f32 * profile.lane_m;
        if profile.theme == Theme::Road {
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
        && profile.theme == Theme::City
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
