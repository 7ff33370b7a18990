//! One submission, verified from its own rows.
//!
//! Everything that is shown or ranked is derived here again; what the contributor wrote down is
//! only compared with it. Nothing of a submission is executed, and nothing outside its folder is
//! opened.

use std::collections::BTreeSet;
use std::path::Path;

use strat_metrics::{
    Row,
    leaderboard::{self, Entry},
    rows::ModelRows,
};
use strat_splits::{Leakage, leakage};
use strat_store::inputs::{self, Kind};
use strat_store::{files, yaml};

use crate::board::{Board, DataSet, SUBMISSIONS};
use crate::card::{Card, shown};
use crate::rows::{self, ROWS, ROWS_GZ};
use crate::run::{Run, mentions};
use crate::text::check_sentence;

/// The lines that a contributor claims.
pub const LINES: &str = "leaderboard.csv";

/// The record of the run.
pub const RUN: &str = "run.yaml";

/// What the contributor says of the method.
pub const CARD: &str = "card.yaml";

/// Sentences about one thing before the rest is counted.
const MOST_PROBLEMS: usize = 5;

/// Something that a contributor has to change.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Problem {
    /// The file, within the leaderboard.
    pub path: String,
    /// What is wrong and what to do.
    pub sentence: String,
}

impl std::fmt::Display for Problem {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}: {}", self.path, self.sentence)
    }
}

/// What was measured under one protocol, or for one group of it.
#[derive(Clone, Debug)]
pub struct Measured {
    /// The line, derived from the rows.
    pub line: Entry,
    /// All images of the data set that the protocol can score are there.
    pub whole: bool,
    /// Ids of the images, sorted; empty where only the check was asked for.
    pub images: Vec<String>,
    /// The seven metrics of each image.
    pub values: Vec<[f64; 7]>,
}

/// What was measured under one protocol.
#[derive(Clone, Debug)]
pub struct Scored {
    /// Name of the protocol.
    pub protocol: String,
    /// Digest of the data set.
    pub data_digest: String,
    /// Digest of the list of images.
    pub images_digest: String,
    /// Number of images.
    pub images: u64,
    /// Of how many.
    pub expected: u64,
    /// What of the test the model has seen.
    pub leakage: Leakage,
    /// The protocol as a whole, or its groups.
    pub parts: Vec<Measured>,
}

/// A submission whose rows bear out what it says.
#[derive(Clone, Debug)]
pub struct Submission {
    /// Name of its folder.
    pub id: String,
    /// What its contributor says.
    pub card: Card,
    /// What ran.
    pub run: Run,
    /// BLAKE3 of what identifies the model.
    pub model_hash: String,
    /// What was measured, protocol by protocol.
    pub scored: Vec<Scored>,
}

impl Submission {
    /// Number of lines.
    #[must_use]
    pub fn lines(&self) -> usize {
        self.scored.iter().map(|scored| scored.parts.len()).sum()
    }
}

