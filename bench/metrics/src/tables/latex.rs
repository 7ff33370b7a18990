//! A [`Table`] in LaTeX: method and numbers, within the width of a page.
//!
//! It is a `table*`, which is as wide as both columns of a two-column paper and as the only one of an
//! article. Digests and notes are comments, works are cited by the keys of [`REFERENCES`].

use super::render::one_line;
use super::table::{Cell, Column, Line, Table, without_number};
use crate::published::Marker;

/// Entries for BibTeX of all works whose numbers stand in tables.
pub const REFERENCES: &str = include_str!("../../../published/references.bib");

/// Width of the text of an article of 10 pt, in points; what has more does not fit.
const PAGE: f64 = 345.0;

/// Space on both sides of a column, in points (`\tabcolsep`).
const SEPARATION: f64 = 3.0;

/// Least width of the methods' names; with less, numbers go into a second block.
const NARROWEST_NAMES: f64 = 70.0;

impl Table {
    /// A LaTeX table for `booktabs` and `xcolor`: the best numbers as `\best{}`, the second best as
    /// `\second{}`, later rows grey.
    pub fn latex(&self) -> String {
        let mut lines = vec![format!("% {}", one_line(&self.first_line))];
        for section in &self.sections {
            let mut comment = format!("% {} digest {}", section.protocol, section.protocol_digest);
            if !section.data_digest.is_empty() {
                comment += &format!("; data {}", section.data_digest);
            }
            lines.push(one_line(&comment));
        }
        lines.extend(
            self.notes
                .iter()
                .map(|note| format!("% {}", one_line(note))),
        );
        lines.extend(
            [
                "% Needs \\usepackage{booktabs} and \\usepackage{xcolor}. The keys of \\cite are in",
                "% table_references.bib: \\bibliography{table_references}",
                "\\providecommand{\\best}[1]{\\textbf{#1}}",
                "\\providecommand{\\second}[1]{\\underline{#1}}",
                "\\begin{table*}",
                "\\centering\\footnotesize",
            ]
            .map(str::to_owned),
        );
        lines.push(format!("\\setlength{{\\tabcolsep}}{{{SEPARATION}pt}}"));
        lines.push(format!("\\caption{{{}}}", self.caption()));
        lines.push(format!(
            "\\label{{tab:strat-{}}}",
            self.key().replace(['.', ' '], "-")
        ));
        let blocks = self.blocks();
        for (number, (names, block)) in blocks.iter().enumerate() {
            if number > 0 {
                lines.push("\\par\\medskip".to_owned());
            }
            self.tabular(*names, block, &mut lines);
        }
        lines.push("\\end{table*}".to_owned());
        lines.join("\n") + "\n"
    }

    fn caption(&self) -> String {
        let line = self.first_line.split("; ").next().unwrap_or_default();
        let line = line.split_once(", ").map_or(line, |(_, rest)| rest);
        let protocols: Vec<String> = self
            .sections
            .iter()
            .map(|section| format!("\\texttt{{{}}}", latex(&section.protocol)))
            .collect();
        let mut protocols = protocols;
        protocols.dedup();
        let mut caption = format!("{}; {}.", latex(line), protocols.join(", "));
        for remark in &self.remarks {
            caption += &format!(" {}.", latex(remark.trim_end_matches('.')));
        }
        let lines = || self.sections.iter().flat_map(|section| &section.lines);
        if lines().any(|line| line.cells.iter().any(|cell| cell.best)) {
            caption += " Bold: best, underlined: second best of the comparable rows.";
        }
        let cited = |line: &Line| line.cite.is_some();
        if lines().any(cited) || self.columns.iter().any(|column| column.published) {
            caption += " Cited rows are as published.";
        }
        let marked = |line: &Line| line.cells.iter().any(|cell| cell.marker.is_some());
        if lines().any(marked)
            && let Some(marks) = self.notes.iter().find(|note| note.starts_with("Marks:"))
        {
            caption += &format!(" {}", latex(marks));
        }
        caption
    }

