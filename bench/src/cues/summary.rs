//! What the rows say: statistics with intervals, and a verdict per cue.
//!
//! Curves are means over backgrounds; intervals come from drawing whole backgrounds (seeded), so
//! they tell how far another choice of pictures would have moved a figure. A verdict judges one
//! effect that is 0 for a model which ignores the cue, by its whole interval
//! ([`strat_metrics::cues::judge`]); the test is stated beside the word.

use std::{collections::BTreeMap, fmt::Write as _};

use serde::Serialize;
use strat_metrics::{
    cues::{
        Estimate, Verdict, common_effect, curve_difference, elasticity, estimate, fit_line,
        fit_through_origin, implied_camera_height_m, judge, pseudo_angle_deg, range_over_mean,
        relative_change, spearman,
    },
    statistics::Bootstrap,
};

use super::rows::{Condition, CueRow, Experiment, Unit};

/// An elasticity within this of 0 counts as none: a tenth of the ideal effect.
const LEAST_ELASTICITY: f64 = 0.1;
/// A step in depth at an occluder's edge counts from this share of its depth.
const LEAST_STEP: f64 = 0.05;
/// A change of the step by contrast counts from this share of the step.
const LEAST_CONTRAST: f64 = 0.1;
/// Steps below this share of the depth are taken for this share when changes are compared.
const NO_STEP: f64 = 0.01;
/// The thesis' range of its angle, degrees.
pub const PSEUDO_ANGLE_END: f64 = 60.0;

/// One figure about one series.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Statistic {
    /// Name of the model.
    pub model: String,
    /// `relative_size`, `occlusion` or `height`.
    pub cue: &'static str,
    /// Which curve or pair of curves.
    pub series: String,
    /// What is stated.
    pub statistic: &'static str,
    /// Its unit; empty for plain numbers.
    pub unit: String,
    /// The figure.
    pub value: f64,
    /// Lower end of its 95 % interval.
    pub low: Option<f64>,
    /// Upper end.
    pub high: Option<f64>,
    /// Backgrounds.
    pub backgrounds: usize,
}

/// Whether a model uses a cue.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// Name of the model.
    pub model: String,
    /// The cue in words.
    pub cue: &'static str,
    /// The answer.
    pub uses: Verdict,
    /// The effect that was judged.
    pub effect: Option<f64>,
    /// Lower end of its 95 % interval.
    pub low: Option<f64>,
    /// Upper end.
    pub high: Option<f64>,
    /// Effects within this of 0 count as none.
    pub threshold: f64,
    /// Backgrounds.
    pub backgrounds: usize,
    /// The test in words.
    pub test: &'static str,
}

/// Everything that is said about all models.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Summary {
    /// One line per model and cue.
    pub findings: Vec<Finding>,
    /// The figures behind and beside them.
    pub statistics: Vec<Statistic>,
}

/// A series of one background by step.
type Series<'a> = BTreeMap<u32, &'a CueRow>;

/// The rows of one condition, by background.
pub(super) fn series<'a>(
    rows: &[&'a CueRow],
    sprite: &str,
    condition: Condition,
) -> Vec<Series<'a>> {
    let mut found: BTreeMap<&str, Series<'a>> = BTreeMap::new();
    for row in rows {
        if row.sprite == sprite && row.condition == condition {
            found
                .entry(&row.background)
                .or_default()
                .insert(row.step, row);
        }
    }
    found.into_values().collect()
}

/// Mean over backgrounds of x and y at each step.
fn mean_curve(
    drawn: &[&Series<'_>],
    x: impl Fn(&CueRow) -> f64,
    y: impl Fn(&CueRow) -> f64,
) -> Vec<(f64, f64)> {
    let mut sums: BTreeMap<u32, (f64, f64, f64)> = BTreeMap::new();
    for series in drawn {
        for (&step, row) in *series {
            let sum = sums.entry(step).or_default();
            sum.0 += x(row);
            sum.1 += y(row);
            sum.2 += 1.0;
        }
    }
    sums.into_values()
        .map(|(x, y, count)| (x / count, y / count))
        .collect()
}

struct Writer<'a> {
    model: &'a str,
    cue: &'static str,
    bootstrap: Bootstrap,
    out: &'a mut Summary,
}

