//! `bench latency`: times models over threads and batches.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::Args;
use strat_store::{
    claim,
    command::{CliError, DONE, FAILED, error_chain, print},
    files,
    inputs::{self, Kind},
    set::PreparedSet,
};

use super::args::{CameraArgs, ReplaceArgs, RuntimeArgs, named_files};
use crate::{
    evaluate::{
        NamedFile,
        ownership::{self, Planned},
    },
    latency::{self, LatencyRow, Minimum, Timing},
    notes::Notes,
    runtime::inventory,
};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bench latency -m model.onnx --images photos --threads 1,2 --batch 1,4 -o speed
  bench latency -m small.onnx -m large.onnx --data eigen_set -o speed")]
pub(super) struct LatencyArgs {
    /// ONNX file, with the name shown in the table; may be given several times
    #[arg(
        short,
        long = "model",
        value_name = "[NAME=]FILE.onnx",
        required = true
    )]
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
    #[command(flatten)]
    camera: CameraArgs,
    /// Folder for latency.csv
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
    /// Thread counts to try, within the model and for decoding [default: all cores]
    #[arg(long, value_name = "N,N,...", value_delimiter = ',',
          value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Vec<u16>,
    /// Batch sizes to try; above 1 only where the model's batch dimension is open
    #[arg(long, value_name = "N,N,...", value_delimiter = ',', default_value = "1",
          value_parser = clap::value_parser!(u16).range(1..=4096))]
    batch: Vec<u16>,
    /// Minimum duration of each measurement in seconds
    #[arg(long, value_name = "S", default_value_t = Minimum::default().seconds, value_parser = seconds)]
    seconds: f64,
    /// Minimum number of queries in each measurement (images in the offline scenario)
    #[arg(long, value_name = "N", default_value_t = Minimum::default().queries,
          value_parser = clap::value_parser!(u64).range(1..))]
    queries: u64,
    #[command(flatten)]
    runtime: RuntimeArgs,
    #[command(flatten)]
    replace: ReplaceArgs,
    /// Print the rows as JSON
    #[arg(long)]
    json: bool,
}

fn seconds(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if (0.0..=1e6).contains(&value) => Ok(value),
        _ => Err("a number of seconds from 0 to 1000000 is needed".to_owned()),
    }
}

pub(super) fn run(args: &LatencyArgs) -> anyhow::Result<u8> {
    let models = named_files("model", &args.models, &[])?;
    let camera = args.camera.stereo_camera();
    if camera.is_none() && args.camera.focal_px().is_some() {
        return Err(CliError::Usage("--focal-px needs --baseline-m".to_owned()).into());
    }
    if camera.is_some() && args.data.is_some() {
        return Err(CliError::Usage(
            "`--focal-px` and `--baseline-m` are for `--images`; a prepared set knows its cameras"
                .to_owned(),
        )
        .into());
    }
    let images = match (&args.data, &args.images) {
        (Some(root), _) => latency::images_of_set(&PreparedSet::open(root)?)?,
        (None, folder) => {
            latency::images_of_folder(folder.as_deref().unwrap_or(Path::new(".")), camera)?
        }
    };
    if images.is_empty() {
        let folder = args.data.as_ref().or(args.images.as_ref());
        return Err(CliError::Usage(format!(
            "no {} in {}",
            if args.data.is_some() {
                "test images"
            } else {
                "PNG or JPEG images"
            },
            folder.map_or(String::new(), |path| path.display().to_string())
        ))
        .into());
    }
    let path = args.out.join("latency.csv");
    let mut inputs: Vec<&Path> = models.iter().map(|given| given.file.as_path()).collect();
    inputs.extend(
        args.data
            .as_deref()
            .into_iter()
            .chain(args.images.as_deref()),
    );
    claim::check_file(&path, &inputs, "bench latency", latency::HEADER)?;
    files::check_writable(&args.out)?;
    let processor = inventory::processor();
    let threads = if args.threads.is_empty() {
        vec![processor.threads]
    } else {
        distinct(&args.threads)
    };
    if !args.replace.force {
        refuse_to_lose(&path, &models, &threads, &distinct(&args.batch))?;
    }
    let timing = Timing {
        runtime: args.runtime.resolve()?,
        device: args.runtime.device,
        images,
        threads,
        batches: distinct(&args.batch),
        minimum: Minimum {
            seconds: args.seconds,
            queries: args.queries,
        },
        processor,
    };
    let mut notes = Notes::new(args.runtime.quiet);
    notes.note(&format!(
        "{} images, {}, device {}, {} ({} threads); each measurement takes at least {} s and {} \
         queries after {} for warming up",
        timing.images.len(),
        timing.runtime,
        timing.device,
        timing.processor.model,
        timing.processor.threads,
        args.seconds,
        args.queries,
        latency::WARM_UP
    ));
    if args.queries < 100 {
        notes.note("below 100 queries the 99th percentile is the slowest query");
    }
    if let Some(most) = timing
        .threads
        .iter()
        .max()
        .filter(|most| **most > timing.processor.threads)
    {
        notes.warn(format!(
            "{most} threads share {} cores; times with more threads than cores say little about the model",
            timing.processor.threads
        ));
    }
    let busy = sysinfo::System::load_average().one;
    if busy > 0.5 * timing.processor.threads as f64 {
        notes.warn(format!(
            "other programs are at work (load {busy:.1} on {} cores); close them for times that can be compared",
            timing.processor.threads
        ));
    }
    let mut rows = Vec::new();
    for NamedFile { name, file } in &models {
        if let Err(error) = timing.model(name, file, &mut rows, &mut notes) {
            notes.fail(format!("model {name}: {}", error_chain(&error)));
        }
    }
    if rows.is_empty() {
        notes.fail("nothing could be measured; latency.csv was not written".to_owned());
        return Ok(FAILED);
    }
    files::write_atomic_with(&path, |out| latency::write_rows(&rows, out))?;
    print(if args.json {
        let text = serde_json::to_string_pretty(&rows);
        text.context("the rows cannot be written as JSON")? + "\n"
    } else {
        latency::table(&rows)
    })?;
    notes.say(&format!(
        "rows are in {}; next: bench report {}",
        path.display(),
        args.out.display()
    ));
    Ok(if notes.incomplete { FAILED } else { DONE })
}

/// Refuses to replace times of another model, or with threads and batches that are not timed now.
fn refuse_to_lose(
    path: &Path,
    models: &[NamedFile],
    threads: &[usize],
    batches: &[usize],
) -> Result<(), CliError> {
    if !path.exists() {
        return Ok(());
    }
    let bytes = inputs::read(path, Kind::Table)?;
    let rows = latency::read_rows(bytes.as_slice()).unwrap_or_default();
    let planned = Planned {
        models,
        named: Vec::new(),
    };
    let held = rows
        .iter()
        .map(|row| (row.model.as_str(), row.model_hash.as_str()));
    let not_timed =
        |row: &&LatencyRow| !threads.contains(&row.threads) || !batches.contains(&row.batch);
    let lost = planned.lacks(held).or_else(|| {
        rows.iter().find(not_timed).map(|row| {
            format!(
                "times of {} with {} threads and batches of {}, which are not timed now",
                row.model, row.threads, row.batch
            )
        })
    });
    match lost {
        Some(what) => Err(ownership::refuse(path, &what).into()),
        None => Ok(()),
    }
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
