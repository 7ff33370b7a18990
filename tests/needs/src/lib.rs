//! What a test needs that a machine may lack, and the one way to say so.
//!
//! A test that cannot run, or a part of one, calls [`Need::is_lacking`] and returns. The line that this
//! writes passes by the capture of the test harness, so it is seen in every output; `.ci/run` gathers
//! these lines at its end. `STRAT_REQUIRE=ort,numpy,chromium` names what must not be lacking: then the
//! test fails instead.

use std::fmt::Display;
use std::io::Write;

/// Something outside the workspace without which a test cannot run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Need {
    /// The library of ONNX Runtime, which the first test that needs it installs with pip.
    OnnxRuntime,
    /// Python with numpy, for the independent implementation.
    Numpy,
    /// A Chromium in the path, which opens reports.
    Chromium,
    /// A folder with real frames of KITTI, named by `STRAT_KITTI_SAMPLES`.
    KittiFrames,
    /// A pdflatex in the path, with booktabs and xcolor.
    Latex,
    /// A user to whom permissions apply, which they do not to the superuser.
    OrdinaryUser,
}

impl Need {
    const ALL: [Self; 6] = [
        Self::OnnxRuntime,
        Self::Numpy,
        Self::Chromium,
        Self::KittiFrames,
        Self::Latex,
        Self::OrdinaryUser,
    ];

    /// The word for it in `STRAT_REQUIRE`.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Self::OnnxRuntime => "ort",
            Self::Numpy => "numpy",
            Self::Chromium => "chromium",
            Self::KittiFrames => "kitti",
            Self::Latex => "latex",
            Self::OrdinaryUser => "user",
        }
    }

    /// Says that the running test, or a part of it, could not run, and why.
    ///
    /// # Panics
    /// `STRAT_REQUIRE` names this need, or a word that is none.
    #[track_caller]
    pub fn is_lacking(self, reason: impl Display) {
        let required = std::env::var("STRAT_REQUIRE").unwrap_or_default();
        assert!(
            !self.is_among(&required),
            "STRAT_REQUIRE names `{}`: {reason}",
            self.word()
        );
        let package = std::env::var("CARGO_PKG_NAME").unwrap_or_default();
        let thread = std::thread::current();
        let test = thread.name().unwrap_or("a test");
        let line = format!(
            "could not run: {package} {test} needs {}: {reason}\n",
            self.word()
        );
        // In one piece, so that lines of tests at work side by side stay whole.
        let _ = std::io::stderr().write_all(line.as_bytes());
    }

    /// Whether this need is one of the words, which stand between commas.
    fn is_among(self, words: &str) -> bool {
        let words = words.split(',').map(str::trim);
        let mut found = false;
        for word in words.filter(|word| !word.is_empty()) {
            let known = Self::ALL.into_iter().find(|need| need.word() == word);
            let known = known.unwrap_or_else(|| {
                let words = Self::ALL.map(Self::word).join(", ");
                panic!("STRAT_REQUIRE: `{word}` is not one of {words}")
            });
            found |= known == self;
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn required_is_what_is_named() {
        assert!(!Need::Chromium.is_among(""));
        assert!(!Need::Chromium.is_among("ort, numpy"));
        assert!(Need::Chromium.is_among("ort,chromium"));
        for need in Need::ALL {
            assert!(need.is_among(need.word()));
        }
    }

    #[test]
    #[should_panic(expected = "`chrome` is not one of ort, numpy, chromium")]
    fn a_misspelt_need_fails() {
        Need::Chromium.is_among("chrome");
    }
}
