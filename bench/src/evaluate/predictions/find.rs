//! Which map of saved predictions belongs to which image, by lists and names; no map is opened here.

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

use strat_splits::Split;
use strat_store::files;
use strat_store::inputs::{self, Kind};
use strat_store::set::{Content, Sample};

use super::error::{SavedError, open, unusable};
use super::names::{id_of_line, stems_of};

/// Extensions of the files of a folder.
const EXTENSIONS: [&str; 3] = ["png", "exr", "npy"];

/// Extensions of files that other programs write beside these and that are not read.
const FOREIGN_EXTENSIONS: [&str; 4] = ["pfm", "npz", "tif", "tiff"];

/// The arrays of an `.npz` that has one for each image, named by its id as `prep export` does; `None`
/// for everything else.
pub fn members_of(
    path: &Path,
    samples: &[Sample],
) -> Result<Option<HashMap<String, String>>, SavedError> {
    if path.extension().is_none_or(|extension| extension != "npz") {
        return Ok(None);
    }
    // What is wrong with an archive is said where its array is read.
    let Ok(archive) = zip::ZipArchive::new(open(path)?) else {
        return Ok(None);
    };
    let names = archive.file_names().flatten();
    let names: HashSet<String> = names
        .filter_map(|name| Some(name.strip_suffix(".npy")?.to_owned()))
        .collect();
    let members = samples.iter().filter_map(|sample| {
        let mut stems = stems_of(&sample.id).into_iter();
        let member = stems.find(|stem| names.contains(stem))?;
        Some((sample.id.clone(), member))
    });
    let members: HashMap<String, String> = members.collect();
    Ok(Some(members).filter(|members| !members.is_empty()))
}

/// Where the images of an array are listed.
fn ids_path(path: &Path) -> PathBuf {
    path.with_extension("ids.txt")
}

/// The images whose maps an array holds, in its order.
pub fn ids_of(
    path: &Path,
    count: usize,
    content: Content,
    samples: &[Sample],
) -> Result<Vec<String>, SavedError> {
    let list = ids_path(path);
    if list.is_file() {
        let text = String::from_utf8(inputs::read(&list, Kind::Table)?);
        let text = text.map_err(|_| unusable(&list, "it is not text"))?;
        // Editors begin files with a byte order mark and end them with empty lines.
        let text = text.trim_start_matches('\u{feff}').trim_end();
        let known: HashSet<&str> = samples.iter().map(|sample| sample.id.as_str()).collect();
        let id = |line: &str| match known.contains(line.trim()) {
            true => line.trim().to_owned(),
            false => id_of_line(line),
        };
        let ids: Vec<String> = text.lines().map(id).collect();
        if ids.len() != count {
            let reason = format!(
                "it names {} images, but the array has {count} maps",
                ids.len()
            );
            return Err(unusable(&list, reason));
        }
        Ok(ids)
    } else {
        let published = content.split().map(strat_splits::test_ids);
        // Those that have improved ground truth, as other projects save them (`eigen_benchmark`).
        let annotated = (content.split() == Some(Split::Eigen)).then(|| {
            let frames = strat_splits::eigen_test().iter();
            let frames = frames.filter(|frame| strat_splits::has_annotated_depth(**frame));
            frames.map(ToString::to_string).collect()
        });
        let mut lists = published.into_iter().chain(annotated);
        match lists.find(|ids: &Vec<String>| ids.len() == count) {
            Some(ids) => Ok(ids),
            None if samples.len() == count => Ok(samples.iter().map(|s| s.id.clone()).collect()),
            None => Err(unusable(
                path,
                format!(
                    "it has {count} maps for the {} test images of the set, so it is not clear \
                     whose they are; name them in {}, one a line",
                    samples.len(),
                    list.display()
                ),
            )),
        }
    }
}

/// Which map of an array is whose.
pub fn indices(path: &Path, ids: Vec<String>) -> Result<HashMap<String, usize>, SavedError> {
    let count = ids.len();
    let indices: HashMap<String, usize> = ids.into_iter().zip(0..).collect();
    if indices.len() == count {
        Ok(indices)
    } else {
        Err(unusable(&ids_path(path), "it names an image twice"))
    }
}

/// The files of a folder by image: `drive/frame.png` or as other programs call it ([`stems_of`]), or,
/// where no other image is called the same, `frame.png`.
pub fn files_of(folder: &Path, samples: &[Sample]) -> Result<HashMap<String, PathBuf>, SavedError> {
    let mut last_parts: HashMap<&str, usize> = HashMap::new();
    fn last(id: &str) -> &str {
        id.rsplit('/').next().unwrap_or(id)
    }
    for sample in samples {
        *last_parts.entry(last(&sample.id)).or_default() += 1;
    }
    let mut found = HashMap::new();
    for sample in samples {
        let alone = last_parts.get(last(&sample.id)) == Some(&1);
        let mut stems = stems_of(&sample.id);
        stems.extend(alone.then(|| last(&sample.id).to_owned()));
        for stem in stems {
            if let Some(file) = file_of(folder, &stem)? {
                found.insert(sample.id.clone(), file);
                break;
            }
        }
    }
    match samples.first() {
        Some(sample) if found.is_empty() => Err(unusable(
            folder,
            format!(
                "it has a file for none of the test images; for {} it should be {}.png, .exr or .npy",
                sample.id,
                sample.id.replace('/', "_")
            ),
        )),
        _ => Ok(found),
    }
}

/// The only file with a stem. A picture beside the numbers it shows is not told from them by name.
fn file_of(folder: &Path, stem: &str) -> Result<Option<PathBuf>, SavedError> {
    let path = |extension: &&str| folder.join(format!("{stem}.{extension}"));
    let known = EXTENSIONS.iter().map(path).filter(|file| file.is_file());
    let known: Vec<PathBuf> = known.collect();
    let Some(first) = known.first() else {
        return Ok(None);
    };
    let foreign = FOREIGN_EXTENSIONS.iter().map(path);
    let other = known.get(1).cloned();
    match other.or_else(|| foreign.into_iter().find(|file| file.is_file())) {
        Some(other) => Err(unusable(
            folder,
            format!(
                "it has {} and {} for one image, and which of them holds the numbers is not clear; leave \
                 one of them",
                first.display(),
                other.display()
            ),
        )),
        None => Ok(Some(first.clone())),
    }
}

/// BLAKE3 over the lines `image BLAKE3` of the maps, in the order of the set.
pub fn hash_of(samples: &[Sample], found: &HashMap<String, PathBuf>) -> Result<String, SavedError> {
    let mut lines = String::new();
    for sample in samples {
        if let Some(file) = found.get(&sample.id) {
            lines += &format!(
                "{} {}\n",
                sample.id,
                files::blake3_file(file, Kind::Content)?
            );
        }
    }
    Ok(files::blake3_hex(lines.as_bytes()))
}
