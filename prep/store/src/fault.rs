//! Faults of the file system at a chosen place, for tests that try all of them.
//!
//! Every change that the three commands make to files (a file begun, bytes written, a rename, a
//! removal, a new folder) passes [`point`], which counts. In a debug build, `STRAT_FAULT_AT=7` ends
//! the process before the seventh change, as a kill would; with `STRAT_FAULT=ENOSPC`, `EIO` or
//! `EMFILE` that change fails instead, once, and with `INT`, `TERM` or `HUP` the process is sent that
//! signal before it. Release builds know nothing of it.

use std::io::{self, Seek, SeekFrom, Write};

/// Environment variable with the number of the change, from 1.
pub const AT: &str = "STRAT_FAULT_AT";

/// Environment variable with the error that the change fails with, or a signal; the process ends where
/// it is not set.
pub const ERROR: &str = "STRAT_FAULT";

/// Environment variable with a file that gets a line for each change: the number of the process that made it.
pub const CHANGES: &str = "STRAT_FAULT_COUNT";

/// Signals by the names that `kill` takes.
pub const SIGNALS: [&str; 3] = ["INT", "TERM", "HUP"];

/// Names of errors with their numbers in Linux.
pub const ERRORS: [(&str, i32); 3] = [("EIO", 5), ("EMFILE", 24), ("ENOSPC", 28)];

/// Counts a change that is about to be made.
///
/// # Errors
/// It is the chosen one.
#[cfg(debug_assertions)]
pub fn point() -> io::Result<()> {
    use std::sync::LazyLock;
    use std::sync::atomic::{AtomicU64, Ordering};

    static CHOSEN: LazyLock<Option<u64>> = LazyLock::new(|| std::env::var(AT).ok()?.parse().ok());
    static COUNT: AtomicU64 = AtomicU64::new(0);
    static TALLY: LazyLock<Option<std::path::PathBuf>> =
        LazyLock::new(|| std::env::var_os(CHANGES).map(Into::into));
    if let Some(tally) = &*TALLY {
        let mut file = std::fs::File::options()
            .append(true)
            .create(true)
            .open(tally)?;
        file.write_all(format!("{}\n", std::process::id()).as_bytes())?;
    }
    let Some(chosen) = *CHOSEN else { return Ok(()) };
    if COUNT.fetch_add(1, Ordering::Relaxed) + 1 != chosen {
        return Ok(());
    }
    let wanted = std::env::var(ERROR).unwrap_or_default();
    if SIGNALS.contains(&wanted.as_str()) {
        crate::signals::send_to_self(&wanted);
        return Ok(());
    }
    match ERRORS.into_iter().find(|(name, _)| *name == wanted) {
        Some((_, number)) => Err(io::Error::from_raw_os_error(number)),
        // No destructor runs, as after SIGKILL.
        None => std::process::abort(),
    }
}

/// Does nothing in release builds.
///
/// # Errors
/// None.
#[cfg(not(debug_assertions))]
#[inline]
pub fn point() -> io::Result<()> {
    Ok(())
}

/// A writer of which every write is a change.
#[derive(Debug)]
pub(crate) struct Counted<W>(pub W);

impl<W: Write> Write for Counted<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        point()?;
        self.0.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.0.flush()
    }
}

impl<W: Seek> Seek for Counted<W> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.0.seek(to)
    }
}