    /// The columns of numbers that fit beside each other, each with its width left for names.
    fn blocks(&self) -> Vec<(f64, Vec<usize>)> {
        let mut blocks: Vec<(f64, Vec<usize>)> = vec![(PAGE - 2.0 * SEPARATION, Vec::new())];
        for (index, column) in self.columns.iter().enumerate() {
            let lines = || self.sections.iter().flat_map(|section| &section.lines);
            let has_numbers =
                lines().any(|line| line.cells.get(index).is_some_and(|c| c.text != "-"));
            if !column.numeric || !has_numbers {
                continue;
            }
            let cells = lines().filter_map(|line| line.cells.get(index));
            let widest = cells.map(number_points).fold(0.0, f64::max);
            let head = head_lines(column)
                .iter()
                .map(|line| points(line))
                .fold(0.0, f64::max);
            let own = widest.max(head) + 2.0 * SEPARATION;
            match blocks.last_mut() {
                Some((left, block)) if *left - own >= NARROWEST_NAMES || block.is_empty() => {
                    *left -= own;
                    block.push(index);
                }
                _ => blocks.push((PAGE - 2.0 * SEPARATION - own, vec![index])),
            }
        }
        blocks
    }

    fn tabular(&self, room: f64, block: &[usize], lines: &mut Vec<String>) {
        let all = || self.sections.iter().flat_map(|section| &section.lines);
        // A citation is printed as a number or a short name.
        let widest = all()
            .map(|line| points(name_of(line)) + if line.cite.is_some() { 18.0 } else { 0.0 })
            .fold(0.0, f64::max);
        let names = if widest <= room {
            "l".to_owned()
        } else {
            format!("p{{{:.0}pt}}", room.floor())
        };
        lines.push(format!(
            "\\begin{{tabular}}{{{names}{}}}",
            "r".repeat(block.len())
        ));
        lines.push("\\toprule".to_owned());
        let end = |cells: Vec<String>| format!("{} \\\\", cells.join(" & "));
        let first = self
            .columns
            .first()
            .map_or(String::new(), |one| latex(&one.heading));
        let heads = block.iter().map(|index| head(&self.columns[*index]));
        lines.push(end([first].into_iter().chain(heads).collect()));
        for section in &self.sections {
            lines.push("\\midrule".to_owned());
            if let Some(heading) = &section.heading {
                let width = block.len() + 1;
                let heading = latex(heading);
                lines.push(format!(
                    "\\multicolumn{{{width}}}{{l}}{{\\textit{{{heading}}}}} \\\\"
                ));
            }
            let mut before = None;
            for line in &section.lines {
                if before == Some(true) && !line.measured {
                    lines.push("\\addlinespace".to_owned());
                }
                before = Some(line.measured);
                let grey = |text: String| match line.grey {
                    true => format!("\\textcolor{{gray}}{{{text}}}"),
                    false => text,
                };
                let numbers = block.iter().filter_map(|index| line.cells.get(*index));
                let cells = numbers.map(|cell| grey(number(cell)));
                lines.push(end([grey(name(line))].into_iter().chain(cells).collect()));
            }
        }
        lines.push("\\bottomrule".to_owned());
        lines.push("\\end{tabular}".to_owned());
    }
}

/// The method as it is printed, whose reference is a citation where that has a key.
fn name_of(line: &Line) -> &str {
    let text = line.cells.first().map_or("", |cell| cell.text.as_str());
    match line.cite {
        Some(_) => without_number(text),
        None => text,
    }
}

fn name(line: &Line) -> String {
    let mark = match line.cells.first().and_then(|cell| cell.marker) {
        Some(Marker::Star) => "$^{*}$",
        Some(Marker::Dagger) => "$^{\\dagger}$",
        None => "",
    };
    let cite = line
        .cite
        .map_or(String::new(), |key| format!("~\\cite{{{key}}}"));
    // A long name of a file may go on in the next line.
    let name = latex(name_of(line)).replace("\\_", "\\_\\allowbreak{}");
    format!("{name}{mark}{cite}")
}

fn number(cell: &Cell) -> String {
    let text = latex(&cell.text);
    match (cell.best, cell.second) {
        (true, _) => format!("\\best{{{text}}}"),
        (false, true) => format!("\\second{{{text}}}"),
        (false, false) => text,
    }
}

/// Heading, broken between words, and unit with direction.
fn head_lines(column: &Column) -> Vec<String> {
    let name = column
        .heading
        .strip_suffix(" (published)")
        .or_else(|| column.heading.strip_suffix(" (measured)"))
        .unwrap_or(&column.heading);
    let name = match column.cite {
        Some(_) => without_number(name),
        None => name,
    };
    let mut lines: Vec<String> = Vec::new();
    for word in name.split(' ') {
        let fits = |line: &String| points(line) + points(word) < 32.0;
        match lines.last_mut().filter(|line| fits(line)) {
            Some(line) => *line += &format!(" {word}"),
            None => lines.push(word.to_owned()),
        }
    }
    lines.extend(Some(column.direction()).filter(|text| !text.is_empty()));
    lines
}

