//! One page per protocol: its sections by data set, group and alignment, with ranks and intervals.

use maud::{Markup, html};
use strat_metrics::{Group, Metric, Protocol, protocol};
use strat_splits::Leakage;

use super::frame::{self, number, p_text};
use super::rules::ranking_rules;
use crate::check::Checked;
use crate::published::Published;
use crate::section::{Method, Section, first_metric, leaks, page_of, published_under};
use crate::web::{interval_text, scrolling, warning};

/// Path and text of every protocol's page.
pub(super) fn pages(checked: &Checked, sections: &[Section<'_>]) -> Vec<(String, String)> {
    names(checked, sections)
        .into_iter()
        .map(|name| {
            let body = body(checked, sections, &name);
            let path = format!("protocols/{name}.html");
            (
                path,
                frame::page(checked, &name, "../", &["board.js"], &body),
            )
        })
        .collect()
}

/// Names of the pages in the order of the protocols.
pub(super) fn names(checked: &Checked, sections: &[Section<'_>]) -> Vec<String> {
    let mut names: Vec<String> = Vec::new();
    let measured = sections
        .iter()
        .map(|section| page_of(&section.protocol.name));
    let published = checked.published.iter().map(|row| page_of(&row.protocol));
    for name in measured.chain(published) {
        if !names.contains(&name) {
            names.push(name);
        }
    }
    names
}

/// A table: a section, or published rows that no measured ones stand beside.
struct Part<'a> {
    id: String,
    heading: String,
    protocol: Protocol,
    section: Option<&'a Section<'a>>,
    published: Vec<&'a Published>,
}

fn parts<'a>(checked: &'a Checked, sections: &'a [Section<'a>], page: &str) -> Vec<Part<'a>> {
    let own = sections
        .iter()
        .filter(|section| page_of(&section.protocol.name) == page);
    let mut parts: Vec<Part<'a>> = own
        .map(|section| Part {
            id: section.id.clone(),
            heading: section.heading(),
            protocol: section.protocol.clone(),
            section: Some(section),
            published: match section.data.competes() {
                true => published_under(&checked.published, &section.protocol.name, section.group),
                false => Vec::new(),
            },
        })
        .collect();
    let mut keys: Vec<(String, Option<Group>)> = Vec::new();
    for row in checked
        .published
        .iter()
        .filter(|row| page_of(&row.protocol) == page)
    {
        let group = row.group.as_deref().and_then(|group| group.parse().ok());
        let key = (row.protocol.clone(), group);
        let is_shown = parts.iter().any(|part| {
            part.protocol.name == key.0
                && part
                    .section
                    .is_some_and(|s| s.group == key.1 && s.data.competes())
        });
        if !is_shown && !keys.contains(&key) {
            keys.push(key);
        }
    }
    for (name, group) in keys {
        // Published rows were checked against the protocols.
        let Some(rules) = protocol(&name) else {
            continue;
        };
        let group_name = group.map_or(String::new(), |group| format!(", {group}"));
        parts.push(Part {
            id: format!(
                "{name}{}-published",
                group.map_or(String::new(), |g| format!(".{g}"))
            ),
            heading: format!("Published numbers{group_name}"),
            protocol: rules,
            section: None,
            published: published_under(&checked.published, &name, group),
        });
    }
    parts
}

