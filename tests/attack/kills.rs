//! Kills, errors and signals at every change of the file system: the next run must end with the bytes of
//! one that nothing happened to.
//!
//! Several stages are attacked side by side. What the next run makes of the files that a fault leaves depends
//! on nothing else, so it runs once for all faults that leave the same.

use std::collections::{BTreeMap, HashMap};
use std::path::PathBuf;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use strat_store::{fault, files, spread};

use crate::Chosen;
use crate::cases::{Case, FOLDERS, cases, finish, results, unharmed};
use crate::stage::{Ended, Fault, Stage, tree};

/// How many points were tried, and what went wrong.
#[derive(Default)]
pub struct Tally {
    pub kills: u64,
    pub errors: u64,
    pub signals: u64,
    pub wrong: Vec<String>,
}

/// How `timeout` tells of `abort`.
const KILLED: i32 = 134;

/// Tries each chosen case at all changes, or in the `short` form at a few that are
/// spread evenly.
pub fn campaign(
    stages: &[Stage],
    chosen: &Chosen,
    short: bool,
) -> impl Iterator<Item = (&'static str, Tally)> {
    let cases = cases()
        .into_iter()
        .filter(move |case| chosen.has(case.name));
    cases.map(move |case| (case.name, sweep(stages, &case, short)))
}

/// The faults of a case, in order.
fn faults(case: &Case, all: u64, short: bool) -> Vec<Fault> {
    let points = |count: usize| -> Vec<u64> {
        let chosen = spread::evenly(all as usize, if short { count } else { all as usize });
        chosen.map(|point| point as u64 + 1).collect()
    };
    let kills = points(case.short).into_iter();
    let mut faults: Vec<Fault> = kills.map(|at| Fault { at, what: None }).collect();
    for (number, at) in points(case.short.div_ceil(2)).into_iter().enumerate() {
        for (turn, (error, _)) in fault::ERRORS.into_iter().enumerate() {
            if !short || turn == number % fault::ERRORS.len() {
                let what = Some(error);
                faults.push(Fault { at, what });
            }
        }
    }
    // Being told to stop is no matter of single changes.
    let middles = if short { 1 } else { 12 };
    for (number, at) in spread::evenly(all as usize, middles).enumerate() {
        faults.push(Fault {
            at: at as u64 + 1,
            what: Some(fault::SIGNALS[number % fault::SIGNALS.len()]),
        });
    }
    faults
}

fn sweep(stages: &[Stage], case: &Case, short: bool) -> Tally {
    let prepared = |stage: &Stage| {
        case.prepare(stage);
        let before = results(stage);
        let all = stage.count(&case.line);
        let whole = results(stage);
        Prepared {
            before,
            whole,
            all,
            ends: HashMap::new(),
        }
    };
    let first = prepared(&stages[0]);
    let faults = faults(case, first.all, short);
    let next = AtomicUsize::new(0);
    let found = Mutex::new(BTreeMap::new());
    std::thread::scope(|scope| {
        let mut first = Some(first);
        for stage in stages {
            let (faults, next, found) = (&faults, &next, &found);
            let first = first.take();
            scope.spawn(move || {
                let mut prepared = first.unwrap_or_else(|| prepared(stage));
                loop {
                    let number = next.fetch_add(1, Ordering::Relaxed);
                    let Some(fault) = faults.get(number) else {
                        break;
                    };
                    if let Some(problem) = prepared.attempt(stage, case, *fault) {
                        let what = fault.what.unwrap_or("killed");
                        let (name, at) = (case.name, fault.at);
                        let sentence = format!("{name}, {what} at change {at}: {problem}");
                        found.lock().expect("no panic").insert(number, sentence);
                    }
                }
            });
        }
    });
    let count = |is: fn(&Fault) -> bool| faults.iter().filter(|fault| is(fault)).count() as u64;
    Tally {
        kills: count(|fault| fault.what.is_none()),
        errors: count(|fault| fault.is_error()),
        signals: count(|fault| fault.is_signal()),
        wrong: found
            .into_inner()
            .expect("no panic")
            .into_values()
            .collect(),
    }
}

/// A case on a stage.
struct Prepared {
    /// What was there before.
    before: BTreeMap<PathBuf, Vec<u8>>,
    /// What is there after a run that nothing happens to.
    whole: BTreeMap<PathBuf, Vec<u8>>,
    /// Changes that it makes.
    all: u64,
    /// What is wrong after the next run, by the digest of what a fault has left.
    ends: HashMap<String, Option<String>>,
}

impl Prepared {
    /// What goes wrong with a fault, and after it.
    fn attempt(&mut self, stage: &Stage, case: &Case, fault: Fault) -> Option<String> {
        case.begin(stage);
        let ended = stage.run(&case.line, Some(fault));
        let problem = match fault.what {
            None if is_killed(case, &ended) => None,
            None => Some(format!("no kill, but exit code {}", ended.code)),
            Some(_) if fault.is_signal() => after_signal(&ended),
            Some(_) => unharmed(stage, &ended, &self.before, &self.whole),
        };
        problem.or_else(|| self.finish(stage, case))
    }

    fn finish(&mut self, stage: &Stage, case: &Case) -> Option<String> {
        let mut left = Vec::new();
        for (name, bytes) in FOLDERS.iter().flat_map(|name| tree(&stage.path(name))) {
            left.extend(format!("{} {}\0", name.display(), bytes.len()).into_bytes());
            left.extend(bytes);
        }
        let digest = files::blake3_hex(&left);
        if let Some(known) = self.ends.get(&digest) {
            return known.clone();
        }
        let problem = finish(stage, case, &self.whole);
        self.ends.insert(digest, problem.clone());
        problem
    }
}

/// Whether a fault has killed the process, or one that it has started.
fn is_killed(case: &Case, ended: &Ended) -> bool {
    ended.code == KILLED || case.starts_others && ended.code == 1
}

fn after_signal(told: &Ended) -> Option<String> {
    let says_how_to_go_on = [
        "interrupted; what is done is kept",
        "continue with: train --resume",
        "the same command goes on",
    ];
    let is_good = match told.code {
        // By the signal itself, before or after the work that goes on later, or in spite of it.
        0 | 129 | 130 | 143 => true,
        1 => says_how_to_go_on
            .iter()
            .any(|text| told.stderr.contains(text)),
        _ => false,
    };
    (!is_good).then(|| format!("exit code {}: {}", told.code, told.stderr.trim()))
}
