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
use strat_metrics::{GroundTruth, GroundTruthKind, Metrics, Protocol, evaluate};
use strat_splits::Role;
use strat_store::image_files::{encode_png_rgb, read_rgb};
use strat_store::raster::Plane;
use strat_store::set::{PreparedSet, Sample};
use strat_store::{exr, files, resize};

use crate::augment::Augmentation;
use crate::config::Config;
use crate::data::Pair;
use crate::error::{Error, Result};
use crate::generator::Generator;
use crate::losses::{Weights, scalar, stereo_losses, synthesize};
use crate::step::images;

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
        let all = set.samples(Role::Val)?;
        let wanted = match config.validation.images {
            0 => all.len(),
            images => images.min(all.len()),
        };
        let chosen: Vec<Sample> = (0..wanted)
            .map(|index| all[index * all.len() / wanted].clone())
            .collect();
        let read: Vec<_> = chosen
            .into_par_iter()
            .map(|sample| {
                let view = |file| read_rgb(&set.path(file)).map_err(|error| error.to_string());
                let pair = view(&sample.left)
                    .and_then(|left| view(&sample.right).map(|right| Pair { left, right }));
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
        Ok(Some(Self {
            samples,
            set: set.clone(),
            protocol,
            warnings,
        }))
    }

    /// Number of pairs.
    #[must_use]
    pub fn len(&self) -> usize {
        self.samples.len()
    }

    /// Never true: [`Self::open`] gives nothing instead.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.samples.is_empty()
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
        let truth = GroundTruth {
            width: truth.width,
            height: truth.height,
            depth_m: &truth.data,
            disparity_px: None,
            focal_px: sample.focal_px,
            baseline_m: sample.baseline_m,
            labels: None,
        };
        // A scan without a point in the crop gives no score, which is no failure of training.
        match evaluate(&self.protocol, &truth, &prediction.data) {
            Ok(scores) => Ok(scores.first().map(|score| score.metrics)),
            Err(strat_metrics::EvaluateError::NothingToScore { .. }) => Ok(None),
            Err(error) => Err(Error::Config(format!(
                "validation of {}: {error}",
                sample.id
            ))),
        }
    }

    /// Writes pictures of the first pairs into `folder`: left image, its disparity, and the
    /// right view synthesised from it, one below the other.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn pictures(
        &self,
        generator: &Generator,
        config: &Config,
        device: &Device,
        folder: &Path,
        epoch: u64,
    ) -> Result<()> {
        let shown = config.pictures.images.min(self.samples.len());
        for index in 0..shown {
            let (sample, pair) = &self.samples[index * self.samples.len() / shown];
            let (left, right) = tensors(std::iter::once(&**pair), config, device);
            let disparities = generator.forward(left.clone());
            let (synthesised, _) = synthesize(left, right, disparities[0].clone(), 1.0);
            let map = &disparity_maps(&disparities[0])[0];
            let values: Vec<f32> = synthesised.into_data().iter::<f32>().collect();
            let picture = stack(&pair.left, map, &values);
            let name = format!(
                "epoch-{epoch:04}-{}.png",
                sample.id.replace(['/', '\\'], "-")
            );
            files::write_atomic(&folder.join(name), &encode_png_rgb(&picture))?;
        }
        Ok(())
    }
}

fn truth_file<'a>(
    protocol: &Protocol,
    sample: &'a Sample,
) -> Option<&'a strat_store::set::FileRef> {
    match protocol.ground_truth {
        GroundTruthKind::VelodyneX => sample.depth_velodyne.as_ref(),
        GroundTruthKind::CameraZ => sample.depth_camera.as_ref(),
        _ => None,
    }
}

fn tensors<'a>(
    pairs: impl Iterator<Item = &'a Pair>,
    config: &Config,
    device: &Device,
) -> (Tensor<4>, Tensor<4>) {
    let values = 3 * (config.input.width * config.input.height) as usize;
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
    let samples = left.len() / values;
    (
        images(left, samples, config, device),
        images(right, samples, config, device),
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

fn stack(left: &RgbImage, disparity: &Plane, synthesised: &[f32]) -> RgbImage {
    let (width, height) = left.dimensions();
    let pixels = (width * height) as usize;
    RgbImage::from_fn(width, 3 * height, |x, y| {
        let at = ((y % height) * width + x) as usize;
        match y / height {
            0 => *left.get_pixel(x, y),
            1 => {
                let share = (f64::from(disparity.data[at]) / WHITE_DISPARITY).clamp(0.0, 1.0);
                let colour = MAGMA.eval_continuous(share);
                image::Rgb([colour.r, colour.g, colour.b])
            }
            _ => image::Rgb(std::array::from_fn(|channel| {
                (synthesised[channel * pixels + at].clamp(0.0, 1.0) * 255.0).round() as u8
            })),
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_stack_image_disparity_and_synthesised_view() {
        let left = RgbImage::from_pixel(2, 1, image::Rgb([9, 8, 7]));
        let map = Plane {
            width: 2,
            height: 1,
            data: vec![0.0, 1.0],
        };
        let picture = stack(&left, &map, &[0.0, 1.0, 0.5, 0.5, 2.0, -1.0]);
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
