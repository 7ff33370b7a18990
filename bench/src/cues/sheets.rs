//! Figures 4.3, 4.4, 4.7 and 4.8: composites of the first background beside what the model makes of them.
//!
//! They need the model once and stay when a folder is drawn again. Depth is coloured as inverse depth
//! (magma, bright is near) with one scale for all pictures of a sheet.

use image::RgbImage;
use strat_store::{raster::Plane, resize};

use super::{
    curves::Figure,
    experiments::Job,
    measure::{Composites, compose},
    reader::Reader,
    rows::{Condition, Experiment, Unit},
    summary::distinct,
};
use crate::{
    draw::{
        colour::{brightest_of, magma, percentile_95},
        legend::{Key, Scale, ScaleUnit, uncaptioned},
        sheet::{Sheet, Tile, tile_size},
    },
    model::{self, Model, ModelError},
};

/// Width of a picture within a sheet.
const TILE_WIDTH: u32 = 460;
/// JPEG quality of composites within a sheet.
const PICTURE_QUALITY: u8 = 90;

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
    plan: &Composites<'_>,
    clean: &[Result<Plane, String>],
) -> Result<Vec<Figure>, ModelError> {
    let &Composites {
        cast,
        backgrounds,
        jobs,
    } = plan;
    let Some((first, Ok(clean))) = clean.iter().enumerate().find(|(_, map)| map.is_ok()) else {
        return Ok(Vec::new());
    };
    let background = &backgrounds[first];
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
        let focal_px = background.ground.focal_px;
        let input = model::prepare_input(&picture, &model.description.input, focal_px)?;
        let depth = reader.whole(&model.predict(&input)?);
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
            .filter(move |job| job.background == first && job.experiment == experiment)
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

fn tile_size_of(plane: &Plane) -> (usize, usize) {
    let (width, height) = tile_size(plane.width as u32, plane.height as u32, TILE_WIDTH);
    (width as usize, height as usize)
}

fn picture_tile(picture: &RgbImage, caption: String) -> Tile {
    let size = tile_size(picture.width(), picture.height(), TILE_WIDTH);
    Tile::photograph(picture, size, PICTURE_QUALITY, caption)
}

/// The scale of depth, which holds for a whole sheet.
fn depth_key(brightest: f32, unit: Unit) -> Key {
    Key {
        words: match unit {
            Unit::M => "depth".to_owned(),
            Unit::Relative => "inverse depth, relative".to_owned(),
        },
        scale: Scale {
            unit: (unit == Unit::M).then_some(ScaleUnit::Metres),
            brightest,
        },
        colour: magma,
    }
}

fn depth_tile(depth: &Plane, key: &Key, caption: String) -> Tile {
    let (width, height) = tile_size_of(depth);
    let small = resize::area_f32(&inverse(depth), width, height);
    Tile::drawn(&uncaptioned(&small, key.scale), caption)
}

/// The brightest colour of several maps together.
fn brightest<'a>(depths: impl Iterator<Item = &'a Plane>) -> f32 {
    depths
        .map(|depth| brightest_of(&inverse(depth)))
        .fold(f32::MIN_POSITIVE, f32::max)
}

/// Composites in one row, their depth in the row below.
fn pairs_sheet(title: String, note: &str, groups: Vec<Vec<Shown>>, unit: Unit) -> Sheet {
    let key = depth_key(
        brightest(groups.iter().flatten().map(|shown| &shown.depth)),
        unit,
    );
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
                .map(|shown| depth_tile(&shown.depth, &key, "depth".to_owned()))
                .collect(),
        );
    }
    Sheet {
        title,
        note: note.to_owned(),
        rows,
        keys: vec![key],
    }
}

/// (a) to (d) of figure 4.7 for each kind of object.
fn occlusion_sheet(
    title: String,
    note: &str,
    rows: &[(String, Shown, Shown)],
    unit: Unit,
) -> Sheet {
    let key = depth_key(
        brightest(rows.iter().flat_map(|(_, a, b)| [&a.depth, &b.depth])),
        unit,
    );
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
        .map(|change| percentile_95(change.data.iter().copied()))
        .fold(f32::MIN_POSITIVE, f32::max);
    let end = match unit {
        Unit::M => format!("{largest:.2} m"),
        Unit::Relative => format!("{largest:.3} (relative)"),
    };
    let mut sheet = Sheet {
        title,
        note: note.to_owned(),
        keys: vec![key.clone()],
        ..Sheet::default()
    };
    for ((name, same, contrast), change) in rows.iter().zip(&changes) {
        let (width, height) = tile_size_of(change);
        let small = resize::area_f32(change, width, height);
        let picture = RgbImage::from_fn(width as u32, height as u32, |x, y| {
            magma(small.data[y as usize * width + x as usize] / largest)
        });
        sheet.rows.push(vec![
            picture_tile(
                &contrast.picture,
                format!("(a) {name}: occluder of other luminance"),
            ),
            depth_tile(&same.depth, &key, "(b) depth, same luminance".to_owned()),
            depth_tile(
                &contrast.depth,
                &key,
                "(c) depth, other luminance".to_owned(),
            ),
            Tile::drawn(&picture, format!("(d) |b - c|, black 0, brightest {end}")),
        ]);
    }
    sheet
}