fn body(checked: &Checked, sections: &[Section<'_>], page: &str) -> Markup {
    let parts = parts(checked, sections, page);
    let mut supervisions: Vec<&str> = Vec::new();
    let mut alignments: Vec<String> = Vec::new();
    for part in &parts {
        let alignment = part.protocol.alignment.to_string();
        if !alignments.contains(&alignment) {
            alignments.push(alignment);
        }
        let measured = part.section.iter().flat_map(|section| &section.methods);
        let all = measured.map(|method| method.submission.card.supervision.as_str());
        for supervision in all.chain(part.published.iter().map(|row| row.supervision.as_str())) {
            if !supervisions.contains(&supervision) {
                supervisions.push(supervision);
            }
        }
    }
    supervisions.sort_unstable();
    html! {
        (controls(&supervisions, &alignments))
        @for part in &parts { (table(part)) }
        h2 #rules { "Rules" }
        @for rules in distinct(&parts) {
            h3 { code { (rules.name) } }
            p.quiet { "Version " (rules.version) ", digest " code { (rules.digest()) } }
            ul { @for line in rules.describe().lines() { li { (line) } } }
        }
        (ranking_rules())
    }
}

fn distinct<'p>(parts: &'p [Part<'_>]) -> Vec<&'p Protocol> {
    let mut all: Vec<&Protocol> = Vec::new();
    for part in parts {
        if !all.iter().any(|known| known.name == part.protocol.name) {
            all.push(&part.protocol);
        }
    }
    all
}

/// What a reader may choose; without scripts everything is shown.
fn controls(supervisions: &[&str], alignments: &[String]) -> Markup {
    let choice = |label: &str, key: &str, options: &[(&str, String)]| {
        html! {
            label { (label) " "
                select data-filter=(key) {
                    option value="" { "all" }
                    @for (value, words) in options { option value=(value) { (words) } }
                }
            }
        }
    };
    let own = |texts: &[&str]| -> Vec<(String, String)> {
        texts
            .iter()
            .map(|text| ((*text).to_owned(), (*text).to_owned()))
            .collect()
    };
    let supervisions = own(supervisions);
    let supervisions: Vec<(&str, String)> = supervisions
        .iter()
        .map(|(value, words)| (value.as_str(), words.clone()))
        .collect();
    let aligned: Vec<(&str, String)> = alignments
        .iter()
        .map(|name| (name.as_str(), name.clone()))
        .collect();
    html! {
        details.choice hidden open {
            summary { "Ranked by, filters, columns" }
            form.controls aria-label="What is shown" {
                label { "Ranked by "
                    select data-metric {
                        @for metric in Metric::ALL { option value=(metric.name()) { (metric.heading()) } }
                    }
                }
                (choice("Supervision", "supervision", &supervisions))
                @if aligned.len() > 1 { (choice("Alignment", "alignment", &aligned)) }
                (choice("Images", "images", &[("complete", "complete".to_owned()), ("partial", "partial".to_owned())]))
                (choice("Origin", "origin", &[("measured", "measured".to_owned()), ("published", "published".to_owned())]))
                fieldset {
                    legend { "Columns" }
                    @for metric in Metric::ALL {
                        label { input type="checkbox" checked data-column=(metric.name()); " " (metric.heading()) }
                    }
                    label { input type="checkbox" checked data-column="bounds"; " intervals" }
                }
            }
        }
    }
}

fn table(part: &Part<'_>) -> Markup {
    let first = first_metric(&part.protocol);
    let scale = Scale::of(part, first);
    let is_rendered = part
        .section
        .is_some_and(|section| section.data.source == "rendered");
    let body = html! {
        table.sortable.ranking data-first=(first.name()) {
            thead { tr {
                th.n scope="col" { "Rank" }
                th scope="col" { "Method" }
                th.drawn scope="col" { span.of { (first.heading()) } ", 95 % interval" }
                @for metric in Metric::ALL {
                    th.n scope="col" data-column=(metric.name()) data-lower[metric.lower_is_better()] { (metric.heading()) }
                }
                th.n scope="col" { "p to the best" }
            } }
            tbody {
                @if let Some(section) = part.section {
                    @for method in &section.methods { (measured(section, method, first, &scale)) }
                }
                @for row in &part.published { (published(row, first, &scale)) }
            }
        }
    };
    html! {
        section data-alignment=(part.protocol.alignment) {
            h2 id=(part.id) { (part.heading) @if part.heading.is_empty() { (part.protocol.name) } }
            p.quiet {
                "Protocol " code { (part.protocol.name) } ", digest " code { (format!("{:.12}", part.protocol.digest())) }
                @if let Some(section) = part.section {
                    "; data " code { (format!("{:.12}", section.data.digest)) } "; "
                    (section.expected) " of the " (section.of_split) " test images, "
                    (section.recordings) " recordings"
                }
                ". " @if part.protocol.alignment != strat_metrics::Alignment::None {
                    "Aligned per image (" (part.protocol.alignment) "): predictions have seen the ground truth. "
                }
                @if part.section.is_some() {
                    a href={ "../csv/" (part.id) ".csv" } download={ (part.id) ".csv" } { "CSV" } " · "
                    a href={ "../compare.html#section=" (part.id) } { "Compare" }
                }
            }
            @if is_rendered {
                (warning("Rendered images, not KITTI: these numbers cannot be compared with published ones.", []))
            }
            @if let Some(why) = part.section.and_then(Section::why_no_rank) {
                p.quiet { "No ranks: " (why) "." }
            }
            (scrolling(&format!("Ranking {}", part.id), "", &body))
        }
    }
}

/// From values to the width of the drawn column.
struct Scale {
    low: f64,
    high: f64,
}

impl Scale {
    fn of(part: &Part<'_>, metric: Metric) -> Self {
        let index = metric as usize;
        let measured = part.section.iter().flat_map(|section| &section.methods);
        let bounds = measured.flat_map(|method| {
            let line = &method.measured.line;
            let interval = line.intervals[index];
            [
                line.metrics[index],
                interval.map(|i| i.low),
                interval.map(|i| i.high),
            ]
        });
        let published = part.published.iter().map(|row| row.metrics()[index]);
        let (low, high) = bounds
            .chain(published)
            .flatten()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
                (low.min(value), high.max(value))
            });
        if low < high {
            Self { low, high }
        } else {
            Self {
                low: low - 0.5,
                high: low + 0.5,
            }
        }
    }

    /// Per cent of the width.
    fn at(&self, value: f64) -> String {
        format!(
            "{:.1}",
            3.0 + 94.0 * (value - self.low) / (self.high - self.low)
        )
    }
}

