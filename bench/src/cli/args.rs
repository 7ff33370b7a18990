//! Arguments that several subcommands share, and how the crate's types are spelled on the command
//! line.
//!
//! The groups of arguments have plain comments: clap would take documentation for that of the command.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::{Args, ValueEnum, builder::PossibleValue};
use strat_metrics::{
    baselines,
    tables::{FILE_WIDTH, Shown},
};
use strat_store::{
    command::CliError,
    inputs::{self, Kind},
    shell, threads,
};

use crate::{
    evaluate::{
        NamedFile,
        plan::TableChoice,
        write::{Look, Tables},
    },
    notes::Notes,
    quantity::StereoCamera,
    runtime::{
        Device, Runtime, RuntimeChoice, RuntimeError,
        process::{self, Limits},
    },
};

// What runs models; the same for all subcommands that run some.
#[derive(Clone, Copy, Debug, Args)]
pub(super) struct RuntimeArgs {
    /// Where models run: cpu, cuda, cuda:1, tensorrt, coreml or directml (see `bench devices`)
    #[arg(long, default_value_t)]
    pub(super) device: Device,
    /// Inference library; `auto` is ONNX Runtime when it is there, else the embedded one
    #[arg(long, value_enum, default_value_t)]
    pub(super) runtime: RuntimeChoice,
    /// Gigabytes of memory that the process of a model may take; one that takes more is ended
    #[arg(long, value_name = "GB", default_value_t = 8.0, value_parser = positive,
          conflicts_with = "in_process")]
    max_memory: f64,
    /// Seconds that a model may take for an image, and ten times as long for loading; one that takes
    /// more is ended
    #[arg(long, value_name = "S", default_value_t = 60.0, value_parser = positive,
          conflicts_with = "in_process")]
    max_seconds: f64,
    /// Run models within this process and without limits: one that crashes takes the run with it
    #[arg(long)]
    in_process: bool,
    /// No progress and no notes; warnings and errors still show
    #[arg(short, long)]
    pub(super) quiet: bool,
}

impl RuntimeArgs {
    /// The runtime that was asked for; a fallback is said on stderr.
    pub(super) fn resolve(&self) -> Result<Runtime, RuntimeError> {
        let (runtime, notice) = Runtime::resolve(self.runtime, self.device)?;
        if let Some(notice) = notice {
            // Not silenced: it says that another program computes than usual.
            Notes::new(false).note(&notice);
        }
        Ok(runtime.isolated(self.limits()))
    }

    /// What a model may take in a process of its own; `None` where it gets none.
    pub(super) fn limits(&self) -> Option<Limits> {
        let limits = Limits {
            memory_bytes: (self.max_memory * 1e9) as u64,
            seconds: self.max_seconds,
        };
        process::possible(limits).filter(|_| !self.in_process)
    }
}

// How many threads work; the same for all subcommands that do not measure time.
#[derive(Clone, Copy, Debug, Args)]
pub(super) struct ThreadArgs {
    /// Threads beside the model, for decoding, measuring and writing [default: all cores]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    jobs: Option<u16>,
    /// Threads within the model. Another number can change the last bits of its numbers, so the
    /// default is the same on all machines
    #[arg(long, value_name = "N", default_value_t = 2,
          value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: u16,
}

impl ThreadArgs {
    /// The threads beside the model.
    pub(super) fn pool(&self) -> Result<rayon::ThreadPool, strat_store::Error> {
        threads::pool("bench", self.jobs.map_or(0, usize::from))
    }

    /// The number of threads within a model.
    pub(super) fn within_model(&self) -> usize {
        usize::from(self.threads)
    }
}

// Whose results may be replaced; the same for all subcommands that keep what they measured.
#[derive(Clone, Copy, Debug, Args)]
pub(super) struct ReplaceArgs {
    /// Replace results of another run in --out; without it only those are that are made again
    #[arg(long)]
    pub(super) force: bool,
}

// How tables are shown; the same for all subcommands that write some.
#[derive(Clone, Debug, Args)]
pub(super) struct ShowArgs {
    /// Rows of the tables: `all`, `measured`, or names of methods between commas, in that order;
    /// table_*.csv has all of them
    #[arg(
        long,
        value_name = "ROWS",
        default_value = "all",
        conflicts_with = "no_published"
    )]
    show: Shown,
    /// No published rows, the same as --show measured
    #[arg(long)]
    no_published: bool,
    /// Published numbers of your own beside the measured ones: CSV with columns of leaderboard.csv, of
    /// which protocol, method and citation are needed; may be given several times
    #[arg(long = "published", value_name = "FILE.csv")]
    published: Vec<PathBuf>,
    /// Print the tables as JSON
    #[arg(long)]
    json: bool,
}

impl ShowArgs {
    /// What was asked for.
    pub(super) fn look(&self) -> Result<Look, CliError> {
        let mut published = Vec::new();
        for path in &self.published {
            let bytes = inputs::read(path, Kind::Table).map_err(CliError::usage)?;
            let rows = baselines::read(bytes.as_slice());
            published.extend(rows.map_err(|error| {
                CliError::Usage(format!("cannot use {}: {error}", path.display()))
            })?);
        }
        let shown = if self.no_published {
            Shown::Measured
        } else {
            self.show.clone()
        };
        Ok(Look { shown, published })
    }

    /// The tables as they are printed: as JSON, or as text that fits the terminal.
    pub(super) fn printed(&self, tables: &Tables) -> anyhow::Result<String> {
        if self.json {
            let text = serde_json::to_string_pretty(&tables.tables);
            return Ok(text.context("the tables cannot be written as JSON")? + "\n");
        }
        let width = shell::columns().unwrap_or(FILE_WIDTH);
        Ok(tables.joined(|table| table.terminal(width)))
    }
}

