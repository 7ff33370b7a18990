//! `bench cues` and `bench sprites`: the depth-cue experiments of the thesis' chapter 4.

use std::{
    path::{Path, PathBuf},
    time::Duration,
};

use anyhow::Context as _;
use clap::{Args, ValueEnum};
use serde::Serialize;
use strat_metrics::statistics::Bootstrap;
use strat_splits::Role;
use strat_store::{
    command::{CliError, DONE, FAILED, error_chain, print},
    files,
    progress::Progress,
    set::{Content, PreparedSet},
};

use super::args::{RuntimeArgs, ThreadArgs, named_files};
use crate::{
    cues::{
        cutouts,
        experiments::{self, Cast, Job, Plan},
        figures::{self, Figure},
        horizon_row,
        rows::{self, CueRow},
        run::{self, Background, Outcome},
        sprites::{self, View},
        summary::{self, Summary},
    },
    draw::chart,
    evaluate::{
        NamedFile,
        record::{TOOL_VERSION, slug},
    },
    model::{Description, Model, vet::vet},
    runtime::Runtime,
};

/// File names of a run beside the rows.
const RECORD: &str = "cues.yaml";
const FAILURES: &str = "failures.csv";
const VERDICTS: &str = "summary.csv";
const STATISTICS: &str = "statistics.csv";
const MARKDOWN: &str = "summary.md";

/// PNG pixels for each unit of the SVG.
const CHART_ZOOM: f32 = 2.0;
const SHEET_ZOOM: f32 = 1.0;

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

#[derive(Debug, Args)]
pub(super) struct CuesArgs {
    /// Experiments to make
    #[arg(value_enum, default_value = "all")]
    cues: Vec<Cue>,
    /// Folder that `prep` has written; its test images are the backgrounds
    #[arg(long, value_name = "DIR", required_unless_present = "render")]
    data: Option<PathBuf>,
    /// ONNX file, with the name it shall have in figures; may be given several times
    #[arg(
        long = "model",
        value_name = "[NAME=]FILE.onnx",
        required_unless_present = "render"
    )]
    models: Vec<String>,
    /// Folder for rows, summary and figures
    #[arg(long, value_name = "DIR", required_unless_present = "render")]
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
    /// Print the summary as JSON
    #[arg(long)]
    json: bool,
}

/// What ran; written beside the rows.
#[derive(Serialize)]
struct Record {
    tool: &'static str,
    tool_version: &'static str,
    arguments: Vec<String>,
    data: PathBuf,
    data_digest: String,
    content: Content,
    source: String,
    backgrounds: Vec<BackgroundRecord>,
    sprites: Vec<SpriteRecord>,
    composites: usize,
    jobs: usize,
    models: Vec<ModelRecord>,
}

#[derive(Serialize)]
struct BackgroundRecord {
    id: String,
    horizon_row: f64,
    /// Share of humans and vehicles where sprites go, where the set has labels.
    occupied: Option<f64>,
}

#[derive(Serialize)]
struct SpriteRecord {
    name: String,
    height_m: f64,
    blake3: String,
}

#[derive(Serialize)]
struct ModelRecord {
    name: String,
    file: PathBuf,
    blake3: String,
    description: Description,
    runtime: String,
    provider: String,
    device: String,
    rows: usize,
    failures: usize,
    seconds: f64,
    /// Share of that time in which the model did not run.
    overhead: f64,
    /// What was warned about, such as a training on the backgrounds' drives.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    warnings: Vec<String>,
}

/// A failure as a line of `failures.csv`.
#[derive(Serialize)]
struct FailureRow<'a> {
    model: &'a str,
    background: &'a str,
    reason: &'a str,
}

/// Everything that is the same for all models of a run.
struct Session<'a> {
    args: &'a CuesArgs,
    set: PreparedSet,
    cast: Cast,
    backgrounds: Vec<Background>,
    jobs: Vec<Job>,
    pool: rayon::ThreadPool,
    runtime: Runtime,
    out: &'a Path,
}

