//! `bench figures`: models side by side on the same images.

use std::{
    collections::{BTreeSet, HashMap},
    path::{Path, PathBuf},
};

use anyhow::Context as _;
use clap::Args;
use serde::Serialize;
use strat_metrics::{Protocol, Row, RowContext, Suffix};
use strat_onnx::metadata::OutputMeaning;
use strat_splits::Role;
use strat_store::{
    command::{CliError, DONE, FAILED, error_chain, print},
    files, image_files,
    progress::Progress,
    resize,
    set::{Content, PreparedSet, Sample},
    yaml,
};

use super::args::{RuntimeArgs, ThreadArgs, named_files};
use crate::{
    draw::chart,
    draw::side_by_side::{self, Frame, Shown, Synthesis, SynthesisFrame},
    evaluate::predictions::SavedPredictions,
    evaluate::{
        self, Comparison, NamedFile, Predictor, Task,
        plan::{self, TableChoice},
        record::TOOL_VERSION,
    },
    model::{self, Model, vet::vet},
    rows::compare,
    runtime::Runtime,
};

/// PNG pixels for each unit of the SVG.
const ZOOM: f32 = 1.0;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bench figures --data kitti_set --model noadv.onnx --model strat.onnx --out figures
  bench figures --data eigen_set --model strat.onnx --rows results/rows.csv --worst 4 --out worst
  bench figures --data make3d_set --model strat.onnx --out figures")]
pub(super) struct FiguresArgs {
    /// Folder that `prep` has written
    #[arg(long, value_name = "DIR")]
    data: PathBuf,
    /// ONNX file, with the name it shall have in figures; may be given several times
    #[arg(long = "model", value_name = "[NAME=]FILE.onnx")]
    models: Vec<String>,
    /// Saved predictions, as for `bench --predictions`
    #[arg(long = "predictions", value_name = "[NAME=]PATH")]
    predictions: Vec<String>,
    /// Folder for the figures
    #[arg(long, value_name = "DIR")]
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
    /// Protocol whose ground truth and camera are used [default: that of the set's first table]
    #[arg(long, value_name = "NAME|FILE.yaml")]
    protocol: Option<String>,
    #[command(flatten)]
    runtime: RuntimeArgs,
    #[command(flatten)]
    threads: ThreadArgs,
}

/// What was drawn; written beside the figures.
#[derive(Serialize)]
struct Record {
    tool: &'static str,
    tool_version: &'static str,
    arguments: Vec<String>,
    data: PathBuf,
    data_digest: String,
    protocol: String,
    images: Vec<String>,
    models: Vec<ModelRecord>,
    figures: Vec<String>,
}

#[derive(Serialize)]
struct ModelRecord {
    name: String,
    file: PathBuf,
    blake3: String,
}

/// What one model made of the chosen images.
struct Drawn {
    record: ModelRecord,
    comparisons: HashMap<String, Shown<Comparison>>,
    /// Right views; none where the model gives no right disparity.
    syntheses: HashMap<String, Shown<Synthesis>>,
}

