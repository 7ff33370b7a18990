//! The page as a whole: sections in their order, and what is said once.

use std::collections::BTreeSet;

use maud::{DOCTYPE, Markup, PreEscaped, html};

use strat_leaderboard::web::{SORT, STYLE};
use strat_metrics::tables::Source;

use super::{
    builder::Page,
    collect::{Collected, DataSet},
    html::warning,
    origin::{protocols, provenance},
    speed::latency,
    training,
};

/// The page may load nothing but what is in it.
const POLICY: &str = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; \
                      script-src 'unsafe-inline'; base-uri 'none'; form-action 'none'";

/// How every page begins, which tells it from other files.
pub const BEGINS: &str = "<!DOCTYPE html><html lang=\"en\"><head><meta charset=\"utf-8\">\
                          <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\
                          <meta http-equiv=\"Content-Security-Policy\" \
                          content=\"default-src 'none'; img-src data:";

/// A finished page.
#[derive(Debug)]
pub struct Rendered {
    /// The page.
    pub html: String,
    /// A sentence for everything that was left out of it; the page begins with them.
    pub problems: Vec<String>,
}

/// The page about everything that was collected, under a title. Pictures that lie beside the rows
/// are shown until they weigh 3 MB together.
#[must_use]
pub fn render(title: &str, collected: &Collected) -> Rendered {
    let mut page = Page::default();
    let mut sections: Vec<(String, String, Markup)> = Vec::new();
    if !collected.studies.is_empty() {
        let alone = collected.studies.len() == 1;
        let studies = collected.studies.iter();
        let bodies: Vec<Markup> = studies.map(|one| page.study(one, alone)).collect();
        let body = html! { @for body in &bodies { (body) } };
        sections.push(("study".to_owned(), "Study".to_owned(), body));
    }
    for (index, set) in collected.data_sets.iter().enumerate() {
        let id = format!("data-{}", index + 1);
        let of_study = set.runs.iter().all(|run| collected.is_of_study(run));
        sections.push((id, heading_of(set), page.data_set(index, set, of_study)));
    }
    let mut section = |id: &str, heading: &str, body: Markup| {
        sections.push((id.to_owned(), heading.to_owned(), body));
    };
    if let Some(curves) = training::curves(collected) {
        section("training", "Training", page.charts(&[curves]));
    }
    if !collected.cues.is_empty() {
        let body = html! { @for results in &collected.cues { (page.cues(results)) } };
        section("cues", "Depth cues", body);
    }
    if !collected.latency.is_empty() {
        section("speed", "Speed", latency(&collected.latency));
    }
    if !collected.data_sets.is_empty() {
        section("rules", "Protocols in words", protocols(collected));
        section(
            "origin",
            "Where the numbers come from",
            provenance(collected),
        );
    }
    let problems: Vec<String> = [collected.problems.clone(), page.problems].concat();
    let html = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta http-equiv="Content-Security-Policy" content=(POLICY);
                title { (title) }
                style { (PreEscaped(STYLE)) }
            }
            body {
                a.skip href="#content" { "Skip to the content" }
                header {
                    h1 { (title) }
                    p.quiet {
                        "Written by strat bench " (env!("CARGO_PKG_VERSION"))
                        " from the files below this folder. Measured numbers carry 95 % intervals; \
                         published ones are marked as published."
                    }
                    nav aria-label="Sections" {
                        ul { @for (id, heading, _) in &sections { li { a href={ "#" (id) } { (heading) } } } }
                    }
                }
                main #content {
                    @if !problems.is_empty() {
                        (warning("Left out, because it cannot be read or used:", &problems))
                    }
                    @for (id, heading, body) in &sections {
                        section aria-labelledby=(id) {
                            h2 id=(id) { (heading) }
                            (body)
                        }
                    }
                }
                script { (PreEscaped(SORT)) }
            }
        }
    }
    .into_string();
    Rendered { html, problems }
}

/// What is said once: the name of the split, of the source, and how much of it is there.
fn heading_of(set: &DataSet) -> String {
    let split = set
        .rows
        .first()
        .map_or("", |row| row.context.split.as_str());
    let split = match split {
        "kitti" => "KITTI split",
        "eigen" => "Eigen split",
        "make3d" => "Make3D",
        "cityscapes" => "Cityscapes",
        other => other,
    };
    let images: BTreeSet<&str> = set.rows.iter().map(|row| row.image.as_str()).collect();
    format!(
        "{split}, {} ({} of {} images)",
        match &set.coverage.source {
            Source::Kitti => "recorded images".to_owned(),
            Source::Rendered => "rendered images".to_owned(),
            other => other.to_string(),
        },
        images.len(),
        set.coverage.expected_images
    )
}
