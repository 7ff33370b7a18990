//! Figures 4.5, 4.6, 4.7's steps, 4.9 and 4.10: curves from rows alone.

use strat_metrics::cues::{fit_through_origin, pseudo_angle_deg, visual_angle_deg};
use strat_metrics::statistics::mean_interval;

use super::{
    experiments::CAMERA_HEIGHT_M,
    rows::{Condition, CueRow, Experiment, Unit},
    summary::{LEAST_STEP, PSEUDO_ANGLE_END, distinct, relative_step, series},
};
use crate::draw::chart::{Chart, Curve, Panel};

/// A figure ready to be written: file name without extension, and its SVG.
pub type Figure = (&'static str, String);

/// Ends the vertical axis: depth is clipped there.
const DEPTH_END_M: f64 = 80.0;
/// The thesis' camera height in equation 4.1, metres.
const EQUATION_HEIGHT_M: f64 = 0.25;

/// Mean over backgrounds of y against x, by step, with its 95 % interval.
fn curve(
    rows: &[&CueRow],
    (sprite, condition): (&str, Condition),
    label: String,
    x: impl Fn(&CueRow) -> f64,
    y: impl Fn(&CueRow) -> f64,
) -> Curve {
    let found = series(rows, sprite, condition);
    let mut steps: Vec<u32> = found.iter().flat_map(|one| one.keys().copied()).collect();
    steps.sort_unstable();
    steps.dedup();
    let mut result = Curve {
        label,
        ..Curve::default()
    };
    let (mut fewest, mut most) = (usize::MAX, 0);
    for step in steps {
        let rows: Vec<&&CueRow> = found.iter().filter_map(|one| one.get(&step)).collect();
        let count = rows.len() as f64;
        let mean =
            |of: &dyn Fn(&CueRow) -> f64| rows.iter().map(|row| of(row)).sum::<f64>() / count;
        let (at, value) = (mean(&x), mean(&y));
        result.points.push((at, value));
        let values: Vec<f64> = rows.iter().map(|row| y(row)).collect();
        // One background has none.
        let interval = mean_interval(&values);
        result
            .band
            .push(interval.map_or((value, value), |bounds| (bounds.low, bounds.high)));
        fewest = fewest.min(rows.len());
        most = most.max(rows.len());
    }
    result.label += &match (fewest, most) {
        (fewest, most) if fewest >= most => format!(" (n = {most})"),
        (fewest, most) => format!(" (n = {fewest} to {most})"),
    };
    result.points.iter_mut().for_each(|point| {
        if point.0 == 0.0 {
            point.0 = 0.0;
        }
    });
    result
}

fn guide(label: impl Into<String>, points: Vec<(f64, f64)>) -> Curve {
    Curve {
        label: label.into(),
        points,
        guide: true,
        ..Curve::default()
    }
}

fn depth_label(rows: &[&CueRow]) -> (String, Option<f64>) {
    match rows.first().map(|row| row.unit) {
        Some(Unit::Relative) => ("depth (relative: 1 = background's median)".to_owned(), None),
        _ => ("depth (m)".to_owned(), Some(DEPTH_END_M)),
    }
}

fn step_of(row: &CueRow) -> f64 {
    f64::from(row.step)
}

/// All figures that rows alone can make, for one model.
#[must_use]
pub fn curves(model: &str, rows: &[CueRow]) -> Vec<Figure> {
    let of = |experiments: &[Experiment]| -> Vec<&CueRow> {
        rows.iter()
            .filter(|row| row.model == model && experiments.contains(&row.experiment))
            .collect()
    };
    let mut figures = Vec::new();
    let size = of(&[Experiment::Size]);
    if !size.is_empty() {
        figures.push(("fig_4_5", size_chart(model, &size).svg()));
    }
    let pair = of(&[Experiment::SizePair]);
    if !pair.is_empty() {
        let both = of(&[Experiment::Size, Experiment::SizePair]);
        figures.push(("fig_4_6", pair_chart(model, &both, &pair).svg()));
    }
    let occlusion = of(&[Experiment::Occlusion]);
    if !occlusion.is_empty() {
        figures.push(("fig_4_7_steps", step_chart(model, &occlusion).svg()));
    }
    let height = of(&[Experiment::Height]);
    if !height.is_empty() {
        figures.push(("fig_4_9", angle_chart(model, &height).svg()));
        figures.push(("fig_4_10", equation_chart(model, &height).svg()));
    }
    figures
}

fn backgrounds_of(rows: &[&CueRow]) -> usize {
    distinct(rows.iter().map(|row| row.background.as_str())).len()
}

fn familiarity(rows: &[&CueRow], name: &str) -> &'static str {
    if rows.iter().any(|row| row.sprite == name && row.familiar) {
        "familiar"
    } else {
        "unfamiliar"
    }
}

const FACTOR: &str = "factor k that divides the size";

