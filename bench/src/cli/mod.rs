//! The `bench` command: arguments, order of work, messages and exit codes.
//!
//! Results go to stdout, everything else to stderr. Exit codes: 0 done, 1 failed or incomplete,
//! 2 wrong usage. A broken image or model costs itself only and ends in code 1; what was good is
//! kept.
#![allow(
    clippy::print_stdout,
    reason = "results of a command belong on stdout; this is the one module that prints them"
)]

mod compare;
mod cues;
mod devices;
mod figures;
mod latency;
mod merge;
mod predict;
mod report;

use std::{
    collections::BTreeSet,
    ffi::OsString,
    io::Write as _,
    path::{Path, PathBuf},
    time::Instant,
};

use anyhow::Context as _;
use clap::{Args, Parser, Subcommand};
use strat_metrics::{
    PostProcessing, Protocol, Row, RowContext, Suffix, protocols,
    tables::{Coverage, Source},
};
use strat_onnx::metadata::OutputMeaning;
use strat_splits::Role;
use strat_store::{
    files, image_files,
    progress::Progress,
    raster::Plane,
    set::{Count, PreparedSet, Sample},
    shard::Shard,
};

use crate::{
    draw::comparison::{self, slug},
    evaluate::journal::{self, Journal, JournalError},
    evaluate::median::{self, MedianDepth},
    evaluate::predictions::SavedPredictions,
    evaluate::predictions::{PredictionWriter, SaveError},
    evaluate::shards,
    evaluate::write::{
        self, DataRecord, ModelRecord, Outcome, PlanError, ProtocolRecord, RunRecord, TableChoice,
    },
    evaluate::{self, Evaluation, Failure, Observer, Predictor, Task},
    model::leakage::{self, Leakage},
    model::{Model, PROBE_TOLERANCE},
    runtime::setup::{self, SetupOptions, Surroundings},
    runtime::{Device, Runtime, RuntimeChoice},
};

const DONE: u8 = 0;
const FAILED: u8 = 1;
const USAGE: u8 = 2;

const TOOL_VERSION: &str = env!("CARGO_PKG_VERSION");

const EXAMPLES: &str = "\
Examples:
  bench setup
      put ONNX Runtime into a folder of its own, once
  bench --table 3.1 --data kitti_set --model strat=model.onnx --out results
      table 3.1 for one model
  bench --table 3.3 --data eigen_set --model a.onnx --model b.onnx --out results --device cuda
      two models side by side on an NVIDIA device
  bench --table all --data kitti_set --model model.onnx --median-baseline --pictures 8 --out results
      all tables the set offers, a constant baseline, and pictures
  bench report results
      one HTML page about all runs below a folder: tables, intervals, curves, best and worst images
  bench protocols
      the evaluation rules by name
  bench devices
      what this machine can run models on, and why not on the rest
  bench --table 3.3 --data eigen_set --predictions godard=disparities.npy --out results
      predictions that another program has saved, without a model
  bench --table 3.3 --data eigen_set --model model.onnx --out results --shard 0/8
      one of eight parts, on as many machines; `bench merge results` puts them together
  bench predict --model model.onnx photos --out depth --format exr,color --focal-px 721.5 --baseline-m 0.54
      depth maps and coloured pictures of a folder of images
  bench latency --model model.onnx --images photos --threads 1,2 --batch 1,4 --out speed
      percentiles and throughput, from file to depth and for the session alone
  bench figures --data kitti_set --model a.onnx --model b.onnx --out figures
      depth and error of models side by side, and the right views they make
  bench cues --data kitti_set --model model.onnx --out cues
      which depth cues the model uses, with figures 4.3 to 4.10

Models of other projects need a description beside the file (model.yaml for model.onnx):
  input:  {width: 640, height: 192, range: 0..1, mean: [0.485, 0.456, 0.406],
           std: [0.229, 0.224, 0.225], channels: rgb, layout: nchw, kernel: lanczos}
  output: {name: disp, meaning: inverse_depth, sigmoid: {min_depth: 0.1, max_depth: 100},
           scale: 5.4, channel: 0, layout: nchw}
where meaning is disparity_fraction, disparity_px, inverse_depth (of unknown scale unless `scale`
says how many metres its unit is), inverse_depth_per_m or depth_m.

Saved predictions need one too (disps.yaml for disps.npy or disps.npz, predictions.yaml in a folder
of PNG, EXR or npy files), with meaning, sigmoid, scale and png_divisor:
  meaning: disparity_fraction

Exit codes: 0 done, 1 failed or incomplete, 2 wrong usage.";

