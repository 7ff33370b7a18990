//! Whose output is it: a command writes only where nothing is, or where its own mark says that
//! what is there came from it.
//!
//! Every command that leaves several files in a folder has a [`Mark`]: a record that says what it
//! left (a manifest, `run.yaml`, `WORLD.yaml`), and until that is written, a record of the work
//! begun. [`Mark::examine`] looks before any work; [`Mark::begin`] marks the folder before the first
//! file. A command that writes a single file knows its own by how it begins ([`check_file`]).
//!
//! Paths are compared as the file system sees them ([`resolve`]): `none/../raw` is `raw`, whether
//! `none` exists or not. Files are written whole or not at all by [`crate::files`].

use std::borrow::Cow;
use std::fs::File;
use std::io::Read;
use std::path::{Component, Path, PathBuf};

use crate::error::{Error, Result};
use crate::files;

/// What tells the outputs of one command from everything else.
#[derive(Debug, Clone, Copy)]
pub struct Mark {
    /// The command as users type it: `prep synth`.
    pub command: &'static str,
    /// File in the output folder that says what the command left there.
    pub record: &'static str,
    /// How every record of this command begins.
    pub begins: &'static str,
    /// Whether the command writes a file or folder of this name into its output folder. Other names
    /// may belong to anyone.
    pub writes: fn(&str) -> bool,
}

/// What an output folder holds of the command that asks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Found {
    /// Nothing: it does not exist, is empty, or holds only what the command never writes.
    Nothing,
    /// What an interrupted run left, which wrote no record yet.
    Begun,
    /// A record of the command.
    Record,
}

impl Mark {
    /// Looks at the output folder before any work.
    ///
    /// # Errors
    /// The folder is a file, lies inside an input, holds an input where the command would write, or
    /// holds something that the command would replace and did not write.
    pub fn examine(&self, out: &Path, inputs: &[&Path]) -> Result<Found> {
        self.check_apart(out, inputs)?;
        let refuse = |problem: String| Error::Output {
            path: out.to_owned(),
            problem,
        };
        if out.exists() && !out.is_dir() {
            return Err(refuse("this is a file; give a folder".to_owned()));
        }
        for (name, found) in [
            (self.record.to_owned(), Found::Record),
            (self.begun(), Found::Begun),
        ] {
            match begins_with(&out.join(&name), self.begins)? {
                None => {}
                Some(true) => return Ok(found),
                Some(false) => {
                    return Err(refuse(format!(
                        "its {name} was not written by `{}`; give another folder",
                        self.command
                    )));
                }
            }
        }
        let Some(foreign) = self.in_the_way(out)? else {
            return Ok(Found::Nothing);
        };
        Err(refuse(format!(
            "this folder holds other things ({foreign}), which `{}` would replace and did not write; give a \
             new or an empty folder",
            self.command
        )))
    }

    /// Makes the folder, removes what killed runs left half-written in it, and marks it as this
    /// command's, so that a later run knows what this one leaves if it is interrupted.
    ///
    /// # Errors
    /// The folder cannot be made or written to.
    pub fn begin(&self, out: &Path) -> Result<()> {
        self.go_on(out)?;
        if out.join(self.record).exists() {
            return Ok(());
        }
        self.write_begun(out)
    }

    /// Makes sure that the folder can be written to, and removes what killed runs left half-written
    /// in it.
    ///
    /// # Errors
    /// The folder cannot be made or written to.
    pub fn go_on(&self, out: &Path) -> Result<()> {
        files::check_writable(out)?;
        files::remove_leftovers_among(out, self.writes)
    }

    /// Writes the record and takes the mark of work begun away.
    ///
    /// # Errors
    /// The folder cannot be written to.
    pub fn finish(&self, out: &Path, record: &[u8]) -> Result<()> {
        debug_assert!(record.starts_with(self.begins.as_bytes()));
        files::write_atomic(&out.join(self.record), record)?;
        files::remove(&out.join(self.begun()))
    }

    /// Makes the record one of work begun, for files that are replaced one after another. It keeps
    /// what it says of the run before.
    ///
    /// # Errors
    /// The folder cannot be written to.
    pub fn reopen(&self, out: &Path) -> Result<()> {
        let record = out.join(self.record);
        if !record.exists() {
            return Ok(());
        }
        files::rename(&record, &out.join(self.begun()))
    }

    /// Marks the folder as work begun with a record of what the work is, so that the next run can
    /// tell whether it is the same, and what is older than it. A finished record is replaced by it.
    ///
    /// # Errors
    /// The folder cannot be made or written to.
    pub fn begin_with(&self, out: &Path, record: &[u8]) -> Result<()> {
        debug_assert!(record.starts_with(self.begins.as_bytes()));
        self.go_on(out)?;
        files::write_atomic(&out.join(self.begun()), record)?;
        files::remove(&out.join(self.record))
    }

