//! What `bench publish` writes, and `init`.

use std::fs;

use strat_leaderboard::init::init;
use strat_leaderboard::publish::publish;

use crate::fixtures::{Fixture, images, measured, text};

#[test]
fn a_submission_is_the_same_again_and_keeps_its_card() {
    let fixture = Fixture::new();
    fixture.submit("strat", 1.1);
    let all = || {
        ["rows.csv.gz", "leaderboard.csv", "run.yaml", "card.yaml"]
            .map(|file| fs::read(fixture.own("strat", file)).unwrap())
    };
    let before = all();
    let file = fixture.path("results/strat/rows.csv");
    let to = fixture.path("board/submissions/strat");
    let written = publish(&file, Some("strat"), &to).unwrap();
    assert!(written.kept_card && !written.partial && written.rows == images().len());
    assert_eq!(all(), before);
    let record = text(&fixture.own("strat", "run.yaml"));
    assert!(!record.contains("/home/somebody"), "{record}");
    let card = text(&fixture.own("strat", "card.yaml"));
    for line in [
        "method: \"strat\"",
        "seed: 3",
        "training: \"eigen split, 1 drive\"",
        "parameters: 7",
    ] {
        assert!(card.contains(line), "{card}");
    }
}

#[test]
fn a_submission_is_of_one_model_and_has_a_record() {
    let fixture = Fixture::new();
    let both = [measured("a", &images(), 1.1), measured("b", &images(), 1.2)].concat();
    let file = fixture.results("a", &both, "null", "");
    let to = fixture.path("board/submissions/x");
    let told = |model| publish(&file, model, &to).unwrap_err().to_string();
    assert!(
        told(None).contains("several models (a, b); a submission is of one, which --model names")
    );
    assert!(told(Some("c")).contains("no rows of model \"c\"; it has a, b"));
    assert!(told(Some("b")).contains("says nothing of model \"b\""));
    assert!(!to.exists());
    fs::remove_file(fixture.path("results/a/run.yaml")).unwrap();
    assert!(told(None).contains("run.yaml is missing"));
    fs::create_dir_all(&to).unwrap();
    fs::write(to.join("card.yaml"), "mine").unwrap();
    fixture.results("a", &both, "null", "");
    assert!(told(Some("a")).contains("holds other things (card.yaml)"));
}

#[test]
fn init_takes_an_empty_folder_only() {
    let fixture = Fixture::new();
    let new = fixture.path("new");
    assert_eq!(
        init(&new, "Depth: \"ours\"", &[], None)
            .unwrap_err()
            .to_string()
            .matches("has the character")
            .count(),
        1
    );
    assert!(!new.exists());
    init(&new, "Depth, ours", &[], None).unwrap();
    for file in [
        "leaderboard.yaml",
        "README.md",
        "published/thesis.csv",
        ".github/workflows/leaderboard.yml",
    ] {
        assert!(new.join(file).is_file(), "{file}");
    }
    let readme = text(&new.join("README.md"));
    assert!(readme.starts_with("# Depth, ours\n") && readme.lines().count() == 7);
    let checked = strat_leaderboard::check::check(&new, false).unwrap();
    assert_eq!((checked.problems.len(), checked.published.len()), (0, 47));
    let odd = init(&fixture.path("odd"), "x", &[], Some("a: b"));
    let odd = odd.unwrap_err().to_string();
    assert!(
        odd.contains("\"a: b\" is not the address of a git repository"),
        "{odd}"
    );
    let again = init(&new, "x", &[], None).unwrap_err().to_string();
    assert!(again.contains("a leaderboard already"), "{again}");
    let foreign = init(&fixture.path("results"), "x", &[], None);
    assert!(foreign.is_ok(), "not there yet");
    fixture.write("full/notes.txt", "mine");
    let full = init(&fixture.path("full"), "x", &[], None)
        .unwrap_err()
        .to_string();
    assert!(full.contains("notes.txt"), "{full}");
}