fn size_chart(model: &str, rows: &[&CueRow]) -> Chart {
    let (y, highest) = depth_label(rows);
    let names = distinct(rows.iter().map(|row| row.sprite.as_str()));
    let lines = |value: fn(&CueRow) -> f64| -> Vec<Curve> {
        names
            .iter()
            .map(|name| {
                let label = format!("{name} ({})", familiarity(rows, name));
                curve(rows, (name, Condition::Single), label, step_of, value)
            })
            .collect()
    };
    let mut absolute = lines(|row| row.depth);
    let mut relative = lines(CueRow::relative_depth);
    let shown = names
        .iter()
        .copied()
        .find(|name| familiarity(rows, name) == "familiar")
        .unwrap_or_default();
    if rows.iter().all(|row| row.ideal_depth_m.is_some()) && highest.is_some() {
        let ideal = |row: &CueRow| row.ideal_depth_m.unwrap_or(f64::NAN);
        let line = curve(
            rows,
            (shown, Condition::Single),
            String::new(),
            step_of,
            ideal,
        );
        absolute.push(guide(
            format!("ideal for the {shown}: f h / height in pixels"),
            line.points,
        ));
    }
    let inverse = curve(
        rows,
        (shown, Condition::Single),
        String::new(),
        step_of,
        |row| 1.0 / row.height_px,
    );
    if let (Some(first), Some(start)) = (
        inverse.points.first(),
        relative.first().and_then(|c| c.points.first()),
    ) {
        let ratio = start.1 / first.1;
        let points = inverse
            .points
            .iter()
            .map(|&(x, y)| (x, ratio * y))
            .collect();
        relative.push(guide(
            format!("as 1/size from the {shown}'s first value"),
            points,
        ));
    }
    Chart {
        title: format!("Figure 4.5  Relative size: {model}"),
        note: format!(
            "mean and 95 % interval over {} backgrounds; the contact with the ground stays at one row",
            backgrounds_of(rows)
        ),
        panels: vec![
            Panel {
                title: "depth of the sprite".to_owned(),
                x: FACTOR.to_owned(),
                y,
                curves: absolute,
                highest,
                ..Panel::default()
            },
            Panel {
                title: "over the clean background's at the same pixels".to_owned(),
                x: FACTOR.to_owned(),
                y: "relative depth".to_owned(),
                highest: highest_of(&relative, names.len()),
                curves: relative,
                ..Panel::default()
            },
        ],
    }
}

/// The end of measured curves, where a guide would run far beyond.
fn highest_of(curves: &[Curve], measured: usize) -> Option<f64> {
    let top = curves
        .iter()
        .take(measured)
        .flat_map(|curve| &curve.band)
        .map(|bounds| bounds.1)
        .fold(0.0, f64::max);
    (top > 0.0).then_some(1.05 * top)
}

fn pair_chart(model: &str, both: &[&CueRow], pair: &[&CueRow]) -> Chart {
    let (y, highest) = depth_label(pair);
    let names = distinct(pair.iter().map(|row| row.sprite.as_str()));
    let lines = |value: fn(&CueRow) -> f64| -> Vec<Curve> {
        let one = |name: &&str, condition, words: &str| {
            curve(
                both,
                (name, condition),
                format!("{name} {words}"),
                step_of,
                value,
            )
        };
        names
            .iter()
            .flat_map(|name| {
                [
                    one(name, Condition::Single, "alone"),
                    one(name, Condition::Pair, "beside one of fixed size"),
                ]
            })
            .collect()
    };
    let panel = |title: &str, y: String, curves, highest| Panel {
        title: title.to_owned(),
        x: FACTOR.to_owned(),
        y,
        curves,
        highest,
        ..Panel::default()
    };
    Chart {
        title: format!("Figure 4.6  One unfamiliar object against two: {model}"),
        note: format!(
            "mean and 95 % interval over {} backgrounds",
            backgrounds_of(pair)
        ),
        panels: vec![
            panel("depth of the sprite", y, lines(|row| row.depth), highest),
            panel(
                "over the clean background's at the same pixels",
                "relative depth".to_owned(),
                lines(CueRow::relative_depth),
                None,
            ),
        ],
    }
}

/// The effect that the words about occlusion judge, size by size and with their sign.
pub(super) fn step_chart(model: &str, rows: &[&CueRow]) -> Chart {
    let names = distinct(rows.iter().map(|row| row.sprite.as_str()));
    let panels = names
        .iter()
        .map(|name| {
            let line = |condition, label: &str| {
                let size = |row: &CueRow| row.height_px;
                let step = |row: &CueRow| relative_step(row).unwrap_or(f64::NAN);
                curve(rows, (name, condition), label.to_owned(), size, step)
            };
            let same = line(Condition::Same, "same luminance");
            let at = |value: f64| same.points.iter().map(|point| (point.0, value)).collect();
            let bounds = [
                guide(
                    format!("{LEAST_STEP}: occlusion counts from here"),
                    at(LEAST_STEP),
                ),
                guide(
                    format!("-{LEAST_STEP}: reversed from here"),
                    at(-LEAST_STEP),
                ),
            ];
            let contrast = line(Condition::Contrast, "occluder of other luminance");
            Panel {
                title: format!("{name} ({})", familiarity(rows, name)),
                x: "height of the occluder (px)".to_owned(),
                y: "step beyond the background's, over depth".to_owned(),
                curves: [same, contrast].into_iter().chain(bounds).collect(),
                signed: true,
                ..Panel::default()
            }
        })
        .collect();
    Chart {
        title: format!("Figure 4.7  Depth step at an occluder's edge: {model}"),
        note: format!(
            "above 0: the hidden object is deeper, as it should be; mean and 95 % interval over \
             {} backgrounds",
            backgrounds_of(rows)
        ),
        panels,
    }
}

