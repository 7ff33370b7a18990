//! What was measured on one prepared set: tables, further protocols, distances.

use maud::{Markup, html};
use strat_metrics::{
    Alignment, Grouping, Metric, ProtocolName, Suffix, leaderboard,
    tables::{self, ThesisTable},
};

use super::{
    builder::Page,
    charts,
    collect::DataSet,
    html::{entries_table, figure, scrolling, thesis_table, warning},
    origin::rules_of,
};
use crate::rows::compare::protocols_of;

impl Page {
    /// A set with its rows. Where they are `of_study`, its seeds are no rivals of each other.
    pub(super) fn data_set(&mut self, index: usize, set: &DataSet, of_study: bool) -> Markup {
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
        // Models of unknown scale are aligned under it.
        let aligned: Vec<String> = Alignment::ALL
            .into_iter()
            .filter_map(|alignment| {
                let suffix = Suffix::of_alignment(alignment)?;
                Some(ProtocolName::parse(first?).with(suffix).to_string())
            })
            .collect();
        let scaled = names
            .iter()
            .filter(|name| Some(*name) != first && aligned.contains(name));
        let ranked: Vec<&String> = first.into_iter().chain(scaled).collect();
        html! {
            @if !warnings.is_empty() { (warning("What was warned about during the runs:", &warnings)) }
            @if of_study {
                p { "Variants are compared under " a href="#study" { "Study" } "; here are their seeds." }
            } @else {
                @for name in &ranked { (self.verdict(&set.rows, name)) }
            }
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
            @if !ranked.is_empty() { h3 { "Best and worst images" } }
            @for name in &ranked { (self.images(index, set, name)) }
        }
    }

    fn tables(&mut self, set: &DataSet, names: &[String]) -> Markup {
        let mut parts = Vec::new();
        for id in ThesisTable::ALL {
            for alignment in Alignment::ALL {
                let own = id.protocols_at(alignment);
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
                        @match alignment {
                            Alignment::None => {}
                            Alignment::Median => { ", scaled by medians" }
                            alignment => { ", aligned: " (alignment) }
                        }
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
                            td.n data-v=[at.group.distance_m().map(|bounds| bounds.0)] { (at.group) }
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
            details { summary { "Data for these curves" } (scrolling(protocol, "Means over the images that have pixels at the distance.", &body)) }
        }
    }
}
