//! The `bench` command: which subcommands there are, and exit codes.
//!
//! One file for each subcommand parses its arguments, calls the library and prints; [`args`] is what
//! several share. Results go to stdout, everything else to stderr; [`strat_store::command`] has the
//! exit codes. A broken image or model costs itself only and ends in code 1; what was good is kept.

mod args;
mod compare;
mod cues;
mod describe;
mod devices;
mod evaluate;
mod figures;
mod latency;
mod leaderboard;
mod merge;
mod model_process;
mod predict;
mod protocols;
mod publish;
mod render;
mod report;
mod setup;
mod sprites;
mod study;
mod verify;

use std::ffi::OsString;

use clap::{Args as _, CommandFactory as _, FromArgMatches as _, Parser, Subcommand};
use strat_store::command::{CliError, DONE, USAGE, fail, utf8_arguments};
use strat_store::shell::{self, ColourArg, CompletionsArgs, take_colour};

use self::evaluate::EvaluateArgs;
use crate::{evaluate::plan::PlanError, runtime::process};

/// Below `bench --help`; `bench` alone leaves it out.
const FURTHER_HELP: &str = "\
Examples:
  bench setup                                                   once: ONNX Runtime into a folder of its own
  bench eval --table 3.1 --data kitti_set -m strat=model.onnx -o results
  bench eval --table 3.3 --data eigen_set --predictions godard=disparities.npy -o results
  bench predict photos -m model.onnx -o depth                   maps of your own photos
  bench report results                                          one page about all of it

`bench --table ...` is `bench eval --table ...`. Models of other projects need a description beside the file,
which `bench describe` drafts; `bench describe --help` shows one.

Exit codes: 0 done, 1 failed or incomplete, 2 wrong usage.";

/// Subcommands by what one wants to do.
const GROUPS: [(&str, &[&str]); 3] = [
    ("Measure", &["eval", "predict", "latency", "cues"]),
    (
        "Look and compare",
        &["report", "compare", "study", "figures", "render"],
    ),
    (
        "Models and rules",
        &["setup", "devices", "describe", "protocols"],
    ),
];

#[derive(Debug, Parser)]
#[command(
    name = "bench",
    version,
    about = "Evaluates ONNX depth models and saved predictions, and writes the thesis' tables",
    after_long_help = FURTHER_HELP,
    args_conflicts_with_subcommands = true,
    subcommand_negates_reqs = true,
    arg_required_else_help = true
)]
struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    colour: ColourArg,
}

/// What a command line asks for: a subcommand, or tables.
enum Asked {
    Command(Command),
    Tables(EvaluateArgs),
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Evaluate models or saved predictions: rows, tables, intervals
    #[command(after_help = evaluate::EXAMPLES)]
    Eval(Box<EvaluateArgs>),
    /// Install ONNX Runtime into a folder of its own (needs python3 with pip, once)
    Setup(setup::SetupArgs),
    /// Merge the parts of a sharded run (--shard)
    Merge(merge::MergeArgs),
    /// Show what this machine can run models on, and why not on the rest
    Devices(devices::DevicesArgs),
    /// Draft the description that a model of another project needs, for you to confirm
    Describe(describe::DescribeArgs),
    /// Write depth, disparity or coloured pictures of images
    Predict(predict::PredictArgs),
    /// Time models over threads and batches, after MLPerf's LoadGen
    Latency(latency::LatencyArgs),
    /// Test which depth cues models use (figures 4.3 to 4.10)
    Cues(cues::CuesArgs),
    /// Cut sprites for `bench cues` out of a labelled set's own images
    Sprites(sprites::SpritesArgs),
    /// Draw what models make of the same images (figures 3.3 and 3.6 to 3.10)
    Figures(figures::FiguresArgs),
    /// List the evaluation protocols, or state the rules of one
    Protocols(protocols::ProtocolsArgs),
    /// Test the differences between models over the images both have
    Compare(compare::CompareArgs),
    /// Host a leaderboard: lay it out, check its submissions
    Leaderboard(leaderboard::LeaderboardArgs),
    /// Write a submission to a leaderboard, add lines to a leaderboard file, or merge files
    Publish(publish::PublishArgs),
    /// Derive every measured line of a leaderboard again from its rows
    #[command(after_help = "\
Examples:
  bench verify-leaderboard leaderboard.csv --rows results/rows.csv
  bench verify-leaderboard all.csv --rows mine/rows.csv yours/rows.csv")]
    VerifyLeaderboard(verify::VerifyArgs),
    /// Write the thesis' tables from rows alone
    Render(render::RenderArgs),
    /// Say which variant of a study is better, over seeds and drives (see `train study`)
    Study(study::StudyArgs),
    /// Write one HTML page about everything below a folder of results
    Report(report::ReportArgs),
    /// Print completions for a shell, or write manual pages
    #[command(after_help = "\
Examples:
  bench completions bash                 for ~/.local/share/bash-completion/completions/bench
  bench completions --man man/man1       bench.1 and a page for each subcommand")]
    Completions(CompletionsArgs),
    /// Run one model for the process that starts this
    #[command(name = process::COMMAND, hide = true)]
    ModelProcess(model_process::ModelProcessArgs),
}

/// The parser of the command line.
pub fn command() -> clap::Command {
    command_of("bench")
}

/// The parser under the name that the program was started by.
fn command_of(program: &str) -> clap::Command {
    // The options of `bench --table` are those of `bench eval`, which shows them.
    let command = EvaluateArgs::augment_args(Cli::command())
        .override_usage(format!(
            "{program} COMMAND [OPTIONS]      ({program} COMMAND --help has options and examples)"
        ))
        .mut_args(|arg| match arg.get_id().as_str() {
            "color" | "help" | "version" => arg,
            _ => arg.hide(true),
        })
        .after_long_help(FURTHER_HELP);
    let list = subcommands(&command);
    command.help_template(format!(
        "{{about-with-newline}}\n{{usage-heading}} {{usage}}\n\n{list}\nOptions:\n{{options}}{{after-help}}"
    ))
}

