//! A [`Table`] as text that fits a terminal.
//!
//! Names of methods and their numbers stand in columns; below a measured number is half the width of its 95 %
//! interval. What does not fit beside each other stands below each other, each block with the names again.
//! Origin, supervision and counts are in the other formats.

use unicode_width::UnicodeWidthStr as _;

use super::render::one_line;
use super::table::{Cell, Column, Line, Section, Table};
use crate::published::Marker;

/// Columns of text in a file, and where nobody knows how wide the reader's terminal is.
pub const FILE_WIDTH: usize = 100;

/// Fewest columns that names get before numbers go into another block.
const NARROWEST_NAMES: usize = 16;

/// Space between columns.
const GAP: usize = 2;

/// The lines of text in one cell.
type Lines = Vec<String>;

impl Table {
    /// Text without colour, for a file: the best numbers stand in brackets, the notes below.
    pub fn text(&self) -> String {
        let mut lines = vec![one_line(&self.first_line)];
        lines.extend(self.remarks.iter().map(|remark| one_line(remark)));
        self.body(FILE_WIDTH, &mut lines);
        lines.push(self.best_note("Brackets"));
        lines.extend(self.notes.iter().map(|note| one_line(note)));
        lines.join("\n") + "\n"
    }

    /// Text for a terminal of so many columns, without the notes.
    pub fn terminal(&self, width: usize) -> String {
        let width = width.max(40);
        let mut lines = wrapped(&one_line(&self.first_line), width);
        for remark in &self.remarks {
            lines.extend(wrapped(&one_line(remark), width));
        }
        self.body(width, &mut lines);
        lines.join("\n") + "\n"
    }

    fn body(&self, width: usize, lines: &mut Vec<String>) {
        let shown = self.shown_columns();
        let names = self.names_width();
        let widths: Vec<usize> = shown.iter().map(|index| self.width_of(*index)).collect();
        let mut blocks: Vec<Vec<usize>> = vec![Vec::new()];
        let mut used = 0;
        for (place, own) in widths.iter().enumerate() {
            let own = own + GAP;
            let room = width.saturating_sub(names.min(NARROWEST_NAMES));
            if used + own > room && used > 0 {
                blocks.push(Vec::new());
                used = 0;
            }
            used += own;
            if let Some(block) = blocks.last_mut() {
                block.push(place);
            }
        }
        for block in blocks {
            let numbers: usize = block.iter().map(|place| widths[*place] + GAP).sum();
            let names = names.min(width.saturating_sub(numbers)).max(8);
            let columns: Vec<(usize, usize)> = block
                .iter()
                .map(|place| (shown[*place], widths[*place]))
                .collect();
            self.block(names, &columns, lines);
        }
        let cells = self.all_cells();
        let cells: Vec<&Cell> = cells.collect();
        let mut legend = Vec::new();
        if cells.iter().any(|cell| cell.interval.is_some()) {
            let unit = self.resampled.as_deref().unwrap_or("drives");
            legend.push(format!("± half of the 95 % interval over {unit}"));
        }
        if cells.iter().any(|cell| cell.text.contains(" ± ")) {
            legend.push("± of seeds: their standard deviation".to_owned());
        }
        if !legend.is_empty() {
            lines.push(legend.join("; "));
        }
    }

    /// The columns of numbers that have any.
    fn shown_columns(&self) -> Vec<usize> {
        let columns = self.columns.iter().enumerate();
        let numeric = columns.filter(|(_, column)| column.numeric);
        let has_numbers = |index: usize| {
            let mut lines = self.sections.iter().flat_map(|section| &section.lines);
            lines.any(|line| line.cells.get(index).is_some_and(|cell| cell.text != "-"))
        };
        numeric
            .map(|(index, _)| index)
            .filter(|index| has_numbers(*index))
            .collect()
    }

    fn all_cells(&self) -> impl Iterator<Item = &Cell> {
        let lines = self.sections.iter().flat_map(|section| &section.lines);
        lines.flat_map(|line| &line.cells)
    }

    fn names_width(&self) -> usize {
        let lines = self.sections.iter().flat_map(|section| &section.lines);
        let head = self
            .columns
            .first()
            .map_or(0, |column| column.heading.width());
        lines
            .map(|line| name_of(line).width())
            .fold(head, usize::max)
    }

    fn width_of(&self, index: usize) -> usize {
        let lines = self.sections.iter().flat_map(|section| &section.lines);
        let cells = lines.filter_map(|line| line.cells.get(index));
        let head = self.columns.get(index).map(head_of).unwrap_or_default();
        let texts = cells.flat_map(|cell| number_of(cell, true)).chain(head);
        texts.map(|text| text.width()).max().unwrap_or(0)
    }

