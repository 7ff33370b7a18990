//! The four formats of a [`Table`]: terminal text, Markdown, LaTeX and CSV.

use comfy_table::{CellAlignment, TableStyle};

use super::table::{Cell, Table};
use crate::columns::CsvError;
use crate::published::Marker;
use crate::thesis::ThesisTable;

impl Table {
    /// Text for a terminal, without colour; the best figures stand in brackets.
    pub fn text(&self) -> String {
        let rule = comfy_table::LineStyle::none().fill('─').junction('─');
        let mut table = comfy_table::Table::new();
        table.load_style(
            TableStyle::new()
                .top_border(rule)
                .header_separator(rule)
                .bottom_border(rule),
        );
        table.set_header(self.columns.iter().map(|column| &column.heading));
        for (index, column) in self.columns.iter().enumerate() {
            let Some(cells) = table.column_mut(index) else {
                continue;
            };
            cells.set_padding((0, 1));
            if column.numeric {
                cells.set_cell_alignment(CellAlignment::Right);
            }
        }
        for (index, section) in self.sections.iter().enumerate() {
            if let Some(heading) = &section.heading {
                if index > 0 {
                    table.add_row(self.columns.iter().map(|_| ""));
                }
                table.add_row(first_of(self.columns.len(), heading));
            }
            for line in &section.lines {
                table.add_row(line.cells.iter().map(|cell| {
                    let text = one_line(&cell.text);
                    match cell.marker {
                        _ if cell.best => format!("[{text}]"),
                        None => text,
                        Some(Marker::Star) => text + " *",
                        Some(Marker::Dagger) => text + " †",
                    }
                }));
            }
        }
        let mut lines = vec![one_line(&self.first_line)];
        lines.extend(self.remarks.iter().map(|remark| one_line(remark)));
        lines.push(table.trim_fmt());
        lines.push(self.best_note("Brackets"));
        lines.extend(self.notes.iter().map(|note| one_line(note)));
        lines.join("\n") + "\n"
    }

    /// A Markdown section with a pipe table; the best figures are bold.
    pub fn markdown(&self) -> String {
        let mut lines = vec![format!("### {}", markdown(&self.first_line)), String::new()];
        for remark in &self.remarks {
            lines.extend([format!("**{}**", markdown(remark)), String::new()]);
        }
        let pipes = |cells: Vec<String>| format!("| {} |", cells.join(" | "));
        let headings = self.columns.iter().map(|column| markdown(&column.heading));
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

    /// A LaTeX table for `booktabs` and `xcolor`; the best figures are bold, later rows grey.
    pub fn latex(&self) -> String {
        let mut lines = vec![
            format!("% {}", one_line(&self.first_line)),
            "% needs \\usepackage{booktabs} and \\usepackage{xcolor}".to_owned(),
            "\\begin{table}".to_owned(),
            "\\centering".to_owned(),
        ];
        let mut caption = latex(&self.first_line);
        for remark in &self.remarks {
            caption += &format!(". {}", latex(remark.trim_end_matches('.')));
        }
        lines.push(format!("\\caption{{{caption}.}}"));
        lines.push(format!(
            "\\label{{tab:strat-{}}}",
            self.key().replace(['.', ' '], "-")
        ));
        let layout: String = self
            .columns
            .iter()
            .map(|column| if column.numeric { 'r' } else { 'l' })
            .collect();
        lines.push(format!("\\begin{{tabular}}{{{layout}}}"));
        lines.push("\\toprule".to_owned());
        let end = |cells: Vec<String>| format!("{} \\\\", cells.join(" & "));
        let headings = self.columns.iter().map(|column| {
            column
                .latex
                .map_or_else(|| latex(&column.heading), str::to_owned)
        });
        lines.push(end(headings.collect()));
        for section in &self.sections {
            lines.push("\\midrule".to_owned());
            if let Some(heading) = &section.heading {
                let width = self.columns.len();
                let heading = latex(heading);
                lines.push(format!(
                    "\\multicolumn{{{width}}}{{l}}{{\\textit{{{heading}}}}} \\\\"
                ));
            }
            for line in &section.lines {
                let cells = line.cells.iter().map(|cell| {
                    let text = latex_cell(cell);
                    if line.grey {
                        format!("\\textcolor{{gray}}{{{text}}}")
                    } else {
                        text
                    }
                });
                lines.push(end(cells.collect()));
            }
        }
        lines.push("\\bottomrule".to_owned());
        lines.push("\\end{tabular}".to_owned());
        lines.push("\\begin{minipage}{\\linewidth}\\footnotesize".to_owned());
        lines.push(format!("{}\\par", self.best_note("Bold")));
        lines.extend(
            self.notes
                .iter()
                .map(|note| format!("{}\\par", latex(note))),
        );
        lines.push("\\end{minipage}".to_owned());
        lines.push("\\end{table}".to_owned());
        lines.join("\n") + "\n"
    }

    /// Name of the table in CSV files and labels.
    fn key(&self) -> String {
        let ablation = if self.ablation { " ablation" } else { "" };
        format!("{}{ablation}", self.id)
    }

    fn best_note(&self, mark: &str) -> String {
        if self.ablation {
            return format!(
                "{mark}: best mean of its column, to three decimals. Which variants differ is said by the \
                 tests of their differences, not by this mark."
            );
        }
        let printed = match self.id {
            ThesisTable::Eigen652 => "printed in the works cited below",
            _ => "those printed in the thesis",
        };
        format!(
            "{mark}: best of the comparable rows, to three decimals. Figures marked published are \
             {printed} and were not measured here."
        )
    }

    /// CSV with exact figures and, on each line, what the heading says in the other formats.
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

fn one_line(text: &str) -> String {
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

/// Text that LaTeX shows as it is.
fn latex(text: &str) -> String {
    let mut escaped = String::new();
    for letter in one_line(text).chars() {
        match letter {
            '\\' => escaped.push_str("\\textbackslash{}"),
            '~' => escaped.push_str("\\textasciitilde{}"),
            '^' => escaped.push_str("\\textasciicircum{}"),
            '<' => escaped.push_str("\\textless{}"),
            '>' => escaped.push_str("\\textgreater{}"),
            '|' => escaped.push_str("\\textbar{}"),
            '†' => escaped.push_str("$\\dagger$"),
            'δ' => escaped.push_str("$\\delta$"),
            '±' => escaped.push_str("$\\pm$"),
            '²' => escaped.push_str("$^2$"),
            '³' => escaped.push_str("$^3$"),
            '&' | '%' | '$' | '#' | '_' | '{' | '}' => escaped.extend(['\\', letter]),
            // After the end of a line these would be read as its options.
            '[' | ']' | '*' => escaped.extend(['{', letter, '}']),
            letter => escaped.push(letter),
        }
    }
    escaped
}

fn latex_cell(cell: &Cell) -> String {
    let text = latex(&cell.text);
    match cell.marker {
        _ if cell.best => format!("\\textbf{{{text}}}"),
        None => text,
        Some(Marker::Star) => text + "$^{*}$",
        Some(Marker::Dagger) => text + "$^{\\dagger}$",
    }
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

    #[test]
    fn latex_shows_names_as_they_are() {
        assert_eq!(latex("5 % & #1_a {b} $c"), r"5 \% \& \#1\_a \{b\} \$c");
        assert_eq!(
            latex(r"a\b~c^d"),
            r"a\textbackslash{}b\textasciitilde{}c\textasciicircum{}d"
        );
        assert_eq!(latex("[x] *"), "{[}x{]} {*}");
        assert_eq!(latex("δ<1.25²"), r"$\delta$\textless{}1.25$^2$");
    }
}