/// The list of subcommands in [`GROUPS`]; all others by name alone.
fn subcommands(command: &clap::Command) -> String {
    let shown = || command.get_subcommands().filter(|one| !one.is_hide_set());
    let named = |name: &str| GROUPS.iter().any(|(_, names)| names.contains(&name));
    let mut text = String::new();
    for (heading, names) in GROUPS {
        text += &format!("{heading}:\n");
        for one in shown().filter(|one| names.contains(&one.get_name())) {
            let about = one.get_about().map(ToString::to_string).unwrap_or_default();
            text += &format!("  {:<10} {about}\n", one.get_name());
        }
    }
    let others = shown()
        .map(clap::Command::get_name)
        .filter(|name| !named(name));
    text += &format!("Further: {}\n", others.collect::<Vec<_>>().join(", "));
    text
}

/// clap's derive never finds an optional group of options that contains another, so the options of
/// `bench --table` are read here, where no subcommand is named.
fn parse(args: &[OsString], colour: clap::ColorChoice) -> Result<Asked, clap::Error> {
    // The Python package starts it as `strat bench`.
    let program = args.first().and_then(|program| program.to_str());
    let program = program.filter(|program| program.ends_with(" bench"));
    let command = command_of(program.unwrap_or("bench"));
    let matches = command.color(colour).try_get_matches_from(args)?;
    Ok(match Cli::from_arg_matches(&matches)?.command {
        Some(Command::Eval(args)) => Asked::Tables(*args),
        Some(command) => Asked::Command(command),
        None => Asked::Tables(EvaluateArgs::from_arg_matches(&matches)?),
    })
}

/// Runs the command with the given arguments, the program's name first, and returns the exit
/// code.
pub fn main(args: impl IntoIterator<Item = OsString>) -> u8 {
    let args = match utf8_arguments(args) {
        Ok(args) => args,
        Err(error) => return fail(&error),
    };
    let (args, colour) = take_colour(args);
    let arguments: Vec<String> = args
        .iter()
        .skip(1)
        .map(|argument| argument.to_string_lossy().into_owned())
        .collect();
    let asked = match parse(&args, colour) {
        Ok(asked) => asked,
        Err(error) => {
            // clap knows which of its messages are help (stdout, success) and which are not.
            let _ = error.print();
            return if error.use_stderr() { USAGE } else { DONE };
        }
    };
    run(asked, arguments).unwrap_or_else(|error| match error.downcast::<PlanError>() {
        Ok(error) => fail(&CliError::usage(error)),
        Err(error) => fail(error.as_ref()),
    })
}

fn run(asked: Asked, arguments: Vec<String>) -> anyhow::Result<u8> {
    let asked = match asked {
        Asked::Tables(args) => return evaluate::run(&args, arguments),
        Asked::Command(asked) => asked,
    };
    match asked {
        Command::Eval(args) => evaluate::run(&args, arguments),
        Command::Setup(args) => setup::run(&args),
        Command::Merge(args) => merge::run(&args),
        Command::Devices(args) => devices::run(&args),
        Command::Describe(args) => describe::run(&args),
        Command::Predict(args) => predict::run(&args, arguments),
        Command::Latency(args) => latency::run(&args),
        Command::Cues(args) => cues::run(&args, arguments),
        Command::Sprites(args) => sprites::run(&args),
        Command::Figures(args) => figures::run(&args, arguments),
        Command::Protocols(args) => protocols::run(&args),
        Command::Compare(args) => compare::run(&args),
        Command::Leaderboard(args) => leaderboard::run(&args),
        Command::Publish(args) => publish::run(&args),
        Command::VerifyLeaderboard(args) => verify::run(&args),
        Command::Render(args) => render::run(&args),
        Command::Study(args) => study::run(&args, arguments),
        Command::Report(args) => report::run(&args),
        Command::Completions(args) => Ok(shell::completions(&args, command())?),
        Command::ModelProcess(args) => model_process::run(&args),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arguments_are_well_formed() {
        command().debug_assert();
    }

    #[test]
    fn help_has_every_subcommand_once_and_fits_a_screen() {
        let short = command().render_help().to_string();
        let long = command().render_long_help().to_string();
        for one in command().get_subcommands().filter(|one| !one.is_hide_set()) {
            let words = |text: &String| text.contains(&format!(" {}", one.get_name()));
            assert!(words(&short) && words(&long), "{short}");
        }
        assert!(!short.contains("--median-baseline"), "{short}");
        assert!(
            short.lines().count() <= 30 && long.lines().count() <= 50,
            "{short}{long}"
        );
    }

    #[test]
    fn a_table_and_a_subcommand_are_told_apart() {
        let asked = |line: &str| {
            let words: Vec<OsString> = line.split(' ').map(OsString::from).collect();
            parse(&words, clap::ColorChoice::Never)
        };
        let table = asked("bench --table 3.1 --data set --out results --model a.onnx");
        assert!(matches!(table, Ok(Asked::Tables(_))));
        let table = asked("bench eval --table 3.1 --data set -o results -m a.onnx -q");
        assert!(matches!(table, Ok(Asked::Tables(_))));
        let other = asked("bench report results");
        assert!(matches!(other, Ok(Asked::Command(Command::Report(_)))));
        assert!(
            asked("bench --table 3.1 --out results").is_err(),
            "--data is missing"
        );
    }
}
