//! The models and the saved predictions of a run, opened and vetted.

use strat_metrics::Protocol;
use strat_onnx::metadata::OutputMeaning;

use super::{RunError, Subject, TableRun};
use crate::{
    evaluate::{
        NamedFile, Predictor,
        fitting::{self, Fitted},
        identity::Identity,
        plan,
        predictions::{PredictionWriter, SavedPredictions},
        record::{ModelRecord, slug},
    },
    model::{Model, leakage::Tested, vet::vet},
    notes::Notes,
    runtime::{Runtime, placement_text},
};

impl TableRun<'_> {
    /// Opens the runtime and measures all models.
    pub(super) fn models(&mut self) -> Result<Option<Runtime>, RunError> {
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

    /// Measures all saved predictions.
    pub(super) fn saved_predictions(&mut self) -> Result<(), RunError> {
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
    pub(super) fn protocols_for(&mut self, name: &str, meaning: OutputMeaning) -> Vec<Protocol> {
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
}