fn head(column: &Column) -> String {
    let mut lines: Vec<String> = head_lines(column).iter().map(|line| latex(line)).collect();
    if let Some(key) = column.cite {
        let at = lines.len().saturating_sub(1);
        lines.insert(at, format!("\\cite{{{key}}}"));
    }
    match lines.as_slice() {
        [one] => one.clone(),
        _ => format!("\\shortstack[r]{{{}}}", lines.join("\\\\")),
    }
}

/// Widths of the letters from space to tilde in Computer Modern of 8 pt (`cmr8.tfm`, and `cmmi8.tfm`
/// and `cmsy8.tfm` for those that [`latex`] takes from there), in hundredths of a point.
#[rustfmt::skip]
const WIDTHS: [u16; 95] = [
    283, 236, 425, 708, 425, 708, 661, 236, 331, 331, 425, 661, 236, 283, 236, 425,
    425, 425, 425, 425, 425, 425, 425, 425, 425, 425, 236, 236, 661, 661, 661, 401,
    661, 637, 602, 614, 649, 578, 554, 667, 637, 306, 436, 660, 531, 778, 637, 661,
    578, 661, 625, 472, 614, 637, 637, 873, 637, 637, 519, 236, 425, 236, 425, 306,
    236, 425, 472, 378, 472, 378, 260, 425, 472, 236, 260, 449, 236, 708, 472, 425,
    472, 449, 331, 335, 331, 472, 449, 614, 449, 449, 378, 425, 236, 425, 425,
];

/// Bold letters (`cmbx8.tfm`) are so much wider.
const BOLD: f64 = 1.155;

/// The width of a text in Computer Modern of 8 pt, in points; that of an em for letters that it lacks.
fn points(text: &str) -> f64 {
    let width = |letter: char| match letter {
        ' '..='~' => f64::from(WIDTHS[letter as usize - ' ' as usize]) / 100.0,
        'δ' | '†' => 3.8,
        '↓' | '↑' | '²' | '³' => 4.3,
        '±' => 6.7,
        _ => 8.5,
    };
    text.chars().map(width).sum()
}

/// The width of a number as [`number`] prints it.
fn number_points(cell: &Cell) -> f64 {
    points(&cell.text) * if cell.best { BOLD } else { 1.0 }
}

/// Text that LaTeX shows as it is.
pub(super) fn latex(text: &str) -> String {
    let mut escaped = String::new();
    for letter in one_line(text).chars() {
        match letter {
            '\\' => escaped.push_str("\\textbackslash{}"),
            '~' => escaped.push_str("\\textasciitilde{}"),
            '^' => escaped.push_str("\\textasciicircum{}"),
            '<' => escaped.push_str("$<$"),
            '>' => escaped.push_str("$>$"),
            '|' => escaped.push_str("\\textbar{}"),
            '†' => escaped.push_str("$\\dagger$"),
            'δ' => escaped.push_str("$\\delta$"),
            '±' => escaped.push_str("$\\pm$"),
            '↓' => escaped.push_str("$\\downarrow$"),
            '↑' => escaped.push_str("$\\uparrow$"),
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn latex_shows_names_as_they_are() {
        assert_eq!(latex("5 % & #1_a {b} $c"), r"5 \% \& \#1\_a \{b\} \$c");
        assert_eq!(
            latex(r"a\b~c^d"),
            r"a\textbackslash{}b\textasciitilde{}c\textasciicircum{}d"
        );
        assert_eq!(latex("[x] *"), "{[}x{]} {*}");
        assert_eq!(latex("δ<1.25²"), r"$\delta$$<$1.25$^2$");
    }

    #[test]
    fn every_key_that_is_cited_has_its_entry() {
        use crate::published;
        use crate::thesis::ThesisTable;
        let rows = ThesisTable::ALL.into_iter().flat_map(published::rows);
        for row in rows {
            let key = row
                .cite_key()
                .unwrap_or_else(|| panic!("{} has no key", row.method));
            assert!(REFERENCES.contains(&format!("{{{key},\n")), "{key}");
        }
    }
}
