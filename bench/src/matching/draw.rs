//! Figure 3.2: costs along the lines of chosen pixels, the pixels in their image, and how often the cheapest
//! place is the true one.

use image::{
    Rgb, RgbImage,
    imageops::{self, FilterType},
};
use strat_metrics::statistics::Ratio;

use super::{
    cost::{Cost, Line},
    survey::{Bin, NEAR_PX, Survey, View},
};
use crate::draw::{
    chart::{Chart, Curve, Panel},
    sheet::{Sheet, Tile, tile_size},
    whiskers::{Mark, Whiskers},
};

/// Widest picture of a pair.
const WIDEST: u32 = 900;
/// Pictures are enlarged by whole numbers up to about this width.
const NARROWEST: u32 = 800;
/// Quality of the pictures.
const QUALITY: u8 = 90;
/// Colours of marks: pixels and true places, and cheapest ones.
const TRUE: Rgb<u8> = Rgb([0, 230, 90]);
const CHEAPEST: Rgb<u8> = Rgb([255, 60, 40]);
const JUDGED: Rgb<u8> = Rgb([60, 110, 255]);

/// A pixel that is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Chosen {
    /// Column and row in the images.
    pub at: (usize, usize),
    /// True disparity in pixels of the images.
    pub truth: f64,
}

/// Pixels with truth by their texture: those at these shares of all, little texture first. Each
/// further pixel is sought away from those before.
#[must_use]
pub fn by_texture(view: &View, shares: &[f64]) -> Vec<Chosen> {
    let apart = view.left.width() as usize / 12;
    let mut ordered: Vec<(f64, Chosen)> = view
        .truths
        .iter()
        .map(|&(x, y, truth)| (view.pair.texture(x, y), Chosen { at: (x, y), truth }))
        .collect();
    ordered.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.at.cmp(&b.1.at)));
    let mut chosen: Vec<Chosen> = Vec::new();
    for share in shares {
        let start = (share * ordered.len().saturating_sub(1) as f64) as usize;
        let is_apart = |one: &&(f64, Chosen)| {
            let far = |other: &Chosen| {
                other
                    .at
                    .0
                    .abs_diff(one.1.at.0)
                    .max(other.at.1.abs_diff(one.1.at.1))
                    > apart
            };
            chosen.iter().all(far)
        };
        let found = ordered.iter().skip(start).find(is_apart);
        let found = found.or_else(|| ordered.get(start)).map(|(_, one)| *one);
        chosen.extend(found);
    }
    chosen
}

/// The pixel with truth that lies nearest to a place, if one is within eight pixels.
#[must_use]
pub fn nearest(view: &View, (x, y): (usize, usize)) -> Option<Chosen> {
    let distance =
        |&&(column, row, _): &&(usize, usize, f64)| column.abs_diff(x).max(row.abs_diff(y));
    let found = view.truths.iter().min_by_key(distance)?;
    (distance(&found) <= 8).then_some(Chosen {
        at: (found.0, found.1),
        truth: found.2,
    })
}

/// Costs along the line of each pixel, a panel each.
#[must_use]
pub fn costs(image: &str, view: &View, chosen: &[(Chosen, Line)], window: Option<usize>) -> String {
    let panels = chosen.iter().zip(1..);
    let panels = panels.map(|((one, line), number)| panel(number, view, one, line));
    let mut note = format!(
        "Each cost as a share of its largest on the line, {} size; the dashed line marks the true disparity, \
         circles the cheapest.",
        if view.native { "native" } else { "prepared" }
    );
    if let Some(window) = window {
        note += &format!(
            " The discriminator's, from its lowest to its largest: its adversarial term for the left image \
             with {window}x{window} px around the pixel from the right image at that disparity."
        );
    }
    Chart {
        title: format!("Figure 3.2  Matching cost along the line of a pixel: {image}"),
        note,
        panels: panels.collect(),
    }
    .svg()
}

fn panel(number: usize, view: &View, one: &Chosen, line: &Line) -> Panel {
    let texture = view.pair.texture(one.at.0, one.at.1);
    let kinds = line.kinds().iter();
    let mut curves: Vec<Curve> = kinds.map(|cost| curve(view, *cost, line)).collect();
    let truth = one.truth * view.scale;
    curves.push(Curve {
        label: format!("true: {truth:.1} px"),
        points: vec![(truth, 0.0), (truth, 1.0)],
        guide: true,
        ..Curve::default()
    });
    curves.extend(untouched(view, line));
    Panel {
        title: format!(
            "{number}: ({}, {}), texture {texture:.1}",
            one.at.0, one.at.1
        ),
        x: "disparity (native px)".to_owned(),
        y: "cost (share of the largest)".to_owned(),
        curves,
        ..Panel::default()
    }
}

