//! One run of the experiments: models one after the other, what they leave behind, and the files.

use std::{
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use serde::{Deserialize, Serialize};
use strat_metrics::statistics::Bootstrap;
use strat_store::{
    claim::{Found, Mark},
    files, human,
    progress::Progress,
    set::{Content, PreparedSet},
    signals::Watch,
    yaml,
};

use super::{
    backgrounds::{Background, horizon_row},
    curves::{self, Figure},
    error::CueError,
    experiments::{Cast, Job},
    journal::Journal,
    measure::{self, Composites, Failure, Outcome},
    rows::{self, CueRow},
    sheets,
    summary::{self, Summary, distinct},
};
use crate::{
    draw::png::png,
    evaluate::{
        NamedFile,
        identity::Identity,
        ownership::{self, Planned},
        record::{TOOL_VERSION, slug},
    },
    model::{Description, Model},
};

/// File names of a run beside the rows.
const RECORD: &str = "cues.yaml";
/// Composites without a row.
pub const FAILURES: &str = "failures.csv";
const WORDS: &str = "summary.csv";
const STATISTICS: &str = "statistics.csv";
const MARKDOWN: &str = "summary.md";
const FIGURES: &str = "figures";

/// Whose a folder of experiments is.
pub const MARK: Mark = Mark {
    command: "bench cues",
    record: RECORD,
    begins: "tool: bench cues\n",
    writes: |name| [rows::ROWS, RECORD].contains(&name) || is_drawn(name),
};

/// Whether a name in the folder is of what is made of the rows.
fn is_drawn(name: &str) -> bool {
    [FAILURES, WORDS, STATISTICS, MARKDOWN, FIGURES].contains(&name)
}

/// PNG pixels for each unit of the SVG.
const CHART_ZOOM: f32 = 2.0;
const SHEET_ZOOM: f32 = 1.0;

/// Everything that is the same for all models of a run.
pub struct CueRun<'a> {
    /// The prepared set.
    pub set: &'a PreparedSet,
    /// The sprites.
    pub cast: Cast,
    /// The pictures they are pasted into.
    pub backgrounds: Vec<Background>,
    /// The composites.
    pub jobs: Vec<Job>,
    /// Number of sizes of the size experiment.
    pub scales: u32,
    /// Threads beside the model.
    pub pool: &'a rayon::ThreadPool,
    /// Where results are written.
    pub out: &'a Path,
    /// No progress.
    pub quiet: bool,
}

/// What ran; written beside the rows.
#[derive(Serialize)]
struct Record<'a> {
    tool: &'static str,
    tool_version: &'static str,
    arguments: &'a [String],
    data: &'a Path,
    #[serde(flatten)]
    settings: Settings<'a>,
    jobs: usize,
    models: &'a [ModelRecord],
}

/// What makes two runs of one model the same.
#[derive(Serialize)]
struct Settings<'a> {
    data_digest: &'a str,
    content: Content,
    source: String,
    backgrounds: Vec<BackgroundRecord<'a>>,
    sprites: Vec<SpriteRecord<'a>>,
    composites: usize,
}

#[derive(Serialize)]
struct BackgroundRecord<'a> {
    id: &'a str,
    horizon_row: f64,
    /// Share of humans and vehicles where sprites go, where the set has labels.
    occupied: Option<f64>,
}

#[derive(Serialize)]
struct SpriteRecord<'a> {
    name: &'a str,
    height_m: f64,
    blake3: &'a str,
}

/// What the record of an earlier run says of its rows.
#[derive(Debug, Deserialize)]
pub struct Earlier {
    #[serde(default)]
    models: Vec<EarlierModel>,
}

#[derive(Debug, Deserialize)]
struct EarlierModel {
    name: String,
    rows: usize,
    #[serde(default)]
    description: serde_yaml::Value,
}

impl Earlier {
    /// What would be lost if these models replaced it.
    #[must_use]
    pub fn lacks(&self, now: &[ModelRecord]) -> Option<String> {
        self.models.iter().find_map(|before| {
            let name = &before.name;
            let now = now.iter().find(|now| now.name == *name);
            let description = now.and_then(|now| yaml::to_string(&now.description).ok());
            let description: Option<serde_yaml::Value> =
                description.and_then(|text| serde_yaml::from_str(&text).ok());
            if before.rows > 0 && description.is_some_and(|now| before.description != now) {
                return Some(format!("rows under another description of {name}"));
            }
            let rows = now.map_or(0, |now| now.rows);
            (rows < before.rows).then(|| {
                format!(
                    "{} rows of {name}, of which only {rows} could be measured now",
                    before.rows
                )
            })
        })
    }
}

/// A model and how it went.
#[derive(Debug, Serialize)]
pub struct ModelRecord {
    name: String,
    file: PathBuf,
    blake3: String,
    description: Description,
    runtime: String,
    provider: String,
    device: String,
    rows: usize,
    failures: usize,
    seconds: f64,
    /// Share of that time in which the model did not run.
    overhead: f64,
    /// What was warned about, such as a training on the backgrounds' drives.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    warnings: Vec<String>,
}

