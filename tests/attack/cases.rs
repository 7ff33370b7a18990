//! Everything that leaves files, as command lines, and what must be the same of two runs.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use crate::stage::{Ended, Stage, TRAINING, tree};

/// A command line that writes to `out`, and what was there before.
pub struct Case {
    pub name: &'static str,
    /// Lines that come first.
    pub before: Vec<String>,
    pub line: String,
    /// Points that are tried in the short form.
    pub short: usize,
}

/// Everything that leaves files.
pub fn cases() -> Vec<Case> {
    let case = |name: &'static str, before: &[&str], line: &str| Case {
        name,
        before: before.iter().map(ToString::to_string).collect(),
        line: line.to_owned(),
        short: if ["prep synth", "bench cues"].contains(&name) || name.starts_with("train") {
            1
        } else {
            2
        },
    };
    let size = "--width 64 --height 32 --jobs 1 --quiet";
    let eigen = format!("prep eigen --raw world/kitti_raw --allow-missing {size} --out out");
    let kitti = format!(
        "prep kitti --raw world/kitti_raw --stereo2015 world/kitti2015 --allow-missing {size} --out out"
    );
    let pairs = format!("prep pairs --csv pairs.csv {size} --out out");
    let export = "prep export eigen --kind velodyne --out out --format";
    let few = "--runtime embedded --jobs 1 --quiet";
    let table = format!("bench --table all --data kitti {few} --out out --model");
    let rows = format!("bench --table all --data kitti {few} --out rows --model a=a.onnx");
    vec![
        case(
            "prep synth",
            &[],
            "prep synth --preset tiny --quiet --jobs 1 --out out",
        ),
        case("prep eigen", &[], &eigen),
        case("prep kitti", &[], &kitti),
        case("prep pairs", &[], &pairs),
        case(
            "prep merge",
            &[
                &format!("{pairs} --shard 0/2"),
                &format!("{pairs} --shard 1/2"),
            ],
            "prep merge out",
        ),
        case("prep export npy", &[], &format!("{export} npy")),
        case("prep export npz", &[], &format!("{export} npz")),
        case(
            "bench",
            &[],
            &format!("{table} a=a.onnx --median-baseline --pictures 1"),
        ),
        case(
            "bench, more models",
            &[&format!("{table} a=a.onnx")],
            &format!("{table} a=a.onnx --model b=b.onnx --save-predictions"),
        ),
        case(
            "bench --force",
            &[&format!("{table} b=b.onnx")],
            &format!("{table} a=a.onnx --force"),
        ),
        case(
            "bench merge",
            &[
                &format!("{table} a=a.onnx --shard 0/2"),
                &format!("{table} a=a.onnx --shard 1/2"),
            ],
            "bench merge out",
        ),
        case(
            "bench cues",
            &[],
            &format!(
                "bench cues size --data own --model a=a.onnx --backgrounds 5 --scales 3 {few} --out out"
            ),
        ),
        case(
            "bench predict",
            &[],
            &format!("bench predict photos --model a.onnx --format npy,color {few} --out out"),
        ),
        case(
            "bench figures",
            &[],
            &format!("bench figures --data kitti --model a=a.onnx --count 2 {few} --out out"),
        ),
        case(
            "bench render",
            &[&rows],
            "bench render --rows rows/rows.csv --out out",
        ),
        case(
            "bench publish",
            &[&rows],
            "bench publish --rows rows/rows.csv --to out/all.csv",
        ),
        case("train", &[], &format!("train {TRAINING} --out out")),
        case(
            "train --force",
            &[&format!(
                "train {TRAINING} --out out --set seed=4 --set max_steps=2"
            )],
            &format!("train {TRAINING} --out out --force"),
        ),
        case(
            "train export",
            &[],
            "train export trained --out out/model.onnx",
        ),
    ]
}

/// What a user types after a fault.
pub fn again(stage: &Stage, case: &Case) -> String {
    let is_run = stage.path("out/run.json").exists();
    if case.name == "train" && is_run {
        // Of settings that are given twice the last one counts.
        return format!("{} --resume", case.line);
    }
    case.line.clone()
}

impl Case {
    /// Makes what was there before.
    pub fn begin(&self, stage: &Stage) {
        for name in ["out", "rows"] {
            stage.remove(name);
        }
        self.before.iter().for_each(|line| stage.must(line));
    }
}

