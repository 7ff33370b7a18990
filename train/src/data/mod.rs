//! Training pairs from a prepared set: order, decoding, augmentation, batches ahead of time.
//!
//! A thread of its own walks the epochs, decodes and augments the pairs of each batch on
//! `workers` threads, and keeps a few batches ready in a bounded channel. What a batch holds
//! depends on the seed, the epoch and the position only (see [`crate::random`]), so neither
//! the number of threads nor a restart in the middle of an epoch changes it. How long the
//! training step had to wait for batches is measured.
//!
//! A pair whose files cannot be read is replaced by the next one in the epoch's order and
//! named once; training stops when more than one in a hundred pairs are like that.
//!
//! Nothing is downloaded, written or checked against hashes here: `prep verify` does that.

pub mod augment;

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use image::RgbImage;
use rayon::prelude::*;
use strat_splits::Role;
use strat_store::image_files::read_rgb;
use strat_store::resize::{self, Kernel};
use strat_store::set::PreparedSet;

use crate::data::augment::{AugmentConfig, Augmentation};
use crate::error::{Error, Result};
use crate::random::{Draws, Purpose};

/// Batches kept ready; more would only hold memory.
const READY: usize = 3;

/// A rectified stereo pair at the network's input size.
#[derive(Clone, Debug)]
pub struct Pair {
    /// Left view.
    pub left: RgbImage,
    /// Right view, same size.
    pub right: RgbImage,
}

impl Pair {
    /// Brings both views to the network's input size: by area when that is smaller, as the
    /// prepared images themselves were made (PROTOCOL 4.6).
    #[must_use]
    pub fn resized(self, width: u32, height: u32) -> Self {
        let fit = |view: RgbImage| {
            if view.dimensions() == (width, height) {
                view
            } else {
                resize::rgb(&view, width, height, Kernel::Area)
            }
        };
        Self {
            left: fit(self.left),
            right: fit(self.right),
        }
    }
}

enum Entry {
    Files {
        id: String,
        drive: String,
        left: PathBuf,
        right: PathBuf,
    },
    Memory(Arc<Pair>),
}

struct Inner {
    width: u32,
    height: u32,
    entries: Vec<Entry>,
    /// Decoded pairs, when the whole set is small enough to be kept.
    cache: Option<Vec<OnceLock<Arc<Pair>>>>,
    /// Pairs that could not be read, with the reason.
    broken: Mutex<BTreeMap<usize, String>>,
}

/// The pairs of one role, read on demand.
#[derive(Clone)]
pub struct Pairs(Arc<Inner>);

impl Pairs {
    /// The pairs of `role` in a prepared set, to be delivered at `width` x `height`.
    ///
    /// They are kept in memory once decoded if all of them fit into `cache_mib` MiB.
    ///
    /// # Errors
    /// When the role's table cannot be read or has no line.
    pub fn from_set(
        set: &PreparedSet,
        role: Role,
        width: u32,
        height: u32,
        cache_mib: u64,
    ) -> Result<Self> {
        let entries: Vec<Entry> = set
            .samples(role)?
            .into_iter()
            .filter_map(|sample| {
                // A single image has nothing to be compared with.
                let right = set.path(sample.right.as_ref()?);
                Some(Entry::Files {
                    left: set.path(&sample.left),
                    right,
                    drive: sample.drive().to_owned(),
                    id: sample.id,
                })
            })
            .collect();
        if entries.is_empty() {
            return Err(Error::EmptySet {
                root: set.root.clone(),
                role: role.to_string(),
            });
        }
        let bytes = entries.len() as u64 * u64::from(width) * u64::from(height) * 6;
        let cached = bytes <= cache_mib.saturating_mul(1 << 20);
        Ok(Self::new(entries, width, height, cached))
    }

    /// Pairs that are already in memory, e.g. closed-form ones in a test.
    ///
    /// # Errors
    /// When there is none.
    pub fn from_memory(pairs: Vec<Pair>, width: u32, height: u32) -> Result<Self> {
        if pairs.is_empty() {
            return Err(Error::EmptySet {
                root: PathBuf::from("memory"),
                role: Role::Train.to_string(),
            });
        }
        let entries = pairs
            .into_iter()
            .map(|pair| Entry::Memory(Arc::new(pair.resized(width, height))))
            .collect();
        Ok(Self::new(entries, width, height, false))
    }

    fn new(entries: Vec<Entry>, width: u32, height: u32, cached: bool) -> Self {
        let cache = cached.then(|| entries.iter().map(|_| OnceLock::new()).collect());
        Self(Arc::new(Inner {
            width,
            height,
            entries,
            cache,
            broken: Mutex::new(BTreeMap::new()),
        }))
    }

    /// Number of pairs.
    #[must_use]
    pub fn len(&self) -> usize {
        self.0.entries.len()
    }

