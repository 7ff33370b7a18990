//! `bench predict`: depth, disparity and pictures for a user's own images.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use anyhow::Context as _;
use clap::{Args, ValueEnum};
use rayon::prelude::*;
use serde::Serialize;
use strat_onnx::metadata::OutputMeaning;
use strat_store::{
    command::{CliError, DONE, FAILED, error_chain, print},
    exr::{self, DepthHeader},
    files, image_files,
    progress::Progress,
    raster::Plane,
    resize,
};

use super::{
    args::{RuntimeArgs, ThreadArgs, default_name},
    latency::rig,
};
use crate::{
    evaluate::record::TOOL_VERSION,
    model::{self, Description, Model, vet::vet},
    quantity::{self, Conversion, Quantity, Rig, Scale, ScaleUnit, natural},
    runtime::placement_text,
};

/// After this many failures without a single success the rest is not tried.
const HOPELESS_AFTER: usize = 10;

/// File name of the record of a run.
const RECORD: &str = "predict.yaml";

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Format {
    /// NAME.exr: depth in metres with unit, camera and model in the header
    Exr,
    /// NAME.depth.png or NAME.disparity.png: value times 256, 0 = none
    Png16,
    /// NAME.color.png: inverse depth or disparity in colour (magma), its scale below
    Color,
    /// NAME.npy: the numbers as f32, [height, width]
    Npy,
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
    /// Focal length in pixels of the images' own width; depth from disparity needs it
    #[arg(long, value_name = "PX", requires = "baseline_m", value_parser = positive)]
    focal_px: Option<f64>,
    /// Stereo baseline in metres that the model was trained with (KITTI: 0.54)
    #[arg(long, value_name = "M", requires = "focal_px", value_parser = positive)]
    baseline_m: Option<f64>,
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

/// A number above 0.
pub(super) fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() && value > 0.0 => Ok(value),
        _ => Err("a number above 0 is needed".to_owned()),
    }
}

/// An image and the place of its results.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Job {
    image: PathBuf,
    /// Relative to the output folder, with the image's own extension.
    name: PathBuf,
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
    camera: Option<Rig>,
    formats: BTreeMap<&'static str, Quantity>,
    probe_max_difference: Option<f32>,
    images: usize,
    failed: usize,
}

/// One format with the conversion into what it holds.
#[derive(Clone, Copy)]
struct Target {
    format: Format,
    conversion: Conversion,
}

impl Target {
    /// Behind the image's name without its extension.
    fn suffix(self) -> &'static str {
        match (self.format, self.conversion.quantity) {
            (Format::Exr, _) => ".exr",
            (Format::Npy, _) => ".npy",
            (Format::Color, _) => ".color.png",
            (Format::Png16, Quantity::DepthM) => ".depth.png",
            (Format::Png16, _) => ".disparity.png",
        }
    }
}

pub(super) fn run(args: &PredictArgs, arguments: Vec<String>) -> anyhow::Result<u8> {
    let jobs = jobs(&args.inputs, &args.out)?;
    let pool = args.threads.pool()?;
    let threads = args.threads.within_model(&pool);
    let runtime = args.runtime.resolve()?;
    let name = default_name(&args.model);
    let mut model = Model::open(&name, &args.model, &runtime, args.runtime.device, threads)?;
    let rig = rig(args.focal_px, args.baseline_m);
    let targets = targets(args, &model.description, rig)?;
    refuse_collisions(&jobs, &targets)?;
    files::check_writable(&args.out)?;
    let vetting = vet(&mut model, None)?;
    for warning in &vetting.warnings {
        eprintln!("warning: {warning}");
    }
    if !args.runtime.quiet {
        eprintln!(
            "{} images, {}, device {}, {}",
            jobs.len(),
            model.runtime(),
            args.runtime.device,
            placement_text(model.placement()).unwrap_or_else(|| model.provider().to_owned())
        );
        if rig.is_none()
            && natural(model.description.output.meaning(), rig) == Quantity::DisparityPx
        {
            eprintln!(
                "note: without --focal-px and --baseline-m there is no depth, only disparity"
            );
        }
    }
    let writer = Writer {
        args,
        targets: &targets,
        rig,
        in_metres: has_scale(model.description.output.meaning(), rig),
        source: format!(
            "model {name}, BLAKE3 {}",
            files::digest_prefix(&model.file.blake3)
        ),
    };
    let outcome = predict_all(args, &jobs, &mut model, &pool, &writer);
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
        camera: rig,
        formats: targets
            .iter()
            .map(|target| {
                let name = match target.format {
                    Format::Exr => "exr",
                    Format::Png16 => "png16",
                    Format::Color => "color",
                    Format::Npy => "npy",
                };
                (name, target.conversion.quantity)
            })
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
        eprintln!(
            "note: {} value(s) above 255.99 do not fit into 16 bits and are written as 0 (none)",
            outcome.too_large
        );
    }
    if outcome.failed == 0 {
        return Ok(DONE);
    }
    eprintln!(
        "error: {} of {} images have no result",
        outcome.failed,
        jobs.len()
    );
    Ok(FAILED)
}