/// Derives a submission again from its rows; with `keep`, the numbers of each image stay for pages.
///
/// # Errors
/// What its contributor has to change.
pub fn verify(
    folder: &Path,
    board: &Board,
    id: &str,
    keep: bool,
) -> Result<Submission, Vec<Problem>> {
    let own = folder.join(SUBMISSIONS).join(id);
    let about = |name: &str, sentence: String| Problem {
        path: match name {
            "" => format!("{SUBMISSIONS}/{id}"),
            name => format!("{SUBMISSIONS}/{id}/{name}"),
        },
        sentence,
    };
    let odd = foreign(&own);
    if !odd.is_empty() {
        return Err(odd
            .into_iter()
            .map(|(name, sentence)| about(&name, sentence))
            .collect());
    }
    let without_path = |name: &str, error: strat_store::Error| {
        vec![about(
            name,
            error
                .to_string()
                .replace(&format!("{}/", own.display()), ""),
        )]
    };
    let run: Run = yaml::load(&own.join(RUN)).map_err(|error| without_path(RUN, error))?;
    let card: Card = yaml::load(&own.join(CARD)).map_err(|error| without_path(CARD, error))?;
    let mut problems: Vec<Problem> = card
        .problems(&run)
        .into_iter()
        .map(|sentence| about(CARD, sentence))
        .collect();
    problems.extend(
        check_run(&run)
            .into_iter()
            .map(|sentence| about(RUN, sentence)),
    );
    if run.models.len() != 1 {
        return Err(problems);
    }
    let (name, found) = rows::read(&own).map_err(|(name, why)| {
        let why = why.replace(&format!("{}/", own.display()), "");
        problems.push(about(name, why));
        problems.clone()
    })?;
    let wrong = check_rows(&found, board, &run);
    if !wrong.is_empty() {
        problems.extend(wrong.into_iter().map(|sentence| about(name, sentence)));
        return Err(problems);
    }
    let claimed = read_lines(&own).map_err(|sentence| vec![about(LINES, sentence)])?;
    let mut scored = Vec::new();
    let mut derived = Vec::new();
    for (protocol, rows) in rows::by_protocol(&found) {
        // Known, because its context was checked.
        let Some(data) = board.data_set(&rows[0].context.data_digest) else {
            continue;
        };
        match score(protocol, &rows, data, &run, keep) {
            Ok(one) => {
                derived.extend(one.parts.iter().map(|part| part.line.clone()));
                scored.push(one);
            }
            Err(sentence) => problems.push(about(name, sentence)),
        }
    }
    let several = scored.iter().any(|one| one.images < one.expected);
    match (&card.partial, several) {
        (None, true) => {
            let part = scored.iter().find(|one| one.images < one.expected);
            problems.extend(part.map(|part| {
                let missing = missing(part, &found, &card);
                about(name, missing)
            }));
        }
        (Some(_), false) => problems.push(about(
            CARD,
            "`partial` is said, but no image is missing; take the line out".to_owned(),
        )),
        _ => {}
    }
    if problems.is_empty() {
        let wrong = differences(&claimed, &derived);
        problems.extend(wrong.into_iter().map(|sentence| about(LINES, sentence)));
    }
    let words = unsaid(&scored, &run);
    problems.extend(words.map(|sentence| about(RUN, sentence)));
    if !problems.is_empty() {
        return Err(problems);
    }
    Ok(Submission {
        id: id.to_owned(),
        model_hash: found[0].context.model_hash.clone(),
        card,
        run,
        scored,
    })
}

/// What a submission's folder should not hold, or lacks.
fn foreign(folder: &Path) -> Vec<(String, String)> {
    let names = match files::names_in(folder) {
        Ok(names) => names,
        Err(error) => return vec![(String::new(), error.to_string())],
    };
    let mut odd = Vec::new();
    for name in &names {
        let text = name.to_string_lossy();
        let kind = folder
            .join(name)
            .symlink_metadata()
            .map(|found| found.file_type());
        let sentence = if ![ROWS, ROWS_GZ, LINES, RUN, CARD].contains(&&*text) {
            format!(
                "{} does not belong into a submission, which has {ROWS_GZ} (or {ROWS}), {LINES}, {RUN} and {CARD}",
                shown(&text)
            )
        } else if kind.is_ok_and(|kind| kind.is_file()) {
            continue;
        } else {
            format!("{text} is a link or folder; a submission has plain files only")
        };
        odd.push((String::new(), sentence));
    }
    for needed in [LINES, RUN, CARD] {
        if !names.iter().any(|name| name == needed) {
            odd.push((
                needed.to_owned(),
                "it is missing; `bench publish` writes it".to_owned(),
            ));
        }
    }
    odd.sort();
    odd.truncate(MOST_PROBLEMS);
    odd
}

fn check_run(run: &Run) -> Vec<String> {
    let mut problems = Vec::new();
    if run.models.len() != 1 {
        problems.push(format!(
            "it has {} models; a submission has one, which `bench publish --model NAME` picks out",
            run.models.len()
        ));
    }
    let notes = run.models.iter().filter_map(|model| model.note.as_ref());
    for text in run.warnings.iter().chain(notes) {
        if let Err(why) = check_sentence(text) {
            problems.push(format!("the sentence {:?} {why}", shown(text)));
        }
    }
    problems
}

