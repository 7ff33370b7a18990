//! `bench leaderboard init`: lays out a repository.

use std::path::{Path, PathBuf};

use strat_store::claim::Found;
use strat_store::inputs::{self, Kind};
use strat_store::{Error, files};

use crate::board::{BOARD, BoardError, DataSet, MARK, PUBLISHED, SUBMISSIONS, quoted};
use crate::published;
use crate::text::check_name;

const README: &str = include_str!("README.md");
const WORKFLOW: &str = include_str!("leaderboard.yml");
const WORKFLOW_PATH: &str = ".github/workflows/leaderboard.yml";

/// Where the workflow takes the address of strat from unless it is told.
const VARIABLE: &str = "${{ vars.STRAT }}";

/// Lays a leaderboard out in a new or empty folder, with the prepared sets whose rows it takes;
/// `strat` is the git address that its workflow builds `bench` from. Returns the sets' descriptions.
///
/// # Errors
/// The folder holds anything, title or address are unusable, or a set is none.
pub fn init(
    folder: &Path,
    title: &str,
    sets: &[PathBuf],
    strat: Option<&str>,
) -> Result<Vec<DataSet>, BoardError> {
    let given: Vec<&Path> = sets.iter().map(PathBuf::as_path).collect();
    let refuse = |problem: String| Error::Output {
        path: folder.to_owned(),
        problem,
    };
    let found = MARK.examine(folder, &given)?;
    if let Err(why) = check_name(title) {
        return Err(refuse(format!("the title {title:?} {why}")).into());
    }
    if let Some(address) = strat.filter(|address| !is_address(address)) {
        return Err(refuse(format!(
            "{address:?} is not the address of a git repository, such as https://host/owner/strat"
        ))
        .into());
    }
    let mut data: Vec<DataSet> = Vec::new();
    for set in sets {
        let one = DataSet::of(set)?;
        if !data.contains(&one) {
            data.push(one);
        }
    }
    let (config, workflow) = (config(title, &data), workflow(strat));
    if found == Found::Record {
        let begun = folder.join(MARK.begun());
        let is_same = |name: &str, text: &str| {
            let there = inputs::read(&folder.join(name), Kind::Yaml);
            there.is_ok_and(|there| there == text.as_bytes())
        };
        if begun.is_file() && is_same(BOARD, &config) && is_same(WORKFLOW_PATH, &workflow) {
            // Ended by a kill after all was written.
            files::remove(&begun)?;
            return Ok(data);
        }
        let problem = "it is a leaderboard already; nothing in it is replaced";
        return Err(refuse(problem.to_owned()).into());
    }
    MARK.begin(folder)?;
    for (name, rows) in published::built_in() {
        files::write_csv(&folder.join(PUBLISHED).join(name), &rows)?;
    }
    let write = |path: &str, text: &str| files::write_atomic(&folder.join(path), text.as_bytes());
    write(&format!("{SUBMISSIONS}/.gitkeep"), "")?;
    write("README.md", &README.replace("TITLE", title))?;
    write(WORKFLOW_PATH, &workflow)?;
    MARK.finish(folder, config.as_bytes())?;
    Ok(data)
}

/// Whether `cargo install --git` could take it, and YAML as it stands.
fn is_address(text: &str) -> bool {
    let known = ["https://", "ssh://", "file://"];
    let plain = |c: char| c.is_ascii_alphanumeric() || "-._~:/@".contains(c);
    known.iter().any(|scheme| text.starts_with(scheme)) && text.chars().all(plain)
}

fn workflow(strat: Option<&str>) -> String {
    WORKFLOW
        .replace("ADDRESS", strat.unwrap_or(VARIABLE))
        .replace("VERSION", env!("CARGO_PKG_VERSION"))
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
pub fn next_steps(folder: &Path, data: &[DataSet], strat: Option<&str>) -> String {
    let mut steps = Vec::new();
    if data.is_empty() {
        steps.push(format!(
            "name the data sets in {BOARD}, or begin again with --data SET"
        ));
    }
    if strat.is_none() {
        steps.push(format!(
            "write the git address of strat into {WORKFLOW_PATH} (or begin again with --strat ADDRESS)"
        ));
    }
    steps.push("commit it; README.md says what a contributor does".to_owned());
    format!(
        "{} is a leaderboard\nnext: {}",
        folder.display(),
        steps.join("; then ")
    )
}
