//! The page as HTML.

use std::{collections::BTreeSet, path::Path};

use maud::{DOCTYPE, Markup, PreEscaped, html};
use strat_metrics::{
    Grouping, Metric, Protocol, ProtocolName, Row, Suffix,
    leaderboard::{self, Entry},
    published::Marker,
    rows::by_model,
    statistics::{Bootstrap, Interval},
    tables::{self, Cell, Line, Scale, Source, Table, ThesisTable},
};
use strat_store::{
    image_files,
    resize::{self, Kernel},
};

use super::{Collected, CueResults, DataSet, Run, charts};
use crate::{
    cues::{curves, summary},
    draw::{comparison, sheet::data_address, svg::themed},
    evaluate::record::ModelRecord,
    latency::LatencyRow,
    rows::compare::protocols_of,
};

const STYLE: &str = include_str!("style.css");
const SCRIPT: &str = include_str!("sort.js");

/// The page may load nothing but what is in it.
const POLICY: &str = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; \
                      script-src 'unsafe-inline'; base-uri 'none'; form-action 'none'";

/// What stands above the verdicts about depth cues and above the measurements of time.
const CUES: &str = "Effects with 95 % intervals from drawing whole backgrounds. Yes: the whole \
                    interval is above the threshold; no: within it on both sides; reversed: below \
                    its negative; undecided: anything else.";
const SPEED: &str = "Milliseconds per query, and images per second. A query is one image (single \
                     stream) or one batch (multi stream); offline has all images at hand.";

/// Best and worst images shown of each model.
const EXTREMES: usize = 3;
/// Width of a picture in pixels, its quality, and what all of them may weigh in bytes.
const PICTURE_WIDTH: u32 = 920;
const PICTURE_QUALITY: u8 = 74;
const PICTURES_BYTES: usize = 3_000_000;

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
    for (place, set) in collected.data_sets.iter().enumerate() {
        let id = format!("data-{}", place + 1);
        sections.push((id, heading_of(set), page.data_set(place, set)));
    }
    let mut section = |id: &str, heading: &str, body: Markup| {
        sections.push((id.to_owned(), heading.to_owned(), body));
    };
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
            "Where the figures come from",
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
                        " from the files below this folder. Measured figures carry 95 % intervals \
                         over drives; published ones are marked as published."
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
                script { (PreEscaped(SCRIPT)) }
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

fn warning<'a>(words: &str, sentences: impl IntoIterator<Item = &'a String>) -> Markup {
    html! {
        div.warn role="note" {
            p { (words) }
            ul { @for sentence in sentences { li { (sentence) } } }
        }
    }
}

/// A table that scrolls within itself on narrow screens.
fn scrolling(label: &str, caption: &str, table: &Markup) -> Markup {
    html! {
        @if !caption.is_empty() { p.caption { (caption) } }
        div.scroll role="region" tabindex="0" aria-label=(label) { (table) }
    }
}

fn interval_text(interval: Option<Interval>) -> Markup {
    html! {
        @if let Some(Interval { low, high }) = interval {
            small { (format!("{low:.3} to {high:.3}")) }
        }
    }
}

/// A figure with its interval below.
fn figure(value: Option<f64>, interval: Option<Interval>) -> Markup {
    html! {
        @match value {
            Some(value) => td.n data-v=(value) { (format!("{value:.3}")) (interval_text(interval)) },
            None => td.n { "-" },
        }
    }
}

fn thesis_table(table: &Table) -> Markup {
    let cell = |place: usize, cell: &Cell| {
        let mark = match cell.marker {
            Some(Marker::Star) => " *",
            Some(Marker::Dagger) => " †",
            None => "",
        };
        let numeric = table
            .columns()
            .get(place)
            .is_some_and(|column| column.numeric);
        html! {
            @if place == 0 {
                th scope="row" { (cell.text) (mark) }
            } @else {
                td.n[numeric] data-v=[cell.value] {
                    @if cell.best { strong { (cell.text) } } @else { (cell.text) }
                    (mark)
                    (interval_text(cell.interval))
                }
            }
        }
    };
    let line = |line: &Line| {
        // Lines of table 3.2 hold both; its headings say which column is which.
        let measured = line.measured && table.id() != ThesisTable::Table32;
        html! {
            tr.measured[measured].later[line.grey] {
                @for (place, one) in line.cells.iter().enumerate() { (cell(place, one)) }
            }
        }
    };
    let body = html! {
        table.sortable {
            thead { tr {
                @for column in table.columns() {
                    th.n[column.numeric] scope="col" { (column.heading) }
                }
            } }
            @for section in table.sections() {
                tbody {
                    @if let Some(heading) = &section.heading {
                        tr { th.part colspan=(table.columns().len()) scope="colgroup" { (heading) } }
                    }
                    @for one in &section.lines { (line(one)) }
                }
            }
        }
    };
    html! {
        @if !table.remarks().is_empty() { (warning("", table.remarks())) }
        (scrolling(
            &format!("Table {}", table.id()),
            &format!("{}. Bold: best among comparable lines.", table.first_line()),
            &body,
        ))
        details {
            summary { "Notes to the table" }
            ul.notes { @for note in table.notes() { li { (note) } } }
        }
    }
}

