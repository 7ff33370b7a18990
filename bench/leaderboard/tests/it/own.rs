//! The leaderboard that this repository carries.

use std::path::Path;

use strat_leaderboard::check::check;
use strat_leaderboard::section::sections;
use strat_leaderboard::site;

#[test]
fn the_repositorys_own_leaderboard_is_good_and_can_be_shown() {
    let board = Path::new(env!("CARGO_MANIFEST_DIR")).join("board");
    let checked = check(&board, true).unwrap();
    assert_eq!(checked.problems, []);
    assert_eq!(
        (checked.submissions.len(), checked.published.len()),
        (16, 47)
    );
    // Nothing of it is KITTI's, so nothing stands beside published rows.
    assert!(
        checked
            .board
            .data
            .iter()
            .all(|data| data.source == "rendered" && !data.competes())
    );
    let all = sections(&checked);
    let ranks: Vec<(&str, Option<usize>)> = all[0]
        .methods
        .iter()
        .map(|method| (method.submission.id.as_str(), method.places[0].rank))
        .collect();
    // As README.md of the board says.
    assert_eq!(
        ranks,
        [
            ("random-1", Some(1)),
            ("fixed-1", Some(1)),
            ("strat-1", Some(1)),
            ("strat-3", Some(1)),
            ("fixed-3", Some(1)),
            ("strat-2", Some(6)),
            ("no-adv-1", Some(6)),
            ("random-3", Some(6)),
            ("no-adv-3", Some(6)),
            ("no-adv-2", Some(10)),
            ("random-2", Some(10)),
            ("fixed-2", Some(10)),
            ("median-depth", Some(13)),
            ("constant", Some(14)),
            ("flat_road", Some(15)),
        ]
    );
    // The demo's images are others, and nothing else is measured on them.
    let of_demo: Vec<(&str, Option<usize>)> = all
        .iter()
        .filter(|section| section.data.images == 40)
        .flat_map(|section| &section.methods)
        .map(|method| (method.submission.id.as_str(), method.places[0].rank))
        .collect();
    assert_eq!(of_demo, [("demo", None), ("demo", None)]);
    let out = tempfile::tempdir().unwrap();
    let written = site::write(&checked, &out.path().join("site")).unwrap();
    assert!(written.bytes < 2_000_000, "{written:?}");
}