    fn write_begun(&self, out: &Path) -> Result<()> {
        let text = format!(
            "{}\n# `{}` was interrupted here, or is still running.\n",
            self.begins.trim_end(),
            self.command
        );
        files::write_atomic(&out.join(self.begun()), text.as_bytes())
    }

    /// Name of the record of work begun.
    pub fn begun(&self) -> String {
        format!("unfinished-{}", self.record)
    }

    /// The first name in the folder that the command would replace.
    fn in_the_way(&self, out: &Path) -> Result<Option<String>> {
        let names = files::names_in(out)?;
        let names = names.iter().map(|name| name.to_string_lossy());
        let foreign = names.filter(|name| !files::is_leftover(name) && (self.writes)(name));
        Ok(foreign.min().map(Cow::into_owned))
    }

    fn check_apart(&self, out: &Path, inputs: &[&Path]) -> Result<()> {
        let here = resolve(out)?;
        for input in inputs {
            let input = resolve(input)?;
            let inside = here.starts_with(&input);
            let first = input.strip_prefix(&here).ok().map(|rest| {
                let first = rest.components().next();
                first.map(|name| name.as_os_str().to_string_lossy().into_owned())
            });
            let problem = if inside {
                "this lies inside the input folder"
            } else if first.flatten().is_some_and(|name| (self.writes)(&name)) {
                "this holds the input"
            } else {
                continue;
            };
            return Err(Error::Output {
                path: out.to_owned(),
                problem: format!(
                    "{problem} {}, which is never written to; give another folder",
                    input.display()
                ),
            });
        }
        Ok(())
    }
}

/// Checks before any work that a single output file may be written: nothing is there, or a file
/// that begins as this command's own do. It must be none of the inputs.
///
/// # Errors
/// Something else is there; the message says what to do.
pub fn check_file(path: &Path, inputs: &[&Path], command: &str, begins: &str) -> Result<()> {
    let refuse = |problem: String| Error::Output {
        path: path.to_owned(),
        problem,
    };
    let here = resolve(path)?;
    for input in inputs {
        let input = resolve(input)?;
        if here == input || (input.is_file() && input.starts_with(&here)) {
            return Err(refuse(
                "this is an input, which is never written to; give another file".to_owned(),
            ));
        }
    }
    if path.is_dir() {
        return Err(refuse("this is a folder; give a file".to_owned()));
    }
    match begins_with(path, begins)? {
        None | Some(true) => remove_leftovers_beside(path),
        Some(false) => Err(refuse(format!(
            "this file was not written by `{command}`; give another name or remove it"
        ))),
    }
}

/// Removes what killed runs have left half-written beside a single output file.
///
/// # Errors
/// The folder cannot be read or a leftover not be removed.
pub fn remove_leftovers_beside(path: &Path) -> Result<()> {
    match path.parent() {
        Some(folder) if folder.is_dir() => files::remove_leftovers_among(folder, |_| false),
        _ => Ok(()),
    }
}

/// Where a path leads: absolute, without `.` and `..`, links followed as far as it exists.
///
/// # Errors
/// The current folder is not known.
pub fn resolve(path: &Path) -> Result<PathBuf> {
    let absolute = std::path::absolute(path).map_err(|e| Error::io("find", path, e))?;
    let mut resolved = PathBuf::new();
    for component in absolute.components() {
        match component {
            Component::CurDir => {}
            // What was resolved so far holds no link, so its parent is the one the system sees.
            Component::ParentDir => {
                resolved.pop();
            }
            Component::Prefix(_) | Component::RootDir => resolved.push(component),
            Component::Normal(name) => {
                let next = resolved.join(name);
                resolved = next.canonicalize().unwrap_or(next);
            }
        }
    }
    Ok(resolved)
}

/// Whether a file begins with a text; `None` if it is not there.
fn begins_with(path: &Path, text: &str) -> Result<Option<bool>> {
    match path.symlink_metadata() {
        Err(_) => return Ok(None),
        Ok(_) if !path.is_file() => return Ok(Some(false)),
        Ok(_) => {}
    }
    let mut start = Vec::new();
    File::open(path)
        .and_then(|file| file.take(text.len() as u64).read_to_end(&mut start))
        .map_err(|e| Error::io("read", path, e))?;
    Ok(Some(start == text.as_bytes()))
}

#[cfg(test)]
mod tests {
    use super::*;

    const TABLES: Mark = Mark {
        command: "bench --table",
        record: "run.yaml",
        begins: "tool: bench\n",
        writes: |name| ["run.yaml", "rows.csv", "parts"].contains(&name),
    };
    const WORLD: Mark = Mark {
        command: "prep synth",
        record: "WORLD.yaml",
        begins: "rendered: true\n",
        writes: |_| true,
    };

