//! A map in colour with its scale below: a strip of colours, ticks and labels; of sheets the scale alone, as
//! part of their SVG.

use image::{Rgb, RgbImage};
use maud::{Markup, html};
use strat_store::raster::Plane;

use super::{
    colour::magma,
    png,
    svg::{Px, text},
};

/// The scale of a coloured map: black at 0, brightest at this value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scale {
    /// How the ticks are labelled; plain numbers when [`None`].
    pub unit: Option<ScaleUnit>,
    /// The value of the brightest colour.
    pub brightest: f32,
}

/// How the ticks of a scale are labelled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ScaleUnit {
    /// Values are 1/m; labels are metres.
    Metres,
    /// Values and labels are pixels.
    Pixels,
    /// Values and labels are plain numbers; the last one is "and more".
    AndMore,
}

/// The scale of a sheet's colours.
#[derive(Clone, Debug)]
pub struct Key {
    /// What it is of.
    pub words: String,
    /// Its values.
    pub scale: Scale,
    /// The colour of a share of the brightest value.
    pub colour: fn(f32) -> Rgb<u8>,
}

impl Key {
    /// Rows that it takes.
    pub const HEIGHT: u32 = 40;
    /// Rows of its strip of colours, the first of them.
    pub const STRIP: u32 = 8;

    /// The scale from `(left, top)` on, as many units wide.
    pub(super) fn svg(&self, left: u32, top: u32, width: u32) -> Markup {
        let bars = width.clamp(1, 100);
        let size = 10.0;
        let below = f64::from(top + Self::STRIP);
        html! {
            g shape-rendering="crispEdges" {
                @for bar in 0..bars {
                    @let (from, to) = (bar * width / bars, (bar + 1) * width / bars);
                    @let Rgb([r, g, b]) = (self.colour)(bar as f32 / (bars - 1).max(1) as f32);
                    rect x=(left + from) y=(top) width=(to - from) height=(Self::STRIP)
                        fill=(format!("#{r:02x}{g:02x}{b:02x}")) {}
                }
            }
            @for label in labels(self.scale, width as f32, size) {
                @let tick = f64::from(left) + f64::from(label.tick) + 0.5;
                path d=(format!("M{tick} {below}v3")) stroke="#222222" fill="none" {}
                text x=(Px(f64::from(left) + f64::from(label.left))) y=(Px(below + 13.0)) font-size=(size)
                    fill="#222222" { (label.text) }
            }
            (text(f64::from(left), below + 26.0, "start", &self.words))
        }
    }
}

/// Rows of the strip of colours, of the ticks below it, and of everything, before magnification.
const STRIP: u32 = 6;
const TICK: u32 = 2;
const ROWS: u32 = 18;
/// Size of the letters, and their mean width as a share of it.
const LETTERS: u32 = 10;
const LETTER_WIDTH: f32 = 0.66;

/// Colours inverse depth or disparity (magma: dark is far, bright is near) and draws the scale below,
/// so that the picture is [`legend_height`] taller than the map.
#[must_use]
pub fn coloured(map: &Plane, scale: Scale) -> RgbImage {
    let (width, height) = (map.width as u32, map.height as u32);
    let mut picture = RgbImage::new(width, height + legend_height(width));
    for (index, &value) in map.data.iter().enumerate() {
        let (column, row) = (index % map.width, index / map.width);
        picture.put_pixel(column as u32, row as u32, magma(value / scale.brightest));
    }
    draw_legend(&mut picture, (0, height), width, scale, magma);
    picture
}

/// The same without the scale below: a picture of the map's own size.
#[must_use]
pub fn uncaptioned(map: &Plane, scale: Scale) -> RgbImage {
    let (width, height) = (map.width as u32, map.height as u32);
    let colours = map
        .data
        .iter()
        .flat_map(|value| magma(value / scale.brightest).0);
    RgbImage::from_raw(width, height, colours.collect()).unwrap_or_default()
}

/// Rows below the map.
#[must_use]
pub fn legend_height(width: u32) -> u32 {
    ROWS * magnification(width)
}

fn magnification(width: u32) -> u32 {
    if width < 600 { 1 } else { 2 }
}