/// Runs a case again after something has happened and compares.
pub fn finish(stage: &Stage, case: &Case, whole: &BTreeMap<PathBuf, Vec<u8>>) -> Option<String> {
    let ended = stage.run(&again(stage, case), None);
    let is_done = ended.code == 0 || ended.stderr.contains("nothing is left to merge");
    if !is_done {
        return Some(format!(
            "then exit code {}: {}",
            ended.code,
            ended.stderr.trim()
        ));
    }
    difference(&results(stage), whole)
}

/// After an error: a sentence and exit code 1, or the work done in spite of it; and no half-written file
/// under the name of a result.
pub fn unharmed(
    stage: &Stage,
    failed: &Ended,
    before: &BTreeMap<PathBuf, Vec<u8>>,
    whole: &BTreeMap<PathBuf, Vec<u8>>,
) -> Option<String> {
    if let Some(crime) = failed.crime() {
        return Some(crime);
    }
    let found = results(stage);
    if failed.code == 0 {
        let what = difference(&found, whole)?;
        return Some(format!("exit code 0, but {what}"));
    }
    if failed.code != 1 {
        return Some(format!(
            "exit code {}: {}",
            failed.code,
            failed.stderr.trim()
        ));
    }
    found.iter().find_map(|(name, bytes)| {
        let known = [before, whole].map(|tree| tree.get(name));
        let is_whole = known.contains(&Some(bytes)) || grows(name);
        (!is_whole).then(|| format!("{} is half-written", name.display()))
    })
}

/// Whether a file is one that lines are added to, or one of work begun.
fn grows(name: &Path) -> bool {
    let text = name.to_string_lossy();
    text.contains("unfinished-") || text.contains(".partial-") || text.ends_with("scalars.csv")
        || text.ends_with("validation.csv") || text.ends_with("failures.csv")
        // They say which of the images were drawn, or that some failed.
        || text.ends_with("pictures.csv") || text.ends_with("predict.yaml")
}

/// Lines of records that say when and how something ran.
const OF_ONE_RUN: [&str; 3] = ["seconds:", "overhead:", "- --quiet"];

/// Files of the results that are the same in every run.
pub fn results(stage: &Stage) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = tree(&stage.path("out"));
    found.retain(|name, bytes| {
        let text = name.to_string_lossy();
        let records = ["run.yaml", "cues.yaml", "figures.yaml", "predict.yaml"];
        if records.iter().any(|record| text.ends_with(record)) {
            let lines = String::from_utf8_lossy(bytes).into_owned();
            let is_kept = |line: &&str| !OF_ONE_RUN.iter().any(|word| line.contains(word));
            let kept: Vec<&str> = lines.lines().filter(is_kept).collect();
            *bytes = kept.join("\n").into_bytes();
        }
        if text.ends_with(".bpk") {
            *bytes = weights(bytes);
        }
        !text.ends_with("checksums.b3")
            && !text.starts_with("tensorboard")
            && !text.ends_with(".lock")
    });
    found
}

/// What the tensors of a burnpack file hold, whatever they are called: its metadata carries the number of
/// each parameter, which burn draws anew in every process, and the moments of the optimizer are named by
/// these numbers and stand in their order. A header of 10 bytes ends in the size of the metadata; from the
/// next multiple of 256 on each tensor begins at one.
fn weights(pack: &[u8]) -> Vec<u8> {
    const BLOCK: usize = 256;
    let size = pack.get(6..10).and_then(|size| size.try_into().ok());
    let metadata = 10 + u32::from_le_bytes(size.unwrap_or_default()) as usize;
    let tensors = pack.get(metadata.next_multiple_of(BLOCK)..);
    let mut blocks: Vec<Vec<u8>> = tensors
        .unwrap_or_default()
        .chunks(BLOCK)
        .map(<[u8]>::to_vec)
        .collect();
    // Between tensors there are zeros, behind the last one nothing.
    if let Some(last) = blocks.last_mut() {
        last.resize(BLOCK, 0);
    }
    blocks.sort_unstable();
    blocks.concat()
}

pub fn difference(
    found: &BTreeMap<PathBuf, Vec<u8>>,
    whole: &BTreeMap<PathBuf, Vec<u8>>,
) -> Option<String> {
    let names = found.keys().chain(whole.keys());
    let differing = names.filter(|name| found.get(*name) != whole.get(*name));
    let mut differing: Vec<String> = differing.map(|name| name.display().to_string()).collect();
    differing.dedup();
    (!differing.is_empty()).then(|| format!("differs: {}", differing.join(", ")))
}
