//! Maps that a program hands over while its network is in memory: for one image ([`evaluate_map`]) or
//! for the test images of a prepared set ([`InMemoryRun`]).
//!
//! The way is that of saved predictions (PROTOCOL 3.3), without their files: the same checks, the
//! same scores, the same rows. A run's maps are identified as a folder of them would be that NumPy
//! has saved as arrays of `<f4`, so the rows of both are the same to the last byte.
//!
//! Not here: where maps come from, and what is in the files of results ([`super::write`](mod@super::write)).

use std::{
    collections::HashMap,
    path::{Path, PathBuf},
    sync::{Mutex, MutexGuard, PoisonError},
    time::Instant,
};

use image::RgbImage;
use strat_metrics::{GroundTruth, ImageScore, Protocol, Row, RowContext, tables::ThesisTable};
use strat_onnx::metadata::OutputMeaning;
use strat_splits::Role;
use strat_store::{
    files, npy,
    raster::Plane,
    set::{Count, PreparedSet, Sample},
};

use super::{
    agreement::Agreement,
    findings::{Remark, images_in, remarks},
    fitting::{self, Fitted},
    identity::Identity,
    ownership::{self, MARK, Planned},
    plan::{self, Plan, PlanError, TableChoice},
    prediction::{Prediction, Seen},
    predictions::{MapFault, SavedDescription},
    record::{DataRecord, Failure, ModelRecord, Outcome, ProtocolRecord, RunRecord, TOOL_VERSION},
    sample::{self, SampleError, Scene},
    score::{self, Attention, Predicted, Scored},
    suspicion::{self, FIRST_IMAGES, Look},
    write::{self, WriteError},
};

