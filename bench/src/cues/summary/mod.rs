//! What the rows say: statistics with intervals, and a word per cue, object and size.
//!
//! Curves are means over backgrounds; intervals come from drawing whole backgrounds (seeded), so
//! they tell how far another choice of pictures would have moved a number. A word judges one
//! effect that is 0 for a model which ignores the cue, by its whole interval
//! ([`strat_metrics::cues::judge`]); the test is stated beside the word.

mod finding;
mod height;
mod occlusion;
mod series;
mod size;
#[cfg(test)]
mod tests;
mod text;

pub use finding::{Finding, Statistic, Summary, Word};
pub use height::PSEUDO_ANGLE_END;
pub use occlusion::LEAST_STEP;
pub(super) use occlusion::relative_step;
pub(crate) use series::distinct;
pub(super) use series::series;
pub use text::Line;

use strat_metrics::statistics::Bootstrap;

use super::rows::{CueRow, Experiment};
use finding::Writer;

/// Statistics and words about all models in the rows.
#[must_use]
pub fn summarise(rows: &[CueRow], bootstrap: &Bootstrap) -> Summary {
    let mut summary = Summary::default();
    for model in distinct(rows.iter().map(|row| row.model.as_str())) {
        let of = |wanted: &[Experiment]| -> Vec<&CueRow> {
            rows.iter()
                .filter(|row| row.model == model && wanted.contains(&row.experiment))
                .collect()
        };
        let mut writer = Writer {
            model,
            experiment: "relative_size",
            bootstrap: *bootstrap,
            out: &mut summary,
        };
        let sizes = of(&[Experiment::Size, Experiment::SizePair]);
        if !sizes.is_empty() {
            size::relative_size(&mut writer, &sizes);
        }
        writer.experiment = "occlusion";
        let pairs = of(&[Experiment::Occlusion]);
        if !pairs.is_empty() {
            occlusion::occlusion(&mut writer, &pairs);
        }
        writer.experiment = "height";
        let heights = of(&[Experiment::Height]);
        if !heights.is_empty() {
            height::visual_height(&mut writer, &heights);
        }
    }
    summary
}
