//! Does the runs of a study, one after another or side by side, each in a process of its own.
//!
//! A process begins or resumes one run as if it had been typed, and ends with a checkpoint when its standard
//! input closes: so it ends when the study is told to stop, and also when the study itself is killed.

use std::collections::{HashMap, VecDeque};
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{ChildStdin, Command, ExitStatus, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::time::{Duration, Instant};

use strat_store::files;
use strat_store::human;
use strat_store::progress::Progress;

use super::plan::{Study, StudyRun};
use super::state::State;
use crate::device::DeviceChoice;
use crate::error::{Error, Result};
use crate::training::folder::{CONFIG, in_use, newest_step};
use crate::training::memory::{self, Need};
use crate::training::trainer::Trainer;

/// How often it is looked how far the runs are.
const LOOK_EVERY: Duration = Duration::from_millis(250);

/// How runs are done.
#[derive(Clone, Debug)]
pub struct Options<'a> {
    /// The study's folder.
    pub out: &'a Path,
    /// Where the networks of each run are.
    pub device: DeviceChoice,
    /// All devices of a run, as `--device` names them.
    pub devices: String,
    /// Most runs side by side.
    pub jobs: usize,
    /// Begin although the memory is predicted not to suffice.
    pub ignore_memory: bool,
    /// Show no progress.
    pub quiet: bool,
    /// Becomes true when the study is to stop.
    pub stop: Arc<AtomicBool>,
}

/// What became of the runs.
#[derive(Clone, Debug, Default)]
pub struct Outcome {
    /// Runs that are finished.
    pub finished: usize,
    /// Names of those that failed, with the reason.
    pub failed: Vec<(String, String)>,
    /// Whether it was told to stop before the end.
    pub stopped: bool,
}

/// What the threads that attend to the processes tell.
enum Message {
    /// A line of the process of a run.
    Line(String, String),
    /// The end of the process of a run.
    Ended(String, std::io::Result<ExitStatus>),
}

/// A run that is going on.
struct Running<'a> {
    run: &'a StudyRun,
    /// Closed, it ends the process.
    input: Option<ChildStdin>,
    started: Instant,
    /// Steps that were counted so far.
    steps: u64,
    /// Predicted bytes of memory.
    bytes: f64,
    /// What it said last.
    last: String,
}

