//! What the subcommands say at their end.

use std::path::Path;

use serde::Serialize;
use strat_splits::Role;
use strat_store::command::{CliError, DONE, FAILED, eprint_line, print_line};
use strat_store::layout::FAILURES;
use strat_store::shard::Shard;

use crate::kitti::inventory;
use crate::set::writer::Report;

/// JSON for scripts.
pub(super) fn json(value: &impl Serialize) -> Result<String, CliError> {
    serde_json::to_string_pretty(value).map_err(CliError::failed)
}

/// What a set is for: training where it has pairs to train on, else evaluation.
fn next_step(report: &Report, out: &str) -> String {
    let manifest = &report.set.manifest;
    let trains = manifest
        .counts
        .get(&Role::Train)
        .is_some_and(|count| count.found > 0);
    match (trains, manifest.content.split()) {
        (true, Some(split)) => format!(
            "next: train --config {split}-strat --data {out} --out runs/first, or bench eval --table all --data {out} \
             -m MODEL.onnx -o results"
        ),
        (true, None) => format!("next: train --config kitti-strat --data {out} --out runs/first"),
        (false, _) => format!(
            "next: bench eval --table all --data {out} -m MODEL.onnx -o results, or with your own maps --predictions \
             NAME=MAPS.npy"
        ),
    }
}

/// Prints what was made; [`FAILED`] if something could not be used.
pub(super) fn conclude(
    out: &Path,
    shard: Option<Shard>,
    quiet: bool,
    report: &Report,
) -> Result<u8, CliError> {
    let manifest = &report.set.manifest;
    let content = match manifest.content.split() {
        Some(split) => format!("{split} split, {} data", manifest.source),
        None => manifest.content.to_string(),
    };
    let out = out.display();
    let mut text = inventory::summary(&manifest.counts);
    if report.written + report.kept > 0 {
        text += &format!("\n{} files written, {} kept", report.written, report.kept);
    }
    text += &match shard {
        Some(shard) => format!(
            "\npart {shard} of {out} ({content}); when all parts are there: prep merge {out}"
        ),
        None => format!("\nset {out} ({content})\ndigest {}", manifest.data_digest),
    };
    print_line(text)?;
    for doubt in &report.doubts {
        eprint_line(format_args!("warning: {doubt}"));
    }
    for path in &report.foreign {
        eprint_line(format_args!(
            "note: {} belongs to no part and stays",
            path.display()
        ));
    }
    if report.failures.is_empty() {
        if shard.is_none() && !quiet {
            eprint_line(next_step(report, &out.to_string()));
        }
        return Ok(DONE);
    }
    eprint_line(format_args!(
        "error: {} inputs could not be used; they are listed in {}. Put them right and run the same \
         command again: only what is missing is made.",
        report.failures.len(),
        report.set.root.join(FAILURES).display()
    ));
    Ok(FAILED)
}
