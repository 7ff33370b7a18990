//! Small charts and sheets of pictures as SVG, and SVG as PNG.
//!
//! The SVG is our own and plain: lines, bands and text that stays text. PNG is made of that very
//! text by resvg with the typeface DejaVu Sans, which is linked in, so that no font of the system
//! is needed and every machine gives the same picture. Colours are Okabe and Ito's, which differ
//! for colour-blind readers too; every line also has a dash pattern of its own.

use std::fmt::Write as _;

/// Why a picture cannot be made.
#[derive(Debug, thiserror::Error)]
#[error("the figure cannot be drawn: {0}")]
pub struct PlotError(String);

/// Line colours with their dash patterns.
const STYLES: [(&str, &str); 5] = [
    ("#0072b2", ""),
    ("#d55e00", "7 3"),
    ("#009e73", "2 3"),
    ("#cc79a7", "9 3 2 3"),
    ("#56b4e9", "4 2"),
];
/// Lines that are not measured: ideals and fits.
const GUIDES: [(&str, &str); 3] = [
    ("#444444", "5 4"),
    ("#444444", "1 3"),
    ("#444444", "10 3 1 3"),
];
const FONT: &str = "DejaVu Sans, Verdana, Arial, sans-serif";

/// A curve.
#[derive(Clone, Debug, Default)]
pub struct Curve {
    /// Its name in the key.
    pub label: String,
    /// Its points, by x.
    pub points: Vec<(f64, f64)>,
    /// Lower and upper end of the band at each point; empty for none.
    pub band: Vec<(f64, f64)>,
    /// Something to compare with rather than a measurement.
    pub guide: bool,
}

/// One diagram.
#[derive(Clone, Debug, Default)]
pub struct Panel {
    /// Above it.
    pub title: String,
    /// Label of the horizontal axis, with its unit.
    pub x: String,
    /// Label of the vertical axis, with its unit.
    pub y: String,
    /// What is drawn.
    pub curves: Vec<Curve>,
    /// The vertical axis ends here when the curves go beyond.
    pub highest: Option<f64>,
}

/// Diagrams side by side.
#[derive(Clone, Debug, Default)]
pub struct Chart {
    /// Above all.
    pub title: String,
    /// A sentence below the title.
    pub note: String,
    /// The diagrams.
    pub panels: Vec<Panel>,
}

/// A figure in a [`Whiskers`] diagram.
#[derive(Clone, Debug, Default)]
pub struct Mark {
    /// What it is about.
    pub label: String,
    /// The figure.
    pub value: f64,
    /// Its interval.
    pub interval: Option<(f64, f64)>,
    /// Somebody else's figure: drawn hollow.
    pub published: bool,
}

/// Figures with their intervals, one below the other.
#[derive(Clone, Debug, Default)]
pub struct Whiskers {
    /// Above it.
    pub title: String,
    /// Label of the axis, with its unit.
    pub x: String,
    /// The figures, top to bottom.
    pub marks: Vec<Mark>,
}

/// A picture within a sheet.
#[derive(Clone, Debug)]
pub struct Tile {
    /// Below it.
    pub caption: String,
    /// An encoded picture.
    pub data: Vec<u8>,
    /// What it is encoded as: `png` or `jpeg`.
    pub format: &'static str,
    /// Its size in pixels.
    pub size: (u32, u32),
}

/// Pictures in rows.
#[derive(Clone, Debug, Default)]
pub struct Sheet {
    /// Above all.
    pub title: String,
    /// A sentence below the title.
    pub note: String,
    /// The pictures.
    pub rows: Vec<Vec<Tile>>,
}

fn escape(text: &str) -> String {
    text.chars().fold(String::new(), |mut out, c| {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            c => out.push(c),
        }
        out
    })
}

/// A document with a title and a note at the top.
fn document(width: f64, height: f64, title: &str, note: &str, body: &str) -> String {
    let (title, note) = (escape(title), escape(note));
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width:.0}\" height=\"{height:.0}\" \
         viewBox=\"0 0 {width:.0} {height:.0}\" font-family=\"{FONT}\" role=\"img\">\n\
         <title>{title}</title>\n<desc>{note}</desc>\n\
         <rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>\n\
         <text x=\"16\" y=\"24\" font-size=\"15\" font-weight=\"bold\" fill=\"#111111\">{title}</text>\n\
         <text x=\"16\" y=\"42\" font-size=\"11\" fill=\"#444444\">{note}</text>\n{body}</svg>\n"
    )
}