#[derive(Debug, Parser)]
#[command(
    name = "bench",
    version,
    about = "Evaluates ONNX depth models and writes the tables 3.1, 3.2 and 3.3",
    after_help = EXAMPLES,
    args_conflicts_with_subcommands = true,
    subcommand_negates_reqs = true,
    arg_required_else_help = true
)]
struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    run: Option<RunArgs>,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Install ONNX Runtime into a folder of its own (needs python3 with pip, once)
    Setup(SetupArgs),
    /// Put the parts of a divided run (--shard) together
    Merge(merge::MergeArgs),
    /// Show what this machine can run models on, and why not on the rest
    Devices(devices::DevicesArgs),
    /// Write depth, disparity or coloured pictures of images
    Predict(predict::PredictArgs),
    /// Time models over threads and batches, after MLPerf's LoadGen
    Latency(latency::LatencyArgs),
    /// Test which depth cues models use (figures 4.3 to 4.10)
    Cues(cues::CuesArgs),
    /// Cut sprites for `bench cues` out of a labelled set's own images
    Sprites(cues::SpritesArgs),
    /// Draw what models make of the same images (figures 3.3 and 3.6 to 3.10)
    Figures(figures::FiguresArgs),
    /// List the evaluation protocols, or state the rules of one
    Protocols {
        /// State the rules of this protocol (or YAML file) in words; `diff` compares two
        #[arg(value_name = "NAME | diff A B")]
        names: Vec<String>,
    },
    /// Test the differences between models over the images both have
    Compare(compare::CompareArgs),
    /// Add measured lines to a leaderboard, or merge leaderboards
    Publish(compare::PublishArgs),
    /// Derive every measured line of a leaderboard again from its rows
    VerifyLeaderboard(compare::VerifyArgs),
    /// Write the thesis' tables from rows alone
    Render(compare::RenderArgs),
    /// Write one HTML page about everything below a folder of results
    Report(report::ReportArgs),
}

#[derive(Debug, Args)]
struct SetupArgs {
    /// The CUDA build and the CUDA 13 libraries (about 2.5 GB) instead of the CPU build (70 MB)
    #[arg(long)]
    gpu: bool,
    /// Install below this folder instead of STRAT_HOME or the user's data folder
    #[arg(long, value_name = "DIR")]
    dir: Option<PathBuf>,
}

#[derive(Debug, Args)]
struct RunArgs {
    /// Table of the thesis to fill; `all` is whatever the data offers
    #[arg(long, value_enum)]
    table: TableChoice,
    /// Folder that `prep` has written
    #[arg(long, value_name = "DIR")]
    data: PathBuf,
    /// ONNX file, with the name it shall have in tables; may be given several times
    #[arg(long = "model", value_name = "[NAME=]FILE.onnx")]
    models: Vec<String>,
    /// Predictions that some program has saved (npy, npz, or a folder of 16-bit PNG, EXR or npy),
    /// with the name they shall have in tables; may be given several times
    #[arg(long = "predictions", value_name = "[NAME=]PATH")]
    predictions: Vec<String>,
    /// Folder for rows, tables and the run record
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Further protocols for rows.csv and leaderboard.csv, by name (see `bench protocols`) or as
    /// a YAML file of your own
    #[arg(long = "protocol", value_name = "NAME|FILE.yaml")]
    protocols: Vec<String>,
    /// Add a measured row: the median depth of the training scans at each place in the picture
    #[arg(long)]
    median_baseline: bool,
    /// Where the model runs: cpu, cuda, cuda:1, tensorrt, coreml or directml (see `bench devices`)
    #[arg(long, default_value_t)]
    device: Device,
    /// Inference library; `auto` is ONNX Runtime when it is there, else the embedded one
    #[arg(long, value_enum, default_value_t)]
    runtime: RuntimeChoice,
    /// Also write predictions.npy (disparity fractions at network size), with the ids of the
    /// images and the description that --predictions needs beside it
    #[arg(long, conflicts_with = "shard")]
    save_predictions: bool,
    /// Measure only one of N parts of the test images, numbered from 0; see `bench merge`
    #[arg(long, value_name = "I/N")]
    shard: Option<Shard>,
    /// Write this many comparison pictures per model
    #[arg(long, value_name = "N", default_value_t = 0)]
    pictures: usize,
    /// Write comparison pictures of the N best and the N worst images of each model too, which
    /// `bench report` shows
    #[arg(long, value_name = "N", default_value_t = 0, conflicts_with = "shard")]
    extremes: usize,
    /// Threads for decoding and metrics, and for the model [default: all cores]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    jobs: Option<u16>,
    /// Threads within the model [default: as many as --jobs]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// No progress and no notes; warnings and errors still show
    #[arg(long)]
    quiet: bool,
}

/// Runs the command with the given arguments, the program's name first, and returns the exit
/// code.
pub fn main(args: impl IntoIterator<Item = OsString>) -> u8 {
    let args: Vec<OsString> = args.into_iter().collect();
    let arguments: Vec<String> = args
        .iter()
        .skip(1)
        .map(|argument| argument.to_string_lossy().into_owned())
        .collect();
    let cli = match Cli::try_parse_from(&args) {
        Ok(cli) => cli,
        Err(error) => {
            // clap knows which of its messages are help (stdout, success) and which are not.
            let _ = error.print();
            return if error.use_stderr() { USAGE } else { DONE };
        }
    };
    let result = match cli {
        Cli {
            command: Some(Command::Setup(args)),
            ..
        } => set_up(&args),
        Cli {
            command: Some(Command::Merge(args)),
            ..
        } => merge::run(&args),
        Cli {
            command: Some(Command::Devices(args)),
            ..
        } => devices::run(&args),
        Cli {
            command: Some(Command::Predict(args)),
            ..
        } => predict::run(&args, arguments),
        Cli {
            command: Some(Command::Latency(args)),
            ..
        } => latency::run(&args),
        Cli {
            command: Some(Command::Cues(args)),
            ..
        } => cues::run(&args, arguments),
        Cli {
            command: Some(Command::Sprites(args)),
            ..
        } => cues::cut(&args),
        Cli {
            command: Some(Command::Figures(args)),
            ..
        } => figures::run(&args, arguments),
        Cli {
            command: Some(Command::Protocols { names }),
            ..
        } => list_protocols(&names),
        Cli {
            command: Some(Command::Compare(args)),
            ..
        } => compare::compare(&args),
        Cli {
            command: Some(Command::Publish(args)),
            ..
        } => compare::publish(&args),
        Cli {
            command: Some(Command::VerifyLeaderboard(args)),
            ..
        } => compare::verify(&args),
        Cli {
            command: Some(Command::Render(args)),
            ..
        } => compare::render(&args),
        Cli {
            command: Some(Command::Report(args)),
            ..
        } => report::run(&args),
        Cli {
            command: None,
            run: Some(args),
        } => run(&args, arguments),
        Cli {
            command: None,
            run: None,
        } => Err(Usage("nothing to do; see `bench --help`".to_owned()).into()),
    };
    match result {
        Ok(code) => code,
        Err(error) => {
            eprintln!("error: {}", sentence(&error));
            if error.is::<Usage>() || error.is::<PlanError>() {
                USAGE
            } else {
                FAILED
            }
        }
    }
}