/// Lines of a leaderboard under protocols that no table is about.
fn entries_table(entries: &[Entry]) -> Markup {
    let body = html! {
        table.sortable {
            thead { tr {
                th scope="col" { "Method" }
                th scope="col" { "Protocol" }
                th.n scope="col" { "Images" }
                @for metric in Metric::ALL { th.n scope="col" { (metric.heading()) } }
                th.n scope="col" { "D1-all" }
            } }
            tbody {
                @for entry in entries {
                    tr.measured {
                        th scope="row" { (entry.method) }
                        td { (entry.protocol) }
                        td.n data-v=[entry.images] {
                            (entry.images.unwrap_or_default()) "/" (entry.expected_images.unwrap_or_default())
                        }
                        @for (value, interval) in entry.metrics.iter().zip(entry.intervals) {
                            (figure(*value, interval))
                        }
                        (figure(entry.d1_all, entry.d1_all_interval))
                    }
                }
            }
        }
    };
    scrolling("Further protocols", "", &body)
}

/// What is counted while a page grows.
#[derive(Default)]
struct Page {
    charts: usize,
    picture_bytes: usize,
    problems: Vec<String>,
}

impl Page {
    fn chart(&mut self, svg: &str) -> Markup {
        self.charts += 1;
        themed(svg, &format!("c{}", self.charts))
    }

    fn charts(&mut self, svgs: &[String]) -> Markup {
        html! { div.charts { @for svg in svgs { div { (self.chart(svg)) } } } }
    }

    /// What `result` holds; otherwise its error is put down and nothing is shown.
    fn or_problem<T, E: std::fmt::Display>(&mut self, result: Result<T, E>) -> Option<T> {
        result
            .map_err(|error| self.problems.push(error.to_string()))
            .ok()
    }

    fn data_set(&mut self, place: usize, set: &DataSet) -> Markup {
        let warnings: Vec<String> = set
            .runs
            .iter()
            .flat_map(|run| {
                let record = run.record.iter();
                record.flat_map(|record| {
                    let missing = (record.failures > 0).then(|| {
                        format!(
                            "{} result(s) of the run in {} are missing; its failures.csv lists them",
                            record.failures,
                            run.folder.display()
                        )
                    });
                    record.warnings.iter().cloned().chain(missing)
                })
            })
            .collect();
        let names = protocols_of(&set.rows);
        let grouping = |name: &String| {
            rules_of(set, name).map_or(Grouping::None, |protocol| protocol.grouping)
        };
        let of_tables = self.tables(set, &names);
        let by_distance: Vec<&String> = names
            .iter()
            .filter(|name| grouping(name) == Grouping::Distance)
            .collect();
        let further: Vec<&String> = names
            .iter()
            .filter(|name| grouping(name) == Grouping::None && ThesisTable::showing(name).is_none())
            .collect();
        let first = names.iter().find(|name| grouping(name) == Grouping::None);
        html! {
            @if !warnings.is_empty() { (warning("What was warned about during the runs:", &warnings)) }
            (of_tables)
            @if !further.is_empty() {
                h3 { "Under further protocols" }
                (self.further(set, &further))
            }
            h3 { "Error against distance" }
            @if by_distance.is_empty() {
                p.quiet {
                    "Not measured. " code {
                        "bench --protocol "
                        (ProtocolName::parse(first.map_or("eigen-80", |name| name)).with(Suffix::Distance))
                    }
                    " scores pixels by their true depth; the curves then stand here."
                }
            }
            @for name in by_distance { (self.distances(set, name)) }
            @if let Some(name) = first {
                h3 { "Best and worst images" }
                (self.images(place, set, name))
            }
        }
    }

