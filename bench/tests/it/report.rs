//! `bench report` from outside: what the page holds, what it says of broken files, and that a
//! browser opens and sorts it.

use std::{collections::BTreeSet, fs, path::Path, process};

use assert_cmd::Command;
use strat_metrics::{Group, Row, rows, statistics::summarise};
use strat_needs::Need;
use strat_splits::Split;

use crate::command::{Ran, run, text};
use crate::fixtures::{INPUT_HEIGHT, INPUT_WIDTH, network, write_model};
use crate::world::World;

fn report(folder: &Path, more: &[&str]) -> Ran {
    let mut command = Command::cargo_bin("bench").unwrap();
    run(command.arg("report").arg(folder).args(more))
}

fn page(folder: &Path) -> String {
    fs::read_to_string(folder.join("report.html")).unwrap()
}

/// Two models over one set, measured apart, below `all`.
fn two_runs() -> World {
    let world = World::new(Split::Kitti, 6, true);
    for (out, name, constant) in [("all/a", "first", 0.04), ("all/b", "<i>second</i>", 0.05)] {
        let file = out.replace('/', "-");
        let model = write_model(world.folder.path(), &file, constant, 0.01, "kitti");
        let model = format!("{name}={}", text(&model));
        let more = ["--model", &model, "--protocol", "kitti2015-distance"];
        let more = [
            &more[..],
            &["--protocol", "kitti2015-occ", "--extremes", "1"],
        ]
        .concat();
        world.bench("all", out, &more).code(0);
    }
    world
}

fn of<'a>(rows: &'a [Row], protocol: &str) -> Vec<&'a Row> {
    let own = rows.iter().filter(|row| row.context.protocol == protocol);
    own.collect()
}

#[test]
fn figures_of_the_page_are_those_of_the_rows() {
    let world = two_runs();
    let all = world.path("all");
    report(&all, &[]).code(0);
    let page = page(&all);
    for out in ["all/a", "all/b"] {
        let rows = world.rows(out);
        for protocol in ["kitti2015", "kitti2015-occ"] {
            let summary = summarise(&of(&rows, protocol)).unwrap();
            let (mean, ends) = (summary.mean.abs_rel, summary.intervals.unwrap()[0]);
            let cell = format!(
                "data-v=\"{mean}\">{mean:.3}<small>{:.3}–{:.3}</small>",
                ends.low, ends.high
            );
            assert!(page.contains(&cell), "no {cell} for {out} under {protocol}");
        }
        for group in Group::DISTANCES.iter().chain(&Group::SEMANTIC) {
            let own: Vec<&Row> = rows
                .iter()
                .filter(|row| row.score.group == Some(*group))
                .collect();
            if let Some(summary) = summarise(&own) {
                let cell = format!("data-v=\"{}\">", summary.mean.rmse);
                assert!(page.contains(&cell), "no {cell} for {group} of {out}");
            }
        }
        let best = of(&rows, "kitti2015")
            .into_iter()
            .min_by(|a, b| a.score.metrics.abs_rel.total_cmp(&b.score.metrics.abs_rel))
            .unwrap();
        let line = format!("<strong>best</strong> <code>{}</code>", best.image);
        assert!(page.contains(&line), "no {line}");
    }
    // Both models stand in one table, beside the published rows; their differences in another.
    assert_eq!(page.matches("<table class=\"sortable\">").count(), 5);
    assert!(page.contains("Which is better, by how much, how sure"));
    assert!(page.contains("Ours - StrAT") && page.contains("published"));
    assert!(page.contains("&lt;i&gt;second&lt;/i&gt;") && !page.contains("<i>second"));
}

/// Scans of 10 m: the upper end belongs to the nearer distance.
#[test]
fn pixels_are_grouped_by_their_true_depth() {
    let world = World::new(Split::Eigen, 3, false);
    let model = write_model(world.folder.path(), "m", 0.05, 0.01, "eigen");
    let more = ["--model", &text(&model), "--protocol", "eigen-80-distance"];
    let ran = world.bench("3.3", "out", &more);
    assert!(
        ran.code(0)
            .out
            .contains("m under eigen-80-distance, Abs Rel by true depth: 5-10m"),
        "{}",
        ran.out
    );
    let rows = world.rows("out");
    let groups: Vec<Option<Group>> = of(&rows, "eigen-80-distance")
        .iter()
        .map(|row| row.score.group)
        .collect();
    assert_eq!(groups, [Some(Group::To10m); 3]);
}