/// Ticks at 1, 2 or 5 times a power of ten, about `count` of them.
fn ticks(low: f64, high: f64, count: f64) -> Vec<f64> {
    let rough = (high - low) / count;
    let power = 10_f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0]
        .into_iter()
        .map(|factor| factor * power)
        .find(|step| *step >= rough * 0.999)
        .unwrap_or(rough);
    let first = (low / step - 1e-9).ceil() as i64;
    let last = (high / step + 1e-9).floor() as i64;
    (first..=last).map(|index| index as f64 * step).collect()
}

fn number(value: f64, step: f64) -> String {
    let decimals = if step >= 1.0 {
        0
    } else {
        (-step.log10()).ceil().clamp(0.0, 6.0) as usize
    };
    let text = format!("{value:.decimals$}");
    if text.trim_start_matches(['-', '0', '.']).is_empty() {
        "0".to_owned()
    } else {
        text
    }
}

const PANEL_WIDTH: f64 = 440.0;
const PLOT_LEFT: f64 = 62.0;
const PLOT_TOP: f64 = 80.0;
const PLOT_WIDTH: f64 = 358.0;
const PLOT_HEIGHT: f64 = 250.0;
const KEY_LINE: f64 = 17.0;

impl Chart {
    /// The chart as SVG.
    #[must_use]
    pub fn svg(&self) -> String {
        let keys = self
            .panels
            .iter()
            .map(|panel| panel.curves.len())
            .max()
            .unwrap_or(0);
        let width = 16.0 + PANEL_WIDTH * self.panels.len().max(1) as f64;
        let height = PLOT_TOP + PLOT_HEIGHT + 52.0 + KEY_LINE * keys as f64;
        let mut body = String::new();
        for (index, panel) in self.panels.iter().enumerate() {
            panel.draw(16.0 + PANEL_WIDTH * index as f64, index, &mut body);
        }
        document(width, height, &self.title, &self.note, &body)
    }
}

