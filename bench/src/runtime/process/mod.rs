//! A model in a process of its own, with limits on its memory and time.
//!
//! An ONNX file is a program: it can loop for ever, ask for terabytes, or crash the runtime that
//! runs it. So `bench` starts itself once for each model that is loaded; the other process
//! ([`super::serve`]) loads the model and runs it on the tensors that it is given ([`frame`]), and a thread
//! here ends it when it takes too much. What happens to it costs that model a sentence. Everything
//! else, from files to rows, stays in this process and knows nothing of it.
//!
//! The other process ends with this one: its input closes. It is in a process group of its own, so
//! that Ctrl-C reaches only this one, which decides what is put down first.

pub mod frame;

#[cfg(unix)]
use std::os::unix::process::CommandExt as _;
use std::{
    ffi::OsString,
    io,
    path::Path,
    process::{Child, ChildStdin, ChildStdout, Command, Stdio},
    sync::{
        Arc, Condvar, Mutex, MutexGuard, OnceLock, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
    thread::JoinHandle,
    time::{Duration, Instant},
};

use serde::{Deserialize, Serialize};
use strat_store::human;
use sysinfo::{Pid, ProcessRefreshKind, ProcessesToUpdate, System};

use super::{choice::RuntimeChoice, device::Device, error::RuntimeError, output::Output};

/// The subcommand that is [`super::serve`].
pub const COMMAND: &str = "model-process";

/// How long a model may take to load, in times per image: some providers compile it first.
const LOADING: f64 = 10.0;

/// How often memory and time are looked at.
const TICK: Duration = Duration::from_millis(50);

/// How a program that serves [`COMMAND`] is started; no words where its file alone does it.
static SERVED: OnceLock<Vec<OsString>> = OnceLock::new();

/// To be said by a program that passes [`COMMAND`] on to [`super::serve`]. Others, such as tests that call
/// the command line as a function, would start themselves for each model and have no end; there, models
/// run within the process.
pub fn is_served_here() {
    is_served_by(Vec::new());
}

/// The same for a program that `bench` is a part of, such as Python: its file, and what stands before
/// the subcommand. What is said first counts.
pub fn is_served_by(words: Vec<OsString>) {
    let _ = SERVED.set(words);
}

/// `limits`, where this program can hold models to them.
#[must_use]
pub fn possible(limits: Limits) -> Option<Limits> {
    SERVED.get().map(|_| limits)
}

/// What a model may take.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Bytes of memory of its process.
    pub memory_bytes: u64,
    /// Seconds for each image.
    pub seconds: f64,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            memory_bytes: 8_000_000_000,
            seconds: 60.0,
        }
    }
}

/// Time that has gone into the way to a model's process and back; copies show the same.
#[derive(Clone, Debug, Default)]
pub struct Transport(Arc<AtomicU64>);

impl Transport {
    /// The time so far.
    #[must_use]
    pub fn so_far(&self) -> Duration {
        Duration::from_nanos(self.0.load(Ordering::Relaxed))
    }

    fn add(&self, time: Duration) {
        let nanos = u64::try_from(time.as_nanos()).unwrap_or(u64::MAX);
        self.0.fetch_add(nanos, Ordering::Relaxed);
    }
}

/// How a loaded model introduces itself.
#[derive(Debug, Serialize, Deserialize)]
pub(super) enum Started {
    Ready {
        runtime: String,
        provider: String,
        placement: Vec<(String, usize)>,
    },
    Refused(String),
}

/// A request; the input's values follow.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Ask {
    pub input: String,
    pub wanted: String,
    pub shape: [usize; 4],
}

/// The answer to it; the values of the wanted output follow.
#[derive(Debug, Serialize, Deserialize)]
pub(super) enum Answer {
    Outputs {
        /// Names and shapes of all.
        all: Vec<(String, Vec<usize>)>,
        /// How long the model ran.
        run: Duration,
    },
    Failed(String),
}

/// A process that has loaded a model.
pub(super) struct Worker {
    requests: Option<ChildStdin>,
    answers: ChildStdout,
    watched: Arc<Watched>,
    watch: Option<JoinHandle<()>>,
    limits: Limits,
    pub transport: Transport,
}

