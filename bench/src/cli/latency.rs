//! `bench latency`: times models over threads and batches.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::Args;
use strat_splits::Role;
use strat_store::{
    command::{CliError, DONE, FAILED, error_chain, print},
    files,
    progress::Progress,
    set::PreparedSet,
};

use super::{
    args::{RuntimeArgs, named_files},
    predict::images_below,
};
use crate::{
    evaluate::record::TOOL_VERSION,
    latency::{
        self, Bench, FORMAT, LatencyRow, Least, MOST_IMAGES, Measured, Scenario, Shot, Stage,
    },
    model::{Model, vet::vet},
    quantity::Rig,
    runtime::inventory::{self, Processor},
    runtime::{Runtime, placement_text},
};

#[derive(Debug, Args)]
pub(super) struct LatencyArgs {
    /// ONNX file, with the name it shall have in the table; may be given several times
    #[arg(long = "model", value_name = "[NAME=]FILE.onnx", required = true)]
    models: Vec<String>,
    /// Folder that `prep` has written: its test images and their cameras are used
    #[arg(
        long,
        value_name = "DIR",
        required_unless_present = "images",
        conflicts_with = "images"
    )]
    data: Option<PathBuf>,
    /// Folder of PNG or JPEG images
    #[arg(long, value_name = "DIR")]
    images: Option<PathBuf>,
    /// Focal length of the images in pixels of their own width, for depth from --images
    #[arg(long, value_name = "PX", requires = "baseline_m", conflicts_with = "data",
          value_parser = super::predict::positive)]
    focal_px: Option<f64>,
    /// Stereo baseline in metres that the model was trained with, for depth from --images
    #[arg(long, value_name = "M", requires = "focal_px", conflicts_with = "data",
          value_parser = super::predict::positive)]
    baseline_m: Option<f64>,
    /// Folder for latency.csv
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Thread counts to try, within the model and for decoding [default: all cores]
    #[arg(long, value_name = "N,N,...", value_delimiter = ',',
          value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Vec<u16>,
    /// Batch sizes to try; above 1 only where the model's batch dimension is open
    #[arg(long, value_name = "N,N,...", value_delimiter = ',', default_value = "1",
          value_parser = clap::value_parser!(u16).range(1..=4096))]
    batch: Vec<u16>,
    /// Least duration of each measurement in seconds
    #[arg(long, value_name = "S", default_value_t = Least::default().seconds, value_parser = seconds)]
    seconds: f64,
    /// Least number of queries in each measurement (images in the offline scenario)
    #[arg(long, value_name = "N", default_value_t = Least::default().queries,
          value_parser = clap::value_parser!(u64).range(1..))]
    queries: u64,
    #[command(flatten)]
    runtime: RuntimeArgs,
}

fn seconds(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if (0.0..=1e6).contains(&value) => Ok(value),
        _ => Err("a number of seconds from 0 to 1000000 is needed".to_owned()),
    }
}

/// What stays the same in a run of the command.
struct Run<'a> {
    args: &'a LatencyArgs,
    runtime: Runtime,
    shots: Vec<Shot>,
    threads: Vec<usize>,
    batches: Vec<usize>,
    processor: Processor,
}

impl Run<'_> {
    fn note(&self, text: &str) {
        if !self.args.runtime.quiet {
            eprintln!("note: {text}");
        }
    }
}

pub(super) fn run(args: &LatencyArgs) -> anyhow::Result<u8> {
    let asked = named_files("model", &args.models, &[])?;
    let shots = shots(args)?;
    files::check_writable(&args.out)?;
    let processor = inventory::processor();
    let threads = if args.threads.is_empty() {
        vec![processor.threads]
    } else {
        distinct(&args.threads)
    };
    let runtime = args.runtime.resolve()?;
    let run = Run {
        args,
        runtime,
        shots,
        threads,
        batches: distinct(&args.batch),
        processor,
    };
    run.note(&format!(
        "{} images, {runtime}, device {}, {} ({} threads); each measurement takes at least {} s and \
         {} queries after {} for warming up",
        run.shots.len(),
        args.runtime.device,
        run.processor.model,
        run.processor.threads,
        args.seconds,
        args.queries,
        latency::WARM_UP
    ));
    if args.queries < 100 {
        run.note("below 100 queries the 99th percentile is the slowest query");
    }
    let (mut rows, mut failed) = (Vec::new(), false);
    for asked in &asked {
        if let Err(error) = time_model(&run, &asked.name, &asked.file, &mut rows, &mut failed) {
            eprintln!(
                "error: model {}: {}",
                asked.name,
                error_chain(error.as_ref())
            );
            failed = true;
        }
    }
    if rows.is_empty() {
        eprintln!("error: nothing could be measured, so there is no latency.csv");
        return Ok(FAILED);
    }
    let path = args.out.join("latency.csv");
    files::write_atomic_with(&path, |out| latency::write_rows(&rows, out))?;
    print(table(&rows))?;
    if !args.runtime.quiet {
        eprintln!("rows are in {}", path.display());
    }
    Ok(if failed { FAILED } else { DONE })
}