impl Writer<'_> {
    /// Estimates a statistic over clusters and writes it down where it is defined.
    fn add<T>(
        &mut self,
        series: &str,
        statistic: &'static str,
        unit: &str,
        clusters: &[T],
        of: impl Fn(&[&T]) -> Option<f64>,
    ) -> Option<Estimate> {
        let found = estimate(clusters, &self.bootstrap, of)?;
        self.out.statistics.push(Statistic {
            model: self.model.to_owned(),
            cue: self.cue,
            series: series.to_owned(),
            statistic,
            unit: unit.to_owned(),
            value: found.value,
            low: found.interval.map(|interval| interval.low),
            high: found.interval.map(|interval| interval.high),
            backgrounds: found.clusters,
        });
        Some(found)
    }

    fn find(
        &mut self,
        cue: &'static str,
        uses: Verdict,
        effect: Option<Estimate>,
        threshold: f64,
        test: &'static str,
    ) {
        self.out.findings.push(Finding {
            model: self.model.to_owned(),
            cue,
            uses,
            effect: effect.map(|effect| effect.value),
            low: effect.and_then(|effect| Some(effect.interval?.low)),
            high: effect.and_then(|effect| Some(effect.interval?.high)),
            threshold,
            backgrounds: effect.map_or(0, |effect| effect.clusters),
            test,
        });
    }
}

/// Names in the order of their first row.
pub(crate) fn distinct<'a>(values: impl Iterator<Item = &'a str>) -> Vec<&'a str> {
    let mut names: Vec<&str> = Vec::new();
    for value in values {
        if !names.contains(&value) {
            names.push(value);
        }
    }
    names
}

/// Statistics and verdicts of all models in the rows.
#[must_use]
pub fn summarise(rows: &[CueRow], bootstrap: &Bootstrap) -> Summary {
    let mut summary = Summary::default();
    for model in distinct(rows.iter().map(|row| row.model.as_str())) {
        let of = |wanted: &[Experiment]| -> Vec<&CueRow> {
            rows.iter()
                .filter(|row| row.model == model && wanted.contains(&row.experiment))
                .collect()
        };
        let mut writer = Writer {
            model,
            cue: "relative_size",
            bootstrap: *bootstrap,
            out: &mut summary,
        };
        let size = of(&[Experiment::Size, Experiment::SizePair]);
        if !size.is_empty() {
            relative_size(&mut writer, &size);
        }
        writer.cue = "occlusion";
        let occlusion = of(&[Experiment::Occlusion]);
        if !occlusion.is_empty() {
            luminance(&mut writer, &occlusion);
        }
        writer.cue = "height";
        let height = of(&[Experiment::Height]);
        if !height.is_empty() {
            visual_height(&mut writer, &height);
        }
    }
    summary
}

fn smallness(row: &CueRow) -> f64 {
    1.0 / row.height_px
}

