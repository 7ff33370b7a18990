//! What all pages have: head, navigation, foot.

use maud::{DOCTYPE, Markup, html};

use crate::check::Checked;

/// The pages may load nothing but their own files. From the file system a browser knows those by
/// `file:` alone.
const POLICY: &str = "default-src 'none'; img-src 'self' file: data:; \
                      style-src 'self' file: 'unsafe-inline'; script-src 'self' file:; \
                      base-uri 'none'; form-action 'none'";

/// A page: `up` is the way to the site's folder, empty or `../`.
pub(super) fn page(
    checked: &Checked,
    title: &str,
    up: &str,
    scripts: &[&str],
    body: &Markup,
) -> String {
    let board = &checked.board.title;
    let whole = if title.is_empty() {
        board.clone()
    } else {
        format!("{title} - {board}")
    };
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta http-equiv="Content-Security-Policy" content=(POLICY);
                title { (whole) }
                link rel="stylesheet" href={ (up) "style.css" };
            }
            body {
                a.skip href="#content" { "Skip to the content" }
                header {
                    p.board { a href={ (up) "index.html" } { (board) } }
                    @if !title.is_empty() { h1 { (title) } } @else { h1 { (board) } }
                    nav aria-label="Site" { ul {
                        li { a href={ (up) "index.html" } { "All rankings" } }
                        li { a href={ (up) "compare.html" } { "Compare two methods" } }
                        li { a href={ (up) "index.html#rules" } { "Rules" } }
                        li { a href={ (up) "csv/leaderboard.csv" } download="leaderboard.csv" { "All lines as CSV" } }
                    } }
                }
                main #content { (body) }
                footer.quiet {
                    p {
                        "Every measured number was derived again from one row per image by bench "
                        (env!("CARGO_PKG_VERSION")) "; intervals are 95 % over recordings. Published numbers are \
                         quoted, never ranked."
                    }
                }
                @for script in scripts { script src={ (up) (script) } {} }
            }
        }
    }
    .into_string()
}

/// A number as pages show it.
pub(super) fn number(value: f64) -> String {
    format!("{value:.3}")
}

/// A p value as pages show it.
pub(super) fn p_text(p: f64) -> String {
    if p < 0.001 {
        "<0.001".to_owned()
    } else {
        format!("{p:.3}")
    }
}