/// An error with its causes; a cause that the message already states is not said twice.
fn sentence(error: &anyhow::Error) -> String {
    let mut text = String::new();
    for cause in error.chain() {
        let cause = cause.to_string();
        if text.is_empty() {
            text = cause;
        } else if !text.contains(&cause) {
            text = format!("{text}: {cause}");
        }
    }
    text
}

/// A request that contradicts itself.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
struct Usage(String);

/// Prints results; a reader that has seen enough (`| head`) is no error.
fn print(text: &str) -> anyhow::Result<()> {
    let mut out = std::io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(error) if error.kind() == std::io::ErrorKind::BrokenPipe => Ok(()),
        other => other.context("the results could not be printed"),
    }
}

fn set_up(args: &SetupArgs) -> anyhow::Result<u8> {
    let surroundings = Surroundings::of_this_process();
    let options = SetupOptions {
        gpu: args.gpu,
        root: args.dir.clone(),
    };
    if setup::installed(&options, &surroundings)?.is_none() {
        let size = if args.gpu {
            "CUDA, about 2.5 GB"
        } else {
            "CPU, about 70 MB"
        };
        eprintln!(
            "installing ONNX Runtime {} ({size}) ...",
            setup::ONNXRUNTIME_VERSION
        );
    }
    let installed = setup::install(&options, &surroundings)?;
    let version =
        crate::runtime::ffi::onnxruntime_version(&installed.library).map_err(|reason| {
            anyhow::anyhow!(
                "the library in {} cannot be opened: {reason}",
                installed.library.display()
            )
        })?;
    print(&format!("{}\n", installed.library.display()))?;
    eprintln!(
        "ONNX Runtime {version} is {} {}; `bench` finds it there from now on, and deleting the \
         folder undoes this",
        if installed.already_there {
            "already in"
        } else {
            "now in"
        },
        installed.folder.display()
    );
    if let Some(root) = &args.dir {
        // A folder of the user's own is found only when it is named.
        eprintln!(
            "to have it found, set STRAT_HOME={} (or ORT_DYLIB_PATH={})",
            root.display(),
            installed.library.display()
        );
    }
    Ok(DONE)
}

fn list_protocols(names: &[String]) -> anyhow::Result<u8> {
    let resolve =
        |name: &str| crate::protocol_file::resolve(name).map_err(|error| Usage(error.to_string()));
    match names {
        [] => {}
        [name] if name != "diff" => {
            let protocol = resolve(name)?;
            print(&format!(
                "{} (version {}, digest {})\n{}\n",
                protocol.name,
                protocol.version,
                protocol.digest(),
                protocol.describe()
            ))?;
            return Ok(DONE);
        }
        [word, a, b] if word == "diff" => {
            print(&crate::protocol_file::difference(
                &resolve(a)?,
                &resolve(b)?,
            ))?;
            return Ok(DONE);
        }
        _ => {
            return Err(Usage(
                "`bench protocols` takes nothing, one name, or `diff` and two names".to_owned(),
            )
            .into());
        }
    }
    let mut text = String::new();
    for protocol in protocols() {
        let digest = protocol.digest();
        let tables: Vec<String> = strat_metrics::tables::ThesisTable::ALL
            .iter()
            .filter(|table| table.protocols().contains(&protocol.name.as_str()))
            .map(|table| format!("table {table}"))
            .collect();
        text += &format!(
            "{:<22} version {}  {}  {}\n",
            protocol.name,
            protocol.version,
            &digest[..12.min(digest.len())],
            tables.join(", ")
        );
    }
    text += "\nEach name also takes -median (median scaling), -pp (flip post-processing), -distance (scores\n\
             by true depth) and another crop (-nocrop, -garg, -eigencrop). `bench protocols NAME` states the rules,\n\
             `bench protocols diff A B` what differs.\n";
    print(&text)?;
    Ok(DONE)
}

/// A model as asked for.
struct Asked {
    name: String,
    file: PathBuf,
}

/// Which provider holds how many nodes of a graph, where the runtime tells.
fn placement_text(placement: &[(String, usize)]) -> Option<String> {
    let parts: Vec<String> = placement
        .iter()
        .map(|(provider, nodes)| format!("{nodes} nodes on {provider}"))
        .collect();
    (!parts.is_empty()).then(|| parts.join(", "))
}

