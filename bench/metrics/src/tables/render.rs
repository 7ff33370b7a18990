//! A [`Table`] in Markdown and CSV, and what all formats say.

use super::table::Table;
use crate::columns::CsvError;
use crate::published::Marker;
use crate::thesis::ThesisTable;

impl Table {
    /// A Markdown section with a pipe table; the best numbers are bold.
    pub fn markdown(&self) -> String {
        let mut lines = vec![format!("### {}", markdown(&self.first_line)), String::new()];
        for remark in &self.remarks {
            lines.extend([format!("**{}**", markdown(remark)), String::new()]);
        }
        let pipes = |cells: Vec<String>| format!("| {} |", cells.join(" | "));
        let headings = self.columns.iter().map(|column| markdown(&column.head()));
        lines.push(pipes(headings.collect()));
        let rules = self
            .columns
            .iter()
            .map(|column| if column.numeric { "---:" } else { "---" }.to_owned());
        lines.push(pipes(rules.collect()));
        for section in &self.sections {
            if let Some(heading) = &section.heading {
                let heading = format!("**{}**", markdown(heading));
                lines.push(pipes(first_of(self.columns.len(), &heading)));
            }
            for line in &section.lines {
                let cells = line.cells.iter().map(|cell| {
                    let text = markdown(&cell.text);
                    match cell.marker {
                        _ if cell.best => format!("**{text}**"),
                        None => text,
                        Some(Marker::Star) => text + r" \*",
                        Some(Marker::Dagger) => text + " †",
                    }
                });
                lines.push(pipes(cells.collect()));
            }
        }
        lines.extend([String::new(), format!("- {}", self.best_note("Bold"))]);
        lines.extend(
            self.notes
                .iter()
                .map(|note| format!("- {}", markdown(note))),
        );
        lines.join("\n") + "\n"
    }

    /// Name of the table in CSV files and labels.
    pub(super) fn key(&self) -> String {
        let ablation = if self.ablation { " ablation" } else { "" };
        format!("{}{ablation}", self.id)
    }

    pub(super) fn best_note(&self, mark: &str) -> String {
        if self.ablation {
            return format!(
                "{mark}: best mean of its column, to three decimals. Which variants differ is said by the \
                 tests of their differences, not by this mark."
            );
        }
        let printed = match self.id {
            ThesisTable::Eigen652 => "printed in the works cited below",
            _ if self.has_further => "those printed in the thesis or in the works named below",
            _ => "those printed in the thesis",
        };
        format!(
            "{mark}: best of the comparable rows, to three decimals. Numbers marked published are \
             {printed} and were not measured here."
        )
    }

    /// CSV with exact numbers and, on each line, what the heading says in the other formats.
    ///
    /// # Errors
    /// None in practice; the CSV writer's own.
    pub fn csv(&self) -> Result<String, CsvError> {
        let mut csv = strat_csv::Writer::new(Vec::new());
        let mut header = vec!["table", "section"];
        header.extend(self.columns.iter().map(|column| column.key.as_str()));
        header.extend([
            "grey",
            "protocol",
            "protocol_digest",
            "data_digest",
            "expected_images",
        ]);
        csv.write_record(header)?;
        for section in &self.sections {
            for line in &section.lines {
                let mut record = vec![self.key(), section.heading.clone().unwrap_or_default()];
                record.extend(line.cells.iter().map(|cell| match cell.value {
                    Some(value) => value.to_string(),
                    None if cell.text == "-" => String::new(),
                    None => cell.text.clone(),
                }));
                let measured = |text: String| if line.measured { text } else { String::new() };
                record.extend([
                    line.grey.to_string(),
                    section.protocol.clone(),
                    measured(section.protocol_digest.clone()),
                    measured(section.data_digest.clone()),
                    measured(section.expected_images.to_string()),
                ]);
                csv.write_record(record)?;
            }
        }
        let bytes = csv.into_inner()?;
        // Only strings went in.
        Ok(String::from_utf8_lossy(&bytes).into_owned())
    }
}

/// A line whose first cell has a text.
fn first_of(columns: usize, text: &str) -> Vec<String> {
    let mut cells = vec![String::new(); columns];
    if let Some(first) = cells.first_mut() {
        text.clone_into(first);
    }
    cells
}

pub(super) fn one_line(text: &str) -> String {
    let clean = text.chars().map(|c| if c.is_control() { ' ' } else { c });
    clean.collect()
}

/// Text that Markdown shows as it is, also inside a table.
fn markdown(text: &str) -> String {
    let mut escaped = String::new();
    let mut letters = one_line(text)
        .chars()
        .collect::<Vec<_>>()
        .into_iter()
        .peekable();
    while let Some(letter) = letters.next() {
        match letter {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '\\' | '|' | '*' | '_' | '`' | '~' | '$' => escaped.extend(['\\', letter]),
            // A bracket alone is a bracket; one before a target would make a link.
            ']' if matches!(letters.peek(), Some('(' | '[' | ':')) => escaped.push_str("\\]"),
            letter => escaped.push(letter),
        }
    }
    escaped
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn markdown_shows_names_as_they_are() {
        assert_eq!(markdown("a|b_c*d`e~$f\\g"), r"a\|b\_c\*d\`e\~\$f\\g");
        assert_eq!(markdown("<b>&amp;"), "&lt;b>&amp;amp;");
        // A reference stays readable, a link does not become one.
        assert_eq!(markdown("Godard [21]"), "Godard [21]");
        assert_eq!(markdown("[a](b) [c][d]"), r"[a\](b) [c\][d]");
        assert_eq!(markdown("two\nlines\t"), "two lines ");
    }
}
