//! Scores on the pairs held out of the training drives, and pictures of them.
//!
//! Depth metrics are those of the named Velodyne protocol (default `eigen-80`), for the pairs
//! that have a scan; the photometric error is the stereo objective without its adversarial
//! term, for all of them. The prediction is resized bilinearly to the size of the ground
//! truth, as in evaluation (PROTOCOL 3.3). Nothing here keeps gradients.
//!
//! The figures of a table are made by `bench`, from the exported model; these are for
//! watching a run and for choosing its best checkpoint.

use std::path::Path;
use std::sync::Arc;

use burn::tensor::{Device, Tensor};
use colorous::MAGMA;
use image::RgbImage;
use rayon::prelude::*;
use strat_metrics::{
    GroundTruth, GroundTruthKind, KnownCamera, Metrics, Protocol, StereoCamera, evaluate,
};
use strat_splits::Role;
use strat_store::image_files::{encode_png_rgb, read_rgb};
use strat_store::raster::Plane;
use strat_store::set::{PreparedSet, Sample};
use strat_store::spread::evenly;
use strat_store::{exr, files, resize};

use crate::config::Config;
use crate::data::augment::Augmentation;
use crate::data::loader::to_tensor;
use crate::data::pairs::Pair;
use crate::error::{Error, Result};
use crate::loss::{Weights, scalar, stereo_losses, synthesize};
use crate::network::discriminator::{ColourFactors, Discriminator, Patches};
use crate::network::generator::Generator;

/// Disparity that is shown as white, as a fraction of the width: 4 m before a KITTI camera
/// is 0.08.
const WHITE_DISPARITY: f64 = 0.1;

/// Mean scores over the validation pairs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scores {
    /// Stereo objective without its adversarial term.
    pub photometric: f64,
    /// Mean of the per-image depth metrics.
    pub depth: Option<Metrics>,
    /// Pairs scored.
    pub images: usize,
    /// Pairs with depth metrics.
    pub depth_images: usize,
}

impl Scores {
    /// Name and value of the score that decides which checkpoint is best; lower is better.
    #[must_use]
    pub fn deciding(&self) -> (&'static str, f64) {
        match self.depth {
            Some(metrics) => ("abs_rel", metrics.abs_rel),
            None => ("photometric", self.photometric),
        }
    }
}

/// The validation pairs of a prepared set.
pub struct Validation {
    samples: Vec<(Sample, Arc<Pair>)>,
    set: PreparedSet,
    protocol: Protocol,
    /// Sentences about pairs that could not be read.
    pub warnings: Vec<String>,
}

impl Validation {
    /// Reads the pairs chosen by the configuration; `None` when validation is off or the set
    /// has no validation pairs.
    ///
    /// # Errors
    /// When the table of the set cannot be read.
    pub fn open(set: &PreparedSet, config: &Config) -> Result<Option<Self>> {
        if config.validation.every == 0 && config.pictures.every == 0 {
            return Ok(None);
        }
        let protocol = strat_metrics::protocol(&config.validation.protocol)
            .ok_or_else(|| Error::Config("unknown validation protocol".to_owned()))?;
        let mut all = set.samples(Role::Val)?;
        all.retain(|sample| sample.right.is_some());
        let wanted = match config.validation.images {
            0 => all.len(),
            images => images,
        };
        let chosen: Vec<Sample> = evenly(all.len(), wanted)
            .map(|index| all[index].clone())
            .collect();
        let read: Vec<_> = chosen
            .into_par_iter()
            .map(|sample| {
                let view = |file| read_rgb(&set.path(file)).map_err(|error| error.to_string());
                let pair = view(&sample.left).and_then(|left| {
                    let right = sample.right.as_ref().ok_or("it has no right image")?;
                    view(right).map(|right| Pair { left, right })
                });
                (sample, pair)
            })
            .collect();
        let mut samples = Vec::new();
        let mut warnings = Vec::new();
        for (sample, pair) in read {
            match pair {
                Ok(pair) => {
                    let pair = pair.resized(config.input.width, config.input.height);
                    samples.push((sample, Arc::new(pair)));
                }
                Err(reason) => warnings.push(format!(
                    "warning: {reason}; validation goes on without this pair"
                )),
            }
        }
        if samples.is_empty() {
            return Ok(None);
        }
        let mut validation = Self {
            samples,
            set: set.clone(),
            protocol,
            warnings,
        };
        if config.validation.every > 0 && !validation.has_depth() {
            validation.warnings.push(format!(
                "warning: no validation pair of {} has the ground truth of the protocol {}; the best \
                 checkpoint is chosen by the photometric loss",
                set.root.display(),
                validation.protocol.name
            ));
        }
        Ok(Some(validation))
    }

