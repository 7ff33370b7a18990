//! How the runs of a study went, epoch by epoch: validation, terms, and what the discriminator did.
//!
//! Read are the tables that `train` writes into a run folder: `validation.csv`, `scalars.csv` (a line a
//! step) and, where it is there, `diagnostics.csv`. Lines of one epoch are averaged, then seeds: a curve
//! is the mean over the seeds of a variant, its band one standard deviation to both sides. Unfinished
//! runs take part as far as they got, since they show as well how a variant goes.

use std::{collections::BTreeMap, io::Read as _, path::Path};

use strat_metrics::CsvError;
use strat_store::inputs::{self, Kind};

use super::folder::StudyRun;
use crate::draw::chart::{Chart, Curve, Panel};

/// A column that is drawn: its table, its name, its axis.
struct Column {
    table: &'static str,
    name: &'static str,
    title: &'static str,
    axis: &'static str,
}

const fn column(
    table: &'static str,
    name: &'static str,
    title: &'static str,
    axis: &'static str,
) -> Column {
    Column {
        table,
        name,
        title,
        axis,
    }
}

const VALIDATION: &str = "validation.csv";
const SCALARS: &str = "scalars.csv";
const DIAGNOSTICS: &str = "diagnostics.csv";

/// The charts: name of the file, title, columns.
const CHARTS: [(&str, &str, &[Column]); 4] = [
    (
        "learning",
        "Validation",
        &[
            column(VALIDATION, "abs_rel", "Abs Rel", "Abs Rel, lower is better"),
            column(VALIDATION, "rmse", "RMSE", "RMSE (m), lower is better"),
            column(
                VALIDATION,
                "photometric",
                "Stereo objective",
                "without the adversarial term",
            ),
        ],
    ),
    (
        "training",
        "Training",
        &[
            column(SCALARS, "stereo", "Stereo objective", "loss"),
            column(
                SCALARS,
                "adversarial",
                "Adversarial term",
                "loss of the generator",
            ),
            column(
                SCALARS,
                "baseline_fraction",
                "Baseline",
                "fraction b of the widest",
            ),
        ],
    ),
    (
        "discriminator",
        "Discriminator",
        &[
            column(
                SCALARS,
                "discriminator",
                "Loss",
                "loss of the discriminator",
            ),
            column(
                SCALARS,
                "accuracy_real",
                "Real patches",
                "share called real",
            ),
            column(
                SCALARS,
                "accuracy_synthesised",
                "Synthesised patches",
                "share called synthesised",
            ),
        ],
    ),
    (
        "gradients",
        "Gradients of the weighted terms at the disparities",
        &[
            column(DIAGNOSTICS, "gradient_l1", "L1", "Euclidean norm"),
            column(DIAGNOSTICS, "gradient_ssim", "SSIM", "Euclidean norm"),
            column(
                DIAGNOSTICS,
                "gradient_left_right",
                "Left-right",
                "Euclidean norm",
            ),
            column(
                DIAGNOSTICS,
                "gradient_adversarial",
                "Adversarial",
                "Euclidean norm",
            ),
        ],
    ),
];

/// Means of all columns by epoch.
type Epochs = BTreeMap<u64, BTreeMap<String, f64>>;

/// Mean and, with two seeds or more, deviation over seeds.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Point {
    mean: f64,
    deviation: Option<f64>,
    seeds: usize,
}

/// The curves of all variants, by table and column.
#[derive(Debug, Default)]
pub struct Curves {
    /// Variants in the order of the study.
    variants: Vec<String>,
    /// Points by variant, table, column and epoch.
    points: BTreeMap<(usize, &'static str, String), BTreeMap<u64, Point>>,
    /// A sentence for each table that could not be read.
    pub problems: Vec<String>,
}

impl Curves {
    /// Reads the tables of all runs.
    #[must_use]
    pub fn read(runs: &[StudyRun]) -> Self {
        let mut curves = Self::default();
        for run in runs {
            if !curves.variants.contains(&run.variant) {
                curves.variants.push(run.variant.clone());
            }
        }
        for table in [VALIDATION, SCALARS, DIAGNOSTICS] {
            for (index, variant) in curves.variants.clone().iter().enumerate() {
                let mut seeds: Vec<Epochs> = Vec::new();
                for run in runs.iter().filter(|run| run.variant == *variant) {
                    let path = run.folder.join(table);
                    if !path.is_file() {
                        continue;
                    }
                    match epochs(&path) {
                        Ok(epochs) => seeds.push(epochs),
                        Err(problem) => curves.problems.push(problem),
                    }
                }
                curves.add(index, table, &seeds);
            }
        }
        curves
    }

