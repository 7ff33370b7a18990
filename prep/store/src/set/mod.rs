//! The prepared set: a folder that `prep` writes and `train` and `bench` read.
//!
//! [`layout`] says which file is where. The tables name every file with its BLAKE3,
//! and the manifest carries a digest of the tables, so the manifest's digest identifies the whole
//! content. Not here: how the files are made, which is `prep`'s.

pub mod layout;
mod manifest;
mod sample;
mod table;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use strat_splits::Role;

pub use self::layout::MANIFEST;
use self::layout::table_name;
pub use self::manifest::{CameraEntry, Content, Count, FORMAT, Manifest};
pub use self::sample::{FileRef, Sample, check_id};
use crate::error::{Error, Result};
use crate::inputs::{self, Kind};
use crate::{files, yaml};

/// A finished set on disk.
#[derive(Debug, Clone)]
pub struct PreparedSet {
    /// The folder.
    pub root: PathBuf,
    /// Its manifest.
    pub manifest: Manifest,
}

impl PreparedSet {
    /// Opens a finished set and checks that its tables are those the manifest speaks of.
    ///
    /// # Errors
    /// `root` is no folder, has no manifest (not a set, or unfinished), is of another format
    /// version, or its tables were changed.
    pub fn open(root: &Path) -> Result<Self> {
        let wrong = |problem: String| Error::Set {
            path: root.to_owned(),
            problem,
        };
        if !root.is_dir() {
            return Err(wrong(
                "folder not found; give the folder that `prep ... --out` wrote".to_owned(),
            ));
        }
        let path = root.join(MANIFEST);
        if !path.is_file() {
            return Err(wrong(format!(
                "it has no {MANIFEST}; give the folder that `prep ... --out` wrote, or run that command \
                 again if it was interrupted"
            )));
        }
        let Format { format } = yaml::load(&path)?;
        if format != FORMAT {
            return Err(wrong(format!(
                "it has format {format} and this program reads format {FORMAT}; prepare it again with this version"
            )));
        }
        let set = Self {
            root: root.to_owned(),
            manifest: manifest::load(&path)?,
        };
        let mut tables = Vec::new();
        for role in Role::ALL {
            tables.push((
                role,
                inputs::read(&root.join(table_name(role)), Kind::Table)?,
            ));
        }
        if data_digest(&tables) != set.manifest.data_digest {
            return Err(Error::DamagedSet {
                path: root.to_owned(),
                problem: format!(
                    "its tables (train.csv, val.csv, test.csv) are not those of {MANIFEST}: a run was \
                     interrupted or a file edited; run the `prep` command again"
                ),
            });
        }
        Ok(set)
    }

    /// Whether the manifest carries a digest of its own words, so that edits of it are noticed. Sets of
    /// earlier versions do not.
    ///
    /// # Errors
    /// The manifest cannot be read.
    pub fn seals_manifest(&self) -> Result<bool> {
        let bytes = inputs::read(&self.root.join(MANIFEST), Kind::Yaml)?;
        Ok(manifest::seal_of(&bytes).is_some())
    }

    /// The samples of a role in the order of the split.
    ///
    /// # Errors
    /// The table cannot be read or has a bad line, which is named.
    pub fn samples(&self, role: Role) -> Result<Vec<Sample>> {
        let path = self.root.join(table_name(role));
        table::parse_table(&path, &inputs::read(&path, Kind::Table)?)
    }

    /// Where a file of the set is.
    pub fn path(&self, file: &FileRef) -> PathBuf {
        let mut path = self.root.clone();
        path.extend(file.path.split('/'));
        path
    }

    /// Writes the tables and, last, the manifest with `data_digest` filled in. All roles get a table.
    ///
    /// # Errors
    /// A file cannot be written.
    pub fn write(
        root: &Path,
        mut manifest: Manifest,
        samples: &BTreeMap<Role, Vec<Sample>>,
    ) -> Result<Self> {
        let tables: Vec<_> = Role::ALL
            .into_iter()
            .map(|role| {
                (
                    role,
                    table::table_bytes(samples.get(&role).map_or(&[][..], Vec::as_slice)),
                )
            })
            .collect();
        manifest.data_digest = data_digest(&tables);
        for (role, bytes) in &tables {
            files::write_atomic(&root.join(table_name(*role)), bytes)?;
        }
        files::write_atomic(&root.join(MANIFEST), &manifest::to_bytes(&manifest)?)?;
        Ok(Self {
            root: root.to_owned(),
            manifest,
        })
    }
}

/// Looked at before the rest, whose keys other versions may not share.
#[derive(Deserialize)]
struct Format {
    format: u32,
}

fn data_digest(tables: &[(Role, Vec<u8>)]) -> String {
    let mut hasher = blake3::Hasher::new();
    for (role, bytes) in tables {
        hasher
            .update(format!("{role} {}\n", bytes.len()).as_bytes())
            .update(bytes);
    }
    hasher.finalize().to_hex().to_string()
}

#[cfg(test)]
mod tests {
    use strat_splits::Split;

    use super::*;
    use crate::resize::Kernel;

    fn file(path: &str) -> FileRef {
        FileRef {
            path: path.to_owned(),
            blake3: files::blake3_hex(path.as_bytes()),
        }
    }