impl Panel {
    fn draw(&self, left: f64, index: usize, out: &mut String) {
        let finite = |value: &f64| value.is_finite();
        let points = || self.curves.iter().flat_map(|curve| &curve.points);
        let (mut x_low, mut x_high) = (f64::INFINITY, f64::NEG_INFINITY);
        for &(x, _) in points().filter(|(x, y)| finite(x) && finite(y)) {
            (x_low, x_high) = (x_low.min(x), x_high.max(x));
        }
        let top = self
            .curves
            .iter()
            .flat_map(|curve| {
                let heights = curve.points.iter().map(|point| point.1);
                heights.chain(curve.band.iter().map(|ends| ends.1))
            })
            .filter(finite)
            .fold(0.0, f64::max);
        if x_low >= x_high {
            (x_low, x_high) = (0.0, 1.0);
        }
        let mut y_high = self.highest.map_or(top, |highest| top.min(highest));
        if y_high <= 0.0 {
            y_high = 1.0;
        }
        // Up to the next tick, so that nothing touches the frame but what is cut there.
        let room = if y_high < top { 1.0 } else { 1.02 };
        let step = ticks(0.0, y_high, 5.0).get(1).copied().unwrap_or(y_high);
        y_high = step * (y_high * room / step - 1e-9).ceil();
        let (x0, y0) = (left + PLOT_LEFT, PLOT_TOP);
        let px = |x: f64| x0 + PLOT_WIDTH * (x - x_low) / (x_high - x_low);
        let py = |y: f64| y0 + PLOT_HEIGHT * (1.0 - y / y_high);
        let _ = writeln!(
            out,
            "<text x=\"{x0:.1}\" y=\"{:.1}\" font-size=\"12\" font-weight=\"bold\" fill=\"#222222\">{}</text>",
            y0 - 10.0,
            escape(&self.title)
        );
        let mut text = |x: f64, y: f64, anchor: &str, words: &str, more: &str| {
            let _ = writeln!(
                out,
                "<text x=\"{x:.1}\" y=\"{y:.1}\" font-size=\"11\" text-anchor=\"{anchor}\" \
                 fill=\"#222222\"{more}>{}</text>",
                escape(words)
            );
        };
        let x_ticks = ticks(x_low, x_high, 6.0);
        let y_ticks = ticks(0.0, y_high, 5.0);
        let gap = |ticks: &[f64]| {
            ticks
                .windows(2)
                .next()
                .map_or(1.0, |pair| pair[1] - pair[0])
        };
        for &tick in &x_ticks {
            let label = number(tick, gap(&x_ticks));
            text(px(tick), y0 + PLOT_HEIGHT + 16.0, "middle", &label, "");
        }
        for &tick in &y_ticks {
            let label = number(tick, gap(&y_ticks));
            text(x0 - 7.0, py(tick) + 4.0, "end", &label, "");
        }
        let middle = y0 + 0.5 * PLOT_HEIGHT;
        let turn = format!(" transform=\"rotate(-90 {:.1} {middle:.1})\"", left + 14.0);
        text(left + 14.0, middle, "middle", &self.y, &turn);
        text(
            x0 + 0.5 * PLOT_WIDTH,
            y0 + PLOT_HEIGHT + 36.0,
            "middle",
            &self.x,
            "",
        );
        for &tick in &y_ticks {
            let y = py(tick);
            let _ = writeln!(
                out,
                "<path d=\"M{x0:.1} {y:.1}h{PLOT_WIDTH}\" stroke=\"#dddddd\" fill=\"none\"/>"
            );
        }
        for &tick in &x_ticks {
            let (x, y) = (px(tick), y0 + PLOT_HEIGHT);
            let _ = writeln!(
                out,
                "<path d=\"M{x:.1} {y:.1}v4\" stroke=\"#222222\" fill=\"none\"/>"
            );
        }
        let _ = writeln!(
            out,
            "<clipPath id=\"plot{index}\"><rect x=\"{x0:.1}\" y=\"{y0:.1}\" width=\"{PLOT_WIDTH}\" \
             height=\"{PLOT_HEIGHT}\"/></clipPath>\n<g clip-path=\"url(#plot{index})\" fill=\"none\">"
        );
        let mut key = String::new();
        let (mut measured, mut guides) = (0, 0);
        for (place, curve) in self.curves.iter().enumerate() {
            let (colour, dashes) = if curve.guide {
                guides += 1;
                GUIDES[(guides - 1) % GUIDES.len()]
            } else {
                measured += 1;
                STYLES[(measured - 1) % STYLES.len()]
            };
            if curve.band.len() == curve.points.len() && curve.points.len() > 1 {
                let xs = || curve.points.iter().map(|point| point.0);
                let mut outline: Vec<(f64, f64)> =
                    xs().zip(curve.band.iter().map(|ends| ends.1)).collect();
                let low: Vec<(f64, f64)> = xs().zip(curve.band.iter().map(|ends| ends.0)).collect();
                outline.extend(low.into_iter().rev());
                let _ = writeln!(
                    out,
                    "<path d=\"{}Z\" fill=\"{colour}\" fill-opacity=\"0.16\"/>",
                    path(&outline, px, py)
                );
            }
            let dash = format!("stroke=\"{colour}\" stroke-dasharray=\"{dashes}\"");
            let dash = dash.replace(" stroke-dasharray=\"\"", "");
            let width = if curve.guide { 1.2 } else { 1.9 };
            let _ = writeln!(
                out,
                "<path d=\"{}\" {dash} stroke-width=\"{width}\"/>",
                path(&curve.points, px, py)
            );
            let y = y0 + PLOT_HEIGHT + 54.0 + KEY_LINE * place as f64;
            let _ = writeln!(
                key,
                "<path d=\"M{x0:.1} {:.1}h28\" {dash} stroke-width=\"{width}\" fill=\"none\"/>\
                 <text x=\"{:.1}\" y=\"{y:.1}\" font-size=\"11\" fill=\"#222222\">{}</text>",
                y - 4.0,
                x0 + 36.0,
                escape(&curve.label)
            );
        }
        let _ = writeln!(
            out,
            "</g>\n<rect x=\"{x0:.1}\" y=\"{y0:.1}\" width=\"{PLOT_WIDTH}\" height=\"{PLOT_HEIGHT}\" \
             fill=\"none\" stroke=\"#222222\"/>\n{key}"
        );
    }
}