    /// Drives that the pairs come from, sorted. Pairs in memory have none.
    #[must_use]
    pub fn drives(&self) -> Vec<String> {
        let drives: BTreeSet<&str> = self
            .0
            .entries
            .iter()
            .filter_map(|entry| match entry {
                Entry::Files { drive, .. } => Some(drive.as_str()),
                Entry::Memory(_) => None,
            })
            .collect();
        drives.into_iter().map(str::to_owned).collect()
    }

    /// Never true: an empty set is an error when it is opened.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.0.entries.is_empty()
    }

    /// Whether decoded pairs are kept in memory.
    #[must_use]
    pub fn is_cached(&self) -> bool {
        self.0.cache.is_some()
    }

    /// Pairs found unreadable so far.
    #[must_use]
    pub fn broken(&self) -> usize {
        self.0
            .broken
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .len()
    }

    /// The pair at an index, decoded and at network size.
    ///
    /// # Errors
    /// With a sentence that names the file, when it cannot be read or the views differ in size.
    fn load(&self, index: usize) -> std::result::Result<Arc<Pair>, String> {
        let cell = self.0.cache.as_ref().map(|cache| &cache[index]);
        if let Some(pair) = cell.and_then(OnceLock::get) {
            return Ok(Arc::clone(pair));
        }
        let pair = match &self.0.entries[index] {
            Entry::Memory(pair) => return Ok(Arc::clone(pair)),
            Entry::Files {
                id, left, right, ..
            } => {
                let pair = Pair {
                    left: read_rgb(left).map_err(|error| error.to_string())?,
                    right: read_rgb(right).map_err(|error| error.to_string())?,
                };
                if pair.left.dimensions() != pair.right.dimensions() {
                    let (lw, lh) = pair.left.dimensions();
                    let (rw, rh) = pair.right.dimensions();
                    return Err(format!(
                        "the views of pair {id} differ in size: left {lw}x{lh}, right {rw}x{rh}"
                    ));
                }
                Arc::new(pair.resized(self.0.width, self.0.height))
            }
        };
        if let Some(cell) = cell {
            // Another worker may have been first; both decoded the same bytes.
            let _ = cell.set(Arc::clone(&pair));
        }
        Ok(pair)
    }

    /// The pair at `order[position]`, or the next readable one after it, with its index.
    ///
    /// # Errors
    /// When more than one in a hundred pairs (and more than one) are unreadable.
    fn load_or_next(
        &self,
        order: &[usize],
        position: usize,
        warnings: &Mutex<Vec<String>>,
    ) -> Result<(usize, Arc<Pair>)> {
        let allowed = self.len().div_ceil(100);
        for offset in 0..order.len() {
            let index = order[(position + offset) % order.len()];
            let known = self
                .0
                .broken
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .contains_key(&index);
            if known {
                continue;
            }
            let reason = match self.load(index) {
                Ok(pair) => return Ok((index, pair)),
                Err(reason) => reason,
            };
            let mut broken = self.0.broken.lock().unwrap_or_else(PoisonError::into_inner);
            if broken.insert(index, reason.clone()).is_none() {
                if broken.len() > allowed {
                    return Err(Error::TooManyBroken {
                        broken: broken.len(),
                        pairs: self.len(),
                        last: reason,
                    });
                }
                warnings
                    .lock()
                    .unwrap_or_else(PoisonError::into_inner)
                    .push(format!(
                        "warning: {reason}; another pair takes its place. `prep verify` lists \
                         every damaged file."
                    ));
            }
        }
        Err(Error::TooManyBroken {
            broken: self.len(),
            pairs: self.len(),
            last: "no pair is left".to_owned(),
        })
    }
}

/// A batch of augmented pairs.
#[derive(Clone, Debug)]
pub struct Batch {
    /// Left views, `[samples, 3, height, width]`, RGB in [0, 1].
    pub left: Vec<f32>,
    /// Right views, same layout.
    pub right: Vec<f32>,
    /// Number of pairs.
    pub samples: usize,
    /// Index in the set of each pair.
    pub indices: Vec<usize>,
    /// Sentences about files that could not be read, to be shown once.
    pub warnings: Vec<String>,
}

/// How the set is cut into batches.
#[derive(Clone, Debug)]
pub struct BatchPlan {
    /// Seed of the run.
    pub seed: u64,
    /// Augmentation; `None` leaves the pairs as they are.
    pub augment: Option<AugmentConfig>,
    /// Pairs per batch.
    pub batch: usize,
    /// Batches per optimizer step.
    pub accumulate: usize,
    /// Optimizer steps per epoch.
    pub steps_per_epoch: u64,
    /// Decoding threads; 0 = one per core.
    pub workers: usize,
}

