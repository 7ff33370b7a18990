//! The workspace's own text files, for the tests that read them.

use std::fs;
use std::path::{Path, PathBuf};

/// The top of the repository.
pub fn root() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
}

/// Path from the top and content of every file with one of these extensions.
pub fn files(extensions: &[&str]) -> Vec<(PathBuf, String)> {
    let mut found = Vec::new();
    gather(root(), extensions, &mut found);
    found.sort();
    found
}

fn gather(folder: &Path, extensions: &[&str], found: &mut Vec<(PathBuf, String)>) {
    for entry in fs::read_dir(folder).expect("a folder of the repository") {
        let path = entry.expect("an entry").path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let made = name.starts_with('.') || name == "target" || name == "strat-demo";
        if path.is_dir() && !made {
            gather(&path, extensions, found);
        } else if path
            .extension()
            .is_some_and(|e| extensions.iter().any(|wanted| e == *wanted))
        {
            let text = fs::read_to_string(&path).expect("text");
            found.push((
                path.strip_prefix(root()).expect("below the top").to_owned(),
                text,
            ));
        }
    }
}
