//! The street of one drive: its course, its cross-section along the way, and
//! where a ray meets the ground.
//!
//! The street runs along +x; its centre line is `y = centre(x)`, a sum of three
//! waves gentle enough that the lateral distance `l = (y - centre) * cos(heading)`
//! is good to a few centimetres within the carriageway. Left of the centre line is
//! positive. The ground has two levels: carriageway at z = 0 and everything beyond
//! the kerb a little higher.

use crate::synth::random::{Rng, key};
use crate::synth::vector::{V3, sin_cos, smooth, v3};
use std::f64::consts::TAU;

/// Length of a block in metres: what stands beside the street changes between blocks.
pub(crate) const BLOCK_M: f64 = 48.0;

/// Character of a drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Theme {
    City,
    Residential,
    Road,
}

/// What stands along one side of a block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Frontage {
    /// Houses wall to wall.
    Terrace,
    /// Single houses with front gardens.
    Houses,
    Park,
    /// Halls behind a yard.
    Depot,
    /// A wall along the pavement.
    LongWall,
    Forest,
    Field,
}

/// Ground beyond the pavement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Yard {
    Grass,
    Paved,
    Gravel,
}

/// Cross-section of one side within a block.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Section {
    pub frontage: Frontage,
    /// Width of the parking strip, 0 for none.
    pub parking_m: f32,
    /// Width of the pavement, 0 for none.
    pub walk_m: f32,
    pub yard: Yard,
}

/// A side of the street.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Side {
    Left,
    Right,
}

impl Side {
    pub const BOTH: [Side; 2] = [Side::Left, Side::Right];

    /// +1 on the left, -1 on the right.
    pub fn sign(self) -> f32 {
        match self {
            Side::Left => 1.0,
            Side::Right => -1.0,
        }
    }

    fn index(self) -> usize {
        match self {
            Side::Left => 0,
            Side::Right => 1,
        }
    }
}

/// The street of a drive.
#[derive(Clone, Debug)]
pub(crate) struct Street {
    pub seed: u64,
    pub theme: Theme,
    pub lane_m: f32,
    /// Lanes in each direction.
    pub lanes: u32,
    pub kerb_m: f32,
    pub shoulder_m: f32,
    /// A painted line divides the directions.
    pub divided: bool,
    /// Lateral position of the camera car.
    pub camera_l: f32,
    pub speed_mps: f64,
    waves: [(f64, f64, f64); 3],
}

impl Street {
    pub fn new(seed: u64, theme: Theme) -> Self {
        let mut rng = Rng::new(key(&[seed, 1]));
        let lanes = match theme {
            Theme::Road => 1 + u32::from(rng.chance(0.5)),
            Theme::City => 1 + u32::from(rng.chance(0.3)),
            Theme::Residential => 1,
        };
        let lane_m = match theme {
            Theme::Road => rng.range(3.4, 3.8),
            Theme::City => rng.range(3.0, 3.5),
            Theme::Residential => rng.range(2.7, 3.1),
        };
        // Bends tighten from the first to the last wave; some drives are straight.
        let bend = if rng.chance(0.25) {
            0.15
        } else {
            f64::from(rng.range(0.6, 1.0))
        };
        let mut wave = |length: f64, slope: f64| {
            let length = length * f64::from(rng.range(0.8, 1.25));
            let number = TAU / length;
            (bend * slope / number, number, f64::from(rng.angle()))
        };
        let waves = [wave(900.0, 0.16), wave(330.0, 0.16), wave(170.0, 0.13)];
        let lane = rng.below(lanes as usize) as f32;
        let camera_l = -(lane + 0.5) * lane_m + rng.range(-0.15, 0.15);
        Self {
            seed,
            theme,
            lane_m,
            lanes,
            kerb_m: if theme == Theme::Road { 0.04 } else { 0.12 },
            shoulder_m: if theme == Theme::Road {
                rng.range(0.5, 1.5)
            } else {
                0.3
            },
            divided: theme != Theme::Residential || rng.chance(0.3),
            camera_l,
            speed_mps: f64::from(rng.range(8.5, 11.5)),
            waves,
        }
    }

