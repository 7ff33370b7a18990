//! What `prep`, `train` and `bench` share at the terminal: exit codes, errors and printing.
//!
//! | code | meaning | examples |
//! |---|---|---|
//! | 0 | done | also for `--help`, and when the reader of stdout has seen enough (`\| head`) |
//! | 1 | failed or incomplete | a damaged file, a full disk, a table over part of its images |
//! | 2 | wrong usage | contradicting options, no prepared set at `--data`, an unusable `--out` |
//!
//! Results go to stdout, everything else to stderr. Not here: arguments, which each command parses
//! itself, and [`crate::progress`].

use std::error::Error as StdError;
use std::ffi::OsString;
use std::fmt::Display;
use std::io::{self, Write};

use anstyle::AnsiColor;

use crate::error::Error;

/// Exit code of a command that did what was asked.
pub const DONE: u8 = 0;

/// Exit code of a command that failed, or whose result is incomplete.
pub const FAILED: u8 = 1;

/// Exit code of a command that was called wrongly.
pub const USAGE: u8 = 2;

/// Why a command ends early: a sentence for the user and, by its variant, the exit code.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum CliError {
    /// The command line contradicts itself or names something that cannot be used.
    #[error("{0}")]
    Usage(String),
    /// The work itself failed.
    #[error("{0}")]
    Failed(String),
}

impl CliError {
    /// An error, with its causes, that the command line is to blame for.
    pub fn usage(error: impl Into<Box<dyn StdError + Send + Sync>>) -> Self {
        Self::Usage(error_chain(&*error.into()))
    }

    /// An error, with its causes, that the work is to blame for.
    pub fn failed(error: impl Into<Box<dyn StdError + Send + Sync>>) -> Self {
        Self::Failed(error_chain(&*error.into()))
    }
}

impl From<Error> for CliError {
    fn from(error: Error) -> Self {
        match exit_code(&error) {
            USAGE => Self::usage(error),
            _ => Self::failed(error),
        }
    }
}

/// The exit code of an error: that of the first [`CliError`] among it and its causes; [`USAGE`] for
/// a folder that is no prepared set, or an output that cannot be written or is not the command's own; else [`FAILED`].
pub fn exit_code(error: &(dyn StdError + 'static)) -> u8 {
    let mut next = Some(error);
    while let Some(error) = next {
        match error.downcast_ref() {
            Some(CliError::Usage(_)) => return USAGE,
            Some(CliError::Failed(_)) => return FAILED,
            None => {}
        }
        match error.downcast_ref() {
            Some(Error::Set { .. } | Error::Output { .. }) => return USAGE,
            Some(Error::Unwritable { source, .. }) if is_refusal(source) => return USAGE,
            _ => {}
        }
        next = error.source();
    }
    FAILED
}

/// Whether a folder cannot be written to for what it is, and not because a disk is full or broken.
fn is_refusal(error: &io::Error) -> bool {
    use io::ErrorKind::{
        AlreadyExists, InvalidFilename, InvalidInput, IsADirectory, NotADirectory, NotFound,
        PermissionDenied, ReadOnlyFilesystem,
    };
    matches!(
        error.kind(),
        AlreadyExists
            | InvalidFilename
            | InvalidInput
            | IsADirectory
            | NotADirectory
            | NotFound
            | PermissionDenied
            | ReadOnlyFilesystem
    )
}

/// The arguments of a command, refused where one is no UTF-8: records of what ran could not hold it.
///
/// # Errors
/// One is not.
pub fn utf8_arguments(args: impl IntoIterator<Item = OsString>) -> Result<Vec<OsString>, CliError> {
    let args: Vec<OsString> = args.into_iter().collect();
    match args.iter().find(|argument| argument.to_str().is_none()) {
        Some(odd) => Err(CliError::Usage(format!(
            "the argument {odd:?} is not UTF-8; rename the file or folder, or give a link to it"
        ))),
        None => Ok(args),
    }
}

/// Prints `error: ...` with all causes on stderr and returns the [`exit_code`].
pub fn fail(error: &(dyn StdError + 'static)) -> u8 {
    eprint_line(format_args!("error: {}", error_chain(error)));
    exit_code(error)
}

/// An error and its causes as one sentence; a cause that is already stated is not repeated.
pub fn error_chain(error: &dyn StdError) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        let sentence = error.to_string();
        if !text.contains(&sentence) {
            text = format!("{text}: {sentence}");
        }
        cause = error.source();
    }
    without_numbers(&text)
}

/// A sentence without the numbers of the operating system, which say nothing that its words do not:
/// `File exists (os error 17)`.
fn without_numbers(text: &str) -> String {
    const BEFORE: &str = " (os error ";
    let mut left = text;
    let mut plain = String::new();
    while let Some((words, rest)) = left.split_once(BEFORE) {
        plain += words;
        let digits = rest.trim_start_matches(|letter: char| letter.is_ascii_digit());
        match digits.strip_prefix(')') {
            Some(rest) => left = rest,
            None => {
                plain += BEFORE;
                left = rest;
            }
        }
    }
    plain + left
}

/// Prints results on stdout. A reader that went away is no error.
///
/// # Errors
/// They cannot be written, e.g. into a file on a full disk.
pub fn print(text: impl Display) -> Result<(), CliError> {
    print_to(&mut io::stdout().lock(), text)
}

