//! A badge per method, for a README.

use maud::html;

use super::frame::number;
use super::method;
use crate::section::Section;
use crate::submission::Submission;

/// Width of a letter of 11 pixels, enough for most typefaces.
const LETTER: f64 = 6.6;

/// What the method has reached: its best ranked section, or else its first.
pub(super) fn svg(sections: &[Section<'_>], submission: &Submission) -> String {
    let ranked = |(section, method): &(&Section<'_>, &crate::section::Method<'_>)| {
        method.places[section.first_metric() as usize]
            .rank
            .unwrap_or(usize::MAX)
    };
    let chosen = method::own(sections, submission).min_by_key(ranked);
    let (left, right) = match chosen {
        None => ("depth".to_owned(), "no rows".to_owned()),
        Some((section, method)) => {
            let metric = section.first_metric();
            let value = method.measured.line.metrics[metric as usize]
                .map(number)
                .unwrap_or_default();
            let rank = match method.places[metric as usize].rank {
                Some(rank) => format!(
                    ", rank {rank} of {}",
                    section.methods.iter().filter(|m| m.takes_part()).count()
                ),
                None => String::new(),
            };
            let rendered = if section.data.source == "rendered" {
                " (rendered)"
            } else {
                ""
            };
            let right = format!("{} {value}{rank}", metric.heading());
            (format!("{}{rendered}", section.protocol.name), right)
        }
    };
    let width = |text: &str| (text.chars().count() as f64 * LETTER + 12.0).round();
    let (a, b) = (width(&left), width(&right));
    html! {
        svg xmlns="http://www.w3.org/2000/svg" width=(a + b) height="20" role="img" aria-label={ (left) ": " (right) } {
            title { (submission.card.method) ", " (left) ": " (right) }
            rect width=(a) height="20" fill="#3c4248" {}
            rect x=(a) width=(b) height="20" fill="#0b57a4" {}
            g fill="#ffffff" font-family="DejaVu Sans, Verdana, sans-serif" font-size="11" text-anchor="middle" {
                text x=(0.5 * a) y="14" { (left) }
                text x=(a + 0.5 * b) y="14" { (right) }
            }
        }
    }
    .into_string()
}
