//! What is watched while a run goes on: the two ways a disparity can die, and an epoch's means.

use super::report::StepReport;
use crate::loss::Term;

/// Steps in a row with a dead or constant disparity before it is said.
const COLLAPSE_STEPS: u32 = 50;

/// Mean disparity, as a fraction of the width, below which nothing is predicted any more: a
/// KITTI camera sees 80 m at 0.0039, so a whole street at a quarter of that is none.
const DEAD_DISPARITY: f64 = 0.001;

/// Watches the disparity for the two ways it can die.
#[derive(Default)]
pub(super) struct Collapse {
    dead: u32,
    constant: u32,
    said: bool,
}

impl Collapse {
    /// A sentence, once, when the disparity has been dead or constant for a while.
    pub fn watch(&mut self, report: &StepReport) -> Option<String> {
        let count = |counter: &mut u32, condition: bool| {
            *counter = if condition { *counter + 1 } else { 0 };
            *counter >= COLLAPSE_STEPS
        };
        let dead = count(&mut self.dead, report.disparity_mean < DEAD_DISPARITY);
        let constant = count(
            &mut self.constant,
            report.disparity_spread < 0.01 * report.disparity_mean,
        );
        if self.said || !(dead || constant) {
            return None;
        }
        self.said = true;
        Some(if dead {
            format!(
                "warning: the predicted disparity has been next to zero for {COLLAPSE_STEPS} steps: \
                 the relu head is dying and will hardly recover. Start again with a smaller \
                 learning_rate, another seed (--set seed=2) or --set network.head=sigmoid"
            )
        } else {
            format!(
                "warning: the predicted disparity has been constant over the image for \
                 {COLLAPSE_STEPS} steps; if it stays so, start again with a smaller \
                 learning_rate or more data"
            )
        })
    }
}

/// Running means of an epoch, for its line.
#[derive(Default)]
pub(super) struct EpochMeans {
    steps: f64,
    sum: StepReport,
    baseline: f64,
    learning_rate: f64,
}

impl EpochMeans {
    pub fn add(&mut self, report: &StepReport) {
        self.steps += 1.0;
        self.sum.add(report);
        self.baseline += report.baseline;
        self.learning_rate = report.learning_rate;
    }

    pub fn sentence(&self, adversarial: bool) -> String {
        let mean = |sum: f64| sum / self.steps.max(1.0);
        let StepReport { terms, .. } = &self.sum;
        let [real, synthesised] = self.sum.accuracy.map(|sum| 100.0 * mean(sum));
        let (adversary, baseline) = if adversarial {
            (
                format!(
                    ", adversarial {:.3}, discriminator {:.3}, right about {real:.0} % real and \
                     {synthesised:.0} % synthesised",
                    mean(self.sum.adversarial),
                    mean(self.sum.discriminator)
                ),
                format!(", b {:.2}", mean(self.baseline)),
            )
        } else {
            (String::new(), String::new())
        };
        format!(
            "loss {:.4} (ssim {:.4}, l1 {:.4}, left-right {:.4}{adversary}), disparity {:.4}\
             {baseline}, learning rate {:.2e}",
            mean(self.sum.total),
            mean(terms.both(Term::Ssim)),
            mean(terms.both(Term::L1)),
            mean(terms.both(Term::LeftRight)),
            mean(self.sum.disparity_mean),
            self.learning_rate,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_dead_or_constant_disparity_is_said_once() {
        let report = |mean: f64, spread: f64| StepReport {
            disparity_mean: mean,
            disparity_spread: spread,
            ..StepReport::default()
        };
        let sentences = |mean, spread| -> Vec<String> {
            let mut collapse = Collapse::default();
            (0..100)
                .filter_map(|_| collapse.watch(&report(mean, spread)))
                .collect()
        };
        assert_eq!(sentences(0.03, 0.01).len(), 0);
        let dead = sentences(0.0, 0.0);
        assert!(dead.len() == 1 && dead[0].contains("dying"), "{dead:?}");
        let constant = sentences(0.03, 1e-6);
        assert!(constant.len() == 1 && constant[0].contains("constant"));
        // A few bad steps among good ones are no collapse.
        let mut collapse = Collapse::default();
        for step in 0..200 {
            let mean = if step % 20 == 0 { 0.03 } else { 0.0 };
            assert!(collapse.watch(&report(mean, 0.01)).is_none());
        }
    }
}
