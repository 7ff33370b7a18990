//! Relative size (PROTOCOL 5.1): does depth grow as an object shrinks?

use strat_metrics::cues::{
    common_effect, curve_difference, elasticity, estimate, fit_line, judge, range_over_mean,
    spearman,
};

use super::{
    finding::{Cue, Writer},
    series::{Series, distinct, mean_curve, series},
};
use crate::cues::rows::{Condition, CueRow, Unit};

/// An elasticity within this of 0 counts as none: a tenth of the ideal effect.
pub(super) const LEAST_ELASTICITY: f64 = 0.1;

const SIZE: Cue = Cue {
    name: "",
    threshold: LEAST_ELASTICITY,
    test: "elasticity of depth against 1/size (1 = ideal, 0 = none): the part that depth and depth \
           relative to the clean background both show",
    cite_numbers: false,
};

const SECOND: Cue = Cue {
    name: "size relative to a second object",
    threshold: LEAST_ELASTICITY,
    test: "gain in the elasticity of depth against 1/size when a second object of fixed size stands \
           beside it",
    cite_numbers: false,
};

fn smallness(row: &CueRow) -> f64 {
    1.0 / row.height_px
}

/// Elasticity of depth against 1 / size that absolute and relative depth both show.
fn size_effect(drawn: &[&Series<'_>]) -> Option<f64> {
    let absolute = elasticity(&mean_curve(drawn, smallness, |row| row.depth))?;
    let relative = elasticity(&mean_curve(drawn, smallness, CueRow::relative_depth))?;
    Some(common_effect(absolute, relative))
}

pub(super) fn relative_size(writer: &mut Writer<'_>, rows: &[&CueRow]) {
    let step = |row: &CueRow| f64::from(row.step);
    let unit = rows.first().map_or("", |row| row.unit.as_str());
    let names = distinct(rows.iter().map(|row| row.sprite.as_str()));
    for &name in &names {
        let single = series(rows, name, Condition::Single);
        for (label, unit, y) in [
            ("depth", unit, (|row| row.depth) as fn(&CueRow) -> f64),
            ("relative depth", "", CueRow::relative_depth),
        ] {
            let series = format!("{name}, {label}");
            let per_step = format!("{unit} per step").trim_start().to_owned();
            let curve = |drawn: &[&Series<'_>]| mean_curve(drawn, step, y);
            writer.add(&series, "slope", &per_step, &single, |drawn| {
                fit_line(&curve(drawn)).map(|line| line.slope)
            });
            writer.add(&series, "R2", "", &single, |drawn| {
                fit_line(&curve(drawn)).map(|line| line.r_squared)
            });
            writer.add(&series, "Spearman rho", "", &single, |drawn| {
                spearman(&curve(drawn))
            });
            writer.add(&series, "range over mean", "", &single, |drawn| {
                range_over_mean(&curve(drawn).iter().map(|p| p.1).collect::<Vec<_>>())
            });
            writer.add(&series, "elasticity", "", &single, |drawn| {
                elasticity(&mean_curve(drawn, smallness, y))
            });
        }
        let has_ideal = rows.iter().all(|row| row.ideal_depth_m.is_some());
        if unit == Unit::M.as_str() && has_ideal {
            let series = format!("{name}, depth");
            writer.add(&series, "slope over ideal slope", "", &single, |drawn| {
                let ideal = |row: &CueRow| row.ideal_depth_m.unwrap_or(f64::NAN);
                let measured = fit_line(&mean_curve(drawn, step, |row| row.depth))?.slope;
                Some(measured / fit_line(&mean_curve(drawn, step, ideal))?.slope)
            });
        }
    }
    // Objects are judged one by one: a mean over a car and a pedestrian says nothing about either.
    for &name in &names {
        let single = series(rows, name, Condition::Single);
        let effect = estimate(&single, &writer.bootstrap, size_effect);
        let cue = Cue {
            name: if rows.iter().any(|row| row.sprite == name && row.familiar) {
                "relative size of familiar objects"
            } else {
                "relative size of unfamiliar objects"
            },
            ..SIZE
        };
        let verdict = judge(effect.as_ref(), cue.threshold);
        writer.find(cue, verdict, effect, name, None);
    }
    for &name in &names {
        let alone = series(rows, name, Condition::Single);
        let pairs: Vec<(Series<'_>, Series<'_>)> = series(rows, name, Condition::Pair)
            .into_iter()
            .filter_map(|with| {
                let background = &with.values().next()?.background;
                let alone = alone
                    .iter()
                    .find(|one| one.values().any(|row| row.background == *background))?;
                Some((alone.clone(), with))
            })
            .collect();
        if pairs.is_empty() {
            continue;
        }
        type Pair<'a> = (Series<'a>, Series<'a>);
        let of = |drawn: &[&Pair<'_>], second: bool| -> Vec<(f64, f64)> {
            let side: Vec<&Series<'_>> = drawn
                .iter()
                .map(|pair| if second { &pair.1 } else { &pair.0 })
                .collect();
            mean_curve(&side, smallness, |row| row.depth)
        };
        let both = |drawn: &[&Pair<'_>]| -> Vec<(f64, f64)> {
            let (a, b) = (of(drawn, false), of(drawn, true));
            a.iter().zip(&b).map(|(a, b)| (a.1, b.1)).collect()
        };
        let series = format!("{name} alone and beside a second one");
        writer.add(&series, "largest difference", unit, &pairs, |drawn| {
            curve_difference(&both(drawn)).map(|(largest, _)| largest)
        });
        writer.add(&series, "rms difference", unit, &pairs, |drawn| {
            curve_difference(&both(drawn)).map(|(_, rms)| rms)
        });
        let gain = estimate(&pairs, &writer.bootstrap, |drawn| {
            Some(elasticity(&of(drawn, true))? - elasticity(&of(drawn, false))?)
        });
        let verdict = judge(gain.as_ref(), SECOND.threshold);
        writer.find(SECOND, verdict, gain, name, None);
    }
}
