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
    /// It works in processes of its own kind, of which a fault may meet one.
    pub starts_others: bool,
}

/// Folders that cases write to.
pub const FOLDERS: [&str; 4] = ["out", "rows", "board", "studied"];

/// Cases that the short form tries at one point only.
const SLOW: [&str; 4] = ["prep synth", "bench cues", "bench study", "bench latency"];

/// Everything that leaves files.
pub fn cases() -> Vec<Case> {
    let case = |name: &'static str, before: &[&str], line: &str| Case {
        name,
        before: before.iter().map(ToString::to_string).collect(),
        line: line.to_owned(),
        short: if SLOW.contains(&name) || name.starts_with("train") {
            1
        } else {
            2
        },
        starts_others: name == "train study",
    };
    let size = "--width 64 --height 32 --jobs 1 --quiet";
    let eigen = format!("prep eigen --raw world/kitti_raw --allow-missing {size} --out out");
    let kitti = format!(
        "prep kitti --raw world/kitti_raw --stereo2015 world/kitti2015 --allow-missing {size} --out out"
    );
    let labelled = kitti.replace("--out out", "--semantics world/kitti2015 --out rows");
    let pairs = format!("prep pairs --csv pairs.csv {size} --out out");
    let export = "prep export eigen --kind velodyne --out out --format";
    let few = "--runtime embedded --jobs 1 --quiet";
    let table = format!("bench --table all --data kitti {few} --out out --model");
    let latency = "--runtime embedded --quiet";
    let study = "train study study.yaml --data kitti --quiet --out out".to_owned();
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
            "bench latency",
            &[],
            &format!(
                "bench latency --model a.onnx --data kitti --seconds 0 --queries 1 --threads 1 {latency} \
                 --out out"
            ),
        ),
        case(
            "bench report",
            &[&format!("{table} a=a.onnx --pictures 1")],
            "bench report out",
        ),
        case(
            "bench sprites",
            &[&labelled],
            "bench sprites --data rows --each 1 --quiet --out out",
        ),
        case(
            "bench leaderboard init",
            &[],
            "bench leaderboard init out --data kitti",
        ),
        case(
            "bench publish --submission",
            &[&rows, "bench leaderboard init out --data kitti"],
            "bench publish --rows rows/rows.csv --submission out/submissions/a",
        ),
        case(
            "bench leaderboard page",
            &[
                &rows,
                "bench leaderboard init board --data kitti",
                "bench publish --rows rows/rows.csv --submission board/submissions/a",
            ],
            "bench leaderboard page board --out out",
        ),
        case("train study", &[], &study),
        case(
            "bench study",
            &[&study.replace("--out out", "--out studied")],
            &format!("bench study studied --data kitti {few} --out out"),
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
    /// Makes what was there before, once.
    pub fn prepare(&self, stage: &Stage) {
        FOLDERS.iter().for_each(|name| stage.remove(name));
        self.before.iter().for_each(|line| stage.must(line));
        stage.fill_in("board/submissions/a/card.yaml");
        stage.keep(&FOLDERS);
    }

    /// Puts what was there before in its place.
    pub fn begin(&self, stage: &Stage) {
        stage.restore(&FOLDERS);
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
    difference(&without_stops(results(stage), whole), whole)
}

/// Takes out whole checkpoints that a run without a fault has not: a training that is told to stop writes one where
/// it is, and keeps it among the newest.
fn without_stops(
    mut found: BTreeMap<PathBuf, Vec<u8>>,
    whole: &BTreeMap<PathBuf, Vec<u8>>,
) -> BTreeMap<PathBuf, Vec<u8>> {
    let of_stops: Vec<PathBuf> = found
        .keys()
        .filter(|name| name.ends_with("state.json") && !whole.contains_key(*name))
        .filter_map(|name| name.parent().map(Path::to_path_buf))
        .filter(|folder| {
            folder
                .parent()
                .is_some_and(|above| above.ends_with("checkpoints"))
        })
        .collect();
    found.retain(|name, _| !of_stops.iter().any(|folder| name.starts_with(folder)));
    found
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
        || text.ends_with("validation.csv") || text.ends_with("diagnostics.csv")
        || text.ends_with("failures.csv")
        // They say which of the images were drawn, or that some failed.
        || text.ends_with("pictures.csv") || text.ends_with("predict.yaml")
        || text.ends_with("study-results.yaml")
}

/// Lines of records that say when and how something ran.
const OF_ONE_RUN: [&str; 3] = ["seconds:", "overhead:", "- --quiet"];

/// Files of the results that are the same in every run.
pub fn results(stage: &Stage) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = tree(&stage.path("out"));
    found.retain(|name, bytes| {
        let text = name.to_string_lossy();
        let records = [
            "run.yaml",
            "cues.yaml",
            "figures.yaml",
            "predict.yaml",
            "study-results.yaml",
        ];
        if records.iter().any(|record| text.ends_with(record)) {
            let lines = String::from_utf8_lossy(bytes).into_owned();
            let is_kept = |line: &&str| !OF_ONE_RUN.iter().any(|word| line.contains(word));
            let kept: Vec<&str> = lines.lines().filter(is_kept).collect();
            *bytes = kept.join("\n").into_bytes();
        }
        if text.ends_with(".bpk") {
            *bytes = weights(bytes);
        }
        if text.ends_with("latency.csv") {
            *bytes = what_was_timed(bytes);
        }
        !text.ends_with("checksums.b3")
            // Named by the second in which it was begun.
            && !text.contains("tensorboard/")
            && !text.ends_with(".lock")
    });
    found
}

/// The columns of `latency.csv` up to the number of images, without times.
fn what_was_timed(bytes: &[u8]) -> Vec<u8> {
    let text = String::from_utf8_lossy(bytes);
    let cells = |line: &str| line.split(',').take(13).collect::<Vec<_>>().join(",");
    text.lines()
        .map(cells)
        .collect::<Vec<_>>()
        .join("\n")
        .into_bytes()
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