/// Splits `[NAME=]FILE` and finds a name for those without, none of which may be `taken`.
fn asked_files(option: &str, texts: &[String], taken: &[&str]) -> Result<Vec<Asked>, Usage> {
    let mut asked: Vec<Asked> = Vec::new();
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
            return Err(Usage(format!(
                "`--{option} {text}` needs a file, and before `=` a name that is not empty"
            )));
        }
        if taken.contains(&name.as_str()) || asked.iter().any(|other| other.name == name) {
            return Err(Usage(format!(
                "two models are called \"{name}\"; name them with `--{option} NAME=FILE`"
            )));
        }
        asked.push(Asked { name, file });
    }
    Ok(asked)
}

/// The file's name, or its folder's where every file is called the same.
fn default_name(file: &Path) -> String {
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

/// Everything a run collects on its way.
struct Session<'a> {
    args: &'a RunArgs,
    set: PreparedSet,
    samples: Vec<Sample>,
    protocols: Vec<Protocol>,
    pool: rayon::ThreadPool,
    wanted_pictures: BTreeSet<String>,
    /// Where results are written: the output folder, or that of one part.
    out: PathBuf,
    journals: Vec<PathBuf>,
    /// All protocols that anything was measured under, in order.
    used: Vec<Protocol>,
    rows: Vec<Row>,
    failures: Vec<Failure>,
    records: Vec<ModelRecord>,
    warnings: Vec<String>,
    /// Something failed that is not an image.
    incomplete: bool,
    several: bool,
    /// Test images of the whole set and of its split.
    count: Count,
}

impl Session<'_> {
    fn note(&self, text: &str) {
        if !self.args.quiet {
            eprintln!("{text}");
        }
    }

    fn warn(&mut self, text: String) {
        eprintln!("warning: {text}");
        self.warnings.push(text);
    }

    fn fail(&mut self, text: String) {
        eprintln!("error: {text}");
        self.warnings.push(text);
        self.incomplete = true;
    }
}

fn run(args: &RunArgs, arguments: Vec<String>) -> anyhow::Result<u8> {
    let constant = args.median_baseline.then_some(median::NAME);
    let asked = asked_files("model", &args.models, constant.as_slice())?;
    let mut taken: Vec<&str> = asked.iter().map(|asked| asked.name.as_str()).collect();
    taken.extend(constant);
    let asked_saved = asked_files("predictions", &args.predictions, &taken)?;
    let set = PreparedSet::open(&args.data)?;
    let mut samples = set.samples(Role::Test)?;
    let count = plan::test_count(&set, &samples);
    let plan = plan::plan(
        args.table,
        &args.protocols,
        set.manifest.content,
        &samples,
        count,
    )?;
    let out = match args.shard {
        Some(shard) => shard.folder(&args.out),
        None => args.out.clone(),
    };
    files::check_writable(&out)?;
    let wanted = args.pictures.min(samples.len());
    let wanted_pictures = (0..wanted)
        .map(|i| samples[i * samples.len() / wanted].id.clone())
        .collect();
    let order: Vec<String> = samples.iter().map(|sample| sample.id.clone()).collect();
    if let Some(shard) = args.shard {
        samples.retain(|sample| shard.has(&sample.id));
        shards::begin(&out, &order, shard)?;
    }
    let jobs = args.jobs.map_or(0, usize::from);
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(jobs)
        .thread_name(|index| format!("bench-{index}"))
        .build()
        .context("the worker threads could not be started")?;
    let threads = args.threads.map_or(pool.current_num_threads(), usize::from);
    let mut session = Session {
        args,
        wanted_pictures,
        out,
        journals: Vec::new(),
        used: Vec::new(),
        protocols: plan.protocols.clone(),
        pool,
        rows: Vec::new(),
        failures: Vec::new(),
        records: Vec::new(),
        warnings: Vec::new(),
        incomplete: false,
        several: asked.len() > 1,
        count,
        set,
        samples,
    };
    for sentence in &plan.left_out {
        session.note(&format!("note: {sentence}"));
    }
    if count.found < count.expected {
        let text = format!(
            "{} of {} test images are in this set; every table says so",
            count.found, count.expected
        );
        session.note(&format!("note: {text}"));
    }

    let mut runtime = None;
    if !asked.is_empty() {
        let (found, notice) = Runtime::resolve(args.runtime, args.device)?;
        if let Some(notice) = notice {
            eprintln!("note: {notice}");
        }
        session.note(&format!(
            "{} images, {found}, device {}",
            session.samples.len(),
            args.device
        ));
        for model in &asked {
            evaluate_model(&mut session, model, &found, threads)?;
        }
        runtime = Some(found);
    }
    for saved in &asked_saved {
        evaluate_saved(&mut session, saved)?;
    }
    if args.median_baseline {
        evaluate_baseline(&mut session)?;
    }
    write_results(session, &plan.tables, runtime.as_ref(), arguments)
}