    /// Number of pairs.
    #[must_use]
    pub fn count(&self) -> usize {
        self.samples.len()
    }

    /// Whether any pair has the ground truth that the protocol needs.
    #[must_use]
    pub fn has_depth(&self) -> bool {
        self.samples
            .iter()
            .any(|(sample, _)| truth_file(&self.protocol, sample).is_some())
    }

    /// Scores a generator without gradients; `device` is its plain device.
    ///
    /// # Errors
    /// When ground truth cannot be read, or the prediction is not finite.
    pub fn score(&self, generator: &Generator, config: &Config, device: &Device) -> Result<Scores> {
        let weights = Weights {
            adversarial: 0.0,
            ..config.loss_weights()
        };
        let mut photometric = 0.0;
        let mut metrics = Vec::new();
        for chunk in self.samples.chunks(config.batch) {
            let (left, right) = tensors(chunk.iter().map(|(_, pair)| &**pair), config, device);
            let disparities = generator.forward(left.clone());
            let terms = stereo_losses(left, right, &disparities, &weights);
            photometric += scalar(&terms.total) * chunk.len() as f64;
            let maps = disparity_maps(&disparities[0]);
            let scored: Vec<Option<Metrics>> = chunk
                .par_iter()
                .zip(&maps)
                .map(|((sample, _), map)| self.score_depth(sample, map))
                .collect::<Result<_>>()?;
            metrics.extend(scored.into_iter().flatten());
        }
        let images = self.samples.len();
        Ok(Scores {
            photometric: photometric / images as f64,
            depth: mean(&metrics),
            images,
            depth_images: metrics.len(),
        })
    }

    fn score_depth(&self, sample: &Sample, disparity: &Plane) -> Result<Option<Metrics>> {
        let Some(file) = truth_file(&self.protocol, sample) else {
            return Ok(None);
        };
        let (truth, _) = exr::read_depth(&self.set.path(file))?;
        let prediction = resize::bilinear_f32(disparity, truth.width, truth.height);
        let unscored = |error| Error::Config(format!("validation of {}: {error}", sample.id));
        let camera = KnownCamera {
            calibration: StereoCamera {
                focal_px: sample.focal_px,
                baseline_m: sample.baseline_m,
            },
            nominal_focal_px: None,
        };
        let size = (truth.width, truth.height);
        let truth = GroundTruth::new(size, &truth.data, camera).map_err(unscored)?;
        // A scan without a point in the crop gives no score, which is no failure of training.
        match evaluate(&self.protocol, &truth, &prediction.data) {
            Ok(scores) => Ok(scores.first().map(|score| score.metrics)),
            Err(strat_metrics::EvaluateError::NothingToScore { .. }) => Ok(None),
            Err(error) => Err(unscored(error)),
        }
    }

