//! One of several parts of a list of samples, for work that is divided among machines.
//!
//! A sample belongs to a part by the hash of its name alone, so the division is the same
//! everywhere and stays the same while the list grows. What a part is for is its user's matter.

use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::files;

/// Folder of the parts within an output folder.
pub const PARTS: &str = "parts";

/// Most parts there can be.
const MOST: u32 = 9999;

/// One of several parts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Shard {
    /// Its number, from 0.
    pub index: u32,
    /// How many there are.
    pub count: u32,
}

impl Shard {
    /// Whether a sample belongs to it: the first eight bytes of the BLAKE3 of the name, as a
    /// little-endian number, modulo the number of parts.
    pub fn has(self, id: &str) -> bool {
        let hash = blake3::hash(id.as_bytes());
        let mut first = [0; 8];
        first.copy_from_slice(&hash.as_bytes()[..8]);
        u64::from_le_bytes(first) % u64::from(self.count) == u64::from(self.index)
    }

    /// Folder of this part within an output folder.
    pub fn folder(self, out: &Path) -> PathBuf {
        let Self { index, count } = self;
        out.join(PARTS).join(format!("{index:04}-of-{count:04}"))
    }

    /// The part whose folder has this name.
    fn of_folder(name: &str) -> Option<Shard> {
        let (index, count) = name.split_once("-of-")?;
        let number = |text: &str| text.parse::<u32>().ok();
        format!("{}/{}", number(index)?, number(count)?)
            .parse()
            .ok()
    }

    /// Removes the parts in an output folder, in one step where nothing else lies among them. What
    /// `writes` does not name is not the command's own: it stays, and is returned.
    ///
    /// # Errors
    /// A folder cannot be read or removed.
    pub fn remove_all(out: &Path, writes: fn(&str) -> bool) -> crate::Result<Vec<PathBuf>> {
        let parts = out.join(PARTS);
        let (mut own, mut foreign) = (Vec::new(), Vec::new());
        for name in files::names_in(&parts)? {
            let name = name.to_string_lossy();
            let folder = parts.join(&*name);
            if Shard::of_folder(&name).is_none() || !folder.is_dir() {
                let list = if files::is_leftover(&name) {
                    &mut own
                } else {
                    &mut foreign
                };
                list.push(folder);
                continue;
            }
            for name in files::names_in(&folder)? {
                let name = name.to_string_lossy();
                let is_own = writes(&name) || files::is_leftover(&name);
                let list = if is_own { &mut own } else { &mut foreign };
                list.push(folder.join(&*name));
            }
        }
        if !foreign.is_empty() {
            own.iter().try_for_each(|path| files::remove(path))?;
            for name in files::names_in(&parts)? {
                let folder = parts.join(name);
                if files::names_in(&folder).is_ok_and(|names| names.is_empty()) {
                    files::remove(&folder)?;
                }
            }
        } else if parts.is_dir() {
            files::remove_folder_atomic(&parts)?;
        }
        Ok(foreign)
    }

    /// The parts whose folders are in an output folder, sorted; complete or not.
    ///
    /// # Errors
    /// The folder of the parts is there and cannot be read; a sentence without its beginning.
    pub fn found_in(out: &Path) -> Result<Vec<Shard>, String> {
        let folder = out.join(PARTS);
        let entries = match std::fs::read_dir(&folder) {
            Ok(entries) => entries,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
            Err(e) => return Err(format!("its {PARTS}/ cannot be read: {e}")),
        };
        let mut shards = Vec::new();
        for entry in entries {
            let name = entry.map_err(|e| format!("its {PARTS}/ cannot be read: {e}"))?;
            let name = name.file_name();
            shards.extend(name.to_str().and_then(Shard::of_folder));
        }
        shards.sort_unstable();
        Ok(shards)
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.index, self.count)
    }
}

impl FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let number = |text: &str| text.parse::<u32>().ok();
        let parsed = text
            .split_once('/')
            .and_then(|(index, count)| Some((number(index)?, number(count)?)));
        match parsed {
            Some((index, count)) if index < count && count <= MOST => Ok(Self { index, count }),
            Some((index, count)) if index == count => Err(format!(
                "parts are numbered from 0, so the last of {count} is {}/{count}",
                count.saturating_sub(1)
            )),
            _ => Err(format!(
                "give the number of the part and how many there are, e.g. 0/8 to 7/8 (at most {MOST})"
            )),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use strat_splits::{Split, training};

    #[test]
    fn every_sample_belongs_to_exactly_one_part() {
        for count in [1, 2, 7, 64] {
            let mut sizes = vec![0_u32; count as usize];
            for frame in training(Split::Eigen).iter().take(2000) {
                let id = frame.to_string();
                let has = |index: &u32| {
                    Shard {
                        index: *index,
                        count,
                    }
                    .has(&id)
                };
                let owners: Vec<_> = (0..count).filter(has).collect();
                assert_eq!(owners.len(), 1, "{id} of {count}");
                sizes[owners[0] as usize] += 1;
            }
            let fair = 2000 / count;
            assert!(
                sizes
                    .iter()
                    .all(|size| (fair / 3..=fair * 3).contains(size)),
                "{sizes:?}"
            );
        }
    }

    #[test]
    fn the_division_never_changes() {
        // Samples of a half-prepared set would change hands if this did.
        let shards: Vec<_> = ["kitti2015/000006", "2011_09_26_drive_0001/0000000005"]
            .iter()
            .map(|id| {
                (0..8)
                    .find(|index| {
                        Shard {
                            index: *index,
                            count: 8,
                        }
                        .has(id)
                    })
                    .unwrap()
            })
            .collect();
        assert_eq!(shards, [GOLDEN.0, GOLDEN.1]);
    }

    // Recipe: make_golden.py store/shard.
    const GOLDEN: (u32, u32) = (1, 5);

    #[test]
    fn parts_go_and_what_is_not_their_own_stays() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path();
        let write = |path: &str| files::write_atomic(&out.join(path), b"x").unwrap();
        let remove = || Shard::remove_all(out, |name| name == "test.csv").unwrap();
        assert!(remove().is_empty());
        write("parts/0000-of-0002/test.csv");
        write("parts/0001-of-0002/test.csv");
        assert!(remove().is_empty());
        assert!(!out.join(PARTS).exists());

        write("parts/0000-of-0002/test.csv");
        write("parts/0001-of-0002/test.csv");
        write("parts/0001-of-0002/notes.txt");
        write("parts/todo.txt");
        let mut left = remove();
        left.sort();
        let notes = out.join("parts/0001-of-0002/notes.txt");
        assert_eq!(left, [notes.clone(), out.join("parts/todo.txt")]);
        assert!(left.iter().all(|path| path.is_file()));
        assert!(!out.join("parts/0000-of-0002").exists());
        assert!(!notes.with_file_name("test.csv").exists());
    }

    #[test]
    fn shards_are_read_and_refused_in_words() {
        assert_eq!("0/8".parse(), Ok(Shard { index: 0, count: 8 }));
        assert_eq!("7/8".parse::<Shard>().unwrap().to_string(), "7/8");
        let refused = |text: &str| text.parse::<Shard>().unwrap_err();
        assert!(refused("8/8").contains("the last of 8 is 7/8"));
        for text in ["", "3", "a/b", "-1/8", "9/8", "0/0", "1/100000"] {
            assert!(!refused(text).is_empty(), "{text}");
        }
    }
}