impl BatchPlan {
    /// Steps that one pass over `pairs` pairs holds; what does not fill a step is left out
    /// of the epoch, and a set smaller than one step repeats pairs to fill it.
    #[must_use]
    pub fn steps_per_epoch(pairs: usize, batch: usize, accumulate: usize) -> u64 {
        ((pairs / (batch * accumulate).max(1)) as u64).max(1)
    }

    /// The batches of one optimizer step (0-based over the run).
    fn build(&self, pairs: &Pairs, step: u64, order: &[usize]) -> Result<Vec<Batch>> {
        let epoch = step / self.steps_per_epoch;
        let within = (step % self.steps_per_epoch) as usize;
        (0..self.accumulate)
            .map(|part| {
                let first = (within * self.accumulate + part) * self.batch;
                self.build_one(pairs, epoch, first, order)
            })
            .collect()
    }

    fn build_one(&self, pairs: &Pairs, epoch: u64, first: usize, order: &[usize]) -> Result<Batch> {
        let values = 3 * pairs.0.width as usize * pairs.0.height as usize;
        let mut left = vec![0.0; self.batch * values];
        let mut right = vec![0.0; self.batch * values];
        let warnings = Mutex::new(Vec::new());
        let indices: Vec<usize> = left
            .par_chunks_mut(values)
            .zip(right.par_chunks_mut(values))
            .enumerate()
            .map(|(slot, (left, right))| {
                let (index, pair) = pairs.load_or_next(order, first + slot, &warnings)?;
                let augmentation = match &self.augment {
                    Some(config) => Augmentation::draw(config, self.seed, epoch, index),
                    None => Augmentation::NONE,
                };
                augmentation.apply(&pair.left, &pair.right, left, right);
                Ok(index)
            })
            .collect::<Result<_>>()?;
        Ok(Batch {
            left,
            right,
            samples: self.batch,
            indices,
            warnings: warnings
                .into_inner()
                .unwrap_or_else(PoisonError::into_inner),
        })
    }

    /// Order of the pairs in an epoch.
    fn order(&self, pairs: usize, epoch: u64) -> Vec<usize> {
        Draws::new(self.seed, Purpose::Order, epoch, 0).permutation(pairs)
    }
}

/// Batches of consecutive steps, prepared in the background.
pub struct Loader {
    receiver: Option<Receiver<Result<Vec<Batch>>>>,
    thread: Option<JoinHandle<()>>,
    waited: Duration,
    started: Instant,
}

impl Loader {
    /// Starts preparing the batches of the steps `first_step..end_step`.
    ///
    /// # Errors
    /// When the operating system gives no threads.
    pub fn start(pairs: Pairs, plan: BatchPlan, first_step: u64, end_step: u64) -> Result<Self> {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(plan.workers)
            .thread_name(|index| format!("decode-{index}"))
            .build()
            .map_err(|error| Error::Threads(error.to_string()))?;
        let (sender, receiver) = sync_channel(READY);
        let thread = std::thread::Builder::new()
            .name("batches".to_owned())
            .spawn(move || produce(&pairs, &plan, first_step, end_step, &pool, &sender))
            .map_err(|error| Error::Threads(error.to_string()))?;
        Ok(Self {
            receiver: Some(receiver),
            thread: Some(thread),
            waited: Duration::ZERO,
            started: Instant::now(),
        })
    }

    /// The batches of the next step.
    ///
    /// # Errors
    /// When too many pairs are unreadable, or after the last step.
    pub fn next_step(&mut self) -> Result<Vec<Batch>> {
        let before = Instant::now();
        let batches = self
            .receiver
            .as_ref()
            .and_then(|receiver| receiver.recv().ok())
            .unwrap_or_else(|| {
                Err(Error::Threads(
                    "the thread that prepares batches has ended".to_owned(),
                ))
            });
        self.waited += before.elapsed();
        batches
    }

    /// Share of the time since the start that was spent waiting for batches.
    #[must_use]
    pub fn wait_share(&self) -> f64 {
        let total = self.started.elapsed().as_secs_f64();
        if total > 0.0 {
            self.waited.as_secs_f64() / total
        } else {
            0.0
        }
    }
}