fn check_rows(found: &[Row], board: &Board, run: &Run) -> Vec<String> {
    let Some(first) = found.first() else {
        return vec!["it has no rows".to_owned()];
    };
    let mut problems: BTreeSet<String> = BTreeSet::new();
    let mut known: Vec<&strat_metrics::RowContext> = Vec::new();
    let mut more = 0;
    for row in found {
        let context = &row.context;
        // Lines of one protocol stand together, so this is short.
        if !known.iter().rev().take(4).any(|other| *other == context) {
            known.push(context);
            problems.extend(rows::check_context(context, board));
            problems.extend(beside_run(context, first, run));
        }
        if let Err(why) = rows::check_row(row) {
            if problems.len() < MOST_PROBLEMS {
                problems.insert(why);
            } else {
                more += 1;
            }
        }
    }
    let mut problems: Vec<String> = problems.into_iter().take(MOST_PROBLEMS).collect();
    if more > 0 {
        problems.push(format!("and {more} more rows like these"));
    }
    problems
}

/// What a row's context says otherwise than `run.yaml` or the first row.
fn beside_run(context: &strat_metrics::RowContext, first: &Row, run: &Run) -> Vec<String> {
    let mut problems = Vec::new();
    let Some(model) = run.models.first() else {
        return problems;
    };
    if context.model != model.name {
        problems.push(format!(
            "rows of {} in the submission of {}; a submission has one method",
            shown(&context.model),
            shown(&model.name)
        ));
    }
    if context.model_hash != first.context.model_hash {
        problems.push(format!(
            "rows of two models under one name: {:.12} and {:.12}",
            first.context.model_hash, context.model_hash
        ));
    }
    if context.data_digest != run.data.data_digest {
        problems.push(format!(
            "rows were measured on data set {:.12}, {RUN} is about {:.12}",
            context.data_digest,
            shown(&run.data.data_digest)
        ));
    }
    let recorded = run
        .protocols
        .iter()
        .find(|one| one.name == context.protocol);
    if recorded.is_some_and(|one| one.digest != context.protocol_digest) {
        problems.push(format!(
            "rows of {} carry another digest than {RUN} has for it",
            context.protocol
        ));
    }
    problems
}

fn read_lines(folder: &Path) -> Result<Vec<Entry>, String> {
    let bytes = inputs::read(&folder.join(LINES), Kind::Submission).map_err(|error| {
        error
            .to_string()
            .replace(&format!("{}/", folder.display()), "")
    })?;
    leaderboard::read(bytes.as_slice()).map_err(|error| error.to_string())
}

/// The rows of one protocol as lines.
fn score(
    protocol: &str,
    rows: &[&Row],
    data: &DataSet,
    run: &Run,
    keep: bool,
) -> Result<Scored, String> {
    let model = ModelRows::new(rows.to_vec()).map_err(|error| error.to_string())?;
    let images: BTreeSet<&str> = model.rows().iter().map(|row| row.image.as_str()).collect();
    let expected = data.under(protocol);
    let found = images.len() as u64;
    if found > expected {
        return Err(format!(
            "{found} images under {protocol}, but data set {} has {expected}",
            data.name
        ));
    }
    let lines = leaderboard::lines(&model, data.split_under(protocol));
    let parts = lines.into_iter().map(|line| {
        let rows = if keep {
            model.of_group(line.group)
        } else {
            Vec::new()
        };
        Measured {
            whole: found == expected,
            images: rows.iter().map(|row| row.image.clone()).collect(),
            values: rows
                .iter()
                .map(|row| row.score.metrics.to_array())
                .collect(),
            line,
        }
    });
    let list: Vec<&str> = images.iter().copied().collect();
    Ok(Scored {
        protocol: protocol.to_owned(),
        data_digest: data.digest.clone(),
        images_digest: files::blake3_hex(list.join("\n").as_bytes()),
        images: found,
        expected,
        leakage: leakage(
            run.models.first().and_then(|model| model.training()),
            &data.split,
            images.iter().copied(),
        ),
        parts: parts.collect(),
    })
}

