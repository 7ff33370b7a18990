//! Submissions that try to pass for what they are not: each is caught with the sentence that an honest
//! contributor would need.

use std::fs;
use std::io::Write as _;

use strat_metrics::{protocol, rows};

use crate::fixtures::{Fixture, PROTOCOL, images, measured, text};

/// A board with two honest submissions and one that a test then spoils.
fn spoiled() -> Fixture {
    let fixture = Fixture::new();
    for (id, factor) in [("a", 1.1), ("b", 1.2), ("bad", 1.3)] {
        fixture.submit(id, factor);
    }
    assert_eq!(fixture.problems(), "");
    fixture
}

fn says(fixture: &Fixture, parts: &[&str]) {
    let told = fixture.problem();
    for part in parts {
        assert!(told.contains(part), "{part:?} is not in: {told}");
    }
    let good: Vec<String> = fixture
        .check()
        .submissions
        .into_iter()
        .map(|one| one.id)
        .collect();
    assert_eq!(good, ["a", "b"], "the others stay");
}

/// The line of the bad submission, cell by cell with the names of the columns.
fn cell(fixture: &Fixture, column: &str) -> String {
    let lines = text(&fixture.own("bad", "leaderboard.csv"));
    let mut lines = lines.lines().map(|line| line.split(','));
    let at = lines
        .next()
        .unwrap()
        .position(|name| name == column)
        .unwrap();
    lines.next().unwrap().nth(at).unwrap().to_owned()
}

#[test]
fn an_edited_metric() {
    let fixture = spoiled();
    let abs_rel = cell(&fixture, "abs_rel");
    fixture.edit("bad", "leaderboard.csv", &format!(",{abs_rel},"), ",0.05,");
    says(
        &fixture,
        &[
            "submissions/bad/leaderboard.csv: abs_rel under eigen-80-nocrop is 0.05, but the rows give ",
            &abs_rel,
            "write them again with `bench publish`",
        ],
    );
}

#[test]
fn an_edited_metric_in_the_rows() {
    let fixture = spoiled();
    fixture.unpack("bad");
    let rows_of = rows::read(text(&fixture.own("bad", "rows.csv")).as_bytes()).unwrap();
    let rmse = rows_of[3].score.metrics.rmse.to_string();
    fixture.edit("bad", "rows.csv", &format!(",{rmse},"), ",0.5,");
    says(
        &fixture,
        &[
            "rows.csv: image ",
            "rmse is 0.5, but sum_squared_error and pixels give",
        ],
    );
    // A share that so few pixels cannot have.
    let fixture = spoiled();
    let mut rows_of = measured("bad", &images(), 1.3);
    rows_of[5].score.metrics.a1 = 0.7;
    fs::remove_dir_all(fixture.own("bad", "")).unwrap();
    fixture.submit_rows("bad", "bad", &rows_of);
    says(&fixture, &["a1 is 0.7, which is no share of 2 pixels"]);
}

#[test]
fn an_edited_interval() {
    let fixture = spoiled();
    let high = cell(&fixture, "rmse_high");
    fixture.edit("bad", "leaderboard.csv", &format!(",{high},"), ",3.9,");
    says(
        &fixture,
        &[
            "leaderboard.csv: rmse_high under eigen-80-nocrop is 3.9, but the rows give ",
            &high,
        ],
    );
}

#[test]
fn a_wrong_digest() {
    let fixture = spoiled();
    let mut rows_of = measured("bad", &images(), 1.3);
    let other = "ab".repeat(32);
    rows_of
        .iter_mut()
        .for_each(|row| row.context.data_digest.clone_from(&other));
    fs::remove_dir_all(fixture.own("bad", "")).unwrap();
    fixture.submit_rows("bad", "bad", &rows_of);
    let told = fixture.problems();
    for part in [
        "rows were measured on data set abababababab, which is not one of this leaderboard (0f0f0f0f0f0f (A set))",
        "measure on one of those, or ask its maintainers",
    ] {
        assert!(told.contains(part), "{told}");
    }
}

#[test]
fn a_doubled_row() {
    let fixture = spoiled();
    let mut rows_of = measured("bad", &images(), 1.3);
    rows_of.push(rows_of[7].clone());
    let mut bytes = Vec::new();
    rows::write(&rows_of, &mut bytes).unwrap();
    fs::write(fixture.own("bad", "rows.csv"), bytes).unwrap();
    fs::remove_file(fixture.own("bad", "rows.csv.gz")).unwrap();
    says(
        &fixture,
        &[
            "bad/rows.csv: image ",
            &images()[7],
            "occurs twice among the rows of model bad",
        ],
    );
}

