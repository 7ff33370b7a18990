//! The images of a run, and where their results go.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use strat_store::command::CliError;

use super::request::Target;
use crate::images;

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

/// All images with the names of their results, in the order of the arguments, and a sentence for each
/// folder with pictures that are not read.
///
/// # Errors
/// A folder has no images, or the results would lie among them.
pub fn jobs(inputs: &[PathBuf], out: &Path) -> Result<(Vec<ImageJob>, Vec<String>), CliError> {
    let (mut jobs, mut skipped) = (Vec::new(), Vec::new());
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
        if found.images.is_empty() {
            return Err(CliError::Failed(format!(
                "no PNG or JPEG images in {}{}",
                input.display(),
                found
                    .skipped()
                    .map_or(String::new(), |text| format!("; {text}"))
            )));
        }
        skipped.extend(found.skipped());
        for image in found.images {
            let name = image.strip_prefix(input).unwrap_or(&image).to_path_buf();
            jobs.push(ImageJob { image, name });
        }
    }
    Ok((jobs, skipped))
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
            for suffix in target.suffixes() {
                let name = output_name(&job.name, suffix);
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
    }
    Ok(())
}

pub(super) fn output_name(name: &Path, suffix: &str) -> PathBuf {
    let mut stem = name.file_stem().unwrap_or_default().to_os_string();
    stem.push(suffix);
    name.with_file_name(stem)
}

#[cfg(test)]
mod tests {
    use strat_onnx::metadata::OutputMeaning;

    use super::*;
    use crate::{
        maps::request::Format,
        quantity::{Conversion, Quantity},
    };

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
        let (jobs, skipped) = jobs(&inputs, elsewhere.path()).unwrap();
        assert!(skipped.is_empty());
        assert_eq!(jobs[0].name, Path::new("a.png"));
    }
}