/// What each format holds; a format that cannot hold it is a contradiction of the arguments.
fn targets(
    args: &PredictArgs,
    description: &Description,
    rig: Option<Rig>,
) -> anyhow::Result<Vec<Target>> {
    let meaning = description.output.meaning();
    let mut targets: Vec<Target> = Vec::new();
    for &format in &args.format {
        if targets.iter().any(|target| target.format == format) {
            continue;
        }
        let natural = natural(meaning, rig);
        let asked = args.quantity.unwrap_or(natural);
        let quantity = match format {
            Format::Exr => Quantity::DepthM,
            Format::Color if natural == Quantity::DepthM => Quantity::InverseDepth,
            Format::Color => natural,
            Format::Npy | Format::Png16 => asked,
        };
        let fits = match format {
            Format::Exr => matches!(args.quantity, None | Some(Quantity::DepthM)),
            Format::Png16 => matches!(quantity, Quantity::DepthM | Quantity::DisparityPx),
            Format::Color | Format::Npy => true,
        };
        if !fits {
            return Err(CliError::Usage(match format {
                Format::Exr => "`--format exr` holds depth in metres only; use npy for other \
                                quantities"
                    .to_owned(),
                _ => format!(
                    "`--format png16` holds depth-m or disparity-px times 256, not {quantity}; use \
                     npy or color"
                ),
            })
            .into());
        }
        let conversion = Conversion::new(quantity, meaning, description.input.width, rig)
            .map_err(CliError::usage)?;
        targets.push(Target { format, conversion });
    }
    if args.nearest_m.is_some() && !has_scale(meaning, rig) {
        return Err(CliError::Usage(
            "`--nearest-m` needs depth in metres, which this model does not give without \
             --focal-px and --baseline-m"
                .to_owned(),
        )
        .into());
    }
    Ok(targets)
}

/// Whether depth in metres follows from what the model gives.
fn has_scale(meaning: OutputMeaning, rig: Option<Rig>) -> bool {
    natural(meaning, rig) == Quantity::DepthM
}

/// All images with the places of their results, in the order of the arguments.
fn jobs(inputs: &[PathBuf], out: &Path) -> anyhow::Result<Vec<Job>> {
    let mut jobs = Vec::new();
    for input in inputs {
        if !input.is_dir() {
            // A file that is not there is a bad image like any other.
            let name = input.file_name().ok_or_else(|| {
                CliError::Usage(format!(
                    "{} is neither an image nor a folder",
                    input.display()
                ))
            })?;
            jobs.push(Job {
                image: input.clone(),
                name: PathBuf::from(name),
            });
            continue;
        }
        // Otherwise a second run would take the results for images.
        let inside = std::path::absolute(out)
            .and_then(|out| Ok(out.starts_with(std::path::absolute(input)?)))
            .unwrap_or(false);
        if inside {
            return Err(CliError::Usage(format!(
                "the results' folder {} lies in {}, where images are looked for; choose another",
                out.display(),
                input.display()
            ))
            .into());
        }
        let images = images_below(input)?;
        if images.is_empty() {
            return Err(anyhow::anyhow!(
                "there are no PNG or JPEG images in {}",
                input.display()
            ));
        }
        for image in images {
            let name = image.strip_prefix(input).unwrap_or(&image).to_path_buf();
            jobs.push(Job { image, name });
        }
    }
    Ok(jobs)
}

/// PNG and JPEG files in a folder and those below it, sorted. Hidden files and linked folders are
/// left out.
pub(super) fn images_below(folder: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    let mut folders = vec![folder.to_path_buf()];
    while let Some(folder) = folders.pop() {
        let reading = || format!("cannot read the folder {}", folder.display());
        for entry in std::fs::read_dir(&folder).with_context(reading)? {
            let entry = entry.with_context(reading)?;
            let path = entry.path();
            if entry.file_name().to_string_lossy().starts_with('.') {
                continue;
            }
            if entry.file_type().with_context(reading)?.is_dir() {
                folders.push(path);
            } else if path.is_file() && has_image_name(&path) {
                found.push(path);
            }
        }
    }
    found.sort();
    Ok(found)
}