pub(super) fn run(args: &FiguresArgs, arguments: Vec<String>) -> anyhow::Result<u8> {
    let asked = named_files("model", &args.models, &[])?;
    let taken: Vec<&str> = asked.iter().map(|asked| asked.name.as_str()).collect();
    let asked_saved = named_files("predictions", &args.predictions, &taken)?;
    if asked.is_empty() && asked_saved.is_empty() {
        return Err(CliError::Usage(
            "nothing to draw: give `--model` or `--predictions`".to_owned(),
        )
        .into());
    }
    if args.rows.is_some() && args.worst + args.best == 0 {
        return Err(CliError::Usage("`--rows` needs `--worst N` or `--best N`".to_owned()).into());
    }
    let set = PreparedSet::open(&args.data)?;
    let samples = set.samples(Role::Test)?;
    let protocol = protocol_of(args, &set, &samples)?;
    let chosen = choose(args, &samples)?;
    files::check_writable(&args.out)?;
    let pool = args.threads.pool()?;
    let job = Job {
        args,
        set: &set,
        samples: &samples,
        chosen: &chosen,
        protocol: &protocol,
        pool: &pool,
    };
    let mut drawn = Vec::new();
    let mut failed = false;
    let mut keep = |name: &str, result: anyhow::Result<Drawn>| match result {
        Ok(found) => drawn.push(found),
        Err(error) => {
            eprintln!("error: {name}: {}", error_chain(error.as_ref()));
            failed = true;
        }
    };
    if !asked.is_empty() {
        let runtime = args.runtime.resolve()?;
        for asked in &asked {
            keep(&asked.name, job.of_model(asked, &runtime));
        }
    }
    for asked in &asked_saved {
        keep(&asked.name, job.of_saved(asked));
    }
    if drawn.is_empty() {
        return Ok(FAILED);
    }
    for one in &drawn {
        for (image, why) in one.problems() {
            eprintln!("error: {}, image {image}: {why}", one.record.name);
            failed = true;
        }
    }
    let written = job.write(&drawn)?;
    let record = Record {
        tool: "bench figures",
        tool_version: TOOL_VERSION,
        arguments,
        data: args.data.clone(),
        data_digest: set.manifest.data_digest.clone(),
        protocol: protocol.name.clone(),
        images: chosen.iter().map(|sample| sample.id.clone()).collect(),
        models: drawn.into_iter().map(|one| one.record).collect(),
        figures: written.clone(),
    };
    let text = yaml::to_string(&record)?;
    files::write_atomic(&args.out.join("figures.yaml"), text.as_bytes())?;
    let lines: Vec<String> = written
        .iter()
        .map(|name| format!("{}\n", args.out.join(format!("{name}.svg")).display()))
        .collect();
    print(lines.concat())?;
    Ok(if failed { FAILED } else { DONE })
}

/// The protocol asked for, or the first one of the set's tables; own pairs and Cityscapes have none.
fn protocol_of(
    args: &FiguresArgs,
    set: &PreparedSet,
    samples: &[Sample],
) -> anyhow::Result<Protocol> {
    let content = set.manifest.content;
    let asked: Vec<String> = match (&args.protocol, content) {
        (Some(name), _) => vec![name.clone()],
        (None, Content::Pairs | Content::Cityscapes) => vec!["eigen-cameraz-80".to_owned()],
        (None, _) => Vec::new(),
    };
    let count = plan::test_count(set, samples);
    let plan = plan::plan(TableChoice::All, &asked, content, samples, count)?;
    let found = match &args.protocol {
        Some(_) => plan.protocols.into_iter().next_back(),
        None => plan.protocols.into_iter().next(),
    };
    let found = found.map(|found| match &args.protocol {
        // One that a table has too stands in the table's place of the plan.
        Some(name) => crate::protocol_file::resolve(name).unwrap_or(found),
        None => found,
    });
    found.context("this set has no protocol of its own; give one with `--protocol`")
}

/// The test images to be drawn.
fn choose(args: &FiguresArgs, samples: &[Sample]) -> anyhow::Result<Vec<Sample>> {
    let by_id =
        |id: &str| -> anyhow::Result<Sample> {
            let found = samples.iter().find(|sample| sample.id == id);
            found.cloned().ok_or_else(|| {
            let drive = id.split('/').next().unwrap_or(id);
            let near = samples.iter().find(|sample| sample.id.starts_with(drive));
            let example = near.or(samples.first()).map_or("", |sample| sample.id.as_str());
            anyhow::anyhow!(
                "{} has no test image {id}; one that it has is {example}, and test.csv lists all",
                args.data.display()
            )
        })
        };
    if !args.frames.is_empty() {
        return args.frames.iter().map(|id| by_id(id.trim())).collect();
    }
    let Some(path) = &args.rows else {
        let count = usize::from(args.count).min(samples.len());
        let even = (0..count).map(|place| samples[place * samples.len() / count].clone());
        return Ok(even.collect());
    };
    let rows = compare::read_rows(path)?;
    let ranked = ranked(&rows);
    let ends = ranked.iter().rev().take(args.worst);
    let mut seen = BTreeSet::new();
    ends.chain(ranked.iter().take(args.best))
        .filter(|id| seen.insert(**id))
        .map(|id| by_id(id))
        .collect()
}