/// A failure as a line of [`FAILURES`].
#[derive(Debug, Serialize)]
pub struct FailureRow {
    model: String,
    background: String,
    reason: String,
}

/// What one model has answered.
pub struct Answers {
    /// Its rows, failures and times.
    pub outcome: Outcome,
    /// For the record of the run.
    pub record: ModelRecord,
    /// Removed once the rows are in the results.
    pub journal: Journal,
}

/// What is known of a model besides its file.
pub struct Subject<'a> {
    /// The model.
    pub model: &'a mut Model,
    /// Its file.
    pub file: &'a Path,
    /// Where it runs.
    pub device: String,
    /// What was warned about.
    pub warnings: Vec<String>,
}

impl CueRun<'_> {
    /// Claims the folder before any work; what it has of an earlier run, which is lost only with
    /// `force`.
    ///
    /// # Errors
    /// It holds other things or another run, or one of `inputs` is in the way.
    pub fn claim(
        &self,
        models: &[NamedFile],
        inputs: &[&Path],
        force: bool,
    ) -> Result<Option<Earlier>, CueError> {
        let planned = Planned {
            models,
            named: Vec::new(),
        };
        let found =
            ownership::examine_record(&MARK, self.out, inputs, &self.settings(), &planned, force)?;
        MARK.begin(self.out)?;
        Ok(match found {
            Found::Record if !force => Some(yaml::load(&self.out.join(RECORD))?),
            _ => None,
        })
    }

    /// Number of composites.
    #[must_use]
    pub fn composites(&self) -> usize {
        self.jobs.iter().map(|job| job.composites.len()).sum()
    }

    /// What there is to know about the backgrounds.
    #[must_use]
    pub fn notes(&self, horizon_is_given: bool) -> Vec<String> {
        let mut notes = Vec::new();
        let content = self.set.manifest.content;
        let is_known = |background: &Background| {
            horizon_row(content, background.ground.width, background.ground.height).1
        };
        if !horizon_is_given && !self.backgrounds.iter().all(is_known) {
            notes.push(
                "the cameras' horizon is not known for this collection and taken for the middle row; \
                 give --horizon-row"
                    .to_owned(),
            );
        }
        let mut shares = self
            .backgrounds
            .iter()
            .map(|background| background.occupied);
        let worst = shares.try_fold(0.0_f64, |worst, share| Some(worst.max(share?)));
        match worst {
            None => notes.push(
                "the set has no labels, so backgrounds are not checked for cars and people in the \
                 path; choose them with --frames"
                    .to_owned(),
            ),
            Some(share) if share > 0.02 => notes.push(format!(
                "humans and vehicles cover up to {:.0} % of the path in the backgrounds",
                100.0 * share
            )),
            Some(_) => {}
        }
        notes
    }

    fn plan(&self) -> Composites<'_> {
        Composites {
            cast: &self.cast,
            backgrounds: &self.backgrounds,
            jobs: &self.jobs,
        }
    }

    /// Everything that can change a row of this model, as a digest.
    fn identity(&self, model: &Model) -> String {
        let mut identity = Identity::of_model(model);
        identity.add("runtime", model.runtime());
        identity.add("provider", model.provider());
        identity.add("threads within the model", &model.threads.to_string());
        identity.add("program", TOOL_VERSION);
        identity.add("prepared set", &self.set.manifest.data_digest);
        identity.add("sizes", &self.scales.to_string());
        for (index, sprite) in self.cast.sprites.iter().enumerate() {
            let facts = format!("{} {} {}", sprite.name, sprite.height_m, sprite.blake3);
            identity.add(&format!("sprite {index}"), &facts);
        }
        for one in &self.backgrounds {
            let horizon = one.ground.horizon_row.to_string();
            identity.add(&format!("background {}", one.id), &horizon);
        }
        identity.digest()
    }

    /// Asks a model about all composites that an interrupted run has not, and draws its sheets. `note`
    /// is told how long it will take.
    ///
    /// # Errors
    /// The model fails on every background, or results cannot be kept.
    pub fn ask(&self, subject: Subject<'_>, note: impl Fn(&str)) -> Result<Answers, CueError> {
        let Subject {
            model,
            file,
            device,
            warnings,
        } = subject;
        let plan = self.plan();
        let name = model.name.clone();
        let (mut journal, found) = Journal::open(self.out, &name, &self.identity(model))?;
        let (before, left) = plan.part(found);
        let started = Instant::now();
        let clean = measure::predict_clean(model, &self.backgrounds)?;
        let rate = self.backgrounds.len() as f64 / started.elapsed().as_secs_f64().max(1e-9);
        let count = |jobs: &[Job]| jobs.iter().map(|job| job.composites.len()).sum::<usize>();
        let (all, to_do) = (self.composites(), count(&left));
        if to_do < all {
            note(&format!(
                "note: {name}: {} of {all} composites were measured before the last run was \
                 interrupted; continuing",
                all - to_do
            ));
        }
        note(&format!(
            "{name}: {to_do} composites at about {rate:.1}/s: {}",
            human::duration(to_do as f64 / rate)
        ));
        let progress = Progress::new(&name, to_do as u64, "composites", self.quiet);
        let rest = Composites {
            jobs: &left,
            ..plan
        };
        let watch = Watch::new("stopping after these composites");
        let mut outcome = measure::run(model, &rest, &clean, self.pool, &progress, |rows| {
            journal.add(rows)?;
            watch.check().map_err(CueError::from)
        })?;
        drop(watch);
        progress.finish();
        outcome.rows = plan.in_order([before, outcome.rows].concat());
        if !outcome.rows.is_empty() {
            let sheets = sheets::sheets(model, &plan, &clean)?;
            write_figures(self.out, &name, &sheets, SHEET_ZOOM)?;
        }
        let record = ModelRecord {
            name,
            file: file.to_path_buf(),
            blake3: model.file.blake3.clone(),
            description: model.description.clone(),
            runtime: model.runtime().to_owned(),
            provider: model.provider().to_owned(),
            device,
            rows: outcome.rows.len(),
            failures: outcome.failures.len(),
            seconds: rounded(outcome.wall),
            overhead: (1000.0 * outcome.overhead()).round() / 1000.0,
            warnings,
        };
        Ok(Answers {
            outcome,
            record,
            journal,
        })
    }

    fn settings(&self) -> Settings<'_> {
        let manifest = &self.set.manifest;
        Settings {
            data_digest: &manifest.data_digest,
            content: manifest.content,
            source: manifest.source.to_string(),
            backgrounds: self
                .backgrounds
                .iter()
                .map(|background| BackgroundRecord {
                    id: &background.id,
                    horizon_row: background.ground.horizon_row,
                    occupied: background.occupied,
                })
                .collect(),
            sprites: self
                .cast
                .sprites
                .iter()
                .map(|sprite| SpriteRecord {
                    name: &sprite.name,
                    height_m: sprite.height_m,
                    blake3: &sprite.blake3,
                })
                .collect(),
            composites: self.composites(),
        }
    }

    /// Writes what ran.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write_record(
        &self,
        data: &Path,
        models: &[ModelRecord],
        arguments: &[String],
    ) -> Result<(), CueError> {
        let record = Record {
            tool: "bench cues",
            tool_version: TOOL_VERSION,
            arguments,
            data,
            settings: self.settings(),
            jobs: self.pool.current_num_threads(),
            models,
        };
        let text = yaml::to_string(&record)?;
        Ok(MARK.finish(self.out, text.as_bytes())?)
    }
}

