//! Models side by side on the same images: which images, what each model makes of them, and the sheets.
//!
//! What is drawn is what was scored under one protocol, the one that the images were chosen under and the
//! captions name. Not here: how a sheet looks; see [`crate::draw::side_by_side`].

mod choice;

use std::{
    collections::{BTreeSet, HashMap},
    convert::Infallible,
    path::{Path, PathBuf},
};

pub use choice::{Choice, choose, protocol_for};
use serde::Serialize;
use strat_metrics::{Alignment, Protocol, Row, RowContext, Suffix};
use strat_onnx::metadata::OutputMeaning;
use strat_store::{
    files, image_files,
    progress::Progress,
    raster::Plane,
    resize,
    set::{Content, PreparedSet, Sample},
};

use crate::{
    draw::{
        baselines,
        png::{self, DrawError},
        side_by_side::{self, Frame, Shown, Synthesis, SynthesisFrame},
    },
    evaluate::{
        self, Comparison, NamedFile, Observer, Predictor, SampleError, Task,
        agreement::ImageAgreement,
        plan::PlanError,
        predictions::{SavedError, SavedPredictions},
        sample::load_image,
    },
    model::{self, Model, ModelError},
};

/// PNG pixels for each unit of the SVG.
const ZOOM: f32 = 1.0;

/// Why there are no figures.
#[derive(Debug, thiserror::Error)]
pub enum FigureError {
    /// A file of the set could not be read, or a figure not written.
    #[error(transparent)]
    Store(#[from] strat_store::Error),
    /// The model cannot be used.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The saved predictions cannot be used.
    #[error(transparent)]
    Saved(#[from] SavedError),
    /// An image cannot be used.
    #[error(transparent)]
    Sample(#[from] SampleError),
    /// The set offers no such protocol.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// A sheet cannot become PNG.
    #[error("figure {name}: {source}")]
    Draw {
        /// The figure.
        name: String,
        /// Why.
        source: DrawError,
    },
    /// The set has no tables.
    #[error("this set has no protocol of its own; give one with `--protocol`")]
    NoProtocol,
    /// An image that was requested is not in the set.
    #[error("{set} has no test image {id}; one that it has is {example}, and test.csv lists all")]
    NoSuchImage {
        /// The set.
        set: String,
        /// The id.
        id: String,
        /// An id of the set, of the same drive where there is one.
        example: String,
    },
    /// The rows say nothing about the protocol.
    #[error(
        "the rows to choose by have no images under {wanted}; they are about {}", found.join(", ")
    )]
    NotRanked {
        /// The protocol of the figures.
        wanted: String,
        /// Those of the rows.
        found: Vec<String>,
    },
    /// The rows were measured by other rules of the same name.
    #[error(
        "the rows to choose by were measured under other rules called {0}; give the file of these \
         rules with `--protocol`"
    )]
    OtherRules(String),
}

/// A model of a figure; stands in `figures.yaml`.
#[derive(Clone, Debug, Serialize)]
pub struct ModelRecord {
    /// Name shown in figures.
    pub name: String,
    /// The file.
    pub file: PathBuf,
    /// Its digest.
    pub blake3: String,
}

/// What one model made of the chosen images.
pub struct Drawn {
    /// The model.
    pub record: ModelRecord,
    /// What its maps let suspect of its description; said already.
    pub suspicions: Vec<String>,
    comparisons: HashMap<String, Shown<Comparison>>,
    /// Right views; none where the model gives no right disparity.
    syntheses: HashMap<String, Shown<Synthesis>>,
}

/// Keeps no rows, but it is here that the images are looked at first.
struct FirstLook;

impl Observer for FirstLook {
    type Error = Infallible;

    fn predicted(&mut self, _: &str, _: Option<&Plane>) -> Result<(), Infallible> {
        Ok(())
    }

    fn scored(&mut self, _: &[Row], _: Option<ImageAgreement>) -> Result<(), Infallible> {
        Ok(())
    }
}

/// What is the same for all models of a figure.
pub struct Figures<'a> {
    /// The prepared set.
    pub set: &'a PreparedSet,
    /// Its test samples.
    pub samples: &'a [Sample],
    /// Those that are drawn.
    pub chosen: &'a [Sample],
    /// What they are scored by.
    pub protocol: &'a Protocol,
    /// Threads beside the model.
    pub pool: &'a rayon::ThreadPool,
    /// No progress.
    pub quiet: bool,
}