/// Does the runs that are not finished. What goes wrong with one is part of the outcome.
#[must_use]
pub fn work(study: &Study, runs: &[&StudyRun], options: &Options) -> Outcome {
    let mut outcome = Outcome::default();
    let mut waiting = VecDeque::new();
    let mut steps = 0;
    for run in runs.iter().copied() {
        match State::of(study, run, options.out) {
            Ok(State::Finished) => outcome.finished += 1,
            Ok(State::Foreign(reason)) => outcome.failed.push((run.name.clone(), reason)),
            Err(error) => outcome.failed.push((run.name.clone(), error.to_string())),
            Ok(state) => {
                steps += run.timeline.end.saturating_sub(state.steps(run));
                waiting.push_back(run);
            }
        }
    }
    let progress = Progress::new("study", steps, "steps", options.quiet);
    for (name, reason) in &outcome.failed {
        progress.println(&format!("{name} cannot be used: {reason}"));
    }
    let (sender, receiver) = channel();
    let mut crew = Crew {
        study,
        options,
        running: Vec::new(),
        budget: memory::free(),
        needs: HashMap::new(),
        sender,
    };
    let mut said_busy = false;
    loop {
        let told = options.stop.load(Ordering::Relaxed);
        if told {
            crew.running
                .iter_mut()
                .for_each(|running| running.input = None);
        } else {
            // Runs of other processes come last.
            for _ in 0..waiting.len() {
                let Some(run) = waiting.pop_front() else {
                    break;
                };
                if crew.is_full() || in_use(&options.out.join(run.folder())) {
                    waiting.push_back(run);
                    continue;
                }
                match crew.take(run) {
                    Ok(Taken::Waits) => waiting.push_back(run),
                    Ok(Taken::Running) => {}
                    Ok(Taken::Finished) => outcome.finished += 1,
                    Err(error) => {
                        progress.println(&format!("{} failed: {error}", run.name));
                        outcome.failed.push((run.name.clone(), error.to_string()));
                    }
                }
            }
            // In the study's order again.
            waiting
                .make_contiguous()
                .sort_by_key(|run| position(runs, run));
        }
        if crew.running.is_empty() && (told || waiting.is_empty()) {
            outcome.stopped = told && !waiting.is_empty() || outcome.stopped;
            break;
        }
        if crew.running.is_empty() && !said_busy {
            said_busy = true;
            let names: Vec<&str> = waiting.iter().map(|run| run.name.as_str()).collect();
            progress.println(&format!(
                "waiting for {}, where another process is training",
                names.join(", ")
            ));
        }
        match receiver.recv_timeout(LOOK_EVERY) {
            Ok(Message::Line(name, line)) => crew.line(&name, line, told, &progress),
            Ok(Message::Ended(name, status)) => {
                let Some(ended) = crew.remove(&name) else {
                    continue;
                };
                progress.add(ended.new_steps(options.out));
                match end_of(&ended, status, options) {
                    End::Finished => {
                        outcome.finished += 1;
                        if !options.quiet {
                            progress.println(&format!(
                                "{name} finished after {} ({} of {} runs)",
                                human::duration(ended.started.elapsed().as_secs_f64()),
                                outcome.finished,
                                runs.len()
                            ));
                        }
                    }
                    End::Again => waiting.push_back(ended.run),
                    End::Stopped => outcome.stopped = true,
                    End::Failed(reason) => {
                        progress.println(&format!("{name} failed: {reason}"));
                        outcome.failed.push((name, reason));
                    }
                }
            }
            Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => {}
        }
        progress.note(&crew.note(outcome.finished, runs.len()));
        for running in &mut crew.running {
            let new = running.new_steps(options.out);
            running.steps += new;
            progress.add(new);
        }
    }
    progress.finish();
    outcome
}

fn position(runs: &[&StudyRun], run: &StudyRun) -> usize {
    let place = runs.iter().position(|other| other.name == run.name);
    place.unwrap_or(runs.len())
}

/// How the process of a run ended.
enum End {
    Finished,
    /// Another process trains there.
    Again,
    Stopped,
    Failed(String),
}

fn end_of(ended: &Running, status: std::io::Result<ExitStatus>, options: &Options) -> End {
    let status = match status {
        Ok(status) if status.success() => return End::Finished,
        Ok(status) => status.to_string(),
        Err(error) => error.to_string(),
    };
    if options.stop.load(Ordering::Relaxed) {
        return End::Stopped;
    }
    if in_use(&options.out.join(ended.run.folder())) {
        return End::Again;
    }
    End::Failed(if ended.last.is_empty() {
        format!("it ended with {status}; it may have run out of memory")
    } else {
        ended.last.clone()
    })
}

/// The runs that are going on, and what is needed to begin more.
struct Crew<'a> {
    study: &'a Study,
    options: &'a Options<'a>,
    running: Vec<Running<'a>>,
    /// Bytes of memory for all runs together.
    budget: f64,
    /// Predicted bytes of the runs that were asked for.
    needs: HashMap<String, f64>,
    sender: Sender<Message>,
}

/// What became of a run whose turn it was.
enum Taken {
    /// The memory does not suffice for it now.
    Waits,
    Running,
    /// Another process has finished it since.
    Finished,
}

impl<'a> Crew<'a> {
    /// Begins a run if the memory suffices.
    fn take(&mut self, run: &'a StudyRun) -> Result<Taken> {
        // What a step needs is only asked where it matters: it takes the networks to know.
        let bytes = match self.options.jobs {
            1 => 0.0,
            _ => self.predicted(run)?,
        };
        let taken: f64 = self.running.iter().map(|running| running.bytes).sum();
        if !self.running.is_empty() && taken + bytes > self.budget {
            return Ok(Taken::Waits);
        }
        // It may have been trained by another process since.
        let state = State::of(self.study, run, self.options.out)?;
        match state {
            State::Finished => return Ok(Taken::Finished),
            State::Foreign(reason) => return Err(Error::Study(reason)),
            State::NotBegun | State::Begun { .. } => {}
        }
        let input = self.start(run, &state)?;
        self.running.push(Running {
            run,
            input,
            started: Instant::now(),
            steps: state.steps(run),
            bytes,
            last: String::new(),
        });
        Ok(Taken::Running)
    }