/// Images by their Abs Rel under the first protocol without groups, in the mean over the models,
/// best first.
fn ranked(rows: &[Row]) -> Vec<&str> {
    let first = rows.iter().find(|row| row.score.group.is_none());
    let mut sums: HashMap<&str, (f64, f64)> = HashMap::new();
    for row in rows {
        if first.is_some_and(|first| first.context.protocol == row.context.protocol) {
            let (sum, count) = sums.entry(&row.image).or_default();
            *sum += row.score.metrics.abs_rel;
            *count += 1.0;
        }
    }
    let mut ranked: Vec<(&str, f64)> = sums
        .into_iter()
        .map(|(image, (sum, count))| (image, sum / count))
        .collect();
    ranked.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(b.0)));
    ranked.into_iter().map(|(image, _)| image).collect()
}

/// What is the same for all models.
struct Job<'a> {
    args: &'a FiguresArgs,
    set: &'a PreparedSet,
    samples: &'a [Sample],
    chosen: &'a [Sample],
    protocol: &'a Protocol,
    pool: &'a rayon::ThreadPool,
}

impl Job<'_> {
    fn of_model(&self, asked: &NamedFile, runtime: &Runtime) -> anyhow::Result<Drawn> {
        let threads = self.args.threads.within_model(self.pool);
        let device = self.args.runtime.device;
        let mut model = Model::open(&asked.name, &asked.file, runtime, device, threads)?;
        let vetting = vet(&mut model, Some((self.set.manifest.content, self.samples)))?;
        for warning in &vetting.warnings {
            eprintln!("warning: {warning}");
        }
        let meaning = model.description.output.meaning();
        let comparisons = self.compare(&asked.name, &mut Predictor::Model(&mut model), meaning);
        let mut syntheses = HashMap::new();
        for sample in self.chosen {
            match self.synthesize(&mut model, sample) {
                Ok(None) => {}
                Ok(Some(synthesis)) => {
                    syntheses.insert(sample.id.clone(), Ok(synthesis));
                }
                // A model that fails is named once, by its comparison.
                Err(error) => {
                    syntheses.insert(sample.id.clone(), Err(error_chain(error.as_ref())));
                }
            }
        }
        Ok(Drawn {
            record: ModelRecord {
                name: asked.name.clone(),
                file: asked.file.clone(),
                blake3: model.file.blake3.clone(),
            },
            comparisons,
            syntheses,
        })
    }

    fn of_saved(&self, asked: &NamedFile) -> anyhow::Result<Drawn> {
        let content = self.set.manifest.content;
        let saved = SavedPredictions::open(&asked.name, &asked.file, content, self.samples)?;
        let meaning = saved.meaning();
        let comparisons = self.compare(&asked.name, &mut Predictor::Saved(&saved), meaning);
        Ok(Drawn {
            record: ModelRecord {
                name: asked.name.clone(),
                file: asked.file.clone(),
                blake3: saved.blake3.clone(),
            },
            comparisons,
            syntheses: HashMap::new(),
        })
    }

    /// Predictions beside the ground truth, or why there is none.
    fn compare(
        &self,
        name: &str,
        predictor: &mut Predictor<'_>,
        meaning: OutputMeaning,
    ) -> HashMap<String, Shown<Comparison>> {
        let mut protocol = self.protocol.clone();
        if meaning == OutputMeaning::InverseDepth {
            protocol = protocol.with(Suffix::Median);
        }
        let pictures: BTreeSet<String> = self.chosen.iter().map(|s| s.id.clone()).collect();
        let task = Task {
            set: self.set,
            samples: self.chosen,
            protocols: &[(protocol, RowContext::default())],
            pictures: &pictures,
        };
        let images = self.chosen.len() as u64;
        let progress = Progress::new(name, images, "images", self.args.runtime.quiet);
        let found = evaluate::evaluate(&task, name, predictor, self.pool, &progress, &mut ());
        progress.finish();
        let found = found.unwrap_or_else(|never| match never {});
        let failures = found.failures.into_iter();
        let mut shown: HashMap<String, Shown<Comparison>> = failures
            .map(|failure| (failure.image, Err(failure.reason)))
            .collect();
        for comparison in found.comparisons {
            // One that could not be scored can be looked at all the same.
            shown.insert(comparison.image.clone(), Ok(comparison));
        }
        shown
    }

    /// The right view that a model makes of the left one; none if the model gives no disparity of
    /// the right view, or the set has no right view.
    fn synthesize(&self, model: &mut Model, sample: &Sample) -> anyhow::Result<Option<Synthesis>> {
        let Some(right) = sample.right_full.as_ref().or(sample.right.as_ref()) else {
            return Ok(None);
        };
        let left = evaluate::sample::load_image(self.set, sample)?;
        let input = model.description.input.clone();
        let Some(disparity) = model.predict_right(&model::prepare_input(&left, &input))? else {
            return Ok(None);
        };
        let size = (disparity.width as u32, disparity.height as u32);
        let small = |image| resize::rgb(&image, size.0, size.1, input.kernel);
        let real = image_files::read_rgb(&self.set.path(right))?;
        Ok(Some(Synthesis {
            right: side_by_side::synthesize_right(&small(left), &disparity),
            real: small(real),
        }))
    }

    /// Writes all sheets and returns their names.
    fn write(&self, drawn: &[Drawn]) -> anyhow::Result<Vec<String>> {
        let content = self.set.manifest.content;
        let (name, title) = match content {
            Content::Kitti => ("comparison", "KITTI split"),
            Content::Eigen => ("comparison", "Eigen split"),
            Content::Make3d => ("fig_3_6", "Make3D"),
            Content::Cityscapes => ("comparison", "Cityscapes"),
            Content::Pairs => ("comparison", "Own pairs"),
        };
        let frames: Vec<Frame<'_>> = self
            .chosen
            .iter()
            .map(|sample| Frame {
                image: &sample.id,
                models: drawn
                    .iter()
                    .map(|one| (one.name(), one.comparison(&sample.id)))
                    .collect(),
            })
            .collect();
        let title = format!("{title}: depth and its error under {}", self.protocol.name);
        let mut written = self.write_sheets(name, &side_by_side::comparisons(&title, &frames))?;
        let able: Vec<&Drawn> = drawn
            .iter()
            .filter(|one| !one.syntheses.is_empty())
            .collect();
        if able.is_empty() {
            if !self.args.runtime.quiet {
                eprintln!(
                    "note: no model gives the disparity of the right view for a set with right \
                     views, so there is no sheet of synthesized views"
                );
            }
            return Ok(written);
        }
        let lefts: Vec<Option<image::RgbImage>> = self
            .chosen
            .iter()
            .map(|sample| evaluate::sample::load_image(self.set, sample).ok())
            .collect();
        let frames: Vec<SynthesisFrame<'_>> = self
            .chosen
            .iter()
            .zip(&lefts)
            .map(|(sample, left)| SynthesisFrame {
                image: &sample.id,
                left: left.as_ref(),
                models: able
                    .iter()
                    .map(|one| (one.name(), one.synthesis(&sample.id)))
                    .collect(),
            })
            .collect();
        let title = "Figure 3.10  Synthesized right views at the widest baseline";
        written.extend(self.write_sheets("fig_3_10", &side_by_side::syntheses(title, &frames))?);
        Ok(written)
    }

    fn write_sheets(&self, name: &str, sheets: &[String]) -> anyhow::Result<Vec<String>> {
        let mut written = Vec::new();
        for (place, svg) in sheets.iter().enumerate() {
            let name = if sheets.len() == 1 {
                name.to_owned()
            } else {
                format!("{name}_{}", place + 1)
            };
            let path = |ending: &str| -> PathBuf {
                Path::new(&self.args.out).join(format!("{name}.{ending}"))
            };
            files::write_atomic(&path("svg"), svg.as_bytes())?;
            let png = chart::png(svg, ZOOM).with_context(|| format!("figure {name}"))?;
            files::write_atomic(&path("png"), &png)?;
            written.push(name);
        }
        Ok(written)
    }
}

impl Drawn {
    fn name(&self) -> &str {
        &self.record.name
    }

    fn comparison(&self, image: &str) -> Shown<&Comparison> {
        match self.comparisons.get(image) {
            Some(shown) => shown.as_ref().map_err(Clone::clone),
            None => Err("nothing was predicted".to_owned()),
        }
    }

    fn synthesis(&self, image: &str) -> Shown<&Synthesis> {
        match self.syntheses.get(image) {
            Some(shown) => shown.as_ref().map_err(Clone::clone),
            None => Err("there is no right view".to_owned()),
        }
    }

    /// Images without depth, and why.
    fn problems(&self) -> Vec<(&str, &str)> {
        let mut problems: Vec<(&str, &str)> = self
            .comparisons
            .iter()
            .filter_map(|(image, shown)| Some((image.as_str(), shown.as_ref().err()?.as_str())))
            .collect();
        problems.sort_unstable();
        problems
    }
}
