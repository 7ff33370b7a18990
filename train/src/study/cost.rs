//! What the rest of a study will take, from real steps and validations of every kind of run.

use std::collections::VecDeque;

use super::plan::{Study, StudyRun};
use super::state::State;
use crate::config::{Config, Variant};
use crate::device::DeviceChoice;
use crate::error::Result;
use crate::training::memory::{Measured, measure_side_by_side};

/// What was measured, by kind of run and set.
#[derive(Debug, Default)]
pub struct Costs(Vec<(Kind, Measured)>);

/// What the rest of a run takes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Cost {
    /// Steps that are left.
    pub steps: u64,
    /// Validations that are left.
    pub validations: u64,
    /// Seconds of both; 0 where nothing was measured.
    pub seconds: f64,
    /// Of them, seconds of validations.
    pub validation_seconds: f64,
    /// Bytes of memory at the peak.
    pub bytes: f64,
}

/// What decides the cost of a step, and which of the sets is validated on.
type Kind = (String, usize);

impl Costs {
    /// Takes real steps for each kind among the runs, as many processes side by side as runs will be; `say` is
    /// told before.
    ///
    /// # Errors
    /// Steps cannot be taken or measured.
    pub fn measure(
        study: &Study,
        runs: &[&StudyRun],
        device: DeviceChoice,
        jobs: usize,
        say: impl Fn(&str),
    ) -> Result<Self> {
        let mut costs = Self::default();
        let jobs = jobs.min(runs.len()).max(1);
        for run in runs {
            let kind = (kind(&run.config)?, run.set);
            if costs.0.iter().any(|(known, _)| *known == kind) {
                continue;
            }
            say(&format!("measuring steps of {}", run.variant));
            let file = &study.file;
            let base = (file.base.as_str(), file.preset);
            let set = &study.set(run).folder;
            let measured = measure_side_by_side(base, &run.settings, device, set, jobs)?;
            costs.0.push((kind, measured));
        }
        Ok(costs)
    }

    /// What the rest of a run takes.
    ///
    /// # Errors
    /// As [`Config::digest`].
    pub fn of(&self, study: &Study, run: &StudyRun, state: &State) -> Result<Cost> {
        let kind = (kind(&run.config)?, run.set);
        let known = self.0.iter().find(|(known, _)| *known == kind);
        let measured = known.map(|(_, measured)| *measured);
        Ok(rest(run, state, study.set(run).validation_pairs, measured))
    }
}

/// The steps and validations that a run has left, and what they take by what was measured.
fn rest(run: &StudyRun, state: &State, held_out: usize, measured: Option<Measured>) -> Cost {
    if !matches!(state, State::NotBegun | State::Begun { .. }) {
        return Cost::default();
    }
    let validation = &run.config.validation;
    let pairs = match validation.images {
        0 => held_out,
        images => images.min(held_out),
    };
    let left = state.steps(run)..run.timeline.end;
    let due = |step: &u64| pairs > 0 && run.timeline.is_due(validation.every, *step);
    let mut cost = Cost {
        steps: left.clone().count() as u64,
        validations: left.filter(due).count() as u64,
        ..Cost::default()
    };
    if let Some(measured) = measured {
        let of_a_pair = measured.validation_seconds.unwrap_or_default();
        cost.validation_seconds = cost.validations as f64 * pairs as f64 * of_a_pair;
        cost.seconds = cost.steps as f64 * measured.step_seconds + cost.validation_seconds;
        cost.bytes = measured.peak_bytes;
    }
    cost
}

/// Seconds until the last of the runs ends, of which at most `jobs` go on at a time and no more than fit into
/// `memory` bytes, each begun as soon as there is room: as [`super::work`] does them.
#[must_use]
pub fn side_by_side(runs: &[Cost], jobs: usize, memory: f64) -> f64 {
    let mut waiting: VecDeque<&Cost> = runs.iter().filter(|run| run.steps > 0).collect();
    // When each ends, and what it takes.
    let mut running: Vec<(f64, f64)> = Vec::new();
    let mut now = 0.0;
    loop {
        for _ in 0..waiting.len() {
            let Some(run) = waiting.pop_front() else {
                break;
            };
            let taken: f64 = running.iter().map(|(_, bytes)| bytes).sum();
            let fits = running.is_empty() || taken + run.bytes <= memory;
            if running.len() < jobs.max(1) && fits {
                running.push((now + run.seconds, run.bytes));
            } else {
                waiting.push_back(run);
            }
        }
        let Some(first) = running.iter().map(|(end, _)| *end).reduce(f64::min) else {
            return now;
        };
        now = first;
        running.retain(|(end, _)| *end > now);
    }
}