// The camera of images that bring none; both numbers or neither.
#[derive(Clone, Copy, Debug, Args)]
pub(super) struct CameraArgs {
    /// Focal length in pixels of the images' own width; depth from disparity needs it, with --baseline-m,
    /// and so do point clouds
    #[arg(long, value_name = "PX", value_parser = positive)]
    focal_px: Option<f64>,
    /// Stereo baseline in metres that the model was trained with (KITTI: 0.54)
    #[arg(long, value_name = "M", requires = "focal_px", value_parser = positive)]
    baseline_m: Option<f64>,
}

impl CameraArgs {
    /// The focal length, also where there is no baseline.
    pub(super) fn focal_px(&self) -> Option<f64> {
        self.focal_px
    }

    /// The camera, where all of it is given.
    pub(super) fn stereo_camera(&self) -> Option<StereoCamera> {
        Some(StereoCamera {
            focal_px: self.focal_px?,
            baseline_m: self.baseline_m?,
        })
    }
}

/// A number above 0.
pub(super) fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() && value > 0.0 => Ok(value),
        _ => Err("a number above 0 is needed".to_owned()),
    }
}

/// Splits `[NAME=]FILE` and finds a name for those without, none of which may be `taken`.
pub(super) fn named_files(
    option: &str,
    texts: &[String],
    taken: &[&str],
) -> Result<Vec<NamedFile>, CliError> {
    let mut given: Vec<NamedFile> = Vec::new();
    for text in texts {
        // A file may have an equals sign in its own name.
        let (name, file) = match text.split_once('=') {
            Some((name, file)) if !Path::new(text).exists() => (Some(name), PathBuf::from(file)),
            _ => (None, PathBuf::from(text)),
        };
        let name = match name {
            Some(name) => name.trim().to_owned(),
            None => default_name(&file),
        };
        if name.is_empty() || file.as_os_str().is_empty() {
            return Err(CliError::Usage(format!(
                "`--{option} {text}` needs a file, and before `=` a name that is not empty"
            )));
        }
        if taken.contains(&name.as_str()) || given.iter().any(|other| other.name == name) {
            return Err(CliError::Usage(format!(
                "two models are called \"{name}\"; name them with `--{option} NAME=FILE`"
            )));
        }
        given.push(NamedFile { name, file });
    }
    Ok(given)
}

/// The file's name, or its folder's where every file is called the same.
pub(super) fn default_name(file: &Path) -> String {
    let text = |part: Option<&std::ffi::OsStr>| {
        part.map(|part| part.to_string_lossy().into_owned())
            .unwrap_or_default()
    };
    let stem = text(file.file_stem());
    let folder = text(file.parent().and_then(Path::file_name));
    if matches!(stem.as_str(), "model" | "predictions") && !folder.is_empty() {
        folder
    } else {
        stem
    }
}

impl ValueEnum for RuntimeChoice {
    fn value_variants<'a>() -> &'a [Self] {
        &[Self::Auto, Self::Ort, Self::Embedded]
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        Some(match self {
            Self::Auto => PossibleValue::new("auto").help(
                "ONNX Runtime when its library is found, else the embedded runtime with a notice",
            ),
            Self::Ort => PossibleValue::new("ort")
                .alias("onnxruntime")
                .help("ONNX Runtime or an error"),
            Self::Embedded => PossibleValue::new("embedded")
                .help("The embedded runtime (CPU only, slower, needs nothing installed)"),
        })
    }
}

impl ValueEnum for TableChoice {
    fn value_variants<'a>() -> &'a [Self] {
        &[
            Self::Table31,
            Self::Table32,
            Self::Table33,
            Self::Make3d,
            Self::Eigen652,
            Self::All,
        ]
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        let (name, help) = match self {
            Self::Table31 => ("3.1", "KITTI split: the seven metrics"),
            Self::Table32 => ("3.2", "KITTI split: errors by semantic group"),
            Self::Table33 => (
                "3.3",
                "Eigen split: the seven metrics with caps of 80 m and 50 m",
            ),
            Self::Make3d => (
                "make3d",
                "Make3D: the numbers beside the pictures of figure 3.6",
            ),
            Self::Eigen652 => (
                "eigen-652",
                "Eigen split, improved ground truth: newer models, with and without a scale",
            ),
            Self::All => (
                "all",
                "The tables of the thesis that the prepared set offers",
            ),
        };
        Some(PossibleValue::new(name).help(help))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_must_be_positive() {
        assert_eq!(positive("0.54"), Ok(0.54));
        for wrong in ["0", "-1", "inf", "NaN", "x"] {
            assert!(positive(wrong).is_err());
        }
    }

    #[test]
    fn models_get_names() {
        let texts = ["runs/a/model.onnx", "b.onnx", "Mine=c.onnx"].map(String::from);
        let names: Vec<String> = named_files("model", &texts, &["Constant"])
            .unwrap()
            .into_iter()
            .map(|given| given.name)
            .collect();
        assert_eq!(names, ["a", "b", "Mine"]);
        for wrong in [
            ["a.onnx", "x/a.onnx"],
            ["=a.onnx", "b.onnx"],
            ["a=", "b.onnx"],
            ["Constant=a.onnx", "b.onnx"],
        ] {
            assert!(named_files("model", &wrong.map(String::from), &["Constant"]).is_err());
        }
    }
}