/// Elasticity of depth against 1 / size that absolute and relative depth both show.
fn size_effect(drawn: &[&Series<'_>]) -> Option<f64> {
    let absolute = elasticity(&mean_curve(drawn, smallness, |row| row.depth))?;
    let relative = elasticity(&mean_curve(drawn, smallness, CueRow::relative_depth))?;
    Some(common_effect(absolute, relative))
}

fn relative_size(writer: &mut Writer<'_>, rows: &[&CueRow]) {
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
    for (familiar, cue) in [
        (true, "relative size of familiar objects"),
        (false, "relative size of unfamiliar objects"),
    ] {
        let of_kind: Vec<&str> = names
            .iter()
            .copied()
            .filter(|name| {
                rows.iter()
                    .any(|row| row.sprite == *name && row.familiar == familiar)
            })
            .collect();
        if of_kind.is_empty() {
            continue;
        }
        // One cluster holds all sprites of a background.
        let mut clusters: BTreeMap<&str, BTreeMap<&str, Series<'_>>> = BTreeMap::new();
        for row in rows.iter().filter(|row| row.condition == Condition::Single) {
            if of_kind.contains(&row.sprite.as_str()) {
                clusters
                    .entry(&row.background)
                    .or_default()
                    .entry(&row.sprite)
                    .or_default()
                    .insert(row.step, row);
            }
        }
        let clusters: Vec<_> = clusters.into_values().collect();
        let effect = estimate(&clusters, &writer.bootstrap, |drawn| {
            let effects: Vec<f64> = of_kind
                .iter()
                .map(|name| {
                    let drawn: Vec<&Series<'_>> =
                        drawn.iter().filter_map(|one| one.get(name)).collect();
                    size_effect(&drawn)
                })
                .collect::<Option<_>>()?;
            Some(effects.iter().sum::<f64>() / effects.len() as f64)
        });
        let uses = judge(effect.as_ref(), LEAST_ELASTICITY);
        writer.find(
            cue,
            uses,
            effect,
            LEAST_ELASTICITY,
            "elasticity of depth against 1/size (1 = ideal, 0 = none): the part that depth and depth \
             relative to the clean background both show",
        );
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
        let uses = judge(gain.as_ref(), LEAST_ELASTICITY);
        writer.find(
            "size relative to a second object",
            uses,
            gain,
            LEAST_ELASTICITY,
            "gain in the elasticity of depth against 1/size when a second object of fixed size stands \
             beside it",
        );
    }
}

/// Rows of one background: same and contrast.
type Contrast<'a> = (Vec<&'a CueRow>, Vec<&'a CueRow>);

fn luminance(writer: &mut Writer<'_>, rows: &[&CueRow]) {
    let unit = rows.first().map_or("", |row| row.unit.as_str());
    let mean = |rows: &mut dyn Iterator<Item = f64>| {
        let (mut sum, mut count) = (0.0, 0.0);
        for value in rows {
            sum += value;
            count += 1.0;
        }
        (count > 0.0).then(|| sum / count)
    };
    for name in distinct(rows.iter().map(|row| row.sprite.as_str())) {
        let familiar = rows.iter().any(|row| row.sprite == name && row.familiar);
        let mut clusters: BTreeMap<&str, Contrast<'_>> = BTreeMap::new();
        for row in rows.iter().filter(|row| row.sprite == name) {
            let (same, contrast) = clusters.entry(&row.background).or_default();
            match row.condition {
                Condition::Contrast => contrast.push(row),
                _ => same.push(row),
            }
        }
        let clusters: Vec<Contrast<'_>> = clusters.into_values().collect();
        let step = |drawn: &[&Contrast<'_>], contrast: bool| {
            let rows = drawn
                .iter()
                .flat_map(|pair| if contrast { &pair.1 } else { &pair.0 });
            mean(&mut rows.filter_map(|row| row.step_depth.map(f64::abs)))
        };
        let ratio = |drawn: &[&Contrast<'_>]| {
            let same = step(drawn, false)?;
            (same > 0.0)
                .then(|| step(drawn, true))?
                .map(|contrast| contrast / same)
        };
        let band_ratio = |drawn: &[&Contrast<'_>]| {
            let of = |get: fn(&CueRow) -> Option<f64>| {
                mean(
                    &mut drawn
                        .iter()
                        .flat_map(|pair| &pair.1)
                        .filter_map(|row| get(row)),
                )
            };
            let rest = of(|row| row.rest_change)?;
            let band = of(|row| row.band_change)?;
            (rest > 0.0).then_some(band / rest)
        };
        let depth = |drawn: &[&Contrast<'_>]| {
            mean(&mut drawn.iter().flat_map(|pair| &pair.0).map(|row| row.depth))
        };
        writer.add(name, "step, same luminance", unit, &clusters, |drawn| {
            step(drawn, false)
        });
        writer.add(name, "step, other luminance", unit, &clusters, |drawn| {
            step(drawn, true)
        });
        writer.add(name, "step ratio", "", &clusters, ratio);
        let bands = writer.add(name, "band ratio", "", &clusters, band_ratio);
        let order =
            writer.add(
                name,
                "step beyond the background's, over depth",
                "",
                &clusters,
                |drawn| {
                    let rows = drawn.iter().flat_map(|pair| &pair.0);
                    mean(&mut rows.filter_map(|row| {
                        Some((row.step_depth? - row.clean_step_depth?) / row.depth)
                    }))
                },
            );
        let change = estimate(&clusters, &writer.bootstrap, |drawn| {
            let same = step(drawn, false)?;
            Some((step(drawn, true)? - same) / same.max(NO_STEP * depth(drawn)?))
        });
        writer.find(
            if familiar {
                "occlusion of familiar objects"
            } else {
                "occlusion of unfamiliar objects"
            },
            judge(order.as_ref(), LEAST_STEP),
            order,
            LEAST_STEP,
            "how much deeper the hidden object is than the occluder along its edge, beyond the clean \
             background and over depth",
        );
        let mut uses = judge(change.as_ref(), LEAST_CONTRAST);
        // A change that is the same all over the objects has nothing to do with their edge.
        let at_edge = bands
            .and_then(|bands| bands.interval)
            .is_some_and(|interval| interval.low > 1.0);
        if uses == Verdict::Yes && !at_edge {
            uses = Verdict::Undecided;
        }
        writer.find(
            if familiar {
                "luminance contrast of familiar objects"
            } else {
                "luminance contrast of unfamiliar objects"
            },
            uses,
            change,
            LEAST_CONTRAST,
            "growth of the step in depth at the occluder's edge by contrast, over the step without it; \
             `yes` also needs a band ratio above 1",
        );
    }
}

fn ground_depth(row: &CueRow) -> f64 {
    1.0 / row.rows_below_horizon()
}

fn pseudo_angle(row: &CueRow) -> f64 {
    pseudo_angle_deg(row.contact_row, row.bottom_row, row.horizon_row)
}

fn visual_height(writer: &mut Writer<'_>, rows: &[&CueRow]) {
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
                writer.find(
                    "height in the visual field",
                    judge(effect.as_ref(), LEAST_ELASTICITY),
                    effect,
                    LEAST_ELASTICITY,
                    "elasticity of the depth of a sprite of fixed size against 1/(v - horizon) (1 = the \
                     ground's, 0 = none)",
                );
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

/// At most three digits that matter.
fn short(value: f64) -> String {
    let magnitude = value.abs();
    let decimals = if magnitude >= 100.0 {
        0
    } else if magnitude >= 10.0 {
        1
    } else if magnitude >= 1.0 {
        2
    } else {
        3
    };
    format!("{value:.decimals$}")
}

fn with_interval(value: f64, low: Option<f64>, high: Option<f64>) -> String {
    match (low, high) {
        (Some(low), Some(high)) => format!("{} [{}, {}]", short(value), short(low), short(high)),
        _ => short(value),
    }
}

impl Summary {
    /// The verdicts as text for a terminal.
    #[must_use]
    pub fn text(&self) -> String {
        let mut out = String::new();
        for model in distinct(self.findings.iter().map(|finding| finding.model.as_str())) {
            let _ = writeln!(out, "{model}");
            for finding in self
                .findings
                .iter()
                .filter(|finding| finding.model == model)
            {
                let effect = finding.effect.map_or_else(
                    || "not defined".to_owned(),
                    |effect| with_interval(effect, finding.low, finding.high),
                );
                let _ = writeln!(
                    out,
                    "  {:<42} {:<10} {effect}",
                    finding.cue,
                    finding.uses.as_str()
                );
            }
        }
        out +=
            "\nbehind each word the effect with its 95 % interval; summary.md states the tests\n";
        out
    }

    /// Verdicts and statistics as Markdown.
    #[must_use]
    pub fn markdown(&self) -> String {
        let mut out = String::from("# Depth cues\n\n");
        out += "Intervals (95 %) come from drawing whole backgrounds. `yes`: the whole interval of the \
                effect lies above the threshold; `no`: within it on both sides; `reversed`: below its \
                negative; `undecided`: anything else.\n\n";
        out += "| model | cue | used? | effect | threshold | backgrounds |\n|---|---|---|---|---|---|\n";
        for finding in &self.findings {
            let effect = finding.effect.map_or_else(
                || "not defined".to_owned(),
                |effect| with_interval(effect, finding.low, finding.high),
            );
            let _ = writeln!(
                out,
                "| {} | {} | **{}** | {effect} | {} | {} |",
                finding.model,
                finding.cue,
                finding.uses.as_str(),
                finding.threshold,
                finding.backgrounds
            );
        }
        out += "\n## Tests\n\n";
        for cue in distinct(self.findings.iter().map(|finding| finding.cue)) {
            if let Some(finding) = self.findings.iter().find(|finding| finding.cue == cue) {
                let _ = writeln!(out, "- {cue}: {}.", finding.test);
            }
        }
        out += "\n## Figures behind the words\n\n";
        out += "| model | experiment | series | statistic | value | unit | backgrounds |\n";
        out += "|---|---|---|---|---|---|---|\n";
        for line in &self.statistics {
            let _ = writeln!(
                out,
                "| {} | {} | {} | {} | {} | {} | {} |",
                line.model,
                line.cue,
                line.series.replace('|', "\\|"),
                line.statistic.replace('|', "\\|"),
                with_interval(line.value, line.low, line.high),
                line.unit,
                line.backgrounds
            );
        }
        out
    }
}
