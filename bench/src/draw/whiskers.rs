//! Values with their intervals, one below the other.

use maud::{Markup, html};

use super::svg::{Px, STYLES, document, labelled, text, ticks};

/// A value in a [`Whiskers`] diagram.
#[derive(Clone, Debug, Default)]
pub struct Mark {
    /// What it is about.
    pub label: String,
    /// The value.
    pub value: f64,
    /// Its interval.
    pub interval: Option<(f64, f64)>,
    /// Somebody else's value: drawn hollow.
    pub published: bool,
}

/// Values with their intervals, one below the other.
#[derive(Clone, Debug, Default)]
pub struct Whiskers {
    /// Above it.
    pub title: String,
    /// Label of the axis, with its unit.
    pub x: String,
    /// The values, top to bottom.
    pub marks: Vec<Mark>,
}

const LABELS: f64 = 236.0;
const PLOT: f64 = 300.0;
const LINE: f64 = 22.0;
const TOP: f64 = 62.0;
/// Letters of a label.
const LONGEST: usize = 36;

impl Whiskers {
    /// The diagram as SVG. Its axis spans the values and need not begin at 0.
    #[must_use]
    pub fn svg(&self) -> String {
        let (low, high) = self.range();
        let px = |x: f64| LABELS + PLOT * (x - low) / (high - low);
        let bottom = TOP + LINE * self.marks.len() as f64;
        let body = html! {
            @for (tick, label) in labelled(&ticks(low, high, 5.0)) {
                path d=(format_args!("M{:.1} {TOP:.1}V{bottom:.1}", px(tick))) stroke="#dddddd" fill="none" {}
                (text(px(tick), bottom + 16.0, "middle", &label))
            }
            @for (row, mark) in self.marks.iter().enumerate() {
                (mark.draw(TOP + LINE * (row as f64 + 0.5), px))
            }
            (text(LABELS + 0.5 * PLOT, bottom + 36.0, "middle", &self.x))
        };
        let note = "filled: measured, with its 95 % interval; hollow: published";
        let size = (LABELS + PLOT + 24.0, bottom + 48.0);
        document(size, &self.title, note, &body)
    }

    /// What the axis spans, with a margin.
    fn range(&self) -> (f64, f64) {
        let bounds = self.marks.iter().flat_map(|mark| {
            let (low, high) = mark.interval.unwrap_or((mark.value, mark.value));
            [low, mark.value, high]
        });
        let (low, high) = bounds
            .filter(|value| value.is_finite())
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
                (low.min(value), high.max(value))
            });
        let (low, high) = match (low < high, low.is_finite()) {
            (true, _) => (low, high),
            (false, true) => (low - 0.5, low + 0.5),
            (false, false) => (0.0, 1.0),
        };
        let margin = 0.04 * (high - low);
        (low - margin, high + margin)
    }
}

impl Mark {
    fn draw(&self, y: f64, px: impl Fn(f64) -> f64) -> Markup {
        let (colour, x) = (STYLES[0].0, px(self.value));
        html! {
            (text(LABELS - 10.0, y + 4.0, "end", &shortened(&self.label, LONGEST)))
            @if self.value.is_finite() {
                @if let Some((low, high)) = self.interval.map(|(low, high)| (px(low), px(high))) {
                    path d=(format_args!(
                        "M{low:.1} {y:.1}H{high:.1}M{low:.1} {:.1}v8M{high:.1} {0:.1}v8", y - 4.0
                    )) stroke=(colour) stroke-width="1.6" fill="none" {}
                }
                @if self.published {
                    path d=(format_args!("M{:.1} {y:.1}l5 -5l5 5l-5 5z", x - 5.0)) fill="#ffffff"
                        stroke="#444444" stroke-width="1.4" {}
                } @else {
                    circle cx=(Px(x)) cy=(Px(y)) r="4.5" fill=(colour) {}
                }
            }
        }
    }
}

fn shortened(text: &str, longest: usize) -> String {
    if text.chars().count() <= longest {
        return text.to_owned();
    }
    let kept: String = text.chars().take(longest - 1).collect();
    kept.trim_end().to_owned() + "…"
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::png::png;

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
        // 0.1 to 0.3 with 4 % on both sides: 300 / 1.08 wide. 0.2 is the middle, 0.15 a quarter.
        assert!(svg.contains("M247.1 73.0H524.9"), "{svg}");
        assert!(svg.contains("cx=\"386.0\" cy=\"73.0\""), "{svg}");
        assert!(svg.contains("M311.6 95.0l5 -5"), "{svg}");
        assert_eq!(
            (svg.matches("<circle").count(), svg.matches('…').count()),
            (2, 1)
        );
        assert!(png(&svg, 1.0).is_ok() && png(&Whiskers::default().svg(), 1.0).is_ok());
    }
}