    /// y of the centre line.
    pub fn centre(&self, x: f64) -> f64 {
        self.waves
            .iter()
            .map(|&(amplitude, number, phase)| amplitude * sin_cos(number * x + phase).0)
            .sum()
    }

    /// dy/dx of the centre line.
    pub fn slope(&self, x: f64) -> f64 {
        self.waves
            .iter()
            .map(|&(amplitude, number, phase)| amplitude * number * sin_cos(number * x + phase).1)
            .sum()
    }

    /// Cosine and sine of the heading.
    pub fn heading(&self, x: f64) -> (f64, f64) {
        let slope = self.slope(x);
        let cos = 1.0 / (1.0 + slope * slope).sqrt();
        (cos, slope * cos)
    }

    /// Half width of the side street at the start of block `block`, if one is there.
    pub fn crossing(&self, block: i64) -> Option<f32> {
        let mut rng = Rng::new(key(&[self.seed, 2, block as u64]));
        let share = match self.theme {
            Theme::City => 0.34,
            Theme::Residential => 0.28,
            Theme::Road => 0.06,
        };
        rng.chance(share).then(|| rng.range(3.0, 4.5))
    }

    /// What one side of a block is like.
    pub fn section(&self, side: Side, block: i64) -> Section {
        // Blocks come in pairs of the same kind more often than not.
        let mut rng = Rng::new(key(&[self.seed, 3, side.index() as u64, block as u64]));
        let kind = if rng.chance(0.5) {
            block
        } else {
            block.div_euclid(2) + 100_000
        };
        let mut choice = Rng::new(key(&[self.seed, 4, side.index() as u64, kind as u64]));
        use Frontage::{Depot, Field, Forest, Houses, LongWall, Park, Terrace};
        let frontage = match self.theme {
            Theme::City => choice.pick(&[
                Terrace, Terrace, Terrace, Terrace, Terrace, Park, Depot, LongWall, Houses,
            ]),
            Theme::Residential => choice.pick(&[
                Houses, Houses, Houses, Houses, Terrace, Park, LongWall, Forest,
            ]),
            Theme::Road => choice.pick(&[
                Field, Field, Field, Forest, Forest, LongWall, Park, Depot, Houses,
            ]),
        };
        let parking_m = match self.theme {
            Theme::City if choice.chance(0.65) => 2.3,
            Theme::Residential if choice.chance(0.6) => 2.1,
            _ => 0.0,
        };
        let walk_m = match (self.theme, frontage) {
            (Theme::Road, Houses | Depot) => 2.0,
            (Theme::Road, _) => 0.0,
            (Theme::City, _) => choice.range(2.2, 4.5),
            (Theme::Residential, _) => choice.range(1.4, 2.2),
        };
        let yard = match frontage {
            Terrace => Yard::Paved,
            Depot => choice.pick(&[Yard::Paved, Yard::Gravel]),
            _ => Yard::Grass,
        };
        Section {
            frontage,
            parking_m,
            walk_m,
            yard,
        }
    }

    /// Distance from the centre line to the kerb without parking strip.
    pub fn lanes_m(&self) -> f32 {
        self.lanes as f32 * self.lane_m + self.shoulder_m
    }
}

/// What lies on the ground at a point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Zone {
    Lane,
    Parking,
    Kerb,
    Walk,
    Yard(Yard),
}

/// A point of the ground in street terms.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Spot {
    pub zone: Zone,
    /// Distance along the centre line in metres.
    pub along: f32,
    /// Lateral distance, left positive.
    pub l: f32,
    /// Distance from the middle of the nearest side street and its half width.
    pub crossing: Option<(f32, f32)>,
    /// Lateral distance at which the driving lanes end on this side.
    pub lanes_end: f32,
    /// Lateral distance at which the carriageway ends on this side.
    pub edge: f32,
}

#[derive(Clone, Copy, Debug)]
struct ProfileSample {
    y: f32,
    cos: f32,
    along: f32,
    parking: [f32; 2],
    walk: [f32; 2],
    yard: [Yard; 2],
    /// Middle and half width of a side street near here.
    crossing: Option<(f32, f32)>,
}