/// The costs of one kind by disparity, with a mark at the cheapest where there is one.
fn curve(view: &View, cost: Cost, line: &Line) -> Curve {
    let costs = line.of(cost);
    let largest = costs.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    let lowest = costs.iter().copied().fold(largest, f64::min);
    let cheapest = line.cheapest(cost);
    let place = match cheapest.as_slice() {
        [one] => format!("cheapest at {:.0} px", *one as f64 * view.scale),
        many => format!("{} places equally cheap", many.len()),
    };
    // A window changes little of a patch, so that shares of the largest would all be nearly 1.
    let (label, base) = if cost == Cost::Discriminator {
        let label = format!("{} ({lowest:.4} to {largest:.4}): {place}", cost.heading());
        (label, lowest)
    } else {
        (format!("{}: {place}", cost.heading()), 0.0)
    };
    let range = (largest - base).max(f64::MIN_POSITIVE);
    let points = costs.iter().zip(0..);
    Curve {
        label,
        points: points
            .map(|(cost, disparity)| (f64::from(disparity) * view.scale, (cost - base) / range))
            .collect(),
        marks: if cheapest.len() == 1 {
            cheapest
        } else {
            Vec::new()
        },
        ..Curve::default()
    }
}

/// What the discriminator makes of the left image as it is, on the scale of its curve.
fn untouched(view: &View, line: &Line) -> Option<Curve> {
    let cost = line.untouched?;
    let costs = line.of(Cost::Discriminator);
    let largest = costs.iter().copied().fold(f64::MIN, f64::max);
    let lowest = costs.iter().copied().fold(f64::MAX, f64::min);
    let share = (cost - lowest) / (largest - lowest).max(f64::MIN_POSITIVE);
    let end = costs.len().saturating_sub(1) as f64 * view.scale;
    let is_drawn = (0.0..=1.0).contains(&share);
    Some(Curve {
        label: format!("discriminator of the left image: {cost:.4}"),
        points: if is_drawn {
            vec![(0.0, share), (end, share)]
        } else {
            Vec::new()
        },
        guide: true,
        ..Curve::default()
    })
}

/// The pair with the chosen pixels, their lines, true and cheapest places.
#[must_use]
pub fn places(image: &str, view: &View, chosen: &[(Chosen, Line)]) -> String {
    // Small images are enlarged, so that crosses do not cover what they mark.
    let zoom = (NARROWEST / view.left.width()).max(1);
    let enlarged = |image: &RgbImage| {
        let (width, height) = (zoom * image.width(), zoom * image.height());
        imageops::resize(image, width, height, FilterType::Nearest)
    };
    let (mut left, mut right) = (enlarged(&view.left), enlarged(&view.right));
    let size = tile_size(left.width(), left.height(), WIDEST);
    let at = |x: f64| (x + 0.5) * f64::from(zoom) - 0.5;
    for (one, line) in chosen {
        let (x, y) = (one.at.0 as f64, at(one.at.1 as f64) as usize);
        cross(&mut left, (at(x), y), TRUE);
        let first = one.at.0.saturating_sub(view.largest) as f64;
        for column in at(first) as usize..=at(x) as usize {
            blend(&mut right, (column, y));
        }
        for &cost in [Cost::Objective, Cost::Discriminator]
            .iter()
            .filter(|cost| line.kinds().contains(cost))
        {
            if let [cheapest] = line.cheapest(cost).as_slice() {
                let colour = if cost == Cost::Objective {
                    CHEAPEST
                } else {
                    JUDGED
                };
                cross(&mut right, (at(x - *cheapest as f64), y), colour);
            }
        }
        cross(&mut right, (at(x - one.truth), y), TRUE);
    }
    let judged = chosen.iter().any(|(_, line)| line.untouched.is_some());
    let pixels: Vec<String> = chosen
        .iter()
        .zip(1..)
        .map(|((one, _), number)| format!("{number} at ({}, {})", one.at.0, one.at.1))
        .collect();
    let tile =
        |picture: &RgbImage, caption: String| Tile::photograph(picture, size, QUALITY, caption);
    Sheet {
        title: format!("Figure 3.2  Chosen pixels and their lines: {image}"),
        note: "Green: the pixel and its true place. Red: the cheapest place by DSSIM + 0.1 L1."
            .to_owned()
            + if judged {
                " Blue: by the discriminator."
            } else {
                ""
            },
        rows: vec![
            vec![tile(&left, format!("left: {}", pixels.join(", ")))],
            vec![tile(
                &right,
                "right, with the part of each line that is searched".to_owned(),
            )],
        ],
        ..Sheet::default()
    }
    .svg()
}