fn distinct(values: &[u16]) -> Vec<usize> {
    let mut found: Vec<usize> = Vec::new();
    for value in values.iter().copied().map(usize::from) {
        if !found.contains(&value) {
            found.push(value);
        }
    }
    found
}

/// The images to take turns with, spread evenly over what is there.
fn shots(args: &LatencyArgs) -> anyhow::Result<Vec<Shot>> {
    let all: Vec<Shot> = if let Some(root) = &args.data {
        let set = PreparedSet::open(root)?;
        set.samples(Role::Test)?
            .iter()
            .map(|sample| Shot {
                path: set.path(sample.left_full.as_ref().unwrap_or(&sample.left)),
                // The focal length belongs to the untouched image; 0 is not known.
                rig: (sample.left_full.is_some()
                    && sample.focal_px > 0.0
                    && sample.baseline_m > 0.0)
                    .then_some(Rig {
                        focal_px: sample.focal_px,
                        baseline_m: sample.baseline_m,
                    }),
            })
            .collect()
    } else {
        let folder = args.images.as_deref().unwrap_or(Path::new("."));
        let rig = rig(args.focal_px, args.baseline_m);
        images_below(folder)?
            .into_iter()
            .map(|path| Shot { path, rig })
            .collect()
    };
    if all.is_empty() {
        let place = args.data.as_ref().or(args.images.as_ref());
        return Err(CliError::Usage(format!(
            "there are no {} in {}",
            if args.data.is_some() {
                "test images"
            } else {
                "PNG or JPEG images"
            },
            place
                .map(|path| path.display().to_string())
                .unwrap_or_default()
        ))
        .into());
    }
    let count = all.len().min(MOST_IMAGES);
    Ok((0..count)
        .map(|i| all[i * all.len() / count].clone())
        .collect())
}

pub(super) fn rig(focal_px: Option<f64>, baseline_m: Option<f64>) -> Option<Rig> {
    Some(Rig {
        focal_px: focal_px?,
        baseline_m: baseline_m?,
    })
}

/// Measures one model in every combination. A combination that fails is named and left out.
fn time_model(
    run: &Run<'_>,
    name: &str,
    file: &Path,
    rows: &mut Vec<LatencyRow>,
    failed: &mut bool,
) -> anyhow::Result<()> {
    let args = run.args;
    let open = |threads| Model::open(name, file, &run.runtime, args.runtime.device, threads);
    let mut accuracy = open(run.processor.threads)?;
    let vetting = vet(&mut accuracy, None)?;
    for note in &vetting.notes {
        run.note(note);
    }
    if vetting.probe_failed() {
        anyhow::bail!(
            "{}; a runtime that computes something else is not timed",
            vetting.warnings.join("; ")
        );
    }
    for warning in &vetting.warnings {
        eprintln!("warning: {warning}");
    }
    if let Some(placement) = placement_text(accuracy.placement()) {
        run.note(&format!("model {name}: {placement}"));
    }
    let mut batches = run.batches.clone();
    if !accuracy.takes_batches() && batches.iter().any(|&batch| batch > 1) {
        run.note(&format!(
            "model {name} has a fixed batch of 1, so other batches are left out; export it with an \
             open first dimension to time them"
        ));
        batches.retain(|&batch| batch == 1);
    }
    let bench = Bench::new(&run.shots, &mut accuracy, &batches)?;
    drop(accuracy);
    for &threads in &run.threads {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .ok()
            .with_context(|| latency::LatencyError::Threads(threads).to_string())?;
        let mut model = open(threads)?;
        for &batch in &batches {
            let setting = Setting {
                threads,
                batch,
                pool: &pool,
            };
            if let Err(error) = time_setting(run, &bench, &mut model, &setting, rows) {
                eprintln!(
                    "error: model {name}, {threads} thread(s), batch {batch}: {}",
                    error_chain(error.as_ref())
                );
                *failed = true;
            }
        }
    }
    Ok(())
}

struct Setting<'a> {
    threads: usize,
    batch: usize,
    pool: &'a rayon::ThreadPool,
}

