//! The tables of a set: a line for each sample, a column for each file and one for its hash.

use std::collections::HashSet;
use std::path::Path;

use super::sample::{FileRef, OPTIONAL_FILES, Sample, check_id, is_plain};
use crate::error::{Error, Result};

/// Longest path of a file within a set, in bytes.
const LONGEST_PATH: usize = 1024;

fn columns() -> Vec<String> {
    let mut columns: Vec<_> = ["id", "width", "height", "focal_px", "baseline_m"]
        .map(String::from)
        .into();
    let files = ["left"]
        .into_iter()
        .chain(OPTIONAL_FILES.iter().map(|(name, _)| *name));
    columns.extend(files.flat_map(|name| [name.to_owned(), format!("{name}_blake3")]));
    columns
}

/// The bytes of a table.
pub(super) fn table_bytes(samples: &[Sample]) -> Vec<u8> {
    let mut writer = strat_csv::Writer::new(Vec::new());
    let mut rows = vec![columns()];
    for sample in samples {
        let mut row = vec![
            sample.id.clone(),
            sample.width.to_string(),
            sample.height.to_string(),
            sample.focal_px.to_string(),
            sample.baseline_m.to_string(),
        ];
        row.extend([sample.left.path.clone(), sample.left.blake3.clone()]);
        for (_, column) in OPTIONAL_FILES {
            match (column.get)(sample) {
                Some(file) => row.extend([file.path.clone(), file.blake3.clone()]),
                None => row.extend([String::new(), String::new()]),
            }
        }
        rows.push(row);
    }
    for row in rows {
        writer
            .write_record(row)
            .expect("rows of equal length can be written into memory");
    }
    writer.into_inner().expect("memory can be written to")
}

/// The samples of a table; `path` is for messages.
pub(super) fn parse_table(path: &Path, bytes: &[u8]) -> Result<Vec<Sample>> {
    let bad = |line: u64, problem: String| Error::Table {
        path: path.to_owned(),
        line,
        problem,
    };
    let mut reader = strat_csv::Reader::new(bytes);
    let expected = columns();
    let header = reader.headers().map_err(|e| bad(1, e.to_string()))?;
    if !header.iter().eq(&expected) {
        return Err(bad(
            1,
            format!("its columns should be {}", expected.join(",")),
        ));
    }
    let mut samples = Vec::new();
    let mut ids = HashSet::new();
    for record in reader.records() {
        let record = record.map_err(|e| {
            bad(
                e.position().map_or(0, strat_csv::Position::line),
                e.to_string(),
            )
        })?;
        let line = record.position().map_or(0, strat_csv::Position::line);
        let sample = parse_row(&record).map_err(|problem| bad(line, problem))?;
        if !ids.insert(sample.id.clone()) {
            return Err(bad(line, format!("the id `{}` occurs twice", sample.id)));
        }
        samples.push(sample);
    }
    Ok(samples)
}

fn parse_row(record: &strat_csv::StringRecord) -> std::result::Result<Sample, String> {
    let mut fields = record.iter();
    let mut next = || fields.next().unwrap_or_default();
    fn positive<T: std::str::FromStr + PartialOrd + Default>(
        name: &str,
        text: &str,
    ) -> std::result::Result<T, String> {
        let number: Option<T> = text.parse().ok().filter(|n| *n > T::default());
        number.ok_or_else(|| format!("`{name}` should be a positive number, but is `{text}`"))
    }
    let id = next().to_owned();
    if id.is_empty() {
        return Err("`id` is empty".to_owned());
    }
    check_id(&id)?;
    let (width, height) = (positive("width", next())?, positive("height", next())?);
    let (focal_px, baseline_m) = (
        known_or_zero("focal_px", next())?,
        known_or_zero("baseline_m", next())?,
    );
    let mut file = |name: &str| -> std::result::Result<Option<FileRef>, String> {
        let (path, blake3) = (next(), next());
        if path.is_empty() {
            return Ok(None);
        }
        if path.len() > LONGEST_PATH || !is_plain(path) {
            let start: String = path.chars().take(80).collect();
            return Err(format!(
                "`{name}` should be a path inside the set, but is `{}`",
                start.escape_debug()
            ));
        }
        if blake3.len() != 64 || !blake3.bytes().all(|b| b.is_ascii_hexdigit()) {
            return Err(format!(
                "`{name}_blake3` should have 64 hex digits, but is `{blake3}`"
            ));
        }
        Ok(Some(FileRef {
            path: path.to_owned(),
            blake3: blake3.to_owned(),
        }))
    };
    let left = file("left")?.ok_or("`left` is empty")?;
    let mut sample = Sample::new(id, (width, height), focal_px, baseline_m, left);
    for (name, column) in OPTIONAL_FILES {
        *(column.set)(&mut sample) = file(name)?;
    }
    Ok(sample)
}

/// A length of the camera, or 0 where it is not known.
fn known_or_zero(name: &str, text: &str) -> std::result::Result<f64, String> {
    let number = text
        .parse()
        .ok()
        .filter(|n: &f64| n.is_finite() && *n >= 0.0);
    number.ok_or_else(|| {
        format!("`{name}` should be a positive number, or 0 if it is not known, but is `{text}`")
    })
}

#[cfg(test)]
mod tests {
    use super::super::tests::sample;
    use super::*;
    use crate::files;

    #[test]
    fn bad_lines_are_named() {
        let good = String::from_utf8(table_bytes(&[sample("a/1"), sample("a/2")])).unwrap();
        let parse = |text: String| parse_table(Path::new("train.csv"), text.as_bytes());
        assert_eq!(parse(good.clone()).unwrap().len(), 2);
        let cases = [
            (
                good.replacen("focal_px", "focal", 1),
                1,
                "columns should be",
            ),
            (
                good.replacen("a/2,1242", "a/2,-4", 1),
                3,
                "`width` should be a positive number, but is `-4`",
            ),
            (good.replacen("721.5377", "NaN", 1), 2, "focal_px"),
            (good.replacen("721.5377", "inf", 1), 2, "focal_px"),
            (
                good.replacen("721.5377", "-1", 1),
                2,
                "0 if it is not known",
            ),
            (
                good.replacen("images/d/left", "../../etc", 1),
                2,
                "path inside the set",
            ),
            (
                good.replacen("images/d/left", "/images/d/left", 1),
                2,
                "path inside the set",
            ),
            (good.replacen("a/2,1242", "a/2", 1), 3, "fields"),
            (good.replacen("a/2,", "a/1,", 1), 3, "`a/1` occurs twice"),
            (good.replacen("a/2,", "../../a,", 1), 3, "not a usable id"),
            (good.replacen("a/2,", "\"a\nb\",", 1), 3, "not a usable id"),
            (good.replacen("a/2,", "a\0b,", 1), 3, "not a usable id"),
            (
                good.replacen("images/d/left", "images//left", 1),
                2,
                "path inside the set",
            ),
            (
                good.replacen("images/d/left", "images/\u{7}/left", 1),
                2,
                "path inside the set",
            ),
            (good.replacen("a/1,", ",", 1), 2, "`id` is empty"),
        ];
        for (text, line, problem) in cases {
            let error = parse(text).unwrap_err().to_string();
            assert!(
                error.starts_with(&format!("train.csv, line {line}: ")) && error.contains(problem),
                "{error}"
            );
        }
        let hash = files::blake3_hex(b"images/d/left/0000000005.png");
        assert!(
            parse(good.replacen(&hash, "123", 1))
                .unwrap_err()
                .to_string()
                .contains("64 hex digits")
        );
    }
}
