//! What all SVG documents here share: the frame, text, ticks, colours and themes.
//!
//! Colours are Okabe and Ito's, which differ for colour-blind readers too; every line also has a dash
//! pattern of its own.

use maud::{Markup, PreEscaped, Render, html};

/// Line colours with their dash patterns.
pub(super) const STYLES: [(&str, &str); 5] = [
    ("#0072b2", ""),
    ("#d55e00", "7 3"),
    ("#009e73", "2 3"),
    ("#cc79a7", "9 3 2 3"),
    ("#56b4e9", "4 2"),
];

/// Lines that are not measured: ideals, fits and thresholds.
pub(super) const GUIDES: [(&str, &str); 3] = [
    ("#444444", "5 4"),
    ("#444444", "1 3"),
    ("#444444", "10 3 1 3"),
];

const FONT: &str = "DejaVu Sans, Verdana, Arial, sans-serif";

/// A length in pixels, written with one decimal.
#[derive(Clone, Copy)]
pub(super) struct Px(pub(super) f64);

impl Render for Px {
    fn render_to(&self, text: &mut String) {
        format_args!("{:.1}", self.0).render_to(text);
    }
}

/// A document with a title and a note at the top.
pub(super) fn document(
    (width, height): (f64, f64),
    title: &str,
    note: &str,
    body: &Markup,
) -> String {
    let (width, height) = (width.round(), height.round());
    html! {
        svg xmlns="http://www.w3.org/2000/svg" width=(width) height=(height)
            viewBox=(format_args!("0 0 {width} {height}")) font-family=(FONT) role="img" {
            title { (title) }
            desc { (note) }
            rect width="100%" height="100%" fill="#ffffff" {}
            text x="16" y="24" font-size="15" font-weight="bold" fill="#111111" { (title) }
            text x="16" y="42" font-size="11" fill="#444444" { (note) }
            (body)
        }
    }
    .into_string()
}

/// Small text; `anchor` is `start`, `middle` or `end`.
pub(super) fn text(x: f64, y: f64, anchor: &str, words: &str) -> Markup {
    html! {
        text x=(Px(x)) y=(Px(y)) font-size="11" text-anchor=(anchor) fill="#222222" { (words) }
    }
}

/// A line in one of the colours above, as an `M`/`L` path.
pub(super) fn line(path: &str, (colour, dashes): (&str, &str), width: f64) -> Markup {
    let dashes = (!dashes.is_empty()).then_some(dashes);
    html! {
        path d=(path) stroke=(colour) stroke-dasharray=[dashes] stroke-width=(width) fill="none" {}
    }
}

/// Ticks at 1, 2 or 5 times a power of ten, about `count` of them.
pub(super) fn ticks(low: f64, high: f64, count: f64) -> Vec<f64> {
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

/// The ticks with their labels, which have as many decimals as the step needs.
pub(super) fn labelled(ticks: &[f64]) -> impl Iterator<Item = (f64, String)> {
    let step = ticks
        .windows(2)
        .next()
        .map_or(1.0, |pair| pair[1] - pair[0]);
    ticks.iter().map(move |&tick| (tick, number(tick, step)))
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

/// One of these SVG documents for a page that has several of them and themes of its own: each colour
/// becomes the CSS variable that [`VARIABLES`] names for it, and ids begin with `id`.
#[must_use]
pub fn themed(svg: &str, id: &str) -> Markup {
    let mut text = svg
        .replace("\"plot", &format!("\"{id}-plot"))
        .replace("(#plot", &format!("(#{id}-plot"));
    // Quotes within words are escaped, so only attributes can match.
    for (colour, variable) in VARIABLES {
        text = text.replace(&format!("\"{colour}\""), &format!("\"var({variable})\""));
    }
    PreEscaped(text)
}

/// Every colour of the charts and the CSS variable that stands for it in themed pages.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round() {
        assert_eq!(ticks(0.0, 80.0, 5.0), [0.0, 20.0, 40.0, 60.0, 80.0]);
        assert_eq!(ticks(74.4, 90.0, 6.0), [75.0, 80.0, 85.0, 90.0]);
        assert_eq!(ticks(-0.1, 0.1, 4.0), [-0.1, -0.05, 0.0, 0.05, 0.1]);
        assert_eq!(number(0.30000000000000004, 0.1), "0.3");
        assert_eq!(number(-0.0, 0.5), "0");
    }
}
