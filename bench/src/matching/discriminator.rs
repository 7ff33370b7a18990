//! What a trained discriminator says of a place along an epipolar line (PROTOCOL 4.7).
//!
//! It judges images, not matches: any piece of the right image looks real on its own. So it is shown what it
//! was trained to judge, a synthesised left view, in which everything is where it belongs but for a window
//! around the pixel, which is taken from the right image at the disparity in question. Its cost is the
//! adversarial term of the generator for that view.

use std::path::{Path, PathBuf};

use strat_onnx::{metadata::DiscriminatorMetadata, model::ReadError};
use strat_store::resize::Kernel;

use super::cost::Pair;
use crate::runtime::{Device, Runtime, RuntimeError, Session};

/// Name of the file in the folder of a run.
const FILE: &str = "discriminator.onnx";

const INPUT: &str = "patches";
const OUTPUT: &str = "logits";

/// Largest difference of a logit to the trainer's own that passes; as `train export` accepts it.
const TOLERANCE: f32 = 1e-3;

/// Values of patches that are handed to the runtime at a time: 16 patches of the thesis' size.
const BATCH_VALUES: usize = 16 * 3 * 256 * 256;

/// Why a discriminator cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum DiscriminatorError {
    /// There is no file.
    #[error(
        "there is no {}; `train export {} --discriminator` writes it",
        path.join(FILE).display(), path.display()
    )]
    NotExported {
        /// Folder of the run.
        path: PathBuf,
    },
    /// It cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// It is something else.
    #[error(
        "{} is no discriminator: {reason}; give the folder of a run, or the file that `train export RUN \
         --discriminator` writes", path.display()
    )]
    Other {
        /// The file.
        path: PathBuf,
        /// Why.
        reason: String,
    },
    /// It does not run, or gives no logits.
    #[error(transparent)]
    Run(#[from] RuntimeError),
    /// It gives something else than in training.
    #[error(
        "the discriminator {} gives other logits than in its training (by {difference:.1e}, more than \
         {TOLERANCE:.0e}), so nothing can be said with it on this runtime", path.display()
    )]
    Probe {
        /// The file.
        path: PathBuf,
        /// Largest difference; infinite where it gives no logits of the right number.
        difference: f32,
    },
}

/// A discriminator that is ready to judge.
pub struct Discriminator {
    session: Session,
    metadata: DiscriminatorMetadata,
    /// BLAKE3 of its file.
    pub blake3: String,
    /// Its file.
    pub path: PathBuf,
    /// A sentence where it was trained on images that were made otherwise.
    pub doubt: Option<String>,
}

impl Discriminator {
    /// Opens the file of a discriminator, or that of a run's folder, and asks its probe. `kernel` is the one
    /// that the images of the set were prepared with.
    ///
    /// # Errors
    /// There is none, it is something else, or the runtime does not compute what was trained.
    pub fn open(
        path: &Path,
        kernel: Kernel,
        runtime: &Runtime,
        device: Device,
        threads: usize,
    ) -> Result<Self, DiscriminatorError> {
        let file = if path.is_dir() {
            let file = path.join(FILE);
            if !file.is_file() {
                return Err(DiscriminatorError::NotExported {
                    path: path.to_path_buf(),
                });
            }
            file
        } else {
            path.to_path_buf()
        };
        let model = strat_onnx::model::read(&file)?;
        let other = |reason: String| DiscriminatorError::Other {
            path: file.clone(),
            reason,
        };
        let metadata = model.info.discriminator().map_err(other)?;
        let metadata =
            metadata.ok_or_else(|| other("it does not say that it is one".to_owned()))?;
        let kernel = kernel.to_string();
        let doubt = (metadata.kernel != kernel).then(|| {
            format!(
                "the discriminator was trained on images resized by `{}`, and those of the set are by \
                 `{kernel}`",
                metadata.kernel
            )
        });
        let session = runtime.load(&file, device, threads)?;
        let mut opened = Self {
            session,
            metadata,
            blake3: model.blake3,
            path: file,
            doubt,
        };
        let logits = opened.logits(1, &opened.metadata.probe_image())?;
        let difference = opened.metadata.max_difference(&logits);
        if difference > TOLERANCE {
            return Err(DiscriminatorError::Probe {
                path: opened.path,
                difference,
            });
        }
        Ok(opened)
    }

