//! The curves of the trainings that measured models came from: `validation.csv` beside the model's file.
//!
//! Not here: the losses of single steps, which TensorBoard shows.

use std::path::{Path, PathBuf};

use serde::Deserialize;
use strat_store::inputs::{self, Kind};

use super::collect::Collected;
use crate::draw::chart::{Chart, Curve, Panel};

/// What `train` writes at the end of each epoch.
const VALIDATION: &str = "validation.csv";

/// The columns that are drawn.
#[derive(Deserialize)]
struct Line {
    epoch: f64,
    photometric: f64,
    abs_rel: Option<f64>,
}

/// A chart of the validations of all measured models whose run folders are still where they were; none
/// where there is no such folder.
pub(super) fn curves(collected: &Collected) -> Option<String> {
    let runs = collected.data_sets.iter().flat_map(|set| &set.runs);
    // The curves of a study are those of its variants, with their spread.
    let runs = runs.filter(|run| !collected.is_of_study(run));
    let models = runs
        .filter_map(|run| run.record.as_ref())
        .flat_map(|record| &record.models);
    let mut known: Vec<PathBuf> = Vec::new();
    let (mut photometric, mut abs_rel) = (Vec::new(), Vec::new());
    for model in models {
        let Some(path) = model.file.as_deref().and_then(Path::parent) else {
            continue;
        };
        let path = path.join(VALIDATION);
        if known.contains(&path) {
            continue;
        }
        let lines = read(&path);
        known.push(path);
        let curve = |points: Vec<(f64, f64)>| Curve {
            label: model.name.clone(),
            points,
            ..Curve::default()
        };
        if lines.len() < 2 {
            continue;
        }
        photometric.push(curve(
            lines
                .iter()
                .map(|line| (line.epoch, line.photometric))
                .collect(),
        ));
        let depth = lines
            .iter()
            .filter_map(|line| Some((line.epoch, line.abs_rel?)));
        let depth: Vec<(f64, f64)> = depth.collect();
        if depth.len() > 1 {
            abs_rel.push(curve(depth));
        }
    }
    let panel = |title: &str, y: &str, curves: Vec<Curve>| Panel {
        title: title.to_owned(),
        x: "epoch".to_owned(),
        y: y.to_owned(),
        curves,
        ..Panel::default()
    };
    let panels = [
        ("Depth", "Abs Rel, lower is better", abs_rel),
        (
            "Photometric term",
            "mean over validation pairs",
            photometric,
        ),
    ];
    let panels: Vec<Panel> = panels
        .into_iter()
        .filter(|(.., curves)| !curves.is_empty())
        .map(|(title, y, curves)| panel(title, y, curves))
        .collect();
    (!panels.is_empty()).then(|| {
        Chart {
            title: "Validation while the models were trained".to_owned(),
            note: "validation pairs, not the test images of the tables".to_owned(),
            panels,
        }
        .svg()
    })
}

/// The lines of a run; none where it cannot be read: it is another command's file, and the page does not
/// depend on it.
fn read(path: &Path) -> Vec<Line> {
    let Ok(file) = inputs::open(path, Kind::Table) else {
        return Vec::new();
    };
    strat_csv::Reader::new(file)
        .deserialize()
        .unwrap_or_default()
}