/// Loads, checks and evaluates one model. A model that cannot be used is reported and skipped.
fn evaluate_model(
    session: &mut Session<'_>,
    asked: &Asked,
    runtime: &Runtime,
    threads: usize,
) -> anyhow::Result<()> {
    let device = session.args.device;
    let mut model = match Model::open(&asked.name, &asked.file, runtime, device, threads) {
        Ok(model) => model,
        Err(error) => {
            session.fail(format!("model {}: {error}", asked.name));
            return Ok(());
        }
    };
    let probe = check_model(session, &mut model)?;
    let Ok(probe) = probe else { return Ok(()) };
    if let Some(placement) = placement_text(model.placement()) {
        session.note(&format!(
            "model {}: {placement}, {threads} threads",
            model.name
        ));
    }

    let protocols = protocols_for(session, &model.name, model.description.output.meaning());
    let metadata = model.file.info.metadata().cloned();
    let context = RowContext {
        model: model.name.clone(),
        model_hash: model.file.blake3.clone(),
        variant: metadata
            .as_ref()
            .and_then(|metadata| metadata.variant.clone()),
        runtime: model.runtime().to_owned(),
        provider: model.provider().to_owned(),
        ..shared_context(session)
    };
    let mut writer = None;
    if session.args.save_predictions {
        let name = if session.several {
            format!("predictions-{}.npy", slug(&model.name))
        } else {
            "predictions.npy".to_owned()
        };
        writer = Some(PredictionWriter::create(&session.out.join(name))?);
    }
    let started = Instant::now();
    let evaluation = predict_all(
        session,
        &model.name.clone(),
        &mut Predictor::Model(&mut model),
        &protocols,
        &context,
        &mut writer,
    )?;
    if let Some(writer) = writer {
        writer.finish()?;
    }
    let record = ModelRecord {
        name: model.name.clone(),
        file: Some(asked.file.clone()),
        blake3: model.file.blake3.clone(),
        description: Some(model.description.clone()),
        saved: None,
        metadata,
        parameters: Some(model.file.info.parameters),
        runtime: model.runtime().to_owned(),
        provider: model.provider().to_owned(),
        probe_max_difference: probe,
        images: images_in(&evaluation.rows),
        seconds: started.elapsed().as_secs_f64(),
        note: None,
    };
    keep(session, evaluation, record)
}

/// The protocols of a run as they apply to predictions of this meaning.
fn protocols_for(session: &mut Session<'_>, name: &str, meaning: OutputMeaning) -> Vec<Protocol> {
    if meaning != OutputMeaning::InverseDepth {
        return session.protocols.clone();
    }
    session.warn(format!(
        "model {name} gives inverse depth of unknown scale: its predictions are scaled by the \
         median of the ground truth, and its rows stand in tables of their own"
    ));
    // What was asked for with the suffix as well is one protocol.
    let mut scaled: Vec<Protocol> = Vec::new();
    for protocol in &session.protocols {
        let protocol = protocol.clone().with(Suffix::Median);
        if !scaled.contains(&protocol) {
            scaled.push(protocol);
        }
    }
    scaled
}

/// Opens and evaluates saved predictions. What cannot be used is reported and skipped.
fn evaluate_saved(session: &mut Session<'_>, asked: &Asked) -> anyhow::Result<()> {
    let Asked { name, file } = asked;
    // Whose map is whose follows from the whole test list, also where a part of it is measured.
    let samples = session.set.samples(Role::Test)?;
    let content = session.set.manifest.content;
    let saved = match SavedPredictions::open(name, file, content, &samples) {
        Ok(saved) => saved,
        Err(error) => {
            session.fail(format!("predictions {name}: {error}"));
            return Ok(());
        }
    };
    session.note(&format!(
        "note: predictions {name} do not say what their model was trained on, so leakage cannot \
         be checked"
    ));
    let protocols = protocols_for(session, name, saved.meaning());
    let (flipped, protocols): (Vec<Protocol>, Vec<Protocol>) = protocols
        .into_iter()
        .partition(|protocol| protocol.post_processing == PostProcessing::Flip);
    for protocol in flipped {
        session.fail(format!(
            "predictions {name}: {} needs predictions of mirrored images, which saved ones do not \
             have; save predictions that are post-processed and evaluate them under the protocol \
             without",
            protocol.name
        ));
    }
    let (runtime, provider) = ("none", "none");
    let context = RowContext {
        model: name.clone(),
        model_hash: saved.blake3.clone(),
        variant: None,
        runtime: runtime.to_owned(),
        provider: provider.to_owned(),
        ..shared_context(session)
    };
    let started = Instant::now();
    let evaluation = predict_all(
        session,
        name,
        &mut Predictor::Saved(&saved),
        &protocols,
        &context,
        &mut None,
    )?;
    let record = ModelRecord {
        name: name.clone(),
        file: Some(file.clone()),
        blake3: saved.blake3.clone(),
        description: None,
        saved: Some(saved.description.clone()),
        metadata: None,
        parameters: None,
        runtime: runtime.to_owned(),
        provider: provider.to_owned(),
        probe_max_difference: None,
        images: images_in(&evaluation.rows),
        seconds: started.elapsed().as_secs_f64(),
        note: None,
    };
    keep(session, evaluation, record)
}