pub(super) fn run(args: &CuesArgs, arguments: Vec<String>) -> anyhow::Result<u8> {
    if let Some(folder) = &args.render {
        return render(args, folder);
    }
    let (Some(data), Some(out)) = (&args.data, &args.out) else {
        return Err(CliError::Usage(
            "`bench cues` needs --data, --model and --out, or --render".to_owned(),
        )
        .into());
    };
    let asked = named_files("model", &args.models, &[])?;
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
    let backgrounds = run::backgrounds(
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
    files::check_writable(out)?;
    let session = Session {
        args,
        set,
        cast,
        backgrounds,
        jobs,
        pool,
        runtime,
        out,
    };
    session.notes();
    session.evaluate(data, &asked, arguments)
}

impl Session<'_> {
    fn note(&self, text: &str) {
        if !self.args.runtime.quiet {
            eprintln!("{text}");
        }
    }

    fn composites(&self) -> usize {
        self.jobs.iter().map(|job| job.composites.len()).sum()
    }

    fn notes(&self) {
        self.note(&format!(
            "{} backgrounds, {} composites, {}, device {}",
            self.backgrounds.len(),
            self.composites(),
            self.runtime,
            self.args.runtime.device
        ));
        let content = self.set.manifest.content;
        let known = self.args.horizon_row.is_some()
            || self.backgrounds.iter().all(|background| {
                horizon_row(content, background.ground.width, background.ground.height).1
            });
        if !known {
            self.note(
                "note: the cameras' horizon is not known for this collection and taken for the middle \
                 row; give --horizon-row",
            );
        }
        let worst = self
            .backgrounds
            .iter()
            .map(|background| background.occupied)
            .try_fold(0.0_f64, |worst, share| Some(worst.max(share?)));
        match worst {
            None => self.note(
                "note: the set has no labels, so backgrounds are not checked for cars and people in the \
                 path; choose them with --frames",
            ),
            Some(share) if share > 0.02 => self.note(&format!(
                "note: humans and vehicles cover up to {:.0} % of the path in the backgrounds",
                100.0 * share
            )),
            Some(_) => {}
        }
    }

    fn evaluate(
        &self,
        data: &Path,
        asked: &[NamedFile],
        arguments: Vec<String>,
    ) -> anyhow::Result<u8> {
        let mut all_rows: Vec<CueRow> = Vec::new();
        let mut records = Vec::new();
        let mut failures: Vec<(String, run::Failure)> = Vec::new();
        let mut incomplete = false;
        for model in asked {
            match self.ask(model) {
                Ok((record, outcome, sheets)) => {
                    incomplete |= !outcome.failures.is_empty() || outcome.not_tried > 0;
                    if outcome.not_tried > 0 {
                        eprintln!(
                            "error: model {}: the first {} attempts all failed, {} were not tried",
                            model.name,
                            outcome.failures.len(),
                            outcome.not_tried
                        );
                    }
                    failures.extend(
                        outcome
                            .failures
                            .into_iter()
                            .map(|failure| (model.name.clone(), failure)),
                    );
                    all_rows.extend(outcome.rows);
                    records.push(record);
                    // What is there is kept although a later model may fail.
                    if !all_rows.is_empty() {
                        rows::write(self.out, &all_rows)?;
                    }
                    write_figures(self.out, &model.name, &sheets, SHEET_ZOOM)?;
                }
                Err(error) => {
                    eprintln!(
                        "error: model {}: {}",
                        model.name,
                        error_chain(error.as_ref())
                    );
                    incomplete = true;
                }
            }
        }
        self.write_record(data, records, arguments)?;
        let lines: Vec<FailureRow<'_>> = failures
            .iter()
            .map(|(model, failure)| FailureRow {
                model,
                background: &failure.background,
                reason: &failure.reason,
            })
            .collect();
        if !lines.is_empty() {
            files::write_csv(&self.out.join(FAILURES), &lines)?;
        }
        if all_rows.is_empty() {
            eprintln!("error: nothing could be measured, so there is no summary");
            return Ok(FAILED);
        }
        self.note("drawing figures and intervals ...");
        write_results(self.out, &all_rows, self.args.json)?;
        self.note(&format!("results are in {}", self.out.display()));
        if incomplete {
            eprintln!(
                "error: {} composite(s) have no row{}",
                lines.len(),
                if lines.is_empty() {
                    String::new()
                } else {
                    format!("; {} says why", self.out.join(FAILURES).display())
                }
            );
            return Ok(FAILED);
        }
        Ok(DONE)
    }

    /// One model through all composites.
    fn ask(&self, asked: &NamedFile) -> anyhow::Result<(ModelRecord, Outcome, Vec<Figure>)> {
        let threads = self.args.threads.within_model(&self.pool);
        let mut model = Model::open(
            &asked.name,
            &asked.file,
            &self.runtime,
            self.args.runtime.device,
            threads,
        )?;
        let samples = self.set.samples(Role::Test)?;
        let content = self.set.manifest.content;
        let vetting = vet(&mut model, Some((content, &samples)))?;
        for note in &vetting.notes {
            self.note(&format!("note: {note}"));
        }
        let warnings = vetting.warnings;
        for warning in &warnings {
            eprintln!("warning: {warning}");
        }
        let clean = run::predict_clean(&mut model, &self.backgrounds)?;
        let progress = Progress::new(
            &asked.name,
            self.composites() as u64,
            "composites",
            self.args.runtime.quiet,
        );
        let outcome = run::run(
            &mut model,
            &self.cast,
            &self.backgrounds,
            &clean,
            &self.jobs,
            &self.pool,
            &progress,
        );
        progress.finish();
        self.note(&format!(
            "{}: {:.1} s, of which compositing and measuring took {:.1} %",
            asked.name,
            outcome.wall.as_secs_f64(),
            100.0 * outcome.overhead()
        ));
        let sheets = if outcome.rows.is_empty() {
            Vec::new()
        } else {
            figures::sheets(
                &mut model,
                &self.cast,
                &self.backgrounds,
                &clean,
                &self.jobs,
            )?
        };
        let record = ModelRecord {
            name: asked.name.clone(),
            file: asked.file.clone(),
            blake3: model.file.blake3.clone(),
            description: model.description.clone(),
            runtime: model.runtime().to_owned(),
            provider: model.provider().to_owned(),
            device: self.args.runtime.device.to_string(),
            rows: outcome.rows.len(),
            failures: outcome.failures.len(),
            seconds: round(outcome.wall),
            overhead: (1000.0 * outcome.overhead()).round() / 1000.0,
            warnings,
        };
        Ok((record, outcome, sheets))
    }

    fn write_record(
        &self,
        data: &Path,
        models: Vec<ModelRecord>,
        arguments: Vec<String>,
    ) -> anyhow::Result<()> {
        let manifest = &self.set.manifest;
        let record = Record {
            tool: "bench cues",
            tool_version: TOOL_VERSION,
            arguments,
            data: data.to_path_buf(),
            data_digest: manifest.data_digest.clone(),
            content: manifest.content,
            source: manifest.source.clone(),
            backgrounds: self
                .backgrounds
                .iter()
                .map(|background| BackgroundRecord {
                    id: background.id.clone(),
                    horizon_row: background.ground.horizon_row,
                    occupied: background.occupied,
                })
                .collect(),
            sprites: self
                .cast
                .sprites
                .iter()
                .map(|sprite| SpriteRecord {
                    name: sprite.name.clone(),
                    height_m: sprite.height_m,
                    blake3: sprite.blake3.clone(),
                })
                .collect(),
            composites: self.composites(),
            jobs: self.pool.current_num_threads(),
            models,
        };
        let text = strat_store::yaml::to_string(&record)?;
        Ok(files::write_atomic(
            &self.out.join(RECORD),
            text.as_bytes(),
        )?)
    }
}

