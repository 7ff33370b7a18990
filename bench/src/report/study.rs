//! A study's answer: the variants, every pair of them in words, and how their trainings went.
//!
//! Everything follows from the rows beside `study-results.yaml` and from `curves.csv`; means, intervals and
//! sentences are those of [`crate::rows::study`].

use std::path::{Path, PathBuf};

use maud::{Markup, html};
use serde::Deserialize;
use strat_metrics::{
    Metric, Row,
    statistics::Interval,
    study::{Part, Study},
    tables::Coverage,
};
use strat_store::{
    inputs::{self, Kind},
    yaml,
};

use super::{
    builder::Page,
    html::{scrolling, thesis_table, warning},
};
use crate::{
    evaluate::record,
    rows::{
        compare::{self, p_text},
        leaderboard, study,
    },
    study::{
        curves::Curves,
        write::{Answer, CURVES, CURVES_TABLE, Question, RECORD},
    },
};

/// A folder of `bench study`.
#[derive(Debug)]
pub struct StudyResults {
    /// The folder.
    pub folder: PathBuf,
    asked: Question,
    leakage: Option<String>,
    warnings: Vec<String>,
    rows: Vec<Row>,
    coverage: Coverage,
    /// How the trainings went, where that is there.
    pub curves: Option<Curves>,
}

/// What of the record is shown.
#[derive(Deserialize)]
struct Record {
    metric: String,
    effect: f64,
    #[serde(default)]
    leakage: Option<String>,
    #[serde(default)]
    rows: Vec<PathBuf>,
    #[serde(default)]
    warnings: Vec<String>,
}

impl StudyResults {
    /// Reads the answer in a folder; `None` where there is none.
    ///
    /// # Errors
    /// A sentence about what cannot be read.
    pub fn read(folder: &Path) -> Result<Option<Self>, String> {
        let path = folder.join(RECORD);
        if !path.is_file() {
            return Ok(None);
        }
        let record: Record = yaml::load(&path).map_err(|error| error.to_string())?;
        let wrong = |problem: &dyn std::fmt::Display| format!("{}: {problem}", path.display());
        let mut metrics = Metric::ALL.into_iter();
        let metric = metrics.find(|metric| metric.name() == record.metric);
        let metric = metric.ok_or_else(|| wrong(&format!("unknown metric {}", record.metric)))?;
        // An answer of rows alone names their files.
        let own = folder.join(record::ROWS);
        let files = if own.is_file() {
            vec![own]
        } else {
            record.rows
        };
        let Some(first) = files.first() else {
            return Err(wrong(&"the rows that it was made of are not there"));
        };
        let rows = compare::read_all_in_order(&files).map_err(|error| wrong(&error))?;
        let coverage = leaderboard::coverage_of(first, &rows).map_err(|error| wrong(&error))?;
        let path = folder.join(CURVES).join(CURVES_TABLE);
        let curves = if path.is_file() {
            let bytes = inputs::read(&path, Kind::Table).map_err(|error| error.to_string())?;
            let curves = Curves::from_csv(&bytes);
            Some(curves.map_err(|error| format!("{}: {error}", path.display()))?)
        } else {
            None
        };
        Ok(Some(Self {
            folder: folder.to_owned(),
            asked: Question {
                metric,
                effect: record.effect,
            },
            leakage: record.leakage,
            warnings: record.warnings,
            rows,
            coverage,
            curves,
        }))
    }

    /// What it is called on the page: the name of its folder.
    #[must_use]
    pub fn name(&self) -> String {
        let name = self.folder.file_name();
        name.map_or_else(String::new, |name| name.to_string_lossy().into_owned())
    }
}

