//! `bench leaderboard page`: the static site of a leaderboard.
//!
//! Every page works from the file system and loads nothing from elsewhere: data are scripts that call
//! one function with plain values, because a browser opens no other file beside a page. What is
//! shown was derived from rows by [`check`](crate::check); the site computes nothing that a rank
//! depends on.
//!
//! ```text
//! index.html  compare.html  style.css  board.js  compare.js  site.yaml
//! protocols/NAME.html   methods/METHOD.html   badges/METHOD.svg
//! csv/leaderboard.csv   csv/SECTION.csv       data/SECTION/METHOD.js
//! ```

mod badge;
mod compare;
mod data;
mod frame;
mod index;
mod memory;
mod method;
mod ranking;
mod rules;
mod tables;

use std::collections::BTreeSet;
use std::path::Path;

use strat_store::claim::Mark;
use strat_store::files;

use self::memory::Site;
use crate::board::BoardError;
use crate::check::Checked;
use crate::section::{Section, sections};
use crate::web::{SORT, STYLE};

/// Whose a site's folder is.
pub const MARK: Mark = Mark {
    command: "bench leaderboard page",
    record: "site.yaml",
    begins: "strat_site: 1\n",
    writes: |name| FILES.contains(&name) || FOLDERS.contains(&name),
};

const FILES: [&str; 6] = [
    "index.html",
    "compare.html",
    "style.css",
    "board.js",
    "compare.js",
    "site.yaml",
];

const FOLDERS: [&str; 5] = ["protocols", "methods", "badges", "csv", "data"];

/// What was written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Written {
    /// Files.
    pub files: usize,
    /// Bytes in them.
    pub bytes: u64,
    /// Rankings.
    pub sections: usize,
}

/// Looks at the folder of a site before any work.
///
/// # Errors
/// It holds something else than a site, or lies in the leaderboard where something else would be
/// written over.
pub fn examine(out: &Path, leaderboard: &Path) -> Result<(), BoardError> {
    // A site within the leaderboard's folder is usual: `--out site`.
    let inputs = [
        leaderboard.join(crate::board::SUBMISSIONS),
        leaderboard.join(crate::board::PUBLISHED),
        leaderboard.join(crate::board::BOARD),
    ];
    let inputs: Vec<&Path> = inputs.iter().map(std::path::PathBuf::as_path).collect();
    MARK.examine(out, &inputs)?;
    Ok(())
}

/// Writes the site of a leaderboard that was checked with the numbers of its images, and removes what
/// an earlier one had and this one lacks.
///
/// # Errors
/// The folder cannot be written to.
pub fn write(checked: &Checked, out: &Path) -> Result<Written, BoardError> {
    let sections = sections(checked);
    let site = build(checked, &sections)?;
    MARK.begin(out)?;
    MARK.reopen(out)?;
    let mut kept: BTreeSet<&str> = BTreeSet::new();
    let mut bytes = 0;
    for (path, content) in &site.files {
        let target = out.join(path);
        // Most of a site stays the same from one submission to the next.
        let is_there = std::fs::metadata(&target)
            .is_ok_and(|found| found.len() == content.len() as u64)
            && std::fs::read(&target).is_ok_and(|there| there == *content);
        if !is_there {
            files::write_atomic(&target, content)?;
        }
        kept.insert(path);
        bytes += content.len() as u64;
    }
    for folder in FOLDERS {
        remove_others(out, folder, &kept)?;
    }
    MARK.finish(out, record(checked, &site).as_bytes())?;
    Ok(Written {
        files: site.files.len(),
        bytes,
        sections: sections.len(),
    })
}

fn build(checked: &Checked, sections: &[Section<'_>]) -> Result<Site, BoardError> {
    let mut site = Site::default();
    site.add("style.css", format!("{STYLE}{}", include_str!("board.css")));
    site.add("board.js", format!("{SORT}{}", include_str!("board.js")));
    site.add("compare.js", include_str!("compare.js"));
    site.add("index.html", index::page(checked, sections));
    site.add("compare.html", compare::page(checked));
    for page in ranking::pages(checked, sections) {
        site.add(page.0, page.1);
    }
    for submission in &checked.submissions {
        let id = &submission.id;
        site.add(
            format!("methods/{id}.html"),
            method::page(checked, sections, submission),
        );
        site.add(format!("badges/{id}.svg"), badge::svg(sections, submission));
    }
    data::add(&mut site, sections);
    tables::add(&mut site, checked, sections)?;
    Ok(site)
}

fn record(checked: &Checked, site: &Site) -> String {
    format!(
        "{}# Written by `bench leaderboard page`, which replaces this folder's {} and {}.\n\
         bench: {}\nsubmissions: {}\nfiles: {}\n",
        MARK.begins,
        FILES.join(", "),
        FOLDERS.join("/, "),
        env!("CARGO_PKG_VERSION"),
        checked.submissions.len(),
        site.files.len()
    )
}

/// Removes what lies in a folder of the site, two deep, and does not belong to it now.
fn remove_others(out: &Path, folder: &str, kept: &BTreeSet<&str>) -> Result<(), BoardError> {
    for name in files::names_in(&out.join(folder))? {
        let path = format!("{folder}/{}", name.to_string_lossy());
        let below = format!("{path}/");
        let is_folder = out
            .join(&path)
            .symlink_metadata()
            .is_ok_and(|found| found.is_dir());
        if is_folder
            && kept
                .range(below.as_str()..)
                .next()
                .is_some_and(|first| first.starts_with(&below))
        {
            remove_others(out, &path, kept)?;
        } else if !kept.contains(path.as_str()) {
            files::remove(&out.join(&path))?;
        }
    }
    Ok(())
}