/// What the process is and what it may do.
struct Watched {
    state: Mutex<State>,
    changed: Condvar,
}

struct State {
    child: Child,
    /// When it has to have answered.
    deadline: Option<Instant>,
    /// Why it was ended.
    verdict: Option<String>,
    closed: bool,
}

impl Watched {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether the process holds too much memory, which then is the verdict.
    fn over_memory(&self, system: &mut System, limits: Limits) -> bool {
        let mut state = self.lock();
        let verdict = over_memory(system, &state.child, limits);
        if verdict.is_some() {
            state.verdict = verdict;
        }
        state.verdict.is_some()
    }
}

/// What was loaded: the runtime, the provider, and how many nodes each provider holds.
pub(super) type Loaded = (String, String, Vec<(String, usize)>);

impl Worker {
    /// Starts a process that loads a model.
    pub fn start(
        choice: RuntimeChoice,
        model: &Path,
        device: Device,
        threads: usize,
        limits: Limits,
    ) -> Result<(Self, Loaded), RuntimeError> {
        let no_process = |error: io::Error| RuntimeError::NoProcess {
            reason: error.to_string(),
        };
        let mut command = own_program().map_err(no_process)?;
        command
            .args([COMMAND, choice.word(), &device.to_string()])
            .arg(threads.to_string())
            .arg("--")
            .arg(OsString::from(model))
            .stdin(Stdio::piped())
            .stdout(Stdio::piped());
        // Runtimes write there what they also return; a crash would add its own.
        if std::env::var_os("STRAT_ORT_LOG").is_none() {
            command.stderr(Stdio::null());
        }
        #[cfg(unix)]
        command.process_group(0);
        let mut child = command.spawn().map_err(no_process)?;
        let (requests, answers) = (child.stdin.take(), child.stdout.take());
        let missing = || no_process(io::ErrorKind::BrokenPipe.into());
        let answers = answers.ok_or_else(missing)?;
        let watched = Arc::new(Watched {
            state: Mutex::new(State {
                child,
                deadline: None,
                verdict: None,
                closed: false,
            }),
            changed: Condvar::new(),
        });
        let watch = std::thread::Builder::new().name("watch".to_owned()).spawn({
            let watched = Arc::clone(&watched);
            move || watch(&watched, limits)
        });
        let mut worker = Self {
            requests,
            answers,
            watched,
            watch: watch.ok(),
            limits,
            transport: Transport::default(),
        };
        match worker.answer(LOADING * limits.seconds)? {
            (Started::Refused(reason), _) => Err(RuntimeError::Told { reason }),
            (
                Started::Ready {
                    runtime,
                    provider,
                    placement,
                },
                _,
            ) => match worker.watched.over_memory(&mut System::new(), limits) {
                // Before a tick has passed, too.
                true => Err(worker.ended()),
                false => Ok((worker, (runtime, provider, placement))),
            },
        }
    }

    /// Runs the model; of the outputs only the `wanted` one has its values.
    pub fn run(
        &mut self,
        input: &str,
        shape: [usize; 4],
        data: &[f32],
        wanted: &str,
    ) -> Result<Vec<Output>, RuntimeError> {
        let started = Instant::now();
        let ask = Ask {
            input: input.to_owned(),
            wanted: wanted.to_owned(),
            shape,
        };
        let sent = match &mut self.requests {
            Some(requests) => frame::write(requests, &ask, data),
            None => Err(io::ErrorKind::BrokenPipe.into()),
        };
        if sent.is_err() {
            return Err(self.ended());
        }
        let images = shape[0].max(1) as f64;
        match self.answer(images * self.limits.seconds)? {
            (Answer::Failed(reason), _) => Err(RuntimeError::Told { reason }),
            (Answer::Outputs { all, run }, values) => {
                self.transport.add(started.elapsed().saturating_sub(run));
                let mut values = Some(values);
                let output = |(name, shape): (String, Vec<usize>)| Output {
                    data: match name == wanted {
                        true => values.take().unwrap_or_default(),
                        false => Vec::new(),
                    },
                    name,
                    shape,
                };
                Ok(all.into_iter().map(output).collect())
            }
        }
    }