impl Page {
    /// One study; `alone` on the page it needs no heading.
    pub(super) fn study(&mut self, results: &StudyResults, alone: bool) -> Markup {
        let answer = Answer::of(&results.rows, &results.coverage, results.asked);
        let Some(answer) = self.or_problem(answer) else {
            return html! {};
        };
        let metric = results.asked.metric;
        let parts = answer.studies().iter();
        let parts = parts.flat_map(|study| study.parts.iter().map(move |part| (study, part)));
        html! {
            @if !alone { h3 { (results.name()) } }
            @if let Some(leakage) = &results.leakage { p { (capital(leakage)) "." } }
            @if !results.warnings.is_empty() {
                (warning("What was warned about during the study:", &results.warnings))
            }
            @for table in answer.ablations() { (thesis_table(table)) }
            @for (study, part) in parts { (pairs(study, part, metric)) }
            p.quiet {
                "Differences are those of the variant named first to the other, with 95 % intervals over the choice "
                "of seeds and of drives together; p after Holm over all pairs in a metric. What it would take: what "
                "finds a difference of " (results.asked.effect) " in four of five studies like this."
            }
            @if let Some(curves) = &results.curves { (self.courses(curves)) }
        }
    }

    /// How the trainings of the variants went.
    fn courses(&mut self, curves: &Curves) -> Markup {
        let mut groups = Vec::new();
        for (title, charts) in curves.charts_apart() {
            groups.push(html! { h4 { (title) } (self.charts(&charts)) });
        }
        let (headings, lines) = curves.last();
        let table = html! {
            table.sortable {
                thead { tr {
                    th scope="col" { "Variant" }
                    @for heading in &headings { th.n scope="col" { (heading) } }
                } }
                tbody { @for (variant, cells) in &lines { tr {
                    th scope="row" { (variant) }
                    @for cell in cells { td.n { (cell) } }
                } } }
            }
        };
        html! {
            h3 { "How the trainings went" }
            p.quiet {
                "A discriminator that only guesses has the loss 1.386 and is right about half of the patches; one that is "
                "always right teaches as little as one that never is. Gradient norms say how hard each weighted term pulls "
                "at the disparities."
            }
            @for group in &groups { (group) }
            details {
                summary { "At the last epoch" }
                (scrolling("At the last epoch", "Mean ± standard deviation between seeds.", &table))
            }
        }
    }
}

/// The sentence with a capital letter.
fn capital(text: &str) -> String {
    let mut characters = text.chars();
    characters.next().map_or_else(String::new, |first| {
        first.to_uppercase().chain(characters).collect()
    })
}

/// The variants under one protocol and every pair of them.
fn pairs(study: &Study, part: &Part, metric: Metric) -> Markup {
    let group = part
        .group
        .map_or(String::new(), |group| format!(", {group}"));
    let under = format!("{}{group}", study.protocol);
    let index = metric as usize;
    let table = html! {
        table.sortable {
            thead { tr {
                th scope="col" { "Metric" }
                th scope="col" { "Variant" }
                th scope="col" { "against" }
                th.n scope="col" { "Difference" }
                th.n scope="col" { "p after Holm" }
                th scope="col" { "Verdict" }
            } }
            tbody { @for one in &part.differences {
                @let known = one.certainty.as_ref().ok();
                tr {
                    td { (one.metric.heading()) }
                    th scope="row" { (one.second) }
                    td { (one.first) }
                    td.n data-v=(one.difference) {
                        (format!("{:+.4}", one.difference))
                        @if let Some(Interval { low, high }) = known.map(|known| known.interval) {
                            small { (format!("{low:+.4} to {high:+.4}")) }
                        }
                    }
                    td.n data-v=[known.map(|known| known.p_holm)] { (p_text(known.map(|known| known.p_holm))) }
                    td { (study::verdict_words(one.verdict())) }
                }
            } }
        }
    };
    html! {
        h4 { (metric.heading()) " under " (under) }
        p {
            (part.images) " images of " (part.clusters.to_string()) ": "
            @for (number, variant) in part.variants.iter().enumerate() {
                @if number > 0 { ", " }
                strong { (variant.name) } (format!(" {:.4}", variant.mean[index]))
                @if let Some(deviation) = variant.deviation { (format!(" ± {:.4}", deviation[index])) }
                @if variant.seeds.len() > 1 { " (" (variant.seeds.len()) " seeds)" }
            }
            "."
        }
        ul.verdict { @for sentence in study::sentences(study, part, metric) { li { (sentence) } } }
        @if !part.differences.is_empty() {
            details {
                summary { "All differences" }
                (scrolling(&format!("Differences under {under}"), "Of the variant to the one it stands against.", &table))
            }
        }
    }
}