    fn write(path: &Path, text: &str) {
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, text).unwrap();
    }

    fn refusal(found: Result<Found>) -> String {
        found.unwrap_err().to_string()
    }

    #[test]
    fn only_what_bears_the_mark_is_ones_own() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("out");
        assert_eq!(WORLD.examine(&out, &[]).unwrap(), Found::Nothing);
        write(&out.join("notes.txt"), "mine");
        // Names that a command never writes are nobody's business.
        assert_eq!(TABLES.examine(&out, &[]).unwrap(), Found::Nothing);
        let text = refusal(WORLD.examine(&out, &[]));
        assert!(
            text.contains("(notes.txt)") && text.contains("prep synth"),
            "{text}"
        );

        write(&out.join("rows.csv"), "somebody's");
        assert!(refusal(TABLES.examine(&out, &[])).contains("(rows.csv)"));
        write(&out.join("run.yaml"), "tool: sweep\n");
        assert!(refusal(TABLES.examine(&out, &[])).contains("run.yaml was not written by"));
        write(&out.join("run.yaml"), "tool: bench\nrest: 1\n");
        assert_eq!(TABLES.examine(&out, &[]).unwrap(), Found::Record);
        assert!(refusal(TABLES.examine(&out.join("rows.csv"), &[])).contains("this is a file"));
    }

    #[test]
    fn an_interrupted_run_is_known_by_what_it_began_with() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("out");
        TABLES.begin(&out).unwrap();
        write(&out.join("rows.csv"), "half of them");
        assert_eq!(TABLES.examine(&out, &[]).unwrap(), Found::Begun);
        TABLES.finish(&out, b"tool: bench\nrest: 1\n").unwrap();
        assert_eq!(TABLES.examine(&out, &[]).unwrap(), Found::Record);
        // A finished run that begins anew is not degraded to an interrupted one.
        TABLES.begin(&out).unwrap();
        assert_eq!(TABLES.examine(&out, &[]).unwrap(), Found::Record);
        let names = files::names_in(&out).unwrap();
        assert_eq!(names.len(), 2, "{names:?}");
    }

    #[test]
    fn leftovers_are_no_obstacle_and_go_away() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path();
        write(&out.join(".unfinished-abc123"), "half");
        write(&out.join("images/.unfinished-Zz9Zz9"), "half");
        std::fs::rename(out.join("images"), out.join(".unfinished-FOLDER")).unwrap();
        assert_eq!(WORLD.examine(out, &[]).unwrap(), Found::Nothing);
        WORLD.begin(out).unwrap();
        assert_eq!(files::names_in(out).unwrap(), ["unfinished-WORLD.yaml"]);
    }

    #[test]
    fn inputs_and_outputs_stay_apart_however_they_are_written() {
        let folder = tempfile::tempdir().unwrap();
        let at = |path: &str| folder.path().join(path);
        write(&at("raw/2011_09_26/calib.txt"), "real");
        let inside = |out: &str, input: &str| WORLD.examine(&at(out), &[&at(input)]);
        for out in ["raw", "raw/x/y", "none/../raw/x", "none/deep/../../raw/./x"] {
            assert!(
                refusal(inside(out, "raw")).contains("inside the input folder"),
                "{out}"
            );
        }
        assert!(refusal(inside("none/..", "raw")).contains("holds the input"));
        assert_eq!(inside("rawer", "raw").unwrap(), Found::Nothing);
        assert_eq!(inside("out", "none/../raw").unwrap(), Found::Nothing);
        // An input beside what the command writes is in no danger.
        write(&at("r/model.onnx"), "weights");
        let with = |input: &str| TABLES.examine(&at("r"), &[&at(input)]);
        assert_eq!(with("r/model.onnx").unwrap(), Found::Nothing);
        assert!(refusal(with("r/rows.csv")).contains("holds the input"));
        #[cfg(unix)]
        {
            std::os::unix::fs::symlink(at("raw"), at("link")).unwrap();
            assert!(refusal(inside("link/x", "raw")).contains("inside the input folder"));
            assert!(refusal(inside("raw/x", "link")).contains("inside the input folder"));
        }
    }

    #[test]
    fn single_files_are_known_by_how_they_begin() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("report.html");
        let check = |inputs: &[&Path]| check_file(&path, inputs, "bench report", "<!DOCTYPE html>");
        check(&[]).unwrap();
        write(&path, "<!DOCTYPE html>\n...");
        check(&[]).unwrap();
        write(&path, "model,protocol\n");
        let text = check(&[]).unwrap_err().to_string();
        assert!(text.contains("not written by `bench report`"), "{text}");
        let text = check(&[&path]).unwrap_err().to_string();
        assert!(text.contains("an input"), "{text}");
        assert!(check_file(folder.path(), &[], "x", "y").is_err());
    }
}
