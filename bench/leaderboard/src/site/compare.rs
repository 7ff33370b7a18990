//! The page that compares two methods: a frame, which `compare.js` fills in the browser.

use maud::html;

use super::frame;
use crate::check::Checked;

pub(super) fn page(checked: &Checked) -> String {
    let body = html! {
        noscript { p.warn { "This page computes in the browser; it needs scripts, which are files of this site." } }
        form.controls #choice aria-label="What is compared" {
            label { "Ranking " select #section {} }
            label { "First method " select #a {} }
            label { "Second method " select #b {} }
            label { "Metric " select #metric {} }
            button #swap type="button" { "Swap" }
        }
        p.quiet { "The address of this page names the choice: it can be passed on." }
        div #status role="status" {}
        div #result hidden {
            div #rendered.warn hidden { "Rendered images, not KITTI: these numbers cannot be compared with published ones." }
            h2 { "Means over the common images" }
            div.scroll role="region" tabindex="0" aria-label="Means" { table #means {} }
            p.quiet #how {}
            div.charts {
                figure { figcaption { "Per image" } div #scatter {} }
                figure { figcaption { "Mean difference per recording" } div #drives {} }
            }
            h2 { "Where they differ most" }
            div.charts {
                div { h3 #better-a {} div.scroll role="region" tabindex="0" aria-label="Images better with the first" { table #images-a {} } }
                div { h3 #better-b {} div.scroll role="region" tabindex="0" aria-label="Images better with the second" { table #images-b {} } }
            }
            p { button #download type="button" { "Download the numbers of these images as CSV" } }
        }
    };
    frame::page(checked, "Compare two methods", "", &["compare.js"], &body)
}