/// Names what decides the cost of a step: everything but seeds, lengths, rates and the schedule of the
/// baseline.
fn kind(config: &Config) -> Result<String> {
    let defaults = Config::default();
    let variant = match config.variant.is_adversarial() {
        true => Variant::Strat,
        false => Variant::NoAdv,
    };
    let same = Config {
        variant,
        split: defaults.split,
        seed: defaults.seed,
        epochs: defaults.epochs,
        learning_rate: defaults.learning_rate,
        discriminator_learning_rate: None,
        decay: defaults.decay,
        baseline_start: defaults.baseline_start,
        initial_weights: None,
        augment: defaults.augment,
        ..config.clone()
    };
    same.digest()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::training::schedule::Timeline;

    #[test]
    fn schedules_cost_the_same_and_sizes_do_not() {
        let of = |settings: &[&str]| {
            let settings: Vec<String> = settings.iter().map(|s| (*s).to_owned()).collect();
            kind(&Config::resolve("demo", None, &settings).unwrap()).unwrap()
        };
        let strat = of(&[]);
        assert_eq!(strat, of(&["variant=random", "seed=9", "epochs=2"]));
        assert_ne!(strat, of(&["variant=no-adv"]));
        assert_ne!(strat, of(&["network.width=1/4"]));
        assert_ne!(strat, of(&["batch=8"]));
    }

    /// Four epochs of three steps, validated after every second one and at the end.
    #[test]
    fn what_is_left_is_steps_and_validations() {
        let of = |setting: &str| {
            let settings = ["validation.every=2", setting].map(str::to_owned);
            StudyRun {
                name: "strat@1".to_owned(),
                variant: "strat".to_owned(),
                seed: 1,
                set: 0,
                config: Config::resolve("demo", None, &settings).unwrap(),
                settings: settings.into(),
                timeline: Timeline {
                    steps_per_epoch: 3,
                    epochs: 4,
                    end: 12,
                },
            }
        };
        let run = of("validation.images=5");
        let measured = Measured {
            batch: 4,
            peak_bytes: 7.0,
            step_seconds: 10.0,
            validation_seconds: Some(0.5),
        };
        let all = rest(&run, &State::NotBegun, 20, Some(measured));
        let expected = Cost {
            steps: 12,
            validations: 2,
            seconds: 12.0 * 10.0 + 2.0 * 5.0 * 0.5,
            validation_seconds: 5.0,
            bytes: 7.0,
        };
        assert_eq!(all, expected);
        let begun = State::Begun { step: 7 };
        let left = rest(&run, &begun, 3, Some(measured));
        assert_eq!((left.steps, left.validations), (5, 1));
        assert_eq!(left.seconds, 5.0 * 10.0 + 3.0 * 0.5);
        // All held-out pairs, none, or a run that is over.
        assert_eq!(
            rest(&of("validation.images=0"), &begun, 8, Some(measured)).seconds,
            54.0
        );
        assert_eq!(rest(&run, &begun, 0, Some(measured)).validations, 0);
        assert_eq!(
            rest(&run, &State::Finished, 8, Some(measured)),
            Cost::default()
        );
    }

    #[test]
    fn side_by_side_takes_as_long_as_the_last_to_end() {
        let run = |seconds: f64, bytes: f64| Cost {
            steps: 1,
            seconds,
            bytes,
            ..Cost::default()
        };
        let runs = [run(4.0, 1.0), run(1.0, 1.0), run(2.0, 1.0), run(3.0, 1.0)];
        assert_eq!(side_by_side(&runs, 1, 9.0), 10.0);
        // 4 beside 1, 2 and then 3.
        assert_eq!(side_by_side(&runs, 2, 9.0), 6.0);
        assert_eq!(side_by_side(&runs, 9, 9.0), 4.0);
        // The memory takes two at a time, and one that never fits goes alone.
        assert_eq!(side_by_side(&runs, 9, 2.0), 6.0);
        assert_eq!(side_by_side(&runs, 9, 0.5), 10.0);
        assert_eq!(side_by_side(&[Cost::default()], 2, 9.0), 0.0);
    }
}
