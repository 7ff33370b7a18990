//! What a run writes down as it goes: three tables and TensorBoard's event files, from the same numbers.

use std::path::Path;

use strat_store::files::{self, Appending};
use strat_store::inputs::{self, Kind};

use super::folder::{DIAGNOSTICS, EVENTS, PICTURES, RunFolder, SCALARS, VALIDATION};
use super::report::{GradientNorms, StepReport};
use super::schedule::Timeline;
use super::tensorboard::EventWriter;
use super::validation::{Pictures, Scores};
use crate::config::Config;
use crate::error::Result;

/// Columns of the metrics of depth, in the order of [`strat_metrics::Metrics::to_array`].
const DEPTH: [&str; 7] = ["abs_rel", "sq_rel", "rmse", "rmse_log", "a1", "a2", "a3"];

/// Columns of a step that the schedules decide; TensorBoard shows them apart from the terms.
const SCHEDULE: [&str; 2] = ["learning_rate", "baseline_fraction"];

/// The tables and event files of a run.
pub(super) struct Log<'a> {
    folder: &'a RunFolder,
    timeline: Timeline,
    scalars: Table,
    validation: Table,
    diagnostics: Table,
    events: EventWriter,
}

impl<'a> Log<'a> {
    /// Opens what is written from the step `first` on; what was written of later steps goes.
    pub fn open(
        folder: &'a RunFolder,
        config: &Config,
        timeline: Timeline,
        first: u64,
    ) -> Result<Self> {
        let scalars = StepReport::default()
            .columns()
            .into_iter()
            .map(|(name, _)| name);
        let scalars: Vec<&str> = ["step", "epoch"].into_iter().chain(scalars).collect();
        let validation = ["step", "epoch", "images", "photometric", "depth_images"];
        let validation: Vec<&str> = validation.into_iter().chain(DEPTH).collect();
        let diagnostics: Vec<String> = GradientNorms::default()
            .columns()
            .map(|(term, _)| format!("gradient_{term}"))
            .collect();
        let diagnostics = diagnostics.iter().map(String::as_str);
        let diagnostics: Vec<&str> = ["step", "epoch"].into_iter().chain(diagnostics).collect();
        // A run that ended within an epoch was validated there; going on, it was not.
        let is_closed = |step| timeline.closes_epoch(step) || timeline.is_last(step);
        let of_epoch = |step| step < first && is_closed(step);
        let mut events = EventWriter::create(&folder.path(EVENTS), first)?;
        events.text(first, "configuration", &config.to_yaml()?)?;
        Ok(Self {
            scalars: Table::open(&folder.path(SCALARS), &scalars, &timeline, |step| {
                step < first
            })?,
            validation: Table::open(&folder.path(VALIDATION), &validation, &timeline, of_epoch)?,
            diagnostics: Table::open(&folder.path(DIAGNOSTICS), &diagnostics, &timeline, of_epoch)?,
            events,
            folder,
            timeline,
        })
    }

    /// Writes the numbers of a step.
    pub fn step(&mut self, report: &StepReport) -> Result<()> {
        let epoch = self.timeline.epoch_number(report.step);
        let columns = report.columns();
        let numbers = columns.iter().map(|(_, value)| value.to_string());
        let cells = [report.step.to_string(), epoch.to_string()];
        self.scalars
            .line(cells.clone().into_iter().chain(numbers))?;
        let grouped = columns.into_iter().map(|(name, value)| {
            let schedule = SCHEDULE.contains(&name);
            (
                format!("{}/{name}", if schedule { "schedule" } else { "train" }),
                value,
            )
        });
        let epoch = ("schedule/epoch".to_owned(), epoch as f64);
        self.events
            .scalars(report.step, std::iter::once(epoch).chain(grouped))?;
        let Some(gradients) = &report.gradients else {
            return Ok(());
        };
        let norms: Vec<(&str, f64)> = gradients.columns().collect();
        let numbers = norms.iter().map(|(_, norm)| norm.to_string());
        self.diagnostics.line(cells.into_iter().chain(numbers))?;
        let tags = norms.into_iter();
        let tags = tags.map(|(term, norm)| (format!("gradients/{term}"), norm));
        self.events.scalars(report.step, tags)
    }

