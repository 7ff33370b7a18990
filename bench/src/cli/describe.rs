//! `bench describe`: a first description of a model, for a person to confirm.

use std::path::{Path, PathBuf};

use clap::builder::PossibleValuesParser;
use image::RgbImage;
use strat_store::{
    command::{CliError, DONE, FAILED, print},
    files, image_files,
};

use super::args::{RuntimeArgs, default_name};
use crate::{
    model::{
        Model, ModelError, description_path,
        draft::{Draft, FAMILIES, Family, Look},
        prepare_input, unconfirmed,
    },
    notes::Notes,
};

/// Size of the picture that is shown to a model where none is given.
const PICTURE: (u32, u32) = (640, 480);

/// Arguments of `bench describe`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
The draft is written beside the file (model.yaml for model.onnx) and never replaces one that is there. Lines
are marked `read from the file` or `to be confirmed`, and in the template of a family by where in its own code
they stand; `bench` warns as long as lines are to be confirmed.

A description says what the model takes and gives; the README of bench has all keys:
  input:  {width: 640, height: 192, range: 0..1, mean: [0.485, 0.456, 0.406],
           std: [0.229, 0.224, 0.225], channels: rgb, layout: nchw, kernel: lanczos}
  output: {name: disp, meaning: inverse_depth, sigmoid: {min_depth: 0.1, max_depth: 100},
           scale: 5.4, channel: 0, layout: nchw}
meaning is disparity_fraction, disparity_px, inverse_depth or depth (of unknown scale unless `scale` says how
many metres the unit is), inverse_depth_per_m or depth_m.

Examples:
  bench describe depth_anything_v2_vits.onnx --family depth-anything-v2 --image street.png
  bench describe model.onnx
  bench describe --family metric3d")]
pub(super) struct DescribeArgs {
    /// The ONNX file; without one the template of a family is printed
    #[arg(required_unless_present = "family")]
    model: Option<PathBuf>,
    /// Begin with what is known of a family of models
    #[arg(long, value_name = "NAME", value_parser = PossibleValuesParser::new(names()))]
    family: Option<String>,
    /// Photograph to try the model on; a synthetic picture without
    #[arg(long, value_name = "FILE", requires = "model")]
    image: Option<PathBuf>,
    #[command(flatten)]
    runtime: RuntimeArgs,
}

fn names() -> Vec<&'static str> {
    FAMILIES.iter().map(|family| family.name).collect()
}

pub(super) fn run(args: &DescribeArgs) -> anyhow::Result<u8> {
    let chosen = args.family.as_deref();
    let family = FAMILIES.iter().find(|family| Some(family.name) == chosen);
    match (&args.model, family) {
        (Some(model), family) => describe(args, model, family),
        (None, Some(family)) => {
            print(Draft::of_family(family).to_string())?;
            Ok(DONE)
        }
        // The parser has seen to it that there is one of the two.
        (None, None) => Ok(DONE),
    }
}

fn describe(args: &DescribeArgs, path: &Path, family: Option<&Family>) -> anyhow::Result<u8> {
    let file = strat_onnx::model::read(path)?;
    let yaml = description_path(path);
    if yaml.exists() {
        let text = format!(
            "{} is there already and is not replaced; move it away to have a new draft",
            yaml.display()
        );
        return Err(CliError::Usage(text).into());
    }
    let mut notes = Notes::new(args.runtime.quiet);
    if file.info.metadata().is_some() {
        notes.note(&format!(
            "{} describes itself, as all models of `train` do; nothing is written",
            path.display()
        ));
        return Ok(DONE);
    }
    let image = match &args.image {
        Some(image) => image_files::read_rgb(image)?,
        None => picture(),
    };
    let misfit = |reason: String| ModelError::Graph {
        model: path.to_path_buf(),
        reason,
    };
    let mut draft = Draft::of_file(&file, family).map_err(misfit)?;
    let description = draft.description().map_err(misfit)?;
    let runtime = args.runtime.resolve()?;
    let name = default_name(path);
    let device = args.runtime.device;
    let tried = Model::described(&name, file, description, &runtime, device, 0)
        .and_then(|mut model| look(&mut model, &image));
    let doubt = match tried {
        Ok((look, doubt)) => {
            notes.say(&look.text());
            if let Some(image) = &args.image {
                let image = image.file_name().unwrap_or_default().to_string_lossy();
                draft.take_look(&look, &image);
            }
            doubt.map(|error| format!("what the model gave is not a map: {error}"))
        }
        Err(error) => Some(format!("the model could not be tried: {error}")),
    };
    let is_whole = doubt.is_none();
    if let Some(sentence) = doubt {
        notes.fail(sentence);
    }
    let text = draft.to_string();
    files::write_atomic(&yaml, text.as_bytes())?;
    print(text.clone())?;
    let left = unconfirmed(&text);
    notes.say(&format!(
        "written to {}; {left} lines are to be confirmed there; next: bench predict PHOTOS -m {} -o depth, or bench \
         eval",
        yaml.display(),
        path.display()
    ));
    Ok(if is_whole { DONE } else { FAILED })
}

/// Asks a model once: a look at the output that is read, and why that is no map.
fn look(model: &mut Model, image: &RgbImage) -> Result<(Look, Option<ModelError>), ModelError> {
    // A canonical camera changes no sign and no order.
    let input = prepare_input(image, &model.description.input, None)?;
    let (output, map) = model.look(&input)?;
    let look = Look::new(&output, map.as_ref().ok());
    Ok((look, map.err()))
}

/// A sky above a road, so that there is something to look at.
fn picture() -> RgbImage {
    let (width, height) = PICTURE;
    RgbImage::from_fn(width, height, |x, y| {
        let (x, y) = (x * 255 / width, y * 255 / height);
        image::Rgb([
            (255 - y) as u8,
            (x / 2 + (255 - y) / 2) as u8,
            (255 - y / 2) as u8,
        ])
    })
}