impl FailureRow {
    /// A failure of a model.
    #[must_use]
    pub fn new(model: &str, failure: &Failure) -> Self {
        Self {
            model: model.to_owned(),
            background: failure.background.clone(),
            reason: failure.reason.clone(),
        }
    }
}

/// Writes the list of failures, or removes that of an earlier run when nothing failed.
///
/// # Errors
/// The file cannot be written or removed.
pub fn write_failures(out: &Path, failures: &[FailureRow]) -> Result<(), CueError> {
    let path = out.join(FAILURES);
    if failures.is_empty() {
        files::remove(&path)?;
    } else {
        files::write_csv(&path, failures)?;
    }
    Ok(())
}

fn rounded(time: Duration) -> f64 {
    (1000.0 * time.as_secs_f64()).round() / 1000.0
}

/// Summary and curves from rows alone.
///
/// # Errors
/// A file cannot be written.
pub fn write_results(out: &Path, rows: &[CueRow]) -> Result<Summary, CueError> {
    let summary = summary::summarise(rows, &Bootstrap::default());
    files::write_csv(&out.join(WORDS), &summary.findings)?;
    files::write_csv(&out.join(STATISTICS), &summary.statistics)?;
    files::write_atomic(&out.join(MARKDOWN), summary.markdown().as_bytes())?;
    for name in distinct(rows.iter().map(|row| row.model.as_str())) {
        write_figures(out, name, &curves::curves(name, rows), CHART_ZOOM)?;
    }
    Ok(summary)
}

/// Draws figures and summary of a folder again.
///
/// # Errors
/// There are no rows, something else is in the way, or a file cannot be written.
pub fn render(folder: &Path) -> Result<Summary, CueError> {
    let rows = rows::read(folder)?;
    // The rows may have been copied here alone; nothing else may be in the way.
    let mark = Mark {
        writes: is_drawn,
        ..MARK
    };
    let found = mark.examine(folder, &[])?;
    mark.begin(folder)?;
    let summary = write_results(folder, &rows)?;
    if found != Found::Record {
        mark.finish(folder, MARK.begins.as_bytes())?;
    }
    Ok(summary)
}

fn write_figures(out: &Path, model: &str, figures: &[Figure], zoom: f32) -> Result<(), CueError> {
    let folder = out.join(FIGURES).join(slug(model));
    for (name, svg) in figures {
        files::write_atomic(&folder.join(format!("{name}.svg")), svg.as_bytes())?;
        let drawn = png(svg, zoom).map_err(|source| CueError::Draw {
            name: (*name).to_owned(),
            source,
        })?;
        files::write_atomic(&folder.join(format!("{name}.png")), &drawn)?;
    }
    Ok(())
}
