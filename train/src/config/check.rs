//! What a configuration must be before anything is made of it.

use strat_metrics::{BenchmarkCrop, GroundTruthKind, Grouping, PostProcessing};

use super::settings::Config;
use crate::error::{Error, Result};
use crate::loss::Term;
use crate::network::discriminator::SMALLEST_PATCH;
use crate::network::generator::SIZE_MULTIPLE;

impl Config {
    pub(super) fn check(&self) -> Result<()> {
        let refuse = |condition: bool, sentence: String| {
            if condition {
                Err(Error::Config(sentence))
            } else {
                Ok(())
            }
        };
        for (key, value) in [
            ("epochs", self.epochs),
            ("batch", self.batch as u64),
            ("accumulate", self.accumulate as u64),
            ("checkpoint.every", self.checkpoint.every),
            ("checkpoint.keep", self.checkpoint.keep as u64),
        ] {
            refuse(value == 0, format!("`{key}` is 0; it must be at least 1"))?;
        }
        refuse(
            self.max_steps == Some(0),
            "`max_steps` is 0; leave it out to train all epochs".to_owned(),
        )?;
        let rate = |key: &str, value: f64| {
            refuse(
                !(value > 0.0 && value <= 1.0),
                format!("`{key}` is {value}; it must be above 0 and at most 1"),
            )
        };
        rate("learning_rate", self.learning_rate)?;
        rate("discriminator_learning_rate", self.discriminator_rate())?;
        refuse(
            !(0.0..=1.0).contains(&self.baseline_start),
            format!(
                "`baseline_start` is {}; it must be between 0 and 1",
                self.baseline_start
            ),
        )?;
        for (key, value) in [
            ("input.width", self.input.width),
            ("input.height", self.input.height),
        ] {
            refuse(
                value == 0 || !(value as usize).is_multiple_of(SIZE_MULTIPLE) || value > 8192,
                format!(
                    "`{key}` is {value}; the network needs a multiple of {SIZE_MULTIPLE}, \
                     at most 8192"
                ),
            )?;
        }
        refuse(
            self.discriminator.patch < SMALLEST_PATCH,
            format!(
                "`discriminator.patch` is {}; the discriminator needs at least {SMALLEST_PATCH}",
                self.discriminator.patch
            ),
        )?;
        let weights = self.loss_weights();
        let stereo = Term::ALL.map(|term| (term.key(), weights.of(term)));
        for (key, value) in stereo
            .into_iter()
            .chain([("adversarial", weights.adversarial)])
        {
            refuse(
                !(value.is_finite() && value >= 0.0),
                format!("`weights.{key}` is {value}; it must be a number of at least 0"),
            )?;
        }
        refuse(
            weights.ssim == 0.0 && weights.l1 == 0.0,
            "`weights.ssim` and `weights.l1` are both 0; then nothing ties the disparity to \
             the images"
                .to_owned(),
        )?;
        refuse(
            self.variant.is_adversarial() && weights.adversarial == 0.0,
            format!(
                "`weights.adversarial` is 0 in the variant `{}`; use `variant: no-adv` instead",
                self.variant.name()
            ),
        )?;
        let augment = &self.augment;
        for (key, value) in [("flip", augment.flip), ("colour", augment.colour)] {
            refuse(
                !(0.0..=1.0).contains(&value),
                format!("`augment.{key}` is {value}; it is a probability"),
            )?;
        }
        for (key, [low, high]) in [
            ("gamma", augment.gamma),
            ("brightness", augment.brightness),
            ("channel", augment.channel),
        ] {
            refuse(
                !(low > 0.0 && low <= high && high.is_finite()),
                format!("`augment.{key}` is [{low}, {high}]; it must ascend from above 0"),
            )?;
        }
        let name = &self.validation.protocol;
        match cannot_validate(name) {
            None => Ok(()),
            Some(reason) => Err(Error::Config(format!(
                "`validation.protocol` is `{name}`, {reason}; choose one such as eigen-80 \
                 (`bench protocols` lists all)"
            ))),
        }
    }
}

/// Why validation cannot score a protocol: it has one prediction per image and depth as its truth.
fn cannot_validate(name: &str) -> Option<&'static str> {
    let Some(protocol) = strat_metrics::protocol(name) else {
        return Some("which is not a known protocol");
    };
    match protocol.ground_truth {
        GroundTruthKind::VelodyneX | GroundTruthKind::CameraZ | GroundTruthKind::Annotated => {}
        GroundTruthKind::StereoNoc | GroundTruthKind::StereoOcc => {
            return Some("whose ground truth is stereo disparity, which validation pairs lack");
        }
        GroundTruthKind::Laser => {
            return Some("whose ground truth is Make3D's laser, which validation pairs lack");
        }
    }
    if protocol.grouping != Grouping::None {
        return Some("which scores parts of an image, and validation scores whole images");
    }
    if protocol.benchmark_crop != BenchmarkCrop::None {
        return Some("which shows the network a crop, and validation shows it whole images");
    }
    match protocol.post_processing {
        PostProcessing::None => None,
        PostProcessing::Flip => {
            Some("which predicts each image twice, and validation predicts it once")
        }
    }
}
