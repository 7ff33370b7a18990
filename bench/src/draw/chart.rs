//! Curves with bands over an axis, in panels side by side.

use std::fmt::Write as _;

use maud::{Markup, html};

use super::svg::{GUIDES, Px, STYLES, document, labelled, line, text, ticks};

/// A curve.
#[derive(Clone, Debug, Default)]
pub struct Curve {
    /// Its name in the key.
    pub label: String,
    /// Its points, by x.
    pub points: Vec<(f64, f64)>,
    /// Lower and upper bound of the band at each point; empty for none.
    pub band: Vec<(f64, f64)>,
    /// Something to compare with rather than a measurement.
    pub guide: bool,
    /// Indices of points that are marked with a circle.
    pub marks: Vec<usize>,
    /// Number of its colour, for what has the same one in every panel; otherwise curves are counted.
    pub style: Option<usize>,
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
    /// Values below 0 are drawn; otherwise the axis begins at 0 and cuts them off.
    pub signed: bool,
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

const PANEL_WIDTH: f64 = 440.0;
const PLOT_LEFT: f64 = 62.0;
const PLOT_TOP: f64 = 80.0;
const PLOT_WIDTH: f64 = 358.0;
const PLOT_HEIGHT: f64 = 250.0;
const PLOT_BOTTOM: f64 = PLOT_TOP + PLOT_HEIGHT;
const KEY_LINE: f64 = 17.0;

impl Chart {
    /// The chart as SVG.
    #[must_use]
    pub fn svg(&self) -> String {
        let keys: Vec<Vec<Styled<'_>>> = (0..self.panels.len()).map(|at| self.key(at)).collect();
        let longest = keys.iter().map(Vec::len).max().unwrap_or(0);
        let width = 16.0 + PANEL_WIDTH * self.panels.len().max(1) as f64;
        let height = PLOT_BOTTOM + 52.0 + KEY_LINE * longest as f64;
        let body = html! {
            @for (index, (panel, key)) in self.panels.iter().zip(&keys).enumerate() {
                (panel.draw(16.0 + PANEL_WIDTH * index as f64, index, key))
            }
        };
        document((width, height), &self.title, &self.note, &body)
    }
}

impl Chart {
    /// What the key of a panel has to say: the keys of the panels before it hold for it as well.
    fn key(&self, panel: usize) -> Vec<Styled<'_>> {
        let (before, from_here) = self.panels.split_at(panel);
        let is_told = |(curve, style, width): &Styled<'_>| {
            let mut told = before.iter().flat_map(Panel::styled);
            told.any(|(other, s, w)| other.label == curve.label && s == *style && w == *width)
        };
        let own = from_here.first().into_iter().flat_map(Panel::styled);
        own.filter(|curve| !is_told(curve)).collect()
    }
}

/// A curve with its colour, its dashes and its width.
type Styled<'a> = (&'a Curve, (&'static str, &'static str), f64);

/// The values that an axis spans.
#[derive(Clone, Copy)]
struct Range {
    low: f64,
    high: f64,
}

impl Range {
    fn share(self, value: f64) -> f64 {
        (value - self.low) / (self.high - self.low)
    }
}

impl Panel {
    fn x_range(&self) -> Range {
        let points = self.curves.iter().flat_map(|curve| &curve.points);
        let (low, high) = points.filter(|(x, y)| x.is_finite() && y.is_finite()).fold(
            (f64::INFINITY, f64::NEG_INFINITY),
            |(low, high), &(x, _)| (low.min(x), high.max(x)),
        );
        if low < high {
            Range { low, high }
        } else {
            Range {
                low: 0.0,
                high: 1.0,
            }
        }
    }

