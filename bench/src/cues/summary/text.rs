//! The summary as text for a terminal and as Markdown.

use std::fmt::Write as _;

use super::{
    finding::{Finding, Summary, Word},
    series::distinct,
};

/// A line of a table of words: one finding, or those of neighbouring sizes with the same word.
#[derive(Clone, Debug, PartialEq)]
pub struct Line<'a> {
    /// The first of them.
    pub finding: &'a Finding,
    /// The word of all.
    pub uses: Word,
    /// The cue and what it is about, such as `occlusion of familiar objects: car, 40 to 93 px`.
    pub label: String,
    /// The effect with its interval, or the smallest and the largest of several.
    pub effect: String,
}

impl Summary {
    /// The words as lines of a table; neighbouring sizes with the same word share one.
    #[must_use]
    pub fn lines(&self) -> Vec<Line<'_>> {
        self.findings
            .chunk_by(|a, b| {
                let key = |finding: &Finding| {
                    (
                        finding.model.clone(),
                        finding.cue,
                        finding.object.clone(),
                        finding.uses,
                    )
                };
                a.height_px.is_some() && b.height_px.is_some() && key(a) == key(b)
            })
            .filter_map(line)
            .collect()
    }

    /// The words as text for a terminal.
    #[must_use]
    pub fn text(&self) -> String {
        let lines = self.lines();
        let width = lines
            .iter()
            .map(|line| line.label.chars().count())
            .max()
            .unwrap_or(0);
        let words = lines
            .iter()
            .map(|line| line.uses.to_string().len())
            .max()
            .unwrap_or(0);
        let mut out = String::new();
        for model in distinct(lines.iter().map(|line| line.finding.model.as_str())) {
            let _ = writeln!(out, "{model}");
            for line in lines.iter().filter(|line| line.finding.model == model) {
                let (label, word) = (&line.label, line.uses.to_string());
                let _ = writeln!(out, "  {label:<width$}  {word:<words$}  {}", line.effect);
            }
        }
        out += "\nbehind each word its effect with the 95 % interval, or the range of the effects of \
                several sizes; summary.md states the tests\n";
        out
    }

    /// Words and statistics as Markdown.
    #[must_use]
    pub fn markdown(&self) -> String {
        let mut out = String::from("# Depth cues\n\n");
        out += "Intervals (95 %) come from drawing whole backgrounds. `yes`: the whole interval of the \
                effect lies above the threshold; `no`: within it on both sides; `reversed`: below its \
                negative; `undecided`: anything else. `(cite the numbers)`: the test is not proved on models \
                with a known answer, so the word alone must not be cited. Neighbouring sizes with the same \
                word share a line, with the range of their effects; summary.csv has each size with its \
                interval.\n\n";
        out += "| model | cue | used? | effect | threshold | backgrounds |\n|---|---|---|---|---|---|\n";
        for line in self.lines() {
            let finding = line.finding;
            let _ = writeln!(
                out,
                "| {} | {} | **{}** | {} | {} | {} |",
                finding.model,
                line.label.replace('|', "\\|"),
                line.uses,
                line.effect,
                finding.threshold,
                finding.backgrounds
            );
        }
        out += "\n## Tests\n\n";
        for cue in distinct(self.findings.iter().map(|finding| finding.cue)) {
            if let Some(finding) = self.findings.iter().find(|finding| finding.cue == cue) {
                let _ = writeln!(out, "- {cue}: {}.", finding.test);
            }
        }
        out += "\n## Details\n\n";
        out += "| model | experiment | series | statistic | value | unit | backgrounds |\n";
        out += "|---|---|---|---|---|---|---|\n";
        for line in &self.statistics {
            let _ = writeln!(
                out,
                "| {} | {} | {} | {} | {} | {} | {} |",
                line.model,
                line.cue,
                line.series.replace('|', "\\|"),
                line.statistic.replace('|', "\\|"),
                with_interval(line.value, line.low, line.high),
                line.unit,
                line.backgrounds
            );
        }
        out
    }
}

fn line(same: &[Finding]) -> Option<Line<'_>> {
    let (first, last) = (same.first()?, same.last()?);
    let sizes = match (first.height_px, last.height_px) {
        (Some(a), Some(b)) if same.len() > 1 => {
            format!(
                ", {:.0} to {:.0} px ({} sizes)",
                a.min(b),
                a.max(b),
                same.len()
            )
        }
        (Some(height_px), _) => format!(", {height_px:.0} px"),
        _ => String::new(),
    };
    let effects = || same.iter().filter_map(|finding| finding.effect);
    let effect = match (same, first.effect) {
        ([only], Some(effect)) => with_interval(effect, only.low, only.high),
        ([_], None) => "not defined".to_owned(),
        _ if effects().next().is_none() => "not defined".to_owned(),
        _ => {
            let low = effects().fold(f64::INFINITY, f64::min);
            let high = effects().fold(f64::NEG_INFINITY, f64::max);
            format!("{} to {}", short(low), short(high))
        }
    };
    Some(Line {
        finding: first,
        uses: first.uses,
        label: format!("{}: {}{sizes}", first.cue, first.object),
        effect,
    })
}

/// At most three digits that matter.
fn short(value: f64) -> String {
    let magnitude = value.abs();
    let decimals = if magnitude >= 100.0 {
        0
    } else if magnitude >= 10.0 {
        1
    } else if magnitude >= 1.0 {
        2
    } else {
        3
    };
    format!("{value:.decimals$}")
}

fn with_interval(value: f64, low: Option<f64>, high: Option<f64>) -> String {
    match (low, high) {
        (Some(low), Some(high)) => format!("{} [{}, {}]", short(value), short(low), short(high)),
        _ => short(value),
    }
}
