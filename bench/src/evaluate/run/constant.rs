//! The rows of constant maps: of the set's own training scans, and of those of other sets.

use std::path::Path;

use strat_onnx::metadata::OutputMeaning;
use strat_splits::Role;
use strat_store::{files, set::PreparedSet};

use super::{Predictor, RunError, Subject, TableRun};
use crate::{
    evaluate::{
        NamedFile,
        median::{self, MedianDepth},
        record::ModelRecord,
        request::Request,
        sample::SampleError,
    },
    model::leakage::{self, Leakage, Tested},
};

impl TableRun<'_> {
    /// Measures the constant maps that are asked for.
    pub(super) fn constant_baselines(&mut self) -> Result<(), RunError> {
        let request = self.request;
        if request.median_baseline {
            let made = MedianDepth::of_training(&self.set, request.pool, request.quiet);
            match made {
                Ok(median) => self.constant(median::NAME, &median, median.origin())?,
                Err(error) => self.notes.fail(error.to_string()),
            }
        }
        for NamedFile { name, file } in request.medians_of {
            match self.of_other_set(name, file) {
                Ok((median, origin)) => self.constant(name, &median, origin)?,
                Err(problem) => self.notes.fail(format!("{name}: {problem}")),
            }
        }
        Ok(())
    }

    /// The map of the training scans of another set, and a sentence of what it was made of. Says what of the
    /// test those scans have seen.
    fn of_other_set(&mut self, name: &str, folder: &Path) -> Result<(MedianDepth, String), String> {
        let Request { pool, quiet, .. } = *self.request;
        let other = PreparedSet::open(folder).map_err(|error| error.to_string())?;
        let median = MedianDepth::of_training(&other, pool, quiet);
        let median = median.map_err(|error| format!("{}: {error}", folder.display()))?;
        let trained = other.samples(Role::Train).map_err(SampleError::from);
        let trained = trained.map_err(|error| error.to_string())?;
        let tested = Tested::new(&self.set.manifest, &self.listed);
        match leakage::between((&other.manifest, &trained), &tested) {
            Leakage::None => {}
            found => self.notes.warn(format!(
                "LEAKAGE: {name}: {found}; its figures are no measure of anything new"
            )),
        }
        let manifest = &other.manifest;
        let origin = format!(
            "{} of {} ({}, {}, data {})",
            median.origin(),
            folder.display(),
            manifest.content,
            manifest.source,
            files::digest_prefix(&manifest.data_digest)
        );
        Ok((median, origin))
    }

    /// Measures a constant map.
    fn constant(&mut self, name: &str, median: &MedianDepth, note: String) -> Result<(), RunError> {
        let protocols = self.protocols_for(name, OutputMeaning::DepthM);
        self.measure(Subject {
            record: ModelRecord {
                note: Some(note),
                ..ModelRecord::new(name, median.digest())
            },
            predictor: Predictor::MedianDepth(median),
            protocols,
            writer: None,
        })
    }
}
