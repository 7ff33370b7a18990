//! `bench cues`: the depth-cue experiments of the thesis' chapter 4.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum, builder::PossibleValue};
use strat_splits::Role;
use strat_store::{
    command::{CliError, DONE, FAILED, error_chain, print},
    set::PreparedSet,
};

use super::args::{ReplaceArgs, RuntimeArgs, ThreadArgs, named_files};
use crate::{
    cues::{
        backgrounds,
        error::CueError,
        experiments::{self, Cast, Plan},
        journal::Journal,
        rows,
        run::{self, Answers, CueRun, FailureRow, Subject},
        sprites::{self, View},
        summary::Summary,
    },
    evaluate::{NamedFile, ownership},
    model::{Model, ModelError, leakage::Tested, vet::vet},
    notes::Notes,
    runtime::Device,
};

/// Which experiments to make.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Cue {
    /// Relative size: one object in 50 sizes (figures 4.3 to 4.6)
    Size,
    /// Occlusion and luminance contrast (figure 4.7)
    Occlusion,
    /// Height in the visual field (figures 4.8 to 4.10)
    Height,
    /// All three
    All,
}

impl ValueEnum for View {
    fn value_variants<'a>() -> &'a [Self] {
        &[Self::Rear, Self::Side]
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        Some(match self {
            Self::Rear => PossibleValue::new("rear").help("From behind"),
            Self::Side => PossibleValue::new("side").help("From its side"),
        })
    }
}

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bench cues --data kitti_set -m model.onnx -o cues        all experiments
  bench cues size --data kitti_set -m a.onnx -m b.onnx -o cues
  bench cues --render cues                                 figures and summary again")]
