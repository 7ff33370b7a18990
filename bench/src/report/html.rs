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

/// A figure with its interval below.
pub(super) fn figure(value: Option<f64>, interval: Option<Interval>) -> Markup {
    html! {
        @match value {
            Some(value) => td.n data-v=(value) { (format!("{value:.3}")) (interval_text(interval)) },
            None => td.n { "-" },
        }
    }
}

pub(super) fn thesis_table(table: &Table) -> Markup {
    let cell = |index: usize, cell: &Cell| {
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
                @for (index, one) in line.cells.iter().enumerate() { (cell(index, one)) }
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
