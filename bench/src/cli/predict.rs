//! `bench predict`: depth, disparity and pictures for a user's own images.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use clap::{Args, ValueEnum, builder::PossibleValue};
use serde::Serialize;
use strat_store::{
    command::{DONE, FAILED, print},
    files,
    progress::Progress,
};

use super::args::{CameraArgs, RuntimeArgs, ThreadArgs, default_name, positive};
use crate::{
    evaluate::record::TOOL_VERSION,
    maps::{self, Format, Request, Writer},
    model::{
        Description, Model,
        vet::{other_camera, vet},
    },
    notes::Notes,
    quantity::{Quantity, StereoCamera, default_quantity},
    runtime::placement_text,
};

/// File name of the record of a run.
const RECORD: &str = "predict.yaml";

impl ValueEnum for Format {
    fn value_variants<'a>() -> &'a [Self] {
        &[Self::Exr, Self::Png16, Self::Color, Self::Npy]
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        let help = match self {
            Self::Exr => "NAME.exr: depth in metres with unit, camera and model in the header",
            Self::Png16 => "NAME.depth.png or NAME.disparity.png: value times 256, 0 = none",
            Self::Color => {
                "NAME.color.png: inverse depth or disparity in colour (magma), its scale below"
            }
            Self::Npy => "NAME.npy: the numbers as f32, [height, width]",
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
pub(super) struct PredictArgs {
    /// Images (PNG or JPEG), or folders of them
    #[arg(value_name = "IMAGE_OR_DIR", required = true)]
    inputs: Vec<PathBuf>,
    /// ONNX file
    #[arg(long, value_name = "FILE.onnx")]
    model: PathBuf,
    /// Folder for the results; a folder given as input is mirrored below it
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// What to write; several may be given, separated by commas
    #[arg(long, value_enum, value_delimiter = ',', default_value = "exr")]
    format: Vec<Format>,
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
}

/// What ran; written beside the results.
#[derive(Serialize)]
struct Record<'a> {
    tool: &'static str,
    tool_version: &'static str,
    arguments: Vec<String>,
    model: &'a Path,
    blake3: &'a str,
    description: &'a Description,
    runtime: &'a str,
    provider: &'a str,
    device: String,
    threads: usize,
    camera: Option<StereoCamera>,
    formats: BTreeMap<&'static str, Quantity>,
    probe_max_difference: Option<f32>,
    images: usize,
    failed: usize,
}

pub(super) fn run(args: &PredictArgs, arguments: Vec<String>) -> anyhow::Result<u8> {
    let jobs = maps::jobs(&args.inputs, &args.out)?;
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
    };
    let targets = maps::targets(&request, &model.description)?;
    maps::refuse_collisions(&jobs, &targets)?;
    files::check_writable(&args.out)?;
    let mut notes = Notes::new(args.runtime.quiet);
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
    if default_quantity(meaning, camera) == Quantity::DisparityPx {
        notes.note("without --focal-px and --baseline-m there is no depth, only disparity");
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
    let progress = Progress::new("predict", jobs.len() as u64, "images", args.runtime.quiet);
    let outcome = maps::predict(&jobs, &mut model, &pool, &writer, &progress);
    progress.finish();
    let record = Record {
        tool: "bench predict",
        tool_version: TOOL_VERSION,
        arguments,
        model: &args.model,
        blake3: &model.file.blake3,
        description: &model.description,
        runtime: model.runtime(),
        provider: model.provider(),
        device: args.runtime.device.to_string(),
        threads,
        camera,
        formats: targets
            .iter()
            .map(|target| (target.format.as_str(), target.conversion.quantity))
            .collect(),
        probe_max_difference: vetting.probe.map(|result| result.max_difference),
        images: jobs.len(),
        failed: outcome.failed,
    };
    let text = strat_store::yaml::to_string(&record)?;
    files::write_atomic(&args.out.join(RECORD), text.as_bytes())?;
    let lines: String = outcome
        .written
        .iter()
        .map(|path| format!("{}\n", path.display()))
        .collect();
    print(lines)?;
    if outcome.too_large > 0 {
        // Not silenced: what is missing cannot be seen in the files.
        Notes::new(false).note(&format!(
            "{} value(s) above 255.99 do not fit into 16 bits and are written as 0 (none)",
            outcome.too_large
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