fn has_image_name(path: &Path) -> bool {
    path.extension().is_some_and(|extension| {
        ["png", "jpg", "jpeg"]
            .iter()
            .any(|known| extension.eq_ignore_ascii_case(known))
    })
}

/// Two images must not share a result, nor differ from another's only by what some file systems
/// do not tell apart.
fn refuse_collisions(jobs: &[Job], targets: &[Target]) -> Result<(), CliError> {
    let mut taken: BTreeMap<String, &Job> = BTreeMap::new();
    for job in jobs {
        for target in targets {
            let name = output_name(&job.name, target.suffix());
            let key = name.to_string_lossy().to_lowercase();
            if let Some(other) = taken.insert(key, job) {
                return Err(CliError::Usage(format!(
                    "{} and {} would both be written to {}; rename one, or use two output folders",
                    other.image.display(),
                    job.image.display(),
                    name.display()
                )));
            }
        }
    }
    Ok(())
}

fn output_name(name: &Path, suffix: &str) -> PathBuf {
    let mut stem = name.file_stem().unwrap_or_default().to_os_string();
    stem.push(suffix);
    name.with_file_name(stem)
}

#[derive(Default)]
struct Outcome {
    written: Vec<PathBuf>,
    failed: usize,
    too_large: usize,
}

/// An image that is ready for the model.
struct Prepared {
    tensor: Vec<f32>,
    size: (u32, u32),
}

/// Decodes and writes on the pool, a few images at a time; the model runs here between.
fn predict_all(
    args: &PredictArgs,
    jobs: &[Job],
    model: &mut Model,
    pool: &rayon::ThreadPool,
    writer: &Writer<'_>,
) -> Outcome {
    let progress = Progress::new("predict", jobs.len() as u64, "images", args.runtime.quiet);
    let mut outcome = Outcome::default();
    let input = model.description.input.clone();
    let mut tried = 0;
    for chunk in jobs.chunks(2 * pool.current_num_threads()) {
        let prepared: Vec<anyhow::Result<Prepared>> = pool.install(|| {
            chunk
                .par_iter()
                .map(|job| {
                    let image = image_files::read_rgb(&job.image)?;
                    Ok(Prepared {
                        tensor: model::prepare_input(&image, &input),
                        size: image.dimensions(),
                    })
                })
                .collect()
        });
        let predicted: Vec<anyhow::Result<(Plane, (u32, u32))>> = prepared
            .into_iter()
            .map(|prepared| {
                let Prepared { tensor, size } = prepared?;
                Ok((model.predict(&tensor)?, size))
            })
            .collect();
        let results: Vec<anyhow::Result<(Vec<PathBuf>, usize)>> = pool.install(|| {
            chunk
                .par_iter()
                .zip(predicted)
                .map(|(job, predicted)| {
                    let (plane, size) = predicted?;
                    writer.write(job, &plane, size)
                })
                .collect()
        });
        for (job, result) in chunk.iter().zip(results) {
            match result {
                Ok((paths, too_large)) => {
                    outcome.written.extend(paths);
                    outcome.too_large += too_large;
                }
                Err(error) => {
                    outcome.failed += 1;
                    let image = job.image.display().to_string();
                    let reason = error_chain(error.as_ref());
                    // Most reasons name the file themselves.
                    progress.println(&if reason.contains(&image) {
                        format!("error: {reason}")
                    } else {
                        format!("error: {image}: {reason}")
                    });
                }
            }
        }
        tried += chunk.len();
        progress.add(chunk.len() as u64);
        if outcome.failed >= HOPELESS_AFTER && outcome.written.is_empty() && tried < jobs.len() {
            progress.println(&format!(
                "error: the first {tried} images all failed, the rest was not tried"
            ));
            outcome.failed += jobs.len() - tried;
            break;
        }
    }
    progress.finish();
    outcome
}

/// Turns predictions into files.
struct Writer<'a> {
    args: &'a PredictArgs,
    targets: &'a [Target],
    rig: Option<Rig>,
    /// Depth has a scale.
    in_metres: bool,
    /// Who predicted, for headers.
    source: String,
}