/// The stretch of street around one camera position, sampled every metre, in
/// coordinates relative to an origin near the camera.
pub(crate) struct StreetProfile {
    first_x: f32,
    samples: Vec<ProfileSample>,

    pub lanes_m: f32,
    pub lane_m: f32,
    pub lanes: u32,
    pub kerb_m: f32,
    pub divided: bool,
    pub theme: Theme,
    pub seed: u64,
}

/// Where a ray meets the ground.
#[derive(Clone, Copy, Debug)]
pub(crate) struct GroundHit {
    pub t: f32,
    pub normal: V3,
    pub spot: Spot,
}

const BEHIND_M: i64 = 130;
const AHEAD_M: i64 = 420;

impl StreetProfile {
    /// Around the world position `x`, relative to the origin `(ox, oy)`.
    pub fn new(street: &Street, x: f64, ox: f64, oy: f64) -> Self {
        let start = x as i64 - BEHIND_M;
        let mut samples = Vec::new();
        // Distance along the street counts from a multiple of the blocks, so that
        // markings do not move with the camera.
        let anchor = (start.div_euclid(960) * 960) as f64;
        let mut along = 0.0_f64;
        let mut at = anchor;
        let step = |from: f64, to: f64| {
            let (dx, dy) = (to - from, street.centre(to) - street.centre(from));
            (dx * dx + dy * dy).sqrt()
        };
        while at < start as f64 {
            along += step(at, at + 1.0);
            at += 1.0;
        }
        let blocks =
            start.div_euclid(BLOCK_M as i64)..=(start + BEHIND_M + AHEAD_M) / BLOCK_M as i64;
        let crossings: Vec<(f32, f32)> = blocks
            .filter_map(|b| {
                street
                    .crossing(b)
                    .map(|half| ((b as f64 * BLOCK_M - ox) as f32, half))
            })
            .collect();
        for i in 0..BEHIND_M + AHEAD_M {
            let wx = (start + i) as f64;
            let block = (wx / BLOCK_M).floor() as i64;
            let within = wx - block as f64 * BLOCK_M;
            // Blend with the neighbouring block within four metres of the boundary.
            let (other, weight) = if within < BLOCK_M / 2.0 {
                (block - 1, 0.5 - 0.5 * smooth(0.0, 4.0, within as f32))
            } else {
                (
                    block + 1,
                    0.5 - 0.5 * smooth(0.0, 4.0, (BLOCK_M - within) as f32),
                )
            };
            let side = |side: Side| {
                let (a, b) = (street.section(side, block), street.section(side, other));
                let mix = |p: f32, q: f32| p + (q - p) * weight;
                (
                    mix(a.parking_m, b.parking_m),
                    mix(a.walk_m, b.walk_m),
                    a.yard,
                )
            };
            let (l, r) = (side(Side::Left), side(Side::Right));
            samples.push(ProfileSample {
                y: (street.centre(wx) - oy) as f32,
                cos: street.heading(wx).0 as f32,
                along: along as f32,
                parking: [l.0, r.0],
                walk: [l.1, r.1],
                yard: [l.2, r.2],
                crossing: crossings
                    .iter()
                    .copied()
                    .find(|&(at, half)| ((wx - ox) as f32 - at).abs() < half + 11.0),
            });
            along += step(wx, wx + 1.0);
        }
        Self {
            first_x: (start as f64 - ox) as f32,
            samples,
            lanes_m: street.lanes_m(),
            lane_m: street.lane_m,
            lanes: street.lanes,
            kerb_m: street.kerb_m,
            divided: street.divided,
            theme: street.theme,
            seed: street.seed,
        }
    }