/// A value with its interval, drawn; `board.js` draws the same for other metrics.
fn drawn(value: Option<f64>, interval: Option<(f64, f64)>, scale: &Scale, hollow: bool) -> Markup {
    let Some(value) = value else {
        return html! {};
    };
    html! {
        svg.iv.hollow[hollow] viewBox="0 0 100 14" preserveAspectRatio="none" aria-hidden="true" {
            @if let Some((low, high)) = interval {
                path d={ "M" (scale.at(low)) " 3v8M" (scale.at(low)) " 7H" (scale.at(high)) "M" (scale.at(high)) " 3v8" } {}
            }
            path.dot d={ "M" (scale.at(value)) " 7h0" } {}
        }
    }
}

fn measured(section: &Section<'_>, method: &Method<'_>, first: Metric, scale: &Scale) -> Markup {
    let line = &method.measured.line;
    let card = &method.submission.card;
    let place = method.places[first as usize];
    let interval = line.intervals[first as usize].map(|interval| (interval.low, interval.high));
    let completeness = if method.measured.whole {
        "complete"
    } else {
        "partial"
    };
    html! {
        tr.measured.best[place.rank == Some(1)]
            data-supervision=(card.supervision) data-images=(completeness) data-origin="measured"
            data-ranks=(joined(method.places.iter().map(|place| place.rank.map(|rank| rank.to_string()))))
            data-ps=(joined(method.places.iter().map(|place| place.p_holm.map(|p| p.to_string()))))
        {
            td.n.rank data-v=[place.rank] { @match place.rank { Some(rank) => (rank), None => "-" } }
            th scope="row" {
                a href={ "../methods/" (method.submission.id) ".html" } { (card.method) }
                (words(section, method))
                small { (card.supervision) ", " (method.scored.images) "/" (section.of_split) " images" }
            }
            td.drawn { (drawn(line.metrics[first as usize], interval, scale, false)) }
            @for metric in Metric::ALL {
                (cell(metric, line.metrics[metric as usize], line.intervals[metric as usize].map(|i| (i.low, i.high))))
            }
            td.n.p data-v=[place.p_holm] { @match place.p_holm { Some(p) => (p_text(p)), None => "-" } }
        }
    }
}

fn joined(values: impl Iterator<Item = Option<String>>) -> String {
    values
        .map(Option::unwrap_or_default)
        .collect::<Vec<_>>()
        .join(" ")
}

/// What must be known of a row where it stands.
pub(super) fn words(section: &Section<'_>, method: &Method<'_>) -> Markup {
    let leakage = &method.scored.leakage;
    html! {
        @if section.data.source == "rendered" { " " span.tag { "rendered" } }
        @if !method.measured.whole { " " span.tag.bad { "partial" } }
        @if leaks(leakage) { " " span.tag.bad { "leakage" } }
        @if leaks(leakage) { small { (leakage) } }
        @if *leakage == Leakage::Unknown { small { (leakage) } }
        @if let Some(why) = method.submission.card.partial.as_ref().filter(|_| !method.measured.whole) {
            small { (why) }
        }
    }
}

fn cell(metric: Metric, value: Option<f64>, interval: Option<(f64, f64)>) -> Markup {
    html! {
        td.n data-column=(metric.name()) data-v=[value] data-l=[interval.map(|i| i.0)] data-h=[interval.map(|i| i.1)] {
            @match value { Some(value) => (number(value)), None => "-" }
            (interval_text(interval.map(|(low, high)| strat_metrics::statistics::Interval { low, high })))
        }
    }
}

fn published(row: &Published, first: Metric, scale: &Scale) -> Markup {
    let metrics = row.metrics();
    html! {
        tr data-supervision=(row.supervision) data-images="" data-origin="published" data-ranks="" data-ps="" {
            td.n.rank { "-" }
            th scope="row" {
                (row.method) " " span.tag { "published" }
                small { (row.supervision) }
                small { (row.citation) @if let Some(note) = &row.note { ". " (note) } }
            }
            td.drawn { (drawn(metrics[first as usize], None, scale, true)) }
            @for metric in Metric::ALL { (cell(metric, metrics[metric as usize], None)) }
            td.n.p { "-" }
        }
    }
}