    fn add(&mut self, variant: usize, table: &'static str, seeds: &[Epochs]) {
        let mut values: BTreeMap<(String, u64), Vec<f64>> = BTreeMap::new();
        for epochs in seeds {
            for (epoch, columns) in epochs {
                for (column, value) in columns {
                    values
                        .entry((column.clone(), *epoch))
                        .or_default()
                        .push(*value);
                }
            }
        }
        for ((column, epoch), values) in values {
            let count = values.len() as f64;
            let mean = values.iter().sum::<f64>() / count;
            let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
            let point = Point {
                mean,
                deviation: (values.len() > 1).then(|| (squares / (count - 1.0)).sqrt()),
                seeds: values.len(),
            };
            let curve = self.points.entry((variant, table, column)).or_default();
            curve.insert(epoch, point);
        }
    }

    /// The charts that have something to show: name of the file and SVG.
    #[must_use]
    pub fn charts(&self) -> Vec<(&'static str, String)> {
        let chart = |(name, title, panels): (&'static str, &'static str, Vec<Panel>)| {
            (name, chart(title, panels))
        };
        self.groups().map(chart).collect()
    }

    /// The same with a chart for each diagram: title of the group, and its SVGs.
    #[must_use]
    pub fn charts_apart(&self) -> Vec<(&'static str, Vec<String>)> {
        let apart = |(_, title, panels): (&'static str, &'static str, Vec<Panel>)| {
            let charts = panels.into_iter().map(|mut panel| {
                let title = std::mem::take(&mut panel.title);
                chart(&title, vec![panel])
            });
            (title, charts.collect())
        };
        self.groups().map(apart).collect()
    }

    /// Name of the file, title and diagrams of the charts that have something to show.
    fn groups(&self) -> impl Iterator<Item = (&'static str, &'static str, Vec<Panel>)> {
        CHARTS.into_iter().filter_map(|(name, title, columns)| {
            let panels = columns.iter().map(|column| self.panel(column));
            let panels: Vec<Panel> = panels.filter(|panel| !panel.curves.is_empty()).collect();
            (!panels.is_empty()).then_some((name, title, panels))
        })
    }

    /// What is drawn at the last epoch of each variant, in the text of a table: the headings, and a line for
    /// each variant, mean ± deviation over seeds.
    #[must_use]
    pub fn last(&self) -> (Vec<&'static str>, Vec<(String, Vec<String>)>) {
        let drawn = CHARTS.iter().flat_map(|(.., columns)| columns.iter());
        let drawn: Vec<&Column> = drawn
            .filter(|column| !self.panel(column).curves.is_empty())
            .collect();
        let last = |variant: usize, column: &Column| {
            let key = (variant, column.table, column.name.to_owned());
            let (_, point) = self.points.get(&key)?.last_key_value()?;
            Some(match point.deviation {
                Some(deviation) => format!("{:.3} ± {deviation:.3}", point.mean),
                None => format!("{:.3}", point.mean),
            })
        };
        let lines = self.variants.iter().enumerate().map(|(index, variant)| {
            let cells = drawn.iter().map(|column| last(index, column));
            let cells = cells.map(|cell| cell.unwrap_or_else(|| "-".to_owned()));
            (variant.clone(), cells.collect())
        });
        let lines = lines.collect();
        (drawn.iter().map(|column| column.title).collect(), lines)
    }

    /// Reads what [`csv`](Self::csv) has written.
    ///
    /// # Errors
    /// It is something else.
    pub fn from_csv(bytes: &[u8]) -> Result<Self, CsvError> {
        #[derive(serde::Deserialize)]
        struct Line {
            variant: String,
            table: String,
            column: String,
            epoch: u64,
            seeds: usize,
            mean: f64,
            deviation: Option<f64>,
        }
        let lines: Vec<Line> = strat_csv::Reader::new(bytes).deserialize()?;
        let mut curves = Self::default();
        for line in lines {
            let known = [VALIDATION, SCALARS, DIAGNOSTICS];
            let is_of = |name: &&str| name.trim_end_matches(".csv") == line.table;
            // What later versions draw besides is not drawn here.
            let Some(table) = known.into_iter().find(is_of) else {
                continue;
            };
            let variants = &mut curves.variants;
            let index = variants.iter().position(|name| *name == line.variant);
            let index = index.unwrap_or_else(|| {
                variants.push(line.variant.clone());
                variants.len() - 1
            });
            let points = curves
                .points
                .entry((index, table, line.column))
                .or_default();
            let point = Point {
                mean: line.mean,
                deviation: line.deviation,
                seeds: line.seeds,
            };
            points.insert(line.epoch, point);
        }
        Ok(curves)
    }