    /// What lies at (x, y).
    pub fn spot(&self, x: f32, y: f32) -> Spot {
        let along_x = (x - self.first_x).clamp(0.0, (self.samples.len() - 2) as f32 + 0.999);
        let i = along_x as usize;
        let w = along_x - i as f32;
        let (a, b) = (&self.samples[i], &self.samples[i + 1]);
        let mix = |p: f32, q: f32| p + (q - p) * w;
        let l = (y - mix(a.y, b.y)) * mix(a.cos, b.cos);
        let side = usize::from(l < 0.0);
        let parking = mix(a.parking[side], b.parking[side]);
        let walk = mix(a.walk[side], b.walk[side]);
        let edge = self.lanes_m + parking;
        let distance = l.abs();
        let crossing = a.crossing.map(|(at, half)| (x - at, half));
        let zone = match crossing {
            Some((off, half)) if off.abs() < half && distance < 90.0 => Zone::Lane,
            Some((off, half)) if distance >= edge && off.abs() < half + 2.0 && walk > 0.0 => {
                Zone::Walk
            }
            _ if distance < self.lanes_m => Zone::Lane,
            _ if distance < edge => Zone::Parking,
            _ if distance < edge + walk => Zone::Walk,
            _ => Zone::Yard(a.yard[side]),
        };
        Spot {
            zone,
            along: mix(a.along, b.along),
            l,
            crossing,
            lanes_end: self.lanes_m,
            edge,
        }
    }

    fn is_low(zone: Zone) -> bool {
        matches!(zone, Zone::Lane | Zone::Parking)
    }

    /// Where a ray from above meets the ground before `t_max`.
    pub fn enter(&self, o: V3, d: V3, t_max: f32) -> Option<GroundHit> {
        if d.z >= -1e-7 || o.z <= self.kerb_m {
            return None;
        }
        let up = v3(0.0, 0.0, 1.0);
        let t_high = (self.kerb_m - o.z) / d.z;
        if t_high >= t_max {
            return None;
        }
        let at = |t: f32| self.spot(o.x + d.x * t, o.y + d.y * t);
        let high = at(t_high);
        if !Self::is_low(high.zone) {
            return Some(GroundHit {
                t: t_high,
                normal: up,
                spot: high,
            });
        }
        let t_low = -o.z / d.z;
        let low = at(t_low);
        if Self::is_low(low.zone) {
            return (t_low < t_max).then_some(GroundHit {
                t: t_low,
                normal: up,
                spot: low,
            });
        }
        // The ray passes into the face of the kerb between the two levels.
        let (mut near, mut far) = (t_high, t_low);
        for _ in 0..8 {
            let middle = 0.5 * (near + far);
            if Self::is_low(at(middle).zone) {
                near = middle;
            } else {
                far = middle;
            }
        }
        let mut spot = at(far);
        spot.zone = Zone::Kerb;
        let across = v3(d.x, d.y, 0.0).unit();
        (far < t_max).then_some(GroundHit {
            t: far,
            normal: -across,
            spot,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slope_is_the_derivative_of_the_centre_line_and_stays_gentle() {
        for seed in 0..6 {
            let street = Street::new(seed, Theme::City);
            for i in 0..200 {
                let x = f64::from(i) * 7.3;
                let numeric = (street.centre(x + 1e-4) - street.centre(x - 1e-4)) / 2e-4;
                assert!((street.slope(x) - numeric).abs() < 1e-6);
                assert!(street.slope(x).abs() < 0.46);
            }
        }
    }

    #[test]
    fn carriageway_is_low_and_the_rest_is_behind_a_kerb() {
        let street = Street::new(3, Theme::City);
        let profile = StreetProfile::new(&street, 500.0, 384.0, street.centre(500.0));
        let o = v3(116.0, street.camera_l, 1.65);
        let hit = profile
            .enter(o, v3(1.0, 0.0, -0.2), 1e9)
            .expect("looks down");
        assert_eq!(hit.spot.zone, Zone::Lane);
        assert!((hit.t - 1.65 / 0.2).abs() < 1e-4);
        assert!(profile.enter(o, v3(1.0, 0.0, 0.2), 1e9).is_none());
        // Sweep sideways: lane first, kerb next, never low again right behind it.
        let mut zones = Vec::new();
        for i in 1..400 {
            let d = v3(0.2, f32::from(i as i16) * 0.02, -0.5);
            if let Some(hit) = profile.enter(o, d, 1e9)
                && zones.last() != Some(&hit.spot.zone)
            {
                zones.push(hit.spot.zone);
            }
        }
        assert_eq!(zones[0], Zone::Lane);
        assert!(zones.contains(&Zone::Kerb), "{zones:?}");
    }
}
