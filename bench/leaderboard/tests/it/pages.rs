//! The site of a leaderboard.

use std::fs;
use std::path::Path;

use strat_leaderboard::section::sections;
use strat_leaderboard::site;
use strat_metrics::compare::{TestOptions, compare};
use strat_metrics::rows::by_model;

use crate::fixtures::{Fixture, PROTOCOL, images, measured, text};

fn site_of(fixture: &Fixture) -> site::Written {
    let out = fixture.path("site");
    site::examine(&out, &fixture.path("board")).unwrap();
    site::write(&fixture.check(), &out).unwrap()
}

#[test]
fn ranks_are_those_of_the_paired_tests() {
    let fixture = Fixture::new();
    for (id, factor) in [("worst", 1.4), ("best", 1.02), ("alike", 1.02)] {
        fixture.submit(id, factor);
    }
    let checked = fixture.check();
    let found = sections(&checked);
    assert_eq!(found.len(), 1);
    let ranks: Vec<(&str, Option<usize>)> = found[0]
        .methods
        .iter()
        .map(|method| (method.submission.id.as_str(), method.places[0].rank))
        .collect();
    assert_eq!(ranks[2], ("worst", Some(3)), "{ranks:?}");
    assert!(ranks[..2].iter().all(|one| one.1 == Some(1)), "{ranks:?}");
    // The same p as that of `bench compare`.
    let rows = [
        measured(ranks[0].0, &images(), 1.02),
        measured("worst", &images(), 1.4),
    ]
    .concat();
    let models = by_model(&rows, PROTOCOL).unwrap();
    let tests = compare(&[(&models[0], &models[1])], false, &TestOptions::default()).unwrap();
    assert_eq!(found[0].methods[2].places[0].p, tests[0].p_permutation);
}

#[test]
fn partial_and_leaking_methods_are_listed_without_a_rank() {
    let fixture = Fixture::new();
    for (id, factor) in [("a", 1.1), ("b", 1.3)] {
        fixture.submit(id, factor);
    }
    fixture.submit_rows("part", "part", &measured("part", &images()[..50], 1.01));
    fixture.edit(
        "part",
        "card.yaml",
        "partial: \"fill in\"",
        "partial: no memory",
    );
    let drive = images()[0].split('/').next().unwrap().to_owned();
    let file = fixture.results(
        "leak",
        &measured("leak", &images(), 1.01),
        &format!("{{train_drives: [{drive}]}}"),
        "'LEAKAGE: model leak was trained on it'",
    );
    strat_leaderboard::publish::publish(&file, None, &fixture.path("board/submissions/leak"))
        .unwrap();
    fixture.fill_in("leak");
    assert_eq!(fixture.problems(), "");
    site_of(&fixture);
    let checked = fixture.check();
    let found = sections(&checked);
    for method in &found[0].methods {
        let has_rank = ["a", "b"].contains(&method.submission.id.as_str());
        assert_eq!(
            method.places[0].rank.is_some(),
            has_rank,
            "{}",
            method.submission.id
        );
    }
    let page = text(&fixture.path("site/methods/leak.html"));
    assert!(page.contains("LEAKAGE: model leak was trained on it"));
    let page = text(&fixture.path("site/protocols/eigen-80-nocrop.html"));
    assert!(page.contains(">leakage<") && page.contains(">partial<") && page.contains("no memory"));
}

/// Everything that a page names is there, and nothing is from elsewhere.
#[test]
fn a_site_is_whole_and_loads_nothing_from_elsewhere() {
    let fixture = Fixture::of_source("rendered");
    fixture.submit("a", 1.1);
    fixture.submit("b", 1.3);
    let written = site_of(&fixture);
    let out = fixture.path("site");
    let mut pages = 0;
    visit(&out, &mut |path| {
        let name = path.to_string_lossy().into_owned();
        let content = text(path);
        // The name of SVG is no address that is opened.
        let elsewhere = content.replace("http://www.w3.org/2000/svg", "");
        assert!(!elsewhere.contains("://"), "{name}");
        if !name.ends_with(".html") {
            return;
        }
        pages += 1;
        let folder = path.parent().unwrap();
        for attribute in ["href=\"", "src=\""] {
            for link in content.split(attribute).skip(1) {
                let link = link.split('"').next().unwrap();
                assert!(!link.contains("//"), "{name}: {link}");
                let (file, id) = link.split_once('#').unwrap_or((link, ""));
                let target = if file.is_empty() {
                    path.to_path_buf()
                } else {
                    folder.join(file)
                };
                assert!(target.is_file(), "{name}: {link}");
                if !id.is_empty() && !id.contains('=') {
                    assert!(
                        text(&target).contains(&format!("id=\"{id}\"")),
                        "{name}: {link}"
                    );
                }
            }
        }
    });
    assert!(pages >= 5 && written.sections == 1);
    let page = text(&out.join("protocols/eigen-80-nocrop.html"));
    assert!(page.contains("Rendered images, not KITTI"));
    let badge = text(&out.join("badges/a.svg"));
    assert!(
        badge.contains("eigen-80-nocrop (rendered)") && badge.contains("Abs Rel"),
        "{badge}"
    );
}

#[test]
fn a_site_replaces_only_its_own() {
    let fixture = Fixture::new();
    fixture.submit("a", 1.1);
    fixture.submit("b", 1.3);
    site_of(&fixture);
    fixture.write("site/CNAME", "example.org");
    let names = |folder: &str| fs::read_dir(fixture.path(folder)).unwrap().count();
    assert_eq!((names("site/methods"), names("site/badges")), (2, 2));
    fs::remove_dir_all(fixture.own("b", "")).unwrap();
    site_of(&fixture);
    assert_eq!((names("site/methods"), names("site/badges")), (1, 1));
    assert!(fixture.path("site/CNAME").is_file());
    fixture.write("mine/index.html", "my page");
    let told = site::examine(&fixture.path("mine"), &fixture.path("board"))
        .unwrap_err()
        .to_string();
    assert!(told.contains("holds other things (index.html)"), "{told}");
    let inside = site::examine(
        &fixture.path("board/submissions/site"),
        &fixture.path("board"),
    );
    assert!(inside.unwrap_err().to_string().contains("inside the input"));
}

fn visit(folder: &Path, look: &mut impl FnMut(&Path)) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            visit(&path, look);
        } else {
            look(&path);
        }
    }
}