    /// Side in pixels of the window that is taken from the right image: a sixteenth of the patch and one.
    #[must_use]
    pub fn window(&self) -> usize {
        2 * half_window(self.metadata.patch as usize) + 1
    }

    /// Columns and rows of the images that it was trained on.
    #[must_use]
    pub fn image_size(&self) -> (u32, u32) {
        (self.metadata.image_width, self.metadata.image_height)
    }

    /// Logits of `count` patches.
    fn logits(&mut self, count: usize, patches: &[f32]) -> Result<Vec<f32>, DiscriminatorError> {
        let side = self.metadata.patch as usize;
        let shape = [count, 3, side, side];
        let outputs = self.session.run(INPUT, shape, patches, OUTPUT)?;
        let found = outputs.into_iter().find(|output| output.name == OUTPUT);
        Ok(found.map(|output| output.data).unwrap_or_default())
    }

    /// The cost of the untouched patch around a left pixel, and those of the disparities from 0 to `last`.
    ///
    /// # Errors
    /// The runtime fails.
    pub fn costs(
        &mut self,
        pair: &Pair,
        at: (usize, usize),
        last: usize,
    ) -> Result<(f64, Vec<f64>), DiscriminatorError> {
        let side = self.metadata.patch as usize;
        let plain = pair.patch(at, side);
        let values = plain.len();
        let views: Vec<Option<usize>> = std::iter::once(None).chain((0..=last).map(Some)).collect();
        let mut costs = Vec::with_capacity(views.len());
        for views in views.chunks((BATCH_VALUES / values).max(1)) {
            let mut patches = Vec::with_capacity(views.len() * values);
            for disparity in views {
                let begin = patches.len();
                patches.extend_from_slice(&plain);
                if let Some(disparity) = disparity {
                    let half = half_window(side);
                    pair.move_window(&mut patches[begin..], at, side, half, *disparity);
                }
            }
            let logits = self.logits(views.len(), &patches)?;
            let expected = views.len() * self.metadata.expected.len();
            if logits.len() != expected || logits.iter().any(|logit| !logit.is_finite()) {
                return Err(DiscriminatorError::Probe {
                    path: self.path.clone(),
                    difference: f32::INFINITY,
                });
            }
            costs.extend(logits.chunks(self.metadata.expected.len()).map(cost));
        }
        let plain = costs.remove(0);
        Ok((plain, costs))
    }
}

fn half_window(patch: usize) -> usize {
    (patch / 32).max(1)
}

/// The adversarial term of the generator (PROTOCOL 4.4): mean of softplus(-logit).
fn cost(logits: &[f32]) -> f64 {
    let softplus = |logit: &f32| {
        let x = -f64::from(*logit);
        x.max(0.0) + (-x.abs()).exp().ln_1p()
    };
    logits.iter().map(softplus).sum::<f64>() / logits.len() as f64
}

#[cfg(test)]
mod tests {
    use image::{Rgb, RgbImage};
    use strat_onnx::{
        graph::{Filter, Geometry, GraphBuilder},
        metadata::probe_image,
    };

    use super::*;
    use crate::runtime::RuntimeChoice;

    #[test]
    fn the_cost_is_the_generators_adversarial_term() {
        assert!((cost(&[0.0]) - 2.0_f64.ln()).abs() < 1e-12);
        // ln(1 + exp(-1)) and ln(1 + exp(2)).
        let expected = (0.313_261_687_518_222_8 + 2.126_928_011_042_972_5) / 2.0;
        assert!((cost(&[1.0, -2.0]) - expected).abs() < 1e-9);
        assert!(cost(&[-1e6]).is_finite() && cost(&[1e6]) < 1e-9);
    }

    #[test]
    fn windows_grow_with_the_patch() {
        assert_eq!([64, 128, 256, 16].map(half_window), [2, 4, 8, 1]);
    }

