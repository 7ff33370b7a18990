//! `bench predict`: depth, disparity and pictures for a user's own images.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use anyhow::Context as _;
use clap::{Args, ValueEnum, builder::PossibleValue};
use serde::Serialize;
use strat_store::{
    claim::{Found, Mark},
    command::{DONE, FAILED, print},
    files, human,
    progress::Progress,
};

use super::args::{CameraArgs, ReplaceArgs, RuntimeArgs, ThreadArgs, default_name, positive};
use crate::{
    evaluate::{
        ownership::{self, Planned},
        record::TOOL_VERSION,
    },
    maps::{self, Format, Request, Writer},
    model::{
        Description, Model,
        vet::{other_camera, vet},
    },
    notes::Notes,
    quantity::{Quantity, StereoCamera},
    runtime::placement_text,
};

/// File name of the record of a run.
const RECORD: &str = "predict.yaml";

/// Whose a folder of predictions is. They are named like the images, so the whole folder is.
const MARK: Mark = Mark {
    command: "bench predict",
    record: RECORD,
    begins: "tool: bench predict\n",
    writes: |_| true,
};

impl ValueEnum for Format {
    fn value_variants<'a>() -> &'a [Self] {
        &[Self::Exr, Self::Png16, Self::Color, Self::Npy, Self::Ply]
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        let help = match self {
            Self::Exr => "NAME.exr: depth in metres with unit, camera and model in the header",
            Self::Png16 => {
                "NAME.depth.png or NAME.disparity.png: value times --png-scale, 0 = none"
            }
            Self::Color => {
                "Inverse depth or disparity in colour (magma): NAME.color.png with its scale below, \
                 NAME.colormap.png of the image's own size"
            }
            Self::Npy => "NAME.npy: the numbers as f32, [height, width]",
            Self::Ply => "NAME.ply: a coloured point cloud in metres; needs --focal-px",
        };
        Some(PossibleValue::new(self.as_str()).help(help))
    }
}

impl ValueEnum for Quantity {
    fn value_variants<'a>() -> &'a [Self] {
        &Self::ALL
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        let (name, help) = match self {
            Self::DepthM => (
                "depth-m",
                "Depth along the camera's axis in metres, 0 = none",
            ),
            Self::DisparityPx => ("disparity-px", "Disparity in pixels of the map's own width"),
            Self::DisparityFraction => (
                "disparity-fraction",
                "Disparity as a fraction of image width",
            ),
            Self::InverseDepth => (
                "inverse-depth",
                "Inverse depth, in 1/m where the scale is known",
            ),
        };
        Some(PossibleValue::new(name).help(help))
    }
}

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bench predict photos -m model.onnx -o depth --focal-px 721.5 --baseline-m 0.54
      depth in metres and coloured pictures of a folder of images
  bench predict street.png -m model.onnx -o depth --format color,npy")]
pub(super) struct PredictArgs {
    /// Images (PNG or JPEG), or folders of them
    #[arg(value_name = "IMAGE_OR_DIR", required = true)]
    inputs: Vec<PathBuf>,
    /// ONNX file
    #[arg(short, long, value_name = "FILE.onnx")]
    model: PathBuf,
    /// Folder for the results; a folder given as input is mirrored below it
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
    /// What to write; several may be given, separated by commas [default: exr,color where depth in metres
    /// follows, else npy,color]
    #[arg(long, value_enum, value_delimiter = ',')]
    format: Vec<Format>,
    /// What values of png16 are multiplied with: 256 as KITTI does, 1000 for millimetres
    #[arg(long, value_name = "N", default_value_t = 256.0, value_parser = positive)]
    png_scale: f64,
    /// Largest depth of a point in ply
    #[arg(long, value_name = "M", default_value_t = 80.0, value_parser = positive)]
    cloud_to_m: f64,
    /// Leave images alone whose files are all there and newer than the image
    #[arg(long)]
    skip_existing: bool,
    /// List every file that was written
    #[arg(short, long)]
    verbose: bool,
    /// Print what was written as JSON
    #[arg(long)]
    json: bool,
    /// What png16 and npy hold [default: depth where it can be had, else disparity-px, or
    /// inverse-depth of unknown scale]
    #[arg(long, value_enum)]
    quantity: Option<Quantity>,
    #[command(flatten)]
    camera: CameraArgs,
    /// Depth of the brightest colour, the same in all pictures [default: each picture's own 95th
    /// percentile]
    #[arg(long, value_name = "M", value_parser = positive)]
    nearest_m: Option<f64>,
    /// Write maps of the network's own size instead of the images'
    #[arg(long)]
    network_size: bool,
    #[command(flatten)]
    threads: ThreadArgs,
    #[command(flatten)]
    runtime: RuntimeArgs,
    #[command(flatten)]
    replace: ReplaceArgs,
}

