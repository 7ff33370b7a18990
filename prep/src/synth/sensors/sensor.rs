//! How a camera turns radiance into bytes: exposure, gain, response curve, noise.

use crate::synth::random::{Rng, key, mix};
use crate::synth::vector::{Rgb, lerp};
use crate::synth::world::World;

/// How a camera turns radiance into bytes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sensor {
    pub exposure: f32,
    /// Gain of each channel beside the exposure.
    pub gain: Rgb,
    pub seed: u64,
}

impl Sensor {
    /// How camera 2 or 3 exposes a frame: the two differ a little in gain and colour.
    pub fn new(world: &World, camera: u64, frame_seed: u64) -> Self {
        let mut frame = Rng::new(key(&[frame_seed, 19]));
        let mut own = Rng::new(key(&[world.seed, 20, camera]));
        let gain = std::array::from_fn(|_| own.range(0.98, 1.02));
        Self {
            exposure: world.light.exposure * frame.range(0.93, 1.07) * own.range(0.975, 1.025),
            gain,
            seed: key(&[frame_seed, camera]),
        }
    }
}

/// Steps of the response curve over the square root of the exposure.
const STEPS: usize = 4096;

/// The response curve: straight, then a shoulder, then a power of 7/16 (close to the
/// usual 1/2.2 and made of square roots alone).
fn response() -> Vec<f32> {
    (0..=STEPS)
        .map(|i| {
            let root = i as f32 / STEPS as f32 * 2.0;
            let x = root * root;
            let bent = if x < 0.7 {
                x
            } else {
                0.7 + 0.3 * (x - 0.7) / (x - 0.4)
            };
            let quarter = bent.sqrt().sqrt();
            let eighth = quarter.sqrt();
            let level = quarter * eighth * eighth.sqrt();
            // A little more contrast, as cameras on cars are set.
            255.0 * lerp(level, level * level * (3.0 - 2.0 * level), 0.35)
        })
        .collect()
}

/// Picture elements as the camera would store them: 8-bit RGB, row-major.
pub(crate) fn develop(radiance: &[Rgb], sensor: &Sensor) -> Vec<u8> {
    let curve = response();
    let mut bytes = Vec::with_capacity(radiance.len() * 3);
    let seed = key(&[sensor.seed, 8]);
    for (at, rgb) in radiance.iter().enumerate() {
        let noise = mix(seed ^ at as u64);
        for (i, &value) in rgb.iter().enumerate() {
            let exposed = (value * sensor.exposure * sensor.gain[i]).clamp(0.0, 4.0);
            let level = curve[(exposed.sqrt() * (0.5 * STEPS as f32)) as usize];
            // Sum of three 7-bit numbers: near enough to a bell of width 1.5 levels.
            let n = noise >> (21 * i);
            let bell = ((n & 127) + ((n >> 7) & 127) + ((n >> 14) & 127)) as f32 - 190.5;
            bytes.push((level + bell * (1.5 / 63.5) + 0.5).clamp(0.0, 255.0) as u8);
        }
    }
    bytes
}
