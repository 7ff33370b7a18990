//! The comparison page in a browser, from the file system.

use std::fs;
use std::io::Read as _;
use std::path::{Path, PathBuf};
use std::process::Command;

use strat_leaderboard::check::check;
use strat_leaderboard::section::sections;
use strat_leaderboard::site;
use strat_metrics::compare::{TestOptions, compare};
use strat_metrics::rows::{self, by_model};
use strat_metrics::{Metric, Row};
use strat_needs::Need;

use crate::fixtures::{Fixture, PROTOCOL, measured};

fn chromium() -> Option<&'static str> {
    let known = ["chromium", "chromium-browser", "google-chrome"];
    known.into_iter().find(|name| {
        let started = Command::new(name).arg("--version").output();
        started.is_ok_and(|output| output.status.success())
    })
}

fn board() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("board")
}

fn rows_of(id: &str) -> Vec<Row> {
    let file = fs::File::open(board().join("submissions").join(id).join("rows.csv.gz")).unwrap();
    let mut bytes = Vec::new();
    flate2::read::GzDecoder::new(file)
        .read_to_end(&mut bytes)
        .unwrap();
    rows::read(bytes.as_slice()).unwrap()
}

/// What a browser makes of a page, whose path may end in a choice.
fn shown(chromium: &str, folder: &Path, page: &str, width: u32) -> String {
    let output = Command::new(chromium)
        .args([
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--virtual-time-budget=20000",
            "--dump-dom",
        ])
        .arg(format!("--window-size={width},900"))
        .arg(format!(
            "--user-data-dir={}",
            folder.join("profile").display()
        ))
        .arg(format!("file://{page}"))
        .output()
        .unwrap();
    String::from_utf8_lossy(&output.stdout).into_owned()
}

fn compared(chromium: &str, folder: &Path, site: &Path, choice: &str) -> String {
    let page = site.join("compare.html");
    shown(
        chromium,
        folder,
        &format!("{}#{choice}", page.display()),
        1280,
    )
}

/// No column of a ranking lies beyond the edge of a usual screen, and a phone shows names and the first metric.
#[test]
fn rankings_fit_the_screen() {
    let Some(chromium) = chromium() else {
        Need::Chromium.is_lacking("none in the path");
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("site");
    site::write(&check(&board(), true).unwrap(), &out).unwrap();
    let measure = "const cut = [...document.querySelectorAll('.scroll')].filter((one) => one.scrollWidth > one.clientWidth);\n\
                   const cell = document.querySelector('td[data-column=abs_rel]').getBoundingClientRect();\n\
                   document.title = `cut ${cut.length}, Abs Rel ends at ${Math.round(cell.right)} of ${innerWidth}`;\n";
    fs::write(out.join("measure.js"), measure).unwrap();
    let page = out.join("protocols/eigen-80.html");
    let html = fs::read_to_string(&page).unwrap();
    let html = html.replace("</body>", "<script src=\"../measure.js\"></script></body>");
    fs::write(&page, html).unwrap();
    let told = |width: u32| {
        let html = shown(chromium, folder.path(), &page.display().to_string(), width);
        let title = html.split("<title>").nth(1).unwrap_or_default();
        title
            .split("</title>")
            .next()
            .unwrap_or_default()
            .to_owned()
    };
    let wide = told(1280);
    assert!(wide.starts_with("cut 0, "), "{wide}");
    // The narrowest window of a headless Chromium is 500 wide.
    let narrow = told(500);
    let numbers: Vec<i32> = narrow
        .split(|c: char| !c.is_ascii_digit())
        .filter_map(|text| text.parse().ok())
        .collect();
    assert!(numbers[1] < 390, "{narrow}");
}

/// The page has the means, differences, intervals and p values of `bench compare`.
fn assert_compared(page: &str, both: &[Row], protocol: &str) {
    let models = by_model(both, protocol).unwrap();
    let tests = compare(&[(&models[0], &models[1])], false, &TestOptions::default()).unwrap();
    for (metric, test) in Metric::ALL.into_iter().zip(&tests) {
        let interval = test.interval.unwrap();
        let p = test.p_permutation.unwrap();
        let cells = [
            format!("{:.4}", test.mean_a),
            format!("{:.4}", test.mean_b),
            format!("{:+.5}", test.difference),
            format!("{:+.5} .. {:+.5}", interval.low, interval.high),
            if p < 0.0001 {
                "&lt;0.0001".to_owned()
            } else {
                format!("{p:.4}")
            },
        ];
        let heading = metric.heading().replace('<', "&lt;");
        let line: String = cells
            .iter()
            .map(|cell| format!("<td class=\"n\">{cell}</td>"))
            .collect();
        let line = format!("<th scope=\"row\">{heading}</th>{line}");
        assert!(
            page.contains(&line),
            "{line} is not in the page:\n{}",
            page.split("id=\"means\"")
                .nth(1)
                .unwrap_or(page)
                .chars()
                .take(3000)
                .collect::<String>(),
        );
    }
}

#[test]
fn a_browser_computes_what_bench_compare_does() {
    let Some(chromium) = chromium() else {
        Need::Chromium.is_lacking("none in the path");
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let checked = check(&board(), true).unwrap();
    let section = sections(&checked)[0].id.clone();
    let out = folder.path().join("site");
    site::write(&checked, &out).unwrap();
    let choice = format!("section={section}&a=strat-1&b=no-adv-1&metric=rmse");
    let page = compared(chromium, folder.path(), &out, &choice);
    let both = [rows_of("strat-1"), rows_of("no-adv-1")].concat();
    assert_compared(&page, &both, "eigen-80");
    assert!(page.contains("224 images of 28 recordings"));
    assert!(page.contains("RMSE: better with strat@1"));
}

/// Patterns of more than 64 signs take more than one word each.
#[test]
fn a_browser_draws_the_signs_of_many_recordings() {
    let Some(chromium) = chromium() else {
        Need::Chromium.is_lacking("none in the path");
        return;
    };
    let ids: Vec<String> = (0..150).map(|room| format!("room_{room:04}/0")).collect();
    let fixture = Fixture::of_images("other", "rooms", &ids);
    let mut both = Vec::new();
    for (id, factor) in [("a", 1.1), ("b", 1.102)] {
        let mut rows = measured(id, &ids, factor);
        for row in &mut rows {
            "rooms".clone_into(&mut row.context.split);
        }
        fixture.submit_rows(id, id, &rows);
        both.extend(rows);
    }
    assert_eq!(fixture.problems(), "");
    let checked = fixture.check();
    let section = sections(&checked)[0].id.clone();
    let out = fixture.path("site");
    site::write(&checked, &out).unwrap();
    let choice = format!("section={section}&a=a&b=b");
    let page = compared(chromium, fixture.folder.path(), &out, &choice);
    assert!(page.contains("150 images of 150 recordings"));
    assert_compared(&page, &both, PROTOCOL);
}