    /// From 0, or from below where values below 0 are drawn, up to a tick, so that nothing touches the
    /// frame but what is cut there.
    fn y_range(&self) -> Range {
        let values = self.curves.iter().flat_map(|curve| {
            let bounds = curve.band.iter().flat_map(|&(low, high)| [low, high]);
            curve.points.iter().map(|point| point.1).chain(bounds)
        });
        let (bottom, top) = values
            .filter(|value| value.is_finite())
            .fold((0.0, 0.0), |(low, high): (f64, f64), value| {
                (low.min(value), high.max(value))
            });
        let low = if self.signed { bottom } else { 0.0 };
        let mut high = self.highest.map_or(top, |highest| top.min(highest));
        if low >= high {
            high = 1.0;
        }
        let room = if high < top { 1.0 } else { 1.02 };
        let step = match ticks(low, high, 5.0).as_slice() {
            [first, second, ..] => second - first,
            _ => high,
        };
        Range {
            low: step * (low * 1.02 / step + 1e-9).floor(),
            high: step * (high * room / step - 1e-9).ceil(),
        }
    }

    fn draw(&self, left: f64, index: usize, key: &[Styled<'_>]) -> Markup {
        let (x, y) = (self.x_range(), self.y_range());
        let x0 = left + PLOT_LEFT;
        let px = |value: f64| x0 + PLOT_WIDTH * x.share(value);
        let py = |value: f64| PLOT_TOP + PLOT_HEIGHT * (1.0 - y.share(value));
        let (x_ticks, y_ticks) = (ticks(x.low, x.high, 6.0), ticks(y.low, y.high, 5.0));
        let (turn_x, middle) = (left + 14.0, PLOT_TOP + 0.5 * PLOT_HEIGHT);
        html! {
            text x=(Px(x0)) y=(Px(PLOT_TOP - 10.0)) font-size="12" font-weight="bold" fill="#222222" {
                (self.title)
            }
            @for (tick, label) in labelled(&x_ticks) {
                (text(px(tick), PLOT_BOTTOM + 16.0, "middle", &label))
                path d=(format_args!("M{:.1} {PLOT_BOTTOM:.1}v4", px(tick))) stroke="#222222" fill="none" {}
            }
            @for (tick, label) in labelled(&y_ticks) {
                (text(x0 - 7.0, py(tick) + 4.0, "end", &label))
                path d=(format_args!("M{x0:.1} {:.1}h{PLOT_WIDTH}", py(tick))) stroke="#dddddd" fill="none" {}
            }
            @if y.low < 0.0 {
                path d=(format_args!("M{x0:.1} {:.1}h{PLOT_WIDTH}", py(0.0))) stroke="#222222" fill="none" {}
            }
            g transform=(format_args!("rotate(-90 {turn_x:.1} {middle:.1})")) {
                (text(turn_x, middle, "middle", &self.y))
            }
            (text(x0 + 0.5 * PLOT_WIDTH, PLOT_BOTTOM + 36.0, "middle", &self.x))
            clipPath id={ "plot" (index) } {
                rect x=(Px(x0)) y=(Px(PLOT_TOP)) width=(PLOT_WIDTH) height=(PLOT_HEIGHT) {}
            }
            g clip-path={ "url(#plot" (index) ")" } {
                @for (curve, style, width) in self.styled() {
                    (curve.draw(style, width, px, py))
                }
            }
            rect x=(Px(x0)) y=(Px(PLOT_TOP)) width=(PLOT_WIDTH) height=(PLOT_HEIGHT) fill="none"
                stroke="#222222" {}
            @for (row, (curve, style, width)) in key.iter().enumerate() {
                @let y = PLOT_BOTTOM + 54.0 + KEY_LINE * row as f64;
                (line(&format!("M{x0:.1} {:.1}h28", y - 4.0), *style, *width))
                (text(x0 + 36.0, y, "start", &curve.label))
            }
        }
    }

    /// The curves with their styles and widths; measurements and guides are counted apart.
    fn styled(&self) -> impl Iterator<Item = Styled<'_>> {
        let (mut measured, mut guides) = (0, 0);
        self.curves.iter().map(move |curve| {
            let (count, styles, width): (&mut usize, &[_], f64) = if curve.guide {
                (&mut guides, &GUIDES, 1.2)
            } else {
                (&mut measured, &STYLES, 1.9)
            };
            let style = styles[curve.style.unwrap_or(*count) % styles.len()];
            *count += 1;
            (curve, style, width)
        })
    }
}

