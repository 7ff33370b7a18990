//! Batches of augmented pairs, prepared ahead of time.
//!
//! A thread of its own walks the epochs, decodes and augments the pairs of each batch on
//! `workers` threads, and keeps a few batches ready in a bounded channel. What a batch holds
//! depends on the seed, the epoch and the position only (see [`crate::random`]), so neither
//! the number of threads nor a restart in the middle of an epoch changes it. How long the
//! training step had to wait for batches is measured.

use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use burn::tensor::{Device, Tensor, TensorData};
use rayon::prelude::*;
use strat_store::threads;

use super::augment::{AugmentConfig, Augmentation};
use super::pairs::Pairs;
use crate::error::{Error, Result};
use crate::random::{Draws, Purpose};

/// Batches kept ready; more would only hold memory.
const READY: usize = 3;

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

/// Images as the networks take them, `[n, 3, height, width]`, from values in that order.
pub(crate) fn to_tensor(
    values: Vec<f32>,
    [height, width]: [usize; 2],
    device: &Device,
) -> Tensor<4> {
    let samples = values.len() / (3 * height * width);
    Tensor::from_data(TensorData::new(values, [samples, 3, height, width]), device)
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
        let values = pairs.values();
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
        let pool = threads::pool("decode", plan.workers)?;
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
            order = (epoch, plan.order(pairs.count(), epoch));
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
    use crate::data::pairs::tests::flat_pairs;

    fn plan(workers: usize) -> BatchPlan {
        BatchPlan {
            seed: 11,
            augment: Some(AugmentConfig::default()),
            batch: 2,
            accumulate: 2,
            steps_per_epoch: 2,
            workers,
        }
    }

    fn collect(workers: usize, first: u64, end: u64) -> Vec<Vec<Batch>> {
        let (_folder, pairs) = flat_pairs(10, &[]);
        let mut loader = Loader::start(pairs, plan(workers), first, end).unwrap();
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
        let mut plan = plan(1);
        plan.steps_per_epoch = 1;
        let (_folder, pairs) = flat_pairs(3, &[]);
        let mut loader = Loader::start(pairs, plan, 0, 1).unwrap();
        let batches = loader.next_step().unwrap();
        let indices: Vec<usize> = batches.iter().flat_map(|b| b.indices.clone()).collect();
        assert_eq!(indices.len(), 4);
        assert_eq!(indices[0], indices[3]);
        assert!(loader.next_step().is_err());
    }

    #[test]
    fn a_broken_file_is_named_once_and_replaced() {
        let (_folder, pairs) = flat_pairs(10, &[4]);
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
        assert!(warnings[0].contains("4-0.png"), "{}", warnings[0]);
        assert_eq!(pairs.broken(), 1);
    }

    #[test]
    fn too_many_broken_files_stop_the_run_with_a_sentence() {
        let (_folder, pairs) = flat_pairs(10, &[1, 2, 3]);
        let mut loader = Loader::start(pairs, plan(2), 0, 8).unwrap();
        let error = (0..8)
            .find_map(|_| loader.next_step().err())
            .expect("three broken pairs of ten are too many");
        assert!(error.to_string().contains("of 10"), "{error}");
    }
}