/// Leakage and the trainer's own probe. The inner error is a model that does not run at all.
#[allow(
    clippy::result_unit_err,
    reason = "the failure has been reported; the caller only skips the model"
)]
fn check_model(
    session: &mut Session<'_>,
    model: &mut Model,
) -> anyhow::Result<Result<Option<f32>, ()>> {
    for problem in model.file.info.description.problems.clone() {
        session.warn(format!("model {}: {problem}", model.name));
    }
    let tested = session.set.manifest.content;
    match leakage::check(model.file.info.metadata(), tested, &session.samples) {
        Leakage::None => {}
        Leakage::Drives { drives, images } => session.warn(format!(
            "LEAKAGE: model {} was trained on drives that {images} of the {} test images come from \
             ({}); its figures are no measure of anything new and must not be compared",
            model.name,
            session.samples.len(),
            drives.join(", ")
        )),
        Leakage::OtherSplit { trained } => session.warn(format!(
            "LEAKAGE: model {} was trained on the {trained} split and is tested on the {tested} \
             split; drives of its training may be among the test images, so its figures are no \
             measure of anything new and must not be compared",
            model.name
        )),
        Leakage::Unknown => session.note(&format!(
            "note: model {} does not say all that it was trained on, so leakage cannot be checked",
            model.name
        )),
    }
    match model.probe() {
        Err(error) => {
            session.fail(format!("model {}: {error}", model.name));
            Ok(Err(()))
        }
        Ok(None) => {
            session.note(&format!(
                "note: model {} carries no probe; whether this runtime computes what was trained \
                 is not checked",
                model.name
            ));
            Ok(Ok(None))
        }
        Ok(Some(result)) => {
            let difference = result.max_difference;
            if result.passes() {
                session.note(&format!(
                    "model {} on {}: largest difference to the trainer's own output {difference:.1e}",
                    model.name,
                    model.provider()
                ));
            } else {
                session.warn(format!(
                    "PROBE FAILED: model {} on {} differs from the trainer's own output by \
                     {difference:.1e} (more than {PROBE_TOLERANCE:.0e}); this runtime does not \
                     compute what was trained, so do not trust the figures",
                    model.name,
                    model.provider()
                ));
            }
            Ok(Ok(Some(difference)))
        }
    }
}

fn evaluate_baseline(session: &mut Session<'_>) -> anyhow::Result<()> {
    let median = match MedianDepth::of_training(&session.set, &session.pool, session.args.quiet) {
        Ok(median) => median,
        Err(error) => {
            session.fail(error.to_string());
            return Ok(());
        }
    };
    let (runtime, provider) = ("none", "none");
    let context = RowContext {
        model: median::NAME.to_owned(),
        model_hash: median.digest(),
        variant: None,
        runtime: runtime.to_owned(),
        provider: provider.to_owned(),
        ..shared_context(session)
    };
    let protocols = session.protocols.clone();
    let started = Instant::now();
    let evaluation = predict_all(
        session,
        median::NAME,
        &mut Predictor::MedianDepth(&median),
        &protocols,
        &context,
        &mut None,
    )?;
    let record = ModelRecord {
        name: median::NAME.to_owned(),
        file: None,
        blake3: median.digest(),
        description: None,
        saved: None,
        metadata: None,
        parameters: None,
        runtime: runtime.to_owned(),
        provider: provider.to_owned(),
        probe_max_difference: None,
        images: images_in(&evaluation.rows),
        seconds: started.elapsed().as_secs_f64(),
        note: Some(format!(
            "per-place median of {} of {} training scans on a grid of {}x{}",
            median.images,
            median.available,
            median::GRID_WIDTH,
            median::GRID_HEIGHT
        )),
    };
    keep(session, evaluation, record)
}

fn shared_context(session: &Session<'_>) -> RowContext {
    let manifest = &session.set.manifest;
    RowContext {
        data_digest: manifest.data_digest.clone(),
        split: manifest.content.to_string(),
        tool_version: TOOL_VERSION.to_owned(),
        ..RowContext::default()
    }
}

/// Why an evaluation was broken off.
#[derive(Debug, thiserror::Error)]
enum BrokenOff {
    #[error(transparent)]
    Save(#[from] SaveError),
    #[error(transparent)]
    Journal(#[from] JournalError),
}

/// Puts down what an evaluation finds as soon as it does.
struct Recorder<'a> {
    writer: &'a mut Option<PredictionWriter>,
    journal: Journal,
}

impl Observer for Recorder<'_> {
    type Error = BrokenOff;

    fn predicted(&mut self, image: &str, disparity: Option<&Plane>) -> Result<(), BrokenOff> {
        match &mut self.writer {
            Some(writer) => Ok(writer.push(image, disparity)?),
            None => Ok(()),
        }
    }

    fn scored(&mut self, rows: &[Row]) -> Result<(), BrokenOff> {
        Ok(self.journal.add(rows)?)
    }
}