/// Positions (0 to 1) and texts of the labels, from the dark end to the bright one.
fn ticks(scale: Scale) -> Vec<(f32, String)> {
    let brightest = scale.brightest;
    match scale.unit {
        None => vec![(0.0, "0".to_owned()), (1.0, short(brightest))],
        Some(ScaleUnit::AndMore) => (0..=4_u8)
            .map(|quarter| {
                let share = f32::from(quarter) / 4.0;
                let more = if quarter == 4 { "+" } else { "" };
                (share, format!("{}{more}", short(share * brightest)))
            })
            .collect(),
        Some(ScaleUnit::Pixels) => (0..=4_u8)
            .map(|quarter| {
                let share = f32::from(quarter) / 4.0;
                (share, format!("{} px", short(share * brightest)))
            })
            .collect(),
        Some(ScaleUnit::Metres) => {
            // 1, 2, 5, 10, ... metres, as far as they lie on the scale; far ones come first.
            let steps = (-3..=4_i32)
                .rev()
                .flat_map(|exponent| [5.0_f32, 2.0, 1.0].map(|step| step * 10_f32.powi(exponent)));
            steps
                .map(|metres| (1.0 / (metres * brightest), metres))
                .filter(|(share, _)| (0.0..=1.0).contains(share))
                .chain([(1.0, 1.0 / brightest)])
                .map(|(share, metres)| (share, format!("{} m", short(metres))))
                .collect()
        }
    }
}

/// At most three significant digits.
fn short(value: f32) -> String {
    let text = if value >= 100.0 || value == 0.0 {
        format!("{value:.0}")
    } else if value >= 10.0 {
        format!("{value:.1}")
    } else if value >= 0.01 {
        format!("{value:.2}")
    } else {
        format!("{value:.1e}")
    };
    if text.contains('.') && !text.contains('e') {
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        text
    }
}

/// A label and the pixel columns where its tick and its text begin.
struct Label {
    tick: f32,
    left: f32,
    text: String,
}

/// The labels that have room. The bounds matter most, so they come first; what would touch another
/// label is left out.
fn labels(scale: Scale, width: f32, size: f32) -> Vec<Label> {
    let mut wanted = ticks(scale);
    let is_inner = |share: f32| share > 0.0 && share < 1.0;
    wanted.sort_by(|a, b| is_inner(a.0).cmp(&is_inner(b.0)).then(b.0.total_cmp(&a.0)));
    let gap = size;
    let mut taken: Vec<(f32, f32)> = Vec::new();
    let mut placed = Vec::new();
    for (share, text) in wanted {
        let length = text.chars().count() as f32 * LETTER_WIDTH * size;
        let tick = (share * (width - 1.0)).round();
        let left = (tick - 0.5 * length).clamp(0.0, (width - length).max(0.0));
        let touches = |&(from, to): &(f32, f32)| left < to + gap && from < left + length + gap;
        if length <= width && !taken.iter().any(touches) {
            taken.push((left, left + length));
            placed.push(Label { tick, left, text });
        }
    }
    placed
}

/// Draws a scale of so many columns into a picture, with its upper left corner at `(left, top)`; it takes
/// [`legend_height`] rows.
pub(super) fn draw_legend(
    picture: &mut RgbImage,
    (left, top): (u32, u32),
    width: u32,
    scale: Scale,
    colour: impl Fn(f32) -> Rgb<u8>,
) {
    let zoom = magnification(width);
    for column in 0..width {
        let colour = colour(column as f32 / width.saturating_sub(1).max(1) as f32);
        for row in top..top + STRIP * zoom {
            picture.put_pixel(left + column, row, colour);
        }
    }
    let (size, rows) = (LETTERS * zoom, (ROWS - STRIP) * zoom);
    let svg = html! {
        svg xmlns="http://www.w3.org/2000/svg" width=(width) height=(rows) fill="#e6e6e6" {
            @for label in labels(scale, width as f32, size as f32) {
                rect x=(label.tick) width=(zoom) height=(TICK * zoom) {}
                text x=(Px(label.left.into())) y=(rows - zoom) font-size=(size) { (label.text) }
            }
        }
    };
    put(picture, (left, top + STRIP * zoom), &svg.into_string());
}

