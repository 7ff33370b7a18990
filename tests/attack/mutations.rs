//! Seeded mutations of every kind of input, through the commands: none of them may panic, abort or hang.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::Chosen;
use crate::stage::Stage;

/// A kind of input: the file that is changed, and the lines that read it.
struct Kind {
    name: &'static str,
    file: String,
    lines: Vec<String>,
    /// Folders that the lines write to.
    outputs: Vec<&'static str>,
}

fn kinds(stage: &Stage) -> Vec<Kind> {
    let kind = |name, file: &str, lines: &[&str]| Kind {
        name,
        file: file.to_owned(),
        lines: lines.iter().map(ToString::to_string).collect(),
        outputs: vec!["out"],
    };
    let size = "--width 32 --height 16 --jobs 1 --quiet --out out";
    let raw = format!("prep eigen --raw small --allow-missing {size}");
    let pairs = format!("prep pairs --csv input/pairs.csv {size}");
    let table = "bench --table 3.3 --data eigen --runtime embedded --jobs 1 --quiet --out out";
    let scan = stage.small_raw();
    stage.inputs();
    vec![
        kind(
            "calibration",
            "small/2011_09_26/calib_cam_to_cam.txt",
            &[&raw],
        ),
        kind("velodyne", &scan, &[&raw]),
        kind("png", "input/left.png", &[&pairs]),
        kind("png, 16 bits", "input/depth.png", &[&pairs]),
        kind("jpeg", "input/right.jpg", &[&pairs]),
        kind("list of pairs", "input/pairs.csv", &[&pairs]),
        kind(
            "exr",
            "input/depth.exr",
            &[&format!("prep pairs --csv input/exr.csv {size}")],
        ),
        kind(
            "npy",
            "input/maps.npy",
            &[&format!("{table} --predictions a=input/maps.npy")],
        ),
        kind(
            "npz",
            "input/arrays.npz",
            &[&format!("{table} --predictions a=input/arrays.npz")],
        ),
        kind(
            "mat",
            "input/make3d/depth/depth_sph_corr-a.mat",
            &[&format!(
                "prep make3d --images input/make3d/images --depth input/make3d/depth {size}"
            )],
        ),
        kind(
            "zip",
            "input/zips/all.zip",
            &[&format!(
                "prep eigen --raw input/zips --allow-missing {size}"
            )],
        ),
        kind(
            "description of a model",
            "input/m.yaml",
            &[&format!("{table} --model input/m.onnx")],
        ),
        kind(
            "description of maps",
            "input/maps.yaml",
            &[&format!("{table} --predictions input/maps.npy")],
        ),
        kind(
            "protocol",
            "input/protocol.yaml",
            &["bench protocols input/protocol.yaml"],
        ),
        kind(
            "manifest",
            "input/set/manifest.yaml",
            &["prep verify input/set"],
        ),
        kind(
            "table of a set",
            "input/set/test.csv",
            &["prep verify input/set"],
        ),
        kind(
            "rows",
            "input/rows.csv",
            &[
                "bench render --rows input/rows.csv --out out",
                "bench compare input/rows.csv",
            ],
        ),
        kind(
            "leaderboard",
            "input/board.csv",
            &["bench publish --merge input/board.csv --to out/all.csv"],
        ),
        kind(
            "onnx",
            "input/a.onnx",
            &[&format!("{table} --model input/a.onnx")],
        ),
    ]
}

/// How mutations of one kind ended.
#[derive(Default)]
pub struct Tally {
    pub mutations: u64,
    /// Processes by exit code.
    pub codes: BTreeMap<i32, u64>,
    pub wrong: Vec<String>,
}

/// Makes `count` mutations of each kind that is chosen.
pub fn campaign(
    stages: &[Stage],
    chosen: &Chosen,
    seed: u64,
    count: u64,
) -> impl Iterator<Item = (&'static str, Tally)> {
    // Each stage makes the files that are mutated there.
    let mut kinds: Vec<Vec<Kind>> = stages.iter().map(kinds).collect();
    let kinds = kinds.pop().unwrap_or_default();
    let kinds = kinds.into_iter().filter(move |kind| chosen.has(kind.name));
    kinds.map(move |kind| (kind.name, attack(stages, &kind, seed, count)))
}