#[test]
fn the_page_stands_alone() {
    let world = two_runs();
    let all = world.path("all");
    report(&all, &["--title", "Ours & \"theirs\""]).code(0);
    let page = page(&all);
    assert!(page.contains("<title>Ours &amp; &quot;theirs&quot;</title>"));
    assert!(page.contains("default-src 'none'"));
    // Two models with one best and one worst picture each.
    assert_eq!(page.matches("src=\"data:image/jpeg;base64,").count(), 4);
    for outside in ["src=\"http", "href=\"http", "url(http", "@import", "<link"] {
        assert!(!page.contains(outside), "{outside}");
    }
    let ids: Vec<&str> = page
        .split(" id=\"")
        .skip(1)
        .filter_map(|rest| rest.split('"').next())
        .collect();
    let distinct: BTreeSet<&&str> = ids.iter().collect();
    assert_eq!(ids.len(), distinct.len(), "{ids:?}");
    for target in page.split("href=\"#").skip(1) {
        let target = target.split('"').next().unwrap();
        assert!(ids.contains(&target), "nothing is called {target}");
    }
    // The same files give the same page.
    let first = page;
    report(&all, &["--title", "Ours & \"theirs\""]).code(0);
    assert_eq!(first, self::page(&all));
}

/// A model of unknown scale is scored by medians; its best and worst images are shown under that
/// protocol, beside those of a model with a scale.
#[test]
fn pictures_are_captioned_with_the_protocol_they_were_scored_under() {
    let world = World::new(Split::Kitti, 4, false);
    let metric = write_model(world.folder.path(), "metric", 0.04, 0.01, "kitti");
    let unscaled = world.path("unscaled.onnx");
    fs::write(&unscaled, network(0.04, 0.02, None)).unwrap();
    let description = format!(
        "input: {{width: {INPUT_WIDTH}, height: {INPUT_HEIGHT}, range: 0..1}}\n\
         output: {{meaning: inverse_depth}}\n"
    );
    fs::write(world.path("unscaled.yaml"), description).unwrap();
    let (metric, unscaled) = (text(&metric), text(&unscaled));
    let more = ["--model", &metric, "--model", &unscaled, "--extremes", "1"];
    world.bench("3.1", "all/a", &more).code(0);
    let all = world.path("all");
    report(&all, &[]).code(0);
    let page = page(&all);
    assert_eq!(page.matches("src=\"data:image/jpeg;base64,").count(), 4);
    for row in world.rows("all/a") {
        let caption = format!(
            "<code>{}</code>: Abs Rel {:.3}, RMSE {:.3} m, δ&lt;1.25 {:.3} under {}",
            row.image,
            row.score.metrics.abs_rel,
            row.score.metrics.rmse,
            row.score.metrics.a1,
            row.context.protocol
        );
        assert!(page.contains(&caption), "no {caption}");
    }
}

#[test]
fn a_copy_of_a_run_counts_once() {
    let world = two_runs();
    fs::create_dir_all(world.path("once")).unwrap();
    fs::rename(world.path("all/b"), world.path("once/b")).unwrap();
    fs::create_dir_all(world.path("once/copy")).unwrap();
    for file in ["rows.csv", "run.yaml"] {
        fs::copy(
            world.path("once/b").join(file),
            world.path("once/copy").join(file),
        )
        .unwrap();
    }
    report(&world.path("once"), &[]).code(0);
    let page = page(&world.path("once"));
    assert!(page.contains("KITTI split, rendered images (6 of 200 images)"));
    // Table 3.1, 3.2, further protocols, distances: of one data set.
    assert_eq!(page.matches("<table class=\"sortable\">").count(), 4);
}

