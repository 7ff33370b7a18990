//! The first page: rankings, methods, data sets, rules in words, sources.

use std::collections::BTreeSet;

use maud::{Markup, html};

use super::frame::{self, number};
use super::ranking;
use super::rules::ranking_rules;
use crate::check::Checked;
use crate::section::{Method, Section, page_of};
use crate::web::scrolling;

pub(super) fn page(checked: &Checked, sections: &[Section<'_>]) -> String {
    let body = html! {
        h2 { "Rankings" }
        (rankings(checked, sections))
        h2 { "Methods" }
        @if checked.submissions.is_empty() { p { "None yet." } }
        ul.methods { @for one in &checked.submissions {
            li {
                a href={ "methods/" (one.id) ".html" } { (one.card.method) }
                " " span.quiet { (one.card.supervision) ", " (one.card.authors) }
            }
        } }
        h2 { "Data sets" }
        (data_sets(checked))
        h2 #rules { "Rules" }
        (ranking_rules())
        h2 { "Published numbers" }
        p { "Quoted from these works, each row with its citation; nothing here was measured with this software." }
        ul.quiet { @for source in sources(checked) { li { (source) } } }
    };
    frame::page(checked, "", "", &[], &body)
}

fn rankings(checked: &Checked, sections: &[Section<'_>]) -> Markup {
    let body = html! {
        table {
            thead { tr {
                th scope="col" { "Protocol" } th scope="col" { "Measured on" } th.n scope="col" { "Methods" }
                th scope="col" { "Best" } th scope="col" { "Not told apart from it" }
            } }
            tbody { @for name in ranking::names(checked, sections) {
                @let own: Vec<&Section<'_>> = sections.iter().filter(|s| page_of(&s.protocol.name) == name).collect();
                @if own.is_empty() {
                    tr {
                        th scope="row" { a href={ "protocols/" (name) ".html" } { (name) } }
                        td { "published numbers only" } td.n { "0" } td { "-" } td { "-" }
                    }
                }
                @for section in own {
                    tr {
                        th scope="row" { a href={ "protocols/" (name) ".html#" (section.id) } { (section.protocol.name) } }
                        td.wrap { (section.heading()) @if section.expected < section.of_split {
                            small { (section.expected) " of " (section.of_split) " images" }
                        } }
                        td.n { (section.methods.len()) }
                        (best(section))
                    }
                }
            } }
        }
    };
    scrolling("Rankings", "", &body)
}

fn best(section: &Section<'_>) -> Markup {
    let metric = section.first_metric();
    let mut taking_part = section.methods.iter().filter(|method| method.takes_part());
    let first = taking_part.next();
    let alike = section
        .methods
        .iter()
        .filter(|method| method.places[metric as usize].rank == Some(1))
        .count();
    let value = |method: &Method<'_>| method.measured.line.metrics[metric as usize].map(number);
    html! {
        @match first {
            None => { td { "-" } td { "-" } }
            Some(method) => {
                td {
                    a href={ "methods/" (method.submission.id) ".html" } { (method.submission.card.method) }
                    small { (metric.heading()) " " (value(method).unwrap_or_default()) }
                }
                @match section.why_no_rank() {
                    Some(why) => td.wrap { small { "no ranks: " (why) } },
                    None => td { (alike - 1) " more" },
                }
            }
        }
    }
}

fn data_sets(checked: &Checked) -> Markup {
    let body = html! {
        table {
            thead { tr {
                th scope="col" { "Name" } th scope="col" { "Source" } th scope="col" { "Split" }
                th.n scope="col" { "Test images" } th scope="col" { "Digest" }
            } }
            tbody { @for data in &checked.board.data {
                tr {
                    th scope="row" { (data.name) } td { (data.source) } td { (data.split) }
                    td.n { (data.images) "/" (data.of_split()) } td { code { (data.digest) } }
                }
            } }
        }
    };
    scrolling("Data sets", "", &body)
}

fn sources(checked: &Checked) -> BTreeSet<&str> {
    checked
        .published
        .iter()
        .map(|row| row.citation.split(", row ").next().unwrap_or_default())
        .collect()
}