/// Why a submission is not complete, naming some of what is missing.
fn missing(part: &Scored, rows: &[Row], card: &Card) -> String {
    let ids = rows
        .iter()
        .find(|row| row.context.protocol == part.protocol)
        .and_then(|row| row.context.split.parse().ok())
        .map(strat_splits::test_ids)
        .unwrap_or_default();
    let have: BTreeSet<&str> = rows
        .iter()
        .filter(|row| row.context.protocol == part.protocol)
        .map(|row| row.image.as_str())
        .collect();
    let lacking: Vec<&str> = ids
        .iter()
        .map(String::as_str)
        .filter(|id| !have.contains(id))
        .take(3)
        .collect();
    // Of a set that is itself a part of its split, which images it has is known to its owner only.
    let named = match ids.len() as u64 == part.expected && !lacking.is_empty() {
        true => format!(", such as {}", lacking.join(", ")),
        false => String::new(),
    };
    format!(
        "{} of {} images under {}: {} are missing{named}; submit all rows of {}, or say in {CARD} why not \
         (`partial: ...`), which leaves it without a rank",
        part.images,
        part.expected,
        part.protocol,
        part.expected - part.images,
        shown(&card.method)
    )
}

/// Where the lines that are claimed differ from those that follow from the rows.
fn differences(claimed: &[Entry], derived: &[Entry]) -> Vec<String> {
    let mut sentences = Vec::new();
    let of = |entry: &Entry| match entry.group {
        Some(group) => format!("{}, {group}", entry.protocol),
        None => entry.protocol.clone(),
    };
    for line in derived {
        let same = claimed
            .iter()
            .filter(|other| (&other.protocol, other.group) == (&line.protocol, line.group));
        let same: Vec<&Entry> = same.collect();
        match same[..] {
            [] => sentences.push(format!(
                "the line of {} is missing; write it again with `bench publish`",
                of(line)
            )),
            [one] => {
                let (mine, theirs) = (line.cells(), one.cells());
                let cells = leaderboard::COLUMNS.iter().zip(theirs.iter().zip(&mine));
                let first = cells.filter(|(_, (claimed, rows))| claimed != rows).take(1);
                sentences.extend(first.map(|(column, (claimed, rows))| {
                    format!(
                        "{column} under {} is {}, but the rows give {}; lines are derived, so write \
                         them again with `bench publish`",
                        of(line),
                        if claimed.is_empty() { "empty".to_owned() } else { shown(claimed) },
                        if rows.is_empty() { "nothing" } else { rows }
                    )
                }));
            }
            _ => sentences.push(format!("{} is there {} times", of(line), same.len())),
        }
    }
    let known = |entry: &&Entry| {
        !derived
            .iter()
            .any(|line| (&line.protocol, line.group) == (&entry.protocol, entry.group))
    };
    if let Some(entry) = claimed.iter().find(known) {
        sentences.push(format!(
            "{} has no rows here; every line needs its rows",
            shown(&of(entry))
        ));
    }
    sentences.truncate(MOST_PROBLEMS);
    sentences
}

/// What is missing of the two things that `bench` writes about leakage: the training that `run.yaml`
/// tells of, and the words that follow from it. That both were taken out cannot be seen.
fn unsaid(scored: &[Scored], run: &Run) -> Option<String> {
    let model = run.models.first()?;
    let said = |warning: &String| warning.starts_with("LEAKAGE") && mentions(warning, &model.name);
    let is_said = run.warnings.iter().any(said);
    if is_said && !model.training().is_some_and(|training| training.is_told()) {
        return Some(format!(
            "a warning says that the model has seen drives of the test, but its training (`metadata`) is \
             missing; submit {RUN} as `bench` wrote it"
        ));
    }
    let mut leaks = scored.iter().map(|one| &one.leakage);
    let leak = leaks
        .find(|leak| matches!(leak, Leakage::Drives { .. } | Leakage::OtherSplit { .. }))
        .filter(|_| !is_said)?;
    Some(format!(
        "the warning about leakage is missing: the model was {leak}; submit {RUN} as `bench` wrote it"
    ))
}
