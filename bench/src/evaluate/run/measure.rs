//! One subject of a run: what an interrupted run has left of it, the evaluation of the rest, its record.

use std::{collections::HashMap, time::Instant};

use strat_metrics::{Protocol, Row, RowContext};
use strat_store::{
    command::eprint_line, failures::Failures, progress::Progress, raster::Plane, set::Sample,
    signals::Watch,
};

use super::{RunError, Subject, TableRun};
use crate::evaluate::{
    Comparison, Evaluation, GaveUp, Observer, Task,
    agreed::Agreed,
    agreement::{Agreement, ImageAgreement},
    evaluate,
    findings::{extremes, images_in, remarks},
    journal::{self, Journal, OfImage},
    ownership,
    predictions::PredictionWriter,
    record::{self, Failure, ModelRecord, slug},
    request::Request,
    suspicion::{FIRST_IMAGES, Look},
};

impl TableRun<'_> {
    /// Measures a subject and puts what is found with the rest.
    pub(super) fn measure(&mut self, mut subject: Subject<'_>) -> Result<(), RunError> {
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