/// Evaluates everything that an interrupted run has not.
fn predict_all(
    session: &mut Session<'_>,
    name: &str,
    predictor: &mut Predictor<'_>,
    protocols: &[Protocol],
    context: &RowContext,
    writer: &mut Option<PredictionWriter>,
) -> anyhow::Result<Evaluation> {
    let with_context: Vec<(Protocol, RowContext)> = protocols
        .iter()
        .map(|protocol| {
            let context = RowContext {
                protocol: protocol.name.clone(),
                protocol_digest: protocol.digest(),
                ..context.clone()
            };
            (protocol.clone(), context)
        })
        .collect();
    for protocol in protocols {
        if !session.used.iter().any(|known| known.name == protocol.name) {
            session.used.push(protocol.clone());
        }
    }
    let contexts: Vec<RowContext> = with_context.iter().map(|(_, c)| c.clone()).collect();
    let path = session
        .out
        .join(format!("{}{}.csv", journal::PREFIX, slug(name)));
    let (journal, mut before) = Journal::open(&path, &contexts)?;
    session.journals.push(path);
    // Rows alone make neither pictures nor saved predictions.
    before.retain(|image, _| writer.is_none() && !session.wanted_pictures.contains(image));
    let left: Vec<Sample> = session
        .samples
        .iter()
        .filter(|sample| !before.contains_key(&sample.id))
        .cloned()
        .collect();
    if !before.is_empty() {
        session.note(&format!(
            "note: {name}: {} of {} images were measured before the last run was interrupted; \
             going on",
            session.samples.len() - left.len(),
            session.samples.len()
        ));
    }
    let task = Task {
        set: &session.set,
        samples: &left,
        protocols: &with_context,
        pictures: &session.wanted_pictures,
    };
    let progress = Progress::new(name, left.len() as u64, "images", session.args.quiet);
    let mut evaluation = evaluate::evaluate(
        &task,
        name,
        predictor,
        &session.pool,
        &progress,
        &mut Recorder { writer, journal },
    )?;
    progress.finish();
    if !before.is_empty() {
        evaluation.rows.extend(before.into_values().flatten());
        let order: Vec<&str> = session.samples.iter().map(|s| s.id.as_str()).collect();
        let names: Vec<&str> = protocols.iter().map(|p| p.name.as_str()).collect();
        record::sort_rows(&mut evaluation.rows, &[name], &names, &order);
    }
    let extremes = extremes(&evaluation.rows, session.args.extremes);
    let again: Vec<Sample> = session
        .samples
        .iter()
        .filter(|sample| {
            let drawn = |comparison: &evaluate::Comparison| comparison.image == sample.id;
            extremes.contains(&sample.id) && !evaluation.comparisons.iter().any(drawn)
        })
        .cloned()
        .collect();
    if !again.is_empty() {
        let task = Task {
            samples: &again,
            pictures: &extremes,
            ..task
        };
        let progress = Progress::new(name, again.len() as u64, "pictures", session.args.quiet);
        let drawn = evaluate::evaluate(&task, name, predictor, &session.pool, &progress, &mut ());
        progress.finish();
        let drawn = drawn.unwrap_or_else(|never| match never {});
        evaluation.comparisons.extend(drawn.comparisons);
    }
    Ok(evaluation)
}

/// The images with the `count` smallest and `count` largest Abs Rel under the first protocol
/// that scores images as wholes.
fn extremes(rows: &[Row], count: usize) -> BTreeSet<String> {
    let first = rows.iter().find(|row| row.score.group.is_none());
    let mut own: Vec<&Row> = rows
        .iter()
        .filter(|row| first.is_some_and(|first| first.context.protocol == row.context.protocol))
        .collect();
    own.sort_by(|a, b| {
        let error = |row: &Row| row.score.metrics.abs_rel;
        error(a).total_cmp(&error(b)).then(a.image.cmp(&b.image))
    });
    let ends = own.iter().take(count).chain(own.iter().rev().take(count));
    ends.map(|row| row.image.clone()).collect()
}

/// Writes a predictor's pictures and puts its rows with the others.
fn keep(
    session: &mut Session<'_>,
    evaluation: Evaluation,
    record: ModelRecord,
) -> anyhow::Result<()> {
    if !evaluation.comparisons.is_empty() {
        let folder = session.out.join(comparison::FOLDER);
        for comparison in &evaluation.comparisons {
            let path = folder.join(comparison::file(&record.name, &comparison.image));
            let picture = comparison::draw(comparison);
            files::write_atomic(&path, &image_files::encode_png_rgb(&picture))?;
        }
        files::write_atomic(&folder.join("LEGEND.txt"), comparison::LEGEND.as_bytes())?;
    }
    for failure in &evaluation.failures {
        eprintln!(
            "error: {}, image {}: {}",
            failure.model, failure.image, failure.reason
        );
    }
    if evaluation.gave_up {
        session.fail(format!(
            "{}: the first {} images all failed, the rest was not tried",
            record.name,
            evaluation.failures.len()
        ));
    }
    let (counted, dead) = floored(&record.name, &evaluation.rows);
    if let Some(text) = counted {
        session.note(&format!("note: {text}"));
    }
    if let Some(text) = dead {
        session.warn(text);
    }
    session.failures.extend(evaluation.failures);
    session.rows.extend(evaluation.rows);
    session.records.push(record);
    Ok(())
}

