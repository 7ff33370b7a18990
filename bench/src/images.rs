//! Images in a user's folders.

use std::{
    io,
    path::{Path, PathBuf},
};

use strat_store::{Error, human};

/// Extensions of pictures that are not read.
const OTHERS: [&str; 9] = [
    "webp", "tif", "tiff", "bmp", "gif", "heic", "heif", "avif", "jxl",
];

/// What a folder and those below it hold.
#[derive(Debug, Default)]
pub struct Found {
    /// PNG and JPEG files, sorted.
    pub images: Vec<PathBuf>,
    /// Pictures of other kinds, sorted.
    pub others: Vec<PathBuf>,
}

impl Found {
    /// A sentence about pictures that are not read.
    #[must_use]
    pub fn skipped(&self) -> Option<String> {
        let names = self.others.iter().filter_map(|path| path.file_name());
        let names: Vec<String> = names
            .map(|name| name.to_string_lossy().into_owned())
            .collect();
        let some = human::first_three(&names)?;
        Some(format!(
            "{} skipped, because only PNG and JPEG are read: {some}",
            human::count(names.len(), "picture", "pictures")
        ))
    }
}

/// PNG and JPEG files in a folder and those below it. Hidden files and linked folders are
/// left out.
///
/// # Errors
/// A folder cannot be read.
pub fn below(folder: &Path) -> Result<Found, Error> {
    let mut found = Found::default();
    let mut folders = vec![folder.to_path_buf()];
    while let Some(folder) = folders.pop() {
        let unreadable = |source: io::Error| Error::Io {
            action: "read the folder",
            path: folder.clone(),
            source,
        };
        for entry in std::fs::read_dir(&folder).map_err(unreadable)? {
            let entry = entry.map_err(unreadable)?;
            let path = entry.path();
            if entry.file_name().to_string_lossy().starts_with('.') {
                continue;
            }
            if entry.file_type().map_err(unreadable)?.is_dir() {
                folders.push(path);
            } else if path.is_file() && has_extension(&path, &["png", "jpg", "jpeg"]) {
                found.images.push(path);
            } else if path.is_file() && has_extension(&path, &OTHERS) {
                found.others.push(path);
            }
        }
    }
    found.images.sort();
    found.others.sort();
    Ok(found)
}

fn has_extension(path: &Path, known: &[&str]) -> bool {
    let extension = path.extension();
    extension.is_some_and(|own| known.iter().any(|known| own.eq_ignore_ascii_case(known)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_images_are_found() {
        let folder = tempfile::tempdir().unwrap();
        for name in [
            "b.PNG",
            "a/c.jpeg",
            "a/x.txt",
            ".hidden.png",
            "a.jpg",
            "d.webp",
        ] {
            let path = folder.path().join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, b"").unwrap();
        }
        let all = below(folder.path()).unwrap();
        let skipped = all.skipped().unwrap();
        assert!(
            skipped.starts_with("1 picture skipped") && skipped.ends_with("d.webp"),
            "{skipped}"
        );
        let found: Vec<String> = all
            .images
            .iter()
            .map(|path| {
                path.strip_prefix(folder.path())
                    .unwrap()
                    .display()
                    .to_string()
            })
            .collect();
        assert_eq!(found, ["a/c.jpeg", "a.jpg", "b.PNG"]);
        assert!(below(&folder.path().join("none")).is_err());
    }
}
