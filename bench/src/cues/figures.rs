//! Figures 4.3 to 4.10: curves from rows alone, and sheets of composites with their depth.
//!
//! Curves (4.5, 4.6, 4.7's steps, 4.9, 4.10) are functions of [`CueRow`]s. Sheets (4.3, 4.4, 4.7,
//! 4.8) show composites of the first background beside what the model makes of them; they need
//! the model once and are kept when a folder is drawn again. Depth is coloured as inverse depth
//! (magma, bright is near) with one scale for all pictures of a sheet.

use image::RgbImage;
use strat_metrics::cues::{fit_through_origin, pseudo_angle_deg, visual_angle_deg};
use strat_store::{image_files, raster::Plane, resize};

use super::{
    experiments::{CAMERA_HEIGHT_M, Cast, Job},
    rows::{Condition, CueRow, Experiment, Unit},
    run::{Background, Reader, compose},
    summary::{PSEUDO_ANGLE_END, distinct, series},
};
use crate::{
    draw::chart::{Chart, Curve, Panel, Sheet, Tile},
    draw::comparison,
    model::{self, Model, ModelError},
    quantity::{self, Scale, ScaleUnit},
};

/// A figure ready to be written: file name without ending, and its SVG.
pub type Figure = (&'static str, String);

/// Width of a picture within a sheet.
const TILE_WIDTH: u32 = 460;
/// JPEG quality of composites within a sheet.
const PICTURE_QUALITY: u8 = 90;
/// Ends the vertical axis: depth is clipped there.
const DEPTH_END_M: f64 = 80.0;
/// The thesis' camera height in equation 4.1, metres.
const EQUATION_HEIGHT_M: f64 = 0.25;

/// Mean and standard deviation over backgrounds of y against x, by step.
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
    for step in steps {
        let rows: Vec<&&CueRow> = found.iter().filter_map(|one| one.get(&step)).collect();
        let count = rows.len() as f64;
        let mean =
            |of: &dyn Fn(&CueRow) -> f64| rows.iter().map(|row| of(row)).sum::<f64>() / count;
        let (at, value) = (mean(&x), mean(&y));
        let squares: f64 = rows.iter().map(|row| (y(row) - value).powi(2)).sum();
        result.points.push((at, value));
        // One background has no deviation.
        let deviation = (squares / (count - 1.0).max(1.0)).sqrt();
        result.band.push((value - deviation, value + deviation));
    }
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
        band: Vec::new(),
        guide: true,
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
            "mean and standard deviation over {} backgrounds; the contact with the ground stays at one row",
            backgrounds_of(rows)
        ),
        panels: vec![
            Panel {
                title: "depth of the sprite".to_owned(),
                x: FACTOR.to_owned(),
                y,
                curves: absolute,
                highest,
            },
            Panel {
                title: "over the clean background's at the same pixels".to_owned(),
                x: FACTOR.to_owned(),
                y: "relative depth".to_owned(),
                highest: highest_of(&relative, names.len()),
                curves: relative,
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
        .map(|ends| ends.1)
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
    };
    Chart {
        title: format!("Figure 4.6  One unfamiliar object against two: {model}"),
        note: format!(
            "mean and standard deviation over {} backgrounds",
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

fn step_chart(model: &str, rows: &[&CueRow]) -> Chart {
    let names = distinct(rows.iter().map(|row| row.sprite.as_str()));
    let unit = if depth_label(rows).1.is_some() {
        "step in depth (m)"
    } else {
        "step in depth (relative)"
    };
    let panels = names
        .iter()
        .map(|name| {
            let line = |condition, label: &str| {
                let size = |row: &CueRow| row.height_px;
                let step = |row: &CueRow| row.step_depth.map_or(f64::NAN, f64::abs);
                curve(rows, (name, condition), label.to_owned(), size, step)
            };
            let clean = curve(
                rows,
                (name, Condition::Same),
                String::new(),
                |row| row.height_px,
                |row| row.clean_step_depth.map_or(f64::NAN, f64::abs),
            );
            Panel {
                title: format!("{name} ({})", familiarity(rows, name)),
                x: "height of the occluder (px)".to_owned(),
                y: unit.to_owned(),
                curves: vec![
                    line(Condition::Same, "same luminance"),
                    line(Condition::Contrast, "occluder of other luminance"),
                    guide("clean background, same pixels", clean.points),
                ],
                highest: None,
            }
        })
        .collect();
    Chart {
        title: format!("Figure 4.7  Depth step at an occluder's edge: {model}"),
        note: format!(
            "|median 3 px outside - median 3 px inside|, mean and standard deviation over {} backgrounds",
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
            "{name}; mean and standard deviation over {} backgrounds",
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
                highest: None,
            },
            Panel {
                title: "measured".to_owned(),
                x: axis,
                y,
                curves,
                highest,
            },
        ],
    }
}

/// What a sheet shows of one composite.
struct Shown {
    picture: RgbImage,
    depth: Plane,
    caption: String,
}

/// The sheets 4.3, 4.4, 4.7 and 4.8 of one model, over the first background.
///
/// # Errors
/// The model fails on a composite.
pub fn sheets(
    model: &mut Model,
    cast: &Cast,
    backgrounds: &[Background],
    clean: &[Result<Plane, String>],
    jobs: &[Job],
) -> Result<Vec<Figure>, ModelError> {
    let Some((place, Ok(clean))) = clean.iter().enumerate().find(|(_, map)| map.is_ok()) else {
        return Ok(Vec::new());
    };
    let background = &backgrounds[place];
    let reader = Reader::new(model, background, clean);
    let unit = reader.unit();
    let model_name = model.name.clone();
    let scales = jobs
        .iter()
        .filter(|job| job.experiment == Experiment::Size)
        .map(|job| job.step)
        .max()
        .unwrap_or(1);
    let mut show = |job: &Job, which: usize| -> Result<Option<Shown>, ModelError> {
        let Some((_, pastes)) = job.composites.get(which) else {
            return Ok(None);
        };
        let (picture, _) = compose(cast, background, pastes);
        let tensor = model::prepare_input(&picture, &model.description.input);
        let depth = reader.whole(&model.predict(&tensor)?);
        let last = pastes.last().map(|paste| paste.place);
        Ok(Some(Shown {
            picture,
            depth,
            caption: last.map_or_else(String::new, |place| {
                format!(
                    "{:.0} px high, contact row {:.0}",
                    place.height_px, place.contact_row
                )
            }),
        }))
    };
    let here = |experiment: Experiment| {
        jobs.iter()
            .filter(move |job| job.background == place && job.experiment == experiment)
    };
    let name_of = |job: &Job| {
        let last = job.composites.first().and_then(|(_, pastes)| pastes.last());
        last.map_or_else(String::new, |paste| cast.sprites[paste.sprite].name.clone())
    };
    let familiar = |job: &Job| {
        let last = job.composites.first().and_then(|(_, pastes)| pastes.last());
        last.is_some_and(|paste| cast.sprites[paste.sprite].familiar)
    };
    let factors = [1, (scales / 10).max(2), (scales / 3).max(3), scales];
    let note = format!(
        "background {}; depth coloured as its inverse, one scale for all, bright is near",
        background.id
    );
    let mut figures = Vec::new();
    for (file, title, wanted) in [
        (
            "fig_4_3",
            "Figure 4.3  Familiar objects of different size",
            true,
        ),
        (
            "fig_4_4",
            "Figure 4.4  Unfamiliar objects of different size",
            false,
        ),
    ] {
        let mut groups: Vec<Vec<Shown>> = Vec::new();
        for experiment in [Experiment::Size, Experiment::SizePair] {
            let of_kind: Vec<&Job> = here(experiment)
                .filter(|job| familiar(job) == wanted)
                .collect();
            for name in distinct(
                of_kind
                    .iter()
                    .map(|job| name_of(job))
                    .collect::<Vec<_>>()
                    .iter()
                    .map(String::as_str),
            ) {
                let mut row = Vec::new();
                for job in of_kind
                    .iter()
                    .filter(|job| factors.contains(&job.step) && name_of(job) == name)
                {
                    if let Some(mut shown) = show(job, 0)? {
                        shown.caption = format!("{name}, k = {}: {}", job.step, shown.caption);
                        row.push(shown);
                    }
                }
                groups.push(row);
            }
        }
        if groups.iter().any(|row| !row.is_empty()) {
            figures.push((
                file,
                pairs_sheet(format!("{title}: {}", model_name), &note, groups, unit).svg(),
            ));
        }
    }
    let mut rows = Vec::new();
    let occlusions: Vec<&Job> = here(Experiment::Occlusion)
        .filter(|job| job.step == 3)
        .collect();
    for job in occlusions {
        if let (Some(same), Some(contrast)) = (show(job, 0)?, show(job, 1)?) {
            rows.push((name_of(job), same, contrast));
        }
    }
    if !rows.is_empty() {
        let title = format!(
            "Figure 4.7  Occlusion and luminance contrast: {}",
            model_name
        );
        figures.push(("fig_4_7", occlusion_sheet(title, &note, &rows, unit).svg()));
    }
    let mut groups = Vec::new();
    for (condition, words) in [
        (Condition::SizeChanges, "A: size follows the ground"),
        (Condition::SizeFixed, "B: size fixed"),
    ] {
        let mut row = Vec::new();
        for job in here(Experiment::Height)
            .filter(|job| {
                job.composites
                    .first()
                    .is_some_and(|(own, _)| *own == condition)
            })
            .filter(|job| [4, 14, 26, 38].contains(&job.step))
        {
            if let Some(mut shown) = show(job, 0)? {
                shown.caption = format!("{words}; {}", shown.caption);
                row.push(shown);
            }
        }
        groups.push(row);
    }
    if groups.iter().any(|row| !row.is_empty()) {
        let title = format!("Figure 4.8  Height in the visual field: {}", model_name);
        figures.push(("fig_4_8", pairs_sheet(title, &note, groups, unit).svg()));
    }
    Ok(figures)
}

fn inverse(depth: &Plane) -> Plane {
    Plane {
        width: depth.width,
        height: depth.height,
        data: depth
            .data
            .iter()
            .map(|&depth| if depth > 0.0 { 1.0 / depth } else { 0.0 })
            .collect(),
    }
}

fn tile(picture: &RgbImage, caption: String) -> Tile {
    Tile {
        caption,
        data: image_files::encode_png_rgb(picture),
        format: "png",
        size: picture.dimensions(),
    }
}

fn tile_size(width: usize, height: usize) -> (usize, usize) {
    let narrow = TILE_WIDTH.min(width as u32) as usize;
    (narrow, (height * narrow).div_ceil(width).max(1))
}

fn picture_tile(picture: &RgbImage, caption: String) -> Tile {
    let (width, height) = tile_size(picture.width() as usize, picture.height() as usize);
    let small = resize::rgb(picture, width as u32, height as u32, resize::Kernel::Area);
    Tile {
        data: image_files::encode_jpeg_rgb(&small, PICTURE_QUALITY),
        format: "jpeg",
        ..tile(&small, caption)
    }
}

fn depth_tile(depth: &Plane, brightest: f32, unit: Unit, caption: String) -> Tile {
    let (width, height) = tile_size(depth.width, depth.height);
    let small = resize::area_f32(&inverse(depth), width, height);
    let scale = Scale {
        unit: (unit == Unit::M).then_some(ScaleUnit::Metres),
        brightest,
    };
    tile(&quantity::colour(&small, scale), caption)
}

/// The brightest colour of several maps together.
fn brightest<'a>(depths: impl Iterator<Item = &'a Plane>) -> f32 {
    depths
        .map(|depth| quantity::brightest_of(&inverse(depth)))
        .fold(f32::MIN_POSITIVE, f32::max)
}

/// Composites in one row, their depth in the row below.
fn pairs_sheet(title: String, note: &str, groups: Vec<Vec<Shown>>, unit: Unit) -> Sheet {
    let brightest = brightest(groups.iter().flatten().map(|shown| &shown.depth));
    let mut rows = Vec::new();
    for group in groups {
        rows.push(
            group
                .iter()
                .map(|shown| picture_tile(&shown.picture, shown.caption.clone()))
                .collect(),
        );
        rows.push(
            group
                .iter()
                .map(|shown| depth_tile(&shown.depth, brightest, unit, "depth".to_owned()))
                .collect(),
        );
    }
    Sheet {
        title,
        note: note.to_owned(),
        rows,
    }
}

/// (a) to (d) of figure 4.7 for each kind of object.
fn occlusion_sheet(
    title: String,
    note: &str,
    rows: &[(String, Shown, Shown)],
    unit: Unit,
) -> Sheet {
    let brightest = brightest(rows.iter().flat_map(|(_, a, b)| [&a.depth, &b.depth]));
    let difference = |a: &Plane, b: &Plane| Plane {
        width: a.width,
        height: a.height,
        data: a
            .data
            .iter()
            .zip(&b.data)
            .map(|(a, b)| (a - b).abs())
            .collect(),
    };
    let changes: Vec<Plane> = rows
        .iter()
        .map(|(_, a, b)| difference(&a.depth, &b.depth))
        .collect();
    // One scale here too; the largest changes would hide the rest.
    let largest = changes
        .iter()
        .map(comparison::percentile_95)
        .fold(f32::MIN_POSITIVE, f32::max);
    let end = match unit {
        Unit::M => format!("{largest:.2} m"),
        Unit::Relative => format!("{largest:.3} (relative)"),
    };
    let mut sheet = Sheet {
        title,
        note: note.to_owned(),
        rows: Vec::new(),
    };
    for ((name, same, contrast), change) in rows.iter().zip(&changes) {
        let (width, height) = tile_size(change.width, change.height);
        let small = resize::area_f32(change, width, height);
        let picture = RgbImage::from_fn(width as u32, height as u32, |x, y| {
            comparison::magma(small.data[y as usize * width + x as usize] / largest)
        });
        sheet.rows.push(vec![
            picture_tile(
                &contrast.picture,
                format!("(a) {name}: occluder of other luminance"),
            ),
            depth_tile(
                &same.depth,
                brightest,
                unit,
                "(b) depth, same luminance".to_owned(),
            ),
            depth_tile(
                &contrast.depth,
                brightest,
                unit,
                "(c) depth, other luminance".to_owned(),
            ),
            tile(&picture, format!("(d) |b - c|, black 0, brightest {end}")),
        ]);
    }
    sheet
}