fn attack(stages: &[Stage], kind: &Kind, seed: u64, count: u64) -> Tally {
    let next = AtomicU64::new(0);
    let numbers = &|| Some(next.fetch_add(1, Ordering::Relaxed)).filter(|number| *number < count);
    let mut all = Tally::default();
    std::thread::scope(|scope| {
        let one = |stage| scope.spawn(move || attack_on(stage, kind, seed, numbers));
        let running: Vec<_> = stages.iter().map(one).collect();
        for one in running {
            let tally = one.join().expect("no panic");
            all.mutations += tally.mutations;
            all.wrong.extend(tally.wrong);
            for (code, times) in tally.codes {
                *all.codes.entry(code).or_default() += times;
            }
        }
    });
    all.wrong.sort_unstable();
    all
}

/// Makes the mutations of these numbers.
fn attack_on(stage: &Stage, kind: &Kind, seed: u64, numbers: impl Fn() -> Option<u64>) -> Tally {
    let whole = stage.read(&kind.file);
    let mut tally = Tally::default();
    while let Some(number) = numbers() {
        let mut random = Random(seed ^ number.wrapping_mul(0x9e37_79b9_7f4a_7c15));
        stage.write(&kind.file, &mutated(&whole, &mut random));
        tally.mutations += 1;
        for line in &kind.lines {
            kind.outputs.iter().for_each(|name| stage.remove(name));
            let ended = stage.run(line, None);
            *tally.codes.entry(ended.code).or_default() += 1;
            if let Some(crime) = ended.crime() {
                let what = format!(
                    "{}, seed {seed}, mutation {number}, `{line}`: {crime}",
                    kind.name
                );
                tally.wrong.push(what);
            }
        }
    }
    stage.write(&kind.file, &whole);
    tally
}

/// SplitMix64 (Steele, Lea and Flood 2014).
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn below(&mut self, bound: usize) -> usize {
        (self.next() % bound.max(1) as u64) as usize
    }
}

/// What stands in place of a word or a number of a text.
const WORDS: [&str; 16] = [
    "nan",
    "-inf",
    "1e999",
    "-1",
    "0",
    "18446744073709551616",
    "99999999999",
    "1e-320",
    "",
    "../../x",
    "\u{0}",
    "é",
    "[[[[[[[[",
    "{a: {b: ",
    "&a *a",
    "\"",
];

/// One to four changes.
fn mutated(whole: &[u8], random: &mut Random) -> Vec<u8> {
    let mut bytes = whole.to_vec();
    for _ in 0..=random.below(4) {
        let length = bytes.len();
        let at = random.below(length);
        // Half of the changes are among the first bytes, where headers are.
        let at = if random.below(2) == 0 {
            at.min(random.below(128))
        } else {
            at
        };
        match random.below(8) {
            0 if length > 0 => bytes[at] ^= 1 << random.below(8),
            1 if length > 0 => bytes[at] = [0, 1, 0x7f, 0x80, 0xff][random.below(5)],
            2 => bytes.truncate(at),
            3 => {
                let more: Vec<u8> = (0..random.below(16)).map(|_| random.next() as u8).collect();
                bytes.splice(at..at, more);
            }
            4 => {
                let end = (at + 1 + random.below(64)).min(length);
                bytes.drain(at.min(end)..end);
            }
            5 => {
                let end = (at + 1 + random.below(256)).min(length);
                let copied = bytes[at.min(end)..end].to_vec();
                let to = random.below(length);
                bytes.splice(to..to, copied);
            }
            6 => {
                // A number of a binary format.
                let value = [
                    0,
                    u32::MAX,
                    1 << 31,
                    0x7fff_ffff,
                    0xffff,
                    random.next() as u32,
                ];
                let value = value[random.below(6)].to_le_bytes();
                let end = (at + 4).min(length);
                let at = at.min(end);
                bytes.splice(at..end, value);
            }
            _ => {
                let is_word = |byte: &u8| byte.is_ascii_alphanumeric() || b".-+_".contains(byte);
                let start = bytes[..at].iter().rposition(|byte| !is_word(byte));
                let start = start.map_or(0, |start| start + 1);
                let end = bytes[at..].iter().position(|byte| !is_word(byte));
                let end = end.map_or(length, |end| at + end);
                bytes.splice(
                    start..end.max(start),
                    WORDS[random.below(WORDS.len())].bytes(),
                );
            }
        }
    }
    bytes
}