impl Whiskers {
    /// The diagram as SVG. Its axis spans the figures and need not begin at 0.
    #[must_use]
    pub fn svg(&self) -> String {
        const LABELS: f64 = 236.0;
        const PLOT: f64 = 300.0;
        const LINE: f64 = 22.0;
        const TOP: f64 = 62.0;
        let ends = self
            .marks
            .iter()
            .flat_map(|mark| {
                let (low, high) = mark.interval.unwrap_or((mark.value, mark.value));
                [low, mark.value, high]
            })
            .filter(|value| value.is_finite());
        let (mut low, mut high) = ends
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
                (low.min(v), high.max(v))
            });
        if low >= high {
            (low, high) = if low.is_finite() {
                (low - 0.5, low + 0.5)
            } else {
                (0.0, 1.0)
            };
        }
        let margin = 0.04 * (high - low);
        (low, high) = (low - margin, high + margin);
        let px = |x: f64| LABELS + PLOT * (x - low) / (high - low);
        let bottom = TOP + LINE * self.marks.len() as f64;
        let mut body = String::new();
        let at = ticks(low, high, 5.0);
        let gap = at.windows(2).next().map_or(1.0, |pair| pair[1] - pair[0]);
        for &tick in &at {
            let (x, label) = (px(tick), number(tick, gap));
            let _ = writeln!(
                body,
                "<path d=\"M{x:.1} {TOP:.1}V{bottom:.1}\" stroke=\"#dddddd\" fill=\"none\"/>\
                 <text x=\"{x:.1}\" y=\"{:.1}\" font-size=\"11\" text-anchor=\"middle\" \
                 fill=\"#222222\">{label}</text>",
                bottom + 16.0
            );
        }
        for (place, mark) in self.marks.iter().enumerate() {
            let y = TOP + LINE * (place as f64 + 0.5);
            let _ = writeln!(
                body,
                "<text x=\"{:.1}\" y=\"{:.1}\" font-size=\"11\" text-anchor=\"end\" \
                 fill=\"#222222\">{}</text>",
                LABELS - 10.0,
                y + 4.0,
                escape(&shortened(&mark.label, 36))
            );
            if !mark.value.is_finite() {
                continue;
            }
            let (colour, x) = (STYLES[0].0, px(mark.value));
            if let Some((low, high)) = mark.interval {
                let _ = writeln!(
                    body,
                    "<path d=\"M{:.1} {y:.1}H{:.1}M{0:.1} {:.1}v8M{1:.1} {2:.1}v8\" \
                     stroke=\"{colour}\" stroke-width=\"1.6\" fill=\"none\"/>",
                    px(low),
                    px(high),
                    y - 4.0
                );
            }
            let _ = if mark.published {
                writeln!(
                    body,
                    "<path d=\"M{:.1} {y:.1}l5 -5l5 5l-5 5z\" fill=\"#ffffff\" stroke=\"#444444\" \
                     stroke-width=\"1.4\"/>",
                    x - 5.0
                )
            } else {
                writeln!(
                    body,
                    "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"4.5\" fill=\"{colour}\"/>"
                )
            };
        }
        let _ = writeln!(
            body,
            "<text x=\"{:.1}\" y=\"{:.1}\" font-size=\"11\" text-anchor=\"middle\" \
             fill=\"#222222\">{}</text>",
            LABELS + 0.5 * PLOT,
            bottom + 36.0,
            escape(&self.x)
        );
        let note = "filled: measured, with its 95 % interval; hollow: published";
        document(
            LABELS + PLOT + 24.0,
            bottom + 48.0,
            &self.title,
            note,
            &body,
        )
    }
}

fn shortened(text: &str, longest: usize) -> String {
    if text.chars().count() <= longest {
        return text.to_owned();
    }
    let kept: String = text.chars().take(longest - 1).collect();
    kept.trim_end().to_owned() + "…"
}