/// A cross of five pixels to each side with a gap in the middle.
fn cross(picture: &mut RgbImage, (x, y): (f64, usize), colour: Rgb<u8>) {
    let (x, y) = (x.round() as i64, y as i64);
    for step in 2..=7_i64 {
        for (column, row) in [(x - step, y), (x + step, y), (x, y - step), (x, y + step)] {
            for thick in 0..2 {
                let (column, row) = (column + thick, row + thick);
                if (0..i64::from(picture.width())).contains(&column)
                    && (0..i64::from(picture.height())).contains(&row)
                {
                    picture.put_pixel(column as u32, row as u32, colour);
                }
            }
        }
    }
}

/// Lightens a pixel of a line.
fn blend(picture: &mut RgbImage, (x, y): (usize, usize)) {
    let pixel = picture.get_pixel_mut(x as u32, y as u32);
    pixel.0 = pixel.0.map(|channel| channel / 2 + 120);
}

/// How often each cost finds the true place, by texture: a diagram each.
#[must_use]
pub fn found(survey: &Survey) -> Vec<(&'static str, String)> {
    let diagram = |cost: Cost| {
        let mut marks: Vec<Mark> = survey
            .bins
            .iter()
            .map(|bin| mark(texture_words(bin), bin, cost))
            .collect();
        if let Some(all) = &survey.all {
            marks.push(mark("all textures".to_owned(), all, cost));
        }
        let chance = survey.all.as_ref().map_or(0.0, |all| 100.0 * all.chance);
        Whiskers {
            title: format!("{}: the cheapest place is true", cost.heading()),
            x: format!("pixels within {NEAR_PX} px of the truth (%; by chance {chance:.1})"),
            marks,
        }
        .svg()
    };
    let costs = survey.costs.iter();
    costs.map(|&cost| (cost.name(), diagram(cost))).collect()
}

fn mark(label: String, bin: &Bin, cost: Cost) -> Mark {
    let Ratio {
        value, interval, ..
    } = &bin.found[cost as usize];
    Mark {
        label,
        value: 100.0 * value,
        interval: interval.map(|bounds| (100.0 * bounds.low, 100.0 * bounds.high)),
        published: false,
    }
}

/// The bounds of a bin, as in `gradient 2 to 4 (1,234 px)`.
fn texture_words(bin: &Bin) -> String {
    let (from, to) = bin.texture;
    match to {
        Some(to) => format!("gradient {from} to {to} ({} px)", bin.pixels),
        None => format!("gradient {from} and more ({} px)", bin.pixels),
    }
}

/// The survey in sentences.
#[must_use]
pub fn words(survey: &Survey) -> String {
    let mut text = format!(
        "{} images searched, {} of them in native size\n",
        survey.images, survey.native
    );
    if survey.costs.contains(&Cost::Discriminator) {
        text += &format!(
            "up to {} pixels of each, in the size that the discriminator was trained on\n",
            survey.per_image
        );
    }
    let all = survey
        .all
        .iter()
        .map(|bin| ("all textures".to_owned(), bin));
    let bins = survey
        .bins
        .iter()
        .map(|bin| (texture_words(bin), bin))
        .chain(all);
    for (label, bin) in bins {
        text += &format!("{label}:");
        for (cost, ratio) in survey.costs.iter().zip(&bin.found) {
            text += &format!(" {} {:.1} %", cost.heading(), 100.0 * ratio.value);
            if let Some(interval) = ratio.interval {
                text += &format!(
                    " ({:.1} to {:.1})",
                    100.0 * interval.low,
                    100.0 * interval.high
                );
            }
        }
        text += &format!("; by chance {:.1} %\n", 100.0 * bin.chance);
    }
    text
}