    /// Writes the scores of a validation after a step.
    pub fn validation(&mut self, step: u64, scores: &Scores) -> Result<()> {
        let epoch = self.timeline.epoch_number(step);
        let mut columns = vec![
            ("images", scores.images as f64),
            ("photometric", scores.photometric),
            ("depth_images", scores.depth_images as f64),
        ];
        let depth = scores.depth.map(|metrics| metrics.to_array());
        columns.extend(DEPTH.into_iter().zip(depth.into_iter().flatten()));
        let mut cells = vec![step.to_string(), epoch.to_string()];
        cells.extend(columns.iter().map(|(_, value)| value.to_string()));
        // A line without depth has gaps.
        cells.resize(5 + DEPTH.len(), String::new());
        self.validation.line(cells)?;
        let tags = columns.into_iter();
        let tags = tags.map(|(name, value)| (format!("validation/{name}"), value));
        self.events.scalars(step, tags)
    }

    /// Keeps pictures of validation pairs.
    pub fn pictures(&mut self, step: u64, shown: &Pictures) -> Result<()> {
        let epoch = self.timeline.epoch_number(step);
        shown.write(&self.folder.path(PICTURES), epoch)?;
        for (what, picture) in [
            ("left", Some(&shown.left)),
            ("disparity", Some(&shown.disparity)),
            ("right at b", Some(&shown.synthesised)),
            (
                "discriminator, real and synthesised",
                shown.verdicts.as_ref(),
            ),
        ] {
            if let Some(picture) = picture {
                self.events
                    .picture(step, &format!("{}/{what}", shown.id), picture)?;
            }
        }
        Ok(())
    }
}

/// A CSV file that grows by a line at a time; its first columns are step and epoch.
struct Table(Appending);

impl Table {
    /// Opens a table for appending after those of its lines whose step is to be kept.
    ///
    /// Lines of later steps were written after the checkpoint that is resumed from. Epochs are
    /// written anew: versions before 0.2 counted those of `scalars.csv` from 0. Lines from before
    /// some column was known have gaps in it.
    fn open(
        path: &Path,
        columns: &[&str],
        timeline: &Timeline,
        keep: impl Fn(u64) -> bool,
    ) -> Result<Self> {
        let mut kept = strat_csv::Writer::new(Vec::new());
        kept.write_record(columns)?;
        if path.exists() {
            let mut before = strat_csv::Reader::flexible(inputs::open(path, Kind::Table)?);
            let cells = before.headers()?.len();
            for line in before.records() {
                let line = line?;
                let step = line.get(0).and_then(|cell| cell.parse().ok());
                // A line that was cut off when the run was killed is no line.
                let whole = line.len() == cells && cells <= columns.len();
                if let Some(step) = step.filter(|step| whole && keep(*step)) {
                    let start = [step.to_string(), timeline.epoch_number(step).to_string()];
                    let start = start.iter().map(String::as_str);
                    let gaps = std::iter::repeat_n("", columns.len() - line.len());
                    kept.write_record(start.chain(line.iter().skip(2)).chain(gaps))?;
                }
            }
        }
        let kept = kept.into_inner()?;
        files::write_atomic(path, &kept)?;
        Ok(Self(Appending::open(path)?))
    }

    fn line(&mut self, cells: impl IntoIterator<Item = String>) -> Result<()> {
        let mut line = strat_csv::Writer::new(Vec::new());
        line.write_record(cells)?;
        let line = line.into_inner()?;
        Ok(self.0.add(&line)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;

    #[test]
    fn a_table_keeps_the_lines_before_the_resumed_step() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.csv");
        let config = Config {
            batch: 1,
            ..Config::default()
        };
        let timeline = Timeline::new(&config, 2);
        let open = |keep: fn(u64) -> bool| {
            Table::open(&path, &["step", "epoch", "x"], &timeline, keep).unwrap()
        };
        let cells = |step: u64, x: &str| [step.to_string(), "0".to_owned(), x.to_owned()];
        let mut table = open(|_| true);
        for step in 0..5 {
            table.line(cells(step, "a")).unwrap();
        }
        // A line cut within its step number must not pass for an earlier step.
        let text = std::fs::read_to_string(&path).unwrap() + "1";
        std::fs::write(&path, text).unwrap();
        let mut table = open(|step| step < 3);
        table.line(cells(3, "b, c")).unwrap();
        assert_eq!(
            std::fs::read_to_string(&path).unwrap(),
            "step,epoch,x\n0,1,a\n1,1,a\n2,2,a\n3,0,\"b, c\"\n"
        );
    }
}
