//! What is counted while a page grows.

use maud::{Markup, html};

use crate::draw::svg::themed;

/// What is counted while a page grows.
#[derive(Default)]
pub(super) struct Page {
    charts: usize,
    pub(super) picture_bytes: usize,
    pub(super) problems: Vec<String>,
}

impl Page {
    pub(super) fn chart(&mut self, svg: &str) -> Markup {
        self.charts += 1;
        themed(svg, &format!("c{}", self.charts))
    }

    pub(super) fn charts(&mut self, svgs: &[String]) -> Markup {
        html! { div.charts { @for svg in svgs { div { (self.chart(svg)) } } } }
    }

    /// What `result` holds; otherwise its error is put down and nothing is shown.
    pub(super) fn or_problem<T, E: std::fmt::Display>(
        &mut self,
        result: Result<T, E>,
    ) -> Option<T> {
        result
            .map_err(|error| self.problems.push(error.to_string()))
            .ok()
    }
}
