//! Whose results a folder holds: a run replaces nothing but results of its own subcommand, and only
//! where it measures all that they hold again, or with `--force`.
//!
//! The mechanism is [`strat_store::claim`]'s; here is what makes two runs the same: the prepared
//! set, the settings that a record names, and every model under its name with the same content.

use std::path::Path;

use serde::Serialize;
use serde_yaml::Value;
use strat_store::{
    Error,
    claim::{Found, Mark},
    files, yaml,
};

use super::{
    NamedFile,
    agreed::AGREEMENTS,
    journal,
    record::{FAILURES, LEADERBOARD, ModelRecord, PICTURES, RECORD, ROWS, RunRecord},
    shards::IMAGES,
};

/// Whose a folder of rows and tables is. Journals are not named: each is known by what it holds.
pub const MARK: Mark = Mark {
    command: "bench --table",
    record: RECORD,
    begins: "tool: bench\n",
    writes: |name| {
        let fixed = [
            ROWS,
            FAILURES,
            RECORD,
            LEADERBOARD,
            IMAGES,
            AGREEMENTS,
            PICTURES,
        ];
        fixed.contains(&name) || is_table(name) || is_saved_prediction(name)
    },
};

/// Whether a file of this name is one that a part of a divided run leaves.
pub fn is_of_part(name: &str) -> bool {
    (MARK.writes)(name) || name.starts_with(journal::PREFIX)
}

fn is_saved_prediction(name: &str) -> bool {
    let ends = [".npy", ".ids.txt", ".yaml"];
    name.starts_with("predictions") && ends.iter().any(|end| name.ends_with(end))
}

/// Whether a file of this name is a table that a run has written.
pub fn is_table(name: &str) -> bool {
    let ends = [".txt", ".md", ".tex", ".csv", ".bib"];
    name.starts_with("table_") && ends.iter().any(|end| name.ends_with(end))
}

/// Removes the tables of an earlier run, which need not be those of this one.
///
/// # Errors
/// The folder cannot be read or a table not be removed.
pub fn remove_tables(out: &Path) -> Result<(), Error> {
    for name in files::names_in(out)? {
        if is_table(&name.to_string_lossy()) {
            files::remove(&out.join(name))?;
        }
    }
    Ok(())
}

/// What is going to be measured, as far as it is known before any work.
#[derive(Debug, Default)]
pub struct Planned<'a> {
    /// ONNX files.
    pub models: &'a [NamedFile],
    /// What has a name and is read later.
    pub named: Vec<&'a str>,
}

impl Planned<'_> {
    /// What of an earlier run, by names and BLAKE3, would not be measured again; the end of a
    /// sentence about it.
    pub fn lacks<'r>(
        &self,
        earlier: impl IntoIterator<Item = (&'r str, &'r str)>,
    ) -> Option<String> {
        earlier.into_iter().find_map(|(name, blake3)| {
            if self.named.contains(&name) {
                return None;
            }
            let Some(given) = self.models.iter().find(|given| given.name == name) else {
                return Some(format!("results of {name}, which is not measured now"));
            };
            match strat_onnx::model::read(&given.file) {
                Err(error) => Some(format!(
                    "results of {name}, which cannot be measured now: {error}"
                )),
                Ok(file) if file.blake3 != blake3 => Some(other_content(name)),
                Ok(_) => None,
            }
        })
    }
}

fn other_content(name: &str) -> String {
    format!("results of another file under the name {name}")
}

/// Refuses to replace what a folder holds: `what` is lost.
pub fn refuse(folder: &Path, what: &str) -> Error {
    Error::Output {
        path: folder.to_owned(),
        problem: format!("it has {what}; give another folder, or replace what it has with --force"),
    }
}

/// Looks at a folder of tables before anything is measured, and returns the record of the run whose
/// results it holds; none where there are no results, or with `force`.
///
/// # Errors
/// The folder holds something else, one of `inputs` is in the way, or results would be lost by a
/// run on the set with `data_digest`.
pub fn examine(
    folder: &Path,
    inputs: &[&Path],
    data_digest: &str,
    planned: &Planned<'_>,
    force: bool,
) -> Result<Option<RunRecord>, Error> {
    let earlier = earlier_results(folder, inputs)?;
    let Some(earlier) = earlier.filter(|_| !force) else {
        return Ok(None);
    };
    let measured = earlier.models.iter().filter(|model| model.images > 0);
    let measured = measured.map(|model| (model.name.as_str(), model.blake3.as_str()));
    let lost = if earlier.data.data_digest == data_digest {
        planned.lacks(measured)
    } else {
        Some(OTHER_SET.to_owned())
    };
    match lost {
        Some(what) => Err(refuse(folder, &what)),
        None => Ok(Some(earlier)),
    }
}

const OTHER_SET: &str = "results on another prepared set";

/// The record of the run whose results a folder holds; none where nothing was measured.
///
/// # Errors
/// The folder holds something else, or one of `inputs` is in the way.
pub fn earlier_results(folder: &Path, inputs: &[&Path]) -> Result<Option<RunRecord>, Error> {
    let found: Option<RunRecord> = match MARK.examine(folder, inputs)? {
        Found::Nothing => None,
        Found::Record => Some(yaml::load(&folder.join(RECORD))?),
        // A record, where a run was killed while it replaced results; else a mark alone.
        Found::Begun => yaml::load(&folder.join(MARK.begun())).ok(),
    };
    Ok(found.filter(|record| record.models.iter().any(|model| model.images > 0)))
}

