//! Measurements of time.

use maud::{Markup, html};

use super::html::scrolling;
use crate::latency::LatencyRow;

const SPEED: &str = "Milliseconds per query, and images per second. A query is one image (single \
                     stream) or one batch (multi stream); offline has all images at hand.";

pub(super) fn latency(rows: &[LatencyRow]) -> Markup {
    let ms = |value: Option<f64>| {
        html! {
            @match value {
                Some(value) => td.n data-v=(value) { (format!("{value:.2}")) },
                None => td.n { "-" },
            }
        }
    };
    let body = html! {
        table.sortable {
            thead { tr {
                th scope="col" { "Model" } th.n scope="col" { "Threads" } th.n scope="col" { "Batch" }
                th scope="col" { "Stage" } th scope="col" { "Scenario" }
                @for heading in ["Mean", "p50", "p90", "p95", "p99", "Images/s"] {
                    th.n scope="col" { (heading) }
                }
                th scope="col" { "Runtime" } th scope="col" { "Provider" } th scope="col" { "Processor" }
            } }
            tbody { @for row in rows { tr {
                th scope="row" { (row.model) }
                td.n data-v=(row.threads) { (row.threads) }
                td.n data-v=(row.batch) { (row.batch) }
                td { (row.stage) }
                td { (row.scenario) }
                (ms(row.mean_ms)) (ms(row.p50_ms)) (ms(row.p90_ms)) (ms(row.p95_ms)) (ms(row.p99_ms))
                (ms(Some(row.images_per_second)))
                td { (row.runtime) }
                td { (row.provider) " (" (row.device) ")" }
                td { (row.processor) }
            } } }
        }
    };
    scrolling("Speed", SPEED, &body)
}
