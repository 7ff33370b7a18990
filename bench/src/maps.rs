//! Maps of a user's own images: which images, which formats, and the files (`bench predict`).
//!
//! Images go through the pipeline of the evaluation; a broken one costs itself only. Not here: what a
//! quantity is ([`crate::quantity`]) and how maps are coloured ([`crate::draw::legend`]).

use std::{
    collections::BTreeMap,
    ops::ControlFlow,
    path::{Path, PathBuf},
};

use strat_onnx::metadata::OutputMeaning;
use strat_store::{
    command::{CliError, error_chain},
    exr::{self, DepthHeader},
    files, image_files, npy,
    progress::Progress,
    raster::Plane,
    resize,
    signals::Watch,
};

use crate::{
    draw::{
        colour::brightest_of,
        legend::{Scale, ScaleUnit, coloured},
    },
    evaluate::pipeline::{self, MAX_INITIAL_FAILURES},
    images,
    model::{self, Description, Model, ModelError, ModelInput},
    quantity::{self, Conversion, Quantity, StereoCamera, default_quantity},
};

/// Why one image has no map.
#[derive(Debug, thiserror::Error)]
pub enum MapError {
    /// A file could not be read or written.
    #[error(transparent)]
    Store(#[from] strat_store::Error),
    /// The model failed.
    #[error(transparent)]
    Model(#[from] ModelError),
}

/// What is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// `NAME.exr`: depth in metres.
    Exr,
    /// `NAME.depth.png` or `NAME.disparity.png`: value times 256.
    Png16,
    /// `NAME.color.png`: inverse depth or disparity in colour.
    Color,
    /// `NAME.npy`: the numbers.
    Npy,
}

impl Format {
    /// The word on the command line and in records.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Exr => "exr",
            Self::Png16 => "png16",
            Self::Color => "color",
            Self::Npy => "npy",
        }
    }
}

/// What maps are to be.
#[derive(Clone, Debug)]
pub struct Request {
    /// What to write.
    pub formats: Vec<Format>,
    /// What png16 and npy hold; depth where it follows.
    pub quantity: Option<Quantity>,
    /// The camera of the images, where it is known.
    pub camera: Option<StereoCamera>,
    /// Depth of the brightest colour in metres; each picture's own where it is not given.
    pub nearest_m: Option<f64>,
    /// Maps of the network's own size instead of the images'.
    pub network_size: bool,
}

/// An image and where its results go.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ImageJob {
    /// The image.
    pub image: PathBuf,
    /// Relative to the output folder, with the image's own extension.
    pub name: PathBuf,
}

/// The one width of all images; none where no image can be read.
///
/// # Errors
/// Images of several widths: one focal length in pixels is not that of all of them.
pub fn one_width(jobs: &[ImageJob]) -> Result<Option<u32>, CliError> {
    let mut first: Option<(&Path, u32)> = None;
    for job in jobs {
        // What cannot be read costs itself only, later.
        let Ok((width, _)) = image::image_dimensions(&job.image) else {
            continue;
        };
        match first {
            None => first = Some((&job.image, width)),
            Some((_, known)) if known == width => {}
            Some((other, known)) => {
                return Err(CliError::Usage(format!(
                    "{} is {known} pixels wide and {} {width}, so one `--focal-px` is not that of \
                     both; predict images of one width at a time, each with its own focal length",
                    other.display(),
                    job.image.display()
                )));
            }
        }
    }
    Ok(first.map(|(_, width)| width))
}

/// One format with the conversion into what it holds.
#[derive(Clone, Copy, Debug)]
pub struct Target {
    /// The format.
    pub format: Format,
    /// What it holds.
    pub conversion: Conversion,
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

/// What each format holds; a format that cannot hold it is a contradiction of the arguments.
///
/// # Errors
/// A format cannot hold the quantity, or the quantity does not follow from what is known.
pub fn targets(request: &Request, description: &Description) -> Result<Vec<Target>, CliError> {
    let camera = request.camera;
    let meaning = description.output.meaning();
    if description.output.canonical_focal_px.is_some() && camera.is_none() {
        return Err(CliError::Usage(
            "the model gives depth for a camera of its own (`canonical_focal_px`); give --focal-px and \
             --baseline-m of the images"
                .to_owned(),
        ));
    }
    let mut targets: Vec<Target> = Vec::new();
    for &format in &request.formats {
        if targets.iter().any(|target| target.format == format) {
            continue;
        }
        let default = default_quantity(meaning, camera);
        let wanted = request.quantity.unwrap_or(default);
        let quantity = match format {
            Format::Exr => Quantity::DepthM,
            Format::Color if default == Quantity::DepthM => Quantity::InverseDepth,
            Format::Color => default,
            Format::Npy | Format::Png16 => wanted,
        };
        let fits = match format {
            Format::Exr => matches!(request.quantity, None | Some(Quantity::DepthM)),
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
            }));
        }
        let conversion = Conversion::new(
            quantity,
            meaning,
            description.input.disparity_width(),
            camera,
        )
        .map_err(CliError::usage)?;
        targets.push(Target { format, conversion });
    }
    if request.nearest_m.is_some() && !has_scale(meaning, camera) {
        return Err(CliError::Usage(
            "`--nearest-m` needs depth in metres, which this model does not give without \
             --focal-px and --baseline-m"
                .to_owned(),
        ));
    }
    Ok(targets)
}

