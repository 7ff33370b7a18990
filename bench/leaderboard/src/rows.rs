//! Rows of a submission: read within bounds, and held against what rows can be.

use std::collections::{BTreeMap, HashSet};
use std::io::Read;
use std::path::Path;
use std::sync::LazyLock;

use flate2::read::GzDecoder;
use strat_metrics::{Grouping, Protocol, Row, RowContext, protocol, rows};
use strat_splits::{Split, test_ids};
use strat_store::human;
use strat_store::inputs::{self, Kind};

use crate::board::Board;
use crate::card::shown;
use crate::text::{check_digest, check_id, check_name};

/// The file of rows, compressed.
pub const ROWS_GZ: &str = "rows.csv.gz";

/// The file of rows, plain.
pub const ROWS: &str = "rows.csv";

/// The file's name and its rows.
///
/// # Errors
/// The name of the file, and a sentence.
pub(crate) fn read(folder: &Path) -> Result<(&'static str, Vec<Row>), (&'static str, String)> {
    let is_there = |name: &str| folder.join(name).symlink_metadata().is_ok();
    match (is_there(ROWS_GZ), is_there(ROWS)) {
        (true, true) => Err((
            ROWS,
            format!("there are {ROWS} and {ROWS_GZ}; keep one of them"),
        )),
        (false, false) => Err((
            ROWS_GZ,
            format!("no rows: {ROWS_GZ} or {ROWS} is needed; `bench publish` writes it"),
        )),
        (true, false) => unpack(&folder.join(ROWS_GZ))
            .map(|rows| (ROWS_GZ, rows))
            .map_err(|e| (ROWS_GZ, e)),
        (false, true) => plain(&folder.join(ROWS))
            .map(|rows| (ROWS, rows))
            .map_err(|e| (ROWS, e)),
    }
}

fn plain(path: &Path) -> Result<Vec<Row>, String> {
    let bytes = inputs::read(path, Kind::Submission).map_err(|error| error.to_string())?;
    rows::read(bytes.as_slice()).map_err(|error| error.to_string())
}

fn unpack(path: &Path) -> Result<Vec<Row>, String> {
    let file = inputs::open(path, Kind::Submission).map_err(|error| error.to_string())?;
    let most = Kind::Submission.largest();
    let mut bytes = Vec::new();
    GzDecoder::new(file)
        .take(most + 1)
        .read_to_end(&mut bytes)
        .map_err(|error| format!("it cannot be unpacked: {error}"))?;
    if bytes.len() as u64 > most {
        return Err(format!(
            "unpacked it has more than {}, the most that rows of a submission may have; submit \
             only protocols of the leaderboard",
            human::bytes(most)
        ));
    }
    rows::read(bytes.as_slice()).map_err(|error| error.to_string())
}

/// Ids of the test images of a split of KITTI.
fn ids_of(split: &str) -> Option<&'static HashSet<String>> {
    static KITTI: LazyLock<HashSet<String>> =
        LazyLock::new(|| test_ids(Split::Kitti).into_iter().collect());
    static EIGEN: LazyLock<HashSet<String>> =
        LazyLock::new(|| test_ids(Split::Eigen).into_iter().collect());
    match split.parse().ok()? {
        Split::Kitti => Some(&KITTI),
        Split::Eigen => Some(&EIGEN),
    }
}

/// The protocol of a row's context, and the sentences about all of it that cannot be.
pub(crate) fn check_context(context: &RowContext, board: &Board) -> Vec<String> {
    let mut problems = Vec::new();
    let texts = [
        ("model", &context.model),
        ("model_hash", &context.model_hash),
        ("protocol", &context.protocol),
        ("split", &context.split),
        ("runtime", &context.runtime),
        ("provider", &context.provider),
        ("tool_version", &context.tool_version),
    ];
    let texts = texts
        .into_iter()
        .map(|(column, text)| (column, text.as_str()));
    for (column, text) in texts.chain(context.variant.as_deref().map(|text| ("variant", text))) {
        let may_lack = ["runtime", "provider", "split"].contains(&column) && text.is_empty();
        if let (false, Err(why)) = (may_lack, check_name(text)) {
            problems.push(format!("column {column:?}: {} {why}", shown(text)));
        }
    }
    if !problems.is_empty() {
        return problems;
    }
    problems.extend(check_protocol(context).err());
    problems.extend(check_data(context, board).err());
    problems
}

