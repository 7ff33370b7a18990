//! What is said about a model: statistics, and words with the effect behind them.

use std::fmt;

use serde::Serialize;
use strat_metrics::{
    cues::{Estimate, Verdict, estimate},
    statistics::Bootstrap,
};

/// One number about one series.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Statistic {
    /// Name of the model.
    pub model: String,
    /// `relative_size`, `occlusion` or `height`.
    pub cue: &'static str,
    /// Which curve or pair of curves.
    pub series: String,
    /// What is stated.
    pub statistic: &'static str,
    /// Its unit; empty for plain numbers.
    pub unit: String,
    /// The number.
    pub value: f64,
    /// Lower bound of its 95 % interval.
    pub low: Option<f64>,
    /// Upper bound.
    pub high: Option<f64>,
    /// Backgrounds.
    pub backgrounds: usize,
}

/// The answer to a question about a model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Word {
    /// What the interval of the effect says.
    pub verdict: Verdict,
    /// The test of this cue is not proved on models with a known answer: its numbers may be cited, the
    /// word alone may not.
    pub cite_numbers: bool,
}

impl fmt::Display for Word {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.verdict.as_str())?;
        if self.cite_numbers {
            f.write_str(" (cite the numbers)")?;
        }
        Ok(())
    }
}

impl Serialize for Word {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// Whether a model uses a cue, for one object and, where sizes are judged apart, one size.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// Name of the model.
    pub model: String,
    /// The cue in words.
    pub cue: &'static str,
    /// The answer.
    pub uses: Word,
    /// The effect that was judged.
    pub effect: Option<f64>,
    /// Lower bound of its 95 % interval.
    pub low: Option<f64>,
    /// Upper bound.
    pub high: Option<f64>,
    /// Effects within this of 0 count as none.
    pub threshold: f64,
    /// Backgrounds.
    pub backgrounds: usize,
    /// The test in words.
    pub test: &'static str,
    /// The sprite.
    pub object: String,
    /// Its height in pixels where each size is judged; none where the effect is over all sizes.
    pub height_px: Option<f64>,
}

/// Everything that is said about all models.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Summary {
    /// One for each model, cue, object and size.
    pub findings: Vec<Finding>,
    /// The numbers behind and beside them.
    pub statistics: Vec<Statistic>,
}

/// A cue and the test of it.
#[derive(Clone, Copy)]
pub(super) struct Cue {
    pub(super) name: &'static str,
    pub(super) threshold: f64,
    pub(super) test: &'static str,
    pub(super) cite_numbers: bool,
}

/// Collects what is said about one model.
pub(super) struct Writer<'a> {
    pub(super) model: &'a str,
    pub(super) experiment: &'static str,
    pub(super) bootstrap: Bootstrap,
    pub(super) out: &'a mut Summary,
}

impl Writer<'_> {
    /// Estimates a statistic over clusters and writes it down where it is defined.
    pub(super) fn add<T>(
        &mut self,
        series: &str,
        statistic: &'static str,
        unit: &str,
        clusters: &[T],
        of: impl Fn(&[&T]) -> Option<f64>,
    ) -> Option<Estimate> {
        let found = estimate(clusters, &self.bootstrap, of)?;
        self.out.statistics.push(Statistic {
            model: self.model.to_owned(),
            cue: self.experiment,
            series: series.to_owned(),
            statistic,
            unit: unit.to_owned(),
            value: found.value,
            low: found.interval.map(|interval| interval.low),
            high: found.interval.map(|interval| interval.high),
            backgrounds: found.clusters,
        });
        Some(found)
    }

    /// Writes down a word about an object, of one height where sizes are judged apart.
    pub(super) fn find(
        &mut self,
        cue: Cue,
        verdict: Verdict,
        effect: Option<Estimate>,
        object: &str,
        height_px: Option<f64>,
    ) {
        let interval = effect.and_then(|effect| effect.interval);
        self.out.findings.push(Finding {
            model: self.model.to_owned(),
            cue: cue.name,
            uses: Word {
                verdict,
                cite_numbers: cue.cite_numbers,
            },
            effect: effect.map(|effect| effect.value),
            low: interval.map(|interval| interval.low),
            high: interval.map(|interval| interval.high),
            threshold: cue.threshold,
            backgrounds: effect.map_or(0, |effect| effect.clusters),
            test: cue.test,
            object: object.to_owned(),
            height_px,
        });
    }
}
