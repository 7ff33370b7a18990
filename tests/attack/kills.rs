//! Kills, errors and signals at every change of the file system: the next run must end with the bytes of
//! one that nothing happened to.

use strat_store::{fault, spread};

use crate::cases::{Case, cases, finish, results, unharmed};
use crate::stage::{Fault, Stage};

/// How many points were tried, and what went wrong.
#[derive(Default)]
pub struct Tally {
    pub kills: u64,
    pub errors: u64,
    pub signals: u64,
    pub wrong: Vec<String>,
}

impl Tally {
    fn note(&mut self, case: &Case, what: &str, at: u64, problem: Option<String>) {
        let name = case.name;
        let sentence = problem.map(|problem| format!("{name}, {what} at change {at}: {problem}"));
        self.wrong.extend(sentence);
    }
}

/// Tries each case whose name contains `filter` at all changes, or in the `short` form at a few that are
/// spread evenly.
pub fn campaign(
    stage: &Stage,
    filter: &str,
    short: bool,
) -> impl Iterator<Item = (&'static str, Tally)> {
    let chosen = cases()
        .into_iter()
        .filter(move |case| case.name.contains(filter));
    chosen.map(move |case| (case.name, sweep(stage, &case, short)))
}

fn sweep(stage: &Stage, case: &Case, short: bool) -> Tally {
    case.begin(stage);
    let before = results(stage);
    let all = stage.count(&case.line);
    let whole = results(stage);
    let points = |count: usize| -> Vec<u64> {
        let chosen = spread::evenly(all as usize, if short { count } else { all as usize });
        chosen.map(|point| point as u64 + 1).collect()
    };
    let mut tally = Tally::default();
    for at in points(case.short) {
        case.begin(stage);
        let killed = stage.run(&case.line, Some(Fault { at, what: None }));
        tally.kills += 1;
        let problem = if killed.code == KILLED {
            finish(stage, case, &whole)
        } else {
            Some(format!("no kill, but exit code {}", killed.code))
        };
        tally.note(case, "killed", at, problem);
    }
    for (number, at) in points(case.short.div_ceil(2)).into_iter().enumerate() {
        for (turn, (error, _)) in fault::ERRORS.into_iter().enumerate() {
            if short && turn != number % fault::ERRORS.len() {
                continue;
            }
            case.begin(stage);
            let failed = stage.run(
                &case.line,
                Some(Fault {
                    at,
                    what: Some(error),
                }),
            );
            tally.errors += 1;
            let problem = unharmed(stage, &failed, &before, &whole);
            let problem = problem.or_else(|| finish(stage, case, &whole));
            tally.note(case, error, at, problem);
        }
    }
    // Being told to stop is no matter of single changes.
    let middles = if short { 1 } else { 12 };
    for (number, at) in spread::evenly(all as usize, middles).enumerate() {
        let (at, signal) = (at as u64 + 1, fault::SIGNALS[number % fault::SIGNALS.len()]);
        case.begin(stage);
        let told = stage.run(
            &case.line,
            Some(Fault {
                at,
                what: Some(signal),
            }),
        );
        tally.signals += 1;
        let says_how_to_go_on = [
            "interrupted; what is done is kept",
            "continue with: train --resume",
        ];
        let is_good = match told.code {
            // By the signal itself, before or after the work that goes on later, or in spite of it.
            0 | 129 | 130 | 143 => true,
            1 => says_how_to_go_on
                .iter()
                .any(|text| told.stderr.contains(text)),
            _ => false,
        };
        let problem = if is_good {
            finish(stage, case, &whole)
        } else {
            Some(format!("exit code {}: {}", told.code, told.stderr.trim()))
        };
        tally.note(case, signal, at, problem);
    }
    tally
}

/// How `timeout` tells of `abort`.
const KILLED: i32 = 134;