    fn panel(&self, column: &Column) -> Panel {
        let curve = |(index, variant): (usize, &String)| {
            let key = (index, column.table, column.name.to_owned());
            let points = self.points.get(&key)?;
            // What a variant does not have is 0 throughout.
            if points.values().all(|point| point.mean == 0.0) {
                return None;
            }
            let band = |point: &Point| {
                let deviation = point.deviation.unwrap_or(0.0);
                (point.mean - deviation, point.mean + deviation)
            };
            let seeds = points.values().map(|point| point.seeds).max().unwrap_or(0);
            Some(Curve {
                label: format!(
                    "{variant} ({seeds} seed{})",
                    if seeds == 1 { "" } else { "s" }
                ),
                points: points
                    .iter()
                    .map(|(epoch, p)| (*epoch as f64, p.mean))
                    .collect(),
                band: points.values().map(band).collect(),
                style: Some(index),
                ..Curve::default()
            })
        };
        Panel {
            title: column.title.to_owned(),
            x: "epoch".to_owned(),
            y: column.axis.to_owned(),
            curves: self.variants.iter().enumerate().filter_map(curve).collect(),
            ..Panel::default()
        }
    }

    /// All points as CSV with exact numbers, also of columns that are not drawn.
    ///
    /// # Errors
    /// The CSV writer's own; none in practice.
    pub fn csv(&self) -> Result<Vec<u8>, CsvError> {
        let mut csv = strat_csv::Writer::new(Vec::new());
        csv.write_record([
            "variant",
            "table",
            "column",
            "epoch",
            "seeds",
            "mean",
            "deviation",
        ])?;
        for ((variant, table, column), points) in &self.points {
            for (epoch, point) in points {
                csv.write_record([
                    self.variants[*variant].clone(),
                    table.trim_end_matches(".csv").to_owned(),
                    column.clone(),
                    epoch.to_string(),
                    point.seeds.to_string(),
                    point.mean.to_string(),
                    point.deviation.map(|d| d.to_string()).unwrap_or_default(),
                ])?;
            }
        }
        Ok(csv.into_inner()?)
    }

