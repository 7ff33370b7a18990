//! A run of `bench --table`: models, saved predictions and the constant baseline over one prepared
//! set.
//!
//! Whatever is measured goes the same way: its protocols, the journal of an interrupted run, the
//! evaluation, its record. What cannot be used is named and costs itself only. Not here: the
//! command line, and the files of a finished run ([`super::write`](mod@super::write)).

mod constant;

use std::{
    collections::{BTreeSet, HashMap},
    path::{Path, PathBuf},
    time::Instant,
};

use strat_metrics::{Protocol, Row, RowContext, tables::ThesisTable};
use strat_onnx::metadata::OutputMeaning;
use strat_splits::Role;
use strat_store::{
    command::eprint_line,
    failures::Failures,
    progress::Progress,
    raster::Plane,
    set::{Count, PreparedSet, Sample},
    signals::Watch,
    spread,
};

use super::{
    Comparison, Evaluation, GaveUp, NamedFile, Observer, Predictor, Task,
    agreed::Agreed,
    agreement::{Agreement, ImageAgreement},
    evaluate,
    findings::{extremes, images_in, remarks},
    fitting::{self, Fitted},
    identity::Identity,
    journal::{self, Journal, OfImage},
    median,
    ownership::{self, MARK, Planned},
    plan,
    predictions::{PredictionWriter, SavedPredictions},
    record::{self, DataRecord, Failure, ModelRecord, Outcome, ProtocolRecord, RunRecord, slug},
    request::{Draw, Finished, Request, RunError},
    shards,
    suspicion::{FIRST_IMAGES, Look},
};
use crate::{
    model::{Model, leakage::Tested, vet::vet},
    notes::Notes,
    runtime::{Runtime, placement_text},
};

/// Measures everything that is asked for.
///
/// # Errors
/// The set, the folder for results or the runtime cannot be used. What concerns one model or one
/// image is part of the outcome.
pub fn run(
    request: &Request<'_>,
    arguments: Vec<String>,
    draw: Draw<'_>,
) -> Result<Finished, RunError> {
    let set = PreparedSet::open(request.data)?;
    let mut samples = set.samples(Role::Test)?;
    let count = plan::test_count(&set, &samples);
    let plan = plan::plan(
        request.table,
        request.protocols,
        set.manifest.content,
        &samples,
        count,
    )?;
    let folder = match request.shard {
        Some(shard) => shard.folder(request.out),
        None => request.out.to_path_buf(),
    };
    let earlier = earlier_run(request, &folder, &set)?;
    MARK.begin(&folder)?;
    if request.shard.is_some() && request.force {
        // An earlier record would call a half-measured part complete.
        MARK.reopen(&folder)?;
    }
    let pictured = spread::evenly(samples.len(), request.pictures)
        .map(|index| samples[index].id.clone())
        .collect();
    let listed = samples.clone();
    if let Some(shard) = request.shard {
        let order: Vec<String> = samples.iter().map(|sample| sample.id.clone()).collect();
        samples.retain(|sample| shard.has(&sample.id));
        shards::begin(&folder, &order, shard)?;
    }
    let mut run = TableRun {
        request,
        draw,
        set,
        listed,
        samples,
        protocols: plan.protocols,
        sections: plan.sections,
        further: request.further || plan.tables.contains(&ThesisTable::Eigen652),
        pictured,
        folder,
        earlier,
        notes: Notes::new(request.quiet),
        journals: Vec::new(),
        used: Vec::new(),
        rows: Vec::new(),
        failures: Vec::new(),
        records: Vec::new(),
        agreed: Vec::new(),
    };
    for sentence in &plan.left_out {
        run.notes.note(sentence);
    }
    if count.found < count.expected {
        run.notes.note(&format!(
            "{} of {} test images are in this set; every table says so",
            count.found, count.expected
        ));
    }
    let runtime = run.models()?;
    run.saved_predictions()?;
    run.constant_baselines()?;
    Ok(run.finish(plan.tables, runtime.as_ref(), count, arguments))
}

