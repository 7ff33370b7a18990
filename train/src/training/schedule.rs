//! What changes while training goes on: steps and epochs, the baseline fraction b, the learning rate.
//!
//! Source: PROTOCOL 4.6 (thesis 3.2.3, the structured adversarial schedule). The baseline
//! fraction `b` (thesis: b/B) says how far the synthesised view that the discriminator
//! judges lies from its source view. Photometric and consistency terms always use the
//! full baseline, because a real image exists only there; nothing here touches them.

use crate::config::{Config, Decay, Variant};
use crate::random::{Draws, Purpose};

/// Steps and epochs of a run. Steps and epochs are counted from 0 unless something else is said.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Timeline {
    /// Optimizer steps of an epoch.
    pub steps_per_epoch: u64,
    /// Epochs of the whole run.
    pub epochs: u64,
    /// Step after which the run stops, at the latest with its last epoch.
    pub end: u64,
}

impl Timeline {
    /// The timeline of a run on so many pairs.
    ///
    /// What does not fill a step is left out of the epoch, and a set smaller than one step
    /// repeats pairs to fill it.
    #[must_use]
    pub fn new(config: &Config, pairs: usize) -> Self {
        let per_step = (config.batch * config.accumulate).max(1);
        let steps_per_epoch = ((pairs / per_step) as u64).max(1);
        let planned = config.epochs * steps_per_epoch;
        Self {
            steps_per_epoch,
            epochs: config.epochs,
            end: config.max_steps.map_or(planned, |limit| limit.min(planned)),
        }
    }

    /// Steps of the whole run, wherever it stops.
    #[must_use]
    pub fn planned(&self) -> u64 {
        self.epochs * self.steps_per_epoch
    }

    /// Epochs done before a step, with their fraction.
    #[must_use]
    pub fn position(&self, step: u64) -> f64 {
        step as f64 / self.steps_per_epoch as f64
    }

    /// Epoch that a step belongs to.
    #[must_use]
    pub fn epoch(&self, step: u64) -> u64 {
        step / self.steps_per_epoch
    }

    /// The same counted from 1, as people and files are told.
    #[must_use]
    pub fn epoch_number(&self, step: u64) -> u64 {
        self.epoch(step) + 1
    }

    /// Whether a step is the last of its epoch.
    #[must_use]
    pub fn closes_epoch(&self, step: u64) -> bool {
        (step + 1).is_multiple_of(self.steps_per_epoch)
    }

    /// Whether a step is the last that is to be taken.
    #[must_use]
    pub fn is_last(&self, step: u64) -> bool {
        step + 1 == self.end
    }

    /// Whether what happens every so many epochs (0: never), and at the end, happens after a step.
    #[must_use]
    pub fn is_due(&self, every: u64, step: u64) -> bool {
        let closes = || self.closes_epoch(step) && self.epoch_number(step).is_multiple_of(every);
        every > 0 && (self.is_last(step) || closes())
    }
}

/// Baseline fraction of the adversarial term in a 0-based epoch:
/// `start + (1 - start) * epoch / epochs`, so it starts at `start` and stays below 1.
#[must_use]
pub fn structured_baseline(epoch: u64, epochs: u64, start: f64) -> f64 {
    start + (1.0 - start) * epoch as f64 / epochs.max(1) as f64
}

/// Baseline fraction of the adversarial term at a step.
#[must_use]
pub fn baseline_fraction(config: &Config, timeline: &Timeline, step: u64) -> f64 {
    match config.variant {
        Variant::Strat => {
            structured_baseline(timeline.epoch(step), timeline.epochs, config.baseline_start)
        }
        Variant::Fixed => 1.0,
        Variant::Random => f64::from(Draws::new(config.seed, Purpose::Baseline, step, 0).unit()),
        Variant::NoAdv => 0.0,
    }
}

