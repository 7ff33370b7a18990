//! What moves: cars in both directions, cyclists, walkers.

use super::frame::{BEHIND_M, Frame};
use super::pose::Pose;
use crate::synth::geometry::street::{BLOCK_M, Side, Theme};
use crate::synth::objects::builder::{Builder, Placement};
use crate::synth::objects::people::{bicycle, person};
use crate::synth::objects::vehicles::{bus, car, truck, van};
use crate::synth::random::{Rng, key};
use crate::synth::vector::{V3, sin_cos};

/// Cars in both directions, cyclists, walkers.
pub(crate) fn traffic(b: &mut Builder, frame: &Frame, pose: &Pose) {
    let t = pose.seconds;
    let mut rng = Rng::new(key(&[frame.seed, 12]));
    let lane = f64::from(frame.street.lane_m);
    let wave = |amplitude: f64, rate: f64, shift: f64| amplitude * sin_cos(rate * t + shift).0;
    // Ahead in the own direction, per lane: one or two cars whose gap breathes.
    for i in 0..frame.street.lanes {
        let l = -((f64::from(i) + 0.5) * lane) as f32;
        let own_lane = (l - frame.street.camera_l).abs() < 1.0;
        let mut gap = if own_lane { 6.0 } else { -12.0 };
        for n in 0..3 {
            let base = f64::from(rng.range(5.0, 30.0));
            let swing = f64::from(rng.range(0.25, 0.9)) * base;
            let (rate, shift) = (f64::from(rng.range(0.12, 0.4)), f64::from(rng.angle()));
            let mut own = Rng::new(key(&[frame.seed, 13, u64::from(i), n]));
            let present = own.chance(if n == 0 { 0.8 } else { 0.6 });
            gap +=
                base + wave(swing * 0.6, rate, shift) + wave(swing * 0.3, 2.3 * rate, 2.0 * shift);
            let x = pose.x + gap;
            if present && frame.visible(x) {
                let place = frame.place(x, l + own.range(-0.25, 0.25), 0.0);
                vehicle(b, place, &mut own);
            }
            gap += 9.0;
        }
    }
    // Oncoming: an endless queue with uneven gaps.
    for i in 0..frame.street.lanes {
        let speed = f64::from(rng.range(7.0, 13.0));
        let spacing = f64::from(rng.range(22.0, 90.0));
        let l = ((f64::from(i) + 0.5) * lane) as f32;
        stream(
            frame,
            [frame.seed, 14, u64::from(i)],
            spacing,
            -speed * t,
            |x, own| {
                if own.chance(0.8) {
                    let place = frame.place(x, l + own.range(-0.25, 0.25), 0.0);
                    vehicle(b, place.offset(V3::default(), 2), own);
                }
            },
        );
    }
    let kerb = frame.kerb();
    if frame.street.theme != Theme::Road || rng.chance(0.5) {
        let spacing = f64::from(rng.range(35.0, 130.0));
        let l = -(frame.street.lanes_m() - 0.75);
        stream(frame, [frame.seed, 15, 0], spacing, 4.6 * t, |x, own| {
            let pedal = sin_cos(5.0 * t + x).0 as f32;
            bicycle(
                b,
                frame.place(x, l + own.range(-0.2, 0.3), 0.0),
                true,
                pedal,
                own,
            );
        });
        stream(
            frame,
            [frame.seed, 15, 1],
            1.6 * spacing,
            -4.2 * t,
            |x, own| {
                let pedal = sin_cos(5.0 * t + x).0 as f32;
                let place = frame.place(x, -l + own.range(-0.3, 0.2), 0.0);
                bicycle(b, place.offset(V3::default(), 2), true, pedal, own);
            },
        );
    }
    let spacing = match frame.street.theme {
        Theme::City => f64::from(rng.range(7.0, 22.0)),
        Theme::Residential => f64::from(rng.range(18.0, 50.0)),
        Theme::Road => 160.0,
    };
    for side in Side::BOTH {
        for (queue, speed) in [(0_u64, 1.3), (1, -1.25)] {
            stream(
                frame,
                [frame.seed, 16, 2 * side as u64 + queue],
                spacing,
                speed * t,
                |x, own| {
                    let section = frame.street.section(side, (x / BLOCK_M).floor() as i64);
                    if section.walk_m < 1.0 {
                        return;
                    }
                    let l = frame.street.lanes_m()
                        + section.parking_m
                        + own.range(0.5, section.walk_m - 0.3);
                    let place = frame.place(x, side.sign() * l, kerb);
                    let place = if speed < 0.0 {
                        place.offset(V3::default(), 2)
                    } else {
                        place
                    };
                    let stride = sin_cos(6.0 * t + 3.0 * x).0 as f32;
                    person(b, place, stride, own);
                },
            );
        }
    }
    // Someone crosses the street now and then.
    if frame.street.theme != Theme::Road {
        stream(frame, [frame.seed, 17, 0], 140.0, 0.0, |x, own| {
            let l = (1.2 * (t + f64::from(own.range(0.0, 60.0)))).rem_euclid(60.0) as f32 - 30.0;
            if l.abs() < frame.street.lanes_m() && (x - pose.x).abs() > 6.0 {
                let place = frame.place(x, l, 0.0).offset(V3::default(), 1);
                person(b, place, sin_cos(6.0 * t).0 as f32, own);
            }
        });
    }
}

fn vehicle(b: &mut Builder, place: Placement, rng: &mut Rng) {
    match rng.below(20) {
        0 => bus(b, place, rng),
        1 | 2 => truck(b, place, rng),
        3..=5 => van(b, place, rng),
        _ => car(b, place, rng),
    }
}

/// Calls `f` for every member of an endless queue that is now near the camera. The
/// members stand `spacing` apart (give or take a third), all moved by `moved`.
fn stream(
    frame: &Frame,
    seed: [u64; 3],
    spacing: f64,
    moved: f64,
    mut f: impl FnMut(f64, &mut Rng),
) {
    let first = ((frame.camera_x - BEHIND_M - moved) / spacing).floor() as i64 - 1;
    let last = ((frame.camera_x + 200.0 - moved) / spacing).floor() as i64 + 1;
    for i in first..=last {
        let mut own = Rng::new(key(&[seed[0], seed[1], seed[2], i as u64]));
        let x = (i as f64 + f64::from(own.range(-0.33, 0.33))) * spacing + moved;
        if frame.visible(x) {
            f(x, &mut own);
        }
    }
}
