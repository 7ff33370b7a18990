//! The recording car's cameras and scanner: calibration per recording day, its
//! text files, and the poses in a scene.
//!
//! Image sizes, focal lengths, principal points, horizontal baselines and the
//! rectifying rotations are those of KITTI's recording days (PROTOCOL 1.1). Two
//! things are simplified, because the world is rendered: the two cameras differ by a
//! sideways shift alone (the millimetres along the other axes are left out), and the
//! scanner's rotation of 2011_09_26 stands in for the days where it is not known.

use strat_splits::Date;

use super::camera::PinholeCamera;
use crate::synth::scene::Scene;
use crate::synth::vector::{V3, v3};

type M3 = [[f64; 3]; 3];

/// Rotation of the scanner against camera 0, recording day 2011_09_26.
const VELO_ROTATION: M3 = [
    [7.533745e-03, -9.999714e-01, -6.166020e-04],
    [1.480249e-02, 7.280733e-04, -9.998902e-01],
    [9.998621e-01, 7.523790e-03, 1.480755e-02],
];

/// One recording day.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Day {
    pub date: Date,
    width: u32,
    height: u32,
    focal: f64,
    cx: f64,
    cy: f64,
    /// Fourth element of the first row of P_rect_02 and P_rect_03.
    shift: [f64; 2],
    rect: M3,
    velo: [f64; 3],
}

/// The five recording days.
pub(crate) const DAYS: [Day; 5] = [
    Day {
        date: Date::D2011_09_26,
        width: 1242,
        height: 375,
        focal: 721.5377,
        cx: 609.5593,
        cy: 172.8540,
        shift: [44.85728, -339.5242],
        rect: [
            [9.999239e-01, 9.837760e-03, -7.445048e-03],
            [-9.869795e-03, 9.999421e-01, -4.278459e-03],
            [7.402527e-03, 4.351614e-03, 9.999631e-01],
        ],
        velo: [-4.069766e-03, -7.631618e-02, -2.717806e-01],
    },
    Day {
        date: Date::D2011_09_28,
        width: 1224,
        height: 370,
        focal: 707.0493,
        cx: 604.0814,
        cy: 180.5066,
        shift: [45.75831, -334.1081],
        rect: [
            [9.999128e-01, 1.009263e-02, -8.511932e-03],
            [-1.012729e-02, 9.999406e-01, -4.037671e-03],
            [8.470675e-03, 4.123522e-03, 9.999556e-01],
        ],
        velo: [-4.069766e-03, -7.631618e-02, -2.717806e-01],
    },
    Day {
        date: Date::D2011_09_29,
        width: 1238,
        height: 374,
        focal: 718.3351,
        cx: 600.3891,
        cy: 181.5122,
        shift: [44.50382, -336.3147],
        rect: [
            [9.999478e-01, 9.791707e-03, -2.925305e-03],
            [-9.806939e-03, 9.999382e-01, -5.238719e-03],
            [2.873828e-03, 5.267134e-03, 9.999820e-01],
        ],
        velo: [-4.069766e-03, -7.631618e-02, -2.717806e-01],
    },
    Day {
        date: Date::D2011_09_30,
        width: 1226,
        height: 370,
        focal: 707.0912,
        cx: 601.8873,
        cy: 183.1104,
        shift: [46.88783, -333.4597],
        rect: [
            [9.999280e-01, 8.085985e-03, -8.866797e-03],
            [-8.123205e-03, 9.999583e-01, -4.169750e-03],
            [8.832711e-03, 4.241477e-03, 9.999520e-01],
        ],
        velo: [-7.137748e-03, -7.482656e-02, -3.336324e-01],
    },
    Day {
        date: Date::D2011_10_03,
        width: 1241,
        height: 376,
        focal: 718.8560,
        cx: 607.1928,
        cy: 185.2157,
        shift: [45.38225, -337.2877],
        rect: [
            [9.999454e-01, 7.259129e-03, -7.519551e-03],
            [-7.292213e-03, 9.999638e-01, -4.381729e-03],
            [7.487471e-03, 4.436324e-03, 9.999621e-01],
        ],
        velo: [-1.377769e-02, -5.542117e-02, -2.918589e-01],
    },
];

/// The rig of one day at a picture size of 1/`divisor` of the native one.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rig {
    day: Day,
    pub width: u32,
    pub height: u32,
    pub focal_px: f64,
    cx: f64,
    cy: f64,
    shift: [f64; 2],
}

impl Rig {
    pub fn new(day: &Day, divisor: u32) -> Self {
        let k = 1.0 / f64::from(divisor);
        // Image points count from 1: the left edge of the first pixel is at 0.5.
        let point = |c: f64| (c - 0.5) * k + 0.5;
        Self {
            day: *day,
            width: day.width / divisor,
            height: day.height / divisor,
            focal_px: day.focal * k,
            cx: point(day.cx),
            cy: point(day.cy),
            shift: day.shift.map(|s| s * k),
        }
    }

    pub fn baseline_m(&self) -> f64 {
        (self.shift[0] - self.shift[1]) / self.focal_px
    }

