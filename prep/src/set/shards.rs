//! Preparing a set in parts on several machines, and making one set of the parts.
//!
//! Every run gets the same inputs, options and output folder and a [`Shard`]. A sample belongs to
//! a shard by the hash of its name alone, so the division is the same everywhere and stays the
//! same while inputs are still arriving. Image and depth files go straight to where they belong;
//! of its tables a shard writes a part of its own, `parts/0003-of-0008/`, whose manifest comes
//! last and marks the part as complete. [`merge`] checks that all parts are there and of one
//! kind, and writes the tables of the whole, byte for byte those of a single run.
//!
//! Nothing here starts processes on other machines: that is the work of Slurm or any other queue.

use std::collections::BTreeMap;
use std::path::Path;

use strat_splits::{FrameId, Role, Split, test_ids, training, validation};
use strat_store::files;
use strat_store::inputs::{self, Kind};
use strat_store::layout::{FAILURES, FRAMES, MANIFEST, SETTINGS, table_name};
use strat_store::set::{Manifest, PreparedSet};
use strat_store::shard::{PARTS, Shard};

use super::results::{Failure, Order, Results, order};
use super::settings::Settings;
use super::writer::Report;
use crate::error::{Error, Result};

/// Makes one set of the parts in `out` and removes them.
///
/// # Errors
/// There are no parts, some are missing or incomplete (they are named, with what to run again),
/// they do not belong together, or the tables cannot be written.
pub fn merge(out: &Path) -> Result<Report> {
    let wrong = |problem: String| Error::Output {
        path: out.to_owned(),
        problem,
    };
    if !out.join(SETTINGS).is_file() {
        return Err(wrong(format!(
            "it has no {SETTINGS}, so no `prep ... --shard` has written here; give the folder those runs had \
             as --out"
        )));
    }
    let settings: Settings = Settings::load(out)?;
    files::remove_leftovers(out)?;
    let shards = Shard::found_in(out).map_err(&wrong)?;
    let Some(count) = shards.first().map(|shard| shard.count) else {
        return Err(wrong(if PreparedSet::open(out).is_ok() {
            "it has no parts and is a finished set: nothing is left to merge".to_owned()
        } else {
            "it has no parts; run `prep ... --shard 0/N` to N-1/N first".to_owned()
        }));
    };
    if let Some(other) = shards.iter().find(|shard| shard.count != count) {
        return Err(wrong(format!(
            "it has parts of {count} and parts of {}; remove the folders of the division that is not meant \
             from {PARTS}/",
            other.count
        )));
    }
    let (parts, lacking) = open_parts(out, count);
    if !lacking.is_empty() {
        let list: Vec<_> = lacking.iter().map(ToString::to_string).collect();
        return Err(Error::Incomplete(format!(
            "{} of {count} parts of {} are missing or incomplete, so nothing was merged: {}. Run them again \
             with the same options: --shard {}; in a Slurm array: SHARDS={count} sbatch --array={}",
            lacking.len(),
            out.display(),
            list.join(", "),
            list.join(", --shard "),
            lacking
                .iter()
                .map(|shard| shard.index.to_string())
                .collect::<Vec<_>>()
                .join(",")
        )));
    }
    let results = gather(&parts, &settings).map_err(&wrong)?;
    let set = results.write(out, &settings)?;
    let kept = Shard::remove_all(out, is_of_part)?;
    Ok(Report {
        set,
        failures: results.failures,
        written: 0,
        kept: 0,
        doubts: Vec::new(),
        foreign: kept,
    })
}

/// Whether a file of this name is one that a part writes into its folder.
fn is_of_part(name: &str) -> bool {
    let tables = Role::ALL.map(table_name);
    [MANIFEST, FAILURES, FRAMES].contains(&name) || tables.iter().any(|table| table == name)
}

/// All complete parts and the shards whose part is not.
fn open_parts(out: &Path, count: u32) -> (Vec<(Shard, PreparedSet)>, Vec<Shard>) {
    let (mut parts, mut lacking) = (Vec::new(), Vec::new());
    for index in 0..count {
        let shard = Shard { index, count };
        match PreparedSet::open(&shard.folder(out)) {
            Ok(part) => parts.push((shard, part)),
            Err(_) => lacking.push(shard),
        }
    }
    (parts, lacking)
}

