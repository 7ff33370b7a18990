//! Pieces of HTML that several sections share.

use maud::{Markup, html};
use strat_leaderboard::web::interval_text;
pub(super) use strat_leaderboard::web::{scrolling, warning};
use strat_metrics::{
    FurtherMetric, Metric,
    leaderboard::Entry,
    published::Marker,
    statistics::Interval,
    tables::{Cell, Line, Table, ThesisTable},
};

/// A number with its interval below.
pub(super) fn figure(value: Option<f64>, interval: Option<Interval>) -> Markup {
    html! {
        @match value {
            Some(value) => td.n data-v=(value) { (format!("{value:.3}")) (interval_text(interval)) },
            None => td.n { "-" },
        }
    }
}

/// Columns whose words stand below the method's name, so that the numbers have room.
const BESIDE_NAMES: [&str; 3] = ["origin", "supervision", "images"];

pub(super) fn thesis_table(table: &Table) -> Markup {
    let below = |line: &Line| {
        let cells = table.columns().iter().zip(&line.cells);
        let cells = cells.filter(|(column, _)| BESIDE_NAMES.contains(&column.key.as_str()));
        let words = cells
            .filter(|(_, cell)| cell.text != "-")
            .map(|(column, cell)| match column.key.as_str() {
                "images" => format!("{} images", cell.text),
                _ => cell.text.clone(),
            });
        words.collect::<Vec<_>>().join(", ")
    };
    let is_shown = |index: usize| {
        let column = table.columns().get(index);
        !column.is_some_and(|column| BESIDE_NAMES.contains(&column.key.as_str()))
    };
    let columns = (0..table.columns().len())
        .filter(|index| is_shown(*index))
        .count();
    let cell = |index: usize, cell: &Cell, below: &str| {
        let mark = match cell.marker {
            Some(Marker::Star) => " *",
            Some(Marker::Dagger) => " †",
            None => "",
        };
        let numeric = table
            .columns()
            .get(index)
            .is_some_and(|column| column.numeric);
        html! {
            @if index == 0 {
                th scope="row" {
                    (cell.text) (mark)
                    @if !below.is_empty() { small { (below) } }
                }
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
                @for (index, one) in line.cells.iter().enumerate() {
                    @if is_shown(index) { (cell(index, one, &below(line))) }
                }
            }
        }
    };
    let body = html! {
        table.sortable {
            thead { tr {
                @for (index, column) in table.columns().iter().enumerate() {
                    @if is_shown(index) { th.n[column.numeric] scope="col" { (column.head()) } }
                }
            } }
            @for section in table.sections() {
                tbody {
                    @if let Some(heading) = &section.heading {
                        tr { th.part colspan=(columns) scope="colgroup" { (heading) } }
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
            &format!(
                "{}. Bold: best among comparable lines.{}",
                table.first_line(),
                table.resampled().map_or(String::new(), |unit| format!(" Below numbers: 95 % intervals over {unit}."))
            ),
            &body,
        ))
        details {
            summary { "Notes to the table" }
            ul.notes { @for note in table.notes() { li { (note) } } }
        }
    }
}

/// Lines of a leaderboard under protocols that no table is about.
pub(super) fn entries_table(entries: &[Entry]) -> Markup {
    let has_further = entries.iter().any(|entry| entry.further != [None; 5]);
    let body = html! {
        table.sortable {
            thead { tr {
                th scope="col" { "Method" }
                th scope="col" { "Protocol" }
                th.n scope="col" { "Images" }
                @for metric in Metric::ALL { th.n scope="col" { (metric.heading()) } }
                th.n scope="col" { "D1-all" }
                @if has_further {
                    @for metric in FurtherMetric::ALL { th.n scope="col" { (metric.heading()) } }
                }
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
                        @if has_further {
                            @for (value, interval) in entry.further.iter().zip(entry.further_intervals) {
                                (figure(*value, interval))
                            }
                        }
                    }
                }
            }
        }
    };
    scrolling("Further protocols", "", &body)
}
