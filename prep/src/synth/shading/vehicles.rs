//! Bodies of cars, vans, lorries and buses: paint, glass, lamps, plates.

use super::pattern::{Look, band, matt, stripes};
use crate::synth::geometry::shapes::Skin;
use crate::synth::vector::{Rgb, V3, blend, dim};

pub(crate) fn painted(skin: &Skin, fine: f32, coarse: f32, height: f32) -> Rgb {
    // Road dirt towards the sills.
    let dirt = (0.5 - height).clamp(0.0, 0.5) * 1.2 + 0.10 + 0.5 * coarse.max(0.0);
    blend(
        dim(skin.paint, 1.0 + 0.35 * fine + 0.5 * coarse),
        [0.13, 0.12, 0.10],
        dirt.clamp(0.0, 0.7),
    )
}

pub(crate) fn car_body(skin: &Skin, p: V3, n: V3, foot: f32, fine: f32, coarse: f32) -> Look {
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

pub(crate) fn car_cabin(skin: &Skin, p: V3, n: V3, foot: f32, coarse: f32) -> Look {
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

pub(crate) fn van_body(skin: &Skin, p: V3, n: V3, foot: f32, fine: f32, coarse: f32) -> Look {
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

pub(crate) fn cargo(skin: &Skin, p: V3, n: V3, foot: f32, fine: f32, coarse: f32) -> Look {
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

pub(crate) fn bus_body(skin: &Skin, p: V3, n: V3, foot: f32, fine: f32, coarse: f32) -> Look {
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