    /// What the networks make of a few pairs spread over the validation set.
    ///
    /// The right view is synthesised at `baseline`, a fraction of the rig's, as the discriminator
    /// sees it in training (PROTOCOL 4.3).
    #[must_use]
    pub fn pictures(
        &self,
        generator: &Generator,
        discriminator: Option<&Discriminator>,
        baseline: f64,
        config: &Config,
        device: &Device,
    ) -> Vec<Pictures> {
        let picture = |index: usize| {
            let (sample, pair) = &self.samples[index];
            let (left, right) = tensors(std::iter::once(&**pair), config, device);
            let disparities = generator.forward(left.clone());
            let (synthesised, _) =
                synthesize(left, right.clone(), disparities[0].clone(), baseline);
            let verdicts = discriminator.map(|network| {
                verdicts(
                    network,
                    [right, synthesised.clone()],
                    config.discriminator.patch,
                )
            });
            let values: Vec<f32> = synthesised.into_data().iter::<f32>().collect();
            let (width, height) = pair.left.dimensions();
            Pictures {
                id: sample.id.clone(),
                left: pair.left.clone(),
                disparity: coloured(&disparity_maps(&disparities[0])[0]),
                synthesised: view_of(&values, width, height),
                verdicts,
            }
        };
        evenly(self.samples.len(), config.pictures.images)
            .map(picture)
            .collect()
    }
}

/// Pictures of one validation pair.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pictures {
    /// The pair.
    pub id: String,
    /// Left image.
    pub left: RgbImage,
    /// Disparity of the left image; white is a tenth of the width or more.
    pub disparity: RgbImage,
    /// The right view made from it.
    pub synthesised: RgbImage,
    /// What the discriminator says of the middle patch of the real right view (left half) and
    /// of the synthesised one (right half): white where it takes it for real.
    pub verdicts: Option<RgbImage>,
}

impl Pictures {
    /// Writes left image, disparity and synthesised view, one below the other.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write(&self, folder: &Path, epoch: u64) -> Result<()> {
        let name = format!("epoch-{epoch:04}-{}.png", self.id.replace(['/', '\\'], "-"));
        let (width, height) = self.left.dimensions();
        let mut stack = RgbImage::new(width, 3 * height);
        for (row, part) in (0..).zip([&self.left, &self.disparity, &self.synthesised]) {
            image::imageops::replace(&mut stack, part, 0, i64::from(row * height));
        }
        files::write_atomic(&folder.join(name), &encode_png_rgb(&stack))?;
        Ok(())
    }
}

/// Side in pixels of a cell of the discriminator's grid as it is shown.
const CELL: u32 = 16;

/// Grid of the discriminator's verdicts for the middle patches of two views, side by side.
fn verdicts(network: &Discriminator, views: [Tensor<4>; 2], patch: usize) -> RgbImage {
    let [_, _, height, width] = views[0].dims();
    let size = patch.min(height).min(width);
    let patches = Patches {
        size,
        rows: vec![(height - size) / 2; 2],
        columns: vec![(width - size) / 2; 2],
    };
    let unchanged = ColourFactors(vec![[1.0; 3]; 2]);
    let logits = network.forward(patches.cut(Tensor::cat(views.into(), 0), &unchanged));
    let side = logits.dims()[3] as u32;
    let values: Vec<f32> = logits.into_data().iter::<f32>().collect();
    // A column of blue keeps the two grids apart.
    RgbImage::from_fn((2 * side + 1) * CELL, side * CELL, |x, y| {
        let (column, row) = (x / CELL, y / CELL);
        let (view, column) = match column {
            c if c < side => (0, c),
            c if c == side => return image::Rgb([40, 60, 160]),
            c => (1, c - side - 1),
        };
        let logit = values[(view * side * side + row * side + column) as usize];
        let real = 1.0 / (1.0 + (-logit).exp());
        image::Rgb([(255.0 * real).round() as u8; 3])
    })
}

fn truth_file<'a>(
    protocol: &Protocol,
    sample: &'a Sample,
) -> Option<&'a strat_store::set::FileRef> {
    match protocol.ground_truth {
        GroundTruthKind::VelodyneX => sample.depth_velodyne.as_ref(),
        GroundTruthKind::CameraZ => sample.depth_camera.as_ref(),
        GroundTruthKind::Annotated => sample.depth_annotated.as_ref(),
        // Refused with the configuration.
        GroundTruthKind::StereoNoc | GroundTruthKind::StereoOcc | GroundTruthKind::Laser => None,
    }
}