/// What there is to say about pixels without disparity, which a protocol's floor keeps from
/// infinity (PROTOCOL D8): how many there are, and whether an output is dead.
fn floored(name: &str, rows: &[Row]) -> (Option<String>, Option<String>) {
    let mut protocols: Vec<&str> = Vec::new();
    for row in rows.iter().filter(|row| row.score.floored_pixels > 0) {
        if !protocols.contains(&row.context.protocol.as_str()) {
            protocols.push(&row.context.protocol);
        }
    }
    let Some(protocol) = protocols.first() else {
        return (None, None);
    };
    let own = || rows.iter().filter(|row| row.context.protocol == *protocol);
    let sum = |count: fn(&Row) -> u64| own().map(count).sum::<u64>();
    let dead: BTreeSet<&str> = own()
        .filter(|row| row.score.floored_pixels == row.score.pixels)
        .map(|row| row.image.as_str())
        .collect();
    let counted = format!(
        "{name}: {} of {} pixels scored under {protocol} had a disparity of zero or nearly zero \
         and were scored at its floor, far away (column floored_pixels of rows.csv)",
        sum(|row| row.score.floored_pixels),
        sum(|row| row.score.pixels)
    );
    let dead = dead.first().map(|first| {
        format!(
            "DEAD OUTPUT: model {name} gives no disparity above the floor in {} of {} images, \
             such as {first}; its figures say nothing about depth",
            dead.len(),
            images_in(rows)
        )
    });
    (Some(counted), dead)
}

fn images_in(rows: &[Row]) -> usize {
    rows.iter()
        .map(|row| row.image.as_str())
        .collect::<BTreeSet<_>>()
        .len()
}

fn write_results(
    session: Session<'_>,
    wanted: &[strat_metrics::tables::ThesisTable],
    runtime: Option<&Runtime>,
    arguments: Vec<String>,
) -> anyhow::Result<u8> {
    let Session {
        args,
        set,
        pool,
        out,
        count,
        records,
        warnings,
        rows,
        failures,
        ..
    } = session;
    let record = RunRecord {
        tool: "bench".to_owned(),
        tool_version: TOOL_VERSION.to_owned(),
        arguments,
        data: DataRecord {
            path: args.data.clone(),
            source: set.manifest.source.clone(),
            content: set.manifest.content,
            split_digest: set.manifest.split_digest.clone(),
            data_digest: set.manifest.data_digest.clone(),
            test_images_expected: count.expected,
            test_images_found: count.found,
            prepared_by: set.manifest.tool_version.clone(),
        },
        tables: wanted.iter().map(ToString::to_string).collect(),
        shard: args.shard,
        device: args.device.to_string(),
        runtime: runtime.map_or_else(|| "none".to_owned(), ToString::to_string),
        runtime_library: runtime.and_then(Runtime::library).map(Path::to_path_buf),
        jobs: pool.current_num_threads(),
        threads: args.threads.map_or(pool.current_num_threads(), usize::from),
        models: records,
        protocols: session.used.iter().map(ProtocolRecord::new).collect(),
        warnings,
        failures: failures.len(),
        complete: failures.is_empty() && !session.incomplete,
    };
    let asked = [&args.models, &args.predictions].map(Vec::len) != [0, 0] || args.median_baseline;
    let outcome = Outcome {
        record,
        rows,
        failures,
    };
    let code = match args.shard {
        Some(shard) => {
            outcome.write(&out)?;
            session_note(
                args.quiet,
                &format!(
                    "part {shard} is done; when all are, `bench merge {}` puts them together",
                    args.out.display()
                ),
            );
            if outcome.record.complete {
                DONE
            } else {
                FAILED
            }
        }
        None => conclude(&outcome, &out, wanted, asked, args.quiet)?,
    };
    for path in &session.journals {
        files::remove(path)?;
    }
    Ok(code)
}

fn session_note(quiet: bool, text: &str) {
    if !quiet {
        eprintln!("{text}");
    }
}

/// Writes everything that follows from the rows of a whole run and prints the tables.
fn conclude(
    outcome: &Outcome,
    out: &Path,
    wanted: &[strat_metrics::tables::ThesisTable],
    asked: bool,
    quiet: bool,
) -> anyhow::Result<u8> {
    let Outcome {
        record,
        rows,
        failures,
    } = outcome;
    let expected = record.data.test_images_expected;
    let coverage = Coverage {
        expected_images: expected,
        source: Source::from(record.data.source.as_str()),
    };
    outcome.write(out)?;
    if rows.is_empty() && asked {
        eprintln!("error: nothing could be measured, so there is no table");
        return Ok(FAILED);
    }
    let entries = write::write_leaderboard(out, rows, expected)?;
    let written = write::write_tables(out, wanted, rows, &coverage)?;
    let mut texts: Vec<String> = written.iter().map(|table| table.text()).collect();
    texts.extend(Some(write::beside_tables(&entries, wanted)).filter(|text| !text.is_empty()));
    print(&texts.join("\n"))?;
    session_note(quiet, &format!("results are in {}", out.display()));
    if !failures.is_empty() {
        eprintln!(
            "error: {} result(s) are missing; they are listed in {}",
            failures.len(),
            out.join("failures.csv").display()
        );
    }
    Ok(if record.complete { DONE } else { FAILED })
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory as _;

    #[test]
    fn arguments_are_well_formed() {
        Cli::command().debug_assert();
    }

    #[test]
    fn models_get_names() {
        let texts = ["runs/a/model.onnx", "b.onnx", "Mine=c.onnx"].map(String::from);
        let names: Vec<String> = asked_files("model", &texts, &[median::NAME])
            .unwrap()
            .into_iter()
            .map(|asked| asked.name)
            .collect();
        assert_eq!(names, ["a", "b", "Mine"]);
        for wrong in [
            ["a.onnx", "x/a.onnx"],
            ["=a.onnx", "b.onnx"],
            ["a=", "b.onnx"],
        ] {
            assert!(asked_files("model", &wrong.map(String::from), &[]).is_err());
        }
    }
}