    fn tables(&mut self, set: &DataSet, names: &[String]) -> Markup {
        let mut parts = Vec::new();
        for id in ThesisTable::ALL {
            for scale in Scale::ALL {
                let own = id.protocols_at(scale);
                if !own.iter().any(|protocol| names.contains(protocol)) {
                    continue;
                }
                let own: Vec<&str> = own.iter().map(String::as_str).collect();
                let built = tables::build_with(id, &own, &set.rows, &set.coverage);
                let Some(table) = self.or_problem(built) else {
                    continue;
                };
                parts.push(html! {
                    h3 {
                        "Table " (id)
                        @if scale == Scale::Median { ", scaled by medians" }
                        @if id == ThesisTable::Table32 { ": error by semantic group" }
                    }
                    (thesis_table(&table))
                    @if id == ThesisTable::Table32 {
                        (self.charts(&charts::of_groups(&table)))
                    } @else {
                        @for section in table.sections() {
                            @if let Some(heading) = &section.heading { h4 { (heading) } }
                            (self.charts(&charts::of_section(&table, section)))
                        }
                    }
                });
            }
        }
        html! { @for part in parts { (part) } }
    }

    fn further(&mut self, set: &DataSet, names: &[&String]) -> Markup {
        let mut entries = Vec::new();
        for name in names {
            let measured = leaderboard::measured(&set.rows, name, set.coverage.expected_images);
            entries.extend(self.or_problem(measured).unwrap_or_default());
        }
        entries_table(&entries)
    }

    fn distances(&mut self, set: &DataSet, protocol: &str) -> Markup {
        let found = charts::distances(&set.rows, protocol);
        let Some(found) = self.or_problem(found) else {
            return html! {};
        };
        let body = html! {
            table.sortable {
                thead { tr {
                    th scope="col" { "Model" }
                    th.n scope="col" { "True depth" }
                    @for metric in Metric::ALL { th.n scope="col" { (metric.heading()) } }
                    th.n scope="col" { "Images" }
                    th.n scope="col" { "Pixels" }
                } }
                tbody {
                    @for at in &found {
                        tr {
                            th scope="row" { (at.model) }
                            td.n data-v=[at.group.distance_m().map(|ends| ends.0)] { (at.group) }
                            @for metric in Metric::ALL {
                                (figure(
                                    Some(at.summary.mean.get(metric)),
                                    at.summary.intervals.map(|all| all[metric as usize]),
                                ))
                            }
                            td.n data-v=(at.summary.images) { (at.summary.images) }
                            td.n data-v=(at.summary.pixels) { (at.summary.pixels) }
                        }
                    }
                }
            }
        };
        html! {
            h4 { (protocol) }
            (self.charts(&charts::of_distances(&found)))
            details { summary { "The figures behind the curves" } (scrolling(protocol, "Means over the images that have pixels at the distance.", &body)) }
        }
    }

    /// The distribution over images and the ends of it, under one protocol.
    fn images(&mut self, place: usize, set: &DataSet, protocol: &str) -> Markup {
        let models = by_model(&set.rows, protocol);
        let curves = charts::of_images(&set.rows, protocol);
        let (Some(models), Some(curves)) = (self.or_problem(models), self.or_problem(curves))
        else {
            return html! {};
        };
        let mut parts = Vec::new();
        let mut absent = false;
        for (number, model) in models.iter().enumerate() {
            let mut rows: Vec<&Row> = model.rows().to_vec();
            rows.sort_by(|a, b| {
                let error = |row: &Row| row.score.metrics.abs_rel;
                error(a).total_cmp(&error(b)).then(a.image.cmp(&b.image))
            });
            let best = EXTREMES.min(rows.len() / 2);
            let (first, last) = (&rows[..best], &rows[rows.len() - best.max(1)..]);
            let name = &model.context().model;
            let chosen: Vec<(&str, &Row)> = last
                .iter()
                .rev()
                .map(|row| ("worst", *row))
                .chain(first.iter().map(|row| ("best", *row)))
                .collect();
            let mut shown = Vec::new();
            for (word, row) in &chosen {
                shown.extend(
                    self.picture(set, name, row)
                        .map(|address| (*word, *row, address)),
                );
            }
            absent |= shown.len() < chosen.len();
            parts.push(html! {
                h4 id={ "images-" (place) "-" (number) } { (name) }
                @if !shown.is_empty() {
                    div.charts {
                        @for (word, row, address) in &shown {
                            figure {
                                img src=(address) loading="lazy" decoding="async"
                                    alt={ "Image " (row.image) ", prediction, ground truth and error" };
                                figcaption { (of_image(word, row)) }
                            }
                        }
                    }
                }
                @if shown.len() < chosen.len() {
                    ul {
                        @for (word, row) in &chosen {
                            @if !shown.iter().any(|(_, with, _)| with.image == row.image) {
                                li { (of_image(word, row)) }
                            }
                        }
                    }
                }
            });
        }
        html! {
            p {
                "By Abs Rel under " (protocol) ". Pictures: input above, ground truth below, on the left; \
                 predicted disparity above (bright is near) and relative depth error below (blue 0, red "
                (comparison::WORST_ERROR) " and more), on the right; grey was not measured."
            }
            @if absent {
                p.quiet {
                    "Pictures are shown where the run has made them: " code { "bench --extremes " (EXTREMES) } "."
                }
            }
            (self.charts(&[curves]))
            @for part in parts { (part) }
        }
    }

