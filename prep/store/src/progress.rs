//! How far a long job is, on stderr.
//!
//! A bar with rate and time left on a terminal; elsewhere (a log file, a batch system) a
//! plain line after five seconds, ten more, and so on up to a line each minute. Never on stdout, which belongs to results.

use std::io::IsTerminal;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use crate::command::eprint_line;
use crate::human;

/// How long the first line in a log takes to come, and the least time between two.
const FIRST_LINE: Duration = Duration::from_secs(5);

/// The most time between two lines; each takes twice as long as the one before it, up to this.
const LINE_EVERY: Duration = Duration::from_secs(60);

/// Progress of one job. Cheap to update and usable from many threads.
pub struct Progress {
    label: String,
    unit: String,
    total: u64,
    done: AtomicU64,
    started: Instant,
    shown: Shown,
}

enum Shown {
    Nothing,
    Bar(ProgressBar),
    Lines(Mutex<Lines>),
}

struct Lines {
    last: Instant,
    wait: Duration,
    note: String,
}

impl Progress {
    /// Starts showing a job of `total` steps called `unit` ("frames"). `quiet` shows nothing.
    pub fn new(label: &str, total: u64, unit: &str, quiet: bool) -> Self {
        let started = Instant::now();
        let shown = if quiet {
            Shown::Nothing
        } else if std::io::stderr().is_terminal() {
            let bar = ProgressBar::with_draw_target(Some(total), ProgressDrawTarget::stderr());
            let template =
                "{prefix} {wide_bar} {human_pos}/{human_len} UNIT, {per_sec}, {eta} left {msg}";
            if let Ok(style) = ProgressStyle::with_template(&template.replace("UNIT", unit)) {
                bar.set_style(style);
            }
            bar.set_prefix(label.to_owned());
            bar.enable_steady_tick(Duration::from_millis(250));
            Shown::Bar(bar)
        } else {
            Shown::Lines(Mutex::new(Lines {
                last: started,
                wait: FIRST_LINE,
                note: String::new(),
            }))
        };
        Self {
            label: label.to_owned(),
            unit: unit.to_owned(),
            total,
            done: AtomicU64::new(0),
            started,
            shown,
        }
    }

    /// Counts `n` more steps as done.
    pub fn add(&self, n: u64) {
        let done = self.done.fetch_add(n, Ordering::Relaxed) + n;
        match &self.shown {
            Shown::Nothing => {}
            Shown::Bar(bar) => bar.inc(n),
            // Whoever finds the lock taken leaves the line to its holder.
            Shown::Lines(lines) => {
                if let Ok(mut lines) = lines.try_lock()
                    && lines.last.elapsed() >= lines.wait
                {
                    lines.last = Instant::now();
                    lines.wait = (2 * lines.wait).min(LINE_EVERY);
                    eprint_line(self.line(done, self.started.elapsed(), &lines.note));
                }
            }
        }
    }

    /// Shows a short changing text behind the counts, e.g. the current loss.
    pub fn note(&self, message: &str) {
        match &self.shown {
            Shown::Nothing => {}
            Shown::Bar(bar) => bar.set_message(message.to_owned()),
            Shown::Lines(lines) => {
                message.clone_into(&mut lines.lock().unwrap_or_else(PoisonError::into_inner).note);
            }
        }
    }

    /// Prints a line on stderr without disturbing the bar. Shown even when quiet: it is meant
    /// for what went wrong.
    pub fn println(&self, line: &str) {
        match &self.shown {
            Shown::Bar(bar) => bar.suspend(|| eprint_line(line)),
            Shown::Nothing | Shown::Lines(_) => eprint_line(line),
        }
    }

    /// Ends the display; says how much was done and how fast.
    pub fn finish(&self) {
        if let Shown::Bar(bar) = &self.shown {
            bar.finish_and_clear();
        }
        if !matches!(self.shown, Shown::Nothing) {
            eprint_line(self.line(
                self.done.load(Ordering::Relaxed),
                self.started.elapsed(),
                "",
            ));
        }
    }

    fn line(&self, done: u64, elapsed: Duration, note: &str) -> String {
        let seconds = elapsed.as_secs_f64();
        let rate = if seconds > 0.0 {
            done as f64 / seconds
        } else {
            0.0
        };
        let end = if done >= self.total {
            format!("{} in all", human::duration(seconds))
        } else if rate > 0.0 {
            format!(
                "{} left",
                human::duration((self.total - done) as f64 / rate)
            )
        } else {
            "time left unknown".to_owned()
        };
        let note = if note.is_empty() {
            String::new()
        } else {
            format!(", {note}")
        };
        format!(
            "{}: {done}/{} {}, {rate:.1}/s, {end}{note}",
            self.label, self.total, self.unit
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_state_count_rate_and_time_left() {
        let progress = Progress::new("prep eigen", 697, "frames", true);
        assert_eq!(
            progress.line(120, Duration::from_secs(4), ""),
            "prep eigen: 120/697 frames, 30.0/s, 19 s left"
        );
        assert_eq!(
            progress.line(697, Duration::from_secs(100), "loss 0.31"),
            "prep eigen: 697/697 frames, 7.0/s, 1 min 40 s in all, loss 0.31"
        );
        assert_eq!(
            progress.line(0, Duration::from_secs(7), ""),
            "prep eigen: 0/697 frames, 0.0/s, time left unknown"
        );
    }

    #[test]
    fn many_threads_may_count() {
        let progress = Progress::new("job", 400, "steps", true);
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| (0..100).for_each(|_| progress.add(1)));
            }
        });
        assert_eq!(progress.done.load(Ordering::Relaxed), 400);
        progress.finish();
    }
}