/// Whether depth in metres follows from what the model gives.
#[must_use]
pub fn has_scale(meaning: OutputMeaning, camera: Option<StereoCamera>) -> bool {
    default_quantity(meaning, camera) == Quantity::DepthM
}

/// All images with the names of their results, in the order of the arguments.
///
/// # Errors
/// A folder has no images, or the results would lie among them.
pub fn jobs(inputs: &[PathBuf], out: &Path) -> Result<Vec<ImageJob>, CliError> {
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
            jobs.push(ImageJob {
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
                "the output folder {} is inside the input folder {}; choose another",
                out.display(),
                input.display()
            )));
        }
        let found = images::below(input)?;
        if found.is_empty() {
            return Err(CliError::Failed(format!(
                "there are no PNG or JPEG images in {}",
                input.display()
            )));
        }
        for image in found {
            let name = image.strip_prefix(input).unwrap_or(&image).to_path_buf();
            jobs.push(ImageJob { image, name });
        }
    }
    Ok(jobs)
}

/// Two images must not share a result, nor differ from another's only by what some file systems
/// do not tell apart.
///
/// # Errors
/// Two would.
pub fn refuse_collisions(jobs: &[ImageJob], targets: &[Target]) -> Result<(), CliError> {
    let mut taken: BTreeMap<String, &ImageJob> = BTreeMap::new();
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

/// What came out.
#[derive(Debug, Default)]
pub struct Outcome {
    /// The files, in the order of the images.
    pub written: Vec<PathBuf>,
    /// Images without a result.
    pub failed: usize,
    /// Values that did not fit into 16 bits.
    pub too_large: usize,
    /// A signal ended the work.
    pub interrupted: bool,
}

/// Predicts and writes all images. Failures are named on stderr.
pub fn predict(
    jobs: &[ImageJob],
    model: &mut Model,
    pool: &rayon::ThreadPool,
    writer: &Writer<'_>,
    progress: &Progress,
) -> Outcome {
    let mut outcome = Outcome::default();
    let watch = Watch::new("stopping after this image");
    let input = model.description.input.clone();
    let mut tried = 0;
    let ended = pipeline::run(
        jobs,
        pipeline::chunk_size(pool),
        pool,
        |job| {
            let image = image_files::read_rgb(&job.image)?;
            let focal_px = writer.request.camera.map(|camera| camera.focal_px);
            Ok::<_, MapError>(model::prepare_input(&image, &input, focal_px)?)
        },
        |_, prepared| {
            if model.has_ended() {
                return ControlFlow::Break(());
            }
            let predict = |input: ModelInput| Ok((model.predict(&input)?, input.image));
            ControlFlow::Continue(prepared.and_then(predict))
        },
        |job, predicted: Result<(Plane, (u32, u32)), MapError>| {
            let (plane, size) = predicted?;
            writer.write(job, &plane, size)
        },
        |job, result| {
            tried += 1;
            progress.add(1);
            match result {
                Ok((paths, too_large)) => {
                    outcome.written.extend(paths);
                    outcome.too_large += too_large;
                }
                Err(error) => {
                    outcome.failed += 1;
                    let image = job.image.display().to_string();
                    let reason = error_chain(&error);
                    // Most reasons name the file themselves.
                    progress.println(&if reason.contains(&image) {
                        format!("error: {reason}")
                    } else {
                        format!("error: {image}: {reason}")
                    });
                }
            }
            if watch.told() {
                outcome.interrupted = true;
                return ControlFlow::Break(());
            }
            if outcome.failed >= MAX_INITIAL_FAILURES && outcome.written.is_empty() {
                return ControlFlow::Break(());
            }
            ControlFlow::Continue(())
        },
    );
    if ended.is_break() && tried < jobs.len() && !outcome.interrupted {
        progress.println(&match outcome.written.is_empty() {
            true => format!("error: the first {tried} images all failed, the rest was not tried"),
            false => format!(
                "error: the process of the model is over, {} images were not tried",
                jobs.len() - tried
            ),
        });
        outcome.failed += jobs.len() - tried;
    }
    outcome
}

/// Turns predictions into files.
pub struct Writer<'a> {
    /// What maps are to be.
    pub request: &'a Request,
    /// What each format holds.
    pub targets: &'a [Target],
    /// Folder for the results.
    pub out: &'a Path,
    /// Depth has a scale.
    pub in_metres: bool,
    /// Who predicted, for headers.
    pub source: String,
}

