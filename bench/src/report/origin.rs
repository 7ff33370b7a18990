//! Where the numbers come from: rules in words, commands, digests, versions and devices.

use std::path::Path;

use maud::{Markup, html};
use strat_metrics::Protocol;

use super::collect::{Collected, DataSet, Run};
use crate::{evaluate::record::ModelRecord, rows::compare::protocols_of};

/// The rules that rows were measured by, as the run wrote them down or as this program knows
/// them under the same digest.
pub(super) fn rules_of(set: &DataSet, name: &str) -> Option<Protocol> {
    let digest = set
        .rows
        .iter()
        .find(|row| row.context.protocol == name)
        .map(|row| row.context.protocol_digest.as_str())?;
    let written = set
        .runs
        .iter()
        .filter_map(|run| run.record.as_ref())
        .flat_map(|record| &record.protocols)
        .map(|record| record.rules.clone());
    written
        .chain(strat_metrics::protocol(name))
        .find(|protocol| protocol.name == name && protocol.digest() == digest)
}

pub(super) fn protocols(collected: &Collected) -> Markup {
    let mut known: Vec<Protocol> = Vec::new();
    for set in &collected.data_sets {
        for name in protocols_of(&set.rows) {
            let rules = rules_of(set, &name);
            known.extend(rules.filter(|rules| !known.contains(rules)));
        }
    }
    html! {
        @for protocol in &known {
            details {
                summary { strong { (protocol.name) } " (version " (protocol.version) ")" }
                p.quiet { "Digest " code { (protocol.digest()) } }
                ul { @for line in protocol.describe().lines() { li { (line) } } }
            }
        }
    }
}

pub(super) fn provenance(collected: &Collected) -> Markup {
    let run = |run: &Run| {
        let record = run.record.as_ref();
        html! {
            h3 { code { (run.folder.display()) } }
            @match record {
                None => p.quiet { "No run.yaml lies beside the rows: what ran is not known beyond the rows." },
                Some(record) => {
                    dl {
                        dt { "Command" } dd { code { "bench " (record.arguments.join(" ")) } }
                        dt { "Version" } dd { (record.tool) " " (record.tool_version) }
                        dt { "Data" } dd {
                            (record.data.content) " (" (record.data.source) "), "
                            (record.data.test_images_found) " of " (record.data.test_images_expected)
                            " test images, prepared by " (record.data.prepared_by)
                        }
                        dt { "Digest of the data" } dd { code { (record.data.data_digest) } }
                        @if let Some(digest) = &record.data.split_digest {
                            dt { "Digest of the split" } dd { code { (digest) } }
                        }
                        dt { "Device" } dd { (record.device) }
                        dt { "Runtime" } dd { (record.runtime) }
                        dt { "Threads" } dd { (record.jobs) " for images, " (record.threads) " within the model" }
                    }
                    @for one in &record.models { (model(one)) }
                }
            }
        }
    };
    html! { @for set in &collected.data_sets { @for one in &set.runs { (run(one)) } } }
}

fn model(record: &ModelRecord) -> Markup {
    let file = record.file.as_deref().map(Path::display);
    html! {
        details {
            summary { "Model " strong { (record.name) } }
            dl {
                @if let Some(file) = file { dt { "File" } dd { code { (file) } } }
                dt { "BLAKE3" } dd { code { (record.blake3) } }
                @if let Some(count) = record.parameters { dt { "Weights" } dd { (count) } }
                dt { "Ran on" } dd { (record.provider) ", " (record.runtime) }
                @if let Some(difference) = record.probe_max_difference {
                    dt { "Difference to the trainer" } dd { (format!("{difference:.1e} of the image width, at most")) }
                }
                @if let Some(input) = record.description.as_ref().map(|both| &both.input) {
                    dt { "Input" } dd { (input.size_text()) }
                }
                @if let Some(metadata) = &record.metadata {
                    @if let Some(variant) = &metadata.variant { dt { "Variant" } dd { (variant) } }
                    @if !metadata.train_drives.is_empty() {
                        dt { "Trained on" } dd { (metadata.train_drives.len()) " drives: " (metadata.train_drives.join(", ")) }
                    }
                }
                dt { "Images" } dd { (record.images) " in " (format!("{:.1}", record.seconds)) " s" }
                @if let Some(note) = &record.note { dt { "Note" } dd { (note) } }
            }
        }
    }
}