impl Drop for Loader {
    fn drop(&mut self) {
        // Without a receiver the producer's next send fails and its thread ends.
        self.receiver = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn produce(
    pairs: &Pairs,
    plan: &BatchPlan,
    first_step: u64,
    end_step: u64,
    pool: &rayon::ThreadPool,
    sender: &SyncSender<Result<Vec<Batch>>>,
) {
    let mut order = (u64::MAX, Vec::new());
    for step in first_step..end_step {
        let epoch = step / plan.steps_per_epoch;
        if order.0 != epoch {
            order = (epoch, plan.order(pairs.len(), epoch));
        }
        let batches = pool.install(|| plan.build(pairs, step, &order.1));
        let failed = batches.is_err();
        if sender.send(batches).is_err() || failed {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flat_pairs(count: usize) -> Pairs {
        let pairs = (0..count)
            .map(|index| Pair {
                left: RgbImage::from_pixel(8, 4, image::Rgb([index as u8, 0, 0])),
                right: RgbImage::from_pixel(8, 4, image::Rgb([index as u8, 255, 0])),
            })
            .collect();
        Pairs::from_memory(pairs, 8, 4).unwrap()
    }

    fn plan(workers: usize) -> BatchPlan {
        BatchPlan {
            seed: 11,
            augment: Some(AugmentConfig::default()),
            batch: 2,
            accumulate: 2,
            steps_per_epoch: BatchPlan::steps_per_epoch(10, 2, 2),
            workers,
        }
    }

    fn collect(workers: usize, first: u64, end: u64) -> Vec<Vec<Batch>> {
        let mut loader = Loader::start(flat_pairs(10), plan(workers), first, end).unwrap();
        (first..end).map(|_| loader.next_step().unwrap()).collect()
    }

    #[test]
    fn batches_depend_on_neither_threads_nor_the_first_step() {
        let whole = collect(1, 0, 5);
        for (first, workers) in [(0, 4), (3, 2)] {
            let part = collect(workers, first, 5);
            for (a, b) in whole[first as usize..].iter().zip(&part) {
                for (a, b) in a.iter().zip(b) {
                    assert_eq!(a.indices, b.indices);
                    assert_eq!(a.left, b.left);
                    assert_eq!(a.right, b.right);
                }
            }
        }
    }

    #[test]
    fn an_epoch_visits_no_pair_twice_and_epochs_differ() {
        let steps = collect(2, 0, 4);
        let epoch = |range: std::ops::Range<usize>| -> Vec<usize> {
            steps[range]
                .iter()
                .flatten()
                .flat_map(|batch| batch.indices.clone())
                .collect()
        };
        let (first, second) = (epoch(0..2), epoch(2..4));
        assert_eq!(first.len(), 8);
        let mut seen = first.clone();
        seen.sort_unstable();
        seen.dedup();
        assert_eq!(seen.len(), 8);
        assert_ne!(first, second);
    }

    #[test]
    fn a_set_smaller_than_a_step_repeats_its_pairs() {
        assert_eq!(BatchPlan::steps_per_epoch(3, 8, 1), 1);
        let mut plan = plan(1);
        plan.steps_per_epoch = 1;
        let mut loader = Loader::start(flat_pairs(3), plan, 0, 1).unwrap();
        let batches = loader.next_step().unwrap();
        let indices: Vec<usize> = batches.iter().flat_map(|b| b.indices.clone()).collect();
        assert_eq!(indices.len(), 4);
        assert_eq!(indices[0], indices[3]);
        assert!(loader.next_step().is_err());
    }

    fn files_with_broken(count: usize, broken: &[usize]) -> (tempfile::TempDir, Pairs) {
        let folder = tempfile::tempdir().unwrap();
        let entries = (0..count)
            .map(|index| {
                let path = folder.path().join(format!("{index}.png"));
                if broken.contains(&index) {
                    std::fs::write(&path, b"not an image").unwrap();
                } else {
                    RgbImage::from_pixel(16, 8, image::Rgb([index as u8, 1, 2]))
                        .save(&path)
                        .unwrap();
                }
                Entry::Files {
                    drive: String::new(),
                    id: index.to_string(),
                    left: path.clone(),
                    right: path,
                }
            })
            .collect();
        (folder, Pairs::new(entries, 8, 4, true))
    }

    #[test]
    fn a_broken_file_is_named_once_and_replaced() {
        let (_folder, pairs) = files_with_broken(10, &[4]);
        let mut loader = Loader::start(pairs.clone(), plan(2), 0, 8).unwrap();
        let mut warnings = Vec::new();
        for _ in 0..8 {
            for batch in loader.next_step().unwrap() {
                assert!(!batch.indices.contains(&4));
                assert_eq!(batch.left.len(), 2 * 3 * 8 * 4);
                warnings.extend(batch.warnings);
            }
        }
        assert_eq!(warnings.len(), 1, "{warnings:?}");
        assert!(warnings[0].contains("4.png"), "{}", warnings[0]);
        assert_eq!(pairs.broken(), 1);
    }

    #[test]
    fn too_many_broken_files_stop_the_run_with_a_sentence() {
        let (_folder, pairs) = files_with_broken(10, &[1, 2, 3]);
        let mut loader = Loader::start(pairs, plan(2), 0, 8).unwrap();
        let error = (0..8)
            .find_map(|_| loader.next_step().err())
            .expect("three broken pairs of ten are too many");
        assert!(error.to_string().contains("of 10"), "{error}");
    }
}
