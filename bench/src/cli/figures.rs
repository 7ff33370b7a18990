//! `bench figures`: models side by side on the same images.

use std::path::{Path, PathBuf};

use clap::Args;
use serde::Serialize;
use strat_splits::Role;
use strat_store::{
    claim::Mark,
    command::{CliError, DONE, FAILED, error_chain, print},
    set::PreparedSet,
    yaml,
};

use super::args::{ReplaceArgs, RuntimeArgs, ThreadArgs, named_files};
use crate::{
    evaluate::{
        NamedFile,
        ownership::{self, Planned},
        record::TOOL_VERSION,
    },
    figures::{self, Choice, Drawn, FigureError, Figures, ModelRecord},
    matching::{self, Matcher, MatchingError, discriminator::Discriminator},
    model::{Model, leakage::Tested, vet::vet},
    notes::Notes,
    rows::compare,
};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bench figures --data kitti_set --model noadv.onnx --model strat.onnx --out figures
  bench figures --data eigen_set --model strat.onnx --rows results/rows.csv --worst 4 --out worst
  bench figures --data make3d_set --model strat.onnx --out figures
  bench figures --data kitti_set --matching --out matching
      figure 3.2, and how often the cheapest match is the true one; no model takes part
  bench figures --data kitti_set --matching --discriminator runs/strat --out matching
      the same with what a discriminator says (`train export runs/strat --discriminator` writes it)")]
pub(super) struct FiguresArgs {
    /// Folder that `prep` has written
    #[arg(long, value_name = "DIR")]
    data: PathBuf,
    /// ONNX file, with the name shown in figures; may be given several times
    #[arg(short, long = "model", value_name = "[NAME=]FILE.onnx")]
    models: Vec<String>,
    /// Saved predictions, as for `bench --predictions`
    #[arg(long = "predictions", value_name = "[NAME=]PATH")]
    predictions: Vec<String>,
    /// Folder for the figures
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
    /// Test images by id, separated by commas
    #[arg(long, value_name = "ID,...", value_delimiter = ',', conflicts_with_all = ["count", "rows"])]
    frames: Vec<String>,
    /// Number of images, spread evenly over the test images
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u16).range(1..=1000))]
    count: u16,
    /// Choose by the Abs Rel of this file, in the mean over its models
    #[arg(long, value_name = "ROWS.csv", conflicts_with = "count")]
    rows: Option<PathBuf>,
    /// With --rows: the N worst images
    #[arg(long, value_name = "N", default_value_t = 0, requires = "rows")]
    worst: usize,
    /// With --rows: the N best images
    #[arg(long, value_name = "N", default_value_t = 0, requires = "rows")]
    best: usize,
    /// Draw what it costs to match pixels of the first image along their lines (figure 3.2), and measure
    /// over all test images how often the cheapest match is the true one, by texture
    #[arg(long)]
    matching: bool,
    /// With --matching: a pixel of the first image, native where the set has native pairs [default:
    /// four of every texture]; may be given several times
    #[arg(long = "pixel", value_name = "X,Y", value_parser = pixel, requires = "matching")]
    pixels: Vec<(usize, usize)>,
    /// With --matching: a run folder, or the file that `train export RUN --discriminator` writes; its
    /// discriminator judges every place of a line too, on prepared images of the size it was trained on
    #[arg(long, value_name = "RUN|FILE.onnx", requires = "matching")]
    discriminator: Option<PathBuf>,
    /// With --matching: pixels searched in each test image [default: 2000, or 8 with a discriminator, which
    /// looks at every place of their lines]
    #[arg(long, value_name = "N", requires = "matching", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    matching_pixels: Option<u32>,
    /// Protocol that errors are drawn under [default: that of the rows, or of the set's first table]
    #[arg(long, value_name = "NAME|FILE.yaml")]
    protocol: Option<String>,
    #[command(flatten)]
    runtime: RuntimeArgs,
    #[command(flatten)]
    threads: ThreadArgs,
    #[command(flatten)]
    replace: ReplaceArgs,
}

