//! A run of `bench --table`: models, saved predictions and the constant baseline over one prepared
//! set.
//!
//! Whatever is measured goes the same way: its protocols, the journal of an interrupted run, the
//! evaluation, its record. What cannot be used is named and costs itself only. Not here: the
//! command line, and the files of a finished run ([`super::write`](mod@super::write)).

mod constant;
mod measure;
mod subjects;

use std::{
    collections::BTreeSet,
    path::{Path, PathBuf},
};

use strat_metrics::{Protocol, Row, tables::ThesisTable};
use strat_splits::Role;
use strat_store::{
    set::{Count, PreparedSet, Sample},
    spread,
};

use super::{
    Predictor,
    agreed::Agreed,
    median,
    ownership::{self, MARK, Planned},
    plan,
    predictions::PredictionWriter,
    record::{self, DataRecord, Failure, ModelRecord, Outcome, ProtocolRecord, RunRecord},
    request::{Draw, Finished, Request, RunError},
    shards,
};
use crate::{notes::Notes, runtime::Runtime};

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