fn time_setting(
    run: &Run<'_>,
    bench: &Bench<'_>,
    model: &mut Model,
    setting: &Setting<'_>,
    rows: &mut Vec<LatencyRow>,
) -> anyhow::Result<()> {
    let &Setting {
        threads,
        batch,
        pool,
    } = setting;
    let before = bench.verify(model, threads, batch)?;
    let stream = Least {
        seconds: run.args.seconds,
        queries: run.args.queries,
    };
    // A query of the offline scenario is whatever keeps all threads busy.
    let at_once = batch * (2 * threads).div_ceil(batch);
    let offline = |images_per_query: usize| Least {
        queries: stream.queries.div_ceil(images_per_query as u64),
        ..stream
    };
    let streaming = if batch == 1 {
        Scenario::SingleStream
    } else {
        Scenario::MultiStream
    };
    let label = format!("{}, threads {threads}, batch {batch}", model.name);
    let progress = Progress::new(&label, 4, "measurements", run.args.runtime.quiet);
    let mut measured: Vec<(Stage, Scenario, Measured)> = Vec::new();
    let file = bench.file_stage();
    for (stage, scenario) in [
        (Stage::Session, streaming),
        (Stage::Session, Scenario::Offline),
        (file, streaming),
        (file, Scenario::Offline),
    ] {
        let clock = latency::wall_clock();
        let result = match (stage, scenario) {
            (Stage::Session, Scenario::Offline) => {
                bench.time_session(model, batch, offline(batch), clock)?
            }
            (Stage::Session, _) => bench.time_session(model, batch, stream, clock)?,
            (_, Scenario::Offline) => {
                bench.time_files(model, batch, at_once, pool, offline(at_once), clock)?
            }
            _ => bench.time_files(model, batch, batch, pool, stream, clock)?,
        };
        measured.push((stage, scenario, result));
        progress.add(1);
    }
    progress.finish();
    // A session that went wrong on its way has no figures either.
    let max_difference = before.max(bench.verify(model, threads, batch)?);
    rows.extend(measured.into_iter().map(|(stage, scenario, measured)| {
        let latencies = measured.latencies.filter(|_| scenario != Scenario::Offline);
        LatencyRow {
            format: FORMAT,
            model: model.name.clone(),
            model_hash: model.file.blake3.clone(),
            device: run.args.runtime.device.to_string(),
            provider: model.provider().to_owned(),
            runtime: model.runtime().to_owned(),
            threads,
            batch,
            scenario,
            stage,
            input_width: model.description.input.width,
            input_height: model.description.input.height,
            samples: run.shots.len(),
            queries: measured.queries,
            images: measured.images,
            seconds: measured.seconds,
            images_per_second: measured.images as f64 / measured.seconds.max(1e-9),
            mean_ms: latencies.map(|l| l.mean_ms),
            min_ms: latencies.map(|l| l.min_ms),
            p50_ms: latencies.map(|l| l.p50_ms),
            p90_ms: latencies.map(|l| l.p90_ms),
            p95_ms: latencies.map(|l| l.p95_ms),
            p99_ms: latencies.map(|l| l.p99_ms),
            max_ms: latencies.map(|l| l.max_ms),
            max_difference,
            processor: run.processor.model.clone(),
            processor_threads: run.processor.threads,
            tool_version: TOOL_VERSION.to_owned(),
        }
    }));
    Ok(())
}

/// The rows for a terminal; latencies in milliseconds per query.
fn table(rows: &[LatencyRow]) -> String {
    let heading = [
        "model", "threads", "batch", "stage", "scenario", "mean ms", "p50", "p90", "p95", "p99",
        "images/s",
    ];
    let mut lines: Vec<Vec<String>> = vec![heading.map(str::to_owned).to_vec()];
    for row in rows {
        let ms = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |v| format!("{v:.2}"));
        lines.push(vec![
            row.model.clone(),
            row.threads.to_string(),
            row.batch.to_string(),
            row.stage.to_string(),
            row.scenario.to_string(),
            ms(row.mean_ms),
            ms(row.p50_ms),
            ms(row.p90_ms),
            ms(row.p95_ms),
            ms(row.p99_ms),
            format!("{:.2}", row.images_per_second),
        ]);
    }
    let widths: Vec<usize> = (0..heading.len())
        .map(|column| {
            let lengths = lines.iter().map(|line| line[column].chars().count());
            lengths.max().unwrap_or(0)
        })
        .collect();
    let mut text = String::new();
    for line in lines {
        for (column, cell) in line.iter().enumerate() {
            let width = widths[column];
            // Words to the left, numbers to the right.
            let cell = if matches!(column, 0 | 3 | 4) {
                format!("{cell:<width$}")
            } else {
                format!("{cell:>width$}")
            };
            text.push_str(&cell);
            text.push_str("  ");
        }
        text.truncate(text.trim_end().len());
        text.push('\n');
    }
    if let Some(row) = rows.first() {
        text += &format!(
            "{} on {} ({}), {}\n",
            row.runtime, row.device, row.provider, row.processor
        );
    }
    text
}
