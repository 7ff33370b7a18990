//! Which runtime is asked for.

/// Which runtime to use (`--runtime`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RuntimeChoice {
    /// ONNX Runtime when its library is found, else the embedded runtime with a notice.
    #[default]
    Auto,
    /// ONNX Runtime or an error.
    Ort,
    /// The embedded runtime (CPU only, slower, needs nothing installed).
    Embedded,
}

impl RuntimeChoice {
    /// How it is called on the command line.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Ort => "ort",
            Self::Embedded => "embedded",
        }
    }
}