    /// Whether the process has ended, so that nothing more can be asked.
    pub fn has_ended(&self) -> bool {
        self.requests.is_none()
    }

    /// Waits for an answer.
    fn answer<T: serde::de::DeserializeOwned>(
        &mut self,
        seconds: f64,
    ) -> Result<(T, Vec<f32>), RuntimeError> {
        // A limit beyond what an instant can hold is none.
        let limit = Duration::try_from_secs_f64(seconds).ok();
        self.watched.lock().deadline = limit.and_then(|limit| Instant::now().checked_add(limit));
        let read = frame::read(&mut self.answers);
        self.watched.lock().deadline = None;
        match read {
            Ok(Some(answer)) => Ok(answer),
            Ok(None) | Err(_) => Err(self.ended()),
        }
    }

    /// Why there is no answer; the process is over with that.
    fn ended(&mut self) -> RuntimeError {
        self.requests = None;
        let mut state = self.watched.lock();
        let _ = state.child.kill();
        let status = state.child.wait();
        let reason = state.verdict.get_or_insert_with(|| {
            let status = status.map_or_else(|error| error.to_string(), |status| status.to_string());
            format!("the process that ran it ended by itself ({status}), as after a fault in the runtime")
        });
        RuntimeError::Ended {
            reason: reason.clone(),
        }
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        self.requests = None;
        {
            let mut state = self.watched.lock();
            state.closed = true;
            let _ = state.child.kill();
            let _ = state.child.wait();
        }
        self.watched.changed.notify_all();
        if let Some(watch) = self.watch.take() {
            let _ = watch.join();
        }
    }
}

/// Ends the process when it takes too much.
fn watch(watched: &Watched, limits: Limits) {
    let mut system = System::new();
    let mut state = watched.lock();
    let mut last = Instant::now();
    loop {
        state = watched
            .changed
            .wait_timeout(state, TICK)
            .unwrap_or_else(PoisonError::into_inner)
            .0;
        if state.closed {
            return;
        }
        let now = Instant::now();
        let passed = now - last;
        last = now;
        if passed > 20 * TICK {
            // This process was stopped or the machine asleep; that is not the model's time.
            state.deadline = state.deadline.and_then(|at| at.checked_add(passed));
        }
        let late = state.deadline.is_some_and(|at| now > at);
        let verdict = if late {
            Some(format!(
                "it was ended: it took more than {} for an image (ten times as long for loading); \
                 --max-seconds allows more",
                human::duration(limits.seconds)
            ))
        } else {
            over_memory(&mut system, &state.child, limits)
        };
        if verdict.is_some() {
            state.verdict = verdict;
            let _ = state.child.kill();
            return;
        }
    }
}

/// That a process holds too much memory, as a sentence; `None` where the system does not tell.
fn over_memory(system: &mut System, child: &Child, limits: Limits) -> Option<String> {
    let pid = Pid::from_u32(child.id());
    let what = ProcessRefreshKind::nothing().with_memory().without_tasks();
    system.refresh_processes_specifics(ProcessesToUpdate::Some(&[pid]), true, what);
    let held = system.process(pid)?.memory();
    (held > limits.memory_bytes).then(|| {
        format!(
            "it was ended: it took more than {} of memory; --max-memory allows more",
            human::bytes(limits.memory_bytes)
        )
    })
}

/// This program, even when its file was replaced meanwhile.
fn own_program() -> io::Result<Command> {
    if let Some((program, arguments)) = SERVED.get().and_then(|words| words.split_first()) {
        let mut command = Command::new(program);
        command.args(arguments);
        return Ok(command);
    }
    let link = Path::new("/proc/self/exe");
    let mut command = Command::new(match link.exists() {
        true => link.to_owned(),
        false => std::env::current_exe()?,
    });
    #[cfg(unix)]
    command.arg0("bench");
    Ok(command)
}
