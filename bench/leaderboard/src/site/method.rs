//! One page per method: its card, its lines with ranks, warnings, digests, badge.

use maud::{Markup, html};
use strat_metrics::Metric;
use strat_splits::Leakage;

use super::frame::{self, number};
use super::ranking::words;
use crate::check::Checked;
use crate::section::{Method, Section, leaks, page_of};
use crate::submission::Submission;
use crate::web::{interval_text, scrolling, warning};

pub(super) fn page(checked: &Checked, sections: &[Section<'_>], submission: &Submission) -> String {
    let own: Vec<(&Section<'_>, &Method<'_>)> = own(sections, submission).collect();
    let mut said: Vec<String> = submission.run.warnings.clone();
    for (section, method) in &own {
        let leakage = &method.scored.leakage;
        let is_said = said.iter().any(|warning| warning.starts_with("LEAKAGE"));
        if leaks(leakage) && !is_said {
            said.push(format!(
                "LEAKAGE: under {} {leakage}",
                section.protocol.name
            ));
        }
    }
    let body = html! {
        @if !said.is_empty() { (warning("What was warned about when it was measured:", &said)) }
        h2 { "Results" }
        (results(&own))
        h2 { "About the method" }
        (card(submission))
        h2 { "Origin" }
        (origin(submission, own.first().map(|(_, method)| &method.scored.leakage)))
        h2 { "Badge" }
        p { img src={ "../badges/" (submission.id) ".svg" } alt={ "Badge of " (submission.card.method) } height="20"; }
        p.quiet { "Its address stays: " code { "badges/" (submission.id) ".svg" } " of this site; it shows the numbers of today." }
    };
    frame::page(
        checked,
        &submission.card.method,
        "../",
        &["board.js"],
        &body,
    )
}

/// The sections that a submission stands in.
pub(super) fn own<'s, 'a>(
    sections: &'s [Section<'a>],
    submission: &'s Submission,
) -> impl Iterator<Item = (&'s Section<'a>, &'s Method<'a>)> {
    sections.iter().filter_map(|section| {
        let method = section
            .methods
            .iter()
            .find(|method| method.submission.id == submission.id)?;
        Some((section, method))
    })
}

fn results(own: &[(&Section<'_>, &Method<'_>)]) -> Markup {
    let body = html! {
        table.sortable {
            thead { tr {
                th scope="col" { "Protocol" } th scope="col" { "Measured on" } th.n scope="col" { "Rank" }
                th.n scope="col" { "Images" }
                @for metric in Metric::ALL { th.n scope="col" { (metric.heading()) } }
                th scope="col" { "Against" }
            } }
            tbody { @for (section, method) in own {
                @let line = &method.measured.line;
                @let place = method.places[section.first_metric() as usize];
                tr.measured {
                    th scope="row" {
                        a href={ "../protocols/" (page_of(&section.protocol.name)) ".html#" (section.id) } { (section.protocol.name) }
                        (words(section, method))
                    }
                    td { (section.heading()) }
                    td.n data-v=[place.rank] { @match place.rank { Some(rank) => (rank), None => "-" } }
                    td.n data-v=(method.scored.images) { (method.scored.images) "/" (section.of_split) }
                    @for metric in Metric::ALL {
                        @let value = line.metrics[metric as usize];
                        td.n data-v=[value] {
                            @match value { Some(value) => (number(value)), None => "-" }
                            (interval_text(line.intervals[metric as usize]))
                        }
                    }
                    td { @if let Some(other) = opponent(section, method) {
                        a href={ "../compare.html#section=" (section.id) "&a=" (other.submission.id) "&b=" (method.submission.id) } {
                            (other.submission.card.method)
                        }
                    } }
                }
            } }
        }
    };
    scrolling(
        "Results",
        "Ranks are those of the first metric of a table; pages of protocols have the others.",
        &body,
    )
}

/// The best other method of a section.
fn opponent<'s, 'a>(section: &'s Section<'a>, method: &Method<'_>) -> Option<&'s Method<'a>> {
    section
        .methods
        .iter()
        .find(|other| other.submission.id != method.submission.id)
}

fn card(submission: &Submission) -> Markup {
    let card = &submission.card;
    let seed = card.seed.map(|seed| seed.to_string());
    let parameters = card.parameters.map(|count| count.to_string());
    let lines = [
        ("Supervision", Some(&card.supervision)),
        ("Trained on", Some(&card.training)),
        ("Variant", card.variant.as_ref()),
        ("Seed", seed.as_ref()),
        ("Weights", parameters.as_ref()),
        ("Submitted by", Some(&card.authors)),
        ("Licence", Some(&card.licence)),
        ("To cite", card.citation.as_ref()),
        ("Notes", card.notes.as_ref()),
        ("Partial, because", card.partial.as_ref()),
    ];
    html! {
        dl {
            @for (name, text) in lines { @if let Some(text) = text { dt { (name) } dd { (text) } } }
            // Its beginning was checked: https and nothing that could end an attribute.
            @if let Some(link) = &card.link { dt { "More" } dd { a href=(link) rel="noopener nofollow" { (link) } } }
        }
    }
}

fn origin(submission: &Submission, leakage: Option<&Leakage>) -> Markup {
    let run = &submission.run;
    let card = &submission.card;
    html! {
        dl {
            dt { "Rows and record" } dd { code { "submissions/" (submission.id) "/" } }
            dt { "Digest of the model" } dd { code { (submission.model_hash) } }
            @if let Some(leakage) = leakage { dt { "Training and test" } dd { (leakage) } }
            dt { "Ran on" } dd {
                @if let Some(device) = &card.device { (device) ", " }
                @if let Some(runtime) = &card.runtime { (runtime) ", " }
                "bench " (run.tool_version)
            }
            @for scored in &submission.scored {
                dt { (scored.protocol) } dd { "data " code { (format!("{:.12}", scored.data_digest)) } ", images " code { (format!("{:.12}", scored.images_digest)) } }
            }
        }
    }
}
