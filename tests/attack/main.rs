//! Attacks on the three commands, as processes of their own: kills and errors at every change of the file
//! system, and mutations of every kind of input. `README.md` has the commands and the last full run.
//!
//! In the ordinary tests this is the short form. It is also the three commands: `attack prep ...`.

mod cases;
mod inputs;
mod kills;
mod mutations;
mod stage;
mod streams;

use std::ffi::OsString;
use std::process::ExitCode;
use std::time::Instant;

use strat_tests::steps::Command;

use self::stage::Stage;

/// Mutations of each kind in the short form and in the full one.
const MUTATIONS: [u64; 2] = [4, 1000];

fn main() -> ExitCode {
    let mut arguments: Vec<OsString> = std::env::args_os().skip(1).collect();
    for command in [Command::Prep, Command::Train, Command::Bench] {
        if arguments.first().is_some_and(|name| name == command.name()) {
            strat_store::signals::tell_size_limits();
            strat_bench::runtime::process::is_served_here();
            return ExitCode::from(command.run(&arguments.split_off(1)));
        }
    }
    if arguments.iter().any(|word| word == "--end-with-stdin") {
        // That `train study` has started for a run.
        strat_store::signals::tell_size_limits();
        return ExitCode::from(Command::Train.run(&arguments));
    }
    if arguments
        .first()
        .is_some_and(|name| name == "model-process")
    {
        // That `bench` has started for a model.
        return ExitCode::from(Command::Bench.run(&arguments));
    }
    let words: Vec<String> = arguments
        .iter()
        .map(|argument| argument.to_string_lossy().into_owned())
        .collect();
    let value = |name: &str| {
        let at = words.iter().position(|word| word == name)?;
        words.get(at + 1).cloned()
    };
    let full = value("--full");
    let is_filter = |word: &String| !word.starts_with('-') && !"attack".contains(word.as_str());
    if full.is_none() && words.iter().any(|word| word == "--list" || is_filter(word)) {
        // Tests by name are asked for, and this is none of them.
        return ExitCode::SUCCESS;
    }
    if cfg!(not(debug_assertions)) {
        println("faults are in debug builds only");
        return ExitCode::SUCCESS;
    }
    let what = full.as_deref().unwrap_or("all");
    let chosen = Chosen {
        only: value("--only").unwrap_or_default(),
        not: value("--not").unwrap_or_default(),
    };
    let number =
        |name, otherwise| value(name).map_or(otherwise, |text| text.parse().unwrap_or(otherwise));
    let is_short = full.is_none();
    let stages = Stage::several();
    let stage = &stages[0];
    if what == "cost" {
        for case in cases::cases().iter().filter(|case| chosen.has(case.name)) {
            case.prepare(stage);
            let began = Instant::now();
            let changes = stage.count(&case.line);
            let seconds = began.elapsed().as_secs_f64();
            println(&format!("{}: {changes} changes, {seconds:.2} s", case.name));
        }
        return ExitCode::SUCCESS;
    }
    let (mut tried, mut wrong) = (0, Vec::new());
    if ["all", "kills"].contains(&what) {
        for (name, tally) in kills::campaign(&stages, &chosen, is_short) {
            println(&format!(
                "{name}: {} kills, {} errors, {} signals; {} wrong",
                tally.kills,
                tally.errors,
                tally.signals,
                tally.wrong.len()
            ));
            tried += tally.kills + tally.errors + tally.signals;
            wrong.extend(tally.wrong);
        }
    }
    if ["all", "streams"].contains(&what) {
        let (processes, found) = streams::campaign(stage, &chosen, is_short);
        println(&format!(
            "streams and limits: {processes} tried; {} wrong",
            found.len()
        ));
        tried += processes;
        wrong.extend(found);
    }
    if ["all", "mutations"].contains(&what) {
        let count = number("--count", MUTATIONS[usize::from(!is_short)]);
        for (name, tally) in mutations::campaign(&stages, &chosen, number("--seed", 1), count) {
            let codes = tally
                .codes
                .iter()
                .map(|(code, times)| format!("{times} with {code}"));
            println(&format!(
                "{name}: {} mutations, exit codes {}; {} wrong",
                tally.mutations,
                codes.collect::<Vec<_>>().join(", "),
                tally.wrong.len()
            ));
            tried += tally.codes.values().sum::<u64>();
            wrong.extend(tally.wrong);
        }
    }
    for sentence in &wrong {
        println(&format!("WRONG: {sentence}"));
    }
    let failed = wrong.len() as u64;
    println(&format!(
        "{} passed, {failed} failed",
        tried.saturating_sub(failed)
    ));
    if wrong.is_empty() {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    }
}

/// Which cases and kinds are tried.
pub struct Chosen {
    /// What their names hold.
    only: String,
    /// Names that are left out, separated by commas.
    not: String,
}

impl Chosen {
    /// Whether something of this name is tried.
    pub fn has(&self, name: &str) -> bool {
        name.contains(&self.only) && self.not.split(',').all(|other| other != name)
    }
}

fn println(text: &str) {
    strat_store::command::eprint_line(text);
}
