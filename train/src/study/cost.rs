//! What the rest of a study will take, from real steps of every kind of run.

use super::plan::{Study, StudyRun};
use crate::config::{Config, Variant};
use crate::device::DeviceChoice;
use crate::error::Result;
use crate::training::memory::{Measured, measure_apart};

/// Measured steps by kind of run.
#[derive(Debug, Default)]
pub struct Costs(Vec<(String, Measured)>);

impl Costs {
    /// Takes real steps for each kind among the runs, each in a process of its own; `say` is told before.
    ///
    /// # Errors
    /// Steps cannot be taken or measured.
    pub fn measure(
        study: &Study,
        runs: &[&StudyRun],
        device: DeviceChoice,
        say: impl Fn(&str),
    ) -> Result<Self> {
        let mut costs = Self::default();
        for run in runs {
            let kind = kind(&run.config)?;
            if costs.0.iter().any(|(known, _)| *known == kind) {
                continue;
            }
            say(&format!("measuring steps of {}", run.variant));
            let file = &study.file;
            let measured = measure_apart(&file.base, file.preset, &run.settings, device)?;
            costs.0.push((kind, measured));
        }
        Ok(costs)
    }

    /// What a step of a run took.
    ///
    /// # Errors
    /// As [`Config::digest`].
    pub fn of(&self, run: &StudyRun) -> Result<Option<Measured>> {
        let kind = kind(&run.config)?;
        let known = self.0.iter().find(|(known, _)| *known == kind);
        Ok(known.map(|(_, measured)| *measured))
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
}