/// Whose a folder of figures is.
const MARK: Mark = Mark {
    command: "bench figures",
    record: "figures.yaml",
    begins: "tool: bench figures\n",
    writes: |name| {
        name == "figures.yaml"
            || name == matching::TABLE
            || name.ends_with(".svg")
            || name.ends_with(".png")
    },
};

/// What was drawn; written beside the figures.
#[derive(Serialize)]
struct Record {
    tool: &'static str,
    tool_version: &'static str,
    arguments: Vec<String>,
    data: PathBuf,
    #[serde(flatten)]
    settings: Settings,
    models: Vec<ModelRecord>,
    /// The discriminator that was asked.
    #[serde(skip_serializing_if = "Option::is_none")]
    discriminator: Option<ModelRecord>,
    figures: Vec<String>,
    /// What was warned about.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    warnings: Vec<String>,
}

/// What makes two runs of one model the same.
#[derive(Serialize)]
struct Settings {
    data_digest: String,
    protocol: String,
    images: Vec<String>,
}

impl From<FigureError> for CliError {
    fn from(error: FigureError) -> Self {
        match error {
            FigureError::Store(error) => error.into(),
            FigureError::Plan(_) | FigureError::NotRanked { .. } | FigureError::OtherRules(_) => {
                Self::usage(error)
            }
            error => Self::failed(error),
        }
    }
}

impl From<MatchingError> for CliError {
    fn from(error: MatchingError) -> Self {
        match error {
            MatchingError::Store(error) => error.into(),
            MatchingError::Figure(error) => error.into(),
            MatchingError::NoMatching { .. } | MatchingError::NoTruthAt { .. } => {
                Self::usage(error)
            }
            error => Self::failed(error),
        }
    }
}

/// A column and a row.
fn pixel(text: &str) -> Result<(usize, usize), String> {
    let numbers = text
        .split_once(',')
        .and_then(|(x, y)| Some((x.trim().parse().ok()?, y.trim().parse().ok()?)));
    numbers.ok_or_else(|| "a column and a row are needed, such as 600,180".to_owned())
}