impl Figures<'_> {
    /// Predictions and right views of a network.
    pub fn of_model(&self, file: &Path, model: &mut Model) -> Drawn {
        let name = model.name.clone();
        let meaning = model.description.output.meaning();
        let (comparisons, suspicions) = self.compare(&name, &mut Predictor::Model(model), meaning);
        let mut syntheses = HashMap::new();
        for sample in self.chosen {
            // A model that fails is named once, by its comparison.
            let synthesis = match self.synthesize(model, sample) {
                Ok(None) => continue,
                Ok(Some(synthesis)) => Ok(synthesis),
                Err(error) => Err(error.to_string()),
            };
            syntheses.insert(sample.id.clone(), synthesis);
        }
        Drawn {
            record: ModelRecord {
                name,
                file: file.to_path_buf(),
                blake3: model.file.blake3.clone(),
            },
            suspicions,
            comparisons,
            syntheses,
        }
    }

    /// Predictions in files.
    ///
    /// # Errors
    /// They cannot be used for this set.
    pub fn of_saved(&self, given: &NamedFile) -> Result<Drawn, FigureError> {
        let content = self.set.manifest.content;
        let saved = SavedPredictions::open(&given.name, &given.file, content, self.samples)?;
        let meaning = saved.meaning();
        let (comparisons, suspicions) =
            self.compare(&given.name, &mut Predictor::Saved(&saved), meaning);
        Ok(Drawn {
            record: ModelRecord {
                name: given.name.clone(),
                file: given.file.clone(),
                blake3: saved.blake3.clone(),
            },
            suspicions,
            comparisons,
            syntheses: HashMap::new(),
        })
    }

    /// Predictions beside the ground truth, or why there is none; and what they let suspect.
    fn compare(
        &self,
        name: &str,
        predictor: &mut Predictor<'_>,
        meaning: OutputMeaning,
    ) -> (HashMap<String, Shown<Comparison>>, Vec<String>) {
        let mut protocol = self.protocol.clone();
        if !meaning.has_scale() && protocol.alignment == Alignment::None {
            protocol = protocol.with(Suffix::Align(Alignment::Median));
        }
        let context = RowContext {
            model: name.to_owned(),
            protocol: protocol.name.clone(),
            protocol_digest: protocol.digest(),
            ..RowContext::default()
        };
        let pictures: BTreeSet<String> = self.chosen.iter().map(|s| s.id.clone()).collect();
        let task = Task {
            set: self.set,
            samples: self.chosen,
            protocols: &[(protocol, context)],
            pictures: &pictures,
            further: false,
            whole: false,
        };
        let images = self.chosen.len() as u64;
        let progress = Progress::new(name, images, "images", self.quiet);
        let mut look = FirstLook;
        let Ok(found) = evaluate::evaluate(&task, name, predictor, self.pool, &progress, &mut look);
        progress.finish();
        let failures = found.failures.into_iter();
        let mut shown: HashMap<String, Shown<Comparison>> = failures
            .map(|failure| (failure.image, Err(failure.reason)))
            .collect();
        for comparison in found.comparisons {
            // One that could not be scored can be looked at.
            shown.insert(comparison.image.clone(), Ok(comparison));
        }
        (shown, found.suspicions)
    }

    /// The right view that a model makes of the left one; none if the model gives no disparity of
    /// the right view, or the set has no right view.
    fn synthesize(
        &self,
        model: &mut Model,
        sample: &Sample,
    ) -> Result<Option<Synthesis>, FigureError> {
        let Some(right) = sample.right_full.as_ref().or(sample.right.as_ref()) else {
            return Ok(None);
        };
        if model.has_ended() {
            return Ok(None);
        }
        let left = load_image(self.set, sample)?;
        let input = model.description.input.clone();
        let prepared = model::prepare_input(&left, &input, None)?;
        let Some(disparity) = model.predict_right(&prepared)? else {
            return Ok(None);
        };
        // A fraction of the width is the same at every size.
        let (width, height) = left.dimensions();
        let disparity = resize::bilinear_f32(&disparity, width as usize, height as usize);
        let mut real = image_files::read_rgb(&self.set.path(right))?;
        if real.dimensions() != (width, height) {
            real = resize::rgb(&real, width, height, input.kernel);
        }
        Ok(Some(Synthesis {
            right: side_by_side::synthesize_right(&left, &disparity, 1.0),
            real,
            left,
            disparity,
        }))
    }

    /// Writes all sheets into a folder and returns their names. There is a sheet of synthesised views
    /// only where some model gives the disparity of the right view.
    ///
    /// # Errors
    /// A figure cannot be drawn or written.
    pub fn write(&self, out: &Path, drawn: &[Drawn]) -> Result<Vec<String>, FigureError> {
        let content = self.set.manifest.content;
        let (name, title) = match content {
            Content::Kitti => ("comparison", "KITTI split"),
            Content::Eigen => ("comparison", "Eigen split"),
            Content::Make3d => ("fig_3_6", "Make3D"),
            Content::Cityscapes => ("comparison", "Cityscapes"),
            Content::Pairs => ("comparison", "Own pairs"),
        };
        let frames: Vec<Frame<'_>> = self
            .chosen
            .iter()
            .map(|sample| Frame {
                image: &sample.id,
                models: drawn
                    .iter()
                    .map(|one| (one.name(), one.comparison(&sample.id)))
                    .collect(),
            })
            .collect();
        let title = format!("{title}: depth and its error under {}", self.protocol.name);
        let mut written = write_sheets(out, name, &side_by_side::comparisons(&title, &frames))?;
        let able: Vec<&Drawn> = drawn.iter().filter(|one| one.gives_right_views()).collect();
        if able.is_empty() {
            return Ok(written);
        }
        let lefts: Vec<Option<image::RgbImage>> = self
            .chosen
            .iter()
            .map(|sample| load_image(self.set, sample).ok())
            .collect();
        let frames: Vec<SynthesisFrame<'_>> = self
            .chosen
            .iter()
            .zip(&lefts)
            .map(|(sample, left)| SynthesisFrame {
                image: &sample.id,
                left: left.as_ref(),
                models: able
                    .iter()
                    .map(|one| (one.name(), one.synthesis(&sample.id)))
                    .collect(),
            })
            .collect();
        let title = "Figure 3.10  Synthesised right views at the widest baseline";
        written.extend(write_sheets(
            out,
            "fig_3_10",
            &side_by_side::syntheses(title, &frames),
        )?);
        written.extend(self.baselines(out, &able)?);
        Ok(written)
    }

    /// A sheet for each model: right views of the first image at growing baselines.
    fn baselines(&self, out: &Path, able: &[&Drawn]) -> Result<Vec<String>, FigureError> {
        let Some(first) = self.chosen.first() else {
            return Ok(Vec::new());
        };
        let sheets: Vec<String> = able
            .iter()
            .filter_map(|one| {
                let synthesis = one.synthesis(&first.id).ok()?;
                Some(baselines::sheet(&first.id, one.name(), synthesis))
            })
            .collect();
        write_sheets(out, "fig_3_4", &sheets)
    }
}