fn check_protocol(context: &RowContext) -> Result<Protocol, String> {
    let RowContext {
        protocol: name,
        protocol_digest: digest,
        ..
    } = context;
    let Some(rules) = protocol(name) else {
        return Err(format!(
            "{name} is not a protocol of this version ({}); leaderboards rank the protocols that \
             `bench protocols` lists, and rules of your own stay in your own tables",
            env!("CARGO_PKG_VERSION")
        ));
    };
    if rules.digest() != *digest {
        return Err(format!(
            "rows of {name} were measured under other rules: their digest is {}, that of this \
             version's {name} is {:.12}; measure again with bench {}",
            shown(digest.get(..12).unwrap_or(digest)),
            rules.digest(),
            env!("CARGO_PKG_VERSION")
        ));
    }
    Ok(rules)
}

fn check_data(context: &RowContext, board: &Board) -> Result<(), String> {
    let RowContext {
        data_digest: digest,
        split,
        ..
    } = context;
    if let Err(why) = check_digest(digest) {
        return Err(format!("column \"data_digest\": {} {why}", shown(digest)));
    }
    let Some(data) = board.data_set(digest) else {
        let known: Vec<String> = board
            .data
            .iter()
            .map(|data| format!("{:.12} ({})", data.digest, data.name))
            .collect();
        return Err(format!(
            "rows were measured on data set {digest:.12}, which is not one of this leaderboard ({}); \
             measure on one of those, or ask its maintainers to add yours to leaderboard.yaml",
            if known.is_empty() {
                "it has none yet".to_owned()
            } else {
                known.join(", ")
            }
        ));
    };
    if data.split != *split {
        return Err(format!(
            "rows name the split {split:?}, but data set {digest:.12} is of {:?}",
            data.split
        ));
    }
    Ok(())
}

/// A sentence about the first row that cannot be: an image of no test set, or numbers that do not
/// belong together.
pub(crate) fn check_row(row: &Row) -> Result<(), String> {
    let context = &row.context;
    let image = &row.image;
    check_id(image).map_err(|why| format!("image {} {why}", shown(image)))?;
    if ids_of(&context.split).is_some_and(|ids| !ids.contains(image)) {
        return Err(format!(
            "image {image} is not a test image of the {} split",
            context.split
        ));
    }
    let score = &row.score;
    let metrics = &score.metrics;
    let wrong = |what: String| {
        Err(format!(
            "image {image} under {}: {what}; rows are submitted as `bench` wrote them",
            context.protocol
        ))
    };
    let pixels = score.pixels as f64;
    // The same sum in another order may differ in its last digits.
    let pooled = (score.sum_squared_error / pixels).sqrt();
    if (pooled - metrics.rmse).abs() > 1e-6 * (1.0 + pooled) {
        return wrong(format!(
            "rmse is {}, but sum_squared_error and pixels give {pooled}",
            metrics.rmse
        ));
    }
    let shares = [("a1", metrics.a1), ("a2", metrics.a2), ("a3", metrics.a3)];
    for (name, share) in shares {
        let count = share * pixels;
        if share > 1.0 || (count - count.round()).abs() > 1e-6 * (1.0 + pixels) {
            return wrong(format!(
                "{name} is {share}, which is no share of {} pixels",
                score.pixels
            ));
        }
    }
    if metrics.a1 > metrics.a2 || metrics.a2 > metrics.a3 {
        return wrong("a1, a2 and a3 do not grow".to_owned());
    }
    if score.d1_all.is_some_and(|percent| percent > 100.0) {
        return wrong("d1_all is above 100".to_owned());
    }
    if score
        .further
        .is_some_and(|further| further.mae > metrics.rmse * (1.0 + 1e-9))
    {
        return wrong("mae is above rmse".to_owned());
    }
    let grouping = protocol(&context.protocol).map_or(Grouping::None, |rules| rules.grouping);
    let fits = match score.group {
        None => grouping == Grouping::None,
        Some(group) => grouping.groups().contains(&group),
    };
    if !fits {
        return wrong("its group is none of the protocol's".to_owned());
    }
    Ok(())
}

/// Rows by protocol, protocols in the order of their first row.
pub(crate) fn by_protocol(rows: &[Row]) -> BTreeMap<&str, Vec<&Row>> {
    let mut parts: BTreeMap<&str, Vec<&Row>> = BTreeMap::new();
    for row in rows {
        parts.entry(&row.context.protocol).or_default().push(row);
    }
    parts
}
