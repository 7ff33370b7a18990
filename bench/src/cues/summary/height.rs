//! Height in the visual field (PROTOCOL 5.3): does depth follow the row where an object stands?

use strat_metrics::cues::{
    elasticity, fit_through_origin, implied_camera_height_m, judge, pseudo_angle_deg,
    relative_change, spearman,
};

use super::{
    finding::{Cue, Writer},
    series::{Series, distinct, mean_curve, series},
    size::LEAST_ELASTICITY,
};
use crate::cues::rows::{Condition, CueRow, Unit};

/// The thesis' range of its angle, degrees.
pub const PSEUDO_ANGLE_END: f64 = 60.0;

const HEIGHT: Cue = Cue {
    name: "height in the visual field",
    threshold: LEAST_ELASTICITY,
    test: "elasticity of the depth of a sprite of fixed size against 1/(v - horizon) (1 = the ground's, \
           0 = none)",
    cite_numbers: false,
};

fn ground_depth(row: &CueRow) -> f64 {
    1.0 / row.rows_below_horizon()
}

fn pseudo_angle(row: &CueRow) -> f64 {
    pseudo_angle_deg(row.contact_row, row.bottom_row, row.horizon_row)
}

pub(super) fn visual_height(writer: &mut Writer<'_>, rows: &[&CueRow]) {
    let unit = rows.first().map_or("", |row| row.unit.as_str());
    for name in distinct(rows.iter().map(|row| row.sprite.as_str())) {
        for (condition, label) in [
            (Condition::SizeChanges, "size follows the ground"),
            (Condition::SizeFixed, "size fixed"),
        ] {
            let found = series(rows, name, condition);
            if found.is_empty() {
                continue;
            }
            let tangents = |drawn: &[&Series<'_>]| -> Vec<(f64, f64)> {
                mean_curve(drawn, pseudo_angle, |row| row.depth)
                    .into_iter()
                    .filter(|(angle, _)| *angle <= PSEUDO_ANGLE_END)
                    .map(|(angle, depth)| (angle.to_radians().tan(), depth))
                    .collect()
            };
            let tangents = &tangents;
            writer.add(
                label,
                "a of depth = a tan(pseudo-angle)",
                unit,
                &found,
                |drawn| fit_through_origin(&tangents(drawn)).map(|line| line.slope),
            );
            writer.add(label, "R2 of that fit", "", &found, |drawn| {
                fit_through_origin(&tangents(drawn)).map(|line| line.r_squared)
            });
            writer.add(label, "Spearman rho", "", &found, |drawn| {
                spearman(&mean_curve(drawn, pseudo_angle, |row| row.depth))
            });
            let in_metres = rows
                .iter()
                .all(|row| row.unit == Unit::M && row.focal_px.is_some());
            if in_metres {
                writer.add(label, "implied camera height", "m", &found, |drawn| {
                    let mut heights: Vec<f64> = drawn
                        .iter()
                        .flat_map(|series| series.values())
                        .filter_map(|row| {
                            let below = row.rows_below_horizon();
                            Some(implied_camera_height_m(row.depth, below, row.focal_px?))
                        })
                        .collect();
                    strat_metrics::median(&mut heights)
                });
            }
            let effect = writer.add(label, "elasticity", "", &found, |drawn| {
                elasticity(&mean_curve(drawn, ground_depth, |row| row.depth))
            });
            if condition == Condition::SizeFixed {
                let verdict = judge(effect.as_ref(), HEIGHT.threshold);
                writer.find(HEIGHT, verdict, effect, name, None);
            }
        }
        let (moving, fixed) = (
            series(rows, name, Condition::SizeChanges),
            series(rows, name, Condition::SizeFixed),
        );
        if moving.len() == fixed.len() {
            let both: Vec<(Series<'_>, Series<'_>)> = moving.into_iter().zip(fixed).collect();
            let series = "with and without size change";
            writer.add(series, "mean |A - B| over mean A", "", &both, |drawn| {
                let side = |second: bool| {
                    let side: Vec<&Series<'_>> = drawn
                        .iter()
                        .map(|pair| if second { &pair.1 } else { &pair.0 })
                        .collect();
                    mean_curve(&side, pseudo_angle, |row| row.depth)
                };
                let pairs: Vec<(f64, f64)> = side(false)
                    .iter()
                    .zip(side(true))
                    .map(|(a, b)| (a.1, b.1))
                    .collect();
                relative_change(&pairs)
            });
        }
    }
}