pub(super) struct CuesArgs {
    /// Experiments to make
    #[arg(value_enum, default_value = "all")]
    cues: Vec<Cue>,
    /// Folder that `prep` has written; its test images are the backgrounds
    #[arg(long, value_name = "DIR", required_unless_present = "render")]
    data: Option<PathBuf>,
    /// ONNX file, with the name shown in figures; may be given several times
    #[arg(
        short,
        long = "model",
        value_name = "[NAME=]FILE.onnx",
        required_unless_present = "render"
    )]
    models: Vec<String>,
    /// Folder for rows, summary and figures
    #[arg(short, long, value_name = "DIR", required_unless_present = "render")]
    out: Option<PathBuf>,
    /// Draw figures and summary of this folder again from its cues.csv, without a model
    #[arg(long, value_name = "DIR", conflicts_with_all = ["data", "models", "out", "sprites"])]
    render: Option<PathBuf>,
    /// Folder of RGBA PNG files with a sprites.yaml, instead of the sprites that come along
    #[arg(long, value_name = "DIR")]
    sprites: Option<PathBuf>,
    /// From where cars and pedestrians are seen
    #[arg(long, value_enum, default_value = "rear")]
    view: View,
    /// Number of backgrounds, at least 5; the first 5 are the thesis' own 500 composites
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u16).range(5..=1000))]
    backgrounds: u16,
    /// Image ids to use as backgrounds instead of choosing by labels, separated by commas
    #[arg(long, value_name = "ID,...", value_delimiter = ',')]
    frames: Vec<String>,
    /// Number of sizes of the size experiment
    #[arg(long, value_name = "N", default_value_t = 50, value_parser = clap::value_parser!(u32).range(3..=1000))]
    scales: u32,
    /// Row of the horizon in all backgrounds [default: the camera's of KITTI, else the middle]
    #[arg(long, value_name = "ROW")]
    horizon_row: Option<f64>,
    #[command(flatten)]
    runtime: RuntimeArgs,
    #[command(flatten)]
    threads: ThreadArgs,
    #[command(flatten)]
    replace: ReplaceArgs,
    /// Print the summary as JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &CuesArgs, arguments: Vec<String>) -> anyhow::Result<u8> {
    if let Some(folder) = &args.render {
        let summary = run::render(folder)?;
        print(shown(&summary, args.json)?)?;
        Notes::new(args.runtime.quiet).say(&format!(
            "figures and summary of {} are drawn again; sheets of pictures stay",
            folder.display()
        ));
        return Ok(DONE);
    }
    let (Some(data), Some(out)) = (&args.data, &args.out) else {
        return Err(CliError::Usage(
            "`bench cues` needs --data, --model and --out, or --render".to_owned(),
        )
        .into());
    };
    let models = named_files("model", &args.models, &[])?;
    let mut inputs: Vec<&Path> = models.iter().map(|given| given.file.as_path()).collect();
    inputs.extend([data.as_path()].into_iter().chain(args.sprites.as_deref()));
    run::MARK.examine(out, &inputs)?;
    let set = PreparedSet::open(data)?;
    let (all, source) = match &args.sprites {
        Some(folder) => (
            sprites::read_folder(folder)?,
            folder.join(sprites::DESCRIPTION),
        ),
        None => (sprites::embedded()?, PathBuf::from("the embedded sprites")),
    };
    let cast = Cast::choose(all, args.view, &source)?;
    let pool = args.threads.pool()?;
    let backgrounds = backgrounds::backgrounds(
        &set,
        &args.frames,
        usize::from(args.backgrounds),
        args.horizon_row,
        &pool,
    )?;
    let grounds: Vec<_> = backgrounds
        .iter()
        .map(|background| background.ground)
        .collect();
    let wants = |cue: Cue| args.cues.contains(&cue) || args.cues.contains(&Cue::All);
    let plan = Plan {
        size: wants(Cue::Size),
        occlusion: wants(Cue::Occlusion),
        height: wants(Cue::Height),
        scales: args.scales,
    };
    let jobs = experiments::jobs(plan, &cast, &grounds)?;
    let runtime = args.runtime.resolve()?;
    let cue_run = CueRun {
        set: &set,
        cast,
        backgrounds,
        jobs,
        scales: args.scales,
        pool: &pool,
        out,
        quiet: args.runtime.quiet,
    };
    let earlier = cue_run.claim(&models, &inputs, args.replace.force)?;
    let mut notes = Notes::new(args.runtime.quiet);
    notes.say(&format!(
        "{} backgrounds, {} composites, {runtime}, device {}",
        cue_run.backgrounds.len(),
        cue_run.composites(),
        args.runtime.device
    ));
    let found = cue_run.notes(args.horizon_row.is_some());
    found.iter().for_each(|note| notes.note(note));
    let open = |given: &NamedFile| {
        let NamedFile { name, file } = given;
        let threads = args.threads.within_model();
        Model::open(name, file, &runtime, args.runtime.device, threads)
    };
    let (mut all_rows, mut records, mut failures, mut journals) = (vec![], vec![], vec![], vec![]);
    for given in &models {
        let NamedFile { name, file } = given;
        match ask(&cue_run, open(given), file, args.runtime.device, &mut notes) {
            Ok(answers) => {
                let outcome = answers.outcome;
                if outcome.not_tried > 0 {
                    notes.fail(format!(
                        "model {name}: {} attempts failed, {} were not tried",
                        outcome.failures.len(),
                        outcome.not_tried
                    ));
                }
                failures.extend(
                    outcome
                        .failures
                        .iter()
                        .map(|one| FailureRow::new(name, one)),
                );
                all_rows.extend(outcome.rows);
                records.push(answers.record);
                journals.push(answers.journal);
            }
            Err(error) if is_interrupt(&error) => return Err(error),
            Err(error) => notes.fail(format!("model {name}: {}", error_chain(error.as_ref()))),
        }
    }
    if let Some(what) = earlier.iter().find_map(|earlier| earlier.lacks(&records)) {
        return Err(CliError::failed(ownership::refuse(out, &what)).into());
    }
    run::write_failures(out, &failures)?;
    if all_rows.is_empty() {
        notes.fail("nothing could be measured; no summary was written".to_owned());
        return Ok(FAILED);
    }
    rows::write(out, &all_rows)?;
    cue_run.write_record(data, &records, &arguments)?;
    notes.say("drawing figures and intervals ...");
    let summary = run::write_results(out, &all_rows)?;
    journals.into_iter().try_for_each(Journal::finish)?;
    print(shown(&summary, args.json)?)?;
    let folder = out.display();
    notes.say(&format!(
        "results are in {folder}; next: bench report {folder}"
    ));
    if !failures.is_empty() {
        notes.fail(format!(
            "{} composite(s) have no row; {} says why",
            failures.len(),
            out.join(run::FAILURES).display()
        ));
    }
    Ok(if notes.incomplete { FAILED } else { DONE })
}

fn is_interrupt(error: &anyhow::Error) -> bool {
    let cause = error.downcast_ref();
    matches!(
        cause,
        Some(CueError::Store(strat_store::Error::Interrupted))
    )
}

/// Vets a model and asks it about all composites.
fn ask(
    cue_run: &CueRun<'_>,
    model: Result<Model, ModelError>,
    file: &Path,
    device: Device,
    notes: &mut Notes,
) -> anyhow::Result<Answers> {
    let mut model = model?;
    let samples = cue_run.set.samples(Role::Test)?;
    let vetting = vet(
        &mut model,
        Some(Tested::new(&cue_run.set.manifest, &samples)),
    )?;
    vetting.notes.iter().for_each(|note| notes.note(note));
    let warnings = vetting.warnings;
    warnings
        .iter()
        .for_each(|warning| notes.warn(warning.clone()));
    let subject = Subject {
        model: &mut model,
        file,
        device: device.to_string(),
        warnings,
    };
    let answers = cue_run.ask(subject, |text| notes.say(text))?;
    notes.say(&format!(
        "{}: {:.1} s, of which compositing and measuring took {:.1} %",
        model.name,
        answers.outcome.wall.as_secs_f64(),
        100.0 * answers.outcome.overhead()
    ));
    Ok(answers)
}

fn shown(summary: &Summary, json: bool) -> anyhow::Result<String> {
    Ok(if json {
        serde_json::to_string_pretty(summary)? + "\n"
    } else {
        summary.text()
    })
}