fn round(time: Duration) -> f64 {
    (1000.0 * time.as_secs_f64()).round() / 1000.0
}

fn render(args: &CuesArgs, folder: &Path) -> anyhow::Result<u8> {
    let rows = rows::read(folder)?;
    write_results(folder, &rows, args.json)?;
    if !args.runtime.quiet {
        eprintln!(
            "figures and summary of {} are drawn anew; sheets of pictures stay",
            folder.display()
        );
    }
    Ok(DONE)
}

/// Summary and curves from rows alone.
fn write_results(out: &Path, rows: &[CueRow], json: bool) -> anyhow::Result<()> {
    let summary = summary::summarise(rows, &Bootstrap::default());
    files::write_csv(&out.join(VERDICTS), &summary.findings)?;
    files::write_csv(&out.join(STATISTICS), &summary.statistics)?;
    files::write_atomic(&out.join(MARKDOWN), summary.markdown().as_bytes())?;
    for name in summary::distinct(rows.iter().map(|row| row.model.as_str())) {
        write_figures(out, name, &figures::curves(name, rows), CHART_ZOOM)?;
    }
    print(if json {
        to_json(&summary)?
    } else {
        summary.text()
    })?;
    Ok(())
}

fn to_json(summary: &Summary) -> anyhow::Result<String> {
    Ok(serde_json::to_string_pretty(summary).context("the summary is no JSON")? + "\n")
}

fn write_figures(out: &Path, model: &str, figures: &[Figure], zoom: f32) -> anyhow::Result<()> {
    let folder = out.join("figures").join(slug(model));
    for (name, svg) in figures {
        files::write_atomic(&folder.join(format!("{name}.svg")), svg.as_bytes())?;
        let png = chart::png(svg, zoom).with_context(|| format!("figure {name}"))?;
        files::write_atomic(&folder.join(format!("{name}.png")), &png)?;
    }
    Ok(())
}

#[derive(Debug, Args)]
pub(super) struct SpritesArgs {
    /// Folder that `prep` has written, with label and instance maps and ground truth
    #[arg(long, value_name = "DIR")]
    data: PathBuf,
    /// Folder for the sprites and their sprites.yaml
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Sprites of each kind (cars and pedestrians)
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=100))]
    each: u16,
    /// No notes
    #[arg(long)]
    quiet: bool,
}

/// Cuts sprites out of a labelled set.
pub(super) fn cut(args: &SpritesArgs) -> anyhow::Result<u8> {
    let set = PreparedSet::open(&args.data)?;
    files::check_writable(&args.out)?;
    let found = cutouts::cut(&set, usize::from(args.each), args.quiet)?;
    let paths = cutouts::write(&args.out, &found)?;
    let lines: String = paths
        .iter()
        .map(|path| format!("{}\n", path.display()))
        .collect();
    print(lines)?;
    for failure in &found.failures {
        eprintln!("error: {failure}");
    }
    if !args.quiet {
        eprintln!(
            "use them with `bench cues --sprites {}`; they are cut from {} images, whose licence they keep",
            args.out.display(),
            set.manifest.source
        );
    }
    Ok(if found.failures.is_empty() {
        DONE
    } else {
        FAILED
    })
}