#[test]
fn dropped_hard_images() {
    let fixture = spoiled();
    let mut rows_of = measured("bad", &images(), 1.3);
    rows_of.sort_by(|a, b| a.score.metrics.abs_rel.total_cmp(&b.score.metrics.abs_rel));
    rows_of.truncate(50);
    fs::remove_dir_all(fixture.own("bad", "")).unwrap();
    fixture.submit_rows("bad", "bad", &rows_of);
    // `bench publish` asks why; whoever takes the question out is asked again.
    says(&fixture, &["card.yaml: `partial` is still to be filled in"]);
    let card = text(&fixture.own("bad", "card.yaml"));
    let without: String = card
        .lines()
        .filter(|line| !line.starts_with("partial"))
        .map(|line| format!("{line}\n"))
        .collect();
    fs::write(fixture.own("bad", "card.yaml"), &without).unwrap();
    says(
        &fixture,
        &[
            "50 of 59 images under eigen-80-nocrop: 9 are missing",
            "or say in card.yaml why not (`partial: ...`), which leaves it without a rank",
        ],
    );
    fs::write(
        fixture.own("bad", "card.yaml"),
        format!("{without}partial: out of memory\n"),
    )
    .unwrap();
    assert_eq!(fixture.problems(), "", "said, it is listed");
}

/// Other images in their place, in a set whose list only its owner knows.
#[test]
fn exchanged_images() {
    let fixture = spoiled();
    let mut others = images();
    let easy = strat_splits::test_ids(strat_splits::Split::Eigen)[1].clone();
    others[0] = easy;
    fs::remove_dir_all(fixture.own("bad", "")).unwrap();
    fixture.submit_rows("bad", "bad", &measured("bad", &others, 1.3));
    says(
        &fixture,
        &["its 59 images under eigen-80-nocrop are not those of submissions/a"],
    );
    others[0] = "2011_09_26_drive_0002/0000000001".to_owned();
    fs::remove_dir_all(fixture.own("bad", "")).unwrap();
    fixture.submit_rows("bad", "bad", &measured("bad", &others, 1.3));
    says(
        &fixture,
        &["2011_09_26_drive_0002/0000000001 is not a test image of the eigen split"],
    );
}

#[test]
fn a_formula_in_a_cell() {
    let fixture = spoiled();
    fixture.unpack("bad");
    let all = text(&fixture.own("bad", "rows.csv")).replace(",embedded,", ",=cmd|' /C calc'!A0,");
    fs::write(fixture.own("bad", "rows.csv"), all).unwrap();
    says(
        &fixture,
        &[
            "rows.csv: column \"runtime\": =cmd|",
            "which a spreadsheet takes for a formula",
        ],
    );
}

#[test]
fn a_script_in_a_name() {
    let fixture = spoiled();
    fixture.unpack("bad");
    let name = "<script>alert(1)</script>";
    for file in ["rows.csv", "run.yaml", "card.yaml", "leaderboard.csv"] {
        let all = text(&fixture.own("bad", file));
        let all = all
            .replace("\nbad,", &format!("\n{name},"))
            .replace("method: \"bad\"", &format!("method: \"{name}\""));
        fs::write(
            fixture.own("bad", file),
            all.replace("name: bad", &format!("name: {name}")),
        )
        .unwrap();
    }
    let told = fixture.problems();
    assert!(told.contains("card.yaml: `method: <script>"), "{told}");
    assert!(
        told.contains("has the character '<'; names may have letters, digits, spaces"),
        "{told}"
    );
    // A folder's name is part of addresses.
    let fixture = spoiled();
    fs::rename(fixture.own("bad", ""), fixture.own("<b>bad", "")).unwrap();
    says(
        &fixture,
        &["submissions: the folder \"<b>bad\" has the character '<'"],
    );
}

#[test]
fn a_way_out_of_the_folder() {
    let fixture = spoiled();
    let mut all = images();
    all[2] = "../../../etc/passwd".to_owned();
    fs::remove_dir_all(fixture.own("bad", "")).unwrap();
    fixture.submit_rows("bad", "bad", &measured("bad", &all, 1.3));
    says(
        &fixture,
        &["image ../../../etc/passwd leads out of its folder"],
    );
}

#[cfg(unix)]
#[test]
fn a_link_out_of_the_folder() {
    let fixture = spoiled();
    let target = fixture.path("results/bad/rows.csv");
    fs::remove_file(fixture.own("bad", "rows.csv.gz")).unwrap();
    std::os::unix::fs::symlink(target, fixture.own("bad", "rows.csv")).unwrap();
    says(
        &fixture,
        &["rows.csv is a link or folder; a submission has plain files only"],
    );
    let fixture = spoiled();
    fs::rename(fixture.own("bad", ""), fixture.path("elsewhere")).unwrap();
    std::os::unix::fs::symlink(
        fixture.path("elsewhere"),
        fixture.path("board/submissions/bad"),
    )
    .unwrap();
    says(
        &fixture,
        &["submissions: bad is not a folder (links are not followed)"],
    );
}

#[test]
fn a_row_file_of_two_gigabytes() {
    let fixture = spoiled();
    fs::remove_file(fixture.own("bad", "rows.csv.gz")).unwrap();
    let file = fs::File::create(fixture.own("bad", "rows.csv")).unwrap();
    // Holes take no room on the disk.
    if file.set_len(2_000_000_000).is_err() {
        eprintln!("could not run: no file of 2 GB here");
        return;
    }
    says(
        &fixture,
        &["rows.csv: rows.csv has 2.0 GB, but a file of a submission has at most 32.0 MB"],
    );
}