/// Like [`print()`], with a line feed behind the text.
///
/// # Errors
/// As [`print()`].
pub fn print_line(text: impl Display) -> Result<(), CliError> {
    print(format_args!("{text}\n"))
}

/// Prints a line on stderr; on a terminal the word that it begins with (`error:`, `warning:`, `note:`) has a
/// colour. A stderr that is closed or full is no reason to stop.
pub fn eprint_line(text: impl Display) {
    let text = text.to_string();
    let marked = MARKS
        .iter()
        .find_map(|(word, colour)| Some((word, colour, text.strip_prefix(word)?)));
    let mut stderr = anstream::AutoStream::auto(io::stderr().lock());
    let _ = match marked {
        Some((word, colour, rest)) => {
            let style = colour.on_default().bold();
            writeln!(stderr, "{style}{word}{style:#}{rest}")
        }
        None => writeln!(stderr, "{text}"),
    };
}

/// Words that lines on stderr begin with, and their colours.
const MARKS: [(&str, AnsiColor); 3] = [
    ("error:", AnsiColor::Red),
    ("warning:", AnsiColor::Yellow),
    ("note:", AnsiColor::Cyan),
];

fn print_to(out: &mut impl Write, text: impl Display) -> Result<(), CliError> {
    match write!(out, "{text}").and_then(|()| out.flush()) {
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => Err(CliError::Failed(format!(
            "the results cannot be printed: {error}"
        ))),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use std::path::{Path, PathBuf};

    use super::*;
    use crate::inputs::{self, Kind};
    use crate::set::PreparedSet;
    use crate::{files, threads};

    /// An error above another, as `anyhow`'s context is.
    #[derive(Debug, thiserror::Error)]
    #[error("{text}")]
    struct Above<E: StdError + 'static> {
        text: &'static str,
        source: E,
    }

    fn above<E: StdError + 'static>(text: &'static str, source: E) -> Above<E> {
        Above { text, source }
    }

    #[test]
    fn every_error_has_its_code() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        std::fs::write(&file, b"").unwrap();
        let no_set = PreparedSet::open(&folder.path().join("none")).unwrap_err();
        let no_folder = files::check_writable(&file).unwrap_err();
        let no_file = inputs::read(&folder.path().join("none"), Kind::Table).unwrap_err();
        let no_threads = Error::Threads {
            threads: 9,
            reason: String::new(),
        };
        for (error, code) in [
            (&no_set, USAGE),
            (&no_folder, USAGE),
            (&no_file, FAILED),
            (&no_threads, FAILED),
        ] {
            assert_eq!(exit_code(error), code, "{error}");
        }
        assert_eq!(exit_code(&above("while testing", no_set)), USAGE);
        let usage = CliError::Usage("a contradicts b".to_owned());
        assert_eq!(exit_code(&above("outer", above("inner", usage))), USAGE);
        // Who says so explicitly has the last word.
        let failed = CliError::Failed(String::new());
        assert_eq!(exit_code(&above("", failed)), FAILED);
        assert!(threads::pool("test", 1).is_ok());
    }

    #[cfg(unix)]
    #[test]
    fn arguments_are_text() {
        use std::os::unix::ffi::OsStringExt;
        let args = |last: &[u8]| {
            utf8_arguments([b"prep", last].map(|text| OsString::from_vec(text.to_vec())))
        };
        assert_eq!(args("Straße".as_bytes()).unwrap().len(), 2);
        let refused = args(b"caf\xe9").unwrap_err();
        assert!(
            matches!(&refused, CliError::Usage(text) if text.contains("caf\\xE9")),
            "{refused}"
        );
    }

    #[test]
    fn errors_keep_their_kind_and_their_sentence() {
        let set = |problem: &str| Error::Set {
            path: PathBuf::from("a"),
            problem: problem.to_owned(),
        };
        let sentence = set("it is empty").to_string();
        assert_eq!(
            CliError::from(set("it is empty")),
            CliError::Usage(sentence)
        );
        let io = inputs::read(Path::new("/no/such/file"), Kind::Table).unwrap_err();
        assert!(
            matches!(CliError::from(io), CliError::Failed(text) if text.contains("/no/such/file"))
        );
    }

    #[test]
    fn numbers_of_the_system_are_left_out() {
        assert_eq!(
            without_numbers("cannot create a: File exists (os error 17); b (os error x)"),
            "cannot create a: File exists; b (os error x)"
        );
    }

    #[test]
    fn a_cause_is_stated_once() {
        let cause = io::Error::other("the disk is tired");
        let outer = above(
            "cannot write rows.csv",
            above("line 7: the disk is tired", cause),
        );
        assert_eq!(
            error_chain(&outer),
            "cannot write rows.csv: line 7: the disk is tired"
        );
    }

    /// Fails as the system does when a pipe is closed or a disk full.
    struct Closed(io::ErrorKind);

    impl Write for Closed {
        fn write(&mut self, _: &[u8]) -> io::Result<usize> {
            Err(self.0.into())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_reader_may_go_away_but_results_are_not_lost_in_silence() {
        assert_eq!(
            print_to(&mut Closed(io::ErrorKind::BrokenPipe), "rows"),
            Ok(())
        );
        let full = print_to(&mut Closed(io::ErrorKind::StorageFull), "rows");
        assert!(matches!(full, Err(CliError::Failed(_))), "{full:?}");
        let mut seen = Vec::new();
        print_to(&mut seen, format_args!("{} rows", 3)).unwrap();
        assert_eq!(seen, b"3 rows");
    }
}
