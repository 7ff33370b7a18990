//! Sun, sky and haze of a drive.

use crate::synth::noise::Textures;
use crate::synth::random::{Rng, key};
use crate::synth::vector::{Rgb, V3, blend, dim, sin_cos, smooth, v3};

/// How a drive is lit.
#[derive(Clone, Debug)]
pub(crate) struct Light {
    /// Direction towards the sun (unit length).
    pub sun: V3,
    pub sun_rgb: Rgb,
    /// Light from the sky on a surface that faces up.
    pub sky_rgb: Rgb,
    zenith: Rgb,
    horizon: Rgb,
    cloud: f32,
    cloud_shift: f32,
    haze_m: f32,
    /// Brightness of the picture.
    pub exposure: f32,
}

impl Light {
    pub fn new(seed: u64) -> Self {
        let mut rng = Rng::new(key(&[seed, 5]));
        let (elevation, azimuth) = (rng.range(0.45, 1.0), rng.angle());
        let (se, ce) = sin_cos(f64::from(elevation));
        let (sa, ca) = sin_cos(f64::from(azimuth));
        let overcast = if rng.chance(0.25) {
            rng.range(0.55, 0.95)
        } else {
            rng.range(0.0, 0.3)
        };
        let warm = rng.range(0.0, 1.0);
        let sun = v3((ce * ca) as f32, (ce * sa) as f32, se as f32);
        let sun_rgb = dim(
            [1.0, 0.93 - 0.06 * warm, 0.80 - 0.16 * warm],
            4.4 * (1.0 - 0.92 * overcast),
        );
        let sky_rgb = blend([0.50, 0.62, 0.82], [0.95, 0.97, 1.0], overcast);
        Self {
            sun,
            sun_rgb,
            sky_rgb: dim(sky_rgb, 0.58 + 0.85 * overcast),
            zenith: blend([0.30, 0.48, 0.85], [0.80, 0.84, 0.90], overcast),
            horizon: blend([0.80, 0.88, 0.97], [0.92, 0.94, 0.96], overcast),
            cloud: rng.range(0.15, 0.75).max(overcast),
            cloud_shift: rng.range(0.0, 512.0),
            haze_m: rng.range(900.0, 3000.0),
            exposure: 0.56 * rng.range(0.85, 1.2) / (0.45 + 0.55 * (1.0 - 0.5 * overcast)),
        }
    }

    /// Radiance of the sky in a direction (any length).
    pub fn sky(&self, textures: &Textures, direction: V3) -> Rgb {
        let d = direction.unit();
        let up = d.z.max(0.0);
        let clear = blend(self.horizon, self.zenith, smooth(0.0, 0.55, up));
        let spread = 1.0 / (up + 0.09);
        let scale = 34.0;
        let (u, v) = (
            d.x * spread * scale + self.cloud_shift,
            d.y * spread * scale,
        );
        let thick = textures.grain.at(u, v, 0.8 * spread) * 0.6
            + textures.grain.at(u * 0.31 + 77.0, v * 0.31, 1.0) * 0.4;
        let cover = smooth(0.62 - 0.32 * self.cloud, 0.86 - 0.30 * self.cloud, thick);
        let cloud = dim([1.0, 1.0, 1.02], 0.86 + 0.5 * (thick - 0.5));
        let mut rgb = blend(clear, cloud, cover * smooth(0.0, 0.12, up));
        // Glare around the sun.
        let glare = smooth(0.93, 1.0, d.dot(self.sun)) * 0.5;
        for c in &mut rgb {
            *c = *c * 1.25 + glare;
        }
        rgb
    }

    /// Sky colour without clouds, for reflections: cheap and smooth.
    pub fn reflection(&self, direction: V3) -> Rgb {
        // Street, then a dark skyline, then sky.
        let sky = blend(self.horizon, self.zenith, smooth(0.1, 0.7, direction.z));
        let skyline = blend([0.20, 0.20, 0.18], sky, smooth(0.10, 0.26, direction.z));
        blend(
            [0.13, 0.13, 0.13],
            skyline,
            smooth(-0.05, 0.02, direction.z),
        )
    }

    /// Adds the haze between the camera and something at a distance.
    pub fn through_haze(&self, rgb: Rgb, distance_m: f32) -> Rgb {
        let u = distance_m / self.haze_m;
        let clear = 1.0 / (1.0 + u + 0.5 * u * u);
        blend(dim(self.horizon, 1.05), rgb, clear)
    }
}
