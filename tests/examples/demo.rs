//! `cargo demo`: the whole way, on a rendered world, in one folder.
//!
//! Runs the commands of [`strat_tests::steps`] one after the other, shows each as
//! a line that can be typed, and stops at the first that fails. Not here: options
//! of the commands themselves; type the lines shown to change them.
#![allow(
    clippy::print_stdout,
    reason = "the demo's results are meant for the terminal"
)]

use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;

use clap::Parser;
use strat_bench::runtime::install::{Availability, ensure_runtime};
use strat_tests::steps::Plan;

/// As the three commands have it.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Renders a street world, prepares it, trains, exports and evaluates.
#[derive(Debug, Parser)]
#[command(name = "cargo demo", version)]
struct Arguments {
    /// Folder for everything the demo writes; finished parts in it are kept.
    #[arg(long, default_value = "strat-demo")]
    out: PathBuf,
    /// Size of the rendered world: a preset of `prep synth`.
    #[arg(long, default_value = "demo")]
    world: String,
    /// Training configuration: a name known to `train`, or a file.
    #[arg(long, default_value = "demo")]
    config: String,
    /// Stop training after this many steps.
    #[arg(long)]
    max_steps: Option<u64>,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let start = Instant::now();
    let run = arguments.out.join("run");
    let mut train_arguments = Vec::new();
    if run.join("config.yaml").is_file() {
        train_arguments.push("--resume".into());
    }
    if let Some(steps) = arguments.max_steps {
        train_arguments.extend(["--max-steps".into(), steps.to_string().into()]);
    }
    let plan = Plan {
        out: arguments.out,
        world: arguments.world,
        config: arguments.config,
        train_arguments,
        bench_arguments: Vec::new(),
    };
    match ensure_runtime() {
        Availability::Ready(path) => {
            eprintln!("ONNX Runtime: {}", path.display());
        }
        Availability::Unavailable(reason) => {
            eprintln!(
                "ONNX Runtime is not available ({reason}); the embedded runtime serves instead"
            );
        }
    }
    let steps = plan.steps();
    for (number, step) in steps.iter().enumerate() {
        eprintln!(
            "\n[{}/{}] {}\n$ {}",
            number + 1,
            steps.len(),
            step.title,
            step.line()
        );
        let code = step.command.run(&step.arguments);
        if code != 0 {
            eprintln!(
                "\nThe demo stopped: this step ended with code {code}. What was finished is kept in \
                 {}; fix the cause, then `cargo demo` goes on from there.",
                plan.out.display()
            );
            return ExitCode::from(code);
        }
    }
    println!();
    for folder in [plan.kitti_results(), plan.eigen_results()] {
        println!(
            "rows, tables, leaderboard and pictures: {}",
            folder.display()
        );
    }
    println!("all of it on one page: {}", plan.report().display());
    println!("model: {}", run.join("model.onnx").display());
    println!("the demo took {} s", start.elapsed().as_secs());
    ExitCode::SUCCESS
}
