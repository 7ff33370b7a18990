//! Words about made-up rows whose effects are known by construction.

use strat_metrics::{cues::Verdict, statistics::Bootstrap};

use super::*;
use crate::cues::{
    curves,
    rows::{Condition, Unit},
};

const BOOTSTRAP: Bootstrap = Bootstrap {
    resamples: 200,
    seed: 1,
};

/// A row of a model `m` at 10 m.
fn row(sprite: &str, background: u32, step: u32, height_px: f64) -> CueRow {
    CueRow {
        model: "m".to_owned(),
        experiment: Experiment::Size,
        sprite: sprite.to_owned(),
        familiar: true,
        background: format!("b{background}"),
        thesis: true,
        condition: Condition::Single,
        step,
        height_px,
        contact_row: 240.0,
        horizon_row: 172.0,
        bottom_row: 374.0,
        focal_px: Some(721.5),
        ideal_depth_m: None,
        unit: Unit::M,
        depth: 10.0,
        reference_depth: 10.0,
        pixels: 100,
        eroded_px: 2,
        step_depth: None,
        clean_step_depth: None,
        band_px: None,
        band_change: None,
        rest_change: None,
    }
}

/// Series whose steps overlap, come before all known ones, between them and after them.
#[test]
fn a_mean_is_over_the_series_that_have_its_step() {
    let rows = |steps: &[u32]| -> Vec<CueRow> {
        let rows = steps.iter().map(|&step| CueRow {
            depth: f64::from(step * steps.len() as u32),
            ..row("car", 0, step, 80.0)
        });
        rows.collect()
    };
    let (late, early, last) = (rows(&[2, 3, 5]), rows(&[1, 2]), rows(&[4, 7]));
    let drawn = [&late, &early, &last].map(|rows| rows.iter().map(|row| (row.step, row)).collect());
    let drawn: Vec<&series::Series<'_>> = drawn.iter().collect();
    let found = series::mean_curve(&drawn, |row| f64::from(row.step), |row| row.depth);
    let expected = [
        (1.0, 2.0),
        (2.0, 5.0),
        (3.0, 9.0),
        (4.0, 8.0),
        (5.0, 15.0),
        (7.0, 14.0),
    ];
    assert_eq!(found, expected);
}

/// Depth grows with the 0.158th power of 1/size for the car and hardly falls for the pedestrian: a mean
/// over both, 0.074, would be "no".
#[test]
fn objects_are_judged_one_by_one() {
    let mut rows = Vec::new();
    for (sprite, power) in [("car", 0.158), ("pedestrian", -0.01)] {
        for background in 0..6 {
            for step in 1..=10 {
                let height_px = 220.0 / f64::from(step);
                let scale = 1.0 + 0.02 * f64::from(background);
                rows.push(CueRow {
                    depth: 10.0 * scale * f64::from(step).powf(power),
                    reference_depth: 10.0 * scale,
                    ..row(sprite, background, step, height_px)
                });
            }
        }
    }
    let found = summarise(&rows, &BOOTSTRAP);
    let of = |object: &str| {
        found
            .findings
            .iter()
            .find(|one| one.object == object)
            .unwrap()
    };
    let (car, pedestrian) = (of("car"), of("pedestrian"));
    assert!((car.effect.unwrap() - 0.158).abs() < 1e-9, "{car:?}");
    assert!((pedestrian.effect.unwrap() + 0.01).abs() < 1e-9);
    assert_eq!(car.uses.verdict, Verdict::Yes);
    assert_eq!(pedestrian.uses.verdict, Verdict::No);
    let text = found.text();
    assert!(
        text.contains("relative size of familiar objects: car "),
        "{text}"
    );
    assert!(!text.contains("cite"), "{text}");
}

