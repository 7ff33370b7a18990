//! `train` itself: a run, new or resumed.

use std::path::PathBuf;
use std::sync::atomic::Ordering;

use clap::Args;
use strat_store::command::{CliError, DONE, FAILED, eprint_line, print, print_line};
use strat_store::human;
use strat_store::signals::Watch;

use super::setup::Setup;
use crate::config::Config;
use crate::training::options::{Options, Outcome};
use crate::training::run::run;

/// A training run.
#[derive(Debug, Args)]
pub(super) struct TrainArgs {
    #[command(flatten)]
    setup: Setup,
    /// Folder of the prepared set.
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Run folder to write.
    #[arg(short, long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Continue the run in --out; its configuration is used unless --config is given.
    #[arg(long, conflicts_with = "force")]
    resume: bool,
    /// Replace the run in --out.
    #[arg(long)]
    force: bool,
    /// Begin although the step is predicted not to fit into the memory that is free.
    #[arg(long)]
    ignore_memory: bool,
    /// Begin on a GPU without holding it against the cpu first (see `train check`).
    #[arg(long)]
    no_check: bool,
    /// Stop after this many optimizer steps in all; the schedules stay those of the epochs.
    #[arg(long, value_name = "N")]
    max_steps: Option<u64>,
    /// Show no progress.
    #[arg(short, long)]
    quiet: bool,
    /// Show the resolved configuration and stop.
    #[arg(long)]
    print_config: bool,
    /// End as at a signal when standard input closes: the runs of a study end with it, however it ends.
    #[arg(long, hide = true)]
    end_with_stdin: bool,
}

/// The configuration that the arguments ask for.
fn configuration(args: &TrainArgs) -> Result<Config, CliError> {
    let source = match (&args.setup.config, args.resume, &args.out) {
        (Some(source), ..) => source.clone(),
        (None, true, Some(out)) => {
            let path = out.join("config.yaml");
            if !path.exists() {
                return Err(CliError::Usage(format!(
                    "no training run in {}: config.yaml is missing, so nothing can be resumed",
                    out.display()
                )));
            }
            path.to_string_lossy().into_owned()
        }
        _ => args.setup.named()?.to_owned(),
    };
    let mut settings = args.setup.set.clone();
    if let Some(steps) = args.max_steps {
        settings.push(format!("max_steps={steps}"));
    } else if args.resume && args.setup.config.is_none() {
        // The run's own limit is where it stopped; resuming means to go on from there.
        settings.push("max_steps=null".to_owned());
    }
    args.setup.resolve(&source, &settings)
}

/// Trains; the exit code.
pub(super) fn train(args: &TrainArgs) -> Result<u8, CliError> {
    let config = configuration(args)?;
    if args.print_config {
        print(config.to_yaml()?)?;
        return Ok(DONE);
    }
    let (device, replicas) = args.setup.devices()?;
    let devices = replicas.len() + 1;
    if config.accumulate < devices {
        return Err(CliError::Usage(format!(
            "{devices} devices share the batches of a step, but `accumulate` is {}; \
             --set accumulate={devices} gives each of them one",
            config.accumulate,
        )));
    }
    let needed = |value: &Option<PathBuf>, sentence: &str| {
        let value = value.clone();
        value.ok_or_else(|| CliError::Usage(sentence.to_owned()))
    };
    let data = needed(
        &args.data,
        "which prepared set? Give --data with a folder that `prep` has written",
    )?;
    let out = needed(
        &args.out,
        "where to? Give --out with a folder for the run, e.g. --out runs/first",
    )?;
    let watch = Watch::new("stopping after this step");
    if args.end_with_stdin {
        let stop = watch.flag();
        std::thread::spawn(move || {
            // Nothing is ever written to it. What cannot be read has ended as well.
            let _ = std::io::copy(&mut std::io::stdin(), &mut std::io::sink());
            stop.store(true, Ordering::SeqCst);
        });
    }
    let options = Options {
        config,
        data,
        out,
        device,
        replicas,
        resume: args.resume,
        force: args.force,
        quiet: args.quiet,
        ignore_memory: args.ignore_memory,
        no_check: args.no_check,
        stop: watch.flag(),
    };
    conclude(&run(&options)?, &options)
}

fn conclude(outcome: &Outcome, options: &Options) -> Result<u8, CliError> {
    let say = |text: String| {
        if !options.quiet {
            eprint_line(text);
        }
    };
    say(format!(
        "{} of {} steps in {}, {:.1} % of it waiting for images",
        outcome.steps,
        outcome.planned,
        human::duration(outcome.seconds),
        100.0 * outcome.wait_share
    ));
    if outcome.broken_pairs > 0 {
        eprint_line(format_args!(
            "{} training pairs could not be read and were replaced by others",
            outcome.broken_pairs
        ));
    }
    if let Some(best) = &outcome.best {
        say(format!(
            "best validation {} {:.4} after epoch {}",
            best.score, best.value, best.epoch
        ));
    }
    if let (Some(model), Some(parity)) = (&outcome.model, outcome.parity) {
        say(format!(
            "check passed: ONNX and trained network agree to {parity:.1e} of the image width"
        ));
        print_line(model.display())?;
        let epochs = options.config.epochs;
        // `--max-steps` ends it before.
        let is_whole = outcome.steps >= outcome.planned;
        let reached = if is_whole {
            format!("epoch {epochs}")
        } else {
            format!("step {} of {}", outcome.steps, outcome.planned)
        };
        let better = outcome.best.as_ref();
        let better = better.filter(|best| !is_whole || best.epoch != epochs);
        let better = better.map_or(String::new(), |best| {
            format!(
                " (the best by validation was epoch {}: train export {} --best)",
                best.epoch,
                options.out.display()
            )
        });
        if !outcome.interrupted {
            say(format!(
                "it is that of {reached}{better}; next: bench eval --table all --data {} -m {} -o results",
                options.data.display(),
                model.display()
            ));
        }
    }
    if outcome.interrupted {
        eprint_line(format_args!(
            "interrupted after step {}; continue with: train --resume --data {} --out {} --device {}",
            outcome.steps,
            options.data.display(),
            options.out.display(),
            options.device_names()
        ));
        return Ok(FAILED);
    }
    Ok(DONE)
}
