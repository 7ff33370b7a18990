//! Which model is better, by how much, and how sure that is: the paired tests of [`crate::rows::compare`] in
//! words.

use maud::{Markup, html};
use strat_metrics::{
    Metric, Row,
    compare::{PairedTest, TestOptions},
    rows::by_model,
    statistics::{Interval, summarise},
};

use super::{builder::Page, html::scrolling};
use crate::rows::compare;

/// What p after Holm must be below for a model to be called better.
const LEVEL: f64 = 0.05;

/// Up to so many differences are printed with the page.
const PRINTED: usize = 42;

impl Page {
    /// The models in the order of their Abs Rel under a protocol, and every pair of them; nothing for a single
    /// one.
    pub(super) fn verdict(&mut self, rows: &[Row], protocol: &str) -> Markup {
        let models = by_model(rows, protocol);
        let Some(models) = self.or_problem(models).filter(|models| models.len() > 1) else {
            return html! {};
        };
        let options = TestOptions::default();
        let tests = compare::pairs(rows, Some(protocol), None, None, false, &options);
        let Some(tests) = self.or_problem(tests) else {
            return html! {};
        };
        let mut ranked: Vec<(&str, f64, Option<Interval>)> = models
            .iter()
            .filter_map(|model| {
                let summary = summarise(model.rows())?;
                let interval = summary.intervals.map(|all| all[Metric::AbsRel as usize]);
                Some((
                    model.context().model.as_str(),
                    summary.mean.abs_rel,
                    interval,
                ))
            })
            .collect();
        ranked.sort_by(|a, b| a.1.total_cmp(&b.1));
        let of_abs_rel = |test: &&PairedTest| test.metric == Metric::AbsRel.name();
        let mut sentences: Vec<(f64, String)> = tests
            .iter()
            .filter(of_abs_rel)
            .map(|test| (test.mean_a.min(test.mean_b), sentence(test)))
            .collect();
        sentences.sort_by(|a, b| a.0.total_cmp(&b.0));
        let recordings = tests.first().map(|test| test.recordings.to_string());
        html! {
            h3 { "Which is better, by how much, how sure" }
            p {
                "Abs Rel under " (protocol) ", lower is better: "
                @for (index, (name, mean, interval)) in ranked.iter().enumerate() {
                    @if index > 0 { ", " }
                    strong { (name) } (format!(" {mean:.3}"))
                    @if let Some(Interval { low, high }) = interval { (format!(" ({low:.3} to {high:.3})")) }
                }
                "."
            }
            ul.verdict { @for (_, sentence) in &sentences { li { (sentence) } } }
            p.quiet {
                "Paired over the images that both models have; intervals of 95 % and p by flipping the signs of whole "
                "recordings (" (recordings.unwrap_or_default()) "), p after Holm over all pairs. A small p means the "
                "choice of test drives is unlikely to explain the difference; it says nothing about variation between "
                "trainings."
            }
            details.long[tests.len() > PRINTED] {
                summary { "All differences" }
                (scrolling(&format!("Differences under {protocol}"), "Second model less first.", &table(&tests)))
            }
        }
    }
}

/// What one test says of Abs Rel.
fn sentence(test: &PairedTest) -> String {
    let b_is_better = (test.difference < 0.0) == test.lower_is_better;
    let (better, worse) = match b_is_better {
        true => (&test.model_b, &test.model_a),
        false => (&test.model_a, &test.model_b),
    };
    let amount = test.difference.abs();
    let share = 100.0 * amount / test.mean_a.max(test.mean_b);
    let interval = test.interval.map(|Interval { low, high }| {
        let (low, high) = if test.difference < 0.0 {
            (-high, -low)
        } else {
            (low, high)
        };
        format!("95 % interval {low:.4} to {high:.4}")
    });
    let p = test.p_holm.map(|p| match p < 1e-4 {
        true => "p below 0.0001".to_owned(),
        false => format!("p {p:.4}"),
    });
    let how_sure: Vec<String> = interval.into_iter().chain(p).collect();
    let how_sure = match how_sure.is_empty() {
        true => String::new(),
        false => format!(" ({})", how_sure.join(", ")),
    };
    if test.p_holm.is_some_and(|p| p < LEVEL) {
        return format!("{better} is better than {worse} by {amount:.4} ({share:.0} %){how_sure}.");
    }
    let cannot = test.smallest_p_holm().is_none_or(|p| p >= LEVEL);
    let reason = if cannot {
        format!("{} are too few to show any difference", test.recordings)
    } else {
        "the difference may be due to the choice of test drives".to_owned()
    };
    if amount == 0.0 {
        return format!("{better} and {worse} do not differ.");
    }
    format!(
        "Undecided: {better} is lower than {worse} by {amount:.4} ({share:.0} %), but {reason}{how_sure}."
    )
}

fn table(tests: &[PairedTest]) -> Markup {
    html! {
        table.sortable {
            thead { tr {
                th scope="col" { "First model" }
                th scope="col" { "Second model" }
                th scope="col" { "Metric" }
                th.n scope="col" { "Difference" }
                th.n scope="col" { "p after Holm" }
                th.n scope="col" { "Images" }
            } }
            tbody {
                @for test in tests {
                    tr {
                        th scope="row" { (test.model_a) }
                        td { (test.model_b) }
                        td { (Metric::ALL.into_iter().find(|one| one.name() == test.metric).map_or(test.metric, Metric::heading)) }
                        td.n data-v=(test.difference) {
                            (format!("{:+.4}", test.difference))
                            @if let Some(Interval { low, high }) = test.interval { small { (format!("{low:+.4} to {high:+.4}")) } }
                        }
                        td.n data-v=[test.p_holm] { (test.p_holm.map_or("-".to_owned(), |p| format!("{p:.4}"))) }
                        td.n data-v=(test.images) { (test.images) }
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use strat_metrics::{ImageScore, Metrics, RowContext};

    use super::*;

    fn rows(model: &str, drives: usize, abs_rel: f64) -> Vec<Row> {
        let context = RowContext {
            model: model.to_owned(),
            protocol: "eigen-80".to_owned(),
            ..RowContext::default()
        };
        let row = |index: usize| {
            let metrics = Metrics {
                abs_rel: abs_rel + 0.001 * index as f64,
                ..Metrics::default()
            };
            let score = ImageScore {
                group: None,
                metrics,
                further: None,
                d1_all: None,
                sum_squared_error: 1.0,
                pixels: 1,
                floored_pixels: 0,
                fit: None,
            };
            Row::new(
                &context,
                format!("2011_09_26_drive_{index:04}/0000000001"),
                score,
            )
        };
        (0..drives).map(row).collect()
    }

    fn verdict(drives: usize) -> String {
        let all = [rows("old", drives, 0.2), rows("new", drives, 0.1)].concat();
        Page::default().verdict(&all, "eigen-80").into_string()
    }

    #[test]
    fn a_difference_is_named_with_its_direction_and_its_size() {
        let text = verdict(12);
        assert!(
            text.contains("new is better than old by 0.1000 (49 %)"),
            "{text}"
        );
        assert!(
            text.find("<strong>new</strong>") < text.find("<strong>old</strong>"),
            "{text}"
        );
    }

    #[test]
    fn few_drives_show_nothing() {
        let text = verdict(3);
        assert!(
            text.contains("Undecided: new is lower than old by 0.1000"),
            "{text}"
        );
        assert!(
            text.contains("3 drives are too few to show any difference"),
            "{text}"
        );
        let alone = Page::default().verdict(&rows("old", 9, 0.2), "eigen-80");
        assert_eq!(alone.into_string(), "");
    }
}
