//! `bench leaderboard init`: lays out a repository.

use std::path::{Path, PathBuf};

use strat_store::claim::Found;
use strat_store::{Error, files};

use crate::board::{BOARD, BoardError, DataSet, MARK, PUBLISHED, SUBMISSIONS, quoted};
use crate::published;
use crate::text::check_name;

const README: &str = include_str!("README.md");
const WORKFLOW: &str = include_str!("leaderboard.yml");
const WORKFLOW_PATH: &str = ".github/workflows/leaderboard.yml";

/// Lays a leaderboard out in a new or empty folder, with the prepared sets whose rows it takes.
/// Returns their descriptions.
///
/// # Errors
/// The folder holds anything, the title is unusable, or a set is none.
pub fn init(folder: &Path, title: &str, sets: &[PathBuf]) -> Result<Vec<DataSet>, BoardError> {
    let inputs: Vec<&Path> = sets.iter().map(PathBuf::as_path).collect();
    let refuse = |problem: String| Error::Output {
        path: folder.to_owned(),
        problem,
    };
    if MARK.examine(folder, &inputs)? == Found::Record {
        return Err(
            refuse("it is a leaderboard already; nothing in it is replaced".to_owned()).into(),
        );
    }
    if let Err(why) = check_name(title) {
        return Err(refuse(format!("the title {title:?} {why}")).into());
    }
    let mut data: Vec<DataSet> = Vec::new();
    for set in sets {
        let one = DataSet::of(set)?;
        if !data.contains(&one) {
            data.push(one);
        }
    }
    MARK.begin(folder)?;
    for (name, rows) in published::built_in() {
        files::write_csv(&folder.join(PUBLISHED).join(name), &rows)?;
    }
    let write = |path: &str, text: &str| files::write_atomic(&folder.join(path), text.as_bytes());
    write(&format!("{SUBMISSIONS}/.gitkeep"), "")?;
    write("README.md", &README.replace("TITLE", title))?;
    write(WORKFLOW_PATH, WORKFLOW)?;
    MARK.finish(folder, config(title, &data).as_bytes())?;
    Ok(data)
}

fn config(title: &str, data: &[DataSet]) -> String {
    let mut text = format!(
        "{}title: {}\n# Data sets whose rows are taken. `bench leaderboard check` refuses rows of all others.\n",
        MARK.begins,
        quoted(title)
    );
    if data.is_empty() {
        return text + "data: []\n";
    }
    text += "data:\n";
    for one in data {
        text += &one.yaml();
    }
    text
}

/// What a maintainer reads after `init`.
#[must_use]
pub fn next_steps(folder: &Path, data: &[DataSet]) -> String {
    let sets = if data.is_empty() {
        format!("name the data sets in {BOARD}, or begin again with --data SET; ")
    } else {
        String::new()
    };
    format!(
        "{} is a leaderboard; {sets}then commit it and see README.md for what a contributor does",
        folder.display()
    )
}