/// One of this module's SVG texts for a page that has several of them and themes of its own: each
/// colour becomes the CSS variable that [`VARIABLES`] names for it, and ids begin with `id`.
#[must_use]
pub fn themed(svg: &str, id: &str) -> String {
    let mut text = svg
        .replace("\"plot", &format!("\"{id}-plot"))
        .replace("(#plot", &format!("(#{id}-plot"));
    // Quotes within words are escaped, so only attributes can match.
    for (colour, variable) in VARIABLES {
        text = text.replace(&format!("\"{colour}\""), &format!("\"var({variable})\""));
    }
    text
}

/// Every colour of this module and the CSS variable that stands for it in themed pages.
pub const VARIABLES: [(&str, &str); 10] = [
    ("#ffffff", "--paper"),
    ("#111111", "--ink"),
    ("#222222", "--ink"),
    ("#444444", "--muted"),
    ("#dddddd", "--rule"),
    ("#0072b2", "--curve-1"),
    ("#d55e00", "--curve-2"),
    ("#009e73", "--curve-3"),
    ("#cc79a7", "--curve-4"),
    ("#56b4e9", "--curve-5"),
];

fn path(points: &[(f64, f64)], px: impl Fn(f64) -> f64, py: impl Fn(f64) -> f64) -> String {
    let mut text = String::new();
    for &(x, y) in points
        .iter()
        .filter(|(x, y)| x.is_finite() && y.is_finite())
    {
        let letter = if text.is_empty() { 'M' } else { 'L' };
        // Far outside the frame a number is only long.
        let _ = write!(
            text,
            "{letter}{:.1} {:.1}",
            px(x),
            py(y).clamp(-9999.0, 9999.0)
        );
    }
    text
}

impl Sheet {
    /// The sheet as SVG, its pictures within.
    #[must_use]
    pub fn svg(&self) -> String {
        const GAP: f64 = 10.0;
        let mut body = String::new();
        let (mut y, mut widest) = (58.0, 520.0_f64);
        for row in &self.rows {
            let (mut x, mut tallest) = (16.0, 0.0_f64);
            for tile in row {
                let (width, height) = (f64::from(tile.size.0), f64::from(tile.size.1));
                let _ = writeln!(
                    body,
                    "<image x=\"{x:.0}\" y=\"{y:.0}\" width=\"{width:.0}\" height=\"{height:.0}\" \
                     href=\"data:image/{};base64,{}\"/>\n<text x=\"{x:.0}\" y=\"{:.0}\" \
                     font-size=\"11\" fill=\"#222222\">{}</text>",
                    tile.format,
                    base64(&tile.data),
                    y + height + 14.0,
                    escape(&tile.caption)
                );
                x += width + GAP;
                tallest = tallest.max(height);
            }
            widest = widest.max(x - GAP + 16.0);
            y += tallest + 28.0;
        }
        document(widest, y, &self.title, &self.note, &body)
    }
}

/// Bytes in the letters of RFC 4648, as `data:` addresses have them.
pub(crate) fn base64(bytes: &[u8]) -> String {
    const LETTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for group in bytes.chunks(3) {
        let bits = group.iter().enumerate().fold(0_u32, |bits, (i, &byte)| {
            bits | u32::from(byte) << (16 - 8 * i)
        });
        for place in 0..4 {
            text.push(if place <= group.len() {
                char::from(LETTERS[(bits >> (18 - 6 * place)) as usize & 63])
            } else {
                '='
            });
        }
    }
    text
}