/// What makes the maps of two runs the same; with it a folder is marked before the first map.
#[derive(Serialize)]
struct Settings<'a> {
    tool: &'static str,
    tool_version: &'static str,
    blake3: &'a str,
    description: &'a Description,
    runtime: &'a str,
    provider: &'a str,
    device: String,
    camera: Option<StereoCamera>,
    nearest_m: Option<f64>,
    network_size: bool,
    png_scale: f64,
    focal_px: Option<f64>,
    formats: BTreeMap<&'static str, Quantity>,
}

/// What was written, for scripts.
#[derive(Serialize)]
struct Written<'a> {
    images: usize,
    failed: usize,
    out: &'a Path,
    files: &'a [PathBuf],
}

/// What ran; written beside the results.
#[derive(Serialize)]
struct Record<'a> {
    #[serde(flatten)]
    settings: Settings<'a>,
    model: &'a Path,
    arguments: Vec<String>,
    threads: usize,
    probe_max_difference: Option<f32>,
    images: usize,
    failed: usize,
}

pub(super) fn run(args: &PredictArgs, arguments: Vec<String>) -> anyhow::Result<u8> {
    let (jobs, skipped) = maps::jobs(&args.inputs, &args.out)?;
    let inputs = args.inputs.iter().chain([&args.model]);
    let inputs: Vec<&Path> = inputs.map(PathBuf::as_path).collect();
    MARK.examine(&args.out, &inputs)?;
    let pool = args.threads.pool()?;
    let threads = args.threads.within_model();
    let runtime = args.runtime.resolve()?;
    let name = default_name(&args.model);
    let mut model = Model::open(&name, &args.model, &runtime, args.runtime.device, threads)?;
    let camera = args.camera.stereo_camera();
    let seen = match camera {
        Some(camera) => maps::one_width(&jobs)?.map(|width| {
            let focal_fraction = camera.focal_px / f64::from(width);
            (focal_fraction, camera.baseline_m)
        }),
        None => None,
    };
    let request = Request {
        formats: args.format.clone(),
        quantity: args.quantity,
        camera,
        nearest_m: args.nearest_m,
        network_size: args.network_size,
        png_scale: args.png_scale,
        focal_px: args.camera.focal_px(),
        cloud_to_m: args.cloud_to_m,
    };
    let targets = maps::targets(&request, &model.description)?;
    maps::refuse_collisions(&jobs, &targets)?;
    // The model is run while the settings are kept.
    let (runtime, provider) = (model.runtime().to_owned(), model.provider().to_owned());
    let settings = Settings {
        tool: MARK.command,
        tool_version: TOOL_VERSION,
        blake3: &model.file.blake3.clone(),
        description: &model.description.clone(),
        runtime: &runtime,
        provider: &provider,
        device: args.runtime.device.to_string(),
        camera,
        nearest_m: args.nearest_m,
        network_size: args.network_size,
        png_scale: args.png_scale,
        focal_px: args.camera.focal_px(),
        formats: targets
            .iter()
            .map(|target| (target.format.as_str(), target.conversion.quantity))
            .collect(),
    };
    let (force, nothing) = (args.replace.force, Planned::default());
    let found = ownership::examine_record(&MARK, &args.out, &inputs, &settings, &nothing, force)?;
    let goes_on = found == Found::Begun && !force;
    if goes_on {
        MARK.go_on(&args.out)?;
    } else {
        let record = strat_store::yaml::to_string(&settings)?;
        MARK.begin_with(&args.out, record.as_bytes())?;
    }
    let mut notes = Notes::new(args.runtime.quiet);
    skipped.iter().for_each(|sentence| notes.note(sentence));
    let vetting = vet(&mut model, None)?;
    vetting
        .warnings
        .into_iter()
        .for_each(|warning| notes.warn(warning));
    if let Some(warning) = other_camera(&model, seen) {
        notes.warn(warning);
    }
    notes.say(&format!(
        "{} images, {}, device {}, {}",
        jobs.len(),
        model.runtime(),
        args.runtime.device,
        placement_text(model.placement()).unwrap_or_else(|| model.provider().to_owned())
    ));
    let meaning = model.description.output.meaning();
    if let Some(advice) = maps::advice(&model.description, camera) {
        notes.note(advice);
    }
    let writer = Writer {
        request: &request,
        targets: &targets,
        out: &args.out,
        in_metres: maps::has_scale(meaning, camera),
        source: format!(
            "model {name}, BLAKE3 {}",
            files::digest_prefix(&model.file.blake3)
        ),
    };
    let (done, left) = if goes_on {
        writer.split(Some(&args.out.join(MARK.begun())), &jobs)
    } else if args.skip_existing {
        writer.split(None, &jobs)
    } else {
        (Vec::new(), jobs.clone())
    };
    if !done.is_empty() {
        notes.note(&format!(
            "{} of {} images were done before{}",
            jobs.len() - left.len(),
            jobs.len(),
            if goes_on {
                " the last run was interrupted; continuing"
            } else {
                " and are left alone"
            }
        ));
    }
    let progress = Progress::new("predict", left.len() as u64, "images", args.runtime.quiet);
    let outcome = maps::predict(&left, &mut model, &pool, &writer, &progress);
    progress.finish();
    if outcome.interrupted {
        return Err(strat_store::Error::Interrupted.into());
    }
    let record = Record {
        settings,
        model: &args.model,
        arguments,
        threads,
        probe_max_difference: vetting.probe.map(|result| result.max_difference),
        images: jobs.len(),
        failed: outcome.failed,
    };
    let text = strat_store::yaml::to_string(&record)?;
    MARK.finish(&args.out, text.as_bytes())?;
    let mut files: Vec<PathBuf> = done.iter().chain(&outcome.written).cloned().collect();
    // The camera of maps of the network's size is another.
    if let Some(focal_px) = args.camera.focal_px().filter(|_| !args.network_size) {
        files.extend(maps::write_camera_info(&args.out, &jobs, focal_px)?);
    }
    let images = jobs.len() - outcome.failed;
    print(if args.json {
        let written = Written {
            images,
            failed: outcome.failed,
            out: &args.out,
            files: &files,
        };
        serde_json::to_string_pretty(&written).context("the list cannot be written as JSON")? + "\n"
    } else if args.verbose {
        files
            .iter()
            .map(|path| format!("{}\n", path.display()))
            .collect()
    } else {
        let kinds = targets.iter().flat_map(|target| target.suffixes());
        let kinds: Vec<String> = kinds.map(|suffix| format!("*{suffix}")).collect();
        format!(
            "{} in {}: {}\n",
            human::count(images, "image", "images"),
            args.out.display(),
            kinds.join(", ")
        )
    })?;
    if outcome.too_large > 0 {
        // Not silenced: what is missing cannot be seen in the files.
        Notes::new(false).note(&format!(
            "{} above {:.2} do not fit into 16 bits and are written as 0 (none)",
            human::count(outcome.too_large, "value", "values"),
            f64::from(u16::MAX) / args.png_scale
        ));
    }
    if outcome.failed == 0 {
        return Ok(DONE);
    }
    notes.fail(format!(
        "{} of {} images have no result",
        outcome.failed,
        jobs.len()
    ));
    Ok(FAILED)
}
