//! `bench leaderboard show`: a leaderboard file for a terminal, protocol by protocol, best mean first.

use comfy_table::{CellAlignment, LineStyle, Table, TableStyle};
use strat_metrics::leaderboard::{Entry, Origin};
use strat_metrics::{Metric, protocol};

use crate::section::first_metric;

/// The lines of a file as text. Lines say nothing of images, so their order is no rank.
#[must_use]
pub fn text(entries: &[Entry]) -> String {
    let mut sorted: Vec<&Entry> = entries.iter().collect();
    let key = |entry: &Entry| (entry.protocol.clone(), entry.group);
    sorted.sort_by_key(|entry| key(entry));
    let mut text = String::new();
    for lines in sorted.chunk_by(|a, b| key(a) == key(b)) {
        text += &block(lines);
        text.push('\n');
    }
    text + "Sorted by mean, best first. Whether two methods differ is said by `bench compare` on their rows.\n"
}

fn block(lines: &[&Entry]) -> String {
    let Some(first) = lines.first() else {
        return String::new();
    };
    let metric = protocol(&first.protocol).map_or(Metric::AbsRel, |rules| first_metric(&rules));
    let mut lines = lines.to_vec();
    let value = |entry: &Entry| entry.metrics[metric as usize].unwrap_or(f64::INFINITY);
    lines.sort_by(|a, b| {
        value(a)
            .total_cmp(&value(b))
            .then_with(|| a.method.cmp(&b.method))
    });
    let group = first
        .group
        .map_or(String::new(), |group| format!(", {group}"));
    let rule = LineStyle::none().fill('─').junction('─');
    let mut table = Table::new();
    table.load_style(
        TableStyle::new()
            .top_border(rule)
            .header_separator(rule)
            .bottom_border(rule),
    );
    let metrics = Metric::ALL.map(|metric| metric.heading().to_owned());
    let header = ["Method", "Origin", "Images"]
        .map(str::to_owned)
        .into_iter()
        .chain(metrics);
    table.set_header(header);
    for index in 0..3 + Metric::ALL.len() {
        if let Some(column) = table.column_mut(index) {
            column.set_padding((0, 1));
            if index > 1 {
                column.set_cell_alignment(CellAlignment::Right);
            }
        }
    }
    for entry in &lines {
        let images = match (entry.origin, entry.images, entry.expected_images) {
            (Origin::Measured, Some(images), Some(expected)) => format!("{images}/{expected}"),
            _ => "-".to_owned(),
        };
        let numbers = entry
            .metrics
            .map(|value| value.map_or("-".to_owned(), |value| format!("{value:.3}")));
        let words = [plain(&entry.method), entry.origin.to_string(), images];
        table.add_row(words.into_iter().chain(numbers));
    }
    format!("{}{group}\n{}\n", plain(&first.protocol), table.trim_fmt())
}

/// A stranger's text on a terminal.
fn plain(text: &str) -> String {
    text.chars().filter(|c| !c.is_control()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_sorted_protocol_by_protocol() {
        let shown = text(&strat_metrics::leaderboard::published());
        let at = |words: &str| {
            shown
                .find(words)
                .unwrap_or_else(|| panic!("{words} is not in {shown}"))
        };
        assert!(at("\neigen-80\n") < at("\nkitti2015\n"));
        let own = &shown[at("\nkitti2015\n")..];
        assert!(own.find("Ours - StrAT") < own.find("Godard"), "{own}");
        assert!(shown.contains("semantic, flat\n") && shown.contains("published"));
    }
}