/// Draws an SVG text as PNG, `zoom` times its size.
///
/// # Errors
/// The text is no SVG or its picture would be too large.
pub fn png(svg: &str, zoom: f32) -> Result<Vec<u8>, PlotError> {
    use resvg::{tiny_skia, usvg};
    let mut options = usvg::Options {
        font_family: "DejaVu Sans".to_owned(),
        ..usvg::Options::default()
    };
    let fonts = options.fontdb_mut();
    fonts.load_font_data(dejavu::sans::regular().to_vec());
    fonts.load_font_data(dejavu::sans::bold().to_vec());
    let tree = usvg::Tree::from_str(svg, &options).map_err(|error| PlotError(error.to_string()))?;
    let size = tree.size();
    let side = |length: f32| (length * zoom).ceil() as u32;
    let mut pixmap = tiny_skia::Pixmap::new(side(size.width()), side(size.height()))
        .ok_or_else(|| PlotError("its size is 0 or too large".to_owned()))?;
    let zoom = tiny_skia::Transform::from_scale(zoom, zoom);
    resvg::render(&tree, zoom, &mut pixmap.as_mut());
    pixmap
        .encode_png()
        .map_err(|error| PlotError(error.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round() {
        assert_eq!(ticks(0.0, 80.0, 5.0), [0.0, 20.0, 40.0, 60.0, 80.0]);
        assert_eq!(ticks(74.4, 90.0, 6.0), [75.0, 80.0, 85.0, 90.0]);
        assert_eq!(number(0.30000000000000004, 0.1), "0.3");
        assert_eq!(number(-0.0, 0.5), "0");
    }

    #[test]
    fn base64_is_that_of_the_standard() {
        for (bytes, text) in [
            ("", ""),
            ("f", "Zg=="),
            ("fo", "Zm8="),
            ("foo", "Zm9v"),
            ("foob", "Zm9vYg=="),
        ] {
            assert_eq!(base64(bytes.as_bytes()), text);
        }
    }

    #[test]
    fn whiskers_span_their_intervals() {
        let mark = |label: &str, value, interval, published| Mark {
            label: label.to_owned(),
            value,
            interval,
            published,
        };
        let diagram = Whiskers {
            title: "Abs Rel".to_owned(),
            x: "lower is better".to_owned(),
            marks: vec![
                mark("ours & <others>", 0.2, Some((0.1, 0.3)), false),
                mark("published", 0.15, None, true),
                mark("none", f64::NAN, None, false),
                mark(&"long ".repeat(20), 0.25, None, false),
            ],
        };
        let svg = diagram.svg();
        assert!(svg.contains("ours &amp; &lt;others&gt;") && !svg.contains("NaN"));
        // 0.1 to 0.3 with 4 % on both sides: 300 / 1.08 wide.
        assert!(svg.contains("M247.1 73.0H524.9"), "{svg}");
        assert_eq!(
            (svg.matches("<circle").count(), svg.matches('…').count()),
            (2, 1)
        );
        assert!(png(&svg, 1.0).is_ok() && png(&Whiskers::default().svg(), 1.0).is_ok());
    }

    #[test]
    fn themed_text_has_no_colour_of_its_own() {
        let panel = Panel {
            curves: vec![Curve::default(); 7],
            ..Panel::default()
        };
        let chart = Chart {
            title: "\"#111111\"".to_owned(),
            panels: vec![panel],
            ..Chart::default()
        };
        let text = themed(&chart.svg(), "a");
        assert!(text.contains("&quot;#111111&quot;"));
        assert!(!text.contains("=\"#"), "{text}");
        assert!(text.contains("id=\"a-plot0\"") && text.contains("url(#a-plot0)"));
    }

    #[test]
    fn charts_keep_their_text_and_become_pictures() {
        let chart = Chart {
            title: "Depth & size <1>".to_owned(),
            note: "note".to_owned(),
            panels: vec![Panel {
                title: "a".to_owned(),
                x: "k".to_owned(),
                y: "depth (m)".to_owned(),
                curves: vec![
                    Curve {
                        label: "car".to_owned(),
                        points: vec![(1.0, 2.0), (2.0, f64::NAN), (3.0, 9.0)],
                        band: vec![(1.0, 3.0), (2.0, 3.0), (8.0, 10.0)],
                        guide: false,
                    },
                    Curve::default(),
                ],
                highest: None,
            }],
        };
        let svg = chart.svg();
        assert!(svg.contains("Depth &amp; size &lt;1&gt;") && svg.contains(">depth (m)</text>"));
        assert!(!svg.contains("NaN"));
        let decoded = image::load_from_memory(&png(&svg, 2.0).unwrap())
            .unwrap()
            .to_rgb8();
        assert_eq!(decoded.width(), 2 * 456);
        // The title is there although the system may have no fonts.
        let dark = decoded
            .enumerate_pixels()
            .filter(|(_, y, p)| *y < 60 && p.0[0] < 90)
            .count();
        assert!(dark > 300, "{dark}");
        assert!(png("nothing", 1.0).is_err());
    }
}