/// What of an earlier run is not in a later one, now that it has been measured.
pub fn loses(earlier: &RunRecord, later: &RunRecord) -> Option<String> {
    if earlier.data.data_digest != later.data.data_digest {
        return Some(OTHER_SET.to_owned());
    }
    let before = earlier.models.iter().filter(|model| model.images > 0);
    let model = before.clone().find_map(|before| {
        let name = &before.name;
        let Some(now) = later.models.iter().find(|now| now.name == *name) else {
            return Some(format!(
                "results of {name}, which could not be measured now"
            ));
        };
        if let Some(what) = is_other(before, now) {
            return Some(what);
        }
        let lost = before
            .images
            .checked_sub(now.images)
            .filter(|&lost| lost > 0);
        lost.map(|lost| {
            format!(
                "results of {name} for {} images, of which {lost} could not be measured now",
                before.images
            )
        })
    });
    model.or_else(|| {
        let is_measured = |digest: &str| later.protocols.iter().any(|now| now.digest == digest);
        let mut protocols = earlier.protocols.iter();
        let lost = protocols.find(|before| !is_measured(&before.digest))?;
        Some(format!(
            "results under {}, which are not measured now",
            lost.name
        ))
    })
}

/// Whether a model is another than the one of the same name in an earlier run.
pub fn is_other(before: &ModelRecord, now: &ModelRecord) -> Option<String> {
    if before.identity.digest() == now.identity.digest() {
        return None;
    }
    let changes = before.identity.changes_to(&now.identity);
    Some(match changes {
        Some(changes) if before.blake3 == now.blake3 => {
            format!("other results of {}: {changes}", now.name)
        }
        _ => other_content(&now.name),
    })
}

/// For subcommands whose record is a mapping with `models` of `name` and `blake3`: looks at a folder
/// before any work. `settings` are what else makes a run the same, under the keys of the record;
/// with `force`, another run is replaced.
///
/// # Errors
/// The folder holds something else, one of `inputs` is in the way, or another run.
pub fn examine_record(
    mark: &Mark,
    folder: &Path,
    inputs: &[&Path],
    settings: &impl Serialize,
    planned: &Planned<'_>,
    force: bool,
) -> Result<Found, Error> {
    let found = mark.examine(folder, inputs)?;
    let path = folder.join(match found {
        Found::Nothing => return Ok(found),
        Found::Record => mark.record.to_owned(),
        Found::Begun => mark.begun(),
    });
    let earlier: Value = yaml::load(&path)?;
    if force {
        return Ok(found);
    }
    // As it would be read, so that numbers are rounded alike.
    let settings: Value = serde_yaml::from_str(&yaml::to_string(settings)?).unwrap_or_default();
    if let Some(key) = changed(&earlier, &settings) {
        let what = format!(
            "results of another run: `{key}` in {} differs",
            path.display()
        );
        return Err(refuse(folder, &what));
    }
    let models = earlier.get("models").and_then(Value::as_sequence);
    let held = models.into_iter().flatten().filter_map(|model| {
        let text = |key| model.get(key).and_then(Value::as_str);
        // Of a model without rows there is nothing to lose.
        if model
            .get("rows")
            .is_some_and(|rows| rows.as_u64() == Some(0))
        {
            return None;
        }
        Some((text("name")?, text("blake3")?))
    });
    match planned.lacks(held) {
        Some(what) => Err(refuse(folder, &what)),
        None => Ok(found),
    }
}

/// The first setting that an earlier record has with another value.
fn changed<'k>(earlier: &Value, settings: &'k Value) -> Option<&'k str> {
    let settings = settings.as_mapping().into_iter().flatten();
    let mut others = settings.filter(|(key, now)| {
        let before = key.as_str().and_then(|key| earlier.get(key));
        before.is_some_and(|before| before != *now)
    });
    others.next().and_then(|(key, _)| key.as_str())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_run_leaves_is_told_from_what_others_do() {
        for own in [
            "rows.csv",
            "table_3_3-median.tex",
            "predictions-a.ids.txt",
            "pictures",
        ] {
            assert!((MARK.writes)(own), "{own}");
        }
        for other in [
            "model.onnx",
            "table.csv",
            "unfinished-a.csv",
            "parts",
            "predictions",
        ] {
            assert!(!(MARK.writes)(other), "{other}");
        }
    }

    #[test]
    fn a_setting_that_is_in_both_must_be_the_same() {
        let value = |text: &str| serde_yaml::from_str::<Value>(text).unwrap();
        let earlier = value("{data_digest: a, images: [x, y], rest: 1}");
        let of = |text: &str| changed(&earlier, &value(text)).map(str::to_owned);
        assert_eq!(of("{data_digest: a, new: 3}"), None);
        assert_eq!(
            of("{data_digest: a, images: [x]}"),
            Some("images".to_owned())
        );
        // A mark of work begun alone says nothing of the run.
        assert_eq!(
            changed(&value("tool: bench cues"), &value("{images: []}")),
            None
        );
    }
}
