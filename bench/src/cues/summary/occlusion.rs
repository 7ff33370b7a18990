//! Occlusion and luminance contrast (PROTOCOL 5.2): is the hidden object deeper than the occluder, and
//! does the step at the edge grow with its contrast?
//!
//! A step is the depth outside the occluder's edge minus that inside: positive where the hidden object
//! is deeper, as it should be. Words and figure 4.7 use it with this sign; the statistics of PROTOCOL 5.2
//! use its magnitude. Each size is judged apart, because small objects behave unlike large ones.

use std::collections::BTreeMap;

use strat_metrics::cues::{Verdict, estimate, judge};

use super::{
    finding::{Cue, Writer},
    series::distinct,
};
use crate::cues::rows::{Condition, CueRow};

/// A step in depth at an occluder's edge counts from this share of its depth.
pub const LEAST_STEP: f64 = 0.05;
/// A change of the step by contrast counts from this share of the step.
const LEAST_CONTRAST: f64 = 0.1;
/// Steps below this share of the depth are taken for this share when changes are compared.
const NO_STEP: f64 = 0.01;

const OCCLUSION: Cue = Cue {
    name: "",
    threshold: LEAST_STEP,
    test: "how much deeper the hidden object is than the occluder along its edge, beyond the clean \
           background and over depth; each size is judged apart",
    cite_numbers: false,
};

const CONTRAST: Cue = Cue {
    name: "",
    threshold: LEAST_CONTRAST,
    test: "growth of the step in depth at the occluder's edge by contrast, over the step without it; \
           `yes` also needs a band ratio above 1; a model that answers to colour alone gets a word too, \
           so cite the numbers",
    cite_numbers: true,
};

/// The step beyond the clean background's, over depth: what the word about occlusion judges and figure
/// 4.7 draws.
pub(in crate::cues) fn relative_step(row: &CueRow) -> Option<f64> {
    Some((row.step_depth? - row.clean_step_depth?) / row.depth)
}

/// Rows of one background: same and contrast.
type Contrast<'a> = (Vec<&'a CueRow>, Vec<&'a CueRow>);

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (mut sum, mut count) = (0.0, 0.0);
    for value in values {
        sum += value;
        count += 1.0;
    }
    (count > 0.0).then(|| sum / count)
}

/// Mean of something over the rows without or with contrast.
fn mean_of(
    drawn: &[&Contrast<'_>],
    contrast: bool,
    of: impl Fn(&CueRow) -> Option<f64>,
) -> Option<f64> {
    let rows = drawn
        .iter()
        .flat_map(|pair| if contrast { &pair.1 } else { &pair.0 });
    mean(rows.filter_map(|row| of(row)))
}

fn magnitude(row: &CueRow) -> Option<f64> {
    row.step_depth.map(f64::abs)
}

fn step_ratio(drawn: &[&Contrast<'_>]) -> Option<f64> {
    let same = mean_of(drawn, false, magnitude).filter(|same| *same > 0.0)?;
    Some(mean_of(drawn, true, magnitude)? / same)
}

fn band_ratio(drawn: &[&Contrast<'_>]) -> Option<f64> {
    let rest = mean_of(drawn, true, |row| row.rest_change).filter(|rest| *rest > 0.0)?;
    Some(mean_of(drawn, true, |row| row.band_change)? / rest)
}

/// By how much contrast makes the step grow, over the step; both with their sign.
fn growth(drawn: &[&Contrast<'_>]) -> Option<f64> {
    let same = mean_of(drawn, false, |row| row.step_depth)?;
    let other = mean_of(drawn, true, |row| row.step_depth)?;
    let depth = mean_of(drawn, false, |row| Some(row.depth))?;
    Some((other - same) / same.abs().max(NO_STEP * depth))
}

fn clusters<'a>(rows: impl Iterator<Item = &'a CueRow>) -> Vec<Contrast<'a>> {
    let mut clusters: BTreeMap<&str, Contrast<'_>> = BTreeMap::new();
    for row in rows {
        let (same, contrast) = clusters.entry(&row.background).or_default();
        match row.condition {
            Condition::Contrast => contrast.push(row),
            _ => same.push(row),
        }
    }
    clusters.into_values().collect()
}

pub(super) fn occlusion(writer: &mut Writer<'_>, rows: &[&CueRow]) {
    let unit = rows.first().map_or("", |row| row.unit.as_str());
    for name in distinct(rows.iter().map(|row| row.sprite.as_str())) {
        let own: Vec<&CueRow> = rows
            .iter()
            .copied()
            .filter(|row| row.sprite == name)
            .collect();
        let all = clusters(own.iter().copied());
        writer.add(name, "step, same luminance", unit, &all, |drawn| {
            mean_of(drawn, false, magnitude)
        });
        writer.add(name, "step, other luminance", unit, &all, |drawn| {
            mean_of(drawn, true, magnitude)
        });
        writer.add(name, "step ratio", "", &all, step_ratio);
        writer.add(name, "band ratio", "", &all, band_ratio);
        let beyond = "step beyond the background's, over depth";
        writer.add(name, beyond, "", &all, |drawn| {
            mean_of(drawn, false, relative_step)
        });
        let mut steps: Vec<u32> = own.iter().map(|row| row.step).collect();
        steps.sort_unstable();
        steps.dedup();
        for cue in words(own.iter().any(|row| row.familiar)) {
            for &step in &steps {
                let of_size = || own.iter().copied().filter(|row| row.step == step);
                let height_px = mean(of_size().map(|row| row.height_px));
                let sized = clusters(of_size());
                let (effect, verdict) = if cue.cite_numbers {
                    let effect = estimate(&sized, &writer.bootstrap, growth);
                    let bands = estimate(&sized, &writer.bootstrap, band_ratio);
                    // A change that is the same all over the objects has nothing to do with their edge.
                    let at_edge = bands
                        .and_then(|bands| bands.interval)
                        .is_some_and(|interval| interval.low > 1.0);
                    let verdict = match judge(effect.as_ref(), cue.threshold) {
                        Verdict::Yes if !at_edge => Verdict::Undecided,
                        verdict => verdict,
                    };
                    (effect, verdict)
                } else {
                    let effect = estimate(&sized, &writer.bootstrap, |drawn| {
                        mean_of(drawn, false, relative_step)
                    });
                    (effect, judge(effect.as_ref(), cue.threshold))
                };
                writer.find(cue, verdict, effect, name, height_px);
            }
        }
    }
}

/// The two cues under their names.
fn words(familiar: bool) -> [Cue; 2] {
    let names = if familiar {
        [
            "occlusion of familiar objects",
            "luminance contrast of familiar objects",
        ]
    } else {
        [
            "occlusion of unfamiliar objects",
            "luminance contrast of unfamiliar objects",
        ]
    };
    let [occlusion, contrast] = names;
    [
        Cue {
            name: occlusion,
            ..OCCLUSION
        },
        Cue {
            name: contrast,
            ..CONTRAST
        },
    ]
}