impl Writer<'_> {
    /// Writes all formats of one image, or none. Returns the files, and how many values did not
    /// fit into 16 bits.
    fn write(
        &self,
        job: &Job,
        plane: &Plane,
        size: (u32, u32),
    ) -> anyhow::Result<(Vec<PathBuf>, usize)> {
        let resized = if self.args.network_size {
            plane.clone()
        } else {
            resize::bilinear_f32(plane, size.0 as usize, size.1 as usize)
        };
        let mut too_large = 0;
        // Everything is encoded before the first file appears.
        let encoded: Vec<(PathBuf, Vec<u8>)> = self
            .targets
            .iter()
            .map(|target| {
                let map = target.conversion.apply(resized.clone(), size.0);
                let bytes = match target.format {
                    Format::Exr => exr::encode_depth(&map, &self.header(job, &map, size.0))?,
                    Format::Npy => quantity::encode_npy(&map),
                    Format::Png16 => {
                        let (bytes, clipped) = quantity::encode_png16(&map);
                        too_large += clipped;
                        bytes
                    }
                    Format::Color => {
                        let scale = self.scale(&map, target.conversion.quantity);
                        image_files::encode_png_rgb(&quantity::colour(&map, scale))
                    }
                };
                let name = output_name(&job.name, target.suffix());
                Ok((self.args.out.join(name), bytes))
            })
            .collect::<anyhow::Result<_>>()?;
        for (path, bytes) in &encoded {
            files::write_atomic(path, bytes)?;
        }
        Ok((
            encoded.into_iter().map(|(path, _)| path).collect(),
            too_large,
        ))
    }

    /// Names the camera of the map, which is not the image's where the sizes differ; 0 is not known.
    fn header(&self, job: &Job, map: &Plane, image_width: u32) -> DepthHeader {
        DepthHeader {
            source: self.source.clone(),
            axis: "camera-z".to_owned(),
            focal_px: self.rig.map_or(0.0, |rig| {
                rig.focal_px * map.width as f64 / f64::from(image_width)
            }),
            baseline_m: self.rig.map_or(0.0, |rig| rig.baseline_m),
            frame: job.name.display().to_string(),
        }
    }

    fn scale(&self, map: &Plane, quantity: Quantity) -> Scale {
        Scale {
            unit: match quantity {
                Quantity::InverseDepth if self.in_metres => Some(ScaleUnit::Metres),
                Quantity::DisparityPx => Some(ScaleUnit::Pixels),
                _ => None,
            },
            brightest: self.args.nearest_m.map_or_else(
                || quantity::brightest_of(map),
                |nearest| (1.0 / nearest) as f32,
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn job(name: &str) -> Job {
        Job {
            image: PathBuf::from("in").join(name),
            name: PathBuf::from(name),
        }
    }

    #[test]
    fn names_mirror_and_collisions_are_named() {
        assert_eq!(
            output_name(Path::new("a/b.c.png"), ".exr"),
            Path::new("a/b.c.exr")
        );
        let conversion = Conversion::new(Quantity::DepthM, OutputMeaning::DepthM, 8, None).unwrap();
        let targets = [Format::Exr, Format::Png16].map(|format| Target { format, conversion });
        assert!(refuse_collisions(&[job("a.png"), job("b/a.png")], &targets).is_ok());
        for other in ["a.jpg", "A.png"] {
            let error = refuse_collisions(&[job("a.png"), job(other)], &targets).unwrap_err();
            assert!(error.to_string().contains("both be written"), "{error}");
        }
    }

    #[test]
    fn only_images_are_found() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["b.PNG", "a/c.jpeg", "a/x.txt", ".hidden.png", "a.jpg"] {
            let path = folder.path().join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, b"").unwrap();
        }
        let found: Vec<String> = images_below(folder.path())
            .unwrap()
            .iter()
            .map(|path| {
                path.strip_prefix(folder.path())
                    .unwrap()
                    .display()
                    .to_string()
            })
            .collect();
        assert_eq!(found, ["a/c.jpeg", "a.jpg", "b.PNG"]);
        assert!(images_below(&folder.path().join("none")).is_err());
    }

    #[test]
    fn the_results_must_not_lie_among_the_images() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("a.png"), b"").unwrap();
        let inputs = [folder.path().to_path_buf()];
        assert!(jobs(&inputs, &folder.path().join("out")).is_err());
        let elsewhere = tempfile::tempdir().unwrap();
        let jobs = jobs(&inputs, elsewhere.path()).unwrap();
        assert_eq!(jobs[0].name, Path::new("a.png"));
    }

    #[test]
    fn numbers_must_be_positive() {
        assert_eq!(positive("0.54"), Ok(0.54));
        for wrong in ["0", "-1", "inf", "NaN", "x"] {
            assert!(positive(wrong).is_err());
        }
    }
}