    fn is_full(&self) -> bool {
        self.running.len() >= self.options.jobs
    }

    /// Predicted bytes of a run; 0 where nothing is predicted.
    fn predicted(&mut self, run: &StudyRun) -> Result<f64> {
        if self.options.device != DeviceChoice::Cpu || self.options.ignore_memory {
            return Ok(0.0);
        }
        if let Some(bytes) = self.needs.get(&run.name) {
            return Ok(*bytes);
        }
        let trainer = Trainer::new(&run.config, None, &self.options.device.open()?);
        let bytes = Need::predict(&run.config, &trainer).bytes(run.config.batch);
        self.needs.insert(run.name.clone(), bytes);
        Ok(bytes)
    }

    /// Starts the process of a run, and a thread that attends to it.
    fn start(&self, run: &StudyRun, state: &State) -> Result<Option<ChildStdin>> {
        let options = self.options;
        let folder = options.out.join(run.folder());
        let mut command = Command::new(std::env::current_exe()?);
        if let State::Begun { .. } = state {
            command.arg("--resume");
            if let Some(steps) = run.config.max_steps {
                command.args(["--max-steps", &steps.to_string()]);
            }
        } else {
            // The run writes the same file again as its own.
            let path = folder.join(CONFIG);
            files::write_atomic(&path, run.config.to_yaml()?.as_bytes())?;
            command.arg("--config").arg(path);
        }
        command.arg("--data").arg(&self.study.set(run).folder);
        command.arg("--out").arg(&folder);
        command.args(["--device", &options.devices, "--quiet", "--end-with-stdin"]);
        if options.ignore_memory {
            command.arg("--ignore-memory");
        }
        memory::share_cores(&mut command, options.jobs);
        command
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped());
        let mut child = command.spawn()?;
        let input = child.stdin.take();
        let (errors, sender, name) = (child.stderr.take(), self.sender.clone(), run.name.clone());
        std::thread::spawn(move || {
            // Who no longer listens has ended.
            for line in errors.into_iter().flat_map(|e| BufReader::new(e).lines()) {
                let Ok(line) = line else { break };
                let _ = sender.send(Message::Line(name.clone(), line));
            }
            let _ = sender.send(Message::Ended(name, child.wait()));
        });
        Ok(input)
    }

    /// Shows what a run says, and remembers it.
    fn line(&mut self, name: &str, line: String, told: bool, progress: &Progress) {
        if let Some(running) = self.running.iter_mut().find(|r| r.run.name == name) {
            match line.strip_prefix("error: ") {
                // Said with the end of the run.
                Some(error) => running.last = error.to_owned(),
                None => {
                    if !told {
                        progress.println(&format!("{name}: {line}"));
                    }
                    running.last = line;
                }
            }
        }
    }

    fn remove(&mut self, name: &str) -> Option<Running<'a>> {
        let place = self.running.iter().position(|r| r.run.name == name)?;
        Some(self.running.remove(place))
    }

    fn note(&self, finished: usize, all: usize) -> String {
        let mut note = format!("{finished} of {all} runs finished");
        for Running { run, steps, .. } in &self.running {
            let epoch = run.timeline.epoch_number(*steps).min(run.timeline.epochs);
            note.push_str(&format!(
                ", {} epoch {epoch}/{}",
                run.name, run.timeline.epochs
            ));
        }
        note
    }
}

impl Running<'_> {
    /// Steps since they were last counted.
    fn new_steps(&self, out: &Path) -> u64 {
        let newest = newest_step(&out.join(self.run.folder()));
        let done = newest.map_or(0, |step| step + 1).min(self.run.timeline.end);
        done.saturating_sub(self.steps)
    }
}