/// Writes sheets as SVG and PNG, numbered where there are several, and returns their names.
pub(crate) fn write_sheets(
    out: &Path,
    name: &str,
    sheets: &[String],
) -> Result<Vec<String>, FigureError> {
    let mut written = Vec::new();
    for (index, svg) in sheets.iter().enumerate() {
        let name = if sheets.len() == 1 {
            name.to_owned()
        } else {
            format!("{name}_{}", index + 1)
        };
        files::write_atomic(&out.join(format!("{name}.svg")), svg.as_bytes())?;
        let drawn = png::png(svg, ZOOM).map_err(|source| FigureError::Draw {
            name: name.clone(),
            source,
        })?;
        files::write_atomic(&out.join(format!("{name}.png")), &drawn)?;
        written.push(name);
    }
    Ok(written)
}

impl Drawn {
    fn name(&self) -> &str {
        &self.record.name
    }

    fn comparison(&self, image: &str) -> Shown<&Comparison> {
        match self.comparisons.get(image) {
            Some(shown) => shown.as_ref().map_err(Clone::clone),
            None => Err("nothing was predicted".to_owned()),
        }
    }

    fn synthesis(&self, image: &str) -> Shown<&Synthesis> {
        match self.syntheses.get(image) {
            Some(shown) => shown.as_ref().map_err(Clone::clone),
            None => Err("no right view".to_owned()),
        }
    }

    /// Whether it gave a right view of any image.
    #[must_use]
    pub fn gives_right_views(&self) -> bool {
        !self.syntheses.is_empty()
    }

    /// Images without depth, and why.
    #[must_use]
    pub fn problems(&self) -> Vec<(&str, &str)> {
        let mut problems: Vec<(&str, &str)> = self
            .comparisons
            .iter()
            .filter_map(|(image, shown)| Some((image.as_str(), shown.as_ref().err()?.as_str())))
            .collect();
        problems.sort_unstable();
        problems
    }
}
