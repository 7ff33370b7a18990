//! What surfaces look like: albedo, texture, markings, windows, and their shading.
//!
//! Patterns are filtered by the footprint of the pixel: noise through the pyramid
//! of [`super::noise`], edges by the share of the footprint that they cover.
//! Not here: where the light comes from (`world::light`).

mod facade;
mod ground;
mod materials;
mod pattern;
mod vehicles;

use ground::ground_look;
use materials::shape_look;

use crate::synth::geometry::recess::Recess;
use crate::synth::geometry::shapes::Material;
use crate::synth::geometry::street::Zone;
use crate::synth::scene::{Hit, On, Scene};
use crate::synth::vector::{Rgb, V3, smooth};

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