#[test]
fn broken_files_cost_themselves_only() {
    let world = two_runs();
    let all = world.path("all");
    let rows = fs::read_to_string(all.join("b/rows.csv")).unwrap();
    fs::write(all.join("b/rows.csv"), &rows[..rows.len() - 30]).unwrap();
    fs::create_dir_all(all.join("c")).unwrap();
    fs::write(all.join("c/latency.csv"), "model,threads\nx,many\n").unwrap();
    fs::create_dir_all(all.join("d")).unwrap();
    fs::write(all.join("d/cues.csv"), "nothing\n").unwrap();
    // A picture that is none.
    let pictures = all.join("a/pictures/first");
    let picture = fs::read_dir(&pictures).unwrap().next().unwrap().unwrap();
    fs::write(picture.path(), b"not a PNG").unwrap();
    let ran = report(&all, &[]);
    ran.code(1)
        .says("rows.csv")
        .says("latency.csv")
        .says("cues.csv");
    ran.says(picture.path().to_str().unwrap());
    let page = page(&all);
    assert!(page.contains("Left out, because it cannot be read or used"));
    assert!(page.contains("first") && !page.contains("second"));

    // Nothing that can be read.
    fs::remove_dir_all(all.join("a")).unwrap();
    report(&all, &["--out", &text(&world.path("none.html"))])
        .code(1)
        .says("can be read");
    assert!(!world.path("none.html").exists());
    // Nothing at all.
    fs::create_dir_all(world.path("empty")).unwrap();
    report(&world.path("empty"), &[])
        .code(1)
        .says("no results below");
    report(&world.path("nowhere"), &[])
        .code(1)
        .says("results folder not found");
}

#[test]
fn rows_without_a_record_make_a_page_too() {
    let world = two_runs();
    let all = world.path("all");
    fs::remove_file(all.join("a/run.yaml")).unwrap();
    fs::remove_dir_all(all.join("b")).unwrap();
    report(&all, &[]).code(0);
    let page = page(&all);
    assert!(page.contains("No run.yaml lies beside the rows"));
    assert!(page.contains("of unknown source"));
    let kept = rows::read(fs::File::open(all.join("a/rows.csv")).unwrap()).unwrap();
    let summary = summarise(&of(&kept, "kitti2015")).unwrap();
    assert!(page.contains(&format!("data-v=\"{}\">", summary.mean.abs_rel)));
}

/// A Chromium that can be started, or nothing.
fn chromium() -> Option<&'static str> {
    let known = ["chromium", "chromium-browser", "google-chrome"];
    known.into_iter().find(|name| {
        let started = process::Command::new(name).arg("--version").output();
        started.is_ok_and(|output| output.status.success())
    })
}

/// Opens the page, clicks on headings, and reads the first column back.
#[test]
fn a_browser_opens_and_sorts_it() {
    let Some(chromium) = chromium() else {
        Need::Chromium.is_lacking("none in the path");
        return;
    };
    let world = two_runs();
    let all = world.path("all");
    report(&all, &[]).code(0);
    // After the page's own script: click, and leave what is seen in the document.
    let test = "<script>
        const table = document.querySelector('[aria-label^=\"Table\"] table');
        const seen = (column) => {
            table.tHead.rows[0].cells[column].querySelector('button').click();
            const lines = [...table.tBodies[0].rows];
            return lines.map((line) => line.cells[1].dataset.v).join(' ');
        };
        const told = document.createElement('output');
        told.id = 'told';
        const up = seen(1), down = seen(1);
        told.textContent = [up, down, table.tHead.rows[0].cells[1].ariaSort,
            seen(0) !== down, document.documentElement.scrollWidth <= window.innerWidth].join('|');
        document.body.append(told);
        </script></body>";
    let html = page(&all).replace("</body>", test);
    let file = world.path("test.html");
    fs::write(&file, html).unwrap();
    let output = process::Command::new(chromium)
        .args([
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--window-size=390,844",
        ])
        .args(["--enable-logging=stderr", "--dump-dom"])
        .arg(format!("--user-data-dir={}", text(&world.path("profile"))))
        .arg(format!("file://{}", text(&file)))
        .output()
        .unwrap();
    let dom = String::from_utf8_lossy(&output.stdout);
    let log = String::from_utf8_lossy(&output.stderr);
    let told = dom
        .split("<output id=\"told\">")
        .nth(1)
        .and_then(|rest| rest.split('<').next())
        .unwrap_or_else(|| panic!("the browser has not run the page:\n{log}"));
    let parts: Vec<&str> = told.split('|').collect();
    let figures = |text: &str| -> Vec<f64> {
        let figures = text.split(' ').map(|figure| figure.parse().unwrap());
        figures.collect()
    };
    let (up, down) = (figures(parts[0]), figures(parts[1]));
    assert!(up.len() > 6 && up.is_sorted(), "{up:?}");
    assert!(down.is_sorted_by(|a, b| a >= b), "{down:?}");
    assert_eq!(parts[2..], ["descending", "true", "true"], "{told}");
    let console: Vec<&str> = log
        .lines()
        .filter(|line| line.contains("CONSOLE"))
        .collect();
    assert!(console.is_empty(), "{console:#?}");
}
