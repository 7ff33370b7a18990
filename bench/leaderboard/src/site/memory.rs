//! A site before it is written.

/// A site in memory: paths below its folder and bytes.
#[derive(Debug, Default)]
pub(super) struct Site {
    pub(super) files: Vec<(String, Vec<u8>)>,
}

impl Site {
    /// One more file.
    pub(super) fn add(&mut self, path: impl Into<String>, bytes: impl Into<Vec<u8>>) {
        self.files.push((path.into(), bytes.into()));
    }
}
