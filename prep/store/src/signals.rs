//! Being told to stop: an interrupt (Ctrl-C), termination (a cluster's time limit), a hang-up (a
//! closed terminal).
//!
//! All three mean the same everywhere. Work that keeps what it has done and goes on later runs
//! under a [`Watch`]: the first signal is remembered, the work comes to a good end and says how to
//! go on. A second signal, and any signal outside of a watch, ends the process at once.

use std::process::exit;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Mutex, Once, PoisonError};

use crate::command::eprint_line;
use crate::error::{Error, Result};

/// Exit code of a process that a signal ended at once, as shells give it for an interrupt.
const INTERRUPTED: i32 = 130;

/// Watches that are alive; a signal without one ends the process.
static WATCHED: AtomicU32 = AtomicU32::new(0);

/// The flag of the newest watch, and what is said when it is set.
static NEWEST: Mutex<Option<(Arc<AtomicBool>, &'static str)>> = Mutex::new(None);

/// As long as it lives, a first signal is remembered.
#[derive(Debug)]
pub struct Watch {
    told: Arc<AtomicBool>,
}

impl Watch {
    /// Begins to watch. `sentence` is said at the first signal.
    pub fn new(sentence: &'static str) -> Self {
        static INSTALLED: Once = Once::new();
        // A handler that somebody else has installed stays, and then nothing is remembered.
        INSTALLED.call_once(|| drop(ctrlc::set_handler(signalled)));
        let told = Arc::new(AtomicBool::new(false));
        *NEWEST.lock().unwrap_or_else(PoisonError::into_inner) = Some((told.clone(), sentence));
        WATCHED.fetch_add(1, Ordering::SeqCst);
        Self { told }
    }

    /// Whether there was a signal.
    pub fn told(&self) -> bool {
        self.told.load(Ordering::Relaxed)
    }

    /// Ends work that was told to stop.
    ///
    /// # Errors
    /// There was a signal.
    pub fn check(&self) -> Result<()> {
        if self.told() {
            return Err(Error::Interrupted);
        }
        Ok(())
    }

    /// Becomes true with the first signal.
    pub fn flag(&self) -> Arc<AtomicBool> {
        Arc::clone(&self.told)
    }
}

impl Drop for Watch {
    fn drop(&mut self) {
        WATCHED.fetch_sub(1, Ordering::SeqCst);
    }
}

/// Signals that were heard.
static HEARD: AtomicU32 = AtomicU32::new(0);

/// Sends this process a signal and waits until it is heard, or has ended the process: for tests.
#[cfg(debug_assertions)]
pub(crate) fn send_to_self(name: &str) {
    let before = HEARD.load(Ordering::SeqCst);
    let process = std::process::id().to_string();
    let told = std::process::Command::new("kill")
        .args(["-s", name, &process])
        .status();
    while told.is_ok() && HEARD.load(Ordering::SeqCst) == before {
        std::thread::yield_now();
    }
}

/// On a thread of its own, so that it may print and lock.
fn signalled() {
    remember();
    HEARD.fetch_add(1, Ordering::SeqCst);
}

fn remember() {
    let newest = NEWEST.lock().unwrap_or_else(PoisonError::into_inner);
    match &*newest {
        Some((told, sentence)) if WATCHED.load(Ordering::SeqCst) > 0 => {
            if told.swap(true, Ordering::SeqCst) {
                exit(INTERRUPTED);
            }
            eprint_line(format_args!("{sentence}; a second signal stops at once"));
        }
        _ => exit(INTERRUPTED),
    }
}

/// Makes a limit on the size of files (`ulimit -f`) an error of the write that meets it; by default
/// it ends the process. For the beginning of a command.
pub fn tell_size_limits() {
    #[cfg(unix)]
    {
        let unused = Arc::new(AtomicBool::new(false));
        let _ = signal_hook::flag::register(signal_hook::consts::SIGXFSZ, unused);
    }
}