/// The run whose results the folder holds; none where they may be replaced by any others.
fn earlier_run(
    request: &Request<'_>,
    folder: &Path,
    set: &PreparedSet,
) -> Result<Option<RunRecord>, strat_store::Error> {
    let given = request.models.iter().chain(request.predictions);
    let mut inputs: Vec<&Path> = given.map(|given| given.file.as_path()).collect();
    inputs.push(request.data);
    inputs.extend(request.medians_of.iter().map(|given| given.file.as_path()));
    let named = request.predictions.iter().chain(request.medians_of);
    let named = named.map(|given| given.name.as_str());
    let planned = Planned {
        models: request.models,
        named: named
            .chain(request.median_baseline.then_some(median::NAME))
            .collect(),
    };
    let digest = &set.manifest.data_digest;
    ownership::examine(folder, &inputs, digest, &planned, request.force)
}

/// Everything a run collects on its way.
struct TableRun<'a> {
    request: &'a Request<'a>,
    draw: Draw<'a>,
    set: PreparedSet,
    /// All test images.
    listed: Vec<Sample>,
    /// Those that are measured here.
    samples: Vec<Sample>,
    protocols: Vec<Protocol>,
    /// Protocols of tables that show a model only where it fits.
    sections: Vec<String>,
    /// The further metrics are measured.
    further: bool,
    /// Images of which a picture is wanted.
    pictured: BTreeSet<String>,
    folder: PathBuf,
    /// The run whose results are there and must not get fewer.
    earlier: Option<RunRecord>,
    notes: Notes,
    journals: Vec<PathBuf>,
    /// All protocols that anything was measured under, in order.
    used: Vec<Protocol>,
    rows: Vec<Row>,
    failures: Vec<Failure>,
    records: Vec<ModelRecord>,
    agreed: Vec<Agreed>,
}

/// What is measured, with all that is known of it beforehand.
struct Subject<'a> {
    predictor: Predictor<'a>,
    record: ModelRecord,
    protocols: Vec<Protocol>,
    writer: Option<PredictionWriter>,
}