    /// Whether there is any point.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }
}

fn chart(title: &str, panels: Vec<Panel>) -> String {
    Chart {
        title: title.to_owned(),
        note: "mean over the seeds of a variant; band: one standard deviation between seeds"
            .to_owned(),
        panels,
    }
    .svg()
}

/// Means of the columns of a table over the lines of each epoch. A last line that was cut off is no line.
fn epochs(path: &Path) -> Result<Epochs, String> {
    let problem = |error: &dyn std::fmt::Display| format!("{}: {error}", path.display());
    let mut bytes = Vec::new();
    inputs::open(path, Kind::Table)
        .map_err(|error| error.to_string())?
        .read_to_end(&mut bytes)
        .map_err(|error| problem(&error))?;
    let mut reader = strat_csv::Reader::flexible(bytes.as_slice());
    let header = reader.headers().map_err(|error| problem(&error))?;
    let header: Vec<String> = header.iter().map(str::to_owned).collect();
    if header.is_empty() {
        return Ok(Epochs::new());
    }
    let Some(epoch_at) = header.iter().position(|name| name == "epoch") else {
        return Err(problem(&"column `epoch` is missing"));
    };
    let mut sums: BTreeMap<u64, BTreeMap<usize, (f64, f64)>> = BTreeMap::new();
    for line in reader.records() {
        let line = line.map_err(|error| problem(&error))?;
        let epoch = line.get(epoch_at).and_then(|cell| cell.parse::<u64>().ok());
        let Some(epoch) = epoch.filter(|_| line.len() == header.len()) else {
            continue;
        };
        let of_epoch = sums.entry(epoch).or_default();
        for (index, cell) in line.iter().enumerate() {
            let value = cell.parse::<f64>().ok().filter(|value| value.is_finite());
            if let Some(value) = value.filter(|_| index != epoch_at && header[index] != "step") {
                let (sum, count) = of_epoch.entry(index).or_default();
                *sum += value;
                *count += 1.0;
            }
        }
    }
    let means = |columns: BTreeMap<usize, (f64, f64)>| {
        columns
            .into_iter()
            .map(|(index, (sum, count))| (header[index].clone(), sum / count))
            .collect()
    };
    Ok(sums
        .into_iter()
        .map(|(epoch, columns)| (epoch, means(columns)))
        .collect())
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use super::*;

    fn run(root: &Path, variant: &str, seed: u64, validation: &str) -> StudyRun {
        let folder = root.join(format!("{variant}@{seed}"));
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::write(folder.join(VALIDATION), validation).unwrap();
        StudyRun {
            variant: variant.to_owned(),
            seed,
            split: "eigen".to_owned(),
            data: PathBuf::new(),
            folder,
        }
    }

    #[test]
    fn a_point_is_the_mean_over_seeds_and_its_band_their_deviation() {
        let scratch = tempfile::tempdir().unwrap();
        let root = scratch.path();
        let mut runs = vec![
            run(
                root,
                "b",
                1,
                "step,epoch,abs_rel,rmse\n9,1,0.3,\n19,2,0.2,\n",
            ),
            run(
                root,
                "b",
                2,
                "step,epoch,abs_rel,rmse\n9,1,0.5,\n19,2,0.2,\n29,3,0.1",
            ),
            run(
                root,
                "a",
                1,
                "step,epoch,abs_rel,rmse\n9,1,0.4,7\n19,2,0.25,6\n",
            ),
        ];
        let scalars = "step,epoch,adversarial,accuracy_real\n0,1,1,0\n1,1,3,0\n2,2,4,0\n";
        std::fs::write(runs[2].folder.join(SCALARS), scalars).unwrap();
        let curves = Curves::read(&runs);
        assert_eq!(curves.problems, Vec::<String>::new());
        let csv = String::from_utf8(curves.csv().unwrap()).unwrap();
        assert!(
            csv.contains("b,validation,abs_rel,1,2,0.4,0.1414213562373095"),
            "{csv}"
        );
        assert!(csv.contains("a,scalars,adversarial,1,1,2,\n"), "{csv}");
        // A line that was cut off is none, and a gap is no number.
        assert!(!csv.contains("b,validation,abs_rel,3"), "{csv}");
        assert!(!csv.contains("b,validation,rmse"), "{csv}");
        let charts = curves.charts();
        let names: Vec<&str> = charts.iter().map(|(name, _)| *name).collect();
        // No discriminator was right about anything, and there are no diagnostics.
        assert_eq!(names, ["learning", "training"]);
        // A variant has one colour, also where those before it are not drawn.
        assert!(charts[1].1.contains("#d55e00") && !charts[1].1.contains("#0072b2"));
        // What is written is what is read.
        let again = Curves::from_csv(csv.as_bytes()).unwrap();
        assert_eq!(again.charts(), charts);
        assert!(Curves::from_csv(b"variant,epoch\na,1\n").is_err());
        let apart = again.charts_apart();
        assert_eq!(apart[0].0, "Validation");
        assert_eq!(apart[0].1.len(), 2, "Abs Rel, and RMSE of one variant");
        let (heads, lines) = again.last();
        assert_eq!(heads, ["Abs Rel", "RMSE", "Adversarial term"]);
        let cells = |index: usize| lines[index].1.join(", ");
        assert_eq!(
            (lines[0].0.as_str(), cells(0)),
            ("b", "0.200 ± 0.000, -, -".into())
        );
        assert_eq!(
            (lines[1].0.as_str(), cells(1)),
            ("a", "0.250, 6.000, 4.000".into())
        );
        assert!(charts[0].1.contains("b (2 seeds)") && charts[0].1.contains("a (1 seed)"));
        std::fs::write(runs[2].folder.join(VALIDATION), "step,abs_rel\n1,2\n").unwrap();
        runs.truncate(3);
        let problems = Curves::read(&runs).problems;
        assert!(
            problems[0].contains("column `epoch` is missing"),
            "{problems:?}"
        );
    }
}
