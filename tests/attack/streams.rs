//! Streams that are full or closed, and a limit on the size of files.

use crate::Chosen;
use crate::cases::{Case, cases, difference, finish, results, unharmed};
use crate::stage::Stage;

/// What is behind the command in a shell; none of it may cost the work.
const STREAMS: [&str; 4] = ["2>/dev/full", "2>&- >&-", ">/dev/full", "2>&1 | true"];

/// Tries each chosen case; a sentence for each that went wrong.
pub fn campaign(stage: &Stage, chosen: &Chosen, short: bool) -> (u64, Vec<String>) {
    let (mut tried, mut wrong) = (0, Vec::new());
    for (number, case) in cases().iter().enumerate() {
        if !chosen.has(case.name) || short && number % 3 != 0 {
            continue;
        }
        case.prepare(stage);
        let before = results(stage);
        stage.must(&case.line);
        let whole = results(stage);
        for (turn, streams) in STREAMS.into_iter().enumerate() {
            if short && turn != number / 3 % STREAMS.len() {
                continue;
            }
            case.begin(stage);
            let ended = stage.run_in_shell("", &loud(case), streams);
            tried += 1;
            let problem = ended
                .crime_but_silence()
                .or_else(|| difference(&results(stage), &whole));
            wrong.extend(problem.map(|problem| format!("{} {streams}: {problem}", case.name)));
        }
        if short && number % 2 != 0 {
            continue;
        }
        case.begin(stage);
        // 4 KiB, in the units of sh.
        let ended = stage.run_in_shell("ulimit -f 8;", &case.line, "");
        tried += 1;
        let problem = unharmed(stage, &ended, &before, &whole).or_else(|| {
            let left = stage.leftovers("out");
            (!left.is_empty()).then(|| format!("{left:?} stays"))
        });
        let problem = problem.or_else(|| finish(stage, case, &whole));
        wrong.extend(problem.map(|problem| format!("{}, ulimit -f 8: {problem}", case.name)));
    }
    (tried, wrong)
}

/// A line that says all it can.
fn loud(case: &Case) -> String {
    case.line.replace(" --quiet", "")
}