impl Writer<'_> {
    /// What the run that `begun` marks the beginning of has written, and the images that it has not:
    /// those without all of their files, or changed since.
    #[must_use]
    pub fn split(&self, begun: &Path, jobs: &[ImageJob]) -> (Vec<PathBuf>, Vec<ImageJob>) {
        let changed = |path: &Path| path.metadata().and_then(|found| found.modified()).ok();
        let (mut done, mut left) = (Vec::new(), Vec::new());
        for job in jobs {
            let newest = changed(&job.image).max(changed(begun));
            let paths = self.targets.iter();
            let paths = paths.map(|target| self.out.join(output_name(&job.name, target.suffix())));
            let paths: Vec<PathBuf> = paths.collect();
            if paths.iter().all(|path| changed(path) > newest) {
                done.extend(paths);
            } else {
                left.push(job.clone());
            }
        }
        (done, left)
    }

    /// Writes all formats of one image, or none. Returns the files, and how many values did not
    /// fit into 16 bits.
    fn write(
        &self,
        job: &ImageJob,
        plane: &Plane,
        size: (u32, u32),
    ) -> Result<(Vec<PathBuf>, usize), MapError> {
        let resized = if self.request.network_size {
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
                    Format::Npy => npy::encode(map.width, map.height, &map.data),
                    Format::Png16 => {
                        let (bytes, clipped) = quantity::encode_png16(&map);
                        too_large += clipped;
                        bytes
                    }
                    Format::Color => {
                        let scale = self.scale(&map, target.conversion.quantity);
                        image_files::encode_png_rgb(&coloured(&map, scale))
                    }
                };
                let name = output_name(&job.name, target.suffix());
                Ok((self.out.join(name), bytes))
            })
            .collect::<Result<_, MapError>>()?;
        for (path, bytes) in &encoded {
            files::write_atomic(path, bytes)?;
        }
        Ok((
            encoded.into_iter().map(|(path, _)| path).collect(),
            too_large,
        ))
    }

    /// Names the camera of the map, which is not the image's where the sizes differ; 0 is not known.
    fn header(&self, job: &ImageJob, map: &Plane, image_width: u32) -> DepthHeader {
        DepthHeader {
            source: self.source.clone(),
            axis: "camera-z".to_owned(),
            focal_px: self.request.camera.map_or(0.0, |camera| {
                camera.focal_px * map.width as f64 / f64::from(image_width)
            }),
            baseline_m: self.request.camera.map_or(0.0, |camera| camera.baseline_m),
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
            brightest: self
                .request
                .nearest_m
                .map_or_else(|| brightest_of(map), |nearest| (1.0 / nearest) as f32),
        }
    }
}

#[cfg(test)]
mod tests {
    use strat_onnx::metadata::InputRange;

    use super::*;
    use crate::model::{InputDescription, OutputDescription};

    fn job(name: &str) -> ImageJob {
        ImageJob {
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
    fn a_canonical_camera_needs_that_of_the_images() {
        let request = |camera| Request {
            formats: vec![Format::Npy],
            quantity: None,
            camera,
            nearest_m: None,
            network_size: false,
        };
        let description = Description {
            input: InputDescription::fixed(8, 4, InputRange::Unit),
            output: OutputDescription {
                canonical_focal_px: Some(1000.0),
                ..OutputDescription::plain(OutputMeaning::DepthM)
            },
        };
        let error = targets(&request(None), &description).unwrap_err();
        assert!(error.to_string().contains("--focal-px"), "{error}");
        let camera = StereoCamera {
            focal_px: 700.0,
            baseline_m: 0.5,
        };
        assert!(targets(&request(Some(camera)), &description).is_ok());
    }
}