impl TableRun<'_> {
    fn models(&mut self) -> Result<Option<Runtime>, RunError> {
        let request = self.request;
        if request.models.is_empty() {
            return Ok(None);
        }
        let (runtime, notice) = Runtime::resolve(request.runtime, request.device)?;
        let runtime = runtime.isolated(request.limits);
        if let Some(notice) = notice {
            // Not silenced: it says that another program computes than usual.
            Notes::new(false).note(&notice);
        }
        self.notes.say(&format!(
            "{} images, {runtime}, device {}",
            self.samples.len(),
            request.device
        ));
        for given in request.models {
            self.model(given, &runtime)?;
        }
        Ok(Some(runtime))
    }

    /// Loads, vets and measures one model.
    fn model(&mut self, given: &NamedFile, runtime: &Runtime) -> Result<(), RunError> {
        let NamedFile { name, file } = given;
        let request = self.request;
        // What it was trained on is held against the whole test, of which a part is measured here.
        let tested = Tested {
            training_source: request.training_source,
            ..Tested::new(&self.set.manifest, &self.listed)
        };
        let opened = Model::open(name, file, runtime, request.device, request.threads)
            .and_then(|mut model| Ok((vet(&mut model, Some(tested))?, model)));
        let (vetting, mut model) = match opened {
            Ok(opened) => opened,
            Err(error) => {
                self.notes.fail(format!("model {name}: {error}"));
                return Ok(());
            }
        };
        for warning in vetting.warnings {
            self.notes.warn(warning);
        }
        for note in &vetting.notes {
            self.notes.note(note);
        }
        if let Some(placement) = placement_text(model.placement()) {
            self.notes.say(&format!(
                "model {name}: {placement}, {} threads",
                request.threads
            ));
        }
        let protocols = self.protocols_for(name, model.description.output.meaning());
        let record = ModelRecord {
            file: Some(file.clone()),
            description: Some(model.description.clone()),
            metadata: model.file.info.metadata().cloned(),
            parameters: Some(model.file.info.parameters),
            runtime: model.runtime().to_owned(),
            provider: model.provider().to_owned(),
            threads: Some(model.threads),
            probe_max_difference: vetting.probe.map(|result| result.max_difference),
            identity: Identity::of_model(&model),
            ..ModelRecord::new(name, model.file.blake3.clone())
        };
        let mut writer = None;
        if request.save_predictions {
            let name = if request.models.len() > 1 {
                format!("predictions-{}.npy", slug(name))
            } else {
                "predictions.npy".to_owned()
            };
            writer = Some(PredictionWriter::create(&self.folder.join(name))?);
        }
        self.measure(Subject {
            predictor: Predictor::Model(&mut model),
            record,
            protocols,
            writer,
        })
    }

    fn saved_predictions(&mut self) -> Result<(), RunError> {
        if self.request.predictions.is_empty() {
            return Ok(());
        }
        let content = self.set.manifest.content;
        for NamedFile { name, file } in self.request.predictions {
            let saved = match SavedPredictions::open(name, file, content, &self.listed) {
                Ok(saved) => saved,
                Err(error) => {
                    self.notes.fail(format!("predictions {name}: {error}"));
                    continue;
                }
            };
            self.notes.note(&format!(
                "predictions {name} do not say what their model was trained on, so leakage cannot be \
                 checked"
            ));
            let sections = &self.sections;
            let description = &saved.description;
            let fitted = fitting::of_maps(name, description, &self.protocols, sections);
            let mut protocols = self.said(fitted);
            protocols.retain(|protocol| {
                let refusal = plan::no_mirrored_images(name, protocol);
                refusal.map(|refusal| self.notes.fail(refusal)).is_none()
            });
            self.measure(Subject {
                record: ModelRecord {
                    file: Some(file.clone()),
                    saved: Some(saved.description.clone()),
                    identity: Identity::of_saved(&saved),
                    ..ModelRecord::new(name, saved.blake3.clone())
                },
                predictor: Predictor::Saved(&saved),
                protocols,
                writer: None,
            })?;
        }
        Ok(())
    }

    /// The protocols of a run as they apply to predictions of this meaning.
    fn protocols_for(&mut self, name: &str, meaning: OutputMeaning) -> Vec<Protocol> {
        let fitted = fitting::of_model(name, meaning, &self.protocols, &self.sections);
        self.said(fitted)
    }

    /// Says what there is to say about the choice of protocols.
    fn said(&mut self, fitted: Fitted) -> Vec<Protocol> {
        for warning in fitted.warnings {
            self.notes.warn(warning);
        }
        for note in fitted.notes {
            self.notes.note(&note);
        }
        for refusal in fitted.refused {
            self.notes.fail(refusal);
        }
        fitted.protocols
    }

    /// Measures a subject and puts what is found with the rest.
    fn measure(&mut self, mut subject: Subject<'_>) -> Result<(), RunError> {
        let gives_depth = subject.predictor.gives_depth();
        let started = Instant::now();
        let evaluation = self.evaluate(&mut subject)?;
        if let Some(writer) = subject.writer {
            writer.finish()?;
        }
        let agreements = evaluation.agreements.iter().map(|(_, one)| *one);
        let agreement = Agreement::of(&agreements.collect::<Vec<_>>());
        let record = ModelRecord {
            agreement,
            images: images_in(&evaluation.rows),
            seconds: started.elapsed().as_secs_f64(),
            ..subject.record
        };
        let name = &record.name;
        for comparison in &evaluation.comparisons {
            (self.draw)(&self.folder, name, comparison)?;
        }
        let mut told = Failures::default();
        for Failure {
            model,
            image,
            reason,
        } in &evaluation.failures
        {
            // One mistake that hits every image is not said once for each of them.
            if let Some(sentence) = told.add(image, reason) {
                eprint_line(format_args!("error: {model}, image {sentence}"));
            }
        }
        for sentence in told.repeated() {
            eprint_line(format_args!("error: {name}: {sentence}"));
        }
        match evaluation.gave_up {
            None => {}
            Some(GaveUp::Failing) => self.notes.fail(format!(
                "{name}: the first {} images all failed, the rest was not tried",
                evaluation.failures.len()
            )),
            Some(GaveUp::Over) => self.notes.fail(format!(
                "{name}: the process that ran it is over, the rest was not tried"
            )),
            Some(GaveUp::Refused) => self.notes.fail(format!(
                "{name} is refused at the first image: its maps are not what its description says"
            )),
        }
        let first_finding = self.notes.warnings.len();
        // What was said after the first images is not said again in other words.
        self.notes.warnings.extend(evaluation.suspicions.clone());
        let is_suspected = !evaluation.suspicions.is_empty();
        for remark in remarks(name, &evaluation.rows, agreement, gives_depth, is_suspected) {
            remark.say(&mut self.notes);
        }
        let mut findings = None;
        if self.request.shard.is_some() {
            findings = Some([first_finding, self.notes.warnings.len()]);
            let mut looks: HashMap<String, Look> = evaluation.looks.into_iter().collect();
            let agreed = evaluation.agreements.into_iter();
            self.agreed.extend(agreed.map(|(image, agreement)| Agreed {
                model: name.clone(),
                look: looks.remove(&image),
                image,
                agreement,
            }));
        }
        self.failures.extend(evaluation.failures);
        self.rows.extend(evaluation.rows);
        self.records.push(ModelRecord { findings, ..record });
        Ok(())
    }

    /// Evaluates everything that an interrupted run has not.
    fn evaluate(&mut self, subject: &mut Subject<'_>) -> Result<Evaluation, RunError> {
        let name = &subject.record.name;
        let earlier = self.earlier.iter().flat_map(|earlier| &earlier.models);
        let before = earlier
            .filter(|model| model.images > 0)
            .find(|model| model.name == *name);
        if let Some(what) = before.and_then(|before| ownership::is_other(before, &subject.record)) {
            return Err(ownership::refuse(&self.folder, &what).into());
        }
        let protocols: Vec<(Protocol, RowContext)> = subject
            .protocols
            .iter()
            .map(|protocol| {
                (
                    protocol.clone(),
                    subject.record.context(protocol, &self.set.manifest),
                )
            })
            .collect();
        for protocol in &subject.protocols {
            if !self.used.iter().any(|known| known.name == protocol.name) {
                self.used.push(protocol.clone());
            }
        }
        let contexts: Vec<RowContext> = protocols.iter().map(|(_, c)| c.clone()).collect();
        let path = self
            .folder
            .join(format!("{}{}.csv", journal::PREFIX, slug(name)));
        let mut facts = subject.record.facts();
        facts.add("bench", record::TOOL_VERSION);
        facts.add("prepared set", &self.set.manifest.data_digest);
        if self.further {
            facts.add("further metrics", "measured");
        }
        for context in &contexts {
            facts.add(
                &format!("protocol {}", context.protocol),
                &context.protocol_digest,
            );
        }
        let (journal, before) = Journal::open(&path, &contexts, &facts)?;
        self.journals.push(path);
        if let Some(changes) = before.changes {
            self.notes.note(&format!(
                "{name}: what the interrupted run has measured is measured again, since it is another \
                 row: {changes}"
            ));
        }
        let mut before = before.images;
        // Rows alone make neither pictures nor saved predictions.
        let saving = subject.writer.is_some();
        before.retain(|image, _| !saving && !self.pictured.contains(image));
        // What is suspected of a model is suspected after the first images of a run.
        for sample in self.samples.iter().take(FIRST_IMAGES) {
            before.remove(&sample.id);
        }
        let left: Vec<Sample> = self
            .samples
            .iter()
            .filter(|sample| !before.contains_key(&sample.id))
            .cloned()
            .collect();
        if !before.is_empty() {
            self.notes.note(&format!(
                "{name}: {} of {} images were measured before the last run was interrupted; going on",
                self.samples.len() - left.len(),
                self.samples.len()
            ));
        }
        let task = Task {
            set: &self.set,
            samples: &left,
            protocols: &protocols,
            pictures: &self.pictured,
            further: self.further,
            whole: saving,
        };
        let Request { pool, quiet, .. } = *self.request;
        let predictor = &mut subject.predictor;
        let watch = Watch::new("stopping after this image");
        let mut recorder = Recorder {
            watch: &watch,
            writer: subject.writer.as_mut(),
            journal,
        };
        let progress = Progress::new(name, left.len() as u64, "images", quiet);
        let mut found = evaluate(&task, name, predictor, pool, &progress, &mut recorder)?;
        progress.finish();
        if !before.is_empty() {
            let order: Vec<&str> = self.samples.iter().map(|s| s.id.as_str()).collect();
            for (image, OfImage { rows, agreement }) in before {
                found.rows.extend(rows);
                found.agreements.extend(agreement.map(|one| (image, one)));
            }
            // Sums depend on the order of what is summed up.
            let positions: HashMap<&str, usize> = order.iter().copied().zip(0..).collect();
            found
                .agreements
                .sort_by_key(|(image, _)| positions.get(image.as_str()).copied());
            let names: Vec<&str> = protocols.iter().map(|(p, _)| p.name.as_str()).collect();
            record::sort_rows(&mut found.rows, &[name], &names, &order);
        }
        let extremes = extremes(&found.rows, self.request.extremes);
        let again: Vec<Sample> = self
            .samples
            .iter()
            .filter(|sample| {
                let drawn = |comparison: &Comparison| comparison.image == sample.id;
                extremes.contains(&sample.id) && !found.comparisons.iter().any(drawn)
            })
            .cloned()
            .collect();
        if !again.is_empty() {
            let task = Task {
                samples: &again,
                pictures: &extremes,
                whole: false,
                ..task
            };
            let progress = Progress::new(name, again.len() as u64, "pictures", quiet);
            let Ok(drawn) = evaluate(&task, name, predictor, pool, &progress, &mut ());
            progress.finish();
            found.comparisons.extend(drawn.comparisons);
        }
        Ok(found)
    }

    fn finish(
        self,
        tables: Vec<ThesisTable>,
        runtime: Option<&Runtime>,
        count: Count,
        arguments: Vec<String>,
    ) -> Finished {
        let request = self.request;
        let record = RunRecord {
            tool: "bench".to_owned(),
            tool_version: record::TOOL_VERSION.to_owned(),
            arguments,
            data: DataRecord::new(request.data, &self.set.manifest, count),
            tables: tables.iter().map(ToString::to_string).collect(),
            shard: request.shard,
            device: request.device.to_string(),
            runtime: runtime.map_or_else(|| "none".to_owned(), ToString::to_string),
            runtime_library: runtime.and_then(Runtime::library).map(Path::to_path_buf),
            jobs: request.pool.current_num_threads(),
            threads: request.threads,
            models: self.records,
            protocols: self.used.iter().map(ProtocolRecord::new).collect(),
            warnings: self.notes.warnings,
            failures: self.failures.len(),
            complete: self.failures.is_empty() && !self.notes.incomplete,
        };
        Finished {
            outcome: Outcome {
                record,
                rows: self.rows,
                failures: self.failures,
                agreed: self.agreed,
            },
            tables,
            folder: self.folder,
            earlier: self.earlier,
            journals: self.journals,
        }
    }
}

/// Puts down what an evaluation finds as soon as it does.
struct Recorder<'a> {
    watch: &'a Watch,
    writer: Option<&'a mut PredictionWriter>,
    journal: Journal,
}

impl Observer for Recorder<'_> {
    type Error = RunError;

    fn predicted(&mut self, image: &str, disparity: Option<&Plane>) -> Result<(), RunError> {
        match &mut self.writer {
            Some(writer) => Ok(writer.push(image, disparity)?),
            None => Ok(()),
        }
    }

    fn scored(&mut self, rows: &[Row], agreement: Option<ImageAgreement>) -> Result<(), RunError> {
        self.journal.add(rows, agreement)?;
        Ok(self.watch.check()?)
    }
}