fn pseudo_angle(row: &CueRow) -> f64 {
    pseudo_angle_deg(row.contact_row, row.bottom_row, row.horizon_row)
}

fn angle_chart(model: &str, rows: &[&CueRow]) -> Chart {
    let (y, highest) = depth_label(rows);
    let name = rows.first().map_or("", |row| row.sprite.as_str());
    let lines = |x: fn(&CueRow) -> f64| -> Vec<Curve> {
        let mut lines = vec![
            curve(
                rows,
                (name, Condition::SizeChanges),
                "A: size follows the ground".to_owned(),
                x,
                |row| row.depth,
            ),
            curve(
                rows,
                (name, Condition::SizeFixed),
                "B: size fixed".to_owned(),
                x,
                |row| row.depth,
            ),
        ];
        if highest.is_some() && rows.iter().all(|row| row.ideal_depth_m.is_some()) {
            let ideal = |row: &CueRow| row.ideal_depth_m.unwrap_or(f64::NAN);
            let line = curve(
                rows,
                (name, Condition::SizeChanges),
                String::new(),
                x,
                ideal,
            );
            lines.push(guide(
                format!("ground seen from {CAMERA_HEIGHT_M} m"),
                line.points,
            ));
        }
        lines
    };
    let panel = |title: &str, x: &str, curves| Panel {
        title: title.to_owned(),
        x: x.to_owned(),
        y: y.clone(),
        curves,
        highest,
        ..Panel::default()
    };
    let mut panels = Vec::new();
    if rows.iter().all(|row| row.focal_px.is_some()) {
        let angle = |row: &CueRow| {
            row.focal_px.map_or(f64::NAN, |focal_px| {
                visual_angle_deg(row.rows_below_horizon(), focal_px)
            })
        };
        panels.push(panel(
            "true angle",
            "angle of the contact from straight down (degrees; 90 = horizon)",
            lines(angle),
        ));
    }
    panels.push(panel(
        "pseudo-angle of the thesis",
        "90 (v_bottom - v) / (v_bottom - horizon) (degrees)",
        lines(pseudo_angle),
    ));
    Chart {
        title: format!("Figure 4.9  Height in the visual field: {model}"),
        note: format!(
            "{name}; mean and 95 % interval over {} backgrounds",
            backgrounds_of(rows)
        ),
        panels,
    }
}

fn equation_chart(model: &str, rows: &[&CueRow]) -> Chart {
    let (y, highest) = depth_label(rows);
    let name = rows.first().map_or("", |row| row.sprite.as_str());
    let tangent = |a: f64| -> Vec<(f64, f64)> {
        (0..=60_u8)
            .map(|degree| (f64::from(degree), a * f64::from(degree).to_radians().tan()))
            .collect()
    };
    let within = |mut line: Curve| {
        let keep: Vec<bool> = line
            .points
            .iter()
            .map(|p| p.0 <= PSEUDO_ANGLE_END)
            .collect();
        let mut kept = keep.iter().copied();
        line.points.retain(|_| kept.next().unwrap_or(false));
        let mut kept = keep.iter().copied();
        line.band.retain(|_| kept.next().unwrap_or(false));
        line
    };
    let mut curves = Vec::new();
    let mut fits = Vec::new();
    for (condition, label) in [
        (Condition::SizeChanges, "A: size follows the ground"),
        (Condition::SizeFixed, "B: size fixed"),
    ] {
        let line = within(curve(
            rows,
            (name, condition),
            label.to_owned(),
            pseudo_angle,
            |row| row.depth,
        ));
        let points: Vec<(f64, f64)> = line
            .points
            .iter()
            .map(|&(angle, depth)| (angle.to_radians().tan(), depth))
            .collect();
        if let Some(fit) = fit_through_origin(&points) {
            let label = format!("{:.2} tan(angle), fit to {}", fit.slope, &label[..1]);
            fits.push(guide(label, tangent(fit.slope)));
        }
        curves.push(line);
    }
    curves.extend(fits);
    let axis = "pseudo-angle (degrees)".to_owned();
    Chart {
        title: format!("Figure 4.10  Equation 4.1, d = h tan(angle): {model}"),
        note: "left: the thesis' curve with its h of 0.25 m; right: the measured depths over the same \
               angles with the h that fits them"
            .to_owned(),
        panels: vec![
            Panel {
                title: "equation 4.1".to_owned(),
                x: axis.clone(),
                y: "d (m)".to_owned(),
                curves: vec![guide("0.25 m tan(angle)", tangent(EQUATION_HEIGHT_M))],
                ..Panel::default()
            },
            Panel {
                title: "measured".to_owned(),
                x: axis,
                y,
                curves,
                highest,
                ..Panel::default()
            },
        ],
    }
}