/// Learning rate at a position in the run.
///
/// `position` is the number of epochs done, with its fraction (`step / steps_per_epoch`).
#[must_use]
pub fn learning_rate(base: f64, decay: Decay, position: f64, epochs: u64) -> f64 {
    let end = epochs.max(1) as f64;
    match decay {
        Decay::Linear => {
            let half = end / 2.0;
            if position < half {
                base
            } else {
                base * ((end - position) / half).max(0.0)
            }
        }
        Decay::Halve => {
            if position < end * 0.6 {
                base
            } else if position < end * 0.8 {
                base / 2.0
            } else {
                base / 4.0
            }
        }
        Decay::Constant => base,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    #[test]
    fn structured_baseline_equals_the_oracle() {
        // Recipe: make_golden.py train/schedule, `baseline`.
        for (epoch, expected) in [(0, 0.1), (1, 0.118), (25, 0.55), (49, 0.982)] {
            assert_relative_eq!(
                structured_baseline(epoch, 50, 0.1),
                expected,
                epsilon = 1e-15
            );
        }
        for (epoch, expected) in [(0, 0.2), (3, 0.4), (11, 0.933_333_333_333_333_3)] {
            assert_relative_eq!(
                structured_baseline(epoch, 12, 0.2),
                expected,
                epsilon = 1e-15
            );
        }
    }

    #[test]
    fn learning_rate_equals_the_oracle() {
        // Recipe: make_golden.py train/schedule, `learning_rate`.
        for (position, expected) in [
            (0.0, 1e-4),
            (24.99, 1e-4),
            (25.0, 1e-4),
            (37.5, 5e-5),
            (49.0, 4e-6),
            (49.5, 2e-6),
            (50.0, 0.0),
        ] {
            assert_relative_eq!(
                learning_rate(1e-4, Decay::Linear, position, 50),
                expected,
                epsilon = 1e-18
            );
        }
    }

    #[test]
    fn other_decays() {
        for (position, expected) in [(29.9, 1.0), (30.0, 0.5), (39.9, 0.5), (40.0, 0.25)] {
            assert_eq!(learning_rate(1.0, Decay::Halve, position, 50), expected);
        }
        assert_eq!(learning_rate(1.0, Decay::Constant, 50.0, 50), 1.0);
    }

    #[test]
    fn variants_choose_their_baseline() {
        let at = |variant, step| {
            let config = Config {
                variant,
                seed: 3,
                ..Config::default()
            };
            baseline_fraction(&config, &Timeline::new(&config, 80), step)
        };
        assert_eq!(at(Variant::Fixed, 0), 1.0);
        assert_eq!(at(Variant::NoAdv, 100), 0.0);
        // Ten steps an epoch, 50 epochs.
        assert_relative_eq!(at(Variant::Strat, 259), 0.55);
        let drawn: Vec<f64> = (0..500).map(|step| at(Variant::Random, step)).collect();
        assert!(drawn.iter().all(|b| (0.0..1.0).contains(b)));
        let mean = drawn.iter().sum::<f64>() / 500.0;
        assert!((mean - 0.5).abs() < 0.06, "mean {mean}");
        let unit = f64::from(Draws::new(3, Purpose::Baseline, 7, 0).unit());
        assert_eq!(drawn[7], unit);
    }

    #[test]
    fn a_timeline_counts_steps_and_epochs() {
        let config = Config {
            epochs: 3,
            batch: 2,
            accumulate: 2,
            ..Config::default()
        };
        // Eleven pairs fill two steps of four.
        let timeline = Timeline::new(&config, 11);
        assert_eq!(
            (timeline.steps_per_epoch, timeline.planned(), timeline.end),
            (2, 6, 6)
        );
        assert_eq!(
            [0, 1, 2, 5].map(|step| timeline.epoch_number(step)),
            [1, 1, 2, 3]
        );
        assert_eq!(
            [0, 1, 2, 3].map(|step| timeline.closes_epoch(step)),
            [false, true, false, true]
        );
        assert_eq!(timeline.position(3), 1.5);
        assert!(timeline.is_last(5) && !timeline.is_last(4));
        let stopped = Config {
            max_steps: Some(4),
            ..config.clone()
        };
        let timeline = Timeline::new(&stopped, 11);
        assert_eq!((timeline.planned(), timeline.end), (6, 4));
        // A set smaller than one step still makes an epoch.
        assert_eq!(Timeline::new(&config, 3).steps_per_epoch, 1);
    }
}