    pub(in crate::set) fn sample(id: &str) -> Sample {
        // The baseline is not a short decimal: it must survive being written as text.
        let left = file("images/d/left/0000000005.png");
        Sample {
            right: Some(file("images/d/right/0000000005.png")),
            left_full: Some(file("full/d/left/0000000005.jpg")),
            depth_velodyne: Some(file("depth/velodyne/d/0000000005.exr")),
            instance: Some(file("labels/instance/1.png")),
            ..Sample::new(id, (1242, 375), 721.5377, 0.1 + 0.2, left)
        }
    }

    fn manifest() -> Manifest {
        Manifest {
            format: FORMAT,
            content: Content::Eigen,
            split_digest: Some(strat_splits::digest(Split::Eigen)),
            source: "kitti".to_owned(),
            image_width: 512,
            image_height: 256,
            kernel: Kernel::Area,
            codec: "png".to_owned(),
            counts: [
                (
                    Role::Train,
                    Count {
                        expected: 3,
                        found: 2,
                    },
                ),
                (
                    Role::Val,
                    Count {
                        expected: 0,
                        found: 0,
                    },
                ),
            ]
            .into(),
            failures: 1,
            cameras: vec![CameraEntry {
                name: "2011_09_26".to_owned(),
                width: 1242,
                height: 375,
                focal_px: 721.5377,
                baseline_m: 0.532_725_428,
            }],
            tool_version: "0.1.0".to_owned(),
            data_digest: String::new(),
        }
    }

    fn written(root: &Path) -> PreparedSet {
        let samples = [(Role::Train, vec![sample("a/1"), sample("a/2")])].into();
        PreparedSet::write(root, manifest(), &samples).unwrap()
    }

    #[test]
    fn a_set_comes_back_as_written() {
        let folder = tempfile::tempdir().unwrap();
        let set = written(folder.path());
        assert_eq!(set.manifest.data_digest.len(), 64);
        let opened = PreparedSet::open(folder.path()).unwrap();
        assert_eq!(opened.manifest, set.manifest);
        assert_eq!(
            opened.samples(Role::Train).unwrap(),
            [sample("a/1"), sample("a/2")]
        );
        assert!(opened.samples(Role::Test).unwrap().is_empty());
        assert!(
            !opened.manifest.is_complete(Role::Train) && opened.manifest.is_complete(Role::Val)
        );
        assert!(
            !opened.manifest.is_complete(Role::Test),
            "a role without a count is not complete"
        );
        assert_eq!(
            opened.path(&file("full/d/x.png")),
            folder.path().join("full").join("d").join("x.png")
        );
        let text = std::fs::read_to_string(folder.path().join(MANIFEST)).unwrap();
        assert!(
            text.contains("content: eigen")
                && text.contains("kernel: area")
                && text.contains("train:"),
            "{text}"
        );
    }

    #[test]
    fn the_digest_follows_the_rows_and_their_roles() {
        let folder = tempfile::tempdir().unwrap();
        let digest = |role, samples| {
            let samples = [(role, samples)].into();
            PreparedSet::write(folder.path(), manifest(), &samples)
                .unwrap()
                .manifest
                .data_digest
        };
        let one = digest(Role::Train, vec![sample("a/1")]);
        assert_eq!(one, digest(Role::Train, vec![sample("a/1")]));
        assert_ne!(one, digest(Role::Val, vec![sample("a/1")]));
        let mut other = sample("a/1");
        other.left.blake3 = files::blake3_hex(b"other pixels");
        assert_ne!(one, digest(Role::Train, vec![other]));
    }

    #[test]
    fn what_is_no_finished_set_is_explained() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        let problem = || PreparedSet::open(root).unwrap_err().to_string();
        let missing = PreparedSet::open(&root.join("none"))
            .unwrap_err()
            .to_string();
        assert!(
            missing.contains("none") && missing.contains("folder not found"),
            "{missing}"
        );
        assert!(problem().contains("has no manifest.yaml"));

        written(root);
        let path = root.join(MANIFEST);
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::write(&path, text.replace("format: 2", "format: 3\nnews: 1")).unwrap();
        assert!(problem().contains("format 3"), "{}", problem());
        let (words, _) = text.split_once("manifest_digest").unwrap();
        std::fs::write(&path, words.replace("kernel: area", "kernel: cubic")).unwrap();
        assert!(
            problem().contains("kernel") && problem().contains("line"),
            "{}",
            problem()
        );
        std::fs::write(&path, &text).unwrap();
        std::fs::write(root.join("train.csv"), b"").unwrap();
        assert!(problem().contains("interrupted"), "{}", problem());
    }

    #[test]
    fn edits_of_the_manifest_are_noticed() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        let set = written(root);
        assert!(set.seals_manifest().unwrap());
        let path = root.join(MANIFEST);
        let text = std::fs::read_to_string(&path).unwrap();
        for (from, to) in [
            ("source: kitti", "source: rendered"),
            ("found: 2", "found: 3"),
            ("image_width: 512", "image_width: 256"),
            ("manifest_digest: ", "manifest_digest: 0"),
        ] {
            assert!(text.contains(from), "{from}");
            std::fs::write(&path, text.replacen(from, to, 1)).unwrap();
            let error = PreparedSet::open(root).unwrap_err().to_string();
            assert!(error.contains("it was edited"), "{error}");
        }
        // Sets of earlier versions have no such line and stay readable.
        let (words, _) = text.split_once("manifest_digest").unwrap();
        std::fs::write(&path, words).unwrap();
        let old = PreparedSet::open(root).unwrap();
        assert_eq!(old.manifest, set.manifest);
        assert!(!old.seals_manifest().unwrap());
    }
}
