//! What the pages of a leaderboard and the report of `bench` share: style, sortable tables, and pieces
//! of HTML. Every text goes through maud, which escapes it.

use maud::{Markup, html};
use strat_metrics::statistics::Interval;

/// Style for screens, light and dark, phones and paper.
pub const STYLE: &str = include_str!("style.css");

/// Makes tables of the class `sortable` so.
pub const SORT: &str = include_str!("sort.js");

/// A box with sentences that a reader must not miss.
pub fn warning<'a>(words: &str, sentences: impl IntoIterator<Item = &'a String>) -> Markup {
    html! {
        div.warn role="note" {
            p { (words) }
            ul { @for sentence in sentences { li { (sentence) } } }
        }
    }
}

/// A table that scrolls within itself on narrow screens.
pub fn scrolling(label: &str, caption: &str, table: &Markup) -> Markup {
    html! {
        @if !caption.is_empty() { p.caption { (caption) } }
        div.scroll role="region" tabindex="0" aria-label=(label) { (table) }
    }
}

/// The bounds of an interval.
pub fn interval_text(interval: Option<Interval>) -> Markup {
    html! {
        @if let Some(Interval { low, high }) = interval {
            small { (format!("{low:.3}–{high:.3}")) }
        }
    }
}
