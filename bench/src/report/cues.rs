//! Depth cues: the words with their effects, and the curves.

use maud::{Markup, html};
use strat_metrics::statistics::Bootstrap;

use super::{builder::Page, collect::CueResults, html::scrolling};
use crate::cues::{
    curves,
    summary::{self, distinct},
};

const CUES: &str = "Effects with 95 % intervals from drawing whole backgrounds. Yes: the whole \
                    interval is above the threshold; no: within it on both sides; reversed: below \
                    its negative; undecided: anything else.";

impl Page {
    pub(super) fn cues(&mut self, results: &CueResults) -> Markup {
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
        let models = distinct(results.rows.iter().map(|row| row.model.as_str()));
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