    /// One convolution: every pixel of a patch of 16 has 4 times its red as its logit, plus `offset`.
    fn red(folder: &Path, offset: f32, expected: f32) -> PathBuf {
        let mut graph = GraphBuilder::new("red");
        let dims = ["N".into(), 3.into(), 16.into(), 16.into()];
        let patches = graph.input(INPUT, &dims).unwrap();
        let filter = Filter {
            shape: [1, 3, 1, 1],
            weights: vec![4.0, 0.0, 0.0],
            bias: vec![offset],
        };
        let logits = graph
            .conv("red", patches, filter, Geometry::new(1, 0))
            .unwrap();
        graph.output(OUTPUT, logits).unwrap();
        let reds = probe_image(16, 16);
        let metadata = DiscriminatorMetadata {
            patch: 16,
            image_width: 40,
            image_height: 20,
            kernel: Kernel::Area.to_string(),
            train_data_digest: "00".to_owned(),
            variant: "strat".to_owned(),
            seed: 0,
            epoch: 1,
            tool_version: "0.0.0".to_owned(),
            parity: 0.0,
            expected: reds[..256].iter().map(|red| 4.0 * red + expected).collect(),
        };
        let path = folder.join(FILE);
        let bytes = graph.finish_with(metadata.to_props(), None).unwrap();
        std::fs::write(&path, bytes).unwrap();
        path
    }

    fn open(path: &Path) -> Result<Discriminator, String> {
        let (runtime, _) = Runtime::resolve(RuntimeChoice::Embedded, Device::Cpu).unwrap();
        let opened = Discriminator::open(path, Kernel::Area, &runtime, Device::Cpu, 1);
        opened.map_err(|error| error.to_string())
    }

    /// A red ridge of three columns around column 13 of the right image: the window of the pixel at column
    /// 20 covers all of it at disparity 7 alone.
    #[test]
    fn the_place_that_a_known_discriminator_likes_best_is_cheapest() {
        let folder = tempfile::tempdir().unwrap();
        red(folder.path(), 0.0, 0.0);
        let mut judge = open(folder.path()).unwrap();
        assert_eq!((judge.window(), &judge.doubt), (3, &None));
        assert_eq!(judge.image_size(), (40, 20));
        let left = RgbImage::new(40, 20);
        let ridge = |x: u32| match x {
            13 => 255,
            12 | 14 => 51,
            _ => 0,
        };
        let right = RgbImage::from_fn(40, 20, |x, _| Rgb([ridge(x), 0, 0]));
        let pair = Pair::new(&left, &right).unwrap();
        let (untouched, costs) = judge.costs(&pair, (20, 10), 12).unwrap();
        assert!((untouched - 2.0_f64.ln()).abs() < 1e-6);
        assert_eq!(costs.len(), 13);
        let softplus = |x: f64| x.exp().ln_1p();
        let three = softplus(-4.0) + 2.0 * softplus(-0.8);
        let expected = (247.0 * 2.0_f64.ln() + 3.0 * three) / 256.0;
        assert!(
            (costs[7] - expected).abs() < 1e-6,
            "{} {expected}",
            costs[7]
        );
        for (disparity, cost) in costs.iter().enumerate() {
            assert!(
                disparity == 7 || *cost > costs[7] + 1e-4,
                "{disparity}: {cost}"
            );
            let sees_nothing = !(5..=9).contains(&disparity);
            assert_eq!((cost - untouched).abs() < 1e-9, sees_nothing, "{disparity}");
        }
    }

    #[test]
    fn what_cannot_judge_is_refused_in_a_sentence() {
        let folder = tempfile::tempdir().unwrap();
        let said = |sentence: &str| {
            let error = open(folder.path()).err().unwrap();
            assert!(error.contains(sentence), "{error}");
        };
        said("train export");
        let file = red(folder.path(), 0.5, 0.0);
        said("other logits than in its training");
        std::fs::write(&file, "no model").unwrap();
        said("discriminator.onnx");
        let mut graph = GraphBuilder::new("other");
        let input = graph.input("x", &[1.into()]).unwrap();
        let output = graph.relu("relu", input).unwrap();
        graph.output("y", output).unwrap();
        std::fs::write(&file, graph.finish(None).unwrap()).unwrap();
        said("is no discriminator");
    }
}