/// The contents of all parts in the order of the split or list.
fn gather(
    parts: &[(Shard, PreparedSet)],
    settings: &Settings,
) -> std::result::Result<Results, String> {
    let order = match settings.content.split() {
        Some(split) => order_of_split(split),
        None => order_of_list(parts)?,
    };
    let mut results = Results::default();
    for (shard, part) in parts {
        let expected = belongs(*shard, &part.manifest, settings)?;
        if *shard == parts[0].0 {
            results.expected = expected;
        } else if results.expected != expected {
            return Err(format!(
                "part {shard} expects other numbers of samples than the first"
            ));
        }
        for role in Role::ALL {
            let samples = part.samples(role).map_err(|e| e.to_string())?;
            for sample in samples {
                if !shard.has(&sample.id) || !order.contains_key(&(role, sample.id.clone())) {
                    return Err(format!(
                        "part {shard} holds {role} sample {}, which does not belong to it",
                        sample.id
                    ));
                }
                results.samples.entry(role).or_default().push(sample);
            }
        }
        results.failures.extend(failures_of(part)?);
    }
    results.sort(&order);
    Ok(results)
}

/// Position of every sample in the order in which a single run goes through the split.
fn order_of_split(split: Split) -> Order {
    let frames = |frames: Vec<FrameId>| frames.iter().map(FrameId::to_string).collect();
    let names: [(Role, Vec<String>); 3] = [
        (Role::Train, frames(training(split))),
        (Role::Val, frames(validation(split))),
        (Role::Test, test_ids(split)),
    ];
    let names = names
        .iter()
        .flat_map(|(role, ids)| ids.iter().map(|id| (*role, &**id)));
    order(names)
}

/// Position of every sample in the list that all parts were made from.
fn order_of_list(parts: &[(Shard, PreparedSet)]) -> std::result::Result<Order, String> {
    let read = |part: &PreparedSet| {
        inputs::read(&part.root.join(FRAMES), Kind::Table).map_err(|e| e.to_string())
    };
    let Some((first, part)) = parts.first() else {
        return Ok(Order::new());
    };
    let list = read(part)?;
    for (shard, part) in parts {
        if read(part)? != list {
            return Err(format!(
                "parts {first} and {shard} were made from different frames, so their inputs had changed \
                 between them; run all parts again: finished files are kept"
            ));
        }
    }
    let names = strat_csv::Reader::without_header(&*list).deserialize::<(Role, String)>();
    let names = names.map_err(|e| format!("{FRAMES} of part {first} is damaged: {e}"))?;
    Ok(order(names.iter().map(|(role, id)| (*role, &**id))))
}

/// Checks that a part was made with `settings` by this version; the samples it expects per role.
fn belongs(
    shard: Shard,
    manifest: &Manifest,
    settings: &Settings,
) -> std::result::Result<BTreeMap<Role, u64>, String> {
    let wanted = (
        settings.content,
        settings.content.split().map(strat_splits::digest),
        settings.source.as_str(),
        (settings.image_width, settings.image_height),
        settings.kernel,
        settings.codec.to_string(),
    );
    let found = (
        manifest.content,
        manifest.split_digest.clone(),
        manifest.source.as_str(),
        (manifest.image_width, manifest.image_height),
        manifest.kernel,
        manifest.codec.clone(),
    );
    if wanted != found {
        return Err(format!(
            "part {shard} was made with other options than {SETTINGS} states"
        ));
    }
    if manifest.tool_version != env!("CARGO_PKG_VERSION") {
        return Err(format!(
            "part {shard} was made by version {} of prep and this is {}; make it again",
            manifest.tool_version,
            env!("CARGO_PKG_VERSION")
        ));
    }
    let counts = manifest.counts.iter();
    Ok(counts
        .map(|(role, count)| (*role, count.expected))
        .collect())
}

fn failures_of(part: &PreparedSet) -> std::result::Result<Vec<Failure>, String> {
    let path = part.root.join(FAILURES);
    if !path.is_file() {
        return Ok(Vec::new());
    }
    let damaged = |e: strat_csv::Error| format!("{} is damaged: {e}", path.display());
    let bytes = inputs::read(&path, Kind::Table).map_err(|e| e.to_string())?;
    strat_csv::Reader::new(&*bytes)
        .deserialize()
        .map_err(damaged)
}