/// A car of 160 to 40 px in ten sizes whose hidden neighbour is seen 6 % of the depth deeper where it
/// is large (five sizes) and 8 % nearer where it is small; with contrast half as much again.
fn occlusions() -> Vec<CueRow> {
    let mut rows = Vec::new();
    for background in 0..6 {
        for step in 1..=10 {
            let height_px = 160.0 - 120.0 * f64::from(step - 1) / 9.0;
            let effect = if step <= 5 { 0.06 } else { -0.08 };
            let noise = 0.0012 * f64::from(background);
            for (condition, factor) in [(Condition::Same, 1.0), (Condition::Contrast, 1.5)] {
                rows.push(CueRow {
                    experiment: Experiment::Occlusion,
                    condition,
                    step_depth: Some(10.0 * (factor * effect + noise) + 0.3),
                    clean_step_depth: Some(0.3),
                    band_change: (condition == Condition::Contrast).then_some(0.3),
                    rest_change: (condition == Condition::Contrast).then_some(0.1),
                    ..row("car", background, step, height_px)
                });
            }
        }
    }
    rows
}

#[test]
fn sizes_are_judged_apart_and_share_a_line_with_their_like() {
    let rows = occlusions();
    let found = summarise(&rows, &BOOTSTRAP);
    let occlusion: Vec<&Finding> = found
        .findings
        .iter()
        .filter(|one| one.cue == "occlusion of familiar objects")
        .collect();
    assert_eq!(occlusion.len(), 10);
    for (index, finding) in occlusion.iter().enumerate() {
        let (effect, verdict) = if index < 5 {
            (0.063, Verdict::Yes)
        } else {
            (-0.077, Verdict::Reversed)
        };
        // 0.0012 times the mean of 0 to 5 comes on top.
        assert!(
            (finding.effect.unwrap() - effect).abs() < 1e-9,
            "{finding:?}"
        );
        assert_eq!(finding.uses.verdict, verdict);
    }
    let labels: Vec<String> = found.lines().into_iter().map(|line| line.label).collect();
    assert_eq!(
        labels[0],
        "occlusion of familiar objects: car, 107 to 160 px (5 sizes)"
    );
    assert_eq!(
        labels[1],
        "occlusion of familiar objects: car, 40 to 93 px (5 sizes)"
    );
    assert_eq!(found.lines()[0].effect, "0.063 to 0.063");
}

/// The step with contrast is half as much again: +50 % or so where it is right, and -50 % where it is
/// wrong, since it grows into the wrong direction.
#[test]
fn contrast_is_judged_with_the_sign_of_the_step_and_says_what_to_cite() {
    let found = summarise(&occlusions(), &BOOTSTRAP);
    let contrast = found
        .findings
        .iter()
        .filter(|one| one.cue.starts_with("luminance"));
    for (index, finding) in contrast.enumerate() {
        // Steps beyond 0.3 m: (0.06 + n) and (0.09 + n) of 10 m, where n is 0.003 in the mean.
        let (growth, verdict) = if index < 5 {
            (0.3 / (0.6 + 0.3 + 0.03), Verdict::Yes)
        } else {
            (-0.4 / (0.8 - 0.3 - 0.03), Verdict::Reversed)
        };
        assert!(
            (finding.effect.unwrap() - growth).abs() < 1e-9,
            "{finding:?} {growth}"
        );
        assert_eq!(finding.uses.verdict, verdict);
        let word = format!("{} (cite the numbers)", verdict.as_str());
        assert_eq!(finding.uses.to_string(), word);
        assert!(found.markdown().contains(&format!("**{word}**")));
    }
}

/// Figure 4.7 draws the very effects that the words judge, with their sign.
#[test]
fn the_figure_has_the_sign_of_the_word() {
    let rows = occlusions();
    let found = summarise(&rows, &BOOTSTRAP);
    let judged: Vec<f64> = found
        .findings
        .iter()
        .filter(|one| one.cue.starts_with("occlusion"))
        .filter_map(|one| one.effect)
        .collect();
    let all: Vec<&CueRow> = rows.iter().collect();
    let chart = curves::step_chart("m", &all);
    assert!(chart.panels[0].signed);
    let drawn: Vec<f64> = chart.panels[0].curves[0]
        .points
        .iter()
        .map(|point| point.1)
        .collect();
    assert_eq!(drawn.len(), 10);
    for (drawn, judged) in drawn.iter().zip(&judged) {
        assert!((drawn - judged).abs() < 1e-12, "{drawn} {judged}");
    }
    assert!(drawn[0] > 0.0 && drawn[9] < 0.0);
}
