//! Models side by side on the same images: which images, what each model makes of them, and the sheets.
//!
//! What is drawn is what was scored under one protocol, the one that the images were chosen under and the
//! captions name. Not here: how a sheet looks; see [`crate::draw::side_by_side`].

use std::{
    collections::{BTreeSet, HashMap},
    path::{Path, PathBuf},
};

use serde::Serialize;
use strat_metrics::{Alignment, Protocol, Row, RowContext, Suffix};
use strat_onnx::metadata::OutputMeaning;
use strat_store::{
    files, image_files,
    progress::Progress,
    resize,
    set::{Content, PreparedSet, Sample},
    spread,
};

use crate::{
    draw::{
        png::{self, DrawError},
        side_by_side::{self, Frame, Shown, Synthesis, SynthesisFrame},
    },
    evaluate::{
        self, Comparison, NamedFile, Predictor, SampleError, Task,
        plan::{self, PlanError, TableChoice},
        predictions::{SavedError, SavedPredictions},
        sample::load_image,
    },
    model::{self, Model, ModelError},
    protocol_file,
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

/// Which test images are drawn.
#[derive(Clone, Debug)]
pub enum Choice {
    /// These ids.
    Images(Vec<String>),
    /// So many, spread evenly.
    Evenly(usize),
    /// By their Abs Rel in the mean over the models of these rows.
    Ranked {
        /// The rows.
        rows: Vec<Row>,
        /// So many of the worst images, the worst first.
        worst: usize,
        /// So many of the best, the best first.
        best: usize,
    },
}

/// The protocol that figures are drawn under: the one given by name, else the first without groups
/// that the rows to choose by were measured under, else that of the set's first table. Own pairs and
/// Cityscapes have no table.
///
/// # Errors
/// The set has no such ground truth, or the rows were measured by other rules.
pub fn protocol_for(
    given: Option<&str>,
    choice: &Choice,
    set: &PreparedSet,
    samples: &[Sample],
) -> Result<Protocol, FigureError> {
    let content = set.manifest.content;
    let of_rows = match choice {
        Choice::Ranked { rows, .. } => rows.iter().find(|row| row.score.group.is_none()),
        _ => None,
    };
    let of_rows = of_rows.map(|row| &row.context);
    let wanted = given.or(of_rows.map(|context| context.protocol.as_str()));
    let wanted: Vec<String> = match (wanted, content) {
        (Some(name), _) => vec![name.to_owned()],
        (None, Content::Pairs | Content::Cityscapes) => vec!["eigen-cameraz-80".to_owned()],
        (None, _) => Vec::new(),
    };
    let count = plan::test_count(set, samples);
    let plan = plan::plan(TableChoice::All, &wanted, content, samples, count)?;
    let found = match wanted.first() {
        // One that a table has too stands in the table's position of the plan.
        Some(name) => protocol_file::resolve(name).ok(),
        None => plan.protocols.into_iter().next(),
    };
    let found = found.ok_or(FigureError::NoProtocol)?;
    match of_rows.filter(|_| given.is_none()) {
        Some(context) if context.protocol_digest != found.digest() => {
            Err(FigureError::OtherRules(found.name))
        }
        _ => Ok(found),
    }
}

/// The test images to be drawn.
///
/// # Errors
/// One is not in the set, or the rows have none under the protocol.
pub fn choose(
    choice: &Choice,
    protocol: &Protocol,
    set: &PreparedSet,
    samples: &[Sample],
) -> Result<Vec<Sample>, FigureError> {
    let by_id = |id: &str| {
        let found = samples.iter().find(|sample| sample.id == id);
        found.cloned().ok_or_else(|| {
            let drive = id.split('/').next().unwrap_or(id);
            let near = samples.iter().find(|sample| sample.id.starts_with(drive));
            let example = near.or(samples.first());
            FigureError::NoSuchImage {
                set: set.root.display().to_string(),
                id: id.to_owned(),
                example: example.map_or_else(String::new, |sample| sample.id.clone()),
            }
        })
    };
    match choice {
        Choice::Images(ids) => ids.iter().map(|id| by_id(id.trim())).collect(),
        Choice::Evenly(count) => {
            let indices = spread::evenly(samples.len(), *count);
            Ok(indices.map(|index| samples[index].clone()).collect())
        }
        Choice::Ranked { rows, worst, best } => {
            let ranked = ranked(rows, protocol);
            if ranked.is_empty() {
                let names = rows.iter().map(|row| row.context.protocol.clone());
                let names: BTreeSet<String> = names.collect();
                return Err(FigureError::NotRanked {
                    wanted: protocol.name.clone(),
                    found: names.into_iter().collect(),
                });
            }
            let mut seen = BTreeSet::new();
            let bounds = ranked.iter().rev().take(*worst);
            bounds
                .chain(ranked.iter().take(*best))
                .filter(|id| seen.insert(**id))
                .map(|id| by_id(id))
                .collect()
        }
    }
}

/// Images by their Abs Rel under a protocol, in the mean over the models, best first. Models of
/// unknown scale are scored by medians under it.
fn ranked<'a>(rows: &'a [Row], protocol: &Protocol) -> Vec<&'a str> {
    let scaled = protocol.clone().with(Suffix::Align(Alignment::Median));
    let digests = [protocol.digest(), scaled.digest()];
    let mut sums: HashMap<&str, (f64, f64)> = HashMap::new();
    for row in rows {
        if row.score.group.is_none() && digests.contains(&row.context.protocol_digest) {
            let (sum, count) = sums.entry(&row.image).or_default();
            *sum += row.score.metrics.abs_rel;
            *count += 1.0;
        }
    }
    let mut ranked: Vec<(&str, f64)> = sums
        .into_iter()
        .map(|(image, (sum, count))| (image, sum / count))
        .collect();
    ranked.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(b.0)));
    ranked.into_iter().map(|(image, _)| image).collect()
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
    comparisons: HashMap<String, Shown<Comparison>>,
    /// Right views; none where the model gives no right disparity.
    syntheses: HashMap<String, Shown<Synthesis>>,
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
        let comparisons = self.compare(&name, &mut Predictor::Model(model), meaning);
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
        let comparisons = self.compare(&given.name, &mut Predictor::Saved(&saved), meaning);
        Ok(Drawn {
            record: ModelRecord {
                name: given.name.clone(),
                file: given.file.clone(),
                blake3: saved.blake3.clone(),
            },
            comparisons,
            syntheses: HashMap::new(),
        })
    }

    /// Predictions beside the ground truth, or why there is none.
    fn compare(
        &self,
        name: &str,
        predictor: &mut Predictor<'_>,
        meaning: OutputMeaning,
    ) -> HashMap<String, Shown<Comparison>> {
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
        let found = evaluate::evaluate(&task, name, predictor, self.pool, &progress, &mut ());
        progress.finish();
        let found = found.unwrap_or_else(|never| match never {});
        let failures = found.failures.into_iter();
        let mut shown: HashMap<String, Shown<Comparison>> = failures
            .map(|failure| (failure.image, Err(failure.reason)))
            .collect();
        for comparison in found.comparisons {
            // One that could not be scored can be looked at.
            shown.insert(comparison.image.clone(), Ok(comparison));
        }
        shown
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
        let size = (disparity.width as u32, disparity.height as u32);
        let small = |image| resize::rgb(&image, size.0, size.1, input.kernel);
        let real = image_files::read_rgb(&self.set.path(right))?;
        Ok(Some(Synthesis {
            right: side_by_side::synthesize_right(&small(left), &disparity),
            real: small(real),
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
        Ok(written)
    }
}

fn write_sheets(out: &Path, name: &str, sheets: &[String]) -> Result<Vec<String>, FigureError> {
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
            None => Err("there is no right view".to_owned()),
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
