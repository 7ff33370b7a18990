//! What maps are to be, and which formats can hold it.

use strat_onnx::metadata::OutputMeaning;
use strat_store::command::CliError;

use crate::{
    model::Description,
    quantity::{Conversion, Quantity, StereoCamera, default_quantity},
};

/// What is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// `NAME.exr`: depth in metres.
    Exr,
    /// `NAME.depth.png` or `NAME.disparity.png`: value times 256.
    Png16,
    /// `NAME.color.png` with its scale below, and `NAME.colormap.png` of the map's own size: inverse depth or
    /// disparity in colour.
    Color,
    /// `NAME.ply`: a coloured point cloud.
    Ply,
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
            Self::Ply => "ply",
        }
    }
}

/// What maps are to be.
#[derive(Clone, Debug)]
pub struct Request {
    /// What to write; nothing named is all that is usual for what the model gives.
    pub formats: Vec<Format>,
    /// What png16 and npy hold; depth where it follows.
    pub quantity: Option<Quantity>,
    /// The camera of the images, where it is known.
    pub camera: Option<StereoCamera>,
    /// Depth of the brightest colour in metres; each picture's own where it is not given.
    pub nearest_m: Option<f64>,
    /// Maps of the network's own size instead of the images'.
    pub network_size: bool,
    /// What values of png16 are multiplied with: 256, or 1000 for millimetres.
    pub png_scale: f64,
    /// Focal length in pixels of the images' own width, for point clouds; also without a baseline.
    pub focal_px: Option<f64>,
    /// Depth in metres beyond which a point cloud has no points.
    pub cloud_to_m: f64,
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
    /// Behind the image's name without its extension, for each file.
    #[must_use]
    pub fn suffixes(self) -> &'static [&'static str] {
        match (self.format, self.conversion.quantity) {
            (Format::Exr, _) => &[".exr"],
            (Format::Npy, _) => &[".npy"],
            (Format::Ply, _) => &[".ply"],
            (Format::Color, _) => &[".color.png", ".colormap.png"],
            (Format::Png16, Quantity::DepthM) => &[".depth.png"],
            (Format::Png16, _) => &[".disparity.png"],
        }
    }
}

/// What is written where nobody names a format: depth where it follows, else the numbers there are, and
/// pictures of them.
fn usual_formats(default: Quantity) -> [Format; 2] {
    match default {
        Quantity::DepthM => [Format::Exr, Format::Color],
        _ => [Format::Npy, Format::Color],
    }
}

/// What would have to be given for depth in metres; none where it follows.
#[must_use]
pub fn advice(description: &Description, camera: Option<StereoCamera>) -> Option<&'static str> {
    let meaning = description.output.meaning();
    if has_scale(meaning, camera) {
        None
    } else if meaning.has_scale() {
        Some(
            "without --focal-px and --baseline-m only disparity is written; with both, --format exr, \
             png16 and ply hold metres",
        )
    } else {
        Some(
            "this model's numbers have no known scale, so depth in metres (exr, png16, ply) cannot be written; \
             `scale` in its description would say how many metres the unit is",
        )
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
    let usual = usual_formats(default_quantity(meaning, camera));
    let formats = match request.formats.as_slice() {
        [] => &usual,
        given => given,
    };
    for &format in formats {
        if targets.iter().any(|target| target.format == format) {
            continue;
        }
        let default = default_quantity(meaning, camera);
        let wanted = request.quantity.unwrap_or(default);
        let quantity = match format {
            Format::Exr | Format::Ply => Quantity::DepthM,
            Format::Color if default == Quantity::DepthM => Quantity::InverseDepth,
            Format::Color => default,
            Format::Npy | Format::Png16 => wanted,
        };
        let fits = match format {
            Format::Exr => matches!(request.quantity, None | Some(Quantity::DepthM)),
            Format::Png16 => matches!(quantity, Quantity::DepthM | Quantity::DisparityPx),
            Format::Ply => request.focal_px.is_some(),
            Format::Color | Format::Npy => true,
        };
        if !fits {
            return Err(CliError::Usage(match format {
                Format::Exr => "`--format exr` holds depth in metres only; use npy for other \
                                quantities"
                    .to_owned(),
                Format::Ply => {
                    "a point cloud needs the camera: give --focal-px, and --baseline-m where the \
                                model gives disparity"
                        .to_owned()
                }
                _ => format!(
                    "`--format png16` holds depth-m or disparity-px, not {}; use npy or color",
                    quantity.option()
                ),
            }));
        }
        let width = description.input.disparity_width();
        let conversion = Conversion::new(quantity, meaning, width, camera)
            .map_err(|error| CliError::Usage(format!("`--format {}`: {error}", format.as_str())))?;
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

#[cfg(test)]
mod tests {
    use strat_onnx::metadata::InputRange;

    use super::*;
    use crate::model::{InputDescription, OutputDescription};

    #[test]
    fn a_canonical_camera_needs_that_of_the_images() {
        let request = |camera| Request {
            formats: vec![Format::Npy],
            quantity: None,
            camera,
            nearest_m: None,
            network_size: false,
            png_scale: 256.0,
            focal_px: None,
            cloud_to_m: 80.0,
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