    fn block(&self, names: usize, columns: &[(usize, usize)], lines: &mut Vec<String>) {
        let numbers: usize = columns.iter().map(|(_, width)| width + GAP).sum();
        let rule = "─".repeat(names + numbers);
        let pour = |first: Lines, cells: Vec<Lines>, lines: &mut Vec<String>| {
            let height = cells
                .iter()
                .chain([&first])
                .map(Vec::len)
                .max()
                .unwrap_or(0);
            for row in 0..height {
                let mut text = first.get(row).cloned().unwrap_or_default();
                let pad = |text: &str, width: usize| " ".repeat(width.saturating_sub(text.width()));
                text += &pad(&text, names);
                for (cell, (_, width)) in cells.iter().zip(columns) {
                    let own = cell.get(row).map_or("", String::as_str);
                    text += &format!("{}{}{own}", " ".repeat(GAP), pad(own, *width));
                }
                lines.push(text.trim_end().to_owned());
            }
        };
        lines.push(rule.clone());
        let head = self
            .columns
            .first()
            .map_or(String::new(), |one| one.heading.clone());
        let heads = columns
            .iter()
            .map(|(index, _)| head_of(&self.columns[*index]));
        pour(vec![head], heads.collect(), lines);
        lines.push(rule.clone());
        for (number, section) in self.sections.iter().enumerate() {
            if let Some(heading) = &section.heading {
                if number > 0 {
                    lines.push(String::new());
                }
                lines.push(one_line(heading));
            }
            let mut before = None;
            for line in &section.lines {
                if before == Some(true) && !line.measured && self.has_origins(section) {
                    lines.push("published, not measured here:".to_owned());
                }
                before = Some(line.measured);
                let cells = columns.iter().map(|(index, _)| {
                    let cell = line.cells.get(*index);
                    cell.map(|cell| number_of(cell, line.measured))
                        .unwrap_or_default()
                });
                pour(wrapped(&name_of(line), names), cells.collect(), lines);
            }
        }
        lines.push(rule);
    }

    /// Lines are either measured or published; those of table 3.2 are both.
    fn has_origins(&self, section: &Section) -> bool {
        section.lines.iter().any(|line| !line.measured)
    }
}

/// Name with its marks.
fn name_of(line: &Line) -> String {
    let Some(cell) = line.cells.first() else {
        return String::new();
    };
    let mark = match cell.marker {
        Some(Marker::Star) => " *",
        Some(Marker::Dagger) => " †",
        None => "",
    };
    let later = if line.grey { " (later)" } else { "" };
    format!("{}{mark}{later}", one_line(&cell.text))
}

/// A number and what is known of its uncertainty.
fn number_of(cell: &Cell, measured: bool) -> Lines {
    let text = one_line(&cell.text);
    let (number, spread) = match text.split_once(" ± ") {
        Some((number, spread)) => (number.to_owned(), Some(spread.to_owned())),
        None => (text, None),
    };
    let half = cell.interval.filter(|_| measured);
    let half = half.map(|bounds| format!("{:.3}", (bounds.high - bounds.low) / 2.0));
    let number = if cell.best {
        format!("[{number}]")
    } else {
        number
    };
    let below = spread.or(half).map(|half| format!("±{half}"));
    [Some(number), below].into_iter().flatten().collect()
}

/// A heading of at most twelve columns in several lines, unit and direction in the last.
fn head_of(column: &Column) -> Lines {
    let mut lines = wrapped(&one_line(&column.heading), 12);
    lines.extend(Some(column.direction()).filter(|text| !text.is_empty()));
    lines
}

/// Lines of at most so many columns, broken between words where that is possible.
fn wrapped(text: &str, width: usize) -> Lines {
    let mut lines: Lines = Vec::new();
    for word in text.split(' ') {
        let fits = lines
            .last()
            .is_some_and(|line| line.width() + 1 + word.width() <= width);
        match lines.last_mut().filter(|_| fits) {
            Some(line) => *line += &format!(" {word}"),
            None => lines.push(word.to_owned()),
        }
        while let Some(line) = lines.last_mut().filter(|line| line.width() > width) {
            let mut kept = String::new();
            let mut rest = String::new();
            for letter in line.chars() {
                let own = unicode_width::UnicodeWidthChar::width(letter).unwrap_or(0);
                if rest.is_empty() && (kept.is_empty() || kept.width() + own <= width) {
                    kept.push(letter);
                } else {
                    rest.push(letter);
                }
            }
            *line = kept;
            if rest.is_empty() {
                break;
            }
            lines.push(rest);
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_kept_whole_where_they_fit() {
        assert_eq!(
            wrapped("Median depth (constant)", 12),
            ["Median depth", "(constant)"]
        );
        assert_eq!(wrapped("abcdefghij k", 4), ["abcd", "efgh", "ij k"]);
        // Wide letters take two columns.
        assert_eq!(wrapped("深度深度", 4), ["深度", "深度"]);
    }
}