    /// The picture of an image as `data:` address, if one of the runs has made it and there is
    /// room for it.
    fn picture(&mut self, set: &DataSet, model: &str, row: &Row) -> Option<String> {
        let path = set.runs.iter().find_map(|run| {
            let own = run.record.as_ref()?.models.iter();
            let is_own = |record: &ModelRecord| {
                record.name == model && record.blake3 == row.context.model_hash
            };
            own.clone()
                .any(is_own)
                .then(|| comparison::picture_of(&run.folder, row))
                .flatten()
        })?;
        let large = image_files::read_rgb(&path);
        let large = self.or_problem(large)?;
        let width = PICTURE_WIDTH.min(large.width());
        let height = (large.height() * width)
            .div_ceil(large.width().max(1))
            .max(1);
        let small = resize::rgb(&large, width, height, Kernel::Area);
        let encoded = data_address(
            "jpeg",
            &image_files::encode_jpeg_rgb(&small, PICTURE_QUALITY),
        );
        if self.picture_bytes + encoded.len() > PICTURES_BYTES {
            return None;
        }
        self.picture_bytes += encoded.len();
        Some(encoded)
    }

    fn cues(&mut self, results: &CueResults) -> Markup {
        let found = summary::summarise(&results.rows, &Bootstrap::default());
        let verdicts = html! {
            table.sortable {
                thead { tr {
                    th scope="col" { "Model" } th scope="col" { "Cue" } th scope="col" { "Used?" }
                    th.n scope="col" { "Effect" } th.n scope="col" { "Threshold" }
                    th.n scope="col" { "Backgrounds" } th scope="col" { "Test" }
                } }
                tbody { @for line in found.lines() {
                    @let finding = line.finding;
                    tr {
                        th scope="row" { (finding.model) }
                        td { (line.label) }
                        td { strong { (line.uses.to_string()) } }
                        td.n data-v=[finding.effect] { (line.effect) }
                        td.n data-v=(finding.threshold) { (finding.threshold) }
                        td.n data-v=(finding.backgrounds) { (finding.backgrounds) }
                        td.wrap { (finding.test) }
                    }
                } }
            }
        };
        let mut models: Vec<&str> = Vec::new();
        for row in &results.rows {
            if !models.contains(&row.model.as_str()) {
                models.push(&row.model);
            }
        }
        let drawn: Vec<Markup> = models
            .iter()
            .flat_map(|model| curves::curves(model, &results.rows))
            .map(|(_, svg)| self.chart(&svg))
            .collect();
        html! {
            p.quiet { "From " code { (results.folder.display()) } }
            (scrolling("Depth cues", CUES, &verdicts))
            @for chart in drawn { div.wide tabindex="0" role="region" aria-label="Curves" { (chart) } }
        }
    }
}

fn of_image(word: &str, row: &Row) -> Markup {
    html! {
        strong { (word) } " " code { (row.image) }
        (format!(
            ": Abs Rel {:.3}, RMSE {:.3} m",
            row.score.metrics.abs_rel, row.score.metrics.rmse
        ))
    }
}

/// The rules that rows were measured by, as the run wrote them down or as this program knows
/// them under the same digest.
fn rules_of(set: &DataSet, name: &str) -> Option<Protocol> {
    let digest = set
        .rows
        .iter()
        .find(|row| row.context.protocol == name)
        .map(|row| row.context.protocol_digest.as_str())?;
    let written = set
        .runs
        .iter()
        .filter_map(|run| run.record.as_ref())
        .flat_map(|record| &record.protocols)
        .map(|record| record.rules.clone());
    written
        .chain(strat_metrics::protocol(name))
        .find(|protocol| protocol.name == name && protocol.digest() == digest)
}