#[test]
fn a_small_file_that_unpacks_to_gigabytes() {
    let fixture = spoiled();
    let file = fs::File::create(fixture.own("bad", "rows.csv.gz")).unwrap();
    let mut packed = flate2::write::GzEncoder::new(file, flate2::Compression::fast());
    let zeros = vec![0_u8; 1 << 20];
    for _ in 0..100 {
        packed.write_all(&zeros).unwrap();
    }
    packed.finish().unwrap();
    says(
        &fixture,
        &["rows.csv.gz: unpacked it has more than 32.0 MB"],
    );
    fs::write(fixture.own("bad", "rows.csv.gz"), b"no gzip at all").unwrap();
    says(&fixture, &["rows.csv.gz: it cannot be unpacked"]);
}

#[test]
fn another_versions_protocol() {
    let fixture = spoiled();
    let mut rows_of = measured("bad", &images(), 1.3);
    let mut older = protocol(PROTOCOL).unwrap();
    older.version += 1;
    rows_of
        .iter_mut()
        .for_each(|row| row.context.protocol_digest = older.digest());
    fs::remove_dir_all(fixture.own("bad", "")).unwrap();
    fixture.submit_rows("bad", "bad", &rows_of);
    let told = fixture.problems();
    let sentence = format!(
        "rows of {PROTOCOL} were measured under other rules: their digest is {:.12}, that of this version's {PROTOCOL} is {:.12}; \
         measure again with bench ",
        older.digest(),
        protocol(PROTOCOL).unwrap().digest()
    );
    assert!(told.contains(&sentence), "{told}");
    let mut rows_of = measured("bad", &images(), 1.3);
    rows_of
        .iter_mut()
        .for_each(|row| row.context.protocol = "mine".to_owned());
    fs::remove_dir_all(fixture.own("bad", "")).unwrap();
    fixture.submit_rows("bad", "bad", &rows_of);
    assert!(
        fixture
            .problems()
            .contains("mine is not a protocol of this version")
    );
}

#[test]
fn leakage_that_was_taken_out() {
    let fixture = spoiled();
    // The first drive of the test.
    let drive = images()[0].split('/').next().unwrap().to_owned();
    fixture.edit("bad", "run.yaml", "2011_09_26_drive_0001", &drive);
    says(
        &fixture,
        &[
            "run.yaml: the warning about leakage is missing: the model was trained on drives of ",
            &drive,
            "submit run.yaml as `bench` wrote it",
        ],
    );
}

/// The words stay behind when the drives that they follow from are taken out.
#[test]
fn training_drives_that_were_taken_out() {
    let fixture = spoiled();
    let record = text(&fixture.own("bad", "run.yaml"));
    assert!(record.contains("train_drives"), "{record}");
    let cut: String = record
        .lines()
        .filter(|line| {
            !["train_drives", "- 2011_", "split:"]
                .iter()
                .any(|part| line.contains(part))
        })
        .map(|line| format!("{line}\n"))
        .collect();
    let warned = cut.replace(
        "warnings: []",
        "warnings: ['LEAKAGE: model bad was trained on it']",
    );
    fs::write(fixture.own("bad", "run.yaml"), &warned).unwrap();
    says(
        &fixture,
        &[
            "run.yaml: a warning says that the model has seen drives of the test, but its training (`metadata`) is missing",
            "submit run.yaml as `bench` wrote it",
        ],
    );
    // Without the words, too, it is a model that does not say what it was trained on.
    fs::write(fixture.own("bad", "run.yaml"), &cut).unwrap();
    assert_eq!(fixture.problems(), "");
    let checked = fixture.check();
    let bad = checked.submissions.iter().find(|one| one.id == "bad");
    let leakage = &bad.unwrap().scored[0].leakage;
    assert_eq!(leakage.to_string(), "training drives unknown");
}

#[test]
fn a_method_twice() {
    let fixture = spoiled();
    fs::remove_dir_all(fixture.own("bad", "")).unwrap();
    fixture.submit_rows("bad", "A", &measured("A", &images(), 1.3));
    says(
        &fixture,
        &["submissions/bad: the same method as submissions/a; a method is listed once"],
    );
    let mut copied = measured("a", &images(), 1.1);
    copied
        .iter_mut()
        .for_each(|row| row.context.model = "mine".to_owned());
    fs::remove_dir_all(fixture.own("bad", "")).unwrap();
    fixture.submit_rows("bad", "mine", &copied);
    says(
        &fixture,
        &["submissions/bad: the same model as submissions/a (model_hash hash of a)"],
    );
}

#[test]
fn what_does_not_belong_there() {
    let fixture = spoiled();
    fs::write(fixture.own("bad", "install.sh"), "rm -r /").unwrap();
    says(
        &fixture,
        &["submissions/bad: install.sh does not belong into a submission"],
    );
    fs::remove_file(fixture.own("bad", "install.sh")).unwrap();
    fs::remove_file(fixture.own("bad", "leaderboard.csv")).unwrap();
    says(
        &fixture,
        &["bad/leaderboard.csv: it is missing; `bench publish` writes it"],
    );
}
