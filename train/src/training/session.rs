//! The loop of a run: steps, what is written of them, validation, checkpoints, the model at the end.

use std::sync::atomic::Ordering;
use std::time::Instant;

use burn::tensor::Device;
use strat_onnx::metadata::Weights;
use strat_store::progress::Progress;

use super::awake::computing_on;
use super::checkpoint::{Best, Checkpoint, State};
use super::folder::{MODEL, RunFolder, RunInfo};
use super::log::Log;
use super::model::export_model;
use super::options::{Options, Outcome};
use super::schedule::Timeline;
use super::trainer::Trainer;
use super::validation::{Scores, Validation};
use super::watch::{Collapse, EpochMeans};
use crate::config::Config;
use crate::data::loader::{BatchPlan, Loader};
use crate::data::pairs::Pairs;
use crate::error::Result;

/// Everything that stays the same while a run goes on, and its state.
pub(super) struct Session<'a> {
    pub options: &'a Options,
    pub folder: &'a RunFolder,
    pub device: Device,
    pub validation: Option<&'a Validation>,
    pub timeline: Timeline,
    pub state: State,
}

impl Session<'_> {
    pub fn train(mut self, mut trainer: Trainer, pairs: Pairs, info: &RunInfo) -> Result<Outcome> {
        let Self {
            options, timeline, ..
        } = self;
        let config = &options.config;
        let first = self.state.step;
        let per_step = (config.batch * config.accumulate) as u64;
        let plan = BatchPlan {
            seed: config.seed,
            augment: Some(config.augment.clone()),
            batch: config.batch,
            accumulate: config.accumulate,
            steps_per_epoch: timeline.steps_per_epoch,
            workers: config.workers,
        };
        let mut log = Log::open(self.folder, config, timeline, first)?;
        let mut loader = Loader::start(pairs.clone(), plan, first, timeline.end)?;
        let images = (timeline.end - first) * per_step;
        let progress = Progress::new("training", images, "images", options.quiet);
        let started = Instant::now();
        let mut collapse = Collapse::default();
        let mut means = EpochMeans::default();
        let mut scores = None;
        let mut interrupted = false;
        let mut saved = first;

        for step in first..timeline.end {
            let batches = loader.next_step()?;
            for warning in batches.iter().flat_map(|batch| &batch.warnings) {
                progress.println(warning);
            }
            let take = || trainer.step(config, &timeline, step, batches);
            let report = computing_on(options.devices(), take)?;
            log.step(&report)?;
            means.add(&report);
            if let Some(sentence) = collapse.watch(&report) {
                progress.println(&sentence);
            }
            self.state.step = step + 1;
            let epoch = format!("epoch {}/{}", timeline.epoch_number(step), timeline.epochs);
            progress.note(&format!("{epoch}, loss {:.4}", report.total));
            progress.add(per_step);

            if timeline.closes_epoch(step) || timeline.is_last(step) {
                let mut line = format!(
                    "{epoch}: {}",
                    means.sentence(config.variant.is_adversarial())
                );
                means = EpochMeans::default();
                let new = self.validate(&trainer, step, &mut log)?;
                let improved = new.is_some_and(|new| self.note_score(step, &new, &mut line));
                scores = new.or(scores);
                self.draw(&trainer, step, report.baseline, &mut log)?;
                // The bar's own lines are shown even when quiet; this one is no warning.
                if !options.quiet {
                    progress.println(&line);
                }
                if improved || self.timeline.is_due(config.checkpoint.every, step) {
                    self.save(&trainer)?;
                    saved = self.state.step;
                }
            }
            if options.stop.load(Ordering::Relaxed) && !timeline.is_last(step) {
                interrupted = true;
                break;
            }
        }
        progress.finish();
        if saved != self.state.step {
            self.save(&trainer)?;
        }
        let wait_share = loader.wait_share();
        drop(loader);
        let seconds = started.elapsed().as_secs_f64();

        let (model, parity) = if interrupted {
            (None, None)
        } else {
            let path = self.folder.path(MODEL);
            let generator = trainer.generator();
            let parity = export_model(&generator, config, info, &self.state, Weights::F32, &path)?;
            (Some(path), Some(parity))
        };
        Ok(Outcome {
            steps: self.state.step,
            planned: timeline.planned(),
            interrupted,
            model,
            parity,
            scores,
            best: self.state.best,
            broken_pairs: pairs.broken(),
            seconds,
            wait_share,
        })
    }

    fn config(&self) -> &Config {
        &self.options.config
    }

    fn validate(&self, trainer: &Trainer, step: u64, log: &mut Log) -> Result<Option<Scores>> {
        let Some(validation) = self.validation else {
            return Ok(None);
        };
        if !self.timeline.is_due(self.config().validation.every, step) {
            return Ok(None);
        }
        let generator = trainer.generator();
        let score = || validation.score(&generator, self.config(), &self.device);
        let scores = computing_on(self.options.devices(), score)?;
        log.validation(step, &scores)?;
        Ok(Some(scores))
    }

    /// Draws a few validation pairs as the networks see them.
    fn draw(&self, trainer: &Trainer, step: u64, baseline: f64, log: &mut Log) -> Result<()> {
        let Some(validation) = self.validation else {
            return Ok(());
        };
        if !self.timeline.is_due(self.config().pictures.every, step) {
            return Ok(());
        }
        let generator = trainer.generator();
        let discriminator = trainer.discriminator();
        for shown in validation.pictures(
            &generator,
            discriminator.as_ref(),
            baseline,
            self.config(),
            &self.device,
        ) {
            log.pictures(step, &shown)?;
        }
        Ok(())
    }

    /// Adds the score that decides to the epoch's line and remembers it where it is better than
    /// all before; true when it is.
    fn note_score(&mut self, step: u64, scores: &Scores, line: &mut String) -> bool {
        let (name, value) = scores.deciding();
        line.push_str(&format!("; validation {name} {value:.4}"));
        let best = self.state.best.as_ref();
        let better = best.is_none_or(|best| best.score != name || value < best.value);
        if better {
            self.state.best = Some(Best {
                step: self.state.step,
                epoch: self.timeline.epoch_number(step),
                score: name.to_owned(),
                value,
            });
        }
        better
    }

    fn save(&self, trainer: &Trainer) -> Result<()> {
        self.folder.checkpoints.save(&Checkpoint {
            state: self.state.clone(),
            parts: trainer.to_parts()?,
        })?;
        self.folder.checkpoints.prune(
            self.config().checkpoint.keep,
            self.state.best.as_ref().map(|best| best.step),
        )
    }
}
