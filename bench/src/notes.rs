//! What a command says on stderr while it works, and what of it goes into the record of the run.

use strat_store::command::eprint_line;

/// Notes (silent with `--quiet`), warnings and errors of one run.
#[derive(Debug, Default)]
pub struct Notes {
    /// No notes; warnings and errors still show.
    pub quiet: bool,
    /// All warnings and errors so far.
    pub warnings: Vec<String>,
    /// Something failed that is not an image.
    pub incomplete: bool,
}

impl Notes {
    /// For a command with or without `--quiet`.
    #[must_use]
    pub fn new(quiet: bool) -> Self {
        Self {
            quiet,
            ..Self::default()
        }
    }

    /// A line that `--quiet` silences.
    pub fn say(&self, text: &str) {
        if !self.quiet {
            eprint_line(text);
        }
    }

    /// Something to know.
    pub fn note(&self, text: &str) {
        self.say(&format!("note: {text}"));
    }

    /// Something that makes results doubtful.
    pub fn warn(&mut self, text: String) {
        eprint_line(format_args!("warning: {text}"));
        self.warnings.push(text);
    }

    /// Something that leaves the run incomplete.
    pub fn fail(&mut self, text: String) {
        eprint_line(format_args!("error: {text}"));
        self.warnings.push(text);
        self.incomplete = true;
    }
}