/// Why maps that were handed over make no row.
#[derive(Debug, thiserror::Error)]
pub enum InMemoryError {
    /// The prepared set cannot be used.
    #[error(transparent)]
    Store(#[from] strat_store::Error),
    /// It cannot serve the protocols.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// What is said about the maps contradicts itself.
    #[error("{0}")]
    Description(String),
    /// What a run cannot do without.
    #[error("{0} is needed")]
    Nothing(&'static str),
    /// A protocol asks for another kind of maps, or for more than maps of the images.
    #[error("{0}")]
    Unfit(String),
    /// No such image.
    #[error("it is none of the {count} test images of {}", set.display())]
    Unknown {
        /// Images that there are.
        count: usize,
        /// The prepared set.
        set: PathBuf,
    },
    /// A map was handed over for this image before.
    #[error("it has a map already, and every image is measured once")]
    Twice,
    /// The map cannot be scored, whatever the protocol.
    #[error(transparent)]
    Map(#[from] MapFault),
    /// Results could not be written.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// It cannot be scored under a protocol.
    #[error(transparent)]
    Score(#[from] SampleError),
    /// What is wrong is wrong with one image.
    #[error("image {image}: {reason}")]
    Image {
        /// Its id.
        image: String,
        /// What is wrong.
        #[source]
        reason: Box<InMemoryError>,
    },
    /// Images are left.
    #[error(
        "{missing} of {count} test images lack rows, such as {first} ({reason}); measure them, or ask for \
         incomplete results"
    )]
    Incomplete {
        /// How many.
        missing: usize,
        /// Of how many.
        count: usize,
        /// The first of them.
        first: String,
        /// What it lacks.
        reason: String,
    },
}

/// Scores one map of any size under protocols: their names with their scores, in the order of the
/// protocols and, within one, of its groups.
///
/// A map without a scale of its own is scored by medians under protocols that do not align. `further`
/// asks for the metrics of PROTOCOL 10.3 as well.
///
/// # Errors
/// The description contradicts itself, the map cannot be what it says, or a protocol lacks something.
pub fn evaluate_map(
    protocols: &[Protocol],
    truth: GroundTruth,
    map: Plane,
    description: &SavedDescription,
    further: bool,
) -> Result<Vec<(String, ImageScore)>, InMemoryError> {
    let protocols = protocols_of("in memory", protocols, description)?.0;
    let map_size = (map.width, map.height);
    let map = description.take(map)?;
    description.check_size(map_size, truth.size())?;
    let contexts: Vec<(Protocol, RowContext)> = protocols
        .into_iter()
        .map(|protocol| (protocol, RowContext::default()))
        .collect();
    let predicted = predicted(map, description, Attention::None);
    let scored = score::score(Scene::given(truth), &contexts, predicted, further);
    let mut named = Vec::new();
    for (scores, (protocol, _)) in scored.scores.into_iter().zip(&contexts) {
        named.extend(
            scores?
                .into_iter()
                .map(|score| (protocol.name.clone(), score)),
        );
    }
    Ok(named)
}

/// The protocols for maps of this kind, with warnings where they become others.
fn protocols_of(
    name: &str,
    protocols: &[Protocol],
    description: &SavedDescription,
) -> Result<(Vec<Protocol>, Vec<String>), InMemoryError> {
    description.check().map_err(InMemoryError::Description)?;
    if protocols.is_empty() {
        return Err(InMemoryError::Nothing("at least one protocol"));
    }
    let Fitted {
        protocols,
        warnings,
        refused,
        ..
    } = fitting::of_maps(name, description, protocols, &[]);
    let mut mirrored = protocols
        .iter()
        .filter_map(|protocol| plan::no_mirrored_images(name, protocol));
    match refused.into_iter().next().or_else(|| mirrored.next()) {
        Some(refusal) => Err(InMemoryError::Unfit(refusal)),
        None => Ok((protocols, warnings)),
    }
}

/// A map that was taken, on its way to the metrics.
fn predicted(map: Plane, description: &SavedDescription, attention: Attention) -> Predicted {
    let meaning = description.meaning_taken();
    let width = map.width as f32;
    Predicted {
        seen: vec![Seen::new(
            description.crop,
            Prediction::new(map, meaning, width),
            None,
        )],
        is_cut: true,
        has_scale: meaning.has_scale(),
        image: None,
        attention,
    }
}

/// The test images of a prepared set, measured map by map in any order and from any thread.
pub struct InMemoryRun {
    name: String,
    description: SavedDescription,
    data: PathBuf,
    set: PreparedSet,
    samples: Vec<Sample>,
    positions: HashMap<String, usize>,
    count: Count,
    tables: Vec<ThesisTable>,
    /// Contexts are made when the maps, which they name, are there.
    protocols: Vec<(Protocol, RowContext)>,
    /// The further metrics are measured.
    further: bool,
    warnings: Vec<String>,
    measured: Mutex<Vec<Option<Measured>>>,
    started: Instant,
}

/// One image.
struct Measured {
    /// BLAKE3 of its map as NumPy would save it.
    blake3: String,
    scored: Scored,
}

impl InMemoryRun {
    /// Opens a prepared set for maps that `description` says the meaning of; `name` is the model's
    /// in tables. Without `protocols`, by name or file, those of the set's own tables are meant.
    /// `further` asks for the metrics of PROTOCOL 10.3 as well.
    ///
    /// # Errors
    /// The set cannot be used or cannot serve the protocols, or the description contradicts itself.
    pub fn open(
        data: &Path,
        name: &str,
        protocols: Option<&[String]>,
        description: SavedDescription,
        further: bool,
    ) -> Result<Self, InMemoryError> {
        if name.is_empty() {
            return Err(InMemoryError::Nothing("a model name that is not empty"));
        }
        let set = PreparedSet::open(data)?;
        let samples = set.samples(Role::Test)?;
        let count = plan::test_count(&set, &samples);
        let content = set.manifest.content;
        let plan = match protocols {
            None => plan::plan(TableChoice::All, &[], content, &samples, count)?,
            Some(names) => {
                let protocols = plan::protocols_named(names, content, &samples)?;
                let names = protocols.iter().map(|protocol| protocol.name.as_str());
                Plan {
                    tables: plan::tables_showing(names),
                    protocols,
                    sections: Vec::new(),
                    left_out: Vec::new(),
                }
            }
        };
        let (protocols, warnings) = protocols_of(name, &plan.protocols, &description)?;
        let positions = samples.iter().map(|sample| sample.id.clone()).zip(0..);
        Ok(Self {
            name: name.to_owned(),
            description,
            data: data.to_owned(),
            positions: positions.collect(),
            count,
            tables: plan.tables,
            protocols: protocols
                .into_iter()
                .map(|protocol| (protocol, RowContext::default()))
                .collect(),
            further,
            warnings,
            measured: Mutex::new(samples.iter().map(|_| None).collect()),
            started: Instant::now(),
            set,
            samples,
        })
    }

    /// The test images, in the order of the set.
    #[must_use]
    pub fn samples(&self) -> &[Sample] {
        &self.samples
    }

    /// The tables that its rows fill.
    #[must_use]
    pub fn tables(&self) -> &[ThesisTable] {
        &self.tables
    }

    /// The protocols that it measures under.
    pub fn protocols(&self) -> impl Iterator<Item = &Protocol> {
        self.protocols.iter().map(|(protocol, _)| protocol)
    }

    /// The image that a model is shown: the untouched one where the set has it.
    ///
    /// # Errors
    /// Its file cannot be read or is not the one that was prepared.
    ///
    /// # Panics
    /// If there are not that many test images.
    pub fn image(&self, index: usize) -> Result<RgbImage, SampleError> {
        sample::load_image(&self.set, &self.samples[index])
    }

    /// Measures the map of one image. With the last of the first images of the set it says what these let
    /// suspect of the description, as sentences.
    ///
    /// # Errors
    /// There is no such image, it was measured before, the map cannot be what its description
    /// says, or no protocol can score it. The run is then as it was.
    pub fn add(&self, image: &str, map: Plane) -> Result<Vec<String>, InMemoryError> {
        self.measure(image, map)
            .map_err(|reason| InMemoryError::Image {
                image: image.to_owned(),
                reason: Box::new(reason),
            })
    }

    fn measure(&self, image: &str, map: Plane) -> Result<Vec<String>, InMemoryError> {
        let index = *(self.positions.get(image)).ok_or_else(|| InMemoryError::Unknown {
            count: self.samples.len(),
            set: self.data.clone(),
        })?;
        if self.measured()[index].is_some() {
            return Err(InMemoryError::Twice);
        }
        let sample = &self.samples[index];
        let map_size = (map.width, map.height);
        let blake3 = files::blake3_hex(&npy::encode(map.width, map.height, &map.data));
        let map = self.description.take(map)?;
        let image_size = (sample.width as usize, sample.height as usize);
        self.description.check_size(map_size, image_size)?;
        let scene = Scene::of_set(&self.set, sample);
        // Maps come in any order: the first ones are those of the set.
        let attention = Attention::of(index < FIRST_IMAGES);
        let predicted = predicted(map, &self.description, attention);
        let mut scored = score::score(scene, &self.protocols, predicted, self.further);
        if scored.scores.iter().all(Result::is_err)
            && let Some(Err(reason)) = scored.scores.pop()
        {
            return Err(reason.into());
        }
        // Another thread may have been faster.
        let mut measured = self.measured();
        if measured[index].is_some() {
            return Err(InMemoryError::Twice);
        }
        measured[index] = Some(Measured { blake3, scored });
        Ok(match index < FIRST_IMAGES {
            true => self.suspicions(&measured),
            false => Vec::new(),
        })
    }

    /// What the first images of the set, or all where there are fewer, let suspect; nothing before each of
    /// them has its map.
    fn suspicions(&self, measured: &[Option<Measured>]) -> Vec<String> {
        let first = measured.iter().take(FIRST_IMAGES);
        let first: Option<Vec<&Measured>> = first.map(Option::as_ref).collect();
        let looks: Vec<Look> = first
            .into_iter()
            .flatten()
            .filter_map(|measured| measured.scored.look.clone())
            .collect();
        suspicion::suspicions(&looks, &self.description.encoding())
            .into_iter()
            .map(|text| format!("{}: {text}", self.name))
            .collect()
    }

    /// Ids of the images without a map, in the order of the set.
    #[must_use]
    pub fn missing(&self) -> Vec<String> {
        let measured = self.measured();
        let left = self.samples.iter().zip(measured.iter());
        left.filter(|(_, measured)| measured.is_none())
            .map(|(sample, _)| sample.id.clone())
            .collect()
    }

    /// What was found so far; images that are missing count as failed.
    #[must_use]
    pub fn outcome(&self) -> Outcome {
        let measured = self.measured();
        let (mut lines, mut images) = (String::new(), Vec::new());
        for (sample, measured) in self.samples.iter().zip(measured.iter()) {
            if let Some(Measured { blake3, .. }) = measured {
                lines += &format!("{} {blake3}\n", sample.id);
                images.push(sample.id.as_str());
            }
        }
        let blake3 = files::blake3_hex(lines.as_bytes());
        let images_digest = files::blake3_hex(images.join("\n").as_bytes());
        let mut model = ModelRecord {
            saved: Some(self.description.clone()),
            identity: Identity::of_maps(&blake3, &self.description, &images_digest),
            note: Some("maps that a program handed over in memory".to_owned()),
            seconds: self.started.elapsed().as_secs_f64(),
            ..ModelRecord::new(&self.name, blake3)
        };
        let (mut rows, mut failures) = (Vec::new(), Vec::new());
        for (index, (protocol, _)) in self.protocols.iter().enumerate() {
            let context = model.context(protocol, &self.set.manifest);
            for (sample, measured) in self.samples.iter().zip(measured.iter()) {
                let Some(Measured { scored, .. }) = measured else {
                    continue;
                };
                let scores = scored.scores.get(index);
                let scores = scores.and_then(|scores| scores.as_ref().ok());
                let scores = scores.into_iter().flatten();
                rows.extend(scores.map(|score| Row::new(&context, sample.id.clone(), *score)));
            }
        }
        let mut agreements = Vec::new();
        for (sample, measured) in self.samples.iter().zip(measured.iter()) {
            let mut fail = |reason: String| {
                failures.push(Failure {
                    model: self.name.clone(),
                    image: sample.id.clone(),
                    reason,
                });
            };
            match measured {
                None => fail("no map was handed over for this image".to_owned()),
                Some(Measured { scored, .. }) => {
                    let errors = scored
                        .scores
                        .iter()
                        .filter_map(|scores| scores.as_ref().err());
                    errors.for_each(|error| fail(error.to_string()));
                    agreements.extend(scored.agreement);
                }
            }
        }
        model.agreement = Agreement::of(&agreements);
        model.images = images_in(&rows);
        let mut warnings = self.warnings.clone();
        let suspicions = self.suspicions(&measured);
        let is_suspected = !suspicions.is_empty();
        warnings.extend(suspicions);
        let gives_depth = self.description.meaning_taken() == OutputMeaning::DepthM;
        for remark in remarks(
            &self.name,
            &rows,
            model.agreement,
            gives_depth,
            is_suspected,
        ) {
            if let Remark::Warning(text) = remark {
                warnings.push(text);
            }
        }
        let record = RunRecord {
            tool: "bench".to_owned(),
            tool_version: TOOL_VERSION.to_owned(),
            arguments: Vec::new(),
            data: DataRecord::new(&self.data, &self.set.manifest, self.count),
            tables: self.tables.iter().map(ToString::to_string).collect(),
            shard: None,
            device: "none".to_owned(),
            runtime: "none".to_owned(),
            runtime_library: None,
            jobs: 1,
            threads: 1,
            models: vec![model],
            protocols: self.protocols().map(ProtocolRecord::new).collect(),
            warnings,
            failures: failures.len(),
            complete: failures.is_empty(),
        };
        Outcome {
            record,
            rows,
            failures,
            agreed: Vec::new(),
        }
    }

    /// Writes the files of a run and returns what it found. A folder with results of something else is
    /// left alone, unless `force` says otherwise; so is every folder if images are missing and the
    /// results need not be `incomplete`.
    ///
    /// # Errors
    /// Images are missing, results would be lost, or a file cannot be written.
    pub fn write(
        &self,
        out: &Path,
        incomplete: bool,
        force: bool,
    ) -> Result<Outcome, InMemoryError> {
        let outcome = self.outcome();
        if !incomplete {
            check_complete(&outcome)?;
        }
        let planned = Planned {
            models: &[],
            named: vec![&self.name],
        };
        let digest = &self.set.manifest.data_digest;
        let earlier = ownership::examine(out, &[&self.data], digest, &planned, force)?;
        if let Some(what) = earlier.and_then(|earlier| ownership::loses(&earlier, &outcome.record))
        {
            return Err(ownership::refuse(out, &what).into());
        }
        MARK.begin(out)?;
        outcome.write(out)?;
        write::derived(&outcome, out, &self.tables, &write::Look::default())?;
        Ok(outcome)
    }

    fn measured(&self) -> MutexGuard<'_, Vec<Option<Measured>>> {
        self.measured.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Makes sure that an outcome has all its images.
///
/// # Errors
/// It has not; the first one is named.
fn check_complete(outcome: &Outcome) -> Result<(), InMemoryError> {
    let mut images: Vec<&str> = Vec::new();
    for failure in &outcome.failures {
        if images.last() != Some(&failure.image.as_str()) {
            images.push(&failure.image);
        }
    }
    match outcome.failures.first() {
        None => Ok(()),
        Some(first) => Err(InMemoryError::Incomplete {
            missing: images.len(),
            count: outcome.record.data.test_images_found as usize,
            first: first.image.clone(),
            reason: first.reason.clone(),
        }),
    }
}