impl Curve {
    fn draw(
        &self,
        style: (&str, &str),
        width: f64,
        px: impl Fn(f64) -> f64,
        py: impl Fn(f64) -> f64,
    ) -> Markup {
        let has_band = self.band.len() == self.points.len() && self.points.len() > 1;
        let outline = || {
            let at = |(point, y): (&(f64, f64), f64)| (point.0, y);
            let upper = self
                .points
                .iter()
                .zip(self.band.iter().map(|bounds| bounds.1));
            let lower = self
                .points
                .iter()
                .zip(self.band.iter().map(|bounds| bounds.0));
            let both: Vec<(f64, f64)> = upper.chain(lower.rev()).map(at).collect();
            path(&both, &px, &py) + "Z"
        };
        html! {
            @if has_band { path d=(outline()) fill=(style.0) fill-opacity="0.16" {} }
            (line(&path(&self.points, &px, &py), style, width))
            @for (x, y) in self.marks.iter().filter_map(|index| self.points.get(*index)) {
                circle cx=(Px(px(*x))) cy=(Px(py(*y))) r="4.5" fill=(style.0) {}
            }
        }
    }
}

/// An `M`/`L` path through the points that are numbers.
fn path(points: &[(f64, f64)], px: impl Fn(f64) -> f64, py: impl Fn(f64) -> f64) -> String {
    let mut text = String::new();
    for &(x, y) in points
        .iter()
        .filter(|(x, y)| x.is_finite() && y.is_finite())
    {
        let letter = if text.is_empty() { 'M' } else { 'L' };
        // Far outside the frame a number is only long.
        let y = py(y).clamp(-9999.0, 9999.0);
        let _ = write!(text, "{letter}{:.1} {y:.1}", px(x));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::{png::png, svg::themed};

    fn curve(points: &[(f64, f64)]) -> Curve {
        Curve {
            label: "car".to_owned(),
            points: points.to_vec(),
            ..Curve::default()
        }
    }

    fn panel(curves: Vec<Curve>) -> Panel {
        Panel {
            y: "depth (m)".to_owned(),
            curves,
            ..Panel::default()
        }
    }

    fn chart(panel: Panel) -> Chart {
        Chart {
            title: "Depth & size <1>".to_owned(),
            panels: vec![panel],
            ..Chart::default()
        }
    }

    /// By hand: the frame is 358 x 250 pixels with its lower left corner at (78, 330). Of 0 to 10 on
    /// both axes, (2, 5) lies at 78 + 0.2 * 358 = 149.6 and 330 - 125 = 205.
    #[test]
    fn curves_lie_where_their_values_put_them() {
        let mut with_band = curve(&[(0.0, 0.0), (2.0, 5.0), (10.0, 7.5)]);
        with_band.band = vec![(0.0, 2.5), (2.5, 7.5), (7.5, 9.5)];
        let svg = chart(panel(vec![with_band])).svg();
        assert!(
            svg.contains("d=\"M78.0 330.0L149.6 205.0L436.0 142.5\""),
            "{svg}"
        );
        // Along the upper bounds and back along the lower ones.
        let band = "d=\"M78.0 267.5L149.6 142.5L436.0 92.5L436.0 142.5L149.6 267.5L78.0 330.0Z\"";
        assert!(svg.contains(band), "{svg}");
        // A larger value stands higher, also on the page: its tick's label has the smaller y.
        for (label, y) in [("0", "334.0"), ("10", "84.0")] {
            let tick = format!(
                "x=\"71.0\" y=\"{y}\" font-size=\"11\" text-anchor=\"end\" fill=\"#222222\">{label}<"
            );
            assert!(svg.contains(&tick), "no tick {label} in {svg}");
        }
    }

    /// -0.1 to 0.1: the middle of the frame, 205, is 0.
    #[test]
    fn signed_axes_go_below_zero() {
        let values = curve(&[(0.0, -0.09), (1.0, 0.0), (2.0, 0.09)]);
        let mut signed = panel(vec![values]);
        let low = |panel: &Panel| panel.y_range().low;
        assert_eq!(low(&signed), 0.0);
        signed.signed = true;
        assert!((low(&signed) + 0.1).abs() < 1e-12);
        let svg = chart(signed).svg();
        assert!(
            svg.contains("d=\"M78.0 317.5L257.0 205.0L436.0 92.5\""),
            "{svg}"
        );
        assert!(
            svg.contains("d=\"M78.0 205.0h358\" stroke=\"#222222\""),
            "{svg}"
        );
    }

    #[test]
    fn what_goes_beyond_the_axis_is_cut_at_its_end() {
        let mut high = panel(vec![curve(&[(0.0, 10.0), (1.0, 200.0)])]);
        high.highest = Some(80.0);
        assert_eq!(high.y_range().high, 80.0);
        // 200 of 80: 330 - 2.5 * 250.
        assert!(chart(high).svg().contains("L436.0 -295.0"));
        let empty = panel(Vec::new());
        assert!(empty.y_range().low == 0.0 && empty.y_range().high >= 1.0);
        assert_eq!((empty.x_range().low, empty.x_range().high), (0.0, 1.0));
    }

    #[test]
    fn charts_keep_their_text_and_become_pictures() {
        let with_gap = curve(&[(1.0, 2.0), (2.0, f64::NAN), (3.0, 9.0)]);
        let svg = chart(panel(vec![with_gap, Curve::default()])).svg();
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
        // The curve is blue and rises to the right: its blue pixels at the left lie lower.
        let blue_row = |column: u32| {
            let is_blue = |y: &u32| decoded.get_pixel(column, *y).0 == [0, 0x72, 0xb2];
            (0..2 * PLOT_BOTTOM as u32).find(is_blue)
        };
        let (left, right) = (blue_row(2 * 100).unwrap(), blue_row(2 * 400).unwrap());
        assert!(left > right + 100, "{left} {right}");
        assert!(png("nothing", 1.0).is_err());
    }

    /// A curve is explained once; what only a later panel has, or has in another style, is explained there.
    #[test]
    fn keys_are_told_once() {
        let named = |label: &str, guide| Curve {
            label: label.to_owned(),
            guide,
            ..curve(&[(0.0, 1.0), (1.0, 2.0)])
        };
        let first = panel(vec![
            named("car", false),
            named("crate", false),
            named("ideal", true),
        ]);
        let second = panel(vec![
            named("car", false),
            named("person", false),
            named("other", true),
        ]);
        let third = panel(vec![named("crate", false)]);
        let both = Chart {
            panels: vec![first, second, third],
            ..Chart::default()
        };
        let labels = |at| {
            both.key(at)
                .iter()
                .map(|one| one.0.label.as_str())
                .collect::<Vec<_>>()
        };
        assert_eq!(labels(0), ["car", "crate", "ideal"]);
        assert_eq!(labels(1), ["person", "other"]);
        // Of another colour than in the first panel.
        assert_eq!(labels(2), ["crate"]);
        assert_eq!(both.svg().matches(">car</text>").count(), 1);
    }

    #[test]
    fn themed_text_has_no_colour_of_its_own() {
        let mut chart = chart(panel(vec![Curve::default(); 7]));
        chart.title = "\"#111111\"".to_owned();
        let text = themed(&chart.svg(), "a").into_string();
        assert!(text.contains("&quot;#111111&quot;"));
        assert!(!text.contains("=\"#"), "{text}");
        assert!(text.contains("id=\"a-plot0\"") && text.contains("url(#a-plot0)"));
    }
}