/// Rows of [`draw_words`].
pub(super) fn words_height(width: u32) -> u32 {
    (LETTERS + 6) * magnification(width)
}

/// Writes a line of words into a picture, light on black, at most so many columns wide.
pub(super) fn draw_words(picture: &mut RgbImage, corner: (u32, u32), width: u32, words: &str) {
    let (zoom, rows) = (magnification(width), words_height(width));
    let size = LETTERS * zoom;
    let svg = html! {
        svg xmlns="http://www.w3.org/2000/svg" width=(width) height=(rows) fill="#e6e6e6" {
            text x=(2 * zoom) y=(rows - 4 * zoom) font-size=(size) { (words) }
        }
    };
    put(picture, corner, &svg.into_string());
}

/// Puts what is drawn, over black, into a picture.
fn put(picture: &mut RgbImage, (left, top): (u32, u32), svg: &str) {
    // Our own SVG of a size above 0 can always be drawn; without it the picture stands alone.
    let Ok(drawn) = png::pixels(svg, 1.0) else {
        return;
    };
    let width = drawn.width();
    for (index, pixel) in drawn.pixels().iter().enumerate() {
        // Premultiplied over black.
        let (column, row) = (index as u32 % width, index as u32 / width);
        let colour = Rgb([pixel.red(), pixel.green(), pixel.blue()]);
        picture.put_pixel(left + column, top + row, colour);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PIXELS: Scale = Scale {
        unit: Some(ScaleUnit::Pixels),
        brightest: 299.0,
    };

    #[test]
    fn the_legend_has_the_colours_of_the_picture() {
        let map = Plane::new(300, 1, (0..300_u16).map(f32::from).collect()).unwrap();
        let picture = coloured(&map, PIXELS);
        assert_eq!(picture.dimensions(), (300, 1 + legend_height(300)));
        for column in 0..300 {
            assert_eq!(picture.get_pixel(column, 0), picture.get_pixel(column, 3));
        }
        // Beyond the scale nothing is brighter.
        assert_eq!(
            coloured(&Plane::filled(1, 1, 1e9), PIXELS).get_pixel(0, 0),
            picture.get_pixel(299, 0)
        );
    }

    /// At each label's position there are a tick and letters, and nowhere else.
    #[test]
    fn labels_stand_below_their_ticks() {
        let picture = coloured(&Plane::filled(300, 1, 0.0), PIXELS);
        let lit = |column: u32, rows: std::ops::Range<u32>| {
            rows.filter(|&row| picture.get_pixel(column, 1 + row).0[0] > 150)
                .count()
        };
        let found = labels(PIXELS, 300.0, 10.0);
        let texts: Vec<&str> = found.iter().map(|label| label.text.as_str()).collect();
        assert_eq!(texts, ["299 px", "0 px", "224 px", "150 px", "74.8 px"]);
        for label in &found {
            assert_eq!(
                lit(label.tick as u32, STRIP..STRIP + TICK),
                2,
                "{}",
                label.text
            );
            let (from, letters) = (label.left as u32, label.text.chars().count() as u32);
            let bright: usize = (from..(from + 6 * letters).min(300))
                .map(|column| lit(column, STRIP + TICK..ROWS))
                .sum();
            assert!(bright > 20, "{}: {bright}", label.text);
        }
        let between: usize = (40..50).map(|column| lit(column, STRIP..ROWS)).sum();
        assert_eq!(between, 0);
    }

    #[test]
    fn ticks_are_round_metres() {
        // Brightest at 1/4 m.
        let scale = Scale {
            unit: Some(ScaleUnit::Metres),
            brightest: 0.25,
        };
        let ticks = ticks(scale);
        let share = |text: &str| ticks.iter().find(|(_, t)| t == text).map(|(p, _)| *p);
        assert_eq!(share("4 m"), Some(1.0));
        assert_eq!(share("5 m"), Some(0.8));
        assert_eq!(share("20 m"), Some(0.2));
        assert_eq!(share("2 m"), None);
        for (value, text) in [
            (0.0, "0"),
            (123.4, "123"),
            (12.34, "12.3"),
            (2.0, "2"),
            (0.5, "0.5"),
        ] {
            assert_eq!(short(value), text);
        }
    }
}
