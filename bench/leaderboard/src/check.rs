//! `bench leaderboard check`: every submission verified from its own rows, and beside each other.

use std::collections::BTreeMap;
use std::path::Path;

use rayon::prelude::*;

use crate::board::{Board, BoardError, SUBMISSIONS, submissions};
use crate::published::{self, Published};
use crate::submission::{Problem, Submission, verify};

/// A leaderboard whose submissions were looked at.
#[derive(Debug)]
pub struct Checked {
    /// `leaderboard.yaml`.
    pub board: Board,
    /// Submissions without problems, by name.
    pub submissions: Vec<Submission>,
    /// Published rows.
    pub published: Vec<Published>,
    /// What contributors or maintainers have to change, by path.
    pub problems: Vec<Problem>,
}

/// Looks at everything in a leaderboard. Submissions are read in parallel and let go one by one; with
/// `keep`, the numbers of each image stay for pages.
///
/// # Errors
/// It is no leaderboard, or a folder cannot be read. What is wrong with submissions is part of the
/// outcome.
pub fn check(folder: &Path, keep: bool) -> Result<Checked, BoardError> {
    let board = Board::open(folder)?;
    let (names, odd) = submissions(folder)?;
    let mut problems: Vec<Problem> = odd
        .into_iter()
        .map(|sentence| Problem {
            path: SUBMISSIONS.to_owned(),
            sentence,
        })
        .collect();
    let verified: Vec<_> = names
        .par_iter()
        .map(|id| verify(folder, &board, id, keep))
        .collect();
    let mut good = Vec::new();
    for one in verified {
        match one {
            Ok(submission) => good.push(submission),
            Err(wrong) => problems.extend(wrong),
        }
    }
    problems.extend(twice(&good));
    problems.extend(other_images(&good));
    let (published, wrong) = published::read(folder)?;
    problems.extend(wrong);
    // What contradicts another is not shown either.
    let is_wrong = |one: &Submission| {
        let own = format!("{SUBMISSIONS}/{}", one.id);
        problems.iter().any(|problem| problem.path == own)
    };
    let submissions = good.into_iter().filter(|one| !is_wrong(one)).collect();
    problems.sort_by(|a, b| a.path.cmp(&b.path));
    Ok(Checked {
        board,
        submissions,
        published,
        problems,
    })
}

fn about(submission: &Submission, sentence: String) -> Problem {
    Problem {
        path: format!("{SUBMISSIONS}/{}", submission.id),
        sentence,
    }
}

/// Methods that are there already under their name, their model or a folder of other letters.
fn twice(submissions: &[Submission]) -> Vec<Problem> {
    type Key = fn(&Submission) -> String;
    let mut problems = Vec::new();
    let keys: [(&str, Key); 3] = [
        ("folder", |one| one.id.to_lowercase()),
        ("method", |one| one.card.method.to_lowercase()),
        ("model", |one| one.model_hash.clone()),
    ];
    let mut told: Vec<&str> = Vec::new();
    for (what, key) in keys {
        let mut known: BTreeMap<String, &Submission> = BTreeMap::new();
        for one in submissions {
            let Some(first) = known.get(&key(one)) else {
                known.insert(key(one), one);
                continue;
            };
            if !told.contains(&one.id.as_str()) {
                told.push(&one.id);
                let sentence = match what {
                    "model" => format!(
                        "the same model as {SUBMISSIONS}/{} (model_hash {:.12}); a method is listed once",
                        first.id, one.model_hash
                    ),
                    what => format!(
                        "the same {what} as {SUBMISSIONS}/{}; a method is listed once, so give the \
                         new one another name or replace the old one",
                        first.id
                    ),
                };
                problems.push(about(one, sentence));
            }
        }
    }
    problems
}

/// Complete submissions have the same images of a data set under a protocol; a set of which some
/// images were exchanged would not be the same test.
fn other_images(submissions: &[Submission]) -> Vec<Problem> {
    let mut known: BTreeMap<(&str, &str), (&Submission, &str)> = BTreeMap::new();
    let mut problems = Vec::new();
    for one in submissions {
        for scored in one
            .scored
            .iter()
            .filter(|scored| scored.images == scored.expected)
        {
            let key = (scored.protocol.as_str(), scored.data_digest.as_str());
            let digest = scored.images_digest.as_str();
            let (first, expected) = *known.entry(key).or_insert((one, digest));
            if digest != expected {
                problems.push(about(
                    one,
                    format!(
                        "its {} images under {} are not those of {SUBMISSIONS}/{}, though both name data \
                         set {:.12}; one of the two was not measured on it",
                        scored.images, scored.protocol, first.id, scored.data_digest
                    ),
                ));
            }
        }
    }
    problems
}
