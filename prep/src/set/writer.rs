//! Frames on many threads, or a part of them on this machine, and the set that comes of them.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use rayon::prelude::*;
use strat_splits::Role;
use strat_store::progress::Progress;
use strat_store::set::{PreparedSet, Sample};
use strat_store::shard::Shard;
use strat_store::signals::Watch;
use strat_store::{files, threads};

use super::files::SetFiles;
use super::results::{Failure, Results, order};
use super::sample::{BadInput, Frame, SampleError, SampleResult};
use super::settings::{ImageOptions, Settings};
use crate::error::Result;

/// Failures shown one by one on stderr; all are in `failures.csv`.
const FAILURES_SHOWN: u64 = 20;

/// What a user chooses of a set, whatever it is made of.
#[derive(Debug, Clone)]
pub struct SetOptions {
    /// Folder of the set.
    pub out: PathBuf,
    /// Its network-size images.
    pub images: ImageOptions,
    /// Makes only what falls to it, and its part of the tables (see [`super::shards`]).
    pub shard: Option<Shard>,
    /// Threads to use; 0 for one for each core.
    pub threads: usize,
    /// Shows no progress.
    pub quiet: bool,
}

/// What a preparation did.
#[derive(Debug)]
pub struct Report {
    /// The finished set, or part of one.
    pub set: PreparedSet,
    /// What could not be used.
    pub failures: Vec<Failure>,
    /// Files written by this run.
    pub written: u64,
    /// Files an earlier run had written.
    pub kept: u64,
    /// Sentences about inputs that were used and may be mistaken.
    pub doubts: Vec<String>,
    /// Files among the parts of a merged set that are none of theirs; they stay.
    pub foreign: Vec<PathBuf>,
}

/// Makes the frames and writes the set, or the part of it that is asked for. `expected` are the samples
/// it should have; `before` is what is known to be unusable before any frame is tried. `make` notes
/// inputs that a sample can do without.
///
/// # Errors
/// The output cannot be written. Bad inputs are no error: see [`Report::failures`].
pub fn write_set<T: Sync>(
    options: &SetOptions,
    settings: &Settings,
    expected: BTreeMap<Role, u64>,
    frames: &[Frame<T>],
    before: Vec<Failure>,
    make: impl Fn(&SetFiles<'_>, &Frame<T>, &mut Vec<BadInput>) -> SampleResult<Sample> + Sync,
) -> Result<Report> {
    let out: &Path = &options.out;
    files::check_writable(out)?;
    settings.save(out)?;
    if options.shard.is_none() {
        // Parts may be written by other machines, whose locks are not always seen here.
        files::remove_leftovers(out)?;
    }
    let set_files = SetFiles::open(out, settings);
    let mine: Vec<&Frame<T>> = frames
        .iter()
        .filter(|frame| options.shard.is_none_or(|shard| shard.has(&frame.id)))
        .collect();
    let label = format!("prep {}", settings.content);
    let watch = Watch::new("stopping after the frames that are being made");
    let progress = Progress::new(&label, mine.len() as u64, "frames", options.quiet);
    let shown = AtomicU64::new(0);
    let show = |role: &str, id: &str, problem: &str| {
        if shown.fetch_add(1, Ordering::Relaxed) < FAILURES_SHOWN {
            progress.println(format!("{role} {id} skipped: {problem}").trim_start());
        }
    };
    // Of the parts of a set, the first tells of what belongs to no frame.
    let mut failures = match options.shard {
        Some(shard) if shard.index != 0 => Vec::new(),
        _ => before,
    };
    for failure in &failures {
        let role = failure.role.map_or("", Role::as_str);
        show(role, &failure.id, &failure.problem);
    }
    let made: Vec<_> = threads::pool("prep", options.threads)?.install(|| {
        let work = mine.par_iter().map(|frame| {
            watch.check()?;
            let mut bad = Vec::new();
            let sample = match make(&set_files, frame, &mut bad) {
                Ok(sample) => Some(sample),
                Err(SampleError::Input(input)) => {
                    bad.push(input);
                    None
                }
                Err(SampleError::Output(error)) => return Err(error),
            };
            for input in &bad {
                show(frame.role.as_str(), &frame.id, &input.problem);
            }
            progress.add(1);
            Ok((sample, bad))
        });
        work.collect::<Result<_>>()
    })?;
    progress.finish();

    let mut results = Results {
        expected,
        ..Results::default()
    };
    for (frame, (sample, bad)) in mine.iter().zip(made) {
        let of_frame = |input| Failure::of_sample(frame.role, &frame.id, input);
        failures.extend(bad.into_iter().map(of_frame));
        if let Some(sample) = sample {
            results.samples.entry(frame.role).or_default().push(sample);
        }
    }
    results.failures = failures;
    let names = frames.iter().map(|frame| (frame.role, &*frame.id));
    results.sort(&order(names.clone()));
    let set = match options.shard {
        Some(shard) => results.write_part(out, settings, shard, names)?,
        None => results.write(out, settings)?,
    };
    Ok(Report {
        set,
        failures: results.failures,
        written: set_files.written(),
        kept: set_files.kept_files(),
        doubts: set_files.doubts(),
        foreign: Vec::new(),
    })
}
