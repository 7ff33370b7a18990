//! `bench predict`: depth, disparity and pictures for a user's own images.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use clap::{Args, ValueEnum, builder::PossibleValue};
use serde::Serialize;
use strat_store::{
    claim::{Found, Mark},
    command::{DONE, FAILED, print},
    files,
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
    quantity::{Quantity, StereoCamera, default_quantity},
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
    formats: BTreeMap<&'static str, Quantity>,
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
    let jobs = maps::jobs(&args.inputs, &args.out)?;
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
    let (done, left) = if goes_on {
        writer.split(&args.out.join(MARK.begun()), &jobs)
    } else {
        (Vec::new(), jobs.clone())
    };
    if !done.is_empty() {
        notes.note(&format!(
            "{} of {} images were done before the last run was interrupted; going on",
            jobs.len() - left.len(),
            jobs.len()
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
    let lines: String = done
        .iter()
        .chain(&outcome.written)
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