fn tensors<'a>(
    pairs: impl Iterator<Item = &'a Pair>,
    config: &Config,
    device: &Device,
) -> (Tensor<4>, Tensor<4>) {
    let size = config.input.size();
    let values = 3 * size[0] * size[1];
    let (mut left, mut right) = (Vec::new(), Vec::new());
    for pair in pairs {
        let start = left.len();
        left.resize(start + values, 0.0);
        right.resize(start + values, 0.0);
        Augmentation::NONE.apply(
            &pair.left,
            &pair.right,
            &mut left[start..],
            &mut right[start..],
        );
    }
    (
        to_tensor(left, size, device),
        to_tensor(right, size, device),
    )
}

/// Left disparities of a batch `[n, 2, h, w]`, fraction of the width.
fn disparity_maps(disparity: &Tensor<4>) -> Vec<Plane> {
    let [samples, _, height, width] = disparity.dims();
    let values: Vec<f32> = disparity
        .clone()
        .narrow(1, 0, 1)
        .into_data()
        .iter::<f32>()
        .collect();
    values
        .chunks_exact(height * width)
        .take(samples)
        .map(|data| Plane {
            width,
            height,
            data: data.to_vec(),
        })
        .collect()
}

fn mean(metrics: &[Metrics]) -> Option<Metrics> {
    if metrics.is_empty() {
        return None;
    }
    let mut sum = [0.0; 7];
    for values in metrics {
        for (sum, value) in sum.iter_mut().zip(values.to_array()) {
            *sum += value / metrics.len() as f64;
        }
    }
    Some(Metrics::from_array(sum))
}

fn coloured(disparity: &Plane) -> RgbImage {
    RgbImage::from_fn(disparity.width as u32, disparity.height as u32, |x, y| {
        let value = disparity.data[y as usize * disparity.width + x as usize];
        let share = (f64::from(value) / WHITE_DISPARITY).clamp(0.0, 1.0);
        let colour = MAGMA.eval_continuous(share);
        image::Rgb([colour.r, colour.g, colour.b])
    })
}

/// An image from planes of red, green and blue in 0..1.
fn view_of(values: &[f32], width: u32, height: u32) -> RgbImage {
    let pixels = (width * height) as usize;
    RgbImage::from_fn(width, height, |x, y| {
        let at = (y * width + x) as usize;
        image::Rgb(std::array::from_fn(|channel| {
            (values[channel * pixels + at].clamp(0.0, 1.0) * 255.0).round() as u8
        }))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_stack_image_disparity_and_synthesised_view() {
        let map = Plane {
            width: 2,
            height: 1,
            data: vec![0.0, 1.0],
        };
        let pictures = Pictures {
            id: "drive/1".to_owned(),
            left: RgbImage::from_pixel(2, 1, image::Rgb([9, 8, 7])),
            disparity: coloured(&map),
            synthesised: view_of(&[0.0, 1.0, 0.5, 0.5, 2.0, -1.0], 2, 1),
            verdicts: None,
        };
        let folder = tempfile::tempdir().unwrap();
        pictures.write(folder.path(), 3).unwrap();
        let picture = read_rgb(&folder.path().join("epoch-0003-drive-1.png")).unwrap();
        assert_eq!(picture.dimensions(), (2, 3));
        assert_eq!(picture.get_pixel(1, 0).0, [9, 8, 7]);
        let black = picture.get_pixel(0, 1).0;
        let white = picture.get_pixel(1, 1).0;
        assert!(
            black.iter().all(|v| *v < 10) && white[0] > 240,
            "{black:?} {white:?}"
        );
        assert_eq!(picture.get_pixel(0, 2).0, [0, 128, 255]);
        assert_eq!(picture.get_pixel(1, 2).0, [255, 128, 0]);
    }

    #[test]
    fn metrics_are_averaged_per_image() {
        let of = |value: f64| Metrics::from_array([value; 7]);
        assert_eq!(mean(&[]), None);
        assert_eq!(mean(&[of(1.0), of(3.0)]), Some(of(2.0)));
    }
}