    /// The rectified camera frame of a scene: eye of camera 0, right, down, forward.
    fn frame(scene: &Scene) -> (V3, V3, V3, V3) {
        let pose = &scene.pose;
        let eye = v3(
            (pose.x - scene.origin.0) as f32,
            (pose.y - scene.origin.1) as f32,
            pose.height_m as f32,
        );
        let (sp, cp) = crate::synth::vector::sin_cos(pose.pitch);
        let (sr, cr) = crate::synth::vector::sin_cos(pose.roll);
        let (cos, sin) = (pose.cos as f32, pose.sin as f32);
        let (sp, cp, sr, cr) = (sp as f32, cp as f32, sr as f32, cr as f32);
        let ahead = v3(cos, sin, 0.0);
        let level = v3(sin, -cos, 0.0);
        let up = v3(0.0, 0.0, 1.0);
        let forward = ahead * cp + up * sp;
        let above = up * cp - ahead * sp;
        let right = level * cr - above * sr;
        let down = -(above * cr + level * sr);
        (eye, right, down, forward)
    }

    /// Camera 2 (left) or 3 (right) of a scene.
    pub fn camera(&self, scene: &Scene, which: usize) -> PinholeCamera {
        let (eye, right, down, forward) = Self::frame(scene);
        let sideways = (-self.shift[which] / self.focal_px) as f32;
        PinholeCamera {
            width: self.width as usize,
            height: self.height as usize,
            focal_px: self.focal_px as f32,
            cx: self.cx as f32,
            cy: self.cy as f32,
            eye: eye + right * sideways,
            right,
            down,
            forward,
        }
    }

    /// The scanner of a scene: its position and its three axes in the scene.
    pub fn scanner(&self, scene: &Scene) -> (V3, [V3; 3]) {
        let (eye, right, down, forward) = Self::frame(scene);
        // Rectified camera 0 = rect * (rotation * velo + translation).
        let rect = |p: [f64; 3]| -> [f64; 3] {
            std::array::from_fn(|i| (0..3).map(|k| self.day.rect[i][k] * p[k]).sum())
        };
        let to_scene =
            |p: [f64; 3]| right * p[0] as f32 + down * p[1] as f32 + forward * p[2] as f32;
        let axis = |j: usize| to_scene(rect(std::array::from_fn(|i| VELO_ROTATION[i][j])));
        (
            eye + to_scene(rect(self.day.velo)),
            [axis(0), axis(1), axis(2)],
        )
    }

    /// `calib_cam_to_cam.txt`.
    pub fn cam_to_cam(&self) -> String {
        let mut text =
            String::from("calib_time: 01-Jan-2000 00:00:00\ncorner_dist: 9.950000e-02\n");
        let size = format!(
            "{} {}",
            number(f64::from(self.width)),
            number(f64::from(self.height))
        );
        let identity = "1.000000e+00 0.000000e+00 0.000000e+00 0.000000e+00 1.000000e+00 0.000000e+00 0.000000e+00 0.000000e+00 1.000000e+00";
        // Cameras 0 and 1 (grey) are not rendered; 1 is given the place of 3.
        for (camera, shift) in [0.0, self.shift[1], self.shift[0], self.shift[1]]
            .iter()
            .enumerate()
        {
            let k = [
                self.focal_px,
                0.0,
                self.cx,
                0.0,
                self.focal_px,
                self.cy,
                0.0,
                0.0,
                1.0,
            ];
            let p = [
                k[0], 0.0, k[2], *shift, 0.0, k[4], k[5], 0.0, 0.0, 0.0, 1.0, 0.0,
            ];
            text.push_str(&format!(
                "S_{camera:02}: {size}\nK_{camera:02}: {}\n",
                numbers(&k)
            ));
            text.push_str(&format!(
                "D_{camera:02}: {}\nR_{camera:02}: {identity}\n",
                numbers(&[0.0; 5])
            ));
            text.push_str(&format!(
                "T_{camera:02}: {}\n",
                numbers(&[shift / self.focal_px, 0.0, 0.0])
            ));
            text.push_str(&format!("S_rect_{camera:02}: {size}\n"));
            // Only camera 0's rotation is applied to scans.
            let rotation = if camera == 0 {
                numbers(&self.day.rect.concat())
            } else {
                identity.to_owned()
            };
            text.push_str(&format!(
                "R_rect_{camera:02}: {rotation}\nP_rect_{camera:02}: {}\n",
                numbers(&p)
            ));
        }
        text
    }

    /// `calib_velo_to_cam.txt`.
    pub fn velo_to_cam(&self) -> String {
        format!(
            "calib_time: 01-Jan-2000 00:00:00\nR: {}\nT: {}\ndelta_f: {}\ndelta_c: {}\n",
            numbers(&VELO_ROTATION.concat()),
            numbers(&self.day.velo),
            numbers(&[0.0; 2]),
            numbers(&[0.0; 2]),
        )
    }

    /// `calib_imu_to_velo.txt`: there is no inertial unit; one is put level behind the scanner.
    pub fn imu_to_velo() -> String {
        format!(
            "calib_time: 01-Jan-2000 00:00:00\nR: {}\nT: {}\n",
            numbers(&[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]),
            numbers(&[-0.8, 0.32, -0.8]),
        )
    }
}

/// The table entry of a recording day.
pub(crate) fn day(date: Date) -> &'static Day {
    let named = |day: &&Day| day.date == date;
    DAYS.iter()
        .find(named)
        .expect("every recording day has an entry")
}

/// A number as KITTI's calibration files write it: `7.215377e+02`.
fn number(value: f64) -> String {
    let text = format!("{value:.6e}");
    match text.split_once('e') {
        Some((digits, power)) => {
            let power: i32 = power.parse().unwrap_or(0);
            format!(
                "{digits}e{}{:02}",
                if power < 0 { '-' } else { '+' },
                power.abs()
            )
        }
        None => text,
    }
}

fn numbers(values: &[f64]) -> String {
    values
        .iter()
        .map(|&v| number(v))
        .collect::<Vec<_>>()
        .join(" ")
}