fn latency(rows: &[LatencyRow]) -> Markup {
    let ms = |value: Option<f64>| {
        html! {
            @match value {
                Some(value) => td.n data-v=(value) { (format!("{value:.2}")) },
                None => td.n { "-" },
            }
        }
    };
    let body = html! {
        table.sortable {
            thead { tr {
                th scope="col" { "Model" } th.n scope="col" { "Threads" } th.n scope="col" { "Batch" }
                th scope="col" { "Stage" } th scope="col" { "Scenario" }
                @for heading in ["Mean", "p50", "p90", "p95", "p99", "Images/s"] {
                    th.n scope="col" { (heading) }
                }
                th scope="col" { "Runtime" } th scope="col" { "Provider" } th scope="col" { "Processor" }
            } }
            tbody { @for row in rows { tr {
                th scope="row" { (row.model) }
                td.n data-v=(row.threads) { (row.threads) }
                td.n data-v=(row.batch) { (row.batch) }
                td { (row.stage) }
                td { (row.scenario) }
                (ms(row.mean_ms)) (ms(row.p50_ms)) (ms(row.p90_ms)) (ms(row.p95_ms)) (ms(row.p99_ms))
                (ms(Some(row.images_per_second)))
                td { (row.runtime) }
                td { (row.provider) " (" (row.device) ")" }
                td { (row.processor) }
            } } }
        }
    };
    scrolling("Speed", SPEED, &body)
}

fn protocols(collected: &Collected) -> Markup {
    let mut known: Vec<Protocol> = Vec::new();
    for set in &collected.data_sets {
        for name in protocols_of(&set.rows) {
            let rules = rules_of(set, &name);
            known.extend(rules.filter(|rules| !known.contains(rules)));
        }
    }
    html! {
        @for protocol in &known {
            details {
                summary { strong { (protocol.name) } " (version " (protocol.version) ")" }
                p.quiet { "Digest " code { (protocol.digest()) } }
                ul { @for line in protocol.describe().lines() { li { (line) } } }
            }
        }
    }
}

fn provenance(collected: &Collected) -> Markup {
    let run = |run: &Run| {
        let record = run.record.as_ref();
        html! {
            h3 { code { (run.folder.display()) } }
            @match record {
                None => p.quiet { "No run.yaml lies beside the rows: what ran is not known beyond the rows." },
                Some(record) => {
                    dl {
                        dt { "Command" } dd { code { "bench " (record.arguments.join(" ")) } }
                        dt { "Version" } dd { (record.tool) " " (record.tool_version) }
                        dt { "Data" } dd {
                            (record.data.content) " (" (record.data.source) "), "
                            (record.data.test_images_found) " of " (record.data.test_images_expected)
                            " test images, prepared by " (record.data.prepared_by)
                        }
                        dt { "Digest of the data" } dd { code { (record.data.data_digest) } }
                        @if let Some(digest) = &record.data.split_digest {
                            dt { "Digest of the split" } dd { code { (digest) } }
                        }
                        dt { "Device" } dd { (record.device) }
                        dt { "Runtime" } dd { (record.runtime) }
                        dt { "Threads" } dd { (record.jobs) " for images, " (record.threads) " within the model" }
                    }
                    @for one in &record.models { (model(one)) }
                }
            }
        }
    };
    html! { @for set in &collected.data_sets { @for one in &set.runs { (run(one)) } } }
}

fn model(record: &ModelRecord) -> Markup {
    let file = record.file.as_deref().map(Path::display);
    html! {
        details {
            summary { "Model " strong { (record.name) } }
            dl {
                @if let Some(file) = file { dt { "File" } dd { code { (file) } } }
                dt { "BLAKE3" } dd { code { (record.blake3) } }
                @if let Some(count) = record.parameters { dt { "Weights" } dd { (count) } }
                dt { "Ran on" } dd { (record.provider) ", " (record.runtime) }
                @if let Some(difference) = record.probe_max_difference {
                    dt { "Difference to the trainer" } dd { (format!("{difference:.1e} of the image width, at most")) }
                }
                @if let Some(input) = record.description.as_ref().map(|both| &both.input) {
                    dt { "Input" } dd { (input.width) "x" (input.height) }
                }
                @if let Some(metadata) = &record.metadata {
                    @if let Some(variant) = &metadata.variant { dt { "Variant" } dd { (variant) } }
                    @if !metadata.train_drives.is_empty() {
                        dt { "Trained on" } dd { (metadata.train_drives.len()) " drives: " (metadata.train_drives.join(", ")) }
                    }
                }
                dt { "Images" } dd { (record.images) " in " (format!("{:.1}", record.seconds)) " s" }
                @if let Some(note) = &record.note { dt { "Note" } dd { (note) } }
            }
        }
    }
}