pub(super) fn run(args: &FiguresArgs, arguments: Vec<String>) -> anyhow::Result<u8> {
    let models = named_files("model", &args.models, &[])?;
    let taken: Vec<&str> = models.iter().map(|given| given.name.as_str()).collect();
    let saved = named_files("predictions", &args.predictions, &taken)?;
    let predicts = !models.is_empty() || !saved.is_empty();
    if !predicts && !args.matching {
        return Err(CliError::Usage(
            "nothing to draw: give `--model`, `--predictions` or `--matching`".to_owned(),
        )
        .into());
    }
    if args.rows.is_some() && args.worst + args.best == 0 {
        return Err(CliError::Usage("`--rows` needs `--worst N` or `--best N`".to_owned()).into());
    }
    let set = PreparedSet::open(&args.data)?;
    let samples = set.samples(Role::Test)?;
    let choice = match &args.rows {
        _ if !args.frames.is_empty() => Choice::Images(args.frames.clone()),
        None => Choice::Evenly(usize::from(args.count)),
        Some(path) => Choice::Ranked {
            rows: compare::read_rows(path)?,
            worst: args.worst,
            best: args.best,
        },
    };
    let given = args.protocol.as_deref();
    let protocol = figures::protocol_for(given, &choice, &set, &samples).map_err(CliError::from)?;
    let chosen = figures::choose(&choice, &protocol, &set, &samples).map_err(CliError::from)?;
    let given = models.iter().chain(&saved);
    let mut inputs: Vec<&Path> = given.map(|given| given.file.as_path()).collect();
    inputs.extend(
        [args.data.as_path()]
            .into_iter()
            .chain(args.rows.as_deref())
            .chain(args.discriminator.as_deref()),
    );
    let settings = Settings {
        data_digest: set.manifest.data_digest.clone(),
        protocol: protocol.name.clone(),
        images: chosen.iter().map(|sample| sample.id.clone()).collect(),
    };
    let planned = Planned {
        models: &models,
        named: saved.iter().map(|given| given.name.as_str()).collect(),
    };
    let force = args.replace.force;
    ownership::examine_record(&MARK, &args.out, &inputs, &settings, &planned, force)?;
    MARK.begin(&args.out)?;
    let pool = args.threads.pool()?;
    let mut notes = Notes::new(args.runtime.quiet);
    let figures = Figures {
        set: &set,
        samples: &samples,
        chosen: &chosen,
        protocol: &protocol,
        pool: &pool,
        quiet: notes.quiet,
    };
    let mut drawn = Vec::new();
    let threads = args.threads.within_model();
    let runtime = if models.is_empty() && args.discriminator.is_none() {
        None
    } else {
        Some(args.runtime.resolve()?)
    };
    let device = args.runtime.device;
    let mut judge = None;
    if let (Some(path), Some(runtime)) = (&args.discriminator, &runtime) {
        let kernel = set.manifest.kernel;
        let opened = Discriminator::open(path, kernel, runtime, device, threads);
        let opened = opened.map_err(CliError::usage)?;
        if let Some(doubt) = &opened.doubt {
            notes.warn(doubt.clone());
        }
        judge = Some(opened);
    }
    if let Some(runtime) = &runtime {
        for NamedFile { name, file } in &models {
            let opened = Model::open(name, file, runtime, device, threads).and_then(|mut model| {
                Ok((
                    vet(&mut model, Some(Tested::new(&set.manifest, &samples)))?,
                    model,
                ))
            });
            match opened {
                Ok((vetting, mut model)) => {
                    vetting.notes.iter().for_each(|note| notes.note(note));
                    vetting
                        .warnings
                        .into_iter()
                        .for_each(|warning| notes.warn(warning));
                    drawn.push(figures.of_model(file, &mut model));
                }
                Err(error) => notes.fail(format!("{name}: {}", error_chain(&error))),
            }
        }
    }
    for given in &saved {
        match figures.of_saved(given) {
            Ok(found) => drawn.push(found),
            Err(error) => notes.fail(format!("{}: {}", given.name, error_chain(&error))),
        }
    }
    if drawn.is_empty() && predicts {
        return Ok(FAILED);
    }
    for one in &drawn {
        notes.warnings.extend(one.suspicions.iter().cloned());
        for (image, why) in one.problems() {
            notes.fail(format!("{}, image {image}: {why}", one.record.name));
        }
    }
    if predicts && !drawn.iter().any(Drawn::gives_right_views) {
        notes.note(
            "no model gives the disparity of the right view for a set with right views, so the sheet of \
             synthesised views was not drawn",
        );
    }
    let mut written = Vec::new();
    if predicts {
        written = figures.write(&args.out, &drawn)?;
    }
    if args.matching {
        let matcher = Matcher {
            set: &set,
            samples: &samples,
            image: &chosen[0],
            pixels: &args.pixels,
            per_image: args.matching_pixels.map(|pixels| pixels as usize),
            pool: &pool,
            quiet: notes.quiet,
        };
        let found = matcher.write(&args.out, judge.as_mut());
        let found = found.map_err(CliError::from)?;
        for problem in &found.survey.problems {
            notes.fail(problem.clone());
        }
        print(matching::draw::words(&found.survey))?;
        written.extend(found.written);
    }
    if !written.is_empty() {
        notes.say(&format!(
            "figures are in {folder} as SVG and PNG, what they show in {folder}/figures.yaml; next: numbers for \
             them with bench eval --table all --data {} -m MODEL.onnx -o results",
            args.data.display(),
            folder = args.out.display()
        ));
    }
    let record = Record {
        tool: "bench figures",
        tool_version: TOOL_VERSION,
        arguments,
        data: args.data.clone(),
        settings,
        models: drawn.into_iter().map(|one| one.record).collect(),
        discriminator: judge.map(|judge| ModelRecord {
            name: "discriminator".to_owned(),
            file: judge.path,
            blake3: judge.blake3,
        }),
        warnings: notes.warnings,
        figures: written.clone(),
    };
    let text = yaml::to_string(&record)?;
    MARK.finish(&args.out, text.as_bytes())?;
    let lines: Vec<String> = written
        .iter()
        .map(|name| format!("{}\n", args.out.join(format!("{name}.svg")).display()))
        .collect();
    print(lines.concat())?;
    Ok(if notes.incomplete { FAILED } else { DONE })
}
